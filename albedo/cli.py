"""The command line: ``albedo models``, ``eval``, ``table``, ``plot``, ``study`` and ``report``."""

from __future__ import annotations

import errno
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer
from typer.core import TyperGroup

from albedo.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from rich.console import Console
    from rich.table import Table

    from albedo.grammar import Spec
    from albedo.studies import Result

NOTHING_FITS = 1
BAD_INPUT = 2
INTERRUPTED = 130


class _Commands(TyperGroup):
    """Commands whose bad input ends in one sentence and a status, not in a traceback."""

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except InputError as error:
            _fail(str(error))
        except OSError as error:
            # A reader that has seen enough (| head) is no failure of ours: typer ends quietly.
            if error.errno == errno.EPIPE:
                raise
            where = f" '{error.filename}'" if error.filename else ""
            _fail(f"The file{where} cannot be used: {error.strerror or error}")
        except KeyboardInterrupt:
            typer.echo("Interrupted; files that were not finished were not kept.", err=True)
            raise typer.Exit(INTERRUPTED) from None


def _fail(message: str) -> NoReturn:
    sentence = message if message.endswith((".", "?", "!")) else message + "."
    typer.echo(f"Error: {sentence}", err=True)
    raise typer.Exit(BAD_INPUT)


# Plain help: examples hold square brackets, which markup would swallow, and it starts faster.
app = typer.Typer(
    cls=_Commands,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
study_app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)
app.add_typer(study_app, name="study", help="List and run studies: one file, one question.")


def main() -> None:
    """Run the command line; the entry point of the ``albedo`` script."""
    try:
        app()
    except KeyboardInterrupt:
        # Interrupted before a command began or after it ended.
        sys.exit(INTERRUPTED)


def _complete_model(incomplete: str) -> list[str]:
    from albedo.catalogue import names

    return [name for name in names() if name.startswith(incomplete)]


def _complete_study(incomplete: str) -> list[str]:
    found = sorted(path.stem for path in Path("studies").glob("*.py"))
    return [name for name in found if name.startswith(incomplete) and name[0] != "_"]


def _print_version(wanted: bool) -> None:
    if wanted:
        import albedo

        typer.echo(f"albedo {albedo.__version__}")
        raise typer.Exit


ModelArgument = Annotated[
    str,
    typer.Argument(
        metavar="MODEL",
        help="A model with its parameters, such as ward:m=0.1; sweeps such as ward:m=0.02..1/32 "
        "or ward:m=[.1,.2,.5] and sums such as 'phong:n=20 + 0.3*lambert' are allowed.",
        autocompletion=_complete_model,
    ),
]
OptionalModelArgument = Annotated[
    str | None,
    typer.Argument(
        metavar="MODEL",
        help="A model with its parameters, such as ward:m=0.1; sweeps such as ward:m=0.02..1/32 "
        "or ward:m=[.1,.2,.5] and sums such as 'phong:n=20 + 0.3*lambert' are allowed.",
        autocompletion=_complete_model,
    ),
]
CosOption = Annotated[
    str | None,
    typer.Option(
        "--cos",
        metavar="NUMBERS",
        help="Cosines of the angle of incidence: numbers and ranges, such as 1,0.5,1e-3 or "
        "0.01..1/32 or 1e-6..1/61log.",
    ),
]
ThetaOption = Annotated[
    str | None,
    typer.Option(
        "--theta",
        metavar="DEGREES",
        help="Angles of incidence in degrees instead, such as 0,60,85 or 0..89/90.",
    ),
]
PhiOption = Annotated[
    str,
    typer.Option("--phi", metavar="DEGREES", help="Azimuths of the incident direction, degrees."),
]
RtolOption = Annotated[float, typer.Option(help="Relative tolerance.")]
OptionalRtolOption = Annotated[
    float | None,
    typer.Option(
        "--rtol",
        help="Relative tolerance; with --method mc, the relative standard error to stop at.",
        show_default="1e-8, or none with --method mc",
    ),
]
MethodOption = Annotated[
    str,
    typer.Option(metavar="quadrature|mc", help="Quadrature with bounds, or Monte Carlo."),
]
SamplesOption = Annotated[
    str | None,
    typer.Option(
        metavar="NUMBER",
        help="mc: draws per direction, such as 1e6; with --rtol, the most of them.",
        show_default="1048576, or 1073741824 with --rtol",
    ),
]
StrategyOption = Annotated[
    str | None,
    typer.Option(
        metavar="model|cosine|uniform|mixture",
        help="mc: what directions are drawn from.",
        show_default="model",
    ),
]
SequenceOption = Annotated[
    str | None,
    typer.Option(
        metavar="random|stratified|sobol",
        help="mc: points of the unit square.",
        show_default="random",
    ),
]
SeedOption = Annotated[
    int | None,
    typer.Option(help="mc: same seed, same numbers.", show_default="0"),
]
FixedOption = Annotated[str, typer.Option(metavar="light|view", help="The direction that is held.")]
ComplementOption = Annotated[
    bool, typer.Option("--complement", help="One minus the albedo, without cancellation.")
]
ControlOption = Annotated[
    str | None,
    typer.Option(
        metavar="literal|cumulative",
        help="Keep what each step, or what all together divide by from falling below "
        "max(n.l, n.v).",
        show_default="none",
    ),
]
OutputOption = Annotated[
    Path | None,
    typer.Option(
        "-o",
        "--output",
        help="Numbers (.csv) or a picture (.png, .svg, .pdf); with --plot the picture goes "
        "beside the numbers.",
    ),
]
FullOption = Annotated[
    bool, typer.Option("--full", help="Full fidelity, which may take long, instead of quick.")
]
StudiesDirOption = Annotated[
    Path | None,
    typer.Option("--studies-dir", help="Folder of the studies.", show_default="./studies"),
]


