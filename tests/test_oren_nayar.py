"""Oren and Nayar's models and their successors: albedos that need no hemisphere.

The azimuth enters these models as c = cos(phi_l - phi_v) only, linearly on either side of 90
degrees, so that albedos are closed forms, or integrals over one angle.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from exact import Number, mp, oracle

import albedo
from albedo.brdf import Model
from albedo.catalogue._oren_nayar import CHART
from albedo.directions import spherical

EPS = np.finfo(float).eps
COSINES = np.array([1.0, 1.0 - 1e-9, 0.97, 0.7, 0.4, 0.1, 1e-2, 1e-4, 1e-6, 1e-9])


def holds(model: Model, expected: list[Any], rtol: float = 1e-12) -> None:
    """The albedo at COSINES is what is expected, within its own bound."""
    found = albedo.directional_albedo(model, COSINES, rtol=rtol)
    assert np.all(found.converged)
    # What is expected comes in 40 digits, and is rounded once.
    off = np.abs(found.value - np.array([float(x) for x in expected]))
    assert np.all(off <= found.error + EPS)


def coefficients(sigma: float) -> tuple[Number, Number, Number]:
    """C_1 = A, s^2/(s^2 + 0.09) and the share of interreflection."""
    s2 = mp.mpf(sigma) ** 2
    return (
        1 - s2 / (s2 + mp.mpf("0.33")) / 2,
        s2 / (s2 + mp.mpf("0.09")),
        mp.mpf("0.17") * s2 / (s2 + mp.mpf("0.13")),
    )


def over_the_angle(integrand: Any, mu: float) -> Number:
    """The integral of integrand(alpha, beta) sin cos over the angle of V, L being at acos(mu)."""
    light = mp.acos(mp.mpf(mu))

    def weighted(t: Number) -> Number:
        both = max(t, light), min(t, light)
        return integrand(*both) * mp.sin(t) * mp.cos(t)

    # Towards the horizon functions of n.l + n.v change within n.l of it.
    near = [mp.pi / 2 - mp.mpf(mu) * 8**k for k in range(-1, 12)]
    cuts = sorted({mp.zero, light, mp.pi / 2} | {t for t in near if t > 0})
    return mp.quad(weighted, cuts)


@pytest.mark.parametrize(
    ("name", "smooth"),
    [
        ("oren_nayar", {"sigma": 0.0}),
        ("oren_nayar_full", {"sigma": 0.0}),
        ("fujii", {"sigma": 0.0}),
        ("fujii", {"form": "artist", "r": 0.0}),
        ("eon", {"r": 0.0}),
        ("eon", {"r": 0.0, "albedo": "fitted"}),
    ],
)
def test_a_smooth_surface_is_lambertian(
    name: str, smooth: dict[str, Any], rng: np.random.Generator
) -> None:
    wi = spherical(10.0 ** rng.uniform(-9.0, 0.0, 50), rng.uniform(-math.pi, math.pi, 50))
    wo = spherical(10.0 ** rng.uniform(-9.0, 0.0, 50), rng.uniform(-math.pi, math.pi, 50))
    values = albedo.model(name, rho=0.7, **smooth).eval(wi, wo)
    # rho and 1/pi are multiplied, or divided: an ulp each.
    np.testing.assert_allclose(values, 0.7 / math.pi, rtol=2 * EPS)


@pytest.mark.parametrize(("rho", "sigma"), [(1.0, 0.1986), (0.5, 0.7), (0.9, 0.5 * math.pi)])
def test_the_qualitative_model_is_an_integral_over_one_angle(rho: float, sigma: float) -> None:
    a, lobe, _ = coefficients(sigma)
    b = mp.mpf("0.45") * lobe
    # The integral of max(0, c) over the azimuth is 2.
    holds(
        albedo.model("oren_nayar", rho=rho, sigma=sigma),
        [
            rho * (a + 2 * b / mp.pi * over_the_angle(lambda x, y: mp.sin(x) * mp.tan(y), mu))
            for mu in COSINES
        ],
    )


@pytest.mark.parametrize(("rho", "sigma"), [(1.0, 0.3044), (0.2, 0.66), (1.0, 1.2)])
def test_the_full_model_is_an_integral_over_one_angle(rho: float, sigma: float) -> None:
    c_1, lobe, second = coefficients(sigma)

    def rest(x: Number, y: Number) -> Number:
        # Integrals over the azimuth: 2 and -2 of c on both halves, 2 pi - 4 of 1 - |c|.
        toward = 2 * mp.mpf("0.45") * lobe * (2 * y / mp.pi) ** 3 * mp.tan(y)
        c_3 = lobe / 8 * (4 * x * y / mp.pi**2) ** 2
        return toward + (2 * mp.pi - 4) * c_3 * mp.tan((x + y) / 2)

    holds(
        albedo.model("oren_nayar_full", rho=rho, sigma=sigma),
        [rho * (c_1 + rho * second + over_the_angle(rest, mu) / mp.pi) for mu in COSINES],
    )


def test_the_full_model_is_never_negative() -> None:
    """f_1 is below 0 opposite the light for sigma > 0.6644; f_2 hardly counts for small rho."""
    light, opposite = spherical(1e-6, 0.0), spherical(1e-6, math.pi)
    assert albedo.model("oren_nayar_full", rho=1e-3, sigma=0.664).eval(light, opposite) > 0.0
    assert albedo.model("oren_nayar_full", rho=1e-3, sigma=0.666).eval(light, opposite) == 0.0


@pytest.mark.parametrize(("rho", "sigma"), [(0.5, 1.2), (0.1, 0.8), (0.1, 0.5 * math.pi)])
@pytest.mark.parametrize("isotropic", [True, False])
def test_the_chart_without_the_dark_region_misses_nothing(
    rho: float, sigma: float, isotropic: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Against the chart that covers the hemisphere, which has to find the edge by cutting cells."""
    model = albedo.model("oren_nayar_full", rho=rho, sigma=sigma)
    kind = type(model)
    (part,) = model.parts()
    assert part.chart != CHART
    monkeypatch.setattr(kind, "isotropic", isotropic)
    found = albedo.directional_albedo(model, COSINES, 0.7, rtol=1e-11)
    assert np.all(found.converged)
    assert np.max(found.evaluations) <= 20_000
    monkeypatch.setattr(kind, "parts", lambda self: (replace(part, chart=CHART),))
    whole = albedo.directional_albedo(model, COSINES, 0.7, rtol=1e-7)
    assert np.all(np.abs(found.value - whole.value) <= found.error + whole.error)


