"""Cylinders on a floor: against ray tracing, points that see the sky, and limits; their chart."""

from __future__ import annotations

import math
from statistics import NormalDist
from typing import Any

import exact
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import azimuths, cosines, decades

import albedo
from albedo.catalogue.blinn import normalization
from albedo.catalogue.poulin_fournier import arc_diffuse, arc_specular, overlap
from albedo.charts.groove import GrooveChart
from albedo.directions import spherical
from albedo.errors import InputError
from albedo.integrators.adaptive import integrate
from albedo.integrators.rules import gauss

EPS = np.finfo(float).eps
mp = exact.mp

# Spacing and height of the floor: touching, overlapping below the floor, apart, flat, far apart.
SECTIONS = [(2.0, 0.0), (1.3, 0.8), (3.0, 0.5), (2.1, 0.05), (4.0, 0.99), (30.0, 0.2)]


@st.composite
def sections(draw: st.DrawFn) -> tuple[float, float]:
    """Spacing and elevation, from caps that touch to cylinders that stand alone."""
    elevation = draw(decades(1e-4, 1.0))
    least = 2.0 * math.sqrt(elevation * (2.0 - elevation))
    return least * (1.0 + draw(st.just(0.0) | decades(1e-9, 1e3))), elevation


# The chart ---------------------------------------------------------------------------------------


lobes = st.sampled_from([0.0, 1.0, 2.0**-5])


@given(sections(), lobes, cosines, azimuths)
@settings(max_examples=150)
def test_nodes_are_directions(section: Any, lobe: float, c: float, phi: float) -> None:
    chart = GrooveChart(lobe)
    geometry, row, code, box = chart.panels(
        np.array([c]), np.array([phi]), np.array([section]), False
    )
    rule = gauss(5)
    wi, wo, h, weight = chart.nodes(geometry[row], code, box, rule.nodes, rule.nodes)
    # Sines and cosines of two angles.
    np.testing.assert_allclose(
        wi, np.repeat(spherical(c, phi)[:, None], wi.shape[1], 1), atol=4e-16
    )
    np.testing.assert_allclose(np.sum(wo * wo, axis=0), 1.0, atol=20 * EPS)
    np.testing.assert_allclose(h, wi[:, :, None] + wo, atol=20 * EPS)
    assert np.all(wo[2] >= 0.0)
    assert np.all(weight >= 0.0)


def covered(section: Any, lobe: float, c: float, phi: float) -> tuple[float, float]:
    """The integral of n.v over the hemisphere, and its bound."""
    found = integrate(
        GrooveChart(lobe),
        lambda row, wi, wo, h: np.ones(wo.shape[1:]),
        *(np.array([c]), np.array([phi]), np.array([section]), False),
        rtol=1e-11,
        atol=0.0,
        limit=4_000_000,
        probe=False,
    )
    return float(found.value[0]), float(found.error[0])


@given(sections(), lobes, cosines, azimuths)
@settings(max_examples=60)
def test_the_hemisphere_is_covered_once(section: Any, lobe: float, c: float, phi: float) -> None:
    """The integral of n.v over the hemisphere is pi."""
    value, error = covered(section, lobe, c, phi)
    assert abs(value - math.pi) <= error
    # What was asked for is ten times less.
    assert abs(value - math.pi) <= 1e-10 * math.pi


@pytest.mark.filterwarnings("ignore::albedo.ConvergenceWarning")
@pytest.mark.parametrize("section", SECTIONS)
def test_all_kinks_lie_between_panels(section: Any, rng: np.random.Generator) -> None:
    """A kink inside a panel would be cut down to, at many times the cost."""
    model = albedo.model("poulin_fournier", spacing=section[0], floor_height=section[1])
    cosines = np.where(rng.random(60) < 0.5, rng.random(60), 10.0 ** rng.uniform(-9, 0, 60))
    found = albedo.directional_albedo(model, cosines, rng.uniform(-4, 4, 60), rtol=1e-12)
    assert np.all(found.converged)
    # Measured over all sections: 7,064. Halving cells down to a kink takes some 40 rounds of two
    # cells with 16 by 16 nodes and more.
    assert np.max(found.evaluations) <= 40 * 2 * 16 * 16


# The section -------------------------------------------------------------------------------------


