"""Monte Carlo: a second way to every albedo, with a standard error and a verdict on itself.

A Dirac part has an energy that is known: only the finite part is estimated. A row of draws is cut
into blocks, each with a random stream of its own that its number gives, so that the same seed
gives the same bits whatever the number of threads. Stratified and quasi-random points are drawn in
`REPLICATES` independent sets: their means tell the standard error.

A strategy that does not see the lobe returns a wrong mean with a small standard error. So a pilot,
with draws of its own from the model's routines, n.v/pi and the whole sphere, foretells the
effective sample size of the strategy, (sum w)^2/sum w^2 in expectation; below `FEWEST` the result
is called unreliable. What the pilot does not see either, nothing here can tell. It also has a say
in the standard error of random draws, which on their own do not know of weights too rare for them.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from albedo._compile import kernel
from albedo.brdf import Model
from albedo.directions import spherical
from albedo.errors import ConvergenceWarning, DivergenceError, InputError
from albedo.estimate import Estimate
from albedo.quadrature import check_directions
from albedo.sampling.mixture import Mixture, Values, lift, mixture_of, weights
from albedo.sampling.routines import COSINE, SPHERE

SEQUENCES = ("random", "stratified", "sobol")
"""Points of the unit square: independent, one in each cell of a grid, or scrambled Sobol points."""

REPLICATES = 32
"""The least number of independent sets of stratified or quasi-random points."""

FEWEST = 100.0
"""Effective sample size below which a result is unreliable."""

DEFAULT_SAMPLES = 2**20
"""Draws per direction when neither their number nor a tolerance is given."""

_BUDGET = 2**30
_BLOCK = 2**15
# Draws whose arrays fit in a core's second cache, and are not given back to the system between.
_PIECE = 2**13
_PILOT = 4096
_FIRST = 2**12

# First numbers of the random streams: for draws, and for the pilot.
_DRAWS, _SCOUTS = 0, 1


@dataclass(frozen=True, eq=False)
class MonteCarloEstimate(Estimate):
    """An estimate with a standard error, and what its draws tell about it.

    Attributes
    ----------
    effective_samples : ndarray
        (sum w)^2/sum w^2 of the weights w.
    below_horizon : ndarray
        Share of the draws that lay below the horizon.
    reliable : ndarray of bool
        Whether the strategy sees the lobe: see `FEWEST`.
    strategy, sequence : str
        How directions were drawn.
    stopped : ndarray of str
        ``rtol`` or ``samples``: what ended the drawing.
    """

    effective_samples: np.ndarray = field(default_factory=lambda: np.zeros(0))
    below_horizon: np.ndarray = field(default_factory=lambda: np.zeros(0))
    reliable: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=bool))
    strategy: str = "model"
    sequence: str = "random"
    stopped: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype="U7"))

    def __str__(self) -> str:
        missed = int(np.size(self.reliable) - np.count_nonzero(self.reliable))
        if not missed:
            return super().__str__()
        of = "" if np.size(self.reliable) == 1 else f" in {missed} of {np.size(self.reliable)}"
        return super().__str__()[:-1] + f", unreliable{of}]"


@dataclass
class _Tally:
    """Sums over draws."""

    draws: int = 0
    total: float = 0.0
    squares: float = 0.0
    below: int = 0

    def add(self, other: _Tally) -> None:
        self.draws += other.draws
        self.total += other.total
        self.squares += other.squares
        self.below += other.below

    @property
    def mean(self) -> float:
        return self.total / self.draws

    @property
    def effective(self) -> float:
        return self.total * self.total / self.squares if self.squares > 0.0 else 0.0


@dataclass(frozen=True)
class _Row:
    """One direction of one model, ready to be sampled."""

    model: Model
    f: Values
    wi: np.ndarray
    mixture: Mixture
    seed: int
    number: int
    swap: bool

    def tally(self, points: np.ndarray) -> _Tally:
        """Sums over points (2, count)."""
        total = _Tally()
        for first in range(0, points.shape[1], _PIECE):
            u = np.ascontiguousarray(points[:, None, first : first + _PIECE])
            wo, h = self.mixture.draw(self.wi, u)
            density = self.mixture.density(self.wi, wo, h)
            f, below = self.values(wo, h)
            total.add(_Tally(u.shape[2], *_sums(f, wo[2], density, below)))
        return total

    def values(self, wo: np.ndarray, h: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """f with the given direction as light, or as view, and which draws are below the horizon.

        Those are lifted above it.
        """
        below = np.empty(wo.shape[1:], dtype=bool)
        lift(self.wi, wo, h, below)
        if not self.swap:
            return self.f(self.wi, wo, h), below
        count = below.size
        light, half = wo.reshape(3, count), h.reshape(3, count, 1)
        view = np.repeat(self.wi, count, axis=1).reshape(3, count, 1)
        return self.f(light, view, half).reshape(below.shape), below

    def stream(self, *key: int) -> np.random.Generator:
        """The random stream of a block: its place in the work gives its bits."""
        sequence = np.random.SeedSequence(self.seed, spawn_key=(self.number, *key))
        return np.random.Generator(np.random.PCG64(sequence))


@kernel
def _sums(f, n_dot_v, density, below):
    """Sums of weights and of their squares, and how many draws are below the horizon."""
    total = squares = 0.0
    lost = 0
    for k in range(f.shape[0]):
        for i in range(f.shape[1]):
            if below[k, i]:
                lost += 1
            elif f[k, i] > 0.0:
                w = f[k, i] * n_dot_v[k, i] / density[k, i]
                total += w
                squares += w * w
    return total, squares, lost


def _random_blocks(row: _Row, first: int, count: int) -> Iterator[Callable[[], _Tally]]:
    """Blocks of independent points from the block number `first` on."""
    for block in range(first, first + -(-count // _BLOCK)):
        size = min(_BLOCK, count - (block - first) * _BLOCK)

        def work(block: int = block, size: int = size) -> _Tally:
            return row.tally(row.stream(_DRAWS, block).random((2, size)))

        yield work


def _grid(count: int) -> tuple[int, int]:
    """Rows and columns of about `count` cells, no more."""
    rows = max(1, math.isqrt(count))
    return rows, count // rows


def _replicate(row: _Row, sequence: str, turn: int, number: int, count: int) -> _Tally:
    """Sums over one set of stratified or quasi-random points."""
    stream = row.stream(_DRAWS, turn, number)
    tally = _Tally()
    if sequence == "sobol":
        from scipy.stats import qmc

        engine = qmc.Sobol(2, scramble=True, bits=52, rng=stream)
        for first in range(0, count, _BLOCK):
            points = engine.random(min(_BLOCK, count - first))
            tally.add(row.tally(np.minimum(points.T, 1.0 - 2.0**-53).copy()))
        return tally
    rows, columns = _grid(count)
    for first in range(0, rows * columns, _BLOCK):
        cell = np.arange(first, min(first + _BLOCK, rows * columns))
        points = stream.random((2, cell.size))
        points[0] = np.minimum((cell // columns + points[0]) / rows, 1.0 - 2.0**-53)
        points[1] = np.minimum((cell % columns + points[1]) / columns, 1.0 - 2.0**-53)
        tally.add(row.tally(points))
    return tally


def _map(pool: ThreadPoolExecutor | None, work: Iterator[Callable[[], _Tally]]) -> Iterator[_Tally]:
    """Results in the order of the work; a pool is given a few blocks at a time."""
    if pool is None:
        for one in work:
            yield one()
        return
    waiting: list[Any] = []
    for one in work:
        waiting.append(pool.submit(one))
        if len(waiting) > 64:
            yield waiting.pop(0).result()
    for future in waiting:
        yield future.result()


def _sample(
    row: _Row,
    sequence: str,
    turn: int,
    done: int,
    count: int,
    pool: ThreadPoolExecutor | None,
    progress: Callable[[int], None],
) -> tuple[_Tally, float]:
    """Sums over `count` draws, and the variance of their mean (0 for random ones: see there)."""
    total = _Tally()
    if sequence == "random":
        for tally in _map(pool, _random_blocks(row, done // _BLOCK, count)):
            total.add(tally)
            progress(tally.draws)
        return total, 0.0
    each, sets = max(count // REPLICATES, 1), REPLICATES
    if sequence == "sobol":
        # Sets of 2^k points are balanced; as many sets as there are draws for.
        each = 2 ** int(math.log2(each))
        sets = max(count // each, REPLICATES)

    def replicate(number: int) -> Callable[[], _Tally]:
        return lambda: _replicate(row, sequence, turn, number, each)

    means = []
    for tally in _map(pool, (replicate(number) for number in range(sets))):
        total.add(tally)
        means.append(tally.mean)
        progress(tally.draws)
    return total, float(np.var(means, ddof=1)) / sets


@dataclass(frozen=True)
class _Pilot:
    """What draws from elsewhere tell of a strategy.

    Attributes
    ----------
    share : float
        Effective samples per draw.
    effective : float
        Effective samples of the pilot itself, which limit what it can know.
    weight, ratio : ndarray
        Weights that the strategy would give to the draws of the pilot, and its density over
        theirs.
    """

    share: float
    effective: float
    weight: np.ndarray
    ratio: np.ndarray

    def variance(self, mean: float) -> float:
        """Variance of the weights of the strategy about their mean."""
        return float(np.mean((self.weight - mean) ** 2 * self.ratio))


def _scout(row: _Row) -> _Pilot:
    """Draw the pilot of a row."""
    own = mixture_of(row.model)
    shares = (*(share / 3.0 for share in own.shares), 1.0 / 3.0, 1.0 / 3.0)
    scout = Mixture(shares, (*own.routines, COSINE, SPHERE))
    u = row.stream(_SCOUTS).random((2, 1, _PILOT))
    wo, h = scout.draw(row.wi, u)
    drawn, density = scout.density(row.wi, wo, h), row.mixture.density(row.wi, wo, h)
    f, below = row.values(wo, h)
    pilot, weight = weights(f, wo, drawn, below), weights(f, wo, density, below)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(drawn > 0.0, density / drawn, 0.0)
    # Where the strategy draws nothing its weights count for nothing here, and for all below.
    told = {"weight": np.where(ratio > 0.0, weight, 0.0), "ratio": ratio}
    top = float(pilot.max())
    if top == 0.0:
        # Nothing is there, or nothing is seen: a declared lobe would have been.
        dark = row.model.resolved_width is None
        return _Pilot(float(dark), float(_PILOT) * dark, **told)
    # As shares of the largest, so that no square underflows.
    pilot /= top
    second = float(np.mean(pilot * np.where(pilot > 0.0, weight / top, 0.0)))
    mean = float(pilot.mean())
    share = mean * mean / second if math.isfinite(second) and second > 0.0 else 0.0
    return _Pilot(share, _PILOT * mean * mean / float(np.mean(pilot * pilot)), **told)


def monte_carlo_albedo(
    model: Model,
    cos_theta: ArrayLike,
    phi: ArrayLike = 0.0,
    *,
    samples: int | None = None,
    rtol: float | None = None,
    strategy: str = "model",
    sequence: str = "random",
    seed: int = 0,
    fixed: str = "light",
    threads: int = 1,
    progress: Callable[[int], None] | None = None,
) -> MonteCarloEstimate:
    r"""Directional albedo by Monte Carlo: the mean of f n.v/pdf over directions that are drawn.

    Parameters
    ----------
    model : Model
        A model of the catalogue, or one made by `albedo.model_from`.
    cos_theta : array_like
        Cosines of the angle of incidence, in [1e-60, 1].
    phi : array_like
        Azimuth in radians; it broadcasts with `cos_theta`.
    samples : int, optional
        Draws per direction: all of them, or the most when `rtol` is given (then 2^30 by default);
        2^20 when neither is. Stratified and quasi-random points come in `REPLICATES` sets or
        more, of equally many points: what does not fill a set is not drawn.
    rtol : float, optional
        Stop when the standard error is at most this share of the mean; looked at first after
        32,768 random or 4,096 other draws, and whenever their number has doubled.
    strategy : {"model", "cosine", "uniform", "mixture"}
        See `albedo.sampling.mixture.STRATEGIES`.
    sequence : {"random", "stratified", "sobol"}
        See `SEQUENCES`.
    seed : int
        Same seed, same bits, whatever the number of threads.
    fixed : {"light", "view"}
        Which direction is given; the other one is drawn.
    threads : int
        Threads that share the work.
    progress : callable, optional
        Called with the number of draws made since the last call.

    Returns
    -------
    MonteCarloEstimate
        Arrays shaped as the broadcast of `cos_theta` and `phi`, of kind ``standard_error``; with
        a leading axis of channels where a colour of the model has several. `evaluations` counts
        draws, those of the pilot left out.

    Raises
    ------
    InputError
        For input out of range.
    DivergenceError
        At cos_theta = 0, where no direction can be drawn.

    Warns
    -----
    ConvergenceWarning
        When a result is unreliable, or a tolerance was not met.

    Examples
    --------
    >>> import albedo
    >>> found = albedo.monte_carlo_albedo(albedo.model("lambert", rho=0.5), 0.7, samples=1000)
    >>> print(found)
    0.500000000000(1) [standard_error]
    """
    c, p = check_directions(cos_theta, phi)
    _check(samples, rtol, sequence, seed, fixed, threads)
    if np.any(c == 0.0):
        raise DivergenceError("cos_theta = 0 has no directions to draw; take one above 0")
    c, p = np.broadcast_arrays(c, p)
    kinds = model.by_channel()
    # Looked at before anything is drawn.
    mixtures = [mixture_of(kind, strategy) for kind in kinds]
    values = [Values(kind) for kind in kinds]
    shape = c.shape if model.channels is None else (len(kinds), *c.shape)
    found: list[tuple[Any, ...]] = []
    pool = ThreadPoolExecutor(threads) if threads > 1 else None
    try:
        for k, kind in enumerate(kinds):
            for i, (mu, turn) in enumerate(zip(c.ravel(), p.ravel(), strict=True)):
                wi = np.ascontiguousarray(spherical(mu, turn).reshape(3, 1))
                number = k * c.size + i
                row = _Row(kind, values[k], wi, mixtures[k], seed, number, fixed == "view")
                report = progress or (lambda _: None)
                found.append(_estimate(row, samples, rtol, sequence, pool, report))
    finally:
        if pool is not None:
            pool.shutdown(cancel_futures=True)
    value, error, draws, converged, effective, below, reliable, stopped = (
        np.array(column).reshape(shape) for column in zip(*found, strict=True)
    )
    result = MonteCarloEstimate(
        *(value, error, "standard_error", draws, converged, model.resolved_width, {}),
        *(effective, below, reliable, strategy, sequence, stopped),
    )
    _warn(result, rtol)
    return result


def _check(
    samples: int | None, rtol: float | None, sequence: str, seed: int, fixed: str, threads: int
) -> None:
    whole = samples is None or (isinstance(samples, int | np.integer) and samples >= 2)
    if not whole or isinstance(samples, bool):
        raise InputError(f"samples = {samples!r} is out of range; it must be a whole number >= 2")
    if sequence not in SEQUENCES:
        raise InputError(f"sequence = {sequence!r} is unknown; choose {', '.join(SEQUENCES)}")
    if sequence != "random" and samples is not None and samples < 2 * REPLICATES:
        raise InputError(
            f"samples = {samples} is too few for {REPLICATES} sets of {sequence} points; it must "
            f"be at least {2 * REPLICATES}"
        )
    if rtol is not None and not (isinstance(rtol, int | float) and 0.0 < rtol < 1.0):
        raise InputError(f"rtol = {rtol!r} is out of range; it lies in (0, 1)")
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(f"seed = {seed!r} is out of range; it must be a whole number >= 0")
    if fixed not in ("light", "view"):
        raise InputError(f"fixed = {fixed!r} is unknown; choose light or view")
    if not isinstance(threads, int) or not 1 <= threads <= 256:
        raise InputError(f"threads = {threads!r} is out of range; it lies in [1, 256]")


def _estimate(
    row: _Row,
    samples: int | None,
    rtol: float | None,
    sequence: str,
    pool: ThreadPoolExecutor | None,
    progress: Callable[[int], None],
) -> tuple[Any, ...]:
    """Value, standard error, draws and the verdict of one row."""
    known, doubt = _known(row)
    limit = samples or (DEFAULT_SAMPLES if rtol is None else _BUDGET)
    if not row.model.parts():
        enough = rtol is None or doubt <= rtol * abs(known)
        return known, doubt, 0, enough, 0.0, 0.0, True, "rtol" if rtol else "samples"
    pilot = _scout(row)
    total, spent, turn, size = _Tally(), 0, 0, limit
    if rtol is not None:
        size = min(limit, max(_FIRST, _BLOCK if sequence == "random" else 0))
    while True:
        tally, variance = _sample(row, sequence, turn, total.draws, size, pool, progress)
        spent += tally.draws
        if sequence == "random":
            # Blocks go on where the last ones ended: all draws count.
            total.add(tally)
            variance = _variance(total, pilot) / max(total.draws - 1, 1)
        else:
            # Other points are drawn anew, twice as many: only the last ones count.
            total = tally
        value, error = known + total.mean, math.sqrt(variance) + doubt
        error += 4.0 * np.finfo(float).eps * abs(value)
        met = rtol is not None and error <= rtol * abs(value)
        left = limit - total.draws if sequence == "random" else limit // (2 * total.draws)
        if rtol is None or met or left < 1:
            break
        turn += 1
        size = min(total.draws, left) if sequence == "random" else 2 * total.draws
    foretold = total.draws * min(pilot.share, pilot.effective / _PILOT)
    # A model that sends nothing has no weights.
    seen = total.effective >= FEWEST or (total.total == 0.0 and pilot.share == 1.0)
    reliable = foretold >= FEWEST and seen
    converged = reliable and (rtol is None or met)
    return (
        *(value, error, spent, converged, total.effective, total.below / total.draws),
        *(reliable, "rtol" if met else "samples"),
    )


def _variance(total: _Tally, pilot: _Pilot) -> float:
    """Variance of the weights, from the draws and, as if they were draws too, from the pilot.

    Where one draw in ten thousand has another weight than all others, a thousand draws do not show
    it; the pilot looks elsewhere.
    """
    own = max(total.squares / total.draws - total.mean**2, 0.0)
    other = pilot.variance(total.mean)
    return max(own, (total.draws * own + _PILOT * other) / (total.draws + _PILOT))


def _known(row: _Row) -> tuple[float, float]:
    """Energy of the Dirac parts, and its error."""
    wi = row.wi.T
    energies = row.model.spikes(wi)[1]
    if not len(energies):
        return 0.0, 0.0
    return float(energies.sum()), float(row.model.spike_errors(wi, energies).sum())


def _warn(result: MonteCarloEstimate, rtol: float | None) -> None:
    unreliable = int(np.size(result.reliable) - np.count_nonzero(result.reliable))
    if unreliable:
        warnings.warn(
            f"{unreliable} of {np.size(result.reliable)} values are unreliable: the draws of "
            f"strategy {result.strategy!r} hardly see the lobe; see MonteCarloEstimate.reliable",
            ConvergenceWarning,
            stacklevel=3,
        )
    missed = int(np.count_nonzero(result.stopped == "samples")) if rtol is not None else 0
    if missed:
        warnings.warn(
            f"{missed} of {np.size(result.stopped)} values missed rtol={rtol:g} within their draws",
            ConvergenceWarning,
            stacklevel=3,
        )
