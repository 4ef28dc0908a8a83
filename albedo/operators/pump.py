"""Pumping-up: a model over a symmetric function of its own albedo, so that less light is lost.

NNS eqs. 16 to 21. Each step makes f* = f/g with max(a(L), a(V)) <= g <= 1; where the albedo exceeds
1 somewhere the first step normalises it. What comes out is again a model: its values, its albedo
with a bound, its samples and tables are had as for any other.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from numbers import Integral
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from albedo._compile import is_kernel
from albedo._threads import blas_in_one
from albedo.brdf import Kernel, Model, Parameter, Part
from albedo.charts._compiled import CompiledChart
from albedo.charts.heights import LOWEST, folded
from albedo.directions import spherical
from albedo.errors import InputError
from albedo.estimate import Estimate
from albedo.operators.asked import FINEST, check_rtol
from albedo.operators.divisor import CONTROLS
from albedo.operators.ladder import Ladder, ladder, rings_of
from albedo.operators.stages import Stages, stages

_MOST_STEPS = 100
# What albedos are to be worth after all steps.
_GOAL = 1e-8
# What the albedos that are divided by are worth, as shares of that: the first of these that leaves
# an albedo less than that share. The first mostly does for twenty steps. Quadrature, which has the
# rest, gains digits for next to nothing.
_OF_CURVES, _LEFT = (0.07, 0.03, 0.01, 0.0025), 0.9
# Where none does, what they were asked for is tried so many times coarser, up to the default.
_COARSER = (10.0, 100.0)
# What tables are asked for where another goal is set, and what albedos that are divided by them are
# worth, in what they were asked for.
_OF_TABLES, _FOLD = 0.3, 1.2


class _Dividing(Protocol):
    """What knows the product of the divisors of some steps."""

    def divide(self, wi: np.ndarray, wo: np.ndarray, out: np.ndarray) -> None: ...


@dataclass(frozen=True, eq=False)
class _Divided:
    """A kernel whose values are divided."""

    fill: Kernel
    divisor: _Dividing

    def __call__(
        self, wi: np.ndarray, wo: np.ndarray, h: np.ndarray, p: np.ndarray, out: np.ndarray
    ) -> None:
        """Fill `out`; see `albedo.brdf.Part`."""
        self.fill(wi, wo, h, p, out)
        self.divisor.divide(wi, wo, out)


class Pumped(Model):
    """A model after some steps of pumping-up; made by `pump`.

    Attributes
    ----------
    base : Model
        What was pumped up.
    steps : int
        How often.
    control : {None, "literal", "cumulative"}
        See `pump`.
    rtol : float, optional
        What the albedos that the divisor reads were to be worth.
    goal : float
        What albedos are to be worth after all steps.
    """

    name = "pump"
    title = "pumped up"
    base: Model
    steps: int
    control: str | None
    rtol: float | None
    goal: float

    def __init__(
        self,
        base: Model,
        steps: int,
        control: str | None,
        rtol: float | None,
        goal: float = _GOAL,
    ) -> None:
        super().__init__()
        values: dict[str, Any] = {
            "base": base,
            "steps": steps,
            "control": control,
            "rtol": rtol,
            "goal": goal,
            "conserves_energy": steps > 0 or base.conserves_energy,
            "grazing_limit": base.grazing_limit,
            "references": ("neumann_pumping", *base.references),
            "equation": f"NNS eqs. 16 to 21 over {base.equation}",
            # Where albedos have no limit, none is known below the first height of the curves.
            "lowest_cosine": base.lowest_cosine if base.grazing_limit or not steps else LOWEST,
            "resolved_width": base.resolved_width,
        }
        kept = {"base": base.spec} if isinstance(base, Pumped) else {"base": base.name}
        own = {} if isinstance(base, Pumped) else dict(base.parameters)
        said = {**kept, **own, "steps": steps, "control": control, "rtol": rtol, "goal": goal}
        values["parameters"] = MappingProxyType(said)
        for key, value in values.items():
            object.__setattr__(self, key, value)

    def parameter_info(self) -> tuple[Parameter, ...]:  # type: ignore[override]
        """The parameters of the base, which `replace` changes."""
        return self.base.parameter_info()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Pumped) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    @property
    def _key(self) -> tuple[Any, ...]:
        return self.base, self.steps, self.control, self.rtol, self.goal

    @property
    def spec(self) -> str:
        control = "" if self.control is None else f", control={self.control}"
        return f"pump({self.base.spec}, steps={self.steps}{control})"

    @property
    def isotropic(self) -> bool:
        return self.base.isotropic

    @property
    def channels(self) -> int | None:
        return self.base.channels

    def channel(self, index: int) -> Model:
        return Pumped(self.base.channel(index), *self._key[1:])

    def replace(self, **values: Any) -> Model:
        """A copy over a base with some parameters changed."""
        return Pumped(self.base.replace(**values), *self._key[1:])

    @cached_property
    def _in_rings(self) -> bool:
        """Whether all parts have charts of rings, and no azimuth is told from another."""
        return self.base.isotropic and all(_is_ring(part) for part in self.base.parts())

    @property
    def usual_rtol(self) -> float:
        """The relative error that its albedos reach by default."""
        if self._in_rings or self.steps == 0:
            return self.goal
        return max(_FOLD * self._of_tables.reach(self.steps), self.goal)

    @property
    def _of_tables(self) -> Stages:
        rtol = self.rtol
        if rtol is None and self.goal != _GOAL:
            rtol = max(_OF_TABLES * self.goal, FINEST)
        return stages(self.base, self.control, rtol, _of_stage)

    @property
    def _steps(self) -> Ladder | Stages:
        """The albedos before every step, computed once for all models that read them."""
        return self._ladder if self._in_rings else self._of_tables

    @property
    def _ladder(self) -> Ladder:
        if self.rtol is not None:
            return self._climbed(self.rtol)
        known = [max(share * self.goal, FINEST) for share in _OF_CURVES]
        enough, tried = _LEFT * self.goal, []
        while known:
            tried.append(found := self._climbed(known[0]))
            left = found.worst(self.steps)
            if left <= enough:
                return found
            # What is left is about in proportion to what was asked for. Where not even the best of
            # them does, the first is as good.
            known = [rtol for rtol in known[1:] if left * rtol <= enough * known[0]]
        # What is asked for less may be worth more where there is no room for all pieces.
        coarser = [tried[0].rtol * fold for fold in _COARSER]
        tried += [self._climbed(rtol) for rtol in coarser if rtol <= _OF_CURVES[0] * _GOAL]
        return min(tried, key=lambda found: found.worst(self.steps))

    def _climbed(self, rtol: float) -> Ladder:
        """The albedos of all steps, for curves that are worth so much."""
        found, whole = ladder(self.base, self.control, rtol), False
        try:
            if len(found.curves) < self.steps:
                with blas_in_one:
                    while len(found.curves) < self.steps:
                        found.step()
                found.tidy()
            found.worst(self.steps)
            whole = True
        finally:
            if not whole:
                # It is shared, and what was interrupted in its midst is not to be gone on with.
                ladder.cache_clear()
        return found

    @property
    def albedos(self) -> tuple[Any, ...]:
        """The albedos a_0, ..., a_(k-1) that the steps divide by, with their errors.

        `albedo.operators.divisor.LogCurve` where the base is isotropic and its parts have rings,
        else `albedo.operators.maps.LogMap`.
        """
        return tuple(self._steps.albedos(self.steps))

    def albedo_before(self, step: int, cos_theta: ArrayLike, phi: ArrayLike = 0.0) -> Estimate:
        """The albedo a_k before a step, or after the last one.

        Where the steps are curves, those that they divide by are read, without a further integral.

        Parameters
        ----------
        step : int
            From 0, the base, to as many as the model has, which is its own albedo.
        cos_theta, phi : array_like
            Cosines of incidence in [2^-64, 1], and azimuths in radians.

        Returns
        -------
        Estimate
            Errors of a curve are its own, and what all curves before err by.

        Raises
        ------
        InputError
            For steps and cosines out of range.
        """
        if isinstance(step, bool) or not isinstance(step, Integral) or not 0 <= step <= self.steps:
            raise InputError(f"step = {step!r} is no whole number in [0, {self.steps}]")
        c = np.asarray(cos_theta, dtype=np.float64)
        if not np.all((c >= LOWEST) & (c <= 1.0)):
            raise InputError(f"cos_theta must lie in [{LOWEST:.3g}, 1]")
        if step == self.steps or not self._in_rings:
            from albedo.quadrature import directional_albedo

            stage = Pumped(self.base, int(step), *self._key[2:])
            return directional_albedo(stage, c, phi, rtol=stage.usual_rtol)
        c, _ = np.broadcast_arrays(c, np.asarray(phi, dtype=np.float64))
        found = self._ladder
        curve = found.curves[step]
        value, passed = curve(c), found.average(step, np.ravel(c)).reshape(c.shape)
        error = value * (curve.bound[curve.piece(folded(c))] + passed)
        known = np.ones(c.shape, dtype=bool)
        return Estimate(value, error, "bound", np.zeros(c.shape, dtype=int), known)

    @property
    def divisor(self) -> Any:
        """What the values of the base are divided by."""
        return self._steps.divisor(self.steps)

    def pack(self) -> tuple[float, ...]:
        return self.base.pack()

    def parts(self) -> tuple[Part, ...]:
        # Here, because a model is sampled without knowing of operators.
        from albedo.sampling.mixture import routines_of

        steps = self._steps
        divisor, error = steps.divisor(self.steps), self._error(steps)
        pumped = []
        for number, part in enumerate(self.base.parts()):
            own = part.doubt

            def doubt(cosines: np.ndarray | None, own: Any = own) -> Any:
                inherited = own(cosines) if callable(own) else own
                return inherited + error + self._beyond(cosines)

            pumped.append(
                replace(
                    part,
                    fill=_Divided(part.fill, divisor),
                    chart=steps.chart(part, self.steps),
                    rings=None,
                    loss=None,
                    loss_chart=None,
                    doubt=doubt,
                    average_doubt=self._average(steps, number, doubt),
                    # Its chart has them.
                    heights=(),
                    routine=routines_of(part),
                    # What users wrote in Python may not be meant for several threads.
                    shared=part.shared or is_kernel(part.fill),
                )
            )
        return tuple(pumped)

    def _error(self, steps: Ladder | Stages) -> float:
        """What the divisor may err by."""
        return steps.doubt(self.steps)

    def _average(
        self, steps: Ladder | Stages, number: int, doubt: Callable[[np.ndarray | None], Any]
    ) -> Callable[[np.ndarray, np.ndarray], np.ndarray] | None:
        """See `albedo.brdf.Part`: an albedo errs by an average of what values err by."""
        if isinstance(steps, Stages) and not steps.trusted(self.steps):
            return None
        if self._error(steps) == 0.0:
            return None

        def average(cosines: np.ndarray, phi: np.ndarray) -> np.ndarray:
            if isinstance(steps, Stages):
                passed = steps.average(self.base.parts()[number], self.steps, cosines, phi)
            else:
                passed = steps.average(self.steps, cosines, number)
            found: np.ndarray = doubt(cosines) - self._error(steps) + passed
            return found

        return average

    def _beyond(self, cosines: np.ndarray | None) -> Any:
        """What is unknown of the divisor where no albedo is known."""
        if self.base.grazing_limit or cosines is None:
            return 0.0
        return np.where(cosines < LOWEST, np.inf, 0.0)

    def sum_doubt(self, cos_theta: np.ndarray, phi: np.ndarray) -> np.ndarray | None:
        if self.steps == 0 or not self._in_rings:
            return None
        # Each part errs by its own average, and by what the base does.
        own = [part.doubt for part in self.base.parts()]
        inherited = np.zeros(cos_theta.size)
        for doubt in own:
            known = doubt(cos_theta) if callable(doubt) else doubt
            inherited = np.maximum(inherited, known)
        wi = spherical(cos_theta, phi)
        _, weights = self.base.spikes(wi)
        if len(weights):
            off = self.base.spike_errors(wi, weights) / np.maximum(weights, 1e-300)
            inherited = np.maximum(inherited, off.max(0))
        found: np.ndarray = inherited + self._ladder.average(self.steps, cos_theta)
        return found + self._beyond(cos_theta)

    def spikes(self, wi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        directions, weights = self.base.spikes(wi)
        return directions, weights * self._over(wi) if len(weights) else weights

    def spike_errors(self, wi: np.ndarray, weights: np.ndarray) -> np.ndarray:
        if not len(weights):
            return super().spike_errors(wi, weights)
        over = self._over(wi)
        own = self.base.spike_errors(wi, weights / over) * over
        return own + self._error(self._steps) * weights

    def _over(self, wi: np.ndarray) -> np.ndarray:
        """1/g(L, R)."""
        mirror = wi * np.array([-1.0, -1.0, 1.0])
        found: np.ndarray = 1.0 / self.divisor.between(wi, mirror)
        return found


class _Stage(Pumped):
    """A pumped model whose divisor is taken as exact: what it errs by is told elsewhere."""

    def _error(self, steps: Ladder | Stages) -> float:
        return 0.0

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Stage) and self._key == other._key

    def __hash__(self) -> int:
        return hash(("stage", self._key))


def _of_stage(base: Model, steps: int, control: str | None, rtol: float | None) -> Model:
    return _Stage(base, steps, control, rtol) if steps else base


def _is_ring(part: Part) -> bool:
    """Whether a part has a chart of rings."""
    try:
        rings_of(part)
    except InputError:
        return False
    return True


def _is_one(first: Pumped, steps: int, control: str | None) -> bool:
    """Whether two operators are one of more steps.

    Each step divides by what it is told alone. Only what keeps the product of all begins anew.
    """
    alike = first.control == control != "cumulative" or 0 in (first.steps, steps)
    return alike and first.steps + steps <= _MOST_STEPS


def pump(
    model: Model,
    steps: int = 1,
    control: str | None = None,
    *,
    rtol: float | None = None,
    goal: float = _GOAL,
) -> Pumped:
    """Pump a model up: divide it by a symmetric function of its albedo, again and again.

    Parameters
    ----------
    model : Model
        Reciprocal; it need not conserve energy.
    steps : int
        How often, from 0 to 100.
    control : {None, "literal", "cumulative"}
        What each step divides by: max(a(L), a(V)) (NNS eq. 20); that or n.l or n.v, if they are
        larger (eq. 21); or the first, but the product of all divisors is at least
        max(n.l, n.v).
    rtol : float, optional
        What the albedos that are divided by are to be worth, from 1e-12 to 1e-3. By default what
        the goal takes: 7% of it, or less where that leaves more than nine tenths of it in an
        albedo of n.l above a millionth; where they depend on the azimuth, or a part of an
        isotropic model has no rings, 3e-10 for the first and 3e-9 for later ones, or three tenths
        of a goal of your own. The error that they leave in the result is part of its bound.
    goal : float
        What albedos are to be worth after all steps, relatively, from 1e-12 to 1e-3: ask
        `albedo.directional_albedo` for the same. Where it is out of reach their bounds say so.

    Returns
    -------
    Pumped
        A model. Its albedos are computed when they are first needed.

    Raises
    ------
    InputError
        For a model that is not symmetric, or about which nothing is declared, and for steps or
        controls out of range.

    Examples
    --------
    >>> import albedo
    >>> brighter = albedo.pump(albedo.model("phong", n=20), steps=2)
    >>> print(albedo.directional_albedo(brighter, 0.1))
    0.790834366(2) [bound]
    """
    if not isinstance(model, Model):
        raise InputError(f"pump needs a model, not {type(model).__name__}")
    if not model.reciprocal:
        raise InputError(f"{model.spec} is not symmetric in its directions; pumping-up needs that")
    if isinstance(steps, bool) or not isinstance(steps, Integral) or not 0 <= steps <= _MOST_STEPS:
        raise InputError(f"steps = {steps!r} is no whole number in [0, {_MOST_STEPS}]")
    steps = int(steps)
    if control not in CONTROLS:
        raise InputError(f"control = {control!r} is unknown; choose None, literal or cumulative")
    check_rtol(rtol)
    check_rtol(goal, "goal")
    if isinstance(model, Pumped) and _is_one(model, steps, control):
        worth = [value for value in (model.rtol, rtol) if value is not None]
        least, kept = min(worth, default=None), control if steps else model.control
        return Pumped(model.base, model.steps + steps, kept, least, min(model.goal, goal))
    if isinstance(model, Pumped) and not model._in_rings:
        raise InputError(f"{model.spec} can be pumped up again without control only")
    for kind in model.by_channel():
        for part in kind.parts():
            if not isinstance(part.chart, CompiledChart):
                raise InputError(
                    f"{kind.spec} cannot be pumped up: nothing is declared of where its "
                    f"{part.name} part lies"
                )
    return Pumped(model, steps, control, rtol, goal)
