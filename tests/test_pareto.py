"""What an accuracy costs: the errors are right, and fronts are fronts; times decide nothing."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import albedo
from albedo.analysis import pareto
from albedo.errors import InputError


@pytest.fixture(scope="module")
def frame() -> pd.DataFrame:
    return pareto.prepare(albedo.model("ward", m=0.4), directions=16).times(3)


def test_all_ways_are_there(frame: pd.DataFrame) -> None:
    assert set(frame["kind"]) == {
        *("nested quadrature", "rule on angles", "draws of the cosine", "draws of the lobe"),
        *("Sobol draws of the lobe", "linear table", "cubic table", "polynomial"),
    }
    assert (frame["ns_low"] <= frame["ns"]).all()
    assert (frame["ns"] <= frame["ns_high"]).all()
    assert frame["ratio"].min() == 1.0


def test_errors_fall_as_they_should(frame: pd.DataFrame) -> None:
    # What the nested quadrature is asked for is an upper bound of what it errs by.
    nested = frame[frame["kind"] == "nested quadrature"]
    for _, row in nested.iterrows():
        assert row["worst"] <= float(row["detail"].removeprefix("rtol = "))
    # Linear tables err as the square of the step, cubic ones as its fourth power.
    for read, order in (("linear", 2), ("cubic", 4)):
        own = frame[frame["kind"] == f"{read} table"]
        worst = [
            float(own[own["detail"] == f"{n} (cos_theta) points, float64, {read}"]["worst"].iloc[0])
            for n in (16, 64)
        ]
        # Places are few: the largest of 16 is a third of the largest at least, mostly.
        assert worst[1] < 4.0 * worst[0] * (15 / 63) ** order
    random = frame[frame["kind"] == "draws of the cosine"].sort_values("evaluations")
    few, many = random["mean"].iloc[[2, -1]]
    draws = random["evaluations"].iloc[[2, -1]]
    # Mean errors of 16 estimates are known to a third or so.
    assert many / few == pytest.approx(np.sqrt(draws.iloc[0] / draws.iloc[1]), rel=0.75)


def test_fronts_are_what_nothing_beats() -> None:
    frame = pd.DataFrame({"ns": [1.0, 2.0, 3.0, 4.0, 2.0], "worst": [0.5, 0.1, 0.2, 0.01, 0.3]})
    assert pareto.front(frame)["front"].tolist() == [True, True, False, True, False]


def test_the_cheapest_of_every_kind(frame: pd.DataFrame) -> None:
    found = pareto.cheapest(frame, 1e-3)
    assert found["kind"].is_unique
    assert (found["worst"] <= 1e-3).all()
    assert found["ns"].is_monotonic_increasing
    assert pareto.cheapest(frame, 1e-13).empty


def test_mistakes_are_named() -> None:
    with pytest.raises(InputError, match=r"directions = 3 .* at least 16"):
        pareto.prepare(albedo.model("phong"), directions=3)
    with pytest.raises(InputError, match=r"repeats = 1 .* at least 3"):
        pareto.Race([], []).times(1)
