"""JSON: the label, and nested lists of numbers in the shortest form that reads back exactly."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from albedo.errors import InputError
from albedo.lookup.formats import Format
from albedo.lookup.label import LookupTable
from albedo.lookup.plain import expected, from_plain, to_plain


def numbers(data: np.ndarray) -> Any:
    """Nested lists of numbers, each the shortest that reads back as it is in its own precision."""
    if data.dtype.kind == "f":
        flat = [float(np.format_float_scientific(x, unique=True)) for x in data.ravel()]
        return np.array(flat).reshape(data.shape).tolist()
    return data.tolist()


def save(table: LookupTable, path: Path) -> None:
    """Write an object with ``label`` and ``data``."""
    text, arrays = to_plain(table)
    content = {
        "label": json.loads(text),
        "data": {name: numbers(data) for name, data in arrays.items()},
    }
    path.write_text(json.dumps(content, allow_nan=False) + "\n", encoding="utf-8")


def load(path: Path) -> LookupTable:
    """Read such an object."""
    try:
        content = json.loads(path.read_bytes(), parse_constant=_no_constant)
        label, data = content["label"], content["data"]
        text = json.dumps(label)
    except (ValueError, RecursionError, KeyError, TypeError) as error:
        raise InputError(f"it is no JSON of a table: {error}") from None
    wanted = expected(text)
    arrays = {}
    for name in wanted.names:
        try:
            found = np.array(data[name])
            # What is too large for its precision becomes infinite, and is refused.
            with np.errstate(over="ignore"):
                exact = found.astype(wanted.dtype)
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise InputError(f"it has no numbers of the channel {name!r}: {error}") from None
        if wanted.dtype.kind == "u" and (
            found.dtype.kind != "i" or not np.array_equal(found, exact)
        ):
            raise InputError(f"the channel {name!r} has numbers that are no shares")
        arrays[name] = exact
    return from_plain(text, arrays)


def _no_constant(word: str) -> float:
    raise ValueError(f"{word} is no number")


FORMAT = Format("json", ".json", "JSON", save, load)
