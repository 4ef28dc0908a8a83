"""A lookup table as a label and arrays, which every file format holds in its own way.

What is read is data, and may be damaged or made to do harm: nothing is taken for granted. A label
is checked word by word, arrays against it, and both against their digest.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jsonschema import Draft202012Validator
from jsonschema.exceptions import best_match

from albedo.errors import InputError
from albedo.lookup.label import Channel, Errors, LookupTable
from albedo.lookup.quantities import QUANTITIES
from albedo.lookup.stored import Grid, Table
from albedo.lookup.warps import Warp

MOST_NUMBERS = 2**24
"""Numbers that a channel may have."""
MOST_BYTES = 2**28
"""Bytes that a file may have."""
MOST_TEXT = 2**20
"""Characters that a label may have."""

DTYPES: dict[str, np.dtype[Any]] = {
    "float64": np.dtype("f8"),
    "float32": np.dtype("f4"),
    "float16": np.dtype("f2"),
    "unorm16": np.dtype("u2"),
    "unorm8": np.dtype("u1"),
}
"""What the numbers of a table are in an array."""

_ABOUT = (
    *("title", "quantity", "meaning", "model", "name", "parameters", "equation", "references"),
    *("fixed", "metric", "asked", "coordinates", "source"),
)


def to_plain(table: LookupTable) -> tuple[str, dict[str, np.ndarray]]:
    """The label with its digest as JSON, and the numbers of each channel in their shape."""
    label = {**table.label, "sha256": table.sha256}
    arrays = {
        channel.name: channel.table.data.view(DTYPES[channel.table.stored]).reshape(
            table.grid.counts
        )
        for channel in table.channels
    }
    return json.dumps(label, ensure_ascii=True, allow_nan=False), arrays


@dataclass(frozen=True)
class Expected:
    """What a label says of its arrays, so that no reader makes room for what is not there.

    Attributes
    ----------
    counts : tuple of int
        The shape of each.
    dtype : dtype
        Its numbers.
    names : tuple of str
        Of the channels.
    """

    counts: tuple[int, ...]
    dtype: np.dtype[Any]
    names: tuple[str, ...]

    @property
    def size(self) -> int:
        """Numbers of each channel."""
        return math.prod(self.counts)


def expected(text: str) -> Expected:
    """What a label in JSON says of its arrays.

    Raises
    ------
    InputError
        For what is no label.
    """
    label = _parsed(text)
    names = tuple(str(channel["name"]) for channel in label["channels"])
    return Expected(_grid(label).counts, DTYPES[label["stored"]], names)


def from_plain(text: str, arrays: Mapping[str, np.ndarray]) -> LookupTable:
    """A table from its label and its arrays.

    Raises
    ------
    InputError
        Where they are not what was written: with a word, a shape or a number that is none, or
        another digest.
    """
    label, wanted = _parsed(text), expected(text)
    grid = _grid(label)
    channels = []
    for name, own in zip(wanted.names, label["channels"], strict=True):
        if name not in arrays:
            raise InputError(f"there are no numbers of the channel {name!r}")
        data = np.asarray(arrays[name])
        if data.shape != wanted.counts or data.dtype != wanted.dtype:
            raise InputError(
                f"the channel {name!r} has {data.dtype} numbers of shape {data.shape}; its label "
                f"says {wanted.dtype} and {wanted.counts}"
            )
        if not np.isfinite(data).all():
            raise InputError(f"the channel {name!r} has numbers that are not finite")
        flat = np.ascontiguousarray(data).ravel()
        bits = flat.view(np.uint16) if label["stored"] == "float16" else flat
        table = Table(grid, label["stored"], label["interpolation"], bits, own["low"], own["step"])
        channels.append(Channel(name, table, Errors(**own["errors"])))
    found = LookupTable(tuple(channels), {key: label[key] for key in _ABOUT})
    if found.label != {key: value for key, value in label.items() if key != "sha256"}:
        raise InputError("its label has words that are not told apart")
    if found.sha256 != label["sha256"]:
        raise InputError(
            "its numbers are not those that were written: the digest of what was read is "
            f"{found.sha256[:12]}..., and {label['sha256'][:12]}... was noted"
        )
    return found


def _parsed(text: str) -> dict[str, Any]:
    """A label whose words are all known, and of the kinds that they should be."""
    if len(text) > MOST_TEXT:
        raise InputError(f"its label has {len(text)} characters, more than {MOST_TEXT}")
    try:
        label = json.loads(text, parse_constant=_no_constant)
        wrong = best_match(_validator().iter_errors(label))
    except (ValueError, RecursionError) as error:
        raise InputError(f"its label is no JSON: {error}") from None
    if wrong is not None:
        where = "/".join(map(str, wrong.absolute_path)) or "it"
        raise InputError(f"its label is wrong at {where}: {wrong.message[:200]}")
    if tuple(c["name"] for c in label["channels"]) != QUANTITIES[label["quantity"]].channels:
        raise InputError("its label does not tell the channels of its quantity")
    for channel in label["channels"]:
        try:
            errors = np.array(channel["errors"]["map"], dtype=np.float64)
        except (TypeError, ValueError):
            errors = np.empty(0)
        if errors.ndim != len(label["axes"]) or not errors.size or not np.all(errors >= 0.0):
            raise InputError("its label has a map of errors of another shape")
    return label


def _no_constant(word: str) -> float:
    raise ValueError(f"{word} is no number")


@cache
def _validator() -> Draft202012Validator:
    text = Path(__file__).with_name("schema.json").read_text(encoding="utf-8")
    return Draft202012Validator(json.loads(text))


def _grid(label: Mapping[str, Any]) -> Grid:
    """The axes of a label, if they are such as tables have."""
    axes = label["axes"]
    names = tuple(axis["name"] for axis in axes)
    ends = tuple((axis["low"], axis["high"]) for axis in axes)
    counts = tuple(axis["count"] for axis in axes)
    if len(set(names)) < len(names) or math.prod(counts) > MOST_NUMBERS:
        raise InputError(f"its label tells axes of the same name, or over {MOST_NUMBERS} numbers")
    if label["interpolation"] == "cubic" and min(counts) < 4:
        raise InputError("its label tells an axis of fewer points than are read")
    for axis in axes:
        name, low, high = axis["name"], axis["low"], axis["high"]
        own = Warp.parse(axis["even_in"])
        if own.by and (own.by == name or own.by not in names):
            raise InputError(f"its label has a warp of {name} that names no other axis")
        by = ends[names.index(own.by)][0] if own.by else 1.0
        allowed = {
            "linear": True,
            "sqrt": low >= 0.0,
            "log": low > 0.0,
            "angle": low >= -1.0 and high <= 1.0,
            "rational": low >= 0.0 and by > 0.0,
        }
        if not low < high or not allowed[own.kind]:
            raise InputError(f"its label has {name} from {low:g} to {high:g}, even in {own}")
    return Grid(names, ends, tuple(axis["even_in"] for axis in axes), counts, label["texels"])
