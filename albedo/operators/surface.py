"""An albedo, or what it leaves of 1, as a function of height and azimuth, with a bound.

What `albedo.operators.heights` is for isotropic models, for the others: tensor Chebyshev series on
rectangles of (y, azimuth), halved across the worse direction until fresh points between the nodes
confirm them. Where the model is symmetric about its tangent and its bitangent, as well as can be
seen, a quarter of the azimuths is enough.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.polynomial import chebyshev

from albedo._compile import inlined, kernel
from albedo.brdf import Model
from albedo.charts.heights import FIRST, LAST, LOWEST, area, fold, folded, unfolded
from albedo.operators.heights import (
    DEEP,
    LAGRANGE,
    NOISE,
    SHORTEST,
    TRUST,
    HeightTable,
    albedos,
    below_lowest,
    height_table,
    refuse,
    refuse_unlimited,
)

# Nodes along y and along the azimuth.
_ORDER, _TURNS = 16, 12
_MOST = 600
_TINY = 1e-300
_EPS = np.finfo(np.float64).eps
_QUARTER = 0.5 * math.pi
_WHOLE = 2.0 * math.pi
# Azimuths at which a height is looked at for its largest relative error, and what may lie between.
_LOOKS, _SLACK = 33, 1.25

_RULES = np.polynomial.legendre.leggauss(32), np.polynomial.legendre.leggauss(20)


@kernel
def turned(x, y, quarter):
    """The azimuth of a direction, in [0, pi/2] where a quarter stands for all, else [0, 2 pi)."""
    if quarter:
        return math.atan2(abs(y), abs(x))
    turn = math.atan2(y, x)
    return turn if turn >= 0.0 else turn + 2.0 * math.pi


@inlined
def surface_at(y, turn, axis, split, child, box, coefficients):
    """Two sums of Clenshaw's on the rectangle that holds a place; never less than 1e-300."""
    node = 0
    while axis[node] >= 0:
        x = y if axis[node] == 0 else turn
        node = child[node, 0] if x < split[node] else child[node, 1]
    k = child[node, 0]
    a, b, c, d = box[k, 0], box[k, 1], box[k, 2], box[k, 3]
    y, turn = min(max(y, a), b), min(max(turn, c), d)
    u = ((y - a) - (b - y)) / (b - a)
    v = ((turn - c) - (d - turn)) / (d - c)
    total = before = 0.0
    for i in range(coefficients.shape[1] - 1, -1, -1):
        inner = last = 0.0
        for j in range(coefficients.shape[2] - 1, 0, -1):
            inner, last = 2.0 * v * inner - last + coefficients[k, i, j], inner
        own = v * inner - last + coefficients[k, i, 0]
        if i > 0:
            total, before = 2.0 * u * total - before + own, total
        else:
            total = u * total - before + own
    return max(total, 1e-300)


@kernel
def _surface_all(y, turn, axis, split, child, box, coefficients, out):
    for i in range(y.size):
        out[i] = surface_at(y[i], turn[i], axis, split, child, box, coefficients)


@kernel
def _surface_rows(x, y, z, quarter, axis, split, child, box, coefficients, out):
    for i in range(z.size):
        height, turn = fold(z[i], math.hypot(x[i], y[i])), turned(x[i], y[i], quarter)
        out[i] = surface_at(height, turn, axis, split, child, box, coefficients)


