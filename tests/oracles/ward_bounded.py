"""ward_bounded, once more."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from exact import Number, dot, half, mp, ward_exponent, ward_scale

CASES: list[dict[str, Any]] = [{"alpha_x": 0.2, "alpha_y": 0.05}, {"m": 1e-6}, {"m": 1.0}]
"""Sets of parameters that matter together."""


def brdf(p: Mapping[str, Any], light: Any, view: Any) -> Number:
    h = half(light, view)
    v_dot_h = dot(view, h)
    e = mp.exp(-ward_exponent(p, h) / h[2] ** 2)
    return ward_scale(p) * e / (v_dot_h**2 * h[2] ** 4)
