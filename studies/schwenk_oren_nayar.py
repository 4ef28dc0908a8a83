"""Is Oren and Nayar's model Lambert's at σ = 0, and where does it lose or gain energy elsewhere?

The survey prints the qualitative model (eq. 34); the full one of Oren and Nayar's paper has light
that is reflected between facets as well. Both are compared with Lambert's law at σ = 0, value by
value and in the albedo, and their albedos are mapped over the angle of incidence and over σ from 0
to π/2, for facets that reflect everything: what is above 1 there is energy that was not received.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

import albedo
from albedo import plotting
from albedo.analysis.energy import energy_map
from albedo.analysis.pairs import direction_pairs, largest_relative_difference
from albedo.estimate import format_value
from albedo.grammar import parse_model
from albedo.studies import Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from albedo.studies import Context

STUDY = Study(
    name="schwenk_oren_nayar",
    title="Energy of Oren and Nayar's model",
    paper="S",
    claims=("S7",),
)

FORMS = {"oren_nayar": "qualitative", "oren_nayar_full": "full"}
RHOS = (0.2, 0.5, 1.0)
SEED = 7
SAME = 1e-14
"""A relative difference that roundings make."""
CLOSE = 1e-10
"""A difference of albedos that their bounds make."""
EPS = float(np.finfo(float).eps)
COLORS = {"oren_nayar": "#0072B2", "oren_nayar_full": "#D55E00"}


def run(context: Context) -> None:
    """Compare with Lambert's law, map albedos, judge and draw."""
    rtol = 1e-8 if context.full else 1e-6
    context.setting(pairs=30_000, seed=SEED, rtol=rtol)
    smooth = compare_smooth(30_000)
    # Where roundings are largest, each machine has its own place.
    places = {"n_dot_l": 1.0, "n_dot_v": 1.0}
    caption = "Both forms at σ = 0 against Lambert's law"
    context.table("smooth", smooth, caption, loose=places)
    judge_smooth(context, smooth)
    context.progress(1, 4, "the map")
    field = map_albedos(46 if context.full else 19, 37 if context.full else 13, rtol)
    context.table("map", field, "Albedos over the angle of incidence and σ, ρ = 1")
    context.progress(2, 4, "extremes")
    ends = extremes(61 if context.full else 16, rtol)
    context.table(
        "extremes",
        ends,
        "The largest and smallest albedo of all angles of incidence, and the average, ρ = 1",
        # A top may be flat.
        loose={"max_cos_theta": 1.0, "min_cos_theta": 1.0},
    )
    context.progress(3, 4, "figures")
    judge_energy(context, ends)
    say(context, ends)
    context.figure(
        "map_figure",
        draw_map(field),
        "Albedo less 1 for facets that reflect everything: blue loses energy, red gains it, and "
        "the black line is an albedo of 1.",
    )
    context.figure(
        "extremes_figure",
        draw_extremes(ends),
        "The largest and the smallest albedo of all angles of incidence (dashed and dotted), and "
        "the cosine-weighted average (solid), ρ = 1.",
    )


def compare_smooth(count: int) -> pd.DataFrame:
    """Values and albedos at sigma = 0 against those of Lambert's law."""
    wi, wo = direction_pairs(count, SEED)
    cosines = plotting.grazing_grid(1e-9, 2)
    rows = []
    for name, form in FORMS.items():
        for rho in RHOS:
            model, lambert = (
                albedo.model(name, rho=rho, sigma=0.0),
                albedo.model("lambert", rho=rho),
            )
            off, at = largest_relative_difference(model.eval(wi, wo), lambert.eval(wi, wo))
            one, two = (albedo.directional_albedo(m, cosines, rtol=1e-11) for m in (model, lambert))
            distance = np.abs(one.value - two.value)
            worst = int(np.argmax(distance))
            rows.append(
                {
                    "form": form,
                    "rho": rho,
                    "value_off": off,
                    # The difference of two rounded numbers, over one of them.
                    "value_off_error": 2.0 * EPS,
                    "n_dot_l": wi[at, 2],
                    "n_dot_v": wo[at, 2],
                    "albedo_off": distance[worst],
                    "albedo_off_error": one.error[worst] + two.error[worst],
                }
            )
    return pd.DataFrame(rows)


