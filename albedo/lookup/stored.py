"""Small tables and polynomials that stand for an albedo: how they are stored and read.

A table is an even grid in warped coordinates, read linearly or with four points along each axis
(Lagrange's cubic, one-sided at the ends). Its numbers are stored in float64, float32, float16, or
as shares of 16 or 8 bits between its smallest and largest number (unorm16, unorm8). Beyond its
outermost nodes a table has what it has there, as textures do. A polynomial is a product of powers
of warped coordinates on [-1, 1]. Arithmetic is in float64 for all of them.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from albedo._compile import inlined, kernel
from albedo.lookup.warps import Warp, warped

STORED = ("float64", "float32", "float16", "unorm16", "unorm8")
"""How numbers may be stored."""
READ = ("linear", "cubic")
"""How a table is read: with two points along each axis, or with four."""
TEXELS = ("ends", "centres")
"""Where nodes lie: on both ends of an axis, or in the middle of as many equal texels."""
MOST_AXES = 3

_BYTES = {"float64": 8, "float32": 4, "float16": 2, "unorm16": 2, "unorm8": 1}
# What the largest share stands for.
_SHARES = {"unorm16": 65535, "unorm8": 255}
# Powers of two for the exponents of float16, whose smallest numbers have an exponent of their own.
_HALVES = np.array([2.0**-24, *(2.0 ** (e - 25) for e in range(1, 31)), math.inf])


@inlined
def _stored(code, a, b, table, i):
    """A number of a table: as it is, from the bits of a float16, or as a share."""
    if code == 0:
        return float(table[i])
    bits = int(table[i])
    if code == 1:
        exponent = (bits >> 10) & 31
        digits = (bits & 1023) + (1024 if exponent > 0 else 0)
        return (-digits if bits >> 15 else digits) * _HALVES[exponent]
    return a + b * bits


@inlined
def _axis(axes, a):
    """What is known of an axis, in numbers that stay in registers."""
    own = axes[a]
    return (
        *(int(own[0]), own[1], int(own[2]), own[3], own[4], own[5], own[6]),
        *(own[7], own[8], int(own[9])),
    )


@inlined
def _along(axis, a, x, i):
    """Coordinate i along an axis, in steps from where its warped range begins."""
    code, k, by, low, high, first, scale, steps, _, _ = axis
    if by < 0:
        return (warped(code, k, x[a, i]) - first) * scale
    k *= x[by, i]
    first = warped(code, k, low)
    return steps * (warped(code, k, x[a, i]) - first) / (warped(code, k, high) - first)


@inlined
def _place(axis, a, x, i, points):
    """First of the points of a grid that are read, and where coordinate i lies from it."""
    _, _, _, _, _, _, _, _, shift, count = axis
    t = min(max(_along(axis, a, x, i) + shift, 0.0), count - 1.0)
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
def _read_line(x, axes, code, a, b, table, cubic, out):
    axis_0 = _axis(axes, 0)
    points = 4 if cubic else 2
    for i in range(out.size):
        k, t = _place(axis_0, 0, x, i, points)
        out[i] = _row(code, a, b, table, k, t, cubic)


@kernel
def _read_plane(x, axes, code, a, b, table, cubic, out):
    axis_0 = _axis(axes, 0)
    axis_1 = _axis(axes, 1)
    points = 4 if cubic else 2
    width = axis_1[9]
    for i in range(out.size):
        j, s = _place(axis_0, 0, x, i, points)
        k, t = _place(axis_1, 1, x, i, points)
        out[i] = _plane(code, a, b, table, j * width + k, width, s, t, cubic)


@kernel
def _read_space(x, axes, code, a, b, table, cubic, out):
    axis_0 = _axis(axes, 0)
    axis_1 = _axis(axes, 1)
    axis_2 = _axis(axes, 2)
    points = 4 if cubic else 2
    width = axis_2[9]
    layer = axis_1[9] * width
    for i in range(out.size):
        m, r = _place(axis_0, 0, x, i, points)
        j, s = _place(axis_1, 1, x, i, points)
        k, t = _place(axis_2, 2, x, i, points)
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
def _unit(axis, a, x, i):
    """A warped coordinate on [-1, 1]."""
    return _along(axis, a, x, i) - 1.0


@kernel
def _powers_line(x, axes, table, out):
    axis_0 = _axis(axes, 0)
    count = axis_0[9]
    for i in range(out.size):
        out[i] = _horner(table, 0, count, _unit(axis_0, 0, x, i))


@inlined
def _horner_plane(table, first, rows, count, s, t):
    """A polynomial in s whose coefficients are polynomials in t."""
    value = _horner(table, first, count, t)
    for j in range(1, rows):
        value = value * s + _horner(table, first + j * count, count, t)
    return value


@kernel
def _powers_plane(x, axes, table, out):
    axis_0 = _axis(axes, 0)
    axis_1 = _axis(axes, 1)
    rows, count = axis_0[9], axis_1[9]
    for i in range(out.size):
        s = _unit(axis_0, 0, x, i)
        t = _unit(axis_1, 1, x, i)
        out[i] = _horner_plane(table, 0, rows, count, s, t)


@kernel
def _powers_space(x, axes, table, out):
    axis_0 = _axis(axes, 0)
    axis_1 = _axis(axes, 1)
    axis_2 = _axis(axes, 2)
    layers, rows, count = axis_0[9], axis_1[9], axis_2[9]
    for i in range(out.size):
        r = _unit(axis_0, 0, x, i)
        s = _unit(axis_1, 1, x, i)
        t = _unit(axis_2, 2, x, i)
        value = _horner_plane(table, 0, rows, count, s, t)
        for m in range(1, layers):
            value = value * r + _horner_plane(table, m * rows * count, rows, count, s, t)
        out[i] = value


_READERS = {1: _read_line, 2: _read_plane, 3: _read_space}
_SUMS = {1: _powers_line, 2: _powers_plane, 3: _powers_space}


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
        What each is even in; see `albedo.lookup.warps.Warp`.
    counts : tuple of int
        Points along each axis, or coefficients.
    texels : str
        Of `TEXELS`, where the points lie.
    """

    names: tuple[str, ...]
    ends: tuple[tuple[float, float], ...]
    warps: tuple[str, ...]
    counts: tuple[int, ...]
    texels: str = "ends"

    @property
    def warped_ends(self) -> np.ndarray:
        """The ends in what each axis is even in, shape (axes, 2), the smaller first.

        Of a warp that depends on another coordinate, where that is 1.
        """
        found = [
            np.sort(Warp.parse(text)(np.array(ends)))
            for text, ends in zip(self.warps, self.ends, strict=True)
        ]
        return np.array(found)

    def nodes(self) -> list[np.ndarray]:
        """Coordinates of the points along each axis, where any other coordinate is 1."""
        lines = [self.shares(count) for count in self.counts]
        return [self._along(axis, line, 1.0) for axis, line in enumerate(lines)]

    def points(self) -> np.ndarray:
        """Coordinates of all points, shape (axes, points), the last axis running fastest."""
        lines = self.nodes()
        found = np.array([m.ravel() for m in np.meshgrid(*lines, indexing="ij")])
        if any(Warp.parse(text).by for text in self.warps):
            shares = [self.shares(count) for count in self.counts]
            whole = self.at(np.array([m.ravel() for m in np.meshgrid(*shares, indexing="ij")]))
            for axis, text in enumerate(self.warps):
                if Warp.parse(text).by:
                    found[axis] = whole[axis]
        return found

    def shares(self, count: int) -> np.ndarray:
        """Where points lie along a warped axis, from 0 at its beginning to 1 at its end."""
        if self.texels == "ends":
            return np.linspace(0.0, 1.0, count)
        return (np.arange(count) + 0.5) / count

    def between(self, within: int) -> Grid:
        """Points at all nodes and, as many times as finely, between them and at both ends."""
        cells = [n - 1 if self.texels == "ends" else n for n in self.counts]
        return replace(self, counts=tuple(within * n + 1 for n in cells), texels="ends")

    def at(self, shares: np.ndarray) -> np.ndarray:
        """Coordinates, shape (axes, n), at shares of the warped axes, of the same shape."""
        found = np.empty(shares.shape)
        # What depends on another coordinate comes after it.
        for axis in sorted(
            range(len(self.names)), key=lambda a: bool(Warp.parse(self.warps[a]).by)
        ):
            by = Warp.parse(self.warps[axis]).by
            other = found[self.names.index(by)] if by else 1.0
            found[axis] = self._along(axis, shares[axis], other)
        return found

    def _along(self, axis: int, share: np.ndarray, other: Any) -> np.ndarray:
        own, ends = Warp.parse(self.warps[axis]), self.ends[axis]
        first, last = own(min(ends), other), own(max(ends), other)
        # The angle falls with its cosine, and the smaller warped value comes first.
        low, high = np.minimum(first, last), np.maximum(first, last)
        found = own.inverse(low + share * (high - low), other)
        return np.clip(found, min(ends), max(ends))

    def share_of(self, x: np.ndarray) -> np.ndarray:
        """Where coordinates, shape (axes, n), lie along the warped axes, from 0 to 1."""
        found = np.empty(x.shape)
        for axis, (text, ends) in enumerate(zip(self.warps, self.ends, strict=True)):
            own = Warp.parse(text)
            other = x[self.names.index(own.by)] if own.by else 1.0
            first, last = own(min(ends), other), own(max(ends), other)
            low, high = np.minimum(first, last), np.maximum(first, last)
            found[axis] = (own(x[axis], other) - low) / (high - low)
        return found

    def numbers(self, steps: float | None = None) -> np.ndarray:
        """What kernels know of the axes, shape (axes, 10), in the order of `_axis`.

        An axis has as many steps as there are from node to node, if their number is not given.
        """
        found = np.zeros((len(self.names), 10))
        for axis, (text, ends, count) in enumerate(
            zip(self.warps, self.ends, self.counts, strict=True)
        ):
            own = Warp.parse(text)
            by = self.names.index(own.by) if own.by else -1
            # Where a warp depends on another coordinate, kernels find its ends at each place.
            first, last = np.sort(own(np.array(ends)))
            own_steps, shift = (count - 1.0, 0.0) if self.texels == "ends" else (count, -0.5)
            if steps is not None:
                own_steps, shift = steps, 0.0
            found[axis] = (
                *(own.code, own.k, by, *ends, first, own_steps / (last - first)),
                *(own_steps, shift, count),
            )
        return found

    def __str__(self) -> str:
        said = {"linear": "", "sqrt": "root of ", "angle": "angle of ", "log": "log of "}
        axes = [
            said[w] + n if w in said else f"{w} of {n}"
            for n, w in zip(self.names, self.warps, strict=True)
        ]
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
        What shares are shares of.
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
        if stored in _SHARES:
            low, high = float(flat.min()), float(flat.max())
            step = (high - low) / _SHARES[stored] or 1.0
            bits = np.uint16 if stored == "unorm16" else np.uint8
            return cls(grid, stored, read, np.rint((flat - low) / step).astype(bits), low, step)
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
            ``data``; of float16 the 16 bits of each. A share k of unorm16 or unorm8 stands for
            ``low`` + ``step`` k.
        """
        scale = {"low": self.low, "step": self.step} if self.stored in _SHARES else {}
        return {"data": self.data.tolist(), **scale}

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Read the table at coordinates, shape (axes, n)."""
        out = np.empty(x.shape[1])
        self.fill(np.ascontiguousarray(x), out)
        return out

    def fill(self, x: np.ndarray, out: np.ndarray) -> None:
        """The same, into an array."""
        code = {"float16": 1, "unorm16": 2, "unorm8": 2}.get(self.stored, 0)
        reader = _READERS[len(self.grid.counts)]
        axes = self.grid.numbers()
        reader(x, axes, code, self.low, self.step, self.data, self.read == "cubic", out)

    @property
    def values(self) -> np.ndarray:
        """The numbers at the nodes as they are read, shape as the counts of the grid."""
        if self.stored == "float16":
            found = self.data.view(np.float16).astype(np.float64)
        elif self.stored in _SHARES:
            found = self.low + self.step * self.data.astype(np.float64)
        else:
            found = self.data.astype(np.float64)
        return found.reshape(self.grid.counts)


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
        _SUMS[len(self.grid.counts)](x, self.grid.numbers(2.0), self.data, out)


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
