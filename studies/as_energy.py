"""Does Ashikhmin and Shirley's lobe conserve energy, and what is lost as its exponents grow?

With a Fresnel factor of 1 the albedo is to stay below one for all directions and exponents
(eqs. 6 to 10), and with any R_s below the bound r(k) = R_s + (1 - R_s)(1 - (k.n)/2)^5 (eq. 15), on
which the diffuse term is built. In the limit of large exponents max(n.k1, n.k2) is to make the lobe
reflect everything at any angle that is not exactly grazing. How an exponent and an angle play
together in that limit is one function of one variable.
"""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

import albedo
from albedo import fresnel, plotting
from albedo.analysis.energy import energy_map
from albedo.analysis.grazing import power
from albedo.analysis.half_vectors import horizon_variable, lost_in_the_limit
from albedo.estimate import format_value
from albedo.grammar import parse_model
from albedo.quadrature import albedo_rows
from albedo.studies import Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from albedo.brdf import Model
    from albedo.studies import Context

STUDY = Study(
    name="as_energy",
    title="Energy of Ashikhmin and Shirley's lobe",
    paper="AS",
    claims=("A3", "A5", "A11"),
)

EXPONENTS = (0.0, 100.0, 1e9)
MORE_EXPONENTS = (0.0, 1.0, 10.0, 100.0, 1e4, 1e9)
# Angles at which the limit of large exponents is taken: 60, 84.3 and 89.4 degrees.
FIXED = (0.5, 0.1, 0.01)
# What a loss is subtracted from is known to this.
DIGITS = 1e-12
# Exponents of the curves that are drawn: along u, along v, azimuth of the light in degrees.
LOBES = (
    (10.0, 10.0, 0.0),
    (1e3, 1e3, 0.0),
    (1e5, 1e5, 0.0),
    (1e7, 1e7, 0.0),
    (1e9, 1e9, 0.0),
    (1e7, 1e4, 30.0),
)
_COLORS = ("#999933", "#E69F00", "#D55E00", "#56B4E9", "#0072B2", "#AA4499")
_DASHES: tuple[Any, ...] = (
    *((0, (1.2, 1.4)), (0, (3, 1.6)), (0, (6, 2)), (0, (6, 1.6, 1.2, 1.6)), "-"),
    (0, (10, 2)),
)


def run(context: Context) -> None:
    """Search for the largest albedo and the smallest gap below r(k), then take the limit."""
    context.setting(rtol_search=1e-5, rtol=DIGITS)
    exponents = MORE_EXPONENTS if context.full else EXPONENTS
    found = search(context, exponents)
    # Directions of ties are any; a direction has no azimuth at normal incidence.
    context.table(
        "largest",
        found,
        "Largest and smallest albedo found by a search, with a Fresnel factor of 1",
        loose={"largest_at_cos": 1.0, "largest_at_phi_deg": 90.0},
    )
    judge_largest(context, found)
    context.progress(2, 4, "the gap below r(k)")
    gaps = measure_gaps(exponents, found, 65 if context.full else 17)
    context.table(
        "gaps",
        gaps,
        "Smallest r - R over all angles, at both ends of R_s",
        loose={"at_cos_r_s=0": 1e-3, "at_phi_deg_r_s=0": 90.0},
    )
    judge_gaps(context, gaps)
    context.progress(3, 4, "large exponents")
    tangents = np.geomspace(1e-5, 1e6, 133 if context.full else 45)
    losses = measure_losses(tangents)
    context.table("losses", losses, "1 - a against the exponents and the angle, and its limit")
    collapse = compare(losses)
    context.table("collapse", collapse, "How far 1 - a is from the function of one variable")
    limits = measure_limits(33 if context.full else 17)
    context.table("limits", limits, "1 - a against the exponent at fixed angles")
    judge_limits(context, limits, collapse)
    context.figure(
        "collapse_figure",
        draw(losses),
        "What is lost with a Fresnel factor of 1. Left: against the angle. Right: the same curves "
        "against 1/u = tan θ sqrt(cos²φ/n_u + sin²φ/n_v), and (grey) the function that they tend "
        "to; they leave it next to normal incidence, where the loss is about 4/n.",
    )