@given(sections(), decades(1e-9, 1.0))
@settings(max_examples=300)
def test_what_is_seen_fills_the_view(section: Any, height: float) -> None:
    """The projections of arc and floor sum to the projection of one period, D sin(eta)."""
    spacing, elevation = section
    cap = 2.0 * math.asin(math.sqrt(0.5 * elevation))
    for y in (1.0, -1.0):
        eta, sine, _, _, away, towards, floor = overlap(
            *(0.0, y, height, 0.0, y, height, spacing, cap)
        )
        arc, start = away + towards, eta - away
        projected = 2.0 * math.sin(0.5 * arc) * math.sin(start + 0.5 * arc)
        # About ten roundings of angles, of which the largest may be pi.
        assert projected + floor * sine == pytest.approx(
            spacing * sine, rel=40 * EPS, abs=20 * EPS * (eta + cap) * min(1.0, arc)
        )


@pytest.mark.parametrize("e", [0.0, 0.1, 1.5, 7.9, 8.1, 30.0, 300.0, 1000.0])
def test_the_rule_over_an_arc_is_exact(e: float, rng: np.random.Generator) -> None:
    """The specular integral against tanh-sinh quadrature in 40 digits."""
    for up_v in (True, False):
        for _ in range(12):
            arc = float(rng.choice([math.pi, 10.0 ** rng.uniform(-6, 0.4)])) * 0.999
            start_l = float(rng.choice([0.0, rng.random()])) * (math.pi - arc) * 0.5
            start_v = float(rng.choice([0.0, rng.random()])) * (math.pi - arc) * 0.5
            # Heights of H lie between those of L and V.
            start_h = start_l + (start_v - start_l) * float(rng.random()) if up_v else 0.3
            start_h = min(start_h, math.pi - arc)
            found = arc_specular(start_l, True, start_v, up_v, start_h, arc, e, 0.0)

            def wanted(
                x: Any,
                arc: float = arc,
                at: tuple[float, ...] = (start_l, start_v, start_h),
                up_v: bool = up_v,
            ) -> Any:
                t = mp.mpf(arc) * x
                n_v = mp.sin(at[1] + (t if up_v else arc - t))
                return mp.sin(at[0] + t) * n_v * exact.power(mp.sin(at[2] + t), e)

            cuts = [mp.mpf(k) / 24 for k in range(25)]
            top = max(wanted(x) for x in cuts)
            value = float(mp.quad(lambda x, top=top: wanted(x) / top, cuts) * top * arc)
            # A rounding of an angle is amplified by e, where the lobe is steep; sums of 64 terms.
            assert found == pytest.approx(value, rel=(40 + 8 * e) * EPS)
            if e == 0.0:
                plain = arc_diffuse(start_l, start_v, arc, up_v)
                assert plain == pytest.approx(value, rel=40 * EPS)


# Ray tracing -------------------------------------------------------------------------------------


def traced(
    p: dict[str, Any], wi: np.ndarray, count: int, rng: np.random.Generator
) -> tuple[float, float]:
    """Albedo for one bounce by Monte Carlo, and its standard deviation.

    Light falls on circles and a floor; one direction is drawn about the normal where it meets
    them, and counts if nothing stands in its way. Nothing is known here of arcs and shadows.
    """
    spacing, f = p["spacing"], p["floor_height"]
    centres = spacing * np.arange(-12, 13)
    start = np.stack((rng.uniform(0.0, spacing, count), np.ones(count)))
    down = -wi[1:] / math.hypot(wi[1], wi[2])
    # Where a ray meets the floor and the circles; the nearest counts.
    travel = np.full(count, (f - 1.0) / down[1])
    normal = np.tile(np.array([[0.0], [0.0], [1.0]]), count)
    for centre in centres:
        off = start - np.array([[centre], [0.0]])
        along = off[0] * down[0] + off[1] * down[1]
        inside = along**2 - (off[0] ** 2 + off[1] ** 2 - 1.0)
        t = -along - np.sqrt(np.maximum(inside, 0.0))
        nearer = (inside > 0.0) & (t < travel)
        travel = np.where(nearer, t, travel)
        at = off + t * down[:, None]
        normal[1] = np.where(nearer, at[0], normal[1])
        normal[2] = np.where(nearer, at[1], normal[2])
    point = start + travel * down[:, None]
    # A direction with density n.v/pi: a point on a sphere that touches the surface from above.
    z, turn = rng.uniform(-1.0, 1.0, count), rng.uniform(0.0, 2.0 * math.pi, count)
    r = np.sqrt(1.0 - z * z)
    view = normal + np.stack((r * np.cos(turn), r * np.sin(turn), z))
    view /= np.linalg.norm(view, axis=0)
    escapes = view[2] > 0.0
    for centre in centres:
        away = np.stack((centre - point[0], -point[1]))
        forward = away[0] * view[1] + away[1] * view[2]
        length = np.hypot(view[1], view[2])
        offset = (away[0] * view[2] - away[1] * view[1]) / length
        own = away[0] ** 2 + away[1] ** 2 < 1.0 + 1e-9
        escapes &= own | (forward <= 0.0) | (np.abs(offset) >= 1.0)
    if p.get("base") == "specular":
        half = view + wi[:, None]
        cosine = np.sum(half * normal, axis=0) / np.linalg.norm(half, axis=0)
        share = math.pi * p["k_s"] * cosine ** p["e"]
    else:
        share = np.full(count, p.get("rho", 1.0))
    share = share * escapes
    return float(share.mean()), float(share.std() / math.sqrt(count))


