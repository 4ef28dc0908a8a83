r"""What a divisor of heights needs of a model: at every incidence, its integrals around rings.

The integral of f (n.v) around the ring of one height, over a panel of heights, is a smooth
function of the place t on the panel: a Legendre series, had once from the cells of the integrator.
A *slice* is a part of a panel, with a Gauss rule of its own on which the series is read. So a
panel is cut where a divisor has a kink without computing the model again, and a step of pumping-up
costs a sum over the nodes of slices.

Two errors of a panel do not depend on what is divided by but in its size: that of the rules along
the rings, and what the series leaves out. That of the rules of slices is read from their spectra.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial.legendre import legvander

from albedo._compile import kernel
from albedo._threads import in_batches, side_by_side
from albedo.brdf import Model, Part
from albedo.charts._compiled import clustered
from albedo.charts.heights import LOWEST, elevation_at, fold_elevation, folded, log_height
from albedo.charts.rings import RingsChart, elevation, stretched
from albedo.integrators.adaptive import refine_alike
from albedo.integrators.cells import (
    Cells,
    ModelIntegrand,
    fill_spectrum,
    probe_cells,
    rules_by_order,
)
from albedo.integrators.rules import LADDER, gauss, stopping_bound
from albedo.operators.divisor import LogCurve, curve_along, curve_at, is_below

TERMS = LADDER[-1]
"""Legendre coefficients of a panel."""
_LIMIT = 400_000
# What a series leaves out of a panel, in terms of its last coefficients.
_TAIL, _WINDOW = 4.0, 3
# It counts for less than errors along the rings: a panel that is not cut does not read its series.
_SHOWN = 0.2
# Roundings at the nodes are amplified by the degree in the last coefficients.
_NOISE = 1024.0 * np.finfo(np.float64).eps
# A panel has nodes for this many e-folds of its error; a part of one has a few more than that
# takes, for what it is divided by, and this many at least.
_DIGITS, _MORE, _LEAST = 27.6, 4.0, 8.0
# Where nodes are clustered there are so many times more: what is smooth has twice the degree.
_CLUSTERED = 1.5
# Slices that are worth another thread, and rows that one integrates at once.
_FEW, _BATCH = 300, 64
# Pairs of slices and places that are looked at at once: few slices have any, and each may have all.
_ROOM = 1_000_000
# Rows that begin with the cells of the one in their midst.
_ALIKE = 20
# Nodes are moved together when there are so many for each that is used.
_HOLES = 2
# Kinks that are closer than this, as a share of a panel, are one.
_SAME = 1e-10


@kernel
def _move_up(array, number):
    """Move the entries of ascending numbers to the front."""
    for i in range(number.size):
        array[i] = array[number[i]]


@kernel
def _close_up(array, first, order):
    """Move runs to the front, each from its first entry on, which ascend."""
    last = 0
    for k in range(first.size):
        for i in range(first[k], first[k] + order[k]):
            array[last] = array[i]
            last += 1


class _Column:
    """One of the arrays of a store, as far as it is filled."""

    def __init__(self, store: str) -> None:
        self.store = store

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def __get__(self, instance: Any, owner: type) -> np.ndarray:
        store: _Store = getattr(instance, self.store)
        return store.arrays[self.name][: store.size]


@dataclass
class _Store:
    """Arrays of one length that grow at their ends, with room to spare."""

    arrays: dict[str, np.ndarray]
    size: int

    def append(self, **more: np.ndarray) -> None:
        """Fill up all arrays; with zeros those of which nothing is given."""
        (count,) = {a.size for a in more.values()}
        self.lengthen(count)
        for name, array in self.arrays.items():
            array[self.size - count : self.size] = more.get(name, 0)

    def lengthen(self, count: int) -> None:
        """Append entries that are still to be filled."""
        last = self.size + count
        for name, array in self.arrays.items():
            if last > array.size:
                # Pages that are not touched cost nothing.
                room = np.empty(2 * last, array.dtype)
                room[: self.size] = array[: self.size]
                self.arrays[name] = room
        self.size = last

    def keep(self, number: np.ndarray) -> None:
        """Give up all entries but those of these numbers, which ascend."""
        for array in self.arrays.values():
            _move_up(array, number)
        self.size = number.size


class Slices:
    """Parts of panels, and the nodes of their rules.

    Attributes
    ----------
    panel, start, end, order : ndarray
        What each slice is a part of, from where to where, and how many nodes it has.
    bent : ndarray
        Where what it is divided by is smooth in the root of the distance from its start (1), its
        end (2) or both (3); nodes are clustered there.
    first : ndarray
        The first of its nodes.
    value, error, most : ndarray
        What it was last worth, the bound of its rule, and the largest factor of its nodes.
    log_scale : ndarray
        Logarithm of what all of its nodes are divided by, besides their own products.
    low, high : ndarray
        Coordinates of n.v at its ends, in ascending order.
    stale : ndarray of bool
        Whether its value, error and most are to be computed again.
    density, y, log_product : ndarray
        Of nodes: the integral around the ring, per unit of the rule; coordinate of n.v, which
        rises or falls along a slice; logarithm of the product of the divisors of all steps.
    """

    panel, start, end = _Column("_slices"), _Column("_slices"), _Column("_slices")
    order, first, stale = _Column("_slices"), _Column("_slices"), _Column("_slices")
    bent = _Column("_slices")
    value, error, most = _Column("_slices"), _Column("_slices"), _Column("_slices")
    log_scale, low, high = _Column("_slices"), _Column("_slices"), _Column("_slices")
    density, y, log_product = _Column("_nodes"), _Column("_nodes"), _Column("_nodes")

    def __init__(self) -> None:
        whole = dict.fromkeys(("panel", "order", "bent", "first"), np.empty(0, int))
        names = ("start", "end", "value", "error", "most", "log_scale", "low", "high")
        real = dict.fromkeys(names, np.empty(0))
        self._slices = _Store({**whole, **real, "stale": np.empty(0, bool)}, 0)
        self._nodes = _Store(dict.fromkeys(("density", "y", "log_product"), np.empty(0)), 0)

    def put(
        self,
        gone: np.ndarray,
        panel: np.ndarray,
        start: np.ndarray,
        end: np.ndarray,
        order: np.ndarray,
        bent: np.ndarray,
    ) -> np.ndarray:
        """Put new slices in the places of others, and more at the end; return their numbers.

        There are no fewer new ones than old ones. Their nodes are still to be laid out.
        """
        more = panel.size - gone.size
        where = np.concatenate((gone, np.arange(self._slices.size, self._slices.size + more)))
        # Where there is room the nodes of old slices are taken up.
        added = order.copy()
        added[: gone.size][order[: gone.size] <= self.order[gone]] = 0
        first = self._nodes.size + np.cumsum(added) - added
        first[: gone.size] = np.where(added[: gone.size], first[: gone.size], self.first[gone])
        self._slices.append(panel=panel[gone.size :])
        new = {"panel": panel, "start": start, "end": end, "order": order}
        new |= {"bent": bent, "first": first}
        for name, values in new.items():
            self._slices.arrays[name][where] = values
        self._slices.arrays["log_scale"][where] = 0.0
        self._slices.arrays["stale"][where] = True
        self._nodes.lengthen(int(added.sum()))
        return where

    def keep(self, which: np.ndarray) -> None:
        """Give up all slices but those that a mask tells."""
        self._slices.keep(np.flatnonzero(which))
        used = int(self.order.sum())
        if _HOLES * used >= self._nodes.size:
            return
        rank = np.argsort(self.first)
        first, order = self.first[rank], self.order[rank]
        for array in self._nodes.arrays.values():
            _close_up(array, first, order)
        self.first[rank] = np.cumsum(order) - order
        self._nodes.size = used

    def extend(self, other: Slices, panels: int) -> None:
        """Take in the slices of others, whose panels follow so many."""
        nodes = self._nodes.size
        columns = {k: getattr(other, k) for k in other._slices.arrays}
        columns["panel"], columns["first"] = other.panel + panels, other.first + nodes
        self._slices.append(**columns)
        self._nodes.append(**{k: getattr(other, k) for k in other._nodes.arrays})


@dataclass(frozen=True)
class Runs:
    """What some rows send on, added up over neighbours.

    Attributes
    ----------
    row, piece : ndarray of int, shape (m,)
        The row of each run, and the piece of y that holds it.
    y, share, lowest : ndarray, shape (m,)
        Where most of it comes from, how much is divided by the albedos alone, and the logarithm
        below which one step does not divide.
    total : ndarray, shape (n,)
        All that rows send on.
    """

    row: np.ndarray
    piece: np.ndarray
    y: np.ndarray
    share: np.ndarray
    lowest: np.ndarray
    total: np.ndarray


@dataclass(frozen=True)
class Ahead:
    """What rows will be worth after steps, of which one albedo is known.

    Where both albedos are small, what is next to nothing at first is much once it is divided by
    them time and again. From step to step most is sent on to heights that are darker, down to where
    V is as dark as L; so what is wanted of a row is wanted of its heights up to any albedo.

    Where control keeps the product of all steps it comes down to the larger cosine, and stays
    there: what is wanted of a row is wanted of what is divided by any cosine, too.

    Attributes
    ----------
    curve : LogCurve
        The albedo that is known.
    steps : tuple of float
        Numbers of steps that may have divided by the known albedo before others are dark no more.
    clamped : bool
        Control keeps the product.
    """

    curve: LogCurve
    steps: tuple[float, ...] = (0.0, 4.0, 12.0)
    clamped: bool = False

    def shares(
        self,
        geometry: np.ndarray,
        code: np.ndarray,
        box: np.ndarray,
        row: np.ndarray,
        held: np.ndarray,
    ) -> np.ndarray:
        """What panels will hold, each with all that are as dark or darker, of what they hold now.

        Parameters
        ----------
        geometry : ndarray, shape (n, ...)
            What a chart tells of the rows.
        code, box, row, held : ndarray, shape (m, ...)
            Of the panels: what the chart tells of them, their rows, and what they hold.

        Returns
        -------
        ndarray, shape (m,)
            What an error of a panel is to be divided by, at least. It is what the panels hold, but
            that the darkest part of the panel may have been divided by less than the middle.
        """
        albedo = np.empty((2, row.size))
        at_l = self.curve.at(folded(geometry[:, 0], geometry[:, 1]))[row]
        _larger(geometry[row], code, box, at_l, *self.curve.pieces, albedo)
        found = np.empty(row.size)
        order = np.lexsort((albedo[1], row))
        _share(order, row, albedo[0] - at_l, albedo[1] - at_l, held, np.array(self.steps), found)
        if self.clamped:
            _share_clamped(np.argsort(row, kind="stable"), row, geometry, code, box, held, found)
        return found

    def weights(self, geometry: np.ndarray, cells: Cells) -> np.ndarray:
        """How many times more errors of cells count then than at first."""
        found = self.shares(geometry, cells.code, cells.box, cells.row, cells.size)
        size = np.bincount(cells.row, cells.size, geometry.shape[0])[cells.row]
        return np.maximum(size / np.maximum(found, 1e-300), 1.0)


@dataclass
class Profiles:
    """One part of a model at many incidences.

    Attributes
    ----------
    geometry, doubt, shift, ahead : ndarray, shape (n, ...), (n,), (n,), (n,)
        Of the rows: what the chart told, factors of bounds, relative errors that no rule has, and
        how far ahead steps were looked: 0 for not at all.
    row, code, box, order, series : ndarray, shape (m, ...)
        Of the panels: their rows, what the chart needs to know, and Legendre coefficients.
    blur, tail : ndarray, shape (m,)
        Bounds on the error along the rings, and on what a series leaves out.
    slices : Slices
    """

    geometry: np.ndarray
    doubt: np.ndarray
    shift: np.ndarray
    ahead: np.ndarray
    row: np.ndarray
    code: np.ndarray
    box: np.ndarray
    order: np.ndarray
    series: np.ndarray
    blur: np.ndarray
    tail: np.ndarray
    slices: Slices

    @classmethod
    def of(
        cls,
        model: Model,
        part: Part,
        chart: RingsChart,
        cos_theta: np.ndarray,
        rtol: float,
        ahead: Ahead | None = None,
    ) -> Profiles:
        """Integrate around rings at some incidences, with panels that are slices as a whole.

        They are worth `rtol` after steps ahead, too.
        """

        numbers = np.array(model.pack(), dtype=np.float64)

        def some(which: slice) -> Profiles:
            c = cos_theta[which]
            n = c.size
            p, scale = part.packed(np.tile(numbers, (n, 1))), np.full(n, part.scale)
            integrand = ModelIntegrand(part.fill, p, scale, shared=True)
            # Rows take over what was found for one of those next to them.
            rank = np.argsort(c)
            like = np.empty(n, dtype=int)
            like[rank] = rank[np.minimum(_ALIKE * (np.arange(n) // _ALIKE) + _ALIKE // 2, n - 1)]
            done = refine_alike(
                *(chart, integrand, c, np.zeros(n), np.tile(part.widths, (n, 1)), True, like),
                rtol=rtol,
                atol=0.0,
                limit=_LIMIT,
                judge_series=_judge_series,
                weigh=ahead.weights if ahead else None,
            )
            cells = done.cells
            # What directions moved by an ulp change, as a share of what is sent on, and what the
            # numbers of the part are worth.
            moved = probe_cells(chart, integrand, done.geometry, cells, n, 1)
            sent = np.maximum(np.bincount(cells.row, cells.value, n), 1e-300)
            shift = 4.0 * moved / sent + doubt_of(part, c)
            rows = done.geometry, done.doubt, shift, np.full(n, int(ahead is not None))
            return cls.whole(
                **dict(zip((*_OF_ROWS, *_OF_PANELS), (*rows, *_stacked(cells)), strict=True))
            )

        found, *others = in_batches(some, cos_theta.size, _BATCH)
        for other in others:
            found.extend(other)
        return found

    @classmethod
    def whole(cls, **arrays: np.ndarray) -> Profiles:
        """Rows and panels, of which each is one slice."""
        found = cls(**arrays, slices=Slices())
        m = found.row.size
        ends = np.zeros(m), np.ones(m)
        found._put(np.empty(0, int), np.arange(m), *ends, found.order, np.zeros(m, int))
        found.slices.log_product[:] = 0.0
        return found

    def sums(
        self, control: int, log_light: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Values of all rows, bounds on the errors of slices, and bounds of panels, as row sums.

        Parameters
        ----------
        control : int
            2 where the product is at least the larger cosine; see `divisor.CONTROLS`.
        log_light : ndarray, shape (n,)
            Log of n.l.
        """
        s = self.slices
        self.sum_nodes(np.flatnonzero(s.stale), control, log_light)
        n, m = self.geometry.shape[0], self.row.size
        value, of_slices, of_panels = np.zeros((3, n))
        panels = self.row, self.blur, self.tail, np.zeros(m), np.zeros(m, int)
        _add_up(s.panel, s.value, s.error, s.most, *panels, value, of_slices, of_panels)
        return value, of_slices * self.doubt, of_panels * self.doubt

    def sum_nodes(self, which: np.ndarray, control: int, log_light: np.ndarray) -> None:
        """Say anew what some slices are worth; see `sums`."""
        s = self.slices
        _, weights, matrices = rules_by_order()
        known = s.panel, s.order, s.first, s.density, s.y, s.log_product, s.log_scale
        rest = self.row, log_light, control == 2, weights, matrices, s.value, s.error, s.most
        side_by_side(lambda part: _sums(which[part], *known, *rest), which.size, _FEW)
        s.stale[which] = False

    def multiply(
        self, curve: LogCurve, cos_theta: np.ndarray, control: int, without: np.ndarray
    ) -> None:
        """Take one step more into the products of all but some slices, which are stale.

        See `divisor.CONTROLS` for `control`.
        """
        s = self.slices
        light = np.empty((2, cos_theta.size))
        light[0] = np.log(np.maximum(cos_theta, LOWEST))
        light[1] = curve.at(folded(cos_theta))
        others = np.ones(s.panel.size, bool)
        others[without] = False
        which = np.flatnonzero(others)
        known = s.panel, s.order, s.first, self.row, s.y, light, control, curve.turns, *curve.pieces
        rest = s.log_product, s.log_scale, s.value, s.error, s.most, s.stale
        side_by_side(lambda part: _multiply(which[part], *known, *rest), which.size, _FEW)

    def sent(
        self,
        control: int,
        log_light: np.ndarray,
        rows: np.ndarray,
        edges: np.ndarray,
        unsure: float = 0.0,
    ) -> Runs:
        """The light that some rows send on, from all runs of nodes in one slice and one piece.

        Parameters
        ----------
        control : int
            See `divisor.CONTROLS`.
        log_light : ndarray, shape (k,)
            Log of n.l of these rows.
        rows : ndarray of int, shape (k,)
        edges : ndarray
            Ends of the pieces in y, ascending.
        unsure : float
            What is no more than this below a cosine may be divided by albedos.
        """
        s = self.slices
        number = np.full(self.geometry.shape[0], -1)
        number[rows] = np.arange(rows.size)
        own = number[self.row[s.panel]]
        slices = np.flatnonzero(own >= 0)
        room = int(s.order[slices].sum())
        row, piece = np.empty(room, int), np.empty(room, int)
        y, share, lowest = np.empty(room), np.empty(room), np.empty(room)
        total = np.zeros(rows.size)
        count = _gather(
            *(slices, own, s.order, s.first, s.y, s.density, s.log_product, s.log_scale),
            *(log_light, control, unsure, edges, rules_by_order()[1]),
            *(row, piece, y, share, lowest, total),
        )
        filled = slice(count)
        return Runs(row[filled], piece[filled], y[filled], share[filled], lowest[filled], total)

    def kinks(
        self,
        curve: LogCurve,
        levels: np.ndarray,
        bends: np.ndarray,
        controlled: bool,
        least: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Slices, and places on their panels, where a kink hides more than `least` of a row.

        The third array tells, as in `Slices.bent`, whether what follows a place (1) or comes
        before it (2) is smooth in the root of the distance from there.

        A kink between the last node of a slice and its end is seen by no spectrum: what may hide
        there is what the curve changes by on the shorter side.

        Parameters
        ----------
        curve : LogCurve
            What the last step divides by.
        levels : ndarray, shape (n, k)
            Coordinates of heights, NaN where there are fewer.
        bends : ndarray
            Those of all rows, ascending.
        controlled : bool
            The heights themselves are divided by, too.
        least : ndarray, shape (n,)
        """
        s = self.slices
        slices = s.panel, s.start, s.end, s.value, s.low, s.high
        panels = self.row, self.code, self.box, self.geometry
        pieces, spread = curve.pieces, curve.spread
        known = levels, bends, curve.bent_sides, least, controlled, *pieces, spread
        most = max(levels.shape[1] + bends.size, 1)

        def find(part: slice) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            step = max(_ROOM // most, 1)
            room = most * min(step, part.stop - part.start)
            out = np.empty(room, int), np.empty(room), np.empty(room, int)
            found = []
            for start in range(part.start, part.stop, step):
                own = [array[start : min(start + step, part.stop)] for array in slices]
                count = _find_kinks(*own, *panels, *known, *out)
                found.append((out[0][:count] + start, *(array[:count].copy() for array in out[1:])))
            empty = [array[:0] for array in out]
            which, place, sides = (np.concatenate(a) for a in zip(empty, *found, strict=True))
            return which, place, sides

        which, place, sides = zip(*side_by_side(find, s.panel.size, _FEW), strict=True)
        return np.concatenate(which), np.concatenate(place), np.concatenate(sides)

    def cut(self, which: np.ndarray, place: np.ndarray, sides: np.ndarray) -> np.ndarray:
        """Cut slices at what `kinks` found; return the numbers of the new ones.

        The products at their nodes are still to be computed.
        """
        s = self.slices
        if which.size == 0:
            return np.empty(0, int)
        hit = np.unique(which)
        owner = np.concatenate((hit, which, hit))
        t = np.concatenate((s.start[hit], place, s.end[hit]))
        side = np.concatenate((s.bent[hit] & 1, sides, s.bent[hit] & 2))
        rank = np.lexsort((t, owner))
        owner, t, side = owner[rank], t[rank], side[rank]
        # Of places that are one the first stays, but for ends of slices.
        ends = np.append(owner[1:] != owner[:-1], True)
        starts = np.append(True, owner[1:] != owner[:-1])
        near = np.append(False, (t[1:] - t[:-1] < _SAME) & ~starts[1:])
        keep = starts | ends | ~near
        before_end = np.append(ends[1:] & (t[1:] - t[:-1] < _SAME), False) & ~starts
        keep &= ~before_end
        owner, t, side = owner[keep], t[keep], side[keep]
        same = np.flatnonzero(owner[1:] == owner[:-1])
        # The first part of every slice takes its place.
        initial = np.append(True, owner[same][1:] != owner[same][:-1])
        same = np.concatenate((same[initial], same[~initial]))
        panel, start, end = s.panel[owner[same]], t[same], t[same + 1]
        bent = (side[same] & 1) | (side[same + 1] & 2)
        order = _orders(self.order[panel], end - start)
        order = np.where(bent > 0, _rungs(_CLUSTERED * order), order)
        return self._put(hit, panel, start, end, order, bent)

    def raised(self, hit: np.ndarray) -> np.ndarray:
        """Give slices more nodes, or halve those that have as many as may be."""
        s = self.slices
        poor = hit[s.order[hit] >= 24]
        rich = hit[s.order[hit] < 24]
        middle = 0.5 * (s.start[poor] + s.end[poor])
        panel = np.concatenate((s.panel[rich], s.panel[poor], s.panel[poor]))
        start = np.concatenate((s.start[rich], s.start[poor], middle))
        end = np.concatenate((s.end[rich], middle, s.end[poor]))
        order = np.concatenate((_rungs(1.5 * s.order[rich]), np.full(2 * poor.size, 20)))
        bent = np.concatenate((s.bent[rich], s.bent[poor] & 1, s.bent[poor] & 2))
        return self._put(np.concatenate((rich, poor)), panel, start, end, order, bent)

    def _put(self, gone: np.ndarray, *parts: np.ndarray) -> np.ndarray:
        """Put new slices in the place of others; see `Slices.put`."""
        s = self.slices
        fresh = s.put(gone, *parts)
        slices = s.panel, s.start, s.end, s.order, s.bent, s.first
        panels = self.row, self.code, self.box, self.order, self.series, self.geometry
        nodes = rules_by_order()[0], s.density, s.y, s.low, s.high
        side_by_side(lambda part: _lay_out(fresh[part], *slices, *panels, *nodes), fresh.size, _FEW)
        return fresh

    def keep(self, rows: np.ndarray) -> None:
        """Give up all rows but some, which are numbered in this order from now on."""
        number = np.full(self.geometry.shape[0], -1)
        number[rows] = np.arange(rows.size)
        self._keep_panels(number[self.row] >= 0)
        self.row = number[self.row]
        for name in _OF_ROWS:
            setattr(self, name, getattr(self, name)[rows])

    def renumber(self, number: np.ndarray) -> None:
        """Put all rows in another order; the new number of each is given."""
        self.row = number[self.row]
        for name in _OF_ROWS:
            setattr(self, name, getattr(self, name)[np.argsort(number)])

    @staticmethod
    def together(found: list[Profiles], which: list[np.ndarray]) -> Profiles:
        """Rows that were found in groups, in the order of the numbers of each."""
        first, *others = found
        for other in others:
            first.extend(other)
        first.renumber(np.concatenate(which))
        return first

    def extend(self, other: Profiles) -> None:
        """Take in the rows of others, after the own ones."""
        rows = np.arange(other.geometry.shape[0]) + self.geometry.shape[0]
        for name in _OF_ROWS:
            setattr(self, name, np.concatenate((getattr(self, name), getattr(other, name))))
        self._take_in(other, rows)

    def replace(self, rows: np.ndarray, other: Profiles) -> None:
        """Put others in the places of some rows."""
        self._keep_panels(~np.isin(self.row, rows))
        for name in _OF_ROWS:
            array = getattr(self, name).copy()
            array[rows] = getattr(other, name)
            setattr(self, name, array)
        self._take_in(other, rows)

    def _keep_panels(self, stays: np.ndarray) -> None:
        """Give up all panels but those that a mask tells."""
        self.slices.keep(stays[self.slices.panel])
        self.slices.panel[:] = (np.cumsum(stays) - 1)[self.slices.panel]
        for name in _OF_PANELS:
            setattr(self, name, getattr(self, name)[stays])

    def _take_in(self, other: Profiles, rows: np.ndarray) -> None:
        """Add the panels and slices of others, whose rows are those."""
        self.slices.extend(other.slices, self.row.size)
        for name in _OF_PANELS:
            more = rows[other.row] if name == "row" else getattr(other, name)
            setattr(self, name, np.concatenate((getattr(self, name), more)))


_OF_ROWS = ("geometry", "doubt", "shift", "ahead")
_OF_PANELS = ("row", "code", "box", "order", "series", "blur", "tail")
_RUNGS = np.array(LADDER)


def _rungs(wanted: np.ndarray) -> np.ndarray:
    """The next orders on the ladder, the highest where there is none."""
    return _RUNGS[np.minimum(np.searchsorted(_RUNGS, wanted), _RUNGS.size - 1)]


def _orders(order: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Nodes for a share of a panel of some order, whose nearest singularity is as far away."""
    return _rungs(np.maximum(_DIGITS / (_DIGITS / order - np.log(share)) + _MORE, _LEAST))


def doubt_of(part: Part, cos_theta: np.ndarray) -> np.ndarray:
    """Relative errors of a part that its own numbers have, for some incidences."""
    own = part.doubt(cos_theta) if callable(part.doubt) else part.doubt
    return np.broadcast_to(own, cos_theta.shape)


def _judge_series(cells: Cells) -> None:
    """Take what series leave out for the errors along v, so far as it is more than rounding."""
    tail = _tails(cells.series, cells.order[:, 1])
    seen = tail > _NOISE * np.abs(cells.series).max(1)
    cells.error[:, 1] = np.where(seen, _SHOWN * tail, 0.0)


def _tails(series: np.ndarray, order: np.ndarray) -> np.ndarray:
    """What series of some lengths leave out, at most."""
    column = np.arange(series.shape[1])
    last = (column >= (order - _WINDOW)[:, None]) & (column < order[:, None])
    tails: np.ndarray = _TAIL * np.abs(np.where(last, series, 0.0)).max(1)
    return tails


def _stacked(cells: Cells) -> tuple[np.ndarray, ...]:
    """Panels of heights, see `Profiles`: no end of a cell lies inside one, and cells that stand
    above it are added up."""
    rank = np.lexsort((cells.box[:, 4], cells.code[:, 0], cells.row))
    key = np.column_stack((cells.row, cells.code[:, 0], cells.box[:, 4]))[rank]
    group = np.empty(rank.size, int)
    group[rank] = np.cumsum(np.append(False, np.any(key[1:] != key[:-1], axis=1)))
    cell, panel, starts, ends = common(group, cells.box[:, 2], cells.box[:, 3])
    # What all cells above a panel have in common, from one of them.
    some = np.empty(starts.size, int)
    some[panel] = cell
    box = cells.box[some].copy()
    box[:, 2], box[:, 3] = starts, ends
    order = np.zeros(starts.size, int)
    np.maximum.at(order, panel, cells.order[cell, 1])
    series = np.zeros((starts.size, TERMS))
    np.add.at(series, panel, restricted(cells, cell, box[panel, 2], box[panel, 3]))
    tail = np.bincount(panel, _tails(cells.series, cells.order[:, 1])[cell], starts.size)
    blur = np.bincount(panel, cells.error[cell, 0], starts.size)
    return cells.row[some], cells.code[some], box, order, series, blur, tail


def common(group: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, ...]:
    """Cut what covers [0, 1] in each group so that no end lies inside a part.

    Parameters
    ----------
    group, low, high : ndarray, shape (m,)
        The group of each cell, from 0 on, and its ends.

    Returns
    -------
    cell, part : ndarray of int
        Which part lies in which cell.
    starts, ends : ndarray
        Of the parts of one group after the other.
    """
    # A group takes up [2 g, 2 g + 1] of one line.
    low, high = 2 * group + low, 2 * group + high
    line = np.unique(np.concatenate((low, high)))
    real = np.flatnonzero(line[1:] // 2 == line[:-1] // 2)
    first, last = np.searchsorted(line[real], low), np.searchsorted(line[real], high)
    cell = np.repeat(np.arange(group.size), last - first)
    begin = np.cumsum(last - first) - (last - first)
    part = np.arange(cell.size) - begin[cell] + first[cell]
    base = 2.0 * (line[real] // 2)
    return cell, part, line[real] - base, line[real + 1] - base


def restricted(
    cells: Cells | Profiles, cell: np.ndarray, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """Series of some cells, or panels, on parts of them, which is exact."""
    series = cells.series[cell]
    start, size = cells.box[cell, 2], cells.box[cell, 3] - cells.box[cell, 2]
    part = np.flatnonzero(high - low < size)
    if part.size:
        rule = gauss(TERMS)
        share = ((high - low) / size)[part, None]
        t = ((low - start) / size)[part, None] + share * rule.nodes
        values = np.einsum("mjk,mk->mj", legvander(2.0 * t - 1.0, TERMS - 1), series[part])
        series[part] = share * values @ rule.to_coefficients
    return series


# Legendre's recurrence, and no division in a loop.
_DEGREE = np.arange(TERMS)
_RISE, _FALL = (2.0 * _DEGREE + 1.0) / (_DEGREE + 1.0), (_DEGREE + 1.0) / (_DEGREE + 2.0)


@kernel
def _height(g, side, power, box, t):
    """Elevation of V at a place of a panel."""
    x, _ = clustered(box[2] + (box[3] - box[2]) * t, power)
    return elevation(g, side, box[4] + (box[5] - box[4]) * x)[0]


@kernel
def _place(g, side, power, box, e_v):
    """The place on a panel where V has an elevation."""
    x = (stretched(g, side, e_v) - box[4]) / (box[5] - box[4])
    x = min(max(x, 0.0), 1.0)
    if power == 1:
        x = math.sqrt(x)
    elif power == 2:
        x = 1.0 - math.sqrt(1.0 - x)
    elif power == 3:
        # x = sin(a)^2 has the place 1/2 + sin(2 a/3 - pi/6 ...): the root of 3 t^2 - 2 t^3 = x.
        x = 0.5 - math.sin(math.asin(1.0 - 2.0 * x) / 3.0)
    elif power == 4:
        x = 1.0 - math.sqrt(math.sqrt(1.0 - x))
    return (x - box[2]) / (box[3] - box[2])


@kernel
def _larger(geometry, code, box, at_l, parts, cells, found):
    """Fill the larger albedo of L and V on panels, in logarithms: the least, and in the middle."""
    for k in range(at_l.size):
        found[0, k] = math.inf
        for i in range(3):
            e_v = _height(geometry[k], code[k, 0], code[k, 3], box[k], 0.5 * i)
            value = max(curve_at(fold_elevation(e_v), parts, cells, 0), at_l[k])
            found[0, k] = min(found[0, k], value)
            if i == 1:
                found[1, k] = value


@kernel
def _share(order, row, least, middle, held, steps, found):
    """Fill what `Ahead.shares` finds; `order` has the panels of each row, from the darkest on."""
    found[:] = math.inf
    for k in steps:
        whole, first = 0.0, 0
        while first < order.size:
            # Panels that are equally dark stand for each other.
            last, i = first, order[first]
            while last < order.size and row[order[last]] == row[i]:
                if middle[order[last]] != middle[i]:
                    break
                whole += held[order[last]] * math.exp(-k * middle[i])
                last += 1
            for j in order[first:last]:
                found[j] = min(found[j], whole * math.exp(k * least[j]))
            if last < order.size and row[order[last]] != row[i]:
                whole = 0.0
            first = last


@kernel
def _share_clamped(order, row, geometry, code, box, held, found):
    """Lower what `_share` found to what is held, of panels over any cosine; `order` has the panels
    of each row together.

    A panel is divided by x = max(n.l, n.v) as soon as the product is that small; those with larger
    cosines are divided by theirs, and those with smaller ones by as much.
    """
    least, most = np.empty(row.size), np.empty(row.size)
    for k in range(row.size):
        g = geometry[row[k]]
        c_0 = math.sin(_height(g, code[k, 0], code[k, 3], box[k], 0.0))
        c_1 = math.sin(_height(g, code[k, 0], code[k, 3], box[k], 1.0))
        least[k] = max(min(c_0, c_1), g[0], LOWEST)
        most[k] = max(max(c_0, c_1), g[0], LOWEST)
    first = 0
    while first < order.size:
        last = first
        while last < order.size and row[order[last]] == row[order[first]]:
            last += 1
        for j in order[first:last]:
            whole = 0.0
            for i in order[first:last]:
                whole += held[i] * min(1.0, least[j] / most[i])
            found[j] = min(found[j], whole)
        first = last


@kernel
def _lay_out(
    fresh,
    panel,
    start,
    end,
    order,
    bent,
    first,
    row,
    code,
    box,
    length,
    series,
    geometry,
    nodes,
    density,
    y,
    low,
    high,
):
    """Fill the nodes of slices, integrals around rings by Clenshaw's sum and heights, and ends."""
    u, last, before = np.empty(TERMS), np.empty(TERMS), np.empty(TERMS)
    for k in fresh:
        i, q = panel[k], order[k]
        g, side, power = geometry[row[i]], code[i, 0], code[i, 3]
        size = end[k] - start[k]
        for j in range(q):
            x, slope = clustered(nodes[q, j], bent[k])
            t = start[k] + size * x
            density[first[k] + j] = size * slope
            y[first[k] + j] = fold_elevation(_height(g, side, power, box[i], t))
            u[j] = 2.0 * t - 1.0
            last[j] = before[j] = 0.0
        # Nodes inside: what is done for all of them at once does not wait for the term before.
        for m in range(length[i] - 1, 0, -1):
            term, rise, fall = series[i, m], _RISE[m], _FALL[m]
            for j in range(q):
                here = term + (rise * u[j] * last[j] - fall * before[j])
                before[j] = last[j]
                last[j] = here
        for j in range(q):
            density[first[k] + j] *= series[i, 0] + u[j] * last[j] - 0.5 * before[j]
        y_0 = fold_elevation(_height(g, side, power, box[i], start[k]))
        y_1 = fold_elevation(_height(g, side, power, box[i], end[k]))
        low[k], high[k] = min(y_0, y_1), max(y_0, y_1)


@kernel
def _sums(
    slices,
    panel,
    order,
    first,
    density,
    y,
    log_product,
    log_scale,
    row,
    log_light,
    clamped,
    weights,
    matrices,
    value,
    error,
    most,
):
    """Fill what some slices are worth."""
    spectrum, along = np.empty(32), np.empty(32)
    for k in slices:
        q = order[k]
        most[k] = 0.0
        for j in range(q):
            product = log_product[first[k] + j] + log_scale[k]
            if clamped:
                product = max(product, log_height(y[first[k] + j]), log_light[row[panel[k]]])
            scale = math.exp(-product)
            along[j] = density[first[k] + j] * scale
            most[k] = max(most[k], scale)
        matrix = matrices[q, : q * q].reshape(q, q)
        hidden = fill_spectrum(along[:q], weights[q, :q], matrix, spectrum)
        error[k] = max(stopping_bound(spectrum[:q]), hidden)
        value[k] = spectrum[0]


@kernel
def _add_up(
    panel, value, error, most, row, blur, tail, largest, count, total, of_slices, of_panels
):
    """Add slices up to rows, and bounds of panels; `largest` and `count` are room for panels."""
    for k in range(panel.size):
        i = panel[k]
        total[row[i]] += value[k]
        of_slices[row[i]] += error[k]
        largest[i] = max(largest[i], most[k])
        count[i] += 1
    for i in range(row.size):
        # The series of a panel that is one slice is read at its own nodes.
        left_out = tail[i] if count[i] > 1 else 0.0
        of_panels[row[i]] += (blur[i] + left_out) * largest[i]


@kernel
def _gather(
    slices,
    own,
    order,
    first,
    y,
    density,
    log_product,
    log_scale,
    log_light,
    control,
    unsure,
    edges,
    weights,
    row,
    piece,
    place,
    share,
    lowest,
    total,
):
    """Fill the runs of `Profiles.sent`, and add to the totals; return how many there are."""
    count = -1
    for k in slices:
        r, q = own[k], order[k]
        at, most = -1, 0.0
        for j in range(q):
            i = first[k] + j
            floor = max(log_height(y[i]), log_light[r]) if control != 0 else -math.inf
            product = log_product[i] + log_scale[k]
            free = control != 2 or product >= floor - unsure
            if control == 2:
                product = max(product, floor)
            light = density[i] * math.exp(-product) * weights[q, j]
            total[r] += light
            if at < 0 or not edges[at] <= y[i] < edges[at + 1]:
                at = min(max(np.searchsorted(edges, y[i], side="right") - 1, 0), edges.size - 2)
                count += 1
                row[count], piece[count], share[count], most = r, at, 0.0, -1.0
            if abs(light) > most:
                most, place[count] = abs(light), y[i]
                lowest[count] = floor - unsure if control == 1 else -math.inf
            if free:
                share[count] += light
    return count + 1


@kernel
def _multiply(
    slices,
    panel,
    order,
    first,
    row,
    y,
    light,
    control,
    turns,
    parts,
    cells,
    log_product,
    log_scale,
    value,
    error,
    most,
    stale,
):
    """Add the log of what a step divides by at the nodes of some slices.

    Where L has the larger albedo, it is the same for all of them.
    """
    at_v = np.empty(TERMS)
    for k in slices:
        r = row[panel[k]]
        at_l = light[1, r]
        begin, end = first[k], first[k] + order[k]
        if control != 1:
            low, high = min(y[begin], y[end - 1]), max(y[begin], y[end - 1])
            if is_below(low, high, at_l, parts, cells, 0, turns):
                log_scale[k] += at_l
                if control == 2:
                    stale[k] = True
                else:
                    scale = math.exp(-at_l)
                    value[k] *= scale
                    error[k] *= scale
                    most[k] *= scale
                continue
        stale[k] = True
        curve_along(y, begin, end, parts, cells, 0, at_v)
        for j in range(begin, end):
            step = max(at_v[j - begin], at_l)
            if control == 1:
                step = max(step, log_height(y[j]), light[0, r])
            log_product[j] += step


@kernel
def _find_kinks(
    panel,
    start,
    end,
    value,
    low,
    high,
    row,
    code,
    box,
    geometry,
    levels,
    bends,
    bent_sides,
    least,
    controlled,
    parts,
    cells,
    spread,
    which,
    place,
    sides,
):
    """Fill slices and places of kinks that hide enough; return how many there are."""
    count = 0
    # More than the whole curve cannot hide.
    reach = math.inf if controlled else spread
    change, y_end = np.empty(2), np.empty(2)
    for k in range(panel.size):
        i = panel[k]
        r = row[i]
        if value[k] * reach < least[r]:
            continue
        own = levels.shape[1]
        after = np.searchsorted(bends, low[k], side="right")
        for m in range(own + bends.size - after):
            level = levels[r, m] if m < own else bends[after + m - own]
            if m >= own and level >= high[k]:
                break
            # Not where there is no level.
            if not low[k] < level < high[k]:
                continue
            y_end[0], y_end[1] = low[k], high[k]
            here = curve_at(level, parts, cells, 0)
            # Of the two sides of a maximum one may be constant: what changes is the other one.
            for side_of in range(2):
                change[side_of] = 0.0
                for half in range(2):
                    y = level + (0.5 + 0.5 * half) * (y_end[side_of] - level)
                    moved = abs(curve_at(y, parts, cells, 0) - here)
                    if controlled:
                        moved += abs(log_height(y) - log_height(level))
                    change[side_of] = max(change[side_of], moved)
            if value[k] * min(change[0], change[1]) > least[r]:
                which[count] = k
                e_v = elevation_at(level)
                place[count] = _place(geometry[r], code[i, 0], code[i, 3], box[i], e_v)
                sides[count] = bent_sides[after + m - own] if m >= own else 0
                if _height(geometry[r], code[i, 0], code[i, 3], box[i], start[k]) > e_v:
                    # What is above comes before.
                    sides[count] = (sides[count] >> 1) | ((sides[count] & 1) << 1)
                if start[k] < place[count] < end[k]:
                    count += 1
    return count