def lobe(n_u: float, n_v: float, r_s: float = 1.0) -> Model:
    """The specular lobe."""
    return albedo.model("ashikhmin_shirley", n_u=n_u, n_v=n_v, r_s=r_s)


def search(context: Context, exponents: tuple[float, ...]) -> pd.DataFrame:
    """The directions of the largest albedo for all pairs, and what is lost there."""
    frames = []
    for done, n_u in enumerate(exponents):
        context.progress(done, 2 * len(exponents), f"largest albedo for n_u = {n_u:g}")
        # The other way round everything is turned by a quarter.
        others = ",".join(f"{n_v:g}" for n_v in exponents if n_v >= n_u)
        spec = parse_model(f"ashikhmin_shirley:n_u={n_u:g},n_v=[{others}]", "A map")
        frame = energy_map(spec, rtol=1e-5).frame
        frame.insert(0, "n_u", n_u)
        frames.append(frame)
    found = pd.concat(frames, ignore_index=True)
    models = [lobe(n_u, n_v) for n_u, n_v in found[["n_u", "n_v"]].to_numpy()]
    cosine, phi = found["max_cos_theta"].to_numpy(), found["max_phi"].to_numpy()
    exact = {"rtol": DIGITS, "atol": DIGITS, "complement": True}
    there = albedo_rows(models, cosine, phi, **exact)
    # A search to 1e-5 may miss a peak of less; where lobes are narrow it is at the normal.
    normal = albedo_rows(models, np.ones(len(models)), np.zeros(len(models)), **exact)
    above = normal.value <= there.value
    lost = np.where(above, normal.value, there.value)
    error = np.where(above, normal.error, there.error)
    low = albedo_rows(
        *(models, found["min_cos_theta"].to_numpy(), found["min_phi"].to_numpy()),
        rtol=1e-10,
        atol=0.0,
    )
    return pd.DataFrame(
        {
            "n_u": found["n_u"],
            "n_v": found["n_v"],
            "largest": 1.0 - lost,
            "largest_error": error,
            "one_less_largest": lost,
            "one_less_largest_error": error,
            "largest_at_cos": np.where(above, 1.0, cosine),
            "largest_at_phi_deg": np.degrees(np.where(above, 0.0, phi)),
            "smallest": low.value,
            "smallest_error": low.error,
        }
    )


def judge_largest(context: Context, found: pd.DataFrame) -> None:
    """Is every albedo at most one?"""
    top = found.loc[found["one_less_largest"].idxmin()]
    context.claim(
        "A3",
        "With c' = 1 and a Fresnel factor of 1 the lobe conserves energy for all directions.",
        value=float(top["one_less_largest"]),
        error=float(top["one_less_largest_error"]),
        criterion=">= 0",
        quantity=(
            f"smallest 1 - a over all directions, of {len(found)} pairs of exponents from "
            f"{found['n_u'].min():g} to {found['n_v'].max():g}"
        ),
        figure="collapse_figure",
        table="largest",
    )
    equal = found[found["n_u"] == found["n_v"]]
    context.note(
        "A draw of the lobe has the weight n.k2/max(n.k1, n.k2), which is at most 1, and 0 below "
        "the horizon; the albedo is its mean, so it is below 1 for all exponents. The largest over "
        "all directions, for equal exponents, leaves 1 - a = "
        + "; ".join(
            f"{format_value(row.one_less_largest, row.one_less_largest_error)} (n = {row.n_u:g})"
            for row in equal.itertuples()
        )
        + ": with large exponents it is at normal incidence, and 4/n."
    )


