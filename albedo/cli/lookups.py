"""``albedo design``, ``export`` and ``audit``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from albedo.cli.app import NOTHING_FITS, app
from albedo.cli.options import complete_model
from albedo.cli.screen import new_table, print_table, stages, warnings_as_lines
from albedo.errors import InputError

if TYPE_CHECKING:
    from albedo.lookup.label import LookupTable


def _complete_format(incomplete: str) -> list[str]:
    from albedo.lookup.formats import formats

    return [name for name in formats() if name.startswith(incomplete)]


@app.command()
def design(
    model: Annotated[
        str,
        typer.Argument(
            metavar="MODEL",
            help="A model; a sweep such as m=0.05..1/2 makes a parameter an axis of the table, "
            "between these numbers.",
            autocompletion=complete_model,
        ),
    ],
    error: Annotated[
        float | None, typer.Option(help="What the table may err by; the smallest is sought.")
    ] = None,
    size: Annotated[
        str | None, typer.Option(metavar="NxM", help="Points along each axis, instead.")
    ] = None,
    form: Annotated[
        str,
        typer.Option(
            metavar="table|polynomial|rational", help="A table, or a formula in its place."
        ),
    ] = "table",
    metric: Annotated[
        str, typer.Option(metavar="max|rms|relative", help="Of which error.")
    ] = "max",
    quantity: Annotated[
        str, typer.Option(metavar="albedo|complement|split_sum|average", help="What it holds.")
    ] = "albedo",
    cos: Annotated[
        str, typer.Option("--cos", metavar="LOW..HIGH", help="Cosines of the angle to the normal.")
    ] = "0..1",
    interp: Annotated[str, typer.Option(metavar="linear|cubic", help="How it is read.")] = "linear",
    dtype: Annotated[
        str,
        typer.Option(
            metavar="float64|float32|float16|unorm16|unorm8", help="How numbers are stored."
        ),
    ] = "float32",
    max_bytes: Annotated[
        int | None, typer.Option(help="What its numbers may take.", show_default="no limit")
    ] = None,
    warp: Annotated[
        list[str] | None,
        typer.Option(
            metavar="AXIS=WARP",
            help="What an axis is even in: linear, sqrt, angle, log, rational:K or "
            "rational:K*AXIS; sought unless given.",
        ),
    ] = None,
    texels: Annotated[
        str,
        typer.Option(metavar="ends|centres", help="Where nodes lie, as the reader takes them."),
    ] = "ends",
    fixed: Annotated[
        str, typer.Option(metavar="light|view", help="Which direction the albedo is of.")
    ] = "light",
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", help="The table; its ending says the format, as in `albedo export`."
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the label as JSON.")] = False,
) -> None:
    """Design a lookup table that meets an error from end to end, and say what it errs by.

    Axes, warps and sizes are tried, and what is best is measured between all nodes, with what its
    numbers lose when they are stored and where its reader takes them to lie, then at fresh places
    by quadrature.

    \b
    Examples:
      albedo design "cook_torrance:m=0.05..1/2,distribution=ggx" --error 1e-3 --cos 0.01..1
      albedo design "phong:n=1..1000/2" --size 32x32 --dtype unorm16 -o phong.nc
      albedo design "cook_torrance:m=0.1..1/2" --quantity split_sum --error 2e-3 -o pair.exr
      albedo design "phong:n=1..100/2" --form rational --error 1e-3 -o phong.glsl
    """
    import json

    from albedo.files import check_output
    from albedo.lookup.design import design as search
    from albedo.lookup.formats import format_of, save_lookup

    if form != "table":
        given = {"--size": size, "--max-bytes": max_bytes}
        for name, value in given.items():
            if value is not None:
                raise InputError(f"{name} is of tables; a formula is sought by its error alone.")
        _fit(model, error, form, metric, quantity, cos, warp or [], fixed, output, as_json)
        return
    if output is not None:
        check_output(output, (format_of(output).suffix,))
    with warnings_as_lines(), stages("design") as say:
        table = search(
            model,
            error=error,
            size=None if size is None else _size(size),
            metric=metric,
            quantity=quantity,
            cosines=_cosines(cos),
            interp=interp,
            dtype=dtype,
            max_bytes=max_bytes,
            warps=_warps(warp or []),
            texels=texels,
            fixed=fixed,
            progress=say,
        )
    if output is not None:
        typer.echo(f"{save_lookup(table, output)}: {_shape(table)}", err=as_json)
    if as_json:
        typer.echo(json.dumps({**table.label, "sha256": table.sha256}, indent=1))
    else:
        _show(table)


def _fit(
    model: str,
    error: float | None,
    form: str,
    metric: str,
    quantity: str,
    cos: str,
    warp: list[str],
    fixed: str,
    output: Path | None,
    as_json: bool,
) -> None:
    """Find a formula in place of a table."""
    import json

    from albedo.files import check_output
    from albedo.lookup.fits import FIT_SUFFIXES, save_fit
    from albedo.lookup.fits import fit as search

    if output is not None:
        check_output(output, FIT_SUFFIXES)
    if error is None:
        raise InputError("--error is needed: what the formula may err by.")
    with warnings_as_lines(), stages("design") as say:
        found = search(
            model,
            error=error,
            form=form,
            metric=metric,
            quantity=quantity,
            cosines=_cosines(cos),
            warps=_warps(warp),
            fixed=fixed,
            progress=say,
        )
    if output is not None:
        typer.echo(f"{save_fit(found, output)}: {found.coefficients} coefficients", err=as_json)
    typer.echo(json.dumps(found.label, indent=1) if as_json else str(found))


def _cosines(text: str) -> tuple[float, float]:
    from albedo.grammar import parse_numbers

    ends = parse_numbers(text if text.count("..") != 1 else f"{text}/2", "--cos")
    if len(ends) != 2:
        raise InputError(f"--cos {text} is no range; write its two ends, as in 0.01..1.")
    return float(ends[0]), float(ends[1])


def _size(text: str) -> tuple[int, ...]:
    try:
        return tuple(int(part) for part in text.lower().split("x"))
    except ValueError:
        raise InputError(
            f"--size {text} is no size; write numbers of points, as in 32x32."
        ) from None


def _warps(words: list[str]) -> dict[str, str]:
    found = {}
    for word in words:
        name, equals, warp = word.partition("=")
        if not equals:
            raise InputError(f"--warp {word} is none; write an axis and a warp, as in m=sqrt.")
        found[name] = warp
    return found


def _shape(table: LookupTable) -> str:
    first = table.channels[0].table
    return f"{table.grid} points of {first.stored}, {table.bytes} bytes"


def _show(table: LookupTable) -> None:
    how = f"read by {table.channels[0].table.read} interpolation"
    typer.echo(f"{table.about['title']}: {_shape(table)}, {how}")
    shown = new_table(
        *("channel", "largest error", "at", "rms", "relative", "at nodes", "fresh places"),
        right=True,
    )
    for channel in table.channels:
        e = channel.errors
        where = ", ".join(f"{name} = {value:.4g}" for name, value in e.where.items())
        shown.add_row(
            *(channel.name, f"{e.largest:.3g}", where, f"{e.rms:.3g}", f"{e.relative:.3g}"),
            *(f"{e.nodes:.2g}", f"{e.verified:.3g} of {e.places}"),
        )
    print_table(shown)


@app.command()
def export(
    table: Annotated[Path, typer.Argument(metavar="TABLE", help="A file of `albedo design`.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="The file to write.")],
    to: Annotated[
        str | None,
        typer.Option(
            metavar="FORMAT",
            help="The format; told by the ending of the file unless given.",
            autocompletion=_complete_format,
        ),
    ] = None,
) -> None:
    """Write a lookup table in another format, with its label.

    What is read is compared with the digest that it was written with.

    \b
    Examples:
      albedo export phong.nc -o phong.csv
      albedo export phong.nc -o phong.h
    """
    from albedo.lookup.formats import load_lookup, save_lookup

    found = load_lookup(table)
    typer.echo(f"{save_lookup(found, output, to)}: {_shape(found)}")


@app.command()
def audit(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            help="A table that was made elsewhere: .npy, .csv, .exr, .png, .dds, or source code.",
        ),
    ],
    model: Annotated[
        str,
        typer.Option(
            help="What it is said to be of: ggx, beckmann, or a model with its parameters.",
            autocompletion=complete_model,
        ),
    ],
    parameter: Annotated[
        str | None,
        typer.Option(
            help="What varies beside the direction, from 0 to 1.",
            show_default="m, if it has two axes",
        ),
    ] = None,
    axes: Annotated[
        str | None,
        typer.Option(
            metavar="ROWS,COLUMNS", help="What rows and columns are; both orders unless given."
        ),
    ] = None,
    shape: Annotated[
        str | None,
        typer.Option(metavar="NxM", help="Of a flat list; a square unless given."),
    ] = None,
    known: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PART=WORD",
            help="What is known: texels=, cosine=, parameter=, masking= or encoding=.",
        ),
    ] = None,
    plot: Annotated[
        Path | None, typer.Option(help="Maps of the errors (.png, .svg or .pdf).")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="All that was found (.json).")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print it as JSON.")] = False,
) -> None:
    """Find out what a table that was made elsewhere holds, and what it errs by.

    The usual conventions are tried, of axes, texels, roughness, masking, Fresnel split and
    encoding; the nearest to certified values is told, with the errors at its nodes and between
    them. The exit status is 1 where none fits.

    \b
    Examples:
      albedo audit brdf_lut.png --model ggx
      albedo audit ltc.js --model ggx --shape 64x64
      albedo audit e.npy --model "cook_torrance:distribution=beckmann" --axes cos_theta,m
    """
    import json

    from albedo.files import check_output, save_json
    from albedo.lookup.audit import audit as look
    from albedo.lookup.audit import plot_audit, said_to_be, shaped
    from albedo.lookup.foreign import load_array

    if output is not None:
        check_output(output, (".json",))
    if plot is not None:
        check_output(plot, (".png", ".svg", ".pdf"))
    kind = said_to_be(model)
    data = shaped(load_array(file), None if shape is None else _size(shape))
    if parameter is None and data.ndim > 1:
        parameter = "m"
    with stages("audit") as say:
        found = look(
            data,
            kind,
            parameter,
            axes=None if axes is None else tuple(axes.split(",")),
            fixed=dict(_pair(word) for word in known or []),
            progress=say,
        )
    if output is not None:
        typer.echo(f"{save_json(found.record(), output)}: the audit", err=as_json)
    if plot is not None:
        typer.echo(f"{plot_audit(found, plot)}: maps of the errors", err=as_json)
    typer.echo(json.dumps(found.record(), indent=1) if as_json else str(found))
    if not found.fits:
        raise typer.Exit(NOTHING_FITS)


def _pair(word: str) -> tuple[str, str]:
    name, equals, value = word.partition("=")
    if not equals:
        raise InputError(f"--known {word} is none; write a part and a word, as in texels=ends.")
    return name, value
