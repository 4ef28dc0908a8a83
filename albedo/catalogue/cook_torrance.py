"""Cook and Torrance 1982: microfacets with a distribution, a masking function and Fresnel."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from albedo._compile import kernel
from albedo.brdf import Alias, Choice, Part, Real
from albedo.catalogue._fresnel import SOURCES_OF_FACTORS, FresnelChoice
from albedo.charts.polar import PolarChart
from albedo.charts.tail_rings import TailRingsChart
from albedo.errors import InputError
from albedo.fresnel import fresnel, is_careful
from albedo.geometry import divided, one_less_v_dot_h, slopes, v_dot_h
from albedo.microfacet import (
    DISTRIBUTIONS,
    GEOMETRIES,
    RATIONAL_END,
    cavity_cosines,
    correlated_cosines,
    distribution,
    distribution_root,
    hidden_cosine,
)
from albedo.sampling.routines import (
    Routine,
    gaussian_normals,
    ggx_normals,
    normal_powers,
    visible_normals,
)


@kernel
def fill(wi, wo, h, p, out):
    """f = F(v.h) D(h) G(l, v, h) / (4 n.l n.v)."""
    for j in range(out.shape[0]):
        lx, ly, lz = wi[0, j], wi[1, j], wi[2, j]
        dist, geometry, kx, ky, scale = int(p[j, 0]), int(p[j, 1]), p[j, 2], p[j, 3], p[j, 4]
        ax2, ay2, prefactor = p[j, 5], p[j, 6], p[j, 7]
        f_code, f_a, f_b, f_c = int(p[j, 8]), p[j, 9], p[j, 10], p[j, 11]
        careful = is_careful(f_code, f_a)
        hidden_l = 0.0
        if geometry >= 2:
            hidden_l = hidden_cosine(geometry, dist, ax2, ay2, lx, ly, lz)
        for i in range(out.shape[1]):
            vz = wo[2, j, i]
            if min(lz, vz) <= 0.0:
                out[j, i] = 0.0
                continue
            hx, hy, hz = h[0, j, i], h[1, j, i], h[2, j, i]
            u = v_dot_h(hx, hy, hz)
            x, y, lift = slopes(hx, hy, hz)
            # G/(n.l n.v) as 1/(a b): with masking no cosine is divided by alone.
            a, b = lz, vz
            if geometry == 1:
                a, b = cavity_cosines(hz, lz, vz, u)
            elif geometry >= 2:
                vx, vy = wo[0, j, i], wo[1, j, i]
                hidden_v = hidden_cosine(geometry, dist, ax2, ay2, vx, vy, vz)
                a, b = lz + hidden_l, vz + hidden_v
                if geometry == 3:
                    a, b = correlated_cosines(lz, hidden_l, vz, hidden_v)
            less = (
                one_less_v_dot_h(lx, ly, lz, wo[0, j, i], wo[1, j, i], vz, u) if careful else -1.0
            )
            f = prefactor * fresnel(f_code, f_a, f_b, f_c, u, less)
            root = distribution_root(dist, kx, ky, x * x, y * y, lift)
            out[j, i] = divided(f * scale, root, a, b)


@kernel
def loss(wi, wo, h, p, out):
    """D (G1(l) - F G2(l, v)) / (4 n.l): what the weak white furnace integral of 1 loses."""
    for j in range(out.shape[0]):
        lx, ly, lz = wi[0, j], wi[1, j], wi[2, j]
        dist, geometry, kx, ky, scale = int(p[j, 0]), int(p[j, 1]), p[j, 2], p[j, 3], p[j, 4]
        ax2, ay2 = p[j, 5], p[j, 6]
        f_code, f_a, f_b, f_c = int(p[j, 8]), p[j, 9], p[j, 10], p[j, 11]
        careful = is_careful(f_code, f_a)
        hidden_l = hidden_cosine(geometry, dist, ax2, ay2, lx, ly, lz) if geometry >= 2 else 0.0
        for i in range(out.shape[1]):
            hx, hy, hz, vz = h[0, j, i], h[1, j, i], h[2, j, i], wo[2, j, i]
            u = v_dot_h(hx, hy, hz)
            # G1/n.l and G2/n.l: with masking no cosine is divided by alone.
            g1 = 1.0 / (lz + hidden_l)
            if geometry == 1:
                g1 = min(1.0 / lz, hz / u / u)
            g2, lost = 0.0, g1
            if vz > 0.0 and geometry == 1:
                # What is the same must be so in every digit.
                g2 = g1 if vz >= lz else min(1.0 / lz, hz / u / u * (vz / lz))
                lost = g1 - g2
            elif vz > 0.0:
                hidden_v = hidden_cosine(geometry, dist, ax2, ay2, wo[0, j, i], wo[1, j, i], vz)
                rest = vz + hidden_v
                if geometry == 3:
                    # (1 + Lambda_l + Lambda_v) n.v; light that is not hidden hides nothing.
                    rest += vz * (hidden_l / lz)
                    g2 = vz / rest / lz
                else:
                    g2 = g1 * (vz / rest)
                lost = g1 * (hidden_v / rest)
            less = (
                one_less_v_dot_h(lx, ly, lz, wo[0, j, i], wo[1, j, i], vz, u) if careful else -1.0
            )
            absorbed = (1.0 - fresnel(f_code, f_a, f_b, f_c, u, less)) * g2
            x, y, lift = slopes(hx, hy, hz)
            d = 0.25 * distribution(dist, kx, ky, scale, x * x, y * y, lift)
            out[j, i] = d * (lost + absorbed) if d > 0.0 else 0.0


@lru_cache(maxsize=4096)
def gaussian_scale(m: float) -> float:
    """1 / (2 pi int exp(-t^2/m^2) cos t sin t dt), Gauss-Legendre in t = m s."""
    x, w = np.polynomial.legendre.leggauss(64)
    top = min(0.5 * math.pi, 8.0 * m)
    t = 0.5 * top * (x + 1.0)
    integral = float(np.sum(0.5 * top * w * np.exp(-((t / m) ** 2)) * np.cos(t) * np.sin(t)))
    return 1.0 / (2.0 * math.pi * integral)


_WIDTHS = ("beckmann", "ggx", "gaussian")
# Distributions whose constant in print is not that of the projected integral.
_PRINTED = ("gaussian", "ashikhmin_shirley")


class CookTorrance(FresnelChoice):
    """f = F(v.h) D(h) G(l, v, h) / (4 n.l n.v) (Cook and Torrance 1982; NNS eqs. 9 and 10).

    ``prefactor="1/pi"`` is the 1982 text, F/pi with the un-normalised D = exp(-tan^2/m^2)/(m^2
    cos^4): four times as bright.

    ``normalization="paper"`` takes D with the constant that is printed where that differs: for
    gaussian Schwenk's arbitrary c as 1/(pi m^2), for ashikhmin_shirley the constant
    sqrt((n_u + 1)(n_v + 1))/(2 pi) of the density p_h that it is taken from, whose integral over
    solid angle is 1. (Schwenk's eq. 39 prints no 1/(2 pi); that is 2 pi times as much.) Both are
    darker than D with a projected integral of 1. Beckmann's D without pi is what
    ``prefactor="1/pi"`` means.

    ``geometry="none"`` is G = 1, which NNS eq. 12 puts in G's place. `smith` uses the exact
    masking of beckmann and ggx; the other distributions borrow beckmann's of the same slope.
    ``smith_rational`` is the rational fit to beckmann's, and ``schlick_smith`` Schlick's
    approximation, which masks more than both; they are products of two directions' own.
    """

    name = "cook_torrance"
    title = "Cook-Torrance microfacets"
    equation = "NNS eqs. 9, 10; Schwenk eqs. 33 to 39"
    references = (
        *("cook1982", "walter2007", "neumann_pumping", "schwenk2011"),
        *SOURCES_OF_FACTORS,
    )
    tables = ("m=0.02..1/32", "alpha_x=0.02..1/16,alpha_y=0.2")
    domain = "m=1e-8..10/46log"

    alpha_x = Real(0.1, "roughness along the tangent, sqrt(2) x rms slope", low=1e-8, high=10.0)
    alpha_y = Real(0.1, "roughness along the bitangent", low=1e-8, high=10.0)
    m = Alias(None, "isotropic roughness", targets=("alpha_x", "alpha_y"))
    n_u = Real(200.0, "exponent along the tangent", low=0.0, high=1e9)
    n_v = Real(200.0, "exponent along the bitangent", low=0.0, high=1e9)
    n = Alias(None, "isotropic exponent", targets=("n_u", "n_v"))
    distribution = Choice("beckmann", "distribution D", choices=tuple(DISTRIBUTIONS))
    normalization = Choice(
        "microfacet", "projected integral 1, or as printed", choices=("microfacet", "paper")
    )
    geometry = Choice("v_cavity", "masking-shadowing G", choices=tuple(GEOMETRIES))
    prefactor = Choice("1/4", "modern form, or the text of 1982", choices=("1/4", "1/pi"))

    def used(self, values: Mapping[str, Any]) -> tuple[str, ...]:
        kind = values["distribution"]
        others = {"n_u", "n_v"} if kind in _WIDTHS else {"alpha_x", "alpha_y"}
        if kind not in _PRINTED:
            others.add("normalization")
        return tuple(name for name in super().used(values) if name not in others)

    def __init__(self, /, **values: Any) -> None:
        super().__init__(**values)
        ax, ay = self._sharpness
        if ax != ay and self.distribution in ("gaussian", "blinn_phong"):
            raise InputError(
                f"cook_torrance: {self.distribution} is isotropic; give one value, not {ax:g} and "
                f"{ay:g}"
            )
        if self.geometry == "smith_rational" and self.distribution == "ggx":
            raise InputError(
                "cook_torrance: geometry = 'smith_rational' is a fit for beckmann; ggx has smith"
            )

    @property
    def _sharpness(self) -> tuple[float, float]:
        if self.distribution in _WIDTHS:
            return self.alpha_x, self.alpha_y
        return self.n_u, self.n_v

    @property
    def isotropic(self) -> bool:
        ax, ay = self._sharpness
        return ax == ay

    @property
    def _exact_masking(self) -> bool:
        """Whether the light that facets see is the light that arrives: the loss rests on it."""
        smith = self.geometry in ("smith", "smith_correlated")
        return self.geometry == "v_cavity" or (smith and self.distribution in ("beckmann", "ggx"))

    @property
    def conserves_energy(self) -> bool:  # type: ignore[override]
        """G = 1, a masking that is not the distribution's, or the 1982 prefactor lose the bound.

        Schlick's masking is dark enough for all, and the fit to beckmann's for beckmann. With the
        constants as printed a borrowed masking suffices, but for correlated needles.
        """
        if self.geometry == "none" or self.prefactor == "1/pi":
            return False
        if self._as_printed:
            return self.geometry != "smith_correlated" or self.distribution == "gaussian"
        own = self.geometry == "smith_rational" and self.distribution == "beckmann"
        return self._exact_masking or self.geometry == "schlick_smith" or own

    @property
    def _as_printed(self) -> bool:
        return self.parameters.get("normalization") == "paper"

    @property
    def grazing_limit(self) -> bool:  # type: ignore[override]
        """Without masking the albedo grows as 1/n.l."""
        return self.geometry != "none"

    def pack(self) -> tuple[float, ...]:
        ax, ay = self._sharpness
        if self.distribution == "gaussian" and not self._as_printed:
            scale = gaussian_scale(ax)
        elif self.distribution in _WIDTHS:
            scale = 1.0 / (math.pi * ax * ay)
        else:
            more = 1.0 if self._as_printed else 2.0
            scale = math.sqrt((ax + more) * (ay + more)) / (2.0 * math.pi)
        slope_x, slope_y = self._slopes
        widths = self.distribution in _WIDTHS
        kx, ky = (1.0 / slope_x, 1.0 / slope_y) if widths else (ax, ay)
        return (
            *(DISTRIBUTIONS[self.distribution], GEOMETRIES[self.geometry], kx, ky, scale),
            *(slope_x, slope_y, 0.25 if self.prefactor == "1/4" else 1.0),
            *self.pack_fresnel(),
        )

    @property
    def _slopes(self) -> tuple[float, float]:
        """Squares of the widths, in slopes, that masking knows."""
        ax, ay = self._sharpness
        if self.distribution in _WIDTHS:
            return ax * ax, ay * ay
        return 2.0 / (ax + 2.0), 2.0 / (ay + 2.0)

    def parts(self) -> tuple[Part, ...]:
        ax, ay = self._sharpness
        powers = self.distribution not in _WIDTHS
        decay = {"beckmann": "gaussian", "ggx": "algebraic", "gaussian": "algebraic"}
        kind = decay.get(self.distribution, "cosine_power")
        if self.distribution == "gaussian" and ax < 0.03:
            kind = "gaussian"  # from here on an angle is a slope: the tail may be cut
        if self.distribution == "beckmann" and max(ax, ay) > 1.0:
            kind = "algebraic"  # wider than the hemisphere: there is no tail to cut
        kinks = "v_cavity" if self.geometry == "v_cavity" else "none"
        edge = 4 if powers and min(ax, ay) < 16 else 1
        if powers:
            ax, ay = math.sqrt(2.0 / max(ax, 2.0)), math.sqrt(2.0 / max(ay, 2.0))
        # Smith's factors turn where n.v passes n.l, next to the mirror direction at grazing.
        origin = 1 if self.geometry in ("none", "v_cavity") else 2
        # Measured: up to seven times fewer evaluations for elliptic lobes with these maskings.
        layered = self.geometry in ("smith_correlated", "schlick_smith") and not self.isotropic
        layer = 1 if layered and self.distribution == "ggx" else 0
        chart: Any = PolarChart("slope", kinks, kind, edge, origin, layer=layer)
        if self.distribution == "ggx" and kinks == "none" and self.isotropic:
            chart = TailRingsChart()
        known = self._exact_masking and self.prefactor == "1/4" and not self._as_printed
        whole = PolarChart("slope", kinks, kind, edge, origin, full=True)
        lost, routine = loss if known else None, self._routine()
        heights = self._heights()
        return (
            Part("specular", fill, chart, (ax, ay), lost, whole, heights=heights, routine=routine),
        )

    def _heights(self) -> tuple[float, ...]:
        """Where the rational fit to the masking ends, if that is a ring."""
        if self.geometry != "smith_rational" or not self.isotropic:
            return ()
        tangent = 1.0 / (RATIONAL_END * math.sqrt(self._slopes[0]))
        return (1.0 / math.sqrt(1.0 + tangent * tangent),)

    def _routine(self) -> Routine:
        """Visible normals where the masking is Smith's own, else normals."""
        kind, (ax, ay) = self.distribution, self._sharpness
        if kind not in _WIDTHS:
            # D n.h is one power more than D.
            return normal_powers(ax + 1.0, ay + 1.0)
        if kind in ("beckmann", "ggx") and self.geometry in ("smith", "smith_correlated"):
            return visible_normals(kind, ax, ay)
        if kind == "beckmann":
            return gaussian_normals(ax, ay)
        # The Gaussian of an angle falls as slowly as GGX where it is wide.
        return ggx_normals(ax, ay)
