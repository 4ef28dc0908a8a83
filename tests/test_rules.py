"""The rules, and how well the bound that they give covers, on integrands of every kind."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pytest

from albedo.integrators.rules import (
    AROUND,
    LADDER,
    RUNGS,
    bounds_around,
    bounds_of,
    gauss,
    midpoint,
)

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


@pytest.mark.parametrize("p", RUNGS)
def test_rules_around_rings_integrate_cosines_exactly(p: int) -> None:
    rule = midpoint(p)
    for k in range(2 * p):
        # Sums of p terms of size one or less, each of an angle of up to 2 pi p.
        assert abs(np.sum(rule.weights * np.cos(np.pi * k * rule.nodes)) - (k == 0)) <= 1e-14 * p
    # The first alias, with its sign.
    alias = np.sum(rule.weights * np.cos(2.0 * np.pi * p * rule.nodes))
    assert alias == pytest.approx(-1.0, abs=1e-14 * p)


@pytest.mark.parametrize("p", RUNGS)
def test_coefficients_are_those_of_the_cosine_series(p: int) -> None:
    rule = midpoint(p)
    for k in range(p):
        values = np.cos(np.pi * k * rule.nodes)
        # p terms of size up to 2/p, each of an angle of up to pi p.
        np.testing.assert_allclose(values @ rule.to_coefficients, np.eye(p)[k], atol=1e-14 * p)


def _around() -> dict[str, Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]]:
    """What rings hold, of a width w and a place, as functions of half the angle around."""
    return {
        "pole": lambda t, w, place: 1.0 / (w * w + np.sin(t - place) ** 2),
        "double pole": lambda t, w, place: (w * w + np.sin(t - place) ** 2) ** -2.0,
        "branch": lambda t, w, place: (w * w + np.sin(t - place) ** 2) ** -0.5,
        "bell": lambda t, w, place: np.exp(-((np.sin(t - place) / w) ** 2)),
        "bell on a pole": lambda t, w, place: (
            10.0 * np.exp(-3.0 * np.sin(t) ** 2) + 1.0 / (1.0 + (np.sin(t - place) / w) ** 2)
        ),
    }


def _passed(p: int, width: np.ndarray, place: np.ndarray) -> dict[str, np.ndarray]:
    """Which errors pass the bounds to stop on and to report, shape (COUNT, 2), of all families."""
    rule, fine, room = midpoint(p), midpoint(4096), np.empty(p)
    passed = {}
    for name, f in _around().items():

        def values(x: np.ndarray, f: Callable[..., np.ndarray] = f) -> np.ndarray:
            t = 0.5 * np.pi * x[None, :]
            return f(t, width[:, None], place[:, None]) + f(t, width[:, None], -place[:, None])

        coefficients = values(rule.nodes) @ rule.to_coefficients
        error = np.abs(coefficients[:, 0] - values(fine.nodes) @ fine.weights)
        # The reference adds up some thousand values.
        floor = 2e-14 * np.abs(coefficients[:, 0])
        farthest = AROUND["entire" if name == "bell" else "smooth"]
        bound = np.array([bounds_around(row, farthest, room) for row in coefficients])
        passed[name] = error[:, None] > bound + floor[:, None]
    return passed


@pytest.mark.parametrize("p", [p for p in RUNGS if p >= 6])
def test_the_bound_covers_the_error_around_rings(p: int, rng: np.random.Generator) -> None:
    """Peaks at either end, as wide as a step or more: narrower ones may not be seen."""
    place = rng.choice([0.0, 0.5 * np.pi], COUNT)
    for name, passed in _passed(p, np.geomspace(1.0 / p, 3.0, COUNT), place).items():
        assert not passed[:, 0].any(), (name, "to stop on")
        assert passed[:, 1].mean() <= 0.02, (name, "to report")


@pytest.mark.parametrize("p", [p for p in RUNGS if p >= 8])
def test_the_bound_covers_most_errors_of_peaks_anywhere(p: int, rng: np.random.Generator) -> None:
    """Charts promise that there are none; two steps wide, up to 4 of 4,000 pass."""
    place = rng.uniform(0.0, 0.5 * np.pi, COUNT)
    for name, passed in _passed(p, np.geomspace(2.0 / p, 3.0, COUNT), place).items():
        assert passed[:, 0].mean() <= 0.005, name


def test_last_coefficients_around_rings_are_not_believed() -> None:
    """About a node between two, cosine series seem to fall to nothing at their last coefficient."""
    rule, w = midpoint(64), 0.01
    values = 1.0 / (w * w + np.sin(0.5 * np.pi * rule.nodes) ** 2)
    found = values @ rule.to_coefficients
    # The mean over the ring in closed form.
    error = abs(found[0] - 1.0 / (w * np.sqrt(1.0 + w * w)))
    assert error > 0.1 * found[0]
    assert bounds_around(found, AROUND["entire"], np.empty(64))[0] > error > bounds_of(found)[0]


def test_series_of_nothing_around_rings_have_no_error() -> None:
    for p in (6, 20, 64):
        constant = np.eye(p)[0]
        for farthest in AROUND.values():
            assert bounds_around(constant, farthest, np.empty(p)) == (0.0, 0.0)
            assert np.isinf(bounds_around(np.full(p, np.inf), farthest, np.empty(p))[0])
