"""Granier and Heidrich 2003: a clear layer over a base, with a colour by interference."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np

from albedo._compile import kernel
from albedo.brdf import Choice, Color, Model, Part, Real
from albedo.catalogue._phong import mirror_chart, mirror_width
from albedo.charts.cosine import CosineChart
from albedo.charts.polar import PolarChart
from albedo.fresnel import dielectric, dielectric_transmittance
from albedo.geometry import cosine_difference, cosine_root, mirror_root


@kernel
def fill_top(wi, wo, h, p, out):
    """f = k_s F(n.l) (r.v)^e0."""
    for j in range(out.shape[0]):
        lx, ly, lz = wi[0, j], wi[1, j], wi[2, j]
        ior, e0 = p[j, 0], p[j, 1]
        scale = p[j, 2] * dielectric(ior, lz)
        for i in range(out.shape[1]):
            vx, vy, vz = wo[0, j, i], wo[1, j, i], wo[2, j, i]
            hx, hy, hz = h[0, j, i], h[1, j, i], h[2, j, i]
            root = mirror_root(lx, ly, lz, vx, vy, vz, hx, hy, hz, e0)
            out[j, i] = scale * root * root


@kernel
def fill_bottom(wi, wo, h, p, out):
    """f = k_s (1 - F(n.l))(1 - F(n.v)) (r'.v')^e1 for the refracted directions l' and v'."""
    for j in range(out.shape[0]):
        lx, ly, lz = wi[0, j], wi[1, j], wi[2, j]
        ior, e1 = p[j, 0], p[j, 3]
        scale = p[j, 4] * dielectric_transmittance(ior, lz)
        bent = (ior - 1.0) * (ior + 1.0)
        inside_l = math.sqrt(bent + lz * lz) if bent > 0.0 else lz
        for i in range(out.shape[1]):
            hx, hy, hz, vz = h[0, j, i], h[1, j, i], h[2, j, i], wo[2, j, i]
            # n.l' = inside_l/ior, so n.l' - n.v' = (n.l - n.v)(n.l + n.v)/(ior (sum of both)).
            dz = cosine_difference(lx, ly, lz, hx, hy, hz, vz) * hz
            inside_v = math.sqrt(bent + vz * vz) if bent > 0.0 else vz
            dz /= inside_l + inside_v
            d2 = (hx * hx + hy * hy + dz * dz) / (ior * ior)
            across = lx * wo[0, j, i] + ly * wo[1, j, i]
            root = cosine_root(d2, (inside_l * inside_v - across) / (ior * ior), e1)
            out[j, i] = scale * dielectric_transmittance(ior, vz) * root * root


@kernel
def fill_diffuse(wi, wo, h, p, out):
    """f = k_d C J_d/pi."""
    for j in range(out.shape[0]):
        for i in range(out.shape[1]):
            out[j, i] = p[j, 5]


class GranierHeidrich(Model):
    """f = k_d C J_d/pi + k_s J_s (after Granier and Heidrich 2003).

    J_s = F(n.l)(r.v)^e0 + (1 - F(n.l))(1 - F(n.v))(r'.v')^e1: the top of the layer reflects about
    the mirror direction, the base about that of the refracted directions. J_d = 1/2 + cos(4 pi ior
    d/wavelength) sqrt(t (1 - t)) with t = 80/21 ior/(ior + 1)^2, the mean transmittance.

    The primary text was out of reach: this follows a public port, with one normal for top and base
    and without a phase on the specular path. The lobes carry no constant; with
    ``normalization="phong"`` each has (e + 2)/(2 pi). ``ior``, ``wavelength`` and ``color`` take a
    number per channel, such as wavelengths of 0.645, 0.525 and 0.445. F(n.l) alone in the first
    lobe is not reciprocal.
    """

    name = "granier_heidrich"
    title = "Granier-Heidrich layered RGB model"
    equation = "after Granier and Heidrich 2003"
    references = ("granier2003", "schwenk2011")
    tables = ("thickness=0..1/32",)
    domain = "ior=1..3/11,thickness=0..0.5/11"

    ior = Color(1.5, "relative index of refraction of the layer", low=1.0, high=10.0)
    thickness = Real(0.5, "thickness of the layer", "um", low=0.0, high=1e3)
    wavelength = Color(0.525, "wavelength of the light", "um", low=1e-2, high=1e3)
    e0 = Real(100.0, "exponent of the top", low=0.0, high=1e6)
    e1 = Real(20.0, "exponent of the base", low=4.0, high=1e6)
    k_d = Real(1.0, "weight of the diffuse term", low=0.0, high=1.0)
    k_s = Real(1.0, "weight of the specular term", low=0.0, high=1.0)
    color = Color(1.0, "colour C of the base", low=0.0, high=1.0)
    normalization = Choice("none", "constant of the lobes", choices=("none", "phong"))

    @property
    def reciprocal(self) -> bool:  # type: ignore[override]
        """The top reflects by the angle of the light alone."""
        return self.k_s == 0.0 or bool(np.all(np.equal(self.ior, 1.0)))

    @property
    def conserves_energy(self) -> bool:  # type: ignore[override]
        """Nothing keeps the sum of the terms below 1."""
        return self.k_s == 0.0

    def _constant(self, e: float) -> float:
        return self.k_s * ((e + 2.0) / (2.0 * math.pi) if self.normalization == "phong" else 1.0)

    def pack(self) -> tuple[float, ...]:
        n = self.ior
        t = 80.0 / 21.0 * n / (n + 1.0) ** 2
        # The path in wavelengths is exact, and so is what is left of it modulo 1.
        waves = 2 * Fraction(n) * Fraction(self.thickness) / Fraction(self.wavelength)
        j_d = 0.5 + math.cos(2.0 * math.pi * float(waves % 1)) * math.sqrt(t * (1.0 - t))
        return (
            *(n, self.e0, self._constant(self.e0), self.e1, self._constant(self.e1)),
            self.k_d * self.color * j_d / math.pi,
        )

    def parts(self) -> tuple[Part, ...]:
        top = mirror_chart(self.e0), (mirror_width(self.e0),) * 2
        # Refraction widens the lobe by the index, and by more along the elevation at grazing.
        wide = min(1.0, self.ior * mirror_width(self.e1))
        bottom = PolarChart("mirror_hemisphere", edge=2), (wide, wide)
        if self.ior == 1.0:
            bottom = mirror_chart(self.e1), (mirror_width(self.e1),) * 2
        return (
            Part("diffuse", fill_diffuse, CosineChart()),
            Part("top", fill_top, *top),
            Part("bottom", fill_bottom, *bottom),
        )
