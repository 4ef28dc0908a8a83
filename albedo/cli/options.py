"""Arguments and options that several commands have, and what reads them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from albedo.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from albedo.grammar import Spec


def complete_model(incomplete: str) -> list[str]:
    from albedo.catalogue import names

    return [name for name in names() if name.startswith(incomplete)]


def complete_study(incomplete: str) -> list[str]:
    found = sorted(path.stem for path in Path("studies").glob("*.py"))
    return [name for name in found if name.startswith(incomplete) and name[0] != "_"]


ModelArgument = Annotated[
    str,
    typer.Argument(
        metavar="MODEL",
        help="A model with its parameters, such as ward:m=0.1; sweeps such as ward:m=0.02..1/32 "
        "or ward:m=[.1,.2,.5] and sums such as 'phong:n=20 + 0.3*lambert' are allowed.",
        autocompletion=complete_model,
    ),
]


OptionalModelArgument = Annotated[
    str | None,
    typer.Argument(
        metavar="MODEL",
        help="A model with its parameters, such as ward:m=0.1; sweeps such as ward:m=0.02..1/32 "
        "or ward:m=[.1,.2,.5] and sums such as 'phong:n=20 + 0.3*lambert' are allowed.",
        autocompletion=complete_model,
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


def _none_as_said(control: str | None) -> str | None:
    """What results call none is no control."""
    return None if control is not None and control.lower() == "none" else control


ControlOption = Annotated[
    str | None,
    typer.Option(
        callback=_none_as_said,
        metavar="none|literal|cumulative",
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
    bool, typer.Option("--full/--quick", help="Full fidelity, which may take long, or quick.")
]


JobsOption = Annotated[
    int | None,
    typer.Option(
        "-j",
        "--jobs",
        help="How many studies run at a time; times are taken while nothing else runs.",
        show_default="as many as there are cores",
    ),
]


AgainOption = Annotated[
    bool, typer.Option("--again", help="Run what did not change since the last run as well.")
]


StudiesDirOption = Annotated[
    Path | None,
    typer.Option("--studies-dir", help="Folder of the studies.", show_default="./studies"),
]


def parse_incidence(
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


def parse_azimuths(phi: str) -> list[float]:
    from albedo.grammar import parse_numbers

    return [float(value) for value in parse_numbers(phi, "--phi")]


def radians(degrees: float) -> float:
    import math

    return math.radians(degrees)


def labelled(spec: Spec) -> Iterator[tuple[str, Any]]:
    """Models with the shortest text that names each: what was written, without the defaults."""
    for single in spec.singles():
        yield str(single), single.model()


def outputs(output: Path | None, draw: bool, default: str) -> tuple[Path | None, Path | None]:
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
        check_output(numbers, (".csv", *plotting.SUFFIXES))
    if picture is not None:
        check_output(picture, plotting.SUFFIXES)
    return numbers, picture
