"""Which albedos diverge at grazing incidence, how fast, and from which angle on?

NNS find that Ward's model (eq. 8) and Cook-Torrance's (eqs. 9, 10, 15) diverge; Ashikhmin and
Shirley say of Ward's that it does not conserve energy, Schwenk that it does. For every model the
exponent of the albedo's power law is measured here, and for those two also in the variants that
could be meant: three forms of Ward's model, and Cook-Torrance with the G of eq. 10, with Smith's,
with the G = 1 that eq. 12 puts in its place, and with the prefactor of 1982.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

import albedo
from albedo import plotting
from albedo.analysis.checks import asymmetry
from albedo.analysis.critical_region import LIMIT, Region, measure
from albedo.analysis.grazing import SMALLEST, Asymptote, asymptote, power, theory
from albedo.analysis.pumping import at_most
from albedo.estimate import format_value
from albedo.grammar import parse
from albedo.studies import Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from albedo.studies import Context

STUDY = Study(
    name="grazing",
    title="What albedos do at grazing incidence",
    paper="NNS",
    claims=("N2", "N3", "N4", "A13", "S5"),
)

DIVERGES = 0.005
"""An exponent above this is told from 0."""

WIDTHS = (1.0, 0.4, 0.1, 0.01, 1e-3)
WARD = {
    "ward": ("exact", "Ward 1992 (eq. 8)"),
    "ward_fast": ("fast", "Ward 1992, fast form"),
    "ward_duer": ("", "Ward-Dür"),
    "ward_bounded": ("", "bounded Ward"),
}
MASKING = {
    "v_cavity": "G as printed",
    "smith": "Smith's G",
    "none": "G = 1",
}
DROP = 0.5
TABLE_END = 89.5
"""Where tables often end, degrees."""
DECREASING = {
    "phong:n=150": "Phong, n = 150",
    "he_torrance:sigma0=0.1,tau=1.7": "He-Torrance, σ₀ = 0.1, τ = 1.7",
    "ward:m=0.1": "Ward, m = 0.1",
}


def ward_spec(form: str, m: float) -> str:
    """How the grammar writes a form of Ward's model."""
    kind = WARD[form][0]
    return f"{form.removesuffix('_fast')}:m={m:g}" + (f",form={kind}" if kind == "fast" else "")


def cook_torrance_spec(geometry: str, m: float, more: str = "") -> str:
    return f"cook_torrance:m={m:g},geometry={geometry}{more}"


def run(context: Context) -> None:
    """Measure all models and variants, judge the claims, and draw them."""
    rtol = 1e-11 if context.full else 1e-9
    context.setting(rtol=rtol)
    variants = [ward_spec(form, m) for form in WARD for m in WIDTHS]
    variants += [cook_torrance_spec(g, m) for g in MASKING for m in WIDTHS]
    variants += [
        *(cook_torrance_spec(g, 0.4, ",distribution=ggx") for g in MASKING),
        *(cook_torrance_spec("v_cavity", m, ",prefactor=1/pi") for m in (0.4, 0.1)),
    ]
    names = list(albedo.models())[:: 1 if context.full else 4]
    models = {name: albedo.model(name).by_channel()[0] for name in names}
    total = len(models) + len(variants) + len(DECREASING)
    found: dict[str, Asymptote] = {}

    def follow(spec: str, model: Any) -> Asymptote:
        context.progress(len(found), total, f"albedos of {spec} towards grazing incidence")
        if spec not in found:
            found[spec] = asymptote(model, rtol=rtol, per_decade=8 if context.full else 2)
        return found[spec]

    every = {name: follow(name, model) for name, model in models.items()}
    several = {spec: follow(spec, parse(spec).model()) for spec in variants}
    falling = {spec: follow(spec, parse(spec).model()) for spec in DECREASING}
    context.table("models", as_rows(every), "All models, with their parameters by default")
    context.table("variants", as_rows(several), "Ward's and Cook-Torrance's models")
    regions = solid_angles(context)

    judge_decrease(context, falling)
    judge_ward(context, several)
    judge_cook_torrance(context, several, regions)
    say_models(context, every)
    draw(context, several, every)


