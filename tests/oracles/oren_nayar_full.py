"""oren_nayar_full, once more."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from exact import Number, mp
from oracles.oren_nayar import angles

CASES: list[dict[str, Any]] = [
    {"sigma": 0.1},
    {"sigma": 0.3, "rho": 0.95},
    {"sigma": 0.65, "rho": 0.1},
    {"sigma": 0.8, "rho": 0.1},
    {"sigma": 1.2, "rho": 0.3},
    {"sigma": 1.2},
]
"""Sets of parameters that matter together."""


def brdf(p: Mapping[str, Any], light: Any, view: Any) -> Number:
    alpha, beta, c = angles(light, view)
    rho, s2 = mp.mpf(p["rho"]), mp.mpf(p["sigma"]) ** 2
    lobe = s2 / (s2 + mp.mpf("0.09"))
    c_1 = 1 - s2 / (s2 + mp.mpf("0.33")) / 2
    c_2 = mp.mpf("0.45") * lobe * (mp.sin(alpha) - (0 if c >= 0 else (2 * beta / mp.pi) ** 3))
    c_3 = lobe / 8 * (4 * alpha * beta / mp.pi**2) ** 2
    f_1 = c_1 + c * c_2 * mp.tan(beta) + (1 - abs(c)) * c_3 * mp.tan((alpha + beta) / 2)
    f_2 = mp.mpf("0.17") * rho * s2 / (s2 + mp.mpf("0.13")) * (1 - c * (2 * beta / mp.pi) ** 2)
    return max(mp.zero, rho / mp.pi * (f_1 + f_2))
