"""The albedos of a model that is pumped up where they depend on more than the height.

Each step is a table of the albedo of the model so far, over heights and azimuths. Where the
logarithm that step j reads errs by E_j, that of the product of k divisors errs by their sum, and
that of the albedo that follows by no more: so E_k is what the table of a_k itself may err by, the
divisor taken as exact, and the sum of all before.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

from albedo.brdf import Model, Part
from albedo.charts._compiled import CompiledChart
from albedo.operators.maps import LogMap, Maps, log_map
from albedo.operators.split import SplitChart

# A logarithm that errs by more tells nothing, and its exponential is no number.
_HOPELESS = 700.0


@dataclass(eq=False)
class Stages:
    """The albedos a_0, a_1, ... of a model and of what pumping-up makes of it, as tables.

    Parameters
    ----------
    model : Model
        Reciprocal.
    control : {None, "literal", "cumulative"}
        See `albedo.operators.divisor.CONTROLS`.
    rtol : float
        What the tables are to be worth, relatively.
    stage : callable
        ``stage(model, steps, control, rtol)`` gives the model after some steps whose divisor is
        taken as exact.
    """

    model: Model
    control: str | None
    rtol: float
    stage: Callable[[Model, int, str | None, float], Model]
    tables: list[LogMap] = field(default_factory=list)
    _maps: dict[int, Maps] = field(default_factory=dict)

    def albedos(self, steps: int) -> list[LogMap]:
        """What the first steps divide by."""
        while len(self.tables) < steps:
            present = self.stage(self.model, len(self.tables), self.control, self.rtol)
            self.tables.append(log_map(present, self.rtol))
        return self.tables[:steps]

    def divisor(self, steps: int) -> Maps:
        """The divisor of the first steps; always the same object."""
        if steps not in self._maps:
            self._maps[steps] = Maps(tuple(self.albedos(steps)), self.control)
        return self._maps[steps]

    def chart(self, part: Part, steps: int) -> CompiledChart | SplitChart:
        """The chart for a part after some steps."""
        # A model that was pumped up by tables is not pumped up over that.
        chart: Any = part.chart
        if steps == 0:
            return chart
        return SplitChart(chart, self.divisor(steps))

    def doubt(self, steps: int) -> float:
        """Bound on the relative error of the divisor of so many steps, whatever L and V are."""
        total = 0.0
        for own in self.divisor(steps).errors:
            total += own + total
        # Tables are logarithms, whose errors add up.
        return math.expm1(total) if total < _HOPELESS else math.inf


@lru_cache(maxsize=32)
def stages(
    model: Model,
    control: str | None,
    rtol: float,
    stage: Callable[[Model, int, str | None, float], Model],
) -> Stages:
    """The stages of a model, shared by all that read them."""
    return Stages(model, control, rtol, stage)
