"""What becomes of Strauss' model at smoothness 1, and where does its albedo leave [0, 1]?

The exponent of the lobe is 3/(1 - s). It is read off the model's values here, at normal incidence,
where every other factor of the lobe is one number, and followed towards s = 1.

Strauss' lighting equation does not multiply the highlight by n.l. As a BRDF the highlight is
divided by it (eq. 46), and what is meant by a BRDF can be J/π, with which the diffuse term reflects
its colour, or J itself. The albedo is measured under both readings: where it first passes 1 on the
way from normal incidence to the horizon, for dielectrics and metals over smoothness. Beside it
stands Cook and Torrance's, whose lobe is as wide.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

import albedo
from albedo import plotting
from albedo.analysis.grazing import first_above_one
from albedo.directions import spherical
from albedo.estimate import format_value
from albedo.studies import Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from albedo.studies import Context

STUDY = Study(
    name="schwenk_strauss",
    title="Smoothness and energy of Strauss' model",
    paper="S",
    claims=("S12",),
)

SMOOTHNESS = (0.0, 0.05, 0.2, 0.4, 0.6, 0.8, 0.95, 0.999)
MORE = (0.02, 0.1, 0.3, 0.5, 0.7, 0.85, 0.9, 0.98, 0.99)
SURFACES = {
    "white plastic": {"metalness": 0.0, "color": 1.0},
    "grey plastic": {"metalness": 0.0, "color": 0.5},
    "white metal": {"metalness": 1.0, "color": 1.0},
    "grey metal": {"metalness": 1.0, "color": 0.5},
}
READINGS = {"brdf": "f = J/π", "literal": "f = J"}
COLORS = ("#0072B2", "#D55E00", "#009E73", "#AA4499")
SMALLEST = 1e-6
"""The smallest cosine that is looked at."""


def run(context: Context) -> None:
    """Follow the exponent to s = 1, find where albedos leave [0, 1], and draw both."""
    rtol = 1e-8 if context.full else 1e-6
    context.setting(rtol=rtol, smallest=SMALLEST)
    exponents = measure_exponents()
    context.table(
        "exponents", exponents, "The exponent of the lobe, and what it reflects, to s = 1"
    )
    judge_exponents(context, exponents)
    context.progress(1, 4, "energy")
    smoothness = tuple(sorted(SMOOTHNESS + (MORE if context.full else ())))
    surfaces = tuple(SURFACES) if context.full else ("white plastic", "grey metal")
    field = leave(surfaces, smoothness, rtol)
    context.table(
        "energy",
        field,
        f"Where albedos first pass 1, and their largest and smallest values down to n.l = "
        f"{SMALLEST:g}",
        # Next to the normal an angle is the root of what its cosine is uncertain by.
        loose={"passes_one_deg": 0.01},
    )
    judge_energy(context, field)
    context.progress(2, 4, "curves")
    curves = beside(rtol)
    context.table("curves", curves, "White metal beside Cook and Torrance's model, F = 1")
    context.progress(3, 4, "figures")
    context.figure(
        "energy_figure",
        draw_energy(field, exponents),
        "Left: the cosine from which on, upwards to grazing incidence, more is reflected than "
        "arrives (f = J/π). "
        "Right: what a white metal reflects at normal incidence; the lobe keeps its height while "
        "it narrows, and nothing is left at s = 1.",
    )
    context.figure(
        "curves_figure",
        draw_curves(curves),
        "White metal of Strauss (solid) and Cook and Torrance's model with a lobe as wide, F = 1 "
        "(dashed). Left in degrees, right in the cosine, towards grazing incidence.",
    )


def measure_exponents() -> pd.DataFrame:
    """Exponents from values, and albedos at normal incidence, towards s = 1."""
    rows = []
    up = np.array([0.0, 0.0, 1.0])
    for s in (0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 0.95, 0.98, 0.99, 0.995, 0.998, 0.999):
        # A black plastic has no diffuse term and a white highlight.
        model = albedo.model("strauss", smoothness=s, metalness=0.0, color=0.0)
        angle = 0.7 * math.sqrt(1.0 - s)
        view = spherical(math.cos(angle), 0.0)
        ratio = float(model.eval(up, view)) / float(model.eval(up, up))
        measured = math.log(ratio) / (0.5 * math.log1p(-(math.sin(angle) ** 2)))
        metal = albedo.model("strauss", smoothness=s, metalness=1.0, color=1.0)
        found = albedo.directional_albedo(metal, 1.0, rtol=1e-10)
        rows.append(
            {
                "smoothness": s,
                "exponent": measured,
                # The cosine of the view is rounded; it is farther than 1e-4 from 1.
                "exponent_error": 1e-11 * measured,
                "normal_albedo": float(found.value),
                "normal_albedo_error": float(found.error),
                "lobe_share": float(found.parts["specular"].value),
                "lobe_share_error": float(found.parts["specular"].error),
            }
        )
    return pd.DataFrame(rows)


def judge_exponents(context: Context, frame: pd.DataFrame) -> None:
    """The power of 1/(1 - s) that the exponent follows."""
    first, last = frame[frame["smoothness"] == 0.9].iloc[0], frame.iloc[-1]
    decades = math.log((1.0 - first["smoothness"]) / (1.0 - last["smoothness"]))
    power = math.log(last["exponent"] / first["exponent"]) / decades
    error = (
        first["exponent_error"] / first["exponent"] + last["exponent_error"] / last["exponent"]
    ) / decades
    context.claim(
        "S12",
        "The model is singular at smoothness 1: the exponent of its lobe grows without limit.",
        value=power,
        error=error,
        criterion="> 0",
        quantity="the power of 1/(1 - s) that the exponent follows from s = 0.9 to 0.999",
        table="exponents",
        figure="energy_figure",
    )
    context.note(
        f"Towards s = 1 the exponent grows as 1/(1 - s) to the power {format_value(power, error)}; "
        f"at s = {last['smoothness']:g} it is "
        f"{format_value(last['exponent'], last['exponent_error'])}. The lobe is not normalised and "
        "keeps its height: a white metal reflects "
        f"{format_value(last['normal_albedo'], last['normal_albedo_error'])} of light at normal "
        f"incidence there, which falls as 2 (1 - s)/3. So the limit is no mirror but a surface "
        "that is black except near grazing incidence, and at s = 1 itself 3/(1 - s) is no number."
    )


def leave(surfaces: tuple[str, ...], smoothness: tuple[float, ...], rtol: float) -> pd.DataFrame:
    """Where albedos leave [0, 1] on the way to the horizon."""
    wide = np.cos(np.radians(np.arange(0.0, 89.0, 4.0)))
    cosines = np.concatenate((wide, np.geomspace(0.02, SMALLEST, 10)))
    rows: list[dict[str, Any]] = []
    for reading in READINGS:
        for surface in surfaces:
            for s in smoothness:
                model = albedo.model("strauss", smoothness=s, reading=reading, **SURFACES[surface])
                found = albedo.directional_albedo(model, cosines, rtol=rtol)
                crossing = first_above_one(model, cosines, found)
                top, low = int(np.argmax(found.value)), int(np.argmin(found.value))
                cosine, width = (math.nan, math.nan) if crossing is None else crossing
                rows.append(
                    {
                        "reading": READINGS[reading],
                        "surface": surface,
                        "smoothness": s,
                        "passes_one_at": cosine,
                        "passes_one_at_error": width,
                        "passes_one_deg": 90.0 - math.degrees(math.asin(cosine))
                        if crossing
                        else math.nan,
                        "largest": found.value[top],
                        "largest_error": found.error[top],
                        "largest_at_cos": cosines[top],
                        "smallest": found.value[low],
                        "smallest_error": found.error[low],
                    }
                )
    return pd.DataFrame(rows)


def judge_energy(context: Context, field: pd.DataFrame) -> None:
    """Under both readings albedos pass one."""
    for reading in READINGS.values():
        own = field[field["reading"] == reading]
        row = own.loc[own["largest"].idxmax()]
        context.claim(
            "S12",
            "The model does not conserve energy: its albedo leaves [0, 1].",
            value=float(row["largest"]),
            error=float(row["largest_error"]),
            criterion="> 1",
            quantity=f"largest albedo down to n.l = {SMALLEST:g} ({row['surface']}, s = "
            f"{row['smoothness']:g})",
            reading=reading,
            table="energy",
            figure="energy_figure",
        )
        over = own[own["passes_one_at"].notna()]
        first = over.loc[over["passes_one_deg"].idxmin()]
        late = over.loc[over["passes_one_deg"].idxmax()]
        context.note(
            f"With {reading} the albedo passes 1 at {len(over)} of {len(own)} settings: earliest "
            f"at {first['passes_one_deg']:.4g}° ({first['surface']}, s = "
            f"{first['smoothness']:g}), latest at {late['passes_one_deg']:.6g}° "
            f"({late['surface']}, s = {late['smoothness']:g}). The smallest albedo is "
            f"{own['smallest'].min():.3g}: none is negative."
        )
    context.note(
        "For s > 0 the lobe's r_n = s³ is divided by n.l, and towards the horizon half of the lobe "
        "is still above it: the albedo grows as 1/n.l without limit. At s = 0 the lobe is made of "
        "0.1 F G G alone, which vanishes at the horizon as fast as n.l."
    )


def beside(rtol: float) -> pd.DataFrame:
    """Albedos of white metal and of Cook and Torrance's model with a lobe as wide."""
    degrees = np.concatenate((np.linspace(0.0, 84.0, 29), 90.0 - np.geomspace(5.0, 1e-3, 22)))
    cosines = np.sin(np.radians(90.0 - degrees))
    frames = []
    for s in (0.6, 0.8, 0.95):
        e = 3.0 / (1.0 - s)
        # About r = n both lobes are Gaussian: (r.v)^e at twice the angle of the half vector.
        m = 1.0 / math.sqrt(2.0 * e)
        columns: dict[str, Any] = {"smoothness": s, "m": m}
        columns |= {"theta_deg": degrees, "cos_theta": cosines}
        for model in (
            albedo.model("strauss", smoothness=s, metalness=1.0),
            albedo.model("cook_torrance", m=m),
        ):
            found = albedo.directional_albedo(model, cosines, rtol=rtol)
            columns |= {model.name: found.value, f"{model.name}_error": found.error}
        frames.append(pd.DataFrame(columns))
    return pd.concat(frames, ignore_index=True)


