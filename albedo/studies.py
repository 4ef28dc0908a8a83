"""Studies: one file, one question, and everything that its answer rests on kept beside it.

A study is a Python file in a folder (by custom ``studies/``) whose name does not start with an
underscore. Its docstring is the question, ``STUDY`` says what it reproduces, and ``run(context)``
computes and hands tables, figures and measured claims to the context:

    \"\"\"Does the albedo of Ward's model stay below one?\"\"\"

    from albedo.studies import Study

    STUDY = Study(name="ward_energy", title="Ward's albedo at grazing angles", claims=("N3",))

    def run(context):
        ...
        context.claim("N3", "Ward's albedo diverges", value=top, error=bound, criterion="> 1")

The results of a study are one folder that appears only when the study is finished, with a
``manifest.json`` of what went in and what came out. Equal inputs give equal manifests, but for
the seconds that it took.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
import sys
import time
import traceback
import types
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from albedo.errors import InputError
from albedo.files import atomic_folder, make_folder, save_csv, save_json, save_text
from albedo.sources import digest, used, versions

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

__all__ = [
    "Context",
    "Criterion",
    "Result",
    "Study",
    "StudyFile",
    "compare",
    "discover",
    "lost_study",
    "run_study",
    "write_skeleton",
]

VERDICTS = ("holds", "holds within", "fails", "depends on the reading", "undecided")

Progress = Callable[[int, int, str], None]
Alone = Callable[[], AbstractContextManager[object]]

_NAME = re.compile(r"[a-z][a-z0-9_]*\Z")
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_COMPARISON = re.compile(rf"(<=|>=|<|>)\s*({_NUMBER})\Z")
_EQUALITY = re.compile(rf"=\s*({_NUMBER})\s*\+-\s*({_NUMBER})\Z")


@dataclass(frozen=True)
class Study:
    """What a study file declares about itself.

    Attributes
    ----------
    name : str
        The name of its file, without the ending.
    title : str
        One line for a heading.
    paper : str
        The paper it is about: its key in ``papers.toml`` beside the study, or as a reader would
        cite it.
    figure : str
        The figure of that paper that it reproduces, if any.
    claims : tuple of str
        Identifiers of the claims that it measures; each has to be measured when it runs.
    """

    name: str
    title: str
    paper: str = ""
    figure: str = ""
    claims: tuple[str, ...] = ()


@dataclass(frozen=True)
class Criterion:
    """How a measured value and its error become a verdict.

    Attributes
    ----------
    text : str
        The criterion in words or signs, printed beside the verdict.
    judge : callable
        ``judge(value, error)`` gives the verdict: one of `VERDICTS`, alone or followed by the
        numbers that it rests on.
    """

    text: str
    judge: Callable[[float, float], str]


def compare(text: str) -> Criterion:
    """Make a criterion from a comparison; the error of the value counts against certainty.

    Parameters
    ----------
    text : str
        ``"< 1"``, ``"<= 1"``, ``"> 1"``, ``">= 1"``, or ``"= 0.68 +- 0.01"``.

    Returns
    -------
    Criterion
        Its verdict is ``holds`` or ``fails`` where the whole interval value +- error agrees, and
        ``undecided`` where the interval reaches across the limit.
    """
    if matched := _COMPARISON.match(text.strip()):
        sign, limit = matched[1], float(matched[2])

        def judge(value: float, error: float) -> str:
            low, high = value - error, value + error
            if sign in ("<", "<="):
                sure = high < limit if sign == "<" else high <= limit
                never = low >= limit if sign == "<" else low > limit
            else:
                sure = low > limit if sign == ">" else low >= limit
                never = high <= limit if sign == ">" else high < limit
            return _verdict(sure, never)

        return Criterion(f"{sign} {matched[2]}", judge)
    if matched := _EQUALITY.match(text.strip()):
        target, width = float(matched[1]), float(matched[2])

        def judge_near(value: float, error: float) -> str:
            distance = abs(value - target)
            return _verdict(distance + error <= width, distance - error > width)

        return Criterion(f"= {matched[1]} ± {matched[2]}", judge_near)
    raise InputError(
        f"{text!r} is not a criterion; write a comparison such as '< 1', '>= 0.5' or "
        "'= 0.68 +- 0.01'."
    )


def _verdict(sure: bool, never: bool) -> str:
    if sure:
        return "holds"
    return "fails" if never else "undecided: the error bound reaches across the limit"


@dataclass
class Context:
    """What a running study hands its results to.

    Attributes
    ----------
    full : bool
        Whether the study shall run at full fidelity, which may take long; otherwise it shall
        give the same kind of answer within seconds.
    pictures : bool
        Whether figures are drawn; otherwise they are on record only.
    """

    study: Study
    folder: Path
    full: bool
    pictures: bool = True
    _progress: Progress | None = None
    _alone: Alone | None = None
    _waited: float = 0.0
    _notes: list[str] = field(default_factory=list)
    _tables: list[dict[str, Any]] = field(default_factory=list)
    _figures: list[dict[str, Any]] = field(default_factory=list)
    _claims: list[dict[str, Any]] = field(default_factory=list)
    _explained: dict[str, list[str]] = field(default_factory=dict)
    _settings: dict[str, Any] = field(default_factory=dict)

    def table(
        self,
        name: str,
        frame: pd.DataFrame,
        caption: str = "",
        *,
        machine: Sequence[str] = (),
        loose: Mapping[str, float] | None = None,
        digits: Mapping[str, int] | None = None,
    ) -> None:
        """Keep a table as CSV, every float in the shortest form that reads back exactly.

        Of a value ``x`` with an error ``x_error``, digits are kept down to a hundredth of the
        error's first, and six in any case; what is cut off is added to the error, and that is
        rounded up to three digits. So are columns that are `loose`, to a thousandth of how far
        they may differ; those that depend on the machine have four digits.

        Where a column ``x`` has a companion ``x_error``, the report prints the two as one number
        with its uncertainty, and it leaves out ``x_evaluations``; the CSV has them all.

        Parameters
        ----------
        name : str
            File name without an ending.
        frame : pandas.DataFrame
            The rows.
        caption : str
            What the table shows.
        machine : sequence of str
            Columns that depend on the machine, such as times: no check compares their values.
        loose : mapping of str to float, optional
            Columns without errors of their own, and how far two runs may differ, absolutely;
            what is not named has to agree to nine digits.
        digits : mapping of str to int, optional
            Columns without errors of their own that are for drawing or reading and need not be
            exact, and how many digits of them are kept.
        """
        self._claim_name(name)
        loose, digits = dict(loose or {}), dict(digits or {})
        named = (*machine, *loose, *digits)
        unknown = [column for column in named if column not in frame.columns]
        if unknown:
            raise InputError(f"The table '{name}' has no column {', '.join(unknown)}.")
        kept = dict.fromkeys(machine, _MACHINE_DIGITS) | digits
        save_csv(_rounded(frame, loose, kept), self.folder / f"{name}.csv")
        self._tables.append(
            {
                "name": name,
                "file": f"{name}.csv",
                "caption": caption,
                "machine": list(machine),
                "loose": loose,
                "digits": digits,
            }
        )

    def figure(self, name: str, figure: Figure, caption: str = "") -> None:
        """Keep a figure as SVG and PNG.

        Parameters
        ----------
        name : str
            File name without an ending.
        figure : Figure
            The figure.
        caption : str
            What the figure shows.
        """
        from albedo.plotting import save_for_site

        self._claim_name(name)
        if self.pictures:
            save_for_site(figure, self.folder / name, small=self.full)
        self._figures.append(
            {"name": name, "svg": f"{name}.svg", "png": f"{name}.png", "caption": caption}
        )

    def claim(
        self,
        id: str,
        statement: str,
        value: float,
        error: float,
        criterion: str | Criterion,
        quantity: str = "",
        kind: str = "bound",
        *,
        reading: str = "",
        figure: str = "",
        table: str = "",
        machine: bool = False,
    ) -> str:
        """Record a measured claim; the verdict comes from the number and the criterion alone.

        Parameters
        ----------
        id : str
            Identifier of the claim, one of those that the study declares.
        statement : str
            What is claimed, in one sentence.
        value, error : float
            What was measured, and its error.
        criterion : str or Criterion
            A comparison as `compare` reads it, or a criterion of one's own.
        quantity : str
            What the number is, where the statement does not say it.
        kind : str
            ``"bound"`` or ``"standard_error"``.
        reading : str
            In which of its readings, where the paper's words can be read in several: where those
            have different verdicts, that of the claim depends on the reading.
        figure, table : str
            Names of the figure and the table of this study that show it; its first ones unless
            given.
        machine : bool
            Whether the value depends on the machine, as times do: a check compares verdicts only.

        Returns
        -------
        str
            The verdict.
        """
        if id not in self.study.claims:
            declared = ", ".join(self.study.claims) or "none"
            raise InputError(
                f"Study '{self.study.name}' measures the claim '{id}' without declaring it; it "
                f"declares {declared}."
            )
        value, error = float(value), float(error)
        if math.isnan(value) or not error >= 0.0:
            raise InputError(
                f"The claim '{id}' was measured as {value} with the error {error}; it needs a "
                "number and an error that is not negative."
            )
        rule = compare(criterion) if isinstance(criterion, str) else criterion
        verdict = rule.judge(value, error)
        if not any(verdict.startswith(known) for known in VERDICTS):
            raise InputError(
                f"The criterion '{rule.text}' gives the verdict {verdict!r}; a verdict starts "
                f"with one of {', '.join(VERDICTS)}."
            )
        self._claims.append(
            {
                "id": id,
                "statement": statement,
                "quantity": quantity,
                "value": value,
                "error": error,
                "kind": kind,
                "criterion": rule.text,
                "verdict": verdict,
                "reading": reading,
                "figure": figure,
                "table": table,
                "machine": machine,
            }
        )
        return verdict

    def explain(self, id: str, text: str) -> None:
        """Say why a claim fails or depends on the reading, with the mathematics.

        The ledger shows it where the claim does not simply hold.

        Parameters
        ----------
        id : str
            Identifier of a claim that the study declares.
        text : str
            One paragraph of plain text, such that the authors of the paper would find it fair.
            Numbers in it should come from what was computed.
        """
        if id not in self.study.claims:
            raise InputError(f"Study '{self.study.name}' explains the claim '{id}', not its own.")
        self._explained.setdefault(id, []).append(text)

    def setting(self, **values: float | int | str | bool) -> None:
        """Put on record what the results depend on: tolerances, seeds, numbers of samples.

        Parameters
        ----------
        **values : float, int, str or bool
            Each under its name.
        """
        self._settings |= values

    def note(self, text: str) -> None:
        """Add a paragraph to the page of the study.

        Parameters
        ----------
        text : str
            Plain text. Numbers in it should come from what was computed.
        """
        self._notes.append(text)

    def progress(self, done: int, total: int, text: str = "") -> None:
        """Say how far the study is.

        Parameters
        ----------
        done, total : int
            Steps done, and steps in all.
        text : str
            What is being done.
        """
        if self._progress is not None:
            self._progress(done, total, text)

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Take times inside of this: it waits until no other study runs, and none begins.

        What can be done before, such as to call once what is timed, belongs before it: the
        others run meanwhile.

        Yields
        ------
        None
        """
        ask, began = self._alone, time.perf_counter()
        if ask is None:
            yield
            return
        # Inside, nobody has to be asked again.
        self._alone = None
        try:
            with ask():
                self._waited += time.perf_counter() - began
                yield
        finally:
            self._alone = ask

    def _claim_name(self, name: str) -> None:
        taken = [item["name"] for item in (*self._tables, *self._figures)]
        if not _NAME.match(name) or name in ("index", "manifest"):
            raise InputError(
                f"'{name}' cannot name a table or figure; use small letters, digits and "
                "underscores, and neither 'index' nor 'manifest'."
            )
        if name in taken:
            raise InputError(f"Study '{self.study.name}' gives two tables or figures as '{name}'.")


