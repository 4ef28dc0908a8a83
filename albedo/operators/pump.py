"""Pumping-up: a model over a symmetric function of its own albedo, so that less light is lost.

NNS eqs. 16 to 21. Each step makes f* = f/g with max(a(L), a(V)) <= g <= 1; where the albedo exceeds
1 somewhere the first step normalises it. What comes out is again a model: its values, its albedo
with a bound, its samples and tables are had as for any other.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from albedo.brdf import Kernel, Model, Parameter, Part
from albedo.errors import InputError
from albedo.operators.divisor import CONTROLS, LOWEST, Divisor, LogCurve
from albedo.operators.ladder import Ladder, ladder, rings_of

_MOST_STEPS = 100
# What the albedos that are divided by are worth: twenty of them leave 1e-8.
_RTOL = 2e-10


@dataclass(frozen=True, eq=False)
class _Divided:
    """A kernel whose values are divided by what knows only the heights of both directions."""

    fill: Kernel
    divisor: Divisor

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
    rtol : float
        What the albedos that the divisor reads were to be worth.
    """

    name = "pump"
    title = "pumped up"
    base: Model
    steps: int
    control: str | None
    rtol: float

    def __init__(self, base: Model, steps: int, control: str | None, rtol: float) -> None:
        super().__init__()
        values: dict[str, Any] = {
            "base": base,
            "steps": steps,
            "control": control,
            "rtol": rtol,
            "conserves_energy": steps > 0 or base.conserves_energy,
            "grazing_limit": base.grazing_limit,
            "references": ("neumann_pumping", *base.references),
            "equation": f"NNS eqs. 16 to 21 over {base.equation}",
            "resolved_width": base.resolved_width,
        }
        kept = {"base": base.spec} if isinstance(base, Pumped) else {"base": base.name}
        own = {} if isinstance(base, Pumped) else dict(base.parameters)
        said = {**kept, **own, "steps": steps, "control": control, "rtol": rtol}
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
        return self.base, self.steps, self.control, self.rtol

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
        return Pumped(self.base.channel(index), self.steps, self.control, self.rtol)

    def replace(self, **values: Any) -> Model:
        """A copy over a base with some parameters changed."""
        return Pumped(self.base.replace(**values), self.steps, self.control, self.rtol)

    @property
    def _ladder(self) -> Ladder:
        """The albedos before every step, computed once for all models that read them."""
        found = ladder(self.base, self.control, self.rtol)
        while len(found.curves) < self.steps:
            found.step()
        return found

    @property
    def albedos(self) -> tuple[LogCurve, ...]:
        """The albedos a_0, ..., a_(k-1) that the steps divide by, with their errors."""
        return tuple(self._ladder.curves[: self.steps])

    @property
    def divisor(self) -> Divisor:
        """What the values of the base are divided by."""
        return self._ladder.divisor(self.steps)

    def pack(self) -> tuple[float, ...]:
        return self.base.pack()

    def parts(self) -> tuple[Part, ...]:
        # Here, because a model is sampled without knowing of operators.
        from albedo.sampling.mixture import routines_of

        divisor, error = self.divisor, self._ladder.doubt(self.steps)
        pumped = []
        for part in self.base.parts():
            chart = rings_of(part, divisor.levels)
            own = part.doubt
            # Lobes about the mirror direction have one routine.
            (routine,) = routines_of(part)

            def doubt(cosines: np.ndarray | None, own: Any = own) -> Any:
                inherited = own(cosines) if callable(own) else own
                if self.base.grazing_limit or cosines is None:
                    return inherited + error
                return inherited + error + np.where(cosines < LOWEST, np.inf, 0.0)

            pumped.append(
                replace(
                    part,
                    fill=_Divided(part.fill, divisor),
                    chart=chart,
                    loss=None,
                    loss_chart=None,
                    doubt=doubt,
                    routine=routine,
                )
            )
        return tuple(pumped)

    def spikes(self, wi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        directions, weights = self.base.spikes(wi)
        return directions, weights * self._over(wi) if len(weights) else weights

    def spike_errors(self, wi: np.ndarray, weights: np.ndarray) -> np.ndarray:
        if not len(weights):
            return super().spike_errors(wi, weights)
        over = self._over(wi)
        own = self.base.spike_errors(wi, weights / over) * over
        return own + self._ladder.doubt(self.steps) * weights

    def _over(self, wi: np.ndarray) -> np.ndarray:
        """1/g(L, R)."""
        return np.exp(-self.divisor.logs(wi[:, 2], wi[:, 2]))


def pump(
    model: Model, steps: int = 1, control: str | None = None, *, rtol: float = _RTOL
) -> Pumped:
    """Pump a model up: divide it by a symmetric function of its albedo, again and again.

    Parameters
    ----------
    model : Model
        Reciprocal and isotropic; it need not conserve energy.
    steps : int
        How often, from 0 to 100.
    control : {None, "literal", "cumulative"}
        What each step divides by: max(a(L), a(V)) (NNS eq. 20); that or n.l or n.v, if they are
        larger (eq. 21); or the first, but the product of all divisors is at least
        max(n.l, n.v).
    rtol : float
        What the albedos that are divided by are to be worth. The error that they leave in the
        result is part of its bound.

    Returns
    -------
    Pumped
        A model. Its albedos are computed when they are first needed.

    Raises
    ------
    InputError
        For a model that is not symmetric, or not isotropic, or whose lobes do not lie about the
        mirror direction, and for steps or controls out of range.

    Examples
    --------
    >>> import albedo
    >>> brighter = albedo.pump(albedo.model("phong", n=20), steps=2)
    >>> print(albedo.directional_albedo(brighter, 0.1))
    0.790834366(4) [bound]
    """
    if not isinstance(model, Model):
        raise InputError(f"pump needs a model, not {type(model).__name__}")
    if not model.reciprocal:
        raise InputError(f"{model.spec} is not symmetric in its directions; pumping-up needs that")
    if not model.isotropic:
        raise InputError(f"{model.spec} is anisotropic; pumping-up is for isotropic models")
    if not isinstance(steps, int) or isinstance(steps, bool) or not 0 <= steps <= _MOST_STEPS:
        raise InputError(f"steps = {steps!r} is out of range; it lies in [0, {_MOST_STEPS}]")
    if control not in CONTROLS:
        raise InputError(f"control = {control!r} is unknown; choose None, literal or cumulative")
    if not 1e-12 <= rtol <= 1e-3:
        raise InputError(f"rtol = {rtol!r} is out of range; it lies in [1e-12, 1e-3]")
    for kind in model.by_channel():
        for part in kind.parts():
            rings_of(part)
    return Pumped(model, steps, control, rtol)