def test_the_dark_region_is_declared_where_there_is_one() -> None:
    """f is smallest where both directions graze, opposite each other."""
    mu = np.geomspace(1e-7, 1.0, 40)
    psi = math.pi - np.append(0.0, np.geomspace(1e-7, math.pi, 40))
    wi = spherical(mu[:, None, None], 0.0)
    wo = spherical(mu[None, :, None], psi[None, None, :])
    for sigma in (0.7, 0.8, 1.2, 0.5 * math.pi):
        rhos = np.linspace(0.02, 0.98, 49)
        dark = []
        for rho in rhos:
            model = albedo.model("oren_nayar_full", rho=rho, sigma=sigma)
            dark.append(model.parts()[0].chart != CHART)
            assert dark[-1] == bool(np.any(model.eval(wi, wo) == 0.0))
        assert any(dark)
        assert not all(dark)


@pytest.mark.parametrize("r", [1e-3, 0.3, 1.0])
def test_the_artist_form_has_the_albedo_of_single_scattering(r: float) -> None:
    single = oracle("eon").single_albedo
    holds(
        albedo.model("fujii", form="artist", rho=0.8, r=r),
        [0.8 * single(mp.mpf(r), mp.mpf(mu)) for mu in COSINES],
    )


@pytest.mark.parametrize(("rho", "sigma"), [(1.0, 0.2575), (0.3, 1.2)])
def test_the_matched_form_has_a_closed_albedo(rho: float, sigma: float) -> None:
    """The integral of s/t over V is that of the artist form: pi (E_F/A_F - 1)/r for any r."""
    a, lobe, second = coefficients(sigma)
    single = oracle("eon").single_albedo

    def lit(mu: float) -> Number:
        return single(mp.one, mp.mpf(mu)) * (mp.mpf(3) / 2 - 2 / (3 * mp.pi)) - 1

    holds(
        albedo.model("fujii", rho=rho, sigma=sigma),
        [rho * (a + rho * second + mp.mpf("0.45") * lobe * lit(mu)) for mu in COSINES],
    )


@pytest.mark.parametrize("r", [0.0, 1e-6, 0.1, 0.5, 1.0])
def test_eon_reflects_all_that_it_receives(r: float) -> None:
    holds(albedo.model("eon", rho=1.0, r=r), [1.0] * COSINES.size)


@pytest.mark.parametrize(("rho", "r"), [(0.9, 1.0), (0.5, 0.4), (0.1, 1.0)])
def test_eon_has_a_closed_albedo(rho: float, r: float) -> None:
    eon = oracle("eon")
    x, y = mp.mpf(rho), mp.mpf(r)
    rho_ms, average = eon.multiple(x, y)
    single = [eon.single_albedo(y, mp.mpf(mu)) for mu in COSINES]
    model = albedo.model("eon", rho=rho, r=r)
    holds(model, [x * e + rho_ms * (1 - e) for e in single])
    whole = albedo.average_albedo(model)
    assert abs(whole.value - float(x * average + rho_ms * (1 - average))) <= whole.error


