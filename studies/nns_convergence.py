"""Where does pumping-up lead, how fast, and from which models may it start?

The paper says that recursive pumping-up converges to an albedo of 1, that a* lies between a and 1,
and that the first step turns any symmetric function into a BRDF that conserves energy.

Convergence is measured where it is slowest: by the largest 1 - a over all angles up to a cosine of
0.01, up to 1e-6, and in the limit of grazing incidence. A power of the number of steps is read off
the last doubling of that number. At a fixed angle it is told by the share of 1 - a that a step
leaves, as far as the bounds can tell.
"""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

import albedo
from albedo import plotting
from albedo.analysis import pumping
from albedo.estimate import format_value
from albedo.grammar import parse
from albedo.studies import Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from albedo.studies import Context

STUDY = Study(
    name="nns_convergence",
    title="What pumping-up converges to",
    paper="NNS",
    claims=("N5", "N6", "N7"),
)

PUMPED = (("phong", "Phong, n = 20", "phong:n=20"), ("blinn", "Blinn, n = 20", "blinn:n=20"))
RANGES = (("cos_0.01", "cosines from 0.01 on", 0.01), ("cos_1e-6", "cosines from 1e-6 on", 0.0))
# Angles of incidence in degrees at which 1 - a is followed.
ANGLES = (30.0, 60.0, 80.0, 88.0)
# What is lost is known when it is so many times its bound.
KNOWN = 20.0
# Models that make light somewhere.
BRIGHT = (
    ("Ward, m = 0.1", "ward:m=0.1"),
    ("Ward, m = 0.4", "ward:m=0.4"),
    ("Cook-Torrance without masking, m = 0.1", "cook_torrance:m=0.1,geometry=none"),
    ("Cook-Torrance without masking, m = 0.4", "cook_torrance:m=0.4,geometry=none"),
)
KERNELS, SIZE = 200, 60
RANDOM = 20240229


def run(context: Context) -> None:
    """Convergence, gains for many exponents, and first steps of what makes light."""
    context.setting(rtol=1e-10, seed=RANDOM)
    converge(context)
    gains(context)
    first_steps(context)


def grid(context: Context) -> np.ndarray:
    """Cosines of incidence, descending."""
    degrees = np.cos(np.radians(np.arange(0.0, 89.0, 1.0 if context.full else 2.0)))
    return np.unique(np.append(degrees, plotting.grazing_grid(1e-6, 12 if context.full else 6)))[
        ::-1
    ]


def converge(context: Context) -> None:
    """The largest 1 - a after each step (N7)."""
    steps = 32 if context.full else 6
    rows: list[dict[str, Any]] = []
    powers: dict[str, dict[str, tuple[float, float]]] = {}
    fixed: list[pd.DataFrame] = []
    for column, label, spec in PUMPED:
        data = pumping.series(
            parse(spec).model(), steps, cosines=grid(context), advance=context.progress
        )
        own = [worst(data, k) for k in range(steps + 1)]
        rows += [{"model": label, "step": k, **row} for k, row in enumerate(own)]
        fixed.append(at_angles(data, label))
        powers[column] = {
            key: power(own, key, steps) for key in (*(key for key, _, _ in RANGES), "limit")
        }
    frame = pd.DataFrame(rows)
    context.table("convergence", frame, "The largest 1 - a after each step")
    context.figure(
        "convergence_figure",
        draw(frame),
        "The largest 1 - a against the number of steps k; grey: 0.6/k.",
    )
    rates = pd.concat(fixed, ignore_index=True)
    context.table("rates", rates, "1 - a at fixed angles after each step, and what a step leaves")
    context.figure(
        "rates_figure",
        draw_rates(rates),
        "1 - a at fixed angles and in the limit of grazing incidence, where it exceeds its bound. "
        "What falls by the same factor with every step is a line here.",
    )
    for _, label, _ in PUMPED:
        context.note(_in_words(rates[rates["model"] == label], label))
    for column, label, _ in PUMPED:
        last = frame[(frame["model"] == label) & (frame["step"] == steps)].iloc[0]
        context.note(
            f"{label}, after {steps} steps: at most "
            + ", ".join(
                f"{format_value(last[key], last[f'{key}_error'])} is lost {where} "
                f"(falling as k^-{format_value(*powers[column][key])})"
                for key, where in (
                    ("cos_0.01", "at cosines from 0.01 on"),
                    ("cos_1e-6", "from 1e-6 on"),
                    ("limit", "in the limit of grazing incidence"),
                )
            )
            + "."
        )
        for key, where in (
            ("cos_0.01", "at cosines of incidence from 0.01 on"),
            ("limit", "even in the limit of grazing incidence"),
        ):
            value, error = powers[column][key]
            context.claim(
                "N7",
                f"Recursive pumping-up of {label} converges to an albedo of 1 {where}.",
                value=value,
                error=error,
                criterion="> 0.5",
                quantity=f"p, where the largest 1 - a falls as k^-p from {steps // 2} to {steps} "
                "steps",
                figure="convergence_figure",
                table="convergence",
            )


