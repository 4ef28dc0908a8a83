"""Is Phong's lobe over the larger cosine what controlled pumping-up leads to, and is it safe?

The paper's new model, NNS eq. 22, is f = c (R.V)^n / max(N.L, N.V). It says that controlled
pumping-up of Phong's lobe converges to it, and that it conserves energy when c is at most
(n + 2)/(2π), the constant of the lobe itself.

What the model reflects beyond 1 is computed a second time, without cancellation. With T = tan θ,
V at the angle α from R and at the azimuth ψ about it, N.V/N.L = r = cos α + T sin α cos ψ, so that

    a - 1 = c ∫∫ (R.V)^n [max(-r, 0) - max(r - 1, 0)] dV:

the first part is light that the horizon would have taken away, and is T^(n+2) for small T; the
second is what the larger cosine takes, (n + 2)/8 T^4. For n < 2 the first one wins near normal
incidence, for n = 2 it is an eighth of the second.
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
from albedo.analysis.pumped_figures import LIGHTS, READINGS
from albedo.analysis.radiance import plane_radiance
from albedo.estimate import format_value
from albedo.integrators.rules import gauss
from albedo.studies import Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from albedo.studies import Context

STUDY = Study(
    name="nns_fig7",
    title="Phong over the larger cosine",
    paper="NNS",
    figure="Figure 7",
    claims=("N11", "N12", "N13"),
)

EXPONENTS = (1, 5, 20, 100, 1000, 10_000)
# Exponents up to 2, where light is made, and beyond; the expansion needs T^4 in float64.
BELOW, BEYOND = (0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 1.9, 1.98), (2.0, 1e6)
EXCESSES = (1e-2, 1e-4, 1e-8)
# Two curves that are closer than this look the same.
SAME = 0.01
LOWEST = 0.01


def run(context: Context) -> None:
    """Curves, the limit of controlled pumping-up, and what is reflected beyond 1."""
    curves(context)
    limit(context)
    energy(context)


def curves(context: Context) -> None:
    """The albedo for several exponents, and the output radiance for one (N13)."""
    rtol = 1e-11 if context.full else 1e-9
    context.setting(rtol=rtol)
    angles = plotting.angle_grid()
    grazing = plotting.grazing_grid(1e-6, 24 if context.full else 8)
    columns: dict[str, dict[str, Any]] = {
        "by_angle": {"theta_deg": np.degrees(np.arccos(angles)), "cos_theta": angles},
        "by_cosine": {"theta_deg": np.degrees(np.arccos(grazing)), "cos_theta": grazing},
    }
    drawn: dict[str, list[plotting.Curve]] = {"by_angle": [], "by_cosine": []}
    lowest = []
    for done, n in enumerate(EXPONENTS):
        context.progress(done, len(EXPONENTS), f"albedo for n = {n}")
        model = albedo.model("max_phong", n=n)
        for name, cosines in (("by_angle", angles), ("by_cosine", grazing)):
            found = albedo.directional_albedo(model, cosines, rtol=rtol)
            columns[name][f"n_{n}"] = found.value
            columns[name][f"n_{n}_error"] = found.error
            drawn[name].append(
                plotting.Curve(label_of(n), "max_phong", cosines, found.value, found.error)
            )
        end = albedo.directional_albedo(model, 0.0, rtol=1e-8)
        values, errors = np.append(found.value, end.value), np.append(found.error, end.error)
        lowest.append(pumping.least(values, errors)[1:])
    for name, caption in (
        ("by_angle", "Albedo of NNS eq. 22, in degrees"),
        ("by_cosine", "Albedo of NNS eq. 22, towards grazing incidence"),
    ):
        context.table(name, pd.DataFrame(columns[name]), caption)
    context.figure(
        "albedo_figure", draw_albedos(drawn), "Albedo of the new model for several exponents."
    )
    models = [albedo.model(name, n=100) for name in ("max_phong", "phong")]
    view = np.arange(-30.0, 90.0, 0.5 if context.full else 1.0)
    rows = []
    for theta in LIGHTS:
        pair = [plane_radiance(m, math.cos(math.radians(theta)), np.radians(view)) for m in models]
        rows.append(
            pd.DataFrame(
                {
                    "theta_deg": theta,
                    "view_deg": view,
                    **{
                        key: item
                        for model, found in zip(models, pair, strict=True)
                        for key, item in (
                            (model.name, found.value),
                            (f"{model.name}_error", found.error),
                        )
                    },
                }
            )
        )
    radiance = pd.concat(rows, ignore_index=True)
    context.table("radiance", radiance, "Output radiance in the plane of incidence, n = 100, 1/sr")
    context.figure(
        "radiance_figure",
        draw_radiance(radiance),
        "Output radiance in the plane of incidence for n = 100; the grey line is the mirror "
        "direction.",
    )
    worst = int(np.argmin([value - error for value, error in lowest]))
    context.note(
        "The albedo falls towards grazing incidence, where it is (n + 2)/(2n + 2) in the limit; "
        "its smallest values are "
        + ", ".join(
            f"{format_value(*found)} for n = {n}"
            for n, found in zip(EXPONENTS, lowest, strict=True)
        )
        + "."
    )
    context.claim(
        "N13",
        "The curves of the new model: at every angle at least half of the light is reflected, "
        "whatever the exponent.",
        value=lowest[worst][0],
        error=lowest[worst][1],
        criterion=">= 0.5",
        quantity=f"smallest albedo for n from {EXPONENTS[0]} to {EXPONENTS[-1]}",
        figure="albedo_figure",
        table="by_cosine",
    )


def limit(context: Context) -> None:
    """How far controlled Phong is from eq. 22 after each step (N11)."""
    steps = 20 if context.full else 4
    goal = albedo.model("max_phong", n=20)
    cosines = np.unique(
        np.concatenate(
            (np.cos(np.radians(np.arange(0.0, 89.0, 2.0))), np.geomspace(0.05, 1e-6, 30))
        )
    )
    known = albedo.directional_albedo(goal, cosines, rtol=1e-9)
    lights = cosines[cosines >= LOWEST]
    view = np.radians(np.linspace(-89.75, 89.75, 360))
    target = [plane_radiance(goal, float(c), view) for c in lights]
    unit = 22.0 / (2.0 * math.pi)
    rows, shown = [], {}
    for control in READINGS:
        whole = albedo.pump(albedo.model("phong", n=20), steps + 1, control, rtol=1e-10)
        for k in range(steps + 1):
            context.progress(k, steps + 1, f"{control} against eq. 22")
            stage = albedo.pump(albedo.model("phong", n=20), k, control, rtol=1e-10)
            found = whole.albedo_before(k, cosines)
            distance, error = np.abs(found.value - known.value), found.error + known.error
            row: dict[str, Any] = {"reading": control, "step": k}
            for name, inside in (
                (f"albedo, cos >= {LOWEST:g}", cosines >= LOWEST),
                ("albedo, cos >= 1e-06", cosines >= 0.0),
            ):
                _, row[name], row[f"{name}_error"] = pumping.most(distance[inside], error[inside])
            off, doubt = [], []
            for c, one in zip(lights, target, strict=True):
                own = plane_radiance(stage, float(c), view)
                off.append(np.abs(own.value - one.value) / unit)
                doubt.append((own.error + one.error) / unit)
            name = f"radiance, cos >= {LOWEST:g}"
            _, row[name], row[f"{name}_error"] = pumping.most(np.ravel(off), np.ravel(doubt))
            rows.append(row)
        shown[control] = rows[-1]
    frame = pd.DataFrame(rows)
    context.table(
        "distance",
        frame,
        "Largest distances from eq. 22: of albedos, and of output radiances in the plane of "
        "incidence in units of (n + 2)/(2π)",
    )
    context.figure(
        "distance_figure",
        draw_distance(frame),
        "Largest distances of controlled Phong, n = 20, from eq. 22 at cosines of incidence from "
        f"{LOWEST:g} on; what bounds cannot tell from 0 is drawn at the bound.",
    )
    context.note(
        "In the cumulative reading the product of the albedos falls below the larger cosine step "
        "by step, first at steep angles; from then on there is no difference at all. No number of "
        "steps reaches all angles: at grazing incidence the product stays above the cosine."
    )
    for control, row in shown.items():
        for what in ("albedo", "radiance"):
            name = f"{what}, cos >= {LOWEST:g}"
            context.claim(
                "N11",
                f"Controlled pumping-up of Phong's lobe converges to eq. 22, in its {what}.",
                value=row[name],
                error=row[f"{name}_error"],
                criterion=f"< {SAME}",
                quantity=f"largest distance after {steps} steps, at cosines from {LOWEST:g} on"
                + ("" if what == "albedo" else ", in units of (n + 2)/(2π)"),
                reading=control,
                figure="distance_figure",
                table="distance",
            )
    name = f"albedo, cos >= {LOWEST:g}"
    apart = {key: format_value(row[name], row[f"{name}_error"]) for key, row in shown.items()}
    context.explain(
        "N11",
        "The albedo of Phong's lobe is at least the cosine, so if each step divides by "
        "max(a(L), a(V), N.L, N.V) the cosines never are the largest of the four: the steps are "
        "those of recursive pumping-up, whose limit reflects everything, while the albedo of "
        f"eq. 22 goes down to (n + 2)/(2n + 2) at grazing incidence. After {steps} steps they are "
        f"up to {apart['literal']} apart. If the product of all divisors may not fall below "
        "max(N.L, N.V), it goes down, as every albedo is below 1 away from the normal, until it is "
        "just that at every pair of directions, and the lobe over that product is eq. 22. After "
        f"{steps} steps the albedos are {apart['cumulative']} apart at cosines from {LOWEST:g} on.",
    )


def energy(context: Context) -> None:
    """How much more than 1 is reflected, from n = 0 to a million (N12)."""
    per_decade = 8 if context.full else 2
    beyond = np.geomspace(*BEYOND, round(per_decade * math.log10(BEYOND[1] / BEYOND[0])) + 1)
    if context.full:
        below = np.unique(np.concatenate((BELOW, np.linspace(0.0, 1.95, 40))))
    else:
        below = np.array(BELOW[::3])
    rows = []
    for done, n in enumerate(below):
        context.progress(done, len(below), f"largest albedo for n = {n:g}")
        big_t, value, error = largest_excess(float(n))
        c = 1.0 / math.hypot(1.0, big_t)
        found = albedo.directional_albedo(albedo.model("max_phong", n=n), c, rtol=1e-13, atol=1e-13)
        small_t, small = expansion(float(n))
        rows.append(
            {
                "n": n,
                "at_deg": math.degrees(math.atan(big_t)),
                "excess": value,
                "excess_error": error,
                "by_quadrature": float(found.value) - 1.0,
                "by_quadrature_error": float(found.error) + np.finfo(float).eps,
                "expansion": small,
                "expansion_at_deg": math.degrees(math.atan(small_t)),
            }
        )
    frame = pd.DataFrame(rows)
    # Roundings move the place of a maximum in the eighth digit.
    caption = "The largest a - 1 over all angles, for n below 2"
    context.table("excess", frame, caption, loose={"at_deg": 1e-4})
    # The two parts cancel where T is large; there the quadrature has all digits.
    tangents = np.geomspace(1e-8, 1.0, 97 if context.full else 33)
    cosines = np.geomspace(math.sqrt(0.5), 1e-9, 97 if context.full else 33)
    lost = []
    for done, n in enumerate(beyond):
        context.progress(done, len(beyond), f"largest albedo for n = {n:g}")
        pairs = np.array([excess(float(n), float(t)) for t in tangents]) / tangents[:, None] ** 4
        found = albedo.directional_albedo(albedo.model("max_phong", n=n), cosines, rtol=1e-10)
        values = np.concatenate((pairs[:, 0], found.value - 1.0))
        errors = np.concatenate((pairs[:, 1], found.error + np.finfo(float).eps))
        k, value, error = pumping.most(values, errors)
        at = math.atan(tangents[k]) if k < tangents.size else math.acos(cosines[k - tangents.size])
        lost.append({"n": n, "largest": value, "largest_error": error, "at_deg": math.degrees(at)})
    table = pd.DataFrame(lost)
    context.table(
        "loss",
        table,
        "The largest (a - 1)/min(1, tan θ)^4 over all angles, for n from 2 on: below 0 where "
        "light is lost at every angle but 0",
    )
    context.figure(
        "excess_figure",
        draw_excess(frame),
        "What eq. 22 with c = (n + 2)/(2π) reflects beyond 1, at the angle where that is most; "
        "dashed: the expansion about normal incidence.",
    )
    crossings = [crossing(goal, 1e-7 if context.full else 1e-2) for goal in EXCESSES]
    context.note(
        "The largest albedo passes 1 by "
        + ", ".join(
            f"{goal:g} at n = {format_value(*found)}"
            for goal, found in zip(EXCESSES, crossings, strict=True)
        )
        + ". There is always some excess below n = 2: about normal incidence "
        "a - 1 = G T^(n+2) - (n + 2)/8 T^4 with T = tan θ and "
        "G = Γ((n + 3)/2)/(2 √π (n + 1) Γ((n + 4)/2)), which is largest at T = (2G)^(1/(2-n)), "
        "where it is (2 - n)/8 T^4. At n = 2, G is 1/16, and a - 1 = -7/16 T^4."
    )
    top = int(np.argmax(frame["excess"]))
    context.claim(
        "N12",
        "Eq. 22 conserves energy when c is at most (n + 2)/(2π): exponents below 2.",
        value=frame["excess"][top],
        error=frame["excess_error"][top],
        criterion="<= 0",
        quantity=f"largest a - 1, at n = {frame['n'][top]:g} and {frame['at_deg'][top]:.1f}°",
        figure="excess_figure",
        table="excess",
    )
    _, value, error = pumping.most(table["largest"].to_numpy(), table["largest_error"].to_numpy())
    context.claim(
        "N12",
        "Eq. 22 conserves energy when c is at most (n + 2)/(2π): exponents from 2 to a million.",
        value=value,
        error=error,
        criterion="< 0",
        quantity="largest (a - 1)/min(1, tan θ)^4 over all exponents and angles",
        figure="excess_figure",
        table="loss",
    )
    context.explain(
        "N12",
        "With this constant the albedo is 1 at normal incidence. At θ, with T = tan θ and the G of "
        "the note, it gains G T^(n+2), as what would lie below the horizon counts nothing where "
        "N.V is negative, and loses (n + 2)/8 T^4 to the larger cosine. For n below 2 the gain has "
        "the lower power and wins near the normal, so light is made, however little: a - 1 is up "
        "to "
        + format_value(frame["excess"][top], frame["excess_error"][top])
        + f" at n = {frame['n'][top]:g}, and passes "
        + ", ".join(
            f"{goal:g} only below n = {format_value(*found)}"
            for goal, found in zip(EXCESSES, crossings, strict=True)
        )
        + ". At n = 2 the two are T^4/16 and T^4/2, and the loss wins; beyond, the gain has the "
        "higher power. So the statement is right for every exponent from 2 on, and lobes that are "
        "broader are hardly highlights.",
    )


def excess(n: float, big_t: float) -> tuple[float, float]:
    """a - 1 of eq. 22 with c = (n + 2)/(2π) at tan θ = T, and what two rules differ by."""
    rules = [_parts(n, big_t, nodes) for nodes in (28, 40)]
    value = rules[1][0] - rules[1][1]
    moved = sum(abs(a - b) for a, b in zip(*rules, strict=True))
    return value, 4.0 * moved + 1e-14 * sum(rules[1])


def _parts(n: float, big_t: float, nodes: int) -> tuple[float, float]:
    """What the horizon would have taken away, and what the larger cosine takes."""
    rule = gauss(nodes)
    x, w = rule.nodes, rule.weights
    # The angle to the plane across that of incidence, stretched at the scale of the lobe.
    width = min(1.0, 1.0 / math.sqrt(max(n, 1.0)))
    scale = width / max(big_t, width)
    last = math.asinh(0.5 * math.pi / scale)
    cuts = np.linspace(0.0, last, math.ceil(last / 2.0) + 1)
    if big_t > 1.0:
        # Where the ring of equal heights meets R.V = 0.
        cuts = np.unique(np.append(cuts, math.asinh(math.asin(1.0 / big_t) / scale)))
    gain = loss = 0.0
    for low, high in itertools.pairwise(cuts):
        # A root at the start of the first panel, where the power n + 2 of the angle begins.
        power = 6 if low == 0.0 else 1
        s = low + (high - low) * x**power
        weight = w * power * x ** (power - 1) * (high - low) * scale * np.cosh(s)
        beta = np.arctan(big_t * np.sin(scale * np.sinh(s)))
        # Both sides of the plane of incidence.
        gain += float(2.0 * weight @ _gained(n, beta, x, w))
        loss += float(2.0 * weight @ _lost(n, beta, x, w))
    c = (n + 2.0) / (2.0 * math.pi)
    return c * gain, c * loss


def _gained(n: float, beta: np.ndarray, x: np.ndarray, w: np.ndarray) -> np.ndarray:
    """∫ sin(y)^n sin(β - y)/cos(β) cos(y) dy up to β, y being the angle from R.V = 0."""
    power = 8
    y = beta[:, None] * x**power
    jacobian = beta[:, None] * power * x ** (power - 1)
    found: np.ndarray = (
        np.exp(n * np.log(np.sin(y)))
        * np.sin(beta[:, None] - y)
        / np.cos(beta[:, None])
        * np.cos(y)
        * jacobian
    ) @ w
    return found


def _lost(n: float, beta: np.ndarray, x: np.ndarray, w: np.ndarray) -> np.ndarray:
    """∫ cos(α)^n 2 sin(α/2) sin(β - α/2)/cos(β) sin(α) dα up to 2β, π/2, or the lobe's end."""
    end = np.minimum(2.0 * beta, 0.5 * math.pi)
    end = np.minimum(end, math.sqrt(100.0 / max(n, 1e-300)))
    power = 6
    alpha = end[:, None] * (1.0 - (1.0 - x) ** power)
    jacobian = end[:, None] * power * (1.0 - x) ** (power - 1)
    cosine = np.sin(0.5 * math.pi - alpha)
    found: np.ndarray = (
        np.exp(n * np.log(np.maximum(cosine, 1e-300)))
        * 2.0
        * np.sin(0.5 * alpha)
        * np.sin(beta[:, None] - 0.5 * alpha)
        / np.cos(beta[:, None])
        * np.sin(alpha)
        * jacobian
    ) @ w
    return found


