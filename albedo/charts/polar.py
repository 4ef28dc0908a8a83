r"""Polar chart around the mirror direction, in slopes of the half vector or in angles about R.

With L at angle theta, let psi be the polar angle from the plane of incidence, t = tan(theta),
T = t cos(psi) and beta = atan(T). The radial coordinate delta is the angle of the half vector to
the normal (``slope``: psi is the azimuth of H) or half the angle between V and the mirror
direction R (``mirror``: psi is the azimuth of V about R). In both, for a fixed psi,

    n.v = cos(theta) (cos(2 delta) + T sin(2 delta)),

and every curve at which a classic model has a kink is *linear in beta*:

==========================  =================================  =======================
horizon                     n.v = 0                            delta = (pi/2 + beta)/2
equal cosines               n.v = n.l                          delta = beta
masking of L (V-cavity)     2 (n.h)(n.l) = l.h                 delta = pi/2 - beta
masking of V (V-cavity)     2 (n.h)(n.v) = v.h                 delta = (pi/2 + beta)/3
half vectors seen from L    l.h = 0                            delta = pi/2 + beta
==========================  =================================  =======================

(the masking curves hold in slopes of H). So panels between kinks are exact at any angle, and the
integrand on them is analytic. Two layers remain, and both are stretched logarithmically: the
radial one at the width of the lobe (delta = w sinh(s)), and, at grazing incidence, the angular
one of width 1/(t w) at psi = +-pi/2, where the horizon sweeps across the lobe. Anisotropic lobes
are stretched to circles first: psi becomes the elliptic angle that Ward's sampling uses.

Jacobians: dV = 4 (l.h) dH = 4 (l.h) sin(delta) d(delta) d(psi) in slopes,
dV = 2 sin(2 delta) d(delta) d(psi) about R. The angle between R and V, in slopes, is
2 asin(sin(delta) sqrt(c^2 + s^2 cos^2(psi))), c and s being cosine and sine of theta.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from albedo._compile import kernel
from albedo.charts._compiled import CompiledChart, Kernel

KINDS = {
    "slope": 0,
    "mirror": 1,
    "retro": 2,
    "mirror_hemisphere": 3,
    "retro_hemisphere": 4,
    "mirror_in_slopes": 5,
}
KINKS = {"none": 0, "max": 1, "v_cavity": 2}
DECAYS = {"algebraic": 0, "gaussian": 1, "cosine_power": 2}
# Instead of a decay: a heavy tail, of which the horizon has a layer, and no core of its own.
_LAYERED = 3
# Instead of kinks: a layer along the horizon that is thinner than all else.
_THIN = 3

# Angular layers thinner than this weigh less than the rounding error.
_THINNEST_LAYER = 1e-17
# Below this cosine of incidence the layer n.v ~ n.l along the horizon gets a panel of its own.
_THIN_EDGE = 0.05
# Power that clusters nodes at a corner where a kink, or the lobe's end, meets an edge with a root.
_CORNER = 2
# Square of the distance, in widths, at which a lobe is 4.5e-19 of its peak.
_REACH = 42.25
# What is lost by a lobe matters down to 1e-293 of it.
_REACH_FULL = 676.0
# Four nodes see what lies at a panel's end if a lobe falls by no more e-folds from there to here.
_FOLDS, _HERE = 2.0, 0.07
# Lobes of widths further apart than this are cut at such distances from where they are narrow.
_APART = 16.0
# The same for lobes that are wide along one axis beyond 45 degrees, and for that axis.
_BEYOND = 4.0
_EIGHTH = math.tan(0.125 * math.pi)


@dataclass(frozen=True)
class PolarChart(CompiledChart):
    """A polar chart with its structure; widths differ from row to row.

    Parameters
    ----------
    kind : {"slope", "mirror", "retro", "mirror_hemisphere", "retro_hemisphere", "mirror_in_slopes"}
        Coordinates: slopes of H; angles about R or L, up to 90 degrees from it; or the same over
        the whole hemisphere; or slopes of H for a lobe about R whose width depends on the azimuth
        of H.
    kinks : {"none", "max", "v_cavity"}
        Curves at which the integrand has a kink.
    decay : {"algebraic", "gaussian", "cosine_power"}
        How the lobe falls: the last two are cut where they are below 4.5e-19 of their peak.
    origin : int
        Power that clusters nodes at the mirror direction at grazing incidence, where n.v is
        proportional to the distance from it (2 makes a square root there smooth).
    edge : int
        Power that clusters nodes at the outer edge (2 makes a square root there smooth).
    full : bool
        Integrate over all half vectors in the hemisphere seen from L, also those whose V is
        below the horizon (for energies lost rather than reflected). Slopes only.
    layer : {0, 1, 2}
        For heavy tails without kinks: the horizon has a layer at any azimuth, where n.v is this
        power of the lobe's width. 0: only where the tail alone reaches the horizon.
    turn : float
        For heavy tails without kinks: n.v at which the horizon has a layer at any azimuth, thinner
        than all else. 0: none.
    """

    kind: str
    kinks: str = "none"
    decay: str = "algebraic"
    edge: int = 1
    origin: int = 1
    full: bool = False
    layer: int = 0
    turn: float = 0.0

    def __post_init__(self) -> None:
        if self.turn and self.kinks != "none":
            raise ValueError(f"a chart with turn = {self.turn:g} has no kinks: {self.kinks!r}")

    def panels(
        self,
        cos_theta: np.ndarray,
        phi: np.ndarray,
        widths: np.ndarray,
        isotropic: bool,
        coarse: bool = False,
        fine: bool = False,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Panels of every row: smooth pieces of the hemisphere.

        Parameters
        ----------
        cos_theta, phi : ndarray, shape (n,)
            Direction of incidence; phi in radians.
        widths : ndarray, shape (n, 2)
            Widths of the lobe along x and y, in radians of delta.
        isotropic : bool
            The integrand is symmetric about the plane of incidence.
        coarse : bool
            One panel per quadrant, kinks inside: for budgets too small for anything better.
        fine : bool
            Search more densely for azimuths at which kinks meet: for a row that `nodes` refused.

        Returns
        -------
        geometry : ndarray, shape (n, 15)
            What `nodes` needs of each row.
        row : ndarray of int, shape (m,)
            Row to which each panel belongs.
        code : ndarray of int, shape (m, 6)
            Quadrant, index of the inner panel, number of inner panels (negative when the last
            is graded towards the horizon), multiplicity, arrangement of the kinks, power p of u.
        box : ndarray, shape (m, 6)
            u0, u1, v0, v1: the panel in the chart's own coordinates, and two values a and z of the
            azimuthal coordinate, which is a + (z - a) u^p.
        """
        c = cos_theta
        s = np.sqrt((1 - c) * (1 + c))
        # A Gaussian lobe that is wider than the hemisphere has its cut where it is.
        wx, wy = np.clip(widths, 1e-12, 100.0 if self.decay == "gaussian" else 1.0).T
        # What is left of the ratio of widths after the stretch: along y over along x.
        over = np.maximum(widths, 1e-12)
        left_over = (over[:, 1] / wy) / (over[:, 0] / wx)
        # An isotropic lobe is laid out in the plane of incidence, whatever phi is.
        cp, sp = (np.ones_like(c), np.zeros_like(c)) if isotropic else (np.cos(phi), np.sin(phi))
        norm = np.hypot(sp / wx, cp / wy)
        slant = (wx / wy * cp * cp + wy / wx * sp * sp) / norm
        with np.errstate(divide="ignore"):
            # A heavy tail feels the horizon at all scales up to half vectors of slope 1; with the
            # elliptic angle cos(psi) grows as slant times norm, which is 1 for circles.
            reach = slant * norm if self.decay == "algebraic" else slant
            layer = np.where(s > 0, c / (s * reach), np.inf)
        geometry = np.column_stack(
            (
                *(c, s, np.cos(phi), np.sin(phi), cp, sp, wx, wy),
                *(-sp / wx / norm, cp / wy / norm, slant, np.clip(layer, _THINNEST_LAYER, 10.0)),
                *(
                    self._grades_edge(c, np.minimum(wx, wy)),
                    wy * wy if self.layer == 2 else np.full_like(c, self.turn),
                    left_over,
                ),
            )
        )
        quadrants = 2 if isotropic else 4
        room = c.size * quadrants * 24 + 64
        while True:
            row, code, box = np.empty(room, int), np.empty((room, 6), int), np.empty((room, 6))
            count = _panels(
                *(geometry, quadrants, coarse, fine, *self._structure, self.edge),
                *(row, code, box),
            )
            if count >= 0:
                return geometry, row[:count].copy(), code[:count].copy(), box[:count].copy()
            room *= 2

    def _grades_edge(self, c: np.ndarray, width: np.ndarray) -> np.ndarray:
        """1 where the lobe reaches the horizon and n.v = n.l lies in a thin layer along it."""
        whole = self.decay == "algebraic" or (width > 0.1)
        reaches = self.kind in ("slope", "mirror_hemisphere", "retro_hemisphere") and not self.full
        return np.where((c < _THIN_EDGE) & whole & reaches, 1.0, 0.0)

    @property
    def _structure(self) -> tuple[int, int, int, bool]:
        decay = _LAYERED if self.layer else DECAYS[self.decay]
        kinks = _THIN if self.turn else KINKS[self.kinks]
        return KINDS[self.kind], kinks, decay, self.full

    @property
    def layout(self) -> tuple[Kernel, np.ndarray]:
        """See `albedo.charts._compiled.CompiledChart`."""
        return _nodes, np.array([*self._structure, self.edge, self.origin], dtype=np.float64)


