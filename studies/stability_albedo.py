"""How many digits of an albedo are right, in float64, in float32, and with lobes as printed?

Albedos are integrals of the values whose digits `stability` counts. Those of the quadrature are
held against golden values, and over the domain of every model the default tolerance against 1e-12,
whose own digits are those that its bound promises. Then all values of a BRDF are computed in single
precision on the nodes of the quadrature, and lobes as papers print them, in cosines, stand beside
those in slopes.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

import albedo
from albedo import plotting
from albedo.analysis import albedo_digits, stability
from albedo.analysis.printed import FORMULAS
from albedo.errors import InputError
from albedo.grammar import parse
from albedo.quadrature import albedo_rows
from albedo.studies import Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from albedo.brdf import Model
    from albedo.studies import Context

STUDY = Study(
    name="stability_albedo",
    title="Digits of albedos",
)

GOLDEN = Path(__file__).parent.parent / "tests" / "golden"
"""Where the references are; see README.md there."""
FILES = ("albedo.csv", "albedos.csv")

ALWAYS = ("lambert", "phong", "ward", "cook_torrance", "ashikhmin_shirley")
"""Of all models a quick run counts every fourth, and these."""

WIDTHS = tuple(10.0 ** (-k / 2) for k in range(2, 17))
"""Widths of lobes as printed."""
INCIDENCE = 0.5
"""Cosine of the angle of incidence of lobes as printed."""
LEAST, TOP = 1e-16, 1e2
"""Relative errors beyond these are drawn at them, and so are sums that are not finite."""
WRONG = 0.01
"""An albedo that is off by more is wrong for any use."""
SEVERAL = 6.0
"""Digits of float32, of 7.2, that one may expect of a sum."""

LOOKS = {
    "default": ("tolerance 1e-8", "#0072B2", 0.25),
    "fine": ("tolerance 1e-12, by its bound", "#009E73", 0.0),
    "float32": ("values in float32", "#D55E00", -0.25),
}
COLORS = ("#0072B2", "#D55E00", "#009E73", "#AA4499")
FORMS = {"printed": "as printed", "raw": "in slopes, raw directions", "known": "in slopes, h known"}


def run(context: Context) -> None:
    """Count against golden values, then over all domains, then for lobes as printed."""
    context.setting(rtol=albedo_digits.DEFAULT, rtol_fine=albedo_digits.FINE)
    golden(context)
    frames = all_models(context)
    summary = pd.concat(
        [albedo_digits.worst(frame).assign(model=name) for name, frame in frames.items()]
    )
    first = ["model", "way", "median", "worst", "lost", "cos_theta", "phi_deg", "albedo"]
    others = [c for c in summary if c not in (*first, "albedo_error")]
    summary = summary.reset_index(drop=True)
    context.table(
        "models",
        summary[[*first, "albedo_error", *others]],
        "Fewest digits of the albedos of every model, and where they are",
        # Digits are logarithms of roundings, and those of library functions differ.
        machine=[*others, "cos_theta", "phi_deg", "albedo", "albedo_error"],
        loose={"median": 0.5, "worst": 1.0, "lost": 1.0},
    )
    context.figure(
        "models_figure",
        draw_models(frames),
        "Right digits of the albedos of all models: fewest (dots) and median (bars) over the "
        "domain and the incidence; the grey lines are all that float32 and float64 have.",
    )
    for way, said in (("default", "at the default tolerance"), ("float32", "of values in float32")):
        context.figure(
            f"{way}_figure",
            draw_maps(frames, way),
            f"Right digits of albedos {said}, over the main parameter of every model, or of the "
            "worst of the others, and the cosine of the angle of incidence.",
        )
    conclude(context, frames)
    printed(context)


# Golden values -----------------------------------------------------------------------------------


def references(every: int) -> Iterator[tuple[str, float, float, Decimal, int]]:
    """Model, cosine, azimuth, albedo and digits of the golden values."""
    for name in FILES:
        path = GOLDEN / name
        if not path.is_file():
            raise InputError(
                f"'{path}' is missing; this study reads the golden values of the project"
            )
        with path.open(encoding="utf-8", newline="") as file:
            for k, row in enumerate(csv.DictReader(file)):
                if k % every == 0:
                    where = float(row["cos_theta"]), float(row["phi"])
                    yield row["model"], *where, Decimal(row["value"]), int(row["digits"])


def golden(context: Context) -> None:
    """What the quadrature gives at both tolerances, against golden values."""
    built: dict[str, Model] = {}
    rows = []
    wanted = list(references(1 if context.full else 24))
    for done, (text, c, phi, value, known) in enumerate(wanted):
        if done % 50 == 0:
            context.progress(done, len(wanted), "golden albedos")
        model = built.setdefault(text, parse(text).model())
        slack = float(abs(value)) * 10.0**-known
        row: dict[str, object] = {"model": model.name, "spec": text, "cos_theta": c, "phi": phi}
        for way, rtol in (("default", albedo_digits.DEFAULT), ("fine", albedo_digits.FINE)):
            found = albedo_rows([model], np.array([c]), np.array([phi]), rtol=rtol, atol=0.0)
            got = float(found.value[0])
            off = float(abs(Decimal(got) - value))
            row[way] = albedo_digits.right_digits(got, value, slack)
            row[f"{way}_over_bound"] = max(off - slack, 0.0) / float(found.error[0])
        rows.append(row)
    frame = pd.DataFrame(rows)
    summary = []
    for name, own in frame.groupby("model"):
        entry: dict[str, object] = {"model": name, "golden": len(own)}
        for way in ("default", "fine"):
            at = own.loc[own[way].idxmin()]
            entry |= {f"{way}_fewest": at[way], f"{way}_median": own[way].median()}
            entry |= {f"{way}_at": at["spec"], f"{way}_cos_theta": at["cos_theta"]}
        summary.append(entry)
    counts = pd.DataFrame(summary)
    context.table(
        "golden",
        counts,
        "Digits of albedos against golden values",
        machine=[c for c in counts if c.endswith(("_at", "_cos_theta"))],
        loose={c: 1.0 for c in counts if c.endswith(("_fewest", "_median"))},
    )
    outside = int((frame[["default_over_bound", "fine_over_bound"]] > 1.0).sum().sum())
    at_least = {}
    for way in ("default", "fine"):
        at = frame.loc[frame[way].idxmin()]
        at_least[way] = (
            f"{at[way]:.1f} digits at least ({at['spec']} at cos θ = {at['cos_theta']:g})"
        )
    context.note(
        f"Against {len(frame)} golden albedos of {frame['model'].nunique()} models the default "
        f"tolerance gives {at_least['default']} and {frame['default'].median():.1f} in the "
        f"median; 1e-12 gives {at_least['fine']} and {frame['fine'].median():.1f} in the median. "
        + (
            f"{outside} values are farther off than their bounds."
            if outside
            else "All are within their bounds."
        )
    )


# Domains -----------------------------------------------------------------------------------------


def all_models(context: Context) -> dict[str, pd.DataFrame]:
    """Digits of every model over its domain; those whose values are no kernels are named."""
    names = list(albedo.models())
    if not context.full:
        names = [name for k, name in enumerate(names) if k % 4 == 0 or name in ALWAYS]
    frames: dict[str, pd.DataFrame] = {}
    refused = {}
    cosines = albedo_digits.COSINES if context.full else (0.7, 1e-3)
    rtol = 1e-8 if context.full else 1e-4
    for done, name in enumerate(names):
        context.progress(done, len(names), f"albedos of {name}")
        models = stability.named_models(stability.swept(name))
        if not context.full:
            models = models[:: max(1, len(models) - 1)]
        try:
            frames[name] = albedo_digits.measure(models, cosines=cosines, rtol=rtol)
        except InputError as error:
            refused[name] = str(error)
    rows = together(frames)
    context.table(
        "digits",
        in_words(rows),
        "Digits of all albedos",
        # What is beside digits are errors of single precision and counts of nodes.
        machine=("parameters", "inputs", "operations", "nodes", "not_finite", "beyond"),
        loose=dict.fromkeys(LOOKS, 1.0),
        digits=dict.fromkeys(LOOKS, 4) | dict.fromkeys(("parameters", "inputs", "operations"), 3),
    )
    context.note(
        f"{len(frames)} models, {len(rows)} albedos over their domains. Not counted: "
        + ("; ".join(f"{name} ({why})" for name, why in refused.items()) or "none")
        + "."
    )
    return frames


def together(frames: dict[str, pd.DataFrame]) -> pd.DataFrame:
    """All rows, with the model first."""
    rows = pd.concat([frame.assign(model=name) for name, frame in frames.items()])
    first = next(iter(frames.values()))
    measured = list(first.columns[first.columns.get_loc("cos_theta") :])
    swept = [c for c in rows if c not in ("model", *measured)]
    return rows[["model", *swept, *measured]].reset_index(drop=True)


def in_words(rows: pd.DataFrame) -> pd.DataFrame:
    """The same rows, with the parameters of each as the command line has them."""
    swept = list(rows.columns[1 : rows.columns.get_loc("cos_theta")])
    said = [
        ",".join(
            f"{name}={value}" for name, value in zip(swept, row, strict=True) if pd.notna(value)
        )
        for row in rows[swept].itertuples(index=False)
    ]
    found = rows.drop(columns=swept)
    found.insert(1, "set", said)
    return found


def conclude(context: Context, frames: dict[str, pd.DataFrame]) -> None:
    """What is lost, and to what."""
    rows = together(frames)
    finite = rows[rows["not_finite"] == 0]
    for way, (label, _, _) in LOOKS.items():
        seen = finite if way == "float32" else rows
        context.note(
            f"Fewest digits with {label}: {placed(seen.loc[seen[way].idxmin()], way)}; the median "
            f"of all is {seen[way].median():.1f}."
        )
    bad = rows[rows["not_finite"] > 0]
    few = finite[finite["float32"] < SEVERAL]
    context.note(
        f"In float32 {len(bad)} of {len(rows)} albedos have values that are not finite"
        + (
            f": {counted(bad)}; the largest cos θ is {bad['cos_theta'].max():g}. Of these values "
            f"{bad['beyond'].sum() / bad['not_finite'].sum():.0%} are too large for it. "
            if len(bad)
            else ". "
        )
        + f"Of the others {len(few)} have fewer than {SEVERAL:g} right digits"
        + (f": {counted(few)}." if len(few) else ".")
    )
    moved = {kind: finite.loc[finite[kind].idxmax()] for kind in ("parameters", "inputs")}
    context.note(
        "Rounding the parameters to float32 and nothing else moves an albedo by "
        f"{finite['parameters'].median():.0e} in the median and "
        f"{moved['parameters']['parameters']:.0e} at most ({moved['parameters']['model']}); "
        f"rounding the directions as well, by {finite['inputs'].median():.0e} and "
        f"{moved['inputs']['inputs']:.0e} ({moved['inputs']['model']}). The median with all "
        f"operations rounded is {finite['operations'].median():.0e}."
    )


def placed(row: pd.Series, way: str) -> str:
    """Digits, and the model and incidence that have them."""
    names = list(row.index[1 : row.index.get_loc("cos_theta")])
    swept = [
        f"{n} = {row[n]:.3g}" for n in names if pd.notna(row[n]) and not isinstance(row[n], str)
    ]
    return (
        f"{row[way]:.1f}, of {row['model']} with {', '.join(swept) or 'its defaults'} at "
        f"cos θ = {row['cos_theta']:g}, where the albedo is {row['albedo']:.3g}"
    )


def counted(rows: pd.DataFrame) -> str:
    """How many of each model."""
    return ", ".join(f"{name} ({len(own)})" for name, own in rows.groupby("model"))


def draw_models(frames: dict[str, pd.DataFrame]) -> Figure:
    """One row for every model."""
    names = sorted(frames, key=lambda name: -frames[name]["fine"].min())
    with plotting.style():
        figure, (axes,) = plotting.new_figure(height=0.24 * len(names) + 0.9)
        for way, (label, color, shift) in LOOKS.items():
            places = np.arange(len(names)) + shift
            least = [frames[name][way].min() for name in names]
            middle = [frames[name][way].median() for name in names]
            axes.hlines(places, least, middle, color=color, linewidth=1.0)
            axes.plot(least, places, "o", ms=4, color=color, label=label)
            axes.plot(middle, places, "|", ms=7, color=color)
        for full in set(albedo_digits.FULL.values()):
            axes.axvline(full, color="#888888", linewidth=0.9, zorder=0.5)
        axes.set_yticks(range(len(names)), names)
        axes.set_xlim(-0.4, 16.6)
        axes.set_ylim(-0.7, len(names) - 0.3)
        axes.set_xlabel("right decimal digits of the albedo: fewest (dot) to median (bar)")
        plotting.add_legend(figure, axes)
    return figure


def draw_maps(frames: dict[str, pd.DataFrame], way: str) -> Figure:
    """A block for every model that has a swept number, all in one panel."""
    swept = {}
    for name, frame in frames.items():
        named = frame.columns[: frame.columns.get_loc("cos_theta")]
        numbers = [c for c in named if pd.api.types.is_float_dtype(frame[c])]
        if numbers:
            swept[name] = numbers[0]
    fields = {}
    for name, parameter in swept.items():
        field = frames[name].pivot_table(
            index="cos_theta", columns=parameter, values=way, aggfunc="min", dropna=False
        )
        fields[name] = field.sort_index(ascending=False)
    cosines = next(iter(fields.values())).index
    across = 4
    down = -(-len(fields) // across)
    # Blocks are one unit wide and high, with room for a title above and a gap beside them.
    wide, high = 1.15, 1.5
    with plotting.style():
        figure, (axes,) = plotting.new_figure(width=9.6, height=1.15 * down + 0.6)
        for k, (name, field) in enumerate(fields.items()):
            left, top = (k % across) * wide, -(k // across) * high
            mesh = axes.pcolormesh(
                np.linspace(left, left + 1.0, field.shape[1] + 1),
                np.linspace(top, top - 1.0, field.shape[0] + 1),
                field.to_numpy(),
                vmin=0.0,
                vmax=albedo_digits.FULL[way],
                cmap="viridis",
                # Hundreds of fields are fewer bytes as dots than as outlines.
                rasterized=True,
            )
            parameter, ends = swept[name], field.columns
            span = f"{parameter} = {ends[0]:.2g} to {ends[-1]:.2g}"
            axes.text(left, top + 0.23, name, fontsize=8, va="bottom")
            axes.text(left, top + 0.04, span, fontsize=6.5, va="bottom", color="#555555")
        middles = (np.arange(len(cosines)) + 0.5) / len(cosines)
        places = [-row * high - y for row in range(down) for y in middles]
        axes.set_yticks(places, [f"{c:g}" for c in cosines] * down, fontsize=6.0)
        axes.set_xticks([])
        axes.set_xlim(-0.03, across * wide - 0.12)
        axes.set_ylim(-(down - 1) * high - 1.03, 0.5)
        axes.set_ylabel("cosine of the angle of incidence")
        axes.grid(visible=False)
        for spine in axes.spines.values():
            spine.set_visible(False)
        bar = figure.colorbar(mesh, ax=axes, shrink=0.5, aspect=30)
        bar.set_label("right digits of the albedo")
    return figure


# Lobes as printed --------------------------------------------------------------------------------


def printed(context: Context) -> None:
    """Errors of albedos over the width of the lobe, as printed and in slopes."""
    widths = WIDTHS if context.full else WIDTHS[::4]
    frames = []
    for label, formula in FORMULAS.items():
        for m in widths:
            if m >= 0.99 * formula.narrowest:
                context.progress(0, 1, f"{label} as printed, width {m:.1g}")
                rtol = 1e-10 if context.full else 1e-4
                frame = albedo_digits.printed_albedos(formula, m, INCIDENCE, rtol=rtol)
                frame.insert(0, "formula", label)
                frames.append(frame)
    rows = pd.concat(frames, ignore_index=True)
    context.table(
        "printed",
        rows,
        f"Albedos at cos θ = {INCIDENCE:g} of lobes as printed and in slopes",
        # Roundings, and what they lead to.
        machine=("value", "relative_error", "not_finite"),
    )
    context.figure(
        "printed_figure",
        draw_printed(rows),
        f"Relative errors of albedos at cos θ = {INCIDENCE:g}: lobes as printed (solid), and in "
        "slopes from raw directions (dashed) or with the half vector known (dotted). Sums above "
        f"{TOP:g} and those that are not finite stand at the top; errors below {LEAST:g} at the "
        "bottom.",
    )
    for way in ("float64", "float32"):
        own = rows[rows["way"] == way]
        parts = []
        for label in FORMULAS:
            seen = own[(own["formula"] == label) & (own["form"] == "printed")]
            wrong = seen[seen["relative_error"] > WRONG]
            said = (
                f"from m = {wrong['width'].max():.1g} on"
                if len(wrong)
                else f"at no width down to {seen['width'].min():.1g}"
            )
            parts.append(f"{label} {said}")
        known = own[own["form"] == "known"]
        top = known.loc[known["relative_error"].idxmax()]
        context.note(
            f"As printed, the albedo in {way} is off by more than {WRONG:.0%}: "
            + "; ".join(parts)
            + f". In slopes with h known it is off by {top['relative_error']:.0e} at most "
            f"({top['formula']}, m = {top['width']:.1g}); it is known to "
            f"{own['relative_error_error'].max():.0e}."
        )


def draw_printed(rows: pd.DataFrame) -> Figure:
    """Two panels, one for each arithmetic."""
    lines = {"printed": "o-", "raw": "s--", "known": ":"}
    with plotting.style():
        figure, panels = plotting.new_figure(2, width=8.6, height=3.9)
        for axes, way in zip(panels, ("float64", "float32"), strict=True):
            for color, label in zip(COLORS, FORMULAS, strict=True):
                for form, line in lines.items():
                    own = rows[(rows["formula"] == label) & (rows["form"] == form)]
                    own = own[own["way"] == way].sort_values("width")
                    error = own["relative_error"].clip(LEAST, TOP)
                    said = f"{label}, {FORMS[form]}"
                    axes.plot(own["width"], error, line, ms=3.0, lw=1.2, color=color, label=said)
            axes.set_xscale("log")
            axes.set_yscale("log")
            axes.set_ylim(0.4 * LEAST, 2.5 * TOP)
            axes.invert_xaxis()
            axes.set_xlabel("width m of the lobe")
            axes.set_title(way, loc="left")
        panels[0].set_ylabel("relative error of the albedo")
        plotting.add_legend(figure, panels[0], columns=3)
    return figure
