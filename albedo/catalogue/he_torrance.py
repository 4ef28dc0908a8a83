"""He, Torrance, Sillion and Greenberg 1991: physical optics of a Gaussian random surface."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from albedo._compile import inlined, kernel
from albedo.brdf import Choice, Part, Real
from albedo.catalogue._fresnel import SOURCES_OF_FACTORS, FresnelChoice
from albedo.charts.cosine import CosineChart
from albedo.charts.polar import PolarChart
from albedo.fresnel import fresnel, is_careful
from albedo.geometry import one_less_v_dot_h, v_dot_h
from albedo.microfacet import beckmann_hidden
from albedo.special import exp

# Shadowing sets in along the horizon below n.v as small as the surface's slope: from here on that
# is a thin layer, which panels of its own see with fewer nodes.
_FLAT = 0.5


@kernel
def lambert_w(x):
    """Principal branch of Lambert's W for x >= 0, by Halley's iteration."""
    w = math.log1p(x)
    if x > 3.0:
        w = math.log(x)
        w -= math.log(w)
    elif x < 1.0:
        w = x * (1.0 + 1.5 * x) / (1.0 + x * (2.5 + x))
    for _ in range(4):
        if w > 1.0:
            # The equation in logarithms, which a huge x cannot overflow.
            f = w + math.log(w / x)
            step = f * w / (1.0 + w)
        else:
            e = math.exp(w)
            f = w * e - x
            step = f / (e * (w + 1.0) - 0.5 * (w + 2.0) * f / (w + 1.0))
        w -= step
        if abs(step) <= 1e-16 * w:
            break
    return w


@kernel
def lambert_w_of_exp(x):
    """W(e^x) for x > 100, by Newton's method for w + ln(w) = x."""
    w = x - math.log(x)
    for _ in range(4):
        w -= (w + math.log(w) - x) * w / (1.0 + w)
    return w


@kernel
def shadowed(ratio, c, s):
    """S1/cos(theta) of one direction (He et al. 1991, eqs. 24, 25, with the exponential 25 lacks).

    It stays a number at any cosine.
    """
    if s == 0.0:
        return 1.0 / c
    seen = 1.0 - 0.5 * math.erfc(0.5 * ratio * c / s)
    return seen / (c + beckmann_hidden(c, 2.0 * s / ratio))


@kernel
def roughness_slope(ratio, c, s):
    """K = tan(theta) erfc(tau/(2 sigma0 tan(theta))) (He et al. 1991, eq. 82)."""
    if s == 0.0:
        return 0.0
    # A sum of two is a number for denormal cosines too: what is read of it is its logarithm.
    return min(s / c, 1e307) * math.erfc(0.5 * ratio * c / s)


@kernel
def roughness2(k_sum):
    """(sigma/sigma0)^2 of the roughness that both directions see, K_L + K_V given.

    sqrt(pi/2) z0 = (sigma0/4)(K_L + K_V) exp(-z0^2/(2 sigma0^2)) (He et al. 1991, eqs. 80, 81)
    has the closed form (z0/sigma0)^2 = W(2 K^2/pi), K = (K_L + K_V)/4.
    """
    k = 0.25 * k_sum
    if k > 1e100:
        return 1.0 / (1.0 + lambert_w_of_exp(math.log(2.0 / math.pi) + 2.0 * math.log(k)))
    return 1.0 / (1.0 + lambert_w(2.0 * k * k / math.pi))


@kernel
def log_weight(g, m):
    """ln of g^m e^-g/m!, for m > 30 (Loader 2000)."""
    d = (m - g) / (m + g)
    if abs(d) < 0.1:
        # m log(m/g) + g - m without cancellation: 2 m sum_k d^(2k+1)/(2k+1) - (m - g).
        deviance = (m - g) * d
        power = 2.0 * m * d
        for k in range(1, 12):
            power *= d * d
            deviance += power / (2 * k + 1)
    else:
        deviance = m * math.log(m / g) + g - m
    m2 = m * m
    stirling = (1.0 / 12.0 - (1.0 / 360.0 - (1.0 / 1260.0 - 1.0 / (1680.0 * m2)) / m2) / m2) / m
    return -deviance - stirling


