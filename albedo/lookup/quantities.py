"""What a table may hold of a model."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from albedo.averages import average_albedo
from albedo.brdf import Model
from albedo.errors import InputError
from albedo.lookup.reference import Coordinate, Function
from albedo.quadrature import albedo_rows

QUARTER = 0.5 * math.pi
"""Azimuths of a model that is symmetric about its tangent and its bitangent."""


@dataclass(frozen=True)
class Quantity:
    """What a table holds.

    Attributes
    ----------
    name : str
    channels : tuple of str
        What each number of a texel is called.
    meaning : str
        In a few words.
    directional : bool
        Whether it depends on a direction.
    """

    name: str
    channels: tuple[str, ...]
    meaning: str
    directional: bool = True


QUANTITIES = {
    q.name: q
    for q in (
        Quantity("albedo", ("albedo",), "directional albedo a"),
        Quantity("complement", ("complement",), "what is lost of the light, 1 - a"),
        Quantity(
            "split_sum",
            ("f0", "f90"),
            "a = F0 f0 + F90 f90 for Schlick's Fresnel factor F0 + (F90 - F0)(1 - v.h)^5",
        ),
        Quantity(
            "average", ("average",), "average albedo, 2 times the integral of a mu dmu", False
        ),
    )
}
"""Everything that a table may hold, by name."""


def quantity_of(name: str) -> Quantity:
    """The quantity of a name.

    Raises
    ------
    InputError
        If it is unknown.
    """
    if name not in QUANTITIES:
        raise InputError(f"quantity = {name!r} is unknown; choose one of {', '.join(QUANTITIES)}")
    return QUANTITIES[name]


def subject_of(
    model: Model | str, ranges: Mapping[str, tuple[float, float]] | None, what: str
) -> tuple[Model, dict[str, tuple[float, float]]]:
    """A model of one channel, and between which numbers its parameters vary.

    Parameters
    ----------
    model : Model or str
        In the grammar a sweep says between which numbers.
    ranges : mapping of str to (float, float), optional
        These count where both say so.
    what : str
        Who asks, for what is said.

    Raises
    ------
    InputError
        For what is no model, or has several channels.
    """
    found = dict(ranges or {})
    if isinstance(model, str):
        from albedo.grammar import parse_ranges

        model, swept = parse_ranges(model)
        found = swept | found
    if not isinstance(model, Model):
        raise InputError(f"{what} needs a model or its name, not {type(model).__name__}")
    if model.channels is not None:
        raise InputError(
            f"{model.spec} has {model.channels} channels; {what} one of them, model.channel(i)"
        )
    return model, found


def coordinates_of(
    model: Model,
    ranges: Mapping[str, tuple[float, float]],
    quantity: Quantity,
    cosines: tuple[float, float],
) -> tuple[Coordinate, ...]:
    """The domain of a table: parameters that vary, then the azimuth and the cosine.

    Parameters
    ----------
    model : Model
    ranges : mapping of str to (float, float)
        Between which numbers parameters vary.
    quantity : Quantity
    cosines : (float, float)
        The smallest and the largest cosine of the angle to the normal.

    Raises
    ------
    InputError
        For ranges that are none, or an albedo that grows without limit within them.
    """
    found = []
    for name, (low, high) in ranges.items():
        if not low < high:
            raise InputError(f"{name} = {low:g}..{high:g} is no range; it goes upwards")
        found.append(Coordinate(name, float(low), float(high)))
    ends = [_at(model, found, high) for high in (False, True)]
    if quantity.directional:
        low, high = cosines
        if not 0.0 <= low < high <= 1.0:
            raise InputError(f"cosines = ({low:g}, {high:g}) are no range in [0, 1]")
        if low == 0.0 and not all(m.grazing_limit for m in ends):
            raise InputError(
                f"the albedo of {model.spec} grows without limit towards grazing incidence; give "
                "the smallest cosine that the table shall have"
            )
        if not all(m.isotropic for m in ends):
            found.append(Coordinate("phi", 0.0, QUARTER))
        found.append(Coordinate("cos_theta", float(low), float(high)))
    if not 1 <= len(found) <= 3:
        raise InputError(f"a table has 1 to 3 axes; this one would have {len(found)}")
    return tuple(found)


def _at(model: Model, coordinates: Sequence[Coordinate], high: bool) -> Model:
    """The model at an end of all ranges."""
    return model.replace(**{c.name: c.high if high else c.low for c in coordinates})


def functions_of(
    model: Model,
    quantity: Quantity,
    coordinates: Sequence[Coordinate],
    error: float,
    relative: bool,
    fixed: str = "light",
) -> list[Function]:
    """Values of each channel, with bounds far below an error."""
    rtol = max(error if relative else 0.0, 1e-13)
    atol = 0.0 if relative else error
    names = [c.name for c in coordinates]

    def rows(kind: Callable[[Model], Model], complement: bool) -> Function:
        def values(columns: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
            own = dict(zip(names, columns, strict=True))
            count = columns[0].size
            phi, cosine = own.pop("phi", np.zeros(count)), own.pop("cos_theta", np.ones(count))
            models = [kind(m) for m in _models(model, own, count)]
            found = albedo_rows(
                *(models, cosine, phi),
                rtol=rtol,
                atol=atol,
                fixed=fixed,
                complement=complement,
                shared=True,
            )
            return found.value, found.error

        return values

    def averages(columns: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        models = _models(model, dict(zip(names, columns, strict=True)), columns[0].size)
        found = [average_albedo(m, rtol=rtol, atol=atol, fixed=fixed) for m in models]
        return np.array([float(f.value) for f in found]), np.array([float(f.error) for f in found])

    if quantity.name == "average":
        return [averages]
    if quantity.name == "split_sum":
        white, edge = _schlick(1.0), _schlick(0.0)
        whole, rest = rows(white, False), rows(edge, False)

        def difference(columns: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
            (a, doubt), (b, own) = whole(columns), rest(columns)
            return a - b, doubt + own

        return [difference, rest]
    return [rows(lambda m: m, quantity.name == "complement")]


def _schlick(f0: float) -> Callable[[Model], Model]:
    """A model with Schlick's Fresnel factor of one F0, and F90 = 1."""
    known: dict[int, tuple[Model, Model]] = {}

    def changed(model: Model) -> Model:
        if id(model) not in known:
            try:
                known[id(model)] = model, model.replace(fresnel="schlick", f0=f0)
            except InputError as error:
                raise InputError(
                    f"split_sum needs a model with Schlick's Fresnel factor, fresnel=schlick and "
                    f"f0; {model.name} has none"
                ) from error
        return known[id(model)][1]

    return changed


def _models(model: Model, values: Mapping[str, np.ndarray], count: int) -> list[Model]:
    """The model for sets of parameters, one object for each that differs."""
    if not values:
        return [model] * count
    distinct, which = np.unique(np.array(list(values.values())), axis=1, return_inverse=True)
    made = [
        model.replace(**dict(zip(values, column, strict=True))) for column in distinct.T.tolist()
    ]
    return [made[i] for i in which.ravel()]
