"""Where is the masking of Cook-Torrance one, and does the albedo diverge at grazing incidence?

The paper takes a cap of half vectors H about the normal, draws the directions V for which H stays
in it while L moves towards the horizon, and puts G = 1 there, so that the albedo diverges (eq. 15).
G of eq. 10, min(1, 2 NH NV/VH, 2 NH NL/VH), is one where V has its own condition to meet. Both sets
of V are computed here, with their solid angles; so are what they reflect, and the albedos for both
readings: G as printed, and G = 1.
"""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

import albedo
from albedo import plotting
from albedo.analysis.critical_region import LIMIT, Region, measure, outline
from albedo.analysis.grazing import power
from albedo.estimate import format_value
from albedo.studies import Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from albedo.estimate import Estimate
    from albedo.studies import Context

STUDY = Study(
    name="nns_fig2",
    title="The critical region of Cook-Torrance",
    paper="NNS",
    figure="Figure 2",
    claims=("N4",),
)

CAP = math.radians(10.0)
"""Largest angle of H to the normal in the cap."""
FIRST = 80.0
"""The arc of L goes from here to the horizon, degrees."""
# Points of a side of an outline.
DRAWN = 80
ANGLES = (60.0, 80.0, 85.0, 89.0)
WIDTHS = (0.1, 0.4)
PRINTED, ONE = "G as printed", "G = 1"
READINGS = {"v_cavity": PRINTED, "none": ONE}


def on_arc(first: float, cap: float, z: np.ndarray) -> np.ndarray:
    """Half width of the V whose H stays in the cap for all L from `first` degrees to the horizon.

    Where cos^2(cap) <= sin(first) it is that of L on the horizon: H of a fixed V then leaves the
    normal monotonically.
    """
    elevations = np.linspace(0.0, math.radians(90.0 - first), 65)
    return np.min([Region(float(e), cap=cap).half_width(z) for e in elevations], axis=0)


def run(context: Context) -> None:
    """Outline the sets, measure them towards grazing incidence, and compare both readings."""
    smallest = 1e-12 if context.full else 1e-9
    cosines = np.geomspace(1.0, smallest, 1 + round(8 * -np.log10(smallest)))
    rtol = 1e-11 if context.full else 1e-9
    context.setting(rtol=rtol)
    context.progress(0, 4, "solid angles")
    angles = solid_angles(np.radians(90.0 - np.array([0.0, 15.0, 30.0, 45.0, *ANGLES, 89.9])))
    context.table("angles", angles, "Solid angles of the sets of V in sr, cap of 10 degrees")
    grazing = solid_angles(np.arcsin(cosines))
    context.table("solid_angles", grazing, "The same towards grazing incidence")
    context.progress(1, 4, "what the sets reflect")
    reflected = reflections(cosines)
    context.table("reflected", reflected, "What the sets of V reflect, Beckmann's D")
    context.progress(2, 4, "albedos")
    albedos, losses = measure_albedos(cosines, rtol)
    context.table("albedos", as_frame(cosines, albedos), "Albedos for both readings")
    context.progress(3, 4, "figures")
    draw_critical(context)
    draw_hemispheres(context)
    draw_slopes(context)
    draw_solid_angles(context, grazing)
    draw_albedos(context, cosines, albedos, reflected)
    judge_regions(context, grazing, reflected)
    judge_albedos(context, cosines, albedos, losses)


def solid_angles(elevations: np.ndarray) -> pd.DataFrame:
    """Solid angles of G = 1, of the cap, and of what they share."""
    rows = []
    for elevation in elevations:
        e = float(elevation)
        c = math.sin(e)
        one, one_error = measure(Region(e, g_one=True))
        cap, cap_error = measure(Region(e, cap=CAP))
        both, both_error = measure(Region(e, g_one=True, cap=CAP))
        rows.append(
            {
                "theta_deg": 90.0 - math.degrees(e),
                "cos_theta": c,
                "g_one": one,
                "g_one_error": one_error,
                "g_one_over_cos2": one / c**2,
                "g_one_over_cos2_error": one_error / c**2,
                "cap": cap,
                "cap_error": cap_error,
                "both": both,
                "both_error": both_error,
                "share_of_cap": both / cap,
                "share_of_cap_error": (both_error + both / cap * cap_error) / (cap - cap_error),
            }
        )
    return pd.DataFrame(rows)


