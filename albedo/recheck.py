"""Compares two runs of studies by value: what is new lies within the bounds of what was kept.

Hashes inform and do not judge: last digits differ between processors. Values with errors agree
within both errors, numbers without to nine digits or to what the study allows, times in their
ranking only. Of claims, values and verdicts agree.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from albedo.errors import InputError
from albedo.ledger import kind_of

__all__ = ["Comparison", "Difference", "compare_runs"]

# Values without an error are printed by other libraries, or come out of a few roundings.
_DIGITS = 1e-9
_SKIPPED = ("_evaluations",)
# An error that got out of hand excuses no more than this many of the former one.
_WIDER = 10.0
# Times threefold apart, errors and all, keep their order, but for some that were disturbed.
_TIMES = ("ns", "seconds")
_APART, _TURNED, _FEW_TURNED = 3.0, 0.02, 3


@dataclass(frozen=True)
class Difference:
    """Something that does not agree: where it is, what was kept, what is new, what is allowed."""

    place: str
    kept: str
    new: str
    allowed: str


@dataclass
class Comparison:
    """What two runs have in common.

    Attributes
    ----------
    studies, columns, values, claims, rankings : int
        How many were compared; of columns of times only the ranking of their rows.
    files, same_bytes : int
        Tables, and how many of them are the same to the last byte.
    differences : list of Difference
        All that does not agree.
    """

    studies: int = 0
    columns: int = 0
    values: int = 0
    claims: int = 0
    rankings: int = 0
    files: int = 0
    same_bytes: int = 0
    differences: list[Difference] = field(default_factory=list)


def compare_runs(kept: Path, new: Path, *, times: bool = True) -> Comparison:
    """Compare the studies of two sites, or of folders of tables and records.

    Parameters
    ----------
    kept, new : Path
        Folders that have a folder ``studies``.
    times : bool
        Whether to compare the ranking of times, which other work on the machine disturbs.

    Returns
    -------
    Comparison
        What was compared, and what does not agree.

    Raises
    ------
    InputError
        If what was kept is missing or damaged.
    """
    found = Comparison()
    names = sorted(path.parent.name for path in (kept / "studies").glob("*/manifest.json"))
    if not names:
        raise InputError(
            f"'{kept}' holds no studies to compare with: no studies/*/manifest.json in it."
        )
    others = {path.parent.name for path in (new / "studies").glob("*/manifest.json")}
    for name in sorted(others - set(names)):
        found.differences.append(Difference(name, "no such study", "a study", "the same studies"))
    for name in names:
        found.studies += 1
        if name not in others:
            found.differences.append(
                Difference(name, "a study", "no such study", "the same studies")
            )
            continue
        pair = kept / "studies" / name, new / "studies" / name
        try:
            found.differences.extend(_study(name, *pair, times, found))
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise InputError(
                f"The record of the study '{name}' in '{kept}' or '{new}' is damaged: "
                f"{type(error).__name__}: {error}."
            ) from None
    return found


def _study(
    name: str, kept: Path, new: Path, times: bool, found: Comparison
) -> Iterator[Difference]:
    old, fresh = (
        json.loads((folder / "manifest.json").read_text(encoding="utf-8")) for folder in (kept, new)
    )
    if fresh["error"] is not None:
        yield Difference(name, "finished", f"failed: {fresh['error']['message']}", "finished")
        return
    if old["fidelity"] != fresh["fidelity"]:
        yield Difference(name, old["fidelity"], fresh["fidelity"], "the same fidelity")
        return
    yield from _claims(name, old["claims"], fresh["claims"], found)
    before = {table["name"]: table for table in old["tables"]}
    after = {table["name"]: table for table in fresh["tables"]}
    for table in before.keys() ^ after.keys():
        has, had = ("a table" if table in tables else "no such table" for tables in (after, before))
        yield Difference(f"{name}/{table}", had, has, "the same tables")
    for table in before.keys() & after.keys():
        file = after[table]["file"]
        found.files += 1
        if _hash(kept / file) == _hash(new / file):
            found.same_bytes += 1
        had, has = (pd.read_csv(folder / file) for folder in (kept, new))
        yield from _table(f"{name}/{table}", had, has, after[table], found)
        if times:
            yield from _times(f"{name}/{table}", had, has, after[table], found)


def _hash(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _claims(
    name: str,
    kept: Sequence[Mapping[str, Any]],
    new: Sequence[Mapping[str, Any]],
    found: Comparison,
) -> Iterator[Difference]:
    ids = [[(claim["id"], claim.get("reading", "")) for claim in claims] for claims in (kept, new)]
    if ids[0] != ids[1]:
        yield Difference(f"{name}: claims", str(len(kept)), str(len(new)), "the same claims")
        return
    for old, fresh in zip(kept, new, strict=True):
        found.claims += 1
        place = f"{name}: {old['id']} {old.get('reading', '')}".strip()
        # Claims about times are about this machine; the tables have the ranking.
        if fresh.get("machine"):
            continue
        kinds = [kind_of(claim["verdict"]) for claim in (old, fresh)]
        if kinds[0] != kinds[1]:
            yield Difference(f"{place}, verdict", kinds[0], kinds[1], "the same verdict")
        before, after = (float(claim["value"]) for claim in (old, fresh))
        error, new_error = float(old["error"]), float(fresh["error"])
        allowed = error + min(new_error, _WIDER * error) + _slack(before, after)
        if not (before == after or abs(before - after) <= allowed):
            yield Difference(f"{place}, value", f"{before:.17g}", f"{after:.17g}", f"{allowed:.3g}")


def _slack(before: float, after: float) -> float:
    """What two numbers may differ by for their printing alone."""
    size = max(abs(before), abs(after))
    return 1e-14 * size if math.isfinite(size) else 0.0


def _table(
    place: str, kept: pd.DataFrame, new: pd.DataFrame, about: Mapping[str, Any], found: Comparison
) -> Iterator[Difference]:
    if list(kept.columns) != list(new.columns):
        had, has = (", ".join(frame.columns) for frame in (kept, new))
        yield Difference(f"{place}, columns", had, has, "the same columns")
        return
    if len(kept) != len(new):
        yield Difference(f"{place}, rows", str(len(kept)), str(len(new)), "the same number")
        return
    for column in kept.columns:
        stem = column.removesuffix("_error")
        companion = column != stem and stem in kept.columns
        if column in about.get("machine", ()) or column.endswith(_SKIPPED) or companion:
            continue
        found.columns += 1
        found.values += len(kept)
        yield from _column(f"{place}, {column}", column, kept, new, about)


def _times(
    place: str, kept: pd.DataFrame, new: pd.DataFrame, about: Mapping[str, Any], found: Comparison
) -> Iterator[Difference]:
    if list(kept.columns) != list(new.columns) or len(kept) != len(new):
        return
    for column in about.get("machine", ()):
        if not column.endswith(_TIMES) or kept[column].dtype.kind not in "fiu":
            continue
        found.rankings += 1
        pairs, turned = _ranking(*(_interval(frame, column) for frame in (kept, new)))
        most = max(_FEW_TURNED, int(_TURNED * pairs))
        if turned > most:
            said = f"{turned} of {pairs} the other way round"
            allowed = f"{most} of them"
            yield Difference(f"{place}, {column}, order", f"{pairs} pairs", said, allowed)


def _interval(frame: pd.DataFrame, column: str) -> tuple[np.ndarray, np.ndarray]:
    """Where times lie by what their table says of them, or they themselves."""
    ends = f"{column}_low", f"{column}_high"
    if all(end in frame.columns for end in ends):
        low, high = (frame[end].to_numpy(dtype=float) for end in ends)
        return low, high
    value = frame[column].to_numpy(dtype=float)
    error = f"{column}_error"
    spread = frame[error].to_numpy(dtype=float) if error in frame.columns else 0.0
    return value - spread, value + spread


def _ranking(
    kept: tuple[np.ndarray, np.ndarray], new: tuple[np.ndarray, np.ndarray]
) -> tuple[int, int]:
    """Pairs of rows whose intervals lay far apart, and how many of them changed their order."""
    with np.errstate(invalid="ignore"):
        ahead = kept[0][:, None] > _APART * kept[1][None, :]
        turned = ahead & (new[1][:, None] < new[0][None, :])
    return int(ahead.sum()), int(turned.sum())


def _column(
    place: str, column: str, kept: pd.DataFrame, new: pd.DataFrame, about: Mapping[str, Any]
) -> Iterator[Difference]:
    loose, digits = (about.get(key, {}) for key in ("loose", "digits"))
    numeric = all(frame[column].dtype.kind in "fiu" for frame in (kept, new))
    if not numeric:
        before, after = (frame[column].astype(str).to_numpy() for frame in (kept, new))
        wrong, allowed = before != after, np.zeros(len(kept))
    else:
        before, after = (frame[column].to_numpy(dtype=float) for frame in (kept, new))
        size = np.maximum(np.abs(before), np.abs(after))
        # Nothing is near to infinity.
        size = np.where(np.isfinite(size), size, 0.0)
        if f"{column}_error" in kept.columns:
            errors = [frame[f"{column}_error"].to_numpy(dtype=float) for frame in (kept, new)]
            allowed = errors[0] + np.minimum(errors[1], _WIDER * errors[0]) + 1e-14 * size
        elif column in loose:
            allowed = np.full(len(kept), float(loose[column]))
        elif column in digits:
            # The last digit that is kept may be another one.
            allowed = 1.001 * 10.0 ** (1 - digits[column]) * size
        elif kept[column].dtype.kind in "iu":
            allowed = np.zeros(len(kept))
        else:
            allowed = _DIGITS * size
        with np.errstate(invalid="ignore"):
            agree = (before == after) | (np.abs(before - after) <= allowed)
        wrong = ~(agree | (np.isnan(before) & np.isnan(after)))
    if wrong.any():
        # One line a column, about its worst row.
        with np.errstate(invalid="ignore"):
            excess = np.abs(before - after) - allowed if numeric else wrong.astype(float)
        worst = int(np.argmax(np.where(wrong & ~np.isnan(excess), excess, -math.inf)))
        worst = worst if wrong[worst] else int(np.argmax(wrong))
        more = f" and {wrong.sum() - 1} more" if wrong.sum() > 1 else ""
        where = f"{place}, row {worst + 1}{more}"
        was, now = (f"{v[worst]:.17g}" if numeric else str(v[worst]) for v in (before, after))
        yield Difference(where, was, now, f"{allowed[worst]:.3g}" if numeric else "the same text")
