"""Unit vectors drawn in space and their products as tables, for figures of geometry.

What is drawn is computed: vectors are projected along the line of sight without perspective, and
arcs between them are parts of great circles.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

__all__ = ["Scene", "angle_between", "dot_products", "mirrored", "vector_table"]

# A product of two unit vectors: their own roundings, three products and two sums.
ROUNDING = 8.0 * float(np.finfo(float).eps)


def mirrored(light: np.ndarray) -> np.ndarray:
    """R = 2 (n.l) N - L."""
    found: np.ndarray = light * np.array([-1.0, -1.0, 1.0])
    return found


def angle_between(a: np.ndarray, b: np.ndarray) -> float:
    """The angle between two unit vectors in radians, as sharp next to 0 as anywhere.

    From |a - b| and |a + b|, the sine and the cosine of half the angle, twice each.
    """
    return 2.0 * math.atan2(float(np.linalg.norm(a - b)), float(np.linalg.norm(a + b)))


def vector_table(vectors: Mapping[str, np.ndarray]) -> pd.DataFrame:
    """Components and angles of vectors.

    Parameters
    ----------
    vectors : mapping of str to ndarray, shape (3,)
        Unit vectors by name.

    Returns
    -------
    pandas.DataFrame
        One row for each: x, y, z, the angle to N and the azimuth in degrees.
    """
    import pandas as pd

    normal = np.array([0.0, 0.0, 1.0])
    return pd.DataFrame(
        [
            {
                "vector": name,
                **dict(zip("xyz", v.tolist(), strict=True)),
                "theta_deg": math.degrees(angle_between(normal, v)),
                # Of -0.0 the azimuth would be -180 degrees.
                "phi_deg": math.degrees(math.atan2(v[1] + 0.0, v[0] + 0.0)),
            }
            for name, v in vectors.items()
        ]
    )


def dot_products(
    vectors: Mapping[str, np.ndarray], pairs: Sequence[tuple[str, str]]
) -> pd.DataFrame:
    """Dot products and angles of pairs of unit vectors.

    Parameters
    ----------
    vectors : mapping of str to ndarray, shape (3,)
        Unit vectors by name.
    pairs : sequence of (str, str)
        Names.

    Returns
    -------
    pandas.DataFrame
        One row for each pair: ``product`` and ``angle_deg`` with their errors by rounding.
    """
    import pandas as pd

    rows = []
    for first, second in pairs:
        a, b = vectors[first], vectors[second]
        rows.append(
            {
                "pair": f"{first}.{second}",
                "product": float(a @ b),
                "product_error": ROUNDING,
                "angle_deg": math.degrees(angle_between(a, b)),
                "angle_deg_error": math.degrees(ROUNDING),
            }
        )
    return pd.DataFrame(rows)


class Scene:
    """Vectors from one point of a surface, seen from a direction without perspective.

    Parameters
    ----------
    axes : Axes
        Where to draw.
    azimuth, elevation : float
        Where one looks from, degrees.
    """

    def __init__(self, axes: Axes, azimuth: float, elevation: float) -> None:
        self.axes = axes
        a, e = math.radians(azimuth), math.radians(elevation)
        self._right = np.array([-math.sin(a), math.cos(a), 0.0])
        self._up = np.array([-math.sin(e) * math.cos(a), -math.sin(e) * math.sin(a), math.cos(e)])
        axes.set_aspect("equal")
        axes.set_axis_off()

    def project(self, points: np.ndarray) -> np.ndarray:
        """Places in the picture, shape (..., 2), of points (..., 3)."""
        return np.stack((points @ self._right, points @ self._up), axis=-1)

    def surface(self, radius: float, **look: Any) -> None:
        """A disc of the surface."""
        turn = np.linspace(0.0, 2.0 * math.pi, 121)
        rim = radius * np.stack((np.cos(turn), np.sin(turn), 0.0 * turn), axis=-1)
        options: dict[str, Any] = {"facecolor": "#eeeeee", "edgecolor": "#bbbbbb", "zorder": 0.2}
        self.axes.fill(*self.project(rim).T, **(options | {"linewidth": 0.8} | look))

    def line(self, points: np.ndarray, **look: Any) -> None:
        """A curve through points, shape (n, 3)."""
        self.axes.plot(*self.project(points).T, **({"linewidth": 1.0} | look))

    def arrow(
        self,
        vector: np.ndarray,
        label: str,
        color: str = "#222222",
        *,
        length: float = 1.0,
        shift: tuple[float, float] = (0.0, 0.0),
        **look: Any,
    ) -> None:
        """An arrow from the origin with its name at its tip, which `shift` moves."""
        tip = self.project(length * vector)
        arrow = {"arrowstyle": "-|>", "color": color, "linewidth": 1.7, "shrinkA": 0, "shrinkB": 0}
        self.axes.annotate("", (tip[0], tip[1]), (0.0, 0.0), arrowprops=arrow | look, zorder=3)
        place = tip + 0.075 * tip / max(float(np.hypot(*tip)), 1e-9) + np.array(shift)
        style: dict[str, Any] = {"ha": "center", "va": "center", "color": color}
        self.axes.text(place[0], place[1], label, fontsize=12, fontweight="bold", **style)
        # An annotation does not count for the limits of the axes.
        self.axes.plot(*(place + 0.05 * np.sign(place)), alpha=0.0)

    def arc(
        self,
        first: np.ndarray,
        second: np.ndarray,
        label: str,
        color: str = "#555555",
        *,
        radius: float = 0.4,
        shift: tuple[float, float] = (0.0, 0.0),
        **look: Any,
    ) -> None:
        """The angle between two unit vectors, with its name outside its middle."""
        angle = angle_between(first, second)
        t = np.linspace(0.0, 1.0, 61)[:, None]
        points = (np.sin((1.0 - t) * angle) * first + np.sin(t * angle) * second) / math.sin(angle)
        self.line(radius * points, color=color, **look)
        middle = self.project(points[30])
        place = (radius + 0.07) * middle + np.array(shift)
        self.axes.text(
            place[0], place[1], label, color=color, ha="center", va="center", fontsize=11
        )
