"""Monte Carlo beside the quadrature: draws, densities, errors, and what it says of itself."""

from __future__ import annotations

import json
import math
import tracemalloc
from typing import Any

import cases
import numpy as np
import pytest
from scipy import stats
from typer.testing import CliRunner

import albedo
from albedo.brdf import Model
from albedo.charts.cosine import CosineChart
from albedo.charts.polar import PolarChart
from albedo.cli import app
from albedo.directions import spherical
from albedo.errors import ConvergenceWarning, DivergenceError, InputError
from albedo.integrators import monte_carlo
from albedo.integrators.adaptive import integrate
from albedo.sampling import routines
from albedo.sampling.mixture import STRATEGIES, Mixture, mixture_of
from albedo.sampling.routines import Routine

EPS = np.finfo(float).eps
moderate = pytest.mark.parametrize("model", cases.MODERATE, ids=lambda m: m.spec)
GGX = albedo.model("cook_torrance", m=0.3, distribution="ggx", geometry="smith")


def points(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return rng.random((*shape, 2))


@pytest.mark.parametrize(("n_u", "n_v"), [(100.0, 100.0), (10.0, 1000.0), (1e4, 0.5)])
def test_half_vectors_are_drawn_as_ashikhmin_and_shirley_print_it(
    n_u: float, n_v: float, rng: np.random.Generator
) -> None:
    """AS eqs. 21 and 22: one quadrant by the tangent, mirrored into the others."""
    u = points(rng, 500)
    u[:4] = [[0.5, 0.0], [0.5, 0.25], [0.5, 0.5], [0.5, 0.75]]
    model = albedo.model("ashikhmin_shirley", n_u=n_u, n_v=n_v)
    wo = model.sample(u, [0.0, 0.0, 1.0]).wo
    quadrant = np.floor(4.0 * u[:, 1])
    x = 4.0 * u[:, 1] - quadrant
    x = np.where(quadrant % 2 == 1, 1.0 - x, x)
    phi = np.arctan(math.sqrt((n_u + 1.0) / (n_v + 1.0)) * np.tan(0.5 * math.pi * x))
    phi = np.choose(quadrant.astype(int), [phi, math.pi - phi, math.pi + phi, -phi])
    n = n_u * np.cos(phi) ** 2 + n_v * np.sin(phi) ** 2
    theta_h = np.arccos((1.0 - u[:, 0]) ** (1.0 / (n + 1.0)))
    expected = spherical(np.cos(2.0 * theta_h), phi)
    # The arc cosine turns a rounding of the cosine into its root; ratios stretch the azimuth.
    np.testing.assert_allclose(wo, expected, atol=1e-7)


@moderate
def test_draws_are_directions_with_their_densities_and_weights(
    model: Model, rng: np.random.Generator
) -> None:
    if model.channels is not None:
        return
    wi = spherical([0.95, 0.5, 0.05], [0.3, 1.2, -2.0])
    wo, pdf, weight = model.sample(points(rng, 200, 3), wi)
    assert wo.shape == (200, 3, 3)
    assert pdf.shape == weight.shape == (200, 3)
    # Of a dozen roundings in each component; a slope of 1e8 squares them.
    np.testing.assert_allclose(np.linalg.norm(wo, axis=-1), 1.0, atol=1e-13)
    assert np.all(weight[wo[..., 2] <= 0.0] == 0.0)
    assert np.all(weight >= 0.0)
    assert np.all(np.isfinite(weight))
    finite = np.isfinite(pdf) & (wo[..., 2] > 0.0)
    light = np.broadcast_to(wi, wo.shape)[finite]
    # A half vector from raw directions loses digits next to the mirror direction, at the horizon
    # most; what a lobe makes of them grows as the exponent does.
    density = model.pdf(light, wo[finite])
    np.testing.assert_allclose(density, pdf[finite], rtol=1e-7)
    energy = model.eval(light, wo[finite]) * wo[..., 2][finite]
    np.testing.assert_allclose(weight[finite], energy / pdf[finite], rtol=1e-7, atol=1e-300)


ROUTINES = [
    (routines.COSINE, CosineChart()),
    (routines.UNIFORM, CosineChart()),
    (routines.gaussian_normals(0.3, 0.3), PolarChart("slope", decay="gaussian")),
    (routines.gaussian_normals(0.05, 0.4), PolarChart("slope", decay="gaussian")),
    (routines.ggx_normals(0.3, 0.3), PolarChart("slope")),
    (routines.ggx_normals(0.6, 0.1), PolarChart("slope")),
    (routines.visible_normals("ggx", 0.3, 0.3), PolarChart("slope")),
    (routines.visible_normals("ggx", 0.1, 0.7), PolarChart("slope")),
    (routines.visible_normals("beckmann", 0.3, 0.3), PolarChart("slope", decay="gaussian")),
    (routines.visible_normals("beckmann", 0.5, 0.1), PolarChart("slope", decay="gaussian")),
    (routines.normal_powers(30.0, 30.0), PolarChart("slope", decay="cosine_power", edge=2)),
    (routines.normal_powers(500.0, 10.0), PolarChart("slope", decay="cosine_power", edge=4)),
    (routines.mirror_power(0.0), PolarChart("mirror", decay="cosine_power", edge=4)),
    (routines.mirror_power(50.0), PolarChart("mirror", decay="cosine_power")),
    (routines.axis_power((-1.0, -1.0, 1.0), 50.0), PolarChart("mirror", decay="cosine_power")),
]


def widths_of(routine: Routine) -> tuple[float, float]:
    if routine.name.startswith("power of"):
        return (1.0 / math.sqrt(2.0 * max(routine.numbers[-1], 0.5)),) * 2
    if routine.name == "powers of n.h":
        return math.sqrt(2.0 / routine.numbers[0]), math.sqrt(2.0 / routine.numbers[1])
    return (routine.numbers[0], routine.numbers[1]) if routine.numbers else (1.0, 1.0)


@pytest.mark.parametrize(
    ("routine", "chart"), ROUTINES, ids=[f"{r.name} {r.numbers}" for r, _ in ROUTINES]
)
@pytest.mark.parametrize("cos_theta", [0.97, 0.4, 0.05])
def test_a_density_integrates_to_the_share_of_draws_above_the_horizon(
    routine: Routine, chart: Any, cos_theta: float, rng: np.random.Generator
) -> None:
    mixture, phi, count = Mixture((1.0,), (routine,)), 0.6, 40_000
    wi = spherical(cos_theta, phi).reshape(3, 1)

    def over_cosine(row: Any, light: Any, wo: np.ndarray, h: np.ndarray) -> np.ndarray:
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(wo[2] > 0.0, mixture.density(light, wo, h) / wo[2], 0.0)

    found = integrate(
        *(chart, over_cosine, np.array([cos_theta]), np.array([phi])),
        *(np.array([widths_of(routine)]), False),
        rtol=1e-6,
        atol=0.0,
        limit=400_000,
    )
    wo, _ = mixture.draw(wi, rng.random((2, 1, count)))
    above = float(np.mean(wo[2] > 0.0))
    # One in 5e5 of 45 tests: five standard errors of a share.
    spread = math.sqrt(max(above * (1.0 - above), 1.0 / count) / count)
    assert abs(found.value[0] - above) <= 5.0 * spread + found.error[0]


@pytest.mark.parametrize(
    "routine", [r for r, _ in ROUTINES], ids=[f"{r.name} {r.numbers}" for r, _ in ROUTINES]
)
def test_draws_fill_their_density(routine: Routine, rng: np.random.Generator) -> None:
    """Kolmogorov and Smirnov's distance of three coordinates of draws, against weighted ones.

    The reference are cosine and uniform draws, weighted with the density: no inverse is shared.
    """
    mixture, wi = Mixture((1.0,), (routine,)), spherical(0.6, 0.6).reshape(3, 1)
    own = mixture.draw(wi, rng.random((2, 1, 20_000)))[0][:, 0]
    own = own[:, own[2] > 0.0]
    other = Mixture((0.5, 0.5), (routines.COSINE, routines.UNIFORM))
    wo, h = other.draw(wi, rng.random((2, 1, 400_000)))
    weight = (mixture.density(wi, wo, h) / other.density(wi, wo, h))[0]
    effective = weight.sum() ** 2 / (weight @ weight)
    size = own.shape[1] * effective / (own.shape[1] + effective)
    for d in range(3):
        rank = np.argsort(wo[d, 0])
        share = np.cumsum(weight[rank]) / weight.sum()
        place = np.searchsorted(wo[d, 0][rank], np.sort(own[d]))
        reference = np.concatenate(([0.0], share))[place]
        distance = np.max(np.abs(reference - np.arange(own.shape[1]) / own.shape[1]))
        # 1 in 1e6 for each of 45: the asymptotic law at the smaller effective size.
        assert distance <= stats.kstwobign.isf(1e-6) / math.sqrt(size)


@pytest.mark.filterwarnings("ignore::albedo.ConvergenceWarning")
@pytest.mark.parametrize("strategy", ["model", "mixture"])
def test_monte_carlo_agrees_with_the_quadrature_as_often_as_it_says(strategy: str) -> None:
    """More than 1,000 cases each: three standard errors are exceeded by 0.27 percent of them."""
    cosines, phi = np.array([0.97, 0.8, 0.55, 0.3, 0.1]), np.array([0.3, 1.0, 0.0, 2.0, 4.0])
    scores = []
    for number, model in enumerate(m for m in cases.MODERATE if m.channels is None):
        exact = albedo.directional_albedo(model, cosines, phi, rtol=1e-6, atol=1e-12)
        found = albedo.monte_carlo_albedo(
            model, cosines, phi, samples=4096, strategy=strategy, seed=number
        )
        allowed = found.error + exact.error
        off = np.abs(found.value - exact.value) / np.maximum(allowed, 1e-300)
        scores += off[found.reliable].tolist()
    assert len(scores) >= 1000
    exceeded = int(np.sum(np.array(scores) > 3.0))
    # Fails for one correct program in 10,000.
    assert exceeded <= stats.binom.isf(1e-4, len(scores), 2.0 * stats.norm.sf(3.0))
    assert max(scores) <= stats.norm.isf(0.5e-4 / len(scores))


def test_a_strategy_that_misses_the_lobe_is_unreliable() -> None:
    sharp = albedo.model("ward", m=1e-3)
    for strategy, missed in (("cosine", True), ("uniform", True), ("model", False)):
        if missed:
            with pytest.warns(ConvergenceWarning, match="unreliable"):
                found = albedo.monte_carlo_albedo(sharp, 0.5, samples=1000, strategy=strategy)
            assert not found.reliable
            assert not found.converged
            assert "unreliable" in str(found)
        else:
            found = albedo.monte_carlo_albedo(sharp, 0.5, samples=1000, strategy=strategy)
            assert found.reliable
            assert "unreliable" not in str(found)
    # None of a thousand cosine draws hits a lobe of 1e-5. Their own spread is 0; the pilot knows
    # better: the variance is the mean of f n.v pi f, about (1e5)^2/4.
    with pytest.warns(ConvergenceWarning, match="unreliable"):
        lost = albedo.monte_carlo_albedo(
            albedo.model("ward", m=1e-5), 0.5, samples=1000, strategy="cosine"
        )
    assert lost.value < 1e-300
    assert lost.error > 1.0
    assert not lost.reliable


def test_rare_losses_count_before_they_are_drawn() -> None:
    """One visible normal in ten thousand loses its light; 4,096 draws may not hold one."""
    model = albedo.model("cook_torrance", m=0.1, geometry="smith")
    many = albedo.monte_carlo_albedo(model, 0.55, 2.0, samples=2**22)
    spread = float(many.error) * math.sqrt(2**22 / 4096)
    for seed in range(20):
        found = albedo.monte_carlo_albedo(model, 0.55, 2.0, samples=4096, seed=seed)
        # Half of the variance is the one that a few draws of the pilot tell; the own may be 0.
        assert 0.1 * spread < found.error < 5.0 * spread


def test_black_models_are_black_and_unknown_ones_unreliable_where_nothing_is_seen() -> None:
    assert albedo.monte_carlo_albedo(albedo.model("lambert", rho=0.0), 0.5, samples=500).reliable
    hidden = albedo.model_from(lambda wi, wo: np.where(wo[..., 2] > 1.0 - 1e-12, 1e9, 0.0))
    with pytest.warns(ConvergenceWarning, match="unreliable"):
        assert not albedo.monte_carlo_albedo(hidden, 0.5, samples=500).reliable


@pytest.mark.parametrize("sequence", monte_carlo.SEQUENCES)
def test_the_seed_gives_the_bits_whatever_the_threads(sequence: str) -> None:
    kept = [
        albedo.monte_carlo_albedo(
            GGX, [0.9, 0.3], samples=150_000, sequence=sequence, seed=seed, threads=threads
        )
        for seed, threads in ((3, 1), (3, 2), (3, 5), (4, 1))
    ]
    for other in kept[1:3]:
        np.testing.assert_array_equal(kept[0].value, other.value)
        np.testing.assert_array_equal(kept[0].error, other.error)
    assert np.all(kept[0].value != kept[3].value)


def test_strata_and_scrambled_points_have_smaller_errors() -> None:
    """Their rates are better than the -1/2 of independent points, and so they say."""
    exact = albedo.directional_albedo(GGX, 0.6).value
    sizes = 2 ** np.arange(12, 21, 2)
    slopes = {}
    for sequence in monte_carlo.SEQUENCES:
        found = [
            albedo.monte_carlo_albedo(GGX, 0.6, samples=int(n), sequence=sequence, seed=1)
            for n in sizes
        ]
        for one in found:
            # With 32 sets an error is known to 13 percent: Student's law at 1 in 1e5.
            assert abs(one.value - exact) <= stats.t.isf(0.5e-5, 31) * one.error
        errors = np.array([float(one.error) for one in found])
        slopes[sequence] = np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    # Four decades of draws, errors known to 13 percent each: slopes to 0.05.
    assert slopes["random"] == pytest.approx(-0.5, abs=0.1)
    assert slopes["stratified"] < -0.65
    assert slopes["sobol"] < -0.75


def test_drawing_stops_at_the_tolerance_or_at_the_budget_and_says_which() -> None:
    found = albedo.monte_carlo_albedo(GGX, [0.9, 0.2], rtol=1e-3)
    assert np.all(found.error <= 1e-3 * found.value)
    assert np.all(found.stopped == "rtol")
    assert np.all(found.converged)
    with pytest.warns(ConvergenceWarning, match="2 of 2 values missed rtol=1e-06"):
        short = albedo.monte_carlo_albedo(GGX, [0.9, 0.2], rtol=1e-6, samples=50_000)
    assert np.all(short.evaluations == 50_000)
    assert np.all(short.stopped == "samples")
    assert not np.any(short.converged)
    quick = albedo.monte_carlo_albedo(GGX, 0.6, rtol=1e-4, sequence="sobol")
    assert quick.error <= 1e-4 * quick.value
    slow = albedo.monte_carlo_albedo(GGX, 0.6, rtol=1e-3, sequence="stratified")
    assert slow.error <= 1e-3 * slow.value


def test_memory_does_not_grow_with_the_draws() -> None:
    def peak(samples: int) -> int:
        tracemalloc.start()
        albedo.monte_carlo_albedo(albedo.model("lambert"), 0.5, samples=samples, threads=2)
        size = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return size

    peak(10_000)
    # Blocks of 2^15 draws of a dozen numbers, two at a time, and what waits for its turn.
    assert peak(4_000_000) <= 2 * peak(400_000) + 2**21


def test_the_view_may_be_held() -> None:
    model = albedo.model("phong_original", n=30.0)
    for fixed in ("light", "view"):
        exact = albedo.directional_albedo(model, [0.9, 0.3], fixed=fixed)
        found = albedo.monte_carlo_albedo(model, [0.9, 0.3], samples=2**16, fixed=fixed, seed=2)
        assert np.all(np.abs(found.value - exact.value) <= 4.5 * found.error + exact.error)


def test_dirac_parts_are_events_of_a_sample_and_known_in_an_albedo(
    rng: np.random.Generator,
) -> None:
    model = albedo.model("he_torrance", sigma0=0.03, tau=1.0)
    wi = spherical(0.5, 0.4)
    energy = float(model.spikes(wi[None])[1].sum())
    wo, pdf, weight = model.sample(points(rng, 20_000), wi)
    hit = np.isinf(pdf)
    np.testing.assert_allclose(wo[hit], np.tile(wi * [-1.0, -1.0, 1.0], (hit.sum(), 1)))
    share = float(hit.mean())
    assert abs(weight[hit].mean() * share - energy) <= 5.0 * energy * math.sqrt(
        (1.0 - share) / share / hit.size
    )
    exact = albedo.directional_albedo(model, 0.5, 0.4)
    spread = weight.std() / math.sqrt(weight.size)
    assert abs(weight.mean() - exact.value) <= 5.0 * spread
    found = albedo.monte_carlo_albedo(model, 0.5, 0.4, samples=20_000)
    assert abs(found.value - exact.value) <= 5.0 * found.error
    # No chance decides there between the mirror and the rest.
    assert found.error < spread
    grating = albedo.model("stam_grating")
    orders = grating.sample(points(rng, 500), spherical(0.8, 0.0))
    assert np.all(np.isinf(orders.pdf))
    assert orders.weight.mean() == pytest.approx(
        float(albedo.directional_albedo(grating, 0.8).value), rel=1e-12
    )
    assert albedo.monte_carlo_albedo(grating, 0.8, samples=100).evaluations == 0


def test_channels_are_estimated_one_by_one() -> None:
    colored = albedo.model("schlick", color=(0.9, 0.5, 0.1))
    found = albedo.monte_carlo_albedo(colored, [0.5, 0.7], samples=2**14)
    exact = albedo.directional_albedo(colored, [0.5, 0.7])
    assert found.value.shape == (3, 2)
    assert np.all(np.abs(found.value - exact.value) <= 4.5 * found.error)
    with pytest.raises(InputError, match="has 3 channels; sample one"):
        colored.sample([0.5, 0.5], [0.0, 0.0, 1.0])


def test_sums_and_functions_are_sampled_too() -> None:
    both = albedo.model("ward", m=0.1) + 0.3 * albedo.model("lambert")
    dusty = albedo.model_from(
        lambda wi, wo: 0.25 / np.pi / (wi[..., 2] + wo[..., 2]), lobe="diffuse"
    )
    for model in (both, dusty):
        exact = albedo.directional_albedo(model, 0.4, rtol=1e-6)
        found = albedo.monte_carlo_albedo(model, 0.4, samples=2**15, seed=9)
        assert abs(found.value - exact.value) <= 4.5 * found.error


def test_a_mixture_keeps_strata(rng: np.random.Generator) -> None:
    """The coordinate that chooses a routine is stretched again: points stay evenly spread."""
    mixture = mixture_of(albedo.model("ward", m=0.1), "mixture")
    assert sum(mixture.shares) == pytest.approx(1.0, abs=4 * EPS)
    assert mixture.routines[-1] is routines.COSINE
    u = np.stack(((np.arange(1000) + 0.5) / 1000, rng.random(1000))).reshape(2, 1, -1)
    wo, _ = mixture.draw(spherical(0.5).reshape(3, 1), u)
    # In the second half, u_0 from 0.5 to 1 is u from 0 to 1 of the cosine: v.z = sqrt(1 - u).
    expected = np.sqrt(1.0 - (2.0 * u[0, 0, 500:] - 1.0))
    np.testing.assert_allclose(wo[2, 0, 500:], expected, rtol=1e-12)


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_strategies_agree(strategy: str) -> None:
    model = albedo.model("oren_nayar", sigma=0.5)
    exact = albedo.directional_albedo(model, 0.3, 1.0)
    found = albedo.monte_carlo_albedo(model, 0.3, 1.0, samples=2**15, strategy=strategy, seed=6)
    assert found.reliable
    assert abs(found.value - exact.value) <= 4.5 * found.error


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"samples": 1}, "samples = 1 is out of range"),
        ({"samples": 10.5}, "samples = 10.5 is out of range"),
        ({"samples": 40, "sequence": "sobol"}, "samples = 40 is too few for 32 sets"),
        ({"rtol": 0.0}, "rtol = 0.0 is out of range"),
        ({"seed": -1}, "seed = -1 is out of range"),
        ({"strategy": "best"}, "strategy = 'best' is unknown"),
        ({"sequence": "halton"}, "sequence = 'halton' is unknown"),
        ({"fixed": "both"}, "fixed = 'both' is unknown"),
        ({"threads": 0}, "threads = 0 is out of range"),
        ({"cos_theta": 1.5}, "cos_theta = 1.5 is out of range"),
    ],
)
def test_bad_input_is_named(arguments: dict[str, Any], message: str) -> None:
    arguments = {"cos_theta": 0.5, **arguments}
    with pytest.raises(InputError, match=message):
        albedo.monte_carlo_albedo(GGX, **arguments)


