"""Golden directional albedos of pumped-up reflectance models, to 13 digits and more.

Pumping-up divides a reflectance model by a symmetric function of its own albedo, and does it again
with what comes out (Neumann, Neumann and Szirmay-Kalos, eqs. 16 to 21)::

    a_k(L) = integral over the upper hemisphere of f_k(L, V) (N.V) dV
    none:        f_(k+1) = f_k / max(a_k(L), a_k(V))
    literal:     f_(k+1) = f_k / max(a_k(L), a_k(V), N.L, N.V)
    cumulative:  f_k = f_0 / max(product over j < k of max(a_j(L), a_j(V)), N.L, N.V)

This script writes ``pumped.csv`` beside itself, with the columns ``model, control, steps,
cos_theta, value, digits``; ``value`` is a_k(L) after k = ``steps`` steps.  It shares nothing with
the package it serves: it needs mpmath, the standard library, and the arithmetic and the
one-dimensional quadrature of ``make_golden.py``, which see for gmpy2.

How the values are made
-----------------------
All models here are isotropic, so albedos and divisors know only the elevations ``x`` of L and
``y`` of V above the horizon.  With the integral of f_0 around the ring of constant ``y``,
``I(x, y)``::

    a_k(x) = integral from 0 to pi/2 of I(x, y) sin(y) cos(y) / divisor_k(x, y) dy

*Rings* are closed forms.  With c = sin(x) + sin(y) and the cosine ``r.v = A + B cos(phi)`` of V
with the mirror direction, A = sin(x) sin(y), B = cos(x) cos(y):

- Phong's and Lafortune's, for an integer exponent, by the recurrence of the integrals of
  (A + B cos(phi))^n over the angles where it is positive;
- Blinn's, for an even exponent, as Laplace's integral of a Legendre polynomial:
  (n.h)^2 = c^2/(2 (1 + A - B cos(phi))), and (1 + A)^2 - B^2 = c^2;
- Ward's by the Bessel function I_0;
- GGX's by integrals of 1/(a - b cos(phi)) and its square;
- Oren and Nayar's are elementary.

*Albedos* a_0 and a_1, which are needed at every node of the next integral, are kept as piecewise
Chebyshev interpolants of log(a) in log(y).  Pieces are halved until points between their nodes
agree.  They end where a_1 is not smooth: at the heights where an albedo has an extremum, where it
equals what it is at an extremum or at normal incidence, where it equals the cosine, and at heights
that these are sent to.

*Integrals* are cut at y = x, at the ends of those pieces, wherever another candidate of a maximum
takes over (found on a grid that holds all extrema, then by bisection), and where the horizon
begins to clip a ring, which has a square root there.  Panels are graded towards the horizon.

How the digits are demonstrated
-------------------------------
Every value is computed twice, from the rings on, with different orders, panels, interpolants,
grids and precisions (``PLANS``).  ``digits`` is ``floor(-log10(relative difference))`` of the two;
the value printed is the one of the higher order.  ``--check`` tests the rings on mpmath's own
quadrature of f over the azimuth, and a_0 on ``make_golden.py``, which has other coordinates.

Every number in a model name and ``cos_theta`` stand for exactly the double that Python reads.

Usage::

    python make_pumped.py                 # add the missing rows to pumped.csv
    python make_pumped.py --only 'ward'   # only models whose name matches the regular expression
    python make_pumped.py --force         # start anew
    python make_pumped.py --list          # show the rows wanted, compute nothing
    python make_pumped.py --check         # test rings and albedos before the first step
"""

from __future__ import annotations

import argparse
import csv
import math
import re
import sys
import time
from bisect import bisect_right
from collections.abc import Callable, Iterator
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import make_golden
import mpmath
from make_golden import AR, Feature, Panel, Real, Recipe, Rule, Spec

HERE = Path(__file__).parent
COLUMNS = ("model", "control", "steps", "cos_theta", "value", "digits")
CONTROLS = ("none", "literal", "cumulative")
MIN_DIGITS = 13
PRINTED_DIGITS = 25

Ring = Callable[[Real, Real, Real], Real]  # of y, sin(y) and cos(y)


# ------------------------------------------------------------------------------------------------
# Rings
# ------------------------------------------------------------------------------------------------


class Base:
    """A model: the integrals of f around rings of constant elevation."""

    special: tuple[float, ...] = ()  # elevations, in units of pi, where albedos are not smooth
    kinked = False  # a_0 itself is not smooth there

    def __init__(self, spec: Spec) -> None:
        self.spec = spec

    def ring(self, x: Real) -> Ring:
        """I(x, .)."""
        raise NotImplementedError

    def edge(self, x: Real) -> Real | None:
        """The elevation below which rings are clipped."""
        return None

    def value(self, x: Real, y: Real, cos_phi: Real) -> Real:
        """f itself; cos_phi is that of the azimuth from the lobe.  For checks."""
        raise NotImplementedError


