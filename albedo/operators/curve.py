"""The albedo of an isotropic model as a function of the angle, with a bound on what it says.

Chebyshev interpolants on pieces of y, which is cos_theta up to 45 degrees from grazing incidence
and sqrt(2) - sin_theta beyond: models in angles depend on sin_theta, not on its square, at normal
incidence. A piece is halved until the albedo at fresh points, between all nodes and at both ends,
confirms it: halving towards 0 grades the pieces as finely as the albedo changes at grazing
incidence. The bound holds what the fresh points showed, several times over, and the errors of the
albedos themselves.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev

from albedo._compile import kernel
from albedo.brdf import Model
from albedo.quadrature import albedo_rows

_ORDER = 16
# Between its nodes, where the fresh points stand, an interpolant errs most; in between not by more.
_TRUST = 8.0
# What errors at the nodes may come to between them: the Lebesgue constant of 16 Chebyshev nodes.
_LEBESGUE = 2.8
# Pieces are halved at most so often: at grazing incidence, float64 has no use for more.
# Length of a piece times its distance from the normal, above which cosines of nodes all differ.
_TOLD_APART = 1e-11
_DEEPEST = 64
# So many pieces tell nothing that fewer would not: their bounds are what they are.
_MOST = 2048
_EPS = np.finfo(np.float64).eps

_NODES = chebyshev.chebpts1(_ORDER)
_FRESH = chebyshev.chebpts2(_ORDER + 1)
_CHECK = chebyshev.chebvander(_FRESH, _ORDER - 1)
_MIDDLE = math.sqrt(0.5)


@dataclass(frozen=True, eq=False)
class AlbedoCurve:
    """Directional albedo of an isotropic model over the incidences, piece by piece.

    Attributes
    ----------
    edges : ndarray, shape (m + 1,)
        Ends of the pieces in y, ascending.
    coefficients : ndarray, shape (m, 16)
        Chebyshev coefficients on every piece.
    error : ndarray, shape (m,)
        Bound on the error over each piece: relative, or absolute where the curve was made so.
    evaluations : int
        Of the model, to make the curve.
    """

    edges: np.ndarray
    coefficients: np.ndarray
    error: np.ndarray
    evaluations: int

    def __call__(self, cos_theta: np.ndarray) -> np.ndarray:
        """The albedo at cosines of any shape."""
        return self.at(_folded(cos_theta))

    def at(self, y: np.ndarray) -> np.ndarray:
        """The albedo at coordinates y of any shape."""
        y = np.ascontiguousarray(y, dtype=np.float64)
        out = np.empty(y.size)
        _values(y.ravel(), self.edges, self.coefficients, out)
        return out.reshape(y.shape)

    def bound(self, cos_theta: np.ndarray | None = None) -> np.ndarray:
        """Bound on the error at cosines; the worst of all where none are given."""
        if cos_theta is None:
            return self.error.max()
        piece = np.searchsorted(self.edges, _folded(cos_theta), side="right") - 1
        return self.error[np.clip(piece, 0, self.error.size - 1)]

    def maximum(self) -> tuple[float, float]:
        """The y where the curve is largest, and its value there."""
        best = (0.0, -np.inf)
        seen = (self.coefficients @ _CHECK.T).max(1)
        for k in np.flatnonzero(seen >= 0.5 * seen.max()).tolist():
            c = self.coefficients[k]
            roots = chebyshev.chebroots(chebyshev.chebder(c))
            inside = roots.real[(np.abs(roots.imag) < 1e-8) & (np.abs(roots.real) < 1.0)]
            u = np.concatenate(([-1.0, 1.0], inside))
            values = chebyshev.chebval(u, c)
            i = int(np.argmax(values))
            if values[i] > best[1]:
                low, high = self.edges[k : k + 2]
                best = (float(low + 0.5 * (u[i] + 1.0) * (high - low)), float(values[i]))
        return best


def _folded(cos_theta: np.ndarray) -> np.ndarray:
    """The coordinate y of directions."""
    c = np.asarray(cos_theta, dtype=np.float64)
    return np.where(
        c <= _MIDDLE, c, 2.0 * _MIDDLE - np.sqrt(np.maximum((1.0 - c) * (1.0 + c), 0.0))
    )


def _unfolded(y: np.ndarray) -> np.ndarray:
    """The cosine of the angle of incidence at y."""
    s = np.clip(2.0 * _MIDDLE - y, 0.0, 1.0)
    return np.where(y <= _MIDDLE, y, np.sqrt((1.0 - s) * (1.0 + s)))


@kernel
def _values(x, edges, coefficients, out):
    """Clenshaw's sum on the piece that holds each x."""
    for i in range(x.size):
        low, high = 0, edges.size - 1
        while high - low > 1:
            middle = (low + high) // 2
            if edges[middle] <= x[i]:
                low = middle
            else:
                high = middle
        a, b = edges[low], edges[low + 1]
        u = ((x[i] - a) - (b - x[i])) / (b - a)
        last = before = 0.0
        for k in range(coefficients.shape[1] - 1, 0, -1):
            last, before = 2.0 * u * last - before + coefficients[low, k], last
        out[i] = u * last - before + coefficients[low, 0]


# Of the curves that were made last, by model and by what was asked for.
_KEPT = 512
_Key = tuple[Model, float, float | None, float, float]
_kept: dict[_Key, AlbedoCurve] = {}


