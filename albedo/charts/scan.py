"""Scanning chart: for a BRDF about which nothing is known.

Azimuth psi about N (from L's azimuth) and polar angle of V; dV n.v = sin cos dtheta dpsi. The
hemisphere is covered with panels so small that every disc of the resolved width holds a node, and
graded geometrically towards the mirror direction (psi = pi, theta_v = theta), the light itself
(psi = 0) and the normal, down to 1e-8 rad. Panel edges pass through the lines theta_v = theta and
psi = 0, +-pi/2, pi, where many models have kinks.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

_FINEST = 1e-8
_RATIO = 4.0
LEAST = 10
"""Nodes along each side of a panel, of which no disc as wide as the resolved width is missed."""
# The widest gap between ten Gauss nodes is 0.149 of a panel; the widest disc without a node in a
# square of such gaps is 1.42 times as wide.
_PANEL_WIDTHS = 4.5


def _graded(points: list[float], step: float, low: float, high: float) -> np.ndarray:
    """Edges from low to high, at most `step` apart, graded towards the given points."""
    near = _FINEST * _RATIO ** np.arange(0, max(1, math.ceil(math.log(step / _FINEST, _RATIO))))
    special = np.array(sorted({low, high, *points}))
    edges = np.concatenate([special, *(x + sign * near for x in points for sign in (-1, 1))])
    edges = np.unique(edges[(edges >= low) & (edges <= high)])
    fine = [edges[:1]]
    for left, right in itertools.pairwise(edges):
        count = math.ceil((right - left) / step)
        fine.append(np.linspace(left, right, count + 1)[1:])
    return np.concatenate(fine)


@dataclass(frozen=True)
class ScanChart:
    """The whole hemisphere, scanned down to a feature width.

    Parameters
    ----------
    width : float
        Feature width that nodes resolve everywhere, radians.
    """

    width: float = 1e-3

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

        `coarse` is ignored: fewer panels would break the promise of the resolved width.
        """
        c = cos_theta
        s = np.sqrt((1 - c) * (1 + c))
        geometry = np.column_stack((c, s, np.cos(phi), np.sin(phi)))
        step = _PANEL_WIDTHS * self.width
        row, boxes = [], []
        for i in range(c.size):
            theta = math.atan2(s[i], c[i])
            bands = _graded([0.0, theta], step, 0.0, 0.5 * math.pi)
            around: dict[int, np.ndarray] = {}
            for t0, t1 in itertools.pairwise(bands):
                # One azimuth grid serves all bands of about the same circumference.
                key = max(0, math.ceil(4.0 * math.log2(max(math.sin(t1), 1e-12)) + 160.0))
                if key not in around:
                    wide = step / 2.0 ** ((key - 160.0) / 4.0)
                    special = [0.0, math.pi, 2.0 * math.pi]
                    edges = _graded(special, min(wide, 0.5 * math.pi), 0.0, 2.0 * math.pi)
                    halves = [0.5 * math.pi, 1.5 * math.pi]
                    around[key] = np.unique(np.concatenate((edges, halves)))
                edges = around[key]
                box = np.empty((edges.size - 1, 4))
                box[:, 0], box[:, 1] = edges[:-1], edges[1:]
                box[:, 2], box[:, 3] = t0, t1
                boxes.append(box)
                row.append(np.full(len(box), i))
        box = np.concatenate(boxes)
        return geometry, np.concatenate(row), np.ones((len(box), 4), dtype=np.int64), box

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
        c, s, cos_phi, sin_phi = geometry[:, :4].T
        psi = box[:, :1] + (box[:, 1:2] - box[:, :1]) * u
        theta = box[:, 2:3] + (box[:, 3:4] - box[:, 2:3]) * v
        sin_v, cos_v = np.sin(theta), np.cos(theta)
        # Turn into the frame of the model before the product with the polar angle.
        x = np.cos(psi) * cos_phi[:, None] - np.sin(psi) * sin_phi[:, None]
        y = np.cos(psi) * sin_phi[:, None] + np.sin(psi) * cos_phi[:, None]
        wi = np.stack((s * cos_phi, s * sin_phi, c))
        wo = np.empty((3, m, u.size, v.size))
        wo[0] = x[:, :, None] * sin_v[:, None, :]
        wo[1] = y[:, :, None] * sin_v[:, None, :]
        wo[2] = cos_v[:, None, :]
        area = (box[:, 1] - box[:, 0]) * (box[:, 3] - box[:, 2])
        weight = np.broadcast_to(
            area[:, None, None] * (sin_v * cos_v)[:, None, :], (m, u.size, v.size)
        ).reshape(m, count)
        flat = wo.reshape(3, m, count)
        return wi, flat, flat + wi[:, :, None], weight
