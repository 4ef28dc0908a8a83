"""Models to test: what the catalogue declares, at its defaults and at the ends of its ranges."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import exact

import albedo
from albedo.brdf import Alias, Choice, Model, Real, Vectors
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
    sets = [{**choice, **end} for end in ends for choice in choices]
    built = moderate(kind)
    return built + [model for model in _built(kind, sets) if model not in built]


MODERATE = [model for kind in albedo.models().values() for model in moderate(kind)]
EXTREME = [model for kind in albedo.models().values() for model in extreme(kind)]
