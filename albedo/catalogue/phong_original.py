"""Phong 1975 as a BRDF: the lobe about the mirror direction, divided by n.l."""

from __future__ import annotations

from albedo._compile import kernel
from albedo.brdf import Model, Part, Real
from albedo.catalogue._phong import mirror_chart, mirror_width
from albedo.geometry import divided, mirror_root
from albedo.sampling.routines import mirror_power


@kernel
def fill(wi, wo, h, p, out):
    """f = rho_s (r.v)^n / n.l."""
    for j in range(out.shape[0]):
        lx, ly, lz = wi[0, j], wi[1, j], wi[2, j]
        n, rho_s = p[j, 0], p[j, 1]
        for i in range(out.shape[1]):
            vx, vy, vz = wo[0, j, i], wo[1, j, i], wo[2, j, i]
            hx, hy, hz = h[0, j, i], h[1, j, i], h[2, j, i]
            root = mirror_root(lx, ly, lz, vx, vy, vz, hx, hy, hz, n)
            out[j, i] = divided(rho_s, root, lz, 1.0)


class PhongOriginal(Model):
    """f = rho_s (r.v)^n / n.l (Phong 1975; NNS eq. 5, Schwenk eq. 24).

    Not reciprocal, and not normalised: the scale is free in the papers.
    """

    name = "phong_original"
    title = "Phong's lighting model read as a BRDF"
    equation = "NNS eq. 5; Schwenk eq. 24"
    references = ("phong1975", "neumann_pumping", "schwenk2011")
    tables = ("n=1..1e6/32log",)
    domain = "n=0.001..1e9/61log"
    reciprocal = False
    conserves_energy = False
    grazing_limit = False

    n = Real(20.0, "exponent", low=0.0, high=1e9)
    rho_s = Real(1.0, "scale of the lobe", low=0.0)

    def pack(self) -> tuple[float, ...]:
        return (self.n, self.rho_s)

    def parts(self) -> tuple[Part, ...]:
        widths = (mirror_width(self.n),) * 2
        routine = mirror_power(self.n)
        return (Part("specular", fill, mirror_chart(self.n), widths, routine=routine),)
