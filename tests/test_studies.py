"""Studies and the report, on small studies made for the purpose."""

from __future__ import annotations

import json
import math
import re
import tomllib
from fractions import Fraction
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from steps import nystrom
from typer.testing import CliRunner

import albedo
from albedo import plotting
from albedo.cli import app
from albedo.errors import InputError
from albedo.estimate import format_value
from albedo.files import atomic_file, atomic_folder, check_output, save_json, save_text
from albedo.report import build_report
from albedo.studies import StudyFile, _rounded, compare, discover, run_study

STUDIES = Path(__file__).parent.parent / "studies"

GOOD = '''
"""Does a number stay below one?

It is a small <number>.
"""

import pandas as pd

from albedo import plotting
from albedo.studies import Study

STUDY = Study(name="good", title="A small number", paper="Nobody, Nothing", claims=("X1",))


def run(context):
    context.progress(0, 1, "thinking")
    frame = pd.DataFrame({"x": [0.1, 1 / 3], "a": [0.25, 2.0], "a_error": [1e-9, float("inf")]})
    context.table("values", frame, "Values & more")
    with plotting.style():
        figure, (axes,) = plotting.new_figure()
        axes.plot([0, 1], [0, 1], label="line")
    context.figure("picture", figure, "A line")
    context.note(f"Fidelity is {'full' if context.full else 'quick'}.")
    context.claim("X1", "It is below one.", 0.5, 1e-3, "< 1")
    context.claim("X1", "It is above one.", 0.5, 1e-3, "> 1")
'''

BAD = '''
"""Does this work?"""

from albedo.studies import Study

STUDY = Study(name="bad", title="A broken study")


def run(context):
    context.note("It began well.")
    raise RuntimeError("no <luck>")
'''


@pytest.fixture
def studies(tmp_path):
    folder = tmp_path / "studies"
    folder.mkdir()
    (folder / "good.py").write_text(GOOD)
    (folder / "bad.py").write_text(BAD)
    (folder / "_helper.py").write_text("raise SystemExit")
    return folder


def write_study(folder: Path, name: str, body: str, claims: str = "()") -> StudyFile:
    path = folder / f"{name}.py"
    path.write_text(
        '"""Question?"""\n'
        "from albedo.studies import Criterion, Study\n"
        f"STUDY = Study(name={name!r}, title='T', claims={claims})\n"
        f"def run(context):\n    {body}\n"
    )
    return StudyFile(path)


def test_studies_are_found_by_their_files(studies):
    assert [file.name for file in discover(studies)] == ["bad", "good"]


def test_where_studies_are_looked_for(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=r"'\./studies'.*--studies-dir"):
        discover()
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="holds no study"):
        discover(tmp_path / "empty")


def test_a_study_leaves_a_complete_folder(studies, tmp_path):
    steps = []
    result = run_study(
        StudyFile(studies / "good.py"),
        tmp_path / "out",
        progress=lambda done, total, text: steps.append((done, total, text)),
    )
    assert not result.failed
    assert steps == [(0, 1, "thinking")]
    folder = tmp_path / "out" / "good"
    assert sorted(path.name for path in folder.iterdir()) == [
        "manifest.json",
        "picture.png",
        "picture.svg",
        "values.csv",
    ]
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["good"]
    manifest = json.loads((folder / "manifest.json").read_text())
    assert manifest["study"]["question"] == "Does a number stay below one?"
    assert manifest["study"]["background"] == ["It is a small <number>."]
    assert manifest["notes"] == ["Fidelity is quick."]
    assert [claim["verdict"] for claim in manifest["claims"]] == ["holds", "fails"]
    assert set(manifest["outputs"]) == {"picture.png", "picture.svg", "values.csv"}
    assert re.fullmatch("[0-9a-f]{64}", manifest["inputs"]["source_sha256"])
    assert (folder / "values.csv").read_text().splitlines() == [
        "x,a,a_error",
        "0.1,0.25,1e-09",
        "0.3333333333333333,2.0,inf",
    ]


