"""Numbers that never travel without their error."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from decimal import ROUND_CEILING, Decimal

import numpy as np


def format_value(value: float, error: float) -> str:
    """Write a number with its error in the last digit, such as ``0.488993(2)``.

    The bracket covers the error and what rounding the number adds to it, rounded up.

    Parameters
    ----------
    value, error : float
        The number, and its error.

    Returns
    -------
    str
        At most 12 digits; ``∞`` where there is no finite number.
    """
    if math.isnan(value):
        return "not a number"
    if math.isinf(value):
        return "∞" if value > 0 else "-∞"
    if not math.isfinite(error):
        return f"{value:.6g} ± ∞"
    number, bound = Decimal(repr(float(value))), Decimal(repr(float(error)))
    size = number.adjusted() if number else 0
    # Beyond 12 digits a printed number is not more useful; the CSV has every digit.
    last = max(bound.adjusted(), size - 11) if bound else size - 11
    while True:
        unit = Decimal(1).scaleb(last)
        rounded = number.quantize(unit)
        spread = bound + abs(number - rounded)
        digits = int((spread / unit).to_integral_value(ROUND_CEILING))
        if digits < 10:
            break
        last += 1
    if not bound and number == rounded:
        return f"{value:.12g}"
    if -5 < size < 7 and last <= 0:
        return f"{rounded:f}({digits})"
    scale = max(size, last)
    return f"{rounded.scaleb(-scale):f}({digits})e{scale:+03d}"


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
