"""Pieces of curves: the points at which an albedo is computed, and the series through them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
from numpy.polynomial import chebyshev

from albedo._compile import kernel
from albedo.charts.heights import folded
from albedo.operators.divisor import placed, straight
from albedo.operators.nodes import FEWEST, LEBESGUE, MOST, TRUST, cosines, places

# Gaps between the nodes of a piece, but where it is narrow.
_USUAL = 8
FRESH = {4: 4, 6: 6, 8: 8, 12: 12, 16: 16}
"""Gaps between nodes that were there already, and how many fresh points confirm them."""
# So there is one in each gap on the average, where a corner shows half of its height at least: what
# that hides is no more than a fresh point in every second gap does.
_TRUST = 4.0
_NARROW = 5e-3
# What is not longer has no clustered nodes: down to y = -44 some would be the same number.
_TOO_SHORT = 1e-8
# Points that were there already are taken where interpolation is this many times worse, at most.
_WORSE = 2.0
# How near they come to what they stand for, over the gaps: no more than a quarter of a gap, so that
# none stands for two.
_REACHES = (0.124 * math.pi, 0.062 * math.pi)
# Where that is looked at, for each gap.
_LOOKS = 8


@dataclass(frozen=True, eq=False)
class Piece:
    """One piece of all curves from now on.

    Attributes
    ----------
    low, high : float
        Its ends in y.
    bent : int
        See `LogCurve`.
    gaps : int
        One less than there are nodes.
    chosen : ndarray, optional
        What `y` is; by default the nodes are those of Chebyshev.
    near : bool
        Whether what is chosen stands for the points by default, one for one.
    """

    low: float
    high: float
    bent: int
    gaps: int
    chosen: np.ndarray | None = None
    near: bool = False

    @classmethod
    def new(cls, low: float, high: float, bent: int) -> Piece:
        """A piece of which nothing is known yet."""
        return cls(low, high, bent, FEWEST if high - low < _NARROW else _USUAL)

    @classmethod
    def among(cls, low: float, high: float, bent: int, gaps: int, y: np.ndarray) -> Piece | None:
        """A piece whose points are some of many, the ends among them; None where they do not do."""
        x = straight(np.clip(folded(cosines(y)), low, high), low, high, bent)
        chosen = np.empty(gaps + 1 + FRESH[gaps], dtype=int)
        chosen[:2] = np.argmin(y), np.argmax(y)
        if not _choose(x, chebyshev.chebvander(x, gaps), chosen):
            return None
        found = cls(low, high, bent, gaps, y[chosen])
        return found if found.worse <= _WORSE else None

    def refined(self) -> Piece:
        """With the next larger usual number of gaps, on nodes of Chebyshev."""
        gaps = _USUAL if self.gaps < _USUAL else MOST
        return replace(self, gaps=gaps, chosen=None, near=False)

    def near_known(self, known: np.ndarray) -> Piece:
        """The same where points that are there already, ascending, stand for those near to them.

        Both ends stay, and all points where interpolation would be too much worse.
        """
        first = np.searchsorted(known, self.low, side="right")
        inside = known[first : np.searchsorted(known, self.high)]
        if inside.size == 0:
            return self
        wanted = places(self.gaps)
        there = 0.5 * (straight(inside, self.low, self.high, self.bent) + 1.0)
        for reach in _REACHES:
            stand_in = np.empty(wanted.size, dtype=int)
            if not _stand_ins(_angles(there), _angles(wanted), reach / self.gaps, stand_in):
                return self
            taken = stand_in >= 0
            x = 2.0 * np.where(taken, there[stand_in], wanted) - 1.0
            if _worse(x, self.gaps) <= _WORSE:
                chosen = np.where(taken, inside[stand_in], self.y)
                return replace(self, chosen=chosen, near=True)
        return self

    @cached_property
    def halved(self) -> Piece:
        """With every second of its nodes."""
        gaps = self.gaps // 2
        chosen = None if self.chosen is None else self.chosen[_halved(gaps)]
        return replace(self, gaps=gaps, chosen=chosen)

    @cached_property
    def y(self) -> np.ndarray:
        """Coordinates of its nodes and of its fresh points."""
        if self.chosen is not None:
            return self.chosen
        t = placed(places(self.gaps), self.bent)
        # Neighbours share the rows at their ends, which are the same number to both.
        return np.where(t == 1.0, self.high, self.low + t * (self.high - self.low))

    def polynomials(self, y: np.ndarray) -> np.ndarray:
        """The polynomials of its series at some coordinates."""
        # Cosines are rounded: near 1 they stand for another angle.
        y = np.clip(folded(cosines(y)), self.low, self.high)
        return chebyshev.chebvander(straight(y, self.low, self.high, self.bent), self.gaps)

    def left_out(self, series: np.ndarray, part: Piece) -> float:
        """What the gaps of another piece leave out of a series of this one, which holds that."""
        y = replace(part, gaps=MOST, chosen=None).y[: MOST + 1]
        x = straight(np.clip(y, self.low, self.high), self.low, self.high, self.bent)
        value = chebyshev.chebvander(x, series.size - 1) @ series
        # Chebyshev's nodes with both ends, from the lower one on.
        own = _to_all() @ value
        return float(np.abs(own[part.gaps + 1 :]).sum())

    @cached_property
    def basis(self) -> np.ndarray:
        """The polynomials of its series at its nodes and fresh points."""
        return self.polynomials(self.y)

    @cached_property
    def to_series(self) -> np.ndarray:
        """The matrix from values at its nodes to coefficients."""
        return np.linalg.inv(self.basis[: self.gaps + 1])

    @cached_property
    def worse(self) -> float:
        """How many times more errors may be than with the nodes of Chebyshev."""
        if self.chosen is None:
            return 1.0
        return float(_worse(self.basis[:, 1], self.gaps))

    @property
    def trust(self) -> float:
        """How many times what is missed at its fresh points errors may be between its nodes."""
        return TRUST if self.chosen is None or self.near else _TRUST

    @property
    def may_have_fewer(self) -> bool:
        """Whether every second of its nodes may do."""
        return (self.chosen is None or self.near) and self.gaps > FEWEST


def between(low: float, high: float, first: bool, last: bool) -> list[Piece]:
    """Pieces between two places, of which the first, or the last, may bend the curve.

    Ends that bend have the clustered nodes; between two of them there are two pieces.
    """
    if high - low < 2.0 * _TOO_SHORT:
        # Over so little |x|^(3/2) is 3e-12, and fresh points tell if that is too much.
        return [Piece.new(low, high, 0)]
    if first and last:
        middle = 0.5 * (low + high)
        return [Piece.new(low, middle, 1), Piece.new(middle, high, 2)]
    return [Piece.new(low, high, 1 if first else 2 if last else 0)]


@kernel
def _choose(x, rest, chosen):
    """Fill points of a piece, of which the first two are its ends; whether there are enough.

    Nodes are those that tell most that the ones before do not: `rest` has the polynomials at x.
    Fresh points, which follow, stand where interpolants err most.
    """
    count, terms = rest.shape
    size = np.empty(count)
    for k in range(terms):
        if k > 1:
            for i in range(count):
                size[i] = 0.0
                for m in range(terms):
                    size[i] += rest[i, m] * rest[i, m]
            chosen[k] = np.argmax(size)
        own, whole = rest[chosen[k]].copy(), 0.0
        for m in range(terms):
            whole += own[m] * own[m]
        # What is told already leaves nothing but rounding.
        if whole < 1e-16:
            return False
        for i in range(count):
            share = 0.0
            for m in range(terms):
                share += rest[i, m] * own[m]
            share /= whole
            for m in range(terms):
                rest[i, m] -= share * own[m]
    size[:] = 1.0
    for k in range(chosen.size):
        if k >= terms:
            chosen[k] = np.argmax(size)
        for i in range(count):
            size[i] *= abs(x[i] - x[chosen[k]])
    return True


@kernel
def _worse(x, gaps):
    """See `Piece.worse`; x has the nodes of a series, from -1 to 1, and then its fresh points."""
    weight = np.ones(gaps + 1)
    for j in range(gaps + 1):
        for k in range(gaps + 1):
            if k != j:
                weight[j] /= x[j] - x[k]
    amplified, largest, seen = 1.0, 0.0, 0.0
    for i in range(_LOOKS * gaps + 1):
        at = math.cos(math.pi * i / (_LOOKS * gaps))
        product, total = 1.0, 0.0
        for j in range(gaps + 1):
            product *= at - x[j]
        if product != 0.0:
            for j in range(gaps + 1):
                total += abs(product * weight[j] / (at - x[j]))
        amplified, largest = max(amplified, total), max(largest, abs(product))
    for i in range(gaps + 1, x.size):
        product = 1.0
        for j in range(gaps + 1):
            product *= x[i] - x[j]
        seen = max(seen, abs(product))
    return max(1.0, amplified / LEBESGUE, largest / seen) if seen > 0.0 else math.inf


@kernel
def _stand_ins(there, wanted, reach, found):
    """Fill which of the angles that are there, ascending, stand for those that are wanted, the ends
    but for: -1 for none. Whether there was one."""
    some = False
    for i in range(wanted.size):
        found[i] = -1
        k = np.searchsorted(there, wanted[i])
        if k == there.size or (k > 0 and wanted[i] - there[k - 1] < there[k] - wanted[i]):
            k -= 1
        inside = 0.0 < wanted[i] < 0.5 * math.pi
        if inside and abs(there[k] - wanted[i]) <= reach:
            found[i] = k
            some = True
    return some


def _angles(place: np.ndarray) -> np.ndarray:
    """In which nodes of Chebyshev are even, from 0 to pi/2, for places from 0 to 1."""
    found: np.ndarray = np.arcsin(np.sqrt(np.clip(place, 0.0, 1.0)))
    return found


@cache
def _halved(gaps: int) -> np.ndarray:
    """Which of the points for twice as many gaps are those for some."""
    order = np.argsort(places(2 * gaps))
    found: np.ndarray = order[np.searchsorted(places(2 * gaps)[order], places(gaps))]
    return found


@cache
def _to_all() -> np.ndarray:
    """The matrix from values at the most nodes to coefficients."""
    at = straight(placed(places(MOST)[: MOST + 1], 0), 0.0, 1.0, 0)
    found: np.ndarray = np.linalg.inv(chebyshev.chebvander(at, MOST))
    return found


def bound_of(
    missed: np.ndarray, noise: np.ndarray, trust: float | np.ndarray, worse: float | np.ndarray
) -> np.ndarray:
    """Bounds on errors of series that missed so much at fresh points, and have so much noise.

    See `Piece.trust` and `Piece.worse`.
    """
    return worse * (trust * missed + LEBESGUE * noise)
