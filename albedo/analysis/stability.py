"""How many digits of a BRDF are right: in float64, in float32, and from raw directions.

Every value is compared with the same formula in 50 digits at exact directions; see
`albedo.analysis.precise`. Three ways to it are measured:

* ``float64``: the kernel, given directions and their sum h as a chart knows them, each component
  rounded once, as integrals have them;
* ``raw``: `Model.eval` on the rounded directions alone, from which h has to be formed, compared
  with the exact value *there*;
* ``float32``: the formula with every operation and all that goes into it in single precision.

Directions are special places (V = R, V = L, V = N, grazing ones) and places about the mirror
direction, in terms of the width of the lobe, for incidences from the normal to cos = 1e-12.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from albedo.analysis.precise import Arithmetic, evaluate, precise, single
from albedo.brdf import Model
from albedo.errors import InputError
from albedo.grammar import ModelSpec, format_spec, parse_model

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

COSINES = (1.0, 0.99, 0.7, 0.3, 0.1, 1e-2, 1e-3, 1e-4, 1e-6, 1e-9, 1e-12)
"""Cosines of the angle of incidence."""
SETS = (9, 4, 3)
"""Most values of a parameter where one, two, or more are swept."""
WAYS = ("float64", "raw", "float32")
LAST = ("place", "value", *WAYS, *(f"{way}_not_finite" for way in WAYS))
"""The last columns of what `measure` gives; before them stands what was varied."""

_TITLES = {"float64": "float64", "raw": "float64 from raw directions", "float32": "float32"}
FULL = {"float64": -math.log10(2.0**-53), "raw": -math.log10(2.0**-53)}
FULL["float32"] = -math.log10(2.0**-24)
"""All digits there are: half a unit in the last place."""
RANGE = {"float64": (2.0**-1000, 2.0**1023), "raw": (2.0**-1000, 2.0**1023)}
RANGE["float32"] = (2.0**-120, 2.0**127)
"""Below the first, numbers lose digits because they are denormal, or are 0; above the second there
are none."""
OFFSETS = ((0.5, 0.0), (0.0, 0.5), (-1.0, 1.0), (2.5, 0.0))
"""Near the mirror direction: slopes of H along and across L, in widths of the lobe."""
_GRAZING = 1e-9


@dataclass(frozen=True)
class Geometry:
    """Exact directions of one incidence, at all places.

    Attributes
    ----------
    places : list of str
    wi, wo, h : ndarray of numbers, shape (n, 3)
    """

    places: list[str]
    wi: np.ndarray
    wo: np.ndarray
    h: np.ndarray


@dataclass(frozen=True)
class ExactFrame:
    """Light with a cosine and an azimuth, and directions that are told from there.

    Attributes
    ----------
    arithmetic : Arithmetic
    cosine : float
        Cosine of the angle of incidence, in (0, 1].
    turn : float
        Azimuth of the light, radians.
    """

    arithmetic: Arithmetic
    cosine: float
    turn: float

    def turned(self, x: Any, y: Any, z: Any) -> np.ndarray:
        """A direction along the light's azimuth, across it, and along the normal."""
        f, turn = self.arithmetic.functions, self.arithmetic.number(self.turn)
        cos_turn, sin_turn = f["cos"](turn), f["sin"](turn)
        return np.array([x * cos_turn - y * sin_turn, x * sin_turn + y * cos_turn, z], object)

    @property
    def _cosine_sine(self) -> tuple[Any, Any]:
        z = self.arithmetic.number(self.cosine)
        return z, self.arithmetic.functions["sqrt"]((1 - z) * (1 + z))

    @property
    def light(self) -> np.ndarray:
        """L."""
        z, s = self._cosine_sine
        return self.turned(s, self.arithmetic.number(0.0), z)

    def about(self, x: float, y: float) -> np.ndarray:
        """V for slopes of H along the light's azimuth and across; it may lie below the horizon."""
        z, s = self._cosine_sine
        a, b = self.arithmetic.number(x), self.arithmetic.number(y)
        root = self.arithmetic.functions["sqrt"](1 + a * a + b * b)
        l_h = (s * a + z) / root
        return self.turned(2 * l_h * a / root - s, 2 * l_h * b / root, 2 * l_h / root - z)

    def beside(self, cosine: float, azimuth: float) -> np.ndarray:
        """V with a cosine, and an azimuth counted from the light's, radians."""
        f = self.arithmetic.functions
        z, phi = self.arithmetic.number(cosine), self.arithmetic.number(azimuth)
        s = f["sqrt"]((1 - z) * (1 + z))
        return self.turned(s * f["cos"](phi), s * f["sin"](phi), z)


