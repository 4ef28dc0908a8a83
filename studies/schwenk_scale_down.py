"""How much do the steps lose by which Schwenk's model is scaled down to Lambert's?

Sect. 4.2.4 drops Fresnel's factor, then 1/(v.h), then the luminance scaling of the highlight's
colour, then the highlight. Every step is measured on top of the one before, and all so far
together: what it changes in the radiance of a point source and in the albedo, in the mean and at
most, over smoothness, metalness and colour; and what it saves, as the kernel stands and in kernels
that have nothing but the arithmetic of their level.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

import albedo
from albedo import plotting
from albedo._compile import kernel
from albedo.analysis.radiance import plane_radiance
from albedo.analysis.scale_down import LOWEST, albedo_change, radiance_change
from albedo.directions import half_vector, spherical
from albedo.estimate import format_value
from albedo.fresnel import schlick
from albedo.geometry import normal_power, slope2, v_dot_h
from albedo.studies import Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from albedo.brdf import Model
    from albedo.studies import Context

STUDY = Study(
    name="schwenk_scale_down",
    title="What the steps of Schwenk's scale-down lose",
    paper="S",
    claims=("S16",),
)

LITTLE = 0.05
"""A mean relative change below this is little."""
EVERY, HALF = "at every setting", "at half of the settings"

STEPS = {
    1: "Fresnel's factor dropped",
    2: "1/(v.h) dropped",
    3: "luminance scaling dropped",
    4: "highlight dropped",
}
PAIRS = ((0, 1), (1, 2), (2, 3), (3, 4), (0, 2), (0, 3), (0, 4))
QUICK_PAIRS = (*PAIRS[:4], PAIRS[-1])
COLORS: dict[str, tuple[float, ...]] = {
    "grey": (0.5,),
    "gold": (1.0, 0.77, 0.34),
    "saturated red": (0.8, 0.1, 0.05),
}
SMOOTHNESS = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 1.0)
METALNESS = (0.0, 0.5, 1.0)
QUICK_SMOOTHNESS, QUICK_METALNESS = (0.5, 0.8), (0.0, 1.0)
QUICK_COLORS = ("grey", "gold")

# The lobes that are drawn: gold's blue channel at 60 degrees.
LOBE = {"color": COLORS["gold"], "metalness": 1.0, "smoothness": 0.9}
LOBE_CHANNEL, LOBE_DEGREES = 2, 60.0

# Directions that are evaluated at a time: they stay in the cache of a core.
BLOCK = 4096

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#AA4499", "#E69F00")


def at_level(level: int, **values: Any) -> Model:
    """Schwenk's model after so many steps; k_s = k_d = 1 and k = 0, as by default."""
    return albedo.model("schwenk", level=str(level), **values)


def run(context: Context) -> None:
    """Measure all steps, judge the claim, and draw them."""
    context.setting(rtol_radiance=1e-3, rtol_albedo=1e-6, lowest_cosine=LOWEST)
    frame = changes(context)
    # A maximum is flat: where it is found is known to half of the digits only.
    places = [c for c in frame if c.endswith(("_cos_light", "_cos_view", "_deg_from_mirror"))]
    # Mean changes are there relative to what is changed.
    kept = frame.drop(columns=[c for c in frame if "_absolute" in c])
    context.table("changes", kept, "What every step changes, at every setting", machine=places)
    summary = summarised(frame)
    context.table(
        "summary",
        summary,
        f"Steps over all settings: how often their mean relative change is below {LITTLE:g}",
        machine=[c for c in summary if c.endswith("_cos_light")],
    )
    judge(context, summary, frame)
    context.figure(
        "steps_figure",
        draw_steps(frame),
        "Mean relative change of every step on top of the one before, the largest of all colours "
        "and channels; the grey line is what counts as little. Where a step changes nothing at all "
        "there is no curve.",
    )
    context.figure(
        "worst_figure",
        draw_worst(frame),
        "The largest change of radiance over all pairs of directions, absolute and relative to the "
        "original, of every step on top of the one before, the largest of all settings.",
    )
    context.figure(
        "lobes_figure",
        draw_lobes(),
        f"Radiance in the plane of incidence, light at {LOBE_DEGREES:g}°, for gold's blue channel, "
        f"smoothness {LOBE['smoothness']}, metalness {LOBE['metalness']}; the grey line is the "
        "mirror direction.",
    )
    costs = measured_costs(200 if context.full else 40, context.alone)
    context.table(
        "costs",
        costs,
        "Nanoseconds for a value of the BRDF, on this machine in this run: medians and quartiles "
        "of rounds in turn; what a step saves is the median of differences within a round",
        machine=[c for c in costs if c not in ("kernel", "level")],
    )
    say(context, summary, costs)


