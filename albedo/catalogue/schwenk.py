"""Schwenk 2011: a model for real-time rendering that scales down step by step to Lambert."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from albedo._compile import kernel
from albedo.brdf import Choice, Color, Model, Part, Real
from albedo.catalogue._blinn import slope_chart, slope_width
from albedo.charts.cosine import CosineChart
from albedo.errors import InputError
from albedo.fresnel import CAREFUL, schlick, schlick_rest
from albedo.geometry import divided, normal_root, one_less_v_dot_h, v_dot_h
from albedo.sampling.routines import normal_powers

LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Weights of red, green and blue; the paper gives none."""


def exponent(s: float) -> float:
    """e = 2/(1 + 1/255 - s): from about 2 to 510."""
    return 2.0 / (1.0 + 1.0 / 255.0 - s)


@kernel
def fill_specular(wi, wo, h, p, out):
    """f = k_s s^2/(v.h) F(v.h, F0) (n.h)^e; simpler levels drop F, then 1/(v.h)."""
    for j in range(out.shape[0]):
        lx, ly, lz = wi[0, j], wi[1, j], wi[2, j]
        e, scale, f0, level = p[j, 0], p[j, 1], p[j, 2], p[j, 3]
        for i in range(out.shape[1]):
            hx, hy, hz = h[0, j, i], h[1, j, i], h[2, j, i]
            u = v_dot_h(hx, hy, hz)
            vx, vy, vz = wo[0, j, i], wo[1, j, i], wo[2, j, i]
            less = one_less_v_dot_h(lx, ly, lz, vx, vy, vz, u) if f0 < CAREFUL else -1.0
            c_s = schlick(f0, u, less) if level < 1.0 else f0
            root = normal_root(hx, hy, hz, e)
            out[j, i] = divided(scale * c_s, root, u if level < 2.0 else 1.0, 1.0)


@kernel
def fill_diffuse(wi, wo, h, p, out):
    """f = k_d (1 - s k) C_d; C_d = (1 - r) C + r C_r reflects an environment."""
    for j in range(out.shape[0]):
        scale, c, metal, plastic, c_e = p[j, 4], p[j, 5], p[j, 6], p[j, 7], p[j, 8]
        for i in range(out.shape[1]):
            # 1 - F = (1 - F0)(1 - (1 - u)^5).
            vz = wo[2, j, i]
            f, rest = schlick(0.04, vz, 1.0 - vz), 0.96 * schlick_rest(vz)
            # What is metal reflects C C_e, plastic (1 - F) C + F C_e.
            out[j, i] = scale * (metal + plastic * (rest * c + f * c_e))


