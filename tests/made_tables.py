"""Lookup tables of all kinds, and what is read of them, for tests of exported code."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from lookups import lookup_table

from albedo.lookup.label import LookupTable
from albedo.lookup.stored import READ, STORED, TEXELS, Table

# What axes are even in, by their number; every kind is there for each of them.
WARPS = {
    1: (("linear",), ("sqrt",), ("angle",), ("log",), ("rational:0.3",)),
    2: (
        *(("log", "rational:0.5*m"), ("linear", "angle"), ("sqrt", "rational:0.2")),
        *(("rational:5", "linear"), ("angle", "sqrt")),
    ),
    3: (
        *(("log", "sqrt", "rational:0.5*m"), ("rational:2*cos_theta", "linear", "angle")),
        *(("sqrt", "linear", "linear"), ("angle", "rational:5", "rational:0.3*m")),
        ("linear", "sqrt", "log"),
    ),
}


def make(name: str, warps: tuple[str, ...], *, channels: int = 1, **how: Any) -> LookupTable:
    """A table under a name of its own."""
    quantity = "split_sum" if channels == 2 else "albedo"
    found = lookup_table(len(warps), warps=warps, quantity=quantity, **how)
    return replace(found, about={**found.about, "name": name})


def all_kinds(stored: Sequence[str] = STORED) -> list[LookupTable]:
    """Tables of all numbers of axes, ways to read, places of nodes and ways to store.

    Warps and channels take turns, so that each is met with each of these. The last has cosines
    below zero, and angles up to pi.
    """
    found = []
    for i, (axes, read, texels) in enumerate(itertools.product((1, 2, 3), READ, TEXELS)):
        for j, kind in enumerate(stored):
            warps = WARPS[axes][(i + j) % len(WARPS[axes])]
            how = {"stored": kind, "read": read, "texels": texels, "channels": 1 + (i + j) % 2}
            found.append(make(f"made_{len(found)}", warps, seed=len(found), **how))
    last = make(f"made_{len(found)}", ("angle",))
    own = last.channels[0]
    table = replace(own.table, grid=replace(own.table.grid, ends=((-1.0, 1.0),)))
    return [*found, replace(last, channels=(replace(own, table=table),))]


def places(table: LookupTable, rng: np.random.Generator, count: int = 2000) -> np.ndarray:
    """Coordinates: nodes and ends, then at random, even in the axes and in themselves."""
    grid = table.grid
    ends = np.array(grid.ends)
    nodes = grid.points()[:, : count // 4]
    corners = np.array(list(itertools.product(*grid.ends))).T
    rest = count - nodes.shape[1] - corners.shape[1]
    shares = grid.at(rng.uniform(size=(len(ends), rest // 2)))
    even = rng.uniform(ends[:, :1], ends[:, 1:], (len(ends), rest - rest // 2))
    return np.concatenate((nodes, corners, shares, even), axis=1)


def readings(table: LookupTable, x: np.ndarray) -> np.ndarray:
    """What the library reads, shape (channels, places); beyond an end, what is there."""
    ends = np.array(table.grid.ends)
    inside = np.clip(x, ends[:, :1], ends[:, 1:])
    return np.array([channel.table(inside) for channel in table.channels])


def rounding(table: LookupTable, eps: float = float(np.finfo(np.float64).eps)) -> float:
    """What two correct programs may differ by whose numbers have a precision.

    An arc cosine or a logarithm that is rounded in another way moves a place by a unit in its last
    digit or two, and a fused multiplication by another: four units of a warped coordinate, in
    steps from node to node, times the steepest way from one to the next, which a cubic overshoots
    by less than three times. Sums of some ten numbers add their own, four units of the largest.
    """
    grid = table.grid
    total = 0.0
    for channel in table.channels:
        found = 4.0 * eps * float(np.abs(channel.table.values).max())
        for (low, high), count, step in zip(
            grid.warped_ends, grid.counts, steepest(channel.table), strict=True
        ):
            moved = 4.0 * eps * max(abs(low), abs(high), 1.0) / (high - low) * count
            found += 3.0 * moved * step
        total = max(total, found)
    return total


def steepest(table: Table) -> list[float]:
    """The largest difference of neighbours along each axis."""
    values = table.values
    return [float(np.abs(np.diff(values, axis=axis)).max()) for axis in range(values.ndim)]
