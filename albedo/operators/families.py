r"""Integrals around rings at many incidences, from those at a few.

Panels follow the lobe: their ends are smooth functions of the incidence, and so is each Legendre
coefficient of the integral around the ring in the coordinate of a panel, however narrow the lobe
is. A *family* has them at Chebyshev's nodes of a stretch of incidences, on panels that are the same
for all, and is confirmed by fresh incidences between: what it missed there goes into its bounds.
Stretches end where panels appear or vanish, and are halved where a family does not do, a few times.
A family is made where more incidences are asked for than it takes to make it.

Where what is next to nothing will be much after some steps, each panel has a scale of its own, of
which the family holds the logarithm: over a stretch it changes by many orders.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.polynomial import chebyshev

from albedo.brdf import Model, Part
from albedo.charts.heights import FIRST, LAST, folded
from albedo.charts.rings import RingsChart
from albedo.operators.nodes import LEBESGUE, MOST, TRUST, cosines, places
from albedo.operators.panels import TERMS, Ahead, Panels, common, doubt_of, restricted

_EPS = np.finfo(np.float64).eps
# Sums of as many terms as a family has rows.
_ROUNDINGS = 8.0
# A family is made of 25 rows where so many are asked for, of which there are many more later where
# steps are looked ahead. They are better than what is asked for by the second factor, since their
# errors are amplified, and by the first at least.
_WORTH, _WORTH_AHEAD, _BETTER = 18, 8, (4.0, 16.0)
# After steps ahead a row may lose so many times what it may at first.
_LENIENT = 4.0
# Mean squares of Legendre's polynomials.
_NORMS = 1.0 / (2.0 * np.arange(TERMS) + 1.0)
# What lies nearer to where panels change, in y, is in no stretch.
_MARGIN = 1e-6
# Stretches are cut to this at first; towards the horizon, to this times 1 - y.
_LONGEST, _GRAZING = 0.15, 0.5
# Stretches that have no family are halved so many times.
_HALVINGS = 4
# Where panels change is looked for on so many incidences.
_SCAN = 700


@dataclass(frozen=True)
class _Segments:
    """Heights that panels have in common, from one kink to the next.

    Attributes
    ----------
    geometry : ndarray, shape (n, k)
        What the chart told of every row.
    kind : ndarray of int, shape (n, m)
        Rows with the same ones have panels that go over into each other; -1 where there is none.
    code, ends : ndarray, shape (n, m, 4) and (n, m, 2)
        As for the first panel of each segment.
    """

    geometry: np.ndarray
    kind: np.ndarray
    code: np.ndarray
    ends: np.ndarray

    @classmethod
    def of(cls, chart: RingsChart, part: Part, c: np.ndarray) -> _Segments:
        n = c.size
        panels = chart.panels(c, np.zeros(n), np.tile(part.widths, (n, 1)), True)
        geometry, row, code, box = panels
        key = np.column_stack((row, code[:, 0], box[:, 4]))
        first = np.flatnonzero(np.any(np.diff(key, axis=0, prepend=-1.0) != 0.0, axis=1))
        row = row[first]
        place = np.arange(row.size) - np.searchsorted(row, row)
        most = int(place.max(initial=-1)) + 1
        kind = np.full((n, most + 1), -1)
        codes, ends = np.zeros((n, most, 4), int), np.zeros((n, most, 2))
        codes[row, place], ends[row, place] = code[first], box[first, 4:]
        # Coordinates have a kink where the axis is as high as the lobe is wide.
        kind[:, 0] = geometry[:, 10] == geometry[:, 4]
        kind[row, place + 1] = code[first, 0] + 4 * code[first, 3] + 32 * (box[first, 4] == 0.0)
        return cls(geometry, kind, codes, ends)

    def like(self, kind: np.ndarray) -> np.ndarray:
        """Which rows are of a kind, where the -1 may be left out."""
        m = kind.size
        if m > self.kind.shape[1]:
            return np.zeros(self.kind.shape[0], bool)
        return np.all(self.kind[:, :m] == kind, axis=1) & np.all(self.kind[:, m:] < 0, axis=1)


@dataclass(frozen=True, eq=False)
class _Family:
    """The panels of all incidences between two.

    Attributes
    ----------
    low, high : float
        The incidences, in y.
    kind : ndarray of int
        See `_Segments`.
    segment, box, order : ndarray, shape (m, ...)
        Of the panels: the segment, the part of it, and how many coefficients there are.
    series : ndarray, shape (MOST + 1, m * terms + scales)
        Chebyshev coefficients of the Legendre coefficients of panels whose scale is 1, and last of
        the logarithms of the scales.
    scale : ndarray of int, shape (m,)
        The scale of each panel: what a row sends on, or a panel.
    blur, tail : ndarray, shape (m,)
        As in `Panels`, for panels whose scale is 1.
    doubt, shift : float
        The worst of the rows it was made from.
    ahead : bool
        Whether it is good for steps ahead.
    """

    low: float
    high: float
    kind: np.ndarray
    segment: np.ndarray
    box: np.ndarray
    order: np.ndarray
    series: np.ndarray
    scale: np.ndarray
    blur: np.ndarray
    tail: np.ndarray
    doubt: float
    shift: float
    ahead: bool

    @classmethod
    def of(
        cls,
        y: np.ndarray,
        kind: np.ndarray,
        rows: Panels,
        first: int,
        rtol: float,
        ahead: Ahead | None,
    ) -> _Family | None:
        """From rows of one kind at nodes and at fresh incidences y, see `nodes.places`.

        They stand from the first on. Where one sends nothing on there is no family, nor where it is
        not worth `rtol`, at first or after steps ahead.
        """
        n = y.size
        mine = np.flatnonzero((rows.row >= first) & (rows.row < first + n))
        row = rows.row[mine] - first
        total = np.bincount(row, rows.series[mine, 0], n)
        if not np.all(total > 0.0):
            return None
        # All rows have the same segments, in the same order.
        key = np.column_stack((row, rows.code[mine, 0], rows.box[mine, 4]))
        segment = np.unique(key, axis=0, return_inverse=True)[1].ravel() % (kind.size - 1)
        place, part, starts, ends = common(segment, rows.box[mine, 2], rows.box[mine, 3])
        m, at, panel = starts.size, row[place], mine[place]
        series = np.zeros((n, m, rows.series.shape[1]))
        series[at, part] = restricted(rows, panel, starts[part], ends[part])
        # What holds nothing at all has no logarithm.
        own = np.all(series[:, :, 0] > 1e-200, axis=0) if ahead else np.zeros(m, dtype=bool)
        scales: np.ndarray = np.column_stack((total, series[:, own, 0]))
        scale = np.where(own, np.cumsum(own), 0)
        series /= scales[:, scale, None]
        order, blur, tail, of = np.zeros(m, int), np.zeros(m), np.zeros(m), np.empty(m, int)
        np.maximum.at(order, part, rows.order[panel])
        np.maximum.at(blur, part, rows.blur[panel] / scales[at, scale[part]])
        np.maximum.at(tail, part, rows.tail[panel] / scales[at, scale[part]])
        of[part] = segment[place]
        box = np.column_stack((np.zeros(m), np.ones(m), starts, ends))
        low, high, nodes = float(y.min()), float(y.max()), MOST + 1
        basis = _basis(y, low, high)
        known = np.column_stack((series.reshape(n, -1), np.log(scales)))
        found = basis @ (fitted := np.linalg.solve(basis[:nodes], known[:nodes]))
        count = scales.shape[1]
        grown = np.exp(found[nodes:, -count:] - known[nodes:, -count:])[:, scale, None]
        off = grown * found[nodes:, :-count].reshape(n - nodes, m, -1) - series[nodes:]
        # The mean modulus of a difference is no more than its mean square's root, by Parseval.
        missed = np.sqrt((off * off) @ _NORMS).max(0)
        # A panel of next to nothing has the roundings of neighbours that hold more.
        rounding = _ROUNDINGS * _EPS * np.abs(series).sum(2).max(0)
        blur = TRUST * missed + LEBESGUE * (blur + rounding)
        doubt, shift = (float(a[first : first + n].max()) for a in (rows.doubt, rows.shift))
        lost = scales[:, scale] * blur
        worst = float((lost.sum(1) / total).max())
        if ahead:
            code, boxes = np.empty((n, m, 4), dtype=int), np.empty((n, m, 6))
            code[at, part], boxes[at, part] = rows.code[panel], rows.box[panel]
            boxes[:, :, 2:4] = box[:, 2:]
            held = (scales[:, scale] * series[:, :, 0]).ravel()
            flat = code.reshape(n * m, 4), boxes.reshape(n * m, 6), np.repeat(np.arange(n), m), held
            share = lost.ravel() / ahead.shares(rows.geometry[first : first + n], *flat)
            worst = max(worst, float(share.max()) / _LENIENT)
        if doubt * worst > rtol:
            return None
        return cls(
            *(low, high, kind, of, box, order, fitted, scale),
            *(blur, LEBESGUE * tail, doubt, shift, ahead is not None),
        )

    def rows(self, segments: _Segments, which: np.ndarray, y: np.ndarray) -> Panels:
        """Rows and panels at some of the rows of segments, which lie at y."""
        n, m = which.size, self.segment.size
        found = _basis(y, self.low, self.high) @ self.series
        count = self.series.shape[1] - m * TERMS
        scale = np.exp(found[:, -count:])[:, self.scale]
        box = np.empty((n, m, 6))
        box[:, :, :4], box[:, :, 4:] = self.box, segments.ends[which][:, self.segment]
        return Panels(
            geometry=segments.geometry[which],
            doubt=np.full(n, self.doubt),
            shift=np.full(n, self.shift),
            ahead=np.full(n, int(self.ahead)),
            row=np.repeat(np.arange(n), m),
            code=segments.code[which][:, self.segment].reshape(n * m, -1),
            box=box.reshape(n * m, -1),
            order=np.tile(self.order, n),
            series=(scale[:, :, None] * found[:, :-count].reshape(n, m, -1)).reshape(n * m, -1),
            blur=(scale * self.blur).ravel(),
            tail=(scale * self.tail).ravel(),
        )


@dataclass(eq=False)
class _Stretch:
    """Incidences that may have a family: how many were asked for, and what became of it."""

    low: float
    high: float
    asked: np.ndarray = field(default_factory=lambda: np.empty(0))
    family: _Family | None = None
    hopeless: bool = False
    halvings: int = 0

    def inside(self, y: np.ndarray) -> np.ndarray:
        """Those of some coordinates that it holds."""
        return y[(y >= self.low) & (y <= self.high)]

    def wants_one(self, y: np.ndarray, ahead: Ahead | None) -> bool:
        """Whether a family is worth while when some coordinates are asked for."""
        if self.family is not None or self.hopeless:
            return False
        worth = _WORTH_AHEAD if ahead else _WORTH
        return self.asked.size + self.inside(y).size >= worth

    def halves(self) -> list[_Stretch]:
        middle = 0.5 * (self.low + self.high)
        lower, upper = self.asked[self.asked <= middle], self.asked[self.asked > middle]
        return [
            _Stretch(self.low, middle, lower, halvings=self.halvings + 1),
            _Stretch(middle, self.high, upper, halvings=self.halvings + 1),
        ]


class Families:
    """One part of a model at any incidence.

    Parameters
    ----------
    model : Model
    part : Part
    chart : RingsChart
    rtol : float
        What the integrals of a row are to be worth, as a share of it.
    finest : float
        What they can be worth at most.
    """

    def __init__(
        self, model: Model, part: Part, chart: RingsChart, rtol: float, finest: float
    ) -> None:
        self.model, self.part, self.chart = model, part, chart
        self.rtol, self.finest = rtol, finest
        self._stretches: dict[Ahead | None, list[_Stretch]] = {}

    def direct(self, c: np.ndarray, ahead: Ahead | None = None, fine: bool = False) -> Panels:
        """Rows from the model, see `Panels.of`; fine ones are as good as those of families."""
        rtol = max(self.rtol / _BETTER[1], self.finest) if fine else self.rtol
        return Panels.of(self.model, self.part, self.chart, c, rtol, ahead)

    def panels(self, c: np.ndarray, ahead: Ahead | None = None) -> Panels:
        """Rows at some cosines: those of families where it is worth while; see `Panels.of`."""
        y = folded(c)
        segments = _Segments.of(self.chart, self.part, c)
        found, order = [], []
        left = np.ones(c.size, bool)
        for family in self._asked(y, ahead):
            inside = (y >= family.low) & (y <= family.high) & left
            if not inside.any():
                continue
            which = np.flatnonzero(inside & segments.like(family.kind))
            left[which] = False
            if which.size:
                found.append(family.rows(segments, which, y[which]))
                found[-1].shift += doubt_of(self.part, c[which])
                order.append(which)
        rest = np.flatnonzero(left)
        if rest.size:
            found.append(self.direct(c[rest], ahead))
            order.append(rest)
        return Panels.together(found, order)

    @cached_property
    def _cuts(self) -> list[tuple[float, float]]:
        """Stretches between the incidences at which panels appear or vanish."""
        if self.rtol < _BETTER[0] * self.finest:
            return []
        y = np.linspace(FIRST, LAST, _SCAN)
        kind = self._segments(y).kind
        at = np.flatnonzero(np.any(kind[1:] != kind[:-1], axis=1))
        low, high, before = y[at], y[at + 1], kind[at]
        while at.size and np.max(high - low) > _MARGIN:
            middle = 0.5 * (low + high)
            segments = self._segments(middle)
            same = np.array([segments.like(k[k >= 0])[i] for i, k in enumerate(before)])
            low, high = np.where(same, middle, low), np.where(same, high, middle)
        # The coordinate itself has a kink at 0.
        starts, ends = np.append(high, (FIRST, 0.0)), np.append(low, (0.0, LAST))
        found: list[tuple[float, float]] = []
        for start, end in zip(np.sort(starts), np.sort(ends), strict=True):
            # More than this hardly has a family.
            longest = _LONGEST if start >= 0.0 else _GRAZING * (1.0 - end)
            count = math.ceil((end - start) / longest)
            cuts = np.linspace(start, end, count + 1).tolist()
            found += itertools.pairwise(cuts)
        return found

    def _segments(self, y: np.ndarray) -> _Segments:
        return _Segments.of(self.chart, self.part, cosines(y))

    def _asked(self, y: np.ndarray, ahead: Ahead | None) -> list[_Family]:
        """All families for some steps ahead, once rows at some coordinates are asked for."""
        stretches = self._stretches.setdefault(ahead, [_Stretch(*ends) for ends in self._cuts])
        while wanted := [s for s in stretches if s.wants_one(y, ahead)]:
            self._make(wanted, ahead)
        for stretch in stretches:
            stretch.asked = np.concatenate((stretch.asked, stretch.inside(y)))
        return [stretch.family for stretch in stretches if stretch.family is not None]

    def _make(self, stretches: list[_Stretch], ahead: Ahead | None) -> None:
        """Families for stretches; where one is not good enough there are two halves then."""
        ends = np.array([(stretch.low, stretch.high) for stretch in stretches])
        y = ends[:, :1] + places(MOST) * (ends[:, 1:] - ends[:, :1])
        kinds = self._segments(y.ravel()).kind.reshape(*y.shape, -1)
        # Where panels change, or where there are none, there is no family.
        alike = np.all(kinds == kinds[:, :1], axis=(1, 2)) & (kinds[:, 0, 1] >= 0)
        made: list[_Family | None] = [None] * len(stretches)
        if alike.any():
            c = cosines(y[alike])
            rtol = max(self.rtol / _BETTER[1], self.finest)
            rows = Panels.of(self.model, self.part, self.chart, c.ravel(), rtol, ahead)
            rows.shift -= doubt_of(self.part, c.ravel())
            for k, at in enumerate(np.flatnonzero(alike).tolist()):
                kind = kinds[at, 0][kinds[at, 0] >= 0]
                first = k * y.shape[1]
                made[at] = _Family.of(folded(c[k]), kind, rows, first, 0.5 * self.rtol, ahead)
        for stretch, found in zip(stretches, made, strict=True):
            stretch.family, stretch.hopeless = found, found is None
            if found is None and stretch.halvings < _HALVINGS:
                self._stretches[ahead].remove(stretch)
                self._stretches[ahead] += stretch.halves()


def _basis(y: np.ndarray, low: float, high: float) -> np.ndarray:
    """Chebyshev's polynomials at coordinates of a stretch."""
    x = (2.0 * y - low - high) / (high - low)
    found: np.ndarray = chebyshev.chebvander(np.clip(x, -1.0, 1.0), MOST)
    return found