@dataclass(frozen=True, eq=False)
class SurfaceTable:
    """A function of height and azimuth, not below 0, rectangle by rectangle.

    Attributes
    ----------
    box : ndarray, shape (m, 4)
        Ends of the rectangles in y and in azimuth.
    coefficients : ndarray, shape (m, 16, 12)
        Chebyshev coefficients on each.
    error, floor : ndarray, shape (m,)
        The error on a rectangle is at most ``error * max(value, floor)``.
    below : float
        What is added to the error below `albedo.charts.heights.LOWEST`.
    quarter : bool
        A quarter of the azimuths stands for all.
    axis, split, child : ndarray
        A tree that finds the rectangle of a place: along which direction a node is cut (-1: it is
        a leaf), where, and the two nodes or the rectangle below it.
    evaluations : int
        Of the model, to make the table.
    """

    box: np.ndarray
    coefficients: np.ndarray
    error: np.ndarray
    floor: np.ndarray
    below: float
    quarter: bool
    axis: np.ndarray
    split: np.ndarray
    child: np.ndarray
    evaluations: int

    @property
    def _known(self) -> tuple[np.ndarray, ...]:
        return self.axis, self.split, self.child, self.box, self.coefficients

    def fill(self, v: np.ndarray, out: np.ndarray) -> None:
        """Fill values for unit vectors (3, ...)."""
        x, y, z = (np.ascontiguousarray(component).ravel() for component in v)
        _surface_rows(x, y, z, self.quarter, *self._known, out.reshape(-1))

    def at(self, y: np.ndarray, turn: np.ndarray) -> np.ndarray:
        """Values at coordinates y and azimuths, two arrays of one shape."""
        out = np.empty(y.size)
        flat = (np.ascontiguousarray(a, dtype=np.float64).ravel() for a in (y, turn))
        _surface_all(*flat, *self._known, out)
        return out.reshape(y.shape)

    def of(self, wi: np.ndarray) -> np.ndarray:
        """Values for unit vectors (n, 3)."""
        out = np.empty(len(wi))
        self.fill(wi.T, out)
        return out

    @property
    def worst(self) -> float:
        """The largest of the relative errors, where values are above the floor."""
        return float(self.error.max())

    @property
    def edges(self) -> tuple[float, ...]:
        """Ends of all rectangles in y."""
        return tuple(np.unique(self.box[:, :2]).tolist())

    @property
    def turns(self) -> tuple[float, ...]:
        """Ends of all rectangles in azimuth, over the whole turn."""
        ends = np.unique(self.box[:, 2:])
        if self.quarter:
            ends = np.concatenate((ends, math.pi - ends, math.pi + ends, _WHOLE - ends))
            ends = np.unique(np.round(ends / _QUARTER, 12)) * _QUARTER
        return tuple(ends.tolist())

    def _leaf(self, y: np.ndarray, turn: np.ndarray) -> np.ndarray:
        """The rectangles that hold places."""
        node = np.zeros(y.shape, dtype=int)
        while True:
            inner = self.axis[node] >= 0
            if not inner.any():
                found: np.ndarray = self.child[node, 0]
                return found
            x = np.where(self.axis[node] == 0, y, turn)
            side = (x >= self.split[node]).astype(int)
            node = np.where(inner, self.child[node, side], node)

    def relative(self, cos_theta: np.ndarray | None = None) -> np.ndarray:
        """Bounds relative to the values at cosines, for any azimuth; the worst of all for None."""
        end = _QUARTER if self.quarter else _WHOLE
        turn = np.linspace(0.0, end, _LOOKS if self.quarter else 4 * _LOOKS)
        if cos_theta is None:
            ends = np.array(self.edges)
            y = (ends[:-1, None] + np.diff(ends)[:, None] * np.linspace(0.0, 1.0, 17)).ravel()
            return self._over(y, turn).max()
        c = np.asarray(cos_theta, dtype=np.float64)
        found = self._over(folded(c.ravel()), turn).reshape(c.shape)
        if not np.any(c < LOWEST):
            return found
        least = self.at(*np.broadcast_arrays(np.array(FIRST), turn)).min()
        return found + np.where(c < LOWEST, self.below / least, 0.0)

    def _over(self, y: np.ndarray, turn: np.ndarray) -> np.ndarray:
        """The largest relative error over azimuths, at places y (n,)."""
        places = np.broadcast_arrays(y[:, None], turn)
        k = self._leaf(*places)
        ratio = np.maximum(1.0, self.floor[k] / self.at(*places))
        return _SLACK * (self.error[k] * ratio).max(1)

    @cached_property
    def average(self) -> tuple[float, float]:
        r"""\int value mu dmu dphi/pi over all directions, and a bound on its error."""
        (x, w), (t, g) = _RULES
        low, size = self.box[:, :1], self.box[:, 1:2] - self.box[:, :1]
        first, turn = self.box[:, 2:3], self.box[:, 3:] - self.box[:, 2:3]
        y, phi = low + 0.5 * size * (x + 1.0), first + 0.5 * turn * (t + 1.0)
        values = self.at(*np.broadcast_arrays(y[:, :, None], phi[:, None, :]))
        whole = _QUARTER if self.quarter else _WHOLE
        weight = (0.5 * size * w * area(y))[:, :, None] * (0.5 * turn * g / whole)[:, None, :]
        pieces = (weight * values).sum((1, 2))
        error = float((self.error * (pieces + self.floor * weight.sum((1, 2)))).sum())
        total = float(pieces.sum())
        return total, error + LOWEST**2 + 64.0 * _EPS * total

    def maximum(self) -> tuple[float, float]:
        """The largest value, and a bound on its relative error.

        It is sampled, then sought in ever smaller surroundings.
        """
        best = 0.0
        u = np.linspace(0.0, 1.0, 17)
        y = self.box[:, :1] + (self.box[:, 1:2] - self.box[:, :1]) * u
        turn = self.box[:, 2:3] + (self.box[:, 3:] - self.box[:, 2:3]) * u
        seen = self.at(*np.broadcast_arrays(y[:, :, None], turn[:, None, :])).reshape(len(y), -1)
        for k in np.flatnonzero(seen.max(1) >= 0.99 * seen.max()).tolist():
            a, b, c, d = self.box[k]
            i, j = divmod(int(seen[k].argmax()), u.size)
            place, width = np.array([u[i], u[j]]), 1.0 / 16.0
            for _ in range(24):
                near = place[:, None] + width * np.linspace(-1.0, 1.0, 9)
                near = np.clip(near, 0.0, 1.0)
                grid = np.broadcast_arrays(
                    (a + (b - a) * near[0])[:, None], (c + (d - c) * near[1])[None, :]
                )
                found = self.at(*grid)
                i, j = divmod(int(found.argmax()), 9)
                place = np.array([near[0, i], near[1, j]])
                best = max(best, float(found.max()))
                width *= 0.5
        return best, float((self.error * np.maximum(1.0, self.floor / best)).max())


