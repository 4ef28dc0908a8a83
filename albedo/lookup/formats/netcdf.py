"""netCDF: named axes with their coordinates, shares packed as its conventions want them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from albedo.errors import InputError
from albedo.lookup.formats import Format
from albedo.lookup.label import LookupTable
from albedo.lookup.plain import Expected, expected, from_plain, to_plain


def save(table: LookupTable, path: Path) -> None:
    """Write a variable for each channel, with its axes as coordinates.

    float16, which netCDF does not have, is widened to float32. Shares have ``scale_factor`` and
    ``add_offset``, so that what reads netCDF sees values.
    """
    import h5netcdf

    text, arrays = to_plain(table)
    grid = table.grid
    with h5netcdf.File(path, "w") as file:
        file.attrs["label"] = text
        for key in ("title", "model", "equation", "source", "meaning"):
            file.attrs[key] = table.about[key]
        file.attrs["references"] = " ".join(table.about["references"])
        file.dimensions = dict(zip(grid.names, grid.counts, strict=True))
        coupled = [":" in w and "*" in w for w in grid.warps]
        points = grid.points().reshape(-1, *grid.counts)
        for name, nodes, own, depends in zip(
            grid.names, grid.nodes(), points, coupled, strict=True
        ):
            # Where nodes depend on another coordinate, they are told for every point.
            if depends:
                file.create_variable(f"{name}_at", grid.names, data=own)
            else:
                file.create_variable(name, (name,), data=nodes)
        for channel, data in zip(table.channels, arrays.values(), strict=True):
            wide = data.astype(np.float32) if data.dtype == np.float16 else data
            variable = file.create_variable(channel.name, grid.names, data=wide)
            variable.attrs["units"] = "1"
            variable.attrs["error"] = channel.errors.largest
            if data.dtype.kind == "u":
                variable.attrs["scale_factor"] = channel.table.step
                variable.attrs["add_offset"] = channel.table.low


def load(path: Path) -> LookupTable:
    """Read such variables; no more is read than the label tells."""
    import h5py

    try:
        with h5py.File(path, "r") as file:
            text = _text(file.attrs["label"])
            wanted = expected(text)
            arrays = {name: _array(file, name, wanted) for name in wanted.names}
    except InputError:
        raise
    except (OSError, KeyError, ValueError, TypeError, RuntimeError, OverflowError) as error:
        raise InputError(f"it is no netCDF of a table: {error}") from None
    return from_plain(text, arrays)


def _text(value: Any) -> str:
    if isinstance(value, bytes):
        return value.decode("utf-8")
    if not isinstance(value, str):
        raise InputError("its label is no text")
    return value


def _array(file: Any, name: str, wanted: Expected) -> np.ndarray:
    own, dtype = file[name], wanted.dtype
    kept = np.dtype("f4") if dtype == np.float16 else dtype
    if getattr(own, "shape", None) != wanted.counts or own.dtype != kept or own.external:
        raise InputError(f"its variable {name!r} is not what its label tells")
    data = own[()]
    exact = data.astype(dtype)
    if not np.array_equal(exact, data):
        raise InputError(f"its variable {name!r} has numbers that are no {dtype}")
    return exact


FORMAT = Format("netcdf", ".nc", "netCDF", save, load)
