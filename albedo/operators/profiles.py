"""Integrals around rings over what they are divided by, at many incidences: a sum for each step.

A *slice* is a part of a panel (`albedo.operators.panels`), with a Gauss rule of its own on which
the panel's series is read. So a panel is cut where a divisor has a kink without computing the
model again, and a step of pumping-up costs a sum over the nodes of slices. What a rule errs by is
read from its spectrum.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from albedo._compile import kernel
from albedo._threads import by_weight, side_by_side
from albedo.charts._compiled import clustered
from albedo.charts.heights import LOWEST, elevation_at, folded, log_height
from albedo.integrators.cells import fill_spectrum, rules_by_order
from albedo.integrators.rules import LADDER, stopping_bound
from albedo.operators.divisor import LogCurve, curve_along, curve_at, is_below, packed
from albedo.operators.panels import (
    OF_PANELS,
    OF_ROWS,
    TERMS,
    Panels,
    fill_heights,
    fill_legendre,
    height_at,
    place_at,
)
from albedo.special import exp

# A panel has nodes for this many e-folds of its error; a part of one has a few more than that
# takes, for what it is divided by, and this many at least.
_DIGITS, _MORE, _LEAST = 27.6, 4.0, 8.0
# Where nodes are clustered there are so many times more: what is smooth has twice the degree.
_CLUSTERED = 1.5
# Slices, and numbers that are moved, that are worth another thread.
_FEW, _MANY = 300, 20_000
# Pairs of slices and places that are looked at at once: few slices have any, and each may have all.
_ROOM = 1_000_000
# Nodes are moved together when there are so many for each that is used.
_HOLES = 2
# What is divided by e to less than minus this has no factor among the numbers that `exp` gives.
_FULL = 700.0
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


@kernel
def _put(
    gone,
    panel,
    start,
    end,
    order,
    bent,
    nodes,
    where,
    panels,
    starts,
    ends,
    orders,
    bends,
    first,
    value,
    error,
    most,
    lift,
    log_scale,
    stale,
):
    """Put slices in the places of those that are gone, and of the last ones; return how many nodes
    there are then, of so many."""
    begin = panels.size - panel.size
    for i in range(panel.size):
        k = gone[i] if i < gone.size else begin + i
        # Where there is room the nodes of old slices are taken up.
        if i >= gone.size or order[i] > orders[k]:
            first[k] = nodes
            nodes += order[i]
        if i >= gone.size:
            value[k] = error[k] = most[k] = lift[k] = 0.0
        where[i] = k
        panels[k], starts[k], ends[k] = panel[i], start[i], end[i]
        orders[k], bends[k] = order[i], bent[i]
        log_scale[k], stale[k] = 0.0, True
    return nodes


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
        (count,) = {len(a) for a in more.values()}
        self.lengthen(count)
        for name, array in self.arrays.items():
            array[self.size - count : self.size] = more.get(name, 0)

    def lengthen(self, count: int) -> None:
        """Append entries that are still to be filled."""
        last = self.size + count
        for name, array in self.arrays.items():
            if last > len(array):
                # Pages that are not touched cost nothing.
                room = np.empty((2 * last, *array.shape[1:]), array.dtype)
                room[: self.size] = array[: self.size]
                self.arrays[name] = room
        self.size = last

    def emptied(self) -> _Store:
        """The same room with nothing in it."""
        return _Store(self.arrays, 0)

    def keep(self, number: np.ndarray) -> None:
        """Give up all entries but those of these numbers, which ascend."""
        arrays = list(self.arrays.values())

        def keep_in(which: slice) -> None:
            for array in arrays[which]:
                if array.ndim == 1:
                    _move_up(array, number)
                else:
                    array[: number.size] = array[number]

        by_weight(keep_in, np.full(len(arrays), number.size), _MANY)
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
    value, error, most, lift : ndarray
        What it was last worth, the bound of its rule, the largest factor of its nodes, and the
        integral of the factor over its part of the panel.
    log_scale : ndarray
        Logarithm of what all of its nodes are divided by, besides their own products.
    low, high : ndarray
        Coordinates of n.v at its ends, in ascending order.
    stale : ndarray of bool
        Whether its value, error and most are to be computed again.
    density, y, log_product : ndarray
        Of nodes: the integral around the ring, per unit of the rule; coordinate of n.v, which
        rises or falls along a slice; logarithm of the product of the divisors of all steps.

    Parameters
    ----------
    room : Slices, optional
        Others that are not read any more, whose memory is used again.
    """

    panel, start, end = _Column("_slices"), _Column("_slices"), _Column("_slices")
    order, first, stale = _Column("_slices"), _Column("_slices"), _Column("_slices")
    bent = _Column("_slices")
    value, error = _Column("_slices"), _Column("_slices")
    most, lift = _Column("_slices"), _Column("_slices")
    log_scale, low, high = _Column("_slices"), _Column("_slices"), _Column("_slices")
    _slices: _Store
    _nodes: _Store
    density, y, log_product = _Column("_nodes"), _Column("_nodes"), _Column("_nodes")

    def __init__(self, room: Slices | None = None) -> None:
        if room is not None:
            self._slices, self._nodes = room._slices.emptied(), room._nodes.emptied()
            return
        whole = dict.fromkeys(("panel", "order", "bent", "first"), np.empty(0, int))
        names = ("start", "end", "value", "error", "most", "lift", "log_scale", "low", "high")
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
        self._slices.lengthen(panel.size - gone.size)
        where = np.empty(panel.size, int)
        own = self.panel, self.start, self.end, self.order, self.bent, self.first
        rest = self.value, self.error, self.most, self.lift, self.log_scale, self.stale
        nodes = self._nodes.size
        last = _put(gone, panel, start, end, order, bent, nodes, where, *own, *rest)
        self._nodes.lengthen(last - nodes)
        return where

    def keep(self, which: np.ndarray) -> None:
        """Give up all slices but those that a mask tells."""
        self._slices.keep(np.flatnonzero(which))
        used = int(self.order.sum())
        if _HOLES * used >= self._nodes.size:
            return
        rank = np.argsort(self.first)
        first, order = self.first[rank], self.order[rank]
        arrays = list(self._nodes.arrays.values())

        def close_up(which: slice) -> None:
            for array in arrays[which]:
                _close_up(array, first, order)

        by_weight(close_up, np.full(len(arrays), used), _MANY)
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
class StepKinks:
    """Where one step has kinks.

    Attributes
    ----------
    curve : LogCurve
        What it divides by.
    levels : ndarray, shape (n, k)
        Coordinates of heights for each row, NaN where there are fewer.
    bends : ndarray
        Those of all rows, ascending: the bends of the curve, or none.
    """

    curve: LogCurve
    levels: np.ndarray
    bends: np.ndarray


