"""Pumping-up against closed forms, another discretisation, and what it promises."""

from __future__ import annotations

import math

import numpy as np
import pytest
from steps import nystrom

import albedo
from albedo.brdf import Model
from albedo.charts.heights import folded, unfolded
from albedo.directions import spherical
from albedo.errors import InputError
from albedo.grammar import parse
from albedo.operators.divisor import CONTROLS, Divisor
from albedo.operators.pump import Pumped

EPS = np.finfo(float).eps
PHONG = albedo.model("phong", n=20)
WARD = albedo.model("ward", m=0.4)
GGX = albedo.model("cook_torrance", m=0.3, distribution="ggx", geometry="smith_correlated")
UNKNOWN = albedo.model_from(lambda wi, wo: np.full(wo.shape[:-1], 0.1), reciprocal=True)
COSINES = np.array([1.0, 0.9, 0.5, 0.2, 0.05, 1e-3, 1e-6])
# A base and a control with which its steps stay cheap.
CASES = [
    (PHONG, None, 3),
    (PHONG, "literal", 2),
    (PHONG, "cumulative", 3),
    (albedo.model("blinn", n=20), "cumulative", 2),
    (WARD, None, 2),
    (GGX, None, 3),
    (albedo.model("oren_nayar"), None, 2),
    (albedo.model("ashikhmin_shirley", n=100, r_s=0.5, r_d=0.5), None, 2),
    (albedo.model("lafortune", lobes=((0.9, 0.9, 0.9, 10.0),), rho_d=0.2), "literal", 2),
    (albedo.model("lafortune_scaled", n=20, s=0.95), "cumulative", 2),
]
cases = pytest.mark.parametrize(
    ("base", "control", "steps"), CASES, ids=lambda x: getattr(x, "spec", str(x))
)


def test_lambert_becomes_white() -> None:
    """f = rho/pi has the albedo rho everywhere: one step makes it 1, and later ones nothing."""
    for steps in (1, 3):
        found = albedo.directional_albedo(
            albedo.pump(albedo.model("lambert", rho=0.3), steps), COSINES
        )
        assert np.all(np.abs(found.value - 1.0) <= found.error)
        assert np.all(found.error <= 1e-8)
    white = albedo.pump(albedo.model("lambert"), 1)
    wi, wo = spherical(0.3, 0.1), spherical(0.8, 2.0)
    assert abs(white.eval(wi, wo) - 1.0 / math.pi) <= 1e-12


def test_no_step_changes_nothing() -> None:
    found = albedo.directional_albedo(albedo.pump(WARD, 0), COSINES)
    own = albedo.directional_albedo(WARD, COSINES)
    assert np.all(np.abs(found.value - own.value) <= found.error + own.error)


@cases
def test_steps_agree_with_another_method(base: Model, control: str | None, steps: int) -> None:
    """Nystroem's method over Gauss points in theta, whose kinks make it of second order."""
    for k in range(1, steps + 1):
        misses = []
        for size in (48, 96):
            c, value = nystrom(base, control, k, size)
            inside = (c > 0.15) & (c < 0.99)
            found = albedo.directional_albedo(albedo.pump(base, k, control), c[inside])
            misses.append(float(np.max(np.abs(value[inside] - found.value))))
        # A kink on the diagonal makes it of second order: it comes four times as close, or a little
        # less where other kinks fall between the points.
        assert misses[0] <= 3.0 / 48**2
        assert misses[1] <= 0.3 * misses[0]


@pytest.mark.parametrize("control", CONTROLS)
@pytest.mark.parametrize(
    "base",
    [
        PHONG,
        albedo.model("blinn", n=20),
        pytest.param(WARD, marks=pytest.mark.slow),
        pytest.param(GGX, marks=pytest.mark.slow),
    ],
    ids=lambda x: x.name,
)
def test_deep_steps_agree_with_another_method(base: Model, control: str | None) -> None:
    """The same after twenty steps, towards grazing incidence as well."""
    misses = []
    for size in (64, 128):
        c, value = nystrom(base, control, 20, size)
        inside = c > 0.03
        found = albedo.directional_albedo(albedo.pump(base, 20, control), c[inside])
        misses.append(float(np.max(np.abs(value[inside] - found.value))))
    # Kinks have moved to where a grid has few points: what they leave falls by two to four.
    assert misses[0] <= 5.0 / 64**2
    assert misses[1] <= 0.5 * misses[0]