def test_equal_runs_have_equal_manifests_and_bytes(studies, tmp_path):
    manifests = []
    for name in ("one", "two"):
        run_study(StudyFile(studies / "good.py"), tmp_path / name)
        manifest = json.loads((tmp_path / name / "good" / "manifest.json").read_text())
        manifest.pop("seconds")
        manifests.append(manifest)
    assert manifests[0] == manifests[1]


def test_a_failing_study_keeps_its_former_results(studies, tmp_path):
    folder = tmp_path / "bad"
    folder.mkdir()
    (folder / "manifest.json").write_text("{}\n")
    result = run_study(StudyFile(studies / "bad.py"), tmp_path)
    assert result.failed
    assert result.folder is None
    assert result.manifest["error"]["kind"] == "RuntimeError"
    assert "bad.py, line" in result.manifest["error"]["where"]
    assert str(tmp_path) not in json.dumps(result.manifest)
    assert [path.name for path in folder.iterdir()] == ["manifest.json"]


def test_a_folder_that_is_no_result_is_not_replaced(studies, tmp_path):
    (tmp_path / "good").mkdir()
    (tmp_path / "good" / "thesis.tex").write_text("years of work")
    with pytest.raises(InputError, match="holds no results"):
        run_study(StudyFile(studies / "good.py"), tmp_path)
    assert (tmp_path / "good" / "thesis.tex").read_text() == "years of work"


@pytest.mark.parametrize(
    ("body", "claims", "says"),
    [
        ("context.claim('A', 's', 1, 0, '< 2')", "()", "without declaring"),
        ("pass", "('A',)", "does not measure"),
        ("context.claim('A', 's', 1, 0, 'big')", "('A',)", "not a criterion"),
        ("context.claim('A', 's', float('nan'), 0, '< 1')", "('A',)", "needs a number"),
        ("context.claim('A', 's', 1, -1, '< 1')", "('A',)", "not negative"),
        ("context.claim('A','s',1,0,Criterion('?', lambda v, e: 'fine'))", "('A',)", "verdict"),
        ("context.table('Bad Name', None)", "()", "small letters"),
        ("context.table('manifest', None)", "()", "small letters"),
        ("raise SystemExit(3)", "()", "3"),
    ],
)
def test_mistakes_in_a_study_are_its_failure(tmp_path, body, claims, says):
    result = run_study(write_study(tmp_path, "odd", body, claims), tmp_path / "out")
    assert result.failed
    assert says in result.manifest["error"]["message"]


@pytest.mark.parametrize(
    ("source", "says"),
    [
        ("x = 1", "is not a study"),
        (GOOD, "calls itself 'good'"),
        ("def broken(:", "invalid syntax"),
    ],
)
def test_files_that_are_no_studies(tmp_path, source, says):
    (tmp_path / "other.py").write_text(source)
    result = run_study(StudyFile(tmp_path / "other.py"), tmp_path / "out")
    assert says in result.manifest["error"]["message"]


def test_warnings_are_on_record(tmp_path):
    file = write_study(tmp_path, "warns", "import warnings; warnings.warn('mind this')")
    assert run_study(file, tmp_path / "out").manifest["warnings"] == ["UserWarning: mind this"]


def test_an_interruption_leaves_finished_studies_and_no_scraps(tmp_path):
    studies = tmp_path / "studies"
    studies.mkdir()
    first = write_study(studies, "a_first", "context.note('done')")
    second = write_study(studies, "b_second", "context.note('x'); raise KeyboardInterrupt")
    out = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        build_report([first, second], out, jobs=1)
    assert [path.name for path in (out / "studies").iterdir()] == ["a_first"]


