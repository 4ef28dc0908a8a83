"""What does an evaluation of each model cost, and is Schwenk's ranking of costs right?

The compiled kernels of all models are timed in turns, in float64 and in float32, over random pairs
of directions and over pairs that the model itself draws. All times are those of one machine: a
processor, where Schwenk thinks of graphics cards.

Schwenk's words are measured as: "relatively fast" is no more than the median of the models that the
survey treats, "comparable" is within a factor of 1.5, "very expensive" is twice the median, and
"hurt by divisions" is that they take more than a quarter of the time. What they take is seen in
kernels whose divisions are products by reciprocals that are there already.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

import albedo
from albedo import plotting
from albedo._compile import in_single, kernel
from albedo.analysis import kernel_cost
from albedo.analysis.kernel_cost import PRECISIONS, Block, Subject, subject
from albedo.estimate import format_value
from albedo.fresnel import schlick
from albedo.geometry import cosine_power, normal_power, slope2, v_dot_h
from albedo.grammar import parse
from albedo.studies import Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from albedo.studies import Context

STUDY = Study(
    name="cost",
    title="What an evaluation costs",
    paper="S",
    claims=("S15",),
)

SURVEYED = (
    *("lambert", "phong", "blinn", "oren_nayar", "cook_torrance", "ward", "lafortune"),
    *("schlick", "strauss", "schwenk"),
)
"""The survey's models that the catalogue has as they are; Ashikhmin-Shirley's is added."""
ISOTROPIC = "ashikhmin_shirley (isotropic)"
PRINTED = "oren_nayar (in angles)"
FRESNEL = "cook_torrance (Fresnel)"

COMPARABLE = 1.5
EXPENSIVE = 2.0
HURT = 0.25

READINGS = [(precision, way) for precision in PRECISIONS for way in ("pairs", "lobe")]
SAID = {"pairs": "random pairs", "lobe": "in the lobe"}


@kernel
def fill_isotropic(wi, wo, h, p, out):
    """f_s = (n+1)/(8 pi) (n.h)^n F/(v.h max(n.l, n.v)): one exponent, and no azimuth."""
    for j in range(out.shape[0]):
        lz, n, scale, r_s = wi[2, j], p[j, 0], p[j, 2], p[j, 3]
        for i in range(out.shape[1]):
            hx, hy, hz = h[0, j, i], h[1, j, i], h[2, j, i]
            u = v_dot_h(hx, hy, hz)
            lobe = normal_power(slope2(hx, hy, hz), n)
            out[j, i] = scale * lobe * schlick(r_s, u) / (u * max(lz, wo[2, j, i]))


@kernel
def fill_in_angles(wi, wo, h, p, out):
    """f = rho/pi (A + B max(0, cos(phi_l - phi_v)) sin(alpha) tan(beta)), as it is printed."""
    for j in range(out.shape[0]):
        theta_l, phi_l = math.acos(wi[2, j]), math.atan2(wi[1, j], wi[0, j])
        for i in range(out.shape[1]):
            theta_v, phi_v = math.acos(wo[2, j, i]), math.atan2(wo[1, j, i], wo[0, j, i])
            alpha, beta = max(theta_l, theta_v), min(theta_l, theta_v)
            turned = max(0.0, math.cos(phi_l - phi_v))
            out[j, i] = p[j, 0] + p[j, 1] * turned * math.sin(alpha) * math.tan(beta)


# Of x(2 k - x)/((k (k - x))^2 whole), as in albedo/catalogue/strauss.py.
_K_F, _K_G = 1.12, 0.01
_WHOLE_F = 1.0 / 0.12**2 - 1.0 / _K_F**2
_WHOLE_G = 1.0 / _K_G**2 - 1.0 / 1.01**2


@kernel
def fill_strauss_products(wi, wo, h, p, out):
    """Strauss' specular term; reciprocals are columns 6 to 11 of p."""
    for j in range(out.shape[0]):
        lx, ly, lz = wi[0, j], wi[1, j], wi[2, j]
        e, r_n, white, tinted, scale = p[j, 0], p[j, 1], p[j, 2], p[j, 3], p[j, 4]
        sin_l = math.hypot(lx, ly)
        x = math.atan2(sin_l, lz) * (2.0 / math.pi)
        f = x * (2.0 * _K_F - x) * p[j, 6]
        y = math.atan2(lz, sin_l) * (2.0 / math.pi)
        both = f * (y * (2.0 * _K_G + y) * p[j, 7])
        c_s = scale * (white + tinted * f) * p[j, 8]
        for i in range(out.shape[1]):
            vz = wo[2, j, i]
            y = math.atan2(vz, math.hypot(wo[0, j, i], wo[1, j, i])) * 2.0 * p[j, 10]
            seen = y * (2.0 * _K_G + y) * p[j, 9]
            r_j = min(1.0, r_n + (r_n + 0.1) * both * seen)
            hx, hy, hz = h[0, j, i], h[1, j, i], h[2, j, i]
            dz = lz - vz
            if hz * hz > math.sqrt(hx * hx + hy * hy):
                dz = -((2.0 * lx - hx) * hx + (2.0 * ly - hy) * hy) * p[j, 11]
            out[j, i] = r_j * cosine_power(hx * hx + hy * hy + dz * dz, e) * c_s


