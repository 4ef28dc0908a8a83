"""What README.md and CONTRIBUTING.md show is run, and every number in them is measured again.

Numbers are written as value(digits of the error). A page and a run agree when the two intervals
have a point in common, so that a page need not follow every digit of the bounds.
"""

from __future__ import annotations

import doctest
import hashlib
import json
import math
import re
import shlex
import shutil
import subprocess
import sys
import types
from collections.abc import Iterator
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import albedo
import albedo.catalogue
from albedo.cli import app
from albedo.describe import citation, markdown
from albedo.estimate import format_value
from albedo.ledger import load_ledger
from albedo.studies import StudyFile, run_study

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
CONTRIBUTING = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
PUMPING = (ROOT / "docs" / "pumping.md").read_text(encoding="utf-8")
COUPLING = (ROOT / "docs" / "coupling.md").read_text(encoding="utf-8")
RADIANCE = (ROOT / "docs" / "radiance.md").read_text(encoding="utf-8")
GRAZING = (ROOT / "docs" / "grazing.md").read_text(encoding="utf-8")
SCALE_DOWN = (ROOT / "docs" / "scale_down.md").read_text(encoding="utf-8")
ADVICE = (ROOT / "docs" / "advice.md").read_text(encoding="utf-8")
LOOKUP = (ROOT / "docs" / "lookup.md").read_text(encoding="utf-8")

_NUMBER = re.compile(r"(-?\d+(?:\.\d+)?)\((\d+)\)(?:e([+-]?\d+))?")


def blocks(text: str, language: str) -> list[str]:
    """Contents of the fenced blocks of a language."""
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


def intervals(text: str) -> list[tuple[Decimal, Decimal]]:
    """Every number with its error in the text, as centre and radius."""
    found = []
    for digits, error, power in _NUMBER.findall(text):
        value = Decimal(digits)
        scale = Decimal(1).scaleb(int(power or 0))
        unit = Decimal(1).scaleb(int(value.as_tuple().exponent))
        found.append((value * scale, int(error) * unit * scale))
    return found


def agree(a: tuple[Decimal, Decimal], b: tuple[Decimal, Decimal]) -> bool:
    """Whether two intervals overlap."""
    return abs(a[0] - b[0]) <= a[1] + b[1]


def commands(text: str, start: str) -> list[list[str]]:
    """Lines of the shell blocks that begin so, as arguments; comments are dropped."""
    lines = [line for block in blocks(text, "sh") for line in block.splitlines()]
    return [shlex.split(line, comments=True)[1:] for line in lines if line.startswith(start)]


def output(arguments: list[str]) -> str:
    """What a command prints."""
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    return result.output


class Intervals(doctest.OutputChecker):
    """Compares text, with numbers that carry an error as intervals."""

    def check_output(self, want: str, got: str, optionflags: int) -> bool:
        same_text = _NUMBER.sub("#", want) == _NUMBER.sub("#", got)
        pairs = zip(intervals(want), intervals(got), strict=True)
        return same_text and all(agree(a, b) for a, b in pairs)


@pytest.mark.parametrize(
    "text",
    [README, CONTRIBUTING, PUMPING, COUPLING, RADIANCE, GRAZING, SCALE_DOWN, ADVICE, LOOKUP],
    ids=[
        *("readme", "contributing", "pumping", "coupling", "radiance", "grazing"),
        *("scale_down", "advice", "lookup"),
    ],
)
def test_python_snippets_print_what_is_shown(text: str) -> None:
    source = "\n".join(block for block in blocks(text, "python") if block.startswith(">>> "))
    test = doctest.DocTestParser().get_doctest(source, {}, "snippets", None, 0)
    result = doctest.DocTestRunner(checker=Intervals(), verbose=False).run(test)
    assert result.failed == 0


SHOWN = [
    *commands(README, "albedo models"),
    *commands(README.partition("## What was found")[0], "albedo eval"),
    *commands(README, "albedo table"),
    *commands(README, "albedo plot"),
    *commands(README, "albedo energy"),
    *commands(README, "albedo pump"),
    *commands(README, "albedo stability"),
    *commands(README, "albedo cost"),
    *commands(README, "albedo advise"),
    *commands(README, "albedo design"),
    *commands(ADVICE, "albedo advise"),
    *commands(RADIANCE, "albedo radiance"),
]


