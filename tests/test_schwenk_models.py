"""What the studies of Schwenk's survey compute, against raw formulas and closed forms."""

from __future__ import annotations

import math
import sys
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any

import mpmath
import numpy as np
import pytest
from scipy.integrate import quad

import albedo
from albedo.analysis.pairs import direction_pairs, largest_relative_difference
from albedo.errors import InputError
from albedo.metals import refractive_index
from albedo.studies import Context, StudyFile

STUDIES = Path(__file__).parent.parent / "studies"
EPS = float(np.finfo(float).eps)


def load(name: str) -> ModuleType:
    StudyFile(STUDIES / f"{name}.py").load()
    return sys.modules[f"albedo_study_{name}"]


def judged(module: ModuleType, folder: Path) -> Context:
    """A context that takes claims."""
    return Context(module.STUDY, folder, False)


def verdicts(context: Context) -> list[str]:
    return [claim["verdict"] for claim in context._claims]


# Pairs of directions


def test_pairs_lie_above_the_horizon_and_where_lobes_are():
    wi, wo = direction_pairs(3000, 3)
    for v in (wi, wo):
        # Each component is a product of two or three rounded numbers.
        np.testing.assert_allclose(np.linalg.norm(v, axis=-1), 1.0, atol=8.0 * EPS, rtol=0.0)
        assert np.all(v[:, 2] > 0.0)
    assert min(wi[:, 2].min(), wo[:, 2].min()) < 1e-5
    beside = np.linalg.norm(wo - wi * (-1.0, -1.0, 1.0), axis=-1)
    assert np.sum(beside < 1e-3) > 300
    again = direction_pairs(3000, 3)
    np.testing.assert_array_equal(again, (wi, wo))
    assert np.any(direction_pairs(3000, 4)[0] != wi)


@pytest.mark.parametrize(("count", "lowest"), [(2, 1e-6), (30, 0.0), (30, 1.0)])
def test_pairs_refuse_what_is_out_of_range(count: int, lowest: float):
    with pytest.raises(InputError, match="out of range"):
        direction_pairs(count, lowest=lowest)


def test_differences_are_relative_to_the_larger_value():
    off, at = largest_relative_difference(np.array([0.0, 1.0, 3.0]), np.array([0.0, 2.0, 3.0]))
    assert (off, at) == (0.5, 1)
    assert largest_relative_difference(np.zeros(2), np.zeros(2)) == (0.0, 0)


# Fresnel


def exact_factor(n: float, k: float, u: Any) -> Any:
    """Eqs. 10 to 12, with complex numbers: the exact unpolarised reflectance."""
    index = mpmath.mpc(n, k)
    inside = mpmath.sqrt(1 - (1 - u * u) / index**2)
    along = (index * u - inside) / (index * u + inside)
    across = (u - index * inside) / (u + index * inside)
    return (abs(along) ** 2 + abs(across) ** 2) / 2


def schlick_form(n: float, k: float, u: Any) -> Any:
    """Eq. 17 as printed."""
    return ((n - 1) ** 2 + 4 * n * (1 - u) ** 5 + k * k) / ((n + 1) ** 2 + k * k)


@pytest.mark.parametrize("metal", [None, "aluminium", "gold"])
def test_errors_of_fresnel_factors_against_complex_arithmetic(metal: str | None):
    study = load("schwenk_fresnel")
    n, k = (1.5, 0.0) if metal is None else map(float, refractive_index(metal, 0.56))
    found = study.measured("schlick", n, k)

    def off(u: Any) -> Any:
        return abs(schlick_form(n, k, u) - exact_factor(n, k, u))

    top = float(np.sin(np.radians(90.0 - found["largest_at_deg"])))
    peak = mpmath.findroot(lambda u: mpmath.diff(off, u), top)
    assert abs(float(off(peak)) - found["largest"]) <= found["largest_error"]
    assert float(off(peak)) >= max(float(off(mpmath.mpf(j) / 60)) for j in range(61))
    # Signs change where the two curves cross: panels end there.
    grid = np.linspace(1e-6, 1.0 - 1e-6, 400)
    signed = [float(schlick_form(n, k, u) - exact_factor(n, k, u)) for u in map(float, grid)]
    cuts = [float(grid[j]) for j in range(1, 400) if signed[j] * signed[j - 1] < 0.0]
    edges = [0.0, *cuts, 1.0]
    mean = sum(
        quad(lambda u: 2.0 * u * float(off(u)), low, high, epsabs=1e-11)[0]
        for low, high in pairwise(edges)
    )
    # A crossing is within a step of the grid, where the error is below a step times its slope.
    assert abs(mean - found["mean"]) <= found["mean_error"] + 1e-6


