"""The pages of the site: plain HTML with relative links, one style sheet and one small script.

Pages load nothing from elsewhere and are whole without the script, so a site can be mailed,
archived or opened from the disk. The folder of a site has the studies in ``studies/NAME/``, and
here are the pages about them: an overview, the claims, one for every paper and every model.
"""

from __future__ import annotations

import csv
import inspect
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from albedo.estimate import format_value
from albedo.files import save_text

if TYPE_CHECKING:
    import jinja2
    import pandas as pd

    from albedo.brdf import Model
    from albedo.ledger import Row
    from albedo.papers import Paper

__all__ = ["render_study", "write_site"]

# A page shows so many rows of a table, evenly spread; the CSV beside it has all.
_SHOWN_ROWS = 8
# A study with more tables than this shows them folded, with fewer rows.
_MANY_TABLES, _FEW_ROWS = 8, 6

KINDS = (
    "holds",
    "holds within",
    "fails",
    "depends on the reading",
    "undecided",
    "pending",
    "not measured",
)
"""What verdicts start with; where two fit, the longer one counts."""

# The class of a verdict in the style sheet, and a sign for those who do not see colours.
_LOOKS = {
    "holds": ("good", "✓"),
    "holds within": ("near", "≈"),
    "fails": ("bad", "✗"),
    "depends on the reading": ("open", "◐"),
    "undecided": ("open", "?"),
    "pending": ("none", "…"),
    "not measured": ("none", "–"),
}

# The studies that the pages of models draw from; without them these pages are shorter.
_PAGES, _DIGITS, _VALUES = "model_pages", "stability_albedo", "stability"


def render_study(folder: Path, manifest: dict[str, Any]) -> str:
    """Write the page of one study, which lies two levels below the first page of the site.

    Parameters
    ----------
    folder : Path
        Folder with its tables and figures.
    manifest : dict
        Its manifest.

    Returns
    -------
    str
        HTML.
    """
    import pandas as pd

    many = len(manifest["tables"]) > _MANY_TABLES
    rows = _FEW_ROWS if many else _SHOWN_ROWS
    tables = [
        {**table, **_excerpt(pd.read_csv(folder / table["file"]), rows)}
        for table in manifest["tables"]
    ]
    figures = [{**figure, **_size(folder / figure["svg"])} for figure in manifest["figures"]]
    return _page(
        "study.html.j2", root="../../", manifest=manifest, tables=tables, figures=figures, many=many
    )


def write_site(
    out: Path, manifests: Sequence[dict[str, Any]], papers: Sequence[Paper], rows: Sequence[Row]
) -> None:
    """Write all pages of the site but those of the studies.

    Parameters
    ----------
    out : Path
        Folder of the site, with the folder of every study at ``studies/NAME``.
    manifests : sequence of dict
        Manifests of the studies.
    papers : sequence of Paper
        Papers that the studies are about; there may be none.
    rows : sequence of Row
        What the studies say about every claim.
    """
    from albedo.catalogue import models

    site = _Site(out, manifests, papers, rows)
    pages = {
        "style.css": _source("style.css"),
        "site.js": _source("site.js"),
        "index.html": _page(
            "index.html.j2",
            root="",
            site=site,
            models=[_summary(site, name, kind) for name, kind in models().items()],
        ),
        "claims.html": _page("claims.html.j2", root="", site=site),
    }
    for paper in papers:
        pages[f"papers/{paper.key}.html"] = _page(
            "paper.html.j2",
            root="../",
            site=site,
            paper=paper,
            **_about_paper(site, paper),
        )
    for name, kind in models().items():
        pages[f"models/{name}.html"] = _page(
            "model.html.j2", root="../", site=site, **_about_model(site, name, kind)
        )
    for path, text in pages.items():
        (out / path).parent.mkdir(parents=True, exist_ok=True)
        save_text(text, out / path)


@dataclass(frozen=True)
class _Entry:
    """A claim as the pages show it."""

    id: str
    paper: str
    says: str
    where: str
    verdict: str
    why: str
    pending: str
    parts: list[dict[str, Any]]
    explanations: tuple[str, ...]
    seconds: float

    @property
    def kind(self) -> str:
        """The verdict without its numbers."""
        return _kind(self.verdict)

    @property
    def words(self) -> str:
        """What a search looks through."""
        said = dict.fromkeys(part["statement"] for part in self.parts)
        return " ".join((self.id, self.says, self.kind, *self.studies, *said))

    @property
    def studies(self) -> list[str]:
        """The studies that measure it, each once."""
        return list(dict.fromkeys(part["study"] for part in self.parts))