@app.callback()
def _main(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    """Directional albedos of reflectance models, every number with an error bound.

    A model is written as its name and parameters: ward:m=0.1, or
    cook_torrance:m=0.3,distribution=ggx. A sweep is m=0.02..1/32 (32 even steps),
    m=0.001..1/32log, or m=[.1,.2,.5]; a vector is (.9,.5,.1). Models add up, each times a number:
    "phong:n=20 + 0.3*lambert", or "0.5*(phong:n=20 + lambert)".

    \b
    Examples:
      albedo models ward
      albedo eval ward:m=0.1 --theta 0,60,85
      albedo table "ward:m=0.02..1/32" -o ward.nc
      albedo plot ward:m=0.1 phong:n=150 -o albedo.png
    """


@app.command()
def models(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="NAME", help="Show one model in full.", autocompletion=_complete_model
        ),
    ] = None,
    as_markdown: Annotated[
        bool, typer.Option("--markdown", help="Print the list as a Markdown table.")
    ] = False,
) -> None:
    """List the models, or show one: its formula, sources, promises and parameters.

    \b
    Examples:
      albedo models
      albedo models cook_torrance
    """
    if as_markdown and name is not None:
        raise InputError("--markdown prints the list of all models and does not go with a name.")
    if as_markdown:
        from albedo.describe import markdown

        typer.echo(markdown(), nl=False)
    elif name is None:
        _list_models()
    else:
        _show_model(name)


def _list_models() -> None:
    import albedo

    table = _new_table("model", "what it is", "equation", "reciprocal", "conserves energy")
    for name, kind in albedo.models().items():
        promises = (_yes(kind.reciprocal), _yes(kind.conserves_energy))
        table.add_row(name, kind.title, kind.equation, *promises)
    _print(table)


def _show_model(name: str) -> None:
    import inspect

    from albedo.catalogue import model_class
    from albedo.describe import citation, promises

    kind = model_class(name)
    typer.echo(f"{kind.name}: {kind.title}\n")
    typer.echo(inspect.getdoc(kind))
    typer.echo(f"\nequation:  {kind.equation}")
    for key in kind.references:
        typer.echo(f"source:    {citation(key)}")
    typer.echo()
    for promise, said in promises(kind).items():
        typer.echo(f"{promise + ':':28s} {said}")
    table = _new_table("parameter", "default", "allowed", "unit", "meaning")
    for item in kind.parameter_info():
        table.add_row(item.name, _default(item.default), item.range_text, item.unit, item.doc)
    if table.row_count:
        typer.echo()
        _print(table)


def _yes(promise: Any) -> str:
    # A model whose promise depends on its parameters declares a property.
    if isinstance(promise, bool):
        return "yes" if promise else "no"
    return "depends on its parameters"


def _default(value: Any) -> str:
    from albedo.grammar import format_value

    return "" if value is None else format_value(value)


