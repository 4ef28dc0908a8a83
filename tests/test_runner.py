"""Running studies: in processes of their own, several at a time, and not without need."""

from __future__ import annotations

import json
import multiprocessing
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path

import pytest
from typer.testing import CliRunner

import albedo
from albedo import _compile, runner, sources
from albedo.cli import app
from albedo.errors import InputError
from albedo.runner import run_studies
from albedo.studies import Result, StudyFile, discover, write_skeleton

HEAD = '''"""Question?"""
import pandas as pd
from albedo.studies import Study
STUDY = Study(name={name!r}, title="T"{more})
def run(context):
    context.table("one", pd.DataFrame({{"x": [1.0]}}))
    {body}
'''

# Starting a process on two busy cores; no test waits as long unless something hangs.
PATIENCE = 120.0


def write(folder: Path, name: str, body: str = "pass", more: str = "") -> StudyFile:
    folder.mkdir(exist_ok=True)
    path = folder / f"{name}.py"
    path.write_text(HEAD.format(name=name, body=body, more=more))
    return StudyFile(path)


class Watcher:
    """Notes what happens."""

    def __init__(self) -> None:
        self.ran: list[str] = []
        self.kept: list[str] = []
        self.steps: list[tuple[str, int, int, str]] = []
        self.seen: list[tuple[int, int, float]] = []
        self.events: list[str] = []

    def begun(self, name: str) -> None:
        self.events.append(f"+{name}")

    def step(self, name: str, done: int, total: int, text: str) -> None:
        self.steps.append((name, done, total, text))

    def left(self, finished: int, total: int, seconds: float) -> None:
        self.seen.append((finished, total, seconds))

    def ended(self, result: Result, kept: bool) -> None:
        (self.kept if kept else self.ran).append(result.name)
        self.events.append(f"-{result.name}")


def ran(files: list[StudyFile], out: Path, **options: object) -> list[str]:
    watcher = Watcher()
    run_studies(files, out, screen=watcher, **options)  # type: ignore[arg-type]
    assert sorted(watcher.ran + watcher.kept) == sorted(file.name for file in files)
    return sorted(watcher.ran)


def test_what_did_not_change_is_not_run_again(tmp_path):
    folder, out = tmp_path / "studies", tmp_path / "out"
    helper = folder / "_helper.py"
    one = write(folder, "one", "import _helper; context.note(str(_helper.x))")
    two = write(folder, "two", "from albedo.metals import _table; _table('gold', 'glassner')")
    data = folder / "data.csv"
    three = write(folder, "three", f"context.note(open({str(data)!r}).read())")
    helper.write_text("import _deeper\nx = _deeper.y\n")
    (folder / "_deeper.py").write_text("y = 1\n")
    data.write_text("1\n")
    files = [one, two, three]
    assert ran(files, out) == ["one", "three", "two"]
    assert ran(files, out) == []
    # A module that a module imports; data; the file of the study; another fidelity.
    (folder / "_deeper.py").write_text("y = 2\n")
    assert ran(files, out) == ["one"]
    assert json.loads((out / "one" / "manifest.json").read_text())["notes"] == ["2"]
    data.write_text("2\n")
    assert ran(files, out) == ["three"]
    two.path.write_text(two.path.read_text() + "# more\n")
    assert ran(files, out) == ["two"]
    assert ran([two], out, full=True) == ["two"]
    assert ran([two], out) == ["two"]
    # Results that are no longer what they were.
    (out / "one" / "one.csv").write_text("x\n2.0\n")
    (out / "three" / "one.csv").unlink()
    assert ran(files, out) == ["one", "three"]
    assert ran([one], out, again=True) == ["one"]


def test_only_what_a_study_reads_is_what_it_rests_on(tmp_path):
    body = "import albedo; albedo.directional_albedo(albedo.model('phong', n=20), 0.5)"
    file = write(tmp_path / "studies", "one", body)
    (result,) = run_studies([file], tmp_path / "out")
    read = result.manifest["inputs"]["sources"]
    assert {"./one.py", "albedo/quadrature.py", "albedo/catalogue/phong.py"} <= set(read)
    assert not {name for name in read if name.startswith(("albedo/lookup", "albedo/cli"))}
    assert "albedo/catalogue/ward.py" not in read
    body = "from albedo.metals import _table; _table('gold', 'glassner')"
    (result,) = run_studies([write(tmp_path / "studies", "two", body)], tmp_path / "out")
    assert "albedo/metals.csv" in result.manifest["inputs"]["sources"]
    assert "albedo/operators/pump.py" not in read


