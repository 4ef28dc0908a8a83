"""The design of a table: axes, size and storage that meet an error from end to end.

What a table errs by is the error of its nodes, of what is read between them, of how its numbers are
stored and of where its reader takes them to lie, all at once: it is measured, on places between all
nodes, against a reference (`albedo.lookup.reference`) that is known far better, and then at fresh
places by quadrature.
"""

from __future__ import annotations

import itertools
import math
from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from albedo.brdf import Model
from albedo.errors import InputError
from albedo.lookup.label import Channel, Errors, LookupTable, about_of
from albedo.lookup.quantities import Quantity, coordinates_of, functions_of, quantity_of, subject_of
from albedo.lookup.reference import Coordinate, Function, Reference, refer
from albedo.lookup.stored import READ, STORED, TEXELS, Grid, Table, size_of
from albedo.lookup.warps import Warp

Reader = Callable[[np.ndarray], np.ndarray]
"""Readings, shape (n,), at coordinates, shape (axes, n)."""

METRICS = ("max", "rms", "relative")
"""What is to be small: the largest error, its root mean square, or its share of the value."""

LARGEST = {1: 4096, 2: 1024, 3: 96}
"""Most points along an axis, by the number of axes."""

# What the reference, and its values, may err by, of what a table may.
_REFERENCE, _VALUES = 0.02, 2e-4
# Places along each axis where designs are compared, by the number of axes.
_COMPARED = {1: 4001, 2: 193, 3: 41}
# Places to a cell along each axis where the design that is chosen is measured, and all together.
_WITHIN, _MOST = 8, 3_000_000
# Fresh places where the table is compared with quadrature, and of these next to the worst.
_FRESH, _NEAR = 768, 256
_SEED = 0x1ABE1
# Shares along each axis whose errors the label tells, by the number of axes.
_BLOCKS = {1: 32, 2: 12, 3: 6}
# Numbers k of the rational family that are tried, before the best one is sharpened.
_FAMILY = (0.01, 0.0316, 0.1, 0.316, 1.0, 3.16, 10.0)
_SHARPENINGS = 8
# How much smaller a table has to be for another warp to be worth it.
_BEST = 4


@dataclass(frozen=True, eq=False)
class Wish:
    """What a table is asked to be.

    Attributes
    ----------
    error : float or None
        The error that it shall meet; None where its size is given.
    metric : str
        Of `METRICS`.
    read : str
        Of `albedo.lookup.stored.READ`.
    stored : str
        Of `albedo.lookup.stored.STORED`.
    counts : tuple of int or None
        Points along each axis, where they are given.
    warps : mapping of str to str
        What an axis is to be even in, where that is given.
    most_bytes : int or None
    texels : str
        Of `albedo.lookup.stored.TEXELS`.
    """

    error: float | None
    metric: str = "max"
    read: str = "linear"
    stored: str = "float32"
    counts: tuple[int, ...] | None = None
    warps: Mapping[str, str] | None = None
    most_bytes: int | None = None
    texels: str = "ends"

    def check(self, axes: int) -> None:
        """Refuse what no table can be."""
        for name, value, known in (
            ("metric", self.metric, METRICS),
            ("interp", self.read, READ),
            ("dtype", self.stored, STORED),
            ("texels", self.texels, TEXELS),
        ):
            if value not in known:
                raise InputError(f"{name} = {value!r} is unknown; choose one of {', '.join(known)}")
        if (self.error is None) == (self.counts is None):
            raise InputError("give the error that the table shall meet, or its size")
        if self.error is not None and not 1e-7 <= self.error <= 0.5:
            raise InputError(f"error = {self.error!r} is out of range; it lies in [1e-7, 0.5]")
        if self.most_bytes is not None and self.most_bytes < 1:
            raise InputError(f"max_bytes = {self.most_bytes!r} is out of range; it is at least 1")
        if self.counts is not None:
            least = 4 if self.read == "cubic" else 2
            if len(self.counts) != axes:
                raise InputError(
                    f"size = {'x'.join(map(str, self.counts))} has {len(self.counts)} axes; the "
                    f"table has {axes}"
                )
            if not all(least <= n <= LARGEST[axes] for n in self.counts):
                raise InputError(
                    f"size = {'x'.join(map(str, self.counts))} is out of range; along each axis it "
                    f"lies in [{least}, {LARGEST[axes]}]"
                )


