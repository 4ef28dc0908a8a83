"""Stam's model against He and Torrance's, against geometrical optics, and its conservation."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from exact import mp, oracle

import albedo
from albedo.catalogue import stam_grating
from albedo.charts.orders import OrdersChart
from albedo.directions import spherical
from albedo.errors import InputError
from albedo.integrators.adaptive import integrate
from albedo.quadrature import albedo_rows

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


GRATINGS = [
    {"depth": 0.15},
    {"depth": 2.0, "period": 8.3, "wavelength": 0.45},
    {"depth": 0.1, "period": 0.2},
    {"depth": 0.6, "fresnel": "dielectric", "period": 3.1},
    {"profile": "lamellar", "duty": 0.3, "period": 5.1},
    {"profile": "lamellar", "duty": 0.01, "period": 60.1, "depth": 0.125},
    {"profile": "lamellar", "depth": 7.0, "fresnel": "gold", "duty": 0.9},
]


@pytest.mark.parametrize("p", GRATINGS, ids=str)
def test_the_orders_of_a_grating(p: dict[str, Any]) -> None:
    """Against the orders one by one at 30 digits, down to grazing incidence."""
    model = albedo.model("stam_grating", **p)
    cosines = np.array([1.0, 0.9, 0.43, 0.05, 1e-3, 1e-6])
    for phi in (0.0, 0.7, 2.5):
        found = albedo.directional_albedo(model, cosines, phi)
        for i, c in enumerate(cosines):
            c, turn = mp.mpf(float(c)), mp.mpf(phi)
            s = mp.sqrt((1 - c) * (1 + c))
            light = (s * mp.cos(turn), s * mp.sin(turn), c)
            total = mp.fsum(oracle("stam_grating").orders(model.parameters, light).values())
            assert abs(float(mp.mpf(float(found.value[i])) - total)) <= found.error[i]
        assert np.all(found.error <= 1e-7 * found.value)
        # Phases up to 400 radians are rounded to 1e-13, and a dozen such errors add up.
        assert np.all(found.error[:3] <= 1e-11 * found.value[:3])


@pytest.mark.parametrize("p", GRATINGS, ids=str)
def test_orders_leave_where_the_grating_equation_sends_them(p: dict[str, Any]) -> None:
    model = albedo.model("stam_grating", **p)
    wi = spherical(np.array([0.7, 0.2]), np.array([0.3, -2.0]))
    directions, weights = model.spikes(wi)
    wavelength, period = model.wavelength, model.period
    for k in np.argwhere(weights > 0.0).tolist():
        v, light = directions[tuple(k)], wi[k[1]]
        # A handful of roundings, over the sine of the elevation where it comes from a square.
        assert abs(np.linalg.norm(v) - 1.0) <= 8 * np.finfo(float).eps / v[2]
        assert v[1] == -light[1]
        order = (v[0] + light[0]) * period / wavelength
        assert abs(order - round(order)) <= 1e-12 * max(1.0, abs(order))
    found = albedo.directional_albedo(model, [0.7, 0.2], [0.3, -2.0])
    assert np.all(np.abs(weights.sum(0) - found.value) <= found.error)


def test_gratings_are_symmetric_in_light_and_view() -> None:
    """The share of an order is that of the light which comes back along it."""
    model = albedo.model("stam_grating", depth=0.4, fresnel="dielectric")
    wi = spherical(np.array([0.6]), np.array([0.4]))
    directions, weights = model.spikes(wi)
    for k in np.flatnonzero(weights[:, 0] > 1e-12).tolist():
        back, shares = model.spikes(directions[k])
        distance = np.linalg.norm(back[:, 0] - wi[0], axis=1)
        nearest = int(np.argmin(distance))
        assert distance[nearest] <= 1e-14
        assert shares[nearest, 0] == pytest.approx(weights[k, 0], rel=1e-12)


def test_a_flat_grating_is_a_mirror() -> None:
    for profile in ("sinusoid", "lamellar"):
        model = albedo.model("stam_grating", depth=0.0, profile=profile)
        found = albedo.directional_albedo(model, COSINES, 0.3)
        assert np.all(np.abs(found.value - 1.0) <= found.error)
        assert found.error.max() <= 1e-13


def test_a_long_shallow_relief_keeps_the_energy() -> None:
    """Orders that stay close to the mirror direction: the sum of |c_n|^2 is 1."""
    for profile in ("sinusoid", "lamellar"):
        model = albedo.model("stam_grating", period=900.3, depth=0.3, profile=profile)
        found = albedo.directional_albedo(model, [1.0, 0.7])
        # Shares differ from |c_n|^2 by the square of lambda/d, and by what c_n leaves at high n.
        assert np.all(np.abs(found.value - 1.0) <= 2e-3)


def test_where_rounding_decides_whether_an_order_leaves_the_bound_is_infinite() -> None:
    model = albedo.model("stam_grating", period=2.0)
    with pytest.warns(albedo.ConvergenceWarning):
        found = albedo.directional_albedo(model, 1.0)
    assert np.isinf(found.error)
    assert not found.converged
    beside = albedo.directional_albedo(model.replace(period=2.0 + 1e-9), 1.0, rtol=1e-3)
    # There the order carries a share that grows as the inverse of its cosine.
    assert beside.value > found.value


def test_a_grating_too_wide_or_too_deep_to_count_is_refused() -> None:
    with pytest.raises(albedo.InputError, match=r"period = 2000 is out of range"):
        albedo.model("stam_grating", period=2000.0)
    with pytest.raises(albedo.InputError, match=r"depth = 500 is out of range"):
        albedo.model("stam_grating", depth=500.0, wavelength=0.05)


def test_a_grating_in_a_sum_keeps_its_errors() -> None:
    grating, diffuse = albedo.model("stam_grating"), albedo.model("lambert", rho=0.5)
    both = albedo.directional_albedo(0.5 * grating + diffuse, COSINES, 0.2)
    one = albedo.directional_albedo(grating, COSINES, 0.2)
    assert np.all(np.abs(both.value - 0.5 * one.value - 0.5) <= both.error + 0.5 * one.error)
    assert np.all(both.error >= 0.5 * one.error)


@pytest.mark.parametrize("phi", [0.0, 0.4, 0.5 * math.pi, 2.5])
@pytest.mark.parametrize(("step", "sigma"), [(0.3, 1.0), (1.0, 1.0), (3.0, 1.0), (0.13, 0.2)])
def test_the_chart_of_orders_covers_the_hemisphere(step: float, sigma: float, phi: float) -> None:
    """The integral of n.v is pi where the Gaussians reach everywhere, down to grazing incidence."""
    cosines = np.array([1.0, 0.7, 0.2, 0.01, 1e-5])
    found = integrate(
        OrdersChart(step, sigma),
        lambda row, wi, wo, h: np.ones(wo.shape[1:]),
        *(cosines, np.full(5, phi), np.full((5, 2), sigma), False),
        rtol=1e-9,
        atol=0.0,
        limit=400_000,
    )
    assert np.all(np.abs(found.value - math.pi) <= found.error)
    assert np.all(found.error <= 1e-8)


@pytest.mark.parametrize("phi", [0.0, 1.0])
def test_with_more_coherence_lobes_become_orders(phi: float) -> None:
    """Even moments of a Gaussian: what is left falls as the square of the coherence."""
    cosines = np.array([1.0, 0.7, 0.4])
    for p in ({"depth": 0.4}, {"profile": "lamellar", "duty": 0.3, "fresnel": "dielectric"}):
        grating = albedo.model("stam_grating", **p)
        orders = albedo.directional_albedo(grating, cosines, phi).value
        left = []
        for length in (30.0, 300.0):
            lobes = albedo.directional_albedo(grating.replace(coherence=length), cosines, phi)
            left.append(lobes.value / orders - 1.0)
        # By a hundred, but for the fourth moments and where a second derivative nearly vanishes.
        assert np.all(np.abs(left[0]) <= 1e-3)
        np.testing.assert_allclose(left[1], 0.01 * left[0], rtol=0.1, atol=2e-8)


@pytest.mark.parametrize("cos_theta", [1.0, 0.6])
def test_lobes_of_a_grating_by_another_chart(cos_theta: float) -> None:
    """Against a product rule in the angles of V to the normal and about it."""
    model = albedo.model("stam_grating", coherence=0.4, depth=0.3, fresnel="schlick", f0=0.3)
    found = albedo.directional_albedo(model, cos_theta, 0.5, rtol=1e-9)
    x, w = np.polynomial.legendre.leggauss(120)
    theta, weight = 0.25 * math.pi * (x + 1.0), 0.25 * math.pi * w
    phi = 2.0 * math.pi * np.arange(240) / 240
    views = spherical(np.cos(theta)[:, None], phi)
    values = model.eval(spherical(cos_theta, 0.5), views)
    inner = values.mean(1) * 2.0 * math.pi
    total = float(np.sum(inner * weight * np.sin(theta) * np.cos(theta)))
    # 120 nodes and 240 azimuths on lobes of width 0.2: both converge faster than any power.
    assert abs(float(found.value) - total) <= found.error + 1e-11


def test_gratings_of_several_factors_go_into_one_batch() -> None:
    models = [
        albedo.model("stam_grating", coherence=2.0, fresnel=kind)
        for kind in ("white", "dielectric", "gold")
    ]
    both = albedo_rows(models, np.full(3, 0.7), np.zeros(3), rtol=1e-6, atol=0.0)
    for k, model in enumerate(models):
        one = albedo.directional_albedo(model, 0.7, rtol=1e-6)
        assert abs(both.value[k] - one.value) <= both.error[k] + one.error


def test_orders_that_carry_nothing_cost_nothing() -> None:
    """|c_n|^2 is below all numbers from n = 90 on; a direction has something of 1,900 orders."""
    assert stam_grating._last_order(0.0) == 1
    last = stam_grating._last_order(2.0)
    assert mp.besselj(last, 2) ** 2 < mp.mpf("1e-308") < mp.besselj(last // 2, 2) ** 2
    model = albedo.model("stam_grating", period=100.0, coherence=0.1)
    light, view = spherical(0.7, 0.3), spherical(0.4, 2.0)
    known = (list(map(mp.mpf, v.ravel().tolist())) for v in (light, view))
    exact = oracle("stam_grating").brdf(model.parameters, *known)
    # Some hundred terms of one sign, and sines of phases of up to 4.
    assert float(model.eval(light, view).ravel()[0]) == pytest.approx(float(exact), rel=1e-13)


@pytest.mark.parametrize("coherence", [0.1, 0.15])
def test_lobes_of_too_many_orders_are_refused(coherence: float) -> None:
    with pytest.raises(InputError, match=r"must be at least 0\.191"):
        albedo.model("stam_grating", period=100.0, coherence=coherence, profile="lamellar")
    assert albedo.model("stam_grating", period=100.0, coherence=0.2, profile="lamellar").parts()
