r"""Rings of constant n.v, for lobes about H = N with heavy tails and without kinks.

Heights and symbols are those of `albedo.charts.rings`: V stands D below R, chi is its azimuth from
R, and the square of the slope of H is a + B sin(chi/2)^2 with a = tan(D/2)^2 and
B = 4 s_l s_v/(n.l + n.v)^2. With k^2 = (w^2 + a)/(w^2 + a + B), w being the width of the lobe, the
substitution tan(chi/2) = k tan(f) makes a trigonometric polynomial of a lobe 1/(w^2 + tan^2)^2,

    d(chi)/(w^2 + a + B sin(chi/2)^2)^2 = 2 k (cos(f)^2 + k^2 sin(f)^2)/(w^2 + a)^2 df,

however narrow it is, and however near to the horizon. So the core of a ring needs few nodes. Its
tail, where H is far from N, is a panel of its own, in the logarithm of tan(chi/4).

A ring is cut nowhere by the horizon, and masking changes from ring to ring only: its layer along
the horizon costs nodes in height, but none in azimuth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from albedo._compile import kernel
from albedo.charts._compiled import CompiledChart, Kernel
from albedo.charts.rings import elevation, stretched

# Most e-folds of a panel in height, and in the tail of a ring. Measured, as is `_NARROW`.
_FOLDS, _TAIL_FOLDS = 6.0, 7.0
# The core of a narrow lobe ends where tan(f) is the inverse of this, of a wide one sooner.
_NARROW = 1.0 / 64.0
_THINNEST = 1e-18
# Parts of a ring.
_CORE, _TAIL, _ALL = 0, 1, 2


@dataclass(frozen=True)
class TailRingsChart(CompiledChart):
    """The hemisphere in rings of constant n.v, for isotropic models.

    Parameters
    ----------
    layer : {1, 2}
        Masking sets in where n.v is this power of the width of the lobe.
    """

    layer: int = 1

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
        if not isotropic:
            raise TypeError("rings of constant n.v are for isotropic models")
        c = cos_theta
        s = np.sqrt((1 - c) * (1 + c))
        lift = np.arctan2(c, s)
        width = np.clip(widths.min(1), 1e-12, 1.0)
        # Below the lobe's width n.v = n.l is a layer as well.
        layer = np.maximum(np.minimum(width**self.layer, lift), _THINNEST)
        scale = np.maximum(np.minimum(2.0 * width, lift), _THINNEST)
        # As `elevation` wants it, of the axis R.
        light = c, s, np.cos(phi), np.sin(phi), lift, np.arctan2(s, c)
        geometry = np.column_stack((*light, width, layer, lift, s, scale))
        room = c.size * 40 + 64
        while True:
            row, code, box = np.empty(room, int), np.empty((room, 3), int), np.empty((room, 4))
            count = _panels(geometry, coarse, row, code, box)
            if count >= 0:
                return geometry, row[:count].copy(), code[:count].copy(), box[:count].copy()
            room *= 2

    @property
    def layout(self) -> tuple[Kernel, np.ndarray]:
        """See `albedo.charts._compiled.CompiledChart`."""
        return _nodes, np.empty(0)


@kernel
def _ring(g, n_v, s_v, below):
    """k, and tan(f) where the core of the ring ends."""
    height, half = g[0] + n_v, math.tan(0.5 * below)
    peak = g[6] * g[6] + half * half
    k = math.sqrt(peak / (peak + 4.0 * g[1] * s_v / (height * height)))
    return k, 1.0 / (_NARROW + math.sqrt(math.sqrt(peak)))


@kernel
def _folds(k, edge):
    """E-folds of tan(chi/4) in the tail of a ring, which ends at 1."""
    q = k * edge
    return math.log((1.0 + math.sqrt(1.0 + q * q)) / q)


@kernel
def _heights(g, span):
    """One of three spans of heights: its side, and the ends of the variable of `elevation`.

    Where L stands lower than the lobe is wide, heights are counted from the horizon only, and the
    spans end where the lobe does.
    """
    if g[4] >= g[6]:
        return span, 0.0, stretched(g, span, 0.5 * math.pi if span == 2 else 0.5 * g[4])
    last = stretched(g, 1, 0.5 * math.pi)
    wide = min(stretched(g, 1, g[6]), last)
    if span == 0:
        return 1, 0.0, wide
    return 1, wide, last if span == 1 else wide


@kernel
def _panels(geometry, coarse, row, code, box):
    """Fill row, code and box with all panels; return their number, or -1 if they do not fit."""
    count = 0
    for i in range(geometry.shape[0]):
        g = geometry[i]
        for span in range(3):
            side, first, last = _heights(g, span)
            if not last > first:
                continue
            folds = (last - first) * (2.0 if side == 1 else 1.0)
            pieces = 1 if coarse else max(1, math.ceil(folds / _FOLDS))
            for piece in range(pieces):
                v0 = first + (last - first) * piece / pieces
                v1 = first + (last - first) * (piece + 1) / pieces
                turns = 0
                if not coarse:
                    longest = 0.0
                    for v in (v0, 0.5 * (v0 + v1), v1):
                        e_v, below, _ = elevation(g, side, v)
                        k, edge = _ring(g, math.sin(e_v), math.cos(e_v), below)
                        longest = max(longest, _folds(k, edge))
                    turns = max(1, math.ceil(longest / _TAIL_FOLDS))
                if count + 1 + turns > row.size:
                    return -1
                for turn in range(1 + turns):
                    row[count] = i
                    code[count, 0], code[count, 1] = side, min(turn, 1)
                    code[count, 2] = _ALL if coarse else min(turn, 1)
                    box[count, 0], box[count, 1] = 0.0, 1.0
                    if turn > 0:
                        box[count, 0], box[count, 1] = (turn - 1) / turns, turn / turns
                    box[count, 2], box[count, 3] = v0, v1
                    count += 1
    return count


@kernel
def _nodes(geometry, code, box, u, v, numbers, wi, wo, h, weight):
    """Directions, sums and Jacobians; one row per panel."""
    for j in range(box.shape[0]):
        g, part = geometry[j], code[j, 2]
        n_l, s_l, cos_phi, sin_phi = g[0], g[1], g[2], g[3]
        wi[0, j], wi[1, j], wi[2, j] = s_l * cos_phi, s_l * sin_phi, n_l
        u0, u1, v0, v1 = box[j, 0], box[j, 1], box[j, 2], box[j, 3]
        for iv in range(v.size):
            e_v, below, slope = elevation(g, code[j, 0], v0 + (v1 - v0) * v[iv])
            # s_l - s_v; next to the normal the cosine of e_v has few digits.
            shift = -2.0 * math.sin(0.5 * below) * math.sin(0.5 * (e_v + g[4]))
            n_v, s_v = math.sin(e_v), s_l - shift
            k, edge = _ring(g, n_v, s_v, below)
            end = 0.5 * math.pi
            if part != _ALL:
                end = _folds(k, edge) if part == _TAIL else math.atan(edge)
            # Both halves of the ring.
            ring = 2.0 * n_v * s_v * slope * (v1 - v0) * (u1 - u0) * end
            for iu in range(u.size):
                y = u0 + (u1 - u0) * u[iu]
                # tan(chi/2), sin(chi/2), cos(chi/2) and how fast chi grows.
                if part == _TAIL:
                    q = math.exp(end * (y - 1.0))
                    inverse = 1.0 / (1.0 + q * q)
                    sine, cosine = 2.0 * q * inverse, (1.0 - q) * (1.0 + q) * inverse
                    turn = 4.0 * q * inverse
                else:
                    f = math.tan(end * y)
                    q = k * f
                    cosine = 1.0 / math.sqrt(1.0 + q * q)
                    sine = q * cosine
                    turn = 2.0 * k * (1.0 + f * f) * cosine * cosine
                along, across = shift + 2.0 * s_v * sine * sine, -2.0 * s_v * sine * cosine
                i = iu * v.size + iv
                h[0, j, i] = along * cos_phi - across * sin_phi
                h[1, j, i] = along * sin_phi + across * cos_phi
                h[2, j, i] = n_l + n_v
                wo[0, j, i] = h[0, j, i] - wi[0, j]
                wo[1, j, i] = h[1, j, i] - wi[1, j]
                wo[2, j, i] = n_v
                weight[j, i] = ring * turn
