r"""The albedos of a model that is pumped up again and again, each step for the price of a sum.

The divisor of a step knows only the heights of L and V. So what all steps need of the model is its
integral around each ring of constant n.v (`albedo.operators.panels`), and a step multiplies, adds
up and reads the spectra anew. Where two albedos cross, a ring is a kink from then on.

An albedo that is read by later steps carries an error into them; that of the last curve is what
was seen between its nodes. What becomes of it is linear: where e_j is the relative error of the
albedo a_j that step j reads, the a_k that follows has the relative error

    e_k = eta_k - sum over j < k of <e_j(the side with the larger a_j)>_k,

the average being over the light that f_k sends on, and eta_k what is new. The averages are taken
piece by piece, which gives a triangular system; the moduli of its inverse bound every error.
"""

from __future__ import annotations

import itertools
import math
import operator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from albedo._compile import kernel
from albedo._threads import blas_in_one, by_weight, in_batches, side_by_side
from albedo.brdf import Model, Part
from albedo.charts.axis import AxisChart
from albedo.charts.cosine import CosineChart
from albedo.charts.heights import FIRST, LAST, LOWEST, folded, unfolded
from albedo.charts.polar import PolarChart
from albedo.charts.rings import MIRROR, RingsChart
from albedo.charts.tail_rings import TailRingsChart
from albedo.errors import InputError
from albedo.operators.divisor import (
    CONTROLS,
    FLAT,
    TERMS,
    Divisor,
    LogCurve,
    mates,
    spread,
)
from albedo.operators.families import Families
from albedo.operators.joined import joined
from albedo.operators.nodes import MOST, TRUST, cosines
from albedo.operators.panels import Ahead, Panels
from albedo.operators.pieces import FRESH, Piece, between, bound_of, matrices_of
from albedo.operators.profiles import Profiles, Runs, Slices, StepKinks

_EPS = np.finfo(np.float64).eps
_ROUNDINGS = 40.0
_MOST_PIECES = 1000
# Pieces are halved down to this length, and next to the normal to that.
_SHORTEST, _BLURRED = 1e-7, 1e-5
# Marks that are closer than this are one.
_APART = 1e-11
# Integrals around rings are had to this share of the tolerance, or as well as float64 allows.
_INNER, _FINEST = 0.06, 2e-13
# What they leave unknown of a row is tolerated up to a share of that; then rows are had for steps
# ahead: towards grazing incidence a mirror leaves what is lost at first, and is much once it is
# pumped up. The few for which that is not enough are had as precisely as families are made of, and
# for any number of steps.
_COARSE, _FARTHEST = 0.15, (0.0, 4.0, 12.0, 30.0, 100.0)
# Where the albedo after one step is less than this, rows are had for steps ahead from the start: it
# is looked at before, to this tolerance.
_DARK, _ROUGH = 0.02, 1e-2
# What has no logarithm is taken for this.
_NOTHING = 1e-300
# Sums over rings may have this share of it; slices are not cut to less than a part of a panel,
# to which twenty halvings lead, after a few rounds that give more nodes, nor where a row has so
# many: what errs then is noise, of which no rule sees less.
_SHARE, _ROUNDS, _NARROWEST, _MOST_SLICES = 0.04, 32, 1e-6, 2000
# What a kink that no node sees may hide in one slice, as a share of the tolerance, and how many of
# those in a row are taken to hide all of it.
_HIDDEN, _MANY = 0.001, 20.0
# Pairs of heights, and cells, that are worth another thread.
_WORTH, _FEW_CELLS = 500, 20
# What a curve that later steps divide by may differ from the one that was fitted, as a share of it.
_JOINED = 0.05
# Half the nodes do where they leave this share of the tolerance.
_AMPLE = 0.5
# What one piece in the place of several may leave of it: it has to do for later steps, too; and
# after how many steps it is tried again where none did.
_ENOUGH, _AGAIN = 0.7, 3
# Pieces that did for the step before may leave so many times the tolerance: what is a little more
# than that would cost as many rows as what is far more.
_WORN = 1.5
# Slices that err by less than this share of the worst of their row wait until those are refined.
_WORST = 0.1
# What albedos, or their product, may be below a cosine by and above it all the same, as a multiple
# of what all curves may err by.
_UNSURE = 10.0
# Where in a cell averages are looked at: in the middle, and wherever a part of them may end that is
# divided by a cosine.
_CLAMPED = (0.5, 0.0, 0.25, 0.75, 1.0)
# What is to be worth most has this n.l at least.
_DARKEST = 1e-6
# Places of a piece in the search for what bends there.
_LOOKS = 33
# Pieces are joined where one does with this share of their rows.
_FEWER = 0.7
# Rows that no piece uses any more are kept as long as they are fewer than this share of all.
_UNUSED = 0.1


# What charts of lobes are as rings: their kind, and their axis.
_RETRO = (1.0, 1.0)
_KINDS = {
    "slope": ("slope", MIRROR),
    "mirror": ("mirror", MIRROR),
    "mirror_in_slopes": ("mirror", MIRROR),
    "mirror_hemisphere": ("mirror_hemisphere", MIRROR),
    "retro": ("mirror", _RETRO),
    "retro_hemisphere": ("mirror_hemisphere", _RETRO),
}


@dataclass(frozen=True)
class _Both:
    """The levels of two operators, one over the other."""

    first: Any
    second: Any

    def __call__(self, cos_light: np.ndarray) -> np.ndarray:
        return np.column_stack((self.first(cos_light), self.second(cos_light)))