@pytest.mark.parametrize(
    ("criterion", "value", "error", "verdict"),
    [
        ("< 1", 0.9, 0.05, "holds"),
        ("< 1", 0.9, 0.2, "undecided"),
        ("< 1", 1.0, 0.0, "fails"),
        ("<= 1", 1.0, 0.0, "holds"),
        ("<= 1", 1.1, 0.05, "fails"),
        ("> 1", math.inf, 0.0, "holds"),
        ("> 1", 1.0, 0.0, "fails"),
        (">= 1", 1.0, 0.0, "holds"),
        (">= 1", 0.9, math.inf, "undecided"),
        ("= 0.68 +- 0.01", 0.683, 0.001, "holds"),
        ("= 0.68 +- 0.01", 0.7, 0.001, "fails"),
        ("= 0.68 +- 0.01", 0.69, 0.001, "undecided"),
    ],
)
def test_verdicts_come_from_the_whole_interval(criterion, value, error, verdict):
    assert compare(criterion).judge(value, error).split(":")[0] == verdict


def test_the_report_shows_success_and_failure(studies, tmp_path):
    out = tmp_path / "site"
    results = build_report(discover(studies), out)
    assert [result.failed for result in results] == [True, False]
    index = (out / "index.html").read_text()
    assert "A small number" in index
    assert "did not finish: RuntimeError" in index
    failed = (out / "studies" / "bad" / "index.html").read_text()
    # What a study says is text, never markup.
    assert "no &lt;luck&gt;" in failed
    assert "It began well." in failed
    page = (out / "studies" / "good" / "index.html").read_text()
    assert "It is a small &lt;number&gt;." in page
    assert "Values &amp; more" in page
    assert "0.250000000(1)" in page
    for text in (index, failed, page):
        assert "http" not in text
        assert not re.search(r"<script(?! src=\"[./]*site\.js\")", text)
        assert str(tmp_path) not in text


def test_every_link_of_the_report_leads_to_a_file(studies, tmp_path):
    out = tmp_path / "site"
    build_report(discover(studies), out)
    for page in out.rglob("*.html"):
        links = re.findall(r'(?:href|src)="([^"]+)"', page.read_text())
        assert links
        for link in links:
            target = page.parent / link.partition("#")[0] if link[0] != "#" else page
            assert target.is_file(), f"{page}: {link}"


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (0.4889934, 1.4e-6, "0.488993(2)"),
        (0.5, 0.0, "0.5"),
        (1.0, 1e-3, "1.000(1)"),
        (0.12345, 1e-4, "0.1234(2)"),
        (1234.5, 20.0, "1.23(3)e+03"),
        (1.25e-9, 1e-11, "1.25(1)e-09"),
        (0.0, 1e-3, "0.000(1)"),
        (-0.25, 0.01, "-0.25(1)"),
        (math.inf, 0.0, "∞"),
        (2.0, math.inf, "2 ± ∞"),
        (math.nan, 0.0, "not a number"),
    ],
)
def test_numbers_are_printed_with_their_error(value, error, text):
    assert format_value(value, error) == text


def test_a_printed_interval_contains_the_true_one():
    generator = np.random.default_rng(20240229)
    for _ in range(500):
        value = generator.normal() * 10.0 ** generator.integers(-12, 12)
        error = abs(value) * 10.0 ** generator.uniform(-14, -0.5)
        matched = re.fullmatch(r"(-?[\d.]+)\((\d)\)(e[+-]\d+)?", format_value(value, error))
        assert matched, format_value(value, error)
        power = matched[3] or "e0"
        places = len(matched[1].partition(".")[2])
        middle, half = float(matched[1] + power), float(f"{matched[2]}{power}") / 10**places
        slack = 1e-14 * abs(value)
        assert middle - half <= value - error + slack
        assert middle + half >= value + error - slack


