"""Where a model reflects more than it receives: its largest and smallest albedo, over its domain.

For every set of parameters the albedo is measured on a grid of directions from normal incidence to
`GRAZING`, and its largest and smallest values are closed in on along the angle of incidence. What
is reported is measured at the direction that is named beside it: the largest albedo of the model
is at least that, and near it where the albedo is smooth between the directions of the grid.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from albedo.brdf import Model
from albedo.errors import InputError
from albedo.estimate import Estimate
from albedo.grammar import ModelSpec, parse_model
from albedo.quadrature import albedo_rows

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

GRAZING = 1e-9
"""The smallest cosine of the angle of incidence that a map looks at."""

# Colours stand for albedos down to this share of the largest.
_FAINT = 1e-12

AZIMUTHS = 5
"""Azimuths from 0 to 90 degrees, for anisotropic models."""

# Steps of two degrees down to 88, then three to a decade.
_GRID = np.concatenate(
    (np.cos(np.radians(np.arange(0.0, 89.0, 2.0))), np.geomspace(1e-2, GRAZING, 22))
)
_ROUNDS, _STEPS = 3, 5
_BATCH = 512
MOST = 1_000_000
"""Most sets of parameters in one map."""


@dataclass(frozen=True)
class EnergyMap:
    """The largest and smallest albedo for every set of parameters.

    Attributes
    ----------
    spec : ModelSpec
        What was swept.
    frame : pandas.DataFrame
        One row for every set (and every channel of colours): the swept parameters, and for each
        of ``max`` and ``min`` the albedo, its bound, and the direction (cos_theta, and phi in
        radians); ``exceeds_one`` is ``yes``, ``no``, or ``within the bound`` where the largest
        albedo cannot be told from 1; ``diverges`` says that it grows without limit towards the
        horizon.
    """

    spec: ModelSpec
    frame: pd.DataFrame


def domain(text: str) -> ModelSpec:
    """The sets of parameters that a map of a model goes through.

    Parameters
    ----------
    text : str
        A model in the grammar. Where it sweeps nothing, the domain that the model declares is
        swept, except for what is given.

    Returns
    -------
    ModelSpec
        With at least one sweep.

    Raises
    ------
    InputError
        When nothing is left to sweep, and for sums of models.
    """
    from albedo.catalogue import model_class

    spec = parse_model(text, "A map")
    if spec.sweep:
        return spec
    kind = model_class(spec.name)
    declared = parse_model(f"{spec.name}:{kind.domain}", "A map")
    taken = _targets(kind, spec.fixed)
    sweep = {k: v for k, v in declared.sweep.items() if not _targets(kind, (k,)) & taken}
    if not sweep:
        raise InputError(
            f"'{text}' leaves nothing to sweep; give a sweep, such as {spec.name}:{kind.domain}."
        )
    return ModelSpec(spec.name, {**declared.fixed, **spec.fixed}, sweep)


def _targets(kind: type[Model], names: Any) -> set[str]:
    """The parameters that these names set."""
    info = {q.name: q for q in kind.parameter_info()}
    return {t for name in names for t in getattr(info.get(name), "targets", (name,))}


def energy_map(
    spec: ModelSpec,
    rtol: float = 1e-6,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> EnergyMap:
    """Measure the largest and the smallest albedo of every model that a spec names.

    Parameters
    ----------
    spec : ModelSpec
        A model with its sweeps; see `domain`.
    rtol : float
        The relative error of every albedo.
    progress : callable, optional
        Called as ``progress(done, total)`` with counts of sets.

    Returns
    -------
    EnergyMap
        The map.

    Raises
    ------
    InputError
        For input out of range.
    """
    import pandas as pd

    if spec.count > MOST:
        raise InputError(f"'{spec}' names {spec.count} models; a map has at most {MOST}.")
    built = list(zip(spec.assignments(), spec.models(), strict=True))
    sets = [
        (values, None if one is model else number, one)
        for values, model in built
        for number, one in enumerate(model.by_channel())
    ]
    per_batch = max(1, _BATCH // _GRID.size)
    rows: list[dict[str, Any]] = []
    for first in range(0, len(sets), per_batch):
        batch = sets[first : first + per_batch]
        found = _extremes([model for *_, model in batch], rtol)
        for k, (values, number, model) in enumerate(batch):
            row: dict[str, Any] = dict(values)
            if number is not None:
                row["channel"] = number
            for name, extreme in zip(("max", "min"), found, strict=True):
                value, error, cosine, phi = (float(column[k]) for column in extreme)
                row |= {f"{name}_albedo": value, f"{name}_albedo_error": error}
                row |= {f"{name}_cos_theta": cosine, f"{name}_phi": phi}
            row["exceeds_one"] = verdict(row["max_albedo"], row["max_albedo_error"])
            row["diverges"] = not model.grazing_limit
            rows.append(row)
        if progress is not None:
            progress(min(first + per_batch, len(sets)), len(sets))
    return EnergyMap(spec, pd.DataFrame(rows))


def verdict(value: float, error: float) -> str:
    """Whether an albedo exceeds 1: ``yes``, ``no``, or ``within the bound``."""
    if value - error > 1.0:
        return "yes"
    return "no" if value + error < 1.0 else "within the bound"


class _Search:
    """The largest albedo of every model (or with sign -1 the smallest) among those looked at."""

    def __init__(self, count: int, sign: float) -> None:
        self.sign = sign
        self.best = np.full(count, -np.inf)
        self.error, self.place, self.phi = np.zeros(count), np.zeros(count), np.zeros(count)

    def take(self, which: np.ndarray, place: np.ndarray, phi: np.ndarray, found: Estimate) -> None:
        score = self.sign * found.value
        order = np.lexsort((score, which))
        last = order[np.append(which[order][1:] != which[order][:-1], True)]
        last = last[score[last] > self.best[which[last]]]
        own = which[last]
        self.best[own], self.error[own] = score[last], found.error[last]
        self.place[own], self.phi[own] = place[last], phi[last]


def _extremes(
    models: Sequence[Model], rtol: float
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Largest and smallest albedo of every model, with its bound and its direction."""
    places = np.arange(_GRID.size, dtype=float)
    searches = [_Search(len(models), sign) for sign in (1.0, -1.0)]

    def look(
        which: np.ndarray, place: np.ndarray, phi: np.ndarray, whose: Sequence[_Search]
    ) -> None:
        cosine = np.interp(place, places, _GRID)
        several = [models[i] for i in which]
        found = albedo_rows(several, cosine, phi, rtol=rtol, atol=1e-3 * rtol)
        for search in whose:
            search.take(which, place, phi, found)

    turned = np.flatnonzero([not m.isotropic for m in models])
    for k, azimuth in enumerate(np.linspace(0.0, 0.5 * np.pi, AZIMUTHS)):
        some = turned if k else np.arange(len(models))
        if some.size:
            which = np.repeat(some, places.size)
            look(which, np.tile(places, some.size), np.full(which.size, azimuth), searches)
    reach = 1.0
    for _ in range(_ROUNDS):
        steps = np.linspace(-reach, reach, 2 * _STEPS + 1)
        for search in searches:
            place = np.clip(search.place[:, None] + steps, 0.0, places[-1]).ravel()
            which = np.repeat(np.arange(len(models)), steps.size)
            look(which, place, search.phi[which], [search])
        reach /= _STEPS
    return [(s.sign * s.best, s.error, np.interp(s.place, places, _GRID), s.phi) for s in searches]


