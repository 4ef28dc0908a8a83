"""What is the albedo of every model, and does every model keep its promises?

One figure for every model of the registry: albedo curves for some values of its main parameter, and
a map over the range of that parameter and the angle of incidence. Where the albedo still changes
beyond 89.9 degrees, both are drawn once more over the logarithm of the cosine.

Three promises are held against what was computed: that light and view may be exchanged, that no
more light leaves than arrives, and that the albedo has a limit at the horizon. What is measured is
the worst of the directions and parameters that were looked at, and no proof for the others.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

import albedo
from albedo import plotting
from albedo.analysis.checks import asymmetry
from albedo.brdf import Vectors
from albedo.grammar import ModelSpec, parse_model
from albedo.quadrature import albedo_rows
from albedo.studies import Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from albedo.brdf import Model
    from albedo.estimate import Estimate
    from albedo.studies import Context

STUDY = Study(name="model_pages", title="Every model's albedo")

# The last angle of a linear axis.
STEEP = 89.9
# Between these two cosines an albedo that has a limit has all but reached it.
NEAR, NEARER = 1e-6, 1e-9
GROWTH = 1.05
SEED = 1
# Half vectors are formed from raw directions, which costs digits at grazing incidence.
RECIPROCAL = 1e-6
# Colours stand for albedos up to this one.
MOST = 2.0


@dataclass(frozen=True)
class Resolution:
    """How finely to look: curves, angles of each, sets and angles of a map, random pairs."""

    curves: int
    angles: int
    per_decade: int
    wide: int
    high: int
    pairs: int
    rtol: float


QUICK = Resolution(curves=4, angles=24, per_decade=2, wide=9, high=13, pairs=500, rtol=1e-4)
FULL = Resolution(curves=4, angles=45, per_decade=4, wide=15, high=25, pairs=20_000, rtol=1e-7)


@dataclass(frozen=True)
class Sweep:
    """Models that differ in one parameter, and the albedos of each over cosines of incidence."""

    parameter: str
    labels: list[str]
    values: np.ndarray
    models: list[Model]
    cosines: np.ndarray
    found: Estimate

    @property
    def albedos(self) -> np.ndarray:
        """One row for every model."""
        found: np.ndarray = self.found.value.reshape(len(self.models), -1)
        return found

    @property
    def errors(self) -> np.ndarray:
        """Their bounds."""
        found: np.ndarray = self.found.error.reshape(len(self.models), -1)
        return found


def run(context: Context) -> None:
    """Draw every model, and hold it to what it promises."""
    look = FULL if context.full else QUICK
    context.setting(rtol=look.rtol, seed=SEED, pairs=look.pairs)
    found: dict[str, list[dict[str, Any]]] = {"reciprocity": [], "energy": [], "horizon": []}
    names = list(albedo.models())
    for done, name in enumerate(names):
        context.progress(done, len(names), name)
        for promise, row in draw_model(context, name, look).items():
            found[promise].append({"model": name, **row})
    captions = {
        "reciprocity": "Light and view exchanged: the largest relative difference of two values",
        "energy": "The largest albedo, of all sets of parameters and of those with the promise",
        "horizon": f"Albedo at cos θ = {NEARER:g} over that at {NEAR:g}, at most, of the sets of "
        "parameters that promise a limit if any do",
    }
    for promise, rows in found.items():
        loose = {"asymmetry": RECIPROCAL} if promise == "reciprocity" else {}
        context.table(promise, pd.DataFrame(rows), captions[promise], loose=loose)
        made = [row for row in rows if row["promised"] != "no"]
        broken = [row["model"] for row in made if row["kept"] != "yes"]
        context.note(
            f"{promise.capitalize()}: {len(made)} of {len(rows)} models promise it, some of them "
            "for a part of their parameters, and "
            + (f"it is not kept by {', '.join(broken)}." if broken else "all of these keep it.")
        )


def draw_model(context: Context, name: str, look: Resolution) -> dict[str, dict[str, Any]]:
    """The figure and the tables of one model; returns what is found of each promise."""
    narrow, wide = sweeps(name)
    narrow, wide = thinned(narrow, look.curves), thinned(wide, look.wide)
    decades = -np.log10(NEARER)
    axes = (
        short(np.cos(np.radians(angles(look.angles)))),
        short(np.geomspace(1.0, NEARER, round(decades * look.per_decade) + 1)),
    )
    curves = [measure(narrow, cosines, look.rtol) for cosines in axes]
    matters = changes_beyond(curves)
    shown = curves if matters else curves[:1]
    rows = (
        short(np.cos(np.radians(np.append(np.linspace(0.0, 88.0, look.high - 1), STEEP)))),
        short(np.geomspace(1.0, NEARER, look.high)),
    )
    maps = [measure(wide, cosines, look.rtol) for cosines in rows[: len(shown)]]
    kind = albedo.models()[name]
    # The angle is there to be read; the cosine is what was computed with.
    curve, field = as_frame(shown), as_frame(maps).drop(columns="theta_deg")
    caption = f"{kind.title}: map over {maps[0].parameter}"
    context.table(f"{name}_curves", curve, f"{kind.title}: curves", digits={"theta_deg": 6})
    context.table(f"{name}_map", field, caption)
    context.figure(
        f"{name}_figure",
        draw(name, shown, maps),
        f"{kind.title}: albedo for {len(curves[0].values)} values of {curves[0].parameter} "
        f"(left), and over the range of {maps[0].parameter} (right)"
        + (", against the angle (top) and towards the horizon (bottom)." if matters else ".")
        + (" Warm colours: more leaves than arrives." if exceeds(maps) else ""),
    )
    return {
        "reciprocity": reciprocity(curves[0].models, look.pairs),
        "energy": energy([*curves, *maps]),
        "horizon": horizon(curves[1].models, look.rtol),
    }


def angles(count: int) -> np.ndarray:
    """So many angles in degrees and the steepest: a quarter of them over the last six degrees."""
    near = count // 4
    flat = np.linspace(0.0, 84.0, count - near, endpoint=False)
    return np.concatenate((flat, np.linspace(84.0, 89.5, near), [STEEP]))


def short(cosines: np.ndarray) -> np.ndarray:
    """Cosines of six digits, exactly what a table says."""
    return np.array([float(f"{c:.6g}") for c in cosines])


def sweeps(name: str) -> tuple[ModelSpec, ModelSpec]:
    """What the curves and the map of a model sweep: its main parameter, over two ranges."""
    kind = albedo.models()[name]
    wide = parse_model(f"{name}:{kind.domain}", "A map")
    narrow = parse_model(f"{name}:{kind.tables[0]}", "Curves")
    main = next(iter(narrow.sweep))
    return one_sweep(narrow, main), one_sweep(wide, main)


def one_sweep(spec: ModelSpec, main: str) -> ModelSpec:
    """The same with one sweep, the main one if it has that; others stay at the model's defaults."""
    key = main if main in spec.sweep else next(iter(spec.sweep))
    return ModelSpec(spec.name, spec.fixed, {key: spec.sweep[key]})


