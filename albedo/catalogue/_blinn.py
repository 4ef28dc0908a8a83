"""What the lobes that are powers of n.h share: their chart and their width."""

from __future__ import annotations

import math

from albedo.charts.polar import PolarChart


def slope_width(n: float) -> float:
    """Width of (n.h)^n in the angle of h, radians."""
    return min(1.0, math.sqrt(2.0 / max(n, 2.0)))


def slope_chart(n: float, kinks: str = "none", full: bool = False) -> PolarChart:
    """The chart for (n.h)^n; low powers end in a root at n.h = 0, which wants dense nodes."""
    return PolarChart("slope", kinks, "cosine_power", edge=4 if n < 16 else 1, full=full)
