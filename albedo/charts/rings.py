r"""Rings of constant n.v, for integrands that know V's height as well as its distance from an axis.

The axis is the mirror direction R, or (c l.x, c l.y, d l.z), which is R for c = -1 and d = 1. It
lies in the plane of incidence at the elevation e_a, which may be below the horizon, on the side of
R or on that of L. V has the elevation e_v and the azimuth chi from that of the axis, and
D = e_a - e_v is how much lower it stands. For one height everything about the axis is a function
of sin(chi/2)^2:

====================================  ================================  ============================
tan^2 of the angle of H (``slope``)   tan(D/2)^2 + B sin(chi/2)^2       B = 4 s_l s_v/(n.l + n.v)^2
sin^2 of half the angle to the axis   sin(D/2)^2 + B sin(chi/2)^2       B = s_a s_v
square of half the way from R to V    (s_l - s_v)^2/4 + B sin(chi/2)^2  B = s_l s_v
====================================  ================================  ============================

with the sines s_l, s_a and s_v of the polar angles, and the way along the surface (``projected``).
So curves of constant n.v, along which factors such as max(a(L), a(V)) have their kinks, are ends of
panels; the horizon is e_v = 0; and the curves of the V-cavity masking, min(n.l, n.v) (n.h) =
(v.h)/2, and of 90 degrees from the axis are known in chi for each ring. They begin and end where
chi is 0 or pi, at heights that are known too; there chi is a root, and nodes are clustered. A ring
ends 90 degrees from the axis at cos(chi) = -tan(e_a) tan(e_v), which at grazing incidence turns
within e_a of the zenith: the fourth power, with which broad lobes have nodes there, sees that layer
as far as it has any weight.

Heights are stretched from the axis as scale sinh(s), on either side, the scale being the width of
the lobe, or the elevation of the axis where that is less and the horizon has a layer; and from the
horizon. Below an axis under the horizon there is nothing: its lobe falls from the horizon on, and
ends where the ring chi = 0 is 90 degrees from it, at e_v = pi/2 + e_a. In chi,
tan(chi/4) is stretched likewise, with the width that the lobe has on that ring.

Where the lobe is a sum of Gaussians (``projected``) nothing has an end in chi but by symmetry.
There tan(chi/2) = a tan(pi u/2): what is smooth and even about chi = 0 and pi is so in u, and has
the rule of whole rings (`albedo.integrators.rules.midpoint`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from albedo._compile import inlined, kernel
from albedo.charts._compiled import CompiledChart, Kernel, clustered
from albedo.charts.dark import dark_angle, dark_end

KINDS = {"slope": 0, "mirror": 1, "axis": 1, "mirror_hemisphere": 2, "broad": 3, "projected": 4}
KINKS = {"none": 0, "max": 1, "v_cavity": 2, "dark": 3}
DECAYS = {"algebraic": 0, "gaussian": 1, "cosine_power": 2}
# A lobe is cut at 4.5e-19 of its peak, which it reaches at so many squares of its width.
_REACH = 42.25
# E-folds of a stretched coordinate in one panel.
_FOLDS = 4.0
_THINNEST = 1e-18
# Lobes that end within so many widths fall like Gaussians, whose core is so many wide.
_ENDS, _CORE = 30.0, 2.0
# Nodes around whole rings crowd within so many widths of the lobe.
_AROUND = 3.0
# R, of whose distance from V kernels lose nothing: they have it from H.
MIRROR = (-1.0, 1.0)
# Down to the height below which pumping-up takes albedos as they are there.
_OCTAVES = 0.5 ** np.arange(1, 65)


def octaves(cos_theta: np.ndarray) -> np.ndarray:
    """Heights of which each is half of the last, as `RingsChart.levels`.

    They are for what falls to 0 towards the horizon with n.l and n.v, and is divided by that: in
    every octave a series knows it to as many digits as in any other.

    Parameters
    ----------
    cos_theta : ndarray, shape (n,)

    Returns
    -------
    ndarray, shape (n, 64)
    """
    return np.tile(_OCTAVES, (cos_theta.size, 1))


@dataclass(frozen=True)
class RingsChart(CompiledChart):
    """The hemisphere in rings of constant n.v, for isotropic models.

    Parameters
    ----------
    kind : {"slope", "mirror", "axis", "mirror_hemisphere", "broad", "projected"}
        What the lobe is a function of: the slope of H; the angle to an axis below 90 degrees,
        widths being those in half of it (``mirror``) or in all of it (``axis``, without layers
        along the horizon); the angle to R at all; neither; or how far V is from R along the
        surface, for waves, of which a slope is a part that falls with n.l + n.v.
    kinks : {"none", "max", "v_cavity", "dark"}
        Curves at which the integrand has a kink, beside those of `levels`; ``dark`` is where Oren
        and Nayar's full model ends, about the side of L.
    decay : {"algebraic", "gaussian", "cosine_power"}
        How the lobe falls; the last two are cut.
    edge : int
        Power that clusters nodes 90 degrees from the axis.
    thin : bool
        The layer along the horizon is as thin as the square of the width.
    axis : tuple of float
        c and d of the axis (c l.x, c l.y, d l.z); (-1, 1) is R, and (1, 1) L.
    levels : callable, optional
        Further values of n.v at which the integrand has kinks, for values of n.l: (n,) to (n, k),
        NaN where there are fewer. Compared by identity.
    waves : float
        Half of how far V is from R along the surface where waves let the lobe fall
        (``projected``).
    fit : tuple of float
        See `albedo.charts.dark.DarkChart` (``dark``).
    around : {"none", "smooth", "entire"}
        The integrand is an analytic function of cos(chi), or an entire one, with a peak nowhere but
        at chi = 0 and pi: whole rings have the rule of what is periodic (``projected``).
    """

    kind: str
    kinks: str = "none"
    decay: str = "algebraic"
    edge: int = 1
    thin: bool = False
    axis: tuple[float, float] = MIRROR
    levels: Callable[[np.ndarray], np.ndarray] | None = None
    waves: float = 0.0
    fit: tuple[float, float, float] = (1.0, 0.0, 0.0)
    around: str = "none"

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
        sideways, up = self.axis / np.abs(self.axis).max()
        along = np.abs(sideways) * s
        high, flat = np.arctan2(up * c, along), np.arctan2(along, np.abs(up) * c)
        width = np.clip(widths.min(1), 1e-12, 1.0)
        layer = widths.min(1) ** 2 if self.thin else width
        if self.kind == "broad":
            width = np.ones_like(c)
        scale = np.minimum(2.0 * width, high)
        if self.kind == "axis":
            # An axis below the horizon has a lobe that falls from the horizon on.
            layer = np.where(high < 0.0, width * np.minimum(width * np.tan(flat), 1.0), width)
            scale, width = width, np.minimum(math.sqrt(0.5) * widths.min(1), 1.0)
        geometry = np.column_stack(
            (
                *(c, s, np.cos(phi), np.sin(phi), high, flat, width),
                *(np.maximum(layer, _THINNEST), np.arctan2(c, s), np.sin(flat)),
                *(np.maximum(scale, _THINNEST), np.full_like(c, math.copysign(1.0, -sideways))),
                np.full_like(c, min(self.waves, 1.0)),
                np.tile(self.fit, (c.size, 1)),
            )
        )
        levels = np.empty((c.size, 0)) if self.levels is None else self.levels(c)
        room = c.size * (40 + 8 * levels.shape[1]) + 64
        while True:
            row, code, box = np.empty(room, int), np.empty((room, 4), int), np.empty((room, 6))
            count = _panels(geometry, levels, coarse, *self._structure, row, code, box)
            if count >= 0:
                return geometry, row[:count].copy(), code[:count].copy(), box[:count].copy()
            room *= 2

    def finest(self, width: float) -> float:
        """The share of a lobe that nobody knows whose directions are rounded.

        Parameters
        ----------
        width : float
            Of the lobe, radians.
        """
        return 0.0 if self.axis == MIRROR else float(2.0 * np.finfo(np.float64).eps / width)

    @property
    def _structure(self) -> tuple[int, int, int, int]:
        return KINDS[self.kind], KINKS[self.kinks], DECAYS[self.decay], self.edge

    @property
    def layout(self) -> tuple[Kernel, np.ndarray]:
        """See `albedo.charts._compiled.CompiledChart`."""
        return _nodes, np.array(self._structure, dtype=np.float64)


@inlined
def expm1_all(t, grown):
    """Fill exp(t) - 1 for t >= 0, many at once: a call of the library takes ten times as long.

    Taylor's series of t/2^m <= 1/4, and (1 + x)^2 - 1 = x (2 + x), m times. The error is that of t
    moved by some ulps.
    """
    most = 0.0
    for i in range(t.size):
        most = max(most, t[i])
    part, halvings = 1.0, 0
    while most * part > 0.25:
        part *= 0.5
        halvings += 1
    for i in range(t.size):
        x = part * t[i]
        total = x * (1.0 / 12.0) + 1.0
        for k in range(11, 1, -1):
            total = total * (x * (1.0 / k)) + 1.0
        grown[i] = x * total
    for _ in range(halvings):
        for i in range(t.size):
            grown[i] *= 2.0 + grown[i]


@kernel
def elevation(g, side, s):
    """Elevation of V, how far it stands below the axis, and the slope of the elevation.

    Sides: 0 below the axis, 1 along the horizon, 2 above the axis.
    """
    e_a = g[4]
    x = math.sinh(s)
    # cosh(s), by a root instead of another exponential.
    grows = math.sqrt(1.0 + x * x)
    if side == 1:
        # Squares, because n.v has a root at the horizon in many models.
        return g[7] * x * x, e_a - g[7] * x * x, 2.0 * g[7] * x * grows
    d = g[10] * x
    slope = g[10] * grows
    if side == 0:
        return e_a - d, d, slope
    return e_a + d, -d, slope


@inlined
def elevations(g, side, s, out):
    """Fill the elevations of V at many places, see `elevation`; these are not below 0."""
    expm1_all(s, out)
    for i in range(s.size):
        out[i] = 0.5 * (out[i] + out[i] / (1.0 + out[i]))
    if side == 1:
        for i in range(s.size):
            out[i] *= g[7] * out[i]
    else:
        scale = -g[10] if side == 0 else g[10]
        for i in range(s.size):
            out[i] = g[4] + scale * out[i]


@kernel
def stretched(g, side, e_v):
    """The variable of `elevation` where V has an elevation."""
    if side == 1:
        return math.asinh(math.sqrt(max(e_v, 0.0) / g[7]))
    below = g[4] - e_v if side == 0 else e_v - g[4]
    return math.asinh(below / g[10])


@kernel
def _polar_sine(g, e_v, below):
    """The sine of V's polar angle; next to the normal its elevation has few digits of that."""
    if e_v < 0.25 * math.pi or g[4] < 0.0:
        return math.cos(e_v)
    return abs(math.sin(g[5] + below))


