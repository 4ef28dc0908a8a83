r"""The albedos of a model that is pumped up again and again, each step for the price of a sum.

The divisor of a step knows only the heights of L and V. So what all steps need of the model is its
integral around each ring of constant n.v (`albedo.operators.profiles`), and a step multiplies, adds
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
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev

from albedo.brdf import Model, Part
from albedo.charts.cosine import CosineChart
from albedo.charts.heights import FIRST, LAST, LOWEST, folded, unfolded
from albedo.charts.polar import PolarChart
from albedo.charts.rings import RingsChart
from albedo.charts.tail_rings import TailRingsChart
from albedo.errors import InputError
from albedo.integrators.cells import rules_by_order
from albedo.operators.divisor import CONTROLS, FLAT, NODES, ORDER, Divisor, LogCurve, straight
from albedo.operators.profiles import Profiles, Slices

_EPS = np.finfo(np.float64).eps
_ROUNDINGS = 40.0
_FRESH = chebyshev.chebpts2(ORDER + 1)[::2]
# Between its nodes an interpolant errs most. Fresh points stand in every second gap, and at both
# ends: what a gap between them hides is not many times as much.
_TRUST = 8.0
# What errors at the nodes may come to between them: the Lebesgue constant of 16 Chebyshev nodes.
_LEBESGUE = 2.8
_ROWS = ORDER + _FRESH.size
_MOST_PIECES = 400
_SHORTEST = 1e-5
# Integrals around rings are had to this share of the tolerance.
_INNER = 0.01
# What they leave unknown of a row is tolerated up to a share of it; then they are had to a part of
# what would be enough, so that it lasts. The finest is what float64 gives.
_COARSE, _AHEAD, _FINEST = 0.15, 0.01, 2e-13
# Sums over rings may have this share of it; slices are not cut to less than a part of a panel.
_SHARE, _ROUNDS, _NARROWEST = 0.05, 12, 1e-6
# What a kink that no node sees may hide in one slice, as a share of the tolerance.
_HIDDEN = 0.001


@dataclass(frozen=True)
class _Both:
    """The levels of two operators, one over the other."""

    first: Any
    second: Any

    def __call__(self, cos_light: np.ndarray) -> np.ndarray:
        return np.column_stack((self.first(cos_light), self.second(cos_light)))


def rings_of(part: Part, levels: Any = None) -> RingsChart:
    """The chart of rings for a part of an isotropic model.

    Parameters
    ----------
    part : Part
        With a chart about the mirror direction, or for what is broad.
    levels : callable, optional
        See `albedo.charts.rings.RingsChart`.

    Raises
    ------
    InputError
        For parts whose lobes lie elsewhere.
    """
    chart = part.chart
    if isinstance(chart, RingsChart):
        # A part that was pumped up before has kinks already.
        if chart.levels is None or levels is None:
            return replace(chart, levels=chart.levels or levels)
        return replace(chart, levels=_Both(chart.levels, levels))
    if isinstance(chart, CosineChart):
        return RingsChart("broad", "max", levels=levels)
    if isinstance(chart, PolarChart) and chart.kind in ("slope", "mirror", "mirror_hemisphere"):
        edge = chart.edge if chart.kind == "mirror" else 1
        thin = chart.layer == 2
        return RingsChart(chart.kind, chart.kinks, chart.decay, edge, thin, levels)
    if isinstance(chart, TailRingsChart):
        return RingsChart("slope", thin=chart.layer == 2, levels=levels)
    raise InputError(
        f"the {part.name} part cannot be pumped up: its lobe is not about the mirror direction"
    )


@dataclass
class _Piece:
    """One piece of all curves from now on, with the rows of its nodes."""

    low: float
    high: float
    bent: int
    first: int


class Ladder:
    """The albedos a_0, a_1, ... of a model and of what pumping-up makes of it.

    Parameters
    ----------
    model : Model
        Isotropic and reciprocal.
    control : {None, "literal", "cumulative"}
        See `albedo.operators.divisor.CONTROLS`.
    rtol : float
        What the curves are to be worth, relatively.
    """

    def __init__(self, model: Model, control: str | None, rtol: float) -> None:
        self.model, self.control, self.rtol = model, control, rtol
        self.curves: list[LogCurve] = []
        self._cos = np.empty(0)
        self._parts: list[Profiles] = []
        self._pieces: list[_Piece] = []
        self._transfer: list[np.ndarray] = []
        self._divisors: dict[int, Divisor] = {}
        self._doubts: dict[int, float] = {}
        far, near = np.linspace(FIRST, -4.0, 7), np.linspace(0.0, LAST, 4)
        start = np.concatenate((far, (-2.0, -1.0), near))
        self._add([(a, b, 0) for a, b in itertools.pairwise(start.tolist())])

    def albedos(self, steps: int) -> list[LogCurve]:
        """What the first steps divide by."""
        return self.curves[:steps]

    def chart(self, part: Part, steps: int) -> RingsChart:
        """The chart for a part after some steps."""
        return rings_of(part, self.divisor(steps).levels)

    def _divisor(self) -> Divisor:
        return self.divisor(len(self.curves))

    def divisor(self, steps: int) -> Divisor:
        """The divisor of the first steps; always the same object."""
        if steps not in self._divisors:
            self._divisors[steps] = Divisor(self.curves[:steps], self.control)
        return self._divisors[steps]

    def _add(self, spans: list[tuple[float, float, int]]) -> None:
        """Rows for new pieces (low, high, bent), with all divisors so far."""
        low, high, bent = (np.array(column)[:, None] for column in zip(*spans, strict=True))
        t = np.tile(0.5 * (np.concatenate((NODES, _FRESH)) + 1.0), (len(spans), 1))
        t = np.where(bent == 1, t * t, np.where(bent == 2, t * (2.0 - t), t))
        y = low + t * (high - low)
        c = np.clip(unfolded(y).ravel(), LOWEST, 1.0)
        first = self._cos.size
        parts = self._profiles(c, self.rtol * _INNER)
        if not self._parts:
            self._parts = parts
        else:
            for old, new in zip(self._parts, parts, strict=True):
                old.extend(new)
        self._cos = np.concatenate((self._cos, c))
        for k, span in enumerate(spans):
            self._pieces.append(_Piece(*span, first + k * _ROWS))

    def _profiles(self, c: np.ndarray, rtol: float) -> list[Profiles]:
        """All parts at some cosines, with all divisors so far."""
        return [self._profile(part, c, rtol) for part in self.model.parts()]

    def _profile(self, part: Part, c: np.ndarray, rtol: float) -> Profiles:
        profiles = Profiles.of(self.model, part, rings_of(part), c, rtol)
        for done in range(1, len(self.curves) + 1):
            self._meet(profiles, self.divisor(done), c)
        return profiles

    def _meet(self, profiles: Profiles, divisor: Divisor, c: np.ndarray) -> None:
        """Take the last step of a divisor into the products, and cut where its curve has kinks."""
        curve = divisor.curves[-1]
        profiles.multiply(curve, c, self.control == "literal")
        levels = divisor.last_levels(c)
        if levels.shape[1] == 0:
            return
        value, _, _ = self._sums(profiles, c)
        least = _HIDDEN * self.rtol * value
        found = profiles.kinks(curve, levels, self.control is not None, least)
        self._renew(profiles, profiles.cut(*found), divisor, c)

    def _renew(
        self, profiles: Profiles, fresh: np.ndarray, divisor: Divisor, c: np.ndarray
    ) -> None:
        """Compute the products of new slices."""
        if fresh.size == 0:
            return
        s = profiles.slices
        rows, row = np.unique(profiles.row[s.panel[fresh]], return_inverse=True)
        runs = row, s.first[fresh], s.order[fresh]
        divisor.product.at_nodes(c[rows], *runs, s.y, s.log_height, s.log_product)

    def _sums(self, profiles: Profiles, c: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        log_light = np.log(np.maximum(c, LOWEST))
        return profiles.sums(CONTROLS.index(self.control), log_light)

    def _values(self) -> tuple[np.ndarray, np.ndarray]:
        """Albedos of all rows at the present step, and their relative errors of quadrature."""
        for turn in range(_ROUNDS):
            value, of_slices, of_panels, other = self._added_up()
            dark = ~(value > 0.0)
            if dark.any():
                raise InputError(
                    f"{self.model.spec} cannot be pumped up: at cos_theta = "
                    f"{self._cos[dark][0]:.3g} its albedo is {value[dark][0]:g}, not above 0"
                )
            if turn == _ROUNDS - 1 or not (
                self._sharpen(of_slices, _SHARE * self.rtol * value)
                or self._remake(of_panels, _COARSE * self.rtol * value)
            ):
                break
        error = of_slices.sum(0) + of_panels.sum(0) + other
        return value, error / value + _ROUNDINGS * _EPS

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
        short, changed = of_slices.sum(0) > goal, False
        if not short.any():
            return False
        divisor = self._divisor()
        for profiles in self._parts:
            s = profiles.slices
            row = profiles.row[s.panel]
            most = (0.5 * goal / np.maximum(np.bincount(row, minlength=goal.size), 1))[row]
            hit = np.flatnonzero(short[row] & (s.error > most) & (s.end - s.start > _NARROWEST))
            changed |= hit.size > 0
            if hit.size:
                self._renew(profiles, profiles.raised(hit), divisor, self._cos)
        return changed

    def _remake(self, of_panels: np.ndarray, goal: np.ndarray) -> bool:
        """Compute rows anew whose integrals around rings became too coarse; whether any was.

        What was next to nothing is much, once it is divided by small albedos often enough.
        """
        changed = False
        for k, (profiles, part) in enumerate(zip(self._parts, self.model.parts(), strict=True)):
            excess = of_panels[k] * len(self._parts) / goal
            rows = np.flatnonzero((excess > 1.0) & (profiles.inner > _FINEST))
            if rows.size:
                finer = (profiles.inner[rows] / excess[rows]).min() * _AHEAD
                fresh = self._profile(part, self._cos[rows], max(finer, _FINEST))
                self._parts[k] = profiles.replaced(rows, fresh)
                changed = True
        return changed

    def _mirror(self) -> tuple[np.ndarray, np.ndarray]:
        """Energy of Dirac parts at all rows, over the divisor."""
        c = self._cos
        s = np.sqrt((1.0 - c) * (1.0 + c))
        wi = np.stack((s, np.zeros_like(c), c), axis=-1)
        _, weights = self.model.spikes(wi)
        if not len(weights):
            return np.zeros(c.size), np.zeros(c.size)
        scale = np.exp(-self._divisor().logs(c, c))
        errors = self.model.spike_errors(wi, weights)
        return weights.sum(0) * scale, errors.sum(0) * scale

    def step(self) -> LogCurve:
        """The curve of the present albedo; later steps divide by it."""
        while True:
            value, own = self._values()
            fits = [self._fit(piece, np.log(value), own) for piece in self._pieces]
            poor = [
                k
                for k, (_, bound, stuck) in enumerate(fits)
                if bound > self.rtol
                and not stuck
                and self._pieces[k].high - self._pieces[k].low > _SHORTEST
            ]
            if not poor or len(self._pieces) + len(poor) > _MOST_PIECES:
                break
            self._halve(poor)
        rank = sorted(range(len(fits)), key=lambda k: self._pieces[k].low)
        edges = np.array([self._pieces[k].low for k in rank] + [LAST])
        curve = LogCurve(
            edges,
            np.ascontiguousarray(np.stack([fits[k][0] for k in rank])),
            np.array([fits[k][1] for k in rank]),
            np.array([self._pieces[k].bent for k in rank]),
        )
        self._transfer.append(self._shares(curve))
        self.curves.append(curve)
        divisor = self._divisor()
        for profiles in self._parts:
            self._meet(profiles, divisor, self._cos)
        return curve

    def _shares(self, curve: LogCurve) -> np.ndarray:
        """What the errors of all curves do to that of a new one, on its pieces: see the module.

        The columns are the new errors of the pieces of the first curve, of the second, ..., and
        of this one.
        """
        middle = 0.5 * (curve.edges[1:] + curve.edges[:-1])
        rank = sorted(range(len(self._pieces)), key=lambda k: self._pieces[k].low)
        rows = np.array([self._pieces[k].first + ORDER // 2 for k in rank])
        before = [t.shape[0] for t in self._transfer]
        found = np.zeros((middle.size, sum(before) + middle.size))
        found[:, sum(before) :] = np.eye(middle.size)
        if not before:
            return found
        parts = [profiles.rows(rows) for profiles in self._parts]
        c = self._cos[rows]
        y_l, total = folded(c), np.zeros(rows.size)
        log_light = np.log(np.maximum(c, LOWEST))
        _, weights, _ = rules_by_order()
        nodes = np.arange(weights.shape[1])
        sent, rows_of = [], []
        for profiles in parts:
            s = profiles.slices
            row = np.repeat(profiles.row[s.panel], s.order)
            product = s.log_product
            if self.control == "cumulative":
                product = np.maximum(product, np.maximum(s.log_height, log_light[row]))
            own = s.density * np.exp(-product) * weights[s.order][nodes < s.order[:, None]]
            sent.append(own)
            rows_of.append(row)
            total += np.bincount(row, own, rows.size)
        mirror = self._mirror()[0][rows]
        total += mirror
        for earlier, transfer in zip(self.curves, self._transfer, strict=True):
            matrix = np.zeros((rows.size, earlier.error.size))
            own_piece, at_l = earlier.piece(y_l), earlier.at(y_l)
            for profiles, row, share in zip(parts, rows_of, sent, strict=True):
                s = profiles.slices
                at_v = earlier.at(s.y)
                chosen = np.where(at_l[row] >= at_v, own_piece[row], earlier.piece(s.y))
                free = self._free(s, log_light[row], np.maximum(at_v, at_l[row]))
                np.add.at(matrix, (row[free], chosen[free]), share[free])
            # A mirror's light has one height.
            matrix[np.arange(rows.size), own_piece] += mirror
            found[:, : transfer.shape[1]] -= matrix / total[:, None] @ transfer
        return found

    def _free(self, s: Slices, log_light: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Whether what is divided by at nodes is made of albedos, not of heights."""
        lowest = np.maximum(s.log_height, log_light)
        if self.control is None:
            return np.ones(step.shape, dtype=bool)
        free: np.ndarray = (step if self.control == "literal" else s.log_product) >= lowest
        return free

    def doubt(self, steps: int) -> float:
        """Bound on the relative error of the divisor of so many steps, whatever L and V are."""
        if steps not in self._doubts:
            self._doubts[steps] = self._doubt(steps) if steps else 0.0
        return self._doubts[steps]

    def _doubt(self, steps: int) -> float:
        curves = self.curves[:steps]
        # A curve errs, and extrema as small as its error were passed over.
        new = (1.0 + FLAT) * np.concatenate([curve.error for curve in curves])
        edges = np.unique(np.concatenate([curve.edges for curve in curves]))
        y = 0.5 * (edges[1:] + edges[:-1])
        rows = np.zeros((y.size, y.size, new.size))
        for curve, transfer in zip(curves, self._transfer[:steps], strict=True):
            value, piece = curve.at(y), curve.piece(y)
            chosen = np.where(value[:, None] >= value[None, :], piece[:, None], piece[None, :])
            rows[:, :, : transfer.shape[1]] += transfer[chosen]
        # Within a piece an error may change its sign: no more than doubles what is left of it.
        return 2.0 * float((np.abs(rows) @ new).max())

    def _fit(
        self, piece: _Piece, logs: np.ndarray, own: np.ndarray
    ) -> tuple[np.ndarray, float, bool]:
        """Coefficients on a piece, a bound on their error, and whether halving will not help."""
        rows = slice(piece.first, piece.first + _ROWS)
        # Cosines are rounded: near 1 they stand for another angle.
        y = np.clip(folded(self._cos[rows]), piece.low, piece.high)
        basis = chebyshev.chebvander(straight(y, piece.low, piece.high, piece.bent), ORDER - 1)
        coefficients = np.linalg.solve(basis[:ORDER], logs[rows][:ORDER])
        missed = float(np.abs(basis @ coefficients - logs[rows]).max())
        noise = float(own[rows].max())
        bound = _TRUST * missed + _LEBESGUE * noise
        return coefficients, bound, missed <= noise

    def _halve(self, poor: list[int]) -> None:
        """Replace pieces by smaller ones: cut where an earlier curve bends, or by halves."""
        marks = self._divisor().marks
        spans = []
        for k in poor:
            a, b, bent = self._pieces[k].low, self._pieces[k].high, self._pieces[k].bent
            margin = 1e-9 * (b - a)
            inside = np.unique(marks[(marks > a + margin) & (marks < b - margin)]).tolist()
            if inside:
                # Ends that bend have the clustered nodes; between two of them a piece is halved.
                ends = [(a, bent == 1), *((x, True) for x in inside), (b, bent == 2)]
                for (low, first), (high, last) in itertools.pairwise(ends):
                    if first and last:
                        middle = 0.5 * (low + high)
                        spans += [(low, middle, 1), (middle, high, 2)]
                    else:
                        spans.append((low, high, 1 if first else 2 if last else 0))
            else:
                middle = 0.5 * (a + b)
                spans += [(a, middle, bent & 1), (middle, b, bent & 2)]
        left = [piece for k, piece in enumerate(self._pieces) if k not in set(poor)]
        width = _ROWS
        kept = np.concatenate(
            [np.arange(piece.first, piece.first + width) for piece in left] or [np.empty(0, int)]
        ).astype(int)
        for k, piece in enumerate(left):
            piece.first = k * width
        self._pieces = left
        self._cos = self._cos[kept]
        self._parts = [profiles.rows(kept) for profiles in self._parts]
        self._add(spans)


@lru_cache(maxsize=64)
def ladder(model: Model, control: str | None, rtol: float) -> Ladder:
    """The ladder of a model, shared by all that read it."""
    return Ladder(model, control, rtol)