class Schwenk(Model):
    """J = k_s s^2/(v.h) F(v.h, F0) (n.h)^e + k_d C_d (1 - s k), read as J/pi (Schwenk, sect. 4).

    F0 = 1 - m + m C', C' = C/lum(C), e = 2/(1 + 1/255 - s). ``reading="literal"`` is f = J. The
    paper gives no weights for the luminance of three channels: they are 0.2126, 0.7152 and 0.0722
    here; the luminance of a number is that number, and C' = 1 where it is 0. F0 may exceed 1 for
    saturated colours; ``clamp="yes"``, which is not in the paper, cuts it there.

    ``level`` counts steps of simplification, each on top of the one before: 1 drops F, 2 drops
    1/(v.h), 3 sets C' = C, which leaves a modified Blinn-Phong lobe, 4 drops the lobe.

    With ``reflectivity`` r > 0, C_d = (1 - r) C + r C_r reflects an environment of one colour C_e:
    C_r = (1 - m)((1 - F) C + F C_e) + m C C_e, where F is a function of n.v alone, which is not
    reciprocal. The paper names no F0 for it: here it is 0.04.
    """

    name = "schwenk"
    title = "Schwenk for real-time rendering"
    equation = "Schwenk eqs. 50 to 53"
    references = ("schwenk2011",)
    tables = ("smoothness=0..1/32",)
    domain = "smoothness=0..1/31"

    color = Color(1.0, "colour C", low=0.0, high=1.0)
    metalness = Real(0.0, "metalness m", low=0.0, high=1.0)
    smoothness = Real(0.5, "smoothness s", low=0.0, high=1.0)
    k_d = Real(1.0, "weight of the diffuse term", low=0.0, high=1.0)
    k_s = Real(1.0, "weight of the specular term", low=0.0, high=1.0)
    k = Real(0.0, "how much of the diffuse term smoothness takes", low=0.0, high=1.0)
    level = Choice("0", "steps of simplification", choices=("0", "1", "2", "3", "4"))
    clamp = Choice("no", "F0 cut at 1", choices=("no", "yes"))
    reflectivity = Real(0.0, "share r of the reflected environment", low=0.0, high=1.0)
    color_environment = Color(1.0, "colour C_e of the environment", low=0.0, high=1.0)
    reading = Choice("brdf", "f = J/pi, or f = J", choices=("brdf", "literal"))

    def __init__(self, /, **values: Any) -> None:
        super().__init__(**values)
        color = self.parameters["color"]
        if isinstance(color, tuple) and len(color) not in (1, 3):
            raise InputError(
                f"schwenk: color has {len(color)} channels, but luminance is defined for 1 or 3"
            )

    def used(self, values: Mapping[str, Any]) -> tuple[str, ...]:
        dropped = {"3": ("clamp",), "4": ("clamp", "k_s")}.get(values["level"], ())
        return tuple(key for key in values if key not in dropped)

    @property
    def reciprocal(self) -> bool:  # type: ignore[override]
        """Plastic mixes the environment in by the view alone."""
        mixes = self.reflectivity > 0.0 and self.metalness < 1.0 and self._diffuse > 0.0
        return not mixes or bool(np.all(np.equal(self.color, self.color_environment)))

    @property
    def conserves_energy(self) -> bool:  # type: ignore[override]
        """A lobe is added to a diffuse term that may reflect all; J alone is pi times that."""
        lobe = self.level != "4" and self.smoothness > 0.0 and self.k_s > 0.0
        return self.reading == "brdf" and not lobe

    @property
    def _diffuse(self) -> float:
        return float(self.k_d * (1.0 - self.smoothness * self.k))

    @property
    def _hue(self) -> float:
        """C' in the chosen channel."""
        whole = self.parameters["color"]
        luminance = float(self.color)
        if isinstance(whole, tuple) and len(whole) == 3:
            luminance = sum(w * c for w, c in zip(LUMINANCE, whole, strict=True))
        return float(self.color) / luminance if luminance > 0.0 else 1.0

    def pack(self) -> tuple[float, ...]:
        m, s, r, c, c_e = (
            *(self.metalness, self.smoothness, self.reflectivity),
            *(self.color, self.color_environment),
        )
        f0 = (1.0 - m) + m * (c if self.level in ("3", "4") else self._hue)
        if self.parameters.get("clamp") == "yes":
            f0 = min(1.0, f0)
        scale = 1.0 / math.pi if self.reading == "brdf" else 1.0
        return (
            *(exponent(s), scale * self.parameters.get("k_s", 0.0) * s * s, f0, float(self.level)),
            *(scale * self._diffuse, c, (1.0 - r) * c + r * m * c * c_e, r * (1.0 - m), c_e),
        )

    def simpler(self) -> dict[str, Model]:
        """The levels of simplification that are left (Schwenk, sect. 4.2.4)."""
        found = super().simpler()
        names = ("the Fresnel factor", "1/(v.h)", "the luminance", "the lobe")
        # What a level does not use must not be given to it.
        for step in range(int(self.level), len(names)):
            dropped = {3: ("clamp",), 4: ("clamp", "k_s")}.get(step + 1, ())
            kept = {k: v for k, v in self.parameters.items() if k not in (*dropped, "level")}
            *others, last = names[int(self.level) : step + 1]
            label = ", ".join(others) + " and " * bool(others) + last
            found[label] = type(self)(**kept, level=str(step + 1))
        return found

    def parts(self) -> tuple[Part, ...]:
        parts = [Part("diffuse", fill_diffuse, CosineChart())]
        if self.level != "4":
            e = exponent(self.smoothness)
            widths, routine = (slope_width(e),) * 2, normal_powers(e, e)
            parts.append(Part("specular", fill_specular, slope_chart(e), widths, routine=routine))
        return tuple(parts)
