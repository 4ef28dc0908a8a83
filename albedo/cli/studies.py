"""``albedo study`` and ``report``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from albedo.cli.app import app, study_app
from albedo.cli.options import (
    FullOption,
    StudiesDirOption,
    complete_study,
)
from albedo.cli.screen import (
    compiling,
    new_table,
    print_table,
    study_progress,
)
from albedo.errors import InputError

if TYPE_CHECKING:
    from albedo.studies import Result


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


@study_app.command("run")
def run_studies(
    names: Annotated[
        list[str],
        typer.Argument(metavar="NAME", help="Studies to run.", autocompletion=complete_study),
    ],
    full: FullOption = False,
    studies_dir: StudiesDirOption = None,
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Folder for the folders of results.")
    ] = Path("reports/studies"),
) -> None:
    """Run studies; each puts a folder of tables, figures and a manifest in place when finished.

    A study that stops with an error leaves its former results alone; the others run, and the
    status is 1. A claim that fails is a finding, not an error.

    \b
    Examples:
      albedo study run nns_fig1
      albedo study run nns_fig1 --full -o results
    """
    from albedo.studies import discover, run_study

    known = {file.name: file for file in discover(studies_dir)}
    for name in names:
        if name not in known:
            raise InputError(f"There is no study '{name}'; there are {', '.join(known)}.")
    failed = False
    for name in dict.fromkeys(names):
        with compiling(), study_progress(name) as advance:
            result = run_study(known[name], output, full=full, progress=advance)
        _say_result(result)
        failed = failed or result.failed
    if failed:
        raise typer.Exit(1)


@app.command()
def report(
    full: FullOption = False,
    studies_dir: StudiesDirOption = None,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder of the site.")] = Path(
        "reports/build"
    ),
) -> None:
    """Run all studies and build a static site of what they found.

    A study that stops with an error has it shown on its page; the others run, and the status
    is 1.

    \b
    Examples:
      albedo report
      albedo report --full -o site
    """
    from albedo.report import build_report
    from albedo.studies import discover

    files = discover(studies_dir)
    with compiling(), study_progress("studies") as advance:
        results = build_report(files, output, full=full, progress=advance, finished=_say_result)
    typer.echo(f"The report is at {output / 'index.html'}")
    if any(result.failed for result in results):
        raise typer.Exit(1)


def _say_result(result: Result) -> None:
    manifest = result.manifest
    if manifest["error"] is not None:
        error = manifest["error"]
        typer.echo(f"{result.name}: failed, {error['kind']}: {error['message']}", err=True)
        typer.echo(f"  {error['where'].splitlines()[-1]}", err=True)
        return
    typer.echo(f"{result.name}: {result.folder} ({manifest['seconds']:.1f} s)")
    for claim in manifest["claims"]:
        typer.echo(f"  {claim['id']}: {claim['verdict']} ({claim['statement']})")
    for warning in manifest["warnings"]:
        typer.echo(f"  warning: {warning}", err=True)
