"""ward, once more."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from exact import Number, half, mp, ward_exponent, ward_scale

CASES: list[dict[str, Any]] = [
    {"alpha_x": 0.2, "alpha_y": 0.05},
    {"m": 1e-6},
    {"m": 1.0},
    {"m": 0.5, "form": "fast"},
]
"""Sets of parameters that matter together."""


def brdf(p: Mapping[str, Any], light: Any, view: Any) -> Number:
    h = half(light, view)
    steep = h[2] ** 2 if p["form"] == "exact" else (1 + h[2]) / 2
    e = mp.exp(-ward_exponent(p, h) / steep)
    return ward_scale(p) * e / mp.sqrt(light[2] * view[2])
