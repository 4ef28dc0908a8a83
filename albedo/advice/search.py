"""The search for the cheapest way, and the answer."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import albedo
from albedo.advice import prices as priced
from albedo.advice.prices import Prices
from albedo.advice.scene import LIGHTS, SEEN, Axis, Scene
from albedo.advice.ways import AlbedoWays, Places, RadianceWays, Variant, Way, variants
from albedo.brdf import Alias, Model, Real
from albedo.errors import InputError
from albedo.grammar import parse_ranges
from albedo.lookup.stored import Polynomial, Table

PILOT, FRESH = 0, 1
"""Seeds of the places where ways are tried first, and where the best ones are tested."""

CONFIDENCE = 0.95
"""How often the stated share holds."""

_PILOTS, _FEWEST, _TESTED = 512, 256, 2048
_FEWEST_SETS = 16
# Places that a way has to pass before it is looked at on more, and on all.
_FIRST = (2, 16)
# Places that tell what a reference costs.
_FEW = 4
# Nanoseconds of a way where it is chosen and where it is tested, and seconds of references, that
# one set of places may take.
_CHOSEN, _VERIFIED, _SECONDS = 2e8, 8e8, 0.6
# Prices within this ratio are equal: then fewer bytes win.
_EQUAL = 1.1


@dataclass(frozen=True, eq=False)
class Option:
    """A way that was tested.

    Attributes
    ----------
    way : Way
    predicted, verified : float
        The largest error as a share of what is allowed: at the places where ways were chosen, and
        at others.
    places : int
        How many these were.
    share : float
        At least this share of the places of the scene is within the tolerance, in `CONFIDENCE` of
        all cases.
    scene : Scene
    """

    way: Way
    predicted: float
    verified: float
    places: int
    share: float
    scene: Scene

    @property
    def ns(self) -> float:
        """Price of a number, nanoseconds on the machine of the table of prices."""
        return self.way.ns

    @property
    def bytes(self) -> int:
        """What it reads beside the model's parameters."""
        return self.way.bytes

    @property
    def made(self) -> Table | Polynomial | None:
        """The table or polynomial, where there is one."""
        found: Any = self.way.made
        return None if found is None else found.get()

    def error(self, ratio: float) -> str:
        """A share of what is allowed, in the units of the tolerance."""
        scene = self.scene
        if scene.rtol == 0.0:
            return f"{ratio * scene.atol:.2g}"
        if scene.atol == 0.0:
            return f"{100.0 * ratio * scene.rtol:.2g} percent"
        return f"{ratio:.2g} of the tolerance"

    def record(self, data: bool = False) -> dict[str, Any]:
        """All of it in plain words and numbers; with `data` also what is read.

        Returns
        -------
        dict
            ``axes`` say, for a table, between which ends each coordinate goes, what it is even in,
            and how many points it has; for a polynomial how many coefficients. ``data`` holds them
            with the last axis fastest, a polynomial's from the highest power of each coordinate
            on, where the coordinate is warped and then scaled from its ends to [-1, 1].
        """
        kept: dict[str, Any] = {
            "kind": self.way.kind,
            "detail": self.way.detail,
            "without": self.way.without,
            "ns": self.ns,
            "bytes": self.bytes,
            "predicted": self.predicted,
            "verified": self.verified,
            "places": self.places,
            "share": self.share,
        }
        made = self.made
        if made is not None:
            grid = made.grid
            kept["axes"] = [
                {"name": name, "low": min(ends), "high": max(ends), "even_in": warp, "count": count}
                for name, ends, warp, count in zip(
                    grid.names, grid.ends, grid.warps, grid.counts, strict=True
                )
            ]
            kept["stored"] = made.stored
            if isinstance(made, Table):
                kept["read"] = made.read
            if data:
                kept |= made.numbers()
        return kept

    def __str__(self) -> str:
        return (
            f"{self.way}\n"
            f"  price      {_plainly(self.ns)} ns, {self.bytes:,} bytes\n"
            f"  predicted  error up to {self.error(self.predicted)}\n"
            f"  verified   error up to {self.error(self.verified)} at {self.places} fresh places; "
            f"at least {100.0 * self.share:.4g} percent of all are within, with "
            f"{100.0 * CONFIDENCE:g} percent confidence"
        )


