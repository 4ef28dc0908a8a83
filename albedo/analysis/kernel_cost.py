"""What an evaluation of a BRDF costs: nanoseconds of its compiled kernels, on this machine.

A block of directions is so long that a longer one takes hardly more per pair, and takes less than 4
MiB with the parameters of a model, which a cache holds. It is evaluated over and over by a compiled
loop: nothing is allocated and no Python runs between two evaluations. All that is timed takes
turns, in an order drawn anew for every round: what slows the machine down for a while hits all
alike, and ratios to a reference are taken within a round. The clock is that of the thread. Four
ways to a value:

* ``pairs``: every pair of directions has a light and a row of parameters of its own, as in a
  renderer; cosines are even in [0.1, 1], so that most views lie outside a narrow lobe;
* ``lobe``: the same with views that the model itself draws, so that a kernel which returns early
  outside its lobe is not flattered;
* ``raw``: ``pairs`` from light and view alone: h = l + v is formed first;
* ``shared``: 256 lights with 64 views each, as integrals have them: what depends on the light alone
  is computed once for all its views.

In float32 the kernels are those of `albedo._compile.in_single`. Dirac parts are not counted.
"""

from __future__ import annotations

import io
import math
import platform
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from albedo._compile import address, in_single, indirect, is_kernel, kernel
from albedo.brdf import Model
from albedo.directions import half_vector, spherical
from albedo.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

WAYS = ("pairs", "lobe", "raw", "shared")
PRECISIONS = ("float64", "float32")
LOWEST_COSINE = 0.1
"""Cosines of lights and views are even from here to 1."""
LIGHTS, VIEWS = 256, 64
"""Lights, and views of each, of the way ``shared``; the others have as many pairs."""
# Phong's lobe takes 17 ns with 4096 pairs, 32 ns with 16384, 34 ns with 65536 (AMD EPYC, float64):
# presumably the branches of few are learnt by heart. With more, memory would be timed.
PAIRS = LIGHTS * VIEWS
REFERENCE = "lambert"
"""The model that ratios are to."""
SPECS = {"stam_grating": "stam_grating:coherence=20"}
"""Models whose finite part is empty at their default parameters, and what is timed instead."""
FILE = Path(__file__).parents[1] / "costs.csv"
"""The table that comes with the package."""
COLUMNS = (
    *("model", "spec", "precision", "way", "ratio", "ratio_low", "ratio_high"),
    *("ns", "ns_low", "ns_high", "empty_ns", "parts", "compiled"),
)

_TEXTS = ("model", "spec", "precision", "way")
_TIMES = ("ratio", "ratio_low", "ratio_high", "ns", "ns_low", "ns_high", "empty_ns")
# A model that draws views below the horizon is asked again, this many times at most.
_DRAWS = 64

_SIGNATURES = {
    precision: f"{precision}[:,::1], {precision}[:,:,::1], {precision}[:,:,::1], "
    f"{precision}[:,::1], {precision}[:,::1]"
    for precision in PRECISIONS
}
_FILLS = {precision: f"void({text})" for precision, text in _SIGNATURES.items()}
_double, _single = (indirect(_FILLS[precision]) for precision in PRECISIONS)


@kernel
def _repeat_double(fill, times, wi, wo, h, p, out):
    """Evaluate a block `times` times; the kernel is known by its address, and is called."""
    for _ in range(times):
        _double(fill, (wi, wo, h, p, out))


@kernel
def _repeat_single(fill, times, wi, wo, h, p, out):
    """As `_repeat_double`, of float32."""
    for _ in range(times):
        _single(fill, (wi, wo, h, p, out))


_REPEAT = {"float64": _repeat_double, "float32": _repeat_single}


@kernel
def read_and_write(wi, wo, h, p, out):
    """The empty kernel: all directions are read, added up and written."""
    for j in range(out.shape[0]):
        light = wi[0, j] + wi[1, j] + wi[2, j]
        for i in range(out.shape[1]):
            view = wo[0, j, i] + wo[1, j, i] + wo[2, j, i]
            out[j, i] = light + view + h[0, j, i] + h[1, j, i] + h[2, j, i]