@dataclass(frozen=True)
class StudyFile:
    """A study on disk: found by its name, read when it is needed."""

    path: Path

    @property
    def name(self) -> str:
        """Name of the study, which is that of its file."""
        return self.path.stem

    def unchanged(self, results: Path, full: bool, pictures: bool = True) -> dict[str, Any] | None:
        """The record of former results, if running the study again would give the same.

        Parameters
        ----------
        results : Path
            The folder of its results.
        full : bool
            The fidelity that is wanted.
        pictures : bool
            Whether drawn figures are.

        Returns
        -------
        dict or None
            The manifest; None if there is none, if the study failed, or if anything changed: the
            files that it read, the versions that it ran with, the fidelity, or its own files.
            Where no pictures are wanted, those that are there do not matter.
        """
        try:
            manifest = json.loads((results / "manifest.json").read_text(encoding="utf-8"))
            inputs, outputs = manifest["inputs"], manifest["outputs"]
            wanted = {"fidelity": "full" if full else "quick", "error": None}
            if any(manifest[key] != value for key, value in wanted.items()):
                return None
            now = versions()
            if any(inputs[key] != value for key, value in now.items()):
                return None
            if inputs["sources_sha256"] != digest(inputs["sources"], self.path.parent):
                return None
            drawn = {figure[kind] for figure in manifest["figures"] for kind in ("svg", "png")}
            if pictures and not drawn <= outputs.keys():
                return None
            for name in outputs.keys() - (set() if pictures else drawn):
                sha = outputs[name]
                if hashlib.sha256((results / name).read_bytes()).hexdigest() != sha:
                    return None
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            # What is no record of this version is no record.
            return None
        found: dict[str, Any] = manifest
        return found

    def try_load(self) -> tuple[LoadedStudy | None, str]:
        """Read the file, whatever is wrong with it.

        Returns
        -------
        loaded : LoadedStudy or None
            What it declares, if it can be read.
        error : str
            What is wrong with it otherwise.
        """
        with _Caught() as caught, beside(self.path.parent):
            return self.load(), ""
        return None, f"{type(caught.error).__name__}: {caught.error}"

    def load(self) -> LoadedStudy:
        """Read and execute the file.

        Returns
        -------
        LoadedStudy
            What it declares.

        Raises
        ------
        InputError
            If it does not declare what a study has to.
        """
        source = self.path.read_bytes()
        module = types.ModuleType(f"albedo_study_{self.name}")
        module.__file__ = str(self.path)
        # Dataclasses look their module up by name.
        sys.modules[module.__name__] = module
        # The bytes that are hashed are the bytes that run: no cached bytecode in between.
        code = compile(source, str(self.path), "exec", dont_inherit=True)
        exec(code, module.__dict__)
        study, run = getattr(module, "STUDY", None), getattr(module, "run", None)
        question, *background = [
            " ".join(paragraph.split()) for paragraph in (module.__doc__ or "").split("\n\n")
        ]
        if not isinstance(study, Study) or not callable(run) or not question:
            raise InputError(
                f"'{self.path.name}' is not a study; it needs a docstring with its question, "
                "STUDY = Study(...) and run(context)."
            )
        if study.name != self.name:
            raise InputError(
                f"The study in '{self.path.name}' calls itself '{study.name}'; its name must be "
                f"'{self.name}', the name of its file."
            )
        return LoadedStudy(
            study=study,
            question=question,
            background=tuple(background),
            run=run,
            source_sha256=hashlib.sha256(source).hexdigest(),
        )


