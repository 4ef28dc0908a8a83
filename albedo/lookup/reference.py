"""A function over the domain of a table, known to far better than the table will be.

Tensor Chebyshev series on boxes, which are halved across the axis that is worst until fresh points
between the nodes confirm them: each carries a bound on its error. Cosines are taken in the
logarithm towards the horizon and in the angle beyond, parameters over decades in the logarithm, so
that layers cost what anything else does.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev

from albedo._compile import inlined, kernel
from albedo._threads import side_by_side
from albedo.charts.heights import folded, unfolded
from albedo.errors import InputError

LOWEST = 1e-9
"""Below this cosine, what is here stands for the limit."""

MOST_AXES = 3

# Nodes along each of as many axes.
_ORDERS = {1: 16, 2: 12, 3: 10}
# Between its nodes, where the fresh points stand, an interpolant errs most; in between not by more.
_TRUST = 4.0
_MOST = {1: 512, 2: 1500, 3: 400}
_DECADES = 4.0
# Places that are worth another thread.
_WORTH = 2048
_EPS = float(np.finfo(np.float64).eps)

Function = Callable[[list[np.ndarray]], tuple[np.ndarray, np.ndarray]]
"""Values and bounds on their errors, shape (n,) each, for lists of coordinates."""


@dataclass(frozen=True)
class Coordinate:
    """One coordinate of a table's domain.

    Attributes
    ----------
    name : str
        Of a parameter, ``phi`` or ``cos_theta``.
    low, high : float
    """

    name: str
    low: float
    high: float

    @property
    def scale(self) -> str:
        """What series are polynomials in: ``height``, ``log`` or ``linear``."""
        if self.name == "cos_theta":
            return "height"
        return "log" if self.low > 0.0 and self.high > _DECADES * self.low else "linear"

    def inward(self, x: np.ndarray) -> np.ndarray:
        """What series are polynomials in, of values."""
        if self.scale == "height":
            return folded(np.maximum(x, LOWEST))
        return np.log(x) if self.scale == "log" else np.asarray(x, dtype=np.float64)

    def outward(self, y: np.ndarray) -> np.ndarray:
        """Values, within the ends."""
        if self.scale == "height":
            return np.clip(unfolded(y), max(self.low, LOWEST), self.high)
        x = np.exp(y) if self.scale == "log" else y
        return np.clip(x, self.low, self.high)

    @property
    def ends(self) -> tuple[float, float]:
        """Both ends, inward."""
        first, last = self.inward(np.array([self.low, self.high])).tolist()
        return first, last


@inlined
def _series_at(y, axis, split, child, box, coefficients):
    """Clenshaw's sums, one in the other, on the box that holds a place."""
    node = 0
    while axis[node] >= 0:
        node = child[node, 0] if y[axis[node]] < split[node] else child[node, 1]
    k = child[node, 0]
    u0, u1, u2 = _unit(y, box, k, 0), _unit(y, box, k, 1), _unit(y, box, k, 2)
    total = before = 0.0
    for i in range(coefficients.shape[1] - 1, -1, -1):
        plane = earlier = 0.0
        for j in range(coefficients.shape[2] - 1, -1, -1):
            line = last = 0.0
            for m in range(coefficients.shape[3] - 1, 0, -1):
                line, last = 2.0 * u2 * line - last + coefficients[k, i, j, m], line
            own = u2 * line - last + coefficients[k, i, j, 0]
            if j > 0:
                plane, earlier = 2.0 * u1 * plane - earlier + own, plane
            else:
                plane = u1 * plane - earlier + own
        if i > 0:
            total, before = 2.0 * u0 * total - before + plane, total
        else:
            total = u0 * total - before + plane
    return total, k


@inlined
def _unit(y, box, k, a):
    low, high = box[k, a, 0], box[k, a, 1]
    x = min(max(y[a], low), high)
    return ((x - low) - (high - x)) / (high - low)


@kernel
def _fill(y, axis, split, child, box, coefficients, out, which):
    place = np.empty(3)
    for i in range(out.size):
        for a in range(3):
            place[a] = y[a, i]
        out[i], which[i] = _series_at(place, axis, split, child, box, coefficients)


