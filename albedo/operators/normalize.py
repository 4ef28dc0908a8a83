"""Models divided by their own albedo: at normal incidence, the largest, or at every incidence."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from types import MappingProxyType
from typing import Any

import numpy as np

from albedo.brdf import Kernel, Model, Parameter, Part
from albedo.errors import InputError
from albedo.operators.asked import check_rtol
from albedo.operators.curve import AlbedoCurve, albedo_curve, albedo_curves
from albedo.operators.heights import HeightTable
from albedo.operators.surface import TURNED, SurfaceTable, surface_table, table_of
from albedo.quadrature import albedo_rows

# The largest value is first sought with this error, then tabulated in a neighbourhood.
_COARSE = 1e-5
# The neighbourhood: what is smaller by less than this share, which samples of a piece do not miss.
_NEAR = 1e-3
_NARROWEST = 1e-5


@dataclass(frozen=True, eq=False)
class PerIncidence:
    """A kernel that divides another one by the albedo at the light's direction."""

    fill: Kernel
    curve: AlbedoCurve

    def __call__(
        self, wi: np.ndarray, wo: np.ndarray, h: np.ndarray, p: np.ndarray, out: np.ndarray
    ) -> None:
        """Fill `out`; see `albedo.brdf.Part`."""
        self.fill(wi, wo, h, p, out)
        out /= self.curve(wi[2])[:, None]


@lru_cache(maxsize=512)
def per_incidence(fill: Kernel, model: Model) -> dict[str, Any]:
    """Kernel and doubt of a part that sends on all that it receives, at every incidence.

    Parameters
    ----------
    fill : callable
        Kernel of the only part of the model.
    model : Model
        Isotropic, with a finite albedo above 0 at grazing incidence.

    Returns
    -------
    dict
        ``fill`` and ``doubt`` for `albedo.brdf.Part`.
    """
    curve = albedo_curve(model)
    return {"fill": PerIncidence(fill, curve), "doubt": curve.bound}


def per_incidence_ahead(models: Sequence[Model]) -> None:
    """Make, side by side, the curves that `per_incidence` divides by."""
    if models:
        albedo_curves(models)


@lru_cache(maxsize=4096)
def largest_albedo(model: Model) -> tuple[float, float]:
    """The largest directional albedo of an isotropic model, and its relative error.

    Parameters
    ----------
    model : Model
        Isotropic, with a finite albedo at grazing incidence.

    Returns
    -------
    largest, error : float
        A curve over all incidences finds the place; a second one over the surroundings in which
        the largest value can lie gives the value.
    """
    coarse = albedo_curve(model, atol=_COARSE * _typical(model))
    place, top = coarse.maximum()
    first, last = _surroundings(coarse, place, top)
    # Cosines next to the normal cannot tell the nodes of a narrower interval apart.
    first = max(0.0, min(first, last - _NARROWEST))
    fine = albedo_curve(model, first=first, last=last, atol=4e-13 * top)
    value = fine.maximum()[1]
    return value, float(fine.bound().max()) / value


def _typical(model: Model) -> float:
    """An albedo of the size of the largest one, from a few directions down to grazing ones."""
    cosines = np.append(np.linspace(0.0, 1.0, 17), 2.0 ** -np.arange(5.0, 41.0))
    zeros = np.zeros(cosines.size)
    found = albedo_rows([model] * cosines.size, cosines, zeros, rtol=1e-3, atol=1e-290)
    return float(found.value.max())


def _surroundings(curve: AlbedoCurve, place: float, top: float) -> tuple[float, float]:
    """The ends of the part of the pieces in which a curve may exceed what it has at its top."""
    first = last = place
    for k in range(curve.error.size):
        y = np.linspace(curve.edges[k], curve.edges[k + 1], 257)
        slack = curve.error[k] + curve.error.max() + _NEAR * top
        high = y[curve.at(y) >= top - slack]
        if high.size:
            step = y[1] - y[0]
            first = min(first, max(high[0] - step, curve.edges[k]))
            last = max(last, min(high[-1] + step, curve.edges[k + 1]))
    return first, last


AT = ("normal", "max", "each_incidence")
"""Where the albedo is taken that `normalize` divides by."""

# What the albedo that is divided by is to be worth, where there are no azimuths.
_RTOL = 1e-12
_EPS = float(np.finfo(np.float64).eps)


@dataclass(frozen=True, eq=False)
class _OverLight:
    """A kernel that divides another one by what a table says for the light's height."""

    fill: Kernel
    table: HeightTable | SurfaceTable

    def __call__(
        self, wi: np.ndarray, wo: np.ndarray, h: np.ndarray, p: np.ndarray, out: np.ndarray
    ) -> None:
        """Fill `out`; see `albedo.brdf.Part`."""
        self.fill(wi, wo, h, p, out)
        light = np.empty(wi.shape[1])
        self.table.fill(wi, light)
        out /= light[:, None]


@lru_cache(maxsize=4096)
def normal_albedo(model: Model) -> tuple[float, float]:
    """The albedo at normal incidence, and its relative error.

    Raises
    ------
    InputError
        Where it is not above 0, or has no bound.
    """
    found = albedo_rows([model], np.ones(1), np.zeros(1), rtol=_RTOL, atol=0.0)
    value, error = float(found.value[0]), float(found.error[0])
    if not value > error:
        raise InputError(
            f"the albedo of {model.spec} at normal incidence is {value:.3g} +- {error:.1g}; there "
            "is nothing to divide by"
        )
    return value, error / (value - error)


