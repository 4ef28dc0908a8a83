r"""What a divisor of heights needs of a model: at every incidence, its integrals around rings.

The integral of f (n.v) around the ring of one height, over a panel of heights, is a smooth
function of the place t on the panel: a Legendre series, had once from the cells of the integrator.
Two errors of a panel do not depend on what is divided by but in its size: that of the rules along
the rings, and what the series leaves out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from albedo._compile import inlined, kernel
from albedo._threads import in_batches
from albedo.brdf import Model, Part
from albedo.charts._compiled import clustered
from albedo.charts.heights import LOWEST, fold_elevation, fold_elevations, folded
from albedo.charts.rings import RingsChart, elevation, elevations, stretched
from albedo.integrators.adaptive import refine_alike
from albedo.integrators.cells import Cells, ModelIntegrand, probe_cells
from albedo.integrators.rules import LADDER, gauss
from albedo.operators.divisor import LogCurve, curve_at

TERMS = LADDER[-1]
"""Legendre coefficients of a panel."""
_LIMIT = 400_000
# What a series leaves out of a panel, in terms of its last coefficients.
_TAIL, _WINDOW = 4.0, 3
# It counts for less than errors along the rings: a panel that is not cut does not read its series.
_SHOWN = 0.2
# Roundings at the nodes are amplified by the degree in the last coefficients.
_NOISE = 256.0 * np.finfo(np.float64).eps
# Rows that one integrates at once, and those that begin with the cells of the one in their midst.
_BATCH, _ALIKE = 64, 13


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
    steps: tuple[float, ...] = (0.0, 2.0, 6.0)
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
        at_l, albedo = self._albedos(geometry, code, box, row)
        found = np.empty(row.size)
        order = np.lexsort((albedo[1], row))
        _share(order, row, albedo[0] - at_l, albedo[1] - at_l, held, np.array(self.steps), found)
        if self.clamped:
            _share_clamped(np.argsort(row, kind="stable"), row, geometry, code, box, held, found)
        return found

    def after_one(self, panels: Panels) -> np.ndarray:
        """What rows are worth after one step, roughly: as if panels were all in their middles."""
        _, albedo = self._albedos(panels.geometry, panels.code, panels.box, panels.row)
        held = panels.series[:, 0] * np.exp(-albedo[1])
        return np.bincount(panels.row, held, panels.geometry.shape[0])

    def _albedos(
        self, geometry: np.ndarray, code: np.ndarray, box: np.ndarray, row: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Logarithms for panels: of L's albedo, and the larger one: the least, in the middle."""
        albedo = np.empty((2, row.size))
        at_l = self.curve.at(folded(geometry[:, 0], geometry[:, 1]))[row]
        _larger(geometry[row], code, box, at_l, *self.curve.pieces, albedo)
        return at_l, albedo

    def weights(self, geometry: np.ndarray, cells: Cells) -> np.ndarray:
        """How many times more errors of cells count then than at first."""
        found = self.shares(geometry, cells.code, cells.box, cells.row, cells.size)
        size = np.bincount(cells.row, cells.size, geometry.shape[0])[cells.row]
        return np.maximum(size / np.maximum(found, 1e-300), 1.0)


