"""What pumping-up divides by: albedos as functions of the height, and where their maxima change.

A curve holds the logarithm of a directional albedo, so that products of albedos are sums and an
error is relative; it is a Chebyshev series on every piece of the coordinate y of
`albedo.charts.heights`, in which a power law of n.l is a line. Below its first height an albedo is
taken as it is there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property

import numpy as np
from numpy.polynomial import chebyshev

from albedo._compile import inlined, kernel
from albedo._threads import side_by_side
from albedo.charts.heights import (
    FIRST,
    LAST,
    LOWEST,
    fold_vector,
    folded,
    log_height,
    unfold,
    unfolded,
)
from albedo.operators.roots import next_share

TERMS = 18
"""Coefficients of a piece; the last ones are 0 where it has fewer."""
# Series are read as polynomials of few terms on even parts of their pieces, as many as it takes for
# all other terms to sum to no more than this share of the curve's error.
FEW, _LEFT_OUT = 8, 0.01
PARTS = (1, 2, 4, 8, 16, 32)
# Even cells of y, in which pieces are looked up; up to the first number they are wide.
_FAR, _FAR_CELLS, _CELLS = -4.0, 64, 1024
# Runs of nodes, and rows, that are worth another thread.
_FEW_RUNS, _FEW_ROWS, _FEW_CLAMPED = 300, 200, 20
# Places at which the product is the cosine that are followed as n.l changes.
_COURSES = 8
# Steps of bisection that tell where they change course.
_HALVINGS = 32
# Samples of a piece in the search for extrema.
_SAMPLES = 24
# Steps of bisection: float64 has no use for more.
_BISECTIONS = 60
# How near a place comes to that of a level, as a share of its coordinate.
_NEAR = 2.0 * np.finfo(np.float64).eps
# Golden sections in search of two places close together, and how near to 0 it must be for that, as
# a share of what a function changes by from one sample to the next.
_SECTIONS, _STEEP, _GOLDEN = 40, 0.5, 0.5 * (math.sqrt(5.0) - 1.0)

# What is told of a part, see `packed`.
_LOW, _HIGH, _BENT, _BASE, _CENTRE, _RATE, _TERMS = range(7)

CONTROLS = (None, "literal", "cumulative")
"""No control (NNS eq. 20); each step divides by max(a(L), a(V), n.l, n.v) (eq. 21 as it stands);
or the product of all divisors never falls below max(n.l, n.v)."""


def straight(
    y: np.ndarray, low: float | np.ndarray, high: float | np.ndarray, bent: int | np.ndarray
) -> np.ndarray:
    """The variable of a series, from -1 to 1, at coordinates y of a piece."""
    x, rest = (y - low) / (high - low), (high - y) / (high - low)
    x = np.where(bent == 1, np.sqrt(x), np.where(bent == 2, 1.0 - np.sqrt(rest), x))
    found: np.ndarray = 2.0 * x - 1.0
    return found


def basis_of(
    y: np.ndarray,
    low: float | np.ndarray,
    high: float | np.ndarray,
    bent: int | np.ndarray,
    terms: int,
) -> np.ndarray:
    """So many of Chebyshev's polynomials, two at least, of that variable: (..., terms)."""
    x = straight(y, low, high, bent)
    found = np.empty((x.size, terms))
    _fill_basis(x.ravel(), found)
    return found.reshape(*x.shape, terms)


@kernel
def _fill_basis(x, found):
    for i in range(x.size):
        found[i, 0], found[i, 1] = 1.0, x[i]
        for m in range(2, found.shape[1]):
            found[i, m] = 2.0 * x[i] * found[i, m - 1] - found[i, m - 2]


def placed(x: np.ndarray, bent: int | np.ndarray) -> np.ndarray:
    """Places on a piece, from 0 to 1, of which those of x are even in the variable of a series."""
    found: np.ndarray = np.where(bent == 1, x * x, np.where(bent == 2, x * (2.0 - x), x))
    return found


@inlined
def _cell(y):
    """Which of the cells of y holds a place; the first one for what is no number."""
    if y >= _FAR:
        return _FAR_CELLS + int((min(y, LAST) - _FAR) * (_CELLS / (LAST - _FAR)))
    return int((y - FIRST) * (_FAR_CELLS / (_FAR - FIRST))) if y > FIRST else 0


@inlined
def _part_of(y, parts, cells, j):
    """The part of curve j that holds y."""
    cell = _cell(y)
    low, high = cells[j, cell], cells[j, cell + 1] + 1
    while high - low > 1:
        middle = (low + high) // 2
        if parts[middle, _LOW] <= y:
            low = middle
        else:
            high = middle
    return low


@inlined
def _variable(y, i, parts):
    """The variable of part i at y."""
    y = min(max(y, parts[i, _LOW]), parts[i, _HIGH])
    if parts[i, _BENT] != 0.0:
        y = math.sqrt(abs(y - parts[i, _BASE]))
    return (y - parts[i, _CENTRE]) * parts[i, _RATE]


@inlined
def _polynomial(c_0, c_1, c_2, c_3, c_4, c_5, c_6, c_7, t):
    # Not one chain of products, in which each waits for the one before.
    square = t * t
    low = (c_0 + c_1 * t) + (c_2 + c_3 * t) * square
    high = (c_4 + c_5 * t) + (c_6 + c_7 * t) * square
    return low + high * (square * square)


