"""eon, once more."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from exact import Number, mp
from oracles.fujii import lobe

CASES: list[dict[str, Any]] = [
    {"r": 1.0},
    {"rho": 0.3, "r": 1.0},
    {"rho": 0.8, "r": 0.2},
    {"r": 1.0, "albedo": "fitted"},
    {"rho": 0.5, "r": 1.0, "albedo": "fitted"},
]
"""Sets of parameters that matter together."""


def single_albedo(r: Number, mu: Number) -> Number:
    """E_F, the albedo of single scattering for rho = 1."""
    si = mp.sqrt(1 - mu * mu)
    g = si * (mp.acos(mu) - si * mu) + mp.mpf(2) / 3 * (si / mu * (1 - si**3) - si)
    return (1 + r * g / mp.pi) / (1 + (mp.mpf(1) / 2 - 2 / (3 * mp.pi)) * r)


def fitted_albedo(r: Number, mu: Number) -> Number:
    """E_F by the polynomial that the paper offers."""
    q = [mp.mpf(x) for x in ("0.0571085289", "0.491881867", "-0.332181442", "0.0714429953")]
    total = sum(c * (1 - mu) ** (k + 1) for k, c in enumerate(q))
    return (1 + r * total) / (1 + (mp.mpf(1) / 2 - 2 / (3 * mp.pi)) * r)


def multiple(rho: Number, r: Number) -> tuple[Number, Number]:
    """rho_ms and <E_F>."""
    k_1, k_2 = mp.mpf(1) / 2 - 2 / (3 * mp.pi), mp.mpf(2) / 3 - 28 / (15 * mp.pi)
    average = (1 + k_2 * r) / (1 + k_1 * r)
    return rho**2 * average / (1 - rho * (1 - average)), average


def brdf(p: Mapping[str, Any], light: Any, view: Any) -> Number:
    rho, r = mp.mpf(p["rho"]), mp.mpf(p["r"])
    a_f = 1 / (1 + (mp.mpf(1) / 2 - 2 / (3 * mp.pi)) * r)
    f_ss = rho / mp.pi * a_f * (1 + r * lobe(light, view))
    rho_ms, average = multiple(rho, r)
    if average == 1:
        return f_ss  # a smooth surface scatters once
    albedo = single_albedo if p["albedo"] == "exact" else fitted_albedo
    lost = (1 - albedo(r, min(light[2], mp.one))) * (1 - albedo(r, min(view[2], mp.one)))
    return f_ss + rho_ms / mp.pi * lost / (1 - average)