def changes(context: Context) -> pd.DataFrame:
    """One row for every pair of levels, setting and channel."""
    smoothness = SMOOTHNESS if context.full else QUICK_SMOOTHNESS
    metalness = METALNESS if context.full else QUICK_METALNESS
    colors = tuple(COLORS) if context.full else QUICK_COLORS
    pairs = PAIRS if context.full else QUICK_PAIRS
    settings = [
        (name, m, s, channel)
        for name in colors
        for m in metalness
        for s in smoothness
        for channel in range(len(COLORS[name]) if context.full else 1)
    ]
    rows = []
    for done, (name, m, s, channel) in enumerate(settings):
        context.progress(done, len(settings), f"{name}, m = {m:g}, s = {s:g}")
        values: dict[str, Any] = {"color": COLORS[name], "metalness": m, "smoothness": s}
        levels = [at_level(level, **values).channel(channel) for level in range(5)]
        for first, last in pairs:
            light = radiance_change(levels[first], levels[last])
            energy = albedo_change(levels[first], levels[last])
            rows.append(
                {
                    "from_level": first,
                    "to_level": last,
                    "color": name,
                    "channel": channel,
                    "metalness": m,
                    "smoothness": s,
                    **light.row("radiance"),
                    **energy.row("albedo"),
                    "agreed": light.agreed and energy.agreed,
                }
            )
    return pd.DataFrame(rows)


def largest(frame: pd.DataFrame, column: str) -> tuple[pd.Series, float, float]:
    """The row with the largest number, the number, and what errors of all rows leave of it."""
    row = frame.loc[frame[column].idxmax()]
    value, error = float(row[column]), float(row[f"{column}_error"])
    return row, value, max(error, float((frame[column] + frame[f"{column}_error"]).max()) - value)


def where(row: pd.Series) -> str:
    """A setting in words."""
    channel = "" if len(COLORS[row["color"]]) == 1 else f" ({'RGB'[int(row['channel'])]})"
    return f"{row['color']}{channel}, m = {row['metalness']:g}, s = {row['smoothness']:g}"


def steps_alone(frame: pd.DataFrame) -> pd.DataFrame:
    """Rows of steps on top of the one before."""
    return frame[frame["to_level"] == frame["from_level"] + 1]


def summarised(frame: pd.DataFrame) -> pd.DataFrame:
    """One row for every pair of levels."""
    rows = []
    for (first, last), part in frame.groupby(["from_level", "to_level"]):
        row: dict[str, Any] = {"from_level": first, "to_level": last, "settings": len(part)}
        unchanged = (part["radiance_worst"] == 0.0) & (part["albedo_worst"] == 0.0)
        row["nothing_at"] = int(unchanged.sum())
        for kind in ("radiance", "albedo"):
            column = f"{kind}_relative"
            place, value, error = largest(part, column)
            row[f"{kind}_little_at"] = int((part[column] + part[f"{column}_error"] < LITTLE).sum())
            row[f"{kind}_median"] = float(part[column].median())
            row[column], row[f"{column}_error"] = value, error
            row[f"{kind}_relative_at"] = where(place)
            row[f"{kind}_share"], row[f"{kind}_share_error"] = largest(part, f"{kind}_share")[1:]
            worst_at, worst, worst_error = largest(part, f"{kind}_worst_relative")
            row[f"{kind}_worst_relative"] = worst
            row[f"{kind}_worst_relative_error"] = worst_error
            row[f"{kind}_worst_cos_light"] = float(worst_at[f"{kind}_worst_relative_cos_light"])
            row[f"{kind}_worst"], row[f"{kind}_worst_error"] = largest(part, f"{kind}_worst")[1:]
        rows.append(row)
    return pd.DataFrame(rows)


def of_pair(summary: pd.DataFrame, first: int, last: int) -> pd.Series:
    """The row of two levels."""
    return summary[(summary["from_level"] == first) & (summary["to_level"] == last)].iloc[0]