@app.command("eval")
def evaluate(
    model: ModelArgument,
    cos: CosOption = None,
    theta: ThetaOption = None,
    phi: PhiOption = "0",
    rtol: OptionalRtolOption = None,
    fixed: FixedOption = "light",
    complement: ComplementOption = False,
    average: Annotated[
        bool, typer.Option("--average", help="The cosine-weighted mean over all directions.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON with every digit.")] = False,
    as_csv: Annotated[bool, typer.Option("--csv", help="Print CSV with every digit.")] = False,
    method: MethodOption = "quadrature",
    samples: SamplesOption = None,
    strategy: StrategyOption = None,
    sequence: SequenceOption = None,
    seed: SeedOption = None,
) -> None:
    """Print albedos with their error bounds, or with the standard errors of Monte Carlo.

    Without --cos and --theta: 0, 15, 30, 45, 60, 75, 85 and 89 degrees. In JSON, numbers that
    are not finite are the strings "Infinity", "-Infinity" and "NaN".

    \b
    Examples:
      albedo eval ward:m=0.1 --theta 0,60,85
      albedo eval phong:n=1e6 --cos 1,0.5,1e-3 --rtol 1e-12
      albedo eval "ward:m=[.1,.2,.5]" --average
      albedo eval "phong:n=20,rho_s=0.4 + 0.3*lambert" --cos 0.5
      albedo eval ward:alpha_x=0.1,alpha_y=0.3 --theta 60 --phi 0,45,90 --json
      albedo eval ward:m=0.1 --theta 60 --method mc --samples 1e6 --sequence sobol --seed 7
    """
    import albedo
    from albedo.grammar import parse

    if as_json and as_csv:
        raise InputError("Both --json and --csv are given; choose one.")
    spec = parse(model)
    find = _method(method, rtol, samples, strategy, sequence, seed)
    if method == "mc" and (average or complement):
        option = "--average" if average else "--complement"
        raise InputError(f"{option} is computed by quadrature and does not go with --method mc.")
    tolerance = 1e-8 if rtol is None else rtol
    if average:
        given = [
            option
            for option, value in (
                ("--cos", cos),
                ("--theta", theta),
                ("--phi", phi if phi != "0" else None),
                ("--complement", complement or None),
            )
            if value is not None
        ]
        if given:
            raise InputError(f"--average is over all directions and does not go with {given[0]}.")
    else:
        cosines, angles = _incidence(cos, theta, default="0,15,30,45,60,75,85,89")
        azimuths = _azimuths(phi)
    rows: list[dict[str, Any]] = []
    # A bar over models says nothing while one of them is drawn a billion times: count draws there.
    drawn = method == "mc" and rtol is None
    steps = spec.count
    if drawn:
        steps *= len(cosines) * len(azimuths) * (find.keywords["samples"] or 2**20)
    with _warnings_as_lines(), _compiling(spec), _progress("evaluating", steps) as advance:
        if drawn:
            find = partial(find, progress=_counted(advance, steps))
        for done, (label, built) in enumerate(_labelled(spec), 1):
            for channel, kind in enumerate(built.by_channel()):
                number = None if kind is built else channel
                if average:
                    estimate = albedo.average_albedo(kind, rtol=tolerance, fixed=fixed)
                    rows += _rows(label, number, "average albedo", estimate, None, None, None)
                    continue
                quantity = "1 - albedo" if complement else "albedo"
                for azimuth in azimuths:
                    options = {"complement": True} if complement else {}
                    estimate = find(kind, cosines, phi=_radians(azimuth), fixed=fixed, **options)
                    rows += _rows(label, number, quantity, estimate, cosines, angles, azimuth)
            if not drawn:
                advance(done, spec.count)
    if as_json:
        import json

        from albedo.files import strict

        typer.echo(json.dumps(strict(rows), indent=2, allow_nan=False))
    elif as_csv:
        import pandas as pd

        typer.echo(pd.DataFrame(rows).to_csv(index=False, lineterminator="\n"), nl=False)
    else:
        _print_rows(rows)


def _counted(advance: Callable[[int, int], None], total: int) -> Callable[[int], None]:
    """What adds up the draws that it is told of, for a progress bar."""
    done = 0

    def add(draws: int) -> None:
        nonlocal done
        done += draws
        advance(min(done, total), total)

    return add


def _method(
    method: str,
    rtol: float | None,
    samples: str | None,
    strategy: str | None,
    sequence: str | None,
    seed: int | None,
    default_rtol: float = 1e-8,
) -> partial[Any]:
    """What computes albedos: called with a model, cosines, and phi and fixed by name."""
    import albedo
    from albedo.grammar import parse_numbers

    given = {
        "--samples": samples,
        "--strategy": strategy,
        "--sequence": sequence,
        "--seed": seed,
    }
    if method == "quadrature":
        for option, value in given.items():
            if value is not None:
                raise InputError(f"{option} needs --method mc: quadrature draws nothing.")
        return partial(albedo.directional_albedo, rtol=default_rtol if rtol is None else rtol)
    if method != "mc":
        raise InputError(f"--method {method} is unknown; choose quadrature or mc.")
    count = None
    if samples is not None:
        numbers = parse_numbers(samples, "--samples")
        if len(numbers) != 1 or numbers[0] % 1.0 != 0.0 or not 2.0 <= numbers[0] <= 1e15:
            raise InputError(
                f"--samples {samples} is out of range; it is a whole number from 2 to 1e15."
            )
        count = int(numbers[0])
    return partial(
        albedo.monte_carlo_albedo,
        samples=count,
        rtol=rtol,
        strategy=strategy or "model",
        sequence=sequence or "random",
        seed=seed or 0,
    )


