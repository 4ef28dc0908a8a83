"""Output radiance and its largest value, against closed forms and other searches."""

from __future__ import annotations

import math
from collections.abc import Callable

import cases
import exact
import numpy as np
import pytest
from scipy.optimize import minimize

import albedo
from albedo.analysis.radiance import Peak, output_radiance, peak, plane_radiance
from albedo.brdf import Model
from albedo.catalogue.blinn import normalization
from albedo.directions import spherical
from albedo.errors import InputError

EPS = np.finfo(float).eps
COSINES = (1.0, 0.9, 0.5, 0.05, 1e-4)


def mirror(c: float, phi: float = 0.0) -> np.ndarray:
    return spherical(c, phi + math.pi)


@pytest.mark.parametrize("c", COSINES)
@pytest.mark.parametrize("n", [1.0, 20.0, 1e4, 1e9])
@pytest.mark.parametrize(
    ("name", "largest"),
    [
        ("phong", lambda n, c: (n + 2.0) / (2.0 * math.pi) * c),
        ("phong_original", lambda n, c: 1.0),
        ("max_phong", lambda n, c: (n + 2.0) / (2.0 * math.pi)),
        ("blinn", lambda n, c: normalization(n) * c),
    ],
)
def test_lobes_about_the_mirror_direction_peak_there(
    name: str, largest: Callable[[float, float], float], n: float, c: float
) -> None:
    """Powers of R.V and N.H are largest at R; eq. 22 has a kink there, and keeps its height."""
    found = peak(albedo.model(name, n=n), c, 0.3)
    # Three roundings in the closed form.
    exact_value = largest(n, c)
    assert abs(found.value - exact_value) <= found.error + 4 * EPS * exact_value
    assert found.error <= 1e-13 * found.value
    assert found.angle_from_mirror == 0.0
    assert not found.off_specular
    assert found.bracket <= 1e-6
    assert abs(found.at_mirror - found.value) <= found.error + found.at_mirror_error
    np.testing.assert_allclose(found.direction, mirror(c, 0.3), rtol=0, atol=1e-15)


@pytest.mark.parametrize("c", [0.9, 0.5, 0.05, 1e-3])
def test_a_scaled_lobe_peaks_beside_the_mirror_direction(c: float) -> None:
    """NNS eq. 7 is a power of V.(-l_x, -l_y, s l_z): largest along that vector."""
    s, n = 0.8, 50.0
    model = albedo.model("lafortune_scaled", n=n, s=s)
    found = peak(model, c)
    sine = math.sqrt((1.0 - c) * (1.0 + c))
    length = math.hypot(sine, s * c)
    scale, doubt = model.normalization
    known = scale * length**n * c
    assert abs(found.value - known) <= found.error + (doubt + 1e-13) * known
    assert found.off_specular
    angle = math.atan2(s * c, sine) - math.atan2(c, sine)
    assert abs(found.angle_from_mirror - abs(angle)) <= found.bracket
    assert abs(found.cos_view - s * c / length) <= found.bracket


def test_a_constant_has_its_peak_everywhere() -> None:
    found = peak(albedo.model("lambert", rho=0.5), 0.3)
    assert abs(found.value - 0.15 / math.pi) <= found.error
    assert found.bracket == math.pi
    assert not found.off_specular


def test_ward_grows_without_limit_towards_the_horizon() -> None:
    found = peak(albedo.model("ward", m=0.2), 0.5)
    assert found.value == math.inf
    assert found.cos_view == 0.0
    # Its lobe does not reach the horizon from the normal.
    found = peak(albedo.model("ward", m=0.1), 1.0)
    assert abs(found.value - 1.0 / (4.0 * math.pi * 0.01)) <= found.error + 4 * EPS * found.value
    assert found.angle_from_mirror == 0.0


@pytest.mark.parametrize("steps", [1, 2])
def test_ward_pumped_up_is_bounded(steps: int) -> None:
    """Its albedo grows towards grazing views as its values do, down to where none is known."""
    model = albedo.pump(albedo.model("ward", m=0.3), steps)
    for c in (0.5, 1e-4, 1e-12):
        found = peak(model, c)
        heights = np.append(c, np.geomspace(1.0, 1e-16, 400))
        views = np.stack([spherical(v, math.pi) for v in heights.tolist()])
        near = output_radiance(model, spherical(c, 0.0), views)
        assert np.all(near.value - near.error <= found.value + found.error)
        # Heights a tenth apart show a corner to less than a hundredth.
        assert found.value - found.error <= 1.01 * near.value.max()
    low = spherical(2.0**-65, math.pi)
    assert np.isnan(model.eval(spherical(0.5, 0.0), low))
    assert output_radiance(model, spherical(0.5, 0.0), low).error == math.inf
    # Where an albedo has a limit, it is known.
    phong = albedo.pump(albedo.model("phong", n=20), steps)
    assert np.isfinite(output_radiance(phong, spherical(0.5, 0.0), low).error)


