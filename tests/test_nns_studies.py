"""What the studies of NNS's figure 2 and eq. 7 compute, against raw vectors and closed forms."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy.integrate import dblquad, quad

import albedo
from albedo.analysis import critical_region
from albedo.studies import StudyFile

STUDIES = Path(__file__).parent.parent / "studies"
EPS = float(np.finfo(float).eps)
# The sum l + v may be as short as 0.02 here; what is read from it rounds by its inverse square.
RAW = 4.0 * EPS / 0.02**2
# Elevations of L, from normal to grazing, on both sides of 30 and 45 degrees; and caps.
ELEVATIONS = (1.57, 1.2, 0.79, 0.6, 0.5, 0.2, 0.02)
SETS = ((True, None), (False, 0.17), (True, 0.17), (True, 0.5), (False, 0.9))


def load(name: str) -> ModuleType:
    StudyFile(STUDIES / f"{name}.py").load()
    return sys.modules[f"albedo_study_{name}"]


@pytest.fixture(scope="module")
def fig2() -> ModuleType:
    return load("nns_fig2")


@pytest.fixture(scope="module")
def scaled() -> ModuleType:
    return load("nns_scaled_lobe")


def uniform(count: int, rng: np.random.Generator) -> np.ndarray:
    """Directions on the hemisphere, uniform in solid angle."""
    z, phi = rng.uniform(0.0, 1.0, count), rng.uniform(0.0, 2.0 * math.pi, count)
    s = np.sqrt(1.0 - z**2)
    return np.stack((s * np.cos(phi), s * np.sin(phi), z), axis=-1)


def raw(elevation: float, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The least of eq. 10's two ratios, and n.h, from the vectors themselves."""
    light = np.array([math.cos(elevation), 0.0, math.sin(elevation)])
    h = light + v
    h /= np.linalg.norm(h, axis=-1, keepdims=True)
    v_dot_h = np.sum(v * h, axis=-1)
    return 2.0 * h[..., 2] * np.minimum(v[..., 2], light[2]) / v_dot_h, h[..., 2]


def inside(elevation: float, g_one: bool, cap: float | None, v: np.ndarray) -> np.ndarray:
    """Distance to the boundary in terms of the conditions; negative outside."""
    ratio, n_dot_h = raw(elevation, v)
    margin = np.full(ratio.shape, np.inf)
    if g_one:
        margin = ratio - 1.0
    if cap is not None:
        margin = np.minimum(margin, n_dot_h - math.cos(cap))
    return margin


@pytest.mark.parametrize("elevation", ELEVATIONS)
@pytest.mark.parametrize(("g_one", "cap"), SETS)
def test_sets_are_those_of_the_raw_vectors(elevation, g_one, cap, rng):
    region = critical_region.Region(elevation, g_one, cap)
    v = uniform(4000, rng)
    psi = np.abs(math.pi - np.abs(np.arctan2(v[:, 1], v[:, 0])))
    margin = inside(elevation, g_one, cap, v)
    clear = np.abs(margin) > RAW
    assert clear.sum() > 3900
    np.testing.assert_array_equal((psi <= region.half_width(v[:, 2]))[clear], (margin > 0.0)[clear])
    low, *_, high = region.edges()
    belong = (margin > 0.0) & clear
    assert np.all((v[belong, 2] >= low) & (v[belong, 2] <= high))
    # The same set by the slopes of H.
    h = v + np.array([math.cos(elevation), 0.0, math.sin(elevation)])
    x, y = h[:, 0] / h[:, 2], h[:, 1] / h[:, 2]
    first, *_, last = region.slope_edges()
    there = (np.abs(y) <= region.slope_limit(x)) & (x >= first) & (x <= last)
    np.testing.assert_array_equal(there[clear], (margin > 0.0)[clear])


@pytest.mark.parametrize("elevation", ELEVATIONS)
@pytest.mark.parametrize(("g_one", "cap"), SETS)
def test_outlines_lie_on_the_boundary(elevation, g_one, cap):
    z, psi = critical_region.outline(critical_region.Region(elevation, g_one, cap))
    s = np.sqrt((1.0 - z) * (1.0 + z))
    v = np.stack((-s * np.cos(psi), s * np.sin(psi), z), axis=-1)
    margin = inside(elevation, g_one, cap, v)
    # On the horizon the boundary is the horizon itself.
    assert np.all(np.abs(margin[z > 0.0]) <= RAW)


@pytest.mark.parametrize("elevation", [*ELEVATIONS, 1e-4, 1e-8, 1e-12])
@pytest.mark.parametrize(("g_one", "cap"), SETS)
@pytest.mark.parametrize("m", [None, 0.1, 0.4])
def test_two_ways_give_one_integral(elevation, g_one, cap, m):
    region = critical_region.Region(elevation, g_one, cap)
    value, error = critical_region.over_slopes(region, m)
    other, more = critical_region.over_hemisphere(region, m)
    assert abs(value - other) <= error + more
    assert error + more <= 1e-8 * value