def thinned(spec: ModelSpec, most: int) -> ModelSpec:
    """So many values of the sweep at most, the ends among them."""
    ((key, values),) = spec.sweep.items()
    which = np.unique(np.linspace(0, len(values) - 1, min(most, len(values))).round().astype(int))
    taken = [values[k] for k in which]
    few = np.array(taken) if isinstance(values, np.ndarray) else tuple(taken)
    return ModelSpec(spec.name, spec.fixed, {key: few})


def measure(spec: ModelSpec, cosines: np.ndarray, rtol: float) -> Sweep:
    """Albedos of all models of a sweep over all cosines, in one batch."""
    ((key, values),) = spec.sweep.items()
    # Where the colours of a model have channels, its first stands for it.
    models = [model.by_channel()[0] for model in spec.models()]
    each = [model for model in models for _ in cosines]
    along = np.tile(cosines, len(models))
    found = albedo_rows(each, along, np.zeros(along.size), rtol=rtol, atol=1e-12)
    name, numbers = key, np.asarray(values) if isinstance(values, np.ndarray) else None
    if numbers is None:
        # Of vectors the last entry of the first is named: the exponent of a lobe.
        declared = {item.name: item for item in type(models[0]).parameter_info()}[key]
        assert isinstance(declared, Vectors)
        name, numbers = declared.entries[-1][0], np.array([v[0][-1] for v in values])
    labels = [f"{name} = {number:.3g}" for number in numbers]
    return Sweep(name, labels, numbers, models, cosines, found)