def test_a_limit_at_the_horizon() -> None:
    """Oren and Nayar's model is brightest there, behind the light."""
    model = albedo.model("oren_nayar", sigma=0.5)
    found = peak(model, 0.5)
    assert found.cos_view == 0.0
    assert found.direction[0] > 0.99
    near = output_radiance(model, spherical(0.5, 0.0), spherical(1e-12, 0.0))
    assert abs(found.value - near.value) <= found.error + near.error + 1e-11 * found.value


SHARP = [
    albedo.model("cook_torrance", m=0.3),
    albedo.model("cook_torrance", m=0.2, distribution="ggx", geometry="smith_correlated"),
    albedo.model("ashikhmin_shirley", n_u=1000, n_v=10),
    albedo.model("ward_bounded", alpha_x=0.05, alpha_y=0.4),
    albedo.model("he_torrance"),
    albedo.model("strauss"),
    albedo.model("max_phong_anisotropic"),
    albedo.model("ashikhmin_shirley", n=100, r_s=0.3, r_d=0.5),
]


@pytest.mark.parametrize("model", SHARP, ids=lambda m: m.spec)
@pytest.mark.parametrize("c", [0.95, 0.6, 0.25])
def test_another_search_finds_nothing_brighter(
    model: Model, c: float, rng: np.random.Generator
) -> None:
    """Nelder and Mead's simplex, from the brightest of many draws; and their values."""
    phi = 0.4
    wi = spherical(c, phi)
    found = peak(model, c, phi)

    def dimmer(x: np.ndarray) -> float:
        theta, turn = x
        if not 0.0 <= theta < 0.5 * math.pi:
            return 0.0
        return -c * float(model.eval(wi, spherical(math.cos(theta), turn)))

    drawn = model.sample(rng.uniform(size=(4096, 2)), wi).wo
    drawn = drawn[drawn[:, 2] > 0.0]
    values = c * model.eval(wi, drawn)
    assert np.all(values <= found.value + found.error)
    best = -math.inf
    for k in np.argsort(values)[-4:]:
        start = [math.acos(drawn[k, 2]), math.atan2(drawn[k, 1], drawn[k, 0])]
        other = minimize(
            *(dimmer, start),
            method="Nelder-Mead",
            options={"xatol": 1e-10, "fatol": 1e-14 * found.value, "maxiter": 4000},
        )
        best = max(best, -other.fun)
    assert best <= found.value + found.error
    # The simplex may stop on a kink; it comes near.
    assert best >= 0.98 * found.value


# Choices and cases beside the defaults take a minute.
DEFAULTS = [kind() for kind in albedo.models().values()]
EVERY = [*DEFAULTS, *(m for m in cases.MODERATE if m not in DEFAULTS)]


@pytest.mark.parametrize(
    "model",
    [m if m in DEFAULTS else pytest.param(m, marks=pytest.mark.slow) for m in EVERY],
    ids=lambda m: m.spec,
)
def test_no_draw_is_brighter_than_the_peak(model: Model, rng: np.random.Generator) -> None:
    kind = model.by_channel()[0]
    if not kind.parts():
        assert peak(kind, 0.5).value == 0.0
        return
    for c in (1.0, 0.7, 0.1):
        found = peak(kind, c, 0.2)
        wi = spherical(c, 0.2)
        anywhere = spherical(rng.uniform(1e-3, 1.0, 500), rng.uniform(-math.pi, math.pi, 500))
        drawn = kind.sample(rng.uniform(size=(500, 2)), wi).wo
        views = np.concatenate((anywhere, drawn[drawn[:, 2] > 0.0]))
        seen = output_radiance(kind, wi, views)
        assert np.all(seen.value <= found.value + found.error + seen.error)
        assert found.at_mirror <= found.value + found.error + found.at_mirror_error


VALUES = ("phong", "blinn", "ward", "cook_torrance", "ashikhmin_shirley", "max_phong", "strauss")


@pytest.mark.parametrize("name", VALUES)
def test_bounds_of_values_hold(name: str, rng: np.random.Generator) -> None:
    """Against forty digits, for the coordinates as they are and within an ulp of them."""
    model = albedo.model(name)
    wi = spherical(rng.uniform(0.05, 1.0, 6), rng.uniform(-3.0, 3.0, 6))
    away = wi * np.array([-1.0, -1.0, 1.0]) + 0.1 * rng.normal(size=(6, 3))
    away[:, 2] = np.abs(away[:, 2]) + 0.01
    wo = away / np.linalg.norm(away, axis=1, keepdims=True)
    found = output_radiance(model, wi, wo)
    assert found.kind == "bound"
    for k in range(6):
        value, slack = exact.brdf_with_slack(model, wi[k], wo[k])
        c = wi[k, 2]
        assert abs(found.value[k] - value * c) <= found.error[k] + slack * c
        assert found.error[k] <= 1e-10 * found.value[k] + 1e-300


