"""What lookup tables are written as, and read from: a file for each format, found here by its name.

A format is a module with a `FORMAT`. Nothing else knows of it: the command line, `save_lookup` and
`load_lookup` find it.
"""

from __future__ import annotations

import os
import pkgutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from albedo.errors import InputError
from albedo.files import check_output
from albedo.lookup.label import LookupTable
from albedo.lookup.plain import MOST_BYTES
from albedo.lookup.stored import STORED

# Characters of a reason.
_SAID = 400


@dataclass(frozen=True)
class Format:
    """A file format.

    Attributes
    ----------
    name : str
        On the command line.
    suffix : str
        Of its files.
    title : str
        In a few words.
    save : callable
        ``save(table, path)`` writes a whole file, at a path that nobody sees yet.
    load : callable or None
        ``load(path)`` gives the table back, where files are data; None for code.
    stored : tuple of str
        Numbers that it can hold.
    axes : int
        Most axes that it can hold.
    """

    name: str
    suffix: str
    title: str
    save: Callable[[LookupTable, Path], None]
    load: Callable[[Path], LookupTable] | None = None
    stored: tuple[str, ...] = STORED
    axes: int = 3


@cache
def formats() -> Mapping[str, Format]:
    """All formats by name."""
    found = {}
    for module in sorted(pkgutil.iter_modules(__path__), key=lambda m: m.name):
        if not module.name.startswith("_"):
            own: Any = import_module(f"{__name__}.{module.name}").FORMAT
            found[own.name] = own
    return found


def format_of(path: str | os.PathLike[str], name: str | None = None) -> Format:
    """The format of a name, or of a file's ending.

    Raises
    ------
    InputError
        Where there is none, or several.
    """
    known = formats()
    if name is not None:
        if name not in known:
            raise InputError(f"the format {name!r} is unknown; choose one of {', '.join(known)}")
        return known[name]
    suffix = Path(path).suffix.lower()
    found = [own for own in known.values() if own.suffix == suffix]
    if len(found) == 1:
        return found[0]
    if found:
        names = ", ".join(own.name for own in found)
        raise InputError(f"'{path}' may be any of {names}; say which")
    endings = ", ".join(sorted({own.suffix for own in known.values()}))
    raise InputError(f"the file '{path}' must end in one of {endings}, which say what it is")


def save_lookup(table: LookupTable, path: str | os.PathLike[str], to: str | None = None) -> Path:
    """Write a lookup table, with all that its label says.

    Parameters
    ----------
    table : LookupTable
    path : path
        Its ending says the format where `to` does not. A file that is there is replaced at the
        last moment.
    to : str, optional
        The format, by name; see `formats`.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        For an unknown format, one that cannot hold such numbers or so many axes, or a path that
        cannot be written to.
    """
    from albedo.files import atomic_file

    own = format_of(path, to)
    target = check_output(path, (own.suffix,))
    stored, axes = table.channels[0].table.stored, len(table.grid.names)
    if stored not in own.stored:
        raise InputError(
            f"{own.name} holds no {stored}; design the table with dtype {' or '.join(own.stored)}"
        )
    if axes > own.axes:
        raise InputError(f"{own.name} holds up to {own.axes} axes; the table has {axes}")
    with atomic_file(target) as temporary:
        own.save(table, temporary)
    return target


def load_lookup(path: str | os.PathLike[str]) -> LookupTable:
    """Read a lookup table that `save_lookup` wrote.

    Parameters
    ----------
    path : path

    Returns
    -------
    LookupTable
        What was written: the digest of its label and numbers is compared.

    Raises
    ------
    InputError
        For a file that is none, is damaged, or is no data.
    """
    target = Path(path)
    own = format_of(target)
    if own.load is None:
        raise InputError(f"'{target}' is code; tables are read from {_readable()}")
    try:
        size = target.stat().st_size
    except OSError as error:
        raise InputError(f"'{target}' cannot be read: {error.strerror}") from None
    if not target.is_file():
        raise InputError(f"'{target}' is no file")
    if size > MOST_BYTES:
        raise InputError(f"'{target}' has {size} bytes; a table has at most {MOST_BYTES}")
    try:
        return own.load(target)
    except InputError as error:
        # What libraries say may have several lines.
        said = " ".join(str(error).split())[:_SAID]
        raise InputError(f"'{target}' is not read: {said}") from None


def _readable() -> str:
    return ", ".join(own.suffix for own in formats().values() if own.load is not None)
