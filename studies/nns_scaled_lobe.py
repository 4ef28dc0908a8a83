"""How far does the factor s of NNS eq. 7 lift grazing reflection relative to normal?

The paper scales the vertical component of Lafortune's lobe, f = c(n, s) max(0, R.x V.x + R.y V.y +
s R.z V.z)^n with 0 < s <= 1, and leaves c(n, s) open. Here it is one over the largest albedo, so
that the lobe reflects all light at its best angle; ratios of albedos do not depend on it. The lobe
is Phong's for s = 1. Its axis (R.x, R.y, s R.z) lies between the mirror direction and the horizon,
at the angle atan(tan(theta)/s) to the normal.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

import albedo
from albedo import plotting
from albedo.estimate import format_value
from albedo.studies import Study

if TYPE_CHECKING:
    from albedo.brdf import Model
    from albedo.estimate import Estimate
    from albedo.studies import Context

STUDY = Study(
    name="nns_scaled_lobe",
    title="Lafortune's lobe scaled along the normal",
    paper="NNS",
    claims=("N15",),
)

EXPONENTS = (20.0, 100.0)
# Values of s that are drawn.
SCALES = (1.0, 0.98, 0.96, 0.94, 0.92, 0.9)
# Angles of incidence that are compared with normal incidence, degrees.
LIFTED = (80.0, 89.0)
# Angles of incidence of the radiance, degrees.
LIGHTS = (60.0, 80.0)
_EPS = float(np.finfo(float).eps)


def run(context: Context) -> None:
    """Albedos against the angle and against s, radiance in the plane of incidence, verdicts."""
    rtol = 1e-10 if context.full else 1e-8
    context.setting(rtol=rtol)
    cosines = plotting.angle_grid()
    curves: dict[tuple[float, float], Estimate] = {}
    for done, n in enumerate(EXPONENTS):
        context.progress(done, 3, f"albedos, n = {n:g}")
        for s in SCALES:
            curves[n, s] = albedo.directional_albedo(lobe(n, s), cosines, rtol=rtol)
    context.table("by_angle", as_frame(cosines, curves), "Albedos against the angle of incidence")
    context.progress(2, 3, "ratios")
    ratios = lifts(np.linspace(1.0, 0.9, 41 if context.full else 11), rtol)
    context.table("ratios", ratios, "Grazing over normal albedo against s")
    peaks = measure_peaks()
    context.table("peaks", peaks, "Largest reflected radiance in the plane of incidence")
    draw_albedos(context, cosines, curves)
    draw_ratios(context, ratios)
    draw_radiance(context)
    judge(context, ratios, peaks)
    remark(context, cosines, curves, ratios, peaks)


def lobe(n: float, s: float) -> Model:
    """The model of eq. 7."""
    return albedo.model("lafortune_scaled", n=n, s=s)


def as_frame(cosines: np.ndarray, curves: dict[tuple[float, float], Estimate]) -> pd.DataFrame:
    """One row for every angle, three columns for every lobe."""
    columns: dict[str, Any] = {"theta_deg": np.degrees(np.arccos(cosines)), "cos_theta": cosines}
    for (n, s), found in curves.items():
        name = f"n={n:g},s={s:g}"
        columns[name] = found.value
        columns[f"{name}_error"] = found.error
        columns[f"{name}_evaluations"] = found.evaluations
    return pd.DataFrame(columns)


def quotient(a: float, a_error: float, b: float, b_error: float) -> tuple[float, float]:
    """a/b and its bound; b is surely positive."""
    ratio = a / b
    return ratio, (a_error + ratio * b_error) / (b - b_error) + 4.0 * _EPS * ratio


def lifts(scales: np.ndarray, rtol: float) -> pd.DataFrame:
    """Albedos at normal and at grazing incidence, their ratio, and that over the one of s = 1."""
    cosines = np.cos(np.radians((0.0, *LIFTED)))
    rows = []
    for n in EXPONENTS:
        phong: dict[float, tuple[float, float]] = {}
        for s in scales:
            found = albedo.directional_albedo(lobe(n, float(s)), cosines, rtol=rtol)
            row = {"n": n, "s": s, "normal": found.value[0], "normal_error": found.error[0]}
            for k, theta in enumerate(LIFTED, start=1):
                ratio = quotient(found.value[k], found.error[k], found.value[0], found.error[0])
                phong.setdefault(theta, ratio)
                values = {
                    f"albedo_{theta:g}": (found.value[k], found.error[k]),
                    f"ratio_{theta:g}": ratio,
                    f"lift_{theta:g}": quotient(*ratio, *phong[theta]),
                }
                for name, (value, error) in values.items():
                    row[name], row[f"{name}_error"] = value, error
            rows.append(row)
    return pd.DataFrame(rows)


def measure_peaks() -> pd.DataFrame:
    """Largest f cos(theta_l) of V in the plane of incidence, and where it is.

    The peak is c |o|^n cos(theta_l) with o = (sin(theta_l), 0, s cos(theta_l)), in its direction:
    s^n c at normal incidence. The model is evaluated there as well; what differs is in the error.
    """
    rows = []
    for n in EXPONENTS:
        for s in SCALES:
            model = lobe(n, s)
            constant, error = model.normalization  # type: ignore[attr-defined]
            for theta in LIGHTS:
                cosine, sine = math.cos(math.radians(theta)), math.sin(math.radians(theta))
                angle = peak_angle(theta, s)
                peak = constant * math.hypot(sine, s * cosine) ** n * cosine
                evaluated, mirror = radiance(model, theta, np.array([angle, theta]))
                # A power of n has n times the rounding of its base.
                rounding = 4.0 * _EPS * (n + 10.0)
                relative = math.hypot(sine / s, cosine) ** n * cosine
                rows.append(
                    {
                        "n": n,
                        "s": s,
                        "theta_deg": theta,
                        "peak": peak,
                        "peak_error": peak * (error + rounding) + abs(peak - evaluated),
                        "peak_over_normal": relative,
                        "peak_over_normal_error": relative * rounding,
                        "peak_at_deg": angle,
                        "beyond_mirror_deg": angle - theta,
                        "in_mirror_direction": mirror,
                    }
                )
    return pd.DataFrame(rows)


def peak_angle(theta: float, s: float) -> float:
    """Angle of the lobe's axis to the normal, degrees.

    It is atan(tan(theta)/s); as theta plus the angle from there, which has the tangent
    (1 - s) sin cos/(sin^2 + s cos^2).
    """
    sine, cosine = math.sin(math.radians(theta)), math.cos(math.radians(theta))
    return theta + math.degrees(math.atan2((1.0 - s) * sine * cosine, sine**2 + s * cosine**2))


def radiance(model: Model, theta: float, angles: np.ndarray) -> np.ndarray:
    """f cos(theta_l) per unit of irradiance across the beam, in 1/sr, in the plane of incidence.

    Parameters
    ----------
    model : Model
        The model.
    theta : float
        Angle of incidence, degrees.
    angles : ndarray
        Angles of V to the normal, degrees, positive on the side of the mirror direction.

    Returns
    -------
    ndarray
        The radiance for each angle.
    """
    light, view = math.radians(theta), np.radians(angles)
    wi = np.array([math.sin(light), 0.0, math.cos(light)])
    wo = np.stack([-np.sin(view), 0.0 * view, np.cos(view)], axis=-1)
    return model.eval(wi, wo) * math.cos(light)


def judge(context: Context, ratios: pd.DataFrame, peaks: pd.DataFrame) -> None:
    """Does s lift grazing over normal, at every step, and the radiance with it?"""
    for n, group in ratios.groupby("n"):
        last = group.iloc[-1]
        for theta in LIFTED:
            name = f"ratio_{theta:g}"
            context.claim(
                "N15",
                f"A factor of s = {last['s']:g} lifts the albedo at {theta:g}° relative to that at "
                f"normal incidence, n = {n:g}.",
                value=last[f"lift_{theta:g}"],
                error=last[f"lift_{theta:g}_error"],
                criterion="> 1",
                quantity=f"a({theta:g}°)/a(0°), over the same for s = 1",
            )
            value, error = group[name].to_numpy(), group[f"{name}_error"].to_numpy()
            steps = [
                quotient(value[k + 1], error[k + 1], value[k], error[k])
                for k in range(value.size - 1)
            ]
            context.claim(
                "N15",
                f"Each smaller s lifts a({theta:g}°)/a(0°) further, n = {n:g}.",
                *min(steps, key=lambda step: step[0] - step[1]),
                criterion="> 1",
                quantity=f"smallest factor between {value.size} values of s",
            )
    for n, theta in ((n, theta) for n in EXPONENTS for theta in LIGHTS):
        group = peaks[(peaks["n"] == n) & (peaks["theta_deg"] == theta)]
        name = "peak_over_normal"
        first, last = ((row[name], row[f"{name}_error"]) for row in (group.iloc[0], group.iloc[-1]))
        value, error = quotient(*last, *first)
        context.claim(
            "N15",
            f"A factor of s = {group['s'].iloc[-1]:g} lifts the largest radiance of light from "
            f"{theta:g}° relative to that at normal incidence, n = {n:g}.",
            value=value,
            error=error,
            criterion="> 1",
            quantity="largest f cos θ over that at normal incidence, over the same for s = 1",
        )


def remark(
    context: Context,
    cosines: np.ndarray,
    curves: dict[tuple[float, float], Estimate],
    ratios: pd.DataFrame,
    peaks: pd.DataFrame,
) -> None:
    """The numbers in words."""
    theta = np.degrees(np.arccos(cosines))
    for n, group in ratios.groupby("n"):
        texts = [
            f"{angle:g}°: from {format_value(group[name].iloc[0], group[f'{name}_error'].iloc[0])} "
            f"to {format_value(group[name].iloc[-1], group[f'{name}_error'].iloc[-1])}"
            for angle, name in ((angle, f"ratio_{angle:g}") for angle in LIFTED)
        ]
        context.note(
            f"n = {n:g}, albedo over that at normal incidence as s goes from 1 to "
            f"{group['s'].iloc[-1]:g}: " + "; ".join(texts) + "."
        )
        tops = []
        for s in SCALES:
            found = curves[n, s]
            top = int(np.argmax(found.value))
            tops.append(f"{theta[top]:.3g}° for s = {s:g}")
        last = group.iloc[-1]
        context.note(
            f"n = {n:g}: the largest albedo of these angles is at {', '.join(tops)}. What grazing "
            f"angles gain is taken from normal incidence, where "
            f"{format_value(last['normal'], last['normal_error'])} is left for s = {last['s']:g}."
        )
    for angle in LIGHTS:
        rows = peaks[(peaks["theta_deg"] == angle) & (peaks["s"] == SCALES[-1])]
        phong = peaks[(peaks["theta_deg"] == angle) & (peaks["s"] == 1.0)]
        texts = [
            f"n = {n:g}: {format_value(peak, error)}/sr, {peak / first:.4g} times that of s = 1, "
            f"and {mirror / peak:.1%} of it in the mirror direction"
            for n, peak, error, mirror, first in zip(
                *(rows[name] for name in ("n", "peak", "peak_error", "in_mirror_direction")),
                phong["peak"],
                strict=True,
            )
        ]
        shift = rows["beyond_mirror_deg"].iloc[0]
        context.note(
            f"Light from {angle:g}°, s = {SCALES[-1]:g}: the largest radiance is {shift:.4f}° from "
            f"the mirror direction towards the horizon, at {angle + shift:.4f}°, for any n. "
            + "; ".join(texts)
            + ". Unlike the ratios, this depends on c(n, s)."
        )


def looks() -> dict[float, dict[str, Any]]:
    """One colour and one dash for every s."""
    from matplotlib import colormaps

    dashes = (
        "-",
        (0, (6, 2)),
        (0, (1.2, 1.4)),
        (0, (6, 1.6, 1.2, 1.6)),
        (0, (3, 1.6)),
        (0, (10, 2)),
    )
    shades = colormaps["viridis"](np.linspace(0.0, 0.82, len(SCALES)))
    return {
        s: {"color": shades[k], "linestyle": dashes[k], "label": f"s = {s:g}"}
        for k, s in enumerate(SCALES)
    }


def draw_albedos(
    context: Context, cosines: np.ndarray, curves: dict[tuple[float, float], Estimate]
) -> None:
    """Albedo against the angle, a panel for each exponent."""
    with plotting.style():
        figure, panels = plotting.new_figure(2, 7.4, 3.4)
        for axes, n in zip(panels, EXPONENTS, strict=True):
            for s, look in looks().items():
                axes.plot(np.degrees(np.arccos(cosines)), curves[n, s].value, **look)
            axes.axhline(1.0, color="#888888", linewidth=0.9, zorder=1.5)
            axes.set_xlim(0.0, 90.0)
            axes.set_ylim(0.0, 1.05)
            axes.set_xticks(np.arange(0.0, 91.0, 15.0))
            axes.set_xlabel("angle of incidence (degrees)")
            axes.set_title(f"n = {n:g}")
        panels[0].set_ylabel("directional albedo")
        plotting.add_legend(figure, panels[0])
    context.figure(
        "albedo_figure",
        figure,
        "Albedo of the scaled lobe, normalised so that its largest value is one (grey line).",
    )


def draw_ratios(context: Context, ratios: pd.DataFrame) -> None:
    """Grazing over normal albedo against s."""
    shades = {20.0: "#0072B2", 100.0: "#D55E00"}
    dashes = {80.0: "-", 89.0: (0, (6, 2))}
    with plotting.style():
        figure, (axes,) = plotting.new_figure(height=3.6)
        for n, group in ratios.groupby("n"):
            for theta in LIFTED:
                axes.plot(
                    *(group["s"], group[f"ratio_{theta:g}"]),
                    color=shades[n],
                    linestyle=dashes[theta],
                    label=f"{theta:g}°, n = {n:g}",
                )
        axes.axhline(1.0, color="#888888", linewidth=0.9, zorder=1.5)
        axes.set_yscale("log")
        axes.set_xlim(1.0, 0.9)
        axes.set_xlabel("factor s of the vertical component")
        axes.set_ylabel("albedo over that at 0°")
        plotting.add_legend(figure, axes)
    context.figure(
        "ratio_figure",
        figure,
        "Albedo at 80 and 89 degrees over that at normal incidence; above the grey line grazing "
        "light is reflected more than normal light.",
    )


def draw_radiance(context: Context) -> None:
    """Radiance in the plane of incidence; rows are exponents, columns angles of incidence."""
    from matplotlib.figure import Figure

    angles = np.linspace(0.0, 90.0, 361)
    with plotting.style():
        figure = Figure(figsize=(7.4, 5.4), layout="constrained")
        for number, (n, theta) in enumerate((n, theta) for n in EXPONENTS for theta in LIGHTS):
            axes = figure.add_subplot(2, 2, number + 1)
            for s, look in looks().items():
                value = radiance(lobe(n, s), theta, angles)
                axes.plot(angles, value, **look)
                top = peak_angle(theta, s)
                peak = radiance(lobe(n, s), theta, np.array([top]))
                axes.plot([top], peak, "o", color=look["color"], markersize=3.5)
            axes.axvline(theta, color="#888888", linewidth=0.9, zorder=1.5)
            axes.set_xlim(theta - (45.0 if n < 50.0 else 25.0), 90.0)
            axes.set_ylim(0.0, None)
            axes.set_title(f"n = {n:g}, light from {theta:g}°")
            if number >= 2:
                axes.set_xlabel("angle of V to the normal (degrees)")
            if number % 2 == 0:
                axes.set_ylabel("f cos θ (1/sr)")
        plotting.add_legend(figure, axes)
    context.figure(
        "radiance_figure",
        figure,
        "Reflected radiance in the plane of incidence, for light of irradiance 1 on a plane across "
        "it; the grey line is the mirror direction, dots are the peaks.",
    )
