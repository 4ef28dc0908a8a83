"""Sums of models and multiples of them: again models, in which nothing is approximated."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from albedo.brdf import Model, Part
from albedo.errors import InputError


class Sum(Model):
    """A sum of models, each times a number: ``specular + 0.3 * diffuse``.

    Each part is integrated in the chart of its own model, Dirac parts included.

    Attributes
    ----------
    terms : tuple of (float, Model)
        Factors and models; no model is itself a sum.
    """

    name = "sum"
    title = "a sum of models"
    terms: tuple[tuple[float, Model], ...]

    def __init__(self, terms: tuple[tuple[float, Model], ...]) -> None:
        super().__init__()
        counts = {m.channels for _, m in terms} - {None}
        if len(counts) > 1:
            raise InputError(
                "models with different numbers of channels have no sum; they have "
                + " and ".join(str(count) for count in sorted(counts, key=str))
            )
        factors = [factor for factor, _ in terms]
        values: dict[str, Any] = {
            "terms": terms,
            "reciprocal": all(m.reciprocal for _, m in terms),
            # Enough, if not needed: what is added may be small where the other model is large.
            "conserves_energy": sum(factors) <= 1.0 and all(m.conserves_energy for _, m in terms),
            "grazing_limit": all(m.grazing_limit for _, m in terms),
            "lowest_cosine": max((m.lowest_cosine for _, m in terms), default=0.0),
            "references": tuple(dict.fromkeys(key for _, m in terms for key in m.references)),
            "equation": " + ".join(m.equation for _, m in terms),
        }
        widths = [m.resolved_width for _, m in terms if m.resolved_width is not None]
        values["resolved_width"] = max(widths, default=None)
        for key, value in values.items():
            object.__setattr__(self, key, value)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sum) and self.terms == other.terms

    def __hash__(self) -> int:
        return hash(self.terms)

    @property
    def spec(self) -> str:
        """The terms, each in the grammar of models."""
        return " + ".join(
            m.spec if factor == 1.0 else f"{factor!r}*{m.spec}" for factor, m in self.terms
        )

    @property
    def isotropic(self) -> bool:
        return all(m.isotropic for _, m in self.terms)

    @property
    def channels(self) -> int | None:
        return next((m.channels for _, m in self.terms if m.channels is not None), None)

    def channel(self, index: int) -> Model:
        return Sum(
            tuple(
                (factor, m if m.channels is None else m.channel(index)) for factor, m in self.terms
            )
        )

    def replace(self, **values: Any) -> Model:
        if values:
            raise InputError("a sum of models has no parameters; change those of its terms")
        return self

    def pack(self) -> tuple[float, ...]:
        return tuple(number for _, m in self.terms for number in m.pack())

    def parts(self) -> tuple[Part, ...]:
        parts: list[Part] = []
        names: dict[str, int] = {}
        start = 0
        for factor, m in self.terms:
            count = len(m.pack())
            for part in m.parts():
                label = f"{m.name} {part.name}"
                names[label] = names.get(label, 0) + 1
                if names[label] > 1:
                    label += f" {names[label]}"
                first, last, _ = slice(*part.columns).indices(count)
                parts.append(
                    replace(
                        part,
                        name=label,
                        columns=(start + first, start + last),
                        scale=factor * part.scale,
                        # What a multiple loses is not a multiple of what is lost.
                        loss=part.loss if factor == 1.0 else None,
                    )
                )
            start += count
        return tuple(parts)

    def spikes(self, wi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        found = [(factor, *m.spikes(wi)) for factor, m in self.terms]
        directions = np.concatenate([directions for _, directions, _ in found])
        return directions, np.concatenate([factor * weights for factor, _, weights in found])

    def spike_errors(self, wi: np.ndarray, weights: np.ndarray) -> np.ndarray:
        errors = []
        for factor, m in self.terms:
            own = m.spikes(wi)[1]
            errors.append(factor * m.spike_errors(wi, own))
        return np.concatenate(errors)

    def simpler(self) -> dict[str, Model]:
        found: dict[str, Model] = {}
        for k, (factor, m) in enumerate(self.terms):
            for name, one in m.simpler().items():
                terms = [*self.terms]
                terms[k : k + 1] = [(factor * own, simple) for own, simple in _terms(one)]
                found[f"{name} of {m.name}"] = Sum(tuple(terms))
        return found

    def grazing_albedo(self) -> float | None:
        known = [(factor, m.grazing_albedo()) for factor, m in self.terms]
        values = [factor * value for factor, value in known if value is not None]
        return math.fsum(values) if len(values) == len(known) else None


def _terms(model: Model) -> tuple[tuple[float, Model], ...]:
    return model.terms if isinstance(model, Sum) else ((1.0, model),)


def total(first: Model, second: Model) -> Sum:
    """The sum of two models.

    Raises
    ------
    InputError
        When both have channels, and not equally many.
    """
    return Sum(_terms(first) + _terms(second))


def scaled(model: Model, factor: Any) -> Sum:
    """A multiple of a model.

    Raises
    ------
    InputError
        When the factor is not a number, or is negative or not finite.
    """
    number = isinstance(factor, int | float | np.number) and not isinstance(factor, bool)
    if not number or np.iscomplexobj(factor) or not 0.0 <= float(factor) < math.inf:
        raise InputError(f"a model times {factor!r} is no model; the factor must lie in [0, inf)")
    return Sum(tuple((float(factor) * own, m) for own, m in _terms(model)))
