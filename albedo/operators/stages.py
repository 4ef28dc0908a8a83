r"""The albedos of a model that is pumped up where they depend on more than the height.

Each step is a table of the albedo of the model so far, over heights and azimuths. Where e_j is the
error of the logarithm of a_j that step j reads, that of the albedo that follows is, for the light
from x,

    e_k(x) = eta_k(x) - sum over j < k of <e_j(the side with the larger a_j)>_k,

the average being over the light that f_k sends on from x, and eta_k what its own table may err by,
the divisor taken as exact. Part of this is at x itself: a share p_kj(x) of the light has the
smaller a_j. So

    e_k(x) = nu_k(x) - sum over j < k of p_kj(x) e_j(x),
    nu_k(x) = eta_k(x) - <sum over j with a_j(V) > a_j(x) of e_j(V)>_k.

The first line is linear, at one place, and what a step divides by too much the next gives back: it
tells any sum of shares of e_j(x) exactly by the nu_j(x). Bounds on these are all that tables keep,
cell by cell, with the shares; the average in the second line takes the modulus of such a sum at
each V. No two errors at different places are taken to cancel, nor to have one sign anywhere. An
average of exponentials of errors is the exponential of their average, but for half the square of
the largest (Hoeffding's lemma).
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np

from albedo._threads import in_batches
from albedo.brdf import Model, Part
from albedo.charts._compiled import CompiledChart
from albedo.directions import spherical
from albedo.integrators.adaptive import refine
from albedo.integrators.cells import Cells, Integrand, evaluate
from albedo.integrators.rules import LADDER
from albedo.operators.kept import shelf_of
from albedo.operators.mapping import STARTS, log_map
from albedo.operators.maps import HOPELESS, PATCHES, LogMap, Maps
from albedo.operators.split import SplitChart

# A table that errs by more somewhere is of a function that jumps: what it promises elsewhere is
# not to be trusted.
_JUMPS = 0.1
# What tables are to be worth: three of them leave 1e-8.
_FIRST, _LATER = 3e-10, 3e-9
# Most albedos that are computed for one: the first albedo is smooth, later ones bend along curves.
# Where tables before it are worth less than this, its own is not to be had any better.
_MOST_FIRST, _MOST_LATER, _POOR = 10_000, 60_000, 1e-5
# Where later ones bend most, measured.
_FINER = tuple(sorted({*STARTS, -3.25, -1.4}))
# Averages need few digits, and bounds hold what is not known of them: the light that is sent on,
# to this share, and what two rules differ by, times the next.
_ROUGH, _TRUST, _LIMIT = 0.02, 2.0, 40_000
_ORDERS = np.array(LADDER)
# Places whose light a thread looks at together.
_BATCH = 32

Weigh = Callable[[np.ndarray, np.ndarray, np.ndarray], None]
"""Multiplies values for some wi and wo in place."""


@dataclass(eq=False)
class Stages:
    """The albedos a_0, a_1, ... of a model and of what pumping-up makes of it, as tables.

    Parameters
    ----------
    model : Model
        Reciprocal.
    control : {None, "literal", "cumulative"}
        See `albedo.operators.divisor.CONTROLS`.
    rtol : float, optional
        What the tables are to be worth, relatively: as well as they can be had in some seconds,
        and later ones in a minute or two, unless given.
    stage : callable
        ``stage(model, steps, control, rtol)`` gives the model after some steps whose divisor is
        taken as exact.
    """

    model: Model
    control: str | None
    rtol: float | None
    stage: Callable[[Model, int, str | None, float | None], Model]
    tables: list[LogMap] = field(default_factory=list)
    _maps: dict[int, Maps] = field(default_factory=dict)
    _making: threading.RLock = field(default_factory=threading.RLock)

    def albedos(self, steps: int) -> list[LogMap]:
        """What the first steps divide by."""
        if len(self.tables) < steps:
            # Two threads are not to make the same table, and append it twice.
            with self._making:
                while len(self.tables) < steps:
                    self.tables.append(self._table())
        return self.tables[:steps]

    def _table(self) -> LogMap:
        """The table that comes next."""
        k, before = len(self.tables), tuple(self.tables)
        present = self.stage(self.model, k, self.control, self.rtol)
        poor = max((float(table.error.max()) for table in before), default=0.0) > _POOR
        most = _MOST_FIRST if k == 0 or poor else _MOST_LATER
        asked = self.worth(k), most, STARTS if k == 0 else _FINER, before
        with shelf_of(f"table {k + 1}", present, *asked) as shelf:
            table = shelf.finished()
            if table is None:
                table = log_map(present, *asked, shelf)
                if before:
                    table = self._told(table)
                shelf.keep(table)
        return table

    def worth(self, step: int) -> float:
        """What the table that a step reads is to be worth."""
        if self.rtol is not None:
            return self.rtol
        return _LATER if step > 0 else _FIRST

    def reach(self, steps: int) -> float:
        """What albedos are to be worth after some steps: errors add up, not more."""
        return sum(self.worth(step) for step in range(steps))

    def _told(self, table: LogMap) -> LogMap:
        """A table with what all before make it err by; see the module."""
        steps, count = len(self.tables), PATCHES + 1
        c, phi = table.places(count)
        _, weights = self.model.spikes(spherical(c[:, 0], phi[:, 0]))
        if len(weights) or not self.trusted(steps):
            worst = self.doubt(steps)
            return replace(table, error=table.error + worst, own=table.own + worst)
        # Azimuths that make no difference are looked at once.
        seen = slice(0, None, count) if self.model.isotropic else slice(None)
        shape = len(c), count, -1
        c, phi = c[:, seen].ravel(), phi[:, seen].ravel()

        def sent_on(part: slice) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            return self._sent_on(self.model.parts(), steps, c[part], phi[part])

        found = in_batches(sent_on, c.size, _BATCH)
        near, unsure, far = (np.concatenate(lines) for lines in zip(*found, strict=True))
        wi = spherical(c, phi)
        passed, off = _on_cells(near.reshape(*shape, steps))
        before = sum(_on_cells(self._each(wi, steps).reshape(*shape, steps)))
        off = off + sum(_on_cells(unsure.reshape(*shape, steps)))
        beyond = sum(_on_cells(far.reshape(shape)))
        here = sum(_on_cells(self.divisor(steps).combined(wi, near).reshape(shape)))
        own = table.own + beyond + (off * before).sum(-1) + self._bent(steps)
        error = (own + here).max((1, 2))
        return replace(table, error=error, own=own, passed=passed)

    def _each(self, wi: np.ndarray, steps: int) -> np.ndarray:
        """Bounds on the errors of all tables at directions: (n, steps)."""
        maps, one = self.divisor(steps), np.eye(steps)
        return np.column_stack([maps.combined(wi, np.tile(row, (len(wi), 1))) for row in one])

    def _bent(self, steps: int) -> float:
        """What an average of exponentials is beside the exponential of the average."""
        return 0.5 * sum(self.divisor(steps).errors) ** 2

    def average(self, part: Part, steps: int, c: np.ndarray, phi: np.ndarray) -> np.ndarray:
        """Bounds on what tables make the albedo of a part err by, relatively."""
        near, unsure, far = self._sent_on((part,), steps, c, phi)
        wi = spherical(c, phi)
        lost = (unsure * self._each(wi, steps)).sum(-1)
        total = self.divisor(steps).combined(wi, near) + lost + far + self._bent(steps)
        return np.expm1(np.minimum(total, HOPELESS))

    def _sent_on(
        self, parts: Sequence[Part], steps: int, c: np.ndarray, phi: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What becomes of the errors of the divisor, averaged over the light that parts send on.

        Returns
        -------
        near, unsure : ndarray, shape (n, steps)
            The share of it for which each step divides by the albedo at L, and its error.
        far : ndarray, shape (n,)
            Bound on what the albedos at V bring.
        """
        maps = self.divisor(steps)
        value, error, far = np.zeros((3, c.size))
        near, unsure = np.zeros((2, c.size, steps))
        most = sum(maps.errors)
        for part in parts:
            light = _Light(self, part, maps, c, phi)
            value, error = value + light.value, error + light.error
            for j in range(steps):
                found = light.averaged(partial(maps.weigh_near, j))
                near[:, j] += found[0]
                unsure[:, j] += found[1]
            far += sum(light.averaged(maps.weigh_far))
        least = value - error
        known = least > 0.0
        safe = np.where(known, least, 1.0)
        # Where nothing is known of the light, nothing is known to cancel.
        near = np.where(known[:, None], near / np.where(known, value, 1.0)[:, None], 0.0)
        unsure = np.where(known[:, None], (unsure + near * error[:, None]) / safe[:, None], 0.0)
        return near, np.minimum(unsure, 1.0), np.where(known, np.minimum(far / safe, most), most)

    def divisor(self, steps: int) -> Maps:
        """The divisor of the first steps; always the same object."""
        if steps not in self._maps:
            self._maps.setdefault(steps, Maps(tuple(self.albedos(steps)), self.control))
        return self._maps[steps]

    def chart(self, part: Part, steps: int) -> CompiledChart | SplitChart:
        """The chart for a part after some steps."""
        # A model that was pumped up by tables is not pumped up over that.
        chart: Any = part.chart
        if steps == 0:
            return chart
        return SplitChart(chart, self.divisor(steps))

    def trusted(self, steps: int) -> bool:
        """Whether the errors of all rectangles mean something, beside the largest of them."""
        return self.doubt(steps) <= _JUMPS

    def doubt(self, steps: int) -> float:
        """Bound on the relative error of the divisor of so many steps, whatever L and V are."""
        # Tables are logarithms, whose errors add up.
        total = sum(self.divisor(steps).errors)
        return math.expm1(total) if total < HOPELESS else math.inf