class Normalized(Model):
    """A model divided by its own albedo; made by `normalize`.

    Attributes
    ----------
    base : Model
        What was divided.
    at : {"normal", "max", "each_incidence"}
        By the albedo in which directions.
    rtol : float, optional
        What a table of albedos is to be worth.
    """

    name = "normalize"
    title = "divided by its albedo"
    base: Model
    at: str
    rtol: float | None

    def __init__(self, base: Model, at: str, rtol: float | None = None) -> None:
        super().__init__()
        values: dict[str, Any] = {
            "base": base,
            "at": at,
            "rtol": rtol,
            "parameters": MappingProxyType({"base": base.spec, **base.parameters, "at": at}),
            "reciprocal": base.reciprocal and at != "each_incidence",
            # Elsewhere an albedo may exceed that at normal incidence.
            "conserves_energy": at != "normal",
            "grazing_limit": base.grazing_limit,
            "references": base.references,
            "equation": f"{base.equation} over its albedo",
            "lowest_cosine": base.lowest_cosine,
            "resolved_width": base.resolved_width,
        }
        for key, value in values.items():
            object.__setattr__(self, key, value)

    def parameter_info(self) -> tuple[Parameter, ...]:  # type: ignore[override]
        """The parameters of the base, which `replace` changes."""
        return self.base.parameter_info()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Normalized) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    @property
    def _key(self) -> tuple[Any, ...]:
        return self.base, self.at, self.rtol

    @property
    def spec(self) -> str:
        return f"normalize({self.base.spec}, at={self.at})"

    @property
    def isotropic(self) -> bool:
        return self.base.isotropic

    @property
    def channels(self) -> int | None:
        return self.base.channels

    def channel(self, index: int) -> Model:
        return Normalized(self.base.channel(index), self.at, self.rtol)

    def replace(self, **values: Any) -> Model:
        """A copy over a base with some parameters changed."""
        return Normalized(self.base.replace(**values), self.at, self.rtol)

    def pack(self) -> tuple[float, ...]:
        return self.base.pack()

    @property
    def divisor(self) -> tuple[float, float]:
        """The one albedo that is divided by, and its relative error."""
        if self.at == "normal":
            return normal_albedo(self.base)
        if self.base.isotropic:
            value, error = largest_albedo(self.base)
        else:
            value, error = surface_table(self.base, False, self.rtol or TURNED).maximum()
        if not value > 0.0 or not math.isfinite(error):
            raise InputError(f"{self.base.spec} reflects nothing; there is nothing to divide by")
        return value, error

    @property
    def _table(self) -> HeightTable | SurfaceTable:
        return table_of(self.base, False, self.rtol or (_RTOL if self.base.isotropic else TURNED))

    def parts(self) -> tuple[Part, ...]:
        return tuple(self._divided(part) for part in self.base.parts())

    def _divided(self, part: Part) -> Part:
        own = part.doubt
        if self.at == "each_incidence":
            table = self._table

            def each(cosines: np.ndarray | None, own: Any = own) -> Any:
                inherited = own(cosines) if callable(own) else own
                return inherited + table.relative(cosines)

            fill = _OverLight(part.fill, table)
            return replace(part, fill=fill, loss=None, loss_chart=None, doubt=each)
        value, error = self.divisor
        error += 2.0 * _EPS

        def once(cosines: np.ndarray | None, own: Any = own) -> Any:
            return (own(cosines) if callable(own) else own) + error

        scale = part.scale / value
        return replace(part, scale=scale, loss=None, loss_chart=None, doubt=once)

    def spikes(self, wi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        directions, weights = self.base.spikes(wi)
        return directions, weights / self._by(wi)[0] if len(weights) else weights

    def spike_errors(self, wi: np.ndarray, weights: np.ndarray) -> np.ndarray:
        if not len(weights):
            return super().spike_errors(wi, weights)
        value, error = self._by(wi)
        return self.base.spike_errors(wi, weights * value) / value + error * weights

    def _by(self, wi: np.ndarray) -> tuple[Any, Any]:
        """What is divided by, and its relative error."""
        if self.at != "each_incidence":
            return self.divisor
        return self._table.of(wi), self._table.relative(np.maximum(wi[:, 2], 0.0))


def normalize(model: Model, at: str = "normal", *, rtol: float | None = None) -> Normalized:
    """Divide a model by its own directional albedo.

    Parameters
    ----------
    model : Model
        What is divided.
    at : {"normal", "max", "each_incidence"}
        The albedo at normal incidence; its largest value (as NNS eq. 7 asks of c(n, s)); or at
        every light direction its own (Lewis 1993), after which the model reflects all light and
        is not reciprocal. Each channel of colours is divided by its own.

    Returns
    -------
    Normalized
        A model; the error of what it is divided by is part of every bound.

    Raises
    ------
    InputError
        For a model whose albedo has no largest value, or is not above 0 where it is divided by.

    Examples
    --------
    >>> import albedo
    >>> half = albedo.normalize(albedo.model("ashikhmin_shirley", n=10))
    >>> print(albedo.directional_albedo(half, 1.0))
    1.00000000(1) [bound]
    """
    if not isinstance(model, Model):
        raise InputError(f"normalize needs a model, not {type(model).__name__}")
    if at not in AT:
        raise InputError(f"at = {at!r} is unknown; choose one of {', '.join(AT)}")
    if at == "max" and not model.grazing_limit:
        raise InputError(
            f"the albedo of {model.spec} grows without limit towards grazing incidence; it has no "
            "largest value"
        )
    check_rtol(rtol)
    normalized = Normalized(model, at, rtol)
    for kind in normalized.by_channel():
        kind.parts()
    return normalized