@kernel
def _azimuth(g, quadrant, u):
    """cos(psi), sin(psi), width of the lobe along psi, and d(psi)/du."""
    cp, sp, wx, wy, ca, sa, slant, layer = g[4], g[5], g[6], g[7], g[8], g[9], g[10], g[11]
    e = math.exp(u)
    d = 0.5 * layer * (e - 1.0 / e)
    sin_d = math.sin(d)
    cos_d = math.cos(d)
    # a = a_layer -+ d for the layer at psi = +pi/2, mirrored for the one at -pi/2.
    turn = 1.0 if quadrant == 0 or quadrant == 3 else -1.0
    side = 1.0 if quadrant < 2 else -1.0
    x = side * wx * (ca * cos_d + turn * sa * sin_d)
    y = side * wy * (sa * cos_d - turn * ca * sin_d)
    # Exactly constant for an isotropic lobe, so that no comparison with it can waver.
    width = wx if wx == wy else math.hypot(x, y)
    front = 1.0 if quadrant % 2 == 0 else -1.0
    cos_psi = front * slant * sin_d / width
    sin_psi = (y * cp - x * sp) / width
    return cos_psi, sin_psi, width, 0.5 * wx * wy / (width * width) * layer * (e + 1.0 / e)


@kernel
def _breaks(c, big_t, width, kind, kinks, decay, full, b):
    """Fill b with tan(delta/2) at the ends of the inner panels.

    Returns the number of panels, and a number that tells the arrangements of ends apart.
    """
    # Tangents of halves: of beta, of pi/2 - beta, and of g = pi/2 + beta.
    root = math.sqrt(1.0 + big_t * big_t)
    above = root + big_t if big_t > 0.0 else 1.0 / (root - big_t)
    horizon = above / (1.0 + math.sqrt(1.0 + above * above))
    n = 0
    b[0] = 0.0
    within = kind == 1 or kind == 2  # up to 90 degrees
    if kinks == 1 and big_t > 0.0 and (big_t < 1.0 or not within):
        n = 1
        b[1] = big_t / (1.0 + root)
    elif kinks == 2 and big_t > 1.0:
        n = 2
        b[1] = 1.0 / above
        b[2] = big_t / (1.0 + root)
    elif kinks == 2:
        n = 1
        b[1] = math.tan(math.atan2(1.0, -big_t) / 6.0)
    n += 1
    b[n] = min(horizon, _EIGHTH) if within else horizon
    if full:
        n += 1
        b[n] = min(1.0, above)
    place = 0
    if full and kinks == 2 and 0.0 < big_t <= 1.0:
        # What L masks goes on beyond the curve where V's masking has taken over.
        line = 1.0 / above
        j = n
        while b[j] > line:
            b[j + 1] = b[j]
            j -= 1
        b[j + 1] = line
        n += 1
        place = j + 1
    reach = _REACH_FULL if full else _REACH
    r = math.inf
    if decay == 1:
        r = math.sqrt(reach) * width
        # Where an elliptic lobe is as wide as 1, the radial stretch has a kink.
        place += 64 if width > 1.0 else 0
    elif kind == 5:
        # Where the power is cut, or ends: sin(angle(R, V)/2) is sin(delta) sqrt(c^2 + s^2 cos^2).
        q = math.sqrt(-0.5 * math.expm1(-2.0 * reach * width * width))
        q = q / (c * math.sqrt(1.0 + big_t * big_t))
        if q < 1.0:
            r = q / math.sqrt((1.0 - q) * (1.0 + q))
    elif decay == 2 and kind == 0 and width < 0.1:
        r = math.sqrt(math.expm1(reach * width * width))
    elif decay == 2 and kind != 0 and width < 0.05:
        r = math.sqrt(math.tanh(reach * width * width))
    cut = r / (1.0 + math.sqrt(1.0 + r * r)) if r < math.inf else 2.0
    moved = 0
    for j in range(1, n + 1):
        if b[j] > cut:
            b[j] = cut
            moved += 1 << j
    core = 2.0 * width
    if decay == 0 and core < (0.5 if kinks == _THIN else 1.0) * b[n]:
        # The core of a heavy-tailed lobe is a panel of its own, the same for every psi.
        j = n
        while b[j] > core:
            b[j + 1] = b[j]
            j -= 1
        b[j + 1] = core
        n += 1
        moved = j + 1
    return n, moved + 256 * place


