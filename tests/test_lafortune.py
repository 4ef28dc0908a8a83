"""Lafortune's lobes: against Phong, against a second chart, and against one-dimensional integrals.

And the chart about an axis that they come with.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from exact import mp
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy import integrate as scipy_integrate
from strategies import azimuths, cosines, decades

import albedo
from albedo.brdf import Model
from albedo.charts.axis import AxisChart
from albedo.charts.cosine import CosineChart
from albedo.directions import spherical
from albedo.grammar import parse
from albedo.integrators.adaptive import integrate
from albedo.integrators.rules import gauss

EPS = np.finfo(float).eps
COSINES = np.array([1.0, 0.9, 0.6, 0.3, 0.05, 1e-3, 1e-7])

coefficients = st.one_of(
    st.sampled_from([(-1.0, -1.0, 1.0), (1.0, 1.0, 1.0), (0.0, 0.0, 1.0), (-1.0, -1.0, -1.0)]),
    st.tuples(*(st.floats(-1.0, 1.0).map(lambda x: round(x, 3)) for _ in range(3))).filter(any),
)


def lobe(*numbers: float, **others: Any) -> Model:
    return albedo.model("lafortune", lobes=(numbers,), **others)


# The chart ---------------------------------------------------------------------------------------


def axis_of(c: tuple[float, ...], light: np.ndarray) -> np.ndarray:
    axis = np.array(c) * light
    return axis / max(np.linalg.norm(axis), 1e-300)


@given(coefficients, cosines, azimuths, decades(1e-4, 10.0), st.sampled_from([1, 2, 4]))
@settings(max_examples=150)
def test_nodes_are_directions_above_the_horizon(
    c: tuple[float, float, float], cosine: float, phi: float, width: float, edge: int
) -> None:
    chart, light = AxisChart(c, edge), spherical(cosine, phi)
    rule = gauss(5)
    for isotropic in (False, True):
        geometry, row, code, box = chart.panels(
            np.array([cosine]), np.array([phi]), np.array([[width, width]]), isotropic
        )
        wi, wo, h, weight = chart.nodes(geometry[row], code, box, rule.nodes, rule.nodes)
        np.testing.assert_allclose(wi, np.repeat(light[:, None], wi.shape[1], 1), atol=4 * EPS)
        np.testing.assert_allclose(np.sum(wo * wo, axis=0), 1.0, atol=20 * EPS)
        np.testing.assert_allclose(h, wi[:, :, None] + wo, atol=4 * EPS)
        assert np.all(wo[2] >= 0.0)
        assert np.all(weight >= 0.0)


@given(coefficients, cosines, azimuths, st.sampled_from([1, 2, 4]), st.booleans())
@settings(max_examples=100)
def test_the_half_space_of_an_axis_is_covered_once(
    c: tuple[float, float, float], cosine: float, phi: float, edge: int, isotropic: bool
) -> None:
    """The projected area within 90 degrees of a and above the horizon is pi/2 (1 + a.z)."""
    assume(np.linalg.norm(axis_of(c, spherical(cosine, phi))) > 0.0)
    found = integrate(
        AxisChart(c, edge, "algebraic"),
        lambda row, wi, wo, h: np.ones(wo.shape[1:]),
        *(np.array([cosine]), np.array([phi]), np.ones((1, 2)), isotropic),
        rtol=1e-11,
        atol=1e-15,
        limit=4_000_000,
        probe=False,
    )
    expected = 0.5 * math.pi * (1.0 + axis_of(c, spherical(cosine, phi))[2])
    # 1 + a.z cancels where the axis is next to -N.
    assert abs(found.value[0] - expected) <= found.error[0] + 20 * EPS


CUT = [(-0.9, -0.9, 1.0), (1.0, 1.0, 0.4), (-1.0, -1.0, -0.02), (-0.5, 0.9, 1.0)]


@pytest.mark.parametrize("n", [0.3, 4.0, 40.0, 250.0])
@pytest.mark.parametrize("c", CUT)
def test_no_lobe_loses_energy_where_it_is_cut(
    c: tuple[float, float, float], n: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Against the chart without its cut, and against one that knows no lobe."""
    model = lobe(*c, n)
    part = model.parts()[0]
    cosines, phi = np.array([0.95, 0.5, 0.1, 1e-3]), 0.7
    found = albedo.directional_albedo(model, cosines, phi, rtol=1e-9)
    uncut = replace(part.chart, decay="algebraic")
    # The cosine chart knows nothing of the edge a.V = 0, where low powers have a root.
    for chart in (uncut, CosineChart()) if n >= 4.0 else (uncut,):
        other = (replace(part, chart=chart),)
        monkeypatch.setattr(type(model), "parts", lambda self, other=other: other)
        whole = albedo.directional_albedo(model, cosines, phi, rtol=1e-8, max_evaluations=8_000_000)
        assert np.all(np.abs(found.value - whole.value) <= found.error + whole.error)