@kernel
def _ring(g, kind, kinks, decay, cut, e_v, below, s_v):
    """What a ring holds: the scale of tan(chi/4), the end of chi and a kink (0: none), as
    tan(chi/4). See `_cut`. Of a ring that has no end the scale is the a of tan(chi/2)."""
    if kind == 3:
        # Broad models turn at right angles to the plane of incidence.
        kink, last = math.tan(0.125 * math.pi), 1.0
        if kinks == 3:
            dark = dark_angle(g[0], g[1], g[8], e_v, math.sin(e_v), s_v, g[13], g[14], g[15])
            last = max(math.tan(0.25 * (math.pi - dark)), kink)
        return 1.0, last, kink
    w2 = g[6] * g[6]
    if g[4] < 0.0:
        scale, last = _low_ring(g, decay, cut, e_v)
        return scale, last, 0.0
    n_l, n_v = g[0], math.sin(e_v)
    half = math.sin(0.5 * below)
    if kind == 0:
        cosine = math.cos(0.5 * below)
        a, b = (half / cosine) ** 2, 4.0 * g[1] * s_v / (n_l + n_v) ** 2
    elif kind == 4:
        # A quarter of the squares of n.l + n.v times the slope of H, and of what waves do.
        high = g[6] * 0.5 * (n_l + n_v)
        w2 = high * high + g[12] * g[12]
        a, b = (half * math.sin(0.5 * (g[4] + e_v))) ** 2, g[9] * s_v
    else:
        a, b = half * half, g[9] * s_v
    b = max(b, 1e-300)
    if kind == 4:
        # A sum of Gaussians, of which far from R wider ones are left. min(x, 1) instead of
        # x/(1 + x) would be a kink along v.
        x = _AROUND * _AROUND * math.sqrt(w2 * (w2 + a)) / b
        return math.sqrt(x / (1.0 + x)), 1.0, 0.0
    # On the ring an algebraic lobe is as wide as it is far from R, and a power of 1/(1 + tan^2)
    # falls as a + 1 does.
    spread = w2
    if decay == 0:
        spread = w2 + a
    elif decay == 2 and kind == 0:
        spread = w2 * (1.0 + a)
    last = 1.0
    if decay != 0:
        last = min(last, _quarter((cut - a) / b))
    if kind == 1:
        last = min(last, _quarter((0.5 - a) / b))
    scale = 0.5 * math.sqrt(spread / b)
    if decay != 0:
        # What falls like a Gaussian is entire, and wants no more than some crowding at its core.
        widths = math.sqrt(cut / w2)
        if widths < _ENDS:
            scale = min(_CORE / widths, 1.0) * last
    kink = 0.0
    if kinks == 2:
        # tan^2 of the angle of H is 4 min(n.l, n.v)/(n.l + n.v) - 1 where masking sets in.
        least = min(n_l, n_v)
        kink = _quarter(((4.0 * least / (n_l + n_v) - 1.0) - a) / b)
        if kink >= last:
            kink = 0.0
    return scale, last, kink


