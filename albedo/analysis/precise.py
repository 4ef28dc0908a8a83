"""BRDFs in other arithmetic: the formulas as they stand, in 50 digits or in float32.

A kernel is a function of plain arithmetic and of `math`, whose source can be run with other
numbers: the same operations in the same order, with numbers of mpmath, which tells how many digits
float64 loses, or with float32, which rounds every operation as a graphics card does. What is in
float64 once and for all, the packed parameters and the constants in the source, stays what it is.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from types import SimpleNamespace
from typing import Any

import numpy as np

from albedo._compile import is_kernel, stands_for, translated
from albedo.brdf import Model, Part
from albedo.errors import InputError
from albedo.special import bessel_j

# Functions that numpy, mpmath and `math` call by the same names.
_PLAIN = (
    *("exp", "log", "sqrt", "sin", "cos", "tan"),
    *("sinh", "cosh", "tanh", "log1p", "expm1", "hypot"),
)

DIGITS = 50
"""Digits of the precise arithmetic."""


@dataclass(frozen=True, eq=False)
class Arithmetic:
    """Numbers, and functions of them.

    Attributes
    ----------
    name : str
    number : callable
        Makes a number from a float.
    dtype : type
        Of arrays of numbers.
    functions : mapping of str to callable or number
        What `math` and `albedo.special` have, by their names there.
    """

    name: str
    number: Callable[[Any], Any]
    dtype: type
    functions: Mapping[str, Any]

    def array(self, values: Any) -> np.ndarray:
        """An array of numbers of the same shape."""
        given = np.asarray(values)
        if self.dtype is not object:
            return given.astype(self.dtype)
        found = np.empty(given.shape, object)
        for place, value in np.ndenumerate(given):
            found[place] = self.number(value)
        return found


@cache
def single() -> Arithmetic:
    """IEEE single precision, every operation rounded."""
    from scipy.special import erfc, jv

    def of(function: Any) -> Callable[..., Any]:
        return lambda *args: function(*(np.float32(arg) for arg in args))

    names = (*_PLAIN, "floor", "isfinite", "isnan")
    functions: dict[str, Any] = {name: of(getattr(np, name)) for name in names}
    others = {"asin": "arcsin", "acos": "arccos", "atan": "arctan", "atan2": "arctan2"}
    functions |= {name: of(getattr(np, other)) for name, other in others.items()}
    constants: dict[str, Any] = {"pi": np.float32(math.pi), "inf": np.float32(math.inf)}
    functions |= {"erfc": of(erfc), "fabs": abs, "bessel_j": of(jv), **constants}
    return Arithmetic("float32", np.float32, np.float32, functions)


@cache
def precise() -> Arithmetic:
    """Fifty digits."""
    import mpmath

    # A context of its own: its precision is nobody else's.
    context = mpmath.MPContext()
    context.dps = DIGITS
    names = (*_PLAIN, "asin", "acos", "atan", "atan2")
    functions: dict[str, Any] = {name: getattr(context, name) for name in names}
    functions |= {name: getattr(context, name) for name in ("erfc", "floor", "isfinite", "isnan")}
    functions |= {"bessel_j": _bessel_j(context)}
    functions |= {"fabs": abs, "pi": +context.pi, "inf": context.inf}
    # numpy's functions of arrays of objects are the methods of these.
    methods = {**{k: functions[k] for k in names}, "rint": context.nint, "floor": context.floor}
    methods |= {"arc" + k[1:]: functions[k] for k in ("asin", "acos", "atan", "atan2")}
    for name, function in methods.items():
        setattr(context.mpf, name, function)
    return Arithmetic("50 digits", context.mpf, object, functions)


# Bessel functions of larger arguments are had by recurrence; for smaller ones a series is as fast.
_BY_RECURRENCE = 20.0
# Digits beside those that are wanted, and -ln of what the recurrence begins with.
_GUARD, _BEGINS = 15, 1500.0


def _bessel_j(context: Any) -> Callable[[Any, Any], Any]:
    """J_n(z) of whole orders, in the numbers of a context of mpmath.

    Series of a large argument cancel as many digits as it has units. By Miller's algorithm all
    orders of an argument are had at once: three terms backwards, and J_0 + 2 (J_2 + J_4 + ...) = 1.
    """

    @lru_cache(maxsize=8)
    def all_orders(z: Any) -> list[Any]:
        m = math.ceil(z) + 1
        while m * (math.log(2.0 * m / float(z)) - 1.0) < _BEGINS:
            m += 1 + m // 50
        with context.workdps(DIGITS + _GUARD):
            found = [context.mpf(0)] * (m + 2)
            found[m] = context.mpf(1)
            for n in range(m, 0, -1):
                found[n - 1] = 2 * n / z * found[n] - found[n + 1]
            whole = found[0] + 2 * context.fsum(found[2::2])
            return [x / whole for x in found]

    def bessel_j(order: Any, z: Any) -> Any:
        n = abs(int(order))
        if z <= _BY_RECURRENCE:
            return context.besselj(order, z)
        if n > z and 2.0 * n * (math.log(2.0 * n / float(z)) - 1.0) > _BEGINS:
            # From here on what the recurrence begins with is felt.
            return context.besselj(order, z)
        value = all_orders(z)[n]
        return -value if order < 0 and n % 2 else value

    return bessel_j


@cache
def rebuilt(kernel: Any, arithmetic: Arithmetic) -> Callable[..., Any]:
    """A kernel, and all kernels that it calls, in another arithmetic.

    Parameters
    ----------
    kernel : callable
        A kernel of `albedo._compile`.
    arithmetic : Arithmetic

    Returns
    -------
    callable
        A function of arrays of such numbers.

    Raises
    ------
    InputError
        For what is no kernel of plain arithmetic.
    """
    return translated(kernel, lambda value: _translated(value, arithmetic))


def _translated(value: Any, arithmetic: Arithmetic) -> Any:
    """A global of a kernel in another arithmetic."""
    if is_kernel(value):
        name = stands_for(value)
        return arithmetic.functions[name] if name else rebuilt(value, arithmetic)
    if value is math:
        return SimpleNamespace(**arithmetic.functions)
    if value is bessel_j:
        return arithmetic.functions["bessel_j"]
    if isinstance(value, np.ndarray) and value.dtype == np.float64:
        return arithmetic.array(value)
    # numpy's scalars would draw float32 up; floats of Python are of whatever they meet.
    return float(value) if isinstance(value, np.float64) else value


def evaluate(
    model: Model, arithmetic: Arithmetic, wi: np.ndarray, wo: np.ndarray, h: np.ndarray
) -> np.ndarray:
    """The finite part of a BRDF in another arithmetic.

    Parameters
    ----------
    model : Model
        With one channel, and parts that are kernels, or a function of one's own.
    arithmetic : Arithmetic
    wi, wo, h : ndarray, shape (n, 3)
        Directions to the light and to the viewer, both above the horizon, and their sums, in
        numbers of that arithmetic.

    Returns
    -------
    ndarray, shape (n,)
        Values in 1/sr; NaN where a number is divided by zero.

    Raises
    ------
    InputError
        For a model with something else than kernels of plain arithmetic.
    """
    if function := vars(model).get("function"):
        return _of_function(model, function, wi, wo, arithmetic)
    found: np.ndarray = np.full(len(wi), arithmetic.number(0.0), dtype=arithmetic.dtype)
    for part in model.parts():
        found = found + evaluate_part(model, part, arithmetic, wi, wo, h)
    return found


def is_plain(part: Part) -> bool:
    """Whether a part has a kernel, or else a formula, that other arithmetic can run."""
    return is_kernel(part.formula or part.fill)


def evaluate_part(
    model: Model, part: Part, arithmetic: Arithmetic, wi: np.ndarray, wo: np.ndarray, h: np.ndarray
) -> np.ndarray:
    """One part of a model in another arithmetic, its factor included; see `evaluate`."""
    fill = _fill(model, part, arithmetic)
    p = arithmetic.array(part.packed(np.array([model.pack()], dtype=np.float64)))
    scale = arithmetic.number(part.scale)
    found: np.ndarray = np.empty(len(wi), arithmetic.dtype)
    for k in range(len(wi)):
        out: np.ndarray = np.empty((1, 1), arithmetic.dtype)
        known = wi[k].reshape(3, 1), wo[k].reshape(3, 1, 1), h[k].reshape(3, 1, 1)
        try:
            with np.errstate(all="ignore"):
                fill(*known, p, out)
                found[k] = scale * out[0, 0]
        except ZeroDivisionError:
            found[k] = arithmetic.number(math.nan)
    return found


def _fill(model: Model, part: Part, arithmetic: Arithmetic) -> Callable[..., Any]:
    """The kernel of a part in another arithmetic."""
    if not is_plain(part):
        raise InputError(
            f"the {part.name} part of {model.spec} is no kernel of plain arithmetic: its values "
            f"cannot be had in {arithmetic.name}"
        )
    return rebuilt(part.formula or part.fill, arithmetic)


def _of_function(
    model: Model, function: Any, wi: np.ndarray, wo: np.ndarray, arithmetic: Arithmetic
) -> np.ndarray:
    """A function of one's own, which numpy's functions are in."""
    try:
        with np.errstate(all="ignore"):
            found = np.asarray(function(wi, wo))
    except (TypeError, AttributeError) as error:
        raise InputError(
            f"{model.name}: f(wi, wo) cannot be had in {arithmetic.name}: {error}"
        ) from None
    return found.astype(arithmetic.dtype)