@pytest.mark.parametrize("rho", [1.0, 0.5])
def test_the_fitted_albedo_of_eon_is_off_by_what_the_fit_is_off(rho: float) -> None:
    eon = oracle("eon")
    x, r = mp.mpf(rho), mp.mpf(1)
    rho_ms, average = eon.multiple(x, r)
    # The cosine-weighted average of the polynomial: 2 x^n (1 - x) integrates to 2/((n+1)(n+2)).
    fitted_average = 2 * mp.quad(lambda mu: mu * eon.fitted_albedo(r, mu), [0, 1])
    share = (1 - fitted_average) / (1 - average)
    holds(
        albedo.model("eon", rho=rho, r=1.0, albedo="fitted"),
        [
            x * eon.single_albedo(r, mp.mpf(mu))
            + rho_ms * (1 - eon.fitted_albedo(r, mp.mpf(mu))) * share
            for mu in COSINES
        ],
    )


def test_the_fitted_albedo_of_eon_exceeds_1_by_a_little() -> None:
    model = albedo.model("eon", rho=1.0, r=1.0, albedo="fitted")
    found = albedo.directional_albedo(model, np.linspace(0.1, 0.2, 101), rtol=1e-10)
    top = int(np.argmax(found.value))
    assert found.value[top] - 1.0 == pytest.approx(1.47e-4, abs=1e-6)
    below = albedo.directional_albedo(model.replace(rho=0.9998), COSINES, rtol=1e-10)
    assert np.all(below.value - below.error <= 1.0)


# The smallest rho for which the albedo reaches 1, and the sigma for which it does.
LIMITS = [
    ("oren_nayar", {"sigma": 0.1986}, 0.985048),
    ("oren_nayar_full", {"sigma": 0.29756}, 0.954352),
    ("fujii", {"sigma": 0.25305}, 0.973520),
]


@pytest.mark.parametrize(("name", "rough", "rho"), LIMITS)
def test_the_promise_ends_where_grazing_incidence_reaches_1(
    name: str, rough: dict[str, float], rho: float
) -> None:
    cosines = np.array([0.0, 1e-6, 1e-3, 0.03, 0.1, 0.3, 0.6, 0.9, 1.0])
    for off, conserves in ((-1e-5, True), (1e-5, False)):
        model = albedo.model(name, rho=rho + off, **rough)
        found = albedo.directional_albedo(model, cosines, rtol=1e-10)
        assert model.conserves_energy is conserves
        assert bool(np.all(found.value <= 1.0)) is conserves
        # The largest albedo is that at grazing incidence.
        assert np.all(np.diff(found.value) < 0.0)


@pytest.mark.parametrize(
    ("name", "sigma"), [("oren_nayar", 0.3261), ("oren_nayar_full", 0.6276), ("fujii", 0.4637)]
)
def test_white_facets_that_are_rough_enough_reflect_less_than_1(name: str, sigma: float) -> None:
    assert not albedo.model(name, sigma=sigma - 2e-4).conserves_energy
    rough = albedo.model(name, sigma=sigma + 2e-4)
    assert rough.conserves_energy
    found = albedo.directional_albedo(rough, 0.0, rtol=1e-10)
    assert 0.9999 < found.value < 1.0


def test_fujii_breaks_the_law_above_097() -> None:
    """Fujii's note says so of rho > 0.97, and that the full model does it as well."""
    sigmas = np.linspace(0.1, 0.5, 81)
    assert all(albedo.model("fujii", rho=0.97, sigma=s).conserves_energy for s in sigmas)
    assert not all(albedo.model("fujii", rho=0.98, sigma=s).conserves_energy for s in sigmas)
    assert not all(
        albedo.model("oren_nayar_full", rho=0.97, sigma=s).conserves_energy for s in sigmas
    )


@pytest.mark.parametrize("name", ["oren_nayar", "oren_nayar_full", "fujii", "eon"])
def test_no_incidence_is_expensive(name: str) -> None:
    cosines = np.concatenate((np.geomspace(1.0, 1e-9, 40), 1.0 - np.geomspace(1e-12, 0.1, 10)))
    found = albedo.directional_albedo(albedo.model(name), cosines, rtol=1e-8)
    assert np.all(found.converged)
    # A dozen panels of 10 times 16 nodes, once again at a higher order.
    assert np.median(found.evaluations) <= 4000
    assert np.max(found.evaluations) <= 6000
