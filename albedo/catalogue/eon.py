"""EON: Fujii's lobe, and a second one for the light that it loses to multiple scattering."""

from __future__ import annotations

import math

from albedo._compile import kernel
from albedo.brdf import Choice, Model, Part, Real
from albedo.catalogue._oren_nayar import CHART, fujii

K1 = 0.5 - 2.0 / (3.0 * math.pi)
K1_LESS_K2 = 6.0 / (5.0 * math.pi) - 1.0 / 6.0
"""k_1 - k_2, k_2 = 2/3 - 28/(15 pi): what is lost on average, where k_1 is lost at the normal."""


@kernel
def lost_exactly(x, y, z):
    """k_1 - G(z)/pi = (1 - E_F)/(A_F r), written so that nothing cancels at grazing angles.

    G(z) = s (acos(z) - s z) + 2/3 (s/z (1 - s^3) - s), s^2 = 1 - z^2.
    """
    s = math.sqrt(x * x + y * y)
    half = (0.5 - 2.0 / (3.0 * math.pi)) * (z * z / (1.0 + s))
    rest = math.atan2(z, s) + s * z - 2.0 / 3.0 * z * (1.0 + s * (1.0 + s)) / (1.0 + s)
    return half + s * rest / math.pi


@kernel
def lost_as_fitted(z):
    """k_1 - Q(1 - z), Q(x) = x (0.0571085289 + x (0.491881867 + x (-0.332181442 + ...))).

    In powers of z, whose first coefficient would be a difference of near-equals.
    """
    return -0.000458539989193781025 + z * (
        0.3300999181 + z * (0.0760044872 + z * (-0.0464094608 + z * -0.0714429953))
    )


@kernel
def fill(wi, wo, h, p, out):
    """f = rho/pi A_F (1 + r s/t) + rho_ms/pi (1 - E_F(n.l)) (1 - E_F(n.v))/(1 - <E_F>)."""
    for j in range(out.shape[0]):
        lx, ly, lz, a, b, a_less_b = wi[0, j], wi[1, j], wi[2, j], p[j, 0], p[j, 1], p[j, 2]
        scale, fitted = p[j, 3], p[j, 4]
        light = lost_as_fitted(lz) if fitted > 0.0 else lost_exactly(lx, ly, lz)
        for i in range(out.shape[1]):
            vx, vy, vz = wo[0, j, i], wo[1, j, i], wo[2, j, i]
            view = lost_as_fitted(vz) if fitted > 0.0 else lost_exactly(vx, vy, vz)
            single = fujii(lx, ly, lz, vx, vy, vz, h[0, j, i], h[1, j, i], a, b, a_less_b)
            out[j, i] = single + scale * light * view


class Eon(Model):
    """f = f_ss + f_ms, energy-preserving Oren-Nayar (Portsmouth et al. 2024).

    f_ss = rho/pi A_F (1 + r s/t) with A_F = 1/(1 + k_1 r), s and t as in `fujii`;
    f_ms = rho_ms/pi (1 - E_F(n.l)) (1 - E_F(n.v))/(1 - <E_F>) with the albedo E_F of f_ss for
    rho = 1, its average <E_F> = A_F (1 + k_2 r), and rho_ms = rho^2 <E_F>/(1 - rho (1 - <E_F>)).

    The albedo is rho E_F + rho_ms (1 - E_F): 1 for rho = 1. ``albedo="fitted"`` takes the paper's
    polynomial for E_F. Its 1 - E_F is below 0 for cosines under 0.00139, where the paper's listing
    puts 1e-7 in its place; it is kept here, and f stays positive.
    """

    name = "eon"
    title = "Energy-preserving Oren-Nayar (EON)"
    equation = "Portsmouth et al. 2024"
    references = ("portsmouth2024",)
    tables = ("r=0..1/32",)
    domain = "r=0..1/21"

    rho = Real(1.0, "albedo of the facets", low=0.0, high=1.0)
    r = Real(0.5, "roughness", low=0.0, high=1.0)
    albedo = Choice("exact", "E_F in the second lobe", choices=("exact", "fitted"))

    @property
    def conserves_energy(self) -> bool:  # type: ignore[override]
        """With the fitted E_F up to 1.000147 is reflected (rho = 1, r = 1, cosine 0.134)."""
        return self.albedo == "exact" or self.r == 0.0 or self.rho <= 0.9998

    def pack(self) -> tuple[float, ...]:
        a = 1.0 / (1.0 + K1 * self.r)
        lost = a * self.r * K1_LESS_K2
        rho_ms = self.rho * self.rho * (1.0 - lost) / (1.0 - self.rho * lost)
        single = self.rho * a / math.pi
        return (
            *(single, single * self.r, single * (1.0 - self.r)),
            *(rho_ms / math.pi * a * self.r / K1_LESS_K2, float(self.albedo == "fitted")),
        )

    def parts(self) -> tuple[Part, ...]:
        return (Part("diffuse", fill, CHART),)
