"""What pumping-up divides by where albedos depend on the azimuth, or lobes lie anywhere.

An albedo is a table of its logarithm over heights and azimuths: tensor Chebyshev series on
rectangles of (y, w), y being the coordinate of `albedo.charts.heights`. Where a model is symmetric
about its tangent and bitangent, as well as can be seen, an albedo is a smooth function of
cos(2 azimuth), and w = -cos(2 psi) with tan(azimuth) = k tan(psi). Elsewhere w is the azimuth
itself.

Along some curves albedos bend (`albedo.operators.levels`). A *strip* is what lies between two of
them, over a range of w: a place in it is told by its shares of both, from 0 to 1, with nodes
clustered at ends that are curves, and rectangles are cut from it as from the whole.
`albedo.operators.mapping` makes the tables.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial import chebyshev

from albedo._compile import inlined, kernel
from albedo.charts.heights import FIRST, LAST, LOWEST, fold_vector, unfolded
from albedo.operators.divisor import CONTROLS, FEW, PARTS, on_parts

# Terms of series that sum to less than this share of a table's error are left out.
_SHARE = 0.01
# A logarithm that errs by more tells nothing, and its exponential is no number.
HOPELESS = 700.0
_WHOLE = 2.0 * math.pi
PATCHES = 4
"""Even cells of a rectangle along y, and along w, whose errors are told apart."""
# Even cells of y and of w in which rectangles are looked up, and their ranges.
_CELLS = 64
_RANGES = (FIRST, LAST), (-1.0, 1.0), (0.0, _WHOLE)
# How a node of a tree is cut: across the height, across w, along a curve; or a strip begins.
HEIGHT, TURN, CURVE, STRIP, LEAF = 0, 1, 2, 3, -1
# A strip: k^2 of its w, ends in y and in w, at which ends of w and of its height nodes are
# clustered, and Chebyshev series along w for the shares of y at which it begins and ends.
BENT_TERMS = 16
_K2, _LOW, _HIGH, _START, _END, _ENDS, _EDGES, _LOWER = range(8)
_UPPER = _LOWER + BENT_TERMS
STRIP_SIZE = _UPPER + BENT_TERMS


@dataclass(frozen=True, eq=False)
class LogMap:
    """The logarithm of an albedo over all directions of incidence, rectangle by rectangle.

    Attributes
    ----------
    box : ndarray, shape (m, 4)
        Ends of the rectangles in y and in w, or in the shares of their strips.
    warp : ndarray, shape (m,)
        The k^2 of the w of each; 0 where w is the azimuth, and in a strip.
    strip : ndarray of int, shape (m,)
        The strip that each is cut from; -1 where that is none.
    series : ndarray, shape (m, q, 16)
        Chebyshev coefficients on each, those along w first; q is 1 for an isotropic model.
    error : ndarray, shape (m,)
        Bound on the error over each, relative to the albedo.
    own : ndarray, shape (m, 4, 4)
        The same for even cells of each, along y first, without what steps before pass on from the
        same place: see `albedo.operators.stages`.
    passed : ndarray, shape (m, 4, 4, k)
        The shares of the errors of the k tables before, at the same place, that are passed on.
    quarter : bool
        A quarter of the azimuths stands for all.
    axis, split, child : ndarray
        A tree that finds the rectangle of a place: how a node is cut, where (in w with k = 1, or
        the number of a strip, at whose upper end it is cut, or which begins), and the two nodes or
        the rectangle below it.
    strips : ndarray, shape (s, 39)
        See `BENT_TERMS`.
    evaluations : int
        Of the model, to make the table.
    """

    box: np.ndarray
    warp: np.ndarray
    strip: np.ndarray
    series: np.ndarray
    error: np.ndarray
    own: np.ndarray
    passed: np.ndarray
    quarter: bool
    axis: np.ndarray
    split: np.ndarray
    child: np.ndarray
    strips: np.ndarray
    evaluations: int

    def places(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Cosines and azimuths of places spread over every rectangle, ends included: (m, n)."""
        t = np.linspace(0.0, 1.0, count)
        found = []
        for (low, high, first, last), warp, k in zip(self.box, self.warp, self.strip, strict=True):
            y, w = np.meshgrid(low + t * (high - low), first + t * (last - first), indexing="ij")
            found.append(
                directions_of(y.ravel(), w.ravel(), warp, self.strips[k] if k >= 0 else None)
            )
        c, phi = (np.array(lines) for lines in zip(*found, strict=True))
        return c, phi

    def at(self, wi: np.ndarray) -> np.ndarray:
        """The albedo for unit vectors (n, 3)."""
        return np.exp(Maps((self,), None).logs(wi)[:, 0])


