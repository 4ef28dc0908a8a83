"""Blinn 1977 with Phong's lobe: a power of n.h, divided by n.l."""

from __future__ import annotations

from albedo._compile import kernel
from albedo.brdf import Model, Part, Real
from albedo.catalogue._blinn import slope_chart, slope_width
from albedo.geometry import divided, normal_root
from albedo.sampling.routines import normal_powers


@kernel
def fill(wi, wo, h, p, out):
    """f = rho_s (n.h)^n / n.l."""
    for j in range(out.shape[0]):
        n, rho_s, lz = p[j, 0], p[j, 1], wi[2, j]
        for i in range(out.shape[1]):
            root = normal_root(h[0, j, i], h[1, j, i], h[2, j, i], n)
            out[j, i] = divided(rho_s, root, lz, 1.0)


class BlinnOriginal(Model):
    """f = rho_s (n.h)^n / n.l (Blinn 1977). Not reciprocal, scale free."""

    name = "blinn_original"
    title = "Blinn's lighting model read as a BRDF"
    equation = "Schwenk sect. 3.2"
    references = ("blinn1977", "schwenk2011")
    tables = ("n=1..1e6/32log",)
    domain = "n=0.001..1e9/61log"
    reciprocal = False
    conserves_energy = False
    grazing_limit = False

    n = Real(80.0, "exponent", low=0.0, high=1e9)
    rho_s = Real(1.0, "scale of the lobe", low=0.0)

    def pack(self) -> tuple[float, ...]:
        return (self.n, self.rho_s)

    def parts(self) -> tuple[Part, ...]:
        widths, routine = (slope_width(self.n),) * 2, normal_powers(self.n, self.n)
        return (Part("specular", fill, slope_chart(self.n), widths, routine=routine),)
