"""The ledger of claims, the list of the papers' claims, and the check of one run by another."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from typer.testing import CliRunner

from albedo.cli import app
from albedo.errors import InputError
from albedo.ledger import Row, kind_of, ledger, load_ledger, save_ledger
from albedo.papers import read_papers
from albedo.recheck import compare_runs
from albedo.studies import StudyFile, run_study

ROOT = Path(__file__).parent.parent

PAPERS = """
[P]
title = "A Paper"
authors = "A. Author"
year = 1999
about = "Light."
[[P.figures]]
number = "1"
caption = "A curve."
[[P.figures]]
number = "2"
caption = "A scene."
pending = "needs a rendered scene"
[P.claims.P1]
says = "It is below one."
where = "eq. 3"
[P.claims.P2]
says = "It is seen."
pending = "needs a rendered scene"
[P.claims.P3]
says = "It is forgotten."
"""


def claim(verdict: str, reading: str = "", id: str = "P1") -> dict[str, Any]:
    return {
        "id": id,
        "statement": "It is.",
        "quantity": "a number",
        "value": 0.5,
        "error": 0.1,
        "kind": "bound",
        "criterion": "< 1",
        "verdict": verdict,
        "reading": reading,
        "figure": "",
        "table": "other",
        "machine": False,
    }


def manifest(*claims: dict[str, Any], name: str = "one", **more: Any) -> dict[str, Any]:
    return {
        "study": {"name": name},
        "error": None,
        "claims": list(claims),
        "explanations": {"P1": ["Because."]},
        "figures": [{"name": "picture"}],
        "tables": [{"name": "numbers"}],
        "seconds": 2.0,
        **more,
    }


@pytest.fixture
def papers(tmp_path):
    (tmp_path / "papers.toml").write_text(PAPERS)
    return read_papers(tmp_path)


def verdict_of(papers, *parts: tuple[str, str]) -> Row:
    return ledger(papers, [manifest(*(claim(*part) for part in parts))])[0]


@pytest.mark.parametrize(
    ("parts", "verdict", "why"),
    [
        ([("holds", "")], "holds", ""),
        ([("holds within the bound, 2e-9", "")], "holds within the bound, 2e-9", ""),
        ([("holds", ""), ("holds within the bound, 2e-9", "")], "holds within the bounds", ""),
        ([("holds", ""), ("fails", "")], "fails", "1 of 2 measured statements hold"),
        ([("fails", ""), ("fails", "")], "fails", ""),
        ([("fails, by 1", ""), ("fails, by 2", "")], "fails", ""),
        ([("holds", ""), ("undecided: no", "")], "undecided", "1 of 2 measured statements hold"),
        (
            [("holds", "a"), ("fails", "b"), ("holds", "b")],
            "depends on the reading: holds [a]; fails [b]",
            "",
        ),
        # What is measured for no reading belongs to all of them.
        (
            [("holds", "a"), ("holds", "b"), ("fails", "")],
            "fails",
            "2 of 3 measured statements hold",
        ),
        ([("fails", "a"), ("fails", "b")], "fails", ""),
        ([("holds", "a"), ("holds", "b")], "holds", ""),
        (
            [("depends on the reading: x", ""), ("holds", "")],
            "depends on the reading",
            "1 of 2 measured statements hold",
        ),
    ],
)
def test_a_verdict_follows_from_its_parts(papers, parts, verdict, why):
    row = verdict_of(papers, *parts)
    assert (row.verdict, row.why) == (verdict, why)


def test_a_ledger_has_every_claim_once(papers):
    rows = ledger(
        papers,
        [
            manifest(claim("holds"), claim("holds", id="Q7")),
            manifest(claim("fails"), name="broken", error={"kind": "RuntimeError"}),
            manifest(claim("holds"), name="two"),
        ],
    )
    assert [(row.id, row.kind) for row in rows] == [
        ("P1", "holds"),
        ("P2", "pending"),
        ("P3", "not measured"),
        ("Q7", "holds"),
    ]
    first, second = rows[:2]
    assert [part["study"] for part in first.parts] == ["one", "two"]
    assert (first.parts[0]["figure"], first.parts[0]["table"]) == ("picture", "other")
    assert (first.where, first.paper, first.seconds) == ("eq. 3", "P", 4.0)
    assert first.explanations == ("Because.", "Because.")
    assert second.pending == "needs a rendered scene"


def test_a_ledger_is_read_as_it_was_written(papers, tmp_path):
    rows = ledger(papers, [manifest(claim("holds"))])
    save_ledger(rows, tmp_path)
    assert load_ledger(tmp_path) == rows
    frame = pd.read_csv(tmp_path / "claims.csv")
    assert list(frame["id"]) == ["P1", "P2", "P3"]
    assert (frame["measured"][0], frame["measured_error"][0]) == (0.5, 0.1)
    assert frame["data"][0] == "studies/one/other.csv"
    (tmp_path / "claims.json").write_text('{"claims": [{"id": 1}]}')
    with pytest.raises(InputError, match="is damaged"):
        load_ledger(tmp_path)
    with pytest.raises(InputError, match="There is no"):
        load_ledger(tmp_path / "nowhere")


def test_claims_are_printed(papers, tmp_path):
    parts = claim("holds", "a"), claim("fails", "b")
    save_ledger(ledger(papers, [manifest(*parts)]), tmp_path)

    def run(*words: str) -> Any:
        return CliRunner().invoke(app, ["claims", *words, "--reports", str(tmp_path)])

    listed = run()
    assert listed.exit_code == 0, listed.output
    assert "depends on the reading  " in listed.stdout
    assert "pending (needs a rendered scene)" in listed.stdout
    one = run("p1")
    assert "depends on the reading: holds [a]; fails [b]" in one.stdout
    assert "0.5(1)" in one.stdout
    assert "Because." in one.stdout
    assert "fails [b]" in one.stdout
    assert json.loads(run("P1", "--json").stdout)[0]["parts"][1]["reading"] == "b"
    refused = run("P9")
    assert refused.exit_code == 2
    assert "there are P1, P2, P3" in refused.stderr


@pytest.mark.parametrize(
    ("before", "after", "says"),
    [
        ("[P]", "[P", "cannot be read"),
        ('title = "A Paper"', "", "has no title"),
        ('title = "A Paper"', 'title = "A"\ncolour = "red"', "unknown colour"),
        ("year = 1999", 'year = "1999"', "whole number"),
        ('says = "It is seen."', "says = 3", "must be a text"),
        ('caption = "A scene."', "", "has no caption"),
        ("[P.claims.P3]", "[Q]\ntitle = 'x'\nauthors = 'y'\n[Q.claims.P1]", "two claims called P1"),
    ],
)
def test_mistakes_in_a_list_of_claims(tmp_path, before, after, says):
    assert before in PAPERS
    (tmp_path / "papers.toml").write_text(PAPERS.replace(before, after, 1))
    with pytest.raises(InputError, match=says):
        read_papers(tmp_path)


def test_a_folder_may_have_no_papers(tmp_path):
    assert read_papers(tmp_path) == ()


STUDY = '''"""Question?"""
import pandas as pd
from albedo.studies import Study
STUDY = Study(name="one", title="T", claims=("P1", "P2"))
def run(context):
    frame = pd.DataFrame({
        "model": ["ward", "phong"], "x": [0.5, 1.5], "a": [1.0, float("inf")],
        "a_error": [1e-3, 0.0], "a_evaluations": [10, 20], "count": [3, 4],
        "at": [10.0, 20.0], "ns": [3.0, 4.0], "none": [float("nan"), 1.0],
        "deg": [100 / 3, 0.0],
    })
    context.table("numbers", frame, machine=("ns",), loose={"at": 0.5}, digits={"deg": 5})
    context.claim("P1", "It is.", 0.5, 0.01, "< 1")
    context.claim("P2", "It is fast.", 0.5, 0.01, "< 1", machine=True)
'''


@pytest.fixture
def runs(tmp_path):
    (tmp_path / "one.py").write_text(STUDY)
    assert not run_study(StudyFile(tmp_path / "one.py"), tmp_path / "kept" / "studies").failed
    shutil.copytree(tmp_path / "kept", tmp_path / "new")
    return tmp_path / "kept", tmp_path / "new"


def test_equal_runs_agree(runs):
    found = compare_runs(*runs)
    assert found.differences == []
    assert (found.studies, found.claims, found.columns, found.values) == (1, 2, 7, 14)
    assert (found.files, found.same_bytes) == (1, 1)


@pytest.mark.parametrize(
    ("column", "row", "value", "agrees"),
    [
        ("a", 0, 1.0019, True),  # both bounds together are 2e-3
        ("a", 0, 1.0021, False),
        ("a", 1, 5.0, False),
        ("a_error", 0, 5.0, True),  # it only says how far values may differ
        ("a_evaluations", 0, 99, True),
        ("x", 0, 0.5 * (1 + 1e-10), True),
        ("x", 0, 0.5 * (1 + 1e-8), False),
        ("count", 0, 4, False),
        ("at", 0, 10.4, True),
        ("at", 0, 10.6, False),
        ("deg", 0, 33.334, True),  # the last of its digits
        ("deg", 0, 33.337, False),
        ("ns", 0, 99.0, True),
        ("none", 0, 1.0, False),
        ("none", 1, float("nan"), False),
        ("model", 0, "blinn", False),
    ],
)
def test_values_are_compared_within_their_bounds(runs, column, row, value, agrees):
    path = runs[1] / "studies" / "one" / "numbers.csv"
    frame = pd.read_csv(path)
    frame[column] = frame[column].astype(object if isinstance(value, str) else float)
    frame.loc[row, column] = value
    if column in ("count", "a_evaluations"):
        frame[column] = frame[column].astype(int)
    frame.to_csv(path, index=False)
    found = compare_runs(*runs)
    assert found.same_bytes == 0
    assert [item.place for item in found.differences] == (
        [] if agrees else [f"one/numbers, {column}, row {row + 1}"]
    )


@pytest.mark.parametrize(
    ("change", "differs"),
    [
        ({"value": 0.519}, False),
        ({"value": 0.521}, True),
        ({"verdict": "undecided: reaches across"}, True),
        ({"reading": "another"}, True),
        ({"machine": True, "value": 9.0, "verdict": "fails"}, False),
    ],
)
def test_claims_are_compared(runs, change, differs):
    path = runs[1] / "studies" / "one" / "manifest.json"
    record = json.loads(path.read_text())
    record["claims"][0] |= change
    path.write_text(json.dumps(record))
    assert bool(compare_runs(*runs).differences) == differs


def test_an_error_that_got_out_of_hand_excuses_little(runs):
    path = runs[1] / "studies" / "one" / "numbers.csv"
    frame = pd.read_csv(path)
    # The former error is 1e-3, which excuses ten more of them.
    for value, agrees in ((1.0109, True), (1.0111, False)):
        frame["a"], frame["a_error"] = [value, float("inf")], [float("inf"), 0.0]
        frame.to_csv(path, index=False)
        assert (compare_runs(*runs).differences == []) == agrees


def test_times_keep_their_ranking(tmp_path):
    source = (
        '"""Question?"""\nimport pandas as pd\nfrom albedo.studies import Study\n'
        'STUDY = Study(name="one", title="T")\n'
        "def run(context):\n"
        '    context.table("t", pd.DataFrame({"ns": [float(3**k) for k in range(8)]}), '
        'machine=("ns",))\n'
    )
    (tmp_path / "one.py").write_text(source)
    for name in ("kept", "new"):
        run_study(StudyFile(tmp_path / "one.py"), tmp_path / name / "studies")
    path = tmp_path / "new" / "studies" / "one" / "t.csv"
    folders = tmp_path / "kept", tmp_path / "new"
    times = pd.read_csv(path)["ns"].tolist()
    # Of the 21 pairs that lie more than threefold apart three may change their order.
    for turned, agrees in ((0, True), (3, True), (4, True), (5, False)):
        moved = times[:]
        moved.insert(0, moved.pop(turned))
        pd.DataFrame({"ns": moved}).to_csv(path, index=False)
        found = compare_runs(*folders)
        assert found.rankings == 1
        assert (found.differences == []) == agrees, turned
    assert [item.place for item in found.differences] == ["one/t, ns, order"]
    found = compare_runs(*folders, times=False)
    assert found.rankings == 0
    assert found.differences == []


@pytest.mark.parametrize("ends", [("ns_low", "ns_high"), ("ns_error",)])
def test_times_are_ranked_beyond_their_errors(tmp_path, ends):
    """Differences of times are smaller than their errors where nothing was saved."""
    rows = {"ns": [1.0, 9.0, 27.0, 81.0, 243.0]}
    rows["ns_low"] = [value * 0.9 for value in rows["ns"]]
    rows["ns_high"] = [value * 1.1 for value in rows["ns"]]
    rows["ns_error"] = [value * 0.1 for value in rows["ns"]]
    source = (
        '"""Question?"""\nimport pandas as pd\nfrom albedo.studies import Study\n'
        'STUDY = Study(name="one", title="T")\n'
        "def run(context):\n"
        f"    frame = pd.DataFrame({ {key: rows[key] for key in ('ns', *ends)} })\n"
        f"    context.table('t', frame, machine={('ns', *ends)})\n"
    )
    (tmp_path / "one.py").write_text(source)
    for name in ("kept", "new"):
        run_study(StudyFile(tmp_path / "one.py"), tmp_path / name / "studies")
    path = tmp_path / "new" / "studies" / "one" / "t.csv"
    frame = pd.read_csv(path)
    # Ten pairs, of which three are threefold apart in their middles only.
    frame.iloc[::-1].to_csv(path, index=False)
    found = compare_runs(tmp_path / "kept", tmp_path / "new")
    assert [item.new for item in found.differences] == ["7 of 7 the other way round"]
    # The same order, within errors that have grown.
    frame = frame.iloc[::-1].reset_index(drop=True)
    frame["ns_low"], frame["ns_high"], frame["ns_error"] = -300.0, 300.0, 300.0
    frame[["ns", *ends]].to_csv(path, index=False)
    assert compare_runs(tmp_path / "kept", tmp_path / "new").differences == []


def test_what_is_missing_or_failed_differs(runs):
    kept, new = runs
    path = new / "studies" / "one" / "manifest.json"
    text = path.read_text()
    for before, after in (
        ('"fidelity": "quick"', '"fidelity": "full"'),
        ('"error": null', '"error": {"message": "no luck"}'),
    ):
        assert before in text
        path.write_text(text.replace(before, after))
        assert len(compare_runs(kept, new).differences) == 1
    path.write_text(text)
    table = new / "studies" / "one" / "numbers.csv"
    frame = pd.read_csv(table)
    frame.iloc[:1].to_csv(table, index=False)
    assert "rows" in compare_runs(kept, new).differences[0].place
    frame.rename(columns={"x": "y"}).to_csv(table, index=False)
    assert "columns" in compare_runs(kept, new).differences[0].place
    table.unlink()
    with pytest.raises(InputError, match="damaged"):
        compare_runs(kept, new)
    shutil.rmtree(new / "studies" / "one")
    assert compare_runs(kept, new).differences[0].new == "no such study"
    with pytest.raises(InputError, match="holds no studies"):
        compare_runs(new, kept)


def test_kinds_of_verdicts():
    assert kind_of("holds within the bound, 2e-9") == "holds within"
    assert kind_of("undecided: reaches") == "undecided"
    assert kind_of("not measured") == "not measured"
