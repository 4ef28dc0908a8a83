"""What a scene asks of a model: the ranges that it uses, its light, and what may be wrong."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from albedo.advice.rows import Rows, albedos
from albedo.brdf import Model, parts_of
from albedo.directions import half_vector, spherical
from albedo.errors import InputError
from albedo.sampling.mixture import Mixture, mixture_of

LIGHTS = ("sky", "point", "area")
"""A uniform sky, point sources, or round sources of one size."""
SEEN = ("radiance", "albedo")
"""What may be wrong: the radiance towards the viewer, or the directional albedo."""

# Ranges of numbers this many times as large at one end as at the other are drawn evenly in the
# logarithm.
_DECADES = 30.0
# Share of the points that lie at an end of a range, for each range.
_AT_ENDS = 0.05
# The reference errs by this share of the tolerance at most.
_SHARE = 1e-3
# Nodes of a round source from its middle outwards, and around; doubled until two rules agree.
_RINGS, _TURNS = 12, 24
_DOUBLINGS = 3
# Directions to round sources that are held at once.
_HELD = 2**18


@dataclass(frozen=True)
class Axis:
    """A number that varies in a scene.

    Attributes
    ----------
    name : str
    low, high : float
    """

    name: str
    low: float
    high: float

    @property
    def log(self) -> bool:
        """Whether it is even in its logarithm."""
        return self.low > 0.0 and self.high > _DECADES * self.low

    def draw(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Values, a few of them at the ends."""
        u = rng.random(count)
        u = np.where(rng.random(count) < _AT_ENDS, np.round(u), u)
        if self.log:
            return np.clip(self.low * (self.high / self.low) ** u, self.low, self.high)
        return self.low + u * (self.high - self.low)


@dataclass(frozen=True, eq=False)
class Points:
    """Places of a scene where something is seen.

    Attributes
    ----------
    models : list of Model
        The model at each.
    values : dict of str to ndarray
        What varies of its parameters, shape (n,) each.
    cos_theta, phi : ndarray, shape (n,)
        The direction that is given: of the viewer, or of the light for an albedo.
    light : ndarray, shape (n, 3), or None
        Towards the source, or its middle.
    seed : int
        What draws at these places start from.
    memo : dict
        What was made for these places, and for the first of them, by those who made it.
    """

    models: list[Model]
    values: dict[str, np.ndarray]
    cos_theta: np.ndarray
    phi: np.ndarray
    light: np.ndarray | None
    seed: int
    memo: dict[Any, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.models)

    @cached_property
    def given(self) -> np.ndarray:
        """The direction that is given, shape (n, 3)."""
        return spherical(self.cos_theta, self.phi)

    def first(self, count: int) -> Points:
        """The first of the places, which remember what all of them do."""
        values = {name: v[:count] for name, v in self.values.items()}
        light = None if self.light is None else self.light[:count]
        cos_theta, phi = self.cos_theta[:count], self.phi[:count]
        models = self.models[:count]
        return Points(models, values, cos_theta, phi, light, self.seed, self.memo)