class _Site:
    """Everything that pages are made from, with what belongs together found."""

    def __init__(
        self, out: Path, manifests: Sequence[dict[str, Any]], papers: Sequence[Paper],
        rows: Sequence[Row],
    ) -> None:  # fmt: skip
        self.folder = out / "studies"
        self.studies = {manifest["study"]["name"]: manifest for manifest in manifests}
        self.papers = {paper.key: paper for paper in papers}
        self.entries = [self._entry(row) for row in rows] + self._unlisted(rows)
        self.by_id = {entry.id: entry for entry in self.entries}
        words = {name: self._words(manifest) for name, manifest in self.studies.items()}
        self.models_of = {name: _named(text, tokens) for name, (text, tokens) in words.items()}

    @property
    def groups(self) -> list[tuple[str, list[_Entry]]]:
        """Claims by paper, in the order of the papers; what is of no paper comes last."""
        keys = list(dict.fromkeys([*self.papers, *(entry.paper for entry in self.entries)]))
        found = [(key, [e for e in self.entries if e.paper == key]) for key in keys]
        return [(key, entries) for key, entries in found if entries]

    @property
    def counts(self) -> list[tuple[str, int]]:
        """How many claims have which verdict."""
        counted = Counter(entry.kind for entry in self.entries)
        return [(kind, counted[kind]) for kind in KINDS if counted[kind]]

    def heading(self, key: str) -> str:
        """What a group of claims is of."""
        if key in self.papers:
            return self.papers[key].title
        return key or "Claims of the studies"

    def thumbnail(self, name: str) -> dict[str, Any] | None:
        """The first figure of a study, if it has one that can be shown."""
        manifest = self.studies[name]
        if not manifest["figures"] or manifest["error"]:
            return None
        figure = manifest["figures"][0]
        return {**figure, **_size(self.folder / name / figure["svg"])}

    def table(self, study: str, name: str) -> list[dict[str, str]]:
        """The rows of a table of a study; none where it is not there."""
        manifest = self.studies.get(study)
        if manifest is None or name not in [item["name"] for item in manifest["tables"]]:
            return []
        with (self.folder / study / f"{name}.csv").open(encoding="utf-8", newline="") as file:
            return list(csv.DictReader(file))

    def claims_of(self, model: str) -> list[_Entry]:
        """Claims in whose words a model is."""
        found = []
        for entry in self.entries:
            texts = [entry.says, *entry.explanations]
            for part in entry.parts:
                texts += [part["statement"], part["quantity"], part["reading"]]
            if model in _named(" ".join(texts), ()):
                found.append(entry)
        return found

    def _entry(self, row: Row) -> _Entry:
        parts = [self._part(part) for part in row.parts]
        own = (row.id, row.paper, row.says, row.where, row.verdict, row.why, row.pending)
        return _Entry(*own, parts, row.explanations, row.seconds)

    def _part(self, part: Mapping[str, Any]) -> dict[str, Any]:
        """A measurement with the files that show it; the first ones unless the study named some."""
        manifest = self.studies.get(part["study"])
        files = {"title": part["study"], "seconds": None, "figure_name": "", "csv": ""}
        if manifest is not None:
            figures = [item["name"] for item in manifest["figures"]]
            tables = [item["name"] for item in manifest["tables"]]
            files |= {
                "title": manifest["study"]["title"],
                "seconds": manifest["seconds"],
                "figure_name": part["figure"]
                if part["figure"] in figures
                else "".join(figures[:1]),
                "csv": part["table"] if part["table"] in tables else "".join(tables[:1]),
            }
        return {**part, **files}

    def _unlisted(self, rows: Sequence[Row]) -> list[_Entry]:
        """Claims that studies measure and no row is about."""
        known = {row.id for row in rows}
        found: dict[str, list[dict[str, Any]]] = {}
        why: dict[str, list[str]] = {}
        for name, manifest in self.studies.items():
            for claim in manifest["claims"]:
                if claim["id"] not in known:
                    found.setdefault(claim["id"], []).append({**claim, "study": name})
            for id, texts in manifest["explanations"].items():
                why.setdefault(id, []).extend(texts)
        entries = []
        for id, parts in found.items():
            kinds = list(dict.fromkeys(_kind(part["verdict"]) for part in parts))
            says = list(dict.fromkeys(part["statement"] for part in parts))
            seconds = sum(self.studies[name]["seconds"] for name in {p["study"] for p in parts})
            verdict = kinds[0] if len(kinds) == 1 else "undecided: " + ", ".join(kinds)
            own = (id, "", says[0], "", verdict, "", "", [self._part(part) for part in parts])
            entries.append(_Entry(*own, tuple(why.get(id, ())), seconds))
        return entries

    def _words(self, manifest: Mapping[str, Any]) -> tuple[str, set[str]]:
        """What a study says in sentences, and the words of its tables."""
        study = manifest["study"]
        texts = [study["title"], study["question"], *study["background"], *manifest["notes"]]
        texts += [item["caption"] for item in (*manifest["figures"], *manifest["tables"])]
        texts += [claim["statement"] for claim in manifest["claims"]]
        words: set[str] = set()
        for table in manifest["tables"]:
            path = self.folder / study["name"] / table["file"]
            if path.is_file():
                words |= set(_WORD.findall(path.read_text(encoding="utf-8")))
        return " ".join(texts), {word.removesuffix("_error") for word in words}


