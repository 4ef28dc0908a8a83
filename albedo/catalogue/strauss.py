"""Strauss 1990: a lighting model for animators, by smoothness, metalness and transparency."""

from __future__ import annotations

import math
from typing import Any

from albedo._compile import kernel
from albedo.brdf import Choice, Color, Model, Part, Real
from albedo.catalogue._phong import mirror_chart, mirror_width
from albedo.charts.cosine import CosineChart
from albedo.charts.parallels import ParallelsChart
from albedo.geometry import divided, mirror_root
from albedo.sampling.routines import mirror_power

SMOOTHEST = 0.999
"""The exponent 3/(1 - s) has no limit at s = 1."""


@kernel
def edge_reflection(x):
    """F(x) = (1/(x - k_f)^2 - 1/k_f^2) / (1/(1 - k_f)^2 - 1/k_f^2), k_f = 1.12; no cancellation."""
    k = 1.12
    whole = 1.0 / (0.12 * 0.12) - 1.0 / (k * k)
    return x * (2.0 * k - x) / ((k * (k - x)) ** 2 * whole)


@kernel
def edge_shadow(y):
    """G(x) = (1/(1 - k_g)^2 - 1/(x - k_g)^2) / (1/(1 - k_g)^2 - 1/k_g^2), k_g = 1.01, y = 1 - x."""
    k = 0.01
    whole = 1.0 / (k * k) - 1.0 / (1.01 * 1.01)
    return y * (2.0 * k + y) / ((k * (k + y)) ** 2 * whole)


def cap_elevation(values: tuple[float, ...], cos_theta: float) -> float:
    """The elevation of V at which r_n + (r_n + 0.1) F G(x_l) G(x_v) is 1; 2 where it stays below.

    With k = k_g - 1 and G = (1/k^2 - 1/(k + y)^2)/W, y = k (1/sqrt(1 - W k^2 G) - 1).
    """
    (r_n,) = values
    theta = math.acos(cos_theta)
    both = edge_reflection(theta * (2.0 / math.pi))
    both *= edge_shadow(math.asin(cos_theta) * (2.0 / math.pi))
    room, k = 1.0 - r_n, 0.01
    if room >= (r_n + 0.1) * both:
        return 2.0
    q = room / ((r_n + 0.1) * both) * (1.0 - (k / 1.01) ** 2)
    root = math.sqrt(1.0 - q)
    return 0.5 * math.pi * k * q / (root * (1.0 + root))


@kernel
def fill_specular(wi, wo, h, p, out):
    """f = r_j (r.v)^e C_s/n.l, r_j = min(1, r_n + (r_n + 0.1) F(x_l) G(x_l) G(x_v))."""
    for j in range(out.shape[0]):
        lx, ly, lz = wi[0, j], wi[1, j], wi[2, j]
        e, r_n, white, tinted, scale = p[j, 0], p[j, 1], p[j, 2], p[j, 3], p[j, 4]
        sin_l = math.hypot(lx, ly)
        f = edge_reflection(math.atan2(sin_l, lz) * (2.0 / math.pi))
        both = f * edge_shadow(math.atan2(lz, sin_l) * (2.0 / math.pi))
        # C_s = 1 + m (1 - F)(C - 1), as a sum of what is not negative.
        c_s = scale * (white + tinted * f)
        for i in range(out.shape[1]):
            vx, vy, vz = wo[0, j, i], wo[1, j, i], wo[2, j, i]
            seen = edge_shadow(math.atan2(vz, math.hypot(vx, vy)) * 2.0 / math.pi)
            r_j = min(1.0, r_n + (r_n + 0.1) * both * seen)
            hx, hy, hz = h[0, j, i], h[1, j, i], h[2, j, i]
            root = mirror_root(lx, ly, lz, vx, vy, vz, hx, hy, hz, e)
            out[j, i] = divided(r_j * c_s, root, lz, 1.0)


@kernel
def fill_diffuse(wi, wo, h, p, out):
    """f = r_d d C, r_d = (1 - s^3)(1 - t), d = 1 - m s."""
    for j in range(out.shape[0]):
        for i in range(out.shape[1]):
            out[j, i] = p[j, 5]


class Strauss(Model):
    """J = r_d d C + r_j (r.v)^e C_s/n.l, read as the BRDF J/pi (Strauss 1990; Schwenk eq. 46).

    r_d = (1 - s^3)(1 - t), r_n = (1 - t) s^3, d = 1 - m s, e = 3/(1 - s),
    r_j = min(1, r_n + (r_n + 0.1) F(x_l) G(x_l) G(x_v)) and C_s = 1 + m (1 - F(x_l))(C - 1), where
    x is the angle to the normal (not its cosine) over 90 degrees. ``reading="literal"`` is f = J.
    The cap of r_j at 1 is reached near grazing incidence when (1 - t) s^3 > 0.56.
    """

    name = "strauss"
    title = "Strauss for animators"
    equation = "Schwenk eq. 46"
    references = ("strauss1990", "schwenk2011")
    tables = ("smoothness=0..0.98/32",)
    domain = "smoothness=0..0.999/31"
    reciprocal = False

    smoothness = Real(0.5, "smoothness s", low=0.0, high=SMOOTHEST)
    metalness = Real(0.0, "metalness m", low=0.0, high=1.0)
    transparency = Real(0.0, "transparency t", low=0.0, high=1.0)
    color = Color(1.0, "colour C", low=0.0, high=1.0)
    reading = Choice("brdf", "f = J/pi, or f = J", choices=("brdf", "literal"))

    @property
    def conserves_energy(self) -> bool:  # type: ignore[override]
        """Only where nothing but the factor 0.1 F G G is left, from s = 0.0698 on (measured)."""
        faint = self.transparency == 1.0 and self.smoothness >= 0.07
        return self.reading == "brdf" and faint

    @property
    def grazing_limit(self) -> bool:  # type: ignore[override]
        """r_n does not vanish at grazing incidence, and is divided by n.l."""
        return self.smoothness == 0.0 or self.transparency == 1.0

    def pack(self) -> tuple[float, ...]:
        s, m, t, c = self.smoothness, self.metalness, self.transparency, self.color
        scale = 1.0 / math.pi if self.reading == "brdf" else 1.0
        r_d = (1.0 - s**3) * (1.0 - t)
        return (
            *(3.0 / (1.0 - s), (1.0 - t) * s**3, (1.0 - m) + m * c, m * (1.0 - c)),
            *(scale, scale * r_d * (1.0 - m * s) * c),
        )

    def parts(self) -> tuple[Part, ...]:
        e = 3.0 / (1.0 - self.smoothness)
        r_n = (1.0 - self.transparency) * self.smoothness**3
        # Low powers end in a root at r.v = 0, but are too far from 1 for the cap.
        chart: Any = mirror_chart(e)
        if e >= 8.0:
            chart = ParallelsChart(cap_elevation, (r_n,), layer=0.005 * math.pi)
        return (
            Part("diffuse", fill_diffuse, CosineChart()),
            Part(
                *("specular", fill_specular, chart, (mirror_width(e),) * 2),
                routine=mirror_power(e),
            ),
        )