def reflections(cosines: np.ndarray) -> pd.DataFrame:
    """What is reflected into the set with G = 1, and by eq. 15 into the whole cap with G = 1."""
    columns: dict[str, Any] = {
        "theta_deg": 90.0 - np.degrees(np.arcsin(cosines)),
        "cos_theta": cosines,
    }
    for m in WIDTHS:
        for name, kind in (("g_one", {"g_one": True}), ("cap", {"cap": CAP})):
            found = [measure(Region(math.asin(c), **kind), m) for c in cosines]  # type: ignore[arg-type]
            columns[f"{name}_m={m:g}"] = [value for value, _ in found]
            columns[f"{name}_m={m:g}_error"] = [error for _, error in found]
    return pd.DataFrame(columns)


def measure_albedos(
    cosines: np.ndarray, rtol: float
) -> tuple[dict[tuple[str, float], Estimate], dict[float, Estimate]]:
    """Albedos of both readings, and 1 - a with G as printed."""
    found, losses = {}, {}
    for reading, m in itertools.product(READINGS, WIDTHS):
        model = albedo.model("cook_torrance", m=m, geometry=reading)
        found[reading, m] = albedo.directional_albedo(model, cosines, rtol=rtol)
        if reading == "v_cavity":
            losses[m] = albedo.directional_albedo(model, cosines, complement=True)
    return found, losses


def as_frame(cosines: np.ndarray, albedos: dict[tuple[str, float], Estimate]) -> pd.DataFrame:
    """One row for every cosine."""
    columns: dict[str, Any] = {
        "theta_deg": 90.0 - np.degrees(np.arcsin(cosines)),
        "cos_theta": cosines,
    }
    for (reading, m), found in albedos.items():
        name = f"{reading}_m={m:g}"
        columns[name] = found.value
        columns[f"{name}_error"] = found.error
        columns[f"{name}_evaluations"] = found.evaluations
    return pd.DataFrame(columns)


def towards_grazing(cosines: np.ndarray) -> np.ndarray:
    """Which cosines a power is fitted to: the smaller half of the decades."""
    return cosines <= 1.001 * math.sqrt(cosines[-1])


