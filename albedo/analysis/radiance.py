r"""Output radiance of a surface that a point source lights, and where it is largest.

A source whose rays carry unit irradiance on a plane perpendicular to them lights the surface with
n.l, so that the radiance towards V is

    f(L, V) n.l,    in 1/sr                                             (NNS sect. 3.1).

Dirac parts are left out: their radiance is no number.

The largest radiance over all V is sought where the lobe is said to be: on the panels of the charts
of all parts, which end at every kink that a model declares, so that the largest value lies inside
a panel, where the radiance is smooth and wide whatever the width of the lobe, or on the edge of
one. All local maxima of a first look are closed in on, in the coordinates of their panels, until
nothing changes any more. What the last look still shows is part of the bound.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from albedo.brdf import Model
from albedo.directions import half_vector, real_array, unit_vectors
from albedo.errors import InputError
from albedo.estimate import Estimate

_EPS = np.finfo(np.float64).eps
# As in the quadrature: roundings of a kernel, and what is made of a move by an ulp.
_ROUNDINGS, _PROBE = 40.0, 4.0
# Nodes of the first look, dense at the edges of panels, and of the later ones.
_FIRST = 0.5 * (1.0 - np.cos(np.pi * np.arange(11) / 10))
_LATER = np.linspace(0.0, 1.0, 9)
# No node stands on an edge, where charts may be singular; it comes as close as the look is small.
_MARGIN = 1e-14
_MOST_MAXIMA, _ROUNDS = 96, 200
# Panels that are looked at together.
_BLOCK = 512
# A view so far below L lies at the horizon; there a radiance that still grows has no largest value.
_LOW, _GROWTH = 1e-6, 1e-4
_HORIZON = np.array([1e-9, 1e-12, 1e-15, 1e-18])
_ROUNDED = 1e-15
# Nodes that are remembered, to tell how wide the top of a lobe is.
_MOST_SEEN = 20_000


@dataclass(frozen=True, eq=False)
class Peak:
    """The largest output radiance that a light direction gives, and where.

    Attributes
    ----------
    value, error : float
        The radiance in 1/sr, and a bound; inf where it grows without limit towards the horizon.
    direction : ndarray, shape (3,)
        The view; at the horizon where the radiance has its limit there.
    bracket : float
        Within this angle in radians of `direction` nothing is known to be smaller than the peak
        by more than its error: what the direction is worth. Where several directions are equal it
        holds them all.
    cos_view : float
        n.v of `direction`.
    angle_from_mirror : float
        Angle in radians between `direction` and the mirror direction.
    at_mirror, at_mirror_error : float
        The radiance in the mirror direction, and a bound.
    evaluations : int
        Of the model.
    """

    value: float
    error: float
    direction: np.ndarray
    bracket: float
    cos_view: float
    angle_from_mirror: float
    at_mirror: float
    at_mirror_error: float
    evaluations: int

    @property
    def off_specular(self) -> bool:
        """Whether the peak lies beside the mirror direction, by more than its direction errs."""
        return self.angle_from_mirror > self.bracket


class _Lobes:
    """The values of a model at directions in the form that kernels read."""

    def __init__(self, model: Model) -> None:
        if model.channels is not None:
            raise InputError(
                f"{model.spec} has {model.channels} channels; choose one with .channel(index)"
            )
        self.parts, self.lowest = model.parts(), model.lowest_cosine
        self._packed = np.array(model.pack(), dtype=np.float64)
        self.evaluations = 0

    def by_part(self, wi: np.ndarray, wo: np.ndarray, h: np.ndarray) -> list[np.ndarray]:
        """f n.l of every part, for wi (3, m), wo and h (3, m, q): arrays (m, q)."""
        low = ~(wo[2] > 0.0)
        if low.any():
            # Kernels take views above the horizon.
            wo, h = wo.copy(), h.copy()
            h[2][low] += 1e-300 - wo[2][low]
            wo[2][low] = 1e-300
        p = np.tile(self._packed, (wi.shape[1], 1))
        found = []
        for part in self.parts:
            out = np.empty(wo.shape[1:])
            with np.errstate(all="ignore"):
                part.fill(wi, wo, h, part.packed(p), out)
                out *= part.scale * wi[2][:, None]
            out[low] = 0.0
            found.append(out)
            self.evaluations += out.size
        return found

    def __call__(self, wi: np.ndarray, wo: np.ndarray, h: np.ndarray) -> np.ndarray:
        total: np.ndarray = np.sum(self.by_part(wi, wo, h), axis=0)
        return total.reshape(wo.shape[1:])

    def bounded(
        self, wi: np.ndarray, wo: np.ndarray, h: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Values and bounds: of the numbers in a model, of rounding and of conditioning."""
        here = self.by_part(wi, wo, h)
        # As in the quadrature: opposite signs move every slope the same way.
        up, down = 1.0 + _EPS, 1.0 - _EPS
        moved = self.by_part(
            np.ascontiguousarray(wi * np.array([up, down, up])[:, None]),
            np.ascontiguousarray(wo * np.array([down, up, up])[:, None, None]),
            np.ascontiguousarray(h * np.array([up, up, down])[:, None, None]),
        )
        value, error = np.zeros(wo.shape[1:]), np.zeros(wo.shape[1:])
        for part, f, other in zip(self.parts, here, moved, strict=True):
            doubt = part.doubt(wi[2]) if callable(part.doubt) else np.array(part.doubt)
            value += f
            relative = np.broadcast_to(doubt, wi.shape[1])[:, None] + _ROUNDINGS * _EPS
            error += relative * np.abs(f) + _PROBE * np.abs(other - f)
        unknown = ~np.isfinite(value) | (np.minimum(wo[2], wi[2][:, None]) < self.lowest)
        return value, np.where(unknown, np.inf, error)


