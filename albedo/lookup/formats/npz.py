"""NumPy's archive: an array for each channel, and the label as text."""

from __future__ import annotations

import tokenize
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from albedo.errors import InputError
from albedo.lookup.formats import Format
from albedo.lookup.label import LookupTable
from albedo.lookup.plain import MOST_TEXT, expected, from_plain, to_plain

_LABEL = "label"
# A header of an array takes less.
_HEADER = 4096


def save(table: LookupTable, path: Path) -> None:
    """Write an archive."""
    text, arrays = to_plain(table)
    everything: dict[str, Any] = {_LABEL: np.array(text), **arrays}
    with path.open("wb") as file:
        np.savez_compressed(file, **everything)


def load(path: Path) -> LookupTable:
    """Read an archive; nothing in it is run, and no more is unpacked than its label tells."""
    try:
        with zipfile.ZipFile(path) as archive:
            # A character takes four bytes.
            text = str(_array(archive, _LABEL, 4 * MOST_TEXT)[()])
            wanted = expected(text)
            size = wanted.size * wanted.dtype.itemsize
            return from_plain(text, {name: _array(archive, name, size) for name in wanted.names})
    except InputError:
        raise
    except (zipfile.BadZipFile, zlib.error, ValueError, OSError, EOFError) as error:
        raise InputError(f"it is no archive of arrays: {error}") from None
    except (KeyError, NotImplementedError, RuntimeError, SyntaxError, tokenize.TokenError) as error:
        raise InputError(f"it is not an archive of a table: {error}") from None


def _array(archive: zipfile.ZipFile, name: str, most: int) -> np.ndarray:
    info = archive.getinfo(f"{name}.npy")
    if info.file_size > most + _HEADER:
        raise InputError(f"its array {name!r} has {info.file_size} bytes, more than {most}")
    with archive.open(info) as file:
        return np.lib.format.read_array(file, allow_pickle=False)


FORMAT = Format("npz", ".npz", "NumPy's archive of arrays", save, load)
