"""oren_nayar, once more."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from exact import Number, mp

CASES: list[dict[str, Any]] = [
    {"sigma": 0.1},
    {"sigma": 0.2, "rho": 0.98},
    {"sigma": 0.7, "rho": 0.5},
    {"sigma": 1.2},
]
"""Sets of parameters that matter together."""


def angles(light: Any, view: Any) -> tuple[Number, Number, Number]:
    """alpha, beta and cos(phi_l - phi_v), which is 0 where there is no azimuth."""
    polar = [mp.acos(min(x[2], mp.one)) for x in (light, view)]
    flat = light[0] ** 2 + light[1] ** 2, view[0] ** 2 + view[1] ** 2
    cosine = mp.zero
    if flat[0] * flat[1] > 0:
        cosine = mp.cos(mp.atan2(light[1], light[0]) - mp.atan2(view[1], view[0]))
    return max(polar), min(polar), cosine


def brdf(p: Mapping[str, Any], light: Any, view: Any) -> Number:
    alpha, beta, cosine = angles(light, view)
    s2 = mp.mpf(p["sigma"]) ** 2
    a = 1 - s2 / (s2 + mp.mpf("0.33")) / 2
    b = mp.mpf("0.45") * s2 / (s2 + mp.mpf("0.09"))
    lobe = max(mp.zero, cosine) * mp.sin(alpha) * mp.tan(beta)
    return mp.mpf(p["rho"]) / mp.pi * (a + b * lobe)
