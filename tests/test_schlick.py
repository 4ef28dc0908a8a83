"""Schlick's model against GGX, an elliptic integral and closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from exact import mp

import albedo
from albedo.brdf import Model
from albedo.catalogue.schlick import weights
from albedo.directions import spherical

EPS = np.finfo(float).eps

COSINES = np.array([1.0, 0.8, 0.3, 0.03, 1e-4])


def agrees(model: Model, exact: np.ndarray, phi: float = 0.0) -> None:
    found = albedo.directional_albedo(model, COSINES, phi, rtol=1e-11)
    assert np.all(found.converged)
    # The closed forms themselves are rounded a few times.
    assert np.all(np.abs(found.value - exact) <= found.error + 8 * EPS * np.abs(exact))


def mean_azimuth(p: float) -> float:
    """The mean of A with its root: sqrt(p) 2/pi K(1 - p^2)."""
    return float(mp.sqrt(p) * 2 / mp.pi * mp.ellipk(1 - mp.mpf(p) ** 2))


@pytest.mark.parametrize("r", [1e-8, 0.01, 0.3, 1.0])
@pytest.mark.parametrize("color", [1.0, 0.2])
def test_the_plain_lobe_is_ggx_without_masking(
    r: float, color: float, rng: np.random.Generator
) -> None:
    mine = albedo.model("schlick", roughness=r, color=color, form="plain")
    ggx = albedo.model(
        "cook_torrance",
        m=math.sqrt(r),
        distribution="ggx",
        geometry="none",
        fresnel="schlick",
        f0=color,
    )
    wi = spherical(rng.uniform(0.1, 1.0, 50), rng.uniform(0.0, 6.0, 50))
    wo = spherical(rng.uniform(0.1, 1.0, 50), rng.uniform(0.0, 6.0, 50))
    # About ten roundings in each of two fourth powers.
    np.testing.assert_allclose(mine.eval(wi, wo), ggx.eval(wi, wo), rtol=100 * EPS)
    there, here = (albedo.directional_albedo(m, COSINES) for m in (ggx, mine))
    assert np.all(np.abs(here.value - there.value) <= here.error + there.error)


@pytest.mark.parametrize(("p", "mean"), [(1.0, 1.0), (0.5, 0.9708), (0.2, 0.8587), (0.05, 0.6241)])
def test_the_azimuthal_factor_as_published_is_not_normalised(p: float, mean: float) -> None:
    """At normal incidence the plain lobe reflects the mean of A over 1 + r.

    V is above the horizon up to slopes of 1, and the integral of r/(r + t)^2 up to t = 1 is
    1/(1 + r).
    """
    assert mean_azimuth(p) == pytest.approx(mean, abs=5e-5)
    for r in (0.01, 0.3, 1.0):
        model = albedo.model("schlick", roughness=r, isotropy=p, form="plain")
        for phi in (0.0, 1.1):
            found = albedo.directional_albedo(model, 1.0, phi)
            exact = mean_azimuth(p) / (1.0 + r)
            assert abs(found.value - exact) <= found.error + 4 * EPS
            full = albedo.directional_albedo(model.replace(azimuth="normalised"), 1.0, phi)
            assert abs(full.value - 1.0 / (1.0 + r)) <= full.error + 4 * EPS


def test_peaks_of_the_azimuthal_factor_are_seen() -> None:
    """Down to an isotropy of 0.001, and where the peak lies inside a panel."""
    for azimuth in ("published", "normalised"):
        model = albedo.model("schlick", isotropy=1e-3, form="plain", azimuth=azimuth)
        mean = mean_azimuth(1e-3) if azimuth == "published" else 1.0
        found = albedo.directional_albedo(model, 1.0, [0.0, 0.3, 0.8, 1.5, 0.5 * math.pi])
        assert np.all(found.converged)
        assert np.all(np.abs(found.value - mean / 1.1) <= found.error)


def test_full_roughness_has_closed_forms() -> None:
    """r = 1: Z = 1 and G(v) = v, so every form is a polynomial of the cosines over pi."""
    rough = albedo.model("schlick", roughness=1.0)
    agrees(rough, np.full(5, 0.25))
    agrees(rough.replace(form="plain"), 0.5 / COSINES)
    # (1 - v v')/pi + 1/(4 pi): more than 1 for v' < 3/8.
    agrees(rough.replace(form="residual"), 1.25 - 2.0 / 3.0 * COSINES)
    # b = 0: Lambert.
    agrees(rough.replace(form="final"), np.ones(5))


def test_the_final_form_shares_out_all_energy(rng: np.random.Generator) -> None:
    for r in (1e-6, 0.1, 0.4, 0.5, 0.9):
        a, b, residual, g = weights(r, "final")
        assert a + b + g == pytest.approx(1.0, abs=4 * EPS)
        assert residual == b
    half = albedo.model("schlick", roughness=0.5, color=0.3, form="final")
    wi = spherical(rng.uniform(0.1, 1.0, 50), rng.uniform(0.0, 6.0, 50))
    np.testing.assert_allclose(
        half.eval(wi, wi[::-1]), half.replace(form="residual").eval(wi, wi[::-1]), rtol=8 * EPS
    )


@pytest.mark.parametrize("r", [0.1, 0.5, 0.8])
def test_without_a_residual_what_is_shadowed_is_lost(r: float) -> None:
    """Then all forms are the shadowed one, and what the final form adds to b of it."""
    shadowed = albedo.model("schlick", roughness=r, color=0.3)
    residual = shadowed.replace(form="residual", residual_azimuth="none")
    final = residual.replace(form="final")
    one, same, whole = (albedo.directional_albedo(m, COSINES) for m in (shadowed, residual, final))
    np.testing.assert_array_equal(same.value, one.value)
    s = 0.3 + 0.7 * (1.0 - COSINES) ** 5
    a, b, _, g = weights(r, "final")
    lambert = whole.parts.get("diffuse")
    rest = g * s if lambert is None else lambert.value
    assert (lambert is None) == (a == 0.0)
    assert np.all(np.abs(whole.value - b * one.value - rest) <= whole.error + 2.0 * one.error)
    kept = albedo.directional_albedo(final.replace(residual_azimuth="uniform"), COSINES)
    assert np.all(kept.value - kept.error > whole.value + whole.error)


def test_smooth_layers_are_mirrors() -> None:
    """r -> 0: S of the light, and with a second layer 1 - (1 - S)(1 - S') of it."""
    c, c2, cosine = 0.2, 0.6, 0.5
    one = albedo.model("schlick", roughness=1e-12, color=c, form="final")
    two = albedo.model(
        "schlick",
        roughness=1e-12,
        color=c,
        layers="2",
        roughness2=1e-12,
        color2=c2,
        form="final",
    )
    s, s2 = (x + (1 - x) * (1 - cosine) ** 5 for x in (c, c2))
    for model, exact in ((one, s), (two, 1.0 - (1.0 - s) * (1.0 - s2))):
        found = albedo.directional_albedo(model, cosine)
        # b = 4e-12 of the energy leaves elsewhere.
        assert found.value == pytest.approx(exact, rel=2e-11)


def test_a_white_first_layer_hides_the_second() -> None:
    model = albedo.model("schlick", layers="2", roughness2=0.3, isotropy2=0.1)
    alone = albedo.model("schlick")
    assert model.isotropic
    found, same = (albedo.directional_albedo(m, 0.4) for m in (model, alone))
    assert found.value == same.value


def test_shadowing_conserves_energy_from_some_roughness_on() -> None:
    """The albedo is largest at grazing incidence, and G grows weak with the roughness."""
    for r, conserves in ((0.169, False), (0.17, True)):
        model = albedo.model("schlick", roughness=r)
        assert model.conserves_energy is conserves
        found = albedo.directional_albedo(model, [0.0, 1e-3, 0.1, 0.5, 1.0], rtol=1e-6)
        assert np.all(found.value + found.error <= 1.0) == conserves
