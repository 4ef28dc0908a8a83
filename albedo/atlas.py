"""The default tables of all models, in one folder: written piece by piece, and continued later.

Each model declares the lines of its `tables`. A finished table is a netCDF file; of an unfinished
one the finished pieces lie in a folder beside it, so an interrupted run loses only the entries that
were being computed, and the next run computes only what is missing. A table or piece that was made
from other inputs, or by other code, is not taken for finished.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import threading
import zipfile
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from albedo.catalogue import models
from albedo.errors import InputError
from albedo.estimate import Estimate
from albedo.files import atomic_file, make_folder, save_table
from albedo.grammar import ModelSpec, parse_model, parse_numbers
from albedo.quadrature import warn_unconverged
from albedo.tables import Plan, plan_table

if TYPE_CHECKING:
    import xarray

COSINES = "0.01..1/32"
"""Cosines of the angle of incidence, in the grammar of sweeps."""

AZIMUTHS = 8
"""Azimuths of an anisotropic table, from 0 to 90 degrees."""

_FIELDS = ("value", "error", "evaluations", "converged")


@dataclass(frozen=True)
class Sheet:
    """One table of the atlas.

    Attributes
    ----------
    name : str
        Name of its file, without the ending.
    spec : ModelSpec
        What is swept.
    plan : Plan
        The table before it is computed.
    """

    name: str
    spec: ModelSpec
    plan: Plan

    def key(self) -> str:
        """A digest of all that the numbers depend on: inputs and code."""
        from albedo._compile import PACKAGE, digest

        said = {
            "spec": str(self.spec),
            "options": self.plan.options,
            "cos_theta": self.plan.cos_theta.tolist(),
            "phi": self.plan.phi.tolist(),
            "sources": digest(PACKAGE),
        }
        return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()[:16]


def sheets(rtol: float = 1e-8) -> Iterator[Sheet]:
    """Plan the default tables of all models.

    Parameters
    ----------
    rtol : float
        The relative error to reach.

    Yields
    ------
    Sheet
        The next table; the first of a model has the model's name, and one with azimuths says so
        where the first has none.
    """
    for name, kind in models().items():
        always = True
        for number, line in enumerate(kind.tables):
            spec = parse_model(f"{name}:{line}" if line else name, "A table")
            model = next(spec.models())
            turned = not model.isotropic
            phi = np.linspace(0.0, 0.5 * np.pi, AZIMUTHS) if turned else 0.0
            sweep = {key: list(values) for key, values in spec.sweep.items()}
            plan = plan_table(model, _cosines(turned), phi, sweep, rtol)
            always = always and turned
            # Only beside an isotropic table does it say something.
            word = "_anisotropic" if turned and not always else f"_{number + 1}"
            ending = word if number else ""
            yield Sheet(name + ending, spec, plan)


def _cosines(turned: bool) -> np.ndarray:
    return parse_numbers(COSINES.replace("/32", "/16") if turned else COSINES, what="cosines")


def write_atlas(
    folder: Path,
    wanted: list[Sheet],
    *,
    threads: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> list[Path]:
    """Compute tables and write them into a folder; go on where an earlier run stopped.

    Parameters
    ----------
    folder : Path
        Where the netCDF files go; it is made if it is missing.
    wanted : list of Sheet
        The tables, such as `sheets` plans.
    threads : int
        Threads that share the pieces of all tables.
    progress : callable, optional
        Called as ``progress(done, total)`` with counts of entries, finished ones included.

    Returns
    -------
    list of Path
        The files, in the order of `wanted`.

    Raises
    ------
    InputError
        If the folder cannot be used, or a piece in it is damaged.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"The output '{folder}' is a file; the tables need a folder.")
    make_folder(folder)
    total = sum(sheet.plan.entries for sheet in wanted)
    lock, done = threading.Lock(), 0

    def advance(count: int) -> None:
        nonlocal done
        with lock:
            done += count
            if progress is not None:
                progress(done, total)

    missing: dict[int, set[int]] = {}
    for which, sheet in enumerate(wanted):
        if _is_finished(folder, sheet):
            advance(sheet.plan.entries)
            continue
        parts = _prepared(folder, sheet)
        pieces = range(len(sheet.plan.pieces))
        missing[which] = {i for i in pieces if not _piece_file(parts, i).exists()}
        advance(sum(sheet.plan.pieces[i].size for i in pieces if i not in missing[which]))

    def work(which: int, number: int) -> tuple[int, int]:
        sheet = wanted[which]
        found = sheet.plan.compute(sheet.plan.pieces[number])
        _save_piece(_piece_file(_parts(folder, sheet), number), found)
        advance(sheet.plan.pieces[number].size)
        return which, number

    for which in [w for w, left in missing.items() if not left]:
        _finish(folder, wanted[which])
    with ThreadPoolExecutor(threads) as pool:
        try:
            jobs = [pool.submit(work, w, i) for w, left in missing.items() for i in sorted(left)]
            for job in as_completed(jobs):
                which, number = job.result()
                missing[which].remove(number)
                if not missing[which]:
                    _finish(folder, wanted[which])
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return [_file(folder, sheet) for sheet in wanted]


def _file(folder: Path, sheet: Sheet) -> Path:
    return folder / f"{sheet.name}.nc"


def _parts(folder: Path, sheet: Sheet) -> Path:
    return folder / f".{sheet.name}.{sheet.key()}.parts"


def _piece_file(parts: Path, number: int) -> Path:
    return parts / f"{number:05d}.npz"


def _is_finished(folder: Path, sheet: Sheet) -> bool:
    """Whether the table is there, made from these inputs."""
    import h5py

    path = _file(folder, sheet)
    if not path.exists():
        return False
    try:
        with h5py.File(path) as file:
            return str(file.attrs.get("key", "")) == sheet.key()
    except OSError:
        raise InputError(
            f"The table '{path}' is damaged or not a netCDF file; remove it, and it will be made "
            "again."
        ) from None


def _prepared(folder: Path, sheet: Sheet) -> Path:
    """The folder of pieces; those of other inputs are removed."""
    parts = _parts(folder, sheet)
    for other in folder.glob(f".{sheet.name}.*.parts"):
        if other != parts:
            shutil.rmtree(other)
    parts.mkdir(exist_ok=True)
    return parts


def _save_piece(path: Path, found: Estimate) -> None:
    arrays: dict[str, Any] = {name: getattr(found, name) for name in _FIELDS}
    with atomic_file(path) as temporary:
        np.savez(temporary, **arrays)


def _load_piece(path: Path) -> Estimate:
    try:
        with np.load(path, allow_pickle=False) as file:
            value, error, evaluations, converged = (file[name] for name in _FIELDS)
    except (OSError, ValueError, KeyError, zipfile.BadZipFile):
        raise InputError(
            f"The piece '{path}' is damaged; remove it, and it will be computed again."
        ) from None
    return Estimate(value, error, "bound", evaluations, converged)


def _finish(folder: Path, sheet: Sheet) -> None:
    """Join the pieces of a table, write it, and remove them."""
    parts = _parts(folder, sheet)
    count = len(sheet.plan.pieces)
    joined = sheet.plan.join([_load_piece(_piece_file(parts, i)) for i in range(count)])
    warn_unconverged(joined, sheet.plan.options["rtol"], sheet.plan.options["atol"])
    dataset: xarray.Dataset = sheet.plan.dataset(joined)
    dataset.attrs["key"] = sheet.key()
    save_table(dataset, _file(folder, sheet))
    shutil.rmtree(parts)
