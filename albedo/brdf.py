"""What a reflectance model is: parameters as data, kernels on arrays, promises that tests hold.

A model is one class in one file of ``albedo/catalogue/``. It declares its parameters, packs what
its kernels need into a row of numbers, and lists its *parts*: each part is a kernel in 1/sr with
the chart in which its lobe is wide and smooth. Everything else (albedo, tables, command line,
plots, tests) reads these declarations.
"""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from albedo.directions import half_vector, unit_vectors
from albedo.errors import InputError
from albedo.grammar import format_value

if TYPE_CHECKING:
    from albedo.sampling.mixture import Sample
    from albedo.sampling.routines import Routine

Kernel = Callable[..., Any]


@dataclass(frozen=True)
class Parameter:
    """A declared parameter: reading it on a model gives the value of that model."""

    default: Any
    doc: str
    unit: str = "1"
    name: str = field(default="", init=False, compare=False)

    def __set_name__(self, owner: type, name: str) -> None:
        object.__setattr__(self, "name", name)

    def __get__(self, model: Model | None, owner: type) -> Any:
        return self if model is None else model.parameters[self.name]

    @property
    def range_text(self) -> str:
        """What is allowed, in words."""
        raise TypeError(f"{type(self).__name__} must say what it allows")

    def check(self, model: str, value: Any) -> Any:
        """Return the value that is stored, or raise InputError."""
        raise TypeError(f"{type(self).__name__} must check its values")


@dataclass(frozen=True)
class Real(Parameter):
    """A real parameter in a closed interval, open below when `open_low`.

    With the default None it may be left out: then the model works without it.
    """

    low: float = 0.0
    high: float = math.inf
    open_low: bool = False

    @property
    def range_text(self) -> str:
        """The interval, such as ``(0, 10]``."""
        left = "(" if self.open_low or self.low == -math.inf else "["
        right = ")" if self.high == math.inf else "]"
        return f"{left}{self.low:g}, {self.high:g}{right}"

    def check(self, model: str, value: Any) -> float | None:
        """A finite float in range; None where that is the default."""
        if value is None and self.default is None:
            return None
        if isinstance(value, str | bool) or np.ndim(value) != 0:
            raise InputError(f"{model}: {self.name} = {value!r} is not a number; {self._allowed}")
        if np.iscomplexobj(value):
            raise InputError(f"{model}: {self.name} = {value} is complex; {self._allowed}")
        try:
            number = float(value)
        except (TypeError, ValueError):
            raise InputError(
                f"{model}: {self.name} = {value!r} is not a number; {self._allowed}"
            ) from None
        if not (self.low <= number <= self.high) or math.isinf(number):
            raise InputError(f"{model}: {self.name} = {number:g} is out of range; {self._allowed}")
        if self.open_low and number == self.low:
            raise InputError(f"{model}: {self.name} = {number:g} is out of range; {self._allowed}")
        return number

    @property
    def _allowed(self) -> str:
        return f"it must lie in {self.range_text}"


@dataclass(frozen=True)
class Color(Real):
    """A number, or a tuple of numbers: one for each channel, such as red, green and blue.

    Reading it on one channel of a model gives the number of that channel.
    """

    def __get__(self, model: Model | None, owner: type) -> Any:
        if model is None:
            return self
        value = model.parameters[self.name]
        if isinstance(value, tuple) and model.selected_channel is not None:
            return value[model.selected_channel]
        return value

    @property
    def range_text(self) -> str:
        """The interval that every channel lies in."""
        return super().range_text + ", or a tuple of such"

    def check(self, model: str, value: Any) -> Any:
        """A finite float in range, or a tuple of them."""
        if not (isinstance(value, tuple | list) or np.ndim(value) == 1):
            return super().check(model, value)
        if not len(value):
            raise InputError(f"{model}: {self.name} has no channel; {self._allowed}")
        return tuple(super(Color, self).check(model, item) for item in value)


@dataclass(frozen=True)
class Choice(Parameter):
    """A parameter that is one of a few words."""

    choices: tuple[str, ...] = ()

    @property
    def range_text(self) -> str:
        """The words, separated by bars."""
        return " | ".join(self.choices)

    def check(self, model: str, value: Any) -> str:
        """One of the words, or the number that one of them spells."""
        if isinstance(value, int | float) and not isinstance(value, bool):
            value = f"{value:g}"
        if value not in self.choices:
            raise InputError(
                f"{model}: {self.name} = {value!r} is unknown; choose one of "
                + ", ".join(self.choices)
            )
        return str(value)


