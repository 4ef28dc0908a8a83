"""Nested quadrature over the panels of a chart, many rows at once, with a bound on every value.

A *row* is one integral: a direction of incidence and a set of parameters. Each row is cut into
*cells*, at first the panels of its chart; on a cell stands a tensor Gauss-Legendre rule whose
order is chosen per direction. The error of a cell is the sum of the errors of the two marginals,
each read from the fall of its Legendre spectrum (`albedo.integrators.rules`). Where that is too
large the order is raised to what the fall promises, or the cell is cut in two.

Whenever a cell is computed again, what moved is a measurement of the old error. It serves twice:
the new bound need not be larger than a few times of it, and must not claim a faster fall than
geometric; and if it exceeds the old bound, all bounds of the row grow by the same factor.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from albedo._compile import kernel
from albedo.charts.scan import LEAST, ScanChart
from albedo.errors import InputError
from albedo.integrators.cells import (
    HIDDEN,
    MOMENTS,
    Cells,
    Chart,
    Integrand,
    compile_cells,
    evaluate,
    of_rows,
    probe_cells,
    whole_rings,
)
from albedo.integrators.rules import LADDER, RUNGS

_EPS = np.finfo(np.float64).eps
_RUNGS = np.array(RUNGS)
_TOP, _TOP_AROUND = LADDER[-1], RUNGS[-1]
# Nodes that whole rings are first seen with.
_ON_RINGS = 16
# Each number that a chart or a kernel hands on carries a few roundings.
_ROUNDINGS = 40.0
_ROUNDS = 60
_UNSELECTED = 1
_GROWTH = 0.65
# Rows of more panels than this are first seen with few nodes: at grazing angles most panels hold
# next to nothing. Fewer than six coefficients tell of no fall, only of the size.
_CROWD, _GLANCE = 16, 4
# A look tells a row to a tenth: enough to share a tolerance, and what it takes is not lost.
_LOOK = 0.1
# Cells that others take over are better than asked for by this: most of them do there as well.
_AHEAD = 0.5
# What moved, times this, bounds the error of the finer rule, and the fall that it may claim.
_TRUST = 8.0
# Errors of more times what is seen of a cell tell that it has not been seen.
_UNSEEN = 0.1 * HIDDEN


@dataclass
class Result:
    """Values of all rows, with what they are worth."""

    value: np.ndarray
    error: np.ndarray
    evaluations: np.ndarray
    converged: np.ndarray


@dataclass
class Refined:
    """Cells on which the integrals of all rows are known, before rounding is told.

    Attributes
    ----------
    geometry : ndarray
        What the chart told of every row.
    cells : Cells
        All cells, with what was measured of them.
    doubt : ndarray, shape (n,)
        Factors of the bounds of the rows.
    spent, rounds, panels : ndarray of int, shape (n,)
        Evaluations, how often a row was refined, and how many cells it began with.
    start : int
        Order that cells begin with.
    """

    geometry: np.ndarray
    cells: Cells
    doubt: np.ndarray
    spent: np.ndarray
    rounds: np.ndarray
    panels: np.ndarray
    start: int


def look(
    chart: Chart,
    integrand: Integrand,
    cos_theta: np.ndarray,
    phi: np.ndarray,
    widths: np.ndarray,
    isotropic: bool,
    *,
    rtol: float,
    limit: int,
) -> tuple[Refined, np.ndarray]:
    """Begin to integrate: cells that `integrate` goes on with, and what every row is at least.

    Parameters
    ----------
    chart, integrand, cos_theta, phi, widths, isotropic, rtol, limit
        As in `integrate`.
    """
    begun = _begin(*(chart, integrand, cos_theta, phi, widths, isotropic), rtol=rtol, limit=limit)
    _go_on(chart, integrand, begun, rtol=max(rtol, _LOOK), atol=0.0, limit=limit)
    value, error, _, _ = _sums(begun.cells, cos_theta.size)
    least = np.abs(value) - begun.doubt * error
    return begun, np.where(least > 0.0, least, 0.0)


def refine(
    chart: Chart,
    integrand: Integrand,
    cos_theta: np.ndarray,
    phi: np.ndarray,
    widths: np.ndarray,
    isotropic: bool,
    *,
    rtol: float,
    atol: float | np.ndarray,
    limit: int,
    fine: bool = False,
    judge_series: Callable[[Cells], None] | None = None,
    weigh: Callable[[np.ndarray, Cells], np.ndarray] | None = None,
) -> Refined:
    """Cut and raise cells until their bounds sum to a quarter of what is tolerated, or less.

    Parameters
    ----------
    chart, integrand, cos_theta, phi, widths, isotropic, rtol, atol, limit, fine
        As in `integrate`.
    judge_series : callable, optional
        Replaces the errors along v of new cells, of which it has the Legendre series along v too.
    weigh : callable, optional
        ``weigh(geometry, cells)``: how many times more the errors of each cell count than as they
        are. What a row is to be worth, the heights from one kink to the next are then as well.

    Returns
    -------
    Refined
        Rows that could not be had as well as asked for are among them, with larger bounds.
    """
    begun = _begin(
        *(chart, integrand, cos_theta, phi, widths, isotropic),
        rtol=rtol,
        limit=limit,
        fine=fine,
        judge_series=judge_series,
    )
    _go_on(
        *(chart, integrand, begun),
        rtol=rtol,
        atol=atol,
        limit=limit,
        judge_series=judge_series,
        weigh=weigh,
    )
    return begun


def refine_alike(
    chart: Chart,
    integrand: Integrand,
    cos_theta: np.ndarray,
    phi: np.ndarray,
    widths: np.ndarray,
    isotropic: bool,
    most: int,
    *,
    rtol: float,
    atol: float | np.ndarray,
    limit: int,
    judge_series: Callable[[Cells], None] | None = None,
    weigh: Callable[[np.ndarray, Cells], np.ndarray] | None = None,
) -> Refined:
    """As `refine`, where rows begin with the cells that were found for others like them.

    Those are the orders and cuts of the row in the midst of some that have the same panels and
    follow each other, and how far its bounds were to be doubted. It begins like the row in the
    midst of all that have the same panels.

    Parameters
    ----------
    most : int
        How many rows are like one, at most.
    chart, integrand, cos_theta, phi, widths, isotropic, rtol, atol, limit, judge_series, weigh
        As in `refine`.

    Returns
    -------
    Refined
    """
    n = cos_theta.size
    geometry, row, code, box = chart.panels(cos_theta, phi, widths, isotropic)
    ends = np.searchsorted(row, np.arange(n + 1))
    panels = [slice(a, b) for a, b in itertools.pairwise(ends.tolist())]
    root, lead = _leads(cos_theta, [(code[own], box[own, :4]) for own in panels], most)
    atol = np.broadcast_to(atol, n)
    how: dict[str, Any] = {"limit": limit, "judge_series": judge_series, "weigh": weigh}
    first = np.unique(root)
    leads = np.setdiff1d(lead, first)
    rest = np.setdiff1d(np.arange(n), np.append(first, leads))
    done = refine(
        *(chart, of_rows(integrand, first), cos_theta[first], phi[first], widths[first], isotropic),
        **(how | {"rtol": _AHEAD * rtol, "atol": atol[first]}),
    )
    found = [(done, first)]
    for which, like, worth in ((leads, root[leads], _AHEAD * rtol), (rest, lead[rest], rtol)):
        if which.size == 0:
            continue
        known, numbers = _together(*found), np.sort(np.concatenate([rows for _, rows in found]))
        known.cells.order = _enough(known, numbers, worth, atol, weigh)
        cells, spent = _begun_alike(known.cells, which, like, panels, code, box)
        inner = of_rows(integrand, which)
        evaluate(chart, inner, geometry[which], cells)
        if judge_series:
            judge_series(cells)
        doubt, rounds = known.doubt[np.searchsorted(numbers, like)], np.zeros(which.size, dtype=int)
        first = np.bincount(cells.row, minlength=which.size)
        begun = Refined(geometry[which], cells, doubt, spent, rounds, first, done.start)
        _go_on(*(chart, inner, begun), **(how | {"rtol": worth, "atol": atol[which]}))
        found.append((begun, which))
    return _together(*found)


def _enough(
    known: Refined,
    numbers: np.ndarray,
    rtol: float,
    atol: np.ndarray,
    weigh: Callable[[np.ndarray, Cells], np.ndarray] | None,
) -> np.ndarray:
    """Orders that would have done for cells of rows of these numbers, as their spectra fall."""
    cells = replace(known.cells, row=np.searchsorted(numbers, known.cells.row))
    value, _, _, count = _sums(cells, numbers.size)
    allowed = np.maximum(atol[numbers], rtol * np.abs(value)) / (known.doubt * count)
    # As much as cells that are refined may leave.
    goal = 0.125 * allowed[cells.row]
    size = np.maximum(cells.size, 1e-300)
    share = np.clip(cells.error / size[:, None], _EPS, 0.9)
    weight = weigh(known.geometry, cells) if weigh else 1.0
    fall = np.log(np.clip(goal / (weight * size), 1e-300, 1.0))[:, None]
    wanted = np.maximum(cells.order * (fall / np.log(share)) ** _GROWTH, 8.0)
    rungs = _RUNGS[np.minimum(np.searchsorted(_RUNGS, wanted), _RUNGS.size - 1)]
    found: np.ndarray = np.minimum(rungs, cells.order)
    return found


def _leads(
    cos_theta: np.ndarray, panels: list[tuple[np.ndarray, np.ndarray]], most: int
) -> tuple[np.ndarray, np.ndarray]:
    """The row in the midst of all that have the same panels, and of at most so many of those.

    Rows with other panels than all the others are their own.
    """
    alike: dict[bytes, list[int]] = {}
    for k in np.argsort(cos_theta, kind="stable").tolist():
        alike.setdefault(b"".join(known.tobytes() for known in panels[k]), []).append(k)
    root, lead = np.empty((2, cos_theta.size), dtype=int)
    for rows in alike.values():
        root[rows] = rows[len(rows) // 2]
        for run in np.array_split(rows, -(-len(rows) // most)):
            lead[run] = run[run.size // 2]
    return root, lead


def _begun_alike(
    known: Cells,
    rows: np.ndarray,
    like: np.ndarray,
    panels: list[slice],
    code: np.ndarray,
    box: np.ndarray,
) -> tuple[Cells, np.ndarray]:
    """Cells of some rows as those of others, still to be evaluated, and how many nodes each has.

    `panels` tells which codes and boxes are those of each row: in the same order where rows are
    alike.
    """
    own: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    for i in np.unique(like).tolist():
        cell = np.flatnonzero(known.row == i)
        own[i] = cell, _panels_of(known, cell, code[panels[i]], box[panels[i]])
    pairs = list(zip(rows.tolist(), like.tolist(), strict=True))
    cell = np.concatenate([own[i][0] for _, i in pairs])
    panel = np.concatenate([own[i][1] + panels[k].start for k, i in pairs])
    row = np.repeat(np.arange(rows.size), [own[i][0].size for _, i in pairs])
    boxes = known.box[cell].copy()
    boxes[:, 4:] = box[panel, 4:]
    cells = Cells.blank(row, code[panel], boxes, known.order[cell], known.series.shape[1])
    spent = np.bincount(row, weights=cells.order.prod(1), minlength=rows.size).astype(int)
    return cells, spent


def _panels_of(cells: Cells, which: np.ndarray, code: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Of which panel of their row, whose codes and boxes are given, some cells are parts."""
    inside = (cells.code[which, None] == code).all(2)
    inside &= (cells.box[which, None, 4:] == box[:, 4:]).all(2)
    for k in (0, 2):
        inside &= (cells.box[which, None, k] >= box[:, k]) & (
            cells.box[which, None, k + 1] <= box[:, k + 1]
        )
    found: np.ndarray = inside.argmax(1)
    return found


