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
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from albedo._compile import kernel
from albedo.integrators.rules import LADDER, bounds_of, gauss

Integrand = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]

_EPS = np.finfo(np.float64).eps
_LADDER = np.array(LADDER)
_TOP = LADDER[-1]
# Nodes in one block: nine numbers each, which fits in a 2 MiB cache.
_BLOCK = 16384
# Each number that a chart or a kernel hands on carries a few roundings.
_ROUNDINGS = 40.0
_ROUNDS = 60
_UNSELECTED = 1
_GROWTH = 0.65
# First Legendre moments of both marginals, compared when a cell is computed again: several
# numbers, because the value alone may happen to agree.
_MOMENTS = 4
# What moved, times this, bounds the error of the finer rule, and the fall that it may claim.
_TRUST = 8.0
# A marginal of which one node carries more than this share has not been seen: a spike may stand
# beside it. The share that may hide is a number that no tolerance can live with.
_LONE, _HIDDEN = 0.99, 1e9


class Chart(Protocol):
    """What the integrator needs of a chart; see `albedo.charts.polar.PolarChart`."""

    def panels(
        self,
        cos_theta: np.ndarray,
        phi: np.ndarray,
        widths: np.ndarray,
        isotropic: bool,
        coarse: bool = False,
        fine: bool = False,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]: ...

    def nodes(
        self,
        geometry: np.ndarray,
        code: np.ndarray,
        box: np.ndarray,
        u: np.ndarray,
        v: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]: ...


@dataclass
class Result:
    """Values of all rows, with what they are worth."""

    value: np.ndarray
    error: np.ndarray
    evaluations: np.ndarray
    converged: np.ndarray


