"""Oren and Nayar 1994, full model: the functional approximation with interreflection."""

from __future__ import annotations

import math

from albedo._compile import kernel
from albedo.brdf import Model, Part, Real
from albedo.catalogue._oren_nayar import CHART, interreflection, spread
from albedo.catalogue.lambert import Lambert
from albedo.catalogue.oren_nayar import OrenNayar
from albedo.charts.dark import DarkChart, opposite
from albedo.charts.rings import RingsChart

# What C_3 adds at grazing incidence, and C_2, over s^2/(s^2 + 0.09): integrals over beta.
_GRAZING = 0.177196556363678


@kernel
def fill(wi, wo, h, p, out):
    """f = rho/pi (C_1 + c C_2 tan(beta) + (1 - |c|) C_3 tan((alpha + beta)/2) + f_2).

    c = cos(phi_l - phi_v), f_2 = I (1 - c (2 beta/pi)^2). The elevation pi/2 - beta is 0.5 pi x.
    """
    for j in range(out.shape[0]):
        lx, ly, lz = wi[0, j], wi[1, j], wi[2, j]
        scale, c_1, lobe, second = p[j, 0], p[j, 1], p[j, 2], p[j, 3]
        sin_l = math.sqrt(lx * lx + ly * ly)
        x_l = math.atan2(lz, sin_l) * (2.0 / math.pi)
        for i in range(out.shape[1]):
            vx, vy, vz = wo[0, j, i], wo[1, j, i], wo[2, j, i]
            sin_v = math.sqrt(vx * vx + vy * vy)
            x_v = math.atan2(vz, sin_v) * (2.0 / math.pi)
            both = sin_l * sin_v
            c = across = 0.0
            if both > 0.0:
                c = max(-1.0, min(1.0, (lx * vx + ly * vy) / both))
                sine = (lx * vy - ly * vx) / both
                across = sine * sine / (1.0 + abs(c))  # 1 - |c|
            sin_a, cos_a, sin_b, cos_b, x = sin_l, lz, sin_v, vz, x_v
            if lz > vz:
                sin_a, cos_a, sin_b, cos_b, x = sin_v, vz, sin_l, lz, x_l
            c_2 = 0.45 * lobe * sin_a
            if c < 0.0:
                c_2 = 0.45 * lobe * opposite(sin_a, cos_a, x)
            c_3 = 0.125 * lobe * ((1.0 - x_l) * (1.0 - x_v)) ** 2
            toward = c * c_2 * (sin_b / cos_b)
            sideways = across * c_3 * ((sin_l + sin_v) / (lz + vz))
            f_2 = second * (1.0 - c * ((1.0 - x) * (1.0 - x)))
            out[j, i] = scale * max(0.0, c_1 + toward + sideways + f_2)


class OrenNayarFull(Model):
    """f = f_1 + f_2, the functional approximation (Oren and Nayar 1994).

    f_1 = rho/pi (C_1 + c C_2 tan(beta) + (1 - abs(c)) C_3 tan((alpha + beta)/2)) and
    f_2 = 0.17 rho^2/pi s^2/(s^2 + 0.13) (1 - c (2 beta/pi)^2), where c = cos(phi_l - phi_v),
    s = sigma, alpha is the larger and beta the smaller of the angles of L and V to the normal, and

    - C_1 = 1 - 0.5 s^2/(s^2 + 0.33),
    - C_2 = 0.45 s^2/(s^2 + 0.09) (sin(alpha) - (2 beta/pi)^3), without the cube for c >= 0,
    - C_3 = 0.125 s^2/(s^2 + 0.09) (4 alpha beta/pi^2)^2.

    Where one direction is the normal, c is 0; what it multiplies is 0 as well. For sigma > 0.6644
    f_1 falls below 0 at grazing angles, opposite the light; where f_1 + f_2 < 0, f is 0.
    """

    name = "oren_nayar_full"
    title = "Oren-Nayar, full model with interreflection"
    equation = "Oren and Nayar 1994"
    references = ("oren1994",)
    tables = ("sigma=0..1.2/32",)
    domain = "sigma=0..1.5/31"

    rho = Real(1.0, "albedo of the facets", low=0.0, high=1.0)
    sigma = Real(
        0.3, "standard deviation of the facets' angles", unit="rad", low=0.0, high=0.5 * math.pi
    )

    @property
    def conserves_energy(self) -> bool:  # type: ignore[override]
        """The albedo is largest at grazing incidence, as measured; there it is known.

        It is rho (C_1 + 0.1772 s^2/(s^2 + 0.09) + 0.17 rho s^2/(s^2 + 0.13)). For rho = 1 that is
        above 1 for 0 < sigma < 0.6276, at most 1.05102 at sigma = 0.3044; for rho <= 0.9543 it
        never is.
        """
        masked, lobe = spread(self.sigma)
        first = 1.0 - 0.5 * masked + _GRAZING * lobe
        return self.rho * (first + self.rho * interreflection(self.sigma)) <= 1.0

    def pack(self) -> tuple[float, ...]:
        masked, lobe = spread(self.sigma)
        second = self.rho * interreflection(self.sigma)
        return (self.rho / math.pi, 1.0 - 0.5 * masked, lobe, second)

    def simpler(self) -> dict[str, Model]:
        """The qualitative model, and Lambert's law, with the albedo of the facets."""
        qualitative = OrenNayar(rho=self.rho, sigma=self.sigma)
        return {
            "the full model's terms": qualitative,
            "roughness": Lambert(rho=self.rho),
        }

    def parts(self) -> tuple[Part, ...]:
        _, c_1, lobe, second = self.pack()
        # What f tends to where both directions graze, opposite each other.
        dark = c_1 - 2.7 / math.pi * lobe + 2.0 * second < 0.0
        if not dark:
            return (Part("diffuse", fill, CHART),)
        chart = DarkChart(c_1=c_1, lobe=lobe, second=second)
        rings = RingsChart("broad", "dark", axis=(1.0, 1.0), fit=(c_1, lobe, second))
        return (Part("diffuse", fill, chart, rings=rings),)
