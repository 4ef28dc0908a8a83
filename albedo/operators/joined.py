"""Curves on as few pieces as hold them.

Where an albedo is computed, pieces are cut at all places where it may bend. Most of these bends are
too weak to be seen, and what reads a curve is spared them: neighbours are joined where one series
does for both, and ends that hardly bend are ends like others.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import chebyshev

from albedo.operators.divisor import TERMS, LogCurve, basis_of, placed

_NODES = chebyshev.chebpts2(TERMS)
_TO_SERIES = np.linalg.inv(chebyshev.chebvander(_NODES, TERMS - 1)).T
# Every piece is looked at in so many places, between which a series may be off twice as much.
_LOOKS = np.sin(0.5 * np.pi * (np.arange(8) + 0.5) / 8.0) ** 2
_BETWEEN = 2.0
# About ends that are no marks a curve is looked at within so much of the shorter neighbour, but not
# nearer than that, and bends where it is off so many times more than is allowed.
_LESS, _WIDE, _PLAIN = 0.125, 0.004, 20.0
# Where a bend shows that is in the middle of a series.
_ABOUT = chebyshev.chebpts1(40)


@dataclass
class _Groups:
    """Runs of pieces, each with the series that stands for it.

    Attributes
    ----------
    first, last : ndarray of int, shape (m,)
        Its first piece, and the one after its last.
    bent, series, off : ndarray, shape (m,), (m, 18), (m,)
        See `LogCurve`, and what the series is off in the places that are looked at.
    """

    first: np.ndarray
    last: np.ndarray
    bent: np.ndarray
    series: np.ndarray
    off: np.ndarray

    def take(self, at: np.ndarray, other: _Groups) -> None:
        """Put others in the places of some."""
        for name, array in vars(self).items():
            array[at] = getattr(other, name)

    def some(self, which: np.ndarray) -> _Groups:
        return _Groups(**{name: array[which] for name, array in vars(self).items()})


class _Joints:
    """What is known of a curve whose pieces are joined."""

    def __init__(self, curve: LogCurve) -> None:
        self.curve = curve
        low, high = curve.edges[:-1, None], curve.edges[1:, None]
        self._y = low + placed(_LOOKS, curve.bent[:, None]) * (high - low)
        self._value = curve.at(self._y)

    def fitted(self, first: np.ndarray, last: np.ndarray, bent: np.ndarray) -> _Groups:
        """Groups of pieces, with series on each."""
        edges = self.curve.edges
        low, high = edges[first], edges[last]
        share = placed(0.5 * (_NODES + 1.0), bent[:, None])
        # Neighbours are the same at their ends.
        y = np.where(share == 1.0, high[:, None], low[:, None] + share * (high - low)[:, None])
        series = self.curve.at(y) @ _TO_SERIES
        count = last - first
        begin = np.cumsum(count) - count
        group = np.repeat(np.arange(first.size), count)
        piece = np.arange(group.size) + (first - begin)[group]
        known = low[group, None], high[group, None], bent[group, None]
        basis = basis_of(self._y[piece], *known, TERMS)
        missed = np.abs((basis @ series[group, :, None])[:, :, 0] - self._value[piece]).max(1)
        return _Groups(first, last, bent, series, np.maximum.reduceat(missed, begin))


def joined(curve: LogCurve, allowed: float, marks: np.ndarray) -> LogCurve:
    """A curve on fewer pieces.

    Parameters
    ----------
    curve : LogCurve
    allowed : float
        What the one may differ from the other by.
    marks : ndarray
        Coordinates at which it may bend.

    Returns
    -------
    LogCurve
        Its pieces are whole ones of the curve, and its errors cover what it differs by. It is said
        to bend at those marks at which no series holds it, and at other ends of pieces where a kink
        is seen about them.
    """
    joints, allowed = _Joints(curve), allowed / _BETWEEN
    number = np.arange(curve.error.size)
    groups = _Groups(
        number, number + 1, curve.bent.copy(), curve.coefficients.copy(), np.zeros(number.size)
    )
    bent = np.flatnonzero(groups.bent)
    if bent.size:
        even = joints.fitted(bent, bent + 1, np.zeros_like(bent))
        does = even.off <= allowed
        groups.take(bent[does], even.some(does))
    # Pairs that begin with an even number, and those that begin with an odd one, in turn.
    side, idle = 0, 0
    while idle < 2:
        pairs = np.arange(side, groups.first.size - 1, 2)
        side, gone = 1 - side, np.zeros(groups.first.size, dtype=bool)
        for which, kind in _ways(groups, pairs):
            open_ = which[~gone[which + 1]]
            if open_.size == 0:
                continue
            first, last = groups.first[open_], groups.last[open_ + 1]
            pair = joints.fitted(first, last, np.full(open_.size, kind))
            does = pair.off <= allowed
            groups.take(open_[does], pair.some(does))
            gone[open_[does] + 1] = True
        idle = 0 if gone.any() else idle + 1
        groups = groups.some(~gone)
    edges = curve.edges[np.append(groups.first, number.size)]
    error = np.maximum.reduceat(curve.error, groups.first) + _BETWEEN * groups.off
    found = LogCurve(edges, groups.series, error, groups.bent)
    bent_there = replace(found, bends=_bends(found, allowed, marks))
    # What is read of it does not depend on where it bends.
    vars(bent_there).update(polynomials=found.polynomials, pieces=found.pieces)
    return bent_there


def _bends(curve: LogCurve, allowed: float, marks: np.ndarray) -> np.ndarray:
    """Ends of pieces about which no series holds a curve.

    Those that are no marks may be there because it is none of few terms: they have to bend within
    less, and next to the first and last end of a curve none is told.
    """
    y, size = curve.edges[1:-1], np.diff(curve.edges)
    marked, least = np.isin(y, marks), np.minimum(size[1:], size[:-1])
    reach = np.where(marked, least, np.maximum(_LESS * least, _WIDE))
    near = y[:, None] + reach[:, None] * np.append(_NODES, _ABOUT)
    value = curve.at(np.clip(near, curve.edges[0], curve.edges[-1]))
    series = value[:, :TERMS] @ _TO_SERIES
    missed = np.abs(series @ chebyshev.chebvander(_ABOUT, TERMS - 1).T - value[:, TERMS:]).max(1)
    inside = (y - reach >= curve.edges[0]) & (y + reach <= curve.edges[-1])
    return y[(missed > np.where(marked, 1.0, _PLAIN) * allowed) & (marked | inside)]


def _ways(groups: _Groups, pairs: np.ndarray) -> Iterator[tuple[np.ndarray, int]]:
    """Pairs of neighbours, and how they may be bent as one: as little as will do."""
    yield pairs, 0
    yield pairs[groups.bent[pairs] == 1], 1
    yield pairs[groups.bent[pairs + 1] == 2], 2
