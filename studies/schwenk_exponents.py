"""By what factor is Blinn's exponent larger than Phong's when their lobes look alike?

The survey says that four times Phong's exponent gives similar results. Here both lobes are 1 at
their peak, for one light at a time, and the best factor is that of the least root mean square
difference over views: those in the plane of incidence, or all by solid angle.

In the plane of incidence N and H are half as far apart as R and V, at any angle of incidence, and
cos(2 delta)^n is cos(delta)^(4 n) for small angles: the best factor is 4 + 5/(4 n) + ... Across
that plane H turns 1/cos(theta) times as fast, which wants 4 cos^2(theta). Over all views narrow
lobes have a best factor in between, the root of an equation of the sixth degree.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

import albedo
from albedo import plotting
from albedo.analysis.lobes import best_factor, narrow_distance, narrow_factor
from albedo.directions import spherical
from albedo.estimate import format_value
from albedo.studies import Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from albedo.brdf import Model
    from albedo.studies import Context

STUDY = Study(
    name="schwenk_exponents",
    title="Blinn's exponent over Phong's",
    paper="S",
    claims=("S3",),
)

READINGS = {"plane": "in the plane of incidence", "all": "over all views"}
EXPONENTS = (1.0, 3.0, 10.0, 30.0, 100.0, 1000.0, 10_000.0)
QUICK_EXPONENTS = (1.0, 10.0, 100.0, 1000.0)
# What counts: lobes that are highlights, at angles that are not grazing.
LEAST, STEEPEST = 10.0, 80.0
# A factor that rounds to four.
WIDTH = 0.5
# Outlines are drawn for this exponent, at these angles.
DRAWN, SHOWN = 100.0, (0.0, 45.0, 70.0)

_DASHES: tuple[Any, ...] = ((0, (1.2, 1.4)), (0, (6, 1.6, 1.2, 1.6)), (0, (6, 2)), "-")
_SHADES = ("#56B4E9", "#009E73", "#0072B2", "#332288")


def run(context: Context) -> None:
    """Best factors over angles and exponents, the verdicts, and what both lobes look like."""
    exponents = EXPONENTS if context.full else QUICK_EXPONENTS
    angles = np.arange(0.0, 85.5, 1.0 if context.full else 5.0)
    context.setting(angles=angles.size, smallest_n=LEAST, steepest_deg=STEEPEST, width=WIDTH)
    rows = []
    for done, n in enumerate(exponents):
        context.progress(done, len(exponents), f"n = {n:g}")
        for views, theta in ((views, theta) for views in READINGS for theta in angles):
            found = best_factor(n, math.cos(math.radians(theta)), views)
            rows.append({"views": views, "n": n, "theta_deg": theta, **vars(found)})
    frame = pd.DataFrame(rows)
    context.table(
        "factors",
        frame,
        "Best factor, and the relative distance of the lobes for it and for the factor 4 (by_rule)",
    )
    cosines = np.cos(np.radians(angles))
    best = [narrow_factor(float(c)) for c in cosines]
    limit = pd.DataFrame(
        {
            "theta_deg": angles,
            "across": 4.0 * cosines**2,
            "best": best,
            "distance": [narrow_distance(c, k) for c, k in zip(cosines, best, strict=True)],
            "by_rule": [narrow_distance(c, 4.0) for c in cosines],
        }
    )
    context.table(
        "narrow_lobes",
        limit,
        "All views in the limit of a large n: the factor that suits the direction across the plane "
        "of incidence, the best one, and distances",
        # Roots of differences that cancel at normal incidence.
        loose={"distance": 1e-7, "by_rule": 1e-7},
    )
    judge(context, frame, limit)
    remark(context, frame, limit)
    context.figure(
        "factors_figure",
        draw_factors(frame, limit),
        "Best factor against the angle of incidence; the grey line is the rule. Over all views "
        "(right) the black line is the limit of narrow lobes and the shade spans what single "
        "directions want, from 4 cos² θ across to 4 along the plane of incidence.",
    )
    context.figure(
        "distances_figure",
        draw_distances(frame, limit),
        "Relative root mean square distance of the two lobes over all views, for the best factor "
        "and for 4.",
    )
    context.figure(
        "outlines_figure",
        draw_outlines(),
        f"Where the lobes are half of their peak, about the mirror direction, for Phong's n = "
        f"{DRAWN:g} at three angles of incidence.",
    )


def counted(frame: pd.DataFrame, views: str) -> pd.DataFrame:
    """Rows of the exponents and angles on which the rule is judged."""
    kept = (frame["views"] == views) & (frame["n"] >= LEAST) & (frame["theta_deg"] <= STEEPEST)
    return frame[kept]


def farthest(frame: pd.DataFrame, views: str) -> pd.Series:
    """The row whose factor is farthest from four."""
    rows = counted(frame, views)
    row: pd.Series = rows.loc[(rows["factor"] - 4.0).abs().idxmax()]
    return row


def at(frame: pd.DataFrame, views: str, n: float, theta: float) -> pd.Series:
    """One row."""
    kept = (frame["views"] == views) & (frame["n"] == n) & (frame["theta_deg"] == theta)
    row: pd.Series = frame[kept].iloc[0]
    return row


def judge(context: Context, frame: pd.DataFrame, limit: pd.DataFrame) -> None:
    """S3, in the plane of incidence and over all views."""
    largest = frame["n"].max()
    for views, reading in READINGS.items():
        row = farthest(frame, views)
        context.claim(
            "S3",
            "Blinn's exponent has to be four times Phong's for similar results.",
            value=row["factor"],
            error=row["factor_error"],
            criterion=f"= 4 +- {WIDTH}",
            quantity=f"best factor, the one farthest from 4 for n from {LEAST:g} to {largest:g} up "
            f"to {STEEPEST:g}°: n = {row['n']:g}, {row['theta_deg']:g}°",
            reading=reading,
        )
    plane, everywhere = (farthest(frame, views) for views in READINGS)
    steep = at(frame, "all", 100.0, 60.0)
    narrow = limit[limit["theta_deg"] == 60.0].iloc[0]
    context.explain(
        "S3",
        "In the plane of incidence the rule is right at every angle, as H turns by half of what V "
        f"does: the best factor is at most {format_value(plane['factor'], plane['factor_error'])} "
        f"for n of {LEAST:g} and more. Out of that plane H turns by 1/(2 cos θ), so that Blinn's "
        "highlight is narrower across by cos θ, and a factor for the whole highlight lies between "
        f"4 cos² θ and 4. At 60° and n = 100 it is "
        f"{format_value(steep['factor'], steep['factor_error'])}, in the limit of narrow lobes "
        f"{narrow['best']:.4f}; the farthest is "
        f"{format_value(everywhere['factor'], everywhere['factor_error'])} at "
        f"{everywhere['theta_deg']:g}°. Near normal incidence both readings agree with the rule.",
    )


def remark(context: Context, frame: pd.DataFrame, limit: pd.DataFrame) -> None:
    """Expansions, and how alike lobes are at best."""
    n = 1000.0
    texts = []
    for views, size in (("plane", "5/4"), ("all", "3/2")):
        row = at(frame, views, n, 0.0)
        value = format_value(n * (row["factor"] - 4.0), n * row["factor_error"])
        texts.append(f"{value} {READINGS[views]}, where the expansion has {size}")
    wide = [at(frame, views, 1.0, 0.0) for views in READINGS]
    context.note(
        f"At normal incidence n (k - 4) is, for n = {n:g}: {'; '.join(texts)}. For n = 1 the best "
        f"factor is {format_value(wide[0]['factor'], wide[0]['factor_error'])} in the plane and "
        f"{format_value(wide[1]['factor'], wide[1]['factor_error'])} over all views."
    )
    rows = [at(frame, "all", 100.0, theta) for theta in (0.0, 30.0, 60.0, 80.0)]
    context.note(
        "How far apart the lobes for n = 100 are over all views, with the best factor and with 4: "
        + "; ".join(
            f"{row['theta_deg']:g}°: {format_value(row['distance'], row['distance_error'])} and "
            f"{format_value(row['by_rule'], row['by_rule_error'])}"
            for row in rows
        )
        + " of the root mean square of Phong's. At large angles no factor makes them similar: "
        "Phong's highlight is round and Blinn's is not."
    )


def shades(exponents: list[float]) -> dict[float, dict[str, Any]]:
    """A look for each of the exponents that are drawn."""
    chosen = [n for n in exponents if n in QUICK_EXPONENTS]
    return {
        n: {"color": _SHADES[k], "linestyle": _DASHES[k], "label": f"n = {n:g}"}
        for k, n in enumerate(chosen)
    }


def draw_factors(frame: pd.DataFrame, limit: pd.DataFrame) -> Figure:
    """Best factors against the angle of incidence, a panel for each reading."""
    with plotting.style():
        figure, panels = plotting.new_figure(2, 7.6, 3.6)
        for axes, (views, reading) in zip(panels, READINGS.items(), strict=True):
            if views == "all":
                axes.fill_between(
                    *(limit["theta_deg"], limit["across"], 4.0),
                    color="#dddddd",
                    alpha=0.55,
                    linewidth=0,
                    zorder=0.5,
                )
            axes.axhline(4.0, color="#888888", linewidth=0.9, zorder=1.5)
            for n, look in shades(sorted(set(frame["n"]))).items():
                rows = frame[(frame["views"] == views) & (frame["n"] == n)]
                axes.plot(rows["theta_deg"], rows["factor"], **look)
            axes.plot(
                limit["theta_deg"],
                limit["best"] if views == "all" else np.full(len(limit), 4.0),
                color="#222222",
                linewidth=1.0,
                label="n → ∞",
            )
            angle_axis(axes)
            axes.set_ylim(0.0, 6.2)
            axes.set_title(reading)
        panels[0].set_ylabel("best factor of the exponents")
        plotting.add_legend(figure, panels[0])
    return figure


def angle_axis(axes: Axes) -> None:
    """Degrees of incidence."""
    axes.set_xlim(0.0, 90.0)
    axes.set_xticks(np.arange(0.0, 91.0, 15.0))
    axes.set_xlabel("angle of incidence (degrees)")


def draw_distances(frame: pd.DataFrame, limit: pd.DataFrame) -> Figure:
    """Distances over all views, for the best factor and for four."""
    with plotting.style():
        figure, panels = plotting.new_figure(2, 7.6, 3.4)
        for axes, column, title in zip(
            panels, ("distance", "by_rule"), ("best factor", "factor 4"), strict=True
        ):
            for n, look in shades(sorted(set(frame["n"]))).items():
                rows = frame[(frame["views"] == "all") & (frame["n"] == n)]
                axes.plot(rows["theta_deg"], rows[column], **look)
            axes.plot(
                *(limit["theta_deg"], limit[column]),
                color="#222222",
                linewidth=1.0,
                label="n → ∞",
            )
            angle_axis(axes)
            axes.set_ylim(0.0, 1.0)
            axes.set_title(title)
        panels[0].set_ylabel("relative distance of the lobes")
        plotting.add_legend(figure, panels[0])
    return figure


def outline(model: Model, theta: float, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A lobe over its peak, x across and y along the plane of incidence, radians from R."""
    light = spherical(math.cos(math.radians(theta)))
    c, s = float(light[2]), float(light[0])
    alpha, psi = np.hypot(x, y), np.arctan2(x, y)
    up, across = np.sin(alpha) * np.cos(psi), np.sin(alpha) * np.sin(psi)
    cosine = np.cos(alpha)
    view = np.stack((-s * cosine + c * up, across, c * cosine + s * up), axis=-1)
    return model.eval(light, view) / model.eval(light, light * np.array([-1.0, -1.0, 1.0]))