TRACED: list[tuple[dict[str, Any], float, float]] = [
    ({"spacing": 2.0, "floor_height": 0.0}, 0.9, 1.2),
    ({"spacing": 3.0, "floor_height": 0.5, "rho": 0.8}, 1.0, 0.0),
    ({"spacing": 3.0, "floor_height": 0.5}, 0.5, 1.5),
    ({"spacing": 3.0, "floor_height": 0.5}, 0.75, -1.5),
    ({"spacing": 1.3, "floor_height": 0.8}, 0.2, 2.5),
    ({"spacing": 6.0, "floor_height": 0.3}, 0.3, -1.0),
    ({"spacing": 3.0, "floor_height": 0.5, "base": "specular", "e": 20.0, "k_s": 1.0}, 0.6, 1.4),
    ({"spacing": 2.0, "floor_height": 0.0, "base": "specular", "e": 3.0, "k_s": 0.4}, 0.9, 0.5),
    ({"spacing": 1.3, "floor_height": 0.8, "base": "specular", "e": 80.0, "k_s": 3.0}, 0.4, -2.0),
]


@pytest.mark.parametrize(("p", "c", "phi"), TRACED)
def test_albedos_are_those_of_ray_tracing(
    p: dict[str, Any], c: float, phi: float, rng: np.random.Generator
) -> None:
    found = albedo.directional_albedo(albedo.model("poulin_fournier", **p), c, phi)
    value, deviation = traced(p, spherical(c, phi), 1_600_000, rng)
    # One in a million that any of these fails by chance.
    limit = NormalDist().inv_cdf(1.0 - 0.5e-6 / len(TRACED))
    assert abs(value - float(found.value)) <= limit * deviation + float(found.error)
    # The check is worth one and a half percent.
    assert limit * deviation <= 1.5e-2 * float(found.value) + 1e-3


# Points that see the sky -------------------------------------------------------------------------


def horizon(x: Any, z: Any, spacing: Any, sign: int) -> Any:
    """The angle to the normal at which the neighbour on one side leaves the sky to a point."""
    dx, dz = sign * spacing - x, -z
    return mp.atan2(sign * dx, dz) - mp.asin(min(mp.one, 1 / mp.hypot(dx, dz)))


def diffuse_albedo(spacing: float, f: float, psi: Any) -> float:
    """Albedo for rho = 1: what each lit point receives, times its share of the sky.

    In the plane a point sees the sky from -b to a about the normal, and its share of it, from a
    surface that is tilted by phi, is (sin(a - phi) + sin(b + phi))/2.
    """
    spacing, f = mp.mpf(spacing), mp.mpf(f)
    cap, w = mp.acos(f), mp.sqrt(1 - f * f)

    def ends(phi: Any) -> tuple[Any, Any]:
        x, z = mp.sin(phi), mp.cos(phi)
        a = min(mp.pi / 2, phi + mp.pi / 2, horizon(x, z, spacing, 1))
        return a, min(mp.pi / 2, mp.pi / 2 - phi, horizon(x, z, spacing, -1))

    def floor_ends(x: Any) -> tuple[Any, Any]:
        return horizon(x, f, spacing, 1), horizon(spacing - x, f, spacing, 1)

    def last_lit(inside: Any, outside: Any, to: Any) -> Any:
        """How far from a lit point towards another one the light reaches."""
        if to(outside)[0] >= psi:
            return outside
        for _ in range(140):
            middle = (inside + outside) / 2
            inside, outside = (middle, outside) if to(middle)[0] >= psi else (inside, middle)
        return inside

    def share(phi: Any) -> Any:
        a, b = ends(phi)
        return mp.cos(phi - psi) * (mp.sin(a - phi) + mp.sin(b + phi)) / 2

    def floor_share(x: Any) -> Any:
        a, b = floor_ends(x)
        return mp.cos(psi) * (mp.sin(a) + mp.sin(b)) / 2

    left, right = last_lit(mp.zero, -cap, ends), last_lit(mp.zero, cap, ends)
    total = mp.quad(share, [left, 0, right])
    if floor_ends(w)[0] > psi and spacing > 2 * w:
        total += mp.quad(floor_share, [w, last_lit(w, spacing - w, floor_ends)])
    return float(total / (spacing * mp.cos(psi)))