def albedo_curve(
    model: Model,
    rtol: float = 4e-13,
    *,
    atol: float | None = None,
    first: float = 0.0,
    last: float = 2.0 * _MIDDLE,
) -> AlbedoCurve:
    """Tabulate the directional albedo of an isotropic model, so finely that a bound holds.

    Parameters
    ----------
    model : Model
        Isotropic, with a finite albedo at grazing incidence.
    rtol : float
        The relative error asked for, everywhere.
    atol : float, optional
        The absolute error asked for instead.
    first, last : float
        Ends of the interval of y; all of it by default.

    Returns
    -------
    AlbedoCurve
        With the bounds that were reached, which are larger than asked for where the albedo itself
        could not be had as precisely.
    """
    return albedo_curves([model], rtol, atol=atol, first=first, last=last)[0]


def albedo_curves(
    models: Sequence[Model],
    rtol: float = 4e-13,
    *,
    atol: float | None = None,
    first: float = 0.0,
    last: float = 2.0 * _MIDDLE,
) -> list[AlbedoCurve]:
    """The curves of several models, made side by side; those made lately are kept.

    Parameters
    ----------
    models : sequence of Model
    rtol, atol, first, last
        As in `albedo_curve`.

    Returns
    -------
    list of AlbedoCurve
    """
    keys = [(model, rtol, atol, first, last) for model in models]
    found = {key: _kept[key] for key in keys if key in _kept}
    missing = [key for key in dict.fromkeys(keys) if key not in found]
    if missing:
        made = _made([key[0] for key in missing], rtol, atol, first, last)
        found.update(zip(missing, made, strict=True))
    for key, curve in found.items():
        # The oldest goes first.
        _kept.pop(key, None)
        _kept[key] = curve
    for key in list(itertools.islice(_kept, max(len(_kept) - _KEPT, 0))):
        _kept.pop(key, None)
    return [found[key] for key in keys]


def _made(
    models: list[Model], rtol: float, atol: float | None, first: float, last: float
) -> list[AlbedoCurve]:
    """The curves of different models."""
    absolute = atol is not None
    goal = rtol if atol is None else atol
    inner = {"rtol": max(0.1 * rtol, 4e-14), "atol": 0.0}
    if absolute:
        inner = {"rtol": 0.0, "atol": 0.1 * goal}
    count = len(models)
    pieces: list[list[tuple[float, float, np.ndarray, float]]] = [[] for _ in models]
    inside = [_MIDDLE] if first < _MIDDLE < last else []
    start = list(itertools.pairwise([first, *inside, last]))
    # Of every piece: whose it is, and its ends.
    active = [(k, *ends) for k in range(count) for ends in start]
    seen_before = np.full(len(active), np.inf)
    used = np.zeros(count, dtype=int)
    for depth in range(_DEEPEST + 1):
        owner = np.array([piece[0] for piece in active])
        ends = np.array([piece[1:] for piece in active])
        low, size = ends[:, :1], np.diff(ends, axis=1)
        y = low + 0.5 * (np.concatenate((_NODES, _FRESH)) + 1.0) * size
        # Both ends as they are, where what was added and subtracted may not return.
        y[:, _ORDER], y[:, -1] = ends[:, 0], ends[:, 1]
        x = _unfolded(y)
        # Cosines are rounded: near 1 they stand for another angle.
        basis = chebyshev.chebvander(2.0 * (_folded(x) - low) / size - 1.0, _ORDER - 1)
        found = albedo_rows(
            *([models[k] for k in np.repeat(owner, x.shape[1])], x.ravel(), np.zeros(x.size)),
            rtol=inner["rtol"],
            atol=inner["atol"],
            shared=True,
        )
        used += np.bincount(
            owner, weights=found.evaluations.reshape(x.shape).sum(1), minlength=count
        ).astype(int)
        value, error = found.value.reshape(x.shape), found.error.reshape(x.shape)
        unit = np.ones_like(value) if absolute else np.maximum(np.abs(value), 1e-300)
        own = (error / unit).max(1)
        coefficients = np.linalg.solve(basis[:, :_ORDER], value[:, :_ORDER, None])
        missed = np.abs((basis @ coefficients)[:, :, 0] - value) / unit
        seen = missed.max(1)
        rounding = _ORDER * _EPS * (np.abs(value) / unit).max(1)
        bound = _TRUST * seen + _LEBESGUE * own + rounding
        # What may be due to the errors of the albedos, and did not fall by halving, will not fall.
        noise = (1.0 + _LEBESGUE) * own + rounding
        stuck = (seen <= own) | ((seen <= noise) & (seen > 0.1 * seen_before))
        # Next to the normal cosines are too coarse for the nodes of a half.
        far = np.where(ends[:, 1] > _MIDDLE, 2.0 * _MIDDLE - ends[:, 0], 1.0)
        done = (bound <= goal) | stuck | (0.25 * far * size[:, 0] < _TOLD_APART)
        held = np.array([len(own_pieces) for own_pieces in pieces])
        full = held + 2 * np.bincount(owner, minlength=count) > _MOST
        done |= full[owner] | (depth == _DEEPEST)
        for k in np.flatnonzero(done).tolist():
            whose, begin, end = active[k]
            pieces[whose].append((begin, end, coefficients[k, :, 0], float(bound[k])))
        halves: list[tuple[int, float, float]] = []
        for k in np.flatnonzero(~done).tolist():
            whose, begin, end = active[k]
            middle = 0.5 * (begin + end)
            halves += (whose, begin, middle), (whose, middle, end)
        active = halves
        seen_before = np.repeat(seen[~done], 2)
        if not active:
            break
    curves = []
    for own_pieces, evaluations in zip(pieces, used.tolist(), strict=True):
        own_pieces.sort(key=lambda piece: piece[0])
        curves.append(
            AlbedoCurve(
                np.array([piece[0] for piece in own_pieces] + [last]),
                np.array([piece[2] for piece in own_pieces]),
                np.array([piece[3] for piece in own_pieces]),
                evaluations,
            )
        )
    return curves
