"""How alike the lobes of Phong and Blinn are, and with what exponents they are most alike.

The distance between two lobes for one light is D = ||B - P||/||P|| with the root mean square over
views: P = (r.v)^n, B = (n.h)^(k n), both 1 at their peak. Views are those of the plane of
incidence, or all of them, by solid angle. The best factor k is that of the least distance.

In the plane of incidence the angle between N and H is half of that between R and V, so that narrow
lobes agree for k = 4. Across it, light at the angle theta makes H turn 1/cos(theta) times as fast:
there k = 4 cos^2(theta), and the best factor over all views of narrow lobes is in between.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from albedo.catalogue.blinn import Blinn
from albedo.catalogue.phong import Phong
from albedo.directions import spherical
from albedo.errors import InputError
from albedo.integrators.rules import gauss

__all__ = ["VIEWS", "BestFactor", "best_factor", "narrow_distance", "narrow_factor"]

VIEWS = ("plane", "all")
"""Views that a distance is taken over: those in the plane of incidence, or all."""

RULE = 4.0
"""The factor of the rule of thumb."""

# Where the least distance is first sought, and nodes in a panel for value and error.
_SCAN = np.geomspace(0.25, 64.0, 97)
_NODES = (20, 28)
_EPS = float(np.finfo(float).eps)


@dataclass(frozen=True)
class BestFactor:
    """The exponent of Blinn's lobe over that of Phong's for which they are most alike.

    Attributes
    ----------
    factor, factor_error : float
        The factor, and what a finer rule changes about it.
    distance, distance_error : float
        The distance that is left.
    by_rule, by_rule_error : float
        The distance for the factor four.
    """

    factor: float
    factor_error: float
    distance: float
    distance_error: float
    by_rule: float
    by_rule_error: float


def best_factor(n: float, cos_theta: float, views: str = "all") -> BestFactor:
    """Find the factor for which both lobes are most alike.

    Parameters
    ----------
    n : float
        Phong's exponent, in [1, 1e6].
    cos_theta : float
        Cosine of the angle of incidence, in [1e-3, 1].
    views : {"all", "plane"}
        Over which views the distance is taken.

    Returns
    -------
    BestFactor
        Errors are differences between two rules.

    Raises
    ------
    InputError
        For input out of range.
    """
    if not 1.0 <= n <= 1e6:
        raise InputError(f"n = {n:g} is out of range; it lies in [1, 1e6]")
    if not 1e-3 <= cos_theta <= 1.0:
        raise InputError(f"cos_theta = {cos_theta:g} is out of range; it lies in [0.001, 1]")
    if views not in VIEWS:
        raise InputError(f"views = {views!r} is unknown; choose one of {', '.join(VIEWS)}")
    coarse, fine = (_Lobes(n, cos_theta, views, nodes) for nodes in _NODES)
    other, factor = coarse.best(), fine.best()
    # Sums of so many products, and a root that is as sharp as the distance is curved there.
    rounding = 64.0 * _EPS * factor
    return BestFactor(
        *(factor, abs(factor - other) + rounding),
        *_with_error(coarse.distance(other), fine.distance(factor)),
        *_with_error(coarse.distance(RULE), fine.distance(RULE)),
    )


def narrow_factor(cos_theta: float) -> float:
    """The best factor over all views as n goes to infinity.

    Next to R both lobes are Gaussian, and D^2 = 1 + c/q - 4 c/sqrt(p) with q = k/4, c = cos(theta)
    and p = (1 + q)(c^2 + q). The least is where p^3 = 4 q^4 (1 + c^2 + 2 q)^2.

    Parameters
    ----------
    cos_theta : float
        Cosine of the angle of incidence, above 0 and at most 1.

    Returns
    -------
    float
        4 q, between 4 c^2 and 4.
    """
    from scipy.optimize import brentq

    square = cos_theta * cos_theta

    def slope(q: float) -> float:
        # Both sides of the equation as roots, the larger one positive on the right.
        p = (1.0 + q) * (square + q)
        return 2.0 * q * q * (1.0 + square + 2.0 * q) - p * math.sqrt(p)

    if cos_theta == 1.0:
        return RULE
    return RULE * float(brentq(slope, square, 1.0, xtol=1e-15, rtol=8.0 * _EPS))


def narrow_distance(cos_theta: float, factor: float) -> float:
    """The distance over all views as n goes to infinity; see `narrow_factor`.

    Parameters
    ----------
    cos_theta : float
        Cosine of the angle of incidence, above 0 and at most 1.
    factor : float
        Exponent of Blinn's lobe over that of Phong's.

    Returns
    -------
    float
        D.
    """
    q, c = factor / RULE, cos_theta
    square = 1.0 + c / q - 4.0 * c / math.sqrt((1.0 + q) * (c * c + q))
    return math.sqrt(max(square, 0.0))


def _with_error(coarse: float, fine: float) -> tuple[float, float]:
    # Next to 0 the distance is the root of a sum of squares that rounds.
    return fine, abs(fine - coarse) + 64.0 * _EPS


class _Lobes:
    """Both lobes at the nodes of one rule."""

    def __init__(self, n: float, cos_theta: float, views: str, nodes: int) -> None:
        light, view, self.weight = _nodes(n, cos_theta, views, nodes)
        mirror = light * np.array([-1.0, -1.0, 1.0])
        peaks = [model.eval(light, mirror) for model in (Phong(n=n), Blinn(n=n))]
        self.phong, self.blinn = (
            model.eval(light, view) / peak
            for model, peak in zip((Phong(n=n), Blinn(n=n)), peaks, strict=True)
        )
        # What has underflowed does so for any factor that is tried.
        with np.errstate(divide="ignore"):
            self.log = np.where(self.blinn > 0.0, np.log(self.blinn), -800.0)
        self.norm = float(self.weight @ self.phong**2)

    def distance(self, k: float) -> float:
        """D for a factor."""
        off = np.exp(k * self.log) - self.phong
        return math.sqrt(float(self.weight @ off**2) / self.norm)

    def slope(self, k: float) -> float:
        """Half of the derivative of D^2 in k."""
        lobe = np.exp(k * self.log)
        return float(self.weight @ ((lobe - self.phong) * lobe * self.log)) / self.norm

    def best(self) -> float:
        """The factor of the least distance."""
        from scipy.optimize import brentq

        at = int(np.argmin([self.distance(k) for k in _SCAN]))
        low, high = _SCAN[max(at - 1, 0)], _SCAN[min(at + 1, _SCAN.size - 1)]
        return float(brentq(self.slope, low, high, xtol=1e-14, rtol=8.0 * _EPS))


def _nodes(
    n: float, cos_theta: float, views: str, nodes: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A light, views above the horizon about its mirror direction, and their weights.

    Panels end where the horizon begins to cut, where r.v = 0, and at multiples of the width.
    """
    theta = math.acos(cos_theta)
    quarter = 0.5 * math.pi
    ends = {0.0, quarter - theta, quarter, quarter + theta}
    width = 1.0 / math.sqrt(n)
    ends |= {width * 2.0**k for k in range(-1, 40) if width * 2.0**k < quarter}
    alpha, weight = _rule(sorted(ends), nodes)
    light = spherical(cos_theta)
    if views == "plane":
        # Positive towards the normal; the horizon cuts the other side off early.
        alpha = np.concatenate((alpha, -alpha))
        weight = np.concatenate((weight, weight))
        angle = theta - alpha
        inside = np.abs(angle) < quarter
        angle, weight = angle[inside], weight[inside]
        view = np.stack((-np.sin(angle), 0.0 * angle, np.cos(angle)), axis=-1)
        return light, view, weight
    c, s = cos_theta, float(light[0])
    # n.v = c cos(alpha) + s sin(alpha) cos(psi) is positive for psi below this.
    with np.errstate(divide="ignore"):
        ratio = -c * np.cos(alpha) / (s * np.sin(alpha)) if s > 0.0 else -np.inf * np.cos(alpha)
    most = np.arccos(np.clip(ratio, -1.0, 1.0))
    unit, share = _rule([0.0, 1.0], 2 * nodes)
    psi = most[:, None] * unit
    sine, cosine = np.sin(alpha)[:, None], np.cos(alpha)[:, None]
    up, across = sine * np.cos(psi), sine * np.sin(psi)
    view = np.stack((-s * cosine + c * up, across, c * cosine + s * up), axis=-1)
    # Both sides of the plane of incidence are alike.
    area = 2.0 * (weight * np.sin(alpha) * most)[:, None] * share
    return light, view.reshape(-1, 3), area.ravel()


def _rule(ends: list[float], nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights on panels; a root at the end of a panel is smooth in the variable used."""
    rule = gauss(nodes)
    t, w = rule.nodes, rule.weights
    inner, jump = t * t * (3.0 - 2.0 * t), 6.0 * t * (1.0 - t) * w
    low = np.array(ends[:-1])[:, None]
    size = np.diff(ends)[:, None]
    return (low + size * inner).ravel(), (size * jump).ravel()
