"""Gauss-Legendre rules on [0, 1] that report the error of their own value.

A rule of p nodes gives the integral and the first p Legendre coefficients of its integrand.
For an integrand that is analytic on the cell the coefficients a_k fall geometrically and the
error of the Gauss rule is the sum of its aliases, coefficients of index 2p and more
(Trefethen, *Is Gauss quadrature better than Clenshaw-Curtis?*, SIAM Review 50, 2008). The bound
extrapolates the fall that was observed over the upper half of the spectrum, less steeply than
geometric decay allows, so that algebraic decay (a kink that was not split) is covered as well.

What goes around a ring, and is even about both ends of half of it, has the midpoint rule: p nodes
give the mean and the first p coefficients of the cosine series, and aliases begin at 2p as well
(Trefethen and Weideman, *The exponentially convergent trapezoidal rule*, SIAM Review 56, 2014).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np

from albedo._compile import kernel

LADDER = (2, 3, 4, 5, 6, 8, 10, 12, 14, 16, 20, 24, 28, 32)
"""Numbers of nodes that cells may use."""
RUNGS = (*LADDER, 36, 40, 44, 48, 52, 56, 60, 64)
"""Numbers of nodes around whole rings."""
AROUND = {"smooth": 5.0, "entire": 10.0}
"""The most e-folds that are claimed beyond the last coefficients of whole rings.

