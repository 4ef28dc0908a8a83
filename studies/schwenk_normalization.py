"""Which of the survey's normalisations keep a lobe at an albedo of one, and which are reciprocal?

Four statements: the modified Phong lobe conserves energy up to k_s = (e + 2)/2; for Blinn's lobe
the constant would be (e + 8)/8; Lewis' normalisation conserves energy and breaks reciprocity;
Ward's 1/(4 pi alpha^2) is valid for alpha up to 0.2. The survey leaves 1/pi out of its constants,
so that k_s = (e + 2)/2 is f = (e + 2)/(2 pi) (r.v)^e.

Phong's albedo is the integral over V of (r.v)^e, which falls with the angle to R, times n.v, which
falls with the angle to N: it is largest where R = N, whatever e >= 0 is, and there it is
2 pi int t^(e + 1) dt = 2 pi/(e + 2). For Blinn's lobe the constant that makes the albedo one at
normal incidence is (e + 2)(e + 4)/(8 (2^(-e/2) + e)), and (e + 8)/8 is larger for every e > 0.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

import albedo
from albedo import plotting
from albedo.analysis.checks import asymmetry
from albedo.analysis.energy import energy_map
from albedo.analysis.pumping import at_most, least, most
from albedo.catalogue.blinn import normalization
from albedo.directions import spherical
from albedo.estimate import format_value
from albedo.grammar import ModelSpec
from albedo.studies import Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from albedo.studies import Context

STUDY = Study(
    name="schwenk_normalization",
    title="Normalisations of Phong, Blinn, Lewis and Ward",
    paper="S",
    claims=("S1", "S2", "S4", "S6"),
)

# What a constant may be off by and still be called right, and roughly right.
EXACTLY, ROUGHLY = 0.01, 0.1
# A residual of reciprocity above this is no rounding.
ROUNDING = 1e-6
WARD_LIMIT = 0.2
LEVELS = (0.01, 0.05, 0.1)
SEED = 0
# What a curve in a figure is worth.
DRAWN = 1e-6
LOBES = {"half_vector": "n.h", "mirror": "r.v"}
FORMS = {"exact": "tan² in the exponent", "fast": "Ward's fast exponent"}

_DASHES: tuple[Any, ...] = (
    "-",
    (0, (6, 2)),
    (0, (1.2, 1.4)),
    (0, (6, 1.6, 1.2, 1.6)),
    (0, (3, 1.6)),
)
_EPS = float(np.finfo(float).eps)


def run(context: Context) -> None:
    """Phong, Blinn, Lewis and Ward, one after the other."""
    rtol = 1e-11 if context.full else 1e-9
    context.setting(rtol=rtol, seed=SEED)
    for done, part in enumerate((phong, blinn, lewis, ward)):
        context.progress(done, 4, part.__name__)
        part(context, rtol)


def phong(context: Context, rtol: float) -> None:
    """S1: the largest albedo at the limit."""
    exponents = np.append(0.0, np.geomspace(1e-3, 1e6, 73 if context.full else 4))
    frame = largest("phong", {}, exponents, rtol)
    context.table("phong", frame, "Largest albedo of the modified Phong lobe at k_s = (e + 2)/2")
    _, value, error = most(*columns(frame, "largest"))
    context.claim(
        "S1",
        "The modified Phong lobe conserves energy when k_s is at most (e + 2)/2.",
        value=value,
        error=error,
        criterion=at_most(1.0),
        quantity=f"largest albedo for k_s = (e + 2)/2, {exponents.size} exponents from 0 to 1e6",
        figure="phong_figure",
        table="phong",
    )
    context.explain(
        "S1",
        "At the limit the albedo is 1 at normal incidence and smaller everywhere else, for every "
        "exponent: the integral of two functions that fall with the angle to R and to N is largest "
        "where R = N. No bound can tell a computed 1 from 1; the integral there, 2π/(e + 2), is "
        "exact.",
    )
    context.note(
        "Phong: at k_s = (e + 2)/2 the largest albedo is within "
        f"{max(abs(frame['largest'] - 1.0)):.1e} of 1, at normal incidence for every e, so that "
        "no larger k_s conserves energy."
    )
    context.figure(
        "phong_figure",
        draw_phong(),
        "Albedo of the modified Phong lobe with k_s = (e + 2)/2, against the angle and, towards "
        "grazing incidence, against the cosine.",
    )


def largest(name: str, fixed: dict[str, Any], exponents: np.ndarray, rtol: float) -> pd.DataFrame:
    """Largest albedo over all angles for every exponent, with its place."""
    found = energy_map(ModelSpec(name, fixed, {"n": exponents}), rtol).frame
    return pd.DataFrame(
        {
            "e": found["n"],
            "largest": found["max_albedo"],
            "largest_error": found["max_albedo_error"],
            "cos_theta": found["max_cos_theta"],
        }
    )


def columns(frame: pd.DataFrame, name: str) -> tuple[np.ndarray, np.ndarray]:
    """A column and its errors."""
    return frame[name].to_numpy(), frame[f"{name}_error"].to_numpy()


def excess(e: float) -> float:
    """(e + 8)/8 over the exact constant, less 1, without a difference of equals next to e = 0.

    (8 (q - 1) + e (2 + q))/((e + 2)(e + 4)) with q = 2^(-e/2). Next to 0 its terms are 13 times as
    large as their sum, 64 roundings are a bound.
    """
    less = math.expm1(-0.5 * e * math.log(2.0))
    return (8.0 * less + e * (3.0 + less)) / ((e + 2.0) * (e + 4.0))


def blinn(context: Context, rtol: float) -> None:
    """S2: (e + 8)/8 beside the exact constant, and what it does to energy."""
    top = worst_exponent()
    exponents = np.unique(
        np.concatenate(
            ((0.0, 1.0, top), np.geomspace(1e-3, 1e6, 73 if context.full else 4), (10.0, 100.0))
        )
    )
    energy = largest("blinn", {"normalization": "n_plus_8"}, exponents, rtol)
    off = np.array([excess(e) for e in exponents])
    frame = pd.DataFrame(
        {
            "e": exponents,
            "common": 0.125 * (exponents + 8.0),
            "exact": [math.pi * normalization(e) for e in exponents],
            "excess": off,
            "excess_error": 64.0 * _EPS * off,
            "largest": energy["largest"],
            "largest_error": energy["largest_error"],
            "cos_theta": energy["cos_theta"],
        }
    )
    context.table(
        "blinn",
        frame,
        "(e + 8)/8 over the exact constant, less 1, and the largest albedo with (e + 8)/8",
        # For e = 0 the albedo is the same everywhere: rounding decides where it is largest.
        loose={"cos_theta": 1.0},
    )
    k, value, error = most(*columns(frame, "largest"))
    words = "The factor that keeps the Blinn-Phong lobe's energy is (e + 8)/8."
    context.claim(
        "S2",
        words,
        value=value,
        error=error,
        criterion=at_most(1.0),
        quantity=f"largest albedo, at e = {exponents[k]:.4g}",
        reading="as a bound that conserves energy",
        figure="blinn_figure",
        table="blinn",
    )
    context.claim(
        "S2",
        words,
        value=excess(top),
        error=64.0 * _EPS * excess(top),
        criterion=f"<= {EXACTLY}",
        quantity=f"largest relative excess over the exact constant, at e = {top:.4f}",
        reading="as an approximation of the constant, to one percent at every exponent",
        figure="blinn_figure",
        table="blinn",
    )
    last = frame.iloc[-1]
    context.claim(
        "S2",
        words,
        value=last["excess"],
        error=last["excess_error"],
        criterion=f"<= {EXACTLY}",
        quantity=f"relative excess over the exact constant at e = {last['e']:.0e}",
        reading="as an approximation for large exponents",
        figure="blinn_figure",
        table="blinn",
    )
    low, high = crossings(EXACTLY, top)
    context.explain(
        "S2",
        "The constant that makes the albedo one at normal incidence, where it is largest, is "
        "(e + 2)(e + 4)/(8 (2^(-e/2) + e)). It is 1 at e = 0, as (e + 8)/8 is, and (e + 6)/8 + "
        "O(1/e) for large e; (e + 8)/8 exceeds it by 2/e there and by at most "
        f"{excess(top):.6f} of it, at e = {top:.4f}, so that as much more light is reflected than "
        f"arrives. It is within one percent up to e = {low:.4f} and from e = {high:.2f} on. As a "
        "factor for highlights of large exponents it is good; as a bound it is not one for any "
        "e > 0.",
    )
    listed = frame[frame["e"].isin((1.0, 10.0, 100.0))]
    agree = np.max(np.abs(frame["largest"] - 1.0 - frame["excess"]))
    context.note(
        "Blinn with (e + 8)/8: the largest albedo is "
        + ", ".join(
            f"{format_value(a, b)} for e = {e:g}"
            for e, a, b in zip(listed["e"], listed["largest"], listed["largest_error"], strict=True)
        )
        + f", and at most {format_value(value, error)}, all at normal incidence. Quadrature and "
        f"the quotient of the two constants agree within {agree:.0e}."
    )
    context.figure(
        "blinn_figure",
        draw_blinn(frame, top),
        "Left: relative excess of (e + 8)/8 over the exact constant; the dotted line is 2/e, the "
        f"grey one 1%. Right: albedos with both constants, e = {top:.2f}.",
    )


def worst_exponent() -> float:
    """The e at which (e + 8)/8 exceeds the exact constant most."""
    from scipy.optimize import minimize_scalar

    found = minimize_scalar(
        lambda e: -excess(e), bounds=(1.0, 100.0), method="bounded", options={"xatol": 1e-9}
    )
    return round(float(found.x), 4)


def crossings(level: float, top: float) -> tuple[float, float]:
    """The exponents below and above the worst one at which the excess is a level."""
    from scipy.optimize import brentq

    def off(e: float) -> float:
        return excess(e) - level

    return float(brentq(off, 1e-6, top, xtol=1e-12)), float(brentq(off, top, 1e6, xtol=1e-9))


def lewis(context: Context, rtol: float) -> None:
    """S4: energy and reciprocity under both readings."""
    exponents = (1.0, 10.0, 100.0, 1e4, 1e6) if context.full else (1.0, 10.0, 100.0)
    cosines = np.append(plotting.angle_grid()[::5], np.append(np.geomspace(1e-3, 1e-9, 7), 0.0))
    readings = {"per_incidence": "at every incidence", "constant": "by a constant"}
    # Where it shall be quick the lobe that is not drawn has one exponent.
    pairs = [
        (lobe, n)
        for lobe in LOBES
        for n in exponents
        if context.full or lobe == "half_vector" or n == 10.0
    ]
    rows = []
    for reading in readings:
        for lobe, n in pairs:
            model = albedo.model("lewis", n=n, reading=reading, lobe=lobe)
            found = albedo.directional_albedo(model, cosines, rtol=rtol)
            _, top, top_error = most(found.value, found.error)
            _, low, low_error = least(found.value, found.error)
            residual = asymmetry(model, SEED, 200_000 if context.full else 20_000)
            # The integrals that are divided by err by this much, and so does the quotient of two.
            (part,) = model.parts()
            doubt = float(part.doubt(None)) if callable(part.doubt) else part.doubt
            rows.append(
                {
                    "reading": reading,
                    "lobe": LOBES[lobe],
                    "e": n,
                    "largest": top,
                    "largest_error": top_error,
                    "smallest": low,
                    "smallest_error": low_error,
                    "residual": residual,
                    "residual_error": 2.0 * doubt + 1e-9,
                }
            )
    frame = pd.DataFrame(rows)
    # The residual is 1 - I(theta_v)/I(theta_l), and I falls from normal to grazing incidence.
    constant = frame["reading"] == "constant"
    low, error = columns(frame[constant], "smallest")
    frame["limit"] = np.tile(1.0 - low, 2) * ~constant
    frame["limit_error"] = np.tile(error, 2) * ~constant
    context.table(
        "lewis",
        frame,
        "Albedos, and |f(L, V) - f(V, L)| over the larger of them: the largest residual that was "
        "drawn, and its limit where one direction is N and the other one grazing",
    )
    for reading, words in readings.items():
        own = frame[frame["reading"] == reading]
        _, value, error = most(*columns(own, "largest"))
        context.claim(
            "S4",
            "Lewis' normalisation conserves energy.",
            value=value,
            error=error,
            criterion=at_most(1.0),
            quantity="largest albedo, both lobes, all exponents and angles",
            reading=f"normalised {words}",
            figure="lewis_figure",
            table="lewis",
        )
        # Broken for every lobe, or not for any: the one that is nearest to the other verdict.
        if reading == "constant":
            what = "the largest of all random pairs"
            k, value, error = most(*columns(own, "residual"))
        else:
            what = "in the limit of grazing incidence, for the lobe that has the least"
            k, value, error = least(*columns(own, "limit"))
        row = own.iloc[k]
        context.claim(
            "S4",
            "Lewis' normalisation breaks reciprocity.",
            value=value,
            error=error,
            criterion=f"> {ROUNDING:g}",
            quantity=f"|f(L, V) - f(V, L)| over the larger one, {what}: {row['lobe']}, e = "
            f"{row['e']:g}",
            reading=f"normalised {words}",
            figure="lewis_figure",
            table="lewis",
        )
    half = frame[~constant & (frame["lobe"] == "n.h")].set_index("e")
    context.explain(
        "S4",
        "A lobe X^e that is divided by its own integral I(θ_l) reflects everything at every angle, "
        "and f(L, V)/f(V, L) = I(θ_v)/I(θ_l). With L = N and V towards the horizon that is far "
        "from 1: for X = n.h and e = 100 the two differ by up to "
        f"{half.loc[100.0, 'limit']:.4f} of the larger. Divided by I(0), a constant, the lobe is "
        "reciprocal to the last digits, and it conserves energy too, because I(θ) is largest at "
        "normal incidence; what it does not do is to reflect everything.",
    )
    context.note(
        "Lewis: normalised at every incidence albedos are 1 within "
        f"{float(np.max(np.abs(frame.loc[~constant, ['largest', 'smallest']] - 1.0))):.0e}. The "
        "largest residuals that were drawn are "
        + ", ".join(
            f"{row['residual']:.4f} ({row['lobe']}, e = {row['e']:g}; at most {row['limit']:.4f})"
            for _, row in frame[~constant].iterrows()
        )
        + f"; normalised by a constant at most {frame.loc[constant, 'residual'].max():.0e}."
    )
    context.figure(
        "lewis_figure",
        draw_lewis(),
        "Left: albedos of the lobe (n.h)^e, normalised by a constant and at every incidence. "
        "Right: f(N, V)/f(V, N) of the latter, 1 where the lobe is reciprocal.",
    )


def deficit(alpha: float, form: str, rtol: float) -> tuple[float, float]:
    """1 - a at normal incidence, and its bound."""
    # What is known of it is known of the albedo: no relative tolerance of a small number is met.
    model = albedo.model("ward", m=alpha, form=form)
    found = albedo.directional_albedo(model, 1.0, rtol=rtol, atol=rtol, complement=True)
    return float(found.value), float(found.error)


def ward(context: Context, rtol: float) -> None:
    """S6: what 1/(4 pi alpha^2) lacks at normal incidence."""
    alphas = np.unique(np.append(np.geomspace(0.01, 1.0, 61 if context.full else 13), WARD_LIMIT))
    rows = []
    for alpha in alphas:
        row: dict[str, Any] = {"alpha": alpha}
        for form in FORMS:
            row[form], row[f"{form}_error"] = deficit(float(alpha), form, rtol)
        rows.append(row)
    frame = pd.DataFrame(rows)
    context.table("ward", frame, "1 - a at normal incidence, with both exponents of Ward's lobe")
    within = frame[frame["alpha"] <= WARD_LIMIT]
    for form, name in FORMS.items():
        k, value, error = most(*columns(within, form))
        for limit, word in ((EXACTLY, "to one percent"), (ROUGHLY, "to ten percent")):
            context.claim(
                "S6",
                "Ward's normalisation 1/(4πα²) is valid for α ≤ 0.2.",
                value=value,
                error=error,
                criterion=f"<= {limit}",
                quantity=f"largest 1 - a at normal incidence, at α = {within.iloc[k]['alpha']:g}",
                reading=f"{name}, {word}",
                figure="ward_figure",
                table="ward",
            )
    levels = pd.DataFrame(
        [
            {"form": FORMS[form], "deficit": level, **ward_width(level, form, rtol)}
            for form in FORMS
            for level in LEVELS
        ]
    )
    context.table("ward_levels", levels, "The α at which 1 - a reaches a level")
    at = within.iloc[-1]
    table = levels.set_index(["form", "deficit"])
    exact, fast = FORMS.values()
    context.explain(
        "S6",
        "With t = tan² δ the albedo at normal incidence is α^(-2) ∫ ((1 - t)/(1 + t))^(1/2) "
        "(1 + t)^(-2) exp(-t/α²) dt over t < 1, which is 1 - 3α² + ...: the constant leaves out "
        "how solid angles and cosines change across the lobe. At α = 0.2 it lacks "
        f"{format_value(at['exact'], at['exact_error'])}, and "
        f"{format_value(at['fast'], at['fast_error'])} with the exponent that Ward proposes for "
        "speed, which is 1 - 3/2 α² + .... So the limit of 0.2 is that of about ten percent; one "
        f"percent is lost at α = {table.loc[(exact, 0.01), 'alpha']:.4f} and "
        f"{table.loc[(fast, 0.01), 'alpha']:.4f}. What is lacking is light lost, never gained, at "
        "normal incidence.",
    )
    context.note(
        "Ward: 1 - a at normal incidence reaches "
        + "; ".join(
            f"{level:.0%} at α = "
            + " and ".join(
                format_value(*table.loc[(name, level), ["alpha", "alpha_error"]])
                for name in FORMS.values()
            )
            for level in LEVELS
        )
        + f" ({exact} and {fast})."
    )
    context.figure(
        "ward_figure",
        draw_ward(frame),
        "What Ward's lobe lacks of an albedo of one at normal incidence; thin lines are 3α² and "
        "3/2 α², the grey ones 1% and 10%, and α = 0.2.",
    )


def ward_width(level: float, form: str, rtol: float) -> dict[str, float]:
    """The alpha of a deficit, and by how much it errs: that of the deficit over its slope."""
    from scipy.optimize import brentq

    found = float(brentq(lambda x: deficit(x, form, rtol)[0] - level, 1e-3, 1.0, xtol=1e-10))
    (high, one), (low, other) = (deficit(found * f, form, rtol) for f in (1.01, 0.99))
    slope = (high - low - one - other) / (0.02 * found)
    # The slope is that of a chord about as long as the deficit is straight: half of it is safe.
    return {"alpha": found, "alpha_error": 2.0 * max(one, other) / slope + 2e-10}


def draw_phong() -> Figure:
    """Albedos at the limit, in degrees and in the cosine."""
    drawn = (0.0, 1.0, 10.0, 100.0, 1e4)
    shades = ("#56B4E9", "#009E73", "#0072B2", "#AA4499", "#222222")
    with plotting.style():
        figure, panels = plotting.new_figure(2, 7.6, 3.4)
        for axes, cosines in zip(
            panels, (plotting.angle_grid(), plotting.grazing_grid(1e-4)), strict=True
        ):
            x = np.degrees(np.arccos(cosines)) if axes is panels[0] else cosines
            for e, shade, dash in zip(drawn, shades, reversed(_DASHES), strict=True):
                found = albedo.directional_albedo(albedo.model("phong", n=e), cosines, rtol=DRAWN)
                axes.plot(x, found.value, color=shade, linestyle=dash, label=f"e = {e:g}")
            axes.axhline(1.0, color="#888888", linewidth=0.9, zorder=1.5)
        angle_axis(panels[0])
        panels[0].set_ylim(0.0, 1.05)
        panels[0].set_ylabel("directional albedo")
        panels[1].set_xscale("log")
        panels[1].set_yscale("log")
        panels[1].set_xlim(1.0, 1e-4)
        panels[1].set_ylim(2e-3, 2.0)
        panels[1].set_xlabel("cosine of the angle (grazing to the right)")
        plotting.add_legend(figure, panels[0])
    return figure


def angle_axis(axes: Any) -> None:
    """Degrees of incidence."""
    axes.set_xlim(0.0, 90.0)
    axes.set_xticks(np.arange(0.0, 91.0, 15.0))
    axes.set_xlabel("angle of incidence (degrees)")


def draw_blinn(frame: pd.DataFrame, top: float) -> Figure:
    """The excess against e, and albedos at the worst e."""
    shade = plotting.color("blinn")
    e = np.geomspace(1e-2, 1e6, 400)
    with plotting.style():
        figure, panels = plotting.new_figure(2, 7.6, 3.4)
        axes = panels[0]
        axes.plot(e, [excess(x) for x in e], color=shade, label="closed form")
        seen = frame[
            (frame["e"] >= 1e-2) & (frame["largest"] - 1.0 > 10.0 * frame["largest_error"])
        ]
        axes.plot(
            *(seen["e"], seen["largest"] - 1.0),
            "o",
            color="#222222",
            markersize=3.5,
            markerfacecolor="white",
            markevery=3 if len(seen) > 20 else 1,
            label="largest albedo - 1, by quadrature",
        )
        far = e[e >= 8.0]
        axes.plot(far, 2.0 / far, color="#222222", linewidth=1.0, linestyle=_DASHES[2], label="2/e")
        axes.axhline(EXACTLY, color="#888888", linewidth=0.9, zorder=1.5)
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlim(1e-2, 1e6)
        axes.set_xlabel("exponent e")
        axes.set_ylabel("relative excess of (e + 8)/8")
        axes = panels[1]
        cosines = plotting.angle_grid()
        looks = {"n_plus_8": ("(e + 8)/8", _DASHES[1]), "exact": ("exact constant", "-")}
        for name, (label, dash) in looks.items():
            model = albedo.model("blinn", n=top, normalization=name)
            found = albedo.directional_albedo(model, cosines, rtol=DRAWN)
            theta = np.degrees(np.arccos(cosines))
            axes.plot(theta, found.value, color=shade, linestyle=dash, label=f"albedo, {label}")
        axes.axhline(1.0, color="#888888", linewidth=0.9, zorder=1.5)
        angle_axis(axes)
        axes.set_ylim(0.0, 1.12)
        axes.set_ylabel("directional albedo")
        plotting.add_legend(figure, panels[0], panels[1].get_legend_handles_labels()[0], columns=3)
    return figure


def draw_lewis() -> Figure:
    """Albedos under both readings, and the quotient that a reciprocal lobe has at 1."""
    drawn = (1.0, 10.0, 100.0)
    shades = ("#56B4E9", "#0072B2", "#332288")
    cosines = plotting.angle_grid()
    theta = np.degrees(np.arccos(cosines))
    normal, views = spherical(1.0), spherical(cosines)
    with plotting.style():
        figure, panels = plotting.new_figure(2, 7.6, 3.4)
        for e, shade, dash in zip(drawn, shades, _DASHES, strict=False):
            models = [
                albedo.model("lewis", n=e, reading=reading)
                for reading in ("constant", "per_incidence")
            ]
            found = albedo.directional_albedo(models[0], cosines, rtol=DRAWN)
            panels[0].plot(
                *(theta, found.value),
                color=shade,
                linestyle=dash,
                label=f"by a constant, e = {e:g}",
            )
            there, back = models[1].eval(normal, views), models[1].eval(views, normal)
            panels[1].plot(theta, there / back, color=shade, linestyle=dash)
        found = albedo.directional_albedo(models[1], cosines, rtol=DRAWN)
        panels[0].plot(
            *(theta, found.value), color="#D55E00", linewidth=2.4, label="at every incidence, any e"
        )
        for axes in panels:
            angle_axis(axes)
            axes.set_ylim(0.0, 1.05)
        panels[1].set_xlabel("angle between V and N (degrees)")
        panels[1].axhline(1.0, color="#888888", linewidth=0.9, zorder=1.5)
        panels[0].set_ylabel("directional albedo")
        panels[1].set_ylabel("f(N, V)/f(V, N), at every incidence")
        plotting.add_legend(figure, panels[0], columns=2)
    return figure


def draw_ward(frame: pd.DataFrame) -> Figure:
    """Deficits against alpha, both axes logarithmic."""
    looks = {"exact": (plotting.color("ward"), "-", 3.0), "fast": ("#0072B2", _DASHES[1], 1.5)}
    with plotting.style():
        figure, (axes,) = plotting.new_figure(height=3.8)
        for form, (shade, dash, factor) in looks.items():
            axes.plot(frame["alpha"], frame[form], color=shade, linestyle=dash, label=FORMS[form])
            start = frame["alpha"][frame["alpha"] <= 0.5]
            axes.plot(start, factor * start**2, color=shade, linewidth=0.8)
        for level in (EXACTLY, ROUGHLY):
            axes.axhline(level, color="#888888", linewidth=0.9, zorder=1.5)
        axes.axvline(WARD_LIMIT, color="#888888", linewidth=0.9, zorder=1.5)
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlim(0.01, 1.0)
        axes.set_ylim(1e-4, 1.0)
        axes.set_xlabel("width α")
        axes.set_ylabel("1 - albedo at normal incidence")
        plotting.add_legend(figure, axes)
    return figure