class Phong(Base):
    """c (r.v)^n, or c (r.v)^n / max(n.l, n.v)."""

    special = (0.25,)  # where a ring of the same elevation begins to be clipped

    def __init__(self, spec: Spec) -> None:
        super().__init__(spec)
        n = spec.real("n")
        self.across = self.along = AR.num(1)
        self.n = int(n)
        if self.n != n or self.n < 1:
            raise ValueError("only for positive integer exponents")
        self.scale = (n + 2) / (2 * AR.pi)
        self.over_larger = self.kinked = spec.name == "max_phong"

    def ring(self, x: Real) -> Ring:
        n, scale, over_larger = self.n, self.scale, self.over_larger
        sin_x, cos_x, longer = AR.sin(x), AR.cos(x), self.across - self.along
        along, across, both = self.along * sin_x, self.across * cos_x, self.across
        pi, sqrt, asin, cos = AR.pi, AR.sqrt, AR.asin, AR.cos

        def value(y: Real, sin_y: Real, cos_y: Real) -> Real:
            a, b = along * sin_y, across * cos_y
            short = both * cos(x + y) + longer * sin_x * sin_y  # b - a
            if short > 0 and b > 0:
                now = pi - 2 * asin(sqrt(short / (2 * b)))
                before, now = now, a * now + sqrt(short * (a + b))
            else:
                before, now = pi, a * pi
            square = (b - a) * (b + a)
            for k in range(2, n + 1):
                before, now = now, ((2 * k - 1) * a * now + (k - 1) * square * before) / k
            result = 2 * scale * now
            return result / max(sin_x, sin_y) if over_larger else result

        return value

    def edge(self, x: Real) -> Real:
        return AR.pi / 2 - AR.atan(self.along * AR.sin(x) / (self.across * AR.cos(x)))

    def value(self, x: Real, y: Real, cos_phi: Real) -> Real:
        sin_x, sin_y = AR.sin(x), AR.sin(y)
        lobe = self.along * sin_x * sin_y + self.across * AR.cos(x) * AR.cos(y) * cos_phi
        result = self.scale * lobe**self.n if lobe > 0 else 0 * lobe
        return result / max(sin_x, sin_y) if self.over_larger else result


class Lafortune(Phong):
    """One lobe (c, c, d, n): (A + B cos(phi))^n, A = d sin(x) sin(y) and B = |c| cos(x) cos(y).

    The azimuth phi is that from its axis, which is on the side of the mirror direction for c < 0
    and on that of the light for c > 0.
    """

    def __init__(self, spec: Spec) -> None:
        Base.__init__(self, spec)
        c, other, d, n = (float(number) for number in spec.word("lobes", "").strip("()").split(","))
        if c != other or c == 0 or d <= 0 or n != int(n) or n < 1:
            raise ValueError("only for one isotropic lobe above the horizon, of integer exponent")
        self.across, self.along, self.n = AR.num(abs(c)), AR.num(d), int(n)
        self.scale, self.over_larger = AR.num(1), False
        self.special = (math.atan(math.sqrt(abs(c) / d)) / math.pi,)


class Blinn(Base):
    """c (n.h)^n with n = 2 m: I = 2 pi c 2^-m (l + v)^m P_(m-1)((1 + l v)/(l + v))."""

    def __init__(self, spec: Spec) -> None:
        super().__init__(spec)
        n = spec.real("n")
        self.m = int(n) // 2
        if 2 * self.m != n or self.m < 1:
            raise ValueError("only for positive even exponents")
        self.scale = (n + 2) * (n + 4) / (8 * AR.pi * (AR.num(1) / 2**self.m + n))

    def ring(self, x: Real) -> Ring:
        sin_x = AR.sin(x)
        m, scale = self.m, 2 * AR.pi * self.scale / 2**self.m

        def value(y: Real, sin_y: Real, cos_y: Real) -> Real:
            both, top = sin_x + sin_y, 1 + sin_x * sin_y
            square = both * both
            before, now = AR.num(0), AR.num(1)
            for k in range(1, m):
                before, now = now, ((2 * k - 1) * top * now - (k - 1) * square * before) / k
            return scale * both * now

        return value

    def value(self, x: Real, y: Real, cos_phi: Real) -> Real:
        sin_x, sin_y = AR.sin(x), AR.sin(y)
        halved = 2 * (1 + sin_x * sin_y - AR.cos(x) * AR.cos(y) * cos_phi)
        return self.scale * ((sin_x + sin_y) ** 2 / halved) ** self.m


