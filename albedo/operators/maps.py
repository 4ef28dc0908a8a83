"""What pumping-up divides by where albedos depend on the azimuth, or lobes lie anywhere.

An albedo is a table of its logarithm over heights and azimuths: tensor Chebyshev series on
rectangles of (y, w), y being the coordinate of `albedo.charts.heights`. Where a model is symmetric
about its tangent and bitangent, as well as can be seen, an albedo is a smooth function of
cos(2 azimuth), and w = -cos(2 psi) with tan(azimuth) = k tan(psi). Near the normal k = 1 suits
best, towards grazing incidence k^2 is about the ratio of the widths of an elliptic lobe: each band
of heights has the k that needs the fewest terms. Elsewhere w is the azimuth itself.

Rectangles get more nodes along w, or are cut in two across the worse direction, until fresh points
between their nodes confirm them.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field, replace
from functools import cache, cached_property

import numpy as np
from numpy.polynomial import chebyshev

from albedo._compile import inlined, kernel
from albedo.brdf import Model
from albedo.charts.heights import FIRST, LAST, LOWEST, fold_vector, folded, unfolded
from albedo.errors import InputError
from albedo.operators.divisor import CONTROLS, FEW, PARTS, on_parts
from albedo.quadrature import albedo_rows

# Nodes along y, and the numbers of them that there may be along w.
_ORDER = 16
_TURNS = (1, 4, 6, 8, 10, 12, 14, 16, 20, 24, 28, 32)
# Nodes of the first look along w.
_GLANCE = 32
# Between its nodes an interpolant errs most. Fresh points stand in every second gap, and at both
# ends: what a gap between them hides is not many times as much.
_TRUST = 8.0
# What an albedo itself may err by, as a share of the tolerance, and evaluations that it may take.
_OWN, _LIMIT = 0.05, 400_000
# Least size of a rectangle.
_SHORTEST = 1e-6
# Terms along w that sum to less than this share of the tolerance need no nodes.
_AMPLE = 0.06
# Terms of series that sum to less than this share of a table's error are left out.
_SHARE = 0.01
# At 45 degrees the albedo of a lobe with V-cavity masking bends.
STARTS = (FIRST, -18.0, -8.0, -4.5, -2.0, -0.8, 0.0, LAST - 0.25 * math.pi, 0.65, LAST)
"""Ends in y of the first rectangles."""
# A logarithm that errs by more tells nothing, and its exponential is no number.
HOPELESS = 700.0
_QUARTER, _WHOLE = 0.5 * math.pi, 2.0 * math.pi
# Even cells of y and of w in which rectangles are looked up, and their ranges.
_CELLS = 64
_RANGES = (FIRST, LAST), (-1.0, 1.0), (0.0, _WHOLE)
_SYMMETRY_CHECKS = 12


@dataclass(frozen=True, eq=False)
class LogMap:
    """The logarithm of an albedo over all directions of incidence, rectangle by rectangle.

    Attributes
    ----------
    box : ndarray, shape (m, 4)
        Ends of the rectangles in y and in w.
    warp : ndarray, shape (m,)
        The k^2 of the w of each; 0 where w is the azimuth.
    series : ndarray, shape (m, q, 16)
        Chebyshev coefficients on each, those along w first; q is 1 for an isotropic model.
    error : ndarray, shape (m,)
        Bound on the error over each, relative to the albedo.
    quarter : bool
        A quarter of the azimuths stands for all.
    axis, split, child : ndarray
        A tree that finds the rectangle of a place: along which direction a node is cut (-1: it is
        a leaf), where (in w with k = 1), and the two nodes or the rectangle below it.
    evaluations : int
        Of the model, to make the table.
    """

    box: np.ndarray
    warp: np.ndarray
    series: np.ndarray
    error: np.ndarray
    quarter: bool
    axis: np.ndarray
    split: np.ndarray
    child: np.ndarray
    evaluations: int

    def places(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Cosines and azimuths of places spread over every rectangle, ends included: (m, n)."""
        t = np.linspace(0.0, 1.0, count)
        c, phi = [], []
        for (low, high, first, last), warp in zip(self.box, self.warp, strict=True):
            heights = np.clip(unfolded(low + t * (high - low)), LOWEST, 1.0)
            turns = _azimuths(first + t * (last - first), warp)
            c.append(np.repeat(heights, count))
            phi.append(np.tile(turns, count))
        return np.array(c), np.array(phi)

    def at(self, wi: np.ndarray) -> np.ndarray:
        """The albedo for unit vectors (n, 3)."""
        out = np.empty((len(wi), 1))
        _albedos_all(wi, *Maps((self,), None).known, out)
        return np.exp(out[:, 0])