def judge(context: Context, summary: pd.DataFrame, frame: pd.DataFrame) -> None:
    """S16: every step, all together, and the whole."""
    for first, last in QUICK_PAIRS:
        row = of_pair(summary, first, last)
        step = f"Step {last}, {STEPS[last]}," if last - first == 1 else "All four steps together"
        verb = "changes" if last - first == 1 else "change"
        for kind, what in (("radiance", "the radiance of a point source"), ("albedo", "albedos")):
            context.claim(
                "S16",
                f"{step} {verb} {what} little.",
                value=row[f"{kind}_relative"],
                error=row[f"{kind}_relative_error"],
                criterion=f"< {LITTLE:g}",
                quantity="mean relative change, largest of all settings: "
                + row[f"{kind}_relative_at"],
                reading=EVERY,
                figure="steps_figure",
                table="summary",
            )
    alone = steps_alone(summary)
    column = max(("radiance_relative", "albedo_relative"), key=lambda name: alone[name].max())
    _, value, error = largest(steps_alone(frame), column)
    medians = [
        middle(steps_alone(frame), step, f"{kind}_relative")
        for step in STEPS
        for kind in ("radiance", "albedo")
    ]
    for reading, found, doubt in (
        (EVERY, value, error),
        (HALF, *max(medians, key=lambda pair: pair[0] + pair[1])),
    ):
        context.claim(
            "S16",
            "Every step loses little.",
            value=found,
            error=doubt,
            criterion=f"< {LITTLE:g}",
            quantity="mean relative change, largest of radiance and albedo, steps and settings"
            if reading == EVERY
            else "median of the settings of the mean relative change, largest of radiance and "
            "albedo and of all steps",
            reading=reading,
            figure="steps_figure",
            table="summary",
        )
    explain(context, summary)


def middle(frame: pd.DataFrame, step: int, column: str) -> tuple[float, float]:
    """The median over settings of what a step changes; no error moves it by more than the most."""
    rows = frame[frame["to_level"] == step]
    return float(rows[column].median()), float(rows[f"{column}_error"].max())


def explain(context: Context, summary: pd.DataFrame) -> None:
    """What each step takes from the formula, and where that is much."""

    def told(step: int) -> str:
        row = of_pair(summary, step - 1, step)
        most = max(float(row[f"{kind}_relative"]) for kind in ("radiance", "albedo"))
        median = max(float(row[f"{kind}_median"]) for kind in ("radiance", "albedo"))
        return f"{most:.2g} at most and {median:.2g} in the median of the settings"

    context.explain(
        "S16",
        "The mean relative change of radiance or albedo, whichever is larger, is the measure. "
        "Without Fresnel's factor F0 + (1 - F0)(1 - v.h)^5 is F0 = 1 - m + m C', which for what is "
        f"no metal is 1 either way: {told(1)}, little indeed. 1/(v.h) is 1 in the highlight of "
        "light along the normal, but 1/cos θ in the mirror direction of light at θ: "
        f"{told(2)}. C for C' = C/lum(C) makes a metal's highlight darker, by the factor lum(C) "
        f"for m = 1: {told(3)}. The last step takes the whole highlight away: {told(4)}. Little is "
        "lost where the highlight holds little of the light: on rough surfaces and, as the lobe is "
        "not normalised, on the smoothest ones. In between, and for saturated colours most of all, "
        "every step but the first can be seen.",
    )


def specialised(level: int) -> Callable[..., None]:
    """A kernel with nothing but the arithmetic of a level, for C_d = C; `level` is compiled in."""

    @kernel
    def fill(wi, wo, h, p, out):
        """As `albedo.catalogue.schwenk`: c c_s (n.h)^e + scale C."""
        for j in range(out.shape[0]):
            e, scale, f0 = p[j, 0], p[j, 1], p[j, 2]
            diffuse = p[j, 4] * p[j, 6]
            for i in range(out.shape[1]):
                if level == 4:
                    out[j, i] = diffuse
                else:
                    hx, hy, hz = h[0, j, i], h[1, j, i], h[2, j, i]
                    c_s, c = f0, scale
                    if level < 2:
                        u = v_dot_h(hx, hy, hz)
                        c = scale / u
                        if level < 1:
                            c_s = schlick(f0, u)
                    out[j, i] = c * c_s * normal_power(slope2(hx, hy, hz), e) + diffuse

    return fill


def block() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """One light and a block of views on a spiral, with their sums, as kernels read them."""
    height = (np.arange(BLOCK) + 0.5) / BLOCK
    views = spherical(height, np.arange(BLOCK) * math.pi * (3.0 - math.sqrt(5.0)))
    light = spherical(0.5)
    sums = half_vector(np.broadcast_to(light, views.shape), views)
    columns = [np.ascontiguousarray(v.T).reshape(3, 1, BLOCK) for v in (views, sums)]
    return light.reshape(3, 1).copy(), columns[0], columns[1]