def test_verdicts_of_fresnel_factors(tmp_path: Path):
    study = load("schwenk_fresnel")
    context = judged(study, tmp_path)
    metals = study.measure_metals(("glassner",))
    study.judge(context, study.measure_dielectrics(4), metals)
    readings = [claim["reading"] for claim in context._claims]
    assert len(set(readings)) == 8
    # Every angle, mean: n = 1.5; all n; eq. 17 as printed; with the error term.
    assert verdicts(context) == ["fails", "holds", *["fails"] * 4, "fails", "holds"]
    # The three equations are one function.
    for n, k in metals[["n", "k"]].itertuples(index=False):
        other = schlick_form(n, k, study.GRID)
        np.testing.assert_allclose(study.printed(study.GRID, n, k), other, rtol=8.0 * EPS)


# Oren and Nayar


def full_form(sigma: float, theta_a: Any, theta_b: Any, phi: Any) -> Any:
    """Oren and Nayar's two terms for rho = 1, in angles; theta_a >= theta_b."""
    s2 = sigma * sigma
    c = np.cos(phi)
    beta = 2.0 * theta_b / math.pi
    lobe = s2 / (s2 + 0.09)
    c_1 = 1.0 - 0.5 * s2 / (s2 + 0.33)
    c_2 = 0.45 * lobe * (np.sin(theta_a) - np.where(c < 0.0, beta**3, 0.0))
    c_3 = 0.125 * lobe * (4.0 * theta_a * theta_b / math.pi**2) ** 2
    first = c_1 + c * c_2 * np.tan(theta_b)
    first = first + (1.0 - np.abs(c)) * c_3 * np.tan(0.5 * (theta_a + theta_b))
    return (first + 0.17 * s2 / (s2 + 0.13) * (1.0 - c * beta**2)) / math.pi


def test_average_of_the_full_form_exceeds_one():
    """Over theta_b < theta_a, and twice: a product rule on pieces without kinks."""
    sigma = 0.1
    x, w = np.polynomial.legendre.leggauss(40)
    x, w = 0.5 * (x + 1.0), 0.5 * w
    half = 0.5 * math.pi

    def average(x: np.ndarray, w: np.ndarray) -> float:
        a = half * x[:, None, None]
        b = a * x[None, :, None]
        weights = half * w[:, None, None] * a * w[None, :, None] * half * w
        total = 0.0
        for start in (0.0, half):
            phi = start + half * x
            # f cos sin of both directions; 2 pi and both signs of phi, over pi.
            value = full_form(sigma, a, b, phi) * np.sin(2.0 * a) * np.sin(2.0 * b) / 4.0
            total += float(np.sum(weights * value))
        return 2.0 * 4.0 * total

    found = albedo.average_albedo(albedo.model("oren_nayar_full", sigma=sigma), rtol=1e-9)
    coarse = np.polynomial.legendre.leggauss(30)
    other = average(0.5 * (coarse[0] + 1.0), 0.5 * coarse[1])
    exact = average(x, w)
    assert abs(exact - float(found.value)) <= float(found.error) + abs(exact - other) + 1e-13
    assert exact > 1.0001


