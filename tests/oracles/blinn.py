"""blinn, once more."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from exact import Number, half, mp


def brdf(p: Mapping[str, Any], light: Any, view: Any) -> Number:
    n = mp.mpf(p["n"])
    exact = (n + 2) * (n + 4) / (8 * mp.pi * (mp.mpf(2) ** (-n / 2) + n))
    c = exact if p["normalization"] == "exact" else (n + 8) / (8 * mp.pi)
    return mp.mpf(p["rho_s"]) * c * half(light, view)[2] ** n
