r"""What a simpler model changes: radiance of a point source, and albedo, each with its error.

For an original f and a simpler g the *radiance* f n.l of a point source of unit irradiance across
its rays (see `albedo.analysis.radiance`) changes by |g - f| n.l, in 1/sr, and relative to the
original by |g - f|/f, where 0/0 counts as 0. Dirac parts are left out. The *albedo* changes by
|b - a|, and relative to the original by |b - a|/a.

Means of radiance are over lights that are uniform in solid angle and over views that count by
their projected area,

    mean of x = 1/(2 pi^2) \int \int x n.v dV dL,

so that the mean of f n.l is the average albedo over 2 pi. Means of albedo are over incidence with
the weight of the cosine, \int x 2 mu dmu. The *share* is the mean change over the mean of the
original: what relative change the whole light sees. It does not care for directions that get next
to nothing, of which the mean relative change, where every direction counts alike, has most.

Pairs of directions are written in the half vector and the angle to it (Rusinkiewicz 1998): with
theta_h, phi_h of H, and theta_d, phi_d of L about H,

    dL dV = 4 cos(theta_d) sin(theta_h) sin(theta_d) dtheta_h dphi_h dtheta_d dphi_d,
    n.l, n.v = cos(theta_h) cos(theta_d) -+ sin(theta_h) sin(theta_d) cos(phi_d),

and both are above the horizon where |cos(phi_d)| < 1/(tan(theta_h) tan(theta_d)). A lobe about H or
the mirror direction, or about the light, is wide in stretched theta_h, or theta_d; Fresnel factors
are functions of theta_d, kinks at n.l = n.v lie at phi_d = 90 degrees, where panels end. All
isotropic models are taken to be mirror-symmetric.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from albedo.brdf import Model
from albedo.errors import InputError
from albedo.integrators.rules import gauss
from albedo.quadrature import check_tolerances, directional_albedo

LEAST = 1e-290
"""Two values below this are equal: next to the smallest numbers one is 0 before the other."""

LOWEST = 1e-6
"""The largest change is sought where both directions have cosines of at least this."""

# Nodes to a side of a panel, until two sizes agree; for isotropic and anisotropic models.
_SIZES, _SIZES_TURNED = (8, 12, 18, 27, 40), (6, 9, 13, 19)
# The error over the difference of two sizes: at a jump that no panel ends at errors fall only as
# the inverse of the size, and sizes grow by a half.
_MORE = 2.0
# A panel covers this much of the stretched theta_h.
_PANEL = 1.4
# Points of the two grids that a search for the largest starts from: theta_h, theta_d, phi_d.
_GRIDS, _GRIDS_TURNED = ((29, 23, 13), (37, 29, 17)), ((17, 13, 9), (21, 17, 11))
_TURNS = 16
# Local maxima that are closed in on, rounds of that, and how many of the last tell the error.
_STARTS, _ROUNDS, _LAST = 4, 100, 4
# A maximum is flat: this close to it, in a cube of size one, nothing is missing of its value.
_CLOSE = 1e-8
# Roundings of a kernel, as in the quadrature.
_ROUNDINGS = 40.0
# A node below the horizon by rounding stands there.
_HORIZON = 1e-30
# Of albedos: nodes in the root of the cosine, and as many azimuths of anisotropic models; points of
# the two grids, azimuths on them, and rounds that close in.
_INCIDENCES, _INCIDENCES_TURNED = (12, 18, 27, 40), (8, 12, 18)
_ALBEDO_GRIDS, _ALBEDO_ROUNDS = ((13, 8), (20, 12)), 5
_EPS = float(np.finfo(float).eps)


@dataclass(frozen=True)
class Measured:
    """A number and its error."""

    value: float
    error: float

    def __str__(self) -> str:
        from albedo.estimate import format_value

        return format_value(self.value, self.error)


@dataclass(frozen=True, eq=False)
class Worst:
    """The largest change, and where.

    Attributes
    ----------
    value, error : float
        The change, and what a search from another grid, the last rounds, and rounding change.
    wi : ndarray, shape (3,)
        Light direction.
    wo : ndarray, shape (3,), or None
        View; None for albedos.
    """

    value: float
    error: float
    wi: np.ndarray
    wo: np.ndarray | None = None

    @property
    def cos_light(self) -> float:
        """n.l there."""
        return float(self.wi[2])

    @property
    def cos_view(self) -> float:
        """n.v there; NaN for albedos."""
        return math.nan if self.wo is None else float(self.wo[2])

    @property
    def angle_from_mirror(self) -> float:
        """Angle in radians between the view and the mirror direction; NaN for albedos."""
        if self.wo is None:
            return math.nan
        mirror = self.wi * np.array([-1.0, -1.0, 1.0])
        return 2.0 * math.asin(min(0.5 * float(np.linalg.norm(self.wo - mirror)), 1.0))


@dataclass(frozen=True)
class Change:
    """What a simpler model changes in a quantity: radiance in 1/sr, or albedo.

    Attributes
    ----------
    absolute, relative : Measured
        Means of |g - f| and of |g - f|/f; inf where f = 0 < g on a set that counts.
    share : Measured
        The mean of |g - f| over the mean of f.
    signed : Measured
        The mean of g - f: above 0 where the simpler model sends back more.
    original : Measured
        The mean of f.
    worst, worst_relative : Worst
        The largest |g - f| and |g - f|/f of all directions not below `lowest`.
    agreed : bool
        Whether two sizes of the rules agreed to the tolerance; where not, the errors say by how
        much they differed.
    """

    absolute: Measured
    relative: Measured
    share: Measured
    signed: Measured
    original: Measured
    worst: Worst
    worst_relative: Worst
    agreed: bool

    def row(self, prefix: str) -> dict[str, float]:
        """Columns of a table; every number has a companion ``_error``."""
        found: dict[str, float] = {}
        for name in ("absolute", "relative", "share", "signed", "worst", "worst_relative"):
            one = getattr(self, name)
            found[f"{prefix}_{name}"], found[f"{prefix}_{name}_error"] = one.value, one.error
            if isinstance(one, Worst):
                found[f"{prefix}_{name}_cos_light"] = one.cos_light
                if one.wo is not None:
                    found[f"{prefix}_{name}_cos_view"] = one.cos_view
                    off = math.degrees(one.angle_from_mirror)
                    found[f"{prefix}_{name}_deg_from_mirror"] = off
        return found


def radiance_change(
    original: Model, simpler: Model, *, rtol: float = 1e-3, lowest: float = LOWEST
) -> Change:
    """What a simpler model changes in the radiance of a point source.

    Parameters
    ----------
    original, simpler : Model
        With one channel each.
    rtol : float
        The rule for means is refined until two sizes agree to this share of every mean; twice
        the difference is the error.
    lowest : float
        The largest change is sought among directions with cosines of at least this, in (0, 0.1].

    Returns
    -------
    Change
        In 1/sr. A change that is large in a region smaller than the rules resolve is not seen:
        lobes are where the charts of the models say, and as wide.

    Raises
    ------
    InputError
        For models with several channels, numbers out of range, and values that are not finite.

    Examples
    --------
    >>> import albedo
    >>> from albedo.analysis.scale_down import radiance_change
    >>> found = radiance_change(albedo.model("lambert", rho=0.5), albedo.model("lambert", rho=0.4))
    >>> print(f"{found.relative.value:.6f}, at most {found.worst.value:.6f} 1/sr")
    0.200000, at most 0.031831 1/sr
    """
    check_tolerances(rtol, 0.0)
    _check_lowest(lowest)
    pair = _Pair(original, simpler)
    means, agreed = _refined(pair.means, pair.sizes, rtol)
    worst, worst_relative = _search(pair, lowest)
    return _change(means, pair.doubt, agreed, worst, worst_relative)


def albedo_change(
    original: Model, simpler: Model, *, rtol: float = 1e-6, lowest: float = LOWEST
) -> Change:
    """What a simpler model changes in the directional albedo.

    Parameters
    ----------
    original, simpler : Model
        With one channel each.
    rtol : float
        The rule for means is refined until two sizes agree to this share of every mean; the error
        is twice the difference, and what the bounds of the albedos allow.
    lowest : float
        The largest change is sought among cosines of at least this, in (0, 0.1].

    Returns
    -------
    Change
        Of anisotropic models over all azimuths as well.

    Raises
    ------
    InputError
        For models with several channels and numbers out of range.

    Examples
    --------
    >>> import albedo
    >>> from albedo.analysis.scale_down import albedo_change
    >>> found = albedo_change(albedo.model("lambert", rho=0.5), albedo.model("lambert", rho=0.4))
    >>> print(f"{found.signed.value:.6f}, {found.relative.value:.6f}")
    -0.100000, 0.200000
    """
    check_tolerances(rtol, 0.0)
    _check_lowest(lowest)
    _check_channels(original, simpler)
    isotropic = original.isotropic and simpler.isotropic

    def azimuths(size: int) -> np.ndarray:
        return np.zeros(1) if isotropic else 2.0 * math.pi * np.arange(size) / size

    def at(cosines: np.ndarray, phi: Any) -> tuple[np.ndarray, ...]:
        c, p = np.broadcast_arrays(cosines, phi)
        found = [_albedos(model, tuple(c.ravel()), tuple(p.ravel())) for model in models]
        return tuple(x.reshape(c.shape) for one in found for x in one)

    models = (original, simpler)

    def means(size: int) -> tuple[np.ndarray, np.ndarray]:
        # In the root of the cosine: albedos may rise like it towards the horizon.
        t, weight = gauss(size).nodes, gauss(size).weights
        phi = azimuths(size)
        a, a_error, b, b_error = at((t * t)[:, None], phi)
        share = (weight * 4.0 * t**3)[:, None] / phi.size
        error = a_error + b_error
        relative, relative_error = _ratios(a, b, error, a_error)
        values = [np.abs(b - a), relative, b - a, a]
        errors = [error, relative_error, error, a_error]
        return (
            np.array([float((share * x).sum()) for x in values]),
            np.array([float((share * x).sum()) for x in errors]),
        )

    found, agreed = _refined(means, _INCIDENCES if isotropic else _INCIDENCES_TURNED, rtol)
    worst = _largest_albedo(at, azimuths, lowest)
    return _change(found, 0.0, agreed, *worst)


def change_by_channel(
    original: Model, simpler: Model, *, lowest: float = LOWEST
) -> list[tuple[Change, Change]]:
    """Changes of radiance and of albedo in every channel of two models.

    Parameters
    ----------
    original, simpler : Model
        A model without channels stands beside every channel of the other.
    lowest : float
        As in `radiance_change`.

    Returns
    -------
    list of (Change, Change)
        Radiance and albedo, one pair for every channel; one where there are none.

    Raises
    ------
    InputError
        Where both have channels, and not equally many.
    """
    first, second = original.by_channel(), simpler.by_channel()
    count = max(len(first), len(second))
    if min(len(first), len(second)) not in (1, count):
        raise InputError(
            f"{original.spec} has {len(first)} channels and {simpler.spec} {len(second)}; "
            "they must have equally many"
        )
    pairs = zip(first * (count // len(first)), second * (count // len(second)), strict=True)
    return [
        (radiance_change(f, g, lowest=lowest), albedo_change(f, g, lowest=lowest)) for f, g in pairs
    ]


def _check_lowest(lowest: float) -> None:
    if not 1e-12 <= lowest <= 0.1:
        raise InputError(f"lowest = {lowest!r} is out of range; it lies in [1e-12, 0.1]")


def _check_channels(*models: Model) -> None:
    for model in models:
        if model.channels is not None:
            raise InputError(
                f"{model.spec} has {model.channels} channels; choose one with .channel(index)"
            )


def _change(
    means: tuple[np.ndarray, np.ndarray],
    doubt: float,
    agreed: bool,
    worst: Worst,
    worst_relative: Worst,
) -> Change:
    """Means of |g - f|, |g - f|/f, g - f and f as a Change; `doubt` is that of all values."""
    (absolute, relative, signed, original), error = means
    # Values of both models may be off by their doubt: that of |g - f| is of f and of g.
    both = doubt * (2.0 * original + absolute)
    total = error[0] + both
    if original > 0.0:
        share = absolute / original
        share_error = (total + share * (error[3] + doubt * original)) / original
    else:
        share, share_error = (0.0, 0.0) if absolute == 0.0 else (math.inf, math.inf)
    doubted = 2.0 * doubt * (1.0 + relative) if math.isfinite(relative) else math.inf
    return Change(
        absolute=Measured(float(absolute), float(total)),
        relative=Measured(float(relative), float(error[1] + doubted)),
        share=Measured(float(share), float(share_error)),
        signed=Measured(float(signed), float(error[2] + both)),
        original=Measured(float(original), float(error[3] + doubt * original)),
        worst=worst,
        worst_relative=worst_relative,
        agreed=agreed,
    )


def _ratios(
    f: np.ndarray, g: np.ndarray, error: np.ndarray, f_error: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """|g - f|/f with its error, 0/0 being 0."""
    difference = np.abs(g - f)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(difference == 0.0, 0.0, difference / f)
        spread = (error + ratio * f_error) / (f - f_error)
    known = f > f_error
    nothing = (f < LEAST) & (g < LEAST)
    ratio = np.where(nothing, 0.0, ratio)
    return ratio, np.where(nothing, 0.0, np.where(known, spread, math.inf))


def _refined(
    rule: Callable[[int], tuple[np.ndarray, np.ndarray]], sizes: tuple[int, ...], rtol: float
) -> tuple[tuple[np.ndarray, np.ndarray], bool]:
    """Means from a rule that grows until two sizes agree, with twice their difference as error."""
    before, _ = rule(sizes[0])
    for size in sizes[1:]:
        value, own = rule(size)
        # Where both are infinite they agree, and the error says so.
        with np.errstate(invalid="ignore"):
            differ = np.where(np.isfinite(value), np.abs(value - before), math.inf)
        # A signed mean may vanish: it is measured by that of its modulus.
        scale = np.array([value[0], value[1], value[0], value[3]])
        finite = np.isfinite(scale)
        agreed = bool(np.all(differ[finite] <= rtol * scale[finite]))
        if agreed:
            break
        before = value
    return (value, _MORE * differ + own), agreed


@dataclass(frozen=True, eq=False)
class _Directions:
    """Pairs of directions with H in the plane y = 0: (n, 3) each, and their weights (n,)."""

    wi: np.ndarray
    wo: np.ndarray
    h: np.ndarray
    weight: np.ndarray

    def turned(self, phi: float, mirrored: bool) -> _Directions:
        """All turned about the normal, after a reflection in y = 0."""
        c, s = math.cos(phi), math.sin(phi)
        y = -1.0 if mirrored else 1.0
        turn = np.array([[c, s, 0.0], [-s * y, c * y, 0.0], [0.0, 0.0, 1.0]])
        return _Directions(self.wi @ turn, self.wo @ turn, self.h @ turn, self.weight)


def _pairs(theta_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray, weight: Any) -> _Directions:
    """Directions from angles: wi, wo = h/2 -+ a vector across it."""
    cos_h, sin_h, cos_d, sin_d = np.cos(theta_h), np.sin(theta_h), np.cos(theta_d), np.sin(theta_d)
    half = np.stack((cos_d * sin_h, np.zeros_like(sin_h), cos_d * cos_h), axis=-1)
    along = sin_d * np.cos(phi_d)
    across = np.stack((along * cos_h, sin_d * np.sin(phi_d), -along * sin_h), axis=-1)
    wi, wo = half + across, half - across
    for one in (wi, wo):
        one[:, 2] = np.maximum(one[:, 2], _HORIZON)
    return _Directions(wi, wo, 2.0 * half, weight)


def _stretch(u: np.ndarray, width: float, end: Any) -> tuple[np.ndarray, np.ndarray]:
    """[0, 1] to [0, end] by the hyperbolic sine, wide where a lobe of that width is; derivative."""
    reach = np.arcsinh(end / width)
    return width * np.sinh(reach * u), width * reach * np.cosh(reach * u)


def _smooth(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """[0, 1] to itself, dense at both ends, and the derivative: takes roots there out."""
    return u * u * (3.0 - 2.0 * u), 6.0 * u * (1.0 - u)


@lru_cache(maxsize=24)
def _nodes(size: int, width_h: float, width_d: float) -> _Directions:
    """A rule for the mean over pairs of directions, of weight 1 in all."""
    x, w = gauss(size).nodes, gauss(size).weights
    right = 0.5 * math.pi

    def panels(width: float, end: float) -> tuple[np.ndarray, np.ndarray]:
        count = math.ceil(math.asinh(end / width) / _PANEL)
        places = ((np.arange(count)[:, None] + x) / count).ravel()
        return places, np.tile(w / count, count)

    # Up to the bend no azimuth of L about H is below the horizon, and from there on some are. Where
    # a lobe about L is narrow, theta_h is dense next to the horizon too, which cuts that lobe.
    if width_d < 1.0:
        end = 0.5 * right
        (u, w_h), (u_far, w_far) = panels(width_h, end), panels(width_d, end)
        (near, slope), (far, slope_far) = _stretch(u, width_h, end), _stretch(u_far, width_d, end)
        theta_h, bend = np.append(near, right - far), np.append(right - near, far)
        w_h = np.append(w_h * slope, w_far * slope_far)
    else:
        u, w_h = panels(width_h, right)
        theta_h, slope = _stretch(u, width_h, right)
        bend, w_h = right - theta_h, w_h * slope
    found = []
    for upper in (False, True):
        start, room = (bend, theta_h) if upper else (0.0, bend)
        u, w_d = panels(width_d, right)
        if upper or width_d == 1.0:
            u, slope = _smooth(u)
        else:
            slope = np.ones_like(u)
        if width_d < 1.0:
            theta_d, slope_d = _stretch(u, width_d, room[:, None])
        else:
            theta_d, slope_d = room[:, None] * u, room[:, None]
        theta_d = np.reshape(start, (-1, 1)) + theta_d
        slope_d = slope_d * slope
        most = np.minimum(1.0 / (np.tan(theta_h)[:, None] * np.tan(theta_d)), 1.0)
        first = np.arccos(most) if upper else np.zeros_like(theta_d)
        turn, slope = _smooth(x)
        span = right - first
        ahead = first[:, :, None] + span[:, :, None] * turn
        measure = 4.0 * np.cos(theta_d) * np.sin(theta_d) * np.sin(theta_h)[:, None]
        weight = w_h[:, None] * w_d * slope_d * measure * span
        weight = weight[:, :, None] * (w * slope)
        shape = ahead.shape
        places = [
            np.broadcast_to(theta_h[:, None, None], shape).ravel(),
            np.broadcast_to(theta_d[:, :, None], shape).ravel(),
        ]
        for phi_d in (ahead, math.pi - ahead):
            found.append((*places, phi_d.ravel(), weight.ravel()))
    angles = [np.concatenate(column) for column in zip(*found, strict=True)]
    pairs = _pairs(angles[0], angles[1], angles[2], angles[3])
    # phi_h gives 2 pi, the other half of phi_d 2.
    pairs.weight[:] *= 4.0 * math.pi / (2.0 * math.pi**2) * pairs.wo[:, 2]
    return pairs


class _Values:
    """The values of a model, its kernels being looked up once."""

    def __init__(self, model: Model) -> None:
        self.model, self.parts = model, model.parts()
        self.packed = np.array(model.pack(), dtype=np.float64)

    def __call__(self, wi: np.ndarray, wo: np.ndarray, h: np.ndarray) -> np.ndarray:
        """As `Model.finite_part`, of directions (n, 3) whose sum is known."""
        count = len(wi)
        light = np.ascontiguousarray(wi.T)
        view, half = (np.ascontiguousarray(v.T).reshape(3, count, 1) for v in (wo, h))
        rows = np.tile(self.packed, (count, 1))
        total, out = np.zeros(count), np.empty((count, 1))
        for part in self.parts:
            part.fill(light, view, half, part.packed(rows), out)
            total += part.scale * out[:, 0]
        if not np.all(np.isfinite(total)):
            k = int(np.flatnonzero(~np.isfinite(total))[0])
            raise InputError(
                f"{self.model.spec} is not finite at n.l = {wi[k, 2]:.3g}, n.v = {wo[k, 2]:.3g}"
            )
        return total


class _Pair:
    """Two models at the same directions."""

    def __init__(self, original: Model, simpler: Model) -> None:
        _check_channels(original, simpler)
        self.f, self.g = _Values(original), _Values(simpler)
        self.isotropic = original.isotropic and simpler.isotropic
        self.sizes = _SIZES if self.isotropic else _SIZES_TURNED
        parts = [*self.f.parts, *self.g.parts]
        about_light = [str(getattr(p.chart, "kind", "")).startswith("retro") for p in parts]
        wide = [min(p.widths) for p in parts]
        self.width_h, self.width_d = (
            _rounded_down(
                min((w for w, b in zip(wide, about_light, strict=True) if b == lit), default=1.0)
            )
            for lit in (False, True)
        )
        doubts = [float(p.doubt(None)) if callable(p.doubt) else float(p.doubt) for p in parts]
        self.doubt = max(doubts, default=0.0)

    def changes(self, at: _Directions) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """f, g, |g - f| n.l and |g - f|/f."""
        f, g = (values(at.wi, at.wo, at.h) for values in (self.f, self.g))
        difference = np.abs(g - f)
        with np.errstate(divide="ignore", invalid="ignore"):
            nothing = (difference == 0.0) | (np.maximum(np.abs(f), np.abs(g)) < LEAST)
            relative = np.where(nothing, 0.0, difference / np.abs(f))
        return f, g, difference * at.wi[:, 2], relative

    def means(self, size: int) -> tuple[np.ndarray, np.ndarray]:
        """Means of |g - f| n.l, |g - f|/f, (g - f) n.l and f n.l, and what rounding does."""
        plain = _nodes(size, self.width_h, self.width_d)
        turns = 1 if self.isotropic else 2 * size
        total, rounding = np.zeros(4), np.zeros(4)
        for turn, mirrored in itertools.product(range(turns), (False, True)):
            if self.isotropic and mirrored:
                continue
            at = plain if self.isotropic else plain.turned(2.0 * math.pi * turn / turns, mirrored)
            f, g, absolute, relative = self.changes(at)
            n_l, w = at.wi[:, 2], at.weight
            total += [w @ absolute, w @ relative, w @ ((g - f) * n_l), w @ (f * n_l)]
            size_of = w @ ((np.abs(f) + np.abs(g)) * n_l)
            rounding += [size_of, w.sum() + w @ relative, size_of, w @ (np.abs(f) * n_l)]
        count = 1 if self.isotropic else 2 * turns
        return total / count, _ROUNDINGS * _EPS * rounding / count


def _rounded_down(width: float) -> float:
    """A power of two, so that models of about the same width share their nodes."""
    return min(1.0, 2.0 ** math.floor(math.log2(width)))


def _cube(
    place: np.ndarray, pair: _Pair, lowest: float, mirrored: np.ndarray | None
) -> _Directions:
    """Directions of at least a cosine, from points (n, 3) or (n, 4) of the unit cube."""
    u = np.clip(place, 0.0, 1.0)
    theta_h, _ = _stretch(u[:, 0], pair.width_h, math.acos(lowest))
    cos_h, sin_h = np.cos(theta_h), np.sin(theta_h)
    most = np.arccos(np.minimum(lowest / cos_h, 1.0))
    if pair.width_d < 1.0:
        theta_d, _ = _stretch(u[:, 1], pair.width_d, most)
    else:
        theta_d = most * np.sin(0.5 * math.pi * u[:, 1])
    room, across = cos_h * np.cos(theta_d) - lowest, sin_h * np.sin(theta_d)
    first = np.arccos(np.clip(room / np.maximum(across, _HORIZON), 0.0, 1.0))
    phi_d = first + (math.pi - 2.0 * first) * u[:, 2]
    pairs = _pairs(theta_h, theta_d, phi_d, 1.0)
    if mirrored is None:
        return pairs
    turn = 2.0 * math.pi * place[:, 3]
    c, s, y = np.cos(turn), np.sin(turn), np.where(mirrored, -1.0, 1.0)
    wi, wo, h = (
        np.stack((v[:, 0] * c - y * v[:, 1] * s, v[:, 0] * s + y * v[:, 1] * c, v[:, 2]), axis=-1)
        for v in (pairs.wi, pairs.wo, pairs.h)
    )
    return _Directions(wi, wo, h, pairs.weight)


def _search(pair: _Pair, lowest: float) -> tuple[Worst, Worst]:
    """The largest |g - f| n.l and |g - f|/f, from two grids."""
    grids = _GRIDS if pair.isotropic else _GRIDS_TURNED
    ends = [_climb(pair, lowest, shape) for shape in grids]
    found = []
    for k in range(2):
        (value, last, wi, wo), (other, other_last, _, _) = sorted(
            (end[k] for end in ends), key=lambda item: -item[0]
        )
        if math.isinf(value):
            found.append(Worst(math.inf, math.inf, wi, wo))
            continue
        f, g = (float(v(wi[None], wo[None], (wi + wo)[None])[0]) for v in (pair.f, pair.g))
        own = (_ROUNDINGS * _EPS + pair.doubt) * (abs(f) + abs(g))
        # What directions err by near the horizon changes n.l, and f with it.
        own = own * wi[2] if k == 0 else own / max(abs(f), _HORIZON) * (1.0 + value)
        error = value - other + max(last, other_last) + own + 4.0 * _EPS / lowest * value
        found.append(Worst(value, error, wi, wo))
    return found[0], found[1]


def _climb(
    pair: _Pair, lowest: float, shape: tuple[int, ...]
) -> list[tuple[float, float, np.ndarray, np.ndarray]]:
    """From the local maxima on a grid up: value, what the last rounds brought, and directions."""
    axes = [np.linspace(0.0, 1.0, n) for n in shape]
    spacing = [1.0 / (n - 1) for n in shape]
    if not pair.isotropic:
        axes.append(np.arange(_TURNS) / _TURNS)
        spacing.append(1.0 / _TURNS)
    mesh = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    flat = mesh.reshape(-1, mesh.shape[-1])
    sides = (None,) if pair.isotropic else (False, True)
    starts: list[tuple[float, int, np.ndarray, bool]] = []
    for side in sides:
        mirrored = None if side is None else np.full(len(flat), side)
        at = _cube(flat, pair, lowest, mirrored)
        for k, values in enumerate(pair.changes(at)[2:]):
            for i in _local_maxima(values.reshape(mesh.shape[:-1]))[:_STARTS]:
                starts.append((float(values[i]), k, flat[i], bool(side)))
    which = np.array([k for _, k, _, _ in starts])
    place = np.array([u for _, _, u, _ in starts])
    side_of = np.array([side for _, _, _, side in starts])
    reach = np.tile(np.array(spacing), (len(starts), 1))
    offsets = np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=len(spacing))))
    best = np.array([value for value, _, _, _ in starts])
    history = [best.copy()]
    many = len(offsets)
    # Models that are the same everywhere leave nothing to climb.
    for _ in range(_ROUNDS if best.any() else 0):
        tried = place[:, None, :] + offsets * reach[:, None, :]
        tried[..., :3] = np.clip(tried[..., :3], 0.0, 1.0)
        points = tried.reshape(-1, tried.shape[-1])
        mirrored = None if pair.isotropic else np.repeat(side_of, many)
        both = np.stack(pair.changes(_cube(points, pair, lowest, mirrored))[2:])
        values = both.reshape(2, len(starts), many)[which, np.arange(len(starts))]
        top = values.argmax(1)
        rows = np.arange(len(starts))
        better = values[rows, top] > best
        moved = np.where(better[:, None], tried[rows, top], place)
        best = np.maximum(best, values[rows, top])
        # On the edge of what was looked at the next look is as wide; else half as wide.
        edge = better[:, None] & (np.abs(moved - place) >= 0.999 * reach)
        reach = np.where(edge.any(1)[:, None], reach, 0.5 * reach)
        place = moved
        history.append(best.copy())
        still = len(history) > _LAST and np.all(best <= history[-1 - _LAST] * (1.0 + 4.0 * _EPS))
        if still and np.all(reach <= _CLOSE):
            break
    before = history[max(0, len(history) - 1 - _LAST)]
    # What was infinite from the start has not grown.
    last = np.where(best > before, best, 0.0) - np.where(best > before, before, 0.0)
    found = []
    for k in range(2):
        mine = np.flatnonzero(which == k)
        i = int(mine[best[mine].argmax()])
        at = _cube(place[i : i + 1], pair, lowest, None if pair.isotropic else side_of[i : i + 1])
        found.append((float(best[i]), float(last[i]), at.wi[0], at.wo[0]))
    return found


def _local_maxima(values: np.ndarray) -> np.ndarray:
    """Flat indices of what no neighbour along an axis exceeds, the largest first."""
    padded = np.pad(values, 1, constant_values=-math.inf)
    inner = tuple(slice(1, -1) for _ in range(values.ndim))
    high = np.ones(values.shape, dtype=bool)
    for axis in range(values.ndim):
        for step in (slice(0, -2), slice(2, None)):
            place = (*inner[:axis], step, *inner[axis + 1 :])
            high &= values >= padded[place]
    found = np.flatnonzero(high)
    order: np.ndarray = found[np.argsort(-values.ravel()[found], kind="stable")]
    return order


@lru_cache(maxsize=256)
def _albedos(
    model: Model, cosines: tuple[float, ...], phi: tuple[float, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Albedos and bounds; several pairs have the same original."""
    rtol = 1e-9 if model.isotropic else 1e-8
    found = directional_albedo(model, np.array(cosines), np.array(phi), rtol=rtol)
    return np.asarray(found.value), np.asarray(found.error)


