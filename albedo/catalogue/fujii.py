"""Fujii's Oren-Nayar model: no dark ring, and darker than Lambert's law away from the light."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from albedo._compile import kernel
from albedo.brdf import Choice, Model, Part, Real
from albedo.catalogue._oren_nayar import CHART, fujii, interreflection, spread
from albedo.catalogue.lambert import Lambert


@kernel
def fill(wi, wo, h, p, out):
    """f = rho (A + B s/t), s = l.v - (n.l)(n.v), t = 1 if s <= 0 else max(n.l, n.v)."""
    for j in range(out.shape[0]):
        lx, ly, lz, a, b, a_less_b = wi[0, j], wi[1, j], wi[2, j], p[j, 0], p[j, 1], p[j, 2]
        for i in range(out.shape[1]):
            vx, vy, vz = wo[0, j, i], wo[1, j, i], wo[2, j, i]
            out[j, i] = fujii(lx, ly, lz, vx, vy, vz, h[0, j, i], h[1, j, i], a, b, a_less_b)


class Fujii(Model):
    """f = rho (A + B s/t) (Fujii, "A tiny improvement of Oren-Nayar reflectance model").

    ``form="matched"`` follows Oren and Nayar's full model: with s = sigma,
    A = (1 - 0.5 s^2/(s^2 + 0.33) + 0.17 rho s^2/(s^2 + 0.13))/pi, B = 0.45 s^2/(s^2 + 0.09)/pi.
    ``form="artist"`` has A = 1/(pi + (pi/2 - 2/3) r), B = r A, which is the single scattering of
    `eon`; its albedo is rho at grazing incidence and below it elsewhere. The note was published at
    mimosa-pudica.net; Portsmouth et al. restate it.
    """

    name = "fujii"
    title = "Oren-Nayar as improved by Fujii"
    equation = "Fujii; Portsmouth et al. 2024"
    references = ("oren1994", "portsmouth2024")
    tables = ("sigma=0..1.2/32",)
    domain = "sigma=0..1.5/31"

    rho = Real(1.0, "albedo of the facets", low=0.0, high=1.0)
    form = Choice("matched", "coefficients A and B", choices=("matched", "artist"))
    sigma = Real(
        0.3, "standard deviation of the facets' angles", unit="rad", low=0.0, high=0.5 * math.pi
    )
    r = Real(0.5, "roughness of the artist form, B/A", low=0.0, high=1.0)

    def used(self, values: Mapping[str, Any]) -> tuple[str, ...]:
        return ("rho", "form", "sigma" if values["form"] == "matched" else "r")

    @property
    def conserves_energy(self) -> bool:  # type: ignore[override]
        """The albedo is largest at grazing incidence, where it is rho (pi A + (pi/2 - 2/3) B).

        In the matched form, for rho = 1, that is above 1 for 0 < sigma < 0.4637, at most 1.02870
        at sigma = 0.2575; for rho <= 0.9735 it never is.
        """
        a, b = self._coefficients()
        peak = self.rho * (math.pi * a + (0.5 * math.pi - 2.0 / 3.0) * b)
        return self.form == "artist" or peak <= 1.0

    def _coefficients(self) -> tuple[float, float]:
        if self.form == "artist":
            a = 1.0 / (math.pi + (0.5 * math.pi - 2.0 / 3.0) * self.r)
            return a, self.r * a
        masked, lobe = spread(self.sigma)
        a = 1.0 - 0.5 * masked + self.rho * interreflection(self.sigma)
        return a / math.pi, 0.45 * lobe / math.pi

    def pack(self) -> tuple[float, ...]:
        a, b = self._coefficients()
        # At r = 1 the difference is 0, not what is left of roundings.
        difference = a * (1.0 - self.r) if self.form == "artist" else a - b
        return (self.rho * a, self.rho * b, self.rho * difference)

    def simpler(self) -> dict[str, Model]:
        """Lambert's law, with the albedo of the facets."""
        return {"roughness": Lambert(rho=self.rho)}

    def parts(self) -> tuple[Part, ...]:
        return (Part("diffuse", fill, CHART),)