def _together(*found: tuple[Refined, np.ndarray]) -> Refined:
    """All rows in their order, from groups and the numbers of their rows."""
    rank = np.argsort(np.concatenate([rows for _, rows in found]))

    def stacked(name: str) -> np.ndarray:
        together: np.ndarray = np.concatenate([getattr(some, name) for some, _ in found])[rank]
        return together

    columns = [
        np.concatenate([getattr(some.cells, name) for some, _ in found])
        for name in Cells.__dataclass_fields__
    ]
    cells = Cells(*columns)
    cells.row = np.concatenate([rows[some.cells.row] for some, rows in found])
    names = ("geometry", "doubt", "spent", "rounds", "panels")
    geometry, doubt, spent, rounds, panels = (stacked(name) for name in names)
    return Refined(geometry, cells, doubt, spent, rounds, panels, found[0][0].start)


def _begin(
    chart: Chart,
    integrand: Integrand,
    cos_theta: np.ndarray,
    phi: np.ndarray,
    widths: np.ndarray,
    isotropic: bool,
    *,
    rtol: float,
    limit: int,
    fine: bool = False,
    judge_series: Callable[[Cells], None] | None = None,
) -> Refined:
    """The panels of all rows as cells of a first order; see `refine`."""
    n = cos_theta.size
    geometry, row, code, box = chart.panels(cos_theta, phi, widths, isotropic, fine=fine)
    per_row = np.bincount(row, minlength=n)
    start = 10 if rtol >= 1e-6 else 12 if rtol >= 1e-10 else 16
    doubt = np.ones(n)
    fits = [p for p in LADDER if p <= start and per_row.max() * (p * p + 8) <= limit]
    scans = isinstance(chart, ScanChart)
    if isinstance(chart, ScanChart) and (not fits or fits[-1] < LEAST):
        needed = int(per_row.max()) * (LEAST * LEAST + 8)
        raise InputError(
            f"max_evaluations = {limit} is out of range; features of {chart.width:g} rad are seen "
            f"with {needed} at least"
        )
    if not fits or fits[-1] < 4:
        geometry, row, code, box = chart.panels(cos_theta, phi, widths, isotropic, coarse=True)
        per_row = np.bincount(row, minlength=n)
        # Kinks and layers inside the panels slow the fall that the bound extrapolates.
        doubt = np.full(n, 4.0)
        fits = [p for p in LADDER if p <= start and per_row.max() * (p * p + 2) <= limit]
    order = fits[-1] if fits else 2
    m = row.size
    first = np.full((m, 2), order)
    # A scan has to see everything at first sight.
    if order == start and not scans:
        # Rows that cannot pay for more begin with as many on rings as elsewhere.
        rich = per_row[row] * (_ON_RINGS * start + 8) <= limit
        first = _start_orders(start, code, whole_rings(chart, box) & rich)
        first[per_row[row] > _CROWD] = _GLANCE
    cells = Cells.blank(row, code, box, first, _TOP if judge_series else 0)
    spent = np.bincount(row, weights=first.prod(1), minlength=n).astype(int)
    evaluate(chart, integrand, geometry, cells)
    if judge_series:
        judge_series(cells)
    return Refined(geometry, cells, doubt, spent, np.zeros(n, dtype=int), per_row, start)