@inlined
def _terms_of(i, parts):
    """The coefficients of part i."""
    c = parts[i, _TERMS:]
    return c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7]


@inlined
def curve_at(y, parts, cells, j):
    """The logarithm that curve j of packed ones holds at y."""
    i = _part_of(y, parts, cells, j)
    return _polynomial(*_terms_of(i, parts), _variable(y, i, parts))


@inlined
def is_below(low, high, goal, parts, cells, j, turns):
    """Whether curve j, whose turns are given, is known to be no more than a goal between two y."""
    turn = 1
    while turn < turns.size - 1 and turns[turn] <= low:
        turn += 1
    if turn < turns.size - 1 and turns[turn] < high:
        return False
    return max(curve_at(low, parts, cells, j), curve_at(high, parts, cells, j)) <= goal


@kernel
def curve_along(y, begin, end, parts, cells, j, out):
    """Fill what curve j holds at the nodes of one slice, whose y rise or fall, from `begin` on."""
    i = begin
    while i < end:
        part = _part_of(y[i], parts, cells, j)
        # The next nodes mostly lie in the same part, where nothing is looked up.
        stop, low, high = i + 1, parts[part, _LOW], parts[part, _HIGH]
        while stop < end and low <= y[stop] < high:
            stop += 1
        base, centre, rate = parts[part, _BASE], parts[part, _CENTRE], parts[part, _RATE]
        c_0, c_1, c_2, c_3, c_4, c_5, c_6, c_7 = _terms_of(part, parts)
        if parts[part, _BENT] != 0.0:
            for m in range(i, stop):
                t = (math.sqrt(abs(y[m] - base)) - centre) * rate
                out[m - begin] = _polynomial(c_0, c_1, c_2, c_3, c_4, c_5, c_6, c_7, t)
        else:
            for m in range(i, stop):
                t = (y[m] - centre) * rate
                out[m - begin] = _polynomial(c_0, c_1, c_2, c_3, c_4, c_5, c_6, c_7, t)
        i = stop


@kernel
def _rising(y, parts, cells, j):
    """Whether curve j grows with y, from the derivative of its polynomial."""
    i = _part_of(y, parts, cells, j)
    t = _variable(y, i, parts)
    slope = 0.0
    for k in range(FEW - 1, 0, -1):
        slope = slope * t + k * parts[i, _TERMS + k]
    return slope > 0.0


@kernel
def _turn_between(low, high, parts, cells):
    """The place between two others where a curve ceases to rise, or to fall."""
    before = _rising(low, parts, cells, 0)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        if _rising(middle, parts, cells, 0) == before:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@kernel
def _curve_all(y, parts, cells, out):
    for i in range(y.size):
        out[i] = curve_at(y[i], parts, cells, 0)


@kernel
def _curves_all(y, parts, cells, out):
    """Fill what all curves hold, a line for each y."""
    for i in range(y.size):
        for j in range(out.shape[1]):
            out[i, j] = curve_at(y[i], parts, cells, j)


@kernel
def spread(row, cell, y, share, lowest, at_l, parts, cells, matrix, own):
    """Add what is sent on from some heights in some rows to the cells of a curve that it is
    divided by.

    It is the cell of V, or that of L, with the value `at_l`, where that is larger: `own`; neither
    where both are below `lowest`.
    """
    for i in range(y.size):
        r = row[i]
        at_v = curve_at(y[i], parts, cells, 0)
        if max(at_v, at_l[r]) >= lowest[i]:
            if at_l[r] >= at_v:
                own[r] += share[i]
            else:
                matrix[r, cell[i]] += share[i]


@kernel
def _cells_all(y, out):
    for i in range(y.size):
        out[i] = _cell(y[i])


Pieces = tuple[np.ndarray, np.ndarray]
"""What kernels know of curves: see `packed`. They are handed its arrays one by one: numba counts
the references to those in a tuple each time that it is read."""


def packed(curves: Sequence[LogCurve]) -> Pieces:
    """All parts of the pieces of some curves, one after the other.

    Returns
    -------
    parts : ndarray, shape (all parts, 14)
        Both ends of each; where it is bent (not 0), from which base; centre, rate and coefficients:
        it is a polynomial of (x - centre) * rate, where x is y, or the root of the distance from
        its base where it is bent.
    cells : ndarray of int, shape (curves, cells + 2)
        The first part of each curve that may hold what lies in one of the cells of y.
    """
    if not curves:
        return np.zeros((1, _TERMS + FEW)), np.zeros((0, 1), np.int32)
    found = [curve.pieces for curve in curves]
    begin = np.cumsum([0] + [parts.shape[0] for parts, _ in found[:-1]])
    cells = np.concatenate([cells for _, cells in found]) + begin[:, None]
    return np.concatenate([parts for parts, _ in found]), cells.astype(np.int32)


