"""he_torrance, once more."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from exact import Number, beckmann_lambda, dot, fresnel_of, half, mp, poisson_sum

CASES: list[dict[str, Any]] = [
    {"sigma0": 5.0, "tau": 50.0},
    {"sigma0": 0.01, "tau": 3.0},
    {"sigma0": 0.18, "tau": 3.0, "fresnel": "dielectric", "a_ud": 0.2},
    {"fresnel": "copper", "source": "measured", "wavelength": 0.6, "a_ud": 1.0},
]
"""Sets of parameters that matter together."""


def brdf(p: Mapping[str, Any], light: Any, view: Any) -> Number:
    total = mp.mpf(p["a_ud"]) / mp.pi
    if p["directional_diffuse"] == "off":
        return total
    sigma0, tau, wavelength = (mp.mpf(p[k]) for k in ("sigma0", "tau", "wavelength"))
    k = 2 * mp.pi / wavelength

    def seen(v: Sequence[Number]) -> tuple[Number, Number]:
        """S1 and K of a direction."""
        tangent = mp.sqrt(v[0] ** 2 + v[1] ** 2) / v[2]
        if tangent == 0:
            return mp.one, mp.zero
        a = tau / (2 * sigma0 * tangent)
        return (1 - mp.erfc(a) / 2) / (1 + beckmann_lambda(a)), tangent * mp.erfc(a)

    s_l, k_l = seen(light)
    s_v, k_v = seen(view)
    # sqrt(pi/2) z0 = (sigma0/4)(K_L + K_V) exp(-z0^2/(2 sigma0^2)), solved for z0/sigma0.
    slope = (k_l + k_v) / (4 * mp.sqrt(mp.pi / 2))
    z0 = mp.sqrt(mp.lambertw(slope * slope).real)
    sigma = sigma0 / mp.sqrt(1 + z0 * z0)
    g = (k * sigma * (light[2] + view[2])) ** 2
    lateral = k * k * ((light[0] + view[0]) ** 2 + (light[1] + view[1]) ** 2)
    d = (mp.pi * tau / (2 * wavelength)) ** 2 * poisson_sum(g, lateral * tau * tau / 4)
    h = half(light, view)
    u = dot(view, h)
    geometry = (2 * u / h[2]) ** 2
    return total + fresnel_of(p, u) * geometry * s_l * s_v * d / (mp.pi * light[2] * view[2])