@dataclass(frozen=True)
class _Heights:
    """Levels that are the same for all light."""

    heights: tuple[float, ...]

    def __call__(self, cos_light: np.ndarray) -> np.ndarray:
        return np.tile(self.heights, (cos_light.size, 1))


# Where control keeps the product of all steps, what is next to the horizon may be divided by n.v
# there: on each of these stretches a series knows it to as many digits as on others.
_STRETCHES = _Heights(tuple((0.5 ** np.arange(4, 65, 4)).tolist()))
# What integrals around rings are rounded to, as a share of the brightest of a panel. Panels for
# steps ahead end where the first step lifts that to the tolerance.
_ROUNDED, _LEAST_LIFT = 32.0 * _EPS, 16.0


def rings_of(part: Part, levels: Any = None) -> RingsChart:
    """The chart of rings for a part of an isotropic model.

    Parameters
    ----------
    part : Part
        With a chart about an axis in the plane of incidence, or for what is broad.
    levels : callable, optional
        See `albedo.charts.rings.RingsChart`.

    Raises
    ------
    InputError
        For parts with other charts.
    """
    chart = part.rings or part.chart
    if part.heights:
        own = _Heights(part.heights)
        levels = own if levels is None else _Both(own, levels)
    if isinstance(chart, RingsChart):
        # A part that was pumped up before has kinks already.
        if chart.levels is None or levels is None:
            return replace(chart, levels=chart.levels or levels)
        return replace(chart, levels=_Both(chart.levels, levels))
    if isinstance(chart, CosineChart):
        return RingsChart("broad", "max", levels=levels)
    # Where the axis is always N the albedo falls to 0 at the horizon as (n.l)^n does, and what is
    # next to nothing there is much once it is divided by that: no series on panels holds it.
    if isinstance(chart, AxisChart) and chart.coefficients[0] != 0.0:
        axis = chart.coefficients[1:]
        return RingsChart("axis", "none", chart.decay, chart.edge, axis=axis, levels=levels)
    if isinstance(chart, PolarChart) and chart.kind in _KINDS:
        kind, axis = _KINDS[chart.kind]
        edge = chart.edge if kind == "mirror" else 1
        thin = chart.layer == 2
        return RingsChart(kind, chart.kinks, chart.decay, edge, thin, axis, levels)
    if isinstance(chart, TailRingsChart):
        return RingsChart("slope", thin=chart.layer == 2, levels=levels)
    raise InputError(f"the {part.name} part has no chart of rings of constant n.v")


def _middles(edges: np.ndarray) -> np.ndarray:
    """The middle of each cell."""
    found: np.ndarray = 0.5 * (edges[1:] + edges[:-1])
    return found


def _finest(part: Part) -> float:
    """How precisely integrals around the rings of a part can be had."""
    return max(_FINEST, rings_of(part).finest(min(part.widths)))


@dataclass(frozen=True)
class _Fit:
    """A curve on a piece: coefficients, a bound on their error, and whether refining is no help."""

    series: np.ndarray
    bound: float
    stuck: bool


