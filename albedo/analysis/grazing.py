r"""What an albedo does towards grazing incidence: the power of the cosine that it follows.

An albedo that follows a power, a(c) ~ C c^-p with c = cos_theta, diverges for p > 0, has a limit
for p = 0 and vanishes for p < 0. The exponent is the slope of least squares in logarithms over the
last decades; its error has what the bounds of the albedos can do to it, and how far the slopes of
parts of these decades are from that of the whole, which is how far the law is from a power there.

For some models theory has the exponent and the prefactor C: with L on the horizon the integrand
times c^p has a limit. In the slopes (x, y) of H, with x along L, q = 1 + x^2 + y^2 and c = 0:
l.h = x/sqrt(q), n.v = 2 x/q and dV = 4 x/q^2 dx dy, x > 0 (see `albedo.charts.polar`). Hence

* Ward 1992 (NNS eq. 8): p = 1/2, C = rho_s sqrt(2)/(pi m^2) int E sqrt(x) x q^(-5/2) dx dy,
* Ward-Duer: p = 1, C = rho_s/(pi m^2) int E x q^-2 dx dy,
* bounded Ward: p = 0, C = rho_s,
* Cook-Torrance with G = 1 and F = 1: p = 1, C = int D x q^-2 dx dy, which is m/(2 sqrt(pi)) for
  Beckmann's D and m/2 for GGX,
* with the G of eq. 10, and with Smith's of correlated heights: p = 0 and C = 1, as in the weak
  white furnace, because light from the horizon is masked and what it reflects is not,
* with Smith's separable G: p = 0, C = int (G1(l)/c) D G1(v) x q^-2 dx dy,

E being exp(-(x^2 + y^2)/m^2), or Ward's fast form of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from albedo.brdf import Model
from albedo.errors import InputError
from albedo.estimate import Estimate
from albedo.quadrature import directional_albedo

SMALLEST = 1e-12
"""The smallest cosine, by default."""
DECADES = 6
"""How many decades, the last ones, a power is fitted to."""

# An exponent is settled when its error is no more than this; else smaller cosines are looked at, by
# so many decades at a time, down to the last.
_SETTLED, _FURTHER, _LAST = 1e-3, 6, 1e-48
# Changes of slopes that are more than this, in terms of what errors of values can do, are believed.
_TOLD = 10.0
# How near to the power an albedo is once it has set in.
_NEAR = 0.05
# An albedo passes one at a place that is closed in on to this share of its cosine.
_CLOSE = 1e-9


@dataclass(frozen=True)
class Theory:
    """What theory says of an albedo at grazing incidence.

    Attributes
    ----------
    exponent : float
        p in a ~ C c^-p.
    prefactor, error : float
        C, and the error of the integral that gives it.
    """

    exponent: float
    prefactor: float
    error: float


@dataclass(frozen=True)
class Asymptote:
    """An albedo towards grazing incidence.

    Attributes
    ----------
    model : Model
    cos_theta : ndarray, shape (n,)
        Descending cosines.
    albedo : Estimate
        The albedo there.
    exponent, error : float
        p in a ~ C c^-p over the last decades, and its error.
    decades : int
        To how many it is fitted.
    prefactor : float
        C of the fit.
    sets_in : float
        The largest cosine from which on the albedo is within 5 percent of that power, or NaN.
    above_one : tuple of (float, float) or None
        The cosine at which the albedo first surely exceeds one on the way from normal incidence,
        and half the width of what it is closed in to. (1, 0) where it does so at the normal.
    """

    model: Model
    cos_theta: np.ndarray
    albedo: Estimate
    exponent: float
    error: float
    decades: int
    prefactor: float
    sets_in: float
    above_one: tuple[float, float] | None

    def measured_prefactor(self, exponent: float) -> tuple[float, float]:
        """a c^p at the smallest cosine, and what it changed by in the last decade, with bounds."""
        c, value, error = self.cos_theta, self.albedo.value, self.albedo.error
        before = int(np.searchsorted(-c, -10.0 * c[-1] * (1.0 - 1e-9)))
        scaled, spread = value * c**exponent, error * c**exponent
        moved = abs(scaled[-1] - scaled[before]) + spread[before]
        return float(scaled[-1]), float(spread[-1] + moved)


def power(c: np.ndarray, value: np.ndarray, error: np.ndarray) -> tuple[float, float]:
    """Exponent p of value ~ c^p as c -> 0, by least squares of the logarithms, and its error.

    Parameters
    ----------
    c, value, error : ndarray, shape (n,)
        Where, in descending order, what, and bounds, which are smaller than the values.

    Returns
    -------
    exponent, error : float
        The slope over all points. The error has what the errors of the values can do at most, how
        far the slopes of the three thirds are from that of the whole, and what is still to come
        beyond the last one if slopes go on to change as they did: how far the law is from a power.
    """

    def slopes(part: slice) -> np.ndarray:
        x = np.log(c[part]) - np.log(c[part]).mean()
        return x / (x @ x)

    third = c.size // 3
    parts = [slice(0, third), slice(third, c.size - third), slice(c.size - third, None)]
    whole, first, second, last = (
        float(slopes(part) @ np.log(value[part])) for part in (slice(None), *parts)
    )
    spread = float(np.abs(slopes(slice(None))) @ (error / (value - error)))
    off = max(abs(other - whole) for other in (first, second, last))
    before, change = abs(second - first), abs(last - second)
    # A geometric series of changes; twice that where the law is a power of the logarithm, and more
    # for what either leaves out.
    ahead = 3.0 * change / (before - change) if before > change else math.inf
    # What the values' own errors can do tells of no series.
    told = change > _TOLD * spread
    return whole, spread + off + (change * max(ahead, 1.0) if told else change)


def cosines(smallest: float = SMALLEST, per_decade: int = 8) -> np.ndarray:
    """Cosines from 1 down: every two degrees to 88, then so many to a decade."""
    last = -math.log10(smallest)
    grazing = np.logspace(-1.5, -last, round(per_decade * (last - 1.5)) + 1)
    wide = np.cos(np.radians(np.arange(0.0, 88.0, 2.0)))
    return np.concatenate((wide, grazing))


def asymptote(
    model: Model,
    *,
    phi: float = 0.0,
    smallest: float = SMALLEST,
    per_decade: int = 8,
    decades: int = DECADES,
    rtol: float = 1e-10,
) -> Asymptote:
    """Measure how an albedo behaves towards grazing incidence.

    Parameters
    ----------
    model : Model
        With one channel.
    phi : float
        Azimuth of incidence, radians.
    smallest : float
        The smallest cosine, within 1e-60 and 1e-6; smaller ones are looked at, by six decades at
        a time down to 1e-48, where the exponent is not known to 0.001 by then.
    per_decade : int
        Cosines to a decade, at least 2.
    decades : int
        How many the power is fitted to, at least 2; the smallest cosines.
    rtol : float
        The relative error that is asked of every albedo.

    Returns
    -------
    Asymptote

    Raises
    ------
    InputError
        For arguments out of range, and where an albedo is not known to be above 0.
    """
    if not 1e-60 <= smallest <= 1e-6:
        raise InputError(f"smallest = {smallest:g} is out of range; it must be within 1e-60, 1e-6")
    if per_decade < 2:
        raise InputError(f"per_decade = {per_decade} is out of range; it must be at least 2")
    if not 2 <= decades <= -math.log10(smallest):
        raise InputError(
            f"decades = {decades} is out of range; it must be within 2 and the "
            f"{-math.log10(smallest):.3g} from cos_theta = 1 to {smallest:g}"
        )
    c = cosines(smallest, per_decade)
    found = directional_albedo(model, c, phi, rtol=rtol)
    while True:
        value, error = found.value, found.error
        # A bound of all of a value or more leaves it no logarithm.
        lost = ~(value > error)
        if lost.any():
            raise InputError(
                f"the albedo of {model.spec} is {value[lost][0]:g} +- {error[lost][0]:g} at "
                f"cos_theta = {c[lost][0]:.3g}; a power needs it to be above 0"
            )
        last = c <= c[-1] * 10.0**decades * (1.0 + 1e-9)
        slope, spread = power(c[last], value[last], error[last])
        if spread <= _SETTLED or c[-1] <= _LAST:
            break
        more = c[-1] * np.logspace(0, -_FURTHER, _FURTHER * per_decade + 1)[1:]
        found = _joined(found, directional_albedo(model, more, phi, rtol=rtol))
        c = np.concatenate((c, more))
    prefactor = math.exp(float(np.mean(np.log(value[last]) - slope * np.log(c[last]))))
    off = np.abs(value / (prefactor * c**slope) - 1.0) > _NEAR
    first = 0 if not off.any() else int(np.flatnonzero(off)[-1]) + 1
    return Asymptote(
        *(model, c, found, -slope, spread, decades, prefactor),
        sets_in=float(c[first]) if first < c.size else math.nan,
        above_one=first_above_one(model, c, found, phi),
    )


def _joined(first: Estimate, second: Estimate) -> Estimate:
    """Two estimates, one after the other."""
    names = ("value", "error", "evaluations", "converged")
    both: dict[str, Any] = {
        k: np.concatenate((getattr(first, k), getattr(second, k))) for k in names
    }
    parts = {name: _joined(part, second.parts[name]) for name, part in first.parts.items()}
    return replace(first, **both, parts=parts)


def first_above_one(
    model: Model, c: np.ndarray, found: Estimate, phi: float = 0.0
) -> tuple[float, float] | None:
    """The cosine at which an albedo first surely exceeds one, from the normal on.

    Parameters
    ----------
    model : Model
    c : ndarray, shape (n,)
        Descending cosines.
    found : Estimate
        The albedos there.
    phi : float
        Azimuth of incidence, radians.

    Returns
    -------
    tuple of (float, float) or None
        The middle and half the width of a bracket, which is halved as long as bounds tell its two
        sides apart; the first cosine and 0 where it exceeds one there already.
    """
    surely = np.flatnonzero(found.value - found.error > 1.0)
    if surely.size == 0:
        return None
    k = int(surely[0])
    if k == 0:
        return float(c[0]), 0.0
    above, below = float(c[k]), float(c[k - 1])
    while below / above - 1.0 > _CLOSE:
        middle = math.sqrt(above * below)
        there = directional_albedo(model, middle, phi, rtol=1e-12)
        if there.value - there.error > 1.0:
            above = middle
        elif there.value + there.error < 1.0:
            below = middle
        else:
            break
    return (above + below) / 2.0, (below - above) / 2.0


def theory(model: Model) -> Theory | None:
    """What theory says of a model at grazing incidence, where it does: see the module.

    Parameters
    ----------
    model : Model
        Known are the isotropic forms of Ward's model, and Cook-Torrance's with a Fresnel factor of
        1 and Beckmann's distribution or GGX.
    """
    p = model.parameters
    if not model.isotropic:
        return None
    if model.name in _WARD:
        return _WARD[model.name](p["alpha_x"], p["rho_s"], p.get("form") == "fast")
    if model.name != "cook_torrance" or p["fresnel"] != "white":
        return None
    if p["distribution"] not in ("beckmann", "ggx"):
        return None
    scale = 4.0 if p["prefactor"] == "1/pi" else 1.0
    found = _cook_torrance(p["alpha_x"], p["distribution"], p["geometry"])
    if found is None:
        return None
    return Theory(found.exponent, scale * found.prefactor, scale * found.error)


def _ward(m: float, rho_s: float, fast: bool) -> Theory:
    # sqrt(x) x = r^(3/2) cos^(3/2) of the azimuth, whose integral is a beta function.
    turn = math.sqrt(math.pi) * math.gamma(1.25) / math.gamma(1.75)
    value, error = _radial(lambda r, q: r**2.5 * q**-2.5 * _bell(r, q, m, fast), m)
    scale = rho_s * math.sqrt(2.0) / (math.pi * m * m) * turn
    return Theory(0.5, scale * value, scale * error)


def _ward_duer(m: float, rho_s: float, fast: bool) -> Theory:
    value, error = _radial(lambda r, q: 2.0 * r * r / (q * q) * _bell(r, q, m, fast), m)
    scale = rho_s / (math.pi * m * m)
    return Theory(1.0, scale * value, scale * error)


def _ward_bounded(m: float, rho_s: float, fast: bool) -> Theory:
    return Theory(0.0, rho_s, 0.0)


_WARD: dict[str, Callable[[float, float, bool], Theory]] = {
    "ward": _ward,
    "ward_duer": _ward_duer,
    "ward_bounded": _ward_bounded,
}


def _bell(r: float, q: float, m: float, fast: bool) -> float:
    """E at a slope."""
    a = (r / m) ** 2
    return math.exp(-a * (2.0 / (q + math.sqrt(q)) if fast else 1.0))


def _cook_torrance(m: float, distribution: str, geometry: str) -> Theory | None:
    beckmann = distribution == "beckmann"
    if geometry == "none":
        return Theory(1.0, 0.5 * m / math.sqrt(math.pi) if beckmann else 0.5 * m, 0.0)
    if geometry in ("v_cavity", "smith_correlated"):
        return Theory(0.0, 1.0, 0.0)
    if geometry != "smith":
        return None
    from scipy.integrate import quad
    from scipy.special import erfcx

    def masking(tangent: float) -> float:
        """Smith's G1 of a direction with this tan(theta)."""
        if tangent == 0.0:
            return 1.0
        a = 1.0 / (m * tangent)
        if not beckmann:
            return 2.0 / (1.0 + math.sqrt(1.0 + (m * tangent) ** 2))
        inside = 1.0 / (a * math.sqrt(math.pi)) - float(erfcx(a))
        return 1.0 / (1.0 + 0.5 * math.exp(-a * a) * inside)

    def ring(r: float, q: float) -> float:
        """D q^-2 x G1(v) around a circle of slopes, but for what D has in front."""

        def around(turn: float) -> float:
            n_v = 2.0 * r * math.cos(turn) / q
            return math.cos(turn) * masking(math.sqrt((1.0 - n_v) * (1.0 + n_v)) / n_v)

        # Half of it: the other half of the circle is the same.
        whole, _ = quad(around, 0.0, 0.5 * math.pi, epsrel=1e-11, epsabs=0.0, limit=200)
        d = math.exp(-((r / m) ** 2)) if beckmann else (1.0 + (r / m) ** 2) ** -2
        return 2.0 * r * r * d * whole

    value, error = _radial(ring, m)
    # G1(l)/c at the horizon.
    grows = 2.0 * math.sqrt(math.pi) / m if beckmann else 2.0 / m
    scale = grows / (math.pi * m * m)
    return Theory(0.0, scale * value, scale * (error + 1e-10 * value))


def _radial(along: Callable[[float, float], float], m: float) -> tuple[float, float]:
    """Integral over the radius of slopes, of a function of it and of q; and its error."""
    from scipy.integrate import quad

    def stretched(t: float) -> float:
        # r = m t/(1 - t): all slopes, those of the lobe about the middle.
        r = m * t / (1.0 - t)
        return along(r, 1.0 + r * r) * m / (1.0 - t) ** 2

    value, error = quad(stretched, 0.0, 1.0, epsabs=0.0, epsrel=1e-11, limit=400)
    return float(value), float(error)
