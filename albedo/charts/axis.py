r"""Angles about any axis, for powers of the cosine from it.

The axis a stands at the elevation epsilon above the horizon, below it where epsilon < 0. With eta
the elevation within the plane of a and N, and b the angle out of that plane,

    V = cos(b) (cos(eta) t + sin(eta) N) + sin(b) N x t,    t the tangential direction of a,
    n.v dV = cos^2(b) sin(eta) db d(eta),    a.V = cos(b) cos(eta - epsilon).

The horizon is eta = 0 and the edge a.V = 0 is eta = epsilon + pi/2: both are lines of these
coordinates, so that a lobe is smooth on a rectangle however the horizon clips it. A lobe that the
horizon does not reach needs fewer nodes in polar coordinates about a: alpha, and psi from the
plane of a and N,

    n.v dV = (sin(epsilon) cos(alpha) + cos(epsilon) sin(alpha) cos(psi)) sin(alpha) d(alpha) dpsi.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from albedo._compile import kernel
from albedo.charts._compiled import CompiledChart, Kernel

# A lobe is cut where it is below exp(-42.25) = 4.5e-19 of the largest that is above the horizon.
_REACH = 42.25
# Panels: below the axis in its plane, above it, and all around it.
_LOWER, _UPPER, _AROUND = 0, 1, 2


@dataclass(frozen=True)
class AxisChart(CompiledChart):
    """What is within 90 degrees of (c_x l.x, c_y l.y, c_z l.z) and above the horizon.

    It is laid out for powers of the cosine from that axis, of exponent 1/width^2, and for kernels
    that do not read h, which is the plain sum wi + wo here.

    Parameters
    ----------
    coefficients : tuple of float
        c_x, c_y, c_z.
    edge : int
        Power that clusters nodes 90 degrees from the axis, where low powers have roots.
    decay : {"algebraic", "cosine_power"}
        How the lobe falls; only a power of the cosine is cut.
    """

    coefficients: tuple[float, float, float]
    edge: int = 1
    decay: str = "cosine_power"

    def panels(
        self,
        cos_theta: np.ndarray,
        phi: np.ndarray,
        widths: np.ndarray,
        isotropic: bool,
        coarse: bool = False,
        fine: bool = False,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Panels of every row; see `albedo.charts.polar.PolarChart.panels`."""
        s = np.sqrt((1 - cos_theta) * (1 + cos_theta))
        wi = np.stack((s * np.cos(phi), s * np.sin(phi), cos_theta))
        largest = max(abs(c) for c in self.coefficients)
        axis = np.array(self.coefficients)[:, None] / largest * wi
        along = np.hypot(axis[0], axis[1])
        with np.errstate(invalid="ignore"):
            turn = np.where(along > 0, axis[:2] / along, [[1.0], [0.0]])
        elevation = np.arctan2(axis[2], along)
        # The edge a.V = 0, where pi/2 + epsilon would cancel.
        edge = np.arctan2(along, -axis[2])
        cut = np.exp(-_REACH * widths.min(1) ** 2) * float(self.decay == "cosine_power")
        side = np.arctan2(np.sqrt((1 - cut) * (1 + cut)), cut)
        # Below the horizon the largest is the cosine of the angle to the horizon.
        cut = np.where(elevation < 0, np.cos(elevation), 1.0) * cut
        reach = np.arctan2(np.sqrt((1 - cut) * (1 + cut)), cut)
        first = np.maximum(elevation - reach, 0.0)
        last = np.maximum(np.minimum(elevation + reach, edge), first)
        middle = np.clip(elevation, first, last)
        geometry = np.column_stack((*wi, *turn, first, middle, last, side))
        halves = (0,) if isotropic else (0, 1)
        clipped = [(half, 0, at, 3 - len(halves)) for half in halves for at in (_LOWER, _UPPER)]
        free = [(half, 0, _AROUND, 3 - len(halves)) for half in halves]
        codes = [free if inside else clipped for inside in first > 0]
        row = np.repeat(np.arange(cos_theta.size), [len(code) for code in codes])
        code = np.array([panel for panels in codes for panel in panels])
        return geometry, row, code, np.tile([0.0, 1.0, 0.0, 1.0], (row.size, 1))

    @property
    def layout(self) -> tuple[Kernel, np.ndarray]:
        """See `albedo.charts._compiled.CompiledChart`."""
        return _nodes, np.array([float(self.edge)])


@kernel
def _away(x, size, edge):
    """Distance from the axis, what is left of `size`, and the slope, nodes clustered at its end."""
    left = size * (1.0 - x) ** edge
    return size - left, left, edge * size * (1.0 - x) ** (edge - 1)


@kernel
def _nodes(geometry, code, box, u, v, numbers, wi, wo, h, weight):
    """Directions, sums and Jacobians; one row per panel."""
    edge = int(numbers[0])
    for k in range(box.shape[0]):
        lx, ly, lz, tx, ty, first, middle, last, side = geometry[k]
        wi[0, k], wi[1, k], wi[2, k] = lx, ly, lz
        half, at, multiplicity = code[k, 0], code[k, 2], code[k, 3]
        sign = 1.0 if half == 0 else -1.0
        size = middle - first if at == _LOWER else last - middle
        sin_a, cos_a = math.sin(middle), math.cos(middle)
        u0, u1, v0, v1 = box[k]
        for iu in range(u.size):
            x = u0 + (u1 - u0) * u[iu]
            if at == _AROUND:
                turn, outer = math.pi * x, math.pi
            else:
                turn, _, outer = _away(x, side, edge)
            sin_t, cos_t = sign * math.sin(turn), math.cos(turn)
            outer *= multiplicity * (u1 - u0) * (v1 - v0)
            for iv in range(v.size):
                away, left, slope = _away(v0 + (v1 - v0) * v[iv], size, edge)
                if at == _AROUND:
                    sin_v, cos_v = math.sin(away), math.cos(away)
                    along = cos_v * cos_a - sin_v * cos_t * sin_a
                    across = sin_v * sin_t
                    vz = cos_v * sin_a + sin_v * cos_t * cos_a
                    area = sin_v
                else:
                    eta = middle + away if at == _UPPER else first + left
                    along, across = cos_t * math.cos(eta), sin_t
                    vz = cos_t * math.sin(eta)
                    area = cos_t
                vz = max(vz, 0.0)
                i = iu * v.size + iv
                wo[0, k, i] = along * tx - across * ty
                wo[1, k, i] = along * ty + across * tx
                wo[2, k, i] = vz
                h[0, k, i] = lx + wo[0, k, i]
                h[1, k, i] = ly + wo[1, k, i]
                h[2, k, i] = lz + vz
                weight[k, i] = outer * slope * area * vz
