"""Every citation key that a model or an operator uses is in references.bib, and none is idle."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import pytest

import albedo

BIB = Path(albedo.__file__).parent / "references.bib"
_ENTRY = re.compile(r"^@(\w+)\{([^,\s]+),\n(.*?)^\}$", re.MULTILINE | re.DOTALL)
_FIELD = re.compile(r"^  (\w+)\s*= \{(.*?)\},$", re.MULTILINE | re.DOTALL)


def entries() -> list[tuple[str, str, dict[str, str]]]:
    """Type, key and fields of every entry, in the order of the file."""
    text = BIB.read_text(encoding="utf-8")
    return [(kind, key, dict(_FIELD.findall(body))) for kind, key, body in _ENTRY.findall(text)]


def used() -> dict[str, list[str]]:
    """The models, and the operators, that cite each key."""
    keys: dict[str, list[str]] = {}
    lobe = albedo.model("cook_torrance", m=0.5)
    made = [
        albedo.couple(lobe),
        albedo.normalize(lobe),
        *(albedo.compensate(lobe, method) for method in ("kulla_conty", "turquin", "pump")),
    ]
    kinds = [*albedo.models().items(), *((model.spec, model) for model in made)]
    for name, kind in kinds:
        for key in kind.references:
            keys.setdefault(key, []).append(name)
    return keys


def test_every_key_that_is_used_exists() -> None:
    known = {key for _, key, _ in entries()}
    missing = {key: names for key, names in used().items() if key not in known}
    assert not missing, f"references.bib lacks {missing}"


def test_every_entry_is_used() -> None:
    idle = {key for _, key, _ in entries()} - used().keys()
    assert not idle, f"no model cites {sorted(idle)}"


def test_every_model_cites_a_source() -> None:
    assert not [name for name, kind in albedo.models().items() if not kind.references]


def test_entries_are_sorted_and_unique() -> None:
    keys = [key for _, key, _ in entries()]
    assert keys == sorted(keys)
    assert not [key for key, count in Counter(keys).items() if count > 1]


def test_the_file_holds_nothing_that_is_not_an_entry() -> None:
    rest = _ENTRY.sub("", BIB.read_text(encoding="utf-8"))
    assert not [line for line in rest.splitlines() if line.strip() and line[0] != "%"]


@pytest.mark.parametrize(("kind", "key", "fields"), entries(), ids=[key for _, key, _ in entries()])
def test_an_entry_is_complete(kind: str, key: str, fields: dict[str, str]) -> None:
    where = {
        "article": {"journal"},
        "book": {"publisher"},
        "inproceedings": {"booktitle"},
        "techreport": {"institution"},
        "misc": set(),
    }[kind]
    assert {"author", "title", "year"} | where <= fields.keys()
    assert re.fullmatch(r"\d{4}", fields["year"])
    # A key that names a year names the right one.
    named = re.search(r"\d{4}\Z", key)
    assert named is None or named[0] == fields["year"]