Of a million spectra of real rings, of 8 nodes or more, none passed its bound by more than 1e-13 of
the ring. With eight e-folds 1 of 200 smooth ones did, by up to five times; with twelve the worst of
500,000 entire ones came to 0.9 of its bound, with sixteen to seven times.
"""

# A bound is safety * tail * exp(-fall over the next octave). Stopping as soon as a bound is small
# selects the spectra that happen to look good, so the bound that stops a refinement is the wider
# one; a result that no bound has selected (the budget ran out) reports the other. Both were chosen
# on 33,000 spectra of real cells: errors pass the wider bound in 1 of 10,000, the other in 8.
# Columns: safety, coefficients in the tail window, straightness, share of the rate that is trusted,
# and the most e-folds that are claimed beyond the last coefficients.
_STOPPING = (6.0, 4, 0.8, 0.6, 5.0)
_REPORTED = (1.5, 4, 0.8, 0.8, 6.0)
# Eight coefficients tell less of a rate.
_SHORT, _SHORT_SAFETY = 8, 3.0
_SHALLOW, _STEEP = 1.0, 1.5
# From so many coefficients on entire series are told from others.
_MANY = 16
# Cosine series of p nodes fall by so much per coefficient at least, times p: what is narrower than
# a fourth of a step may be anywhere. Coefficients below so many roundings of the largest are noise.
_FLATTEST, _NOISE = 0.25, 8.0 * float(np.finfo(np.float64).eps)


@dataclass(frozen=True)
class Rule:
    """A rule on [0, 1].

    Attributes
    ----------
    nodes, weights : ndarray, shape (p,)
        Nodes in (0, 1), and weights that sum to 1.
    to_coefficients : ndarray, shape (p, p)
        ``values @ to_coefficients`` are the coefficients of the shifted Legendre polynomials, or
        of the cosines of k pi x; the first one is the integral.
    """

    nodes: np.ndarray
    weights: np.ndarray
    to_coefficients: np.ndarray


@cache
def gauss(p: int) -> Rule:
    """The Gauss-Legendre rule of `p` nodes on [0, 1]."""
    x, w = np.polynomial.legendre.leggauss(p)
    polynomials = np.polynomial.legendre.legvander(x, p - 1)
    scaled = polynomials * (w[:, None] / 2) * (2 * np.arange(p) + 1)
    return Rule((x + 1) / 2, w / 2, scaled)


@cache
def midpoint(p: int) -> Rule:
    """The midpoint rule of `p` nodes on [0, 1], for what is even about both ends."""
    x = (np.arange(p) + 0.5) / p
    scaled = 2.0 / p * np.cos(math.pi * np.arange(p) * x[:, None])
    scaled[:, 0] = 1.0 / p
    return Rule(x, np.full(p, 1.0 / p), scaled)


@kernel
def _largest(a, first, last):
    """Largest modulus in a[first:last]."""
    top = 0.0
    for k in range(max(first, 0), last):
        top = max(top, abs(a[k]))
    return top


@kernel
def _extrapolate(a, safety, wide, straight, reach, farthest):
    """Bound on the aliases of index 2p and more."""
    p = a.size
    window = wide if p > _SHORT else 3
    tail = _largest(a, p - window, p)
    if tail == 0.0:
        return 0.0
    if not math.isfinite(tail):
        return math.inf
    start = p // 2 - 2
    middle = max(_largest(a, start, p), tail)
    head = max(_largest(a, p // 4 - 1, p), middle)
    fall = math.log(middle / tail)
    rate = fall / max(p - window - start, 1)
    # Per octave an algebraic spectrum falls by a constant factor, a geometric one by its square.
    octave = _SHALLOW * fall
    if head > middle:
        octave = min(max(0.75 * fall / math.log(head / middle), _SHALLOW), _STEEP) * fall
    # A smooth part can hide an algebraic one until the last coefficients: follow their slope too.
    last = _largest(a, p - 2, p)
    local = rate
    if last > 0.0:
        for shift in (2, max(2, p // 4)):
            drop = math.log(max(_largest(a, p - 2 - shift, p), last) / last)
            local = min(local, drop / shift)
            octave = min(octave, math.log(2.0) / math.log(p / (p - shift)) * drop)
    if local > straight * rate:
        octave = reach * p * local
    # Never claim more digits beyond the last coefficients than this.
    octave = min(octave, farthest)
    if p <= _SHORT:
        safety *= _SHORT_SAFETY
    return safety * tail * math.exp(-octave)


@kernel
def stopping_bound(a):
    """The first of `bounds_of`."""
    p = a.size
    if p < 6:
        # Too short a spectrum to see a rate: everything but the mean may be aliased.
        total = 0.25 * abs(a[0])
        for k in range(1, p):
            total += 6.0 * abs(a[k])
        return total
    return _extrapolate(a, *_STOPPING)


@kernel
def bounds_of(a):
    """Bounds on the quadrature error, from the Legendre coefficients of the integrand.

    Parameters
    ----------
    a : ndarray, shape (p,)
        Coefficients that a rule of p nodes gave; the first is the integral.

    Returns
    -------
    stop, report : float
        Bounds on the error of a[0]: the one to stop on, and the one to report when nothing was
        stopped on it. Never negative.
    """
    p, stop = a.size, stopping_bound(a)
    if p < 6:
        return stop, stop
    # Six coefficients cannot tell a root at the end from a smooth integrand: no steeper fall.
    return stop, 0.5 * stop if p < _SHORT else min(_extrapolate(a, *_REPORTED), stop)


@kernel
def _last_of_largest(a, first, last):
    """Where the last of the largest moduli in a[first:last] stands."""
    place = last - 1
    for k in range(last - 1, max(first, 0) - 1, -1):
        if abs(a[k]) > abs(a[place]):
            place = k
    return place


@kernel
def _rate(drop, n, m, least):
    """The r, `least` or more, of which ln(sinh(r n)/sinh(r m)) is the drop, for n > m > 0."""
    if not drop > math.log(math.sinh(least * n) / math.sinh(least * m)):
        return least
    # From above, where the function is convex: Newton's method does not overshoot.
    r = drop / (n - m)
    for _ in range(8):
        far, near = -math.expm1(-2.0 * r * n), -math.expm1(-2.0 * r * m)
        excess = r * (n - m) + math.log(far / near) - drop
        slope = n * (2.0 / far - 1.0) - m * (2.0 / near - 1.0)
        step = excess / slope
        r -= step
        if step <= 0.01 * r:
            break
    return max(r, least)


@kernel
def bounds_around(a, farthest, lifted):
    """As `bounds_of`, from coefficients of cosines, of what has its peaks at the ends.

    Of a series that falls by r each time, p nodes see the coefficient k with its first alias,
    2p - k. Of a peak at an end, which no node hits, they cancel as sinh(r (p - k)) does towards
    k = p: the last coefficients look smaller than they are, and their fall steeper. Both are
    undone. A peak elsewhere may stand so between two nodes that they cancel further.

    Parameters
    ----------
    a : ndarray, shape (p,)
    farthest : float
        Of `AROUND`.
    lifted : ndarray, shape (p,)
        Overwritten.
    """
    p = a.size
    if p < 6:
        stop = stopping_bound(a)
        return stop, stop
    # The least of the falls that `_extrapolate` looks at.
    last = _last_of_largest(a, p - 2, p)
    tail = _last_of_largest(a, p - (_STOPPING[1] if p > _SHORT else 3), p)
    rate = math.inf
    for end, first in ((tail, p // 2 - 2), (last, p - 2 - max(2, p // 4))):
        start = _last_of_largest(a, first, p)
        if a[end] != 0.0:
            drop = math.log(abs(a[start] / a[end]))
            rate = min(rate, _rate(drop, float(p - start), float(p - end), _FLATTEST / p))
    if not rate < math.inf:
        rate = 1.0
    noise = _NOISE * _largest(a, 0, p)
    lifted[0] = a[0]
    for k in range(1, p):
        lifted[k] = a[k]
        if abs(a[k]) > noise:
            lifted[k] /= -math.expm1(-2.0 * rate * (p - k))
    if p < _MANY:
        farthest = min(farthest, _STOPPING[4])
    more = -1.0 / math.expm1(-2.0 * rate * p)
    stop = more * _extrapolate(lifted[:p], *_STOPPING[:4], farthest)
    if p < _SHORT:
        return stop, 0.5 * stop
    return stop, min(more * _extrapolate(lifted[:p], *_REPORTED), stop)
