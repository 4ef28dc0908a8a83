"""``albedo eval``, ``table``, ``plot`` and ``energy``."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from albedo.cli.app import app
from albedo.cli.options import (
    ComplementOption,
    CosOption,
    FixedOption,
    MethodOption,
    ModelArgument,
    OptionalModelArgument,
    OptionalRtolOption,
    PhiOption,
    RtolOption,
    SamplesOption,
    SeedOption,
    SequenceOption,
    StrategyOption,
    ThetaOption,
    complete_model,
    labelled,
    parse_azimuths,
    parse_incidence,
    radians,
)
from albedo.cli.screen import (
    compiling,
    print_rows,
    progress,
    rows_of,
    short,
    warnings_as_lines,
)
from albedo.errors import InputError


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
        cosines, angles = parse_incidence(cos, theta, default="0,15,30,45,60,75,85,89")
        azimuths = parse_azimuths(phi)
    rows: list[dict[str, Any]] = []
    # A bar over models says nothing while one of them is drawn a billion times: count draws there.
    drawn = method == "mc" and rtol is None
    steps = spec.count
    if drawn:
        steps *= len(cosines) * len(azimuths) * (find.keywords["samples"] or 2**20)
    with warnings_as_lines(), compiling(spec), progress("evaluating", steps) as advance:
        if drawn:
            find = partial(find, progress=_counted(advance, steps))
        for done, (label, built) in enumerate(labelled(spec), 1):
            for channel, kind in enumerate(built.by_channel()):
                number = None if kind is built else channel
                if average:
                    estimate = albedo.average_albedo(kind, rtol=tolerance, fixed=fixed)
                    rows += rows_of(label, number, "average albedo", estimate, None, None, None)
                    continue
                quantity = "1 - albedo" if complement else "albedo"
                for azimuth in azimuths:
                    options = {"complement": True} if complement else {}
                    estimate = find(kind, cosines, phi=radians(azimuth), fixed=fixed, **options)
                    rows += rows_of(label, number, quantity, estimate, cosines, angles, azimuth)
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
        print_rows(rows)


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
    cosines, _ = parse_incidence(cos, theta, default_cos="0.01..1/32")
    azimuths = np.array([radians(azimuth) for azimuth in parse_azimuths(phi)])
    for what, values in (("angles of incidence", cosines), ("azimuths", azimuths)):
        if len(np.unique(values)) < len(values):
            raise InputError(f"The {what} of a table must differ, and two of them are the same.")
    # The first combination stands for the parameters that are swept; all of them get checked.
    base = next(spec.models())
    with warnings_as_lines(), compiling(spec), progress("computing the table", None) as advance:
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

    with warnings_as_lines(), compiling(), progress("computing tables", None) as advance:
        files = write_atlas(output, list(sheets(rtol)), threads=threads, progress=advance)
    typer.echo(f"{output}: {len(files)} tables")


@app.command()
def plot(
    models: Annotated[
        list[str],
        typer.Argument(
            metavar="MODEL",
            help="Models with their parameters, sweeps allowed, all in one figure.",
            autocompletion=complete_model,
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
    azimuth = radians(parse_azimuths(repr(phi))[0])
    total = sum(spec.count for spec in specs)
    with warnings_as_lines(), compiling(*specs), progress("computing curves", total) as advance:
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
    with warnings_as_lines(), compiling(spec), progress("mapping", spec.count) as advance:
        found = energy_map(spec, rtol, progress=advance)
    numbers = save_csv(found.frame, output.with_suffix(".csv"))
    typer.echo(f"{numbers}: {len(found.frame)} sets of parameters of {spec}")
    for what, row in (
        ("largest", found.frame.loc[found.frame["max_albedo"].idxmax()]),
        ("smallest", found.frame.loc[found.frame["min_albedo"].idxmin()]),
    ):
        name = {"largest": "max", "smallest": "min"}[what]
        value = format_value(row[f"{name}_albedo"], row[f"{name}_albedo_error"])
        at = ", ".join(f"{key} = {short(row[key])}" for key in spec.sweep)
        typer.echo(f"{what} albedo: {value} at {at}, cos θ = {row[f'{name}_cos_theta']:.6g}")
    count = int((found.frame["exceeds_one"] == "yes").sum())
    typer.echo(f"exceeds 1: {count} of {len(found.frame)}")
    save_figure(draw(found), output)
    typer.echo(f"{output}: the map")