def draw(found: EnergyMap) -> Figure:
    """Draw a map: curves over one swept number, or two coloured fields over two.

    Parameters
    ----------
    found : EnergyMap
        The map.

    Returns
    -------
    Figure
        Where the largest albedo exceeds 1 it is marked.

    Raises
    ------
    InputError
        When not exactly one or two numbers are swept.
    """
    numbers = drawn_over(found.spec)
    return _curves(found, numbers[0]) if len(numbers) == 1 else _fields(found, *numbers)


def drawn_over(spec: ModelSpec) -> list[str]:
    """The one or two swept numbers over which a map is drawn.

    Raises
    ------
    InputError
        When something else is swept.
    """
    numbers = [key for key, values in spec.sweep.items() if isinstance(values, np.ndarray)]
    if len(numbers) != len(spec.sweep) or len(numbers) > 2:
        raise InputError(f"'{spec}' cannot be drawn: a map is over one or two swept numbers.")
    return numbers


def _is_log(values: np.ndarray) -> bool:
    return bool(values.min() > 0.0 and values.max() / values.min() > 50.0)


def _curves(found: EnergyMap, name: str) -> Figure:
    from albedo.plotting import _BLUE, _VERMILION, add_legend, new_figure, style

    with style():
        figure, (axes,) = new_figure()
        groups = (
            found.frame.groupby("channel") if "channel" in found.frame else [(None, found.frame)]
        )
        for channel, frame in groups:
            ending = "" if channel is None else f", channel {channel}"
            x, top, low = frame[name], frame["max_albedo"], frame["min_albedo"]
            shade = 1.0 if channel is None else 1.0 - 0.25 * float(channel)
            axes.plot(x, top, color=_VERMILION, alpha=shade, label=f"largest albedo{ending}")
            axes.plot(x, low, "--", color=_BLUE, alpha=shade, label=f"smallest albedo{ending}")
            over = (frame["exceeds_one"] == "yes").to_numpy()
            if over.any():
                label = None if ending and channel else "exceeds 1"
                axes.plot(x[over], top[over], "o", ms=3.5, color=_VERMILION, label=label)
        axes.axhline(1.0, color="#888888", linewidth=0.9, zorder=1.5)
        if _is_log(found.frame[name].to_numpy()):
            axes.set_xscale("log")
        _scale_values(axes, found.frame)
        axes.set_xlabel(_label(found, name))
        axes.set_ylabel("directional albedo")
        axes.set_title(_title(found), loc="left")
        add_legend(figure, axes)
    return figure