def draw_outlines() -> Figure:
    """Half of the peak for both lobes, with four and with the best factor."""
    from matplotlib.lines import Line2D

    reach = 13.0
    degrees = np.linspace(-reach, reach, 241)
    x, y = np.meshgrid(np.radians(degrees), np.radians(degrees))
    with plotting.style():
        figure, panels = plotting.new_figure(len(SHOWN), 8.4, 3.2)
        for axes, theta in zip(panels, SHOWN, strict=True):
            factor = best_factor(DRAWN, math.cos(math.radians(theta))).factor
            lobes: tuple[tuple[Model, Any, Any], ...] = (
                (albedo.model("phong", n=DRAWN), plotting.color("phong"), "-"),
                (albedo.model("blinn", n=4.0 * DRAWN), plotting.color("blinn"), (0, (6, 2))),
                (albedo.model("blinn", n=factor * DRAWN), "#E69F00", (0, (1.2, 1.4))),
            )
            for model, shade, dash in lobes:
                axes.contour(
                    *(degrees, degrees, outline(model, theta, x, y)),
                    levels=[0.5],
                    colors=[shade],
                    linewidths=1.7,
                    linestyles=[dash],
                )
            axes.set_aspect("equal")
            axes.set_title(f"{theta:g}°, best factor {factor:.2f}")
            axes.set_xlabel("across (degrees)")
            axes.set_xticks(np.arange(-10.0, 11.0, 5.0))
            axes.set_yticks(np.arange(-10.0, 11.0, 5.0))
        panels[0].set_ylabel("towards the normal (degrees)")
        names = ("Phong, n", "Blinn, 4 n", "Blinn, best factor")
        extra = [
            Line2D([], [], color=shade, linestyle=dash, label=label)
            for (_, shade, dash), label in zip(lobes, names, strict=True)
        ]
        plotting.add_legend(figure, panels[0], extra)
    return figure