def design(
    model: Model | str,
    ranges: Mapping[str, tuple[float, float]] | None = None,
    error: float | None = None,
    *,
    metric: str = "max",
    quantity: str = "albedo",
    cosines: tuple[float, float] = (0.0, 1.0),
    interp: str = "linear",
    dtype: str = "float32",
    size: Sequence[int] | None = None,
    warps: Mapping[str, str] | None = None,
    max_bytes: int | None = None,
    texels: str = "ends",
    fixed: str = "light",
    progress: Callable[[str], None] | None = None,
) -> LookupTable:
    """Design a lookup table of a model, and say what it errs by.

    Parameters
    ----------
    model : Model or str
        With one channel; or its name and parameters in the grammar, where a sweep says between
        which numbers a parameter varies.
    ranges : mapping of str to (float, float), optional
        Parameters that are axes of the table, and between which numbers.
    error : float, optional
        What the table may err by, end to end, anywhere in its domain; the smallest table is sought
        that meets it. In [1e-7, 0.5].
    metric : {"max", "rms", "relative"}
        Of which error: the largest, the root mean square over even coordinates, or the largest as a
        share of the value.
    quantity : {"albedo", "complement", "split_sum", "average"}
        See `albedo.lookup.quantities.QUANTITIES`.
    cosines : (float, float)
        The smallest and the largest cosine of the angle to the normal.
    interp : {"linear", "cubic"}
        How the table is read.
    dtype : {"float64", "float32", "float16", "unorm16", "unorm8"}
        How its numbers are stored.
    size : sequence of int, optional
        Points along each axis in place of an error; the axes are sought that err least.
    warps : mapping of str to str, optional
        What axes are even in; see `albedo.lookup.warps`. All others are sought.
    max_bytes : int, optional
        What the numbers may take.
    texels : {"ends", "centres"}
        Whether nodes lie on both ends of an axis, or in the middle of equal texels, as a reader
        takes them to lie that scales its texture coordinate by nothing.
    fixed : {"light", "view"}
        As in `albedo.directional_albedo`.
    progress : callable, optional
        Called with a few words for every stage.

    Returns
    -------
    LookupTable
        With its errors, measured.

    Raises
    ------
    InputError
        For input out of range, and where no table meets the error within the bytes.

    Examples
    --------
    >>> import albedo
    >>> table = albedo.design("phong:n=1..100/2", error=1e-2)
    >>> bool(table.worst <= 1e-2)
    True
    """
    model, varied = subject_of(model, ranges, "design")
    what = quantity_of(quantity)
    coordinates = coordinates_of(model, varied, what, cosines)
    counts = None if size is None else tuple(size)
    wish = Wish(error, metric, interp, dtype, counts, warps, max_bytes, texels)
    wish.check(len(coordinates))
    search = Search(model, what, coordinates, wish, fixed, progress or (lambda words: None))
    return search.found()