def _go_on(
    chart: Chart,
    integrand: Integrand,
    begun: Refined,
    *,
    rtol: float,
    atol: float | np.ndarray,
    limit: int | np.ndarray,
    slack: float | np.ndarray = 0.0,
    judge_series: Callable[[Cells], None] | None = None,
    weigh: Callable[[np.ndarray, Cells], np.ndarray] | None = None,
) -> None:
    """Cut and raise the cells that were begun, in place; see `refine`."""
    geometry, cells, doubt = begun.geometry, begun.cells, begun.doubt
    spent, n = begun.spent, begun.doubt.size
    active = np.ones(n, dtype=bool)
    of, owner = _heights(cells) if weigh else (cells.row, np.arange(n))
    for _ in range(_ROUNDS):
        value, error, size, leaves = _sums(cells, n)
        target = np.maximum(atol, slack + rtol * np.abs(value))
        row = _Rows(of, owner, np.ones(of.size))
        if weigh is not None:
            row, error = _lifted(cells, row, weigh(geometry, cells))
            size, target = size[owner], target[owner]
        rounding = _ROUNDINGS * _EPS * size
        # Leave half of the tolerance to rounding and to the probe.
        open_ = active[row.owner] & (doubt[row.owner] * error + rounding > 0.5 * target)
        active[:] = False
        active[row.owner[open_]] = True
        if not active.any():
            break
        allowed = 0.25 * target / doubt[row.owner]
        budget = limit - spent - (2 * leaves + 4)
        around = whole_rings(chart, cells.box)
        work, paid = _plan(
            *(cells, row, allowed, open_, budget, spent, begun.rounds, begun.start, around)
        )
        active &= paid
        if work.parent.size == 0:
            # Only rounding stands above what was asked for, or nothing can be paid for.
            break
        children = work.children(cells)
        evaluate(chart, integrand, geometry, children)
        _audit(cells, children, work, doubt, around)
        if judge_series:
            judge_series(children)
        cells.replace(work.parent, children)
        # Second halves stand at the end.
        of = np.concatenate((of, of[work.parent[work.cut >= 0]]))


