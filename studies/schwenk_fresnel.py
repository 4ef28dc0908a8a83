"""How far are the survey's approximations of Fresnel's equations from the equations?

Eqs. 15 and 16 are Schlick's form, with the reflectance at normal incidence from the index or given;
eq. 17 is Lázányi and Szirmay-Kalos' form for metals as the survey prints it, without their last
term a u (1 - u)^α, which makes up for the error. Since 1 - F0 = 4n/((n + 1)² + k²), the three are
one function of u.

What counts as close is set beforehand: one percent of the incident light, at every angle under one
reading and in the cosine-weighted mean over angles under the other. Dielectrics have indices from
1.1 to 4; metals are gold, silver, copper and aluminium between 0.4 and 0.7 µm.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from scipy.optimize import minimize_scalar

from albedo import plotting
from albedo.errors import InputError
from albedo.estimate import format_value
from albedo.fresnel import average, fit_lazanyi, reflectance, schlick_f0
from albedo.integrators.rules import gauss
from albedo.metals import METALS, SOURCES, refractive_index
from albedo.studies import Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from albedo.studies import Context

STUDY = Study(
    name="schwenk_fresnel",
    title="Approximations of Fresnel's equations",
    paper="S",
    claims=("S11",),
)

CLOSE = 0.01
"""A share of the incident light, that an approximation may be off."""
WAVELENGTHS = (0.40, 0.44, 0.48, 0.52, 0.56, 0.60, 0.64, 0.70)
INDICES = (1.1, 4.0)
# Cosines of the first look at an error, dense towards grazing incidence where metals dip.
GRID = np.linspace(0.0, 1.0, 2001) ** 2
# Values are good to a few units of the last digit; closing in on a top errs by less.
ROUNDING = 1e-13
# A top is flat: where it lies is known to the root of that, in degrees.
PLACE = 1e-3
READINGS = {"largest": "at every angle", "mean": "in the mean over angles"}
COLORS = {"gold": "#E69F00", "silver": "#56B4E9", "copper": "#D55E00", "aluminium": "#332288"}


def run(context: Context) -> None:
    """Measure errors of dielectrics and metals, judge them, and draw them."""
    context.setting(close=CLOSE, grid=GRID.size)
    dielectrics = measure_dielectrics(61 if context.full else 30)
    context.table(
        "dielectrics",
        dielectrics,
        "Schlick's form against the exact equations, over the index of a dielectric",
        loose={"largest_at_deg": PLACE},
    )
    context.progress(1, 3, "metals")
    metals = measure_metals(SOURCES if context.full else SOURCES[:1])
    context.table(
        "metals",
        metals,
        "Eq. 17 as printed, and with the term that it leaves out",
        loose={
            **dict.fromkeys(("printed_largest_at_deg", "whole_largest_at_deg"), PLACE),
            **dict.fromkeys(("a", "alpha"), 1e-6),
        },
    )
    context.progress(2, 3, "figures")
    judge(context, dielectrics, metals)
    say(context, dielectrics, metals)
    context.figure(
        "errors_figure",
        draw_errors(dielectrics, metals),
        "Left: largest (solid) and mean (dashed) error of Schlick's form for dielectrics. Right: "
        "largest errors for metals, of eq. 17 as printed (solid) and with the term that the survey "
        f"leaves out (dashed). The grey line is what counts as close, {CLOSE:g} of the light.",
    )
    context.figure(
        "factors_figure",
        draw_factors(),
        "Above: exact factors (solid), Schlick's form, which is eq. 17 as printed (dashed), and "
        "Lázányi's whole form (dotted). Below: what the approximations are off.",
    )


def difference(kind: str, n: float, k: float) -> Callable[[Any], np.ndarray]:
    """An approximation less the exact factor, as a function of u."""
    exact = "conductor" if k > 0.0 else "dielectric"

    def off(u: Any) -> np.ndarray:
        return reflectance(kind, u, n=n, k=k) - reflectance(exact, u, n=n, k=k)

    return off


def largest_error(off: Callable[[Any], np.ndarray]) -> tuple[float, float, float]:
    """The largest absolute value over u in [0, 1], its error, and where."""
    values = np.abs(off(GRID))
    top = int(np.argmax(values))
    low, high = GRID[max(top - 1, 0)], GRID[min(top + 1, GRID.size - 1)]
    found = minimize_scalar(
        lambda u: -float(np.abs(off(u))),
        bounds=(low, high),
        method="bounded",
        options={"xatol": 1e-9},
    )
    if -found.fun > values[top]:
        return float(-found.fun), ROUNDING, float(found.x)
    return float(values[top]), ROUNDING, float(GRID[top])


def mean_error(off: Callable[[Any], np.ndarray]) -> tuple[float, float]:
    """Mean absolute value, weighted by 2u, and what half as many panels change."""

    def mean(panels: int) -> float:
        # Panels are short towards grazing incidence, as the grid is.
        edges = np.linspace(0.0, 1.0, panels + 1) ** 2
        rule = gauss(8)
        u = edges[:-1, None] + np.diff(edges)[:, None] * rule.nodes
        weights = np.diff(edges)[:, None] * rule.weights
        return float(np.sum(2.0 * u * np.abs(off(u)) * weights))

    fine = mean(256)
    return fine, abs(fine - mean(128)) + ROUNDING


def measured(kind: str, n: float, k: float) -> dict[str, float]:
    """Errors of an approximation for one index."""
    off = difference(kind, n, k)
    value, error, u = largest_error(off)
    mean, spread = mean_error(off)
    exact = "conductor" if k > 0.0 else "dielectric"
    whole = average(kind, n=n, k=k) - average(exact, n=n, k=k)
    return {
        "largest": value,
        "largest_error": error,
        "largest_at_deg": 90.0 - float(np.degrees(np.arcsin(u))),
        "mean": mean,
        "mean_error": spread,
        # Averages of factors have errors of a few units in the fifteenth digit.
        "average_off": whole,
        "average_off_error": ROUNDING,
    }


def measure_dielectrics(count: int) -> pd.DataFrame:
    """Errors over the index; 1.5 is among them."""
    indices = np.unique(np.append(np.linspace(*INDICES, count), 1.5))
    rows = []
    for n in indices:
        row = {"n": float(n), "f0": float(schlick_f0(n))}
        rows.append(row | measured("schlick", float(n), 0.0))
    return pd.DataFrame(rows)


def measure_metals(sources: tuple[str, ...]) -> pd.DataFrame:
    """Errors for metals over the wavelength, without and with the error term."""
    rows = []
    for source in sources:
        for metal in METALS:
            for wavelength in WAVELENGTHS:
                n, k = map(float, refractive_index(metal, wavelength, source))
                row: dict[str, Any] = {
                    "metal": metal,
                    "source": source,
                    "wavelength": wavelength,
                    "n": n,
                    "k": k,
                }
                printed = measured("schlick", n, k)
                row |= {f"printed_{key}": value for key, value in printed.items()}
                a, alpha, _ = fit_lazanyi(n, k)
                row |= {"a": a, "alpha": alpha}
                try:
                    whole = measured("lazanyi", n, k)
                except InputError:
                    # The best fit leaves [0, 1]: there is no such factor.
                    whole = dict.fromkeys(printed, np.nan)
                row |= {f"whole_{key}": value for key, value in whole.items()}
                rows.append(row)
    return pd.DataFrame(rows)


def worst(frame: pd.DataFrame, column: str) -> pd.Series:
    """The row with the largest value."""
    return frame.loc[frame[column].idxmax()]


def judge(context: Context, dielectrics: pd.DataFrame, metals: pd.DataFrame) -> None:
    """Three statements, each under both readings of close."""
    glassy = dielectrics[dielectrics["n"] == 1.5]
    schlick = "Schlick's form (eqs. 15, 16)"
    kinds = (
        ("dielectrics", glassy, "", f"{schlick} for n = 1.5", "eq. 15, n = 1.5"),
        ("dielectrics", dielectrics, "", f"{schlick} for n from 1.1 to 4", "eq. 15, n 1.1 to 4"),
        ("metals", metals, "printed_", "Eq. 17 as printed for metals", "eq. 17 as printed"),
        ("metals", metals, "whole_", "Eq. 17 with its error term for metals", "with error term"),
    )
    for table, frame, prefix, text, short in kinds:
        for column, reading in READINGS.items():
            row = worst(frame, prefix + column)
            where = f"n = {row['n']:.3g}"
            if table == "metals":
                where = f"{row['metal']}, {row['wavelength']:g} µm"
            context.claim(
                "S11",
                f"{text} is close to Fresnel's equations.",
                value=float(row[prefix + column]),
                error=float(row[f"{prefix}{column}_error"]),
                criterion=f"<= {CLOSE:g}",
                quantity=f"{column} error, share of the light, at worst ({where})",
                reading=f"{short}, {reading}",
                table=table,
            )
    glass = glassy.iloc[0]
    best = dielectrics.loc[dielectrics["largest"].idxmin()]
    top, metal = worst(dielectrics, "largest"), worst(metals, "printed_largest")
    left = worst(metals, "whole_largest")
    context.explain(
        "S11",
        "Schlick's form has the exact values at normal incidence and at the horizon. What lies "
        "between depends on the index by more than F0: for indices near 1, and for large ones, the "
        "exact curve rises later than (1 - u)^5, which is the same for all and suits an index of "
        f"about {best['n']:.2g}. At n = 1.5 the largest error is "
        f"{format_value(glass['largest'], glass['largest_error'])} at "
        f"{glass['largest_at_deg']:.1f}°, the mean one "
        f"{format_value(glass['mean'], glass['mean_error'])}; the smallest largest error is "
        f"{best['largest']:.3g} at n = {best['n']:.3g}, and at n = {top['n']:.3g} it is "
        f"{top['largest']:.3g}. Eq. 17 without its last term is Schlick's form with the complex "
        f"index in F0, and misses the dip of a metal near its pseudo-Brewster angle by "
        f"{metal['printed_largest']:.3g} ({metal['metal']}, {metal['wavelength']:g} µm, "
        f"{metal['printed_largest_at_deg']:.1f}°). The term a u (1 - u)^α that the authors of that "
        f"form add, and the survey leaves out, brings the largest error of all metals down to "
        f"{left['whole_largest']:.3g} ({left['metal']}, {left['wavelength']:g} µm).",
    )


def printed(u: np.ndarray, n: float, k: float) -> np.ndarray:
    """Eq. 17 in the form in which it is printed, to be compared."""
    return ((n - 1.0) ** 2 + 4.0 * n * (1.0 - u) ** 5 + k * k) / ((n + 1.0) ** 2 + k * k)


def say(context: Context, dielectrics: pd.DataFrame, metals: pd.DataFrame) -> None:
    """One function, and where it is close."""
    apart = max(
        float(np.abs(printed(GRID, n, k) - reflectance("schlick", GRID, n=n, k=k)).max())
        for n, k in metals[["n", "k"]].itertuples(index=False)
    )
    context.note(
        f"Eqs. 15, 16 and 17 are one function: as printed, eq. 17 differs from Schlick's form by "
        f"{apart:.1g} at most over all metals and angles, which is rounding."
    )
    for column, words in READINGS.items():
        inside = dielectrics[dielectrics[column] <= CLOSE]
        context.note(
            f"Of the {len(dielectrics)} indices of dielectrics, {len(inside)} are within {CLOSE:g} "
            f"{words}"
            + ("." if inside.empty else f": {inside['n'].min():.3g} to {inside['n'].max():.3g}.")
        )
    off = dielectrics.loc[dielectrics["average_off"].abs().idxmax()]
    context.note(
        "In the cosine-weighted average of the reflectance, where errors of both signs cancel, "
        f"Schlick's form is off by {off['average_off']:+.3g} at most, at n = {off['n']:.3g}."
    )
    for metal, group in metals.groupby("metal", sort=False):
        bare, whole = worst(group, "printed_largest"), worst(group, "whole_largest")
        context.note(
            f"{str(metal).capitalize()}: largest error {bare['printed_largest']:.3g} at "
            f"{bare['wavelength']:g} µm as printed, {whole['whole_largest']:.3g} at "
            f"{whole['wavelength']:g} µm with the error term."
        )


def draw_errors(dielectrics: pd.DataFrame, metals: pd.DataFrame) -> Figure:
    """Errors over the index and over the wavelength."""
    with plotting.style():
        figure, (left, right) = plotting.new_figure(2, width=8.6, height=3.6)
        for column, line in (("largest", "-"), ("mean", "--")):
            left.plot(
                *(dielectrics["n"], dielectrics[column]),
                color="#222222",
                linestyle=line,
                label=f"dielectrics, {column}",
            )
        left.set_xlim(1.0, INDICES[1])
        left.set_xlabel("index of refraction n")
        left.set_ylabel("error of the reflectance")
        left.set_title("dielectrics, eqs. 15 and 16")
        first = metals[metals["source"] == metals["source"].iloc[0]]
        lines = []
        for metal, group in first.groupby("metal", sort=False):
            look = {"color": COLORS[str(metal)], "marker": "o", "ms": 3.5}
            lines += right.plot(
                group["wavelength"], group["printed_largest"], label=str(metal), **look
            )
            right.plot(group["wavelength"], group["whole_largest"], linestyle="--", **look)
        right.set_xlabel("wavelength (µm)")
        right.set_title("metals, eq. 17")
        bottom, top = 1e-4, 0.5
        for axes in (left, right):
            axes.axhline(CLOSE, color="#777777", linewidth=1.3, zorder=1.2)
            axes.set_yscale("log")
            axes.set_ylim(bottom, top)
        plotting.add_legend(figure, left, lines)
    return figure


def draw_factors() -> Figure:
    """Factors and their errors against the angle."""
    degrees = np.linspace(0.0, 90.0, 361)
    u = np.sin(np.radians(90.0 - degrees))
    u[-1] = 0.0
    blue, gold = map(float, (0.44, 0.56))
    cases: list[tuple[str, float, float, str]] = [
        ("n = 1.5", 1.5, 0.0, "#0072B2"),
        ("n = 4", 4.0, 0.0, "#AA4499"),
    ]
    for metal, wavelength in (("gold", blue), ("aluminium", gold)):
        n, k = map(float, refractive_index(metal, wavelength))
        cases.append((f"{metal}, {wavelength:g} µm", n, k, COLORS[metal]))
    with plotting.style():
        figure, _ = plotting.new_figure(0, 6.8, 5.6)
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(1.5, 1.0))
        for label, n, k, color in cases:
            exact = reflectance("conductor" if k else "dielectric", u, n=n, k=k)
            upper.plot(degrees, exact, color=color, label=label)
            kinds = [("schlick", "--")] + ([("lazanyi", ":")] if k else [])
            for kind, line in kinds:
                other = reflectance(kind, u, n=n, k=k)
                upper.plot(degrees, other, color=color, linestyle=line, linewidth=1.3)
                lower.plot(degrees, other - exact, color=color, linestyle=line)
        upper.set_ylim(0.0, 1.02)
        upper.set_ylabel("reflectance F")
        lower.axhspan(-CLOSE, CLOSE, color="#dddddd", linewidth=0, zorder=0.5)
        lower.set_ylabel("approximation - exact")
        lower.set_xlabel("angle of incidence (degrees)")
        lower.set_xlim(0.0, 90.0)
        lower.set_xticks(np.arange(0.0, 91.0, 15.0))
        plotting.add_legend(figure, upper)
    return figure
