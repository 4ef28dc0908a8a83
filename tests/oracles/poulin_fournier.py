"""poulin_fournier, once more."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from exact import Number, half, mp, power

CHECKED_BY = "test_poulin_fournier.py"
"""Where the albedo is held against something independent."""

CASES: list[dict[str, Any]] = [
    {"spacing": 2.0, "floor_height": 0.0},
    {"spacing": 2.2, "floor_height": 0.1, "rho": 0.7},
    {"spacing": 1.3, "floor_height": 0.8},
    {"spacing": 6.0, "floor_height": 0.3},
    {"spacing": 2.5, "floor_height": 0.2, "base": "specular", "e": 2.5, "k_s": 0.3},
    {"spacing": 4.0, "floor_height": 0.9, "base": "specular", "e": 200.0, "k_s": 8.0},
    {"spacing": 2.0, "floor_height": 0.0, "base": "specular", "e": 10.0, "k_s": 0.5},
    {"spacing": 3.0, "floor_height": 0.5, "base": "specular", "e": 2.0, "k_s": 3.0},
]
"""Sets of parameters that matter together."""


def visible(psi: Number, spacing: Number, f: Number) -> tuple[Number, ...]:
    """Ends of the arc and of the floor that are seen from the angle psi to the normal."""
    if psi < 0:
        a, b, x, y = visible(-psi, spacing, f)
        return -b, -a, spacing - y, spacing - x
    cap, w = mp.acos(f), mp.sqrt(1 - f * f)
    if mp.sin(psi) <= f:
        # The neighbour's outline is hidden in the floor: no shadow.
        return -cap, cap, w, spacing - w
    end = psi + mp.asin(min(mp.one, spacing * mp.cos(psi) - 1))
    shadow = f * mp.tan(psi) + spacing - 1 / mp.cos(psi)
    return psi - mp.pi / 2, min(end, cap), w, max(w, min(spacing - w, shadow))


def brdf(p: Mapping[str, Any], light: Any, view: Any) -> Number:
    spacing, f = mp.mpf(p["spacing"]), mp.mpf(p["floor_height"])
    h = half(light, view)
    psi_l, psi_v, psi_h = (mp.atan2(v[1], v[2]) for v in (light, view, h))
    in_l, in_v, in_h = (mp.hypot(v[1], v[2]) for v in (light, view, h))
    # Steep directions lose digits in tangents, and short arcs in differences.
    with mp.workdps(70):
        seen_l, seen_v = visible(psi_l, spacing, f), visible(psi_v, spacing, f)
        a, b = max(seen_l[0], seen_v[0]), min(seen_l[1], seen_v[1])
        floor = max(mp.zero, min(seen_l[3], seen_v[3]) - max(seen_l[2], seen_v[2]))
    if p["base"] == "lambert":
        with mp.workdps(90):
            twice = mp.sin(2 * b - psi_l - psi_v) - mp.sin(2 * a - psi_l - psi_v)
            arc = ((b - a) * mp.cos(psi_l - psi_v) + twice / 2) / 2
        arc, on_floor = mp.mpf(p["rho"]) / mp.pi * arc, mp.mpf(p["rho"]) / mp.pi
    else:
        e, k_s = mp.mpf(p["e"]), mp.mpf(p["k_s"])

        def along(x: Number) -> Number:
            phi = a + (b - a) * x
            lobe = power(in_h * mp.cos(phi - psi_h), e)
            return lobe * mp.cos(phi - psi_l) * mp.cos(phi - psi_v)

        # mpmath stops at an absolute error, and an arc may be short and dark: integrate over its
        # share of the arc, relative to its largest value, and in pieces as wide as the lobe.
        pieces = 4 + int(mp.sqrt(e) / 4)
        cuts = [mp.mpf(k) / pieces for k in range(pieces + 1)]
        top = max(along(x) for x in cuts)
        whole = mp.quad(lambda x: along(x) / top, cuts) if top > 0 else mp.zero
        arc, on_floor = k_s * whole * top * (b - a), k_s * power(h[2], e)
    return (in_l * in_v * arc + on_floor * light[2] * view[2] * floor) / (
        spacing * light[2] * view[2]
    )
