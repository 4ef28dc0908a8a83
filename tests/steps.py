"""Steps of pumping-up by another method: Nystroem's, with plain rules and plain values."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from albedo.brdf import Model
from albedo.directions import spherical


@lru_cache(maxsize=8)
def _grid(base: Model, size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Heights, their weights, and the integrals of f around rings: plain rules, plain values."""
    x, w = np.polynomial.legendre.leggauss(size)
    theta, weight = 0.25 * math.pi * (x + 1.0), 0.25 * math.pi * w
    c = np.cos(theta)
    phi = math.pi * (np.arange(4 * size) + 0.5) / (4 * size)
    views = spherical(c[:, None], phi)
    ring = [2.0 * math.pi * base.eval(light, views).mean(-1) for light in spherical(c, 0.0)]
    return c, weight * np.sin(theta) * c, np.array(ring)


def nystrom(base: Model, control: str | None, steps: int, size: int) -> tuple[np.ndarray, ...]:
    """Heights, and the albedo after some steps there."""
    c, weight, ring = _grid(base, size)
    higher = np.maximum(c[:, None], c[None, :])
    product = np.ones_like(ring)
    value = ring @ weight
    for _ in range(steps):
        step = np.maximum(value[:, None], value[None, :])
        product = product * (np.maximum(step, higher) if control == "literal" else step)
        divisor = np.maximum(product, higher) if control == "cumulative" else product
        value = (ring / divisor) @ weight
    return c, value
