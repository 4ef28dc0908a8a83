"""Lobes divided by their own albedo: at every incidence, or by its largest value."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from albedo.brdf import Kernel, Model
from albedo.operators.curve import AlbedoCurve, albedo_curve
from albedo.quadrature import albedo_rows

# The largest value is first sought with this error, then tabulated in a neighbourhood.
_COARSE = 1e-5
# The neighbourhood: what is smaller by less than this share, which samples of a piece do not miss.
_NEAR = 1e-3


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