@kernel
def _scale(c, big_t, width, kind, decay):
    """Scale of the radial stretch, in tan(delta/2): measured to need the fewest nodes."""
    if kind == 5:
        t = width / (c * math.sqrt(1.0 + big_t * big_t))
        return t / math.sqrt(1.0 + t * t)
    return min(width, 1.0) * (0.5 if decay == 0 or decay == _LAYERED else 1.0)


@kernel
def _edge_layer(big_t, c, width, thin):
    """Distance from the horizon, in tan(delta/2), at which n.v is about n.l or the width.

    Masking sets in where n.v falls below the width of the lobe, or below `thin` if that is not 0.
    """
    width = thin if thin > 0.0 else width
    return max(0.5 * width / math.hypot(width, c) / math.sqrt(1.0 + big_t * big_t), 1e-17)


@kernel
def _split_edge(b, n):
    """Split the last of n panels halfway, where no lobe is steep any more."""
    b[n + 1] = b[n]
    b[n] = 0.5 * (b[n - 1] + b[n + 1])


@kernel
def _split_horizon(b, n, big_t):
    """Split the panel that ends at the horizon; return its new index, or -1."""
    root = math.sqrt(1.0 + big_t * big_t)
    above = root + big_t if big_t > 0.0 else 1.0 / (root - big_t)
    horizon = above / (1.0 + math.sqrt(1.0 + above * above))
    for j in range(n):
        if b[j + 1] == horizon:
            for k in range(n, j, -1):
                b[k + 1] = b[k]
            b[j + 1] = 0.5 * (b[j] + b[j + 2])
            return j + 1
    return -1