# What models are called -----------------------------------------------------------------------

_WORD = re.compile(r"[a-z][a-z0-9_]+")

# Names in sentences that are not made of the name in the registry, or are of no model at all.
_SPOKEN: dict[str, tuple[str, ...]] = {
    "Blinn-Phong": ("blinn",),
    "anisotropic Phong": (),
    "Schlick's approximation": (),
    "Schlick's Fresnel": (),
    "Schwenk's survey": (),
    "Schwenk eq": (),
    "Schwenk sect": (),
    "Lambertian": ("lambert",),
    "EON": ("eon",),
}


@cache
def _spoken() -> tuple[re.Pattern[str], dict[str, tuple[str, ...]]]:
    """A pattern that finds models in sentences, and the models by what it finds."""
    from albedo.catalogue import names

    known = {key.lower(): value for key, value in _SPOKEN.items()}
    for name in names():
        for joint in ("_", "-", " "):
            known.setdefault(name.replace("_", joint), (name,))
    longest = sorted(known, key=len, reverse=True)
    pattern = "|".join(re.escape(word) for word in longest)
    return re.compile(rf"(?<![\w-])(?:{pattern})(?![\w-])", re.IGNORECASE), known


def _named(text: str, words: Iterable[str]) -> list[str]:
    """The models that a text, or one of some words, names."""
    from albedo.catalogue import names

    pattern, known = _spoken()
    found = {name for hit in pattern.findall(text) for name in known[hit.lower()]}
    found |= set(words) & set(names())
    return sorted(found)


# Pages ----------------------------------------------------------------------------------------


def _summary(site: _Site, name: str, kind: type[Model]) -> dict[str, Any]:
    """A model in one line."""
    from albedo.describe import promises

    said = {key: text.split(":")[0] for key, text in promises(kind).items()}
    short = {key: "depends" if text.startswith("depends") else text for key, text in said.items()}
    return {
        "name": name,
        "title": kind.title,
        "equation": kind.equation,
        "reciprocal": short["reciprocal"],
        "conserves": short["conserves energy"],
        "largest": _found(site, name, "energy", "largest"),
        "ns": _nanoseconds(name),
    }


def _about_paper(site: _Site, paper: Paper) -> dict[str, Any]:
    """The figures of a paper with the studies that reproduce them, and the other studies."""
    ids = {claim.id for claim in paper.claims}
    about = {
        name: manifest
        for name, manifest in site.studies.items()
        if _is_about(manifest, paper) or ids & set(manifest["study"]["claims"])
    }
    figures, shown = [], set()
    for figure in paper.figures:
        wanted = set(_numbers(figure.number))
        own = [
            name
            for name, manifest in about.items()
            if _is_about(manifest, paper) and wanted & set(_numbers(manifest["study"]["figure"]))
        ]
        shown |= set(own)
        figures.append({"figure": figure, "studies": own})
    entries = [entry for entry in site.entries if entry.paper == paper.key or entry.id in ids]
    others = [name for name in about if name not in shown]
    return {"figures": figures, "others": others, "entries": entries}


def _is_about(manifest: Mapping[str, Any], paper: Paper) -> bool:
    said = manifest["study"]["paper"]
    return paper.key in re.split(r"[\s,;]+", said) or paper.title in said


def _numbers(text: str) -> list[str]:
    """The numbers of figures in a text such as ``Figures 5 and 6``, or ``Section 4.2, Fig. 3``."""
    after = re.split(r"\bfig(?:ures?|s)?\b", text, flags=re.IGNORECASE)[-1]
    return re.findall(r"\d+[a-z]?\b", after)