def test_a_plane_is_where_the_directions_are() -> None:
    model = albedo.model("ashikhmin_shirley", n_u=100, n_v=10)
    angles = np.radians([-80.0, -20.0, 0.0, 30.0, 59.9, 60.0, 80.0])
    wi = spherical(0.5, 0.7)
    for azimuth in (0.0, 0.4, -2.0):
        found = plane_radiance(model, 0.5, angles, azimuth, phi=0.7)
        views = spherical(np.cos(angles), 0.7 + math.pi + azimuth + math.pi * (angles < 0))
        other = output_radiance(model, wi, views)
        # Azimuths are rounded before they are turned.
        np.testing.assert_allclose(found.value, other.value, rtol=1e-11)
    ends = plane_radiance(model, 0.5, [-0.5 * math.pi, 0.5 * math.pi])
    assert np.all(ends.value == 0.0)
    assert output_radiance(model, wi, -wi).value == 0.0


def test_views_close_to_the_mirror_direction_keep_their_digits() -> None:
    """At grazing incidence a lobe of a billionth is seen as well as at the normal."""
    model, c = albedo.model("phong", n=1e9), 1e-6
    theta = math.acos(c)
    delta = np.array([0.0, 1e-5, 3e-5])
    found = plane_radiance(model, c, theta - delta)
    known = (1e9 + 2.0) / (2.0 * math.pi) * c * np.exp(1e9 * np.log(np.cos(delta)))
    # The angles err by half an ulp of pi/2, which the power of a billion makes 4e-6 of.
    assert np.all(np.abs(found.value - known) <= 1e-5 * known)


def steps_of(model: Model, control: str | None, steps: int, c: float) -> tuple[Peak, float, float]:
    pumped = albedo.pump(model, steps, control)
    product = math.prod(float(curve(np.array([c]))[0]) for curve in pumped.albedos)
    if control == "cumulative":
        product = max(product, c)
    if control == "literal":
        terms = [max(float(curve(np.array([c]))[0]), c) for curve in pumped.albedos]
        product = math.prod(terms)
    doubt = sum(float(curve.error.max()) for curve in pumped.albedos)
    return peak(pumped, c), product, doubt


@pytest.mark.parametrize("control", [None, "literal", "cumulative"])
@pytest.mark.parametrize("name", ["phong", "blinn"])
def test_what_is_pumped_up_peaks_in_the_mirror_direction(name: str, control: str | None) -> None:
    """No divisor is smaller than at V as high as L: g(L, V) >= g(L, R)."""
    base = albedo.model(name, n=20)
    for c in (1.0, 0.5, 0.05, 1e-3):
        found, product, doubt = steps_of(base, control, 2, c)
        known = peak(base, c).value / product
        assert abs(found.value - known) <= found.error + (doubt + 8 * EPS) * known
        assert found.angle_from_mirror == 0.0


def test_a_function_of_ones_own() -> None:
    """A bump beside the mirror direction, with a declared lobe and without."""
    bump = spherical(0.6, 2.5)

    def f(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        return np.exp(-20.0 * (1.0 - wo @ bump))

    for model in (
        albedo.model_from(f, lobe="diffuse"),
        albedo.model_from(f, resolved_width=0.1),
    ):
        found = peak(model, 0.8)
        assert abs(found.value - 0.8) <= found.error
        chord = float(np.linalg.norm(found.direction - bump))
        assert chord <= found.bracket <= 1e-6


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda m: peak(m, 0.0), r"cos_theta = 0\.0 is out of range"),
        (lambda m: peak(m, 1.5), r"cos_theta = 1\.5"),
        (lambda m: peak(m, [0.5, 0.6]), "it is a number"),
        (lambda m: peak(m, 0.5, [0.1]), "it is one number"),
        (lambda m: plane_radiance(m, 0.5, 2.0), "theta_view = 2"),
        (lambda m: output_radiance(m, (0, 0, 2), (0, 0, 1)), "length 2"),
        (lambda m: output_radiance(m, np.eye(3), np.ones((2, 3)) / 3**0.5), "do not broadcast"),
        (lambda m: peak(albedo.model("schlick", color=(0.1, 0.2)), 0.5), "has 2 channels"),
    ],
)
def test_bad_input(make: Callable[[Model], object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        make(albedo.model("lambert"))
