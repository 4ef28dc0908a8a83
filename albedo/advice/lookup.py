"""Small tables and polynomials that stand for an albedo: how they are stored and read.

A table is an even grid in warped coordinates, read linearly or with four points along each axis
(Lagrange's cubic, one-sided at the ends). Its numbers are stored in float64, float32, float16, or
as 16-bit shares between its smallest and largest number (unorm16). A polynomial is a product of
powers of warped coordinates on [-1, 1]. Arithmetic is in float64 for all of them.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from albedo._compile import inlined, kernel

WARPS = ("linear", "sqrt", "angle", "log")
"""What an axis is even in: the coordinate, its root, its arc cosine, its logarithm."""
STORED = ("float64", "float32", "float16", "unorm16")
READ = ("linear", "cubic")
MOST_AXES = 3

_BYTES = {"float64": 8, "float32": 4, "float16": 2, "unorm16": 2}
# Powers of two for the exponents of float16, whose smallest numbers have an exponent of their own.
_HALVES = np.array([2.0**-24, *(2.0 ** (e - 25) for e in range(1, 31))])
_LARGEST_HALF = 65504.0


@inlined
def _warped(code, x):
    if code == 1:
        return math.sqrt(max(x, 0.0))
    if code == 2:
        return math.acos(min(max(x, -1.0), 1.0))
    if code == 3:
        return math.log(x)
    return x


@inlined
def _stored(code, a, b, table, i):
    """A number of a table: as it is, from the bits of a float16, or as a share."""
    if code == 0:
        return float(table[i])
    bits = int(table[i])
    if code == 1:
        exponent = bits >> 10
        digits = bits & 1023
        return (digits + (1024 if exponent > 0 else 0)) * _HALVES[exponent]
    return a + b * bits


@inlined
def _place(code, low, scale, count, x, points):
    """First of the points of a grid that are read, and where x lies from it."""
    t = (_warped(code, x) - low) * scale
    first = int(t) - (points // 2 - 1)
    first = min(max(first, 0), count - points)
    return first, t - first


@inlined
def _cubic(t):
    """Lagrange's weights of four points at 0, 1, 2, 3."""
    a, b, c = t - 1.0, t - 2.0, t - 3.0
    return -a * b * c / 6.0, 0.5 * t * b * c, -0.5 * t * a * c, t * a * b / 6.0


@inlined
def _row(code, a, b, table, i, t, cubic):
    """Along the last axis, from its first point on."""
    if cubic:
        w0, w1, w2, w3 = _cubic(t)
        return (
            w0 * _stored(code, a, b, table, i)
            + w1 * _stored(code, a, b, table, i + 1)
            + w2 * _stored(code, a, b, table, i + 2)
            + w3 * _stored(code, a, b, table, i + 3)
        )
    first = _stored(code, a, b, table, i)
    return first + t * (_stored(code, a, b, table, i + 1) - first)


@inlined
def _plane(code, a, b, table, i, width, s, t, cubic):
    """Over the last two axes."""
    if cubic:
        w0, w1, w2, w3 = _cubic(s)
        return (
            w0 * _row(code, a, b, table, i, t, cubic)
            + w1 * _row(code, a, b, table, i + width, t, cubic)
            + w2 * _row(code, a, b, table, i + 2 * width, t, cubic)
            + w3 * _row(code, a, b, table, i + 3 * width, t, cubic)
        )
    first = _row(code, a, b, table, i, t, cubic)
    return first + s * (_row(code, a, b, table, i + width, t, cubic) - first)


@kernel
def _read_line(x, warps, low, scale, counts, code, a, b, table, cubic, out):
    points = 4 if cubic else 2
    for i in range(out.size):
        k, t = _place(warps[0], low[0], scale[0], counts[0], x[0, i], points)
        out[i] = _row(code, a, b, table, k, t, cubic)


@kernel
def _read_plane(x, warps, low, scale, counts, code, a, b, table, cubic, out):
    points = 4 if cubic else 2
    width = counts[1]
    for i in range(out.size):
        j, s = _place(warps[0], low[0], scale[0], counts[0], x[0, i], points)
        k, t = _place(warps[1], low[1], scale[1], counts[1], x[1, i], points)
        out[i] = _plane(code, a, b, table, j * width + k, width, s, t, cubic)


@kernel
def _read_space(x, warps, low, scale, counts, code, a, b, table, cubic, out):
    points = 4 if cubic else 2
    width = counts[2]
    layer = counts[1] * width
    for i in range(out.size):
        m, r = _place(warps[0], low[0], scale[0], counts[0], x[0, i], points)
        j, s = _place(warps[1], low[1], scale[1], counts[1], x[1, i], points)
        k, t = _place(warps[2], low[2], scale[2], counts[2], x[2, i], points)
        at = m * layer + j * width + k
        first = _plane(code, a, b, table, at, width, s, t, cubic)
        second = _plane(code, a, b, table, at + layer, width, s, t, cubic)
        if cubic:
            third = _plane(code, a, b, table, at + 2 * layer, width, s, t, cubic)
            fourth = _plane(code, a, b, table, at + 3 * layer, width, s, t, cubic)
            w0, w1, w2, w3 = _cubic(r)
            out[i] = w0 * first + w1 * second + w2 * third + w3 * fourth
        else:
            out[i] = first + r * (second - first)