def exact_places(
    arithmetic: Arithmetic,
    c: float,
    turn: float,
    widths: tuple[float, float],
    grazing: Iterable[float] = (_GRAZING,),
) -> Geometry:
    """All places for light with a cosine and an azimuth, about a lobe of some widths."""
    frame = ExactFrame(arithmetic, c, turn)
    zero, one = arithmetic.number(0.0), arithmetic.number(1.0)
    found = {
        "mirror": frame.about(0.0, 0.0),
        "retro": frame.light,
        "normal": frame.turned(zero, zero, one),
    }
    for number in grazing:
        low = arithmetic.number(number)
        flat = arithmetic.functions["sqrt"]((1 - low) * (1 + low))
        said = "" if number == _GRAZING else f", {number:g}"
        found[f"grazing ahead{said}"] = frame.turned(-flat, zero, low)
        found[f"grazing aside{said}"] = frame.turned(zero, flat, low)
        found[f"grazing behind{said}"] = frame.turned(flat, zero, low)
    for x, y in OFFSETS:
        found[f"H at ({x:g}, {y:g}) widths"] = frame.about(x * widths[0], y * widths[1])
    kept = {name: v for name, v in found.items() if v[2] > 0}
    wi = np.stack([frame.light] * len(kept))
    wo = np.stack(list(kept.values()))
    return Geometry(list(kept), wi, wo, wi + wo)


def values_with_sums(model: Model, wi: np.ndarray, wo: np.ndarray, h: np.ndarray) -> np.ndarray:
    """Values of the kernels in float64 for directions whose sum is known.

    A function of one's own forms what it wants, and may be infinite here.
    """
    if function := vars(model).get("function"):
        with np.errstate(all="ignore"):
            return np.asarray(function(wi, wo), dtype=np.float64)
    return model.finite_part(wi, wo, h)


