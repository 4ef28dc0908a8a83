"""Labelled tables of albedos: values, bounds, coordinates, units and provenance."""

from __future__ import annotations

import itertools
import json
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

import albedo
from albedo.brdf import Model
from albedo.compose import Sum
from albedo.errors import InputError
from albedo.estimate import Estimate
from albedo.grammar import format_value
from albedo.quadrature import albedo_rows, check_directions, check_tolerances, warn_unconverged

if TYPE_CHECKING:
    import xarray

# Most rows in a batch, whatever the number of threads: sums are rounded in the same order.
_CHUNK = 512


def table(
    model: Model,
    cos_theta: ArrayLike,
    phi: ArrayLike = 0.0,
    sweep: Mapping[str, Sequence[Any]] | None = None,
    rtol: float = 1e-8,
    atol: float = 0.0,
    *,
    fixed: str = "light",
    complement: bool = False,
    max_evaluations: int | None = None,
    threads: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> xarray.Dataset:
    """Directional albedos over a grid of directions and parameters.

    Parameters
    ----------
    model : Model
        The model; parameters that are swept replace its own.
    cos_theta, phi : array_like
        Cosines in [0, 1] and azimuths in radians, each a number or a list.
    sweep : mapping of str to sequence, optional
        Values of parameters (aliases allowed); the table has one dimension for each.
    rtol, atol, fixed, complement, max_evaluations
        As in `albedo.directional_albedo`.
    threads : int
        Threads that share the work; the numbers do not depend on it.
    progress : callable, optional
        Called as ``progress(done, total)`` with counts of entries.

    Returns
    -------
    xarray.Dataset
        Variables ``value``, ``error``, ``evaluations`` and ``converged`` with dimensions (sweep
        names..., phi, cos_theta), units, and the provenance in its attributes. Where a colour has
        channels, the dimension ``channel`` stands before phi.

    Raises
    ------
    InputError
        For input out of range, before anything is computed.
    """
    plan = plan_table(
        *(model, cos_theta, phi, sweep, rtol, atol),
        fixed=fixed,
        complement=complement,
        max_evaluations=max_evaluations,
    )
    if not isinstance(threads, int) or not 1 <= threads <= 256:
        raise InputError(f"threads = {threads!r} is out of range; it lies in [1, 256]")
    lock, done = threading.Lock(), 0

    def work(piece: np.ndarray) -> Estimate:
        nonlocal done
        found = plan.compute(piece)
        with lock:
            done += piece.size
            if progress is not None:
                progress(done, plan.entries)
        return found

    if threads == 1:
        found = [work(piece) for piece in plan.pieces]
    else:
        found = _worked_off(work, plan.pieces, threads)
    joined = plan.join(found)
    warn_unconverged(joined, rtol, atol)
    return plan.dataset(joined)


def _worked_off(
    work: Callable[[np.ndarray], Estimate], pieces: Sequence[np.ndarray], threads: int
) -> list[Estimate]:
    """What some work finds on pieces, in their order.

    Every thread takes the next one that is left: an interrupt that meets an executor just as it is
    handed work leaves one of its locks open, so it is handed little.
    """
    found: dict[int, Estimate] = {}
    left = iter(range(len(pieces)))

    def take() -> None:
        try:
            for k in left:
                found[k] = work(pieces[k])
        finally:
            # Nothing more is begun once something failed.
            for _ in left:
                pass

    with ThreadPoolExecutor(threads) as pool:
        try:
            for job in [pool.submit(take) for _ in range(threads)]:
                job.result()
        finally:
            for _ in left:
                pass
    return [found[k] for k in range(len(pieces))]


@dataclass(frozen=True)
class Plan:
    """A table before it is computed: its entries, cut into pieces that are computed one by one.

    Attributes
    ----------
    model : Model
        The model whose parameters are not swept.
    axes : dict of str to list
        Parameters that are swept, with their values.
    cos_theta, phi : ndarray
        The directions.
    options : dict
        What `albedo.quadrature.albedo_rows` needs to know.
    channels : int or None
        Channels of the colours.
    rows : list of Model
        The model of every entry.
    pieces : list of ndarray of int
        Which entries each piece holds; all cost about the same.
    """

    model: Model
    axes: dict[str, list[Any]]
    cos_theta: np.ndarray
    phi: np.ndarray
    options: dict[str, Any]
    channels: int | None
    rows: list[Model]
    pieces: list[np.ndarray]

    @property
    def entries(self) -> int:
        """The number of entries."""
        return len(self.rows)

    def compute(self, piece: np.ndarray) -> Estimate:
        """Albedos of the entries of a piece."""
        phi, cosine = np.divmod(piece % (self.phi.size * self.cos_theta.size), self.cos_theta.size)
        return albedo_rows(
            [self.rows[i] for i in piece], self.cos_theta[cosine], self.phi[phi], **self.options
        )

    def join(self, found: Sequence[Estimate]) -> Estimate:
        """All entries in their order, from those of the pieces."""
        order = np.argsort(np.concatenate(self.pieces))
        value, error, evaluations, converged = (
            np.concatenate([getattr(piece, name) for piece in found])[order]
            for name in ("value", "error", "evaluations", "converged")
        )
        return Estimate(value, error, "bound", evaluations, converged)

    def dataset(self, joined: Estimate) -> xarray.Dataset:
        """The labelled table."""
        import xarray

        model, axes, options = self.model, self.axes, self.options
        channel = {} if self.channels is None else {"channel": self.channels}
        shape = (
            *(len(v) for v in axes.values()),
            *(*channel.values(), self.phi.size, self.cos_theta.size),
        )
        dims = (*axes, *channel, "phi", "cos_theta")
        loss = options["complement"]
        what = "complement of the directional albedo" if loss else "directional albedo"
        labels = {
            "value": (what, "1"),
            "error": ("bound on the error of value", "1"),
            "evaluations": ("evaluations of the model, those of the bound included", "1"),
            "converged": ("whether the tolerance was met", "1"),
        }
        variables = {
            name: (dims, getattr(joined, name).reshape(shape), {"long_name": text, "units": unit})
            for name, (text, unit) in labels.items()
        }
        info = {q.name: q for q in model.parameter_info()}
        coordinates: dict[str, Any] = {
            name: (name, _labels(values), {"long_name": info[name].doc, "units": info[name].unit})
            for name, values in axes.items()
        }
        if self.channels is not None:
            numbers = np.arange(self.channels)
            coordinates["channel"] = ("channel", numbers, {"long_name": "channel of colours"})
        azimuth = {"long_name": "azimuth of the fixed direction", "units": "rad"}
        cosine = {"long_name": "cosine of the angle to the normal", "units": "1"}
        coordinates["phi"] = ("phi", self.phi, azimuth)
        coordinates["cos_theta"] = ("cos_theta", self.cos_theta, cosine)
        kept = {k: v for k, v in model.parameters.items() if not _swept(model, k, axes)}
        attributes = {
            "title": f"{what} of {model.name}",
            "model": model.spec if isinstance(model, Sum) else model.name,
            "parameters": json.dumps(kept),
            "equation": model.equation,
            "references": " ".join(model.references),
            "fixed": options["fixed"],
            "error_kind": "bound",
            "rtol": options["rtol"],
            "atol": options["atol"],
            "source": f"albedo-workbench {albedo.__version__}",
        }
        if model.resolved_width is not None:
            attributes["resolved_width"] = model.resolved_width
        return xarray.Dataset(variables, coordinates, attributes)


def _labels(values: Sequence[Any]) -> Sequence[Any]:
    """Values along an axis; vectors and colours as they are written in the grammar of models."""
    if any(isinstance(value, tuple) for value in values):
        return [format_value(value) for value in values]
    return values


def plan_table(
    model: Model,
    cos_theta: ArrayLike,
    phi: ArrayLike = 0.0,
    sweep: Mapping[str, Sequence[Any]] | None = None,
    rtol: float = 1e-8,
    atol: float = 0.0,
    *,
    fixed: str = "light",
    complement: bool = False,
    max_evaluations: int | None = None,
) -> Plan:
    """Check what a table is to hold, and cut it into pieces.

    Parameters
    ----------
    model, cos_theta, phi, sweep, rtol, atol, fixed, complement, max_evaluations
        As in `table`.

    Returns
    -------
    Plan
        Nothing is computed yet.

    Raises
    ------
    InputError
        For input out of range.
    """
    c, p = check_directions(np.atleast_1d(cos_theta).ravel(), 0.0)[0], np.atleast_1d(phi).ravel()
    p = check_directions(0.5, p)[1]
    check_tolerances(rtol, atol)
    axes = {name: list(values) for name, values in (sweep or {}).items()}
    for name, values in axes.items():
        if not values:
            raise InputError(f"the sweep of {name} is empty")
    models = [
        model.replace(**dict(zip(axes, values, strict=True)))
        for values in itertools.product(*axes.values())
    ]
    counts = {m.channels for m in models}
    if len(counts) > 1:
        raise InputError("all entries of a table must have equally many channels")
    per_model = p.size * c.size
    rows = [kind for m in models for kind in m.by_channel() for _ in range(per_model)]
    # Every piece takes entries from all over the table, so that all cost about the same.
    count = -(-len(rows) // _CHUNK)
    turn = np.arange(len(rows)) % (2 * count)
    share = np.minimum(turn, 2 * count - 1 - turn)
    pieces = [np.flatnonzero(share == piece) for piece in range(count)]
    options = {
        "rtol": rtol,
        "atol": atol,
        "fixed": fixed,
        "complement": complement,
        "max_evaluations": max_evaluations,
    }
    return Plan(model, axes, c, p, options, counts.pop(), rows, pieces)


def _swept(model: Model, name: str, axes: Mapping[str, Any]) -> bool:
    """Whether a sweep sets this parameter, directly or through an alias."""
    info = {q.name: q for q in model.parameter_info()}
    return any(name == axis or name in getattr(info[axis], "targets", ()) for axis in axes)
