"""Chart of parallels: elevation and azimuth, for lobes whose model has kinks at some n.v.

V = (cos(e) cos(a), cos(e) sin(a), sin(e)) with the azimuth a measured from the mirror direction R,
which lies at a = 0 and at the elevation e_R of L. Both coordinates are stretched about R:
e = e_R + w sinh(v) and a = w' sinh(u), with w the scale of the lobe and w' = w/sin(theta), at most
1; n.v dV = sin(e) cos(e) de da. Panels end at parallels: that of R, those where the model says that
it has a kink, and one next to the horizon for a layer there. The half vector is
h = (2 sin((e + e_R)/2) sin((e - e_R)/2) + 2 cos(e) sin^2(a/2), cos(e) sin(a), n.l + n.v), turned.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from albedo._compile import kernel
from albedo.charts._compiled import CompiledChart, Kernel

# A cosine power is cut where it is exp(-42.25) = 4.5e-19 of its peak; in widths, the angle to R.
_REACH = math.sqrt(8.0 * 42.25)
# Scale of the stretch, in widths: measured to need the fewest nodes.
_SCALE = 6.0


@dataclass(frozen=True)
class ParallelsChart(CompiledChart):
    """The hemisphere in (azimuth, elevation), stretched about the mirror direction.

    Parameters
    ----------
    level : callable
        ``level(values, cos_theta)``: the elevation, in radians, at which the integrand has a kink
        for this incidence; outside (0, pi/2) when it has none.
    values : tuple of float
        What `level` needs of the model.
    layer : float
        Width of a layer at the horizon, radians.
    """

    level: Callable[[tuple[float, ...], float], float]
    values: tuple[float, ...] = ()
    layer: float = 1.0

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

        `widths` are those of half the angle between R and V, as in the polar chart; the first
        one counts.
        """
        c = cos_theta
        s = np.sqrt((1 - c) * (1 + c))
        width = np.clip(widths[:, 0], 1e-12, 1.0)
        w = np.minimum(_SCALE * width, 1.0)
        with np.errstate(divide="ignore"):
            across = np.minimum(w / s, 1.0)
        lift = np.arctan2(c, s)
        geometry = np.column_stack((c, s, np.cos(phi), np.sin(phi), lift, w, across))
        row, code, box = [], [], []
        for i in range(c.size):
            reach = _REACH * width[i]
            low, high = max(0.0, lift[i] - reach), min(0.5 * math.pi, lift[i] + reach)
            cuts = {low, high}
            if not coarse:
                inner = (lift[i], self.level(self.values, float(c[i])), 3.0 * self.layer)
                cuts |= {x for x in inner if low < x < high}
            end = math.asinh(_turn(reach, math.cos(lift[i]) * math.cos(high)) / across[i])
            steps = 1 if coarse else max(1, math.ceil(end / 4.0))
            turns = np.linspace(0.0, end, steps + 1)
            if not isotropic:
                turns = np.concatenate((-turns[:0:-1], turns))
            for v0, v1 in itertools.pairwise(sorted(cuts)):
                for u0, u1 in itertools.pairwise(turns):
                    row.append(i)
                    code.append((0, 0, 1, 2 if isotropic else 1))
                    ends = (math.asinh((x - lift[i]) / w[i]) for x in (v0, v1))
                    box.append((u0, u1, *ends))
        return geometry, np.array(row), np.array(code), np.array(box)

    @property
    def layout(self) -> tuple[Kernel, np.ndarray]:
        """See `albedo.charts._compiled.CompiledChart`."""
        return _nodes, np.empty(0)


def _turn(reach: float, cosines: float) -> float:
    """The azimuth beyond which no direction is within `reach` of R; pi when there is none."""
    # sin^2(angle/2) is at least cos(e) cos(e_R) sin^2(a/2).
    q = math.sin(0.5 * min(reach, math.pi)) ** 2
    return 2.0 * math.asin(math.sqrt(q / cosines)) if q < cosines else math.pi


@kernel
def _nodes(geometry, code, box, u, v, numbers, wi, wo, h, weight):
    for k in range(box.shape[0]):
        c, s, cos_phi, sin_phi, lift, w, across = geometry[k]
        wi[0, k] = s * cos_phi
        wi[1, k] = s * sin_phi
        wi[2, k] = c
        u0, u1, v0, v1 = box[k]
        for iu in range(u.size):
            t = u0 + (u1 - u0) * u[iu]
            turn = across * math.sinh(t)
            sin_a, half = math.sin(turn), math.sin(0.5 * turn)
            outer = code[k, 3] * (u1 - u0) * (v1 - v0) * across * math.cosh(t) * w
            for iv in range(v.size):
                x = v0 + (v1 - v0) * v[iv]
                rise = w * math.sinh(x)
                e = min(max(lift + rise, 0.0), 0.5 * math.pi)
                sin_e, cos_e = math.sin(e), math.cos(e)
                along = 2.0 * math.sin(lift + 0.5 * rise) * math.sin(0.5 * rise)
                along += 2.0 * cos_e * half * half
                aside = -cos_e * sin_a
                j = iu * v.size + iv
                wo[0, k, j] = (along - s) * cos_phi - aside * sin_phi
                wo[1, k, j] = (along - s) * sin_phi + aside * cos_phi
                wo[2, k, j] = sin_e
                h[0, k, j] = along * cos_phi - aside * sin_phi
                h[1, k, j] = along * sin_phi + aside * cos_phi
                h[2, k, j] = c + sin_e
                weight[k, j] = outer * math.cosh(x) * sin_e * cos_e