def changes_beyond(curves: Sequence[Sweep]) -> bool:
    """Whether an albedo changes by more than a line's width beyond the axis of angles."""
    linear, grazing = curves
    beyond = grazing.cosines < np.cos(np.radians(STEEP))
    moved = np.abs(grazing.albedos[:, beyond] - linear.albedos[:, -1:])
    return bool(np.any(moved > 0.02))


def exceeds(found: Sequence[Sweep]) -> bool:
    """Whether an albedo is above one by more than its bound."""
    return any(bool(np.any(one.albedos - one.errors > 1.0)) for one in found)


def as_frame(found: Sequence[Sweep]) -> pd.DataFrame:
    """One row for every model and angle."""
    frames = []
    for one in found:
        count = len(one.cosines)
        cosines = np.tile(one.cosines, len(one.models))
        frames.append(
            pd.DataFrame(
                {
                    one.parameter: np.repeat(one.values, count),
                    "theta_deg": np.degrees(np.arccos(cosines)),
                    "cos_theta": cosines,
                    "albedo": one.found.value,
                    "albedo_error": one.found.error,
                }
            )
        )
    return pd.concat(frames, ignore_index=True)


# Promises ----------------------------------------------------------------------------------------


def promised(models: Sequence[Model], name: str) -> tuple[str, np.ndarray]:
    """How many of the models promise something, in words, and which are held to it."""
    made = np.array([bool(getattr(model, name)) for model in models])
    said = "yes" if made.all() else "no" if not made.any() else f"{made.sum()} of {made.size} sets"
    return said, made if made.any() else np.ones(made.size, dtype=bool)


def verdict(said: str, sure: bool, broken: bool) -> str:
    """Whether a promise is kept; the error of what was measured counts against certainty."""
    if said == "no":
        return "not promised"
    return "yes" if sure else "no" if broken else "within the bound"


def reciprocity(models: Sequence[Model], pairs: int) -> dict[str, Any]:
    """The worst of random pairs of directions."""
    said, held = promised(models, "reciprocal")
    asked = [model for model, use in zip(models, held, strict=True) if use]
    worst = max(asymmetry(model, SEED, pairs) for model in asked)
    kept = verdict(said, worst <= RECIPROCAL, worst > RECIPROCAL)
    return {"promised": said, "asymmetry": worst, "kept": kept}


def energy(found: Sequence[Sweep]) -> dict[str, Any]:
    """The largest albedo of everything that was computed, and of what promises at most 1."""
    models = [model for one in found for model in one.models]
    said, held = promised(models, "conserves_energy")
    value = np.concatenate([one.found.value for one in found])
    error = np.concatenate([one.found.error for one in found])
    use = np.repeat(held, [len(one.cosines) for one in found for _ in one.models])
    label = [text for one in found for text in one.labels for _ in one.cosines]
    cosine = np.concatenate([np.tile(one.cosines, len(one.models)) for one in found])
    top, asked = int(np.argmax(value)), int(np.argmax(np.where(use, value, -np.inf)))
    # Of places that cannot be told apart the first is named, on every machine the same.
    at = int(np.flatnonzero(value + error >= value[top] - error[top])[0])
    sure = bool(np.all(value[use] <= 1.0 + error[use]))
    return {
        "promised": said,
        "largest": value[top],
        "largest_error": error[top],
        "at": label[at],
        "cos_theta": cosine[at],
        "of_promises": math.nan if said == "no" else value[asked],
        "of_promises_error": math.nan if said == "no" else error[asked],
        "kept": verdict(said, sure, not sure),
    }


def horizon(models: Sequence[Model], rtol: float) -> dict[str, Any]:
    """How much the albedo grows over the last three decades, at most."""
    said, held = promised(models, "grazing_limit")
    asked = [model for model, use in zip(models, held, strict=True) if use]
    ends = []
    for cosine in (NEAR, NEARER):
        along = np.full(len(asked), cosine)
        ends.append(albedo_rows(asked, along, np.zeros(along.size), rtol=rtol, atol=0.0))
    (near, near_error), (far, far_error) = ((end.value, end.error) for end in ends)
    dark = far <= far_error
    low = np.maximum(near - near_error, np.finfo(float).tiny)
    growth = np.where(dark, 0.0, far / np.where(near > 0.0, near, 1.0))
    error = np.where(dark, 0.0, (far_error + growth * near_error) / low)
    top = int(np.argmax(growth))
    value, bound = float(growth[top]), float(error[top])
    kept = verdict(said, value + bound <= GROWTH, value - bound > GROWTH)
    return {"promised": said, "growth": value, "growth_error": bound, "kept": kept}