def measure_gaps(exponents: tuple[float, ...], found: pd.DataFrame, steps: int) -> pd.DataFrame:
    """The smallest r - R at R_s = 0, and at R_s = 1, where r is 1.

    Both are linear in R_s, F being R_s + (1 - R_s)(1 - k.h)^5.
    """
    wide = np.cos(np.linspace(0.0, 1.5, steps, endpoint=False))
    grid = np.concatenate((wide, np.geomspace(math.cos(1.5), 1e-6, 2 * steps)))
    rows = []
    for n_u, n_v in itertools.combinations_with_replacement(exponents, 2):
        model = lobe(n_u, n_v, r_s=0.0)
        cosines = grid
        turns = np.linspace(0.0, 0.5 * math.pi, 1 if model.isotropic else 5)
        for _ in range(4):
            dark = albedo.directional_albedo(model, cosines[:, None], turns, rtol=1e-8, atol=1e-10)
            bound = fresnel.reflectance("schlick", 0.5 * cosines, f0=0.0)[:, None]
            gap = bound - dark.value
            i, j = (int(k) for k in np.unravel_index(int(np.argmin(gap)), gap.shape))
            near = gap[max(i - 1, 0) : i + 2, j]
            # Where the gap is convex it is no farther below than a neighbour is above.
            more = float(near.max() - near.min()) if 0 < i < cosines.size - 1 else 0.0
            least = float(gap[i, j]), float(dark.error[:, j].max()) + more
            share = float(dark.value[i, j] / bound[i, 0])
            at, phi = float(cosines[i]), float(turns[j])
            # Closer in between the neighbours.
            first, last = cosines[max(i - 1, 0)], cosines[min(i + 1, cosines.size - 1)]
            cosines, turns = np.geomspace(first, last, 9), turns[j : j + 1]
        one = found[(found["n_u"] == n_u) & (found["n_v"] == n_v)].iloc[0]
        rows.append(
            {
                "n_u": n_u,
                "n_v": n_v,
                "gap_r_s=0": least[0],
                "gap_r_s=0_error": least[1],
                "at_cos_r_s=0": at,
                "at_phi_deg_r_s=0": math.degrees(phi) if at < 1.0 else 0.0,
                "share_r_s=0": share,
                "share_r_s=0_error": least[1] / (1.0 - least[0]) + 1e-12,
                "gap_r_s=1": float(one["one_less_largest"]),
                "gap_r_s=1_error": float(one["one_less_largest_error"]),
            }
        )
    return pd.DataFrame(rows)


def judge_gaps(context: Context, gaps: pd.DataFrame) -> None:
    """Is R below r?"""
    for name, words in (("gap_r_s=0", "R_s = 0"), ("gap_r_s=1", "R_s = 1")):
        low = gaps.loc[gaps[name].idxmin()]
        context.claim(
            "A5",
            f"R(k) <= r(k) (eq. 15) at {words}; r - R is linear in R_s.",
            value=float(low[name]),
            error=float(low[f"{name}_error"]),
            criterion=">= 0",
            quantity=(
                f"smallest r - R over all directions, at n_u = {low['n_u']:g}, n_v = {low['n_v']:g}"
            ),
            figure="collapse_figure",
            table="gaps",
        )
    least = gaps.loc[gaps["gap_r_s=0"].idxmin()]
    n = least["n_u"]
    context.note(
        "r - R is linear in R_s, so its minimum is at an end. At R_s = 1 r is 1, and the gap is "
        "what the lobe loses, 4/n at normal incidence. At R_s = 0 it is smallest at "
        f"cos θ = {least['at_cos_r_s=0']:.3g} for n_u = {n:g}, n_v = {least['n_v']:g}: "
        f"{format_value(least['gap_r_s=0'], least['gap_r_s=0_error'])}. There, for large n, r - R "
        "is about 5/2 cos θ + sqrt(2/(π n))/cos θ, the first from the half of k.n in r and the "
        "second what the lobe loses; that is 2 (5/2 sqrt(2/π))^(1/2) n^(-1/4) at least, "
        f"{2.0 * math.sqrt(2.5 * math.sqrt(2.0 / math.pi)) * n**-0.25:.4f} here. So in the limit "
        "of large exponents neither end leaves a gap."
    )


