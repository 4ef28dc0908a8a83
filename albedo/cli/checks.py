"""``albedo check``."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from albedo.cli.app import app
from albedo.cli.options import (
    complete_model,
    labelled,
)
from albedo.cli.screen import (
    compiling,
    new_table,
    print_table,
    progress,
    warnings_as_lines,
)
from albedo.errors import InputError


@app.command()
def check(
    model: Annotated[
        str,
        typer.Argument(
            metavar="MODEL|FILE.py:FUNCTION",
            help="A model such as ward:m=0.1, or a function f(wi, wo) in a file.",
            autocompletion=complete_model,
        ),
    ],
    level: Annotated[
        float,
        typer.Option(help="Chance that the statistical checks fail for a correct BRDF."),
    ] = 1e-3,
    seed: Annotated[int, typer.Option(help="Same seed, same draws.")] = 0,
    lobe: Annotated[
        str | None,
        typer.Option(
            metavar="mirror|half|retro|diffuse", help="FUNCTION: where its mass lies, if known."
        ),
    ] = None,
    width: Annotated[
        float | None, typer.Option(help="FUNCTION: width of the lobe, radians.")
    ] = None,
    isotropic: Annotated[
        bool,
        typer.Option("--isotropic", help="FUNCTION: it depends on no azimuth but the difference."),
    ] = False,
    reciprocal: Annotated[
        bool, typer.Option("--reciprocal", help="FUNCTION: hold it to f(l, v) = f(v, l).")
    ] = False,
    conserves: Annotated[
        bool, typer.Option("--conserves-energy", help="FUNCTION: hold its albedo to 1.")
    ] = False,
    resolved_width: Annotated[
        float, typer.Option(help="FUNCTION: features down to this width, radians, are looked for.")
    ] = 0.03,
) -> None:
    """Check reciprocity, energy, sampling and tables of a model, or of a function in a file.

    The status is 1 when a check fails. A promise that a model does not make is measured, and held
    to nothing. Beside FUNCTION, a file may have FUNCTION_sample(u, wi) and FUNCTION_pdf(wi, wo):
    draws and density of a sampling routine, which are tested against one another.

    \b
    Examples:
      albedo check ward:m=0.1
      albedo check my_brdf.py:dusty --lobe diffuse --isotropic --reciprocal
    """
    from albedo.analysis import checks
    from albedo.grammar import parse

    if not 0.0 < level < 1.0:
        raise InputError(f"--level {level:g} is out of range; it lies in (0, 1).")
    if seed < 0:
        raise InputError(f"--seed {seed} is out of range; it must be at least 0.")
    if ".py:" in model:
        hints: dict[str, Any] = {"isotropic": isotropic, "resolved_width": resolved_width}
        hints |= {"lobe": lobe, "width": width, "reciprocal": reciprocal}
        hints |= {"conserves_energy": conserves}
        with warnings_as_lines():
            found = checks.check_function(model, level=level, seed=seed, **hints)
        failed = _print_checks({model: found})
    else:
        given = {"--lobe": lobe, "--width": width, "--isotropic": isotropic}
        given |= {"--reciprocal": reciprocal, "--conserves-energy": conserves}
        for option, value in given.items():
            if value:
                raise InputError(f"{option} is about a function in a file; a model knows itself.")
        spec = parse(model)
        results: dict[str, Any] = {}
        with warnings_as_lines(), compiling(spec), progress("checking", spec.count) as advance:
            for done, (label, built) in enumerate(labelled(spec), 1):
                for channel, kind in enumerate(built.by_channel()):
                    name = label if kind is built else f"{label}, channel {channel}"
                    results[name] = checks.check(kind, level, seed)
                advance(done, spec.count)
        failed = _print_checks(results)
    if failed:
        raise typer.Exit(1)


def _print_checks(results: dict[str, Any]) -> int:
    """Print one table for all; return how many checks failed."""
    words = {True: "passed", False: "FAILED", None: "measured"}
    for label, found in results.items():
        table = new_table("check", "verdict", "what was found")
        table.title, table.title_justify = label, "left"
        for one in found:
            table.add_row(one.name, words[one.passed], one.measured)
        print_table(table)
    every = [one for found in results.values() for one in found]
    failed = sum(one.passed is False for one in every)
    typer.echo(f"{failed} of {len(every)} checks failed" if failed else "No check failed")
    return failed
