"""Ctrl-C at the worst moment: real processes, real signals, and what is left on the disk."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

import albedo

pytestmark = pytest.mark.skipif(
    os.name == "nt", reason="Windows has no SIGINT to send to one process"
)

# Imports on two busy cores; no test waits as long as that unless something hangs.
PATIENCE = 120.0
# Threads finish the batch that they are at, which takes a second, and nothing else.
SOON = 20.0
# A shell says 130 for both: where Python was carrying out text, as when it makes a dataclass, it
# ends itself by the signal in the end, whatever the program did about it.
INTERRUPTED = (130, -signal.SIGINT)

ENVIRONMENT = {**os.environ, "PYTHONPATH": str(Path(albedo.__file__).parents[1])}

# The command line as it is, but it says on stdout when each batch of values begins.
TAPPED = """
import os, sys, albedo.tables as tables
from albedo.cli import main
rows = tables.albedo_rows
def tapped(*arguments, **options):
    os.write(1, b"batch\\n")  # in one piece, whichever threads do
    return rows(*arguments, **options)
tables.albedo_rows = tapped
sys.argv[0] = "albedo"
main()
"""

# Hours of work, in batches of less than a second.
BIG = ("table", "ward:m=0.02..1/400", "--cos", "1e-6..1/2000log", "--rtol", "1e-10")


def start(folder: Path, *arguments: str, code: str = TAPPED) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", code, *arguments],
        cwd=folder,
        env=ENVIRONMENT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def interrupted(process: subprocess.Popen[str]) -> str:
    """Interrupt a process; it ends soon, with status 130 and one sentence, which is returned."""
    sent = time.monotonic()
    process.send_signal(signal.SIGINT)
    try:
        _, errors = process.communicate(timeout=PATIENCE)
    finally:
        process.kill()
    assert time.monotonic() - sent < SOON
    assert process.returncode in INTERRUPTED, errors
    assert "Traceback" not in errors
    return errors


def wait_for(process: subprocess.Popen[str], line: str, times: int = 1) -> None:
    assert process.stdout is not None
    for _ in range(times):
        found = process.stdout.readline()
        if found != line + "\n":
            process.kill()
            pytest.fail(f"the process said {found!r} and {process.communicate()[1]!r}")


@pytest.mark.parametrize("threads", ["1", "2"])
@pytest.mark.parametrize("batches", [1, 5])
@pytest.mark.parametrize("name", ["big.nc", "big.csv"])
def test_an_interrupted_table_leaves_nothing(
    name: str, batches: int, threads: str, tmp_path: Path
) -> None:
    process = start(tmp_path, *BIG, "-o", name, "--threads", threads)
    wait_for(process, "batch", batches)
    assert interrupted(process) == "Interrupted; files that were not finished were not kept.\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("threads", ["1", "2"])
def test_an_interrupted_table_leaves_the_former_file_untouched(
    threads: str, tmp_path: Path
) -> None:
    former = tmp_path / "big.nc"
    former.write_bytes(b"what an earlier run made")
    before = former.stat()
    process = start(tmp_path, *BIG, "-o", "big.nc", "--threads", threads)
    wait_for(process, "batch", 2)
    interrupted(process)
    assert list(tmp_path.iterdir()) == [former]
    assert former.read_bytes() == b"what an earlier run made"
    after = former.stat()
    assert (after.st_mtime_ns, after.st_ino) == (before.st_mtime_ns, before.st_ino)


# Writing takes long: the temporary file lies in the folder when the signal comes.
SLOW_WRITING = """
import pathlib, sys, time, xarray
from albedo.cli import main
to_netcdf = xarray.Dataset.to_netcdf
def slow(self, path, *arguments, **options):
    to_netcdf(self, path, *arguments, **options)
    assert pathlib.Path(path).stat().st_size > 0
    print("written", flush=True)
    # A signal that comes just before a sleep begins is noticed when it ends.
    for _ in range(600):
        time.sleep(0.1)
