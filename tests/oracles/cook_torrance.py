"""cook_torrance, once more."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from exact import Number, distribution, dot, fresnel_of, half, mp, smith_lambda

CASES: list[dict[str, Any]] = [
    {"m": 1.0, "distribution": "ggx", "geometry": "smith_correlated"},
    {"m": 1e-6, "distribution": "ggx", "geometry": "smith"},
    {"m": 0.3, "geometry": "smith"},
    {"alpha_x": 0.5, "alpha_y": 0.05, "distribution": "ggx", "geometry": "smith"},
    {"alpha_x": 0.02, "alpha_y": 0.5, "geometry": "v_cavity"},
    {"n": 4.0, "distribution": "blinn_phong"},
    {"n": 4.0, "distribution": "blinn_phong", "geometry": "smith"},
    {"n_u": 1e4, "n_v": 1.0, "distribution": "ashikhmin_shirley", "geometry": "smith"},
    {"m": 0.7, "distribution": "gaussian", "geometry": "smith_correlated"},
    {"m": 0.4, "fresnel": "conductor", "ior": 0.2, "k": 3.0},
    {"m": 0.4, "fresnel": "dielectric", "ior": 0.7, "distribution": "ggx"},
    {"m": 0.4, "geometry": "none"},
    {"m": 0.4, "geometry": "schlick_smith"},
    {"alpha_x": 0.5, "alpha_y": 0.05, "distribution": "ggx", "geometry": "schlick_smith"},
    {"m": 0.4, "geometry": "smith_rational"},
    {"m": 0.6, "distribution": "gaussian", "normalization": "paper"},
    {"n_u": 10.0, "n_v": 1e3, "distribution": "ashikhmin_shirley", "normalization": "paper"},
    {"m": 0.3, "fresnel": "schlick", "f0": 0.5},
    {"m": 0.3, "fresnel": "lazanyi", "ior": 0.97, "k": 6.68},
    {"m": 0.3, "fresnel": "lazanyi", "ior": 0.39, "k": 2.67, "a": 0.155, "alpha": 3.02},
    {"m": 0.3, "fresnel": "copper", "source": "measured", "wavelength": 0.47},
]
"""Sets of parameters that matter together."""


def brdf(p: Mapping[str, Any], light: Any, view: Any) -> Number:
    name = p["distribution"]
    width = (p["alpha_x"], p["alpha_y"]) if "alpha_x" in p else (p["n_u"], p["n_v"])
    h = half(light, view)
    u = dot(view, h)
    g = mp.one
    if p["geometry"] == "v_cavity":
        g = min(g, 2 * h[2] * light[2] / u, 2 * h[2] * view[2] / u)
    elif p["geometry"] != "none":
        a, b = (smith_lambda(name, width, v, p["geometry"]) for v in (light, view))
        g = 1 / (1 + a + b) if p["geometry"] == "smith_correlated" else 1 / ((1 + a) * (1 + b))
    # 1982: F/pi, with a distribution that lacks 1/pi.
    quarter = mp.one if p["prefactor"] == "1/pi" else mp.mpf("0.25")
    d = distribution(name, width, h, p.get("normalization") == "paper")
    return fresnel_of(p, u) * d * g * quarter / (light[2] * view[2])
