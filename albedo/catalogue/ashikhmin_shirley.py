"""Ashikhmin and Shirley 2000: anisotropic Phong with a Fresnel-coupled diffuse term."""

from __future__ import annotations

import math

from albedo._compile import kernel
from albedo.brdf import Alias, Choice, Model, Part, Real
from albedo.catalogue._blinn import slope_chart, slope_width
from albedo.charts.cosine import CosineChart
from albedo.fresnel import schlick
from albedo.geometry import normal_power, v_dot_h
from albedo.sampling.routines import normal_powers


@kernel
def coupling(cosine):
    """1 - (1 - cosine/2)^5, expanded so that nothing cancels at grazing angles."""
    x = 0.5 * cosine
    return x * (5.0 + x * (-10.0 + x * (10.0 + x * (-5.0 + x))))


@kernel
def fill_specular(wi, wo, h, p, out):
    """f_s = sqrt((n_u+1)(n_v+1))/(8 pi) (n.h)^(n_u cos^2 + n_v sin^2) F/(v.h max(n.l, n.v))."""
    for j in range(out.shape[0]):
        lz, n_u, n_v, scale, r_s = wi[2, j], p[j, 0], p[j, 1], p[j, 2], p[j, 3]
        for i in range(out.shape[1]):
            hx, hy, hz = h[0, j, i], h[1, j, i], h[2, j, i]
            x2, y2 = (hx / hz) ** 2, (hy / hz) ** 2
            tan2 = x2 + y2
            n = (n_u * x2 + n_v * y2) / tan2 if tan2 > 0.0 else n_u
            u = v_dot_h(hx, hy, hz)
            larger = max(lz, wo[2, j, i])
            out[j, i] = scale * normal_power(tan2, n) * schlick(r_s, u) / (u * larger)


@kernel
def fill_diffuse(wi, wo, h, p, out):
    """f_d = 28 r_d/(23 pi) (1 - r_s) (1 - (1 - n.l/2)^5)(1 - (1 - n.v/2)^5), or r_d/pi."""
    for j in range(out.shape[0]):
        scale, lambert = p[j, 4], p[j, 5]
        light = coupling(wi[2, j])
        for i in range(out.shape[1]):
            if lambert > 0.0:
                out[j, i] = scale
            else:
                out[j, i] = scale * light * coupling(wo[2, j, i])


class AshikhminShirley(Model):
    """f = f_s + f_d (Ashikhmin and Shirley 2000, eqs. 4 and 5).

    ``diffuse="lambert"`` replaces the coupled diffuse term by r_d/pi, ``"none"`` drops it;
    ``specular="none"`` drops the specular lobe.
    """

    name = "ashikhmin_shirley"
    title = "Ashikhmin-Shirley anisotropic Phong"
    equation = "AS eqs. 4, 5; Schwenk eq. 42"
    references = ("ashikhmin2000", "schwenk2011")
    tables = ("n=1..1e6/32log", "n_u=1..1e4/16log,n_v=100")
    domain = "n=0.001..1e9/61log"

    n_u = Real(100.0, "exponent along the tangent", low=0.0, high=1e9)
    n_v = Real(100.0, "exponent along the bitangent", low=0.0, high=1e9)
    n = Alias(None, "isotropic exponent", targets=("n_u", "n_v"))
    r_s = Real(1.0, "specular reflectance at normal incidence", low=0.0, high=1.0)
    r_d = Real(0.0, "diffuse reflectance of the substrate", low=0.0, high=1.0)
    specular = Choice("paper", "specular term", choices=("paper", "none"))
    diffuse = Choice("paper", "diffuse term", choices=("paper", "lambert", "none"))

    @property
    def isotropic(self) -> bool:
        return self.n_u == self.n_v or self.specular == "none"

    @property
    def conserves_energy(self) -> bool:  # type: ignore[override]
        """A Lambertian diffuse term is added without regard to what the coat reflects."""
        return self.diffuse != "lambert" or self.r_d == 0.0 or self.specular == "none"

    def pack(self) -> tuple[float, ...]:
        scale = math.sqrt((self.n_u + 1.0) * (self.n_v + 1.0)) / (8.0 * math.pi)
        lambert = self.diffuse == "lambert"
        coupled = 28.0 * self.r_d / (23.0 * math.pi) * (1.0 - self.r_s)
        diffuse = self.r_d / math.pi if lambert else coupled
        return (self.n_u, self.n_v, scale, self.r_s, diffuse, float(lambert))

    def parts(self) -> tuple[Part, ...]:
        parts = []
        if self.specular == "paper":
            chart = slope_chart(min(self.n_u, self.n_v), "max")
            widths = (slope_width(self.n_u), slope_width(self.n_v))
            routine = normal_powers(self.n_u, self.n_v)
            parts.append(Part("specular", fill_specular, chart, widths, routine=routine))
        if self.diffuse != "none" and self.r_d > 0.0:
            parts.append(Part("diffuse", fill_diffuse, CosineChart()))
        return tuple(parts)
