"""The pages of the site: plain HTML with relative links, which loads nothing from elsewhere."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from albedo.estimate import format_value
from albedo.files import save_text
from albedo.ledger import Row
from albedo.papers import Paper

if TYPE_CHECKING:
    import jinja2
    import pandas as pd

__all__ = ["render_study", "write_site"]

# A page shows so many rows of a table, evenly spread; the CSV beside it has all.
_SHOWN_ROWS = 24


def write_site(
    out: Path, manifests: Sequence[dict[str, Any]], papers: Sequence[Paper], rows: Sequence[Row]
) -> None:
    """Write the pages that are not those of single studies."""
    save_text(_source("style.css"), out / "style.css")
    save_text(_render_index(manifests), out / "index.html")


def _render_index(manifests: Sequence[dict[str, Any]]) -> str:
    """Write the first page of the site.

    Parameters
    ----------
    manifests : sequence of dict
        Manifests of the studies.

    Returns
    -------
    str
        HTML.
    """
    return _environment().get_template("index.html.j2").render(manifests=manifests)


def render_study(folder: Path, manifest: dict[str, Any]) -> str:
    """Write the page of one study.

    Parameters
    ----------
    folder : Path
        Folder with its tables.
    manifest : dict
        Its manifest.

    Returns
    -------
    str
        HTML.
    """
    import pandas as pd

    tables = [
        {**table, **_excerpt(pd.read_csv(folder / table["file"]))} for table in manifest["tables"]
    ]
    template = _environment().get_template("study.html.j2")
    return template.render(manifest=manifest, tables=tables)


def _excerpt(frame: pd.DataFrame) -> dict[str, Any]:
    """Rows and columns as a page shows them: a value and its error become one column."""
    import numpy as np

    count = len(frame)
    picked = np.unique(np.linspace(0, count - 1, min(count, _SHOWN_ROWS)).round().astype(int))
    shown = frame.iloc[picked]
    columns = []
    for name in frame.columns:
        stem = next(
            (name.removesuffix(s) for s in ("_error", "_evaluations") if name.endswith(s)), None
        )
        if stem is not None and stem in frame.columns:
            continue
        if f"{name}_error" in frame.columns:
            pairs = zip(shown[name], shown[f"{name}_error"], strict=True)
            cells = [format_value(float(value), float(error)) for value, error in pairs]
        else:
            cells = [f"{v:.6g}" if isinstance(v, float) else str(v) for v in shown[name]]
        numeric = frame[name].dtype.kind in "iuf"
        columns.append({"name": name, "cells": cells, "numeric": numeric})
    rows = list(zip(*(column["cells"] for column in columns), strict=True))
    return {"columns": columns, "rows": rows, "count": count, "shown": len(picked)}


def _seconds(value: float) -> str:
    if value < 1:
        return f"{value * 1000:.0f} ms"
    return f"{value:.1f} s" if value < 100 else f"{value / 60:.1f} min"


def _tone(verdict: str) -> str:
    """CSS class of a verdict."""
    for start, tone in (("holds", "good"), ("fails", "bad")):
        if verdict.startswith(start):
            return tone
    return "open"


def _verdicts(claims: list[dict[str, Any]]) -> list[tuple[str, int]]:
    """Claims with their verdicts, without the numbers, and how often each is there."""
    return list(Counter(f"{c['id']} {c['verdict'].split(':')[0]}" for c in claims).items())


def _environment() -> jinja2.Environment:
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("albedo", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["format_value"] = lambda claim: format_value(claim["value"], claim["error"])
    environment.filters["seconds"] = _seconds
    environment.filters["tone"] = _tone
    environment.filters["verdicts"] = _verdicts
    return environment


def _source(name: str) -> str:
    """Text of a file of the templates."""
    return (Path(__file__).parent / "templates" / name).read_text(encoding="utf-8")
