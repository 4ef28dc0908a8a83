"""The half vector of Ashikhmin and Shirley's model: its density, its limits, what it sends back.

The density of the half vector is p_h = sqrt((n_u + 1)(n_v + 1))/(2 pi) (n.h)^(n_u cos^2 + n_v
sin^2) (AS eq. 5). For large exponents its slopes are normal variables with variances 1/n_u and
1/n_v, and the view next to grazing incidence has n.v = n.l + 2 s, s being the slope of h along the
light. What is not reflected is then the mean of 1 - max(0, n.v)/max(n.l, n.v), a function of one
variable; see `lost_in_the_limit`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from albedo.brdf import Model
from albedo.catalogue._blinn import slope_chart, slope_width
from albedo.integrators.adaptive import integrate

# The lowest that a half vector is put: a direction has to be above the horizon.
_LOWEST = 1e-60
_NORMAL = np.array([0.0, 0.0, 1.0])


def integral_of_density(model: Model, rtol: float = 1e-12) -> tuple[float, float]:
    """Integral of the density of half vectors over the hemisphere, by quadrature.

    Parameters
    ----------
    model : Model
        ``ashikhmin_shirley`` with any exponents. Its density of views is p_h/(4 v.h), so that of
        half vectors is 4 times that of the view V = H for light from H.
    rtol : float
        The error asked for.

    Returns
    -------
    value, error : float
        The integral and its bound.
    """
    n_u, n_v = model.pack()[:2]

    def over_views(row: np.ndarray, wi: np.ndarray, wo: np.ndarray, h: np.ndarray) -> np.ndarray:
        # Opposite the light half vectors are short and rounded, and there is no solid angle.
        h = np.stack((h[0], h[1], np.maximum(h[2], 0.0)))
        most = np.max(np.abs(h), axis=0)
        there = most > 0.0
        scaled = np.where(there, h / np.where(there, most, 1.0), _NORMAL[:, None, None])
        length = np.sqrt(np.sum(scaled * scaled, axis=0))
        unit = np.moveaxis(scaled / length, 0, -1).reshape(-1, 3)
        unit[:, 2] = np.maximum(unit[:, 2], _LOWEST)
        density = 4.0 * model.pdf(unit, unit).reshape(length.shape)
        # 4 (v.h) = 2 |h|.
        return np.where(there, density / np.where(there, 2.0 * most * length, 1.0), 0.0)

    # With light from the normal, views on the whole sphere have half vectors on the hemisphere.
    found = integrate(
        *(slope_chart(min(n_u, n_v), full=True), over_views, np.ones(1), np.zeros(1)),
        *(np.array([[slope_width(n_u), slope_width(n_v)]]), model.isotropic),
        rtol=rtol,
        atol=0.0,
        limit=400_000,
    )
    return float(found.value[0]), float(found.error[0])


def albedo_at_normal(n: float) -> float:
    """The albedo of equal exponents at normal incidence, with a Fresnel factor of 1.

    There n.v = 2 (n.h)^2 - 1 and max(n.l, n.v) = 1, so it is the integral of
    (n + 1) x^n (2 x^2 - 1) from x = sqrt(1/2) to 1.

    Parameters
    ----------
    n : float
        The exponent.

    Returns
    -------
    float
        In closed form.
    """
    root = math.sqrt(0.5)
    upper = 2.0 / (n + 3.0) * (1.0 - root ** (n + 3.0))
    return (n + 1.0) * (upper - (1.0 - root ** (n + 1.0)) / (n + 1.0))


def least_k_dot_h(cos_theta: ArrayLike) -> np.ndarray:
    """The smallest k.h that a direction k above the horizon can have (AS eq. 14).

    Half vectors are farthest from k where the other direction lies on the horizon opposite to it:
    cos(pi/4 + theta/2), written without the difference that cancels at grazing angles.

    Parameters
    ----------
    cos_theta : array_like
        n.k.

    Returns
    -------
    ndarray
        sqrt((1 - sin(theta))/2) = n.k/sqrt(2 (1 + sin(theta))).
    """
    c = np.asarray(cos_theta, dtype=float)
    found: np.ndarray = c / np.sqrt(2.0 * (1.0 + np.sqrt((1.0 - c) * (1.0 + c))))
    return found


def horizon_variable(
    cos_theta: ArrayLike, n_u: float, n_v: float, phi: ArrayLike = 0.0
) -> np.ndarray:
    """cot(theta) over the standard deviation of the slope of h along the light.

    Parameters
    ----------
    cos_theta, phi : array_like
        The light.
    n_u, n_v : float
        Exponents above 0.

    Returns
    -------
    ndarray
        cot(theta)/sqrt(cos^2(phi)/n_u + sin^2(phi)/n_v).
    """
    c = np.asarray(cos_theta, dtype=float)
    with np.errstate(divide="ignore"):
        cot = c / np.sqrt((1.0 - c) * (1.0 + c))
    variance = np.cos(phi) ** 2 / n_u + np.sin(phi) ** 2 / n_v
    found: np.ndarray = cot / np.sqrt(variance)
    return found


def lost_in_the_limit(u: ArrayLike) -> np.ndarray:
    """What a lobe of large exponents loses, with a Fresnel factor of 1, as exponents grow.

    With a standard normal g the view has n.v/n.l = 1 + 2 g/u, and the loss is the mean of
    1 - max(0, n.v)/max(n.l, n.v): P(g < -u/2) + (2/u) (p(0) - p(u/2)), p being its density. That is
    1/2 for u = 0 and (2/u) p(0) for large u.

    Parameters
    ----------
    u : array_like
        See `horizon_variable`.

    Returns
    -------
    ndarray
        1 - a.
    """
    from scipy.special import ndtr

    u = np.asarray(u, dtype=float)
    peak = 1.0 / math.sqrt(2.0 * math.pi)
    with np.errstate(divide="ignore", invalid="ignore"):
        shared = np.where(u > 0.0, -2.0 * peak * np.expm1(-0.125 * u * u) / u, 0.0)
    found: np.ndarray = ndtr(-0.5 * u) + shared
    return found
