"""netCDF: named axes with their coordinates, shares packed as its conventions want them.

The classic format, which every reader knows: a list of what there is, then the numbers. Files of
HDF5, which netCDF 4 is, can be damaged so that its library never returns.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from albedo.errors import InputError
from albedo.lookup.formats import Format
from albedo.lookup.label import Channel, LookupTable, digest_of
from albedo.lookup.plain import Expected, expected, from_plain, to_plain
from albedo.lookup.warps import Warp

# What numbers are kept as: the classic format has none of 16 bits but signed ones.
_KEPT = {"f8": "f8", "f4": "f4", "f2": "f4", "u2": "i2", "u1": "i1"}
_TOLD = ("title", "model", "equation", "source", "meaning")


def save(table: LookupTable, path: Path) -> None:
    """Write a variable for each channel, with its axes as coordinates.

    float16, which netCDF does not have, is widened to float32. Shares are signed words with
    ``_Unsigned``, ``scale_factor`` and ``add_offset``, so that what reads netCDF sees values.
    Where nodes of an axis depend on another coordinate they are told for every point, as
    ``NAME_at``.
    """
    from scipy.io import netcdf_file

    text, arrays = to_plain(table)
    grid = table.grid
    points = grid.points().reshape(-1, *grid.counts)
    with netcdf_file(path, "w", version=2) as file:
        file.label = text
        for key, value in _words(table).items():
            setattr(file, key, value)
        for name, count in zip(grid.names, grid.counts, strict=True):
            file.createDimension(name, count)
        for name, warp, nodes, own in zip(
            grid.names, grid.warps, grid.nodes(), points, strict=True
        ):
            depends = bool(Warp.parse(warp).by)
            dimensions = grid.names if depends else (name,)
            variable = file.createVariable(f"{name}_at" if depends else name, "f8", dimensions)
            variable[:] = own if depends else nodes
        for channel, data in zip(table.channels, arrays.values(), strict=True):
            kept = data.astype(_KEPT[data.dtype.str[1:]], casting="unsafe")
            variable = file.createVariable(channel.name, kept.dtype, grid.names)
            variable[:] = kept
            for key, told in _attributes(channel).items():
                # A plain float would be kept in float32.
                setattr(variable, key, told if isinstance(told, str) else np.float64(told))


def _words(table: LookupTable) -> dict[str, str]:
    """What of the label is told to those who do not read it."""
    found = {key: str(table.about[key]) for key in _TOLD}
    return {**found, "references": " ".join(table.about["references"])}


def _attributes(channel: Channel) -> dict[str, Any]:
    """What a variable says of itself."""
    found: dict[str, Any] = {"units": "1", "error": channel.errors.largest}
    if channel.table.stored in ("unorm16", "unorm8"):
        shares = {"scale_factor": channel.table.step, "add_offset": channel.table.low}
        found |= {"_Unsigned": "true", **shares}
    return found


def load(path: Path) -> LookupTable:
    """Read such a file; all that it tells is compared."""
    from scipy.io import netcdf_file

    with path.open("rb") as start:
        if start.read(4) == b"\x89HDF":
            raise InputError(
                "it is a file of netCDF 4, such as `albedo table` writes; `albedo design` makes "
                "lookup tables"
            )
    try:
        # Copied: nothing points into a file that may change.
        with netcdf_file(path, "r", mmap=False, maskandscale=False) as file:
            text = _text(file, "label")
            wanted = expected(text)
            arrays = {name: _array(file, name, wanted) for name in wanted.names}
            table = from_plain(text, arrays)
            _compare(file, table)
    except InputError:
        raise
    except (OSError, KeyError, ValueError, TypeError, AttributeError, IndexError) as error:
        raise InputError(f"it is no netCDF of a table: {error}") from None
    except (AssertionError, OverflowError, MemoryError) as error:
        raise InputError(f"it is no netCDF of a table: {error!r}") from None
    return table


def _text(holder: Any, key: str) -> str:
    value = getattr(holder, key)
    if not isinstance(value, bytes):
        raise InputError(f"its attribute {key!r} is no text")
    return value.decode("utf-8")


def _numbers(file: Any, name: str, shape: tuple[int, ...], dtype: Any) -> np.ndarray:
    data = file.variables[name].data
    if data.shape != shape or data.dtype != np.dtype(dtype).newbyteorder(">"):
        raise InputError(f"its variable {name!r} is not what its label tells")
    return data.astype(dtype)


def _array(file: Any, name: str, wanted: Expected) -> np.ndarray:
    kept = _KEPT[wanted.dtype.str[1:]]
    data = _numbers(file, name, wanted.counts, kept)
    if wanted.dtype.kind == "u":
        return data.view(wanted.dtype)
    with np.errstate(over="ignore"):
        exact = data.astype(wanted.dtype)
    if not np.array_equal(exact, data):
        raise InputError(f"its variable {name!r} has numbers that are no {wanted.dtype}")
    return exact


def _compare(file: Any, table: LookupTable) -> None:
    """Refuse dimensions, coordinates and words that are not those of the label."""
    grid = table.grid
    if dict(file.dimensions) != dict(zip(grid.names, grid.counts, strict=True)):
        raise InputError("its dimensions are not those that its label tells")
    points = np.empty((len(grid.names), *grid.counts))
    for axis, (name, warp) in enumerate(zip(grid.names, grid.warps, strict=True)):
        if Warp.parse(warp).by:
            points[axis] = _numbers(file, f"{name}_at", grid.counts, "f8")
        else:
            shape = [1] * len(grid.names)
            shape[axis] = grid.counts[axis]
            points[axis] = _numbers(file, name, (grid.counts[axis],), "f8").reshape(shape)
    if digest_of(points.reshape(len(grid.names), -1)) != table.about["coordinates"]:
        raise InputError("its coordinates are not those that were written")
    for key, value in _words(table).items():
        if _text(file, key) != value:
            raise InputError(f"its attribute {key!r} is not what its label tells")
    for channel in table.channels:
        own = file.variables[channel.name]
        if own.dimensions != grid.names:
            raise InputError(f"the axes of {channel.name!r} are not those that its label tells")
        for key, told in _attributes(channel).items():
            found = _text(own, key) if isinstance(told, str) else float(getattr(own, key))
            if found != told:
                raise InputError(f"the attribute {key!r} of {channel.name!r} is another")


FORMAT = Format("netcdf", ".nc", "netCDF", save, load)