def scaled_bessel(z: Real) -> Real:
    """exp(-z) I_0(z): the power series, or the asymptotic one where that is exact enough."""
    if z < 60:
        quarter, term, total, k = z * z / 4, AR.num(1), AR.num(1), 0
        while term > total * 1e-45:
            k += 1
            term = term * quarter / (k * k)
            total += term
        return total * AR.exp(-z)
    term = total = AR.num(1)
    k = 0
    while term > 1e-45:
        k += 1
        term = term * ((2 * k - 1) * (2 * k - 1)) / (8 * k * z)
        total += term
    return total / AR.sqrt(2 * AR.pi * z)


class Ward(Base):
    """exp(-tan^2(d)/m^2) / (4 pi m^2 sqrt(n.l n.v)), d the angle between half vector and normal.

    tan^2(d) = 2 (1 + A - B cos(phi))/(l + v)^2 - 1, which is tan^2((x - y)/2) at phi = 0.
    """

    def __init__(self, spec: Spec) -> None:
        super().__init__(spec)
        self.inverse = 1 / spec.real("m") ** 2
        self.scale = self.inverse / (4 * AR.pi)

    def ring(self, x: Real) -> Ring:
        sin_x, cos_x = AR.sin(x), AR.cos(x)
        inverse, scale = self.inverse, 2 * AR.pi * self.scale

        def value(y: Real, sin_y: Real, cos_y: Real) -> Real:
            both, tangent = sin_x + sin_y, AR.tan((x - y) / 2)
            z = 2 * inverse * cos_x * cos_y / (both * both)
            peak = AR.exp(-inverse * tangent * tangent)
            return scale * peak * scaled_bessel(z) / AR.sqrt(sin_x * sin_y)

        return value

    def value(self, x: Real, y: Real, cos_phi: Real) -> Real:
        sin_x, sin_y = AR.sin(x), AR.sin(y)
        halved = 2 * (1 + sin_x * sin_y - AR.cos(x) * AR.cos(y) * cos_phi)
        slope2 = halved / (sin_x + sin_y) ** 2 - 1
        return self.scale * AR.exp(-self.inverse * slope2) / AR.sqrt(sin_x * sin_y)


class Ggx(Base):
    """D G / (4 n.l n.v) with GGX's D and height-correlated Smith masking.

    G/(4 l v) = 1/(2 (v e(l) + l e(v))), e(u)^2 = m^2 + (1 - m^2) u^2, and with
    w = 1 + A - B cos(phi) and k = (1 - m^2) (l + v)^2/2, D = m^2/pi (w/(w - k))^2.
    """

    def __init__(self, spec: Spec) -> None:
        super().__init__(spec)
        wanted = ("ggx", "smith_correlated")
        if (spec.word("distribution", ""), spec.word("geometry", "")) != wanted:
            raise ValueError("only GGX with height-correlated Smith masking")
        self.m2 = spec.real("m") ** 2

    def masked(self, sin_x: Real, sin_y: Real) -> Real:
        """G/(4 l v)."""
        e_x, e_y = (AR.sqrt(self.m2 + (1 - self.m2) * u * u) for u in (sin_x, sin_y))
        return 1 / (2 * (sin_y * e_x + sin_x * e_y))

    def ring(self, x: Real) -> Ring:
        sin_x, cos_x, m2 = AR.sin(x), AR.cos(x), self.m2

        def value(y: Real, sin_y: Real, cos_y: Real) -> Real:
            half, tangent = (sin_x + sin_y) ** 2 / 2, AR.tan((x - y) / 2)
            k, b = (1 - m2) * half, cos_x * cos_y
            least = half * (tangent * tangent + m2)  # w - k at phi = 0
            a = least + b
            root = AR.sqrt(least * (a + b))
            around = 1 + 2 * k / root + k * k * a / (root * root * root)
            return 2 * m2 * around * self.masked(sin_x, sin_y)

        return value

    def value(self, x: Real, y: Real, cos_phi: Real) -> Real:
        sin_x, sin_y = AR.sin(x), AR.sin(y)
        w = 1 + sin_x * sin_y - AR.cos(x) * AR.cos(y) * cos_phi
        h2 = (sin_x + sin_y) ** 2 / (2 * w)
        slope_density = self.m2 / (AR.pi * (1 - (1 - self.m2) * h2) ** 2)
        return slope_density * self.masked(sin_x, sin_y)


