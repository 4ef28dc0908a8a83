"""Checks of a BRDF and of its sampling, ours or anyone's: each with what was measured.

A statistical check states its level: the chance that it fails for a correct program. Where several
are made, the level of each is that of all over their number (Bonferroni).
"""

from __future__ import annotations

import importlib.util
import math
import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from albedo.brdf import Model
from albedo.directions import spherical
from albedo.errors import ConvergenceWarning, InputError
from albedo.integrators.adaptive import integrate
from albedo.integrators.monte_carlo import monte_carlo_albedo
from albedo.quadrature import directional_albedo
from albedo.sampling.mixture import Mixture, mixture_of, routines_of, spike_probability
from albedo.sampling.routines import COSINE, UNIFORM

Draw = Callable[[np.ndarray, np.ndarray], np.ndarray]
Density = Callable[[np.ndarray, np.ndarray], np.ndarray]

# Draws that a cell of the partition should hold, and the fewest that a category must expect.
_PER_CELL, _FEWEST = 100, 10.0
# Pilot draws in a box over which the density is integrated.
_PER_BOX = 4
_DEEPEST = 60
# Of what is expected in a cell, the error of the integral of the density: far below its spread.
_RTOL = 1e-4

LOOSE = 0.01
"""Most that the integral of a density may be uncertain by, for a test of draws against it."""

_COSINES = np.array([0.95, 0.6, 0.25, 0.05])
_TURNS = np.array([0.3, 1.2, 2.5, 4.0])


@dataclass(frozen=True)
class Check:
    """One check: what it is, what came out, and whether that is right.

    Attributes
    ----------
    name : str
    passed : bool or None
        None where there was nothing to hold the measurement to.
    measured : str
        What was found, in words.
    """

    name: str
    passed: bool | None
    measured: str


@dataclass(frozen=True)
class Cell:
    """A cell of the hemisphere, and the draws in it.

    Attributes
    ----------
    box : tuple of float
        From and to which azimuth in radians, from and to which 1 - z.
    expected, seen : float
        How many the density leaves, and how many there are.
    """

    box: tuple[float, float, float, float]
    expected: float
    seen: float


@dataclass(frozen=True)
class ChiSquare:
    """Pearson's test of draws against a density.

    Attributes
    ----------
    statistic, p_value : float
        The sum of (seen - expected)^2/expected, and the chance of one as large.
    degrees : int
        Degrees of freedom: categories less one.
    level : float
        The p-value below which the test fails.
    undensified : int
        Draws above the horizon at which the density is 0; any is a failure.
    above, bound : float
        Integral of the density over the upper hemisphere, and its bound: where that is more than
        `LOOSE`, nothing is known of the draws, and the test fails.
    draws, lost : int
        How many were counted, and how many of them below the horizon or in a Dirac part.
    worst : Cell
        Of what adds most to the statistic, the cell that is furthest off.
    """

    statistic: float
    p_value: float
    degrees: int
    level: float
    undensified: int
    above: float
    bound: float
    draws: int
    lost: int
    worst: Cell

    @property
    def passed(self) -> bool:
        """Whether draws and density may belong together."""
        sound = self.undensified == 0 and self.bound <= LOOSE
        return sound and self.p_value >= self.level

    def __str__(self) -> str:
        lost = f", {self.undensified} draws where the density is 0" if self.undensified else ""
        if not self.bound <= LOOSE:
            lost += f", the integral of the density is uncertain by {self.bound:.2g}"
        return (
            f"chi-square {self.statistic:.4g} with {self.degrees} degrees of freedom, "
            f"p = {self.p_value:.3g} (fails below {self.level:.2g}){lost}"
        )


