"""Fresnel factors, unpolarised, as a function of u = cos of the angle of incidence.

Microfacet models take u = v.h. In energy analyses the factor is ``white`` (1).
"""

from __future__ import annotations

import math

from albedo._compile import kernel

CODES = {"white": 0, "schlick": 1, "dielectric": 2, "conductor": 3}


@kernel
def schlick(f0, u):
    """Schlick 1994, eq. 15: F0 + (1 - F0)(1 - u)^5."""
    x = 1.0 - u
    x2 = x * x
    return f0 + (1.0 - f0) * (x2 * x2 * x)


@kernel
def dielectric(n, u):
    """Exact equations for a real relative index n (Cook and Torrance 1982, sect. 2)."""
    g2 = (n - 1.0) * (n + 1.0) + u * u
    if g2 <= 0.0:
        return 1.0
    g = math.sqrt(g2)
    ratio = (u * (g + u) - 1.0) / (u * (g - u) + 1.0)
    front = (g - u) / (g + u)
    return 0.5 * front * front * (1.0 + ratio * ratio)


@kernel
def dielectric_transmittance(n, u):
    """1 - F of the exact equations for a real relative index n >= 1, without cancellation."""
    g = math.sqrt((n - 1.0) * (n + 1.0) + u * u)
    across = u + g
    along = n * n * u + g
    return 2.0 * u * g * (1.0 / (across * across) + n * n / (along * along))


@kernel
def conductor(n, k, u):
    """Exact equations for a complex index n - ik (Schwenk, eqs. 10 to 12)."""
    s2 = (1.0 - u) * (1.0 + u)
    t0 = (n - 1.0) * (n + 1.0) - k * k + u * u
    q = math.sqrt(t0 * t0 + 4.0 * n * n * k * k)
    # (q + t0)/2 without cancellation: q^2 - t0^2 = 4 n^2 k^2.
    a = math.sqrt(0.5 * (q + t0)) if t0 > 0.0 else n * k * math.sqrt(2.0 / (q - t0))
    r_s = (q + u * u - 2.0 * a * u) / (q + u * u + 2.0 * a * u)
    r_p = r_s * (u * u * q + s2 * s2 - 2.0 * a * u * s2) / (u * u * q + s2 * s2 + 2.0 * a * u * s2)
    return 0.5 * (r_s + r_p)


@kernel
def fresnel(code, a, b, u):
    """The factor that `code` names: schlick(a = F0), dielectric(a = n), conductor(a = n, b = k)."""
    if code == 0:
        return 1.0
    if code == 1:
        return schlick(a, u)
    if code == 2:
        return dielectric(a, u)
    return conductor(a, b, u)
