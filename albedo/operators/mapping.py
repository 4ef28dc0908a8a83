"""Tables of albedos over heights and azimuths, see `albedo.operators.maps`.

Near the normal k = 1 suits w best, towards grazing incidence k^2 is about the ratio of the widths
of an elliptic lobe: each band of heights has the k that needs the fewest terms. Bands are cut into
strips where earlier albedos have critical levels. Rectangles get more nodes along w, or are cut in
two across the worse direction, until fresh points between their nodes confirm them.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cache, partial

import numpy as np
from numpy.polynomial import chebyshev

from albedo._threads import threads
from albedo.brdf import Model
from albedo.charts.heights import FIRST, LAST, folded
from albedo.errors import InputError
from albedo.estimate import Estimate
from albedo.operators.kept import Shelf
from albedo.operators.levels import critical_levels
from albedo.operators.maps import (
    CURVE,
    HEIGHT,
    LEAF,
    PATCHES,
    STRIP,
    STRIP_SIZE,
    TURN,
    LogMap,
    Maps,
    directions_of,
    warped,
)
from albedo.operators.split import Piece, cut_along
from albedo.quadrature import albedo_rows

# Most nodes along y, and the numbers of them that there may be along y and along w.
_ORDER = 16
_ORDERS = (8, 12, 16)
_TURNS = (1, 4, 6, 8, 10, 12, 14, 16, 20, 24, 28, 32)
# Nodes of the first look along w, and how many there are where that is not resolved; where lines
# across rectangles lie that tell how many there should be: in the middle they may be too even.
_GLANCE, _UNSEEN, _ASIDE = 32, 10, 0.4
# Between its nodes an interpolant errs most. Fresh points stand in every second gap, and at both
# ends: what a gap between them hides is not many times as much.
_TRUST = 8.0
# What an albedo itself may err by, as a share of the tolerance, and evaluations that it may take.
_OWN, _LIMIT = 0.05, 400_000
# Albedos that a thread computes at once: who interrupts waits for them, and those of models that
# are divided by tables take ten times as long.
_CHUNK, _CHUNK_LATER = 256, 16
# Least size of a rectangle, and of one in a strip.
_SHORTEST, _SLIM = 1e-6, 1e-3
# Terms along w that sum to less than this share of the tolerance need no nodes.
_AMPLE = 0.06
# At 45 degrees the albedo of a lobe with V-cavity masking bends.
STARTS = (FIRST, -18.0, -8.0, -4.5, -2.0, -0.8, 0.0, LAST - 0.25 * math.pi, 0.65, LAST)
"""Ends in y of the first rectangles."""
_QUARTER, _WHOLE = 0.5 * math.pi, 2.0 * math.pi
_SYMMETRY_CHECKS = 12
# What `_logs` returns, from grids alone.
_Logs = Callable[[list[tuple[np.ndarray, np.ndarray]]], tuple[list[np.ndarray], list[float], int]]


@dataclass
class _Tree:
    """A tree of rectangles that grows at its leaves."""

    axis: list[int] = field(default_factory=list)
    split: list[float] = field(default_factory=list)
    child: list[list[int]] = field(default_factory=list)

    def leaf(self) -> int:
        self.axis.append(LEAF)
        self.split.append(0.0)
        self.child.append([-1, -1])
        return len(self.axis) - 1

    def cut(self, node: int, axis: int, place: float) -> list[int]:
        """Cut a leaf; return the two new ones."""
        self.axis[node], self.split[node] = axis, place
        self.child[node] = [self.leaf(), self.leaf()]
        return self.child[node]

    def enter(self, node: int, strip: int) -> int:
        """Begin a strip at a leaf; return the leaf that is all of it."""
        self.axis[node], self.split[node] = STRIP, strip
        self.child[node][0] = self.leaf()
        return self.child[node][0]

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

    A leaf of the tree, ends in y and w, the k^2 of its w, and nodes along w, 0 as long as that is
    unknown. Or ends in the shares of a strip, which has a number.
    """

    node: int
    y: tuple[float, float]
    w: tuple[float, float]
    warp: float
    turns: int
    number: int = -1
    strip: np.ndarray | None = None
    order: int = _ORDER

    @property
    def rows(self) -> int:
        """How many albedos it takes."""
        return self.order * self.turns + _fresh(self.order).size * _fresh(self.turns).size

    @property
    def short(self) -> bool:
        """Whether it is not to be cut any more."""
        least = _SHORTEST if self.strip is None else _SLIM
        return min(self.y[1] - self.y[0], self.w[1] - self.w[0]) < least

    def halves(self, tree: _Tree, axis: int) -> list[_Rectangle]:
        """Two rectangles in its place, of which nothing is known."""
        y, w = self.y, self.w
        place = 0.5 * sum(y) if axis == HEIGHT else _plain(0.5 * sum(w), self.warp)
        below, above = tree.cut(self.node, axis, place)
        new = replace(self, turns=1 if self.turns == 1 else 0, order=_ORDER)
        if axis == HEIGHT:
            middle = 0.5 * sum(y)
            low, high = (y[0], middle), (middle, y[1])
            return [replace(new, node=below, y=low), replace(new, node=above, y=high)]
        middle = 0.5 * sum(w)
        low, high = (w[0], middle), (middle, w[1])
        return [replace(new, node=below, w=low), replace(new, node=above, w=high)]

    def grid(self, along: np.ndarray, across: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Cosines, and azimuths, of nodes given in [-1, 1]: along y first."""
        y = self.y[0] + 0.5 * (along + 1.0) * (self.y[1] - self.y[0])
        w = self.w[0] + 0.5 * (across + 1.0) * (self.w[1] - self.w[0])
        return directions_of(*np.meshgrid(y, w, indexing="ij"), self.warp, self.strip)


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


def _ratio(model: Model) -> float:
    """The ratio of the widths of the most elongated lobe, along x and y."""
    ratios = [part.widths[0] / part.widths[1] for part in model.parts()]
    return max(ratios, key=lambda ratio: abs(math.log(ratio)), default=1.0)


def log_map(
    model: Model,
    rtol: float,
    most: int = 10_000,
    starts: tuple[float, ...] = STARTS,
    before: Sequence[LogMap] = (),
    shelf: Shelf | None = None,
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
    before : sequence of LogMap
        What the model is divided by: the albedo bends along their critical levels.
    shelf : Shelf, optional
        Where albedos go as they come, and where some may be known.

    Returns
    -------
    LogMap
        With the bounds that were reached, what the tables before err by left out.

    Raises
    ------
    InputError
        For an albedo that is not above 0.
    """
    quarter = model.isotropic or _symmetric(model, rtol)
    chunk = _CHUNK_LATER if before else _CHUNK
    logs_of = partial(_logs, model, rtol, shelf or Shelf(), chunk)
    tree, active = _start(model, logs_of, rtol, starts, quarter)
    active, strips = _bent(tree, active, before)
    leaves: list[tuple[_Rectangle, _Fit]] = []
    used = rows = 0
    while active:
        unknown = [rectangle for rectangle in active if rectangle.turns == 0]
        if unknown:
            seen, taken, evaluations = _seen(logs_of, tree, unknown, rtol, rows < most)
            active = [rectangle for rectangle in active if rectangle.turns] + seen
            rows, used = rows + taken, used + evaluations
            continue
        fits, evaluations = _tabulated(logs_of, active)
        used += evaluations
        rows += sum(rectangle.rows for rectangle in active)
        poor: list[tuple[_Rectangle, _Fit]] = []
        for rectangle, fit in zip(active, fits, strict=True):
            enough = fit.bound <= rtol or fit.missed <= fit.noise
            (leaves if enough or rectangle.short else poor).append((rectangle, fit))
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
        series[k, : rectangle.turns, : rectangle.order] = fit.series
    error = np.array([fit.bound for _, fit in leaves])
    patches = len(leaves), PATCHES, PATCHES
    return LogMap(
        np.array([(*rectangle.y, *rectangle.w) for rectangle, _ in leaves]),
        np.array([rectangle.warp for rectangle, _ in leaves]),
        np.array([rectangle.number for rectangle, _ in leaves]),
        series,
        error,
        np.array(np.broadcast_to(error[:, None, None], patches)),
        np.zeros((*patches, len(before))),
        quarter,
        np.array(tree.axis),
        np.array(tree.split),
        np.array(tree.child),
        np.array(strips).reshape(-1, STRIP_SIZE),
        used,
    )


def _start(
    model: Model, logs_of: _Logs, rtol: float, starts: tuple[float, ...], quarter: bool
) -> tuple[_Tree, list[_Rectangle]]:
    """The first rectangles."""
    ends = [-1.0, 1.0] if quarter else np.linspace(0.0, _WHOLE, 5).tolist()
    # Between the widths of the lobe and a circle.
    warp = math.sqrt(_ratio(model)) if quarter else 0.0
    tree, found = _Tree(), []
    bands = tree.over(tree.leaf(), HEIGHT, list(starts))
    for band, y in zip(bands, itertools.pairwise(starts), strict=True):
        for node, w in zip(tree.over(band, TURN, ends), itertools.pairwise(ends), strict=True):
            found.append(_Rectangle(node, y, w, warp, 1))
    if model.isotropic:
        return tree, found
    # Lines in the middle tell which k suits, and how many nodes it takes along w.
    middle, across = np.zeros(1), _nodes(_GLANCE)
    logs, _, _ = logs_of([rectangle.grid(middle, across) for rectangle in found])
    return tree, [_suited(one, line[0], rtol) for one, line in zip(found, logs, strict=True)]


def _bent(
    tree: _Tree, rectangles: list[_Rectangle], before: Sequence[LogMap]
) -> tuple[list[_Rectangle], list[np.ndarray]]:
    """Rectangles cut into strips along critical levels, and all strips."""
    steps, levels = critical_levels(Maps(tuple(before), None))
    if levels.size == 0:
        return rectangles, []
    box = np.array([(*one.y, *one.w) for one in rectangles])
    warp = np.array([one.warp for one in rectangles])
    repeated = Maps(tuple(before[step] for step in steps.tolist()), None)
    found: list[_Rectangle] = []
    strips: list[np.ndarray] = []
    pieces = cut_along(repeated, levels, box, warp)
    for k, of_one in itertools.groupby(pieces, lambda piece: piece.rectangle):
        whole = rectangles[k]
        ranges = [
            (start, list(together))
            for start, together in itertools.groupby(of_one, lambda piece: piece.start)
        ]
        width = whole.w[1] - whole.w[0]
        ends = [whole.w[0] + width * start for start, _ in ranges] + [whole.w[1]]
        plain = [_plain(end, whole.warp) for end in ends]
        nodes = tree.over(whole.node, TURN, plain)
        alone = [False, *(len(together) == 1 for _, together in ranges), False]
        for i, (_, together) in enumerate(ranges):
            node, w = nodes[i], (ends[i], ends[i + 1])
            if alone[i + 1]:
                # Between two pieces as high as their rectangle a curve runs across w.
                meets = alone[i] + 2 * alone[i + 2]
                if not meets:
                    turns = whole.turns if len(ranges) == 1 or whole.turns == 1 else 0
                    found.append(replace(whole, node=node, w=w, turns=turns))
                    continue
                together = [replace(together[0], ends=meets)]
            for j, piece in enumerate(together):
                last = j == len(together) - 1
                strips.append(_strip(whole, w, piece, (j > 0) + 2 * (not last)))
                number, here = len(strips) - 1, node
                if not last:
                    here, node = tree.cut(node, CURVE, number)
                turns = 1 if whole.turns == 1 else 0
                inside = tree.enter(here, number), (0.0, 1.0), (0.0, 1.0), 0.0, turns
                found.append(_Rectangle(*inside, number, strips[-1]))
    return found, strips


def _strip(whole: _Rectangle, w: tuple[float, float], piece: Piece, edges: int) -> np.ndarray:
    """The numbers of a strip; see `albedo.operators.maps.BENT_TERMS`."""
    return np.array([whole.warp, *whole.y, *w, piece.ends, edges, *piece.lower, *piece.upper])


def _seen(
    logs_of: _Logs, tree: _Tree, rectangles: list[_Rectangle], rtol: float, cut: bool
) -> tuple[list[_Rectangle], int, int]:
    """Rectangles with the nodes that lines across them ask for, or halves of them.

    Also the albedos that it took, and evaluations.
    """
    aside, across, up = np.array([_ASIDE]), _nodes(_GLANCE), _nodes(_ORDER)
    grids = [one.grid(*lines) for one in rectangles for lines in ((aside, across), (up, aside))]
    logs, own, used = logs_of(grids)
    found = []
    for k, one in enumerate(rectangles):
        (along, over), noise = logs[2 * k : 2 * k + 2], max(own[2 * k : 2 * k + 2])
        w = np.linalg.solve(chebyshev.chebvander(across, _GLANCE - 1), along[0])
        y = np.linalg.solve(chebyshev.chebvander(up, _ORDER - 1), over[:, 0])
        least = _least(w, rtol)
        # What albedos themselves err by is no reason to cut.
        rough = np.abs(y[-3:]).sum() > max(rtol, noise)
        turning = least > max(_AMPLE * rtol, _TRUST * noise)
        if cut and not one.short and (rough or turning):
            found += one.halves(tree, HEIGHT if rough else TURN)
            continue
        terms = _terms(np.abs(y), _AMPLE * rtol) + 2
        order = next((count for count in _ORDERS if count >= terms), _ORDER)
        turns = _UNSEEN if turning else _rung(_terms(np.abs(w), least) + 2)
        found.append(replace(one, turns=turns, order=order))
    return found, len(rectangles) * (_GLANCE + _ORDER), used


def _least(series: np.ndarray, rtol: float) -> float:
    """Which terms need no nodes: those that sum to less, or were not resolved."""
    return max(_AMPLE * rtol, 4.0 * float(np.abs(series[-2:]).sum()))


def _suited(rectangle: _Rectangle, line: np.ndarray, rtol: float) -> _Rectangle:
    """A rectangle with the k and the nodes along w that suit the albedos at nodes of a line."""
    across = _nodes(_GLANCE)
    basis = chebyshev.chebvander(across, _GLANCE - 1)
    series = np.linalg.solve(basis, line)
    least = _least(series, rtol)
    found = {rectangle.warp: _terms(np.abs(series), least)}
    for power in (-1, 1) if rectangle.warp > 0.0 else ():
        # One k^2 is that of a circle, the other the ratio of widths.
        other = rectangle.warp ** (1 + power)
        w = np.array([warped(x, rectangle.warp / other) for x in across])
        again = np.linalg.solve(basis, chebyshev.chebval(w, series))
        found[other] = _terms(np.abs(again), least)
    warp = min(found, key=lambda key: found[key])
    turns = _rung(found[warp] + 2) if least <= _AMPLE * rtol else 0
    return replace(rectangle, warp=warp, turns=turns)


def _logs(
    model: Model,
    rtol: float,
    shelf: Shelf,
    chunk: int,
    grids: list[tuple[np.ndarray, np.ndarray]],
) -> tuple[list[np.ndarray], list[float], int]:
    """Logarithms of albedos on grids, what they may err by on each, and evaluations."""
    c, phi = (np.concatenate([grid[k].ravel() for grid in grids]) for k in (0, 1))
    value, error, evaluations = shelf.known(c, phi).T
    missing = np.flatnonzero(np.isnan(value))
    # Every chunk costs about the same.
    count = -(-missing.size // chunk)
    chunks = [missing[k::count] for k in range(count)]

    def of_chunk(which: np.ndarray) -> Estimate:
        found = albedo_rows(
            *([model] * which.size, c[which], phi[which]),
            rtol=_OWN * rtol,
            atol=0.0,
            max_evaluations=_LIMIT,
        )
        shelf.put(c[which], phi[which], found)
        return found

    with ThreadPoolExecutor(threads()) as pool:
        try:
            for which, found in zip(chunks, pool.map(of_chunk, chunks), strict=True):
                value[which], error[which] = found.value, found.error
                evaluations[which] = found.evaluations
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    dark = ~(value > 0.0)
    if dark.any():
        raise InputError(
            f"{model.spec} cannot be pumped up: at cos_theta = {c[dark][0]:.3g} "
            f"its albedo is {value[dark][0]:g}, not above 0"
        )
    ends = np.cumsum([cosines.size for cosines, _ in grids])[:-1]
    logs, errors = np.split(np.log(value), ends), np.split(error / value, ends)
    shaped = [line.reshape(c.shape) for line, (c, _) in zip(logs, grids, strict=True)]
    return shaped, [float(own.max()) for own in errors], int(evaluations.sum())


def _tabulated(logs_of: _Logs, rectangles: list[_Rectangle]) -> tuple[list[_Fit], int]:
    """Series on rectangles, and evaluations."""
    grids = []
    for one in rectangles:
        grids.append(one.grid(_nodes(one.order), _nodes(one.turns)))
        grids.append(one.grid(_fresh(one.order), _fresh(one.turns)))
    logs, own, used = logs_of(grids)
    fits = []
    for k, one in enumerate(rectangles):
        both = slice(2 * k, 2 * k + 2)
        fits.append(_fitted(one, [c[:, 0] for c, _ in grids[both]], logs[both], max(own[both])))
    return fits, used


def _fitted(
    rectangle: _Rectangle, cosines: list[np.ndarray], logs: list[np.ndarray], noise: float
) -> _Fit:
    """The series through values at nodes, and how far it misses those at fresh points."""
    low, high = rectangle.y
    u, u_fresh = _nodes(rectangle.order), _fresh(rectangle.order)
    if rectangle.strip is None:
        # Cosines are rounded: near 1 they stand for another angle.
        u, u_fresh = (
            np.clip(2.0 * (folded(x) - low) / (high - low) - 1.0, -1.0, 1.0) for x in cosines
        )
    top, turns = rectangle.order - 1, rectangle.turns - 1
    half = np.linalg.solve(chebyshev.chebvander(u, top), logs[0])
    series = np.linalg.solve(chebyshev.chebvander(_nodes(rectangle.turns), turns), half.T)
    across = chebyshev.chebvander(_fresh(rectangle.turns), turns) @ series
    fitted = across @ chebyshev.chebvander(u_fresh, top).T
    missed = float(np.abs(fitted - logs[1].T).max())
    lebesgue = _lebesgue(rectangle.order) * _lebesgue(rectangle.turns)
    return _Fit(series, _TRUST * missed + lebesgue * noise, missed, noise)


def _finer(tree: _Tree, rectangle: _Rectangle, fit: _Fit, rtol: float) -> list[_Rectangle]:
    """What a rectangle is replaced by: more nodes, or two halves."""
    modulus, turns = np.abs(fit.series), rectangle.turns
    along, across = modulus[:, -3:].sum(), modulus[-2:].sum()
    wanted = _wanted(modulus.sum(1), rtol) if turns > 1 else 1
    if turns == 1 or along >= across or (along > rtol / _TRUST and wanted <= _TURNS[-1]):
        if rectangle.order == _ORDER:
            return rectangle.halves(tree, HEIGHT)
        more = _rung(wanted) if wanted <= _TURNS[-1] else turns
        return [replace(rectangle, order=_ORDER, turns=max(turns, more))]
    if wanted <= _TURNS[-1]:
        return [replace(rectangle, turns=_rung(max(wanted, turns + 2)))]
    return rectangle.halves(tree, TURN)


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