@inlined
def _eight_terms(first, way, c, root, rest, heights, over):
    """Fill the roots of exp(-c/m) root^2 rest^2, and them over m, for eight m up or down."""
    for j in range(heights.size):
        m = max(first + way * j, 1.0)
        height = root * exp(-0.5 * c / m) * rest
        heights[j] = height
        over[j] = height / m


@inlined
def _eight_weights(weight, ratios, heights, over):
    """Make weights of their ratios, the first to a given one; the sum of the terms, and the last.

    Terms are summed in pairs: nothing waits long for what comes before.
    """
    w_0 = weight * ratios[0]
    w_1 = w_0 * ratios[1]
    w_2 = w_1 * ratios[2]
    w_3 = w_2 * ratios[3]
    w_4 = w_3 * ratios[4]
    w_5 = w_4 * ratios[5]
    w_6 = w_5 * ratios[6]
    w_7 = w_6 * ratios[7]
    t_01 = w_0 * heights[0] * over[0] + w_1 * heights[1] * over[1]
    t_23 = w_2 * heights[2] * over[2] + w_3 * heights[3] * over[3]
    t_45 = w_4 * heights[4] * over[4] + w_5 * heights[5] * over[5]
    before, last = w_6 * heights[6] * over[6], w_7 * heights[7] * over[7]
    return (t_01 + t_23) + (t_45 + (before + last)), before, last, w_7


@kernel
def _huge_terms(weight, ratios, heights, over):
    """The sum of terms up to the first that is about to leave the range of numbers."""
    total = 0.0
    for j in range(heights.size):
        weight *= ratios[j]
        total += weight * heights[j] * over[j]
        if weight <= 1e-300 or heights[j] > 1e200:
            break
    return total


@kernel
def poisson_series(g, c, root, rest, room):
    """(root rest)^2 times the sum over m >= 1 of g^(m-1) e^-g/(m! m) exp(-c/m), root-wise.

    That is the series of He et al. 1991, eq. 78, over g, and what it is multiplied by: the series
    alone may be below the range of numbers. Up to g = 40 it starts with m = 1, up to 100 with the
    largest term, before which e^-g is below what float32 has. Above, the sum is a trapezoid rule
    of a smooth function, so a wider step around the largest term gives the same number.

    The room is three arrays of eight numbers: the terms come eight at a time, side by side.
    """
    ratios, heights, over = room
    if g <= 40.0:
        weight, total, first = math.exp(-g), 0.0, 1.0
        while True:
            _eight_terms(first, 1.0, c, root, rest, heights, over)
            for j in range(heights.size):
                ratios[j] = g / (first + j)
            if first == 1.0:
                ratios[0] = 1.0
            # They rise with m.
            if heights[7] > 1e200:
                return total + _huge_terms(weight, ratios, heights, over)
            some, before, last, weight = _eight_weights(weight, ratios, heights, over)
            total += some
            # The first terms of a far tail underflow: only a falling term ends the sum.
            if (total > 0.0 and last <= before and last <= 1e-17 * total) or weight <= 1e-300:
                return total
            first += 8.0
    # The largest term: m log(m/g) = c/m.
    m0 = g + c / g
    for _ in range(6):
        m0 -= (m0 * math.log(m0 / g) - c / m0) / (math.log(m0 / g) + 1.0 + c / (m0 * m0))
    if g <= 100.0:
        # Its floor, without an integer on the way.
        m0 -= m0 % 1.0
        largest = math.exp(log_weight(g, m0)) / (g * math.sqrt(2.0 * math.pi * m0))
        total = 0.0
        for side in range(2):
            way = 1.0 - 2.0 * side
            weight, first = largest, m0 - side
            while first >= 1.0:
                _eight_terms(first, way, c, root, rest, heights, over)
                for j in range(heights.size):
                    m = first + way * j
                    ratios[j] = g / m if side == 0 else (m + 1.0) / g
                    # Down to the first term, and no further.
                    if m < 1.0:
                        ratios[j] = 0.0
                if first == m0:
                    ratios[0] = 1.0
                some, _, last, weight = _eight_weights(weight, ratios, heights, over)
                total += some
                if last <= 1e-17 * total:
                    break
                first += 8.0 * way
        return total
    step = 0.55 / math.sqrt(1.0 / m0 + 2.0 * c / (m0 * m0 * m0))
    # A step that m0 can be added to exactly: nodes that are rounded cost sqrt(g) ulps.
    step = (m0 + step) - m0
    total = 0.0
    for j in range(-17, 20):
        m = m0 + j * step
        if m < 1.0:
            continue
        height = root * math.exp(0.5 * (log_weight(g, m) - c / m)) * rest
        total += height * (height * (step / g / (m * math.sqrt(2.0 * math.pi * m))))
    return total