def measure_losses(tangents: np.ndarray) -> pd.DataFrame:
    """1 - a of the lobes that are drawn, and the limit for each."""
    cosines = 1.0 / np.hypot(1.0, tangents)
    frames = []
    for n_u, n_v, degrees in LOBES:
        phi = math.radians(degrees)
        lost = albedo.directional_albedo(
            lobe(n_u, n_v), cosines, phi, rtol=DIGITS, atol=DIGITS, complement=True
        )
        # The same function of cot(theta), which the cosine next to the normal does not tell.
        u = horizon_variable(math.sqrt(0.5), n_u, n_v, phi) / tangents
        frames.append(
            pd.DataFrame(
                {
                    "n_u": n_u,
                    "n_v": n_v,
                    "phi_deg": degrees,
                    "tan_theta": tangents,
                    "cos_theta": cosines,
                    "u": u,
                    "lost": lost.value,
                    "lost_error": lost.error,
                    "limit": lost_in_the_limit(u),
                }
            )
        )
    return pd.concat(frames, ignore_index=True)


def compare(losses: pd.DataFrame) -> pd.DataFrame:
    """The largest distance from the limit, curve by curve, and times the smaller exponent."""
    rows = []
    for (n_u, n_v, degrees), group in losses.groupby(["n_u", "n_v", "phi_deg"]):
        off = group["lost"] - group["limit"]
        worst = group.loc[off.abs().idxmax()]
        distance, error = abs(worst["lost"] - worst["limit"]), worst["lost_error"]
        n = min(n_u, n_v)
        rows.append(
            {
                "n_u": n_u,
                "n_v": n_v,
                "phi_deg": degrees,
                "distance": distance,
                "distance_error": error,
                "at_tan_theta": worst["tan_theta"],
                "distance_times_n": n * distance,
                "distance_times_n_error": n * error,
            }
        )
    return pd.DataFrame(rows)


def measure_limits(count: int) -> pd.DataFrame:
    """1 - a at fixed angles, as equal exponents grow."""
    exponents = np.geomspace(1.0, 1e9, count)
    rows = []
    for cosine in FIXED:
        models = [lobe(float(n), float(n)) for n in exponents]
        lost = albedo_rows(
            *(models, np.full(count, cosine), np.zeros(count)),
            rtol=DIGITS,
            atol=DIGITS,
            complement=True,
        )
        rows.append(
            pd.DataFrame(
                {
                    "cos_theta": cosine,
                    "n": exponents,
                    "lost": lost.value,
                    "lost_error": lost.error,
                    "limit": lost_in_the_limit(horizon_variable(cosine, exponents, exponents)),
                }
            )
        )
    return pd.concat(rows, ignore_index=True)