class OrenNayar(Base):
    """(A + B max(0, cos(phi_l - phi_v)) sin(alpha) tan(beta)) / pi."""

    def __init__(self, spec: Spec) -> None:
        super().__init__(spec)
        s2 = spec.real("sigma") ** 2
        rho = spec.real("rho", 1.0)
        self.a = rho * (1 - s2 / (s2 + AR.num(33) / 100) / 2)
        self.b = rho * 45 * s2 / (s2 + AR.num(9) / 100) / 100

    def ring(self, x: Real) -> Ring:
        sin_x = AR.sin(x)
        flat, lobe = 2 * self.a, 2 * self.b * AR.cos(x) / AR.pi
        return lambda y, sin_y, cos_y: flat + lobe * cos_y / max(sin_x, sin_y)

    def value(self, x: Real, y: Real, cos_phi: Real) -> Real:
        towards = max(0 * x, -cos_phi) * AR.cos(x) * AR.cos(y) / AR.sin(max(x, y))
        return (self.a + self.b * towards) / AR.pi


BASES: dict[str, type[Base]] = {
    "phong": Phong,
    "max_phong": Phong,
    "lafortune": Lafortune,
    "blinn": Blinn,
    "ward": Ward,
    "cook_torrance": Ggx,
    "oren_nayar": OrenNayar,
}


# ------------------------------------------------------------------------------------------------
# Plans
# ------------------------------------------------------------------------------------------------


class Plan(NamedTuple):
    """What distinguishes the two computations of a value."""

    recipe: Recipe  # of the integrals
    degree: int  # of the interpolants
    long: float  # the longest piece of an interpolant in log(y), far down
    short: float  # and for y > 0.1
    lowest: float  # elevation of the lowest panel and piece
    tolerance: float  # of the interpolants
    grid: int  # points on which changes of a maximum are looked for


PLANS = (
    Plan(Recipe(20, 120, 1.0, 1e-20), 26, 2.0, 0.50, 1e-14, 1e-18, 150),
    Plan(Recipe(28, 150, 1.2, 1e-21), 34, 1.7, 0.43, 1e-15, 1e-19, 211),
)
LIKE = 1e-18  # a cosine and an albedo that are so near each other are not told apart


# ------------------------------------------------------------------------------------------------
# Interpolants of albedos
# ------------------------------------------------------------------------------------------------


class Piece(NamedTuple):
    """A Chebyshev series of log(a) between two values of log(y)."""

    lo: Real
    hi: Real
    series: list[Real]
    slopes: list[Real]

    def at(self, t: Real) -> Real:
        """log(a)."""
        return clenshaw(self.series, (2 * t - self.lo - self.hi) / (self.hi - self.lo))

    def slope(self, t: Real) -> Real:
        """The derivative of log(a), up to a positive factor."""
        return clenshaw(self.slopes, (2 * t - self.lo - self.hi) / (self.hi - self.lo))


def clenshaw(series: list[Real], u: Real) -> Real:
    """The sum of series[k] T_k(u)."""
    one = two = AR.num(0)
    twice = 2 * u
    for c in reversed(series[1:]):
        one, two = c + twice * one - two, one
    return series[0] + u * one - two


def chebyshev_nodes(degree: int) -> list[Real]:
    """Zeros of T_(degree + 1)."""
    count = degree + 1
    return [AR.cos(AR.pi * (2 * i + 1) / (2 * count)) for i in range(count)]


def fit(lo: Real, hi: Real, f: Callable[[Real], Real], degree: int) -> Piece:
    """The interpolant of f of this degree."""
    count = degree + 1
    middle, half = (lo + hi) / 2, (hi - lo) / 2
    values = [f(middle + half * u) for u in chebyshev_nodes(degree)]
    cosines = [AR.cos(AR.pi * i / (2 * count)) for i in range(4 * count)]
    series = []
    for k in range(count):
        terms = (v * cosines[k * (2 * i + 1) % (4 * count)] for i, v in enumerate(values))
        series.append(2 * sum(terms) / count)
    series[0] /= 2
    slopes = [AR.num(0)] * (count + 1)
    for k in range(count - 1, 0, -1):
        slopes[k - 1] = slopes[k + 1] + 2 * k * series[k]
    slopes[0] /= 2
    return Piece(lo, hi, series, slopes[:degree])


