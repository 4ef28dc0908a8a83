"""Sums and multiples of models: values, albedos and Dirac parts add up."""

from __future__ import annotations

import math

import numpy as np
import pytest

import albedo
from albedo.directions import spherical

EPS = np.finfo(float).eps
SPECULAR = albedo.model("ward", m=0.1)
DIFFUSE = albedo.model("lambert", rho=0.5)
COSINES = np.array([1.0, 0.5, 1e-2, 1e-6])


def test_values_add_up(rng: np.random.Generator) -> None:
    both = SPECULAR + 0.3 * DIFFUSE
    wi, wo = (spherical(rng.uniform(0.1, 1, 20), rng.uniform(-3, 3, 20)) for _ in range(2))
    expected = SPECULAR.eval(wi, wo) + 0.3 * DIFFUSE.eval(wi, wo)
    # One product and one sum.
    np.testing.assert_allclose(both.eval(wi, wo), expected, rtol=4 * EPS)


@pytest.mark.parametrize("fixed", ["light", "view"])
@pytest.mark.parametrize("complement", [False, True])
def test_albedos_add_up_within_their_bounds(fixed: str, complement: bool) -> None:
    options = {"fixed": fixed, "complement": complement}
    found = albedo.directional_albedo(0.7 * SPECULAR + DIFFUSE * 0.3, COSINES, **options)
    one, other = (albedo.directional_albedo(m, COSINES, fixed=fixed) for m in (SPECULAR, DIFFUSE))
    value = 0.7 * one.value + 0.3 * other.value
    allowed = found.error + 0.7 * one.error + 0.3 * other.error + 4 * EPS * value
    assert np.all(found.converged)
    assert np.all(np.abs(found.value - (1.0 - value if complement else value)) <= allowed)
    if not complement:
        assert set(found.parts) == {"ward specular", "lambert diffuse"}
        assert np.all(np.abs(found.parts["lambert diffuse"].value - 0.15) <= 1e-8)


def test_models_of_one_kind_keep_their_own_parameters() -> None:
    found = albedo.directional_albedo(
        albedo.model("ward", m=0.1) + albedo.model("ward", m=0.4), 0.5
    )
    parts = [albedo.directional_albedo(albedo.model("ward", m=m), 0.5) for m in (0.1, 0.4)]
    assert abs(found.value - sum(p.value for p in parts)) <= found.error + sum(
        p.error for p in parts
    )
    assert list(found.parts) == ["ward specular", "ward specular 2"]


def test_dirac_parts_are_scaled() -> None:
    rough = albedo.model("he_torrance", sigma0=0.02)
    wi = spherical(np.array([0.8]), 0.3)
    directions, weights = (0.25 * rough + DIFFUSE).spikes(wi)
    expected, whole = rough.spikes(wi)
    assert np.array_equal(directions, expected)
    assert np.array_equal(weights, 0.25 * whole)
    found = albedo.directional_albedo(0.25 * rough + DIFFUSE, 0.8)
    alone = albedo.directional_albedo(rough, 0.8)
    assert abs(found.value - 0.25 * alone.value - 0.5) <= found.error + alone.error


def test_a_sum_keeps_the_loss_of_nothing_but_itself() -> None:
    """1 - a of a single unscaled term is integrated directly, of a multiple by subtraction."""
    sharp = albedo.model("cook_torrance", m=1e-6, distribution="ggx", geometry="smith_correlated")
    direct = albedo.directional_albedo(sharp, 0.5, complement=True)
    same = albedo.directional_albedo(1.0 * sharp, 0.5, complement=True)
    assert abs(same.value - direct.value) <= same.error + direct.error
    assert same.error < 1e-6 * same.value
    half = albedo.directional_albedo(0.5 * sharp, 0.5, complement=True)
    assert abs(half.value - 0.5 - 0.5 * direct.value) <= half.error + direct.error


def test_promises_of_a_sum() -> None:
    assert (0.5 * DIFFUSE + 0.5 * albedo.model("blinn")).conserves_energy
    assert not (DIFFUSE + DIFFUSE).conserves_energy
    assert not (DIFFUSE + albedo.model("phong_original")).reciprocal
    assert not (DIFFUSE + albedo.model("ward")).grazing_limit
    assert not (DIFFUSE + albedo.model("ward", alpha_x=0.1, alpha_y=0.2)).isotropic
    with pytest.raises(albedo.DivergenceError):
        albedo.directional_albedo(DIFFUSE + albedo.model("ward"), 0.0)
    assert albedo.directional_albedo(0.5 * DIFFUSE + DIFFUSE, 0.0).value == pytest.approx(0.75)


def test_sums_work_everywhere_else() -> None:
    both = 0.5 * DIFFUSE + 0.5 * albedo.model("blinn", n=10.0)
    average = albedo.average_albedo(both, rtol=1e-6)
    blinn = albedo.average_albedo(albedo.model("blinn", n=10.0), rtol=1e-6)
    assert abs(average.value - 0.25 - 0.5 * blinn.value) <= average.error + blinn.error
    table = albedo.table(both, COSINES)
    assert table["value"].shape == (1, 4)
    assert both.spec == "0.5*lambert:rho=0.5 + 0.5*blinn:n=10.0,rho_s=1.0,normalization=exact"


def test_sums_are_equal_by_their_terms() -> None:
    assert SPECULAR + albedo.model("lambert", rho=0.5) == SPECULAR + DIFFUSE
    assert hash(SPECULAR + DIFFUSE) == hash(SPECULAR + albedo.model("lambert", rho=0.5))
    assert SPECULAR + DIFFUSE != DIFFUSE + SPECULAR
    assert 2.0 * (SPECULAR + 0.5 * DIFFUSE) == 2.0 * SPECULAR + DIFFUSE * 1.0
    assert np.float64(0.5) * DIFFUSE == 0.5 * DIFFUSE
    assert (SPECULAR + DIFFUSE).replace() == SPECULAR + DIFFUSE


@pytest.mark.parametrize("factor", [-1.0, math.nan, math.inf, 1j, "x", True, np.array([1.0, 2.0])])
def test_bad_factors_are_refused(factor: object) -> None:
    with pytest.raises(albedo.InputError, match="must lie in"):
        factor * SPECULAR  # type: ignore[operator]


def test_what_is_no_model_cannot_be_added() -> None:
    with pytest.raises(TypeError):
        SPECULAR + 1.0  # type: ignore[operator]
    with pytest.raises(TypeError):
        SPECULAR * DIFFUSE  # type: ignore[operator]
    with pytest.raises(albedo.InputError, match="no parameters"):
        (SPECULAR + DIFFUSE).replace(m=0.2)
