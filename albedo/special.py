"""Special functions with names in other arithmetic: see `albedo.analysis.precise`."""

from __future__ import annotations

import math
from typing import Any

from albedo._compile import stand_in, two_to

_LOG2_E, _SHIFT = 1.0 / math.log(2.0), 1.5 * 2.0**52
# ln 2 in two numbers, of which the first times a whole number below 2^11 is exact.
_LN2_HIGH = math.ldexp(math.floor(math.ldexp(math.log(2.0), 32)), -32)
_LN2_LOW = 1.90821492927058770002e-10
_C_2, _C_3, _C_4, _C_5, _C_6, _C_7, _C_8, _C_9, _C_10, _C_11, _C_12, _C_13 = (
    1.0 / math.factorial(k) for k in range(2, 14)
)


def bessel_j(order: Any, x: Any) -> Any:
    """J_order(x), for arrays that broadcast, by scipy; no kernel can call it."""
    from scipy.special import jv

    return jv(order, x)


@stand_in("exp")
def exp(x):
    """e^x to an ulp and a half for x up to 700, and 0 below -700: loops of it run side by side.

    e^x = 2^k e^r with |r| <= ln(2)/2, where Taylor's series to r^13 leaves out 5e-18.
    """
    bounded = -700.0 if x < -700.0 else x
    shifted = bounded * _LOG2_E + _SHIFT
    k = shifted - _SHIFT
    r = (bounded - k * _LN2_HIGH) - k * _LN2_LOW
    r2 = r * r
    r4 = r2 * r2
    low = (_C_2 + _C_3 * r) + (_C_4 + _C_5 * r) * r2
    middle = (_C_6 + _C_7 * r) + (_C_8 + _C_9 * r) * r2
    high = (_C_10 + _C_11 * r) + (_C_12 + _C_13 * r) * r2
    value = (1.0 + (r + r2 * (low + (middle + high * r4) * r4))) * two_to(shifted)
    return 0.0 if x < -700.0 else value
