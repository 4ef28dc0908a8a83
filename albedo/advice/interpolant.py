"""An albedo over the ranges of a scene in Chebyshev polynomials, from which tables are cut."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from albedo.lookup.warps import Warp

_FIRST, _LARGEST = 9, 129
# Coefficients that are looked at to tell whether an axis has enough of them.
_LAST = 2


@dataclass(frozen=True, eq=False)
class Interpolant:
    """A function of a few coordinates, each warped onto [-1, 1].

    Attributes
    ----------
    names : tuple of str
        Of the coordinates.
    ends : tuple of (float, float)
        The smaller and the larger end of each.
    warps : tuple of str
        What each is taken in; see `albedo.lookup.warps.Warp`.
    coefficients : ndarray
        Of products of Chebyshev polynomials, an axis for each coordinate.
    resolved : bool
        Whether the last coefficients of every axis are small enough.
    """

    names: tuple[str, ...]
    ends: tuple[tuple[float, float], ...]
    warps: tuple[str, ...]
    coefficients: np.ndarray
    resolved: bool

    def grid(self, nodes: Sequence[np.ndarray]) -> np.ndarray:
        """Values at all combinations of coordinates along the axes."""
        found = self.coefficients
        for axis, values in enumerate(nodes):
            matrix = self._matrix(axis, values)
            found = np.moveaxis(np.tensordot(matrix, found, axes=(1, axis)), 0, axis)
        return found

    def _matrix(self, axis: int, values: np.ndarray) -> np.ndarray:
        own = Warp.parse(self.warps[axis])
        low, high = np.sort(own(self.ends[axis]))
        x = (2.0 * own(values) - (low + high)) / (high - low)
        count = self.coefficients.shape[axis]
        return np.polynomial.chebyshev.chebvander(np.clip(x, -1.0, 1.0), count - 1)

    def over(self, kept: Sequence[int]) -> Interpolant:
        """The mean, in the sense of the first coefficient, over all other coordinates."""
        index = tuple(slice(None) if k in kept else 0 for k in range(len(self.names)))
        return Interpolant(
            tuple(self.names[k] for k in kept),
            tuple(self.ends[k] for k in kept),
            tuple(self.warps[k] for k in kept),
            self.coefficients[index],
            self.resolved,
        )

    def in_warps(self, warps: Sequence[str]) -> Interpolant:
        """The same function in polynomials of other warps of its coordinates."""
        sizes = self.coefficients.shape
        found = _coefficients(self.grid(_nodes(self.ends, warps, sizes)))
        return Interpolant(self.names, self.ends, tuple(warps), found, self.resolved)


def _nodes(
    ends: Sequence[tuple[float, float]], warps: Sequence[str], sizes: Sequence[int]
) -> list[np.ndarray]:
    """Chebyshev's points of the first kind along every axis."""
    found = []
    for own, name, size in zip(ends, warps, sizes, strict=True):
        warp = Warp.parse(name)
        low, high = np.sort(warp(own))
        x = np.cos(math.pi * (np.arange(size) + 0.5) / size)
        values = warp.inverse(0.5 * (low + high) + 0.5 * (high - low) * x)
        found.append(np.clip(values, *own))
    return found


def _coefficients(values: np.ndarray) -> np.ndarray:
    """Coefficients of the polynomials through values at Chebyshev's points."""
    found = values
    for axis, size in enumerate(values.shape):
        k, j = np.arange(size)[:, None], np.arange(size)
        matrix = np.cos(math.pi * k * (j + 0.5) / size) * (2.0 / size)
        matrix[0] *= 0.5
        found = np.moveaxis(np.tensordot(matrix, found, axes=(1, axis)), 0, axis)
    return found


def interpolate(
    function: Callable[[list[np.ndarray]], np.ndarray],
    names: tuple[str, ...],
    ends: tuple[tuple[float, float], ...],
    warps: tuple[str, ...],
    allowed: float,
    most: int,
) -> Interpolant:
    """Interpolate with more nodes along the axes that need them.

    Parameters
    ----------
    function : callable
        Values for lists of coordinates, one for each name, shape (n,) each.
    names, ends, warps
        See `Interpolant`.
    allowed : float
        What the last coefficients may be.
    most : int
        Values that may be asked for in one rule.

    Returns
    -------
    Interpolant
        With `resolved` false where `most` was not enough.
    """
    sizes = [_FIRST] * len(names)
    while math.prod(sizes) > most and max(sizes) > 3:
        sizes = [size - 2 for size in sizes]
    while True:
        mesh = np.meshgrid(*_nodes(ends, warps, sizes), indexing="ij")
        values = function([m.ravel() for m in mesh]).reshape(sizes)
        found = _coefficients(values)
        short = [axis for axis in range(len(sizes)) if not _enough(found, axis, allowed)]
        grown = [2 * n - 1 if axis in short else n for axis, n in enumerate(sizes)]
        if not short or max(grown) > _LARGEST or math.prod(grown) > most:
            return Interpolant(names, ends, warps, found, not short)
        sizes = grown


def _enough(coefficients: np.ndarray, axis: int, allowed: float) -> bool:
    """Whether the last coefficients along an axis are small, for all of the other axes together."""
    last = np.moveaxis(coefficients, axis, 0)[-_LAST:]
    return bool(np.abs(last).reshape(len(last), -1).sum(1).max() <= allowed)