@kernel
def fill(wi, wo, h, p, out):
    """f_dd = F(v.h) G S D / (pi n.l n.v), G = (2 v.h / n.h)^2."""
    # What knows no more of V than its height.
    shadow, roughness = np.empty(out.shape[1], out.dtype), np.empty(out.shape[1], out.dtype)
    room = np.empty(8, out.dtype), np.empty(8, out.dtype), np.empty(8, out.dtype)
    for j in range(out.shape[0]):
        lx, ly, lz = wi[0, j], wi[1, j], wi[2, j]
        ratio, k2s2, k2t2, scale = p[j, 0], p[j, 1], p[j, 2], p[j, 3]
        f_code, f_a, f_b, f_c = int(p[j, 5]), p[j, 6], p[j, 7], p[j, 8]
        careful = is_careful(f_code, f_a)
        sin_l = math.hypot(wi[0, j], wi[1, j])
        s_l = shadowed(ratio, lz, sin_l)
        k_l = roughness_slope(ratio, lz, sin_l)
        # Nodes that go around rings have heights that come again after so many.
        period = 0
        for i in range(out.shape[1]):
            vz = wo[2, j, i]
            if min(lz, vz) <= 0.0:
                out[j, i] = 0.0
                continue
            hx, hy, hz = h[0, j, i], h[1, j, i], h[2, j, i]
            if period == 0 and i > 0 and vz == wo[2, j, 0]:
                period = i
            if period > 0 and vz == wo[2, j, i - period]:
                s_v, rough = shadow[i - period], roughness[i - period]
            else:
                sin_v = math.hypot(wo[0, j, i], wo[1, j, i])
                s_v = shadowed(ratio, vz, sin_v)
                rough = k2s2 * roughness2(k_l + roughness_slope(ratio, vz, sin_v))
            shadow[i], roughness[i] = s_v, rough
            u = v_dot_h(hx, hy, hz)
            # G D has the series over h_z^2, and h_z^2 in its g.
            less = (
                one_less_v_dot_h(lx, ly, lz, wo[0, j, i], wo[1, j, i], vz, u) if careful else -1.0
            )
            factor = fresnel(f_code, f_a, f_b, f_c, u, less) * scale * rough / math.pi
            out[j, i] = poisson_series(
                *(rough * hz * hz, 0.25 * k2t2 * (hx * hx + hy * hy)),
                *(4.0 * u * u * math.sqrt(max(factor, 0.0)) * math.sqrt(s_l), math.sqrt(s_v), room),
            )


@kernel
def fill_diffuse(wi, wo, h, p, out):
    """f_ud = a_ud / pi."""
    for j in range(out.shape[0]):
        for i in range(out.shape[1]):
            out[j, i] = p[j, 4] / math.pi


@kernel
def mirror_share(c, p):
    """F e^-g S at the mirror direction: the energy of the Dirac part."""
    s = math.sqrt((1.0 - c) * (1.0 + c))
    shadow = c * shadowed(p[0], c, s)
    g = p[1] * roughness2(2.0 * roughness_slope(p[0], c, s)) * 4.0 * c * c
    return fresnel(int(p[5]), p[6], p[7], p[8], c) * math.exp(-g) * shadow * shadow


