"""``albedo pump`` and ``radiance``."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from albedo.cli.app import app
from albedo.cli.options import (
    ControlOption,
    CosOption,
    ModelArgument,
    OutputOption,
    ThetaOption,
    labelled,
    outputs,
    parse_incidence,
    radians,
)
from albedo.cli.screen import (
    compiling,
    counted,
    new_table,
    print_rows,
    print_table,
    progress,
    rows_of,
    short,
    warnings_as_lines,
)
from albedo.errors import InputError


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
        typer.Option(
            help="Relative error asked for, of all that is divided by as well; by default 1e-8, or "
            "what tables can give."
        ),
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
    from albedo.operators.asked import COARSEST, FINEST

    numbers, picture = outputs(output, draw, "pump.png")
    spec = parse(model)
    if spec.count > 1:
        raise InputError(f"pump takes one model; {spec} is a sweep of {spec.count}")
    base = spec.model()
    if base.channels is not None:
        raise InputError(f"pump takes one channel; {spec} has {base.channels}")
    cosines, angles = parse_incidence(cos, theta, default="0,15,30,45,60,75,85,89")
    # Divisors are worth no more and no less than that; what is asked of results may be.
    wanted = {} if rtol is None else {"goal": max(FINEST, min(COARSEST, rtol))}
    whole = albedo.pump(base, steps, control, **wanted)
    goal = whole.usual_rtol if rtol is None else rtol
    azimuth = radians(phi)
    stages = [albedo.pump(base, k, control, **wanted) for k in range(whole.steps)] + [whole]
    rows: list[dict[str, Any]] = []
    curves = []
    grid = plotting.grazing_grid() if grazing else plotting.angle_grid()
    with warnings_as_lines(), compiling(spec), progress("pumping", len(stages)) as advance:
        for k, stage in enumerate(stages):
            found = albedo.directional_albedo(stage, cosines, azimuth, rtol=goal)
            for row in rows_of(str(spec), None, "albedo", found, cosines, angles, phi):
                if row.get("part", "total") == "total":
                    own = {"model": row.pop("model"), "step": k, "control": control or "none"}
                    rows.append({**own, **row})
            if picture is not None:
                drawn = albedo.directional_albedo(stage, grid, azimuth, rtol=max(goal, 1e-6))
                label = f"{spec}, {_said(k, control)}"
                swept = ("steps", float(k))
                curves.append(
                    plotting.Curve(label, spec.name, grid, drawn.value, drawn.error, swept)
                )
            advance(k + 1, len(stages))
    if numbers is not None:
        save_csv(pd.DataFrame(rows), numbers)
        typer.echo(f"{numbers}: {counted(len(rows), 'albedo')}")
    if picture is not None:
        plotting.save_figure(plotting.draw(curves, grazing=grazing), picture)
        typer.echo(f"{picture}: {counted(len(curves), 'curve')}")
    if numbers is None:
        for row in rows:
            row.pop("part", None)
            row["model"] = f"step {row.pop('step')}"
            row.pop("control")
        print_rows(rows)


def _said(steps: int, control: str | None) -> str:
    """Steps and their control in words."""
    kept = f", {control}" if control else ""
    return f"{counted(steps, 'step')}{kept}"


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
    rtol: Annotated[
        float | None,
        typer.Option(
            help="Relative error asked for of the albedos after all steps; by default 1e-8, or "
            "what tables can give."
        ),
    ] = None,
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
    from albedo.operators.asked import check_rtol

    numbers, picture = outputs(output, draw, "radiance.png")
    spec = parse(model)
    if steps == 0 and control is not None:
        raise InputError("--control is how steps are kept; it goes with --steps.")
    if steps == 0 and rtol is not None:
        raise InputError("--rtol is what steps are to be worth; it goes with --steps.")
    check_rtol(rtol, "--rtol")
    wanted = {} if rtol is None else {"goal": rtol}
    cosines, angles = parse_incidence(cos, theta, default="0,15,30,45,60,75,85,89")
    rows: list[dict[str, Any]] = []
    profiles = []
    turn = radians(phi)
    total = spec.count * len(cosines)
    with warnings_as_lines(), compiling(spec), progress("searching", total) as advance:
        for label, base in labelled(spec):
            for number, kind in enumerate(base.by_channel()):
                lobe = albedo.pump(kind, steps, control, **wanted) if steps else kind
                named = label if kind is base else f"{label}, channel {number}"
                for c, angle in zip(cosines.tolist(), angles.tolist(), strict=True):
                    found = peak(lobe, c, turn)
                    own = {"model": named, "steps": steps, "control": control or "none"}
                    rows.append({**own, **_peak_row(angle, c, phi, found)})
                    if picture is not None:
                        view = plotting.view_grid(angle)
                        drawn = plane_radiance(lobe, c, view, phi=turn)
                        name = f"{named}, {angle:.6g}°" if spec.count > 1 else f"{angle:.6g}°"
                        profiles.append((name, view, drawn))
                    advance(min(len(rows), total), total)
    if numbers is not None:
        save_csv(pd.DataFrame(rows), numbers)
        typer.echo(f"{numbers}: {counted(len(rows), 'peak')}")
    if picture is not None:
        title = f"{spec}, {_said(steps, control)}" if steps else str(spec)
        plotting.save_figure(plotting.draw_radiance(profiles, title), picture)
        typer.echo(f"{picture}: {counted(len(profiles), 'curve')}")
    if numbers is None:
        _print_peaks(rows)


def _peak_row(angle: float, cos_theta: float, phi: float, found: Any) -> dict[str, Any]:
    import math

    x, y = float(found.direction[0]), float(found.direction[1])
    return {
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
    table = new_table(*heads, "in mirror direction", "degrees from it", right=True)
    last = None
    for row in rows:
        label, steps = row["model"], row["steps"]
        if steps:
            label += f", {_said(steps, None if row['control'] == 'none' else row['control'])}"
        if last is not None and label != last:
            table.add_section()
        table.add_row(
            "" if label == last else label,
            short(row["theta"]),
            short(row["cos_theta"]),
            format_value(row["peak"], row["peak_error"]),
            f"{row['view_theta']:.4f}",
            f"{row['view_phi']:.4f}",
            format_value(row["at_mirror"], row["at_mirror_error"]),
            "any" if row["direction_error"] > 90.0 else f"{row['from_mirror']:.4f}",
        )
        last = label
    print_table(table)