class Profiles:
    """Rows and panels that are cut into slices, at first one for each.

    Parameters
    ----------
    panels : Panels
        Their arrays are taken over.
    room : Slices, optional
        See `Slices`.

    Attributes
    ----------
    geometry, doubt, shift, ahead : ndarray, shape (n, ...), (n,), (n,), (n,)
        Of the rows, see `albedo.operators.panels.Panels`.
    row, code, box, order, series, blur, tail : ndarray, shape (m, ...)
        Of the panels.
    slices : Slices
    """

    row, code, box = _Column("_panels"), _Column("_panels"), _Column("_panels")
    order, series = _Column("_panels"), _Column("_panels")
    blur, tail = _Column("_panels"), _Column("_panels")

    def __init__(self, panels: Panels, room: Slices | None = None) -> None:
        self.geometry, self.doubt = panels.geometry, panels.doubt
        self.shift, self.ahead = panels.shift, panels.ahead
        m = panels.row.size
        self._panels = _Store({name: getattr(panels, name) for name in OF_PANELS}, m)
        self.slices = Slices(room)
        ends = np.zeros(m), np.ones(m)
        self._put(np.empty(0, int), np.arange(m), *ends, self.order, np.zeros(m, int))
        self.slices.log_product[:] = 0.0

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
        panels = self.row, self.blur, self.tail, *np.zeros((2, m)), np.zeros(m, int)
        slices = s.panel, s.value, s.error, s.most, s.lift
        _add_up(*slices, *panels, value, of_slices, of_panels)
        return value, of_slices * self.doubt, of_panels * self.doubt

    def sum_nodes(self, which: np.ndarray, control: int, log_light: np.ndarray) -> None:
        """Say anew what some slices are worth; see `sums`."""
        s = self.slices
        known = s.panel, s.start, s.end, s.order, s.bent, s.first, s.density, s.y, s.log_product
        rules = s.log_scale, self.row, log_light, control == 2, *rules_by_order()
        rest = *rules, s.value, s.error, s.most, s.lift
        side_by_side(lambda part: _sums(which[part], *known, *rest), which.size, _FEW)
        s.stale[which] = False

    def multiply(
        self, curves: Sequence[LogCurve], cos_theta: np.ndarray, control: int, without: np.ndarray
    ) -> None:
        """Take some steps more into the products of all but some slices, which are stale.

        See `divisor.CONTROLS` for `control`.
        """
        s = self.slices
        others = np.ones(s.panel.size, bool)
        others[without] = False
        which = np.flatnonzero(others)
        log_light, y_l = np.log(np.maximum(cos_theta, LOWEST)), folded(cos_theta)
        known = s.panel, s.order, s.first, self.row, s.y, control, log_light
        rest = s.log_product, s.log_scale, s.value, s.error, s.most, s.lift, s.stale
        steps = [(curve.at(y_l), curve.turns, *curve.pieces) for curve in curves]

        def multiply(part: slice) -> None:
            for step in steps:
                _multiply(which[part], *known, *step, *rest)

        side_by_side(multiply, which.size, max(_FEW // max(len(steps), 1), 1))

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
        wanted, number = np.zeros((2, self.geometry.shape[0]), int)
        wanted[rows], number[rows] = 1, np.arange(rows.size)
        slices, own = self.of_rows(wanted > 0)
        own = number[own]
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
        self, known: Sequence[StepKinks], controlled: bool, least: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Slices, and places on their panels, where a kink hides more than `least` of a row.

        The third array tells, as in `Slices.bent`, whether what follows a place (1) or comes
        before it (2) is smooth in the root of the distance from there.

        A kink between the last node of a slice and its end is seen by no spectrum: what may hide
        there is what the curve changes by on the shorter side.

        Parameters
        ----------
        known : sequence of StepKinks
            Of the last steps.
        controlled : bool
            The heights themselves are divided by, too.
        least : ndarray, shape (n,)
        """
        s = self.slices
        slices = s.panel, s.start, s.end, s.value, s.low, s.high
        panels = self.row, self.code, self.box, self.geometry
        curves = [step.curve for step in known]
        widths = [step.levels.shape[1] for step in known]
        counts = [step.bends.size for step in known]
        levels = np.concatenate([step.levels for step in known], axis=1)
        bends = np.concatenate([step.bends for step in known])
        sides_of = np.concatenate([step.curve.bent_sides[: step.bends.size] for step in known])
        # More than the whole curve cannot hide.
        reach = np.array([np.inf if controlled else curve.spread for curve in curves])
        ends = np.cumsum([0, *widths]), np.cumsum([0, *counts])
        rest = levels, bends, sides_of, *ends, reach, least, controlled, *packed(curves)
        most = max(levels.shape[1] + bends.size, 1)

        def find(part: slice) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            step = max(_ROOM // most, 1)
            room = most * min(step, part.stop - part.start)
            out = np.empty(room, int), np.empty(room), np.empty(room, int)
            found = []
            for start in range(part.start, part.stop, step):
                own = [array[start : min(start + step, part.stop)] for array in slices]
                count = _find_kinks(*own, *panels, *rest, *out)
                found.append((out[0][:count] + start, *(array[:count].copy() for array in out[1:])))
            empty = [array[:0] for array in out]
            which, place, sides = (np.concatenate(a) for a in zip(empty, *found, strict=True))
            return which, place, sides

        found = side_by_side(find, s.panel.size, max(_FEW // len(known), 1))
        which, place, sides = zip(*found, strict=True)
        return np.concatenate(which), np.concatenate(place), np.concatenate(sides)

    def cut(self, which: np.ndarray, place: np.ndarray, sides: np.ndarray) -> np.ndarray:
        """Cut slices at what `kinks` found; return the numbers of the new ones.

        The products at their nodes are still to be computed.
        """
        s = self.slices
        if which.size == 0:
            return np.empty(0, int)
        rank = np.argsort(which, kind="stable")
        ordered = which[rank]
        hit = ordered[np.diff(ordered, prepend=-1) > 0]
        # The first part of every slice takes its place, and the others follow.
        room = hit.size + which.size
        fresh = tuple(np.empty(room, kind) for kind in (int, float, float, int, int))
        slices = s.panel, s.start, s.end, s.bent
        count = _cut(hit, rank, which, place, sides, *slices, self.order, *fresh)
        return self._put(hit, *(array[:count] for array in fresh))

    def of_rows(self, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The slices of rows that a mask tells, and the row of each."""
        panel = self.slices.panel
        which, row = np.empty(panel.size, int), np.empty(panel.size, int)
        count = _of_rows(wanted, panel, self.row, which, row)
        return which[:count], row[:count]

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
        self.row[:] = number[self.row]
        for name in OF_ROWS:
            setattr(self, name, getattr(self, name)[rows])

    def extend(self, other: Profiles) -> None:
        """Take in the rows of others, after the own ones."""
        rows = np.arange(other.geometry.shape[0]) + self.geometry.shape[0]
        for name in OF_ROWS:
            setattr(self, name, np.concatenate((getattr(self, name), getattr(other, name))))
        self._take_in(other, rows)

    def replace(self, rows: np.ndarray, other: Profiles) -> None:
        """Put others in the places of some rows."""
        self._keep_panels(~np.isin(self.row, rows))
        for name in OF_ROWS:
            array = getattr(self, name).copy()
            array[rows] = getattr(other, name)
            setattr(self, name, array)
        self._take_in(other, rows)

    def _keep_panels(self, stays: np.ndarray) -> None:
        """Give up all panels but those that a mask tells."""
        self.slices.keep(stays[self.slices.panel])
        self.slices.panel[:] = (np.cumsum(stays) - 1)[self.slices.panel]
        self._panels.keep(np.flatnonzero(stays))

    def _take_in(self, other: Profiles, rows: np.ndarray) -> None:
        """Add the panels and slices of others, whose rows are those."""
        self.slices.extend(other.slices, self.row.size)
        columns = {name: getattr(other, name) for name in OF_PANELS}
        self._panels.append(**{**columns, "row": rows[other.row]})


_RUNGS = np.array(LADDER)


def _rungs(wanted: np.ndarray) -> np.ndarray:
    """The next orders on the ladder, the highest where there is none."""
    return _RUNGS[np.minimum(np.searchsorted(_RUNGS, wanted), _RUNGS.size - 1)]


@kernel
def _of_rows(wanted, panel, row, which, own):
    """Fill the slices of rows that are wanted, and their rows; return how many there are."""
    count = 0
    for k in range(panel.size):
        r = row[panel[k]]
        if wanted[r]:
            which[count], own[count] = k, r
            count += 1
    return count


@kernel
def _cut(
    hit, rank, which, place, sides, panel, start, end, bent, length, own, low, high, order, bends
):
    """Fill the parts of slices that are cut, the first ones first; return how many there are.

    `rank` has the places of the slices that are hit, one slice after the other.
    """
    count, i = hit.size, 0
    for m in range(hit.size):
        k, begin = hit[m], i
        while i < rank.size and which[rank[i]] == k:
            i += 1
        # Each has few.
        for last in range(begin + 1, i):
            one, at = rank[last], last
            while at > begin and place[rank[at - 1]] > place[one]:
                rank[at] = rank[at - 1]
                at -= 1
            rank[at] = one
        at, side, before = start[k], bent[k] & 1, start[k]
        where = m
        for last in range(begin, i + 1):
            t, sides_of = (place[rank[last]], sides[rank[last]]) if last < i else (end[k], bent[k])
            # Of places that are one the first stays, but for ends of slices.
            near, before = t - before < _SAME, t
            if last < i and (near or end[k] - t < _SAME):
                continue
            own[where], low[where], high[where] = panel[k], at, t
            bends[where] = (side & 1) | (sides_of & 2)
            order[where] = _order_of(length[panel[k]], t - at, bends[where] > 0)
            at, side = t, sides_of
            if last < i:
                where = count
                count += 1
    return count


@kernel
def _order_of(length, share, bent):
    """Nodes for a share of a panel of some order, whose nearest singularity is as far away."""
    wanted = max(_DIGITS / (_DIGITS / length - math.log(share)) + _MORE, _LEAST)
    last = _RUNGS.size - 1
    found = _RUNGS[min(np.searchsorted(_RUNGS, wanted), last)]
    if bent:
        found = _RUNGS[min(np.searchsorted(_RUNGS, _CLUSTERED * found), last)]
    return found


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
    held = np.empty(TERMS)
    place, room, height = np.empty(TERMS + 2), np.empty(TERMS + 2), np.empty(TERMS + 2)
    for k in fresh:
        i, q, begin = panel[k], order[k], first[k]
        g, side, power = geometry[row[i]], code[i, 0], code[i, 3]
        size = end[k] - start[k]
        for j in range(q):
            x, slope = clustered(nodes[q, j], bent[k])
            place[j] = start[k] + size * x
            density[begin + j] = size * slope
            u[j] = 2.0 * place[j] - 1.0
        place[q], place[q + 1] = start[k], end[k]
        whole = q + 2
        fill_heights(g, side, power, box[i], place[:whole], room[:whole], height[:whole])
        fill_legendre(series[i], length[i], u[:q], last, before, held)
        for j in range(q):
            y[begin + j] = height[j]
            density[begin + j] *= held[j]
        low[k], high[k] = min(height[q], height[q + 1]), max(height[q], height[q + 1])


@kernel
def _sums(
    slices,
    panel,
    start,
    end,
    order,
    bent,
    first,
    density,
    y,
    log_product,
    log_scale,
    row,
    log_light,
    clamped,
    nodes,
    weights,
    matrices,
    value,
    error,
    most,
    lift,
):
    """Fill what some slices are worth."""
    spectrum, along, scale = np.empty(TERMS), np.empty(TERMS), np.empty(TERMS)
    for k in slices:
        q, begin, shift, size = order[k], first[k], log_scale[k], end[k] - start[k]
        for j in range(q):
            scale[j] = log_product[begin + j] + shift
        if clamped:
            l_l = log_light[row[panel[k]]]
            for j in range(q):
                scale[j] = max(scale[j], log_height(y[begin + j]), l_l)
        # Loops without a branch or a call run side by side.
        least = math.inf
        for j in range(q):
            least = min(least, scale[j])
        if least > -_FULL:
            for j in range(q):
                scale[j] = exp(-scale[j])
        else:
            for j in range(q):
                scale[j] = math.exp(-scale[j])
        largest = mean = 0.0
        for j in range(q):
            along[j] = density[begin + j] * scale[j]
            largest = max(largest, scale[j])
        for j in range(q):
            _, slope = clustered(nodes[q, j], bent[k])
            mean += slope * weights[q, j] * scale[j]
        most[k], lift[k] = largest, size * mean
        matrix = matrices[q, : q * q].reshape(q, q)
        hidden = fill_spectrum(along[:q], weights[q, :q], matrix, spectrum)
        error[k] = max(stopping_bound(spectrum[:q]), hidden)
        value[k] = spectrum[0]


@kernel
def _add_up(
    panel,
    value,
    error,
    most,
    lift,
    row,
    blur,
    tail,
    largest,
    lifted,
    count,
    total,
    of_slices,
    of_panels,
):
    """Add slices up to rows, and bounds of panels.

    `largest`, `lifted` and `count` are room for panels: the largest factor, its mean, and how many
    slices there are.
    """
    for k in range(panel.size):
        i = panel[k]
        total[row[i]] += value[k]
        of_slices[row[i]] += error[k]
        largest[i] = max(largest[i], most[k])
        lifted[i] += lift[k]
        count[i] += 1
    for i in range(row.size):
        # Nobody knows at which heights rings err. What a series leaves out is as much at any of
        # them, and that of a panel that is one slice is read at its own nodes.
        left_out = tail[i] * lifted[i] if count[i] > 1 else 0.0
        of_panels[row[i]] += blur[i] * largest[i] + left_out


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
    for m in range(slices.size):
        k = slices[m]
        r, q = own[m], order[k]
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
    control,
    log_light,
    own,
    turns,
    parts,
    cells,
    log_product,
    log_scale,
    value,
    error,
    most,
    lift,
    stale,
):
    """Add the log of what a step divides by at the nodes of some slices.

    Where L has the larger albedo, it is the same for all of them. `own` has that of each row.
    """
    at_v = np.empty(TERMS)
    for k in slices:
        r = row[panel[k]]
        at_l = own[r]
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
                    lift[k] *= scale
                continue
        stale[k] = True
        curve_along(y, begin, end, parts, cells, 0, at_v)
        for j in range(begin, end):
            step = max(at_v[j - begin], at_l)
            if control == 1:
                step = max(step, log_height(y[j]), log_light[r])
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
    sides_of,
    level_ends,
    bend_ends,
    reach,
    least,
    controlled,
    parts,
    cells,
    which,
    place,
    sides,
):
    """Fill slices and places of kinks that hide enough; return how many there are.

    Step j has the levels, and bends, from one of `level_ends`, and `bend_ends`, to the next.
    """
    count = 0
    change, y_end = np.empty(2), np.empty(2)
    for k in range(panel.size):
        i = panel[k]
        r = row[i]
        for j in range(reach.size):
            if value[k] * reach[j] < least[r]:
                continue
            first, last = level_ends[j], level_ends[j + 1]
            inside, stop = bend_ends[j], bend_ends[j + 1]
            inside += np.searchsorted(bends[inside:stop], low[k], side="right")
            for m in range(first, last + stop - inside):
                level = levels[r, m] if m < last else bends[inside + m - last]
                if m >= last and level >= high[k]:
                    break
                # Not where there is no level.
                if not low[k] < level < high[k]:
                    continue
                y_end[0], y_end[1] = low[k], high[k]
                here = curve_at(level, parts, cells, j)
                # Of the two sides of a maximum one may be constant: what changes is the other one.
                for side_of in range(2):
                    change[side_of] = 0.0
                    for half in range(2):
                        y = level + (0.5 + 0.5 * half) * (y_end[side_of] - level)
                        moved = abs(curve_at(y, parts, cells, j) - here)
                        if controlled:
                            moved += abs(log_height(y) - log_height(level))
                        change[side_of] = max(change[side_of], moved)
                if value[k] * min(change[0], change[1]) > least[r]:
                    which[count] = k
                    e_v = elevation_at(level)
                    place[count] = place_at(geometry[r], code[i, 0], code[i, 3], box[i], e_v)
                    sides[count] = sides_of[inside + m - last] if m >= last else 0
                    if height_at(geometry[r], code[i, 0], code[i, 3], box[i], start[k]) > e_v:
                        # What is above comes before.
                        sides[count] = (sides[count] >> 1) | ((sides[count] & 1) << 1)
                    if start[k] < place[count] < end[k]:
                        count += 1
    return count
