"""The distribution-based BRDF: closed forms at normal and grazing incidence, and its inversion."""

from __future__ import annotations

import math

import numpy as np
import pytest
from exact import Number, mp, oracle

import albedo
from albedo.catalogue.distribution_brdf import recover_distribution, solid_angle
from albedo.directions import spherical
from albedo.quadrature import albedo_rows

EPS = np.finfo(float).eps


def build(**values: object) -> albedo.Model:
    return albedo.model("distribution_brdf", **values)


@pytest.mark.parametrize("n", [0.0, 3.0, 50.0, 1e5])
def test_normal_incidence_in_closed_form(n: float) -> None:
    """n.l = 1 leaves f = p/4: with c = n.h, the integral of (n+2)/(2 pi) c^n (2 c^2 - 1) (c) dh."""
    found = albedo.directional_albedo(build(distribution="blinn_phong", n=n), 1.0, rtol=1e-12)
    # V is above the horizon for c^2 > 1/2: the integral of (n + 2) c^(n + 1) (2 c^2 - 1).
    low = math.sqrt(0.5)
    exact = 2.0 * (n + 2.0) / (n + 4.0) * (1.0 - low ** (n + 4.0)) - (1.0 - low ** (n + 2.0))
    assert abs(found.value - exact) <= found.error + 4 * EPS


@pytest.mark.parametrize("m", [0.1, 1.0, 3.0])
def test_grazing_incidence_in_closed_form(m: float) -> None:
    """f n.v = p/4 at n.l = 0: the mean of max(0, slope), m/2 and m/(2 sqrt(pi))."""
    for kind, exact in (("ggx", 0.5 * m), ("beckmann", 0.5 * m / math.sqrt(math.pi))):
        found = albedo.directional_albedo(build(distribution=kind, m=m), 0.0)
        assert abs(found.value - exact) <= found.error + 4 * EPS
        # Over solid angle the same, divided by the integral of D.
        less = build(distribution=kind, m=m, normalization="solid_angle")
        found = albedo.directional_albedo(less, 0.0)
        assert abs(found.value - exact / solid_angle(kind, m)) <= found.error + 8 * EPS


@pytest.mark.parametrize("kind", ["beckmann", "ggx"])
@pytest.mark.parametrize("m", [1e-3, 0.5, 1.0 - 1e-6, 1.0, 1.0 + 1e-6, 4.0])
def test_the_integral_over_solid_angle(kind: str, m: float) -> None:
    """In x = tan^2: dh = pi dx/(1 + x)^(3/2), here substituted x = m^2 t/(1 - t)."""
    t, w = np.polynomial.legendre.leggauss(400)
    # u^2 = 1 - t takes the root at the horizon away.
    u, w = 0.5 * (t + 1.0), 0.5 * w
    t = (1.0 - u) * (1.0 + u)
    x = m * m * t / (u * u)
    shape = np.exp(-x / (m * m)) * (1.0 + x) ** 2 if kind == "beckmann" else None
    if shape is None:
        shape = ((1.0 + x) / (1.0 + x / (m * m))) ** 2
    density = shape / (math.pi * m * m)
    total = np.sum(w * density * math.pi * (1.0 + x) ** -1.5 * m * m * 2.0 / u**3)
    # 400 nodes: spectral in u for ggx; exp(-1/u^2) at u = 0 is smooth but not analytic.
    assert total == pytest.approx(solid_angle(kind, m), rel=1e-12)


def test_velvet_has_a_projected_integral_of_1() -> None:
    """The retro-reflection gives p back; its integral over n.h is 1 for any spread."""
    for spread in (0.05, 0.5, 10.0):
        model = build(distribution="velvet", spread=spread)
        x, w = np.polynomial.legendre.leggauss(600)
        # In the angle of h; the hairs set in where tan(angle) is about 1/spread.
        angle, w = 0.25 * math.pi * (x + 1.0), 0.25 * math.pi * w
        up = spherical(np.cos(angle), 0.0)
        p = recover_distribution(model.eval(up, up), np.cos(angle))
        total = np.sum(w * p * 2.0 * math.pi * np.sin(angle) * np.cos(angle))
        # Gauss-Legendre of 600 nodes on a function that is smooth on the scale of the spread.
        assert total == pytest.approx(1.0, rel=1e-10)


@pytest.mark.parametrize(
    "values",
    [{"m": 0.3}, {"m": 0.3, "distribution": "ggx"}, {"distribution": "blinn_phong", "n": 9.0}],
)
def test_the_distribution_comes_back_from_retro_reflection(values: dict) -> None:
    f0 = 0.3
    model = build(fresnel="schlick", f0=f0, **values)
    cosines = np.array([1.0, 0.9, 0.5, 0.2])
    up = spherical(cosines, 0.4)
    p = recover_distribution(model.eval(up, up), cosines, f0)
    # As a microfacet distribution: f = D/(4 n.l n.v) with G = F = 1.
    names = {"n" if "n" in values else "m": values.get("n", values.get("m"))}
    facets = albedo.model(
        "cook_torrance",
        geometry="none",
        distribution=values.get("distribution", "beckmann"),
        **names,
    )
    expected = 4.0 * facets.eval(up, up) * cosines**2
    # Slopes of raw directions at the steepest, tan = 5, behind an exponent of 270.
    np.testing.assert_allclose(p, expected, rtol=2000 * EPS)


