"""The papers that studies are about: what they say and show, from a file beside the studies."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from albedo.errors import InputError

__all__ = ["FILE", "Paper", "PaperClaim", "PaperFigure", "read_papers"]

FILE = "papers.toml"


@dataclass(frozen=True)
class PaperFigure:
    """A figure of a paper: its number, what it shows, and why no study reproduces it, if so."""

    number: str
    caption: str
    pending: str = ""


@dataclass(frozen=True)
class PaperClaim:
    """A statement of a paper, where it stands, and why no study can measure it yet, if so."""

    id: str
    says: str
    where: str = ""
    pending: str = ""


@dataclass(frozen=True)
class Paper:
    """A paper, by the key that studies name it by.

    Attributes
    ----------
    key, title, authors : str
        As they are printed.
    year : int or None
        None where it is not known for certain.
    about : str
        A sentence or two.
    figures : tuple of PaperFigure
        All of them, in order.
    claims : tuple of PaperClaim
        What it asserts that a number can settle.
    """

    key: str
    title: str
    authors: str
    year: int | None
    about: str
    figures: tuple[PaperFigure, ...]
    claims: tuple[PaperClaim, ...]


def read_papers(folder: Path) -> tuple[Paper, ...]:
    """Read ``papers.toml`` in a folder of studies.

    Parameters
    ----------
    folder : Path
        The folder.

    Returns
    -------
    tuple of Paper
        None where there is no such file.

    Raises
    ------
    InputError
        If the file is damaged, lacks something or has what nobody reads.
    """
    path = folder / FILE
    if not path.is_file():
        return ()
    try:
        entries = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"'{path}' cannot be read: {error}.") from None
    papers = []
    for key, entry in entries.items():
        place = f"'{path}', [{key}]"
        known = _fields(place, entry, ("title", "authors"), ("about", "year", "figures", "claims"))
        year = known.get("year")
        if not (year is None or isinstance(year, int)):
            raise InputError(f"{place}: the year is {year!r}; it must be a whole number.")
        figures = []
        for item in known.get("figures", []):
            own = _fields(f"{place}, figures", item, ("number", "caption"), ("pending",))
            figures.append(PaperFigure(**own))
        claims = []
        for id, item in known.get("claims", {}).items():
            own = _fields(f"{place}, claim {id}", item, ("says",), ("where", "pending"))
            claims.append(PaperClaim(id=id, **own))
        about = known.get("about", "")
        papers.append(
            Paper(
                *(key, known["title"], known["authors"], year, about),
                *(tuple(figures), tuple(claims)),
            )
        )
    ids = [claim.id for paper in papers for claim in paper.claims]
    double = sorted({id for id in ids if ids.count(id) > 1})
    if double:
        raise InputError(f"'{path}' has two claims called {', '.join(double)}.")
    return tuple(papers)


def _fields(
    place: str, entry: Any, needed: tuple[str, ...], optional: tuple[str, ...]
) -> dict[str, Any]:
    """The fields of an entry, all of which are known, and none of which is missing."""
    if not isinstance(entry, dict):
        raise InputError(f"{place} is not a table of fields.")
    unknown = [name for name in entry if name not in (*needed, *optional)]
    missing = [name for name in needed if name not in entry]
    if unknown or missing:
        said = [f"has no {', '.join(missing)}"] if missing else []
        said += [f"has the unknown {', '.join(unknown)}"] if unknown else []
        raise InputError(
            f"{place} {' and '.join(said)}; it needs {', '.join(needed)} and may have "
            f"{', '.join(optional)}."
        )
    for name, value in entry.items():
        if name not in ("year", "figures", "claims") and not isinstance(value, str):
            raise InputError(f"{place}: {name} is {value!r}; it must be a text.")
    return entry