def at_angles(data: pumping.Series, label: str) -> pd.DataFrame:
    """1 - a at fixed angles after each step, and the share of it that the step leaves."""
    rows: list[dict[str, Any]] = []
    theta = np.degrees(np.arccos(data.cosines))
    for angle in (*ANGLES, 90.0):
        k = int(np.argmin(np.abs(theta - angle)))
        value, error = data.value[:, k], data.error[:, k]
        if angle == 90.0:
            value, error = data.limit, data.limit_error
        lost = 1.0 - value
        for step in range(1, data.steps + 1):
            before, bound = lost[step - 1], error[step - 1]
            share = doubt = math.nan
            if before > bound and lost[step] > KNOWN * error[step]:
                share = lost[step] / before
                doubt = (error[step] + share * bound) / (before - bound)
            rows.append(
                {
                    "model": label,
                    "theta_deg": angle,
                    "step": step,
                    "lost": lost[step],
                    "lost_error": error[step],
                    "left_of_last": share,
                    "left_of_last_error": doubt,
                }
            )
    return pd.DataFrame(rows)


def _in_words(rates: pd.DataFrame, label: str) -> str:
    """What steps leave at fixed angles: the first and the last of which that is known."""
    told = []
    for angle in (*ANGLES, 90.0):
        own = rates[(rates["theta_deg"] == angle) & rates["left_of_last"].notna()]
        ends = [
            f"step {row['step']} leaves "
            f"{format_value(row['left_of_last'], row['left_of_last_error'])}"
            for _, row in own.iloc[[0, -1]].iterrows()
        ]
        where = "in the limit of grazing incidence" if angle == 90.0 else f"at {angle:g}°"
        told.append(
            f"{where} {ends[0]} of 1 - a and {ends[1]}, the least of all being "
            f"{own['left_of_last'].min():.2g} and the most {own['left_of_last'].max():.2g}"
        )
    return f"{label}, as far as bounds tell 1 - a to a twentieth: {'; '.join(told)}."


def worst(data: pumping.Series, step: int) -> dict[str, float]:
    """The largest 1 - a of a step over each range of cosines, and in the limit."""
    row = {}
    for key, _, lowest in RANGES:
        inside = data.cosines >= lowest
        k, value, error = pumping.most(1.0 - data.value[step, inside], data.error[step, inside])
        row[key], row[f"{key}_error"] = value, error
        row[f"{key}_at_deg"] = math.degrees(math.acos(data.cosines[k]))
    row["limit"], row["limit_error"] = 1.0 - data.limit[step], data.limit_error[step]
    return row


