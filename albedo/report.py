"""The report: runs the studies, and makes a site, a ledger and a record of what they found.

out/
  index.html, claims.html, papers/, models/     the pages
  studies/NAME/                                 page, figures, tables and record of each study
  claims.csv, claims.json                       the ledger
  manifest.json                                 what all of it was made from
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from albedo.files import make_folder, save_json, save_text
from albedo.ledger import ledger, save_ledger
from albedo.papers import read_papers
from albedo.runner import Screen, run_studies
from albedo.sources import versions
from albedo.studies import Result, StudyFile

__all__ = ["build_report", "record"]


def build_report(
    files: Sequence[StudyFile],
    out: Path,
    *,
    full: bool = False,
    jobs: int | None = None,
    again: bool = False,
    pages: bool = True,
    screen: Screen | None = None,
) -> list[Result]:
    """Run studies and write the site.

    A study that fails gets a page that says why, and does not stop the others. Those of which
    nothing changed are not run again. What is finished when the run is interrupted stays.

    Parameters
    ----------
    files : sequence of StudyFile
        The studies, all of one folder.
    out : Path
        Folder of the site; created when missing.
    full : bool
        Full fidelity instead of quick.
    jobs : int, optional
        How many studies run at a time; as many as there are cores unless given.
    again : bool
        Run all of them, whether anything changed or not.
    pages : bool
        Without, only tables, records and the ledger stay: enough to compare a later run with.
    screen : Screen, optional
        What shows how far the studies are.

    Returns
    -------
    list of Result
        One for every study, failures included.
    """
    from albedo.site import render_study, write_site

    papers = read_papers(files[0].path.parent)
    make_folder(out)

    def finish(result: Result) -> None:
        if result.folder is None:
            return
        page = render_study(result.folder, result.manifest)
        save_text(page, result.folder / "index.html")

    results = run_studies(
        *(files, out / "studies"),
        full=full,
        jobs=jobs,
        again=again,
        pictures=pages,
        keep_failure=True,
        screen=screen,
        finish=finish if pages else None,
    )
    manifests = [result.manifest for result in results]
    rows = ledger(papers, manifests)
    save_ledger(rows, out)
    save_json(record(manifests, full), out / "manifest.json")
    if pages:
        write_site(out, manifests, papers, rows)
    return results


def record(manifests: Sequence[Mapping[str, Any]], full: bool) -> dict[str, Any]:
    """What a site was made from.

    Parameters
    ----------
    manifests : sequence of dict
        Records of the studies.
    full : bool
        The fidelity.

    Returns
    -------
    dict
        Versions, the kind of machine, and for every study its settings (tolerances, seeds), a hash
        of what it read, and a hash of every table.
    """
    studies = {}
    for manifest in manifests:
        if manifest["error"] is not None:
            continue
        tables = {table["file"] for table in manifest["tables"]}
        studies[manifest["study"]["name"]] = {
            "settings": manifest["settings"],
            "sources_sha256": manifest["inputs"]["sources_sha256"],
            "tables_sha256": {k: v for k, v in manifest["outputs"].items() if k in tables},
            "seconds": manifest["seconds"],
        }
    return {
        "fidelity": "full" if full else "quick",
        "made_with": versions(),
        "studies": studies,
    }
