"""Schlick 1993, 1994: rational factors for roughness, isotropy and colour, in one or two layers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from albedo._compile import kernel
from albedo.brdf import Choice, Color, Model, Part, Real
from albedo.charts.cosine import CosineChart
from albedo.charts.polar import PolarChart
from albedo.charts.tail_rings import TailRingsChart
from albedo.fresnel import CAREFUL, schlick, schlick_rest
from albedo.geometry import along_azimuth, capped_slopes, one_less_v_dot_h, v_dot_h


@kernel
def spectral(first, second, below, u, less):
    """S(u) of the first layer, or (1 - S(u)) S'(u) of what the one below gets (Schwenk eq. 48)."""
    if not below:
        return schlick(first, u, less)
    return (1.0 - first) * schlick_rest(u) * schlick(second, u, less)


@kernel
def zenith(r, tan2):
    """Z(t) = r/(1 + r t^2 - t^2)^2 with t = n.h, in slopes."""
    q = (1.0 + tan2) / (r + tan2)
    return r * q * q


@kernel
def azimuth(p, published, hx, hy):
    """A(w) = sqrt(p/(p^2 - p^2 w^2 + w^2)), w the cosine of h's azimuth; or without the root."""
    a = p / along_azimuth(1.0, p * p, hx, hy)
    return math.sqrt(a) if published else a


@kernel
def unmasked(r, v):
    """G(v)/v = 1/(r - r v + v)."""
    return 1.0 / (r * (1.0 - v) + v)


@kernel
def lobe(wi, wo, h, p, out, first):
    """f = S b G Z A/(4 pi v v') of the layer whose numbers start at `first`; G = 1 if plain."""
    for j in range(out.shape[0]):
        lx, ly, lz = wi[0, j], wi[1, j], wi[2, j]
        plain, published = p[j, 12] > 0.0, p[j, 13] > 0.0
        # Numbers, no slice of p: loops with one are not vectorised.
        below, color, color_2 = first > 0, p[j, 2], p[j, 8]
        careful = (color_2 if below else color) < CAREFUL
        r, isotropy, b = p[j, first], p[j, first + 1], p[j, first + 4]
        g_l = 1.0 if plain else unmasked(r, lz)
        for i in range(out.shape[1]):
            vz = wo[2, j, i]
            if min(lz, vz) <= 0.0:
                out[j, i] = 0.0
                continue
            hx, hy, hz = h[0, j, i], h[1, j, i], h[2, j, i]
            x, y = capped_slopes(hx, hy, hz)
            g = g_l if plain else g_l * unmasked(r, vz)
            za = zenith(r, x * x + y * y) * azimuth(isotropy, published, hx, hy)
            u = v_dot_h(hx, hy, hz)
            less = (
                one_less_v_dot_h(lx, ly, lz, wo[0, j, i], wo[1, j, i], vz, u) if careful else -1.0
            )
            s = spectral(color, color_2, below, u, less)
            value = s * b / (4.0 * math.pi) * g * za
            out[j, i] = value / lz / vz if plain else value


@kernel
def broad(wi, wo, h, p, out, first):
    """f = S (a + c (1 - G) A~)/pi of the layer whose numbers start at `first`."""
    for j in range(out.shape[0]):
        lx, ly, lz = wi[0, j], wi[1, j], wi[2, j]
        published, turned = p[j, 13] > 0.0, p[j, 14] > 0.0
        # Numbers, no slice of p: loops with one are not vectorised.
        below, color, color_2 = first > 0, p[j, 2], p[j, 8]
        careful = (color_2 if below else color) < CAREFUL
        r, isotropy, a, c = p[j, first], p[j, first + 1], p[j, first + 3], p[j, first + 5]
        g_l = lz * unmasked(r, lz)
        for i in range(out.shape[1]):
            hx, hy, hz, vz = h[0, j, i], h[1, j, i], h[2, j, i], wo[2, j, i]
            # 1 - G(v) G(v') = 1 - G(v') + G(v')(1 - G(v)), 1 - G(v) = r (1 - v)/(r - r v + v).
            lost = r * (1.0 - lz) * unmasked(r, lz) + g_l * r * (1.0 - vz) * unmasked(r, vz)
            if turned:
                lost *= azimuth(isotropy, published, hx, hy)
            u = v_dot_h(hx, hy, hz)
            less = (
                one_less_v_dot_h(lx, ly, lz, wo[0, j, i], wo[1, j, i], vz, u) if careful else -1.0
            )
            s = spectral(color, color_2, below, u, less)
            out[j, i] = s * (a + c * lost) / math.pi


