r"""Routines that draw directions for a lobe, each with its density.

``draw(wi, u, q, wo, h)`` maps points u of the unit square, of shape (2, rows, columns), to
directions; ``density(wi, wo, h, q, out)`` is their density in 1/sr, on the whole sphere. As in
charts h = wi + wo is formed without cancellation, so that lobes a millionth wide are drawn to all
digits. `q` holds what the routine needs to know, one line for each row.

A half vector with slopes (x, y), H = (x, y, 1)/\sqrt{q}, q = 1 + x^2 + y^2, sends V to
h = 2 (l.(x, y, 1))/q (x, y, 1), and n.v = (2 (l_x x + l_y y) + l_z (1 - x^2 - y^2))/q. A density
p_h of H per solid angle is p_h/(4 l.h) for V (Ashikhmin and Shirley 2000, eq. 20).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from albedo._compile import kernel
from albedo.geometry import cosine_power, mirror_offset2, normal_power
from albedo.microfacet import distribution, hidden_cosine

_PI = math.pi
# Slopes beyond this are those of half vectors in the horizon: no density reaches there.
_STEEPEST = 1e100


@dataclass(frozen=True)
class Routine:
    """A way to draw directions, with what it needs to know.

    Attributes
    ----------
    name : str
        What it draws, in a few words.
    draw, density : callable
        Kernels, see this module.
    numbers : tuple of float
        What the kernels read.
    source : str
        Where it was published.
    """

    name: str
    draw: Callable[..., Any]
    density: Callable[..., Any]
    numbers: tuple[float, ...] = ()
    source: str = ""


@kernel
def _cosine(wi, u, q, wo, h):
    for k in range(wo.shape[1]):
        for i in range(wo.shape[2]):
            s, turn = math.sqrt(u[0, k, i]), 2.0 * _PI * u[1, k, i]
            wo[0, k, i] = s * math.cos(turn)
            wo[1, k, i] = s * math.sin(turn)
            wo[2, k, i] = math.sqrt(1.0 - u[0, k, i])
            for d in range(3):
                h[d, k, i] = wi[d, k] + wo[d, k, i]


@kernel
def _cosine_density(wi, wo, h, q, out):
    for k in range(out.shape[0]):
        for i in range(out.shape[1]):
            out[k, i] = max(wo[2, k, i], 0.0) / _PI


@kernel
def _uniform(wi, u, q, wo, h):
    for k in range(wo.shape[1]):
        for i in range(wo.shape[2]):
            z, turn = 1.0 - u[0, k, i], 2.0 * _PI * u[1, k, i]
            s = math.sqrt(u[0, k, i] * (1.0 + z))
            wo[0, k, i] = s * math.cos(turn)
            wo[1, k, i] = s * math.sin(turn)
            wo[2, k, i] = z
            for d in range(3):
                h[d, k, i] = wi[d, k] + wo[d, k, i]


@kernel
def _uniform_density(wi, wo, h, q, out):
    for k in range(out.shape[0]):
        for i in range(out.shape[1]):
            out[k, i] = 0.5 / _PI if wo[2, k, i] > 0.0 else 0.0


@kernel
def _sphere(wi, u, q, wo, h):
    for k in range(wo.shape[1]):
        for i in range(wo.shape[2]):
            s, turn = 2.0 * math.sqrt(u[0, k, i] * (1.0 - u[0, k, i])), 2.0 * _PI * u[1, k, i]
            wo[0, k, i] = s * math.cos(turn)
            wo[1, k, i] = s * math.sin(turn)
            wo[2, k, i] = 1.0 - 2.0 * u[0, k, i]
            for d in range(3):
                h[d, k, i] = wi[d, k] + wo[d, k, i]


@kernel
def _sphere_density(wi, wo, h, q, out):
    out[:] = 0.25 / _PI


@kernel
def _reflect(x, y, k, i, wi, wo, h):
    """V and L + V for the half vector of slopes x and y."""
    lx, ly, lz = wi[0, k], wi[1, k], wi[2, k]
    tan2 = x * x + y * y
    along = lx * x + ly * y
    twice = 2.0 / (1.0 + tan2)
    z = twice * (along + lz)
    h[0, k, i] = z * x
    h[1, k, i] = z * y
    h[2, k, i] = z
    wo[0, k, i] = z * x - lx
    wo[1, k, i] = z * y - ly
    wo[2, k, i] = twice * (along + 0.5 * lz * (1.0 - tan2))


@kernel
def _four_times_v_dot_h(hx, hy, hz):
    return 2.0 * math.sqrt(hx * hx + hy * hy + hz * hz)


@kernel
def _gaussian_slopes(wi, u, q, wo, h):
    for k in range(wo.shape[1]):
        ax, ay = q[k, 0], q[k, 1]
        for i in range(wo.shape[2]):
            r, turn = math.sqrt(-math.log1p(-u[0, k, i])), 2.0 * _PI * u[1, k, i]
            _reflect(ax * r * math.cos(turn), ay * r * math.sin(turn), k, i, wi, wo, h)


@kernel
def _ggx_slopes(wi, u, q, wo, h):
    for k in range(wo.shape[1]):
        ax, ay = q[k, 0], q[k, 1]
        for i in range(wo.shape[2]):
            r = math.sqrt(u[0, k, i] / (1.0 - u[0, k, i]))
            turn = 2.0 * _PI * u[1, k, i]
            _reflect(ax * r * math.cos(turn), ay * r * math.sin(turn), k, i, wi, wo, h)


@kernel
def _normals_density(wi, wo, h, q, out):
    """D (n.h)/(4 v.h); q has the widths along x and y and the code of the distribution."""
    for k in range(out.shape[0]):
        ax, ay, code = q[k, 0], q[k, 1], int(q[k, 2])
        scale, kx, ky = 1.0 / (_PI * ax * ay), 1.0 / (ax * ax), 1.0 / (ay * ay)
        for i in range(out.shape[1]):
            hx, hy, hz = h[0, k, i], h[1, k, i], h[2, k, i]
            length = math.sqrt(hx * hx + hy * hy + hz * hz)
            out[k, i] = 0.0
            if max(abs(hx), abs(hy)) < _STEEPEST * abs(hz):
                x, y = hx / hz, hy / hz
                d = distribution(code, kx, ky, scale, x * x, y * y)
                out[k, i] = d * (abs(hz) / length) / (2.0 * length)


@kernel
def _powers(wi, u, q, wo, h):
    """AS eqs. 21 and 22, their four quadrants at once.

    tan(phi) = sqrt((n_u + 1)/(n_v + 1)) tan(2 pi u_1), with phi in the quadrant of 2 pi u_1: the
    direction (cos(2 pi u_1), ratio sin(2 pi u_1)), here from the tangent of half the angle past pi.
    """
    for k in range(wo.shape[1]):
        n_u, n_v = q[k, 0], q[k, 1]
        ratio = math.sqrt((n_u + 1.0) / (n_v + 1.0))
        for i in range(wo.shape[2]):
            half = math.tan(_PI * (u[1, k, i] - 0.5))
            x, y = (half - 1.0) * (half + 1.0), -2.0 * ratio * half
            x2, y2 = x * x, y * y
            over = 1.0 / (x2 + y2)
            n = over * (n_u * x2 + n_v * y2)
            t = math.sqrt(over * math.expm1(-2.0 * math.log(1.0 - u[0, k, i]) / (n + 1.0)))
            _reflect(t * x, t * y, k, i, wi, wo, h)


@kernel
def _powers_density(wi, wo, h, q, out):
    for k in range(out.shape[0]):
        n_u, n_v = q[k, 0], q[k, 1]
        scale = math.sqrt((n_u + 1.0) * (n_v + 1.0)) / (2.0 * _PI)
        for i in range(out.shape[1]):
            hx, hy, hz = h[0, k, i], h[1, k, i], h[2, k, i]
            out[k, i] = 0.0
            if max(abs(hx), abs(hy)) < _STEEPEST * abs(hz):
                x2, y2 = (hx / hz) ** 2, (hy / hz) ** 2
                tan2 = x2 + y2
                n = (n_u * x2 + n_v * y2) / tan2 if tan2 > 0.0 else n_u
                out[k, i] = scale * normal_power(tan2, n) / _four_times_v_dot_h(hx, hy, hz)


@kernel
def _about_mirror(wi, u, q, wo, h):
    for k in range(wo.shape[1]):
        lx, ly, lz, n = wi[0, k], wi[1, k], wi[2, k], q[k, 0]
        s = math.sqrt(lx * lx + ly * ly)
        cos_phi, sin_phi = (lx / s, ly / s) if s > 0.0 else (1.0, 0.0)
        for i in range(wo.shape[2]):
            # 1 - cos(a) and sin(a) of the angle a to the mirror direction.
            less = -math.expm1(math.log1p(-u[0, k, i]) / (n + 1.0))
            sine, turn = math.sqrt(less * (2.0 - less)), 2.0 * _PI * u[1, k, i]
            along = less * s + sine * math.cos(turn) * lz
            across = sine * math.sin(turn)
            z = lz * (1.0 - less) + s * math.cos(turn) * sine
            h[0, k, i] = along * cos_phi - across * sin_phi
            h[1, k, i] = along * sin_phi + across * cos_phi
            h[2, k, i] = lz + z
            wo[0, k, i] = h[0, k, i] - lx
            wo[1, k, i] = h[1, k, i] - ly
            wo[2, k, i] = z


@kernel
def _about_mirror_density(wi, wo, h, q, out):
    for k in range(out.shape[0]):
        n = q[k, 0]
        for i in range(out.shape[1]):
            d2 = mirror_offset2(
                *(wi[0, k], wi[1, k], wi[2, k]),
                *(h[0, k, i], h[1, k, i], h[2, k, i], wo[2, k, i]),
            )
            out[k, i] = (n + 1.0) / (2.0 * _PI) * cosine_power(d2, n)


@kernel
def _axis(wi, q, k):
    """The unit axis (c_x l.x, c_y l.y, c_z l.z), or the normal where that is 0."""
    x, y, z = q[k, 0] * wi[0, k], q[k, 1] * wi[1, k], q[k, 2] * wi[2, k]
    length = math.sqrt(x * x + y * y + z * z)
    if length == 0.0:
        return 0.0, 0.0, 1.0
    return x / length, y / length, z / length


@kernel
def _about_axis(wi, u, q, wo, h):
    for k in range(wo.shape[1]):
        ax, ay, az = _axis(wi, q, k)
        n = q[k, 3]
        # A frame about the axis (Duff et al. 2017).
        sign = 1.0 if az >= 0.0 else -1.0
        a = -1.0 / (sign + az)
        b = ax * ay * a
        for i in range(wo.shape[2]):
            less = -math.expm1(math.log1p(-u[0, k, i]) / (n + 1.0))
            sine, turn = math.sqrt(less * (2.0 - less)), 2.0 * _PI * u[1, k, i]
            x, y, z = sine * math.cos(turn), sine * math.sin(turn), 1.0 - less
            wo[0, k, i] = x * (1.0 + sign * ax * ax * a) + y * b + z * ax
            wo[1, k, i] = x * sign * b + y * (sign + ay * ay * a) + z * ay
            wo[2, k, i] = -x * sign * ax - y * ay + z * az
            for d in range(3):
                h[d, k, i] = wi[d, k] + wo[d, k, i]


@kernel
def _about_axis_density(wi, wo, h, q, out):
    for k in range(out.shape[0]):
        ax, ay, az = _axis(wi, q, k)
        n = q[k, 3]
        for i in range(out.shape[1]):
            vx, vy, vz = wo[0, k, i], wo[1, k, i], wo[2, k, i]
            d2 = (ax - vx) ** 2 + (ay - vy) ** 2 + (az - vz) ** 2
            out[k, i] = (n + 1.0) / (2.0 * _PI) * cosine_power(d2, n)


@kernel
def _visible_density(wi, wo, h, q, out):
    """D G_1(l)/(4 n.l) (Heitz 2014, eq. 17); q as for `_normals_density`."""
    for k in range(out.shape[0]):
        ax, ay, code = q[k, 0], q[k, 1], int(q[k, 2])
        scale, kx, ky = 1.0 / (_PI * ax * ay), 1.0 / (ax * ax), 1.0 / (ay * ay)
        lx, ly, lz = wi[0, k], wi[1, k], wi[2, k]
        # n.l (1 + Lambda) stays a number at grazing incidence.
        seen = 0.25 / (lz + hidden_cosine(2, code, ax * ax, ay * ay, lx, ly, lz))
        for i in range(out.shape[1]):
            hx, hy, hz = h[0, k, i], h[1, k, i], h[2, k, i]
            out[k, i] = 0.0
            if hz > 0.0 and max(abs(hx), abs(hy)) < _STEEPEST * hz:
                x, y = hx / hz, hy / hz
                out[k, i] = seen * distribution(code, kx, ky, scale, x * x, y * y)


@kernel
def _visible_ggx(wi, u, q, wo, h):
    """Visible normals as a cap of the sphere (Dupuy and Benyoub 2023)."""
    for k in range(wo.shape[1]):
        ax, ay = q[k, 0], q[k, 1]
        x, y, z = ax * wi[0, k], ay * wi[1, k], wi[2, k]
        length = math.sqrt(x * x + y * y + z * z)
        x, y, z = x / length, y / length, z / length
        rest = (x * x + y * y) / (1.0 + z)  # 1 - z
        for i in range(wo.shape[2]):
            turn, left = 2.0 * _PI * u[1, k, i], 1.0 - u[0, k, i]
            up = left * (1.0 + z)  # the height of the point, and z
            s = math.sqrt(u[0, k, i] * (1.0 + z) * (up + rest))
            sx, sy = (s * math.cos(turn) + x) / up, (s * math.sin(turn) + y) / up
            _reflect(ax * sx, ay * sy, k, i, wi, wo, h)


@kernel
def _inverse_erf(p):
    """The x with erf(x) = p, by Winitzki's approximation and Newton's and Halley's steps."""
    if p <= -1.0 or p >= 1.0:
        return math.copysign(6.0, p)
    t = math.log1p(-p * p)
    a = 2.0 / (_PI * 0.147) + 0.5 * t
    x = math.copysign(math.sqrt(max(math.sqrt(a * a - t / 0.147) - a, 0.0)), p)
    for _ in range(3):
        error = (math.erf(x) - p) * math.sqrt(_PI) * 0.5 * math.exp(x * x)
        x -= error / (1.0 + x * error)
    return x


