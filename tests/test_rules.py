"""The rules, and how well the bound that they give covers, on integrands of every kind."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pytest

from albedo.integrators.rules import LADDER, bounds_of, gauss

COUNT = 400


def spectrum_bound(coefficients: np.ndarray) -> np.ndarray:
    """Bounds of many spectra, shape (m, 2)."""
    return np.array([bounds_of(row) for row in coefficients])


def _families(rng: np.random.Generator) -> dict[str, Callable[[np.ndarray], np.ndarray]]:
    """Families of COUNT integrands on [0, 1]: poles, bells, layers, waves, roots at an end."""

    def column(low: float, high: float) -> np.ndarray:
        return rng.uniform(low, high, COUNT)[:, None]

    place, sharp = column(-0.3, 1.3), 10.0 ** column(-1.3, 1.0)
    rate, length = column(-25.0, 25.0), column(0.5, 8.0)
    wave, phase = column(0.0, 20.0), column(0.0, 6.0)
    width, power = 10.0 ** column(-0.5, 1.0), column(0.1, 2.0)
    return {
        "pole": lambda x: 1.0 / ((x - place) ** 2 + sharp**2),
        "bell": lambda x: np.exp(-(((x - place) / width) ** 2)),
        "layer": lambda x: np.exp(rate * (x - (rate > 0))),
        "wave": lambda x: 1.0 + np.cos(wave * x + phase),
        "heavy tail": lambda x: np.sinh(length * x) * np.cosh(length * x) ** -3.0,
        "root": lambda x: np.sqrt(x + 10.0 ** (6.0 * place.clip(-0.3, 0.0) / 0.3)),
        "power": lambda x: x**power,
    }


def _reference(f: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Composite Gauss rule, graded towards 0; good to about 1e-15 for every family."""
    edges = np.unique(np.concatenate((np.linspace(0, 1, 101), 2.0 ** -np.arange(1.0, 60.0))))
    rule = gauss(16)
    return sum(
        (f(a + (b - a) * rule.nodes[None, :]) * rule.weights).sum(1) * (b - a)
        for a, b in itertools.pairwise(edges)
    )


@pytest.mark.parametrize("p", LADDER)
def test_rules_integrate_polynomials_exactly(p: int) -> None:
    rule = gauss(p)
    assert np.all(rule.weights > 0)
    for degree in range(2 * p):
        # Sums of p positive terms: a few roundings.
        assert np.sum(rule.weights * rule.nodes**degree) == pytest.approx(
            1.0 / (degree + 1), rel=1e-14
        )


@pytest.mark.parametrize("p", LADDER)
def test_coefficients_are_those_of_the_legendre_series(p: int) -> None:
    rule = gauss(p)
    x = 2.0 * rule.nodes - 1.0
    for k in range(p):
        values = np.polynomial.legendre.Legendre.basis(k)(x)
        # p terms of size up to 2k + 1.
        np.testing.assert_allclose(values @ rule.to_coefficients, np.eye(p)[k], atol=1e-13)


@pytest.mark.parametrize("p", [p for p in LADDER if p >= 6])
def test_the_bound_covers_the_error(p: int, rng: np.random.Generator) -> None:
    rule = gauss(p)
    for name, f in _families(rng).items():
        values = f(rule.nodes[None, :]) * np.ones((COUNT, 1))
        coefficients = values @ rule.to_coefficients
        error = np.abs(coefficients[:, 0] - _reference(f))
        # The composite reference sums some hundred panels.
        floor = 2e-14 * np.abs(values).mean(1)
        bound = spectrum_bound(coefficients)
        assert np.all(error <= bound[:, 0] + floor), (name, "to stop on")
        # The one to report is a bound for typical spectra, not for the best-looking of many.
        assert np.mean(error > bound[:, 1] + floor) <= 0.02, (name, "to report")


def test_a_kink_inside_is_covered(rng: np.random.Generator) -> None:
    place = rng.uniform(0.05, 0.95, COUNT)[:, None]
    for p in (8, 12, 20, 32):
        rule = gauss(p)
        coefficients = np.abs(rule.nodes[None, :] - place) @ rule.to_coefficients
        exact = 0.5 * (place**2 + (1 - place) ** 2)[:, 0]
        bound = spectrum_bound(coefficients)[:, 0]
        assert np.all(np.abs(coefficients[:, 0] - exact) <= bound)


def test_a_wrong_weight_shows_in_the_spectrum() -> None:
    rule = gauss(16)
    spoiled = rule.to_coefficients.copy()
    spoiled[5] *= 1.01
    values = np.exp(rule.nodes)[None, :]
    found = values @ spoiled
    error = abs(found[0, 0] - np.expm1(1.0))
    assert error > 1e-4
    assert spectrum_bound(found)[0, 0] > error


def test_values_that_are_not_finite_have_no_bound() -> None:
    assert np.isinf(spectrum_bound(np.full((1, 12), np.inf)))[0, 0]
