"""Coupling against closed forms, and the tables of what an albedo leaves of 1."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import albedo
from albedo.analysis import checks
from albedo.brdf import Model, Part, Real
from albedo.directions import spherical
from albedo.errors import InputError
from albedo.operators.heights import height_table
from albedo.operators.surface import surface_table
from albedo.quadrature import albedo_rows

COSINES = np.array([1.0, 0.9, 0.5, 0.2, 0.05, 1e-2, 1e-3, 1e-4, 1e-6, 0.0])
PHONG = albedo.model("phong", n=20)
GGX = albedo.model("cook_torrance", m=0.3, distribution="ggx", geometry="smith_correlated")
SHARP = [
    albedo.model("cook_torrance", m=m, distribution=kind, geometry="smith")
    for kind in ("ggx", "beckmann")
    for m in (1e-3, 1e-6)
]
SPECULARS = [
    PHONG,
    GGX,
    *SHARP,
    albedo.model("cook_torrance", m=0.1),
    albedo.model("ashikhmin_shirley", n=100, r_s=0.05),
    albedo.model("schlick", form="final", roughness=0.3, color=0.2),
    # Its albedo is 1 at one height between the normal and the horizon, within the bounds.
    albedo.model("lafortune_scaled", n=20, s=0.95),
]
speculars = pytest.mark.parametrize("specular", SPECULARS, ids=lambda m: m.spec[:60])


class Mirror(Model):
    """A smooth interface: R = f0 + (1 - f0)(1 - share mu)^5, all of it in the mirror direction."""

    name = "mirror"
    references = ("schlick1994",)
    f0 = Real(0.04, "reflectance", low=0.0, high=1.0)
    share = Real(1.0, "of the cosine", low=0.0, high=1.0)

    def pack(self) -> tuple[float, ...]:
        return ()

    def parts(self) -> tuple[Part, ...]:
        return ()

    def spikes(self, wi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        weight = self.f0 + (1.0 - self.f0) * (1.0 - self.share * wi[:, 2]) ** 5
        return (wi * np.array([-1.0, -1.0, 1.0]))[None], weight[None]


def pairs(rng: np.random.Generator, count: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """Directions from normal to grazing ones."""
    ends = []
    for _ in range(2):
        c = np.where(rng.random(count) < 0.5, rng.random(count), 10.0 ** -rng.uniform(0, 5, count))
        ends.append(spherical(c, rng.uniform(-3.0, 3.0, count)))
    return ends[0], ends[1]


def relative(model: Model, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    """Bound on the relative errors of the values of the diffuse part."""
    (part,) = (part for part in model.parts() if part.name.startswith("diffuse"))
    assert callable(part.doubt)
    return np.asarray(part.doubt(wi[:, 2]) + part.doubt(wo[:, 2]))


@pytest.mark.parametrize("r_d", [0.3, 1.0])
@pytest.mark.parametrize("f0", [0.0, 0.04, 0.9])
def test_over_schlicks_mirror(f0: float, r_d: float, rng: np.random.Generator) -> None:
    """f_d = 21 R_d (1 - F0)/(20 pi) (1 - (1 - n.l)^5)(1 - (1 - n.v)^5)."""
    model = albedo.couple(Mirror(f0=f0), r_d)
    wi, wo = pairs(rng)
    light, view = (-np.expm1(5.0 * np.log1p(-x[:, 2])) for x in (wi, wo))
    known = 21.0 * r_d * (1.0 - f0) / (20.0 * math.pi) * light * view
    off = np.abs(model.eval(wi, wo) / known - 1.0)
    assert np.all(off <= relative(model, wi, wo))
    # Above 1e-2 nothing is small: bounds are those of the table.
    high = np.minimum(wi[:, 2], wo[:, 2]) > 1e-2
    assert np.all(relative(model, wi, wo)[high] <= 1e-9)


@pytest.mark.parametrize("r_s", [0.0, 0.05, 0.5])
def test_ashikhmin_and_shirleys_own(r_s: float, rng: np.random.Generator) -> None:
    """AS eq. 5 is what eq. 12 makes of R = R_s + (1 - R_s)(1 - n.l/2)^5."""
    model = albedo.couple(Mirror(f0=r_s, share=0.5), 0.7)
    own = albedo.model("ashikhmin_shirley", r_s=r_s, r_d=0.7, specular="none")
    wi, wo = pairs(rng)
    off = np.abs(model.eval(wi, wo) / own.eval(wi, wo) - 1.0)
    assert np.all(off <= relative(model, wi, wo))


@pytest.mark.parametrize("rho", [0.0, 0.3, 0.999])
def test_over_lambert_is_lambert(rho: float, rng: np.random.Generator) -> None:
    base = albedo.model("lambert", rho=rho)
    wi, wo = pairs(rng)
    found = albedo.couple(base, 0.6).eval(wi, wo)
    # Of 1 - rho the errors of the table are a larger share.
    slack = 1e-11 / (1.0 - rho)
    np.testing.assert_allclose(found, (rho + 0.6 * (1.0 - rho)) / math.pi, rtol=slack)


@speculars
def test_what_is_left_is_reflected(specular: Model) -> None:
    """The albedo is R + R_d (1 - R), never above 1, at a cost that sharp lobes do not raise."""
    alone = albedo.directional_albedo(specular, COSINES)
    for r_d in (1.0, 0.4):
        found = albedo.directional_albedo(albedo.couple(specular, r_d), COSINES)
        known = alone.value + r_d * (1.0 - alone.value)
        assert found.converged.all()
        assert np.all(np.abs(found.value - known) <= found.error + alone.error)
        assert np.all(found.value <= 1.0 + found.error)
        # At most three dozen panels are looked at, and the few that matter computed twice.
        assert (
            found.parts[next(k for k in found.parts if "diffuse" in k)].evaluations.max() < 20_000
        )
    seen = albedo.directional_albedo(albedo.couple(specular, 0.4), COSINES[:-1], fixed="view")
    assert np.all(np.abs(seen.value - known[:-1]) <= seen.error + alone.error[:-1])
    assert np.all(seen.error <= 1e-6)


@speculars
@pytest.mark.parametrize("rtol", [1e-4, 1e-10])
def test_a_table_keeps_within_its_bound(
    specular: Model, rtol: float, rng: np.random.Generator
) -> None:
    table = height_table(specular, True, rtol)
    c = np.concatenate((rng.random(60), 10.0 ** -rng.uniform(0.0, 12.0, 60), COSINES[:-1]))
    zeros = np.zeros(c.size)
    # Not all can be had so well: their intervals are wider.
    found = albedo_rows([specular] * c.size, c, zeros, rtol=1e-11, atol=1e-290, complement=True)
    assert np.all(np.abs(table(c) - found.value) <= table.bound(c) + found.error)
    assert table.worst <= rtol
    average, error = table.average
    known = albedo.average_albedo(specular, rtol=1e-9)
    assert abs(1.0 - average - float(known.value)) <= error + float(known.error)


def test_what_a_sharp_lobe_loses_has_its_digits() -> None:
    """1 - R falls as the square of the width, and its bound with it."""
    for m in (1e-2, 1e-6):
        model = albedo.model("cook_torrance", m=m, distribution="ggx", geometry="smith_correlated")
        average, error = height_table(model, True, 1e-10).average
        assert 0.0 < average < 30.0 * m * m
        assert error <= 1e-9 * average
        assert height_table(model, True, 1e-10).relative(np.array([0.7]))[0] <= 1e-9


@pytest.mark.parametrize("specular", [PHONG, GGX, SHARP[0]], ids=lambda m: m.spec[:60])
def test_rough_tables_say_so(specular: Model, rng: np.random.Generator) -> None:
    """Tables of 1e-5 against such of 1e-11: values differ by no more than the rough one says."""
    rough, fine = (albedo.couple(specular, 1.0, rtol=rtol) for rtol in (1e-5, 1e-11))
    wi, wo = pairs(rng)
    diffuse = [
        model.eval(wi, wo) - specular.eval(wi, wo) if specular is not SHARP[0] else None
        for model in (rough, fine)
    ]
    if diffuse[0] is not None and diffuse[1] is not None:
        off = np.abs(diffuse[0] - diffuse[1])
        # What is subtracted rounds.
        slack = 1e-14 * specular.eval(wi, wo)
        assert np.all(off <= (relative(rough, wi, wo) + 1e-10) * diffuse[1] + slack)
    found = albedo.directional_albedo(rough, COSINES, rtol=1e-4)
    assert np.all(np.abs(found.value - 1.0) <= found.error)
    assert np.all(found.error <= 2e-4)


@speculars
def test_values_are_reciprocal(specular: Model) -> None:
    model = albedo.couple(specular, 0.5)
    assert model.reciprocal
    assert checks.reciprocity(model).passed


def test_over_a_model_that_is_not_reciprocal(rng: np.random.Generator) -> None:
    """R is that of the light, what is added is symmetric, and no energy is made."""

    def f(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        return np.broadcast_to(0.15 / math.pi * (1.0 + wi[..., 2]), wo.shape[:-1])

    base = albedo.model_from(f, lobe="diffuse", isotropic=True)
    model = albedo.couple(base, 1.0)
    assert not model.reciprocal
    found = albedo.directional_albedo(model, COSINES[:-1])
    assert np.all(np.abs(found.value - 1.0) <= found.error)
    wi, wo = pairs(rng)
    here, there = (model.eval(*ends) - base.eval(*ends) for ends in ((wi, wo), (wo, wi)))
    np.testing.assert_allclose(here, there, rtol=1e-12)


def test_draws_agree() -> None:
    model = albedo.couple(GGX, 0.5)
    cosines = np.array([0.9, 0.3, 0.05])
    exact = albedo.directional_albedo(model, cosines)
    drawn = albedo.monte_carlo_albedo(model, cosines, samples=2**16, sequence="sobol", seed=3)
    assert np.all(np.abs(drawn.value - exact.value) <= 5.0 * drawn.error + exact.error)
    mirror = albedo.couple(Mirror(), 0.5)
    drawn = albedo.monte_carlo_albedo(mirror, cosines, samples=2**14, seed=3)
    exact = albedo.directional_albedo(mirror, cosines)
    assert np.all(np.abs(drawn.value - exact.value) <= 5.0 * drawn.error + exact.error)


def test_operators_nest() -> None:
    cosines = COSINES[1:-1]
    once = albedo.directional_albedo(albedo.couple(PHONG, 0.5), cosines)
    # 1 - (1 - R)/2, and half of what that leaves.
    twice = albedo.directional_albedo(albedo.couple(albedo.couple(PHONG, 0.5), 0.5), cosines)
    known = 0.5 + 0.5 * once.value
    assert np.all(np.abs(twice.value - known) <= twice.error + 0.5 * once.error)
    brighter = albedo.pump(PHONG, 1, rtol=1e-10)
    inner = albedo.directional_albedo(brighter, cosines)
    over = albedo.directional_albedo(albedo.couple(brighter, 0.5), cosines, rtol=1e-7)
    assert np.all(np.abs(over.value - (0.5 + 0.5 * inner.value)) <= over.error + inner.error)
    assert over.converged.all()
    pumped = albedo.directional_albedo(albedo.pump(albedo.couple(PHONG, 0.5), 1), cosines)
    assert np.all(pumped.value >= once.value - once.error - pumped.error)
    assert np.all(pumped.value <= 1.0 + pumped.error)
    both = albedo.directional_albedo(0.5 * albedo.couple(PHONG, 0.5) + PHONG * 0.5, cosines)
    alone = albedo.directional_albedo(PHONG, cosines)
    known = 0.5 * (once.value + alone.value)
    assert np.all(np.abs(both.value - known) <= both.error + once.error + alone.error)


def test_over_an_anisotropic_model(rng: np.random.Generator) -> None:
    specular = albedo.model("ashikhmin_shirley", n_u=10, n_v=100, r_s=0.5)
    model = albedo.couple(specular, 1.0, rtol=1e-3)
    table = surface_table(specular, True, 1e-3)
    c, phi = np.concatenate((rng.random(30), 10.0 ** -rng.uniform(0, 8, 20))), rng.uniform(0, 7, 50)
    alone = albedo.directional_albedo(specular, c, phi, rtol=1e-9, complement=True)
    values = table.of(spherical(c, phi))
    assert np.all(np.abs(values - alone.value) <= table.relative(c) * values + alone.error)
    assert table.quarter
    found = albedo.directional_albedo(model, c, phi, rtol=1e-2)
    assert np.all(np.abs(found.value - 1.0) <= found.error)
    assert found.converged.all()
    assert checks.reciprocity(model).passed
    average, error = table.average
    known = albedo.average_albedo(specular, rtol=1e-4)
    assert abs(1.0 - average - float(known.value)) <= error + float(known.error)
    assert error <= 1e-3


def test_a_coupled_model_is_a_model_like_any_other() -> None:
    model = albedo.couple(PHONG, 0.5)
    assert model == albedo.couple(albedo.model("phong", n=20), 0.5)
    assert model != albedo.couple(PHONG, 0.4)
    assert hash(model) == hash(albedo.couple(PHONG, 0.5))
    assert model.spec == f"couple({PHONG.spec}, diffuse_albedo=0.5)"
    assert model.isotropic
    assert model.conserves_energy
    assert model.references[:2] == ("ashikhmin2000", "shirley1997")
    table = albedo.table(model, [0.9, 0.3], sweep={"n": [10.0, 20.0], "diffuse_albedo": [0.1, 0.5]})
    exact = albedo.directional_albedo(model, [0.9, 0.3])
    off = np.abs(table["value"].values[1, 1, 0] - exact.value)
    assert np.all(off <= 2.0 * exact.error)


def test_colours_have_channels() -> None:
    model = albedo.couple(PHONG, (0.1, 0.5, 0.9))
    assert model.channels == 3
    found = albedo.directional_albedo(model, [0.9, 0.3])
    for k, r_d in enumerate((0.1, 0.5, 0.9)):
        one = albedo.directional_albedo(albedo.couple(PHONG, r_d), [0.9, 0.3])
        np.testing.assert_array_equal(found.value[k], one.value)
    metal = albedo.model("schlick", form="shadowed", roughness=0.5, color=(0.2, 0.5, 0.7))
    alone = albedo.directional_albedo(metal, 0.3)
    found = albedo.directional_albedo(albedo.couple(metal, 0.5), 0.3)
    known = 0.5 + 0.5 * alone.value
    assert np.all(np.abs(found.value - known) <= found.error + alone.error)
    with pytest.raises(InputError, match="has no channel 3"):
        model.channel(3)


@pytest.mark.parametrize(
    ("base", "values", "message"),
    [
        ("phong", {}, "needs a model, not str"),
        (PHONG, {"diffuse_albedo": 1.5}, "out of range"),
        (PHONG, {"diffuse_albedo": -0.1}, "out of range"),
        (PHONG, {"diffuse_albedo": "red"}, "not a number"),
        (PHONG, {"rtol": 0.0}, "rtol = 0.0"),
        (albedo.model("ward", m=0.3), {}, "without limit"),
        (albedo.model("oren_nayar", sigma=0.2), {}, "nothing is lost there"),
        (albedo.model("lambert"), {}, "reflects all light"),
        (albedo.model("schlick", color=(0.2, 0.5)), {"diffuse_albedo": (0.1, 0.2, 0.3)}, "equally"),
    ],
)
def test_bad_input(base: Any, values: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        albedo.couple(base, **values)
