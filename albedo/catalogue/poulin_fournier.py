"""Poulin and Fournier 1990: parallel cylinders on a floor, as grooves or threads."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from albedo._compile import kernel
from albedo.brdf import Choice, Model, Part, Real
from albedo.catalogue.blinn import normalization
from albedo.charts.groove import GrooveChart
from albedo.errors import InputError
from albedo.geometry import log_secant2, normal_root

# Gauss-Legendre rule on [0, 1] for each half of an arc; its error is below 1e-15 for e <= 1000.
_X, _W = np.polynomial.legendre.leggauss(32)
_NODES, _WEIGHTS = 0.5 * (_X + 1.0), 0.5 * _W
# An arc is cut where the lobe is below exp(-46) = 1e-20 of its largest value there.
_FOLDS = 46.0
# Below this exponent the root of (n.h)^e, where L and V both graze, is smoothed by t = x^4.
_ROOT = 8.0


@kernel
def seen(y, z, spacing, cap):
    """What a direction sees of a cap, and how it stands: height, its sine, and both ends.

    The ends are angles from the top, away from the direction's own side and towards it.
    """
    eta, sin_eta = math.atan2(z, abs(y)), z / math.hypot(y, z)
    towards = cap
    if eta < cap:
        limit = 2.0 * math.asin(math.sqrt(min(0.5 * spacing * sin_eta, 1.0)))
        towards = min(cap, limit - eta)
    return eta, sin_eta, min(eta, cap), towards


@kernel
def dark(eta, sin_eta, cap):
    """Length of the shadow of a cylinder on the floor: (1 - f cos(eta))/sin(eta) - w."""
    if eta >= cap:
        return 0.0
    x = math.sin(0.5 * (cap - eta))
    return 2.0 * x * x / sin_eta


@kernel
def overlap(lx, ly, lz, vx, vy, vz, spacing, cap):
    """What L and V both see: heights and sines, the two ends of the arc, the floor's length."""
    eta_l, sin_l, away_l, towards_l = seen(ly, lz, spacing, cap)
    eta_v, sin_v, away_v, towards_v = seen(vy, vz, spacing, cap)
    dark_l, dark_v = dark(eta_l, sin_l, cap), dark(eta_v, sin_v, cap)
    floor = spacing - 2.0 * math.sin(cap)
    if ly * vy >= 0.0:
        away, towards = min(away_l, away_v), min(towards_l, towards_v)
        floor -= max(dark_l, dark_v)
    else:
        away, towards = min(away_l, towards_v), min(towards_l, away_v)
        floor -= dark_l + dark_v
    return eta_l, sin_l, eta_v, sin_v, away, towards, max(floor, 0.0)


@kernel
def arc_diffuse(start_l, other, arc, same):
    """The integral of (n.l)(n.v)/(|l_p||v_p|) over an arc, without cancellation.

    n.l is sin(start_l + t); n.v is sin(other + t), or sin(other + arc - t) on opposite sides.
    """
    less = arc - math.sin(arc)
    if arc < 0.3:
        a2 = arc * arc
        less = arc * a2 / 6.0 * (1.0 - a2 / 20.0 * (1.0 - a2 / 42.0 * (1.0 - a2 / 72.0)))
        less += arc * a2 * a2 * a2 * a2 * a2 / 39916800.0
    turn = math.cos(start_l - other) if same else -math.cos(start_l + other + arc)
    middle = math.sin(start_l + 0.5 * arc) * math.sin(other + 0.5 * arc)
    return max(0.5 * less * turn + math.sin(arc) * middle, 0.0)