@cases
def test_bounds_hold_and_are_small(base: Model, control: str | None, steps: int) -> None:
    """Curves of 1e-6 against such of 1e-10: errors of early steps are in the late bounds."""
    rough = albedo.pump(base, steps, control, rtol=1e-6)
    exact = albedo.pump(base, steps, control, rtol=1e-10)
    found = albedo.directional_albedo(rough, COSINES, rtol=1e-5)
    known = albedo.directional_albedo(exact, COSINES, rtol=1e-9)
    assert known.converged.all()
    assert np.all(np.abs(found.value - known.value) <= found.error + known.error)
    assert np.all(found.error <= 1e-4 * found.value)


@cases
def test_curves_are_albedos_of_the_steps(
    base: Model, control: str | None, steps: int, rng: np.random.Generator
) -> None:
    """Sums over rings against the integral of the whole, at many heights: none may miss a kink."""
    cosines = np.concatenate((COSINES, np.sin(rng.uniform(0.0, 0.5 * math.pi, 150))))
    curves = albedo.pump(base, steps, control).albedos
    assert len(curves) == steps
    for k, curve in enumerate(curves):
        found = albedo.directional_albedo(albedo.pump(base, k, control), cosines, rtol=1e-8)
        error = curve.error[curve.piece(folded(cosines))] * found.value
        assert np.all(np.abs(curve(cosines) - found.value) <= found.error + error)


@cases
def test_light_is_gained_and_none_is_made(base: Model, control: str | None, steps: int) -> None:
    """a <= a* <= 1 (NNS eq. 19); where a base makes light its first step takes it back."""
    before = albedo.directional_albedo(base, COSINES)
    for k in range(1, steps + 1):
        after = albedo.directional_albedo(albedo.pump(base, k, control), COSINES)
        assert after.converged.all()
        assert np.all(after.value <= 1.0 + after.error)
        if np.all(before.value <= 1.0 + before.error):
            assert np.all(after.value >= before.value - before.error - after.error)
        before = after


@cases
def test_values_are_reciprocal(
    base: Model, control: str | None, steps: int, rng: np.random.Generator
) -> None:
    model = albedo.pump(base, steps, control)
    wi, wo = (spherical(rng.uniform(1e-3, 1, 200), rng.uniform(-3, 3, 200)) for _ in range(2))
    here, there = model.eval(wi, wo), model.eval(wo, wi)
    # Exact but for the base, which loses a few digits where half vectors of raw directions do.
    logs = model.divisor.logs(wi[:, 2], wo[:, 2])
    np.testing.assert_allclose(here * np.exp(logs), base.eval(wi, wo), rtol=1e-13)
    np.testing.assert_allclose(there * np.exp(logs), base.eval(wo, wi), rtol=1e-13)
    np.testing.assert_allclose(model.divisor.logs(wo[:, 2], wi[:, 2]), logs, rtol=0, atol=1e-15)


def test_the_divisor_is_one_table_where_all_albedos_rise() -> None:
    curves = list(albedo.pump(PHONG, 3).albedos)
    one, each = Divisor(curves, None), Divisor(curves, "literal")
    assert one.collapsed
    assert not each.collapsed
    c = unfolded(np.linspace(-20.0, 1.0, 50))
    # Phong's albedo is never below the cosine, so both divide by the same.
    sums = sum(np.maximum(curve.at(folded(c)), curve.at(folded(c[::-1]))) for curve in curves)
    # One table and each curve are read as polynomials that leave something out.
    slack = 1e-13 + one.left_out + sum(curve.polynomials.left_out.max() for curve in curves)
    np.testing.assert_allclose(one.logs(c, c[::-1].copy()), sums, rtol=0, atol=slack)
    np.testing.assert_allclose(each.logs(c, c[::-1].copy()), sums, rtol=0, atol=1e-11)
    assert one.levels(c).shape == (50, 0)


def test_equal_albedos_are_kinks() -> None:
    """Ward's has a minimum inside: every height but few has another one with the same albedo."""
    model = albedo.pump(WARD, 1)
    (curve,) = model.albedos
    c = np.array([0.9, 0.5, 0.2, 0.1])
    levels = model.divisor.levels(c)
    equal = np.abs(curve(levels) / curve(c)[:, None] - 1.0) < 1e-12
    assert np.all(equal.sum(1) == 1)
    assert np.all(np.abs(levels - c[:, None])[equal] > 1e-3)
    # The others are bends of the curve, where it is what is divided by.
    others = np.isfinite(levels) & ~equal
    assert np.all(np.isin(folded(levels[others]), curve.bends))
    assert np.all((curve(levels) > curve(c)[:, None])[others])


