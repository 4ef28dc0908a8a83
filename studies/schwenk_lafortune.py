"""Is Lafortune's model with the one lobe (-1, -1, 1) Phong's?

With c = (-1, -1, 1) the axis of the lobe is the mirror direction of the light, and the value is
(r.v)^n. The survey calls that the original Phong model. Two models have this name: Phong's, which
is (r.v)^n/n.l as a BRDF and not reciprocal, and Lewis' and Lafortune and Willems' modification,
which is (r.v)^n alone. Values and albedos are compared with both, times the constant that the
library's models have.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

import albedo
from albedo import plotting
from albedo.analysis.checks import asymmetry
from albedo.analysis.pairs import direction_pairs, largest_relative_difference
from albedo.estimate import format_value
from albedo.studies import Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from albedo.studies import Context

STUDY = Study(
    name="schwenk_lafortune",
    title="Lafortune's lobe about the mirror direction",
    paper="S",
    claims=("S10",),
)

SEED = 10
SAME_VALUE = 1e-10
"""A relative difference that roundings make; powers of n multiply those of their base by n."""
ROUNDING = 5e-11
"""What such differences are uncertain by."""
SAME_ALBEDO = 1e-9
"""A relative difference of albedos that their bounds make."""
EXPONENTS = (0.0, 1.0, 5.0, 20.0, 150.0, 1e4, 1e6)
READINGS = {"phong": "reciprocal Phong, (r.v)^n", "phong_original": "Phong's own, (r.v)^n/n.l"}


def run(context: Context) -> None:
    """Compare values and albedos with both models."""
    count = 90_000 if context.full else 15_000
    context.setting(pairs=count, seed=SEED)
    values = compare_values(count)
    context.table(
        "values",
        values,
        "Values of both models over those of Lafortune's lobe",
        # Where roundings are largest, each machine has its own place.
        loose={"n_dot_l": 1.0, "n_dot_v": 1.0},
    )
    cosines = plotting.grazing_grid(1e-6, 4 if context.full else 2)
    curves = compare_albedos(cosines, EXPONENTS if context.full else EXPONENTS[::3])
    context.table("albedos", curves, "Albedos of all three, with one constant (n + 2)/(2π)")
    judge(context, values, curves)
    say(context, values)
    context.figure(
        "albedos_figure",
        draw(curves),
        "Albedos with the constant (n + 2)/(2π): Lafortune's lobe (dots) lies on the reciprocal "
        "Phong model (solid); Phong's own (dashed) is larger by the mean of 1/n.l.",
    )


def constant(n: float) -> float:
    """(n + 2)/(2 pi), by which the reciprocal Phong model multiplies its power."""
    return (n + 2.0) / (2.0 * math.pi)


def compare_values(count: int) -> pd.DataFrame:
    """Largest relative differences of values."""
    wi, wo = direction_pairs(count, SEED)
    rows = []
    for n in EXPONENTS:
        lobe = albedo.model("lafortune", lobes=((-1.0, -1.0, 1.0, n),))
        own = constant(n) * lobe.eval(wi, wo)
        for name, reading in READINGS.items():
            model = albedo.model(name, n=n)
            scale = constant(n) / scale_of(name, n)
            off, at = largest_relative_difference(own, scale * model.eval(wi, wo))
            rows.append(
                {
                    "model": name,
                    "reading": reading,
                    "n": n,
                    "relative_difference": off,
                    "relative_difference_error": ROUNDING,
                    "n_dot_l": wi[at, 2],
                    "n_dot_v": wo[at, 2],
                }
            )
    return pd.DataFrame(rows)


def scale_of(name: str, n: float) -> float:
    """What a model multiplies its power by: its value where l, v and r are the normal."""
    up = np.array([0.0, 0.0, 1.0])
    return float(albedo.model(name, n=n).eval(up, up))


def compare_albedos(cosines: np.ndarray, exponents: tuple[float, ...]) -> pd.DataFrame:
    """Albedos of the three, all with the constant of the reciprocal Phong model."""
    frames = []
    for n in exponents:
        columns = {"n": n, "theta_deg": np.degrees(np.arccos(cosines)), "cos_theta": cosines}
        models = {
            "lafortune": albedo.model("lafortune", lobes=((-1.0, -1.0, 1.0, n),)),
            **{name: albedo.model(name, n=n) for name in READINGS},
        }
        for name, model in models.items():
            found = albedo.directional_albedo(model, cosines, rtol=1e-10)
            scale = constant(n) / (1.0 if name == "lafortune" else scale_of(name, n))
            columns |= {name: scale * found.value, f"{name}_error": scale * found.error}
        frames.append(pd.DataFrame(columns))
    return pd.concat(frames, ignore_index=True)


def judge(context: Context, values: pd.DataFrame, curves: pd.DataFrame) -> None:
    """Both models, by values and by albedos."""
    for name, reading in READINGS.items():
        own = values[values["model"] == name]
        row = own.loc[own["relative_difference"].idxmax()]
        context.claim(
            "S10",
            "Lafortune's model with the lobe (-1, -1, 1) has the values of the Phong model.",
            value=float(row["relative_difference"]),
            error=float(row["relative_difference_error"]),
            criterion=f"<= {SAME_VALUE:g}",
            quantity=f"largest relative difference of values, n = {row['n']:g}",
            reading=reading,
            table="values",
        )
        off = (curves[name] / curves["lafortune"] - 1.0).abs()
        spread = (
            curves[f"{name}_error"] / curves[name] + curves["lafortune_error"] / curves["lafortune"]
        )
        worst = int((off + spread).to_numpy().argmax())
        context.claim(
            "S10",
            "Lafortune's model with the lobe (-1, -1, 1) has the albedos of the Phong model.",
            value=float(off.iloc[worst]),
            error=float(spread.iloc[worst] * (1.0 + off.iloc[worst])),
            criterion=f"<= {SAME_ALBEDO:g}",
            quantity="largest relative difference of albedos, n = "
            f"{curves['n'].iloc[worst]:g}, n.l = {curves['cos_theta'].iloc[worst]:.3g}",
            reading=reading,
            table="albedos",
        )
    lobe, original = (
        asymmetry(model) for model in (albedo.model("lafortune"), albedo.model("phong_original"))
    )
    twenty = curves[curves["n"] == 20.0]
    low = twenty.loc[(twenty["theta_deg"] - 80.0).abs().idxmin()]
    context.explain(
        "S10",
        "The lobe is max(0, -l_x v_x - l_y v_y + l_z v_z)^n, and what stands in the brackets is "
        "r.v with r = (-l_x, -l_y, l_z). It is symmetric in light and view, so it is the "
        "reciprocal form of Phong's model, value by value. Phong's own formula has no n.l, and as "
        "a BRDF is (r.v)^n/n.l: with n = 20, exchanging both directions changes its values by a "
        f"share of up to {original:.2g}, and those of the lobe by {lobe:.0e}, which is rounding. "
        "The two agree only at normal incidence: the "
        f"albedos at {low['theta_deg']:.1f}° are "
        f"{format_value(low['lafortune'], low['lafortune_error'])} and "
        f"{format_value(low['phong_original'], low['phong_original_error'])}. The survey's words "
        "are right of the shape of the lobe, and of the model that is called Phong's today.",
    )


def say(context: Context, values: pd.DataFrame) -> None:
    """Normalisation."""
    small = values[(values["model"] == "phong") & (values["n"] <= 20.0)]
    context.note(
        "Without a constant the lobe is not normalised: its albedo at normal incidence is "
        "2π/(n + 2), above 1 for n < 4.28 and "
        f"{2.0 * math.pi / (small['n'].max() + 2.0):.3g} for n = {small['n'].max():g}. With "
        "c = (-C, -C, C) and C^n = (n + 2)/(2π) it is 1."
    )


def draw(curves: pd.DataFrame) -> Figure:
    """Albedos over the angle for a few exponents."""
    with plotting.style():
        figure, (axes,) = plotting.new_figure(width=6.8, height=3.9)
        shades = ("#0072B2", "#D55E00", "#009E73")
        degrees = np.concatenate((np.linspace(0.0, 72.0, 25), np.linspace(73.0, 89.5, 34)))
        cosines = np.sin(np.radians(90.0 - degrees))
        for color, n in zip(shades, (1.0, 20.0, 150.0), strict=True):
            for name, line in (("phong", "-"), ("phong_original", "--")):
                found = albedo.directional_albedo(albedo.model(name, n=n), cosines, rtol=1e-6)
                scale = constant(n) / scale_of(name, n)
                label = f"n = {n:g}" if name == "phong" else None
                axes.plot(degrees, scale * found.value, line, color=color, label=label)
            own = albedo.model("lafortune", lobes=((-1.0, -1.0, 1.0, n),))
            found = albedo.directional_albedo(own, cosines[::4], rtol=1e-6)
            axes.plot(degrees[::4], constant(n) * found.value, "o", ms=4, color=color)
        axes.set_xlim(0.0, 90.0)
        axes.set_xticks(np.arange(0.0, 91.0, 15.0))
        axes.set_ylim(0.0, 2.0)
        axes.set_xlabel("angle of incidence (degrees)")
        axes.set_ylabel("albedo with (n + 2)/(2π)")
        plotting.add_legend(figure, axes)
    return figure
