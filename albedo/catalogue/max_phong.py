"""Phong over the larger cosine: the limit that controlled pumping-up is said to have."""

from __future__ import annotations

import math

from albedo._compile import kernel
from albedo.brdf import Choice, Model, Part, Real
from albedo.catalogue._phong import mirror_chart, mirror_width
from albedo.geometry import cosine_root, divided, mirror_root
from albedo.sampling.routines import axis_power, mirror_power


@kernel
def fill(wi, wo, h, p, out):
    """f = c (r.v)^n / max(n.l, n.v)^p; the retro variant has l.v in place of r.v."""
    for j in range(out.shape[0]):
        lx, ly, lz = wi[0, j], wi[1, j], wi[2, j]
        n, c, stretch, retro = p[j, 0], p[j, 1], p[j, 2], p[j, 3]
        for i in range(out.shape[1]):
            vx, vy, vz = wo[0, j, i], wo[1, j, i], wo[2, j, i]
            if retro > 0.0:
                dx, dy, dz = lx - vx, ly - vy, lz - vz
                root = cosine_root(dx * dx + dy * dy + dz * dz, lx * vx + ly * vy + lz * vz, n)
            else:
                hx, hy, hz = h[0, j, i], h[1, j, i], h[2, j, i]
                root = mirror_root(lx, ly, lz, vx, vy, vz, hx, hy, hz, n)
            larger = max(lz, vz)
            if stretch != 1.0:
                larger = larger**stretch
            out[j, i] = divided(c, root, larger, 1.0)


class MaxPhong(Model):
    """f = c (r.v)^n / max(n.l, n.v)^p (NNS eq. 22; Neumann et al. 1999).

    With ``c="paper"`` c = rho_s (n + 2)/(2 pi): the albedo is 1 at normal incidence for p = 1,
    and exceeds 1 at small angles for n < 2.
    With ``c="safe"`` c = rho_s (n + 1)/(2 pi), which never exceeds 1. The exponent p is the
    stretch of "stretched Phong": 0 gives the reciprocal Phong model, 1 the paper's. The retro
    variant reflects towards the light; its albedo is the same.
    """

    name = "max_phong"
    title = "Phong over the larger cosine"
    equation = "NNS eq. 22"
    references = ("neumann1999", "neumann_pumping")
    tables = ("n=1..1e6/32log",)
    domain = "n=0.001..1e9/61log"

    n = Real(20.0, "exponent", low=0.0, high=1e9)
    rho_s = Real(1.0, "scale", low=0.0, high=1.0)
    p = Real(1.0, "power of the larger cosine", low=0.0, high=1.0)
    c = Choice("paper", "normalisation constant", choices=("paper", "safe"))
    variant = Choice("mirror", "direction of the lobe", choices=("mirror", "retro"))

    @property
    def conserves_energy(self) -> bool:  # type: ignore[override]
        """The paper's constant sends more than it receives at small angles when n < 2."""
        return self.c == "safe" or self.p == 0.0 or self.n >= 2.0

    def pack(self) -> tuple[float, ...]:
        constant = self.rho_s * (self.n + (2.0 if self.c == "paper" else 1.0)) / (2.0 * math.pi)
        return (self.n, constant, self.p, float(self.variant == "retro"))

    def parts(self) -> tuple[Part, ...]:
        kinks = "none" if self.p == 0.0 else "max"
        chart = mirror_chart(self.n, kinks, self.variant)
        widths, routine = (mirror_width(self.n),) * 2, mirror_power(self.n)
        if self.variant == "retro":
            routine = axis_power((1.0, 1.0, 1.0), self.n)
        return (Part("specular", fill, chart, widths, routine=routine),)
