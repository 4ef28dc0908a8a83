"""Albedos by quadrature: closed forms, second parametrisations, limits, complements, tables."""

from __future__ import annotations

import math
import warnings

import exact
import numpy as np
import pytest
from scipy import integrate as scipy_integrate

import albedo
from albedo.brdf import Model
from albedo.charts.cosine import CosineChart
from albedo.charts.polar import PolarChart
from albedo.charts.scan import ScanChart
from albedo.directions import spherical
from albedo.estimate import format_value
from albedo.integrators.adaptive import integrate

ggx_1 = albedo.model("cook_torrance", m=1.0, distribution="ggx", geometry="smith_correlated")


def through(
    chart: object, model: Model, cos_theta: float, rtol: float = 1e-9
) -> tuple[float, float]:
    """The albedo of the first part of a model through a chart that is not its own."""
    part, p = model.parts()[0], np.array(model.pack())

    def integrand(row: np.ndarray, wi: np.ndarray, wo: np.ndarray, h: np.ndarray) -> np.ndarray:
        out = np.empty(wo.shape[1:])
        part.fill(wi, wo, h, np.tile(p, (row.size, 1)), out)
        return out

    result = integrate(
        chart,  # type: ignore[arg-type]
        integrand,
        *(np.array([cos_theta]), np.zeros(1), np.array([part.widths]), model.isotropic),
        rtol=rtol,
        atol=0.0,
        limit=4_000_000,
    )
    return float(result.value[0]), float(result.error[0])


@pytest.mark.parametrize("cos_theta", [1.0, 0.6, 0.05])
@pytest.mark.parametrize(
    "spec",
    [
        ("cook_torrance", {"m": 0.4, "geometry": "smith"}),
        ("cook_torrance", {"m": 0.5, "distribution": "ggx", "geometry": "smith_correlated"}),
        ("blinn", {"n": 12.0}),
        ("ward_bounded", {"m": 0.4}),
    ],
)
def test_charts_agree(spec: tuple[str, dict[str, object]], cos_theta: float) -> None:
    model = albedo.model(spec[0], **spec[1])
    own, own_error = through(model.parts()[0].chart, model, cos_theta)
    for chart in (
        PolarChart("mirror_hemisphere"),
        PolarChart("retro_hemisphere"),
        CosineChart("max"),
        ScanChart(0.1),
    ):
        other, other_error = through(chart, model, cos_theta, rtol=1e-7)
        assert abs(own - other) <= own_error + other_error, chart


@pytest.mark.parametrize("name", ["phong", "max_phong", "blinn", "ward", "ashikhmin_shirley"])
def test_scipy_agrees_on_wide_lobes(name: str) -> None:
    kinds = {"ward": {"m": 0.5}, "ashikhmin_shirley": {"n": 4.0}}
    model = albedo.model(name, **kinds.get(name, {"n": 4.0}))
    wi = spherical(0.6)

    def integrand(mu: float, phi: float) -> float:
        return float(model.eval(wi, spherical(mu, phi))) * mu

    # Kinks and roots at the horizon keep the general method at its tolerance.
    value, error = scipy_integrate.dblquad(integrand, 0.0, math.pi, 0.0, 1.0, epsabs=1e-5, epsrel=0)
    found = albedo.directional_albedo(model, 0.6)
    assert abs(2.0 * value - found.value) <= 2.0 * error + 2e-5 + found.error


def test_closed_forms() -> None:
    mu = np.array([1.0, 0.7, 0.1, 1e-3, 1e-6])
    found = albedo.directional_albedo(ggx_1, mu)
    assert np.all(np.abs(found.value - [exact.ggx_alpha_1(m) for m in mu]) <= found.error)
    average = albedo.average_albedo(ggx_1)
    assert abs(average.value - 4.0 / 3.0 * (1.0 - math.log(2.0))) <= average.error
    for n in (1.0, 20.0, 1e4):
        grazing = albedo.directional_albedo(albedo.model("phong", n=n), 0.0)
        # The closed form itself is a quotient of gamma functions, good to 1e-13.
        assert abs(grazing.value - float(exact.phong_grazing(n))) <= grazing.error + 1e-13


def test_limits_at_the_horizon() -> None:
    one = albedo.directional_albedo(ggx_1, 0.0)
    assert abs(one.value - 1.0) <= one.error
    with pytest.raises(albedo.DivergenceError, match=r"ward.*diverges at cos_theta = 0"):
        albedo.directional_albedo(albedo.model("ward"), [0.5, 0.0])
    with pytest.raises(albedo.DivergenceError, match="phong_original"):
        albedo.directional_albedo(albedo.model("phong_original"), 0.0)
    assert albedo.directional_albedo(albedo.model("he_torrance"), 0.0).value == 0.0


