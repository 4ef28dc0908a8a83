"""A lookup table with its label: what it holds, how it is read, and what it errs by."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

import albedo
from albedo.brdf import Model
from albedo.errors import InputError
from albedo.files import strict
from albedo.lookup.quantities import Quantity
from albedo.lookup.stored import Grid, Table

FORMAT = "albedo lookup table 1"
"""What the label of every file begins with."""


def digest_of(points: np.ndarray) -> str:
    """Digest of coordinates: elsewhere they may be rounded another way, and are not made again."""
    return hashlib.sha256(points.astype("<f8").tobytes()).hexdigest()


def places_of(
    grid: Grid, coordinates: Mapping[str, ArrayLike]
) -> tuple[np.ndarray, tuple[int, ...]]:
    """Coordinates of any shape as an array of shape (axes, n), and their shape.

    Raises
    ------
    InputError
        For a coordinate that is missing, unknown, or outside the domain.
    """
    names = grid.names
    if set(coordinates) != set(names):
        raise InputError(
            f"a reading needs {', '.join(names)}; given are {', '.join(coordinates) or 'none'}"
        )
    try:
        arrays = [np.asarray(coordinates[name], dtype=np.float64) for name in names]
        columns = np.broadcast_arrays(*arrays)
    except (TypeError, ValueError):
        raise InputError(f"{', '.join(names)} are not numbers of shapes that broadcast") from None
    for name, x, ends in zip(names, columns, grid.ends, strict=True):
        if not np.all((x >= min(ends)) & (x <= max(ends))):
            raise InputError(
                f"{name} is outside of the table; it lies in [{min(ends):g}, {max(ends):g}]"
            )
    return np.array([x.ravel() for x in columns]), columns[0].shape


def about_of(
    model: Model,
    quantity: Quantity,
    grid: Grid,
    *,
    metric: str,
    asked: float | None,
    fixed: str,
) -> dict[str, Any]:
    """What a label says beside axes and errors."""
    info = {p.name: p for p in model.parameter_info()}
    varied = set(grid.names)
    for name in grid.names:
        # An alias sets others.
        varied |= set(getattr(info.get(name), "targets", ()))
    about = {
        "title": f"{quantity.name} of {model.name}",
        "quantity": quantity.name,
        "meaning": quantity.meaning,
        "model": model.spec,
        "name": model.name,
        "parameters": {k: v for k, v in model.parameters.items() if k not in varied},
        "equation": model.equation,
        "references": list(model.references),
        "fixed": fixed,
        "metric": metric,
        "asked": asked,
        "coordinates": digest_of(grid.points()),
        "source": f"albedo-workbench {albedo.__version__}",
    }
    return strict(about)


@dataclass(frozen=True)
class Errors:
    """What one channel of a table errs by, from end to end.

    Attributes
    ----------
    largest : float
        A bound on the error anywhere in the domain: the largest on places between all nodes, what
        may lie between those by the curvature of the error, and the bound on the values that it
        was compared with.
    rms : float
        The root mean square over even coordinates.
    relative : float
        A bound on the error as a share of the value.
    nodes : float
        A bound on the error at the nodes.
    where : dict of str to float
        The place of the largest error.
    verified : float
        The largest error at fresh places, by quadrature; its bound included.
    places : int
        How many these were.
    map : nested list of float
        `largest` over equal shares of the warped domain, an axis for each of the table's.
    """

    largest: float
    rms: float
    relative: float
    nodes: float
    where: dict[str, float]
    verified: float
    places: int
    map: list[Any]


@dataclass(frozen=True, eq=False)
class Channel:
    """One number of every texel.

    Attributes
    ----------
    name : str
    table : Table
    errors : Errors
    """

    name: str
    table: Table
    errors: Errors


@dataclass(frozen=True, eq=False)
class LookupTable:
    """A table that says what it is; made by `albedo.design`, read by `albedo.load_lookup`.

    Attributes
    ----------
    channels : tuple of Channel
    about : dict
        What the label says beside the axes and the errors: model, parameters, quantity, sources.
    """

    channels: tuple[Channel, ...]
    about: dict[str, Any]

    @property
    def grid(self) -> Grid:
        """The axes, which all channels share."""
        return self.channels[0].table.grid

    @property
    def bytes(self) -> int:
        """What the numbers of all channels take."""
        return sum(channel.table.bytes for channel in self.channels)

    @property
    def worst(self) -> float:
        """The error of the worst channel, in the sense that was asked for."""
        name = {"max": "largest", "rms": "rms", "relative": "relative"}[self.about["metric"]]
        return max(float(getattr(channel.errors, name)) for channel in self.channels)

    def __call__(self, **coordinates: ArrayLike) -> np.ndarray:
        """Read the table.

        Parameters
        ----------
        **coordinates : array_like
            One for each axis, such as ``m=0.3, cos_theta=[0.1, 0.5]``; they broadcast. Azimuths
            in radians.

        Returns
        -------
        ndarray
            In the shape of the coordinates, after an axis of channels where there are several.

        Raises
        ------
        InputError
            For a coordinate that is missing, unknown, or outside the domain.
        """
        x, shape = places_of(self.grid, coordinates)
        found = [channel.table(x).reshape(shape) for channel in self.channels]
        return found[0] if len(found) == 1 else np.array(found)

    def bound(self, **coordinates: ArrayLike) -> np.ndarray:
        """What the table errs by in the shares of the domain that hold some places.

        In the shape of a reading.
        """
        x, shape = places_of(self.grid, coordinates)
        shares = self.grid.share_of(x)
        found = []
        for channel in self.channels:
            errors = np.array(channel.errors.map)
            index = tuple(
                np.clip((share * n).astype(int), 0, n - 1)
                for share, n in zip(shares, errors.shape, strict=True)
            )
            found.append(errors[index].reshape(shape))
        return found[0] if len(found) == 1 else np.array(found)

    @cached_property
    def label(self) -> dict[str, Any]:
        """All that is known of the table but its numbers, as plain data."""
        grid, first = self.grid, self.channels[0].table
        axes = [
            {"name": n, "low": min(e), "high": max(e), "even_in": w, "count": c}
            for n, e, w, c in zip(grid.names, grid.ends, grid.warps, grid.counts, strict=True)
        ]
        return strict(
            {
                "format": FORMAT,
                **self.about,
                "axes": axes,
                "texels": grid.texels,
                "interpolation": first.read,
                "stored": first.stored,
                "bytes": self.bytes,
                "channels": [
                    {
                        "name": channel.name,
                        "low": channel.table.low,
                        "step": channel.table.step,
                        "errors": asdict(channel.errors),
                    }
                    for channel in self.channels
                ],
            }
        )

    @cached_property
    def sha256(self) -> str:
        """Digest of the label and of the stored numbers."""
        text = json.dumps(self.label, sort_keys=True, separators=(",", ":"), allow_nan=False)
        found = hashlib.sha256(text.encode())
        for channel in self.channels:
            data = channel.table.data
            found.update(data.astype(data.dtype.newbyteorder("<")).tobytes())
        return found.hexdigest()

    def __str__(self) -> str:
        grid = self.grid
        first = self.channels[0].table
        lines = [
            f"{self.about['title']}: {grid} points of {first.stored}, read by {first.read} "
            f"interpolation, {self.bytes} bytes"
        ]
        for channel in self.channels:
            e = channel.errors
            where = ", ".join(f"{name} = {value:.4g}" for name, value in e.where.items())
            lines.append(
                f"{channel.name}: errs by {e.largest:.3g} at most, at {where}; rms {e.rms:.3g}, "
                f"relative {e.relative:.3g}, at nodes {e.nodes:.2g}; {e.verified:.3g} at "
                f"{e.places} fresh places"
            )
        return "\n".join(lines)
