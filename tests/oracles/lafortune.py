"""lafortune, once more."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from exact import Number, mp, power

CHECKED_BY = "test_lafortune.py"
"""Where the albedo is held against something independent."""

CASES: list[dict[str, Any]] = [
    {"lobes": ((-0.9, -0.9, 1.0, 50.0),)},
    {"lobes": ((-1.0, -1.0, 0.8, 200.0),), "rho_d": 0.3},
    {"lobes": ((1.0, 1.0, 1.0, 30.0), (-1.05, -1.05, 1.02, 200.0)), "rho_d": 0.2},
    {"lobes": ((-1.0, -0.7, 0.9, 12.0), (0.5, 0.9, 1.0, 3.5))},
    {"lobes": ((-1.0, -1.0, -0.3, 8.0),)},
    {"lobes": ((1.1, 1.1, -1e-7, 100.0),)},
    {"lobes": ((0.0, 0.0, 1.0, 6.0),)},
    {"lobes": ((0.0, -1.0, 0.5, 1000.0),)},
    {"lobes": ((-1.0, -1.0, 0.99, 1e6),)},
]
"""Sets of parameters that matter together."""


def brdf(p: Mapping[str, Any], light: Any, view: Any) -> Number:
    total = mp.mpf(p["rho_d"]) / mp.pi
    for *c, n in p["lobes"]:
        base = sum(mp.mpf(a) * x * y for a, x, y in zip(c, light, view, strict=True))
        total += power(base, n)
    return total


def amplification(p: Mapping[str, Any]) -> float:
    """o.v is a sum of products with a few roundings, which a power n amplifies n times.

    And 1/x times more where the cosine x is small: down to where x^n is 1e-10 of its peak, or
    x is 1e-6 of it. A lobe about L has the roundings of the distance from it, of 1/sqrt(n).
    """
    worst = 1.0
    for c_x, c_y, c_z, n in p["lobes"]:
        end = min(10.0 ** (10.0 / n), 1e6) if n > 0.0 else 0.0
        classic = c_x == c_y == abs(c_z)
        worst = max(worst, n**0.5 if classic else n / 23.0, n * end / 230.0)
    return worst