def test_a_study_of_all_models_rests_on_their_list(tmp_path):
    body = "from albedo.catalogue import models; models()"
    file = write(tmp_path / "studies", "one", body)
    (result,) = run_studies([file], tmp_path / "out")
    assert "albedo/catalogue/" in result.manifest["inputs"]["sources"]


def test_an_edit_changes_the_digest(tmp_path, monkeypatch):
    package = tmp_path / "albedo"
    package.mkdir()
    (package / "one.py").write_text("1")
    monkeypatch.setattr(sources, "PACKAGE", package)
    names = ["albedo/one.py", "albedo/two.py", "albedo/"]
    digests = {sources.digest(names, tmp_path)}
    (package / "two.py").write_text("")
    digests.add(sources.digest(names, tmp_path))
    (package / "two.py").write_text("22")
    digests.add(sources.digest(names, tmp_path))
    (package / "three.py").write_text("3")
    digests.add(sources.digest(names, tmp_path))
    assert len(digests) == 4


def test_studies_run_side_by_side(tmp_path):
    folder = tmp_path / "studies"
    meet = (
        "import time, pathlib; p = pathlib.Path({own!r}); p.touch(); "
        "[time.sleep(0.01) for _ in range(3000) if not pathlib.Path({other!r}).exists()]; "
        "assert pathlib.Path({other!r}).exists()"
    )
    a, b = str(tmp_path / "a"), str(tmp_path / "b")
    files = [
        write(folder, "one", meet.format(own=a, other=b)),
        write(folder, "two", meet.format(own=b, other=a)),
    ]
    watcher = Watcher()
    results = run_studies(files, tmp_path / "out", jobs=2, screen=watcher)
    assert [result.name for result in results] == ["one", "two"]
    assert [result.manifest["error"] for result in results] == [None] * 2
    assert set(watcher.events[:2]) == {"+one", "+two"}
    assert watcher.seen[-1][:2] == (2, 2)
    assert all(seconds >= 0.0 for _, _, seconds in watcher.seen)
    with pytest.raises(InputError, match="jobs is 0"):
        run_studies(files, tmp_path / "out", jobs=0)


def timeline(log: Path) -> dict[str, dict[str, float]]:
    """When each study did what."""
    found: dict[str, dict[str, float]] = {}
    for line in log.read_text().splitlines():
        name, what, when = line.split()
        found.setdefault(name, {})[what] = float(when)
    return found


def logging(log: Path, name: str, *steps: str) -> str:
    """Lines of a study that write down when they are reached; `steps` are lines between them."""
    note = (
        "import time\n"
        "    def note(what):\n"
        f"        with open({str(log)!r}, 'a') as file:\n"
        f"            file.write(f'{name} {{what}} {{time.monotonic()}}\\n')"
    )
    return "\n    ".join((note, *steps))


@pytest.mark.parametrize("jobs", [1, 2, 3])
def test_times_are_taken_while_nothing_else_runs(tmp_path, jobs, monkeypatch):
    monkeypatch.setattr(runner, "_second_compiler", nullcontext)
    folder, log = tmp_path / "studies", tmp_path / "log"
    timed = (
        *("note('begin')", "time.sleep(0.1)", "note('ask')", "with context.alone():"),
        # What is alone already need not wait to be alone.
        *("    with context.alone(): note('alone')", "    time.sleep(0.2)", "    note('end')"),
        "time.sleep(0.1)",
    )
    plain = ("note('alone')", "time.sleep(0.6)", "note('end')")
    # Where all that run wait at once, one goes on before others begin: here one still runs.
    patient = f"while {jobs} > 1 and 'd_plain' not in open({str(log)!r}).read(): time.sleep(0.01)"
    files = [
        write(folder, "a_timed", logging(log, "a_timed", *timed)),
        write(folder, "b_timed", logging(log, "b_timed", timed[0], patient, *timed[2:])),
        write(folder, "c_fails", logging(log, "c_fails", *timed[:5], "    raise ValueError()")),
        *(write(folder, name, logging(log, name, *plain)) for name in ("d_plain", "e_plain")),
    ]
    before = time.monotonic()
    results = run_studies(files, tmp_path / "out", jobs=jobs, keep_failure=True)
    took = time.monotonic() - before
    assert [result.failed for result in results] == [False, False, True, False, False]
    seen = timeline(log)
    for name in ("a_timed", "b_timed"):
        for other in seen.keys() - {name, "c_fails"}:
            apart = seen[name]["end"] <= seen[other]["alone"]
            assert apart or seen[other]["end"] <= seen[name]["alone"]
        assert not seen[name]["alone"] < seen["c_fails"]["alone"] < seen[name]["end"]
    for result in results[:3]:
        # Nor does the time count that they wait.
        waited = seen[result.name]["alone"] - seen[result.name]["ask"]
        assert 0.0 < result.manifest["seconds"] <= took - 0.9 * waited
    if jobs == 2:
        # They get ready beside others, which do not wait for them.
        assert seen["a_timed"]["ask"] < seen["d_plain"]["end"] <= seen["a_timed"]["alone"]


