"""``albedo study``, ``report`` and ``claims``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from albedo.cli.app import app, study_app
from albedo.cli.options import (
    AgainOption,
    FullOption,
    JobsOption,
    StudiesDirOption,
    complete_study,
)
from albedo.cli.screen import new_table, print_table, study_screen
from albedo.errors import InputError

if TYPE_CHECKING:
    from albedo.ledger import Row
    from albedo.recheck import Comparison
    from albedo.studies import Result

BUILD = Path("reports/build")


@study_app.command("list")
def list_studies(studies_dir: StudiesDirOption = None) -> None:
    """List the studies of a folder; the status is 1 if one of them cannot be read.

    \b
    Examples:
      albedo study list
      albedo study list --studies-dir my_studies
    """
    from albedo.studies import discover

    table = new_table("study", "title", "reproduces", "claims")
    broken = False
    for file in discover(studies_dir):
        loaded, error = file.try_load()
        if loaded is None:
            broken = True
            table.add_row(file.name, f"cannot be read: {error}", "", "")
            continue
        study = loaded.study
        source = ", ".join(text for text in (study.figure, study.paper) if text)
        table.add_row(study.name, study.title, source, ", ".join(study.claims))
    print_table(table)
    if broken:
        raise typer.Exit(1)


@study_app.command("new")
def new_study(
    name: Annotated[str, typer.Argument(metavar="NAME", help="What the study is called.")],
    studies_dir: StudiesDirOption = None,
) -> None:
    """Write a study that runs, with comments that say what to change.

    \b
    Examples:
      albedo study new my_question
      albedo study new my_question --studies-dir my_studies
    """
    from albedo.studies import write_skeleton

    path = write_skeleton(name, studies_dir)
    typer.echo(f"{path} is there; 'albedo study run {name}' runs it.")


@study_app.command("run")
def run_some(
    names: Annotated[
        list[str],
        typer.Argument(metavar="NAME", help="Studies to run.", autocompletion=complete_study),
    ],
    full: FullOption = False,
    jobs: JobsOption = None,
    again: AgainOption = False,
    studies_dir: StudiesDirOption = None,
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Folder for the folders of results.")
    ] = BUILD / "studies",
) -> None:
    """Run studies; each puts a folder of tables, figures and a manifest in place when finished.

    A study is not run again where neither its file, nor any module or data that it read, nor its
    results changed. One that stops with an error leaves its former results alone; the others
    run, and the status is 1. A claim that fails is a finding, not an error.

    \b
    Examples:
      albedo study run nns_fig1
      albedo study run nns_fig1 nns_fig2 --full -o results
    """
    from albedo.runner import run_studies
    from albedo.studies import discover

    known = {file.name: file for file in discover(studies_dir)}
    for name in names:
        if name not in known:
            raise InputError(f"There is no study '{name}'; there are {', '.join(known)}.")
    files = [known[name] for name in dict.fromkeys(names)]
    with study_screen(_say_result) as screen:
        results = run_studies(files, output, full=full, jobs=jobs, again=again, screen=screen)
    if any(result.failed for result in results):
        raise typer.Exit(1)


@app.command()
def report(
    full: FullOption = False,
    jobs: JobsOption = None,
    again: AgainOption = False,
    check: Annotated[
        bool,
        typer.Option("--check", help="Compare with the data of a former run, by value."),
    ] = False,
    against: Annotated[
        Path | None,
        typer.Option(
            "--against",
            help="What to compare with.",
            show_default="reports with --full, reports/quick without",
        ),
    ] = None,
    times: Annotated[
        bool,
        typer.Option(
            "--times/--no-times",
            help="Whether --check compares rankings of times, which other work disturbs.",
        ),
    ] = True,
    pages: Annotated[
        bool,
        typer.Option("--pages/--data", help="The whole site, or only tables and records."),
    ] = True,
    studies_dir: StudiesDirOption = None,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder of the site.")] = BUILD,
) -> None:
    """Run all studies and build a static site of what they found, with a ledger of all claims.

    Studies of which nothing changed are not run again. One that stops with an error has it shown
    on its page; the others run, and the status is 1. With --check the status is 1 as well where
    a value differs from what was kept by more than the bounds of both.

    \b
    Examples:
      albedo report
      albedo report --full -o site
      albedo report --check
    """
    from albedo.report import build_report
    from albedo.studies import discover

    files = discover(studies_dir)
    kept = against or Path("reports" if full else "reports/quick")
    if check and output.resolve() == kept.resolve():
        raise InputError(
            f"'{output}' is both what is written and what it is compared with; name another "
            "folder with -o or --against."
        )
    if check and not (kept / "studies").is_dir():
        raise InputError(
            f"'{kept}' holds no studies to compare with; name a folder with --against."
        )
    with study_screen(_say_result) as screen:
        results = build_report(
            files, output, full=full, jobs=jobs, again=again, pages=pages, screen=screen
        )
    typer.echo(f"The report is at {output / 'index.html' if pages else output}")
    failed = any(result.failed for result in results)
    if check:
        from albedo.recheck import compare_runs

        failed = _say_comparison(compare_runs(kept, output, times=times), kept) or failed
    if failed:
        raise typer.Exit(1)


@app.command()
def claims(
    id: Annotated[
        str | None,
        typer.Argument(metavar="ID", help="A claim, such as N3.", show_default="all of them"),
    ] = None,
    reports: Annotated[
        Path, typer.Option("--reports", help="The report whose ledger is read.")
    ] = Path("reports"),
    json: Annotated[bool, typer.Option("--json", help="As JSON, with every digit.")] = False,
) -> None:
    """Print what the papers claim and what was measured.

    \b
    Examples:
      albedo claims
      albedo claims N3
      albedo claims --reports reports/build
    """
    from albedo.ledger import load_ledger

    rows = load_ledger(reports)
    if id is not None:
        rows = [row for row in rows if row.id.lower() == id.lower()] or _no_claim(id, rows)
    if json:
        from dataclasses import asdict
        from json import dumps

        typer.echo(dumps([asdict(row) for row in rows], indent=2, ensure_ascii=False))
    elif id is None:
        table = new_table("claim", "verdict", "the paper says")
        for row in rows:
            # Readings have long names, which a line for each claim has no room for.
            brief = row.why and row.kind != "depends on the reading"
            table.add_row(row.id, f"{row.verdict} ({row.why})" if brief else row.kind, row.says)
        print_table(table)
        typer.echo("\n'albedo claims ID' says what was measured, in which readings, and why.")
    else:
        _say_claim(rows[0])


def _no_claim(id: str, rows: list[Row]) -> list[Row]:
    known = ", ".join(row.id for row in rows)
    raise InputError(f"There is no claim '{id}'; there are {known}.")


def _say_claim(row: Row) -> None:
    from albedo.estimate import format_value

    where = ", ".join(text for text in (row.paper, row.where) if text)
    typer.echo(f"{row.id}{f' ({where})' if where else ''}: {row.says}")
    typer.echo(f"  {row.verdict}{f' ({row.why})' if row.why else ''}\n")
    for part in row.parts:
        value = format_value(float(part["value"]), float(part["error"]))
        reading = f" [{part['reading']}]" if part["reading"] else ""
        quantity = f", {part['quantity']}" if part["quantity"] else ""
        typer.echo(f"  {part['verdict']}{reading}: {part['statement']}")
        typer.echo(f"      measured {value} ({part['criterion']}){quantity}; study {part['study']}")
    for text in row.explanations:
        typer.echo(f"\n  {text}")


def _say_result(result: Result, kept: bool) -> None:
    manifest = result.manifest
    if manifest["error"] is not None:
        error = manifest["error"]
        typer.echo(f"{result.name}: failed, {error['kind']}: {error['message']}", err=True)
        typer.echo(f"  {error['where'].splitlines()[-1]}", err=True)
        return
    how = "unchanged" if kept else f"{manifest['seconds']:.1f} s"
    typer.echo(f"{result.name}: {result.folder} ({how})")
    if kept:
        return
    for claim in manifest["claims"]:
        typer.echo(f"  {claim['id']}: {claim['verdict']} ({claim['statement']})")
    for warning in manifest["warnings"]:
        typer.echo(f"  warning: {warning}", err=True)


def _say_comparison(found: Comparison, kept: Path) -> bool:
    """Say what a check found; whether anything differs."""
    many = (
        f"{found.values:,} values in {found.columns} columns and {found.claims} claims of "
        f"{found.studies} studies"
    )
    same = f"{found.same_bytes} of {found.files} tables have the same bytes"
    if not found.differences:
        typer.echo(f"All agree with {kept}: {many}; {same}.")
        return False
    shown = found.differences[:20]
    table = new_table("what differs", "kept", "new", "allowed")
    for item in shown:
        table.add_row(item.place, item.kept, item.new, item.allowed)
    print_table(table)
    more = len(found.differences) - len(shown)
    if more:
        typer.echo(f"... and {more} more.")
    typer.echo(f"{len(found.differences)} of {many} differ from {kept}; {same}.")
    return True
