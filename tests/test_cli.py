"""The command line: what it prints, what it writes, and how it refuses."""

from __future__ import annotations

import csv
import inspect
import io
import json
import math
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import albedo
from albedo.cli import app
from albedo.cli.options import complete_model
from albedo.describe import citation, promises
from albedo.grammar import parse

# Long enough on two busy cores, and far below what a hanging process would take.
PATIENCE = 120.0

# New processes find the package that is tested here, installed or not.
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(Path(albedo.__file__).parents[1])}


def run(*arguments: str):
    return CliRunner().invoke(app, list(arguments), catch_exceptions=False)


def refused(*arguments: str) -> str:
    """Run what cannot work: status 2 and one sentence on stderr, nothing on stdout."""
    result = run(*arguments)
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    lines = result.stderr.strip().splitlines()
    assert len(lines) == 1, result.stderr
    assert lines[0].startswith("Error: ")
    assert lines[0].endswith(".")
    assert "Traceback" not in result.stderr
    return lines[0]


def records(*arguments: str) -> list[dict]:
    result = run("eval", *arguments, "--json")
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout, parse_constant=pytest.fail)


def test_version_and_help():
    assert run("--version").stdout == f"albedo {albedo.__version__}\n"
    for command in ((), ("models",), ("eval",), ("table",), ("plot",), ("report",)):
        result = run(*command, "--help")
        assert result.exit_code == 0
        assert "Examples:" in result.stdout
        # Sweeps in brackets are part of the examples, not of a markup language.
        assert "\b" not in result.stdout
    for command in ("list", "run"):
        assert "Examples:" in run("study", command, "--help").stdout


def test_all_models_are_listed():
    result = run("models")
    assert result.exit_code == 0
    for name, kind in albedo.models().items():
        (line,) = (row for row in result.stdout.splitlines() if row.split()[:1] == [name])
        assert kind.title in line


@pytest.mark.parametrize("name", albedo.models())
def test_a_model_is_shown_in_full(name):
    result = run("models", name)
    assert result.exit_code == 0
    kind = albedo.models()[name]
    assert kind.equation in result.stdout
    assert inspect.getdoc(kind) in result.stdout
    for key in kind.references:
        assert citation(key) in result.stdout
    for promise, said in promises(kind).items():
        assert f"{promise}:" in result.stdout
        assert said in result.stdout
    for item in kind.parameter_info():
        assert item.name in result.stdout
        assert item.range_text in result.stdout
        assert item.doc in result.stdout


def test_eval_prints_what_the_library_computes():
    rows = records("ward:m=0.1", "--theta", "0,60,85")
    ward = albedo.model("ward", m=0.1)
    expected = albedo.directional_albedo(ward, [row["cos_theta"] for row in rows])
    assert [row["value"] for row in rows] == expected.value.tolist()
    assert [row["error"] for row in rows] == expected.error.tolist()
    assert [row["evaluations"] for row in rows] == expected.evaluations.tolist()
    assert [row["theta"] for row in rows] == [0.0, 60.0, 85.0]
    assert rows[1]["cos_theta"] == 0.5
    assert all(row["kind"] == "bound" and row["converged"] for row in rows)
    assert {row["model"] for row in rows} == {"ward:m=0.1"}


def test_sums_are_models():
    (total, *parts) = records("0.5*(phong:n=20 + 0.6*lambert)", "--cos", "0.5")
    both = 0.5 * albedo.model("phong", n=20) + 0.3 * albedo.model("lambert")
    exact = albedo.directional_albedo(both, 0.5)
    assert (total["value"], total["error"]) == (float(exact.value), float(exact.error))
    assert total["model"] == "0.5*phong:n=20 + 0.3*lambert"
    assert [row["part"] for row in parts] == ["phong specular", "lambert diffuse"]
    swept = records("phong:n=[1,20] + lambert", "--average")
    assert [row["model"] for row in swept] == ["phong:n=1 + lambert", "phong:n=20 + lambert"]


