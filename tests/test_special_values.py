"""Values where special parameters meet special directions, and at the horizon."""

from __future__ import annotations

import math

import numpy as np
import pytest

import albedo
from albedo.analysis import special_values as special
from albedo.analysis import stability
from albedo.analysis.precise import evaluate, precise
from albedo.brdf import Model
from albedo.catalogue import names
from albedo.directions import spherical
from albedo.errors import DivergenceError, InputError
from albedo.geometry import divided, log_secant2, slopes, v_dot_h
from albedo.grammar import parse
from albedo.quadrature import LOWEST_COSINE

# Of models with many choices, or with constants that take a second to find, every so manieth set of
# parameters is tried; the deep suite has all.
SOME = {
    **dict.fromkeys(("cook_torrance", "distribution_brdf", "he_torrance", "stam_gaussian"), 6),
    "ashikhmin_shirley": 2,
    "lafortune_scaled": 8,
    "lewis": 4,
    "stam_grating": 4,
}


def wrong_values(model: Model) -> list[str]:
    frame = special.special_values(model)
    bad = frame[frame["float64_wrong"] | frame["raw_wrong"]]
    return [f"{model.spec}: {row.float64}, {row.raw} at {row.place}" for row in bad.itertuples()]


@pytest.mark.parametrize("name", names())
def test_no_value_is_nan_and_none_infinite_that_should_not_be(name: str) -> None:
    models = special.special_models(albedo.models()[name])
    models = [m for m in models[:: SOME.get(name, 1)] if m.parts()]
    assert models
    assert [line for model in models for line in wrong_values(model)] == []


@pytest.mark.slow
@pytest.mark.parametrize("name", names())
def test_no_value_is_nan_where_many_parameters_are_special(name: str) -> None:
    most = 6 if name == "lafortune_scaled" else 400
    models = special.special_models(albedo.models()[name], most=most)
    assert [line for model in models if model.parts() for line in wrong_values(model)] == []


@pytest.mark.parametrize(
    "spec",
    [
        # Only the square of what is squared is beyond all numbers.
        "stam_grating:depth=0,period=1,wavelength=1000,coherence=0.1",
        # A small Fresnel factor brings it back.
        "stam_grating:depth=0,period=1,wavelength=1000,coherence=1,fresnel=schlick,f0=0",
        "stam_grating:period=0.01,depth=0,wavelength=1000,coherence=1,fresnel=conductor,ior=1,k=1e-8",
        # Only in 50 digits is the phase w k depth above 0.
        "stam_grating:period=1e4,depth=1,wavelength=1000,coherence=1000",
    ],
)
def test_lobes_of_gratings_at_the_smallest_cosines(spec: str) -> None:
    assert wrong_values(parse(spec).model()) == []


HORIZON = [0.0, -0.0, -5e-324, -1e-300]
ABOVE = [5e-324, 1e-300, 0.5, 1.0]


def as_lobes(kind: type[Model]) -> Model:
    """The defaults of a model, with lobes where it is all Dirac parts otherwise."""
    return kind() if kind().parts() else kind(coherence=3.0)


@pytest.mark.parametrize("name", names())
def test_nothing_is_reflected_at_the_horizon(name: str) -> None:
    """`Model.eval` is 0 where a cosine is exactly 0, and defined for the smallest above it."""
    model = as_lobes(albedo.models()[name])
    edge = np.array([[math.sqrt(1.0 - z * z), 0.0, z] for z in HORIZON])
    above = np.array([[0.0, math.sqrt(1.0 - z * z), z] for z in ABOVE])
    for wi, wo in ((edge[:, None], above), (above[:, None], edge), (edge[:, None], edge)):
        assert np.all(model.eval(wi, wo) == 0.0)
    assert not np.isnan(model.eval(above[:, None], above)).any()


@pytest.mark.parametrize("name", names())
def test_the_albedo_at_the_horizon_is_the_limit(name: str) -> None:
    """Where there is one: at cos 0 what is meant is what cosines next to it tend to."""
    model = as_lobes(albedo.models()[name])
    if not model.grazing_limit:
        with pytest.raises(DivergenceError):
            albedo.directional_albedo(model, 0.0)
        return
    at = albedo.directional_albedo(model, 0.0, rtol=1e-6)
    # Albedos of these cosines differ from the limit about as they do themselves; he_torrance's
    # roughness that is seen falls only as 1/ln(1/c).
    c = np.array([1e-12, 1e-15, 1e-18])
    near = albedo.directional_albedo(model, c, rtol=1e-6)
    off = np.abs(near.value - at.value)
    if name == "he_torrance":
        slow = off * -np.log(c)
        assert np.all(np.abs(slow / slow[-1] - 1.0) < 0.1)
    else:
        assert np.all(off <= near.error + at.error + 1e3 * c)