@dataclass
class _Cells:
    """A growing set of cells, one entry per array element."""

    row: np.ndarray
    code: np.ndarray
    box: np.ndarray
    order: np.ndarray  # (m, 2) nodes along u and v
    value: np.ndarray
    error: np.ndarray  # (m, 2) bounds along u and v, to stop on
    tight: np.ndarray  # (m,) their sum, to report where nothing was stopped on it
    size: np.ndarray  # integral of the modulus
    moments: np.ndarray  # (m, 2, _MOMENTS) first Legendre coefficients of the marginals

    @classmethod
    def blank(cls, row: np.ndarray, code: np.ndarray, box: np.ndarray, order: np.ndarray) -> _Cells:
        """Cells that are still to be evaluated."""
        m = row.size
        empty = np.zeros(m), np.zeros((m, 2)), np.zeros(m), np.zeros(m), np.zeros((m, 2, _MOMENTS))
        return cls(row, code, box, order, *empty)

    def take(self, keep: np.ndarray) -> _Cells:
        return _Cells(*(getattr(self, f)[keep] for f in self.__dataclass_fields__))

    def replace(self, parent: np.ndarray, children: _Cells) -> None:
        """Put the first children in the places of their parents, and the others at the end."""
        m = parent.size
        for f in self.__dataclass_fields__:
            old, new = getattr(self, f), getattr(children, f)
            old[parent] = new[:m]
            if new.shape[0] > m:
                setattr(self, f, np.concatenate((old, new[m:])))


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
    probe: bool = True,
    fine: bool = False,
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
        A row is done when its error is at most max(atol, rtol |value|).
    limit : int
        Most evaluations of the integrand per row, probes included.
    probe : bool
        Add the effect of moving every direction by an ulp to the bound.
    fine : bool
        Let the chart search finely for its panels; rows that were refused are tried again so.

    Returns
    -------
    Result
        With arrays of shape (n,).
    """
    n = cos_theta.size
    geometry, row, code, box = chart.panels(cos_theta, phi, widths, isotropic, fine=fine)
    per_row = np.bincount(row, minlength=n)
    start = 10 if rtol >= 1e-6 else 12 if rtol >= 1e-10 else 16
    doubt = np.ones(n)
    fits = [p for p in LADDER if p <= start and per_row.max() * (p * p + 8) <= limit]
    if not fits or fits[-1] < 4:
        geometry, row, code, box = chart.panels(cos_theta, phi, widths, isotropic, coarse=True)
        per_row = np.bincount(row, minlength=n)
        # Kinks and layers inside the panels slow the fall that the bound extrapolates.
        doubt = np.full(n, 4.0)
        fits = [p for p in LADDER if p <= start and per_row.max() * (p * p + 2) <= limit]
    order = fits[-1] if fits else 2
    m = row.size
    first = np.full((m, 2), order)
    if order == start:
        # The core of a lobe (inner panel 0) is steeper along v than along u.
        first += np.where((code[:, 1] == 0)[:, None], (-2, 4), (-2, 0))
    cells = _Cells.blank(row, code, box, first)
    spent = np.bincount(row, weights=first.prod(1), minlength=n).astype(int)
    _evaluate(chart, integrand, geometry, cells)
    active = np.ones(n, dtype=bool)
    rounds = np.zeros(n, dtype=int)
    for _ in range(_ROUNDS):
        value, error, size, leaves = _sums(cells, n)
        rounding = _ROUNDINGS * _EPS * size
        target = np.maximum(atol, rtol * np.abs(value))
        # Leave half of the tolerance to rounding and to the probe.
        active &= doubt * error + rounding > 0.5 * target
        if not active.any():
            break
        work = _plan(cells, 0.25 * target / doubt, active, n)
        if work.parent.size == 0:
            # Only rounding stands above what was asked for.
            break
        reserve = 2 * leaves + 4
        cost = work.cost
        rank = np.lexsort((-cells.error.sum(1)[work.parent], cells.row[work.parent]))
        work = work.take(rank)
        cost = cost[rank]
        rows = cells.row[work.parent]
        running = np.cumsum(cost)
        opens = np.concatenate(([True], rows[1:] != rows[:-1]))
        base = (running - cost)[opens][np.cumsum(opens) - 1]
        affordable = spent[rows] + (running - base) + reserve[rows] <= limit
        # A row that cannot pay for all of it pays for the worst cells, and is done.
        active &= np.bincount(rows[affordable], minlength=n) > 0
        work = work.take(affordable)
        if work.parent.size == 0:
            break
        children = work.children(cells)
        rounds += np.bincount(children.row, minlength=n) > 0
        spent += np.bincount(children.row, weights=children.order.prod(1), minlength=n).astype(int)
        _evaluate(chart, integrand, geometry, children)
        _audit(cells, children, work, doubt)
        cells.replace(work.parent, children)
    value, error, size, leaves = _sums(cells, n)
    if not probe:
        nodes, shift = 0, np.zeros(n)
    else:
        nodes = 2 if limit - int(spent.max()) >= 8 * int(leaves.max()) else 1
        shift = _probe(chart, integrand, geometry, cells, n, nodes)
    spent = spent + 2 * nodes * nodes * leaves
    rounding = _ROUNDINGS * _EPS * size + 4.0 * shift
    stopped = doubt * error + rounding <= np.maximum(atol, rtol * np.abs(value))
    tight = np.bincount(cells.row, weights=cells.tight, minlength=n)
    # Refining where the bound is large selects as well: after a few rounds only the wide one holds.
    error = doubt * np.where(stopped | (rounds > _UNSELECTED), error, tight) + rounding
    finite = np.isfinite(value) & np.isfinite(error)
    value, error = np.where(finite, value, np.nan), np.where(finite, error, np.inf)
    found = Result(value, error, spent, finite & stopped)
    refused = np.flatnonzero(~finite)
    if refused.size and not fine:
        # A panel turned out to be two: look for the place where it changes.
        again = integrate(
            chart,
            lambda row, wi, wo, h: integrand(refused[row], wi, wo, h),
            cos_theta[refused],
            phi[refused],
            widths[refused],
            isotropic,
            rtol=rtol,
            atol=np.broadcast_to(atol, n)[refused],
            limit=limit,
            probe=probe,
            fine=True,
        )
        again.evaluations += found.evaluations[refused]
        for name in ("value", "error", "evaluations", "converged"):
            getattr(found, name)[refused] = getattr(again, name)
    return found


def _sums(cells: _Cells, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Value, error and modulus of every row, and its number of cells."""
    total = cells.error.sum(1)
    return (
        np.bincount(cells.row, weights=cells.value, minlength=n),
        np.bincount(cells.row, weights=total, minlength=n),
        np.bincount(cells.row, weights=cells.size, minlength=n),
        np.maximum(np.bincount(cells.row, minlength=n), 1),
    )


