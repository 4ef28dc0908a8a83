"""Half vectors and charts: no direction is lost, doubled, or off by more than roundings."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import cases
import exact
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.special import erf
from strategies import azimuths, cosines, decades, whole_charts, widths

import albedo
from albedo.brdf import Model, Part
from albedo.charts.cosine import CosineChart
from albedo.charts.polar import KINKS, PolarChart
from albedo.charts.scan import ScanChart
from albedo.directions import half_vector, spherical
from albedo.geometry import cosine_power, mirror_offset2, normal_power, slope2, v_dot_h
from albedo.integrators.adaptive import Result, integrate
from albedo.integrators.rules import gauss

EPS = np.finfo(float).eps
mp = exact.mp


# Half vectors ------------------------------------------------------------------------------------


@st.composite
def pairs(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray]:
    """Two directions above the horizon, often close to each other's mirror image."""
    wi = spherical(draw(cosines), draw(azimuths))
    if draw(st.booleans()):
        return wi, spherical(draw(cosines), draw(azimuths))
    away = draw(decades(1e-9, 1.0)) * draw(st.sampled_from([1.0, wi[2]]))
    turn = draw(azimuths)
    wo = wi * np.array([-1.0, -1.0, 1.0]) + away * spherical(draw(st.floats(0.0, 1.0)), turn)
    return wi, wo / np.linalg.norm(wo)


def local(wi: np.ndarray, v: Any) -> list[Any]:
    """Components of a vector along and across the tangential part of wi, and along the normal."""
    t = mp.sqrt(mp.mpf(float(wi[0])) ** 2 + mp.mpf(float(wi[1])) ** 2)
    if t == 0:
        return list(v)
    x, y = mp.mpf(float(wi[0])) / t, mp.mpf(float(wi[1])) / t
    return [v[0] * x + v[1] * y, v[1] * x - v[0] * y, v[2]]


@given(pairs())
@settings(max_examples=300)
def test_half_vectors_of_raw_directions(pair: tuple[np.ndarray, np.ndarray]) -> None:
    wi, wo = pair
    light, view = exact.unit(wi), exact.unit(wo)
    u, w, z = local(wi, [a + b for a, b in zip(light, view, strict=True)])
    found = local(wi, [mp.mpf(float(x)) for x in half_vector(wi, wo)])
    _, v_w, v_z = local(wi, view)
    # Coordinates of unit vectors carry a rounding each, and the turn into the local frame two.
    assert abs(found[1] - w) <= 6 * EPS
    assert abs(found[2] - z) <= 6 * EPS * z
    loose = 6 * EPS
    if local(wi, view)[0] < 0 and math.hypot(wi[0], wi[1]) > wi[2]:
        # Opposite azimuths: the sum would cancel, and the difference of squares does not.
        loose *= min(1.0, 2.0 * abs(float(v_w)) + float(v_z) ** 2 + float(light[2]) ** 2 + 1e-16)
    assert abs(found[0] - u) <= loose


@given(pairs(), decades(1e-3, 1e9))
@settings(max_examples=200)
def test_cosines_of_half_vectors(pair: tuple[np.ndarray, np.ndarray], n: float) -> None:
    """What kernels read of h, and of V and R, for an h that is given exactly as it is."""
    wi, wo = pair
    h = half_vector(wi, wo)
    x, y, z = (mp.mpf(float(a)) for a in h)
    tan2 = (x * x + y * y) / (z * z)
    # Quotients, squares and a root: an ulp each.
    assert slope2(*h) == pytest.approx(float(tan2), rel=8 * EPS, abs=1e-300)
    assert v_dot_h(*h) == pytest.approx(
        float(mp.sqrt(x * x + y * y + z * z) / 2), rel=8 * EPS, abs=0.0
    )
    power = (1 + tan2) ** (-mp.mpf(n) / 2)
    if power > 1e-290:
        # The exponent is rounded four times.
        slack = (8 + 6 * abs(math.log(float(power)))) * EPS
        assert normal_power(slope2(*h), n) == pytest.approx(float(power), rel=slack, abs=0.0)
    offset = mirror_offset2(*wi, *h, wo[2])
    light, view = exact.unit(wi), exact.unit(wo)
    mirror = (-light[0], -light[1], light[2])
    expected = sum((a - b) ** 2 for a, b in zip(mirror, view, strict=True))
    # Each component of R - V is a coordinate of h or a difference of cosines, an ulp off.
    assert offset == pytest.approx(float(expected), abs=40 * EPS * float(mp.sqrt(expected)) + 1e-30)


