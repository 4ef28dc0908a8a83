"""Where has a value the fewest right digits, and does a fixed map of places miss it?

For every model hypothesis searches parameters over the whole of their ranges and directions down
to cos = 1e-12, climbing towards where more digits are lost, and the worst case of each way to a
value is kept. Beside it stands the worst of the map of `albedo.analysis.stability`, which sweeps
the model's main parameters through special places.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

import albedo
from albedo import plotting
from albedo.analysis import stability
from albedo.analysis.worst_case import Search, search
from albedo.errors import InputError
from albedo.studies import Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from albedo.studies import Context

STUDY = Study(
    name="stability_search",
    title="The worst case: a search for lost digits",
    paper="S",
)

SEED = 0
EXAMPLES, FEW = 800, 20
"""Cases of one model, each with five views at most, in the full run and in the quick one."""
COUNTED = 1e-14
"""A count of digits is the logarithm of a ratio known to 50: it has its own rounding only."""
MISSED = 1.0
"""The map has missed what loses so many decimal digits more than its worst place."""

LABELS = {
    "float64": "float64, half vector known",
    "raw": "float64, raw directions",
    "float32": "float32",
}


def run(context: Context) -> None:
    """Search all models, count on the map, and say what the map missed."""
    examples = EXAMPLES if context.full else FEW
    context.setting(seed=SEED, examples=examples)
    found, maps, refused = {}, {}, {}
    names = list(albedo.models())[:: 1 if context.full else 4]
    for done, name in enumerate(names):
        context.progress(done, len(names), f"worst case of {name}")
        try:
            found[name] = search(name, examples=examples, seed=SEED)
            maps[name] = on_map(name, full=context.full)
        except InputError as error:
            refused[name] = str(error)
    rows = [case_rows(name, found[name], maps[name]) for name in found]
    cases = pd.concat(rows, ignore_index=True)
    context.table(
        "worst_cases",
        cases,
        "Worst cases of every model, and the worst of the map",
        # Roundings decide where a search climbs to.
        machine=[column for column in cases if column not in ("model", "way")],
    )
    context.figure(
        "worst_cases_figure",
        draw(cases),
        "Decimal digits that are lost at most: by the search (dots) and on the map (bars); the "
        "grey lines are all that there are.",
    )
    context.note(
        f"{len(found)} models, {int(cases['values'].sum())} values counted by the search, "
        f"{int(cases['map_values'].sum())} on the map. Not searched: "
        + ("; ".join(f"{name} ({why})" for name, why in refused.items()) or "none")
        + "."
    )
    for way in stability.WAYS:
        context.note(said(cases[cases["way"] == way], way))
    largest = cases[cases["way"] == "float64"].sort_values("lost").iloc[-1]
    context.note(
        f"With the half vector known no search loses more than {largest['lost']:.1f} digits in "
        f"float64: {largest['model']}, at {largest['place']}, cos θ = {largest['cos_theta']:.3g}, "
        f"where the value is {largest['value']:.3g}."
    )


def on_map(name: str, *, full: bool) -> pd.DataFrame:
    """Digits on the map, over the domain of a model."""
    models = stability.named_models(stability.swept(name))
    if not full:
        models = models[:: max(1, len(models) // 2)]
    cosines = stability.COSINES if full else stability.COSINES[::5]
    return stability.measure(models, cosines=cosines)


def case_rows(name: str, found: Search, frame: pd.DataFrame) -> pd.DataFrame:
    """One row for every way: the worst of the search, and of the map."""
    rows = found.table().rename(columns={"model": "parameters"})
    rows.insert(0, "model", name)
    worst = stability.worst(frame).set_index("way")
    lost = worst["lost"].reindex(rows["way"]).to_numpy()
    counts = [int(frame[way].notna().sum()) for way in rows["way"]]
    wrong = [int(frame[f"{way}_not_finite"].sum()) for way in rows["way"]]
    at = rows.columns.get_loc("lost")
    rows.insert(at + 1, "lost_error", COUNTED)
    rows.insert(at + 2, "map_lost", lost)
    rows.insert(at + 3, "map_lost_error", COUNTED)
    rows["map_values"], rows["map_not_finite"] = counts, wrong
    return rows


def said(rows: pd.DataFrame, way: str) -> str:
    """What the map missed on one way, and what is not a number."""
    more = rows["lost"] - rows["map_lost"]
    missed = rows[more > MISSED].assign(more=more).sort_values("more", ascending=False)
    names = [
        f"{row.model} ({row.lost:.1f} for {row.map_lost:.1f})"
        for row in missed.itertuples(index=False)
    ]
    all_lost = rows[rows["digits"] < 1.0]["model"].tolist()
    wrong = rows[rows["not_finite"] > 0]
    broken = [f"{row.model} ({row.not_finite})" for row in wrong.itertuples(index=False)]
    return (
        f"{LABELS[way]}: the search loses more than {MISSED:g} digit more than the map for "
        f"{len(missed)} of {len(rows)} models"
        + (f": {', '.join(names)}" if names else "")
        + ". Without one right digit: "
        + (", ".join(all_lost) or "none")
        + ". Values that are not finite though the exact one is: "
        + (", ".join(broken) or "none")
        + "."
    )


def draw(cases: pd.DataFrame) -> Figure:
    """One row for every model, one panel for every way."""
    order = cases[cases["way"] == "float64"].sort_values("lost")["model"].tolist()
    with plotting.style():
        figure, panels = plotting.new_figure(3, width=9.6, height=0.2 * len(order) + 1.2)
        for axes, way in zip(panels, stability.WAYS, strict=True):
            rows = cases[cases["way"] == way].set_index("model").reindex(order)
            places = np.arange(len(order))
            axes.hlines(places, 0.0, rows["lost"], color="#BBBBBB", linewidth=0.8, zorder=0.8)
            axes.plot(rows["lost"], places, "o", ms=4, color="#D55E00", label="search")
            axes.plot(rows["map_lost"], places, "|", ms=9, mew=1.6, color="#0072B2", label="map")
            axes.axvline(stability.FULL[way], color="#888888", linewidth=0.9, zorder=0.5)
            axes.set_xlim(-0.03 * stability.FULL[way], 1.05 * stability.FULL[way])
            axes.set_ylim(-0.7, len(order) - 0.3)
            axes.set_yticks(places, order if axes is panels[0] else [])
            axes.set_xlabel("decimal digits lost at most")
            axes.set_title(LABELS[way], loc="left")
            axes.set_xticks(range(0, 8, 2) if way == "float32" else range(0, 17, 4))
        plotting.add_legend(figure, panels[0])
    return figure
