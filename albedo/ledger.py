"""The ledger: for every claim of the papers what was measured, and the verdict that follows.

No verdict is written by hand. A study measures a claim in one or more parts, each with a verdict of
its own (`albedo.studies.Context.claim`); that of the claim is the worst of them, and where the
paper's words have several readings with different verdicts, it depends on the reading.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from albedo.errors import InputError
from albedo.files import save_csv, save_json
from albedo.papers import Paper, PaperClaim

__all__ = ["Row", "ledger", "load_ledger", "save_ledger"]

_WORSE = ("holds", "holds within", "undecided", "depends on the reading", "fails")


@dataclass(frozen=True)
class Row:
    """A claim and what became of it.

    Attributes
    ----------
    id, paper, says, where : str
        As in the list of the papers' claims; what a study claims beyond that has no paper, and
        says what its first part states.
    verdict : str
        One of `albedo.studies.VERDICTS`, ``"pending"`` or ``"not measured"``, alone or followed by
        what it rests on.
    why : str
        How it follows from those of the parts, where it is not theirs.
    pending : str
        What measuring it needs that is not there.
    parts : tuple of dict
        What was measured: the claims of the manifests, each with its ``study``.
    explanations : tuple of str
        Why it does not simply hold.
    seconds : float
        What the studies took that measured it.
    """

    id: str
    paper: str
    says: str
    where: str
    verdict: str
    why: str = ""
    pending: str = ""
    parts: tuple[dict[str, Any], ...] = ()
    explanations: tuple[str, ...] = ()
    seconds: float = 0.0

    @property
    def kind(self) -> str:
        """The verdict without what it rests on."""
        return kind_of(self.verdict)


def kind_of(verdict: str) -> str:
    """A verdict without what it rests on.

    Parameters
    ----------
    verdict : str
        Such as ``"holds within the bound, 2e-9"``.

    Returns
    -------
    str
        Such as ``"holds within"``.
    """
    known = (*_WORSE[::-1], "pending", "not measured")
    return next((kind for kind in known if verdict.startswith(kind)), verdict)


def ledger(papers: Sequence[Paper], manifests: Sequence[Mapping[str, Any]]) -> list[Row]:
    """Put together what studies measured, in the order of the papers' claims.

    Parameters
    ----------
    papers : sequence of Paper
        What the papers claim.
    manifests : sequence of dict
        Records of studies; those of failed ones count for nothing.

    Returns
    -------
    list of Row
        One for every claim of the papers, and after them what studies claim beyond those.
    """
    finished = [manifest for manifest in manifests if manifest["error"] is None]
    listed = [(paper.key, claim) for paper in papers for claim in paper.claims]
    known = {claim.id for _, claim in listed}
    for part in _parts(finished):
        if part["id"] not in known:
            known.add(part["id"])
            listed.append(("", PaperClaim(part["id"], part["statement"])))
    rows = []
    for key, claim in listed:
        parts = tuple(part for part in _parts(finished) if part["id"] == claim.id)
        studies = {part["study"] for part in parts}
        own = [m for m in finished if m["study"]["name"] in studies]
        verdict, why = _judge(parts)
        if not parts:
            verdict, why = "pending" if claim.pending else "not measured", claim.pending
        rows.append(
            Row(
                *(claim.id, key, claim.says, claim.where, verdict, why),
                pending="" if parts else claim.pending,
                parts=parts,
                explanations=tuple(
                    text for m in own for text in m.get("explanations", {}).get(claim.id, ())
                ),
                seconds=sum(m["seconds"] for m in own),
            )
        )
    return rows


def _parts(manifests: Sequence[Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    """All that was measured, each with its study, its figure and its table."""
    for manifest in manifests:
        first = {
            "figure": next((item["name"] for item in manifest["figures"]), ""),
            "table": next((item["name"] for item in manifest["tables"]), ""),
        }
        for claim in manifest["claims"]:
            shown = {key: claim.get(key) or name for key, name in first.items()}
            yield {**claim, **shown, "study": manifest["study"]["name"]}


def _judge(parts: Sequence[Mapping[str, Any]]) -> tuple[str, str]:
    """The verdict of parts together, and how it follows from theirs."""
    readings = list(dict.fromkeys(part["reading"] for part in parts if part["reading"]))
    common = [part["verdict"] for part in parts if not part["reading"]]
    if not readings:
        return _worst(common)
    found = {}
    for reading in readings:
        own = [part["verdict"] for part in parts if part["reading"] == reading]
        found[reading] = _worst([*own, *common])[0]
    if len({verdict.startswith("holds") for verdict in found.values()}) == 1:
        return _worst([part["verdict"] for part in parts])
    said = "; ".join(f"{kind_of(verdict)} [{name}]" for name, verdict in found.items())
    return f"depends on the reading: {said}", ""


def _worst(verdicts: Sequence[str]) -> tuple[str, str]:
    if len(verdicts) < 2:
        return "".join(verdicts), ""
    kinds = [kind_of(verdict) for verdict in verdicts]
    worst = max(kinds, key=_WORSE.index)
    same = [verdict for verdict, kind in zip(verdicts, kinds, strict=True) if kind == worst]
    held = sum(kind.startswith("holds") for kind in kinds)
    if worst == "holds within":
        return same[0] if len(set(verdicts)) == 1 else "holds within the bounds", ""
    if held in (0, len(kinds)):
        return (same[0] if len(set(same)) == 1 else worst), ""
    return worst, f"{held} of {len(kinds)} measured statements hold"


def save_ledger(rows: Sequence[Row], out: Path) -> None:
    """Write ``claims.json``, and ``claims.csv`` with one row for every part.

    Parameters
    ----------
    rows : sequence of Row
        The ledger.
    out : Path
        Folder of the site.
    """
    import pandas as pd

    save_json({"claims": [asdict(row) for row in rows]}, out / "claims.json")
    lines = []
    for row in rows:
        whole = {"id": row.id, "paper": row.paper, "says": row.says, "verdict": row.verdict}
        for part in row.parts or ({},):
            lines.append(
                {
                    **whole,
                    "study": part.get("study", ""),
                    "statement": part.get("statement", ""),
                    "reading": part.get("reading", ""),
                    "quantity": part.get("quantity", ""),
                    "criterion": part.get("criterion", ""),
                    "measured": part.get("value"),
                    "measured_error": part.get("error"),
                    "kind": part.get("kind", ""),
                    "part_verdict": part.get("verdict", ""),
                    "figure": _path(part, "figure", ".svg"),
                    "data": _path(part, "table", ".csv"),
                    "seconds": row.seconds,
                }
            )
    save_csv(pd.DataFrame(lines), out / "claims.csv")


def _path(part: Mapping[str, Any], key: str, ending: str) -> str:
    return f"studies/{part['study']}/{part[key]}{ending}" if part.get(key) else ""


def load_ledger(folder: Path) -> list[Row]:
    """Read the ledger of a site.

    Parameters
    ----------
    folder : Path
        Of the site.

    Returns
    -------
    list of Row
        As `save_ledger` wrote them; numbers that JSON does not know are texts again.

    Raises
    ------
    InputError
        If there is none, or it is damaged.
    """
    path = folder / "claims.json"
    try:
        entries = json.loads(path.read_text(encoding="utf-8"))["claims"]
        return [
            Row(
                **{
                    **entry,
                    "parts": tuple(entry["parts"]),
                    "explanations": tuple(entry["explanations"]),
                }
            )
            for entry in entries
        ]
    except FileNotFoundError:
        raise InputError(
            f"There is no '{path}'; 'albedo report -o {folder}' writes it, or name the folder of "
            "another report with --reports."
        ) from None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"'{path}' is damaged: {type(error).__name__}: {error}.") from None