SMITH = [
    {"distribution": distribution, "geometry": geometry, **widths}
    for distribution in ("beckmann", "ggx")
    for geometry in ("v_cavity", "smith", "smith_correlated")
    for widths in ({"m": 0.1}, {"alpha_x": 0.02, "alpha_y": 0.5}, {"alpha_x": 1e-8, "alpha_y": 0.1})
]


@pytest.mark.parametrize("choices", SMITH, ids=str)
@pytest.mark.filterwarnings("ignore::albedo.ConvergenceWarning")
def test_albedos_of_facets_are_numbers_next_to_the_horizon(choices: dict[str, object]) -> None:
    """Both ways round, and what is lost: where its panels give up, by subtraction."""
    model = albedo.model("cook_torrance", **choices)
    c = np.array([1e-9, 1e-12, 1e-15, 1e-18, 1e-20])
    for phi in (0.3, 1.57):
        light, view = (
            albedo.directional_albedo(model, c, phi, rtol=1e-4, fixed=way)
            for way in ("light", "view")
        )
        lost = albedo.directional_albedo(model, c, phi, rtol=1e-4, complement=True)
        for found in (light, view, lost):
            assert np.isfinite(found.value).all()
        # The model is reciprocal.
        assert np.all(np.abs(light.value - view.value) <= light.error + view.error)
        assert np.all(np.abs(light.value + lost.value - 1.0) <= light.error + lost.error + 1e-15)


def test_models_are_special_all_over() -> None:
    ward = special.special_models(albedo.models()["ward"])
    pairs = {(m.parameters["alpha_x"], m.parameters["alpha_y"]) for m in ward}
    assert {(1e-8, 0.1), (10.0, 0.1), (1e-8, 1e-8), (10.0, 10.0), (1.0, 1e-4)} <= pairs
    assert {(10.0, 10.0 / special.ANISOTROPY), (10.0 / special.ANISOTROPY, 10.0)} <= pairs
    assert {m.parameters["rho_s"] for m in ward} == {0.0, 1e-8, 1.0}
    phong = special.special_models(albedo.models()["phong"])
    assert {0.0, 1.0, 1e8, 1e9} <= {m.parameters["n"] for m in phong} | {1e9}
    drawn = special.special_models(albedo.models()["phong"], most=30)
    assert drawn[: len(phong)] == phong
    assert len(drawn) > len(phong)


def test_wrong_values_are_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """NaN, what is below 0, and infinite values where the exact one is in range."""
    model = albedo.model("lambert")
    good = special.special_values(model)
    assert not good["float64_wrong"].any()
    assert not good["raw_wrong"].any()

    def spoil(_: Model, wi: np.ndarray, wo: np.ndarray, h: np.ndarray) -> np.ndarray:
        found = np.full(len(wi), 1.0 / math.pi)
        found[:3] = math.nan, -1.0, math.inf
        return found

    monkeypatch.setattr(special, "values_with_sums", spoil)
    bad = special.special_values(model)
    assert bad["float64_wrong"].tolist() == [True] * 3 + [False] * (len(bad) - 3)
    # The largest values of Ward-Duer are truly above the range.
    monkeypatch.undo()
    steep = special.special_values(albedo.model("ward_duer"))
    assert np.isposinf(steep["float64"]).any()
    assert not steep["float64_wrong"].any()


def test_slopes_next_to_the_horizon_keep_their_azimuth() -> None:
    x, y, lift = slopes(3e-10, -4e-10, 1e-300)
    assert y / x == pytest.approx(-4.0 / 3.0, rel=4 * np.finfo(float).eps)
    # ln tan^2 = 2 ln(5e-10/1e-300), from three logarithms of up to 700.
    expected = 2.0 * (math.log(5e-10) - math.log(1e-300))
    eps = float(np.finfo(float).eps)
    assert math.log(x * x + y * y) + lift == pytest.approx(expected, rel=8 * eps)
    assert log_secant2(3e-10, -4e-10, 1e-300) == pytest.approx(expected, rel=8 * eps)
    assert slopes(0.3, 0.1, 0.5) == (0.6, 0.2, 0.0)
    assert all(np.isfinite(slopes(1.0, 0.0, 0.0)))