@dataclass(frozen=True)
class Vectors(Parameter):
    """One or more vectors, each with the same named entries."""

    entries: tuple[tuple[str, Real], ...] = ()

    @property
    def range_text(self) -> str:
        """The entries of a vector, and what each of them may be."""
        names = ", ".join(name for name, _ in self.entries)
        bounded = [(name, entry) for name, entry in self.entries if math.isfinite(entry.low)]
        ranges = "".join(f", {name} in {entry.range_text}" for name, entry in bounded)
        return f"one or more ({names}){ranges}"

    def check(self, model: str, value: Any) -> tuple[tuple[float, ...], ...]:
        """A tuple of tuples of finite floats in range."""
        shape = f"it must hold {self.range_text}"
        if not _is_sequence(value) or not len(value):
            raise InputError(f"{model}: {self.name} = {value!r} has no vectors; {shape}")
        checked = []
        for k, vector in enumerate(value):
            if not _is_sequence(vector) or len(vector) != len(self.entries):
                raise InputError(f"{model}: {self.name}[{k}] = {vector!r} does not fit; {shape}")
            numbers: list[Any] = []
            for (name, entry), number in zip(self.entries, vector, strict=True):
                # A complaint names the entry that is wrong.
                placed = copy.copy(entry)
                object.__setattr__(placed, "name", f"{self.name}[{k}].{name}")
                numbers.append(placed.check(model, number))
            checked.append(tuple(numbers))
        return tuple(checked)


def _is_sequence(value: Any) -> bool:
    return isinstance(value, tuple | list) or np.ndim(value) > 0


@dataclass(frozen=True)
class Alias(Parameter):
    """A second name that sets one or more parameters to the same value."""

    targets: tuple[str, ...] = ()

    @property
    def range_text(self) -> str:
        """What it sets."""
        return "sets " + " and ".join(self.targets)

    def __get__(self, model: Model | None, owner: type) -> Any:
        if model is None:
            return self
        values = {model.parameters[t] for t in self.targets}
        if len(values) > 1:
            raise AttributeError(
                f"{model.spec} has no single {self.name}: {', '.join(self.targets)} differ"
            )
        return values.pop()


@dataclass(frozen=True)
class Part:
    """One lobe of a model: a kernel, and the chart in which it is wide and smooth.

    Attributes
    ----------
    name : str
        What the part is, such as ``specular``.
    fill : callable
        ``fill(wi, wo, h, p, out)``: wi (3, rows), wo and h (3, rows, columns), p (rows, k) the
        packed parameters, out (rows, columns) the values in 1/sr. All in wo.z > 0.
    chart : object
        A chart of `albedo.charts`.
    widths : tuple of float
        Widths of the lobe along x and y in the radial coordinate of the chart, radians.
    loss : callable, optional
        Like `fill`, but the energy per solid angle that a *unit* integral over the chart
        ``loss_chart`` loses: 1 - albedo without cancellation.
    loss_chart : object, optional
        Chart of the domain of the unit integral.
    columns : tuple of int
        First and last + 1 of the packed parameters that the kernels see; all of them by default.
    scale : float
        A factor of the values.
    doubt : float or callable
        Relative error of the values where numbers in them were computed with an error. A callable
        is called with the cosines of light directions; with None it gives the worst of all.
    average_doubt : callable, optional
        Relative error of the albedos, from cosines and azimuths of light directions, where that
        is less than the largest of the values.
    heights : tuple of float
        Cosines n.v at which the values have a kink, whatever n.l is.
    routine : Routine, optional
        How to draw directions for this lobe; by default what the chart and the widths suggest.
    formula : callable, optional
        Where `fill` is no kernel: a kernel that would fill the same, one pair of directions at a
        time. It is never compiled; values in other arithmetic are computed by it.
    shared : bool
        All cores work on its albedos: its values cost more than what threads do.
    rings : RingsChart, optional
        Rings of constant n.v for a lobe of the same widths, where those that suit `chart` do not
        suit the lobe as well.
    """

    name: str
    fill: Kernel
    chart: Any
    widths: tuple[float, float] = (1.0, 1.0)
    loss: Kernel | None = None
    loss_chart: Any = None
    columns: tuple[int, int | None] = (0, None)
    scale: float = 1.0
    doubt: float | Callable[[np.ndarray | None], Any] = 0.0
    average_doubt: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None
    heights: tuple[float, ...] = ()
    routine: Routine | tuple[Routine, ...] | None = None
    formula: Kernel | None = None
    shared: bool = False
    rings: Any = None

    def packed(self, rows: np.ndarray) -> np.ndarray:
        """What the kernels of this part see of packed parameters (rows, k)."""
        return np.ascontiguousarray(rows[:, slice(*self.columns)])


