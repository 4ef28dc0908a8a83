"""Lobes as papers print them, in cosines, beside the models that have them in slopes.

They are kept to be measured: next to a peak of width m a cosine is 1 - m^2, and a rounding of it
moves the lobe.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from albedo.catalogue.blinn import normalization


def n_dot_h(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    h = wi + wo
    return h[..., 2] / np.sqrt((h * h).sum(-1))


def ward_printed(wi: np.ndarray, wo: np.ndarray, m: float) -> np.ndarray:
    """exp(-tan^2/m^2)/(4 pi m^2 sqrt(n.l n.v)), tan^2 = 1/(n.h)^2 - 1."""
    c = n_dot_h(wi, wo)
    root = np.sqrt(wi[..., 2] * wo[..., 2])
    return np.exp(-(1.0 / (c * c) - 1.0) / (m * m)) / (4.0 * math.pi * m * m * root)


def schlick_printed(wi: np.ndarray, wo: np.ndarray, m: float) -> np.ndarray:
    """Z = r/(1 + r t^2 - t^2)^2, t = n.h (Schwenk eq. 50), r = m^2."""
    t, r = n_dot_h(wi, wo), m * m
    z = r / (1.0 + r * t * t - t * t) ** 2
    return z / (4.0 * math.pi * wi[..., 2] * wo[..., 2])


def phong_printed(wi: np.ndarray, wo: np.ndarray, m: float) -> np.ndarray:
    """(n + 2)/(2 pi) (r.v)^n, r.v = 2 (n.l)(n.v) - l.v, n = 2/m^2."""
    n = 2.0 / (m * m)
    r_v = 2.0 * wi[..., 2] * wo[..., 2] - (wi * wo).sum(-1)
    return (n + 2.0) / (2.0 * math.pi) * np.maximum(r_v, 0.0) ** n


def blinn_printed(wi: np.ndarray, wo: np.ndarray, m: float) -> np.ndarray:
    """(n.h)^n, n = 2/m^2."""
    return n_dot_h(wi, wo) ** (2.0 / (m * m)) / (2.0 * math.pi)


@dataclass(frozen=True)
class Printed:
    """A formula as printed.

    Attributes
    ----------
    function : callable
        ``function(wi, wo, m)``: values in 1/sr of a lobe of width m, directions (..., 3).
    spec : callable
        A model with that lobe in slopes or distances, for a width.
    narrowest : float
        The narrowest width of that model.
    plain : str
        What has to follow the spec for a model that is this lobe and nothing else.
    constant : callable
        What the values of that model are over those of the function, for a width.
    """

    function: Callable[[np.ndarray, np.ndarray, Any], np.ndarray]
    spec: Callable[[float], str]
    narrowest: float
    plain: str = ""
    constant: Callable[[float], float] = lambda m: 1.0

    def same(self, m: float) -> str:
        """The model that has these values, times the constant."""
        return self.spec(m) + self.plain


FORMULAS: dict[str, Printed] = {
    "Ward": Printed(ward_printed, lambda m: f"ward:m={m!r}", 1e-8),
    "Schlick's Z": Printed(
        schlick_printed, lambda m: f"schlick:roughness={m * m:.17g}", 1e-8, ",form=plain"
    ),
    "Phong": Printed(phong_printed, lambda m: f"phong:n={2.0 / (m * m):.17g}", 1e-4),
    "Blinn": Printed(
        blinn_printed,
        lambda m: f"blinn:n={2.0 / (m * m):.17g}",
        1e-4,
        constant=lambda m: 2.0 * math.pi * normalization(2.0 / (m * m)),
    ),
}
"""Formulas as printed, by what they are called."""