def test_dirac_parts_are_divided() -> None:
    base = albedo.model("schlick", form="final", roughness=0.1)
    model = albedo.pump(base, 1)
    wi = spherical(np.array([0.9, 0.1]), 0.2)
    weights, known = model.spikes(wi)[1][0], base.spikes(wi)[1][0]
    (curve,) = model.albedos
    # Eight roundings and the curve's own.
    np.testing.assert_allclose(weights, known / curve(wi[:, 2]), rtol=1e-13)
    found = albedo.directional_albedo(model, COSINES)
    assert found.converged.all()
    assert np.all(found.value <= 1.0 + found.error)
    assert "mirror" in found.parts


def test_what_is_pumped_is_a_model_like_any_other() -> None:
    model = albedo.pump(PHONG, 2)
    assert model.spec.startswith("pump(phong:n=20")
    assert model == albedo.pump(albedo.model("phong", n=20), 2)
    assert model != albedo.pump(PHONG, 3)
    cosines = np.array([0.9, 0.3])
    exact = albedo.directional_albedo(model, cosines)
    drawn = albedo.monte_carlo_albedo(model, cosines, samples=2**16, sequence="sobol", seed=3)
    assert np.all(np.abs(drawn.value - exact.value) <= 5.0 * drawn.error)
    table = albedo.table(model, cosines, sweep={"n": [10.0, 20.0]})
    assert np.all(np.abs(table["value"].values[1] - exact.value) <= 2.0 * exact.error)
    seen = albedo.directional_albedo(model, cosines, fixed="view")
    assert np.all(np.abs(seen.value - exact.value) <= seen.error + exact.error)
    # The inner divisor errs, and the outer one with it: it has to be better than by default.
    nested = Pumped(albedo.pump(PHONG, 1, rtol=1e-10), 1, None, None)
    twice = albedo.directional_albedo(nested, cosines)
    assert np.all(np.abs(twice.value - exact.value) <= twice.error + exact.error)


def test_steps_upon_steps_are_one_operator() -> None:
    assert albedo.pump(albedo.pump(PHONG, 2), 3) == albedo.pump(PHONG, 5)
    literal = albedo.pump(albedo.pump(PHONG, 2, "literal", goal=1e-9), 3, "literal")
    assert literal == albedo.pump(PHONG, 5, "literal", goal=1e-9)
    for first, last in ((None, "literal"), ("literal", None), ("cumulative", "cumulative")):
        again = albedo.pump(albedo.pump(PHONG, 1, first), 1, last)
        assert again.base == albedo.pump(PHONG, 1, first)
    # No step keeps nothing.
    assert albedo.pump(albedo.pump(PHONG, 0), 2, "cumulative") == albedo.pump(
        PHONG, 2, "cumulative"
    )
    assert albedo.pump(PHONG, np.int64(2)) == albedo.pump(PHONG, 2)


@pytest.mark.parametrize(("steps", "goal"), [(5, 1e-10), (20, 1e-10), (20, 1e-5)])
@pytest.mark.parametrize("control", CONTROLS)
def test_a_goal_is_met(control: str | None, steps: int, goal: float) -> None:
    model = albedo.pump(PHONG, steps, control, goal=goal)
    c = np.array([1.0, 0.7, 0.3, 0.03, 1e-3, 1e-6])
    found = albedo.directional_albedo(model, c, rtol=goal)
    assert np.all(found.converged)
    assert np.all(found.error <= goal * found.value)
    other = albedo.directional_albedo(albedo.pump(PHONG, steps, control), c)
    assert np.all(np.abs(found.value - other.value) <= found.error + other.error)


@pytest.mark.parametrize(
    ("n", "control", "steps"), [(64.96, None, 19), (249.5, "literal", 19)], ids=str
)
def test_ten_digits_are_met_where_steps_lift_what_is_dark(
    n: float, control: str | None, steps: int
) -> None:
    """Panels whose dark ends steps divide by a millionth: bounds had been 1.2e-10 and 1.8e-10."""
    model = albedo.pump(albedo.model("blinn", n=n), steps, control, goal=1e-10)
    c = np.concatenate((np.geomspace(1e-6, 0.05, 12), np.linspace(0.07, 1.0, 14)))
    found = albedo.directional_albedo(model, c, rtol=1e-10)
    assert np.all(found.converged)
    assert np.all(found.error <= 1e-10 * found.value)
    other = albedo.directional_albedo(albedo.pump(model.base, steps, control), c)
    assert np.all(np.abs(found.value - other.value) <= found.error + other.error)


