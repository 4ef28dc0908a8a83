"""The chart of rings beside the charts in which models are integrated."""

from __future__ import annotations

import math

import numpy as np
import pytest
from cases import anywhere

import albedo
from albedo.brdf import Model, Part
from albedo.charts.rings import RingsChart, elevation, elevations, expm1_all
from albedo.directions import spherical
from albedo.grammar import parse
from albedo.integrators.adaptive import Result, integrate, refine
from albedo.integrators.cells import Cells, ModelIntegrand, evaluate, whole_rings
from albedo.operators.ladder import rings_of

EPS = np.finfo(float).eps
COSINES = np.concatenate((np.geomspace(1e-9, 1e-2, 5), np.linspace(0.03, 1.0, 12)))
MODELS = [
    "lambert",
    "phong:n=0.5",
    "phong:n=20",
    "phong:n=1e6",
    "blinn:n=20",
    "max_phong:n=100",
    "cook_torrance:m=0.1",
    "cook_torrance:m=0.4",
    "cook_torrance:m=1e-4",
    "cook_torrance:m=0.3,distribution=ggx,geometry=smith_correlated",
    "cook_torrance:m=1e-3,distribution=ggx,geometry=smith_correlated",
    "ward:m=0.1",
    "ward_bounded:m=0.3",
    "ashikhmin_shirley:n=100,r_d=0.5",
    "he_torrance:sigma0=0.1",
    "schlick:roughness=1e-3,form=residual",
    "stam_gaussian",
    # Waves: next to the horizon a lobe is far longer than wide.
    "he_torrance:sigma0=2.7e-3,tau=279,mirror=off",
    "he_torrance:sigma0=9e-3,tau=54,fresnel=dielectric",
    "he_torrance:sigma0=0.02,mirror=off",
    "he_torrance:sigma0=1,tau=20",
    "stam_gaussian:sigma=5e-4,t_x=134,t_y=134",
    "stam_gaussian:sigma=0.067,t_x=63,t_y=63",
    "stam_gaussian:sigma=1,t_x=20,t_y=20",
    "oren_nayar",
    "oren_nayar_full",
    # Cut off at 0 opposite the light.
    "oren_nayar_full:rho=0.05,sigma=0.8",
    "oren_nayar_full:rho=0.5,sigma=1.26",
    "ashikhmin_shirley:specular=none,r_s=0.4,r_d=0.2",
    "fujii",
    "eon",
    "max_phong:n=20,variant=retro",
    "max_phong:n=0.5,variant=retro",
    "max_phong_anisotropic:n_u=50,n_v=50",
    # Towards the light, off the mirror direction, along the horizon and below it.
    *(
        f"lafortune:lobes=(({c},{c},{d},{n}))"
        for n in ("0.5", "7.3", "200", "1e8")
        for c, d in ((1, 1), (-1, 0.3), (-1, 0), (-1, -0.02), (1, -0.7), (-0.01, -1))
        if not (d == -1 and n == "200")
    ),
    "lafortune:lobes=((-0.5,-0.5,1,20),(1,1,1,3)),rho_d=0.1",
    "lafortune_scaled:s=0.5,n=3",
    "lafortune_scaled",
    "lafortune_scaled:s=0.999999,n=1e6",
]


def over(
    part: Part,
    chart: object,
    p: np.ndarray,
    rtol: float = 1e-9,
    limit: int = 10**6,
    cosines: np.ndarray = COSINES,
) -> Result:
    n = cosines.size
    integrand = ModelIntegrand(part.fill, np.tile(p, (n, 1)), np.ones(n))
    return integrate(
        *(chart, integrand, cosines, np.zeros(n), np.tile(part.widths, (n, 1)), True),
        rtol=rtol,
        atol=0.0,
        limit=limit,
    )


