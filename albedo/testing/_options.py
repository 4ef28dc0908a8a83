"""Options of the assertions that are looked at before anything is called."""

from __future__ import annotations

import numpy as np

from albedo.errors import InputError


def check_number(name: str, value: float, low: float, high: float) -> None:
    """Refuse what is no number in [low, high)."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value < high:
        raise InputError(f"{name} = {value!r} is out of range; it lies in [{low:g}, {high:g})")


def check_count(name: str, value: int, least: int) -> None:
    """Refuse what is no whole number from `least` on."""
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not whole or value < least:
        raise InputError(
            f"{name} = {value!r} is out of range; it must be a whole number >= {least}"
        )


def check_undecided(value: str) -> None:
    """Refuse what is neither of the two words."""
    if value not in ("fail", "pass"):
        raise InputError(f"undecided = {value!r} is unknown; choose fail or pass")
