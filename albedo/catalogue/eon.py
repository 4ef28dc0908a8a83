"""EON: Fujii's lobe, and a second one for the light that it loses to multiple scattering."""

from __future__ import annotations

import math

from albedo._compile import kernel
from albedo.brdf import Choice, Model, Part, Real
from albedo.catalogue._oren_nayar import CHART, fujii
from albedo.catalogue.lambert import Lambert
from albedo.sampling.routines import Routine

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


@kernel
def _transform(r, mu):
    """Share of uniform draws, and the four entries a, b, c, d of the linear transform."""
    share = r**0.1 * (0.162925 + mu * (-0.372058 + (0.538233 - 0.290822 * mu) * mu))
    a = 1.0 + r * (0.303392 + (-0.518982 + 0.111709 * mu) * mu + (-0.276266 + 0.335918 * mu) * r)
    b = r * (-1.16407 + 1.15859 * mu + (0.150815 - 0.150105 * mu) * r) / (mu**3 - 1.43545)
    c = 1.0 + (0.20013 + (-0.506373 + 0.261777 * mu) * mu) * r
    d = r * (0.540852 + (-1.01625 + 0.475392 * mu) * mu)
    return share, a, b, c, d / (-1.0743 + mu * (0.0725628 + mu))


@kernel
def draw(wi, u, q, wo, h):
    """A clipped linear transform of the cosine, or one uniform direction in `share` draws."""
    for k in range(wo.shape[1]):
        lx, ly, lz = wi[0, k], wi[1, k], wi[2, k]
        share, a, b, c, d = _transform(q[k, 0], lz)
        s = math.sqrt(lx * lx + ly * ly)
        cos_phi, sin_phi = (lx / s, ly / s) if s > 0.0 else (1.0, 0.0)
        # Of the disk, the part that the transform sends above the horizon.
        half = 0.5 * (1.0 + 1.0 / math.sqrt(d * d + 1.0))
        for i in range(wo.shape[2]):
            first, turn = u[0, k, i], 2.0 * math.pi * u[1, k, i]
            if first < share:
                z = 1.0 - first / share
                rho = math.sqrt((1.0 - z) * (1.0 + z))
                x, y = rho * math.cos(turn), rho * math.sin(turn)
            else:
                rho = math.sqrt((first - share) / (1.0 - share))
                x, y = rho * math.cos(turn), rho * math.sin(turn)
                x = -((1.0 - half) * math.sqrt(1.0 - y * y) + half * x)
                z = math.sqrt(max(1.0 - x * x - y * y, 0.0))
                x, y, z = a * x + b * z, c * y, d * x + z
                length = math.sqrt(x * x + y * y + z * z)
                x, y, z = x / length, y / length, z / length
            wo[0, k, i] = x * cos_phi - y * sin_phi
            wo[1, k, i] = x * sin_phi + y * cos_phi
            wo[2, k, i] = z
            for j in range(3):
                h[j, k, i] = wi[j, k] + wo[j, k, i]


@kernel
def density(wi, wo, h, q, out):
    """share/(2 pi) + (1 - share) (det/|w|^2)^2 max(w.z, 0)/(pi half), w the direction before."""
    for k in range(out.shape[0]):
        lx, ly, lz = wi[0, k], wi[1, k], wi[2, k]
        share, a, b, c, d = _transform(q[k, 0], lz)
        s = math.sqrt(lx * lx + ly * ly)
        cos_phi, sin_phi = (lx / s, ly / s) if s > 0.0 else (1.0, 0.0)
        half = 0.5 * (1.0 + 1.0 / math.sqrt(d * d + 1.0))
        determinant = c * (a - b * d)
        for i in range(out.shape[1]):
            x = wo[0, k, i] * cos_phi + wo[1, k, i] * sin_phi
            y = -wo[0, k, i] * sin_phi + wo[1, k, i] * cos_phi
            z = wo[2, k, i]
            out[k, i] = 0.0
            if z > 0.0:
                wx, wy, wz = c * (x - b * z), (a - b * d) * y, -c * (d * x - a * z)
                scale = determinant / (wx * wx + wy * wy + wz * wz)
                own = scale * scale * max(wz, 0.0) / (math.pi * half)
                out[k, i] = share * 0.5 / math.pi + (1.0 - share) * own


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

    def simpler(self) -> dict[str, Model]:
        """Lambert's law, with the albedo of the facets."""
        return {"roughness": Lambert(rho=self.rho)}

    def parts(self) -> tuple[Part, ...]:
        routine = Routine("transformed cosine", draw, density, (self.r,), "Portsmouth et al. 2024")
        return (Part("diffuse", fill, CHART, routine=routine),)
