"""stam_grating, once more: its orders, one by one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from exact import Number, dot, fresnel_of, mp

CHECKED_BY = "test_stam.py"
"""Where the albedo is held against something independent."""

CASES: list[dict[str, Any]] = [
    {"depth": 0.6, "fresnel": "dielectric"},
    {"profile": "lamellar", "duty": 0.3, "period": 5.0},
    {"coherence": 3.0},
    {"coherence": 0.3, "profile": "lamellar", "duty": 0.3, "fresnel": "dielectric"},
    {"coherence": 200.0, "depth": 0.6, "period": 4.1},
]
"""Sets of parameters that matter together."""


def brdf(p: Mapping[str, Any], light: Any, view: Any) -> Number:
    """Lobes about the orders; Dirac parts have no value."""
    if "coherence" not in p:
        return mp.zero
    wavelength = mp.mpf(p["wavelength"])
    sigma = wavelength / (2 * mp.pi * mp.mpf(p["coherence"]))
    step = wavelength / mp.mpf(p["period"])
    u, v, w = (a + b for a, b in zip(light, view, strict=True))
    phase = 2 * mp.pi / wavelength * mp.mpf(p["depth"]) * w
    total, reach = mp.zero, int(14 * sigma / step) + 1
    for n in range(int(u / step) - reach, int(u / step) + reach + 1):
        height = mp.exp(-((u - n * step) ** 2 + v * v) / (2 * sigma**2))
        total += abs(coefficient(p, n, phase)) ** 2 * height
    l_dot_v = dot(light, view)
    factor = fresnel_of(p, mp.sqrt((1 + l_dot_v) / 2))
    scale = 2 * mp.pi * sigma**2 * w * w * light[2] * view[2]
    return factor * (1 + l_dot_v) ** 2 * total / scale


def coefficient(p: Mapping[str, Any], n: int, phase: Number) -> Number:
    """Fourier coefficient of exp(i phase height/depth): by closed forms, or as an integral."""
    if p["profile"] == "sinusoid":
        return mp.besselj(n, phase / 2)
    q = mp.mpf(p["duty"])
    if n == 0:
        return 1 - q + q * mp.expj(phase)
    return (mp.expj(phase) - 1) * (1 - mp.expj(-2 * mp.pi * n * q)) / (2j * mp.pi * n)


def orders(p: Mapping[str, Any], light: Any) -> dict[int, Number]:
    """Shares of the energy in every order that leaves, by unit vectors and their products."""
    found = {}
    k = 2 * mp.pi / mp.mpf(p["wavelength"])
    step = mp.mpf(p["wavelength"]) / mp.mpf(p["period"])
    reach = int(2 / step) + 1
    for n in range(-reach, reach + 1):
        x, y = -light[0] + n * step, -light[1]
        rest = 1 - x * x - y * y
        if rest <= 0:
            continue
        z = mp.sqrt(rest)
        w = light[2] + z
        l_dot_v = light[0] * x + light[1] * y + light[2] * z
        strength = abs(coefficient(p, n, k * mp.mpf(p["depth"]) * w)) ** 2
        u = mp.sqrt((1 + l_dot_v) / 2)
        found[n] = fresnel_of(p, u) * strength * (1 + l_dot_v) ** 2 / (w * w * light[2] * z)
    return found
