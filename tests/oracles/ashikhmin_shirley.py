"""ashikhmin_shirley, once more."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from exact import Number, dot, half, mp

CASES: list[dict[str, Any]] = [
    {"n_u": 10.0, "n_v": 1000.0},
    {"n_u": 1e4, "n_v": 1.0, "r_s": 0.3},
    {"n": 30.0, "r_s": 0.05, "r_d": 1.0},
    {"n": 30.0, "r_s": 0.8, "r_d": 1.0, "diffuse": "lambert"},
]
"""Sets of parameters that matter together."""


def brdf(p: Mapping[str, Any], light: Any, view: Any) -> Number:
    a, b, r_s, r_d = (mp.mpf(p[k]) for k in ("n_u", "n_v", "r_s", "r_d"))
    total = mp.zero
    if p["specular"] == "paper":
        h = half(light, view)
        u = dot(view, h)
        t2 = h[0] ** 2 + h[1] ** 2
        n = (a * h[0] ** 2 + b * h[1] ** 2) / t2 if t2 > 0 else a
        total += (
            mp.sqrt((a + 1) * (b + 1)) / (8 * mp.pi) * h[2] ** n / (u * max(light[2], view[2]))
        ) * (r_s + (1 - r_s) * (1 - u) ** 5)
    if p["diffuse"] == "lambert":
        total += r_d / mp.pi
    elif p["diffuse"] == "paper":
        both = (1 - (1 - light[2] / 2) ** 5) * (1 - (1 - view[2] / 2) ** 5)
        total += 28 * r_d / (23 * mp.pi) * (1 - r_s) * both
    return total
