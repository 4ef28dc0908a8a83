"""Ashikhmin and Premoze 2007: a BRDF that is little more than a distribution of half vectors."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from albedo._compile import kernel
from albedo.brdf import Alias, Choice, Part, Real, Vectors
from albedo.catalogue._blinn import slope_chart, slope_width
from albedo.catalogue._fresnel import SOURCES_OF_FACTORS, FresnelChoice
from albedo.charts.polar import PolarChart
from albedo.errors import InputError
from albedo.fresnel import fresnel, is_careful
from albedo.geometry import divided, one_less_v_dot_h, slopes, v_dot_h
from albedo.microfacet import DISTRIBUTIONS, distribution_root
from albedo.sampling.routines import COSINE, gaussian_normals, ggx_normals, normal_powers

_VELVET = -1


@kernel
def velvet(a, scale, tan2):
    """p = (1 + 4 exp(-cot^2/a^2)/sin^4)/(pi (1 + 4 a^2)): hairs that stand up, and a ground."""
    hairs = 0.0
    if a * a * tan2 > 1e-3:
        inverse = 1.0 + 1.0 / tan2
        hairs = 4.0 * math.exp(-1.0 / (a * a * tan2)) * inverse * inverse
    return scale * (1.0 + hairs)


@kernel
def fill(wi, wo, h, p, out):
    """f = F(v.h) p(h)/(4 (n.l + n.v - (n.l)(n.v)))."""
    for j in range(out.shape[0]):
        lx, ly, lz = wi[0, j], wi[1, j], wi[2, j]
        code, kx, ky, scale = int(p[j, 0]), p[j, 1], p[j, 2], p[j, 3]
        f_code, f_a, f_b, f_c = int(p[j, 4]), p[j, 5], p[j, 6], p[j, 7]
        careful = is_careful(f_code, f_a)
        for i in range(out.shape[1]):
            hx, hy, hz, vz = h[0, j, i], h[1, j, i], h[2, j, i], wo[2, j, i]
            x, y, lift = slopes(hx, hy, hz)
            u = v_dot_h(hx, hy, hz)
            less = (
                one_less_v_dot_h(lx, ly, lz, wo[0, j, i], wo[1, j, i], vz, u) if careful else -1.0
            )
            k = fresnel(f_code, f_a, f_b, f_c, u, less) * scale
            lower = 4.0 * (lz + vz * (1.0 - lz))
            if code < 0:
                out[j, i] = velvet(kx, k, x * x + y * y) / lower
            else:
                root = distribution_root(code, kx, ky, x * x, y * y, lift)
                out[j, i] = divided(k, root, lower, 1.0)


@kernel
def log_density(knots, angle):
    """Cubic pieces in the angle of h, constant before the first and beyond the last one.

    Five numbers for each: where it starts, and its coefficients from the third power down.
    """
    first, last = 0, knots.size // 5 - 1
    if angle <= knots[0]:
        return knots[4]
    if angle >= knots[5 * last]:
        return knots[5 * last + 4]
    while last - first > 1:
        middle = (first + last) // 2
        if knots[5 * middle] <= angle:
            first = middle
        else:
            last = middle
    t = angle - knots[5 * first]
    k = 5 * first
    return ((knots[k + 1] * t + knots[k + 2]) * t + knots[k + 3]) * t + knots[k + 4]


@kernel
def fill_tabulated(wi, wo, h, p, out):
    """f = F(v.h) p(h)/(4 (n.l + n.v - (n.l)(n.v))), log p a spline in the angle of h."""
    for j in range(out.shape[0]):
        lx, ly, lz, scale = wi[0, j], wi[1, j], wi[2, j], p[j, 0]
        f_code, f_a, f_b, f_c = int(p[j, 1]), p[j, 2], p[j, 3], p[j, 4]
        careful = is_careful(f_code, f_a)
        for i in range(out.shape[1]):
            hx, hy, hz, vz = h[0, j, i], h[1, j, i], h[2, j, i], wo[2, j, i]
            density = scale * math.exp(log_density(p[j, 5:], math.atan2(math.hypot(hx, hy), hz)))
            u = v_dot_h(hx, hy, hz)
            less = (
                one_less_v_dot_h(lx, ly, lz, wo[0, j, i], wo[1, j, i], vz, u) if careful else -1.0
            )
            factor = fresnel(f_code, f_a, f_b, f_c, u, less)
            out[j, i] = factor * density / (4.0 * (lz + vz * (1.0 - lz)))


def recover_distribution(retro: ArrayLike, cos_theta: ArrayLike, f0: float = 1.0) -> np.ndarray:
    """The distribution that a measured retro-reflection implies.

    Parameters
    ----------
    retro : array_like
        Values f(L, L) of a BRDF, in 1/sr.
    cos_theta : array_like
        Cosines of the angles at which they were measured, in (0, 1].
    f0 : float
        Fresnel factor at normal incidence, in (0, 1].

    Returns
    -------
    ndarray
        p(h) at these angles, in 1/sr: 4 f (2 n.h - (n.h)^2)/F0, from f at L = V = H. The model
        takes them as its ``density``, with ``distribution="tabulated"``.

    Raises
    ------
    InputError
        For cosines or a factor out of range.
    """
    f, c = np.asarray(retro, dtype=float), np.asarray(cos_theta, dtype=float)
    if not np.all((c > 0.0) & (c <= 1.0)):
        raise InputError(f"cos_theta = {cos_theta!r} is out of range; it must lie in (0, 1]")
    if not 0.0 < f0 <= 1.0:
        raise InputError(f"f0 = {f0!r} is out of range; it must lie in (0, 1]")
    return 4.0 * f * c * (2.0 - c) / f0


@dataclass(frozen=True)
class _Density(Vectors):
    """A table of at least two angles that ascend."""

    def check(self, model: str, value: Any) -> tuple[tuple[float, ...], ...]:
        """As `Vectors`; the angles ascend."""
        pairs = super().check(model, value)
        angles = [angle for angle, _ in pairs]
        if len(pairs) < 2 or any(b <= a for a, b in itertools.pairwise(angles)):
            raise InputError(
                f"{model}: {self.name} has the angles {angles}; "
                "it must hold at least two, in ascending order"
            )
        return pairs


@lru_cache(maxsize=256)
def _spline(density: tuple[tuple[float, float], ...]) -> np.ndarray:
    """Where each piece of log p starts, and its coefficients; the last row is its end."""
    from scipy.interpolate import CubicSpline

    angles, p = np.array(density).T
    spline = CubicSpline(angles, np.log(p), bc_type="clamped")
    pieces = np.column_stack((angles[:-1], spline.c.T))
    return np.vstack((pieces, (angles[-1], 0.0, 0.0, 0.0, math.log(p[-1]))))


def _integral(table: np.ndarray, projected: bool, order: int) -> float:
    """The integral of a tabulated p over half vectors, times n.h when `projected`."""
    ends = np.unique(np.concatenate(([0.0], table[:, 0], [0.5 * math.pi])))
    x, w = np.polynomial.legendre.leggauss(order)
    # Eight parts of each piece, because log p may fall by decades within one.
    parts = (ends[:-1, None] + np.diff(ends)[:, None] * np.arange(8) / 8.0).ravel()
    size = np.repeat(np.diff(ends) / 8.0, 8)[:, None]
    angle = parts[:, None] + 0.5 * (x + 1.0) * size
    flat = table.ravel()
    p = np.exp([log_density(flat, float(a)) for a in angle.ravel()]).reshape(angle.shape)
    height = np.cos(angle) if projected else 1.0
    return float(np.sum(0.5 * w * size * p * height * 2.0 * math.pi * np.sin(angle)))


def _width(table: np.ndarray) -> float:
    """The angle at which p has fallen to 1/e of what it is at the normal; 1 if it rises first."""
    flat = table.ravel()
    angles = np.geomspace(1e-6, 1.0, 241)
    fall = np.array([log_density(flat, float(a)) for a in angles]) - table[0, 4]
    low = np.flatnonzero((fall < -1.0) | (fall > 0.5))
    first = int(low[0]) if low.size else -1
    return float(angles[first]) if first >= 0 and fall[first] < 0.0 else 1.0


class DistributionBrdf(FresnelChoice):
    """f = F(v.h) p(h)/(4 (n.l + n.v - (n.l)(n.v))) (Ashikhmin and Premoze 2007).

    p may be any density. With ``normalization="projected"`` its integral over n.h is 1, as
    renderers take it; with ``"solid_angle"`` its integral over directions is 1, and then the
    albedo is at most that of F: n.l + n.v - (n.l)(n.v) is at least the larger cosine.

    ``velvet`` is (1 + 4 exp(-cot^2/a^2)/sin^4)/(pi (1 + 4 a^2)) in the angle of h, whose projected
    integral is 1.

    ``tabulated`` takes p from ``density``, pairs of an angle of h and a value, as measured: log p
    is the cubic spline through them with slope 0 at both ends, and constant beyond. It is
    normalised like the others, or taken ``as_given``: then its retro-reflection is the table's.
    """

    name = "distribution_brdf"
    title = "distribution-based BRDF"
    equation = "Ashikhmin and Premoze 2007"
    references = ("ashikhmin2007", "walter2007", *SOURCES_OF_FACTORS)
    tables = ("m=0.02..1/32", "alpha_x=0.02..1/16,alpha_y=0.2")
    domain = "m=1e-8..10/46log"

    alpha_x = Real(0.1, "roughness along the tangent, sqrt(2) x rms slope", low=1e-8, high=10.0)
    alpha_y = Real(0.1, "roughness along the bitangent", low=1e-8, high=10.0)
    m = Alias(None, "isotropic roughness", targets=("alpha_x", "alpha_y"))
    n = Real(100.0, "blinn_phong: exponent", low=0.0, high=1e9)
    spread = Real(0.5, "velvet: spread a of the hairs", low=0.05, high=10.0)
    distribution = Choice(
        "beckmann", "density p", choices=("beckmann", "ggx", "blinn_phong", "velvet", "tabulated")
    )
    density = _Density(
        ((0.0, 1.0), (0.5 * math.pi, 1.0)),
        "tabulated: angles of h to the normal, ascending, and p there",
        entries=(
            ("theta_h", Real(0.0, "angle of h", "rad", low=0.0, high=1.5707963267948966)),
            ("p", Real(1.0, "density", "1/sr", low=0.0, high=1e100, open_low=True)),
        ),
    )
    normalization = Choice(
        "projected",
        "what of p integrates to 1; tabulated: or nothing",
        choices=("projected", "solid_angle", "as_given"),
    )

    def used(self, values: Mapping[str, Any]) -> tuple[str, ...]:
        own = {"blinn_phong": ("n",), "velvet": ("spread",), "tabulated": ("density",)}
        kept = own.get(values["distribution"], ("alpha_x", "alpha_y"))
        dropped = {"alpha_x", "alpha_y", "n", "spread", "density"} - set(kept)
        if values["distribution"] == "velvet":
            dropped.add("normalization")
        return tuple(name for name in super().used(values) if name not in dropped)

    def __init__(self, /, **values: Any) -> None:
        super().__init__(**values)
        if self._by_solid_angle and not self.isotropic:
            raise InputError(
                "distribution_brdf: normalization = 'solid_angle' needs one roughness, not "
                f"{self.alpha_x:g} and {self.alpha_y:g}"
            )
        if self.parameters.get("normalization") == "as_given" and self.distribution != "tabulated":
            raise InputError(
                "distribution_brdf: normalization = 'as_given' is for distribution = 'tabulated', "
                f"not {self.distribution!r}"
            )

    @property
    def _by_solid_angle(self) -> bool:
        return self.parameters.get("normalization") == "solid_angle"

    @property
    def isotropic(self) -> bool:
        p = self.parameters
        return p.get("alpha_x") == p.get("alpha_y")

    @property
    def conserves_energy(self) -> bool:  # type: ignore[override]
        """With a projected integral of 1 up to m = 2 for ggx and 2 sqrt(pi) for beckmann.

        There the albedo at grazing incidence, m/2 and m/(2 sqrt(pi)), reaches 1. A table may be
        anything.
        """
        if self.distribution == "tabulated":
            return self._by_solid_angle
        largest = {"beckmann": 2.0 * math.sqrt(math.pi), "ggx": 2.0}.get(self.distribution)
        if largest is None or self._by_solid_angle:
            return True
        return bool(max(self.alpha_x, self.alpha_y) <= largest)

    def pack(self) -> tuple[float, ...]:
        kind = self.distribution
        if kind == "tabulated":
            table = _spline(self.density)
            return (1.0 / self._whole(table)[0], *self.pack_fresnel(), *table.ravel())
        if kind == "velvet":
            a = self.spread
            numbers: tuple[float, ...] = (_VELVET, a, a, 1.0 / (math.pi * (1.0 + 4.0 * a * a)))
        elif kind == "blinn_phong":
            more = 1.0 if self._by_solid_angle else 2.0
            numbers = (DISTRIBUTIONS[kind], self.n, self.n, (self.n + more) / (2.0 * math.pi))
        else:
            ax, ay = self.alpha_x, self.alpha_y
            scale = 1.0 / (math.pi * ax * ay)
            if self._by_solid_angle:
                scale /= solid_angle(kind, ax)
            numbers = (DISTRIBUTIONS[kind], ax**-2.0, ay**-2.0, scale)
        return (*numbers, *self.pack_fresnel())

    def _whole(self, table: np.ndarray) -> tuple[float, float]:
        """What a tabulated density is divided by, and its relative error."""
        if self.parameters["normalization"] == "as_given":
            return 1.0, 0.0
        coarse, fine = (_integral(table, not self._by_solid_angle, k) for k in (20, 30))
        # A rule of 20 nodes errs by what 30 move; sums of positive terms round a few times.
        return fine, abs(fine - coarse) / fine + 16.0 * float(np.finfo(float).eps)

    def parts(self) -> tuple[Part, ...]:
        kind = self.distribution
        if kind == "tabulated":
            table = _spline(self.density)
            width = _width(table)
            return (
                Part(
                    *("specular", fill_tabulated, PolarChart("slope", origin=2), (width, width)),
                    columns=(0, len(self.pack())),
                    doubt=self._whole(table)[1],
                ),
            )
        if kind == "velvet":
            chart = PolarChart("slope", edge=2, origin=2)
            return (Part("specular", fill, chart, (1.0, 1.0), routine=COSINE),)
        if kind == "blinn_phong":
            widths = (slope_width(self.n),) * 2
            routine = normal_powers(self.n, self.n)
            return (Part("specular", fill, slope_chart(self.n), widths, routine=routine),)
        ax, ay = self.alpha_x, self.alpha_y
        cut = kind == "beckmann" and max(ax, ay) <= 1.0
        # Measured: up to seven times fewer evaluations for elliptic lobes.
        layer = 1 if kind == "ggx" and ax != ay else 0
        decay = "gaussian" if cut else "algebraic"
        chart = PolarChart("slope", decay=decay, origin=2, layer=layer)
        routine = ggx_normals(ax, ay) if kind == "ggx" else gaussian_normals(ax, ay)
        return (Part("specular", fill, chart, (ax, ay), routine=routine),)


def solid_angle(kind: str, m: float) -> float:
    """The integral of D over solid angle, for beckmann and ggx of one roughness.

    GGX: 1 + m^2 artanh(b)/b, b^2 = 1 - m^2 (arctan beyond 1). Beckmann, with s = 1/m:
    1 + sqrt(pi) m erfcx(s)/2.
    """
    if kind == "beckmann":
        from scipy.special import erfcx

        return 1.0 + 0.5 * math.sqrt(math.pi) * m * float(erfcx(1.0 / m))
    b2 = (1.0 - m) * (1.0 + m)
    if abs(b2) < 1e-4:
        return 1.0 + m * m * (1.0 + b2 / 3.0 + b2 * b2 / 5.0 + b2**3 / 7.0)
    b = math.sqrt(abs(b2))
    # artanh(b) = log((1 + b)/m), where 1 - b would cancel.
    turn = math.log((1.0 + b) / m) if b2 > 0.0 else math.atan(b)
    return 1.0 + m * m * turn / b