# All tables take a minute; tests/test_atlas.py writes some of them.
LONG = [
    pytest.param(arguments, marks=pytest.mark.slow) if "--all" in arguments else arguments
    for arguments in SHOWN
]


@pytest.mark.parametrize("arguments", LONG, ids=" ".join)
def test_commands_work_as_shown(
    arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    output(arguments)
    if "-o" in arguments:
        assert (tmp_path / arguments[arguments.index("-o") + 1]).stat().st_size > 0


FINDINGS = README.partition("## What was found")[2].split("\n### ")[1:]


@pytest.mark.parametrize("finding", FINDINGS, ids=lambda text: text.partition("\n")[0])
def test_findings_are_measured_again(finding: str) -> None:
    runs = commands(finding.partition("\n## ")[0], "albedo eval")
    measured = []
    for arguments in runs:
        printed = output([word for word in arguments if word != "--csv"])
        measured += intervals(printed)
    for name in re.findall(r"albedo study run (\w+)", finding):
        manifest = json.loads((ROOT / f"reports/studies/{name}/manifest.json").read_text("utf-8"))
        measured += intervals(" ".join(manifest["notes"]))
    stated = intervals(re.sub(r"```.*?```", "", finding, flags=re.DOTALL))
    assert stated
    for number in stated:
        assert any(agree(number, other) for other in measured), f"{number} was not measured"


def test_verdicts_of_the_readme_are_those_of_the_ledger() -> None:
    rows = {row.id: row for row in load_ledger(ROOT / "reports")}
    told = README.partition("## What was found")[2].partition("\n### ")[0]
    kinds = [row.kind for row in rows.values() if row.paper]
    counts = {
        "hold": sum(kind.startswith("holds") for kind in kinds),
        "fail": kinds.count("fails"),
        "depend": kinds.count("depends on the reading"),
        "is undecided": kinds.count("undecided"),
        "wait": kinds.count("pending"),
    }
    assert sum(counts.values()) == len(kinds)
    assert f"Of {len(kinds)} statements" in told
    for verb, count in counts.items():
        assert re.search(rf"\b{count} {verb}\b", told), (verb, count)
    items = re.findall(r"^- \*\*(\w+) (.*?)\.\*\*(.*?)(?=^- |^$)", told, re.MULTILINE | re.DOTALL)
    assert len(items) == 5
    for id, verdict, text in items:
        assert rows[id].kind == verdict
        parts = [(float(part["value"]), float(part["error"])) for part in rows[id].parts]
        measured = intervals(" ".join(format_value(*part) for part in parts))
        for number in intervals(text):
            assert any(agree(number, other) for other in measured), f"{id}: {number}"


def test_committed_results_are_what_their_manifest_says() -> None:
    for path in (ROOT / "reports" / "studies").glob("*/manifest.json"):
        manifest = json.loads(path.read_text(encoding="utf-8"))
        assert manifest["fidelity"] == "full"
        for name, digest in manifest["outputs"].items():
            assert hashlib.sha256((path.parent / name).read_bytes()).hexdigest() == digest, name


@pytest.mark.parametrize(
    "page",
    ["README.md", "CONTRIBUTING.md", "reports/README.md", "docs/radiance.md", "docs/reports.md"],
)
def test_links_between_files_lead_somewhere(page: str) -> None:
    text = (ROOT / page).read_text(encoding="utf-8")
    targets = [target for target in re.findall(r"\]\(([^)\s]+)\)", text) if "://" not in target]
    assert targets
    for target in targets:
        assert (ROOT / page).parent.joinpath(target.partition("#")[0]).exists(), target


def test_continuous_integration_runs_the_command_of_the_readme() -> None:
    (command,) = re.findall(r"<!-- test command -->\n```sh\n(.*)\n```\n", README)
    # bash in place of the command shows what would run.
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    shown = script.replace("exec bash -euo pipefail -c", "printf '%s\\n'")
    assert shown != script
    there = shown.replace('"$(dirname "${BASH_SOURCE[0]}")/.."', shlex.quote(str(ROOT)))
    run = subprocess.run(["bash", "-c", there], capture_output=True, text=True, check=True)
    assert run.stdout.splitlines() == [f"+ {command}", command]


# CONTRIBUTING.md adds a model and a study; the same is done here.


def example(start: str) -> str:
    """The block of CONTRIBUTING.md that starts so."""
    found = [b for kind in ("python", "bibtex") for b in blocks(CONTRIBUTING, kind)]
    (block,) = [block for block in found if block.startswith(start)]
    return block


MODEL = example('"""Lommel and Seeliger')
STUDY = example('"""How much')
ORACLE = example('"""lommel_seeliger, once')
ENTRY = example("@article{seeliger1887")


@pytest.fixture
def lommel_seeliger(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[types.ModuleType]:
    """The catalogue with the model of CONTRIBUTING.md in it."""
    folder = tmp_path / "catalogue"
    folder.mkdir()
    (folder / "lommel_seeliger.py").write_text(MODEL, encoding="utf-8")
    catalogue = albedo.catalogue
    monkeypatch.setattr(catalogue, "__path__", [*catalogue.__path__, str(folder)])
    catalogue.model_class.cache_clear()
    yield catalogue
    monkeypatch.undo()
    catalogue.model_class.cache_clear()
    sys.modules.pop("albedo.catalogue.lommel_seeliger", None)


def closed_form(mu: float) -> float:
    """Albedo of Lommel and Seeliger's law for w = 1."""
    return 0.5 * (1.0 - mu * math.log1p(1.0 / mu))


@pytest.mark.usefixtures("lommel_seeliger")
def test_the_model_of_the_guide_has_its_closed_form() -> None:
    cosines = np.array([1.0, 0.5, 0.1, 1e-3, 1e-6])
    found = albedo.directional_albedo(albedo.model("lommel_seeliger"), cosines, rtol=1e-10)
    exact = np.array([closed_form(mu) for mu in cosines])
    assert np.all(found.converged)
    assert np.all(np.abs(found.value - exact) <= found.error + 4 * np.finfo(float).eps)


@pytest.mark.usefixtures("lommel_seeliger")
def test_the_guide_shows_what_the_command_line_prints() -> None:
    shown = re.findall(r"^```text\n\$ albedo (eval .*?)\n(.*?)^```$", CONTRIBUTING, re.M | re.S)
    assert shown
    for line, printed in shown:
        again = intervals(output(shlex.split(line)))
        assert all(agree(a, b) for a, b in zip(intervals(printed), again, strict=True))


@pytest.mark.usefixtures("lommel_seeliger")
def test_the_study_of_the_guide_runs_and_its_claim_holds(tmp_path: Path) -> None:
    path = tmp_path / "dusty_layer.py"
    path.write_text(STUDY, encoding="utf-8")
    result = run_study(StudyFile(path), tmp_path / "results")
    assert result.manifest["error"] is None
    assert [claim["verdict"] for claim in result.manifest["claims"]] == ["holds"]
    assert not result.manifest["warnings"]


@pytest.mark.slow
def test_the_steps_of_the_guide_pass_the_tests(tmp_path: Path) -> None:
    for name in ("albedo", "tests"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    (tmp_path / "albedo/catalogue/lommel_seeliger.py").write_text(MODEL, encoding="utf-8")
    bib = tmp_path / "albedo/references.bib"
    entries = bib.read_text(encoding="utf-8")
    later = min(key for key in re.findall(r"^@\w+\{(\w+),", entries, re.M) if key > "seeliger1887")
    bib.write_text(re.sub(rf"^(@\w+\{{{later},)", rf"{ENTRY}\n\1", entries, flags=re.M), "utf-8")
    (tmp_path / "tests/oracles/lommel_seeliger.py").write_text(ORACLE, encoding="utf-8")
    tests = ["tests/test_models.py", "tests/test_references.py"]
    chosen = ["-k", "lommel_seeliger or references"]
    run = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *tests, *chosen],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stdout


def test_the_list_of_models_is_current() -> None:
    """``albedo models --markdown`` prints what stands in README.md."""
    (shown,) = re.findall(r"<!-- models -->\n(.*?)<!-- end -->", README, re.S)
    assert shown == markdown()


def test_sources_are_readable() -> None:
    assert citation("duer2006").startswith("Dür: An Improved Normalization for the Ward")
