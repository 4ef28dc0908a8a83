"""A rough conductor for Mitsuba 3 that gives back what its microfacets lose.

`compensatedconductor` is `roughconductor` and Kulla and Conty's diffuse lobe (2017), with Hill's
factor for the colour of a metal (2018),

    F_ms (1 - E(i)) (1 - E(o)) / (pi (1 - E_avg)),  F_ms = F_avg^2 E_avg/(1 - F_avg (1 - E_avg)).

E is the albedo of the lobe without its Fresnel factor: the table that this file carries. Import the
file once a variant is set; after another one is set, call `register` again.
"""

import base64
import json
import math
from collections.abc import Iterator
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

LABEL = ""
DATA = ""

NAME = "compensatedconductor"
"""What scenes call the plugin."""

_DTYPES = {"float64": "<f8", "float32": "<f4", "float16": "<f2", "unorm16": "<u2", "unorm8": "<u1"}
# Mitsuba takes any smaller roughness for this one.
_LEAST_ALPHA = 1e-4


def _warped(kind: str, k: float, x: Any) -> Any:
    """A coordinate as an axis is even in it."""
    if kind == "sqrt":
        return np.sqrt(x)
    if kind == "angle":
        return np.arccos(x)
    if kind == "log":
        return np.log(x)
    return x * (1.0 + k) / (x + k) if kind == "rational" else x


def _warp(text: str, alpha: float) -> tuple[str, float]:
    """The kind of a warp, and its number at a roughness."""
    kind, _, rest = text.partition(":")
    number, star, _ = rest.partition("*")
    return kind, float(number or 0.0) * (alpha if star else 1.0)


class Lost:
    """1 - E at one roughness, by the cosine: a row of the table.

    Attributes
    ----------
    row : ndarray
        At the nodes.
    average : float
        2 times the integral of 1 - E over cosine d cosine, of the row as it is read.
    """

    def __init__(self, label: dict[str, Any], alpha: float) -> None:
        (channel,), (across, along) = label["channels"], label["axes"]
        low, high = max(across["low"], _LEAST_ALPHA), across["high"]
        if not low <= alpha <= high:
            raise ValueError(f"alpha = {alpha:g} is outside of the table: [{low:g}, {high:g}]")
        stored = np.frombuffer(base64.b64decode(DATA), _DTYPES[label["stored"]]).astype(np.float64)
        if label["stored"].startswith("unorm"):
            stored = channel["low"] + channel["step"] * stored
        values = stored.reshape(across["count"], along["count"])
        kind, k = _warp(across["even_in"], alpha)
        ends = sorted(float(_warped(kind, k, across[end])) for end in ("low", "high"))
        share = (float(_warped(kind, k, alpha)) - ends[0]) / (ends[1] - ends[0])
        self._centres = label["texels"] == "centres"
        i, t = self._cell(share, across["count"])
        row = values[i] + t * (values[i + 1] - values[i])
        self.row = 1.0 - row if label["quantity"] == "albedo" else row
        self._kind, self._k = _warp(along["even_in"], alpha)
        self.average = self._integral()
        # In the variant's own numbers, where it has arrays.
        self._nodes: Any = self.row.tolist()
        if dr.is_array_v(mi.Float):
            self._nodes = mi.Float(self._nodes)

    def _place(self, share: Any, count: int) -> Any:
        """Where a share of an axis lies, in steps from its first node."""
        return share * count - 0.5 if self._centres else share * (count - 1.0)

    def _cell(self, share: float, count: int) -> tuple[int, float]:
        place = min(max(self._place(share, count), 0.0), count - 1.0)
        i = min(int(place), count - 2)
        return i, place - i

    def __call__(self, cosine: Any, active: Any) -> Any:
        """1 - E; what is read below 0 is 0."""
        count, k = len(self.row), self._k
        share = {
            "linear": lambda: cosine,
            "sqrt": lambda: dr.sqrt(cosine),
            "angle": lambda: dr.acos(cosine) * (2.0 / math.pi),
            "rational": lambda: cosine * ((1.0 + k) / (cosine + k)),
        }[self._kind]()
        place = dr.clip(self._place(share, count), 0.0, count - 1.0)
        i = dr.minimum(mi.UInt32(place), count - 2)
        t = place - mi.Float(i)
        if dr.is_array_v(mi.Float):
            a = dr.gather(mi.Float, self._nodes, i, active)
            b = dr.gather(mi.Float, self._nodes, i + 1, active)
        else:
            a, b = self._nodes[i], self._nodes[i + 1]
        return dr.maximum(a + t * (b - a), 0.0)

    def _integral(self) -> float:
        """Gauss-Legendre between nodes and where the row turns from below 0."""
        row, count = self.row, len(self.row)
        place = np.arange(count, dtype=np.float64)
        a, b = row[:-1], row[1:]
        turns = a * b < 0.0
        place = np.concatenate((place, place[:-1][turns] + a[turns] / (a - b)[turns]))
        share = (place + 0.5) / count if self._centres else place / (count - 1.0)
        share = np.unique(np.concatenate((share, [0.0, 1.0])))
        x, w = np.polynomial.legendre.leggauss(32)
        # Cosine and share are entire in p, so that the rule converges on cells of any size.
        k = self._k
        ends = np.log1p(share / (1.0 - share + k)) if self._kind == "rational" else share
        half = 0.5 * np.diff(ends)[:, None]
        p = ends[:-1, None] + half * (1.0 + x)
        share, slope = p, np.ones_like(p)
        if self._kind == "linear":
            cosine = p
        elif self._kind == "sqrt":
            cosine, slope = p * p, 2.0 * p
        elif self._kind == "angle":
            cosine, slope = np.cos(0.5 * math.pi * p), 0.5 * math.pi * np.sin(0.5 * math.pi * p)
        else:
            cosine, slope, share = k * np.expm1(p), k * np.exp(p), -(1.0 + k) * np.expm1(-p)
        lost = np.interp(self._place(share, count), np.arange(count), row)
        return float(np.sum(2.0 * half * w * np.maximum(lost, 0.0) * cosine * slope))