class Model:
    """A reflectance model with its parameters fixed; immutable, comparable, hashable.

    Subclasses declare `Parameter` attributes and implement `pack` and `parts`; the class
    attributes below state what the model promises, and the tests hold it to that.
    """

    name: ClassVar[str] = ""
    title: ClassVar[str] = ""
    equation: ClassVar[str] = ""
    references: ClassVar[tuple[str, ...]] = ()
    reciprocal: bool = True
    conserves_energy: bool = True
    grazing_limit: bool = True
    """Whether the albedo has a finite limit at cos_theta = 0."""

    lowest_cosine: float = 0.0
    """Below this n.l or n.v values are not known: no table holds what they are divided by."""

    resolved_width: float | None = None
    """Feature width down to which a bound holds, when nothing finer is declared (radians)."""

    selected_channel: int | None = None
    """Which channel of its colours this model stands for; see `channel`."""

    tables: ClassVar[tuple[str, ...]] = ()
    """Default tables: what each sweeps, in the grammar of models, such as ``m=0.02..1/32``."""

    domain: ClassVar[str] = ""
    """What an energy map sweeps: the ranges of the main parameters, in the same grammar."""

    as_lobes: ClassVar[str] = ""
    """For a model that is all Dirac parts by default: what makes it lobes, in the same grammar."""

    made: ClassVar[float] = 0.0
    """When the class was defined, in seconds since the epoch."""

    _declared: ClassVar[dict[str, Parameter]] = {}
    parameters: Mapping[str, Any]

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        cls.made = time.time()
        own = {k: v for k, v in vars(cls).items() if isinstance(v, Parameter)}
        # What a model declares itself comes before what it inherits.
        cls._declared = {**own, **{k: v for k, v in cls._declared.items() if k not in own}}

    def __init__(self, /, **values: Any) -> None:
        values_in = dict(values)
        names = list(self._declared)
        for key in values_in:
            if key not in self._declared:
                listing = ", ".join(names) or "none"
                raise InputError(f"{self.name} has no parameter {key!r}; it has {listing}")
        for key, declared in self._declared.items():
            if isinstance(declared, Alias) and key in values_in:
                value = values_in.pop(key)
                for target in declared.targets:
                    if target in values_in:
                        raise InputError(f"{self.name}: give either {key} or {target}, not both")
                    # A complaint names what was given.
                    given = copy.copy(self._declared[target])
                    object.__setattr__(given, "name", key)
                    values_in[target] = given.check(self.name, value)
        stored = {
            key: declared.check(self.name, values_in.get(key, declared.default))
            for key, declared in self._declared.items()
            if not isinstance(declared, Alias)
        }
        used = self.used(stored)
        for key in values_in:
            if key not in used:
                raise InputError(
                    f"{self.name} does not use {key} with these choices; it uses {', '.join(used)}"
                )
        kept = {k: v for k, v in stored.items() if k in used and v is not None}
        frozen = MappingProxyType(kept)
        object.__setattr__(self, "parameters", frozen)
        lengths = {k: len(v) for k, v in self._colors().items()}
        if len(set(lengths.values())) > 1:
            counts = ", ".join(f"{k} has {count}" for k, count in lengths.items())
            raise InputError(f"{self.name}: colours must have equally many channels; {counts}")

    def __setattr__(self, key: str, value: Any) -> None:
        raise AttributeError(f"{self.name} is frozen; use .replace({key}=...) for a changed copy")

    def __eq__(self, other: object) -> bool:
        return (
            type(self) is type(other)
            and self.parameters == other.parameters
            and self.selected_channel == other.selected_channel
        )

    def __hash__(self) -> int:
        return hash((type(self), tuple(self.parameters.items()), self.selected_channel))

    def __repr__(self) -> str:
        return f"<albedo model {self.spec}>"

    @classmethod
    def parameter_info(cls) -> tuple[Parameter, ...]:
        """The declared parameters, aliases included, in order."""
        return tuple(cls._declared.values())

    def used(self, values: Mapping[str, Any]) -> tuple[str, ...]:
        """Names of the parameters that matter for this choice of values; all, by default."""
        return tuple(values)

    def __add__(self, other: Any) -> Model:
        """Both models on one surface: their values, and their albedos, add up."""
        from albedo.compose import total

        return total(self, other) if isinstance(other, Model) else NotImplemented

    def __mul__(self, factor: Any) -> Model:
        """The model with all its values multiplied by a number that is not negative."""
        from albedo.compose import scaled

        return NotImplemented if isinstance(factor, Model) else scaled(self, factor)

    __rmul__ = __mul__
    # A numpy number times a model is a model.
    __array_ufunc__ = None

    def replace(self, **values: Any) -> Model:
        """A copy with some parameters changed (aliases allowed)."""
        kept = dict(self.parameters)
        for key in values:
            declared = self._declared.get(key)
            for target in declared.targets if isinstance(declared, Alias) else (key,):
                kept.pop(target, None)
        return type(self)(**kept, **values)

    def _colors(self) -> dict[str, tuple[float, ...]]:
        """The colours that have channels."""
        kept = self.parameters.items()
        return {
            k: v for k, v in kept if isinstance(self._declared[k], Color) and isinstance(v, tuple)
        }

    @property
    def channels(self) -> int | None:
        """How many channels the model has; None when its colours are numbers, or one is chosen."""
        found = self._colors()
        if self.selected_channel is not None or not found:
            return None
        return len(next(iter(found.values())))

    def by_channel(self) -> list[Model]:
        """One model for every channel; the model itself when it has none."""
        count = self.channels
        return [self] if count is None else [self.channel(i) for i in range(count)]

    def channel(self, index: int) -> Model:
        """The model in one channel of its colours: values and albedos are numbers again."""
        count = self.channels
        if count is None or not 0 <= index < count:
            raise InputError(f"{self.spec} has no channel {index}; it has {count or 'none'}")
        chosen = copy.copy(self)
        object.__setattr__(chosen, "selected_channel", index)
        return chosen

    @property
    def spec(self) -> str:
        """The model in the one grammar of the workbench, such as ``ward:alpha_x=0.1,...``."""
        words = [
            f"{k}={v!r}" if isinstance(v, float) else f"{k}={format_value(v, k)}"
            for k, v in self.parameters.items()
        ]
        return self.name + (":" + ",".join(words) if words else "")

    @property
    def isotropic(self) -> bool:
        """Whether a common rotation of both directions about the normal changes nothing."""
        return True

    def pack(self) -> tuple[float, ...]:
        """The numbers that the kernels of all parts read."""
        raise TypeError(f"{type(self).__name__} must implement pack()")

    def parts(self) -> tuple[Part, ...]:
        """The lobes that sum to the finite part of the model."""
        raise TypeError(f"{type(self).__name__} must implement parts()")

    @classmethod
    def prepare(cls, models: Sequence[Self]) -> None:
        """Make, side by side, what the parts of several models of this kind need.

        Parts are the same without it; most models have nothing to make.
        """

    def spikes(self, wi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Dirac parts: directions (k, n, 3) and weights (k, n) for light directions (n, 3).

        A weight is the share of the incident energy that leaves in exactly that direction.
        """
        return np.empty((0, len(wi), 3)), np.empty((0, len(wi)))

    def spike_errors(self, wi: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Bounds on the errors of the weights of `spikes`, in their shape.

        By default for a closed form of about a dozen roundings, one of them in an exponential.
        """
        return 64.0 * np.finfo(float).eps * np.abs(weights)

    def sum_doubt(self, cos_theta: np.ndarray, phi: np.ndarray) -> np.ndarray | None:
        """Relative error of the albedo of all parts and Dirac parts together, of numbers that they
        have in common.

        Parameters
        ----------
        cos_theta, phi : ndarray, shape (n,)
            Directions to the light.

        Returns
        -------
        ndarray, shape (n,), or None
            None, the default, where nothing more is known than of every part by itself.
        """
        return None

    def simpler(self) -> dict[str, Model]:
        """Models that leave something out, and may do for less, by what each leaves out.

        Returns
        -------
        dict of str to Model
            By default an isotropic model for an anisotropic one, with the geometric means of the
            parameters that an alias sets together.
        """
        found: dict[str, Model] = {}
        for alias in self._declared.values():
            if not isinstance(alias, Alias) or not set(alias.targets) <= self.parameters.keys():
                continue
            values = [self.parameters[name] for name in alias.targets]
            if all(isinstance(v, float) and v >= 0.0 for v in values) and len(set(values)) > 1:
                mean = math.prod(values) ** (1.0 / len(values))
                found["anisotropy"] = self.replace(**{alias.name: mean})
        return found

    def grazing_albedo(self) -> float | None:
        """The limit of the albedo at cos_theta = 0 where it is known in closed form."""
        return None

    def eval(self, wi: ArrayLike, wo: ArrayLike) -> np.ndarray:
        """The finite part of the BRDF, in 1/sr.

        Parameters
        ----------
        wi, wo : array_like, shape (..., 3)
            Unit vectors to the light and to the viewer; leading axes broadcast.

        Returns
        -------
        ndarray, shape (...)
            Values in 1/sr; 0 where either direction is not above the horizon, and NaN where one is
            nearer to it than `lowest_cosine`. Shape (channels, ...) where a colour of the model has
            channels.

        Raises
        ------
        InputError
            When an input is not an array of finite unit vectors, or shapes do not broadcast.
        """
        if self.channels is not None:
            return np.stack([model.eval(wi, wo) for model in self.by_channel()])
        light, view = unit_vectors(wi, "wi"), unit_vectors(wo, "wo")
        try:
            light, view = np.broadcast_arrays(light, view)
        except ValueError:
            raise InputError(
                f"wi of shape {light.shape} and wo of shape {view.shape} do not broadcast"
            ) from None
        shape = light.shape[:-1]
        light, view = light.reshape(-1, 3), view.reshape(-1, 3)
        above = (light[:, 2] > 0) & (view[:, 2] > 0)
        total = np.zeros(len(light))
        if np.any(above):
            half = half_vector(light[above], view[above])
            total[above] = self.finite_part(light[above], view[above], half)
            total[above & (np.minimum(light[:, 2], view[:, 2]) < self.lowest_cosine)] = np.nan
        return total.reshape(shape)

    def finite_part(self, wi: np.ndarray, wo: np.ndarray, h: np.ndarray) -> np.ndarray:
        """What `eval` gives for directions above the horizon whose sum is known.

        Parameters
        ----------
        wi, wo, h : ndarray, shape (n, 3)
            Unit vectors to the light and to the viewer, and wi + wo as a chart knows it.

        Returns
        -------
        ndarray, shape (n,)
            Values in 1/sr of a model with one channel.
        """
        count = len(wi)
        light = np.ascontiguousarray(wi.T)
        view, half = (np.ascontiguousarray(v.T).reshape(3, count, 1) for v in (wo, h))
        p = np.tile(np.array(self.pack(), dtype=np.float64), (count, 1))
        total = np.zeros(count)
        for part in self.parts():
            out = np.empty((count, 1))
            part.fill(light, view, half, part.packed(p), out)
            total += part.scale * out[:, 0]
        return total

    def sample(self, u: ArrayLike, wi: ArrayLike) -> Sample:
        """Draw view directions for light directions, from points of the unit square.

        Parameters
        ----------
        u : array_like, shape (..., 2)
            Points in [0, 1).
        wi : array_like, shape (..., 3)
            Unit vectors to the light, above the horizon; leading axes broadcast with those of `u`.

        Returns
        -------
        Sample
            Directions ``wo``, densities ``pdf`` in 1/sr, and weights f n.v/pdf, whose mean is the
            directional albedo. A draw below the horizon has the weight 0; a Dirac part that was
            drawn has the density inf and its energy over its probability as weight.

        Raises
        ------
        InputError
            When `u` or `wi` is out of range, shapes do not broadcast, or the model has channels.
        """
        from albedo.sampling.mixture import draw

        return draw(self, u, wi)

    def pdf(self, wi: ArrayLike, wo: ArrayLike) -> np.ndarray:
        """The density in 1/sr with which `sample` draws `wo`, Dirac parts left out.

        Parameters
        ----------
        wi, wo : array_like, shape (..., 3)
            Unit vectors; leading axes broadcast.

        Returns
        -------
        ndarray, shape (...)
            It integrates, over the upper hemisphere, to the probability that a draw lies above the
            horizon and is no Dirac part.

        Raises
        ------
        InputError
            As `sample`.
        """
        from albedo.sampling.mixture import density

        return density(self, wi, wo)


# Models whose parts are made side by side: what they need is kept for a few hundred.
_TOGETHER = 64


def parts_of(models: Sequence[Model]) -> list[tuple[Part, ...]]:
    """The parts of many models, with what those of one kind need made side by side."""
    found = []
    for first in range(0, len(models), _TOGETHER):
        group = models[first : first + _TOGETHER]
        kinds: dict[type[Model], list[Model]] = {}
        for model in group:
            kinds.setdefault(type(model), []).append(model)
        for kind, own in kinds.items():
            kind.prepare(own)
        found += [model.parts() for model in group]
    return found
