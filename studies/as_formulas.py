"""Do three formulas hold on which Ashikhmin and Shirley's energy argument rests?

The density p_h of half vectors (eq. 5) is to integrate to one over the hemisphere, for any two
exponents. The smallest k.h of a direction k above the horizon (eq. 14) is to be at least (k.n)/2.
And the diffuse term is to send back what the bound on the specular one leaves, which fixes its
constant 28/(23 pi). Each is computed by quadrature or by a search, and held to its closed form.
"""

from __future__ import annotations

import itertools
import math
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

import albedo
from albedo import fresnel, plotting
from albedo.analysis.half_vectors import integral_of_density, least_k_dot_h
from albedo.estimate import format_value
from albedo.studies import Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from albedo.studies import Context

STUDY = Study(
    name="as_formulas",
    title="Three formulas of Ashikhmin and Shirley",
    paper="AS",
    claims=("A1", "A4", "A6"),
)

EXPONENTS = (0.0, 1.0, 100.0, 1e4, 1e8)
MORE_EXPONENTS = (0.0, 0.1, 1.0, 10.0, 100.0, 1e3, 1e4, 1e6, 1e8)
CONSTANT = 28.0 / (23.0 * math.pi)
EPS = float(np.finfo(float).eps)


def run(context: Context) -> None:
    """Integrate p_h, search for the smallest k.h, and measure the constant."""
    rtol = 1e-12
    context.setting(rtol=rtol)
    densities = integrate_densities(MORE_EXPONENTS if context.full else EXPONENTS, rtol)
    context.table("densities", densities, "Integral of p_h over the hemisphere")
    judge_densities(context, densities)
    context.progress(1, 3, "smallest k.h")
    wide = np.cos(np.radians(np.arange(0.0, 86.0, 2.5 if context.full else 5.0)))
    cosines = np.concatenate((wide, np.geomspace(0.05, 1e-12, 61 if context.full else 16)))
    least = search_least(cosines)
    context.table("least_k_dot_h", least, "The smallest k.h: by a search, and in closed form")
    context.figure(
        "least_k_dot_h_figure",
        draw_least(least),
        "Left: the smallest k.h over k.n, by a search (points) and in closed form (line). Right: "
        "how far its square is above that of the bound (k.n)/2, which it meets at grazing angles.",
    )
    judge_least(context, least)
    context.progress(2, 3, "the diffuse constant")
    diffuse = measure_constant(rtol)
    context.table("diffuse", diffuse, "The constant that makes the diffuse albedo what it shall be")
    judge_constant(context, diffuse)


def integrate_densities(exponents: tuple[float, ...], rtol: float) -> pd.DataFrame:
    """The integral for every pair of exponents."""
    rows = []
    for n_u, n_v in itertools.combinations_with_replacement(exponents, 2):
        model = albedo.model("ashikhmin_shirley", n_u=n_u, n_v=n_v)
        value, error = integral_of_density(model, rtol)
        rows.append({"n_u": n_u, "n_v": n_v, "integral": value, "integral_error": error})
    return pd.DataFrame(rows)


def judge_densities(context: Context, densities: pd.DataFrame) -> None:
    """Is it one?"""
    farthest = (densities["integral"] - 1.0).abs() + densities["integral_error"]
    worst = densities.loc[farthest.idxmax()]
    context.claim(
        "A1",
        "p_h (eq. 5) integrates to one over the hemisphere for all exponents.",
        value=worst["integral"],
        error=worst["integral_error"],
        criterion="= 1 +- 1e-6",
        quantity=f"of {len(densities)} integrals the one that is farthest from 1 or least certain",
        table="densities",
    )
    safe = densities[(densities["n_u"] >= 1.0) & (densities["n_v"] >= 1.0)]
    off = float(((safe["integral"] - 1.0).abs() + safe["integral_error"]).max())
    context.note(
        "In closed form: along a meridian of azimuth φ the integral of (n.h)^e is 1/(e + 1), e = "
        "n_u cos^2 φ + n_v sin^2 φ, and that of 1/((n_u + 1) cos^2 φ + (n_v + 1) sin^2 φ) over all "
        "azimuths is 2π/sqrt((n_u + 1)(n_v + 1)). So p_h integrates to 1 exactly. By quadrature, "
        f"for exponents from 1 up, it does to {off:.0e}; where one exponent is below 1, powers of "
        "n.h that vary with the azimuth end in a root at the horizon, and quadrature leaves "
        f"{float(farthest.max()):.0e}."
    )


