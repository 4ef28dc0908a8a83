"""Is Ashikhmin and Shirley's model Cook and Torrance's with a simpler geometry term?

With D = p_h, the density of half vectors, and G = min(n.l, n.v)/v.h in place of masking, the
microfacet form F D G/(4 n.l n.v) is Ashikhmin and Shirley's lobe. The survey offers their
distribution for Cook and Torrance's model too (eq. 39), and prints it without 1/(2π). A microfacet
distribution needs an integral of D n.h over the hemisphere of 1: that of p_h is 1 over solid angle
instead. Three constants are compared, under both questions.

The survey warns as well that a Lambertian diffuse term, in place of the model's own, loses energy
conservation. How much such a term may reflect is measured over R_s and the exponent.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

import albedo
from albedo import plotting
from albedo.analysis.energy import energy_map
from albedo.analysis.pairs import direction_pairs, largest_relative_difference
from albedo.brdf import Model
from albedo.directions import half_vector
from albedo.estimate import format_value
from albedo.grammar import parse_model
from albedo.studies import Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from albedo.studies import Context

STUDY = Study(
    name="schwenk_ashikhmin_shirley",
    title="Ashikhmin and Shirley's model as a microfacet model",
    paper="S",
    claims=("S8", "S9"),
)

SEED = 8
SAME, ROUNDING = 1e-10, 1e-11
"""Relative differences that roundings of two kernels make, and what they are uncertain by."""
ONE = 1e-3
"""How far an integral that is to be 1 may be off."""
# Exponents along x and y, and reflectances at normal incidence.
EXPONENTS = ((0.0, 0.0), (1.0, 1.0), (10.0, 10.0), (10.0, 1e3), (100.0, 100.0), (1e4, 1.0))
MORE = ((1e3, 1e3), (1e5, 1e5), (1e4, 1e6))
EXPONENTS_OF_LOBES = (10.0, 100.0, 1e4, 1e6)
R_S = 0.05
# The three constants of eq. 39's power, relative to that of p_h.
CONSTANTS = {
    "eq. 39 as printed": "sqrt((n_u + 1)(n_v + 1))",
    "with 1/(2π), as p_h": "sqrt((n_u + 1)(n_v + 1))/(2π)",
    "projected": "sqrt((n_u + 2)(n_v + 2))/(2π)",
}
COLORS = ("#0072B2", "#D55E00", "#009E73", "#AA4499")


def microfacets(n_u: float, n_v: float, normalization: str, **values: Any) -> Model:
    """F D/(4 n.l n.v) with the power of the paper as D."""
    return albedo.model(
        "cook_torrance",
        distribution="ashikhmin_shirley",
        geometry="none",
        n_u=n_u,
        n_v=n_v,
        normalization=normalization,
        **values,
    )


def run(context: Context) -> None:
    """Compare the two models, integrate the distribution, and map the diffuse term."""
    count = 90_000 if context.full else 15_000
    context.setting(pairs=count, seed=SEED, same=SAME, one=ONE)
    exponents = EXPONENTS + (MORE if context.full else ())
    values = compare_values(exponents, count)
    context.table(
        "values",
        values,
        "Both models, value by value, R_s = 0.05",
        # Where roundings are largest, each machine has its own place.
        loose={"n_dot_l": 1.0, "n_dot_v": 1.0},
    )
    integrals = integrate(exponents)
    context.table("integrals", integrals, "Integrals of the distribution over the hemisphere")
    judge_distribution(context, values, integrals)
    context.progress(1, 3, "the diffuse term")
    field = diffuse_room(11 if context.full else 5)
    context.table(
        "diffuse",
        field,
        "The largest albedo of the lobe over all directions, what room it leaves, and the albedo "
        "with R_d = 1 there with Lambert's terms R_d/π and R_d (1 - R_s)/π; the largest with the "
        "model's own term",
        # A top may be flat.
        loose={"at_cos_theta": 1.0},
    )
    curves = grazing_curves(40 if context.full else 16)
    context.table("curves", curves, "Albedos over the angle of incidence, R_s = 0.05, R_d = 1")
    context.progress(2, 3, "figures")
    judge_diffuse(context, field)
    context.figure(
        "geometry_figure",
        draw_geometry(),
        "Left: what stands for masking, in the plane of incidence with the light at 60 degrees. "
        "Right: the integral of D n.h for equal exponents; a microfacet distribution has 1.",
    )
    context.figure(
        "diffuse_figure",
        draw_diffuse(field, curves),
        "Left: how much a Lambertian term may reflect before some albedo passes 1; the grey line "
        "is 1 - R_s, what normal incidence leaves. Right: albedos over the angle of incidence.",
    )


def geometry_term(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    """min(n.l, n.v)/v.h: what the paper's max(n.l, n.v) and v.h make of G."""
    h = half_vector(wi, wo)
    # v.h is half the length of the half vector that is not normalised.
    return np.minimum(wi[..., 2], wo[..., 2]) / (0.5 * np.linalg.norm(h, axis=-1))


