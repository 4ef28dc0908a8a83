r"""Microfacet distributions and masking functions.

Every distribution D is normalised so that its projected integral \int D(h) (n.h) dh over the
hemisphere is 1, and is a function of the slopes x = h.x/h.z, y = h.y/h.z.
"""

from __future__ import annotations

import math

from albedo._compile import kernel

DISTRIBUTIONS = {"beckmann": 0, "ggx": 1, "blinn_phong": 2, "gaussian": 3, "ashikhmin_shirley": 4}
GEOMETRIES = {
    "none": 0,
    "v_cavity": 1,
    "smith": 2,
    "smith_correlated": 3,
    "schlick_smith": 4,
    "smith_rational": 5,
}


@kernel
def distribution(code, kx, ky, scale, x2, y2):
    """D of the half vector with squared slopes (x2, y2).

    kx, ky are inverse squared widths for beckmann, ggx and gaussian, and exponents for the two
    powers; `scale` is the normalisation constant, which does not depend on direction.

    Sources: Beckmann and GGX, Walter et al. 2007, eqs. 25 and 33; Blinn-Phong and Gaussian,
    Schwenk, eqs. 36 and 37; Ashikhmin-Shirley, Schwenk, eq. 39, with the constant that makes
    the projected integral 1 (as printed it lacks 1/(2 pi) and is normalised over solid angle).
    """
    tan2 = x2 + y2
    q = 1.0 + tan2
    if code == 1:
        g = q / (1.0 + x2 * kx + y2 * ky)
        return scale * g * g
    if code == 0:
        return scale * math.exp(-(x2 * kx + y2 * ky)) * q * q
    if code == 2:
        return scale * math.exp(-0.5 * kx * math.log1p(tan2))
    if code == 3:
        delta = math.atan(math.sqrt(tan2))
        return scale * math.exp(-(delta * delta) * kx)
    n = kx
    if tan2 > 0.0:
        n = (kx * x2 + ky * y2) / tan2
    return scale * math.exp(-0.5 * n * math.log1p(tan2))


@kernel
def beckmann_lambda(a):
    """Smith's Lambda for Beckmann slopes, a = 1/(alpha tan(theta)) (Walter et al. 2007, sect. 5.2).

    Lambda = (exp(-a^2)/(a sqrt(pi)) - erfc(a))/2; from a = 2.5 on the difference is written with
    the continued fraction of erfc, whose leading term cancels exactly.
    """
    if a > 27.0:
        return 0.0
    e = math.exp(-a * a) / 1.7724538509055160273
    if a < 2.5:
        return 0.5 * (e / a - math.erfc(a))
    k = 0.0
    for i in range(10 + int(250.0 / (a * a)), 0, -1):
        k = 0.5 * i / (a + k)
    return 0.5 * e * k / (a * (a + k))


@kernel
def smith_lambda(code, ax2, ay2, vx, vy, vz):
    """Smith's Lambda(v) for squared slope widths ax2, ay2: exact for beckmann and ggx.

    The other distributions borrow beckmann's: the two powers with alpha^2 = 2/(n + 2) (Walter et
    al. 2007, sect. 5.2), the Gaussian with its own m. That is not the masking that belongs to
    them: their furnace is not exact.
    """
    t2 = (ax2 * vx * vx + ay2 * vy * vy) / (vz * vz)
    if code == 1:
        return 0.5 * t2 / (1.0 + math.sqrt(1.0 + t2))
    if t2 == 0.0:
        return 0.0
    return beckmann_lambda(1.0 / math.sqrt(t2))


RATIONAL_END = (1.259 - math.sqrt(1.259**2 - 4.0 * 0.396)) / (2.0 * 0.396)
"""Where `rational_lambda` ends: it has a kink there."""


@kernel
def rational_lambda(a):
    """The rational fit to `beckmann_lambda` (Walter et al. 2007, eq. 27, as 1/G1 - 1).

    The fit ends at a = 1.6, but from a = 1.548 on its G1 is above 1, by up to 6e-5, and is taken
    as 1 here: so nothing jumps.
    """
    if a >= 1.6:
        return 0.0
    return max(0.0, 1.0 + a * (-1.259 + 0.396 * a)) / (a * (3.535 + 2.181 * a))


@kernel
def masking_lambda(geometry, code, ax2, ay2, vx, vy, vz):
    """1/G1(v) - 1 of the maskings that are products or sums of directions' own.

    Schlick-Smith: G1 = v/(v (1 - k) + k) of v = n.v and k = m sqrt(2/pi) (Schlick 1994),
    so that 1/G1 - 1 = k (1 - v)/v, with m the width in the azimuth of v.
    """
    if geometry <= 3:
        return smith_lambda(code, ax2, ay2, vx, vy, vz)
    if geometry == 4:
        s = math.hypot(vx, vy)
        width = math.sqrt(ax2 * vx * vx + ay2 * vy * vy)
        return math.sqrt(2.0 / math.pi) * width * s / ((1.0 + vz) * vz)
    t2 = (ax2 * vx * vx + ay2 * vy * vy) / (vz * vz)
    return rational_lambda(1.0 / math.sqrt(t2)) if t2 > 0.0 else 0.0


@kernel
def v_cavity(n_dot_h, n_dot_l, n_dot_v, l_dot_h):
    """Torrance and Sparrow's masking, NNS eq. 10: min(1, 2 NH NV/VH, 2 NH NL/VH)."""
    return min(1.0, 2.0 * n_dot_h * min(n_dot_l, n_dot_v) / l_dot_h)
