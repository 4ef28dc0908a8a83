"""Pumped-up models against the references of ``golden/pumped.csv`` (see ``golden/README.md``).

They are made with mpmath from closed forms of the rings, over elevations, with interpolants of
their own for the albedos that are divided by.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from decimal import Decimal
from functools import cache
from pathlib import Path

import pytest

import albedo
from albedo.grammar import parse

GOLDEN = Path(__file__).parent / "golden" / "pumped.csv"
# A model, a control and a number of steps: what one divisor is for.
Key = tuple[str, str, int]


@dataclass(frozen=True)
class Reference:
    """An albedo after some steps."""

    cos_theta: float
    value: Decimal
    uncertainty: float


@cache
def references() -> dict[Key, list[Reference]]:
    found: dict[Key, list[Reference]] = {}
    with GOLDEN.open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            value = Decimal(row["value"])
            # Two computations agree on these digits; what a float can hold is granted as well.
            own = max(10.0 ** -int(row["digits"]), 5e-16) * abs(float(value))
            key = row["model"], row["control"], int(row["steps"])
            found.setdefault(key, []).append(Reference(float(row["cos_theta"]), value, own))
    return found


def compare(
    key: Key, rtol: float, divisor_rtol: float = 1e-9
) -> Iterator[tuple[str, float, float, float]]:
    """For each cosine, what it is, the error, what bound and reference grant, and the value."""
    model, control, steps = key
    base = parse(model).model()
    pumped = albedo.pump(base, steps, None if control == "none" else control, rtol=divisor_rtol)
    for known in references()[key]:
        found = albedo.directional_albedo(pumped, known.cos_theta, rtol=rtol)
        error = abs(float(Decimal(float(found.value)) - known.value))
        granted = float(found.error) + known.uncertainty
        text = f"{pumped.spec} cos={known.cos_theta:g}: error {error:.3g}, granted {granted:.3g}"
        yield text, error, granted, abs(float(known.value))


every = pytest.mark.parametrize("key", references(), ids=lambda k: f"{k[0]}-{k[1]}-{k[2]}")


def test_there_are_references_for_both_steps_and_all_controls() -> None:
    assert {key[1:] for key in references()} == {
        (control, steps) for control in ("none", "literal", "cumulative") for steps in (1, 2)
    }
    assert sum(map(len, references().values())) >= 100


@every
def test_the_bound_covers_and_eight_digits_are_met(key: Key) -> None:
    for text, error, granted, scale in compare(key, 1e-8):
        assert error <= granted, text
        assert error <= 1e-8 * scale, text


@every
def test_ten_digits_are_met_where_they_are_asked_for(key: Key) -> None:
    for text, error, granted, scale in compare(key, 1e-10, 1e-11):
        assert error <= granted, text
        assert error <= 1e-10 * scale, text