@dataclass(frozen=True)
class LoadedStudy:
    """A study file that was read: its declaration, its question and its code."""

    study: Study
    question: str
    background: tuple[str, ...]
    run: Callable[[Context], None]
    source_sha256: str


@dataclass(frozen=True)
class Result:
    """How a study went, as its manifest has it.

    Attributes
    ----------
    name : str
        Name of the study.
    folder : Path or None
        Where its results are; None when it failed and nothing was kept.
    manifest : dict
        Inputs, outputs, claims and notes; ``manifest["error"]`` says why it failed, if it did.
    """

    name: str
    folder: Path | None
    manifest: dict[str, Any]

    @property
    def failed(self) -> bool:
        """Whether the study stopped with an error. A claim that fails is not one."""
        return self.manifest["error"] is not None


def discover(folder: Path | None = None) -> list[StudyFile]:
    """Find the studies in a folder: every Python file whose name has no leading underscore.

    Parameters
    ----------
    folder : Path, optional
        Where to look; ``./studies`` by default.

    Returns
    -------
    list of StudyFile
        The studies, sorted by name.

    Raises
    ------
    InputError
        If the folder is missing or holds no study.
    """
    place = Path("studies") if folder is None else folder
    shown = "./studies" if folder is None else str(folder)
    if not place.is_dir():
        raise InputError(
            f"There is no folder '{shown}' of studies; run this in a folder that has ./studies, "
            "or name one with --studies-dir."
        )
    found = sorted(path for path in place.glob("*.py") if not path.name.startswith("_"))
    if not found:
        raise InputError(
            f"The folder '{shown}' holds no study: no Python file whose name has no leading "
            "underscore; run this in a folder that has ./studies, or name one with --studies-dir."
        )
    return [StudyFile(path) for path in found]


