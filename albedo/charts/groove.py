r"""Groove chart: the angle in the plane across grooves along x, and the angle out of that plane.

Across the grooves lies the plane of y and z. The part of V in that plane has the height eta above
the horizon, taken on either side from the horizon that is nearer, and V stands at the angle gamma
from the x axis that points away from L:

    V = (-cos(gamma) sign(l_x), +-sin(gamma) cos(eta), sin(gamma) sin(eta)),
    n.v dV = sin(gamma)^2 sin(eta) d(gamma) d(eta).

What a section of parallel cylinders of radius 1 shows of itself depends on eta alone. With the
spacing D, a floor at the height f above the axes, and caps that span the angle A = acos(f) on
either side of the top, w = sin(A), the integrand has kinks where

=======================================  ====================================================
shadows begin                            eta = A
the floor disappears                     (D - w) sin(eta) + f cos(eta) = 1
L and V on one side show the same        eta = eta_L
L and V on opposite sides share an end   (D - sin(e)) sin(eta) + cos(e) cos(eta) = 1, e = eta_L,
                                         and the same with eta and eta_L exchanged
their parts of the floor come apart      x sin(eta) + f cos(eta) = 1, x where L's floor ends
=======================================  ====================================================

All are lines eta = const. The sine and cosine law a sin(eta) + b cos(eta) = 1 is quadratic in
tan(eta/2), and is solved there without cancellation. Between the lines the section is a
trigonometric polynomial in eta, except next to the horizon, where it is one in sqrt(eta) as well.

A lobe about the mirror direction, gamma = beta with beta the angle of L to the x axis, narrows
where V comes close to -L. There delta = gamma - beta is stretched, delta = b sinh(s), by the
length b = |l_p + |l_p| v_p/|v_p|| of what the half vector has in the plane, times the width of the
lobe.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from albedo._compile import kernel
from albedo.charts._compiled import CompiledChart, Kernel

# A corner that the stretching leaves round at this distance holds its cube of the energy.
_FINEST = 1e-5
# The stretching goes over this many e-folds in one panel.
_FOLDS = 4.0
# A strip is no wider than this many widths of the lobe: ends of arcs sweep through it.
_STRIP = 12.0
# Next to -L the stretching changes with the logarithm of the height: this power clusters there.
_CORNER = 4


def _height(a: float, b: float, c: float) -> float:
    """The lower solution of a sin(eta) + b cos(eta) = 1, where c = 1 - b and a >= sqrt(1 - b^2)."""
    return 2.0 * math.atan2(c, a + math.sqrt(max(a * a - c * (1.0 + b), 0.0)))


@dataclass(frozen=True)
class GrooveChart(CompiledChart):
    """The hemisphere in (height across the grooves, angle out of the plane across them).

    The two widths of a row are the spacing D of the cylinders and the elevation 1 - f of their
    tops above the floor, both in radii.

    Parameters
    ----------
    lobe : float
        Width of a lobe about the half vector, in radians: panels are stretched towards the mirror
        direction. 0 where the integrand is smooth out of the plane.
    """

    lobe: float = 0.0

    def panels(
        self,
        cos_theta: np.ndarray,
        phi: np.ndarray,
        widths: np.ndarray,
        isotropic: bool,
        coarse: bool = False,
        fine: bool = False,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Panels of every row; see `albedo.charts.polar.PolarChart.panels`.

        `isotropic` and `fine` change nothing. Code: the number 0 for a lobe's core and 1
        elsewhere in second place, the side (1 with L, -1 opposite), the power that clusters
        nodes at the horizon, and the layout out of the plane (0 plain, 1 and -1 the stretched
        halves above and below gamma = beta). Box: the panel, and the heights between which it
        lies.
        """
        s = np.sqrt((1 - cos_theta) * (1 + cos_theta))
        along, across = s * np.cos(phi), s * np.sin(phi)
        in_plane = np.hypot(across, cos_theta)
        eta_l = np.arctan2(cos_theta, np.abs(across))
        beta = np.arctan2(in_plane, np.abs(along))
        geometry = np.column_stack((along, across, cos_theta, in_plane, eta_l, beta))
        row, code, box = [], [], []
        for i, (spacing, elevation) in enumerate(widths):
            light = float(eta_l[i]), float(beta[i]), float(in_plane[i])
            lobe = 0.0 if coarse else self.lobe
            for side, u0, u1, low, high, power in _strips(
                light[0], spacing, elevation, lobe, coarse
            ):
                for layout, v0, v1 in _pieces(light, side, low, lobe):
                    row.append(i)
                    code.append((side, 0 if layout else 1, power, layout))
                    box.append((u0, u1, v0, v1, low, high))
        return geometry, np.array(row), np.array(code), np.array(box)

    @property
    def layout(self) -> tuple[Kernel, np.ndarray]:
        """See `albedo.charts._compiled.CompiledChart`."""
        return _nodes, np.array([self.lobe, _FINEST])