def _scale_values(axes: Any, frame: pd.DataFrame) -> None:
    low, high = frame["min_albedo"].min(), frame["max_albedo"].max()
    if high > 5.0:
        positive = frame["min_albedo"][frame["min_albedo"] > 0.0]
        floor = max(positive.min() if len(positive) else 1e-3, 1e-6 * high, 1e-6)
        axes.set_yscale("log")
        axes.set_ylim(min(floor, 0.5) / 1.3, high * 1.6)
    else:
        axes.set_ylim(min(0.0, 1.05 * low), 1.06 * max(high, 1.0))


def _label(found: EnergyMap, name: str) -> str:
    from albedo.catalogue import model_class

    info = {q.name: q for q in model_class(found.spec.name).parameter_info()}[name]
    unit = "" if info.unit == "1" else f" ({info.unit})"
    return f"{name}{unit}: {info.doc}"


def _title(found: EnergyMap) -> str:
    """What is kept fixed, and that the top of a curve may not be its top."""
    from albedo.grammar import format_spec

    title = format_spec(found.spec.name, found.spec.fixed)
    if found.frame["diverges"].any():
        title += f"   (down to cos θ = {GRAZING:g}; the albedo grows without limit)"
    return title


def _fields(found: EnergyMap, first: str, second: str) -> Figure:
    from matplotlib.colors import LogNorm, Normalize, TwoSlopeNorm

    from albedo.plotting import new_figure, style

    frame = found.frame
    if "channel" in frame:
        frame = frame[frame["channel"] == 0]
    with style():
        figure, panels = new_figure(2, width=8.6, height=4.1)
        figure.suptitle(_title(found), x=0.01, ha="left", fontsize=10.5)
        for axes, column, what in zip(
            panels, ("max_albedo", "min_albedo"), ("largest", "smallest"), strict=True
        ):
            field = frame.pivot(index=second, columns=first, values=column)
            x, y, z = field.columns.to_numpy(), field.index.to_numpy(), field.to_numpy()
            low, top = float(np.nanmin(z)), max(float(np.nanmax(z)), 1.0 + 1e-3)
            if column == "max_albedo":
                start, end = min(low, 0.999), min(top, 3.0)
                norm: Any = TwoSlopeNorm(1.0, start, end)
                # A side that is hardly there is labelled at its end only.
                below, above = (4 if size > 0.01 else 2 for size in (1.0 - start, end - 1.0))
                ticks = [*np.linspace(start, 1.0, below), *np.linspace(1.0, end, above)[1:]]
                beyond = "max" if top > end else "neither"
            else:
                wide = low > 0.0 and top > 50.0 * low
                floor = max(low, _FAINT * top) if wide else low
                norm = (LogNorm if wide else Normalize)(floor, top)
                ticks, beyond = None, "min" if low < floor else "neither"
            look = "PuOr_r" if column == "max_albedo" else "cividis"
            image = axes.pcolormesh(x, y, z, norm=norm, cmap=look, shading="nearest")
            over = (frame["exceeds_one"] == "yes").to_numpy()
            if column == "max_albedo" and over.any():
                some = frame[over]
                axes.plot(some[first], some[second], ".", ms=3, color="#222222", label="exceeds 1")
                axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), borderaxespad=0.2)
            for values, set_scale in ((x, axes.set_xscale), (y, axes.set_yscale)):
                if _is_log(values):
                    set_scale("log")
            axes.grid(False)
            axes.set_xlabel(_label(found, first))
            axes.set_ylabel(_label(found, second))
            bar = figure.colorbar(image, ax=axes, pad=0.02, extend=beyond)
            if ticks is not None:
                bar.set_ticks(ticks, labels=[f"{tick:.4g}" for tick in ticks])
            bar.set_label(f"{what} directional albedo")
            bar.outline.set_visible(False)
    return figure