@dataclass
class Panels:
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

    @classmethod
    def of(
        cls,
        model: Model,
        part: Part,
        chart: RingsChart,
        cos_theta: np.ndarray,
        rtol: float,
        ahead: Ahead | None = None,
    ) -> Panels:
        """Integrate around rings at some incidences, to `rtol`, after steps ahead, too."""

        numbers = np.array(model.pack(), dtype=np.float64)

        def some(which: slice) -> Panels:
            c = cos_theta[which]
            n = c.size
            p, scale = part.packed(np.tile(numbers, (n, 1))), np.full(n, part.scale)
            integrand = ModelIntegrand(part.fill, p, scale, shared=True)
            done = refine_alike(
                *(chart, integrand, c, np.zeros(n), np.tile(part.widths, (n, 1)), True, _ALIKE),
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
            return cls(*rows, *_stacked(cells))

        found = in_batches(some, cos_theta.size, _BATCH)
        sizes = [some.doubt.size for some in found]
        return cls.together(found, np.split(np.arange(cos_theta.size), np.cumsum(sizes)[:-1]))

    @staticmethod
    def together(found: list[Panels], which: list[np.ndarray]) -> Panels:
        """Rows that were found in groups, in the order of the numbers of each."""
        number = np.concatenate(which)
        rank = np.argsort(number)
        first = np.cumsum([0, *(some.doubt.size for some in found)])
        columns = {
            name: np.concatenate([getattr(some, name) for some in found])
            for name in (*OF_ROWS, *OF_PANELS)
        }
        for name in OF_ROWS:
            columns[name] = columns[name][rank]
        row = [some.row + begin for some, begin in zip(found, first[:-1], strict=True)]
        return Panels(**{**columns, "row": number[np.concatenate(row)]})


OF_ROWS = ("geometry", "doubt", "shift", "ahead")
OF_PANELS = ("row", "code", "box", "order", "series", "blur", "tail")
"""What is known of every row, and of every panel."""


def doubt_of(part: Part, cos_theta: np.ndarray) -> np.ndarray:
    """Relative errors of a part that its own numbers have, for some incidences."""
    own = part.doubt(cos_theta) if callable(part.doubt) else part.doubt
    return np.broadcast_to(own, cos_theta.shape)


def _judge_series(cells: Cells) -> None:
    """Take what series leave out for the errors along v, so far as it is more than rounding."""
    tail, most = _tails(cells.series, cells.order[:, 1])
    cells.error[:, 1] = np.where(tail > _NOISE * most, _SHOWN * tail, 0.0)


def _tails(series: np.ndarray, order: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What series of some lengths leave out, at most, and the largest modulus of their terms."""
    tail, most = np.zeros((2, order.size))
    _fill_tails(series, order, tail, most)
    return tail, most


@kernel
def _fill_tails(series, order, tail, most):
    """Fill what `_tails` finds."""
    for k in range(order.size):
        for j in range(series.shape[1]):
            size = abs(series[k, j])
            most[k] = max(most[k], size)
            if order[k] - _WINDOW <= j < order[k]:
                tail[k] = max(tail[k], _TAIL * size)


def _stacked(cells: Cells) -> tuple[np.ndarray, ...]:
    """Panels of heights, see `Panels`: no end of a cell lies inside one, and cells that stand
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
    tail = np.bincount(panel, _tails(cells.series, cells.order[:, 1])[0][cell], starts.size)
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
    cells: Cells | Panels, cell: np.ndarray, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """Series of some cells, or panels, on parts of them, which is exact."""
    series = cells.series[cell]
    start, size = cells.box[cell, 2], cells.box[cell, 3] - cells.box[cell, 2]
    part = np.flatnonzero(high - low < size)
    if part.size:
        rule = gauss(TERMS)
        begin, share = ((low - start) / size)[part], ((high - low) / size)[part]
        values = np.empty((part.size, TERMS))
        _read(series[part], begin, share, rule.nodes, values)
        series[part] = share[:, None] * values @ rule.to_coefficients
    return series


# Legendre's recurrence, and no division in a loop.
_DEGREE = np.arange(TERMS)
_RISE, _FALL = (2.0 * _DEGREE + 1.0) / (_DEGREE + 1.0), (_DEGREE + 1.0) / (_DEGREE + 2.0)


@inlined
def fill_legendre(series, terms, u, last, before, out):
    """Fill sums of some terms of a Legendre series at places from -1 to 1, by Clenshaw's rule.

    `last` and `before` are room for as many numbers as there are places.
    """
    for j in range(u.size):
        last[j] = before[j] = 0.0
    # Places inside: what is done for all of them at once does not wait for the term before.
    for m in range(terms - 1, 0, -1):
        term, rise, fall = series[m], _RISE[m], _FALL[m]
        for j in range(u.size):
            here = term + (rise * u[j] * last[j] - fall * before[j])
            before[j] = last[j]
            last[j] = here
    for j in range(u.size):
        out[j] = series[0] + u[j] * last[j] - 0.5 * before[j]


@kernel
def _read(series, begin, share, nodes, values):
    """Fill what series hold at the nodes of a part of each."""
    u, last, before = np.empty(TERMS), np.empty(TERMS), np.empty(TERMS)
    for k in range(begin.size):
        for j in range(TERMS):
            u[j] = 2.0 * (begin[k] + share[k] * nodes[j]) - 1.0
        fill_legendre(series[k], TERMS, u, last, before, values[k])


@kernel
def height_at(g, side, power, box, t):
    """Elevation of V at a place of a panel."""
    x, _ = clustered(box[2] + (box[3] - box[2]) * t, power)
    return elevation(g, side, box[4] + (box[5] - box[4]) * x)[0]


@inlined
def fill_heights(g, side, power, box, t, s, y):
    """Fill the coordinates of V at many places of a panel; there is room for as many numbers."""
    for i in range(t.size):
        x, _ = clustered(box[2] + (box[3] - box[2]) * t[i], power)
        s[i] = box[4] + (box[5] - box[4]) * x
    elevations(g, side, s, y)
    for i in range(t.size):
        s[i] = y[i]
    fold_elevations(s, y)


@kernel
def place_at(g, side, power, box, e_v):
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
            e_v = height_at(geometry[k], code[k, 0], code[k, 3], box[k], 0.5 * i)
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
        c_0 = math.sin(height_at(g, code[k, 0], code[k, 3], box[k], 0.0))
        c_1 = math.sin(height_at(g, code[k, 0], code[k, 3], box[k], 1.0))
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
