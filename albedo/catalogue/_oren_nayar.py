"""What Oren and Nayar's model and its successors share: coefficients, and Fujii's lobe."""

from __future__ import annotations

from albedo._compile import kernel
from albedo.charts.cosine import CosineChart

CHART = CosineChart("max", angle=True)
"""All of them are functions of the angles, with a kink, or a layer, at n.v = n.l."""


def spread(sigma: float) -> tuple[float, float]:
    """s^2/(s^2 + 0.33) and s^2/(s^2 + 0.09), what masking and the lobe towards the light follow."""
    s2 = sigma * sigma
    return s2 / (s2 + 0.33), s2 / (s2 + 0.09)


def interreflection(sigma: float) -> float:
    """0.17 s^2/(s^2 + 0.13), the share of light that meets a second facet, for rho = 1."""
    s2 = sigma * sigma
    return 0.17 * s2 / (s2 + 0.13)


@kernel
def fujii(lx, ly, lz, vx, vy, vz, hx, hy, a, b, a_less_b):
    """a + b s/t: s = l.v - (n.l)(n.v), t = 1 if s <= 0 else max(n.l, n.v).

    Where s < 0 it is a - b + b (1 + s), and 1 + s is a sum of squares: towards s = -1 nothing
    cancels.
    """
    s = lx * vx + ly * vy
    if s > 0.0:
        return a + b * s / max(lz, vz)
    return a_less_b + 0.5 * b * (hx * hx + hy * hy + lz * lz + vz * vz)