@kernel
def _pattern(g, quadrant, u, kind, kinks, decay, full, b):
    """Which arrangement of ends `_breaks` finds at u."""
    cos_psi, _, width, _ = _azimuth(g, quadrant, u)
    return _breaks(g[0], g[1] / g[0] * cos_psi, width, kind, kinks, decay, full, b)[1]


@kernel
def _among(x, values, count):
    """Whether x is one of the first values."""
    found = False
    for k in range(count):
        found = found or values[k] == x
    return found


@kernel
def _sort(values, count):
    """Sort the first values, which are few; numpy's sort takes a second to compile."""
    for k in range(1, count):
        x = values[k]
        j = k
        while j > 0 and values[j - 1] > x:
            values[j] = values[j - 1]
            j -= 1
        values[j] = x


@kernel
def _known_cuts(g, quadrant, steps, coarse, kind, kinks, edge, cuts, corner):
    """Outer cuts at equal e-folds and where T = 1; how many they are, and how many are corners."""
    c, s, cp, sp, wx, wy = g[0], g[1], g[4], g[5], g[6], g[7]
    ca, sa, slant, layer = g[8], g[9], g[10], g[11]
    end = math.asinh(0.5 * math.pi / layer)
    m = steps + 1
    for k in range(m):
        cuts[k] = end * k / steps
    corners = 0
    # About R in slopes, the lobe itself shrinks from |T| = 1 on.
    if s > c and not coarse and (kind == 5 or (0 < kinks < _THIN and quadrant % 2 == 0)):
        tail = math.sqrt((s - c) * (s + c)) / c * slant
        along = wy * sa * cp - wx * ca * sp
        across = -wx * sa * sp - wy * ca * cp
        near = math.atan2(along, tail - across)
        far = math.atan2(along, tail + across)
        if quadrant == 1 or quadrant == 2:
            near, far = far, near
        for d in (near, math.pi - far):
            if 0.0 < d < 0.5 * math.pi:
                cuts[m] = math.asinh(d / layer)
                if kinks == 1 and kind != 0 and kind != 5 and edge > 1:
                    corner[corners] = cuts[m]
                    corners += 1
                m += 1
        _sort(cuts, m)
    return m, corners


@kernel
def _cut_at_axis(g, quadrant, along_x, ratio, factor, cuts, m):
    """Cut at distances in proportion, from `ratio` on, from the axis along x or y; return m."""
    turn = 1.0 if quadrant == 0 or quadrant == 3 else -1.0
    axis = turn * math.atan2(g[9], g[8]) + (0.0 if along_x else 0.5 * math.pi)
    axis -= math.pi * math.floor(axis / math.pi)
    for center in (axis - math.pi, axis):
        for side in (-1.0, 1.0):
            away = ratio
            while away < 1.0:
                d = center + side * away
                if 0.0 < d < 0.5 * math.pi and m < cuts.size:
                    cuts[m] = math.asinh(d / g[11])
                    m += 1
                away *= factor
    _sort(cuts, m)
    return m