# Of times, the fourth digit is noise; of what is known to an error, digits that nobody doubts.
_MACHINE_DIGITS, _SURE_DIGITS = 4, 6


def _rounded(
    frame: pd.DataFrame, loose: Mapping[str, float], digits: Mapping[str, int]
) -> pd.DataFrame:
    """The table without digits that say nothing; no error is smaller than it was."""
    columns: dict[str, list[float]] = {}
    for name in frame.columns:
        if frame[name].dtype.kind != "f":
            continue
        values = [float(value) for value in frame[name]]
        if f"{name}_error" in frame.columns:
            errors = [float(error) for error in frame[f"{name}_error"]]
            kept = [_cut(v, 1e-2 * e) for v, e in zip(values, errors, strict=True)]
            off = [_upper(e, abs(v - k)) for v, k, e in zip(values, kept, errors, strict=True)]
            columns |= {name: kept, f"{name}_error": [_rounded_up(error) for error in off]}
        elif name in digits:
            columns[name] = [_to_digits(value, digits[name]) for value in values]
        elif name in loose:
            columns[name] = [_cut(value, 1e-3 * loose[name]) for value in values]
    return frame.assign(**columns) if columns else frame


def _upper(error: float, more: float) -> float:
    """An upper bound of a sum."""
    return math.nextafter(error + more, math.inf) if more > 0.0 else error