@kernel
def _low_ring(g, decay, cut, e_v):
    """The scale of tan(chi/4) and the end of chi, for an axis below the horizon."""
    # The cosine from the axis is that at chi = 0 less b sin(chi/2)^2.
    cosine = max(math.sin(g[5] - e_v), 1e-300)
    b = max(2.0 * g[9] * math.cos(e_v), 1e-300)
    last = _quarter((cosine - _least(g, decay, cut)) / b)
    return g[6] * math.sqrt(0.5 * cosine / b), last


@kernel
def _least(g, decay, cut):
    """The cosine from an axis below the horizon at which its lobe, largest there, is cut."""
    return 0.0 if decay == 0 else g[9] * (1.0 - 2.0 * cut)


@kernel
def _cut(kind, decay, w2):
    """Where a lobe is cut, in tan^2 of the angle of H or sin^2 of half the angle to R."""
    if decay == 0:
        return math.inf
    x = _REACH * w2
    if decay == 1:
        return x
    # (1 + x)^(-1/w^2) and (1 - 2 x)^(1/(2 w^2)).
    if kind == 0:
        return math.expm1(x) if x < 700.0 else math.inf
    return -0.5 * math.expm1(-2.0 * x)


@kernel
def _quarter(sine2):
    """tan(chi/4) from sin(chi/2)^2; 0 below 0, 1 above 1."""
    if sine2 <= 0.0:
        return 0.0
    if sine2 >= 1.0:
        return 1.0
    sine = math.sqrt(sine2)
    return sine / (1.0 + math.sqrt((1.0 - sine) * (1.0 + sine)))


