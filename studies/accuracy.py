"""What does an accuracy cost, and which way to an albedo is the cheapest that has it?

For each model all ways to its directional albedo are timed in one run, beside the largest relative
error that they have at 64 directions: the nested quadrature, a plain rule on angles, Monte Carlo
with draws of the cosine and of the lobe, random and Sobol, tables read linearly and cubically, and
polynomials.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pandas as pd

from albedo import plotting
from albedo.analysis import kernel_cost, pareto
from albedo.grammar import parse
from albedo.studies import Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from albedo.studies import Context

STUDY = Study(name="accuracy", title="What an accuracy costs")

MODELS = {
    "oren_nayar": "Oren-Nayar, σ = 0.3",
    "phong:n=20": "Phong, n = 20",
    "cook_torrance:m=0.3,distribution=ggx,geometry=smith_correlated": "GGX, m = 0.3",
    "ward:m=0.1": "Ward, m = 0.1",
    "ward:m=0.001": "Ward, m = 0.001",
    "ashikhmin_shirley:n=100": "Ashikhmin-Shirley, n = 100",
}
QUICK = ("phong:n=20", "ward:m=0.001")
ERRORS = (1e-2, 1e-4, 1e-6)
STYLES = {
    "nested quadrature": ("#000000", "o"),
    "rule on angles": ("#AA4499", "s"),
    "draws of the cosine": ("#E69F00", "v"),
    "draws of the lobe": ("#D55E00", "^"),
    "Sobol draws of the lobe": ("#CC6677", "D"),
    "linear table": ("#0072B2", "x"),
    "cubic table": ("#56B4E9", "+"),
    "polynomial": ("#009E73", "."),
}


def run(context: Context) -> None:
    """Measure all models, list what is cheapest, and draw fronts."""
    names = list(MODELS) if context.full else list(QUICK)
    directions, repeats = (64, 9) if context.full else (16, 3)
    context.setting(seed=pareto.SEED, directions=directions, repeats=repeats)
    races = {}
    for done, name in enumerate(names):
        context.progress(done, len(names), name)
        races[name] = pareto.prepare(
            parse(name).model(),
            directions=directions,
            stored=("float64", "float32") if context.full else ("float64",),
            evaluations=math.inf if context.full else 2**13,
        )
    frames = {}
    with context.alone():
        for done, (name, race) in enumerate(races.items()):
            context.progress(done, len(names), f"times of {name}")
            frames[name] = race.times(repeats)
    context.progress(len(names), len(names), "")
    first = ["model", "kind", "detail", "ratio", "worst", "mean", "front"]
    whole = pd.concat([frame.assign(model=name) for name, frame in frames.items()])
    others = [column for column in whole if column not in first]
    # Frames are in the order of times, which no two runs share.
    whole = whole.sort_values(["model", "kind", "detail"], kind="stable")
    context.table(
        "ways",
        whole[[*first, *others]],
        "All ways: price as a ratio to the cheapest of the model, and relative errors. "
        "Nanoseconds depend on the machine.",
        machine=("ratio", "front", "ns", "ns_low", "ns_high"),
        # Errors down to roundings, relative to the albedo.
        loose={"worst": 1e-9, "mean": 1e-9},
    )
    best = listed(frames)
    context.table(
        "cheapest",
        best,
        "The cheapest way of every kind to an error, and its price",
        # Which one is cheapest is a matter of times.
        machine=[column for column in best if column not in ("model", "asked")],
    )
    context.figure(
        "fronts_figure",
        draw(frames),
        "Largest relative error of an albedo over angles of incidence up to 85 degrees, against "
        "the time of an entry, of what is best of every kind; lines join what nothing beats. "
        f"Times depend on the machine, here {kernel_cost.processor()}.",
    )
    for sentence in sentences(frames, best):
        context.note(sentence)


def listed(frames: dict[str, pd.DataFrame]) -> pd.DataFrame:
    """The cheapest of every kind for some errors, with ratios to the cheapest of all."""
    found = []
    for name, frame in frames.items():
        for error in ERRORS:
            rows = pareto.cheapest(frame, error)
            rows = rows.assign(model=name, asked=error, ratio=rows["ns"] / rows["ns"].min())
            found.append(rows)
    kept = ["model", "asked", "kind", "detail", "ratio", "ns", "ns_low", "ns_high", "worst"]
    return pd.concat(found)[[*kept, "evaluations", "bytes"]]


def sentences(frames: dict[str, pd.DataFrame], best: pd.DataFrame) -> list[str]:
    """What the numbers say."""
    found = []
    for error in ERRORS:
        rows = best[best["asked"] == error]
        first = rows[rows["ratio"] == 1.0]
        kinds = first["kind"].value_counts()
        said = ", ".join(f"{kind} for {count}" for kind, count in kinds.items())
        nested = rows[rows["kind"] == "nested quadrature"]["ratio"]
        found.append(
            f"To {error:g}, the cheapest of {len(frames)} models: {said}. The nested quadrature "
            f"takes {nested.min():,.0f} to {nested.max():,.0f} times as long as the cheapest."
        )
    for kind in ("rule on angles", "draws of the cosine", "draws of the lobe"):
        missing = [
            MODELS[name]
            for name, frame in frames.items()
            if not (frame[frame["kind"] == kind]["worst"] <= ERRORS[0]).any()
        ]
        largest = max(
            frame[frame["kind"] == kind]["evaluations"].max() for frame in frames.values()
        )
        what = f"{kind.capitalize()}, with up to {largest:,.0f} evaluations:"
        said = f"no error below {ERRORS[0]:g} for {', '.join(missing)}" if missing else ""
        found.append(f"{what} {said or f'errors below {ERRORS[0]:g} for all'}.")
    return found


def draw(frames: dict[str, pd.DataFrame]) -> Figure:
    """Errors over times, a panel for each model."""
    from matplotlib.figure import Figure as NewFigure

    columns = min(3, len(frames))
    rows = -(-len(frames) // columns)
    with plotting.style():
        figure = NewFigure(figsize=(2.75 * columns, 2.5 * rows), layout="constrained")
        panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        for axes, (name, frame) in zip(panels.flat, frames.items(), strict=True):
            for kind, (color, marker) in STYLES.items():
                own = pareto.front(frame[frame["kind"] == kind])
                own = own[own["front"]]
                axes.plot(own["ns"], own["worst"], marker, color=color, ms=5, label=kind, mew=1.2)
            best = frame[frame["front"]].sort_values("ns")
            axes.step(
                best["ns"], best["worst"], where="post", color="#888888", linewidth=0.9, zorder=0.5
            )
            axes.set_xscale("log")
            axes.set_yscale("log")
            axes.set_title(MODELS[name], loc="left")
        for axes in panels[-1]:
            axes.set_xlabel("nanoseconds for an albedo")
        for axes in panels[:, 0]:
            axes.set_ylabel("largest relative error")
        plotting.add_legend(figure, panels[0, 0], columns=4 if columns > 2 else 3)
    return figure