@given(cosines, azimuths, azimuths, decades(1e-12, 0.5))
@settings(max_examples=200)
def test_the_distance_to_the_mirror_direction(c: float, phi: float, way: float, far: float) -> None:
    """Of half vectors as charts make them, correct to the last digits, the chord is as good."""
    light = exact.unit(spherical(c, phi))
    across = exact.unit((light[1], -light[0], 0)) if c < 1.0 else (mp.one, mp.zero, mp.zero)
    mirror = (-light[0], -light[1], light[2])
    along = [
        mirror[(i + 1) % 3] * across[(i + 2) % 3] - mirror[(i + 2) % 3] * across[(i + 1) % 3]
        for i in range(3)
    ]
    a, b = far * mp.cos(way), far * mp.sin(way)
    view = [r + a * u + b * v for r, u, v in zip(mirror, across, along, strict=True)]
    view = [x / mp.sqrt(sum(y * y for y in view)) for x in view]
    h = [x + y for x, y in zip(light, view, strict=True)]
    chord2 = sum((r - v) ** 2 for r, v in zip(mirror, view, strict=True))
    found = mirror_offset2(*map(float, light), *map(float, h), float(view[2]))
    if h[2] > 0:
        # l_z - v_z is a sum of products with h, over h.z, and where that is worse the difference.
        assert found == pytest.approx(float(chord2), rel=float(40 * EPS * (1 + 1 / h[2])), abs=0.0)


def test_powers_of_cosines() -> None:
    assert cosine_power(0.0, 1e9) == 1.0
    assert cosine_power(2.0, 0.0) == 0.0
    assert cosine_power(2.5, 3.0) == 0.0
    assert cosine_power(1.0, 3.0) == pytest.approx(0.125, rel=4 * EPS, abs=0.0)
    # cos(a)^n of an angle far below what 1 - cos(a) could tell: exp(-n a^2/2).
    assert cosine_power(1e-18, 1e18) == pytest.approx(math.exp(-0.5), rel=4 * EPS, abs=0.0)


HEMISPHERES = ("slope", "mirror_hemisphere", "retro_hemisphere")


# Charts ------------------------------------------------------------------------------------------


def rows_of(
    chart: Any,
    integrand: Any,
    cos_theta: Any,
    phi: Any,
    width: Any,
    isotropic: bool = False,
    rtol: float = 1e-11,
) -> Result:
    """Integrate over a chart, one row per direction; no direction may be refused."""
    c = np.atleast_1d(np.asarray(cos_theta, dtype=float))
    found = integrate(
        chart,
        integrand,
        *(c, np.broadcast_to(np.asarray(phi, dtype=float), c.shape).copy()),
        *(np.broadcast_to(np.asarray(width, dtype=float), (c.size, 2)).copy(), isotropic),
        rtol=rtol,
        atol=0.0,
        limit=4_000_000,
        probe=False,
    )
    assert np.all(np.isfinite(found.value)), "a panel was mistaken for another"
    return found


def one(row: np.ndarray, wi: np.ndarray, wo: np.ndarray, h: np.ndarray) -> np.ndarray:
    return np.ones(wo.shape[1:])


def holds(found: Result, expected: Any) -> None:
    """Within the bound, and within 1e-10: what was asked for is ten times less."""
    off = np.abs(found.value - expected)
    assert np.all(off <= found.error)
    assert np.all(off <= 1e-10 * np.abs(expected))


def check_nodes(chart: Any, cos_theta: float, phi: float, width: Any, isotropic: bool) -> None:
    geometry, row, code, box = chart.panels(
        np.array([cos_theta]), np.array([phi]), np.array([width]), isotropic
    )
    rule = gauss(5)
    wi, wo, h, weight = chart.nodes(geometry[row], code, box, rule.nodes, rule.nodes)
    light = spherical(cos_theta, phi)
    # Sines and cosines of two angles, and a turn.
    np.testing.assert_allclose(wi, np.repeat(light[:, None], wi.shape[1], 1), atol=4 * EPS)
    np.testing.assert_allclose(np.sum(wo * wo, axis=0), 1.0, atol=20 * EPS)
    np.testing.assert_allclose(h, wi[:, :, None] + wo, atol=10 * EPS)
    assert np.all(wo[2] >= 0.0)
    assert np.all(weight >= 0.0)
    # Nodes lie inside their panels: hardly any weight may vanish by rounding.
    assert np.mean(weight > 0.0) > 0.99


