"""Gauss-Legendre rules on [0, 1] that report the error of their own value.

A rule of p nodes gives the integral and the first p Legendre coefficients of its integrand.
For an integrand that is analytic on the cell the coefficients a_k fall geometrically and the
error of the Gauss rule is the sum of its aliases, coefficients of index 2p and more
(Trefethen, *Is Gauss quadrature better than Clenshaw-Curtis?*, SIAM Review 50, 2008). The bound
extrapolates the fall that was observed over the upper half of the spectrum, less steeply than
geometric decay allows, so that algebraic decay (a kink that was not split) is covered as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

LADDER = (2, 3, 4, 5, 6, 8, 10, 12, 14, 16, 20, 24, 28, 32)
"""Numbers of nodes that cells may use."""

# The bound is _SAFETY * tail * fall**steepness; tests/test_rules.py measures how it covers.
_SAFETY = 30.0
_STEEPNESS = (1.0, 1.5)


@dataclass(frozen=True)
class Rule:
    """A Gauss-Legendre rule on [0, 1].

    Attributes
    ----------
    nodes, weights : ndarray, shape (p,)
        Nodes in (0, 1), and weights that sum to 1.
    to_coefficients : ndarray, shape (p, p)
        ``values @ to_coefficients`` are the coefficients of the shifted Legendre polynomials;
        the first one is the integral.
    """

    nodes: np.ndarray
    weights: np.ndarray
    to_coefficients: np.ndarray


@lru_cache(maxsize=None)
def gauss(p: int) -> Rule:
    """The Gauss-Legendre rule of `p` nodes on [0, 1]."""
    x, w = np.polynomial.legendre.leggauss(p)
    polynomials = np.polynomial.legendre.legvander(x, p - 1)
    scaled = polynomials * (w[:, None] / 2) * (2 * np.arange(p) + 1)
    return Rule((x + 1) / 2, w / 2, scaled)


def spectrum_bound(coefficients: np.ndarray) -> np.ndarray:
    """Bound on the quadrature error, from the Legendre coefficients of the integrand.

    Parameters
    ----------
    coefficients : ndarray, shape (..., p)
        Coefficients that a rule of p nodes gave; the first is the integral.

    Returns
    -------
    ndarray, shape (...)
        A bound on the error of the first coefficient, never negative.
    """
    a = np.abs(coefficients)
    p = a.shape[-1]
    if p < 6:
        # Too short a spectrum to see a rate: everything but the mean may be aliased.
        return 4.0 * a[..., 1:].sum(-1) + (0.25 if p < 4 else 0.0) * a[..., 0]
    tail = a[..., p - (4 if p > 8 else 3) :].max(-1)
    middle = np.maximum(a[..., p // 2 - 2 :].max(-1), tail)
    head = np.maximum(a[..., p // 4 - 1 :].max(-1), middle)
    last = a[..., p - 2 :].max(-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        # Per octave an algebraic spectrum falls by a constant factor, a geometric one by its square.
        fall = np.log(tail / middle)
        bend = np.where(head > middle, fall / np.log(middle / head), 0.0)
        octave = np.clip(0.75 * bend, *_STEEPNESS) * fall
        # A smooth part can hide an algebraic one until the last coefficients: follow their slope too.
        for shift in (2, max(2, p // 4)):
            before = np.maximum(a[..., p - 2 - shift :].max(-1), last)
            octave = np.maximum(octave, np.log(2) / np.log(p / (p - shift)) * np.log(last / before))
        octave = np.where(last > 0, octave, 0.0)
        return np.where(tail > 0, _SAFETY * tail * np.exp(octave), 0.0)