@kernel
def _add(cuts, corner, count, x, least, end, is_corner):
    """Put x among the first `count` cuts, which are in order, if it lies between the ends."""
    if not least < x < (1.0 - 1e-14) * end:
        return count
    j = count
    while j > 0 and cuts[j - 1] > x:
        cuts[j] = cuts[j - 1]
        corner[j] = corner[j - 1]
        j -= 1
    cuts[j] = x
    corner[j] = is_corner
    return count + 1


@kernel
def _join_slivers(cuts, corner, count, scale):
    """Take out cuts that hardly differ from the one before, in terms of `scale` or of themselves.

    The neighbour covers what lies between. Returns the number of panels that are left.
    """
    kept = 0
    for k in range(1, count + 1):
        if cuts[k] - cuts[kept] > 1e-13 * max(scale, cuts[k]):
            kept += 1
            cuts[kept], corner[kept] = cuts[k], corner[k]
        else:
            cuts[kept] = cuts[k] if k == count else cuts[kept]
            corner[kept] = corner[kept] or corner[k]
    return kept


@kernel
def _special(g, kind, kinks, cut, reach, places):
    """Fill how far V stands below the axis where curves of kinks have chi = 0 or pi.

    The end of a lobe is such a curve too: beyond, nodes would be where nothing is.
    """
    e_a, flat = g[4], g[5]
    n = 0
    if e_a < 0.0:
        return n
    if kinks == 2:
        # V masked ahead and behind; L masked ahead and behind.
        places[0] = 2.0 / 3.0 * e_a
        places[1] = (math.pi - 4.0 * flat) / 3.0
        places[2] = -2.0 * e_a
        places[3] = math.pi - 4.0 * flat
        n = 4
        if places[1] < 0.0:
            places[1] = math.nan
        if places[3] > 0.0:
            places[3] = math.nan
    if kinks == 3:
        places[0] = e_a - dark_end(g[0], g[1], g[8], g[13], g[14], g[15])
        n = 1
    if kind == 1:
        places[n] = e_a - flat
        n += 1
    if reach < math.inf:
        places[n] = reach - 2.0 * flat
        n += 1
        if kinks == 2 and cut < 1.0:
            # Where the lobe ends on the curve of masking, below R and above.
            ratio = (1.0 + cut) / (3.0 - cut)
            places[n] = e_a - math.asin(g[0] * ratio)
            places[n + 1] = e_a - math.asin(min(g[0] / ratio, 1.0))
            n += 2
    return n


