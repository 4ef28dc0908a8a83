"""Ways to what a scene needs: each with a price, its bytes, and the numbers that it gives.

For an albedo: constants, polynomials and tables (`albedo.advice.small`), rules on angles, Monte
Carlo, the nested quadrature. For the radiance from sources: the model itself in float64 and
float32, and for round sources means over a few directions. And all of these for models that leave
something out.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from albedo._compile import is_kernel
from albedo._threads import in_batches
from albedo.advice.prices import Prices
from albedo.advice.rows import Rows, albedos, spike_energy
from albedo.advice.scene import Points, Scene, disc_mean, radiance
from albedo.brdf import Model
from albedo.directions import half_vector, spherical
from albedo.sampling.mixture import Mixture, Values, lift, mixture_of, weights
from albedo.sampling.routines import COSINE

if TYPE_CHECKING:
    from albedo.advice.small import SmallWays

RULES = (2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)
"""Polar angles of the rules on angles; they have twice as many azimuths."""
DRAWS = tuple(2**k for k in range(2, 17))
DIGITS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-6, 1e-8)
"""What the nested quadrature is asked for."""
SOURCES = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32)
"""Directions to a round source along each side of a square that is mapped to it."""

# Directions held at once by Monte Carlo and by rules on angles.
_HELD = 2**18
# Draws that are worth another thread.
_WORTH = 2**13


class Lazy:
    """Something that is made when it is first asked for, and kept."""

    def __init__(self, make: Callable[[], Any]) -> None:
        self._make = make
        self._made: Any = None

    def get(self) -> Any:
        """What is made."""
        if self._made is None:
            self._made = self._make()
        return self._made


@dataclass(frozen=True, eq=False)
class Way:
    """One way.

    Attributes
    ----------
    kind : str
        Such as ``table`` or ``polynomial``.
    detail : str
        Of which size.
    without : str
        What the model leaves out; empty for the model itself.
    ns : float
        Price of a number, from the table of prices.
    bytes : int
        What it reads beside the model's parameters.
    values : callable
        Numbers at `Points`, shape (n,).
    work : float
        Evaluations of the model for each number.
    made : Lazy or None
        Makes what is read.
    """

    kind: str
    detail: str
    without: str
    ns: float
    bytes: int
    values: Callable[[Points], np.ndarray]
    work: float = 0.0
    made: Lazy | None = None

    @property
    def family(self) -> tuple[str, str]:
        """What a runner-up must differ in."""
        return self.kind, self.without

    def __str__(self) -> str:
        said = f"{self.kind}, {self.detail}" if self.detail else self.kind
        return said + (f", without {self.without}" if self.without else "")


@dataclass(frozen=True, eq=False)
class Places:
    """Points of a scene with what is seen there.

    Attributes
    ----------
    scene : Scene
    points : Points
    known : ndarray, shape (n,)
    """

    scene: Scene
    points: Points
    known: np.ndarray

    @classmethod
    def draw(cls, scene: Scene, seed: int, count: int, sets: int | None = None) -> Places:
        """New places; see `Scene.points`."""
        points = scene.points(seed, count, sets)
        return cls(scene, points, scene.reference(points))

    @cached_property
    def allowed(self) -> np.ndarray:
        """What may be wrong, shape (n,)."""
        return self.scene.allowed(self.known)

    def worst(self, way: Callable[[Points], np.ndarray], count: int | None = None) -> float:
        """The largest error at the first of the places, as a share of what is allowed."""
        points = self.points if count is None else self.points.first(count)
        off = np.abs(way(points) - self.known[: len(points)])
        # Where nothing is seen, and nothing may be wrong, nothing must be wrong.
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(off == 0.0, 0.0, off / self.allowed[: len(points)])
        return math.inf if np.isnan(ratio).any() else float(ratio.max())


@dataclass(frozen=True)
class Variant:
    """A model that may leave something out, at every place of a scene.

    Attributes
    ----------
    path : tuple of str
        What is left out, one after the other, as `Model.simpler` calls it.
    typical : Model
        For the price.
    """

    path: tuple[str, ...]
    typical: Model

    @property
    def without(self) -> str:
        return " and ".join(self.path)

    def of(self, model: Model) -> Model:
        """The model at one place; where there is nothing to leave out, as it is."""
        for name in self.path:
            model = model.simpler().get(name, model)
        return model

    def models(self, points: Points) -> list[Model]:
        """The models at places; those that are the same object stay so."""
        if not self.path:
            return points.models
        known: list[Model] = points.memo.setdefault(self.path, [])
        seen: dict[int, Model] = points.memo.setdefault((self.path, "seen"), {})
        for model in points.models[len(known) :]:
            if id(model) not in seen:
                seen[id(model)] = self.of(model)
            known.append(seen[id(model)])
        return known[: len(points)]

    def rows(self, points: Points, precision: str = "float64") -> Rows:
        """Values of these models, in float64 or in float32."""
        key = self.path, precision
        known = points.memo.get(key)
        if known is None or len(known) < len(points):
            models = self.models(points)
            if precision == "float64":
                known = Rows(models)
            else:
                from albedo._compile import in_single

                known = Rows(models, in_single, np.float32)
            points.memo[key] = known
        return known.take(np.arange(len(points)))


def variants(scene: Scene, first: Model) -> list[Variant]:
    """The model, and all that can be left out of it, each once.

    Parameters
    ----------
    scene : Scene
    first : Model
        The model at any place.
    """
    typical = scene.models({a.name: np.array([_middle(a)]) for a in scene.axes}, 1)[0]
    # Parameters may be equal in the middle, and differ elsewhere.
    seen = {(typical.spec, first.spec)}
    found = [Variant((), typical)]
    queue: list[tuple[tuple[str, ...], Model, Model]] = [((), typical, first)]
    while queue:
        path, model, other = queue.pop(0)
        for name in dict.fromkeys((*model.simpler(), *other.simpler())):
            simple = model.simpler().get(name, model), other.simpler().get(name, other)
            key = simple[0].spec, simple[1].spec
            if key not in seen:
                seen.add(key)
                found.append(Variant((*path, name), simple[0]))
                queue.append(((*path, name), *simple))
    return found


def _middle(axis: Any) -> float:
    return math.sqrt(axis.low * axis.high) if axis.log else 0.5 * (axis.low + axis.high)


@dataclass(eq=False)
class AlbedoWays:
    """Ways to the albedo of one variant in a scene.

    Attributes
    ----------
    scene : Scene
    variant : Variant
    prices : Prices
    pilot : Places
        Where ways are chosen.
    """

    scene: Scene
    variant: Variant
    prices: Prices
    pilot: Places

    def all(self) -> list[Way]:
        """All ways."""
        return [*self.direct(), *self._small.all()]

    def good(self) -> list[Way]:
        """All ways but tables and polynomials that are larger than they need be, or too small."""
        return [*self.direct(), *self._small.good()]

    @cached_property
    def _small(self) -> SmallWays:
        from albedo.advice.small import SmallWays

        return SmallWays(self.scene, self.variant, self.prices, self.pilot)

    def direct(self) -> Iterator[Way]:
        """What evaluates the model."""
        model, without = self.variant.typical, self.variant.without
        spikes = self.prices.spikes(model)
        for count in RULES:
            number = 2 * count * count
            price = number * self.prices.node(model) + spikes
            detail = f"{count} x {2 * count} angles"
            values = _Call(self._on_angles, count)
            yield Way("rule on angles", detail, without, price, 24 * number, values, number)
        for how, count in itertools.product(("cosine", "model", "sobol"), DRAWS):
            price = count * self.prices.draw(model, how) + spikes
            drawn = {"cosine": "of the cosine", "model": "of the lobe"}
            detail = f"{count} draws {drawn.get(how, 'of the lobe, Sobol')}"
            values = _Call(self._by_draws, how, count)
            yield Way("Monte Carlo", detail, without, price, 0, values, count)
        entry, each = self.prices.adaptive(model)
        few = self.pilot.points.first(16)
        models = self.variant.models(few)
        for rtol in DIGITS:
            place = few.cos_theta, few.phi
            mean = float(albedos(models, *place, rtol, 0.0, self.scene.fixed)[2].mean())
            values = _Call(self._nested, rtol)
            price = entry + mean * each + spikes
            yield Way("nested quadrature", f"rtol = {rtol:g}", without, price, 0, values, mean)

    def _nested(self, points: Points, rtol: float) -> np.ndarray:
        models = self.variant.models(points)
        return albedos(models, points.cos_theta, points.phi, rtol, 0.0, self.scene.fixed)[0]

    def _spikes(self, models: list[Model], points: Points) -> np.ndarray:
        return spike_energy(models, points.given)

    def _on_angles(self, points: Points, count: int) -> np.ndarray:
        """Gauss nodes in the polar angle, even ones in the azimuth."""
        models = self.variant.models(points)
        x, w = np.polynomial.legendre.leggauss(count)
        theta = 0.25 * math.pi * (x + 1.0)
        turn = 2.0 * math.pi * (np.arange(2 * count) + 0.5) / (2 * count)
        views = spherical(np.cos(theta)[:, None], turn[None, :]).reshape(-1, 3)
        # sin cos d theta d phi.
        weight = np.repeat(
            0.25 * math.pi * w * np.sin(theta) * np.cos(theta) * math.pi / count, 2 * count
        )
        rows, total = self.variant.rows(points), self._spikes(models, points)
        step = max(1, _HELD // len(views))
        for first in range(0, len(models), step):
            own = np.arange(first, min(first + step, len(models)))
            given = points.given[own]
            lights = np.broadcast_to(views, (len(own), *views.shape))
            total[own] += self._values(rows.take(own), given, lights) @ weight
        return total

    def _values(self, rows: Rows, given: np.ndarray, others: np.ndarray) -> np.ndarray:
        """f for given directions (m, 3) and others (m, k, 3)."""
        if self.scene.fixed == "view":
            return rows.of_lights(others, given)
        h = half_vector(given[:, None, :], others)
        columns = (np.ascontiguousarray(np.moveaxis(v, -1, 0)) for v in (others, h))
        return rows(np.ascontiguousarray(given.T), *columns)

    def _by_draws(self, points: Points, how: str, count: int) -> np.ndarray:
        """Means of weights of draws, as many at every place."""
        models = self.variant.models(points)
        total = self._spikes(models, points)
        rng = np.random.default_rng((points.seed, 0xD4A3))
        base = None
        if how == "sobol":
            from scipy.stats import qmc

            sobol = qmc.Sobol(2, scramble=True, rng=np.random.default_rng(5))
            base = sobol.random_base2(count.bit_length() - 1).T
        known: dict[int, tuple[Mixture, Values]] = {}
        cosine = Mixture((1.0,), (COSINE,))
        rows = [row for row, model in enumerate(models) if model.parts()]
        for row in rows:
            model = models[row]
            if id(model) not in known:
                mixture = cosine if how == "cosine" else mixture_of(model)
                known[id(model)] = mixture, Values(model)
        # What users wrote in Python may not be meant for several threads.
        safe = all(is_kernel(part.fill) for row in rows for part in models[row].parts())
        step = max(1, _HELD // count)
        for first in range(0, len(rows), step):
            block = rows[first : first + step]
            # The same points everywhere, shifted anew at every place.
            shifts = [rng.random((2, count if base is None else 1)) for _ in block]

            def add(which: slice, block: list[int] = block, shifts: Any = shifts) -> None:
                for row, u in zip(block[which], shifts[which], strict=True):
                    mixture, f = known[id(models[row])]
                    own = u if base is None else (base + u) % 1.0
                    total[row] += self._mean(mixture, f, points.given[row], own)

            in_batches(add, len(block), max(1, _WORTH // count) if safe else len(block))
        return total

    def _mean(self, mixture: Mixture, f: Values, given: np.ndarray, u: np.ndarray) -> float:
        wi = np.ascontiguousarray(given.reshape(3, 1))
        wo, h = mixture.draw(wi, np.ascontiguousarray(u[:, None, :]))
        pdf = mixture.density(wi, wo, h)
        below = np.empty(wo.shape[1:], dtype=bool)
        lift(wi, wo, h, below)
        if self.scene.fixed == "view":
            view = np.ascontiguousarray(np.repeat(wi, below.size, axis=1)[:, :, None])
            found = f(wo[:, 0], view, h.reshape(3, -1, 1)).reshape(below.shape)
        else:
            found = f(wi, wo, h)
        return float(weights(found, wo, pdf, below).mean())


@dataclass(eq=False)
class RadianceWays:
    """Ways to the radiance from sources, for one variant in a scene.

    Attributes
    ----------
    scene, variant, prices, pilot
        As of `AlbedoWays`.
    """

    scene: Scene
    variant: Variant
    prices: Prices
    pilot: Places

    def all(self) -> list[Way]:
        """All ways."""
        return list(self._ways())

    def good(self) -> list[Way]:
        """The same: there are few."""
        return self.all()

    def _ways(self) -> Iterator[Way]:
        model = self.variant.typical
        precisions = ["float64"]
        if self.prices.single(model):
            precisions.append("float32")
        for precision in precisions:
            each = self.prices.value(model, precision, "raw")
            if self.scene.light == "point":
                values: Callable[[Points], np.ndarray] = _Call(self._of_points, precision)
                yield Way("evaluation", precision, self.variant.without, each, 0, values, 1)
                continue
            for side in SOURCES:
                count = side * side
                detail = f"{count} directions to the source, {precision}"
                values = _Call(self._of_sources, precision, side)
                price = count * (each + self.prices.node(model) - self.prices.value(model))
                yield Way("mean", detail, self.variant.without, price, 24 * count, values, count)

    def _of_points(self, points: Points, precision: str) -> np.ndarray:
        return radiance(self.variant.rows(points, precision), points)

    def _of_sources(self, points: Points, precision: str, side: int) -> np.ndarray:
        """Middles of the cells of a square, mapped to the cap evenly in rings (Shirley)."""
        steps = 2.0 * (np.arange(side) + 0.5) / side - 1.0
        x, y = np.repeat(steps, side), np.tile(steps, side)
        along = np.abs(x) > np.abs(y)
        ring = np.where(along, x, y)
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = np.where(along, y / x, x / y)
        slope = np.where(ring == 0.0, 0.0, slope)
        turn = np.where(along, 0.25 * math.pi * slope, math.pi * (0.5 - 0.25 * slope))
        turn = np.where(ring < 0.0, turn + math.pi, turn)
        weight = np.full(side * side, 1.0 / (side * side))
        rows = self.variant.rows(points, precision)
        return disc_mean(rows, points, ring * ring, turn, weight, self.scene.radius)


@dataclass(frozen=True)
class _Call:
    """A method with its last arguments."""

    method: Callable[..., np.ndarray]
    arguments: tuple[Any, ...]

    def __init__(self, method: Callable[..., np.ndarray], *arguments: Any) -> None:
        object.__setattr__(self, "method", method)
        object.__setattr__(self, "arguments", arguments)

    def __call__(self, points: Points) -> np.ndarray:
        return self.method(points, *self.arguments)
