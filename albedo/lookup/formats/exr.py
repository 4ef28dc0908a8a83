"""OpenEXR: a pixel for every point, rows for the first axis; needs the package OpenEXR."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from albedo.errors import InputError
from albedo.lookup.formats import Format
from albedo.lookup.label import LookupTable
from albedo.lookup.plain import expected, from_plain, to_plain

# One number is a luminance, two are red and green.
_CHANNELS = {1: ("Y",), 2: ("R", "G")}


def library() -> Any:
    """The bindings.

    Raises
    ------
    InputError
        Where they are not installed.
    """
    try:
        import OpenEXR
    except ImportError:
        raise InputError(
            "OpenEXR files need the package OpenEXR: pip install 'albedo-workbench[exr]'"
        ) from None
    return OpenEXR


def picture(data: np.ndarray) -> np.ndarray:
    """An array as rows of pixels: of three axes the first two run down."""
    return np.ascontiguousarray(data.reshape(math.prod(data.shape[:-1]), data.shape[-1]))


def save(table: LookupTable, path: Path) -> None:
    """Write the numbers without loss, and the label in the header."""
    exr = library()
    text, arrays = to_plain(table)
    header = {"compression": exr.ZIP_COMPRESSION, "type": exr.scanlineimage, "label": text}
    names = _CHANNELS[len(arrays)]
    channels = {name: picture(data) for name, data in zip(names, arrays.values(), strict=True)}
    with exr.File(header, channels) as file:
        file.write(str(path))


def load(path: Path) -> LookupTable:
    """Read such a picture; its size is compared with the label before its pixels are read."""
    exr = library()
    try:
        with exr.File(str(path), header_only=True) as file:
            # The bindings empty it when the file is closed.
            header = dict(file.header())
        text = header.get("label")
        if not isinstance(text, str):
            raise InputError("its header has no label")
        wanted = expected(text)
        corner, far = (np.asarray(c).tolist() for c in header["dataWindow"])
        size = (math.prod(wanted.counts[:-1]), wanted.counts[-1])
        if corner != [0, 0] or far != [size[1] - 1, size[0] - 1]:
            raise InputError("its picture is not as large as its label tells")
        with exr.File(str(path), separate_channels=True) as file:
            found = {name: own.pixels for name, own in file.channels().items()}
    except InputError:
        raise
    except (RuntimeError, OSError, ValueError, TypeError, KeyError) as error:
        raise InputError(f"it is no OpenEXR picture of a table: {error}") from None
    planes = _CHANNELS[len(wanted.names)]
    if set(found) != set(planes) or any(found[own].shape != size for own in planes):
        raise InputError(f"its picture does not have the channels {', '.join(planes)}")
    arrays = {
        name: found[own].reshape(wanted.counts)
        for name, own in zip(wanted.names, planes, strict=True)
    }
    return from_plain(text, arrays)


FORMAT = Format("exr", ".exr", "OpenEXR", save, load, ("float32", "float16"))