def output_radiance(model: Model, wi: ArrayLike, wo: ArrayLike) -> Estimate:
    """Output radiance f(L, V) n.l of a point source of unit irradiance across its rays, in 1/sr.

    Parameters
    ----------
    model : Model
        Without channels.
    wi, wo : array_like, shape (..., 3)
        Unit vectors to the light and to the viewer; leading axes broadcast.

    Returns
    -------
    Estimate
        Of kind ``bound``, 0 where either direction is not above the horizon. The bound holds what
        the numbers in the model are worth, rounding, and what an ulp in the directions changes.

    Raises
    ------
    InputError
        For directions that are no unit vectors, and for models with channels.

    Examples
    --------
    >>> import albedo
    >>> from albedo.analysis.radiance import output_radiance
    >>> print(output_radiance(albedo.model("lambert"), (0.6, 0.0, 0.8), (0.0, 0.0, 1.0)))
    0.254647908947(1) [bound]
    """
    light, view = unit_vectors(wi, "wi"), unit_vectors(wo, "wo")
    try:
        light, view = np.broadcast_arrays(light, view)
    except ValueError:
        raise InputError(
            f"wi of shape {light.shape} and wo of shape {view.shape} do not broadcast"
        ) from None
    lobes = _Lobes(model)
    shape = light.shape[:-1]
    light, view = light.reshape(-1, 3), view.reshape(-1, 3)
    value, error = np.zeros(len(light)), np.zeros(len(light))
    above = (light[:, 2] > 0.0) & (view[:, 2] > 0.0)
    if above.any():
        value[above], error[above] = _at(lobes, light[above], view[above])
    return Estimate(
        *(value.reshape(shape), error.reshape(shape), "bound"),
        *(np.ones(shape, dtype=int), np.isfinite(error).reshape(shape)),
        model.resolved_width,
    )