class _Partition:
    """Cells of the hemisphere in (azimuth, 1 - z) as a chart: one cell, one integral."""

    def __init__(self, box: np.ndarray) -> None:
        self.box = box

    def panels(
        self,
        cos_theta: np.ndarray,
        phi: np.ndarray,
        widths: np.ndarray,
        isotropic: bool,
        coarse: bool = False,
        fine: bool = False,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        m = len(self.box)
        return np.zeros((m, 1)), np.arange(m), np.ones((m, 4), dtype=np.int64), self.box

    def nodes(
        self, geometry: np.ndarray, code: np.ndarray, box: np.ndarray, u: np.ndarray, v: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        m = len(box)
        turn = (box[:, :1] + (box[:, 1:2] - box[:, :1]) * u)[:, :, None]
        less = (box[:, 2:3] + (box[:, 3:4] - box[:, 2:3]) * v)[:, None, :]
        s = np.sqrt(less * (2.0 - less))
        wo = np.empty((3, m, u.size, v.size))
        wo[0], wo[1], wo[2] = np.cos(turn) * s, np.sin(turn) * s, 1.0 - less
        area = (box[:, 1] - box[:, 0]) * (box[:, 3] - box[:, 2])
        flat = wo.reshape(3, m, -1)
        return np.zeros((3, m)), flat, flat, np.repeat(area[:, None], flat.shape[2], axis=1)


def _place(wo: np.ndarray) -> np.ndarray:
    """Azimuth in [0, 2 pi) and 1 - z, without cancellation near the normal, as (n, 2)."""
    turn = np.arctan2(wo[:, 1], wo[:, 0]) % (2.0 * math.pi)
    near = wo[:, 2] > 0.5
    tangential = wo[:, 0] ** 2 + wo[:, 1] ** 2
    less = np.where(near, tangential / (1.0 + wo[:, 2]), 1.0 - wo[:, 2])
    return np.stack((turn, less), axis=1)


@dataclass
class _Cells:
    """A partition of the hemisphere, and finer boxes over which a density is integrated."""

    box: np.ndarray
    cell: np.ndarray
    seen: np.ndarray
    place: np.ndarray


def _halve(pilot: np.ndarray, points: np.ndarray) -> _Cells:
    """Halve the hemisphere until no cell holds more than `_PER_CELL` of the pilot.

    Cells are halved further, until a box holds next to none of it, so that a rule on a box sees a
    lobe that fills a corner of a cell. `points` are counted in the cells.
    """
    whole = np.array([0.0, 2.0 * math.pi, 0.0, 1.0])
    todo: list[tuple[np.ndarray, np.ndarray, np.ndarray, int, int]] = [
        (whole, pilot, points, 0, -1)
    ]
    boxes: list[np.ndarray] = []
    cells: list[int] = []
    seen: list[int] = []
    places: list[np.ndarray] = []
    while todo:
        box, inside, counted, depth, cell = todo.pop()
        if cell < 0 and (len(inside) <= _PER_CELL or depth >= _DEEPEST):
            cell = len(seen)
            seen.append(len(counted))
            places.append(box)
        if cell >= 0 and (len(inside) <= _PER_BOX or depth >= _DEEPEST):
            boxes.append(box)
            cells.append(cell)
            continue
        axis = depth % 2
        middle = 0.5 * (box[2 * axis] + box[2 * axis + 1])
        low, high = box.copy(), box.copy()
        low[2 * axis + 1] = high[2 * axis] = middle
        left, below = inside[:, axis] < middle, counted[:, axis] < middle
        todo.append((low, inside[left], counted[below], depth + 1, cell))
        todo.append((high, inside[~left], counted[~below], depth + 1, cell))
    return _Cells(
        *(np.array(boxes), np.array(cells), np.array(seen, dtype=float), np.array(places))
    )


def chi_square(
    draw: Draw,
    density: Density,
    cos_theta: float,
    phi: float = 0.0,
    *,
    samples: int = 100_000,
    level: float = 1e-3,
    tests: int = 1,
    seed: int = 0,
) -> ChiSquare:
    """Test draws against the density that they are said to have.

    Parameters
    ----------
    draw : callable
        ``draw(u, wi) -> wo``: directions (n, 3) for points (n, 2) of the unit square; NaN where a
        draw is a Dirac part. Of a model: ``checks.finite_draws(model)``.
    density : callable
        ``density(wi, wo)`` in 1/sr, for wi (3,) and wo (n, 3). Of a model: ``model.pdf``.
    cos_theta, phi : float
        The fixed direction.
    samples : int
        Draws; a quarter of them, with points of their own, lays out the cells.
    level : float
        Chance of a failure for a correct program.
    tests : int
        How many tests share that level.
    seed : int

    Returns
    -------
    ChiSquare
        Cells are halved until each holds a hundred draws; those that expect fewer than ten are
        merged; draws below the horizon and Dirac parts are a category, and its expectation is what
        the density leaves: an integral that is not the share of the others fails as well.
    """
    wi = spherical(cos_theta, phi)
    rng = np.random.default_rng(seed)
    first, second = (np.asarray(draw(rng.random((n, 2)), wi)) for n in (samples // 4, samples))
    return compare(first, second, density, wi, level=level / tests)


def compare(
    pilot: np.ndarray,
    draws: np.ndarray,
    density: Density,
    wi: np.ndarray,
    *,
    level: float,
    fewest: float = _FEWEST,
) -> ChiSquare:
    """Test directions that were drawn against the density that they are said to have.

    Parameters
    ----------
    pilot, draws : ndarray, shape (n, 3)
        Independent draws: of the pilot, which lays out the cells, and those that are counted. NaN
        where a draw is a Dirac part.
    density : callable
        ``density(wi, wo)`` in 1/sr, for wi (3,) and wo (n, 3).
    wi : ndarray, shape (3,)
    level : float
        The p-value below which the test fails.
    fewest : float
        Cells that expect fewer draws are merged.

    Returns
    -------
    ChiSquare
        See `chi_square`.
    """
    from scipy import stats

    # Comparisons with NaN are false: Dirac parts are not above.
    first, above = pilot[pilot[:, 2] > 0.0], draws[draws[:, 2] > 0.0]
    values = np.asarray(density(wi, above)) if len(above) else np.zeros(0)
    undensified = int(np.count_nonzero(~(values > 0.0)))
    cells = _halve(_place(first), _place(above))
    value, bound = _integrals(density, wi, cells.box)
    lost, count = len(draws) - len(above), len(cells.seen)
    expected = np.bincount(cells.cell, weights=value, minlength=count) * len(draws)
    error = np.bincount(cells.cell, weights=bound, minlength=count) * len(draws)
    # What no cell is expected to hold lies below the horizon, or is a Dirac part.
    expected = np.append(expected, max(len(draws) - expected.sum(), 0.0))
    seen, error = np.append(cells.seen, lost), np.append(error, error.sum())
    category = _merged(expected, fewest)
    together, counted, granted = (np.bincount(category, weights=a) for a in (expected, seen, error))
    # What the integrals may be off by is not held against the draws.
    off = np.maximum(np.abs(counted - together) - granted, 0.0)
    terms = off**2 / np.maximum(together, 1e-300)
    statistic, degrees = float(np.sum(terms)), max(len(terms) - 1, 1)
    # A density that integrates to more than 1 leaves less than nothing below.
    whole, uncertain = float(value.sum()), float(bound.sum())
    excess = whole - 1.0 > uncertain + 1e-9
    p = 0.0 if excess else float(stats.chi2.sf(statistic, degrees))
    # Of cells that are counted together the one with the most draws too many or too few.
    rank = np.lexsort((np.abs(seen - expected)[:count], terms[category[:count]]))
    k = int(rank[-1])
    worst = Cell(tuple(cells.place[k].tolist()), float(expected[k]), float(seen[k]))
    return ChiSquare(
        *(statistic, p, degrees, level, undensified, whole, uncertain),
        *(len(draws), lost, worst),
    )


def _merged(expected: np.ndarray, fewest: float) -> np.ndarray:
    """Which category each is counted in: the rarest are merged until each expects enough."""
    rank = np.argsort(-expected)
    many = int(np.count_nonzero(expected >= fewest))
    if many < len(rank) and expected[rank[many:]].sum() < fewest and many > 0:
        many -= 1
    category = np.empty(len(rank), dtype=int)
    category[rank] = np.minimum(np.arange(len(rank)), many)
    return category


def _integrals(density: Density, wi: np.ndarray, box: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Integrals of the density over all cells, with their bounds."""

    def over_cells(row: Any, light: Any, wo: np.ndarray, h: Any) -> np.ndarray:
        flat = np.moveaxis(wo, 0, -1).reshape(-1, 3)
        return np.asarray(density(wi, flat), dtype=float).reshape(wo.shape[1:])

    m = len(box)
    found = integrate(
        *(_Partition(box), over_cells, np.ones(m), np.zeros(m), np.ones((m, 2)), False),
        rtol=_RTOL,
        atol=1e-7,
        limit=40_000,
        probe=False,
    )
    return found.value, found.error


def above_horizon(
    model: Model, cos_theta: float, phi: float = 0.0, rtol: float = 1e-8
) -> tuple[float, float]:
    """The probability that a draw of a model lies above the horizon, Dirac parts included.

    Parameters
    ----------
    model : Model
        Without channels.
    cos_theta, phi : float
        The light direction.
    rtol : float
        Relative error of the integral of each routine's density.

    Returns
    -------
    value, error : float
        The integral of the density, each routine in the chart of the part that it is for, and its
        bound.
    """
    wi = spherical(cos_theta, phi)
    energies = model.spikes(wi[None])[1]
    share = (
        float(spike_probability(energies.sum(0), bool(model.parts()))[0]) if len(energies) else 0
    )
    mixture = mixture_of(model)
    found = {routine: part for part in reversed(model.parts()) for routine in routines_of(part)}
    value = error = 0.0
    for own, routine in zip(mixture.shares, mixture.routines, strict=True):
        if routine in (COSINE, UNIFORM):
            value += own
            continue
        alone, part = Mixture((1.0,), (routine,)), found[routine]

        def over_cosine(
            row: Any, light: np.ndarray, wo: np.ndarray, h: np.ndarray, alone: Mixture = alone
        ) -> np.ndarray:
            with np.errstate(divide="ignore", invalid="ignore"):
                return np.where(wo[2] > 0.0, alone.density(light, wo, h) / wo[2], 0.0)

        result = integrate(
            *(part.chart, over_cosine, np.array([cos_theta]), np.array([phi])),
            *(np.array([part.widths]), model.isotropic),
            rtol=rtol,
            atol=0.0,
            limit=400_000,
        )
        value += own * float(result.value[0])
        error += own * float(result.error[0])
    return share + (1.0 - share) * value, (1.0 - share) * error


def finite_draws(model: Model) -> Draw:
    """The draws of a model as `chi_square` wants them: NaN for a Dirac part."""

    def draw(u: np.ndarray, wi: np.ndarray) -> np.ndarray:
        found = model.sample(u, wi)
        return np.where(np.isinf(found.pdf)[:, None], np.nan, found.wo)

    return draw


def asymmetry(model: Model, seed: int = 0, count: int = 20_000) -> float:
    """The largest |f(l, v) - f(v, l)| over the larger of them, where that is not negligible.

    Parameters
    ----------
    model : Model
    seed, count : int
        So many random pairs of directions, some of them drawn by the model's own sampling.
    """
    rng = np.random.default_rng(seed)
    light = spherical(np.sqrt(rng.random(count)), 2.0 * math.pi * rng.random(count))
    own = model.sample(rng.random((count, 2)), light)
    other = spherical(np.sqrt(rng.random(count)), 2.0 * math.pi * rng.random(count))
    use = np.isfinite(own.pdf) & (own.wo[:, 2] > 1e-3) & (rng.random(count) < 0.5)
    view = np.where(use[:, None], own.wo, other)
    view /= np.linalg.norm(view, axis=1)[:, None]
    there, back = model.eval(light, view), model.eval(view, light)
    larger = np.maximum(there, back)
    keep = larger > 1e-6 * larger.max(initial=0.0)
    return float(np.max(np.abs(there - back)[keep] / larger[keep], initial=0.0))


def reciprocity(model: Model, seed: int = 0, count: int = 20_000) -> Check:
    """Whether f(l, v) and f(v, l) are the same; see `asymmetry`."""
    worst = asymmetry(model, seed, count)
    said = f"f(l, v) and f(v, l) differ by at most {worst:.2g} of the larger"
    # Half vectors from raw directions lose digits; see `albedo.directions.half_vector`.
    return Check("reciprocity", worst <= 1e-6 if model.reciprocal else None, said)


def energy(model: Model) -> Check:
    """The largest albedo over directions, beside what the model promises."""
    cosines = np.array([1.0, 0.97, 0.9, 0.7, 0.5, 0.35, 0.2, 0.1, 0.03, 1e-2, 1e-4, 1e-7])
    turns = np.zeros(1) if model.isotropic else np.linspace(0.0, math.pi, 5)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        found = directional_albedo(model, cosines, turns[:, None], rtol=1e-6, atol=1e-9)
    at = np.unravel_index(int(np.argmax(found.value)), found.value.shape)
    value, error = float(found.value[at]), float(found.error[at])
    said = f"the largest of {found.value.size} albedos is {value:.9g} +- {error:.1g}, "
    said += f"at cos theta = {cosines[at[-1]]:g}"
    passed = value - error <= 1.0 if model.conserves_energy else None
    return Check("energy", passed, said)


def sampling(model: Model, level: float = 1e-3, seed: int = 0) -> list[Check]:
    """Weights, densities and draws of a model, at four directions of incidence."""
    from scipy import stats

    directions = list(zip(_COSINES.tolist(), _TURNS.tolist(), strict=True))
    worst, count, scores = 0.0, 0, []
    rng = np.random.default_rng(seed)
    for mu, turn in directions:
        wi = spherical(mu, turn)
        found = model.sample(rng.random((2000, 2)), wi)
        share, bound = above_horizon(model, mu, turn, rtol=1e-6)
        seen = float(np.mean(found.wo[:, 2] > 0.0))
        spread = math.sqrt(max(share * (1.0 - share), 1.0 / 2000) / 2000)
        scores.append((abs(seen - share) - bound) / spread)
        finite = np.isfinite(found.pdf) & (found.wo[:, 2] > 0.0)
        if finite.any():
            wo = found.wo[finite]
            value = model.eval(wi, wo) * wo[:, 2] / found.pdf[finite]
            off = np.abs(value - found.weight[finite]) / max(float(value.max()), 1e-300)
            worst, count = max(worst, float(off.max())), count + int(finite.sum())
    said = f"weights and f n.v/pdf of {count} draws differ by at most {worst:.2g} of the largest"
    checks = [Check("weights", worst <= 1e-6, said)]
    limit = float(stats.norm.isf(0.5 * level / len(scores)))
    said = "shares of draws above the horizon are off from the integrals of the density by at most "
    said += f"{max(*scores, 0.0):.2f} standard errors (at most {limit:.2f})"
    checks.append(Check("above the horizon", max(scores) <= limit, said))
    if not model.parts():
        return checks
    for k, (mu, turn) in enumerate(directions):
        result = chi_square(
            *(finite_draws(model), model.pdf, mu, turn),
            level=level,
            tests=len(directions),
            seed=seed + k,
        )
        checks.append(Check(f"draws at cos theta = {mu:g}", result.passed, str(result)))
    return checks


def agreement(model: Model, level: float = 1e-3, seed: int = 0) -> Check:
    """Monte Carlo beside quadrature at 32 directions: how often it is off by two standard errors.

    Directions at which Monte Carlo calls itself unreliable are left out.
    """
    from scipy import stats

    cosines = np.linspace(0.05, 1.0, 32)
    turns = np.linspace(0.0, 6.0, 32)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        exact = directional_albedo(model, cosines, turns, rtol=1e-6, atol=1e-9)
        found = monte_carlo_albedo(model, cosines, turns, samples=2**14, seed=seed)
    off = np.abs(found.value - exact.value) - exact.error
    # Zero variance leaves only rounding.
    scores = off / np.maximum(found.error, 1e-9 * np.maximum(np.abs(exact.value), 1e-300))
    scores = scores[found.reliable]
    if not scores.size:
        return Check("Monte Carlo", None, "unreliable at all of 32 directions")
    exceeded = int(np.count_nonzero(scores > 2.0))
    chance = 2.0 * float(stats.norm.sf(2.0))
    most = int(stats.binom.isf(0.5 * level, scores.size, chance))
    top = float(stats.norm.isf(0.25 * level / scores.size))
    said = f"{exceeded} of {scores.size} are off by more than two standard errors (at most {most})"
    said += f", the worst by {max(float(scores.max()), 0.0):.2f} (at most {top:.2f})"
    return Check("Monte Carlo", exceeded <= most and float(scores.max()) <= top, said)


def table(model: Model) -> Check:
    """A table of albedos to 1e-6 against values to 1e-10: bounds hold, and are met."""
    from albedo.tables import table as compute

    cosines = np.linspace(0.02, 1.0, 12)
    turns = np.zeros(1) if model.isotropic else np.linspace(0.0, math.pi, 3)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        rough = compute(model, cosines, turns, rtol=1e-6, atol=1e-12)
        fine = directional_albedo(model, cosines, turns[:, None], rtol=1e-10, atol=1e-14)
    off = np.abs(rough["value"].values - fine.value)
    allowed = rough["error"].values + fine.error
    held = bool(np.all(off <= allowed))
    met = int(np.count_nonzero(rough["converged"].values))
    said = f"{int(np.count_nonzero(off <= allowed))} of {off.size} bounds hold, {met} meet 1e-6"
    return Check("table", held, said)


def check(model: Model, level: float = 1e-3, seed: int = 0) -> list[Check]:
    """All checks of a model.

    Parameters
    ----------
    model : Model
        Of the catalogue or made by `albedo.model_from`; one channel of it, where it has several.
    level : float
        Chance that a statistical check fails for a correct model; there are three kinds, shares,
        draws and agreement.
    seed : int

    Returns
    -------
    list of Check
        One at least failed where a `passed` is False.

    Raises
    ------
    InputError
        When the model has channels.
    """
    return [
        reciprocity(model, seed),
        energy(model),
        *sampling(model, level / 3.0, seed),
        agreement(model, level / 3.0, seed),
        table(model),
    ]


def check_function(
    text: str,
    *,
    level: float = 1e-3,
    seed: int = 0,
    **hints: Any,
) -> list[Check]:
    """All checks of a function in a file, and of the sampling routine beside it.

    Parameters
    ----------
    text : str
        ``path/to/file.py:name`` of a function ``name(wi, wo)``, as for `albedo.model_from`. When
        the file has ``name_sample(u, wi)``, directions for points of the unit square, and
        ``name_pdf(wi, wo)``, their density in 1/sr, these are put to the test as well.
    level : float
    seed : int
        As for `check`.
    **hints
        What `albedo.model_from` takes.

    Returns
    -------
    list of Check

    Raises
    ------
    InputError
        When there is no such file or function, the file cannot be run, or it has only one of the
        two functions of a sampling routine.
    """
    module, path, name, model = _model_in(text, hints)
    checks = check(model, level, seed)
    own = [hasattr(module, name + suffix) for suffix in ("_sample", "_pdf")]
    if not any(own):
        return checks
    if not all(own):
        has, lacks = ("_sample", "_pdf") if own[0] else ("_pdf", "_sample")
        raise InputError(f"{path} has {name}{has} but no {name}{lacks}; a test needs both")
    draw, density = (_function(module, path, name + suffix) for suffix in ("_sample", "_pdf"))
    for k, (mu, turn) in enumerate(zip(_COSINES.tolist(), _TURNS.tolist(), strict=True)):
        result = chi_square(
            *(draw, density, mu, turn), level=level / 3.0, tests=len(_COSINES), seed=seed + k
        )
        checks.append(Check(f"{name}_sample at cos theta = {mu:g}", result.passed, str(result)))
    return checks


def model_in_file(text: str, **hints: Any) -> Model:
    """The model of a function in a file, ``path/to/file.py:name``, as `albedo.model_from` makes it.

    Raises
    ------
    InputError
        When there is no such file or function, or the file cannot be run.
    """
    return _model_in(text, hints)[-1]


def _model_in(text: str, hints: dict[str, Any]) -> tuple[Any, Path, str, Model]:
    """The module of a function, its path, the function's name, and its model."""
    from albedo.user import model_from

    module, path, name = _load(text)
    return module, path, name, model_from(_function(module, path, name), name=name, **hints)


def _load(text: str) -> tuple[Any, Path, str]:
    """The module of ``path/to/file.py:name``, its path, and the name."""
    path_text, _, name = text.rpartition(":")
    path = Path(path_text)
    if not path.is_file():
        raise InputError(f"{path_text} is not a file; write path/to/file.py:function")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise InputError(f"{path} is not a Python file; write path/to/file.py:function")
    module = importlib.util.module_from_spec(spec)
    # Its own imports of neighbours work as if it were run.
    sys.path.insert(0, str(path.parent.resolve()))
    try:
        spec.loader.exec_module(module)
    except (ImportError, SyntaxError, NameError, ValueError, TypeError, OSError) as error:
        raise InputError(f"{path} cannot be run: {type(error).__name__}: {error}") from None
    finally:
        sys.path.pop(0)
    return module, path, name


def _function(module: Any, path: Path, name: str) -> Callable[..., Any]:
    function = getattr(module, name, None)
    if not callable(function):
        found = ", ".join(k for k, v in vars(module).items() if callable(v) and k[0] != "_")
        raise InputError(f"{path} has no function {name!r}; it has {found or 'none'}")
    return function
