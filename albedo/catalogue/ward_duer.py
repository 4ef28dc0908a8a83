"""Ward's lobe as Duer renormalised it in 2006: over the product of both cosines."""

from __future__ import annotations

import math

from albedo._compile import kernel
from albedo.brdf import Model, Part, Real
from albedo.catalogue._ward import M, alpha
from albedo.charts.polar import PolarChart
from albedo.geometry import divided, slopes


@kernel
def fill(wi, wo, h, p, out):
    """f = rho_s exp(-x^2/ax^2 - y^2/ay^2) / (4 pi ax ay n.l n.v)."""
    for j in range(out.shape[0]):
        lz, kx, ky, scale = wi[2, j], p[j, 0], p[j, 1], p[j, 2]
        for i in range(out.shape[1]):
            vz = wo[2, j, i]
            x, y, _ = slopes(h[0, j, i], h[1, j, i], h[2, j, i])
            root = math.exp(-0.5 * (x * x * kx + y * y * ky))
            out[j, i] = divided(scale, root, lz, vz)


class WardDuer(Model):
    """f = rho_s E / (4 pi ax ay n.l n.v) (Duer 2006): Ward without the square root."""

    name = "ward_duer"
    title = "Ward-Duer 2006"
    equation = "Duer 2006"
    references = ("duer2006", "walter2005")
    tables = ("m=0.02..1/32", "alpha_x=0.02..1/16,alpha_y=0.2")
    domain = "m=1e-8..10/46log"
    conserves_energy = False
    grazing_limit = False

    alpha_x = alpha("tangent")
    alpha_y = alpha("bitangent")
    m = M
    rho_s = Real(1.0, "scale", low=0.0, high=1.0)

    @property
    def isotropic(self) -> bool:
        return self.alpha_x == self.alpha_y

    def pack(self) -> tuple[float, ...]:
        scale = self.rho_s / (4.0 * math.pi * self.alpha_x * self.alpha_y)
        return (self.alpha_x**-2, self.alpha_y**-2, scale)

    def parts(self) -> tuple[Part, ...]:
        decay = "gaussian" if max(self.alpha_x, self.alpha_y) <= 1.0 else "algebraic"
        chart = PolarChart("slope", decay=decay)
        return (Part("specular", fill, chart, (self.alpha_x, self.alpha_y)),)