@inlined
def _horner(table, first, count, t):
    """A polynomial whose coefficients stand from `first` on, the highest power first."""
    value = table[first]
    for k in range(1, count):
        value = value * t + table[first + k]
    return value


@inlined
def _unit(code, low, scale, x):
    """A warped coordinate on [-1, 1]."""
    return (_warped(code, x) - low) * scale - 1.0


@kernel
def _powers_line(x, warps, low, scale, counts, table, out):
    count = counts[0]
    for i in range(out.size):
        out[i] = _horner(table, 0, count, _unit(warps[0], low[0], scale[0], x[0, i]))


@inlined
def _horner_plane(table, first, rows, count, s, t):
    """A polynomial in s whose coefficients are polynomials in t."""
    value = _horner(table, first, count, t)
    for j in range(1, rows):
        value = value * s + _horner(table, first + j * count, count, t)
    return value


@kernel
def _powers_plane(x, warps, low, scale, counts, table, out):
    rows, count = counts[0], counts[1]
    for i in range(out.size):
        s = _unit(warps[0], low[0], scale[0], x[0, i])
        t = _unit(warps[1], low[1], scale[1], x[1, i])
        out[i] = _horner_plane(table, 0, rows, count, s, t)


@kernel
def _powers_space(x, warps, low, scale, counts, table, out):
    layers, rows, count = counts[0], counts[1], counts[2]
    for i in range(out.size):
        r = _unit(warps[0], low[0], scale[0], x[0, i])
        s = _unit(warps[1], low[1], scale[1], x[1, i])
        t = _unit(warps[2], low[2], scale[2], x[2, i])
        value = _horner_plane(table, 0, rows, count, s, t)
        for m in range(1, layers):
            value = value * r + _horner_plane(table, m * rows * count, rows, count, s, t)
        out[i] = value


_READERS = {1: _read_line, 2: _read_plane, 3: _read_space}
_SUMS = {1: _powers_line, 2: _powers_plane, 3: _powers_space}


def warp(name: str, values: Any) -> np.ndarray:
    """Values of a coordinate as the axis of a table is even in them."""
    x = np.asarray(values, dtype=np.float64)
    if name == "sqrt":
        return np.sqrt(x)
    if name == "angle":
        return np.arccos(x)
    return np.log(x) if name == "log" else x


def unwarp(name: str, values: np.ndarray) -> np.ndarray:
    """The coordinate of warped values."""
    if name == "sqrt":
        return values * values
    if name == "angle":
        return np.cos(values)
    return np.exp(values) if name == "log" else values