def test_every_command_takes_sums_or_says_why_not(tmp_path):
    import xarray as xr

    both = "0.4*phong:n=20 + 0.3*lambert"
    for command in (
        ("plot", both, "-o", str(tmp_path / "curves.svg")),
        ("pump", both, "--cos", "0.5"),
        ("radiance", both, "--cos", "0.5"),
        ("check", both),
        ("table", both, "--cos", "0.5,1", "-o", str(tmp_path / "one.csv")),
        ("table", both, "--cos", "0.5,1", "-o", str(tmp_path / "one.nc")),
        ("eval", both, "--cos", "0.5", "--method", "mc", "--samples", "100"),
    ):
        result = run(*command)
        assert result.exit_code == 0, (command, result.output)
        assert both in result.stdout or command[0] in ("plot", "pump")
    with xr.open_dataset(tmp_path / "one.nc", engine="h5netcdf") as dataset:
        assert parse(dataset.attrs["model"]).model() == parse(both).model()
    many = "phong:n=[1,20] + lambert"
    assert "'phong:n=[1,20] + lambert' sweeps" in refused("table", many, "-o", "t.csv")
    assert "sum or a multiple" in refused("energy", both)
    assert "sweep of 2" in refused("pump", many)
    assert "before the '*'" in refused("eval", "phong:n=20*0.3")
    assert "unknown model" in refused("eval", "phong + lambertian")


def test_eval_in_csv_keeps_every_digit():
    result = run("eval", "phong:n=20", "--cos", "1,0.5,1e-3", "--csv")
    rows = list(csv.DictReader(io.StringIO(result.stdout)))
    expected = albedo.directional_albedo(albedo.model("phong", n=20), [1.0, 0.5, 1e-3])
    assert [float(row["value"]) for row in rows] == expected.value.tolist()


def test_eval_for_people():
    result = run("eval", "ward:m=[.1,.2]", "--theta", "0,60")
    assert result.exit_code == 0
    lines = result.stdout.splitlines()
    assert "albedo (bound)" in result.stdout
    assert sum("ward:m=0.1 " in line for line in lines) == 1
    assert sum("ward:m=0.2 " in line for line in lines) == 1
    assert "0.97105167" in result.stdout


def test_grazing_in_degrees_is_exactly_grazing():
    (row,) = records("phong:n=20", "--theta", "90")
    assert row["cos_theta"] == 0.0
    exact = albedo.directional_albedo(albedo.model("phong", n=20), 0.0)
    assert row["value"] == float(exact.value)


def test_parts_are_shown_beside_the_total():
    rows = records("he_torrance:sigma0=0.1,tau=1.7", "--theta", "60")
    parts = {row["part"]: row["value"] for row in rows}
    assert set(parts) == {"total", "mirror", "directional_diffuse"}
    assert parts["total"] == pytest.approx(parts["mirror"] + parts["directional_diffuse"])


def test_azimuths_are_degrees():
    rows = records("ward:alpha_x=0.1,alpha_y=0.4", "--cos", "0.3", "--phi", "0,90")
    ward = albedo.model("ward", alpha_x=0.1, alpha_y=0.4)
    for row, phi in zip(rows, (0.0, np.pi / 2), strict=True):
        exact = albedo.directional_albedo(ward, 0.3, phi=phi)
        assert row["value"] == float(exact.value)


