"""Do the albedos of the reciprocal Phong and Blinn lobes follow cos(theta) as their exponent grows?

A mirror would reflect everything. The paper says that a narrow reciprocal lobe with a constant
factor reflects cos(theta) instead. The largest distance between the albedo and cos(theta) over all
angles is measured for exponents from 10 to 1e8, with the place where it is and its rate in n.

For Phong's lobe the place is known. With V at the angle alpha from R and at the azimuth psi about
it, n.v = cos(theta) cos(alpha) + sin(theta) sin(alpha) cos(psi), of which the lobe has the mean
cos(theta) if views below the horizon count as negative, so that

    a - cos(theta) = (n + 2)/(2 pi) int (r.v)^n max(-n.v, 0) dV:

it is not negative. Where n.v < 0, its derivative in cos(theta) is positive, so the distance is
largest at grazing incidence, where it is (n + 2)/(2 pi) B((n + 1)/2, 3/2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

import albedo
from albedo import plotting
from albedo.estimate import format_value
from albedo.studies import Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from albedo.studies import Context

STUDY = Study(
    name="nns_mirror_limit",
    title="Narrow lobes and the cosine",
    paper="NNS",
    claims=("N1",),
)

SAME = 0.01
"""Two curves that are closer than this look the same in a figure."""

NAMES = {"phong": "reciprocal Phong", "blinn": "reciprocal Blinn"}
# What is compared: model, power of the cosine.
PAIRS = (("phong", 1), ("blinn", 1), ("blinn", 2))
TARGETS = {1: "cos θ", 2: "cos² θ"}
DRAWN = (10.0, 100.0, 1e4)
_ROUNDS, _STEPS = 4, 8


@dataclass(frozen=True)
class Distance:
    """The largest distance between an albedo and a power of the cosine.

    Attributes
    ----------
    value, error : float
        The largest distance, and its bound where the albedo is smooth between the angles tried.
    cos_theta : float
        Where it is.
    above : bool
        Whether the albedo is the larger one there.
    """

    value: float
    error: float
    cos_theta: float
    above: bool


def run(context: Context) -> None:
    """Largest distances and their rates, verdicts, and three views of the limit."""
    exponents = np.geomspace(10.0, 1e8, 29 if context.full else 8)
    rtol = 1e-11 if context.full else 1e-10
    context.setting(rtol=rtol)
    rows = []
    for done, n in enumerate(exponents):
        context.progress(done, len(exponents), f"n = {n:.3g}")
        for name, power in PAIRS:
            found = largest_distance(name, float(n), power, rtol)
            rows.append(
                {
                    "model": name,
                    "target": TARGETS[power],
                    "n": n,
                    "distance": found.value,
                    "distance_error": found.error,
                    "cos_theta": found.cos_theta,
                    "theta_deg": math.degrees(math.acos(found.cos_theta)),
                    "albedo_above": found.above,
                }
            )
    frame = with_rates(pd.DataFrame(rows))
    context.table(
        "distances",
        frame,
        "Largest distance over all angles, where it is, and its power of n since the row before",
        loose={"cos_theta": 1e-4, "theta_deg": 0.01},
    )
    judge(context, frame)
    remark(context, frame)
    context.figure(
        "distances_figure",
        draw_distances(frame),
        "Largest distance between an albedo and a power of cos θ. The dotted line is "
        "(2πn)^(-1/2); Blinn's lobe stays away from cos θ.",
    )
    context.figure(
        "albedo_figure",
        draw_albedos(),
        "Albedos of both lobes beside cos θ and cos² θ (grey).",
    )
    context.figure(
        "profile_figure",
        draw_profiles(rtol),
        "What Phong's albedo has above cos θ, both in units of n^(-1/2): the black line is the "
        "limit φ(x) - x Φ(-x), with φ and Φ of the normal distribution.",
    )


def largest_distance(name: str, n: float, power: int, rtol: float) -> Distance:
    """The largest |a - cos^power| over all angles of incidence, closed in on from a grid."""
    model = albedo.model(name, n=n)
    cosines = np.unique(
        np.concatenate(([0.0, 1.0], np.linspace(0.0, 1.0, 65), np.geomspace(1e-6, 1.0, 49)))
    )
    for _ in range(_ROUNDS):
        found = albedo.directional_albedo(model, cosines, rtol=rtol)
        difference = found.value - cosines**power
        top = int(np.argmax(np.abs(difference)))
        best = Distance(
            float(abs(difference[top])),
            float(found.error[top]) + 2.0 * missed(cosines, difference, top),
            float(cosines[top]),
            bool(difference[top] > 0.0),
        )
        low, high = cosines[max(top - 1, 0)], cosines[min(top + 1, cosines.size - 1)]
        cosines = np.unique(np.append(np.linspace(low, high, 2 * _STEPS + 1), best.cos_theta))
    return best


def missed(cosines: np.ndarray, values: np.ndarray, top: int) -> float:
    """What a parabola through the largest value and its neighbours has above it."""
    if top in (0, cosines.size - 1):
        # An end of the range, with values that fall from there on: nothing is between.
        return 0.0
    x, y = cosines[top - 1 : top + 2], values[top - 1 : top + 2]
    left, right = (y[1] - y[0]) / (x[1] - x[0]), (y[2] - y[1]) / (x[2] - x[1])
    curvature = 2.0 * (right - left) / (x[2] - x[0])
    return float(abs(curvature) * max(x[1] - x[0], x[2] - x[1]) ** 2 / 8.0)


def with_rates(frame: pd.DataFrame) -> pd.DataFrame:
    """Add d ln(distance)/d ln(n) between a row and the one before of the same kind."""
    pieces = []
    for _, group in frame.groupby(["model", "target"], sort=False):
        size, error = group["distance"].to_numpy(), group["distance_error"].to_numpy()
        step = np.diff(np.log(group["n"].to_numpy()))
        relative = error / (size - error)
        # log1p of the relative change: that of Blinn's lobe is as small as 1e-7.
        rate = np.log1p(np.diff(size) / size[:-1]) / step
        pieces.append(
            group.assign(
                power_of_n=np.append(np.nan, rate),
                power_of_n_error=np.append(np.nan, (relative[1:] + relative[:-1]) / step),
            )
        )
    return pd.concat(pieces, ignore_index=True)


def of_pair(frame: pd.DataFrame, name: str, power: int) -> pd.DataFrame:
    """Rows of a model and a power of the cosine, ascending in n."""
    found: pd.DataFrame = frame[(frame["model"] == name) & (frame["target"] == TARGETS[power])]
    return found


def phong_at_grazing(n: float) -> float:
    """(n + 2)/(2 pi) B((n + 1)/2, 3/2): Phong's albedo at grazing incidence.

    In more digits than a float has, as logarithms of gamma functions of the size of n are
    subtracted.
    """
    import mpmath

    with mpmath.workdps(40):
        return float((n + 2.0) / (2.0 * mpmath.pi) * mpmath.beta(0.5 * (n + 1.0), 1.5))


def judge(context: Context, frame: pd.DataFrame) -> None:
    """N1: both lobes, the distance that is left and whether it still falls."""
    for name, title in NAMES.items():
        last = of_pair(frame, name, 1).iloc[-1]
        context.claim(
            "N1",
            f"As n grows, the albedo of the {title} lobe follows cos θ.",
            value=last["distance"],
            error=last["distance_error"],
            criterion=f"< {SAME}",
            quantity=f"largest distance to cos θ over all angles, n = {last['n']:.0e}",
            figure="distances_figure",
        )
        context.claim(
            "N1",
            f"The distance of the albedo of the {title} lobe from cos θ falls as n grows.",
            value=last["power_of_n"],
            error=last["power_of_n_error"],
            criterion="< 0",
            quantity=f"power of n of the largest distance, before n = {last['n']:.0e}",
            figure="distances_figure",
        )
    blinn, square = (of_pair(frame, "blinn", power).iloc[-1] for power in (1, 2))
    phong = of_pair(frame, "phong", 1).iloc[-1]
    context.explain(
        "N1",
        "The statement is right for Phong's lobe, "
        f"{format_value(phong['distance'], phong['distance_error'])} away at n = {phong['n']:.0e}. "
        "A lobe (n.h)^n with a constant factor has one cosine more: solid angles of V are 4 (v.h) "
        "times those of H, and a narrow lobe has v.h = n.v = cos θ, so that a = c ∫ (n.h)^n (n.v) "
        "4 (v.h) dH tends to cos² θ when c makes it 1 at normal incidence. The distance to cos θ "
        f"then tends to 1/4, at 60°; at n = {blinn['n']:.0e} it is "
        f"{format_value(blinn['distance'], blinn['distance_error'])} at {blinn['theta_deg']:.2f}°, "
        f"while that to cos² θ is {format_value(square['distance'], square['distance_error'])}. "
        "The statement would be right for the lobe over v.h, which is how a density of half "
        "vectors becomes one of views. What the paper concludes is not touched by this: Blinn's "
        "narrow lobe loses the more, and needs pumping-up as much.",
    )


def remark(context: Context, frame: pd.DataFrame) -> None:
    """Rates, places, and the closed form beside the measured numbers."""
    phong, blinn, square = (of_pair(frame, *pair) for pair in PAIRS)
    exact = np.array([phong_at_grazing(n) for n in phong["n"]])
    off = float(np.max(np.abs(phong["distance"] / exact - 1.0)))
    last = phong.iloc[-1]
    scaled = math.sqrt(2.0 * math.pi * last["n"])
    context.note(
        "Phong: the largest distance is at grazing incidence for every n, where the albedo is "
        "(n + 2)/(2π) B((n + 1)/2, 3/2), which it agrees with to "
        f"{off:.0e}. It falls as (2πn)^(-1/2): times (2πn)^(1/2) it is "
        f"{format_value(scaled * last['distance'], scaled * last['distance_error'])} at n = "
        f"{last['n']:.0e}, with the power "
        f"{format_value(last['power_of_n'], last['power_of_n_error'])} of n before."
    )
    end, near = blinn.iloc[-1], square.iloc[-1]
    first = blinn.iloc[0]
    context.note(
        f"Blinn: the distance to cos θ rises, from {format_value(*both(first))} at "
        f"{first['theta_deg']:.2f}° for n = {first['n']:g} to {format_value(*both(end))} at "
        f"{end['theta_deg']:.2f}° for n = {end['n']:.0e}; the albedo is the smaller one there. "
        f"The distance to cos² θ is {format_value(*both(near))}, n times it "
        f"{format_value(near['n'] * near['distance'], near['n'] * near['distance_error'])}, at "
        f"{near['theta_deg']:.2f}°."
    )


def both(row: pd.Series) -> tuple[float, float]:
    """A distance and its bound."""
    return float(row["distance"]), float(row["distance_error"])


def draw_distances(frame: pd.DataFrame) -> Figure:
    """Largest distances against n, both axes logarithmic."""
    styles: dict[tuple[str, int], dict[str, Any]] = {
        ("phong", 1): {"marker": "o", "linestyle": "-"},
        ("blinn", 1): {"marker": "s", "linestyle": "-"},
        ("blinn", 2): {"marker": "^", "linestyle": (0, (6, 2))},
    }
    with plotting.style():
        figure, (axes,) = plotting.new_figure(height=3.8)
        for (name, power), look in styles.items():
            rows = of_pair(frame, name, power)
            axes.plot(
                *(rows["n"], rows["distance"]),
                color=plotting.color(name),
                markersize=4,
                label=f"{NAMES[name]}, to {TARGETS[power]}",
                **look,
            )
        n = np.array([10.0, 1e8])
        axes.plot(
            *(n, (2.0 * math.pi * n) ** -0.5),
            color="#222222",
            linestyle=(0, (1.2, 1.4)),
            linewidth=1.1,
            label="$(2\\pi n)^{-1/2}$",
        )
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_ylim(top=1.0)
        axes.set_xlabel("exponent n")
        axes.set_ylabel("largest distance of the albedo")
        plotting.add_legend(figure, axes, columns=2)
    return figure


def draw_albedos() -> Figure:
    """Albedos against the angle, a panel for each lobe."""
    dashes: tuple[Any, ...] = ((0, (1.2, 1.4)), (0, (6, 2)), "-")
    cosines = plotting.angle_grid()
    theta = np.degrees(np.arccos(cosines))
    with plotting.style():
        figure, panels = plotting.new_figure(2, 7.4, 3.4)
        for axes, (name, title) in zip(panels, NAMES.items(), strict=True):
            for power, width in ((1, 3.2), (2, 1.6)):
                axes.plot(
                    *(theta, cosines**power),
                    color="#bbbbbb",
                    linewidth=width,
                    label=f"{TARGETS[power]}",
                )
            for n, dash in zip(DRAWN, dashes, strict=True):
                found = albedo.directional_albedo(albedo.model(name, n=n), cosines, rtol=1e-6)
                axes.plot(
                    *(theta, found.value), color=plotting.color(name), linestyle=dash, linewidth=1.4
                )
            axes.set_title(title)
            axes.set_xlim(0.0, 90.0)
            axes.set_xticks(np.arange(0.0, 91.0, 15.0))
            axes.set_ylim(0.0, 1.05)
            axes.set_xlabel("angle of incidence (degrees)")
        panels[0].set_ylabel("directional albedo")
        from matplotlib.lines import Line2D

        extra = [
            Line2D([], [], color="#222222", linestyle=dash, label=f"n = {n:g}")
            for n, dash in zip(DRAWN, dashes, strict=True)
        ]
        plotting.add_legend(figure, panels[0], extra)
    return figure


def draw_profiles(rtol: float) -> Figure:
    """What Phong's albedo has above the cosine near the horizon, rescaled."""
    from scipy.special import ndtr

    x = np.linspace(0.0, 4.0, 161)
    marks: dict[float, dict[str, Any]] = {
        10.0: {"color": "#56B4E9", "linestyle": (0, (1.2, 1.4))},
        30.0: {"color": "#0072B2", "linestyle": (0, (6, 2))},
        100.0: {"color": "#332288", "linestyle": (0, (6, 1.6, 1.2, 1.6))},
        1e6: {"color": "#E69F00", "linestyle": "-", "linewidth": 4.0},
    }
    limit = np.exp(-0.5 * x**2) / math.sqrt(2.0 * math.pi) - x * ndtr(-x)
    with plotting.style():
        figure, (axes,) = plotting.new_figure(height=3.6)
        for n, look in marks.items():
            own = x[x / math.sqrt(n) <= 1.0]
            cosines = own / math.sqrt(n)
            found = albedo.directional_albedo(albedo.model("phong", n=n), cosines, rtol=rtol)
            axes.plot(own, math.sqrt(n) * (found.value - cosines), label=f"n = {n:g}", **look)
        axes.plot(x, limit, color="#222222", linewidth=1.0, label="limit")
        axes.set_xlim(0.0, 4.0)
        axes.set_yscale("log")
        axes.set_ylim(1e-6, 1.0)
        axes.set_xlabel("cos θ · n$^{1/2}$ (grazing to the left)")
        axes.set_ylabel("(a - cos θ) · n$^{1/2}$")
        plotting.add_legend(figure, axes)
    return figure