def judge_regions(context: Context, grazing: pd.DataFrame, reflected: pd.DataFrame) -> None:
    """Does G = 1 hold on a fixed cap, and does what is reflected there diverge?"""
    last = grazing.iloc[-1]
    near = towards_grazing(grazing["cos_theta"].to_numpy())
    c = grazing.loc[near, "cos_theta"].to_numpy()

    def exponent(frame: pd.DataFrame, column: str) -> tuple[float, float]:
        rows = frame[near]
        return power(c, rows[column].to_numpy(), rows[f"{column}_error"].to_numpy())

    def shown(column: str) -> str:
        return format_value(last[column], last[f"{column}_error"])

    context.claim(
        "N4",
        "For L near grazing incidence, G = 1 for all H within 10° of N.",
        value=last["share_of_cap"],
        error=last["share_of_cap_error"],
        criterion=">= 1",
        quantity=f"share of the cap's V with G = 1, at cos θ = {last['cos_theta']:.0e}",
        reading=PRINTED,
        figure="critical_figure",
        table="solid_angles",
    )
    p, error = exponent(grazing, "g_one")
    context.claim(
        "N4",
        "The set of V with G = 1 keeps its size as L becomes grazing.",
        value=p,
        error=error,
        criterion="<= 0",
        quantity="exponent p of its solid angle ~ (n.l)^p",
        reading=PRINTED,
        figure="solid_angle_figure",
        table="solid_angles",
    )
    for name, reading, sets in (
        ("g_one", PRINTED, "What is reflected where G = 1"),
        ("cap", ONE, "What is reflected into the cap"),
    ):
        for m in WIDTHS:
            q, spread = exponent(reflected, f"{name}_m={m:g}")
            context.claim(
                "N4",
                f"{sets} diverges as L becomes grazing, m = {m:g}.",
                value=q,
                error=spread,
                criterion="< 0",
                quantity="exponent p of the light reflected there ~ (n.l)^p",
                reading=reading,
                figure="albedo_figure",
                table="reflected",
            )
    context.note(
        f"At cos θ = {last['cos_theta']:.0e} the set of V with G = 1 has the solid angle "
        f"{shown('g_one')} sr, which is {shown('g_one_over_cos2')} (n.l)^2; its limit is "
        f"2π + 8/3 (1 - artanh(1/√3)/√3) = {LIMIT:.12g}. (At normal incidence it is π.) Of the "
        f"cap's {shown('cap')} sr, {shown('both')} sr have G = 1. The exponents of n.l in the two "
        f"sets with G = 1 are {format_value(p, error)} and "
        f"{format_value(*exponent(grazing, 'both'))}. So no cap of fixed size has G = 1 for all L "
        "near the horizon: of the cap, a sliver remains, of slopes of H from -cot(θ)/3 to cot θ "
        "along L."
    )
    context.note(
        "In the plane of incidence G = 1 holds for elevations of V from a third to three times "
        "that of L (for L up to 30° high): for L at 89°, from 1/3° to 3°."
    )
    z = np.sin(np.linspace(0.0, 2.0 * CAP, 400))
    gap = np.max(np.abs(on_arc(FIRST, CAP, z) - Region(0.0, cap=CAP).half_width(z)))
    fractions = {m: exponent(reflected, f"g_one_m={m:g}") for m in WIDTHS}
    context.explain(
        "N4",
        "Eq. 15 puts G = 1 on a fixed cap of half vectors while L goes to the horizon. What eq. 9 "
        "reflects into it is then 1/(N.L) times an integral that stays finite, and diverges. But G "
        "of eq. 10 is one only where 2 NH NL ≥ VH and 2 NH NV ≥ VH, and on the cap VH does not "
        "shrink with N.L but for a sliver: of its directions V a share of "
        f"{shown('share_of_cap')} has G = 1 at cos θ = {last['cos_theta']:.0e}, as their solid "
        f"angle goes as (N.L)^p, p = {format_value(p, error)}. What they reflect vanishes as "
        + " and ".join(
            f"(N.L)^{format_value(*found)} (m = {m:g})" for m, found in fractions.items()
        )
        + ". Elsewhere G is at most 2 NH NL/VH, which cancels the 1/N.L of eq. 9. So with G = 1 "
        "the proof holds, and with G as printed it does not.",
    )
    context.note(
        f"For all L from {FIRST:g}° to the horizon, H stays within 10° of N for exactly the V of L "
        f"on the horizon: the least half widths over 65 L differ from those by {gap:.1g}. That set "
        f"has 4δ - 2 sin 2δ = {4.0 * CAP - 2.0 * math.sin(2.0 * CAP):.6f} sr. G = 1 for all these "
        "L holds nowhere, as the set with G = 1 shrinks to the mirror direction."
    )


def judge_albedos(
    context: Context,
    cosines: np.ndarray,
    albedos: dict[tuple[str, float], Estimate],
    losses: dict[float, Estimate],
) -> None:
    """Do the albedos pass 1 and go on?"""
    near = towards_grazing(cosines)
    for (reading, m), found in albedos.items():
        end = f"cos θ = {cosines[-1]:.0e}"
        if reading == "none":
            p, spread = power(cosines[near], found.value[near], found.error[near])
            context.claim(
                "N4",
                f"The albedo diverges as L becomes grazing, m = {m:g}.",
                value=p,
                error=spread,
                criterion="< 0",
                quantity="exponent p of the albedo ~ (n.l)^p",
                reading=ONE,
                figure="albedo_figure",
                table="albedos",
            )
            context.note(
                f"G = 1 everywhere, m = {m:g}: towards grazing incidence the albedo goes as "
                f"(n.l)^p, p = {format_value(p, spread)}; it is "
                f"{format_value(found.value[-1], found.error[-1])} at {end}."
            )
            continue
        lost, errors = losses[m].value, losses[m].error
        least = int(np.argmin(lost))
        context.claim(
            "N4",
            f"The albedo passes 1, as it must to diverge, m = {m:g}.",
            value=float(lost[least]),
            error=float(errors[least]),
            criterion="< 0",
            quantity=f"smallest 1 - a for cos θ from 1 to {cosines[-1]:.0e}",
            reading=PRINTED,
            figure="albedo_figure",
            table="albedos",
        )
        context.note(
            f"G as printed, m = {m:g}: the albedo is below 1 at every cosine: 1 - a is "
            f"{format_value(lost[0], errors[0])} at normal incidence and "
            f"{format_value(lost[-1], errors[-1])} at {end}."
        )
    context.note(
        "That no albedo with G as printed is above 1, at any L, is the weak white furnace: G is at "
        "most min(1, 2 NH NL/LH), and the integral of D times that times (LH) over all H is n.l."
    )