def compare_values(exponents: tuple[tuple[float, float], ...], count: int) -> pd.DataFrame:
    """F D G/(4 n.l n.v) against Ashikhmin and Shirley's lobe."""
    wi, wo = direction_pairs(count, SEED)
    g = geometry_term(wi, wo)
    rows = []
    for n_u, n_v in exponents:
        own = albedo.model("ashikhmin_shirley", n_u=n_u, n_v=n_v, r_s=R_S).eval(wi, wo)
        for name, form, factor in (
            ("eq. 39 as printed", "paper", 2.0 * math.pi),
            ("with 1/(2π), as p_h", "paper", 1.0),
            ("projected", "microfacet", 1.0),
        ):
            model = microfacets(n_u, n_v, form, fresnel="schlick", f0=R_S)
            off, at = largest_relative_difference(own, factor * g * model.eval(wi, wo))
            rows.append(
                {
                    "constant": name,
                    "n_u": n_u,
                    "n_v": n_v,
                    "relative_difference": off,
                    # Powers of 1e4 multiply what their bases round.
                    "relative_difference_error": ROUNDING,
                    "n_dot_l": wi[at, 2],
                    "n_dot_v": wo[at, 2],
                    "largest_g": float(g.max()),
                }
            )
    return pd.DataFrame(rows)


def integrate(exponents: tuple[tuple[float, float], ...]) -> pd.DataFrame:
    """The integral of D n.h, and of D, for all three constants.

    With G = 1 and F = 1 the value towards the light itself is D(h)/(4 (n.h)^2), with h = l. So D
    comes from the model, and its integrals are albedos of functions of the view alone.
    """
    rows = []
    for n_u, n_v in exponents:
        closed = {
            "with 1/(2π), as p_h": math.sqrt((n_u + 1.0) / (n_u + 2.0) * (n_v + 1.0) / (n_v + 2.0)),
            "projected": 1.0,
        }
        closed["eq. 39 as printed"] = 2.0 * math.pi * closed["with 1/(2π), as p_h"]
        for name, form, factor in (
            ("eq. 39 as printed", "paper", 2.0 * math.pi),
            ("with 1/(2π), as p_h", "paper", 1.0),
            ("projected", "microfacet", 1.0),
        ):
            model = microfacets(n_u, n_v, form)

            def d(
                wi: np.ndarray, wo: np.ndarray, model: Model = model, factor: float = factor
            ) -> np.ndarray:
                c = wo[..., 2]
                return factor * 4.0 * c * c * model.eval(wo, wo)

            def over_solid_angle(wi: np.ndarray, wo: np.ndarray, d: Any = d) -> np.ndarray:
                return np.asarray(d(wi, wo)) / wo[..., 2]

            row: dict[str, Any] = {"constant": name, "n_u": n_u, "n_v": n_v}
            width = math.sqrt(2.0 / (max(n_u, n_v) + 2.0))
            for column, function in (("projected", d), ("solid_angle", over_solid_angle)):
                user = albedo.model_from(function, lobe="mirror", width=width)
                found = albedo.directional_albedo(user, 1.0, rtol=1e-9)
                row |= {column: float(found.value), f"{column}_error": float(found.error)}
            row["closed_form"] = closed[name]
            rows.append(row)
    return pd.DataFrame(rows)