def search_least(cosines: np.ndarray) -> pd.DataFrame:
    """The smallest k.h over all directions of the hemisphere, by descent from several starts."""
    from scipy.optimize import minimize

    closed = least_k_dot_h(cosines)
    rows = []
    for c, exact in zip(cosines, closed, strict=True):
        elevation = math.asin(c)

        def ratio(x: np.ndarray, e: float = elevation, unit: float = float(exact)) -> float:
            # |k + v|/2 for v of elevation e x and azimuth e y from the plane opposite to k, with
            # cos(e) - cos(e_v) cos(psi) as a sum of products: v is nearly opposite at grazing k.
            e_v, psi = e * x[0], e * x[1]
            up = math.sin(e) + math.sin(e_v)
            along = 2.0 * math.sin(0.5 * (e_v + e)) * math.sin(0.5 * (e_v - e))
            along += 2.0 * math.cos(e_v) * math.sin(0.5 * psi) ** 2
            return 0.5 * math.hypot(up, along, math.cos(e_v) * math.sin(psi)) / unit

        most = min(1e3, 0.5 * math.pi / elevation), min(1e3, math.pi / elevation)
        found = [
            minimize(ratio, start, bounds=((0.0, most[0]), (0.0, most[1]))).fun
            for start in ((0.3, 0.2), (0.9 * most[0], 0.1), (0.5 * most[0], 0.5 * most[1]))
        ]
        # A descent ends where a step gains less than 2.2e-9 of the value.
        best = min(found)
        sine = math.sqrt((1.0 - c) * (1.0 + c))
        rows.append(
            {
                "cos_theta": c,
                "theta_deg": 90.0 - math.degrees(elevation),
                "closed_form": exact,
                "closed_form_error": 8.0 * EPS * exact,
                "search_over_closed_form": best,
                "search_over_closed_form_error": 1e-8,
                "over_k_dot_n": exact / c,
                "over_k_dot_n_error": 8.0 * EPS * exact / c,
                # (2 least/(k.n))^2 - 1 without a difference.
                "squared_ratio_less_one": (c / (1.0 + sine)) ** 2,
                "squared_ratio_less_one_error": 16.0 * EPS * (c / (1.0 + sine)) ** 2,
            }
        )
    return pd.DataFrame(rows)


def judge_least(context: Context, least: pd.DataFrame) -> None:
    """Does the search find what the formula says, and is that at least (k.n)/2?"""
    off = (least["search_over_closed_form"] - 1.0).abs()
    k = int(off.idxmax())
    context.claim(
        "A4",
        "The smallest k.h over all directions above the horizon is that of eq. 14.",
        value=float(least["search_over_closed_form"][k]),
        error=float(least["search_over_closed_form_error"][k]),
        criterion="= 1 +- 1e-6",
        quantity="what a search finds over sqrt((1 - sin θ)/2), where they differ most",
        figure="least_k_dot_h_figure",
        table="least_k_dot_h",
    )
    last = least.loc[least["squared_ratio_less_one"].idxmin()]
    context.claim(
        "A4",
        "The smallest k.h is at least (k.n)/2.",
        value=float(last["squared_ratio_less_one"]),
        error=float(last["squared_ratio_less_one_error"]),
        criterion=">= 0",
        quantity=f"smallest (2 (k.h)min/(k.n))^2 - 1, at cos θ = {last['cos_theta']:.0e}",
        figure="least_k_dot_h_figure",
        table="least_k_dot_h",
    )
    context.note(
        "k.h = |k + k2|/2 is smallest for k2 on the horizon opposite to k: cos(π/4 + θ/2) = "
        "sqrt((1 - sin θ)/2) = (k.n)/sqrt(2 (1 + sin θ)). That is (k.n)/2 times sqrt(2/(1 + "
        "sin θ)), which falls from sqrt(2) at normal incidence to 1 at grazing incidence: the "
        "bound (k.n)/2 cannot be improved by a factor."
    )


