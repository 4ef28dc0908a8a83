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

from collections.abc import Callable
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

    def join(self, other: _Cells) -> _Cells:
        pairs = ((getattr(self, f), getattr(other, f)) for f in self.__dataclass_fields__)
        return _Cells(*(np.concatenate(pair) for pair in pairs))


def integrate(
    chart: Chart,
    integrand: Integrand,
    cos_theta: np.ndarray,
    phi: np.ndarray,
    widths: np.ndarray,
    isotropic: bool,
    *,
    rtol: float,
    atol: float,
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
    rtol, atol : float
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
    retired: list[_Cells] = []
    for _ in range(_ROUNDS):
        value, error, size, leaves = _sums(cells, n)
        rounding = _ROUNDINGS * _EPS * size
        target = np.maximum(atol, rtol * np.abs(value))
        # Leave half of the tolerance to rounding and to the probe.
        active &= doubt * error + rounding > 0.5 * target
        if not active.any():
            break
        alive = active[cells.row]
        if np.count_nonzero(alive) < 0.8 * alive.size:
            # What is done need not be sorted and copied again.
            retired.append(cells.take(~alive))
            cells = cells.take(alive)
        work = _plan(cells, 0.25 * target / doubt, active, n)
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
        doubt = _audit(cells, children, work, doubt)
        keep = np.ones(cells.row.size, dtype=bool)
        keep[work.parent] = False
        cells = cells.take(keep).join(children)
    for done in retired:
        cells = cells.join(done)
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
            atol=atol,
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


def _groups(order: np.ndarray) -> list[tuple[int, int, np.ndarray]]:
    """Cells that share a pair of orders."""
    key = order[:, 0] * 1000 + order[:, 1]
    rank = np.argsort(key, kind="stable")
    keys, start = np.unique(key[rank], return_index=True)
    pieces = np.split(rank, start[1:])
    return [(int(k) // 1000, int(k) % 1000, piece) for k, piece in zip(keys, pieces, strict=True)]


def _evaluate(chart: Chart, integrand: Integrand, geometry: np.ndarray, cells: _Cells) -> None:
    """Fill value, error and size of all cells."""
    for p, q, members in _groups(cells.order):
        rule_u, rule_v = gauss(p), gauss(q)
        step = max(1, _BLOCK // (p * q))
        for first in range(0, members.size, step):
            block = members[first : first + step]
            row = cells.row[block]
            wi, wo, h, weight = chart.nodes(
                geometry[row], cells.code[block], cells.box[block], rule_u.nodes, rule_v.nodes
            )
            f = integrand(row, wi, wo, h)
            _reduce(
                *(block, f, weight, rule_u.weights, rule_v.weights),
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
    total = cells.error.sum(1)
    rank = np.lexsort((total, cells.row))
    rows, running = cells.row[rank], np.cumsum(total[rank])
    start = np.concatenate(([True], rows[1:] != rows[:-1]))
    base = (running - total[rank])[start][np.cumsum(start) - 1]
    spare = running - base <= allowed[rows]
    parent = np.sort(rank[active[rows] & ~spare])
    count = np.bincount(cells.row[parent], minlength=n)
    error, old = cells.error[parent], cells.order[parent]
    size = np.maximum(cells.size[parent], 1e-300)[:, None]
    goal = (0.5 * allowed / np.maximum(count, 1))[cells.row[parent]][:, None]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        # Spectra of entire functions fall ever faster, so less than proportionally more will do.
        growth = np.where(old <= 16, _GROWTH, 1.0)
        wanted = old * (np.log(goal / size) / np.log(np.minimum(error / size, 0.9))) ** growth
        # A direction that was resolved far too well may use fewer nodes once the cell is cut.
        enough = 1.3 * old * np.log(goal / size) / np.log(np.maximum(error / size, 1e-25)) + 2.0
    wanted = np.where(error > goal, np.maximum(wanted, old + 2), old)
    wanted = np.where(np.isfinite(wanted), wanted, 1e9)
    order = np.maximum(_rung(wanted), old)
    hopeless = (wanted > np.where(old < 20, 1.5, 1.1) * _TOP) | ((old >= _TOP) & (error > goal))
    worst = np.argmax(np.where(hopeless, error, -1.0), axis=1)
    cut = np.where(hopeless.any(1), worst, -1)
    # A half needs fewer nodes along the cut, and what was planned across it.
    one = np.arange(parent.size)
    across = 1 - worst
    spare = (cut >= 0) & (error[one, across] < 1e-3 * goal[:, 0])
    fewer = np.minimum(_rung(np.clip(enough[one, across], 10, _TOP)), old[one, across])
    order[one, across] = np.where(spare, fewer, order[one, across])
    order[one, worst] = np.where(cut >= 0, np.clip(old[one, worst], 8, 20), order[one, worst])
    return _Work(parent, order, cut)


def _rung(wanted: np.ndarray) -> np.ndarray:
    """The next order on the ladder."""
    return _LADDER[np.minimum(np.searchsorted(_LADDER, wanted), _LADDER.size - 1)]


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


def _moved(old: _Cells, children: _Cells, work: _Work) -> np.ndarray:
    """How far the moments of cells moved when they were computed again: the old error."""
    m = work.parent.size
    new = children.moments[:m].copy()
    second = np.flatnonzero(work.cut >= 0)
    for d in (0, 1):
        here = work.cut[second] == d
        both, upper = second[here], children.moments[m:][here]
        new[both, 1 - d] += upper[:, 1 - d]
        new[both, d] = new[both, d] @ _LEFT + upper[:, d] @ _RIGHT
    moved: np.ndarray = np.abs(new - old.moments).max(axis=(1, 2))
    return moved


def _audit(cells: _Cells, children: _Cells, work: _Work, doubt: np.ndarray) -> np.ndarray:
    """Judge old bounds and new ones by what moved; return the doubt of every row."""
    m = work.parent.size
    old = cells.take(work.parent)
    second = np.flatnonzero(work.cut >= 0)
    new, slack = children.value[:m].copy(), children.error[:m].sum(1)
    new[second] += children.value[m:]
    slack[second] += children.error[m:].sum(1)
    # A bound that was passed makes all bounds of its row doubtful.
    excess = np.abs(new - old.value) - slack - _ROUNDINGS * _EPS * old.size
    bound = np.maximum(old.error.sum(1), 1e-300)
    passed = (excess > bound) & (excess > 1e-13 * old.size)
    doubt = doubt.copy()
    np.maximum.at(doubt, old.row[passed], np.minimum(excess / bound, 1e6)[passed])
    moved = _moved(old, children, work)
    # Along a direction that became finer, the new error is not worse than the old one was.
    finer = work.order >= 1.2 * old.order
    finer[second, work.cut[second]] = True
    most = np.where(finer, _TRUST * moved[:, None], np.inf)
    np.minimum(children.error[:m], most, out=children.error[:m])
    np.minimum(children.error[m:], most[second], out=children.error[m:])
    # A geometric fall takes the error e of p nodes to e^(q/p) for q nodes.
    growth = work.order / old.order
    growth = np.where(growth > 1.0, growth, np.inf).min(1)
    share = np.minimum(moved / np.maximum(old.size, 1e-300), 1.0)
    raised = (work.cut < 0) & np.isfinite(growth)
    least = np.where(raised, _TRUST * moved * share ** np.where(raised, growth - 1.0, 0.0), 0.0)
    one, worst = np.arange(m), children.error[:m].argmax(1)
    children.error[one, worst] += np.maximum(least - children.error[:m].sum(1), 0.0)
    children.tight[:m] = np.maximum(children.tight[:m], least)
    return doubt


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
