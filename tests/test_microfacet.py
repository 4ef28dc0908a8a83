"""Distributions, masking functions, Fresnel factors and special functions, each on its own."""

from __future__ import annotations

import math

import numpy as np

import albedo
from albedo.brdf import Model
from albedo.microfacet import DISTRIBUTIONS, distribution

EPS = np.finfo(float).eps

# Widths or exponents along x and y.
SHAPES: dict[str, list[tuple[float, float]]] = {
    "beckmann": [(1.0, 1.0), (0.1, 0.1), (1e-6, 1e-6), (0.5, 0.05)],
    "ggx": [(1.0, 1.0), (0.1, 0.1), (1e-6, 1e-6), (0.5, 0.05)],
    "gaussian": [(1.0, 1.0), (0.1, 0.1), (1e-6, 1e-6), (10.0, 10.0)],
    "blinn_phong": [(0.0, 0.0), (1.0, 1.0), (100.0, 100.0), (1e8, 1e8)],
    "ashikhmin_shirley": [(0.0, 0.0), (100.0, 100.0), (1e4, 1.0), (1.0, 1e8)],
}
CASES = [(name, shape) for name, shapes in SHAPES.items() for shape in shapes]
POWERS = ("blinn_phong", "ashikhmin_shirley")


def microfacets(name: str, shape: tuple[float, float], **choices: object) -> Model:
    """The Cook-Torrance model with this distribution."""
    if name in ("gaussian", "blinn_phong"):
        sharp = {"n" if name in POWERS else "m": shape[0]}
    else:
        names = ("n_u", "n_v") if name in POWERS else ("alpha_x", "alpha_y")
        sharp = dict(zip(names, shape, strict=True))
    return albedo.model("cook_torrance", distribution=name, **sharp, **choices)


def slope_widths(name: str, shape: tuple[float, float]) -> tuple[float, float]:
    """Widths in slopes at which the distribution has fallen by about e."""
    if name in POWERS:
        return math.sqrt(2.0 / (shape[0] + 2.0)), math.sqrt(2.0 / (shape[1] + 2.0))
    return min(shape[0], 2.0), min(shape[1], 2.0)


def over_half_vectors(name: str, shape: tuple[float, float]) -> tuple[np.ndarray, ...]:
    """Unit half vectors over the hemisphere, with D dh; a dense product rule in stretched slopes.

    x = w_x r cos(a), y = w_y r sin(a): the trapezoid rule in a, and one in the double exponential
    variable t of r = exp(pi/2 sinh(t)), which reaches both ends of (0, inf).
    """
    p = microfacets(name, shape).pack()
    w_x, w_y = slope_widths(name, shape)
    t = np.linspace(-3.6, 3.6, 721)
    r = np.exp(0.5 * math.pi * np.sinh(t))
    dr = r * 0.5 * math.pi * np.cosh(t) * (t[1] - t[0])
    turns = 64 if shape[0] == shape[1] else 4096
    a = np.linspace(0.0, 2.0 * math.pi, turns, endpoint=False)
    x, y = w_x * r[:, None] * np.cos(a), w_y * r[:, None] * np.sin(a)
    code, (kx, ky, scale) = DISTRIBUTIONS[name], p[2:5]
    d = (
        np.array(
            [
                distribution(code, kx, ky, scale, u, v)
                for u, v in zip((x * x).ravel(), (y * y).ravel(), strict=True)
            ]
        ).reshape(x.shape)
        if turns == 64
        else np.vectorize(distribution)(code, kx, ky, scale, x * x, y * y)
    )
    root = np.sqrt(1.0 + x * x + y * y)
    weight = d / root**3 * w_x * w_y * (r * dr)[:, None] * (2.0 * math.pi / turns)
    return x / root, y / root, 1.0 / root, weight