@dataclass(frozen=True, eq=False)
class Advice:
    """The answer.

    Attributes
    ----------
    scene : Scene
        The question.
    choice, runner_up : Option or None
        The cheapest way that was verified, and the cheapest of another kind. None where nothing
        fits.
    plain : float
        Price of what one would do without advice: the model evaluated in float64, or the nested
        quadrature; NaN where that misses the tolerance itself.
    tried, tested : int
        Ways that were tried, and those that were tested on fresh places.
    reason : str
        Why nothing fits, if so.
    machine : str
        Where prices were measured.
    """

    scene: Scene
    choice: Option | None
    runner_up: Option | None
    plain: float
    tried: int
    tested: int
    reason: str
    machine: str

    def record(self, data: bool = False) -> dict[str, Any]:
        """All of it in plain words and numbers; with `data` also what is read."""
        scene = self.scene
        asked = {
            "model": scene.model.spec,
            "varies": {axis.name: [axis.low, axis.high] for axis in scene.axes},
            "theta_degrees": list(scene.theta),
            "light": scene.light,
            "of": scene.of,
            "rtol": scene.rtol,
            "atol": scene.atol,
        }
        if scene.light == "area":
            asked["radius_degrees"] = scene.radius
        return {
            "asked": asked,
            "choice": None if self.choice is None else self.choice.record(data),
            "runner_up": None if self.runner_up is None else self.runner_up.record(),
            "plain_ns": self.plain,
            "tried": self.tried,
            "tested": self.tested,
            "reason": self.reason,
            "prices": self.machine,
            "source": f"albedo-workbench {albedo.__version__}",
        }

    def __str__(self) -> str:
        if self.choice is None:
            return f"Nothing fits: {self.reason}"
        lines = [str(self.choice)]
        if self.runner_up is not None:
            lines.append(f"runner-up: {self.runner_up}")
        plain = "the nested quadrature" if self.scene.integral else "the model in float64"
        ratio = self.plain / self.choice.ns
        takes = f"takes {_plainly(self.plain)} ns, {_plainly(ratio)} times as much"
        lines.append(
            f"{plain} {'misses the tolerance' if math.isnan(ratio) else takes}; {self.tried} ways "
            f"were tried, {self.tested} tested\n"
            f"prices are those of one machine: {self.machine.partition(chr(59))[0]}"
        )
        return "\n".join(lines)


def advise(
    model: Model | str,
    *,
    over: Mapping[str, tuple[float, float]] | None = None,
    theta: tuple[float, float] = (0.0, 85.0),
    light: str = "sky",
    radius: float = 5.0,
    of: str = "radiance",
    rtol: float = 0.0,
    atol: float = 0.0,
    ns: float = math.inf,
    bytes: float = math.inf,
    prices: Prices | None = None,
) -> Advice:
    """Find the cheapest way to what a scene needs of a model, and test it.

    Parameters
    ----------
    model : Model or str
        A model with one channel, or its name and parameters in the grammar; a swept number varies
        between the smallest and the largest value of its sweep.
    over : mapping of str to (float, float), optional
        Parameters that vary between two ends.
    theta : (float, float)
        Smallest and largest angle to the normal that is seen, degrees, in [0, 90].
    light : {"sky", "point", "area"}
        A uniform sky, point sources, or round sources.
    radius : float
        Angular radius of round sources, degrees, in (0, 45].
    of : {"radiance", "albedo"}
        What may be wrong: the radiance towards the viewer, or the directional albedo. Under a
        uniform sky they are the same, but for models that are not reciprocal.
    rtol, atol : float
        What is seen may be wrong by max(atol, rtol of it); one of them at least is not 0. A
        radiance from a source is f n.l, in 1/sr.
    ns, bytes : float
        The most that a number may cost.
    prices : Prices, optional
        Other prices than those of the package.

    Returns
    -------
    Advice

    Raises
    ------
    InputError
        For input out of range, and for what cannot be known well enough to test anything.

    Examples
    --------
    >>> import albedo
    >>> found = albedo.advise("ward:m=0.1..0.5/2", theta=(0, 80), rtol=0.01)
    >>> found.choice.verified < 1.0
    True
    """
    scene = _scene(model, over or {}, theta, light, radius, of, rtol, atol)
    for name, value in (("ns", ns), ("bytes", bytes)):
        if not value > 0.0:
            raise InputError(f"{name} = {value!r} is out of range; it must be above 0")
    return Search(scene, prices or priced.committed()).answer(ns, bytes)


