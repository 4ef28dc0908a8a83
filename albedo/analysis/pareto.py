"""What an accuracy costs: all ways to the albedo of a model, timed beside what they err by.

Errors are relative, against the nested quadrature at 1e-12, over directions that no table or
polynomial was made from. Times are those of an entry, with all that belongs to it, measured in
turns in one run: polynomials and tables read 4,096 places at once, the rest computes as many
entries as there are directions. Only ratios of times hold elsewhere.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from albedo.advice.prices import Prices, committed
from albedo.advice.scene import Scene
from albedo.advice.ways import AlbedoWays, Places, Variant, Way
from albedo.brdf import Model
from albedo.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

SEED = 3
"""Of the directions where errors are measured."""

# The reference, which an error is never taken to be below.
_EXACT = 1e-12
_TOLERANCE = 1e-9
_READ = 4096
_SECONDS = 5e-4
# Entries that take longer are computed for a few directions only, and timed once a round.
_LONG, _FEW = 2_000, 16


@dataclass(frozen=True)
class Race:
    """All ways to the albedo of one model, ready to be timed.

    Attributes
    ----------
    rows : list of dict
        What each way is, and its errors.
    runs : list of callable
        Each takes nanoseconds of an entry once.
    """

    rows: list[dict[str, object]]
    runs: list[Callable[[], float]]

    def times(
        self, repeats: int = 7, progress: Callable[[int, int], None] | None = None
    ) -> pd.DataFrame:
        """Time all ways, in turns.

        Parameters
        ----------
        repeats : int
            Rounds that medians are of, at least 3.
        progress : callable, optional
            Called with rounds done and rounds in all.

        Returns
        -------
        pandas.DataFrame
            One row for every way: ``kind``, ``detail``, ``evaluations`` of the model for an entry,
            ``bytes``, ``ns`` for an entry with quartiles ``ns_low`` and ``ns_high``, ``ratio`` to
            the cheapest, the largest and the mean relative error ``worst`` and ``mean``, and
            ``front``: whether nothing is cheaper and as good.

        Raises
        ------
        InputError
            For fewer rounds.
        """
        import pandas as pd

        if repeats < 3:
            raise InputError(f"repeats = {repeats} is out of range; it must be at least 3")
        times = np.empty((repeats, len(self.runs)))
        order = np.random.default_rng(SEED)
        for done in range(repeats):
            for k in order.permutation(len(self.runs)):
                times[done, k] = self.runs[k]()
            if progress is not None:
                progress(done + 1, repeats)
        low, middle, high = np.quantile(times, (0.25, 0.5, 0.75), axis=0)
        frame = pd.DataFrame(self.rows).assign(ns=middle, ns_low=low, ns_high=high)
        frame["ratio"] = frame["ns"] / frame["ns"].min()
        return front(frame).sort_values(["ns", "worst"], ignore_index=True)


def prepare(
    model: Model,
    *,
    theta: tuple[float, float] = (0.0, 85.0),
    directions: int = 64,
    stored: Sequence[str] = ("float64", "float32"),
    evaluations: float = math.inf,
    prices: Prices | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Race:
    """Measure the errors of all ways to the albedo of one model, and make them ready to be timed.

    Parameters
    ----------
    model : Model
        With one channel.
    theta : (float, float)
        Smallest and largest angle of incidence, degrees.
    directions : int
        Where errors are measured, at least 16.
    stored : sequence of str
        How tables and polynomials may be stored.
    evaluations : float
        Ways that evaluate the model more often than this for an entry are left out.
    prices : Prices, optional
        Which decide how finely the albedo is interpolated.
    progress : callable, optional
        Called with ways done and ways in all.

    Returns
    -------
    Race
        What takes their times.

    Raises
    ------
    InputError
        For input out of range.
    """
    if directions < _FEW:
        raise InputError(f"directions = {directions} is out of range; it must be at least {_FEW}")
    scene = Scene(model, (), theta, "sky", 5.0, "albedo", _TOLERANCE, 0.0)
    pilot = Places.draw(scene, 0, directions)
    places = Places.draw(scene, SEED, directions)
    variant = Variant((), model)
    ways = [
        way
        for way in AlbedoWays(scene, variant, prices or committed(), pilot).all()
        if way.work <= evaluations and (way.made is None or way.detail.split(", ")[1] in stored)
    ]
    runs = [_run(way, places) for way in ways]
    rows = []
    for done, way in enumerate(ways):
        count = directions if way.work <= _LONG else _FEW
        found = way.values(places.points.first(count))
        off = np.maximum(np.abs(found / places.known[:count] - 1.0), _EXACT)
        rows.append({**_about(way), "worst": float(off.max()), "mean": float(off.mean())})
        if progress is not None:
            progress(done + 1, len(ways))
    return Race(rows, runs)


def _about(way: Way) -> dict[str, object]:
    return {
        "kind": _kind(way),
        "detail": way.detail,
        "evaluations": way.work,
        "bytes": way.bytes,
    }


def _kind(way: Way) -> str:
    """Finer than `Way.kind`: how a table is read, and what is drawn."""
    if way.kind == "table":
        return f"{way.detail.rsplit(', ', 1)[1]} table"
    if way.kind == "Monte Carlo":
        ends = {"Sobol": "Sobol draws of the lobe", "cosine": "draws of the cosine"}
        return ends.get(way.detail.rsplit(" ", 1)[1], "draws of the lobe")
    return "polynomial" if way.kind == "constant" else way.kind


def _run(way: Way, places: Places) -> Callable[[], float]:
    """What measures the nanoseconds of an entry once."""
    if way.made is not None:
        made = way.made.get()
        low, high = (np.array(ends) for ends in zip(*made.grid.ends, strict=True))
        rng = np.random.default_rng(SEED)
        x = np.ascontiguousarray(rng.uniform(low, high, (_READ, len(low))).T)
        out = np.empty(_READ)
        return _timer(lambda: made.fill(x, out), _READ)
    points = places.points if way.work <= _LONG else places.points.first(_FEW)
    return _timer(lambda: way.values(points), len(points))


def _timer(call: Callable[[], object], entries: int) -> Callable[[], float]:
    call()
    start = time.perf_counter()
    call()
    turns = max(1, math.ceil(_SECONDS / max(time.perf_counter() - start, 1e-7)))

    def timed() -> float:
        begin = time.perf_counter()
        for _ in range(turns):
            call()
        return 1e9 * (time.perf_counter() - begin) / (turns * entries)

    return timed


def front(frame: pd.DataFrame) -> pd.DataFrame:
    """Mark the rows than which no other is both cheaper and as good.

    Parameters
    ----------
    frame : DataFrame
        With columns ``ns`` and ``worst``.

    Returns
    -------
    DataFrame
        With the column ``front``.
    """
    best, marked = math.inf, np.zeros(len(frame), dtype=bool)
    for k in np.lexsort((frame["worst"], frame["ns"])):
        error = float(frame["worst"].iloc[k])
        if error < best:
            marked[k], best = True, error
    return frame.assign(front=marked)


def cheapest(frame: pd.DataFrame, error: float) -> pd.DataFrame:
    """The cheapest row of every kind that errs by at most so much, the cheapest first.

    Parameters
    ----------
    frame : DataFrame
        What `measure` gives.
    error : float
        The largest relative error that may be.

    Returns
    -------
    DataFrame
        With fewer rows, or none.
    """
    good = frame[frame["worst"] <= error].sort_values("ns")
    return good.drop_duplicates("kind")
