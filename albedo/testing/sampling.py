"""The assertion that draws of directions follow the density that they are said to have."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from albedo.brdf import Model
from albedo.directions import UNIT_TOLERANCE, spherical
from albedo.errors import InputError
from albedo.testing._functions import (
    Function,
    Values,
    function_of,
    incidences,
    look,
    real_values,
)
from albedo.testing._options import check_count, check_number, check_undecided
from albedo.testing._words import direction, pair

if TYPE_CHECKING:
    from albedo.analysis.checks import Cell, ChiSquare

Sampler = Callable[[np.ndarray, np.ndarray], Any]
"""``sample(wi, u)``: directions (n, 3), or these with their densities, and weights, for lights
(n, 3) and points u (n, dimensions) of the unit cube."""

COSINES = (1.0, 0.9, 0.6, 0.25, 0.05)
"""Cosines of the angles of incidence that are tested unless others are given."""

# The fewest draws that a cell may expect. Far out Pearson's statistic of such cells is more likely
# than its limit distribution says: 5 times at 1e-8, 22 at 1e-11, 41 at 1e-12, for one to five cells
# with Poisson counts, summed exactly. So a hundredth of the level is asked of it.
_FEWEST, _TAIL = 100.0, 0.01


@dataclass(frozen=True)
class _Routine:
    """A sampling routine, its density, and the BRDF that its weights are for."""

    name: str
    sample: Sampler
    pdf: Values
    f: Values | None


@dataclass(frozen=True)
class _Draws:
    """What a routine returned for one light; `wo` is NaN where it returned no direction."""

    wi: np.ndarray
    wo: np.ndarray
    pdf: np.ndarray | None
    weight: np.ndarray | None

    @property
    def kept(self) -> np.ndarray:
        """Which draws lie above the horizon."""
        return self.wo[:, 2] > 0.0


@dataclass(frozen=True)
class _Outcome:
    """The two tests at one incidence: of the cells, and of the share above the horizon."""

    wi: np.ndarray
    cells: ChiSquare
    share_p: float
    level: float

    @property
    def loose(self) -> bool:
        """Whether the integral of the density is too uncertain to tell anything."""
        from albedo.analysis.checks import LOOSE

        return not self.cells.bound <= LOOSE

    @property
    def failed(self) -> bool:
        return not self.loose and (not self.cells.passed or self.share_p < self.level)

    @property
    def score(self) -> float:
        """How far the statistic is above its mean, in standard deviations."""
        degrees = self.cells.degrees
        return (self.cells.statistic - degrees) / math.sqrt(2.0 * degrees)

    def __str__(self) -> str:
        found = self.cells
        share = (found.draws - found.lost) / found.draws
        return (
            f"  {direction('wi', self.wi)}\n"
            f"  chi-square {found.statistic:.4g} with {found.degrees} degrees of freedom, "
            f"p = {found.p_value:.2g} (fails below {found.level:.2g})\n"
            f"  {_where(found.worst)}\n"
            f"  pdf integrates to {found.above:.6g} +- {found.bound:.1g} above the horizon, where "
            f"{share:.6g} of {found.draws} draws are: p = {self.share_p:.2g} (fails below "
            f"{self.level:.2g})"
        )


def assert_sampler_matches_pdf(
    sample: Sampler | Model,
    pdf: Function | Model | None = None,
    *,
    f: Function | Model | None = None,
    cos_theta: ArrayLike = COSINES,
    phi: ArrayLike | None = None,
    samples: int = 100_000,
    level: float = 1e-6,
    rtol: float = 1e-6,
    dimensions: int = 2,
    with_cosine: bool = False,
    undecided: str = "fail",
    seed: int = 0,
) -> None:
    r"""Assert that directions are drawn with the density that is stated for them.

    At every incidence the hemisphere is cut into cells of about 300 draws, the density is
    integrated over each, with a bound that is not held against the draws, and the draws in the
    cells are compared with that by Pearson's chi-square test. The share of the draws above the
    horizon is held to the integral of the density by the binomial distribution. Densities that are
    returned with the draws are held to `pdf`, and weights to f n.v/pdf.

    Parameters
    ----------
    sample : callable or Model
        ``sample(wi, u)``: unit vectors wo, shape (n, 3), or a tuple (wo, pdf) or (wo, pdf, weight)
        with arrays of shape (n,), for n equal unit vectors to the light, shape (n, 3), and points
        u of the unit square, shape (n, 2). A direction that is not above the horizon is lost, and
        so is any draw with the density 0, or inf, which is that of a Dirac part.
    pdf : callable or Model, optional
        ``pdf(wi, wo)``: densities in 1/sr, shape (n,), for directions of shape (n, 3) above the
        horizon. Over the hemisphere it integrates to the probability that a draw is not lost. A
        model's own unless given.
    f : callable or Model, optional
        ``f(wi, wo)`` in 1/sr, which weights are compared with; a model's own unless given.
    cos_theta : array_like
        Cosines of the angles of incidence, in (0, 1].
    phi : array_like, optional
        Azimuths of the light in radians; they broadcast with `cos_theta`. Without them each cosine
        has an azimuth of its own.
    samples : int
        Draws that are counted at each incidence, at least 1000; a quarter more lay out the cells.
    level : float
        The probability that a correct routine fails, over all incidences, in [1e-9, 0.1).
    rtol : float
        Relative difference that is allowed between densities, and between weights, in [0, 1). A
        lobe of width w that reads raw directions is known to about 1e-16/w^2.
    dimensions : int
        Random numbers for one draw, at least 1: u has shape (n, dimensions).
    with_cosine : bool
        `f` returns f n.v, as renderers do.
    undecided : {"fail", "pass"}
        What to do where the density cannot be integrated to 0.01.
    seed : int
        Same seed, same points u.

    Raises
    ------
    AssertionError
        When draws do not follow the density, or lie where it is 0; when densities or weights differ
        from what they should be; when a direction is not of unit length; when a lost draw has a
        weight; when something that is returned is not finite, is negative, or does not fit.
    InputError
        When an option is out of range, or `pdf` is missing.

    Notes
    -----
    With 100,000 draws in 300 cells a density whose relative error is 0.045 (root of its mean
    square, weighted by the density) is found with a probability of 0.8 at one incidence of five,
    and one of 0.05 with 0.98; twice that error takes a quarter of the draws in as many cells. A
    share above the horizon that is off by 0.01 is found. What is wrong inside of cells only, or on
    less than about 1e-3 of the draws, is not seen. Nor is a lobe of f that is never drawn: it
    changes no weight. Directions below the horizon are not compared with `pdf`.

    Pearson's statistic has its limit distribution only for large cells. All cells expect 100 draws
    or more, and a hundredth of the level is asked of it.

    Examples
    --------
    >>> import numpy as np
    >>> from albedo.testing import assert_sampler_matches_pdf
    >>> def sample(wi, u):
    ...     r, phi = np.sqrt(u[:, 0]), 2 * np.pi * u[:, 1]
    ...     return np.stack((r * np.cos(phi), r * np.sin(phi), np.sqrt(1 - u[:, 0])), axis=1)
    >>> assert_sampler_matches_pdf(sample, lambda wi, wo: wo[:, 2] / np.pi, cos_theta=0.5)
    >>> even = lambda wi, wo: np.full(len(wo), 0.5 / np.pi)
    >>> assert_sampler_matches_pdf(sample, even, cos_theta=0.5)
    Traceback (most recent call last):
    AssertionError: the draws of sample do not follow pdf: ...
    """
    __tracebackhide__ = True
    check_count("samples", samples, 1000)
    check_count("dimensions", dimensions, 1)
    check_count("seed", seed, 0)
    check_number("level", level, 1e-9, 0.1)
    check_number("rtol", rtol, 0.0, 1.0)
    check_undecided(undecided)
    c, p, _ = incidences(cos_theta, phi, None)
    routines = _routines(sample, pdf, f, with_cosine)
    wi = spherical(c, p)
    # Two tests at each incidence share the level.
    each = level / (2.0 * len(wi) * len(routines))
    for routine in routines:
        for values in (routine.pdf, routine.f):
            if values is not None:
                look(values, wi)
        outcomes = []
        for k, light in enumerate(wi):
            rng = np.random.default_rng([seed, k])
            pilot, draws = (
                _drawn(routine, light, rng.random((n, dimensions)))
                for n in (max(samples // 4, 1), samples)
            )
            _check_values(routine, draws, rtol)
            outcomes.append(_count(routine.pdf, pilot, draws, each))
        _report(routine, outcomes, level, undecided)


def _routines(
    sample: Sampler | Model,
    pdf: Function | Model | None,
    f: Function | Model | None,
    with_cosine: bool,
) -> list[_Routine]:
    """One routine, or one for each channel of a model."""
    if isinstance(sample, Model) and sample.channels is not None:
        return [r for one in sample.by_channel() for r in _routines(one, pdf, f, with_cosine)]
    if isinstance(sample, Model):
        pdf = sample if pdf is None else pdf
        f = sample if f is None else f
    elif not callable(sample):
        raise InputError(f"sample is {type(sample).__name__}; it must be sample(wi, u) or a Model")
    if pdf is None:
        raise InputError("pdf is missing; only a model knows its own")
    name = function_of(sample, "sample")[0].name if isinstance(sample, Model) else "sample"
    density = Values(pdf.pdf, "pdf") if isinstance(pdf, Model) else function_of(pdf, "pdf")[0]
    values = None if f is None else _only(function_of(f, "f", with_cosine))
    draw = _model_sampler(sample) if isinstance(sample, Model) else sample
    return [_Routine(name, draw, density, values)]


def _only(every: list[Values]) -> Values:
    if len(every) > 1:
        raise InputError(f"f has {len(every)} channels; give one, model.channel(i)")
    return every[0]


def _model_sampler(model: Model) -> Sampler:
    """`Model.sample` has its arguments the other way round."""
    return lambda wi, u: model.sample(u, wi)


def _drawn(routine: _Routine, wi: np.ndarray, u: np.ndarray) -> _Draws:
    """Draw, and look at what comes back before anything is made of it."""
    count = len(u)
    found = routine.sample(np.tile(wi, (count, 1)), u.copy())
    several = tuple(found) if isinstance(found, tuple | list) else (found,)
    if not 1 <= len(several) <= 3:
        raise AssertionError(
            f"sample(wi, u) returned {len(several)} things; it must return wo, (wo, pdf) or "
            "(wo, pdf, weight)"
        )
    wo = np.asarray(several[0])
    if wo.dtype.kind != "f" or wo.shape != (count, 3):
        raise AssertionError(
            f"sample(wi, u) returned {type(several[0]).__name__} of {wo.dtype} and shape "
            f"{wo.shape} for {count} points; it must return real directions of shape ({count}, 3)"
        )
    wo = np.array(wo, dtype=np.float64)
    pdf, weight = (
        real_values(several[k], f"sample(wi, u)[{k}], the {what},", count)
        if len(several) > k
        else None
        for k, what in ((1, "density"), (2, "weight"))
    )
    lost = np.zeros(count, dtype=bool) if pdf is None else (pdf == 0.0) | np.isinf(pdf)
    dirac = np.zeros(count, dtype=bool) if pdf is None else np.isinf(pdf)
    _refuse(np.isnan(wo).any(1) & ~lost, "directions are not a number", wi, wo, u)
    length = np.linalg.norm(wo, axis=1)
    long = (np.abs(length - 1.0) > UNIT_TOLERANCE) & (wo[:, 2] > 0.0) & ~lost
    _refuse(long, "directions are not of unit length", wi, wo, u, length)
    if pdf is not None:
        _refuse(~(pdf >= 0.0), "densities are negative or not a number", wi, wo, u, pdf)
    if weight is not None:
        bad = ~(np.isfinite(weight) & (weight >= 0.0))
        _refuse(bad, "weights are not finite or negative", wi, wo, u, weight)
        idle = (lost | ~(wo[:, 2] > 0.0)) & ~dirac & (weight > 0.0)
        _refuse(idle, "draws below the horizon, or of density 0, have a weight", wi, wo, u, weight)
    wo[lost] = np.nan
    return _Draws(wi, wo, pdf, weight)


def _refuse(
    bad: np.ndarray,
    what: str,
    wi: np.ndarray,
    wo: np.ndarray,
    u: np.ndarray,
    values: np.ndarray | None = None,
) -> None:
    """Fail with the first draw that is bad."""
    if not bad.any():
        return
    k = int(np.argmax(bad))
    shown = "" if values is None else f" {values[k]:.9g}"
    raise AssertionError(
        f"{np.count_nonzero(bad)} of {bad.size} {what}:{shown} for u = "
        f"({', '.join(f'{x:.9g}' for x in u[k])})\n{pair(wi, wo[k])}"
    )


def _check_values(routine: _Routine, draws: _Draws, rtol: float) -> None:
    """Hold what came with the draws above the horizon to the density there."""
    wo = draws.wo[draws.kept]
    wi = np.tile(draws.wi, (len(wo), 1))
    density = routine.pdf(wi, wo)
    if (dark := density == 0.0).any():
        k = int(np.argmax(dark))
        raise AssertionError(
            f"{np.count_nonzero(dark)} of {len(wo)} draws lie where pdf(wi, wo) is 0\n"
            f"{pair(wi[k], wo[k])}"
        )
    if draws.pdf is not None:
        said = draws.pdf[draws.kept]
        _same(said, density, "the density that sample returns", "pdf(wi, wo)", wi, wo, rtol)
    if draws.weight is not None and routine.f is not None:
        weight = routine.f(wi, wo) * wo[:, 2] / density
        said = draws.weight[draws.kept]
        _same(said, weight, "the weight that sample returns", "f n.v/pdf", wi, wo, rtol)


def _same(
    said: np.ndarray,
    true: np.ndarray,
    name: str,
    other: str,
    wi: np.ndarray,
    wo: np.ndarray,
    rtol: float,
) -> None:
    larger = np.maximum(said, true)
    off = np.abs(said - true) / np.where(larger > 0.0, larger, 1.0)
    if not (failed := off > rtol).any():
        return
    k = int(np.argmax(off))
    raise AssertionError(
        f"{name} is not {other}: {said[k]:.9g} beside {true[k]:.9g}, {off[k]:.3g} of the larger; "
        f"{np.count_nonzero(failed)} of {off.size} draws differ by more than rtol = {rtol:g}\n"
        f"{pair(wi[k], wo[k])}"
    )


def _count(pdf: Values, pilot: _Draws, draws: _Draws, level: float) -> _Outcome:
    """Test the counts in cells, and how many draws are above the horizon."""
    # Here, because it loads the quadrature.
    from albedo.analysis.checks import compare

    def at(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        return pdf(np.tile(wi, (len(wo), 1)), wo)

    found = compare(pilot.wo, draws.wo, at, draws.wi, level=_TAIL * level, fewest=_FEWEST)
    return _Outcome(draws.wi, found, _share_p(found), level)


def _share_p(found: ChiSquare) -> float:
    """Probability of as many lost draws, or of as few, with what the integral leaves for them."""
    from scipy import stats

    least, most = (
        min(max(1.0 - found.above + sign * found.bound, 0.0), 1.0) for sign in (-1.0, 1.0)
    )
    few = float(stats.binom.cdf(found.lost, found.draws, least))
    many = float(stats.binom.sf(found.lost - 1, found.draws, most))
    return min(2.0 * min(few, many), 1.0)


def _where(worst: Cell) -> str:
    """A cell by its directions, with its draws."""
    phi = [math.degrees(x) for x in worst.box[:2]]
    theta = [math.degrees(2.0 * math.asin(math.sqrt(0.5 * x))) for x in worst.box[2:]]
    middle = spherical(1.0 - 0.5 * sum(worst.box[2:]), 0.5 * sum(worst.box[:2]))
    return (
        f"worst cell: {worst.expected:.1f} draws expected, {worst.seen:.0f} found, theta from "
        f"{theta[0]:.4g} to {theta[1]:.4g} deg, phi from {phi[0]:.4g} to {phi[1]:.4g} deg, about\n"
        f"  {direction('wo', middle)}"
    )


def _report(routine: _Routine, outcomes: list[_Outcome], level: float, undecided: str) -> None:
    __tracebackhide__ = True
    failed = [one for one in outcomes if one.failed]
    if failed:
        raise AssertionError(
            f"the draws of {routine.name} do not follow {routine.pdf.name}: {len(failed)} of "
            f"{len(outcomes)} incidences fail, the worst of them\n"
            f"{max(failed, key=lambda one: one.score)}\n"
            f"  a correct routine fails with a probability of {level:g} at most"
        )
    loose = [one for one in outcomes if one.loose]
    if loose and undecided == "fail":
        widest = max(loose, key=lambda one: one.cells.bound)
        raise AssertionError(
            f"it could not be decided whether the draws of {routine.name} follow "
            f"{routine.pdf.name}: the integral of the density is {widest.cells.above:.6g} with a "
            f"bound of {widest.cells.bound:.2g} at {len(loose)} of {len(outcomes)} incidences, the "
            f"widest at\n  {direction('wi', widest.wi)}\n  undecided='pass' lets it pass"
        )
