"""What things cost: nanoseconds for a value, a draw, a lookup, from a table that was measured.

The table is committed beside this file, and `measure` makes it again; its numbers hold for the
machine that is named in it, and ratios of them hold roughly on others. What it does not know, such
as a function of one's own, is measured when it is asked for.
"""

from __future__ import annotations

import csv
import itertools
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, lru_cache, partial
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from albedo.analysis import kernel_cost
from albedo.brdf import Choice, Model, Part, Real
from albedo.compose import Sum
from albedo.directions import spherical
from albedo.errors import InputError
from albedo.grammar import parse_model
from albedo.lookup.stored import READ, Grid, Polynomial, Table

FILE = Path(__file__).with_name("prices.csv")
COLUMNS = ("what", "key", "how", "ns", "low", "high")
STORED = ("float64", "float32", "float16", "unorm16")
"""What tables are priced in: eight bits a number are too few for what is seen."""

_COUNT = 4096
_LIGHTS, _COSINES = 256, (0.1, 1.0)
_REPEATS = 9
_LONG_ENOUGH = 1e-3
# Sizes of tables whose lookups are timed: in a core's first cache, in its second, and beyond.
CACHES = {"first": 16 * 2**10, "second": 512 * 2**10, "third": 8 * 2**20}
_POLYNOMIALS = ((1, 2), (1, 8), (2, 3), (2, 8), (3, 3), (3, 6))


def seconds_of(call: Callable[[], Any]) -> list[float]:
    """Times of a call, in seconds, each a mean over as many calls as a millisecond takes."""
    call()
    start = time.perf_counter()
    call()
    turns = max(1, math.ceil(_LONG_ENOUGH / max(time.perf_counter() - start, 1e-7)))
    found = []
    for _ in range(_REPEATS):
        start = time.perf_counter()
        for _ in range(turns):
            call()
        found.append((time.perf_counter() - start) / turns)
    return found


def key_of(model: Model, part: Part) -> tuple[str, tuple[str, ...]]:
    """A kernel, and the choices of its model that are not the default ones."""
    choices = _choices(model)
    name = getattr(part.fill, "__qualname__", part.name)
    return f"{model.name}/{name}", choices


def _choices(model: Model) -> tuple[str, ...]:
    """The choices of a model that are not the default ones."""
    return tuple(
        f"{info.name}={model.parameters[info.name]}"
        for info in model.parameter_info()
        if isinstance(info, Choice)
        and model.parameters.get(info.name, info.default) != info.default
    )


def priced_models(kind: type[Model]) -> Iterator[Model]:
    """The models of a class whose kernels are timed: the default, and one choice changed each.

    Numbers that are 0 by default, which may leave out a part, are set to a half.
    """
    numbers = {
        info.name: 0.5
        for info in kind.parameter_info()
        if isinstance(info, Real) and info.default == 0.0 and info.low <= 0.5 <= info.high
    }
    choices = [
        {info.name: word}
        for info in kind.parameter_info()
        if isinstance(info, Choice)
        for word in info.choices
        if word != info.default
    ]
    for extra, chosen in itertools.product(({}, numbers), ({}, *choices)):
        try:
            yield kind(**extra, **chosen)
        except InputError:
            # Some numbers are not used with some choices, and some choices need more.
            continue


