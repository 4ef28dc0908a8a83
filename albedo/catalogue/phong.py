"""The reciprocal (modified) Phong model of Lewis 1993 and Lafortune and Willems 1994."""

from __future__ import annotations

import math

from albedo._compile import kernel
from albedo.brdf import Model, Part, Real
from albedo.catalogue._phong import mirror_chart, mirror_width
from albedo.geometry import mirror_root
from albedo.sampling.routines import mirror_power


@kernel
def fill(wi, wo, h, p, out):
    """f = rho_s (n + 2)/(2 pi) (r.v)^n."""
    for j in range(out.shape[0]):
        lx, ly, lz = wi[0, j], wi[1, j], wi[2, j]
        n, scale = p[j, 0], p[j, 1]
        for i in range(out.shape[1]):
            vx, vy, vz = wo[0, j, i], wo[1, j, i], wo[2, j, i]
            hx, hy, hz = h[0, j, i], h[1, j, i], h[2, j, i]
            root = mirror_root(lx, ly, lz, vx, vy, vz, hx, hy, hz, n)
            out[j, i] = scale * root * root


class Phong(Model):
    """f = rho_s (n + 2)/(2 pi) (r.v)^n (Lewis 1993; NNS eq. 6).

    The albedo is rho_s at normal incidence and rho_s cos(theta) as long as the horizon does not
    clip the lobe. At n = 0 the model is the limit n -> 0: zero where r.v <= 0.
    """

    name = "phong"
    title = "reciprocal Phong"
    equation = "NNS eq. 6"
    references = ("lewis1993", "lafortune1994", "neumann_pumping")
    tables = ("n=1..1e6/32log",)
    domain = "n=0.001..1e9/61log"

    n = Real(20.0, "exponent", low=0.0, high=1e9)
    rho_s = Real(1.0, "albedo at normal incidence", low=0.0, high=1.0)

    def pack(self) -> tuple[float, ...]:
        return (self.n, self.rho_s * (self.n + 2.0) / (2.0 * math.pi))

    def parts(self) -> tuple[Part, ...]:
        widths = (mirror_width(self.n),) * 2
        routine = mirror_power(self.n)
        return (Part("specular", fill, mirror_chart(self.n), widths, routine=routine),)