# The model ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [0.5, 3.0, 20.0, 150.0, 1e5])
def test_one_lobe_about_the_mirror_direction_is_phong(n: float) -> None:
    c = ((n + 2.0) / (2.0 * math.pi)) ** (1.0 / n)
    phong = albedo.directional_albedo(albedo.model("phong", n=n), COSINES, rtol=1e-11)
    # c is rounded once, and its power n times that.
    slack = n * EPS * phong.value
    for model in (lobe(-c, -c, c, n), lobe(c, c, c, n)):
        found = albedo.directional_albedo(model, COSINES, rtol=1e-11)
        assert np.all(found.converged)
        # By symmetry a lobe about L reflects as much as one about R, on a chart of its own.
        assert np.all(np.abs(found.value - phong.value) <= found.error + phong.error + slack)


def below(elevation: float, n: float) -> float:
    """The albedo of (a.v)^n for an axis at this elevation, as a product of two integrals."""
    across = 0.5 * float(mp.beta((n + 3) / 2, 0.5)) * 2.0
    low = max(-elevation, -0.5 * math.pi)

    def within(angle: float) -> float:
        return math.cos(angle) ** n * math.sin(elevation + angle)

    # Most of it is next to the horizon, or to the axis.
    middle = max(low, 0.0) + 3.0 / math.sqrt(n + 1.0)
    cuts = [low, min(middle, 0.5 * math.pi), 0.5 * math.pi]
    pieces = [
        scipy_integrate.quad(within, a, b, epsabs=0.0, epsrel=1e-13, limit=400)[0]
        for a, b in itertools.pairwise(cuts)
        if b > a
    ]
    return across * sum(pieces)


@pytest.mark.parametrize("n", [0.5, 2.0, 7.3, 30.0, 400.0])
@pytest.mark.parametrize(
    "c", [(-1.0, -1.0, -0.3), (-1.0, -1.0, -0.01), (1.0, 1.0, -0.7), (-0.9, -0.9, 1.0)]
)
def test_an_axis_on_either_side_of_the_horizon(c: tuple[float, float, float], n: float) -> None:
    """With scipy, in plane angles, which share the idea of the chart but no code with it."""
    cosines = np.array([0.9, 0.5, 0.1, 1e-3])
    found = albedo.directional_albedo(lobe(*c, n), cosines, rtol=1e-10)
    for k, cosine in enumerate(cosines):
        s = math.sqrt((1.0 - cosine) * (1.0 + cosine))
        o = math.hypot(c[0] * s, c[2] * cosine)
        expected = o**n * below(math.atan2(c[2] * cosine, abs(c[0]) * s), n)
        # scipy is asked for 1e-13; a power of n amplifies the roundings of |o|.
        slack = (1e-12 + 4 * n * EPS) * expected
        assert abs(found.value[k] - expected) <= found.error[k] + slack


def test_a_lobe_about_the_normal_is_known() -> None:
    """f = (n.l n.v)^n: the albedo is 2 pi (n.l)^n/(n + 2)."""
    found = albedo.directional_albedo(lobe(0.0, 0.0, 1.0, 6.0), [1.0, 0.5, 0.1], rtol=1e-11)
    expected = 2.0 * math.pi / 8.0 * np.array([1.0, 0.5, 0.1]) ** 6
    assert np.all(np.abs(found.value - expected) <= found.error + 8 * EPS * expected)


