"""What pumping-up divides by where albedos depend on the azimuth, or lobes lie anywhere.

An albedo is a table of its logarithm over heights and azimuths: tensor Chebyshev series on
rectangles of (y, azimuth), y being the coordinate of `albedo.operators.divisor`, which are halved
across the worse direction until fresh points between their nodes confirm them. Where a model is
symmetric about its tangent and bitangent, as well as can be seen, a quarter of the azimuths does.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.polynomial import chebyshev

from albedo._compile import kernel
from albedo.brdf import Model
from albedo.charts.heights import FIRST, LAST, LOWEST, fold_vector, folded, unfolded
from albedo.errors import InputError
from albedo.operators.divisor import CONTROLS
from albedo.quadrature import albedo_rows

# Nodes along y and along the azimuth, and fresh points between them.
_ORDER, _TURNS = 16, 8
_NODES, _FRESH = chebyshev.chebpts1(_ORDER), chebyshev.chebpts2(_ORDER + 1)[::2]
_TURNED, _FRESH_TURNED = chebyshev.chebpts1(_TURNS), chebyshev.chebpts2(_TURNS + 1)[::2]
# Between its nodes an interpolant errs most. Fresh points stand in every second gap, and at both
# ends: what a gap between them hides is not many times as much.
_TRUST = 8.0
# What errors at the nodes may come to between them: the Lebesgue constants of both sets of nodes.
_LEBESGUE, _LEBESGUE_TURNED = 2.8, 2.4
# What an albedo itself may err by, as a share of the tolerance, and evaluations that it may take.
_OWN, _LIMIT = 0.05, 100_000
# Rectangles of an anisotropic albedo cost a hundred times what pieces of an isotropic one do.
_MOST, _MOST_TURNED, _SHORTEST = 400, 60, 1e-6
# Terms of series that sum to less than this share of a table's error are left out.
_SHARE = 0.01
_STARTS = (FIRST, -24.0, -8.0, -3.0, 0.0, LAST)
_QUARTER, _WHOLE = 0.5 * math.pi, 2.0 * math.pi
_SYMMETRY_CHECKS = 12


@dataclass(frozen=True, eq=False)
class LogMap:
    """The logarithm of an albedo over all directions of incidence, rectangle by rectangle.

    Attributes
    ----------
    box : ndarray, shape (m, 4)
        Ends of the rectangles in y and in azimuth.
    series : ndarray, shape (m, 16, 8)
        Chebyshev coefficients on each; one along the azimuth for an isotropic model.
    error : ndarray, shape (m,)
        Bound on the error over each, relative to the albedo.
    quarter : bool
        A quarter of the azimuths stands for all.
    axis, split, child : ndarray
        A tree that finds the rectangle of a place: along which direction a node is cut (-1: it is
        a leaf), where, and the two nodes or the rectangle below it.
    evaluations : int
        Of the model, to make the table.
    """

    box: np.ndarray
    series: np.ndarray
    error: np.ndarray
    quarter: bool
    axis: np.ndarray
    split: np.ndarray
    child: np.ndarray
    evaluations: int

    def at(self, wi: np.ndarray) -> np.ndarray:
        """The albedo for unit vectors (n, 3)."""
        out = np.empty((len(wi), 1))
        _albedos_all(wi, *Maps((self,), None).known, out)
        return np.exp(out[:, 0])


@dataclass
class _Tree:
    """A tree of rectangles that grows at its leaves."""

    axis: list[int] = field(default_factory=list)
    split: list[float] = field(default_factory=list)
    child: list[list[int]] = field(default_factory=list)

    def leaf(self) -> int:
        self.axis.append(-1)
        self.split.append(0.0)
        self.child.append([-1, -1])
        return len(self.axis) - 1

    def cut(self, node: int, axis: int, place: float) -> list[int]:
        """Cut a leaf; return the two new ones."""
        self.axis[node], self.split[node] = axis, place
        self.child[node] = [self.leaf(), self.leaf()]
        return self.child[node]

    def over(self, node: int, axis: int, ends: list[float]) -> list[int]:
        """Cut a leaf at all but the first and the last of some places; return the leaves."""
        if len(ends) < 3:
            return [node]
        k = len(ends) // 2
        low, high = self.cut(node, axis, ends[k])
        return self.over(low, axis, ends[: k + 1]) + self.over(high, axis, ends[k:])


def log_map(model: Model, rtol: float) -> LogMap:
    """Tabulate the logarithm of an albedo over all heights and azimuths.

    Parameters
    ----------
    model : Model
    rtol : float
        The relative error asked for, everywhere.

    Returns
    -------
    LogMap
        With the bounds that were reached.

    Raises
    ------
    InputError
        For an albedo that is not above 0.
    """
    # One node along the azimuth is enough where none differs from another.
    turned = np.zeros(1) if model.isotropic else _TURNED
    fresh_turned = np.zeros(1) if model.isotropic else _FRESH_TURNED
    lebesgue = _LEBESGUE if model.isotropic else _LEBESGUE * _LEBESGUE_TURNED
    quarter = model.isotropic or _symmetric(model, rtol)
    turns = np.linspace(0.0, _QUARTER if quarter else _WHOLE, 2 if quarter else 5).tolist()
    tree = _Tree()
    active: list[tuple[int, float, float, float, float]] = []
    for band, ends in zip(
        tree.over(tree.leaf(), 0, list(_STARTS)), itertools.pairwise(_STARTS), strict=True
    ):
        for node, (first, last) in zip(
            tree.over(band, 1, turns), itertools.pairwise(turns), strict=True
        ):
            active.append((node, *ends, first, last))
    leaves: list[tuple[np.ndarray, np.ndarray, float]] = []
    used = 0
    turn_basis = chebyshev.chebvander(turned, turned.size - 1)
    fresh_basis = chebyshev.chebvander(fresh_turned, turned.size - 1)
    while active:
        box = np.array([rectangle[1:] for rectangle in active])
        sets = []
        for along, across in ((_NODES, turned), (_FRESH, fresh_turned)):
            size = box[:, 1:2] - box[:, :1]
            c = np.clip(unfolded(box[:, :1] + 0.5 * (along + 1.0) * size), LOWEST, 1.0)
            phi = box[:, 2:3] + 0.5 * (across + 1.0) * (box[:, 3:] - box[:, 2:3])
            places = np.broadcast_arrays(c[:, :, None], phi[:, None, :])
            flat = places[0].ravel(), places[1].ravel()
            found = albedo_rows(
                [model] * flat[0].size,
                *flat,
                rtol=_OWN * rtol,
                atol=0.0,
                max_evaluations=_LIMIT,
            )
            used += int(found.evaluations.sum())
            dark = ~(found.value > 0.0)
            if dark.any():
                raise InputError(
                    f"{model.spec} cannot be pumped up: at cos_theta = {flat[0][dark][0]:.3g} "
                    f"its albedo is {found.value[dark][0]:g}, not above 0"
                )
            # Cosines are rounded: near 1 they stand for another angle.
            u = np.clip(2.0 * (folded(c) - box[:, :1]) / size - 1.0, -1.0, 1.0)
            shape = places[0].shape
            own = (found.error / found.value).reshape(shape).max((1, 2))
            sets.append((np.log(found.value.reshape(shape)), own, u))
        (logs, own, u), (fresh, other, u_fresh) = sets
        half = np.linalg.solve(chebyshev.chebvander(u, _ORDER - 1), logs)
        series = np.linalg.solve(turn_basis, half.transpose(0, 2, 1)).transpose(0, 2, 1)
        fitted = chebyshev.chebvander(u_fresh, _ORDER - 1) @ series @ fresh_basis.T
        missed = np.abs(fitted - fresh).max((1, 2))
        noise = np.maximum(own, other)
        bound = _TRUST * missed + lebesgue * noise
        done = (bound <= rtol) | (missed <= noise) | (box[:, 1] - box[:, 0] < _SHORTEST)
        if len(leaves) + 2 * len(active) > (_MOST if model.isotropic else _MOST_TURNED):
            done[:] = True
        tails = np.abs(series[:, -3:]).sum((1, 2)), np.abs(series[:, :, -2:]).sum((1, 2))
        halves: list[tuple[int, float, float, float, float]] = []
        for k, (node, low, high, first, last) in enumerate(active):
            if done[k]:
                tree.child[node] = [len(leaves), -1]
                leaves.append((box[k], series[k], float(bound[k])))
            elif model.isotropic or tails[0][k] >= tails[1][k]:
                middle = 0.5 * (low + high)
                below, above = tree.cut(node, 0, middle)
                halves += [(below, low, middle, first, last), (above, middle, high, first, last)]
            else:
                middle = 0.5 * (first + last)
                before, after = tree.cut(node, 1, middle)
                halves += [(before, low, high, first, middle), (after, low, high, middle, last)]
        active = halves
    return LogMap(
        np.array([leaf[0] for leaf in leaves]),
        np.array([leaf[1] for leaf in leaves]),
        np.array([leaf[2] for leaf in leaves]),
        quarter,
        np.array(tree.axis),
        np.array(tree.split),
        np.array(tree.child),
        used,
    )


def _symmetric(model: Model, rtol: float) -> bool:
    """Whether albedos mirrored at tangent and bitangent are the same, as far as is known."""
    rng = np.random.default_rng(1)
    deep = 0.5 * np.exp(-10.0 * rng.random(_SYMMETRY_CHECKS))
    c = np.concatenate((rng.random(_SYMMETRY_CHECKS), deep))
    phi = rng.uniform(0.0, _QUARTER, c.size)
    found = [
        albedo_rows([model] * c.size, c, turn, rtol=_OWN * rtol, atol=0.0)
        for turn in (phi, -phi, math.pi - phi, math.pi + phi)
    ]
    first = found[0]
    return all(
        bool(np.all(np.abs(other.value - first.value) <= first.error + other.error))
        for other in found[1:]
    )


@dataclass(frozen=True, eq=False)
class Maps:
    """The product of the divisors of some steps, as a function of L and V.

    Parameters
    ----------
    tables : tuple of LogMap
        Albedos before every step.
    control : {None, "literal", "cumulative"}
        See `albedo.operators.divisor.CONTROLS`.
    """

    tables: tuple[LogMap, ...]
    control: str | None

    @property
    def code(self) -> int:
        """The number of the control."""
        return CONTROLS.index(self.control)

    @property
    def changes(self) -> int:
        """How many functions change their signs where the divisor has kinks."""
        steps = len(self.tables)
        return (steps, 2 * steps, steps + 2)[self.code] if steps else 0

    @cached_property
    def known(self) -> tuple[np.ndarray, ...]:
        """All tables as one: where their trees begin, whether a quarter is all, and the trees."""
        tables = self.tables
        nodes = np.cumsum([0, *(table.axis.size for table in tables)])
        leaves = np.cumsum([0, *(table.error.size for table in tables)])
        child = [
            table.child + np.where(table.axis >= 0, node, leaf)[:, None]
            for table, node, leaf in zip(tables, nodes[:-1], leaves[:-1], strict=True)
        ]
        quarter = np.array([table.quarter for table in tables])
        axis, split, box, series, error = (
            np.concatenate([getattr(table, k) for table in tables])
            for k in ("axis", "split", "box", "series", "error")
        )
        size = _sizes(series, error)
        return nodes[:-1], quarter, axis, split, np.concatenate(child), box, size, series

    @cached_property
    def errors(self) -> tuple[float, ...]:
        """Bounds on the relative errors of all tables."""
        return tuple((1.0 + _SHARE) * float(table.error.max()) for table in self.tables)

    def divide(self, wi: np.ndarray, wo: np.ndarray, out: np.ndarray) -> None:
        """Divide values of a kernel by the divisor, in place."""
        if self.tables:
            _divide(wi, wo, *self.known, self.code, out)

    def between(self, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        """The divisor for pairs of unit vectors (n, 3)."""
        out = np.ones((len(wi), 1))
        views = np.ascontiguousarray(wo.T).reshape(3, -1, 1)
        self.divide(np.ascontiguousarray(wi.T), views, out)
        found: np.ndarray = 1.0 / out[:, 0]
        return found


def _sizes(series: np.ndarray, error: np.ndarray) -> np.ndarray:
    """How many terms of series are needed, along y and along the azimuth: (m, 2)."""
    modulus = np.abs(series)
    found = np.empty((len(series), 2), int)
    for side in (0, 1):
        rows = modulus.sum(2 - side)
        beyond = np.cumsum(rows[:, ::-1], axis=1)[:, ::-1]
        found[:, side] = np.maximum((beyond > 0.5 * _SHARE * error[:, None]).sum(1), 1)
    return found


@kernel
def albedos_at(x, y, z, roots, quarter, axis, split, child, box, size, series, out):
    """Fill the logarithms of the albedos of all steps for one direction."""
    height = fold_vector(x, y, z)
    fourth, turn = 0.0, 0.0
    if series.shape[2] > 1:
        fourth = math.atan2(abs(y), abs(x))
    for j in range(roots.size):
        place = fourth
        if not quarter[j]:
            turn = math.atan2(y, x)
            place = turn if turn >= 0.0 else turn + 2.0 * math.pi
        node = roots[j]
        while axis[node] >= 0:
            along = height if axis[node] == 0 else place
            node = child[node, 0] if along < split[node] else child[node, 1]
        k = child[node, 0]
        a, b, c, d = box[k, 0], box[k, 1], box[k, 2], box[k, 3]
        inside, within = min(max(height, a), b), min(max(place, c), d)
        u = 2.0 * ((inside - a) - (b - inside)) / (b - a)
        v = 2.0 * ((within - c) - (d - within)) / (d - c)
        # Two sums of Clenshaw's, u and v being twice the variables.
        total = before = own = 0.0
        for m in range(size[k, 0] - 1, -1, -1):
            inner = last = 0.0
            for n in range(size[k, 1] - 1, 0, -1):
                inner, last = v * inner + (series[k, m, n] - last), inner
            own = 0.5 * v * inner - last + series[k, m, 0]
            if m > 0:
                total, before = u * total + (own - before), total
        out[j] = 0.5 * u * total - before + own


@kernel
def _albedos_all(wi, roots, quarter, axis, split, child, box, size, series, out):
    known = roots, quarter, axis, split, child, box, size, series
    for i in range(out.shape[0]):
        albedos_at(wi[i, 0], wi[i, 1], wi[i, 2], *known, out[i])


@kernel
def _divide(wi, wo, roots, quarter, axis, split, child, box, size, series, control, out):
    at_l, at_v = np.empty(roots.size), np.empty(roots.size)
    known = roots, quarter, axis, split, child, box, size, series
    for k in range(out.shape[0]):
        lz = max(wi[2, k], LOWEST)
        albedos_at(wi[0, k], wi[1, k], wi[2, k], *known, at_l)
        for i in range(out.shape[1]):
            vz = wo[2, k, i]
            if not vz > 0.0:
                continue
            albedos_at(wo[0, k, i], wo[1, k, i], vz, *known, at_v)
            product = 0.0
            for j in range(roots.size):
                step = max(at_v[j], at_l[j])
                if control == 1:
                    step = max(step, math.log(max(vz, lz)))
                product += step
            if control == 2:
                product = max(product, math.log(max(vz, lz)))
            out[k, i] *= math.exp(-product)


@kernel
def changes_at(at_l, at_v, lz, vz, control, out):
    """Fill functions whose signs change where the divisor has kinks."""
    steps = at_l.size
    log_l, log_v = 0.0, 0.0
    if control > 0:
        log_l, log_v = math.log(lz), math.log(vz)
    if control == 1:
        for j in range(steps):
            out[2 * j] = max(at_v[j], log_v) - max(at_l[j], log_l)
            out[2 * j + 1] = at_v[j] - log_v
        return
    product = 0.0
    for j in range(steps):
        out[j] = at_v[j] - at_l[j]
        product += max(at_v[j], at_l[j])
    if control == 2:
        out[steps] = product - max(log_l, log_v)
        out[steps + 1] = log_v - log_l
