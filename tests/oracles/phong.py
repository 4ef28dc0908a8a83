"""phong, once more."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from exact import Number, cos_mirror, mp, power


def brdf(p: Mapping[str, Any], light: Any, view: Any) -> Number:
    n = mp.mpf(p["n"])
    return mp.mpf(p["rho_s"]) * (n + 2) / (2 * mp.pi) * power(cos_mirror(light, view), n)
