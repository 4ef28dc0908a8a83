"""Cosine chart: azimuth about N and n.v itself, for everything that is broad.

V = (sqrt(1 - mu^2) cos(psi), sqrt(1 - mu^2) sin(psi), mu) with psi measured from L's azimuth;
n.v dV = mu dmu dpsi. Panels end at psi = 0, +-pi/2, pi and, for models with max(n.l, n.v), at
mu = n.l.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from albedo._compile import kernel


@dataclass(frozen=True)
class CosineChart:
    """The hemisphere in (azimuth, cosine).

    Parameters
    ----------
    kinks : {"none", "max"}
        Whether the integrand has a kink where n.v = n.l.
    """

    kinks: str = "none"
    full: bool = False

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
        geometry = np.column_stack((c, np.sqrt((1 - c) * (1 + c)), np.cos(phi), np.sin(phi)))
        halves = 2 if isotropic else 4
        psi = np.linspace(0.0, 0.5 * np.pi * halves, halves + 1)
        row, code, box = [], [], []
        for i, mu in enumerate(c):
            cuts = (
                [0.0, mu, 1.0] if self.kinks == "max" and 0 < mu < 1 and not coarse else [0.0, 1.0]
            )
            for u0, u1 in itertools.pairwise(psi):
                for v0, v1 in itertools.pairwise(cuts):
                    row.append(i)
                    code.append((0, 0, 1, 2 if isotropic else 1))
                    box.append((u0, u1, v0, v1))
        return geometry, np.array(row), np.array(code), np.array(box)

    def nodes(
        self,
        geometry: np.ndarray,
        code: np.ndarray,
        box: np.ndarray,
        u: np.ndarray,
        v: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Directions and Jacobians; see `albedo.charts.polar.PolarChart.nodes`."""
        m, count = box.shape[0], u.size * v.size
        wi, wo, h = np.empty((3, m)), np.empty((3, m, count)), np.empty((3, m, count))
        weight = np.empty((m, count))
        _nodes(geometry, code, box, u, v, wi, wo, h, weight)
        return wi, wo, h, weight


@kernel
def _nodes(geometry, code, box, u, v, wi, wo, h, weight):
    for k in range(box.shape[0]):
        c, s, cos_phi, sin_phi = geometry[k, 0], geometry[k, 1], geometry[k, 2], geometry[k, 3]
        wi[0, k] = s * cos_phi
        wi[1, k] = s * sin_phi
        wi[2, k] = c
        u0, u1, v0, v1 = box[k]
        for iu in range(u.size):
            psi = u0 + (u1 - u0) * u[iu]
            cos_psi, sin_psi = math.cos(psi), math.sin(psi)
            for iv in range(v.size):
                mu = v0 + (v1 - v0) * v[iv]
                sin_v = math.sqrt((1.0 - mu) * (1.0 + mu))
                vx = sin_v * (cos_psi * cos_phi - sin_psi * sin_phi)
                vy = sin_v * (cos_psi * sin_phi + sin_psi * cos_phi)
                i = iu * v.size + iv
                wo[0, k, i] = vx
                wo[1, k, i] = vy
                wo[2, k, i] = mu
                h[0, k, i] = vx + wi[0, k]
                h[1, k, i] = vy + wi[1, k]
                h[2, k, i] = mu + c
                weight[k, i] = code[k, 3] * mu * (u1 - u0) * (v1 - v0)