def _about_model(site: _Site, name: str, kind: type[Model]) -> dict[str, Any]:
    """What is known of a model."""
    from albedo.describe import promises, reference

    figure = f"{name}_figure"
    manifest = site.studies.get(_PAGES)
    figures = [] if manifest is None else manifest["figures"]
    drawn = next((item for item in figures if item["name"] == figure), None)
    if drawn is not None:
        drawn = {**drawn, **_size(site.folder / _PAGES / drawn["svg"])}
    return {
        "name": name,
        "kind": kind,
        "formula": _paragraphs(inspect.getdoc(kind) or ""),
        "references": [reference(key) for key in kind.references],
        "parameters": [_parameter(item) for item in kind.parameter_info()],
        "promises": _kept(site, name, promises(kind)),
        "figure": drawn,
        "pages": _PAGES,
        "costs": _costs(name),
        "digits": _digits(site, name),
        "studies": [study for study, models in site.models_of.items() if name in models],
        "entries": site.claims_of(name),
    }


def _parameter(item: Any) -> dict[str, str]:
    from albedo.grammar import format_value as written

    return {
        "name": item.name,
        "default": "" if item.default is None else written(item.default),
        "allowed": item.range_text,
        "unit": "" if item.unit == "1" else item.unit,
        "meaning": item.doc,
    }


def _row(site: _Site, study: str, table: str, model: str) -> dict[str, str] | None:
    return next((row for row in site.table(study, table) if row.get("model") == model), None)


def _found(site: _Site, model: str, table: str, column: str) -> str:
    """A number of a table of promises, with its error."""
    row = _row(site, _PAGES, table, model)
    if row is None:
        return ""
    if f"{column}_error" in row:
        return format_value(float(row[column]), float(row[f"{column}_error"]))
    return f"{float(row[column]):.1e}"


_PROMISES = (
    ("reciprocal", "reciprocity", "asymmetry", "largest relative difference"),
    ("conserves energy", "energy", "largest", "largest albedo"),
    (
        "finite at grazing incidence",
        "horizon",
        "growth",
        "albedo at cos θ = 1e-9 over that at 1e-6",
    ),
)


def _kept(site: _Site, name: str, said: Mapping[str, str]) -> list[dict[str, str]]:
    """Promises, what was measured of each, and whether it was kept."""
    found = []
    for promise, table, column, quantity in _PROMISES:
        row = _row(site, _PAGES, table, name)
        measured = _found(site, name, table, column)
        if row is not None and table == "energy":
            quantity += f", at {row['at']}, cos θ = {float(row['cos_theta']):.4g}"
        if row is not None and row["promised"] not in ("yes", "no"):
            quantity += f"; {row['promised']} promise it"
            if table == "energy":
                quantity += f", with at most {_found(site, name, table, 'of_promises')}"
            else:
                quantity += ", and are measured"
        kept = "" if row is None else row["kept"]
        found.append(
            {
                "promise": promise,
                "said": said[promise],
                "measured": measured,
                "quantity": quantity if measured else "",
                "kept": kept,
                "tone": {"yes": "good", "no": "bad", "within the bound": "open"}.get(kept, "none"),
            }
        )
    isotropic = {"promise": "isotropic", "said": said["isotropic"]}
    rest = dict.fromkeys(("measured", "quantity", "kept"), "") | {"tone": "none"}
    return [*found, isotropic | rest]


_WAYS = {
    "pairs": "random pairs",
    "lobe": "views drawn from the lobe",
    "raw": "random pairs, half vector formed first",
    "shared": "64 views of each light",
}


@cache
def _all_costs() -> pd.DataFrame:
    from albedo.analysis.kernel_cost import committed

    return committed()


def _costs(name: str) -> dict[str, Any]:
    frame = _all_costs()
    own = frame[frame["model"] == name]
    rows = [
        {
            "precision": row["precision"],
            "way": _WAYS.get(row["way"], row["way"]),
            "ns": f"{row['ns']:.3g}",
            "ratio": f"{row['ratio']:.3g}",
            "spread": f"{row['ratio_low']:.3g} to {row['ratio_high']:.3g}",
        }
        for row in own.to_dict("records")
    ]
    return {"rows": rows, **{key: frame.attrs[key] for key in ("processor", "versions")}}


def _nanoseconds(name: str) -> str:
    frame = _all_costs()
    own = frame[(frame["model"] == name) & (frame["precision"] == "float64")]
    own = own[own["way"] == "pairs"]
    return f"{own['ns'].iloc[0]:.3g}" if len(own) else ""