def test_extremes_of_oren_and_nayar(tmp_path: Path):
    study = load("schwenk_oren_nayar")
    ends = study.extremes(6, 1e-6)
    context = judged(study, tmp_path)
    study.judge_smooth(context, study.compare_smooth(3000))
    study.judge_energy(context, ends)
    study.say(context, ends)
    assert verdicts(context) == ["holds"] * 6
    # At the horizon the qualitative form is A + B/2, and at normal incidence A.
    for row in ends[ends["model"] == "oren_nayar"].to_dict("records"):
        s2 = row["sigma"] ** 2
        a, b = 1.0 - 0.5 * s2 / (s2 + 0.33), 0.45 * s2 / (s2 + 0.09)
        # The map goes to n.l = 1e-9, not to the horizon itself.
        assert abs(row["max_albedo"] - (a + 0.5 * b)) <= row["max_albedo_error"] + 1e-8
        assert abs(row["min_albedo"] - a) <= row["min_albedo_error"]


# Ashikhmin and Shirley


def test_the_power_is_normalised_over_solid_angle(tmp_path: Path):
    study = load("schwenk_ashikhmin_shirley")
    exponents = ((0.0, 0.0), (10.0, 10.0), (10.0, 1e3))
    integrals = study.integrate(exponents)
    for row in integrals.to_dict("records"):
        assert abs(row["projected"] - row["closed_form"]) <= row["projected_error"] + 4.0 * EPS
        p_h = row["solid_angle"]
        if row["constant"] == "with 1/(2π), as p_h":
            assert abs(p_h - 1.0) <= row["solid_angle_error"] + 4.0 * EPS
    ten = integrals[(integrals["n_u"] == 10.0) & (integrals["n_v"] == 10.0)]
    assert set(ten["closed_form"].round(12)) == {
        round(2.0 * math.pi * 11.0 / 12.0, 12),
        round(11.0 / 12.0, 12),
        1.0,
    }
    context = judged(study, tmp_path)
    study.judge_distribution(context, study.compare_values(exponents, 3000), integrals)
    # Equality with the constants as printed, of p_h, projected; then the integral.
    assert verdicts(context) == ["fails", "holds", "fails", "fails", "fails", "holds"]


def test_the_geometry_term_is_at_most_n_dot_h():
    study = load("schwenk_ashikhmin_shirley")
    wi, wo = direction_pairs(3000, 1)
    h = wi + wo
    h /= np.linalg.norm(h, axis=-1, keepdims=True)
    g = study.geometry_term(wi, wo)
    # The sum l + v is no shorter than 1e-6 here, but rounds absolutely: only long ones are seen.
    clear = np.linalg.norm(wi + wo, axis=-1) > 0.1
    v_dot_h = np.sum(wo * h, axis=-1)
    raw = np.minimum(wi[:, 2], wo[:, 2]) / v_dot_h
    np.testing.assert_allclose(g[clear], raw[clear], rtol=200.0 * EPS)
    assert np.all(g[clear] <= h[clear, 2] * (1.0 + 200.0 * EPS))


def mirror_albedo(n: float) -> float:
    """Of the isotropic lobe at normal incidence, F = 1: a draw of h counts n.v = cos(2 theta)."""
    low = math.sqrt(0.5)
    return (n + 1.0) * sum(
        sign * (1.0 - low**power) / power for sign, power in ((2.0, n + 3.0), (-1.0, n + 1.0))
    )


def test_room_for_a_lambertian_term(tmp_path: Path):
    study = load("schwenk_ashikhmin_shirley")
    field = study.diffuse_room(2)
    context = judged(study, tmp_path)
    study.judge_diffuse(context, field)
    assert verdicts(context) == ["holds", "holds"]
    for row in field.to_dict("records"):
        assert row["paper"] - row["paper_error"] <= 1.0
        total = row["lambert"] + row["room"]
        assert abs(total - 2.0) <= row["lambert_error"] + row["room_error"] + 4.0 * EPS
        if row["r_s"] == 1.0 and row["at_cos_theta"] == 1.0:
            assert abs(row["lobe"] - mirror_albedo(row["n"])) <= row["lobe_error"]


# Lafortune


