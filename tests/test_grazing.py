"""Powers that albedos follow towards grazing incidence, against theory and other integrals."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import dblquad

import albedo
from albedo.analysis.grazing import SMALLEST, asymptote, first_above_one, power, theory
from albedo.brdf import Model
from albedo.errors import InputError
from albedo.grammar import parse

EPS = float(np.finfo(float).eps)
KNOWN = [
    "ward:m=1",
    "ward:m=0.1",
    "ward:m=0.001",
    "ward:m=0.4,form=fast,rho_s=0.5",
    "ward_duer:m=0.4",
    "ward_bounded:m=0.1",
    "cook_torrance:m=0.4",
    "cook_torrance:m=0.1,prefactor=1/pi",
    "cook_torrance:m=0.4,geometry=none",
    "cook_torrance:m=0.4,distribution=ggx,geometry=none",
    "cook_torrance:m=0.4,distribution=ggx,geometry=smith_correlated",
    "cook_torrance:m=0.4,geometry=smith",
    "cook_torrance:m=0.4,distribution=ggx,geometry=smith",
]


def model(spec: str) -> Model:
    return parse(spec).model()


def test_powers_are_found_within_their_errors() -> None:
    c = np.geomspace(1e-6, 1e-12, 49)
    value = 3.0 * c**2
    p, error = power(c, value, 1e-10 * value)
    # The errors may tilt the line; the logarithms round.
    assert abs(p - 2.0) <= error <= 1e-9


@pytest.mark.parametrize("size", [10.0, 0.3, -0.5])
@pytest.mark.parametrize("q", [1.0, 0.5, 0.2])
def test_what_is_not_yet_a_power_is_in_the_error(size: float, q: float) -> None:
    c = np.geomspace(1e-6, 1e-12, 49)
    value = c**-0.5 * (1.0 + size * (c / 1e-6) ** q)
    p, error = power(c, value, 1e-13 * value)
    assert abs(p + 0.5) <= error


@pytest.mark.parametrize("start", [1e-6, 1e-20, 1e-40])
@pytest.mark.parametrize("k", [1.0, 2.0, -1.0])
def test_powers_of_logarithms_are_in_the_error(start: float, k: float) -> None:
    """Their exponent is 0, and no decade shows it."""
    c = start * np.geomspace(1.0, 1e-6, 49)
    value = np.log(1.0 / c) ** k
    p, error = power(c, value, 1e-13 * value)
    assert 0.0 < abs(p) <= error


@pytest.mark.parametrize("spec", KNOWN)
def test_theory_is_measured(spec: str) -> None:
    one = model(spec)
    known, found = theory(one), asymptote(one, rtol=1e-10, per_decade=4)
    assert known is not None
    # What is asked for is 0.005.
    assert abs(found.exponent - known.exponent) <= found.error <= 2e-3
    value, error = found.measured_prefactor(known.exponent)
    assert abs(value - known.prefactor) <= error + known.error
    # From 1e-11 to 1e-12 a lobe of width 1e-3 changes by 1e-8.
    assert error <= 1e-7 * value
    assert found.albedo.converged.all()
    assert found.cos_theta[-1] == pytest.approx(SMALLEST, rel=1e-12)


def limit_over_half_vectors(spec: str, exponent: float) -> float:
    """The integral of f n.v c^p from raw vectors, over the polar angles of H, L being next to the
    horizon."""
    one = model(spec)
    c = 1e-9
    wi = np.array([math.sqrt(1.0 - c * c), 0.0, c])

    def integrand(turn: float, delta: float) -> float:
        h = np.array(
            [
                math.sin(delta) * math.cos(turn),
                math.sin(delta) * math.sin(turn),
                math.cos(delta),
            ]
        )
        l_h = float(wi @ h)
        wo = 2.0 * l_h * h - wi
        return float(one.eval(wi, wo)) * wo[2] * 4.0 * l_h * math.sin(delta) * c**exponent

    right = 0.5 * math.pi
    total, _ = dblquad(integrand, 0.0, right, 0.0, right, epsabs=1e-12, epsrel=1e-8)
    return 2.0 * total


@pytest.mark.parametrize("spec", [spec for spec in KNOWN if "m=0.4" in spec or "m=1" in spec])
def test_theory_is_the_limit_over_half_vectors(spec: str) -> None:
    known = theory(model(spec))
    assert known is not None
    # The quadrature is asked for 1e-8, and L is 1e-9 above the horizon.
    assert limit_over_half_vectors(spec, known.exponent) == pytest.approx(known.prefactor, rel=1e-7)


def test_theory_says_nothing_of_others() -> None:
    others = [
        "phong:n=20",
        "ward:alpha_x=0.1,alpha_y=0.2",
        "cook_torrance:m=0.1,fresnel=schlick",
        "cook_torrance:distribution=blinn_phong",
        "cook_torrance:m=0.1,geometry=smith_rational",
    ]
    assert all(theory(model(spec)) is None for spec in others)


def test_an_albedo_passes_one_where_it_is_one() -> None:
    one = model("ward:m=0.1")
    there = asymptote(one, per_decade=2).above_one
    assert there is not None
    c, width = there
    assert width <= 1e-9 * c
    for side, above in ((c - 4.0 * width, True), (c + 4.0 * width, False)):
        found = albedo.directional_albedo(one, side, rtol=1e-12)
        assert (found.value > 1.0) == above


def test_what_exceeds_one_at_the_normal_or_nowhere() -> None:
    bright = asymptote(model("cook_torrance:m=0.1,prefactor=1/pi"), per_decade=2)
    assert bright.above_one == (1.0, 0.0)
    dark = model("lambert")
    c = np.array([1.0, 0.5])
    assert first_above_one(dark, c, albedo.directional_albedo(dark, c)) is None


def test_an_asymptote_sets_in_where_the_lobe_is_wider_than_the_elevation() -> None:
    found = [asymptote(model(f"ward:m={m:g}"), per_decade=4) for m in (0.1, 0.01, 0.001)]
    share = [one.sets_in / one.model.parameters["alpha_x"] for one in found]
    # The scale of a narrow lobe is its width: the same share of it, to one step of the grid.
    assert max(share) / min(share) <= 10.0**0.25 * 1.01
    assert 0.01 < share[0] < 0.1


def test_a_law_that_does_not_settle_is_followed_further() -> None:
    """He-Torrance's mirror fades like a logarithm; its exponent is not known to 0.001."""
    found = asymptote(model("he_torrance"), rtol=1e-8, per_decade=2)
    assert found.cos_theta[-1] < 1e-40
    assert found.error > 1e-3
    assert abs(found.exponent) <= found.error


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"smallest": 0.5}, "smallest"),
        ({"smallest": math.nan}, "smallest"),
        ({"per_decade": 1}, "per_decade"),
        ({"decades": 1}, "decades"),
        ({"decades": 13}, "decades"),
    ],
)
def test_arguments_out_of_range_are_named(options: dict[str, float], named: str) -> None:
    with pytest.raises(InputError, match=named):
        asymptote(model("lambert"), **options)  # type: ignore[arg-type]


def test_an_albedo_of_zero_has_no_power() -> None:
    with pytest.raises(InputError, match="above 0"):
        asymptote(model("ward:m=0.1,rho_s=0"))
