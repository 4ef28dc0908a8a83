"""What is measured on a cell: its integral, bounds, size and moments, from values at its nodes.

Nodes come from a chart and values from a kernel of a model. Where both are compiled all blocks of
a round are computed inside one kernel, which finds the two by their addresses: a block fits in the
cache of a core, and threads meet once a round. A function of plain Python goes block by block.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Protocol, TypeGuard

import numpy as np

from albedo._compile import address, indirect, is_kernel, kernel
from albedo._threads import by_weight, in_batches
from albedo.charts._compiled import CompiledChart
from albedo.integrators.rules import (
    AROUND,
    LADDER,
    RUNGS,
    Rule,
    bounds_around,
    bounds_of,
    gauss,
    midpoint,
)

Integrand = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]

_EPS = np.finfo(np.float64).eps
# Nodes in one block, of nine numbers each: for a call from Python, and inside a kernel.
_BLOCK, _INNER_BLOCK = 16384, 2048
# Nodes that are worth another thread.
_WORTH = 8192
# First Legendre moments of both marginals, compared when a cell is computed again: several
# numbers, because the value alone may happen to agree.
MOMENTS = 4
# A marginal of which one node carries more than this share has not been seen: a spike may stand
# beside it. The share that may hide is a number that no tolerance can live with.
_LONE, HIDDEN = 0.99, 1e9
# The first node's distance from the end, as a share of that to the second: 0.27 to 0.37 for two to
# four nodes, 0.26 for five.
_OUTWARD = 0.3

# Types of `CompiledChart.layout`, and of `Part.fill`.
NODES_TYPES = (
    "void(f8[:,::1], i8[:,::1], f8[:,::1], f8[::1], f8[::1], f8[::1],"
    " f8[:,::1], f8[:,:,::1], f8[:,:,::1], f8[:,::1])"
)
_FILL_TYPES = "void(f8[:,::1], f8[:,:,::1], f8[:,:,::1], f8[:,::1], f8[:,::1])"
_lay_out, _fill = indirect(NODES_TYPES), indirect(_FILL_TYPES)


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


@dataclass(frozen=True, eq=False)
class ModelIntegrand:
    """The values of one part of a model, each row with parameters of its own.

    Attributes
    ----------
    fill : callable
        See `albedo.brdf.Part`.
    p : ndarray, shape (n, k)
        Packed parameters of the rows.
    scale : ndarray, shape (n,)
        Factors of the values.
    swap : bool
        The fixed direction is the view, not the light.
    shared : bool
        All cores work on it.
    """

    fill: Callable[..., Any]
    p: np.ndarray
    scale: np.ndarray
    swap: bool = False
    shared: bool = False

    def __call__(
        self, row: np.ndarray, wi: np.ndarray, wo: np.ndarray, h: np.ndarray
    ) -> np.ndarray:
        out: np.ndarray = np.empty(wo.shape[1:])
        if not self.swap:
            self.fill(wi, wo, h, self.p[row], out)
        else:
            # Every node is a light direction of its own.
            count = out.shape[1]
            view = np.repeat(wi, count, axis=1).reshape(3, -1, 1)
            flat, p = out.reshape(-1, 1), np.repeat(self.p[row], count, axis=0)
            self.fill(wo.reshape(3, -1), view, h.reshape(3, -1, 1), p, flat)
            out = flat.reshape(-1, count)
        return out * self.scale[row][:, None]

    def compiled(self, chart: Chart) -> TypeGuard[CompiledChart]:
        """Whether values, and nodes of the chart, are found by their addresses."""
        return is_kernel(self.fill) and isinstance(chart, CompiledChart) and not self.swap


def of_rows(integrand: Integrand, rows: np.ndarray) -> Integrand:
    """The integrand of some rows only, which count from 0."""
    if isinstance(integrand, ModelIntegrand):
        return replace(integrand, p=integrand.p[rows], scale=integrand.scale[rows])
    return lambda row, wi, wo, h: integrand(rows[row], wi, wo, h)


@dataclass
class Cells:
    """A growing set of cells, one entry per array element."""

    row: np.ndarray
    code: np.ndarray
    box: np.ndarray
    order: np.ndarray  # (m, 2) nodes along u and v
    value: np.ndarray
    error: np.ndarray  # (m, 2) bounds along u and v, to stop on
    tight: np.ndarray  # (m,) their sum, to report where nothing was stopped on it
    size: np.ndarray  # integral of the modulus
    moments: np.ndarray  # (m, 2, MOMENTS) first coefficients of the marginals
    series: np.ndarray  # (m, terms) Legendre coefficients along v, as many as are wanted

    @classmethod
    def blank(
        cls, row: np.ndarray, code: np.ndarray, box: np.ndarray, order: np.ndarray, terms: int = 0
    ) -> Cells:
        """Cells that are still to be evaluated."""
        m = row.size
        empty = np.zeros(m), np.zeros((m, 2)), np.zeros(m), np.zeros(m), np.zeros((m, 2, MOMENTS))
        return cls(row, code, box, order, *empty, np.zeros((m, terms)))

    @property
    def measured(self) -> tuple[np.ndarray, ...]:
        """What `evaluate` fills."""
        return self.value, self.error, self.tight, self.size, self.moments, self.series

    def replace(self, parent: np.ndarray, children: Cells) -> None:
        """Put the first children in the places of their parents, and the others at the end."""
        m = parent.size
        for f in self.__dataclass_fields__:
            old, new = getattr(self, f), getattr(children, f)
            # Children stay in the row and in the panel of their parents.
            if f not in ("row", "code"):
                old[parent] = new[:m]
            if new.shape[0] > m:
                setattr(self, f, np.concatenate((old, new[m:])))


@cache
def rules_by_order() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes, weights and matrices to coefficients of Gauss's rules, by their numbers of nodes."""
    return _by_order(gauss, LADDER)