def test_an_interrupted_write_leaves_the_old_file(tmp_path):
    target = tmp_path / "table.csv"
    target.write_text("old")
    temporary: Path | None = None

    def interrupted():
        nonlocal temporary
        with atomic_file(target) as temporary:
            temporary.write_text("half of the n")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert temporary is not None
    assert temporary.suffix == target.suffix
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_an_interrupted_folder_leaves_the_old_one(tmp_path):
    target = tmp_path / "results"
    with atomic_folder(target) as folder:
        (folder / "a").write_text("old")

    def interrupted():
        with atomic_folder(target) as folder:
            (folder / "a").write_text("new")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert (target / "a").read_text() == "old"
    with atomic_folder(target) as folder:
        (folder / "b").write_text("newer")
    assert [path.name for path in target.iterdir()] == ["b"]
    assert list(tmp_path.iterdir()) == [target]


def test_a_link_keeps_pointing_at_what_is_written(tmp_path):
    (tmp_path / "there").mkdir()
    link = tmp_path / "link.json"
    link.symlink_to(tmp_path / "there" / "real.json")
    save_text("{}\n", link)
    assert link.is_symlink()
    assert (tmp_path / "there" / "real.json").read_text() == "{}\n"


def test_json_is_strict(tmp_path):
    save_json({"a": [np.float64(1.5), np.inf, -math.inf, math.nan]}, tmp_path / "x.json")
    text = (tmp_path / "x.json").read_text()
    assert json.loads(text, parse_constant=pytest.fail) == {
        "a": [1.5, "Infinity", "-Infinity", "NaN"]
    }


def test_outputs_that_cannot_work(tmp_path):
    for path, says in (
        (tmp_path / "a.txt", r"must end in one of \.nc, \.csv"),
        (tmp_path / "no" / "a.nc", "there is no folder"),
        (tmp_path, "must end"),
    ):
        with pytest.raises(InputError, match=says):
            check_output(path, (".nc", ".csv"))


def curves(count: int, swept: bool = False) -> list[plotting.Curve]:
    cos_theta = plotting.angle_grid()
    return [
        plotting.Curve(
            label=f"ward:m={index + 1}",
            name="ward",
            cos_theta=cos_theta,
            value=cos_theta / (index + 1),
            error=np.full(cos_theta.shape, 0.01),
            swept=("m", float(index + 1)) if swept else None,
        )
        for index in range(count)
    ]


def test_figures_label_axes_and_curves():
    figure = plotting.draw(curves(2))
    (axes,) = figure.axes
    assert axes.get_xlabel() == "angle of incidence (degrees)"
    assert axes.get_ylabel() == "directional albedo"
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["ward:m=1", "ward:m=2"]
    lines = [line for line in axes.get_lines() if line.get_label().startswith("ward")]
    assert len({line.get_linestyle() + str(line._dash_pattern) for line in lines}) == 2
    # Errors of a hundredth are seen on this axis, and so are drawn.
    assert len(axes.collections) == 2


def test_a_long_sweep_gets_a_colour_scale():
    figure = plotting.draw(curves(12, swept=True))
    assert not figure.legends
    assert figure.axes[1].get_ylabel() == "ward: m"


def test_a_grazing_figure_has_logarithmic_axes():
    cos_theta = plotting.grazing_grid(1e-4)
    diverging = plotting.Curve("w", "ward", cos_theta, cos_theta**-0.5, 0.0 * cos_theta)
    (axes,) = plotting.draw([diverging], grazing=True).axes
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    assert axes.get_xlim() == (1.0, 1e-4)
    with pytest.raises(InputError, match="smallest cosine"):
        plotting.grazing_grid(2.0)


@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf"])
def test_equal_figures_are_equal_files(tmp_path, suffix):
    contents = []
    for name in ("a", "b"):
        path = plotting.save_figure(plotting.draw(curves(2)), tmp_path / f"{name}{suffix}")
        contents.append(path.read_bytes())
    assert contents[0] == contents[1]
    assert len(list(tmp_path.iterdir())) == 2


