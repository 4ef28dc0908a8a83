"""Numbers that never travel without their error."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np


def format_value(value: float, error: float) -> str:
    """`value` with its error in units of the last digit: ``0.488993(2)``.

    Parameters
    ----------
    value, error : float
        A number and the bound of its error, which is rounded up to one digit.

    Returns
    -------
    str
        Such as ``0.488993(2)``; ``1.00(0)`` when the error is 0; ``nan`` as it is.
    """
    if not math.isfinite(value):
        return str(value)
    if not math.isfinite(error):
        return f"{value:.3g}(inf)"
    if error == 0.0:
        return f"{value!r}(0)"
    exponent = math.floor(math.log10(error))
    digit = math.ceil(error / 10.0**exponent - 1e-9)
    if digit == 10:
        exponent, digit = exponent + 1, 1
    if exponent >= 0:
        return f"{round(value, -exponent):.0f}({digit * 10**exponent})"
    if abs(value) >= 1e-4 or value == 0.0:
        return f"{value:.{-exponent}f}({digit})"
    lead = math.floor(math.log10(abs(value)))
    return f"{value / 10.0**lead:.{max(lead - exponent, 0)}f}({digit})e{lead:+03d}"


@dataclass(frozen=True, eq=False)
class Estimate:
    """Values with their errors, and how they were come by.

    Attributes
    ----------
    value, error : ndarray
        Of one shape. What `error` means is said by `kind`.
    kind : {"bound", "standard_error"}
        ``bound``: the true value is within `error` of `value`.
    evaluations : ndarray of int
        Evaluations of the model per value, those of the bound included.
    converged : ndarray of bool
        Whether the tolerance that was asked for was met.
    resolved_width : float or None
        When the model declares nothing about itself: the feature width, in radians, down to
        which the bound holds.
    parts : mapping of str to Estimate
        The contributions of the parts of the model when it has several.
    """

    value: np.ndarray
    error: np.ndarray
    kind: str
    evaluations: np.ndarray
    converged: np.ndarray
    resolved_width: float | None = None
    parts: Mapping[str, Estimate] = field(default_factory=dict)

    def __str__(self) -> str:
        flat = [
            format_value(float(v), float(e))
            for v, e in zip(np.ravel(self.value), np.ravel(self.error), strict=True)
        ]
        text = np.array(flat, dtype=object).reshape(np.shape(self.value)).tolist()
        body = text if isinstance(text, str) else str(text).replace("'", "")
        width = f", features of {self.resolved_width:g} rad" if self.resolved_width else ""
        return f"{body} [{self.kind}{width}]"

    def __repr__(self) -> str:
        return f"Estimate({self})"