def values_of_directions(model: Model, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    """Values in float64 for directions alone."""
    own = "function" in vars(model)
    return values_with_sums(model, wi, wo, wi + wo) if own else model.eval(wi, wo)


def digits(value: np.ndarray, exact: np.ndarray, way: str) -> np.ndarray:
    """Right digits of values: NaN where an exact one is out of the range of the arithmetic.

    Parameters
    ----------
    value : ndarray, shape (n,)
    exact : ndarray of numbers, shape (n,)
    way : str
        One of `WAYS`.

    Returns
    -------
    ndarray, shape (n,)
        Between 0 and all that there are; 0 where a value is not finite.
    """
    found = np.full(len(value), math.nan)
    low, high = RANGE[way]
    for k, (got, true) in enumerate(zip(value, exact, strict=True)):
        if not abs(true) >= low:
            # Nothing is to be right about 0 but that it is small.
            small = math.isfinite(got) and abs(got) <= 2.0 * low
            found[k] = math.nan if small or true != true else 0.0
        elif abs(true) > high:
            continue
        elif not math.isfinite(got):
            found[k] = 0.0
        else:
            off = float(abs(type(true)(float(got)) - true) / abs(true))
            right = -math.log10(off) if off > 0.0 else math.inf
            found[k] = min(max(right, 0.0), FULL[way])
    return found


def thinned(spec: ModelSpec) -> ModelSpec:
    """The same sweeps with a few values each (`SETS`), the first and the last among them."""
    sweep: dict[str, Any] = {}
    most = SETS[min(len(spec.sweep), len(SETS)) - 1]
    for name, values in spec.sweep.items():
        even = np.linspace(0, len(values) - 1, min(most, len(values)))
        which = np.unique(even.round()).astype(int)
        taken = [values[k] for k in which]
        sweep[name] = np.array(taken) if isinstance(values, np.ndarray) else tuple(taken)
    return ModelSpec(spec.name, spec.fixed, sweep)


def swept(text: str) -> ModelSpec:
    """What a model in the grammar asks for: its sweeps, or the domain that it declares, thinned.

    A model that is all Dirac parts by default is looked at with the lobes that it declares.

    Raises
    ------
    InputError
        For sums of models and what is no model.
    """
    from albedo.analysis.energy import domain
    from albedo.catalogue import model_class

    spec = parse_model(text, "A count of digits")
    kind = model_class(spec.name)
    if not spec.sweep and not spec.fixed and kind.as_lobes:
        return thinned(parse_model(f"{spec.name}:{kind.as_lobes}", "A count of digits"))
    if not spec.sweep and (spec.fixed or not kind.domain):
        return spec
    return thinned(domain(text))


def named_models(spec: ModelSpec) -> list[tuple[dict[str, Any], Model]]:
    """All models of a spec, each by its swept parameters; the first channel of colours."""
    found = []
    for values in spec.assignments():
        one = ModelSpec(spec.name, {**spec.fixed, **values})
        found.append((dict(values), one.model().by_channel()[0]))
    return found


def title_of(spec: ModelSpec) -> str:
    """A model, what is fixed, and from where to where the rest goes."""
    ranges = [
        f"{name} = {values[0]:g} to {values[-1]:g}" if isinstance(values, np.ndarray) else name
        for name, values in spec.sweep.items()
    ]
    return ", ".join((format_spec(spec.name, spec.fixed), *ranges))


def numbers_of(spec: ModelSpec) -> list[str]:
    """The swept parameters that are numbers."""
    return [name for name, values in spec.sweep.items() if isinstance(values, np.ndarray)]


def measure(
    models: Iterable[tuple[dict[str, Any], Model]],
    *,
    cosines: Iterable[float] = COSINES,
    progress: Callable[[int, int], None] | None = None,
) -> pd.DataFrame:
    """Count the right digits of models at all places.

    Parameters
    ----------
    models : iterable of (dict, Model)
        What each is called by, such as its swept parameters, and the model, with one channel.
    cosines : iterable of float
        Cosines of the angle of incidence, in (0, 1].
    progress : callable, optional
        Called with models done and models in all.

    Returns
    -------
    pandas.DataFrame
        One row for every model, cosine and place: what the model is called by, ``cos_theta``,
        ``phi_deg``, ``place``, the exact ``value`` in 1/sr, the digits of each of `WAYS`, and
        whether it is ``_not_finite`` though its exact value is in range.

    Raises
    ------
    InputError
        For models that are no kernels of plain arithmetic, and for those that are all Dirac parts.
    """
    import pandas as pd

    exact, short = precise(), single()
    models = list(models)
    frames = []
    for done, (names, model) in enumerate(models):
        if progress is not None:
            progress(done, len(models))
        if not model.parts():
            raise InputError(f"{model.spec} is all Dirac parts: no value of it has digits to count")
        wx, wy = (min(w, 1.0) for w in model.parts()[0].widths)
        # Anisotropic lobes are looked at beside their axes too.
        turns = (0.0,) if model.isotropic else (0.0, 0.6, 0.5 * math.pi)
        for c in cosines:
            for turn in turns:
                across = math.hypot(wx * math.cos(turn), wy * math.sin(turn))
                beside = math.hypot(wx * math.sin(turn), wy * math.cos(turn))
                geometry = exact_places(exact, c, turn, (across, beside))
                frame = pd.DataFrame(
                    {"place": geometry.places, **count_ways(model, geometry, short)}
                )
                frame.insert(0, "phi_deg", math.degrees(turn))
                frame.insert(0, "cos_theta", c)
                for name, value in reversed(names.items()):
                    frame.insert(0, name, value)
                frames.append(frame)
    if progress is not None:
        progress(len(models), len(models))
    return pd.concat(frames, ignore_index=True)


def count_ways(model: Model, geometry: Geometry, short: Arithmetic) -> dict[str, np.ndarray]:
    """The exact values, and the digits of all ways."""
    exact = precise()
    vectors = geometry.wi, geometry.wo, geometry.h
    true = evaluate(model, exact, *vectors)
    plain = [v.astype(np.float64) for v in vectors]
    at_rounded = evaluate(model, exact, *exact_directions(plain[0], plain[1]))
    wi, wo, h = (short.array(v) for v in plain)
    in_short = evaluate(model, short, wi, wo, h)
    ways = {
        "float64": (values_with_sums(model, *plain), true),
        "raw": (values_of_directions(model, plain[0], plain[1]), at_rounded),
        "float32": (in_short.astype(np.float64), true),
    }
    found = {way: digits(*values, way) for way, values in ways.items()}
    for way, (got, right) in ways.items():
        high = RANGE[way][1]
        in_range = np.array([bool(abs(x) <= high) for x in right])
        found[f"{way}_not_finite"] = ~np.isfinite(got) & in_range
    return {"value": true.astype(np.float64), **found}


def exact_directions(wi: np.ndarray, wo: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What raw directions say, taken at their word but for their lengths, and their sums."""
    exact = precise()
    light, view = exact.array(wi), exact.array(wo)
    for v in (light, view):
        for k in range(len(v)):
            v[k] = v[k] / exact.functions["sqrt"](sum(x * x for x in v[k]))
    return light, view, light + view


def not_finite(frame: pd.DataFrame) -> dict[str, int]:
    """How many values of each way are NaN or infinite, though the exact ones are in its range."""
    counts = {way: int(frame[f"{way}_not_finite"].sum()) for way in WAYS}
    return {way: count for way, count in counts.items() if count}


def worst(frame: pd.DataFrame) -> pd.DataFrame:
    """For every way, the row with the fewest digits, the median of all, and what is missing.

    Returns
    -------
    pandas.DataFrame
        One row for every way: ``way``, ``median`` digits, ``worst`` digits, ``lost``, which is all
        that the arithmetic has less those, and the columns of the row where it is worst.
    """
    import pandas as pd

    rows = []
    for way in WAYS:
        if frame[way].notna().any():
            at = frame.loc[frame[way].idxmin()].drop([*LAST[2:]])
            least = float(frame[way].min())
            numbers = {"way": way, "median": float(frame[way].median()), "worst": least}
            rows.append({**numbers, "lost": FULL[way] - least, **at})
    return pd.DataFrame(rows)


def draw(frame: pd.DataFrame, swept: str, title: str) -> Figure:
    """The fewest digits of all places over a swept parameter and cos_theta, way by way.

    Parameters
    ----------
    frame : DataFrame
        What `measure` gives, with a column of numbers `swept`.
    swept : str
        Name of the parameter.
    title : str

    Returns
    -------
    Figure
    """
    from albedo.plotting import new_figure, style

    with style():
        figure, panels = new_figure(len(WAYS), width=9.6, height=3.9)
        figure.suptitle(title, x=0.01, ha="left", fontsize=10.5)
        for axes, way in zip(panels, WAYS, strict=True):
            field = frame.pivot_table(
                index="cos_theta", columns=swept, values=way, aggfunc="min", dropna=False
            ).sort_index(ascending=False)
            z = field.to_numpy()
            image = axes.imshow(z, aspect="auto", vmin=0.0, vmax=FULL[way], cmap="viridis")
            for row, column in np.ndindex(z.shape):
                if np.isfinite(z[row, column]):
                    dark = z[row, column] < 0.6 * FULL[way]
                    axes.text(
                        *(column, row, f"{z[row, column]:.0f}"),
                        ha="center",
                        va="center",
                        fontsize=7.5,
                        color="white" if dark else "black",
                    )
            axes.grid(visible=False)
            axes.set_xticks(range(z.shape[1]), [f"{x:.2g}" for x in field.columns], rotation=60)
            axes.set_yticks(range(z.shape[0]), [f"{c:g}" for c in field.index])
            axes.set_xlabel(swept)
            axes.set_title(_TITLES[way], loc="left")
            bar = figure.colorbar(image, ax=axes, shrink=0.9)
        bar.set_label("right digits, fewest of all places")
        panels[0].set_ylabel("cosine of the angle of incidence")
        for axes in panels[1:]:
            axes.set_yticklabels([])
    return figure