def expansion(n: float) -> tuple[float, float]:
    """tan θ where a - 1 is largest, and how large, by the first terms about normal incidence."""
    root = math.exp(math.lgamma(0.5 * (n + 3.0)) - math.lgamma(0.5 * (n + 4.0)))
    g = root / (2.0 * math.sqrt(math.pi) * (n + 1.0))
    big_t = (2.0 * g) ** (1.0 / (2.0 - n))
    return big_t, (2.0 - n) / 8.0 * big_t**4


def largest_excess(n: float) -> tuple[float, float, float]:
    """tan θ at which a - 1 is largest, for n below 2; its value there, and a bound."""
    start = math.log(expansion(n)[0])
    grid = start + np.linspace(-2.0, 3.0, 26)
    values = [excess(n, math.exp(t))[0] for t in grid]
    k = int(np.clip(np.argmax(values), 1, len(grid) - 2))
    low, high = float(grid[k - 1]), float(grid[k + 1])
    golden = 0.5 * (math.sqrt(5.0) - 1.0)
    a, b = high - golden * (high - low), low + golden * (high - low)
    at_a, at_b = excess(n, math.exp(a))[0], excess(n, math.exp(b))[0]
    # Beyond half the digits a maximum is flat.
    while high - low > 1e-8:
        if at_a >= at_b:
            high, b, at_b = b, a, at_a
            a = high - golden * (high - low)
            at_a = excess(n, math.exp(a))[0]
        else:
            low, a, at_a = a, b, at_b
            b = low + golden * (high - low)
            at_b = excess(n, math.exp(b))[0]
    big_t = math.exp(0.5 * (low + high))
    return (big_t, *excess(n, big_t))


