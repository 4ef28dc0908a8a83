"""Assertions about the directional albedo: that it is at most 1, or equals 1."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from albedo.brdf import Model
from albedo.directions import spherical
from albedo.estimate import Estimate, format_value
from albedo.testing._functions import Declared, Function, Surface, incidences, look, surfaces
from albedo.testing._options import check_count, check_number, check_undecided
from albedo.testing._words import direction

COSINES = (1.0, 0.9, 0.7, 0.5, 0.3, 0.1, 0.03, 1e-2, 1e-3, 1e-4)
"""Cosines of the angles of incidence that are tested unless others are given."""

# Azimuths over half a turn for what may be anisotropic.
_AROUND = 4
# Albedos are integrated roughly first, and where that does not decide, to this share of what is
# tolerated.
_ROUGH, _SHARE = 1e-3, 0.125
# What rounding leaves of any integral.
_FINEST = 1e-12
# Evaluations for one albedo; a scan of the hemisphere needs more the narrower its features are.
_EVALUATIONS, _PER_FEATURE = 4_000_000, 200.0
_SHOWN = 3


@dataclass(frozen=True)
class _Verdict:
    """Albedos of one surface beside what is allowed, one for each incidence."""

    surface: Surface
    cos_theta: np.ndarray
    phi: np.ndarray
    low: np.ndarray
    high: np.ndarray
    found: Estimate

    @property
    def outside(self) -> np.ndarray:
        """How far the whole interval of each albedo lies outside of what is allowed."""
        value, error = self.found.value, self.found.error
        return np.maximum(value - error - self.high, self.low - (value + error))

    @property
    def failed(self) -> np.ndarray:
        """Where no albedo within the bound is allowed."""
        return self.outside > 0.0

    @property
    def undecided(self) -> np.ndarray:
        """Where some are, and some are not."""
        value, error = self.found.value, self.found.error
        inside = (value + error <= self.high) & (value - error >= self.low)
        return ~(inside | self.failed)

    def lines(self, which: np.ndarray, size: np.ndarray) -> str:
        """The incidences among `which` of the largest `size`."""
        order = np.argsort(-np.where(which, size, -np.inf), kind="stable")
        width = self.found.resolved_width
        seen = f" for features of {width:g} rad and more" if width else ""
        lines = []
        for k in order[: min(_SHOWN, int(np.count_nonzero(which)))].tolist():
            value, error = float(self.found.value[k]), float(self.found.error[k])
            least = "at most" if self.low[k] == -np.inf else f"{self.low[k]:.9g} to"
            wi = spherical(self.cos_theta[k], self.phi[k])
            lines.append(
                f"  albedo {format_value(value, error)} with a bound of {error:.2g}{seen}, where "
                f"{least} {self.high[k]:.9g} is allowed\n    {direction('wi', wi)}"
            )
        return "\n".join(lines)


def assert_energy_conserving(
    f: Function | Model,
    *,
    cos_theta: ArrayLike = COSINES,
    phi: ArrayLike | None = None,
    atol: float = 1e-6,
    with_cosine: bool = False,
    isotropic: bool = False,
    lobe: str | None = None,
    width: float | None = None,
    resolved_width: float | None = None,
    max_evaluations: int | None = None,
    undecided: str = "fail",
) -> None:
    r"""Assert that a BRDF reflects no more than it receives.

    Its directional albedo, the integral of f n.v over the directions v of view (NNS eq. 2), is at
    most 1 + `atol` at every incidence that is tested. Each albedo has a bound on its error: the
    assertion fails where albedo - bound is larger, and says that it cannot tell where only
    albedo + bound is.

    Parameters
    ----------
    f : callable or Model
        ``f(wi, wo)``: values in 1/sr, shape (n,), at pairs of unit vectors to the light and to the
        viewer, shape (n, 3), z along the normal, both above the horizon. Or a model, whose Dirac
        parts count as well; one with channels is tested in each.
    cos_theta : array_like
        Cosines of the angles of incidence, in (0, 1].
    phi : array_like, optional
        Azimuths of the light in radians; they broadcast with `cos_theta`. Without them, 0 for what
        is isotropic, else 0, 45, 90 and 135 degrees for every cosine.
    atol : float
        By so much an albedo may exceed 1, in [0, 1).
    with_cosine : bool
        `f` returns f n.v, as renderers do.
    isotropic : bool
        `f` does not change when both directions turn about the normal; that is tried.
    lobe : {"mirror", "half", "retro", "diffuse"}, optional
    width : float, optional
        Where the mass of `f` lies, and how wide its lobe is, in radians, as for
        `albedo.model_from`. Without them the hemisphere is scanned.
    resolved_width : float, optional
        Width in radians of the narrowest features that the bound is to hold for, 0.03 unless
        given. About the mirror direction, the light and the normal all are seen down to 1e-8 rad.
        The work grows as its inverse square.
    max_evaluations : int, optional
        Most evaluations of `f` for one albedo, at least 16; four million unless given, and more
        for narrow features.
    undecided : {"fail", "pass"}
        What to do where the bound is too wide to tell.

    Raises
    ------
    AssertionError
        When an albedo exceeds 1, or cannot be told from that, or a value of `f` is not finite, or
        negative, or the arrays that it returns do not fit.
    InputError
        When an option is out of range, or one about a function goes with a model.

    Notes
    -----
    What a bound rests on is in ``docs/method.md``. A feature that is narrower than
    `resolved_width` and lies elsewhere than about the mirror direction, the light and the normal
    may be missed, and so may an excess between the incidences, or nearer to the horizon than
    all of them.

    Examples
    --------
    >>> import numpy as np
    >>> from albedo.testing import assert_energy_conserving
    >>> def blinn(wi, wo, n=20):
    ...     h = wi + wo
    ...     n_h = h[:, 2] / np.linalg.norm(h, axis=1)
    ...     return (n + 2) / (8 * np.pi) * n_h**n / np.maximum(wi[:, 2], wo[:, 2])
    >>> assert_energy_conserving(lambda wi, wo: 0.6 * blinn(wi, wo), isotropic=True)
    >>> assert_energy_conserving(lambda wi, wo: 2.0 * blinn(wi, wo), isotropic=True)
    Traceback (most recent call last):
    AssertionError: f reflects more than it receives: ...
    """
    __tracebackhide__ = True
    _check(undecided, max_evaluations, atol=atol)
    declared = Declared(isotropic, lobe, width, resolved_width)
    found = _judge(
        *(surfaces(f, with_cosine, declared), cos_theta, phi, 1.0),
        lambda one: (np.full(one.shape, -np.inf), one + atol),
        _budget(max_evaluations, declared),
    )
    _report(found, "{} reflects more than it receives", undecided)


def assert_white_furnace(
    f: Function | Model,
    *,
    expected: ArrayLike = 1.0,
    cos_theta: ArrayLike = COSINES,
    phi: ArrayLike | None = None,
    rtol: float = 1e-3,
    atol: float = 0.0,
    with_cosine: bool = False,
    isotropic: bool = False,
    lobe: str | None = None,
    width: float | None = None,
    resolved_width: float | None = None,
    max_evaluations: int | None = None,
    undecided: str = "fail",
) -> None:
    r"""Assert that a BRDF reflects all light, or a given share of it, at every incidence.

    In a furnace whose walls are equally bright everywhere a surface that loses nothing cannot be
    told from the walls (Heitz 2014): its directional albedo is 1. The assertion fails where the
    interval albedo +- bound lies outside of `expected` +- max(`atol`, `rtol` `expected`), and says
    that it cannot tell where the interval lies partly outside.

    Parameters
    ----------
    f : callable or Model
        As for `assert_energy_conserving`.
    expected : array_like
        The albedo, at least 0: one number, or one for each incidence that `cos_theta` and `phi`
        make, with which it broadcasts.
    cos_theta, phi : array_like
        As for `assert_energy_conserving`.
    rtol, atol : float
        How far an albedo may be off, relative to `expected` and in itself, in [0, 1).
    with_cosine, isotropic, lobe, width, resolved_width, max_evaluations, undecided
        As for `assert_energy_conserving`.

    Raises
    ------
    AssertionError, InputError
        As for `assert_energy_conserving`.

    Notes
    -----
    What cannot be seen is what `assert_energy_conserving` cannot see either. An albedo of 1 does
    not make the BRDF reciprocal; see `assert_reciprocal`.

    Examples
    --------
    >>> import numpy as np
    >>> from albedo.testing import assert_white_furnace
    >>> assert_white_furnace(lambda wi, wo: np.full(len(wo), 1 / np.pi), isotropic=True)
    >>> assert_white_furnace(lambda wi, wo: np.full(len(wo), 0.3), isotropic=True)
    Traceback (most recent call last):
    AssertionError: the albedo of f is not what is expected: ...
    """
    __tracebackhide__ = True
    _check(undecided, max_evaluations, rtol=rtol, atol=atol)
    declared = Declared(isotropic, lobe, width, resolved_width)

    def around(wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        allowed = np.maximum(atol, rtol * wanted)
        return wanted - allowed, wanted + allowed

    found = _judge(
        *(surfaces(f, with_cosine, declared), cos_theta, phi, expected),
        *(around, _budget(max_evaluations, declared)),
    )
    _report(found, "the albedo of {} is not what is expected", undecided)


def _check(undecided: str, max_evaluations: int | None, **tolerances: float) -> None:
    for name, value in tolerances.items():
        check_number(name, value, 0.0, 1.0)
    check_undecided(undecided)
    if max_evaluations is not None:
        check_count("max_evaluations", max_evaluations, 16)


def _budget(max_evaluations: int | None, declared: Declared) -> int:
    """Evaluations for one albedo: as many as a scan needs, and some more."""
    if max_evaluations is not None:
        return max_evaluations
    return max(_EVALUATIONS, math.ceil(_PER_FEATURE / declared.finest**2))


def _judge(
    every: list[Surface],
    cos_theta: ArrayLike,
    phi: ArrayLike | None,
    expected: ArrayLike,
    limits: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    budget: int,
) -> list[_Verdict]:
    """The albedos of all surfaces: integrated roughly, and well where that does not decide."""
    verdicts = []
    for surface in every:
        around = 1 if surface.model.isotropic else _AROUND
        c, p, wanted = incidences(cos_theta, phi, around, expected)
        low, high = limits(wanted)
        fine = max(_SHARE * float(np.min(high - wanted)), _FINEST)
        look(surface.values, spherical(c, p), isotropic=surface.model.isotropic)
        found = _albedos(surface.model, c, p, max(fine, _ROUGH), budget)
        verdict = _Verdict(surface, c, p, low, high, found)
        again = np.flatnonzero(verdict.undecided)
        if again.size and fine < _ROUGH:
            better = _albedos(surface.model, c[again], p[again], fine, budget)
            found.value[again], found.error[again] = better.value, better.error
        verdicts.append(verdict)
    return verdicts


def _albedos(
    model: Model, cos_theta: np.ndarray, phi: np.ndarray, tolerance: float, budget: int
) -> Estimate:
    # Here, because a test that needs no albedo needs no quadrature.
    from albedo.quadrature import albedo_rows

    models = [model] * cos_theta.size
    # An albedo of thousands needs no more digits than one of 1.
    rtol = tolerance if tolerance >= _ROUGH else 0.0
    return albedo_rows(*(models, cos_theta, phi), rtol=rtol, atol=tolerance, max_evaluations=budget)


def _report(verdicts: list[_Verdict], claim: str, undecided: str) -> None:
    """Fail where a claim holds, and where it may hold, unless that is to pass."""
    __tracebackhide__ = True
    for one in verdicts:
        name, count, failed = one.surface.values.name, one.found.value.size, one.failed
        if failed.any():
            raise AssertionError(
                f"{claim.format(name)}: {np.count_nonzero(failed)} of {count} incidences fail, the "
                f"worst of them\n{one.lines(failed, one.outside)}"
            )
    for one in verdicts:
        name, count, open_ = one.surface.values.name, one.found.value.size, one.undecided
        if open_.any() and undecided == "fail":
            raise AssertionError(
                f"it could not be decided whether {claim.format(name)}: the bounds of "
                f"{np.count_nonzero(open_)} of {count} albedos are too wide, the widest of them\n"
                f"{one.lines(open_, one.found.error)}\n  more max_evaluations may help, or lobe "
                "and width of a function; undecided='pass' lets it pass"
            )
