"""Ward 1992: a Gaussian of the half vector's slopes over the root of both cosines."""

from __future__ import annotations

import math

from albedo._compile import kernel
from albedo.brdf import Choice, Model, Part, Real
from albedo.catalogue._ward import M, alpha
from albedo.charts.polar import PolarChart
from albedo.geometry import slopes


@kernel
def fill(wi, wo, h, p, out):
    """f = rho_s exp(-x^2/ax^2 - y^2/ay^2) / (4 pi ax ay sqrt(n.l n.v))."""
    for j in range(out.shape[0]):
        lz, kx, ky, scale, fast = wi[2, j], p[j, 0], p[j, 1], p[j, 2], p[j, 3]
        for i in range(out.shape[1]):
            vz = wo[2, j, i]
            if min(lz, vz) <= 0.0:
                out[j, i] = 0.0
                continue
            x, y, _ = slopes(h[0, j, i], h[1, j, i], h[2, j, i])
            a = x * x * kx + y * y * ky
            if fast > 0.0:
                # 2/(1 + n.h) with h normalised, in slopes: n.h = 1/sqrt(q).
                q = 1.0 + x * x + y * y
                a *= 2.0 / (q + math.sqrt(q))
            # Root by root: what is above or below the range of numbers alone need not be in all.
            root = math.exp(-0.5 * a)
            out[j, i] = (scale * root / math.sqrt(lz)) * (root / math.sqrt(vz))


class Ward(Model):
    """f = rho_s E / (4 pi ax ay sqrt(n.l n.v)), E = exp(-tan^2 d (cos^2/ax^2 + sin^2/ay^2)).

    Ward 1992; NNS eq. 8. ``form="fast"`` is the approximation Ward proposes for speed,
    E = exp(-2 ((h.x/ax)^2 + (h.y/ay)^2)/(1 + n.h)).
    """

    name = "ward"
    title = "Ward 1992"
    equation = "NNS eq. 8; Schwenk eqs. 43, 44"
    references = ("ward1992", "walter2005", "neumann_pumping", "schwenk2011")
    tables = ("m=0.02..1/32", "alpha_x=0.02..1/16,alpha_y=0.2")
    domain = "m=1e-8..10/46log"
    conserves_energy = False
    grazing_limit = False

    alpha_x = alpha("tangent")
    alpha_y = alpha("bitangent")
    m = M
    rho_s = Real(1.0, "scale", low=0.0, high=1.0)
    form = Choice("exact", "exponent as defined, or Ward's fast form", choices=("exact", "fast"))

    @property
    def isotropic(self) -> bool:
        return self.alpha_x == self.alpha_y

    def pack(self) -> tuple[float, ...]:
        scale = self.rho_s / (4.0 * math.pi * self.alpha_x * self.alpha_y)
        return (self.alpha_x**-2, self.alpha_y**-2, scale, float(self.form == "fast"))

    def parts(self) -> tuple[Part, ...]:
        # The fast exponent is a Gaussian of the angle: the cut in slopes fits narrow lobes only.
        narrow = max(self.alpha_x, self.alpha_y) < 0.05
        wide = max(self.alpha_x, self.alpha_y) > 1.0
        decay = "gaussian" if narrow or (self.form == "exact" and not wide) else "algebraic"
        chart = PolarChart("slope", decay=decay, edge=2, origin=3)
        return (Part("specular", fill, chart, (self.alpha_x, self.alpha_y)),)