@dataclass(frozen=True)
class Scene:
    """A question.

    Attributes
    ----------
    model : Model
        With one channel; parameters that vary replace its own.
    axes : tuple of Axis
        What varies of its parameters.
    theta : (float, float)
        Smallest and largest angle to the normal, of views and of lights, degrees.
    light : str
        Of `LIGHTS`.
    radius : float
        Angular radius of round sources, degrees.
    of : str
        Of `SEEN`.
    rtol, atol : float
        What is seen may be wrong by max(atol, rtol of it).
    """

    model: Model
    axes: tuple[Axis, ...]
    theta: tuple[float, float]
    light: str
    radius: float
    of: str
    rtol: float
    atol: float

    @property
    def integral(self) -> bool:
        """Whether an integral over the hemisphere is asked for."""
        return self.light == "sky" or self.of == "albedo"

    @property
    def fixed(self) -> str:
        """Which direction is given where it matters."""
        reads_view = self.light == "sky" and self.of == "radiance"
        return "view" if reads_view and not self.model.reciprocal else "light"

    def models(self, values: Mapping[str, np.ndarray], count: int) -> list[Model]:
        """The model for every set of values."""
        if not values:
            return [self.model] * count
        columns = {name: v.tolist() for name, v in values.items()}
        models = [
            self.model.replace(**dict(zip(columns, row, strict=True)))
            for row in zip(*columns.values(), strict=True)
        ]
        parts_of(models)
        return models

    def points(self, seed: int, count: int, sets: int | None = None) -> Points:
        """Draw places of the scene.

        Parameters
        ----------
        seed : int
            Different seeds give places that have nothing to do with each other.
        count : int
        sets : int, optional
            At most so many sets of parameters, each for several places.

        Returns
        -------
        Points
            Angles to the normal are even in the angle, azimuths in the circle, parameters between
            their ends, or in the logarithm where those are far apart; of each a twentieth is at an
            end. One half of the lights is even over the solid angle, the other is drawn as the
            model reflects, so that highlights are seen.
        """
        rng = np.random.default_rng((seed, 0x5CE9E))
        sets = count if sets is None else min(sets, count)
        which = np.arange(count) % sets
        drawn = {axis.name: axis.draw(rng, sets) for axis in self.axes}
        values = {name: v[which] for name, v in drawn.items()}
        theta = Axis("theta", *self.theta).draw(rng, count)
        low, high = self.cosines
        cos_theta = np.clip(np.cos(np.radians(theta)), low, high)
        phi = rng.uniform(-math.pi, math.pi, count)
        few = self.models(drawn, sets)
        models = [few[k] for k in which]
        light = None if self.integral else self._lights(models, cos_theta, phi, rng)
        return Points(models, values, cos_theta, phi, light, seed)

    @property
    def cosines(self) -> tuple[float, float]:
        """Smallest and largest cosine to the normal."""
        low, high = self.theta
        # cos(90 degrees) is no 0 in floating point.
        return math.sin(math.radians(90.0 - high)), math.cos(math.radians(low))

    def _lights(
        self, models: list[Model], cos_theta: np.ndarray, phi: np.ndarray, rng: np.random.Generator
    ) -> np.ndarray:
        low, high = self.cosines
        if self.light == "area":
            # A round source is above the horizon as a whole.
            low = max(low, math.sin(math.radians(self.radius)))
        count = len(models)
        evenly = spherical(rng.uniform(low, high, count), rng.uniform(-math.pi, math.pi, count))
        given = spherical(cos_theta, phi)
        found = evenly.copy()
        u = rng.random((count, 2))
        mixtures: dict[int, Mixture] = {}
        for row in range(0, count, 2):
            model = models[row]
            if id(model) not in mixtures:
                mixtures[id(model)] = mixture_of(model)
            mixture = mixtures[id(model)]
            wi = np.ascontiguousarray(given[row].reshape(3, 1))
            direction = mixture.draw(wi, u[row].reshape(2, 1, 1).copy())[0][:, 0, 0]
            if low <= direction[2] <= high:
                found[row] = direction
        return found

    def allowed(self, seen: np.ndarray) -> np.ndarray:
        """What may be wrong of what is seen."""
        return np.maximum(self.atol, self.rtol * np.abs(seen))

    def reference(self, points: Points) -> np.ndarray:
        """What is seen at places, shape (n,), to a thousandth of what may be wrong.

        Parameters
        ----------
        points : Points

        Raises
        ------
        InputError
            Where that cannot be had, to a twentieth at least.
        """
        models = points.models
        if self.integral:
            rtol, atol = max(_SHARE * self.rtol, 1e-12), _SHARE * self.atol
            place = points.cos_theta, points.phi
            value, error, _ = albedos(models, *place, rtol, atol, self.fixed)
            self._check(points, error, value)
            return value
        if self.light == "point":
            return radiance(Rows(models), points)
        return self._round(points, Rows(models))

    def evaluations(self, points: Points) -> float:
        """How often the reference of an albedo evaluates the model for a place, in the mean."""
        rtol, atol = max(_SHARE * self.rtol, 1e-12), _SHARE * self.atol
        place = points.cos_theta, points.phi
        return float(albedos(points.models, *place, rtol, atol, self.fixed)[2].mean())

    def _check(self, points: Points, error: np.ndarray, value: np.ndarray) -> None:
        wrong = ~(error <= 0.05 * self.allowed(value))
        if wrong.any():
            at = int(np.flatnonzero(wrong)[0])
            raise InputError(
                f"what is seen of {points.models[at].spec} at cos_theta = "
                f"{points.cos_theta[at]:.3g} is known to {error[at]:.1g} only, of a tolerance of "
                f"{self.allowed(value)[at]:.1g}; ask for less"
            )

    def _round(self, points: Points, rows: Rows) -> np.ndarray:
        """Means of f n.l over round sources, with more nodes until two rules agree."""
        found = disc_mean(rows, points, *disc_rule(_RINGS, _TURNS), self.radius)
        left = np.arange(len(points))
        for step in range(1, _DOUBLINGS + 1):
            rule = disc_rule(_RINGS << step, _TURNS << step)
            finer = disc_mean(rows.take(left), _subset(points, left), *rule, self.radius)
            moved = np.abs(finer - found[left])
            found[left] = finer
            left = left[moved > 0.05 * self.allowed(finer)]
            if not left.size:
                return found
        at = int(left[0])
        raise InputError(
            f"the highlight of {points.models[at].spec} is too narrow for a source of radius "
            f"{self.radius:g} degrees: what is seen of it is not known to a twentieth of the "
            "tolerance; ask for less, for a smaller source, or for point sources"
        )


