"""Lookup tables that are made in no time, for tests of what holds and reads them."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from albedo.lookup.label import Channel, Errors, LookupTable, digest_of
from albedo.lookup.quantities import QUANTITIES
from albedo.lookup.stored import Grid, Table

AXES = {
    1: [(("cos_theta",), ((0.01, 1.0),))],
    2: [(("m", "cos_theta"), ((0.05, 1.0), (0.0, 1.0)))],
    3: [(("m", "phi", "cos_theta"), ((0.05, 1.0), (0.0, 1.5), (0.01, 1.0)))],
}
WARPS = {
    1: [("linear",), ("angle",), ("rational:0.3",)],
    2: [("sqrt", "linear"), ("log", "rational:0.25"), ("linear", "rational:0.5*m")],
    3: [("log", "linear", "angle"), ("sqrt", "linear", "rational:0.5*m")],
}


def lookup_table(
    axes: int = 2,
    *,
    warps: tuple[str, ...] | None = None,
    stored: str = "float32",
    read: str = "linear",
    texels: str = "ends",
    quantity: str = "albedo",
    seed: int = 0,
) -> LookupTable:
    """A table of a smooth function that no model has."""
    names, ends = AXES[axes][0]
    counts = tuple((7, 6, 5)[:axes])
    grid = Grid(names, ends, warps or WARPS[axes][0], counts, texels)
    rng = np.random.default_rng(seed)
    channels = []
    for name in QUANTITIES[quantity].channels:
        values = 0.2 + 0.7 * rng.uniform(size=counts)
        errors = Errors(
            *(
                2e-3,
                5e-4,
                1e-2,
                1e-7,
                dict(zip(names, (0.5, 0.7, 0.9), strict=False)),
                1.9e-3,
                1024,
            ),
            np.full((4,) * axes, 2e-3).tolist(),
        )
        channels.append(Channel(name, Table.of(grid, values, stored, read), errors))
    about: dict[str, Any] = {
        "title": f"{quantity} of nothing",
        "quantity": quantity,
        "meaning": QUANTITIES[quantity].meaning,
        "model": "nothing:m=0.5",
        "name": "nothing",
        "parameters": {"distribution": "ggx", "f0": 0.04},
        "equation": "none",
        "references": ["schwenk2011"],
        "fixed": "light",
        "metric": "max",
        "asked": None,
        "coordinates": digest_of(grid.points()),
        "source": "tests",
    }
    return LookupTable(tuple(channels), about)


def all_kinds() -> list[dict[str, Any]]:
    """Axes, warps, numbers, readings and texels, each with each that it has to do with."""
    found: list[dict[str, Any]] = []
    for axes in (1, 2, 3):
        for warps, read, texels in itertools.product(
            WARPS[axes], ("linear", "cubic"), ("ends", "centres")
        ):
            found.append({"axes": axes, "warps": warps, "read": read, "texels": texels})
    found += [
        {"stored": stored} for stored in ("float64", "float32", "float16", "unorm16", "unorm8")
    ]
    return [*found, {"quantity": "split_sum"}, {"quantity": "average", "axes": 1}]