def interrupt(
    folder: Path,
    names: Sequence[str],
    out: Path,
    *,
    when: Callable[[], bool],
    jobs: int = 2,
    how: int = signal.SIGINT,
) -> None:
    """Run studies from the command line, and interrupt them at some time."""
    environment = {**os.environ, "PYTHONPATH": str(Path(albedo.__file__).parents[1])}
    process = subprocess.Popen(
        [
            *(sys.executable, "-c", "from albedo.cli import main; main()"),
            *("study", "run", *names, "--jobs", str(jobs), "-o", str(out)),
        ],
        cwd=folder.parent,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    end = time.monotonic() + PATIENCE
    while not when() and time.monotonic() < end:
        time.sleep(0.05)
    process.send_signal(how)
    try:
        _, errors = process.communicate(timeout=PATIENCE)
    finally:
        process.kill()
    assert process.returncode == (130 if how == signal.SIGINT else -how), errors
    assert "Traceback" not in errors


@pytest.mark.parametrize("refused", [False, True])
def test_a_study_that_ends_when_nobody_listens_was_interrupted(tmp_path, monkeypatch, refused):
    """The runner may be killed after the last step, before the result is sent."""

    def run(*_: object, **__: object) -> str:
        if refused:
            raise InputError("no")
        return "result"

    monkeypatch.setattr(runner, "run_study", run)
    monkeypatch.setattr(runner, "watch", lambda: None)
    own, other = multiprocessing.Pipe()
    other.close()
    known = {key: os.environ[key] for key in os.environ if key.startswith("ALBEDO_")}
    with own, pytest.raises(SystemExit) as ended:
        runner._work(None, known, own, out=tmp_path)
    assert ended.value.code == runner._INTERRUPTED


@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGINT to send to one process")
def test_a_study_that_waits_to_be_alone_can_be_interrupted(tmp_path):
    folder, log = tmp_path / "studies", tmp_path / "log"
    write(folder, "busy", logging(log, "busy", "note('begin')", f"time.sleep({PATIENCE})"))
    write(folder, "timed", logging(log, "timed", "note('begin')", "context.alone().__enter__()"))
    interrupt(
        *(folder, ("busy", "timed"), tmp_path / "out"),
        when=lambda: log.exists() and log.read_text().count("begin") == 2,
    )
    assert not any((tmp_path / "out").iterdir())


@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGKILL")
def test_studies_whose_runner_was_killed_end_and_leave_nothing(tmp_path):
    folder, log, out = tmp_path / "studies", tmp_path / "log", tmp_path / "out"
    busy = "    for k in range(10_000): context.progress(k, 10_000); time.sleep(0.05)"
    timed = "    with context.alone(): note('alone')"
    for name, body in (("busy", busy), ("timed", timed)):
        steps = ("note('begin')", "try:", body, "finally: note('over')")
        write(folder, name, logging(log, name, *steps))
    interrupt(
        *(folder, ("busy", "timed"), out),
        when=lambda: log.exists() and log.read_text().count("begin") == 2,
        how=signal.SIGKILL,
    )
    end = time.monotonic() + PATIENCE
    # Their folders are there for a moment longer than what runs in them.
    while time.monotonic() < end and (log.read_text().count("over") < 2 or any(out.glob(".*"))):
        time.sleep(0.05)
    assert log.read_text().count("over") == 2
    assert "alone" not in log.read_text()
    assert not any(out.iterdir())


def test_what_integrates_is_compiled_beside_the_first_study(tmp_path, monkeypatch):
    folder, log, steps = tmp_path / "studies", tmp_path / "log", ("note('begin')", "note('end')")
    names = ("a_first", "b_second", "c_third")
    files = [write(folder, name, logging(log, name, *steps)) for name in names]
    asked: list[str] = []

    class Helper:
        """Is busy until two studies have ended."""

        def poll(self) -> int | None:
            done = log.exists() and log.read_text().count("end") >= 2
            return 0 if done else None

    @contextmanager
    def second_compiler(*models: str) -> Iterator[Helper]:
        asked.append("begun")
        yield Helper()
        asked.append("closed")

    monkeypatch.setattr(_compile, "second_compiler", second_compiler)
    run_studies(files, tmp_path / "out", jobs=2)
    assert asked == ["begun", "closed"]
    seen = timeline(log)
    first, second, third = (seen[name] for name in names)
    # It takes the place of a study.
    assert first["end"] <= second["begin"]
    assert second["end"] <= third["begin"]
    # Where one runs at a time there is no place for it.
    asked.clear()
    run_studies(files, tmp_path / "out", jobs=1, again=True)
    assert asked == []
    # Nor are times taken while it compiles.
    log.unlink()
    timed = ("with context.alone(): note('begin')", "note('end')")
    files[0] = write(folder, "a_first", logging(log, "a_first", *timed))
    run_studies(files, tmp_path / "out", jobs=2, again=True)
    seen = timeline(log)
    assert seen["c_third"]["end"] <= seen["a_first"]["begin"]


def test_tables_alone_are_kept_and_found_again(tmp_path):
    body = "from albedo.plotting import new_figure; context.figure('drawn', new_figure()[0])"
    file, out = write(tmp_path / "studies", "one", body), tmp_path / "out"
    run_studies([file], out, pictures=False)
    names = {path.name for path in (out / "one").iterdir()}
    assert names == {"one.csv", "manifest.json"}
    watcher = Watcher()
    run_studies([file], out, pictures=False, screen=watcher)
    assert (watcher.ran, watcher.kept) == ([], ["one"])
    # Who wants pictures gets them, and who does not want them need not throw them away.
    run_studies([file], out, screen=watcher)
    assert (watcher.ran, watcher.kept) == (["one"], ["one"])
    names = {path.name for path in (out / "one").iterdir()}
    assert names == {"one.csv", "manifest.json", "drawn.svg", "drawn.png"}
    for pictures in (True, False):
        run_studies([file], out, pictures=pictures, screen=watcher)
    assert (watcher.ran, watcher.kept) == (["one"], ["one"] * 3)


def test_progress_reaches_the_screen(tmp_path):
    body = "import time; context.progress(1, 3, 'thinking'); time.sleep(0.2)"
    watcher = Watcher()
    run_studies([write(tmp_path / "studies", "one", body)], tmp_path / "out", screen=watcher)
    assert watcher.steps == [("one", 1, 3, "thinking")]


@pytest.mark.parametrize("body", ["import os; os._exit(7)", "import os; os.kill(os.getpid(), 9)"])
def test_a_process_that_dies_is_a_failure_of_its_study(tmp_path, body):
    folder, out = tmp_path / "studies", tmp_path / "out"
    files = [write(folder, "dies", body), write(folder, "lives")]
    results = run_studies(files, out, keep_failure=True)
    assert [result.failed for result in results] == [True, False]
    assert re.search(r"ended with (status 7|signal 9)", results[0].manifest["error"]["message"])
    assert json.loads((out / "dies" / "manifest.json").read_text())["error"] is not None
    # What failed is tried again.
    assert ran(files, out) == ["dies"]


def test_a_folder_that_is_no_result_is_not_replaced(tmp_path):
    file = write(tmp_path / "studies", "one")
    (tmp_path / "out" / "one").mkdir(parents=True)
    (tmp_path / "out" / "one" / "thesis.tex").write_text("years of work")
    with pytest.raises(InputError, match="holds no results"):
        run_studies([file], tmp_path / "out")


@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGINT to send to one process")
def test_an_interrupted_run_leaves_no_scraps_and_goes_on(tmp_path):
    folder, out = tmp_path / "studies", tmp_path / "out"
    write(folder, "a_quick")
    mark = tmp_path / "mark"
    slow = f"import time, pathlib; pathlib.Path({str(mark)!r}).touch(); time.sleep(100)"
    write(folder, "b_slow", slow)
    interrupt(folder, ("a_quick", "b_slow"), out, when=mark.exists, jobs=1)
    assert [path.name for path in out.iterdir()] == ["a_quick"]
    write(folder, "b_slow")
    files = [file for file in discover(folder) if file.name != "_none"]
    assert ran(files, out) == ["b_slow"]


def test_a_new_study_runs_as_it_is(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    runner = CliRunner()
    done = runner.invoke(app, ["study", "new", "my_question"])
    assert done.exit_code == 0, done.output
    done = runner.invoke(app, ["study", "run", "my_question", "-o", "out"])
    assert done.exit_code == 0, done.output
    assert "below_one: fails" in done.stdout
    assert (tmp_path / "out" / "my_question" / "figure.svg").is_file()
    again = runner.invoke(app, ["study", "run", "my_question", "-o", "out"])
    assert "unchanged" in again.stdout
    for name, says in (("my_question", "is there already"), ("My study", "small letters")):
        refused = runner.invoke(app, ["study", "new", name])
        assert (refused.exit_code, says in refused.stderr) == (2, True)
    with pytest.raises(InputError, match="cannot name"):
        write_skeleton("1st", tmp_path)