def _packed_one(curve: LogCurve) -> Pieces:
    """What `packed` returns for one curve."""
    count = curve.polynomials.parts
    piece = np.repeat(np.arange(count.size), count)
    number, count = np.arange(piece.size) - (np.cumsum(count) - count)[piece], count[piece]
    low, high, bent = curve.edges[piece], curve.edges[piece + 1], curve.bent[piece]
    edges = np.append(low + placed(number / count, bent) * (high - low), curve.edges[-1])
    own = np.empty(piece.size, dtype=int)
    _cells_all(edges[:-1], own)
    cells = np.maximum(np.searchsorted(own, np.arange(_FAR_CELLS + _CELLS + 2)) - 1, 0)
    # From the end of a piece at which it is bent its parts are counted backwards.
    size, number = high - low, np.where(bent == 2, count - 1 - number, number)
    size = np.where(bent == 0, size, np.sqrt(size))
    base = np.where(bent == 2, high, low)
    centre = np.where(bent == 0, low, 0.0) + (number + 0.5) / count * size
    rate = np.where(bent == 2, -2.0, 2.0) * count / size
    columns = edges[:-1], edges[1:], bent, base, centre, rate, curve.polynomials.terms
    return np.column_stack(columns), cells.astype(np.int32)[None]


@dataclass(frozen=True, eq=False)
class Polynomials:
    """A curve on even parts of its pieces.

    Attributes
    ----------
    parts : ndarray of int, shape (m,)
        How many of every piece.
    terms : ndarray, shape (sum of parts, 8)
        Coefficients of the powers of variables from -1 to 1.
    left_out : ndarray, shape (m,)
        What the others sum to on a piece, at most.
    """

    parts: np.ndarray
    terms: np.ndarray
    left_out: np.ndarray

    @classmethod
    def of(cls, coefficients: np.ndarray, allowed: np.ndarray) -> Polynomials:
        """From Chebyshev coefficients (m, 18), and what may be left out of each piece (m,)."""
        m = allowed.size
        parts, left_out = np.ones(m, dtype=int), np.full(m, np.inf)
        blocks: list[np.ndarray] = [np.empty(0)] * m
        for count in PARTS:
            open_ = np.flatnonzero(left_out > allowed)
            kept, others = on_parts(count, TERMS)
            left_out[open_] = np.abs(coefficients[open_] @ others).sum(2).max(0, initial=0.0)
            parts[open_] = count
            for k in open_.tolist():
                blocks[k] = coefficients[k] @ kept
        return cls(parts, np.concatenate(blocks), left_out)


@cache
def on_parts(count: int, terms: int) -> tuple[np.ndarray, np.ndarray]:
    """Matrices from a Chebyshev series to even parts: powers, and what is not among them.

    Their shapes are (parts, terms, 8) and (parts, terms, terms - 8).
    """
    t = chebyshev.chebpts1(terms)
    to_series = np.linalg.inv(chebyshev.chebvander(t, terms - 1)).T
    powers = np.zeros((FEW, FEW))
    for k in range(FEW):
        powers[k, : k + 1] = chebyshev.cheb2poly(np.eye(FEW)[k, : k + 1])
    u = 2.0 * (np.arange(count)[:, None] + 0.5 * (t + 1.0)) / count - 1.0
    local = chebyshev.chebvander(u, terms - 1).transpose(0, 2, 1) @ to_series
    return local[:, :, :FEW] @ powers, local[:, :, FEW:]


