"""Pumping-up by tables over height and azimuth: any lobe, isotropic or not."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from steps import nystrom

import albedo
from albedo._compile import kernel
from albedo.brdf import Model, Part, Real
from albedo.charts._compiled import clustered
from albedo.charts.cosine import CosineChart
from albedo.charts.heights import folded
from albedo.directions import spherical
from albedo.errors import InputError
from albedo.integrators.adaptive import integrate
from albedo.integrators.cells import ModelIntegrand
from albedo.operators.levels import critical_levels
from albedo.operators.mapping import log_map
from albedo.operators.maps import Maps, directions_of
from albedo.operators.pump import _of_stage
from albedo.operators.split import SplitChart, cut_along
from albedo.operators.stages import Stages, stages


@kernel
def fill_saddle(wi, wo, h, p, out):
    """f = g(l) g(v)/pi, g = 1 + b (x^2 - y^2): its albedo is g."""
    for j in range(out.shape[0]):
        b = p[j, 0]
        light = 1.0 + b * (wi[0, j] - wi[1, j]) * (wi[0, j] + wi[1, j])
        for i in range(out.shape[1]):
            x, y = wo[0, j, i], wo[1, j, i]
            out[j, i] = light * (1.0 + b * (x - y) * (x + y)) / math.pi


class Saddle(Model):
    """A model whose albedo has a saddle at the normal, and whose steps are integrals over levels.

    Over the unit disk of (x, y), s = x^2 - y^2 has the density arcosh(1/|s|)/pi. With g = 1 + b s
    the albedo after k steps is a function A_k of s, which rises with s: A_0 = g, and
    A_k(s) = int min(g, g')/(A_1 ... A_(k-1))(the larger of s and s') arcosh(1/|s'|)/pi ds'.
    """

    name = "saddle"
    title = "product of two saddles"
    equation = "none"
    isotropic = False
    conserves_energy = False
    b = Real(0.5, "height of the saddle", low=0.0, high=0.9)

    def pack(self) -> tuple[float, ...]:
        return (self.b,)

    def parts(self) -> tuple[Part, ...]:
        return (Part("diffuse", fill_saddle, CosineChart()),)

    def level(self, wi: np.ndarray) -> np.ndarray:
        """s for unit vectors (n, 3)."""
        found: np.ndarray = (wi[:, 0] - wi[:, 1]) * (wi[:, 0] + wi[:, 1])
        return found

    def after(self, steps: int, level: float) -> float:
        """The albedo after some steps, by plain rules between the places that are not smooth."""
        if steps == 0:
            return 1.0 + self.b * level
        x, w = np.polynomial.legendre.leggauss(40)
        # The density is a logarithm at 0 and a root at both ends.
        x, w = 0.5 * (x + 1.0), 0.5 * w
        x, w = x**4 * (5.0 - 4.0 * x), w * 20.0 * x**3 * (1.0 - x)
        total = 0.0
        ends = sorted({-1.0, 0.0, 1.0, level})
        for low, high in itertools.pairwise(ends):
            for s, near, share in ((low, high, 1.0), (high, low, -1.0)):
                place = s + 0.5 * (near - s) * x
                weight = 0.5 * (near - s) * share * w
                larger = np.maximum(place, level)
                value = 1.0 + self.b * np.minimum(place, level)
                for k in range(1, steps):
                    value = value / np.array([self.after(k, t) for t in larger])
                total += float(weight @ (value * np.arccosh(1.0 / np.abs(place)) / math.pi))
        return total


class Turned(type(albedo.model("ward"))):  # type: ignore[misc]
    """Ward's model, whose azimuths are told from one another."""

    isotropic = False


COSINES = np.array([1.0, 0.9, 0.5, 0.2, 0.05, 1e-3, 1e-6])
PHONG = albedo.model("phong", n=20)
WARD = albedo.model("ward", m=0.4)
ELLIPTIC = albedo.model("ward", alpha_x=0.4, alpha_y=0.2)
SCALED = albedo.model("lafortune_scaled")
UPRIGHT = albedo.model("lafortune", lobes=((0.0, 0.0, 1.0, 1.0),))
GGX = albedo.model("cook_torrance", alpha_x=0.3, alpha_y=0.1, distribution="ggx")
RETRO = albedo.model("lafortune", lobes=((0.9, 0.9, 0.9, 10.0),), rho_d=0.2)


@pytest.mark.parametrize(
    ("base", "control", "steps"),
    [
        (PHONG, None, 3),
        (PHONG, "cumulative", 2),
        (WARD, None, 2),
        (WARD, "literal", 2),
        (albedo.model("oren_nayar"), None, 2),
        (SCALED, None, 2),
        (RETRO, "literal", 2),
    ],
    ids=str,
)
def test_tables_agree_with_sums_over_rings(base: Model, control: str | None, steps: int) -> None:
    """Two ways to the same albedos: other charts, other tables, other bounds."""
    by_tables = Stages(base, control, 1e-5, _of_stage)
    for k, table in enumerate(by_tables.albedos(steps)):
        exact = albedo.pump(base, k, control, rtol=7e-11)
        known = albedo.directional_albedo(exact, COSINES, rtol=1e-9)
        values = table.at(spherical(COSINES, 0.3))
        # What all tables before may err by, and the own error.
        slack = by_tables.doubt(k) + table.error.max()
        assert slack <= 1e-3
        assert np.all(np.abs(values - known.value) <= slack * known.value + known.error)


@pytest.mark.parametrize("base", [SCALED, RETRO, UPRIGHT], ids=str)
def test_lobes_may_lie_anywhere(base: Model) -> None:
    by_tables = Stages(base, None, 1e-5, _of_stage)
    for k, table in enumerate(by_tables.albedos(3)[1:], 1):
        misses = []
        for size in (48, 96):
            c, value = nystrom(base, None, k, size)
            inside = (c > 0.15) & (c < 0.99)
            found = table.at(spherical(c[inside], 0.3))
            misses.append(float(np.max(np.abs(value[inside] - found))))
        # A kink makes the other method of second order, see test_pump.py.
        assert misses[0] <= 3.0 / 48**2
        assert misses[1] <= 0.3 * misses[0] + 1e-5


@pytest.mark.parametrize(
    ("steps", "rtol"), [(1, None), (1, 1e-3), pytest.param(2, 1e-4, marks=pytest.mark.slow)]
)
def test_steps_over_a_saddle_are_integrals_over_levels(steps: int, rtol: float | None) -> None:
    """The level through the saddle crosses itself, and all albedos but the first bend there."""
    base = Saddle()
    c, phi = np.array([1.0, 0.8, 0.5, 0.1, 1e-3]), np.array([0.0, 0.3, 0.9, 1.4, 0.6])
    exact = np.array([base.after(steps, float(s)) for s in base.level(spherical(c, phi))])
    model = albedo.pump(base, steps, rtol=rtol)
    found = albedo.directional_albedo(model, c, phi, rtol=model.usual_rtol)
    assert found.converged.all()
    assert np.all(np.abs(found.value - exact) <= found.error)
    assert np.all(found.error <= model.usual_rtol * exact)


def test_critical_levels_are_found() -> None:
    """The saddle at the normal of a product, and the extrema of Ward's lobe along both axes."""
    table = log_map(Saddle(), 1e-9)
    steps, levels = critical_levels(Maps((table,), None))
    assert np.all(steps == 0)
    # The level of the saddle is g = 1; what its own table errs by.
    assert np.abs(levels).min() <= 1e-9
    table = log_map(ELLIPTIC, 1e-8)
    _, levels = critical_levels(Maps((table,), None))
    c, phi = np.meshgrid(np.exp(np.linspace(-8.0, 0.0, 400)), [0.0, 0.5 * math.pi], indexing="ij")
    along = np.log(table.at(spherical(c.ravel(), phi.ravel()))).reshape(c.shape)
    for line in along.T:
        turns = 1 + np.flatnonzero(np.diff(line)[1:] * np.diff(line)[:-1] < 0.0)
        assert turns.size == 1
        # The best of the samples is as near as their second difference.
        slack = np.abs(np.diff(line, 2)).max()
        assert np.abs(levels - line[turns[0]]).min() <= slack


def test_strips_lie_between_levels_and_cover_their_rectangle() -> None:
    maps = Maps((log_map(ELLIPTIC, 1e-9),), None)
    _, levels = critical_levels(maps)
    box, warp = np.array([[-1.4, -0.8, -1.0, 1.0], [-8.0, -4.5, -1.0, 1.0]]), np.array([1.0, 2.0])
    repeated = Maps(maps.tables * levels.size, None)
    pieces = cut_along(repeated, levels, box, warp)
    assert {piece.rectangle for piece in pieces} == {0, 1}
    t = np.linspace(0.0, 1.0, 7)
    covered = np.zeros(2)
    for piece in pieces:
        lower, upper = (
            np.polynomial.chebyshev.chebval(2.0 * t - 1.0, series)
            for series in (piece.lower, piece.upper)
        )
        assert np.all(lower <= upper + 1e-5)
        k = piece.rectangle
        share = clustered_share(t, piece.ends)
        w = piece.start + share * (piece.end - piece.start)
        covered[k] += np.trapezoid(upper - lower, w)
        for edge in (lower, upper):
            if edge.min() == edge.max():
                continue
            y = box[k, 0] + np.clip(edge, 0.0, 1.0) * (box[k, 1] - box[k, 0])
            c, phi = directions_of(y, 2.0 * w - 1.0, float(warp[k]))
            off = np.abs(maps.logs(spherical(c, phi)) - levels).min(1)
            # The series may miss a place by 1e-5 of the height, over which the albedo changes by
            # no more than its slope in y, 1.
            assert off.max() <= 2e-5 * (box[k, 1] - box[k, 0])
    # Neighbours have the same edges, so that only the trapezoids of different pieces differ.
    np.testing.assert_allclose(covered, 1.0, atol=0.02)


def clustered_share(t: np.ndarray, ends: int) -> np.ndarray:
    return np.array([clustered(x, ends)[0] for x in t])


@pytest.mark.slow
def test_a_second_step_over_azimuths_bends_along_levels() -> None:
    base = ELLIPTIC
    model = albedo.pump(base, 2, rtol=1e-4)
    rng = np.random.default_rng(4)
    c = np.concatenate((rng.random(6), np.exp(-8.0 * rng.random(6))))
    phi = rng.uniform(0.0, math.pi, c.size)
    found = albedo.directional_albedo(model, c, phi, rtol=model.usual_rtol)
    assert found.converged.all()
    assert np.all(found.error <= model.usual_rtol * found.value)
    # Tables that are ten times better; both bounds hold.
    finer = albedo.pump(base, 2, rtol=1e-5)
    exact = albedo.directional_albedo(finer, c, phi, rtol=finer.usual_rtol)
    assert exact.converged.all()
    assert np.all(np.abs(found.value - exact.value) <= found.error + exact.error)


def test_a_curve_along_the_lines_of_a_panel_is_a_kink() -> None:
    """All of a line changes its sign there at once, so that no count of places tells of it."""
    (part,) = _of_stage(ELLIPTIC, 1, None, None).parts()
    c, phi = np.array([0.0055241, 0.01385, 0.018046]), np.array([1.47153, 1.409, 0.305])
    p = part.packed(np.tile(np.array(ELLIPTIC.pack()), (c.size, 1)))

    def integrand(row: np.ndarray, wi: np.ndarray, wo: np.ndarray, h: np.ndarray) -> np.ndarray:
        out = np.empty(wo.shape[1:])
        part.fill(wi, wo, h, p[row], out)
        return out * part.scale

    widths = np.tile(part.widths, (c.size, 1))
    found, plain = (
        integrate(chart, integrand, c, phi, widths, False, rtol=rtol, atol=0.0, limit=4_000_000)
        for chart, rtol in ((part.chart, 1e-10), (part.chart.chart, 3e-8))
    )
    assert found.converged.all()
    assert plain.converged.all()
    assert np.all(np.abs(found.value - plain.value) <= found.error + plain.error)
    # With a kink inside a panel, 300,000 to 400,000.
    assert found.evaluations.max() <= 100_000


def test_a_curve_may_close_between_two_lines() -> None:
    """A loop around the normal, a hundredth of a panel wide, that no node of a rule sees."""
    c = 0.00597966 + 1e-7 * np.arange(-2, 6)
    model = _of_stage(ELLIPTIC, 1, None, None)
    found = albedo.directional_albedo(model, c, 0.18994077, rtol=1e-10)
    assert found.converged.all()
    # Over so short a distance the albedo is a parabola; a loop that is not seen is worth 3e-9.
    third = np.abs(np.diff(found.value, 3)).max()
    assert third <= 8.0 * found.error.max()


@pytest.mark.parametrize("base", [ELLIPTIC, pytest.param(GGX, marks=pytest.mark.slow)], ids=str)
def test_a_first_step_over_azimuths_is_worth_as_much_as_over_heights(base: Model) -> None:
    model = albedo.pump(base, 1)
    assert model.usual_rtol == 1e-8
    (table,) = model.albedos
    assert table.error.max() <= 2e-9
    c, phi = np.tile(COSINES, 3), np.repeat([0.1, 0.8, 1.5], COSINES.size)
    own = albedo.directional_albedo(base, c, phi, rtol=1e-10)
    apart = np.abs(table.at(spherical(c, phi)) - own.value)
    assert np.all(apart <= table.error.max() * own.value + own.error)
    assert albedo.directional_albedo(model, c, phi).converged.all()


def test_azimuths_that_make_no_difference_change_nothing() -> None:
    for m in (0.2, 0.4):
        turned = albedo.directional_albedo(albedo.pump(Turned(m=m), 1), COSINES, 0.4)
        rings = albedo.directional_albedo(albedo.pump(albedo.model("ward", m=m), 1), COSINES, 0.4)
        assert turned.converged.all()
        assert np.all(np.abs(turned.value - rings.value) <= turned.error + rings.error)


def plain_rule(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Views over a quarter of the hemisphere, (n, 3), and n.v dV for all four quarters."""
    x, w = np.polynomial.legendre.leggauss(size)
    theta, weight = 0.25 * math.pi * (x + 1.0), 0.25 * math.pi * w
    phi, around = 0.25 * math.pi * (x + 1.0), 0.25 * math.pi * w
    t, p = np.meshgrid(theta, phi, indexing="ij")
    views = spherical(np.cos(t).ravel(), p.ravel())
    area = (weight * np.sin(theta) * np.cos(theta))[:, None] * around
    return views, area.ravel()


def test_anisotropic_steps_agree_with_a_plain_rule() -> None:
    """Points in angles, albedos at those points: no table, no chart, no kink."""
    lights = spherical(np.array([0.95, 0.7, 0.4]), np.array([0.2, 0.9, 1.3]))
    own = albedo.directional_albedo(
        ELLIPTIC, lights[:, 2], np.arctan2(lights[:, 1], lights[:, 0]), rtol=1e-8
    ).value
    misses = []
    for size in (24, 48):
        views, area = plain_rule(size)
        phi = np.arctan2(views[:, 1], views[:, 0])
        there = albedo.directional_albedo(ELLIPTIC, views[:, 2], phi, rtol=1e-6).value
        value = np.zeros(3)
        for flip_x in (1.0, -1.0):
            for flip_y in (1.0, -1.0):
                mirrored = views * np.array([flip_x, flip_y, 1.0])
                for k, light in enumerate(lights):
                    f = ELLIPTIC.eval(light, mirrored)
                    value[k] += (f / np.maximum(own[k], there)) @ area
        found = albedo.directional_albedo(
            albedo.pump(ELLIPTIC, 1),
            lights[:, 2],
            np.arctan2(lights[:, 1], lights[:, 0]),
            rtol=1e-3,
        )
        misses.append(float(np.max(np.abs(value - found.value))))
    # A kink that crosses the points makes the plain rule of second order.
    assert misses[0] <= 3.0 / 24**2
    assert misses[1] <= 0.5 * misses[0] + 2e-4


def test_an_anisotropic_step_is_a_model_like_any_other() -> None:
    model = albedo.pump(ELLIPTIC, 1)
    assert not model.isotropic
    found = albedo.directional_albedo(model, COSINES, 0.7, rtol=1e-3)
    before = albedo.directional_albedo(ELLIPTIC, COSINES, 0.7)
    assert found.converged.all()
    # The elliptic lobe makes light at grazing angles, and its first step takes it back.
    assert before.value.max() > 1.0
    assert np.all(found.value <= 1.0 + found.error)
    wi, wo = spherical(np.array([0.3, 0.8]), 0.4), spherical(np.array([0.6, 0.1]), 2.1)
    np.testing.assert_allclose(model.eval(wi, wo), model.eval(wo, wi), rtol=1e-12)
    drawn = albedo.monte_carlo_albedo(model, 0.6, 0.7, samples=2**15, sequence="sobol", seed=3)
    exact = albedo.directional_albedo(model, 0.6, 0.7, rtol=1e-3)
    assert abs(drawn.value - exact.value) <= 5.0 * drawn.error + exact.error


def test_split_panels_cover_the_same() -> None:
    """Cut where it may be, a chart integrates what it did."""
    table = log_map(ELLIPTIC, 1e-3)
    (part,) = albedo.pump(ELLIPTIC, 1).parts()
    assert isinstance(part.chart, SplitChart)
    assert part.chart.maps.tables[0].error.max() <= 1e-3
    (own,) = ELLIPTIC.parts()
    c, phi = COSINES[:6], np.full(6, 0.4)
    p = own.packed(np.tile(np.array(ELLIPTIC.pack()), (c.size, 1)))
    integrand = ModelIntegrand(own.fill, p, np.full(c.size, own.scale))
    widths = np.tile(own.widths, (c.size, 1))
    found = [
        integrate(*(chart, integrand, c, phi, widths, False), rtol=1e-8, atol=0.0, limit=400_000)
        for chart in (own.chart, part.chart)
    ]
    assert all(result.converged.all() for result in found)
    slack = found[0].error + found[1].error
    assert np.all(np.abs(found[0].value - found[1].value) <= slack)
    wi = spherical(c, phi)
    # The table's error over all directions, and what it was asked for.
    np.testing.assert_allclose(table.at(wi), found[0].value, rtol=float(table.error.max()))


@pytest.mark.parametrize(
    ("c", "phi"), [(0.0781293, 1.06226), (0.08183, 0.27418), (0.08348, 0.27418), (0.0888, 0.05)]
)
def test_kinks_may_come_and_go_between_two_lines(c: float, phi: float) -> None:
    """Cut or not, panels give one value, next to the level through a saddle of the albedo."""
    pumped = albedo.pump(ELLIPTIC, 1)
    (own,), (part,) = ELLIPTIC.parts(), pumped.parts()
    p = own.packed(np.array([ELLIPTIC.pack()]))
    integrand = ModelIntegrand(part.fill, p, np.full(1, own.scale))
    lights, widths = (np.array([c]), np.array([phi])), np.array([own.widths])
    found = [
        integrate(chart, integrand, *lights, widths, False, rtol=rtol, atol=0.0, limit=4_000_000)
        for chart, rtol in ((own.chart, 1e-7), (part.chart, 1e-9))
    ]
    assert all(result.converged.all() for result in found)
    slack = found[0].error + found[1].error
    assert np.all(np.abs(found[0].value - found[1].value) <= slack)


def test_what_tables_err_by_is_in_the_bound() -> None:
    rough = albedo.directional_albedo(albedo.pump(UPRIGHT, 2, rtol=1e-3), COSINES, rtol=0.1)
    exact = albedo.directional_albedo(albedo.pump(UPRIGHT, 2), COSINES, rtol=1e-4)
    assert np.all(np.abs(rough.value - exact.value) <= rough.error + exact.error)
    assert np.all(rough.error > exact.error)


def test_what_is_passed_on_at_one_place_is_a_triangular_system() -> None:
    """e_k = own_k - sum over j < k of the shares of e_j: a sum of e_k by the inverse."""
    rng, steps = np.random.default_rng(6), 4
    table = log_map(UPRIGHT, 1e-3)
    shape = table.own.shape
    tables = tuple(
        replace(table, own=rng.random(shape), passed=rng.random((*shape, k))) for k in range(steps)
    )
    wi = spherical(np.array([0.9, 0.3, 1e-4]), np.array([0.1, 2.0, 4.0]))
    shares = rng.uniform(-1.0, 1.0, (3, steps))
    found = Maps(tables, None).combined(wi, shares)
    y, which = folded(wi[:, 2]), np.empty(3, int)
    for i in range(3):
        which[i] = np.flatnonzero((table.box[:, 0] <= y[i]) & (y[i] <= table.box[:, 1]))[0]
    low, high = table.box[which, 0], table.box[which, 1]
    along = np.minimum((4.0 * (y - low) / (high - low)).astype(int), 3)
    around = np.minimum((2.0 * (1.0 - np.cos(2.0 * np.array([0.1, 2.0, 4.0])))).astype(int), 3)
    for i in range(3):
        place = which[i], along[i], around[i]
        system = np.eye(steps)
        for k, one in enumerate(tables):
            system[k, :k] = one.passed[place]
        own = np.array([one.own[place] for one in tables])
        # What is read leaves out a hundredth of what the table as a whole errs by.
        own += 0.01 * table.error[which[i]]
        exact = np.abs(np.linalg.solve(system.T, shares[i])) @ own
        assert found[i] == pytest.approx(exact, rel=1e-12)


@pytest.mark.parametrize("waves", [0.0, 3.0])
def test_errors_of_tables_are_passed_on_within_the_bound(waves: float) -> None:
    """Tables that are wrong on purpose, by what they say: up and down along the height."""
    wrong, rtol = 1e-4, 1e-6 * (1.0 + 1e-3 * waves)
    tables = stages(UPRIGHT, None, rtol, _of_stage)
    ratios, bounds = [], []
    for steps in (1, 2, 3):
        table = tables.albedos(steps)[-1]
        order = table.series.shape[2]
        nodes = np.polynomial.chebyshev.chebpts1(order)
        y = table.box[:, :1] + 0.5 * (nodes + 1.0) * (table.box[:, 1:2] - table.box[:, :1])
        off = wrong * (-1.0) ** steps * np.cos(waves * np.tanh(y))
        basis = np.polynomial.chebyshev.chebvander(nodes, order - 1)
        series = table.series.copy()
        series[:, 0] += np.linalg.solve(basis, off.T).T
        # The series of a wave exceeds it by what it leaves out.
        worst = 1.01 * wrong
        tables.tables[-1] = replace(
            table, series=series, error=table.error + worst, own=table.own + worst
        )
        model = albedo.pump(UPRIGHT, steps, rtol=rtol)
        found = albedo.directional_albedo(model, COSINES, rtol=8.0 * steps * wrong)
        exact = albedo.directional_albedo(albedo.pump(UPRIGHT, steps), COSINES)
        assert found.converged.all()
        apart = np.abs(found.value - exact.value)
        assert np.all(apart <= found.error + exact.error)
        (part,) = model.parts()
        assert part.average_doubt is not None
        own = part.average_doubt(COSINES, np.zeros(COSINES.size))
        assert np.all(apart <= own * exact.value + 1e-2 * wrong)
        ratios.append(float((apart / (own * exact.value)).max()))
        bounds.append(float(own.max()) / worst)
    # One table errs by all that it says, but for what is read and left out; a wave by its average.
    assert ratios[0] >= (0.8 if waves == 0.0 else 0.25)
    assert bounds[0] <= 1.05
    # Where each table passes on twice what all before may err by, it is 1 + 3 + 9.
    assert bounds[2] <= 6.5


def test_steps_over_steps_are_more_steps() -> None:
    once = albedo.pump(UPRIGHT, 1, rtol=1e-5)
    assert albedo.pump(once, 2) == albedo.pump(UPRIGHT, 3, rtol=1e-5)
    assert albedo.pump(once, 2, rtol=1e-6) == albedo.pump(UPRIGHT, 3, rtol=1e-6)
    with pytest.raises(InputError, match="without control only"):
        albedo.pump(once, 1, "literal")


def test_a_dark_model_is_refused() -> None:
    with pytest.raises(InputError, match="not above 0"):
        albedo.directional_albedo(albedo.pump(0.0 * ELLIPTIC), 0.5)