def as_rows(found: dict[str, Asymptote]) -> pd.DataFrame:
    """One row for every model."""
    rows = []
    for spec, one in found.items():
        value, error = one.albedo.value, one.albedo.error
        high = int(np.argmax(value))
        expected = theory(one.model)
        ratio, spread = prefactor_ratio(one)
        crossing, width = one.above_one or (math.nan, math.nan)
        rows.append(
            {
                "model": spec,
                "exponent": one.exponent,
                "exponent_error": one.error,
                "theory_exponent": math.nan if expected is None else expected.exponent,
                "prefactor": one.prefactor,
                "measured_over_theory": ratio,
                "measured_over_theory_error": spread,
                "sets_in_at_cos": one.sets_in,
                "normal": value[0],
                "normal_error": error[0],
                "smallest_cos": one.cos_theta[-1],
                "grazing": value[-1],
                "grazing_error": error[-1],
                "highest": value[high],
                "highest_error": error[high],
                "above_one_from_cos": crossing,
                "above_one_from_cos_error": width,
                "above_one_from_deg": 90.0 - math.degrees(math.asin(crossing)),
                "evaluations": int(one.albedo.evaluations.sum()),
            }
        )
    return pd.DataFrame(rows)


def prefactor_ratio(one: Asymptote) -> tuple[float, float]:
    """Measured over predicted prefactor, with its bound; NaN where there is no theory."""
    expected = theory(one.model)
    if expected is None:
        return math.nan, math.nan
    value, error = one.measured_prefactor(expected.exponent)
    ratio = value / expected.prefactor
    return ratio, error / expected.prefactor + ratio * expected.error / expected.prefactor


def highest(one: Asymptote) -> tuple[float, float]:
    """The largest albedo that was measured."""
    k = int(np.argmax(one.albedo.value))
    return float(one.albedo.value[k]), float(one.albedo.error[k])


def solid_angles(context: Context) -> pd.DataFrame:
    """The set of V with G = 1 in eq. 10, as L goes to the horizon."""
    cosines = np.logspace(-1, -12, 45 if context.full else 12)
    found = np.array([measure(Region(math.asin(c), g_one=True)) for c in cosines])
    frame = pd.DataFrame(
        {
            "cos_theta": cosines,
            "solid_angle": found[:, 0],
            "solid_angle_error": found[:, 1],
            "over_cos2": found[:, 0] / cosines**2,
            "over_cos2_error": found[:, 1] / cosines**2,
        }
    )
    context.table("solid_angles", frame, "Directions V with G = 1 in eq. 10, in steradians")
    return frame


def judge_decrease(context: Context, falling: dict[str, Asymptote]) -> None:
    """N2: how much of an albedo is left, before it may rise again."""
    for spec, label in DECREASING.items():
        one = falling[spec]
        value, error = one.albedo.value, one.albedo.error
        k = int(np.argmin(value[one.cos_theta >= SMALLEST]))
        ratio = float(value[k] / value[0])
        context.claim(
            "N2",
            f"{label}: the albedo badly decreases for larger angles of incidence.",
            value=ratio,
            error=float((error[k] + ratio * error[0]) / (value[0] - error[0])),
            criterion=f"< {DROP}",
            quantity=f"lowest albedo, at cos θ = {one.cos_theta[k]:.2g}, over that at the normal",
            reading="with the mirror term" if one.model.name == "he_torrance" else "",
        )


