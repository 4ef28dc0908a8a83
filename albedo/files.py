"""Files that are either complete or absent.

Everything is written under a temporary name in the folder where it is going to live and renamed at
the end, so an interruption or a full disk never leaves a broken file under the name asked for.
"""

from __future__ import annotations

import json
import math
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from albedo.errors import InputError

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

__all__ = [
    "atomic_file",
    "atomic_folder",
    "check_output",
    "make_folder",
    "save_csv",
    "save_json",
    "save_table",
    "save_text",
    "strict",
]


@contextmanager
def atomic_file(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a temporary path, and rename it to the one asked for when the block succeeds.

    Parameters
    ----------
    path : path
        Where the file shall be. A file that is already there is replaced at the last moment.

    Yields
    ------
    Path
        Path in the same folder, with the same suffix, to write to.
    """
    # A rename onto a link would replace the link, not the file that it stands for.
    target = Path(os.path.realpath(path))
    temporary = target.with_name(f".{target.stem}.{secrets.token_hex(4)}.part{target.suffix}")
    try:
        yield temporary
        os.replace(temporary, target)
    except OSError as error:
        # Nobody knows the temporary name.
        if error.filename == os.fspath(temporary):
            error.filename = os.fspath(path)
        raise
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def atomic_folder(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a fresh temporary folder, and put it in the place asked for when the block succeeds.

    Parameters
    ----------
    path : path
        Where the folder shall be. One that is already there is replaced as a whole.

    Yields
    ------
    Path
        Empty folder beside it to fill.
    """
    target = Path(os.path.realpath(path))
    make_folder(target.parent)
    mark = secrets.token_hex(4)
    temporary = target.with_name(f".{target.name}.{mark}.part")
    former = target.with_name(f".{target.name}.{mark}.old")
    try:
        temporary.mkdir()
        yield temporary
        if target.exists():
            os.replace(target, former)
        os.replace(temporary, target)
    finally:
        # Interrupted between the two renames: the former results go back to their place.
        if former.exists() and not target.exists():
            os.replace(former, target)
        shutil.rmtree(temporary, ignore_errors=True)
        shutil.rmtree(former, ignore_errors=True)


def make_folder(path: str | os.PathLike[str]) -> None:
    """Make a folder, and those that it lies in, where they are not there.

    Parameters
    ----------
    path : path
        The folder.

    Raises
    ------
    InputError
        If it cannot be made, with its name and that of what is in the way.
    """
    try:
        Path(path).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"The folder '{path}' cannot be made; '{error.filename}': {error.strerror}."
        ) from None


def check_output(path: str | os.PathLike[str], suffixes: tuple[str, ...]) -> Path:
    """Refuse an output path that cannot work, before any time is spent on its content.

    Parameters
    ----------
    path : path
        The file that is going to be written.
    suffixes : tuple of str
        File name endings that are understood, such as ``(".nc", ".csv")``.

    Returns
    -------
    Path
        The same path.

    Raises
    ------
    InputError
        If the ending is not one of those, or the folder is missing or cannot be written to.
    """
    target = Path(path)
    if target.suffix.lower() not in suffixes:
        raise InputError(
            f"The output file '{target}' must end in one of {', '.join(suffixes)}, which say what "
            "is written."
        )
    if target.is_dir():
        raise InputError(f"The output file '{target}' is a folder; name a file in it.")
    if not target.parent.is_dir():
        raise InputError(
            f"The output file '{target}' cannot be written: there is no folder '{target.parent}'."
        )
    if not os.access(target.parent, os.W_OK | os.X_OK):
        raise InputError(
            f"The output file '{target}' cannot be written: the folder '{target.parent}' does not "
            "allow it."
        )
    return target


def save_table(dataset: xr.Dataset, path: str | os.PathLike[str]) -> Path:
    """Write an albedo table as netCDF (with all its provenance) or CSV (one row per value).

    Parameters
    ----------
    dataset : xarray.Dataset
        Table such as `albedo.table` makes.
    path : path
        File that ends in ``.nc`` or ``.csv``.

    Returns
    -------
    Path
        The file.
    """
    target = check_output(path, (".nc", ".csv"))
    if target.suffix.lower() == ".csv":
        return save_csv(dataset.to_dataframe().reset_index(), target)
    with atomic_file(target) as temporary:
        dataset.to_netcdf(temporary, engine="h5netcdf")
    return target


def save_csv(frame: pd.DataFrame, path: str | os.PathLike[str]) -> Path:
    """Write a data frame as CSV, floats in the shortest form that reads back exactly.

    Parameters
    ----------
    frame : pandas.DataFrame
        The rows; the index is not written.
    path : path
        The file.

    Returns
    -------
    Path
        The file.
    """
    target = Path(path)
    with atomic_file(target) as temporary:
        frame.to_csv(temporary, index=False, lineterminator="\n", na_rep="nan")
    return target


def save_json(content: Any, path: str | os.PathLike[str]) -> Path:
    """Write plain data as indented, strictly valid JSON.

    Parameters
    ----------
    content : object
        Dicts, lists, text and numbers.
    path : path
        The file.

    Returns
    -------
    Path
        The file.
    """
    return save_text(json.dumps(strict(content), indent=2, allow_nan=False) + "\n", path)


def save_text(text: str, path: str | os.PathLike[str]) -> Path:
    """Write text as UTF-8.

    Parameters
    ----------
    text : str
        The content.
    path : path
        The file.

    Returns
    -------
    Path
        The file.
    """
    target = Path(path)
    with atomic_file(target) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")
    return target


def strict(content: Any) -> Any:
    """Turn data into what JSON can say; infinities and NaN become text, as JSON has none.

    Parameters
    ----------
    content : object
        Dicts, lists, tuples, text, numbers, numpy arrays and scalars.

    Returns
    -------
    object
        The same with plain Python types; ``"Infinity"``, ``"-Infinity"`` and ``"NaN"`` for the
        numbers that are not finite.
    """
    if isinstance(content, dict):
        return {str(key): strict(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [strict(value) for value in content]
    if hasattr(content, "tolist"):
        return strict(content.tolist())
    if isinstance(content, float) and not math.isfinite(content):
        return "NaN" if math.isnan(content) else "Infinity" if content > 0.0 else "-Infinity"
    return content