@kernel
def form_half_vector(wi, wo, h, p, out):
    """h = l + v as a renderer forms it; `albedo.directions.half_vector` keeps more digits."""
    for j in range(out.shape[0]):
        for i in range(out.shape[1]):
            h[0, j, i] = wi[0, j] + wo[0, j, i]
            h[1, j, i] = wi[1, j] + wo[1, j, i]
            h[2, j, i] = wi[2, j] + wo[2, j, i]


@dataclass(frozen=True)
class Block:
    """Directions above the horizon, as kernels read them.

    Attributes
    ----------
    wi : ndarray, shape (3, lights)
    wo, h : ndarray, shape (3, lights, views)
        Views, and their sums with the lights.
    """

    wi: np.ndarray
    wo: np.ndarray
    h: np.ndarray

    def astype(self, dtype: str) -> Block:
        """A copy of its own in another precision: h may be overwritten."""
        return Block(*(np.array(v, dtype=dtype, order="C") for v in (self.wi, self.wo, self.h)))


@dataclass(frozen=True, eq=False)
class Subject:
    """What is timed under one name: kernels that run one after the other.

    Attributes
    ----------
    label : str
        Its name.
    spec : str
        What it is, in the grammar of models, or in words.
    fills : tuple of (kernel, function)
        Kernels as `albedo.brdf.Part` has them, or functions that are none; and what makes of a
        `Block` the packed parameters of its lights, shape (lights, k), in float64.
    model : Model, optional
        Draws directions of the lobe; without it there is no way ``lobe``.
    """

    label: str
    spec: str
    fills: tuple[tuple[Callable[..., Any], Callable[[Block], np.ndarray]], ...]
    model: Model | None = None

    @property
    def compiled(self) -> bool:
        """Whether all of it is kernels; otherwise it is timed in float64 only."""
        return all(is_kernel(fill) for fill, _ in self.fills)


def subject(model: Model, label: str | None = None) -> Subject:
    """All parts of all channels of a model.

    Parameters
    ----------
    model : Model
        With a finite part.
    label : str, optional
        Its name in the results; by default that of the model.

    Returns
    -------
    Subject
        What can be timed.

    Raises
    ------
    InputError
        For a model that has Dirac parts and nothing else.
    """
    fills = []
    for channel in model.by_channel():
        packed = np.array([channel.pack()], dtype=np.float64)
        fills += [(part.fill, constant(part.packed(packed)[0])) for part in channel.parts()]
    if not fills:
        raise InputError(f"{model.spec} has no finite part: there is no evaluation to time")
    return Subject(label or model.name, model.spec, tuple(fills), model.by_channel()[0])


def constant(row: np.ndarray) -> Callable[[Block], np.ndarray]:
    """The same packed parameters for every light of a block."""
    return lambda block: np.tile(row, (block.wi.shape[1], 1))


def catalogue(names: Iterable[str] | None = None) -> list[Subject]:
    """Models at their default parameters, or as `SPECS` has them.

    Parameters
    ----------
    names : iterable of str, optional
        Names of models; all unless given.

    Returns
    -------
    list of Subject
        In the same order.
    """
    from albedo.catalogue import names as all_names
    from albedo.grammar import parse

    return [subject(parse(SPECS.get(name, name)).model()) for name in names or all_names()]


def random_block(rng: np.random.Generator, lights: int = PAIRS, views: int = 1) -> Block:
    """Directions whose cosines are even in [0.1, 1], and whose azimuths are even."""

    def directions(count: int) -> np.ndarray:
        return spherical(rng.uniform(LOWEST_COSINE, 1.0, count), rng.uniform(0, 2 * math.pi, count))

    wi, wo = directions(lights), directions(lights * views).reshape(lights, views, 3)
    return _block(wi, wo)


def _block(wi: np.ndarray, wo: np.ndarray) -> Block:
    """A block of lights (n, 3) and views (n, m, 3)."""
    h = half_vector(np.broadcast_to(wi[:, None, :], wo.shape), wo)
    return Block(*(np.ascontiguousarray(np.moveaxis(v, -1, 0)) for v in (wi, wo, h)))


