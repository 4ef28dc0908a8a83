"""What the lobes about the mirror direction share: their chart and their width."""

from __future__ import annotations

import math

from albedo.charts.polar import PolarChart


def mirror_width(n: float) -> float:
    """Width of cos(a)^n in half the angle a, radians."""
    return min(1.0, 1.0 / math.sqrt(2.0 * max(n, 0.5)))


def mirror_chart(n: float, kinks: str = "none", kind: str = "mirror") -> PolarChart:
    """The chart for cos(a)^n; low powers end in a root at a = pi/2, which wants dense nodes."""
    return PolarChart(kind, kinks, "cosine_power", edge=4 if n < 16 else 1)