@kernel
def _fall(g, quadrant, u, kind, reach):
    """E-folds by which a lobe has fallen where it meets n.v = n.l, at most `reach`."""
    cos_psi, _, width, _ = _azimuth(g, quadrant, u)
    big_t = g[1] / g[0] * cos_psi
    if big_t <= 0.0:
        return 0.0
    away = big_t / width
    if kind == 5:
        away *= g[0] * math.sqrt(1.0 + big_t * big_t)
    return min(away * away, reach)


@kernel
def _cut_unseen(g, quadrant, kind, reach, cuts, m):
    """Cut until few nodes see what lies beyond the kink n.v = n.l; return m.

    An elliptic lobe may be narrow at one end of a panel only, and the kink then cross most of it
    within a small part of the panel, and stay about where little is left in all the others.
    """
    least = 1e-9 * cuts[m - 1]
    k = 0
    while k < m - 1 and m < cuts.size:
        low, size = cuts[k], cuts[k + 1] - cuts[k]
        cut = -1.0
        if size > least:
            for end, side in ((low, 1.0), (low + size, -1.0)):
                here = _fall(g, quadrant, end + side * _HERE * size, kind, reach)
                if cut < 0.0 and here > _fall(g, quadrant, end, kind, reach) + _FOLDS:
                    cut = end + 0.25 * side * size
        if cut < 0.0:
            k += 1
            continue
        for j in range(m, k + 1, -1):
            cuts[j] = cuts[j - 1]
        cuts[k + 1] = cut
        m += 1
    return m


@kernel
def _change(g, quadrant, low, high, before, kind, kinks, decay, full, b):
    """The place between low and high where the arrangement ceases to be `before`."""
    for _ in range(45):
        middle = 0.5 * (low + high)
        if _pattern(g, quadrant, middle, kind, kinks, decay, full, b) == before:
            low = middle
        else:
            high = middle
    return low, high


@kernel
def _cut_at_changes(
    g, quadrant, probes, edge, kind, kinks, decay, full, cuts, m, corner, corners, b
):
    """Cut where the arrangement of the inner ends changes; return m and corners."""
    known = m
    for k in range(known - 1):
        low = cuts[k] + 1e-9 * (cuts[k + 1] - cuts[k])
        before = _pattern(g, quadrant, low, kind, kinks, decay, full, b)
        for probe in range(1, probes + 1):
            high = cuts[k] + (probe / probes - 1e-9) * (cuts[k + 1] - cuts[k])
            after = _pattern(g, quadrant, high, kind, kinks, decay, full, b)
            while after != before and m < cuts.size:
                left, right = _change(g, quadrant, low, high, before, kind, kinks, decay, full, b)
                cuts[m] = 0.5 * (left + right)
                if kind == 5 and edge > 1:
                    corner[corners] = cuts[m]
                    corners += 1
                m += 1
                # There may be a second change before the next probe.
                low = right
                before = _pattern(g, quadrant, right, kind, kinks, decay, full, b)
            low = high
    _sort(cuts, m)
    return m, corners


@kernel
def _join_slivers(cuts, m, corner, corners, least):
    """Take out cuts closer to the one before than `least`; return m and corners.

    Ends of inner panels are continuous across a cut, so the neighbour covers what lies between.
    """
    kept = 1
    for k in range(1, m):
        before, x = cuts[kept - 1], cuts[k]
        if x - before >= least:
            cuts[kept] = x
            kept += 1
            continue
        cuts[kept - 1] = x if k == m - 1 else before
        if _among(x, corner, corners) or _among(before, corner, corners):
            corner[corners] = cuts[kept - 1]
            corners += 1
    return kept, corners


@kernel
def _cut_opening(end, cuts, m):
    """Cut the panels that open where the core meets the kink, or beyond |T| = 1; return m.

    They are smooth only on the scale of the distance from psi = +-pi/2 to there.
    """
    known = m
    for k in range(1, known - 1):
        ratio = cuts[k + 1] / cuts[k]
        if 1e-9 * end < cuts[k] < 0.5 and ratio > 32.0:
            parts = math.ceil(math.log(ratio) / math.log(32.0))
            for j in range(1, parts):
                if m < cuts.size:
                    cuts[m] = cuts[k] * ratio ** (j / parts)
                    m += 1
    _sort(cuts, m)
    return m


