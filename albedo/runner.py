"""Runs studies, several at a time, each in a process of its own, and none that is unchanged.

A process of its own means that what a study read is known exactly: it is run again when one of
these files changed, and only then. One that is about to take times waits until the others are
finished or wait as well, and while it takes them none runs.
"""

from __future__ import annotations

import json
import math
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import dataclass
from enum import Enum
from functools import partial
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, Protocol

from albedo._threads import threads
from albedo.errors import InputError
from albedo.sources import watch
from albedo.studies import Result, StudyFile, check_place, lost_study, run_study

__all__ = ["Screen", "run_studies"]

# What no former run tells: a quick and a full study take about so many seconds.
_USUAL = {False: 4.0, True: 60.0}
# A process that was asked to stop leaves no scraps behind; one that does not is made to.
_PATIENCE = 20.0
_INTERRUPTED = 130
# One for every chart that most studies integrate in.
_COMPILED_AHEAD = ("lambert", "phong")
_BLAS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")


class Screen(Protocol):
    """What shows how far the studies are."""

    def begun(self, name: str) -> None:
        """A study was started."""

    def step(self, name: str, done: int, total: int, text: str) -> None:
        """A study is so far."""

    def left(self, finished: int, total: int, seconds: float) -> None:
        """So many studies are finished; the others take about so long."""

    def ended(self, result: Result, kept: bool) -> None:
        """A study is finished, or need not be run again."""


class _State(Enum):
    """What a study does."""

    RUNS = "runs"
    WAITS = "waits to be alone"
    ALONE = "takes times"


@dataclass
class _Task:
    """A study in a process."""

    file: StudyFile
    process: BaseProcess
    pipe: Connection
    began: float
    state: _State = _State.RUNS
    waits_since: float = 0.0
    result: Result | None = None

    def left(self, cost: float) -> float:
        """How many seconds it takes from now, if that is what it takes in all."""
        until = self.waits_since if self.state is _State.WAITS else time.monotonic()
        return max(cost - (until - self.began), 0.0)

    def wait(self) -> None:
        """It asked to be alone."""
        self.state, self.waits_since = _State.WAITS, time.monotonic()

    def go(self) -> None:
        """It is alone; the time that it waited does not count."""
        self.began += time.monotonic() - self.waits_since
        self.state = _State.ALONE
        with suppress(BrokenPipeError):
            self.pipe.send("go")


