"""netCDF: named axes with their coordinates, shares packed as its conventions want them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from albedo.errors import InputError
from albedo.lookup.formats import Format
from albedo.lookup.label import Channel, LookupTable, digest_of
from albedo.lookup.plain import Expected, expected, from_plain, to_plain
from albedo.lookup.warps import Warp

_TOLD = ("title", "model", "equation", "source", "meaning")


def save(table: LookupTable, path: Path) -> None:
    """Write a variable for each channel, with its axes as coordinates.

    float16, which netCDF does not have, is widened to float32. Shares have ``scale_factor`` and
    ``add_offset``, so that what reads netCDF sees values. Where nodes of an axis depend on another
    coordinate they are told for every point, as ``NAME_at``.
    """
    import h5netcdf

    text, arrays = to_plain(table)
    grid = table.grid
    points = grid.points().reshape(-1, *grid.counts)
    with h5netcdf.File(path, "w") as file:
        file.attrs["label"] = text
        for key, value in _words(table).items():
            file.attrs[key] = value
        file.dimensions = dict(zip(grid.names, grid.counts, strict=True))
        for name, warp, nodes, own in zip(
            grid.names, grid.warps, grid.nodes(), points, strict=True
        ):
            if Warp.parse(warp).by:
                file.create_variable(f"{name}_at", grid.names, data=own)
            else:
                file.create_variable(name, (name,), data=nodes)
        for channel, data in zip(table.channels, arrays.values(), strict=True):
            wide = data.astype(np.float32) if data.dtype == np.float16 else data
            variable = file.create_variable(channel.name, grid.names, data=wide)
            for key, told in _attributes(channel).items():
                variable.attrs[key] = told


def _words(table: LookupTable) -> dict[str, str]:
    """What of the label is told to those who do not read it."""
    found = {key: str(table.about[key]) for key in _TOLD}
    return {**found, "references": " ".join(table.about["references"])}


def _attributes(channel: Channel) -> dict[str, Any]:
    """What a variable says of itself."""
    found: dict[str, Any] = {"units": "1", "error": channel.errors.largest}
    if channel.table.data.dtype.kind == "u" and channel.table.stored != "float16":
        found |= {"scale_factor": channel.table.step, "add_offset": channel.table.low}
    return found


def load(path: Path) -> LookupTable:
    """Read such a file; no more is read than the label tells, and all of it is compared."""
    import h5py

    try:
        with h5py.File(path, "r") as file:
            text = _text(file.attrs["label"])
            wanted = expected(text)
            arrays = {name: _array(file, name, wanted) for name in wanted.names}
            table = from_plain(text, arrays)
            _compare(file, table)
    except InputError:
        raise
    except (OSError, KeyError, ValueError, TypeError, RuntimeError, OverflowError) as error:
        raise InputError(f"it is no netCDF of a table: {error}") from None
    return table


def _compare(file: Any, table: LookupTable) -> None:
    """Refuse coordinates and words that are not those of the label."""
    grid = table.grid
    points = np.empty((len(grid.names), *grid.counts))
    for axis, (name, warp) in enumerate(zip(grid.names, grid.warps, strict=True)):
        if Warp.parse(warp).by:
            points[axis] = _numbers(file, f"{name}_at", grid.counts)
        else:
            nodes = _numbers(file, name, (grid.counts[axis],))
            shape = [1] * len(grid.names)
            shape[axis] = grid.counts[axis]
            points[axis] = nodes.reshape(shape)
    if digest_of(points.reshape(len(grid.names), -1)) != table.about["coordinates"]:
        raise InputError("its coordinates are not those that were written")
    for key, value in _words(table).items():
        if _text(file.attrs[key]) != value:
            raise InputError(f"its attribute {key!r} is not what its label tells")
    for channel in table.channels:
        for key, told in _attributes(channel).items():
            found = file[channel.name].attrs[key]
            if (_text(found) if isinstance(told, str) else np.asarray(found).item()) != told:
                raise InputError(f"the attribute {key!r} of {channel.name!r} is another")


def _numbers(file: Any, name: str, shape: tuple[int, ...]) -> np.ndarray:
    own = file[name]
    if getattr(own, "shape", None) != shape or own.dtype != np.float64 or own.external:
        raise InputError(f"its variable {name!r} is not what its label tells")
    return own[()]


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
