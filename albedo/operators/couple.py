r"""Coupling: a diffuse part for the light that a specular one leaves, in both directions.

Ashikhmin and Shirley 2000, sect. 3, after Shirley, Hu, Smits and Lafortune 1997. With the
directional albedo R of the specular model,

    f_d = R_d (1 - R(n.l)) (1 - R(n.v))/(pi (1 - R_avg)),    R_avg = 2 \int R(mu) mu dmu,

which is symmetric in both directions, and reflects R_d (1 - R(n.l)): for R_d = 1, what is left.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from albedo._compile import kernel
from albedo.brdf import Color, Model, Parameter, Part
from albedo.charts.heights import HeightsChart
from albedo.errors import InputError
from albedo.operators.asked import check_rtol
from albedo.operators.heights import HeightTable
from albedo.operators.surface import SurfaceTable, table_of
from albedo.sampling.routines import COSINE


@kernel
def _products(light, view, scale, out):
    for j in range(out.shape[0]):
        for i in range(out.shape[1]):
            out[j, i] = scale * light[j] * view[j, i]


@dataclass(frozen=True, eq=False)
class _Product:
    """A kernel: a number times what a table says for both directions."""

    table: HeightTable | SurfaceTable
    scale: float

    def __call__(
        self, wi: np.ndarray, wo: np.ndarray, h: np.ndarray, p: np.ndarray, out: np.ndarray
    ) -> None:
        """Fill `out`; see `albedo.brdf.Part`."""
        light, view = np.empty(wi.shape[1]), np.empty(out.shape)
        self.table.fill(wi, light)
        self.table.fill(wo, view)
        _products(light, view, self.scale, out)


def part_of_lost(
    model: Model, share: float, error: float, rtol: float | None, name: str = "diffuse"
) -> Part | None:
    """The part that sends on a share of the light that a model loses: share (1 - a(L)).

    Parameters
    ----------
    model : Model
        With an albedo not above 1.
    share : float
        Of what is lost, in [0, 1].
    error : float
        Its relative error.
    rtol : float, optional
        What 1 - a is to be worth.
    name : str
        Of the part.

    Returns
    -------
    Part or None
        None where the share is 0.

    Raises
    ------
    InputError
        Where the albedo exceeds 1, or is 1 everywhere, as well as that is known.
    """
    table = table_of(model, True, rtol)
    average, wide = table.average
    if average <= 2.0 * wide:
        raise InputError(
            f"{model.spec} reflects all light, or loses less of it than is known (at most "
            f"{average + wide:.1g} on average); nothing is left to send on"
        )
    if share == 0.0:
        return None
    # What views are worth: on average for the albedo, and on the worst piece for other weights.
    views = wide / average + max(wide / average, table.worst)

    def doubt(cosines: np.ndarray | None) -> Any:
        return table.relative(cosines) + views + error

    chart = HeightsChart(edges=table.edges, turns=table.turns)
    fill = _Product(table, share / (math.pi * average))
    return Part(name, fill, chart, columns=(0, 0), doubt=doubt, routine=COSINE)


class Coupled(Model):
    """A specular model over a diffuse one, coupled to it; made by `couple`.

    Attributes
    ----------
    specular : Model
        What reflects first.
    rtol : float
        What its albedo, and 1 less it, is tabulated to.
    """

    name = "couple"
    title = "coupled to a diffuse part"
    diffuse_albedo = Color(1.0, "R_d: share that is reflected of what comes through", high=1.0)
    specular: Model
    rtol: float | None

    def __init__(self, specular: Model, diffuse_albedo: Any, rtol: float | None) -> None:
        super().__init__(diffuse_albedo=diffuse_albedo)
        said = {
            "specular": specular.spec,
            **{k: v for k, v in specular.parameters.items() if k != "diffuse_albedo"},
            "diffuse_albedo": self.parameters["diffuse_albedo"],
        }
        values: dict[str, Any] = {
            "specular": specular,
            "rtol": rtol,
            "parameters": MappingProxyType(said),
            "reciprocal": specular.reciprocal,
            # Refused where the specular model does not.
            "conserves_energy": True,
            "grazing_limit": specular.grazing_limit,
            "references": tuple(
                dict.fromkeys(("ashikhmin2000", "shirley1997", *specular.references))
            ),
            "equation": f"AS eq. 12 over {specular.equation}",
            "lowest_cosine": specular.lowest_cosine,
            "resolved_width": specular.resolved_width,
        }
        for key, value in values.items():
            object.__setattr__(self, key, value)
        own = self.parameters["diffuse_albedo"]
        count = len(own) if isinstance(own, tuple) else None
        if count is not None and specular.channels not in (None, count):
            raise InputError(
                f"diffuse_albedo has {count} channels, but {specular.spec} has "
                f"{specular.channels}; they must have equally many"
            )

    def parameter_info(self) -> tuple[Parameter, ...]:  # type: ignore[override]
        """The diffuse albedo, and the parameters of the specular model."""
        known = [q for q in self.specular.parameter_info() if q.name != "diffuse_albedo"]
        return (*super().parameter_info(), *known)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Coupled) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    @property
    def _key(self) -> tuple[Any, ...]:
        return self.specular, self.parameters["diffuse_albedo"], self.rtol

    @property
    def spec(self) -> str:
        return f"couple({self.specular.spec}, diffuse_albedo={self.parameters['diffuse_albedo']!r})"

    @property
    def isotropic(self) -> bool:
        return self.specular.isotropic

    @property
    def channels(self) -> int | None:
        own = self.parameters["diffuse_albedo"]
        return len(own) if isinstance(own, tuple) else self.specular.channels

    def channel(self, index: int) -> Model:
        count = self.channels
        if count is None or not 0 <= index < count:
            raise InputError(f"{self.spec} has no channel {index}; it has {count or 'none'}")
        own, specular = self.parameters["diffuse_albedo"], self.specular
        return Coupled(
            specular if specular.channels is None else specular.channel(index),
            own[index] if isinstance(own, tuple) else own,
            self.rtol,
        )

    def replace(self, **values: Any) -> Model:
        """A copy with another diffuse albedo, or with some parameters of the specular changed."""
        own = values.pop("diffuse_albedo", self.parameters["diffuse_albedo"])
        return Coupled(self.specular.replace(**values), own, self.rtol)

    def pack(self) -> tuple[float, ...]:
        return self.specular.pack()

    @property
    def _diffuse(self) -> Part | None:
        share = float(self.parameters["diffuse_albedo"])
        return part_of_lost(self.specular, share, 0.0, self.rtol)

    def simpler(self) -> dict[str, Model]:
        """Lambert's diffuse term; and what the specular model may leave out."""
        from albedo.catalogue.lambert import Lambert

        found: dict[str, Model] = {}
        if self.diffuse_albedo > 0.0:
            lambert = Lambert(rho=self.diffuse_albedo)
            found["the coupling of the diffuse term"] = self.specular + lambert
        return found

    def parts(self) -> tuple[Part, ...]:
        return with_part(self.specular, self._diffuse)

    def spikes(self, wi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self.specular.spikes(wi)

    def spike_errors(self, wi: np.ndarray, weights: np.ndarray) -> np.ndarray:
        return self.specular.spike_errors(wi, weights)

    def grazing_albedo(self) -> float | None:
        known = self.specular.grazing_albedo()
        share = float(self.parameters["diffuse_albedo"])
        return None if known is None else known + share * (1.0 - known)


def with_part(model: Model, more: Part | None) -> tuple[Part, ...]:
    """The parts of a model, whose losses are no longer those of the whole, and one more."""
    parts = model.parts()
    if more is None:
        return parts
    names = {part.name for part in parts}
    label = more.name
    while label in names:
        label += "_2"
    return (
        *(replace(part, loss=None, loss_chart=None) for part in parts),
        replace(more, name=label),
    )


def check_model(model: object, operator: str) -> Model:
    """A model, or InputError."""
    if not isinstance(model, Model):
        raise InputError(f"{operator} needs a model, not {type(model).__name__}")
    return model


def couple(specular: Model, diffuse_albedo: Any = 1.0, *, rtol: float | None = None) -> Coupled:
    """Add a diffuse part to a model, for the light that the model does not reflect.

    f_d = R_d (1 - R(n.l)) (1 - R(n.v))/(pi (1 - R_avg)), R being the directional albedo of the
    model, Dirac parts included, and R_avg its average (Ashikhmin and Shirley 2000, eq. 12; Shirley,
    Hu, Smits and Lafortune 1997).

    Parameters
    ----------
    specular : Model
        With an albedo that is nowhere above 1. If it is not reciprocal, R is taken over views for
        given lights: what is added is symmetric, and the whole is not.
    diffuse_albedo : float or tuple of float
        R_d in [0, 1]; a tuple has one for each channel.
    rtol : float, optional
        What 1 - R is to be worth, relative to it as far as R is known so well: 1e-10 by default,
        and 1e-6 for anisotropic models. What is left of the error is part of every bound.

    Returns
    -------
    Coupled
        A model with the albedo R + R_d (1 - R).

    Raises
    ------
    InputError
        For a model whose albedo exceeds 1, or is 1 everywhere, and for numbers out of range.

    Examples
    --------
    >>> import albedo
    >>> gloss = albedo.model("ashikhmin_shirley", n=100, r_s=0.05)
    >>> print(albedo.directional_albedo(albedo.couple(gloss, 0.5), 0.3))
    0.53766441(2) [bound]
    """
    model = check_model(specular, "couple")
    check_rtol(rtol)
    coupled = Coupled(model, diffuse_albedo, rtol)
    for kind in coupled.by_channel():
        kind.parts()
    return coupled
