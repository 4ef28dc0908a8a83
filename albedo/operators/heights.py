"""An albedo, or what it leaves of 1, as a function of the height, with a bound on what it says.

Chebyshev series on pieces of y (`albedo.charts.heights`), halved until fresh points between their
nodes confirm them. What a sharp lobe loses is small everywhere, and smaller towards the horizon:
so errors are relative to the value, as far as the value itself is known so well. On every piece

    |error| <= bound * max(value, floor),

where the floor is what lies so far below the rest of the piece, or so near to the errors of the
albedos, that no share of it can be told.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev

from albedo._compile import kernel
from albedo.brdf import Model
from albedo.charts.heights import FIRST, LAST, LOWEST, area, fold, folded, unfolded
from albedo.errors import InputError
from albedo.quadrature import albedo_rows

_ORDER = 16
# Between its nodes, where the fresh points stand, an interpolant errs most; in between not by more.
_TRUST = 8.0
# What errors at the nodes may come to between them: the Lebesgue constant of 16 Chebyshev nodes.
_LEBESGUE = 2.8
# Pieces in the logarithm begin with this many e-folds; in angles they are not cut below an arc
# whose cosines float64 can tell apart.
_FOLDS, _SHORTEST = 4.0, 1e-5
_MOST = 1024
# What is smaller than this share of the average, or of the largest value of a piece, may have a
# larger relative error: no albedo would show it.
_DEEP = 1e-6
# Evaluations of one albedo: towards grazing incidence rounding is what remains, and more of them
# do not help.
_LIMIT = 60_000
# Errors of the albedos may take this share of the bound that is asked for.
_NOISE = 1.0 / 40.0
# The error asked of an albedo that is subtracted from 1.
_SUBTRACTED = 1e-13
_TINY = 1e-300
_EPS = np.finfo(np.float64).eps

_NODES = chebyshev.chebpts1(_ORDER)
_FRESH = chebyshev.chebpts2(_ORDER + 1)
_RULE = np.polynomial.legendre.leggauss(40)


@kernel
def table_at(y, edges, coefficients):
    """Clenshaw's sum on the piece that holds y; never less than 1e-300."""
    low, high = 0, edges.size - 1
    while high - low > 1:
        middle = (low + high) // 2
        if edges[middle] <= y:
            low = middle
        else:
            high = middle
    a, b = edges[low], edges[low + 1]
    y = min(max(y, a), b)
    u = ((y - a) - (b - y)) / (b - a)
    last = before = 0.0
    for k in range(coefficients.shape[1] - 1, 0, -1):
        last, before = 2.0 * u * last - before + coefficients[low, k], last
    return max(u * last - before + coefficients[low, 0], 1e-300)


@kernel
def _table_all(y, edges, coefficients, out):
    for i in range(y.size):
        out[i] = table_at(y[i], edges, coefficients)


@kernel
def fill_rows(x, y, z, edges, coefficients, out):
    """Fill values of a table for unit vectors, three flat arrays."""
    for i in range(z.size):
        out[i] = table_at(fold(z[i], math.hypot(x[i], y[i])), edges, coefficients)