def _symmetric(model: Model, rtol: float) -> bool:
    """Whether albedos mirrored at tangent and bitangent are the same, as far as is known."""
    rng = np.random.default_rng(1)
    count = 12
    c = np.concatenate((rng.random(count), 0.5 * np.exp(-10.0 * rng.random(count))))
    turn = rng.uniform(0.0, _QUARTER, c.size)
    mirrored = [turn, -turn, math.pi - turn, math.pi + turn]
    found = [albedos(model, c, False, rtol, phi=phi)[:2] for phi in mirrored]
    (first, error), others = found[0], found[1:]
    return all(bool(np.all(np.abs(v - first) <= error + e)) for v, e in others)


@lru_cache(maxsize=128)
def surface_table(model: Model, lost: bool = False, rtol: float = 1e-6) -> SurfaceTable:
    """Tabulate the albedo of a model, or 1 - albedo, over all heights and azimuths.

    Parameters
    ----------
    model, lost, rtol
        As for `albedo.operators.heights.height_table`, but the model need not be isotropic.

    Returns
    -------
    SurfaceTable
        With the bounds that were reached.

    Raises
    ------
    InputError
        For an albedo above 1, or not above 0.
    """
    if lost:
        refuse_unlimited(model)
    quarter = _symmetric(model, rtol)
    ends = _QUARTER if quarter else _WHOLE
    turns = np.linspace(0.0, ends, 2 if quarter else 5).tolist()
    # Towards the horizon little light arrives, and evaluations are dear.
    start = [FIRST, -12.0, -6.0, -3.0, 0.0, LAST]
    axis: list[int] = []
    split: list[float] = []
    child: list[list[int]] = []
    active: list[tuple[int, float, float, float, float]] = []

    def grow(heights: list[float], azimuths: list[float]) -> int:
        """A balanced tree over the first rectangles."""
        node = len(axis)
        axis.append(-1)
        split.append(0.0)
        child.append([-1, -1])
        if len(heights) > 2:
            k = len(heights) // 2
            axis[node], split[node] = 0, heights[k]
            child[node] = [grow(heights[: k + 1], azimuths), grow(heights[k:], azimuths)]
        elif len(azimuths) > 2:
            k = len(azimuths) // 2
            axis[node], split[node] = 1, azimuths[k]
            child[node] = [grow(heights, azimuths[: k + 1]), grow(heights, azimuths[k:])]
        else:
            active.append((node, heights[0], heights[1], azimuths[0], azimuths[1]))
        return node

    grow(start, turns)
    typical, used = _typical(model, ends) if lost else (0.0, 0)
    leaves: list[tuple[np.ndarray, np.ndarray, float, float]] = []
    while active:
        box = np.array([rectangle[1:] for rectangle in active])
        size = np.column_stack((box[:, 1] - box[:, 0], box[:, 3] - box[:, 2]))
        sets = []
        for along, across in ((_NODES, _NODES_TURN), (_FRESH, _FRESH_TURN)):
            y = box[:, :1] + 0.5 * (along + 1.0) * size[:, :1]
            c = np.clip(unfolded(y), LOWEST, 1.0)
            turn = box[:, 2:3] + 0.5 * (across + 1.0) * size[:, 1:]
            places = np.broadcast_arrays(c[:, :, None], turn[:, None, :])
            flat = places[0].ravel(), places[1].ravel()
            value, error, count = albedos(model, flat[0], lost, rtol, typical, flat[1])
            used += count
            refuse(model, flat[0], value, error, lost)
            # Cosines are rounded: near 1 they stand for another angle.
            u = 2.0 * (folded(c) - box[:, :1]) / size[:, :1] - 1.0
            basis = chebyshev.chebvander(u, _ORDER - 1)
            shape = places[0].shape
            sets.append((value.reshape(shape), error.reshape(shape), basis))
        (value, error, basis), (fresh, wide, other) = sets
        half = np.linalg.solve(basis, value)
        coefficients = np.linalg.solve(_BASIS_TURN, half.transpose(0, 2, 1)).transpose(0, 2, 1)
        fitted = other @ coefficients @ _CHECK_TURN.T
        modulus = np.maximum(np.abs(value).max((1, 2)), np.abs(fresh).max((1, 2)))
        above = np.maximum(
            np.maximum(error - 0.15 * rtol * np.abs(value), 0.0).max((1, 2)),
            np.maximum(wide - 0.15 * rtol * np.abs(fresh), 0.0).max((1, 2)),
        )
        floor = np.maximum(DEEP * np.maximum(modulus, typical), above / (NOISE * rtol))
        floor = np.maximum(floor, _TINY)
        # Between the nodes as well: a value may fall to next to nothing there.
        between = np.abs(_BETWEEN @ coefficients @ _BETWEEN_TURN.T)
        floor = np.maximum(floor, between.min((1, 2)))
        missed = np.abs(fitted - fresh).max((1, 2)) / floor
        # What errors at the nodes may come to between them, and those that hide what was missed.
        noise = _LAGRANGE @ error @ _LAGRANGE_TURN.T
        own = (noise / np.maximum(between, floor[:, None, None])).max((1, 2))
        own += (wide / np.maximum(np.abs(fresh), floor[:, None, None])).max((1, 2))
        bound = TRUST * missed + own + 256.0 * _EPS * modulus / floor
        # What would be left of the error if one direction were cut no more.
        tail = np.abs(coefficients)
        steep = np.column_stack((tail[:, -3:].sum((1, 2)), tail[:, :, -3:].sum((1, 2))))
        steep[:, 1] *= size[:, 1] > SHORTEST
        cut = np.argmax(steep, axis=1)
        done = (bound <= rtol) | (size[:, 0] < SHORTEST)
        if len(leaves) + 2 * len(active) > _MOST:
            done[:] = True
        halves: list[tuple[int, float, float, float, float]] = []
        for k, (node, a, b, c0, c1) in enumerate(active):
            if done[k]:
                child[node] = [len(leaves), -1]
                leaves.append((box[k], coefficients[k], float(bound[k]), float(floor[k])))
                continue
            new = [len(axis), len(axis) + 1]
            axis[node], child[node] = int(cut[k]), new
            if cut[k] == 0:
                middle = 0.5 * (a + b)
                halves += [(new[0], a, middle, c0, c1), (new[1], middle, b, c0, c1)]
            else:
                middle = 0.5 * (c0 + c1)
                halves += [(new[0], a, b, c0, middle), (new[1], a, b, middle, c1)]
            split[node] = middle
            axis += [-1, -1]
            split += [0.0, 0.0]
            child += [[-1, -1], [-1, -1]]
        active = halves
    return SurfaceTable(
        np.array([leaf[0] for leaf in leaves]),
        np.array([leaf[1] for leaf in leaves]),
        np.array([leaf[2] for leaf in leaves]),
        np.array([leaf[3] for leaf in leaves]),
        max(below_lowest(model, lost, rtol, phi) for phi in np.linspace(0.0, ends, 5)),
        quarter,
        np.array(axis),
        np.array(split),
        np.array(child),
        used,
    )


