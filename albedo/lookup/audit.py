"""What a table that was made elsewhere holds, and what it errs by.

A table says little of itself: which axis is which, where its texels lie, what its roughness is,
which masking its maker had. All usual conventions are tried, and the one whose nodes are nearest to
certified values is told, with what is left.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from albedo.brdf import Choice, Model
from albedo.errors import InputError
from albedo.lookup.quantities import QUANTITIES, coordinates_of, functions_of
from albedo.lookup.reference import LOWEST, Reference, refer

TEXELS: Mapping[str, Callable[[int], np.ndarray]] = {
    "ends": lambda n: np.linspace(0.0, 1.0, n),
    "centres": lambda n: (np.arange(n) + 0.5) / n,
    "first edges": lambda n: np.arange(n) / n,
    "last edges": lambda n: (np.arange(n) + 1.0) / n,
}
"""Where texels lie on an axis from 0 to 1."""

COSINES: Mapping[str, Callable[[np.ndarray], np.ndarray]] = {
    "cos": lambda u: u,
    "cos^2": lambda u: np.sqrt(u),
    "root of cos": lambda u: u * u,
    "angle": lambda u: np.cos(0.5 * math.pi * u),
    "elevation": lambda u: np.sin(0.5 * math.pi * u),
    "1 - cos": lambda u: 1.0 - u,
    "sine": lambda u: np.sqrt((1.0 - u) * (1.0 + u)),
}
"""What an axis from 0 to 1 may be of the direction."""

PARAMETERS: Mapping[str, Callable[[np.ndarray], np.ndarray]] = {
    "itself": lambda u: u,
    "its root": lambda u: u * u,
    "its square": lambda u: np.sqrt(u),
    "1 - itself": lambda u: 1.0 - u,
    "1 - its root": lambda u: (1.0 - u) ** 2,
}
"""What an axis from 0 to 1 may be of a parameter such as the roughness alpha."""

ENCODINGS: Mapping[str, Callable[[np.ndarray], np.ndarray]] = {
    "as it is": lambda v: v,
    "sRGB": lambda v: np.where(v <= 0.04045, v / 12.92, ((np.abs(v) + 0.055) / 1.055) ** 2.4),
    "over pi": lambda v: math.pi * v,
    "half": lambda v: 2.0 * v,
}
"""How a value may be written: what makes it a value again."""

_MASKINGS = "geometry"
# Where no roughness is told from a mirror, and what the references may err by.
_SMOOTHEST, _EXACT = 2e-3, 2e-5
# What fits is nearer to certified values than this, in the mean square.
_FITS = 0.01
# Places from node to node where readings are compared.
_BETWEEN = 7
_MOST_SIDE = 1024
# A longer list is no single line.
_MOST_LINE = 512


_Values = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Convention:
    """How a table is to be read.

    Attributes
    ----------
    rows, columns : str
        The axes, in the array's order: ``cos_theta``, or the parameter's name; rows are empty for
        one axis.
    texels : str
        Of `TEXELS`.
    cosine, parameter : str
        Of `COSINES` and of `PARAMETERS`; the parameter is empty for one axis.
    masking : str
        The masking-shadowing, or what else was tried; empty where there is no choice.
    channels : tuple of str
        What each channel holds: a channel of `albedo.lookup.quantities.QUANTITIES`.
    encoding : str
        Of `ENCODINGS`.
    """

    rows: str
    columns: str
    texels: str
    cosine: str
    parameter: str
    masking: str
    channels: tuple[str, ...]
    encoding: str

    def __str__(self) -> str:
        axes = f"rows {self.rows}, columns {self.columns}" if self.rows else self.columns
        said = [axes, f"texels at {self.texels}", f"even in {_axis('cos_theta', self.cosine)}"]
        if self.parameter:
            name = self.rows if self.columns == "cos_theta" else self.columns
            said.append(f"even in {_axis(name, self.parameter)}")
        if self.masking:
            said.append(self.masking)
        said.append(f"holds {', '.join(self.channels)}")
        if self.encoding != "as it is":
            said.append(f"written {self.encoding}")
        return "; ".join(said)


def _axis(name: str, how: str) -> str:
    if name == "cos_theta":
        plain = {"angle": "theta", "elevation": "90 degrees - theta", "sine": "sin_theta"}
        return plain.get(how, how.replace("cos", "cos_theta"))
    return {
        "itself": name,
        "its root": f"root of {name}",
        "its square": f"{name}^2",
        "1 - itself": f"1 - {name}",
        "1 - its root": f"1 - root of {name}",
    }[how]


@dataclass(frozen=True)
class Finding:
    """A convention, and how far the nodes of the table are from certified values under it.

    Attributes
    ----------
    convention : Convention
    nodes : float
        The largest error at a node, of the worst channel.
    rms : float
        The root mean square over all nodes and channels.
    """

    convention: Convention
    nodes: float
    rms: float


@dataclass(frozen=True, eq=False)
class Audit:
    """What an audit found.

    Attributes
    ----------
    model : str
        What the table was compared with.
    shape : tuple of int
    best, second : Finding
        The nearest convention, and the nearest that differs in the model or in an axis.
    fits : bool
        Whether the best is near enough to be what was meant.
    node_errors : ndarray, shape (channels, ...)
        Table minus certified values at its nodes, in the array's own order.
    readings : ndarray, shape (channels, ...)
        The largest error of linear readings about each node, half of the way to the next ones.
    largest : float
        The largest of all; with the bound of what it was compared with.
    where : dict of str to float
        Its place.
    noise : float
        What part of the error at the nodes, in the mean square, differs from node to node: from
        Monte Carlo, or from rounding.
    """

    model: str
    shape: tuple[int, ...]
    best: Finding
    second: Finding | None
    fits: bool
    node_errors: np.ndarray
    readings: np.ndarray
    largest: float
    where: dict[str, float]
    noise: float

    def __str__(self) -> str:
        shape = " x ".join(map(str, self.shape))
        verdict = "nearest to" if self.fits else "NOT what any convention gives; nearest to"
        lines = [
            f"a table of {shape} numbers, {verdict} {self.model}:",
            f"  {self.best.convention}",
            f"  at its nodes it errs by {self.best.nodes:.3g} at most, rms {self.best.rms:.3g}; "
            f"{self.noise:.2g} of that differs from node to node",
            f"  read linearly it errs by {self.largest:.3g} at most, at "
            + ", ".join(f"{name} = {value:.4g}" for name, value in self.where.items()),
        ]
        if self.second is not None:
            lines.append(
                f"the next convention has an rms of {self.second.rms:.3g}: {self.second.convention}"
            )
        return "\n".join(lines)

    def record(self) -> dict[str, Any]:
        """All of it as plain data."""
        from dataclasses import asdict

        from albedo.files import strict

        return strict(
            {
                "model": self.model,
                "shape": list(self.shape),
                "fits": self.fits,
                "best": asdict(self.best),
                "second": None if self.second is None else asdict(self.second),
                "largest": self.largest,
                "where": self.where,
                "noise": self.noise,
                "node_errors": self.node_errors,
                "readings": self.readings,
            }
        )


def audit(
    data: np.ndarray,
    model: Model,
    parameter: str | None = None,
    *,
    axes: Sequence[str] | None = None,
    fixed: Mapping[str, str] | None = None,
    progress: Callable[[str], None] | None = None,
) -> Audit:
    """Find out what a table holds, and what it errs by.

    Parameters
    ----------
    data : ndarray
        Rows and columns, and channels last where each place has several numbers; or one row.
    model : Model
        What it is said to be of. Its ``geometry``, where it has one, is tried in all ways.
    parameter : str, optional
        What varies beside the direction, such as ``m``; its axis goes from 0 to 1. Without it the
        table has one axis.
    axes : sequence of str, optional
        What rows and columns are, such as ``("m", "cos_theta")``; both orders are tried unless
        given.
    fixed : mapping of str to str, optional
        What is known of the convention: ``texels``, ``cosine``, ``parameter``, ``masking`` or
        ``encoding``.
    progress : callable, optional
        Called with a few words for every stage.

    Returns
    -------
    Audit

    Raises
    ------
    InputError
        For an array that is no table, and for what is unknown.
    """
    values = np.asarray(data, dtype=np.float64)
    say = progress or (lambda words: None)
    return _Audit(values, model, parameter, axes, dict(fixed or {}), say).found()


def said_to_be(text: str) -> Model:
    """The model of a word such as ``ggx``, or of the grammar.

    Parameters
    ----------
    text : str
        A distribution of `cook_torrance`, which then has its own masking, or a model.
    """
    from albedo.catalogue import model
    from albedo.grammar import parse_ranges

    if text in ("ggx", "beckmann"):
        return model("cook_torrance", distribution=text, geometry="smith_correlated")
    found, ends = parse_ranges(text)
    if ends:
        raise InputError(f"{text} sweeps {', '.join(ends)}; what varies is told by --parameter")
    return found


def shaped(data: np.ndarray, shape: Sequence[int] | None) -> np.ndarray:
    """An array in a shape that is told, or, of a flat list, in that of a square.

    Raises
    ------
    InputError
        Where it has another number of numbers, or may be of several shapes.
    """
    if shape is not None:
        if min(shape) < 1 or data.size % math.prod(shape):
            raise InputError(
                f"the table has {data.size} numbers, which are not {' x '.join(map(str, shape))}"
            )
        channels = data.size // math.prod(shape)
        return data.reshape(*shape, channels) if channels > 1 else data.reshape(shape)
    if data.ndim > 1:
        return data[0] if data.shape[0] == 1 else data[:, 0] if data.shape[1] == 1 else data
    # A list of as many numbers as a square has is one; of 2, 3 or 4 squares, one with channels.
    for channels in (1, 2, 3, 4):
        side = math.isqrt(data.size // channels)
        if side * side * channels == data.size:
            return data.reshape(side, side, channels) if channels > 1 else data.reshape(side, side)
    if data.size > _MOST_LINE:
        raise InputError(
            f"the table is a list of {data.size} numbers; give its shape, such as 32x32"
        )
    return data


def plot_audit(found: Audit, path: Path) -> Path:
    """Draw the errors at the nodes and of readings about them.

    Parameters
    ----------
    found : Audit
    path : path
        Where; its ending says the format.

    Returns
    -------
    Path
    """
    from albedo.plotting import error_maps

    how = found.best.convention
    titles = [
        f"{name}: {what}"
        for name in how.channels
        for what in ("table minus value at the nodes", "largest error of a linear reading")
    ]
    pairs = zip(found.node_errors, found.readings, strict=True)
    maps = [own for nodes, readings in pairs for own in (nodes, readings)]
    return error_maps(maps, titles, how.rows, how.columns, path)


@dataclass(eq=False)
class _Audit:
    data: np.ndarray
    model: Model
    parameter: str | None
    axes: Sequence[str] | None
    fixed: dict[str, str]
    say: Callable[[str], None]

    def __post_init__(self) -> None:
        wanted = 1 if self.parameter is None else 2
        if self.data.ndim == wanted:
            self.data = self.data[..., None]
        shape = self.data.shape
        if self.data.ndim != wanted + 1 or not 1 <= shape[-1] <= 4:
            raise InputError(
                f"the table has shape {shape}; it should have {wanted} axes, and up to 4 channels"
            )
        if not all(2 <= n <= _MOST_SIDE for n in shape[:-1]):
            raise InputError(f"the table has shape {shape}; an axis has 2 to {_MOST_SIDE} nodes")
        if not np.isfinite(self.data).all():
            raise InputError("the table has numbers that are not finite")
        if self.model.channels is not None or not self.model.isotropic:
            raise InputError(f"{self.model.spec} is no isotropic model of one channel")
        known = {
            "texels": tuple(TEXELS),
            "cosine": tuple(COSINES),
            "parameter": tuple(PARAMETERS),
            "encoding": tuple(ENCODINGS),
            "masking": tuple(self._maskings),
        }
        for name, value in self.fixed.items():
            if name not in known:
                raise InputError(f"{name!r} is no part of a convention; it has {', '.join(known)}")
            if value not in known[name]:
                raise InputError(f"{name} = {value!r} is unknown; choose {', '.join(known[name])}")
        names = {"cos_theta", self.parameter} - {None}
        if self.axes is not None and (len(self.axes) != len(names) or set(self.axes) != names):
            raise InputError(
                f"axes = {','.join(map(str, self.axes))} are not those of the table, "
                + " and ".join(sorted(map(str, names)))
            )

    @cached_property
    def _maskings(self) -> dict[str, Model]:
        """The model with every masking that it may have."""
        info = {p.name: p for p in self.model.parameter_info()}
        choice = info.get(_MASKINGS)
        if not isinstance(choice, Choice):
            return {"": self.model}
        found = {}
        for word in choice.choices:
            try:
                other = self.model.replace(**{_MASKINGS: word})
            except InputError:
                # A masking of another distribution.
                continue
            if other.grazing_limit:
                found[word] = other
        return found

    def _references(self, masking: str) -> Mapping[str, _Values]:
        """Values of all that a number may hold, for coordinates (axes, n)."""
        return _values_of(self._maskings[masking], self.parameter)[0]

    def _orders(self) -> list[tuple[str, ...]]:
        if self.parameter is None:
            return [("cos_theta",)]
        if self.axes is not None:
            return [tuple(self.axes)]
        return [(self.parameter, "cos_theta"), ("cos_theta", self.parameter)]

    def _choices(self, name: str, known: Mapping[str, Any]) -> list[str]:
        return [self.fixed[name]] if name in self.fixed else list(known)

    def _coordinates(
        self, order: tuple[str, ...], texels: str, cosine: str, parameter: str
    ) -> list[np.ndarray]:
        """Coordinates along each axis of the array."""
        found = []
        for name, count in zip(order, self.data.shape, strict=False):
            u = TEXELS[texels](count)
            if name == "cos_theta":
                found.append(np.clip(COSINES[cosine](u), LOWEST, 1.0))
            else:
                found.append(np.clip(PARAMETERS[parameter](u), _SMOOTHEST, 1.0))
        return found

    def _mesh(self, order: tuple[str, ...], lines: Sequence[np.ndarray]) -> np.ndarray:
        """Coordinates of all places in the order that references know, shape (axes, n)."""
        mesh = [m.ravel() for m in np.meshgrid(*lines, indexing="ij")]
        return np.array(mesh if order[-1] == "cos_theta" else mesh[::-1])

    def _all(self) -> Iterator[tuple[Finding, tuple[str, ...]]]:
        channels = self.data.shape[-1]
        flat = self.data.reshape(-1, channels).T
        parameters = [""] if self.parameter is None else self._choices("parameter", PARAMETERS)
        encodings = self._choices("encoding", ENCODINGS)
        decoded = {name: ENCODINGS[name](flat) for name in encodings}
        for masking in self._choices("masking", self._maskings):
            self.say(f"values of {self._maskings[masking].spec}")
            references = self._references(masking)
            for order, texels, cosine, parameter in itertools.product(
                self._orders(),
                self._choices("texels", TEXELS),
                self._choices("cosine", COSINES),
                parameters,
            ):
                x = self._mesh(order, self._coordinates(order, texels, cosine, parameter))
                known = {name: of(x) for name, of in references.items()}
                for encoding, values in decoded.items():
                    best = [_nearest(own, known) for own in values]
                    mean = math.sqrt(float(np.mean([square for _, square, _ in best])))
                    convention = Convention(
                        order[0] if len(order) > 1 else "",
                        order[-1],
                        texels,
                        cosine,
                        parameter,
                        masking,
                        tuple(name for name, _, _ in best),
                        encoding,
                    )
                    yield Finding(convention, max(top for _, _, top in best), mean), order

    def found(self) -> Audit:
        """The nearest of all conventions."""
        ranked = sorted(self._all(), key=lambda pair: pair[0].rms)
        best, order = ranked[0]
        second = next((own for own, _ in ranked[1:] if _differs(own, best)), None)
        how = best.convention
        references = self._references(how.masking)
        lines = self._coordinates(order, how.texels, how.cosine, how.parameter)
        x = self._mesh(order, lines)
        values = ENCODINGS[how.encoding](self.data.reshape(-1, self.data.shape[-1]).T)
        known = np.array([references[name](x) for name in how.channels])
        shape = self.data.shape[:-1]
        errors = (values - known).reshape(-1, *shape)
        largest, where, readings = self._between(order, how, references, values.reshape(-1, *shape))
        return Audit(
            model=self._maskings[how.masking].spec,
            shape=shape if len(how.channels) == 1 else self.data.shape,
            best=best,
            second=second,
            fits=best.rms <= _FITS,
            node_errors=errors,
            readings=readings,
            largest=largest,
            where=where,
            noise=_noise(errors),
        )

    def _between(
        self,
        order: tuple[str, ...],
        how: Convention,
        references: Mapping[str, _Values],
        values: np.ndarray,
    ) -> tuple[float, dict[str, float], np.ndarray]:
        """The largest error of linear readings, its place, and the largest about each node."""
        shares = []
        for count in values.shape[1:]:
            ends = TEXELS[how.texels](count)
            fine = np.interp(
                np.linspace(0.0, count - 1.0, _BETWEEN * (count - 1) + 1), np.arange(count), ends
            )
            rim = np.linspace(0.0, ends[0], 4)[:-1], np.linspace(ends[-1], 1.0, 4)[1:]
            shares.append(np.unique(np.concatenate((rim[0], fine, rim[1]))))
        lines = []
        for name, u in zip(order, shares, strict=True):
            if name == "cos_theta":
                lines.append(np.clip(COSINES[how.cosine](u), LOWEST, 1.0))
            else:
                lines.append(np.clip(PARAMETERS[how.parameter](u), _SMOOTHEST, 1.0))
        x = self._mesh(order, lines)
        worst, where, about = 0.0, dict[str, float](), []
        for own, name in zip(values, how.channels, strict=True):
            read = own
            for axis, u in enumerate(shares):
                nodes = TEXELS[how.texels](own.shape[axis])
                read = _linear(np.moveaxis(read, axis, 0), nodes, u, axis)
            off = np.abs(read.ravel() - references[name](x))
            about.append(self._about(off.reshape(read.shape), shares, how.texels))
            k = int(np.argmax(off))
            if off[k] >= worst:
                names = order if order[-1] == "cos_theta" else order[::-1]
                worst, where = float(off[k]), dict(zip(names, x[:, k].tolist(), strict=True))
        doubt = _values_of(self._maskings[how.masking], self.parameter)[1]
        return worst + doubt, where, np.array(about)

    def _about(self, off: np.ndarray, shares: Sequence[np.ndarray], texels: str) -> np.ndarray:
        """The largest of the errors that are nearest to each node."""
        for axis, u in enumerate(shares):
            nodes = TEXELS[texels](self.data.shape[axis])
            first = np.searchsorted(u, 0.5 * (nodes[1:] + nodes[:-1]))
            off = np.maximum.reduceat(off, np.concatenate(([0], first)), axis=axis)
        return off


@lru_cache(maxsize=32)
def _values_of(model: Model, parameter: str | None) -> tuple[Mapping[str, _Values], float]:
    """Values of all that a number may hold, for coordinates (axes, n), and what they err by."""
    ranges = {} if parameter is None else {parameter: (_SMOOTHEST, 1.0)}
    coordinates = coordinates_of(model, ranges, QUANTITIES["albedo"], (0.0, 1.0))

    def of(name: str, which: int) -> Reference:
        quantity = QUANTITIES[name]
        functions = functions_of(model, quantity, coordinates, 0.01 * _EXACT, relative=False)
        return refer(functions[which], coordinates, _EXACT)

    whole = of("albedo", 0)
    found: dict[str, _Values] = {
        "albedo": lambda x: whole(x)[0],
        "complement": lambda x: 1.0 - whole(x)[0],
    }
    if not any(p.name == "f0" for p in model.parameter_info()):
        # A model without Schlick's factor has no split.
        return found, whole.largest
    edge = of("split_sum", 1)
    split: dict[str, _Values] = {
        "f90": lambda x: edge(x)[0],
        "f0": lambda x: whole(x)[0] - edge(x)[0],
    }
    return {**found, **split}, whole.largest + edge.largest


def _linear(values: np.ndarray, nodes: np.ndarray, u: np.ndarray, axis: int) -> np.ndarray:
    """Linear readings along the first axis, which goes back to its place; constant beyond."""
    k = np.clip(np.searchsorted(nodes, u, side="right") - 1, 0, nodes.size - 2)
    t = np.clip((u - nodes[k]) / (nodes[k + 1] - nodes[k]), 0.0, 1.0)
    t = t.reshape(-1, *(1,) * (values.ndim - 1))
    return np.moveaxis((1.0 - t) * values[k] + t * values[k + 1], 0, axis)


def _nearest(values: np.ndarray, known: Mapping[str, np.ndarray]) -> tuple[str, float, float]:
    """What some numbers are nearest to, with their mean square and their largest error."""
    found = []
    for name, own in known.items():
        off = values - own
        found.append((float(np.mean(off * off)), name, float(np.abs(off).max())))
    square, name, top = min(found)
    return name, square, top


def _differs(one: Finding, other: Finding) -> bool:
    """Whether two conventions are more than two ways to say the same."""
    return abs(one.rms - other.rms) > 1e-6 + 1e-3 * other.rms


def _noise(errors: np.ndarray) -> float:
    """Which part of errors differs from node to node, in the mean square.

    The second difference of independent numbers has six times their variance; that of what changes
    slowly has next to none. Of two axes the quieter is taken: values may bend along one.
    """
    shares = []
    whole = float(np.mean(errors**2))
    for axis in range(1, errors.ndim):
        if errors.shape[axis] >= 5:
            e = np.moveaxis(errors, axis, 0)
            bend = e[2:] - 2.0 * e[1:-1] + e[:-2]
            shares.append(float(np.mean(bend**2)) / 6.0)
    return math.sqrt(min(min(shares, default=0.0) / max(whole, 1e-300), 1.0))
