"""What is tested: a function of two directions whose values are looked at, or a model.

A function is called with two arrays (n, 3) of its own. What it returns wrong is an AssertionError,
what the assertions are asked for wrongly an InputError.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from albedo.brdf import Model
from albedo.directions import real_array, spherical
from albedo.errors import InputError
from albedo.testing._words import pair

Function = Callable[[np.ndarray, np.ndarray], Any]
"""``f(wi, wo)``: values (n,) at pairs of directions (n, 3)."""

RESOLVED = 0.03
"""Width in radians of the features that are looked for where nothing is declared."""

LOWEST = 1e-4
"""Smallest cosine of directions at which functions are looked at."""

_GOLDEN_TURN = math.pi * (3.0 - math.sqrt(5.0))

# Relative, between a function and itself turned: what a claim of isotropy may be off by.
_ALIKE = 1e-4


@dataclass(frozen=True)
class Values:
    """A function that is called with copies, and whose values are finite and not negative.

    Attributes
    ----------
    function : callable
    name : str
        How it is called in a failure.
    with_cosine : bool
        It returns f n.v: what is returned is divided by n.v.
    """

    function: Function
    name: str
    with_cosine: bool = False

    def __call__(self, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        """Values (n,) at pairs of directions (n, 3), all above the horizon."""
        found = self.function(wi.copy(), wo.copy())
        values = real_values(found, f"{self.name}(wi, wo)", len(wo))
        bad = ~(np.isfinite(values) & (values >= 0.0))
        if bad.any():
            k = int(np.argmax(bad))
            raise AssertionError(
                f"{self.name}(wi, wo) is {values[k]:.9g}; it must be finite and not negative "
                f"({np.count_nonzero(bad)} of {bad.size} places are not)\n{pair(wi[k], wo[k])}"
            )
        return values / wo[:, 2] if self.with_cosine else values

    def everywhere(self, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        """Values (...) at directions (..., 3), 0 where the view is below the horizon."""
        light, view = (v.reshape(-1, 3) for v in np.broadcast_arrays(wi, wo))
        above = view[:, 2] > 0.0
        values = np.zeros(len(view))
        values[above] = self(light[above], view[above])
        return values.reshape(wo.shape[:-1])


@dataclass(frozen=True)
class Declared:
    """What a user says about a function, as for `albedo.model_from`."""

    isotropic: bool = False
    lobe: str | None = None
    width: float | None = None
    resolved_width: float | None = None

    @property
    def finest(self) -> float:
        """Width of the narrowest features that are looked for, in radians."""
        return RESOLVED if self.resolved_width is None else self.resolved_width


@dataclass(frozen=True)
class Surface:
    """One BRDF with one channel: its values, and the model that is integrated."""

    values: Values
    model: Model


def real_values(found: Any, name: str, count: int) -> np.ndarray:
    """What a function returned, as float64 of shape (count,)."""
    values = np.asarray(found)
    if values.dtype.kind not in "fiub":
        raise AssertionError(
            f"{name} returned {type(found).__name__} of {values.dtype} for {count} places; it must "
            "return an array of real numbers"
        )
    if values.shape != (count,):
        raise AssertionError(
            f"{name} returned shape {values.shape} for {count} places; it must return ({count},)"
        )
    return values.astype(np.float64)


def function_of(f: Function | Model, name: str, with_cosine: bool = False) -> list[Values]:
    """The values of a function, or of each channel of a model.

    Raises
    ------
    InputError
        When `f` is neither, or is a model that is said to return f n.v.
    """
    if isinstance(f, Model):
        if with_cosine:
            raise InputError("with_cosine is about a function; a model returns f in 1/sr")
        return [Values(one.eval, _label(one)) for one in f.by_channel()]
    if not callable(f):
        raise InputError(f"{name} is {type(f).__name__}; it must be {name}(wi, wo) or a Model")
    return [Values(f, name, with_cosine)]


def surfaces(f: Function | Model, with_cosine: bool, declared: Declared) -> list[Surface]:
    """What is integrated of a function, or of each channel of a model.

    Raises
    ------
    InputError
        When `f` is neither, or what is declared of it is out of range or about a model.
    """
    from albedo.user import model_from

    every = function_of(f, "f", with_cosine)
    if isinstance(f, Model):
        for option, value in vars(declared).items():
            if value:
                raise InputError(f"{option} is about a function; a model knows itself")
        return [Surface(*both) for both in zip(every, f.by_channel(), strict=True)]
    model = model_from(
        every[0].everywhere,
        lobe=declared.lobe,
        width=declared.width,
        isotropic=declared.isotropic,
        resolved_width=declared.finest,
        name="f",
    )
    return [Surface(every[0], model)]


def _label(model: Model) -> str:
    channel = model.selected_channel
    return model.spec if channel is None else f"{model.spec}, channel {channel}: f"


def incidences(
    cos_theta: ArrayLike, phi: ArrayLike | None, around: int | None, expected: ArrayLike = 0.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cosines and azimuths of directions of incidence, and what is expected there, all flat.

    Parameters
    ----------
    cos_theta, phi, expected : array_like
        They broadcast.
    around : int or None
        Without `phi`: so many azimuths over half a turn for every cosine; None for one azimuth
        each, no two alike.

    Raises
    ------
    InputError
        When they are out of range, do not broadcast, or there are none.
    """
    from albedo.quadrature import check_directions

    c, p = check_directions(cos_theta, 0.0 if phi is None else phi)
    wanted = real_array(expected, "expected")
    if np.any(c == 0.0):
        raise InputError("cos_theta contains 0; directions of incidence lie above the horizon")
    if np.any(wanted < 0.0):
        raise InputError(f"expected contains {wanted.min():g}; an albedo is at least 0")
    if phi is None and around is None:
        p = np.reshape(_GOLDEN_TURN * np.arange(1, c.size + 1) % (2.0 * math.pi), c.shape)
    elif phi is None and around is not None:
        c, wanted = c[..., None], wanted[..., None]
        p = math.pi / around * np.arange(around)
    try:
        c, p, wanted = np.broadcast_arrays(c, p, wanted)
    except ValueError:
        raise InputError(
            f"expected of shape {wanted.shape} does not broadcast with the directions"
        ) from None
    if not c.size:
        raise InputError("cos_theta is empty; give one incidence at least")
    return c.ravel(), p.ravel(), wanted.ravel()