def test_the_other_quantities():
    (row,) = records("phong:n=20", "--cos", "0.7", "--complement")
    (whole,) = records("phong:n=20", "--cos", "0.7")
    assert row["quantity"] == "1 - albedo"
    assert row["value"] == pytest.approx(1.0 - whole["value"], rel=1e-6)
    (seen,) = records("phong:n=20", "--cos", "0.7", "--fixed", "view")
    assert seen["value"] == pytest.approx(whole["value"], rel=1e-6)
    (mean,) = records("lambert:rho=0.5", "--average")
    assert mean["quantity"] == "average albedo"
    assert mean["value"] == pytest.approx(0.5, abs=1e-6)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("eval", "wart"), "ward"),
        (("eval", "ward:m=0"), "m = "),
        (("eval", "ward:rough=1"), "has no parameter"),
        (("eval", "ward:m=nan"), "finite"),
        (("eval", "ward:m=(1"), "never closed"),
        (("eval", "ward", "--cos", "2"), "within 0 and 1"),
        (("eval", "ward", "--cos", "nan"), "finite"),
        (("eval", "ward", "--theta", "91"), "within 0 and 90"),
        (("eval", "ward", "--theta", "60", "--cos", "1"), "choose one"),
        (("eval", "ward", "--phi", "x"), "--phi"),
        (("eval", "ward", "--json", "--csv"), "choose one"),
        (("eval", "ward", "--average", "--cos", "1"), "--cos"),
        (("eval", "ward", "--rtol", "-1"), "rtol"),
        (("eval", "ward", "--rtol", "nan"), "rtol"),
        (("eval", "ward", "--fixed", "sideways"), "fixed"),
        (("models", "nobody"), "unknown model"),
        (("plot", "ward:m=0", "-o", "a.png"), "m = "),
        (("plot", "ward", "-o", "a.gif"), ".png, .svg, .pdf"),
        (("plot", "ward", "-o", "no/a.png"), "there is no folder"),
        (("plot", "ward", "-o", "a.png", "--min-cos", "1e-3"), "--grazing"),
        (("plot", "ward", "-o", "a.png", "--grazing", "--min-cos", "0"), "smallest cosine"),
        (("table", "ward", "-o", "a.xlsx"), ".nc, .csv"),
        (("table", "ward:m=0", "-o", "a.nc"), "m = "),
        (("table", "ward", "-o", "a.nc", "--cos", "1,1"), "must differ"),
        (("table", "ward:m=[.1,-1]", "-o", "a.nc"), "m = "),
        (("study", "list"), "--studies-dir"),
        (("study", "run", "x"), "--studies-dir"),
        (("report",), "./studies"),
        (("report", "--studies-dir", "nowhere"), "nowhere"),
    ],
)
def test_bad_input_gets_one_sentence_and_writes_nothing(arguments, says, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert says in refused(*arguments)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_written_gets_one_sentence(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "studies").mkdir()
    (tmp_path / "studies" / "one.py").write_text("x = 1")
    (tmp_path / "taken").write_text("a file, not a folder")
    says = refused("report", "-o", "taken/more/site")
    assert "The folder 'taken/more/site' cannot be made; 'taken" in says


def test_a_table_as_netcdf(tmp_path):
    import xarray as xr

    path = tmp_path / "ward.nc"
    result = run("table", "ward:m=[.1,.2,.3]", "--cos", "0.1..1/4", "-o", str(path))
    assert result.exit_code == 0, result.output
    with xr.open_dataset(path, engine="h5netcdf") as dataset:
        assert dict(dataset.sizes) == {"m": 3, "phi": 1, "cos_theta": 4}
        assert set(dataset) >= {"value", "error", "evaluations", "converged"}
        ward = albedo.model("ward", m=0.2)
        exact = albedo.directional_albedo(ward, dataset.cos_theta.values)
        found = dataset.value.sel(m=0.2, phi=0.0).values
        np.testing.assert_allclose(found, exact.value, rtol=2e-8)
        assert dataset.attrs
    assert [item.name for item in tmp_path.iterdir()] == ["ward.nc"]


def test_a_table_as_csv(tmp_path):
    path = tmp_path / "phong.csv"
    result = run("table", "phong:n=[1,10]", "--theta", "0,60", "-o", str(path))
    assert result.exit_code == 0, result.output
    rows = list(csv.DictReader(path.read_text().splitlines()))
    assert len(rows) == 4
    assert {"n", "phi", "cos_theta", "value", "error", "evaluations", "converged"} <= set(rows[0])


def test_a_plot_of_several_models_and_a_sweep(tmp_path):
    path = tmp_path / "albedo.svg"
    result = run("plot", "lambert", "phong:n=[5,20]", "-o", str(path))
    assert result.exit_code == 0, result.output
    assert path.read_text().startswith("<?xml")
    assert "3 curves" in result.stdout
    assert list(tmp_path.iterdir()) == [path]


STUDY = '''"""Does Lambert's albedo stay what it is?"""

import pandas as pd

import albedo
from albedo.studies import Study

STUDY = Study(name="lambert", title="Lambert", claims=("L",))


def run(context):
    estimate = albedo.directional_albedo(albedo.model("lambert", rho=0.5), 0.3)
    value, error = float(estimate.value), float(estimate.error)
    context.table("albedo", pd.DataFrame({"a": [value], "a_error": [error]}))
    context.claim("L", "The albedo is rho.", value, error, "= 0.5 +- 1e-6")
'''


def test_studies_from_the_command_line(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "studies").mkdir()
    (tmp_path / "studies" / "lambert.py").write_text(STUDY)
    assert "Lambert" in run("study", "list").stdout
    assert "there are lambert" in refused("study", "run", "ward")
    result = run("study", "run", "lambert", "-o", "out")
    assert result.exit_code == 0, result.output
    assert "L: holds" in result.stdout
    assert (tmp_path / "out" / "lambert" / "manifest.json").is_file()

    (tmp_path / "studies" / "broken.py").write_text(STUDY.replace("def run", "def walk"))
    listing = run("study", "list")
    assert listing.exit_code == 1
    assert "cannot be read: InputError" in listing.stdout
    result = run("report")
    assert result.exit_code == 1
    assert "reports/build/index.html" in result.stdout
    assert "broken: failed" in result.stderr
    assert "did not finish" in (tmp_path / "reports/build/studies/broken/index.html").read_text()
    assert "holds" in (tmp_path / "reports/build/studies/lambert/index.html").read_text()
    assert run("study", "run", "broken", "lambert", "-o", "out").exit_code == 1


def test_model_names_complete():
    assert complete_model("war") == ["ward", "ward_bounded", "ward_duer"]


def test_help_loads_nothing_heavy():
    code = (
        "import sys, albedo, albedo.cli\n"
        "sys.argv = ['albedo', '--help']\n"
        "try:\n    albedo.cli.main()\n"
        "except SystemExit:\n    pass\n"
        "heavy = {'numpy', 'numba', 'matplotlib', 'pandas', 'xarray', 'scipy', 'jinja2', 'rich'}\n"
        "print(sorted(heavy & set(sys.modules)))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=ENVIRONMENT,
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=True,
    )
    assert "Usage:" in done.stdout
    assert done.stdout.splitlines()[-1] == "[]"


@pytest.mark.parametrize("named", [False, True])
@pytest.mark.parametrize("command", [("table", "-o", "a.nc"), ("plot", "-o", "a.png")])
def test_an_interrupted_command_leaves_no_file(command, named, tmp_path, monkeypatch):
    def interrupted(*arguments, **options):
        if named:
            # As Python 3.11 does while a class is made.
            raise RuntimeError("Error calling __set_name__") from KeyboardInterrupt()
        raise KeyboardInterrupt

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(albedo, "table", interrupted)
    monkeypatch.setattr(albedo, "directional_albedo", interrupted)
    result = run(*command, "ward")
    assert result.exit_code == 130
    assert result.stderr.startswith("Interrupted")
    assert list(tmp_path.iterdir()) == []


def test_other_errors_are_no_interruptions(tmp_path, monkeypatch):
    def broken(*arguments, **options):
        raise RuntimeError("broken") from ValueError("cause")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(albedo, "table", broken)
    with pytest.raises(RuntimeError, match="broken"):
        run("table", "ward", "-o", "a.nc")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGINT to send to one process")
def test_a_real_interruption_ends_with_130_and_no_scraps(tmp_path):
    (tmp_path / "studies").mkdir()
    waits = STUDY.replace(
        "estimate =", "print('ready', flush=True); __import__('time').sleep(60); estimate ="
    )
    (tmp_path / "studies" / "lambert.py").write_text(waits)
    process = subprocess.Popen(
        [sys.executable, "-m", "albedo.cli", "study", "run", "lambert", "-o", "out"],
        cwd=tmp_path,
        env=ENVIRONMENT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130
    assert errors.startswith("Interrupted")
    assert list((tmp_path / "out").iterdir()) == []


def test_pump_prints_every_step_and_writes_numbers_and_pictures(tmp_path: Path) -> None:
    result = run("pump", "lambert:rho=0.5", "--steps", "1", "--theta", "0,60")
    assert result.exit_code == 0
    assert "step 0" in result.stdout
    assert "1.00000000" in result.stdout
    numbers = tmp_path / "phong.csv"
    arguments = ("phong:n=20", "--steps", "2", "--control", "cumulative", "--cos", "1,0.1")
    assert run("pump", *arguments, "--plot", "-o", str(numbers)).exit_code == 0
    with numbers.open() as file:
        rows = list(csv.DictReader(file))
    assert [row["step"] for row in rows] == ["0", "0", "1", "1", "2", "2"]
    assert {row["control"] for row in rows} == {"cumulative"}
    model = albedo.pump(albedo.model("phong", n=20), 2, "cumulative")
    found = albedo.directional_albedo(model, 0.1)
    assert abs(float(rows[-1]["value"]) - found.value) <= float(rows[-1]["error"]) + found.error
    assert (tmp_path / "phong.png").stat().st_size > 10_000


def test_no_control_has_the_name_that_results_give_it(tmp_path: Path) -> None:
    numbers = tmp_path / "steps.csv"
    assert run("pump", "lambert", "--control", "none", "-o", str(numbers)).exit_code == 0
    kept = numbers.read_bytes()
    assert b"none" in kept
    assert run("pump", "lambert", "-o", str(numbers)).exit_code == 0
    assert numbers.read_bytes() == kept


@pytest.mark.parametrize("rtol", ["1e-10", "1e-4", "0.01"])
def test_pump_gives_what_is_asked_for(tmp_path: Path, rtol: str) -> None:
    numbers = tmp_path / "steps.csv"
    arguments = ("phong:n=20", "--steps", "4", "--rtol", rtol, "--cos", "0.7,0.1,1e-6")
    assert run("pump", *arguments, "-o", str(numbers)).exit_code == 0
    with numbers.open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 15
    for row in rows:
        assert row["converged"] == "True"
        assert float(row["error"]) <= float(rtol) * float(row["value"])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("phong_original",), "not symmetric"),
        (("phong", "--steps", "-1"), "steps = -1 is no whole number in [0, 100]"),
        (("phong", "--rtol", "1e-15"), "rtol = 1e-15 is below what float64 can meet"),
        (("phong", "--rtol", "nan"), "rtol = nan is out of range"),
        (("phong", "--control", "soft"), "control = 'soft' is unknown"),
        (("phong:n=[1,2]",), "takes one model"),
        (("phong", "-o", "albedo.txt"), "albedo.txt"),
    ],
)
def test_pump_refuses_in_one_sentence(arguments: tuple[str, ...], message: str) -> None:
    assert message in refused("pump", *arguments)