class Prices:
    """What things cost.

    Parameters
    ----------
    rows : dict of (str, str, str) to float
        Nanoseconds by what it is, its key, and how it is done.
    machine : str
        Where that was measured.
    """

    def __init__(self, rows: dict[tuple[str, str, str], float], machine: str) -> None:
        self._rows = rows
        self.machine = machine

    def _price(self, what: str, key: str, how: str) -> float:
        found = self._rows.get((what, key, how))
        if found is None:
            raise InputError(
                f"the table of prices has no {what} of {key}, {how}; `albedo cost --update` makes "
                "it again"
            )
        return found

    def known(self, model: Model) -> bool:
        """Whether the table has all kernels of a model."""
        return all(
            ("value", key_of(one, part)[0], "float64 shared") in self._rows
            for one in _terms(model)
            for part in one.parts()
        )

    def value(self, model: Model, precision: str = "float64", way: str = "shared") -> float:
        """Nanoseconds of f.

        Parameters
        ----------
        model : Model
        precision : {"float64", "float32"}
        way : {"shared", "raw"}
            One light for many views with known half vectors, or a light and a view alone; see
            `albedo.analysis.kernel_cost`.
        """
        how = f"{precision} {way}"
        return sum(self._part(one, part, how) for one in _terms(model) for part in one.parts())

    def _part(self, model: Model, part: Part, precision: str) -> float:
        name, choices = key_of(model, part)
        base = self._rows.get(("value", name, precision))
        if base is None:
            return _timed(part.fill, model, part, precision)
        found = base
        for choice in choices:
            # A choice costs what it costs alone; two of them what both cost.
            found += self._rows.get(("value", f"{name}:{choice}", precision), base) - base
        return max(found, 0.2 * base)

    def single(self, model: Model) -> bool:
        """Whether there is a price for float32."""
        return all(
            ("value", key_of(one, part)[0], "float32 raw") in self._rows
            for one in _terms(model)
            for part in one.parts()
        )

    def spikes(self, model: Model) -> float:
        """Nanoseconds of the Dirac parts for a light."""
        total = 0.0
        for one in _terms(model):
            if type(one).spikes is not Model.spikes:
                known = self._rows.get(("spikes", one.name, "model"))
                total += _time_spikes_once(one) if known is None else known
        return total

    def node(self, model: Model) -> float:
        """Nanoseconds of a node of a rule on angles, whose directions are known."""
        return self.value(model) + self._price("node", "all", "angles")

    def draw(self, model: Model, how: str) -> float:
        """Nanoseconds of a draw: of ``cosine``, ``model`` or ``sobol``, with its value."""
        routine = "cosine" if how == "cosine" else "model"
        own = [self._rows.get(("draw", one.name, routine)) for one in _terms(model)]
        usual = self._price("draw", "all", routine)
        # A sum draws from one of its terms, and needs the densities of all.
        drawn = sum(usual if price is None else price for price in own)
        extra = self._price("draw", "all", "sobol") if how == "sobol" else 0.0
        return self.value(model) + drawn + extra

    def adaptive(self, model: Model) -> tuple[float, float]:
        """Nanoseconds of an entry of the nested quadrature, and of each of its evaluations."""
        return (
            self._price("entry", "all", "nested"),
            self.value(model) + self._price("evaluation", "all", "nested"),
        )

    def lookup(self, grid: Grid, stored: str, read: str, size: int) -> float:
        """Nanoseconds of a lookup in a table of so many bytes, its coordinates warped first."""
        places = list(CACHES)
        place = places[min(sum(size > 2 * CACHES[p] for p in places), len(places) - 1)]
        return self._price("lookup", f"{len(grid.counts)} axes", f"{read} {stored} {place}") + (
            self._warps(grid)
        )

    def polynomial(self, grid: Grid) -> float:
        """Nanoseconds of a polynomial, its coordinates warped first."""
        axes = len(grid.counts)
        points = [
            (n**axes, self._price("polynomial", f"{axes} axes", f"{n}")) for n in _sizes(axes)
        ]
        (few, cheap), (many, dear) = points
        slope = max(dear - cheap, 0.0) / (many - few)
        count = math.prod(grid.counts)
        return max(cheap + slope * (count - few), 0.5 * cheap) + self._warps(grid)

    def constant(self) -> float:
        """Nanoseconds of a number that is always the same."""
        return self._price("polynomial", "0 axes", "1")

    def made(self, model: Model) -> float:
        """Nanoseconds to make a model of new parameters, which a table may not need."""
        total = 0.0
        for one in _terms(model):
            keys = (one.name, *(f"{one.name}:{choice}" for choice in _choices(one)))
            total += max(self._rows.get(("made", key, "model"), 0.0) for key in keys)
        return total

    def _warps(self, grid: Grid) -> float:
        total = 0.0
        for name, warp in zip(grid.names, grid.warps, strict=True):
            total += self._price("warp", "all", warp)
            if name == "phi":
                total += self._price("warp", "all", "azimuth")
        return total


def _sizes(axes: int) -> tuple[int, int]:
    few, many = (n for a, n in _POLYNOMIALS if a == axes)
    return few, many


def _terms(model: Model) -> list[Model]:
    return [one for _, one in model.terms] if isinstance(model, Sum) else [model]


@lru_cache(maxsize=256)
def _timed(fill: Any, model: Model, part: Part, how: str) -> float:
    """What the table does not know, now."""
    precision, way = how.split()
    own = _subject("", model, part)
    found = kernel_cost.samples([replace(own, label="own")], ways=(way,), repeats=7)
    return float(np.median(found["own", precision, way]))


def _subject(label: str, model: Model, part: Part) -> kernel_cost.Subject:
    """A part of a model, to be timed."""
    row = part.packed(np.array([model.pack()], dtype=np.float64))[0]
    return kernel_cost.Subject(label, model.spec, ((part.fill, kernel_cost.constant(row)),))


