"""Stam 1999: diffraction by a grating, an optically thin relief with a period along the tangent."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np

from albedo._compile import kernel
from albedo.brdf import Choice, Part, Real
from albedo.catalogue._fresnel import SOURCES_OF_FACTORS, FresnelChoice
from albedo.charts.orders import REACH, OrdersChart
from albedo.errors import InputError
from albedo.fresnel import fill_factors, fresnel
from albedo.geometry import one_less_v_dot_h, v_dot_h
from albedo.special import bessel_j

_EPS = np.finfo(np.float64).eps
# Orders beside the mirror direction, on each side: bounds the memory that a direction takes.
_MOST_ORDERS = 4000
# Heights in waves: up to this argument the Bessel functions were measured.
_MOST_PHASE = 1e5
# -ln of a number that is 0, and orders beyond the last that carries something for any phase.
_VANISHED, _FARTHEST = 760.0, 200_000
# In widths, from where on the root of a Gaussian is 0.
_FAR = math.sqrt(4.0 * _VANISHED)
_ROOT = math.sqrt(2.0 * math.pi)


def strengths(n: np.ndarray, phase: np.ndarray, duty: np.ndarray) -> np.ndarray:
    """|c_n|^2 of orders n, for phases k w depth in radians.

    `duty` is the share of bars in the period of a lamellar relief, and nan for a sinusoid.
    """
    n, phase, duty = np.broadcast_arrays(n, phase, duty)
    sinusoid, value = np.isnan(duty), np.empty(n.shape)
    if sinusoid.any():
        value[sinusoid] = bessel_j(n[sinusoid], 0.5 * phase[sinusoid]) ** 2
    if not sinusoid.all():
        swing, sine, spread = _lamellar(*(x[~sinusoid] for x in (n, phase, duty)))
        q = duty[~sinusoid]
        # |c_0|^2 = 1 - 4 q (1 - q) sin(psi/2)^2; beside 1 nothing is gained by another form.
        middle = np.maximum(1.0 - q * (1.0 - q) * swing, 0.0)
        value[~sinusoid] = np.where(n[~sinusoid] == 0, middle, swing * sine * sine * spread)
    return value


def _lamellar(
    n: np.ndarray, phase: np.ndarray, duty: float | np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """4 sin(psi/2)^2, sin(pi n q) and 1/(pi n)^2."""
    swing = 4.0 * np.sin(0.5 * phase) ** 2
    sine = np.sin(math.pi * np.remainder(n * duty, 1.0))
    return swing, sine, 1.0 / (math.pi * np.where(n == 0, 1, n)) ** 2


def strength_errors(n: np.ndarray, phase: np.ndarray, duty: float, moved: np.ndarray) -> np.ndarray:
    """Bounds on the errors of `strengths`, for phases with the errors `moved`."""
    if math.isnan(duty):
        z = 0.5 * phase
        j = np.abs(bessel_j(n, z))
        slope = 0.5 * np.abs(bessel_j(n - 1, z) - bessel_j(n + 1, z))
        # Measured up to z = 1e5: less than 17 roundings of z and of the value.
        error = 20.0 * _EPS * (j + z * slope) + 0.5 * moved * slope
        return (2.0 * j + error) * error
    swing, sine, spread = _lamellar(n, phase, duty)
    swing_error = (2.0 * np.sqrt(swing) + moved) * moved + 8.0 * _EPS * swing
    # n q is rounded, and the remainder keeps what that moved.
    sine_error = math.pi * _EPS * np.abs(n) * duty + 4.0 * _EPS * np.abs(sine)
    side = 8.0 * _EPS * swing * sine * sine + swing_error * sine * sine
    side += (swing + swing_error) * (2.0 * np.abs(sine) + sine_error) * sine_error
    middle = duty * (1.0 - duty) * (swing_error + 2.0 * _EPS * swing) + _EPS
    return np.where(n == 0, middle, spread * side)


@kernel
def vanishes(n, z):
    """Whether J_n(x)^2, n >= 0, is below all numbers for x <= z: |J_n(x)| <= (e x/(2 n))^n."""
    return n > z and (z == 0.0 or 2.0 * n * (math.log(2.0 * n / z) - 1.0) > _VANISHED)


@cache
def _last_order(z: float) -> int:
    """The last order that carries something for arguments up to z."""
    return bisect_left(range(_FARTHEST), True, key=lambda n: bool(vanishes(n, z)))


def fill(wi: np.ndarray, wo: np.ndarray, h: np.ndarray, p: np.ndarray, out: np.ndarray) -> None:
    """f = F (1 + l.v)^2/(w^2 n.l n.v) sum of |c_n|^2 G(u - n lambda/d, v), (u, v) from l + v.

    G is a normalised Gaussian in both; 1 + l.v = 2 (v.h)^2. In numpy: its Bessel functions are.
    """
    step, wave, duty, sigma = (p[:, i, None] for i in range(4))
    lz, vz, (u, v, w) = wi[2][:, None], wo[2], h
    nearest = np.rint(u / step)
    total = np.zeros_like(w)
    v_h = np.minimum(0.5 * np.hypot(np.hypot(u, v), w), 1.0)
    # All orders but the mirror's vanish as w does: over w they are what they are at any small w.
    some = np.maximum(w, 1e-100)
    reach = math.ceil(REACH * float((sigma / step).max()))
    last = np.array([_last_order(z) for z in wave.ravel().tolist()])[:, None]
    last = np.where(np.isnan(duty), last, math.inf)
    above = (lz > 0.0) & (vz > 0.0)
    cosines = np.sqrt(np.where(lz > 0.0, lz, 1.0)) * np.sqrt(np.where(vz > 0.0, vz, 1.0))
    factor = np.empty(w.shape)
    away = sum((x - y) ** 2 for x, y in zip((wi[0][:, None], wi[1][:, None], lz), wo, strict=True))
    less = 0.25 * away / (1.0 + v_h)
    for code in np.unique(p[:, 4]).tolist():
        rows = p[:, 4] == code
        found = np.empty(v_h[rows].size)
        numbers = (np.repeat(p[rows, i], w.shape[1]) for i in (5, 6, 7))
        fill_factors(int(code), *numbers, v_h[rows].ravel(), less[rows].ravel(), found)
        factor[rows] = found.reshape(-1, w.shape[1])
    # Before it is squared: the square may be beyond all numbers where the value is not.
    scale = np.sqrt(factor) / (_ROOT * sigma)
    columns = (np.broadcast_to(x, w.shape) for x in (step, sigma, wave * some, duty))
    step, sigma, phase, shape = columns
    most = float(last.max(initial=0.0))
    few = most < reach
    for k in range(-int(most), int(most) + 1) if few else range(-reach, reach + 1):
        n = np.full(w.shape, float(k)) if few else nearest + k
        seen = np.abs(n) <= last
        away = (u[seen] - n[seen] * step[seen]) / sigma[seen]
        # The root of a Gaussian: it may be below all numbers though what it is over brings it back.
        height = np.exp(-0.25 * (away**2 + (v[seen] / sigma[seen]) ** 2))
        if np.any(height > 0.0):
            mirror = n[seen] == 0
            root = np.sqrt(strengths(n[seen], phase[seen], shape[seen])) * height
            with np.errstate(over="ignore", invalid="ignore"):
                straight = 2.0 * v_h[seen] * (v_h[seen] / np.where(mirror, w[seen], some[seen]))
                part = root * (straight / cosines[seen] * scale[seen])
                total[seen] += np.where(root > 0.0, part * part, 0.0)
    out[:] = np.where(above & (total > 0.0), total, 0.0)


@kernel
def strength(n, phase, duty):
    """One of `strengths`."""
    if math.isnan(duty):
        j = bessel_j(n, 0.5 * phase)
        return j * j
    sine = math.sin(0.5 * phase)
    if n == 0:
        return 1.0 - 4.0 * duty * (1.0 - duty) * sine * sine
    turns = n * duty
    off = 2.0 * sine * math.sin(math.pi * (turns - math.floor(turns))) / (math.pi * n)
    return off * off


@kernel
def formula(wi, wo, h, p, out):
    """What `fill` does, one pair of directions at a time."""
    for j in range(out.shape[0]):
        step, wave, duty, sigma, lz = p[j, 0], p[j, 1], p[j, 2], p[j, 3], wi[2, j]
        reach = int(REACH * sigma / step) + 1
        # J_n of a small phase is over a small w: what carries something counts for the largest.
        sinusoid, last, below = math.isnan(duty), _FARTHEST, -1
        while sinusoid and last - below > 1:
            between = (last + below) // 2
            if vanishes(between, wave):
                last = between
            else:
                below = between
        # Where few orders carry anything all are summed, otherwise those that are near.
        few = sinusoid and last < reach
        for i in range(out.shape[1]):
            u, v, w, vz = h[0, j, i], h[1, j, i], h[2, j, i], wo[2, j, i]
            if min(lz, vz) <= 0.0:
                out[j, i] = 0.0
                continue
            nearest = int(u / step + (0.5 if u >= 0.0 else -0.5))
            # The root of a Gaussian farther away is 0.
            side = min(reach if not few else _FARTHEST, int(_FAR * sigma / step) + 1)
            total = 0.0
            for n in range(max(nearest - side, -last), min(nearest + side, last) + 1):
                x, y = (u - n * step) / sigma, v / sigma
                total += strength(n, wave * w, duty) * math.exp(-0.5 * (x * x + y * y))
            v_h = v_dot_h(u, v, w)
            straight = 2.0 * v_h * (v_h / w)
            less = one_less_v_dot_h(wi[0, j], wi[1, j], lz, wo[0, j, i], wo[1, j, i], vz, v_h)
            factor = fresnel(p[j, 4], p[j, 5], p[j, 6], p[j, 7], v_h, less)
            value = factor * total * straight * straight / (2.0 * math.pi * sigma * sigma)
            out[j, i] = value / lz / vz


class StamGrating(FresnelChoice):
    """Orders V_n = (-l.x + n lambda/d, -l.y), each with F |c_n|^2 (1 + l.V_n)^2/(w^2 n.l n.V_n).

    Here w = n.l + n.V_n, and c_n is the Fourier coefficient of exp(i k w height(x)) for
    k = 2 pi/lambda (Stam 1999). ``sinusoid`` is a relief of height depth/2 cos(2 pi x/d): |c_n|^2
    is J_n(k w depth/2)^2. ``lamellar`` has bars of the given depth over the share `duty` of the
    period: with psi = k w depth, c_0 = 1 - duty + duty e^(i psi) and |c_n|^2 =
    4 sin(psi/2)^2 sin(pi n duty)^2/(pi n)^2. Orders outside the unit disk stay in the surface.

    The orders are Dirac parts: the albedo is their sum. Each has its share of the energy with an
    error of its own, which grows where the order leaves near the horizon, for the directions and
    wavelengths of Rayleigh's anomalies; where rounding decides whether it leaves at all, the bound
    is infinite. This is Kirchhoff's theory without shadowing: shares grow as 1/(n.l n.V_n) towards
    grazing directions. The primary text was out of reach; the Gaussian surface of the same theory
    fixes the constant.

    With ``coherence`` each order is a lobe, a Gaussian in (v.x, v.y) of standard deviation
    lambda/(2 pi coherence) whose integral is 1, and the factors are those of V itself.
    """

    name = "stam_grating"
    title = "Stam's diffraction grating"
    equation = "after Stam 1999"
    references = ("stam1999", *SOURCES_OF_FACTORS)
    tables = ("depth=0.02..0.5/16", "depth=0.02..0.5/16,profile=lamellar")
    domain = "depth=0.001..1/13log,period=0.31..31/9log"
    as_lobes = "coherence=0.3..300/9log"
    conserves_energy = False
    grazing_limit = False

    period = Real(1.6, "period d along the tangent", "um", low=1e-2, high=1e4)
    depth = Real(0.15, "height from valley to crest", "um", low=0.0, high=1e3)
    duty = Real(0.5, "lamellar: share of the period that is raised", low=0.0, high=1.0)
    profile = Choice("sinusoid", "shape of the relief", choices=("sinusoid", "lamellar"))
    wavelength = Real(0.5, "wavelength of the light", "um", low=1e-2, high=1e3)
    coherence = Real(None, "length over which orders form; none: all", "um", low=0.1, high=1e3)

    def __init__(self, /, **values: Any) -> None:
        super().__init__(**values)
        most = _MOST_ORDERS * self.wavelength / 2.0
        if self.period > most:
            raise InputError(
                f"{self.name}: period = {self.period:g} is out of range; at wavelength = "
                f"{self.wavelength:g} it must lie in [0.01, {most:g}]"
            )
        most = 0.25 * _MOST_ORDERS
        if self._sigma is not None and self._orders_in_lobe() > most:
            low = REACH * self.period / (2.0 * math.pi * most)
            raise InputError(
                f"{self.name}: coherence = {self.coherence:g} is out of range; of period = "
                f"{self.period:g} it must be at least {low:.4g}"
            )
        most = _MOST_PHASE * self.wavelength / (4.0 * math.pi)
        if self.depth > most:
            raise InputError(
                f"{self.name}: depth = {self.depth:g} is out of range; at wavelength = "
                f"{self.wavelength:g} it must lie in [0, {most:g}]"
            )

    def used(self, values: Mapping[str, Any]) -> tuple[str, ...]:
        """What the Fresnel factor and the shape of the relief need."""
        needed = {*super().used(values), "wavelength"}
        if values["profile"] != "lamellar":
            needed.discard("duty")
        return tuple(name for name in values if name in needed)

    @property
    def isotropic(self) -> bool:
        """Whether nothing leaves but the mirror order, whose share knows no azimuth."""
        flat = self.depth == 0.0 or self.parameters.get("duty", 0.5) in (0.0, 1.0)
        return flat or (self._sigma is None and 2.0 * self.period <= self.wavelength)

    @property
    def _sigma(self) -> float | None:
        """Standard deviation of the orders."""
        length = self.parameters.get("coherence")
        return None if length is None else self.wavelength / (2.0 * math.pi * length)

    def _orders_in_lobe(self) -> float:
        """How many orders on each side a direction has something of."""
        assert self._sigma is not None
        inside = REACH * self._sigma * self.period / self.wavelength
        flat = self.profile == "lamellar"
        return inside if flat else min(inside, _last_order(self.pack()[1]))

    def pack(self) -> tuple[float, ...]:
        wave = 2.0 * math.pi / self.wavelength * self.depth
        duty = self.parameters.get("duty", math.nan)
        step = self.wavelength / self.period
        return (step, wave, duty, self._sigma or 0.0, *self.pack_fresnel())

    def parts(self) -> tuple[Part, ...]:
        sigma = self._sigma
        if sigma is None:
            return ()
        chart = OrdersChart(self.wavelength / self.period, sigma)
        return (Part("orders", fill, chart, (sigma, sigma), formula=formula),)

    def spikes(self, wi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if self._sigma is not None:
            return super().spikes(wi)
        directions, weights, _ = self._orders(wi)
        return directions, weights

    def spike_errors(self, wi: np.ndarray, weights: np.ndarray) -> np.ndarray:
        return super().spike_errors(wi, weights) if self._sigma else self._orders(wi)[2]

    def _orders(self, wi: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Directions (k, n, 3) of orders, their shares of the energy (k, n) and errors of these."""
        step = self.wavelength / self.period
        reach = math.floor(2.0 / step) + 1
        n = np.arange(-reach, reach + 1)[:, None]
        lx, ly, lz = wi.T
        g = n * step
        # (n.v)^2 = 1 - v.x^2 - v.y^2 without the differences of squares; sums of a few roundings.
        squared = lz * lz + g * (2.0 * lx - g)
        moved = _EPS * (2.0 * lz * lz + np.abs(g) * (6.0 * np.abs(lx) + 4.0 * np.abs(g)))
        leaves = squared > 0.0
        nv = np.sqrt(np.where(leaves, squared, 1.0))
        # Relative error of n.v; at one eighth nothing is known of the order.
        nv_error = 0.5 * moved / (nv * nv)
        w = lz + nv
        # l + v is (g, 0, w), so 1 + l.v = (g^2 + w^2)/2 and v.h = |l + v|/2.
        whole = g * g + w * w
        share = whole * whole / (4.0 * w * w * lz * nv)
        # No derivative of its logarithm by that of n.v exceeds 1 + 4 + 2.
        share_error = 16.0 * _EPS + 7.0 * nv_error
        u = np.minimum(0.5 * np.sqrt(whole), 1.0)
        factor = self.fresnel_factor(u)
        other = self.fresnel_factor(u * (1.0 - 4.0 * _EPS - nv_error))
        factor_error = np.abs(factor - other) + 8.0 * _EPS * factor
        phase = 2.0 * math.pi / self.wavelength * self.depth * w
        duty = self.parameters.get("duty", math.nan)
        moved_phase = phase * (4.0 * _EPS + nv_error * nv / w)
        strength = strengths(n, phase, np.array(duty))
        strength_error = strength_errors(n, phase, duty, moved_phase)
        weights = share * factor * strength
        errors = share * (factor_error * strength + factor * strength_error) + share_error * weights
        unknown = np.abs(squared) <= 4.0 * moved
        # An order that carries nothing may leave or not.
        doubtful = unknown & (strength + strength_error > 0.0)
        errors = np.where(doubtful, np.inf, np.where(leaves & ~unknown, errors, 0.0))
        directions = np.stack(np.broadcast_arrays(g - lx, -ly, nv), axis=-1)
        directions[~leaves] = (0.0, 0.0, 1.0)
        return directions, np.where(leaves & ~unknown, weights, 0.0), errors