@dataclass(frozen=True, eq=False)
class HeightTable:
    """A function of the height, not below 0, piece by piece.

    Attributes
    ----------
    edges : ndarray, shape (m + 1,)
        Ends of the pieces in y, ascending.
    coefficients : ndarray, shape (m, 16)
        Chebyshev coefficients on every piece.
    error, floor : ndarray, shape (m,)
        The error on a piece is at most ``error * max(value, floor)``.
    below : float
        What is added to the error below `LOWEST`, where the value is taken for the one there.
    evaluations : int
        Of the model, to make the table.
    """

    edges: np.ndarray
    coefficients: np.ndarray
    error: np.ndarray
    floor: np.ndarray
    below: float
    evaluations: int

    def __call__(self, cos_theta: np.ndarray) -> np.ndarray:
        """Values at cosines of any shape."""
        return self.at(folded(np.asarray(cos_theta, dtype=np.float64)))

    def at(self, y: np.ndarray) -> np.ndarray:
        """Values at coordinates y of any shape."""
        y = np.ascontiguousarray(y, dtype=np.float64)
        out = np.empty(y.size)
        _table_all(y.ravel(), self.edges, self.coefficients, out)
        return out.reshape(y.shape)

    def bound(self, cos_theta: np.ndarray) -> np.ndarray:
        """Bounds on the errors of the values at cosines."""
        c = np.asarray(cos_theta, dtype=np.float64)
        y = folded(c)
        piece = np.clip(np.searchsorted(self.edges, y, side="right") - 1, 0, self.error.size - 1)
        known = self.error[piece] * np.maximum(self.at(y), self.floor[piece])
        return known + np.where(c < LOWEST, self.below, 0.0)

    def relative(self, cos_theta: np.ndarray | None = None) -> np.ndarray:
        """Bounds relative to the values at cosines; the worst of all where none are given.

        The worst is that of all heights above `LOWEST`.
        """
        if cos_theta is None:
            y = self.edges[:-1, None] + np.diff(self.edges)[:, None] * np.linspace(0.0, 1.0, 33)
            least = self.at(y).min(1)
            return (self.error * np.maximum(1.0, self.floor / least)).max()
        return self.bound(cos_theta) / self(cos_theta)

    @cached_property
    def average(self) -> tuple[float, float]:
        r"""2 \int value mu dmu over all heights, and a bound on its error."""
        low, size = self.edges[:-1, None], np.diff(self.edges)[:, None]
        y = low + 0.5 * size * (_RULE[0] + 1.0)
        pieces = (0.5 * size * _RULE[1] * area(y) * self.at(y)).sum(1)
        c = unfolded(self.edges)
        share = np.diff(c * c)
        error = float((self.error * (pieces + self.floor * share)).sum())
        # Below, no more light arrives than LOWEST^2.
        left = LOWEST**2 * min(self.below + float(self.at(self.edges[:1])[0]), 1.0)
        total = float(pieces.sum())
        return total, error + left + 64.0 * _EPS * total


def _albedos(
    model: Model, c: np.ndarray, lost: bool, rtol: float, typical: float = 0.0
) -> tuple[np.ndarray, np.ndarray, int]:
    """Values and errors of the albedo, or of what it leaves, at flat cosines."""
    parts = model.parts()
    options: dict[str, Any] = {"rtol": max(0.1 * rtol, 1e-13), "atol": 0.1 * rtol * _DEEP * typical}
    if lost and not (len(parts) == 1 and parts[0].loss is not None):
        # What is subtracted need not be better than what its numbers are worth.
        doubts = [float(p.doubt(None) if callable(p.doubt) else p.doubt) for p in parts]
        worst = max((d for d in doubts if d < 1e-3), default=0.0)
        options = {"rtol": 0.0, "atol": max(_SUBTRACTED, 0.1 * worst)}
    limit = None if model.resolved_width is not None else _LIMIT
    found = albedo_rows(
        *([model] * c.size, c, np.zeros(c.size)),
        complement=lost,
        max_evaluations=limit,
        **options,
    )
    return found.value, found.error, int(found.evaluations.sum())


def _refuse(model: Model, c: np.ndarray, value: np.ndarray, error: np.ndarray, lost: bool) -> None:
    """Raise where a table would have no sense."""
    bad = ~(np.isfinite(value) & np.isfinite(error))
    if bad.any():
        where = f"{c[bad].flat[0]:.3g}"
        raise InputError(f"the albedo of {model.spec} at cos_theta = {where} has no bound")
    wrong = value < -error if lost else value <= error
    if wrong.any():
        k = int(np.argmin(np.where(wrong, value, np.inf)))
        where = f"at cos_theta = {c.flat[k]:.3g}"
        if lost:
            raise InputError(
                f"the albedo of {model.spec} is {1.0 - value.flat[k]:.6g} {where}; nothing is "
                "lost there that could be sent on"
            )
        raise InputError(f"the albedo of {model.spec} is not above 0 {where}")


