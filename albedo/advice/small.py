"""Constants, polynomials and tables that stand for an albedo over the ranges of a scene."""

from __future__ import annotations

import itertools
import math
from bisect import bisect_left
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np

from albedo.advice.interpolant import Interpolant, interpolate
from albedo.advice.prices import STORED, Prices
from albedo.advice.rows import albedos
from albedo.advice.scene import Points, Scene
from albedo.advice.ways import Lazy, Places, Variant, Way
from albedo.brdf import Model
from albedo.lookup.stored import (
    MOST_AXES,
    READ,
    Grid,
    Polynomial,
    Table,
    all_warps,
    size_of,
)

SIZES = (2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512)
"""Points along each axis of the tables that are tried."""
LARGEST = {1: 512, 2: 128, 3: 32}
DEGREES = {1: range(1, 13), 2: range(1, 9), 3: range(1, 6)}
"""Degrees of the polynomials that are tried, by the number of axes."""

# Coordinates that an albedo may have: two parameters, an azimuth, and a cosine.
_MOST_COORDINATES = 4
# Values that an interpolant may ask for, as seconds of the nested quadrature.
_SECONDS = 0.8
_MOST_VALUES = 20_000
# Shares of the tolerance: what an interpolant's last coefficients, and its values, may err by.
_LAST, _EXACT = 0.01, 1e-3
# What is offered beside the smallest that does: sizes that are larger by up to so many steps.
_STEPS = 4
# Places that tell how often the quadrature evaluates the model.
_FEW = 4


