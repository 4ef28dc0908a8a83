"""strauss, once more."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from exact import Number, cos_mirror, mp, power

CHECKED_BY = "test_strauss.py"
"""Where the albedo is held against something independent."""

CASES: list[dict[str, Any]] = [
    {"smoothness": 0.95, "metalness": 1.0, "color": 0.4},
    {"smoothness": 0.3, "metalness": 0.6, "transparency": 0.5, "color": 0.2},
    {"smoothness": 0.0, "reading": "literal"},
    {"smoothness": 0.0, "transparency": 1.0},
    {"smoothness": 0.07, "transparency": 1.0},
]
"""Sets of parameters that matter together."""


def angle(v: Any) -> Number:
    """The angle to the normal over a right angle."""
    return 2 * mp.atan2(mp.sqrt(v[0] ** 2 + v[1] ** 2), v[2]) / mp.pi


def brdf(p: Mapping[str, Any], light: Any, view: Any) -> Number:
    s, m, t, c = (mp.mpf(p[k]) for k in ("smoothness", "metalness", "transparency", "color"))
    k_f, k_g, k_j = mp.mpf("1.12"), mp.mpf("1.01"), mp.mpf("0.1")

    def f(x: Number) -> Number:
        return (1 / (x - k_f) ** 2 - 1 / k_f**2) / (1 / (1 - k_f) ** 2 - 1 / k_f**2)

    def g(x: Number) -> Number:
        return (1 / (1 - k_g) ** 2 - 1 / (x - k_g) ** 2) / (1 / (1 - k_g) ** 2 - 1 / k_g**2)

    x_l, x_v = angle(light), angle(view)
    d, r_d = 1 - m * s, (1 - s**3) * (1 - t)
    r_n = (1 - t) - r_d
    r_j = min(mp.one, r_n + (r_n + k_j) * f(x_l) * g(x_l) * g(x_v))
    r_s = r_j * power(cos_mirror(light, view), 3 / (1 - s))
    c_s = 1 + m * (1 - f(x_l)) * (c - 1)
    j = r_d * d * c + r_s * c_s / light[2]
    return j / mp.pi if p["reading"] == "brdf" else j
