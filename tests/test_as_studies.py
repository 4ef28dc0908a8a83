"""What the studies of Ashikhmin and Shirley's paper compute, against vectors and closed forms."""

from __future__ import annotations

import itertools
import math
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from exact import mp
from scipy.integrate import quad

import albedo
from albedo.analysis import half_vectors
from albedo.studies import StudyFile, run_study

STUDIES = Path(__file__).parent.parent / "studies"
EPS = float(np.finfo(float).eps)


def load(name: str) -> ModuleType:
    StudyFile(STUDIES / f"{name}.py").load()
    return sys.modules[f"albedo_study_{name}"]


def uniform(count: int, rng: np.random.Generator) -> np.ndarray:
    """Directions on the hemisphere, uniform in solid angle."""
    z, phi = rng.uniform(0.0, 1.0, count), rng.uniform(0.0, 2.0 * math.pi, count)
    s = np.sqrt(1.0 - z**2)
    return np.stack((s * np.cos(phi), s * np.sin(phi), z), axis=-1)


def raw_density(n_u: float, n_v: float, h: np.ndarray) -> np.ndarray:
    """AS eq. 5 from unit half vectors."""
    exponent = (n_u * h[:, 0] ** 2 + n_v * h[:, 1] ** 2) / (1.0 - h[:, 2] ** 2)
    return math.sqrt((n_u + 1.0) * (n_v + 1.0)) / (2.0 * math.pi) * h[:, 2] ** exponent


# What the studies share --------------------------------------------------------------------------


@pytest.mark.parametrize("pair", [(0.0, 0.0), (3.0, 3.0), (10.0, 100.0), (1.0, 1e8), (0.0, 20.0)])
def test_density_integrates_to_one(pair):
    model = albedo.model("ashikhmin_shirley", n_u=pair[0], n_v=pair[1])
    value, error = half_vectors.integral_of_density(model)
    # In closed form it is 1.
    assert abs(value - 1.0) <= error
    assert error <= 1e-7


def test_density_is_that_of_the_paper(rng):
    h = uniform(500, rng)
    h = h[(h[:, 2] > 0.1) & (h[:, 2] < 0.99)]
    for n_u, n_v in ((0.0, 5.0), (10.0, 100.0), (30.0, 2.0)):
        model = albedo.model("ashikhmin_shirley", n_u=n_u, n_v=n_v)
        # A cosine above 0.1 to the power 100, and 1 - cos^2 above 0.02, both by subtraction.
        np.testing.assert_allclose(
            4.0 * model.pdf(h, h), raw_density(n_u, n_v, h), rtol=100.0 * EPS / 0.02 * 3.0
        )


@pytest.mark.parametrize("n", [0.0, 0.5, 1.0, 10.0, 1000.0])
def test_albedo_at_normal_incidence(n):
    closed = half_vectors.albedo_at_normal(n)
    with mp.workdps(30):
        exact = mp.quad(
            lambda x: (n + 1) * x**n * (2 * x**2 - 1), mp.linspace(mp.sqrt(mp.mpf(0.5)), 1, 9)
        )
    # Two terms of at most 2 are subtracted, each after a power.
    assert abs(closed - float(exact)) <= 32.0 * EPS
    model = albedo.model("ashikhmin_shirley", n=n)
    found = albedo.directional_albedo(model, 1.0, rtol=1e-10)
    assert abs(float(found.value) - closed) <= float(found.error) + 32.0 * EPS


def test_least_k_dot_h(rng):
    for elevation in (1.5, 0.8, 0.2, 0.01):
        k = np.array([math.cos(elevation), 0.0, math.sin(elevation)])
        least = float(half_vectors.least_k_dot_h(k[2]))
        v = uniform(20_000, rng)
        assert np.all(0.5 * np.linalg.norm(k + v, axis=-1) >= least)
        # Reached on the horizon opposite to k.
        reached = 0.5 * float(np.linalg.norm(k - np.array([1.0, 0.0, 0.0])))
        # The difference of the components along x rounds by EPS, at an elevation of 0.01.
        assert abs(reached - least) <= 4.0 * EPS / least
        assert least >= 0.5 * k[2]
    # cos(pi/4 + theta/2) in 40 digits, where in double precision nothing would be left of it.
    with mp.workdps(40):
        c = mp.mpf(10) ** -12
        exact = mp.cos(mp.pi / 4 + mp.acos(c) / 2)
    assert abs(float(half_vectors.least_k_dot_h(1e-12) / exact) - 1.0) <= 8.0 * EPS


