"""How many digits of a BRDF are right at its extremes, and what do formulas as printed lose?

Every model is evaluated over its domain of roughness or exponent, from normal incidence to
cos = 1e-12 and at special directions, in float64, from raw directions and in float32, and compared
with the same formula in 50 digits. Lobes as the papers print them, in cosines, stand beside those
in slopes.
"""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

import albedo
from albedo import plotting
from albedo.analysis import stability
from albedo.analysis.precise import evaluate, precise
from albedo.analysis.printed import FORMULAS
from albedo.errors import InputError
from albedo.estimate import format_value
from albedo.grammar import parse
from albedo.studies import Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from albedo.studies import Context

STUDY = Study(
    name="stability",
    title="Digits that are right at the extremes",
    paper="S",
    claims=("S13", "S17"),
)

COUNTED = 1e-14
"""A count of digits is the logarithm of a ratio known to 50: it has its own rounding only."""
SUFFERS = 2.0
"""A formula that loses more decimal digits than this suffers numerically."""

ALWAYS = ("ward", "ward_bounded")
"""Of all models a quick run counts every fourth, and these, which claims are about."""

WIDTHS = (0.1, 1e-2, 1e-3, 1e-4, 1e-6, 1e-8)
LABELS = {
    "float64": "float64, half vector known",
    "raw": "float64, raw directions",
    "float32": "float32",
}


def run(context: Context) -> None:
    """Count digits of all models, then of formulas as printed, and judge the claims."""
    context.setting(digits_of_reference=50)
    frames, refused = all_models(context)
    summary = pd.concat(
        [stability.worst(frame).assign(model=name) for name, frame in frames.items()]
    )
    first = ["model", "way", "median", "worst", "lost", "place", "cos_theta", "phi_deg"]
    others = [column for column in summary if column not in first]
    # Counts of digits are logarithms of roundings, and those of library functions differ.
    context.table(
        "models",
        summary[[*first, *others]],
        "Fewest digits of every model, and where they are",
        machine=[c for c in summary if c not in ("model", "way", "median", "worst", "lost")],
        loose={"median": 0.5, "worst": 1.0, "lost": 1.0},
    )
    counts = {name: stability.not_finite(frame) for name, frame in frames.items()}
    wrong = {name: count for name, count in counts.items() if count}
    context.figure(
        "models_figure",
        draw_models(frames),
        "Right digits of all models: the fewest of all places (dots) and the median (bars); the "
        "grey lines are all that float32 and float64 have.",
    )
    ward = stability.swept("ward")
    context.figure(
        "ward_figure",
        stability.draw(frames["ward"], "m", stability.title_of(ward)),
        "Right digits of Ward's model over its width and the incidence, fewest of all places.",
    )
    printed = formulas(context)
    context.figure(
        "printed_figure",
        draw_printed(printed),
        "Digits that formulas as printed lose (solid) and the same lobes in slopes (dashed), from "
        "raw directions in float64, and in float32.",
    )
    context.note(
        f"{len(frames)} models, {sum(len(frame) for frame in frames.values())} values; "
        + (f"not finite: {wrong}. " if wrong else "all of them finite where the exact value is. ")
        + "Not counted: "
        + ("; ".join(f"{name} ({why})" for name, why in refused.items()) or "none")
        + "."
    )
    judge_rational_lobes(context, printed)
    judge_denominators(context, frames)


