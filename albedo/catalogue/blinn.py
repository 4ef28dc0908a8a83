"""The reciprocal (modified) Blinn-Phong model, with its exact normalisation."""

from __future__ import annotations

import math

from albedo._compile import kernel
from albedo.brdf import Choice, Model, Part, Real
from albedo.catalogue._blinn import slope_chart, slope_width
from albedo.geometry import normal_root
from albedo.sampling.routines import normal_powers


@kernel
def fill(wi, wo, h, p, out):
    """f = rho_s c_B(n) (n.h)^n."""
    for j in range(out.shape[0]):
        n, scale = p[j, 0], p[j, 1]
        for i in range(out.shape[1]):
            root = normal_root(h[0, j, i], h[1, j, i], h[2, j, i], n)
            out[j, i] = scale * root * root


def normalization(n: float) -> float:
    """The constant that makes the albedo 1 at normal incidence (Giesen 2009).

    c_B = (n + 2)(n + 4) / (8 pi (2^(-n/2) + n)).
    """
    return (n + 2.0) * (n + 4.0) / (8.0 * math.pi * (2.0 ** (-0.5 * n) + n))


class Blinn(Model):
    """f = rho_s c (n.h)^n (Lewis 1993 with Blinn's half vector).

    ``normalization="exact"`` makes the albedo rho_s at normal incidence; ``"n_plus_8"`` is the
    common (n + 8)/(8 pi), which overshoots.
    """

    name = "blinn"
    title = "reciprocal Blinn-Phong"
    equation = "Schwenk sect. 3.2; Giesen 2009"
    references = ("lewis1993", "giesen2009", "schwenk2011")
    tables = ("n=1..1e6/32log",)
    domain = "n=0.001..1e9/61log"

    n = Real(80.0, "exponent", low=0.0, high=1e9)
    rho_s = Real(1.0, "albedo at normal incidence", low=0.0, high=1.0)
    normalization = Choice("exact", "constant of the lobe", choices=("exact", "n_plus_8"))

    @property
    def conserves_energy(self) -> bool:  # type: ignore[override]
        """The common constant is larger than the exact one."""
        return self.normalization == "exact"

    def pack(self) -> tuple[float, ...]:
        exact = self.normalization == "exact"
        constant = normalization(self.n) if exact else (self.n + 8.0) / (8.0 * math.pi)
        return (self.n, self.rho_s * constant)

    def parts(self) -> tuple[Part, ...]:
        widths, routine = (slope_width(self.n),) * 2, normal_powers(self.n, self.n)
        return (Part("specular", fill, slope_chart(self.n), widths, routine=routine),)
