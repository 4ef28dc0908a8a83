"""max_phong_anisotropic, once more."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from exact import Number, cos_mirror, mp, power

CASES: list[dict[str, Any]] = [{"n_u": 1e4, "n_v": 1.0}, {"n_u": 50.0, "n_v": 50.0}]
"""Sets of parameters that matter together."""


def brdf(p: Mapping[str, Any], light: Any, view: Any) -> Number:
    a, b = mp.mpf(p["n_u"]), mp.mpf(p["n_v"])
    x, y = light[0] + view[0], light[1] + view[1]
    n = (a * x * x + b * y * y) / (x * x + y * y) if (x, y) != (0, 0) else a
    c = mp.sqrt((a + 2) * (b + 2)) / (2 * mp.pi)
    return c * power(cos_mirror(light, view), n) / max(light[2], view[2])