def lobe_block(model: Model, rng: np.random.Generator, lights: int = PAIRS) -> Block:
    """Lights as in `random_block`, and for each a view above the horizon that the model draws.

    Parameters
    ----------
    model : Model
        With one channel, and a finite part.
    rng : Generator
        Where the random numbers come from.
    lights : int
        How many pairs.

    Returns
    -------
    Block
        One view for each light.

    Raises
    ------
    InputError
        When hardly any draw is above the horizon.
    """
    from albedo.sampling.mixture import mixture_of

    # Of the finite part alone: `Model.sample` would draw Dirac parts as well.
    mixture = mixture_of(model)
    wi = random_block(rng, lights).wi
    wo, h = np.empty((3, lights, 1)), np.empty((3, lights, 1))
    left = np.arange(lights)
    for _ in range(_DRAWS):
        drawn, sums = mixture.draw(np.ascontiguousarray(wi[:, left]), rng.random((2, left.size, 1)))
        above = drawn[2, :, 0] > 0.0
        wo[:, left[above]], h[:, left[above]] = drawn[:, above], sums[:, above]
        left = left[~above]
        if not left.size:
            return Block(wi, wo, h)
    raise InputError(
        f"{model.spec} drew no view above the horizon for {left.size} of {lights} lights in "
        f"{_DRAWS} draws each"
    )


@dataclass(frozen=True)
class _Unit:
    """One subject, one precision, one way: run it, and know how many evaluations that was."""

    run: Callable[[int], None]
    times: int

    def sample(self) -> float:
        """Nanoseconds for one evaluation, on a clock that stands still while others run."""
        begin = time.thread_time_ns()
        self.run(self.times)
        return (time.thread_time_ns() - begin) / (self.times * PAIRS)


def _unit(calls: Sequence[Callable[[int], None]], seconds: float) -> _Unit:
    """Run all once, and find out how often a block has to be evaluated to take that long."""

    def run(times: int) -> None:
        for call in calls:
            call(times)

    run(1)
    times, took = 1, 0.0
    while True:
        begin = time.thread_time()
        run(times)
        took = time.thread_time() - begin
        if took >= seconds or times >= 1 << 20:
            break
        times = math.ceil(times * min(16.0, max(1.5, 1.1 * seconds / max(took, 1e-9))))
    return _Unit(run, times)


def _call(fill: Any, block: Block, p: np.ndarray, precision: str) -> Callable[[int], None]:
    """What evaluates a block many times over."""
    out = np.empty(block.wo.shape[1:], precision)
    if not is_kernel(fill):

        def by_python(times: int) -> None:
            for _ in range(times):
                fill(block.wi, block.wo, block.h, p, out)

        return by_python
    compiled = fill if precision == "float64" else in_single(fill)
    code, repeat = address(compiled, _FILLS[precision]), _REPEAT[precision]
    rows = np.ascontiguousarray(p, dtype=precision)
    return lambda times: repeat(code, times, block.wi, block.wo, block.h, rows, out)


Key = tuple[str, str, str]
"""Label, precision and way."""


def samples(
    subjects: Sequence[Subject],
    *,
    ways: Sequence[str] = WAYS,
    repeats: int = 9,
    seconds: float = 1e-3,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
    alone: Callable[[], AbstractContextManager[object]] = nullcontext,
) -> dict[Key, np.ndarray]:
    """Time kernels, in turns.

    Parameters
    ----------
    subjects : sequence of Subject
        What to time; labels are distinct.
    ways : sequence of str
        Of `WAYS`.
    repeats : int
        Rounds, at least 7: quartiles of fewer say little.
    seconds : float
        How long one turn takes at least.
    seed : int
        Of the directions, and of the order of turns.
    progress : callable, optional
        Called with the number of steps done and of all steps: subjects made ready, and rounds.
    alone : callable, optional
        Gives what is entered for the rounds, when all is ready.

    Returns
    -------
    dict of (label, precision, way) to ndarray, shape (repeats,)
        Nanoseconds for one evaluation; element k of all arrays is of the same round. With the
        label ``""``, the empty kernel.

    Raises
    ------
    InputError
        For fewer than 7 rounds, turns without length, or labels that are there twice.
    """
    if repeats < 7:
        raise InputError(f"repeats = {repeats} is out of range; it must be at least 7")
    if not 0.0 < seconds <= 10.0:
        raise InputError(f"seconds = {seconds:g} is out of range; it must lie in (0, 10]")
    labels = [item.label for item in subjects]
    if len(set(labels)) < len(labels) or "" in labels:
        raise InputError(f"labels must be there and be distinct; they are {', '.join(labels)}")
    units: dict[Key, _Unit] = {}
    steps = len(subjects) + repeats
    (lambert,) = catalogue([REFERENCE])
    empty = Subject("", "", ((read_and_write, constant(_NOTHING)),), lambert.model)
    for done, item in enumerate([empty, *subjects]):
        for way in ways:
            if way == "lobe" and item.model is None:
                continue
            block = _block_of(item, way, seed)
            for precision in PRECISIONS if item.compiled else PRECISIONS[:1]:
                units[item.label, precision, way] = _prepared(item, block, way, precision, seconds)
        if progress is not None:
            progress(done, steps)
    found: dict[Key, list[float]] = {key: [] for key in units}
    order, keys = np.random.default_rng(seed), list(units)
    with alone():
        for done in range(repeats):
            for k in order.permutation(len(keys)):
                found[keys[k]].append(units[keys[k]].sample())
            if progress is not None:
                progress(len(subjects) + done + 1, steps)
    return {key: np.array(values) for key, values in found.items()}