@kernel
def fill_specular(wi, wo, h, p, out):
    """f = S b G Z A/(4 pi v v')."""
    lobe(wi, wo, h, p, out, 0)


@kernel
def fill_diffuse(wi, wo, h, p, out):
    """f = S (a + c (1 - G) A~)/pi."""
    broad(wi, wo, h, p, out, 0)


@kernel
def fill_specular_2(wi, wo, h, p, out):
    """f = (1 - S) S' b' G' Z' A'/(4 pi v v')."""
    lobe(wi, wo, h, p, out, 6)


@kernel
def fill_diffuse_2(wi, wo, h, p, out):
    """f = (1 - S) S' (a' + c' (1 - G') A~')/pi."""
    broad(wi, wo, h, p, out, 6)


def weights(r: float, form: str) -> tuple[float, float, float, float]:
    """Weights of Lambert's term, of the lobe, of its residual and of the mirror part."""
    if form != "final":
        return 0.0, 1.0, 1.0 if form == "residual" else 0.0, 0.0
    b = 4.0 * r * (1.0 - r)
    rest = (1.0 - 2.0 * r) ** 2  # 1 - b without cancellation
    return (0.0, b, b, rest) if r < 0.5 else (rest, b, b, 0.0)


class Schlick(Model):
    """f = S D, or S D + (1 - S) S' D' in two layers (Schlick 1993, 1994; Schwenk eqs. 47 to 49).

    S(u) = C + (1 - C)(1 - u)^5, u = v.h. The forms of D are

    - ``plain``: Z A/(4 pi v v'), no self-shadowing;
    - ``shadowed``: G Z A/(4 pi v v'), G = G(v) G(v'), G(v) = v/(r - r v + v);
    - ``residual``: that and (1 - G) A~/pi for what is shadowed (Schwenk eq. 49);
    - ``final``: a/pi + b (the residual form) + g (ideal mirror), b = 4 r (1 - r); the rest 1 - b
      goes to g for r < 1/2 and to a otherwise. The primary text was out of reach: this is a
      reconstruction, and whether its b has the residual is open.

    Z/pi is GGX with alpha = sqrt(r). A as published integrates to less than 1 over the azimuth;
    ``azimuth="normalised"`` leaves its root away, and integrates to 1. Schwenk's eq. 49 may have a
    factor A~ = A on the residual: ``residual_azimuth="turned"``. With ``"none"``, A~ = 0, what is
    shadowed is lost in every form.
    """

    name = "schlick"
    title = "Schlick's rational model"
    equation = "Schwenk eqs. 47 to 49"
    references = ("schlick1993", "schlick1994", "schwenk2011")
    tables = ("roughness=0.01..1/32", "roughness=0.01..1/16,isotropy=0.3")
    domain = "roughness=1e-6..1/37log"

    roughness = Real(0.1, "roughness r", low=1e-16, high=1.0)
    isotropy = Real(1.0, "isotropy p", low=1e-3, high=1.0)
    color = Color(1.0, "colour C at normal incidence", low=0.0, high=1.0)
    layers = Choice("1", "number of layers", choices=("1", "2"))
    roughness2 = Real(0.5, "second layer: roughness", low=1e-16, high=1.0)
    isotropy2 = Real(1.0, "second layer: isotropy", low=1e-3, high=1.0)
    color2 = Color(1.0, "second layer: colour", low=0.0, high=1.0)
    form = Choice(
        "shadowed", "directional factor", choices=("plain", "shadowed", "residual", "final")
    )
    azimuth = Choice(
        "published", "A with its root, or without", choices=("published", "normalised")
    )
    residual_azimuth = Choice(
        "uniform", "factor A~ of the residual: 1, A, or 0", choices=("uniform", "turned", "none")
    )

    def used(self, values: Mapping[str, Any]) -> tuple[str, ...]:
        second = ("roughness2", "isotropy2", "color2") if values["layers"] == "2" else ()
        residual = ("residual_azimuth",) if values["form"] in ("residual", "final") else ()
        return (
            *("roughness", "isotropy", "color", "layers"),
            *second,
            *("form", "azimuth"),
            *residual,
        )

    @property
    def _layers(self) -> list[tuple[float, float, Any]]:
        """Roughness, isotropy and colour of every layer that light reaches."""
        layers = [(self.roughness, self.isotropy, self.color)]
        if self.layers == "2" and self.color != 1.0:
            layers.append((self.roughness2, self.isotropy2, self.color2))
        return layers

    @property
    def _residual(self) -> str | None:
        """The factor of the residual, None in forms without one."""
        return self.parameters.get("residual_azimuth")

    def _weights(self, r: float) -> tuple[float, float, float, float]:
        """As `weights`, with the residual only where it is kept."""
        a, b, residual, g = weights(r, self.form)
        return a, b, 0.0 if self._residual == "none" else residual, g

    @property
    def isotropic(self) -> bool:
        return all(isotropy == 1.0 for _, isotropy, _ in self._layers)

    @property
    def conserves_energy(self) -> bool:  # type: ignore[override]
        """G = v/(r - r v + v) masks enough for an isotropic layer from r = 0.1695 on (measured)."""
        lost = self.form == "shadowed" or self._residual == "none"
        masked = lost and self.roughness >= 0.17
        lambert = self.form == "final" and self.roughness == 1.0
        return self.layers == "1" and self.isotropic and (masked or lambert)

    @property
    def grazing_limit(self) -> bool:  # type: ignore[override]
        """Without shadowing the albedo grows as 1/n.l."""
        return self.form != "plain"

    def pack(self) -> tuple[float, ...]:
        numbers: list[float] = []
        for r, isotropy, color in self._layers:
            a, b, residual, _ = self._weights(r)
            numbers += [r, isotropy, color, a, b, residual]
        turned = self._residual == "turned"
        choices = (self.form == "plain", self.azimuth == "published", turned)
        return (*numbers, *(0.0,) * (12 - len(numbers)), *map(float, choices))

    def parts(self) -> tuple[Part, ...]:
        parts: list[Part] = []
        fills = ((fill_specular, fill_diffuse), (fill_specular_2, fill_diffuse_2))
        for k, (r, isotropy, _) in enumerate(self._layers):
            a, b, residual, _ = self._weights(r)
            suffix = "" if k == 0 else "_2"
            # In the elliptic azimuth of this stretch A without its root is constant.
            stretch = isotropy if self.azimuth == "normalised" else math.sqrt(isotropy)
            if b > 0.0:
                plain = self.form == "plain"
                chart: Any = PolarChart("slope")
                if self.isotropic:
                    chart = TailRingsChart(layer=1 if plain else 2, steep=self.color != 1.0)
                elif not plain:
                    chart = PolarChart("slope", edge=2, origin=2, layer=2)
                widths = (math.sqrt(r) * stretch, math.sqrt(r))
                parts.append(Part("specular" + suffix, fills[k][0], chart, widths))
            if a > 0.0 or residual > 0.0:
                # 1 - G changes where n.v is r.
                broad_chart: Any = CosineChart(angle=True, layered=True)
                widths = (r, 1.0)
                if self._residual == "turned" and isotropy < 1.0:
                    broad_chart, widths = PolarChart("slope", edge=2), (stretch, 1.0)
                parts.append(Part("diffuse" + suffix, fills[k][1], broad_chart, widths))
        return tuple(parts)

    def spikes(self, wi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        layers = self._layers
        shares = [weights(r, self.form)[3] for r, _, _ in layers]
        if not any(shares):
            return super().spikes(wi)
        p = np.array(self.pack())
        total = np.zeros(len(wi))
        for k, g in enumerate(shares):
            total += g * np.array([spectral(p[2], p[8], k > 0, c, 1.0 - c) for c in wi[:, 2]])
        return (wi * np.array([-1.0, -1.0, 1.0]))[None], np.where(wi[:, 2] > 0.0, total, 0.0)[None]
