"""Pairs of directions on which two forms of a BRDF are compared, value by value.

A third of the pairs is uniform in solid angle, a third grazes with either direction or both, and
in the last third the view lies beside the mirror direction of the light, at distances of all sizes:
where narrow lobes have their values, and where formulas differ if they do.
"""

from __future__ import annotations

import math

import numpy as np

from albedo.directions import spherical
from albedo.errors import InputError

LOWEST = 1e-6
"""The smallest cosine, and the smallest distance from the mirror direction in radians."""


def direction_pairs(
    count: int, seed: int = 0, *, lowest: float = LOWEST
) -> tuple[np.ndarray, np.ndarray]:
    """Draw pairs of directions above the horizon.

    Parameters
    ----------
    count : int
        How many, at least 3.
    seed : int
        The same seed gives the same pairs.
    lowest : float
        The smallest cosine of grazing directions, in (0, 1).

    Returns
    -------
    wi, wo : ndarray, shape (count, 3)
        Lights and views.

    Raises
    ------
    InputError
        For arguments out of range.
    """
    if count < 3:
        raise InputError(f"count = {count} is out of range; it must be at least 3")
    if not 0.0 < lowest < 1.0:
        raise InputError(f"lowest = {lowest:g} is out of range; it must lie in (0, 1)")
    rng = np.random.default_rng(seed)
    part = np.arange(count) % 3
    cos_l, cos_v = 1.0 - rng.random((2, count))
    phi_l, phi_v = 2.0 * math.pi * rng.random((2, count))
    # Grazing: one of the two, the other, or both.
    low_l, low_v = lowest ** rng.random((2, count))
    which = rng.integers(0, 3, count)
    cos_l = np.where((part == 1) & (which != 1), low_l, cos_l)
    cos_v = np.where((part == 1) & (which != 0), low_v, cos_v)
    distance = LOWEST ** rng.random(count)
    turn = 2.0 * math.pi * rng.random(count)
    wi = spherical(cos_l, phi_l)
    wo = spherical(cos_v, phi_v)
    mirror = wi * (-1.0, -1.0, 1.0)
    sin_l = np.sqrt((1.0 - cos_l) * (1.0 + cos_l))
    toward = np.stack((-cos_l * np.cos(phi_l), -cos_l * np.sin(phi_l), -sin_l), axis=-1)
    across = np.stack((-np.sin(phi_l), np.cos(phi_l), np.zeros(count)), axis=-1)
    beside = (
        np.cos(distance)[:, None] * mirror
        + (np.sin(distance) * np.cos(turn))[:, None] * toward
        + (np.sin(distance) * np.sin(turn))[:, None] * across
    )
    # What falls below the horizon is reflected up again.
    beside[:, 2] = np.abs(beside[:, 2])
    beside /= np.linalg.norm(beside, axis=-1, keepdims=True)
    wo = np.where((part == 2)[:, None], beside, wo)
    return wi, wo


def largest_relative_difference(first: np.ndarray, second: np.ndarray) -> tuple[float, int]:
    """The largest difference of two sets of values, over the larger of the two, and where.

    Parameters
    ----------
    first, second : ndarray, shape (n,)
        Values that are not negative.

    Returns
    -------
    value : float
        0 where both are 0 everywhere.
    index : int
        Of the pair that has it.
    """
    larger = np.maximum(np.abs(first), np.abs(second))
    # Below the range of normal numbers there are no relative digits to compare.
    seen = larger > np.finfo(float).tiny
    ratio = np.divide(np.abs(first - second), larger, out=np.zeros(larger.shape), where=seen)
    index = int(np.argmax(ratio))
    return float(ratio[index]), index