def _rows(
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


def _print_rows(rows: list[dict[str, Any]]) -> None:
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
    table = _new_table(*heads, f"{quantity} ({kind})", "evaluations", "converged", right=True)
    last = None
    for row in rows:
        if last is not None and row["model"] != last:
            table.add_section()
        cells = [_short(row[head]) for head in heads]
        if row["model"] == last:
            cells[0] = ""
        last = row["model"]
        table.add_row(
            *cells,
            format_value(row["value"], row["error"]),
            str(row["evaluations"]),
            "yes" if row["converged"] else "NO",
        )
    _print(table)
    widths = {row["resolved_width"] for row in rows} - {None}
    if widths:
        typer.echo(f"The bounds hold for features wider than {max(widths):g} radians.")


def _short(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


@app.command()
def table(
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--output", help="File that ends in .nc (netCDF) or .csv; with --all, a folder."
        ),
    ],
    model: OptionalModelArgument = None,
    every: Annotated[bool, typer.Option("--all", help="The default tables of all models.")] = False,
    cos: CosOption = None,
    theta: ThetaOption = None,
    phi: PhiOption = "0",
    rtol: RtolOption = 1e-8,
    fixed: FixedOption = "light",
    complement: ComplementOption = False,
    threads: Annotated[int, typer.Option(help="Threads to compute with.")] = 1,
) -> None:
    """Write a table of albedos over angles and swept parameters.

    Without --cos and --theta: 0.01..1/32 in the cosine. netCDF keeps units, citations, tolerance
    and version beside the numbers; CSV has one row per value. Files have azimuths in radians.

    --all writes the default tables of all models as netCDF files into a folder. A run that was
    interrupted goes on where it stopped.

    \b
    Examples:
      albedo table "ward:m=0.02..1/32" -o ward.nc
      albedo table "phong:n=1..1e6/61log" --cos 1e-4..1/41log -o phong.csv --threads 4
      albedo table ward:alpha_x=0.1,alpha_y=0.3 --theta 0..85/18 --phi 0..90/7 -o aniso.nc
      albedo table --all -o tables --rtol 1e-6 --threads 2
    """
    if every:
        given = {"a model": model, "--cos": cos, "--theta": theta, "--complement": complement}
        odd = [what for what, value in given.items() if value]
        odd += ["--phi"] * (phi != "0") + ["--fixed"] * (fixed != "light")
        if odd:
            raise InputError(f"--all writes the default tables and does not go with {odd[0]}.")
        _write_atlas(output, rtol, threads)
        return
    if model is None:
        raise InputError("Name a model such as ward:m=0.02..1/32, or write all with --all.")
    import numpy as np

    import albedo
    from albedo.files import check_output, save_table
    from albedo.grammar import ModelSpec, parse

    check_output(output, (".nc", ".csv"))
    spec = parse(model)
    sweep = {}
    if isinstance(spec, ModelSpec):
        sweep = {key: list(values) for key, values in spec.sweep.items()}
    elif spec.count > 1:
        raise InputError(
            f"A table sweeps the parameters of one model; '{spec}' sweeps within a sum."
        )
    cosines, _ = _incidence(cos, theta, default_cos="0.01..1/32")
    azimuths = np.array([_radians(azimuth) for azimuth in _azimuths(phi)])
    for what, values in (("angles of incidence", cosines), ("azimuths", azimuths)):
        if len(np.unique(values)) < len(values):
            raise InputError(f"The {what} of a table must differ, and two of them are the same.")
    # The first combination stands for the parameters that are swept; all of them get checked.
    base = next(spec.models())
    with _warnings_as_lines(), _compiling(spec), _progress("computing the table", None) as advance:
        dataset = albedo.table(
            base,
            cos_theta=cosines,
            phi=azimuths,
            sweep=sweep,
            rtol=rtol,
            fixed=fixed,
            complement=complement,
            threads=threads,
            progress=advance,
        )
    save_table(dataset, output)
    what = "complements" if complement else "albedos"
    typer.echo(f"{output}: {dataset['value'].size} {what} of {spec}")


def _write_atlas(output: Path, rtol: float, threads: int) -> None:
    from albedo.atlas import sheets, write_atlas

    with _warnings_as_lines(), _compiling(), _progress("computing tables", None) as advance:
        files = write_atlas(output, list(sheets(rtol)), threads=threads, progress=advance)
    typer.echo(f"{output}: {len(files)} tables")