def _subset(points: Points, which: np.ndarray) -> Points:
    values = {name: v[which] for name, v in points.values.items()}
    assert points.light is not None
    return Points(
        [points.models[i] for i in which],
        *(values, points.cos_theta[which], points.phi[which], points.light[which], points.seed),
    )


def radiance(rows: Rows, points: Points) -> np.ndarray:
    """f n.l for the light and the view of places, shape (n,), per unit of radiance times sr."""
    assert points.light is not None
    wi, wo = points.light, points.given
    h = half_vector(wi, wo)
    vectors = wi.T, wo.T[:, :, None], h.T[:, :, None]
    return rows(*(np.ascontiguousarray(v) for v in vectors))[:, 0] * wi[:, 2]


def disc_rule(rings: int, turns: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gauss nodes over a cap: shares of 1 - cos of its radius, azimuths, and weights to 1."""
    x, w = np.polynomial.legendre.leggauss(rings)
    share, turn = np.meshgrid(
        0.5 * (x + 1.0), 2.0 * math.pi * (np.arange(turns) + 0.5) / turns, indexing="ij"
    )
    weight = np.repeat(0.5 * w / turns, turns)
    return share.ravel(), turn.ravel(), weight


def disc_mean(
    rows: Rows,
    points: Points,
    share: np.ndarray,
    turn: np.ndarray,
    weight: np.ndarray,
    radius: float,
) -> np.ndarray:
    """Weighted means of f n.l over nodes of round sources about the lights, shape (n,)."""
    assert points.light is not None
    # 1 - cos of the angle to the middle is a share of 2 sin^2(radius/2).
    short = 2.0 * math.sin(0.5 * math.radians(radius)) ** 2 * share
    sine = np.sqrt(short * (2.0 - short))
    middle = points.light
    x = np.where(np.abs(middle[:, :1]) < 0.8, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    x = x - (x * middle).sum(1, keepdims=True) * middle
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    y = np.cross(middle, x)
    total = np.empty(len(middle))
    step = max(1, _HELD // share.size)
    for first in range(0, len(middle), step):
        own = np.arange(first, min(first + step, len(middle)))
        lights = (
            (1.0 - short)[:, None] * middle[own, None, :]
            + (sine * np.cos(turn))[:, None] * x[own, None, :]
            + (sine * np.sin(turn))[:, None] * y[own, None, :]
        )
        f = rows.take(own).of_lights(lights, points.given[own])
        total[own] = (f * lights[:, :, 2]) @ weight
    return total