def test_half_a_cosine_that_underflows_is_measured() -> None:
    assert v_dot_h(3e-300, 0.0, 4e-300) == pytest.approx(2.5e-300, rel=1e-15)
    assert v_dot_h(0.0, 0.0, 2e-323) == 1e-323


def test_a_quotient_leaves_the_range_only_when_it_has_to() -> None:
    # exp(-800)/1e-300 from the root exp(-400), and 1e-20/5e-324 from 1e-10.
    expected = math.exp(-400.0) / 1e-300 * math.exp(-400.0)
    assert divided(1.0, math.exp(-400.0), 1e-300, 1.0) == pytest.approx(expected, rel=1e-15)
    assert divided(1.0, 1e-10, 5e-324, 1.0) == pytest.approx(1e-20 / 5e-324, rel=1e-15)
    assert divided(1.0, 1.0, 1e-300, 1e-300) == math.inf
    assert divided(0.0, 1.0, 5e-324, 5e-324) == 0.0
    assert divided(1.0, 0.0, 5e-324, 5e-324) == 0.0
    assert divided(1.0, 1.0, 0.0, 1.0) == 0.0


TINY_POWERS = [
    albedo.model("phong", n=1e-3),
    albedo.model("phong_original", n=1e-3),
    albedo.model("max_phong", n=1e-3),
    albedo.model("max_phong_anisotropic", n_u=1e-3, n_v=1e-3),
    albedo.model("lafortune", lobes=((-1.0, -1.0, 1.0, 1e-3),)),
    albedo.model("granier_heidrich", e0=1e-3),
]


@pytest.mark.parametrize("model", TINY_POWERS, ids=lambda model: model.name)
@pytest.mark.parametrize("c", [1e-3, 1e-12, 1e-17, 1e-300])
def test_a_tiny_power_of_a_tiny_cosine_is_right(model: Model, c: float) -> None:
    """(1e-17)^0.001 is 0.96, and 0 for an r.v that is rounded to 0; V = N has r.v = n.l."""
    wi, up = spherical([c]), np.array([[0.0, 0.0, 1.0]])
    exact = stability.exact_directions(wi, up)
    known = float(evaluate(model, precise(), *exact)[0])
    # A logarithm, an exponential and a dozen products; what is over c is rounded with it.
    assert model.eval(wi, up)[0] == pytest.approx(known, rel=16 * np.finfo(float).eps)


@pytest.mark.parametrize(
    "spec",
    [
        # e^-g is below what float32 has from g = 87 on.
        *("he_torrance:sigma0=0.39,tau=3", "he_torrance:sigma0=0.4,tau=10"),
        *("stam_gaussian:sigma=0.385,t_x=3,t_y=3", "stam_gaussian:sigma=0.39,t_x=10,t_y=10"),
    ],
)
def test_series_whose_first_terms_underflow_have_digits_in_float32(spec: str) -> None:
    frame = stability.measure([({}, parse(spec).model())], cosines=(1.0, 0.99, 0.95))
    at = frame[(frame["place"] == "mirror") | frame["place"].str.contains("0.5")]
    # Exponents of up to ten, whose digits count once in 7.2.
    assert at["float32"].min() > 5.0
    assert frame["float64"].min() > 12.0


@pytest.mark.parametrize("name", names())
def test_albedos_go_on_down_to_the_smallest_cosine(name: str) -> None:
    """Powers of the cosine, or a limit; below, values of gratings end."""
    model = as_lobes(albedo.models()[name])
    c = LOWEST_COSINE * np.array([1.0, 1e3, 1e6])
    found = albedo.directional_albedo(model, c, 0.3, rtol=1e-6)
    assert np.all(found.value > 0.0)
    assert np.all(found.error < 1e-5 * found.value)
    if name == "he_torrance":
        # It falls as a power of 1/ln(1/c).
        assert np.all(np.diff(found.value) > 0.0)
    else:
        steps = np.diff(np.log(found.value))
        # Three values, each with its error.
        assert abs(steps[1] - steps[0]) < 4e-5
    for wrong in (1e-61, 5e-324):
        with pytest.raises(InputError, match=r"is 0 or lies in \[1e-60, 1\]"):
            albedo.directional_albedo(model, wrong)
