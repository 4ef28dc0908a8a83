"""What the axis of a table is even in.

``linear``, ``sqrt``, ``angle`` (the arc cosine) and ``log`` have no numbers of their own. The
rational family s = x (1 + k)/(x + k) is even in x for a large k, and crowds the nodes at 0 for a
small one; its k is a number, ``rational:0.3``, or a multiple of another coordinate,
``rational:0.5*m``, so that a table is as fine near the horizon as a smooth surface needs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from albedo._compile import inlined
from albedo.errors import InputError

KINDS = ("linear", "sqrt", "angle", "log", "rational")
"""All that an axis may be even in; kernels know them by their place here."""

_LEAST, _MOST = 1e-9, 1e9


@inlined
def warped(code, k, x):
    """A coordinate as an axis is even in it."""
    if code == 1:
        return math.sqrt(max(x, 0.0))
    if code == 2:
        return math.acos(min(max(x, -1.0), 1.0))
    if code == 3:
        return math.log(x)
    if code == 4:
        return x * (1.0 + k) / (x + k)
    return x


@dataclass(frozen=True)
class Warp:
    """What an axis is even in.

    Attributes
    ----------
    kind : str
        Of `KINDS`.
    k : float
        Of the rational family; a factor where `by` is not empty.
    by : str
        The coordinate that k is a multiple of.
    """

    kind: str
    k: float = 0.0
    by: str = ""

    @classmethod
    def parse(cls, text: str) -> Warp:
        """Read such as ``sqrt``, ``rational:0.3`` or ``rational:0.5*m``.

        Raises
        ------
        InputError
            For an unknown kind, or a k outside [1e-9, 1e9].
        """
        kind, colon, rest = text.partition(":")
        if kind not in KINDS or (kind == "rational") != bool(colon):
            raise InputError(
                f"the warp {text!r} is unknown; it is one of linear, sqrt, angle, log, rational:K "
                "and rational:K*NAME"
            )
        if kind != "rational":
            return cls(kind)
        number, star, by = rest.partition("*")
        try:
            k = float(number)
        except ValueError:
            k = math.nan
        if not _LEAST <= k <= _MOST or bool(star) != bool(by):
            raise InputError(
                f"the warp {text!r} is out of range; K of rational:K and rational:K*NAME lies in "
                f"[{_LEAST:g}, {_MOST:g}]"
            )
        return cls(kind, k, by)

    def __str__(self) -> str:
        if self.kind != "rational":
            return self.kind
        return f"rational:{self.k!r}" + (f"*{self.by}" if self.by else "")

    @property
    def code(self) -> int:
        """What kernels know the kind by."""
        return KINDS.index(self.kind)

    def __call__(self, values: Any, other: Any = 1.0) -> np.ndarray:
        """Values of a coordinate as an axis is even in them; `other` is what `by` names."""
        x = np.asarray(values, dtype=np.float64)
        if self.kind == "sqrt":
            return np.sqrt(x)
        if self.kind == "angle":
            return np.arccos(x)
        if self.kind == "log":
            return np.log(x)
        if self.kind == "rational":
            k = self.k * (np.asarray(other, dtype=np.float64) if self.by else 1.0)
            return x * (1.0 + k) / (x + k)
        return x

    def inverse(self, values: Any, other: Any = 1.0) -> np.ndarray:
        """The coordinate of warped values."""
        s = np.asarray(values, dtype=np.float64)
        if self.kind == "sqrt":
            return s * s
        if self.kind == "angle":
            return np.cos(s)
        if self.kind == "log":
            return np.exp(s)
        if self.kind == "rational":
            k = self.k * (np.asarray(other, dtype=np.float64) if self.by else 1.0)
            return s * k / (1.0 + k - s)
        return s