def test_lafortunes_lobe_is_the_power_of_r_dot_v(tmp_path: Path, rng: np.random.Generator):
    study = load("schwenk_lafortune")
    z, phi = rng.uniform(0.05, 1.0, (2, 500)), rng.uniform(0.0, 2.0 * math.pi, (2, 500))
    wi, wo = (albedo.directions.spherical(c, p) for c, p in zip(z, phi, strict=True))
    r = 2.0 * wi[:, 2:] * (0.0, 0.0, 1.0) - wi
    r_v = np.sum(r * wo, axis=-1)
    power = np.maximum(r_v, 0.0) ** 20
    clear = r_v > 0.1
    # A rounding of r.v counts twenty times, and by 1/(r.v).
    found = albedo.model("lafortune").eval(wi, wo)
    np.testing.assert_allclose(found[clear], power[clear], rtol=20.0 * 4.0 * EPS / 0.1)
    context = judged(study, tmp_path)
    values = study.compare_values(3000)
    curves = study.compare_albedos(np.array([1.0, 0.5, 0.1]), (5.0, 20.0))
    study.judge(context, values, curves)
    assert verdicts(context) == ["holds", "holds", "fails", "fails"]
    # The albedo of the reciprocal Phong lobe at normal incidence is 1.
    first = curves[curves["cos_theta"] == 1.0]
    assert np.all(np.abs(first["lafortune"] - 1.0) <= first["lafortune_error"] + 4.0 * EPS)


# Strauss


def test_strauss_exponent_and_what_is_left_at_normal_incidence(tmp_path: Path):
    study = load("schwenk_strauss")
    frame = study.measure_exponents()
    for row in frame.to_dict("records"):
        s = row["smoothness"]
        e = 3.0 / (1.0 - s)
        assert abs(row["exponent"] - e) <= row["exponent_error"]
        share = 2.0 * s**3 / (e + 2.0)
        assert abs(row["lobe_share"] - share) <= row["lobe_share_error"] + 4.0 * EPS * share
        whole = (1.0 - s**3) * (1.0 - s) + share
        assert abs(row["normal_albedo"] - whole) <= row["normal_albedo_error"] + 4.0 * EPS
    context = judged(study, tmp_path)
    study.judge_exponents(context, frame)
    study.judge_energy(context, study.leave(("white metal",), (0.6, 0.9), 1e-6))
    assert verdicts(context) == ["holds"] * 3


def test_strauss_albedo_passes_one_where_it_is_said_to():
    """The lighting equation in raw angles, by midpoints over the hemisphere."""
    study = load("schwenk_strauss")
    s = 0.6
    field = study.leave(("white metal",), (s,), 1e-6)
    cosine = float(field["passes_one_at"].iloc[0])
    theta = math.acos(cosine)

    def f(x: Any) -> Any:
        return (1.0 / (x - 1.12) ** 2 - 1.0 / 1.12**2) / (1.0 / 0.12**2 - 1.0 / 1.12**2)

    def g(x: Any) -> Any:
        return (1.0 / 0.01**2 - 1.0 / (x - 1.01) ** 2) / (1.0 / 0.01**2 - 1.0 / 1.01**2)

    def whole(count: int) -> float:
        t = (np.arange(count) + 0.5) / count * 0.5 * math.pi
        phi = (np.arange(count) + 0.5) / count * math.pi
        cos_v, sin_v = np.cos(t)[:, None], np.sin(t)[:, None]
        r_v = np.maximum(cosine * cos_v - math.sin(theta) * sin_v * np.cos(phi), 0.0)
        x_l, x_v = 2.0 * theta / math.pi, 2.0 * t[:, None] / math.pi
        r_n = s**3
        r_j = np.minimum(1.0, r_n + (r_n + 0.1) * f(x_l) * g(x_l) * g(x_v))
        j = (1.0 - r_n) * (1.0 - s) + r_j * r_v ** (3.0 / (1.0 - s)) / cosine
        step = 0.5 * math.pi / count * math.pi / count
        return float(np.sum(2.0 * j / math.pi * cos_v * sin_v) * step)

    fine = whole(800)
    # Midpoints err by the square of a step, a third of what half as many of them change.
    assert abs(fine - 1.0) <= abs(fine - whole(400)) + 1e-9


