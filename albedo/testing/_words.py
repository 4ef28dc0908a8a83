"""What a failure says: directions, and numbers with their bounds."""

from __future__ import annotations

import math

import numpy as np


def direction(name: str, w: np.ndarray) -> str:
    """A direction as unit vector and in degrees."""
    # A negative zero would be printed, and turn the azimuth.
    x, y, z = (float(component) + 0.0 for component in w)
    theta = math.degrees(math.atan2(math.hypot(x, y), z))
    phi = math.degrees(math.atan2(y, x)) % 360.0
    # Cosines tell grazing angles apart, degrees do not.
    return (
        f"{name} = ({x:.9g}, {y:.9g}, {z:.9g}), theta = {theta:.6g} deg, phi = {phi:.6g} deg, "
        f"cos_theta = {z:.6g}"
    )


def pair(wi: np.ndarray, wo: np.ndarray) -> str:
    """A pair of directions, one line each."""
    return f"  {direction('wi', wi)}\n  {direction('wo', wo)}"
