"""Chart for what knows V's height and nothing else but its azimuth, on given pieces of both.

The coordinate of heights is y: log(2 n.v) up to 30 degrees above the horizon, in which a layer is
as wide as any other, however thin it is, and pi/3 - theta beyond, because models in angles depend
on theta at normal incidence. Panels end where the pieces of a table end.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from albedo._compile import inlined, kernel
from albedo.charts._compiled import Kernel
from albedo.charts.cosine import CosineChart

LOWEST = 2.0**-64
"""Below this cosine a height is taken for this one."""

FIRST, LAST = math.log(2.0 * LOWEST), math.pi / 3.0
_LOG_2 = math.log(2.0)
# ln(x/sin x) is a series in x^2, of which these terms leave out 3e-17 up to pi/6.
_OF_SINE = np.array(
    (
        *(1.0 / 6.0, 1.0 / 180.0, 1.0 / 2835.0, 1.0 / 37800.0, 1.0 / 467775.0),
        *(691.0 / 3831077250.0, 2.0 / 127702575.0, 3617.0 / 2605132530000.0),
        43867.0 / 350813659321125.0,
    )
)


@kernel
def fold(c, s):
    """The coordinate y of a direction, from cosine and sine of its polar angle."""
    if c <= 0.5:
        return math.log(2.0 * max(c, LOWEST))
    return LAST - math.atan(s / c)


@kernel
def fold_vector(x, y, z):
    """The coordinate y of a unit vector; its tangential part is read only where it matters."""
    if z <= 0.5:
        return math.log(2.0 * max(z, LOWEST))
    return LAST - math.atan(math.sqrt(x * x + y * y) / z)


@kernel
def fold_elevation(e):
    """The coordinate y of an elevation above the horizon."""
    if e <= math.pi / 6.0:
        return math.log(2.0 * max(math.sin(e), LOWEST))
    return LAST - (0.5 * math.pi - e)


@inlined
def fold_elevations(e, y):
    """Fill the coordinates of many elevations, see `fold_elevation`."""
    for i in range(e.size):
        square, total = e[i] * e[i], 0.0
        for k in range(_OF_SINE.size - 1, -1, -1):
            total = (total + _OF_SINE[k]) * square
        y[i] = total
    for i in range(e.size):
        if e[i] <= math.pi / 6.0:
            y[i] = math.log(2.0 * max(e[i], LOWEST)) - y[i]
        else:
            y[i] = LAST - (0.5 * math.pi - e[i])


@kernel
def elevation_at(y):
    """The elevation above the horizon at y."""
    if y <= 0.0:
        return math.asin(0.5 * math.exp(y))
    return 0.5 * math.pi - (LAST - y)


@kernel
def log_height(y):
    """The logarithm of n.v at y."""
    if y <= 0.0:
        return y - _LOG_2
    return math.log(math.cos(LAST - y))


@kernel
def unfold(y):
    """Cosine and sine of the polar angle at y."""
    if y <= 0.0:
        c = 0.5 * math.exp(y)
        return c, math.sqrt((1.0 - c) * (1.0 + c))
    return math.cos(LAST - y), math.sin(LAST - y)


@kernel
def _fold_all(c, s, y):
    for i in range(c.size):
        y[i] = fold(c[i], s[i])


@kernel
def _fold_cosines(c, y):
    for i in range(c.size):
        y[i] = fold(c[i], math.sqrt(max((1.0 - c[i]) * (1.0 + c[i]), 0.0)))


def folded(c: np.ndarray, s: np.ndarray | None = None) -> np.ndarray:
    """The coordinate y of cosines of any shape, and of sines where they are known better."""
    c = np.asarray(c, dtype=np.float64)
    flat, y = np.ascontiguousarray(c).ravel(), np.empty(c.size)
    if s is None:
        _fold_cosines(flat, y)
    else:
        _fold_all(flat, np.ascontiguousarray(s).ravel(), y)
    return y.reshape(c.shape)


def unfolded(y: np.ndarray) -> np.ndarray:
    """The cosine at y."""
    return np.where(y <= 0.0, 0.5 * np.exp(np.minimum(y, 0.0)), np.cos(LAST - np.maximum(y, 0.0)))


def area(y: np.ndarray) -> np.ndarray:
    """2 mu dmu/dy, the share of what comes evenly from everywhere in dy."""
    c = unfolded(y)
    theta = LAST - np.maximum(y, 0.0)
    return np.where(y <= 0.0, 2.0 * c * c, np.sin(2.0 * theta))


@dataclass(frozen=True)
class HeightsChart(CosineChart):
    """The hemisphere in (azimuth, y).

    Parameters
    ----------
    edges : tuple of float
        Ends of the panels in y, ascending, with 0 among them.
    turns : tuple of float
        Ends of the panels in azimuth, from 0 to 2 pi; for what depends on the height alone they
        are not needed.
    """

    edges: tuple[float, ...] = (FIRST, 0.0, LAST)
    turns: tuple[float, ...] = (0.0, 2.0 * math.pi)

    def panels(
        self,
        cos_theta: np.ndarray,
        phi: np.ndarray,
        widths: np.ndarray,
        isotropic: bool,
        coarse: bool = False,
        fine: bool = False,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Panels of every row; see `albedo.charts.polar.PolarChart.panels`."""
        c = cos_theta
        s = np.sqrt((1 - c) * (1 + c))
        geometry = np.column_stack((c, s, np.cos(phi), np.sin(phi)))
        edges = (FIRST, 0.0, LAST) if coarse else self.edges
        turns = (0.0, 2.0 * math.pi) if coarse else self.turns
        one = [
            (u0, u1, v0, v1)
            for u0, u1 in itertools.pairwise(turns)
            for v0, v1 in itertools.pairwise(edges)
        ]
        code = np.zeros((len(one) * c.size, 4), dtype=np.int64)
        # Neither panel is the core of a lobe.
        code[:, 1] = 1
        return geometry, np.repeat(np.arange(c.size), len(one)), code, np.tile(one, (c.size, 1))

    @property
    def layout(self) -> tuple[Kernel, np.ndarray]:
        """See `albedo.charts._compiled.CompiledChart`."""
        return _nodes, np.zeros(1)


@kernel
def _nodes(geometry, code, box, u, v, numbers, wi, wo, h, weight):
    for k in range(box.shape[0]):
        c, s, cos_phi, sin_phi = geometry[k, 0], geometry[k, 1], geometry[k, 2], geometry[k, 3]
        wi[0, k] = s * cos_phi
        wi[1, k] = s * sin_phi
        wi[2, k] = c
        u0, u1, v0, v1 = box[k, 0], box[k, 1], box[k, 2], box[k, 3]
        for iv in range(v.size):
            y = v0 + (v1 - v0) * v[iv]
            if y <= 0.0:
                mu = 0.5 * math.exp(y)
                sin_v = math.sqrt((1.0 - mu) * (1.0 + mu))
                slope = mu
            else:
                mu, sin_v = math.cos(LAST - y), math.sin(LAST - y)
                slope = sin_v
            for iu in range(u.size):
                # Absolute, because tables do not turn with the light.
                psi = u0 + (u1 - u0) * u[iu]
                i = iu * v.size + iv
                wo[0, k, i] = sin_v * math.cos(psi)
                wo[1, k, i] = sin_v * math.sin(psi)
                wo[2, k, i] = mu
                h[0, k, i] = wo[0, k, i] + wi[0, k]
                h[1, k, i] = wo[1, k, i] + wi[1, k]
                h[2, k, i] = mu + c
                weight[k, i] = mu * slope * (u1 - u0) * (v1 - v0)