def strauss_reciprocals(block: Block, row: np.ndarray) -> list[np.ndarray]:
    """Of what Strauss' specular term divides by: 5 denominators of directions, and pi."""
    (lx, ly, lz), (vx, vy, vz) = block.wi, block.wo[:, :, 0]
    sin_l, sin_v = np.hypot(lx, ly), np.hypot(vx, vy)
    x, y = (2.0 / math.pi * np.arctan2(*pair) for pair in ((sin_l, lz), (lz, sin_l)))
    y_v = 2.0 / math.pi * np.arctan2(vz, sin_v)
    return [
        1.0 / ((_K_F * (_K_F - x)) ** 2 * _WHOLE_F),
        1.0 / ((_K_G * (_K_G + y)) ** 2 * _WHOLE_G),
        1.0 / lz,
        1.0 / ((_K_G * (_K_G + y_v)) ** 2 * _WHOLE_G),
        np.full_like(lz, 1.0 / math.pi),
        1.0 / block.h[2, :, 0],
    ]


@kernel
def fill_schlick_products(wi, wo, h, p, out):
    """Schlick's shadowed lobe in one layer, r and A with its root; reciprocals follow column 14."""
    for j in range(out.shape[0]):
        r, isotropy, color, b = p[j, 0], p[j, 1], p[j, 2], p[j, 4]
        g_l = p[j, 15]
        for i in range(out.shape[1]):
            if wo[2, j, i] <= 0.0:
                out[j, i] = 0.0
                continue
            hx, hy, hz = h[0, j, i], h[1, j, i], h[2, j, i]
            x, y = hx * p[j, 16], hy * p[j, 16]
            g = g_l * p[j, 17]
            q = (1.0 + x * x + y * y) * p[j, 18]
            w2, rest = hx * hx * p[j, 19], hy * hy * p[j, 19]
            # In the place of p^2 rest + w2, whose reciprocal is there, stands a sum that is 1.
            a = isotropy * p[j, 20] * (w2 + rest)
            s = schlick(color, v_dot_h(hx, hy, hz))
            out[j, i] = s * b * g * (r * q * q * math.sqrt(a)) * p[j, 21]


def schlick_reciprocals(block: Block, row: np.ndarray) -> list[np.ndarray]:
    """Of what Schlick's shadowed lobe divides by: 6 denominators of directions, and 4 pi."""
    r, p = row[0], row[1]
    lz, vz, (hx, hy, hz) = block.wi[2], block.wo[2, :, 0], block.h[:, :, 0]
    t2 = hx * hx + hy * hy
    return [
        1.0 / (r * (1.0 - lz) + lz),
        1.0 / hz,
        1.0 / (r * (1.0 - vz) + vz),
        1.0 / (r + t2 / hz**2),
        1.0 / t2,
        1.0 / (p * p * hy * hy / t2 + hx * hx / t2),
        np.full_like(lz, 1.0 / (4.0 * math.pi)),
    ]


# Model, its kernel without divisions, their reciprocals, and how many divisions a pair takes.
PRODUCTS: dict[str, tuple[Any, Callable[[Block, np.ndarray], list[np.ndarray]], int]] = {
    "strauss": (fill_strauss_products, strauss_reciprocals, 6),
    "schlick": (fill_schlick_products, schlick_reciprocals, 9),
}