@dataclass(frozen=True, eq=False)
class LogCurve:
    """The logarithm of an albedo over all incidences, piece by piece.

    Attributes
    ----------
    edges : ndarray, shape (m + 1,)
        Ends of the pieces in y, ascending from `FIRST` to `LAST`.
    coefficients : ndarray, shape (m, 18)
        Chebyshev coefficients on every piece.
    error : ndarray, shape (m,)
        Bound on the error of each series, relative to the albedo.
    bent : ndarray of int, shape (m,)
        Pieces whose series are in the root of the distance from the lower (1) or upper end (2).
    bends : ndarray
        Coordinates at which the curve bends, ascending. Where nothing foretold it a bend is known
        only if it shows within 0.004 of the end of a piece, and not at the ends next to the first
        and the last one.
    """

    edges: np.ndarray
    coefficients: np.ndarray
    error: np.ndarray
    bent: np.ndarray
    bends: np.ndarray = field(default_factory=lambda: np.empty(0))

    def at(self, y: np.ndarray) -> np.ndarray:
        """The logarithm at coordinates y of any shape."""
        out = np.empty(y.size)
        _curve_all(np.ascontiguousarray(y).ravel(), *self.pieces, out)
        return out.reshape(y.shape)

    @cached_property
    def polynomials(self) -> Polynomials:
        """What the series is read from."""
        rounding = 8.0 * np.finfo(np.float64).eps * np.abs(self.coefficients).sum(1)
        return Polynomials.of(self.coefficients, np.maximum(_LEFT_OUT * self.error, rounding))

    @property
    def bound(self) -> np.ndarray:
        """Bound on the error over each piece, relative to the albedo, of what is read: (m,)."""
        found: np.ndarray = self.error + self.polynomials.left_out
        return found

    @cached_property
    def bent_sides(self) -> np.ndarray:
        """Of each bend: 1 where the series above is bent there, 2 below, 3 on both sides."""
        above = np.searchsorted(self.edges, self.bends)
        found: np.ndarray = (self.bent[above] == 1) + 2 * (self.bent[above - 1] == 2)
        return found

    @cached_property
    def spread(self) -> float:
        """No two logarithms differ by more."""
        size = np.abs(self.coefficients[:, 1:]).sum(1)
        middle = self.coefficients[:, 0]
        return float((middle + size).max() - (middle - size).min())

    @cached_property
    def pieces(self) -> Pieces:
        """This curve as kernels know it."""
        return _packed_one(self)

    def __call__(self, cos_theta: np.ndarray) -> np.ndarray:
        """The albedo at cosines of any shape."""
        return np.exp(self.at(folded(cos_theta)))

    def piece(self, y: np.ndarray) -> np.ndarray:
        """The number of the piece that holds each y."""
        found = np.searchsorted(self.edges, y, side="right") - 1
        return np.clip(found, 0, self.error.size - 1)

    @cached_property
    def marks(self) -> np.ndarray:
        """Coordinates at which the albedo after this one may bend.

        There the curve has the value of one of its extrema or ends, those included.
        """
        return np.union1d(self.turns[1:-1], mates(self, self.turns))

    @cached_property
    def floored_marks(self) -> np.ndarray:
        """The same where what is divided by is not less than the cosine."""
        ends, crossings = self.floored_turns, self.crossings
        corners = np.concatenate((ends, crossings))
        return np.unique(np.concatenate((ends[1:-1], crossings, mates(self, corners, True))))

    @cached_property
    def turns(self) -> np.ndarray:
        """Ends of the intervals of y on which the curve rises or falls."""
        return _turns(_Step(self, False))

    @cached_property
    def floored_turns(self) -> np.ndarray:
        """Ends of the intervals on which the larger of the curve and the cosine does."""
        return _turns(_Step(self, True))

    @cached_property
    def crossings(self) -> np.ndarray:
        """Coordinates at which the albedo is the cosine."""
        return _sign_changes(lambda y: self.at(y) - np.log(unfolded(y)), self.samples)

    def passes(self, log_value: float) -> np.ndarray:
        """Coordinates at which the logarithm has a value, ascending."""
        return _sign_changes(lambda y: self.at(y) - log_value, self.samples)

    @cached_property
    def samples(self) -> np.ndarray:
        """Coordinates y that show every extremum, ascending, with both ends."""
        place = 0.5 * (1.0 - np.cos(np.pi * np.arange(_SAMPLES) / _SAMPLES))
        y = self.edges[:-1, None] + np.diff(self.edges)[:, None] * place
        return np.append(y.ravel(), self.edges[-1])


def mates(curve: LogCurve, y: np.ndarray, floor: bool = False) -> np.ndarray:
    """Coordinates at which a curve has the values that it has at others, but for these.

    With a floor it is the larger of the curve and the cosine.
    """
    found = np.concatenate([np.empty(0), *_equal_levels(_Step(curve, floor), y)])
    return np.unique(found[np.isfinite(found)])


def summed(curves: list[LogCurve]) -> LogCurve:
    """One curve that is the sum of others, none of them bent: exact, on pieces of all of them."""
    edges = np.unique(np.concatenate([curve.edges for curve in curves]))
    middle, half = 0.5 * (edges[1:] + edges[:-1]), 0.5 * np.diff(edges)
    nodes = chebyshev.chebpts1(TERMS)
    y = middle[:, None] + half[:, None] * nodes
    values = np.sum([curve.at(y) for curve in curves], axis=0)
    coefficients = np.linalg.solve(chebyshev.chebvander(nodes, TERMS - 1), values.T).T
    error = np.sum([curve.error[curve.piece(middle)] for curve in curves], axis=0)
    flat = np.zeros(error.size, dtype=int)
    return LogCurve(edges, np.ascontiguousarray(coefficients), error, flat)


@kernel
def _log_divisors(row, first, count, y, l_l, known, parts, cells, control, out):
    """Log of the divisor at runs of nodes, each in a row; `known` has the curves at L."""
    steps = cells.shape[0]
    room = 1
    for k in range(row.size):
        room = max(room, count[k])
    at_v, largest = np.empty(room), np.full(room, -math.inf)
    for k in range(row.size):
        r, begin = row[k], first[k]
        end = begin + count[k]
        for i in range(begin, end):
            out[i] = 0.0
            if control != 0:
                largest[i - begin] = max(log_height(y[i]), l_l[r])
        for j in range(steps):
            curve_along(y, begin, end, parts, cells, j, at_v)
            at_l = known[r, j]
            for i in range(begin, end):
                value = max(at_v[i - begin], at_l)
                if control == 1:
                    value = max(value, largest[i - begin])
                out[i] += value
        if control == 2:
            for i in range(begin, end):
                out[i] = max(out[i], largest[i - begin])


@kernel
def _divide(wi, wo, parts, cells, control, known, out):
    """Divide values by the divisor; `known` is room for the curves at L."""
    steps = cells.shape[0]
    for k in range(out.shape[0]):
        lz = wi[2, k]
        y_l = fold_vector(wi[0, k], wi[1, k], lz)
        l_l = math.log(max(lz, LOWEST))
        for j in range(steps):
            known[j] = curve_at(y_l, parts, cells, j)
        for i in range(out.shape[1]):
            vz = wo[2, k, i]
            if not vz > 0.0:
                continue
            y = fold_vector(wo[0, k, i], wo[1, k, i], vz)
            largest = max(log_height(y), l_l) if control != 0 else -math.inf
            total = 0.0
            for j in range(steps):
                value = max(curve_at(y, parts, cells, j), known[j])
                if control == 1:
                    value = max(value, largest)
                total += value
            if control == 2:
                total = max(total, largest)
            out[k, i] *= math.exp(-total)


