"""What the registry says about its models, in words: promises, sources, and the list of all."""

from __future__ import annotations

import inspect
import re
import unicodedata
from functools import cache
from pathlib import Path
from typing import Any

from albedo.brdf import Model
from albedo.catalogue import models

_ENTRY = re.compile(r"^@\w+\{([^,\s]+),\n(.*?)^\}$", re.MULTILINE | re.DOTALL)
_FIELD = re.compile(r"^  (\w+)\s*= \{(.*?)\},$", re.MULTILINE | re.DOTALL)
_ACCENT = re.compile(r"\\(?:(['\"`^~])\{?(\w)\}?|([vcu])\{(\w)\})")
# The combining characters of what TeX calls an accent.
_MARKS = dict(zip("'\"`^~vcu", "\u0301\u0308\u0300\u0302\u0303\u030c\u0327\u0306", strict=True))


@cache
def sources() -> dict[str, dict[str, str]]:
    """The fields of every entry of references.bib, by key."""
    text = (Path(__file__).parent / "references.bib").read_text(encoding="utf-8")
    return {key: dict(_FIELD.findall(body)) for key, body in _ENTRY.findall(text)}


def citation(key: str) -> str:
    """A source as one line: authors, title, where and when.

    Parameters
    ----------
    key : str
        A key of references.bib.

    Returns
    -------
    str
        Such as ``Cook, Torrance: A Reflectance Model ... ACM Transactions on Graphics, 1982``.
    """
    entry = sources()[key]
    people = ", ".join(name.split(",")[0] for name in entry["author"].split(" and "))
    where = [entry.get(k) for k in ("journal", "booktitle", "publisher", "institution")]
    place = next((text for text in where if text), None)
    line = f"{people}: {entry['title']}. " + (f"{place}, " if place else "") + entry["year"]
    return _plain(line).replace("--", "-")


def reference(key: str) -> str:
    """A source in full: authors, title, where and when.

    Parameters
    ----------
    key : str
        A key of references.bib.

    Returns
    -------
    str
        One line of plain text.
    """
    entry = sources()[key]
    people = []
    for person in entry["author"].split(" and "):
        last, _, first = person.partition(", ")
        people.append(f"{first} {last}".strip())
    place = next(
        (entry[k] for k in ("journal", "booktitle", "publisher", "institution") if k in entry), ""
    )
    if "volume" in entry:
        place += f" {entry['volume']}" + (f"({entry['number']})" if "number" in entry else "")
    if "pages" in entry:
        place += f", {entry['pages']}"
    if entry.get("publisher", place) not in place:
        place += f", {entry['publisher']}"
    tail = [place, entry.get("address", ""), entry["year"], entry.get("note", "")]
    line = f"{', '.join(people)}: {entry['title']}. {', '.join(part for part in tail if part)}."
    if "doi" in entry:
        line += f" doi:{entry['doi']}"
    return _plain(line).replace("--", "–")


def _plain(line: str) -> str:
    """A line without its markup."""
    plain = _ACCENT.sub(
        lambda hit: (hit[2] or hit[4]) + _MARKS[hit[1] or hit[3]], " ".join(line.split())
    )
    return unicodedata.normalize("NFC", re.sub(r"[{}]", "", plain).replace("\\&", "&"))


def promises(kind: type[Model]) -> dict[str, str]:
    """What a model promises, each as ``yes``, ``no``, or on what it depends.

    Parameters
    ----------
    kind : type
        The class of a model.

    Returns
    -------
    dict of str to str
        For ``reciprocal``, ``conserves energy``, ``isotropic`` and ``finite at grazing incidence``.
    """
    return {
        "reciprocal": _said(kind, "reciprocal"),
        "conserves energy": _said(kind, "conserves_energy"),
        "isotropic": "yes" if vars(Model)["isotropic"] is _found(kind, "isotropic") else _DEPENDS,
        "finite at grazing incidence": _said(kind, "grazing_limit"),
    }


_DEPENDS = "depends on its parameters"


def _found(kind: type[Model], name: str) -> Any:
    return inspect.getattr_static(kind, name)


def _said(kind: type[Model], name: str) -> str:
    promise = _found(kind, name)
    if isinstance(promise, bool):
        return "yes" if promise else "no"
    reason = inspect.getdoc(promise)
    # A property says in its first sentence on what it depends.
    return f"{_DEPENDS}: {' '.join(reason.split())}" if reason else _DEPENDS


def markdown() -> str:
    """The list of all models as a Markdown table, as it stands in the README."""
    lines = [
        "| model | what it is | source | reciprocal | conserves energy |",
        "|---|---|---|---|---|",
    ]
    for name, kind in models().items():
        said = promises(kind)
        short = [said[key].split(":")[0] for key in ("reciprocal", "conserves energy")]
        short = ["depends" if text == _DEPENDS else text for text in short]
        lines.append(f"| `{name}` | {kind.title} | {kind.equation} | {' | '.join(short)} |")
    return "\n".join(lines) + "\n"