def _evaluate(chart: Chart, integrand: Integrand, geometry: np.ndarray, cells: _Cells) -> None:
    """Fill value, error and size of all cells."""
    # Cells that share a pair of orders stand together, so that every block is a slice.
    key = cells.order[:, 0] * 1000 + cells.order[:, 1]
    rank = np.argsort(key, kind="stable")
    row, code, box = cells.row[rank], cells.code[rank], cells.box[rank]
    geometry = geometry[row]
    edges = np.flatnonzero(np.diff(key[rank])) + 1
    for start, stop in itertools.pairwise((0, *edges.tolist(), rank.size)):
        p, q = cells.order[rank[start]].tolist()
        rule_u, rule_v = gauss(p), gauss(q)
        step = max(1, _BLOCK // (p * q))
        for first in range(start, stop, step):
            block = slice(first, min(first + step, stop))
            wi, wo, h, weight = chart.nodes(
                geometry[block], code[block], box[block], rule_u.nodes, rule_v.nodes
            )
            f = integrand(row[block], wi, wo, h)
            _reduce(
                *(rank[block], f, weight, rule_u.weights, rule_v.weights),
                *(rule_u.to_coefficients, rule_v.to_coefficients),
                *(cells.value, cells.error, cells.tight, cells.size, cells.moments),
            )


@kernel
def _judge(along, weights, to_coefficients, spectrum):
    """Fill the spectrum of a marginal; return its two bounds."""
    p = along.size
    for k in range(p):
        total = 0.0
        for i in range(p):
            total += along[i] * to_coefficients[i, k]
        spectrum[k] = total
    stop, report = bounds_of(spectrum[:p])
    seen = most = 0.0
    for i in range(p):
        part = abs(along[i]) * weights[i]
        seen += part
        most = max(most, part)
    if most > _LONE * seen:
        stop, report = max(stop, _HIDDEN * seen), max(report, _HIDDEN * seen)
    return stop, report


@kernel
def _reduce(block, f, weight, weights_u, weights_v, to_u, to_v, value, error, tight, size, moments):
    """Fill what is measured of the cells in a block, from the values at their nodes."""
    p, q = weights_u.size, weights_v.size
    along_u, along_v = np.empty(p), np.empty(q)
    spectrum = np.empty(max(p, q))
    for k in range(block.size):
        cell = block[k]
        along_v[:] = 0.0
        modulus = 0.0
        for i in range(p):
            total = absolute = 0.0
            for j in range(q):
                x = f[k, i * q + j] * weight[k, i * q + j]
                total += x * weights_v[j]
                absolute += abs(x) * weights_v[j]
                along_v[j] += x * weights_u[i]
            along_u[i] = total
            modulus += absolute * weights_u[i]
        size[cell] = modulus
        error[cell, 0], report = _judge(along_u, weights_u, to_u, spectrum)
        value[cell] = spectrum[0]
        for j in range(min(p, _MOMENTS)):
            moments[cell, 0, j] = spectrum[j]
        error[cell, 1], other = _judge(along_v, weights_v, to_v, spectrum)
        for j in range(min(q, _MOMENTS)):
            moments[cell, 1, j] = spectrum[j]
        tight[cell] = report + other


@dataclass
class _Work:
    """What becomes of cells: new orders, and along which direction they are cut (-1: none)."""

    parent: np.ndarray
    order: np.ndarray
    cut: np.ndarray

    @property
    def cost(self) -> np.ndarray:
        return self.order.prod(1) * np.where(self.cut >= 0, 2, 1)

    def take(self, keep: np.ndarray) -> _Work:
        return _Work(self.parent[keep], self.order[keep], self.cut[keep])

    def children(self, cells: _Cells) -> _Cells:
        source = np.concatenate((self.parent, self.parent[self.cut >= 0]))
        box = cells.box[source].copy()
        first = np.flatnonzero(self.cut >= 0)
        second = self.parent.size + np.arange(first.size)
        column = 2 * self.cut[first]
        middle = 0.5 * (box[first, column] + box[first, column + 1])
        box[first, column + 1] = middle
        box[second, column] = middle
        order = np.concatenate((self.order, self.order[first]))
        return _Cells.blank(cells.row[source], cells.code[source], box, order)


def _plan(cells: _Cells, allowed: np.ndarray, active: np.ndarray, n: int) -> _Work:
    """Choose, for the cells whose errors a row cannot afford, a higher order or a cut.

    `allowed` is what the cells left alone may sum to, and once more what the others may come to.
    """
    live = np.flatnonzero(active[cells.row])
    total = cells.error[live].sum(1)
    rank = np.lexsort((total, cells.row[live]))
    total, live = total[rank], live[rank]
    rows = cells.row[live]
    # As shares of their row: beside the errors of another row small ones would be rounded away.
    whole = np.maximum(np.bincount(rows, weights=total, minlength=n), 1e-300)[rows]
    share = np.where(np.isfinite(whole), total / whole, 1.0)
    running = np.cumsum(share)
    start = np.concatenate(([True], rows[1:] != rows[:-1]))
    base = (running - share)[start][np.cumsum(start) - 1]
    spare = running - base <= allowed[rows] / whole
    parent = np.sort(live[~spare])
    count = np.bincount(cells.row[parent], minlength=n)
    order, cut = np.empty((parent.size, 2), int), np.empty(parent.size, int)
    goal = (0.5 * allowed / np.maximum(count, 1))[cells.row[parent]]
    _choose(parent, goal, cells.error, cells.size, cells.order, order, cut)
    return _Work(parent, order, cut)


@kernel
def _rung(wanted):
    """The next order on the ladder; the highest when there is none."""
    for order in _LADDER:
        if order >= wanted:
            return order
    return _LADDER[-1]


@kernel
def _choose(parent, goal, error, size, old, order, cut):
    """Fill, for every parent, its new orders and the direction along which it is cut."""
    for k in range(parent.size):
        i = parent[k]
        whole = max(size[i], 1e-300)
        fall = math.log(goal[k] / whole)
        cut[k] = -1
        for d in range(2):
            p, share = old[i, d], error[i, d] / whole
            order[k, d] = p
            if not error[i, d] > goal[k]:
                continue
            # Spectra of entire functions fall ever faster: less than proportionally more will do.
            growth = _GROWTH if p <= 16 else 1.0
            wanted = p * (fall / math.log(min(share, 0.9))) ** growth
            if not math.isfinite(wanted):
                wanted = 1e9
            wanted = max(wanted, p + 2.0)
            order[k, d] = max(_rung(wanted), p)
            hopeless = wanted > (1.5 if p < 20 else 1.1) * _TOP or p >= _TOP
            if hopeless and (cut[k] < 0 or error[i, d] > error[i, cut[k]]):
                cut[k] = d
        if cut[k] < 0:
            continue
        # A half needs fewer nodes along the cut, and what was planned across it.
        order[k, cut[k]] = min(max(old[i, cut[k]], 8), 20)
        d = 1 - cut[k]
        p, share = old[i, d], max(error[i, d] / whole, 1e-25)
        if error[i, d] < 1e-3 * goal[k]:
            # A direction that was resolved far too well may use fewer nodes.
            enough = 1.3 * p * fall / math.log(share) + 2.0
            order[k, d] = min(_rung(max(enough, 10.0)), p)


def _halves() -> tuple[np.ndarray, np.ndarray]:
    """Matrices that give the moments of a cell from those of its two halves."""
    degrees = 2.0 * np.arange(_MOMENTS) + 1.0
    basis = np.polynomial.legendre.Legendre.basis
    middle = np.polynomial.legendre.Legendre.identity()
    matrices = []
    for side in (-0.5, 0.5):
        # P_k of the whole, written in the polynomials of the half.
        whole = [basis(k)(0.5 * middle + side).coef for k in range(_MOMENTS)]
        square = np.array([np.pad(row, (0, _MOMENTS - row.size)) for row in whole])
        matrices.append((square / degrees * degrees[:, None]).T)
    return matrices[0], matrices[1]


_LEFT, _RIGHT = _halves()


@kernel
def _distance(k, other, cut, new, old):
    """How far moments moved: those of a cell, or of its two halves, from `old`."""
    moved = 0.0
    for d in range(2):
        for r in range(_MOMENTS):
            total = new[k, d, r]
            if cut == d:
                total = 0.0
                for q in range(_MOMENTS):
                    total += new[k, d, q] * _LEFT[q, r] + new[other, d, q] * _RIGHT[q, r]
            elif cut >= 0:
                total += new[other, d, r]
            step = abs(total - old[d, r])
            if not step <= moved:
                moved = step
    return moved


def _audit(cells: _Cells, children: _Cells, work: _Work, doubt: np.ndarray) -> None:
    """Judge old bounds and new ones by what moved when cells were computed again.

    Raises the doubt of rows in whose cells a bound was passed, and mends the errors of children.
    """
    _compare(
        *(work.parent, work.order, work.cut),
        *(cells.row, cells.order, cells.value, cells.error, cells.size, cells.moments),
        *(children.value, children.error, children.tight, children.moments, doubt),
    )


@kernel
def _compare(
    parent,
    order,
    cut,
    row,
    old_order,
    old_value,
    old_error,
    old_size,
    old_moments,
    value,
    error,
    tight,
    moments,
    doubt,
):
    """What moved is the old error; second halves stand behind the first in the order of parents."""
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
        moved = _distance(k, other, cut[k], moments, old_moments[i])
        growth = math.inf
        for d in range(2):
            ratio = order[k, d] / old_order[i, d]
            if ratio > 1.0:
                growth = min(growth, ratio)
            if ratio >= 1.2 or cut[k] == d:
                # Along a direction that became finer, the new error is not worse than the old.
                if not error[k, d] <= _TRUST * moved:
                    error[k, d] = _TRUST * moved
                if halved and not error[other, d] <= _TRUST * moved:
                    error[other, d] = _TRUST * moved
        if not halved and growth < math.inf:
            # A geometric fall takes the error e of p nodes to e^(q/p) for q nodes.
            share = min(moved / max(old_size[i], 1e-300), 1.0)
            least = _TRUST * moved * share ** (growth - 1.0)
            worst = 0 if error[k, 0] >= error[k, 1] else 1
            error[k, worst] += max(least - error[k, 0] - error[k, 1], 0.0)
            tight[k] = max(tight[k], least)


def _probe(
    chart: Chart, integrand: Integrand, geometry: np.ndarray, cells: _Cells, n: int, nodes: int
) -> np.ndarray:
    """How far the integral moves when every direction at the nodes moves by an ulp."""
    rule = gauss(nodes)
    weights = np.outer(rule.weights, rule.weights).ravel()
    shift = np.zeros(n)
    step = max(1, _BLOCK // (nodes * nodes))
    # Opposite signs on h's tangential and normal parts move every slope the same way.
    up, down = 1.0 + _EPS, 1.0 - _EPS
    for first in range(0, cells.row.size, step):
        block = slice(first, first + step)
        row = cells.row[block]
        wi, wo, h, weight = chart.nodes(
            geometry[row], cells.code[block], cells.box[block], rule.nodes, rule.nodes
        )
        before = integrand(row, wi, wo, h)
        wi = wi * np.array([up, down, up])[:, None]
        wo = wo * np.array([down, up, up])[:, None, None]
        h = h * np.array([up, up, down])[:, None, None]
        moved = np.abs(integrand(row, wi, wo, h) - before) * np.abs(weight) @ weights
        shift += np.bincount(row, weights=moved, minlength=n)
    return shift


def compile_kernels(charts: Iterable[Chart]) -> None:
    """Compile the nodes of charts and the kernels of this room, by calling them with no cells.

    The panels of a chart are left out: another process works on them meanwhile.
    """
    none = np.empty(0, int)
    cells = _Cells.blank(none, np.empty((0, 6), int), np.empty((0, 6)), np.empty((0, 2), int))
    rule, values = gauss(8), np.empty((0, 64))
    _reduce(
        *(none, values, values, rule.weights, rule.weights),
        *(rule.to_coefficients, rule.to_coefficients),
        *(cells.value, cells.error, cells.tight, cells.size, cells.moments),
    )
    work = _Work(none, np.empty((0, 2), int), none)
    _choose(none, np.empty(0), cells.error, cells.size, cells.order, work.order, work.cut)
    _audit(cells, work.children(cells), work, np.ones(1))
    # Last: by now the kernels that they share with the panels are on disk.
    for chart in charts:
        chart.nodes(np.empty((0, 1)), cells.code, cells.box, rule.nodes, rule.nodes)
