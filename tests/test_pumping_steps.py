"""What the studies of pumping-up make their claims of."""

from __future__ import annotations

import math

import numpy as np
import pytest

import albedo
from albedo.analysis import pumping


@pytest.fixture(scope="module")
def steps() -> pumping.Series:
    cosines = np.array([1.0, 0.9, 0.5, 0.1, 1e-3])
    return pumping.series(albedo.model("phong", n=20), 2, cosines=cosines)


def test_a_series_holds_the_albedos_of_its_stages(steps: pumping.Series) -> None:
    assert steps.steps == 2
    for k, stage in enumerate(steps.stages):
        found = albedo.directional_albedo(stage, steps.cosines)
        assert np.all(np.abs(found.value - steps.value[k]) <= found.error + steps.error[k])
        end = albedo.directional_albedo(stage, 1e-12)
        assert abs(end.value - steps.limit[k]) <= end.error + steps.limit_error[k]
    top = steps.most_gained(2, 0)
    assert top.value >= np.max(steps.gain(2, 0)[0]) - top.error
    assert 1e-3 <= top.cos_theta <= 1.0
    gain, error = steps.gain(2, 0)
    np.testing.assert_allclose(gain, steps.value[2] - steps.value[0], rtol=0, atol=0)
    np.testing.assert_allclose(error, steps.error[2] + steps.error[0], rtol=0, atol=0)


def test_tables_of_a_series(steps: pumping.Series) -> None:
    gains = pumping.steps_frame(steps)
    # The first of the angles from ten degrees on is at a cosine of 0.9, and that gains least.
    assert np.all(gains["smallest_gain"] > gains["smallest_gain_error"])
    assert gains["smallest_gain_at_deg"][0] == pytest.approx(math.degrees(math.acos(0.9)))
    assert gains["above_0_from_deg"][0] == pytest.approx(math.degrees(math.acos(0.9)))
    assert list(pumping.albedo_frame(steps).columns[:4]) == [
        "theta_deg",
        "cos_theta",
        "step_0",
        "step_0_error",
    ]
    assert pumping.worthwhile(steps) == (2, 0)
    assert pumping.worthwhile(steps, 0.99) == (0, 0)


def test_peaks_are_told_in_units_of_the_base(steps: pumping.Series) -> None:
    peaks = pumping.find_peaks(steps, np.array([1.0, 0.5, 0.1]))
    asked = np.isin(peaks.cosines, [1.0, 0.5, 0.1])
    ratio, error = (column[asked] for column in peaks.relative(0))
    assert np.all(np.abs(ratio - [1.0, 0.5, 0.1]) <= error)
    # The first step divides by the albedo, which is the cosine but for what the horizon cuts off.
    ratio, error = (column[asked] for column in peaks.relative(1))
    known = np.array([1.0, 0.5, 0.1]) / steps.value[0, [0, 2, 3]]
    assert np.all(np.abs(ratio - known) <= error + 2.0 * steps.error[0, [0, 2, 3]] * known / 0.1)
    assert np.all(peaks.beside_mirror(2)[0] == 1.0)
    # Incidences of the largest of all, to four digits, are among them; a table has those and every
    # other one.
    tops = {top.nearby for top in peaks.tops.values()}
    assert all(abs(top.nearby - top.cos_theta) <= 5e-5 for top in peaks.tops.values())
    frame = peaks.frame()
    assert tops | {0.1, 1.0} <= set(frame["cos_theta"]) <= set(peaks.cosines)
    assert len(frame) == 3 * len(set(frame["cos_theta"]))


def test_the_largest_radiance_of_all_incidences_is_found(steps: pumping.Series) -> None:
    """In the mirror direction it is n.l over the albedos before every step."""
    peaks = pumping.find_peaks(steps, pumping.PEAK_COSINES[::3])
    whole = steps.stages[2]
    # A grid this fine misses a smooth top by its square; the tops have no corner here.
    c = np.geomspace(0.05, 0.5, 20_001)
    product = np.ones(c.size)
    for k in (1, 2):
        product = product * whole.albedo_before(k - 1, c).value
        known = float((c / product).max())
        top = peaks.tops[k]
        assert abs(top.value - max(known, 1.0)) <= top.error + 1e-7 * known
        assert top.error <= 1e-8
    assert peaks.tops[2].value > 1.0 + peaks.tops[2].error + np.max(peaks.relative(0)[1])
    # Over that before any step it is largest where the albedos are smallest.
    assert peaks.gains[2].cos_theta == pytest.approx(peaks.cosines.min())


def test_tops_of_corners_and_of_plateaus() -> None:
    def corner(c: float) -> tuple[float, float]:
        return min(c / 0.3, 0.3 / c) ** 2, 1e-15

    cosines = np.geomspace(1.0, 1e-3, 12)
    top = pumping.top_of(corner, cosines)
    assert abs(top.value - 1.0) <= top.error <= 1e-8
    assert top.cos_theta == pytest.approx(0.3, rel=1e-7)
    flat = pumping.top_of(lambda c: (min(1.0, 2.0 * c), 1e-12), cosines)
    assert flat.value == 1.0
    assert flat.error <= 1e-10
    # At an end nothing lies beyond.
    assert pumping.top_of(lambda c: (-c, 0.0), cosines).cos_theta == pytest.approx(1e-3)


def test_what_equals_a_limit_holds_within_its_bound() -> None:
    rule = pumping.at_most(1.0)
    assert rule.judge(0.9, 0.01) == "holds"
    assert rule.judge(1.0, 1e-9).startswith("holds within the bound")
    assert rule.judge(1.1, 0.01) == "fails"


def test_the_worst_of_many_is_so_within_its_bound() -> None:
    value, error = np.array([0.3, 0.2, 0.25]), np.array([0.0, 0.0, 0.1])
    assert pumping.least(value, error) == (2, 0.25, 0.1)
    assert pumping.most(value, error) == (2, 0.25, 0.1)