def plane_radiance(
    model: Model,
    cos_theta: float,
    theta_view: ArrayLike,
    azimuth: ArrayLike = 0.0,
    phi: float = 0.0,
) -> Estimate:
    """Output radiance along a plane through the normal: the plane of incidence unless turned.

    Parameters
    ----------
    model : Model
        Without channels.
    cos_theta : float
        Cosine of the angle of incidence, in (0, 1].
    theta_view : array_like
        Angles of V to the normal in radians, in [-pi/2, pi/2], positive on the side of the mirror
        direction.
    azimuth : array_like
        Turns the plane about the normal, out of that of incidence; radians. Broadcasts.
    phi : float
        Azimuth of the light.

    Returns
    -------
    Estimate
        As `output_radiance`; 0 at the horizon.
    """
    c = _cosine(cos_theta)
    angle, turn = np.broadcast_arrays(
        real_array(theta_view, "theta_view"), real_array(azimuth, "azimuth")
    )
    if np.any(np.abs(angle) > 0.5 * math.pi):
        worst = angle[np.abs(angle) > 0.5 * math.pi].flat[0]
        raise InputError(f"theta_view = {worst:g} is out of range; it lies in [-pi/2, pi/2]")
    lobes = _Lobes(model)
    s = math.sqrt((1.0 - c) * (1.0 + c))
    e_l = math.atan2(c, s)
    flat, around = angle.ravel(), turn.ravel()
    value, error = np.zeros(flat.size), np.zeros(flat.size)
    inside = np.abs(flat) < 0.5 * math.pi
    if inside.any():
        theta, chi = flat[inside], around[inside]
        # Half vectors from differences of elevations, which lose nothing near the mirror direction.
        below = np.abs(theta) + e_l - 0.5 * math.pi
        chi = np.where(theta < 0.0, chi + math.pi, chi)
        wi, wo, h = _about_mirror(c, s, phi, 0.5 * math.pi - np.abs(theta), below, chi)
        found = lobes.bounded(wi, wo, h)
        value[inside], error[inside] = found[0][0], found[1][0]
    return Estimate(
        *(value.reshape(angle.shape), error.reshape(angle.shape), "bound"),
        *(np.ones(angle.shape, dtype=int), np.isfinite(error).reshape(angle.shape)),
        model.resolved_width,
    )