def run(context: Context) -> None:
    """Time all models and the variants of some, and judge the ranking."""
    repeats, seconds = (31, 4e-3) if context.full else (9, 5e-4)
    context.setting(seed=0, repeats=repeats, seconds=seconds)
    names = None if context.full else (*SURVEYED, "ashikhmin_shirley")
    listed, variants = kernel_cost.catalogue(names), readings_of_models()
    pairs = {name: with_and_without(name) for name in PRODUCTS}
    every = [*listed, *variants, *(item for two in pairs.values() for item in two)]
    found = kernel_cost.samples(
        every,
        ways=("pairs", "lobe"),
        repeats=repeats,
        seconds=seconds,
        progress=lambda done, total: context.progress(done, total, "timing"),
        alone=context.alone,
    )
    frame = kernel_cost.table([*listed, *variants], found)
    context.table(
        "costs",
        with_errors(frame),
        "Nanoseconds for one evaluation of all parts",
        machine=("ns", "ns_error", "ratio", "ratio_error", "empty_ns"),
    )
    context.figure(
        "costs_figure",
        draw(frame),
        "Nanoseconds for one evaluation, medians and quartiles, on one machine. Grey: an empty "
        "kernel that reads and writes as much.",
    )
    context.note(
        f"Times are those of one machine ({kernel_cost.processor()}), of {repeats} rounds in which "
        "all kernels took turns; another machine gives others. The errors are the distances from "
        "the median to the farther quartile of the rounds, which is more than the standard error "
        "of a median."
    )
    rank(context, found)
    divisions(context, found, pairs)
    out_of_range(context, found, listed)


def readings_of_models() -> list[Subject]:
    """Models of the survey as it may mean them, where the catalogue has them otherwise."""
    shirley, nayar = albedo.model("ashikhmin_shirley"), albedo.model("oren_nayar")
    fresnel = parse("cook_torrance:fresnel=dielectric").model()
    row_s, row_n = (kernel_cost.constant(np.array(m.pack())) for m in (shirley, nayar))
    return [
        Subject(ISOTROPIC, "one exponent", ((fill_isotropic, row_s),), shirley),
        Subject(PRINTED, "acos, atan2, cos, sin, tan", ((fill_in_angles, row_n),), nayar),
        subject(fresnel, FRESNEL),
    ]


def with_and_without(name: str) -> tuple[Subject, Subject]:
    """The specular kernel of a model, and that without divisions, with equal rows of parameters."""
    model = albedo.model(name)
    part = next(part for part in model.parts() if part.name == "specular")
    row = part.packed(np.array([model.pack()]))[0]
    variant, reciprocals, _ = PRODUCTS[name]

    def rows(block: Block) -> np.ndarray:
        shared = np.tile(row, (block.wi.shape[1], 1))
        return np.column_stack((shared, *reciprocals(block, row)))

    return (
        Subject(f"{name}, divisions", model.spec, ((part.fill, rows),), model),
        Subject(f"{name}, products", model.spec, ((variant, rows),), model),
    )


def largest_difference(two: tuple[Subject, Subject], precision: str) -> float:
    """Between the values of both kernels over random pairs, relative to the largest value."""
    block = kernel_cost.random_block(np.random.default_rng(0))
    own, other = (
        values(fill, rows(block), block, precision) for item in two for fill, rows in item.fills
    )
    return float(np.max(np.abs(other - own)) / np.max(np.abs(own)))


def with_errors(frame: pd.DataFrame) -> pd.DataFrame:
    """Quartiles as errors, so that a report prints one number."""
    kept = frame[["model", "spec", "precision", "way"]].copy()
    for name in ("ns", "ratio"):
        low, high = frame[name] - frame[f"{name}_low"], frame[f"{name}_high"] - frame[name]
        kept[name], kept[f"{name}_error"] = frame[name], np.maximum(low, high)
    return kept.assign(empty_ns=frame["empty_ns"], parts=frame["parts"])


def middle(values: np.ndarray) -> tuple[float, float]:
    """Median of the rounds, and its distance to the farther quartile."""
    found, low, high = kernel_cost.spread(values)
    return found, max(found - low, high - found)


def judge(
    context: Context,
    statement: str,
    quantity: str,
    values: Mapping[tuple[str, str], np.ndarray],
    criterion: str,
    table: str = "ranking",
) -> dict[str, str]:
    """One part of the claim for each precision and kind of directions; what is found of each."""
    said = {}
    for (precision, way), of_rounds in values.items():
        value, error = middle(of_rounds)
        reading = f"{precision}, {SAID[way]}"
        said[reading] = format_value(value, error)
        context.claim(
            "S15",
            statement,
            value=value,
            error=error,
            criterion=criterion,
            quantity=quantity,
            kind="standard_error",
            reading=reading,
            table=table,
            machine=True,
        )
    return said