def measure(progress: Callable[[int, int], None] | None = None) -> list[tuple[Any, ...]]:
    """Measure all prices on this machine.

    Parameters
    ----------
    progress : callable, optional
        Called with models done and models in all.

    Returns
    -------
    list of tuple
        Rows of the table: `COLUMNS`, with quartiles as the last two.
    """
    from albedo.catalogue import models

    rows: list[tuple[Any, ...]] = []

    def add(what: str, key: str, how: str, ns: list[float]) -> float:
        quartiles = [float(q) for q in np.percentile(ns, (50, 25, 75))]
        rows.append((what, key, how, *(f"{q:.4g}" for q in quartiles)))
        return quartiles[0]

    kinds = models()
    subjects: dict[str, kernel_cost.Subject] = {}
    for kind in kinds.values():
        for model in priced_models(kind):
            one = model.by_channel()[0]
            for part in one.parts():
                key, choices = key_of(one, part)
                label = ":".join((key, *choices))
                # Other numbers do not change what a kernel costs.
                subjects.setdefault(label, _subject(label, one, part))
    steps = len(subjects) + _REPEATS + len(kinds)

    def step(done: int, _: int) -> None:
        if progress is not None:
            progress(done, steps)

    options: dict[str, Any] = {"ways": ("raw", "shared"), "repeats": _REPEATS}
    timed = kernel_cost.samples(list(subjects.values()), progress=step, **options)
    for (label, precision, way), values in timed.items():
        if label:
            add("value", label, f"{precision} {way}", values.tolist())
    known = Prices({(what, key, how): float(ns) for what, key, how, ns, *_ in rows}, "")
    draws: dict[str, list[float]] = {"cosine": [], "model": []}
    nested = []
    for done, (name, kind) in enumerate(kinds.items()):
        step(len(subjects) + _REPEATS + done, steps)
        for model in priced_models(kind):
            label = ":".join((name, *_choices(model)))
            if ("made", label, "model") not in {row[:3] for row in rows}:
                add("made", label, "model", _time_made(model))
        model = kind().by_channel()[0]
        if type(model).spikes is not Model.spikes:
            add("spikes", name, "model", _time_spikes(model))
        if model.parts():
            own = known.value(model)
            for how in ("cosine", "model"):
                spent = [max(t - own, 0.0) for t in _time_draws(model, how)]
                draws[how].append(add("draw", name, how, spent))
            nested.append(_time_nested(model, own))
    step(steps, steps)
    for how, found in draws.items():
        add("draw", "all", how, found)
    add("draw", "all", "sobol", _time_sobol())
    add("entry", "all", "nested", [entry for entry, _ in nested])
    add("evaluation", "all", "nested", [evaluation for _, evaluation in nested])
    _measure_lookups(add)
    return rows


def _time_made(model: Model) -> list[float]:
    """Nanoseconds to make such a model with parameters that were not met before, and its parts."""
    spec = parse_model(f"{model.name}:{type(model).domain}", "A price")
    info = {item.name: item for item in model.parameter_info()}
    # Some choices do not use what the domain sweeps.
    numbers = {
        name: v
        for name, v in spec.sweep.items()
        if isinstance(v, np.ndarray)
        and set(getattr(info[name], "targets", (name,))) <= model.parameters.keys()
    }
    rng = np.random.default_rng(6)
    found = []
    for _ in range(_REPEATS):
        # In the middle of the domain: its ends may be dear.
        drawn = {name: rng.uniform(*np.quantile(v, (0.4, 0.6))) for name, v in numbers.items()}
        start = time.perf_counter()
        one = model.replace(**drawn).by_channel()[0]
        one.parts()
        one.pack()
        found.append(1e9 * (time.perf_counter() - start))
    return found


def _time_spikes(model: Model) -> list[float]:
    """Nanoseconds of the Dirac parts of a model for a light, of many at once."""
    lights = spherical(np.linspace(*_COSINES, _LIGHTS), 0.3)
    return [1e9 * t / _LIGHTS for t in seconds_of(lambda: model.spikes(lights))]


@lru_cache(maxsize=64)
def _time_spikes_once(model: Model) -> float:
    return median(_time_spikes(model))


def _time_draws(model: Model, how: str) -> list[float]:
    """Nanoseconds of a draw with all that belongs to it, as `monte_carlo_albedo` makes them."""
    from albedo.integrators.monte_carlo import _Row
    from albedo.sampling.mixture import Values, mixture_of

    wi = np.ascontiguousarray(spherical(0.6, 0.3).reshape(3, 1))
    row = _Row(model, Values(model), wi, mixture_of(model, how), 0, 0, False)
    u = np.random.default_rng(2).random((2, _COUNT))
    return [1e9 * t / _COUNT for t in seconds_of(lambda: row.tally(u))]


