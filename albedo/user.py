"""A BRDF of one's own, plain numpy, as a model like any other."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from albedo.brdf import Model, Part
from albedo.charts.cosine import CosineChart
from albedo.charts.polar import PolarChart
from albedo.charts.scan import ScanChart
from albedo.errors import InputError

LOBES = ("mirror", "half", "retro", "diffuse")


class UserModel(Model):
    """A model made from a function by `model_from`."""

    name = "user"
    title = "a function given by the user"

    def __init__(
        self,
        function: Callable[[np.ndarray, np.ndarray], np.ndarray],
        part: Part,
        resolved_width: float,
        promises: dict[str, bool],
        label: str,
    ) -> None:
        super().__init__()
        values = {
            "function": function,
            "resolved_width": resolved_width,
            "name": label,
            **{k: promises[k] for k in ("reciprocal", "conserves_energy")},
        }
        for key, value in values.items():
            object.__setattr__(self, key, value)
        object.__setattr__(self, "_part", part)
        object.__setattr__(self, "_isotropic", promises["isotropic"])

    def __eq__(self, other: object) -> bool:
        return self is other

    def __hash__(self) -> int:
        return id(self)

    @property
    def isotropic(self) -> bool:
        return bool(vars(self)["_isotropic"])

    def replace(self, **values: Any) -> Model:
        if values:
            raise InputError(
                f"{self.name} is a function and has no parameter {next(iter(values))!r}"
            )
        return self

    def pack(self) -> tuple[float, ...]:
        return ()

    def parts(self) -> tuple[Part, ...]:
        return (vars(self)["_part"],)


def model_from(
    function: Callable[[np.ndarray, np.ndarray], np.ndarray],
    *,
    lobe: str | None = None,
    width: float | None = None,
    isotropic: bool = False,
    reciprocal: bool = False,
    conserves_energy: bool = False,
    resolved_width: float = 1e-3,
    name: str = "user",
) -> UserModel:
    """Make a model of a function ``f(wi, wo)``.

    Parameters
    ----------
    function : callable
        Takes two arrays of unit vectors of shape (..., 3), both above the horizon, and returns
        the values in 1/sr, shape (...).
    lobe : {"mirror", "half", "retro", "diffuse"}, optional
        Where the mass lies: about the mirror direction, about H = N, about the light itself, or
        everywhere. Without it the hemisphere is scanned.
    width : float, optional
        Width of the lobe in radians; goes with `lobe`, except for ``diffuse``.
    isotropic, reciprocal, conserves_energy : bool
        What the function promises; an isotropic one needs half the work.
    resolved_width : float
        Without `lobe`: the feature width, in radians, down to which the bound is to hold. The
        neighbourhoods of the mirror direction, of the light and of the normal are probed down
        to 1e-8 rad in any case. The work grows as its inverse square.
    name : str
        How the model calls itself.

    Returns
    -------
    UserModel
        Every result made from it carries the resolved width, and prints it.

    Raises
    ------
    InputError
        For an unknown lobe or a width out of range.

    Examples
    --------
    >>> import albedo, numpy as np
    >>> half = albedo.model_from(lambda wi, wo: np.full(wo.shape[:-1], 0.5 / np.pi), lobe="diffuse")
    >>> print(albedo.directional_albedo(half, 0.3, rtol=1e-6))
    0.500000000000(1) [bound, features of 0.001 rad]
    """
    if not callable(function):
        raise InputError(f"model_from needs a function f(wi, wo), not {type(function).__name__}")
    if lobe is not None and lobe not in LOBES:
        raise InputError(f"lobe = {lobe!r} is unknown; choose one of {', '.join(LOBES)}")
    if lobe in ("mirror", "half", "retro") and width is None:
        raise InputError(f"lobe = {lobe!r} needs a width in radians")
    for label, value in (("width", width), ("resolved_width", resolved_width)):
        if value is not None and not 1e-8 <= value <= math.pi:
            raise InputError(f"{label} = {value!r} is out of range; it lies in [1e-8, pi]")
    chart: Any = ScanChart(resolved_width)
    radial = 1.0
    if lobe == "diffuse":
        chart = CosineChart("max")
    elif lobe is not None and width is not None:
        kind = {"mirror": "mirror_hemisphere", "half": "slope", "retro": "retro_hemisphere"}[lobe]
        chart = PolarChart(kind, "max")
        radial = width if lobe == "half" else 0.5 * width
        resolved_width = min(resolved_width, width)

    def fill(wi: np.ndarray, wo: np.ndarray, h: np.ndarray, p: np.ndarray, out: np.ndarray) -> None:
        view = np.moveaxis(wo, 0, -1)
        light = np.broadcast_to(np.moveaxis(wi, 0, -1)[:, None, :], view.shape)
        above = view[..., 2] > 0
        values = np.asarray(function(light, view))
        if values.shape != above.shape or np.iscomplexobj(values):
            raise InputError(
                f"{name}: f(wi, wo) returned {values.dtype} of shape {values.shape} for "
                f"directions of shape {view.shape}; it must return real values of shape "
                f"{above.shape}"
            )
        bad = ~np.isfinite(values) & above
        if bad.any():
            where = np.argwhere(bad)[0]
            raise InputError(
                f"{name}: f(wi, wo) is {values[tuple(where)]} at wi = "
                f"{light[tuple(where)].tolist()}, wo = {view[tuple(where)].tolist()}; it must be "
                "finite above the horizon"
            )
        out[...] = np.where(above, values, 0.0)

    promises = {
        "isotropic": isotropic,
        "reciprocal": reciprocal,
        "conserves_energy": conserves_energy,
    }
    part = Part("user", fill, chart, (radial, radial))
    return UserModel(function, part, resolved_width, promises, name)