def _digits(site: _Site, name: str) -> list[dict[str, str]]:
    """Right digits of values and albedos, from the studies of stability."""
    ways = {
        (_VALUES, "float64"): "values, half vector known",
        (_VALUES, "raw"): "values, from light and view",
        (_VALUES, "float32"): "values in float32",
        (_DIGITS, "default"): "albedos, default tolerance",
        (_DIGITS, "fine"): "albedos, tolerance 1e-12",
        (_DIGITS, "float32"): "albedos of values in float32",
    }
    found = []
    for study in (_VALUES, _DIGITS):
        for row in site.table(study, "models"):
            label = ways.get((study, row["way"]))
            if row["model"] == name and label is not None:
                where = f"cos θ = {float(row['cos_theta']):.4g}"
                if row.get("place"):
                    where = f"{row['place']}, {where}"
                found.append(
                    {
                        "what": label,
                        "worst": f"{float(row['worst']):.1f}",
                        "median": f"{float(row['median']):.1f}",
                        "lost": f"{float(row['lost']):.1f}",
                        "where": where,
                        "study": study,
                    }
                )
    return found


def _paragraphs(text: str) -> list[dict[str, Any]]:
    """A docstring as paragraphs and lists, each of pieces of text and code."""
    found: list[dict[str, Any]] = []
    for block in re.split(r"\n\s*\n", text):
        head, *items = re.split(r"^\s*- ", block, flags=re.MULTILINE)
        if head.strip():
            found.append({"text": _pieces(head)})
        if items:
            found.append({"items": [_pieces(item) for item in items]})
    return found


def _pieces(text: str) -> list[tuple[bool, str]]:
    """Text and code in turn, the code marked."""
    parts = re.split(r"``(.+?)``|`(.+?)`", " ".join(text.split()))
    found = []
    for k in range(0, len(parts), 3):
        found.append((False, parts[k]))
        if k + 2 < len(parts):
            found.append((True, parts[k + 1] or parts[k + 2]))
    return [(code, piece) for code, piece in found if piece]


# Pieces of pages ------------------------------------------------------------------------------


def _excerpt(frame: pd.DataFrame, most: int) -> dict[str, Any]:
    """Rows and columns as a page shows them: a value and its error become one column."""
    import numpy as np

    count = len(frame)
    picked = np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))
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
        # What does not apply to a row is left empty.
        blank = ["" if cell in ("nan", "not a number") else cell for cell in cells]
        columns.append({"name": name, "cells": blank, "numeric": frame[name].dtype.kind in "iuf"})
    rows = list(zip(*(column["cells"] for column in columns), strict=True))
    return {"columns": columns, "rows": rows, "count": count, "shown": len(picked)}


def _size(svg: Path) -> dict[str, int | None]:
    """Width and height of a picture, so that a page does not jump while it loads."""
    if svg.is_file():
        head = svg.read_text(encoding="utf-8", errors="replace")[:2000]
        if found := re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', head):
            return {"width": round(float(found[1])), "height": round(float(found[2]))}
    return {"width": None, "height": None}


def _seconds(value: float) -> str:
    # Number and unit stay on one line.
    if value < 1:
        return f"{value * 1000:.0f}\N{NO-BREAK SPACE}ms"
    if value < 100:
        return f"{value:.1f}\N{NO-BREAK SPACE}s"
    return f"{value / 60:.1f}\N{NO-BREAK SPACE}min"


def _kind(verdict: str) -> str:
    """What a verdict starts with; something unheard-of stands for itself."""
    fitting = [kind for kind in KINDS if verdict.startswith(kind)]
    return max(fitting, key=len, default=verdict)


def _rest(verdict: str) -> str:
    """What a verdict says beyond its kind."""
    return verdict.removeprefix(_kind(verdict)).lstrip(" :,")


def _tone(verdict: str) -> str:
    """CSS class of a verdict."""
    return _LOOKS.get(_kind(verdict), ("open", ""))[0]


def _sign(verdict: str) -> str:
    """A sign for a verdict, beside its colour."""
    return _LOOKS.get(_kind(verdict), ("open", "?"))[1]


def _verdicts(claims: list[dict[str, Any]]) -> list[tuple[str, str, int]]:
    """Claims with their verdicts, without the numbers, and how often each is there."""
    counted = Counter((claim["id"], _kind(claim["verdict"])) for claim in claims)
    return [(id, verdict, count) for (id, verdict), count in counted.items()]


def _page(template: str, **values: Any) -> str:
    return _environment().get_template(template).render(**values)


@cache
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
    environment.filters["sign"] = _sign
    environment.filters["kind"] = _kind
    environment.filters["rest"] = _rest
    environment.filters["verdicts"] = _verdicts
    return environment


def _source(name: str) -> str:
    """Text of a file of the templates."""
    return (Path(__file__).parent / "templates" / name).read_text(encoding="utf-8")
