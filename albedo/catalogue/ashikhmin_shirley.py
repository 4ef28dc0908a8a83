"""Ashikhmin and Shirley 2000: anisotropic Phong with a Fresnel-coupled diffuse term."""

from __future__ import annotations

import math

from albedo._compile import kernel
from albedo.brdf import Alias, Choice, Model, Part, Real
from albedo.catalogue._blinn import slope_chart, slope_width
from albedo.charts.cosine import CosineChart
from albedo.charts.rings import RingsChart, octaves
from albedo.fresnel import CAREFUL, schlick, schlick_rest
from albedo.geometry import along_azimuth, divided, normal_root, one_less_v_dot_h, v_dot_h
from albedo.sampling.routines import normal_powers


@kernel
def coupling(cosine):
    """1 - (1 - cosine/2)^5, expanded so that nothing cancels at grazing angles."""
    return schlick_rest(0.5 * cosine)


@kernel
def fill_specular(wi, wo, h, p, out):
    """f_s = sqrt((n_u+1)(n_v+1))/(8 pi) (n.h)^(n_u cos^2 + n_v sin^2) F/(v.h max(n.l, n.v))."""
    for j in range(out.shape[0]):
        lx, ly, lz = wi[0, j], wi[1, j], wi[2, j]
        n_u, n_v, scale, r_s = p[j, 0], p[j, 1], p[j, 2], p[j, 3]
        for i in range(out.shape[1]):
            hx, hy, hz = h[0, j, i], h[1, j, i], h[2, j, i]
            root = normal_root(hx, hy, hz, along_azimuth(n_u, n_v, hx, hy))
            u = v_dot_h(hx, hy, hz)
            vx, vy, vz = wo[0, j, i], wo[1, j, i], wo[2, j, i]
            less = one_less_v_dot_h(lx, ly, lz, vx, vy, vz, u) if r_s < CAREFUL else -1.0
            factor = schlick(r_s, u, less)
            out[j, i] = divided(scale * factor, root, u, max(lz, vz))


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

    def simpler(self) -> dict[str, Model]:
        """Also Lambert's diffuse term, with what the coat lets through at normal incidence."""
        found = super().simpler()
        if self.diffuse == "paper" and self.r_d > 0.0:
            left = self.r_d * (1.0 - self.r_s)
            found["the coupling of the diffuse term"] = self.replace(diffuse="lambert", r_d=left)
        return found

    def parts(self) -> tuple[Part, ...]:
        parts = []
        if self.specular == "paper":
            chart = slope_chart(min(self.n_u, self.n_v), "max")
            widths = (slope_width(self.n_u), slope_width(self.n_v))
            routine = normal_powers(self.n_u, self.n_v)
            parts.append(Part("specular", fill_specular, chart, widths, routine=routine))
        if self.diffuse != "none" and self.r_d > 0.0:
            # Alone it leaves an albedo that falls to 0 towards the horizon.
            fades = self.specular == "none" and self.diffuse == "paper"
            rings = RingsChart("broad", "max", levels=octaves) if fades else None
            parts.append(Part("diffuse", fill_diffuse, CosineChart(), rings=rings))
        return tuple(parts)