def _mirrors() -> Iterator[tuple[float, float]]:
    """Cosines and weights of 2 times an integral over cosine d cosine."""
    x, w = np.polynomial.legendre.leggauss(16)
    x = 0.5 * (1.0 + x)
    yield from zip(x.tolist(), (w * x).tolist(), strict=True)


def _plugin() -> Any:
    """The plugin, of the classes of the variant that is set."""

    class CompensatedConductor(mi.BSDF):
        """`roughconductor` of a constant `alpha`, and what it loses."""

        def __init__(self, props: Any) -> None:
            mi.BSDF.__init__(self, props)
            label = json.loads(LABEL)
            self.distribution = label["parameters"]["distribution"]
            if mi.is_polarized:
                raise ValueError(f"{NAME} knows no polarisation; use another variant")
            given = props.get("distribution", self.distribution)
            if given != self.distribution:
                raise ValueError(f"the table is of {self.distribution}, not of {given}")
            alpha = props.get("alpha", 0.1)
            if not isinstance(alpha, float | int):
                raise ValueError("alpha is one number: the table is read where the scene is loaded")
            visible = props.get("sample_visible", True)
            colour = {name: props[name] for name in ("material", "eta", "k") if name in props}
            unknown = props.unqueried()
            if unknown:
                raise ValueError(
                    f"{NAME} has no {', '.join(unknown)}; it has alpha, material, eta, k, "
                    "distribution and sample_visible"
                )
            self.alpha = float(alpha)
            self.lost = Lost(label, self.alpha)
            self.base = mi.load_dict(
                {
                    "type": "roughconductor",
                    "distribution": self.distribution,
                    "alpha": self.alpha,
                    "sample_visible": visible,
                    **colour,
                }
            )
            self.mirror = mi.load_dict({"type": "conductor", **colour})
            # Visible normals of beckmann are drawn exactly, and their density is a fit.
            self.fitted = visible and self.distribution == "beckmann"
            self.m_components = [
                mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide,
                mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide,
            ]
            self.m_flags = self.m_components[0] | self.m_components[1]
            self._factor = None if mi.is_spectral else self._of(dr.zeros(mi.SurfaceInteraction3f))

        def _of(self, si: Any, active: Any = True) -> Any:
            """F_ms / (pi (1 - E_avg))."""
            own = mi.SurfaceInteraction3f(si)
            mean = mi.Spectrum(0.0)
            for cosine, weight in _mirrors():
                own.wi = mi.Vector3f(math.sqrt(1.0 - cosine * cosine), 0.0, cosine)
                _, f = self.mirror.sample(mi.BSDFContext(), own, 0.0, mi.Point2f(0.0), active)
                mean += weight * f
            lost = self.lost.average
            more = mean * mean * (1.0 - lost) / (1.0 - mean * lost)
            return more * (1.0 / (math.pi * lost) if lost > 0.0 else 0.0)

        def _heights(self, si: Any, wo: Any, active: Any) -> tuple[Any, Any, Any]:
            """Both cosines, and whether both are above the horizon."""
            cos_i, cos_o = mi.Frame3f.cos_theta(si.wi), mi.Frame3f.cos_theta(wo)
            active = active & (cos_i > 0.0) & (cos_o > 0.0)
            return dr.clip(cos_i, 0.0, 1.0), dr.clip(cos_o, 0.0, 1.0), active

        def _share(self, ctx: Any, cos_i: Any, active: Any) -> Any:
            """How often the diffuse lobe is drawn: as much as it reflects of all."""
            if not ctx.is_enabled(mi.BSDFFlags.DiffuseReflection, 1):
                return mi.Float(0.0)
            if not ctx.is_enabled(mi.BSDFFlags.GlossyReflection, 0):
                return mi.Float(1.0)
            return self.lost(cos_i, active)

        def _density(self, ctx: Any, si: Any, wo: Any, active: Any) -> Any:
            """What the normals of the base are drawn with."""
            found = self.base.pdf(ctx, si, wo, active)
            if not self.fitted:
                return found
            cosine = mi.Frame3f.cos_theta(si.wi)
            sine = dr.sqrt(dr.maximum(1.0 - cosine * cosine, 0.0))
            # Where this is 1.6 the fit ends, and from 6 on both are 1 in float32.
            a = dr.minimum(cosine / dr.maximum(self.alpha * sine, 1e-9), 6.0)
            a = dr.maximum(a, 1e-9)
            square = a * a
            fit = (3.535 * a + 2.181 * square) / (1.0 + 2.276 * a + 2.577 * square)
            fit = dr.select(a >= 1.6, 1.0, fit)
            exact = 2.0 / (1.0 + dr.erf(a) + dr.exp(-square) / (a * math.sqrt(math.pi)))
            return found * (exact / fit)

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            """f N.wo."""
            cos_i, cos_o, active = self._heights(si, wo, active)
            value = mi.Spectrum(0.0)
            if ctx.is_enabled(mi.BSDFFlags.GlossyReflection, 0):
                value += self.base.eval(ctx, si, wo, active)
            if ctx.is_enabled(mi.BSDFFlags.DiffuseReflection, 1):
                factor = self._of(si, active) if self._factor is None else self._factor
                lost = self.lost(cos_i, active) * self.lost(cos_o, active)
                value += factor * (lost * cos_o)
            return dr.select(active, value, 0.0)

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            """Of directions as they are drawn, in 1/sr."""
            cos_i, cos_o, active = self._heights(si, wo, active)
            share = self._share(ctx, cos_i, active)
            found = share * cos_o * (1.0 / math.pi)
            if ctx.is_enabled(mi.BSDFFlags.GlossyReflection, 0):
                found += (1.0 - share) * self._density(ctx, si, wo, active)
            return dr.select(active, found, 0.0)

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            """A direction of one of the two lobes, and f N.wo over the density of both."""
            cos_i = mi.Frame3f.cos_theta(si.wi)
            active = active & (cos_i > 0.0)
            share = self._share(ctx, dr.clip(cos_i, 0.0, 1.0), active)
            glossy = sample1 >= share
            wo = mi.warp.square_to_cosine_hemisphere(sample2)
            if ctx.is_enabled(mi.BSDFFlags.GlossyReflection, 0):
                # `roughconductor` has no use for its first number.
                drawn, _ = self.base.sample(ctx, si, sample1, sample2, active & glossy)
                wo = dr.select(glossy, drawn.wo, wo)
            found: Any = dr.zeros(mi.BSDFSample3f)
            found.wo = wo
            found.eta = 1.0
            found.pdf = self.pdf(ctx, si, wo, active)
            found.sampled_component = dr.select(glossy, mi.UInt32(0), mi.UInt32(1))
            found.sampled_type = dr.select(
                glossy,
                mi.UInt32(+mi.BSDFFlags.GlossyReflection),
                mi.UInt32(+mi.BSDFFlags.DiffuseReflection),
            )
            active = active & (found.pdf > 0.0)
            weight = self.eval(ctx, si, wo, active) / dr.select(active, found.pdf, 1.0)
            return found, dr.select(active, weight, 0.0)

        def to_string(self) -> str:
            """What `print` shows."""
            return f"CompensatedConductor[{self.distribution}, alpha = {self.alpha:g}]"

    return CompensatedConductor


def register(name: str = NAME) -> None:
    """Make the plugin known to the variant that is set."""
    mi.register_bsdf(name, _plugin())


if mi.variant() is not None:
    register()
