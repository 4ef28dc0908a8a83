"""What the models with Lafortune's lobes share: their numbers, their kernel and their charts."""

from __future__ import annotations

import math
from typing import Any

from albedo._compile import kernel
from albedo.catalogue._phong import mirror_chart, mirror_width
from albedo.charts.axis import AxisChart
from albedo.geometry import cosine_root, mirror_offset2
from albedo.sampling.routines import Routine, axis_power, mirror_power

COLUMNS = 10
"""How many packed numbers a lobe has."""


@kernel
def fill(wi, wo, h, p, out):
    """f = scale max(0, o.v)^n, o = (c_x l.x, c_y l.y, c_z l.z); as scale |o|^n (a.v)^n.

    With C the largest |c|, |o|^2 = C^2 (1 - sum (1 - c_i^2/C^2) l_i^2): nothing is rounded that n
    would amplify where all |c| are nearly equal. By the chord, 1 - a.v = |a - v|^2/2 close to a.
    """
    for j in range(out.shape[0]):
        lx, ly, lz = wi[0, j], wi[1, j], wi[2, j]
        n, mirror, scale = p[j, 3], p[j, 8], p[j, 9]
        ax, ay, az = p[j, 0] * lx, p[j, 1] * ly, p[j, 2] * lz
        length = math.sqrt(ax * ax + ay * ay + az * az)
        if length == 0.0:
            out[j] = 0.0
            continue
        ax, ay, az = ax / length, ay / length, az / length
        less = p[j, 5] * lx * lx + p[j, 6] * ly * ly + p[j, 7] * lz * lz
        log_o = 0.5 * math.log1p(-less) if less < 0.5 else math.log(length)
        # The root of the peak, which alone may be above the range of numbers.
        peak = math.exp(0.5 * n * (p[j, 4] + log_o))
        for i in range(out.shape[1]):
            vx, vy, vz = wo[0, j, i], wo[1, j, i], wo[2, j, i]
            if mirror > 0.0:
                d2 = mirror_offset2(lx, ly, lz, h[0, j, i], h[1, j, i], h[2, j, i], vz)
            else:
                d2 = (ax - vx) ** 2 + (ay - vy) ** 2 + (az - vz) ** 2
            root = cosine_root(d2, ax * vx + ay * vy + az * vz, n)
            out[j, i] = scale * (peak * root) * (peak * root) if root > 0.0 else 0.0


def is_mirror(c: tuple[float, float, float]) -> bool:
    """Whether the lobe is one about the mirror direction."""
    return c[0] == c[1] == -c[2] and c[2] > 0.0


def log_largest(c: tuple[float, float, float]) -> float:
    """Logarithm of the largest length of o."""
    return math.log(max(abs(x) for x in c))


def lobe_numbers(c: tuple[float, float, float], n: float, scale: float = 1.0) -> tuple[float, ...]:
    """What the kernel reads of a lobe."""
    top = max(abs(x) for x in c)
    less = ((top - abs(x)) / top * ((top + abs(x)) / top) for x in c)
    return (*(x / top for x in c), n, math.log(top), *less, float(is_mirror(c)), scale)


def lobe_layout(c: tuple[float, float, float], n: float) -> tuple[Any, tuple[float, float]]:
    """Chart and widths of a lobe."""
    if is_mirror(c):
        return mirror_chart(n), (mirror_width(n),) * 2
    width = 1.0 / math.sqrt(max(n, 1e-6))
    return AxisChart(c, edge=4 if n < 1.0 else 2 if n < 3.0 else 1), (width, width)


def lobe_routine(c: tuple[float, float, float], n: float) -> Routine:
    """How to draw directions of a lobe."""
    return mirror_power(n) if is_mirror(c) else axis_power(c, n)
