"""Is the advice good? Random scenes, judged at places and with ways that no search has seen.

For each scene, a model over part of its default table under a sky, point or round sources, with a
tolerance, the cheapest way is searched for; then it is tested at places drawn anew, and all other
ways at less than half its price are tested too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from albedo import plotting
from albedo.advice import judge
from albedo.studies import Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from albedo.studies import Context

STUDY = Study(name="advice", title="Advice on what a scene needs, judged")

COLORS = {"sky": "#0072B2", "point": "#D55E00", "area": "#009E73"}
MARKERS = {"sky": "o", "point": "s", "area": "^"}


def run(context: Context) -> None:
    """Judge thirty scenes, or three."""
    seeds = range(30) if context.full else range(1, 8, 3)
    context.setting(scenes=len(seeds), seed_unseen=judge.UNSEEN)
    rows = []
    for done, (seed, judged) in enumerate(judge.judge_many(seeds)):
        rows.append({**judge.row_of(seed, judged), "kept": judged.kept})
        context.progress(done + 1, len(seeds), f"scene {seed}")
    frame = pd.DataFrame(rows)
    context.table(
        "scenes",
        frame,
        "Advice on random scenes: errors as shares of what is allowed, at the places of the search "
        "and at unseen ones; prices in nanoseconds, which depend on the machine",
        # Largest errors as shares of the tolerance.
        loose=dict.fromkeys(("verified", "unseen", "share_stated", "share_unseen"), 1e-6),
    )
    fits = frame[frame["ns"].notna()]
    ratio = fits["plain_ns"] / fits["ns"]
    context.note(
        f"Of {len(frame)} scenes {len(fits)} got advice. At unseen places the stated share was "
        f"within the tolerance in {int(fits['kept'].sum())} of them; the least share within was "
        f"{100.0 * fits['share_unseen'].min():.2f} percent, the largest error there "
        f"{fits['unseen'].max():.2f} of what is allowed."
    )
    cheaper = frame[frame["cheaper"] != ""]
    context.note(
        f"An exhaustive search found something that passes at less than half the price in "
        f"{len(cheaper)} of {len(frame)} scenes."
    )
    sky = ratio[fits["light"] == "sky"]
    if len(sky):
        context.note(
            f"Under a sky what is advised costs {sky.median():,.0f} times less than the nested "
            f"quadrature in the median, by prices of one machine."
        )
    context.figure(
        "errors_figure",
        draw(fits),
        "Largest errors at places that advice was not chosen by: at those of its test, and at "
        "unseen ones; 1 is what is allowed.",
    )


def draw(fits: pd.DataFrame) -> Figure:
    """Errors at unseen places over those of the test."""
    floor = 1e-6
    with plotting.style():
        figure, (axes,) = plotting.new_figure(width=5.4, height=4.2)
        for light, color in COLORS.items():
            own = fits[fits["light"] == light]
            axes.plot(
                np.maximum(own["verified"], floor),
                np.maximum(own["unseen"], floor),
                MARKERS[light],
                color=color,
                ms=5,
                label={"sky": "uniform sky", "point": "points", "area": "round sources"}[light],
            )
        ends = np.array([floor, 2.0])
        axes.plot(ends, ends, color="#888888", linewidth=0.9, zorder=0.5)
        axes.axhline(1.0, color="#888888", linewidth=0.9, linestyle="--", zorder=0.5)
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlabel("largest error at the places of the test, share of the tolerance")
        axes.set_ylabel("largest error at unseen places")
        plotting.add_legend(figure, axes)
    return figure