def integrate(
    chart: Chart,
    integrand: Integrand,
    cos_theta: np.ndarray,
    phi: np.ndarray,
    widths: np.ndarray,
    isotropic: bool,
    *,
    rtol: float,
    atol: float | np.ndarray,
    limit: int,
    per_panel: int = 0,
    probe: bool = True,
    fine: bool = False,
    slack: float | np.ndarray = 0.0,
    begun: Refined | None = None,
) -> Result:
    """Integrate over the domain of a chart, one integral per row.

    Parameters
    ----------
    chart : Chart
        Panels and nodes.
    integrand : callable
        ``integrand(row, wi, wo, h) -> (m, count)``: values at the nodes of m cells, `row` being
        the row of each.
    cos_theta, phi, widths : ndarray, shape (n,), (n,), (n, 2)
        What the chart needs of each row.
    isotropic : bool
        Symmetric about the plane of incidence.
    rtol : float
    atol : float or ndarray, shape (n,)
        A row is done when its error is at most max(atol, slack + rtol |value|).
    limit : int
        Most evaluations of the integrand per row, probes included.
    per_panel : int
        Rows may have so many for each of their panels, where that is more.
    probe : bool
        Add the effect of moving every direction by an ulp to the bound.
    fine : bool
        Let the chart search finely for its panels; rows that were refused are tried again so.
    slack : float or ndarray, shape (n,)
        What others leave to a row, or have of it where it is negative.
    begun : Refined, optional
        What `look` returned for the same rows; it is changed.

    Returns
    -------
    Result
        With arrays of shape (n,).
    """
    n = cos_theta.size
    done = begun or _begin(
        *(chart, integrand, cos_theta, phi, widths, isotropic), rtol=rtol, limit=limit, fine=fine
    )
    most = np.maximum(limit, per_panel * done.panels)
    _go_on(chart, integrand, done, rtol=rtol, atol=atol, limit=most, slack=slack)
    geometry, cells, doubt, spent = done.geometry, done.cells, done.doubt, done.spent
    value, error, size, leaves = _sums(cells, n)
    if not probe:
        nodes, shift = 0, np.zeros(n)
    else:
        nodes = 2 if np.all(most - spent >= 8 * leaves.max()) else 1
        shift = probe_cells(chart, integrand, geometry, cells, n, nodes)
    spent = spent + 2 * nodes * nodes * leaves
    rounding = _ROUNDINGS * _EPS * size + 4.0 * shift
    stopped = doubt * error + rounding <= np.maximum(atol, slack + rtol * np.abs(value))
    tight = np.bincount(cells.row, weights=cells.tight, minlength=n)
    # Refining where the bound is large selects as well: after a few rounds only the wide one holds.
    error = doubt * np.where(stopped | (done.rounds > _UNSELECTED), error, tight) + rounding
    finite = np.isfinite(value) & np.isfinite(error)
    value, error = np.where(finite, value, np.nan), np.where(finite, error, np.inf)
    found = Result(value, error, spent, finite & stopped)
    refused = np.flatnonzero(~finite)
    if refused.size and not fine:
        # A panel turned out to be two: look for the place where it changes.
        again = integrate(
            chart,
            of_rows(integrand, refused),
            cos_theta[refused],
            phi[refused],
            widths[refused],
            isotropic,
            rtol=rtol,
            atol=np.broadcast_to(atol, n)[refused],
            limit=limit,
            per_panel=per_panel,
            probe=probe,
            fine=True,
            slack=np.broadcast_to(slack, n)[refused],
        )
        again.evaluations += found.evaluations[refused]
        for name in ("value", "error", "evaluations", "converged"):
            getattr(found, name)[refused] = getattr(again, name)
    return found


