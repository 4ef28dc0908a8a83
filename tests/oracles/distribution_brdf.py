"""distribution_brdf, once more."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from functools import cache
from typing import Any

from exact import Number, distribution, dot, fresnel_of, half, mp

CHECKED_BY = "test_distribution_brdf.py"
"""Where the albedo is held against something independent."""

FALLING = ((0.0, 9.0), (0.1, 4.0), (0.25, 0.7), (0.6, 0.02), (1.3, 0.001))
RISING = ((0.2, 0.01), (1.0, 0.2), (1.3, 3.0), (1.5, 9.0))

CASES: list[dict[str, Any]] = [
    {"m": 1.0, "distribution": "ggx"},
    {"m": 0.3, "distribution": "ggx", "normalization": "solid_angle"},
    {"m": 3.0, "normalization": "solid_angle"},
    {"m": 1.0, "distribution": "ggx", "normalization": "solid_angle"},
    {"alpha_x": 0.4, "alpha_y": 0.1, "distribution": "ggx"},
    {"n": 3.0, "distribution": "blinn_phong", "normalization": "solid_angle"},
    {"distribution": "velvet", "fresnel": "schlick", "f0": 0.04},
    {"distribution": "tabulated", "density": FALLING, "normalization": "solid_angle"},
    {"distribution": "tabulated", "density": FALLING, "fresnel": "schlick", "f0": 0.04},
    {"distribution": "tabulated", "density": RISING},
    {"distribution": "tabulated", "density": RISING, "normalization": "as_given"},
]
"""Sets of parameters that matter together."""


@cache
def whole(kind: str, width: tuple[float, float]) -> Number:
    """The integral of a distribution of one width over solid angle, in the cosine c of h."""
    m = mp.mpf(width[0])

    def density(c: Number) -> Number:
        return distribution(kind, width, (mp.sqrt(1 - c * c), mp.zero, c))

    # Towards c = 1 a lobe of width m is as wide as m^2.
    cuts = sorted({mp.zero, mp.one} | {1 / mp.sqrt(1 + (m * 2**k) ** 2) for k in range(-8, 9)})
    return 2 * mp.pi * mp.quad(density, cuts)


@cache
def spline(density: tuple[tuple[float, float], ...]) -> list[tuple[Number, Number, Number]]:
    """Angles, logarithms of p and slopes of the clamped cubic spline."""
    x = [mp.mpf(angle) for angle, _ in density]
    y = [mp.log(mp.mpf(value)) for _, value in density]
    count = len(x)
    rows, right = mp.eye(count), mp.zeros(count, 1)
    # The second derivatives of neighbouring Hermite pieces agree; at the ends the slopes are 0.
    for k in range(1, count - 1):
        a, b = x[k] - x[k - 1], x[k + 1] - x[k]
        rows[k, k - 1], rows[k, k], rows[k, k + 1] = 1 / a, 2 / a + 2 / b, 1 / b
        right[k] = 3 * ((y[k] - y[k - 1]) / a**2 + (y[k + 1] - y[k]) / b**2)
    slopes = mp.lu_solve(rows, right)
    return [(x[k], y[k], slopes[k]) for k in range(count)]


def tabulated(density: tuple[tuple[float, float], ...], angle: Number) -> Number:
    """exp of the spline, in Hermite's form."""
    knots = spline(density)
    if angle <= knots[0][0]:
        return mp.exp(knots[0][1])
    for (x, y, d), (x_2, y_2, d_2) in itertools.pairwise(knots):
        if angle <= x_2:
            size = x_2 - x
            t = (angle - x) / size
            return mp.exp(
                (1 + 2 * t) * (1 - t) ** 2 * y
                + t * t * (3 - 2 * t) * y_2
                + size * (t * (1 - t) ** 2 * d - t * t * (1 - t) * d_2)
            )
    return mp.exp(knots[-1][1])


@cache
def tabulated_whole(density: tuple[tuple[float, float], ...], normalization: str) -> Number:
    """What a table is divided by."""
    if normalization == "as_given":
        return mp.one

    def height(angle: Number) -> Number:
        more = mp.cos(angle) if normalization == "projected" else mp.one
        return tabulated(density, angle) * more * mp.sin(angle)

    ends = sorted({mp.zero, mp.pi / 2} | {mp.mpf(angle) for angle, _ in density})
    return 2 * mp.pi * mp.quad(height, ends)


def brdf(p: Mapping[str, Any], light: Any, view: Any) -> Number:
    kind = p["distribution"]
    h = half(light, view)
    if kind == "velvet":
        a, sine2 = mp.mpf(p["spread"]), h[0] ** 2 + h[1] ** 2
        hairs = 4 * mp.exp(-(h[2] ** 2) / (sine2 * a * a)) / sine2**2 if sine2 > 0 else mp.zero
        density = (1 + hairs) / (mp.pi * (1 + 4 * a * a))
    elif kind == "tabulated":
        density = tabulated(p["density"], mp.atan2(mp.hypot(h[0], h[1]), h[2]))
        density /= tabulated_whole(p["density"], p["normalization"])
    elif kind == "blinn_phong":
        n = mp.mpf(p["n"])
        more = 1 if p["normalization"] == "solid_angle" else 2
        density = (n + more) / (2 * mp.pi) * h[2] ** n
    else:
        width = (p["alpha_x"], p["alpha_y"])
        density = distribution(kind, width, h)
        if p["normalization"] == "solid_angle":
            density /= whole(kind, width)
    cosines = light[2] + view[2] - light[2] * view[2]
    return fresnel_of(p, dot(view, h)) * density / (4 * cosines)
