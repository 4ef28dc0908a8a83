"""``albedo advise`` and ``cost``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from albedo.cli.app import NOTHING_FITS, app
from albedo.cli.options import (
    complete_model,
    labelled,
)
from albedo.cli.screen import (
    new_table,
    print_table,
    progress,
    warnings_as_lines,
)
from albedo.errors import InputError


@app.command()
def advise(
    model: Annotated[
        str,
        typer.Argument(
            metavar="MODEL",
            help="A model as the scene has it; a sweep such as m=0.05..0.5/2 says between which "
            "numbers a parameter varies.",
            autocompletion=complete_model,
        ),
    ],
    theta: Annotated[
        str, typer.Option("--theta", metavar="LOW..HIGH", help="Angles to the normal, degrees.")
    ] = "0..85",
    light: Annotated[
        str, typer.Option(metavar="sky|point|area", help="A uniform sky, points, or round sources.")
    ] = "sky",
    radius: Annotated[float, typer.Option(help="Angular radius of round sources, degrees.")] = 5.0,
    of: Annotated[
        str, typer.Option(metavar="radiance|albedo", help="What may be wrong.")
    ] = "radiance",
    rtol: Annotated[float, typer.Option(help="By how much, relative to itself.")] = 0.0,
    atol: Annotated[float, typer.Option(help="By how much, absolutely.")] = 0.0,
    ns: Annotated[
        float, typer.Option(help="Nanoseconds that a number may cost.", show_default="no limit")
    ] = float("inf"),
    size: Annotated[
        float, typer.Option("--bytes", help="Bytes that may be read.", show_default="no limit")
    ] = float("inf"),
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="The answer with its table or polynomial (.json)."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON with every digit.")] = False,
) -> None:
    """Find the cheapest way to what a scene needs of a model: measured, not guessed.

    Tables, polynomials, sampled and nested integrals, float32 and models that leave something out
    are tried from the cheapest on; what is named was tested on places that it was not chosen by.
    Prices were measured on one machine: ratios of them hold roughly on others.

    \b
    Examples:
      albedo advise "ward:m=0.1..0.5/2" --theta 0..80 --rtol 0.01
      albedo advise "schwenk:smoothness=0.2..0.8/2" --light point --atol 0.01
      albedo advise cook_torrance:m=0.3,fresnel=gold --light area --radius 10 --atol 0.01
    """
    import json

    from albedo.advice.search import advise as search
    from albedo.files import check_output, save_json, strict
    from albedo.grammar import parse_numbers

    if output is not None:
        check_output(output, (".json",))
    ends = parse_numbers(theta if theta.count("..") != 1 else f"{theta}/2", "--theta")
    if len(ends) > 2:
        raise InputError(f"--theta {theta} is no range; write its two ends, as in 0..85.")
    options: dict[str, Any] = {"rtol": rtol, "atol": atol, "ns": ns, "bytes": size}
    with warnings_as_lines():
        found = search(
            model,
            theta=(float(ends[0]), float(ends[-1])),
            light=light,
            radius=radius,
            of=of,
            **options,
        )
    if output is not None:
        typer.echo(f"{save_json(found.record(data=True), output)}: the answer", err=as_json)
    typer.echo(json.dumps(strict(found.record()), indent=1) if as_json else str(found))
    if found.choice is None:
        raise typer.Exit(NOTHING_FITS)


@app.command()
def cost(
    models: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[MODEL]...",
            help="Models with their parameters, such as ward:m=0.1; all models unless given.",
            autocompletion=complete_model,
        ),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="All that was measured (.csv).")
    ] = None,
    update: Annotated[
        bool, typer.Option("--update", help="Put the tables that come with the package in place.")
    ] = False,
    repeats: Annotated[int, typer.Option(help="Rounds that medians are of, at least 7.")] = 9,
    seed: Annotated[int, typer.Option(help="Same seed, same directions.")] = 0,
) -> None:
    """Time the compiled kernels of models: what one evaluation costs, in float64 and in float32.

    Ratios are to lambert, in the same precision and the same round; behind each stand the quartiles
    of the rounds. Directions are even in the cosine over 0.1 to 1, or drawn by the model itself (in
    the lobe). The CSV has these and two more ways to a value. Times are those of this machine.

    \b
    Examples:
      albedo cost
      albedo cost ward:m=0.1 schlick "cook_torrance:fresnel=[white,dielectric]" -o costs.csv
    """
    from albedo.analysis import kernel_cost as room
    from albedo.files import check_output
    from albedo.grammar import parse

    if seed < 0:
        raise InputError(f"--seed {seed} is out of range; it must be at least 0.")
    if update and (models or output is not None):
        raise InputError("--update times all models into the package: give neither MODEL nor -o.")
    target = room.FILE if update else output
    if target is not None:
        check_output(target, (".csv",))
    if models:
        specs = [parse(text) for text in models]
        subjects = [room.subject(m, label) for spec in specs for label, m in labelled(spec)]
    else:
        subjects = room.catalogue()
    with warnings_as_lines(), progress("timing", None) as advance:
        frame = room.measure(subjects, repeats=repeats, seed=seed, progress=advance)
    _print_costs(frame)
    typer.echo(f"Processor: {room.processor()}. Times and ratios are those of this machine.")
    if not frame["compiled"].all():
        plain = frame.loc[~frame["compiled"], "model"].unique()
        typer.echo(f"In float64 only, by functions that are no kernels: {', '.join(plain)}.")
    if target is not None:
        typer.echo(f"{room.save(frame, target)}: {len(frame)} costs")
    if update:
        from albedo.advice import prices

        with progress("timing what advice needs", None) as advance:
            rows = prices.measure(advance)
        typer.echo(f"{prices.save(rows, prices.FILE)}: {len(rows)} prices")


def _print_costs(frame: Any) -> None:
    """Ratios first, then nanoseconds; a model is a row."""
    heads = [
        *("ratio", "quartiles", "ratio float32", "quartiles"),
        *("ns", "ns float32", "ns in the lobe", "ns in the lobe, float32"),
    ]
    table = new_table("model", *heads, right=True)
    known = {(row["model"], row["precision"], row["way"]): row for row in frame.to_dict("records")}
    for name in frame["model"].unique():
        cells = []
        for precision in ("float64", "float32"):
            row = known.get((name, precision, "pairs"))
            middle = "" if row is None else f"{row['ratio']:.2f}"
            ends = "" if row is None else f"{row['ratio_low']:.2f} to {row['ratio_high']:.2f}"
            cells += [middle, ends]
        for way in ("pairs", "lobe"):
            for precision in ("float64", "float32"):
                row = known.get((name, precision, way))
                cells.append("" if row is None else f"{row['ns']:.2f}")
        table.add_row(name, *cells)
    print_table(table)
