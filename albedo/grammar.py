"""The one grammar in which models, parameters and sweeps are written.

    ward:m=0.1                                              a model with a parameter
    cook_torrance:m=0.3,distribution=ggx,prefactor=1/pi     numbers and choices
    schwenk:color=(.9,.5,.1)                                a vector
    ward:m=0.02..1/32                                       a sweep: 32 even steps, both ends in
    ward:m=0.001..1/32log                                   the same, evenly spaced in the logarithm
    ward:m=[.1,.2,.5]                                       a sweep over listed values
    phong:n=20,rho_s=0.4 + 0.3*lambert                      a sum of models, each times a number
    0.5*(phong:n=20 + lambert)                              the same number for several

The command line, the tables and the studies all read and write this form, so a name printed by one
can be pasted into another.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from numbers import Real
from typing import TYPE_CHECKING, Any

from albedo.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from albedo import Model

__all__ = [
    "ModelSpec",
    "Spec",
    "SumSpec",
    "cos_degrees",
    "format_spec",
    "format_value",
    "parse",
    "parse_model",
    "parse_numbers",
]

Value = float | str | tuple[Any, ...]

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*\Z")
# Fractions such as 1/4 and 1/pi are words: they name a choice, and are not computed.
_WORD = re.compile(r"(?:[A-Za-z_][A-Za-z0-9_]*|[0-9]+)(?:/[A-Za-z0-9_]+)*\Z")
_DIGIT = re.compile(r"[0-9]\Z")
_NUMBER_TEXT = r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?"
_NUMBER = re.compile(_NUMBER_TEXT + r"\Z")
_COMPLEX = re.compile(rf"(?=.*[0-9])(?:{_NUMBER_TEXT})?[+-]?(?:[0-9.]+(?:[eE][+-]?[0-9]+)?)?[ij]\Z")
_NOT_FINITE = re.compile(r"[+-]?(?:nan|inf|infinity)\Z", re.IGNORECASE)
_COUNT = re.compile(r"([0-9]+)\s*(log)?\Z")
_CLOSING = {"(": ")", "[": "]"}
# What stands before a + that is a sign or in an exponent, and after one that adds a multiple.
_SIGNED = re.compile(r"(?:[=,:]|\.\.)\s*\Z")
_EXPONENT = re.compile(r"[0-9.][eE]\Z")
_MULTIPLE = re.compile(_NUMBER_TEXT + r"\s*\*")

# A sweep beyond this is a slip of the finger, and would fill the memory before it failed.
_MOST_POINTS = 1_000_000
# Vectors of vectors of vectors are as deep as any parameter is; a bound keeps the parser finite.
_DEEPEST = 8


@dataclass(frozen=True, eq=False)
class ModelSpec:
    """What a line of the grammar says: a model's name, its fixed parameters and its sweeps.

    Attributes
    ----------
    name : str
        Name of the model. It is looked up only when a model is built.
    fixed : dict
        Parameters with one value: a float, a word or a (nested) tuple.
    sweep : dict
        Parameters with several values, in the order in which they were written: an array of
        floats, or a tuple of words or vectors.
    """

    name: str
    fixed: dict[str, Value] = field(default_factory=dict)
    sweep: dict[str, np.ndarray | tuple[Any, ...]] = field(default_factory=dict)

    def __str__(self) -> str:
        return format_spec(self.name, {**self.fixed, **_as_lists(self.sweep)})

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ModelSpec) and self._key() == other._key()

    def __hash__(self) -> int:
        return hash((self.name, frozenset(self.fixed.items()), tuple(self.sweep)))

    def _key(self) -> tuple[Any, ...]:
        # The order of sweeps is the order of the product; the order of the rest means nothing.
        return self.name, self.fixed, list(_as_lists(self.sweep).items())

    def model(self) -> Model:
        """Build the one model that is named here.

        Returns
        -------
        Model
            The model, its parameters checked.

        Raises
        ------
        InputError
            If a parameter is swept, or if the name or a parameter is not valid.
        """
        if self.sweep:
            swept = ", ".join(self.sweep)
            raise InputError(f"'{self}' sweeps {swept}, but one single model is needed here.")
        import albedo
        from albedo.catalogue import model_class

        # Python binds these two itself, before a model could refuse them.
        for key in self.fixed.keys() & {"name", "self"}:
            known = ", ".join(item.name for item in model_class(self.name).parameter_info())
            raise InputError(f"{self.name} has no parameter '{key}'; it has {known or 'none'}.")
        return albedo.model(self.name, **self.fixed)

    def models(self) -> Iterator[Model]:
        """Build one model for every combination of the swept values, the last sweep fastest.

        Yields
        ------
        Model
            The next model; exactly one where nothing is swept.
        """
        for single in self.singles():
            yield single.model()

    def singles(self) -> Iterator[ModelSpec]:
        """Go through the combinations of the swept values, each as a spec without sweeps.

        Yields
        ------
        ModelSpec
            What names one model; exactly one where nothing is swept.
        """
        for values in self.assignments():
            yield ModelSpec(self.name, {**self.fixed, **values})

    def assignments(self) -> Iterator[dict[str, Value]]:
        """Go through the combinations of the swept values.

        Yields
        ------
        dict
            A value for each swept parameter; one empty dict where nothing is swept.
        """
        columns = _as_lists(self.sweep)
        for row in itertools.product(*columns.values()):
            yield dict(zip(columns, row, strict=True))

    @property
    def count(self) -> int:
        """Number of models that `models` builds."""
        return math.prod(len(values) for values in self.sweep.values())


@dataclass(frozen=True)
class SumSpec:
    """What a line of the grammar says about a sum of models, or a multiple of one.

    Attributes
    ----------
    terms : tuple of (float, ModelSpec)
        Factors, and what they multiply.
    """

    terms: tuple[tuple[float, ModelSpec], ...]

    # As of the models that are built.
    name = "sum"

    def __str__(self) -> str:
        return " + ".join(
            str(spec) if factor == 1.0 else f"{format_value(factor)}*{spec}"
            for factor, spec in self.terms
        )

    def model(self) -> Model:
        """Build the sum that is named here; see `ModelSpec.model`."""
        from albedo.compose import Sum

        return Sum(tuple((factor, spec.model()) for factor, spec in self.terms))

    def models(self) -> Iterator[Model]:
        """Build one sum for every combination of the swept values of its terms."""
        for single in self.singles():
            yield single.model()

    def singles(self) -> Iterator[SumSpec]:
        """Go through the combinations of the swept values; see `ModelSpec.singles`."""
        factors = [factor for factor, _ in self.terms]
        for specs in itertools.product(*(spec.singles() for _, spec in self.terms)):
            yield SumSpec(tuple(zip(factors, specs, strict=True)))

    def assignments(self) -> Iterator[dict[str, Value]]:
        """Go through the combinations of the swept values, each under its model and parameter."""
        for rows in itertools.product(*(spec.assignments() for _, spec in self.terms)):
            found: dict[str, Value] = {}
            for (_, spec), values in zip(self.terms, rows, strict=True):
                for key, value in values.items():
                    label, number = f"{spec.name} {key}", 2
                    while label in found:
                        label, number = f"{spec.name} {key} {number}", number + 1
                    found[label] = value
            yield found

    @property
    def count(self) -> int:
        """Number of sums that `models` builds."""
        return math.prod(spec.count for _, spec in self.terms)


Spec = ModelSpec | SumSpec
"""What a line of the grammar says."""


def parse(text: str) -> Spec:
    """Read one model, or a sum of models, in the grammar of this module.

    Parameters
    ----------
    text : str
        For example ``"ward:m=0.1"``, ``"ward:m=0.02..1/32"`` or ``"phong:n=20 + 0.3*lambert"``.

    Returns
    -------
    ModelSpec or SumSpec
        The name, the fixed parameters and the sweeps of a model, or the terms of a sum. Whether
        models and their parameters exist is checked when the model is built.

    Raises
    ------
    InputError
        If the text does not follow the grammar; the message says where and what is allowed.

    Examples
    --------
    >>> parse("ward:m=0.10").fixed
    {'m': 0.1}
    >>> str(parse("phong:n=1e2..4e2/4"))
    'phong:n=100..400/4'
    >>> str(parse("0.5*(phong:n=20 + 2*lambert)"))
    '0.5*phong:n=20 + lambert'
    """
    if not isinstance(text, str):
        raise InputError(f"A model is written as text such as 'ward:m=0.1'; {text!r} was given.")
    if not text.strip():
        raise InputError("The model is empty; write a name and parameters, as in 'ward:m=0.1'.")
    terms = _terms(text, text, 0)
    for factor, spec in terms:
        if not math.isfinite(factor):
            raise InputError(f"The factors of '{spec.name}' in {_shown(text)} are too large.")
    if len(terms) == 1 and terms[0][0] == 1.0:
        return terms[0][1]
    return SumSpec(tuple(terms))


def parse_model(text: str, what: str) -> ModelSpec:
    """Read one model where a sum has no meaning.

    Parameters
    ----------
    text : str
        As for `parse`.
    what : str
        What needs one model, for the error message, for example ``"A map"``.

    Returns
    -------
    ModelSpec
        The model.

    Raises
    ------
    InputError
        If the text does not follow the grammar, or is a sum or a multiple.
    """
    spec = parse(text)
    if isinstance(spec, SumSpec):
        raise InputError(
            f"{what} is over the parameters of one model; {_shown(text)} is a sum or a multiple."
        )
    return spec


def _terms(text: str, whole: str, depth: int) -> list[tuple[float, ModelSpec]]:
    """The factors and models of a sum."""
    if depth > _DEEPEST:
        raise InputError(f"{_shown(whole)} nests brackets more than {_DEEPEST} deep.")
    terms: list[tuple[float, ModelSpec]] = []
    for term in _split(text, whole, _is_plus):
        *factors, last = _split(term, whole, _is_times)
        if not last or "" in factors:
            raise InputError(
                f"{_shown(whole)} has an empty place beside a '+' or a '*'; write a sum as "
                "'phong:n=20 + 0.3*lambert'."
            )
        factor = math.prod(_factor(one, last, whole) for one in factors)
        if last.startswith("("):
            inner = _bracketed(f"The sum {_shown(whole)}", last, _is_nothing)
            terms += [(factor * own, spec) for own, spec in _terms(inner[0], whole, depth + 1)]
        else:
            terms.append((factor, _parse_one(last)))
    return terms


def _factor(text: str, model: str, whole: str) -> float:
    """The number before a ``*``."""
    if not _NUMBER.match(text):
        raise InputError(
            f"{_shown(text)} before the '*' in {_shown(whole)} is not a number; a factor stands "
            "before its model, as in 0.3*lambert."
        )
    number = _number(f"The factor of {_shown(model)}", text)
    if number < 0.0:
        raise InputError(
            f"The factor of {_shown(model)} is {text} in {_shown(whole)}; it must not be negative."
        )
    return number


def _is_comma(text: str, position: int) -> bool:
    return text[position] == ","


def _is_times(text: str, position: int) -> bool:
    return text[position] == "*"


def _is_plus(text: str, position: int) -> bool:
    """Whether a + adds models, and is not part of a number."""
    before, after = text[:position], text[position + 1 :].lstrip()
    if text[position] != "+" or _SIGNED.search(before):
        return False
    if _EXPONENT.search(before) and _DIGIT.match(text[position + 1 : position + 2]):
        return False
    # Sums of numbers and complex ones are left to what reads values, which says what is wrong.
    return ":" not in before or not after[:1].isdigit() or bool(_MULTIPLE.match(after))


def _is_nothing(text: str, position: int) -> bool:
    return False


def _parse_one(text: str) -> ModelSpec:
    """Read one model with its parameters."""
    name, colon, rest = text.partition(":")
    name = name.strip()
    if not _NAME.match(name):
        raise InputError(
            f"{_shown(name)} is not the name of a model; names have letters, digits and "
            "underscores, and parameters follow a colon, as in 'ward:m=0.1'."
        )
    if not colon:
        return ModelSpec(name)
    if not rest.strip():
        raise InputError(
            f"{_shown(text)} ends after the colon; parameters follow it, as in 'ward:m=0.1'."
        )
    fixed: dict[str, Value] = {}
    sweep: dict[str, np.ndarray | tuple[Any, ...]] = {}
    for item in _split(rest, text, _is_comma):
        key, equals, value = item.partition("=")
        key, value = key.strip(), value.strip()
        if not item:
            raise InputError(f"{_shown(text)} has an empty place between its commas.")
        if not equals or not _NAME.match(key):
            raise InputError(
                f"{_shown(item)} in {_shown(text)} is not a parameter; each is written name=value."
            )
        if key in fixed or key in sweep:
            raise InputError(f"Parameter '{key}' is given twice in {_shown(text)}.")
        if value.startswith("["):
            sweep[key] = _list(key, value)
        elif ".." in value and not value.startswith("("):
            sweep[key] = _range(f"Parameter '{key}'", value)
        else:
            fixed[key] = _value(key, value)
    return ModelSpec(name, fixed, sweep)


def parse_ranges(text: str) -> tuple[Model, dict[str, tuple[float, float]]]:
    """Read one model whose sweeps say between which numbers parameters vary.

    Parameters
    ----------
    text : str
        Such as ``ward:m=0.1..0.5/2``, or a sum of models that sweeps nothing.

    Returns
    -------
    model : Model
        With the smallest of the numbers.
    ends : dict of str to (float, float)

    Raises
    ------
    InputError
        For sweeps over words, and in sums.
    """
    import numpy as np

    spec = parse(text)
    if not isinstance(spec, ModelSpec):
        if spec.count > 1:
            raise InputError("a sum of models has its numbers fixed here; sweep none")
        return spec.model(), {}
    ends: dict[str, tuple[float, float]] = {}
    for name, values in spec.sweep.items():
        if not isinstance(values, np.ndarray):
            raise InputError(f"{name} is swept over words; ask for one of them at a time")
        ends[name] = float(values.min()), float(values.max())
    low = {name: pair[0] for name, pair in ends.items()}
    return ModelSpec(spec.name, {**spec.fixed, **low}).model(), ends


def parse_numbers(text: str, what: str) -> np.ndarray:
    """Read a list of numbers and ranges, such as ``1,0.5,1e-3`` or ``0.01..1/32``.

    Parameters
    ----------
    text : str
        Numbers and ranges of this module's grammar, separated by commas.
    what : str
        How an error message calls them, for example ``"--cos"``.

    Returns
    -------
    ndarray
        The numbers, in the order given.
    """
    import numpy as np

    parts: list[np.ndarray] = []
    for item in text.split(","):
        item = item.strip()
        if not item:
            raise InputError(
                f"{what} has an empty place in {_shown(text)}; write numbers separated by commas, "
                "or a range such as 0.01..1/32."
            )
        if ".." in item:
            parts.append(_range(what, item))
        else:
            parts.append(np.array([_number(what, item)]))
    return np.concatenate(parts)


def format_spec(name: str, params: Mapping[str, Any]) -> str:
    """Write a model and its parameters so that `parse` reads the same values back.

    Parameters
    ----------
    name : str
        Name of the model.
    params : mapping
        Values by parameter name: numbers, words, tuples (vectors), and lists or arrays (sweeps).

    Returns
    -------
    str
        The model in the grammar of this module, with every digit that matters.

    Examples
    --------
    >>> format_spec("ward", {"m": 0.1, "rho_s": 1.0})
    'ward:m=0.1,rho_s=1'
    """
    if not _NAME.match(name):
        raise InputError(
            f"{_shown(name)} is not the name of a model; names have letters, digits and "
            "underscores."
        )
    items = []
    for key, value in params.items():
        if not _NAME.match(key):
            raise InputError(
                f"{_shown(key)} is not the name of a parameter; names have letters, digits and "
                "underscores."
            )
        if isinstance(value, list) or (hasattr(value, "ndim") and value.ndim > 0):
            items.append(f"{key}={_format_sweep(key, list(value))}")
        else:
            items.append(f"{key}={format_value(value, key)}")
    return f"{name}:{','.join(items)}" if items else name


def format_value(value: Any, name: str = "value") -> str:
    """Write one parameter value: a number in its shortest exact form, a word, or a vector.

    Parameters
    ----------
    value : float, str or tuple
        The value; tuples may be nested.
    name : str
        How an error message calls it.

    Returns
    -------
    str
        The value in the grammar of this module.
    """
    if isinstance(value, str):
        # A choice may be spelled as a count: what is read is a number, which the choice takes.
        if not _is_word(value) and not _DIGIT.match(value):
            raise InputError(
                f"Parameter '{name}' is {_shown(value)}; a word has letters, digits and "
                "underscores, and starts with a letter, or is a fraction such as 1/4."
            )
        return value
    if isinstance(value, tuple):
        if not value:
            raise InputError(f"Parameter '{name}' is an empty vector; it needs at least one entry.")
        return f"({','.join(format_value(entry, name) for entry in value)})"
    if isinstance(value, bool) or not isinstance(value, Real):
        raise InputError(
            f"Parameter '{name}' is {value!r}; it must be a number, a word or a tuple of them."
        )
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise InputError(f"Parameter '{name}' is {number}; it must be finite.")
    return repr(number).removesuffix(".0")


def cos_degrees(theta: float) -> float:
    """Cosine of an angle of incidence in degrees, to the last digit and exactly 0 at 90.

    Parameters
    ----------
    theta : float
        Angle in degrees, 0 to 90.

    Returns
    -------
    float
        Its cosine. Near 90 it is taken as the sine of the complement, whose subtraction is exact.
    """
    if not 0.0 <= theta <= 90.0:
        raise InputError(f"An angle of incidence is {theta:g} degrees; it must be within 0 and 90.")
    # sin(radians(30)) is one rounding away from the half that everybody expects.
    if theta == 60.0:
        return 0.5
    if theta <= 45.0:
        return math.cos(math.radians(theta))
    return math.sin(math.radians(90.0 - theta))


def _as_lists(sweep: Mapping[str, Any]) -> dict[str, list[Any]]:
    return {
        key: values.tolist() if hasattr(values, "tolist") else list(values)
        for key, values in sweep.items()
    }


def _shown(text: str) -> str:
    """Quote what was given, cut to a length that leaves the sentence readable."""
    return repr(text if len(text) <= 80 else text[:77] + "...")


def _is_word(text: str) -> bool:
    return bool(_WORD.match(text)) and not _NUMBER.match(text) and not _NOT_FINITE.match(text)


def _split(text: str, whole: str, cuts: Callable[[str, int], bool]) -> list[str]:
    """Split at the characters outside all brackets at which ``cuts(text, position)`` is true."""
    items, start, open_brackets = [], 0, ""
    for position, character in enumerate(text):
        if character in _CLOSING:
            open_brackets += character
            if len(open_brackets) > _DEEPEST:
                raise InputError(
                    f"{_shown(whole)} nests brackets more than {_DEEPEST} deep, which no "
                    "parameter needs."
                )
        elif character in ")]":
            if not open_brackets or _CLOSING[open_brackets[-1]] != character:
                raise InputError(f"{_shown(whole)} closes a '{character}' that was not opened.")
            open_brackets = open_brackets[:-1]
        elif not open_brackets and cuts(text, position):
            items.append(text[start:position].strip())
            start = position + 1
    if open_brackets:
        raise InputError(f"{_shown(whole)} opens a '{open_brackets[-1]}' that is never closed.")
    items.append(text[start:].strip())
    return items


def _number(what: str, text: str) -> float:
    if _NOT_FINITE.match(text):
        raise InputError(f"{what} is {_shown(text)}; it must be a finite number.")
    if not _NUMBER.match(text):
        if _COMPLEX.match(text):
            raise InputError(f"{what} is {_shown(text)}; complex numbers are not allowed.")
        raise InputError(f"{what} is {_shown(text)}, which is not a number.")
    number = float(text)
    if not math.isfinite(number):
        raise InputError(f"{what} is {_shown(text)}, which is too large for a 64-bit float.")
    return number


def _value(key: str, text: str) -> Value:
    what = f"Parameter '{key}'"
    if not text:
        raise InputError(f"{what} has no value; write a number, a word, (vector) or [list].")
    if text.startswith("("):
        entries = _bracketed(what, text)
        return tuple(_value(key, entry) for entry in entries)
    if "[" in text or "(" in text:
        raise InputError(
            f"{what} is {_shown(text)}; a vector is written (.9,.5,.1), and a list of values to "
            "sweep [.1,.2,.5], not inside another value."
        )
    if ".." in text:
        raise InputError(f"{what} has the range {_shown(text)} inside a vector or a list.")
    if _is_word(text):
        return text
    if _NUMBER.match(text) or _NOT_FINITE.match(text) or _COMPLEX.match(text):
        return _number(what, text)
    raise InputError(
        f"{what} is {_shown(text)}; it must be a number, a word, a vector such as (.9,.5,.1), "
        "a range such as 0.02..1/32, or a list such as [.1,.2,.5]."
    )


def _bracketed(what: str, text: str, cuts: Callable[[str, int], bool] = _is_comma) -> list[str]:
    """Take the entries of ``(...)`` or ``[...]``."""
    closing = _CLOSING[text[0]]
    inner = text[1:-1]
    if text[-1] != closing or (not inner.strip()):
        kind = "empty" if text[-1] == closing else "followed by something else"
        raise InputError(f"{what} is {_shown(text)}, where the bracket is {kind}.")
    entries = _split(inner, text, cuts)
    if "" in entries:
        raise InputError(f"{what} has an empty place between the commas of {_shown(text)}.")
    return entries


def _list(key: str, text: str) -> np.ndarray | tuple[Any, ...]:
    import numpy as np

    what = f"Parameter '{key}'"
    values = [_value(key, entry) for entry in _bracketed(what, text)]
    kinds = {type(value) for value in values}
    if len(kinds) > 1:
        raise InputError(
            f"{what} sweeps over {_shown(text)}, which mixes numbers, words and vectors."
        )
    if len(set(values)) < len(values):
        raise InputError(f"{what} sweeps over {_shown(text)}, where a value appears twice.")
    return np.array(values) if kinds == {float} else tuple(values)


def _range(what: str, text: str) -> np.ndarray:
    """Read ``start..stop/count`` or ``start..stop/countlog``."""
    import numpy as np

    ends, slash, count_text = text.partition("/")
    start_text, _, stop_text = ends.partition("..")
    if stop_text.startswith("."):
        raise InputError(
            f"{what} is {_shown(text)}, where the dots can be read in two ways; write 0 before "
            "a decimal point, as in 0.1..0.5/5."
        )
    if not slash:
        raise InputError(
            f"{what} is the range {_shown(text)} without a count; write the number of points "
            "after a slash, as in 0.02..1/32."
        )
    matched = _COUNT.match(count_text.strip())
    # A longer count is beyond the limit anyhow, and int() of thousands of digits raises.
    count = int(matched[1]) if matched and len(matched[1]) <= 9 else _MOST_POINTS + 1
    if matched is None or not 2 <= count <= _MOST_POINTS:
        raise InputError(
            f"{what} has the count {_shown(count_text.strip())} in {_shown(text)}; it must be a "
            f"whole number from 2 to {_MOST_POINTS}, with or without 'log' after it."
        )
    start = _number(f"{what}, start of the range,", start_text.strip())
    stop = _number(f"{what}, end of the range,", stop_text.strip())
    if start == stop:
        raise InputError(f"{what} is the range {_shown(text)}, whose ends are the same.")
    if matched[2] and (start <= 0.0 or stop <= 0.0):
        raise InputError(
            f"{what} is the logarithmic range {_shown(text)}; both its ends must be above 0."
        )
    values = _spaced(start, stop, count, bool(matched[2]))
    if not np.isfinite(values).all() or len(np.unique(values)) < count:
        raise InputError(
            f"{what} is the range {_shown(text)}, whose points 64-bit floats cannot tell apart."
        )
    return values


def _spaced(start: float, stop: float, count: int, log: bool) -> np.ndarray:
    import numpy as np

    # An overflowing or vanishing step is reported by the caller as indistinct points.
    with np.errstate(over="ignore", invalid="ignore", under="ignore"):
        return (np.geomspace if log else np.linspace)(start, stop, count)


def _format_sweep(key: str, values: list[Any]) -> str:
    """Write a sweep as the range that gives exactly these values, else as a list."""
    if not values:
        raise InputError(f"Parameter '{key}' sweeps over an empty list.")
    entries = [format_value(value, key) for value in values]
    # Below four points a list is as short, and says more.
    if len(values) >= 4 and all(isinstance(value, Real) for value in values):
        numbers = [float(value) for value in values]
        for log, suffix in ((False, ""), (True, "log")):
            if log and min(numbers[0], numbers[-1]) <= 0.0:
                continue
            if _spaced(numbers[0], numbers[-1], len(numbers), log).tolist() == numbers:
                return f"{entries[0]}..{entries[-1]}/{len(entries)}{suffix}"
    return f"[{','.join(entries)}]"
