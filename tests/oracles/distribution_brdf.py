"""distribution_brdf, once more."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from exact import Number, distribution, dot, fresnel_of, half, mp

CHECKED_BY = "test_distribution_brdf.py"
"""Where the albedo is held against something independent."""

CASES: list[dict[str, Any]] = [
    {"m": 1.0, "distribution": "ggx"},
    {"m": 0.3, "distribution": "ggx", "normalization": "solid_angle"},
    {"m": 3.0, "normalization": "solid_angle"},
    {"m": 1.0, "distribution": "ggx", "normalization": "solid_angle"},
    {"alpha_x": 0.4, "alpha_y": 0.1, "distribution": "ggx"},
    {"n": 3.0, "distribution": "blinn_phong", "normalization": "solid_angle"},
    {"distribution": "velvet", "fresnel": "schlick", "f0": 0.04},
]
"""Sets of parameters that matter together."""


def whole(p: Mapping[str, Any], kind: str, width: tuple[float, float]) -> Number:
    """The integral of a distribution of one width over solid angle, in the cosine c of h."""
    m = mp.mpf(width[0])

    def density(c: Number) -> Number:
        return distribution(kind, width, (mp.sqrt(1 - c * c), mp.zero, c))

    # Towards c = 1 a lobe of width m is as wide as m^2.
    cuts = sorted({mp.zero, mp.one} | {1 / mp.sqrt(1 + (m * 2**k) ** 2) for k in range(-8, 9)})
    return 2 * mp.pi * mp.quad(density, cuts)


def brdf(p: Mapping[str, Any], light: Any, view: Any) -> Number:
    kind = p["distribution"]
    h = half(light, view)
    if kind == "velvet":
        a, sine2 = mp.mpf(p["spread"]), h[0] ** 2 + h[1] ** 2
        hairs = 4 * mp.exp(-(h[2] ** 2) / (sine2 * a * a)) / sine2**2 if sine2 > 0 else mp.zero
        density = (1 + hairs) / (mp.pi * (1 + 4 * a * a))
    elif kind == "blinn_phong":
        n = mp.mpf(p["n"])
        more = 1 if p["normalization"] == "solid_angle" else 2
        density = (n + more) / (2 * mp.pi) * h[2] ** n
    else:
        width = (p["alpha_x"], p["alpha_y"])
        density = distribution(kind, width, h)
        if p["normalization"] == "solid_angle":
            density /= whole(p, kind, width)
    cosines = light[2] + view[2] - light[2] * view[2]
    return fresnel_of(p, dot(view, h)) * density / (4 * cosines)
