"""max_phong, once more."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from exact import Number, cos_mirror, dot, mp, power

CASES: list[dict[str, Any]] = [{"n": 5.0, "p": 0.0}, {"n": 5.0, "p": 0.5}, {"n": 0.0, "c": "safe"}]
"""Sets of parameters that matter together."""


def brdf(p: Mapping[str, Any], light: Any, view: Any) -> Number:
    n = mp.mpf(p["n"])
    c = mp.mpf(p["rho_s"]) * (n + (2 if p["c"] == "paper" else 1)) / (2 * mp.pi)
    retro = p["variant"] == "retro"
    cosine = max(mp.zero, dot(light, view)) if retro else cos_mirror(light, view)
    return c * power(cosine, n) / max(light[2], view[2]) ** mp.mpf(p["p"])