@pytest.mark.parametrize("u", [0.0, 1e-6, 0.3, 2.0, 10.0, 300.0])
def test_the_loss_in_the_limit_is_a_mean(u):
    def lost(g: float) -> float:
        # n.l in units of itself, n.v = 1 + 2 g/u; for u = 0 all that is not below is kept.
        view = 1.0 + 2.0 * g / u if u > 0.0 else g
        kept = max(0.0, view) / max(1.0, view) if u > 0.0 else float(view > 0.0)
        return (1.0 - kept) * math.exp(-0.5 * g * g) / math.sqrt(2.0 * math.pi)

    ends = sorted({-12.0, -min(0.5 * u, 12.0), 0.0})
    parts = [quad(lost, a, b, epsabs=1e-13) for a, b in itertools.pairwise(ends)]
    value, error = (sum(column) for column in zip(*parts, strict=True))
    assert abs(float(half_vectors.lost_in_the_limit(u)) - value) <= error + 1e-14


def test_losses_tend_to_the_limit():
    for n_u, n_v, phi in ((1e8, 1e8, 0.0), (1e8, 1e6, 0.4), (1e6, 1e8, 0.4), (1e9, 1e7, 1.5)):
        model = albedo.model("ashikhmin_shirley", n_u=n_u, n_v=n_v)
        cosines = np.array([0.9, 0.3, 1e-2, 1e-3, 1e-4, 1e-6])
        lost = albedo.directional_albedo(
            model, cosines, phi, rtol=1e-11, atol=1e-11, complement=True
        )
        u = half_vectors.horizon_variable(cosines, n_u, n_v, phi)
        off = np.abs(lost.value - half_vectors.lost_in_the_limit(u))
        # At normal incidence the loss is 2/n_u + 2/n_v, and nothing else is of that order.
        assert np.all(off <= lost.error + 2.0 / n_u + 2.0 / n_v)


# The figures -------------------------------------------------------------------------------------


def test_the_half_vector_halves_the_angle():
    fig1 = load("as_fig1")
    vectors = fig1.make_vectors()
    k1, k2, h = vectors["k1"], vectors["k2"], vectors["h"]
    # In one plane with both, at the same angle to both, which is half of theirs.
    assert abs(np.linalg.det(np.stack((k1, k2, h)))) <= 8.0 * EPS
    half = 0.5 * math.acos(float(k1 @ k2))
    for k in (k1, k2):
        assert abs(math.acos(float(k @ h)) - half) <= 16.0 * EPS
    row = fig1.exponent_of(vectors).iloc[0]
    exact = float(raw_density(row["n_u"], row["n_v"], h[None])[0])
    # The power of about 100 of a rounded cosine.
    assert abs(row["p_h"] - exact) <= 256.0 * EPS * row["exponent"] * exact
    assert abs(np.linalg.norm(fig1.on_page([0.0, 0.0, 1.0])) - math.cos(math.radians(27.0))) < 1e-12


def test_pixels_are_albedos_in_the_local_frame():
    fig2 = load("as_fig2")
    model = fig2.lobe(10.0, 1000.0)
    sphere = fig2.tabulate(model, 49, 17)
    off = fig2.off_nodes(model, sphere, 60)
    pixels = 32
    pictures = fig2.picture(sphere, pixels), fig2.picture(sphere, pixels, turned=True)
    viewer, up = np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])
    for row, column in ((16, 16), (5, 12), (20, 3), (27, 24), (16, 29)):
        x = (column + 0.5) / 16.0 - 1.0
        y = 1.0 - (row + 0.5) / 16.0
        n = np.array([x, y, math.sqrt(1.0 - x * x - y * y)])
        u = np.cross(up, n) / np.linalg.norm(np.cross(up, n))
        phi = math.atan2(float(viewer @ np.cross(n, u)), float(viewer @ u))
        for image, n_u, n_v in ((pictures[0], 10.0, 1000.0), (pictures[1], 1000.0, 10.0)):
            exact = albedo.directional_albedo(fig2.lobe(n_u, n_v), float(n[2]), phi, rtol=1e-7)
            # As far as interpolation was found to be off at 60 directions; twice, for others.
            assert abs(image[row, column] - float(exact.value)) <= 2.0 * off


