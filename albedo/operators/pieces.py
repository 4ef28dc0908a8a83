"""Pieces of curves: the points at which an albedo is computed, and the series through them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.polynomial import chebyshev

from albedo.charts.heights import folded
from albedo.operators.divisor import placed, straight
from albedo.operators.nodes import FEWEST, LEBESGUE, MOST, TRUST, cosines, places

# Gaps between the nodes of a piece, but where it is narrow.
_USUAL = 8
FRESH = {4: 4, 6: 4, 8: 4, 12: 6, 16: 8}
"""Gaps between nodes that were there already, and how many fresh points confirm them."""
_NARROW = 5e-3
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
        x = straight(np.clip(folded(cosines(y)), low, high), low, high, bent)
        # Those that tell most that the ones before do not, first of all the ends.
        rest = chebyshev.chebvander(x, gaps)
        nodes = [int(np.argmin(y)), int(np.argmax(y))]
        for k in range(gaps + 1):
            if k >= len(nodes):
                nodes.append(int(np.argmax((rest * rest).sum(1))))
            own = rest[nodes[k]]
            size = float(own @ own)
            # What is told already leaves nothing but rounding.
            if size < 1e-16:
                return None
            rest = rest - np.outer(rest @ own, own / size)
        # Fresh points stand where interpolants err most.
        fresh: list[int] = []
        size = np.abs(x[:, None] - x[nodes]).prod(1)
        for _ in range(FRESH[gaps]):
            fresh.append(int(np.argmax(size)))
            size = size * np.abs(x - x[fresh[-1]])
        found = cls(low, high, bent, gaps, y[nodes + fresh])
        return found if found.worse <= _WORSE else None

    def refined(self) -> Piece:
        """With the next larger usual number of gaps, on nodes of Chebyshev."""
        return replace(self, gaps=_USUAL if self.gaps < _USUAL else MOST, chosen=None)

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
        at = np.cos(np.pi * np.arange(_LOOKS * self.gaps + 1) / (_LOOKS * self.gaps))
        amplified = np.abs(chebyshev.chebvander(at, self.gaps) @ self.to_series).sum(1).max()
        x = self.basis[:, 1]
        nodes = x[: self.gaps + 1]
        largest = np.abs(at[:, None] - nodes).prod(1).max()
        seen = np.abs(x[self.gaps + 1 :, None] - nodes).prod(1).max()
        return max(1.0, float(amplified) / LEBESGUE, float(largest / seen))

    @property
    def may_have_fewer(self) -> bool:
        """Whether every second of its nodes may do."""
        return self.chosen is None and self.gaps > FEWEST


def bound_of(missed: np.ndarray, noise: np.ndarray, worse: float | np.ndarray) -> np.ndarray:
    """Bounds on errors of series that missed so much at fresh points, and have so much noise.

    See `Piece.worse`.
    """
    return worse * (TRUST * missed + LEBESGUE * noise)