@app.command()
def plot(
    models: Annotated[
        list[str],
        typer.Argument(
            metavar="MODEL",
            help="Models with their parameters, sweeps allowed, all in one figure.",
            autocompletion=_complete_model,
        ),
    ],
    output: Annotated[
        Path, typer.Option("-o", "--output", help="File that ends in .png, .svg or .pdf.")
    ],
    grazing: Annotated[
        bool, typer.Option("--grazing", help="Logarithmic axis in the cosine of the angle.")
    ] = False,
    min_cos: Annotated[
        float | None,
        typer.Option("--min-cos", help="Smallest cosine with --grazing.", show_default="1e-6"),
    ] = None,
    phi: Annotated[
        float, typer.Option("--phi", help="Azimuth of the incident direction, degrees.")
    ] = 0.0,
    rtol: OptionalRtolOption = None,
    method: MethodOption = "quadrature",
    samples: SamplesOption = None,
    strategy: StrategyOption = None,
    sequence: SequenceOption = None,
    seed: SeedOption = None,
) -> None:
    """Draw albedo curves of models and sweeps against the angle of incidence.

    \b
    Examples:
      albedo plot ward:m=0.1 phong:n=150 cook_torrance:m=0.1 -o albedo.png
      albedo plot "ward:m=[.1,.2,.5]" --grazing --min-cos 1e-9 -o grazing.svg
      albedo plot ward:m=0.1 --method mc --samples 1e4 -o noisy.png
    """
    from albedo import plotting
    from albedo.files import check_output
    from albedo.grammar import parse

    check_output(output, plotting.SUFFIXES)
    if min_cos is not None and not grazing:
        raise InputError("--min-cos needs --grazing: a linear axis ends at 89.9 degrees.")
    specs = [parse(model) for model in models]
    find = _method(method, rtol, samples, strategy, sequence, seed, default_rtol=1e-6)
    cosines = (
        plotting.grazing_grid(1e-6 if min_cos is None else min_cos)
        if grazing
        else plotting.angle_grid()
    )
    azimuth = _radians(_azimuths(repr(phi))[0])
    total = sum(spec.count for spec in specs)
    with _warnings_as_lines(), _compiling(*specs), _progress("computing curves", total) as advance:
        curves = plotting.measure(specs, cosines, phi=azimuth, find=find, progress=advance)
    figure = plotting.draw(curves, grazing=grazing, phi=azimuth or None)
    plotting.save_figure(figure, output)
    typer.echo(f"{output}: {len(curves)} curve{'' if len(curves) == 1 else 's'}")


@app.command()
def energy(
    model: ModelArgument,
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--output", help="Picture (.png, .svg, .pdf); the numbers go beside it as .csv."
        ),
    ] = Path("energy.png"),
    rtol: RtolOption = 1e-6,
) -> None:
    """Map the largest and smallest albedo of a model, and mark where it exceeds 1.

    Without a sweep, the domain of the model's main parameters is swept.

    \b
    Examples:
      albedo energy ward
      albedo energy cook_torrance:geometry=none -o cook_torrance.svg
      albedo energy "max_phong:n=0..4/41" -o max_phong.png
    """
    from albedo.analysis.energy import domain, draw, drawn_over, energy_map
    from albedo.estimate import format_value
    from albedo.files import check_output, save_csv
    from albedo.plotting import SUFFIXES, save_figure

    check_output(output, SUFFIXES)
    spec = domain(model)
    drawn_over(spec)
    with _warnings_as_lines(), _compiling(spec), _progress("mapping", spec.count) as advance:
        found = energy_map(spec, rtol, progress=advance)
    numbers = save_csv(found.frame, output.with_suffix(".csv"))
    typer.echo(f"{numbers}: {len(found.frame)} sets of parameters of {spec}")
    for what, row in (
        ("largest", found.frame.loc[found.frame["max_albedo"].idxmax()]),
        ("smallest", found.frame.loc[found.frame["min_albedo"].idxmin()]),
    ):
        name = {"largest": "max", "smallest": "min"}[what]
        value = format_value(row[f"{name}_albedo"], row[f"{name}_albedo_error"])
        at = ", ".join(f"{key} = {_short(row[key])}" for key in spec.sweep)
        typer.echo(f"{what} albedo: {value} at {at}, cos θ = {row[f'{name}_cos_theta']:.6g}")
    count = int((found.frame["exceeds_one"] == "yes").sum())
    typer.echo(f"exceeds 1: {count} of {len(found.frame)}")
    save_figure(draw(found), output)
    typer.echo(f"{output}: the map")