def test_figure_4_has_the_minimum_of_its_limit():
    fig4 = load("as_fig4")
    q = 2.0**-0.25
    exact = (1.0 - q) / (1.0 - 0.5 * q)
    value = 0.05 + 0.95 * (1.0 + (1.0 - exact) ** 5 - (1.0 - 0.5 * exact) ** 5)
    c, width, low, error = fig4.lowest_inside(None, 1e-10)
    assert abs(c - exact) <= width
    assert abs(low - value) <= error
    # What the lobe loses lowers it, by F sqrt(2/(pi n)) tan(theta) to first order.
    _, _, finite, bound = fig4.lowest_inside(1e9, 1e-10)
    lost = (0.05 + 0.95 * (1.0 - exact) ** 5) * math.sqrt(2.0 / (math.pi * 1e9))
    lost *= math.sqrt(1.0 - exact**2) / exact
    # The rest is of the order of 1/n and of the square of the loss.
    assert abs(value - lost - finite) <= error + bound + 1e-8


def test_figure_4_knows_where_its_minimum_appears():
    fig4 = load("as_fig4")
    first, last = fig4.thresholds(41)
    assert math.isnan(fig4.lowest_inside(0.95 * first, 1e-10)[2])
    assert fig4.lowest_inside(1.05 * first, 1e-10)[2] < 0.735
    assert (
        fig4.lowest_inside(0.99 * last, 1e-10)[2]
        < 0.735
        < fig4.lowest_inside(1.01 * last, 1e-10)[2]
    )


def test_the_gap_is_linear_in_the_reflectance():
    cosines = np.array([1.0, 0.5, 0.05])
    gaps = {}
    for r_s in (0.0, 0.3, 1.0):
        model = albedo.model("ashikhmin_shirley", n_u=20.0, n_v=300.0, r_s=r_s)
        found = albedo.directional_albedo(model, cosines, 0.6, rtol=1e-10)
        bound = r_s + (1.0 - r_s) * (1.0 - 0.5 * cosines) ** 5
        gaps[r_s] = bound - found.value, found.error
    mixed = 0.7 * gaps[0.0][0] + 0.3 * gaps[1.0][0]
    allowed = gaps[0.3][1] + 0.7 * gaps[0.0][1] + 0.3 * gaps[1.0][1] + 16.0 * EPS
    assert np.all(np.abs(gaps[0.3][0] - mixed) <= allowed)


def test_the_diffuse_constant_in_whole_numbers():
    formulas = load("as_formulas")
    assert str(formulas.closed_constant()) == "28/23"
    value, error = quad(lambda x: (1.0 - (1.0 - 0.5 * x) ** 5) * x, 0.0, 1.0)
    assert abs(1.0 / (2.0 * value) - 28.0 / 23.0) <= 2.0 * error / value**2


@pytest.mark.parametrize(
    ("name", "verdicts"),
    [
        ("as_fig1", {}),
        ("as_fig2", {"A2": {"fails"}}),
        ("as_fig4", {"A7": {"holds", "fails"}}),
        ("as_formulas", {"A1": {"holds"}, "A4": {"holds"}, "A6": {"holds"}}),
        ("as_energy", {"A3": {"holds"}, "A5": {"holds"}, "A11": {"holds"}}),
    ],
)
def test_verdicts(name, verdicts, tmp_path):
    manifest = run_study(StudyFile(STUDIES / f"{name}.py"), tmp_path).manifest
    assert manifest["error"] is None
    assert manifest["warnings"] == []
    found: dict[str, set[str]] = {}
    for claim in manifest["claims"]:
        found.setdefault(claim["id"], set()).add(claim["verdict"])
    assert found == verdicts
    # Whatever does not simply hold is explained.
    assert {id for id, several in found.items() if several != {"holds"}} == set(
        manifest["explanations"]
    )
