"""lambert, once more."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from exact import Number, mp


def brdf(p: Mapping[str, Any], light: Any, view: Any) -> Number:
    return mp.mpf(p["rho"]) / mp.pi
