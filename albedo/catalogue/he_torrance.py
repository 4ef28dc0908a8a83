"""He, Torrance, Sillion and Greenberg 1991: physical optics of a Gaussian random surface."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from albedo._compile import kernel
from albedo.brdf import Choice, Part, Real
from albedo.catalogue._fresnel import SOURCES_OF_FACTORS, FresnelChoice
from albedo.catalogue._orders import ALONE, SIDE, fill_series, poisson_series
from albedo.charts.cosine import CosineChart
from albedo.charts.polar import PolarChart
from albedo.charts.rings import RingsChart
from albedo.fresnel import fresnel, is_careful
from albedo.geometry import one_less_v_dot_h, v_dot_h
from albedo.microfacet import beckmann_hidden
from albedo.sampling.routines import ggx_normals

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
def _period(heights):
    """After how many places heights come again, as those of nodes that go around rings do."""
    period = 1
    while period < heights.size and heights[period] != heights[0]:
        period += 1
    other = 0
    for i in range(period, heights.size):
        other += heights[i] != heights[i - period]
    return period if other == 0 else heights.size


@kernel
def fill(wi, wo, h, p, out):
    """f_dd = F(v.h) G S D / (pi n.l n.v), G = (2 v.h / n.h)^2."""
    count = out.shape[1]
    # What knows no more of V than its height.
    rest, roughness = np.empty(count, out.dtype), np.empty(count, out.dtype)
    g, c, root = np.empty(count, out.dtype), np.empty(count, out.dtype), np.empty(count, out.dtype)
    room = np.empty(8, out.dtype), np.empty(8, out.dtype), np.empty(8, out.dtype)
    side = (
        *(np.empty(SIDE, out.dtype), np.empty(SIDE, out.dtype), np.empty(SIDE, out.dtype)),
        *(np.empty(SIDE, out.dtype), np.empty(SIDE, out.dtype)),
    )
    for j in range(out.shape[0]):
        lx, ly, lz = wi[0, j], wi[1, j], wi[2, j]
        ratio, k2s2, k2t2, scale = p[j, 0], p[j, 1], p[j, 2], p[j, 3]
        f_code, f_a, f_b, f_c = int(p[j, 5]), p[j, 6], p[j, 7], p[j, 8]
        sin_l = math.hypot(wi[0, j], wi[1, j])
        k_l = roughness_slope(ratio, lz, sin_l)
        root_l = math.sqrt(shadowed(ratio, lz, sin_l)) if lz > 0.0 else 0.0
        period = _period(wo[2, j])
        for i in range(min(period, count)):
            vz = wo[2, j, i]
            if min(lz, vz) <= 0.0:
                rest[i] = roughness[i] = 0.0
            else:
                sin_v = math.hypot(wo[0, j, i], wo[1, j, i])
                rough = k2s2 * roughness2(k_l + roughness_slope(ratio, vz, sin_v))
                rest[i] = math.sqrt(shadowed(ratio, vz, sin_v)) * math.sqrt(rough * scale / math.pi)
                roughness[i] = rough
        for first in range(period, count, period):
            for i in range(min(period, count - first)):
                rest[first + i], roughness[first + i] = rest[i], roughness[i]
        for i in range(count):
            hx, hy, hz = h[0, j, i], h[1, j, i], h[2, j, i]
            # G D has the series over h_z^2, and h_z^2 in its g.
            across, up = hx * hx + hy * hy, hz * hz
            g[i], c[i] = roughness[i] * up, 0.25 * k2t2 * across
            # Twice v.h is |h|.
            root[i] = (across + up) * root_l
        if f_code != 0:
            careful = is_careful(f_code, f_a)
            for i in range(count):
                u, less = v_dot_h(h[0, j, i], h[1, j, i], h[2, j, i]), -1.0
                if careful:
                    vx, vy, vz = wo[0, j, i], wo[1, j, i], wo[2, j, i]
                    less = one_less_v_dot_h(lx, ly, lz, vx, vy, vz, u)
                root[i] *= math.sqrt(max(fresnel(f_code, f_a, f_b, f_c, u, less), 0.0))
        if count < ALONE:
            for i in range(count):
                out[j, i] = poisson_series(g[i], c[i], root[i], rest[i], room)
        else:
            fill_series(g, c, root, rest, side, room, out[j])


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
            # Of the facets, or of one wave.
            waves = self.wavelength / (2.0 * math.pi * self.tau)
            width = max(slope, waves)
            chart = PolarChart("slope", edge=2, turn=turn)
            rings = RingsChart("projected", waves=waves, around=self.fresnel_around)
            # On a smooth surface next to the horizon the lobe of waves is wider in slopes.
            smooth = 2.0 * math.pi * self.sigma0 <= self.wavelength
            routine = ggx_normals(2.0 * waves, 2.0 * waves) if smooth else None
            one = Part("directional_diffuse", fill, chart, (width, width))
            parts.append(replace(one, rings=rings, routine=routine))
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