@kernel
def arc_specular(start_l, up_l, start_v, up_v, start_h, arc, e, log_scale):
    """The same integral with the factor (n.h)^e = exp(e log_scale) sin(start_h + t)^e.

    t is counted from the end where H, in the plane, is lower; n.l and n.v are sin(start + t), or
    sin(start + arc - t) where they do not go up with t.
    """
    # Where the lobe is largest on the arc, and where it has fallen so far that nothing counts.
    peak = min(max(0.5 * math.pi - start_h, 0.0), arc)
    largest = min(max(math.sin(start_h + peak), 1e-300), 1.0)
    wide = math.acos(largest * math.exp(-_FOLDS / max(e, 1e-2)))
    first = max(0.0, 0.5 * math.pi - wide - start_h)
    last = min(arc, 0.5 * math.pi + wide - start_h)
    middle = peak if first < peak < last else 0.5 * (first + last)
    total = 0.0
    for half in range(2):
        low, high = (first, middle) if half == 0 else (middle, last)
        for i in range(_NODES.size):
            x, weight = _NODES[i], _WEIGHTS[i]
            if e < _ROOT:
                y = x if half == 0 else 1.0 - x
                weight *= 4.0 * y * y * y
                x = y**4 if half == 0 else 1.0 - y**4
            t = low + (high - low) * x
            n_l = math.sin(start_l + (t if up_l else arc - t))
            n_v = math.sin(start_v + (t if up_v else arc - t))
            n_h = math.sin(start_h + t)
            if n_h > 0.0:
                lobe = math.exp(e * (math.log(n_h) + log_scale))
                total += weight * (high - low) * n_l * n_v * lobe
    return max(total, 0.0)


@kernel
def fill_diffuse(wi, wo, h, p, out):
    """f = rho/(pi D) (I/(sin(eta_l) sin(eta_v)) + floor), I over the arc that L and V share."""
    for j in range(out.shape[0]):
        spacing, cap, rho = p[j, 0], p[j, 1], p[j, 2]
        lx, ly, lz = wi[0, j], wi[1, j], wi[2, j]
        for i in range(out.shape[1]):
            vx, vy, vz = wo[0, j, i], wo[1, j, i], wo[2, j, i]
            if vz <= 0.0:
                out[j, i] = 0.0
                continue
            eta_l, sin_l, eta_v, sin_v, away, towards, floor = overlap(
                lx, ly, lz, vx, vy, vz, spacing, cap
            )
            same = ly * vy >= 0.0
            other = eta_v - away if same else eta_v - towards
            arc = arc_diffuse(eta_l - away, other, away + towards, same)
            out[j, i] = rho / (math.pi * spacing) * (arc / sin_l / sin_v + floor)


@kernel
def fill_specular(wi, wo, h, p, out):
    """f = k_s/D (I/(sin(eta_l) sin(eta_v)) + (N.h)^e floor), I with the factor (n.h)^e."""
    for j in range(out.shape[0]):
        spacing, cap, e, k_s = p[j, 0], p[j, 1], p[j, 3], p[j, 4]
        lx, ly, lz = wi[0, j], wi[1, j], wi[2, j]
        for i in range(out.shape[1]):
            vx, vy, vz = wo[0, j, i], wo[1, j, i], wo[2, j, i]
            if vz <= 0.0:
                out[j, i] = 0.0
                continue
            eta_l, sin_l, eta_v, sin_v, away, towards, floor = overlap(
                lx, ly, lz, vx, vy, vz, spacing, cap
            )
            same = ly * vy >= 0.0
            other = eta_v - away if same else eta_v - towards
            hx, hy, hz = h[0, j, i], h[1, j, i], h[2, j, i]
            log_scale = -0.5 * log_secant2(hx, 0.0, math.hypot(hy, hz))
            # Sides are L's; V's where L stands upright.
            side = 1.0 if ly > 0.0 or (ly == 0.0 and vy >= 0.0) else -1.0
            with_l = side * hy >= 0.0
            start_h = math.atan2(hz, abs(hy)) - (away if with_l else towards)
            arc = arc_specular(
                *(eta_l - away, with_l, other, with_l == same),
                *(start_h, away + towards, e, log_scale),
            )
            root = normal_root(hx, hy, hz, e)
            out[j, i] = k_s / spacing * (arc / sin_l / sin_v + root * root * floor)