# Kernels that read no parameters still get a row.
_NOTHING = np.zeros(1)


def _block_of(item: Subject, way: str, seed: int) -> Block:
    """The directions of a way: the same for all, but for those that a model draws."""
    rng = np.random.default_rng(seed)
    if way == "lobe":
        assert item.model is not None
        return lobe_block(item.model, rng)
    return random_block(rng, LIGHTS, VIEWS) if way == "shared" else random_block(rng)


def _prepared(item: Subject, block: Block, way: str, precision: str, seconds: float) -> _Unit:
    own = block.astype(precision)
    calls = [_call(fill, own, rows(block), precision) for fill, rows in item.fills]
    if way == "raw":
        calls.insert(0, _call(form_half_vector, own, constant(_NOTHING)(block), precision))
    return _unit(calls, seconds)


def spread(values: np.ndarray) -> tuple[float, float, float]:
    """Median, first and third quartile."""
    low, middle, high = (float(v) for v in np.quantile(values, (0.25, 0.5, 0.75)))
    return middle, low, high


def table(
    subjects: Sequence[Subject], found: Mapping[Key, np.ndarray], reference: str = REFERENCE
) -> pd.DataFrame:
    """What `samples` found, as one row for every subject, precision and way.

    Parameters
    ----------
    subjects : sequence of Subject
        What was timed, and shall be listed.
    found : mapping
        What `samples` gave.
    reference : str
        Label of the subject that ratios are to: it was timed as well.

    Returns
    -------
    pandas.DataFrame
        `COLUMNS`: ``ratio`` to the reference in the same precision and way, taken in every round;
        ``ns`` for one evaluation of all parts; ``_low`` and ``_high`` are quartiles of the rounds
        around medians. ``empty_ns`` is what one empty kernel takes. Where ``compiled`` is False
        values are not had by kernels alone.
    """
    import pandas as pd

    rows = []
    for item in subjects:
        for precision in PRECISIONS:
            for way in WAYS:
                values = found.get((item.label, precision, way))
                if values is None:
                    continue
                of = found[reference, precision, way]
                ratio, ns = spread(values / of), spread(values)
                empty, _, _ = spread(found["", precision, way])
                about = (len(item.fills), item.compiled)
                rows.append((item.label, item.spec, precision, way, *ratio, *ns, empty, *about))
    return pd.DataFrame(rows, columns=list(COLUMNS))