def _to_digits(value: float, digits: int) -> float:
    return float(f"{value:.{digits - 1}e}") if math.isfinite(value) else value


def _cut(value: float, size: float) -> float:
    """A value to decimals of a size or somewhat less, and to some digits in any case."""
    if not (0.0 < size < math.inf and math.isfinite(value)) or value == 0.0:
        return value
    decimals = -math.floor(math.log10(size))
    least = _SURE_DIGITS - 1 - math.floor(math.log10(abs(value)))
    return round(value, max(decimals, least))


def _rounded_up(error: float) -> float:
    """An error with three digits, not smaller than it was."""
    if not 0.0 < error < math.inf:
        return error
    rounded = float(f"{error:.2e}")
    # The next number of three digits is a hundredth of the leading digit away.
    if rounded < error:
        rounded = float(f"{error + 10.0 ** (math.floor(math.log10(error)) - 2):.2e}")
    return max(rounded, error) if math.isfinite(rounded) else error


def write_skeleton(name: str, folder: Path | None = None) -> Path:
    """Write a study that runs, to be changed into one's own.

    Parameters
    ----------
    name : str
        Of the study and its file.
    folder : Path, optional
        Of studies, ``./studies`` by default; created when missing.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        If the name cannot be one, or is taken.
    """
    if not _NAME.match(name):
        raise InputError(
            f"'{name}' cannot name a study; use small letters, digits and underscores, with a "
            "letter first."
        )
    path = (Path("studies") if folder is None else folder) / f"{name}.py"
    if path.exists():
        raise InputError(f"The study '{path}' is there already; name another one.")
    source = Path(__file__).parent / "templates" / "study.py.txt"
    make_folder(path.parent)
    save_text(source.read_text(encoding="utf-8").replace("@NAME@", name), path)
    return path


@contextmanager
def beside(folder: Path) -> Iterator[None]:
    """Let a study import the modules that lie in its folder."""
    place, writes = str(folder.resolve()), sys.dont_write_bytecode
    sys.path.insert(0, place)
    # Bytecode tells an edit by its second: what runs could be older than what is hashed.
    sys.dont_write_bytecode = True
    try:
        yield
    finally:
        sys.path.remove(place)
        sys.dont_write_bytecode = writes


class _Caught:
    """Keep what went wrong inside the block; an interruption goes through."""

    error: Exception | SystemExit | None = None

    def __enter__(self) -> _Caught:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: object
    ) -> bool:
        # A study is foreign code and may raise anything; its error is shown, not lost.
        if isinstance(error, Exception | SystemExit):
            self.error = error
            return True
        return False