def all_models(context: Context) -> tuple[dict[str, pd.DataFrame], dict[str, str]]:
    """Digits of every model over its domain, and why models have none."""
    names = list(albedo.models())
    if not context.full:
        names = [name for k, name in enumerate(names) if k % 4 == 0 or name in ALWAYS]
    cosines = stability.COSINES if context.full else stability.COSINES[::3]
    frames, refused = {}, {}
    for done, name in enumerate(names):
        context.progress(done, len(names), f"digits of {name}")
        models = stability.named_models(stability.swept(name))
        if not context.full:
            models = models[:: max(1, len(models) // 4)]
        try:
            frames[name] = stability.measure(models, cosines=cosines)
        except InputError as error:
            refused[name] = str(error)
    return frames, refused


def formulas(context: Context) -> pd.DataFrame:
    """Digits lost by formulas as printed and by the models, within two and a half widths."""
    rows = []
    for label, printed in FORMULAS.items():
        for m in (m for m in WIDTHS if m >= printed.narrowest):
            context.progress(0, 1, f"{label} as printed, width {m:g}")

            naive = albedo.model_from(partial(printed.function, m=m), lobe="half", width=m)
            for form, model in (("printed", naive), ("slopes", parse(printed.spec(m)).model())):
                found = stability.measure([({}, model)], cosines=(0.9, 0.5, 0.1))
                near = found[found["place"].str.contains("widths|mirror")]
                lost = stability.worst(near).set_index("way")["lost"]
                rows.append(
                    {
                        "formula": label,
                        "form": form,
                        "width": m,
                        **{f"lost_{way}": float(lost.get(way, math.nan)) for way in LABELS},
                    }
                )
    frame = pd.DataFrame(rows)
    context.table(
        "printed",
        frame,
        "Digits lost near the peak by formulas as printed",
        loose={f"lost_{way}": 1.0 for way in LABELS},
    )
    return frame


def judge_rational_lobes(context: Context, printed: pd.DataFrame) -> None:
    """S13: as printed, and in slopes."""
    rows = printed[(printed["formula"] == "Schlick's Z") & (printed["width"] == 1e-2)]
    rows = rows.set_index("form")
    for form, said in (("printed", "the formula as printed"), ("slopes", "the function itself")):
        context.claim(
            "S13",
            "Schlick's rational lobe suffers numerically in float32.",
            value=float(rows.loc[form, "lost_float32"]),
            error=COUNTED,
            criterion=f"> {SUFFERS:g}",
            quantity="decimal digits lost near the peak, of 7.2, for r = 1e-4",
            reading=said,
            figure="printed_figure",
            table="printed",
        )
    lost = rows["lost_float32"]
    context.explain(
        "S13",
        "Near its peak Z = r/(1 - (1 - r) t²)² has a denominator of the order of r, the difference "
        "of 1 and a number near 1: rounding t = n.h to float32, by 6e-8, changes it by 1.2e-7, "
        "which for r = 1e-4 is a relative 1e-3, and the square doubles that. "
        f"{lost['printed']:.1f} digits of 7.2 are lost. So the warning is right for the formula. "
        "It is not the function that suffers: with the slope of H, s² = (1 - t²)/t², which the "
        "components of an unnormalised H give without a difference, "
        "Z = ((1 + s²)/(r + s²))² r, all terms positive, and "
        f"{lost['slopes']:.1f} digits are lost.",
    )


def judge_denominators(context: Context, frames: dict[str, pd.DataFrame]) -> None:
    """S17: 1/(n.l n.v), and the corner of 1/max(n.l, n.v)."""

    def lost(name: str) -> pd.Series:
        frame = frames[name]
        near = frame["place"].str.contains("widths|mirror") & (frame["cos_theta"] <= 1e-3)
        return stability.worst(frame[near]).set_index("way")["lost"]

    least, undivided = lost("ward"), lost("ward_bounded")
    for way in ("float64", "float32"):
        context.claim(
            "S17",
            f"Dividing by sqrt(n.l n.v) costs Ward's model digits near 90 degrees, in {way}.",
            value=float(least[way]),
            error=COUNTED,
            criterion=f"> {SUFFERS:g}",
            quantity="decimal digits lost in the lobe, m = 1e-8 to 10, cos θ = 1e-3 to 1e-12",
            figure="ward_figure",
            table="models",
        )
    # The same at every incidence, and from longer differences.
    jumps = [slope_jump(c, step) for c in (0.5, 0.1, 1e-3, 1e-6) for step in (1e-20, 1e-18)]
    spread = max(abs(jump - jumps[0]) for jump in jumps) + float(np.finfo(float).eps)
    context.claim(
        "S17",
        "The derivative of f = 1/max(n.l, n.v) jumps where both are the same.",
        value=jumps[0],
        error=spread,
        criterion="> 0",
        quantity="jump of d ln f/d(n.v), times n.l",
        figure="ward_figure",
        table="models",
    )
    context.explain(
        "S17",
        "A product, a root and a quotient are each rounded correctly, so 1/sqrt(n.l n.v) has a "
        "relative error of a few roundings however small the cosines: it grows without bound, but "
        "does not cancel, and at cosines down to 1e-12 it is far from overflow in float32 too. "
        f"Ward's model loses {least['float64']:.1f} digits in float64 and {least['float32']:.1f} "
        "in float32 at most, and its bounded form, which has the same exponential and no such "
        f"division, {undivided['float64']:.1f} and {undivided['float32']:.1f}. Trouble there is "
        "where a cosine is 0 or already wrong: n.l from a dot product of rounded vectors has an "
        "absolute error of 1e-7 in float32, all of a cosine of 1e-7. And f is unbounded, which a "
        "frame buffer may not hold. The other half of the statement is right: 1/max(n.l, n.v) is "
        "finite but where both vanish, and the relative derivative jumps by "
        f"{format_value(jumps[0], spread)}/(n.l) where they are the same.",
    )
    context.note(
        f"In its lobe Ward's model, which divides by sqrt(n.l n.v), loses {least['float64']:.1f} "
        f"digits in float64 and {least['float32']:.1f} in float32 at most, from cos θ = 1e-3 to "
        "1e-12 and m = 1e-8 to 10. What max(n.l, n.v) costs is a corner: the relative derivative "
        f"jumps by {format_value(jumps[0], spread)}/(n.l), at cos θ = 0.5 to 1e-6."
    )


def slope_jump(c: float, length: float) -> float:
    """n.l times the jump of d ln f/d(n.v) at n.v = n.l, from differences in 50 digits."""
    exact = precise()
    # At exponent 0 the lobe is constant, and the maximum is all that is left.
    model = albedo.model("max_phong", n=0.0)
    f, step = exact.functions, exact.number(length)
    z = exact.number(c)

    def value(height: Any) -> Any:
        light = np.array([[f["sqrt"](1 - z * z), exact.number(0.0), z]], object)
        view = np.array([[-f["sqrt"](1 - height * height), exact.number(0.0), height]], object)
        return f["log"](evaluate(model, exact, light, view, light + view)[0])

    below, here, above = value(z - step), value(z), value(z + step)
    return float(((here - below) - (above - here)) / step * z)


def draw_models(frames: dict[str, pd.DataFrame]) -> Figure:
    """One row for every model."""
    names = sorted(frames, key=lambda name: -frames[name]["float64"].min())
    looks = {"float64": ("#0072B2", 0.25), "raw": ("#E69F00", 0.0), "float32": ("#D55E00", -0.25)}
    with plotting.style():
        figure, (axes,) = plotting.new_figure(height=0.24 * len(names) + 0.9)
        for way, (color, shift) in looks.items():
            rows = np.arange(len(names)) + shift
            least = [frames[name][way].min() for name in names]
            middle = [frames[name][way].median() for name in names]
            axes.hlines(rows, least, middle, color=color, linewidth=1.0)
            axes.plot(least, rows, "o", ms=4, color=color, label=LABELS[way])
            axes.plot(middle, rows, "|", ms=7, color=color)
        for all_digits in (-math.log10(2.0**-24), -math.log10(2.0**-53)):
            axes.axvline(all_digits, color="#888888", linewidth=0.9, zorder=0.5)
        axes.set_yticks(range(len(names)), names)
        axes.set_xlim(-0.4, 16.6)
        axes.set_ylim(-0.7, len(names) - 0.3)
        axes.set_xlabel("right decimal digits: fewest (dot) to median (bar)")
        plotting.add_legend(figure, axes)
    return figure


def draw_printed(printed: pd.DataFrame) -> Figure:
    """Digits lost over the width, as printed and in slopes."""
    with plotting.style():
        figure, panels = plotting.new_figure(2, width=8.2, height=3.7)
        colors = ("#0072B2", "#D55E00", "#009E73", "#AA4499")
        for axes, way in zip(panels, ("raw", "float32"), strict=True):
            for color, label in zip(colors, FORMULAS, strict=True):
                for form, line in (("printed", "o-"), ("slopes", "s--")):
                    rows = printed[(printed["formula"] == label) & (printed["form"] == form)]
                    said = f"{label}, {'as printed' if form == 'printed' else 'in slopes'}"
                    lost = rows[f"lost_{way}"]
                    axes.plot(rows["width"], lost, line, ms=3.5, color=color, label=said)
            axes.set_xscale("log")
            axes.invert_xaxis()
            axes.set_xlabel("width of the lobe")
            axes.set_title(LABELS[way], loc="left")
        panels[0].set_ylabel("decimal digits lost near the peak")
        plotting.add_legend(figure, panels[0])
    return figure