def rank(context: Context, found: Mapping[kernel_cost.Key, np.ndarray]) -> None:
    """The order of the survey's models, and what the survey says of it."""
    names = [*SURVEYED, ISOTROPIC]
    relative: dict[str, dict[tuple[str, str], np.ndarray]] = {}
    for reading in READINGS:
        median = np.median([found[name, *reading] for name in names], axis=0)
        for name in (*names, PRINTED, FRESNEL):
            relative.setdefault(name, {})[reading] = found[name, *reading] / median
    rows = []
    for name, values in relative.items():
        for (precision, way), of_rounds in values.items():
            ns, ns_error = middle(found[name, precision, way])
            ratio, error = middle(of_rounds)
            rows.append((name, precision, way, ns, ns_error, ratio, error))
    columns = ["model", "precision", "way", "ns", "ns_error", "to_median", "to_median_error"]
    table = pd.DataFrame(rows, columns=columns)
    order = ["precision", "way", "to_median"]
    context.table(
        "ranking",
        table.sort_values(order, ascending=[False, False, True], ignore_index=True),
        "The survey's models by their cost over the median of eleven of them: "
        f"{PRINTED} and {FRESNEL} are further readings",
        # Rows are in the order of their times.
        machine=("model", "ns", "ns_error", "to_median", "to_median_error"),
    )
    fast = judge(
        context,
        "Ashikhmin and Shirley's isotropic model is relatively fast.",
        "time over the median of the survey's models",
        relative[ISOTROPIC],
        "<= 1",
    )
    apart = {}
    for key in READINGS:
        ratio = found["ward", *key] / found[ISOTROPIC, *key]
        apart[key] = np.maximum(ratio, 1.0 / ratio)
    near = judge(
        context,
        "Ward's model costs about as much as Ashikhmin and Shirley's isotropic one.",
        "ratio of the two times, the larger over the smaller",
        apart,
        f"<= {COMPARABLE:g}",
    )
    dear: dict[str, dict[str, str]] = {}
    for name, said in (
        ("oren_nayar", "Oren and Nayar's model, in dot products,"),
        (PRINTED, "Oren and Nayar's model, in angles as printed,"),
        ("cook_torrance", "Cook and Torrance's model with F = 1"),
        (FRESNEL, "Cook and Torrance's model with the exact Fresnel factor"),
    ):
        dear[name] = judge(
            context,
            f"{said} is very expensive.",
            "time over the median of the survey's models",
            relative[name],
            f">= {EXPENSIVE:g}",
        )
    first_reading = next(iter(fast))
    context.explain(
        "S15",
        "The survey has graphics cards in mind, and these are kernels compiled for a processor, so "
        "its ranking is not wrong for what it is about; here it does not carry over. What is dear "
        "is to go through angles: Oren-Nayar as it is printed takes "
        f"{dear[PRINTED][first_reading]} times the median of the models ({first_reading}), and in "
        f"dot products, with the same values, {dear['oren_nayar'][first_reading]} times. "
        f"Cook-Torrance takes {dear['cook_torrance'][first_reading]} times the median, and with "
        f"the exact Fresnel factor {dear[FRESNEL][first_reading]}. Isotropic Ashikhmin-Shirley "
        f"takes {fast[first_reading]}, near the median and not below it in every reading, and Ward "
        f"differs from it by a factor of {near[first_reading]}: which of the two is faster depends "
        "on the precision and on the directions, as values far from the lobe underflow.",
    )
    first = table[(table["precision"] == "float64") & (table["way"] == "pairs")]
    by_cost = first[first["model"].isin(names)].sort_values("to_median")
    listed = ", ".join(
        f"{row['model']} {format_value(row['to_median'], row['to_median_error'])}"
        for row in by_cost.to_dict("records")
    )
    context.note(
        f"The survey's models in float64 over random pairs, as multiples of their median: {listed}."
    )


def divisions(
    context: Context,
    found: Mapping[kernel_cost.Key, np.ndarray],
    pairs: Mapping[str, tuple[Subject, Subject]],
) -> None:
    """What share of Strauss' and Schlick's time goes into divisions."""
    rows, told = [], []
    for name, two in pairs.items():
        shares = {
            key: 1.0 - found[two[1].label, *key] / found[two[0].label, *key] for key in READINGS
        }
        for (precision, way), of_rounds in shares.items():
            share, error = middle(of_rounds)
            count, difference = PRODUCTS[name][2], largest_difference(two, precision)
            rows.append((name, precision, way, count, share, error, difference))
        share_of = judge(
            context,
            f"Divisions hurt {name.capitalize()}: they take over a quarter of the specular term's "
            "time.",
            "share of the time that is saved where reciprocals are there already",
            shares,
            f"> {HURT:g}",
            table="divisions",
        )
        told.append(f"{share_of[next(iter(share_of))]} of the {name.capitalize()} term's")
    columns = ["model", "precision", "way", "divisions", "share", "share_error", "value_difference"]
    context.table(
        "divisions",
        pd.DataFrame(rows, columns=columns),
        "Time that divisions take: the specular kernel against one that multiplies by reciprocals "
        "read from memory, and how far their values differ over the largest value",
        machine=("share", "share_error"),
        # Of float32's roundings.
        loose={"value_difference": 1e-5},
    )
    context.explain(
        "S15",
        f"Divisions take {' and '.join(told)} time, in float64 over random pairs: of the "
        f"{PRODUCTS['strauss'][2]} that Strauss' specular term has for a pair little is seen "
        "beside its arc tangents and its power, while Schlick's has little else than "
        f"{PRODUCTS['schlick'][2]} of them.",
    )