@pytest.mark.parametrize("spec", MODELS)
def test_rings_agree_with_the_chart_of_the_model(spec: str) -> None:
    model = next(parse(spec).models())
    for part in model.parts():
        p = part.packed(np.array([model.pack()], dtype=float))
        own = over(part, part.chart, p)
        for limit in (600, 3000, 10**6):
            found = over(part, rings_of(part), p, limit=limit)
            assert np.all(np.abs(found.value - own.value) <= found.error + own.error)
        assert found.converged.all()


@pytest.mark.parametrize("spec", ["ward:m=1e-6", "phong:n=1e9"])
def test_rings_within_a_narrow_lobe_of_the_normal_have_all_digits(spec: str) -> None:
    """Radii of rings from cosines of elevations had noise of 4e-10 in the sums."""
    model = next(parse(spec).models())
    (part,) = model.parts()
    p = part.packed(np.array([model.pack()], dtype=float))
    cosines = np.cos([0.0, 1e-7, 1e-6, 1e-5, 1e-3])
    own, found = (
        over(part, chart, p, rtol=1e-12, cosines=cosines) for chart in (part.chart, rings_of(part))
    )
    assert found.converged.all()
    assert np.all(np.abs(found.value - own.value) <= found.error + own.error)
    # A million, and no end, with that noise.
    assert found.evaluations.max() <= 20_000


@pytest.mark.parametrize("n", ["0", "0.01", "0.1"])
@pytest.mark.parametrize("axis", [None, "1,1,1", "-1,-1,.3", "-1,-1,-.3"])
def test_rings_that_close_near_the_zenith_are_seen(n: str, axis: str | None) -> None:
    """Lobes that do not fall to their edge, where it passes near the zenith."""
    spec = f"phong:n={n}" if axis is None else f"lafortune:lobes=(({axis},{n}))"
    model = next(parse(spec).models())
    (part,) = model.parts()
    p = part.packed(np.array([model.pack()], dtype=float))
    c = np.geomspace(1e-8, 0.1, 71)
    own = over(part, part.chart, p, 1e-13, cosines=c)
    for rtol in (1e-6, 1e-10, 1e-12):
        for limit in (1000, 1500, 2000, 3000, 4000, 10**6):
            found = over(part, rings_of(part), p, rtol, limit, c)
            assert np.all(np.abs(found.value - own.value) <= found.error + own.error)


def agree_anywhere(kind: type[Model], rng: np.random.Generator, count: int) -> int:
    """Compare both charts of models all over the ranges; return how many parts there were."""
    parts = 0
    for model in anywhere(kind, rng, count):
        # Where total reflection sets in no chart has ends.
        if not model.isotropic or model.parameters.get("ior", 1.0) < 1.0:
            continue
        for part in model.parts():
            try:
                rings = rings_of(part)
            except albedo.InputError:
                continue
            parts += 1
            p = part.packed(np.array([model.pack()], dtype=float))
            c = np.concatenate((rng.uniform(0.005, 1.0, 12), 10.0 ** rng.uniform(-9.0, 0.0, 12)))
            own, found = (over(part, x, p, 1e-8, cosines=c) for x in (part.chart, rings))
            off, bound = np.abs(found.value - own.value), found.error + own.error
            assert np.all(off <= bound), (model.spec, c[np.argmax(off / bound)])
    return parts


NAMES = sorted(albedo.models().keys() - {"granier_heidrich"})


@pytest.mark.filterwarnings("ignore::albedo.ConvergenceWarning")
@pytest.mark.parametrize("name", NAMES)
def test_rings_agree_all_over_the_ranges(name: str, rng: np.random.Generator) -> None:
    parts = agree_anywhere(albedo.models()[name], rng, 12)
    # What never has rings, or not among so few.
    assert parts or name in ("max_phong_anisotropic", "poulin_fournier", "stam_grating")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::albedo.ConvergenceWarning")
@pytest.mark.parametrize("name", NAMES)
def test_rings_agree_all_over_the_ranges_many_times(name: str, rng: np.random.Generator) -> None:
    agree_anywhere(albedo.models()[name], rng, 120)