def test_the_fixed_direction_matters_for_models_that_are_not_reciprocal() -> None:
    for name in ("phong", "ward"):
        light, view = (
            albedo.directional_albedo(albedo.model(name), [0.9, 0.3], fixed=f)
            for f in ("light", "view")
        )
        assert np.all(np.abs(light.value - view.value) <= light.error + view.error)
    original = albedo.model("phong_original", n=20.0)
    view = albedo.directional_albedo(original, 1.0, fixed="view")
    # Normal incidence: the integral of cos^n over the hemisphere.
    assert abs(view.value - 2.0 * math.pi / 21.0) <= view.error
    light = albedo.directional_albedo(original, 1.0)
    assert abs(light.value - 2.0 * math.pi / 22.0) <= light.error


@pytest.mark.parametrize("geometry", ["v_cavity", "smith", "smith_correlated"])
@pytest.mark.parametrize("distribution", ["beckmann", "ggx"])
@pytest.mark.parametrize("m", [0.5, 0.05])
def test_the_complement_completes(geometry: str, distribution: str, m: float) -> None:
    model = albedo.model("cook_torrance", m=m, distribution=distribution, geometry=geometry)
    mu = np.array([0.9, 0.3, 1e-3])
    rest = albedo.directional_albedo(model, mu, complement=True)
    whole = albedo.directional_albedo(model, mu, rtol=1e-12)
    assert np.all(rest.converged)
    assert np.all(np.abs(rest.value + whole.value - 1.0) <= rest.error + whole.error)


def test_the_complement_falls_like_the_square_of_the_roughness() -> None:
    for alpha in (1e-2, 1e-4, 1e-6):
        kinds = {"distribution": "ggx", "geometry": "smith_correlated"}
        found = albedo.directional_albedo(
            albedo.model("cook_torrance", m=alpha, **kinds), 1.0, complement=True
        )
        assert abs(found.value - float(exact.ggx_normal_loss(alpha))) <= found.error
        assert found.error <= 1e-8 * found.value


def test_parts_sum_to_the_whole() -> None:
    found = albedo.directional_albedo(albedo.model("he_torrance"), [0.9, 0.2])
    assert set(found.parts) == {"mirror", "directional_diffuse"}
    total = sum(part.value for part in found.parts.values())
    np.testing.assert_array_equal(total, found.value)


def test_shapes_are_those_of_the_broadcast() -> None:
    model = albedo.model("ward", alpha_x=0.3, alpha_y=0.2)
    found = albedo.directional_albedo(model, [[0.9], [0.5]], [0.0, 0.3, 0.6], rtol=1e-4)
    assert found.value.shape == found.error.shape == (2, 3)
    assert found.evaluations.shape == found.converged.shape == (2, 3)
    assert albedo.directional_albedo(model, 0.5, rtol=1e-4).value.shape == ()


def test_a_budget_that_is_too_small_is_said() -> None:
    with pytest.warns(albedo.ConvergenceWarning, match="1 of 1 values missed"):
        found = albedo.directional_albedo(albedo.model("ward"), 0.1, max_evaluations=100)
    assert not found.converged
    reference = albedo.directional_albedo(albedo.model("ward"), 0.1)
    assert abs(found.value - reference.value) <= found.error + reference.error


def test_tables_carry_labels_and_do_not_depend_on_threads() -> None:
    model = albedo.model("ward")
    mu = [0.1, 0.5, 1.0]
    calls: list[tuple[int, int]] = []
    one = albedo.table(
        model,
        mu,
        sweep={"m": [0.1, 0.3]},
        rtol=1e-5,
        progress=lambda done, total: calls.append((done, total)),
    )
    two = albedo.table(model, mu, sweep={"m": [0.1, 0.3]}, rtol=1e-5, threads=2)
    assert one.value.dims == ("m", "phi", "cos_theta")
    assert one.identical(two)
    assert calls[-1] == (6, 6)
    assert one.phi.attrs["units"] == "rad"
    assert one.attrs["model"] == "ward"
    assert "albedo-workbench" in one.attrs["source"]
    lone = albedo.directional_albedo(model.replace(m=0.3), 0.5, rtol=1e-5)
    assert abs(float(one.value.sel(m=0.3, cos_theta=0.5).item()) - lone.value) <= 2 * lone.error