@kernel
def _cut_between_corners(cuts, m, corner, corners):
    """Halve what has a corner at both ends: a panel is graded towards one end only."""
    known = m
    for k in range(known - 1):
        ends = _among(cuts[k], corner, corners) and _among(cuts[k + 1], corner, corners)
        if ends and m < cuts.size:
            cuts[m] = 0.5 * (cuts[k] + cuts[k + 1])
            m += 1
    _sort(cuts, m)
    return m


@kernel
def _outer_cuts(
    g, quadrant, steps, coarse, probes, kind, kinks, decay, full, edge, cuts, corner, b
):
    """Fill cuts and corner with the ends of the outer panels; return how many there are."""
    m, corners = _known_cuts(g, quadrant, steps, coarse, kind, kinks, edge, cuts, corner)
    if coarse:
        return m, corners
    front = quadrant % 2 == 0
    elliptic = kinks == 1 and decay != 0 and front and g[6] != g[7]
    if elliptic or kind == 5:
        # Seen from a lobe of widths w < W a kink moves as the inverse square of its width, which
        # has poles at a distance of w/W from where it is w.
        ratio = min(g[6], g[7]) / max(g[6], g[7])
        if ratio * _APART < 1.0:
            m = _cut_at_axis(g, quadrant, g[6] < g[7], ratio, _APART, cuts, m)
    if decay == 0 and g[14] != 1.0:
        # Beyond 45 degrees the lobe is narrow around the axis along which it is wide.
        ratio = min(g[14], 1.0 / g[14])
        m = _cut_at_axis(g, quadrant, g[14] < 1.0, ratio, _BEYOND, cuts, m)
    structure = kind, kinks, decay, full
    m, corners = _cut_at_changes(g, quadrant, probes, edge, *structure, cuts, m, corner, corners, b)
    if elliptic:
        known = m
        m = _cut_unseen(g, quadrant, kind, _REACH_FULL if full else _REACH, cuts, m)
        if m > known:
            # Smaller panels are probed more finely.
            m, corners = _cut_at_changes(
                g, quadrant, probes, edge, *structure, cuts, m, corner, corners, b
            )
    m, corners = _join_slivers(cuts, m, corner, corners, 1e-12 * cuts[m - 1])
    if (kinks == 1 and decay == 0 and front) or kind == 5:
        m = _cut_opening(cuts[m - 1], cuts, m)
    return _cut_between_corners(cuts, m, corner, corners), corners


@kernel
def _measure(g, quadrant, u0, u1, samples, layered, kind, kinks, decay, full, b, size, span):
    """Fill the largest size and the most e-folds of every inner panel between u0 and u1.

    Returns the number of inner panels, their arrangement and whether the last one is graded.
    """
    c = g[0]
    size[:] = 0.0
    span[:] = 0.0
    inner, pattern, graded = 0, -1, False
    for f in range(samples):
        # From one end to the other, and from 0.02 to 0.98 of the panel.
        u = u0 + (0.02 + 0.96 * f / (samples - 1)) * (u1 - u0)
        cos_psi, _, width, _ = _azimuth(g, quadrant, u)
        big_t = g[1] / c * cos_psi
        inner, pattern = _breaks(c, big_t, width, kind, kinks, decay, full, b)
        scale = _scale(c, big_t, width, kind, decay)
        tail = decay == 0 and pattern % 256 > 0
        graded = layered or decay == _LAYERED or (tail and not full)
        edge_panel = -1
        if graded:
            _split_edge(b, inner)
            edge_panel = inner
            inner += 1
        elif decay == 0 and full:
            # What is lost turns where n.v falls below the width, above the horizon.
            edge_panel = _split_horizon(b, inner, big_t)
            graded = True
            inner += 1
        for j in range(inner):
            size[j] = max(size[j], b[j + 1] - b[j])
            folds = math.asinh(b[j + 1] / scale) - math.asinh(b[j] / scale)
            if j == edge_panel:
                folds = math.asinh((b[j + 1] - b[j]) / _edge_layer(big_t, c, width, g[13]))
            span[j] = max(span[j], folds)
    return inner, pattern, graded