def _scene(
    model: Model | str,
    over: Mapping[str, tuple[float, float]],
    theta: tuple[float, float],
    light: str,
    radius: float,
    of: str,
    rtol: float,
    atol: float,
) -> Scene:
    ranges = dict(over)
    if isinstance(model, str):
        model, swept = parse_ranges(model)
        for name in swept.keys() & ranges.keys():
            raise InputError(f"{name} is swept, and given in over; give one of them")
        ranges = swept | ranges
    if not isinstance(model, Model):
        raise InputError(f"advise needs a model or its name, not {type(model).__name__}")
    if model.channels is not None:
        raise InputError(
            f"{model.spec} has {model.channels} channels; ask for one, model.channel(i), or give "
            "colours as numbers"
        )
    for name, value, known in (("light", light, LIGHTS), ("of", of, SEEN)):
        if value not in known:
            raise InputError(f"{name} = {value!r} is unknown; choose {', '.join(known)}")
    small, large = _pair("theta", theta)
    if not 0.0 <= small <= large <= 90.0:
        raise InputError(f"theta = {theta!r} is out of range; it lies in [0, 90] degrees")
    if not 0.0 < radius <= 45.0:
        raise InputError(f"radius = {radius!r} is out of range; it lies in (0, 45] degrees")
    if light == "area" and of == "radiance" and small + radius >= 90.0:
        raise InputError(f"theta = {theta!r} leaves no place for a source of radius {radius:g}")
    for name, number in (("rtol", rtol), ("atol", atol)):
        if not (isinstance(number, int | float) and (number == 0.0 or 1e-9 <= number < 1.0)):
            raise InputError(f"{name} = {number!r} is out of range; it is 0 or lies in [1e-9, 1)")
    if rtol == 0.0 and atol == 0.0:
        raise InputError("give a tolerance, rtol or atol, above 0")
    axes = tuple(_axis(model, name, ends) for name, ends in ranges.items())
    if light != "sky" and of == "radiance" and not model.parts():
        raise InputError(
            f"{model.spec} has nothing but Dirac parts, which have no radiance that could be wrong"
        )
    return Scene(model, axes, (small, large), light, radius, of, rtol, atol)


def _pair(name: str, value: Any) -> tuple[float, float]:
    try:
        low, high = (float(end) for end in value)
    except (TypeError, ValueError):
        raise InputError(f"{name} = {value!r} is no range; give two numbers") from None
    if not (math.isfinite(low) and math.isfinite(high)):
        raise InputError(f"{name} = {value!r} is out of range; both ends must be finite")
    return low, high


def _axis(model: Model, name: str, ends: Any) -> Axis:
    low, high = _pair(name, ends)
    if low > high:
        raise InputError(f"{name} = {ends!r} ends before it begins")
    info = {item.name: item for item in model.parameter_info()}
    if not isinstance(info.get(name), Real | Alias):
        raise InputError(f"{model.name} has no number {name!r} that could vary")
    # Values out of range are refused here, by what declares the parameter.
    for value in (low, high):
        model.replace(**{name: value})
    return Axis(name, low, high)