@given(whole_charts(), cosines, azimuths, widths())
@settings(max_examples=150)
def test_nodes_are_directions(chart: Any, c: float, phi: float, width: Any) -> None:
    check_nodes(chart, c, phi, width, False)
    check_nodes(chart, c, phi, (width[0], width[0]), True)


@given(cosines, azimuths, decades(0.02, 1.0))
@settings(max_examples=10)
def test_nodes_of_a_scan_are_directions(c: float, phi: float, width: float) -> None:
    check_nodes(ScanChart(width), c, phi, (1.0, 1.0), False)


@given(whole_charts(), cosines, azimuths, widths())
@settings(max_examples=150)
def test_the_hemisphere_is_covered_once(chart: Any, c: float, phi: float, width: Any) -> None:
    """The integral of n.v over the hemisphere is pi."""
    holds(rows_of(chart, one, c, phi, width), math.pi)
    holds(rows_of(chart, one, c, phi, (width[0], width[0]), isotropic=True), math.pi)


@pytest.mark.slow
@given(whole_charts(), cosines, azimuths, widths())
@settings(max_examples=4000)
def test_the_hemisphere_is_always_covered_once(
    chart: Any, c: float, phi: float, width: Any
) -> None:
    holds(rows_of(chart, one, c, phi, width), math.pi)
    holds(rows_of(chart, one, c, phi, (width[0], width[0]), isotropic=True), math.pi)