class _Light:
    """The light that a part of the base sends on from some places, over a divisor."""

    def __init__(
        self, stages: Stages, part: Part, maps: Maps, c: np.ndarray, phi: np.ndarray
    ) -> None:
        self._part, self._maps = part, maps
        p = part.packed(np.array([stages.model.pack()], dtype=np.float64))
        self._p = np.tile(p, (c.size, 1))
        # Along its panels lie the places where another albedo is the larger one.
        self._chart: Any = stages.chart(part, len(maps.tables))
        widths = np.tile(part.widths, (c.size, 1))
        what: tuple[Any, ...] = self._chart, self._integrand(None), c, phi, widths
        self._begun = refine(*(*what, stages.model.isotropic), rtol=_ROUGH, atol=0.0, limit=_LIMIT)
        self._light = self._begun.cells.value
        self.value, self.error = self._summed(self._light, self._begun.cells.error.sum(1))

    def _summed(self, value: np.ndarray, error: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Sums of cells for every place."""
        begun, n = self._begun, len(self._p)
        total, lost = (np.bincount(begun.cells.row, a, n) for a in (value, error))
        return total, begun.doubt * lost

    def _integrand(self, weigh: Weigh | None) -> Integrand:
        def sent(row: np.ndarray, wi: np.ndarray, wo: np.ndarray, h: np.ndarray) -> np.ndarray:
            out = np.empty(wo.shape[1:])
            self._part.fill(wi, wo, h, self._p[row], out)
            self._maps.divide(wi, wo, out)
            if weigh is not None:
                weigh(wi, wo, out)
            return out * self._part.scale

        return sent

    def averaged(self, weigh: Weigh) -> tuple[np.ndarray, np.ndarray]:
        """Its integral with what `weigh` multiplies values by; and its error.

        That may jump, of which no spectrum tells: two rules do.
        """
        old, found = self._begun.cells, []
        # All but the last have a next one.
        up = np.searchsorted(_ORDERS, old.order)
        for order in (old.order, _ORDERS[np.where(up < _ORDERS.size - 1, up + 1, up - 1)]):
            cells = Cells.blank(old.row, old.code, old.box, order)
            evaluate(self._chart, self._integrand(weigh), self._begun.geometry, cells)
            found.append(cells.value)
        return self._summed(found[0], _TRUST * np.abs(found[1] - found[0]))


def _on_cells(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What is known in corners of cells (m, 5, 5, ...): the middle, and how far off it may be.

    That is twice what corners differ by from it. One column stands for all.
    """
    if corners.shape[2] == 1:
        corners = np.repeat(corners, PATCHES + 1, axis=2)
    low = np.lib.stride_tricks.sliding_window_view(corners, (2, 2), axis=(1, 2))
    least, most = low.min((-2, -1)), low.max((-2, -1))
    return 0.5 * (least + most), most - least


@lru_cache(maxsize=32)
def stages(
    model: Model,
    control: str | None,
    rtol: float | None,
    stage: Callable[[Model, int, str | None, float | None], Model],
) -> Stages:
    """The stages of a model, shared by all that read them."""
    return Stages(model, control, rtol, stage)