def judge_distribution(context: Context, values: pd.DataFrame, integrals: pd.DataFrame) -> None:
    """Equality of values, and the integral, for each constant."""
    for name, text in CONSTANTS.items():
        own = values[values["constant"] == name]
        row = own.loc[own["relative_difference"].idxmax()]
        context.claim(
            "S8",
            "Ashikhmin and Shirley's lobe is Cook and Torrance's with G = min(n.l, n.v)/v.h and "
            "eq. 39 for D.",
            value=float(row["relative_difference"]),
            error=float(row["relative_difference_error"]),
            criterion=f"<= {SAME:g}",
            quantity=f"largest relative difference, n_u = {row['n_u']:g}, n_v = {row['n_v']:g}",
            reading=f"the constant of D is {text}",
            figure="geometry_figure",
            table="values",
        )
    for name, text in CONSTANTS.items():
        own = integrals[integrals["constant"] == name]
        row = own.loc[(own["projected"] - 1.0).abs().idxmax()]
        context.claim(
            "S8",
            "Eq. 39 is a microfacet distribution: the integral of D n.h is 1.",
            value=float(row["projected"]),
            error=float(row["projected_error"]),
            criterion=f"= 1 +- {ONE:g}",
            quantity=f"the integral farthest from 1, n_u = {row['n_u']:g}, n_v = {row['n_v']:g}",
            reading=f"the constant of D is {text}",
            figure="geometry_figure",
            table="integrals",
        )
    ten = integrals[(integrals["n_u"] == 10.0) & (integrals["n_v"] == 10.0)].set_index("constant")
    half, whole = ten.loc["with 1/(2π), as p_h"], ten.loc["eq. 39 as printed"]
    projected = ten.loc["projected"]
    context.explain(
        "S8",
        "The lobe is F p_h/(4 v.h max(n.l, n.v)) with the density of half vectors p_h, whose "
        "integral over solid angle is 1. Written as F D G/(4 n.l n.v) with D = p_h it leaves "
        "G = n.l n.v/(v.h max(n.l, n.v)) = min(n.l, n.v)/v.h, which is at most n.h: with this "
        "constant the two models agree in every value. A microfacet distribution has "
        "∫ D n.h dh = 1 instead. For the power n_u cos²φ + n_v sin²φ that integral is 2π/√((n_u + "
        "2)(n_v + 2)), so that with the constant of p_h it is √((n_u + 1)(n_v + 1)/((n_u + 2)(n_v "
        f"+ 2))): {format_value(half['projected'], half['projected_error'])} for n_u = n_v = 10, "
        "and 1 only in the limit of large exponents. Eq. 39 as printed lacks 1/(2π), and has "
        f"{format_value(whole['projected'], whole['projected_error'])}. With √((n_u + 2)(n_v + "
        f"2))/(2π) it is {format_value(projected['projected'], projected['projected_error'])}, but "
        "then the model is not Ashikhmin and Shirley's by that ratio of constants. No constant "
        "does both.",
    )