def test_lobes_and_the_diffuse_part_add_up() -> None:
    lobes = ((-1.0, -1.0, 0.9, 30.0), (1.0, 1.0, 1.0, 5.0))
    both = albedo.directional_albedo(albedo.model("lafortune", lobes=lobes, rho_d=0.3), COSINES)
    apart = [albedo.directional_albedo(lobe(*one), COSINES) for one in lobes]
    off = both.value - 0.3 - apart[0].value - apart[1].value
    assert np.all(np.abs(off) <= both.error + apart[0].error + apart[1].error + EPS)
    assert set(both.parts) == {"lobe_1", "lobe_2", "diffuse"}


def test_an_anisotropic_lobe_follows_the_axes() -> None:
    """Turning the light by 90 degrees exchanges c_x and c_y."""
    one, other = lobe(-1.0, -0.6, 0.9, 25.0), lobe(-0.6, -1.0, 0.9, 25.0)
    a = albedo.directional_albedo(one, COSINES, 0.3)
    b = albedo.directional_albedo(other, COSINES, 0.5 * math.pi - 0.3)
    assert np.all(np.abs(a.value - b.value) <= a.error + b.error)


@pytest.mark.parametrize("rtol", [1e-8, 1e-12])
def test_lobes_are_cheap(rtol: float) -> None:
    """What narrow lobes cost hardly grows with n."""
    spent = []
    for n in (0.0, 0.5, 3.0, 20.0, 300.0):
        for c in ((1.0, 1.0, 1.0), (-1.0, -1.0, 0.95), (-1.0, -1.0, -0.2), (0.0, 0.0, 1.0)):
            found = albedo.directional_albedo(lobe(*c, n), COSINES, rtol=rtol)
            assert np.all(found.converged)
            spent += found.evaluations.tolist()
    assert np.median(spent) <= (4_000 if rtol == 1e-8 else 12_000)
    assert max(spent) <= 20_000


# Parameters --------------------------------------------------------------------------------------


def test_lobes_are_written_in_the_grammar() -> None:
    model = parse("lafortune:lobes=((-1,-1,.9,20),(1,1,1,5)),rho_d=0.1").model()
    assert model.lobes == ((-1.0, -1.0, 0.9, 20.0), (1.0, 1.0, 1.0, 5.0))
    assert model.spec == "lafortune:lobes=((-1,-1,0.9,20),(1,1,1,5)),rho_d=0.1"
    assert parse(lobe(-1, -1, 1, 20).spec).model() == lobe(-1, -1, 1, 20)
    assert albedo.model("lafortune", lobes=np.array([[-1, -1, 1, 20]])) == lobe(-1, -1, 1, 20)


@pytest.mark.parametrize(
    ("lobes", "message"),
    [
        (3.0, r"lobes = 3.0 has no vectors; it must hold one or more \(c_x, c_y, c_z, n\)"),
        ((), "has no vectors"),
        ("(1,1,1,5)", "has no vectors"),
        ((-1.0, -1.0, 1.0, 20.0), r"lobes\[0\] = -1.0 does not fit"),
        (((1.0, 1.0, 1.0),), r"lobes\[0\] = \(1.0, 1.0, 1.0\) does not fit"),
        (((1.0, 1.0, 1.0, 5.0), (1.0, 1.0, 1.0, -5.0)), r"lobes\[1\].n = -5 is out of range"),
        (((math.nan, 1.0, 1.0, 5.0),), r"lobes\[0\].c_x = nan is out of range"),
        (((1.0, "up", 1.0, 5.0),), r"lobes\[0\].c_y = 'up' is not a number"),
        (((0.0, 0.0, 0.0, 5.0),), "has no axis"),
        (((2.0, 0.0, 0.0, 1e4),), "overflows"),
    ],
)
def test_lobes_that_do_not_fit_are_refused(lobes: Any, message: str) -> None:
    with pytest.raises(albedo.InputError, match=message) as caught:
        albedo.model("lafortune", lobes=lobes)
    assert "\n" not in str(caught.value)
