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
    return 0.5 * math.sqrt(hx * hx + hy * hy + hz * hz)


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
def normal_power(tan2, n):
    """(n.h)^n from tan^2 of the angle of h."""
    return math.exp(-0.5 * n * math.log1p(tan2))
