"""What is printed: tables, progress, and warnings as lines."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    import numpy as np
    from rich.console import Console
    from rich.progress import Progress, TaskID
    from rich.table import Table

    from albedo.grammar import Spec
    from albedo.studies import Result


@contextmanager
def warnings_as_lines() -> Iterator[None]:
    """Print a warning as one line on stderr, once, instead of with a line of source code."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield
    for text in dict.fromkeys(str(item.message) for item in caught):
        typer.echo(f"Warning: {text}", err=True)


@contextmanager
def compiling(*models: Spec) -> Iterator[None]:
    """Share what a first call has to compile between two processes."""
    from albedo._compile import second_compiler

    with second_compiler(*map(str, models)):
        yield


@contextmanager
def progress(what: str, total: int | None) -> Iterator[Callable[[int, int], None]]:
    """Show a transient progress bar on stderr, when it is a terminal and there is a wait."""
    with _bar(what, total, visible=total != 1) as update:
        yield lambda done, total: update(completed=done, total=total)


class StudyScreen:
    """Shows studies while they run, on stderr where it is a terminal, and says what each found."""

    def __init__(self, say: Callable[[Result, bool], None], bars: Progress | None) -> None:
        self._say, self._bars = say, bars
        self._tasks: dict[str, TaskID] = {}
        self._all = None if bars is None else bars.add_task("studies", total=None)

    def begun(self, name: str) -> None:
        if self._bars is not None:
            self._tasks[name] = self._bars.add_task(f"  {name}", total=None)

    def step(self, name: str, done: int, total: int, text: str) -> None:
        if self._bars is not None:
            words = f"  {name} {text}".rstrip()
            self._bars.update(
                self._tasks[name], completed=done, total=total or None, description=words
            )

    def left(self, finished: int, total: int, seconds: float) -> None:
        if self._bars is not None and self._all is not None:
            words = f"{finished} of {total} studies, {_about(seconds)} left"
            self._bars.update(self._all, completed=finished, total=total, description=words)

    def ended(self, result: Result, kept: bool) -> None:
        if self._bars is not None and result.name in self._tasks:
            self._bars.remove_task(self._tasks.pop(result.name))
        self._say(result, kept)


def _about(seconds: float) -> str:
    if seconds < 90.0:
        return f"about {max(5.0 * round(seconds / 5.0), 5.0):.0f} s"
    return f"about {seconds / 60.0:.0f} min"


@contextmanager
def study_screen(say: Callable[[Result, bool], None]) -> Iterator[StudyScreen]:
    """Yield what shows running studies; ``say(result, kept)`` prints what one found."""
    if not sys.stderr.isatty():
        yield StudyScreen(say, None)
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=20),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bars:
        yield StudyScreen(say, bars)


@contextmanager
def stages(what: str) -> Iterator[Callable[[str], None]]:
    """Show the stage that some work is in."""
    with _bar(what, None) as update:
        yield lambda words: update(description=f"{what}: {words}")


@contextmanager
def _bar(what: str, total: int | None, visible: bool = True) -> Iterator[Callable[..., None]]:
    """Yield what updates a bar, below which tables of albedos have bars of their own."""
    if not sys.stderr.isatty():
        yield lambda **changes: None
        return
    from rich.console import Console
    from rich.progress import Progress

    from albedo.progress import watched

    with Progress(console=Console(stderr=True), transient=True) as bar:

        @contextmanager
        def table(what: str) -> Iterator[Callable[[int, int], None]]:
            # More may turn out to be needed: there is no share to show.
            task = bar.add_task(what, total=None, visible=False)
            try:
                yield lambda done, known: bar.update(
                    task,
                    description=f"{what}: {done:,} albedos of at least {known:,}",
                    visible=True,
                )
            finally:
                bar.remove_task(task)

        with watched(table):
            yield partial(bar.update, bar.add_task(what, total=total, visible=visible))


def new_table(*heads: str, right: bool = False) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, header_style="bold")
    for head in heads:
        numeric = right and head not in ("model", "part", "converged")
        table.add_column(head, justify="right" if numeric else "left", overflow="fold")
    return table


def print_table(table: Table) -> None:
    console: Console
    from rich.console import Console
    from rich.measure import Measurement

    console = Console(markup=False, highlight=False, emoji=False)
    if not console.is_terminal:
        # What is piped is read by programs: nothing is folded to fit a screen.
        console.width = max(
            Measurement.get(console, console.options.update(width=100_000), table).maximum, 1
        )
    console.print(table)


def short(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def counted(count: int, what: str) -> str:
    """So many of something."""
    return f"{count} {what}{'' if count == 1 else 's'}"


def rows_of(
    label: str,
    channel: int | None,
    quantity: str,
    estimate: Any,
    cosines: np.ndarray | None,
    angles: np.ndarray | None,
    azimuth: float | None,
) -> list[dict[str, Any]]:
    """One row for every direction and, where a model has several parts, for each of them."""
    import numpy as np

    several = dict(estimate.parts) if len(estimate.parts) > 1 else {}
    rows = []
    for index in range(1 if cosines is None else len(cosines)):
        for part, item in (("total", estimate), *several.items()):
            row: dict[str, Any] = {"model": label, "quantity": quantity}
            if channel is not None:
                row["channel"] = channel
            if several:
                row["part"] = part
            if cosines is not None and angles is not None:
                row["theta"] = float(angles[index])
                row["cos_theta"] = float(cosines[index])
                row["phi"] = azimuth
            row["value"] = float(np.atleast_1d(item.value)[index])
            row["error"] = float(np.atleast_1d(item.error)[index])
            row["kind"] = item.kind
            row["evaluations"] = int(np.atleast_1d(item.evaluations)[index])
            row["converged"] = bool(np.atleast_1d(item.converged)[index])
            row["resolved_width"] = item.resolved_width
            for name in ("reliable", "effective_samples", "below_horizon"):
                if hasattr(item, name):
                    row[name] = np.atleast_1d(getattr(item, name))[index].item()
            rows.append(row)
    return rows


def print_rows(rows: list[dict[str, Any]]) -> None:
    from albedo.estimate import format_value

    # Columns that say the same in every row only take room.
    several_azimuths = len({row.get("phi") for row in rows} | {0.0}) > 1
    heads = ["model"]
    heads += ["channel"] if "channel" in rows[0] else []
    heads += ["part"] if "part" in rows[0] else []
    heads += ["theta"] if "theta" in rows[0] else []
    heads += ["cos_theta"] if "theta" in rows[0] else []
    heads += ["phi"] if "phi" in rows[0] and several_azimuths else []
    quantity, kind = rows[0]["quantity"], rows[0]["kind"].replace("_", " ")
    table = new_table(*heads, f"{quantity} ({kind})", "evaluations", "converged", right=True)
    last = None
    for row in rows:
        if last is not None and row["model"] != last:
            table.add_section()
        cells = [short(row[head]) for head in heads]
        if row["model"] == last:
            cells[0] = ""
        last = row["model"]
        table.add_row(
            *cells,
            format_value(row["value"], row["error"]),
            str(row["evaluations"]),
            "yes" if row["converged"] else "NO",
        )
    print_table(table)
    widths = {row["resolved_width"] for row in rows} - {None}
    if widths:
        typer.echo(f"The bounds hold for features wider than {max(widths):g} radians.")
