"""The search for the fewest right digits."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

import albedo
from albedo.analysis import stability
from albedo.analysis.precise import evaluate, precise
from albedo.analysis.worst_case import _Models, _real, search
from albedo.brdf import Alias, Choice, Model, Real
from albedo.catalogue import names
from albedo.cli import app
from albedo.errors import InputError

WAYS = stability.WAYS


def spoiled(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    """1 but for a difference of near-equals, which is rounded away where n.v is below 1e-8."""
    z = wo[..., 2]
    return (1.0 + z * z) - 1.0


def test_a_search_finds_where_a_difference_is_rounded_away() -> None:
    found = search(albedo.model_from(spoiled, lobe="diffuse", isotropic=True), examples=60)
    for way, edge in (("float64", 2.0**-26), ("float32", 2.0**-11)):
        case = found.worst[way]
        assert case.digits < 1.0
        # Half the rounding of 1 is what n.v^2 has to fall below.
        assert case.cos_view < 4.0 * edge


def test_what_is_found_is_there() -> None:
    """The value of the worst case once more, from its parameters and directions."""
    for case in search("blinn:n=1", examples=40).worst.values():
        light = stability.ExactFrame(precise(), case.cos_theta, case.phi).light.reshape(1, 3)
        view = stability.ExactFrame(precise(), case.cos_view, case.phi_view).light.reshape(1, 3)
        exact = evaluate(case.model, precise(), light, view, light + view)
        # Angles are rounded to 4e-16, which is 4e-4 of a slope where both cosines are 1e-12.
        assert float(exact[0]) == pytest.approx(case.value, rel=1e-3)
        assert case.lost == stability.FULL[case.way] - case.digits


def test_the_same_seed_gives_the_same_cases(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.chdir(tmp_path)
    first, second = (search("phong", examples=40, seed=3).table() for _ in range(2))
    pd.testing.assert_frame_equal(first, second)
    other = search("phong", examples=40, seed=4).table()
    assert not first.equals(other)
    # Nothing is left in the current folder.
    assert list(tmp_path.iterdir()) == []


def test_a_search_finds_what_the_map_finds() -> None:
    """The longest tails of Ward's lobe lose as many digits as on the map, give or take one."""
    frame = stability.measure(stability.named_models(stability.swept("ward"))[::4])
    mapped = stability.worst(frame).set_index("way")["lost"]
    found = search("ward", examples=300).worst
    for way in WAYS:
        assert found[way].lost > mapped[way] - 1.5


def test_parameters_that_are_given_stay() -> None:
    found = search("ward:m=0.25", examples=30)
    assert {case.model.parameters["alpha_x"] for case in found.worst.values()} == {0.25}
    swept = search("ward:m=[0.1,0.2]", examples=30)
    assert all(case.model.parameters["alpha_y"] in (0.1, 0.2) for case in swept.worst.values())
    one = search(albedo.model("phong", n=7.0), examples=30)
    assert all(case.model == albedo.model("phong", n=7.0) for case in one.worst.values())


@pytest.mark.parametrize("name", names())
def test_draws_cover_the_declared_ranges(name: str, rng: np.random.Generator) -> None:
    models = _Models.of(name)
    for parameter in albedo.models()[name].parameter_info():
        if isinstance(parameter, Real):
            rows = rng.integers(0, 64, (400, 4)).tolist()
            drawn = [_real(tuple(row), parameter) for row in rows]
            numbers = [x for x in drawn if x is not None]
            for x in numbers:
                assert parameter.check(name, x) == x
            finite = math.isfinite(parameter.low), math.isfinite(parameter.high)
            assert parameter.open_low or min(numbers) == (parameter.low if finite[0] else -1e6)
            assert max(numbers) == (parameter.high if finite[1] else 1e6)
    kind = albedo.models()[name]
    assert isinstance(kind, type)
    assert issubclass(kind, Model)
    choices = [p for p in kind.parameter_info() if isinstance(p, Choice)]
    assert {p.name for p in choices} == set(models.words)
    # Words that would make something else than kernels are left out, the default never is.
    assert all(p.default in models.words[p.name] for p in choices)
    assert models.size >= 4 * sum(not isinstance(p, Alias) for p in kind.parameter_info())


def test_a_search_counts_what_is_not_finite() -> None:
    def broken(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        # Infinite in float32 alone: its numbers end at 3e38.
        return (1.0 + wo[..., 2]) * 1e30 * 1e30 / 1e60

    found = search(albedo.model_from(broken, lobe="diffuse"), examples=25)
    assert found.not_finite == {"float64": 0, "raw": 0, "float32": found.tried["float32"]}
    assert found.tried["float32"] > 25
    assert not found.worst["float32"].finite
    assert found.worst["float32"].digits == 0.0
    assert found.worst["float64"].finite


@pytest.mark.parametrize(
    ("what", "examples", "said"),
    [
        ("nope", 30, "unknown model"),
        ("phong + lambert", 30, "sum"),
        ("ward:m=-1", 30, "m = -1"),
        ("ward", 5, "at least 20"),
        ("lewis:reading=per_incidence", 30, "plain arithmetic"),
    ],
)
def test_mistakes_are_named(what: str, examples: int, said: str) -> None:
    with pytest.raises(InputError, match=said):
        search(what, examples=examples)


def test_the_command_searches_and_writes(tmp_path: Path) -> None:
    csv = tmp_path / "ward.csv"
    line = ["stability", "ward", "--search", "--examples", "30", "-o", str(csv)]
    done = CliRunner().invoke(app, line, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    assert "float32:" in done.output
    frame = pd.read_csv(csv)
    assert list(frame["way"]) == list(WAYS)
    assert (frame["digits"] >= 0.0).all()
    assert all(model.startswith("ward:") for model in frame["model"])


def test_the_command_searches_a_function(tmp_path: Path) -> None:
    file = tmp_path / "my_brdf.py"
    file.write_text("def dusty(wi, wo):\n    return 0.25 / (wi[..., 2] + wo[..., 2])\n")
    line = ["stability", f"{file}:dusty", "--search", "--examples", "25"]
    done = CliRunner().invoke(app, line, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    assert "raw: 1" in done.output


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (["ward", "--search", "--plot", "x.png"], "--plot"),
        (["ward", "--search", "--width", "0.1"], "--width"),
        (["ward", "--search", "--examples", "3"], "at least 20"),
        (["ward", "--examples", "30"], "--search"),
    ],
)
def test_options_that_do_not_go_together_are_refused(line: list[str], said: str) -> None:
    done = CliRunner().invoke(app, ["stability", *line])
    assert done.exit_code == 2
    assert said in done.output


def test_importing_albedo_does_not_load_hypothesis() -> None:
    code = "import sys, albedo.cli, albedo.analysis.worst_case; print('hypothesis' in sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "False"