def directions_of(
    y: np.ndarray, w: np.ndarray, warp: float, strip: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Cosines and azimuths of places in y and w, or in the shares of a strip."""
    if strip is not None:
        edges = strip[_LOWER:].reshape(2, BENT_TERMS)
        lower, upper = (chebyshev.chebval(2.0 * w - 1.0, series) for series in edges)
        share = np.clip(lower + _gathered(y, strip[_EDGES]) * (upper - lower), 0.0, 1.0)
        y = strip[_LOW] + share * (strip[_HIGH] - strip[_LOW])
        w = strip[_START] + _gathered(w, strip[_ENDS]) * (strip[_END] - strip[_START])
        warp = strip[_K2]
    c = np.clip(unfolded(y), LOWEST, 1.0)
    if warp == 0.0:
        return c, w
    half = 0.5 * np.arccos(np.clip(-w, -1.0, 1.0))
    return c, np.arctan2(math.sqrt(warp) * np.sin(half), np.cos(half))


def _gathered(t: np.ndarray, ends: float) -> np.ndarray:
    """Places in (0, 1), nodes clustered as `albedo.charts._compiled.clustered` does."""
    return (t, t * t, t * (2.0 - t), t * t * (3.0 - 2.0 * t))[int(ends)]


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
        axis, split, box, warp, error, strips = (
            np.concatenate([getattr(table, k) for table in tables])
            for k in ("axis", "split", "box", "warp", "error", "strips")
        )
        # Numbers of strips count on.
        before = np.cumsum([0, *(len(table.strips) for table in tables)])[:-1]
        of_table = np.repeat(before, [table.axis.size for table in tables])
        split = split + np.where(axis >= CURVE, of_table, 0)
        turns = max(FEW, *(table.series.shape[1] for table in tables))
        series = np.zeros((error.size, turns, tables[0].series.shape[2]))
        for table, leaf in zip(tables, leaves[:-1], strict=True):
            series[leaf : leaf + table.error.size, : table.series.shape[1]] = table.series
        parts, terms = _patches(series, error)
        start = np.cumsum(parts.prod(1)) - parts.prod(1)
        trees = axis, split, np.concatenate(child), strips
        cells = [_cells(root, quarter[j], *trees[:3]) for j, root in enumerate(nodes[:-1].tolist())]
        return np.stack(cells), quarter, *trees, box, warp, parts, start, terms

    @cached_property
    def errors(self) -> tuple[float, ...]:
        """Bounds on the relative errors of all tables."""
        return tuple((1.0 + _SHARE) * float(table.error.max()) for table in self.tables)

    def logs(self, wi: np.ndarray) -> np.ndarray:
        """The logarithms of all albedos for unit vectors (n, 3)."""
        out = np.empty((len(wi), len(self.tables)))
        _albedos_all(np.ascontiguousarray(wi), *self.known, out)
        return out

    def divide(self, wi: np.ndarray, wo: np.ndarray, out: np.ndarray) -> None:
        """Divide values of a kernel by the divisor, in place."""
        if self.tables:
            _divide(wi, wo, *self.known, self.code, out)

    @cached_property
    def doubts(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Errors of all rectangles (m,), own ones of their cells, and what these pass on."""
        steps, worst = len(self.tables), HOPELESS / max(len(self.tables), 1)
        error = np.concatenate([table.error for table in self.tables])
        # What is read leaves out a share of every series.
        own = np.concatenate([table.own for table in self.tables])
        own = own.reshape(error.size, -1) + _SHARE * error[:, None]
        passed = [
            np.pad(table.passed, ((0, 0),) * 3 + ((0, steps - j),))
            for j, table in enumerate(self.tables)
        ]
        return (
            np.minimum((1.0 + _SHARE) * error, worst),
            np.minimum(own, worst).ravel(),
            np.concatenate(passed).reshape(-1, steps),
        )

    def weigh_far(self, wi: np.ndarray, wo: np.ndarray, out: np.ndarray) -> None:
        """Multiply values, in place, by a bound on what tables make the divisor err by at V.

        In the logarithm, and of the steps that divide by the albedo there; what may be of either
        side is in it.
        """
        _weigh(wi, wo, *self.known, *self.doubts, self.code, -1, out)

    def weigh_near(self, step: int, wi: np.ndarray, wo: np.ndarray, out: np.ndarray) -> None:
        """Multiply values, in place, by 1 where a step divides by the albedo at L, else by 0."""
        _weigh(wi, wo, *self.known, *self.doubts, self.code, step, out)

    def combined(self, wi: np.ndarray, shares: np.ndarray) -> np.ndarray:
        """Bounds on sums of the errors of all tables, (n,): shares (n, steps) of each, at wi."""
        out = np.empty(len(wi))
        _combined_all(np.ascontiguousarray(wi), *self.known, *self.doubts, shares, out)
        return out

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
    # Thirty-two terms may take more parts than the eighteen of a curve.
    for count in (*PARTS, 2 * PARTS[-1], 4 * PARTS[-1]):
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
        if axis[node] not in (HEIGHT, TURN) or a >= b or c >= d:
            continue
        which = HEIGHT if axis[node] == HEIGHT else 1 if quarter else 2
        cell = _cell_of(split[node], *_RANGES[which])
        low, high = child[node]
        # The cell with the cut in it stays with the node.
        if axis[node] == HEIGHT:
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
def _share(x, low, high, ends):
    """The share of an interval that x stands for, nodes being clustered at some ends."""
    t = min(max((x - low) / (high - low), 0.0), 1.0) if high > low else 0.0
    if ends == 1:
        return math.sqrt(t)
    if ends == 2:
        return 1.0 - math.sqrt(1.0 - t)
    if ends == 3:
        # t = sin(a)^2 is the root of 3 x^2 - 2 x^3 = t.
        return 0.5 - math.sin(math.asin(1.0 - 2.0 * t) / 3.0)
    return t


@inlined
def _edge(strip, first, share):
    """A curve of a strip, as a share of its heights."""
    twice = 4.0 * share - 2.0
    total = last = 0.0
    for i in range(first + BENT_TERMS - 1, first, -1):
        total, last = twice * total + (strip[i] - last), total
    return 0.5 * twice * total - last + strip[first]


@inlined
def _across_strip(strip, place):
    """The share of the range of w of a strip."""
    if strip[_K2] > 0.0:
        place = warped(place, strip[_K2])
    return _share(place, strip[_START], strip[_END], strip[_ENDS])


@inlined
def _leaf(height, place, j, cells, quarter, axis, split, child, strips):
    """The rectangle of table j that holds a place, and the place as it is told there."""
    low, high = (-1.0, 1.0) if quarter[j] else (0.0, _WHOLE)
    node = cells[j, _cell_of(height, FIRST, LAST), _cell_of(place, low, high)]
    while axis[node] >= 0:
        side = 0
        if axis[node] == HEIGHT:
            side = int(height >= split[node])
        elif axis[node] == TURN:
            side = int(place >= split[node])
        else:
            strip = strips[int(split[node])]
            share = _across_strip(strip, place)
            up = (height - strip[_LOW]) / (strip[_HIGH] - strip[_LOW])
            end = _edge(strip, _UPPER, share)
            if axis[node] == CURVE:
                side = int(up >= end)
            else:
                height = _share(up, _edge(strip, _LOWER, share), end, strip[_EDGES])
                place = share
        node = child[node, side]
    return child[node, 0], height, place


@inlined
def _on_part(x, low, high, parts):
    """Which of the even parts of an interval holds x, and the variable of its powers."""
    at = parts * ((min(max(x, low), high) - low) / (high - low))
    part = min(int(at), parts - 1)
    return part, 2.0 * (at - part) - 1.0


@inlined
def albedos_at(
    x, y, z, cells, quarter, axis, split, child, strips, box, warp, parts, start, terms, out
):
    """Fill the logarithms of the albedos of all steps for one direction."""
    folded = fold_vector(x, y, z)
    for j in range(cells.shape[0]):
        tree = cells, quarter, axis, split, child, strips
        k, height, place = _leaf(folded, _across(x, y, quarter[j]), j, *tree)
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
def _albedos_all(
    wi, cells, quarter, axis, split, child, strips, box, warp, parts, start, terms, out
):
    known = cells, quarter, axis, split, child, strips, box, warp, parts, start, terms
    for i in range(out.shape[0]):
        albedos_at(wi[i, 0], wi[i, 1], wi[i, 2], *known, out[i])


@kernel
def _divide(
    wi, wo, cells, quarter, axis, split, child, strips, box, warp, parts, start, terms, control, out
):
    steps = cells.shape[0]
    at_l, at_v = np.empty(steps), np.empty(steps)
    known = cells, quarter, axis, split, child, strips, box, warp, parts, start, terms
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


@inlined
def _patch_of(x, y, z, j, known, patch):
    """The rectangle of table j that holds a direction, and its cell."""
    cells, quarter, axis, split, child, strips, box, warp = known[:8]
    tree = cells, quarter, axis, split, child, strips
    k, height, place = _leaf(fold_vector(x, y, z), _across(x, y, quarter[j]), j, *tree)
    if warp[k] > 0.0:
        place = warped(place, warp[k])
    first, _ = _on_part(height, box[k, 0], box[k, 1], PATCHES)
    second, _ = _on_part(place, box[k, 2], box[k, 3], PATCHES)
    patch[j] = (k * PATCHES + first) * PATCHES + second
    return k


@inlined
def _bound(shares, patch, own, passed):
    """Bound on a sum of errors at one place; the shares are changed.

    What an error of table l is made of is its own, less what it passes on of those before.
    """
    total = 0.0
    for j in range(shares.size - 1, -1, -1):
        total += abs(shares[j]) * own[patch[j]]
        for i in range(j):
            shares[i] -= shares[j] * passed[patch[j], i]
    return total


@inlined
def _sides(at_l, at_v, of_l, of_v, largest, control, side):
    """Fill whose albedo every step divides by: that of L (1), of V (2), or neither (0).

    Return what the errors make of this where it cannot be told.
    """
    unsure, product, most = 0.0, 0.0, 0.0
    for j in range(side.size):
        larger, worst = max(at_l[j], at_v[j]), max(of_l[j], of_v[j])
        side[j] = 2 if at_v[j] > at_l[j] else 1
        # The wrong side is off by what errors exceed the distance by.
        unsure += max(of_l[j] + of_v[j] - abs(at_v[j] - at_l[j]), 0.0)
        if control == 1:
            if larger < largest:
                side[j] = 0
            unsure += max(worst - abs(larger - largest), 0.0)
        product += larger
        most += worst
    if control == 2:
        if product < largest:
            side[:] = 0
            unsure = 0.0
        unsure += max(most - abs(product - largest), 0.0)
    return unsure


@kernel
def _weigh(
    wi,
    wo,
    cells,
    quarter,
    axis,
    split,
    child,
    strips,
    box,
    warp,
    parts,
    start,
    terms,
    error,
    own,
    passed,
    control,
    which,
    out,
):
    """Multiply values by a bound on what V adds to the error of the divisor, or, where a step is
    given, by whether it divides by the albedo at L."""
    steps = cells.shape[0]
    at_l, at_v, of_l, of_v = np.empty(steps), np.empty(steps), np.empty(steps), np.empty(steps)
    side, patch, shares = np.empty(steps, np.int64), np.empty(steps, np.int64), np.empty(steps)
    known = cells, quarter, axis, split, child, strips, box, warp, parts, start, terms
    for k in range(out.shape[0]):
        x, y, z = wi[0, k], wi[1, k], wi[2, k]
        albedos_at(x, y, z, *known, at_l)
        lz = max(z, LOWEST)
        for j in range(steps):
            of_l[j] = error[_patch_of(x, y, z, j, known, patch)]
        for i in range(out.shape[1]):
            x, y, z = wo[0, k, i], wo[1, k, i], wo[2, k, i]
            if not z > 0.0:
                continue
            albedos_at(x, y, z, *known, at_v)
            for j in range(steps):
                of_v[j] = error[_patch_of(x, y, z, j, known, patch)]
            largest = math.log(max(z, lz)) if control != 0 else -math.inf
            unsure = _sides(at_l, at_v, of_l, of_v, largest, control, side)
            if which >= 0:
                out[k, i] *= 1.0 if side[which] == 1 else 0.0
                continue
            for j in range(steps):
                shares[j] = 1.0 if side[j] == 2 else 0.0
            out[k, i] *= unsure + _bound(shares, patch, own, passed)


@kernel
def _combined_all(
    wi,
    cells,
    quarter,
    axis,
    split,
    child,
    strips,
    box,
    warp,
    parts,
    start,
    terms,
    error,
    own,
    passed,
    shares,
    out,
):
    steps = cells.shape[0]
    patch, here = np.empty(steps, np.int64), np.empty(steps)
    known = cells, quarter, axis, split, child, strips, box, warp, parts, start, terms
    for i in range(out.size):
        for j in range(steps):
            _patch_of(wi[i, 0], wi[i, 1], wi[i, 2], j, known, patch)
            here[j] = shares[i, j]
        out[i] = _bound(here, patch, own, passed)


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
