"""Mixtures of routines: how a whole model is sampled, its Dirac parts included."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from albedo._compile import kernel
from albedo.brdf import Model, Part
from albedo.charts.axis import AxisChart
from albedo.charts.polar import PolarChart
from albedo.charts.tail_rings import TailRingsChart
from albedo.directions import half_vector, real_array, unit_vectors
from albedo.errors import InputError
from albedo.sampling.routines import (
    COSINE,
    UNIFORM,
    Routine,
    axis_power,
    gaussian_normals,
    ggx_normals,
    mirror_power,
    normal_powers,
)

STRATEGIES = ("model", "cosine", "uniform", "mixture")
"""What directions are drawn from: the model's own routines, n.v/pi, the hemisphere evenly, or the
model's own for one half of the draws and n.v/pi for the other."""

# Of the draws of a model with finite parts, Dirac parts take at least and at most these shares.
_RAREST, _MOST = 0.05, 0.95

# The direction at which the parts of a model are weighed, how well, and the least share.
_TYPICAL, _ROUGH, _LEAST = 0.6, 1e-2, 0.1


class Sample(NamedTuple):
    """Directions drawn for given ones.

    Attributes
    ----------
    wo : ndarray, shape (..., 3)
        Unit vectors, also below the horizon.
    pdf : ndarray, shape (...)
        Densities in 1/sr; inf where a Dirac part was drawn.
    weight : ndarray, shape (...)
        f n.v/pdf; 0 below the horizon.
    """

    wo: np.ndarray
    pdf: np.ndarray
    weight: np.ndarray