@kernel
def _mirror_shares(cos_theta, p, out):
    for i in range(out.size):
        out[i] = mirror_share(cos_theta[i], p) if cos_theta[i] > 0.0 else 0.0


class HeTorrance(FresnelChoice):
    """f = f_dd + a_ud/pi, plus a mirror part (He, Torrance, Sillion and Greenberg 1991).

    Directional diffuse: f_dd = F G S D/(pi n.l n.v) with the geometry factor in its closed form
    (2 v.h/n.h)^2, Smith's shadowing of 1967 and the series of the Gaussian surface; the
    wave number 2 pi/wavelength belongs in the lateral wave vector, and exp(-v^2) in eq. 25,
    which misses it in print. The mirror part carries F e^-g S of the energy. All lengths are in
    micrometres. For a large optical roughness f_dd tends to Cook-Torrance with
    m = 2 sigma0/tau. With F = 1 the sum exceeds 1 by some percent next to grazing incidence.
    """

    name = "he_torrance"
    title = "He-Torrance physical optics"
    equation = "He et al. 1991, eqs. 70 to 82"
    references = ("he1991", "neumann_pumping", *SOURCES_OF_FACTORS)
    tables = ("sigma0=0.02..0.5/32",)
    domain = "sigma0=0.01..1/9log,tau=0.5..50/9log"
    conserves_energy = False

    sigma0 = Real(0.1, "rms height of the surface", "um", low=1e-4, high=100.0)
    tau = Real(1.7, "correlation length", "um", low=1e-3, high=1e4)
    wavelength = Real(0.5, "wavelength of the light", "um", low=1e-2, high=1e3)
    a_ud = Real(0.0, "albedo of the uniform diffuse part", low=0.0, high=1.0)
    mirror = Choice("on", "mirror part", choices=("on", "off"))
    directional_diffuse = Choice("on", "directional diffuse part", choices=("on", "off"))

    def used(self, values: Mapping[str, Any]) -> tuple[str, ...]:
        others = super().used(values)
        return tuple(name for name in values if name in others or name == "wavelength")

    def pack(self) -> tuple[float, ...]:
        wave = 2.0 * math.pi / self.wavelength
        return (
            self.tau / self.sigma0,
            (wave * self.sigma0) ** 2,
            (wave * self.tau) ** 2,
            (0.5 * math.pi * self.tau / self.wavelength) ** 2,
            self.a_ud,
            *self.pack_fresnel(),
        )

    def parts(self) -> tuple[Part, ...]:
        parts = []
        if self.directional_diffuse == "on":
            slope = 2.0 * self.sigma0 / self.tau
            turn = slope if slope < _FLAT else 0.0
            optical = (2.0 * math.pi * self.sigma0 / self.wavelength) ** 2
            if optical > 1.0:
                chart, width = PolarChart("slope", edge=2, turn=turn), slope
            else:
                width = self.wavelength / (2.0 * math.pi * self.tau)
                chart = PolarChart("mirror_hemisphere", edge=2, turn=turn)
            parts.append(Part("directional_diffuse", fill, chart, (width, width)))
        if self.a_ud > 0.0:
            parts.append(Part("uniform_diffuse", fill_diffuse, CosineChart()))
        return tuple(parts)

    def spikes(self, wi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if self.mirror == "off":
            return super().spikes(wi)
        p = np.array(self.pack())
        directions = wi * np.array([-1.0, -1.0, 1.0])
        share = np.empty(wi.shape[0])
        _mirror_shares(np.ascontiguousarray(wi[:, 2]), p, share)
        return directions[None], share[None]

    def grazing_albedo(self) -> float:
        """Only a_ud: the roughness that is seen falls to 0, and with it e^-g -> 1 but S -> 0.

        The rest falls as slowly as 1/ln(1/n.l): by default it is 0.0026 at 1e-12, 0.0017 at 1e-18.
        """
        return float(self.a_ud)
