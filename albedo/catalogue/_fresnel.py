"""The Fresnel factor of a model: its choice, the parameters of each choice, and what it packs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from albedo.brdf import Choice, Model, Real
from albedo.errors import InputError
from albedo.fresnel import CODES, coefficients, fill_factors
from albedo.metals import METALS, SOURCES, refractive_index

# Schlick's form, Lazanyi's error term, and the indices of the metals.
# How far, in squares of cosines, factors are smooth around those that there are.
_FAR = 0.1
SOURCES_OF_FACTORS = ("schlick1994", "lazanyi2005", "glassner1995", "johnson1972", "rakic1995")


class FresnelChoice(Model):
    """A model with a Fresnel factor F; a base class, with no name of its own.

    ``schlick`` takes F0 as it is given, or that of the index. ``lazanyi`` is Schlick's form with
    its error term, fitted to the index unless a and alpha are given. A metal is the exact
    ``conductor`` with its index at a wavelength. A model that has a wavelength of its own declares
    that parameter again, and lists it in `used`.

    `pack` puts the four numbers of `pack_fresnel` where its kernel hands them to
    `albedo.fresnel.fresnel`.
    """

    fresnel = Choice("white", "Fresnel factor F", choices=(*CODES, *METALS))
    f0 = Real(None, "schlick: reflectance at normal incidence, if not from ior and k", high=1.0)
    ior = Real(1.5, "relative index of refraction n of n - ik", low=1e-3, high=100.0)
    k = Real(0.0, "extinction coefficient k of n - ik", low=0.0, high=100.0)
    a = Real(None, "lazanyi: factor of the error term, if not fitted", low=-100.0, high=100.0)
    alpha = Real(None, "lazanyi: exponent of the error term", low=1.0, high=100.0)
    wavelength = Real(0.55, "wavelength of the light, for metals", "um", low=1e-2, high=1e3)
    source = Choice("glassner", "metals: data for the index", choices=SOURCES)

    def __init__(self, /, **values: Any) -> None:
        super().__init__(**values)
        try:
            self.pack_fresnel()
        except InputError as error:
            raise InputError(f"{self.name}: {error}") from None

    def used(self, values: Mapping[str, Any]) -> tuple[str, ...]:
        """Everything but the parameters of other Fresnel factors."""
        kind = values["fresnel"]
        index = {"dielectric": ("ior",), "conductor": ("ior", "k")}.get(kind, ())
        if kind == "schlick":
            index = ("f0",) if values["f0"] is not None else ("f0", "ior", "k")
        elif kind == "lazanyi":
            index = ("ior", "k", "a", "alpha")
        elif kind in METALS:
            index = ("wavelength", "source")
        others = FresnelChoice._declared.keys() - {"fresnel", *index}
        return tuple(name for name in values if name not in others)

    def simpler(self) -> dict[str, Model]:
        """Also Schlick's form for the exact factor, and the value at normal incidence for any."""
        found = super().simpler()
        if self.fresnel == "white":
            return found
        f0 = min(float(self.fresnel_factor(np.ones(1))[0]), 1.0)
        # A wavelength of the model's own stays.
        base = FresnelChoice._declared
        kept = {k: v for k, v in self.parameters.items() if self._declared[k] is not base.get(k)}
        if self.fresnel != "schlick":
            found["the exact Fresnel factor"] = type(self)(**kept, fresnel="schlick", f0=f0)
        found["the Fresnel factor"] = f0 * type(self)(**kept, fresnel="white")
        return found

    def fresnel_factor(self, u: np.ndarray) -> np.ndarray:
        """F at cosines u of any shape."""
        out = np.empty(u.size)
        code, *numbers = self.pack_fresnel()
        columns = (np.full(u.size, number) for number in numbers)
        fill_factors(code, *columns, np.ascontiguousarray(u).ravel(), np.full(u.size, -1.0), out)
        return out.reshape(u.shape)

    @property
    def fresnel_around(self) -> str:
        """What F is around a ring: see `albedo.charts.rings.RingsChart`.

        Where n^2 - 1 + u^2 has a root, of the complex index n, total reflection sets in; a power
        of 1 - u need not be whole (``lazanyi``). All others but 1 have odd powers of u, a root.
        """
        code, n, k, _ = self.pack_fresnel()
        if code in (CODES["white"], CODES["schlick"]):
            return "entire" if code == CODES["white"] else "smooth"
        root = 1.0 - complex(n, -k if code == CODES["conductor"] else 0.0) ** 2
        near = complex(min(max(root.real, 0.0), 1.0), 0.0)
        return "smooth" if code != CODES["lazanyi"] and abs(root - near) >= _FAR else "none"

    def pack_fresnel(self) -> tuple[int, float, float, float]:
        """The code of the factor and its three numbers."""
        p = self.parameters
        if self.fresnel in METALS:
            n, k = refractive_index(self.fresnel, p["wavelength"], p["source"])
            return coefficients("conductor", n=float(n), k=float(k))
        return coefficients(
            self.fresnel,
            f0=p.get("f0"),
            n=p.get("ior", 1.5),
            k=p.get("k", 0.0),
            a=p.get("a"),
            alpha=p.get("alpha"),
        )