def diffuse_room(reflectances: int) -> pd.DataFrame:
    """How much a diffuse term may reflect beside the lobe, and what R_d = 1 makes of it.

    Lambert's term adds its albedo in every direction alike, so that the largest albedo of the lobe
    over all directions says how much there is room for.
    """
    n = ",".join(f"{x:g}" for x in EXPONENTS_OF_LOBES)
    r_s = ",".join(f"{x:.6g}" for x in np.unique((*np.linspace(0.0, 1.0, reflectances), R_S)))
    columns = ["n", "r_s", "max_albedo", "max_albedo_error", "max_cos_theta"]
    text = f"ashikhmin_shirley:n=[{n}],r_s=[{r_s}]"
    lobe = energy_map(parse_model(f"{text},diffuse=none", "A map"), 1e-6).frame[columns]
    own = energy_map(parse_model(f"{text},r_d=1", "A map"), 1e-6).frame[columns]
    frame = lobe.rename(columns={c: c.replace("max_albedo", "lobe") for c in columns})
    frame = frame.rename(columns={"max_cos_theta": "at_cos_theta"})
    frame["room"], frame["room_error"] = 1.0 - frame["lobe"], frame["lobe_error"]
    for name, share in (("lambert", 1.0), ("shared", None)):
        values = []
        for row in frame.to_dict("records"):
            r_d = 1.0 - row["r_s"] if share is None else share
            model = albedo.model(
                "ashikhmin_shirley", n=row["n"], r_s=row["r_s"], r_d=r_d, diffuse="lambert"
            )
            values.append(albedo.directional_albedo(model, row["at_cos_theta"], rtol=1e-6))
        frame[name] = [float(v.value) for v in values]
        frame[f"{name}_error"] = [float(v.error) for v in values]
    frame["paper"], frame["paper_error"] = own["max_albedo"], own["max_albedo_error"]
    return frame


def grazing_curves(count: int) -> pd.DataFrame:
    """Albedos over the angle for R_s = 0.05 and R_d = 1, n = 1000."""
    degrees = np.concatenate((np.linspace(0.0, 80.0, count), np.linspace(80.0, 90.0, count)[1:]))
    cosines = np.sin(np.radians(90.0 - degrees))
    cosines[-1] = 0.0
    columns: dict[str, Any] = {"theta_deg": degrees, "cos_theta": cosines}
    for name, options in (
        ("lambert", {"r_d": 1.0, "diffuse": "lambert"}),
        ("shared", {"r_d": 1.0 - R_S, "diffuse": "lambert"}),
        ("paper", {"r_d": 1.0}),
    ):
        model = albedo.model("ashikhmin_shirley", n=1e3, r_s=R_S, **options)
        found = albedo.directional_albedo(model, cosines, rtol=1e-6)
        columns |= {name: found.value, f"{name}_error": found.error}
    return pd.DataFrame(columns)


def judge_diffuse(context: Context, field: pd.DataFrame) -> None:
    """A Lambertian term loses energy conservation, the model's own does not."""
    readings = {"lambert": "R_d/π", "shared": "R_d (1 - R_s)/π"}
    for name, text in readings.items():
        row = field.loc[field[name].idxmax()]
        context.claim(
            "S9",
            "With a Lambertian diffuse term the model does not conserve energy.",
            value=float(row[name]),
            error=float(row[f"{name}_error"]),
            criterion="> 1",
            quantity=f"largest albedo, R_d = 1 (n = {row['n']:g}, R_s = {row['r_s']:g})",
            reading=f"the diffuse term is {text}",
            figure="diffuse_figure",
            table="diffuse",
        )
        over = field[field[name] - field[f"{name}_error"] > 1.0]
        context.note(
            f"With {text} and R_d = 1 the albedo is "
            f"{format_value(row[name], row[f'{name}_error'])} at most (n = {row['n']:g}, R_s = "
            f"{row['r_s']:g}, n.l = {row['at_cos_theta']:.3g}), and exceeds 1 in some direction at "
            f"{len(over)} of {len(field)} settings."
        )
    coat = field[field["r_s"] == R_S]
    context.note(
        f"At R_s = {R_S:g} energy is conserved for a Lambertian term up to R_d = "
        + ", ".join(
            f"{format_value(row['room'], row['room_error'])} (n = {row['n']:g})"
            for _, row in coat.iterrows()
        )
        + ". Towards the horizon F is 1 and a narrow lobe reflects nearly all, so that any R_d > 0 "
        "is too much once n is large enough."
    )
    row = field.loc[field["paper"].idxmax()]
    context.note(
        "With the diffuse term of the model itself and R_d = 1 the largest albedo of the same "
        f"settings is {format_value(row['paper'], row['paper_error'])}."
    )


