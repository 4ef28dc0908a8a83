"""Stam's model against He and Torrance's, against geometrical optics, and its conservation."""

from __future__ import annotations

import math

import numpy as np
import pytest

import albedo

COSINES = np.array([1.0, 0.8, 0.5, 0.3])


@pytest.mark.parametrize("sigma", [0.02, 0.1, 0.4])
def test_without_shadowing_it_is_he_torrance(sigma: float) -> None:
    """At tau/sigma0 = 1e4 a direction at n.v = 0.01 is 50 slopes off: K and 1 - S vanish there."""
    tau = 1e4 * sigma
    stam = albedo.model("stam_gaussian", sigma=sigma, t_x=tau, t_y=tau)
    he = albedo.model("he_torrance", sigma0=sigma, tau=tau)
    one, other = (albedo.directional_albedo(m, COSINES, rtol=1e-10) for m in (stam, he))
    assert np.all(np.abs(one.value - other.value) <= one.error + other.error + 1e-15)


def test_an_optically_rough_surface_is_one_of_facets() -> None:
    """g >> 1: Cook-Torrance with m = 2 sigma/T and G = 1, up to the size of the wave, 1/g."""
    stam = albedo.model("stam_gaussian", sigma=20.0, t_x=400.0, t_y=200.0)
    facets = albedo.model("cook_torrance", alpha_x=0.1, alpha_y=0.2, geometry="none")
    one, other = (albedo.directional_albedo(m, COSINES, 0.6) for m in (stam, facets))
    g = (2.0 * math.pi * 20.0 / 0.5 * 2.0 * 0.3) ** 2
    np.testing.assert_allclose(one.value, other.value, rtol=4.0 / g)


def test_a_smooth_surface_is_a_mirror() -> None:
    found = albedo.directional_albedo(albedo.model("stam_gaussian", sigma=1e-4), COSINES)
    g = (4.0 * math.pi * 1e-4 / 0.5 * COSINES) ** 2
    # What leaves the mirror part goes into the waves, of which some part leaves the hemisphere.
    assert np.all(np.abs(found.value - 1.0) <= g)
    assert np.all(np.abs(found.parts["mirror"].value - np.exp(-g)) <= 1e-15)


def test_the_albedo_grows_as_one_over_the_cosine() -> None:
    found = albedo.directional_albedo(
        albedo.model("stam_gaussian", sigma=0.3, mirror="off"), [1e-4, 1e-6, 1e-8]
    )
    assert np.all(found.converged)
    scaled = found.value * np.array([1e-4, 1e-6, 1e-8])
    # The next term is smaller by the cosine over the slope 2 sigma/T = 0.35, or its square root.
    np.testing.assert_allclose(scaled, scaled[-1], rtol=0.1)
    with pytest.raises(albedo.DivergenceError):
        albedo.directional_albedo(albedo.model("stam_gaussian"), 0.0)


def test_both_charts_agree() -> None:
    """An isotropic surface laid out as an anisotropic one: other charts, the same albedo."""
    one = albedo.model("stam_gaussian", sigma=0.06, t_x=1.0, t_y=1.0)
    other = albedo.model("stam_gaussian", sigma=0.06, t_x=1.0, t_y=1.0 + 1e-13)
    a, b = (albedo.directional_albedo(m, COSINES, 0.4) for m in (one, other))
    # The lengths differ by 1e-13, and no more than that the albedo.
    assert np.all(np.abs(a.value - b.value) <= a.error + b.error + 1e-12)