@kernel
def _panels(geometry, levels, coarse, kind, kinks, decay, edge, row, code, box):
    """Fill row, code and box with all panels; return their number, or -1 if they do not fit."""
    most = 20 + levels.shape[1]
    cuts, corner = np.empty(most), np.empty(most, np.bool_)
    places = np.empty(10)
    count = 0
    for i in range(geometry.shape[0]):
        g = geometry[i]
        e_a, flat = g[4], g[5]
        cut, reach = _cut(kind, decay, g[6] * g[6]), math.inf
        if decay != 0 and kind != 3:
            root = math.sqrt(cut)
            reach = 2.0 * math.atan(root) if kind == 0 else 2.0 * math.asin(min(root, 1.0))
        known = 0 if coarse else _special(g, kind, kinks, cut, reach, places)
        for side in range(3):
            # The variable is D, e_v and -D on the three sides.
            first, last = 0.0, 0.5 * e_a
            if side == 0:
                last = min(last, reach)
            elif side == 1:
                first = max(e_a - reach, 0.0)
            else:
                last = min(flat, reach)
            if e_a < 0.0:
                first, last = 0.0, flat - math.asin(_least(g, decay, cut))
            if not last > first or (e_a < 0.0 and side != 1):
                continue
            cuts[0], corner[0] = first, False
            m = 1
            # The elevation of the axis may be the scale, and far less than `last`.
            scale = min(g[7] if side == 1 else g[10], last)
            least = max(first, 1e-14 * scale)
            for k in range(known):
                x = places[k]
                if side == 1:
                    x = e_a - x
                elif side == 2:
                    x = -x
                m = _add(cuts, corner, m, x, least, last, True)
            # Factors such as max(n.l, n.v) have a kink at L's height, wherever the axis stands.
            for k in range(0 if coarse else levels.shape[1] + 1):
                e_v = g[8] if k == levels.shape[1] else math.asin(min(levels[i, k], 1.0))
                x = e_a - e_v
                if side == 1:
                    x = e_v
                elif side == 2:
                    x = -x
                m = _add(cuts, corner, m, x, least, last, False)
            cuts[m], corner[m] = last, e_a < 0.0
            for k in range(_join_slivers(cuts, corner, m, scale)):
                count = _rings(
                    *(g, i, side, cuts[k], cuts[k + 1], corner[k], corner[k + 1]),
                    *(coarse, kind, kinks, decay, edge, cut, row, code, box, count),
                )
                if count < 0:
                    return -1
    return count