@kernel
def _panels(geometry, quadrants, coarse, fine, kind, kinks, decay, full, edge, row, code, box):
    """Fill row, code and box with all non-empty panels; return their number, or -1 if they do not
    fit: outer cuts at equal e-folds, at T = 1 and where the lobe's cut meets a kink; inner ones
    at the kinks."""
    cuts, corner = np.empty(160), np.empty(160)
    b, size, span = np.empty(12), np.empty(12), np.empty(12)
    probes, samples = (8, 3) if quadrants == 2 else (96, 17)
    if fine:
        probes, samples = 32 * probes, 65
    count = 0
    for i in range(geometry.shape[0]):
        g = geometry[i]
        end = math.asinh(0.5 * math.pi / g[11])
        steps = 1 if coarse else max(1, math.ceil(end / 5.0))
        for quadrant in range(quadrants):
            front = quadrant % 2 == 0
            m, corners = _outer_cuts(
                *(g, quadrant, steps, coarse, probes, kind, kinks, decay, full, edge),
                *(cuts, corner, b),
            )
            for k in range(m - 1):
                u0, u1 = cuts[k], cuts[k + 1]
                inner, pattern, graded = 1, -1, False
                size[0], span[0] = 1.0, 0.0
                if not coarse:
                    layered = (g[12] > 0.0 and front) or kinks == _THIN
                    inner, pattern, graded = _measure(
                        *(g, quadrant, u0, u1, samples, layered, kind, kinks, decay, full),
                        *(b, size, span),
                    )
                pruned = False
                for j in range(inner):
                    pruned = pruned or size[j] <= 0.0
                # A cut that moves unnoticed costs smoothness, but no energy.
                if decay != 0 and not pruned:
                    pattern = -1
                # Panels shrink to a point in an edge where the integrand has a root.
                at_start = _among(u0, corner, corners)
                shrinks = (inner > 1 or kind == 5) and (at_start or _among(u1, corner, corners))
                from_u, to_u = 0.0, 1.0
                if shrinks:
                    from_u = u0 if at_start else u1
                    to_u = u1 if at_start else u0
                for j in range(inner):
                    if size[j] <= 0.0:
                        continue
                    pieces = max(1, math.ceil(span[j] / 4.0))
                    if count + pieces > row.size:
                        return -1
                    for piece in range(pieces):
                        row[count] = i
                        code[count, 0] = quadrant
                        code[count, 1] = j
                        code[count, 2] = -inner if graded else inner
                        code[count, 3] = 2 if quadrants == 2 else 1
                        code[count, 4] = pattern
                        code[count, 5] = _CORNER if shrinks else 1
                        box[count, 0] = 0.0 if shrinks else u0
                        box[count, 1] = 1.0 if shrinks else u1
                        box[count, 2] = piece / pieces
                        box[count, 3] = (piece + 1) / pieces
                        box[count, 4] = from_u
                        box[count, 5] = to_u
                        count += 1
    return count


@kernel
def _adapt(b, found, pattern, expected):
    """Give a core to ends without one, or take it, where it only just fits below the last end.

    The core's end is no kink of the integrand: panels cover the same with it and without.
    """
    if pattern == 0 and expected == found:
        b[found + 1] = b[found]
        b[found] *= 1.0 - 1e-9
        return found + 1, expected
    if expected == 0 and pattern == found - 1:
        b[found - 1] = b[found]
        return found - 1, expected
    return found, pattern


@kernel
def _nodes(geometry, code, box, u, v, numbers, wi, wo, h, weight):
    """Directions, half vectors and Jacobians; one row per panel."""
    kind, kinks, decay, full = int(numbers[0]), int(numbers[1]), int(numbers[2]), numbers[3] != 0.0
    edge, origin = int(numbers[4]), int(numbers[5])
    b = np.empty(12)
    count = v.size
    exps, jacs, sines, cosines = np.empty(count), np.empty(count), np.empty(count), np.empty(count)
    for k in range(box.shape[0]):
        g = geometry[k]
        c, s, cos_phi, sin_phi = g[0], g[1], g[2], g[3]
        wi[0, k] = s * cos_phi
        wi[1, k] = s * sin_phi
        wi[2, k] = c
        quadrant, j, inner = code[k, 0], code[k, 1], abs(code[k, 2])
        graded = code[k, 2] < 0
        u0, u1, v0, v1, corner, far = box[k]
        power = code[k, 5]
        front = quadrant % 2 == 0
        from_origin = origin > 1 and j == 0 and c < 0.1 and front
        # At grazing incidence the kink n.v = n.l lies close to the horizon.
        last = inner - 1 if not graded else (0 if kinks == 1 and inner == 3 else -1)
        to_edge = edge > 1 and j == last
        for iu in range(u.size):
            place = u0 + (u1 - u0) * u[iu]
            slope = power * abs(far - corner) * place ** (power - 1)
            place = corner + (far - corner) * place**power
            cos_psi, sin_psi, width, turn = _azimuth(g, quadrant, place)
            big_t = s / c * cos_psi
            found, pattern = _breaks(c, big_t, width, kind, kinks, decay, full, b)
            scale = _scale(c, big_t, width, kind, decay)
            if decay == 0 and pattern != code[k, 4] and code[k, 4] >= 0:
                found, pattern = _adapt(b, found, pattern, code[k, 4])
            # A panel that is not what it was taken for: better no value than a wrong one.
            sound = 1.0 if pattern == code[k, 4] or code[k, 4] < 0 else math.nan
            edge_panel = -1
            if graded and full:
                edge_panel = _split_horizon(b, found, big_t)
            elif graded:
                _split_edge(b, found)
                edge_panel = found
            elif inner == 1 and found > 1:
                b[1] = b[found]  # one panel over all kinks (budget too small to split)
            at_edge = graded and j == edge_panel
            if at_edge:
                scale = _edge_layer(big_t, c, width, g[13])
                s0 = math.asinh((b[j + 1] - b[j]) / scale)
                s1 = 0.0
            else:
                s0 = math.asinh(b[j] / scale) if j > 0 else 0.0
                s1 = math.asinh(b[j + 1] / scale)
            outer = sound * code[k, 3] * turn * slope * (u1 - u0) * (v1 - v0) * abs(s1 - s0)
            for iv in range(count):
                x = v0 + (v1 - v0) * v[iv]
                stretch = 1.0
                if from_origin:
                    stretch = origin * x ** (origin - 1)
                    x = x**origin
                elif to_edge:
                    stretch = edge * (1.0 - x) ** (edge - 1)
                    x = 1.0 - (1.0 - x) ** edge
                exps[iv] = math.exp(s0 + (s1 - s0) * x)
                jacs[iv] = outer * stretch
            _radial(exps, scale, b[j + 1] if at_edge else -1.0, sines, cosines, jacs)
            _directions(
                *(g, cos_psi, sin_psi, kind, full, sines, cosines, jacs),
                *(k, iu * count, wo, h, weight),
            )