@pytest.mark.parametrize("kind", ["slope", "mirror_hemisphere", "broad", "projected"])
@pytest.mark.parametrize("kinks", ["none", "max", "v_cavity"])
@pytest.mark.parametrize("width", [1e-3, 0.3, 1.0])
def test_rings_cover_the_hemisphere_once(kind: str, kinks: str, width: float) -> None:
    if kinks == "v_cavity" and kind != "slope":
        return
    n = COSINES.size

    def levels(c: np.ndarray) -> np.ndarray:
        return np.column_stack((0.5 * c, np.sqrt(c), np.where(c > 0.5, np.nan, 0.7)))

    waves = 0.3 * width
    for chart in (
        RingsChart(kind, kinks, waves=waves),
        RingsChart(kind, kinks, thin=True, levels=levels, waves=waves),
    ):
        found = integrate(
            *(chart, lambda row, wi, wo, h: np.ones(wo.shape[1:]), COSINES, np.zeros(n)),
            *(np.full((n, 2), width), True),
            rtol=1e-10,
            atol=0.0,
            limit=10**6,
        )
        assert np.all(np.abs(found.value - math.pi) <= found.error)
        assert found.converged.all()


def test_nodes_are_directions_and_their_sums() -> None:
    n = COSINES.size
    for kind, kinks in (
        *(("slope", "v_cavity"), ("mirror", "none"), ("broad", "max"), ("projected", "none")),
    ):
        chart = RingsChart(kind, kinks)
        phi = np.linspace(-2.0, 3.0, n)
        geometry, row, code, box = chart.panels(COSINES, phi, np.full((n, 2), 0.2), True)
        u = np.array([0.1, 0.6, 0.95])
        wi, wo, h, weight = chart.nodes(geometry[row], code, box, u, u)
        np.testing.assert_allclose(wi.T, spherical(COSINES, phi)[row], rtol=0, atol=2 * EPS)
        # A dozen roundings, and those of sines and cosines.
        np.testing.assert_allclose(np.sum(wo * wo, axis=0), 1.0, atol=20 * EPS)
        np.testing.assert_allclose(h - wo, np.broadcast_to(wi[:, :, None], h.shape), atol=4 * EPS)
        assert np.all(weight >= 0.0)
        # All nodes along u have one height.
        heights = wo[2].reshape(row.size, 3, 3)
        assert np.array_equal(heights[:, 0], heights[:, 1])


@pytest.mark.parametrize("axis", [(-1.0, 0.3), (1.0, 1.0), (1.0, -0.7), (-0.2, 1.0), (-1.0, 0.0)])
def test_half_spaces_of_axes_are_covered_once(axis: tuple[float, float]) -> None:
    """The projected area within 90 degrees of a and above the horizon is pi/2 (1 + a.z)."""
    n = COSINES.size
    chart = RingsChart("axis", decay="algebraic", axis=axis)
    found = integrate(
        *(chart, lambda row, wi, wo, h: np.ones(wo.shape[1:]), COSINES, np.zeros(n)),
        *(np.ones((n, 2)), True),
        rtol=1e-10,
        atol=1e-13,
        limit=10**6,
    )
    s = np.sqrt((1.0 - COSINES) * (1.0 + COSINES))
    length = np.hypot(axis[0] * s, axis[1] * COSINES)
    with np.errstate(invalid="ignore"):
        height = np.where(length > 0.0, axis[1] * COSINES / length, -1.0)
    assert np.all(np.abs(found.value - 0.5 * math.pi * (1.0 + height)) <= found.error + 20 * EPS)
    assert found.converged.all()