@kernel
def _visible_slope(share, cot):
    """The slope s < cot, in the plane of incidence, below which this share of all visible ones is.

    (1 + erf(s)) cot + exp(-s^2)/sqrt(pi) is the share that is not normalised, by a safe Newton
    method (Heitz and d'Eon 2014, with the slope itself as unknown).
    """
    low, high = -6.0, min(cot, 6.0)
    whole = cot * (1.0 + math.erf(high)) + math.exp(-high * high) / math.sqrt(_PI)
    s = min(0.0, high)
    for _ in range(60):
        e = math.exp(-s * s)
        miss = cot * (1.0 + math.erf(s)) + e / math.sqrt(_PI) - share * whole
        if miss > 0.0:
            high = s
        else:
            low = s
        slope = 2.0 * e / math.sqrt(_PI) * (cot - s)
        step = miss / slope if slope > 0.0 else math.inf
        if abs(step) < 1e-14 or high - low < 1e-14:
            break
        s -= step
        if not low < s < high:
            s = 0.5 * (low + high)
    return s


@kernel
def _visible_beckmann(wi, u, q, wo, h):
    for k in range(wo.shape[1]):
        ax, ay = q[k, 0], q[k, 1]
        x, y = ax * wi[0, k], ay * wi[1, k]
        s = math.sqrt(x * x + y * y)
        steep = s < 1e-9 * wi[2, k]
        cos_phi, sin_phi = (1.0, 0.0) if steep else (x / s, y / s)
        for i in range(wo.shape[2]):
            if steep:
                r, turn = math.sqrt(-math.log1p(-u[0, k, i])), 2.0 * _PI * u[1, k, i]
                along, across = r * math.cos(turn), r * math.sin(turn)
            else:
                along = -_visible_slope(u[0, k, i], wi[2, k] / s)
                across = _inverse_erf(2.0 * u[1, k, i] - 1.0)
            x = ax * (along * cos_phi - across * sin_phi)
            y = ay * (along * sin_phi + across * cos_phi)
            _reflect(x, y, k, i, wi, wo, h)