def measured_costs(
    rounds: int, alone_here: Callable[[], AbstractContextManager[object]]
) -> pd.DataFrame:
    """Time of a value at each level: the model's own kernels, and specialised ones, in turn."""
    wi, wo, h = block()
    calls: dict[tuple[str, int], Callable[[], None]] = {}
    for level in range(5):
        model = at_level(level, **LOBE).channel(LOBE_CHANNEL)
        rows = np.array([model.pack()])
        fills = [part.fill for part in model.parts()]
        single = specialised(level)

        def as_is(fills: list[Any] = fills, rows: np.ndarray = rows) -> None:
            total, out = np.zeros((1, BLOCK)), np.empty((1, BLOCK))
            for fill in fills:
                fill(wi, wo, h, rows, out)
                total += out

        def alone(fill: Callable[..., None] = single, rows: np.ndarray = rows) -> None:
            fill(wi, wo, h, rows, np.empty((1, BLOCK)))

        calls["as it stands", level] = as_is
        calls["specialised", level] = alone
    for call in calls.values():
        call()
    spent: dict[tuple[str, int], list[float]] = {key: [] for key in calls}
    with alone_here():
        for _ in range(rounds):
            for key, call in calls.items():
                start = time.perf_counter()
                call()
                spent[key].append(1e9 * (time.perf_counter() - start) / BLOCK)
    table = []
    for (kind, level), times in spent.items():
        low, middle, high = np.percentile(times, (25, 50, 75))
        row = {"kernel": kind, "level": level, "ns": middle, "ns_low": low, "ns_high": high}
        if level:
            saved = np.array(spent[kind, level - 1]) - np.array(times)
            low, middle, high = np.percentile(saved, (25, 50, 75))
            row |= {"saved_ns": middle, "saved_ns_low": low, "saved_ns_high": high}
        table.append(row)
    return pd.DataFrame(table).sort_values(["kernel", "level"], ignore_index=True)


def say(context: Context, summary: pd.DataFrame, costs: pd.DataFrame) -> None:
    """What was found, in words around the numbers."""
    own = costs[costs["kernel"] == "specialised"].set_index("level")
    stands = costs[costs["kernel"] == "as it stands"].set_index("level")
    for level, name in STEPS.items():
        row = of_pair(summary, level - 1, level)
        words = []
        for kind in ("radiance", "albedo"):
            value = format_value(row[f"{kind}_relative"], row[f"{kind}_relative_error"])
            words.append(
                f"{kind}: {value} in the mean at most ({row[f'{kind}_relative_at']}), median of "
                f"the settings {row[f'{kind}_median']:.2g}, little at {row[f'{kind}_little_at']} "
                f"of {row['settings']}"
            )
        radiance_at, albedo_at = (row[f"{k}_worst_cos_light"] for k in ("radiance", "albedo"))
        worst = [
            format_value(row[f"{k}_worst_relative"], row[f"{k}_worst_relative_error"])
            for k in ("radiance", "albedo")
        ]
        saved = own.loc[level]
        context.note(
            f"Step {level}, {name}. " + "; ".join(words) + ". The largest relative change of the "
            f"radiance of any two directions is {worst[0]}, at n.l = {radiance_at:.2g}; of an "
            f"albedo {worst[1]}, at n.l = {albedo_at:.2g}. It saves {saved['saved_ns']:.2g} ns of "
            f"{own.loc[level - 1, 'ns']:.2g} ({saved['saved_ns_low']:.2g} to "
            f"{saved['saved_ns_high']:.2g} between quartiles) in kernels with the arithmetic of "
            f"their level alone, and {stands.loc[level, 'saved_ns']:.2g} ns of "
            f"{stands.loc[level - 1, 'ns']:.2g} in that of the model, on this machine."
        )
    whole = own.loc[0, "ns"] - own.loc[4, "ns"]
    context.note(
        f"Of the {whole:.2g} ns that all steps save in kernels of their own on this machine, "
        + ", ".join(
            f"step {level} saves {100.0 * own.loc[level, 'saved_ns'] / whole:.2g} percent"
            for level in STEPS
        )
        + "."
    )
    nothing = {k: of_pair(summary, k - 1, k)["nothing_at"] for k in STEPS}
    context.note(
        "Lights are uniform in solid angle, and views count by their projected area; the largest "
        f"changes are sought among directions with cosines of at least {LOWEST:g}. Steps change "
        "nothing at all at "
        + ", ".join(f"{count} (step {k})" for k, count in nothing.items())
        + f" of {summary['settings'].iloc[0]} settings: F0 = 1 - m + m C' is 1 for what is no "
        "metal, and for grey metal until C takes the place of C' = C/lum(C). Where F0 is above 1, "
        "as for saturated metals, Fresnel's factor takes light away towards grazing incidence."
    )