@dataclass(eq=False)
class SmallWays:
    """Ways to the albedo of one variant in a scene that evaluate nothing.

    Attributes
    ----------
    scene : Scene
    variant : Variant
    prices : Prices
    pilot : Places
        Where ways are chosen.
    """

    scene: Scene
    variant: Variant
    prices: Prices
    pilot: Places

    def all(self) -> Iterator[Way]:
        """All of them."""
        for kept in self._kept():
            yield from self._all_polynomials(kept)
            yield from self._all_tables(kept)
        yield from self._constants()

    def good(self) -> Iterator[Way]:
        """All but those that are larger than they need be, or too small."""
        for kept in self._kept():
            yield from self._good_polynomials(kept)
            yield from self._good_tables(kept)
        yield from self._constants()

    @cached_property
    def _names(self) -> tuple[str, ...]:
        axes = [axis.name for axis in self.scene.axes if axis.high > axis.low]
        turns = not all(m.isotropic for m in self.variant.models(self.pilot.points))
        low, high = self.scene.cosines
        cosine = ("cos_theta",) if high > low else ()
        return (*axes, *(("phi",) if turns else ()), *cosine)

    @cached_property
    def _ends(self) -> tuple[tuple[float, float], ...]:
        own = {axis.name: (axis.low, axis.high) for axis in self.scene.axes}
        own |= {"phi": (0.0, 0.5 * math.pi), "cos_theta": self.scene.cosines}
        return tuple(own[name] for name in self._names)

    def _kept(self) -> Iterator[tuple[int, ...]]:
        """Which coordinates are read: all, or some, where the others matter little."""
        count = len(self._names)
        if count <= _MOST_COORDINATES:
            for number in range(1, min(count, MOST_AXES) + 1):
                yield from itertools.combinations(range(count), number)

    def _coordinates(self, points: Points) -> np.ndarray:
        """Coordinates of places, shape (axes, n); azimuths folded into a quarter turn."""
        known = points.memo.get(("x", self._names))
        if known is None or known.shape[1] < len(points):
            turn = points.phi
            folded = np.arctan2(np.abs(np.sin(turn)), np.abs(np.cos(turn)))
            own = {**points.values, "phi": folded, "cos_theta": points.cos_theta}
            known = np.array([own[name] for name in self._names])
            points.memo["x", self._names] = known
        return known[:, : len(points)]

    @cached_property
    def interpolant(self) -> Interpolant:
        """The albedo over the scene."""
        scene, names = self.scene, self._names
        entry, each = self.prices.adaptive(self.variant.typical)
        few = self.pilot.points.first(_FEW)
        one = entry + scene.evaluations(few) * each + self.prices.made(self.variant.typical)
        most = min(max(int(_SECONDS * 1e9 / one), 3 ** len(names)), _MOST_VALUES)

        def values(columns: list[np.ndarray]) -> np.ndarray:
            own = dict(zip(names, columns, strict=True))
            count = columns[0].size
            fixed = {axis.name: np.full(count, axis.low) for axis in scene.axes}
            parameters = {axis.name: own.get(axis.name, fixed[axis.name]) for axis in scene.axes}
            models = _models(scene, self.variant, parameters, count)
            cosine = own.get("cos_theta", np.full(count, scene.cosines[0]))
            turn = own.get("phi", np.zeros(count))
            rtol, atol = max(_EXACT * scene.rtol, 1e-12), _EXACT * scene.atol
            return albedos(models, cosine, turn, rtol, atol, scene.fixed)[0]

        logs = {axis.name for axis in scene.axes if axis.log}
        warps = tuple(
            "angle" if name == "cos_theta" else "log" if name in logs else "linear"
            for name in names
        )
        allowed = _LAST * float(self.pilot.allowed.min())
        return interpolate(values, names, self._ends, warps, allowed, most)

    @cached_property
    def _made(self) -> dict[Any, Any]:
        """Interpolants over some of the coordinates, and values on grids, as they are asked for."""
        return {}

    def _over(self, kept: tuple[int, ...], warps: tuple[str, ...] | None = None) -> Interpolant:
        """The interpolant over some coordinates, in other warps of them."""
        if (kept, warps) not in self._made:
            found = self.interpolant.over(kept) if warps is None else self._over(kept)
            self._made[kept, warps] = found if warps is None else found.in_warps(warps)
        return self._made[kept, warps]

    def _grid(self, kept: tuple[int, ...], warps: tuple[str, ...], counts: tuple[int, ...]) -> Grid:
        names = tuple(self._names[k] for k in kept)
        return Grid(names, tuple(self._ends[k] for k in kept), warps, counts)

    def _warps(self, kept: tuple[int, ...]) -> list[tuple[str, ...]]:
        return all_warps([self._names[k] for k in kept], [self._ends[k][0] for k in kept])

    def _all_polynomials(self, kept: tuple[int, ...]) -> Iterator[Way]:
        axes = len(kept)
        for warps in self._warps(kept):
            for degrees in itertools.product(DEGREES[axes], repeat=axes):
                for stored in ("float64", "float32"):
                    yield self._polynomial(kept, warps, tuple(d + 1 for d in degrees), stored)

    def _good_polynomials(self, kept: tuple[int, ...]) -> Iterator[Way]:
        axes = len(kept)
        counts = [d + 1 for d in DEGREES[axes]]
        for warps in self._warps(kept):
            for own in self._smallest(counts, axes, partial(self._polynomial, kept, warps)):
                for stored in ("float64", "float32"):
                    yield self._polynomial(kept, warps, own, stored)

    def _all_tables(self, kept: tuple[int, ...]) -> Iterator[Way]:
        axes = len(kept)
        sizes = [n for n in SIZES if n <= LARGEST[axes]]
        for warps, read in itertools.product(self._warps(kept), READ):
            for counts in _shapes(sizes, axes):
                if read == "linear" or min(counts) >= 4:
                    for stored in STORED:
                        yield self._table(kept, warps, read, counts, stored)

    def _good_tables(self, kept: tuple[int, ...]) -> Iterator[Way]:
        axes = len(kept)
        for warps, read in itertools.product(self._warps(kept), READ):
            least = 4 if read == "cubic" else 2
            sizes = [n for n in SIZES if least <= n <= LARGEST[axes]]
            for own in self._smallest(sizes, axes, partial(self._table, kept, warps, read)):
                for stored in STORED:
                    yield self._table(kept, warps, read, own, stored)

    def _smallest(
        self, sizes: Sequence[int], axes: int, way: Callable[..., Way]
    ) -> Iterator[tuple[int, ...]]:
        """The smallest counts that do, and some that are a few steps larger along all axes.

        Errors are taken to fall with every count; where they do not, something larger is found.
        """

        def does(places: tuple[int, ...]) -> bool:
            counts = tuple(sizes[k] for k in places)
            return self.pilot.worst(way(counts, "float64").values) <= 1.0

        last = len(sizes) - 1
        if not does((last,) * axes):
            return
        found = [bisect_left(range(last), True, key=lambda k: does((k,) * axes))] * axes
        for axis in range(axes):
            before, after = found[:axis], found[axis + 1 :]

            def along(k: int, before: list[int] = before, after: list[int] = after) -> bool:
                return does((*before, k, *after))

            found[axis] = bisect_left(range(found[axis]), True, key=along)
        for step in range(_STEPS):
            yield tuple(sizes[min(k + step, last)] for k in found)
            if min(found) + step >= last:
                return

    def _table(
        self,
        kept: tuple[int, ...],
        warps: tuple[str, ...],
        read: str,
        counts: tuple[int, ...],
        stored: str,
    ) -> Way:
        grid = self._grid(kept, warps, counts)
        size = size_of(counts, stored)
        price = self.prices.lookup(grid, stored, read, size)

        def make() -> Table:
            if grid not in self._made:
                self._made[grid] = self._over(kept).grid(grid.nodes())
            return Table.of(grid, self._made[grid], stored, read)

        return self._read("table", f"{grid} points, {stored}, {read}", price, size, kept, make)

    def _polynomial(
        self, kept: tuple[int, ...], warps: tuple[str, ...], counts: tuple[int, ...], stored: str
    ) -> Way:
        grid = self._grid(kept, warps, counts)
        price = self.prices.polynomial(grid)
        size = math.prod(counts) * (8 if stored == "float64" else 4)

        def make() -> Polynomial:
            own = self._over(kept, warps).coefficients[tuple(slice(count) for count in counts)]
            cut = np.zeros(counts)
            cut[tuple(slice(n) for n in own.shape)] = own
            return Polynomial.of(grid, cut, stored)

        detail = f"{grid} coefficients, {stored}"
        return self._read("polynomial", detail, price, size, kept, make)

    def _read(
        self,
        kind: str,
        detail: str,
        price: float,
        size: int,
        kept: tuple[int, ...],
        make: Callable[[], Any],
    ) -> Way:
        lazy = Lazy(make)

        def values(points: Points) -> np.ndarray:
            return lazy.get()(self._coordinates(points)[list(kept)])

        return Way(kind, detail, self.variant.without, price, size, values, made=lazy)

    def _constants(self) -> Iterator[Way]:
        """One number for all places, which nothing has to be left out for."""
        if self.variant.path:
            return
        low, high = float(self.pilot.known.min()), float(self.pilot.known.max())
        # Of all numbers the one whose largest error is least.
        relative = self.scene.atol == 0.0 and low > 0.0
        value = 2.0 * low * high / (low + high) if relative else 0.5 * (low + high)

        def values(points: Points) -> np.ndarray:
            return np.full(len(points), value)

        yield Way("constant", f"{value:.6g}", "", self.prices.constant(), 8, values)


def _shapes(sizes: Sequence[int], axes: int) -> Iterator[tuple[int, ...]]:
    """As many points along all axes; along two, also up to four times as many along one."""
    if axes != 2:
        yield from ((n,) * axes for n in sizes)
        return
    for first, second in itertools.product(sizes, repeat=2):
        if max(first, second) <= 4 * min(first, second):
            yield first, second


def _models(
    scene: Scene, variant: Variant, parameters: dict[str, np.ndarray], count: int
) -> list[Model]:
    """What a variant makes of the model for sets of parameters, one object for each set."""
    if not parameters:
        return [variant.of(scene.model)] * count
    table = np.array(list(parameters.values()))
    distinct, which = np.unique(table, axis=1, return_inverse=True)
    columns = dict(zip(parameters, distinct, strict=True))
    models = [variant.of(model) for model in scene.models(columns, distinct.shape[1])]
    return [models[i] for i in which.ravel()]