class PoulinFournier(Model):
    """f = 1/(D n.l n.v) (int f_c (n.l)(n.v) dphi + f_c N.l N.v floor) (Poulin and Fournier 1990).

    Cylinders of radius 1 lie along the tangent, their axes D apart and a height f below a floor
    that hides what is lower. The integral runs over the normals n of a cylinder that both
    directions see; ``floor`` is the length of the floor that both see, from one cylinder to the
    next. Light is reflected once.

    The primary text is out of reach but for its abstract: this section, its shadows and its
    visible lengths are our own reconstruction of the geometry that is described there. So is the
    choice that floor and cylinders are of one material, f_c = rho/pi or f_c = k_s (n.h)^e. The
    caps must not overlap, D >= 2 sqrt(1 - f^2); D >= 2 keeps whole cylinders apart. The paper
    approximates the specular integral by a Chebyshev polynomial; here it is a Gauss-Legendre
    rule of 64 nodes, exact to a few roundings for e <= 1000.
    """

    name = "poulin_fournier"
    title = "Poulin-Fournier cylinders"
    equation = "after Poulin and Fournier 1990"
    references = ("poulin1990",)
    tables = ("rho=0.5,spacing=2..6/16,floor_height=0.3",)
    domain = "spacing=2..12/21"

    spacing = Real(3.0, "distance D of the axes, in radii", low=0.01, high=1e4)
    floor_height = Real(0.5, "height f of the floor above the axes, in radii", high=0.9999)
    base = Choice("lambert", "material f_c", choices=("lambert", "specular"))
    rho = Real(1.0, "lambert: albedo of cylinders and floor", high=1.0)
    e = Real(20.0, "specular: exponent of n.h", high=1000.0)
    k_s = Real(1.0, "specular: coefficient", high=100.0)

    def __init__(self, /, **values: Any) -> None:
        super().__init__(**values)
        if self.spacing < 2.0 * math.sin(self._cap) * (1.0 - 1e-15):
            raise InputError(
                f"{self.name}: spacing = {self.spacing:g} is out of range; with floor_height = "
                f"{self.floor_height:g} it must be at least {2.0 * math.sin(self._cap):g}, so "
                "that cylinders do not overlap"
            )

    def used(self, values: Mapping[str, Any]) -> tuple[str, ...]:
        material = ("rho",) if values["base"] == "lambert" else ("e", "k_s")
        return ("spacing", "floor_height", "base", *material)

    @property
    def _cap(self) -> float:
        """The angle acos(f) from the top of a cylinder to the floor."""
        return 2.0 * math.asin(math.sqrt(0.5 * (1.0 - self.floor_height)))

    @property
    def isotropic(self) -> bool:
        """What reflects nothing is."""
        return (self.rho if self.base == "lambert" else self.k_s) == 0.0

    @property
    def conserves_energy(self) -> bool:  # type: ignore[override]
        """All do whose material does: lambert, and k_s up to the constant of Blinn's lobe."""
        return self.base == "lambert" or self.k_s <= normalization(self.e)

    def pack(self) -> tuple[float, ...]:
        if self.base == "lambert":
            return (self.spacing, self._cap, self.rho, 0.0, 0.0)
        return (self.spacing, self._cap, 0.0, self.e, self.k_s)

    def parts(self) -> tuple[Part, ...]:
        # What the chart reads as widths: the spacing, and the elevation of the tops.
        section = (self.spacing, 1.0 - self.floor_height)
        if self.base == "lambert":
            return (Part("diffuse", fill_diffuse, GrooveChart(), section),)
        # Rounded to a power of 2, so that many exponents share a chart.
        width = 2.0 ** -round(0.5 * math.log2(max(self.e, 1.0)))
        return (Part("specular", fill_specular, GrooveChart(width), section),)