def _time_sobol() -> list[float]:
    """Nanoseconds of a point: shifted, and folded into the unit square."""
    u, shift = np.random.default_rng(3).random((2, _COUNT)), np.array([[0.3], [0.7]])
    return [1e9 * t / _COUNT for t in seconds_of(lambda: (u + shift) % 1.0)]


def _time_nested(model: Model, own: float) -> tuple[float, float]:
    """Nanoseconds of an entry, and of each evaluation beside the model's own time."""
    from albedo.quadrature import albedo_rows

    found = []
    cosines, zero = np.linspace(0.1, 1.0, 64), np.zeros(64)
    for rtol in (1e-2, 1e-8):
        run = partial(albedo_rows, [model] * 64, cosines, zero, rtol=rtol, atol=0.0)
        evaluations = float(run().evaluations.mean())
        found.append((evaluations, 1e9 * median(seconds_of(run)) / 64))
    (few, short), (many, long) = found
    slope = max((long - short) / max(many - few, 1.0), own)
    return max(short - slope * few, 0.0), slope - own


def _measure_lookups(add: Callable[[str, str, str, list[float]], float]) -> None:
    """Nodes on angles, half vectors, warps, tables and polynomials."""
    rng = np.random.default_rng(4)

    def per(call: Callable[[], Any]) -> list[float]:
        return [1e9 * t / _COUNT for t in seconds_of(call)]

    weight, values = rng.random(_COUNT), rng.random(_COUNT)
    add("node", "all", "angles", per(lambda: float(values @ weight)))
    x = rng.uniform(0.1, 1.0, (3, _COUNT))
    out = np.empty(_COUNT)
    ends = (0.1, 1.0)

    def grid(axes: int, count: int, warp: str = "linear") -> Grid:
        return Grid(("a", "b", "c")[:axes], (ends,) * axes, (warp,) * axes, (count,) * axes)

    def one(warp: str) -> list[float]:
        own = Polynomial.of(grid(1, 2, warp), np.ones(2), "float64")
        return per(lambda: own.fill(x[:1], out))

    plain = median(one("linear"))
    for warp in ("linear", "sqrt", "angle", "log"):
        add("warp", "all", warp, [max(t - plain, 0.0) for t in one(warp)])
    add("warp", "all", "azimuth", per(lambda: np.arctan2(x[0], x[1])))
    add("polynomial", "0 axes", "1", per(lambda: out.fill(0.5)))
    for axes, count in _POLYNOMIALS:
        own = Polynomial.of(grid(axes, count), np.ones((count,) * axes), "float64")
        add("polynomial", f"{axes} axes", f"{count}", per(partial(own.fill, x[:axes], out)))
    for (place, size), stored, read, axes in itertools.product(
        CACHES.items(), STORED, READ, (1, 2, 3)
    ):
        bytes_each = {"float64": 8, "float32": 4}.get(stored, 2)
        count = max(4, round((size / bytes_each) ** (1.0 / axes)))
        table = Table.of(grid(axes, count), rng.random((count,) * axes), stored, read)
        points = np.ascontiguousarray(rng.uniform(*ends, (axes, _COUNT)))
        how = f"{read} {stored} {place}"
        add("lookup", f"{axes} axes", how, per(partial(table.fill, points, out)))


@cache
def committed() -> Prices:
    """The table beside this file.

    Raises
    ------
    InputError
        When it is damaged.
    """
    return read(FILE)


def read(path: Path) -> Prices:
    """Read a table of prices.

    Raises
    ------
    InputError
        When it is missing or damaged.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        raise InputError(f"the table of prices {path.name} cannot be read") from None
    machine = lines[0].removeprefix("# ") if lines else ""
    rows: dict[tuple[str, str, str], float] = {}
    for number, row in enumerate(csv.reader(lines[1:]), start=2):
        if number == 2:
            if tuple(row) != COLUMNS:
                raise InputError(f"the table of prices {path.name} has other columns in line 2")
            continue
        try:
            what, key, how, ns, _, _ = row
            price = float(ns)
        except ValueError:
            raise InputError(
                f"the table of prices {path.name} is damaged in line {number}"
            ) from None
        if not (math.isfinite(price) and price >= 0.0):
            raise InputError(f"the table of prices {path.name} has {ns} in line {number}")
        rows[what, key, how] = price
    if not rows:
        raise InputError(f"the table of prices {path.name} has no rows")
    return Prices(rows, machine)


def save(rows: list[tuple[Any, ...]], path: Path) -> Path:
    """Write what `measure` found."""
    from albedo.files import save_text

    lines = [f"# {kernel_cost.processor()}; {kernel_cost.versions()}", ",".join(COLUMNS)]
    lines += [",".join(str(cell) for cell in row) for row in rows]
    return save_text("\n".join(lines) + "\n", path)
