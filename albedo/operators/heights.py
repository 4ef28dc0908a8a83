"""An albedo, or what it leaves of 1, as a function of the height, with a bound on what it says.

Chebyshev series on pieces of y (`albedo.charts.heights`), halved until fresh points between their
nodes confirm them. What a sharp lobe loses is small everywhere, and smaller towards the horizon:
so errors are relative to the value, as far as the value itself is known so well. On every piece

    |error| <= bound * max(value, floor),

where the floor is the least value, unless that lies so far below the rest of the piece, or so near
to the errors of the albedos, that no share of it can be told.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.polynomial import chebyshev

from albedo._compile import inlined, kernel
from albedo.brdf import Model
from albedo.charts.heights import FIRST, LAST, LOWEST, area, fold, folded, unfolded
from albedo.errors import InputError
from albedo.quadrature import albedo_rows

_ORDER = 16
# Between its nodes, where the fresh points stand, an interpolant errs most; in between not by more.
TRUST = 8.0
# Pieces in the logarithm begin with this many e-folds; in angles they are not cut below an arc
# whose cosines float64 can tell apart.
FOLDS, SHORTEST = 4.0, 1e-5
_MOST = 1024
# What is smaller than this share of the average, or of the largest value of a piece, may have a
# larger relative error: no albedo would show it.
DEEP = 1e-6
# Evaluations of one albedo: towards grazing incidence rounding is what remains, and more of them
# do not help.
_LIMIT = 60_000
# Errors of the albedos may take this share of the bound that is asked for.
NOISE = 1.0 / 40.0
# The error asked of an albedo that is subtracted from 1.
_SUBTRACTED = 1e-13
_TINY = 1e-300
_EPS = np.finfo(np.float64).eps

_NODES = chebyshev.chebpts1(_ORDER)
_FRESH = chebyshev.chebpts2(_ORDER + 1)
_RULE = np.polynomial.legendre.leggauss(40)
# Places between the nodes, and the moduli of Lagrange's polynomials there.
_BETWEEN = chebyshev.chebvander(np.linspace(-1.0, 1.0, 65), _ORDER - 1)
LAGRANGE = np.abs(_BETWEEN @ np.linalg.inv(chebyshev.chebvander(_NODES, _ORDER - 1)))


@inlined
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
def _fill_rows(x, y, z, edges, coefficients, out):
    """Fill values of a table for unit vectors, three flat arrays."""
    for i in range(z.size):
        out[i] = table_at(fold(z[i], math.hypot(x[i], y[i])), edges, coefficients)


@dataclass(frozen=True, eq=False)
class HeightTable:
    """A function of the height, not below 0, piece by piece.

    Attributes
    ----------
    ends : ndarray, shape (m + 1,)
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

    ends: np.ndarray
    coefficients: np.ndarray
    error: np.ndarray
    floor: np.ndarray
    below: float
    evaluations: int

    def fill(self, v: np.ndarray, out: np.ndarray) -> None:
        """Fill values for unit vectors (3, ...)."""
        x, y, z = (np.ascontiguousarray(component).ravel() for component in v)
        _fill_rows(x, y, z, self.ends, self.coefficients, out.reshape(-1))

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
        """Ends of the pieces in y."""
        return tuple(self.ends.tolist())

    @property
    def turns(self) -> tuple[float, ...]:
        """No azimuth is told from another."""
        return 0.0, 2.0 * math.pi

    def __call__(self, cos_theta: np.ndarray) -> np.ndarray:
        """Values at cosines of any shape."""
        return self.at(folded(np.asarray(cos_theta, dtype=np.float64)))

    def at(self, y: np.ndarray) -> np.ndarray:
        """Values at coordinates y of any shape."""
        y = np.ascontiguousarray(y, dtype=np.float64)
        out = np.empty(y.size)
        _table_all(y.ravel(), self.ends, self.coefficients, out)
        return out.reshape(y.shape)

    def bound(self, cos_theta: np.ndarray) -> np.ndarray:
        """Bounds on the errors of the values at cosines."""
        c = np.asarray(cos_theta, dtype=np.float64)
        y = folded(c)
        piece = np.clip(np.searchsorted(self.ends, y, side="right") - 1, 0, self.error.size - 1)
        known = self.error[piece] * np.maximum(self.at(y), self.floor[piece])
        return known + np.where(c < LOWEST, self.below, 0.0)

    def relative(self, cos_theta: np.ndarray | None = None) -> np.ndarray:
        """Bounds relative to the values at cosines; the worst of all where none are given.

        The worst is that of all heights above `LOWEST`.
        """
        if cos_theta is None:
            y = self.ends[:-1, None] + np.diff(self.ends)[:, None] * np.linspace(0.0, 1.0, 33)
            least = self.at(y).min(1)
            return (self.error * np.maximum(1.0, self.floor / least)).max()
        return self.bound(cos_theta) / self(cos_theta)

    @cached_property
    def average(self) -> tuple[float, float]:
        r"""2 \int value mu dmu over all heights, and a bound on its error."""
        low, size = self.ends[:-1, None], np.diff(self.ends)[:, None]
        y = low + 0.5 * size * (_RULE[0] + 1.0)
        pieces = (0.5 * size * _RULE[1] * area(y) * self.at(y)).sum(1)
        c = unfolded(self.ends)
        share = np.diff(c * c)
        error = float((self.error * (pieces + self.floor * share)).sum())
        # Below, no more light arrives than LOWEST^2.
        left = LOWEST**2 * min(self.below + float(self.at(self.ends[:1])[0]), 1.0)
        total = float(pieces.sum())
        return total, error + left + 64.0 * _EPS * total