def random_rows(
    rng: np.random.Generator, count: int, ratio: float = 100.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cosines, azimuths and pairs of widths: many in one call."""
    c = np.where(rng.random(count) < 0.5, rng.random(count), 10.0 ** rng.uniform(-9, 0, count))
    phi = rng.uniform(-math.pi, math.pi, count)
    wide = 10.0 ** rng.uniform(-5, 1, count)
    pair = np.stack((wide, np.maximum(wide * ratio ** -rng.random(count), 1e-6)), axis=1)
    return c, phi, np.where(rng.random(count)[:, None] < 0.5, pair, pair[:, ::-1])


WHOLE = [(kind, kinks) for kind in HEMISPHERES for kinks in ("none", "max")] + [
    ("slope", "v_cavity")  # the masking curves are lines of half vectors
]


@pytest.mark.parametrize(("kind", "kinks"), WHOLE)
def test_the_hemisphere_is_covered_from_many_directions(
    kind: str, kinks: str, rng: np.random.Generator
) -> None:
    chart = PolarChart(kind, kinks)
    c, phi, width = random_rows(rng, 300)
    holds(rows_of(chart, one, c, phi, width), math.pi)
    holds(rows_of(chart, one, c, phi, width[:, :1], isotropic=True), math.pi)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "kinks"), WHOLE)
@pytest.mark.parametrize("rtol", [1e-6, 1e-9, 1e-11])
def test_the_hemisphere_is_covered_from_very_many_directions(
    kind: str, kinks: str, rtol: float, rng: np.random.Generator
) -> None:
    chart = PolarChart(kind, kinks)
    c, phi, width = random_rows(rng, 4000)
    for found in (
        rows_of(chart, one, c, phi, width, rtol=rtol),
        rows_of(chart, one, c, phi, width[:, :1], isotropic=True, rtol=rtol),
    ):
        assert np.all(np.abs(found.value - math.pi) <= found.error)


# Where the inner panels' ends cross, and where the lobe is as wide as the horizon is high: a
# feature next to the end of a panel, between it and the first node.
HIDDEN = [
    ("retro_hemisphere", "none", 1.0766743e-3, 0.9125, (5.8694549e-4, 6.34947915e-3)),
    ("retro_hemisphere", "max", 2.81952109e-3, -2.38996, (4.8129277e-3, 1.606349987e-4)),
    ("mirror_hemisphere", "max", 0.8927578283699517, 2.496531595, (6.5952332e-6, 3.877213556e-4)),
    ("slope", "max", 0.8683054311445979, -1.76223268, (1.76799342e-5, 1.98576786e-6)),
    ("retro_hemisphere", "max", 0.7071245475517526, -2.801398799, (2.14556633e-4,) * 2),
    ("mirror_hemisphere", "max", 0.7190639673007251, -2.915772093, (1.99526526e-4,) * 2),
]


@pytest.mark.parametrize(("kind", "kinks", "c", "phi", "width"), HIDDEN)
def test_no_panel_hides_a_feature_at_its_end(
    kind: str, kinks: str, c: float, phi: float, width: tuple[float, float]
) -> None:
    """Bounds that an even spectrum made far too small: the angle decides what the nodes miss."""
    # A row falls into the trap only if its nodes do, so its neighbours are tried as well.
    cosines = c * (1.0 + 1e-3 * np.arange(-20, 21))
    isotropic = width[0] == width[1]
    for rtol in (1e-10, 1e-11, 1e-12):
        found = rows_of(PolarChart(kind, kinks), one, cosines, phi, width, isotropic, rtol)
        assert np.all(np.abs(found.value - math.pi) <= found.error)


def larger_cosine(row: np.ndarray, wi: np.ndarray, wo: np.ndarray, h: np.ndarray) -> np.ndarray:
    return 1.0 / np.maximum(wi[2][:, None], wo[2])


@pytest.mark.parametrize(
    "chart",
    [
        CosineChart("max"),
        CosineChart("max", angle=True),
        *(PolarChart(kind, "max") for kind in HEMISPHERES),
    ],
    ids=str,
)
def test_the_kink_at_equal_cosines_lies_between_panels(
    chart: Any, rng: np.random.Generator
) -> None:
    """The integral of n.v/max(n.l, n.v) is pi (2 - n.l), and costs what a smooth one costs."""
    c, phi, width = random_rows(rng, 100)
    for isotropic, w in ((False, width), (True, width[:, :1])):
        found = rows_of(chart, larger_cosine, c, phi, w, isotropic)
        holds(found, math.pi * (2.0 - c))
        smooth = rows_of(chart, one, c, phi, w, isotropic)
        # Cutting cells down to a kink costs a hundred times more.
        assert np.median(found.evaluations) <= 3.0 * np.median(smooth.evaluations)


@given(cosines, azimuths, widths(), st.sampled_from(["none", "max"]), st.booleans())
@settings(max_examples=60)
def test_the_half_space_of_the_mirror_direction_is_covered_once(
    c: float, phi: float, width: Any, kinks: str, retro: bool
) -> None:
    """What is above the horizon and within 90 degrees of R (or L): a lune of (1 + cos)/2."""
    chart = PolarChart("retro" if retro else "mirror", kinks, "algebraic", edge=4)
    holds(rows_of(chart, one, c, phi, width), 0.5 * math.pi * (1.0 + c))


@given(cosines, azimuths, widths(), st.sampled_from(sorted(KINKS)))
@settings(max_examples=60)
def test_all_half_vectors_that_the_light_sees_are_covered_once(
    c: float, phi: float, width: Any, kinks: str
) -> None:
    """The integral of 4 (l.h) over visible half vectors is 2 pi (1 + cos)."""
    chart = PolarChart("slope", kinks, full=True)
    holds(rows_of(chart, one, c, phi, width), 2.0 * math.pi * (1.0 + c))


@given(cosines, azimuths)
@settings(max_examples=10)
def test_a_scan_covers_the_hemisphere_once(c: float, phi: float) -> None:
    holds(rows_of(ScanChart(0.1), one, c, phi, (1.0, 1.0)), math.pi)


@pytest.mark.parametrize(
    "chart",
    [PolarChart("slope", "max"), CosineChart("max"), CosineChart("max", angle=True)],
    ids=str,
)
def test_the_coarsest_panels_cover_the_hemisphere_too(chart: Any, rng: np.random.Generator) -> None:
    c, phi, _ = random_rows(rng, 40)
    c = np.maximum(c, 0.05)
    geometry, row, code, box = chart.panels(c, phi, np.ones((40, 2)), False, coarse=True)
    assert np.all(np.bincount(row) == 4)
    rule = gauss(200)
    *_, weight = chart.nodes(geometry[row], code, box, rule.nodes, rule.nodes)
    total = np.bincount(row, weights=weight @ np.outer(rule.weights, rule.weights).ravel())
    # Layers inside the panels at cos = 0.05 want more than 200 nodes for the tenth digit.
    np.testing.assert_allclose(total, math.pi, rtol=1e-9)


# Lobes that are cut ------------------------------------------------------------------------------


def gaussian_share(c: float, phi: float, width: tuple[float, float]) -> float:
    """The share of a Gaussian of slopes whose V is above the horizon, from error functions.

    In slopes along and across L's azimuth the exponent is a x^2 + 2 b x y + d y^2, and V is above
    the horizon between x = (y^2 - 1)/(t + r) and t + r, t = tan(theta), r^2 = 1/cos^2 - y^2.
    """
    cp, sp = math.cos(phi), math.sin(phi)
    k_x, k_y = width[0] ** -2.0, width[1] ** -2.0
    a = cp * cp * k_x + sp * sp * k_y
    b = cp * sp * (k_y - k_x)
    d = k_x * k_y / a  # d - b^2/a: what is left of y^2 once x is integrated
    tangent, secant = math.sqrt((1.0 - c) * (1.0 + c)) / c, 1.0 / c
    top = min(secant, 7.0 / math.sqrt(d))
    # The chord's ends turn at |y| = 1 and at the disk's edge; the rest is spread evenly.
    u, w = np.polynomial.legendre.leggauss(12)
    edges = np.linspace(-1.0, 1.0, 1201)
    # y = top sin(angle) takes the root at the edge of the disk away.
    angle = (
        0.25 * math.pi * (edges[1:] + edges[:-1])[:, None]
        + 0.25 * math.pi * (edges[1] - edges[0]) * u
    )
    y, dy = top * np.sin(angle), top * np.cos(angle) * 0.25 * math.pi * (edges[1] - edges[0]) * w
    root = np.sqrt(np.maximum((secant - np.abs(y)) * (secant + np.abs(y)), 0.0))
    shift, scale = b / a * y, math.sqrt(a)
    inside = erf(scale * (tangent + root + shift)) - erf(
        scale * ((y - 1.0) * (y + 1.0) / (tangent + root) + shift)
    )
    return float(np.sum(0.5 * inside * np.exp(-d * y * y) * math.sqrt(d / math.pi) * dy))


def slopes_of(h: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Slopes of h and q = 1 + x^2 + y^2."""
    x, y = h[0] / h[2], h[1] / h[2]
    return x, y, 1.0 + x * x + y * y


def gaussian_of(width: Any) -> Any:
    """The integrand that makes n.v dV f a Gaussian of the slopes, of integral 1."""
    w_x, w_y = np.broadcast_to(np.asarray(width, dtype=float), (*np.shape(width)[:-1], 2)).T

    def integrand(row: np.ndarray, wi: np.ndarray, wo: np.ndarray, h: np.ndarray) -> np.ndarray:
        a, b = (w_x[row, None], w_y[row, None]) if np.ndim(w_x) else (w_x, w_y)
        x, y, q = slopes_of(h)
        half = 0.5 * np.sqrt(h[0] ** 2 + h[1] ** 2 + h[2] ** 2)
        value = np.exp(-((x / a) ** 2) - (y / b) ** 2) / (math.pi * a * b) * q**1.5 / (4.0 * half)
        return np.where(wo[2] > 0.0, value / np.where(wo[2] > 0.0, wo[2], 1.0), 0.0)

    return integrand


@given(cosines, azimuths, widths(), st.sampled_from(sorted(KINKS)))
@settings(max_examples=100)
def test_a_gaussian_lobe_is_clipped_exactly(c: float, phi: float, width: Any, kinks: str) -> None:
    chart = PolarChart("slope", kinks, "gaussian")
    share = gaussian_share(c, phi, width)
    found = rows_of(chart, gaussian_of(width), c, phi, width)
    # Two sums of a thousand error functions; the lobe's cut leaves 1e-18.
    assert abs(found.value[0] - share) <= found.error[0] + 1e-13
    assert abs(found.value[0] - share) <= 1e-10


def test_gaussian_lobes_of_many_shapes_are_clipped_exactly(rng: np.random.Generator) -> None:
    c, phi, width = random_rows(rng, 150)
    shares = [gaussian_share(*row) for row in zip(c, phi, width, strict=True)]
    for kinks in KINKS:
        found = rows_of(PolarChart("slope", kinks, "gaussian"), gaussian_of(width), c, phi, width)
        assert np.all(np.abs(found.value - shares) <= found.error + 1e-13)
        assert np.all(np.abs(found.value - shares) <= 1e-10)


@given(cosines, azimuths, widths())
@example(0.375, 0.5, (0.01, 1.0))
@settings(max_examples=60)
def test_what_a_gaussian_surface_shows_is_known(c: float, phi: float, width: Any) -> None:
    """The integral of (l.h) D over visible half vectors is n.l (1 + Lambda(l)) of Smith."""
    light = spherical(c, phi)
    lost = float(exact.smith_lambda("beckmann", width, [mp.mpf(float(x)) for x in light]))

    def integrand(row: np.ndarray, wi: np.ndarray, wo: np.ndarray, h: np.ndarray) -> np.ndarray:
        # h.z cancels beyond the horizon; the direction is that of h all the same.
        x, y, q = slopes_of(h)
        e = np.exp(-((x / width[0]) ** 2) - (y / width[1]) ** 2)
        return e * q * q / (4.0 * math.pi * width[0] * width[1] * c)

    for kinks in KINKS:
        chart = PolarChart("slope", kinks, "gaussian", full=True)
        found = rows_of(chart, integrand, c, phi, width)
        # Lambda is as good as the azimuth of the light, which turns anisotropic widths.
        slack = 1e-13 * (1.0 + lost) * max(width) / min(width)
        assert abs(found.value[0] - 1.0 - lost) <= found.error[0] + slack
        assert abs(found.value[0] - 1.0 - lost) <= 1e-10 * (1.0 + lost) + slack


@given(cosines, azimuths, decades(1e-2, 1e9), decades(1.0, 1e4), st.sampled_from(["none", "max"]))
@settings(max_examples=60)
def test_powers_are_cut_without_loss(
    c: float, phi: float, n: float, ratio: float, kinks: str
) -> None:
    """(n.h)^n, anisotropic too, and (r.v)^n: a cut chart against one that covers everything."""
    n_v = max(n / ratio, 1e-3)

    def half_power(row: np.ndarray, wi: Any, wo: np.ndarray, h: np.ndarray) -> np.ndarray:
        x2, y2 = (h[0] / h[2]) ** 2, (h[1] / h[2]) ** 2
        exponent = (n * x2 + n_v * y2) / np.maximum(x2 + y2, 1e-300)
        return np.exp(-0.5 * exponent * np.log1p(x2 + y2))

    def mirror_power(row: np.ndarray, wi: Any, wo: np.ndarray, h: np.ndarray) -> np.ndarray:
        d2 = h[0] ** 2 + h[1] ** 2 + (wi[2][:, None] - wo[2]) ** 2
        return np.exp(n * np.log1p(-0.5 * np.minimum(d2, 1.99999)))

    half_width = tuple(min(1.0, math.sqrt(2.0 / max(k, 2.0))) for k in (n, n_v))
    mirror_width = (min(1.0, math.sqrt(0.5 / max(n, 0.5))),) * 2
    for kind, integrand, width, lowest in (
        ("slope", half_power, half_width, n_v),
        ("mirror", mirror_power, mirror_width, n),
    ):
        cut = PolarChart(kind, kinks, "cosine_power", edge=4 if lowest < 16 else 1)
        found, whole = (
            rows_of(chart, integrand, c, phi, width, rtol=1e-8)
            for chart in (cut, replace(cut, decay="algebraic"))
        )
        gap = abs(found.value[0] - whole.value[0])
        assert gap <= found.error[0] + whole.error[0]
        assert gap <= 2e-8 * whole.value[0]


def shown_of(c: np.ndarray, width: np.ndarray) -> Any:
    """The integrand of what a Gaussian surface shows, per n.l."""

    def integrand(row: np.ndarray, wi: np.ndarray, wo: np.ndarray, h: np.ndarray) -> np.ndarray:
        x, y, q = slopes_of(h)
        w_x, w_y = width[row, :1], width[row, 1:]
        e = np.exp(-((x / w_x) ** 2) - (y / w_y) ** 2)
        return e * q * q / (4.0 * math.pi * w_x * w_y * c[row, None])

    return integrand


def half_powers_of(width: np.ndarray) -> Any:
    """Powers of n.h whose exponents differ along x and y."""

    def integrand(row: np.ndarray, wi: np.ndarray, wo: np.ndarray, h: np.ndarray) -> np.ndarray:
        n_x, n_y = 2.0 / width[row, :1] ** 2, 2.0 / width[row, 1:] ** 2
        x2, y2 = (h[0] / h[2]) ** 2, (h[1] / h[2]) ** 2
        exponent = (n_x * x2 + n_y * y2) / np.maximum(x2 + y2, 1e-300)
        return np.exp(-0.5 * exponent * np.log1p(x2 + y2)) * np.sqrt(n_x * n_y)

    return integrand


def mirror_powers_of(width: np.ndarray) -> Any:
    """Powers of r.v whose exponents differ with the azimuth of h."""

    def integrand(row: np.ndarray, wi: np.ndarray, wo: np.ndarray, h: np.ndarray) -> np.ndarray:
        n_x, n_y = 0.5 / width[row, :1] ** 2, 0.5 / width[row, 1:] ** 2
        x2, y2 = h[0] ** 2, h[1] ** 2
        exponent = (n_x * x2 + n_y * y2) / np.maximum(x2 + y2, 1e-300)
        d2 = x2 + y2 + (wi[2][:, None] - wo[2]) ** 2
        return np.exp(exponent * np.log1p(-0.5 * np.minimum(d2, 1.99999))) * np.sqrt(n_x * n_y)

    return integrand


@pytest.mark.parametrize("ratio", [100.0, 3e4])
@pytest.mark.parametrize("kind", ["slope", "full", "mirror_in_slopes"])
def test_elliptic_lobes_are_not_hidden_between_kinks_and_nodes(
    kind: str, ratio: float, rng: np.random.Generator
) -> None:
    """A smooth integrand over panels that end at n.v = n.l is what it is over panels that do not.

    Where a lobe is narrow along one axis the kink crosses most of it in a small part of a panel,
    which few nodes did not see: about one row in 100 to 10 000 had too small a bound.
    """
    full, tolerances = kind == "full", (1e-8, 1e-6, 1e-4)
    count = 400 if full else 2500
    broad, grazing = rng.uniform(0.01, 1.0, count), 10.0 ** rng.uniform(-4.0, 0.0, count)
    c = np.where(rng.random(count) < 0.6, broad, grazing)
    phi = rng.uniform(0.0, 2.0 * math.pi, count)
    wide = 10.0 ** rng.uniform(-3.0 if full else -2.0, -0.5, count)
    pair = np.stack((wide, wide * ratio ** -rng.random(count)), axis=1)
    width = np.where(rng.random(count)[:, None] < 0.5, pair, pair[:, ::-1])
    if full:
        integrand, decay = shown_of(c, width), "gaussian"
    else:
        powers = half_powers_of if kind == "slope" else mirror_powers_of
        integrand, decay = powers(width), "cosine_power"
    chart = PolarChart("slope" if full else kind, "max", decay, full=full)
    smooth = rows_of(replace(chart, kinks="none"), integrand, c, phi, width, rtol=1e-8)
    for rtol in tolerances:
        found = rows_of(chart, integrand, c, phi, width, rtol=rtol)
        off = np.abs(found.value - smooth.value)
        # Both may err, and an azimuth is only as good as the ratio of the widths lets it be.
        slack = 1e-13 * found.value * width.max(1) / width.min(1)
        over = np.flatnonzero(off > found.error + smooth.error + slack)
        assert over.size == 0, (rtol, c[over], phi[over], width[over])


@given(decades(1e-3, 1e9), cosines)
@settings(max_examples=150)
def test_phong_is_known_at_every_angle(n: float, c: float) -> None:
    found = albedo.directional_albedo(albedo.model("phong", n=n), c, rtol=1e-10)
    # The closed form is rounded once.
    assert abs(found.value - exact.phong(n, c)) <= found.error + EPS
    assert found.converged


def uncut(part: Part) -> Part:
    """A part whose charts cover the hemisphere, however its lobe falls."""
    charts = {
        name: replace(chart, decay="algebraic")
        for name, chart in (("chart", part.chart), ("loss_chart", part.loss_chart))
        if isinstance(chart, PolarChart)
    }
    return replace(part, **charts)


def cuts(part: Part) -> bool:
    return isinstance(part.chart, PolarChart) and part.chart.decay != "algebraic"


# Without its cut max_phong_anisotropic is too sharp a needle for any polar chart; see below.
CUT = [
    kind
    for name, kind in albedo.models().items()
    if any(map(cuts, kind().parts())) and name != "max_phong_anisotropic"
]


@pytest.mark.parametrize("kind", CUT, ids=lambda kind: kind.name)
@pytest.mark.filterwarnings("ignore::albedo.ConvergenceWarning")
def test_no_model_loses_energy_where_its_lobe_is_cut(
    kind: type[Model], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What lies beyond a cut is far below the bound, for widths and powers at their ends too."""
    c = np.array([1.0, 0.8, 0.3, 0.03, 1e-5])
    parts_of = kind.parts
    models = [m for m in cases.extreme(kind) if any(map(cuts, m.parts()))]
    models = [m for m in models if m.parameters.get("fresnel", "white") == "white"]
    phi = {m: np.array([0.0] if m.isotropic else [0.0, 0.7, 0.5 * math.pi]) for m in models}
    losses = [(m, True) for m in models if m.parts()[0].loss is not None]
    quantities = [(m, False) for m in models] + losses

    def measured(rtol: float) -> list[albedo.Estimate]:
        return [
            albedo.directional_albedo(m, c, phi[m][:, None], rtol=rtol, complement=loss)
            for m, loss in quantities
        ]

    cut = measured(1e-7)
    monkeypatch.setattr(kind, "parts", lambda self: tuple(map(uncut, parts_of(self))))
    # No lobe is meant to be measured on a chart that does not end with it: with care.
    whole_ones = measured(1e-9)
    for (model, _), found, whole in zip(quantities, cut, whole_ones, strict=True):
        assert np.all(np.isfinite(found.value)), model.spec
        # Where the uncut chart gives up there is nothing to compare with.
        known = np.isfinite(whole.value)
        off = np.abs(found.value - whole.value)[known]
        assert off.size
        assert np.all(off <= (found.error + whole.error)[known]), model.spec


@pytest.mark.parametrize("exponents", [(1e3, 10.0), (10.0, 1e3), (1e3, 100.0), (300.0, 1.0)])
def test_the_anisotropic_lobe_about_the_mirror_direction_is_all_there(
    exponents: tuple[float, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its exponent turns with l + v, and so does its cut: against a chart that has no cut."""
    model = albedo.model("max_phong_anisotropic", n_u=exponents[0], n_v=exponents[1])
    c, phi = np.array([1.0, 0.8, 0.5, 0.2, 0.05]), np.array([0.0, 0.7, 0.5 * math.pi])
    found = albedo.directional_albedo(model, c, phi[:, None], rtol=1e-8)
    parts = tuple(replace(part, chart=CosineChart("max")) for part in model.parts())
    monkeypatch.setattr(type(model), "parts", lambda self: parts)
    whole = albedo.directional_albedo(model, c, phi[:, None], rtol=1e-7, max_evaluations=10_000_000)
    assert np.all(np.abs(found.value - whole.value) <= found.error + whole.error)


@pytest.mark.parametrize("n", [2.0, 10.0, 100.0, 1e5])
def test_no_sliver_is_left_out_between_azimuths_at_which_kinks_meet(n: float) -> None:
    """At grazing incidence the lobe's end meets the kink and the horizon at about one azimuth."""
    c = np.geomspace(1e-9, 1e-4, 31)
    laid_out_about_r = albedo.directional_albedo(albedo.model("max_phong", n=n), c, rtol=1e-12)
    in_slopes = albedo.model("max_phong_anisotropic", n_u=n, n_v=n)
    found = albedo.directional_albedo(in_slopes, c, rtol=1e-12)
    difference = np.abs(found.value - laid_out_about_r.value)
    assert np.all(difference <= found.error + laid_out_about_r.error)


@pytest.mark.filterwarnings("ignore::albedo.ConvergenceWarning")
def test_no_direction_is_refused_for_lobes_like_needles() -> None:
    phi = np.array([0.0, 0.7, 0.5 * math.pi, 2.0])
    c = np.append(np.geomspace(1e-6, 1.0, 60), 0.7912342618981326 + 1e-4 * np.arange(-20, 21))
    for a, b in ((1e-3, 1.0), (1e-4, 0.1), (1e-6, 1.0), (1e-7, 0.1)):
        needle = albedo.model("cook_torrance", distribution="ggx", alpha_x=a, alpha_y=b)
        found = albedo.directional_albedo(needle, c, phi[:, None], rtol=1e-6, complement=True)
        assert np.all(np.isfinite(found.value)), needle.spec


def test_a_chart_with_a_turn_has_no_kinks() -> None:
    with pytest.raises(ValueError, match="no kinks"):
        PolarChart("slope", kinks="max", turn=0.1)
