"""Which density do Ashikhmin and Shirley's draws have, and where does their energy go?

The paper's eq. 20 gives the density of the reflected direction as that of the half vector over
4 (k1.h); a draft of it prints the inverse. Both are put to the test against draws by eqs. 21 and
22. What is lost by drawing is compared with what max(n.k1, n.k2) takes, and cosine sampling of the
diffuse term with exact sampling.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

import albedo
from albedo import plotting
from albedo.analysis.checks import above_horizon, chi_square, finite_draws
from albedo.brdf import Model
from albedo.estimate import format_value
from albedo.studies import Study

if TYPE_CHECKING:
    from albedo.studies import Context

STUDY = Study(
    name="as_sampling",
    title="Densities and losses of Ashikhmin and Shirley's sampling",
    paper="AS",
    claims=("A8", "A9", "A10", "A12"),
)

LEVEL = 1e-3
PRINTED, DRAFT = "eq. 20, p_h/(4 k1.h)", "the draft, 4 (k1.h)/p_h"
# Exponents along x and y, from isotropic to a ratio of 1e4.
PAIRS = ((1.0, 1.0), (100.0, 100.0), (1e4, 1e4), (10.0, 1e3), (1e4, 1.0), (100.0, 1e6))
COSINES = (0.95, 0.5, 0.1)
ANGLES = (30.0, 60.0, 80.0)


def lobe(n_u: float, n_v: float) -> Model:
    """The specular lobe with a Fresnel factor of 1."""
    return albedo.model("ashikhmin_shirley", n_u=n_u, n_v=n_v)


def run(context: Context) -> None:
    """Test both densities and the draws, split the loss, and weigh cosine sampling."""
    samples = 400_000 if context.full else 50_000
    context.setting(rtol=1e-10, seed=0, samples=samples, level=LEVEL)
    densities = judge_densities(samples)
    context.table("densities", densities, "The printed densities against draws, n = 10")
    for row in densities.to_dict("records"):
        context.claim(
            "A8",
            f"The printed density is that of the draws, at cos θ = {row['cos_theta']:g}.",
            value=row["p_value"],
            error=0.0,
            criterion=f">= {LEVEL / len(densities):.3g}",
            quantity="p-value of the chi-square test",
            kind="standard_error",
            reading=row["reading"],
            table="densities",
        )
    explain_density(context, densities)
    context.progress(1, 4, "draws")
    draws = judge_draws(samples)
    context.table("draws", draws, "Draws by eqs. 21 and 22 against eq. 20")
    context.claim(
        "A9",
        "Eqs. 21 and 22 draw h with the density p_h, up to n_u/n_v = 1e4.",
        value=float(draws["p_value"].min()),
        error=0.0,
        criterion=f">= {LEVEL / len(draws):.3g}",
        quantity=f"smallest p-value of {len(draws)} chi-square tests",
        kind="standard_error",
        table="draws",
    )
    context.progress(2, 4, "losses")
    exponents = np.geomspace(1.0, 1e6, 25 if context.full else 13)
    losses = split_losses(exponents)
    context.table("losses", losses, "What the isotropic lobe loses, and to what")
    judge_losses(context, losses)
    explain_losses(context, losses)
    context.progress(3, 4, "the diffuse term")
    diffuse = weigh_cosine(2**18 if context.full else 2**15)
    context.table(
        "diffuse",
        diffuse,
        "Cosine sampling of the diffuse term",
        loose={"effective_share_of_draws": 1e-6},
    )
    worst = diffuse.loc[diffuse["effective_share"].idxmin()]
    context.claim(
        "A12",
        "Cosine sampling of the diffuse term is sufficiently close: nine of ten draws count.",
        value=float(worst["effective_share"]),
        error=float(worst["effective_share_error"]),
        criterion="> 0.9",
        quantity="smallest effective share of the draws; exact sampling has 1",
        kind="bound",
        table="diffuse",
    )
    draw(context, losses)
    context.note(
        "Exact sampling of the diffuse term has no variance; a cosine draw has a relative standard "
        f"deviation of {np.sqrt(1.0 / worst['effective_share'] - 1.0):.3f} at every angle, because "
        "the angle of incidence is only a factor."
    )


def explain_density(context: Context, densities: pd.DataFrame) -> None:
    """Why one density fits and the other does not."""
    rows = densities.set_index("reading")
    integrals = ", ".join(f"{value:.3g}" for value in rows.loc[[DRAFT], "integral"])
    shares = ", ".join(
        format_value(value, error)
        for value, error in zip(
            rows.loc[[PRINTED], "share_above_horizon"],
            rows.loc[[PRINTED], "share_above_horizon_error"],
            strict=True,
        )
    )
    cosines = ", ".join(f"{c:g}" for c in COSINES)
    context.explain(
        "A8",
        "Where k1 is fixed, k2 turns twice as far as h: a ring at the angle α about k1, of "
        "2π sin α dα in h, becomes one of 2π sin 2α · 2 dα = 2π sin α dα · 4 cos α in k2, and "
        "cos α = k1.h. So the density in k2 is p_h/(4 k1.h), as eq. 20 has it. Over the directions "
        f"above the horizon it integrates to the share of the draws there, {shares} at cos θ = "
        f"{cosines}. The inverse that the draft prints integrates to {integrals}, and has the unit "
        "of a solid angle; it is a slip of print, which the paper put right.",
    )


def judge_densities(samples: int) -> pd.DataFrame:
    """Integrals and p-values of eq. 20 and of its inverse."""
    model = lobe(10.0, 10.0)
    readings = {
        PRINTED: model.pdf,
        DRAFT: lambda wi, wo: 1.0 / model.pdf(wi, wo),
    }
    rows = []
    for name, density in readings.items():
        for cosine in COSINES:
            found = chi_square(
                *(finite_draws(model), density, cosine),
                samples=samples,
                level=LEVEL,
                tests=len(readings) * len(COSINES),
            )
            exact, error = above_horizon(model, cosine)
            rows.append(
                {
                    "reading": name,
                    "cos_theta": cosine,
                    "integral": found.above,
                    "share_above_horizon": exact,
                    "share_above_horizon_error": error,
                    "chi_square": found.statistic,
                    "degrees": found.degrees,
                    "p_value": found.p_value,
                }
            )
    return pd.DataFrame(rows)


def judge_draws(samples: int) -> pd.DataFrame:
    """Chi-square tests of the draws for all pairs of exponents."""
    rows = []
    for n_u, n_v in PAIRS:
        model = lobe(n_u, n_v)
        for k, cosine in enumerate(COSINES):
            found = chi_square(
                *(finite_draws(model), model.pdf, cosine, 0.7),
                samples=samples,
                level=LEVEL,
                tests=len(PAIRS) * len(COSINES),
                seed=k,
            )
            rows.append(
                {
                    "n_u": n_u,
                    "n_v": n_v,
                    "cos_theta": cosine,
                    "chi_square": found.statistic,
                    "degrees": found.degrees,
                    "p_value": found.p_value,
                }
            )
    return pd.DataFrame(rows)


def split_losses(exponents: np.ndarray) -> pd.DataFrame:
    """1 - a as what falls below the horizon, and what max(n.k1, n.k2) takes from the rest.

    A draw has the weight F n.v/max(n.l, n.v), so the albedo is the mean of that.
    """
    rows = []
    for angle in ANGLES:
        cosine = float(np.cos(np.radians(angle)))
        for n in exponents:
            model = lobe(float(n), float(n))
            reflected = albedo.directional_albedo(model, cosine, rtol=1e-10)
            above, error = above_horizon(model, cosine, rtol=1e-10)
            lost, lost_error = 1.0 - float(reflected.value), float(reflected.error)
            rows.append(
                {
                    "theta_deg": angle,
                    "n": n,
                    "lost": lost,
                    "lost_error": lost_error,
                    "below_horizon": 1.0 - above,
                    "below_horizon_error": error,
                    "to_max": above - float(reflected.value),
                    "to_max_error": error + lost_error,
                }
            )
    return pd.DataFrame(rows)


def judge_losses(context: Context, losses: pd.DataFrame) -> None:
    """Is the horizon the main loss, and does it vanish as n grows?"""
    for angle, group in losses.groupby("theta_deg"):
        for least in (9.9, 990.0):
            first = group[group["n"] >= least].iloc[0]
            share = first["below_horizon"] / first["lost"]
            spread = first["below_horizon_error"] + share * first["lost_error"]
            context.claim(
                "A10",
                f"Lobes below the horizon are the main loss at {angle:g}°, n = {first['n']:.3g}.",
                value=float(share),
                error=float(spread / first["lost"]),
                criterion="> 0.5",
                quantity="share of the loss that falls below the horizon",
                table="losses",
            )
            error = spread / first["lost"]
            part = format_value(share, error) if share > error else f"less than {error:.0e}"
            context.note(
                f"At {angle:g}° and n = {first['n']:.4g}, {part} of the loss falls below the "
                f"horizon; the loss is {format_value(first['lost'], first['lost_error'])}."
            )
        last = group.iloc[-1]
        context.claim(
            "A10",
            f"What falls below the horizon vanishes as n grows, at {angle:g}°.",
            value=float(last["below_horizon"]),
            error=float(last["below_horizon_error"]),
            criterion="< 1e-6",
            quantity=f"share of the draws below the horizon at n = {last['n']:.0e}",
            table="losses",
        )
        ratio = group["lost"].iloc[-1] / group["lost"].iloc[-3]
        rate = np.log(ratio) / np.log(group["n"].iloc[-1] / group["n"].iloc[-3])
        context.note(
            f"At {angle:g}° the whole loss falls as n to the power {rate:.3f} towards n = 1e6, "
            f"where it is {group['lost'].iloc[-1]:.3g}, all of it taken by max(n.k1, n.k2)."
        )


def explain_losses(context: Context, losses: pd.DataFrame) -> None:
    """What falls with which power of n."""
    told, main = [], []
    for angle, group in losses.groupby("theta_deg"):
        last = group.iloc[-1]
        slope = np.tan(np.radians(angle))
        ratio = last["to_max"] / (slope * np.sqrt(2.0 / (np.pi * last["n"])))
        told.append(
            f"{format_value(last['to_max'], last['to_max_error'])} ({ratio:.4f}) at {angle:g}°"
        )
        more = group[group["below_horizon"] > 0.5 * group["lost"]]
        main.append(f"{more['n'].max():.3g} at {angle:g}°")
    context.explain(
        "A10",
        "A draw has the weight n.k2/max(n.k1, n.k2), so there are two losses: k2 below the "
        "horizon, and n.k2 below n.k1. For the first, h has to lean by more than half the "
        "elevation of k1, and the chance of that alone is cos((90° - θ)/2)^(n + 1): it vanishes "
        "exponentially, as the paper says. The second is half of a blur: n.k2/n.k1 - 1 spreads by "
        "2 tan θ/√n about 0, so its negative half costs tan θ √(2/(π n)) on average, a power of n. "
        f"At n = {losses['n'].max():.0e} it costs {', '.join(told)} (in brackets over that "
        "formula). So the horizon is the main loss only for small exponents, of those measured up "
        f"to n = {', '.join(main)}; beyond, it is the maximum in the denominator, which is there "
        "so that energy is conserved.",
    )


def weigh_cosine(samples: int) -> pd.DataFrame:
    """(sum w)^2/sum w^2 per draw, by quadrature and by draws."""
    model = albedo.model("ashikhmin_shirley", r_s=0.05, r_d=1.0, specular="none")

    def squared(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        return np.pi * model.eval(wi, wo) ** 2

    second = albedo.model_from(squared, lobe="diffuse", isotropic=True)
    rows = []
    for angle in (0.0, *ANGLES):
        cosine = float(np.cos(np.radians(angle)))
        first = albedo.directional_albedo(model, cosine)
        square = albedo.directional_albedo(second, cosine)
        share = float(first.value) ** 2 / float(square.value)
        relative = 2.0 * first.error / first.value + square.error / square.value
        drawn = albedo.monte_carlo_albedo(model, cosine, samples=samples, strategy="cosine")
        rows.append(
            {
                "theta_deg": angle,
                "albedo": float(first.value),
                "albedo_error": float(first.error),
                "effective_share": share,
                "effective_share_error": share * float(relative),
                "effective_share_of_draws": float(drawn.effective_samples) / samples,
            }
        )
    return pd.DataFrame(rows)


def draw(context: Context, losses: pd.DataFrame) -> None:
    """Both losses against the exponent, one colour for each angle."""
    with plotting.style():
        figure, (axes,) = plotting.new_figure()
        for color, (angle, group) in zip(
            ("#0072B2", "#D55E00", "#009E73"), losses.groupby("theta_deg"), strict=True
        ):
            seen = group[group["below_horizon"] > 1e-12]
            axes.plot(seen["n"], seen["below_horizon"], color=color, label=f"below, {angle:g}°")
            axes.plot(group["n"], group["to_max"], "--", color=color, label=f"max, {angle:g}°")
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_ylim(1e-9, 1.0)
        axes.set_xlabel("exponent n")
        axes.set_ylabel("share of the light that is lost")
        axes.legend(ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.18), frameon=False)
    context.figure(
        "losses_figure",
        figure,
        "Lost below the horizon (solid) and to max(n.k1, n.k2) (dashed), Fresnel factor 1.",
    )