def judge_ward(context: Context, several: dict[str, Asymptote]) -> None:
    """N3, A13, S5: all three papers' words on Ward's model."""
    for m in WIDTHS:
        one = several[ward_spec("ward", m)]
        context.claim(
            "N3",
            f"Ward's model (eq. 8) diverges at grazing incidence, m = {m:g}.",
            value=one.exponent,
            error=one.error,
            criterion=f"> {DIVERGES}",
            quantity="exponent p of a ~ (n.l)^-p",
            figure="by_cosine_figure",
            table="variants",
        )
    one = several[ward_spec("ward", 0.1)]
    value, error = highest(one)
    last = f"largest albedo down to cos θ = {one.cos_theta[-1]:.0e}, m = 0.1"
    for id, statement, criterion in (
        ("A13", "Ward's model does not conserve energy at grazing incidence.", "> 1"),
        ("S5", "Ward's model conserves energy.", "<= 1"),
    ):
        context.claim(
            *(id, statement, value, error, criterion),
            quantity=last,
            figure="by_cosine_figure",
            table="variants",
        )
    context.claim(
        "S5",
        "Ward's model is reciprocal.",
        asymmetry(one.model),
        16.0 * float(np.finfo(float).eps),
        # Half vectors from raw directions lose digits at grazing angles.
        "= 0 +- 1e-6",
        quantity="largest |f(l, v) - f(v, l)| of 20,000 pairs, over the larger of both",
        table="variants",
    )
    crossing = one.above_one
    assert crossing is not None
    context.explain(
        "S5",
        "f is symmetric in L and V, so the model is reciprocal. But with eq. 8, "
        "a(L) = (N.L)^(-1/2) times the integral of E (N.V)^(1/2)/(4π m²) over all V, and as L goes "
        "to the horizon the integral tends to a positive number: where H is near N, V is near the "
        "horizon too, and its root takes from the integral, but not all of it. The measured "
        f"exponent is {format_value(one.exponent, one.error)} for m = 0.1. The prefactor goes as "
        "m^(3/2), so narrow lobes make light only very near to grazing incidence: for m = 0.1 from "
        f"cos θ = {format_value(*crossing)} on, {math.degrees(math.asin(crossing[0])):.2g}° above "
        "the horizon. At smaller angles of incidence light is lost, and there the model conserves "
        "energy, as the survey says; a table or a plot in degrees shows no more.",
    )
    ratios = [prefactor_ratio(several[ward_spec(form, m)]) for form in WARD for m in WIDTHS]
    off = max(abs(ratio - 1.0) + error for ratio, error in ratios)
    crossings = {
        m: there for m in WIDTHS if (there := several[ward_spec("ward", m)].above_one) is not None
    }
    said = [
        f"{m:g}: {format_value(*there)} ({math.degrees(math.asin(there[0])):.3g}°)"
        for m, there in crossings.items()
    ]
    others = ", ".join(
        f"{format_value(other.exponent, other.error)} ({WARD[form][1]})"
        for form in ("ward_duer", "ward_bounded")
        for other in (several[ward_spec(form, 0.1)],)
    )
    end = math.sin(math.radians(90.0 - TABLE_END))
    unseen = [f"{m:g}" for m, there in crossings.items() if there[0] < end]
    context.note(
        "With L on the horizon the integrand of Ward's albedo times a power of n.l has a limit. It "
        "gives the exponents 1/2 (eq. 8 and the fast form), 1 (Ward-Dür) and 0 (the bounded form, "
        "whose albedo goes to one), and prefactors that grow as m^(3/2) and m: narrow lobes "
        f"diverge late. Measured exponents for m = 0.1: {others}. Measured prefactors are those of "
        f"theory to {off:.1g} for all widths and "
        "forms here. Ward's albedo (eq. 8) first exceeds one at these cosines (degrees above the "
        "horizon), m = "
        + "; ".join(said)
        + f". A table that ends at {TABLE_END:g}° does not show it for m = "
        + ", ".join(unseen)
        + "."
    )