# Colours of Okabe and Ito.
_CAP, _ONE, _LIGHT, _MIRROR = "#0072B2", "#D55E00", "#222222", "#009E73"


def on_page(z: np.ndarray | float, psi: np.ndarray | float) -> tuple[Any, Any]:
    """Lambert's equal-area projection about N: the horizon is the unit circle, L on the right."""
    radius = np.sqrt(1.0 - np.asarray(z))
    return -radius * np.cos(psi), radius * np.sin(psi)


def fill_region(axes: Axes, region: Region, color: str, **line: Any) -> None:
    """Draw a set of V with its boundary."""
    from matplotlib.colors import to_rgba

    x, y = on_page(*outline(region, DRAWN))
    axes.fill(x, y, facecolor=to_rgba(color, 0.22), edgecolor="none")
    axes.plot([*x, x[0]], [*y, y[0]], color=color, **line)


def frame_hemisphere(axes: Axes, names: bool = True) -> None:
    """The horizon, elevations of 30 and 60 degrees, and the normal."""
    turn = np.linspace(0.0, 2.0 * math.pi, 181)
    for elevation in (0.0, 30.0, 60.0):
        z = math.sin(math.radians(elevation))
        x, y = on_page(z, turn)
        look = {"color": "#222222", "linewidth": 1.1} if elevation == 0.0 else {"color": "#cccccc"}
        axes.plot(x, y, **{"linewidth": 0.8, "zorder": 1.2, **look})
        if names and elevation:
            white = {"facecolor": "white", "edgecolor": "none", "pad": 0.8}
            text = {"color": "#777777", "ha": "center", "va": "center", "fontsize": 8.5}
            axes.text(*on_page(z, math.radians(125.0)), f"{90 - elevation:g}°", bbox=white, **text)
    if names:
        axes.plot([0.0], [0.0], "+", color="#222222", markersize=7)
        axes.text(0.04, 0.04, "N", fontsize=10)
    axes.set_aspect("equal")
    axes.axis("off")


def mark(axes: Axes, x: float, marker: str, color: str, size: float = 6.0) -> None:
    """A direction in the plane of incidence."""
    axes.plot(
        *([x], [0.0], marker),
        color=color,
        markersize=size,
        markeredgecolor="white",
        markeredgewidth=0.6,
        zorder=4,
        clip_on=False,
    )


def keys() -> list[Any]:
    """What a legend lists: the two sets, L and R."""
    from matplotlib.colors import to_rgba
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    cap = {"facecolor": to_rgba(_CAP, 0.22), "edgecolor": _CAP, "linewidth": 1.5}
    one = {"facecolor": to_rgba(_ONE, 0.22), "edgecolor": _ONE, "linewidth": 1.5}
    return [
        Patch(label="H in the cap", **cap),
        Patch(label="G = 1", linestyle="--", **one),
        Line2D([], [], marker="o", color=_LIGHT, linestyle="none", label="light L"),
        Line2D([], [], marker="^", color=_MIRROR, linestyle="none", label="mirror R"),
    ]