class Curve:
    """log(a) as a function of the elevation, from the lowest one up to pi/2."""

    def __init__(self, log_albedo: Callable[[Real], Real], breaks: list[Real], plan: Plan) -> None:
        self.breaks = breaks
        self.pieces: list[Piece] = []
        self.calls = 0
        ends = [AR.log(AR.num(plan.lowest)), *map(AR.log, breaks), AR.log(AR.pi / 2)]

        def f(t: Real) -> Real:
            self.calls += 1
            return log_albedo(AR.exp(t))

        for lo, hi in pairwise(ends):
            at = lo
            while at < hi:
                length = plan.long if at < math.log(0.08) else plan.short
                to = at + AR.num(length)
                if to > hi - AR.num(length / 3):
                    to = hi
                self._add(f, at, to, plan)
                at = to
        self.starts = [float(piece.lo) for piece in self.pieces]

    def _add(self, f: Callable[[Real], Real], lo: Real, hi: Real, plan: Plan) -> None:
        """A piece, or its halves if points between the nodes are off."""
        piece = fit(lo, hi, f, plan.degree)
        # Of all light, what passes heights below y is no more than about y^(3/2).
        allowed = plan.tolerance * max(1.0, 0.01 * math.exp(-1.5 * float(hi)))
        if hi - lo > 1e-9:
            tests = (lo + (hi - lo) * AR.num(share) for share in (0.0007, 0.237, 0.768, 0.9991))
            if any(abs(piece.at(t) - f(t)) > allowed for t in tests):
                middle = (lo + hi) / 2
                self._add(f, lo, middle, plan)
                self._add(f, middle, hi, plan)
                return
        self.pieces.append(piece)

    def at(self, t: Real) -> Real:
        """log(a) at log(y); below the lowest elevation, what it is there."""
        if t <= self.pieces[0].lo:
            return self.pieces[0].at(self.pieces[0].lo)
        return self.pieces[bisect_right(self.starts, float(t)) - 1].at(t)

    def extrema(self) -> list[Real]:
        """Elevations inside where the slope changes its sign."""
        found = []
        last: tuple[Real, Any] | None = None
        for piece in self.pieces:
            span = piece.hi - piece.lo
            if max(abs(c) for c in piece.series[1:]) < 1e-15:
                last = None
                continue
            for i in range(21):
                t = piece.lo + span * (i + AR.num(0.5)) / 21
                slope = piece.slope(t)
                if last is not None and (slope > 0) != (last[1] > 0):
                    found.append(self._turn(last[0], t, last[1] > 0))
                last = t, slope
        return [AR.exp(t) for t in found]

    def _turn(self, lo: Real, hi: Real, rising: bool) -> Real:
        """Where the slope changes its sign between two points."""
        for _ in range(80):
            middle = (lo + hi) / 2
            piece = self.pieces[bisect_right(self.starts, float(middle)) - 1]
            if (piece.slope(middle) > 0) == rising:
                lo = middle
            else:
                hi = middle
        return (lo + hi) / 2


# ------------------------------------------------------------------------------------------------
# Pumping up
# ------------------------------------------------------------------------------------------------