def judge_cook_torrance(
    context: Context, several: dict[str, Asymptote], regions: pd.DataFrame
) -> None:
    """N4: with which G, if with any, the albedo diverges, and why not with that of eq. 10."""
    for geometry, label in MASKING.items():
        for m in WIDTHS:
            one = several[cook_torrance_spec(geometry, m)]
            context.claim(
                "N4",
                f"Cook-Torrance diverges at grazing incidence, m = {m:g}.",
                value=one.exponent,
                error=one.error,
                criterion=f"> {DIVERGES}",
                quantity="exponent p of a ~ (n.l)^-p",
                reading=label,
                figure="by_cosine_figure",
                table="variants",
            )
    for geometry in ("v_cavity", "smith"):
        context.claim(
            "N4",
            "Cook-Torrance reflects no more than it receives.",
            *max(highest(several[cook_torrance_spec(geometry, m)]) for m in WIDTHS),
            at_most(1.0),
            quantity="largest albedo of all widths and directions; the weak white furnace allows 1",
            reading=MASKING[geometry],
            figure="by_cosine_figure",
            table="variants",
        )
    last = regions[regions["cos_theta"] <= 1e-6]
    columns = (last[k].to_numpy() for k in ("cos_theta", "solid_angle", "solid_angle_error"))
    p, spread = power(*columns)
    context.claim(
        "N4",
        "The directions with G = 1 keep their solid angle as L becomes grazing.",
        p,
        spread,
        f"< {DIVERGES}",
        quantity="exponent p of the solid angle ~ (n.l)^p",
        reading=MASKING["v_cavity"],
        figure="by_cosine_figure",
        table="solid_angles",
    )
    end = regions.iloc[-1]
    bright = several[cook_torrance_spec("v_cavity", 0.1, ",prefactor=1/pi")]
    one, none = (several[cook_torrance_spec(g, 0.1)] for g in ("v_cavity", "none"))
    variants = {label: several[cook_torrance_spec(g, 0.1)] for g, label in MASKING.items()}
    variants["the prefactor of 1982"] = bright
    diverging = [label for label, v in variants.items() if v.exponent - v.error > DIVERGES]
    context.note(
        "The paper's proof puts G = 1 on a fixed cap of half vectors while L goes to the horizon. "
        "With eq. 10 the directions with G = 1 have a solid angle that falls as (n.l)^p, p = "
        f"{format_value(p, spread)}: they fill "
        f"{format_value(end['over_cos2'], end['over_cos2_error'])} (n.l)^2 steradians at cos θ = "
        f"{end['cos_theta']:.0e}; the limit is {LIMIT:.10g}. Everywhere else light that comes from "
        "the horizon is masked in proportion to n.l, which takes back the 1/(n.l) of eq. 9. Since "
        "G is at most the masking of L alone, the weak white furnace bounds the albedo by 1 at "
        "every angle, with this G and with Smith's."
    )
    exponents = [
        (label, format_value(several[spec].exponent, several[spec].error))
        for spec, label in ((cook_torrance_spec(g, 0.1), label) for g, label in MASKING.items())
    ]
    context.explain(
        "N4",
        "a(L) is the integral of D G (L.H) over all H, over N.L. With G = 1 that tends to "
        "m/(2 √π) over N.L, and the albedo diverges. G of eq. 10, though, is at most "
        "2 NH NL/VH, so at grazing incidence N.L cancels; more exactly, as G is at most the "
        "masking of L alone, for which the integral is N.L at every angle (the weak white "
        "furnace), the albedo is at most 1, and so it is with Smith's G. Measured exponents p of "
        "a ~ (N.L)^-p for m = 0.1: "
        + ", ".join(f"{found} ({label})" for label, found in exponents)
        + ". The statement holds for the model without masking, and not for the one that is "
        "printed.",
    )
    context.note(
        f"Of the variants with m = 0.1 there diverge: {', '.join(diverging) or 'none'}. With G = 1 "
        f"the exponent is {format_value(none.exponent, none.error)} and the prefactor m/(2 √π) to "
        f"{abs(prefactor_ratio(none)[0] - 1.0) + prefactor_ratio(none)[1]:.1g}; the albedo is "
        f"above one {passes_one(none)}. The text of 1982, 1/π with a D that is not normalised, is "
        f"above one {passes_one(bright)} ({format_value(*highest(bright))} at most), with the "
        f"exponent {format_value(bright.exponent, bright.error)}. With the G of eq. 10 the albedo "
        f"is {format_value(*at_end(one))} at cos θ = {one.cos_theta[-1]:.0e}."
    )


def passes_one(one: Asymptote) -> str:
    """From where on an albedo is above one."""
    if one.above_one is None:
        return "nowhere"
    cosine, width = one.above_one
    return f"from cos θ = {format_value(cosine, width)} on" if width else "from the normal on"


