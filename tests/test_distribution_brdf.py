"""The distribution-based BRDF: closed forms at normal and grazing incidence, and its inversion."""

from __future__ import annotations

import math

import numpy as np
import pytest

import albedo
from albedo.catalogue.distribution_brdf import recover_distribution, solid_angle
from albedo.directions import spherical

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