def test_drawing_changes_no_global_setting():
    import matplotlib

    before = dict(matplotlib.rcParams)
    plotting.draw(curves(1))
    assert dict(matplotlib.rcParams) == before


def test_a_model_has_one_colour():
    assert plotting.color("ward") == plotting.color("ward")
    assert len({plotting.color(m) for m in ("phong", "he_torrance", "cook_torrance", "ward")}) == 4
    assert re.fullmatch("#[0-9A-F]{6}", plotting.color("somebody_elses_model"))


# What the claims about the paper come to: study, claim and reading, verdicts.
VERDICTS = {
    ("nns_fig3", "N6", ""): ["holds", "holds"],
    ("nns_fig3", "N8", "brighter than a mirror"): ["holds"],
    ("nns_fig3", "N8", "brightest beside the mirror direction"): ["fails"],
    ("nns_fig4", "N6", ""): ["holds", "holds"],
    ("nns_fig4", "N8", "brighter than a mirror"): ["holds"],
    ("nns_fig4", "N8", "brightest beside the mirror direction"): ["fails"],
    ("nns_fig5", "N9", "literal"): ["fails"],
    ("nns_fig5", "N9", "cumulative"): ["holds within the bound"],
    ("nns_fig5", "N10", "literal"): ["fails", "fails"],
    ("nns_fig5", "N10", "cumulative"): ["holds", "holds"],
    ("nns_fig6", "N9", "literal"): ["fails"],
    ("nns_fig6", "N9", "cumulative"): ["holds within the bound"],
    ("nns_fig6", "N10", "literal"): ["fails", "fails"],
    ("nns_fig6", "N10", "cumulative"): ["holds", "holds"],
    ("nns_fig7", "N11", "literal"): ["fails", "fails"],
    ("nns_fig7", "N11", "cumulative"): ["holds", "holds"],
    ("nns_fig7", "N12", ""): ["fails", "holds"],
    ("nns_fig7", "N13", ""): ["holds"],
    ("nns_convergence", "N5", ""): ["holds within the bound"] * 3,
    ("nns_convergence", "N6", ""): ["holds"] * 4,
    ("nns_convergence", "N7", ""): ["holds"] * 4,
    ("schwenk_scale_down", "S16", "at every setting"): [
        *("holds", "holds"),  # Fresnel's factor: radiance, albedo
        *["fails"] * 9,
    ],
    ("schwenk_scale_down", "S16", "at half of the settings"): ["fails"],
    ("nns_fig2", "N4", "G as printed"): ["fails"] * 6,
    ("nns_fig2", "N4", "G = 1"): ["holds"] * 4,
    ("grazing", "N3", ""): ["holds"] * 5,
    ("grazing", "N4", "G as printed"): [*["fails"] * 5, "holds within the bound", "fails"],
    ("grazing", "N4", "Smith's G"): [*["fails"] * 5, "holds within the bound"],
    ("grazing", "N4", "G = 1"): ["holds"] * 5,
    ("grazing", "A13", ""): ["holds"],
    ("grazing", "S5", ""): ["fails", "holds"],
    ("as_sampling", "A8", "eq. 20, p_h/(4 k1.h)"): ["holds"] * 3,
    ("as_sampling", "A8", "the draft, 4 (k1.h)/p_h"): ["fails"] * 3,
    ("as_sampling", "A10", ""): [
        *("fails", "fails", "holds"),  # 30 degrees: main loss for n = 10, for 1000; vanishing
        *("holds", "fails", "holds"),
        *("holds", "fails", "holds"),
    ],
    ("stability", "S13", "the formula as printed"): ["holds"],
    ("stability", "S13", "the function itself"): ["fails"],
    ("stability", "S17", ""): ["fails", "fails", "holds"],
}