def measure_constant(rtol: float) -> pd.DataFrame:
    """The diffuse albedo over what it shall be, R_d (1 - r(k)), and the constant that follows."""
    model = albedo.model("ashikhmin_shirley", r_s=0.0, r_d=1.0, specular="none")
    cosines = np.cos(np.radians((0.0, 30.0, 60.0, 80.0, 89.0)))
    found = albedo.directional_albedo(model, cosines, rtol=rtol)
    # 1 - (1 - c/2)^5 at the five angles: the least of them is 0.04.
    wanted = 1.0 - fresnel.reflectance("schlick", 0.5 * cosines, f0=0.0)
    ratio = found.value / wanted
    error = found.error / wanted + 4.0 * EPS / wanted
    return pd.DataFrame(
        {
            "theta_deg": np.round(np.degrees(np.arccos(cosines)), 9),
            "albedo": found.value,
            "albedo_error": found.error,
            "over_one_less_bound": ratio,
            "over_one_less_bound_error": error,
            "constant": CONSTANT / ratio,
            "constant_error": CONSTANT / ratio * error / (ratio - error),
        }
    )


def closed_constant() -> Fraction:
    """1/(2 int (1 - (1 - u/2)^5) u du) from 0 to 1, the constant times pi, in whole numbers."""
    # With t = 1 - u/2: int (1 - u/2)^5 u du = 4 int t^5 (1 - t) dt from 1/2 to 1.
    half = Fraction(1, 2)
    rest = 4 * ((1 - half**6) / 6 - (1 - half**7) / 7)
    return 1 / (2 * (half - rest))


def judge_constant(context: Context, diffuse: pd.DataFrame) -> None:
    """Is it 28/(23 pi)?"""
    off = (diffuse["constant"] - CONSTANT).abs() + diffuse["constant_error"]
    worst = diffuse.loc[off.idxmax()]
    exact = closed_constant()
    context.claim(
        "A6",
        "The diffuse term has the constant 28/(23 π).",
        value=float(worst["constant"]),
        error=float(worst["constant_error"]),
        criterion=f"= {CONSTANT:.15f} +- 1e-9",
        quantity="constant with which the diffuse albedo is R_d (1 - r(k)), by quadrature",
        table="diffuse",
    )
    context.claim(
        "A6",
        "The diffuse term has the constant 28/(23 π), in closed form.",
        value=float(exact - Fraction(28, 23)),
        error=0.0,
        criterion="= 0 +- 0",
        quantity="1/(2 int (1 - (1 - u/2)^5) u du) less 28/23, in whole numbers",
        table="diffuse",
    )
    context.note(
        f"1/(2 int (1 - (1 - u/2)^5) u du) is {exact.numerator}/{exact.denominator} in whole "
        "numbers; by quadrature the constant is "
        f"{format_value(worst['constant'], worst['constant_error'])}, and 28/(23 π) is "
        f"{CONSTANT:.12f}."
    )


def draw_least(least: pd.DataFrame) -> Figure:
    """The smallest k.h over k.n, and how far it is above the bound."""
    with plotting.style():
        figure, (axes, close) = plotting.new_figure(2, 7.2, 3.5)
        color = plotting.color("ashikhmin_shirley")
        theta = np.linspace(0.0, 90.0, 361)[:-1]
        c = np.cos(np.radians(theta))
        axes.plot(theta, least_k_dot_h(c) / c, color=color, label="closed form")
        points = least["search_over_closed_form"] * least["over_k_dot_n"]
        dots: dict[str, Any] = {"color": "#222222", "markersize": 4.0, "linestyle": "none"}
        axes.plot(
            *(least["theta_deg"], points),
            marker="o",
            label="search over the hemisphere",
            **dots,
        )
        axes.axhline(
            0.5, color="#0072B2", linestyle=(0, (6, 2)), linewidth=1.2, label="the bound, 1/2"
        )
        axes.set_xlim(0.0, 90.0)
        axes.set_xticks(np.arange(0.0, 91.0, 15.0))
        axes.set_ylim(0.45, 0.75)
        axes.set_xlabel("angle of k to the normal (degrees)")
        axes.set_ylabel("smallest k.h over k.n")
        close.plot(least["cos_theta"], least["squared_ratio_less_one"], color=color)
        close.set_xscale("log")
        close.set_yscale("log")
        close.set_xlim(1.0, 1e-12)
        close.set_xticks(10.0 ** -np.arange(0.0, 13.0, 3.0))
        close.set_xlabel("k.n (grazing to the right)")
        close.set_ylabel("square over that of the bound, less 1")
        plotting.add_legend(figure, axes)
    return figure