# Figures -----------------------------------------------------------------------------------------

# Inches: 28 figures with panels of one size need no search for a layout.
WIDTH, PANEL, LEFT, GAP, BAR = 8.15, (2.85, 2.1), 0.72, 0.82, 0.13
TOP, BELOW, LEGEND = 0.12, 0.55, 0.42


def draw(name: str, curves: Sequence[Sweep], maps: Sequence[Sweep]) -> Figure:
    """Curves and maps side by side, and towards the horizon below where that matters."""
    height = TOP + len(curves) * (PANEL[1] + BELOW) + LEGEND
    with plotting.style():
        figure, _ = plotting.new_figure(0, WIDTH, height)
        figure.set_layout_engine("none")
        above = exceeds(maps)
        for row, (lines, field) in enumerate(zip(curves, maps, strict=True)):
            bottom = height - TOP - (row + 1) * PANEL[1] - row * BELOW
            left, right = (
                figure.add_axes((x / WIDTH, bottom / height, PANEL[0] / WIDTH, PANEL[1] / height))
                for x in (LEFT, LEFT + PANEL[0] + GAP)
            )
            drawn = [
                plotting.Curve(label, name, lines.cosines, value, error, (lines.parameter, number))
                for label, value, error, number in zip(
                    lines.labels, lines.albedos, lines.errors, lines.values.tolist(), strict=True
                )
            ]
            plotting.draw_axes(left, drawn, grazing=row == 1)
            image = draw_map(right, field, above=above, grazing=row == 1)
            for axes in (left, right):
                sparse(axes, row == 1)
                axes.set_xlabel("cosine of the angle" if row else "angle of incidence (degrees)")
        figure.legend(
            *left.get_legend_handles_labels(),
            loc="lower center",
            ncols=len(drawn),
            handlelength=2.6,
            columnspacing=1.4,
        )
        edge = LEFT + 2 * PANEL[0] + GAP + 0.12
        bottom, tall = height - TOP - PANEL[1], PANEL[1]
        place = (edge / WIDTH, bottom / height, BAR / WIDTH, tall / height)
        bar = figure.colorbar(
            image, cax=figure.add_axes(place), extend="max" if above else "neither"
        )
        bar.set_ticks(np.linspace(0.0, MOST if above else 1.0, 5))
        bar.set_label("directional albedo")
        bar.outline.set_visible(False)
    return figure


def sparse(axes: Axes, grazing: bool) -> None:
    """Few ticks: every one of them costs as much as a curve."""
    from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator

    for axis in (axes.xaxis, axes.yaxis):
        if axis.get_scale() == "log":
            axis.set_major_locator(LogLocator(numticks=5))
            axis.set_minor_locator(NullLocator())
        else:
            axis.set_major_locator(MaxNLocator(5))
    if not grazing:
        axes.set_xlim(0.0, 90.0)
        axes.set_xticks(np.arange(0.0, 91.0, 30.0))


def draw_map(axes: Axes, field: Sweep, *, above: bool, grazing: bool) -> Any:
    """The albedo as a colour; what is above one beyond its bound is warm."""
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap, Normalize

    # What may be one by its bound is no finding.
    sure = field.albedos - field.errors > 1.0
    shown = np.where(sure, field.albedos, np.minimum(field.albedos, 1.0))
    look: Any = colormaps["viridis"]
    if above:
        warm = colormaps["OrRd"](np.linspace(0.4, 1.0, 256))
        look = ListedColormap(np.concatenate((look(np.linspace(0.0, 0.96, 256)), warm)))
        look = look.with_extremes(over="#4a0000")
    across = field.cosines if grazing else np.degrees(np.arccos(field.cosines))
    image = axes.pcolormesh(
        *(across, field.values, shown),
        norm=Normalize(0.0, MOST if above else 1.0),
        cmap=look,
        shading="nearest",
        # Cells as paths would outweigh everything else in the file.
        rasterized=True,
    )
    low, high = float(field.values.min()), float(field.values.max())
    if low > 0.0 and high / low > 50.0:
        axes.set_yscale("log")
    axes.set_ylim(low, high)
    if grazing:
        axes.set_xscale("log")
        axes.set_xlim(1.0, float(field.cosines.min()))
    axes.set_ylabel(field.parameter)
    axes.grid(visible=False)
    return image