class Search:
    """All ways in a scene, by their prices, with what they err by.

    Parameters
    ----------
    scene : Scene
    prices : Prices
    """

    def __init__(self, scene: Scene, prices: Prices) -> None:
        self.scene, self.prices = scene, prices
        count = _TESTED
        few = scene.points(PILOT, _FEW, _FEW)
        if scene.integral:
            entry, each = prices.adaptive(few.models[0])
            one = entry + scene.evaluations(few) * each
            count = int(_SECONDS * 1e9 / one)
        self.count = min(max(count, _FEWEST), _TESTED)
        # Models that take long to make are made for a few sets of parameters.
        self.sets = max(_FEWEST_SETS, int(_SECONDS * 1e9 / max(prices.made(scene.model), 1.0)))
        self.pilot = self.places(PILOT, min(_PILOTS, self.count))
        self.variants: list[Variant] = variants(scene, self.pilot.points.models[0])
        kind = AlbedoWays if scene.integral else RadianceWays
        self._makers = [kind(scene, one, prices, self.pilot) for one in self.variants]

    @cached_property
    def ways(self) -> list[Way]:
        """The ways that are gone through, the cheapest first."""
        return sorted((way for maker in self._makers for way in maker.good()), key=_order)

    @cached_property
    def all_ways(self) -> list[Way]:
        """All ways that there are."""
        return sorted((way for maker in self._makers for way in maker.all()), key=_order)

    @cached_property
    def fresh(self) -> Places:
        """Places that nothing was chosen by."""
        return self.places(FRESH, self.count)

    def places(self, seed: int, count: int) -> Places:
        """Places of the scene."""
        return Places.draw(self.scene, seed, count, self.sets if self.scene.axes else None)

    def independent(self, places: int) -> int:
        """How many of some places have nothing to do with each other."""
        return min(places, self.sets) if self.scene.axes else places

    def predicted(self, way: Way) -> float:
        """The largest error at the places where ways are chosen, as a share of what is allowed.

        What fails at the first few of them is not looked at further: there it is what is told.
        """
        most = max(_FIRST[-1], min(len(self.pilot.points), int(_CHOSEN / max(way.ns, 1.0))))
        worst = 0.0
        for count in (*_FIRST, most):
            worst = self.pilot.worst(way.values, count)
            if not worst <= 1.0 or count == most:
                break
        return worst

    def verified(self, way: Way) -> tuple[float, int]:
        """The same at fresh places, and how many these are."""
        most = len(self.fresh.points)
        count = min(max(_FEWEST, min(most, int(_VERIFIED / max(way.ns, 1.0)))), most)
        return self.fresh.worst(way.values, count), count

    def answer(self, ns: float, most_bytes: float) -> Advice:
        """Go through the ways from the cheapest on, and test what seems good enough."""
        found: list[Option] = []
        tried = tested = 0
        nearest = math.inf
        within = [way for way in self.ways if way.ns <= ns and way.bytes <= most_bytes]
        for way in within:
            if found and way.family == found[0].way.family:
                continue
            tried += 1
            predicted = self.predicted(way)
            nearest = min(nearest, predicted)
            if not predicted <= 1.0:
                continue
            tested += 1
            verified, places = self.verified(way)
            if verified <= 1.0:
                share = share_of(self.independent(places), tested)
                found.append(Option(way, predicted, verified, places, share, self.scene))
                if len(found) == 2:
                    break
        plain = self._plain()
        choice, second = (*found, None, None)[:2]
        reason = "" if found else self._why(within, nearest)
        return Advice(
            *(self.scene, choice, second, plain, tried, tested, reason, self.prices.machine)
        )

    def _plain(self) -> float:
        """Price of the model itself, as exactly as it is needed; NaN where it misses that."""
        kinds = {"nested quadrature", "evaluation", "mean"}
        own = [way for way in self.ways if way.kind in kinds and not way.without]
        exact = [way for way in own if way.kind != "evaluation" or way.detail == "float64"]
        for way in exact:
            if self.predicted(way) <= 1.0 and self.verified(way)[0] <= 1.0:
                return way.ns
        return math.nan

    def _why(self, within: list[Way], nearest: float) -> str:
        if not within:
            return "no way is within the budget"
        return (
            f"of {len(within)} ways within the budget the best errs by {nearest:.2g} times what "
            "is allowed at least, or fails on fresh places"
        )


def _plainly(number: float) -> str:
    """Three digits, without powers of ten."""
    return f"{float(f'{number:.3g}'):,.10g}"


def _order(way: Way) -> tuple[int, int, bool, float]:
    """The cheaper first; of what costs the same the smaller, then what leaves nothing out."""
    step = round(math.log(max(way.ns, 1e-3)) / math.log(_EQUAL))
    return step, way.bytes, bool(way.without), way.ns


def share_of(places: int, tested: int) -> float:
    """Share of a scene that is within a tolerance when all of some random places are.

    Were it less, all places would be within by luck in fewer than 5 percent of the cases; what is
    tested k-th gets 1/(k (k + 1)) of these.

    Parameters
    ----------
    places : int
    tested : int
        Ways that were tested, this one included.

    Returns
    -------
    float
    """
    return max(0.0, 1.0 - math.log(tested * (tested + 1) / (1.0 - CONFIDENCE)) / places)