def albedos(
    model: Model,
    c: np.ndarray,
    lost: bool,
    rtol: float,
    typical: float = 0.0,
    phi: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, int]:
    """Values and errors of the albedo, or of what it leaves, at flat cosines and azimuths.

    `rtol` is that of a table, and `typical` what is lost on average.
    """
    parts = model.parts()
    direct = lost and len(parts) == 1 and parts[0].loss is not None
    doubts = [float(p.doubt(None) if callable(p.doubt) else p.doubt) for p in parts]
    # What is asked for need not be better than what the numbers of the model are worth.
    worst = max((d for d in doubts if d < 1e-3), default=0.0)
    turn = np.zeros(c.size) if phi is None else phi
    relative, absolute = max(0.1 * rtol, 1e-13), 0.1 * rtol * DEEP * typical
    if lost and not direct:
        least = _SUBTRACTED
        if phi is not None:
            # Over azimuths as well, there are too many to have each as well as can be.
            least = max(least, 0.02 * rtol * typical)
        if rtol > 1e-3:
            least = 1e-6 * rtol
        relative, absolute = 0.0, max(least, 0.1 * worst)
    value, error, used = _found(model, c, turn, lost, relative, absolute)
    for loose in (1e2, 1e4):
        # An interval that the evaluations did not suffice for is wider than one that is asked for.
        goal = np.maximum(absolute, (relative + 3.0 * worst) * np.abs(value))
        poor = np.flatnonzero(~(error <= loose * goal))
        if poor.size:
            again, wide, more = _found(
                model, c[poor], turn[poor], lost, min(loose * relative, 0.1), loose * absolute
            )
            better = ~(error[poor] <= wide)
            value[poor[better]], error[poor[better]] = again[better], wide[better]
            used += more
    poor = np.flatnonzero(~np.isfinite(value))
    if lost and poor.size:
        again, wide, more = _found(model, c[poor], turn[poor], False, 1e-10, 0.0)
        value[poor], error[poor] = 1.0 - again, wide + _EPS
        used += more
    return value, error, used


def _found(
    model: Model, c: np.ndarray, phi: np.ndarray, lost: bool, rtol: float, atol: float
) -> tuple[np.ndarray, np.ndarray, int]:
    """Values and errors of rows, and the evaluations that they took."""
    found = albedo_rows(
        *([model] * c.size, c, phi),
        rtol=rtol,
        atol=atol,
        complement=lost,
        max_evaluations=None if model.resolved_width is not None else _LIMIT,
    )
    return found.value.copy(), found.error.copy(), int(found.evaluations.sum())


def refuse(model: Model, c: np.ndarray, value: np.ndarray, error: np.ndarray, lost: bool) -> None:
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


def refuse_unlimited(model: Model) -> None:
    """Raise for an albedo that grows without limit."""
    if not model.grazing_limit:
        raise InputError(
            f"the albedo of {model.spec} exceeds 1, and grows without limit, towards grazing "
            "incidence; nothing is lost there that could be sent on"
        )


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
    if lost:
        refuse_unlimited(model)
    start = np.linspace(FIRST, 0.0, 1 + math.ceil(-FIRST / FOLDS)).tolist()
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
        value, error, count = albedos(model, c.ravel(), lost, rtol, typical)
        used += count
        refuse(model, c.ravel(), value, error, lost)
        value, error = value.reshape(c.shape), error.reshape(c.shape)
        # Cosines are rounded: near 1 they stand for another angle.
        basis = chebyshev.chebvander(2.0 * (folded(c) - low) / size - 1.0, _ORDER - 1)
        coefficients = np.linalg.solve(basis[:, :_ORDER], value[:, :_ORDER, None])
        modulus = np.abs(value)
        # Between the nodes as well: a value may fall to next to nothing there.
        between = np.abs(_BETWEEN @ coefficients)[:, :, 0]
        # Errors that are a share of each value are in the bound that is relative.
        above = np.maximum(error - 0.15 * rtol * modulus, 0.0).max(1)
        floor = np.maximum(DEEP * np.maximum(modulus.max(1), typical), above / (NOISE * rtol))
        floor = np.maximum(np.maximum(floor, between.min(1)), _TINY)
        unit = np.maximum(modulus, floor[:, None])
        missed = np.abs((basis @ coefficients)[:, :, 0] - value).max(1) / floor
        # What errors at the nodes may come to between them, and those that hide what was missed.
        noise = (error[:, :_ORDER] @ LAGRANGE.T) / np.maximum(between, floor[:, None])
        own = noise.max(1) + (error / unit)[:, _ORDER:].max(1)
        bound = TRUST * missed + own + 64.0 * _EPS * modulus.max(1) / floor
        done = (bound <= rtol) | (size[:, 0] < SHORTEST)
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
        below_lowest(model, lost, rtol),
        used,
    )


def _typical(model: Model) -> tuple[float, int]:
    """What is lost on average, roughly, and the evaluations that it took."""
    ends = np.append(np.linspace(FIRST, 0.0, 12), LAST)
    x, w = np.polynomial.legendre.leggauss(6)
    y = ends[:-1, None] + 0.5 * np.diff(ends)[:, None] * (x + 1.0)
    weight = 0.5 * np.diff(ends)[:, None] * w * area(y)
    value, _, used = albedos(model, unfolded(y).ravel(), True, 1e-2)
    return max(float(weight.ravel() @ value), 0.0), used


def below_lowest(model: Model, lost: bool, rtol: float, phi: float = 0.0) -> float:
    """How far the values below `LOWEST` may lie from the one there."""
    if not model.grazing_limit:
        return math.inf
    places = np.array([LOWEST, 0.0])
    value, error, _ = albedos(model, places, lost, rtol, phi=np.full(2, phi))
    return float(abs(value[0] - value[1]) + error.sum())
