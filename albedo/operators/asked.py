"""What operators may be asked for."""

from __future__ import annotations

from numbers import Real
from typing import Any

from albedo.errors import InputError


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
    if isinstance(rtol, bool) or not isinstance(rtol, Real) or not 1e-12 <= float(rtol) <= 1e-3:
        raise InputError(f"{name} = {rtol!r} is out of range; it is a number in [1e-12, 1e-3]")
