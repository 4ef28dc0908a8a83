"""Cosine chart that leaves out where Oren and Nayar's full model is cut off at 0.

Opposite the light, at grazing angles, their fit falls below 0 for rough and dark surfaces. At a
fixed elevation t of V it is linear in 1 + cos(psi) there, so that it ends at an azimuth that is
known: 2 sin^2(d/2) = 1 + cos(psi) = -a/b, d = pi - psi, where the fit is a + b (1 + cos(psi)). Seen
over t the dark region ends at an elevation t_0 where a = 0; d falls to 0 there like a root.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from albedo._compile import kernel
from albedo.charts._compiled import Kernel
from albedo.charts.cosine import CosineChart
from albedo.charts.cosine import _nodes as plain

_HALF = 0.5 * math.pi


@dataclass(frozen=True)
class DarkChart(CosineChart):
    """The hemisphere without the region where the fit is negative, in azimuth and elevation.

    Parameters
    ----------
    c_1, lobe, second : float
        C_1, sigma^2/(sigma^2 + 0.09) and 0.17 rho sigma^2/(sigma^2 + 0.13) of the model.
    """

    kinks: str = "max"
    angle: bool = True
    c_1: float = 1.0
    lobe: float = 0.0
    second: float = 0.0

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
        geometry, row, code, box = super().panels(cos_theta, phi, widths, isotropic, coarse, fine)
        plain = np.concatenate((box, np.zeros_like(box[:, :2])), axis=1)
        if coarse:
            return geometry, row, np.pad(code, ((0, 0), (0, 1))), plain
        ends = [dark_end(g[0], g[1], g[4], self.c_1, self.lobe, self.second) for g in geometry]
        rows, codes, boxes = [], [], []
        for r, kind, (u0, u1, v0, v1) in zip(row, code, box, strict=True):
            end = ends[r]
            if kind[2]:
                end = math.log(0.5 * (end / geometry[r, 4] + 1.0)) if end > 0.0 else -1.0
            first = v0
            # Azimuths from 90 to 270 degrees are opposite the light.
            if _HALF <= u0 < 3.0 * _HALF and end > v0:
                first = min(end, v1)
                last = 1.0 - math.sqrt((end - first) / (end - v0))
                rows.append(r)
                codes.append((*kind, 1))
                boxes.append((u0, u1, 0.0, last, v0, end))
            if first < v1:
                rows.append(r)
                codes.append((*kind, 0))
                boxes.append((u0, u1, first, v1, 0.0, 0.0))
        return geometry, np.array(rows), np.array(codes), np.array(boxes)

    @property
    def layout(self) -> tuple[Kernel, np.ndarray]:
        """See `albedo.charts._compiled.CompiledChart`."""
        return _nodes, np.array([float(self.angle), self.c_1, self.lobe, self.second])


@kernel
def opposite(sin_a, cos_a, x):
    """sin(alpha) - (2 beta/pi)^3 with 2 beta/pi = 1 - x, written so that nothing cancels."""
    return x * (3.0 + x * (x - 3.0)) - cos_a * cos_a / (1.0 + sin_a)


@kernel
def _fit(c, s, elevation, t, mu, sin_v, c_1, lobe, second):
    """a and b of the fit a + b (1 + cos(psi)) opposite the light."""
    x_l, x_v = elevation / (0.5 * math.pi), t / (0.5 * math.pi)
    sin_a, cos_a, tan_b, x = s, c, sin_v / mu, x_v
    if c > mu:
        sin_a, cos_a, tan_b, x = sin_v, mu, s / c, x_l
    toward = 0.45 * lobe * opposite(sin_a, cos_a, x) * tan_b
    c_3 = 0.125 * lobe * ((1.0 - x_l) * (1.0 - x_v)) ** 2
    more = second * (1.0 - x) * (1.0 - x)
    return c_1 - toward + second + more, toward + c_3 * ((s + sin_v) / (c + mu)) - more


@kernel
def dark_angle(c, s, elevation, t, mu, sin_v, c_1, lobe, second):
    """How far from opposite the light V is dark at an elevation t; up to a right angle."""
    a, b = _fit(c, s, elevation, t, mu, sin_v, c_1, lobe, second)
    return 2.0 * math.asin(math.sqrt(min(1.0, max(0.0, -0.5 * a / b))))


@kernel
def dark_end(c, s, elevation, c_1, lobe, second):
    """Elevation of V below which the fit is negative opposite the light; 0 where it never is."""
    low, high = 0.0, 0.5 * math.pi
    for _ in range(200):
        t = 0.5 * (low + high)
        a = _fit(c, s, elevation, t, math.sin(t), math.cos(t), c_1, lobe, second)[0]
        if a < 0.0:
            low = t
        else:
            high = t
    return low


@kernel
def _nodes(geometry, code, box, u, v, numbers, wi, wo, h, weight):
    c_1, lobe, second = numbers[1], numbers[2], numbers[3]
    plain(geometry, code, box, u, v, numbers, wi, wo, h, weight)
    for k in range(box.shape[0]):
        if code[k, 4] == 0:
            continue
        c, s, cos_phi, sin_phi, elevation = geometry[k, :5]
        u0, u1, v0, v1, start, end = box[k]
        for iv in range(v.size):
            # The root at the end of the dark region becomes smooth.
            rest = 1.0 - (v0 + (v1 - v0) * v[iv])
            t = end - (end - start) * rest * rest
            stretch = 2.0 * (end - start) * rest
            if code[k, 2] > 0:
                e = 2.0 * elevation * math.exp(t)
                t = e - elevation
                stretch *= e
            mu, sin_v = math.sin(t), math.cos(t)
            d = dark_angle(c, s, elevation, t, mu, sin_v, c_1, lobe, second)
            lit = 1.0 - d / (0.5 * math.pi)
            for iu in range(u.size):
                # How far psi is from 180 degrees, of which d is dark.
                away = u0 + (u1 - u0) * u[iu] - math.pi
                away = lit * away + math.copysign(d, away)
                cos_psi, sin_psi = -math.cos(away), -math.sin(away)
                vx = sin_v * (cos_psi * cos_phi - sin_psi * sin_phi)
                vy = sin_v * (cos_psi * sin_phi + sin_psi * cos_phi)
                i = iu * v.size + iv
                wo[0, k, i] = vx
                wo[1, k, i] = vy
                wo[2, k, i] = mu
                h[0, k, i] = vx + s * cos_phi
                h[1, k, i] = vy + s * sin_phi
                h[2, k, i] = mu + c
                weight[k, i] = code[k, 3] * mu * sin_v * stretch * lit * (u1 - u0) * (v1 - v0)
