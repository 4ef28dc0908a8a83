r"""The albedos of a model that is pumped up again and again, each step for the price of a sum.

The divisor of a step knows only the heights of L and V. So what all steps need of the model is its
integral around each ring of constant n.v: the cells of the integrator, in the chart of rings, hold
it at their nodes, and a step multiplies, adds up and reads the spectra anew. Where two albedos
cross, a ring is a kink from then on: cells are cut there, and their halves computed again.

An albedo that is read by later steps carries an error into them; that of the last curve is what
was seen between its nodes. What becomes of it is linear: where e_j is the relative error of the
albedo a_j that step j reads, the a_k that follows has the relative error

    e_k = eta_k - sum over j < k of <e_j(the side with the larger a_j)>_k,

the average being over the light that f_k sends on, and eta_k what is new. The averages are taken
piece by piece, which gives a triangular system; the moduli of its inverse bound every error.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev

from albedo._compile import kernel
from albedo.brdf import Model, Part
from albedo.charts._compiled import clustered
from albedo.charts.cosine import CosineChart
from albedo.charts.polar import PolarChart
from albedo.charts.rings import RingsChart, elevation
from albedo.errors import InputError
from albedo.integrators.adaptive import refine
from albedo.integrators.cells import (
    Cells,
    ModelIntegrand,
    evaluate,
    judge,
    probe_cells,
    rules_by_order,
)
from albedo.integrators.rules import LADDER, gauss
from albedo.operators.divisor import (
    FIRST,
    FLAT,
    LAST,
    LOWEST,
    NODES,
    ORDER,
    Divisor,
    LogCurve,
    folded,
    straight,
    unfolded,
)

_TOP = LADDER[-1]
_EPS = np.finfo(np.float64).eps
_ROUNDINGS = 40.0
_FRESH = chebyshev.chebpts2(ORDER + 1)
# Between its nodes, where the fresh points stand, an interpolant errs most; in between not by more.
_TRUST = 8.0
# What errors at the nodes may come to between them: the Lebesgue constant of 16 Chebyshev nodes.
_LEBESGUE = 2.8
_MOST_PIECES = 400
_SHORTEST = 1e-5
_LIMIT = 400_000
# Sums over rings may have this share of the tolerance; cells are not cut to less than a part.
_SHARE, _ROUNDS, _NARROWEST = 0.05, 12, 1e-3
# What a kink that no node sees may hide in one cell, as a share of the tolerance.
_HIDDEN = 0.003
_BLOCK = 16384


@dataclass(frozen=True)
class _Both:
    """The levels of two operators, one over the other."""

    first: Any
    second: Any

    def __call__(self, cos_light: np.ndarray) -> np.ndarray:
        return np.column_stack((self.first(cos_light), self.second(cos_light)))


def rings_of(part: Part, levels: Any = None) -> RingsChart:
    """The chart of rings for a part of an isotropic model.

    Parameters
    ----------
    part : Part
        With a chart about the mirror direction, or for what is broad.
    levels : callable, optional
        See `albedo.charts.rings.RingsChart`.

    Raises
    ------
    InputError
        For parts whose lobes lie elsewhere.
    """
    chart = part.chart
    if isinstance(chart, RingsChart):
        # A part that was pumped up before has kinks already.
        if chart.levels is None or levels is None:
            return replace(chart, levels=chart.levels or levels)
        return replace(chart, levels=_Both(chart.levels, levels))
    if isinstance(chart, CosineChart):
        return RingsChart("broad", "max", levels=levels)
    if isinstance(chart, PolarChart) and chart.kind in ("slope", "mirror", "mirror_hemisphere"):
        edge = chart.edge if chart.kind == "mirror" else 1
        thin = chart.layer == 2
        return RingsChart(chart.kind, chart.kinks, chart.decay, edge, thin, levels)
    raise InputError(
        f"the {part.name} part cannot be pumped up: its lobe is not about the mirror direction"
    )


@kernel
def _ring_sums(f, weight, weights_u, q, place, density):
    """Fill integrals along u, at the nodes along v."""
    p = weights_u.size
    for k in range(place.size):
        for j in range(q):
            total = 0.0
            for i in range(p):
                total += f[k, i * q + j] * weight[k, i * q + j] * weights_u[i]
            density[place[k], j] = total


@kernel
def _row_sums(
    row,
    order,
    density,
    log_divisor,
    error_u,
    nodes_weights,
    matrices,
    value,
    error,
    along_u,
    along_v,
):
    """Add up rows, with the bounds of the rules along v; `error_u` is that of the rules along u."""
    spectrum, along = np.empty(32), np.empty(32)
    for k in range(row.size):
        q = order[k, 1]
        most = 0.0
        for j in range(q):
            scale = np.exp(-log_divisor[k, j])
            along[j] = density[k, j] * scale
            most = max(most, scale)
        stop, _ = judge(
            along[:q], nodes_weights[q, :q], matrices[q, : q * q].reshape(q, q), spectrum
        )
        along_u[k] = error_u[k] * most
        along_v[k] = stop
        value[row[k]] += spectrum[0]
        error[row[k]] += stop + error_u[k] * most


@kernel
def _selected(row, order, sent, at_l, at_v, free, own_piece, piece_v, matrix):
    """Add the shares of the energy of rows to the pieces of the curve that was divided by.

    `free` tells the nodes at which the curve, and not the height, was divided by.
    """
    for k in range(row.size):
        r = row[k]
        for j in range(order[k, 1]):
            if not free[k, j]:
                continue
            if at_l[r] >= at_v[k, j]:
                matrix[r, own_piece[r]] += sent[k, j]
            else:
                matrix[r, piece_v[k, j]] += sent[k, j]


@dataclass
class _Rings:
    """One part of a model at many incidences: its integrals around rings, cell by cell."""

    chart: RingsChart
    integrand: ModelIntegrand
    geometry: np.ndarray
    cells: Cells
    doubt: np.ndarray
    shift: np.ndarray
    density: np.ndarray
    c: np.ndarray
    s: np.ndarray
    log_divisor: np.ndarray

    @classmethod
    def of(cls, model: Model, part: Part, cos_theta: np.ndarray, rtol: float) -> _Rings:
        n = cos_theta.size
        p = part.packed(np.tile(np.array(model.pack(), dtype=np.float64), (n, 1)))
        chart, integrand = rings_of(part), ModelIntegrand(part.fill, p, np.full(n, part.scale))
        widths = np.tile(part.widths, (n, 1))
        done = refine(
            *(chart, integrand, cos_theta, np.zeros(n), widths, True),
            rtol=rtol,
            atol=0.0,
            limit=_LIMIT,
        )
        # What directions moved by an ulp change, as a share of what is sent on, and what the
        # numbers of the part are worth.
        moved = probe_cells(chart, integrand, done.geometry, done.cells, n, 1)
        sent = np.maximum(np.bincount(done.cells.row, done.cells.value, n), 1e-300)
        own = part.doubt(cos_theta) if callable(part.doubt) else part.doubt
        shift = 4.0 * moved / sent + own
        empty = (np.empty((0, _TOP)) for _ in range(4))
        found = cls(chart, integrand, done.geometry, done.cells, done.doubt, shift, *empty)
        found.density, found.c, found.s = found._around(done.cells)
        found.log_divisor = np.zeros_like(found.density)
        return found

    def _around(self, cells: Cells) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Integrals along u at the nodes along v, and cosine and sine of V there."""
        m = cells.row.size
        density, c, s = np.zeros((m, _TOP)), np.ones((m, _TOP)), np.zeros((m, _TOP))
        key = cells.order[:, 0] * (_TOP + 1) + cells.order[:, 1]
        rank = np.argsort(key, kind="stable")
        edges = np.flatnonzero(np.diff(key[rank])) + 1
        for start, stop in itertools.pairwise((0, *edges.tolist(), m)):
            if start == stop:
                continue
            p, q = cells.order[rank[start]].tolist()
            step = max(1, _BLOCK // (p * q))
            for first in range(start, stop, step):
                block = rank[first : min(first + step, stop)]
                row = cells.row[block]
                wi, wo, h, weight = self.chart.nodes(
                    self.geometry[row],
                    cells.code[block],
                    cells.box[block],
                    gauss(p).nodes,
                    gauss(q).nodes,
                )
                f = self.integrand(row, wi, wo, h)
                _ring_sums(f, weight, gauss(p).weights, q, block, density)
                # All nodes along u have one height.
                c[block, :q] = wo[2, :, :q]
                s[block, :q] = np.hypot(wo[0, :, :q], wo[1, :, :q])
        return density, c, s

    def cut(self, places: np.ndarray, divisor: Divisor, cos_theta: np.ndarray) -> None:
        """Cut cells along v at places in (0, 1) of each, (m, k), NaN where there are none."""
        inside = np.isfinite(places)
        hit = np.flatnonzero(inside.any(1))
        count = inside[hit].sum(1)
        ends = np.column_stack(
            (np.zeros(hit.size), np.sort(places[hit], axis=1), np.ones(hit.size))
        )
        ends[np.arange(hit.size), count + 1] = 1.0
        low, high = ends[:, :-1], ends[:, 1:]
        real = (np.arange(low.shape[1]) <= count[:, None]) & (high - low > 1e-12)
        k, j = np.nonzero(real)
        parent = hit[k]
        box = self.cells.box[parent].copy()
        start, size = box[:, 2].copy(), box[:, 3] - box[:, 2]
        box[:, 2], box[:, 3] = start + low[k, j] * size, start + high[k, j] * size
        self._replace(parent, box, divisor, cos_theta)

    def halve(self, hit: np.ndarray, divisor: Divisor, cos_theta: np.ndarray) -> None:
        """Halve cells along u."""
        parent = np.repeat(np.flatnonzero(hit), 2)
        box = self.cells.box[parent].copy()
        middle = 0.5 * (box[::2, 0] + box[::2, 1])
        box[::2, 1] = middle
        box[1::2, 0] = middle
        self._replace(parent, box, divisor, cos_theta)

    def _replace(
        self, parent: np.ndarray, box: np.ndarray, divisor: Divisor, cos_theta: np.ndarray
    ) -> None:
        """Put other cells in the places of their parents."""
        if parent.size == 0:
            return
        cells = self.cells
        children = Cells.blank(
            cells.row[parent], cells.code[parent], box, cells.order[parent].copy()
        )
        evaluate(self.chart, self.integrand, self.geometry, children)
        new = self._around(children)
        keep = np.ones(cells.row.size, dtype=bool)
        keep[parent] = False
        for name in Cells.__dataclass_fields__:
            joined = np.concatenate((getattr(cells, name)[keep], getattr(children, name)))
            setattr(cells, name, joined)
        log_divisor = divisor.at_nodes(cos_theta, children.row, new[1], new[2])
        for name, fresh in zip(
            ("density", "c", "s", "log_divisor"), (*new, log_divisor), strict=True
        ):
            setattr(self, name, np.concatenate((getattr(self, name)[keep], fresh)))

    def places(self, levels: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """Where in (0, 1) of cells their row's levels of n.v lie, NaN for others and outside."""
        ends = self.heights(np.array([0.0, 1.0]))
        level = np.arcsin(np.minimum(levels, 1.0))[self.cells.row]
        low, high = ends.min(1)[:, None], ends.max(1)[:, None]
        margin = 1e-12 * (high - low)
        inside = (level > low + margin) & (level < high - margin) & wanted[:, None]
        found = np.full(level.shape, np.nan)
        cell, which = np.nonzero(inside)
        goal = level[cell, which]
        rising = (ends[:, 1] > ends[:, 0])[cell]
        a, b = np.zeros(cell.size), np.ones(cell.size)
        for _ in range(52):
            middle = 0.5 * (a + b)
            here = np.empty(cell.size)
            _heights(
                *(self.geometry[self.cells.row[cell]], self.cells.code[cell]),
                *(self.cells.box[cell], middle[:, None], here[:, None]),
            )
            below = (here < goal) == rising
            a, b = np.where(below, middle, a), np.where(below, b, middle)
        found[cell, which] = 0.5 * (a + b)
        return found

    def heights(self, v: np.ndarray) -> np.ndarray:
        """Elevations of V at places v of all cells, (m, v.size)."""
        out = np.empty((self.cells.row.size, v.size))
        places = np.tile(v, (out.shape[0], 1))
        _heights(self.geometry[self.cells.row], self.cells.code, self.cells.box, places, out)
        return out

    def sums(self, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Values of all rows, bounds on their errors, and the bounds of cells along u and v."""
        _, weights, matrices = rules_by_order()
        value, error = np.zeros(n), np.zeros(n)
        along_u, along_v = np.empty(self.cells.row.size), np.empty(self.cells.row.size)
        _row_sums(
            *(self.cells.row, self.cells.order, self.density, self.log_divisor),
            *(self.cells.error[:, 0].copy(), weights, matrices, value, error, along_u, along_v),
        )
        return value, error * self.doubt, along_u, along_v

    def rows(self, kept: np.ndarray) -> _Rings:
        """Only some of the rows, which count from 0 again."""
        number = np.full(self.geometry.shape[0], -1)
        number[kept] = np.arange(kept.size)
        stays = number[self.cells.row] >= 0
        cells = Cells(*(getattr(self.cells, k)[stays] for k in Cells.__dataclass_fields__))
        cells.row = number[cells.row]
        integrand = ModelIntegrand(
            self.integrand.fill, self.integrand.p[kept], self.integrand.scale[kept]
        )
        arrays = (a[stays] for a in (self.density, self.c, self.s, self.log_divisor))
        return _Rings(
            *(self.chart, integrand, self.geometry[kept], cells, self.doubt[kept]),
            *(self.shift[kept], *arrays),
        )

    def joined(self, other: _Rings) -> _Rings:
        """The rows of both."""
        n = self.geometry.shape[0]
        theirs = other.cells
        cells = Cells(
            *(
                np.concatenate(
                    (getattr(self.cells, k), getattr(theirs, k) + (n if k == "row" else 0))
                )
                for k in Cells.__dataclass_fields__
            )
        )
        integrand = ModelIntegrand(
            self.integrand.fill,
            np.concatenate((self.integrand.p, other.integrand.p)),
            np.concatenate((self.integrand.scale, other.integrand.scale)),
        )
        names = ("density", "c", "s", "log_divisor")
        joined = (np.concatenate((getattr(self, k), getattr(other, k))) for k in names)
        geometry, doubt, shift = (
            np.concatenate((getattr(self, k), getattr(other, k)))
            for k in ("geometry", "doubt", "shift")
        )
        return _Rings(self.chart, integrand, geometry, cells, doubt, shift, *joined)


@kernel
def _heights(geometry, code, box, v, out):
    """Elevations of V at places v (m, k) of cells."""
    for k in range(v.shape[0]):
        for j in range(v.shape[1]):
            x, _ = clustered(box[k, 2] + (box[k, 3] - box[k, 2]) * v[k, j], code[k, 3])
            s = box[k, 4] + (box[k, 5] - box[k, 4]) * x
            out[k, j] = elevation(geometry[k], code[k, 0], s)[0]


@dataclass
class _Piece:
    """One piece of all curves from now on, with the rows of its nodes."""

    low: float
    high: float
    bent: int
    first: int


class Ladder:
    """The albedos a_0, a_1, ... of a model and of what pumping-up makes of it.

    Parameters
    ----------
    model : Model
        Isotropic and reciprocal.
    control : {None, "literal", "cumulative"}
        See `albedo.operators.divisor.CONTROLS`.
    rtol : float
        What the curves are to be worth, relatively.
    """

    def __init__(self, model: Model, control: str | None, rtol: float) -> None:
        self.model, self.control, self.rtol = model, control, rtol
        self.curves: list[LogCurve] = []
        self._cos = np.empty(0)
        self._parts: list[_Rings] = []
        self._pieces: list[_Piece] = []
        self._transfer: list[np.ndarray] = []
        self._divisors: dict[int, Divisor] = {}
        self._doubts: dict[int, float] = {}
        start = np.concatenate((np.linspace(FIRST, 0.0, 12), np.linspace(0.0, LAST, 4)[1:]))
        self._add([(a, b, 0) for a, b in itertools.pairwise(start.tolist())])

    def _divisor(self) -> Divisor:
        return self.divisor(len(self.curves))

    def divisor(self, steps: int) -> Divisor:
        """The divisor of the first steps; always the same object."""
        if steps not in self._divisors:
            self._divisors[steps] = Divisor(self.curves[:steps], self.control)
        return self._divisors[steps]

    def _add(self, spans: list[tuple[float, float, int]]) -> None:
        """Rows for new pieces (low, high, bent), with all divisors so far."""
        low, high, bent = (np.array(column)[:, None] for column in zip(*spans, strict=True))
        t = np.tile(0.5 * (np.concatenate((NODES, _FRESH)) + 1.0), (len(spans), 1))
        t = np.where(bent == 1, t * t, np.where(bent == 2, t * (2.0 - t), t))
        y = low + t * (high - low)
        c = np.clip(unfolded(y).ravel(), LOWEST, 1.0)
        first = self._cos.size
        parts = [_Rings.of(self.model, part, c, self.rtol * 1e-2) for part in self.model.parts()]
        for done in range(1, len(self.curves) + 1):
            divisor = self.divisor(done)
            for rings in parts:
                self._meet(rings, divisor, c)
        if not self._parts:
            self._parts = parts
        else:
            self._parts = [a.joined(b) for a, b in zip(self._parts, parts, strict=True)]
        self._cos = np.concatenate((self._cos, c))
        for k, span in enumerate(spans):
            self._pieces.append(_Piece(*span, first + k * (2 * ORDER + 1)))

    def _meet(self, rings: _Rings, divisor: Divisor, c: np.ndarray) -> None:
        """Take the divisor at the nodes, and cut rings where its last curve has a kink.

        A kink between the last node of a cell and its end is seen by no spectrum: what may hide
        there is what the curve changes by on the shorter side.
        """
        row = rings.cells.row
        if self.control == "cumulative":
            rings.log_divisor = divisor.at_nodes(c, row, rings.c, rings.s)
        else:
            last = Divisor(divisor.curves[-1:], self.control)
            rings.log_divisor += last.at_nodes(c, row, rings.c, rings.s)
        levels = divisor.last_levels(c)
        if levels.shape[1] == 0:
            return
        sent = rings.cells.value * np.exp(-rings.log_divisor.min(1))
        share = sent / np.bincount(row, sent, minlength=c.size)[row]
        end = rings.heights(np.array([0.0, 1.0]))
        curve = divisor.curves[-1]
        hidden = np.zeros(row.size)
        for column in range(levels.shape[1]):
            level = np.where(np.isfinite(levels[:, column]), levels[:, column], c)[row]
            place = np.arcsin(level)[:, None]
            inside = (place[:, 0] - end[:, 0]) * (place[:, 0] - end[:, 1]) < 0.0
            # Of the two sides of a maximum one may be constant: what changes is the other one.
            change = np.zeros(end.shape)
            for share_of_way in (0.5, 1.0):
                there = place + share_of_way * (end - place)
                moved = curve.at(folded(np.sin(there), np.cos(there)))
                moved = np.abs(moved - curve.at(folded(level))[:, None])
                if divisor.control is not None:
                    heights = np.log(np.maximum(np.sin(there), LOWEST))
                    moved += np.abs(heights - np.log(np.maximum(level, LOWEST))[:, None])
                change = np.maximum(change, moved)
            hidden = np.maximum(hidden, np.where(inside, change.min(1), 0.0))
        wanted = share * hidden > _HIDDEN * self.rtol
        if wanted.any():
            rings.cut(rings.places(levels, wanted), divisor, c)

    def _values(self) -> tuple[np.ndarray, np.ndarray]:
        """Albedos of all rows at the present step, and their relative errors of quadrature."""
        n = self._cos.size
        for _ in range(_ROUNDS):
            value, error = np.zeros(n), np.zeros(n)
            per_cell = []
            for rings in self._parts:
                own, bound, *cells = rings.sums(n)
                value += own
                error += bound + rings.shift * own
                per_cell.append(cells)
            mirror, mirror_error = self._mirror()
            value += mirror
            error += mirror_error
            dark = ~(value > 0.0)
            if dark.any():
                raise InputError(
                    f"{self.model.spec} cannot be pumped up: at cos_theta = "
                    f"{self._cos[dark][0]:.3g} its albedo is {value[dark][0]:g}, not above 0"
                )
            if not self._sharpen(value, error, per_cell):
                break
        return value, error / value + _ROUNDINGS * _EPS

    def _sharpen(
        self, value: np.ndarray, error: np.ndarray, per_cell: list[list[np.ndarray]]
    ) -> bool:
        """Cut what keeps rows from the error they may have; return whether anything was cut."""
        goal = _SHARE * self.rtol
        short = error > goal * value
        divisor, changed = self._divisor(), False
        for rings, (along_u, along_v) in zip(self._parts, per_cell, strict=True):
            row = rings.cells.row
            counts = np.bincount(row, minlength=value.size)
            most = (0.3 * goal * value / np.maximum(counts, 1))[row]
            size = rings.cells.box[:, 1:4:2] - rings.cells.box[:, :4:2]
            bad_u = short[row] & (along_u > most) & (size[:, 0] > _NARROWEST)
            bad_v = short[row] & (along_v > most) & ~bad_u & (size[:, 1] > _NARROWEST)
            changed |= bool(bad_u.any() or bad_v.any())
            places = self._kinks(rings, bad_v, divisor)
            # Cutting moves cells: what is halved goes last, found by what it was.
            halved = np.flatnonzero(bad_u)
            if halved.size:
                places = np.delete(places, halved, axis=0)
                rings.halve(bad_u, divisor, self._cos)
                places = np.concatenate(
                    (places, np.full((2 * halved.size, places.shape[1]), np.nan))
                )
            if np.isfinite(places).any():
                rings.cut(places, divisor, self._cos)
        return changed

    def _kinks(self, rings: _Rings, bad: np.ndarray, divisor: Divisor) -> np.ndarray:
        """Where to cut cells along v: at kinks of the divisor, halfway where there are none."""
        row = rings.cells.row
        rows = np.unique(row[bad])
        levels = np.full((self._cos.size, 1), np.nan)
        if rows.size:
            found = divisor.levels(self._cos[rows])
            levels = np.full((self._cos.size, max(found.shape[1], 1)), np.nan)
            levels[rows, : found.shape[1]] = found
        places = rings.places(levels, bad)
        alone = bad & ~np.isfinite(places).any(1)
        return np.where(alone[:, None] & (np.arange(places.shape[1]) == 0), 0.5, places)

    def _mirror(self) -> tuple[np.ndarray, np.ndarray]:
        """Energy of Dirac parts at all rows, over the divisor."""
        c = self._cos
        s = np.sqrt((1.0 - c) * (1.0 + c))
        wi = np.stack((s, np.zeros_like(c), c), axis=-1)
        _, weights = self.model.spikes(wi)
        if not len(weights):
            return np.zeros(c.size), np.zeros(c.size)
        scale = np.exp(-self._divisor().logs(c, c))
        errors = self.model.spike_errors(wi, weights)
        return weights.sum(0) * scale, errors.sum(0) * scale

    def step(self) -> LogCurve:
        """The curve of the present albedo; later steps divide by it."""
        while True:
            value, own = self._values()
            fits = [self._fit(piece, np.log(value), own) for piece in self._pieces]
            poor = [
                k
                for k, (_, bound, stuck) in enumerate(fits)
                if bound > self.rtol
                and not stuck
                and self._pieces[k].high - self._pieces[k].low > _SHORTEST
            ]
            if not poor or len(self._pieces) + len(poor) > _MOST_PIECES:
                break
            self._halve(poor)
        rank = sorted(range(len(fits)), key=lambda k: self._pieces[k].low)
        edges = np.array([self._pieces[k].low for k in rank] + [LAST])
        curve = LogCurve(
            edges,
            np.ascontiguousarray(np.stack([fits[k][0] for k in rank])),
            np.array([fits[k][1] for k in rank]),
            np.array([self._pieces[k].bent for k in rank]),
        )
        self._transfer.append(self._shares(curve))
        self.curves.append(curve)
        divisor = self._divisor()
        for rings in self._parts:
            self._meet(rings, divisor, self._cos)
        return curve

    def _shares(self, curve: LogCurve) -> np.ndarray:
        """What the errors of all curves do to that of a new one, on its pieces: see the module.

        The columns are the new errors of the pieces of the first curve, of the second, ..., and
        of this one.
        """
        middle = 0.5 * (curve.edges[1:] + curve.edges[:-1])
        rank = sorted(range(len(self._pieces)), key=lambda k: self._pieces[k].low)
        rows = np.array([self._pieces[k].first + ORDER // 2 for k in rank])
        before = [t.shape[0] for t in self._transfer]
        found = np.zeros((middle.size, sum(before) + middle.size))
        found[:, sum(before) :] = np.eye(middle.size)
        if not before:
            return found
        parts = [rings.rows(rows) for rings in self._parts]
        c = self._cos[rows]
        y_l, total = folded(c), np.zeros(rows.size)
        weights = rules_by_order()[1]
        sent, heights = [], []
        for rings in parts:
            own = rings.density * np.exp(-rings.log_divisor) * weights[rings.cells.order[:, 1]]
            sent.append(own)
            total += np.bincount(rings.cells.row, own.sum(1), rows.size)
            heights.append(folded(rings.c, rings.s))
        total += self._mirror()[0][rows]
        for earlier, transfer in zip(self.curves, self._transfer, strict=True):
            matrix = np.zeros((rows.size, earlier.error.size))
            own_piece = earlier.piece(y_l)
            at_l = earlier.at(y_l)
            for rings, share, y in zip(parts, sent, heights, strict=True):
                free = self._free(earlier, rings, c, y)
                _selected(
                    *(rings.cells.row, rings.cells.order, share, at_l, earlier.at(y), free),
                    *(own_piece, earlier.piece(y), matrix),
                )
            # A mirror's light has one height.
            matrix[np.arange(rows.size), own_piece] += self._mirror()[0][rows]
            found[:, : transfer.shape[1]] -= matrix / total[:, None] @ transfer
        return found

    def _free(self, curve: LogCurve, rings: _Rings, c: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Whether the divisor at nodes is made of albedos, not of heights."""
        if self.control is None:
            return np.ones(y.shape, dtype=bool)
        lowest = np.maximum(
            np.log(np.maximum(rings.c, LOWEST)), np.log(c)[rings.cells.row][:, None]
        )
        if self.control == "literal":
            return np.maximum(curve.at(y), curve.at(folded(c))[rings.cells.row][:, None]) >= lowest
        product = Divisor(self.curves, None)
        return product.at_nodes(c, rings.cells.row, rings.c, rings.s) >= lowest

    def doubt(self, steps: int) -> float:
        """Bound on the relative error of the divisor of so many steps, whatever L and V are."""
        if steps not in self._doubts:
            self._doubts[steps] = self._doubt(steps) if steps else 0.0
        return self._doubts[steps]

    def _doubt(self, steps: int) -> float:
        curves = self.curves[:steps]
        # A curve errs, and extrema as small as its error were passed over.
        new = (1.0 + FLAT) * np.concatenate([curve.error for curve in curves])
        edges = np.unique(np.concatenate([curve.edges for curve in curves]))
        y = 0.5 * (edges[1:] + edges[:-1])
        rows = np.zeros((y.size, y.size, new.size))
        for curve, transfer in zip(curves, self._transfer[:steps], strict=True):
            value, piece = curve.at(y), curve.piece(y)
            chosen = np.where(value[:, None] >= value[None, :], piece[:, None], piece[None, :])
            rows[:, :, : transfer.shape[1]] += transfer[chosen]
        # Within a piece an error may change its sign: no more than doubles what is left of it.
        return 2.0 * float((np.abs(rows) @ new).max())

    def _fit(
        self, piece: _Piece, logs: np.ndarray, own: np.ndarray
    ) -> tuple[np.ndarray, float, bool]:
        """Coefficients on a piece, a bound on their error, and whether halving will not help."""
        rows = slice(piece.first, piece.first + 2 * ORDER + 1)
        # Cosines are rounded: near 1 they stand for another angle.
        y = np.clip(folded(self._cos[rows]), piece.low, piece.high)
        basis = chebyshev.chebvander(straight(y, piece.low, piece.high, piece.bent), ORDER - 1)
        coefficients = np.linalg.solve(basis[:ORDER], logs[rows][:ORDER])
        missed = float(np.abs(basis @ coefficients - logs[rows]).max())
        noise = float(own[rows].max())
        bound = _TRUST * missed + _LEBESGUE * noise
        return coefficients, bound, missed <= noise

    def _halve(self, poor: list[int]) -> None:
        """Replace pieces by smaller ones: cut where an earlier curve bends, or by halves."""
        marks = self._divisor().marks
        spans = []
        for k in poor:
            a, b, bent = self._pieces[k].low, self._pieces[k].high, self._pieces[k].bent
            margin = 1e-9 * (b - a)
            inside = np.unique(marks[(marks > a + margin) & (marks < b - margin)]).tolist()
            if inside:
                # Ends that bend have the clustered nodes; between two of them a piece is halved.
                ends = [(a, bent == 1), *((x, True) for x in inside), (b, bent == 2)]
                for (low, first), (high, last) in itertools.pairwise(ends):
                    if first and last:
                        middle = 0.5 * (low + high)
                        spans += [(low, middle, 1), (middle, high, 2)]
                    else:
                        spans.append((low, high, 1 if first else 2 if last else 0))
            else:
                middle = 0.5 * (a + b)
                spans += [(a, middle, bent & 1), (middle, b, bent & 2)]
        left = [piece for k, piece in enumerate(self._pieces) if k not in set(poor)]
        width = 2 * ORDER + 1
        kept = np.concatenate(
            [np.arange(piece.first, piece.first + width) for piece in left] or [np.empty(0, int)]
        ).astype(int)
        for k, piece in enumerate(left):
            piece.first = k * width
        self._pieces = left
        self._cos = self._cos[kept]
        self._parts = [rings.rows(kept) for rings in self._parts]
        self._add(spans)


@lru_cache(maxsize=64)
def ladder(model: Model, control: str | None, rtol: float) -> Ladder:
    """The ladder of a model, shared by all that read it."""
    return Ladder(model, control, rtol)