class Pump:
    """The albedos of one model, before and after steps, by one plan."""

    def __init__(self, base: Base, control: str, plan: Plan, rule: Rule) -> None:
        self.base, self.control, self.plan, self.rule = base, control, plan, rule
        self.top = AR.pi / 2
        self.curves: list[Curve] = []
        self.special = [AR.pi * AR.num(share) for share in base.special]
        self.marks: list[Real] = []  # elevations where the grid must have points
        self.grid: list[tuple[Real, ...]] = []
        self._lay_grid()

    def take(self, curves: list[Curve], marks: list[Real]) -> None:
        """Begin with these curves."""
        self.curves, self.marks = list(curves), list(marks)
        self._lay_grid()

    # --- what is divided by ---

    def candidates(self, y: Real) -> tuple[Real, ...]:
        """log(y), the logarithms of all albedos there, and that of the cosine."""
        t = AR.log(y)
        return (y, *(curve.at(t) for curve in self.curves), AR.log(AR.sin(y)))

    def log_divisor(self, here: list[Real], there: tuple[Real, ...]) -> Real:
        """That of a pair; both hold logarithms of albedos and, last, of the cosine."""
        largest = [max(a, b) for a, b in zip(here, there, strict=True)]
        cosine = largest.pop()
        if self.control == "literal":
            return sum((max(a, cosine) for a in largest), AR.num(0))
        product = sum(largest, AR.num(0))
        if self.control == "cumulative" and largest:
            return max(product, cosine)
        return product

    def label(self, here: list[Real], there: tuple[Real, ...]) -> tuple[int, ...]:
        """Which candidates are the largest: where this changes there is a kink."""
        sides = [int(b > a) for a, b in zip(here, there, strict=True)]
        if self.control == "none":
            return tuple(sides[:-1])
        largest = [max(a, b) for a, b in zip(here, there, strict=True)]
        cosine, side = largest.pop() - LIKE, sides.pop()
        if self.control == "literal":
            return tuple(2 + side if cosine > a else k for a, k in zip(largest, sides, strict=True))
        if cosine > sum(largest, AR.num(0)):
            return (2 + side,)
        return tuple(sides)

    def _lay_grid(self) -> None:
        """Elevations, with the candidates there, on which changes of the label are looked for."""
        count, low, top = self.plan.grid, self.plan.lowest, self.top
        points = [top * AR.num(i) / count for i in range(1, count)]
        ratio = (0.02 / low) ** (3.0 / count)
        points += [AR.num(low * ratio**i) for i in range(count // 3)]
        points += [y + sign * y * AR.num(1e-9) for y in self.marks for sign in (-1, 0, 1)]
        points.append(top)
        self.grid = [self.candidates(y) for y in sorted(p for p in points if low < p <= top)]

    def changes(self, x: Real, here: list[Real]) -> list[Real]:
        """Elevations y where the label changes."""
        near = [self.candidates(x + sign * x * AR.num(1e-12)) for sign in (-1, 1)]
        points = sorted([*self.grid, *(p for p in near if p[0] < self.top)])
        labels = [self.label(here, p[1:]) for p in points]
        found: list[Real] = []
        for (a, p), (b, q) in pairwise(zip(points, labels, strict=True)):
            if p != q:
                self._bisect(here, a[0], p, b[0], q, found)
        return found

    def _bisect(
        self,
        here: list[Real],
        lo: Real,
        low_label: tuple[int, ...],
        hi: Real,
        high_label: tuple[int, ...],
        found: list[Real],
    ) -> None:
        """All changes between two elevations, between which a third label may lie."""
        while hi - lo > 1e-22 * hi:
            middle = (lo + hi) / 2
            label = self.label(here, self.candidates(middle)[1:])
            if label == low_label:
                lo = middle
            elif label == high_label:
                hi = middle
            else:
                self._bisect(here, lo, low_label, middle, label, found)
                self._bisect(here, middle, label, hi, high_label, found)
                return
        found.append(hi)

    # --- albedos ---

    def albedo(self, x: Real, here: list[Real]) -> Real:
        """The albedo after as many steps as there are curves.

        `here` holds the logarithms of the earlier albedos at x and of the cosine.
        """
        plan, base, top = self.plan, self.base, self.top
        cuts = [x, *(b for curve in self.curves for b in curve.breaks)]
        if self.curves:
            cuts += self.changes(x, here)
        edge = base.edge(x)
        if edge is not None:
            cuts.append(edge)
        cuts = merged([y for y in cuts if plan.lowest < y < top], keep=(x, edge))
        ring, divides = base.ring(x), bool(self.curves)
        sin, cos, exp = AR.sin, AR.cos, AR.exp

        def f(y: Real) -> Real:
            sin_y, cos_y = sin(y), cos(y)
            light = ring(y, sin_y, cos_y) * sin_y * cos_y
            if divides:
                light *= exp(-self.log_divisor(here, self.candidates(y)[1:]))
            return light

        near = [Feature(AR.num(0), plan.lowest), Feature(AR.num(0), 0.35, 0.0)]
        panels: list[Panel] = []
        for a, b in pairwise([AR.num(0), *cuts, top]):
            middle, root = (a + b) / 2, edge is not None and b == edge
            others = [*near, Feature(edge, 0.0)] if edge is not None and b < edge else near
            panels += make_golden.march(a, middle, others, self.rule.spread, False)
            panels += make_golden.march(b, middle, others, self.rule.spread, root)
        return make_golden.integrate(f, panels, self.rule)

    def here(self, x: Real, exact: bool) -> list[Real]:
        """Logarithms of all albedos so far at x, from the curves or anew, and of the cosine."""
        if not exact:
            return list(self.candidates(x)[1:])
        values: list[Real] = []
        curves, self.curves = self.curves, []
        cosine = AR.log(AR.sin(x))
        try:
            for curve in curves:
                # The grid holds one candidate for each curve; it is laid anew for fewer.
                self._lay_grid()
                values.append(AR.log(self.albedo(x, [*values, cosine])))
                self.curves.append(curve)
        finally:
            self.curves = curves
            self._lay_grid()
        return [*values, cosine]

    def step(self) -> None:
        """Make the next curve, of the albedo that the next step divides by."""

        def log_albedo(x: Real) -> Real:
            return AR.log(self.albedo(x, self.here(x, False)))

        curve = Curve(log_albedo, self._breaks(), self.plan)
        self.curves.append(curve)
        self.marks = merged([*self.marks, *curve.extrema(), *curve.breaks])
        self._lay_grid()

    def _breaks(self) -> list[Real]:
        """Elevations where the next albedo may not be smooth."""
        if not self.curves:
            return self.special if self.base.kinked else []
        (curve,) = self.curves
        found = [*self.special, *curve.breaks]
        turns = curve.extrema()
        logs = [curve.at(AR.log(y)) for y in (*turns, *curve.breaks, self.top)]
        if self.control != "none":
            # Where the albedo is the cosine; where either is what the other is at such places.
            equal = self._roots(lambda p: p[1] - p[2] + LIKE)
            logs += [curve.at(AR.log(y)) for y in equal]
            places = [*turns, *curve.breaks, *equal]
            logs += [AR.log(AR.sin(y)) for y in (*places, self.top)]
            found += equal
            for log in logs:
                found += self._roots(lambda p, log=log: p[2] - log)
        for log in logs:
            found += self._roots(lambda p, log=log: p[1] - log)
        found += turns
        low, top = self.plan.lowest * 10, self.top * (1 - AR.num(1e-9))
        return merged([y for y in found if low < y < top])

    def _roots(self, f: Callable[[tuple[Real, ...]], Real]) -> list[Real]:
        """Where a function of the candidates changes its sign."""
        found = []
        values = [f(point) for point in self.grid]
        for (a, p), (b, q) in pairwise(zip(self.grid, values, strict=True)):
            if (p > 0) == (q > 0):
                continue
            lo, hi = a[0], b[0]
            while hi - lo > 1e-22 * hi:
                middle = (lo + hi) / 2
                if (f(self.candidates(middle)) > 0) == (p > 0):
                    lo = middle
                else:
                    hi = middle
            found.append(hi)
        return found


def merged(points: list[Real], keep: tuple[Real | None, ...] = ()) -> list[Real]:
    """The points in order, without those that another one stands for."""
    first = [p for p in keep if p is not None]
    result: list[Real] = []
    for p in [*(p for p in first if p in points), *points]:
        if all(abs(p - q) > 1e-14 * q for q in result):
            result.append(p)
    return sorted(result)


# ------------------------------------------------------------------------------------------------
# Values
# ------------------------------------------------------------------------------------------------


def start(which: int) -> tuple[Plan, Rule]:
    """A plan, with its precision set."""
    plan = PLANS[which]
    AR.set_bits(plan.recipe.bits)
    return plan, make_golden.legendre_rule(plan.recipe)


@cache
def pumped(model: str, control: str, steps: int, which: int) -> Pump:
    """The curves that so many steps read."""
    plan, rule = start(which)
    spec = Spec.parse(model)
    result = Pump(BASES[spec.name](spec), control, plan, rule)
    # The first albedo knows of no control, and one step of both controls is the same.
    others = {1: "none", 2: "literal" if control == "cumulative" else control}
    like = others.get(steps, control)
    if like != control:
        same = pumped(model, like, steps, which)
        result.take(same.curves, same.marks)
    elif steps > 0:
        before = pumped(model, control, steps - 1, which)
        result.take(before.curves, before.marks)
        result.step()
    return result


class Row(NamedTuple):
    """A wanted row."""

    model: str
    control: str
    steps: int
    cos_theta: float


class Golden(NamedTuple):
    """A computed row."""

    value: str
    digits: int


def albedo(row: Row, which: int) -> Real:
    """The albedo by one of the two plans."""
    pump = pumped(row.model, row.control, row.steps, which)
    start(which)
    x = AR.asin(AR.num(row.cos_theta))
    return pump.albedo(x, pump.here(x, True))


def compute(row: Row) -> Golden:
    """Value and demonstrated digits."""
    first, second = albedo(row, 0), albedo(row, 1)
    gap = abs(float((first - second) / second))
    digits = PRINTED_DIGITS if gap == 0 else math.floor(-math.log10(gap))
    value = mpmath.nstr(
        AR.to_mp(second), PRINTED_DIGITS, strip_zeros=False, min_fixed=0, max_fixed=0
    )
    return Golden(value, min(digits, PRINTED_DIGITS))


def check() -> None:
    """Rings against mpmath's quadrature of f, and a_0 against other coordinates."""
    for model in dict.fromkeys(row.model for row in table()):
        worst = 0.0
        start(1)
        base = pumped(model, "none", 0, 1).base
        for x, y in ((1.2, 0.9), (0.3, 0.5), (0.01, 0.3), (0.002, 0.0017), (1.5, 0.04)):
            x, y = AR.num(x), AR.num(y)
            ring = AR.to_mp(base.ring(x)(y, AR.sin(y), AR.cos(y)))
            edge = base.edge(x)
            clip = AR.tan(y) / AR.tan(edge) if edge is not None else AR.num(0)
            ends = [AR.pi, AR.acos(-clip) if clip < 1 else AR.pi / 2, AR.pi / 2]
            ends += [AR.num(10.0**-k) for k in range(5)] + [AR.num(0)]

            def around(phi: Any, base: Base = base, x: Real = x, y: Real = y) -> Any:
                return AR.to_mp(base.value(x, y, AR.cos(AR.from_mp(phi))))

            cuts = sorted(AR.to_mp(end) for end in ends)
            whole = 2 * mpmath.quad(around, cuts)
            worst = max(worst, abs(float(whole / ring - 1)))
        print(f"{model}: rings {worst:.1g}", end="", flush=True)
        assert worst < 1e-22, model
        # The other script knows no lobe of Lafortune's.
        for cos_theta in () if isinstance(base, Lafortune) else (0.9, 0.1, 1e-3):
            mine = albedo(Row(model, "none", 0, cos_theta), 1)
            other = make_golden.albedo(Spec.parse(model), cos_theta, 0.0, 1)
            gap = abs(float(mine / other - 1))
            print(f", a({cos_theta:g}) {gap:.1g}", end="", flush=True)
            assert gap < 1e-17, model
        print()


# ------------------------------------------------------------------------------------------------
# The table
# ------------------------------------------------------------------------------------------------

GGX = "cook_torrance:m=0.3,distribution=ggx,geometry=smith_correlated"
COSINES = (0.9, 0.5, 0.1, 1e-3)
# Of some models, because it takes minutes.
GRAZING = 1e-6
# Towards the light, and off the mirror direction.
RETRO = "lafortune:lobes=((0.9,0.9,0.9,10))"
LEANING = "lafortune:lobes=((-0.9,-0.9,0.6,5))"


def table() -> Iterator[Row]:
    """The wanted rows."""
    yield from _grid("phong:n=20", ("none", "cumulative"), (*COSINES, GRAZING))
    yield from _grid("phong:n=2", ("none", "cumulative"))
    yield from _grid("blinn:n=20", CONTROLS, (*COSINES, GRAZING))
    yield from _grid("ward:m=0.4", ("none",), (*COSINES, GRAZING))
    yield from _grid("ward:m=0.4", CONTROLS[1:])
    yield from _grid("oren_nayar:sigma=0.3", CONTROLS)
    yield from _grid("max_phong:n=20", CONTROLS)
    yield from _grid(GGX, CONTROLS)
    for cos_theta in COSINES:
        yield Row(RETRO, "none", 1, cos_theta)
        yield Row(LEANING, "none", 1, cos_theta)
        yield Row(LEANING, "cumulative", 1, cos_theta)


def _grid(
    model: str, controls: tuple[str, ...], cosines: tuple[float, ...] = COSINES
) -> Iterator[Row]:
    """One and two steps, all cosines."""
    for control in controls:
        for steps in (1, 2):
            for cos_theta in cosines:
                yield Row(model, control, steps, cos_theta)


def key(row: Row) -> tuple[str, str, str, str]:
    """How a row is recognised in the file."""
    return row.model, row.control, str(row.steps), repr(row.cos_theta)


def key_in_file(row: dict[str, str]) -> tuple[str, str, str, str]:
    """The same of a row of the file."""
    return row["model"], row["control"], row["steps"], row["cos_theta"]


def write_rows(path: Path, rows: list[dict[str, str]]) -> None:
    """A file with these rows, put in place in one step."""
    fresh = path.with_suffix(".tmp")
    with fresh.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    fresh.replace(path)


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = argparse.ArgumentParser(description="Write golden pumped-up albedos (see the file).")
    result.add_argument("--out", type=Path, default=HERE / "pumped.csv", help="the CSV file")
    result.add_argument("--only", default="", metavar="PATTERN", help="regular expression on model")
    result.add_argument("--force", action="store_true", help="recompute rows already there")
    result.add_argument("--list", action="store_true", help="print the wanted rows and stop")
    result.add_argument("--check", action="store_true", help="test the formulas and stop")
    return result


def main(argv: list[str] | None = None) -> int:
    """Compute what is missing."""
    args = parser().parse_args(argv)
    if args.check:
        check()
        return 0
    wanted = [row for row in dict.fromkeys(table()) if re.search(args.only, row.model)]
    if args.list:
        for row in wanted:
            print(*key(row))
        return 0
    names = {key(row) for row in wanted}
    kept = make_golden.read_rows(args.out)
    if args.force:
        kept = [old for old in kept if key_in_file(old) not in names]
    known = {key_in_file(old) for old in kept}
    weak = 0
    begin = time.perf_counter()
    if args.force or not args.out.exists():
        write_rows(args.out, kept)
    with args.out.open("a", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        for row in wanted:
            if key(row) in known:
                continue
            began = time.perf_counter()
            golden = compute(row)
            print(*key(row), *golden, f"{time.perf_counter() - began:.1f} s", flush=True)
            if golden.digits < MIN_DIGITS:
                weak += 1
                print("  fewer digits than wanted: row left out", file=sys.stderr, flush=True)
                continue
            writer.writerow((*key(row), golden.value, golden.digits))
            stream.flush()
    place = {key(row): i for i, row in enumerate(table())}
    rows = make_golden.read_rows(args.out)
    rows.sort(key=lambda row: place.get(key_in_file(row), len(place)))
    write_rows(args.out, rows)  # in the order of the table
    print(f"{time.perf_counter() - begin:.0f} s, {weak} rows left out")
    return 1 if weak else 0


if __name__ == "__main__":
    sys.exit(main())