def lights(count: int, lowest: float, rng: np.random.Generator) -> np.ndarray:
    """Directions (count, 3), every second one next to the horizon."""
    w = _anywhere(count, rng)
    w[::2] = _grazing(len(w[::2]), lowest, rng)
    return w


def places(
    wi: np.ndarray, lowest: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of directions at which a BRDF may go wrong, (n, 3) each, for some lights.

    Each light with a view anywhere, one next to the horizon, one near the mirror direction and one
    near the light, from 1e-4 to 1 rad away; and pairs of directions along the axes, exactly.
    """
    count = len(wi)
    mirror, retro = (_near(w, lowest, rng) for w in (wi * (-1.0, -1.0, 1.0), wi))
    views = (_anywhere(count, rng), _grazing(count, lowest, rng), mirror, retro)
    axes = _axes(lowest)
    first, second = np.divmod(np.arange(len(axes) ** 2), len(axes))
    light = np.concatenate((np.tile(wi, (len(views), 1)), axes[first]))
    return light, np.concatenate((*views, axes[second]))


def _anywhere(count: int, rng: np.random.Generator) -> np.ndarray:
    return spherical(1.0 - rng.random(count), 2.0 * math.pi * rng.random(count))


def _grazing(count: int, lowest: float, rng: np.random.Generator) -> np.ndarray:
    cosine = np.geomspace(lowest, 0.1, 64)[rng.integers(64, size=count)]
    return spherical(cosine, 2.0 * math.pi * rng.random(count))


def _near(w: np.ndarray, lowest: float, rng: np.random.Generator) -> np.ndarray:
    angle = 10.0 ** rng.uniform(-4.0, 0.0, (len(w), 1))
    moved = w + angle * rng.standard_normal(w.shape)
    moved[:, 2] = np.maximum(np.abs(moved[:, 2]), lowest)
    length: np.ndarray = np.linalg.norm(moved, axis=1, keepdims=True)
    return moved / length


def _axes(lowest: float) -> np.ndarray:
    """The normal, and directions at three heights above the axes x and y, without rounding."""
    z = np.array([math.sqrt(0.5), 0.1, lowest])
    s = np.sqrt((1.0 - z) * (1.0 + z))
    turns = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))
    around = [np.stack((x * s, y * s, z), axis=1) for x, y in turns]
    return np.concatenate((np.array([[0.0, 0.0, 1.0]]), *around))


def look(values: Values, wi: np.ndarray, *, isotropic: bool = False) -> None:
    """Call a function where it may go wrong, before it is integrated.

    Parameters
    ----------
    values : Values
    wi : ndarray, shape (n, 3)
        The lights that it will be integrated for.
    isotropic : bool
        Whether it is said not to change when both directions turn about the normal.

    Raises
    ------
    AssertionError
        When a value is not finite, or negative, or changes in spite of `isotropic`.
    """
    rng = np.random.default_rng(0)
    light, view = places(np.repeat(wi, 32, axis=0), LOWEST, rng)
    found = values(light, view)
    if isotropic:
        turn = 2.0 * math.pi * rng.random(len(light))
        turned = values(*(_turned(w, turn) for w in (light, view)))
        _refuse_change(found, turned, light, view, values.name, turn)


def _refuse_change(
    found: np.ndarray,
    turned: np.ndarray,
    wi: np.ndarray,
    wo: np.ndarray,
    name: str,
    turn: np.ndarray,
) -> None:
    """Refuse a function that is not isotropic as it was said to be."""
    larger = np.maximum(found, turned)
    ratio = np.abs(found - turned) / np.where(larger > 1e-9, larger, np.inf)
    k = int(np.argmax(ratio))
    if ratio[k] > _ALIKE:
        raise AssertionError(
            f"{name}(wi, wo) is not isotropic, as isotropic=True says: it is {found[k]:.9g}, and "
            f"{turned[k]:.9g} with both directions turned by {math.degrees(turn[k]):.6g} deg about "
            f"the normal\n{pair(wi[k], wo[k])}"
        )


def _turned(w: np.ndarray, turn: np.ndarray) -> np.ndarray:
    c, s = np.cos(turn), np.sin(turn)
    x, y, z = w.T
    return np.stack((c * x - s * y, s * x + c * y, z), axis=1)