class Divisor:
    """The product of the divisors of some steps, as a function of n.l and n.v.

    Parameters
    ----------
    curves : sequence of LogCurve
        Log of the albedo before each step.
    control : {None, "literal", "cumulative"}
        See `CONTROLS`.
    """

    def __init__(self, curves: list[LogCurve], control: str | None) -> None:
        self.curves, self.control = list(curves), control
        self._code = CONTROLS.index(control)
        # Where all rise or all fall with the height, the maximum is at one of the two directions.
        rising = [_rises(curve) for curve in self.curves]
        self.collapsed = len(curves) > 0 and control != "literal" and len(set(rising)) == 1
        self.collapsed = self.collapsed and rising[0] is not None
        self.collapsed = self.collapsed and not any(curve.bent.any() for curve in curves)
        used = [summed(self.curves)] if self.collapsed else self.curves
        self._used = used
        self._pieces = packed(used)

    @property
    def left_out(self) -> float:
        """What one table that stands for all curves leaves out of them, at most."""
        return float(self._used[0].polynomials.left_out.max()) if self.collapsed else 0.0

    def at_nodes(
        self,
        cos_light: np.ndarray,
        row: np.ndarray,
        first: np.ndarray,
        count: np.ndarray,
        y: np.ndarray,
        out: np.ndarray,
    ) -> None:
        """Fill the log of the divisor at runs of nodes, in rows with these lights.

        Parameters
        ----------
        cos_light : ndarray, shape (n,)
        row, first, count : ndarray of int, shape (m,)
            Row of each run, its first node, and how many there are.
        y, out : ndarray, shape (q,)
            Of all nodes: coordinate of n.v, and the result.
        """
        y_l = folded(cos_light)
        known = np.empty((y_l.size, len(self._used)))
        _curves_all(y_l, *self._pieces, known)
        lowest = np.log(np.maximum(cos_light, LOWEST))
        rest = lowest, known, *self._pieces, self._code, out

        def fill(part: slice) -> None:
            _log_divisors(row[part], first[part], count[part], y, *rest)

        side_by_side(fill, row.size, _FEW_RUNS)

    def divide(self, wi: np.ndarray, wo: np.ndarray, out: np.ndarray) -> None:
        """Divide values of a kernel by the divisor, in place."""
        _divide(wi, wo, *self._pieces, self._code, np.empty(len(self._used)), out)

    def between(self, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        """The divisor for pairs of unit vectors (n, 3)."""
        found: np.ndarray = np.exp(self.logs(wi[:, 2].copy(), wo[:, 2].copy()))
        return found

    def logs(self, cos_light: np.ndarray, cos_view: np.ndarray) -> np.ndarray:
        """Log of the divisor for pairs of heights, two arrays of one shape (n,)."""
        y = folded(cos_view)
        rows, out = np.arange(y.size), np.empty(y.size)
        self.at_nodes(cos_light, rows, rows, np.ones_like(rows), y, out)
        return out

    def levels(self, cos_light: np.ndarray) -> np.ndarray:
        """Values of n.v, beside n.l, at which the divisor has kinks: (n, k), NaN where fewer."""
        y_l = folded(cos_light)
        found: list[np.ndarray] = []
        if not self.collapsed:
            for curve in self.curves:
                found += self._levels_of(curve, y_l)
            found += self._bent(y_l)
        return _columns([unfolded(y) for y in found + self._clamped(y_l)], y_l.size)

    def _bent(self, y_l: np.ndarray) -> list[np.ndarray]:
        """Coordinates at which a curve bends that is what its step divides by there."""
        every = np.unique(np.concatenate([np.empty(0), *(curve.bends for curve in self.curves)]))
        shown = np.zeros((every.size, y_l.size), bool)
        for curve in self.curves:
            least = curve.at(y_l)
            if self.control == "literal":
                least = np.maximum(least, np.log(np.maximum(unfolded(y_l), LOWEST)))
            place = np.searchsorted(every, curve.bends)
            shown[place] |= curve.at(curve.bends)[:, None] > least
        return list(np.where(shown, every[:, None], np.nan))

    def last_levels(self, cos_light: np.ndarray) -> np.ndarray:
        """Coordinates of the levels that the last step adds: (n, k), NaN where fewer.

        Those that are the same for all light are in `last_bends`.
        """
        y_l = folded(cos_light)
        found: list[np.ndarray] = []
        if not self.collapsed and self.curves:
            found += self._levels_of(self.curves[-1], y_l)
        found += self._clamped(y_l)
        return np.column_stack(found) if found else np.empty((y_l.size, 0))

    @property
    def last_bends(self) -> np.ndarray:
        """Coordinates at which the curve of the last step bends, ascending."""
        return np.empty(0) if self.collapsed or not self.curves else self.curves[-1].bends

    @cached_property
    def marks(self) -> tuple[np.ndarray, np.ndarray]:
        """Coordinates of n.l at which an albedo with this divisor may bend: the last ones, all."""
        return self._marks(self.curves[-1:]), self._marks(self.curves)

    def _marks(self, curves: list[LogCurve]) -> np.ndarray:
        """The marks of some of the curves, and those of control."""
        found = [np.empty(0), *(self._marks_of(curve) for curve in curves)]
        found += [curve.bends for curve in curves]
        if self.control == "cumulative" and self.curves:
            # Where the product is the cosine with V as high as L, and with V at the normal.
            for other in (None, 1.0):

                def excess(y: np.ndarray, other: float | None = other) -> np.ndarray:
                    c = unfolded(y)
                    view = c if other is None else np.full(c.size, other)
                    return self._free.logs(c, view) - np.log(np.maximum(view, LOWEST))

                found.append(_sign_changes(excess, self.curves[-1].samples))
        together: np.ndarray = np.unique(np.concatenate(found))
        return together

    def _marks_of(self, curve: LogCurve) -> np.ndarray:
        return curve.floored_marks if self.control == "literal" else curve.marks

    def turnings(self, y: np.ndarray) -> np.ndarray:
        """Coordinates of n.l at which the places change course where the product is the cosine.

        There two of them meet, one reaches an end, or another albedo takes over at it.

        Parameters
        ----------
        y : ndarray
            Ascending; what happens more often than once between two of them may be passed over.
        """
        curves = self.curves
        if self.control != "cumulative" or not curves:
            return np.empty(0)

        def course(y_l: np.ndarray) -> np.ndarray:
            found = np.full((_COURSES, y_l.size), np.nan)
            for line, level in zip(found, self._clamped(y_l), strict=False):
                line[:] = level
            found.sort(axis=0)
            sides = []
            for curve in curves:
                excess = curve.at(found.ravel()).reshape(found.shape) - curve.at(y_l)
                flat = FLAT * float(curve.error.max())
                sides.append(np.where(np.abs(excess) > flat, np.sign(excess), 0.0))
            told = np.concatenate((np.where(np.isnan(found), 0.0, 1.0), *np.nan_to_num(sides)))
            return np.ascontiguousarray(told.T)

        at = course(y)
        k = np.flatnonzero((at[1:] != at[:-1]).any(1))
        low, high, left = y[k], y[k + 1], at[k]
        for _ in range(_HALVINGS if k.size else 0):
            middle = 0.5 * (low + high)
            same = (course(middle) == left).all(1)
            low, high = np.where(same, middle, low), np.where(same, high, middle)
        found: np.ndarray = 0.5 * (low + high)
        return found

    @cached_property
    def _free(self) -> Divisor:
        """The same steps without control."""
        return Divisor(self.curves, None)

    @property
    def product(self) -> Divisor:
        """The product of the divisors of all steps, whatever it may not fall below."""
        return self._free if self.control == "cumulative" else self

    def _levels_of(self, curve: LogCurve, y_l: np.ndarray) -> list[np.ndarray]:
        """Levels of one step."""
        literal = self.control == "literal"
        found = _equal_levels(_Step(curve, literal), y_l)
        # Where an albedo is the cosine the larger of both has a kink.
        return found + [np.full(y_l.size, y) for y in curve.crossings] if literal else found

    def _clamped(self, y_l: np.ndarray) -> list[np.ndarray]:
        """Coordinates at which the product of the albedos is max(n.l, n.v)."""
        if self.control != "cumulative" or not self.curves:
            return []
        used = self._free
        y, at_v = self._sampled
        at_l = np.stack([curve.at(y_l) for curve in used._used])
        log_v = np.log(np.maximum(unfolded(y), LOWEST))

        def fill(part: slice) -> np.ndarray:
            rows = y_l[part], np.ascontiguousarray(at_l[:, part])
            room = 4
            while True:
                out = np.full((room, rows[0].size), np.nan)
                most = _clamp_levels(y, log_v, at_v, *rows, *used._pieces, out)
                if most <= room:
                    return out[:most]
                room = most

        found = side_by_side(fill, y_l.size, _FEW_CLAMPED)
        levels = np.full((max(len(part) for part in found), y_l.size), np.nan)
        begin = 0
        for part in found:
            levels[: len(part), begin : begin + part.shape[1]] = part
            begin += part.shape[1]
        return list(levels)

    @cached_property
    def _sampled(self) -> tuple[np.ndarray, np.ndarray]:
        """Coordinates that show the extrema of the newest curve and the corners of all, and what is
        divided by there."""
        y = np.unique(np.concatenate((self.curves[-1].samples, *(c.bends for c in self.curves))))
        return y, np.stack([curve.at(y) for curve in self._free._used])


@kernel
def _excess(y, log_l, at_l, r, parts, cells):
    """How far a sum of maxima at y exceeds the log of the larger cosine, for the light of row r."""
    total = 0.0
    for j in range(at_l.shape[0]):
        total += max(curve_at(y, parts, cells, j), at_l[j, r])
    return total - max(log_height(y), log_l)


@kernel
def _change(low, high, log_l, at_l, r, parts, cells):
    """The place between two others at which the excess changes its sign."""
    before = _excess(low, log_l, at_l, r, parts, cells) > 0.0
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        if middle in (low, high):
            break
        if (_excess(middle, log_l, at_l, r, parts, cells) > 0.0) == before:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@kernel
def _closest(low, high, log_l, at_l, r, parts, cells):
    """The place where the excess is nearest to 0, or beyond, between two of one sign."""
    sign = 1.0 if _excess(low, log_l, at_l, r, parts, cells) > 0.0 else -1.0
    for _ in range(_SECTIONS):
        a, b = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
        first = sign * _excess(a, log_l, at_l, r, parts, cells)
        last = sign * _excess(b, log_l, at_l, r, parts, cells)
        if min(first, last) <= 0.0:
            return a if first <= last else b
        if first <= last:
            high = b
        else:
            low = a
    return 0.5 * (low + high)


@kernel
def _looks(y, log_v, at_v, y_l, log_l, at_l, r, parts, cells, product, corners, looks, seen):
    """Fill places, ascending, at which the excess of row r is looked at, and what it is there.

    Those are given ones, L's own height, and where an albedo is that of L, but for what lies
    between L and the given ones next to it. Return how many.
    """
    product[:], corners[:] = 0.0, 0
    for j in range(at_v.shape[0]):
        at_own = at_l[j, r]
        for i in range(y.size):
            product[i] += max(at_v[j, i], at_own)
        for i in range(1, y.size):
            corners[i] += (at_v[j, i - 1] > at_own) != (at_v[j, i] > at_own)
    count, own = 0, False
    for i in range(y.size):
        first = count
        if not own and y[i] > y_l:
            own = True
            looks[count] = y_l
            count += 1
        elif corners[i] > 0:
            for j in range(at_v.shape[0]):
                if (at_v[j, i - 1] > at_l[j, r]) != (at_v[j, i] > at_l[j, r]):
                    known = at_v[j, i - 1], at_v[j, i], at_l[j, r], False
                    looks[count] = _level(y[i - 1], y[i], *known, parts, cells[j : j + 1])
                    count += 1
            # Few, and mostly one.
            for last in range(first + 1, count):
                place, at = looks[last], last
                while at > first and looks[at - 1] > place:
                    looks[at] = looks[at - 1]
                    at -= 1
                looks[at] = place
        for k in range(first, count):
            seen[k] = _excess(looks[k], log_l, at_l, r, parts, cells)
        looks[count], seen[count] = y[i], product[i] - max(log_v[i], log_l)
        count += 1
    return count


@kernel
def _clamp_levels(y, log_v, at_v, y_l, at_l, parts, cells, out):
    """Fill the places where a sum of maxima is the log of the larger cosine; return how many.

    L's own height, where the larger cosine has a corner, is looked at too, and so are the corners
    of the sum, but for any next to it, and what comes near to 0 between the places.
    """
    most, room = 0, (y.size + 1) * (at_v.shape[0] + 1)
    looks, seen = np.empty(room), np.empty(room)
    product, corners = np.empty(y.size), np.empty(y.size, np.int64)
    for r in range(y_l.size):
        cosine, _ = unfold(y_l[r])
        log_l = math.log(max(cosine, LOWEST))
        row = y_l[r], log_l, at_l, r, parts, cells
        found = _looks(y, log_v, at_v, *row, product, corners, looks, seen)
        count = 0
        for i in range(1, found):
            here, after = seen[i - 1], seen[i]
            if (here > 0.0) != (after > 0.0):
                if count < out.shape[0]:
                    out[count, r] = _change(looks[i - 1], looks[i], log_l, at_l, r, parts, cells)
                count += 1
                continue
            if i < 2:
                continue
            before, a, c = seen[i - 2], looks[i - 2], looks[i]
            steep = max(abs(before - here), abs(after - here))
            near = abs(here) <= min(abs(before), abs(after)) and abs(here) < _STEEP * steep
            if near and (before > 0.0) == (here > 0.0):
                x = _closest(a, c, log_l, at_l, r, parts, cells)
                if (_excess(x, log_l, at_l, r, parts, cells) > 0.0) != (here > 0.0):
                    if count + 1 < out.shape[0]:
                        out[count, r] = _change(a, x, log_l, at_l, r, parts, cells)
                        out[count + 1, r] = _change(x, c, log_l, at_l, r, parts, cells)
                    count += 2
        most = max(most, count)
    return most


def _columns(found: list[np.ndarray], n: int) -> np.ndarray:
    """Levels side by side, in the fewest columns that hold them all."""
    if not found:
        return np.empty((n, 0))
    every = np.column_stack(found)
    every[every >= 1.0] = np.nan
    every = np.sort(every, axis=1)
    return every[:, np.isfinite(every).any(0)]


@dataclass(frozen=True, eq=False)
class _Step:
    """What a step divides by as a function of one height: an albedo, not less than the cosine."""

    curve: LogCurve
    floor: bool

    def at(self, y: np.ndarray) -> np.ndarray:
        value = self.curve.at(y)
        return np.maximum(value, np.log(unfolded(y))) if self.floor else value


# Curves that vary by less than this many of their errors have no kink that is known to be there;
# what that may cost is part of the bound.
FLAT = 0.5


def _turns(function: _Step) -> np.ndarray:
    """Ends of the intervals of y on which a function rises or falls."""
    y = function.curve.samples
    if function.floor:
        y = np.unique(np.concatenate((y, function.curve.crossings)))
    value = function.at(y)
    turns, last, direction = [0], 0, 0
    flat = FLAT * float(function.curve.error.max())
    # An extremum counts when what follows differs from it by more than the rounding.
    for k in range(1, y.size):
        step = value[k] - value[last]
        if direction == 0:
            if abs(step) > flat:
                direction, last = (1 if step > 0 else -1), k
        elif step * direction >= 0.0:
            last = k
        elif abs(step) > flat:
            turns.append(last)
            direction, last = -direction, k
    turns.append(y.size - 1)
    ends = y[turns].copy()
    for place, k in enumerate(turns[1:-1], start=1):
        low, high = y[max(k - 1, 0)], y[min(k + 1, y.size - 1)]
        sign = 1.0 if value[k] >= value[k - 1] else -1.0
        ends[place] = _peak(function, low, high, sign)
    return ends


def _peak(function: _Step, low: float, high: float, sign: float) -> float:
    """The place of the largest value of sign * function.

    Where it is smooth, by the change of sign of its derivative: values tell the place of an
    extremum to half their digits only. Else by golden sections.
    """
    curve = function.curve
    smooth = not function.floor or bool(np.all(curve.at(np.array([low, high])) > _logs(low, high)))
    if smooth and _rising(low, *curve.pieces, 0) != _rising(high, *curve.pieces, 0):
        return float(_turn_between(low, high, *curve.pieces))
    for _ in range(80):
        a, b = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
        values = sign * function.at(np.array([a, b]))
        if values[0] >= values[1]:
            high = b
        else:
            low = a
    return 0.5 * (low + high)


def _logs(low: float, high: float) -> np.ndarray:
    """Logarithms of the cosines at two coordinates."""
    found: np.ndarray = np.log(unfolded(np.array([low, high])))
    return found


def _rises(curve: LogCurve) -> bool | None:
    """Whether a curve rises with the height, falls (False), or does both (None)."""
    if curve.turns.size > 2:
        return None
    ends = curve.at(np.array([FIRST, LAST]))
    return bool(ends[1] >= ends[0])


def _equal_levels(function: _Step, y_l: np.ndarray) -> list[np.ndarray]:
    """Coordinates at which a function is what it is at each y_l, but for y_l itself."""
    curve = function.curve
    ends = curve.floored_turns if function.floor else curve.turns
    if ends.size == 2:
        return []
    goal, known = function.at(y_l), (ends, function.at(ends), function.floor, *curve.pieces)

    def fill(part: slice) -> np.ndarray:
        out = np.full((ends.size - 1, y_l[part].size), np.nan)
        _fill_equal(y_l[part], goal[part], *known, out)
        return out

    out = np.concatenate(side_by_side(fill, y_l.size, _FEW_ROWS), axis=1)
    return [column for column in out if np.isfinite(column).any()]


@kernel
def _level(x_1, x_2, at_1, at_2, goal, floor, parts, cells):
    """The place between two others at which a curve, or the larger cosine, has a value."""
    f_1, f_2 = at_1 - goal, at_2 - goal
    x_3, f_3 = x_1, f_1
    for _ in range(_BISECTIONS):
        near = _NEAR * max(abs(x_1), abs(x_2), 1.0)
        # Nearer than that a second step would not be one.
        if abs(x_2 - x_1) <= 2.0 * near:
            break
        least = near / abs(x_2 - x_1)
        x = x_1 + next_share(x_1, x_2, x_3, f_1, f_2, f_3, least) * (x_2 - x_1)
        value = curve_at(x, parts, cells, 0)
        if floor:
            value = max(value, log_height(x))
        f = value - goal
        if (f > 0.0) == (f_1 > 0.0):
            x_3, f_3 = x_1, f_1
        else:
            x_3, f_3, x_2, f_2 = x_2, f_2, x_1, f_1
        x_1, f_1 = x, f
    return x_1


@kernel
def _fill_equal(y_l, goal, ends, at_ends, floor, parts, cells, out):
    """Fill one line for every interval on which a function rises or falls."""
    for i in range(ends.size - 1):
        least, most = min(at_ends[i], at_ends[i + 1]), max(at_ends[i], at_ends[i + 1])
        for r in range(y_l.size):
            low, high = ends[i], ends[i + 1]
            if low <= y_l[r] <= high or not least < goal[r] < most:
                continue
            out[i, r] = _level(low, high, at_ends[i], at_ends[i + 1], goal[r], floor, parts, cells)


def _sign_changes(function: Callable[[np.ndarray], np.ndarray], y: np.ndarray) -> np.ndarray:
    """Coordinates between samples, in ascending order, at which a function changes its sign."""
    positive = function(y) > 0.0
    k = np.flatnonzero(positive[1:] != positive[:-1])
    a, b, left = y[k], y[k + 1], positive[k]
    for _ in range(_BISECTIONS if k.size else 0):
        middle = 0.5 * (a + b)
        same = (function(middle) > 0.0) == left
        a, b = np.where(same, middle, a), np.where(same, b, middle)
    found: np.ndarray = 0.5 * (a + b)
    return found
