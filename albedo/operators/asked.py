"""What operators may be asked for."""

from __future__ import annotations

from numbers import Real
from typing import Any

from albedo.errors import InputError

FINEST, COARSEST = 1e-12, 1e-3
"""What tables may be asked to be worth, relatively."""


def check_rtol(rtol: Any, name: str = "rtol") -> None:
    """Raise InputError for what no table can be worth; None asks for nothing.

    Parameters
    ----------
    rtol : object
        As it was given.
    name : str
        What it is called.

    Raises
    ------
    InputError
        For anything but numbers in [1e-12, 1e-3].
    """
    if rtol is None:
        return
    number = isinstance(rtol, Real) and not isinstance(rtol, bool)
    if not number or not FINEST <= float(rtol) <= COARSEST:
        ends = f"[{FINEST:g}, {COARSEST:g}]"
        raise InputError(f"{name} = {rtol!r} is out of range; it is a number in {ends}")