def out_of_range(
    context: Context, found: Mapping[kernel_cost.Key, np.ndarray], listed: list[Subject]
) -> None:
    """Say where float32 is slower than float64 outside the lobe, but not within it."""
    slower = {}
    for item in listed:
        if not item.compiled:
            continue
        of = {
            way: middle(found[item.label, "float32", way] / found[item.label, "float64", way])
            for way in ("pairs", "lobe")
        }
        (outside, outside_error), (inside, inside_error) = of["pairs"], of["lobe"]
        if outside - outside_error > 1.0 and inside + inside_error < 1.0:
            slower[item] = format_value(outside, outside_error)
    if not slower:
        return
    told = ", ".join(
        f"{item.label} by {ratio} ({lost(item, 'pairs'):.0%} and {lost(item, 'lobe'):.0%})"
        for item, ratio in slower.items()
    )
    context.note(
        "Slower in float32 than in float64 over random pairs, though faster in the lobe (in "
        "brackets the shares of float32 values that are 0 or denormal, over random pairs and in "
        "the lobe): "
        f"{told}."
    )


def lost(item: Subject, way: str) -> float:
    """Share of the values of the kernels that are below the normal numbers of float32."""
    rng = np.random.default_rng(0)
    assert item.model is not None
    block = kernel_cost.random_block(rng)
    if way == "lobe":
        block = kernel_cost.lobe_block(item.model, rng)
    tiny = [values(fill, rows(block), block, "float32") for fill, rows in item.fills]
    return float(np.mean(np.abs(tiny) < np.finfo(np.float32).tiny))


def values(fill: Any, rows: np.ndarray, block: Block, precision: str) -> np.ndarray:
    """What a kernel gives in a precision."""
    own, compiled = block.astype(precision), fill if precision == "float64" else in_single(fill)
    out = np.empty(own.wo.shape[1:], precision)
    compiled(own.wi, own.wo, own.h, np.ascontiguousarray(rows, precision), out)
    return out.astype(float)


def draw(frame: pd.DataFrame) -> Figure:
    """One row for every model: bars from a logarithmic axis, with quartiles."""
    first = frame[frame["way"] == "pairs"].set_index(["model", "precision"])
    names = list(first.xs("float64", level="precision")["ns"].sort_values(ascending=False).index)
    looks = {"float64": ("#0072B2", 0.19), "float32": ("#E69F00", -0.19)}
    with plotting.style():
        figure, (axes,) = plotting.new_figure(height=0.24 * len(names) + 0.9)
        for precision, (color, shift) in looks.items():
            shown = [k for k, name in enumerate(names) if (name, precision) in first.index]
            rows = first.loc[[(names[k], precision) for k in shown]]
            ns = rows["ns"].to_numpy()
            ends = np.array([ns - rows["ns_low"], rows["ns_high"] - ns])
            axes.barh(
                np.array(shown) + shift,
                ns,
                height=0.38,
                color=color,
                xerr=ends,
                error_kw={"elinewidth": 0.9, "ecolor": "#222222"},
                label=precision,
            )
        empty = first.xs("float64", level="precision")["empty_ns"].iloc[0]
        axes.axvline(empty, color="#888888", linewidth=0.9, label="empty kernel, float64")
        axes.set_xscale("log")
        low, high = float(first["ns_low"].min()), float(first["ns_high"].max())
        axes.set_xlim(0.7 * low, 1.3 * high)
        axes.set_yticks(range(len(names)), names)
        axes.set_ylim(-0.6, len(names) - 0.4)
        axes.set_xlabel("time for one evaluation (ns)")
        axes.grid(axis="y", visible=False)
        plotting.add_legend(figure, axes)
    return figure
