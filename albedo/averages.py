"""The average albedo: what a surface reflects of light that comes evenly from everywhere."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np

from albedo.brdf import Model
from albedo.estimate import Estimate
from albedo.integrators.adaptive import Result, integrate
from albedo.quadrature import (
    DEFAULT_LIMIT,
    albedo_rows,
    check_tolerances,
    reshaped,
    warn_unconverged,
)

# Directions closer to the horizon carry mu^2 = 1e-20 of the light.
_LOWEST = 1e-10


class _Incidence:
    """Directions of incidence as a chart: azimuth, and the logarithm of the cosine.

    2 mu dmu = 2 mu^2 d(log mu); panels end at 45 degrees, where masking curves first cross.
    """

    def panels(
        self,
        cos_theta: np.ndarray,
        phi: np.ndarray,
        widths: np.ndarray,
        isotropic: bool,
        coarse: bool = False,
        fine: bool = False,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        edges = np.log([1.0, math.sqrt(0.5), 0.2, 0.03, 1e-3, 1e-5, _LOWEST])
        turns = [0.0, 1.0] if isotropic else np.linspace(0.0, 1.0, 5)
        box = [
            (u0, u1, v0, v1)
            for u0, u1 in itertools.pairwise(turns)
            for v1, v0 in itertools.pairwise(edges)
        ]
        m = len(box)
        return (
            *(np.zeros((1, 1)), np.zeros(m, dtype=np.int64)),
            *(np.ones((m, 4), dtype=np.int64), np.array(box)),
        )

    def nodes(
        self,
        geometry: np.ndarray,
        code: np.ndarray,
        box: np.ndarray,
        u: np.ndarray,
        v: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        m = len(box)
        turn = box[:, :1] + (box[:, 1:2] - box[:, :1]) * u
        mu = np.exp(box[:, 2:3] + (box[:, 3:4] - box[:, 2:3]) * v)
        shape = (m, u.size, v.size)
        area = (box[:, 1] - box[:, 0]) * (box[:, 3] - box[:, 2])
        weight = np.broadcast_to((area[:, None] * 2.0 * mu * mu)[:, None, :], shape)
        direction = np.zeros((3, *shape))
        direction[0] = turn[:, :, None]
        direction[2] = mu[:, None, :]
        flat = direction.reshape(3, m, -1)
        return np.zeros((3, m)), flat, flat, weight.reshape(m, -1)


def average_albedo(
    model: Model,
    rtol: float = 1e-8,
    atol: float = 0.0,
    *,
    fixed: str = "light",
    max_evaluations: int | None = None,
) -> Estimate:
    r"""Average (hemispherical) albedo, 2 \int a(mu) mu dmu, averaged over azimuth.

    Parameters
    ----------
    model : Model
        The model.
    rtol, atol : float
        The error asked for.
    fixed : {"light", "view"}
        As in `albedo.directional_albedo`.
    max_evaluations : int, optional
        Most evaluations per direction.

    Returns
    -------
    Estimate
        Of shape (), or (channels,) where a colour of the model has several; kind ``bound``;
        `evaluations` counts those of the model.

    Raises
    ------
    InputError
        For input out of range.

    Examples
    --------
    >>> import albedo, math
    >>> ggx = albedo.model("cook_torrance", m=1.0, distribution="ggx", geometry="smith_correlated")
    >>> a = albedo.average_albedo(ggx)
    >>> bool(abs(a.value - 4 / 3 * (1 - math.log(2))) <= a.error)
    True
    """
    check_tolerances(rtol, atol)
    options: dict[str, Any] = {"fixed": fixed, "max_evaluations": max_evaluations}
    kinds = model.by_channel()
    found = [_average(kind, rtol, atol, **options) for kind in kinds]
    names = ("value", "error", "evaluations", "converged")
    value, error, evaluations, converged = (
        np.concatenate([getattr(one, name) for one in found]) for name in names
    )
    estimate = Estimate(value, error, "bound", evaluations, converged, model.resolved_width)
    warn_unconverged(estimate, rtol, atol)
    return reshaped(estimate, () if model.channels is None else (len(kinds),))


def _average(
    model: Model, rtol: float, atol: float, *, fixed: str, max_evaluations: int | None
) -> Result:
    """The average of one channel, of shape (1,)."""
    inner = max(0.1 * rtol, 1e-13)
    used = 0
    worst = 0.0

    def integrand(row: np.ndarray, wi: np.ndarray, wo: np.ndarray, h: np.ndarray) -> np.ndarray:
        nonlocal used, worst
        turn = np.zeros_like(wo[0]) if model.isotropic else wo[0]
        pairs, back = np.unique(
            np.stack((wo[2].ravel(), turn.ravel())), axis=1, return_inverse=True
        )
        found = albedo_rows(
            [model] * pairs.shape[1],
            *(pairs[0], 2.0 * math.pi * pairs[1]),
            rtol=inner,
            atol=0.1 * atol,
            fixed=fixed,
            max_evaluations=max_evaluations,
        )
        used += int(found.evaluations.sum())
        size = np.maximum(np.abs(found.value), 1e-300)
        excess = np.where(found.converged, 0.0, found.error / size)
        worst = max(worst, float(excess.max()))
        return found.value[back.ravel()].reshape(wo[0].shape)

    result = integrate(
        _Incidence(),
        integrand,
        *(np.ones(1), np.zeros(1), np.ones((1, 2)), model.isotropic),
        rtol=0.8 * rtol,
        atol=0.8 * atol,
        limit=DEFAULT_LIMIT,
        probe=False,
    )
    error = result.error + (inner + worst) * np.abs(result.value) + 0.1 * atol
    # Albedos grow at most as 1/mu towards the horizon, so what was left out is this small.
    lowest = albedo_rows(
        [model], np.array([_LOWEST]), np.zeros(1), rtol=1e-3, atol=0.0, fixed=fixed
    )
    error = error + 2.0 * _LOWEST**2 * np.abs(lowest.value)
    converged = error <= np.maximum(atol, rtol * np.abs(result.value))
    return Result(result.value, error, np.array([used]), converged)
