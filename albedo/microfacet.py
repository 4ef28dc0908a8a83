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
def distribution_root(code, kx, ky, x2, y2, lift):
    """The root of D over its constant, of the half vector with squared slopes (x2, y2).

    An exponential alone may be below the range of numbers though what it is multiplied by brings it
    back. `lift` is what `albedo.geometry.slopes` says of slopes that would be above it.
    """
    tan2 = x2 + y2
    q = 1.0 + tan2
    if code == 1:
        return q / (1.0 + x2 * kx + y2 * ky)
    if code == 0:
        return math.exp(-0.5 * (x2 * kx + y2 * ky)) * q
    if code == 2:
        return math.exp(-0.25 * kx * (math.log1p(tan2) + lift))
    if code == 3:
        delta = math.atan(math.sqrt(tan2))
        return math.exp(-0.5 * (delta * delta) * kx)
    n = kx
    if tan2 > 0.0:
        n = (kx * x2 + ky * y2) / tan2
    return math.exp(-0.25 * n * (math.log1p(tan2) + lift))


@kernel
def distribution(code, kx, ky, scale, x2, y2, lift=0.0):
    """D of the half vector with squared slopes (x2, y2).

    kx, ky are inverse squared widths for beckmann, ggx and gaussian, and exponents for the two
    powers; `scale` is the normalisation constant, which does not depend on direction.

    Sources: Beckmann and GGX, Walter et al. 2007, eqs. 25 and 33; Blinn-Phong and Gaussian,
    Schwenk, eqs. 36 and 37; Ashikhmin-Shirley, Schwenk, eq. 39, with the constant that makes
    the projected integral 1 (as printed it lacks 1/(2 pi) and is normalised over solid angle).
    """
    root = distribution_root(code, kx, ky, x2, y2, lift)
    return scale * root * root


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
def beckmann_hidden(c, width):
    """c Lambda of `beckmann_lambda` for a = c/width."""
    if c >= 2.5 * width:
        return c * beckmann_lambda(c / width) if c <= 27.0 * width else 0.0
    a = c / width
    return 0.5 * (width * math.exp(-a * a) / 1.7724538509055160273 - c * math.erfc(a))


RATIONAL_END = (1.259 - math.sqrt(1.259**2 - 4.0 * 0.396)) / (2.0 * 0.396)
"""Where `rational_hidden` ends: it has a kink there."""


@kernel
def rational_hidden(a):
    """a Lambda of the rational fit to `beckmann_lambda` (Walter et al. 2007, eq. 27, as 1/G1 - 1).

    The fit ends at a = 1.6, but from a = 1.548 on its G1 is above 1, by up to 6e-5, and is taken
    as 1 here: so nothing jumps.
    """
    if a >= 1.6:
        return 0.0
    return max(0.0, 1.0 + a * (-1.259 + 0.396 * a)) / (3.535 + 2.181 * a)


@kernel
def hidden_cosine(geometry, code, ax2, ay2, vx, vy, vz):
    """n.v Lambda(v), Lambda = 1/G1(v) - 1, for squared slope widths ax2, ay2.

    Towards the horizon Lambda overflows; this is a number, and n.v/G1 is n.v and this.

    Smith's masking is exact for beckmann and ggx. The other distributions borrow beckmann's: the
    two powers with alpha^2 = 2/(n + 2) (Walter et al. 2007, sect. 5.2), the Gaussian with its own
    m. That is not the masking that belongs to them: their furnace is not exact.

    Schlick-Smith: G1 = v/(v (1 - k) + k) of v = n.v and k = m sqrt(2/pi) (Schlick 1994),
    so that 1/G1 - 1 = k (1 - v)/v, with m the width in the azimuth of v.
    """
    width = math.sqrt(ax2 * vx * vx + ay2 * vy * vy)
    if geometry == 4:
        return math.sqrt(2.0 / math.pi) * width * math.hypot(vx, vy) / (1.0 + vz)
    if geometry == 5:
        return width * rational_hidden(vz / width) if width > 0.0 else 0.0
    if code == 1:
        # (sqrt(1 + tan^2) - 1)/2 (Walter et al. 2007, eq. 34) without cancellation.
        return 0.5 * width * width / (vz + math.sqrt(vz * vz + width * width))
    return beckmann_hidden(vz, width)


@kernel
def v_cavity(n_dot_h, n_dot_l, n_dot_v, l_dot_h):
    """Torrance and Sparrow's masking, NNS eq. 10: min(1, 2 NH NV/VH, 2 NH NL/VH)."""
    return min(1.0, 2.0 * n_dot_h * min(n_dot_l, n_dot_v) / l_dot_h)


@kernel
def cavity_cosines(hz, lz, vz, u):
    """Two numbers, 1/(a b) = G/(n.l n.v) of `v_cavity`, h = l + v not normalised and u = v.h."""
    larger, smaller = max(lz, vz), min(lz, vz)
    # min(1, x)/smaller is 1/max(smaller, smaller/x), and smaller/x is u^2/h_z.
    return larger, max(smaller, u * (u / hz))


@kernel
def correlated_cosines(lz, hidden_l, vz, hidden_v):
    """Two numbers, 1/(a b) = 1/(n.l n.v (1 + Lambda_l + Lambda_v)), from what is hidden of each."""
    if lz > vz:
        return lz, vz + hidden_v + vz / lz * hidden_l
    return vz, lz + hidden_l + lz / vz * hidden_v
