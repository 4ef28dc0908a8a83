"""lewis, once more."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from functools import cache
from typing import Any

from exact import Number, cos_mirror, half, mp, power

CHECKED_BY = "test_normalize.py"
"""Where the albedo is held against something independent."""

CASES: list[dict[str, Any]] = [
    {"reading": "per_incidence", "n": 3.0},
    {"reading": "per_incidence", "n": 1e4, "rho_s": 0.7},
    {"reading": "per_incidence", "lobe": "mirror", "n": 20.0},
    {"reading": "per_incidence", "lobe": "mirror", "n": 1e5},
    {"lobe": "mirror", "n": 150.0},
]
"""Sets of parameters that matter together."""


def half_vector_integral(n: Number, cos_theta: Number) -> Number:
    """Int (n.h)^n (n.v) dV as one integral over the angle d of h to the normal.

    dV = 4 (l.h) dh and n.v = 2 (l.h)(n.h) - n.l are polynomials in the cosine of the azimuth of h,
    and v is above the horizon where that cosine exceeds (n.l/(2 n.h) - n.l n.h)/(sin theta sin d).
    """
    c, n = mp.mpf(cos_theta), mp.mpf(n)
    s = mp.sqrt((1 - c) * (1 + c))

    def around(d: Number) -> Number:
        a, b, z = c * mp.cos(d), s * mp.sin(d), mp.cos(d)
        least = (c / (2 * z) - a) / b if b > 0 else -mp.one
        least = min(max(least, -mp.one), mp.one)
        psi, sine = mp.acos(least), mp.sqrt((1 - least) * (1 + least))
        squares = a * a * psi + 2 * a * b * sine + b * b * (psi + least * sine) / 2
        return 8 * (2 * z * squares - c * (a * psi + b * sine)) * mp.sin(d) * z**n

    theta = mp.acos(c)
    first, last = (mp.pi / 2 - theta) / 2, (mp.pi / 2 + theta) / 2
    width = 1 / mp.sqrt(n + 1)
    marks = [k * width for k in (1, 2, 4, 6, 9, 14)] + [first * (1 + k) for k in (-0.5, 0.5, 2, 8)]
    ends = sorted({mp.zero, first, last} | {x for x in marks if 0 < x < last})
    return mp.fsum(mp.quad(around, [a, b]) for a, b in itertools.pairwise(ends))


def mirror_integral(n: Number, cos_theta: Number, s: Number = 1) -> Number:
    """Int max(0, o.v)^n (n.v) dV, o = (-l.x, -l.y, s l.z), in two factors.

    With b the angle of v out of the plane of o and N, and eta its elevation within that plane,
    (n.v) dV = cos^2 b sin eta db deta and o.v = |o| cos b cos(eta - e).
    """
    c, n = mp.mpf(cos_theta), mp.mpf(n)
    s, along = mp.mpf(s), mp.sqrt((1 - c) * (1 + c))
    length, e = mp.sqrt(along**2 + (s * c) ** 2), mp.atan2(s * c, along)
    # The Beta function of a large argument, by its logarithm.
    out = mp.exp(mp.loggamma((n + 3) / 2) + mp.loggamma(mp.mpf(1) / 2) - mp.loggamma((n + 4) / 2))
    width = 1 / mp.sqrt(n + 1)
    last = min(e + mp.pi / 2, mp.pi)
    marks = [e + k * width for k in (-14, -9, -6, -4, -2, -1, 0, 1, 2, 4, 6, 9, 14)]
    ends = sorted({mp.zero, last} | {x for x in marks if 0 < x < last})
    within = mp.fsum(
        mp.quad(lambda x: power(mp.cos(x - e), n) * mp.sin(x), [a, b])
        for a, b in itertools.pairwise(ends)
    )
    return length**n * out * within


@cache
def _integral(lobe: str, n: float, cos_theta: str) -> Number:
    integral = half_vector_integral if lobe == "half_vector" else mirror_integral
    return integral(n, mp.mpf(cos_theta))


def brdf(p: Mapping[str, Any], light: Any, view: Any) -> Number:
    n = p["n"]
    x = half(light, view)[2] if p["lobe"] == "half_vector" else cos_mirror(light, view)
    # By 14 digits of the cosine: an ulp more or less is not worth a new integral.
    c = "1" if p["reading"] == "constant" else mp.nstr(light[2], 14)
    return mp.mpf(p["rho_s"]) * power(x, n) / _integral(p["lobe"], n, c)


def amplification(p: Mapping[str, Any]) -> float:
    """The lobe about R has the roundings of the distance from R, as the Phong model."""
    return 1.0