@kernel
def _rings(
    g,
    i,
    side,
    low,
    high,
    at_low,
    at_high,
    coarse,
    kind,
    kinks,
    decay,
    edge,
    cut,
    row,
    code,
    box,
    count,
):
    """Panels between two heights; return the number of all so far, or -1."""
    if side == 1:
        s0, s1 = math.asinh(math.sqrt(low / g[7])), math.asinh(math.sqrt(high / g[7]))
    else:
        s0, s1 = math.asinh(low / g[10]), math.asinh(high / g[10])
    pieces = 1 if coarse else max(1, math.ceil((s1 - s0) / _FOLDS))
    for piece in range(pieces):
        v0 = s0 + (s1 - s0) * piece / pieces
        v1 = s0 + (s1 - s0) * (piece + 1) / pieces
        e_v, below, _ = elevation(g, side, 0.5 * (v0 + v1))
        s_v = _polar_sine(g, e_v, below)
        _, last, kink = _ring(g, kind, kinks, decay, cut, e_v, below, s_v)
        if last <= 0.0:
            continue
        inner = 2 if kink > 0.0 and not coarse else 1
        clustered = 0
        if inner == 2 or last < 1.0:
            clustered = (at_low and piece == 0) + 2 * (at_high and piece == pieces - 1)
            # A lobe that hardly falls to its edge shows how fast rings close near the zenith.
            if clustered == 2 and edge > 1 and g[6] >= 1.0:
                clustered = 4
        for part in range(inner):
            folds = 0.0
            for sample in range(3):
                e_v, below, _ = elevation(g, side, v0 + (0.02 + 0.48 * sample) * (v1 - v0))
                s_v = _polar_sine(g, e_v, below)
                scale, last, kink = _ring(g, kind, kinks, decay, cut, e_v, below, s_v)
                start = kink if part == 1 else 0.0
                end = kink if part == 0 and inner == 2 else last
                folds = max(folds, math.asinh(end / scale) - math.asinh(start / scale))
            turns = 1 if coarse or edge > 1 or kind == 4 else max(1, math.ceil(folds / _FOLDS))
            if count + turns > row.size:
                return -1
            for turn in range(turns):
                row[count] = i
                code[count, 0] = side
                code[count, 1] = 1
                code[count, 2] = part if inner == 2 else -1
                code[count, 3] = clustered
                box[count, 0] = turn / turns
                box[count, 1] = (turn + 1) / turns
                box[count, 2] = 0.0
                box[count, 3] = 1.0
                box[count, 4] = v0
                box[count, 5] = v1
                count += 1
    return count


