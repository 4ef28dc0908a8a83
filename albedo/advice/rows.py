"""Values and albedos of many models at once, each with directions of its own."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from albedo._compile import is_kernel
from albedo._threads import in_batches
from albedo.brdf import Model
from albedo.directions import half_vector
from albedo.quadrature import albedo_rows

# Directions that are held at once, so that arrays stay in a core's second cache.
_BLOCK = 2**14


class Rows:
    """f of models that may all differ, one for each row.

    Parameters
    ----------
    models : sequence of Model
        With one channel each.
    kernels : callable, optional
        What stands for the kernel of a part, such as the same in float32.
    dtype : type
        Of the numbers that those kernels take and give.
    """

    def __init__(
        self,
        models: Sequence[Model],
        kernels: Callable[[Any], Any] = lambda fill: fill,
        dtype: Any = np.float64,
    ) -> None:
        self._dtype = dtype
        # Which parts a row has, by a number, and which of those that have them it is.
        self._kind = np.empty(len(models), dtype=int)
        self._place = np.empty(len(models), dtype=int)
        numbers: dict[Any, int] = {}
        counts: list[int] = []
        fills: list[list[Any]] = []
        packed: list[list[list[np.ndarray]]] = []
        scales: list[list[list[float]]] = []
        seen: dict[int, tuple[int, int]] = {}
        for row, model in enumerate(models):
            if id(model) not in seen:
                parts = model.parts()
                key = tuple((part.fill, part.columns) for part in parts)
                if key not in numbers:
                    numbers[key] = len(fills)
                    counts.append(0)
                    fills.append([kernels(part.fill) for part in parts])
                    packed.append([[] for _ in parts])
                    scales.append([[] for _ in parts])
                kind = numbers[key]
                p = np.array([model.pack()], dtype=np.float64)
                for part, own, factors in zip(parts, packed[kind], scales[kind], strict=True):
                    own.append(part.packed(p)[0])
                    factors.append(part.scale)
                seen[id(model)] = kind, counts[kind]
                counts[kind] += 1
            self._kind[row], self._place[row] = seen[id(model)]
        self._parts = [
            [
                (fill, np.array(own, dtype=dtype).reshape(len(own), -1), np.array(factors))
                for fill, own, factors in zip(*lists, strict=True)
            ]
            for lists in zip(fills, packed, scales, strict=True)
        ]

    def __len__(self) -> int:
        return len(self._kind)

    def take(self, which: np.ndarray) -> Rows:
        """Some of the rows, by their numbers."""
        taken = copy.copy(self)
        taken._kind, taken._place = self._kind[which], self._place[which]
        return taken

    def __call__(self, wi: np.ndarray, wo: np.ndarray, h: np.ndarray) -> np.ndarray:
        """f in 1/sr at directions (3, rows, columns) above the horizon, for lights (3, rows)."""
        total = np.zeros(wo.shape[1:])
        step = max(1, _BLOCK // wo.shape[2])
        for kind, parts in enumerate(self._parts):
            rows = np.flatnonzero(self._kind == kind)

            def add(which: slice, rows: np.ndarray = rows, parts: Any = parts) -> None:
                for first in range(which.start, which.stop, step):
                    own = rows[first : min(first + step, which.stop)]
                    vectors = wi[:, own], wo[:, own], h[:, own]
                    light, view, half = (
                        np.ascontiguousarray(v, dtype=self._dtype) for v in vectors
                    )
                    out = np.empty(view.shape[1:], dtype=self._dtype)
                    place = self._place[own]
                    for fill, p, scale in parts:
                        fill(light, view, half, p[place], out)
                        total[own] += scale[place, None] * out

            # What users wrote in Python may not be meant for several threads.
            if all(is_kernel(fill) for fill, _, _ in parts):
                in_batches(add, len(rows), step)
            else:
                add(slice(0, len(rows)))
        return total

    def of_lights(self, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        """f in 1/sr, shape (rows, k), for lights (rows, k, 3) and one view (rows, 3) each."""
        rows, count = wi.shape[:2]
        step = max(1, _BLOCK // count)
        total = np.empty((rows, count))
        for first in range(0, rows, step):
            own = np.arange(first, min(first + step, rows))
            light = wi[own].reshape(-1, 3)
            view = np.repeat(wo[own], count, axis=0)
            half = half_vector(light, view)
            columns = (np.ascontiguousarray(v.T)[:, :, None] for v in (view, half))
            spread = self.take(np.repeat(own, count))
            total[own] = spread(np.ascontiguousarray(light.T), *columns).reshape(-1, count)
        return total


def albedos(
    models: Sequence[Model],
    cos_theta: np.ndarray,
    phi: np.ndarray,
    rtol: float,
    atol: float,
    fixed: str,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Albedos, their bounds, and evaluations, of many models.

    Returns
    -------
    tuple of ndarray
        Each of shape (n,).
    """
    how: dict[str, Any] = {"rtol": rtol, "atol": atol, "fixed": fixed, "shared": True}
    found = albedo_rows(models, cos_theta, phi, **how)
    return found.value, found.error, found.evaluations


def spike_energy(models: Sequence[Model], wi: np.ndarray) -> np.ndarray:
    """Energy of the Dirac parts for lights (n, 3), shape (n,)."""
    total = np.zeros(len(models))
    for row, model in enumerate(models):
        energies = model.spikes(wi[row : row + 1])[1]
        total[row] = float(energies.sum()) if len(energies) else 0.0
    return total
