"""``albedo stability``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from albedo.cli.app import app
from albedo.cli.options import (
    OutputOption,
    complete_model,
)
from albedo.cli.screen import (
    progress,
    short,
    warnings_as_lines,
)
from albedo.errors import InputError


@app.command()
def stability(
    model: Annotated[
        str,
        typer.Argument(
            metavar="MODEL|FILE.py:FUNCTION",
            help="A model such as ward, or a function f(wi, wo) in a file.",
            autocompletion=complete_model,
        ),
    ],
    output: OutputOption = None,
    plot: Annotated[
        Path | None,
        typer.Option("--plot", help="Picture of digits over a swept number (.png, .svg, .pdf)."),
    ] = None,
    width: Annotated[
        float | None,
        typer.Option(help="FUNCTION: width of its lobe, radians, for places beside the mirror."),
    ] = None,
    search: Annotated[
        bool, typer.Option("--search", help="Look for the worst case instead of counting on a map.")
    ] = False,
    examples: Annotated[
        int | None,
        typer.Option(help="--search: cases that are tried, with up to five values each; 500."),
    ] = None,
    seed: Annotated[int, typer.Option(help="--search: same seed, same cases.")] = 0,
) -> None:
    """Count the right digits of a BRDF at its extremes, in float64 and in float32.

    Values are compared with the same formula in 50 digits, at special directions and from normal
    incidence to cos θ = 1e-12. Without a sweep, the domain of the model's main parameters is swept;
    of a sweep the ends and a few values between are taken.

    With --search all parameters that are not fixed are drawn from the whole of their ranges, and
    directions from everywhere down to cos θ = 1e-12, climbing towards where more digits are lost.

    \b
    Examples:
      albedo stability ward
      albedo stability ward --search --examples 2000
      albedo stability "phong:n=0.001..1e9/61log" -o phong.csv --plot phong.png
      albedo stability my_brdf.py:dusty
    """
    from albedo.analysis import stability as room
    from albedo.analysis.checks import model_in_file
    from albedo.files import check_output, save_csv
    from albedo.plotting import SUFFIXES, save_figure

    if output is not None:
        check_output(output, (".csv",))
    if plot is not None:
        check_output(plot, SUFFIXES)
    if search:
        if plot is not None:
            raise InputError("--plot is of a map; a search has none.")
        _search(model, output, width, examples, seed)
        return
    if examples is not None:
        raise InputError("--examples is about --search.")
    if ".py:" in model:
        if plot is not None:
            raise InputError("--plot is over a parameter of a model; a function has none.")
        hints: dict[str, Any] = {} if width is None else {"lobe": "half", "width": width}
        named: list[tuple[dict[str, Any], Any]] = [({}, model_in_file(model, **hints))]
        title, numbers = model, []
    else:
        if width is not None:
            raise InputError("--width is about a function in a file; a model knows itself.")
        spec = room.swept(model)
        named, title, numbers = room.named_models(spec), room.title_of(spec), room.numbers_of(spec)
        if plot is not None and len(numbers) != 1:
            raise InputError(
                f"'{title}' cannot be drawn: a map of digits is over one swept number."
            )
    with warnings_as_lines(), progress("counting digits", len(named)) as advance:
        frame = room.measure(named, progress=advance)
    if output is not None:
        typer.echo(f"{save_csv(frame, output)}: {len(frame)} values")
    typer.echo(f"{title}: right digits of {len(frame)} values")
    for row in room.worst(frame).to_dict("records"):
        at = ", ".join(f"{k} = {short(row[k])}" for k in (*frame.columns[: -len(room.LAST)],))
        typer.echo(
            f"  {row['way']}: median {row['median']:.1f}, fewest {row['worst']:.1f} "
            f"({row['lost']:.1f} lost) at {row['place']}, {at}"
        )
    for way, count in room.not_finite(frame).items():
        typer.echo(f"  {way}: {count} values are not finite")
    if plot is not None:
        save_figure(room.draw(frame, numbers[0], title), plot)
        typer.echo(f"{plot}: the map")


def _search(
    model: str, output: Path | None, width: float | None, examples: int | None, seed: int
) -> None:
    """Print, and write, the worst case of every way to the values of a model or a function."""
    from albedo.analysis.checks import model_in_file
    from albedo.analysis.worst_case import EXAMPLES
    from albedo.analysis.worst_case import search as look
    from albedo.files import save_csv

    what: Any = model
    if ".py:" in model:
        hints: dict[str, Any] = {} if width is None else {"lobe": "half", "width": width}
        what = model_in_file(model, **hints)
    elif width is not None:
        raise InputError("--width is about a function in a file; a model knows itself.")
    count = EXAMPLES if examples is None else examples
    with warnings_as_lines(), progress("searching", count) as advance:
        found = look(what, examples=count, seed=seed, progress=advance)
    if output is not None:
        typer.echo(f"{save_csv(found.table(), output)}: {len(found.worst)} cases")
    typer.echo(f"{model}: fewest right digits of a search")
    for way, case in found.worst.items():
        typer.echo(
            f"  {way}: {case.digits:.1f} ({case.lost:.1f} lost) of {found.tried[way]} values, at "
            f"{case.place}, cos_theta = {case.cos_theta:.6g}, phi = {case.phi:.6g}, view "
            f"{case.cos_view:.6g}, {case.phi_view:.6g}: {case.value:.6g}"
            f"{'' if case.finite else ', not finite'}"
        )
        if case.model.parameters:
            typer.echo(f"    {case.model.spec}")
    for way, number in found.not_finite.items():
        if number:
            typer.echo(f"  {way}: {number} values are not finite")
