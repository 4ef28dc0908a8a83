"""The committed reports: complete, derived from what was measured, and small enough."""

from __future__ import annotations

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest
from PIL import Image
from typer.testing import CliRunner

from albedo.cli import app
from albedo.ledger import ledger, load_ledger
from albedo.papers import read_papers
from albedo.report import record
from albedo.sources import versions

ROOT = Path(__file__).parent.parent
REPORTS = ROOT / "reports"
PAPERS = read_papers(ROOT / "studies")
MANIFESTS = [
    json.loads(path.read_text(encoding="utf-8"))
    for path in sorted((REPORTS / "studies").glob("*/manifest.json"))
]
# What cannot be measured yet, and nothing else: a rendered scene and measured data are missing.
PENDING = {"N14", "N16"}
MOST_BYTES = 15_000_000
LINK = "{http://www.w3.org/1999/xlink}href"


def test_every_study_has_its_results():
    names = {path.stem for path in (ROOT / "studies").glob("*.py") if path.name[0] != "_"}
    for folder in (REPORTS, REPORTS / "quick"):
        found = {path.parent.name for path in (folder / "studies").glob("*/manifest.json")}
        assert found == names
    assert all(manifest["error"] is None for manifest in MANIFESTS)
    assert all(manifest["warnings"] == [] for manifest in MANIFESTS)


def test_the_ledger_is_what_was_measured():
    rows = load_ledger(REPORTS)
    # As JSON has it, where infinity is a text.
    again = ledger(PAPERS, MANIFESTS)
    assert rows == again
    counts = {"N": 17, "A": 14, "S": 18}
    expected = [f"{key}{k}" for key, end in counts.items() for k in range(1, end)]
    papers = [row.id for row in rows if row.paper]
    assert sorted(papers) == sorted(expected)
    assert {row.id for row in rows if row.kind == "pending"} == PENDING
    assert not [row.id for row in rows if row.kind == "not measured"]


@pytest.mark.parametrize("row", load_ledger(REPORTS), ids=lambda row: row.id)
def test_what_does_not_hold_is_explained(row):
    if row.kind in ("fails", "depends on the reading", "undecided"):
        assert any(len(text) > 80 for text in row.explanations)
    for part in row.parts:
        folder = REPORTS / "studies" / part["study"]
        for key, ending in (("figure", ".svg"), ("table", ".csv")):
            assert not part[key] or (folder / f"{part[key]}{ending}").is_file()


def test_every_figure_that_is_no_scene_has_its_study():
    shown = {(m["study"]["paper"], m["study"]["figure"]) for m in MANIFESTS}
    for paper in PAPERS:
        for figure in paper.figures:
            own = (paper.key, f"Figure {figure.number}") in shown
            assert own != bool(figure.pending), f"{paper.key} figure {figure.number}"


def test_claims_are_printed_where_the_readme_says(monkeypatch):
    monkeypatch.chdir(ROOT)
    listed = CliRunner().invoke(app, ["claims"])
    assert listed.exit_code == 0, listed.output
    lines = [line.rstrip() for line in listed.stdout.splitlines()]
    (line,) = [line for line in lines if line.split()[:1] == ["S11"]]
    assert "depends on the reading  " in line
    # Also where there is no terminal that would wrap it.
    assert max(map(len, lines)) < 240
    one = CliRunner().invoke(app, ["claims", "N4"])
    assert "[G as printed]" in one.stdout


def test_the_record_is_that_of_the_studies():
    found = json.loads((REPORTS / "manifest.json").read_text(encoding="utf-8"))
    assert found["studies"] == record(MANIFESTS, True)["studies"]
    assert found["made_with"].keys() == versions().keys()
    assert found["fidelity"] == "full"


def test_the_site_is_small():
    # All that a reader loads or downloads; what quick runs are checked against is no part of it.
    apart = [REPORTS / name for name in ("build", "quick", "README.md")]
    site = [path for path in REPORTS.rglob("*") if path.is_file()]
    site = [path for path in site if not any(path.is_relative_to(place) for place in apart)]
    assert sum(path.stat().st_size for path in site) < MOST_BYTES


@pytest.mark.parametrize("study", [manifest["study"]["name"] for manifest in MANIFESTS])
def test_drawings_are_whole(study):
    for path in (REPORTS / "studies" / study).glob("*.svg"):
        root = ElementTree.parse(path).getroot()
        named = {item.get("id") for item in root.iter()}
        for item in root.iter():
            # What is drawn again, or cut along, is there.
            for target in (item.get(LINK, ""), item.get("clip-path", "")):
                if found := re.search(r"#([\w.-]+)", target):
                    assert found[1] in named, f"{path.name}: {target}"
        with Image.open(path.with_suffix(".png")) as picture:
            assert picture.mode == "P"
            picture.load()
