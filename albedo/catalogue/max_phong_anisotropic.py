"""Anisotropic Phong over the larger cosine, with an exponent that turns with the half vector."""

from __future__ import annotations

import math

from albedo._compile import kernel
from albedo.brdf import Model, Part, Real
from albedo.catalogue._phong import mirror_chart, mirror_width
from albedo.charts.polar import PolarChart
from albedo.geometry import along_azimuth, divided, mirror_root


@kernel
def fill(wi, wo, h, p, out):
    """f = c (r.v)^(n_u cos^2 + n_v sin^2) / max(n.l, n.v), angles of h's azimuth."""
    for j in range(out.shape[0]):
        lx, ly, lz = wi[0, j], wi[1, j], wi[2, j]
        n_u, n_v, c = p[j, 0], p[j, 1], p[j, 2]
        for i in range(out.shape[1]):
            hx, hy, hz = h[0, j, i], h[1, j, i], h[2, j, i]
            vx, vy, vz = wo[0, j, i], wo[1, j, i], wo[2, j, i]
            n = along_azimuth(n_u, n_v, hx, hy)
            root = mirror_root(lx, ly, lz, vx, vy, vz, hx, hy, hz, n)
            out[j, i] = divided(c, root, max(lz, vz), 1.0)


class MaxPhongAnisotropic(Model):
    """f = c (r.v)^(n_u cos^2 phi_h + n_v sin^2 phi_h) / max(n.l, n.v).

    The primary text of the anisotropic variant is out of reach; this definition is ours: phi_h
    is the azimuth of l + v, which is symmetric in l and v, and c = sqrt((n_u + 2)(n_v + 2))/(2 pi)
    makes the albedo 1 at normal incidence.
    """

    name = "max_phong_anisotropic"
    title = "anisotropic Phong over the larger cosine"
    equation = "after NNS eq. 22"
    references = ("neumann1999",)
    tables = ("n_u=1..1e4/16log,n_v=100",)
    domain = "n_u=1..1e8/9log,n_v=1..1e8/9log"
    conserves_energy = False

    n_u = Real(100.0, "exponent along the tangent", low=0.0, high=1e9)
    n_v = Real(10.0, "exponent along the bitangent", low=0.0, high=1e9)

    @property
    def isotropic(self) -> bool:
        return self.n_u == self.n_v

    def pack(self) -> tuple[float, ...]:
        constant = math.sqrt((self.n_u + 2.0) * (self.n_v + 2.0)) / (2.0 * math.pi)
        return (self.n_u, self.n_v, constant)

    def parts(self) -> tuple[Part, ...]:
        low, high = sorted((self.n_u, self.n_v))
        widths = mirror_width(self.n_u), mirror_width(self.n_v)
        if low < 2.0 and high <= 100.0 * low:
            # A broad lobe: laid out about R, as wide as its wider half.
            chart = PolarChart("mirror", "max", "algebraic", edge=4)
            return (Part("specular", fill, chart, (max(widths),) * 2),)
        chart = mirror_chart(low, "max", "mirror_in_slopes")
        return (Part("specular", fill, chart, widths),)
