"""Lookup tables of random numbers, which no model has to be integrated for."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from albedo.lookup.label import Channel, Errors, LookupTable, digest_of
from albedo.lookup.stored import READ, STORED, TEXELS, Grid, Table

# What axes are even in, by their number; every kind is there for each of them.
WARPS = {
    1: (("linear",), ("sqrt",), ("angle",), ("log",), ("rational:0.3",)),
    2: (
        *(("log", "rational:0.5*m"), ("linear", "angle"), ("sqrt", "rational:0.2")),
        *(("rational:2*cos_theta", "linear"), ("angle", "log")),
    ),
    3: (
        *(("log", "sqrt", "rational:0.5*m"), ("linear", "rational:0.1*n_u", "angle")),
        *(("sqrt", "log", "linear"), ("rational:5", "angle", "rational:0.3*n_u")),
        ("log", "linear", "rational:0.199"),
    ),
}
NAMES = {1: ("cos_theta",), 2: ("m", "cos_theta"), 3: ("n_u", "m", "cos_theta")}
ENDS = {"n_u": (2.0, 50.0), "m": (0.05, 1.0), "cos_theta": (0.01, 1.0)}
COUNTS = {1: (9,), 2: (7, 9), 3: (5, 6, 7)}


def make(
    name: str,
    warps: Sequence[str],
    rng: np.random.Generator,
    *,
    stored: str = "float32",
    read: str = "linear",
    texels: str = "ends",
    channels: int = 1,
    about: Mapping[str, Any] | None = None,
    names: Sequence[str] | None = None,
) -> LookupTable:
    """A table, with errors that nobody measured."""
    count = len(warps)
    ends = tuple(ENDS[own] for own in NAMES[count])
    grid = Grid(tuple(names or NAMES[count]), ends, tuple(warps), COUNTS[count], texels)
    errors = Errors(
        *(1e-3, 1e-4, 1e-2, 1e-6, dict.fromkeys(grid.names, 0.3), 9e-4, 1024),
        map=np.full((2,) * count, 1e-3).tolist(),
    )
    tables = [
        Table.of(grid, rng.uniform(0.1, 0.9, grid.counts), stored, read) for _ in range(channels)
    ]
    words = ("f0", "f90") if channels == 2 else ("albedo",)
    whole = {
        "title": f"albedo of {name}",
        "quantity": "split_sum" if channels == 2 else "albedo",
        "meaning": "directional albedo a",
        "model": name,
        "name": name,
        "parameters": {},
        "equation": "none",
        "references": [],
        "fixed": "light",
        "metric": "max",
        "asked": None,
        "coordinates": digest_of(grid.points()),
        "source": "tests",
    }
    return LookupTable(
        tuple(Channel(*own, errors) for own in zip(words, tables, strict=True)),
        {**whole, **(about or {})},
    )


def all_kinds(rng: np.random.Generator, stored: Sequence[str] = STORED) -> list[LookupTable]:
    """Tables of all numbers of axes, ways to read, places of nodes and ways to store.

    Warps and channels take turns, so that each is met with each of these.
    """
    found = []
    for i, (axes, read, texels) in enumerate(itertools.product((1, 2, 3), READ, TEXELS)):
        for j, kind in enumerate(stored):
            warps = WARPS[axes][(i + j) % len(WARPS[axes])]
            name = f"made_{len(found)}"
            how = {"stored": kind, "read": read, "texels": texels, "channels": 1 + (i + j) % 2}
            found.append(make(name, warps, rng, **how))
    return found


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
    """What the library reads, shape (channels, places)."""
    return np.array([channel.table(x) for channel in table.channels])


def rounding(table: LookupTable) -> float:
    """What two correct programs in double precision may differ by.

    An arc cosine or a logarithm that is rounded in another way moves a place by a unit in its last
    digit or two, and a fused multiplication by another: four units of a warped coordinate, in
    steps from node to node, times the steepest way from one to the next, which a cubic overshoots
    by less than three times. Sums of some ten numbers add their own, four units of the largest.
    """
    grid = table.grid
    eps = np.finfo(float).eps
    total = 0.0
    for channel in table.channels:
        values = channel.table.values
        found = 4.0 * eps * float(np.abs(values).max())
        for axis, (low, high) in enumerate(grid.warped_ends):
            moved = 4.0 * eps * max(abs(low), abs(high), 1.0) / (high - low) * grid.counts[axis]
            found += 3.0 * moved * float(np.abs(np.diff(values, axis=axis)).max())
        total = max(total, found)
    return total