@dataclass(frozen=True)
class Mixture:
    """Routines with their shares, which sum to 1."""

    shares: tuple[float, ...]
    routines: tuple[Routine, ...]

    def draw(self, wi: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Directions and half vectors (3, rows, columns) for points (2, rows, columns).

        The first coordinate chooses the routine as well, and is stretched again to the unit
        interval: strata stay strata.
        """
        wo, h = np.empty((3, *u.shape[1:])), np.empty((3, *u.shape[1:]))
        if len(self.routines) == 1:
            _draw(self.routines[0], wi, u, wo, h)
            return wo, h
        ends = np.minimum(np.cumsum((0.0, *self.shares)), 1.0)
        ends[-1] = 1.0
        choice = np.searchsorted(ends[1:-1], u[0], side="right")
        for k, routine in enumerate(self.routines):
            row, column = np.nonzero(choice == k)
            own = u[:, row, column]
            own[0] = np.minimum((own[0] - ends[k]) / (ends[k + 1] - ends[k]), 1.0 - 2.0**-53)
            # One light direction for all draws, where there is only one: its terms are shared.
            single = wi.shape[1] == 1
            shape = (1, row.size) if single else (row.size, 1)
            there, half = np.empty((3, *shape)), np.empty((3, *shape))
            light = wi if single else np.ascontiguousarray(wi[:, row])
            _draw(routine, light, own.reshape(2, *shape), there, half)
            wo[:, row, column] = there.reshape(3, -1)
            h[:, row, column] = half.reshape(3, -1)
        return wo, h

    def density(self, wi: np.ndarray, wo: np.ndarray, h: np.ndarray) -> np.ndarray:
        """Density at directions (3, rows, columns), in 1/sr."""
        total = np.empty(wo.shape[1:])
        _density(self.routines[0], wi, wo, h, total)
        if len(self.routines) == 1:
            return total
        total *= self.shares[0]
        one = np.empty_like(total)
        for share, routine in zip(self.shares[1:], self.routines[1:], strict=True):
            _density(routine, wi, wo, h, one)
            total += share * one
        return total


def _numbers(routine: Routine, rows: int) -> np.ndarray:
    return np.tile(np.array(routine.numbers, dtype=np.float64), (rows, 1))


def _draw(routine: Routine, wi: np.ndarray, u: np.ndarray, wo: np.ndarray, h: np.ndarray) -> None:
    routine.draw(wi, u, _numbers(routine, wi.shape[1]), wo, h)


def _density(
    routine: Routine, wi: np.ndarray, wo: np.ndarray, h: np.ndarray, out: np.ndarray
) -> None:
    routine.density(wi, wo, h, _numbers(routine, wi.shape[1]), out)


def routines_of(part: Part) -> tuple[Routine, ...]:
    """How to draw directions for a part, in equal shares: its own routine, or what its chart says.

    A lobe is drawn with a density that falls no faster than it does itself.
    """
    if part.routine is not None:
        return part.routine if isinstance(part.routine, tuple) else (part.routine,)
    chart, (wx, wy) = part.chart, part.widths
    if isinstance(chart, AxisChart):
        return (axis_power(chart.coefficients, min(part.widths) ** -2),)
    wx, wy = min(wx, 1.0), min(wy, 1.0)
    if isinstance(chart, TailRingsChart):
        return (ggx_normals(wx, wy),)
    if not isinstance(chart, PolarChart):
        return (COSINE,)
    if chart.kind == "slope" and chart.decay == "gaussian":
        return (gaussian_normals(wx, wy),)
    if chart.kind == "slope" and chart.decay == "cosine_power":
        # Widths are sqrt(2/n).
        return (normal_powers(2.0 / wx**2, 2.0 / wy**2),)
    # Widths of half the angle are 1/sqrt(2 n).
    n = max(0.5 / max(wx, wy) ** 2, 1.0)
    if chart.kind == "mirror_in_slopes":
        # Toward grazing the lobe keeps its width about R, while in slopes it grows without bound.
        return (ggx_normals(wx, wy), mirror_power(n))
    if chart.kind == "slope":
        return (ggx_normals(wx, wy),)
    if chart.kind.startswith("retro"):
        return (axis_power((1.0, 1.0, 1.0), n),)
    if chart.decay == "cosine_power":
        return (mirror_power(n),)
    return (ggx_normals(2.0 * wx, 2.0 * wy),)


@lru_cache(maxsize=4096)
def _own(model: Model) -> tuple[tuple[Routine, float], ...]:
    """The routines of a model with their shares.

    In proportion to the albedos of the parts at one direction, roughly, but a tenth at least:
    elsewhere a part may matter more.
    """
    parts = model.parts()
    if not parts:
        return ((COSINE, 1.0),)
    energies = np.ones(len(parts))
    if len(parts) > 1:
        # Here, because Monte Carlo needs no quadrature but for this.
        from albedo.quadrature import albedo_rows

        place = np.array([_TYPICAL]), np.zeros(1)
        found = albedo_rows([model], *place, rtol=_ROUGH, atol=_ROUGH).parts
        energies = np.array([float(found[part.name].value[0]) for part in parts])
    energies = np.where(np.isfinite(energies), energies, 0.0)
    energies = np.maximum(energies, max(_LEAST * float(energies.sum()), 1e-300))
    shares: dict[Routine, float] = {}
    for part, energy in zip(parts, energies / energies.sum(), strict=True):
        routines = routines_of(part)
        for routine in routines:
            shares[routine] = shares.get(routine, 0.0) + float(energy) / len(routines)
    return tuple(shares.items())


def mixture_of(model: Model, strategy: str = "model") -> Mixture:
    """The routines of a model, or of another strategy, with their shares.

    Parameters
    ----------
    model : Model
        Without channels.
    strategy : {"model", "cosine", "uniform", "mixture"}
        See `STRATEGIES`.

    Raises
    ------
    InputError
        For an unknown strategy, or a model that has channels.
    """
    if strategy not in STRATEGIES:
        raise InputError(f"strategy = {strategy!r} is unknown; choose {', '.join(STRATEGIES)}")
    if model.channels is not None:
        raise InputError(
            f"{model.spec} has {model.channels} channels; sample one, model.channel(i)"
        )
    if strategy == "cosine":
        return Mixture((1.0,), (COSINE,))
    if strategy == "uniform":
        return Mixture((1.0,), (UNIFORM,))
    shares = dict(_own(model))
    if strategy == "mixture":
        shares = {routine: 0.5 * share for routine, share in shares.items()}
        shares[COSINE] = shares.get(COSINE, 0.0) + 0.5
    return Mixture(tuple(shares.values()), tuple(shares))


@kernel
def lift(wi, wo, h, below):
    """Mark the draws below the horizon, and put others above it in their places.

    Kernels of models need a view direction above the horizon.
    """
    for k in range(below.shape[0]):
        for i in range(below.shape[1]):
            below[k, i] = not wo[2, k, i] > 0.0
            if below[k, i]:
                for d in range(3):
                    wo[d, k, i] = 1.0 if d == 2 else 0.0
                    h[d, k, i] = wi[d, k] + wo[d, k, i]


class Values:
    """f of a model: its parts and what their kernels read are looked up once."""

    def __init__(self, model: Model) -> None:
        packed = np.array(model.pack(), dtype=np.float64).reshape(1, -1)
        self._parts = [(part, part.packed(packed)) for part in model.parts()]

    def __call__(self, wi: np.ndarray, wo: np.ndarray, h: np.ndarray) -> np.ndarray:
        """f at directions (3, rows, columns) above the horizon, for light directions (3, rows)."""
        total: np.ndarray | None = None
        for part, p in self._parts:
            out = np.empty(wo.shape[1:])
            part.fill(wi, wo, h, np.repeat(p, wi.shape[1], axis=0), out)
            if part.scale != 1.0:
                out *= part.scale
            total = out if total is None else np.add(total, out, out=total)
        return np.zeros(wo.shape[1:]) if total is None else total


def weights(f: np.ndarray, wo: np.ndarray, pdf: np.ndarray, below: np.ndarray) -> np.ndarray:
    """f n.v/pdf, and 0 below the horizon; inf where the model sends light that is never drawn."""
    energy = np.where(below, 0.0, f * wo[2])
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(energy > 0.0, energy / pdf, 0.0)


def spike_probability(energy: np.ndarray, finite: bool) -> np.ndarray:
    """Share of the draws that Dirac parts of this total energy take: their energy, within limits.

    All where a model has nothing else, none where they have no energy.
    """
    if not finite:
        return np.where(energy > 0.0, 1.0, 0.0)
    return np.where(energy > 0.0, np.clip(energy, _RAREST, _MOST), 0.0)


def _points(u: ArrayLike, wi: ArrayLike) -> tuple[np.ndarray, np.ndarray, tuple[int, ...]]:
    points, light = real_array(u, "u"), unit_vectors(wi, "wi")
    if points.ndim == 0 or points.shape[-1] != 2:
        raise InputError(f"u has shape {points.shape}; points have shape (..., 2)")
    outside = (points < 0.0) | (points >= 1.0)
    if outside.any():
        raise InputError(f"u contains {points[outside].flat[0]:g}; points lie in [0, 1)")
    try:
        shape = np.broadcast_shapes(points.shape[:-1], light.shape[:-1])
    except ValueError:
        raise InputError(
            f"u of shape {points.shape} and wi of shape {light.shape} do not broadcast"
        ) from None
    if np.any(light[..., 2] <= 0.0):
        raise InputError("wi contains a direction that is not above the horizon (z > 0)")
    points = np.broadcast_to(points, (*shape, 2)).reshape(-1, 2)
    light = np.broadcast_to(light, (*shape, 3)).reshape(-1, 3)
    return points, light, shape


def draw(model: Model, u: ArrayLike, wi: ArrayLike) -> Sample:
    """See `albedo.brdf.Model.sample`."""
    points, light, shape = _points(u, wi)
    mixture = mixture_of(model)
    n = len(points)
    wo, pdf, weight = np.zeros((n, 3)), np.full(n, np.inf), np.zeros(n)
    directions, energies = model.spikes(light)
    total = energies.sum(0) if len(energies) else np.zeros(n)
    share = spike_probability(total, bool(model.parts()))
    first = points[:, 0]
    hit = first < share
    if hit.any():
        ends = np.cumsum(energies[:, hit], axis=0) / total[hit] * share[hit]
        which = np.minimum((first[hit] >= ends).sum(0), len(energies) - 1)
        wo[hit] = directions[which, np.flatnonzero(hit)]
        # Each is drawn in proportion to its energy: all have one weight.
        weight[hit] = total[hit] / share[hit]
    rest = ~hit
    if rest.any():
        own = points[rest].T.reshape(2, -1, 1).copy()
        left = 1.0 - share[rest]
        own[0, :, 0] = np.minimum((own[0, :, 0] - share[rest]) / left, 1.0 - 2.0**-53)
        lights = np.ascontiguousarray(light[rest].T)
        there, h = mixture.draw(lights, own)
        found = mixture.density(lights, there, h) * left[:, None]
        wo[rest], pdf[rest] = there[:, :, 0].T, found[:, 0]
        below = np.empty(there.shape[1:], dtype=bool)
        lift(lights, there, h, below)
        f = Values(model)(lights, there, h)
        weight[rest] = weights(f, there, found, below)[:, 0]
    return Sample(wo.reshape(*shape, 3), pdf.reshape(shape), weight.reshape(shape))


def density(model: Model, wi: ArrayLike, wo: ArrayLike) -> np.ndarray:
    """See `albedo.brdf.Model.pdf`."""
    view = unit_vectors(wo, "wo")
    light = unit_vectors(wi, "wi")
    try:
        light, view = np.broadcast_arrays(light, view)
    except ValueError:
        raise InputError(
            f"wi of shape {light.shape} and wo of shape {view.shape} do not broadcast"
        ) from None
    if np.any(light[..., 2] <= 0.0):
        raise InputError("wi contains a direction that is not above the horizon (z > 0)")
    shape = light.shape[:-1]
    light, view = light.reshape(-1, 3), view.reshape(-1, 3)
    h = half_vector(light, view)
    energies = model.spikes(light)[1]
    total = energies.sum(0) if len(energies) else np.zeros(len(light))
    left = 1.0 - spike_probability(total, bool(model.parts()))
    columns: Sequence[Any] = [np.ascontiguousarray(a.T).reshape(3, -1, 1) for a in (view, h)]
    found = mixture_of(model).density(np.ascontiguousarray(light.T), *columns)
    return (found[:, 0] * left).reshape(shape)
