"""Pieces of curves: the points at which an albedo is computed, and the series through them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np

from albedo._compile import kernel
from albedo.charts.heights import folded
from albedo.operators.divisor import basis_of, placed
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
    """

    low: float
    high: float
    bent: int
    gaps: int
    chosen: np.ndarray | None = None

    @classmethod
    def new(cls, low: float, high: float, bent: int) -> Piece:
        """A piece of which nothing is known yet."""
        return cls(low, high, bent, FEWEST if high - low < _NARROW else _USUAL)

    @classmethod
    def among(cls, low: float, high: float, bent: int, gaps: int, y: np.ndarray) -> Piece | None:
        """A piece whose points are some of many, the ends among them; None where they do not do."""
        chosen = np.empty(gaps + 1 + FRESH[gaps], dtype=int)
        chosen[:2] = np.argmin(y), np.argmax(y)
        basis = cls(low, high, bent, gaps).polynomials(y)
        if not _choose(basis[:, 1].copy(), basis, chosen):
            return None
        found = cls(low, high, bent, gaps, y[chosen])
        return found if found.worse <= _WORSE else None

    def refined(self) -> Piece:
        """With the next larger usual number of gaps, on nodes of Chebyshev."""
        return replace(self, gaps=_USUAL if self.gaps < _USUAL else MOST, chosen=None)

    @cached_property
    def halved(self) -> Piece:
        """With every second of its nodes."""
        return replace(self, gaps=self.gaps // 2)

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
        return _polynomials(y, self.low, self.high, self.bent, self.gaps)

    def left_out(self, series: np.ndarray, part: Piece) -> float:
        """What the gaps of another piece leave out of a series of this one, which holds that."""
        y = replace(part, gaps=MOST, chosen=None).y[: MOST + 1]
        y = np.clip(y, self.low, self.high)
        value = basis_of(y, self.low, self.high, self.bent, series.size) @ series
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
        return TRUST if self.chosen is None else _TRUST

    @property
    def may_have_fewer(self) -> bool:
        """Whether every second of its nodes may do."""
        return self.chosen is None and self.gaps > FEWEST


def _polynomials(
    y: np.ndarray,
    low: float | np.ndarray,
    high: float | np.ndarray,
    bent: int | np.ndarray,
    gaps: int,
) -> np.ndarray:
    # Cosines are rounded: near 1 they stand for another angle.
    y = np.clip(folded(cosines(y)), low, high)
    return basis_of(y, low, high, bent, gaps + 1)


def matrices_of(pieces: list[Piece]) -> tuple[np.ndarray, np.ndarray]:
    """`Piece.basis` and `Piece.to_series` of pieces with as many nodes and fresh points, stacked.

    What no piece was asked for before is computed for all at once, and each keeps its own.
    """
    fresh = [piece for piece in pieces if "to_series" not in vars(piece)]
    if fresh:
        ends = np.array([(piece.low, piece.high, piece.bent) for piece in fresh])
        low, high, bent = ends.T[:, :, None]
        bases = _polynomials(np.stack([p.y for p in fresh]), low, high, bent, fresh[0].gaps)
        inverses = np.linalg.inv(bases[:, : fresh[0].gaps + 1])
        for piece, basis, inverse in zip(fresh, bases, inverses, strict=True):
            vars(piece).update(basis=basis, to_series=inverse)
    return np.stack([piece.basis for piece in pieces]), np.stack([p.to_series for p in pieces])


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


@cache
def _to_all() -> np.ndarray:
    """The matrix from values at the most nodes to coefficients."""
    at = placed(places(MOST)[: MOST + 1], 0)
    found: np.ndarray = np.linalg.inv(basis_of(at, 0.0, 1.0, 0, MOST + 1))
    return found


def bound_of(
    missed: np.ndarray, noise: np.ndarray, trust: float | np.ndarray, worse: float | np.ndarray
) -> np.ndarray:
    """Bounds on errors of series that missed so much at fresh points, and have so much noise.

    See `Piece.trust` and `Piece.worse`.
    """
    return worse * (trust * missed + LEBESGUE * noise)