# Schwenk


def highlight_at_normal(s: float, f0: float) -> float:
    """8 s^2 times the integral of F cos^e cos(2 theta) sin(theta), h above 45 degrees."""
    e = 2.0 / (1.0 + 1.0 / 255.0 - s)

    def integrand(t: float) -> float:
        c = math.cos(t)
        factor = f0 + (1.0 - f0) * (1.0 - c) ** 5
        return factor * c**e * math.cos(2.0 * t) * math.sin(t)

    return 8.0 * s * s * quad(integrand, 0.0, 0.25 * math.pi, epsabs=1e-13)[0]


def test_schwenks_exponent_and_highlight(tmp_path: Path):
    study = load("schwenk_own_model")
    frame = study.measure_exponents(5)
    for row in frame.to_dict("records"):
        s = row["smoothness"]
        assert abs(row["exponent"] - 2.0 / (1.0 + 1.0 / 255.0 - s)) <= row["exponent_error"]
        assert abs(row["normal"] - highlight_at_normal(s, 1.0)) <= row["normal_error"] + 1e-12
    sets = (["white", "red"], np.array([0.0, 0.8]), 2, 1e-5)
    whole, lobe = study.energy(1.0, *sets), study.energy(0.0, *sets)
    # C' of the red channel, by the weights of the luminance.
    hue = 0.8 / (0.2126 * 0.8 + 0.7152 * 0.1 + 0.0722 * 0.05)
    for frame_of, diffuse in ((whole, 0.8), (lobe, 0.0)):
        picked = frame_of[
            (frame_of["color"] == "red")
            & (frame_of["smoothness"] == 0.8)
            & (frame_of["metalness"] == 1.0)
        ]
        row = picked.iloc[0]
        assert row["channel"] == 0
        assert row["max_cos_theta"] == 1.0
        exact = diffuse + highlight_at_normal(0.8, hue)
        assert abs(row["max_albedo"] - exact) <= row["max_albedo_error"] + 1e-12
    context = judged(study, tmp_path)
    study.judge_exponents(context, frame)
    study.judge_energy(context, whole, lobe)
    assert verdicts(context) == ["holds"] * 4


# Figure 7


def ward_at_normal(alpha: float) -> float:
    """Ward's albedo at normal incidence, over the angle of h."""

    def integrand(t: float) -> float:
        tan = math.tan(t) / alpha
        root = math.sqrt(math.cos(2.0 * t))
        return math.exp(-tan * tan) * root * math.cos(t) * math.sin(t)

    # dV = 4 v.h dh, over 4 pi alpha^2, and 2 pi of azimuth.
    return 2.0 / alpha**2 * quad(integrand, 0.0, 0.25 * math.pi, epsabs=1e-12)[0]


def test_maps_of_figure_7():
    study = load("schwenk_fig7")
    furnace = study.furnace_maps(3, 3, 1e-5)
    top = furnace[furnace["cos_theta"] == 1.0]
    for name, exact in (
        ("ashikhmin_shirley_1", mirror_albedo(2.0 / study.MEAN**2 - 2.0)),
        ("ward_1", ward_at_normal(study.MEAN)),
    ):
        assert np.all(np.abs(top[name] - exact) <= top[f"{name}_error"] + 1e-10)
    lobes = study.lobe_maps(21)
    radius = np.hypot(lobes["v_x"], lobes["v_y"])
    assert radius.max() < 1.0
    # Light along a ridge: the lobe of a wide alpha_x is the wider one along x.
    light = study.light_direction()
    across = np.abs(lobes["v_y"] + light[1]) < 0.05
    wide = lobes.loc[across, "ward_8"] > 1e-2
    narrow = lobes.loc[across, "ward_1"] > 1e-2
    assert wide.sum() > narrow.sum() > 0
    summary = study.summarise(lobes, furnace)
    assert len(summary) == 8
    assert np.all(summary["largest"] + summary["largest_error"] < 1.0)
    isotropic = summary[summary["ratio"] == 1.0]
    assert np.all(isotropic["azimuthal_spread"] < 1e-9)