@pytest.mark.parametrize("spec", ["ward:m=1e-6", "phong:n=1e8", "cook_torrance:m=1e-5"])
def test_ten_digits_are_met_by_the_narrowest_lobes(spec: str) -> None:
    """Rings near the normal had been too noisy for less than 1e-10 to 2e-9."""
    model = albedo.pump(parse(spec).model(), 3, goal=1e-10)
    c = np.concatenate((np.geomspace(1e-6, 0.05, 6), np.linspace(0.07, 1.0, 6)))
    found = albedo.directional_albedo(model, c, rtol=1e-10)
    assert np.all(found.converged)
    assert np.all(found.error <= 1e-10 * found.value)


@pytest.mark.slow
def test_ten_digits_are_met_where_a_row_has_hundreds_of_panels() -> None:
    """400,000 evaluations had left 1.6e-8 of it at cosines from 0.2 to 0.5."""
    base = albedo.model("ashikhmin_shirley", n_u=52.05, n_v=52.05, r_s=0.2885, r_d=0.8515)
    c = np.linspace(0.07, 1.0, 14)[2:7]
    found = albedo.directional_albedo(
        albedo.pump(base, 15, "cumulative", goal=1e-10), c, rtol=1e-10
    )
    assert np.all(found.converged)
    assert np.all(found.error <= 1e-10 * found.value)
    other = albedo.directional_albedo(albedo.pump(base, 15, "cumulative"), c)
    assert np.all(np.abs(found.value - other.value) <= found.error + other.error)


def test_albedos_of_steps_are_told_over_azimuths() -> None:
    base = albedo.model("ward", alpha_x=0.4, alpha_y=0.2)
    model = albedo.pump(base, 1, goal=1e-3)
    c, phi = np.array([0.8, 0.3]), np.array([0.2, 1.1])
    for k, stage in enumerate((base, model)):
        found = model.albedo_before(k, c, phi)
        known = albedo.directional_albedo(stage, c, phi, rtol=1e-3)
        assert np.all(np.abs(found.value - known.value) <= found.error + known.error)
        assert np.all(found.error <= 1e-3 * found.value)


def test_a_dark_model_is_refused() -> None:
    with pytest.raises(InputError, match="not above 0"):
        albedo.directional_albedo(albedo.pump(albedo.model("lambert", rho=0.0)), 0.5)


def test_what_the_base_is_worth_is_in_the_bound() -> None:
    """A base whose numbers err by a part in a million makes a divisor that does."""
    rough = Pumped(albedo.pump(PHONG, 1, rtol=1e-6), 1, None, None)
    found = albedo.directional_albedo(rough, COSINES, rtol=1e-4)
    inner = rough.base.parts()[0].doubt(None)
    assert inner > 1e-9
    assert rough.parts()[0].doubt(None) > 2.0 * inner
    known = albedo.directional_albedo(albedo.pump(PHONG, 2), COSINES)
    assert np.all(np.abs(found.value - known.value) <= found.error + known.error)


def test_no_step_promises_no_more_than_the_base() -> None:
    assert not albedo.pump(WARD, 0).conserves_energy
    assert albedo.pump(WARD, 1).conserves_energy


def test_tables_end_where_the_albedo_has_no_limit() -> None:
    """Ward's grows without bound: below 5e-20 nothing is known of what it is divided by."""
    with pytest.raises(albedo.DivergenceError):
        albedo.directional_albedo(albedo.pump(WARD, 1), 0.0)
    with pytest.warns(albedo.ConvergenceWarning):
        found = albedo.directional_albedo(albedo.pump(WARD, 1), 1e-21)
    assert found.error == np.inf


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: albedo.pump("phong"), "needs a model, not str"),
        (lambda: albedo.pump(albedo.model("phong_original")), "not symmetric"),
        (lambda: albedo.pump(PHONG, -1), "steps = -1"),
        (lambda: albedo.pump(PHONG, 2.0), "steps = 2.0"),
        (lambda: albedo.pump(PHONG, True), "steps = True"),
        (lambda: albedo.pump(PHONG, 1, "soft"), "control = 'soft'"),
        (lambda: albedo.pump(PHONG, rtol=0.0), "rtol = 0.0"),
        (lambda: albedo.pump(PHONG, rtol="fine"), "rtol = 'fine'"),
        (lambda: albedo.pump(PHONG, goal=[1e-8]), "goal = "),
        (lambda: albedo.pump(UNKNOWN), "nothing is declared"),
    ],
)
def test_bad_input(make: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make()  # type: ignore[operator]


# Their albedos jump where orders pass the horizon and where cylinders hide each other: no series
# follows that, and bounds say so.
JUMPS = ("poulin_fournier", "stam_grating")
SYMMETRIC = [name for name in albedo.models() if albedo.model(name).reciprocal]
RINGS = [name for name in SYMMETRIC if albedo.model(name).isotropic and name not in JUMPS]


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in SYMMETRIC if name not in JUMPS])
def test_no_step_makes_light_of_any_model(name: str) -> None:
    """a* <= 1 for every symmetric model, whatever its albedo was (NNS sect. 3)."""
    model = albedo.pump(albedo.model(name), 1)
    found = albedo.directional_albedo(model, COSINES[:-1], 0.4, rtol=model.usual_rtol)
    assert np.all(found.value <= 1.0 + found.error)
    assert np.all(found.error <= 1e-2 * found.value)


