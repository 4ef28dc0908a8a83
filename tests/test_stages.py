"""Pumping-up by tables over height and azimuth: any lobe, isotropic or not."""

from __future__ import annotations

import math

import numpy as np
import pytest
from steps import nystrom

import albedo
from albedo.brdf import Model
from albedo.directions import spherical
from albedo.errors import InputError
from albedo.integrators.adaptive import integrate
from albedo.integrators.cells import ModelIntegrand
from albedo.operators.maps import log_map
from albedo.operators.pump import _of_stage
from albedo.operators.split import SplitChart
from albedo.operators.stages import Stages

COSINES = np.array([1.0, 0.9, 0.5, 0.2, 0.05, 1e-3, 1e-6])
PHONG = albedo.model("phong", n=20)
WARD = albedo.model("ward", m=0.4)
ELLIPTIC = albedo.model("ward", alpha_x=0.4, alpha_y=0.2)
SCALED = albedo.model("lafortune_scaled")
UPRIGHT = albedo.model("lafortune", lobes=((0.0, 0.0, 1.0, 1.0),))
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
        known = albedo.directional_albedo(albedo.pump(base, k, control), COSINES, rtol=1e-9)
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


def test_what_tables_err_by_is_in_the_bound() -> None:
    rough = albedo.directional_albedo(albedo.pump(UPRIGHT, 2, rtol=1e-3), COSINES, rtol=0.1)
    exact = albedo.directional_albedo(albedo.pump(UPRIGHT, 2), COSINES, rtol=1e-4)
    assert np.all(np.abs(rough.value - exact.value) <= rough.error + exact.error)
    assert np.all(rough.error > exact.error)


def test_steps_over_steps_are_more_steps() -> None:
    once = albedo.pump(UPRIGHT, 1, rtol=1e-5)
    assert albedo.pump(once, 2) == albedo.pump(UPRIGHT, 3, rtol=1e-5)
    assert albedo.pump(once, 2, rtol=1e-6) == albedo.pump(UPRIGHT, 3, rtol=1e-6)
    with pytest.raises(InputError, match="without control only"):
        albedo.pump(once, 1, "literal")


def test_a_dark_model_is_refused() -> None:
    with pytest.raises(InputError, match="not above 0"):
        albedo.directional_albedo(albedo.pump(0.0 * ELLIPTIC), 0.5)
