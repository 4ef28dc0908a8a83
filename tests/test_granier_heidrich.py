"""Granier and Heidrich's model: closed forms at normal incidence and without refraction."""

from __future__ import annotations

import math

import numpy as np
import pytest
from exact import mp, phong

import albedo
from albedo.fresnel import dielectric, dielectric_transmittance

EPS = np.finfo(float).eps


def interference(n: float, thickness: float, wavelength: float) -> float:
    """J_d at 40 digits."""
    n = mp.mpf(n)
    t = mp.mpf(80) / 21 * n / (n + 1) ** 2
    phase = 4 * mp.pi * n * mp.mpf(thickness) / mp.mpf(wavelength)
    return float((1 + 2 * mp.cos(phase) * mp.sqrt(t * (1 - t))) / 2)


@pytest.mark.parametrize("n", [1.0, 1.3, 2.0, 10.0])
def test_what_is_transmitted_is_not_reflected(n: float) -> None:
    for u in (1.0, 0.5, 0.1, 1e-3):
        # 1 - F rounds F, which is near 1, and the exact equations round a dozen times.
        assert abs(dielectric_transmittance(n, u) + dielectric(n, u) - 1.0) <= 32 * EPS


def test_no_node_on_the_horizon_spoils_a_layer_that_does_not_refract() -> None:
    """Without refraction F(0) is 0/0, and rounding puts nodes at n.v = 0."""
    assert dielectric_transmittance(1.0, 0.0) == 0.0
    model = albedo.model("granier_heidrich", ior=1.0, e0=0.0, e1=4.0)
    found = albedo.directional_albedo(model, [1e-6, 1e-9, 1e-12])
    assert np.all(found.converged)


@pytest.mark.parametrize("n", [1.3, 1.5, 4.0])
def test_diffuse_transmittance_is_that_of_duntley(n: float) -> None:
    """The integral of 2 u T(u), with the closed form of 1942."""
    mean = (
        0.5
        + (n - 1) * (3 * n + 1) / (6 * (n + 1) ** 2)
        + n**2 * (n**2 - 1) ** 2 / (n**2 + 1) ** 3 * math.log((n - 1) / (n + 1))
        - 2 * n**3 * (n**2 + 2 * n - 1) / ((n**2 + 1) * (n**4 - 1))
        + 8 * n**4 * (n**4 + 1) / ((n**2 + 1) * (n**4 - 1) ** 2) * math.log(n)
    )
    x, w = np.polynomial.legendre.leggauss(60)
    u = 0.5 * (x + 1.0)
    total = sum(
        0.5 * b * 2.0 * a * dielectric_transmittance(n, a) for a, b in zip(u, w, strict=True)
    )
    # The closed form cancels a digit or two.
    assert total == pytest.approx(1.0 - mean, abs=1e-13)


@pytest.mark.parametrize(("n", "e1"), [(1.1, 4.0), (1.5, 20.0), (4.0, 300.0)])
def test_normal_incidence_is_a_single_integral(n: float, e1: float) -> None:
    """Top: F(1) 2 pi/(e0 + 2). Base: the refracted ray of V makes the angle cos = g(u)/n."""
    model = albedo.model("granier_heidrich", ior=n, e0=50.0, e1=e1, k_d=0.7, color=0.5)
    found = albedo.directional_albedo(model, 1.0, rtol=1e-10)
    assert found.converged

    def base(u: mp.mpf) -> mp.mpf:
        g = mp.sqrt(mp.mpf(n) ** 2 - 1 + u * u)
        reflected = (((u - g) / (u + g)) ** 2 + ((n**2 * u - g) / (n**2 * u + g)) ** 2) / 2
        return (1 - reflected) * (g / n) ** e1 * u

    f0 = ((n - 1.0) / (n + 1.0)) ** 2
    exact = 0.7 * 0.5 * interference(n, 0.5, 0.525) + f0 * 2.0 * math.pi / 52.0
    exact += float((1.0 - f0) * 2 * mp.pi * mp.quad(base, [0, 0.5, 0.9, 1]))
    assert abs(found.value - exact) <= found.error + 8 * EPS


@pytest.mark.parametrize("cos_theta", [0.9, 0.3, 0.01])
def test_without_refraction_the_base_is_phongs(cos_theta: float) -> None:
    model = albedo.model("granier_heidrich", ior=1.0, e1=30.0, normalization="phong")
    assert model.reciprocal
    found = albedo.directional_albedo(model, cos_theta)
    exact = interference(1.0, 0.5, 0.525) + phong(30.0, cos_theta)
    assert abs(found.value - exact) <= found.error + 8 * EPS


def test_wavelengths_are_channels() -> None:
    bands = (0.645, 0.525, 0.445)
    model = albedo.model("granier_heidrich", wavelength=bands, ior=(1.4, 1.7, 2.0), k_s=0.0)
    found = albedo.directional_albedo(model, 0.5)
    for k, (n, wavelength) in enumerate(zip((1.4, 1.7, 2.0), bands, strict=True)):
        assert abs(found.value[k] - interference(n, 0.5, wavelength)) <= found.error[k] + 4 * EPS


def test_the_phase_of_a_thick_layer_keeps_its_digits() -> None:
    """A thousand micrometres are 5,700 periods, of which the last fraction counts."""
    model = albedo.model("granier_heidrich", thickness=1000.0, k_s=0.0)
    found = albedo.directional_albedo(model, 0.5)
    assert abs(found.value - interference(1.5, 1000.0, 0.525)) <= found.error + 4 * EPS


def test_where_it_reflects_more_than_it_receives() -> None:
    """Refraction widens the base's lobe: its constant is n^2 too large at normal incidence."""
    model = albedo.model("granier_heidrich", e0=1e4, e1=1e4, k_d=0.0, normalization="phong")
    found = albedo.directional_albedo(model, 1.0)
    f0 = 0.04
    # Narrow lobes, up to 1/e of curvature.
    assert found.value == pytest.approx(f0 + 1.5**2 * (1.0 - f0) ** 2, rel=1e-3)
    assert found.value - found.error > 1.0