def _strips(
    eta_l: float, spacing: float, elevation: float, lobe: float, coarse: bool
) -> list[tuple[int, float, float, float, float, int]]:
    """Side, ends, heights and power of the strips between kinks."""
    half_pi = 0.5 * math.pi
    if coarse:
        return [(side, 0.0, 1.0, 0.0, half_pi, 2) for side in (1, -1)]
    top = min(elevation, 1.0)
    f, w = 1.0 - top, math.sqrt(top * (2.0 - top))
    spacing = max(spacing, 2.0 * w)
    cap = 2.0 * math.asin(math.sqrt(0.5 * top))
    closed = _height(spacing - w, f, top)
    same, opposite = [closed], [closed]
    if eta_l < cap:
        same.append(eta_l)
        sine, cosine = math.sin(eta_l), math.cos(eta_l)
        opposite.append(_height(spacing - sine, cosine, 2.0 * math.sin(0.5 * eta_l) ** 2))
        if eta_l < closed:
            opposite.append(2.0 * math.asin(math.sqrt(min(0.5 * spacing * sine, 1.0))) - eta_l)
        else:
            dark = 2.0 * math.sin(0.5 * (cap - eta_l)) ** 2 / sine
            opposite.append(_height(spacing - w - dark, f, top))
    found = []
    for side, kinks in ((1, same), (-1, opposite)):
        # One panel stands over the middle, from cap to cap.
        cuts = sorted({0.0, cap, *(x for x in kinks if 0.0 < x < cap)})
        for low, high in itertools.pairwise(cuts):
            power = 2 if low == 0.0 else 1
            if lobe > 0.0 and side < 0 and low < 0.1 * high:
                power = _CORNER
            found.append((side, low, high, power))
    if cap < half_pi:
        found.append((1, cap, math.pi - cap, 1))
    widest = _STRIP * lobe if lobe > 0.0 else math.inf
    return [
        (side, k / count, (k + 1) / count, low, high, power)
        for side, low, high, power in found
        for count in [max(1, math.ceil((high - low) / widest))]
        for k in range(count)
    ]


def _pieces(
    light: tuple[float, float, float], side: int, low: float, lobe: float
) -> list[tuple[int, float, float]]:
    """Layout and ends of the pieces of a strip out of the plane."""
    if lobe == 0.0:
        return [(0, 0.0, 1.0)]
    eta_l, beta, in_plane = light
    # The length is least next to the horizon, on the side where V may be -L.
    least = math.sin(0.5 * (eta_l + low)) if side < 0 else abs(math.cos(0.5 * (eta_l - low)))
    scale = max(2.0 * in_plane * least * lobe, _FINEST)
    found = []
    for layout, extent in ((-1, beta), (1, math.pi - beta)):
        count = max(1, math.ceil(math.asinh(extent / scale) / _FOLDS))
        found += [(layout, k / count, (k + 1) / count) for k in range(count)]
    return found


@kernel
def _nodes(geometry, code, box, u, v, numbers, wi, wo, h, weight):
    lobe, finest = numbers[0], numbers[1]
    for k in range(box.shape[0]):
        lx, ly, lz, in_plane, eta_l, beta = geometry[k]
        wi[0, k] = lx
        wi[1, k] = ly
        wi[2, k] = lz
        u0, u1, v0, v1, low, high = box[k]
        side, power, layout = code[k, 0], code[k, 2], code[k, 3]
        turn_x = 1.0 if lx >= 0.0 else -1.0
        turn_y = 1.0 if ly >= 0.0 else -1.0
        for iu in range(u.size):
            place = u0 + (u1 - u0) * u[iu]
            eta = low + (high - low) * place**power
            sin_eta, cos_eta = math.sin(eta), math.cos(eta)
            outer = sin_eta * power * place ** (power - 1) * (high - low) * (u1 - u0) * (v1 - v0)
            sum_2, less_2 = 0.5 * (eta + eta_l), 0.5 * (eta - eta_l)
            length = math.sin(sum_2) if side < 0 else abs(math.cos(less_2))
            scale = max(2.0 * in_plane * length * lobe, finest)
            end = math.asinh((beta if layout < 0 else math.pi - beta) / scale)
            for iv in range(v.size):
                x = v0 + (v1 - v0) * v[iv]
                if layout == 0:
                    gamma, jac = math.pi * x, math.pi
                    delta = gamma - beta
                else:
                    delta = layout * scale * math.sinh(end * x)
                    gamma = min(max(beta + delta, 0.0), math.pi)
                    jac = scale * end * math.cosh(end * x)
                sin_gamma = math.sin(gamma)
                mid = beta + 0.5 * delta
                half_chord = 2.0 * math.sin(0.5 * delta)
                j = iu * v.size + iv
                wo[0, k, j] = -turn_x * math.cos(gamma)
                wo[1, k, j] = turn_y * side * sin_gamma * cos_eta
                wo[2, k, j] = sin_gamma * sin_eta
                # L + V from the differences of the angles: opposite components cancel in part.
                h[0, k, j] = turn_x * half_chord * math.sin(mid)
                if side > 0:
                    h[1, k, j] = ly + wo[1, k, j]
                else:
                    tilt = 2.0 * math.sin(sum_2) * math.sin(less_2)
                    h[1, k, j] = turn_y * (
                        sin_gamma * tilt - half_chord * math.cos(mid) * math.cos(eta_l)
                    )
                h[2, k, j] = lz + wo[2, k, j]
                weight[k, j] = outer * jac * sin_gamma * sin_gamma