def judge_limits(context: Context, limits: pd.DataFrame, collapse: pd.DataFrame) -> None:
    """Does the loss at a fixed angle vanish as exponents grow, and how?"""
    said = []
    for cosine in FIXED:
        group = limits[limits["cos_theta"] == cosine]
        # Three decades, in descending order of 1/n.
        last = group[group["n"] > 0.9e6]
        p, error = power(
            *(1.0 / last["n"].to_numpy(), last["lost"].to_numpy(), last["lost_error"].to_numpy())
        )
        end = group.iloc[-1]
        theta = 90.0 - math.degrees(math.asin(cosine))
        context.claim(
            "A11",
            f"In the limit n → ∞ everything is reflected, at {theta:.2f}°.",
            value=p,
            error=error,
            criterion="> 0",
            quantity="exponent p of 1 - a ~ n^-p, n from 1e6 to 1e9",
            figure="collapse_figure",
            table="limits",
        )
        said.append(
            f"at {theta:.2f}° it falls as n^-p, p = {format_value(p, error)}, to "
            f"{format_value(end['lost'], end['lost_error'])} at n = {end['n']:.0e}"
        )
    context.note("1 - a vanishes at every fixed angle: " + "; ".join(said) + ".")
    equal = collapse[collapse["n_u"] == collapse["n_v"]]
    context.note(
        "Exponent and angle act through u = cot θ/sqrt(cos^2 φ/n_u + sin^2 φ/n_v) alone, which is "
        "sqrt(n) cot θ for equal exponents: 1 - a tends to P(-u/2) + (2/u)(p(0) - p(u/2)), p and P "
        "being the normal density and distribution. That is 1/2 at u = 0, and sqrt(2/π)/u for "
        "large u. What is left is of the order of 1/n, most of it next to normal incidence: times "
        "n it is up to "
        + "; ".join(
            f"{format_value(row.distance_times_n, row.distance_times_n_error)} (n = {row.n_u:g})"
            for row in equal.itertuples()
        )
        + "."
    )
    context.note(
        "The limit is not uniform in the angle: for every n half of the light is lost at angles "
        "with u small, and half of that half at "
        f"u = {quarter():.4f}, where cos θ is about {quarter():.2f}/sqrt(n): 89.9° for "
        f"n = {quarter() ** 2 / math.tan(math.radians(0.1)) ** 2:.2g}."
    )


def quarter() -> float:
    """The u at which a quarter of the light is lost."""
    from scipy.optimize import brentq

    return float(brentq(lambda u: float(lost_in_the_limit(u)) - 0.25, 0.1, 100.0, xtol=1e-12))


def draw(losses: pd.DataFrame) -> Figure:
    """Losses against the cosine, and against the variable that joins them."""
    with plotting.style():
        figure, (left, right) = plotting.new_figure(2, 7.4, 3.7)
        for (n_u, n_v, degrees), color, dashes in zip(LOBES, _COLORS, _DASHES, strict=True):
            group = losses[
                (losses["n_u"] == n_u) & (losses["n_v"] == n_v) & (losses["phi_deg"] == degrees)
            ]
            label = f"n = $10^{round(math.log10(n_u))}$"
            if n_u != n_v:
                label = (
                    f"$n_u$ = $10^{round(math.log10(n_u))}$, $n_v$ = $10^{round(math.log10(n_v))}$,"
                    f" φ = {degrees:g}°"
                )
            look = {"color": color, "linestyle": dashes}
            left.plot(group["tan_theta"], group["lost"], label=label, **look)
            right.plot(1.0 / group["u"], group["lost"], **look)
        u = np.geomspace(1e-3, 1e9, 400)
        limit: dict[str, Any] = {"color": "#c4c4c4", "linewidth": 6.0, "label": "limit"}
        right.plot(1.0 / u, lost_in_the_limit(u), zorder=1.8, **limit)
        left.plot([], [], **limit)
        for axes in (left, right):
            axes.set_xscale("log")
            axes.set_yscale("log")
            axes.set_ylim(1e-9, 1.5)
            axes.set_yticks(10.0 ** np.arange(-9.0, 1.0, 3.0))
        left.set_xlim(1e-5, 1e6)
        left.set_xticks(10.0 ** np.arange(-4.0, 7.0, 2.0))
        left.set_xlabel("tan θ (grazing to the right)")
        left.set_ylabel("share of the light that is lost, 1 - a")
        top = left.secondary_xaxis("top", functions=(np.asarray, np.asarray))
        degrees = (0.01, 1.0, 45.0, 89.0, 89.99)
        top.set_xticks(np.tan(np.radians(degrees)), [f"{d:g}°" for d in degrees])
        top.minorticks_off()
        right.set_xlim(1e-8, 1e3)
        right.set_xticks(10.0 ** np.arange(-8.0, 3.0, 2.0))
        right.set_xlabel("1/u = tan θ times the spread of slopes")
        right.tick_params(labelleft=False)
        plotting.add_legend(figure, left, columns=4)
    return figure
