"""fujii, once more."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from exact import Number, dot, mp

CASES: list[dict[str, Any]] = [
    {"sigma": 0.1},
    {"sigma": 0.26, "rho": 0.97},
    {"sigma": 1.2, "rho": 0.5},
    {"form": "artist", "r": 1.0},
]
"""Sets of parameters that matter together."""


def lobe(light: Any, view: Any) -> Number:
    """s/t."""
    s = dot(light, view) - light[2] * view[2]
    return s / (1 if s <= 0 else max(light[2], view[2]))


def brdf(p: Mapping[str, Any], light: Any, view: Any) -> Number:
    rho = mp.mpf(p["rho"])
    if p["form"] == "artist":
        r = mp.mpf(p["r"])
        a = 1 / (mp.pi + (mp.pi / 2 - mp.mpf(2) / 3) * r)
        return rho * a * (1 + r * lobe(light, view))
    s2 = mp.mpf(p["sigma"]) ** 2
    more = mp.mpf("0.17") * rho * s2 / (s2 + mp.mpf("0.13"))
    a = (1 - s2 / (s2 + mp.mpf("0.33")) / 2 + more) / mp.pi
    b = mp.mpf("0.45") * s2 / (s2 + mp.mpf("0.09")) / mp.pi
    return rho * (a + b * lobe(light, view))