@app.command()
def pump(
    model: ModelArgument,
    steps: Annotated[int, typer.Option(help="How often the model is pumped up.")] = 1,
    control: ControlOption = None,
    cos: CosOption = None,
    theta: ThetaOption = None,
    phi: Annotated[
        float, typer.Option(metavar="DEGREES", help="Azimuth of the light, degrees.")
    ] = 0.0,
    rtol: Annotated[
        float | None,
        typer.Option(help="Relative error asked for; by default 1e-8, or what tables can give."),
    ] = None,
    draw: Annotated[
        bool, typer.Option("--plot", help="Draw the albedos of all steps as well.")
    ] = False,
    grazing: Annotated[
        bool, typer.Option("--grazing", help="Logarithmic axis in the cosine of the angle.")
    ] = False,
    output: OutputOption = None,
) -> None:
    """Pump a model up, and print its albedo before and after every step.

    The model must be symmetric in both directions; it need not conserve energy. Where it is
    anisotropic, or has lobes elsewhere than about the mirror direction, each step is a table of
    its own, and takes minutes rather than milliseconds. Such tables are kept: a run that was
    interrupted goes on where it stopped.

    \b
    Examples:
      albedo pump phong:n=20 --steps 5
      albedo pump blinn:n=20 --steps 3 --control cumulative --plot -o blinn.csv
      albedo pump ward:m=0.4 --steps 2 --grazing -o ward.png
    """
    import pandas as pd

    import albedo
    from albedo import plotting
    from albedo.files import save_csv
    from albedo.grammar import parse

    numbers, picture = _outputs(output, draw, "pump.png")
    spec = parse(model)
    if spec.count > 1:
        raise InputError(f"pump takes one model; {spec} is a sweep of {spec.count}")
    base = spec.model()
    if base.channels is not None:
        raise InputError(f"pump takes one channel; {spec} has {base.channels}")
    cosines, angles = _incidence(cos, theta, default="0,15,30,45,60,75,85,89")
    whole = albedo.pump(base, steps, control)
    goal = whole.usual_rtol if rtol is None else rtol
    azimuth = _radians(phi)
    stages = [albedo.pump(base, k, control) for k in range(whole.steps)] + [whole]
    rows: list[dict[str, Any]] = []
    curves = []
    grid = plotting.grazing_grid() if grazing else plotting.angle_grid()
    with _warnings_as_lines(), _compiling(spec), _progress("pumping", len(stages)) as advance:
        for k, stage in enumerate(stages):
            found = albedo.directional_albedo(stage, cosines, azimuth, rtol=goal)
            for row in _rows(str(spec), None, "albedo", found, cosines, angles, phi):
                if row.get("part", "total") == "total":
                    rows.append({"model": row.pop("model"), "step": k, **row})
            if picture is not None:
                drawn = albedo.directional_albedo(stage, grid, azimuth, rtol=max(goal, 1e-6))
                label = f"{spec}, {k} step{'' if k == 1 else 's'}"
                swept = ("steps", float(k))
                curves.append(
                    plotting.Curve(label, spec.name, grid, drawn.value, drawn.error, swept)
                )
            advance(k + 1, len(stages))
    if numbers is not None:
        save_csv(pd.DataFrame(rows), numbers)
        typer.echo(f"{numbers}: {len(rows)} albedos")
    if picture is not None:
        plotting.save_figure(plotting.draw(curves, grazing=grazing), picture)
        typer.echo(f"{picture}: {len(curves)} curves")
    if numbers is None:
        for row in rows:
            row.pop("part", None)
            row["model"] = f"step {row.pop('step')}"
        _print_rows(rows)


@app.command()
def radiance(
    model: ModelArgument,
    steps: Annotated[int, typer.Option(help="Pump the model up so often first.")] = 0,
    control: ControlOption = None,
    cos: CosOption = None,
    theta: ThetaOption = None,
    phi: Annotated[
        float, typer.Option(metavar="DEGREES", help="Azimuth of the light, degrees.")
    ] = 0.0,
    draw: Annotated[
        bool,
        typer.Option("--plot", help="Draw the output radiance in the plane of incidence as well."),
    ] = False,
    output: OutputOption = None,
) -> None:
    """Print where the output radiance of a point source is largest, and how large.

    The source's rays carry unit irradiance across them: the radiance is f(L, V) n.l in 1/sr. Dirac
    parts are left out. The last columns are the radiance in the mirror direction and the angle
    between the two.

    \b
    Examples:
      albedo radiance cook_torrance:m=0.3 --theta 0,30,60,80
      albedo radiance phong:n=20 --steps 5 --cos 0.5,0.1,0.01 -o phong.csv
      albedo radiance ashikhmin_shirley:n_u=1000,n_v=10 --phi 30 --plot -o lobe.csv
    """
    import pandas as pd

    import albedo
    from albedo import plotting
    from albedo.analysis.radiance import peak, plane_radiance
    from albedo.files import save_csv
    from albedo.grammar import parse

    numbers, picture = _outputs(output, draw, "radiance.png")
    spec = parse(model)
    if steps == 0 and control is not None:
        raise InputError("--control is how steps are kept; it goes with --steps.")
    cosines, angles = _incidence(cos, theta, default="0,15,30,45,60,75,85,89")
    rows: list[dict[str, Any]] = []
    profiles = []
    turn = _radians(phi)
    total = spec.count * len(cosines)
    with _warnings_as_lines(), _compiling(spec), _progress("searching", total) as advance:
        for label, base in _labelled(spec):
            for number, kind in enumerate(base.by_channel()):
                lobe = albedo.pump(kind, steps, control) if steps else kind
                named = label if kind is base else f"{label}, channel {number}"
                for c, angle in zip(cosines.tolist(), angles.tolist(), strict=True):
                    found = peak(lobe, c, turn)
                    rows.append(_peak_row(named, steps, angle, c, phi, found))
                    if picture is not None:
                        view = plotting.view_grid(angle)
                        drawn = plane_radiance(lobe, c, view, phi=turn)
                        name = f"{named}, {angle:.6g}°" if spec.count > 1 else f"{angle:.6g}°"
                        profiles.append((name, view, drawn))
                    advance(min(len(rows), total), total)
    if numbers is not None:
        save_csv(pd.DataFrame(rows), numbers)
        typer.echo(f"{numbers}: {len(rows)} peaks")
    if picture is not None:
        plotting.save_figure(plotting.draw_radiance(profiles, str(spec)), picture)
        typer.echo(f"{picture}: {len(profiles)} curves")
    if numbers is None:
        _print_peaks(rows)


