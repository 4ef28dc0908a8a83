"""Where the masking of Cook-Torrance (NNS eq. 10) is one, and where H stays near the normal.

Both sets of V are intervals of azimuth about the plane of incidence at every elevation of V. With
c = n.l, z = n.v and an azimuth of V that is psi away from that of the mirror direction, G = 1 is
cos(psi) >= (1 + c z - 2 (c + z) min(c, z))/(s_l s_v), s the sines. In that plane V lies between a
third and three times the elevation of L, where that is at most 30 degrees. In the slopes (x, y)
of H, with x along L, the same set is x <= cot(theta) on one side of the circle x^2 + y^2 = x
tan(theta), where n.v = n.l, and (3 + x tan(theta)) (1 + x^2 + y^2) <= 4 (1 + x tan(theta)) on the
other.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from albedo.integrators.rules import gauss

_EPS = float(np.finfo(float).eps)

LIMIT = 2.0 * math.pi + 8.0 / 3.0 * (1.0 - math.atanh(3.0**-0.5) / 3.0**0.5)
"""Solid angle of G = 1 over (n.l)^2, as n.l tends to 0.

With z = c t the interval is psi <= c w(t): w^2 = 4 - (t - 1)^2 for 1 <= t <= 3, which is half of a
circle, and w^2 = 3 t^2 + 2 t - 1 for 1/3 <= t <= 1. The integral of 2 w is LIMIT.
"""


@dataclass(frozen=True)
class Region:
    """Directions V above the horizon, for L in the plane y = 0 with the elevation `elevation`.

    Attributes
    ----------
    elevation : float
        Angle between L and the horizon, radians: above 0, at most pi/2.
    g_one : bool
        Only those with G = 1.
    cap : float or None
        Only those with an angle of H to the normal of at most this, radians.
    """

    elevation: float
    g_one: bool = False
    cap: float | None = None

    @property
    def c(self) -> float:
        """n.l."""
        return math.sin(self.elevation)

    def half_width(self, z: np.ndarray) -> np.ndarray:
        """Largest azimuth psi from the mirror direction at n.v = z; pi where all belong.

        cos(psi) >= (1 + c z - X)/(s_l s_v), X = 2 (c + z) min(c, z) for G = 1, and
        (c + z)^2/(2 cos^2(cap)) for the cap, since |l + v|^2 = 2 (1 + l.v). As half-angle sines:
        sin^2(psi/2) <= (X - c z - (1 - s_l s_v))/(2 s_l s_v), where nothing cancels as c -> 0.
        """
        c = self.c
        sines = math.cos(self.elevation) * np.sqrt((1.0 - z) * (1.0 + z))
        most = np.full(np.shape(z), np.inf)
        if self.g_one:
            most = 2.0 * (c + z) * np.minimum(c, z)
        if self.cap is not None:
            most = np.minimum(most, (c + z) ** 2 / (2.0 * math.cos(self.cap) ** 2))
        excess = most - c * z - (c * c + z * z - (c * z) ** 2) / (1.0 + sines)
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            square = np.where(excess > 0.0, excess / (2.0 * sines), 0.0)
        return 2.0 * np.arcsin(np.sqrt(np.minimum(square, 1.0)))

    def edges(self) -> list[float]:
        """n.v of the lowest and the highest V, and where the half width has a kink between."""
        e, c = self.elevation, self.c
        low, high, kinks = 0.0, 1.0, []
        if self.g_one:
            low = math.sin(e / 3.0)
            # In the plane of incidence V ends at three times the elevation of L; for L above 45
            # degrees, where that would be past L, on the side of L at 30 degrees + e/3 to N.
            end = math.sin(3.0 * e) if e < 0.25 * math.pi else math.cos(math.pi / 6.0 + e / 3.0)
            if e < math.pi / 6.0:
                high = end
            kinks += [c, end]
        if self.cap is not None:
            low = max(low, math.sin(max(0.0, e - 2.0 * self.cap)))
            end = math.sin(e + 2.0 * self.cap)
            if e + 2.0 * self.cap < 0.5 * math.pi:
                high = min(high, end)
            kinks.append(end)
            if self.g_one:
                # 2 (c + z) min(c, z) = (c + z)^2/(2 cos^2(cap)).
                ratio = 4.0 * math.cos(self.cap) ** 2 - 1.0
                kinks += [c / ratio, c * ratio]
        return [low, *sorted({kink for kink in kinks if low < kink < high}), high]

    def slope_limit(self, x: np.ndarray | float) -> np.ndarray:
        """Largest |y| of the slopes of H at a slope x; 0 where there is none."""
        along = x * math.cos(self.elevation) / self.c
        most = 1.0 + 2.0 * along - np.square(x)  # the horizon
        if self.g_one:
            # 2 NH NV >= VH; the other condition ends the interval of x.
            most = np.minimum(most, (1.0 + 3.0 * along) / (3.0 + along) - np.square(x))
        if self.cap is not None:
            most = np.minimum(most, math.tan(self.cap) ** 2 - np.square(x))
        return np.sqrt(np.maximum(most, 0.0))

    def slope_edges(self) -> list[float]:
        """Slopes x of H, along L, where the region begins, has kinks and ends."""
        e = self.elevation
        low, high, kinks = -math.tan(0.5 * e), 1.0 / math.tan(0.5 * e), []
        cotangent = math.tan(e)
        if self.g_one:
            low, high = -math.tan(e / 3.0), math.tan(min(e, (math.pi - e) / 3.0))
        if self.cap is not None:
            t = math.tan(self.cap)
            low, high = max(low, -t), min(high, t)
            kinks = [cotangent * (t * t - 1.0) / 2.0]
            if self.g_one:
                kinks = [cotangent * (3.0 * t * t - 1.0) / (3.0 - t * t)]
        return [low, *sorted(kink for kink in kinks if low < kink < high), high]


def over_hemisphere(region: Region, m: float | None = None) -> tuple[float, float]:
    """Integral over V in elevation and azimuth, by products of Gauss-Legendre rules.

    Parameters
    ----------
    region : Region
        Where.
    m : float, optional
        Integrate f n.v of Cook-Torrance with Beckmann's D of this roughness and G = 1, which is
        D/(4 n.l), instead of 1.

    Returns
    -------
    value, error : float
        The integral, and what changed from rules of two thirds of the nodes, with roundings: of
        a cap the half width is a difference that is smaller by its square.
    """
    coarse, fine = (_product(region, m, nodes) for nodes in (48, 72))
    roundings = 100.0 + (0.0 if region.cap is None else 20.0 / region.cap**2)
    return fine, abs(fine - coarse) + roundings * _EPS * abs(fine)


def _product(region: Region, m: float | None, nodes: int) -> float:
    rule = gauss(nodes)
    points, weights = rule.nodes, rule.weights
    c, s = region.c, math.cos(region.elevation)
    # The half width ends like a root: sin^2 makes it smooth.
    rise = np.sin(0.5 * math.pi * points) ** 2
    slope = 0.5 * math.pi * np.sin(math.pi * points) * weights
    total = 0.0
    for a, b in itertools.pairwise(region.edges()):
        z = a + (b - a) * rise
        width = region.half_width(z)
        inner = width
        if m is not None:
            psi = width[:, None] * points
            sines = np.sqrt((1.0 - z) * (1.0 + z))
            # tan^2 of the angle of H: the tangential part of l + v over its part along n.
            radial = ((z - c) * (z + c) / (s + sines))[:, None]
            across = 4.0 * s * sines[:, None] * np.sin(0.5 * psi) ** 2
            t2 = (radial**2 + across) / ((c + z) ** 2)[:, None]
            values = np.exp(-t2 / m**2) * (1.0 + t2) ** 2 / (4.0 * c * math.pi * m**2)
            inner = width * (values @ weights)
        total += 2.0 * (b - a) * float(inner @ slope)
    return total


def over_slopes(region: Region, m: float | None = None) -> tuple[float, float]:
    """The same integral over the slopes of H: closed across L, adaptive along it.

    dV = 4 (l.h) dh and dh = dx dy/q^(3/2), q = 1 + x^2 + y^2, with l.h = (x s + c)/sqrt(q); so
    dV = 4 (x s + c)/q^2 dx dy, and D/(4 n.l) dV = (x s + c)/c exp(-(x^2 + y^2)/m^2)/(pi m^2) dx dy.

    Parameters
    ----------
    region, m
        As for `over_hemisphere`.

    Returns
    -------
    value, error : float
        The integral, and the error that the adaptive quadrature estimates.
    """
    from scipy.integrate import quad
    from scipy.special import erf

    c, s = region.c, math.cos(region.elevation)

    def across(x: float) -> float:
        y = float(region.slope_limit(x))
        if m is not None:
            bell = math.exp(-((x / m) ** 2)) / (math.sqrt(math.pi) * m)
            return (x * s + c) / c * bell * float(erf(y / m))
        a = math.hypot(1.0, x)
        return 4.0 * (x * s + c) * (y / (a * a + y * y) + math.atan(y / a) / a) / (a * a)

    value = error = 0.0
    for low, high in itertools.pairwise(region.slope_edges()):

        def smooth(t: float, low: float = low, high: float = high) -> float:
            there = low + (high - low) * math.sin(0.5 * math.pi * t) ** 2
            return across(there) * 0.5 * math.pi * math.sin(math.pi * t) * (high - low)

        part, spread = quad(smooth, 0.0, 1.0, epsabs=0.0, epsrel=1e-11, limit=200)
        value, error = value + part, error + spread
    return value, error + 100.0 * _EPS * abs(value)


def measure(region: Region, m: float | None = None) -> tuple[float, float]:
    """The integral by both ways; the error is the sum of theirs and their difference."""
    value, error = over_slopes(region, m)
    other, more = over_hemisphere(region, m)
    return value, error + more + abs(value - other)


def outline(region: Region, points: int = 160) -> tuple[np.ndarray, np.ndarray]:
    """n.v and azimuth from the mirror direction along the boundary of a region, once around."""
    rise = np.sin(np.linspace(0.0, 0.5 * math.pi, points)) ** 2
    z = np.concatenate([a + (b - a) * rise for a, b in itertools.pairwise(region.edges())])
    psi = region.half_width(z)
    part = psi < math.pi
    if not part.any():
        ring = np.linspace(-math.pi, math.pi, 4 * points)
        return np.full(ring.shape, region.edges()[0]), ring
    turn = np.linspace(-1.0, 1.0, points)
    # Where all azimuths belong, the two sides have met; elsewhere an arc closes the top.
    top = turn if part.all() else turn[:0]
    z, psi = z[part], psi[part]
    return (
        np.concatenate((z, np.full(top.size, z[-1]), z[::-1], np.full(points, z[0]))),
        np.concatenate((psi, -top * psi[-1], -psi[::-1], turn * psi[0])),
    )