def draw_critical(context: Context) -> None:
    """The paper's figure: where H stays in the cap for all L of the arc, and where G = 1."""
    from matplotlib.colors import to_rgba
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch, Rectangle

    lines = {80.0: "-", 85.0: (0, (6, 2)), 89.0: (0, (1.2, 1.4))}
    z = np.sin(np.linspace(0.0, 2.0 * CAP, 201))
    psi = on_arc(FIRST, CAP, z)
    stays = on_page(np.append(z, z[::-1]), np.append(psi, -psi[::-1]))
    with plotting.style():
        figure = Figure(figsize=(7.2, 4.1), layout="constrained")
        grid = figure.add_gridspec(1, 2, width_ratios=(1.0, 0.8))
        whole, close_up = (figure.add_subplot(cell) for cell in grid)
        for axes, close in ((whole, False), (close_up, True)):
            frame_hemisphere(axes, names=not close)
            axes.fill(*stays, facecolor=to_rgba(_CAP, 0.35), edgecolor="none")
            axes.plot(*stays, color=_CAP, linewidth=2.6 if close else 1.2)
            for theta, dashes in lines.items():
                e = math.radians(90.0 - theta)
                look = {"linestyle": dashes, "linewidth": 1.3} if close else {"linewidth": 0.9}
                if close:
                    axes.plot(*on_page(*outline(Region(e, cap=CAP), DRAWN)), color=_CAP, **look)
                fill_region(axes, Region(e, g_one=True), _ONE, **look)
                if close:
                    mark(axes, -float(on_page(math.sin(e), math.pi)[0]), "^", _MIRROR, 4.5)
        lights, _ = on_page(np.sin(np.radians(np.linspace(0.0, 90.0 - FIRST, 20))), math.pi)
        whole.plot(lights, 0.0 * lights, color=_LIGHT, linewidth=4.0, solid_capstyle="butt")
        whole.text(lights[10], 0.06, "L", fontsize=10, ha="center")
        left, bottom, width, height = -1.03, -0.36, 0.46, 0.72
        whole.add_patch(
            Rectangle((left, bottom), width, height, fill=False, edgecolor="#777777", linewidth=0.9)
        )
        close_up.set_xlim(left, left + width)
        close_up.set_ylim(bottom, bottom + height)
        whole.set_title("Hemisphere of V")
        close_up.set_title("Close-up of the frame")
        single = [
            Line2D([], [], color="#444444", linestyle=dashes, label=f"L at {theta:g}° alone")
            for theta, dashes in lines.items()
        ]
        filled = {"facecolor": to_rgba(_CAP, 0.35), "edgecolor": _CAP, "linewidth": 2.2}
        plotting.add_legend(
            figure,
            whole,
            [
                Patch(label="H in the cap for all L", **filled),
                single[0],
                Patch(label="G = 1", facecolor=to_rgba(_ONE, 0.22), edgecolor=_ONE),
                single[1],
                keys()[3],
                single[2],
            ],
        )
    context.figure(
        "critical_figure",
        figure,
        "Directions V for which H stays within 10 degrees of N for all L from 80 degrees to the "
        "horizon (thick, filled, blue; thin outlines for single L), and for which G of eq. 10 is "
        "one (orange). Lambert's equal-area projection about N; the horizon is the outer circle.",
    )


def draw_hemispheres(context: Context) -> None:
    """Both sets on the hemisphere of V, for four L."""
    from matplotlib.figure import Figure

    def sets(axes: Axes, elevation: float, size: float = 6.0) -> None:
        fill_region(axes, Region(elevation, cap=CAP), _CAP, linewidth=1.5)
        fill_region(axes, Region(elevation, g_one=True), _ONE, linewidth=1.4, linestyle="--")
        right = float(on_page(math.sin(elevation), math.pi)[0])
        mark(axes, -right, "^", _MIRROR, size)

    with plotting.style():
        figure = Figure(figsize=(6.5, 7.2), layout="constrained")
        figure.get_layout_engine().set(h_pad=0.12)
        for number, theta in enumerate(ANGLES):
            axes = figure.add_subplot(2, 2, number + 1)
            elevation = math.radians(90.0 - theta)
            frame_hemisphere(axes)
            sets(axes, elevation)
            mark(axes, float(on_page(math.sin(elevation), math.pi)[0]), "o", _LIGHT)
            axes.set_title(f"θ = {theta:g}°", pad=8)
            if theta == ANGLES[-1]:
                # The set with G = 1 is small here: it is shown again, seven times as large.
                box = (-0.2, -0.78, 0.80, 0.52)
                inset = axes.inset_axes(box, transform=axes.transData)
                frame_hemisphere(inset, names=False)
                sets(inset, elevation)
                inset.axis("on")
                inset.set_xlim(-1.009, -1.009 + box[2] / 7.0)
                inset.set_ylim(-box[3] / 14.0, box[3] / 14.0)
                inset.set_xticks([])
                inset.set_yticks([])
                inset.grid(visible=False)
                inset.spines[:].set(visible=True, color="#777777")
                axes.indicate_inset_zoom(inset, edgecolor="#777777", alpha=1.0)
        plotting.add_legend(figure, axes, keys())
    context.figure(
        "hemispheres_figure",
        figure,
        "Sets of V for one L: H within 10 degrees of N, and G = 1. Lambert's equal-area projection "
        "with N in the centre and the horizon as the outer circle; rings at 30 and 60 degrees.",
    )