def run_study(
    file: StudyFile,
    out: Path,
    *,
    full: bool = False,
    pictures: bool = True,
    progress: Progress | None = None,
    alone: Alone | None = None,
    keep_failure: bool = False,
) -> Result:
    """Run one study and keep its results, complete or not at all.

    Parameters
    ----------
    file : StudyFile
        The study.
    out : Path
        Folder in which the folder of this study's results is put.
    full : bool
        Full fidelity instead of quick.
    pictures : bool
        Whether figures are drawn.
    progress : callable, optional
        Called with steps done, steps in all and a text.
    alone : callable, optional
        Gives what the study enters while it takes times, and which waits until it is alone.
    keep_failure : bool
        Put the record of a failure in the place of former results; otherwise these stay.

    Returns
    -------
    Result
        The manifest and where it is.

    Raises
    ------
    InputError
        If the place of the results is taken by something else.
    """
    target = out / file.name
    check_place(target)
    began = time.perf_counter()
    result: Result | None = None
    with suppress(_Dropped), atomic_folder(target) as folder:
        study = Study(name=file.name, title=file.name)
        question, source_sha256 = "", ""
        background: tuple[str, ...] = ()
        context = Context(study, folder, full, pictures, _progress=progress, _alone=alone)
        with (
            _Caught() as caught,
            beside(file.path.parent),
            warnings.catch_warnings(record=True) as warned,
        ):
            warnings.simplefilter("always")
            loaded = file.load()
            question, background = loaded.question, loaded.background
            source_sha256 = loaded.source_sha256
            context.study = loaded.study
            loaded.run(context)
            missing = [id for id in loaded.study.claims if id not in _measured(context)]
            if missing:
                raise InputError(
                    f"Study '{file.name}' declares the claim {', '.join(missing)} and does not "
                    "measure it."
                )
        sources = used(file.path.parent)
        manifest = _record(
            *(context, file, full, sources, time.perf_counter() - began - context._waited),
            question=question,
            background=list(background),
            source_sha256=source_sha256,
            error=None if caught.error is None else _describe(caught.error, file.path),
            warned=sorted({f"{w.category.__name__}: {w.message}" for w in warned}),
        )
        kept = caught.error is None or keep_failure
        result = Result(file.name, target if kept else None, manifest)
        if not kept:
            raise _Dropped
        save_json(manifest, folder / "manifest.json")
    assert result is not None
    return result


def _record(
    context: Context,
    file: StudyFile,
    full: bool,
    sources: Sequence[str],
    seconds: float,
    *,
    question: str = "",
    background: Sequence[str] = (),
    source_sha256: str = "",
    error: dict[str, str] | None,
    warned: Sequence[str] = (),
) -> dict[str, Any]:
    """The manifest: what went in and what came out."""
    study = context.study
    return {
        "study": {
            "name": file.name,
            "title": study.title,
            "question": question,
            "background": list(background),
            "paper": study.paper,
            "figure": study.figure,
            "claims": list(study.claims),
        },
        "fidelity": "full" if full else "quick",
        "inputs": {
            "source": file.path.name,
            "source_sha256": source_sha256,
            **versions(),
            "sources": list(sources),
            "sources_sha256": digest(sources, file.path.parent),
        },
        "error": error,
        "notes": context._notes,
        "claims": context._claims,
        "explanations": context._explained,
        "settings": context._settings,
        "figures": context._figures,
        "tables": context._tables,
        "warnings": list(warned),
        "outputs": {
            path.name: hashlib.sha256(path.read_bytes()).hexdigest()
            for path in sorted(context.folder.iterdir())
        },
        "seconds": round(seconds, 3),
    }


def lost_study(
    file: StudyFile,
    out: Path,
    message: str,
    seconds: float,
    *,
    full: bool = False,
    keep_failure: bool = False,
) -> Result:
    """Put on record that a study ended without saying why.

    Parameters
    ----------
    file, out, full, keep_failure
        As for `run_study`.
    message : str
        What is known.
    seconds : float
        How long it had run.

    Returns
    -------
    Result
        A failure.
    """
    error = {"kind": "ProcessEnded", "message": message, "where": file.path.name}
    target = out / file.name
    with suppress(_Dropped), atomic_folder(target) as folder:
        context = Context(Study(name=file.name, title=file.name), folder, full)
        manifest = _record(context, file, full, (), seconds, error=error)
        if not keep_failure:
            raise _Dropped
        save_json(manifest, folder / "manifest.json")
    return Result(file.name, target if keep_failure else None, manifest)


def check_place(target: Path) -> None:
    """Refuse to replace what is no result of a study."""
    if target.exists() and not (target / "manifest.json").is_file():
        raise InputError(
            f"'{target}' is there and holds no results of a study; name another folder with -o, "
            "or move it away, as it would be replaced."
        )


class _Dropped(Exception):
    """Leave a folder of results without putting it in its place."""


def _measured(context: Context) -> set[str]:
    return {claim["id"] for claim in context._claims}


def _describe(error: Exception | SystemExit, path: Path) -> dict[str, str]:
    """Say what went wrong and where in the study, without the paths of this machine."""
    frames = [
        f"{Path(frame.filename).name}, line {frame.lineno}, in {frame.name}: {frame.line}"
        for frame in traceback.extract_tb(error.__traceback__)
        if Path(frame.filename).name != "studies.py"
    ]
    return {
        "kind": type(error).__name__,
        "message": str(error) or type(error).__name__,
        "where": "\n".join(frames) or path.name,
    }
