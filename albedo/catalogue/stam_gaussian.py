"""Stam 1999: diffraction by an anisotropic Gaussian random surface."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from albedo._compile import kernel
from albedo.brdf import Choice, Part, Real
from albedo.catalogue._fresnel import SOURCES_OF_FACTORS, FresnelChoice
from albedo.catalogue._orders import ALONE, SIDE, fill_series, poisson_series
from albedo.charts.polar import PolarChart
from albedo.charts.rings import RingsChart
from albedo.fresnel import fresnel, is_careful
from albedo.geometry import one_less_v_dot_h, v_dot_h
from albedo.sampling.routines import ggx_normals


@kernel
def fill(wi, wo, h, p, out):
    """f = F (1 + l.v)^2/(lambda^2 w^2 n.l n.v) S_p, w = n.l + n.v, 1 + l.v = 2 (v.h)^2.

    S_p = pi t_x t_y sum of e^-g g^m/(m! m) exp(-k^2 (u^2 t_x^2 + v^2 t_y^2)/(4 m)), where
    g = (k w sigma)^2 and (u, v) is the tangential part of l + v.
    """
    count = out.shape[1]
    g, c = np.empty(count, out.dtype), np.empty(count, out.dtype)
    root, rest = np.empty(count, out.dtype), np.empty(count, out.dtype)
    room = np.empty(8, out.dtype), np.empty(8, out.dtype), np.empty(8, out.dtype)
    side = (
        *(np.empty(SIDE, out.dtype), np.empty(SIDE, out.dtype), np.empty(SIDE, out.dtype)),
        *(np.empty(SIDE, out.dtype), np.empty(SIDE, out.dtype)),
    )
    for j in range(out.shape[0]):
        lx, ly, lz = wi[0, j], wi[1, j], wi[2, j]
        k2s2, x2, y2, scale = p[j, 0], p[j, 1], p[j, 2], p[j, 3]
        f_code, f_a, f_b, f_c = int(p[j, 4]), p[j, 5], p[j, 6], p[j, 7]
        careful = is_careful(f_code, f_a)
        for i in range(count):
            vz = wo[2, j, i]
            if min(lz, vz) <= 0.0:
                g[i] = c[i] = root[i] = rest[i] = 0.0
                continue
            hx, hy, w = h[0, j, i], h[1, j, i], h[2, j, i]
            u = v_dot_h(hx, hy, w)
            less = (
                one_less_v_dot_h(lx, ly, lz, wo[0, j, i], wo[1, j, i], vz, u) if careful else -1.0
            )
            factor = scale * k2s2 * max(fresnel(f_code, f_a, f_b, f_c, u, less), 0.0)
            # S_p/w^2 has the series over g, and w^2 in its g.
            g[i], c[i] = k2s2 * w * w, 0.25 * (x2 * hx * hx + y2 * hy * hy)
            root[i] = 2.0 * u * u * math.sqrt(factor) / math.sqrt(lz)
            rest[i] = 1.0 / math.sqrt(vz)
        if count < ALONE:
            for i in range(count):
                out[j, i] = poisson_series(g[i], c[i], root[i], rest[i], room)
        else:
            fill_series(g, c, root, rest, side, room, out[j])


@kernel
def _mirror_shares(cos_theta, p, out):
    """F e^-g at the mirror direction: the energy of the Dirac part."""
    for i in range(out.size):
        c, out[i] = cos_theta[i], 0.0
        if c > 0.0:
            out[i] = fresnel(int(p[4]), p[5], p[6], p[7], c) * math.exp(-4.0 * p[0] * c * c)


class StamGaussian(FresnelChoice):
    """f = F (1 + l.v)^2/(lambda^2 w^2 n.l n.v) S_p, plus a mirror part F e^-g (Stam 1999).

    Kirchhoff's theory of a surface of Gaussian heights with the correlation lengths t_x and t_y,
    without shadowing: with t_x = t_y it is the directional diffuse part of He and Torrance where
    neither shadowing nor the effective roughness sets in. The mirror part carries F e^-g of the
    energy, g = (2 k n.l sigma)^2. All lengths are in micrometres. Without shadowing the albedo
    grows as 1/n.l. The primary text was out of reach; He and Torrance's formula fixes the constant.
    """

    name = "stam_gaussian"
    title = "Stam's diffraction by a random surface"
    equation = "after Stam 1999"
    references = ("stam1999", "he1991", *SOURCES_OF_FACTORS)
    tables = ("sigma=0.02..0.5/32", "sigma=0.02..0.5/16,t_x=3,t_y=1")
    domain = "sigma=0.003..1/11log"
    conserves_energy = False
    grazing_limit = False

    sigma = Real(0.1, "rms height of the surface", "um", low=1e-4, high=100.0)
    t_x = Real(1.7, "correlation length along the tangent", "um", low=1e-2, high=1e4)
    t_y = Real(1.7, "correlation length along the bitangent", "um", low=1e-2, high=1e4)
    wavelength = Real(0.5, "wavelength of the light", "um", low=1e-2, high=1e3)
    mirror = Choice("on", "mirror part", choices=("on", "off"))

    def used(self, values: Mapping[str, Any]) -> tuple[str, ...]:
        others = super().used(values)
        return tuple(name for name in values if name in others or name == "wavelength")

    @property
    def isotropic(self) -> bool:
        return self.t_x == self.t_y

    def pack(self) -> tuple[float, ...]:
        wave = 2.0 * math.pi / self.wavelength
        return (
            *((wave * self.sigma) ** 2, (wave * self.t_x) ** 2, (wave * self.t_y) ** 2),
            math.pi * self.t_x * self.t_y / self.wavelength**2,
            *self.pack_fresnel(),
        )

    def parts(self) -> tuple[Part, ...]:
        lengths = (self.t_x, self.t_y)
        # Slopes of the facets, or of one wave.
        height = max(2.0 * self.sigma, self.wavelength / (2.0 * math.pi))
        widths = height / lengths[0], height / lengths[1]
        waves = self.wavelength / (2.0 * math.pi * min(lengths))
        around = RingsChart("projected", waves=waves, around=self.fresnel_around)
        rings = around if self.isotropic else None
        chart = PolarChart("slope", edge=2)
        # On a smooth surface next to the horizon the lobe of waves is wider in slopes.
        smooth = self.isotropic and 2.0 * math.pi * self.sigma <= self.wavelength
        routine = ggx_normals(2.0 * waves, 2.0 * waves) if smooth else None
        return (Part("diffracted", fill, chart, widths, rings=rings, routine=routine),)

    def spikes(self, wi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if self.mirror == "off":
            return super().spikes(wi)
        directions = wi * np.array([-1.0, -1.0, 1.0])
        share = np.empty(wi.shape[0])
        _mirror_shares(np.ascontiguousarray(wi[:, 2]), np.array(self.pack()), share)
        return directions[None], share[None]