def test_solid_angles_and_light_against_draws(rng):
    count, tests = 200_000, 2 * 4
    # A level of 1e-3 for all tests together, two-sided, by the normal distribution.
    widest = 3.95
    assert math.erfc(widest / math.sqrt(2.0)) < 1e-3 / tests
    for elevation in (0.9, 0.4, 0.15, 0.05):
        v = uniform(count, rng)
        light = np.array([math.cos(elevation), 0.0, math.sin(elevation)])
        belong = inside(elevation, True, None, v) > 0.0
        f = albedo.model("cook_torrance", m=0.4, geometry="none").eval(light, v)
        for drawn, m in ((belong.astype(float), None), (belong * f * v[:, 2], 0.4)):
            value, _ = critical_region.measure(critical_region.Region(elevation, g_one=True), m)
            mean, spread = 2.0 * math.pi * drawn.mean(), 2.0 * math.pi * drawn.std()
            assert abs(mean - value) <= widest * spread / math.sqrt(count)


def test_closed_forms_of_solid_angles():
    normal = 0.5 * math.pi
    for region, exact in (
        (critical_region.Region(normal, g_one=True), math.pi),
        (critical_region.Region(normal, cap=0.2), 2.0 * math.pi * (1.0 - math.cos(0.4))),
        (critical_region.Region(0.7), 2.0 * math.pi),
        # H of L on the horizon in half of a cap; the rest is of the order of the elevation.
        (critical_region.Region(1e-13, cap=0.2), 4.0 * 0.2 - 2.0 * math.sin(0.4)),
    ):
        value, error = critical_region.measure(region)
        assert abs(value - exact) <= error + 1e-12


def test_the_limit_of_the_set_with_g_one():
    # 2 w of the limiting outline, in pieces that are smooth but for roots at an end.
    upper, upper_error = quad(lambda t: 2.0 * math.sqrt(4.0 - (t - 1.0) ** 2), 1.0, 3.0)
    lower, lower_error = quad(lambda t: 2.0 * math.sqrt(3.0 * t**2 + 2.0 * t - 1.0), 1 / 3, 1.0)
    assert abs(upper + lower - critical_region.LIMIT) <= upper_error + lower_error
    c = math.sin(1e-9)
    value, error = critical_region.measure(critical_region.Region(1e-9, g_one=True))
    # The rest is of the order of c^2.
    assert (
        abs(value / c**2 - critical_region.LIMIT)
        <= error / c**2 + 8.0 * EPS * critical_region.LIMIT
    )


@pytest.mark.parametrize("elevation", [1.2, 0.5, 0.2])
def test_the_whole_hemisphere_reflects_the_albedo(elevation):
    model = albedo.model("cook_torrance", m=0.4, geometry="none")
    exact = albedo.directional_albedo(model, math.sin(elevation), rtol=1e-10)
    value, error = critical_region.measure(critical_region.Region(elevation), 0.4)
    assert abs(value - float(exact.value)) <= error + float(exact.error)


def test_the_arc_keeps_half_vectors_in_the_cap(fig2, rng):
    v = uniform(20_000, rng)
    v = v[v[:, 2] < 0.4]
    arc = np.linspace(0.0, math.radians(90.0 - fig2.FIRST), 65)
    margin = np.min([inside(float(e), False, fig2.CAP, v) for e in arc], axis=0)
    psi = np.abs(math.pi - np.abs(np.arctan2(v[:, 1], v[:, 0])))
    clear = np.abs(margin) > RAW
    found = psi <= fig2.on_arc(fig2.FIRST, fig2.CAP, v[:, 2])
    np.testing.assert_array_equal(found[clear], (margin > 0.0)[clear])
    assert found.any()


@pytest.mark.parametrize(("n", "s"), [(20.0, 0.9), (20.0, 0.98), (5.0, 0.95)])
def test_a_lift_against_the_raw_lobe(n, s):
    def raw_albedo(theta: float) -> tuple[float, float]:
        sine, cosine = math.sin(theta), math.cos(theta)

        def lobe(phi: float, z: float) -> float:
            r = math.sqrt(1.0 - z * z)
            return max(0.0, sine * r * math.cos(phi) + s * cosine * z) ** n * z

        value, error = dblquad(lobe, 0.0, 1.0, 0.0, math.pi, epsabs=1e-9, epsrel=1e-8)
        return value, error

    model = albedo.model("lafortune_scaled", n=n, s=s)
    high, low = raw_albedo(math.radians(80.0)), raw_albedo(0.0)
    found = albedo.directional_albedo(model, np.cos(np.radians((80.0, 0.0))))
    ratio = high[0] / low[0]
    spread = (high[1] + ratio * low[1]) / low[0]
    value = found.value[0] / found.value[1]
    error = (found.error[0] + value * found.error[1]) / found.value[1]
    # Twice: the intervals of both ratios to first order.
    assert abs(value - ratio) <= 2.0 * (error + spread)


def test_peaks_are_the_largest_radiance(scaled):
    peaks = scaled.measure_peaks()
    assert np.all(peaks["peak_error"] < 1e-10 * peaks["peak"])
    for row in peaks[peaks["n"] == 20.0].to_dict("records"):
        angles = np.linspace(0.0, 90.0, 9001)
        values = scaled.radiance(scaled.lobe(row["n"], row["s"]), row["theta_deg"], angles)
        assert values.max() <= row["peak"] + row["peak_error"]
        assert abs(angles[np.argmax(values)] - row["peak_at_deg"]) <= 0.01
        exact = math.degrees(math.atan(math.tan(math.radians(row["theta_deg"])) / row["s"]))
        # An arc tangent of a large number, in degrees.
        assert abs(exact - row["peak_at_deg"]) <= 64.0 * EPS * exact
