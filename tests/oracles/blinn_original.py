"""blinn_original, once more."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from exact import Number, half, mp


def brdf(p: Mapping[str, Any], light: Any, view: Any) -> Number:
    return mp.mpf(p["rho_s"]) * half(light, view)[2] ** mp.mpf(p["n"]) / light[2]
