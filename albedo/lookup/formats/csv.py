"""CSV: the label in a first line that begins with #, then a row for every point of the grid."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np

from albedo.errors import InputError
from albedo.lookup.formats import Format
from albedo.lookup.label import LookupTable, digest_of
from albedo.lookup.plain import expected, from_plain, to_plain

_MARK = "# label: "


def save(table: LookupTable, path: Path) -> None:
    """Write coordinates and numbers; shares of 16 or 8 bits are written as whole numbers."""
    import pandas as pd

    text, arrays = to_plain(table)
    columns = dict(zip(table.grid.names, table.grid.points(), strict=True))
    for name, data in arrays.items():
        columns[name] = [_shortest(x) for x in data.ravel()]
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(f"{_MARK}{text}\n")
        pd.DataFrame(columns).to_csv(file, index=False, lineterminator="\n")


def _shortest(x: Any) -> str:
    if x.dtype.kind == "f":
        return np.format_float_positional(x, unique=True, trim="0")
    return str(int(x))


def load(path: Path) -> LookupTable:
    """Read such rows; coordinates must be those of the label."""
    import pandas as pd

    try:
        content = path.read_text(encoding="utf-8")
    except ValueError as error:
        raise InputError(f"it is no text: {error}") from None
    first, _, rest = content.partition("\n")
    if not first.startswith(_MARK):
        raise InputError(f"its first line does not begin with {_MARK!r}")
    text = first[len(_MARK) :]
    wanted = expected(text)
    names, dtype = wanted.names, wanted.dtype
    try:
        frame = pd.read_csv(io.StringIO(rest), dtype=str, na_filter=False)
    except (ValueError, pd.errors.ParserError) as error:
        raise InputError(f"its rows are no CSV: {error}") from None
    if len(frame) != wanted.size or tuple(frame.columns[-len(names) :]) != names:
        raise InputError(f"it does not have {wanted.size} rows with the columns {', '.join(names)}")
    try:
        arrays = {}
        for name in names:
            column = frame[name].to_numpy(dtype=object)
            if dtype.kind == "u":
                whole = np.array([int(x) for x in column], dtype=np.int64)
                found = whole.astype(dtype)
                if not np.array_equal(found, whole):
                    raise ValueError("a share is out of range")
            else:
                # Through the precision itself: a detour over float64 would round twice.
                found = np.array([dtype.type(x) for x in column], dtype=dtype)
            arrays[name] = found.reshape(wanted.counts)
        coordinates = np.array(
            [[float(x) for x in frame[name]] for name in frame.columns[: -len(names)]]
        )
    except (ValueError, OverflowError) as error:
        raise InputError(f"its rows have what is no number: {error}") from None
    table = from_plain(text, arrays)
    same = digest_of(coordinates) == table.about["coordinates"]
    if not same or tuple(frame.columns[: -len(names)]) != table.grid.names:
        raise InputError("its coordinates are not those that were written")
    return table


FORMAT = Format("csv", ".csv", "rows of coordinates and numbers", save, load)