def run_studies(
    files: Sequence[StudyFile],
    out: Path,
    *,
    full: bool = False,
    jobs: int | None = None,
    again: bool = False,
    pictures: bool = True,
    keep_failure: bool = False,
    screen: Screen | None = None,
    finish: Callable[[Result], None] | None = None,
) -> list[Result]:
    """Run studies; those of which nothing changed since they were run are kept as they are.

    A study that fails does not stop the others. What is finished when the run is interrupted
    stays, and is not run again by the next call.

    Parameters
    ----------
    files : sequence of StudyFile
        The studies.
    out : Path
        Folder in which each has a folder of results.
    full : bool
        Full fidelity instead of quick.
    jobs : int, optional
        How many run at a time; as many as there are cores unless given.
    again : bool
        Run all of them, whether anything changed or not.
    pictures : bool
        Whether figures are drawn.
    keep_failure : bool
        Put the record of a failure in the place of former results; otherwise these stay.
    screen : Screen, optional
        What shows how far they are.
    finish : callable, optional
        Called with the result of each study as soon as it is there, to add what is made from it.

    Returns
    -------
    list of Result
        One for every study, failures included, in the order of the files.

    Raises
    ------
    InputError
        If the place of some results is taken by something else.
    """
    cores = threads()
    jobs = cores if jobs is None else jobs
    if jobs < 1:
        raise InputError(f"jobs is {jobs}; at least one study has to run at a time.")
    results: dict[str, Result] = {}
    costs: dict[str, float] = {}
    for file in files:
        target = out / file.name
        check_place(target)
        manifest = None if again else file.unchanged(target, full, pictures)
        if manifest is not None:
            results[file.name] = Result(file.name, target, manifest)
            if finish is not None:
                finish(results[file.name])
            if screen is not None:
                screen.ended(results[file.name], True)
        else:
            costs[file.name] = _former_seconds(target, full)
    known = [seconds for seconds in costs.values() if math.isfinite(seconds)]
    usual = sum(known) / len(known) if known else _USUAL[full]
    costs = {name: s if math.isfinite(s) else usual for name, s in costs.items()}
    # The longest first, so that none is left over at the end.
    todo = sorted(
        (file for file in files if file.name in costs),
        key=lambda file: (-costs[file.name], file.name),
    )
    running: list[_Task] = []
    helper: subprocess.Popen[bytes] | None = None
    work = {"out": out, "full": full, "pictures": pictures, "keep_failure": keep_failure}
    lost = partial(_lost, out=out, full=full, keep=keep_failure)
    first = todo[0] if jobs > 1 and len(todo) > 1 else None
    stack = ExitStack()
    try:
        while todo or running:
            if not _compiles(helper):
                _let_one_be_alone(running)
            while todo and _may_begin(running, jobs - _compiles(helper)):
                file = todo.pop(0)
                shared = min(jobs, len(todo) + len(running) + 1)
                running.append(_begin(file, work, max(1, cores // shared)))
                if screen is not None:
                    screen.begun(file.name)
                if file is first:
                    helper = stack.enter_context(_second_compiler())
            for task in _listen(running, screen, lost):
                running.remove(task)
                assert task.result is not None
                results[task.file.name] = task.result
                if finish is not None:
                    finish(task.result)
                if screen is not None:
                    screen.ended(task.result, False)
            if screen is not None:
                last = [task for task in running if task.state is not _State.RUNS]
                alone = sum(task.left(costs[task.file.name]) for task in last)
                left = [costs[file.name] for file in todo]
                left += [t.left(costs[t.file.name]) for t in running if t not in last]
                seconds = alone + sum(left) / min(jobs, max(len(left), 1))
                screen.left(len(results), len(files), seconds)
    finally:
        stack.close()
        _stop(running)
    return [results[file.name] for file in files]


def _former_seconds(target: Path, full: bool) -> float:
    """How long a study took the last time, whatever has changed since; infinite if unknown."""
    try:
        manifest = json.loads((target / "manifest.json").read_text(encoding="utf-8"))
        if manifest["fidelity"] == ("full" if full else "quick"):
            return float(manifest["seconds"])
    except (OSError, ValueError, KeyError, TypeError):
        pass
    return math.inf


def _second_compiler() -> AbstractContextManager[subprocess.Popen[bytes] | None]:
    """On an empty cache, what integrates is compiled once, not by every study that begins."""
    from albedo._compile import second_compiler

    return second_compiler(*_COMPILED_AHEAD)


def _compiles(helper: subprocess.Popen[bytes] | None) -> bool:
    return helper is not None and helper.poll() is None


def _let_one_be_alone(running: list[_Task]) -> None:
    """Where all wait, the one that has waited the longest goes on."""
    if running and all(task.state is _State.WAITS for task in running):
        min(running, key=lambda task: task.waits_since).go()


def _may_begin(running: list[_Task], jobs: int) -> bool:
    states = [task.state for task in running]
    return _State.ALONE not in states and states.count(_State.RUNS) < jobs


def _begin(file: StudyFile, work: Mapping[str, Any], share: int) -> _Task:
    # Forking a process that has no threads and knows the heavy libraries saves their import.
    forks = "forkserver" in multiprocessing.get_all_start_methods()
    multiprocessing.set_forkserver_preload(["albedo._ready"])
    ours, theirs = multiprocessing.Pipe()
    # What forks was started once, with the environment of that time.
    own = {key: value for key, value in os.environ.items() if key.startswith("ALBEDO_")}
    own.setdefault("ALBEDO_THREADS", str(share))
    call: dict[str, Any] = {"target": _work, "args": (file, own, theirs), "kwargs": work}
    if forks:
        process: BaseProcess = multiprocessing.get_context("forkserver").Process(**call)
    else:
        process = multiprocessing.get_context("spawn").Process(**call)
    with _one_blas_thread():
        process.start()
    theirs.close()
    return _Task(file, process, ours, time.monotonic())


@contextmanager
def _one_blas_thread() -> Iterator[None]:
    """Threads of a linear algebra library would wait for each other while other studies run.

    What is started inside has one of them, unless the environment says otherwise.
    """
    added = [name for name in _BLAS if name not in os.environ]
    os.environ.update(dict.fromkeys(added, "1"))
    try:
        yield
    finally:
        for name in added:
            del os.environ[name]


def _work(
    file: StudyFile, environment: dict[str, str], pipe: Connection, *, out: Path, **options: bool
) -> None:
    """Run a study in this process, and tell the other how it goes."""
    watch()
    for key in [key for key in os.environ if key.startswith("ALBEDO_")]:
        del os.environ[key]
    os.environ.update(environment)
    said = 0.0

    @contextmanager
    def heard() -> Iterator[None]:
        """Where nobody is there any more this is no failure of the study: it is interrupted."""
        try:
            yield
        except (BrokenPipeError, EOFError):
            raise KeyboardInterrupt from None

    def progress(done: int, total: int, text: str) -> None:
        nonlocal said
        # Nobody reads more than a few of them in a second.
        if time.monotonic() - said > 0.1:
            said = time.monotonic()
            with heard():
                pipe.send(("step", (done, total, text)))

    @contextmanager
    def alone() -> Iterator[None]:
        with heard():
            pipe.send(("alone", None))
            # Nothing but the leave to go on comes this way.
            pipe.recv()
        try:
            yield
        finally:
            with heard():
                pipe.send(("together", None))

    try:
        answer: tuple[str, Any]
        try:
            answer = "result", run_study(file, out, progress=progress, alone=alone, **options)
        except InputError as error:
            answer = "refused", str(error)
        pipe.send(answer)
    except (KeyboardInterrupt, BrokenPipeError):
        # The one who asked for this stopped, and says so.
        sys.exit(_INTERRUPTED)


def _listen(
    running: list[_Task], screen: Screen | None, lost: Callable[[_Task], Result]
) -> list[_Task]:
    """Wait until something is heard; return the tasks that ended."""
    ended = []
    heard = wait([task.pipe for task in running], timeout=0.5)
    for task in running:
        if task.pipe not in heard:
            continue
        try:
            word, said = task.pipe.recv()
        except (EOFError, OSError):
            task.process.join()
            if task.process.exitcode == _INTERRUPTED:
                raise KeyboardInterrupt from None
            task.result = lost(task)
        else:
            if word == "refused":
                raise InputError(said)
            if word == "step":
                if screen is not None:
                    screen.step(task.file.name, *said)
                continue
            if word == "alone":
                task.wait()
                continue
            if word == "together":
                task.state = _State.RUNS
                continue
            task.result = said
        task.process.join()
        task.pipe.close()
        ended.append(task)
    return ended


def _lost(task: _Task, out: Path, full: bool, keep: bool) -> Result:
    """The result of a study whose process ended without one."""
    code = task.process.exitcode or 0
    how = f"signal {-code}" if code < 0 else f"status {code}"
    message = f"The process of the study ended with {how}."
    seconds = time.monotonic() - task.began
    return lost_study(task.file, out, message, seconds, full=full, keep_failure=keep)


def _stop(running: list[_Task]) -> None:
    """Interrupt what still runs, and wait until its scraps are gone."""
    for task in running:
        with suppress(ProcessLookupError):
            if task.process.pid is not None and task.process.is_alive():
                # Windows knows no interruption of one process.
                if os.name == "nt":
                    task.process.terminate()
                else:
                    os.kill(task.process.pid, signal.SIGINT)
    end = time.monotonic() + _PATIENCE
    for task in running:
        task.process.join(max(end - time.monotonic(), 0.1))
        if task.process.is_alive():
            task.process.kill()
            task.process.join()
        task.pipe.close()