def map_albedos(angles: int, sigmas: int, rtol: float) -> pd.DataFrame:
    """Albedos of both forms over the angle of incidence and sigma."""
    # Dense where energy is gained: towards grazing incidence, and for small sigma.
    degrees = (90.0 * np.sin(np.linspace(0.0, 0.5 * math.pi, angles))).round(2)
    cosines = np.sin(np.radians(90.0 - degrees)).round(8)
    rows = []
    steps = (0.5 * math.pi * np.linspace(0.0, 1.0, sigmas) ** 2).round(5)
    for sigma in np.minimum(steps, 0.5 * math.pi):
        columns = {"sigma": float(sigma), "theta_deg": degrees, "cos_theta": cosines}
        for name in FORMS:
            found = albedo.directional_albedo(
                *(albedo.model(name, sigma=float(sigma)), cosines), rtol=rtol
            )
            columns |= {name: found.value, f"{name}_error": found.error}
        rows.append(pd.DataFrame(columns))
    return pd.concat(rows, ignore_index=True)


def extremes(sigmas: int, rtol: float) -> pd.DataFrame:
    """Largest and smallest albedo of all angles, and the average, for every sigma."""
    frames = []
    for name in FORMS:
        steps = 0.5 * math.pi * np.linspace(0.0, 1.0, sigmas) ** 2
        spec = parse_model(f"{name}:sigma=[{','.join(f'{x:.17g}' for x in steps)}]", "A map")
        found = energy_map(spec, rtol).frame
        columns = ["sigma"]
        for end in ("max", "min"):
            columns += [f"{end}_albedo", f"{end}_albedo_error", f"{end}_cos_theta"]
        frame = found[columns].copy()
        frame.insert(0, "model", name)
        means = [
            albedo.average_albedo(albedo.model(name, sigma=s), rtol=rtol) for s in frame["sigma"]
        ]
        frame["average"] = [float(m.value) for m in means]
        frame["average_error"] = [float(m.error) for m in means]
        frames.append(frame)
    return pd.concat(frames, ignore_index=True)


def judge_smooth(context: Context, smooth: pd.DataFrame) -> None:
    """At sigma = 0 values and albedos are Lambert's."""
    for column, what in (("value_off", "values"), ("albedo_off", "albedos")):
        row = smooth.loc[smooth[column].idxmax()]
        context.claim(
            "S7",
            f"At σ = 0 Oren and Nayar's model has the {what} of Lambert's.",
            value=float(row[column]),
            error=float(row[f"{column}_error"]),
            criterion=f"<= {SAME if column == 'value_off' else CLOSE:g}",
            quantity=f"largest {'relative ' * (what == 'values')}difference, both forms",
            table="smooth",
        )


def judge_energy(context: Context, ends: pd.DataFrame) -> None:
    """Elsewhere energy is lost, and gained."""
    for name, form in FORMS.items():
        own = ends[ends["model"] == name]
        top = own.loc[own["max_albedo"].idxmax()]
        low = own.loc[own["min_albedo"].idxmin()]
        context.claim(
            "S7",
            f"The {form} form gains energy: some albedo is above 1.",
            value=float(top["max_albedo"]),
            error=float(top["max_albedo_error"]),
            criterion="> 1",
            quantity=f"largest albedo, ρ = 1 (σ = {top['sigma']:.3g})",
            figure="extremes_figure",
            table="extremes",
        )
        context.claim(
            "S7",
            f"The {form} form loses energy: some albedo is below 1, though facets lose nothing.",
            value=float(low["min_albedo"]),
            error=float(low["min_albedo_error"]),
            criterion="< 1",
            quantity=f"smallest albedo, ρ = 1 (σ = {low['sigma']:.3g})",
            figure="extremes_figure",
            table="extremes",
        )