def draw_geometry() -> Figure:
    """G in the plane of incidence, and integrals over the exponent."""
    degrees = np.linspace(-89.9, 89.9, 721)
    n = np.geomspace(1.0, 1e4, 120)
    theta = math.radians(60.0)
    wi = np.array([math.sin(theta), 0.0, math.cos(theta)])
    angles = np.radians(degrees)
    wo = np.stack((-np.sin(angles), np.zeros(angles.size), np.cos(angles)), axis=-1)
    lights = np.broadcast_to(wi, wo.shape)
    with plotting.style():
        figure, (left, right) = plotting.new_figure(2, width=8.6, height=3.6)
        left.plot(degrees, geometry_term(lights, wo), color="#222222", label="min(n.l, n.v)/v.h")
        none, cavity = (
            albedo.model("cook_torrance", m=0.5, geometry=g).eval(lights, wo)
            for g in ("none", "v_cavity")
        )
        left.plot(degrees, cavity / none, "--", color=COLORS[0], label="v-shaped cavities")
        left.set_xlim(-90.0, 90.0)
        left.set_xticks(np.arange(-90.0, 91.0, 30.0))
        left.set_ylim(0.0, 1.05)
        left.set_xlabel("angle of the view (degrees, mirror side positive)")
        left.set_ylabel("geometry term G")
        # The closed forms, which the table holds against the measured integrals.
        ratio = (n + 1.0) / (n + 2.0)
        lines = []
        for name, value, color, line in (
            ("eq. 39 as printed", 2.0 * math.pi * ratio, COLORS[3], "-"),
            ("with 1/(2π)", ratio, COLORS[1], "-"),
            ("with (n + 2)/(2π)", np.ones(n.size), COLORS[2], "--"),
        ):
            lines += right.plot(n, value, color=color, linestyle=line, label=name)
        right.set_xscale("log")
        right.set_xlim(n[0], n[-1])
        right.set_ylim(0.0, 7.0)
        right.set_xlabel("exponent n")
        right.set_ylabel("integral of D n.h")
        plotting.add_legend(figure, left, lines)
    return figure


def draw_diffuse(field: pd.DataFrame, curves: pd.DataFrame) -> Figure:
    """Room for a diffuse term over R_s, and curves over the angle."""
    with plotting.style():
        figure, (left, right) = plotting.new_figure(2, width=8.6, height=3.7)
        for color, (n, own) in zip(COLORS, field.groupby("n"), strict=True):
            left.plot(own["r_s"], own["room"], color=color, label=f"n = {n:,.0f}")
        left.plot((0.0, 1.0), (1.0, 0.0), color="#888888", linewidth=0.9, zorder=1.2)
        left.set_xlim(0.0, 1.0)
        left.set_ylim(0.0, 1.02)
        left.set_xlabel("R_s")
        left.set_ylabel("largest R_d that conserves energy")
        left.set_title("Lambert's term, R_d/π")
        drawn = []
        for name, text, line in (
            ("lambert", "R_d/π", "-"),
            ("shared", "R_d (1 - R_s)/π", (0, (1.2, 1.4))),
            ("paper", "the model's own", "--"),
        ):
            drawn += right.plot(
                *(curves["theta_deg"], curves[name]), color="#222222", linestyle=line, label=text
            )
        right.set_title(f"n = 1000, R_s = {R_S:g}, R_d = 1")
        right.set_xlim(0.0, 90.0)
        right.set_xticks(np.arange(0.0, 91.0, 15.0))
        right.set_xlabel("angle of incidence (degrees)")
        right.set_ylabel("albedo")
        right.axhline(1.0, color="#888888", linewidth=0.9, zorder=1.5)
        right.set_ylim(0.0, 1.75)
        plotting.add_legend(figure, left, drawn, columns=4)
    return figure