def test_a_density_over_solid_angle_bounds_the_albedo() -> None:
    """a <= the integral of p (v.h) <= 1, also where a projected integral of 1 does not."""
    cosines = np.array([1.0, 0.5, 0.1, 1e-3, 1e-9])
    for kind in ("beckmann", "ggx"):
        bad = albedo.directional_albedo(build(distribution=kind, m=8.0), cosines)
        assert bad.value.max() > 1.0
        good = build(distribution=kind, m=8.0, normalization="solid_angle")
        found = albedo.directional_albedo(good, cosines)
        assert np.all(found.value + found.error < 1.0)


def test_what_cannot_be_recovered_is_refused() -> None:
    with pytest.raises(albedo.InputError, match=r"cos_theta = .* \(0, 1\]"):
        recover_distribution([1.0], [0.0])
    with pytest.raises(albedo.InputError, match="f0 = 0"):
        recover_distribution([1.0], [0.5], 0.0)
    with pytest.raises(albedo.InputError, match="needs one roughness"):
        build(alpha_x=0.1, alpha_y=0.2, normalization="solid_angle")


def test_a_table_that_was_measured_gives_its_retro_reflection_back() -> None:
    base = build(m=0.3, distribution="ggx", fresnel="schlick", f0=0.2)
    angles = np.linspace(0.0, 1.45, 30)
    up = spherical(np.cos(angles), 0.7)
    measured = base.eval(up, up)
    p = recover_distribution(measured, np.cos(angles), 0.2)
    table = tuple(zip(angles.tolist(), p.tolist(), strict=True))
    model = build(
        distribution="tabulated", density=table, normalization="as_given", fresnel="schlick", f0=0.2
    )
    # At the knots a spline is its data; raw directions cost a few roundings of slopes up to 8.
    np.testing.assert_allclose(model.eval(up, up), measured, rtol=1000 * EPS)
    cosines = np.array([1.0, 0.8, 0.5, 0.2])
    ours = albedo.directional_albedo(model, cosines, rtol=1e-6)
    other = albedo.directional_albedo(base, cosines, rtol=1e-6)
    # Knots 0.05 apart on a lobe of width 0.3: a fourth power of 1/6, over 384, times 24 and more.
    np.testing.assert_allclose(ours.value, other.value, rtol=1e-3)


@pytest.mark.parametrize("normalization", ["projected", "solid_angle", "as_given"])
def test_a_table_at_normal_incidence_is_one_integral(normalization: str) -> None:
    """n.l = 1 leaves f = p/4, and dV n.v = 4 c (2 c^2 - 1) dh with c = n.h."""
    density = oracle("distribution_brdf").FALLING
    table = oracle("distribution_brdf").tabulated
    model = build(distribution="tabulated", density=density, normalization=normalization)
    found = albedo.directional_albedo(model, 1.0, rtol=1e-9)

    def height(a: Number) -> Number:
        return table(density, a) * 2 * mp.pi * mp.sin(a) * mp.cos(a) * mp.cos(2 * a)

    ends = sorted({mp.zero, mp.pi / 4} | {mp.mpf(a) for a, _ in density if a < math.pi / 4})
    whole = oracle("distribution_brdf").tabulated_whole(density, normalization)
    assert abs(float(found.value - mp.quad(height, ends) / whole)) <= found.error
    assert found.converged


def test_a_table_of_a_constant_is_a_distribution_of_roughness_one() -> None:
    cosines = np.array([1.0, 0.4, 1e-3, 0.0])
    flat = albedo.directional_albedo(build(distribution="tabulated"), cosines)
    ggx = albedo.directional_albedo(build(distribution="ggx", m=1.0), cosines)
    assert np.all(np.abs(flat.value - ggx.value) <= flat.error + ggx.error)


def test_tables_of_several_lengths_go_into_one_batch() -> None:
    tables = [((0.0, 2.0), (1.0, 0.1)), ((0.0, 2.0), (0.5, 0.7), (1.0, 0.1))]
    models = [build(distribution="tabulated", density=table) for table in tables]
    cosines = np.array([0.9, 0.9])
    both = albedo_rows(models, cosines, np.zeros(2), rtol=1e-6, atol=0.0)
    for k, model in enumerate(models):
        one = albedo.directional_albedo(model, 0.9, rtol=1e-6)
        assert abs(both.value[k] - one.value) <= both.error[k] + one.error


def test_tables_that_are_none_are_refused() -> None:
    for density in (((0.0, 1.0),), ((0.1, 1.0), (0.1, 2.0)), ((0.5, 1.0), (0.1, 2.0))):
        with pytest.raises(albedo.InputError, match="at least two, in ascending order"):
            build(distribution="tabulated", density=density)
    with pytest.raises(albedo.InputError, match=r"density\[1\].p = 0 is out of range"):
        build(distribution="tabulated", density=((0.0, 1.0), (1.0, 0.0)))
    with pytest.raises(albedo.InputError, match="is for distribution = 'tabulated'"):
        build(normalization="as_given")