@kernel
def _nodes(geometry, code, box, u, v, numbers, wi, wo, h, weight):
    """Directions, sums and Jacobians; one row per panel."""
    kind, kinks, decay, edge = int(numbers[0]), int(numbers[1]), int(numbers[2]), int(numbers[3])
    # Of every ring, and of one node on each: loops over rings run without a branch or a call.
    n_v, s_v, scale = np.empty(v.size), np.empty(v.size), np.empty(v.size)
    start, size = np.empty(v.size), np.empty(v.size)
    ring, shift = np.empty(v.size), np.empty(v.size)
    t, grown = np.empty(v.size), np.empty(v.size)
    sine, cosine = np.empty(v.size), np.empty(v.size)
    for k in range(box.shape[0]):
        g = geometry[k]
        n_l, s_l, cos_phi, sin_phi, away = g[0], g[1], g[2], g[3], g[11]
        wi[0, k], wi[1, k], wi[2, k] = s_l * cos_phi, s_l * sin_phi, n_l
        side, part = code[k, 0], code[k, 2]
        u0, u1, v0, v1, first, final = box[k]
        cut = _cut(kind, decay, g[6] * g[6])
        for iv in range(v.size):
            x, dx = clustered(v0 + (v1 - v0) * v[iv], code[k, 3])
            e_v, below, slope = elevation(g, side, first + (final - first) * x)
            n_v[iv], s_v[iv] = math.sin(e_v), _polar_sine(g, e_v, below)
            scale[iv], last, kink = _ring(g, kind, kinks, decay, cut, e_v, below, s_v[iv])
            area = n_v[iv] * s_v[iv] * slope * (final - first) * dx * (v1 - v0) * (u1 - u0)
            if kind == 4:
                ring[iv] = 2.0 * math.pi * area * scale[iv]
            else:
                start[iv] = math.asinh(kink / scale[iv]) if part == 1 else 0.0
                size[iv] = math.asinh((kink if part == 0 else last) / scale[iv]) - start[iv]
                ring[iv] = 8.0 * area * size[iv] * scale[iv]
            # H ahead of the normal where chi = 0: s_l - s_v, or s_l + s_v about the side of L.
            shift[iv] = s_l + s_v[iv]
            if away > 0.0:
                lower = below + (g[8] - g[4])
                shift[iv] = -2.0 * math.sin(0.5 * lower) * math.sin(0.5 * (e_v + g[8]))
        to_edge = edge > 1 and part != 0
        for iu in range(u.size):
            y, stretch = u0 + (u1 - u0) * u[iu], 1.0
            if to_edge:
                stretch = edge * (1.0 - y) ** (edge - 1)
                y = 1.0 - (1.0 - y) ** edge
            row = iu * v.size
            if kind == 4:
                across, along = math.sin(0.5 * math.pi * y), math.cos(0.5 * math.pi * y)
                for iv in range(v.size):
                    opposite = scale[iv] * across
                    inverse = 1.0 / (along * along + opposite * opposite)
                    root = math.sqrt(inverse)
                    sine[iv], cosine[iv] = opposite * root, along * root
                    weight[k, row + iv] = ring[iv] * inverse
            else:
                for iv in range(v.size):
                    t[iv] = start[iv] + size[iv] * y
                expm1_all(t, grown)
                for iv in range(v.size):
                    # sinh and cosh of one exponential.
                    shrunk = grown[iv] / (1.0 + grown[iv])
                    q = 0.5 * scale[iv] * (grown[iv] + shrunk)
                    inverse = 1.0 / (1.0 + q * q)
                    # sin and cos of chi/2.
                    sine[iv], cosine[iv] = 2.0 * q * inverse, (1.0 - q) * (1.0 + q) * inverse
                    slope = 1.0 + 0.5 * (grown[iv] - shrunk)
                    weight[k, row + iv] = ring[iv] * stretch * inverse * slope
            for iv in range(v.size):
                turned = 2.0 * away * s_v[iv] * sine[iv]
                along, across = shift[iv] + turned * sine[iv], -turned * cosine[iv]
                h[0, k, row + iv] = along * cos_phi - across * sin_phi
                h[1, k, row + iv] = along * sin_phi + across * cos_phi
                h[2, k, row + iv] = n_l + n_v[iv]
            for iv in range(v.size):
                # Not h less wi, which would round more: narrow lobes see every ulp.
                across = -2.0 * away * s_v[iv] * sine[iv] * cosine[iv]
                ahead = -away * s_v[iv] * (cosine[iv] - sine[iv]) * (cosine[iv] + sine[iv])
                wo[0, k, row + iv] = ahead * cos_phi - across * sin_phi
                wo[1, k, row + iv] = ahead * sin_phi + across * cos_phi
                wo[2, k, row + iv] = n_v[iv]
