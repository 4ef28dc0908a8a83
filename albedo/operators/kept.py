"""Tables that took long are kept on disk, and the albedos of unfinished ones as they come.

They lie beside the compiled kernels, named by a digest of all that their numbers depend on: the
model to the last bit, what is asked for, the tables before, and the sources. Where it cannot be
told what a model is, nothing is kept. Files hold arrays, and begin with a digest of the rest.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import sys
import threading
import time
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import fields, is_dataclass
from functools import cached_property
from pathlib import Path
from types import BuiltinFunctionType, FunctionType, ModuleType
from typing import Any

import numpy as np

from albedo._compile import PACKAGE, cache_root, digest
from albedo.brdf import Model
from albedo.errors import CacheWarning
from albedo.estimate import Estimate
from albedo.files import atomic_file
from albedo.operators.maps import LogMap
from albedo.progress import Advance, long_work

# Seconds that a table takes if it is worth a file, and between two files of its albedos: what is
# made sooner is not missed, and a killed process loses no more.
_WORTH = 2.0
# Bytes of all files, for hundreds of tables; those that were not used for longest go first.
_ROOM = 2**28
_TABLE, _ROWS = ".table", ".rows"
_SEAL = hashlib.sha256().digest_size


class _UntoldError(Exception):
    """It cannot be told surely what a model is."""


class Shelf:
    """Where the albedos of one table go as they come, and the table when it is finished.

    Parameters
    ----------
    key : str, optional
        A digest of all that the numbers depend on. Without it nothing is kept.
    advance : callable, optional
        See `albedo.progress.watched`.
    """

    def __init__(self, key: str | None = None, advance: Advance | None = None) -> None:
        self._key, self._advance = key, advance
        self._lock = threading.Lock()
        self._begun = self._saved = time.monotonic()
        self._asked = self._done = 0
        self._closed = False
        self._known: dict[bytes, np.ndarray] = {}
        self._fresh: list[np.ndarray] = []

    def finished(self) -> LogMap | None:
        """The table as it was kept; where there is none, what is known of its albedos is read."""
        if self._key is None:
            return None
        arrays = self._read(_folder() / f"{self._key}{_TABLE}")
        if arrays is not None:
            # Numbers were written as arrays without axes.
            told: dict[str, Any] = {name: a if a.ndim else a.item() for name, a in arrays.items()}
            return LogMap(**told)
        for path in self._pieces():
            piece = self._read(path)
            if piece is not None:
                self._known.update((row[:2].tobytes(), row[2:]) for row in piece["rows"])
        return None

    def known(self, c: np.ndarray, phi: np.ndarray) -> np.ndarray:
        """Value, error and evaluations of albedos that are asked for (n, 3); NaN where unknown."""
        found = np.full((c.size, 3), np.nan)
        if self._known:
            for k, place in enumerate(np.column_stack((c, phi))):
                row = self._known.get(place.tobytes())
                if row is not None:
                    found[k] = row
        with self._lock:
            self._asked += c.size
            self._count(int(np.count_nonzero(~np.isnan(found[:, 0]))))
        return found

    def put(self, c: np.ndarray, phi: np.ndarray, found: Estimate) -> None:
        """Take albedos that were computed, from any thread."""
        with self._lock:
            self._count(c.size)
            if self._key is None:
                return
            row = c, phi, found.value, found.error, found.evaluations
            self._fresh.append(np.column_stack(row))
            # A thread that was being started when its pool was interrupted comes late.
            late = self._closed and self._worth
            if late or time.monotonic() - self._saved > _WORTH:
                self._save()

    def keep(self, table: LogMap) -> None:
        """Write the table, where it is worth it, in place of its albedos."""
        self._fresh.clear()
        if not self._worth:
            return
        pieces = self._pieces()
        arrays = {one.name: np.asarray(getattr(table, one.name)) for one in fields(table)}
        if self._write(_folder() / f"{self._key}{_TABLE}", arrays):
            for path in pieces:
                _remove(path)

    def close(self) -> None:
        """Write the albedos of a table that was not finished."""
        with self._lock:
            self._closed, self._advance = True, None
            if self._fresh and self._worth:
                self._save()

    @property
    def _worth(self) -> bool:
        """Whether it took long, this time or before."""
        long = bool(self._known) or time.monotonic() - self._begun > _WORTH
        return self._key is not None and long

    def _count(self, more: int) -> None:
        self._done += more
        if self._advance is not None:
            self._advance(self._done, self._asked)

    def _pieces(self) -> list[Path]:
        return sorted(_folder().glob(f"{self._key}.*{_ROWS}"))

    def _save(self) -> None:
        rows = np.concatenate(self._fresh)
        self._fresh.clear()
        self._saved = time.monotonic()
        name = hashlib.sha256(rows.tobytes()).hexdigest()[:16]
        self._write(_folder() / f"{self._key}.{name}{_ROWS}", {"rows": rows})

    def _sealed(self, content: bytes) -> bytes:
        """A digest of the content, and of whose it is."""
        return hashlib.sha256(f"{self._key}".encode() + content).digest()

    def _read(self, path: Path) -> dict[str, np.ndarray] | None:
        """The arrays of a file; None where it is not there, or is not what was written."""
        try:
            content = path.read_bytes()
        except FileNotFoundError:
            return None
        except OSError as error:
            _warn(f"The kept file '{path}' cannot be read ({error.strerror}); it is made again")
            return None
        if self._sealed(content[_SEAL:]) != content[:_SEAL]:
            _warn(f"The kept file '{path}' is damaged; it is removed and made again")
            _remove(path)
            return None
        with suppress(OSError):
            # The time tells when it was used last.
            os.utime(path)
        with np.load(io.BytesIO(content[_SEAL:]), allow_pickle=False) as file:
            return dict(file)

    def _write(self, path: Path, arrays: dict[str, np.ndarray]) -> bool:
        """Write a file as a whole; where that cannot be, say so, go on and keep nothing."""
        buffer = io.BytesIO()
        np.savez(buffer, **arrays)  # type: ignore[arg-type]
        content = buffer.getvalue()
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with atomic_file(path) as temporary:
                temporary.write_bytes(self._sealed(content) + content)
            _tidy(path.parent)
        except OSError as error:
            self._key = None
            _warn(f"The folder '{path.parent}' cannot keep tables: {error.strerror}")
            return False
        return True


@contextmanager
def shelf_of(what: str, model: Model, *asked: Any) -> Iterator[Shelf]:
    """The shelf of a table while it is made.

    Parameters
    ----------
    what : str
        What is made, for whoever watches.
    model : Model
        Whose albedos it holds.
    *asked
        All else that its numbers depend on: numbers, text and tables.
    """
    with long_work(what) as advance:
        shelf = Shelf(_key(model, asked), advance)
        try:
            yield shelf
        finally:
            shelf.close()


def _folder() -> Path:
    return cache_root() / "tables"


def _warn(sentence: str) -> None:
    warnings.warn(sentence, CacheWarning, stacklevel=2)


def _remove(path: Path) -> None:
    # Another process may have been faster, or may have it open.
    with suppress(OSError):
        path.unlink()


def _tidy(folder: Path) -> None:
    """Remove the files that were not used for longest, until the others have room."""
    known = []
    for path in folder.iterdir():
        with suppress(OSError):
            known.append((path.stat().st_mtime, path.stat().st_size, path))
    total = 0
    for _, size, path in sorted(known, reverse=True):
        total += size
        if total > _ROOM:
            _remove(path)


def _key(model: Model, asked: tuple[Any, ...]) -> str | None:
    """A digest of all that the numbers of a table depend on; None where that cannot be told."""
    try:
        said = [digest(PACKAGE), np.__version__, _said(model), _said(asked)]
    except (_UntoldError, OSError):
        return None
    return hashlib.sha256(json.dumps(said).encode()).hexdigest()[:32]


def _said(value: Any) -> Any:
    """Plain data that tell a value exactly, and its type."""
    kind = type(value).__name__
    if value is None or isinstance(value, bool | int | str):
        return [kind, value]
    if isinstance(value, float):
        return [kind, value.hex()]
    if isinstance(value, tuple | list):
        return [kind, [_said(item) for item in value]]
    if isinstance(value, Mapping):
        return ["mapping", [[_said(key), _said(item)] for key, item in value.items()]]
    if isinstance(value, np.ndarray) and value.dtype.kind in "biuf":
        content = hashlib.sha256(value.tobytes()).hexdigest()
        return [kind, value.dtype.str, value.shape, content]
    if is_dataclass(value) and _inside(_home(type(value))):
        return [kind, [_said(getattr(value, one.name)) for one in fields(value)]]
    if isinstance(value, Model):
        home = type(value)
        kept = {
            name: one
            for name, one in sorted(vars(value).items())
            if not isinstance(getattr(home, name, None), cached_property)
        }
        names = home.__module__, home.__qualname__
        # What the kernels read may come from elsewhere than the parameters.
        packed = np.array(value.pack(), dtype=np.float64)
        return [kind, names, _own(value), _said(kept), _said(packed)]
    raise _UntoldError


def _own(model: Model) -> list[Any]:
    """What makes a model that is not of this package alone: sources, and what they hold."""
    kinds = [kind for kind in type(model).__mro__[:-1] if not _inside(_home(kind))]
    if not kinds:
        return []
    homes = {_home(kind) for kind in kinds}
    # A script is told from others only by its file.
    told: list[Any] = [sorted(home.name for home in homes)]
    for part in model.parts():
        told.append(_held(part.fill, homes))
        plain = "name", "widths", "chart", "columns", "scale", "doubt", "heights"
        told.append([_said(getattr(part, name)) for name in plain])
    # A file that was edited since is not what runs.
    made = min(vars(kind).get("made", 0.0) for kind in kinds)
    folders = sorted({home.parent for home in homes})
    for folder in folders:
        if any(source.stat().st_mtime > made for source in folder.rglob("*.py")):
            raise _UntoldError
    return [*told, [digest.__wrapped__(folder) for folder in folders]]


def _held(function: Any, homes: set[Path], seen: tuple[Any, ...] = ()) -> list[Any]:
    """The globals that a function reads, and those that it calls; their files join `homes`."""
    function = getattr(function, "py_func", function)
    code = getattr(function, "__code__", None)
    # Nothing tells what an object holds, or a function that was made inside of another.
    if code is None or code.co_freevars:
        raise _UntoldError
    home = Path(code.co_filename).resolve()
    if _inside(home) or function in seen:
        return []
    homes.add(home)
    told = []
    for name in code.co_names:
        value = function.__globals__.get(name)
        if hasattr(value, "py_func") or isinstance(value, FunctionType):
            told.append([name, _held(value, homes, (*seen, function))])
        elif not isinstance(value, ModuleType | BuiltinFunctionType | type):
            told.append([name, _said(value)])
    return told


def _inside(path: Path) -> bool:
    return path.is_relative_to(PACKAGE)


def _home(kind: type) -> Path:
    """The file that a class comes from, where it can be found there by its name."""
    module = sys.modules.get(kind.__module__)
    found: Any = module
    for name in kind.__qualname__.split("."):
        found = getattr(found, name, None)
    file = getattr(module, "__file__", None)
    if found is not kind or file is None:
        raise _UntoldError
    return Path(file).resolve()