def say(context: Context, ends: pd.DataFrame) -> None:
    """Where energy is gained and lost."""
    for name, form in FORMS.items():
        own = ends[ends["model"] == name]
        over = own[own["max_albedo"] - own["max_albedo_error"] > 1.0]
        top = own.loc[own["max_albedo"].idxmax()]
        low = own.loc[own["min_albedo"].idxmin()]
        mean = own.loc[own["average"].idxmin()]
        most = own.loc[own["average"].idxmax()]
        text = (
            f"The {form} form reflects at most "
            f"{format_value(top['max_albedo'], top['max_albedo_error'])} (σ = {top['sigma']:.3g}, "
            f"{90.0 - math.degrees(math.asin(top['max_cos_theta'])):.4g}°) and at least "
            f"{format_value(low['min_albedo'], low['min_albedo_error'])} (σ = {low['sigma']:.3g}, "
            f"{90.0 - math.degrees(math.asin(low['min_cos_theta'])):.4g}°). "
        )
        if len(over):
            text += (
                f"It gains energy at {len(over)} of {len(own)} values of σ, from "
                f"{over['sigma'].min():.3g} to {over['sigma'].max():.3g}; "
            )
        text += (
            "averaged over all directions it reflects between "
            f"{format_value(mean['average'], mean['average_error'])} (σ = {mean['sigma']:.3g}) and "
            f"{format_value(most['average'], most['average_error'])} (σ = {most['sigma']:.3g})."
        )
        context.note(text)


def draw_map(field: pd.DataFrame) -> Figure:
    """Both maps on one scale of colours."""
    from matplotlib.colors import TwoSlopeNorm

    sigma, theta = np.unique(field["sigma"]), np.unique(field["theta_deg"])
    shape = (sigma.size, theta.size)
    low = min(float(field[name].min()) for name in FORMS) - 1.0
    # Gains are a tenth of what is lost: each side has its own scale.
    norm = TwoSlopeNorm(0.0, low, 0.06)
    with plotting.style():
        figure, panels = plotting.new_figure(2, width=8.6, height=3.7)
        for axes, (name, form) in zip(panels, FORMS.items(), strict=True):
            off = field[name].to_numpy().reshape(shape) - 1.0
            image = axes.pcolormesh(
                theta, sigma, off, cmap="RdBu_r", norm=norm, shading="gouraud", rasterized=True
            )
            lines = axes.contour(
                theta, sigma, off, (-0.4, -0.3, -0.2, -0.1), colors="#555555", linewidths=0.7
            )
            axes.clabel(lines, fmt=lambda v: f"{v:g}", fontsize=8)
            # At sigma = 0 all is 1: the line is where it is crossed.
            axes.contour(theta, sigma[1:], off[1:], (0.0,), colors="black", linewidths=1.6)
            axes.set_title(f"{form}")
            axes.set_xticks(np.arange(0.0, 91.0, 15.0))
            axes.set_xlabel("angle of incidence (degrees)")
            axes.grid(False)
        panels[0].set_ylabel("σ (radians)")
        bar = figure.colorbar(image, ax=panels, pad=0.02)
        bar.set_ticks([-0.4, -0.3, -0.2, -0.1, 0.0, 0.02, 0.04, 0.06])
        bar.set_label("albedo - 1")
        bar.outline.set_visible(False)
    return figure


def draw_extremes(ends: pd.DataFrame) -> Figure:
    """Largest, smallest and average albedo over sigma."""
    with plotting.style():
        figure, (axes,) = plotting.new_figure(width=6.5, height=3.8)
        for name, form in FORMS.items():
            own = ends[ends["model"] == name]
            for column, what, line in (
                ("max_albedo", "largest", "--"),
                ("average", "average", "-"),
                ("min_albedo", "smallest", (0, (1.2, 1.4))),
            ):
                axes.plot(
                    *(own["sigma"], own[column]),
                    color=COLORS[name],
                    linestyle=line,
                    label=f"{form}: {what}",
                )
        axes.axhline(1.0, color="#888888", linewidth=0.9, zorder=1.5)
        axes.set_xlim(0.0, 0.5 * math.pi)
        axes.set_ylim(top=1.08)
        axes.set_xlabel("σ (radians)")
        axes.set_ylabel("albedo, ρ = 1")
        plotting.add_legend(figure, axes, columns=2)
    return figure