@dataclass
class _Tree:
    """A tree of rectangles that grows at its leaves."""

    axis: list[int] = field(default_factory=list)
    split: list[float] = field(default_factory=list)
    child: list[list[int]] = field(default_factory=list)

    def leaf(self) -> int:
        self.axis.append(-1)
        self.split.append(0.0)
        self.child.append([-1, -1])
        return len(self.axis) - 1

    def cut(self, node: int, axis: int, place: float) -> list[int]:
        """Cut a leaf; return the two new ones."""
        self.axis[node], self.split[node] = axis, place
        self.child[node] = [self.leaf(), self.leaf()]
        return self.child[node]

    def over(self, node: int, axis: int, ends: list[float]) -> list[int]:
        """Cut a leaf at all but the first and the last of some places; return the leaves."""
        if len(ends) < 3:
            return [node]
        k = len(ends) // 2
        low, high = self.cut(node, axis, ends[k])
        return self.over(low, axis, ends[: k + 1]) + self.over(high, axis, ends[k:])


@dataclass(frozen=True)
class _Rectangle:
    """A rectangle that is to be tabulated.

    A leaf of the tree, ends in y and w, the k^2 of its w, and nodes along w.
    """

    node: int
    y: tuple[float, float]
    w: tuple[float, float]
    warp: float
    turns: int

    @property
    def rows(self) -> int:
        """How many albedos it takes."""
        return _ORDER * self.turns + _fresh(_ORDER).size * _fresh(self.turns).size

    def grid(self, along: np.ndarray, across: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Cosines, and azimuths, of nodes given in [-1, 1]."""
        y = self.y[0] + 0.5 * (along + 1.0) * (self.y[1] - self.y[0])
        w = self.w[0] + 0.5 * (across + 1.0) * (self.w[1] - self.w[0])
        return np.clip(unfolded(y), LOWEST, 1.0), _azimuths(w, self.warp)


@dataclass
class _Fit:
    """A series on a rectangle, and what it is worth.

    `missed` is the most by which fresh points were missed, `noise` what albedos may err by.
    """

    series: np.ndarray
    bound: float
    missed: float
    noise: float


@cache
def _nodes(count: int) -> np.ndarray:
    found: np.ndarray = chebyshev.chebpts1(count) if count > 1 else np.zeros(1)
    return found


@cache
def _fresh(count: int) -> np.ndarray:
    found: np.ndarray = chebyshev.chebpts2(count + 1)[::2] if count > 1 else np.zeros(1)
    return found


def _lebesgue(count: int) -> float:
    """What errors at so many nodes may come to between them (Rivlin)."""
    return 2.0 / math.pi * math.log(count) + 1.0


def _terms(modulus: np.ndarray, least: float) -> int:
    """How many terms are needed for the others to sum to less."""
    beyond = np.cumsum(modulus[::-1])[::-1]
    return max(int(np.count_nonzero(beyond > least)), 1)


def _rung(terms: float) -> int:
    """A number of nodes for so many terms."""
    return next((count for count in _TURNS if count >= terms), _TURNS[-1])


def _azimuths(w: np.ndarray, warp: float) -> np.ndarray:
    """The azimuths at w."""
    if warp == 0.0:
        return w
    half = 0.5 * np.arccos(np.clip(-w, -1.0, 1.0))
    return np.arctan2(math.sqrt(warp) * np.sin(half), np.cos(half))


def _ratio(model: Model) -> float:
    """The ratio of the widths of the most elongated lobe, along x and y."""
    ratios = [part.widths[0] / part.widths[1] for part in model.parts()]
    return max(ratios, key=lambda ratio: abs(math.log(ratio)), default=1.0)


def log_map(
    model: Model, rtol: float, most: int = 10_000, starts: tuple[float, ...] = STARTS
) -> LogMap:
    """Tabulate the logarithm of an albedo over all heights and azimuths.

    Parameters
    ----------
    model : Model
    rtol : float
        The relative error asked for, everywhere.
    most : int
        Most albedos that are computed.
    starts : tuple of float
        Ends in y of the first rectangles; 0 is one of them.

    Returns
    -------
    LogMap
        With the bounds that were reached.

    Raises
    ------
    InputError
        For an albedo that is not above 0.
    """
    tree, active = _start(model, rtol, starts)
    leaves: list[tuple[_Rectangle, _Fit]] = []
    used = rows = 0
    while active:
        fits, evaluations = _tabulated(model, active, rtol)
        used += evaluations
        rows += sum(rectangle.rows for rectangle in active)
        poor: list[tuple[_Rectangle, _Fit]] = []
        for rectangle, fit in zip(active, fits, strict=True):
            enough = fit.bound <= rtol or fit.missed <= fit.noise
            short = rectangle.y[1] - rectangle.y[0] < _SHORTEST
            (leaves if enough or short else poor).append((rectangle, fit))
        active, spent = [], rows
        for rectangle, fit in sorted(poor, key=lambda one: -one[1].bound):
            spent += 2 * rectangle.rows
            if spent > most:
                leaves.append((rectangle, fit))
            else:
                active += _finer(tree, rectangle, fit, rtol)
    for k, (rectangle, _) in enumerate(leaves):
        tree.child[rectangle.node] = [k, -1]
    series = np.zeros((len(leaves), max(one.turns for one, _ in leaves), _ORDER))
    for k, (rectangle, fit) in enumerate(leaves):
        series[k, : rectangle.turns] = fit.series
    return LogMap(
        np.array([(*rectangle.y, *rectangle.w) for rectangle, _ in leaves]),
        np.array([rectangle.warp for rectangle, _ in leaves]),
        series,
        np.array([fit.bound for _, fit in leaves]),
        leaves[0][0].warp > 0.0,
        np.array(tree.axis),
        np.array(tree.split),
        np.array(tree.child),
        used,
    )


def _start(model: Model, rtol: float, starts: tuple[float, ...]) -> tuple[_Tree, list[_Rectangle]]:
    """The first rectangles."""
    quarter = model.isotropic or _symmetric(model, rtol)
    ends = [-1.0, 1.0] if quarter else np.linspace(0.0, _WHOLE, 5).tolist()
    # Between the widths of the lobe and a circle.
    warp = math.sqrt(_ratio(model)) if quarter else 0.0
    tree, found = _Tree(), []
    bands = tree.over(tree.leaf(), 0, list(starts))
    for band, y in zip(bands, itertools.pairwise(starts), strict=True):
        for node, w in zip(tree.over(band, 1, ends), itertools.pairwise(ends), strict=True):
            found.append(_Rectangle(node, y, w, warp, 1))
    if model.isotropic:
        return tree, found
    # Lines in the middle tell which k suits, and how many nodes it takes along w.
    middle, across = np.zeros(1), _nodes(_GLANCE)
    logs, _, _ = _logs(model, [rectangle.grid(middle, across) for rectangle in found], rtol)
    return tree, [_suited(one, line[0], rtol) for one, line in zip(found, logs, strict=True)]


def _suited(rectangle: _Rectangle, line: np.ndarray, rtol: float) -> _Rectangle:
    """A rectangle with the k and the nodes along w that suit the albedos at nodes of a line."""
    across = _nodes(_GLANCE)
    basis = chebyshev.chebvander(across, _GLANCE - 1)
    series = np.linalg.solve(basis, line)
    # What was not resolved tells nothing.
    least = max(_AMPLE * rtol, 4.0 * float(np.abs(series[-2:]).sum()))
    found = {rectangle.warp: _terms(np.abs(series), least)}
    for power in (-1, 1) if rectangle.warp > 0.0 else ():
        # One k^2 is that of a circle, the other the ratio of widths.
        other = rectangle.warp ** (1 + power)
        w = np.array([warped(x, rectangle.warp / other) for x in across])
        again = np.linalg.solve(basis, chebyshev.chebval(w, series))
        found[other] = _terms(np.abs(again), least)
    warp = min(found, key=lambda key: found[key])
    resolved = least <= _AMPLE * rtol
    return replace(rectangle, warp=warp, turns=_rung(found[warp] + 2 if resolved else _GLANCE // 3))


def _logs(
    model: Model, grids: list[tuple[np.ndarray, np.ndarray]], rtol: float
) -> tuple[list[np.ndarray], list[float], int]:
    """Logarithms of albedos on grids, what they may err by on each, and evaluations."""
    places = [np.broadcast_arrays(c[:, None], phi[None, :]) for c, phi in grids]
    c, phi = (np.concatenate([place[k].ravel() for place in places]) for k in (0, 1))
    found = albedo_rows(
        [model] * c.size, c, phi, rtol=_OWN * rtol, atol=0.0, max_evaluations=_LIMIT
    )
    dark = ~(found.value > 0.0)
    if dark.any():
        raise InputError(
            f"{model.spec} cannot be pumped up: at cos_theta = {c[dark][0]:.3g} "
            f"its albedo is {found.value[dark][0]:g}, not above 0"
        )
    ends = np.cumsum([place[0].size for place in places])[:-1]
    logs = np.split(np.log(found.value), ends)
    errors = np.split(found.error / found.value, ends)
    shaped = [line.reshape(place[0].shape) for line, place in zip(logs, places, strict=True)]
    return shaped, [float(own.max()) for own in errors], int(found.evaluations.sum())


def _tabulated(model: Model, rectangles: list[_Rectangle], rtol: float) -> tuple[list[_Fit], int]:
    """Series on rectangles, and evaluations."""
    grids = []
    for one in rectangles:
        grids.append(one.grid(_nodes(_ORDER), _nodes(one.turns)))
        grids.append(one.grid(_fresh(_ORDER), _fresh(one.turns)))
    logs, own, used = _logs(model, grids, rtol)
    fits = []
    for k, one in enumerate(rectangles):
        both = slice(2 * k, 2 * k + 2)
        fits.append(_fitted(one, [c for c, _ in grids[both]], logs[both], max(own[both])))
    return fits, used


def _fitted(
    rectangle: _Rectangle, cosines: list[np.ndarray], logs: list[np.ndarray], noise: float
) -> _Fit:
    """The series through values at nodes, and how far it misses those at fresh points."""
    low, high = rectangle.y
    # Cosines are rounded: near 1 they stand for another angle.
    u, u_fresh = (np.clip(2.0 * (folded(x) - low) / (high - low) - 1.0, -1.0, 1.0) for x in cosines)
    turned, turns = _nodes(rectangle.turns), rectangle.turns - 1
    half = np.linalg.solve(chebyshev.chebvander(u, _ORDER - 1), logs[0])
    series = np.linalg.solve(chebyshev.chebvander(turned, turns), half.T)
    across = chebyshev.chebvander(_fresh(rectangle.turns), turns) @ series
    fitted = across @ chebyshev.chebvander(u_fresh, _ORDER - 1).T
    missed = float(np.abs(fitted - logs[1].T).max())
    lebesgue = _lebesgue(_ORDER) * _lebesgue(rectangle.turns)
    return _Fit(series, _TRUST * missed + lebesgue * noise, missed, noise)


def _finer(tree: _Tree, rectangle: _Rectangle, fit: _Fit, rtol: float) -> list[_Rectangle]:
    """What a rectangle is replaced by: more nodes along w, or two halves."""
    modulus, turns = np.abs(fit.series), rectangle.turns
    along, across = modulus[:, -3:].sum(), modulus[-2:].sum()
    wanted = _wanted(modulus.sum(1), rtol) if turns > 1 else 1
    if turns == 1 or along >= across or (along > rtol / _TRUST and wanted <= _TURNS[-1]):
        low, high = rectangle.y
        middle = 0.5 * (low + high)
        below, above = tree.cut(rectangle.node, 0, middle)
        count = _rung(wanted) if wanted <= _TURNS[-1] else turns
        return [
            replace(rectangle, node=below, y=(low, middle), turns=count),
            replace(rectangle, node=above, y=(middle, high), turns=count),
        ]
    if wanted <= _TURNS[-1]:
        return [replace(rectangle, turns=_rung(max(wanted, turns + 2)))]
    low, high = rectangle.w
    middle = 0.5 * (low + high)
    before, after = tree.cut(rectangle.node, 1, _plain(middle, rectangle.warp))
    fewer = min(turns, _rung(_GLANCE // 2))
    return [
        replace(rectangle, node=before, w=(low, middle), turns=fewer),
        replace(rectangle, node=after, w=(middle, high), turns=fewer),
    ]


def _wanted(modulus: np.ndarray, rtol: float) -> float:
    """How many terms along w a tolerance takes, from those that there are, as they fall."""
    least, last, half = _AMPLE * rtol, modulus[-2:].sum(), modulus.size // 2
    enough = _terms(modulus, least) + 2
    if enough <= modulus.size:
        return enough
    fall = math.log(max(modulus[half - 1 :].max() / last, 1.0)) / half
    return float(modulus.size + math.log(max(last / least, 1.0)) / max(fall, 1e-3))


def _plain(w: float, warp: float) -> float:
    """The w of k = 1 at the same azimuth."""
    return warped(w, 1.0 / warp) if warp > 0.0 else w


def _symmetric(model: Model, rtol: float) -> bool:
    """Whether albedos mirrored at tangent and bitangent are the same, as far as is known."""
    rng = np.random.default_rng(1)
    deep = 0.5 * np.exp(-10.0 * rng.random(_SYMMETRY_CHECKS))
    c = np.concatenate((rng.random(_SYMMETRY_CHECKS), deep))
    phi = rng.uniform(0.0, _QUARTER, c.size)
    found = [
        albedo_rows([model] * c.size, c, turn, rtol=_OWN * rtol, atol=0.0)
        for turn in (phi, -phi, math.pi - phi, math.pi + phi)
    ]
    first = found[0]
    return all(
        bool(np.all(np.abs(other.value - first.value) <= first.error + other.error))
        for other in found[1:]
    )


@dataclass(frozen=True, eq=False)
class Maps:
    """The product of the divisors of some steps, as a function of L and V.

    Parameters
    ----------
    tables : tuple of LogMap
        Albedos before every step.
    control : {None, "literal", "cumulative"}
        See `albedo.operators.divisor.CONTROLS`.
    """

    tables: tuple[LogMap, ...]
    control: str | None

    @property
    def code(self) -> int:
        """The number of the control."""
        return CONTROLS.index(self.control)

    @property
    def changes(self) -> int:
        """How many functions change their signs where the divisor has kinks."""
        steps = len(self.tables)
        return (steps, 2 * steps, steps + 2)[self.code] if steps else 0

    @cached_property
    def known(self) -> tuple[np.ndarray, ...]:
        """All tables as one.

        Nodes of their trees for even cells, whether a quarter is all, the trees, the rectangles,
        and what `_patches` makes of their series.
        """
        tables = self.tables
        nodes = np.cumsum([0, *(table.axis.size for table in tables)])
        leaves = np.cumsum([0, *(table.error.size for table in tables)])
        child = [
            table.child + np.where(table.axis >= 0, node, leaf)[:, None]
            for table, node, leaf in zip(tables, nodes[:-1], leaves[:-1], strict=True)
        ]
        quarter = np.array([table.quarter for table in tables])
        axis, split, box, warp, error = (
            np.concatenate([getattr(table, k) for table in tables])
            for k in ("axis", "split", "box", "warp", "error")
        )
        turns = max(FEW, *(table.series.shape[1] for table in tables))
        series = np.zeros((error.size, turns, _ORDER))
        for table, leaf in zip(tables, leaves[:-1], strict=True):
            series[leaf : leaf + table.error.size, : table.series.shape[1]] = table.series
        parts, terms = _patches(series, error)
        start = np.cumsum(parts.prod(1)) - parts.prod(1)
        trees = axis, split, np.concatenate(child)
        cells = [_cells(root, quarter[j], *trees) for j, root in enumerate(nodes[:-1].tolist())]
        return np.stack(cells), quarter, *trees, box, warp, parts, start, terms

    @cached_property
    def errors(self) -> tuple[float, ...]:
        """Bounds on the relative errors of all tables."""
        return tuple((1.0 + _SHARE) * float(table.error.max()) for table in self.tables)

    def divide(self, wi: np.ndarray, wo: np.ndarray, out: np.ndarray) -> None:
        """Divide values of a kernel by the divisor, in place."""
        if self.tables:
            _divide(wi, wo, *self.known, self.code, out)

    def weigh(self, wi: np.ndarray, wo: np.ndarray, out: np.ndarray) -> None:
        """Multiply values by what the divisor may err by, relatively, in place."""
        error = (1.0 + _SHARE) * np.concatenate([table.error for table in self.tables])
        _weigh(wi, wo, *self.known, np.minimum(error, HOPELESS / len(self.tables)), out)

    def between(self, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        """The divisor for pairs of unit vectors (n, 3)."""
        out = np.ones((len(wi), 1))
        views = np.ascontiguousarray(wo.T).reshape(3, -1, 1)
        self.divide(np.ascontiguousarray(wi.T), views, out)
        found: np.ndarray = 1.0 / out[:, 0]
        return found


def _patches(series: np.ndarray, error: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Series on even parts of their rectangles, by eight powers of both variables.

    Returns
    -------
    parts : ndarray, shape (m, 2)
        How many along w and along y.
    terms : ndarray, shape (all parts, 8, 8)
        Parts along y follow each other.
    """
    parts, terms = np.empty((len(series), 2), int), []
    for k, (one, worth) in enumerate(zip(series, error, strict=True)):
        allowed = 0.5 * _SHARE * worth
        along, parts[k, 1] = _halved(one, allowed)
        # Terms along w last, as those along y were.
        both, parts[k, 0] = _halved(along.transpose(0, 2, 1).reshape(-1, len(one)), allowed, FEW)
        shape = parts[k, 0], parts[k, 1], FEW, FEW
        terms.append(both.reshape(shape).transpose(0, 1, 3, 2).reshape(-1, FEW, FEW))
    return parts, np.concatenate(terms)


def _halved(
    series: np.ndarray, allowed: float, together: int | None = None
) -> tuple[np.ndarray, int]:
    """Chebyshev series (n, terms) on as few even parts as leave out what is allowed, and how many.

    What so many of them leave out is summed, or what all do. The shape is (parts, n, 8).
    """
    for count in PARTS:
        kept, others = on_parts(count, series.shape[1])
        lost = np.abs(series @ others).sum(2)
        if lost.reshape(count, -1, together or len(series)).sum(2).max(initial=0.0) <= allowed:
            break
    return series @ kept, count


def _cells(
    root: int, quarter: bool, axis: np.ndarray, split: np.ndarray, child: np.ndarray
) -> np.ndarray:
    """The nodes of a tree that hold even cells of y and w as a whole."""
    found = np.empty((_CELLS + 1, _CELLS + 1), int)
    waiting = [(root, 0, _CELLS + 1, 0, _CELLS + 1)]
    while waiting:
        node, a, b, c, d = waiting.pop()
        found[a:b, c:d] = node
        if axis[node] < 0 or a >= b or c >= d:
            continue
        cell = _cell_of(split[node], *_RANGES[0 if axis[node] == 0 else 1 if quarter else 2])
        low, high = child[node]
        # The cell with the cut in it stays with the node.
        if axis[node] == 0:
            waiting += [(low, a, min(b, cell), c, d), (high, max(a, cell + 1), b, c, d)]
        else:
            waiting += [(low, a, b, c, min(d, cell)), (high, a, b, max(c, cell + 1), d)]
    return found


@inlined
def warped(w, warp):
    """-cos(2 psi) from w = -cos(2 phi), where tan(phi) = sqrt(warp) tan(psi)."""
    above, below = 1.0 + w, warp * (1.0 - w)
    return (above - below) / (above + below)


@inlined
def _across(x, y, quarter):
    """The coordinate w of a direction, with k = 1."""
    if not quarter:
        turn = math.atan2(y, x)
        return turn if turn >= 0.0 else turn + 2.0 * math.pi
    square = x * x + y * y
    return (y * y - x * x) / square if square > 0.0 else -1.0


@inlined
def _cell_of(x, low, high):
    """Which of even cells holds x."""
    return int((min(max(x, low), high) - low) * (_CELLS / (high - low)))


@inlined
def _leaf(height, place, j, cells, quarter, axis, split, child):
    """The number of the rectangle of table j that holds a place."""
    low, high = (-1.0, 1.0) if quarter[j] else (0.0, _WHOLE)
    node = cells[j, _cell_of(height, FIRST, LAST), _cell_of(place, low, high)]
    while axis[node] >= 0:
        along = height if axis[node] == 0 else place
        node = child[node, 0] if along < split[node] else child[node, 1]
    return child[node, 0]


@inlined
def _on_part(x, low, high, parts):
    """Which of the even parts of an interval holds x, and the variable of its powers."""
    at = parts * ((min(max(x, low), high) - low) / (high - low))
    part = min(int(at), parts - 1)
    return part, 2.0 * (at - part) - 1.0


@inlined
def albedos_at(x, y, z, cells, quarter, axis, split, child, box, warp, parts, start, terms, out):
    """Fill the logarithms of the albedos of all steps for one direction."""
    height = fold_vector(x, y, z)
    for j in range(cells.shape[0]):
        place = _across(x, y, quarter[j])
        k = _leaf(height, place, j, cells, quarter, axis, split, child)
        if warp[k] > 0.0:
            place = warped(place, warp[k])
        first, v = _on_part(place, box[k, 2], box[k, 3], parts[k, 0])
        second, u = _on_part(height, box[k, 0], box[k, 1], parts[k, 1])
        i = start[k] + first * parts[k, 1] + second
        # Not one chain of products, in which each waits for the one before.
        square, total = u * u, 0.0
        for n in range(FEW - 1, -1, -1):
            low = (terms[i, n, 0] + terms[i, n, 1] * u) + (
                terms[i, n, 2] + terms[i, n, 3] * u
            ) * square
            high = (terms[i, n, 4] + terms[i, n, 5] * u) + (
                terms[i, n, 6] + terms[i, n, 7] * u
            ) * square
            total = total * v + (low + high * (square * square))
        out[j] = total


@kernel
def _albedos_all(wi, cells, quarter, axis, split, child, box, warp, parts, start, terms, out):
    known = cells, quarter, axis, split, child, box, warp, parts, start, terms
    for i in range(out.shape[0]):
        albedos_at(wi[i, 0], wi[i, 1], wi[i, 2], *known, out[i])


@kernel
def _divide(
    wi, wo, cells, quarter, axis, split, child, box, warp, parts, start, terms, control, out
):
    steps = cells.shape[0]
    at_l, at_v = np.empty(steps), np.empty(steps)
    known = cells, quarter, axis, split, child, box, warp, parts, start, terms
    for k in range(out.shape[0]):
        lz = max(wi[2, k], LOWEST)
        albedos_at(wi[0, k], wi[1, k], wi[2, k], *known, at_l)
        for i in range(out.shape[1]):
            vz = wo[2, k, i]
            if not vz > 0.0:
                continue
            albedos_at(wo[0, k, i], wo[1, k, i], vz, *known, at_v)
            product = 0.0
            for j in range(steps):
                step = max(at_v[j], at_l[j])
                if control == 1:
                    step = max(step, math.log(max(vz, lz)))
                product += step
            if control == 2:
                product = max(product, math.log(max(vz, lz)))
            out[k, i] *= math.exp(-product)


@kernel
def _weigh(wi, wo, cells, quarter, axis, split, child, box, warp, parts, start, terms, error, out):
    """Multiply values by what the divisor may err by: of each step, the side that is larger."""
    steps = cells.shape[0]
    at_l, at_v, of_l = np.empty(steps), np.empty(steps), np.empty(steps)
    known = cells, quarter, axis, split, child, box, warp, parts, start, terms
    tree = cells, quarter, axis, split, child
    for k in range(out.shape[0]):
        x, y, z = wi[0, k], wi[1, k], wi[2, k]
        albedos_at(x, y, z, *known, at_l)
        height = fold_vector(x, y, z)
        for j in range(steps):
            of_l[j] = error[_leaf(height, _across(x, y, quarter[j]), j, *tree)]
        for i in range(out.shape[1]):
            x, y, z = wo[0, k, i], wo[1, k, i], wo[2, k, i]
            if not z > 0.0:
                continue
            albedos_at(x, y, z, *known, at_v)
            height, total = fold_vector(x, y, z), 0.0
            for j in range(steps):
                of_v = error[_leaf(height, _across(x, y, quarter[j]), j, *tree)]
                apart, near = at_v[j] - at_l[j], of_v + of_l[j]
                if apart > near:
                    total += of_v
                elif apart < -near:
                    total += of_l[j]
                else:
                    total += max(of_v, of_l[j])
            out[k, i] *= math.expm1(total)


@kernel
def changes_at(at_l, at_v, lz, vz, control, out):
    """Fill functions whose signs change where the divisor has kinks."""
    steps = at_l.size
    log_l, log_v = 0.0, 0.0
    if control > 0:
        log_l, log_v = math.log(lz), math.log(vz)
    if control == 1:
        for j in range(steps):
            out[2 * j] = max(at_v[j], log_v) - max(at_l[j], log_l)
            out[2 * j + 1] = at_v[j] - log_v
        return
    product = 0.0
    for j in range(steps):
        out[j] = at_v[j] - at_l[j]
        product += max(at_v[j], at_l[j])
    if control == 2:
        out[steps] = product - max(log_l, log_v)
        out[steps + 1] = log_v - log_l