def _sums(cells: Cells, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Value, error and modulus of every row, and its number of cells."""
    total = cells.error[:, 0] + cells.error[:, 1]
    return (
        np.bincount(cells.row, weights=cells.value, minlength=n),
        np.bincount(cells.row, weights=total, minlength=n),
        np.bincount(cells.row, weights=cells.size, minlength=n),
        np.maximum(np.bincount(cells.row, minlength=n), 1),
    )


def _start_orders(start: int, code: np.ndarray, around: np.ndarray) -> np.ndarray:
    """Orders that cells begin with: the core of a lobe (inner panel 0) is steeper along v, and
    `around` tells which are whole rings."""
    orders = start + np.where((code[:, 1] == 0)[:, None], (-2, 4), (-2, 0))
    orders[around, 0] = _ON_RINGS
    return orders


@dataclass
class _Rows:
    """What has a tolerance: rows, or parts of them.

    Attributes
    ----------
    of : ndarray of int
        That of each cell.
    owner : ndarray of int
        The row of each.
    weight : ndarray
        How much cells count, with their errors and their sizes.
    """

    of: np.ndarray
    owner: np.ndarray
    weight: np.ndarray


def _heights(cells: Cells) -> tuple[np.ndarray, np.ndarray]:
    """The heights from one kink to the next that each cell is part of, and the row of each."""
    place = np.lexsort((cells.box[:, 4], cells.code[:, 0], cells.row))
    key = np.column_stack((cells.row, cells.code[:, 0], cells.box[:, 4]))[place]
    first = np.append(True, np.any(key[1:] != key[:-1], axis=1))
    of = np.empty(place.size, dtype=int)
    of[place] = np.cumsum(first) - 1
    return of, cells.row[place[first]]


def _lifted(cells: Cells, rows: _Rows, weight: np.ndarray) -> tuple[_Rows, np.ndarray]:
    """Heights from one kink to the next as rows of their own, whose errors count for more.

    Parameters
    ----------
    cells : Cells
    rows : _Rows
        Those heights.
    weight : ndarray
        See `refine`.

    Returns
    -------
    _Rows
    ndarray
        Their errors, of which each may be as large as that of a row.
    """
    # No more nodes help against rounding, which may be all that is seen of a cell.
    error = cells.error.sum(1)
    weight = np.where(error > _ROUNDINGS * _EPS * cells.size, weight, 0.0)
    total = np.bincount(rows.of, weights=weight * error, minlength=rows.owner.size)
    return replace(rows, weight=weight), total


@dataclass
class _Work:
    """What becomes of cells: new orders, and along which direction they are cut (-1: none)."""

    parent: np.ndarray
    order: np.ndarray
    cut: np.ndarray

    def children(self, cells: Cells) -> Cells:
        """The new cells: one in the place of every parent, then the second halves of those cut."""
        m = self.parent.size + np.count_nonzero(self.cut >= 0)
        row, order = np.empty(m, dtype=int), np.empty((m, 2), dtype=int)
        code, box = np.empty((m, cells.code.shape[1]), dtype=int), np.empty((m, cells.box.shape[1]))
        _divide(
            *(self.parent, self.order, self.cut, cells.row, cells.code, cells.box),
            *(row, code, box, order),
        )
        return Cells.blank(row, code, box, order, cells.series.shape[1])


@kernel
def _divide(parent, new_order, cut, old_row, old_code, old_box, row, code, box, order):
    """Fill the last four with the children of parents."""
    other = parent.size
    for k in range(parent.size):
        i = parent[k]
        _copy(i, k, old_row, old_code, old_box, row, code, box)
        order[k, 0], order[k, 1] = new_order[k, 0], new_order[k, 1]
        if cut[k] >= 0:
            _copy(i, other, old_row, old_code, old_box, row, code, box)
            order[other, 0], order[other, 1] = new_order[k, 0], new_order[k, 1]
            first, last = 2 * cut[k], 2 * cut[k] + 1
            middle = 0.5 * (old_box[i, first] + old_box[i, last])
            box[k, last] = middle
            box[other, first] = middle
            other += 1


@kernel
def _copy(i, k, old_row, old_code, old_box, row, code, box):
    # Element by element: assigning rows of arrays takes two seconds to compile.
    row[k] = old_row[i]
    for j in range(code.shape[1]):
        code[k, j] = old_code[i, j]
    for j in range(box.shape[1]):
        box[k, j] = old_box[i, j]


def _plan(
    cells: Cells,
    rows: _Rows,
    allowed: np.ndarray,
    active: np.ndarray,
    budget: np.ndarray,
    spent: np.ndarray,
    rounds: np.ndarray,
    start: int,
    around: np.ndarray,
) -> tuple[_Work, np.ndarray]:
    """Choose, for the cells whose errors a row cannot afford, a higher order or a cut.

    `allowed` is what the cells left alone may sum to, and once more what the others may come to,
    for those of `rows` that are active. `around` tells which cells are whole rings.
    A row that cannot pay for all of it from its budget pays for the worst cells. What is paid is
    added to `spent`, and a round to those that paid, which are returned too.
    """
    error, size = cells.error * rows.weight[:, None], cells.size * rows.weight
    total = error[:, 0] + error[:, 1]
    place = np.flatnonzero(active[rows.of])
    m, of = place.size, rows.of[place]
    place = place[np.lexsort((total[place], of))]
    ends = np.concatenate(([0], np.cumsum(np.bincount(of, minlength=active.size))))
    usual = _start_orders(start, cells.code[place], around[place])
    parent, order, cut = np.empty(m, dtype=int), np.empty((m, 2), dtype=int), np.empty(m, dtype=int)
    paid = np.zeros(spent.size, dtype=int)
    count = _choose_all(
        *(ends, place, total, error, size, cells.order, around, usual, allowed),
        *(active, rows.owner),
        *(budget, paid, parent, order, cut),
    )
    spent += paid
    rounds += paid > 0
    return _Work(parent[:count], order[:count], cut[:count]), paid > 0


@kernel
def _choose_all(
    ends,
    place,
    total,
    error,
    size,
    old,
    around,
    usual,
    allowed,
    active,
    owner,
    budget,
    paid,
    parent,
    order,
    cut,
):
    """Fill parent, order, cut and what is paid; return how many cells are to be computed again.

    `place` has the cells of every active row from the smallest error on, those of row r from
    ends[r] on; `usual` is in the same order. Rows of one owner have one budget.
    """
    count = 0
    for r in range(active.size):
        if not active[r]:
            continue
        first, last = ends[r], ends[r + 1]
        # Added up from the smallest on, so that none is rounded away; NaN counts as too much.
        running = 0.0
        while first < last:
            running += total[place[first]]
            if not running <= allowed[r]:
                break
            first += 1
        goal = 0.5 * allowed[r] / max(last - first, 1)
        for j in range(last - 1, first - 1, -1):
            i = place[j]
            cut[count] = -1
            order[count, 0], order[count, 1] = usual[j, 0], usual[j, 1]
            if max(old[i, 0], old[i, 1]) > _GLANCE:
                cut[count] = _choose(goal, error[i], size[i], old[i], around[i], order[count])
            cost = order[count, 0] * order[count, 1] * (2 if cut[count] >= 0 else 1)
            if paid[owner[r]] + cost > budget[owner[r]]:
                break
            parent[count] = i
            paid[owner[r]] += cost
            count += 1
    return count


@kernel
def _rung(wanted, top):
    """The next order on the ladder; the highest when there is none."""
    for order in _RUNGS:
        if order >= min(wanted, top):
            return order
    return top


@kernel
def _choose(goal, error, size, old, around, order):
    """Fill the new orders of a cell; return the direction along which it is cut, or -1."""
    whole = max(size, 1e-300)
    fall = math.log(goal / whole)
    cut = -1
    for d in range(2):
        p, share = old[d], error[d] / whole
        top = _TOP_AROUND if around and d == 0 else _TOP
        order[d] = p
        if not error[d] > goal:
            continue
        # Spectra of entire functions fall ever faster: less than proportionally more will do.
        growth = _GROWTH if p <= 16 else 1.0
        wanted = p * (fall / math.log(min(share, 0.9))) ** growth
        if not math.isfinite(wanted):
            wanted = 1e9
        wanted = max(wanted, p + 2.0)
        order[d] = max(_rung(wanted, top), p)
        hopeless = wanted > (1.5 if p < 20 else 1.1) * top or p >= top
        if hopeless and (cut < 0 or error[d] > error[cut]):
            cut = d
    if cut >= 0:
        # A half needs fewer nodes along the cut, and what was planned across it.
        order[cut] = min(max(old[cut], 8), 20)
        d = 1 - cut
        p, share = old[d], max(error[d] / whole, 1e-25)
        if error[d] < 1e-3 * goal:
            # A direction that was resolved far too well may use fewer nodes.
            enough = 1.3 * p * fall / math.log(share) + 2.0
            order[d] = min(_rung(max(enough, 10.0), _TOP_AROUND), p)
    return cut


def _halves() -> tuple[np.ndarray, np.ndarray]:
    """Matrices that give the moments of a cell from those of its two halves."""
    degrees = 2.0 * np.arange(MOMENTS) + 1.0
    basis = np.polynomial.legendre.Legendre.basis
    middle = np.polynomial.legendre.Legendre.identity()
    matrices = []
    for side in (-0.5, 0.5):
        # P_k of the whole, written in the polynomials of the half.
        whole = [basis(k)(0.5 * middle + side).coef for k in range(MOMENTS)]
        square = np.array([np.pad(row, (0, MOMENTS - row.size)) for row in whole])
        matrices.append((square / degrees * degrees[:, None]).T)
    return matrices[0], matrices[1]


_LEFT, _RIGHT = _halves()


@kernel
def _distance(k, other, cut, around, new, old):
    """How far moments moved: those of a cell, or of its two halves, from `old`."""
    moved = 0.0
    for d in range(2):
        # Halves of a whole ring have moments of another kind, but for the first.
        for r in range(1 if around and cut == 0 and d == 0 else MOMENTS):
            total = new[k, d, r]
            if cut == d:
                total = 0.0
                for q in range(MOMENTS):
                    total += new[k, d, q] * _LEFT[q, r] + new[other, d, q] * _RIGHT[q, r]
            elif cut >= 0:
                total += new[other, d, r]
            step = abs(total - old[d, r])
            if not step <= moved:
                moved = step
    return moved


def _audit(
    cells: Cells, children: Cells, work: _Work, doubt: np.ndarray, around: np.ndarray
) -> None:
    """Judge old bounds and new ones by what moved when cells were computed again.

    Raises the doubt of rows in whose cells a bound was passed, and mends the errors of children.
    """
    _compare(
        *(work.parent, work.order, work.cut, around),
        *(cells.row, cells.order, cells.value, cells.error, cells.size, cells.moments),
        *(children.value, children.error, children.tight, children.size, children.moments),
        doubt,
    )


@kernel
def _compare(
    parent,
    order,
    cut,
    around,
    row,
    old_order,
    old_value,
    old_error,
    old_size,
    old_moments,
    value,
    error,
    tight,
    size,
    moments,
    doubt,
):
    """What moved is the old error; second halves stand behind the first in the order of parents.

    Where one node carries what is seen of a cell, that nothing moved says nothing.
    """
    other = parent.size - 1
    for k in range(parent.size):
        i = parent[k]
        halved = cut[k] >= 0
        other += halved
        new, slack = value[k], error[k, 0] + error[k, 1]
        if halved:
            new += value[other]
            slack += error[other, 0] + error[other, 1]
        # A bound that was passed makes all bounds of its row doubtful.
        excess = abs(new - old_value[i]) - slack - _ROUNDINGS * _EPS * old_size[i]
        bound = max(old_error[i, 0] + old_error[i, 1], 1e-300)
        if excess > bound and excess > 1e-13 * old_size[i]:
            doubt[row[i]] = max(doubt[row[i]], min(excess / bound, 1e6))
        moved = _distance(k, other, cut[k], around[i], moments, old_moments[i])
        growth = math.inf
        for d in range(2):
            ratio = order[k, d] / old_order[i, d]
            if ratio > 1.0 and old_order[i, d] > _GLANCE:
                growth = min(growth, ratio)
            if ratio >= 1.2 or cut[k] == d:
                # Along a direction that became finer, the new error is not worse than the old.
                if not error[k, d] <= _TRUST * moved and error[k, d] < _UNSEEN * size[k]:
                    error[k, d] = _TRUST * moved
                if (
                    halved
                    and not error[other, d] <= _TRUST * moved
                    and error[other, d] < _UNSEEN * size[other]
                ):
                    error[other, d] = _TRUST * moved
        if not halved and growth < math.inf:
            # A geometric fall takes the error e of p nodes to e^(q/p) for q nodes.
            share = min(moved / max(old_size[i], 1e-300), 1.0)
            least = _TRUST * moved * share ** (growth - 1.0)
            worst = 0 if error[k, 0] >= error[k, 1] else 1
            error[k, worst] += max(least - error[k, 0] - error[k, 1], 0.0)
            tight[k] = max(tight[k], least)


def compile_kernels(charts: Iterable[Chart]) -> None:
    """Compile the nodes of charts and what integrates, by calling it with no cells.

    The panels of a chart are left out: another process works on them meanwhile.
    """
    none = np.empty(0, int)
    cells = Cells.blank(none, np.empty((0, 6), int), np.empty((0, 6)), np.empty((0, 2), int))
    active, spent = np.ones(1, dtype=bool), np.zeros(1, dtype=int)
    rows = _Rows(none, np.zeros(1, dtype=int), cells.size)
    around = np.empty(0, dtype=bool)
    work, _ = _plan(cells, rows, np.ones(1), active, spent, spent, spent, 12, around)
    _audit(cells, work.children(cells), work, np.ones(1), around)
    compile_cells(charts)
