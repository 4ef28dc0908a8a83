"""granier_heidrich, once more."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from exact import Number, cos_mirror, dot, fresnel, mp, power

CHECKED_BY = "test_granier_heidrich.py"
"""Where the albedo is held against something independent."""

CASES: list[dict[str, Any]] = [
    {"ior": 1.4, "e0": 10.0, "e1": 5.0, "normalization": "phong"},
    {"ior": 2.0, "e0": 1000.0, "e1": 300.0, "k_d": 0.3, "color": 0.5},
    {"ior": 1.2, "e1": 3.0, "wavelength": 0.645, "thickness": 65.0},
]
"""Sets of parameters that matter together."""


def brdf(p: Mapping[str, Any], light: Any, view: Any) -> Number:
    n, wavelength = mp.mpf(p["ior"]), mp.mpf(p["wavelength"])
    t = mp.mpf(80) / 21 * n / (n + 1) ** 2
    phase = 4 * mp.pi * n * mp.mpf(p["thickness"]) / wavelength
    j_d = (1 + 2 * mp.cos(phase) * mp.sqrt(t * (1 - t))) / 2

    def refracted(v: Any) -> tuple[Number, ...]:
        """Down into the layer: v turned about, bent towards -N."""
        x, y = -v[0] / n, -v[1] / n
        return x, y, -mp.sqrt(1 - x * x - y * y)

    def scale(e: Any) -> Number:
        return (mp.mpf(e) + 2) / (2 * mp.pi) if p["normalization"] == "phong" else mp.one

    f_l, f_v = fresnel(complex(n), light[2]), fresnel(complex(n), view[2])
    t_l, t_v = refracted(light), refracted(view)
    back = (t_l[0], t_l[1], -t_l[2])
    inner = max(mp.zero, -dot(back, t_v))
    j_s = scale(p["e0"]) * f_l * power(cos_mirror(light, view), p["e0"])
    j_s += scale(p["e1"]) * (1 - f_l) * (1 - f_v) * power(inner, p["e1"])
    return mp.mpf(p["k_d"]) * mp.mpf(p["color"]) * j_d / mp.pi + mp.mpf(p["k_s"]) * j_s