def test_pump_takes_anisotropic_models_and_lobes_anywhere() -> None:
    elliptic = run("pump", "ward:alpha_x=0.4,alpha_y=0.2", "--cos", "0.5", "--phi", "40")
    scaled = run("pump", "lafortune_scaled", "--cos", "0.5,0.01")
    for done in (elliptic, scaled):
        assert done.exit_code == 0
        assert "step 1" in done.output
        assert "NO" not in done.output


def test_radiance_prints_peaks_and_writes_numbers_and_pictures(tmp_path: Path) -> None:
    result = run("radiance", "lambert:rho=0.5", "--theta", "0,60")
    assert result.exit_code == 0
    # Every direction is as bright as any other.
    assert "any" in result.stdout
    assert "0.0795774715459(1)" in result.stdout
    numbers = tmp_path / "phong.csv"
    arguments = ("phong:n=20", "--steps", "2", "--control", "cumulative", "--cos", "0.5,0.1")
    assert run("radiance", *arguments, "--phi", "30", "--plot", "-o", str(numbers)).exit_code == 0
    with numbers.open() as file:
        rows = list(csv.DictReader(file))
    assert [row["cos_theta"] for row in rows] == ["0.5", "0.1"]
    assert {(row["steps"], row["control"]) for row in rows} == {("2", "cumulative")}
    # Under control the lobe is never brighter than before at normal incidence.
    for row in rows:
        assert abs(float(row["peak"]) - 11.0 / math.pi) <= float(row["peak_error"])
        assert float(row["from_mirror"]) == 0.0
        assert abs(float(row["view_phi"]) + 150.0) <= 1e-12
    assert (tmp_path / "phong.png").stat().st_size > 10_000
    assert "phong, 1 step, literal" in run(
        *("radiance", "phong", "--steps", "1", "--control", "literal", "--theta", "60")
    ).stdout.replace("\n", " ")
    assert "∞" in run("radiance", "ward:m=0.2", "--theta", "60").stdout
    picture = tmp_path / "sweep.svg"
    sweep = ("ward_bounded:m=[.1,.3]", "--theta", "30,60", "-o", str(picture))
    assert "4 curves" in run("radiance", *sweep).stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("phong_original", "--steps", "1"), "not symmetric"),
        (("phong", "--control", "literal"), "goes with --steps"),
        (("phong", "--rtol", "1e-6"), "goes with --steps"),
        (("phong", "--steps", "1", "--rtol", "2"), "--rtol = 2.0 is out of range"),
        (("phong", "--cos", "0"), "cos_theta = 0.0 is out of range"),
        (("phong", "--cos", "1", "--theta", "0"), "choose one"),
        (("phong", "-o", "peaks.txt"), "peaks.txt"),
    ],
)
def test_radiance_refuses_in_one_sentence(arguments: tuple[str, ...], message: str) -> None:
    assert message in refused("radiance", *arguments)