def draw_energy(field: pd.DataFrame, exponents: pd.DataFrame) -> Figure:
    """Where one is passed, and what is left at normal incidence."""
    with plotting.style():
        figure, (left, right) = plotting.new_figure(2, width=8.6, height=3.7)
        own = field[field["reading"] == READINGS["brdf"]]
        for surface, group in own.groupby("surface", sort=False):
            k = list(SURFACES).index(str(surface))
            seen = group[group["passes_one_at"].notna()]
            left.plot(
                *(seen["smoothness"], seen["passes_one_at"]),
                color=COLORS[k],
                linestyle="-" if k < 2 else "--",
                marker="o" if k < 2 else "s",
                ms=3.5,
                label=str(surface),
            )
        left.set_xlim(0.0, 1.01)
        left.set_yscale("log")
        left.set_ylim(1.5, 1e-6)
        left.set_xlabel("smoothness s")
        left.set_ylabel("n.l where the albedo passes 1")
        rest = 1.0 - exponents["smoothness"]
        lines = []
        for column, name, line in (("normal_albedo", "all", "-"), ("lobe_share", "lobe", "--")):
            seen = exponents[column] > 0.0
            lines += right.plot(
                *(rest[seen], exponents[column][seen]),
                color="#222222",
                linestyle=line,
                marker="o",
                ms=3.5,
                label=f"white metal, normal incidence: {name}",
            )
        right.set_xscale("log")
        right.set_yscale("log")
        right.set_xlim(1.2, 7e-4)
        right.set_ylim(3e-4, 1.5)
        right.set_xlabel("1 - s (smoother to the right)")
        right.set_ylabel("albedo")
        plotting.add_legend(figure, left, lines, columns=2)
    return figure


