"""Lobes of Phong, Blinn, Lewis and Ward in studies, against closed forms and other integrals."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from types import ModuleType

import mpmath
import numpy as np
import pytest

import albedo
from albedo.analysis import lobes
from albedo.analysis.drawn_vectors import ROUNDING, Scene, angle_between, mirrored
from albedo.directions import half_vector, spherical
from albedo.errors import InputError
from albedo.studies import StudyFile, run_study

STUDIES = Path(__file__).parent.parent / "studies"
EPS = float(np.finfo(float).eps)
# Verdicts of the quick run, in the order of the claims.
VERDICTS = {
    "nns_mirror_limit": [("N1", "holds"), ("N1", "holds"), ("N1", "fails"), ("N1", "fails")],
    "schwenk_fig1": [],
    "schwenk_fig3": [],
    "schwenk_exponents": [("S3", "holds"), ("S3", "fails")],
    "schwenk_normalization": [
        ("S1", "holds within"),
        *(("S2", "fails"), ("S2", "fails"), ("S2", "holds")),
        *(("S4", "holds within"), ("S4", "holds"), ("S4", "holds within"), ("S4", "fails")),
        *(("S6", "fails"), ("S6", "fails"), ("S6", "fails"), ("S6", "holds")),
    ],
}


def load(name: str) -> ModuleType:
    StudyFile(STUDIES / f"{name}.py").load()
    return sys.modules[f"albedo_study_{name}"]


@pytest.fixture(scope="module")
def limit() -> ModuleType:
    return load("nns_mirror_limit")


@pytest.fixture(scope="module")
def normal() -> ModuleType:
    return load("schwenk_normalization")


@pytest.mark.parametrize("name", VERDICTS)
def test_verdicts_of_the_quick_run(name, tmp_path):
    # Without pictures, which take longer than everything else.
    manifest = run_study(StudyFile(STUDIES / f"{name}.py"), tmp_path, pictures=False).manifest
    assert manifest["error"] is None
    assert manifest["warnings"] == []
    found = [(claim["id"], claim["verdict"]) for claim in manifest["claims"]]
    assert len(found) == len(VERDICTS[name])
    for (id, verdict), (own, start) in zip(found, VERDICTS[name], strict=True):
        assert id == own
        assert verdict.startswith(start)
        # What does not simply hold is explained.
        assert verdict == "holds" or manifest["explanations"][id]


def gauss(low: float, high: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    x, w = np.polynomial.legendre.leggauss(count)
    return low + 0.5 * (high - low) * (1.0 + x), 0.5 * (high - low) * w


def hemisphere(azimuths: int = 600) -> tuple[np.ndarray, np.ndarray]:
    """Directions and solid angles, by Gauss in n.v and evenly in azimuth."""
    z, weight = gauss(0.0, 1.0, 400)
    step = 2.0 * math.pi / azimuths
    area = np.broadcast_to(weight[:, None] * step, (z.size, azimuths))
    return spherical(z[:, None], (np.arange(azimuths) + 0.5) * step), area


# ---- N1


@pytest.mark.parametrize("n", [10.0, 1234.0, 1e5, 1e8])
def test_phong_is_farthest_from_the_cosine_at_grazing_incidence(limit, n):
    # With n even, m = n/2: Gamma(m + 1/2)/Gamma(m + 2) is binom(2 m, m) sqrt(pi)/(4^m (m + 1)).
    with mpmath.workdps(40):
        m = mpmath.mpf(n) / 2
        central = mpmath.exp(
            mpmath.loggamma(2 * m + 1) - 2 * mpmath.loggamma(m + 1) - 2 * m * mpmath.ln(2)
        )
        exact = central / 2
        assert abs(limit.phong_at_grazing(n) / exact - 1) < 2 * EPS
        found = limit.largest_distance("phong", n, 1, 1e-10)
        assert found.cos_theta == 0.0
        assert found.above
        assert abs(found.value - exact) <= found.error


@pytest.mark.parametrize(("n", "cosine"), [(10.0, 0.6), (1000.0, 0.5), (1000.0, 0.08)])
def test_blinn_in_coordinates_about_the_normal(n, cosine):
    # The trapezoidal rule in azimuth leaves a smooth function of n.v, and both rules converge
    # geometrically. The narrowest lobe here turns H by one width, 1/sqrt(n), within 0.0025 in
    # azimuth; a step s of so wide a Gaussian leaves exp(-2 (pi 0.0025/s)^2) = 1e-21.
    view, area = hemisphere(4000)
    half = spherical(cosine) + view
    n_h = half[..., 2] / np.linalg.norm(half, axis=-1)
    c = (n + 2.0) * (n + 4.0) / (8.0 * math.pi * (2.0 ** (-0.5 * n) + n))
    total = c * float(np.sum(area * n_h**n * view[..., 2]))
    found = albedo.directional_albedo(albedo.model("blinn", n=n), cosine, rtol=1e-10)
    assert abs(float(found.value) - total) <= float(found.error) + 1e-12


def test_blinn_follows_the_square_and_stays_away_from_the_cosine(limit):
    for n in (1e4, 1e8):
        far, near = (limit.largest_distance("blinn", n, power, 1e-10) for power in (1, 2))
        # a = cos^2 + O(1/n) with a constant below 3 at 60 degrees and below 2.1 anywhere else.
        assert abs(far.value - 0.25) <= 3.0 / n + far.error
        assert abs(far.cos_theta - 0.5) < 2e-3
        assert near.value <= 2.1 / n
        assert not far.above
    # At grazing incidence 2 int x^2 over half of a Gaussian of variance 1/n: 1/n.
    grazing = albedo.directional_albedo(albedo.model("blinn", n=1e6), 0.0)
    assert abs(float(grazing.value) * 1e6 - 1.0) < 1e-5


# ---- S3


def test_the_limit_of_narrow_lobes_is_a_minimum():
    assert lobes.narrow_factor(1.0) == 4.0
    assert lobes.narrow_distance(1.0, 4.0) == 0.0
    for theta in (5.0, 30.0, 60.0, 85.0):
        c = math.cos(math.radians(theta))
        k = lobes.narrow_factor(c)
        assert 4.0 * c * c < k < 4.0
        scan = np.geomspace(0.5 * k, 2.0 * k, 4001)
        distances = [lobes.narrow_distance(c, x) for x in scan]
        # The step of the scan is less than 4e-4 of k.
        assert abs(scan[int(np.argmin(distances))] / k - 1.0) < 4e-4
    # Towards grazing incidence: the root of 15 q^3 + 13 q^2 + q = 1, times 4.
    (q,) = [x.real for x in np.roots([15.0, 13.0, 1.0, -1.0]) if x.real > 0.0]
    assert abs(lobes.narrow_factor(1e-6) - 4.0 * q) < 1e-5


def test_best_factors_of_large_exponents():
    n = 1e5
    for theta in (0.0, 40.0, 70.0):
        c = math.cos(math.radians(theta))
        found = lobes.best_factor(n, c)
        # Terms of the order of 1/n with constants of the order of the lobe's cut: 100 is plenty.
        assert abs(found.factor - lobes.narrow_factor(c)) < 100.0 / n
        assert abs(found.by_rule - lobes.narrow_distance(c, 4.0)) < 100.0 / n
        plane = lobes.best_factor(n, c, "plane")
        # The expansions 4 + 5/(4 n) and 4 + 3/(2 n); the next terms are about 1/n^2, and nodes
        # about directions lose eps n of a lobe.
        assert abs(n * (plane.factor - 4.0) - 1.25) < 1e-3
        if theta == 0.0:
            assert abs(n * (found.factor - 4.0) - 1.5) < 1e-3


@pytest.mark.parametrize("theta", [0.0, 35.0, 60.0])
def test_distances_in_coordinates_about_the_normal(theta):
    n, c = 10.0, math.cos(math.radians(theta))
    view, area = hemisphere()
    light = spherical(c)
    half = light + view
    n_h = half[..., 2] / np.linalg.norm(half, axis=-1)
    phong = np.maximum(view @ (light * np.array([-1.0, -1.0, 1.0])), 0.0) ** n

    def distance(k: float) -> float:
        return math.sqrt(np.sum(area * (n_h ** (k * n) - phong) ** 2) / np.sum(area * phong**2))

    found = lobes.best_factor(n, c)
    # Where r.v = 0 the tenth derivative jumps, which leaves less than 400^-9 of an ordinary size.
    assert abs(distance(4.0) - found.by_rule) < 1e-12
    assert abs(distance(found.factor) - found.distance) < 1e-12
    assert min(distance(found.factor * f) for f in (0.99, 1.01)) > found.distance


def test_factors_refuse_what_is_out_of_range():
    for arguments in ((0.5, 1.0), (10.0, 0.0), (10.0, 1.1), (math.nan, 1.0)):
        with pytest.raises(InputError, match="out of range"):
            lobes.best_factor(*arguments)
    with pytest.raises(InputError, match="choose one of plane, all"):
        lobes.best_factor(10.0, 1.0, "some")


# ---- S1, S2


@pytest.mark.parametrize("e", [0.0, 1e-6, 0.5, 1.0, 8.7637, 10.0, 100.0, 1e6])
def test_excess_over_the_exact_constant(normal, e):
    with mpmath.workdps(60):
        x = mpmath.mpf(e)
        # The integral at normal incidence: V at 2 d from the normal, cos(2 d) 4 cos(d) sin(d) dd.
        exact = mpmath.quad(
            lambda d: mpmath.cos(d) ** (x + 1) * mpmath.cos(2 * d) * mpmath.sin(d),
            [0, *(k / mpmath.sqrt(x + 200) for k in (1, 3, 9)), mpmath.pi / 4],
        )
        constant = 1 / (8 * exact)
        value = (x + 8) / 8 / constant - 1
        # Next to e = 0 the terms are 13 times as large as their sum, with two roundings each.
        assert abs(normal.excess(e) - value) <= 64 * EPS * abs(value) + mpmath.mpf(10) ** -40


def test_common_constant_at_normal_incidence():
    for e, value, doubt in (
        (1.0, 1.0242640687, 2e-10),
        (10.0, 1.07477678571, 1e-11),
        (100.0, 1.018099548, 3e-9),
    ):
        model = albedo.model("blinn", n=e, normalization="n_plus_8")
        found = albedo.directional_albedo(model, 1.0, rtol=1e-12)
        assert abs(float(found.value) - value) <= float(found.error) + doubt
        assert abs(float(found.value) - 1.0 - load("schwenk_normalization").excess(e)) <= float(
            found.error
        )


def test_crossings_and_the_worst_exponent(normal):
    top = normal.worst_exponent()
    low, high = normal.crossings(0.01, top)
    assert normal.excess(top) > max(normal.excess(top + d) for d in (-1e-3, 1e-3))
    assert 0.0 < low < top < high
    for e in (low, high):
        assert abs(normal.excess(e) - 0.01) < 1e-12


# ---- S4


@pytest.mark.parametrize("e", [1.0, 10.0])
def test_residual_of_reciprocity_in_closed_form(normal, e):
    # f(N, V)/f(V, N) = I(theta_v)/I(0), the albedo of the lobe with a constant factor.
    per_incidence = albedo.model("lewis", n=e, reading="per_incidence")
    view = spherical(np.array([0.9, 0.3, 1e-4]))
    up = spherical(1.0)
    ratio = per_incidence.eval(up, view) / per_incidence.eval(view, up)
    constant = albedo.directional_albedo(albedo.model("blinn", n=e), view[:, 2], rtol=1e-11)
    # The table that is divided by is right to about 1e-12.
    np.testing.assert_allclose(ratio, constant.value, rtol=1e-10)
    if e == 1.0:
        # In the limit of grazing incidence 2 - sqrt(2).
        end = albedo.directional_albedo(albedo.model("blinn", n=1.0), 0.0, rtol=1e-11)
        assert abs(float(end.value) - (2.0 - math.sqrt(2.0))) <= float(end.error)


# ---- S6


@pytest.mark.parametrize("alpha", [0.02, 0.1, 0.2, 0.5])
def test_deficit_of_ward_by_integrals_in_one_variable(normal, alpha):
    with mpmath.workdps(30):
        a2 = mpmath.mpf(alpha) ** 2
        ends = [0, *(x for x in (a2, 9 * a2, 36 * a2) if x < 0.5), 1]
        exact = mpmath.quad(
            lambda t: mpmath.sqrt((1 - t) / (1 + t)) / (1 + t) ** 2 * mpmath.exp(-t / a2) / a2, ends
        )
        value, error = normal.deficit(alpha, "exact", 1e-10)
        assert abs(value - (1 - exact)) <= error
        # Ward's fast exponent is 2 sin^2/(1 + cos) = 2 (1 - cos) of the angle of H; u = 1 - cos.
        stop = 1 - mpmath.sqrt(0.5)
        ends = [0, *(x for x in (a2 / 2, 9 * a2 / 2, 36 * a2 / 2) if x < 0.25), stop]
        fast = mpmath.quad(
            lambda u: (
                2 * (1 - u) * mpmath.sqrt(abs(2 * (1 - u) ** 2 - 1)) * mpmath.exp(-2 * u / a2) / a2
            ),
            ends,
        )
        value, error = normal.deficit(alpha, "fast", 1e-10)
        assert abs(value - (1 - fast)) <= error


# ---- Figures 1 and 3


def test_relations_hold_for_any_two_directions(rng):
    study = load("schwenk_fig1")
    for _ in range(200):
        light, view = (spherical(rng.uniform(0.02, 1.0), rng.uniform(0.0, 6.28)) for _ in "lv")
        half = half_vector(light, view)
        vectors = {
            "N": np.array([0.0, 0.0, 1.0]),
            "L": light,
            "V": view,
            "R": mirrored(light),
            "H": half / np.linalg.norm(half),
        }
        table = study.relations(vectors)
        off = (table["left"] - table["right"]).abs()
        assert (off <= table["left_error"] + table["right_error"]).all()


def test_angles_of_both_lobes():
    study = load("schwenk_fig3")
    for off in (1e-6, 1.0, 24.0):
        plane, side = study.in_plane(off), study.beside(off)
        for vectors in (plane, side):
            alpha = angle_between(vectors["R"], vectors["V"])
            assert abs(alpha - math.radians(off)) <= ROUNDING
        delta = angle_between(plane["N"], plane["H"])
        assert abs(delta - 0.5 * math.radians(off)) <= ROUNDING
        # V at the height of R: sin(alpha/2) = (v.h) sin(delta).
        delta = angle_between(side["N"], side["H"])
        v_h = float(side["V"] @ side["H"])
        assert abs(v_h * math.sin(delta) - math.sin(0.5 * math.radians(off))) <= ROUNDING
    table = study.relation(8)
    assert ((table["left"] - table["right"]).abs() <= table["left_error"]).all()


def test_pictures_are_projections():
    from matplotlib.figure import Figure

    scene = Scene(Figure().add_subplot(), azimuth=-35.0, elevation=20.0)
    a, e = math.radians(-35.0), math.radians(20.0)
    sight = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
    # What lies along the line of sight is one point; lengths across it are kept.
    assert np.abs(scene.project(sight)).max() < 4.0 * EPS
    across = np.cross(sight, [0.3, -0.2, 0.9])
    assert abs(np.hypot(*scene.project(across)) - np.linalg.norm(across)) < 8.0 * EPS
    assert scene.project(np.array([0.0, 0.0, 1.0]))[1] == math.cos(e)