COSINE = Routine("cosine", _cosine, _cosine_density, (), "Malley")
UNIFORM = Routine("uniform", _uniform, _uniform_density)
SPHERE = Routine("uniform over the sphere", _sphere, _sphere_density)


def gaussian_normals(alpha_x: float, alpha_y: float) -> Routine:
    """Half vectors with Gaussian slopes: Beckmann's normals, and Ward's."""
    numbers = (alpha_x, alpha_y, 0.0)
    source = "Walter 2005; Walter et al. 2007, eq. 28"
    return Routine("Beckmann normals", _gaussian_slopes, _normals_density, numbers, source)


def ggx_normals(alpha_x: float, alpha_y: float) -> Routine:
    """Half vectors with GGX slopes."""
    numbers = (alpha_x, alpha_y, 1.0)
    source = "Walter et al. 2007, eq. 35"
    return Routine("GGX normals", _ggx_slopes, _normals_density, numbers, source)


def visible_normals(distribution: str, alpha_x: float, alpha_y: float) -> Routine:
    """Half vectors as the light sees them, for `beckmann` or `ggx` with Smith's masking."""
    if distribution == "ggx":
        numbers, draw, source = (alpha_x, alpha_y, 1.0), _visible_ggx, "Dupuy and Benyoub 2023"
    else:
        numbers, draw = (alpha_x, alpha_y, 0.0), _visible_beckmann
        source = "Heitz and d'Eon 2014"
    label = "GGX" if distribution == "ggx" else "Beckmann"
    return Routine(f"visible {label} normals", draw, _visible_density, numbers, source)


def normal_powers(n_u: float, n_v: float) -> Routine:
    """Half vectors with the density (n.h)^(n_u cos^2 + n_v sin^2) per solid angle."""
    source = "Ashikhmin and Shirley 2000, eqs. 21 and 22"
    return Routine("powers of n.h", _powers, _powers_density, (n_u, n_v), source)


def mirror_power(n: float) -> Routine:
    """Directions with the density (r.v)^n about the mirror direction r."""
    source = "Lafortune and Willems 1994"
    return Routine("power of r.v", _about_mirror, _about_mirror_density, (n,), source)


def axis_power(c: tuple[float, float, float], n: float) -> Routine:
    """Directions with the density (a.v)^n about a = (c_x l.x, c_y l.y, c_z l.z), normalised."""
    source = "Lafortune et al. 1997"
    return Routine("power of a.v", _about_axis, _about_axis_density, (*c, n), source)