def _about_mirror(
    c: float, s: float, phi: float, elevation: np.ndarray, below: np.ndarray, chi: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Directions (3, 1), (3, 1, q) and half vectors: V so far below R, turned by chi from it."""
    e_l = math.atan2(c, s)
    n_v, s_v = np.sin(elevation), np.cos(elevation)
    half = np.sin(0.5 * chi)
    # As in `albedo.charts.rings`: s_l - s_v, then what the turn adds.
    along = -2.0 * np.sin(0.5 * below) * np.sin(0.5 * (elevation + e_l)) + 2.0 * s_v * half**2
    across = -s_v * np.sin(chi)
    cos_phi, sin_phi = math.cos(phi), math.sin(phi)
    wi = np.array([s * cos_phi, s * sin_phi, c])[:, None]
    h = np.stack((along * cos_phi - across * sin_phi, along * sin_phi + across * cos_phi, c + n_v))
    wo = np.stack((h[0] - wi[0], h[1] - wi[1], n_v))
    return wi, np.ascontiguousarray(wo[:, None, :]), np.ascontiguousarray(h[:, None, :])


def _at(lobes: _Lobes, light: np.ndarray, view: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values and bounds for pairs of raw directions above the horizon, (n, 3)."""
    count = len(light)
    h = half_vector(light, view)
    value, error = lobes.bounded(
        np.ascontiguousarray(light.T),
        np.ascontiguousarray(view.T).reshape(3, count, 1),
        np.ascontiguousarray(h.T).reshape(3, count, 1),
    )
    return value[:, 0], error[:, 0]


def _cosine(cos_theta: float) -> float:
    c = real_array(cos_theta, "cos_theta")
    if c.ndim or not 0.0 < c <= 1.0:
        raise InputError(f"cos_theta = {cos_theta!r} is out of range; it is a number in (0, 1]")
    return float(c)


def peak(model: Model, cos_theta: float, phi: float = 0.0) -> Peak:
    """The largest output radiance over all views, for one light direction.

    Parameters
    ----------
    model : Model
        Without channels; Dirac parts are left out.
    cos_theta : float
        Cosine of the angle of incidence, in (0, 1].
    phi : float
        Azimuth of the light in radians.

    Returns
    -------
    Peak
        Its value is inf where the radiance grows without limit as V nears the horizon. What a
        lobe sends beyond the cut of its chart, 4.5e-19 of its peak, is not looked at.

    Raises
    ------
    InputError
        For input out of range, and for models with channels.

    Examples
    --------
    >>> import albedo, math
    >>> from albedo.analysis.radiance import peak
    >>> found = peak(albedo.model("phong", n=20), 0.5)
    >>> print(f"{found.value * 2 * math.pi / 22:.9f} {found.angle_from_mirror:g}")
    0.500000000 0
    """
    c = _cosine(cos_theta)
    azimuth = real_array(phi, "phi")
    if azimuth.ndim:
        raise InputError(f"phi = {phi!r} is out of range; it is one number")
    lobes = _Lobes(model)
    search = _Search(lobes, c, float(azimuth))
    isotropic = model.isotropic
    for part in lobes.parts:
        search.part(part, isotropic)
    return search.result()


class _Search:
    """A search for the largest radiance of one light direction, and what it has seen."""

    def __init__(self, lobes: _Lobes, c: float, phi: float) -> None:
        self.lobes, self.c, self.phi = lobes, c, phi
        self.s = math.sqrt((1.0 - c) * (1.0 + c))
        self.wi = np.array([self.s * math.cos(phi), self.s * math.sin(phi), c])
        # The most that places may hold which were left.
        self.hidden: list[float] = []
        self.seen: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        wi, wo, h = self._mirror()
        value, error = lobes.bounded(wi, wo, h)
        self.mirror, self.mirror_error = float(value[0, 0]), float(error[0, 0])
        self.best, self.noise = max(self.mirror, 0.0), self.mirror_error
        self.wo, self.h = wo[:, 0, 0], h[:, 0, 0]
        # Directions in which lobes and kinks are centred are looked at as they are.
        for view in (-self.wi * np.array([1.0, 1.0, -1.0]), self.wi, np.array([0.0, 0.0, 1.0])):
            self._look(*self._raw(view))

    def _mirror(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        wo = np.array([-self.wi[0], -self.wi[1], self.c]).reshape(3, 1, 1)
        return self.wi[:, None], wo, np.array([0.0, 0.0, 2.0 * self.c]).reshape(3, 1, 1)

    def _raw(self, view: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        h = half_vector(self.wi, view).reshape(3, 1, 1)
        return self.wi[:, None], np.ascontiguousarray(view.reshape(3, 1, 1)), h

    def _look(self, wi: np.ndarray, wo: np.ndarray, h: np.ndarray) -> np.ndarray:
        """Values at nodes; the best is kept, and what comes near it."""
        # At the horizon it is rounding that puts a node above or below.
        least = max(_HORIZON[-1] * self.c, self.lobes.lowest)
        at_horizon = (np.abs(wo[2]) < _ROUNDED) | ((wo[2] > 0.0) & (wo[2] < least))
        if at_horizon.any():
            wo, h = wo.copy(), h.copy()
            lifted = np.where(at_horizon, np.maximum(wo[2], least), wo[2])
            h[2] += lifted - wo[2]
            wo[2] = lifted
        f = self.lobes(wi, wo, h)
        f = np.where(np.isnan(f), -math.inf, f)
        flat, views, halves = f.ravel(), wo.reshape(3, -1), h.reshape(3, -1)
        k = int(np.argmax(flat))
        # Where several are equal, the first stays: the mirror direction, if it is among them.
        if flat[k] > (1.0 + 4.0 * _EPS) * self.best:
            self.best = float(flat[k])
            self.wo, self.h = views[:, k].copy(), halves[:, k].copy()
            self.noise = float(self.lobes.bounded(*self._best())[1][0, 0])
        near = np.flatnonzero(flat >= self.best - max(1e-9 * self.best, self.noise))
        if near.size > _MOST_SEEN:
            near = near[:: -(-near.size // _MOST_SEEN)]
        self.seen.append((flat[near], views[:, near], halves[:, near]))
        return f

    def _best(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self.wi[:, None], self.wo.reshape(3, 1, 1), self.h.reshape(3, 1, 1)

    def part(self, part: Any, isotropic: bool) -> None:
        """Look at all panels of a part, then close in on every local maximum that was seen."""
        chart = part.chart
        widths = np.array([part.widths], dtype=np.float64)
        geometry, row, code, box = chart.panels(
            np.array([self.c]), np.array([self.phi]), widths, isotropic, fine=True
        )
        geometry = geometry[row]
        side = _inside(_FIRST)
        found: list[tuple[float, float, int, np.ndarray]] = []
        for first in range(0, row.size, _BLOCK):
            block = slice(first, first + _BLOCK)
            wi, wo, h, _ = chart.nodes(geometry[block], code[block], box[block], side, side)
            f = self._look(wi, wo, h).reshape(-1, side.size, side.size)
            found += _maxima(f, first, box[block], side)
            # What cannot reach the best any more is dropped.
            found = [item for item in found if item[0] >= self.best]
        found.sort(key=lambda item: -item[0])
        found = found[:_MOST_MAXIMA]
        if not found:
            return
        which = np.array([item[2] for item in found])
        boxes = np.array([item[3] for item in found])
        self._close_in(chart, geometry[which], code[which], box[which], boxes)

    def _close_in(
        self, chart: Any, geometry: np.ndarray, code: np.ndarray, whole: np.ndarray, box: np.ndarray
    ) -> None:
        """Look again and again at what lies around the largest values, on less each time."""
        side = _inside(_LATER)
        limit = np.stack((whole[:, 1] - whole[:, 0], whole[:, 3] - whole[:, 2]), axis=1)
        earlier = np.full((len(box), 3), -math.inf)
        for _ in range(_ROUNDS):
            wi, wo, h, _ = chart.nodes(geometry, code, box, side, side)
            f = self._look(wi, wo, h).reshape(len(box), -1)
            place = f.argmax(1)
            i, j = np.divmod(place, side.size)
            top = f[np.arange(len(f)), place]
            spread = _around(f.reshape(-1, side.size, side.size), i, j)
            size = np.stack((box[:, 1] - box[:, 0], box[:, 3] - box[:, 2]), axis=1)
            rough = spread > 4.0 * _EPS * np.abs(top)
            active = rough & (np.abs(size) > 1e-16 * np.abs(limit)).any(1)
            active &= top + spread >= self.best
            # What a place that is left may still hide: what is seen around it, or what looking
            # closer has brought of late. At a corner of panels the first need not become small.
            hidden = np.minimum(spread, 4.0 * (top - earlier.min(1)))
            left = ~active
            if left.any():
                self.hidden.append(float((top + hidden)[left].max()))
            if not active.any():
                return
            box = _smaller(box, whole, i, j, side)[active]
            earlier = np.column_stack((earlier[:, 1:], top))[active]
            geometry, code = geometry[active], code[active]
            whole, limit = whole[active], limit[active]
        self.hidden.append(float((top + hidden).max()))

    def result(self) -> Peak:
        """What was found, with its bounds."""
        if self.wo[2] < _LOW * self.c:
            return self._horizon()
        value, error = (float(x[0, 0]) for x in self.lobes.bounded(*self._best()))
        error += max(0.0, *(most - value for most in self.hidden), 0.0)
        return self._peak(value, error, self.wo, self.h)

    def _horizon(self) -> Peak:
        """The limit towards the horizon, at the azimuth where the search ended."""
        turn = math.atan2(self.wo[1], self.wo[0])
        # Where values are not known, the last of these stand above.
        last = max(_HORIZON[-1], self.lobes.lowest / self.c)
        first = max(_HORIZON[0], last * _HORIZON[0] / _HORIZON[1])
        heights = self.c * np.geomspace(first, last, _HORIZON.size)
        across = np.sqrt((1.0 - heights) * (1.0 + heights))
        views = np.column_stack((across * math.cos(turn), across * math.sin(turn), heights))
        value, error = _at(self.lobes, np.tile(self.wi, (heights.size, 1)), views)
        last = np.array([math.cos(turn), math.sin(turn), 0.0])
        if value[-1] > (1.0 + _GROWTH) * value[-2] or not np.isfinite(value[-1]):
            return self._peak(math.inf, math.inf, last, self.wi + last)
        changed = abs(float(value[-1] - value[-2])) + abs(self.best - float(value[-1]))
        return self._peak(float(value[-1]), float(error[-1]) + changed, last, self.wi + last)

    def _peak(self, value: float, error: float, wo: np.ndarray, h: np.ndarray) -> Peak:
        bracket = 0.0
        if math.isfinite(value):
            for f, views, halves in self.seen:
                equal = f >= value - error
                if equal.any():
                    # Half vectors tell directions apart that are close to one another.
                    chord = np.linalg.norm(halves[:, equal] - h[:, None], axis=0)
                    far = np.linalg.norm(views[:, equal] - wo[:, None], axis=0)
                    chord = np.where(far < 1e-7, chord, far)
                    bracket = max(bracket, float(2.0 * np.arcsin(np.minimum(0.5 * chord, 1)).max()))
        # The nodes next to the last one that is equal may be so too.
        bracket = float(min(2.0 * bracket + 4.0 * _EPS, math.pi))
        return Peak(
            value=value,
            error=error,
            direction=wo / np.linalg.norm(wo),
            bracket=bracket,
            cos_view=float(wo[2]),
            angle_from_mirror=self._from_mirror(wo, h),
            at_mirror=self.mirror,
            at_mirror_error=self.mirror_error,
            evaluations=self.lobes.evaluations,
        )

    def _from_mirror(self, wo: np.ndarray, h: np.ndarray) -> float:
        """Angle to R: R - V = (-h_x, -h_y, l_z - v_z), the last from h where that rounds less."""
        across = math.hypot(h[0], h[1])
        height = self.c - wo[2]
        if h[2] * h[2] > across:
            height = -float((2.0 * self.wi[:2] - h[:2]) @ h[:2]) / h[2]
        return 2.0 * math.asin(min(0.5 * math.hypot(across, height), 1.0))


def _inside(nodes: np.ndarray) -> np.ndarray:
    return np.clip(nodes, _MARGIN, 1.0 - _MARGIN)


def _around(f: np.ndarray, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """How much the values next to a node differ from it, for one node of each panel."""
    most = f.shape[1] - 1
    n = np.arange(len(f))
    near = [
        f[n, np.clip(i + a, 0, most), np.clip(j + b, 0, most)]
        for a in (-1, 0, 1)
        for b in (-1, 0, 1)
    ]
    low = np.min([np.where(np.isfinite(x), x, math.inf) for x in near], axis=0)
    differ: np.ndarray = f[n, i, j] - low
    return differ


def _maxima(
    f: np.ndarray, first: int, box: np.ndarray, side: np.ndarray
) -> list[tuple[float, float, int, np.ndarray]]:
    """Local maxima on panels: the most that may be there, the value, the panel and a box."""
    padded = np.pad(f, ((0, 0), (1, 1), (1, 1)), constant_values=-math.inf)
    size = side.size
    shifts = [padded[:, a : a + size, b : b + size] for a in range(3) for b in range(3)]
    top = np.max(shifts, axis=0)
    low = np.min([np.where(np.isfinite(x), x, math.inf) for x in shifts], axis=0)
    k, i, j = np.nonzero((f >= top) & np.isfinite(f) & (f > 0.0))
    # A plateau is seen once.
    reach = 2.0 * f[k, i, j] - low[k, i, j]
    flat = reach <= f[k, i, j]
    if flat.any():
        once = np.unique(k[flat], return_index=True)[1]
        keep = np.concatenate((np.flatnonzero(~flat), np.flatnonzero(flat)[once]))
        k, i, j, reach = k[keep], i[keep], j[keep], reach[keep]
    boxes = _smaller(box[k], box[k], i, j, side)
    return [
        (float(reach[n]), float(f[k[n], i[n], j[n]]), first + int(k[n]), boxes[n])
        for n in range(k.size)
    ]


def _smaller(
    box: np.ndarray, whole: np.ndarray, i: np.ndarray, j: np.ndarray, side: np.ndarray
) -> np.ndarray:
    """Boxes that reach from each node to its neighbours.

    From a node on the edge of its box, but not of the panel, the new box is as large as the old:
    on a ridge across both coordinates the largest value may lie far from the best node.
    """
    new = box.copy()
    last = side.size - 1
    at_edge = np.zeros(i.size, dtype=bool)
    for column, at in ((0, i), (2, j)):
        for node, end in ((0, column), (last, column + 1)):
            at_edge |= (at == node) & (box[:, end] != whole[:, end])
    for column, at in ((0, i), (2, j)):
        low, size = box[:, column], box[:, column + 1] - box[:, column]
        before, after = side[np.maximum(at - 1, 0)], side[np.minimum(at + 1, last)]
        reach = np.where(at_edge, 0.5, np.maximum(after - side[at], side[at] - before)) * size
        centre = low + side[at] * size
        # Boxes may run downwards.
        ends = np.sort(whole[:, column : column + 2], axis=1)
        new[:, column] = np.clip(centre - reach, ends[:, 0], ends[:, 1])
        new[:, column + 1] = np.clip(centre + reach, ends[:, 0], ends[:, 1])
    return new
