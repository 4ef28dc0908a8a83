"""Cosine chart: azimuth about N and n.v itself, for everything that is broad.

V = (sqrt(1 - mu^2) cos(psi), sqrt(1 - mu^2) sin(psi), mu) with psi measured from L's azimuth;
n.v dV = mu dmu dpsi. Panels end at psi = 0, +-pi/2, pi and, for models with max(n.l, n.v), at
mu = n.l.

Models in angles have a root at mu = 1, where the angle of V to the normal is sqrt(2 (1 - mu)). For
them the coordinate is V's elevation t, mu = sin(t). Above the elevation t_l of L it is graded as
t + t_l = 2 t_l exp(x): functions of n.l + n.v, which at grazing incidence change in a layer as
thin as n.l, are smooth in x. A model may also have a layer of its own, of a thickness r, such as
the factor 1/(r + (1 - r) n.v) makes: there t = r (exp(x) - 1).

Fresnel factors are functions of v.h = |h|/2. With chi the azimuth of V from the mirror direction,
|h|^2 is about chi^2 + (t + t_l)^2: at grazing incidence a cone, whose tip is a corner of the chart.
Where there is a layer, both coordinates are graded towards that corner: chi = q sinh(x) with
q = t + t_l + 0.1, and r at most t_l + 0.1.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from albedo._compile import kernel
from albedo.charts._compiled import CompiledChart, Kernel

# A rule of a dozen nodes sees this many e-folds of a graded panel to all digits.
_FOLDS = 7.0
# Most e-folds of a panel in a layer, and the distance from the tip of a cone that is still graded.
# Measured: what is nearer to the tip adds too little to need nodes of its own.
_LAYER_FOLDS, _NEAR = 8.0, 0.1


@dataclass(frozen=True)
class CosineChart(CompiledChart):
    """The hemisphere in (azimuth, cosine).

    Parameters
    ----------
    kinks : {"none", "max"}
        Whether the integrand has a kink where n.v = n.l.
    angle : bool
        Integrate over the elevation of V, graded above that of L where there is a kink.
    layered : bool
        With `angle`: the first width of a row is the thickness of a layer along the horizon, and
        there may be a cone where V is the mirror direction at grazing incidence.
    """

    kinks: str = "none"
    full: bool = False
    angle: bool = False
    layered: bool = False

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
        c = cos_theta
        s = np.sqrt((1 - c) * (1 + c))
        elevation = np.arctan2(c, s)
        near, thickness = np.zeros(c.size), elevation
        if self.layered:
            near = elevation + _NEAR
            thickness = np.minimum(widths[:, 0], near)
        geometry = np.column_stack((c, s, np.cos(phi), np.sin(phi), thickness, near))
        halves = 2 if isotropic else 4
        turns = np.linspace(0.0, 0.5 * np.pi * halves, halves + 1)
        if self.layered:
            turns = np.arange(-1.0, 0.5 * halves)
        row, code, box = [], [], []
        for i, mu in enumerate(c):
            heights = self._heights(mu, geometry[i, 4], coarse)
            for u0, u1 in itertools.pairwise(turns):
                for v0, v1, graded in heights:
                    # Only the top of a layer is steep.
                    gentle = self.layered and v1 < heights[-1][1]
                    row.append(i)
                    code.append((0, int(gentle), graded, 2 if isotropic else 1))
                    box.append((u0, u1, v0, v1))
        return geometry, np.array(row), np.array(code), np.array(box)

    def _heights(self, mu: float, elevation: float, coarse: bool) -> list[tuple[float, float, int]]:
        """Ends of the panels from the horizon to the normal, and whether they are graded."""
        top = 0.5 * math.pi if self.angle else 1.0
        if self.layered and not coarse:
            end = math.log1p(top / elevation)
            x = np.linspace(0.0, end, 1 + max(1, math.ceil(end / _LAYER_FOLDS))).tolist()
            return [(v0, v1, 2) for v0, v1 in itertools.pairwise(x)]
        if self.kinks != "max" or not 0 < mu < 1 or coarse:
            return [(0.0, top, 0)]
        if not self.angle:
            return [(0.0, mu, 0), (mu, top, 0)]
        end = math.log(0.5 * (top / elevation + 1.0))
        x = np.linspace(0.0, end, 1 + max(1, math.ceil(end / _FOLDS))).tolist()
        return [(0.0, elevation, 0), *((v0, v1, 1) for v0, v1 in itertools.pairwise(x))]

    @property
    def layout(self) -> tuple[Kernel, np.ndarray]:
        """See `albedo.charts._compiled.CompiledChart`."""
        return _nodes, np.array([float(self.angle)])


@kernel
def _height(geometry, graded, angle, place):
    """N.v, the cosine of V's elevation, d(n.v) / d(place), and that elevation if by angle."""
    if not angle:
        return place, math.sqrt((1.0 - place) * (1.0 + place)), 1.0, 0.0
    t, stretch = place, 1.0
    if graded == 1:
        stretch = 2.0 * geometry[4] * math.exp(place)
        t = stretch - geometry[4]
    elif graded == 2:
        t = geometry[4] * math.expm1(place)
        stretch = geometry[4] + t
    across = math.cos(t)
    return math.sin(t), across, stretch * across, t


@kernel
def _nodes(geometry, code, box, u, v, numbers, wi, wo, h, weight):
    angle = numbers[0] != 0.0
    heights, sines, stretches = np.empty(v.size), np.empty(v.size), np.empty(v.size)
    near, reach = np.empty(v.size), np.empty(v.size)
    for k in range(box.shape[0]):
        c, s, cos_phi, sin_phi = geometry[k, 0], geometry[k, 1], geometry[k, 2], geometry[k, 3]
        wi[0, k] = s * cos_phi
        wi[1, k] = s * sin_phi
        wi[2, k] = c
        u0, u1, v0, v1 = box[k, 0], box[k, 1], box[k, 2], box[k, 3]
        layered = geometry[k, 5] > 0.0
        area = code[k, 3] * (u1 - u0) * (v1 - v0)
        for iv in range(v.size):
            place = v0 + (v1 - v0) * v[iv]
            mu, sin_v, stretch, t = _height(geometry[k], code[k, 2], angle, place)
            heights[iv], sines[iv], stretches[iv] = mu, sin_v, area * mu * stretch
            if layered:
                near[iv] = geometry[k, 5] + t
                reach[iv] = math.asinh(math.pi / near[iv])
        for iu in range(u.size):
            turn = u0 + (u1 - u0) * u[iu]
            cos_psi, sin_psi = math.cos(turn), math.sin(turn)
            for iv in range(v.size):
                slope = 1.0
                if layered:
                    rise = math.exp(turn * reach[iv])
                    chi = 0.5 * near[iv] * (rise - 1.0 / rise)
                    slope = 0.5 * near[iv] * (rise + 1.0 / rise) * reach[iv]
                    cos_psi, sin_psi = -math.cos(chi), -math.sin(chi)
                vx = sines[iv] * (cos_psi * cos_phi - sin_psi * sin_phi)
                vy = sines[iv] * (cos_psi * sin_phi + sin_psi * cos_phi)
                i = iu * v.size + iv
                wo[0, k, i] = vx
                wo[1, k, i] = vy
                wo[2, k, i] = heights[iv]
                h[0, k, i] = vx + wi[0, k]
                h[1, k, i] = vy + wi[1, k]
                h[2, k, i] = heights[iv] + c
                weight[k, i] = stretches[iv] * slope