@pytest.mark.parametrize("axis", [(-1.0, 0.3), (1.0, 1.0), (1.0, -0.7)])
def test_nodes_about_an_axis_are_on_its_side(axis: tuple[float, float]) -> None:
    n = COSINES.size
    phi = np.linspace(-2.0, 3.0, n)
    chart = RingsChart("axis", decay="cosine_power", axis=axis)
    geometry, row, code, box = chart.panels(COSINES, phi, np.full((n, 2), 0.2), True)
    u = np.array([0.1, 0.6, 0.95])
    wi, wo, h, weight = chart.nodes(geometry[row], code, box, u, u)
    np.testing.assert_allclose(np.sum(wo * wo, axis=0), 1.0, atol=20 * EPS)
    np.testing.assert_allclose(h - wo, np.broadcast_to(wi[:, :, None], h.shape), atol=4 * EPS)
    assert np.all(weight >= 0.0)
    a = np.array([axis[0], axis[0], axis[1]])[:, None] * wi
    # A cosine of 20 roundings from 90 degrees is a matter of rounding.
    assert np.all(np.einsum("ik,ikj->kj", a, wo) >= -20 * EPS)


def test_the_height_of_the_light_is_an_end_of_panels() -> None:
    """A kink where n.v = n.l, as of max(n.l, n.v), costs nothing wherever the axis stands."""
    c = np.array([0.9, 0.5, 0.1])

    def larger(row: np.ndarray, wi: np.ndarray, wo: np.ndarray, h: np.ndarray) -> np.ndarray:
        return np.maximum(wo[2], c[row][:, None])

    for axis in ((-1.0, 0.3), (1.0, 0.8), (-1.0, -0.1)):
        chart = RingsChart("axis", decay="algebraic", axis=axis)
        found = integrate(
            *(chart, larger, c, np.zeros(3), np.ones((3, 2)), True),
            rtol=1e-11,
            atol=0.0,
            limit=10**4,
        )
        assert found.converged.all()


def test_levels_are_ends_of_panels() -> None:
    """A step in n.v costs nothing where its place is known."""
    c = np.array([0.9, 0.5, 0.1])

    def step(row: np.ndarray, wi: np.ndarray, wo: np.ndarray, h: np.ndarray) -> np.ndarray:
        return np.where(wo[2] > 0.3, 1.0, 0.25)

    found = integrate(
        *(RingsChart("broad", levels=lambda c: np.full((c.size, 1), 0.3)), step, c, np.zeros(3)),
        *(np.ones((3, 2)), True),
        rtol=1e-12,
        atol=0.0,
        limit=10**4,
    )
    assert np.all(np.abs(found.value - math.pi * (1.0 - 0.75 * 0.09)) <= found.error)
    assert found.converged.all()


@pytest.mark.parametrize("above", [1e-15, 3e-14, 1e-13, 3e-13])
@pytest.mark.parametrize("kind", ["broad", "mirror_hemisphere"])
def test_nothing_is_left_out_between_an_axis_and_a_level(kind: str, above: float) -> None:
    """Near the horizon a height just above that of the light may be far off in terms of it."""
    c = np.geomspace(1e-12, 1e-3, 10)
    chart = RingsChart(kind, levels=lambda c: np.sin(np.arcsin(c) + above)[:, None])
    found = integrate(
        *(chart, lambda row, wi, wo, h: 1.0 / h[2] ** 2, c, np.zeros(c.size)),
        *(np.ones((c.size, 2)), True),
        rtol=1e-11,
        atol=0.0,
        limit=10**5,
    )
    known = 2.0 * math.pi * (np.log1p(1.0 / c) - 1.0 / (1.0 + c))
    assert np.all(np.abs(found.value - known) <= found.error)
    assert found.converged.all()


def test_rings_are_for_isotropic_models() -> None:
    with pytest.raises(TypeError, match="isotropic"):
        RingsChart("slope").panels(COSINES, COSINES, np.ones((COSINES.size, 2)), False)
    upright = albedo.model("lafortune", lobes=((0.0, 0.0, 1.0, 20.0),))
    with pytest.raises(albedo.InputError, match="no chart of rings"):
        rings_of(upright.parts()[0])


