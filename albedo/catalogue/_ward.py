"""Parameters that the three Ward models share."""

from __future__ import annotations

from albedo.brdf import Alias, Real


def alpha(axis: str) -> Real:
    """A width of the lobe: sqrt(2) times the rms slope along one axis."""
    return Real(0.1, f"roughness along the {axis}, sqrt(2) x rms slope", low=1e-8, high=10.0)


M = Alias(None, "isotropic roughness", targets=("alpha_x", "alpha_y"))