def measure(
    subjects: Sequence[Subject],
    *,
    repeats: int = 9,
    seconds: float = 1e-3,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> pd.DataFrame:
    """Time models beside `REFERENCE`, which is timed in any case.

    Parameters
    ----------
    subjects : sequence of Subject
        What `subject` or `catalogue` makes.
    repeats, seconds, seed, progress
        As in `samples`.

    Returns
    -------
    pandas.DataFrame
        As `table`. The directions depend on the seed alone; the times are those of this machine,
        now.

    Raises
    ------
    InputError
        As `samples`.
    """
    (lambert,) = catalogue([REFERENCE])
    # Under a name of its own: a caller's lambert may have another albedo.
    lambert = Subject(f"{REFERENCE} (reference)", lambert.spec, lambert.fills, lambert.model)
    options: dict[str, Any] = {"repeats": repeats, "seconds": seconds, "seed": seed}
    found = samples([lambert, *subjects], progress=progress, **options)
    return table(subjects, found, lambert.label)


def processor() -> str:
    """What the processor calls itself, as far as the system tells."""
    listing = Path("/proc/cpuinfo")
    if listing.is_file():
        for line in listing.read_text(encoding="utf-8", errors="replace").splitlines():
            name, _, value = line.partition(":")
            if name.strip() == "model name" and value.strip():
                return " ".join(value.split())
    return platform.processor() or platform.machine()


def versions() -> str:
    """What the kernels were compiled with."""
    import llvmlite
    import numba

    import albedo

    return (
        f"albedo {albedo.__version__}, numba {numba.__version__}, llvmlite "
        f"{llvmlite.__version__}, Python {platform.python_version()}"
    )


def save(frame: pd.DataFrame, path: Path) -> Path:
    """Write costs as CSV, below comments that say where they come from.

    Parameters
    ----------
    frame : pandas.DataFrame
        What `measure` gives.
    path : Path
        The file.

    Returns
    -------
    Path
        The file.
    """
    from albedo.files import save_text

    head = (
        "# Nanoseconds for one evaluation, and ratios to lambert: other machines give others.\n"
        f"# processor: {processor()}\n# versions: {versions()}\n"
    )
    # Four digits are more than timings have.
    text = frame.to_csv(index=False, lineterminator="\n", float_format="%.4g")
    return save_text(head + text, path)


def committed(path: Path = FILE) -> pd.DataFrame:
    """The costs that come with the package, or those of another file of `save`.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    pandas.DataFrame
        `COLUMNS`; ``attrs`` has the processor and the versions.

    Raises
    ------
    InputError
        When the file is missing or damaged.
    """
    import pandas as pd

    def damaged(what: str) -> InputError:
        return InputError(f"the costs in '{path.name}' {what}; `albedo cost -o FILE` writes such")

    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        raise damaged("cannot be read") from None
    comments = [line[1:].partition(":") for line in text.splitlines() if line.startswith("#")]
    about = {name.strip(): value.strip() for name, _, value in comments}
    try:
        frame = pd.read_csv(io.StringIO(text), comment="#", dtype=dict.fromkeys(_TEXTS, str))
    except (pd.errors.ParserError, pd.errors.EmptyDataError):
        raise damaged("are no table") from None
    # Cells that have no column would be an index.
    if not isinstance(frame.index, pd.RangeIndex):
        raise damaged("are no table")
    if tuple(frame.columns) != COLUMNS:
        raise damaged(f"have other columns than {', '.join(COLUMNS)}")
    for name in ("processor", "versions"):
        if not about.get(name):
            raise damaged(f"do not name their {name}")
    if frame.empty or frame[list(_TEXTS)].isna().any(axis=None):
        raise damaged("have no rows, or rows without names")
    if not (set(frame["precision"]) <= set(PRECISIONS) and set(frame["way"]) <= set(WAYS)):
        raise damaged(f"have other precisions or ways than {', '.join((*PRECISIONS, *WAYS))}")
    if frame.duplicated(["model", "spec", "precision", "way"]).any():
        raise damaged("have a row twice")
    for name in _TIMES:
        # Few rows may have nothing but whole numbers.
        if frame[name].dtype == np.int64:
            frame[name] = frame[name].astype(np.float64)
        if (
            frame[name].dtype != np.float64
            or not (np.isfinite(frame[name]) & (frame[name] > 0)).all()
        ):
            raise damaged(f"have a {name} that is no positive number")
    for name in ("ratio", "ns"):
        low, high = frame[f"{name}_low"], frame[f"{name}_high"]
        if not ((low <= frame[name]) & (frame[name] <= high)).all():
            raise damaged(f"have a {name} outside its quartiles")
    if frame["parts"].dtype != np.int64 or frame["compiled"].dtype != np.bool_:
        raise damaged("have parts that are no whole number, or are compiled neither True nor False")
    frame.attrs |= {name: about[name] for name in ("processor", "versions")}
    return frame