def _peak_row(
    label: str, steps: int, angle: float, cos_theta: float, phi: float, found: Any
) -> dict[str, Any]:
    import math

    x, y = float(found.direction[0]), float(found.direction[1])
    return {
        "model": label,
        "steps": steps,
        "theta": angle,
        "cos_theta": cos_theta,
        "phi": phi,
        "peak": found.value,
        "peak_error": found.error,
        "view_theta": math.degrees(math.atan2(math.hypot(x, y), found.cos_view)),
        "view_phi": math.degrees(math.atan2(y, x)),
        "direction_error": math.degrees(found.bracket),
        "at_mirror": found.at_mirror,
        "at_mirror_error": found.at_mirror_error,
        "from_mirror": math.degrees(found.angle_from_mirror),
    }


def _print_peaks(rows: list[dict[str, Any]]) -> None:
    from albedo.estimate import format_value

    heads = ("model", "theta", "cos_theta", "largest radiance (bound)", "at theta", "at phi")
    table = _new_table(*heads, "in mirror direction", "degrees from it", right=True)
    last = None
    for row in rows:
        if last is not None and row["model"] != last:
            table.add_section()
        table.add_row(
            "" if row["model"] == last else row["model"],
            _short(row["theta"]),
            _short(row["cos_theta"]),
            format_value(row["peak"], row["peak_error"]),
            f"{row['view_theta']:.4f}",
            f"{row['view_phi']:.4f}",
            format_value(row["at_mirror"], row["at_mirror_error"]),
            "any" if row["direction_error"] > 90.0 else f"{row['from_mirror']:.4f}",
        )
        last = row["model"]
    _print(table)


def _outputs(output: Path | None, draw: bool, default: str) -> tuple[Path | None, Path | None]:
    """Where numbers and a picture go: with a picture as output, or asked for beside numbers."""
    from albedo import plotting
    from albedo.files import check_output

    picture = Path(default) if draw and output is None else None
    numbers = None
    if output is not None and output.suffix.lower() in plotting.SUFFIXES:
        picture = output
    elif output is not None:
        numbers = output
        picture = output.with_suffix(".png") if draw else None
    if numbers is not None:
        check_output(numbers, (".csv",))
    if picture is not None:
        check_output(picture, plotting.SUFFIXES)
    return numbers, picture


