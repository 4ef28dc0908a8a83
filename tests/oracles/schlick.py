"""schlick, once more."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from exact import Number, dot, half, mp

CHECKED_BY = "test_schlick.py"
"""Where the albedo is held against something independent."""

CASES: list[dict[str, Any]] = [
    {"roughness": 0.01, "isotropy": 0.2},
    {"roughness": 0.3, "isotropy": 0.01, "color": 0.3},
    {"roughness": 0.04, "isotropy": 0.05, "azimuth": "normalised", "form": "plain"},
    {"roughness": 0.2, "isotropy": 0.1, "form": "residual", "residual_azimuth": "turned"},
    {"roughness": 0.17},
    {"roughness": 1.0, "form": "final", "color": 0.5},
    {"isotropy": 0.8, "form": "residual", "residual_azimuth": "turned"},
    {"isotropy": 0.8, "form": "final", "residual_azimuth": "turned"},
    {"roughness": 0.7, "isotropy": 0.5, "form": "final", "color": 0.5},
    {"roughness": 0.2, "form": "final", "color": 0.5},
    {"roughness": 0.1, "form": "final", "residual_azimuth": "none"},
    {"roughness": 0.6, "form": "final", "residual_azimuth": "none"},
    {
        "roughness": 0.02,
        "color": 0.1,
        "layers": "2",
        "roughness2": 0.6,
        "isotropy2": 0.3,
        "color2": 0.8,
        "form": "final",
    },
]
"""Sets of parameters that matter together."""


def brdf(p: Mapping[str, Any], light: Any, view: Any) -> Number:
    h = half(light, view)
    u, t2 = dot(view, h), h[2] ** 2
    across2 = h[0] ** 2 + h[1] ** 2
    w2 = h[0] ** 2 / across2 if across2 > 0 else mp.one

    def directional(r: Number, p_: Number) -> Number:
        z = r / (1 + r * t2 - t2) ** 2
        a = p_ / (p_**2 - p_**2 * w2 + w2)
        if p["azimuth"] == "published":
            a = mp.sqrt(a)
        lobe = z * a / (4 * mp.pi * light[2] * view[2])
        if p["form"] == "plain":
            return lobe
        g = mp.one
        for v in (light[2], view[2]):
            g *= v / (r - r * v + v)
        if p["form"] == "shadowed":
            return g * lobe
        turn = {"uniform": mp.one, "turned": a, "none": mp.zero}[p["residual_azimuth"]]
        whole = g * lobe + (1 - g) / mp.pi * turn
        if p["form"] == "residual":
            return whole
        b = 4 * r * (1 - r)
        return b * whole + (0 if r < mp.mpf("0.5") else 1 - b) / mp.pi

    def spectral(c: Number) -> Number:
        return c + (1 - c) * (1 - u) ** 5

    numbers = [mp.mpf(p[k]) for k in ("roughness", "isotropy", "color")]
    value = spectral(numbers[2]) * directional(*numbers[:2])
    if p["layers"] == "2":
        under = [mp.mpf(p[k]) for k in ("roughness2", "isotropy2", "color2")]
        passed = (1 - spectral(numbers[2])) * spectral(under[2])
        value += passed * directional(*under[:2])
    return value