@dataclass(frozen=True, eq=False)
class Reference:
    """Values over a domain, with bounds.

    Attributes
    ----------
    coordinates : tuple of Coordinate
    axis, split, child : ndarray
        A tree of halves: across which axis, where, and its two branches; an axis of -1 is a box.
    box : ndarray, shape (boxes, 3, 2)
        Ends of the boxes, inward; of axes that there are not, -1 and 1.
    coefficients : ndarray, shape (boxes, n, n, n)
    error : ndarray, shape (boxes,)
        Bounds on the errors over the boxes: as shares of the values where `relative`.
    relative : bool
    below : float
        What may be added for cosines below `LOWEST`.
    values_asked : int
        How many values it took.
    """

    coordinates: tuple[Coordinate, ...]
    axis: np.ndarray
    split: np.ndarray
    child: np.ndarray
    box: np.ndarray
    coefficients: np.ndarray
    error: np.ndarray
    relative: bool
    below: float
    values_asked: int

    def __call__(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values and bounds on their errors at coordinates, shape (axes, n)."""
        y = np.zeros((3, x.shape[1]))
        for a, coordinate in enumerate(self.coordinates):
            y[a] = coordinate.inward(x[a])
        value, which = np.empty(x.shape[1]), np.empty(x.shape[1], dtype=np.int64)
        tree = self.axis, self.split, self.child, self.box, self.coefficients

        def fill(part: slice) -> None:
            _fill(np.ascontiguousarray(y[:, part]), *tree, value[part], which[part])

        side_by_side(fill, x.shape[1], _WORTH)
        error = self.error[which] * (np.abs(value) if self.relative else 1.0)
        if self.below > 0.0:
            error = error + np.where(x[self._cosine] < LOWEST, self.below, 0.0)
        return value, error

    @property
    def largest(self) -> float:
        """The largest bound, of a reference that is not relative."""
        return float(self.error.max()) + self.below

    @property
    def _cosine(self) -> int:
        return [c.name for c in self.coordinates].index("cos_theta")


def refer(
    function: Function, coordinates: Sequence[Coordinate], allowed: float, relative: bool = False
) -> Reference:
    """Interpolate a function over a domain.

    Parameters
    ----------
    function : callable
        See `Function`.
    coordinates : sequence of Coordinate
        Up to three.
    allowed : float
        The error asked for.
    relative : bool
        As a share of the values.

    Returns
    -------
    Reference
        With the bounds that were reached.

    Raises
    ------
    InputError
        Where a value is no number, or the bounds that were reached are over ten times what was
        asked for: the function has more corners than boxes can follow.
    """
    axes = len(coordinates)
    order = _ORDERS[axes]
    node = chebyshev.chebpts1(order)
    # Over three axes, every other one of the places between the nodes is enough.
    fresh = chebyshev.chebpts2(order + 1)[:: 1 if axes < 3 else 2]
    inverse = np.linalg.inv(chebyshev.chebvander(node, order - 1))
    check = chebyshev.chebvander(fresh, order - 1)
    # What errors at the nodes may come to between them.
    lebesgue = float(np.abs(check @ inverse).sum(1).max()) ** axes
    boxes = [tuple(c.ends for c in coordinates)]
    # Of every node of the tree: axis, split, branches.
    tree: list[list[float]] = [[-1, 0.0, -1, -1]]
    active = [(0, boxes[0])]
    found: list[tuple[tuple[tuple[float, float], ...], np.ndarray, float]] = []
    asked = 0
    while active:
        places = np.concatenate(
            [_mesh(box, points, coordinates) for _, box in active for points in (node, fresh)],
            axis=1,
        )
        value, error = function(list(places))
        asked += value.size
        if not np.isfinite(value).all() or not np.isfinite(error).all():
            at = int(np.flatnonzero(~(np.isfinite(value) & np.isfinite(error)))[0])
            where = ", ".join(
                f"{c.name} = {x:.3g}" for c, x in zip(coordinates, places[:, at], strict=True)
            )
            raise InputError(f"the table has no value with a bound at {where}")
        size = order**axes
        per = size + fresh.size**axes
        halves: list[tuple[int, tuple[tuple[float, float], ...]]] = []
        for k, (place, box) in enumerate(active):
            own = slice(k * per, (k + 1) * per)
            v, e = value[own], error[own]
            series = _transform(v[:size].reshape((order,) * axes), inverse)
            missed = np.abs(_transform(series, check).ravel() - v[size:])
            unit = np.abs(v).min() if relative else 1.0
            bound = _TRUST * missed.max() + lebesgue * e.max() + 64.0 * _EPS * np.abs(v).max()
            bound /= max(unit, 1e-300)
            full = len(found) + 2 * len(active) > _MOST[axes]
            # What is left is due to the errors of the values, and halves have the same.
            noise = lebesgue * e.max() > 0.5 * allowed * unit and missed.max() <= e.max() * lebesgue
            if bound <= allowed or full or noise:
                tree[place][2] = len(found)
                found.append((box, series, bound))
                continue
            worst = int(np.argmax([_tail(series, axis) for axis in range(axes)]))
            low, high = box[worst]
            middle = 0.5 * (low + high)
            tree[place] = [worst, middle, len(tree), len(tree) + 1]
            for ends in ((low, middle), (middle, high)):
                halves.append((len(tree), (*box[:worst], ends, *box[worst + 1 :])))
                tree.append([-1, 0.0, -1, -1])
        active = halves
    reached = max(bound for _, _, bound in found)
    if reached > 10.0 * allowed:
        raise InputError(
            f"the values that a table is made of are known to {reached:.2g} only, where "
            f"{allowed:.2g} is needed; ask for a larger error, or for a smaller domain"
        )
    branches = np.array(tree)
    padding = ((-1.0, 1.0),) * (MOST_AXES - axes)
    return Reference(
        tuple(coordinates),
        branches[:, 0].astype(np.int64),
        branches[:, 1].copy(),
        branches[:, 2:].astype(np.int64),
        np.array([(*box, *padding) for box, _, _ in found]),
        np.array([series.reshape((*series.shape, *(1,) * (3 - axes))) for _, series, _ in found]),
        np.array([bound for _, _, bound in found]),
        relative,
        _below(function, coordinates),
        asked,
    )


def _mesh(
    box: Sequence[tuple[float, float]], points: np.ndarray, coordinates: Sequence[Coordinate]
) -> np.ndarray:
    """Coordinates of a tensor of points of [-1, 1] in a box, shape (axes, n)."""
    lines = [
        c.outward(low + 0.5 * (high - low) * (points + 1.0))
        for c, (low, high) in zip(coordinates, box, strict=True)
    ]
    return np.array([m.ravel() for m in np.meshgrid(*lines, indexing="ij")])


def _transform(values: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """A matrix along every axis."""
    for axis in range(values.ndim):
        values = np.moveaxis(np.tensordot(matrix, values, axes=(1, axis)), 0, axis)
    return values


def _tail(series: np.ndarray, axis: int) -> float:
    """How large the last coefficients along an axis are."""
    return float(np.abs(np.moveaxis(series, axis, 0)[-2:]).sum())


def _below(function: Function, coordinates: Sequence[Coordinate]) -> float:
    """How far the limit at the horizon may lie from what is at the lowest cosine that is held."""
    names = [c.name for c in coordinates]
    if "cos_theta" not in names or coordinates[names.index("cos_theta")].low >= LOWEST:
        return 0.0
    others = [
        np.array([0.5 * (c.low + c.high)])
        if c.name == "cos_theta"
        else np.linspace(c.low, c.high, 9)
        for c in coordinates
    ]
    mesh = [m.ravel() for m in np.meshgrid(*others, indexing="ij")]
    ends = []
    for cosine in (0.0, LOWEST):
        mesh[names.index("cos_theta")] = np.full(mesh[0].size, cosine)
        value, error = function(list(mesh))
        ends.append((value, error))
    (limit, doubt), (near, own) = ends
    return float((2.0 * np.abs(limit - near) + doubt + own).max())