@lru_cache(maxsize=512)
def height_table(model: Model, lost: bool = False, rtol: float = 1e-10) -> HeightTable:
    """Tabulate the albedo of an isotropic model, or 1 - albedo, over all heights.

    Parameters
    ----------
    model : Model
        Isotropic, without channels. Its albedo is above 0 where that is tabulated, and not above
        1 where `lost`.
    lost : bool
        Tabulate 1 - albedo.
    rtol : float
        The relative error asked for.

    Returns
    -------
    HeightTable
        With the bounds that were reached.

    Raises
    ------
    InputError
        For an albedo above 1, or not above 0.
    """
    if lost and not model.grazing_limit:
        raise InputError(
            f"the albedo of {model.spec} exceeds 1, and grows without limit, towards grazing "
            "incidence; nothing is lost there that could be sent on"
        )
    start = np.linspace(FIRST, 0.0, 1 + math.ceil(-FIRST / _FOLDS)).tolist()
    active = list(itertools.pairwise([*start, LAST]))
    pieces: list[tuple[float, float, np.ndarray, float, float]] = []
    # An albedo itself is had to any share of it, where what is left of 1 is not.
    typical, used = _typical(model) if lost else (0.0, 0)
    while active:
        ends = np.array(active)
        low, size = ends[:, :1], np.diff(ends, axis=1)
        y = low + 0.5 * (np.concatenate((_NODES, _FRESH)) + 1.0) * size
        y[:, _ORDER], y[:, -1] = ends[:, 0], ends[:, 1]
        c = np.clip(unfolded(y), LOWEST, 1.0)
        value, error, count = _albedos(model, c.ravel(), lost, rtol, typical)
        used += count
        _refuse(model, c.ravel(), value, error, lost)
        value, error = value.reshape(c.shape), error.reshape(c.shape)
        # Cosines are rounded: near 1 they stand for another angle.
        basis = chebyshev.chebvander(2.0 * (folded(c) - low) / size - 1.0, _ORDER - 1)
        coefficients = np.linalg.solve(basis[:, :_ORDER], value[:, :_ORDER, None])
        modulus = np.abs(value)
        # Errors that are a share of each value are in the bound that is relative.
        above = np.maximum(error - 0.15 * rtol * modulus, 0.0).max(1)
        floor = np.maximum(_DEEP * np.maximum(modulus.max(1), typical), above / (_NOISE * rtol))
        floor = np.maximum(floor, _TINY)
        unit = np.maximum(modulus, floor[:, None])
        missed = (np.abs((basis @ coefficients)[:, :, 0] - value) / unit).max(1)
        own = (error / unit).max(1)
        bound = _TRUST * missed + _LEBESGUE * own + 64.0 * _EPS * (modulus / unit).max(1)
        done = (bound <= rtol) | (size[:, 0] < _SHORTEST)
        if len(pieces) + 2 * len(active) > _MOST:
            done[:] = True
        pieces += [
            (*active[k], coefficients[k, :, 0], float(bound[k]), float(floor[k]))
            for k in np.flatnonzero(done).tolist()
        ]
        halves: list[tuple[float, float]] = []
        for k in np.flatnonzero(~done).tolist():
            first, last = active[k]
            halves += itertools.pairwise((first, 0.5 * (first + last), last))
        active = halves
    pieces.sort(key=lambda piece: piece[0])
    return HeightTable(
        np.array([piece[0] for piece in pieces] + [LAST]),
        np.array([piece[2] for piece in pieces]),
        np.array([piece[3] for piece in pieces]),
        np.array([piece[4] for piece in pieces]),
        _below(model, lost, rtol),
        used,
    )


def _typical(model: Model) -> tuple[float, int]:
    """What is lost on average, roughly, and the evaluations that it took."""
    ends = np.append(np.linspace(FIRST, 0.0, 12), LAST)
    x, w = np.polynomial.legendre.leggauss(6)
    y = ends[:-1, None] + 0.5 * np.diff(ends)[:, None] * (x + 1.0)
    weight = 0.5 * np.diff(ends)[:, None] * w * area(y)
    value, _, used = _albedos(model, unfolded(y).ravel(), True, 1e-2)
    return max(float(weight.ravel() @ value), 0.0), used


def _below(model: Model, lost: bool, rtol: float) -> float:
    """How far the values below `LOWEST` may lie from the one there."""
    if not model.grazing_limit:
        return math.inf
    value, error, _ = _albedos(model, np.array([LOWEST, 0.0]), lost, rtol)
    return float(abs(value[0] - value[1]) + error.sum())