def draw_slopes(context: Context) -> None:
    """The same sets of half vectors, in slopes."""
    from matplotlib.colors import to_rgba
    from matplotlib.lines import Line2D

    dots = (0, (1.2, 1.4))
    turn = np.linspace(0.0, 2.0 * math.pi, 181)
    disc = math.tan(CAP) * np.cos(turn), math.tan(CAP) * np.sin(turn)
    rise = np.sin(np.linspace(0.0, 0.5 * math.pi, 101)) ** 2
    with plotting.style():
        figure, panels = plotting.new_figure(3, 7.2, 3.3)
        for axes, theta in zip(panels, (60.0, 75.0, 85.0), strict=True):
            region = Region(math.radians(90.0 - theta), g_one=True)
            edges = itertools.pairwise(region.slope_edges())
            x = np.concatenate([a + (b - a) * rise for a, b in edges])
            y = region.slope_limit(x)
            x, y = np.append(x, x[::-1]), np.append(y, -y[::-1])
            axes.fill(x, y, facecolor=to_rgba(_ONE, 0.22), edgecolor="none")
            axes.plot([*x, x[0]], [*y, y[0]], "--", color=_ONE, linewidth=1.4)
            axes.fill(*disc, facecolor=to_rgba(_CAP, 0.22))
            axes.plot(*disc, color=_CAP, linewidth=1.5)
            tangent = math.tan(math.radians(theta))
            for centre, radius, look in (
                (tangent, math.hypot(1.0, tangent), {"color": "#222222", "linewidth": 1.1}),
                (0.5 * tangent, 0.5 * tangent, {"color": _MIRROR, "linestyle": dots}),
            ):
                part = np.linspace(-1.0, 1.0, 181) * min(math.pi, 2.0 / radius)
                axes.plot(centre - radius * np.cos(part), radius * np.sin(part), **look)
            axes.set_xlim(-0.45, 0.85)
            axes.set_ylim(-1.05, 1.05)
            axes.set_aspect("equal")
            axes.set_xticks((0.0, 0.5))
            axes.set_yticks((-1.0, -0.5, 0.0, 0.5, 1.0))
            axes.set_title(f"θ = {theta:g}°")
            axes.set_xlabel("slope towards L")
        panels[0].set_ylabel("slope of H across")
        plotting.add_legend(
            figure,
            panels[0],
            [
                *keys()[:2],
                Line2D([], [], color="#222222", linewidth=1.1, label="V at horizon"),
                Line2D([], [], color=_MIRROR, linestyle=dots, label="n.v = n.l"),
            ],
        )
    context.figure(
        "slopes_figure",
        figure,
        "The half vectors of both sets by their slopes, cap of 10 degrees: where n.v > n.l, G = 1 "
        "ends at the line x = cot θ, and elsewhere at a cubic.",
    )


def grazing_axis(axes: Axes, smallest: float) -> None:
    """A logarithmic axis of n.l with a mark every third decade."""
    axes.set_xscale("log")
    axes.set_xlim(1.0, float(smallest))
    axes.set_xticks(10.0 ** -np.arange(0.0, 0.5 - math.log10(smallest), 3.0))
    axes.set_xlabel("n.l (grazing to the right)")