def crossing(goal: float, width: float) -> tuple[float, float]:
    """The exponent at which the largest a - 1 is `goal`, and a bound on its error."""
    low, high = 0.0, 1.9
    while high - low > width:
        middle = 0.5 * (low + high)
        _, value, error = largest_excess(middle)
        if value - error > goal:
            low = middle
        elif value + error < goal:
            high = middle
        else:
            break
    return 0.5 * (low + high), 0.5 * (high - low)


def label_of(n: int) -> str:
    """n in a legend."""
    return f"n = {n}" if n < 1000 else f"n = 10{'³⁴'[round(math.log10(n)) - 3]}"


def draw_albedos(drawn: dict[str, list[plotting.Curve]]) -> Figure:
    """The albedo in degrees and towards grazing incidence."""
    with plotting.style():
        figure, panels = plotting.new_figure(2, 7.5, 3.4)
        for axes, (name, curves) in zip(panels, drawn.items(), strict=True):
            for curve, look in zip(curves, pumping.looks(len(curves)), strict=True):
                grazing = name == "by_cosine"
                x = curve.cos_theta if grazing else np.degrees(np.arccos(curve.cos_theta))
                axes.plot(x, curve.value, label=curve.label, **look)
            axes.axhline(1.0, color="#888888", linewidth=0.9, zorder=1.5)
            axes.set_ylim(0.4, 1.03)
        left, right = panels
        left.set_xlim(0.0, 90.0)
        left.set_xticks(np.arange(0.0, 91.0, 15.0))
        left.set_xlabel("angle of incidence (degrees)")
        left.set_ylabel("directional albedo")
        right.set_xscale("log")
        right.set_xlim(1.0, 1e-6)
        right.set_xlabel("cosine of the angle of incidence")
        plotting.add_legend(figure, left)
    return figure