@pytest.mark.slow
@pytest.mark.parametrize("control", CONTROLS)
@pytest.mark.parametrize("name", RINGS)
def test_none_of_many_steps_makes_light_of_any_model(name: str, control: str | None) -> None:
    """Nor is less reflected than before, once the first step has taken back what was made."""
    model = albedo.pump(albedo.model(name), 13, control)
    last = None
    for k in range(1, 13):
        found = model.albedo_before(k, COSINES)
        assert np.all(found.value <= 1.0 + found.error)
        assert np.all(found.error <= 1e-8 * found.value)
        if last is not None:
            assert np.all(found.value >= last.value - last.error - found.error)
        last = found


@pytest.mark.slow
@pytest.mark.parametrize("name", JUMPS)
def test_albedos_that_jump_have_wide_bounds(name: str) -> None:
    model = albedo.pump(albedo.model(name), 1)
    with pytest.warns(albedo.ConvergenceWarning):
        found = albedo.directional_albedo(model, COSINES[:-1], 0.4, rtol=model.usual_rtol)
    assert np.all(found.error > 0.1 * found.value)


@cases
def test_albedos_of_steps_are_had_without_integrals(
    base: Model, control: str | None, steps: int
) -> None:
    model = albedo.pump(base, steps + 1, control)
    for k in range(steps + 1):
        read = model.albedo_before(k, COSINES)
        known = albedo.directional_albedo(albedo.pump(base, k, control), COSINES)
        assert np.all(np.abs(read.value - known.value) <= read.error + known.error)
        assert np.all(read.error <= 1e-8 * read.value)
    with pytest.raises(InputError, match="step = "):
        model.albedo_before(steps + 2, COSINES)
    own = model.albedo_before(steps + 1, COSINES)
    known = albedo.directional_albedo(model, COSINES)
    assert np.all(np.abs(own.value - known.value) <= own.error + known.error)
    with pytest.raises(InputError, match="cos_theta must lie"):
        model.albedo_before(0, np.array([0.0]))


def test_curves_are_made_better_where_steps_leave_too_much_of_an_albedo() -> None:
    """Next to the normal a product of twenty albedos and the cosine are both 1."""
    few, many = (albedo.pump(PHONG, steps, "cumulative") for steps in (5, 20))
    found = albedo.directional_albedo(many, [1.0, 1.0 - 1e-5, 0.3, 1e-6])
    assert found.converged.all()
    assert many._ladder.rtol < few._ladder.rtol
    # What is asked for is what is had.
    assert albedo.pump(PHONG, 20, "cumulative", rtol=1e-6)._ladder.rtol == 1e-6


def test_values_carry_what_the_worst_pair_of_heights_does_and_albedos_their_average() -> None:
    model = albedo.pump(PHONG, 5, rtol=1e-6)
    (part,) = model.parts()
    cosines = np.geomspace(1e-9, 1.0, 50)
    assert part.average_doubt is not None
    averages = part.average_doubt(cosines, np.zeros(50))
    assert np.all(averages <= 0.6 * part.doubt(None))
    np.testing.assert_array_equal(averages, model.sum_doubt(cosines, np.zeros(50)))
    # The albedo before the last step errs by its own curve and by the average of those before.
    before = model.albedo_before(4, cosines)
    assert np.all(before.error <= 2.0 * (model._ladder.average(4, cosines) + 1e-6) * before.value)
    assert albedo.pump(PHONG, 0).sum_doubt(cosines, np.zeros(50)) is None
