"""Lafortune, Foo, Torrance and Greenberg 1997: cosine lobes about axes that follow the light."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from albedo.brdf import Model, Part, Real, Vectors
from albedo.catalogue._lafortune import (
    COLUMNS,
    fill,
    lobe_layout,
    lobe_numbers,
    lobe_routine,
    log_largest,
)
from albedo.catalogue.lambert import fill as fill_diffuse
from albedo.charts.cosine import CosineChart
from albedo.errors import InputError

# exp(690) = 1e299: sums of several lobes stay finite.
_HIGHEST = 690.0


@dataclass(frozen=True)
class _Lobes(Vectors):
    """Lobes that a 64-bit float can hold."""

    def check(self, model: str, value: Any) -> tuple[tuple[float, ...], ...]:
        """As `Vectors`; no lobe is all zero or overflows."""
        lobes = super().check(model, value)
        for k, (*c, n) in enumerate(lobes):
            what = f"{model}: {self.name}[{k}] = {lobes[k]}"
            if not any(c):
                raise InputError(f"{what} has no axis; one of c_x, c_y and c_z must differ from 0")
            if n * log_largest((c[0], c[1], c[2])) > _HIGHEST:
                raise InputError(f"{what} overflows; its largest |c|^n must be at most 1e299")
        return lobes


# Exponents 1, 1.6, 2.5, ... of lobes whose albedo at normal incidence is 1.
_EXPONENTS = [10.0 ** (0.2 * k) for k in range(32)]


def _normalised(n: float) -> str:
    """The reciprocal Phong lobe, in the grammar of models."""
    n = float(f"{n:.6g}")
    # Every digit: the albedo is proportional to the n-th power of c.
    c = ((n + 2.0) / (2.0 * math.pi)) ** (1.0 / n)
    return f"((-{c!r},-{c!r},{c!r},{n:g}))"


class Lafortune(Model):
    """f = rho_d/pi + sum of max(0, c_x l.x v.x + c_y l.y v.y + c_z l.z v.z)^n (Lafortune 1997).

    The axis of a lobe is o = (c_x l.x, c_y l.y, c_z l.z). c = (-C, -C, C) with
    C^n = (n + 2)/(2 pi) is the reciprocal Phong model, c_x = c_y = c_z reflects towards the
    light, c_z < |c_x| leans the lobe towards the horizon, and c_x != c_y is anisotropic. The
    default is (r.v)^n, not normalised, the survey's example.
    """

    name = "lafortune"
    title = "Lafortune's generalised cosine lobes"
    equation = "Schwenk eq. 45; Lafortune et al. 1997"
    references = ("lafortune1997", "schwenk2011")
    tables = ("lobes=[" + ",".join(_normalised(n) for n in _EXPONENTS) + "]",)
    domain = "rho_d=0..1/21"

    lobes = _Lobes(
        ((-1.0, -1.0, 1.0, 20.0),),
        "coefficients and exponent of each lobe",
        entries=(
            ("c_x", Real(-1.0, "coefficient of l.x v.x", low=-math.inf)),
            ("c_y", Real(-1.0, "coefficient of l.y v.y", low=-math.inf)),
            ("c_z", Real(1.0, "coefficient of l.z v.z", low=-math.inf)),
            ("n", Real(20.0, "exponent", low=0.0, high=1e9)),
        ),
    )
    rho_d = Real(0.0, "albedo of the diffuse part", low=0.0, high=1.0)

    @property
    def isotropic(self) -> bool:
        return all(c_x == c_y for c_x, c_y, _, _ in self.lobes)

    @property
    def conserves_energy(self) -> bool:  # type: ignore[override]
        """Surely when rho_d + sum 2 pi/(n + 2) max |c|^n <= 1: no axis can reflect more."""
        lobes = (
            2.0 * math.pi / (n + 2.0) * math.exp(n * log_largest((c_x, c_y, c_z)))
            for c_x, c_y, c_z, n in self.lobes
        )
        return bool(self.rho_d + sum(lobes) <= 1.0)

    def pack(self) -> tuple[float, ...]:
        numbers = [self.rho_d]
        for c_x, c_y, c_z, n in self.lobes:
            numbers += lobe_numbers((c_x, c_y, c_z), n)
        return tuple(numbers)

    def parts(self) -> tuple[Part, ...]:
        parts = []
        for k, (c_x, c_y, c_z, n) in enumerate(self.lobes):
            chart, widths = lobe_layout((c_x, c_y, c_z), n)
            columns = (1 + COLUMNS * k, 1 + COLUMNS * (k + 1))
            name = "specular" if len(self.lobes) == 1 else f"lobe_{k + 1}"
            routine = lobe_routine((c_x, c_y, c_z), n)
            parts.append(Part(name, fill, chart, widths, columns=columns, routine=routine))
        if self.rho_d > 0.0:
            diffuse = Part("diffuse", fill_diffuse, CosineChart(), columns=(0, 1))
            parts.append(diffuse)
        return tuple(parts)
