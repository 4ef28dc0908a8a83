"""phong_original, once more."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from exact import Number, cos_mirror, mp, power

CASES: list[dict[str, Any]] = [{"rho_s": 3.0}]
"""Sets of parameters that matter together."""


def brdf(p: Mapping[str, Any], light: Any, view: Any) -> Number:
    return mp.mpf(p["rho_s"]) * power(cos_mirror(light, view), p["n"]) / light[2]