def draw_solid_angles(context: Context, grazing: pd.DataFrame) -> None:
    """The set with G = 1 in units of n.l, and the solid angles against n.l."""
    with plotting.style():
        figure, (shape, axes) = plotting.new_figure(2, 7.2, 3.5)
        for theta, color, dashes in (
            (70.0, "#56B4E9", (0, (6, 2))),
            (80.0, "#0072B2", (0, (3, 1.6))),
            (85.0, "#222222", (0, (1.2, 1.4))),
        ):
            region = Region(math.radians(90.0 - theta), g_one=True)
            z, psi = outline(region, DRAWN)
            shape.plot(psi / region.c, z / region.c, color=color, linestyle=dashes,
                       label=f"θ = {theta:g}°")  # fmt: skip
        t = np.concatenate((1.0 / 3.0 + 2.0 / 3.0 * np.linspace(0.0, 1.0, 101) ** 2,
                            3.0 - 2.0 * np.linspace(1.0, 0.0, 101) ** 2))  # fmt: skip
        w = np.sqrt(np.where(t < 1.0, 3.0 * t**2 + 2.0 * t - 1.0, 4.0 - (t - 1.0) ** 2).clip(0.0))
        shape.fill(np.append(w, -w[::-1]), np.append(t, t[::-1]), color=_ONE, alpha=0.22)
        shape.plot(np.append(w, -w[::-1]), np.append(t, t[::-1]), color=_ONE, label="θ → 90°")
        shape.plot([0.0], [1.0], "^", color=_MIRROR, markersize=6)
        shape.annotate("R", (0.0, 1.0), (0.12, 1.05))
        shape.set_aspect("equal")
        shape.set_xlim(-2.6, 2.6)
        shape.set_ylim(0.0, 3.9)
        shape.set_xlabel("azimuth from R, over n.l")
        shape.set_ylabel("n.v over n.l")
        shape.set_title("Where G = 1")
        shape.legend(loc="upper center", ncols=2, fontsize=8.5, columnspacing=1.0, handlelength=2.6)
        x = grazing["cos_theta"]
        for column, label, look in (
            ("cap", "H in the cap", {"color": _CAP}),
            ("g_one", "G = 1", {"color": _ONE, "linestyle": "--"}),
            ("both", "both", {"color": "#AA4499", "linestyle": (0, (1.2, 1.4))}),
        ):
            axes.plot(x, grazing[column], label=label, **look)
        axes.set_yscale("log")
        grazing_axis(axes, x.min())
        axes.set_ylabel("solid angle of V (sr)")
        axes.set_title("Solid angles")
        axes.legend(loc="lower left")
    context.figure(
        "solid_angle_figure",
        figure,
        "Left: the set of V with G = 1, in units of n.l, tends to half a circle above a hyperbola. "
        "Right: its solid angle falls as the square of n.l, that of the cap does not.",
    )


def draw_albedos(
    context: Context,
    cosines: np.ndarray,
    albedos: dict[tuple[str, float], Estimate],
    reflected: pd.DataFrame,
) -> None:
    """Albedos of both readings, and what is reflected where G = 1."""
    with plotting.style():
        figure, panels = plotting.new_figure(2, 7.2, 3.5)
        for axes, m in zip(panels, WIDTHS, strict=True):
            for value, color, dashes, label in (
                (albedos["none", m].value, "#222222", "-", "albedo, G = 1 everywhere"),
                (reflected[f"cap_m={m:g}"], _CAP, (0, (6, 1.6, 1.2, 1.6)),
                 "into the cap, G = 1 there"),
                (albedos["v_cavity", m].value, _MIRROR, (0, (6, 2)), "albedo, G as printed"),
                (reflected[f"g_one_m={m:g}"], _ONE, (0, (1.2, 1.4)), "of that, where G = 1"),
            ):  # fmt: skip
                axes.plot(cosines, value, color=color, linestyle=dashes, label=label)
            axes.axhline(1.0, color="#888888", linewidth=0.9, zorder=1.5)
            axes.set_yscale("log")
            grazing_axis(axes, cosines[-1])
            axes.set_title(f"m = {m:g}")
        panels[0].set_ylabel("share of the light")
        panels[1].sharey(panels[0])
        plotting.add_legend(figure, panels[0])
    context.figure(
        "albedo_figure",
        figure,
        "With G as printed the albedo stays below 1, and ever less of it is reflected where G is "
        "one; with G = 1 on a fixed cap the light reflected into it grows as the inverse of n.l.",
    )