def draw_curves(curves: pd.DataFrame) -> Figure:
    """Both models over the angle, and over the cosine."""
    with plotting.style():
        figure, (left, right) = plotting.new_figure(2, width=8.6, height=3.7)
        for color, (s, own) in zip(COLORS, curves.groupby("smoothness"), strict=False):
            m = own["m"].iloc[0]
            for axes, x in ((left, "theta_deg"), (right, "cos_theta")):
                axes.plot(own[x], own["strauss"], color=color, label=f"Strauss, s = {s:g}")
                axes.plot(
                    *(own[x], own["cook_torrance"], "--"),
                    color=color,
                    label=f"Cook-Torrance, m = {m:.3g}",
                )
        left.set_xlim(0.0, 90.0)
        left.set_xticks(np.arange(0.0, 91.0, 15.0))
        left.set_ylim(0.0, 2.0)
        left.set_xlabel("angle of incidence (degrees)")
        left.set_ylabel("albedo")
        right.set_xscale("log")
        right.set_yscale("log")
        right.set_xlim(1.0, float(curves["cos_theta"].min()))
        right.set_xlabel("cosine of the angle (grazing to the right)")
        for axes in (left, right):
            axes.axhline(1.0, color="#888888", linewidth=0.9, zorder=1.5)
        plotting.add_legend(figure, left, columns=3)
    return figure