def at_end(one: Asymptote) -> tuple[float, float]:
    """The albedo at the smallest cosine."""
    return float(one.albedo.value[-1]), float(one.albedo.error[-1])


def say_models(context: Context, every: dict[str, Asymptote]) -> None:
    """Which models diverge, which exceed one, and which follow no power."""
    diverging = [
        f"{name} ({format_value(one.exponent, one.error)})"
        for name, one in every.items()
        if one.exponent - one.error > DIVERGES
    ]
    unsettled = [name for name, one in every.items() if one.error > DIVERGES]
    bounded = [
        name
        for name, one in every.items()
        if one.above_one is not None and one.exponent - one.error <= DIVERGES
    ]
    context.note(
        f"Of {len(every)} models, with their parameters by default, these diverge at grazing "
        f"incidence (exponents in brackets): {', '.join(diverging)}. These stay bounded there but "
        f"exceed one somewhere: {', '.join(bounded)}."
    )
    for name in unsettled:
        one = every[name]
        context.note(
            f"The albedo of {name} has settled to no power before cos θ = "
            f"{one.cos_theta[-1]:.0e}: its exponent over the last {one.decades} decades is "
            f"{format_value(one.exponent, one.error)}, and changes from decade to decade as that "
            "of a logarithm does."
        )


def draw(context: Context, several: dict[str, Asymptote], every: dict[str, Asymptote]) -> None:
    """Both families against the angle and on logarithmic axes, and the exponents of all models."""
    shown = [
        *((ward_spec(form, 0.1), label) for form, (_, label) in WARD.items() if form[5:] != "fast"),
        *(
            (cook_torrance_spec(g, 0.1), f"Cook-Torrance, {label}")
            for g, label in MASKING.items()
            if g != "smith"
        ),
    ]
    curves = {
        spec: albedo.directional_albedo(several[spec].model, plotting.angle_grid(), rtol=1e-8)
        for spec, _ in shown
    }
    for name, log in (("by_angle_figure", False), ("by_cosine_figure", True)):
        drawn = []
        for spec, label in shown:
            one = several[spec]
            found = one.albedo if log else curves[spec]
            cos_theta = one.cos_theta if log else plotting.angle_grid()
            drawn.append(
                plotting.Curve(
                    label=label,
                    name=one.model.name,
                    cos_theta=cos_theta,
                    value=found.value,
                    error=found.error,
                )
            )
        axis = "cosine of the angle of incidence" if log else "angle of incidence"
        context.figure(
            name,
            plotting.draw(drawn, grazing=True) if log else draw_angles(drawn),
            f"Ward's and Cook-Torrance's albedos, m = 0.1, against the {axis}; the grey line is an "
            "albedo of one.",
        )
    context.figure(
        "exponents_figure",
        draw_exponents(every),
        "Exponents of all models, with their parameters by default, and their errors; beyond the "
        "grey line an albedo diverges.",
    )


def draw_angles(drawn: list[plotting.Curve]) -> Figure:
    """Linear axes, as in the paper, up to an albedo of two."""
    with plotting.style():
        figure, (axes,) = plotting.new_figure()
        plotting.draw_axes(axes, drawn)
        axes.set_yscale("linear")
        axes.set_ylim(0.0, 2.0)
        plotting.add_legend(figure, axes)
    return figure


def draw_exponents(every: dict[str, Asymptote]) -> Figure:
    """One dot for every model."""
    names = sorted(every, key=lambda name: (every[name].exponent, name))
    with plotting.style():
        figure, (axes,) = plotting.new_figure(height=0.19 * len(names) + 0.9)
        for row, name in enumerate(names):
            one = every[name]
            axes.errorbar(
                one.exponent, row, xerr=one.error, fmt="o", ms=5, color=plotting.color(name)
            )
        axes.axvline(0.0, color="#888888", linewidth=0.9, zorder=0.5)
        axes.set_yticks(range(len(names)), names)
        axes.set_xlabel("exponent p of a ~ (cos θ)^-p towards grazing incidence")
        axes.set_ylim(-0.7, len(names) - 0.3)
    return figure