@dataclass(frozen=True)
class Grid:
    """Axes of a table, or of a polynomial.

    Attributes
    ----------
    names : tuple of str
        Of the coordinates.
    ends : tuple of (float, float)
        Where each begins and ends, in the coordinate itself.
    warps : tuple of str
        Of `WARPS`, what each is even in.
    counts : tuple of int
        Points along each axis, or coefficients.
    """

    names: tuple[str, ...]
    ends: tuple[tuple[float, float], ...]
    warps: tuple[str, ...]
    counts: tuple[int, ...]

    @property
    def warped_ends(self) -> np.ndarray:
        """The ends in what each axis is even in, shape (axes, 2), the smaller first."""
        found = [
            np.sort(warp(name, ends)) for name, ends in zip(self.warps, self.ends, strict=True)
        ]
        return np.array(found)

    def nodes(self) -> list[np.ndarray]:
        """Coordinates of the points along each axis."""
        found = []
        for name, (low, high), count, own in zip(
            self.warps, self.warped_ends.tolist(), self.counts, self.ends, strict=True
        ):
            values = unwarp(name, np.linspace(low, high, count))
            found.append(np.clip(values, min(own), max(own)))
        return found

    def _numbers(self, steps: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Codes of the warps, lower ends, and steps per warped unit."""
        ends = self.warped_ends
        codes = np.array([WARPS.index(name) for name in self.warps])
        return codes, np.ascontiguousarray(ends[:, 0]), steps / (ends[:, 1] - ends[:, 0])

    def __str__(self) -> str:
        said = {"linear": "", "sqrt": "root of ", "angle": "angle of ", "log": "log of "}
        axes = [said[w] + n for n, w in zip(self.names, self.warps, strict=True)]
        return " x ".join(
            f"{count} ({axis})" for count, axis in zip(self.counts, axes, strict=True)
        )


@dataclass(frozen=True, eq=False)
class Table:
    """A stored table.

    Attributes
    ----------
    grid : Grid
    stored : str
        Of `STORED`.
    read : str
        Of `READ`.
    data : ndarray
        The numbers as they are stored, all axes in one.
    low, step : float
        What unorm16 shares are shares of.
    """

    grid: Grid
    stored: str
    read: str
    data: np.ndarray
    low: float = 0.0
    step: float = 1.0

    @classmethod
    def of(cls, grid: Grid, values: np.ndarray, stored: str, read: str) -> Table:
        """Store values at the nodes of a grid, shape as its counts."""
        flat = np.ascontiguousarray(values, dtype=np.float64).ravel()
        if stored == "float16":
            # Larger numbers do not exist there: they become infinite, and fail where it is tested.
            with np.errstate(over="ignore"):
                return cls(grid, stored, read, flat.astype(np.float16).view(np.uint16))
        if stored == "unorm16":
            low, high = float(flat.min()), float(flat.max())
            step = (high - low) / 65535.0 or 1.0
            return cls(
                grid, stored, read, np.rint((flat - low) / step).astype(np.uint16), low, step
            )
        return cls(grid, stored, read, flat.astype(stored))

    @property
    def bytes(self) -> int:
        """What the numbers take."""
        return int(self.data.nbytes)

    def numbers(self) -> dict[str, Any]:
        """The numbers as they are stored, for other programs.

        Returns
        -------
        dict
            ``data``; of float16 and unorm16 the 16 bits of each. A unorm16 share k stands for
            ``low`` + ``step`` k.
        """
        scale = {"low": self.low, "step": self.step} if self.stored == "unorm16" else {}
        return {"data": self.data.tolist(), **scale}

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Read the table at coordinates, shape (axes, n)."""
        out = np.empty(x.shape[1])
        self.fill(np.ascontiguousarray(x), out)
        return out

    def fill(self, x: np.ndarray, out: np.ndarray) -> None:
        """The same, into an array."""
        counts = np.array(self.grid.counts)
        code = {"float16": 1, "unorm16": 2}.get(self.stored, 0)
        reader = _READERS[len(counts)]
        numbers = self.grid._numbers(counts - 1.0)
        reader(
            *(x, *numbers, counts, code, self.low, self.step, self.data, self.read == "cubic", out)
        )


@dataclass(frozen=True, eq=False)
class Polynomial:
    """Powers of warped coordinates on [-1, 1].

    Attributes
    ----------
    grid : Grid
        Its counts are the degrees + 1.
    stored : str
        float64 or float32.
    data : ndarray
        Coefficients, the highest power of every axis first, all axes in one.
    """

    grid: Grid
    stored: str
    data: np.ndarray

    @classmethod
    def of(cls, grid: Grid, chebyshev: np.ndarray, stored: str) -> Polynomial:
        """From coefficients of products of Chebyshev polynomials in the warped coordinates."""
        powers = np.asarray(chebyshev, dtype=np.float64)
        for axis in range(powers.ndim):
            powers = np.apply_along_axis(_powers, axis, powers)
        return cls(grid, stored, np.ascontiguousarray(powers).ravel().astype(stored))

    @property
    def bytes(self) -> int:
        """What the coefficients take."""
        return int(self.data.nbytes)

    def numbers(self) -> dict[str, Any]:
        """The coefficients, for other programs."""
        return {"data": self.data.tolist()}

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Values at coordinates, shape (axes, n)."""
        out = np.empty(x.shape[1])
        self.fill(np.ascontiguousarray(x), out)
        return out

    def fill(self, x: np.ndarray, out: np.ndarray) -> None:
        """The same, into an array."""
        counts = np.array(self.grid.counts)
        numbers = self.grid._numbers(np.full(len(counts), 2.0))
        _SUMS[len(counts)](x, *numbers, counts, self.data, out)


def _powers(chebyshev: np.ndarray) -> np.ndarray:
    """Coefficients of powers, the highest first, of as many of Chebyshev polynomials."""
    found = np.zeros(len(chebyshev))
    powers = np.polynomial.chebyshev.cheb2poly(chebyshev)
    found[: len(powers)] = powers
    return found[::-1].copy()


def size_of(counts: Sequence[int], stored: str) -> int:
    """Bytes of a table with so many points along its axes."""
    return math.prod(counts) * _BYTES[stored]


def warps_for(name: str, low: float) -> tuple[str, ...]:
    """Warps that a coordinate is tried with."""
    if name == "cos_theta":
        return "linear", "sqrt", "angle"
    if name == "phi":
        return ("linear",)
    return ("linear", "sqrt", "log") if low > 0.0 else ("linear", "sqrt")


def all_warps(names: Sequence[str], lows: Sequence[float]) -> list[tuple[str, ...]]:
    """All combinations of warps of several coordinates."""
    return list(itertools.product(*(warps_for(n, low) for n, low in zip(names, lows, strict=True))))