@pytest.mark.parametrize("section", SECTIONS)
@pytest.mark.parametrize(("c", "phi"), [(1.0, 0.0), (0.8, 1.0), (0.3, -1.4), (1e-3, 1.5), (0.1, 0)])
def test_diffuse_albedos_are_sums_over_points_that_see_the_sky(
    section: tuple[float, float], c: float, phi: float
) -> None:
    model = albedo.model("poulin_fournier", spacing=section[0], floor_height=section[1])
    found = albedo.directional_albedo(model, c, phi, rtol=1e-12)
    light = spherical(c, phi)
    with mp.workdps(30):
        psi = mp.atan2(abs(light[1]), light[2])
        expected = diffuse_albedo(*section, psi)
    # The last digit of the expected value.
    assert abs(float(found.value) - expected) <= float(found.error) + EPS


# Limits ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("section", SECTIONS)
def test_a_specular_material_without_a_lobe_is_diffuse(section: tuple[float, float]) -> None:
    """(n.h)^0 k_s with k_s = 1/pi, on another chart and by quadrature over the arc."""
    same = {"spacing": section[0], "floor_height": section[1]}
    c, phi = np.array([1.0, 0.6, 0.1, 1e-4]), np.array([[0.0], [0.9], [1.5]])
    diffuse = albedo.directional_albedo(albedo.model("poulin_fournier", **same), c, phi)
    flat = albedo.model("poulin_fournier", base="specular", e=0.0, k_s=1.0 / math.pi, **same)
    specular = albedo.directional_albedo(flat, c, phi)
    assert np.all(np.abs(diffuse.value - specular.value) <= diffuse.error + specular.error)


@pytest.mark.parametrize("spacing", [100.0, 1e4])
def test_cylinders_that_are_far_apart_leave_the_floor(spacing: float) -> None:
    """A cylinder takes 1/cos(psi) of the light of a length D, and shadows as much to the view."""
    c, phi = np.array([1.0, 0.8, 0.5]), 0.7
    far = {"spacing": spacing, "floor_height": 0.5}
    found = albedo.directional_albedo(albedo.model("poulin_fournier", rho=0.6, **far), c, phi)
    assert np.all(found.value < 0.6)
    assert np.all(found.value > 0.6 * (1.0 - 4.0 / spacing))
    lobe = albedo.model("poulin_fournier", base="specular", e=30.0, k_s=normalization(30.0), **far)
    found = albedo.directional_albedo(lobe, c, phi)
    floor = albedo.directional_albedo(albedo.model("blinn", n=30.0), c, phi)
    # The lobe sends most of its light within 60 degrees of the mirror direction.
    assert np.all(np.abs(found.value - floor.value) <= 8.0 / spacing)


def test_light_that_grazes_across_finds_the_tops_alone() -> None:
    """They see the whole sky, so that the albedo tends to rho, with the root of the height."""
    model = albedo.model("poulin_fournier")
    c = 10.0 ** np.arange(-12.0, -3.0, 2.0)
    lost = 1.0 - albedo.directional_albedo(model, c, 0.5 * math.pi).value
    # What is lost is of the first order in the arc that is lit, sqrt(2 D c), or less.
    assert np.all(lost >= 0.0)
    assert np.all(lost <= np.sqrt(2.0 * model.spacing * c))


def test_cylinders_that_overlap_are_refused() -> None:
    with pytest.raises(InputError, match=r"spacing = 1.5 .* floor_height = 0.5 .* 1.73205"):
        albedo.model("poulin_fournier", spacing=1.5)
    albedo.model("poulin_fournier", spacing=2.0, floor_height=0.0)
    albedo.model("poulin_fournier", spacing=1.2, floor_height=0.8)