@kernel
def _radial(exps, scale, edge, sines, cosines, jacs):
    """Sines and cosines of delta, and jacs times d(delta)/ds, from e = exp(s).

    tan(delta/2) is scale sinh(s), or so much less than `edge` where that is positive.
    """
    if edge > 0.0:
        for i in range(exps.size):
            e = exps[i]
            t = edge - 0.5 * scale * (e - 1.0 / e)
            inverse = 1.0 / (1.0 + t * t)
            sines[i] = 2.0 * t * inverse
            cosines[i] = (1.0 - t) * (1.0 + t) * inverse
            jacs[i] *= scale * (e + 1.0 / e) * inverse
    else:
        for i in range(exps.size):
            e = exps[i]
            a = 0.5 * scale * (e * e - 1.0)  # e tan(delta/2): one division does for all
            inverse = 1.0 / (e * e + a * a)
            sines[i] = 2.0 * a * e * inverse
            cosines[i] = (e - a) * (e + a) * inverse
            jacs[i] *= scale * (e * e + 1.0) * e * inverse


@kernel
def _directions(g, cos_psi, sin_psi, kind, full, sines, cosines, jacs, k, first, wo, h, weight):
    """V, L + V and the weights along one azimuth."""
    c, s, cos_phi, sin_phi = g[0], g[1], g[2], g[3]
    slopes = kind == 0 or kind == 5
    retro = kind == 2 or kind == 4
    t = s * cos_psi
    for i in range(sines.size):
        sin_delta, cos_delta = sines[i], cosines[i]
        sin_2 = 2.0 * sin_delta * cos_delta
        two_sin2 = 2.0 * sin_delta * sin_delta
        n_dot_v = c * (1.0 - two_sin2) + t * sin_2
        l_dot_h = c * cos_delta + t * sin_delta
        if slopes:
            along = 2.0 * l_dot_h * sin_delta * cos_psi
            across = 2.0 * l_dot_h * sin_delta * sin_psi
            jac = jacs[i] * 4.0 * l_dot_h * sin_delta
        else:
            along = two_sin2 * s + sin_2 * cos_psi * c
            across = sin_2 * sin_psi
            jac = jacs[i] * 2.0 * sin_2
        if not full:
            n_dot_v = n_dot_v if n_dot_v > 0.0 else 0.0
            jac *= n_dot_v
        v_along, v_across = along - s, across
        if retro:
            v_along, v_across = -v_along, -v_across
            along, across = v_along + s, v_across
        j = first + i
        wo[0, k, j] = v_along * cos_phi - v_across * sin_phi
        wo[1, k, j] = v_along * sin_phi + v_across * cos_phi
        wo[2, k, j] = n_dot_v
        h[0, k, j] = along * cos_phi - across * sin_phi
        h[1, k, j] = along * sin_phi + across * cos_phi
        # Beyond the horizon the sum cancels; there only slopes go.
        h[2, k, j] = 2.0 * l_dot_h * cos_delta if full else c + n_dot_v
        weight[k, j] = jac
