r"""Compensation: what microfacets lose to multiple scattering is given back.

With E the directional albedo of the model whose Fresnel factor is 1, and E_avg = 2 \int E mu dmu:

``kulla_conty``
    f + F_ms (1 - E(n.l)) (1 - E(n.v))/(pi (1 - E_avg)) (Kulla and Conty 2017, after Kelemen and
    Szirmay-Kalos 2001), with F_ms = F_avg^2 E_avg/(1 - F_avg (1 - E_avg)), all bounces from the
    second on, as Hill (2018) corrects it; the slides of 2017 print F_avg in place of F_avg^2.
``turquin``
    f (1 + F_0 (1 - E(n.v))/E(n.v)) (Turquin 2019), which is not reciprocal.
``pump``
    f/max(E(n.l), E(n.v)), for F = 1: one step of `albedo.pump`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from albedo._compile import kernel
from albedo.brdf import Kernel, Model, Parameter, Part
from albedo.charts.heights import LOWEST
from albedo.errors import InputError
from albedo.operators.asked import check_rtol
from albedo.operators.couple import check_model, part_of_lost, with_part
from albedo.operators.heights import HeightTable
from albedo.operators.pump import pump
from albedo.operators.surface import SurfaceTable, table_of

METHODS = ("kulla_conty", "turquin", "pump")
_EPS = float(np.finfo(np.float64).eps)


@dataclass(frozen=True)
class White:
    """A model without its Fresnel factor, and what that is.

    Attributes
    ----------
    model : Model
        With the factor 1.
    f0 : float
        The factor at normal incidence.
    average, error : float
        2 times the integral of F(u) u, and a bound on its error.
    """

    model: Model
    f0: float = 1.0
    average: float = 1.0
    error: float = 0.0


def white(model: Model) -> White:
    """Take the Fresnel factor from a model.

    Parameters
    ----------
    model : Model
        Of one term, all of which the factor multiplies.

    Returns
    -------
    White
        Models without a factor are returned as they are.

    Raises
    ------
    InputError
        Where a factor is there and cannot be taken away.
    """
    # Here, because most models have no need of these.
    from albedo.catalogue._fresnel import FresnelChoice
    from albedo.catalogue.ashikhmin_shirley import AshikhminShirley
    from albedo.catalogue.schlick import Schlick

    inner = [getattr(model, name) for name in ("base", "specular") if hasattr(model, name)]
    inner = [one for one in inner if isinstance(one, Model)]
    inner += [one for _, one in getattr(model, "terms", ())]
    if inner:
        if any(white(one).f0 != 1.0 for one in inner):
            raise InputError(f"{model.spec} has a Fresnel factor inside; compensate its terms")
        return White(model)
    if isinstance(model, FresnelChoice):
        if model.fresnel == "white":
            return White(model)
        if model.parameters.get("a_ud", 0.0) > 0.0:
            raise _not_alone(model)
        stored = {k: q.default for k, q in type(model)._declared.items()} | dict(model.parameters)
        kept = model.used({**stored, "fresnel": "white"})
        values = {k: v for k, v in model.parameters.items() if k in kept and k != "fresnel"}
        return White(type(model)(**values), *_factor(model))
    if isinstance(model, AshikhminShirley):
        if model.r_d > 0.0 and model.diffuse != "none" and model.r_s < 1.0:
            raise _not_alone(model)
        return White(model.replace(r_s=1.0), *_schlick(model.r_s))
    if isinstance(model, Schlick):
        if len(model._layers) > 1:
            raise _not_alone(model)
        return White(model.replace(color=1.0), *_schlick(float(model.color)))
    if model.name in ("granier_heidrich", "schwenk", "strauss"):
        raise _not_alone(model)
    return White(model)


def _not_alone(model: Model) -> InputError:
    return InputError(
        f"{model.spec} has terms that its Fresnel factor does not multiply; compensation is for "
        "a lobe alone"
    )


def _schlick(f0: float) -> tuple[float, float, float]:
    """F_0, and the average F_0 + (1 - F_0)/21."""
    return f0, f0 + (1.0 - f0) / 21.0, 4.0 * _EPS


def _factor(model: Any) -> tuple[float, float, float]:
    """F_0, the average of F, and a bound on its error: what half the points of the rule move it.

    A double exponential rule on both sides of the critical angle, as in `albedo.fresnel.average`:
    with twice the points the error is about the square.
    """
    code, a, b, _ = model.pack_fresnel()
    f0 = float(model.fresnel_factor(np.ones(1))[0])
    if code == 1:
        return _schlick(f0)
    index = code in (2, 3)
    n, k = (a, b if code == 3 else 0.0) if index else (1.0, 0.0)
    cut = math.sqrt(min(max((1.0 - n) * (1.0 + n) + k * k, 0.0), 1.0))
    t, step = np.linspace(-3.5, 3.5, 561, retstep=True)
    sinh, cosh = 0.5 * math.pi * np.sinh(t), 0.5 * math.pi * np.cosh(t)
    near, far = 1.0 / (1.0 + np.exp(-2.0 * sinh)), 1.0 / (1.0 + np.exp(2.0 * sinh))
    weight = 2.0 * near * far * cosh * float(step)
    terms = np.zeros_like(t)
    for low, high in ((0.0, cut), (cut, 1.0)):
        u = np.clip(np.where(t < 0.0, low + (high - low) * near, high - (high - low) * far), 0, 1)
        terms += 2.0 * (high - low) * weight * model.fresnel_factor(u) * u
    fine, coarse = float(terms.sum()), 2.0 * float(terms[::2].sum())
    return f0, fine, abs(fine - coarse) + 64.0 * _EPS


def multiple(
    average: tuple[float, float], lost: tuple[float, float], slides: bool = False
) -> tuple[float, float]:
    """F_ms, and a bound on its relative error.

    Parameters
    ----------
    average : tuple of float
        F_avg and its error.
    lost : tuple of float
        1 - E_avg and its error.
    slides : bool
        As the slides of 2017 have it.
    """
    (f, df), (q, dq) = average, lost
    power = 1 if slides else 2
    left = 1.0 - f * q
    value = f**power * (1.0 - q) / left
    if value == 0.0:
        return 0.0, 0.0
    # Of the logarithm, with the second order of what is small counted by doubling.
    error = power * df / f + dq / (1.0 - q) + (df * q + f * dq) / left
    return value, 2.0 * error + 16.0 * _EPS


@kernel
def _brighten(view, f0, out):
    for j in range(out.shape[0]):
        for i in range(out.shape[1]):
            out[j, i] *= (1.0 - f0) + f0 / view[j, i]


@dataclass(frozen=True, eq=False)
class _Turquin:
    """A kernel whose values are multiplied by 1 + F_0 (1 - E(n.v))/E(n.v)."""

    fill: Kernel
    table: HeightTable | SurfaceTable
    f0: float

    def __call__(
        self, wi: np.ndarray, wo: np.ndarray, h: np.ndarray, p: np.ndarray, out: np.ndarray
    ) -> None:
        """Fill `out`; see `albedo.brdf.Part`."""
        self.fill(wi, wo, h, p, out)
        view = np.empty(out.shape)
        self.table.fill(wo, view)
        _brighten(view, self.f0, out)


class Compensated(Model):
    """A model with what multiple scattering would add; made by `compensate`.

    Attributes
    ----------
    base : Model
        What was compensated.
    method : {"kulla_conty", "turquin"}
        How.
    slides : bool
        See `compensate`.
    rtol : float, optional
        What the albedos are tabulated to.
    """

    name = "compensate"
    title = "compensated for multiple scattering"
    base: Model
    method: str
    slides: bool
    rtol: float | None

    def __init__(self, base: Model, method: str, slides: bool, rtol: float | None) -> None:
        super().__init__()
        symmetric = method == "kulla_conty"
        sources = {
            "kulla_conty": ("hill2018", "kelemen2001", "kulla2017"),
            "turquin": ("turquin2019",),
        }
        said = {"base": base.spec, **dict(base.parameters), "method": method}
        values: dict[str, Any] = {
            "base": base,
            "method": method,
            "slides": slides,
            "rtol": rtol,
            "parameters": MappingProxyType(said | ({"slides": slides} if symmetric else {})),
            # E(n.v) alone is not symmetric.
            "reciprocal": base.reciprocal and symmetric,
            # Refused where the model does not; Turquin's promises it for one view, not one light.
            "conserves_energy": symmetric,
            "grazing_limit": base.grazing_limit,
            "references": tuple(dict.fromkeys((*sources[method], *base.references))),
            "equation": f"{method} over {base.equation}",
            "lowest_cosine": base.lowest_cosine,
            "resolved_width": base.resolved_width,
        }
        for key, value in values.items():
            object.__setattr__(self, key, value)

    def parameter_info(self) -> tuple[Parameter, ...]:  # type: ignore[override]
        """The parameters of the base, which `replace` changes."""
        return self.base.parameter_info()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Compensated) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    @property
    def _key(self) -> tuple[Any, ...]:
        return self.base, self.method, self.slides, self.rtol

    @property
    def spec(self) -> str:
        slides = ", slides=True" if self.slides else ""
        return f"compensate({self.base.spec}, {self.method}{slides})"

    @property
    def isotropic(self) -> bool:
        return self.base.isotropic

    @property
    def channels(self) -> int | None:
        return self.base.channels

    def channel(self, index: int) -> Model:
        return Compensated(self.base.channel(index), self.method, self.slides, self.rtol)

    def replace(self, **values: Any) -> Model:
        """A copy over a base with some parameters changed."""
        return Compensated(self.base.replace(**values), self.method, self.slides, self.rtol)

    def pack(self) -> tuple[float, ...]:
        return self.base.pack()

    def parts(self) -> tuple[Part, ...]:
        alone = white(self.base)
        if self.method == "kulla_conty":
            lost = table_of(alone.model, True, self.rtol).average
            share, error = multiple((alone.average, alone.error), lost, self.slides)
            more = part_of_lost(alone.model, share, error, self.rtol, "multiple")
            return with_part(self.base, more)
        # Here, because a model is sampled without knowing of operators.
        from albedo.sampling.mixture import routines_of

        table = table_of(alone.model, False, self.rtol)
        worst, parts = float(table.relative()), []
        for part in self.base.parts():
            own = part.doubt

            def doubt(cosines: np.ndarray | None, own: Any = own) -> Any:
                inherited = own(cosines) if callable(own) else own
                if cosines is None:
                    return inherited + worst
                # Where the lobe stands below all heights that are tabulated, so do most views.
                return inherited + np.where(cosines < LOWEST, table.relative(cosines), worst)

            routines = routines_of(part)
            parts.append(
                replace(
                    part,
                    fill=_Turquin(part.fill, table, alone.f0),
                    loss=None,
                    loss_chart=None,
                    doubt=doubt,
                    routine=part.routine or (routines[0] if len(routines) == 1 else None),
                )
            )
        return tuple(parts)

    def _over(self, wi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What Dirac parts are multiplied by, and its relative error."""
        alone = white(self.base)
        table = table_of(alone.model, False, self.rtol)
        c = wi[:, 2]
        factor = (1.0 - alone.f0) + alone.f0 / table.of(wi)
        return factor, np.where(c < LOWEST, table.relative(c), table.relative())

    def spikes(self, wi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        directions, weights = self.base.spikes(wi)
        if self.method == "kulla_conty" or not len(weights):
            return directions, weights
        # Orders of a grating leave in directions of their own.
        factor, _ = self._over(directions.reshape(-1, 3))
        return directions, weights * factor.reshape(weights.shape)

    def spike_errors(self, wi: np.ndarray, weights: np.ndarray) -> np.ndarray:
        if self.method == "kulla_conty" or not len(weights):
            return self.base.spike_errors(wi, weights)
        directions, own = self.base.spikes(wi)
        factor, error = (x.reshape(weights.shape) for x in self._over(directions.reshape(-1, 3)))
        return self.base.spike_errors(wi, own) * factor + error * weights


def compensate(
    model: Model, method: str = "kulla_conty", *, slides: bool = False, rtol: float | None = None
) -> Model:
    """Give a model what it loses to multiple scattering between its facets.

    Parameters
    ----------
    model : Model
        A lobe with or without a Fresnel factor. Without one E is its own albedo, and F = 1.
    method : {"kulla_conty", "turquin", "pump"}
        See this module. ``kulla_conty`` and ``pump`` keep the model reciprocal; ``turquin`` does
        not, because it reads the height of the viewer alone.
    slides : bool
        kulla_conty: F_ms with F_avg in place of F_avg^2, as printed in 2017. It is the same for
        F = 1.
    rtol : float, optional
        What E or 1 - E is to be worth, relative to it as far as it is known so well: 1e-10 by
        default, 1e-6 for anisotropic models, and as for `albedo.pump` for ``pump``. What is left
        of the error is part of every bound.

    Returns
    -------
    Model
        For F = 1 the albedo of ``kulla_conty`` is 1 in every direction, and that of ``turquin``
        for every fixed view.

    Raises
    ------
    InputError
        For a model whose terms do not share one Fresnel factor, whose E exceeds 1, or is 1
        everywhere (kulla_conty), or is not above 0 (turquin); for ``pump`` with a Fresnel factor.

    Examples
    --------
    >>> import albedo
    >>> rough = albedo.model("cook_torrance", m=0.5, distribution="ggx", geometry="smith")
    >>> print(albedo.directional_albedo(albedo.compensate(rough), 0.3))
    1.00000000(1) [bound]
    """
    base = check_model(model, "compensate")
    if method not in METHODS:
        raise InputError(f"method = {method!r} is unknown; choose one of {', '.join(METHODS)}")
    if not isinstance(slides, bool):
        raise InputError(f"slides = {slides!r} is neither True nor False")
    check_rtol(rtol)
    if method == "pump":
        if any(white(kind).f0 != 1.0 for kind in base.by_channel()):
            raise InputError(f"{base.spec} has a Fresnel factor; pumping-up compensates for F = 1")
        return pump(base, 1, rtol=rtol)
    compensated = Compensated(base, method, slides, rtol)
    for kind in compensated.by_channel():
        kind.parts()
    return compensated