class Ladder:
    """The albedos a_0, a_1, ... of a model and of what pumping-up makes of it.

    Parameters
    ----------
    model : Model
        Isotropic and reciprocal.
    control : {None, "literal", "cumulative"}
        See `albedo.operators.divisor.CONTROLS`.
    rtol : float
        What the curves are to be worth, relatively, or nearly so.
    """

    @blas_in_one
    def __init__(self, model: Model, control: str | None, rtol: float) -> None:
        self.model, self.control, self.rtol = model, control, rtol
        self._of_model = model.parts()
        self._stretches = _STRETCHES if control == "cumulative" else None
        self.curves: list[LogCurve] = []
        self._cos = np.empty(0)
        self._row: dict[float, int] = {}
        self._parts: list[Profiles] = []
        # Where fresh rows are laid out before they are taken in.
        self._room: list[Slices] = []
        self._families: dict[tuple[Part, _Heights | None], Families] = {}
        # Energy of Dirac parts at all rows and its error, and by how much steps divide it: the
        # logarithm, and how many steps.
        self._dirac: np.ndarray | None = None
        self._over, self._over_steps = np.empty(0), 0
        # How many steps are in the products of all rows.
        self._met = 0
        # For every step, ends of cells that lie each in one piece of every curve so far, and what
        # the errors of these pieces do there.
        self._cells: list[np.ndarray] = []
        self._transfer: list[np.ndarray] = []
        self._divisors: dict[int, Divisor] = {}
        self._doubts: dict[int, float] = {}
        # What errors of curves do to the albedos of all parts together, after the last step that
        # was looked at; bounds on what they do after every step, of all together and part by part.
        self._passed: tuple[int, np.ndarray] = 0, np.empty((0, 0))
        self._averages: dict[int, np.ndarray] = {}
        self._worst: dict[int, float] = {}
        far, near = np.linspace(FIRST, -4.0, 7), np.linspace(0.0, LAST, 4)
        # What has a kink for all light has one in its albedo, and later where a step divides by as
        # much as there.
        heights = [height for part in self._of_model for height in part.heights]
        self._heights = np.unique(folded(np.array(heights)))
        self._mates: list[np.ndarray] = []
        # Pieces that did not do as one, by their ends and how many they are, and for how many steps
        # that is not tried again.
        self._apart: dict[tuple[float, float, int], int] = {}
        self._start = np.unique(np.concatenate((far, (-2.0, -1.0), near, self._heights)))
        self._pieces = [Piece.new(a, b, 0) for a, b in itertools.pairwise(self._start.tolist())]
        # Where control keeps the product, what a rough curve leaves unknown of rows is in the way.
        self._seen = None if control == "cumulative" else self._look()
        self._lay_out()

    def tidy(self) -> None:
        """Give up the memory that only further steps would use."""
        self._room.clear()

    def albedos(self, steps: int) -> list[LogCurve]:
        """What the first steps divide by."""
        return self.curves[:steps]

    def chart(self, part: Part, steps: int) -> RingsChart:
        """The chart for a part after some steps."""
        levels = self.divisor(steps).levels
        return rings_of(part, _Both(levels, self._stretches) if self._stretches else levels)

    def _divisor(self) -> Divisor:
        return self.divisor(len(self.curves))

    def divisor(self, steps: int) -> Divisor:
        """The divisor of the first steps; always the same object."""
        if steps not in self._divisors:
            self._divisors[steps] = Divisor(self.curves[:steps], self.control)
        return self._divisors[steps]

    def _look(self) -> tuple[LogCurve, np.ndarray, np.ndarray] | None:
        """The first albedo, roughly, and what a step makes of it at some coordinates.

        None where a step leaves no row dark.
        """
        # Both ends of each piece and its middle.
        y = np.sort(np.concatenate((self._start, _middles(self._start))))
        c = cosines(y)
        spikes = self._spikes(c)
        mirror = np.zeros(c.size) if spikes is None else spikes[0]
        charts = [(part, self._families_of(part, False).chart) for part in self._of_model]
        panels = [Panels.of(self.model, *of, c, _ROUGH) for of in charts]
        total = mirror + sum(np.bincount(some.row, some.series[:, 0], c.size) for some in panels)
        total = np.maximum(total, _NOTHING)
        # A step that divides by no more than the brightest leaves no less than this.
        if total.min() > _DARK * total.max():
            return None
        low, middle, high = np.log(total[:-2:2]), np.log(total[1::2]), np.log(total[2::2])
        series = np.zeros((low.size, TERMS))
        series[:, 0], series[:, 1] = 0.25 * (low + high) + 0.5 * middle, 0.5 * (high - low)
        series[:, 2] = 0.25 * (low + high) - 0.5 * middle
        error, flat = np.full(low.size, _ROUGH), np.zeros(low.size, dtype=int)
        first = LogCurve(self._start, series, error, flat)
        later = mirror / total + sum(Ahead(first).after_one(some) for some in panels)
        return (first, y, np.maximum(later, _NOTHING)) if np.any(later < _DARK) else None

    def _dark(self, y: np.ndarray) -> np.ndarray:
        """Where a step leaves rows dark."""
        if self._seen is None:
            return np.zeros(y.size, bool)
        _, known, later = self._seen
        found: np.ndarray = np.interp(y, known, np.log(later)) < math.log(_DARK)
        return found

    def _lay_out(self) -> None:
        """Rows for the points of all pieces, with all divisors so far."""
        wanted = np.unique(np.concatenate([piece.y for piece in self._pieces]))
        fresh = wanted[[y not in self._row for y in wanted.tolist()]]
        if fresh.size == 0:
            return
        c = cosines(fresh)
        if self._parts:
            nearest = self._nearest(fresh)
            ahead = [profiles.ahead[nearest] for profiles in self._parts]
        else:
            ahead = [self._dark(fresh).astype(int) for _ in self._of_model]
        # All parts read them, and make none.
        for steps in range(len(self.curves) + 1):
            self.divisor(steps)

        def of_part(one: slice) -> Profiles:
            return self._profile(self._of_model[one.start], c, ahead[one.start])

        parts = in_batches(of_part, len(ahead), 1)
        if not self._parts:
            self._parts = parts
        else:
            for old, new in zip(self._parts, parts, strict=True):
                old.extend(new)
                self._room.append(new.slices)
        self._row |= {y: self._cos.size + k for k, y in enumerate(fresh.tolist())}
        self._cos = np.concatenate((self._cos, c))
        self._see_mirror(c)

    def _nearest(self, y: np.ndarray) -> np.ndarray:
        """The rows next to some coordinates."""
        known = np.sort(list(self._row))
        k = np.clip(np.searchsorted(known, y), 1, known.size - 1)
        below = y - known[k - 1] < known[k] - y
        return np.array([self._row[at] for at in known[k - below].tolist()])

    def _leave_out(self) -> None:
        """Give up the rows that are for no point of a piece, when they are many."""
        wanted = {y for piece in self._pieces for y in piece.y.tolist()}
        if len(wanted) > (1.0 - _UNUSED) * self._cos.size:
            return
        kept = np.sort([self._row[y] for y in wanted])
        number = {row: k for k, row in enumerate(kept.tolist())}
        self._row = {y: number[row] for y, row in self._row.items() if row in number}
        self._cos = self._cos[kept]
        if self._dirac is not None:
            self._dirac, self._over = self._dirac[:, kept], self._over[kept]
        for profiles in self._parts:
            profiles.keep(kept)

    def _rows(self, piece: Piece) -> np.ndarray:
        """The rows of the nodes and of the fresh points of a piece."""
        return np.array([self._row[y] for y in piece.y.tolist()])

    def _profile(self, part: Part, c: np.ndarray, levels: np.ndarray) -> Profiles:
        """Rows, each as far ahead as is known to be needed: not at all, some steps, or all."""
        known = np.unique(levels).tolist()
        which = [np.flatnonzero(levels == level) for level in known]
        clamped = self.control == "cumulative"
        near, far = self._families_of(part, False), self._families_of(part, 2 in known)

        def of_level(one: slice) -> Panels:
            level, rows = known[one.start], which[one.start]
            if level < 2:
                ahead = Ahead(self._known, clamped=clamped) if level else None
                found = near.panels(c[rows], ahead)
            else:
                ahead = Ahead(self._known, _FARTHEST, clamped)
                found = far.direct(c[rows], ahead, True)
            found.ahead[:] = level
            return found

        found = in_batches(of_level, len(known), 1)
        profiles = Profiles(Panels.together(found, which), self._free_room())
        self._meet(profiles, c, 0)
        return profiles

    def _free_room(self) -> Slices | None:
        try:
            return self._room.pop()
        except IndexError:
            return None

    def _families_of(self, part: Part, ahead: bool) -> Families:
        """What rows of a part are had from, as they are at first or for any steps ahead."""
        levels = (self._stretches or self._falls) if ahead else None
        if (part, levels) not in self._families:
            finest = _finest(part)
            rtol = max(self.rtol * _INNER, finest)
            chart = rings_of(part, levels)
            self._families[part, levels] = Families(self.model, part, chart, rtol, finest)
        return self._families[part, levels]

    @property
    def _known(self) -> LogCurve:
        """The first albedo, as far as steps ahead know it."""
        return self.curves[0] if self._seen is None else self._seen[0]

    @cached_property
    def _falls(self) -> _Heights | None:
        """Where the first albedo falls by what lifts roundings to the tolerance, time and again."""
        first = self.curves[0]
        least = float(first.at(first.samples).min())
        lift = math.log(max(self.rtol / _ROUNDED, _LEAST_LIFT))
        passed = [first.passes(-lift * k) for k in range(1, math.ceil(-least / lift))]
        heights = unfolded(np.concatenate([np.empty(0), *passed]))
        return _Heights(tuple(heights.tolist())) if heights.size else None

    def _meet(self, profiles: Profiles, c: np.ndarray, done: int) -> None:
        """Take all steps but so many into the products, and cut where their curves have kinks."""
        fresh = np.empty(0, int)
        late = bool(profiles.slices.stale.any())
        if late:
            # What hides is told by what slices are worth; at a step the one before will do.
            self._multiply(profiles, c, done, fresh)
        divisors = [self.divisor(n) for n in range(done + 1, len(self.curves) + 1)]
        known = [StepKinks(d.curves[-1], d.last_levels(c), d.last_bends) for d in divisors]
        known = [step for step in known if step.levels.shape[1] or step.bends.size]
        if known:
            value, _, _ = self._sums(profiles, c)
            least = _HIDDEN * self.rtol * value
            fresh = profiles.cut(*profiles.kinks(known, self.control is not None, least))
        if not late:
            self._multiply(profiles, c, done, fresh)
        self._renew(profiles, fresh, self._divisor(), c)

    def _multiply(self, profiles: Profiles, c: np.ndarray, done: int, without: np.ndarray) -> None:
        """Take all steps but so many into the products of all but some slices."""
        profiles.multiply(self.curves[done:], c, CONTROLS.index(self.control), without)

    def _renew(
        self, profiles: Profiles, fresh: np.ndarray, divisor: Divisor, c: np.ndarray
    ) -> None:
        """Compute the products of new slices."""
        if fresh.size == 0:
            return
        s = profiles.slices
        row = profiles.row[s.panel[fresh]]
        seen = np.zeros(c.size, bool)
        seen[row] = True
        runs = (np.cumsum(seen) - 1)[row], s.first[fresh], s.order[fresh]
        divisor.product.at_nodes(c[seen], *runs, s.y, s.log_product)

    def _controlled(self, c: np.ndarray) -> tuple[int, np.ndarray]:
        """What sums know of the control: its number, and the logarithms of n.l."""
        return CONTROLS.index(self.control), np.log(np.maximum(c, LOWEST))

    def _sums(self, profiles: Profiles, c: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return profiles.sums(*self._controlled(c))

    def _values(self) -> tuple[np.ndarray, np.ndarray]:
        """Albedos of all rows at the present step, and their relative errors of quadrature."""
        for turn in range(_ROUNDS):
            value, of_slices, of_panels, other = self._added_up()
            if not np.all(value > 0.0):
                self._refuse(value)
            if turn == _ROUNDS - 1 or not (
                self._sharpen(of_slices, _SHARE * self.rtol * value)
                or self._remake(of_panels, _COARSE * self.rtol * value)
            ):
                break
        error = of_slices.sum(0) + of_panels.sum(0) + other
        return value, error / value + _ROUNDINGS * _EPS + _MANY * _HIDDEN * self.rtol

    def _refuse(self, value: np.ndarray) -> None:
        """Tell that there is nothing to divide by at some row."""
        k = int(np.argmin(value > 0.0))
        steps = len(self.curves)
        why = f"its albedo is {value[k]:g}, not above 0"
        if steps:
            least = math.exp(self.curves[0].at(self.curves[0].samples).min())
            why = f"no digit of its albedo is left after step {steps}"
            why += f"; it is as low as {least:.1g} at first"
        raise InputError(
            f"{self.model.spec} cannot be pumped up: at cos_theta = {self._cos[k]:.3g} {why}"
        )

    def _rounded(self, logs: np.ndarray) -> np.ndarray:
        """What it changes of the logarithms of all rows that cosines are not quite where y are."""
        y, row = np.array(list(self._row)), np.array(list(self._row.values()))
        rank = np.argsort(y)
        y, row = y[rank], row[rank]
        slope = np.abs(np.diff(logs[row]) / np.diff(y))
        found = np.empty(y.size)
        found[row] = np.maximum(np.append(slope, 0.0), np.append(0.0, slope))
        found[row] *= np.abs(folded(self._cos[row]) - y)
        return found

    def _added_up(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Values of all rows, bounds of slices and panels part by part, and all other errors."""
        found = [self._sums(profiles, self._cos) for profiles in self._parts]
        value, other = self._mirror()
        for profiles, (own, _, _) in zip(self._parts, found, strict=True):
            value = value + own
            other = other + profiles.shift * own
        of_slices, of_panels = (np.array([sums[k] for sums in found]) for k in (1, 2))
        return value, of_slices, of_panels, other

    def _sharpen(self, of_slices: np.ndarray, goal: np.ndarray) -> bool:
        """Refine slices whose rules are not worth what rows may lose; whether any was."""
        total, changed = of_slices.sum(0), False
        if not np.any(total > goal):
            return False
        divisor, control, log_light = self._divisor(), *self._controlled(self._cos)
        for profiles in self._parts:
            s = profiles.slices
            hit, row = profiles.of_rows(total > goal)
            count = np.bincount(row, minlength=goal.size)
            most = 0.5 * goal / np.maximum(count, 1)
            for _ in range(_ROUNDS):
                poor = (total > goal)[row] & (s.error[hit] > most[row])
                poor &= (s.end[hit] - s.start[hit]) > _NARROWEST
                poor &= (count < _MOST_SLICES)[row]
                hit, row = hit[poor], row[poor]
                # The worst come first: the others may do, then.
                worst = np.zeros(goal.size)
                np.maximum.at(worst, row, s.error[hit])
                now = s.error[hit] > _WORST * worst[row]
                later, hit = hit[~now], hit[now]
                if hit.size == 0:
                    break
                changed = True
                row, before = profiles.row[s.panel[hit]], s.error[hit]
                total = total - np.bincount(row, before, total.size) * profiles.doubt
                count -= np.bincount(row, minlength=count.size)
                hit = profiles.raised(hit)
                self._renew(profiles, hit, divisor, self._cos)
                profiles.sum_nodes(hit, control, log_light)
                row = profiles.row[s.panel[hit]]
                total += np.bincount(row, s.error[hit], total.size) * profiles.doubt
                count += np.bincount(row, minlength=count.size)
                hit = np.concatenate((hit, later))
                row = profiles.row[s.panel[hit]]
        return changed

    def _remake(self, of_panels: np.ndarray, goal: np.ndarray) -> bool:
        """Compute rows anew whose integrals around rings became too coarse; whether any was.

        What was next to nothing is much, once it is divided by small albedos often enough.
        """
        changed = False
        if not self.curves:
            return changed
        for k, (profiles, part) in enumerate(zip(self._parts, self._of_model, strict=True)):
            poor = of_panels[k] * len(self._parts) > goal
            rows = np.flatnonzero(poor & (profiles.ahead < 2))
            if rows.size:
                fresh = self._profile(part, self._cos[rows], profiles.ahead[rows] + 1)
                profiles.replace(rows, fresh)
                self._room.append(fresh.slices)
                changed = True
        return changed

    def _spikes(self, c: np.ndarray) -> np.ndarray | None:
        """The energy of Dirac parts at some cosines, and its error; None where there are none."""
        s = np.sqrt((1.0 - c) * (1.0 + c))
        wi = np.stack((s, np.zeros_like(c), c), axis=-1)
        _, weights = self.model.spikes(wi)
        if not len(weights):
            return None
        return np.stack((weights.sum(0), self.model.spike_errors(wi, weights).sum(0)))

    def _see_mirror(self, c: np.ndarray) -> None:
        """Compute the energy of Dirac parts at fresh rows."""
        found = self._spikes(c)
        if found is None:
            return
        over = self.divisor(self._over_steps).logs(c, c)
        if self._dirac is not None:
            found = np.concatenate((self._dirac, found), axis=1)
        self._dirac, self._over = found, np.concatenate((self._over, over))

    def _mirror(self) -> tuple[np.ndarray, np.ndarray]:
        """Energy of Dirac parts at all rows, over the divisor."""
        c = self._cos
        if self._dirac is None:
            return np.zeros(c.size), np.zeros(c.size)
        if self._over_steps != len(self.curves):
            self._over_steps, self._over = len(self.curves), self._divisor().logs(c, c)
        scale = np.exp(-self._over)
        return self._dirac[0] * scale, self._dirac[1] * scale

    @blas_in_one
    def step(self) -> LogCurve:
        """The curve of the present albedo; later steps divide by it."""
        self._pass_on()
        known: dict[Piece, _Fit] = {}
        # Under control steps give back less of what others took too much.
        old, worn = set(self._pieces), _WORN if self.control is None else 1.0
        before = np.empty(0)
        while True:
            value, own = self._values()
            if not np.array_equal(value[: before.size], before):
                known.clear()
            before, logs = value, np.log(value)
            own = own + self._rounded(logs)
            fresh = [piece for piece in self._pieces if piece not in known]
            known |= zip(fresh, self._fits(fresh, logs, own), strict=True)
            fits = [known[piece] for piece in self._pieces]
            allowed = [worn if piece in old else 1.0 for piece in self._pieces]
            poor = [
                k
                for k, (fit, fold) in enumerate(zip(fits, allowed, strict=True))
                if fit.bound > fold * self.rtol and not fit.stuck
            ]
            # The worst come first: there is room for so many.
            poor.sort(key=lambda k: -fits[k].bound)
            room = max(_MOST_PIECES - len(self._pieces), 0)
            if not poor[:room] or not self._refine({k: fits[k] for k in poor[:room]}):
                break
        self._thin_out(fits, logs, own)
        fine = LogCurve(
            np.array([piece.low for piece in self._pieces] + [LAST]),
            np.stack([fit.series for fit in fits]),
            np.array([fit.bound for fit in fits]),
            np.array([piece.bent for piece in self._pieces]),
        )
        marks = np.concatenate((*self._divisor().marks, *self._mates, self._heights))
        curve = joined(fine, _JOINED * self.rtol, marks)
        self._transfer.append(self._shares(curve))
        self._cells.append(np.union1d(self._cells[-1] if self._cells else self._start, curve.edges))
        self._mates.append(mates(curve, self._heights, self.control == "literal"))
        self._join(curve, logs, own)
        self.curves.append(curve)
        return curve

    @blas_in_one
    def _pass_on(self) -> None:
        """Take new steps into the products of all rows, and see what errors of curves do after."""
        steps = len(self.curves)
        if self._met < steps:
            self._leave_out()
            for profiles in self._parts:
                self._meet(profiles, self._cos, self._met)
            self._met = steps
        if steps == 0 or self._passed[0] == steps:
            return
        edges = self._cells[-1]
        # The rows next to the middles stand for all cells, and others where averages may jump.
        shares = _CLAMPED if self.control == "cumulative" else _CLAMPED[:1]
        y = edges[:-1] + np.array(shares)[:, None] * np.diff(edges)
        rows, of_cell = np.unique(self._nearest(y.ravel()), return_inverse=True)
        c, of_cell = self._cos[rows], of_cell.reshape(y.shape)
        control, log_light = self._controlled(c)
        known = log_light, rows, edges, _UNSURE * sum(curve.bound.max() for curve in self.curves)
        runs = [profiles.sent(control, *known) for profiles in self._parts]
        mirror = self._mirror()[0][rows]
        found = self._averaged(runs, mirror, c, of_cell)
        self._passed = steps, found[0, 0]
        self._averages[steps] = (np.abs(found) @ self._new(steps)).max(1)

    def _averaged(
        self, runs: list[Runs], mirror: np.ndarray, c: np.ndarray, of_cell: np.ndarray
    ) -> np.ndarray:
        """What the errors of all curves do to averages over some light, on the cells of the last.

        Parameters
        ----------
        runs : list of Runs
            The light that rows send on, by part.
        mirror : ndarray, shape (n,)
            What they send on to the height that they come from.
        c : ndarray, shape (n,)
            Cosines of the rows.
        of_cell : ndarray of int, shape (k, m)
            The rows that stand for each cell.

        Returns
        -------
        ndarray, shape (1 + parts, k, m, errors)
            In the average over all light, and over that of each part.
        """
        middle, y_l = _middles(self._cells[-1]), folded(c)
        # Where nothing is sent on, nothing is averaged.
        totals = [mirror + sum(run.total for run in runs), *(run.total for run in runs)]
        # One part alone is all.
        alone = len(runs) == 1 and not mirror.any()
        share = 1.0 / np.maximum(totals[:1] if alone else totals, 1e-300)

        def of_curve(part: slice) -> tuple[np.ndarray, ...]:
            k = part.start
            earlier, cells, transfer = self.curves[k], self._cells[k], self._transfer[k]
            # Cells are cut and never joined: each lies in one of an earlier curve.
            of_earlier = np.searchsorted(cells, middle) - 1
            at_l = earlier.at(y_l)
            matrix = np.zeros((len(runs), c.size, transfer.shape[0]))
            own = np.zeros((len(runs), c.size))
            for run, from_v, from_l in zip(runs, matrix, own, strict=True):
                place = run.row, of_earlier[run.piece], run.y, run.share, run.lowest
                spread(*place, at_l, *earlier.pieces, from_v, from_l)
            return matrix @ transfer, np.vstack((own.sum(0) + mirror, own)), of_earlier

        known = in_batches(of_curve, len(self.curves), 1)
        found = np.zeros((len(share), *of_cell.shape, self._transfer[-1].shape[1]))

        def subtract(part: slice) -> None:
            for (passed, own, of_earlier), transfer in zip(known, self._transfer, strict=True):
                rest = passed, own, transfer, of_earlier[part], of_cell[:, part]
                _subtract(*rest, share, found[:, :, part])

        side_by_side(subtract, middle.size, _FEW_CELLS)
        return np.broadcast_to(found, (len(totals), *found.shape[1:]))

    def _shares(self, curve: LogCurve) -> np.ndarray:
        """What the errors of all curves do to that of a new one, on its cells: see the module.

        The columns are the new errors of the pieces of the first curve, of the second, ..., and
        of this one.
        """
        before = self._cells[-1] if self._cells else self._start
        middle = _middles(np.union1d(before, curve.edges))
        own = np.zeros((middle.size, curve.error.size))
        own[np.arange(middle.size), curve.piece(middle)] = 1.0
        if not self.curves:
            return own
        # Averages change little from one end of a cell to the other.
        return np.column_stack((self._passed[1][np.searchsorted(before, middle) - 1], own))

    def average(self, steps: int, cos_theta: np.ndarray, part: int | None = None) -> np.ndarray:
        """Bounds on what the divisor of so many steps makes albedos err by, relatively.

        It errs less in the average over all V than for the worst of them.

        Parameters
        ----------
        steps : int
        cos_theta : ndarray, shape (n,)
            Incidences; below `LOWEST` as there.
        part : int, optional
            Of the light that one part of the model sends on; of all by default.

        Returns
        -------
        ndarray, shape (n,)
            0 where there is no divisor.
        """
        if steps == 0:
            return np.zeros(cos_theta.shape)
        if steps not in self._averages:
            self._pass_on()
        own = self._averages[steps][0 if part is None else part + 1]
        cell = np.searchsorted(self._cells[steps - 1], folded(cos_theta), side="right") - 1
        # What holds in the middle of cells is looked up in those next to it as well.
        cell = np.clip(cell + np.array([[-1], [0], [1]]), 0, own.size - 1)
        # As for pairs of heights; an average of exponentials is not the exponential of the average.
        doubt = self.doubt(steps)
        bent = steps * doubt * doubt
        found: np.ndarray = 2.0 * own[cell].max(0) + bent + self.divisor(steps).left_out
        return found

    def worst(self, steps: int) -> float:
        """The largest of `average` for all incidences with n.l above a millionth."""
        if steps not in self._worst:
            ends = self._cells[steps - 1] if steps else np.array([FIRST, LAST])
            seen = np.maximum(_middles(ends), folded(np.array(_DARKEST)))
            self._worst[steps] = float(self.average(steps, unfolded(seen)).max())
        return self._worst[steps]

    def _new(self, steps: int) -> np.ndarray:
        """Bounds on the new errors of the pieces of so many curves, one after the other."""
        # A curve errs, and extrema as small as its error were passed over.
        curves = self.curves[:steps]
        return np.concatenate([FLAT * curve.error.max() + curve.bound for curve in curves])

    def doubt(self, steps: int) -> float:
        """Bound on the relative error of the divisor of so many steps, whatever L and V are."""
        if steps not in self._doubts:
            self._doubts[steps] = self._doubt(steps) if steps else 0.0
        return self._doubts[steps]

    @blas_in_one
    def _doubt(self, steps: int) -> float:
        curves, new = self.curves[:steps], self._new(steps)
        y = _middles(self._cells[steps - 1])
        transfers = self._transfer[:steps]
        value = np.stack([curve.at(y) for curve in curves])
        cell = np.stack([np.searchsorted(cells, y) - 1 for cells in self._cells[:steps]])
        width = np.array([transfer.shape[1] for transfer in transfers])
        sizes = np.array([transfer.size for transfer in transfers])
        known = np.concatenate([t.ravel() for t in transfers]), np.cumsum(sizes) - sizes, width

        def largest(part: slice) -> float:
            return _largest_doubt(part.start, part.stop, value, cell, *known, new)

        # Pairs of heights have no order.
        worst = float(np.max(by_weight(largest, np.arange(y.size, 0, -1), _WORTH)))
        # Within a piece an error may change its sign: no more than doubles what is left of it.
        return 2.0 * worst + self.divisor(steps).left_out

    def _fits(self, pieces: list[Piece], logs: np.ndarray, own: np.ndarray) -> list[_Fit]:
        """Series on pieces, from the logarithms of all rows and their errors."""
        found: dict[int, _Fit] = {}
        sizes = [(piece.gaps, piece.y.size) for piece in pieces]
        for gaps, points in set(sizes):
            which = [k for k, size in enumerate(sizes) if size == (gaps, points)]
            rows = np.stack([self._rows(pieces[k]) for k in which])
            basis, to_series = matrices_of([pieces[k] for k in which])
            known = logs[rows, None]
            series = np.zeros((len(which), TERMS))
            series[:, : gaps + 1] = (to_series @ known[:, : gaps + 1])[:, :, 0]
            missed = np.abs(basis @ series[:, : gaps + 1, None] - known).max((1, 2))
            noise = own[rows].max(1)
            trust, worse = (
                np.array([getattr(pieces[k], name) for k in which]) for name in ("trust", "worse")
            )
            bound, stuck = bound_of(missed, noise, trust, worse), missed <= noise
            for k, *fit in zip(which, series, bound.tolist(), stuck.tolist(), strict=True):
                found[k] = _Fit(*fit)
        return [found[k] for k in range(len(pieces))]

    def _thin_out(self, fits: list[_Fit], logs: np.ndarray, own: np.ndarray) -> None:
        """Give pieces half their nodes where these do: later albedos are smoother."""
        which = list(range(len(self._pieces)))
        while which := [k for k in which if self._pieces[k].may_have_fewer]:
            halves = [self._pieces[k].halved for k in which]
            found = zip(which, halves, self._fits(halves, logs, own), strict=True)
            ample = [of for of in found if of[2].bound <= _AMPLE * self.rtol]
            for k, half, fit in ample:
                self._pieces[k], fits[k] = half, fit
            which = [k for k, _, _ in ample]

    def _join(self, curve: LogCurve, logs: np.ndarray, own: np.ndarray) -> None:
        """Put one piece in the place of all that lie in one of the curve, where few of their rows
        do: later curves hardly bend at most of the ends between them.
        """
        first = np.searchsorted([piece.low for piece in self._pieces], curve.edges)
        pieces: list[Piece] = []
        for k, (begin, end) in enumerate(itertools.pairwise(first.tolist())):
            inside = self._pieces[begin:end]
            one = None
            # What did not do hardly does soon.
            key = inside[0].low, inside[-1].high, end - begin
            if end - begin > 1 and len(self.curves) >= self._apart.get(key, 0):
                one = self._joined(inside, int(curve.bent[k]), curve.coefficients[k], logs, own)
                if one is None:
                    self._apart[key] = len(self.curves) + _AGAIN
            pieces += inside if one is None else [one]
        self._pieces = pieces

    def _joined(
        self,
        pieces: list[Piece],
        bent: int,
        series: np.ndarray,
        logs: np.ndarray,
        own: np.ndarray,
    ) -> Piece | None:
        """One piece in the place of several, of which it keeps few enough rows.

        The series that holds them tells how many terms it takes.
        """
        known = np.unique(np.concatenate([piece.y for piece in pieces]))
        rows = np.array([self._row[y] for y in known.tolist()])
        rest = np.cumsum(np.abs(series[::-1]))[::-1]
        for gaps, fresh in FRESH.items():
            if gaps + 1 + fresh > _FEWER * known.size:
                break
            if TRUST * rest[gaps + 1] > self.rtol:
                continue
            piece = Piece.among(pieces[0].low, pieces[-1].high, bent, gaps, known)
            if piece is not None:
                # All rows are there to confirm it.
                own_series = piece.to_series @ logs[self._rows(piece)[: gaps + 1]]
                missed = np.abs(piece.polynomials(known) @ own_series - logs[rows]).max()
                bound = bound_of(missed, own[rows].max(), piece.trust, piece.worse)
                if bound <= _ENOUGH * self.rtol:
                    return piece
        return None

    def _refine(self, poor: dict[int, _Fit]) -> bool:
        """Cut pieces where an earlier curve bends; else give them more nodes, or halve them.

        Those of some numbers, with what was fitted to them. Whether there was one that is not too
        short.
        """
        seen = [self._pieces[k] for k in poor]
        y = np.concatenate([np.linspace(piece.low, piece.high, _LOOKS) for piece in seen])
        turnings = self._divisor().turnings(np.unique(y))
        pieces = []
        for k, piece in enumerate(self._pieces):
            if k not in poor:
                pieces.append(piece)
                continue
            for found in self._refined(piece, turnings):
                # What is known of the whole mostly tells whether few nodes will do for a part.
                few = found is not piece and found.gaps < MOST
                rest = piece.left_out(poor[k].series, found) if few else 0.0
                pieces.append(replace(found, gaps=MOST) if TRUST * rest > self.rtol else found)
        changed = len(pieces) > len(self._pieces) or any(map(operator.is_not, pieces, self._pieces))
        self._pieces = pieces
        self._lay_out()
        return changed

    def _refined(self, piece: Piece, turnings: np.ndarray) -> list[Piece]:
        a, b, bent = piece.low, piece.high, piece.bent
        # So near to the normal no cosine tells nodes from each other.
        end = min(b - _APART, LAST - _BLURRED)
        # What earlier steps did not bend enough to be seen, this one hardly does.
        newest, every = self._divisor().marks
        newest = np.unique(np.concatenate((newest, turnings, *self._mates[-1:])))
        for marks in (newest, np.unique(np.concatenate((every, *self._mates)))):
            apart = marks[np.diff(marks, prepend=-np.inf) > _APART]
            inside = apart[(apart > a + _APART) & (apart < end)].tolist()
            if inside:
                break
        else:
            if piece.gaps < MOST:
                return [piece.refined()]
            if b - a <= (_SHORTEST if a < LAST - _BLURRED else _BLURRED):
                return [piece]
            middle = 0.5 * (a + b)
            return [Piece.new(a, middle, bent & 1), Piece.new(middle, b, bent & 2)]
        corners = [(a, bent == 1), *((x, True) for x in inside), (b, bent == 2)]
        pairs = itertools.pairwise(corners)
        return [
            one for (low, first), (high, last) in pairs for one in between(low, high, first, last)
        ]


@kernel
def _subtract(passed, own, transfer, of_earlier, of_cell, share, found):
    """Take from averages what one curve errs by at V, and at L where that has the larger albedo.

    `passed` has that at V for all light of each part and row; `own` what is divided by L's albedo.
    """
    for n in range(found.shape[0]):
        first, last = (0, passed.shape[0]) if n == 0 else (n - 1, n)
        for i in range(of_cell.shape[0]):
            for k in range(of_cell.shape[1]):
                r, e = of_cell[i, k], of_earlier[k]
                scale = share[n, r]
                at_l = scale * own[n, r]
                for m in range(transfer.shape[1]):
                    found[n, i, k, m] -= at_l * transfer[e, m]
                for p in range(first, last):
                    for m in range(transfer.shape[1]):
                        found[n, i, k, m] -= scale * passed[p, r, m]


@kernel
def _largest_doubt(start, stop, value, cell, transfer, begin, width, new):
    """The largest sum of errors, in modulus, that reach a pair of heights, of which the first are
    some; `transfer` has the matrices of all steps, each from its `begin` on."""
    worst, steps, n = 0.0, value.shape[0], value.shape[1]
    passed = np.empty(new.size)
    for i in range(start, stop):
        for k in range(i, n):
            for m in range(new.size):
                passed[m] = 0.0
            for j in range(steps):
                chosen = cell[j, i] if value[j, i] >= value[j, k] else cell[j, k]
                first = begin[j] + chosen * width[j]
                for m in range(width[j]):
                    passed[m] += transfer[first + m]
            total = 0.0
            for m in range(new.size):
                total += abs(passed[m]) * new[m]
            # What is no number stays one that is none.
            if not total <= worst and worst == worst:
                worst = total
    return worst


@lru_cache(maxsize=64)
def ladder(model: Model, control: str | None, rtol: float) -> Ladder:
    """The ladder of a model, shared by all that read it."""
    return Ladder(model, control, rtol)