def test_a_function_is_a_model() -> None:
    n = 400.0

    def lobe(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        mirror = wo * wi * np.array([-1.0, -1.0, 1.0])
        return (n + 2.0) / (2.0 * math.pi) * np.maximum(mirror.sum(-1), 0.0) ** n

    reference = albedo.directional_albedo(albedo.model("phong", n=n), [0.9, 0.2])
    for hints in (
        {"resolved_width": 0.02},
        {"lobe": "mirror", "width": 0.07},
        {"lobe": "half", "width": 0.07, "isotropic": True},
    ):
        model = albedo.model_from(lobe, **hints)  # type: ignore[arg-type]
        found = albedo.directional_albedo(model, [0.9, 0.2], rtol=1e-6)
        assert np.all(np.abs(found.value - reference.value) <= found.error + reference.error)
        assert found.resolved_width is not None
        assert "rad" in str(found)


def test_a_scan_misses_no_disc_of_its_width(rng: np.random.Generator) -> None:
    """A disc that reflects, and nothing else: wherever it lies, some node sees it."""
    width = 0.05
    for _ in range(40):
        theta, turn = rng.uniform(0.3, 1.2), rng.uniform(0.4, 2.7)
        middle = spherical(math.cos(theta), turn).ravel()

        def disc(wi: np.ndarray, wo: np.ndarray, middle: np.ndarray = middle) -> np.ndarray:
            inside = ((wo - middle) ** 2).sum(-1) < (0.5 * width) ** 2
            return np.where(inside, 1.0 / width**2, 0.0)

        model = albedo.model_from(disc, resolved_width=width)
        # Its edge needs more evaluations than are given.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", albedo.ConvergenceWarning)
            found = albedo.directional_albedo(model, 0.9, rtol=1e-2, max_evaluations=500_000)
        expected = 0.25 * math.pi * math.cos(theta)
        # A chord is shorter than an arc, by a share of width^2/96 that tilts nothing.
        assert abs(float(found.value) - expected) <= float(found.error) + 1e-3 * expected


def test_a_scan_that_cannot_see_everything_is_refused() -> None:
    model = albedo.model_from(lambda wi, wo: np.full(wo.shape[:-1], 0.1), resolved_width=0.01)
    with pytest.raises(albedo.InputError, match=r"features of 0.01 rad are seen with \d+ at least"):
        albedo.directional_albedo(model, 0.5, max_evaluations=100_000)


def test_functions_that_return_nonsense_are_refused() -> None:
    broken = albedo.model_from(lambda wi, wo: wo[..., 0] * np.nan, lobe="diffuse")
    with pytest.raises(albedo.InputError, match=r"f\(wi, wo\) is nan at wi = "):
        albedo.directional_albedo(broken, 0.5)
    flat = albedo.model_from(lambda wi, wo: np.ones(3), lobe="diffuse")
    with pytest.raises(albedo.InputError, match="it must return real values of shape"):
        albedo.directional_albedo(flat, 0.5)


def test_estimates_print_with_their_errors() -> None:
    # The bracket covers what rounding the number adds as well.
    assert format_value(0.488993, 2e-6) == "0.488993(2)"
    assert format_value(0.488993012, 2e-6) == "0.488993(3)"
    found = albedo.directional_albedo(albedo.model("lambert", rho=0.5), 1.0, rtol=1e-6)
    assert str(found).endswith("[bound]")


def test_parts_share_the_tolerance_of_their_sum() -> None:
    """A part that adds little needs few digits, also where it comes first."""
    dim = 1e-4 * albedo.model("phong", n=1000.0)
    cosines = np.geomspace(1e-6, 1.0, 25)
    alone = albedo.directional_albedo(dim, cosines)
    found = albedo.directional_albedo(dim + albedo.model("lambert", rho=0.9), cosines)
    first = next(iter(found.parts.values()))
    np.testing.assert_array_less(np.abs(first.value - alone.value), first.error + alone.error)
    assert found.converged.all()
    assert np.all(first.evaluations <= alone.evaluations)
    # A ten-thousandth of the sum to 1e-8 of it: four digits.
    assert first.evaluations.sum() < 0.5 * alone.evaluations.sum()


def test_no_part_takes_what_others_have_used() -> None:
    """The first three parts use most of what the four may lose, and none of them loses more."""
    model = albedo.model(
        "schlick",
        form="residual",
        roughness=0.23221591103701314,
        color=0.040912391332155136,
        layers="2",
        roughness2=2.0531459190559112e-4,
        color2=0.028932997795348418,
    )
    found = albedo.directional_albedo(model, np.geomspace(1e-4, 0.1, 61))
    assert found.converged.all()
    assert np.all(found.error <= 1e-8 * found.value)