@app.command()
def stability(
    model: Annotated[
        str,
        typer.Argument(
            metavar="MODEL|FILE.py:FUNCTION",
            help="A model such as ward, or a function f(wi, wo) in a file.",
            autocompletion=_complete_model,
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
    with _warnings_as_lines(), _progress("counting digits", len(named)) as advance:
        frame = room.measure(named, progress=advance)
    if output is not None:
        typer.echo(f"{save_csv(frame, output)}: {len(frame)} values")
    typer.echo(f"{title}: right digits of {len(frame)} values")
    for row in room.worst(frame).to_dict("records"):
        at = ", ".join(f"{k} = {_short(row[k])}" for k in (*frame.columns[: -len(room.LAST)],))
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
    with _warnings_as_lines(), _progress("searching", count) as advance:
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


@app.command()
def advise(
    model: Annotated[
        str,
        typer.Argument(
            metavar="MODEL",
            help="A model as the scene has it; a sweep such as m=0.05..0.5/2 says between which "
            "numbers a parameter varies.",
            autocompletion=_complete_model,
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
    with _warnings_as_lines():
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
            autocompletion=_complete_model,
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
        subjects = [room.subject(m, label) for spec in specs for label, m in _labelled(spec)]
    else:
        subjects = room.catalogue()
    with _warnings_as_lines(), _progress("timing", None) as advance:
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

        with _progress("timing what advice needs", None) as advance:
            rows = prices.measure(advance)
        typer.echo(f"{prices.save(rows, prices.FILE)}: {len(rows)} prices")


def _print_costs(frame: Any) -> None:
    """Ratios first, then nanoseconds; a model is a row."""
    heads = [
        *("ratio", "quartiles", "ratio float32", "quartiles"),
        *("ns", "ns float32", "ns in the lobe", "ns in the lobe, float32"),
    ]
    table = _new_table("model", *heads, right=True)
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
    _print(table)


@app.command()
def check(
    model: Annotated[
        str,
        typer.Argument(
            metavar="MODEL|FILE.py:FUNCTION",
            help="A model such as ward:m=0.1, or a function f(wi, wo) in a file.",
            autocompletion=_complete_model,
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
        with _warnings_as_lines():
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
        with _warnings_as_lines(), _compiling(spec), _progress("checking", spec.count) as advance:
            for done, (label, built) in enumerate(_labelled(spec), 1):
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
        table = _new_table("check", "verdict", "what was found")
        table.title, table.title_justify = label, "left"
        for one in found:
            table.add_row(one.name, words[one.passed], one.measured)
        _print(table)
    every = [one for found in results.values() for one in found]
    failed = sum(one.passed is False for one in every)
    typer.echo(f"{failed} of {len(every)} checks failed" if failed else "No check failed")
    return failed


@study_app.command("list")
def list_studies(studies_dir: StudiesDirOption = None) -> None:
    """List the studies of a folder; the status is 1 if one of them cannot be read.

    \b
    Examples:
      albedo study list
      albedo study list --studies-dir my_studies
    """
    from albedo.studies import discover

    table = _new_table("study", "title", "reproduces", "claims")
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
    _print(table)
    if broken:
        raise typer.Exit(1)


@study_app.command("run")
def run_studies(
    names: Annotated[
        list[str],
        typer.Argument(metavar="NAME", help="Studies to run.", autocompletion=_complete_study),
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
        with _compiling(), _study_progress(name) as advance:
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
    with _compiling(), _study_progress("studies") as advance:
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


def _incidence(
    cos: str | None, theta: str | None, default: str | None = None, default_cos: str | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Cosines and angles in degrees from whichever of the two is given."""
    import numpy as np

    from albedo.grammar import cos_degrees, parse_numbers

    if cos is not None and theta is not None:
        raise InputError("Both --cos and --theta are given; choose one.")
    if cos is None and theta is None:
        cos, theta = default_cos, default
    if cos is not None:
        cosines = parse_numbers(cos, "--cos")
        for value in cosines:
            if not 0.0 <= value <= 1.0:
                raise InputError(f"--cos has {value:g}; a cosine must be within 0 and 1.")
        return cosines, np.degrees(np.arccos(cosines))
    assert theta is not None
    angles = parse_numbers(theta, "--theta")
    return np.array([cos_degrees(angle) for angle in angles]), angles


def _azimuths(phi: str) -> list[float]:
    from albedo.grammar import parse_numbers

    return [float(value) for value in parse_numbers(phi, "--phi")]


def _radians(degrees: float) -> float:
    import math

    return math.radians(degrees)


def _labelled(spec: Spec) -> Iterator[tuple[str, Any]]:
    """Models with the shortest text that names each: what was written, without the defaults."""
    for single in spec.singles():
        yield str(single), single.model()


@contextmanager
def _warnings_as_lines() -> Iterator[None]:
    """Print a warning as one line on stderr, once, instead of with a line of source code."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield
    for text in dict.fromkeys(str(item.message) for item in caught):
        typer.echo(f"Warning: {text}", err=True)


@contextmanager
def _compiling(*models: Spec) -> Iterator[None]:
    """Share what a first call has to compile between two processes."""
    from albedo._compile import second_compiler

    with second_compiler(*map(str, models)):
        yield


@contextmanager
def _progress(what: str, total: int | None) -> Iterator[Callable[[int, int], None]]:
    """Show a transient progress bar on stderr, when it is a terminal and there is a wait."""
    with _bar(what, total, visible=total != 1) as update:
        yield lambda done, total: update(completed=done, total=total)


@contextmanager
def _study_progress(what: str) -> Iterator[Callable[[int, int, str], None]]:
    with _bar(what, None) as update:
        yield lambda done, total, text: update(
            completed=done, total=total, description=f"{what} {text}".strip()
        )


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


def _new_table(*heads: str, right: bool = False) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, header_style="bold")
    for head in heads:
        numeric = right and head not in ("model", "part", "converged")
        table.add_column(head, justify="right" if numeric else "left", overflow="fold")
    return table


def _print(table: Table) -> None:
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


if __name__ == "__main__":
    main()
