r"""Rings of constant n.v, for lobes about H = N with heavy tails and without kinks.

Heights and symbols are those of `albedo.charts.rings`: V stands D below R, chi is its azimuth from
R, and the square of the slope of H is a + B sin(chi/2)^2 with a = tan(D/2)^2 and
B = 4 s_l s_v/(n.l + n.v)^2. With k^2 = (w^2 + a)/(w^2 + a + B), w being the width of the lobe, the
substitution tan(chi/2) = k tan(f) makes a trigonometric polynomial of a lobe 1/(w^2 + tan^2)^2,

    d(chi)/(w^2 + a + B sin(chi/2)^2)^2 = 2 k (cos(f)^2 + k^2 sin(f)^2)/(w^2 + a)^2 df,

however narrow it is, and however near to the horizon. So the core of a ring needs few nodes. Its
tail, where H is far from N, is a panel of its own, in the logarithm of tan(chi/4): at
tan(chi/2) = +-i, as near to f = pi/2 as k is small, a Fresnel factor has poles. Where the lobe is
about as wide as the ring, they are far, and a ring is a single panel. Without the width k is
tan(D/2)/tan(theta + D/2), theta being the polar angle of L: so it is next to N, and far below an R
that is near to N.

A Fresnel factor is steep in both logarithms at grazing incidence: in the azimuth of L the power
(1 - v.h)^5 is the tenth power of a height, and 1 - (1 - v.h)^5 begins linearly at the tip of the
cone of v.h, where V is R on the horizon. So steep lobes have the far end of a ring in chi itself,
and heights next to the zenith as fourth powers: there they are nearly polynomials.

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

# Most e-folds of a panel in the tail of a ring. Measured, as are the other numbers here.
_TAIL_FOLDS = 7.0
# Most e-folds of a panel in height, and how far beyond the core tan(chi/2) goes in the tail of a
# ring (0: on to chi = pi). Lobes that are steep have their own numbers where L stands lower than
# that.
_GENTLE, _STEEP, _GRAZING = (6.0, 0.0), (7.0, 0.35), 0.03
# From this k on a ring has no tail.
_ROUND = 0.4
# The span of a steep lobe next to the zenith: its share of all heights, or so many widths, unless
# these are too many.
_TOP, _WIDTHS, _MOST = math.exp(-5.0), 8.0, 0.08
_THINNEST = 1e-18
# Parts of a ring.
_CORE, _TAIL, _ALL, _FAR = 0, 1, 2, 3


@dataclass(frozen=True)
class TailRingsChart(CompiledChart):
    """The hemisphere in rings of constant n.v, for isotropic models.

    Parameters
    ----------
    layer : {1, 2}
        Masking sets in where n.v is this power of the width of the lobe.
    steep : bool
        The lobe has a Fresnel factor such as 1 - (1 - v.h)^5, or (1 - v.h)^5.
    """

    layer: int = 1
    steep: bool = False

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
        steep = self.steep & (lift < _GRAZING)
        numbers = np.where(steep[:, None], _STEEP, _GENTLE)
        geometry = np.column_stack((*light, width, layer, lift, s, scale, numbers))
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
    return k, 1.0 / math.sqrt(math.sqrt(peak + k * k))


@kernel
def _quarter(q):
    """The logarithm of tan(chi/4) where tan(chi/2) is q."""
    return math.log(q / (1.0 + math.sqrt(1.0 + q * q)))


@kernel
def _tail(g, k, edge):
    """Where the tail of a ring begins and ends, in the logarithm of tan(chi/4)."""
    q = k * edge
    return _quarter(q), _quarter(q + g[12]) if g[12] > 0.0 else 0.0


@kernel
def _foot(g):
    """The elevation from which heights above the lobe are counted.

    Where L stands lower than the lobe is wide, that is the horizon.
    """
    return 0.0 if g[4] < g[6] else g[4]


@kernel
def _round(g):
    """How far below R the k of a lobe without width comes to `_ROUND`; pi where it never does.

    A quadratic equation in tan(D/2), by its smaller root.
    """
    rest = (1.0 - _ROUND) * g[0]
    square = rest * rest - 4.0 * _ROUND * g[1] * g[1]
    if square < 0.0:
        return math.pi
    return 2.0 * math.atan(2.0 * _ROUND * g[1] / (rest + math.sqrt(square)))


@kernel
def _heights(g, span):
    """One of five spans of heights: its side, and the ends of the variable of `_height`."""
    foot, top = _foot(g), 0.5 * math.pi
    side, first = (2, 0.0) if foot > 0.0 else (1, stretched(g, 1, g[6]))
    if span < 3:
        if foot == 0.0:
            return 1, 0.0, first if span == 2 else 0.0
        if span == 2:
            return 1, 0.0, stretched(g, 1, 0.5 * g[4])
        middle = stretched(g, 0, g[4] - min(_round(g), 0.5 * g[4]))
        if span == 0:
            return 0, 0.0, middle
        return 0, middle, stretched(g, 0, 0.5 * g[4])
    if g[12] > 0.0:
        near = max(_TOP * (top - foot), _WIDTHS * g[6])
        if near < _MOST * (top - foot):
            if span == 4:
                return 3, near**0.25, (top - foot) ** 0.25
            top = foot + near
    return side, first, stretched(g, side, top) if span == 3 else first


@kernel
def _height(g, side, s):
    """As `elevation`, with side 3 next to the zenith: fourth powers."""
    if side < 3:
        return elevation(g, side, s)
    d, foot = s**4, _foot(g)
    return foot + d, (g[4] - foot) - d, 4.0 * s**3


@kernel
def _panels(geometry, coarse, row, code, box):
    """Fill row, code and box with all panels; return their number, or -1 if they do not fit."""
    count = 0
    for i in range(geometry.shape[0]):
        g = geometry[i]
        for span in range(5):
            side, first, last = _heights(g, span)
            if not last > first:
                continue
            folds = (last - first) * (2.0 if side == 1 else 1.0)
            pieces = 1 if coarse else max(1, math.ceil(folds / g[11]))
            for piece in range(pieces):
                v0 = first + (last - first) * piece / pieces
                v1 = first + (last - first) * (piece + 1) / pieces
                turns = parts = 0
                if not coarse:
                    longest, least = 0.0, 1.0
                    for v in (v0, 0.5 * (v0 + v1), v1):
                        e_v, below, _ = _height(g, side, v)
                        k, edge = _ring(g, math.sin(e_v), math.cos(e_v), below)
                        begin, end = _tail(g, k, edge)
                        longest, least = max(longest, end - begin), min(least, k)
                    # One span begins at `_ROUND`, up to roundings.
                    if least < 0.999 * _ROUND:
                        turns = max(1, math.ceil(longest / _TAIL_FOLDS))
                        parts = turns + 1 if g[12] > 0.0 else turns
                if count + 1 + parts > row.size:
                    return -1
                for turn in range(1 + parts):
                    row[count] = i
                    code[count, 0], code[count, 1] = side, min(turn, 1)
                    code[count, 2] = _ALL if parts == 0 else min(turn, 1)
                    if turn > turns:
                        code[count, 2] = _FAR
                    box[count, 0], box[count, 1] = 0.0, 1.0
                    if 0 < turn <= turns:
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
            e_v, below, slope = _height(g, code[j, 0], v0 + (v1 - v0) * v[iv])
            # s_l - s_v; next to the normal the cosine of e_v has few digits.
            shift = -2.0 * math.sin(0.5 * below) * math.sin(0.5 * (e_v + g[4]))
            n_v, s_v = math.sin(e_v), s_l - shift
            k, edge = _ring(g, n_v, s_v, below)
            begin, end = 0.0, 0.5 * math.pi
            if part == _CORE:
                end = math.atan(edge)
            elif part == _TAIL:
                begin, end = _tail(g, k, edge)
            elif part == _FAR:
                begin = math.atan(k * edge + g[12])
            # Both halves of the ring.
            ring = 2.0 * n_v * s_v * slope * (v1 - v0) * (u1 - u0) * (end - begin)
            for iu in range(u.size):
                y = begin + (end - begin) * (u0 + (u1 - u0) * u[iu])
                # tan(chi/2), sin(chi/2), cos(chi/2) and how fast chi grows.
                if part == _TAIL:
                    q = math.exp(y)
                    inverse = 1.0 / (1.0 + q * q)
                    sine, cosine = 2.0 * q * inverse, (1.0 - q) * (1.0 + q) * inverse
                    turn = 4.0 * q * inverse
                elif part == _FAR:
                    sine, cosine, turn = math.sin(y), math.cos(y), 2.0
                else:
                    f = math.tan(y)
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
