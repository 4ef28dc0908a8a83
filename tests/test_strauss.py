"""Strauss's model: its published factors, closed forms, and the chart that knows its cap."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from exact import mp
from test_models import pure

import albedo
from albedo.catalogue._phong import mirror_chart
from albedo.catalogue.strauss import cap_elevation, edge_reflection, edge_shadow
from albedo.charts.parallels import ParallelsChart
from albedo.integrators.rules import gauss

EPS = np.finfo(float).eps


@pytest.mark.parametrize(("x", "f"), [(0.0, 0.0), (0.5, 0.02628), (0.75, 0.09479), (0.9, 0.28936)])
def test_published_values_of_the_reflection_at_edges(x: float, f: float) -> None:
    # Five decimals are printed.
    assert edge_reflection(x) == pytest.approx(f, abs=5e-6)


@pytest.mark.parametrize(("x", "g"), [(0.0, 1.0), (0.9, 0.99183), (0.99, 0.75007), (1.0, 0.0)])
def test_published_values_of_the_shadow_at_edges(x: float, g: float) -> None:
    assert edge_shadow(1.0 - x) == pytest.approx(g, abs=5e-6)


@pytest.mark.parametrize("s", [0.0, 0.4, 0.8, 0.95, 0.999])
@pytest.mark.parametrize(("m", "t", "c"), [(0.0, 0.0, 1.0), (0.7, 0.3, 0.2)])
def test_normal_incidence_has_a_closed_form(s: float, m: float, t: float, c: float) -> None:
    """F(0) = 0, and the lobe is not clipped: the integral of cos^(e + 1) is 2 pi/(e + 2)."""
    e = 3.0 / (1.0 - s)
    exact = (1.0 - t) * (
        (1.0 - s**3) * (1.0 - m * s) * c + s**3 * (1.0 - m + m * c) * 2.0 / (e + 2.0)
    )
    model = albedo.model("strauss", smoothness=s, metalness=m, transparency=t, color=c)
    for kind, factor in ((model, 1.0), (model.replace(reading="literal"), math.pi)):
        found = albedo.directional_albedo(kind, 1.0, rtol=1e-11)
        assert found.converged
        assert abs(found.value - factor * exact) <= found.error


def test_where_it_reflects_more_than_it_receives() -> None:
    """The lobe is divided by n.l; without one, the limit at grazing incidence exceeds 1 still."""
    with pytest.raises(albedo.DivergenceError, match="strauss"):
        albedo.directional_albedo(albedo.model("strauss"), 0.0)
    low = albedo.directional_albedo(albedo.model("strauss"), [1e-4, 1e-6])
    assert low.value[1] > 50.0 * low.value[0]
    rough = albedo.directional_albedo(albedo.model("strauss", smoothness=0.0), 0.0, rtol=1e-6)
    assert rough.value - rough.error > 2.0


def test_a_clear_surface_conserves_energy_from_some_smoothness_on() -> None:
    for s, conserves in ((0.069, False), (0.07, True)):
        model = albedo.model("strauss", smoothness=s, transparency=1.0)
        assert model.conserves_energy is conserves
        found = albedo.directional_albedo(model, 0.0, rtol=1e-6)
        assert bool(found.value + found.error <= 1.0) is conserves


@pytest.mark.parametrize("r_n", [0.7, 0.9, 0.999])
@pytest.mark.parametrize("cos_theta", [0.3, 0.1, 0.03, 1e-2])
def test_the_cap_is_where_the_chart_is_told(r_n: float, cos_theta: float) -> None:
    """At that elevation the reflectance without the cap is 1, at 40 digits."""
    x = 2 / mp.pi * mp.acos(mp.mpf(cos_theta))
    k_f, k_g = mp.mpf("1.12"), mp.mpf("1.01")
    f = (1 / (x - k_f) ** 2 - 1 / k_f**2) / (1 / (1 - k_f) ** 2 - 1 / k_f**2)

    def g(y: Any) -> Any:
        return (1 / (1 - k_g) ** 2 - 1 / (y - k_g) ** 2) / (1 / (1 - k_g) ** 2 - 1 / k_g**2)

    elevation = cap_elevation((r_n,), cos_theta)
    most = r_n + (r_n + mp.mpf("0.1")) * f * g(x)
    if most <= 1:
        assert elevation > 0.5 * math.pi
        return
    there = r_n + (r_n + mp.mpf("0.1")) * f * g(x) * g(1 - 2 * mp.mpf(elevation) / mp.pi)
    # 1/sqrt(1 - q), q near 1, amplifies a dozen roundings by up to 1/(1 - q) = 1e4.
    assert abs(there - 1) <= 1e5 * EPS


@pytest.mark.parametrize("s", [0.7, 0.9, 0.99])
@pytest.mark.parametrize("cos_theta", [1.0, 0.6, 0.1, 0.01, 1e-6])
@pytest.mark.filterwarnings("ignore::albedo.ConvergenceWarning")
def test_two_charts_agree(s: float, cos_theta: float, monkeypatch: pytest.MonkeyPatch) -> None:
    model = albedo.model("strauss", smoothness=s, metalness=0.5, color=0.3)
    known = albedo.directional_albedo(model, cos_theta, rtol=1e-11)
    assert known.converged
    diffuse, lobe = model.parts()
    assert isinstance(lobe.chart, ParallelsChart)
    polar = replace(lobe, chart=mirror_chart(3.0 / (1.0 - s)))
    monkeypatch.setattr(type(model), "parts", lambda self: (diffuse, polar))
    other = albedo.directional_albedo(model, cos_theta, rtol=1e-6)
    assert abs(known.value - other.value) <= known.error + other.error


def laid_out(
    chart: Any, cos_theta: float, width: float, isotropic: bool, order: int
) -> tuple[Any, ...]:
    geometry, row, code, box = chart.panels(
        np.array([cos_theta]), np.array([0.7]), np.array([[width, width]]), isotropic
    )
    rule = gauss(order)
    return (rule, *chart.nodes(geometry[row], code, box, rule.nodes, rule.nodes))


CHART = ParallelsChart(cap_elevation, (0.9,), 0.0157)


@pytest.mark.parametrize("isotropic", [True, False])
@pytest.mark.parametrize("cos_theta", [1.0, 1 - 1e-12, 0.7, 0.1, 1e-3, 1e-9])
def test_the_weights_of_the_chart_sum_to_pi(cos_theta: float, isotropic: bool) -> None:
    # A lobe so wide that nothing is cut; entire functions of both coordinates.
    rule, wi, wo, h, weight = laid_out(CHART, cos_theta, 0.3, isotropic, 32)
    total = np.sum(weight * np.outer(rule.weights, rule.weights).ravel())
    assert total == pytest.approx(math.pi, rel=100 * EPS)
    assert np.linalg.norm(wo, axis=0) == pytest.approx(1.0, abs=8 * EPS)
    np.testing.assert_allclose(h, wo + wi[:, :, None], rtol=0, atol=8 * EPS)


def test_half_vectors_near_the_mirror_direction_keep_their_digits() -> None:
    _, wi, wo, h, _ = laid_out(CHART, 0.5, 1e-7, True, 8)
    # (l + v).(l - v) = 0 holds for unit vectors; h is 1e-7 of wi there.
    skew = np.sum(h * (wi[:, :, None] - wo), axis=0)
    assert np.max(np.abs(skew)) <= 16 * EPS
    tangent = np.hypot(h[0], h[1])
    assert np.max(tangent) < 1e-5
    # The chord between V and R is that of h_t and of the difference of heights.
    chord = np.sqrt(tangent**2 + (wo[2] - 0.5) ** 2)
    exact = np.linalg.norm(wo - (wi * np.array([[-1.0], [-1.0], [1.0]]))[:, :, None], axis=0)
    assert np.max(np.abs(chord - exact)) <= 8 * EPS


def test_the_compiled_chart_equals_plain_python(monkeypatch: pytest.MonkeyPatch) -> None:
    compiled = laid_out(CHART, 0.1, 0.05, False, 3)
    room = sys.modules[ParallelsChart.__module__]
    monkeypatch.setattr(room, "_nodes", pure(room._nodes))
    plain = laid_out(CHART, 0.1, 0.05, False, 3)
    for a, b in zip(compiled[1:], plain[1:], strict=True):
        # The two libraries' sines differ by an ulp, of angles up to pi.
        np.testing.assert_allclose(a, b, rtol=64 * EPS, atol=8 * EPS)