def power(rows: list[dict[str, float]], key: str, steps: int) -> tuple[float, float]:
    """The power of k with which a number falls over the last doubling, and a bound."""
    half, last = rows[steps // 2], rows[steps]
    error = sum(row[f"{key}_error"] / row[key] for row in (half, last))
    return math.log2(half[key] / last[key]), error / math.log(2.0)


def gains(context: Context) -> None:
    """What every step gains and leaves, for many exponents (N6)."""
    steps = 5 if context.full else 2
    exponents = np.geomspace(1.0, 1e4, 13 if context.full else 3)
    rows = []
    for done, (n, name) in enumerate(itertools.product(exponents, ("phong", "blinn"))):
        context.progress(done, 2 * len(exponents), f"gains of {name} for n = {n:g}")
        data = pumping.series(albedo.model(name, n=n), steps, cosines=grid(context))
        table = pumping.steps_frame(data)
        table.insert(0, "n", n)
        table.insert(0, "model", name)
        rows.append(table)
    frame = pd.concat(rows, ignore_index=True)
    context.table("gains", frame, "Recursively: what each step gains and what is lost")
    for name in ("phong", "blinn"):
        own = frame[frame["model"] == name]
        for key, statement, quantity in (
            ("smallest_gain", "every step gains light: a < a*", "smallest a* - a"),
            ("smallest_loss", "no step makes light: a* < 1", "smallest 1 - a*"),
        ):
            _, value, error = pumping.least(own[key].to_numpy(), own[f"{key}_error"].to_numpy())
            context.claim(
                "N6",
                f"{name.capitalize()} with n from 1 to 10,000: {statement}.",
                value=value,
                error=error,
                criterion="> 0",
                quantity=f"{quantity} of {steps} steps, from 10 degrees to a cosine of 1e-6",
                table="gains",
            )
    # One row for each of both: where its bound leaves least.
    least = [
        frame.loc[(frame[key] - frame[f"{key}_error"]).idxmin()]
        for key in ("smallest_gain", "smallest_loss")
    ]
    first = frame[frame["step"] == 1]
    context.explain(
        "N6",
        "With g = max(a(L), a(V)), a* - a is the integral of f (1/g - 1) N.V over all V, and "
        "1 - a*, as f/a(L) has the albedo 1, is that of f max(0, 1/a(L) - 1/a(V)) N.V. Neither is "
        "negative; the first is above 0 where a falls short of 1 in the lobe, the second where the "
        "lobe reaches a V with a larger albedo than L's. So the statement is right but for light "
        "along the normal, where a is 1 before and after. How much is left is another matter: "
        "each step makes the albedo flatter, and what is lost near the normal falls by a large "
        "factor each time. After the first step the smallest loss from 10 degrees on is "
        f"{first['smallest_loss'].min():.1e}; after {steps} it is "
        f"{least[1]['smallest_loss']:.1e} with {least[1]['model']}:n={least[1]['n']:.3g}, where "
        f"the bound is {least[1]['smallest_loss_error']:.1e}, and the smallest gain is "
        f"{least[0]['smallest_gain']:.1e} with {least[0]['model']}:n={least[0]['n']:.3g}, with a "
        f"bound of {least[0]['smallest_gain_error']:.1e}. Where a number is less than its bound it "
        "cannot tell more.",
    )


def first_steps(context: Context) -> None:
    """What the first step makes of models that make light, and of random kernels (N5)."""
    rows = []
    cosines = grid(context)
    bright = BRIGHT if context.full else BRIGHT[::2]
    for done, (label, spec) in enumerate(bright):
        context.progress(done, len(bright), label)
        model = parse(spec).model()
        before = albedo.directional_albedo(model, cosines, rtol=1e-8)
        after = albedo.directional_albedo(albedo.pump(model, 1), cosines, rtol=1e-8)
        high, highest, error = pumping.most(before.value, before.error)
        k, value, bound = pumping.most(after.value, after.error)
        rows.append(
            {
                "model": label,
                "before": highest,
                "before_error": error,
                "before_at_cos": cosines[high],
                "after": value,
                "after_error": bound,
                "after_at_cos": cosines[k],
            }
        )
    before_all, value, bound = random_kernels()
    rows.append(
        {
            "model": f"{KERNELS} random symmetric kernels on {SIZE} heights",
            "before": before_all,
            "before_error": SIZE * np.finfo(float).eps * before_all,
            "before_at_cos": math.nan,
            "after": value,
            "after_error": bound,
            "after_at_cos": math.nan,
        }
    )
    frame = pd.DataFrame(rows)
    context.table(
        "first_step", frame, "The largest albedo at cosines from 1e-6 on, before and after a step"
    )
    for row in rows:
        context.claim(
            "N5",
            "The first step makes a symmetric function conserve energy: "
            f"{row['model']}, whose albedo is up to {row['before']:.4g}.",
            value=row["after"],
            error=row["after_error"],
            criterion=pumping.at_most(1.0),
            quantity="largest albedo after one step",
            table="first_step",
        )
    context.explain(
        "N5",
        "As 1/max(a(L), a(V)) is at most 1/a(L), a* is at most the integral of f N.V/a(L), which "
        "is 1, however large a may be. It is equal to 1 where a(L) is the largest albedo that the "
        "lobe reaches, as at the maximum of a. So the largest a* is 1, and no bound can tell it "
        "from a little more: measured values are within "
        f"{max(abs(row['after'] - 1.0) for row in rows):.0e} of 1, and within their bounds of at "
        f"most {max(row['after_error'] for row in rows):.0e}.",
    )


def random_kernels() -> tuple[float, float, float]:
    """Largest albedo before and after a step of random kernels on a grid, and a bound.

    On a grid albedos are sums, and the step is exact but for rounding.
    """
    generator = np.random.default_rng(RANDOM)
    weights = np.full(SIZE, 1.0 / SIZE)
    before = after = 0.0
    for _ in range(KERNELS):
        # Over ten decades, so that albedos are very different.
        kernel = 10.0 ** generator.uniform(-5.0, 5.0, (SIZE, SIZE))
        kernel = np.maximum(kernel, kernel.T)
        value = kernel @ weights
        divided = kernel / np.maximum(value[:, None], value[None, :])
        before = max(before, float(value.max()))
        after = max(after, float((divided @ weights).max()))
    return before, after, 2.0 * (SIZE + 2) * np.finfo(float).eps


def draw(frame: pd.DataFrame) -> Figure:
    """The largest 1 - a against the number of steps."""
    with plotting.style():
        figure, (axes,) = plotting.new_figure(1, 6.5, 3.8)
        for column, label, _ in PUMPED:
            rows = frame[(frame["model"] == label) & (frame["step"] > 0)]
            for key, what, line in (
                ("cos_0.01", "cos θ ≥ 0.01", (0, (6, 2))),
                ("limit", "grazing limit", "-"),
            ):
                axes.plot(
                    *(rows["step"], rows[key]),
                    color=plotting.color(column),
                    linestyle=line,
                    marker="o",
                    markersize=3.0,
                    label=f"{label}: {what}",
                )
        steps = np.array([1.0, float(frame["step"].max())])
        axes.plot(steps, 0.6 / steps, color="#888888", linewidth=0.9, zorder=1.5)
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlabel("steps k")
        axes.set_ylabel("largest 1 - albedo")
        marks = sorted({*(k for k in (1, 2, 4, 8, 16) if k < steps[1]), int(steps[1])})
        axes.set_xticks(marks, [str(k) for k in marks])
        low = float(frame[frame["step"] > 0]["cos_0.01"].min())
        heights = [y for y in (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0) if y > 0.8 * low]
        axes.set_yticks(heights, [f"{y:g}" for y in heights])
        axes.set_ylim(0.8 * low, 1.05)
        axes.minorticks_off()
        plotting.add_legend(figure, axes, columns=2)
    return figure


def draw_rates(rates: pd.DataFrame) -> Figure:
    """1 - a at fixed angles against the number of steps."""
    labels = list(dict.fromkeys(rates["model"]))
    angles = sorted(set(rates["theta_deg"]))
    with plotting.style():
        figure, panels = plotting.new_figure(len(labels), 7.5, 3.4)
        for axes, label in zip(panels, labels, strict=True):
            for angle, look in zip(angles, pumping.looks(len(angles)), strict=True):
                own = rates[(rates["model"] == label) & (rates["theta_deg"] == angle)]
                own = own[own["lost"] > own["lost_error"]]
                name = "grazing limit" if angle == 90.0 else f"{angle:g}°"
                axes.plot(own["step"], own["lost"], marker="o", markersize=2.5, label=name, **look)
            axes.set_yscale("log")
            axes.set_title(label, loc="left")
            axes.set_xlabel("steps k")
            if axes is not panels[0]:
                axes.sharey(panels[0])
                axes.tick_params(labelleft=False)
        panels[0].set_ylabel("1 - albedo")
        plotting.add_legend(figure, panels[0], columns=len(angles))
    return figure
