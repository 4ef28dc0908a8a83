"""Unit vectors in the local frame: x = tangent, y = bitangent, z = normal.

Both directions point away from the surface: ``wi`` is the light L, ``wo`` the view V, always in
this order. Public arrays have shape (..., 3); kernels see one contiguous array per component.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from albedo._compile import kernel
from albedo.errors import InputError

# A unit vector rounded to float32 is off by 6e-8 in length.
UNIT_TOLERANCE = 1e-6


def real_array(values: ArrayLike, name: str) -> np.ndarray:
    """`values` as float64, refusing what is complex, not a number, or not finite."""
    try:
        array = np.asarray(values)
        if np.iscomplexobj(array):
            raise InputError(f"{name} is complex; it must be real")
        array = array.astype(np.float64)
    except (TypeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{name} = {values!r} is not an array of numbers") from None
    if not np.all(np.isfinite(array)):
        bad = array[~np.isfinite(array)].flat[0]
        raise InputError(f"{name} contains {bad}; every value must be finite")
    return array


def unit_vectors(values: ArrayLike, name: str) -> np.ndarray:
    """`values` as directions of shape (..., 3), refusing what is not of unit length.

    Raises
    ------
    InputError
        When the last axis is not 3, a value is not finite, or a length is not 1 within 1e-6.
    """
    array = real_array(values, name)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise InputError(f"{name} has shape {array.shape}; directions have shape (..., 3)")
    length = np.linalg.norm(array, axis=-1)
    wrong = np.abs(length - 1.0) > UNIT_TOLERANCE
    if np.any(wrong):
        raise InputError(
            f"{name} contains a vector of length {length[wrong].flat[0]:.9g}; "
            "directions must be unit vectors (within 1e-6)"
        )
    return array


def spherical(cos_theta: ArrayLike, phi: ArrayLike = 0.0) -> np.ndarray:
    """Unit vectors from the cosine of the polar angle and the azimuth in radians, (..., 3)."""
    c, phi = np.broadcast_arrays(real_array(cos_theta, "cos_theta"), real_array(phi, "phi"))
    s = np.sqrt((1 - c) * (1 + c))
    return np.stack((s * np.cos(phi), s * np.sin(phi), c), axis=-1)


def half_vector(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    """The half vector h = wi + wo, not normalised, as well as raw directions allow.

    Parameters
    ----------
    wi, wo : ndarray, shape (..., 3)
        Unit vectors; they broadcast.

    Returns
    -------
    ndarray, shape (..., 3)
        h. Along the tangential part of wi the sum cancels near the mirror direction at grazing
        incidence; there h_u = (v_w^2 + v_z^2 - l_z^2) / (|l_t| - v_u), which follows from
        |wi| = |wo| = 1 with u along the tangential part of wi and w across.
    """
    wi, wo = np.broadcast_arrays(wi, wo)
    h = np.empty(wi.shape)
    fill_half_vectors(
        *(np.ascontiguousarray(v, dtype=np.float64).reshape(-1, 3) for v in (wi, wo)),
        h.reshape(-1, 3),
    )
    return h


@kernel
def fill_half_vectors(wi, wo, h):
    """Half vectors of rows of raw directions; see `half_vector`."""
    for i in range(h.shape[0]):
        lx, ly, l_z = wi[i, 0], wi[i, 1], wi[i, 2]
        vx, vy, v_z = wo[i, 0], wo[i, 1], wo[i, 2]
        h[i, 0], h[i, 1], h[i, 2] = lx + vx, ly + vy, l_z + v_z
        tangential = math.hypot(lx, ly)
        if tangential > l_z:
            ux, uy = lx / tangential, ly / tangential
            v_u, v_w = vx * ux + vy * uy, -vx * uy + vy * ux
            if v_u < 0.0:
                h_u = (v_w * v_w + (v_z - l_z) * (v_z + l_z)) / (tangential - v_u)
                h[i, 0] = h_u * ux - v_w * uy
                h[i, 1] = h_u * uy + v_w * ux
