"""The fewest right digits that a search finds: over parameters and directions, way by way.

`albedo.analysis.stability` counts digits on a fixed map. Here hypothesis draws parameters from the
whole of their ranges and directions from special places, beside the lobe and from the horizon, and
climbs towards where more digits are lost (`hypothesis.target`). A value is compared as on the map.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from albedo._compile import cache_root
from albedo.analysis.precise import evaluate, is_plain, precise, single
from albedo.analysis.stability import FULL, WAYS, ExactFrame, Geometry, count_ways
from albedo.brdf import Alias, Choice, Model, Real, Vectors
from albedo.errors import InputError
from albedo.grammar import ModelSpec

if TYPE_CHECKING:
    import pandas as pd

EXAMPLES = 500
"""Cases of one search, unless told otherwise: a model and a light, with five views at most."""
LOWEST = 1e-12
"""The smallest cosine that is drawn."""

# What is drawn is a row of integers from 0 to 63, each with one meaning. hypothesis draws constants
# from the source of whatever is imported as well: none of these is below 100.
_BASE = 64
# Integers of a number: how it is drawn, and three digits; of both directions.
_NUMBER, _BOTH = 4, 4 * 4
# Where an infinite range ends, and where one from 0 begins, in decades; and open ones.
_INFINITE, _SMALL, _OPEN = 1e6, 1e-3, 1e-6
# A range of more than this is drawn from in decades.
_WIDE = 100.0
_SPECIAL_COSINES = (1.0, 0.99, 0.7, 0.3, 0.1, 1e-3, 1e-6, 1e-9, LOWEST)
_SPECIAL_AZIMUTHS = (0.0, 0.5 * math.pi, math.pi, 0.25 * math.pi)


@dataclass(frozen=True)
class WorstCase:
    """Where a way to values has the fewest right digits.

    Attributes
    ----------
    way : str
        One of `albedo.analysis.stability.WAYS`.
    digits, lost : float
        Right decimal digits, and all that there are less those.
    model : Model
        With its parameters.
    cos_theta, phi : float
        Cosine of the polar angle and azimuth of the light, radians.
    cos_view, phi_view : float
        Of the view.
    place : str
        How the view was drawn.
    value : float
        The exact value there, 1/sr.
    finite : bool
        Whether what the way gave is a number.
    """

    way: str
    digits: float
    lost: float
    model: Model
    cos_theta: float
    phi: float
    cos_view: float
    phi_view: float
    place: str
    value: float
    finite: bool


@dataclass
class Search:
    """What a search found.

    Attributes
    ----------
    name : str
        The model.
    worst : dict of str to WorstCase
        One for every way that has a value with digits.
    tried : dict of str to int
        How many values had digits to count, way by way.
    not_finite : dict of str to int
        How many of these were NaN or infinite.
    """

    name: str
    worst: dict[str, WorstCase] = field(default_factory=dict)
    tried: dict[str, int] = field(default_factory=lambda: dict.fromkeys(WAYS, 0))
    not_finite: dict[str, int] = field(default_factory=lambda: dict.fromkeys(WAYS, 0))

    def table(self) -> pd.DataFrame:
        """One row for every way."""
        import pandas as pd

        return pd.DataFrame(
            {
                "way": way,
                "values": self.tried[way],
                "not_finite": self.not_finite[way],
                "digits": case.digits,
                "lost": case.lost,
                "cos_theta": case.cos_theta,
                "phi_deg": math.degrees(case.phi),
                "cos_view": case.cos_view,
                "phi_view_deg": math.degrees(case.phi_view),
                "place": case.place,
                "value": case.value,
                "model": case.model.spec,
            }
            for way, case in self.worst.items()
        )


def search(
    what: Model | ModelSpec | str,
    *,
    examples: int = EXAMPLES,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Search:
    """Look for the values with the fewest right digits.

    Parameters
    ----------
    what : Model, ModelSpec or str
        A model, whose directions alone are searched; or a model in the grammar, whose other
        parameters are searched over their whole ranges, and sweeps over their values.
    examples : int
        Cases that are tried, at least 20, each with five views at most; half of them by climbing.
    seed : int
        The same seed gives the same cases.
    progress : callable, optional
        Called with cases done and cases in all.

    Returns
    -------
    Search
        The worst case of each way.

    Raises
    ------
    InputError
        For what `albedo.analysis.stability.measure` refuses, and for too few examples.
    """
    import hypothesis

    if not isinstance(examples, int) or examples < 20:
        raise InputError(f"examples = {examples!r} is out of range; it must be at least 20")
    models = _Models.of(what)
    found, done = Search(models.name), 0

    def case(row: tuple[int, ...]) -> None:
        model = models.draw(row[_BOTH:])
        light, geometry = _directions(row[:_BOTH], model)
        counted = count_ways(model, geometry, single())
        nonlocal done
        done += 1
        if progress is not None:
            progress(min(done, examples), examples)
        for way in WAYS:
            digits, wrong = counted[way], counted[f"{way}_not_finite"]
            seen = np.flatnonzero(~np.isnan(digits))
            if not seen.size:
                continue
            found.tried[way] += seen.size
            found.not_finite[way] += int(wrong[seen].sum())
            least = int(seen[np.argmin(digits[seen])])
            fewest = float(digits[least])
            hypothesis.target(FULL[way] - fewest, label=way)
            if way not in found.worst or fewest < found.worst[way].digits:
                x, y, z = geometry.wo[least].astype(np.float64)
                found.worst[way] = WorstCase(
                    *(way, fewest, FULL[way] - fewest, model, *light),
                    *(float(z), math.atan2(y, x), geometry.places[least]),
                    *(float(counted["value"][least]), not bool(wrong[least])),
                )

    with _own_folder():
        _settled(hypothesis, _BOTH + models.size, examples, seed)(case)()
    if progress is not None:
        progress(examples, examples)
    return found


def _settled(
    hypothesis: Any, size: int, examples: int, seed: int
) -> Callable[[Any], Callable[[], None]]:
    """What makes a function of a row of integers a search that is the same each time."""
    settings = hypothesis.settings(
        max_examples=examples,
        derandomize=True,
        database=None,
        deadline=None,
        print_blob=False,
        suppress_health_check=list(hypothesis.HealthCheck),
        phases=(hypothesis.Phase.generate, hypothesis.Phase.target),
    )
    integers = hypothesis.strategies.integers(0, _BASE - 1)
    given = hypothesis.given(hypothesis.strategies.tuples(*[integers] * size))
    return lambda case: hypothesis.seed(seed)(settings(given(case)))


@contextmanager
def _own_folder() -> Iterator[None]:
    """Let hypothesis keep what it reads of sources in the cache, not in the current folder."""
    from hypothesis import configuration

    before = configuration.storage_directory(intent_to_write=False).path
    configuration.set_hypothesis_home_dir(cache_root() / "hypothesis")
    try:
        yield
    finally:
        configuration.set_hypothesis_home_dir(before)


# Draws --------------------------------------------------------------------------------------------


def _one_of(drawn: int, values: Any) -> Any:
    """One of a few values."""
    return values[drawn % len(values)]


def _share(digits: tuple[int, ...]) -> float:
    """A number in [0, 1], both ends included, of its digits."""
    whole = 0
    for digit in digits:
        whole = whole * _BASE + digit
    return float(whole / (_BASE ** len(digits) - 1))


def _decades(digits: tuple[int, ...], low: float, high: float) -> float:
    """A number in [low, high], even in its logarithm."""
    return float(min(max(low * (high / low) ** _share(digits), low), high))


def _ends(parameter: Real) -> tuple[float, float]:
    """The ends of a range; something large for what is infinite."""
    low = parameter.low + _OPEN if parameter.open_low else parameter.low
    return (
        low if math.isfinite(low) else -_INFINITE,
        parameter.high if math.isfinite(parameter.high) else _INFINITE,
    )


def _real(row: tuple[int, ...], parameter: Real, given: bool = False) -> float | None:
    """A number of a closed range: an end, or anything between; none at all unless it is `given`."""
    kinds: tuple[str, ...] = ("low", "high", "even", "decades", "decades", "negative")
    if parameter.default is None and not given:
        kinds += ("none",) * 6
    kind = _one_of(row[0], kinds)
    if kind == "none":
        return None
    low, high = _ends(parameter)
    if kind in ("low", "high"):
        return low if kind == "low" else high
    if kind == "even" and high <= _WIDE * max(abs(low), 1.0):
        return low + (high - low) * _share(row[1:])
    if low < 0.0:
        found = _decades(row[1:], _SMALL, high)
        return max(low, -found) if kind == "negative" else found
    return _decades(row[1:], low or min(_SMALL, _SMALL * high), high)


@dataclass
class _Models:
    """Models of one class, or one model.

    Attributes
    ----------
    name : str
    kind : type, optional
        What parameters are drawn for; None for one model.
    fixed : dict
        Parameters with one value.
    swept : dict
        Parameters with a few values.
    needed : frozenset of str
        Parameters that always have a number.
    one : Model, optional
    """

    name: str
    kind: type[Model] | None = None
    fixed: dict[str, Any] = field(default_factory=dict)
    swept: dict[str, list[Any]] = field(default_factory=dict)
    one: Model | None = None
    words: dict[str, list[str]] = field(default_factory=dict)
    coarse: bool = False
    needed: frozenset[str] = frozenset()

    @classmethod
    def of(cls, what: Model | ModelSpec | str) -> _Models:
        """What a search goes over."""
        from albedo.catalogue import model_class
        from albedo.grammar import parse_model

        if isinstance(what, Model):
            _known(what)
            return cls(what.name, one=what.by_channel()[0])
        spec = parse_model(what, "A search for the worst case") if isinstance(what, str) else what
        kind = model_class(spec.name)
        swept = {name: list(values) for name, values in spec.sweep.items()}
        found = cls(spec.name, kind, dict(spec.fixed), swept)
        first = {name: values[0] for name, values in swept.items()}
        default = kind(**found.fixed, **first)
        if kind.as_lobes and not default.parts():
            # Without these parameters there is no value to look at.
            lobes = parse_model(f"{kind.name}:{kind.as_lobes}", "A search").sweep
            default = kind(**found.fixed, **first, **{k: v[0] for k, v in lobes.items()})
            found.needed = frozenset(lobes)
        _known(default)
        for p in kind.parameter_info():
            if isinstance(p, Choice) and p.name not in found.settled:
                found.words[p.name] = [w for w in p.choices if found._plain({**first, p.name: w})]
        # Numbers that a model finds by quadrature take it seconds: few sets of parameters then.
        found.coarse = any(callable(p.doubt) or p.doubt > 0.0 for p in default.parts())
        return found

    @property
    def settled(self) -> set[str]:
        """Parameters about which nothing is drawn."""
        names = {*self.fixed, *self.swept}
        assert self.kind is not None
        for p in self.kind.parameter_info():
            if isinstance(p, Alias) and (p.name in names or names & set(p.targets)):
                names |= set(p.targets)
        return names

    def _plain(self, values: dict[str, Any]) -> bool:
        """Whether a model is kernels of plain arithmetic with these parameters."""
        assert self.kind is not None
        try:
            parts = self.kind(**self.fixed, **values).parts()
        except InputError:
            # It may go together with others.
            return True
        return all(is_plain(part) for part in parts)

    @property
    def size(self) -> int:
        """How many integers `draw` reads."""
        if self.kind is None:
            return 0
        parameters = self.kind.parameter_info()
        vectors = (len(p.entries) for p in parameters if isinstance(p, Vectors))
        return len(self.swept) + _NUMBER * (len(parameters) + sum(vectors))

    def draw(self, row: tuple[int, ...]) -> Model:
        """A model that has values with digits to count."""
        from hypothesis import assume

        if self.one is not None:
            return self.one
        assert self.kind is not None
        place = 0

        def take(count: int) -> tuple[int, ...]:
            nonlocal place
            place += count
            return row[place - count : place]

        values: dict[str, Any] = {k: _one_of(take(1)[0], few) for k, few in self.swept.items()}
        settled = self.settled
        parameters = self.kind.parameter_info()
        declared = {p.name: p for p in parameters if p.name not in settled}
        for p in declared.values():
            if isinstance(p, Choice):
                values[p.name] = _one_of(take(_NUMBER)[0], self.words[p.name])
            elif isinstance(p, Vectors):
                values[p.name] = (tuple(_real(take(_NUMBER), entry) for _, entry in p.entries),)
            elif isinstance(p, Real):
                values[p.name] = self._number(take(_NUMBER), p)
        for p in parameters:
            if isinstance(p, Alias) and set(p.targets) <= declared.keys() and take(1)[0] % 2:
                values |= dict.fromkeys(p.targets, values[p.targets[0]])
        plain = {p.name: p.default for p in parameters if not isinstance(p, Alias)}
        used = self.kind.used(object.__new__(self.kind), {**plain, **self.fixed, **values})
        kept = {k: v for k, v in values.items() if k not in declared or k in used}
        try:
            model = self.kind(**self.fixed, **kept).by_channel()[0]
        except InputError:
            model = None
        assume(model is not None)
        assert model is not None
        assume(bool(model.parts()) and all(is_plain(part) for part in model.parts()))
        return model

    def _number(self, row: tuple[int, ...], parameter: Real) -> float | None:
        if self.coarse:
            low, high = max(parameter.low, _SMALL), _ends(parameter)[1]
            return float(_one_of(row[0], (low, math.sqrt(low * high), high)))
        return _real(row, parameter, parameter.name in self.needed)


def _known(model: Model) -> None:
    """Refuse what has no digits to count."""
    if not model.parts():
        raise InputError(f"{model.spec} is all Dirac parts: no value of it has digits to count")
    above = precise().array([[0.0, 0.0, 1.0]])
    evaluate(model.by_channel()[0], precise(), above, above, above + above)


def _directions(row: tuple[int, ...], model: Model) -> tuple[tuple[float, float], Geometry]:
    """Cosine and azimuth of the light; the special places, one beside the lobe, and any other."""
    lit, turned, first, second = (row[k : k + _NUMBER] for k in range(0, _BOTH, _NUMBER))
    c = _cosine(lit)
    turn = 0.0 if model.isotropic else _azimuth(turned)
    frame = ExactFrame(precise(), c, turn)
    zero, one = frame.arithmetic.number(0.0), frame.arithmetic.number(1.0)
    wx, wy = (min(w, 1.0) for w in model.parts()[0].widths)
    across = math.hypot(wx * math.cos(turn), wy * math.sin(turn))
    beside = math.hypot(wx * math.sin(turn), wy * math.cos(turn))
    far, azimuth = _decades(first[1:], 1e-3, 30.0), _azimuth(second)
    x, y = far * math.cos(azimuth), far * math.sin(azimuth)
    views = {
        "mirror": frame.about(0.0, 0.0),
        "retro": frame.light,
        "normal": frame.turned(zero, zero, one),
        f"H at ({x:.4g}, {y:.4g}) widths": frame.about(x * across, y * beside),
        f"{math.degrees(azimuth):.4g} degrees from L": frame.beside(_cosine(first), azimuth),
    }
    # Above the horizon, also when it is rounded.
    kept = {name: view for name, view in views.items() if float(view[2]) > 0.0}
    wo = np.stack(list(kept.values()))
    wi = np.stack([frame.light] * len(kept))
    return (c, turn), Geometry(list(kept), wi, wo, wi + wo)


def _cosine(row: tuple[int, ...]) -> float:
    """A cosine from 1 down to `LOWEST`."""
    kind = _one_of(row[0], ("special", "decades", "decades", "even"))
    if kind == "special":
        return float(_one_of(row[1], _SPECIAL_COSINES))
    return max(_share(row[1:]), LOWEST) if kind == "even" else _decades(row[1:], LOWEST, 1.0)


def _azimuth(row: tuple[int, ...]) -> float:
    """An azimuth in radians: a special one, one beside it, or any."""
    kind = _one_of(row[0], ("special", "beside", "any"))
    if kind == "any":
        return 2.0 * math.pi * _share(row[1:])
    at = float(_one_of(row[1], _SPECIAL_AZIMUTHS))
    return at if kind == "special" else at + _decades(row[2:], LOWEST, 1.0)
