"""Values of BRDFs where special numbers meet special directions: none may be NaN.

Parameters stand at the ends of the ranges that they declare and at 0, 1, 1e-8 and 1e8; lobes are up
to 1e4 times as wide along one axis as along the other. Directions are the places of
`albedo.analysis.stability`, and both may have cosines down to the smallest denormal number. There a
product of two cosines is 0 in float64 and a quotient infinite, so that a formula as it is printed
ends in 0/0.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from albedo.analysis.precise import evaluate, precise
from albedo.analysis.stability import (
    RANGE,
    exact_directions,
    exact_places,
    values_of_directions,
    values_with_sums,
)
from albedo.brdf import Alias, Choice, Model, Parameter, Real, Vectors
from albedo.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

SPECIAL = (0.0, 1.0, 1e-8, 1e8)
"""Numbers at which a parameter is tried wherever its range has them, beside both of its ends."""
ANISOTROPY = 1e4
"""Ratio of widths or exponents along the two axes."""
LOWEST = 5e-324
"""The smallest number above 0."""
COSINES = (1.0, 0.7, 0.1, 1e-9, 1e-154, 1e-300, LOWEST)
"""Cosines of the angle of incidence."""
GRAZING = (1e-9, 1e-300, LOWEST)
"""Cosines of the views at the horizon."""

# Values from raw directions may be infinite from here on.
_NEAR = 2.0**1000
# Where an open range begins, and where an infinite one ends, for this purpose.
_OPEN, _INFINITE = 1e-6, 1e8
_PAIRS = {"_x": "_y", "_u": "_v"}


def special_numbers(parameter: Real) -> list[float]:
    """Both ends of a range, and what of `SPECIAL` lies in it."""
    low = parameter.low + _OPEN if parameter.open_low else parameter.low
    ends = (max(low, -_INFINITE), min(parameter.high, _INFINITE))
    inside = [x for x in SPECIAL if low <= x <= parameter.high]
    return sorted({*ends, *inside})


def _special_vectors(parameter: Vectors) -> list[Any]:
    """The default with each number of its first vector at each special one."""
    first, *others = parameter.default
    return [
        ((*first[:k], number, *first[k + 1 :]), *others)
        for k, (_, entry) in enumerate(parameter.entries)
        for number in special_numbers(entry)
    ]


def special_settings(kind: type[Model]) -> dict[str, list[Any]]:
    """What each parameter of a model is tried at."""
    found: dict[str, list[Any]] = {}
    for parameter in kind.parameter_info():
        if isinstance(parameter, Choice):
            found[parameter.name] = list(parameter.choices)
        elif isinstance(parameter, Vectors):
            found[parameter.name] = _special_vectors(parameter)
        elif isinstance(parameter, Real):
            found[parameter.name] = list(special_numbers(parameter))
    return found


def _anisotropic(kind: type[Model]) -> Iterator[dict[str, Any]]:
    """Widths and exponents that are `ANISOTROPY` apart, at both ends of their range."""
    declared: dict[str, Parameter] = {p.name: p for p in kind.parameter_info()}
    for name, parameter in declared.items():
        other = name[:-2] + _PAIRS.get(name[-2:], "?")
        if isinstance(parameter, Real) and other in declared:
            low, high = max(parameter.low, 1e-4), parameter.high
            for wide in (high, low * ANISOTROPY):
                pair = wide, wide / ANISOTROPY
                yield dict(zip((name, other), pair, strict=True))
                yield dict(zip((other, name), pair, strict=True))


def special_models(kind: type[Model], *, most: int | None = None, seed: int = 0) -> list[Model]:
    """Models of one class with their parameters at special numbers.

    Parameters
    ----------
    kind : type
        A class of the catalogue.
    most : int, optional
        So many more models whose parameters are all special at once, drawn at random.
    seed : int
        Of these.

    Returns
    -------
    list of Model
        With one channel each: every parameter at every special number by itself, with every
        choice; both widths or exponents far apart; and what was drawn.
    """
    settings = special_settings(kind)
    alone: list[dict[str, Any]] = [{}]
    alone += [{name: value} for name, values in settings.items() for value in values]
    aliases = [p for p in kind.parameter_info() if isinstance(p, Alias)]
    for alias in aliases:
        alone += [{alias.name: value} for value in settings[alias.targets[0]]]
    alone += _anisotropic(kind)
    chosen = [
        {p.name: word}
        for p in kind.parameter_info()
        if isinstance(p, Choice)
        for word in p.choices
        if word != p.default
    ]
    sets = alone + [{**one, **word} for one in alone for word in chosen if not set(one) & set(word)]
    rng = np.random.default_rng(seed)
    for _ in range(most or 0):
        sets.append({name: values[rng.integers(len(values))] for name, values in settings.items()})
    return _built(kind, sets)


def _built(kind: type[Model], sets: Iterable[dict[str, Any]]) -> list[Model]:
    """The different models among sets of parameters, less what does not go together."""
    found: dict[Model, None] = {}
    for values in sets:
        try:
            found[_used(kind, values)] = None
        except InputError:
            continue
    return list(found)


def _used(kind: type[Model], values: dict[str, Any]) -> Model:
    """A model of the parameters that are used with these choices."""
    words = {p.name for p in kind.parameter_info() if isinstance(p, Choice)}
    plain = {p.name: p.default for p in kind.parameter_info() if not isinstance(p, Alias)}
    used = kind.used(object.__new__(kind), {**plain, **values})
    aliases = {p.name: p.targets[0] for p in kind.parameter_info() if isinstance(p, Alias)}
    kept = {k: v for k, v in values.items() if aliases.get(k, k) in used}
    if kept.keys() - words or not values.keys() - words:
        return kind(**kept)
    raise InputError(f"{kind.name} uses none of {', '.join(values)}")


def special_directions(model: Model) -> tuple[list[str], np.ndarray, np.ndarray, np.ndarray]:
    """Where a model is tried.

    Returns
    -------
    tuple
        Names of the places, L, V and their sums in 50 digits, each of shape (n, 3).
    """
    parts = model.parts()
    wx, wy = (min(w, 1.0) for w in parts[0].widths) if parts else (1.0, 1.0)
    names: list[str] = []
    vectors: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    turns = (0.0,) if model.isotropic else (0.0, 0.6, 0.5 * math.pi)
    for c, turn in itertools.product(COSINES, turns):
        widths = (
            math.hypot(wx * math.cos(turn), wy * math.sin(turn)),
            math.hypot(wx * math.sin(turn), wy * math.cos(turn)),
        )
        found = exact_places(precise(), c, turn, widths, GRAZING)
        names += [f"cos_theta = {c:g}, phi = {turn:g}, {place}" for place in found.places]
        vectors.append((found.wi, found.wo, found.h))
    wi, wo, h = (np.concatenate(kind) for kind in zip(*vectors, strict=True))
    return names, wi, wo, h


def _has_digits(model: Model) -> bool:
    """Whether values of a model can be had in 50 digits."""
    above = precise().array([[0.0, 0.0, 1.0]])
    try:
        evaluate(model, precise(), above, above, above + above)
    except InputError:
        return False
    return True


def special_values(model: Model) -> pd.DataFrame:
    """Values of a model with one channel at special directions, and what is wrong about them.

    Parameters
    ----------
    model : Model

    Returns
    -------
    pandas.DataFrame
        One row for every direction: ``place``, what the kernel gives where the sum of both
        directions is known, ``float64``, and from directions alone, ``raw``, and of each whether
        it is ``_wrong``: NaN, below 0, or infinite though the value in 50 digits is at most 2^1023.
        Next to the horizon the half vector of rounded directions is theirs: there 2^1000 counts,
        at the directions that are meant or at the rounded ones. Of models without values in 50
        digits no infinity is judged.
    """
    import pandas as pd

    names, wi, wo, h = special_directions(model)
    light, view, half = (v.astype(np.float64) for v in (wi, wo, h))
    # A rounding must not take a direction below the horizon, nor to it.
    above = (light[:, 2] > 0.0) & (view[:, 2] > 0.0)
    names = [name for name, kept in zip(names, above, strict=True) if kept]
    wi, wo, h, light, view, half = (v[above] for v in (wi, wo, h, light, view, half))
    with np.errstate(all="ignore"):
        found = {
            "float64": values_with_sums(model, light, view, half),
            "raw": values_of_directions(model, light, view),
        }
    judged = _has_digits(model)
    columns: dict[str, Any] = {"place": names}
    for way, values in found.items():
        wrong = np.isnan(values) | (values < 0.0)
        infinite = np.flatnonzero(np.isposinf(values) & judged)
        if infinite.size:
            meant = evaluate(model, precise(), *(v[infinite] for v in (wi, wo, h)))
            wrong[infinite] = [not x > RANGE[way][1] for x in meant]
        if way == "raw" and wrong[infinite].any():
            there = exact_directions(light[infinite], view[infinite])
            said = evaluate(model, precise(), *there)
            wrong[infinite] = [not max(x, y) > _NEAR for x, y in zip(meant, said, strict=True)]
        columns |= {way: values, f"{way}_wrong": wrong}
    return pd.DataFrame(columns)