def test_exponentials_of_many_are_those_of_one() -> None:
    """Taylor's series to 1e-17, and as many roundings as doublings of t: each an ulp of exp(t)."""
    for top in (1e-12, 0.25, 0.26, 4.0, 45.0):
        t = np.concatenate(([0.0, 1e-300], np.geomspace(1e-20, 1.0, 50) * top))
        found = np.empty(t.size)
        expm1_all(t, found)
        known = np.expm1(t)
        assert np.all(np.abs(found - known) <= (1.0 + top) * 2.0 * EPS * known)


@pytest.mark.parametrize("name", ["phong:n=1e6", "cook_torrance:m=0.1", "he_torrance"])
def test_elevations_of_many_are_those_of_one(name: str) -> None:
    """Both round the distance from the axis, as a share of it, and then the elevation."""
    (part,) = next(parse(name).models()).parts()
    n = COSINES.size
    widths = np.tile(part.widths, (n, 1))
    geometry, row, code, box = rings_of(part).panels(COSINES, np.zeros(n), widths, True)
    sides = set()
    for g, side, (first, last) in zip(geometry[row], code[:, 0], box[:, 4:], strict=True):
        sides.add(int(side))
        s = first + (last - first) * np.linspace(0.0, 1.0, 20)
        found = np.empty(s.size)
        elevations(g, side, s, found)
        known = np.array([elevation(g, side, x)[:2] for x in s.tolist()])
        distance = np.abs(known[:, 0] if side == 1 else known[:, 1])
        # As many doublings as s takes, each with a rounding or two of exp(s).
        off = (8.0 + 4.0 * s) * EPS * distance + EPS * np.abs(known[:, 0])
        assert np.all(np.abs(found - known[:, 0]) <= off)
    assert sides == {0, 1, 2}


WAVES = ["he_torrance", "he_torrance:sigma0=9e-3,tau=54", "stam_gaussian:sigma=0.067,t_x=63,t_y=63"]


def smooth_rings(spec: str) -> tuple[Part, RingsChart, np.ndarray]:
    """The part of a model that has whole rings, their chart, and its packed parameters."""
    model = next(parse(spec).models())
    part = model.parts()[0]
    assert isinstance(part.rings, RingsChart)
    return part, part.rings, part.packed(np.array([model.pack()], dtype=float))


@pytest.mark.parametrize("spec", WAVES)
def test_whole_rings_and_their_halves_have_one_integral(spec: str) -> None:
    """The midpoint rule with cosines, and Gauss's rule with Legendre's polynomials."""
    part, chart, p = smooth_rings(spec)
    n = COSINES.size
    widths = np.tile(part.widths, (n, 1))
    geometry, row, code, box = chart.panels(COSINES, np.zeros(n), widths, True)
    integrand = ModelIntegrand(part.fill, np.tile(p, (n, 1)), np.ones(n))
    whole = Cells.blank(row, code, box, np.tile((64, 32), (row.size, 1)))
    assert whole_rings(chart, box).all()
    evaluate(chart, integrand, geometry, whole)
    total = np.zeros(row.size)
    error = np.zeros(row.size)
    for k in range(4):
        quarter = box.copy()
        quarter[:, 0], quarter[:, 1] = 0.25 * k, 0.25 * (k + 1)
        assert not whole_rings(chart, quarter).any()
        cells = Cells.blank(row, code, quarter, np.tile((32, 32), (row.size, 1)))
        evaluate(chart, integrand, geometry, cells)
        total += cells.value
        error += cells.error[:, 0]
    # Both have the same heights: only the rules along u differ, and roundings of the sums.
    slack = 100 * EPS * whole.size
    assert np.all(np.abs(whole.value - total) <= whole.error[:, 0] + error + slack)
    bright = whole.value > 1e-6 * np.bincount(row, whole.value)[row]
    # Bounds that say little would agree with anything.
    assert np.median(whole.error[bright, 0] / whole.size[bright]) <= 1e-9