def test_the_studies_of_the_project_run(tmp_path: Path) -> None:
    """What the README's first command does, at its quick fidelity, and what it finds."""
    kept = STUDIES.parent / "reports" / "quick"
    # Other tests run beside this one: what took how long is for the reports to say.
    words = ["report", "--check", "--no-times", "--against", str(kept)]
    words += ["--studies-dir", str(STUDIES)]
    done = CliRunner().invoke(app, [*words, "-o", str(tmp_path)])
    assert done.exit_code == 0, done.output
    assert "All agree with" in done.stdout
    folder = tmp_path / "studies"
    assert (folder / "nns_fig1" / "by_angle_figure.png").is_file()
    assert (folder / "nns_fig1" / "by_angle.csv").is_file()
    manifest = json.loads((folder / "nns_scaled_lobe" / "manifest.json").read_text())
    assert {claim["verdict"] for claim in manifest["claims"]} == {"holds"}
    for (name, claim, reading), verdicts in VERDICTS.items():
        manifest = json.loads((folder / name / "manifest.json").read_text())
        assert manifest["warnings"] == []
        found = [
            item["verdict"].partition(",")[0]
            for item in manifest["claims"]
            if item["id"] == claim and item["reading"] == reading
        ]
        assert found == verdicts, f"{name}, {claim}, {reading}"
    _check_explanations(folder)
    _check_against_nystrom(folder)
    _check_excess(folder)


def _check_explanations(folder: Path) -> None:
    """Papers and claims are those of papers.toml; what does not simply hold is explained."""
    papers = tomllib.loads((STUDIES / "papers.toml").read_text(encoding="utf-8"))
    every = {id for paper in papers.values() for id in paper["claims"]}
    for path in folder.glob("*/manifest.json"):
        manifest = json.loads(path.read_text())
        assert manifest["study"]["paper"] in ("", *papers)
        assert manifest["settings"]
        assert every.issuperset(manifest["study"]["claims"])
        odd = {claim["id"] for claim in manifest["claims"] if claim["verdict"] != "holds"}
        assert odd <= set(manifest["explanations"])


def _check_against_nystrom(folder: Path) -> None:
    """Albedos of the steps against another method, whose error on this grid is about 1e-4."""
    for name, model in (("nns_fig5", "phong"), ("nns_fig6", "blinn")):
        for control in ("literal", "cumulative"):
            frame = pd.read_csv(folder / name / f"albedo_{control}.csv")
            for step in (1, 2, 4):
                c, value = nystrom(albedo.model(model, n=20), control, step, 96)
                k = int(np.argmin(np.abs(c - 0.5)))
                order = np.argsort(frame["cos_theta"])
                # Between angles of three degrees a line errs by less than 1e-3.
                there = np.interp(c[k], frame["cos_theta"][order], frame[f"step_{step}"][order])
                assert abs(there - value[k]) <= 1.3e-3


def _check_excess(folder: Path) -> None:
    """What eq. 22 reflects beyond 1, by two methods, in closed form, and near the threshold."""
    frame = pd.read_csv(folder / "nns_fig7" / "excess.csv")
    slack = frame["excess_error"] + frame["by_quadrature_error"]
    assert np.all(np.abs(frame["excess"] - frame["by_quadrature"]) <= slack)
    assert np.all(frame["excess"] > frame["excess_error"])
    first, last = frame.iloc[0], frame.iloc[-1]
    # For n = 0 it is largest at 45 degrees; a maximum is flat to half of the digits.
    assert first["n"] == 0.0
    assert abs(first["excess"] - (1.5 - math.sqrt(2.0))) <= first["excess_error"] + 1e-13
    # What the expansion leaves out, and what the table does not have of the value.
    apart = abs(last["excess"] - last["expansion"])
    assert apart <= 1e-12 * last["expansion"] + last["excess_error"]
    loss = pd.read_csv(folder / "nns_fig7" / "loss.csv")
    assert np.all(loss["largest"] + loss["largest_error"] < 0.0)


