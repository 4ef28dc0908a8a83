"""Does Schwenk's exponent run from about 2 to about 512, and what energy does the model give back?

The survey ends with a model of its own (sect. 4): a diffuse term C and a highlight
s²/(v.h) F(v.h) (n.h)^e, e = 2/(1 + 1/255 - s), of which its author says that it does not conserve
energy. The exponent is read off the model's values here, and "about" is taken as within one
percent. The largest albedo over all directions is mapped over smoothness, metalness and colour, for
the whole model and for its highlight alone. Values J are read as the BRDF J/π, with which the
diffuse term reflects its colour.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

import albedo
from albedo import plotting
from albedo.analysis.energy import energy_map
from albedo.brdf import Model
from albedo.estimate import format_value
from albedo.grammar import parse_model
from albedo.studies import Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from albedo.studies import Context

STUDY = Study(
    name="schwenk_own_model",
    title="Exponent and energy of Schwenk's model",
    paper="S",
    claims=("S14",),
)

ABOUT = 0.01
"""A relative difference that "about" leaves room for."""
ENDS = {0.0: 2.0, 1.0: 512.0}
COLORS_OF = {
    "grey": "0.5",
    "white": "1",
    "gold": "(1,0.77,0.34)",
    "red": "(0.8,0.1,0.05)",
}
# What a quick run looks at.
FEW, QUICK = (0.0, 0.3, 0.6, 0.75, 0.85, 0.95, 1.0), ["grey", "white", "red"]
# A top may be flat, and several channels may have it.
PLACES = {"max_cos_theta": 1.0, "channel": 2.0}
COLORS = {"grey": "#222222", "white": "#0072B2", "gold": "#E69F00", "red": "#D55E00"}


def run(context: Context) -> None:
    """Read the exponent, map the energy, and draw both."""
    rtol = 1e-8 if context.full else 1e-5
    context.setting(rtol=rtol, about=ABOUT)
    exponents = measure_exponents(41 if context.full else 11)
    context.table("exponents", exponents, "The exponent over smoothness, read off values")
    judge_exponents(context, exponents)
    context.progress(1, 4, "the whole model")
    smoothness = np.linspace(0.0, 1.0, 21) if context.full else np.array(FEW)
    sets = (list(COLORS_OF) if context.full else QUICK, smoothness, 3 if context.full else 2)
    whole = energy(1.0, *sets, rtol)
    context.table(
        "energy",
        whole,
        "The largest albedo of all directions, with the diffuse term; the channel that has it",
        loose=PLACES,
    )
    context.progress(2, 4, "the highlight alone")
    lobe = energy(0.0, *sets, rtol)
    context.table(
        "highlight",
        lobe,
        "The largest albedo of all directions of the highlight alone, k_d = 0",
        loose=PLACES,
    )
    judge_energy(context, whole, lobe)
    context.progress(3, 4, "figures")
    context.figure(
        "exponent_figure",
        draw_exponents(exponents),
        "Left: the exponent over smoothness. Right: the albedo of the highlight over the angle of "
        "incidence, C = 1: it is not normalised, and fades as it narrows.",
    )
    context.figure(
        "energy_figure",
        draw_energy(whole, lobe),
        "The largest albedo of all directions and channels over smoothness. Left: the whole model. "
        "Right: its highlight alone. Solid for metals (m = 1), dashed for what is no metal.",
    )


def measure_exponents(count: int) -> pd.DataFrame:
    """Exponents from the highlight of equal v.h and two n.h, and its albedo."""
    rows = []
    # Both pairs of directions have l.v = cos(2 beta), and so v.h and F; only n.h differs.
    beta, tilt = 0.5, 0.3
    for s in np.linspace(0.0, 1.0, count):
        lobe = albedo.model("schwenk", smoothness=max(float(s), 1e-3), k_d=0.0)
        columns: dict[str, Any] = {"smoothness": float(s)}
        measured = exponent_of(lobe, beta, tilt)
        if s == 0.0:
            # At s = 0 the highlight is multiplied by s^2: e follows on the line through 1/e.
            near = exponent_of(lobe.replace(smoothness=2e-3), beta, tilt)
            measured = 1.0 / (2.0 / measured - 1.0 / near)
        error = 1e-10 * measured
        columns |= {"exponent": measured, "exponent_error": error}
        own = albedo.model("schwenk", smoothness=float(s), k_d=0.0)
        normal = albedo.directional_albedo(own, 1.0, rtol=1e-8)
        columns |= {"normal": float(normal.value), "normal_error": float(normal.error)}
        rows.append(columns)
    return pd.DataFrame(rows)


def exponent_of(lobe: Model, beta: float, tilt: float) -> float:
    """The power of n.h that values follow from n.h = 1 to cos(tilt)."""
    c, s = math.cos(beta), math.sin(beta)
    light, view = np.array([s, 0.0, c]), np.array([-s, 0.0, c])
    first = float(lobe.eval(light, view))
    # Turned about the x axis: both directions keep their angle.
    turn = np.array(
        [
            [1.0, 0.0, 0.0],
            [0.0, math.cos(tilt), math.sin(tilt)],
            [0.0, -math.sin(tilt), math.cos(tilt)],
        ]
    )
    second = float(lobe.eval(turn @ light, turn @ view))
    return math.log(second / first) / (0.5 * math.log1p(-(math.sin(tilt) ** 2)))


def judge_exponents(context: Context, frame: pd.DataFrame) -> None:
    """Both ends of the exponent."""
    for s, about in ENDS.items():
        row = frame[frame["smoothness"] == s].iloc[0]
        context.claim(
            "S14",
            f"The exponent is about {about:g} at s = {s:g}.",
            value=float(row["exponent"]),
            error=float(row["exponent_error"]),
            criterion=f"= {about:g} +- {ABOUT * about:g}",
            quantity="exponent of n.h",
            table="exponents",
            figure="exponent_figure",
        )
    last = frame.iloc[-1]
    top = frame.loc[frame["normal"].idxmax()]
    context.note(
        "From 2/(1 + 1/255 - s) the ends are 510/256 and 510: "
        f"{format_value(frame['exponent'].iloc[0], frame['exponent_error'].iloc[0])} and "
        f"{format_value(last['exponent'], last['exponent_error'])} as measured. Exponents are "
        f"distributed unevenly: half of all smoothness lies below e = {4.0 * 255.0 / 257.0:.3g}."
    )
    context.note(
        "The factor s² is all that makes up for the width of the highlight. At normal incidence it "
        f"reflects {format_value(top['normal'], top['normal_error'])} at most (s = "
        f"{top['smoothness']:g}), and {format_value(last['normal'], last['normal_error'])} at "
        "s = 1, C = 1: a smooth surface has nearly no highlight but a diffuse term."
    )


def energy(
    k_d: float, colors: list[str], smoothness: np.ndarray, metals: int, rtol: float
) -> pd.DataFrame:
    """Largest albedos over smoothness, metalness and colour."""
    frames = []
    steps = ",".join(f"{s:.6g}" for s in smoothness)
    for name in colors:
        spec = parse_model(
            f"schwenk:smoothness=[{steps}],metalness=0..1/{metals},color={COLORS_OF[name]},"
            f"k_d={k_d:g}",
            "A map",
        )
        frame = energy_map(spec, rtol).frame
        if "channel" not in frame:
            frame["channel"] = 0
        best = frame.groupby(["smoothness", "metalness"])["max_albedo"].idxmax()
        columns = ["smoothness", "metalness", "channel"]
        columns += ["max_albedo", "max_albedo_error", "max_cos_theta"]
        own = frame.loc[best, columns].reset_index(drop=True)
        own.insert(0, "color", name)
        frames.append(own)
    return pd.concat(frames, ignore_index=True)


def judge_energy(context: Context, whole: pd.DataFrame, lobe: pd.DataFrame) -> None:
    """The model does not conserve energy, whole or without its diffuse term."""
    for frame, what, table in ((whole, "whole model", "energy"), (lobe, "highlight", "highlight")):
        row = frame.loc[frame["max_albedo"].idxmax()]
        context.claim(
            "S14",
            "The model does not conserve energy: some albedo is above 1.",
            value=float(row["max_albedo"]),
            error=float(row["max_albedo_error"]),
            criterion="> 1",
            quantity=f"largest albedo of all settings ({row['color']}, s = "
            f"{row['smoothness']:g}, m = {row['metalness']:g}, n.l = {row['max_cos_theta']:.3g})",
            reading="the whole model" if what == "whole model" else "its highlight alone",
            table=table,
            figure="energy_figure",
        )
        over = frame[frame["max_albedo"] - frame["max_albedo_error"] > 1.0]
        tops = frame.loc[frame.groupby("color", sort=False)["max_albedo"].idxmax()]
        context.note(
            f"The {what} has an albedo above 1 at {len(over)} of {len(frame)} settings. The "
            "largest for each colour: "
            + "; ".join(
                f"{r['color']} {format_value(r['max_albedo'], r['max_albedo_error'])} (s = "
                f"{r['smoothness']:g}, m = {r['metalness']:g})"
                for r in tops.to_dict("records")
            )
            + "."
        )
    normal = lobe[(lobe["metalness"] == 0.0) & (lobe["color"] == "white")]
    top = normal.loc[normal["max_albedo"].idxmax()]
    red = lobe.loc[lobe["max_albedo"].idxmax()]
    context.explain(
        "S14",
        "A diffuse term that reflects C leaves 1 - C for the highlight, whatever its colour. The "
        "highlight takes no part of it away: with k = 0, as by default, J_d is C for every "
        "smoothness, and what is no metal has F0 = 1. The highlight alone reflects "
        f"{format_value(top['max_albedo'], top['max_albedo_error'])} at most for C = 1, of the "
        f"settings looked at (s = {top['smoothness']:g}). A saturated colour can have C' = "
        f"C/lum(C) far above 1, and F0 with it: {red['color']} reaches "
        f"{format_value(red['max_albedo'], red['max_albedo_error'])} by its highlight (s = "
        f"{red['smoothness']:g}, m = {red['metalness']:g}).",
    )


def draw_exponents(frame: pd.DataFrame) -> Figure:
    """The exponent, and what the highlight reflects at normal incidence."""
    with plotting.style():
        figure, (left, right) = plotting.new_figure(2, width=8.6, height=3.5)
        s = np.linspace(0.0, 1.0, 400)
        left.plot(s, 2.0 / (1.0 + 1.0 / 255.0 - s), color="#0072B2", label="2/(1 + 1/255 - s)")
        left.plot(frame["smoothness"], frame["exponent"], "o", color="#222222", ms=4,
                  label="read off values")  # fmt: skip
        left.set_yscale("log", base=2)
        left.set_yticks([2.0**k for k in range(1, 10)], [f"{2**k}" for k in range(1, 10)])
        left.set_ylabel("exponent e")
        degrees = np.linspace(0.0, 89.9, 46)
        cosines = np.sin(np.radians(90.0 - degrees))
        lines = []
        for color, smooth in zip(
            ("#009E73", "#E69F00", "#D55E00", "#AA4499"), (0.4, 0.7, 0.9, 1.0), strict=True
        ):
            model = albedo.model("schwenk", smoothness=smooth, k_d=0.0)
            found = albedo.directional_albedo(model, cosines, rtol=1e-6)
            lines += right.plot(degrees, found.value, color=color, label=f"s = {smooth:g}")
        left.set_xlim(0.0, 1.02)
        left.set_xlabel("smoothness s")
        right.set_xlim(0.0, 90.0)
        right.set_xticks(np.arange(0.0, 91.0, 15.0))
        right.set_ylim(bottom=0.0)
        right.set_xlabel("angle of incidence (degrees)")
        right.set_ylabel("albedo of the highlight, C = 1")
        plotting.add_legend(figure, left, lines)
    return figure


def draw_energy(whole: pd.DataFrame, lobe: pd.DataFrame) -> Figure:
    """Largest albedos over smoothness, by colour."""
    with plotting.style():
        figure, panels = plotting.new_figure(2, width=8.6, height=3.7)
        for axes, frame, title in zip(
            panels, (whole, lobe), ("whole model", "highlight alone"), strict=True
        ):
            for name in frame["color"].unique():
                color = COLORS[name]
                for m, line in ((0.0, "--"), (1.0, "-")):
                    own = frame[(frame["color"] == name) & (frame["metalness"] == m)]
                    axes.plot(
                        *(own["smoothness"], own["max_albedo"]),
                        color=color,
                        linestyle=line,
                        label=name if m == 1.0 else None,
                    )
            axes.axhline(1.0, color="#888888", linewidth=0.9, zorder=1.5)
            axes.set_xlim(0.0, 1.0)
            axes.set_ylim(bottom=0.0)
            axes.set_xlabel("smoothness s")
            axes.set_title(title)
        panels[0].set_ylabel("largest albedo of all directions")
        plotting.add_legend(figure, panels[0])
    return figure
