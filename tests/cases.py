"""Models to test: what the catalogue declares, at its defaults and at the ends of its ranges."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import exact
import numpy as np

import albedo
from albedo.brdf import Alias, Choice, Model, Real, Vectors
from albedo.catalogue._fresnel import FresnelChoice
from albedo.errors import InputError


def _built(kind: type[Model], sets: Iterable[dict[str, Any]]) -> list[Model]:
    """The models that these sets of parameters make, without those that do not go together."""
    models: list[Model] = []
    for values in sets:
        try:
            model = kind(**values)
        except InputError:
            continue
        if model not in models:
            models.append(model)
    return models


def moderate(kind: type[Model]) -> list[Model]:
    """A model with its defaults, with every choice, and with the sets that its oracle lists."""
    sets: list[dict[str, Any]] = [{}]
    for parameter in kind.parameter_info():
        if isinstance(parameter, Choice):
            sets += [{parameter.name: choice} for choice in parameter.choices]
    return _built(kind, sets + getattr(exact.oracle(kind.name), "CASES", []))


def _vectors_at_ends(parameter: Vectors) -> list[tuple[tuple[float, ...], ...]]:
    """The default, with one number of its first vector at an end of its range."""
    first, *others = parameter.default
    return [
        ((*first[:k], end, *first[k + 1 :]), *others)
        for k, (_, entry) in enumerate(parameter.entries)
        for end in (entry.low, entry.high)
        if math.isfinite(end)
    ]


def extreme(kind: type[Model]) -> list[Model]:
    """As `moderate`, and with every number at both ends of the range that it declares."""
    ends: list[dict[str, Any]] = []
    declared = {parameter.name: parameter for parameter in kind.parameter_info()}
    for parameter in declared.values():
        first = declared[parameter.targets[0]] if isinstance(parameter, Alias) else parameter
        if isinstance(first, Real):
            low = first.low + 1e-6 if first.open_low else first.low
            ends.append({parameter.name: low})
            if math.isfinite(first.high):
                ends.append({parameter.name: first.high})
        if isinstance(first, Vectors):
            ends += [{parameter.name: value} for value in _vectors_at_ends(first)]
    # The ends count with every choice that uses the parameter.
    choices = [{}] + [
        {parameter.name: choice}
        for parameter in declared.values()
        if isinstance(parameter, Choice)
        for choice in parameter.choices
    ]
    # A Fresnel factor has its own parameters, and goes with all others in the same way.
    factor = FresnelChoice._declared if issubclass(kind, FresnelChoice) else {}
    sets = [
        {**choice, **end}
        for end in ends
        for choice in choices
        if not choice or (next(iter(choice)) in factor) == (next(iter(end)) in factor)
    ]
    built = moderate(kind)
    return built + [model for model in _built(kind, sets) if model not in built]


MODERATE = [model for kind in albedo.models().values() for model in moderate(kind)]
EXTREME = [model for kind in albedo.models().values() for model in extreme(kind)]


def anywhere(kind: type[Model], rng: np.random.Generator, count: int) -> list[Model]:
    """Models whose numbers are drawn from all of their ranges, most of them by decades.

    Some parameters are left at their defaults, and sets that do not go together are drawn again.
    """
    models: list[Model] = []
    for _ in range(60 * count):
        share = rng.choice([0.2, 0.4, 0.6, 0.9])
        values: dict[str, Any] = {}
        for parameter in kind.parameter_info():
            if rng.random() > share:
                continue
            if isinstance(parameter, Choice):
                values[parameter.name] = str(rng.choice(parameter.choices))
            elif isinstance(parameter, Real):
                low, high = max(parameter.low, -1e3), min(parameter.high, 10 ** rng.uniform(0, 6))
                if low < 0.0 or rng.random() < 0.1:
                    values[parameter.name] = float(rng.uniform(low, max(low, high)))
                else:
                    ends = np.log10([max(low, 1e-4), max(low, 1e-4, high)])
                    values[parameter.name] = float(10.0 ** rng.uniform(*ends))
        models += _built(kind, [values])
        if len(models) == count:
            break
    return models