def rounded(tmp_path: Path, columns: str, **words: str) -> pd.DataFrame:
    """What a table is when it has been kept."""
    more = "".join(f", {key}={value}" for key, value in words.items())
    body = (
        "import pandas as pd; inf, nan = float('inf'), float('nan'); "
        f"context.table('t', pd.DataFrame({columns}){more})"
    )
    result = run_study(write_study(tmp_path, "one", body), tmp_path / "out")
    assert result.manifest["error"] is None, result.manifest["error"]
    return pd.read_csv(tmp_path / "out" / "one" / "t.csv")


def test_errors_of_tables_are_rounded_up(tmp_path):
    errors = "[1.2341e-9, 1.23e-9, 9.999e-5, 0.0, inf, 5e-324]"
    frame = rounded(tmp_path, f"{{'a': [0.5] * 6, 'a_error': {errors}, 'x_error': {errors}}}")
    assert frame["a_error"].tolist() == [1.24e-9, 1.23e-9, 1e-4, 0.0, math.inf, 5e-324]
    # It is the error of nothing.
    assert frame["x_error"][0] == 1.2341e-9
    assert frame["a"][0] == 0.5


def test_values_of_tables_lose_the_digits_that_their_errors_hide(tmp_path):
    values = [1 / 3, 1 / 3, 1 / 3, -2e5 / 3, 1e-30 / 3, math.inf, math.nan, 0.0]
    errors = [1.234e-9, 0.0, 7e-17, 3.0, 1e-9, 1.0, 1.0, 1e-9]
    frame = rounded(tmp_path, f"{{'a': {values}, 'a_error': {errors}}}")
    assert frame["a"][:5].tolist() == [0.33333333333, 1 / 3, 1 / 3, -66666.67, 3.33333e-31]
    assert frame["a"][5] == math.inf
    assert math.isnan(frame["a"][6])
    assert frame["a"][7] == 0.0
    # The bound still holds for what it held for.
    off = [abs(Fraction(a) - Fraction(b)) for a, b in zip(frame["a"][:5], values[:5], strict=True)]
    for moved, error, kept in zip(off, errors[:5], frame["a_error"][:5], strict=True):
        assert Fraction(kept) >= Fraction(error) + moved
        assert kept <= 1.02 * error


@settings(max_examples=300)
@given(
    value=st.floats(-1e12, 1e12),
    error=st.floats(1e-300, 1e6) | st.sampled_from((0.0, 5e-324, 0.999, 9.995e-5, 1e-9)),
)
def test_no_bound_of_a_table_is_lost_by_rounding(value, error):
    frame = pd.DataFrame({"a": [value], "a_error": [error]})
    kept = _rounded(frame, {}, {}).iloc[0]
    moved = abs(Fraction(float(kept["a"])) - Fraction(value))
    assert Fraction(float(kept["a_error"])) >= Fraction(error) + moved
    assert moved <= Fraction(error) / 100 or moved <= abs(Fraction(value)) / 10**6


def test_columns_for_reading_keep_some_digits(tmp_path):
    columns = "{'deg': [100 / 3], 'ns': [1234.567], 'near': [1 / 3], 'cos': [1 / 3], 'k': [123456]}"
    words = {"machine": "('ns', 'k')", "loose": "{'near': 1e-6}", "digits": "{'deg': 5}"}
    frame = rounded(tmp_path, columns, **words)
    # A number of its own is as exact as ever, and a count is a count.
    assert frame.iloc[0].tolist() == [33.333, 1235.0, 0.333333333, 1 / 3, 123456]
    manifest = json.loads((tmp_path / "out" / "one" / "manifest.json").read_text())
    assert manifest["tables"][0]["digits"] == {"deg": 5}
    refused = run_study(
        write_study(
            tmp_path,
            "two",
            "import pandas as pd; context.table('t', pd.DataFrame({'a': [1.0]}), digits={'b': 5})",
        ),
        tmp_path / "out",
    )
    assert "no column b" in refused.manifest["error"]["message"]
