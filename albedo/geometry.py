"""Compiled geometry that several models read: cosines of small angles without cancellation."""

from __future__ import annotations

import math

from albedo._compile import kernel


@kernel
def slope2(hx, hy, hz):
    """tan^2 of the angle between h and the normal; h need not be normalised."""
    x = hx / hz
    y = hy / hz
    return x * x + y * y


@kernel
def v_dot_h(hx, hy, hz):
    """Cosine of the half angle, v.h = l.h = |h|/2."""
    square = hx * hx + hy * hy + hz * hz
    if square >= 1e-280:
        return 0.5 * math.sqrt(square)
    # Opposite each other next to the horizon squares underflow; a call would slow down all others.
    x, y, z = 1e200 * hx, 1e200 * hy, 1e200 * hz
    return 0.5e-200 * math.sqrt(x * x + y * y + z * z)


@kernel
def one_less_v_dot_h(lx, ly, lz, vx, vy, vz, u):
    """1 - v.h = |l - v|^2/(4 (1 + v.h)), u = v.h: nothing cancels next to V = L."""
    x, y, z = lx - vx, ly - vy, lz - vz
    return 0.25 * (x * x + y * y + z * z) / (1.0 + u)


STEEPEST = 1e75
"""Slopes of h whose fourth power is still a number."""


SAFE = 1e-30
"""Products above this, and quotients by them, are far from where numbers end, in float32 too."""


@kernel
def capped_slopes(hx, hy, hz):
    """Slopes of h along x and y, at most `STEEPEST`, without a branch."""
    height = max(hz, max(abs(hx), abs(hy)) / STEEPEST)
    return hx / height, hy / height


@kernel
def slopes(hx, hy, hz):
    """Slopes of h along x and y, at most `STEEPEST`, and the logarithm of what they lack, squared.

    Next to the horizon h.x/h.z overflows; the azimuth is kept.
    """
    most = max(abs(hx), abs(hy))
    if most > STEEPEST * hz:
        # h.z may be 0 where V is below the horizon.
        lift = 2.0 * (math.log(most) - math.log(STEEPEST) - math.log(max(hz, 5e-324)))
        return STEEPEST * (hx / most), STEEPEST * (hy / most), lift
    return hx / hz, hy / hz, 0.0


@kernel
def log_secant2(hx, hy, hz):
    """-2 ln(n.h) = ln(1 + tan^2) of the angle of h."""
    square = hz * hz
    if square > SAFE:
        return math.log1p((hx * hx + hy * hy) / square)
    x, y, lift = slopes(hx, hy, hz)
    return math.log1p(x * x + y * y) + lift


@kernel
def along_azimuth(a, b, hx, hy):
    """a cos^2 + b sin^2 of the azimuth of h; a where h is the normal."""
    # Scaled so that squares do not underflow, in float32 (where 1e-120 is 0) neither.
    most, up = max(abs(hx), abs(hy)), 1.0
    if most < 1e-15:
        up = 1e30
    if most < 1e-120:
        up = 1e250
    x, y = up * hx, up * hy
    square = x * x + y * y
    return (a * (x * x) + b * (y * y)) / square if square > 0.0 else a


@kernel
def cosine_difference(lx, ly, lz, hx, hy, hz, vz):
    """n.l - n.v from the half vector: -(2 l - h)_t . h_t / h_z where that rounds less."""
    if hz * hz > math.sqrt(hx * hx + hy * hy):
        return -((2.0 * lx - hx) * hx + (2.0 * ly - hy) * hy) / hz
    return lz - vz


@kernel
def mirror_offset2(lx, ly, lz, hx, hy, hz, vz):
    """|R - V|^2 = 2 (1 - R.V) for the mirror direction R of L: R - V = (-h_x, -h_y, l_z - v_z)."""
    dz = cosine_difference(lx, ly, lz, hx, hy, hz, vz)
    return hx * hx + hy * hy + dz * dz


@kernel
def cosine_power(offset2, n):
    """max(0, cos(a))^n with |chord|^2 = offset2 = 2 (1 - cos(a)); 0 where cos(a) <= 0."""
    if offset2 >= 2.0:
        return 0.0
    return math.exp(n * math.log1p(-0.5 * offset2))


@kernel
def cosine_root(offset2, cosine, n):
    """max(0, cos(a))^(n/2), whose square may be below the range of numbers.

    By the chord, |chord|^2 = offset2 = 2 (1 - cos(a)), up to 60 degrees. Beyond, by the cosine
    itself: of 1 - offset2/2 little is right where cos(a) is small, and a small n does not hide it.
    """
    if offset2 < 1.0:
        return math.exp(0.5 * n * math.log1p(-0.5 * offset2))
    return math.exp(0.5 * n * math.log(cosine)) if cosine > 0.0 else 0.0


@kernel
def mirror_root(lx, ly, lz, vx, vy, vz, hx, hy, hz, n):
    """max(0, r.v)^(n/2), r.v = (n.l)(n.v) - (l_x v_x + l_y v_y)."""
    offset2 = mirror_offset2(lx, ly, lz, hx, hy, hz, vz)
    return cosine_root(offset2, lz * vz - (lx * vx + ly * vy), n)


@kernel
def normal_power(tan2, n):
    """(n.h)^n from tan^2 of the angle of h."""
    return math.exp(-0.5 * n * math.log1p(tan2))


@kernel
def normal_root(hx, hy, hz, n):
    """(n.h)^(n/2), whose square may be below the range of numbers."""
    return math.exp(-0.25 * n * log_secant2(hx, hy, hz))


@kernel
def divided(scale, root, a, b):
    """scale root^2/(a b): nothing leaves the range of numbers before the result does.

    0 where a cosine that is divided by is not above 0.
    """
    product = a * b
    if product > SAFE:
        return scale * root * (root / product)
    larger, smaller = max(a, b), min(a, b)
    if smaller <= 0.0:
        return 0.0
    partly, other = scale * root / larger, root / smaller
    return partly * other if other <= 1e300 else partly * root / smaller