def draw_steps(frame: pd.DataFrame) -> Figure:
    """Mean relative changes over smoothness."""
    alone = steps_alone(frame)
    metals = (alone["metalness"].min(), alone["metalness"].max())
    with plotting.style():
        figure, panels = plotting.new_figure(2, width=8.6, height=3.8)
        for axes, kind in zip(panels, ("radiance", "albedo"), strict=True):
            for color, level in zip(PALETTE, STEPS, strict=False):
                for m, line, mark in ((metals[0], "--", "s"), (metals[1], "-", "o")):
                    part = alone[(alone["to_level"] == level) & (alone["metalness"] == m)]
                    top = part.groupby("smoothness")[f"{kind}_relative"].max()
                    top = top[top > 0.0]
                    if top.empty:
                        continue
                    label = f"step {level}, m = {m:g}"
                    look = {"color": color, "linestyle": line, "marker": mark, "ms": 3.5}
                    axes.plot(top.index, top.to_numpy(), label=label, **look)
            axes.axhline(LITTLE, color="#888888", linewidth=0.9, zorder=0.5)
            axes.set_yscale("log")
            axes.set_xlim(0.0, 1.02)
            axes.set_xlabel("smoothness s")
            axes.set_title("radiance of a point source" if kind == "radiance" else "albedo")
        ends = np.array([axes.get_ylim() for axes in panels])
        for axes in panels:
            axes.set_ylim(ends.min(), ends.max())
        panels[0].set_ylabel("mean relative change")
        plotting.add_legend(figure, panels[0], columns=3)
    return figure


def draw_worst(frame: pd.DataFrame) -> Figure:
    """Largest changes of radiance over smoothness."""
    alone = steps_alone(frame)
    titles = {
        "radiance_worst": "largest change of radiance (1/sr)",
        "radiance_worst_relative": "largest relative change of radiance",
    }
    with plotting.style():
        figure, panels = plotting.new_figure(2, width=8.6, height=3.6)
        for axes, (column, title) in zip(panels, titles.items(), strict=True):
            for color, (level, name) in zip(PALETTE, STEPS.items(), strict=False):
                part = alone[alone["to_level"] == level]
                top = part.groupby("smoothness")[column].max()
                axes.plot(top.index, top.to_numpy(), "o-", ms=3.5, color=color, label=name)
            axes.set_yscale("log")
            axes.set_xlim(0.0, 1.02)
            axes.set_xlabel("smoothness s")
            axes.set_ylabel(title)
        plotting.add_legend(figure, panels[0], columns=2)
    return figure


def draw_lobes() -> Figure:
    """Radiance in the plane of incidence at every level."""
    degrees = np.linspace(-89.5, 89.5, 359)
    with plotting.style():
        figure, (axes,) = plotting.new_figure(width=6.8, height=3.8)
        lines = ("-", (0, (6, 2)), "-", (0, (1.2, 1.4)), "-")
        for color, line, level in zip(PALETTE, lines, range(5), strict=True):
            model = at_level(level, **LOBE).channel(LOBE_CHANNEL)
            cosine = math.cos(math.radians(LOBE_DEGREES))
            found = plane_radiance(model, cosine, np.radians(degrees))
            name = "level 0, whole" if level == 0 else f"level {level}, {STEPS[level]}"
            axes.plot(degrees, found.value, color=color, linestyle=line, label=name)
        axes.axvline(LOBE_DEGREES, color="#888888", linewidth=0.9, zorder=0.5)
        axes.set_xlim(-90.0, 90.0)
        axes.set_xticks(np.arange(-90.0, 91.0, 30.0))
        axes.set_ylim(bottom=0.0)
        axes.set_xlabel("angle of the view (degrees, mirror side positive)")
        axes.set_ylabel("radiance f n.l (1/sr)")
        plotting.add_legend(figure, axes, columns=2)
    return figure
