"""schwenk, once more."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from exact import Number, dot, half, mp

CHECKED_BY = "test_schwenk.py"
"""Where the albedo is held against something independent."""

CASES: list[dict[str, Any]] = [
    {"color": 0.3, "metalness": 1.0, "smoothness": 0.9},
    {"color": 0.3, "metalness": 0.5, "level": "3"},
    {"color": 0.3, "smoothness": 0.8, "k": 0.7, "k_d": 0.5, "k_s": 0.4},
    {"color": 0.3, "reflectivity": 0.6, "color_environment": 0.9},
    {
        "color": 0.3,
        "reflectivity": 0.6,
        "color_environment": 0.9,
        "metalness": 0.4,
        "level": "4",
        "k": 0.5,
    },
]
"""Sets of parameters that matter together."""


def brdf(p: Mapping[str, Any], light: Any, view: Any) -> Number:
    """For a colour that is a number, whose luminance it is."""
    m, s, c, r, c_e = (
        mp.mpf(p[k])
        for k in ("metalness", "smoothness", "color", "reflectivity", "color_environment")
    )
    level = int(p["level"])

    def fresnel(f0: Number, u: Number) -> Number:
        return f0 + (1 - f0) * (1 - u) ** 5

    f = fresnel(mp.mpf(0.04), view[2])
    c_r = (1 - m) * ((1 - f) * c + f * c_e) + m * c * c_e
    j = mp.mpf(p["k_d"]) * ((1 - r) * c + r * c_r) * (1 - s * mp.mpf(p["k"]))
    if level < 4:
        h = half(light, view)
        u = dot(view, h)
        f0 = 1 - m + m * (c if level == 3 else mp.one)
        c_s = fresnel(f0, u) if level == 0 else f0
        strength = s * s / u if level < 2 else s * s
        j += mp.mpf(p["k_s"]) * strength * c_s * h[2] ** (2 / (1 + mp.one / 255 - s))
    return j / mp.pi if p["reading"] == "brdf" else j
