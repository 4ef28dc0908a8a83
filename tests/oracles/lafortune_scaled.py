"""lafortune_scaled, once more."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

from exact import Number, mp, power
from oracles.lewis import mirror_integral

CHECKED_BY = "test_normalize.py"
"""Where the albedo is held against something independent."""

CASES: list[dict[str, Any]] = [
    {"s": 1.0},
    {"s": 0.5, "n": 3.0},
    {"s": 0.999, "n": 1e4, "rho_s": 0.7},
]
"""Sets of parameters that matter together."""


@cache
def largest(n: float, s: float) -> Number:
    """The largest integral of the lobe over all incidences, by golden sections of log(n.l)."""

    @cache
    def height(t: Number) -> Number:
        return mirror_integral(n, mp.exp(-t), s)

    top = max((mp.mpf(k) for k in range(27)), key=height)
    ratio = (mp.sqrt(5) - 1) / 2
    low, high = max(top - 1, mp.zero), top + 1
    x, y = high - ratio * (high - low), low + ratio * (high - low)
    # 1.2 0.618^36 = 4e-8: what is lost beside the top is the square of it.
    for _ in range(36):
        if height(x) >= height(y):
            high, y = y, x
            x = high - ratio * (high - low)
        else:
            low, x = x, y
            y = low + ratio * (high - low)
    return max(height(low), height(x), height(y), height(high))


def brdf(p: Mapping[str, Any], light: Any, view: Any) -> Number:
    base = mp.mpf(p["s"]) * light[2] * view[2] - light[0] * view[0] - light[1] * view[1]
    return mp.mpf(p["rho_s"]) * power(base, p["n"]) / largest(p["n"], p["s"])


def amplification(p: Mapping[str, Any]) -> float:
    """As for the lobes of lafortune."""
    n = p["n"]
    end = min(10.0 ** (10.0 / n), 1e6) if n > 0.0 else 0.0
    return max(1.0, n**0.5 if p["s"] == 1.0 else n / 23.0, n * end / 230.0)
