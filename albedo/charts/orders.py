r"""Tangential components of V about the orders of a grating, for lobes that are Gaussian in them.

Order n stands at x_n = -l.x + n g, y_0 = -l.y in the plane of (v.x, v.y), on which the hemisphere
is the unit disk and n.v dV = dx dy. With x = x_n + xi and y = y_0 + eta, (n.v)^2 has no difference
of squares that cancels:

    (n.v)^2 = (n.l)^2 + n g (2 l.x - n g) + eta (2 l.y - eta) - xi (2 x_n + xi).

Near the horizon n.v is a root. There s measures the distance from the edge of the chord, s^2 =
cos(b) - |x| with sin(b) = y, so that n.v = s sqrt(2 cos(b) - s^2); likewise r^2 = 1 - |y| where the
chord itself ends. At grazing incidence lobes have a layer n.v ~ n.l, and both are stretched as
n.l (e^t - 1); elsewhere xi and eta are 3 sigma sinh(t). Each order has the strip of the plane that
is nearer to it than to its neighbours, or shares one with those that it melts into; a panel ends
where the end of its strip crosses the horizon.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from albedo._compile import kernel
from albedo.charts._compiled import CompiledChart, Kernel, clustered

# A Gaussian is cut at this many widths: at 5e-32 of its peak.
REACH = 12.0
# An edge closer than so many sizes of a panel makes the root felt.
_NEAR = 2.0
# E-folds of a stretched coordinate in one panel.
_FOLDS = 4.0
# In widths, where the stretch of a Gaussian turns logarithmic: measured to need the fewest nodes.
_CORE = 3.0
# Width of a strip that orders share, in widths of the Gaussian: as wide as one of them.
_SHARED = 4.0
_PLAIN, _UPPER, _LOWER = 0, 1, 2


class _Side(NamedTuple):
    """A stretch of one coordinate: how it is measured, and its two ends."""

    mode: int
    first: float
    last: float


@dataclass(frozen=True)
class OrdersChart(CompiledChart):
    """The unit disk of (v.x, v.y), about the orders of a grating.

    Parameters
    ----------
    step : float
        Distance g of the orders, wavelength over period.
    sigma : float
        Standard deviation of the Gaussian about each order.
    """

    step: float
    sigma: float

    def panels(
        self,
        cos_theta: np.ndarray,
        phi: np.ndarray,
        widths: np.ndarray,
        isotropic: bool,
        coarse: bool = False,
        fine: bool = False,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Panels of every row; see `albedo.charts.polar.PolarChart.panels`.

        The box of a panel also holds the ends of its strip: along y in its own coordinate, and
        along x as distances from the order, or in theirs away from the horizon.
        """
        s = np.sqrt((1 - cos_theta) * (1 + cos_theta))
        lights = np.column_stack((s * np.cos(phi), s * np.sin(phi), cos_theta))
        row, code, box = [], [], []
        for i, light in enumerate(lights.tolist()):
            for kinds, ends in self._row(*light):
                row.append(i)
                code.append(kinds)
                box.append(ends)
        return (
            np.column_stack((lights, np.tile((self.step, self.sigma), (len(s), 1)))),
            np.array(row, dtype=np.int64),
            np.array(code, dtype=np.int64).reshape(-1, 6),
            np.array(box, dtype=np.float64).reshape(-1, 8),
        )

    def _row(
        self, lx: float, ly: float, lz: float
    ) -> list[tuple[tuple[int, ...], tuple[float, ...]]]:
        """Codes and boxes of all panels of one direction."""
        reach = REACH * self.sigma
        # Orders that melt into one another share a strip.
        every = max(1, round(_SHARED * self.sigma / self.step))
        half = min(reach, 0.5 * every * self.step)
        top, bottom = _to_edge(ly, lx, lz), _to_edge(-ly, lx, lz)
        low, high = max(-reach, -bottom), min(reach, top)
        near = _NEAR * (high - low)
        turns = {0.0}
        if top - high <= near and low + bottom <= near:
            turns.add(ly)
        found: list[tuple[tuple[int, ...], tuple[float, ...]]] = []
        first = math.ceil((lx - 1.0 - half) / (every * self.step))
        last = math.floor((lx + 1.0 + half) / (every * self.step))
        for n in range(every * first, every * last + 1, every):
            x = n * self.step - lx
            crossings = set()
            for end in (x - half, x, x + half):
                if abs(end) < 1.0:
                    y = math.sqrt((1.0 - end) * (1.0 + end))
                    crossings |= {ly - y, ly + y}
            ends = sorted({low, high} | {e for e in turns | crossings if low < e < high})
            for start, end in itertools.pairwise(ends):
                if end - start <= 1e-14 * (high - low):
                    continue
                # A root at an end where a strip meets the horizon becomes smooth by squares.
                power = (start in crossings) + 2 * (end in crossings)
                middle = 0.5 * (start + end)
                mode = _PLAIN
                if top - high <= near and (low + bottom > near or middle > ly):
                    mode = _UPPER
                elif low + bottom <= near:
                    mode = _LOWER
                along = self._stretched(mode, start, end, (top, bottom), lz)
                chord = [
                    math.sqrt(max((1 + ly - e) * (1 - ly + e), 0.0)) for e in (start, middle, end)
                ]
                for across in self._strip(x, half, chord):
                    u = _pieces(along.last - along.first if mode != _PLAIN else 0.0)
                    v = _pieces(_spread(across, x, chord[1], lz))
                    for (u0, u1), (v0, v1) in itertools.product(u, v):
                        found.append(
                            (
                                (mode, 0, across.mode, 1, n, power),
                                (
                                    u0,
                                    u1,
                                    v0,
                                    v1,
                                    along.first,
                                    along.last,
                                    across.first,
                                    across.last,
                                ),
                            )
                        )
        return found

    def _stretched(
        self, mode: int, start: float, end: float, edges: tuple[float, float], scale: float
    ) -> _Side:
        """A piece of eta in its own coordinate; `edges` are how far eta may go up and down."""
        if mode == _PLAIN:
            return _Side(
                mode,
                math.asinh(start / (_CORE * self.sigma)),
                math.asinh(end / (_CORE * self.sigma)),
            )
        top, bottom = edges
        far = (top - start, top - end) if mode == _UPPER else (start + bottom, end + bottom)
        return _Side(mode, *(math.log1p(math.sqrt(max(d, 0.0)) / scale) for d in far))

    def _strip(self, x: float, half: float, chord: list[float]) -> list[_Side]:
        """Pieces of xi above the horizon, over a piece of eta, and how they are measured."""
        if x - half >= chord[1] or x + half <= -chord[1]:
            return []
        # A chord is longer inside than at the ends.
        least = min(chord[0], chord[2])
        right = least - (x + half) <= 2.0 * _NEAR * half
        left = least + (x - half) <= 2.0 * _NEAR * half
        cuts = [-half, 0.0, half]
        if right and left and -half < -x < half and x != 0.0:
            cuts = sorted([*cuts, -x])
        found = []
        for first, last in itertools.pairwise(cuts):
            if right or left:
                beyond = x + 0.5 * (first + last) > 0.0
                mode = _UPPER if right and (not left or beyond) else _LOWER
                found.append(_Side(mode, first, last))
            else:
                ends = (math.asinh(end / (_CORE * self.sigma)) for end in (first, last))
                found.append(_Side(_PLAIN, *ends))
        return found

    @property
    def layout(self) -> tuple[Kernel, np.ndarray]:
        """See `albedo.charts._compiled.CompiledChart`."""
        return _nodes, np.empty(0)


