"""The albedos of a model that is pumped up where they depend on more than the height.

Each step is a table of the albedo of the model so far, over heights and azimuths. Where the
logarithms that the steps before read err by E_j(L) and E_j(V), that of the albedo that follows errs
by the average of the sum over j of E_j on the side with the larger albedo, over the light that is
sent on from L. The errors of a table are known rectangle by rectangle, so that this is one more
integral. So the table of a_k errs by what its own fit may err by, the divisor taken as exact, and
by the largest of these averages over each rectangle.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np

from albedo.brdf import Model, Part
from albedo.charts._compiled import CompiledChart
from albedo.directions import spherical
from albedo.integrators.adaptive import integrate
from albedo.operators.kept import shelf_of
from albedo.operators.mapping import STARTS, log_map
from albedo.operators.maps import HOPELESS, LogMap, Maps
from albedo.operators.split import SplitChart

# A table that errs by more somewhere is of a function that jumps: what it promises elsewhere is
# not to be trusted.
_JUMPS = 0.1
# What tables are to be worth: two of them leave 1e-8.
_FIRST, _LATER = 3e-10, 3e-9
# Most albedos that are computed for one: the first albedo is smooth, later ones bend along curves.
# Where tables before it are worth less than this, its own is not to be had any better.
_MOST_FIRST, _MOST_LATER, _POOR = 10_000, 60_000, 1e-5
# Where later ones bend most, measured.
_FINER = tuple(sorted({*STARTS, -3.25, -1.4}))
# Averages of errors need few digits; they are looked at in so many places along both sides of a
# rectangle, and what is between them is not twice as much.
_ROUGH, _LIMIT, _LOOKS, _BETWEEN = 0.1, 40_000, 3, 2.0


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
                    table = replace(table, error=table.error + self._inherited(table))
                shelf.keep(table)
        return table

    def worth(self, step: int) -> float:
        """What the table that a step reads is to be worth."""
        if self.rtol is not None:
            return self.rtol
        return _LATER if step > 0 else _FIRST

    def reach(self, steps: int) -> float:
        """What albedos are to be worth after some steps: tables have the errors of those before."""
        total = 0.0
        for step in range(steps):
            total += self.worth(step) + _BETWEEN * total
        return total

    def _inherited(self, table: LogMap) -> np.ndarray:
        """What all tables so far make an albedo err by, on every rectangle of its table."""
        c, phi = table.places(_LOOKS)
        steps = len(self.tables)
        error, value = np.zeros(c.size), np.zeros(c.size)
        for part in self.model.parts():
            own, sent = self.average(part, steps, c.ravel(), phi.ravel())
            error, value = error + own, value + sent
        _, weights = self.model.spikes(spherical(c.ravel(), phi.ravel()))
        if len(weights) or not self.trusted(steps):
            return np.full(len(c), self.doubt(steps))
        found: np.ndarray = _BETWEEN * (error / value).reshape(c.shape).max(1)
        return found

    def average(
        self, part: Part, steps: int, c: np.ndarray, phi: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Bounds on what tables make the albedo of a part err by, and on that albedo from below."""
        maps, p = self.divisor(steps), part.packed(np.array([self.model.pack()], dtype=np.float64))

        def sent(row: np.ndarray, wi: np.ndarray, wo: np.ndarray, h: np.ndarray) -> np.ndarray:
            out = np.empty(wo.shape[1:])
            part.fill(wi, wo, h, np.repeat(p, row.size, axis=0), out)
            maps.divide(wi, wo, out)
            return out * part.scale

        def doubted(row: np.ndarray, wi: np.ndarray, wo: np.ndarray, h: np.ndarray) -> np.ndarray:
            out = sent(row, wi, wo, h)
            maps.weigh(wi, wo, out)
            return out

        widths = np.tile(part.widths, (c.size, 1))
        error, value = (
            integrate(
                *(part.chart, integrand, c, phi, widths, self.model.isotropic),
                rtol=_ROUGH,
                atol=0.0,
                limit=_LIMIT,
                probe=False,
            )
            for integrand in (doubted, sent)
        )
        return error.value + error.error, np.maximum(value.value - value.error, 0.0)

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


@lru_cache(maxsize=32)
def stages(
    model: Model,
    control: str | None,
    rtol: float | None,
    stage: Callable[[Model, int, str | None, float | None], Model],
) -> Stages:
    """The stages of a model, shared by all that read them."""
    return Stages(model, control, rtol, stage)
