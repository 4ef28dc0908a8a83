"""What hypothesis draws: directions, widths and charts, extremes included."""

from __future__ import annotations

import math

from hypothesis import strategies as st

from albedo.charts.cosine import CosineChart
from albedo.charts.polar import PolarChart


def decades(low: float, high: float) -> st.SearchStrategy[float]:
    """Numbers evenly spread over the logarithm, both ends included."""
    inner = st.floats(math.log10(low), math.log10(high)).map(lambda x: 10.0**x)
    return st.sampled_from([low, high]) | inner.map(lambda x: min(max(x, low), high))


# Normal incidence, 45 degrees (where the horizon leaves the lobe), and their neighbours.
cosines = st.one_of(
    st.sampled_from([1.0, math.nextafter(1.0, 0.0), 1 - 1e-12, math.sqrt(0.5), 0.5, 1e-9]),
    st.floats(1e-3, 1.0),
    decades(1e-9, 1.0),
)
azimuths = st.one_of(
    st.sampled_from([0.0, 0.5 * math.pi, math.pi, -0.25 * math.pi, 1e-9, 2.0 * math.pi]),
    st.floats(-math.pi, 2.0 * math.pi),
)


@st.composite
def widths(
    draw: st.DrawFn, low: float = 1e-6, high: float = 10.0, ratio: float = 100.0
) -> tuple[float, float]:
    """Widths of a lobe along x and y: equal, or up to `ratio` apart."""
    wide = draw(decades(low, high))
    stretch = draw(st.just(1.0) | decades(1.0, ratio))
    pair = wide, max(wide / stretch, low)
    return pair if draw(st.booleans()) else pair[::-1]


@st.composite
def whole_charts(draw: st.DrawFn) -> CosineChart | PolarChart:
    """Charts whose domain is the hemisphere above the horizon."""
    if draw(st.integers(0, 9)) == 0:
        return CosineChart(draw(st.sampled_from(["none", "max"])), angle=draw(st.booleans()))
    kind = draw(st.sampled_from(["slope", "mirror_hemisphere", "retro_hemisphere"]))
    # The masking curves of V-cavities are curves of the half vector.
    kinks = ["none", "max", "v_cavity"] if kind == "slope" else ["none", "max"]
    edge, origin = draw(st.sampled_from([(1, 1), (2, 2), (4, 1), (2, 1)]))
    return PolarChart(kind, draw(st.sampled_from(kinks)), "algebraic", edge, origin)