_NODES, _NODES_TURN = chebyshev.chebpts1(_ORDER), chebyshev.chebpts1(_TURNS)
_FRESH, _FRESH_TURN = chebyshev.chebpts2(_ORDER + 1), chebyshev.chebpts2(_TURNS + 1)
_BASIS_TURN = chebyshev.chebvander(_NODES_TURN, _TURNS - 1)
_CHECK_TURN = chebyshev.chebvander(_FRESH_TURN, _TURNS - 1)
# Places between the nodes, and the moduli of Lagrange's polynomials there.
_BETWEEN = chebyshev.chebvander(np.linspace(-1.0, 1.0, 33), _ORDER - 1)
_BETWEEN_TURN = chebyshev.chebvander(np.linspace(-1.0, 1.0, 25), _TURNS - 1)
_LAGRANGE = LAGRANGE[::2]
_LAGRANGE_TURN = np.abs(_BETWEEN_TURN @ np.linalg.inv(_BASIS_TURN))


def _typical(model: Model, end: float) -> tuple[float, int]:
    """What is lost on average, roughly, and the evaluations that it took."""
    ends = np.append(np.linspace(FIRST, 0.0, 12), LAST)
    x, w = np.polynomial.legendre.leggauss(6)
    y = ends[:-1, None] + 0.5 * np.diff(ends)[:, None] * (x + 1.0)
    weight = (0.5 * np.diff(ends)[:, None] * w * area(y)).ravel()
    turn = end * (np.arange(4) + 0.5) / 4
    c, phi = np.broadcast_arrays(unfolded(y).ravel()[:, None], turn)
    value, _, used = albedos(model, c.ravel(), True, 1e-2, phi=phi.ravel())
    return max(float((weight @ value.reshape(c.shape)).mean()), 0.0), used


TABLED, TURNED = 1e-10, 1e-6
"""What tables of isotropic models, and of the others, are worth unless asked for otherwise."""


def table_of(model: Model, lost: bool, rtol: float | None = None) -> HeightTable | SurfaceTable:
    """The table of a model over all directions: of heights alone where it is isotropic."""
    if model.isotropic:
        return height_table(model, lost, TABLED if rtol is None else rtol)
    return surface_table(model, lost, TURNED if rtol is None else rtol)
