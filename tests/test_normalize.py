"""Albedos as functions, and the models that are divided by them: Lewis, and NNS eq. 7."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
import pytest
from exact import mp
from oracles.lafortune_scaled import largest
from oracles.lewis import half_vector_integral, mirror_integral

import albedo
from albedo.brdf import Model
from albedo.operators import curve as curve_module
from albedo.operators.curve import albedo_curve, albedo_curves
from albedo.operators.normalize import largest_albedo
from albedo.quadrature import albedo_rows

EPS = np.finfo(float).eps

# Down to where the curve of a narrow lobe has its last bend, and beyond.
GRAZING = 10.0 ** -np.linspace(0.3, 14.0, 40)
COSINES = np.concatenate((np.linspace(0.02, 1.0, 61), GRAZING, [0.0]))


@pytest.mark.parametrize(
    ("name", "parameters"),
    [
        ("phong", {"n": 20.0}),
        ("phong", {"n": 1e8}),
        ("blinn", {"n": 0.5}),
        ("blinn", {"n": 1e4}),
        ("max_phong", {"n": 50.0}),
        ("cook_torrance", {"m": 0.4}),
        ("cook_torrance", {"m": 0.05, "distribution": "ggx", "geometry": "smith_correlated"}),
        ("oren_nayar", {"sigma": 0.5}),
        ("ashikhmin_shirley", {"n_u": 100.0, "n_v": 100.0, "r_d": 0.5}),
    ],
)
@pytest.mark.parametrize("rtol", [1e-6, 4e-13])
def test_a_curve_keeps_within_its_bound(name: str, parameters: dict[str, Any], rtol: float) -> None:
    model = albedo.model(name, **parameters)
    curve = albedo_curve(model, rtol)
    found = albedo.directional_albedo(model, COSINES, rtol=1e-12)
    missed = np.abs(curve(COSINES) - found.value)
    assert np.all(missed <= curve.bound(COSINES) * found.value + found.error)
    # The errors of the albedos, by the Lebesgue constant and once more, are what is left at 4e-13.
    assert np.median(curve.error) <= max(rtol, 2e-12)


def test_a_curve_may_have_an_absolute_error_and_cover_a_part() -> None:
    model = albedo.model("phong", n=50.0)
    curve = albedo_curve(model, atol=1e-7, first=0.25, last=0.7)
    x = np.linspace(0.25, 0.7, 101)
    found = albedo.directional_albedo(model, x)
    assert np.all(np.abs(curve(x) - found.value) <= curve.bound(x) + found.error)
    assert curve.bound() == curve.error.max() <= 1e-7
    assert curve.edges[0] == 0.25
    assert curve.edges[-1] == 0.7
    assert curve(np.array([[0.3], [0.4]])).shape == (2, 1)


def test_curves_made_side_by_side_are_those_made_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    models = [albedo.model("blinn", n=n) for n in (0.5, 7.0, 1e4)]
    models.insert(1, albedo.model("phong", n=7.0))
    together = albedo_curves(models, 1e-10)
    # Otherwise they are only looked up.
    monkeypatch.setattr(curve_module, "_kept", {})
    for model, curve in zip(models, together, strict=True):
        alone = albedo_curve(model, 1e-10)
        assert alone is not curve
        np.testing.assert_array_equal(alone.edges, curve.edges)
        assert alone.evaluations == curve.evaluations
        y = np.linspace(0.0, curve.edges[-1], 501)
        # Both are within their bounds, which are relative.
        both = alone.error.max() + curve.error.max()
        assert np.all(np.abs(alone.at(y) - curve.at(y)) <= both * curve.at(y))


def test_curves_are_kept_until_others_follow(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[int] = []
    original = curve_module._made

    def counted(models: list[Model], *rest: Any) -> list[Any]:
        made.append(len(models))
        return original(models, *rest)

    monkeypatch.setattr(curve_module, "_made", counted)
    monkeypatch.setattr(curve_module, "_kept", {})
    monkeypatch.setattr(curve_module, "_KEPT", 3)
    a, b, c, d = (albedo.model("blinn", n=n) for n in (1.0, 2.0, 3.0, 4.0))
    found = albedo_curves([a, b, a, c], 1e-4)
    assert made == [3]
    assert found[0] is found[2]
    assert albedo_curve(a, 1e-4) is found[0]
    assert made == [3]
    # It takes the place of b, which was asked for before a.
    albedo_curve(d, 1e-4)
    albedo_curves([a, c], 1e-4)
    assert made == [3, 1]
    assert albedo_curve(b, 1e-4) is not found[1]
    assert made == [3, 1, 1]
    # Another tolerance is another curve.
    albedo_curve(b, 1e-5)
    assert made == [3, 1, 1, 1]


def test_many_lewis_models_are_prepared_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[int] = []
    original = curve_module._made

    def counted(models: list[Model], *rest: Any) -> list[Any]:
        made.append(len(models))
        return original(models, *rest)

    monkeypatch.setattr(curve_module, "_made", counted)
    monkeypatch.setattr(curve_module, "_kept", {})
    per = [
        albedo.model("lewis", n=n, reading="per_incidence", lobe=lobe)
        for n in (1.25, 3.25, 9.25)
        for lobe in ("half_vector", "mirror")
    ]
    models = [*per, albedo.model("lewis", n=1.25)]
    found = albedo_rows(models, np.full(7, 0.3), np.zeros(7), rtol=1e-8, atol=0.0)
    assert made == [3, 3]
    assert np.all(np.abs(found.value[:6] - 1.0) <= found.error[:6])


def test_a_curve_knows_its_maximum() -> None:
    # Its albedo is largest between normal and grazing incidence.
    model = albedo.model("lafortune", lobes=((-1.0, -1.0, 0.9, 30.0),))
    curve = albedo_curve(model, 1e-10)
    place, top = curve.maximum()
    x = np.linspace(0.0, 1.0, 20001)
    assert top >= curve(x).max()
    assert top == pytest.approx(float(curve.at(np.array([place]))[0]), rel=1e-14)
    # Up to 45 degrees from grazing incidence the coordinate is the cosine itself.
    assert place < math.sqrt(0.5)
    assert abs(x[np.argmax(curve(x))] - place) <= 1e-4


def test_a_tolerance_below_the_rounding_is_missed_and_said_to_be() -> None:
    model = albedo.model("phong", n=1e4)
    with pytest.warns(albedo.ConvergenceWarning):
        found = albedo.directional_albedo(model, [1.0, 0.5], rtol=0.0, atol=1e-19)
    assert not found.converged.any()
    assert np.all(np.abs(found.value - [1.0, 0.5]) <= found.error)
    assert np.all(found.error < 1e-12)


@pytest.mark.parametrize("lobe", ["half_vector", "mirror"])
@pytest.mark.parametrize("n", [0.0, 0.7, 20.0, 1e4, 1e9])
def test_lewis_reflects_the_same_at_every_incidence(lobe: str, n: float) -> None:
    model = albedo.model("lewis", n=n, rho_s=0.8, reading="per_incidence", lobe=lobe)
    for rtol in (1e-4, 1e-8, 1e-12):
        found = albedo.directional_albedo(model, COSINES, rtol=rtol)
        assert found.converged.all()
        assert np.all(np.abs(found.value - 0.8) <= found.error)


@pytest.mark.parametrize("lobe", ["half_vector", "mirror"])
@pytest.mark.parametrize("n", [0.7, 20.0, 1e6])
@pytest.mark.parametrize("cos_theta", [1.0, 0.4, 0.01, 1e-5])
def test_the_integral_that_lewis_divides_by(lobe: str, n: float, cos_theta: float) -> None:
    """Against one-dimensional integrals over an angle of the lobe, at 30 digits."""
    integral = half_vector_integral if lobe == "half_vector" else mirror_integral
    kind = "blinn" if lobe == "half_vector" else "phong"
    curve = albedo_curve(albedo.model(kind, n=n))
    expected = integral(n, cos_theta) / integral(n, 1.0)
    missed = abs(float(mp.mpf(float(curve(np.array([cos_theta]))[0])) / expected - 1))
    assert missed <= float(curve.bound(np.array([cos_theta]))[0])


def test_lewis_constant_is_phong_and_blinn() -> None:
    for lobe, name in (("half_vector", "blinn"), ("mirror", "phong")):
        ours = albedo.directional_albedo(albedo.model("lewis", n=30.0, lobe=lobe), COSINES)
        other = albedo.directional_albedo(albedo.model(name, n=30.0), COSINES)
        assert np.array_equal(ours.value, other.value)


@cache
def divided_by(n: float, cos_theta: float) -> float:
    return float(half_vector_integral(n, cos_theta))


@pytest.mark.parametrize("cos_theta", [1.0, 0.6])
def test_lewis_seen_from_a_fixed_view(cos_theta: float) -> None:
    """Against a product rule in azimuth and cosine, with the integrals of the oracle inside."""
    n = 6.0
    model = albedo.model("lewis", n=n, reading="per_incidence")
    found = albedo.directional_albedo(model, cos_theta, fixed="view", rtol=1e-10)

    def product(order: int) -> float:
        x, w = np.polynomial.legendre.leggauss(order)
        mu, weight = 0.5 * (x + 1.0), 0.5 * w
        # A root of n.h, as at n.l = n.v = 0, is not smooth: squares cluster the nodes there.
        mu, weight = mu * mu, 2.0 * mu * weight
        divisor = np.array([divided_by(n, c) for c in mu.tolist()])
        psi, turn = math.pi * 0.5 * (x + 1.0), math.pi * w
        sine, s = np.sqrt(1.0 - mu * mu), math.sqrt(1.0 - cos_theta**2)
        l_dot_v = cos_theta * mu[:, None] + s * sine[:, None] * np.cos(psi)
        n_dot_h = (cos_theta + mu[:, None]) / np.sqrt(2.0 * (1.0 + l_dot_v))
        return float(((n_dot_h**n) @ turn * mu / divisor) @ weight)

    coarse, fine = product(24), product(36)
    # The rule's own error is at most what it moved; 1e-9 where both have converged.
    assert abs(float(found.value) - fine) <= float(found.error) + max(abs(fine - coarse), 1e-9)


def test_lewis_gains_energy_when_light_and_view_are_exchanged() -> None:
    model = albedo.model("lewis", n=20.0, reading="per_incidence")
    found = albedo.directional_albedo(model, 1.0, fixed="view")
    assert float(found.value - found.error) > 1.38


@pytest.mark.parametrize(
    ("n", "s"), [(0.0, 0.5), (3.0, 0.8), (20.0, 0.95), (20.0, 0.5), (1e4, 0.999), (1e6, 1.0)]
)
def test_the_constant_of_the_scaled_lobe(n: float, s: float) -> None:
    """c(n, s) against golden sections on one-dimensional integrals at 30 digits."""
    constant, error = albedo.model("lafortune_scaled", n=n, s=s).normalization
    assert error <= 1e-12
    # 60 roundings in an integral that is a product of two.
    assert abs(float(constant * largest(n, s) - 1)) <= error + 60 * EPS


@pytest.mark.parametrize(("n", "s"), [(20.0, 1.0), (20.0, 0.99), (1e4, 1.0 - 1e-5), (2.0, 0.9)])
def test_a_lobe_that_is_largest_at_normal_incidence(n: float, s: float) -> None:
    """There its integral is s^n 2 pi/(n + 2), with o = (0, 0, s)."""
    constant, error = albedo.model("lafortune_scaled", n=n, s=s).normalization
    expected = (n + 2.0) / (2.0 * math.pi) * math.exp(-n * math.log(s))
    # log(s) is rounded, and n times that.
    assert abs(constant / expected - 1.0) <= error + (8.0 + n) * EPS


@pytest.mark.parametrize(("n", "s"), [(20.0, 0.95), (1e3, 0.5), (1e6, 1.0 - 1e-6), (0.3, 0.1)])
def test_the_scaled_lobe_reaches_its_largest_albedo_and_stays_below(n: float, s: float) -> None:
    model = albedo.model("lafortune_scaled", n=n, s=s, rho_s=0.9)
    found = albedo.directional_albedo(model, np.geomspace(1e-9, 1.0, 400))
    assert np.all(found.value - found.error <= 0.9)
    # Steps of 5 percent in the cosine miss the top of a smooth curve by the square of that.
    assert found.value.max() >= 0.9 * (1.0 - 2e-3)


def test_without_a_scale_it_is_phongs_lobe() -> None:
    ours: Model = albedo.model("lafortune_scaled", n=40.0, s=1.0)
    phong = albedo.directional_albedo(albedo.model("phong", n=40.0), COSINES)
    found = albedo.directional_albedo(ours, COSINES)
    assert np.all(np.abs(found.value - phong.value) <= found.error + phong.error)


def test_the_largest_albedo_counts_its_error() -> None:
    value, error = largest_albedo(albedo.model("blinn", n=100.0))
    # Giesen's constant makes it 1, at normal incidence.
    assert abs(value - 1.0) <= error
    assert 0.0 < error <= 1e-12


MIRRORED = albedo.model("schlick", form="final", roughness=0.1)


@pytest.mark.parametrize(
    "base",
    [
        albedo.model("phong", n=20.0),
        albedo.model("ashikhmin_shirley", n=10),
        albedo.model("ward", m=0.3),
        albedo.model("cook_torrance", m=1e-3, geometry="smith"),
        MIRRORED,
    ],
    ids=lambda m: m.name,
)
def test_a_model_over_its_albedo(base: Model) -> None:
    alone = albedo.directional_albedo(base, COSINES[:-1])
    normal = albedo.normalize(base)
    found = albedo.directional_albedo(normal, COSINES[:-1])
    top = albedo.directional_albedo(base, 1.0, rtol=1e-10)
    known = alone.value / float(top.value)
    assert np.all(
        np.abs(found.value - known) <= found.error + (alone.error + top.error) / top.value
    )
    assert normal.reciprocal == base.reciprocal
    each = albedo.normalize(base, "each_incidence")
    found = albedo.directional_albedo(each, COSINES[:-1])
    assert np.all(np.abs(found.value - 1.0) <= found.error)
    assert found.converged.all()
    assert not each.reciprocal
    assert each.conserves_energy
    if not base.grazing_limit:
        return
    largest = albedo.directional_albedo(albedo.normalize(base, "max"), COSINES)
    assert np.all(largest.value <= 1.0 + largest.error)
    # Steps of the cosines miss the top of a smooth curve by the square of them.
    assert largest.value.max() >= 1.0 - 2e-3


def test_each_incidence_is_lewis() -> None:
    ours = albedo.normalize(albedo.model("blinn", n=20.0), "each_incidence")
    lewis = albedo.model("lewis", n=20.0, reading="per_incidence")
    for fixed in ("light", "view"):
        found = albedo.directional_albedo(ours, [1.0, 0.5, 0.02], fixed=fixed)
        other = albedo.directional_albedo(lewis, [1.0, 0.5, 0.02], fixed=fixed)
        assert np.all(np.abs(found.value - other.value) <= found.error + other.error)


def test_dirac_parts_are_normalised() -> None:
    model = albedo.normalize(MIRRORED, "each_incidence")
    wi = np.array([[0.6, 0.0, 0.8], [0.0, 0.0, 1.0]])
    alone = albedo.directional_albedo(MIRRORED, wi[:, 2], rtol=1e-11)
    known = MIRRORED.spikes(wi)[1][0] / alone.value
    weights = model.spikes(wi)[1]
    errors = model.spike_errors(wi, weights)
    assert np.all(np.abs(weights[0] - known) <= errors[0] + 2e-11 * known)
    assert "mirror" in albedo.directional_albedo(model, 0.3).parts


def test_an_anisotropic_model_over_its_albedo() -> None:
    base = albedo.model("cook_torrance", alpha_x=0.5, alpha_y=0.3, geometry="smith")
    found = albedo.directional_albedo(albedo.normalize(base), 1.0, [0.0, 1.0])
    assert np.all(np.abs(found.value - 1.0) <= found.error)
    assert found.converged.all()
    phi = np.array([[0.0], [0.4], [2.0]])
    each = albedo.normalize(base, "each_incidence", rtol=1e-3)
    found = albedo.directional_albedo(each, [1.0, 0.4, 0.05], phi, rtol=1e-2)
    assert np.all(np.abs(found.value - 1.0) <= found.error)
    # Masking takes least at normal incidence, or next to the horizon along one of the axes.
    alone = albedo.directional_albedo(base, [1.0, 0.3, 0.0], phi)
    most = albedo.normalize(base, "max", rtol=1e-3)
    largest, error = most.divisor
    assert largest * (1.0 + error) >= np.max(alone.value - alone.error)
    assert largest <= 1.0 + error


def test_normalised_models_are_models_like_any_other() -> None:
    base = albedo.model("ashikhmin_shirley", n=10)
    model = albedo.normalize(base, "max")
    assert model == albedo.normalize(albedo.model("ashikhmin_shirley", n=10), "max")
    assert model != albedo.normalize(base)
    assert hash(model) == hash(albedo.normalize(base, "max"))
    assert model.spec == f"normalize({base.spec}, at=max)"
    exact = albedo.directional_albedo(model, [0.9, 0.2])
    drawn = albedo.monte_carlo_albedo(model, [0.9, 0.2], samples=2**14, seed=5)
    assert np.all(np.abs(drawn.value - exact.value) <= 5.0 * drawn.error + exact.error)
    table = albedo.table(albedo.normalize(base), [1.0], sweep={"n": [1.0, 30.0]})
    assert np.all(np.abs(table["value"].values - 1.0) <= table["error"].values)
    coloured = albedo.normalize(albedo.model("schlick", color=(0.2, 0.5)))
    found = albedo.directional_albedo(coloured, 1.0)
    assert np.all(np.abs(found.value - 1.0) <= found.error)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: albedo.normalize("phong"), "needs a model, not str"),
        (lambda: albedo.normalize(albedo.model("phong"), "grazing"), "at = 'grazing'"),
        (lambda: albedo.normalize(albedo.model("ward"), "max"), "no largest value"),
        (lambda: albedo.normalize(albedo.model("ward"), rtol=0.1), "rtol = 0.1"),
        (lambda: albedo.normalize(albedo.model("lambert", rho=0.0)), "nothing to divide by"),
        (lambda: albedo.normalize(albedo.model("lambert", rho=0.0), "each_incidence"), "above 0"),
    ],
)
def test_bad_input_to_normalize(make: Any, message: str) -> None:
    with pytest.raises(albedo.InputError, match=message):
        make()
