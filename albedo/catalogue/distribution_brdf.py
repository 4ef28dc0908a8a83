"""Ashikhmin and Premoze 2007: a BRDF that is little more than a distribution of half vectors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from albedo._compile import kernel
from albedo.brdf import Alias, Choice, Part, Real
from albedo.catalogue._blinn import slope_chart, slope_width
from albedo.catalogue._fresnel import SOURCES_OF_FACTORS, FresnelChoice
from albedo.charts.polar import PolarChart
from albedo.errors import InputError
from albedo.fresnel import fresnel
from albedo.geometry import v_dot_h
from albedo.microfacet import DISTRIBUTIONS, distribution

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
        lz = wi[2, j]
        code, kx, ky, scale = int(p[j, 0]), p[j, 1], p[j, 2], p[j, 3]
        f_code, f_a, f_b, f_c = int(p[j, 4]), p[j, 5], p[j, 6], p[j, 7]
        for i in range(out.shape[1]):
            hx, hy, hz, vz = h[0, j, i], h[1, j, i], h[2, j, i], wo[2, j, i]
            x, y = hx / hz, hy / hz
            if code < 0:
                density = velvet(kx, scale, x * x + y * y)
            else:
                density = distribution(code, kx, ky, scale, x * x, y * y)
            factor = fresnel(f_code, f_a, f_b, f_c, v_dot_h(hx, hy, hz))
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
        p(h) at these angles, in 1/sr: 4 f (2 n.h - (n.h)^2)/F0, from f at L = V = H.

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


class DistributionBrdf(FresnelChoice):
    """f = F(v.h) p(h)/(4 (n.l + n.v - (n.l)(n.v))) (Ashikhmin and Premoze 2007).

    p may be any density. With ``normalization="projected"`` its integral over n.h is 1, as
    renderers take it; with ``"solid_angle"`` its integral over directions is 1, and then the
    albedo is at most that of F: n.l + n.v - (n.l)(n.v) is at least the larger cosine.

    ``velvet`` is (1 + 4 exp(-cot^2/a^2)/sin^4)/(pi (1 + 4 a^2)) in the angle of h, whose projected
    integral is 1.
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
        "beckmann", "density p", choices=("beckmann", "ggx", "blinn_phong", "velvet")
    )
    normalization = Choice(
        "projected", "what of p integrates to 1", choices=("projected", "solid_angle")
    )

    def used(self, values: Mapping[str, Any]) -> tuple[str, ...]:
        own = {"blinn_phong": ("n",), "velvet": ("spread",)}
        kept = own.get(values["distribution"], ("alpha_x", "alpha_y"))
        dropped = {"alpha_x", "alpha_y", "n", "spread"} - set(kept)
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

        There the albedo at grazing incidence, m/2 and m/(2 sqrt(pi)), reaches 1.
        """
        largest = {"beckmann": 2.0 * math.sqrt(math.pi), "ggx": 2.0}.get(self.distribution)
        if largest is None or self._by_solid_angle:
            return True
        return bool(max(self.alpha_x, self.alpha_y) <= largest)

    def pack(self) -> tuple[float, ...]:
        kind = self.distribution
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

    def parts(self) -> tuple[Part, ...]:
        kind = self.distribution
        if kind == "velvet":
            return (Part("specular", fill, PolarChart("slope", edge=2, origin=2), (1.0, 1.0)),)
        if kind == "blinn_phong":
            widths = (slope_width(self.n),) * 2
            return (Part("specular", fill, slope_chart(self.n), widths),)
        ax, ay = self.alpha_x, self.alpha_y
        cut = kind == "beckmann" and max(ax, ay) <= 1.0
        chart = PolarChart("slope", decay="gaussian" if cut else "algebraic", origin=2)
        return (Part("specular", fill, chart, (ax, ay)),)


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
