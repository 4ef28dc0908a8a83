"""Oren and Nayar 1994, qualitative model: rough surfaces of Lambertian facets."""

from __future__ import annotations

import math

from albedo._compile import kernel
from albedo.brdf import Model, Part, Real
from albedo.catalogue._oren_nayar import CHART, spread
from albedo.catalogue.lambert import Lambert


@kernel
def fill(wi, wo, h, p, out):
    """f = rho/pi (A + B max(0, cos(phi_l - phi_v)) sin(alpha) tan(beta)).

    cos(phi_l - phi_v) sin(alpha) tan(beta) = (l_x v_x + l_y v_y)/max(n.l, n.v).
    """
    for j in range(out.shape[0]):
        lx, ly, lz, a, b = wi[0, j], wi[1, j], wi[2, j], p[j, 0], p[j, 1]
        for i in range(out.shape[1]):
            s = lx * wo[0, j, i] + ly * wo[1, j, i]
            out[j, i] = a + b * max(0.0, s) / max(lz, wo[2, j, i])


class OrenNayar(Model):
    """f = rho/pi (A + B max(0, cos(phi_l - phi_v)) sin(alpha) tan(beta)) (Oren and Nayar 1994).

    A = 1 - 0.5 s^2/(s^2 + 0.33), B = 0.45 s^2/(s^2 + 0.09), s = sigma; alpha is the larger and
    beta the smaller of the angles of L and V to the normal. Light that is reflected between facets
    is left out: `oren_nayar_full` has it.
    """

    name = "oren_nayar"
    title = "Oren-Nayar, qualitative model"
    equation = "Oren and Nayar 1994; Schwenk eq. 34"
    references = ("oren1994", "schwenk2011")
    tables = ("sigma=0..1.2/32",)
    domain = "sigma=0..1.5/31"

    rho = Real(1.0, "albedo of the facets", low=0.0, high=1.0)
    sigma = Real(
        0.3, "standard deviation of the facets' angles", unit="rad", low=0.0, high=0.5 * math.pi
    )

    @property
    def conserves_energy(self) -> bool:  # type: ignore[override]
        """The albedo is largest at grazing incidence, where it is rho (A + B/2).

        For rho = 1 that is above 1 for 0 < sigma < 0.3261, at most 1.01518 at sigma = 0.1986; for
        rho <= 0.98504 it never is.
        """
        masked, lobe = spread(self.sigma)
        return self.rho * (1.0 - 0.5 * masked + 0.225 * lobe) <= 1.0

    def pack(self) -> tuple[float, ...]:
        masked, lobe = spread(self.sigma)
        scale = self.rho / math.pi
        return (scale * (1.0 - 0.5 * masked), scale * 0.45 * lobe)

    def simpler(self) -> dict[str, Model]:
        """Lambert's law, with the albedo of the facets."""
        return {"roughness": Lambert(rho=self.rho)}

    def parts(self) -> tuple[Part, ...]:
        return (Part("diffuse", fill, CHART),)