def _largest_albedo(
    at: Callable[..., tuple[np.ndarray, ...]],
    azimuths: Callable[[int], np.ndarray],
    lowest: float,
) -> list[Worst]:
    """The largest |b - a| and |b - a|/a: two grids, closed in on by a few points at a time."""
    first, both = math.sqrt(lowest), np.arange(2)

    def changes(t: np.ndarray, phi: Any) -> tuple[np.ndarray, np.ndarray]:
        a, a_error, b, b_error = at(t * t, phi)
        error = a_error + b_error
        relative, relative_error = _ratios(a, b, error, a_error)
        return np.stack((np.abs(b - a), relative)), np.stack((error, relative_error))

    ends: list[list[tuple[float, float, float, float, float]]] = [[], []]
    for size, turns in _ALBEDO_GRIDS:
        grid, turn = np.linspace(first, 1.0, size), azimuths(turns)
        values, errors = changes(grid[:, None], turn)
        i, j = np.unravel_index(values.reshape(2, -1).argmax(1), values.shape[1:])
        t, phi, best, bound = grid[i], turn[j], values[both, i, j], errors[both, i, j]
        flat = turn.size == 1
        steps = np.linspace(-1.0, 1.0, 9 if flat else 5)
        aside = np.zeros(1) if flat else steps
        reach, reach_phi, brought = (1.0 - first) / (size - 1), 2.0 * math.pi / turns, np.zeros(2)
        for _ in range(_ALBEDO_ROUNDS):
            near, ahead = (x.ravel() for x in np.meshgrid(steps, aside, indexing="ij"))
            tried = np.clip(t[:, None] + reach * near, first, 1.0)
            tried_phi = phi[:, None] + reach_phi * ahead
            values, errors = changes(tried, tried_phi)
            top = values[both, both].argmax(1)
            value = values[both, both, top]
            better = value > best
            brought = np.where(better, value, 0.0) - np.where(better, best, 0.0)
            bound = np.where(better, errors[both, both, top], bound)
            t = np.where(better, tried[both, top], t)
            phi, best = np.where(better, tried_phi[both, top], phi), np.maximum(best, value)
            # To the distance of the points.
            reach, reach_phi = reach * (steps[1] - steps[0]), reach_phi * (steps[1] - steps[0])
            # At an end that a quarter of the spacing does not improve on, nothing will.
            if flat and not better.any() and np.all((t == first) | (t == 1.0)):
                break
        columns = (column.tolist() for column in (best, brought, bound, t, phi))
        for k, end in enumerate(zip(*columns, strict=True)):
            ends[k].append(end)
    found = []
    for one in ends:
        (value, last, bound_here, t_here, phi_here), other = sorted(one, key=lambda end: -end[0])
        c = min(t_here * t_here, 1.0)
        s = math.sqrt((1.0 - c) * (1.0 + c))
        wi = np.array([s * math.cos(phi_here), s * math.sin(phi_here), c])
        spread = math.inf if math.isinf(value) else value - other[0] + last + other[1] + bound_here
        found.append(Worst(value, float(spread), wi))
    return found