def draw_radiance(frame: pd.DataFrame) -> Figure:
    """The output radiance of the new model and of Phong's."""
    with plotting.style():
        figure, panels = plotting.new_figure(len(LIGHTS), 7.5, 3.2)
        for axes, theta in zip(panels, LIGHTS, strict=True):
            rows = frame[frame["theta_deg"] == theta]
            axes.axvline(theta, color="#888888", linewidth=0.9, zorder=1.5)
            for name, label, line in (
                ("max_phong", "over the larger cosine", "-"),
                ("phong", "Phong", (0, (6, 2))),
            ):
                color = plotting.color(name)
                axes.plot(rows["view_deg"], rows[name], label=label, color=color, linestyle=line)
            axes.set_title(f"light at {theta:g}°", loc="left")
            axes.set_xlim(theta - 45.0, min(theta + 45.0, 90.0))
            axes.set_ylim(0.0, 1.05 * float(frame["max_phong"].max()))
            if axes is not panels[0]:
                axes.tick_params(labelleft=False)
        panels[1].set_xlabel("angle of the view in the plane of incidence (degrees)")
        panels[0].set_ylabel("output radiance (1/sr)")
        plotting.add_legend(figure, panels[0])
    return figure


def draw_distance(frame: pd.DataFrame) -> Figure:
    """Distances from eq. 22 against the number of steps."""
    with plotting.style():
        figure, (axes,) = plotting.new_figure(1, 6.5, 3.6)
        for control, color in (("literal", "#D55E00"), ("cumulative", "#0072B2")):
            rows = frame[frame["reading"] == control]
            for what, line, mark in (("albedo", "-", "o"), ("radiance", (0, (3, 1.6)), "s")):
                name = f"{what}, cos >= {LOWEST:g}"
                # What bounds cannot tell from 0 is drawn at the bound.
                value = np.maximum(rows[name], rows[f"{name}_error"])
                axes.plot(
                    *(rows["step"], value),
                    color=color,
                    linestyle=line,
                    marker=mark,
                    markersize=3.5,
                    label=f"{control}, {what}",
                )
        axes.set_yscale("log")
        axes.set_xlabel("steps")
        axes.set_xticks(np.arange(0, frame["step"].max() + 1, 1 + frame["step"].max() // 11))
        axes.set_ylabel("largest distance from eq. 22")
        plotting.add_legend(figure, axes, columns=2)
    return figure


def draw_excess(frame: pd.DataFrame) -> Figure:
    """The largest a - 1 against the exponent."""
    with plotting.style():
        figure, (axes,) = plotting.new_figure(1, 6.5, 3.6)
        color = plotting.color("max_phong")
        axes.plot(
            *(frame["n"], frame["excess"]),
            color=color,
            marker="o",
            markersize=3.5,
            label="measured",
        )
        axes.plot(
            *(frame["n"], frame["expansion"]),
            color="#222222",
            linestyle=(0, (6, 2)),
            linewidth=1.0,
            label="expansion about normal incidence",
        )
        axes.set_yscale("log")
        axes.set_ylim(1e-20, 1.0)
        axes.set_xlim(0.0, 2.0)
        axes.set_xlabel("exponent n")
        axes.set_ylabel("largest albedo less 1")
        plotting.add_legend(figure, axes)
    return figure