@dataclass(eq=False)
class Search:
    """The search for one table, or for what stands for it."""

    model: Model
    quantity: Quantity
    coordinates: tuple[Coordinate, ...]
    wish: Wish
    fixed: str
    say: Callable[[str], None]

    @cached_property
    def relative(self) -> bool:
        return self.wish.metric == "relative"

    @cached_property
    def goal(self) -> float:
        """What errors are to be told apart from: the error asked for, or a guess at it."""
        if self.wish.error is not None:
            return self.wish.error
        assert self.wish.counts is not None
        return max(
            0.02 * min(self.wish.counts) ** (-2.0 if self.wish.read == "linear" else -4.0), 1e-7
        )

    @cached_property
    def functions(self) -> list[Function]:
        return functions_of(
            *(self.model, self.quantity, self.coordinates, _VALUES * self.goal),
            *(self.relative, self.fixed),
        )

    @cached_property
    def references(self) -> list[Reference]:
        self.say("values of the model")
        return [
            refer(f, self.coordinates, _REFERENCE * self.goal, self.relative)
            for f in self.functions
        ]

    @cached_property
    def cloud(self) -> np.ndarray:
        """Places where designs are compared: even in several warps of each coordinate."""
        lines = [_spread(c, _COMPARED[len(self.coordinates)]) for c in self.coordinates]
        return np.array([m.ravel() for m in np.meshgrid(*lines, indexing="ij")])

    @cached_property
    def known(self) -> list[np.ndarray]:
        return [reference(self.cloud)[0] for reference in self.references]

    @cached_property
    def _weight(self) -> np.ndarray:
        """Shares of the domain that the places stand for, which sum to 1."""
        shares = []
        for c in self.coordinates:
            x = _spread(c, _COMPARED[len(self.coordinates)])
            ends = np.concatenate(([x[0]], 0.5 * (x[1:] + x[:-1]), [x[-1]]))
            shares.append(np.diff(ends) / (x[-1] - x[0]))
        found = shares[0]
        for own in shares[1:]:
            found = np.multiply.outer(found, own)
        return found.ravel()

    def _tables(self, grid: Grid) -> list[Table]:
        points = grid.points()
        return [
            Table.of(
                grid, reference(points)[0].reshape(grid.counts), self.wish.stored, self.wish.read
            )
            for reference in self.references
        ]

    def _errs(self, grid: Grid) -> float:
        """The error of a design, at the places where designs are compared."""
        worst = 0.0
        for table, known in zip(self._tables(grid), self.known, strict=True):
            off = np.abs(table(self.cloud) - known)
            if self.wish.metric == "rms":
                own = math.sqrt(float(self._weight @ off**2))
            elif self.relative:
                own = float((off / np.maximum(np.abs(known), 1e-300)).max())
            else:
                own = float(off.max())
            worst = max(worst, own)
        return worst

    def _grid(self, warps: tuple[str, ...], counts: tuple[int, ...]) -> Grid:
        names = tuple(c.name for c in self.coordinates)
        ends = tuple((c.low, c.high) for c in self.coordinates)
        return Grid(names, ends, warps, counts, self.wish.texels)

    def found(self) -> LookupTable:
        """The best table, measured."""
        _ = self.known
        self.say("axes")
        axes = len(self.coordinates)
        trial = self.wish.counts or (max(8, min(64, LARGEST[axes] // 2)),) * axes
        ranked = sorted(
            ((self._errs(self._grid(warps, trial)), warps) for warps in self.combinations()),
            key=lambda pair: pair[0],
        )
        best = [self._sharpened(warps, trial) for _, warps in ranked[:_BEST]]
        if self.wish.counts is not None:
            chosen = min(best, key=lambda warps: self._errs(self._grid(warps, trial)))
            grid = self._grid(chosen, trial)
            self._check_bytes(grid)
            return self._measured(grid)
        self.say("size")
        sizes = [(self._smallest(warps, self.goal), warps) for warps in best]
        offered = [
            (size_of(counts, self.wish.stored), self._grid(warps, counts))
            for counts, warps in sizes
            if counts is not None
        ]
        if not offered:
            warps = ranked[0][1]
            largest = self._errs(self._grid(warps, (LARGEST[axes],) * axes))
            raise InputError(
                f"no table of {self.wish.stored} read by {self.wish.read} "
                f"interpolation meets {self.goal:g}: with {LARGEST[axes]} points along each axis "
                f"the best errs by {largest:.2g}"
            )
        return self._grown(min(offered, key=lambda pair: pair[0])[1])

    def _grown(self, grid: Grid) -> LookupTable:
        """A table that meets the error where it is measured, larger than it seemed if need be."""
        assert self.wish.error is not None
        while True:
            self._check_bytes(grid)
            table = self._measured(grid)
            if table.worst <= self.wish.error:
                return table
            counts = tuple(n + max(1, n // 32) for n in grid.counts)
            if max(counts) > LARGEST[len(counts)]:
                raise InputError(
                    f"no table of {self.wish.stored} meets {self.wish.error:g}: the largest errs "
                    f"by {table.worst:.2g}"
                )
            grid = replace(grid, counts=counts)

    def _check_bytes(self, grid: Grid) -> None:
        most = self.wish.most_bytes
        taken = size_of(grid.counts, self.wish.stored) * len(self.quantity.channels)
        if most is not None and taken > most:
            shape = " x ".join(map(str, grid.counts))
            raise InputError(
                f"no table within {most} bytes meets {self.goal:g}: the smallest found has "
                f"{shape} points of {self.wish.stored}, {taken} bytes"
            )

    def combinations(self) -> Iterator[tuple[str, ...]]:
        given = dict(self.wish.warps or {})
        names = [c.name for c in self.coordinates]
        for name in given:
            if name not in names:
                raise InputError(f"there is no axis {name!r}; the table has {', '.join(names)}")
        for name, text in given.items():
            own = Warp.parse(text)
            if own.by and (own.by not in names or own.by == name):
                raise InputError(f"the warp {text!r} of {name} names no other axis")
            if own.by and next(c for c in self.coordinates if c.name == own.by).low <= 0.0:
                raise InputError(f"the warp {text!r} of {name} is none where {own.by} is 0")
            if own.kind == "log" and next(c for c in self.coordinates if c.name == name).low <= 0.0:
                raise InputError(f"{name} begins at 0, where there is no logarithm")
        yield from itertools.product(
            *(
                [given[c.name]] if c.name in given else warps_for(c, self.coordinates)
                for c in self.coordinates
            )
        )

    def _sharpened(self, warps: tuple[str, ...], counts: tuple[int, ...]) -> tuple[str, ...]:
        """The same with the number of every rational warp as good as it gets."""
        given = self.wish.warps or {}
        for axis, text in enumerate(warps):
            own = Warp.parse(text)
            if own.kind != "rational" or self.coordinates[axis].name in given:
                continue

            before, after = warps[:axis], warps[axis + 1 :]

            def at(
                e: float,
                before: tuple[str, ...] = before,
                own: Warp = own,
                after: tuple[str, ...] = after,
            ) -> tuple[str, ...]:
                return (*before, str(replace(own, k=float(f"{10.0**e:.3g}"))), *after)

            def errs(e: float, at: Callable[[float], tuple[str, ...]] = at) -> float:
                return self._errs(self._grid(at(e), counts))

            middle = math.log10(own.k)
            warps = at(_golden(errs, middle - 0.5, middle + 0.5))
        return warps

    def _smallest(self, warps: tuple[str, ...], goal: float) -> tuple[int, ...] | None:
        """The smallest counts that meet an error; errors are taken to fall with every count."""
        axes = len(warps)
        least, most = (4 if self.wish.read == "cubic" else 2), LARGEST[axes]

        def does(counts: tuple[int, ...]) -> bool:
            return self._errs(self._grid(warps, counts)) <= goal

        # Twice as many each time: large tables take long to compare.
        high = max(least, 8)
        while not does((high,) * axes):
            if high == most:
                return None
            high = min(2 * high, most)
        low = least if high <= 8 else high // 2
        even = low + bisect_left(range(low, high), True, key=lambda n: does((n,) * axes))
        if axes == 1:
            return (even,)
        return min(self._slimmed(does, even, axes, least), key=math.prod)

    @staticmethod
    def _slimmed(
        does: Callable[[tuple[int, ...]], bool], even: int, axes: int, least: int
    ) -> Iterator[tuple[int, ...]]:
        """As few points along one axis after the other, beginning a little larger or not."""
        for more in (1.0, 1.15, 1.4):
            for order in itertools.permutations(range(axes)):
                counts = [max(even, round(more * even))] * axes
                for axis in order:

                    def along(n: int, axis: int = axis, counts: list[int] = counts) -> bool:
                        return does((*counts[:axis], n, *counts[axis + 1 :]))

                    counts[axis] = least + bisect_left(range(least, counts[axis]), True, key=along)
                if does(tuple(counts)):
                    yield tuple(counts)

    def _measured(self, grid: Grid) -> LookupTable:
        """A table with its errors: between all nodes, and at fresh places by quadrature."""
        self.say("errors")
        parts = zip(
            self.quantity.channels,
            self._tables(grid),
            self.references,
            self.functions,
            strict=True,
        )
        channels = [
            Channel(name, table, measure(grid, table, reference, function))
            for name, table, reference, function in parts
        ]
        how: dict[str, Any] = {"metric": self.wish.metric, "asked": self.wish.error}
        about = about_of(self.model, self.quantity, grid, fixed=self.fixed, **how)
        return LookupTable(tuple(channels), about)


def warps_for(c: Coordinate, all_of_them: Sequence[Coordinate]) -> list[str]:
    """What an axis is tried to be even in."""
    if c.name == "phi":
        return ["linear"]
    family = [f"rational:{k!r}" for k in _FAMILY]
    if c.name != "cos_theta":
        plain = ["linear", "sqrt"] if c.low >= 0.0 else ["linear"]
        return [*plain, "log"] if c.low > 0.0 else plain
    others = [o.name for o in all_of_them if o.name not in ("cos_theta", "phi") and o.low > 0.0]
    coupled = [f"{text}*{name}" for name in others for text in family]
    return ["linear", "sqrt", "angle", *family, *coupled]


def _spread(c: Coordinate, count: int) -> np.ndarray:
    """Values of a coordinate, even in several warps at once, ascending, both ends among them."""
    share = np.linspace(0.0, 1.0, count // 2 + 1)
    first, last = c.ends
    inward = c.outward(first + share * (last - first))
    plain = c.low + share * (c.high - c.low)
    if c.name == "cos_theta":
        # Half of what is even in the logarithm would lie where nobody looks.
        root = math.sqrt(c.low) + share * (math.sqrt(c.high) - math.sqrt(c.low))
        plain = np.concatenate((plain[::2], np.clip(root * root, c.low, c.high)[::2]))
    return np.unique(np.concatenate((inward, plain, [c.low, c.high])))


def _golden(f: Callable[[float], float], a: float, b: float) -> float:
    """Where a function with one minimum is least, roughly."""
    ratio = 0.5 * (math.sqrt(5.0) - 1.0)
    x, y = b - ratio * (b - a), a + ratio * (b - a)
    fx, fy = f(x), f(y)
    for _ in range(_SHARPENINGS):
        if fx <= fy:
            b, y, fy = y, x, fx
            x = b - ratio * (b - a)
            fx = f(x)
        else:
            a, x, fx = x, y, fy
            y = a + ratio * (b - a)
            fy = f(y)
    return x if fx <= fy else y


def measure(grid: Grid, read: Reader, reference: Reference, function: Function) -> Errors:
    """What readings err by: between all nodes of a grid, and at fresh places by quadrature.

    Parameters
    ----------
    grid : Grid
        Of a table, or so fine that errors do not bend more than once from node to node.
    read : callable
        Readings at coordinates, shape (axes, n).
    reference : Reference
    function : callable
        What the reference was made of.

    Returns
    -------
    Errors
    """
    within = _WITHIN
    while within > 2 and math.prod(within * n for n in grid.counts) > _MOST:
        within -= 2
    fine = grid.between(within)
    places = fine.points()
    known, doubt = (a.reshape(fine.counts) for a in reference(places))
    off = read(places).reshape(fine.counts) - known
    start = 0 if grid.texels == "ends" else within // 2
    # What lies between the places, by the curvature that they show, and what they err by.
    more = sum(_overshoot(off, axis, within, start) for axis in range(off.ndim)) + doubt
    bound = np.abs(off) + more
    size = np.maximum(np.abs(known), 1e-300)
    at = np.unravel_index(int(np.argmax(bound)), bound.shape)
    worst = places[:, int(np.argmax(bound))]
    weight = _weights(fine, places)
    verified, count = _verified(read, reference, function, fine, at, within)
    nodes = tuple(slice(start, None, within) for _ in fine.counts)
    return Errors(
        largest=float(bound.max()),
        rms=math.sqrt(float((weight * bound**2).sum())),
        relative=float((bound / size).max()),
        nodes=float((np.abs(off) + doubt)[nodes].max()),
        where=dict(zip(grid.names, worst.tolist(), strict=True)),
        verified=verified,
        places=count,
        map=_map(bound).tolist(),
    )


def _overshoot(off: np.ndarray, axis: int, within: int, start: int) -> float:
    """How far errors may go beyond those at places next to each other: an eighth of their bend."""
    e = np.moveaxis(off, axis, 0)
    bend = np.abs(e[2:] - 2.0 * e[1:-1] + e[:-2])
    inside = (np.arange(1, len(e) - 1) - start) % within != 0
    return 0.125 * float(bend[inside].max()) if inside.any() else 0.0


def _weights(fine: Grid, places: np.ndarray) -> np.ndarray:
    """Shares of the domain that places stand for, in even coordinates."""
    found = np.ones(fine.counts)
    for axis, count in enumerate(fine.counts):
        x = np.moveaxis(places[axis].reshape(fine.counts), axis, -1)
        middle = 0.5 * (x[..., 1:] + x[..., :-1])
        ends = np.concatenate((x[..., :1], middle, x[..., count - 1 :]), axis=-1)
        found = found * np.moveaxis(np.abs(np.diff(ends, axis=-1)), -1, axis)
    return found / found.sum()


def _map(bound: np.ndarray) -> np.ndarray:
    """The largest bound over equal shares of each axis, with three digits."""
    blocks = _BLOCKS[bound.ndim]
    for axis, count in enumerate(bound.shape):
        # What lies on the edge of two shares counts for both.
        edges = (count - 1) * np.arange(blocks + 1) / blocks
        parts = [
            np.take(bound, range(math.floor(low), math.ceil(high) + 1), axis=axis).max(axis=axis)
            for low, high in itertools.pairwise(edges.tolist())
        ]
        bound = np.stack(parts, axis=axis)
    digit = 10.0 ** (np.floor(np.log10(np.maximum(bound, 1e-300))) - 2.0)
    # Up: a bound is not rounded down.
    return np.array([float(f"{x:.3g}") for x in (np.ceil(bound / digit) * digit).ravel()]).reshape(
        bound.shape
    )


def _verified(
    read: Reader,
    reference: Reference,
    function: Function,
    fine: Grid,
    at: Sequence[Any],
    within: int,
) -> tuple[float, int]:
    """The largest error at fresh places, at random and about the worst one, by quadrature."""
    rng = np.random.default_rng(_SEED)
    axes = len(fine.counts)
    scale = np.array(fine.counts)[:, None] - 1.0
    spread = rng.uniform(size=(axes, _FRESH))
    near = (np.array(at)[:, None] + within * rng.uniform(-1.0, 1.0, (axes, _NEAR))) / scale
    x = fine.at(np.concatenate((spread, np.clip(near, 0.0, 1.0)), axis=1))
    value, error = function(list(x))
    known, doubt = reference(x)
    missed = np.abs(known - value) - doubt - error
    if missed.max() > 0.0:
        k = int(np.argmax(missed))
        where = ", ".join(f"{n} = {v:.6g}" for n, v in zip(fine.names, x[:, k], strict=True))
        raise InputError(
            f"values of the model next to {where} change faster than was seen; the table would err "
            f"by {missed[k]:.2g} more than it says"
        )
    return float((np.abs(read(x) - value) + error).max()), x.shape[1]