def _to_edge(along: float, across: float, up: float) -> float:
    """1 + along, for a unit vector."""
    return 1.0 + along if along > -0.5 else (across * across + up * up) / (1.0 - along)


def _spread(across: _Side, x: float, chord: float, scale: float) -> float:
    """E-folds of a piece of xi."""
    if across.mode == _PLAIN:
        return 0.0
    sign = 1.0 if across.mode == _UPPER else -1.0
    far = (chord - sign * (x + end) for end in (across.first, across.last))
    a, b = (math.log1p(math.sqrt(max(d, 0.0)) / scale) for d in far)
    return abs(a - b)


def _pieces(folds: float) -> list[tuple[float, float]]:
    count = max(1, math.ceil(abs(folds) / _FOLDS))
    return [(k / count, (k + 1) / count) for k in range(count)]


@kernel
def _nodes(geometry, code, box, u, v, numbers, wi, wo, h, weight):
    """Directions, sums and Jacobians; one row per panel."""
    for k in range(box.shape[0]):
        lx, ly, lz, step, sigma = geometry[k]
        wi[0, k], wi[1, k], wi[2, k] = lx, ly, lz
        y_mode, x_mode, order, power = code[k, 0], code[k, 2], code[k, 4], code[k, 5]
        u0, u1, v0, v1, y_first, y_last, x_first, x_last = box[k]
        across = order * step
        x = across - lx
        chord0 = math.hypot(lx, lz)
        level = lz * lz + across * (2.0 * lx - across)  # (n.v)^2 of the order itself
        # As seen from the edge of the chord that is measured from.
        sign = -1.0 if x_mode == 2 else 1.0
        inner = sign * x
        for iu in range(u.size):
            t, dt = clustered(u0 + (u1 - u0) * u[iu], power)
            place = y_first + (y_last - y_first) * t
            dy = abs(y_last - y_first) * dt * (u1 - u0)
            if y_mode == 0:
                eta = _CORE * sigma * math.sinh(place)
                dy *= _CORE * sigma * math.cosh(place)
                chord = math.sqrt(max(chord0 * chord0 + eta * (2.0 * ly - eta), 0.0))
            else:
                e = math.exp(place)
                r = lz * (e - 1.0)
                dy *= 2.0 * r * lz * e
                chord = r * math.sqrt(2.0 - r * r)
                if y_mode == 1:
                    far = 1.0 + ly if ly > -0.5 else chord0 * chord0 / (1.0 - ly)
                    eta = far - r * r
                else:
                    far = 1.0 - ly if ly < 0.5 else chord0 * chord0 / (1.0 + ly)
                    eta = r * r - far
            moved = eta * (2.0 * ly - eta)
            if inner > 0.0:
                edge = level / (chord0 + inner) + moved / max(chord + chord0, 1e-300)
            else:
                edge = chord - inner
            first, last = x_first, x_last
            if x_mode != 0:
                a, b = (edge - x_last, edge - x_first)
                if x_mode == 2:
                    a, b = edge + x_first, edge + x_last
                first = math.log1p(math.sqrt(max(a, 0.0)) / lz)
                last = math.log1p(math.sqrt(max(b, 0.0)) / lz)
            for iv in range(v.size):
                place = first + (last - first) * (v0 + (v1 - v0) * v[iv])
                dx = (last - first) * (v1 - v0)
                if x_mode == 0:
                    xi = _CORE * sigma * math.sinh(place)
                    dx *= _CORE * sigma * math.cosh(place)
                    nv = math.sqrt(max(level + moved - xi * (2.0 * x + xi), 0.0))
                    vx = x + xi
                else:
                    e = math.exp(place)
                    s = lz * (e - 1.0)
                    dx *= 2.0 * s * lz * e
                    xi = sign * (edge - s * s)
                    nv = s * math.sqrt(max(2.0 * chord - s * s, 0.0))
                    vx = sign * (chord - s * s)
                i = iu * v.size + iv
                wo[0, k, i] = vx
                wo[1, k, i] = eta - ly
                wo[2, k, i] = nv
                h[0, k, i] = across + xi
                h[1, k, i] = eta
                h[2, k, i] = lz + nv
                weight[k, i] = dx * dy