@cache
def _rules_around() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """As `rules_by_order`, of the rules around whole rings."""
    return _by_order(midpoint, RUNGS)


def _by_order(
    rule_of: Callable[[int], Rule], orders: Sequence[int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    top = orders[-1]
    nodes, weights = np.zeros((top + 1, top)), np.zeros((top + 1, top))
    matrices = np.zeros((top + 1, top * top))
    for p in (1, *orders):
        rule = rule_of(p)
        nodes[p, :p], weights[p, :p] = rule.nodes, rule.weights
        matrices[p, : p * p] = rule.to_coefficients.ravel()
    return nodes, weights, matrices


def whole_rings(chart: Chart, box: np.ndarray) -> np.ndarray:
    """Which cells go all around, where they are even about both ends and have the midpoint rule.

    Parameters
    ----------
    chart : Chart
    box : ndarray, shape (m, ...)
        Of the cells.

    Returns
    -------
    ndarray of bool, shape (m,)
    """
    if not (isinstance(chart, CompiledChart) and chart.around in AROUND):
        return np.zeros(box.shape[0], dtype=bool)
    found: np.ndarray = (box[:, 0] == 0.0) & (box[:, 1] == 1.0)
    return found


def evaluate(chart: Chart, integrand: Integrand, geometry: np.ndarray, cells: Cells) -> None:
    """Fill what is measured of all cells.

    Parameters
    ----------
    chart : Chart
        Where the nodes lie.
    integrand : callable
        Values at the nodes.
    geometry : ndarray
        What the chart told of every row.
    cells : Cells
        Changed in place.
    """
    # Cells that share a pair of rules stand together, so that every block is a slice.
    # Sixteen bits are sorted in linear time.
    around = whole_rings(chart, cells.box)
    farthest = AROUND[chart.around] if isinstance(chart, CompiledChart) and around.any() else 0.0
    key = (cells.order[:, 0] + (RUNGS[-1] + 1) * around) * (LADDER[-1] + 1) + cells.order[:, 1]
    key = key.astype(np.int16)
    rank = np.argsort(key, kind="stable")
    row, code, box, order = (a[rank] for a in (cells.row, cells.code, cells.box, cells.order))
    around = around[rank]
    geometry = geometry[row]
    if isinstance(integrand, ModelIntegrand) and integrand.compiled(chart):
        lay_out, numbers = chart.layout
        nodes, fill = address(lay_out, NODES_TYPES), address(integrand.fill, _FILL_TYPES)
        p, scale = integrand.p[row], integrand.scale[row]
        rules = *rules_by_order(), *_rules_around()

        def sweep(part: slice) -> None:
            _sweep(
                *(nodes, numbers, geometry[part], code[part], box[part], fill, p[part]),
                *(scale[part], order[part], around[part], rank[part]),
                *(*rules, farthest, _INNER_BLOCK, *cells.measured),
            )

        if integrand.shared:
            by_weight(sweep, order.prod(1), _WORTH)
        else:
            sweep(slice(None))
        return
    edges = np.flatnonzero(np.diff(key[rank])) + 1
    blocks = []
    for start, stop in itertools.pairwise((0, *edges.tolist(), rank.size)):
        step = max(1, _BLOCK // int(order[start].prod())) if stop > start else 1
        blocks += [slice(first, min(first + step, stop)) for first in range(start, stop, step)]

    def measure(which: slice) -> None:
        for block in blocks[which]:
            along_u, along_v = order[block.start].tolist()
            whole = farthest if around[block.start] else 0.0
            rule_u, rule_v = midpoint(along_u) if whole > 0.0 else gauss(along_u), gauss(along_v)
            wi, wo, h, weight = chart.nodes(
                geometry[block], code[block], box[block], rule_u.nodes, rule_v.nodes
            )
            f = integrand(row[block], wi, wo, h)
            _reduce(
                *(rank[block], f, weight, rule_u.weights, rule_v.weights),
                *(rule_u.to_coefficients, rule_v.to_coefficients, whole, *cells.measured),
            )

    if isinstance(integrand, ModelIntegrand) and integrand.shared:
        in_batches(measure, len(blocks), 1)
    else:
        measure(slice(None))


def probe_cells(
    chart: Chart, integrand: Integrand, geometry: np.ndarray, cells: Cells, n: int, nodes: int
) -> np.ndarray:
    """How far the integral of each row moves when every direction at the nodes moves by an ulp.

    Parameters
    ----------
    chart, integrand, geometry, cells
        As in `evaluate`.
    n : int
        The number of rows.
    nodes : int
        Nodes along each side of a cell.

    Returns
    -------
    ndarray, shape (n,)
        Sums of what moves at the nodes, in absolute value.
    """
    shift = np.zeros(n)
    rule = gauss(nodes)
    weights = np.outer(rule.weights, rule.weights).ravel()
    step = max(1, _BLOCK // (nodes * nodes))
    # Opposite signs on h's tangential and normal parts move every slope the same way.
    up, down = 1.0 + _EPS, 1.0 - _EPS
    shared = isinstance(integrand, ModelIntegrand) and integrand.shared
    for first in range(0, cells.row.size, step):
        block = slice(first, first + step)
        row = cells.row[block]
        wi, wo, h, weight = chart.nodes(
            geometry[row], cells.code[block], cells.box[block], rule.nodes, rule.nodes
        )
        here = wi, wo, h
        there = (
            wi * np.array([up, down, up])[:, None],
            wo * np.array([down, up, up])[:, None, None],
            h * np.array([up, up, down])[:, None, None],
        )

        def values(which: slice, row: np.ndarray = row, places: Any = (here, there)) -> Any:
            return [integrand(row, *place) for place in places[which]]

        found = in_batches(values, 2, 1) if shared else [values(slice(None))]
        before, after = itertools.chain(*found)
        moved = np.abs(after - before) * np.abs(weight) @ weights
        shift += np.bincount(row, weights=moved, minlength=n)
    return shift


@kernel
def fill_spectrum(along, weights, to_coefficients, spectrum):
    """Fill the spectrum of a marginal; return what nodes hide that are alone or few, or 0."""
    p = along.size
    for k in range(p):
        spectrum[k] = 0.0
    # Nodes outside: sums side by side need no order among themselves, and are done at once.
    for i in range(p):
        for k in range(p):
            spectrum[k] += along[i] * to_coefficients[i, k]
    seen = most = 0.0
    for i in range(p):
        part = abs(along[i]) * weights[i]
        seen += part
        most = max(most, part)
    if most > _LONE * seen:
        return HIDDEN * seen
    return _outside(along, weights) if p < 6 else 0.0


@kernel
def _outside(along, weights):
    """What few nodes leave out at the ends, if the marginal goes on as from one node to another.

    Panels are stretched by the logarithm of the distance, where layers rise exponentially.
    """
    p = along.size
    unseen = 0.0
    for end, inner in ((0, 1), (p - 1, p - 2)):
        first, second = abs(along[end]), abs(along[inner])
        if first > second:
            rise = first / max(second, 1e-30 * first)
            unseen += weights[end] * first * (rise**_OUTWARD - 1.0)
    return unseen


@kernel
def judge(along, weights, to_coefficients, farthest, spectrum, room):
    """Fill the spectrum of a marginal, around whole rings if the e-folds that may be claimed are
    told; return its two bounds."""
    hidden = fill_spectrum(along, weights, to_coefficients, spectrum)
    if farthest > 0.0:
        stop, report = bounds_around(spectrum[: along.size], farthest, room)
    else:
        stop, report = bounds_of(spectrum[: along.size])
    return max(stop, hidden), max(report, hidden)


@kernel
def _reduce(
    block,
    f,
    weight,
    weights_u,
    weights_v,
    to_u,
    to_v,
    farthest,
    value,
    error,
    tight,
    size,
    moments,
    series,
):
    """Fill what is measured of the cells in a block, from the values at their nodes."""
    p, q = weights_u.size, weights_v.size
    along_u, along_v = np.empty(p), np.empty(q)
    spectrum, room = np.empty(max(p, q)), np.empty(max(p, q))
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
        error[cell, 0], report = judge(along_u, weights_u, to_u, farthest, spectrum, room)
        value[cell] = spectrum[0]
        for j in range(min(p, MOMENTS)):
            moments[cell, 0, j] = spectrum[j]
        error[cell, 1], other = judge(along_v, weights_v, to_v, 0.0, spectrum, room)
        for j in range(min(q, MOMENTS)):
            moments[cell, 1, j] = spectrum[j]
        for j in range(min(q, series.shape[1])):
            series[cell, j] = spectrum[j]
        tight[cell] = report + other


@kernel
def _flat(room, m, n):
    return room[: m * n].reshape(m, n)


@kernel
def _deep(room, m, n):
    return room[: 3 * m * n].reshape(3, m, n)


@kernel
def _sweep(
    nodes,
    numbers,
    geometry,
    code,
    box,
    fill,
    p,
    scale,
    order,
    around,
    place,
    rule_nodes,
    rule_weights,
    rule_matrices,
    nodes_around,
    weights_around,
    matrices_around,
    farthest,
    block,
    value,
    error,
    tight,
    size,
    moments,
    series,
):
    """Evaluate cells that stand in the order of their pairs of rules, block by block."""
    room = max(block, rule_nodes.shape[1] * nodes_around.shape[1])
    wi_room, wo_room, h_room = np.empty(3 * room), np.empty(3 * room), np.empty(3 * room)
    weight_room, f_room = np.empty(room), np.empty(room)
    first = 0
    while first < place.size:
        a, b, whole = order[first, 0], order[first, 1], around[first]
        count = a * b
        stop = first + 1
        last = min(place.size, first + max(1, block // count))
        while stop < last and order[stop, 0] == a and order[stop, 1] == b:
            if around[stop] != whole:
                break
            stop += 1
        m = stop - first
        wi, wo, h = _flat(wi_room, 3, m), _deep(wo_room, m, count), _deep(h_room, m, count)
        weight, f = _flat(weight_room, m, count), _flat(f_room, m, count)
        u, v = (nodes_around if whole else rule_nodes)[a, :a], rule_nodes[b, :b]
        shape, kinds, ends = geometry[first:stop], code[first:stop], box[first:stop]
        _lay_out(nodes, (shape, kinds, ends, u, v, numbers, wi, wo, h, weight))
        _fill(fill, (wi, wo, h, p[first:stop], f))
        for k in range(m):
            if scale[first + k] != 1.0:
                for i in range(count):
                    f[k, i] *= scale[first + k]
        _reduce(
            place[first:stop],
            f,
            weight,
            (weights_around if whole else rule_weights)[a, :a],
            rule_weights[b, :b],
            _flat((matrices_around if whole else rule_matrices)[a], a, a),
            _flat(rule_matrices[b], b, b),
            farthest if whole else 0.0,
            value,
            error,
            tight,
            size,
            moments,
            series,
        )
        first = stop


def compile_cells(charts: Iterable[Chart]) -> None:
    """Compile what evaluates cells, and the nodes of charts; formulas of models are left out."""
    none, table = np.empty(0, int), np.empty((0, 1))
    cells = Cells.blank(none, np.empty((0, 6), int), np.empty((0, 6)), np.empty((0, 2), int))
    _sweep(
        *(0, np.empty(1), table, cells.code, cells.box, 0, table, np.empty(0)),
        *(cells.order, np.empty(0, dtype=bool), none, *rules_by_order(), *_rules_around()),
        *(0.0, _INNER_BLOCK, *cells.measured),
    )
    # Last: by now the kernels that they share with the panels are on disk.
    for chart in charts:
        if isinstance(chart, CompiledChart):
            address(chart.layout[0], NODES_TYPES)