@pytest.mark.parametrize("spec", WAVES)
def test_calls_from_python_have_whole_rings_as_well(spec: str) -> None:
    """Functions that are not compiled go block by block, with the same rules."""
    part, chart, p = smooth_rings(spec)
    n = COSINES.size
    compiled = ModelIntegrand(part.fill, np.tile(p, (n, 1)), np.ones(n))
    widths = np.tile(part.widths, (n, 1))
    geometry, row, code, box = chart.panels(COSINES, np.zeros(n), widths, True)
    one, other = (Cells.blank(row, code, box, np.tile((40, 12), (row.size, 1))) for _ in range(2))
    halves = np.arange(row.size) % 3 == 0
    for cells in (one, other):
        # Both kinds of rules in one call.
        cells.box[halves, 1] = 0.5
        cells.order[halves, 0] = 12
    evaluate(chart, compiled, geometry, one)
    evaluate(chart, lambda *where: compiled(*where), geometry, other)
    # The same sums, which may be vectorised otherwise.
    close = 100 * EPS * one.size
    assert np.all(np.abs(one.value - other.value) <= close)
    assert np.all(np.abs(one.error - other.error) <= 1e3 * close[:, None] + 1e-9 * one.error)


@pytest.mark.parametrize(("times", "cut"), [(2.0, False), (8.0, True)])
def test_rings_that_want_more_nodes_than_there_are_rules_are_cut(times: float, cut: bool) -> None:
    """A lobe that is some times narrower than its chart was told."""
    part, chart, p = smooth_rings("he_torrance:sigma0=9e-3,tau=54,mirror=off")
    widths = np.full((1, 2), times * part.widths[0])
    wide = RingsChart("projected", waves=times * chart.waves, around="entire")
    c = np.array([0.5])
    integrand = ModelIntegrand(part.fill, p, np.ones(1))
    done = refine(
        *(wide, integrand, c, np.zeros(1), widths, True), rtol=1e-9, atol=0.0, limit=10**7
    )
    assert (~whole_rings(wide, done.cells.box)).any() == cut
    # Gauss's rules end at 32.
    assert (done.cells.order[:, 0].max() > 32) == (not cut)
    told = over(part, chart, p, cosines=c)
    value, error = done.cells.value.sum(), done.doubt[0] * done.cells.error.sum()
    assert told.converged.all()
    # Rounding is no part of the bounds of cells.
    assert abs(value - told.value[0]) <= error + told.error[0] + 100 * EPS * value


@pytest.mark.parametrize(
    ("factor", "around"),
    [
        ("fresnel=white", "entire"),
        ("fresnel=schlick,f0=0.1", "smooth"),
        ("fresnel=dielectric,ior=1.5", "smooth"),
        ("fresnel=gold", "smooth"),
        ("fresnel=conductor,ior=0.2,k=3", "smooth"),
        # Total reflection at u^2 = 1 - n^2, and where it is all but that.
        ("fresnel=dielectric,ior=0.5", "none"),
        ("fresnel=dielectric,ior=1.01", "none"),
        ("fresnel=conductor,ior=0.5,k=0.01", "none"),
        # A power of 1 - u that is not whole.
        ("fresnel=lazanyi,ior=1.5,k=3", "none"),
    ],
)
def test_rings_are_whole_where_the_fresnel_factor_is_smooth(factor: str, around: str) -> None:
    for name in ("he_torrance", "stam_gaussian"):
        _, chart, _ = smooth_rings(f"{name}:{factor}")
        assert chart.around == around
        own = over(*_own(f"{name}:{factor}"))
        found = over(*_own(f"{name}:{factor}", chart))
        assert np.all(np.abs(found.value - own.value) <= found.error + own.error)


def _own(spec: str, chart: RingsChart | None = None) -> tuple[Part, object, np.ndarray]:
    part, _, p = smooth_rings(spec)
    return part, chart or part.chart, p
