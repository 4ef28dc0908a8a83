"""The studies of NNS figs. 3 to 6: what two models become, pumped up with and without control."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from albedo.analysis import pumping
from albedo.estimate import format_value

if TYPE_CHECKING:
    from albedo.brdf import Model
    from albedo.studies import Context

STEPS = 5
"""Steps that are drawn."""

LIGHTS = (30.0, 60.0, 80.0)
"""Angles of incidence, in degrees, at which radiances are drawn."""

# The angle is there to be read; the cosine is what was computed with.
READ = {"theta_deg": 9}
# What one would see of a highlight beside the mirror direction.
SEEN = 1.01
BRIGHT, BESIDE = "brighter than a mirror", "brightest beside the mirror direction"


def recursive(context: Context, model: Model, name: str) -> None:
    """NNS figs. 3 and 4: recursive pumping-up, and the claims N6 and N8.

    Parameters
    ----------
    context : Context
        Of the study.
    model : Model
        What is pumped up.
    name : str
        What it is called in sentences.
    """
    rtol = 1e-11 if context.full else 1e-10
    context.setting(rtol=rtol)
    steps = 2 * STEPS if context.full else STEPS
    cosines = pumping.default_cosines(context.full)
    data = pumping.series(model, steps, cosines=cosines, rtol=rtol, advance=context.progress)
    peaks = pumping.find_peaks(data, _peak_cosines(context), context.progress)
    radiance = pumping.radiance_frame(data, LIGHTS)
    shown = range(STEPS + 1)

    gains = pumping.steps_frame(data)
    context.table("steps", gains, "What each step gains at least and at most, and what is lost")
    caption = "The largest output radiance over all views, in 1/sr"
    context.table("peaks", peaks.frame(), caption, digits=READ)
    context.table("albedo", pumping.albedo_frame(data), "Albedo after each step", digits=READ)
    context.table("radiance", radiance, "Output radiance in the plane of incidence, in 1/sr")
    context.figure(
        "albedo_figure",
        pumping.draw_albedos(data, shown),
        "Albedo after each step, in degrees and towards grazing incidence.",
    )
    context.figure(
        "radiance_figure",
        pumping.draw_radiance(radiance, shown),
        "Output radiance in the plane of incidence; the grey line is the mirror direction.",
    )
    context.figure(
        "peaks_figure",
        pumping.draw_peaks(peaks, shown),
        "The largest output radiance over all views, in units of the lobe's at normal incidence.",
    )
    _say_recursive(context, data, peaks)
    _claim_recursive(context, data, peaks, name)


def _peak_cosines(context: Context) -> np.ndarray:
    """Every other one when it has to be quick."""
    return pumping.PEAK_COSINES[:: 1 if context.full else 2]


def _say_recursive(context: Context, data: pumping.Series, peaks: pumping.Peaks) -> None:
    """The numbers in words."""
    shown = range(STEPS + 1)
    half = int(np.argmin(np.abs(data.cosines - 0.5)))
    context.note(
        "Albedo at 60 degrees: "
        + ", ".join(format_value(data.value[k, half], data.error[k, half]) for k in shown)
        + f" after 0 to {STEPS} steps; in the limit of grazing incidence: "
        + ", ".join(format_value(data.limit[k], data.limit_error[k]) for k in shown)
        + "."
    )
    theta = np.degrees(np.arccos(data.cosines))
    near = int(np.argmin(np.abs(theta - 5.0)))
    first = float(np.max(np.abs(data.value[:, 0] - 1.0) + data.error[:, 0]))
    context.note(
        f"At normal incidence every albedo is 1 (within {first:.0e}), so there both sides of "
        "a ≤ a* ≤ 1 are equalities, and near it the differences are smaller than any bound: at "
        f"{theta[near]:g}° what is lost after 0 to {STEPS} steps is "
        + ", ".join(
            format_value(1.0 - data.value[k, near], data.error[k, near]) for k in range(STEPS + 1)
        )
        + ". The claims are about angles from ten degrees on; the table says from where on each "
        "step's differences are surely above 0."
    )
    for k in sorted({1, STEPS, data.steps}):
        top, gain = peaks.tops[k], peaks.gains[k]
        context.note(
            f"After {k} step{'s' if k > 1 else ''} the largest output radiance at cosines of "
            f"incidence from {peaks.cosines.min():g} on is {format_value(top.value, top.error)} "
            f"times the lobe's at normal incidence, at {top.theta_deg:.2f}°, and up to "
            f"{format_value(gain.value, gain.error)} times what it was before any step, at "
            f"{gain.theta_deg:.3f}°."
        )


def _claim_recursive(
    context: Context, data: pumping.Series, peaks: pumping.Peaks, name: str
) -> None:
    """N6 for all steps together, N8 after the steps of the figure."""
    inside = data.at(pumping.NEAR_NORMAL)
    gains = [data.gain(k) for k in range(1, STEPS + 1)]
    _, value, error = pumping.least(
        np.concatenate([gain[inside] for gain, _ in gains]),
        np.concatenate([bound[inside] for _, bound in gains]),
    )
    context.claim(
        "N6",
        f"Each of {STEPS} steps gains light: a < a*.",
        value=value,
        error=error,
        criterion="> 0",
        quantity="smallest a* - a of all steps, from 10 degrees to a cosine of 1e-6",
    )
    lost, bound = 1.0 - data.value[1 : STEPS + 1], data.error[1 : STEPS + 1]
    _, value, error = pumping.least(lost[:, inside].ravel(), bound[:, inside].ravel())
    context.claim(
        "N6",
        f"None of {STEPS} steps makes light: a* < 1.",
        value=value,
        error=error,
        criterion="> 0",
        quantity="smallest 1 - a* of all steps, from 10 degrees to a cosine of 1e-6",
    )
    top = peaks.tops[STEPS]
    context.claim(
        "N8",
        f"After {STEPS} steps the output radiance of {name} exceeds what an ideal mirror's would "
        "be with the same blur.",
        value=top.value,
        error=top.error,
        criterion="> 1",
        quantity="largest output radiance at all cosines of incidence from "
        f"{peaks.cosines.min():g} on, over that at normal incidence",
        reading=BRIGHT,
        figure="peaks_figure",
        table="peaks",
    )
    _, value, error = pumping.most(*peaks.beside_mirror(STEPS))
    context.claim(
        "N8",
        f"After {STEPS} steps the largest output radiance of {name} lies beside the mirror "
        "direction.",
        value=value,
        error=error,
        criterion=f"> {SEEN}",
        quantity="largest output radiance over that in the mirror direction, at worst",
        reading=BESIDE,
        figure="radiance_figure",
        table="peaks",
    )
    context.explain(
        "N8",
        "After k steps f_k is the lobe f_0 over the product of all max(a_j(L), a_j(V)), j < k. In "
        "the mirror direction R the lobe is largest, and the divisor, nowhere below the product of "
        "the a_j(L), is just that, as a_j(R) = a_j(L). So whatever the number of steps, R is the "
        f"brightest direction for every L: the ratio is {format_value(value, error)}, and no peak "
        "lies beside R. What does grow is the peak itself. Over the lobe's at normal incidence it "
        "is N.L over the product of the a_j(L), and passes 1 once that product falls below the "
        f"cosine. Here it is up to {format_value(top.value, top.error)} after {STEPS} steps, at "
        f"{top.theta_deg:.2f}°. So the warning of a surface that is too "
        "bright holds; where it is brightest is the mirror direction of its light.",
    )


READINGS = {
    "literal": "each step divides by max(a(L), a(V), N.L, N.V)",
    "cumulative": "all steps together divide by no less than max(N.L, N.V)",
}
"""The two readings of controlled pumping-up, NNS eq. 21, in words."""

# Of what is lost, the share that a step leaves when the albedo has come to its limit.
ARRIVED = 0.99
# What is lost is known when it is so many times its bound.
KNOWN = 100.0


def controlled(
    context: Context, model: Model, name: str, worth: tuple[str, str], gains_from: int
) -> None:
    """NNS figs. 5 and 6: controlled pumping-up in both readings, and the claims N9 and N10.

    Parameters
    ----------
    context : Context
        Of the study.
    model : Model
        What is pumped up.
    name : str
        What it is called in sentences.
    worth : tuple of str
        How many steps are said to be worth it: in words, and as a criterion on the number of the
        last step that raises the albedo visibly.
    gains_from : int
        The step from which on the largest gain is noted.
    """
    steps = 20 if context.full else STEPS - 1
    context.setting(rtol=1e-10)
    found = {}
    for control in READINGS:
        cosines = pumping.default_cosines(context.full)
        data = pumping.series(
            model, steps, control, cosines=cosines, advance=_named(context, control)
        )
        peaks = pumping.find_peaks(data, _peak_cosines(context), _named(context, control))
        found[control] = data, peaks
        radiance = pumping.radiance_frame(data, LIGHTS)
        shown = range(STEPS)
        context.table(
            f"steps_{control}",
            pumping.steps_frame(data),
            f"What each step gains at least and at most, and what is lost: {control}",
        )
        context.table(
            f"peaks_{control}",
            peaks.frame(),
            f"The largest output radiance over all views, in 1/sr: {control}",
            digits=READ,
        )
        context.table(
            f"albedo_{control}",
            pumping.albedo_frame(data),
            f"Albedo after each step: {control}",
            digits=READ,
        )
        context.table(
            f"radiance_{control}",
            radiance,
            f"Output radiance in the plane of incidence, in 1/sr: {control}",
        )
        context.figure(
            f"albedo_{control}_figure",
            pumping.draw_albedos(data, shown),
            f"Albedo after each step where {READINGS[control]}.",
        )
        context.figure(
            f"radiance_{control}_figure",
            pumping.draw_radiance(radiance, shown),
            f"Output radiance in the plane of incidence where {READINGS[control]}; the grey line "
            "is the mirror direction.",
        )
    for control, (data, peaks) in found.items():
        _say_controlled(context, data, peaks, control, gains_from)
    for control, (data, peaks) in found.items():
        _claim_controlled(context, data, peaks, name, control, worth)
    _explain_controlled(context, {control: data for control, (data, _) in found.items()}, name)


def _named(context: Context, control: str) -> pumping.Advance:
    def advance(done: int, total: int, text: str) -> None:
        context.progress(done, total, f"{control}, {text}")

    return advance


def _say_controlled(
    context: Context,
    data: pumping.Series,
    peaks: pumping.Peaks,
    control: str,
    gains_from: int,
) -> None:
    half = int(np.argmin(np.abs(data.cosines - 0.5)))
    shown = range(min(STEPS, data.steps) + 1)
    last, doubt = pumping.worthwhile(data)
    late = data.most_gained(data.steps, gains_from - 1)
    context.note(
        f"{control.capitalize()}, where {READINGS[control]}: the albedo at 60 degrees is "
        + ", ".join(format_value(data.value[k, half], data.error[k, half]) for k in shown)
        + f" after 0 to {shown[-1]} steps, and "
        + format_value(data.value[-1, half], data.error[-1, half])
        + f" after {data.steps}; in the limit of grazing incidence it is "
        + ", ".join(format_value(data.limit[k], data.limit_error[k]) for k in shown)
        + f", and {format_value(data.limit[-1], data.limit_error[-1])}. The last step that raises "
        f"it anywhere by more than {pumping.VISIBLE:g} is number {last}"
        + ("" if not doubt else f" or one of the {doubt} after it")
        + (
            f" of {data.steps}. After step {gains_from - 1} it rises by at most "
            f"{format_value(late.value, late.error)} more in all, at {late.theta_deg:.4g}°."
        )
    )


def _claim_controlled(
    context: Context,
    data: pumping.Series,
    peaks: pumping.Peaks,
    name: str,
    control: str,
    worth: tuple[str, str],
) -> None:
    top = max((peaks.tops[k] for k in peaks.tops if k > 0), key=lambda top: top.value + top.error)
    context.claim(
        "N9",
        f"The output radiance of {name} never exceeds that of an ideal mirror with the same blur.",
        value=top.value,
        error=top.error,
        criterion=pumping.at_most(1.0),
        quantity=f"largest output radiance after up to {data.steps} steps at all cosines of "
        f"incidence from {peaks.cosines.min():g} on, over the base's at normal incidence",
        reading=control,
        figure=f"radiance_{control}_figure",
        table=f"peaks_{control}",
    )
    half = int(np.argmin(np.abs(data.cosines - 0.5)))
    lost, doubts = 1.0 - data.value[:, half], data.error[:, half]
    # The last step at which what is lost is known at all.
    k = int(np.flatnonzero(lost > KNOWN * doubts)[-1])
    share = float(lost[k] / lost[k - 1])
    context.claim(
        "N10",
        f"The albedo of {name} converges to a limit below 1.",
        value=share,
        error=float((doubts[k] + share * doubts[k - 1]) / (lost[k - 1] - doubts[k - 1])),
        criterion=f"> {ARRIVED}",
        quantity=f"share of 1 - a at 60 degrees that step {k} of {data.steps} leaves",
        reading=control,
        figure=f"albedo_{control}_figure",
        table=f"albedo_{control}",
    )
    last, doubt = pumping.worthwhile(data)
    context.claim(
        "N10",
        f"{worth[0]}.",
        value=float(last),
        error=float(doubt),
        criterion=worth[1],
        quantity=f"last of {data.steps} steps that raises the albedo anywhere by more than "
        f"{pumping.VISIBLE:g}",
        reading=control,
        figure=f"albedo_{control}_figure",
        table=f"steps_{control}",
    )


def _explain_controlled(context: Context, found: dict[str, pumping.Series], name: str) -> None:
    """Why the control of eq. 21 controls nothing when it is taken step by step."""
    literal, cumulative = found["literal"], found["cumulative"]
    below = literal.cosines - literal.value
    # The steps before which the albedo is somewhere below the cosine.
    controls = [
        k
        for k in range(literal.steps + 1)
        if np.any(below[k] > literal.error[k] + 4.0 * np.finfo(float).eps)
    ]
    first = controls[-1] + 1 if controls else 0
    worst = ", ".join(f"{float(below[k].max()):.2g} (step {k})" for k in controls)
    held = (
        "from the start"
        if first == 0
        else f"from step {first} on, and before less by up to {worst}"
    )
    half = int(np.argmin(np.abs(literal.cosines - 0.5)))
    ends = [
        format_value(data.value[-1, half], data.error[-1, half]) for data in (literal, cumulative)
    ]
    last, _ = pumping.worthwhile(literal)
    context.explain(
        "N9",
        "Taken literally, eq. 21 keeps each divisor from falling below max(N.L, N.V), but not the "
        f"product of several. The albedo of {name} is no less than cos θ {held}. Then the cosines "
        "are never again the largest of the four numbers: each further step is one of recursive "
        "pumping-up, and the radiance in the mirror "
        "direction, the lobe's at normal incidence times N.L over the product of all divisors, "
        "passes 1. If the control is meant for the product of all divisors, that is at least "
        "max(N.L, N.V), so f N.L is at most the lobe's largest value after any number of steps. It "
        "is equal to it where the product has come down to N.L, which is why the measured number "
        "is 1 within its bound.",
    )
    context.explain(
        "N10",
        "Taken literally nothing stops the steps before an albedo of 1, as the cosines never are "
        f"the largest number again: after {literal.steps} steps it is {ends[0]} at 60 degrees, "
        f"and near grazing incidence step {last} still shows. If the product of all divisors is "
        "kept from falling below max(N.L, N.V), f no longer changes where it has come down to "
        f"that, and the albedo stops at {ends[1]} at 60 degrees. The number of steps that the "
        "paper finds worth while is that of this reading.",
    )
