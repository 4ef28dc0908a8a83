"""Critical levels of albedos, along which the albedos that follow bend.

Over the light from L, the albedo of a step is a_k+1(V) = F(V, a_k(V)) with

    F(V, c) = int f(L, V)/max(a_k(L), c) dL,    d^2 F/dc^2 ~ d/dc of what lies in {a_k < c}.

F is a smooth function of V, and of c as long as the level {a_k = c} is a smooth curve. At the level
of a saddle, where it crosses itself, its length has a logarithm, and F an (c - c*)^2 log|c - c*|;
at that of a summit or a hollow, where a loop of it vanishes, F has (c - c*)|c - c*|; and on a ridge
all around, where a whole circle vanishes, |c - c*|^(3/2) (Duistermaat and Hoermander for the
asymptotics of integrals over levels). On either side of such a level F is smooth up to its end, or
nearly so.
"""

from __future__ import annotations

import math

import numpy as np

from albedo.charts.heights import LAST, unfolded
from albedo.directions import spherical
from albedo.operators.maps import Maps

# Looks along y, and along azimuths of a quarter. Below this albedos are powers of the cosine.
_LOWEST, _ALONG, _AROUND = -16.0, 600, 48
# Steps of differences, of Newton's method, and how far it may go.
_APART, _STEPS, _FAR = 5e-3, 6, 0.2
# Where an albedo bends by less than this there is nothing to see, nor where looks differ by less
# than so many errors of its table.
_FLAT, _SEEN = 1e-6, 16.0
# Levels as near as this are one.
_SAME = 1e-7


def critical_levels(maps: Maps) -> tuple[np.ndarray, np.ndarray]:
    """Levels of saddles, summits, hollows and ridges of all albedos.

    Parameters
    ----------
    maps : Maps

    Returns
    -------
    steps : ndarray of int, shape (m,)
        Which albedo has each.
    levels : ndarray, shape (m,)
        Logarithms.
    """
    found = []
    for step, table in enumerate(maps.tables):
        if table.series.shape[1] == 1:
            levels = _ridges(maps, step)
        else:
            levels = _points(maps, step, table.quarter)
        levels.sort()
        kept = [x for k, x in enumerate(levels) if k == 0 or x - levels[k - 1] > _SAME]
        found += [(step, level) for level in kept]
    return np.array([step for step, _ in found], dtype=int), np.array([x for _, x in found])


def _values(maps: Maps, step: int, y: np.ndarray, phi: np.ndarray) -> np.ndarray:
    """The logarithm of an albedo; beyond the normal y goes on on the other side."""
    beyond = y > LAST
    y, phi = np.where(beyond, 2.0 * LAST - y, y), np.where(beyond, phi + math.pi, phi)
    theta = LAST - np.maximum(y, 0.0)
    c = unfolded(y)
    wi = spherical(c, phi)
    # Near the normal a cosine says little about the angle.
    sine = np.where(y > 0.0, np.sin(theta), np.sqrt((1.0 - c) * (1.0 + c)))
    wi[:, 0], wi[:, 1] = sine * np.cos(phi), sine * np.sin(phi)
    return maps.logs(wi)[:, step]


def _ridges(maps: Maps, step: int) -> list[float]:
    """Extrema along the height, and the normal."""
    y = np.linspace(_LOWEST, LAST, _ALONG)
    value = _values(maps, step, y, np.zeros(_ALONG))
    found = [float(value[-1])]
    rise = np.diff(value)
    seen = np.maximum(np.abs(rise[1:]), np.abs(rise[:-1])) > _SEEN * maps.errors[step]
    for k in range(1, _ALONG - 1):
        if seen[k - 1] and rise[k - 1] * rise[k] < 0.0:
            place = _newton(maps, step, y[k], 0.0, False)
            if place is not None:
                found.append(place)
    return found


def _points(maps: Maps, step: int, quarter: bool) -> list[float]:
    """Saddles, summits and hollows."""
    y = np.linspace(_LOWEST, LAST, _ALONG)
    end = 0.5 * math.pi if quarter else 2.0 * math.pi
    around = _AROUND + 1 if quarter else 4 * _AROUND
    phi = np.linspace(0.0, end, around, endpoint=quarter)
    value = _values(maps, step, np.repeat(y, around), np.tile(phi, _ALONG)).reshape(_ALONG, around)
    # One more column on both sides: mirrored, or the other end.
    wide = np.pad(value, ((0, 0), (1, 1)), mode="reflect" if quarter else "wrap")
    rings = [(-1, -1), (-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1)]
    apart = (
        np.array([wide[1 + i : _ALONG - 1 + i, 1 + j : around + 1 + j] for i, j in rings])
        - wide[1:-1, 1:-1]
    )
    changes = ((apart > 0.0) != (np.roll(apart, 1, axis=0) > 0.0)).sum(0)
    seen = np.abs(apart).max(0) > _SEEN * maps.errors[step]
    found = [float(_values(maps, step, np.array([LAST]), np.zeros(1))[0])]
    for i, j in zip(*np.nonzero(seen & (changes != 2)), strict=True):
        on_axis = quarter and j in (0, around - 1)
        place = _newton(maps, step, y[i + 1], phi[j], not on_axis)
        if place is not None:
            found.append(place)
    return found


def _newton(maps: Maps, step: int, y: float, phi: float, turning: bool) -> float | None:
    """The level of a critical point near a place; nothing if there is none."""
    h = _APART
    least = max(_FLAT, _SEEN * maps.errors[step] / (h * h))
    start = np.array([y, phi])
    place, hessian = start.copy(), np.zeros((2, 2))
    along = h * np.array([0.0, 1.0, -1.0, 0.0, 0.0, 1.0, -1.0, 1.0, -1.0])
    across = h * np.array([0.0, 0.0, 0.0, 1.0, -1.0, 1.0, -1.0, -1.0, 1.0])
    for _ in range(_STEPS):
        v = _values(maps, step, place[0] + along, place[1] + across)
        slope = np.array([v[1] - v[2], v[3] - v[4]]) / (2.0 * h)
        mixed = (v[5] + v[6] - v[7] - v[8]) / 4.0
        hessian = np.array([[v[1] - 2.0 * v[0] + v[2], mixed], [mixed, v[3] - 2.0 * v[0] + v[4]]])
        hessian /= h * h
        # On an axis of symmetry the azimuth stays.
        free = slice(0, 2 if turning else 1)
        own = hessian[free, free]
        if np.abs(np.linalg.eigvalsh(own)).min() < least:
            return None
        place[free] -= np.linalg.solve(own, slope[free])
        if np.abs(place - start).max() > _FAR or place[0] > LAST - 2.0 * h:
            return None
    return float(_values(maps, step, place[:1], place[1:])[0])
