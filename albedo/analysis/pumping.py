"""What pumping-up does to a model, step by step: albedos, what is gained, output radiance.

The studies of the figures of Neumann, Neumann and Szirmay-Kalos share this: one series of steps,
its tables, its figures, and the numbers that claims are made of.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from albedo.analysis.radiance import Peak, peak, plane_radiance
from albedo.brdf import Model
from albedo.operators.pump import Pumped, pump
from albedo.plotting import angle_grid, grazing_grid, new_figure, style
from albedo.quadrature import directional_albedo
from albedo.studies import Criterion

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Advance = Callable[[int, int, str], None]

# Closer to normal incidence than this what a few steps leave is less than bounds can tell: every
# albedo is 1 there, and the more steps, the higher the power of the angle with which it falls.
NEAR_NORMAL = math.cos(math.radians(10.0))
# A step is worth its while where the albedo rises by so much: what one sees in a figure.
VISIBLE = 0.01

LOWEST_VIEW = -30.0
"""The first angle of views in the plane of incidence, in degrees: lobes are on the other side."""

PEAK_COSINES = np.concatenate(
    (np.cos(np.radians(np.arange(0.0, 80.0, 2.5))), np.geomspace(0.175, 1e-4, 52))
)
"""Cosines of incidence at, and between, which largest radiances are sought."""

# How near the incidence of the largest of all is come to, in log n.l.
_NEAREST = 1e-10
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)


@dataclass(frozen=True, eq=False)
class Series:
    """A model after 0, 1, 2, ... steps, with its albedos.

    Attributes
    ----------
    stages : tuple of Pumped
        The models.
    cosines : ndarray, shape (n,)
        Cosines of incidence, descending from 1.
    value, error : ndarray, shape (steps + 1, n)
        Albedos and their bounds.
    limit, limit_error : ndarray, shape (steps + 1,)
        Albedos at grazing incidence, in the limit.
    """

    stages: tuple[Pumped, ...]
    cosines: np.ndarray
    value: np.ndarray
    error: np.ndarray
    limit: np.ndarray
    limit_error: np.ndarray

    @property
    def steps(self) -> int:
        """How many steps were made."""
        return len(self.stages) - 1

    def gain(self, step: int, before: int | None = None) -> tuple[np.ndarray, np.ndarray]:
        """What the albedo has risen by, from step `before` (the last one) to a step; bounds."""
        first = step - 1 if before is None else before
        return self.value[step] - self.value[first], self.error[step] + self.error[first]

    def most_gained(self, step: int, before: int) -> Top:
        """The most that the albedo has risen by, at any cosine between those of the series."""
        stage = self.stages[-1]

        def gain(c: float) -> tuple[float, float]:
            later, earlier = (stage.albedo_before(k, c) for k in (step, before))
            return float(later.value - earlier.value), float(later.error + earlier.error)

        return top_of(gain, self.cosines)

    def at(self, cos_theta: float) -> np.ndarray:
        """Places of the incidences that are not above a cosine."""
        return np.flatnonzero(self.cosines <= cos_theta)


def default_cosines(full: bool = True) -> np.ndarray:
    """Cosines for both axes of `albedo.plotting`: degrees, and decades down to 1e-6."""
    degrees, per_decade = angle_grid(), 12
    if not full:
        degrees, per_decade = np.append(degrees[:85:3], degrees[85::5]), 6
    # Eight digits, so that a table says exactly what was computed with.
    both = np.append(degrees, grazing_grid(1e-6, per_decade))
    found: np.ndarray = np.unique([float(f"{c:.8g}") for c in both])[::-1]
    return found


def series(
    base: Model,
    steps: int,
    control: str | None = None,
    *,
    cosines: np.ndarray | None = None,
    rtol: float = 1e-10,
    advance: Advance | None = None,
) -> Series:
    """Pump a model up and measure its albedo before and after every step.

    Parameters
    ----------
    base : Model
        See `albedo.pump`.
    steps, control, rtol
        See `albedo.pump`.
    cosines : ndarray, optional
        Cosines of incidence, descending from 1; those of `default_cosines` unless given.
    advance : callable, optional
        Called as ``advance(done, total, text)``.

    Returns
    -------
    Series
        Its models and albedos.
    """
    cosines = default_cosines() if cosines is None else cosines
    stages = tuple(pump(base, k, control, rtol=rtol) for k in range(steps + 1))
    # The step after the last one has them all.
    whole = pump(base, steps + 1, control, rtol=rtol)
    rows, limits = [], []
    for k, stage in enumerate(stages):
        if advance is not None:
            advance(k, steps + 1, f"albedo after step {k}")
        goal = tolerance(stage, rtol)
        rows.append(whole.albedo_before(k, cosines))
        limits.append(directional_albedo(stage, 0.0, rtol=max(1e-6, goal)))
    return Series(
        *(stages, cosines),
        *(np.array([x.value for x in rows]), np.array([x.error for x in rows])),
        *(np.array([float(x.value) for x in limits]), np.array([float(x.error) for x in limits])),
    )


def tolerance(stage: Model, rtol: float) -> float:
    """What albedos of a stage can be worth: its divisor errs by more than one of its curves."""
    doubts = [part.doubt(None) if callable(part.doubt) else part.doubt for part in stage.parts()]
    return float(max(30.0 * rtol, 3.0 * max(doubts)))


def least(value: np.ndarray, error: np.ndarray) -> tuple[int, float, float]:
    """Where value - error is smallest: the place, and both there."""
    k = int(np.argmin(value - error))
    return k, float(value[k]), float(error[k])


def most(value: np.ndarray, error: np.ndarray) -> tuple[int, float, float]:
    """Where value + error is largest: the place, and both there."""
    k = int(np.argmax(value + error))
    return k, float(value[k]), float(error[k])


def at_most(limit: float) -> Criterion:
    """A criterion for what may be equal to a limit: then no bound can tell it from above."""

    def judge(value: float, error: float) -> str:
        if value + error <= limit:
            return "holds"
        if value - error <= limit:
            return f"holds within the bound, {error:.1e}"
        return "fails"

    return Criterion(f"<= {limit:g}, or equal within the bound", judge)


def worthwhile(data: Series, visible: float = VISIBLE) -> tuple[int, int]:
    """The last step that raises the albedo somewhere by more than is visible; what bounds leave.

    Returns
    -------
    step, doubt : int
        How many later ones the bounds do not exclude.
    """
    sure = possible = 0
    for k in range(1, data.steps + 1):
        gain, error = data.gain(k)
        sure = k if np.any(gain - error > visible) else sure
        possible = k if np.any(gain + error > visible) else possible
    return sure, possible - sure


def albedo_frame(data: Series) -> pd.DataFrame:
    """One row for every angle, and the albedo after every step."""
    import pandas as pd

    columns: dict[str, Any] = {
        "theta_deg": np.degrees(np.arccos(data.cosines)),
        "cos_theta": data.cosines,
    }
    for k in range(data.steps + 1):
        columns[f"step_{k}"] = data.value[k]
        columns[f"step_{k}_error"] = data.error[k]
    return pd.DataFrame(columns)


def steps_frame(data: Series) -> pd.DataFrame:
    """One row for every step: how little and how much it gains, and what is still lost.

    The smallest gain and loss are those from ten degrees on: at normal incidence all is reflected.
    Where they can be told from 0 at every angle beyond one, that is the angle.
    """
    import pandas as pd

    inside = data.at(NEAR_NORMAL)
    theta = np.degrees(np.arccos(data.cosines))
    rows = []
    for k in range(1, data.steps + 1):
        gain, error = data.gain(k)
        low, low_gain, low_error = least(gain[inside], error[inside])
        high, high_gain, high_error = most(gain, error)
        loss, loss_value, loss_error = least(1.0 - data.value[k][inside], data.error[k][inside])
        rows.append(
            {
                "step": k,
                "smallest_gain": low_gain,
                "smallest_gain_error": low_error,
                "smallest_gain_at_deg": theta[inside[low]],
                "largest_gain": high_gain,
                "largest_gain_error": high_error,
                "largest_gain_at_deg": theta[high],
                "smallest_loss": loss_value,
                "smallest_loss_error": loss_error,
                "smallest_loss_at_deg": theta[inside[loss]],
                "above_0_from_deg": _sure_from(
                    theta, np.minimum(gain - error, 1.0 - data.value[k] - data.error[k])
                ),
                "grazing": data.limit[k],
                "grazing_error": data.limit_error[k],
            }
        )
    return pd.DataFrame(rows)


def _sure_from(theta: np.ndarray, low: np.ndarray) -> float:
    """The angle from which on a lower bound is above 0 at every greater one; nan if nowhere."""
    unsure = np.flatnonzero(~(low > 0.0))
    first = unsure[-1] + 1 if unsure.size else 0
    return float(theta[first]) if first < theta.size else math.nan


@dataclass(frozen=True)
class Top:
    """The largest value of a function of the incidence, and where.

    Attributes
    ----------
    cos_theta : float
    value, error : float
        The bound holds what is left between the incidences that were looked at last.
    """

    cos_theta: float
    value: float
    error: float

    @property
    def theta_deg(self) -> float:
        """Angle of incidence in degrees."""
        return math.degrees(math.acos(min(self.cos_theta, 1.0)))

    @property
    def nearby(self) -> float:
        """The cosine to four digits: roundings move the place of a maximum in the eighth."""
        return float(f"{self.cos_theta:.4g}")


def top_of(function: Callable[[float], tuple[float, float]], cosines: np.ndarray) -> Top:
    """The largest value of a function of the incidence between the first cosine and the last.

    Parameters
    ----------
    function : callable
        Value and bound at a cosine.
    cosines : ndarray
        Descending; between two of them is no more than one maximum.
    """
    x = np.log(cosines)
    seen = {float(at): function(float(c)) for at, c in zip(x, cosines, strict=True)}

    def at(place: float) -> float:
        if place not in seen:
            seen[place] = function(math.exp(place))
        return seen[place][0]

    value, error = np.array([seen[float(place)] for place in x]).T
    high, low = (
        choose(np.append(value[1:], end), np.append(end, value[:-1]))
        for choose, end in ((np.maximum, -math.inf), (np.minimum, math.inf))
    )
    # What falls on both sides by less than it is below the best, or errs by, hides no better one.
    peaked = (value >= high) & (2.0 * value - low >= value.max()) & (value - low > error)
    left = 0.0
    for k in np.flatnonzero(peaked).tolist():
        a, b = float(x[min(k + 1, x.size - 1)]), float(x[max(k - 1, 0)])
        while b - a > _NEAREST:
            first, last = b - _GOLDEN * (b - a), a + _GOLDEN * (b - a)
            a, b = (a, last) if at(first) >= at(last) else (first, b)
        left = max(left, *(abs(at(a) - at(end)) for end in (0.5 * (a + b), b)))
    best = max(seen, key=lambda place: seen[place][0])
    found, doubt = seen[best]
    return Top(math.exp(best), found, doubt + left)


@dataclass(frozen=True, eq=False)
class Peaks:
    """The largest output radiances of all steps of a series, in units of that of the base at N.

    Attributes
    ----------
    cosines : ndarray, shape (n,)
        Cosines of incidence.
    found : mapping of int to list of Peak
        For every step, at every cosine.
    unit : Peak
        Of the base, at normal incidence.
    tops : mapping of int to Top
        For every step, the largest of all incidences.
    gains : mapping of int to Top
        The same of what it is over that of step 0 at the same incidence.
    """

    cosines: np.ndarray
    found: dict[int, list[Peak]]
    unit: Peak
    tops: dict[int, Top]
    gains: dict[int, Top]

    def relative(self, step: int) -> tuple[np.ndarray, np.ndarray]:
        """Largest radiances of a step over the unit, and bounds."""
        return _over(self._numbers(step), (self.unit.value, self.unit.error))

    def beside_mirror(self, step: int) -> tuple[np.ndarray, np.ndarray]:
        """Largest radiances over those in the mirror direction, and bounds."""
        mirror = [(p.at_mirror, p.at_mirror_error) for p in self.found[step]]
        return _over(self._numbers(step), np.array(mirror).T)

    def over_base(self, step: int) -> tuple[np.ndarray, np.ndarray]:
        """Largest radiances over those of step 0 at the same incidence, and bounds."""
        return _over(self._numbers(step), self._numbers(0))

    def _numbers(self, step: int) -> np.ndarray:
        return np.array([(p.value, p.error) for p in self.found[step]]).T

    def frame(self) -> pd.DataFrame:
        """One row for every step and every other incidence, and those of the largest of all."""
        import pandas as pd

        tops = [top.nearby for top in self.tops.values()]
        told = np.isin(self.cosines, tops)
        told[::2] = told[-1] = True
        rows = []
        for k, found in self.found.items():
            columns = self.relative(k), self.over_base(k), self.beside_mirror(k)
            for n in np.flatnonzero(told).tolist():
                item = found[n]
                row = {
                    "step": k,
                    "theta_deg": np.degrees(np.arccos(self.cosines[n])),
                    "cos_theta": self.cosines[n],
                    "peak": item.value,
                    "peak_error": item.error,
                }
                names = ("over_normal_incidence", "over_step_0", "over_mirror_direction")
                for name, (value, error) in zip(names, columns, strict=True):
                    row[name], row[f"{name}_error"] = value[n], error[n]
                row["from_mirror_deg"] = np.degrees(item.angle_from_mirror)
                row["from_mirror_deg_error"] = np.degrees(item.bracket)
                rows.append(row)
        return pd.DataFrame(rows)


def _over(a: Any, b: Any) -> tuple[np.ndarray, np.ndarray]:
    """Quotients of numbers with bounds."""
    ratio = np.asarray(a[0] / b[0])
    return ratio, (a[1] + ratio * b[1]) / (b[0] - b[1])


def _quotient(one: Peak, other: Peak) -> tuple[float, float]:
    value, error = _over((one.value, one.error), (other.value, other.error))
    return float(value), float(error)


def sparse(steps: int) -> list[int]:
    """The first steps, then every fifth, and the last: of many, what a table can do with."""
    return sorted({*range(min(steps, 5) + 1), *range(0, steps + 1, 5), steps})


def find_peaks(
    data: Series, cosines: np.ndarray = PEAK_COSINES, advance: Advance | None = None
) -> Peaks:
    """Seek the largest output radiance after the steps that `sparse` names, at some incidences.

    Those next to which it is largest of all, for one of the steps, are added to them.
    """
    base = data.stages[0].base
    unit = peak(base, 1.0)
    known: dict[tuple[int, float], Peak] = {}

    def at(k: int, c: float) -> Peak:
        if (k, c) not in known:
            known[k, c] = peak(data.stages[k], c)
        return known[k, c]

    def bright(k: int, c: float) -> tuple[float, float]:
        return _quotient(at(k, c), unit)

    def gained(k: int, c: float) -> tuple[float, float]:
        return _quotient(at(k, c), at(0, c))

    steps = sparse(data.steps)
    tops, gains = {}, {}
    for k in steps:
        if advance is not None:
            advance(k, data.steps + 1, f"largest radiance after step {k}")
        tops[k], gains[k] = (top_of(partial(what, k), cosines) for what in (bright, gained))
    every = np.unique(np.append(cosines, [top.nearby for top in tops.values()]))[::-1]
    found = {k: [at(k, float(c)) for c in every] for k in steps}
    return Peaks(every, found, unit, tops, gains)


def radiance_frame(data: Series, theta_deg: Sequence[float]) -> pd.DataFrame:
    """Output radiance in the plane of incidence: one row for every light and view direction."""
    import pandas as pd

    # The views that `draw_radiance` shows.
    view = np.append(np.arange(LOWEST_VIEW, 90.0), 89.5)
    frames = []
    for theta in theta_deg:
        c = math.cos(math.radians(theta))
        columns: dict[str, Any] = {
            "theta_deg": np.full(view.size, theta),
            "view_deg": view,
        }
        for k in sparse(data.steps):
            found = plane_radiance(data.stages[k], c, np.radians(view))
            columns[f"step_{k}"], columns[f"step_{k}_error"] = found.value, found.error
        frames.append(pd.DataFrame(columns))
    return pd.concat(frames, ignore_index=True)


def ramp(count: int) -> list[Any]:
    """Colours for what is ordered, from dark to light, none too pale for a line on white."""
    from matplotlib import colormaps

    return [tuple(x) for x in colormaps["viridis"](np.linspace(0.0, 0.86, max(count, 2)))][:count]


_DASHES: tuple[Any, ...] = ("-", (0, (6, 2)), (0, (1.2, 1.4)), (0, (6, 1.6, 1.2, 1.6)))


def looks(count: int) -> list[dict[str, Any]]:
    """Colours and dashes for curves that are ordered."""
    return [
        # What comes later lies below: dashes are seen where curves are one.
        {"color": color, "linestyle": _DASHES[k % len(_DASHES)], "zorder": 2.5 - 0.01 * k}
        for k, color in enumerate(ramp(count))
    ]


def step_labels(steps: Sequence[int]) -> list[str]:
    """What a legend calls the stages."""
    return ["before" if k == 0 else f"{k} step{'s' if k > 1 else ''}" for k in steps]


def albedo_axes(axes: Axes, data: Series, steps: Sequence[int], *, grazing: bool) -> None:
    """Draw the albedo after some of the steps."""
    # Cosines have eight digits.
    last = (1.0 - 1e-7) * angle_grid()[-1]
    inside = np.ones(data.cosines.size, bool) if grazing else data.cosines >= last
    c = data.cosines[inside]
    x = c if grazing else np.degrees(np.arccos(c))
    for k, label, look in zip(steps, step_labels(steps), looks(len(steps)), strict=True):
        axes.plot(x, data.value[k][inside], label=label, **look)
    axes.axhline(1.0, color="#888888", linewidth=0.9, zorder=1.5)
    axes.set_ylim(0.0, 1.05)
    if grazing:
        axes.set_xscale("log")
        axes.set_xlim(1.0, float(c.min()))
        axes.set_xlabel("cosine of the angle of incidence")
    else:
        axes.set_xlim(0.0, 90.0)
        axes.set_xticks(np.arange(0.0, 91.0, 15.0))
        axes.set_xlabel("angle of incidence (degrees)")


def draw_albedos(data: Series, steps: Sequence[int] | None = None) -> Figure:
    """The albedo after every step, in degrees and towards grazing incidence."""
    from albedo.plotting import add_legend

    shown = range(data.steps + 1) if steps is None else steps
    with style():
        figure, (left, right) = new_figure(2, 7.5, 3.4)
        albedo_axes(left, data, shown, grazing=False)
        albedo_axes(right, data, shown, grazing=True)
        left.set_ylabel("directional albedo")
        add_legend(figure, left)
    return figure


def draw_radiance(frame: pd.DataFrame, steps: Sequence[int] | None = None) -> Figure:
    """Output radiance in the plane of incidence, one panel for every light direction."""
    from albedo.plotting import add_legend

    angles = sorted(set(frame["theta_deg"]))
    count = sum(name.startswith("step_") and not name.endswith("_error") for name in frame)
    shown = range(count) if steps is None else steps
    with style():
        figure, panels = new_figure(len(angles), 7.5, 3.2)
        top = max(float(frame[f"step_{k}"].max()) for k in shown)
        for axes, theta in zip(panels, angles, strict=True):
            rows = frame[frame["theta_deg"] == theta]
            axes.axvline(theta, color="#888888", linewidth=0.9, zorder=1.5)
            for k, label, look in zip(shown, step_labels(shown), looks(len(shown)), strict=True):
                axes.plot(rows["view_deg"], rows[f"step_{k}"], label=label, **look)
            axes.set_title(f"light at {theta:g}°", loc="left")
            axes.set_xlim(LOWEST_VIEW, 90.0)
            axes.set_xticks(np.arange(LOWEST_VIEW, 91.0, 30.0))
            axes.set_ylim(0.0, 1.05 * top)
            if axes is not panels[0]:
                axes.tick_params(labelleft=False)
        panels[len(panels) // 2].set_xlabel("angle of the view in the plane of incidence (degrees)")
        panels[0].set_ylabel("output radiance (1/sr)")
        add_legend(figure, panels[0])
    return figure


def draw_peaks(peaks: Peaks, steps: Sequence[int] | None = None) -> Figure:
    """The largest output radiance after every step, against the angle of incidence."""
    from albedo.plotting import add_legend

    shown = list(peaks.found) if steps is None else steps
    with style():
        figure, (axes,) = new_figure(1, 7.5, 3.6)
        for k, label, look in zip(shown, step_labels(shown), looks(len(shown)), strict=True):
            axes.plot(peaks.cosines, peaks.relative(k)[0], label=label, **look)
        axes.axhline(1.0, color="#888888", linewidth=0.9, zorder=1.5)
        axes.set_xscale("log")
        axes.set_xlim(1.0, float(peaks.cosines.min()))
        axes.set_ylim(bottom=0.0)
        axes.set_xlabel("cosine of the angle of incidence (grazing to the right)")
        axes.set_ylabel("largest output radiance\nover that at normal incidence")
        add_legend(figure, axes)
    return figure
