"""stam_gaussian, once more."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from exact import Number, dot, fresnel_of, half, mp, poisson_sum

CHECKED_BY = "test_stam.py"
"""Where the albedo is held against something independent."""

CASES: list[dict[str, Any]] = [
    {"sigma": 2.0, "t_x": 20.0, "t_y": 20.0},
    {"sigma": 0.02, "t_x": 3.0, "t_y": 3.0, "fresnel": "dielectric"},
    {"sigma": 0.3, "t_x": 4.0, "t_y": 1.5},
]
"""Sets of parameters that matter together."""


def brdf(p: Mapping[str, Any], light: Any, view: Any) -> Number:
    sigma, t_x, t_y, wavelength = (mp.mpf(p[k]) for k in ("sigma", "t_x", "t_y", "wavelength"))
    k = 2 * mp.pi / wavelength
    w = light[2] + view[2]
    u, v = light[0] + view[0], light[1] + view[1]
    s_p = (
        mp.pi
        * t_x
        * t_y
        * poisson_sum((k * w * sigma) ** 2, k * k * (u * u * t_x**2 + v * v * t_y**2) / 4)
    )
    factor = fresnel_of(p, dot(view, half(light, view)))
    return factor * (1 + dot(light, view)) ** 2 * s_p / (wavelength**2 * w**2 * light[2] * view[2])