xarray.Dataset.to_netcdf = slow
sys.argv[0] = "albedo"
main()
"""


def test_a_table_interrupted_while_it_is_written_leaves_the_former_file(tmp_path: Path) -> None:
    (tmp_path / "small.nc").write_text("former")
    arguments = ("table", "lambert", "--cos", "1,0.5", "-o", "small.nc")
    process = start(tmp_path, *arguments, code=SLOW_WRITING)
    wait_for(process, "written")
    # While it is being written it has another name.
    assert len(list(tmp_path.iterdir())) == 2
    interrupted(process)
    assert [path.name for path in tmp_path.iterdir()] == ["small.nc"]
    assert (tmp_path / "small.nc").read_text() == "former"


def interrupted_on_a_terminal(
    folder: Path, command: list[str], ready: Callable[[bytes], bool]
) -> bytes:
    """Run Python on a terminal, interrupt it when it has said enough; return all that it said."""
    pty = pytest.importorskip("pty")
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, *command],
        cwd=folder,
        env={**ENVIRONMENT, "TERM": "xterm", "COLUMNS": "100"},
        stdout=theirs,
        stderr=theirs,
    )
    os.close(theirs)
    said = b""
    try:
        while not ready(said):
            said += os.read(ours, 4096)
        process.send_signal(signal.SIGINT)
        sent = time.monotonic()
        while True:
            try:
                more = os.read(ours, 4096)
            except OSError:  # the other end is closed
                break
            if not more:
                break
            said += more
        assert process.wait(PATIENCE) in INTERRUPTED, said
        assert time.monotonic() - sent < SOON
    finally:
        process.kill()
        process.wait()
        os.close(ours)
    return said


def test_an_interrupted_progress_bar_leaves_the_terminal_alone(tmp_path: Path) -> None:
    """On a terminal a second thread draws the bar: it ends too, and the cursor comes back."""
    command = ["-m", "albedo.cli", *BIG, "-o", "big.nc"]
    said = interrupted_on_a_terminal(tmp_path, command, lambda said: b"computing the table" in said)
    assert b"Interrupted" in said
    assert b"Traceback" not in said
    show, hide = b"\x1b[?25h", b"\x1b[?25l"
    assert said.rfind(show) > said.rfind(hide) >= 0
    assert list(tmp_path.iterdir()) == []


STUDY = '''"""Does a study that is interrupted leave traces?"""

import os
import time

from albedo.studies import Study

STUDY = Study(name="NAME", title="A study", claims=())


def run(context):
    context.note("text of NAME")
    if "NAME" == "second" and os.environ.get("WAIT"):
        print("second", flush=True)
        for _ in range(600):
            time.sleep(0.1)
'''

MAIN = "from albedo.cli import main; main()"


def test_an_interrupted_report_is_completed_by_the_next_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "studies").mkdir()
    for name in ("first", "second", "third"):
        (tmp_path / "studies" / f"{name}.py").write_text(STUDY.replace("NAME", name))
    monkeypatch.setitem(ENVIRONMENT, "WAIT", "yes")
    process = start(tmp_path, "report", "-o", "site", "--jobs", "1", code=MAIN)
    assert process.stdout is not None
    while (line := process.stdout.readline()) != "second\n":
        assert line, "the second study never began"
    interrupted(process)
    # What was finished is complete, and nothing else is there.
    studies = tmp_path / "site" / "studies"
    assert [path.name for path in (tmp_path / "site").iterdir()] == ["studies"]
    assert [path.name for path in studies.iterdir()] == ["first"]
    assert "text of first" in (studies / "first" / "index.html").read_text()

    monkeypatch.delitem(ENVIRONMENT, "WAIT")
    again = start(tmp_path, "report", "-o", "site", code=MAIN)
    output, errors = again.communicate(timeout=PATIENCE)
    assert again.returncode == 0, errors
    assert "The report is at" in output
    # What was finished is not run again.
    assert re.findall(r"^(\w+): .*\(unchanged\)$", output, re.MULTILINE) == ["first"]
    names = sorted(path.name for path in studies.iterdir())
    assert names == ["first", "second", "third"]
    for name in names:
        assert f"text of {name}" in (studies / name / "index.html").read_text()
    assert (tmp_path / "site" / "index.html").is_file()

    # Interrupted once more, the complete site stays as it is.
    kept = {p: p.read_bytes() for p in (tmp_path / "site").rglob("*") if p.is_file()}
    monkeypatch.setitem(ENVIRONMENT, "WAIT", "yes")
    where = ("--again", "-o", "site/studies")
    process = start(tmp_path, "study", "run", "second", *where, code=MAIN)
    wait_for(process, "second")
    interrupted(process)
    assert {p: p.read_bytes() for p in (tmp_path / "site").rglob("*") if p.is_file()} == kept


# What is kept lies in the folder of the run, and so does a list of all albedos of tables that it
# began to compute.
KEPT = """
import pathlib, sys
from albedo.cli import main
from albedo.operators import kept, mapping
kept._WORTH, kept._folder = 0.0, lambda: pathlib.Path("tables")
rows = mapping.albedo_rows
def tapped(models, c, phi, **options):
    with open("begun", "a") as file:
        # Those that look for symmetry have no limit.
        if "max_evaluations" in options:
            file.write("".join(f"{place}\\n" for place in zip(c.tolist(), phi.tolist())))
    return rows(models, c, phi, **options)
mapping.albedo_rows = tapped
sys.argv[0] = "albedo"
main()
"""
PUMP = ("pump", "ward:alpha_x=0.4,alpha_y=0.2", "--theta", "30,60", "--phi", "20")


def test_an_interrupted_table_of_a_step_is_shown_and_taken_up(tmp_path: Path) -> None:
    said = interrupted_on_a_terminal(
        tmp_path,
        ["-c", KEPT, *PUMP],
        lambda said: b"albedos of at least" in said and any(tmp_path.glob("tables/*.rows")),
    )
    assert b"table 1: " in said
    assert b"Interrupted; files that were not finished were not kept." in said
    assert b"Traceback" not in said
    assert {path.suffix for path in (tmp_path / "tables").iterdir()} == {".rows"}
    before = set((tmp_path / "begun").read_text().splitlines())
    assert before
    (tmp_path / "begun").unlink()
    again = start(tmp_path, *PUMP, code=KEPT)
    said_again, errors = again.communicate(timeout=PATIENCE)
    assert (again.returncode, errors) == (0, "")
    # Threads finished what they had begun, and none of it was lost.
    assert before.isdisjoint((tmp_path / "begun").read_text().splitlines())
    # The table is there as a whole, and the next run computes nothing of it.
    assert [path.suffix for path in (tmp_path / "tables").iterdir()] == [".table"]
    (tmp_path / "begun").unlink()
    last = start(tmp_path, *PUMP, code=KEPT)
    assert last.communicate(timeout=PATIENCE) == (said_again, "")
    assert not (tmp_path / "begun").exists()