def test_directions_and_points_are_checked() -> None:
    with pytest.raises(DivergenceError, match="no directions to draw"):
        albedo.monte_carlo_albedo(GGX, 0.0)
    up = [0.0, 0.0, 1.0]
    for u, wi, message in (
        ([0.5, 1.0], up, "points lie in"),
        ([0.5, 0.5, 0.5], up, r"points have shape \(..., 2\)"),
        ([[0.5, 0.5]] * 2, [up] * 3, "do not broadcast"),
        ([0.5, 0.5], [0.0, 0.0, -1.0], "not above the horizon"),
    ):
        with pytest.raises(InputError, match=message):
            GGX.sample(u, wi)
    with pytest.raises(InputError, match="do not broadcast"):
        GGX.pdf([up] * 2, [up] * 3)
    with pytest.raises(InputError, match="not above the horizon"):
        GGX.pdf([0.0, 0.0, -1.0], up)


def test_the_command_line_draws_as_the_function_does() -> None:
    line = "eval ward:m=0.1 --theta 60 --method mc --samples 1e4 --sequence sobol --seed 7 --json"
    run = CliRunner().invoke(app, line.split())
    assert run.exit_code == 0, run.output
    (row,) = json.loads(run.stdout)
    found = albedo.monte_carlo_albedo(
        albedo.model("ward", m=0.1),
        math.cos(math.radians(60.0)),
        samples=10_000,
        sequence="sobol",
        seed=7,
    )
    assert row["value"] == pytest.approx(float(found.value), rel=1e-12)
    assert row["kind"] == "standard_error"
    assert row["reliable"] is True


def test_draws_are_reported_as_they_are_made() -> None:
    told: list[int] = []
    for sequence in monte_carlo.SEQUENCES:
        told.clear()
        found = albedo.monte_carlo_albedo(
            GGX, [0.5, 0.9], samples=100_000, sequence=sequence, threads=2, progress=told.append
        )
        assert len(told) > 4
        assert sum(told) == int(found.evaluations.sum())


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("eval ward --samples 100", "--samples needs --method mc"),
        ("eval ward --seed 1", "--seed needs --method mc"),
        ("eval ward --method mc --samples 2.5", "--samples 2.5 is out of range"),
        ("eval ward --method dice", "--method dice is unknown"),
        ("eval ward --method mc --average", "--average is computed by quadrature"),
        ("eval ward --method mc --strategy best", "strategy = 'best' is unknown"),
        ("eval ward --method mc --cos 0", "no directions to draw"),
    ],
)
def test_the_command_line_names_what_does_not_fit(line: str, message: str) -> None:
    run = CliRunner().invoke(app, line.split())
    assert run.exit_code == 2
    assert message in run.stderr
    assert not run.stdout
