"""Compensation for multiple scattering: what each method promises, and keeps."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from test_couple import COSINES, GGX, PHONG, Mirror, pairs

import albedo
from albedo.analysis import checks
from albedo.brdf import Model
from albedo.errors import InputError
from albedo.fresnel import average
from albedo.operators.compensate import METHODS, multiple, white


def lobe(m: float, kind: str = "ggx", **values: Any) -> Model:
    return albedo.model("cook_torrance", m=m, distribution=kind, geometry="smith", **values)


@pytest.mark.parametrize("kind", ["ggx", "beckmann"])
@pytest.mark.parametrize("m", [1.0, 0.1, 1e-3])
def test_nothing_is_lost(kind: str, m: float) -> None:
    """Kulla and Conty's albedo is 1 for every light, Turquin's for every view."""
    cosines = COSINES[:-1]
    for method, fixed in (("kulla_conty", "light"), ("kulla_conty", "view"), ("turquin", "view")):
        model = albedo.compensate(lobe(m, kind), method)
        found = albedo.directional_albedo(model, cosines, fixed=fixed)
        assert np.all(np.abs(found.value - 1.0) <= found.error), method
        assert found.converged.all(), method


@pytest.mark.parametrize("method", METHODS)
def test_over_lambert_is_white(method: str, rng: np.random.Generator) -> None:
    wi, wo = pairs(rng)
    model = albedo.compensate(albedo.model("lambert", rho=0.3), method)
    np.testing.assert_allclose(model.eval(wi, wo), 1.0 / math.pi, rtol=1e-9)


def test_which_methods_are_reciprocal() -> None:
    base = lobe(0.5)
    for method in ("kulla_conty", "pump"):
        model = albedo.compensate(base, method)
        assert model.reciprocal
        assert checks.reciprocity(model).passed
    turquin = albedo.compensate(base, "turquin")
    assert not turquin.reciprocal
    # From the normal E falls by a fifth towards grazing incidence.
    wi, wo = pairs(np.random.default_rng(1))
    there, back = turquin.eval(wi, wo), turquin.eval(wo, wi)
    assert np.max(np.abs(there - back) / np.maximum(there, back)) > 0.1
    assert checks.reciprocity(turquin).passed is None
    # For one light it may reflect more than there is.
    assert not turquin.conserves_energy
    found = albedo.directional_albedo(turquin, 1e-3)
    assert float(found.value - found.error) > 1.1


@pytest.mark.parametrize(
    "fresnel",
    [
        {"fresnel": "schlick", "f0": 0.3},
        {"fresnel": "dielectric", "ior": 1.5},
        {"fresnel": "conductor", "ior": 0.2, "k": 3.0},
        {"fresnel": "lazanyi", "ior": 0.35, "k": 2.7},
        {"fresnel": "gold"},
    ],
    ids=lambda x: "-".join(map(str, x.values())),
)
def test_what_further_bounces_bring(fresnel: dict[str, Any]) -> None:
    """The albedo is that of f, and F_ms (1 - E) more: all of it computed in another way."""
    base, alone = lobe(0.6, **fresnel), lobe(0.6)
    known = albedo.directional_albedo(base, COSINES)
    lost = albedo.directional_albedo(alone, COSINES, complement=True)
    e_avg = albedo.average_albedo(alone, rtol=1e-10)
    code = base.pack_fresnel()  # type: ignore[attr-defined]
    kind = ("white", "schlick", "dielectric", "conductor", "lazanyi")[code[0]]
    index = {"schlick": {"f0": 0.3}, "dielectric": {"n": code[1]}}.get(kind)
    f = average(kind, **(index or {"n": 0.35, "k": 2.7}))
    if kind == "conductor":
        f = average(kind, n=code[1], k=code[2])
    found = white(base)
    assert abs(found.average - f) <= found.error + 1e-14
    assert found.error <= 1e-12
    # Of the light that F sends on k times: sum over k of F^(k + 1) E (1 - E)^(k - 1).
    e = float(e_avg.value)
    bounces = sum(f ** (k + 1) * e * (1.0 - e) ** (k - 1) for k in range(1, 60))
    for slides in (False, True):
        share = bounces / f if slides else bounces
        model = albedo.compensate(base, slides=slides)
        whole = albedo.directional_albedo(model, COSINES)
        expected = known.value + share * lost.value
        # Two relative errors of averages, 1e-10, are in the share.
        slack = whole.error + known.error + lost.error + 1e-9 * lost.value
        assert np.all(np.abs(whole.value - expected) <= slack)
        assert np.all(whole.value <= 1.0)


def test_the_error_of_averages_is_passed_on() -> None:
    """F_ms at the ends of two intervals lies within its bound."""
    for f, q in ((0.9, 0.3), (0.1, 0.8), (0.999, 0.999), (1.0, 1e-9)):
        for slides in (False, True):
            df, dq = 1e-4 * min(f, 1.0 - f), 1e-4 * min(q, 1.0 - q)
            value, error = multiple((f, df), (q, dq), slides)
            for a in (-1.0, 1.0):
                for b in (-1.0, 1.0):
                    end, _ = multiple((f + a * df, 0.0), (q + b * dq, 0.0), slides)
                    assert abs(end - value) <= error * value
    assert multiple((1.0, 0.0), (0.4, 0.0)) == pytest.approx((1.0, 0.0), abs=1e-14)
    assert multiple((0.0, 0.0), (0.4, 0.0)) == (0.0, 0.0)


def test_turquins_factor(rng: np.random.Generator) -> None:
    """f (1 + F0 (1 - E(n.v))/E(n.v)), for F0 at normal incidence."""
    base = lobe(0.7, fresnel="schlick", f0=0.4)
    model = albedo.compensate(base, "turquin")
    wi, wo = pairs(rng, 60)
    e = albedo.directional_albedo(lobe(0.7), wo[:, 2], rtol=1e-11).value
    known = base.eval(wi, wo) * (1.0 + 0.4 * (1.0 - e) / e)
    np.testing.assert_allclose(model.eval(wi, wo), known, rtol=1e-9)


def test_dirac_parts_are_compensated() -> None:
    base = albedo.model("schlick", form="final", roughness=0.1)
    model = albedo.compensate(base, "turquin")
    # What is known of E at all heights counts: grazing ones are known to 1e-9.
    found = albedo.directional_albedo(model, COSINES[:-1], rtol=1e-7, fixed="view")
    assert np.all(np.abs(found.value - 1.0) <= found.error)
    assert found.converged.all()
    # It makes light at grazing incidence: Turquin's factor takes it back, a second lobe cannot.
    with pytest.raises(InputError, match="nothing is lost there"):
        albedo.compensate(base)
    whole = albedo.directional_albedo(albedo.compensate(Mirror(f0=0.3)), COSINES)
    assert np.all(np.abs(whole.value - 1.0) <= whole.error)


@pytest.mark.parametrize("method", ["kulla_conty", "turquin"])
def test_rough_tables_say_so(method: str) -> None:
    base = albedo.model("cook_torrance", m=0.4, geometry="smith", fresnel="schlick", f0=0.5)
    rough, fine = (albedo.compensate(base, method, rtol=rtol) for rtol in (1e-5, 1e-11))
    found = albedo.directional_albedo(rough, COSINES, rtol=1e-4)
    known = albedo.directional_albedo(fine, COSINES, rtol=1e-10)
    assert np.all(np.abs(found.value - known.value) <= found.error + known.error)
    assert np.all(found.error <= 1e-3)
    wi, wo = pairs(np.random.default_rng(2))
    # The tables of the rough one err; three of their bounds are in a value.
    there, known_there = rough.eval(wi, wo), fine.eval(wi, wo)
    assert np.all(np.abs(there - known_there) <= 4e-5 * known_there)


@pytest.mark.parametrize("method", ["kulla_conty", "turquin"])
def test_draws_agree(method: str) -> None:
    model = albedo.compensate(GGX, method)
    cosines = np.array([0.9, 0.3, 0.05])
    exact = albedo.directional_albedo(model, cosines)
    drawn = albedo.monte_carlo_albedo(model, cosines, samples=2**16, sequence="sobol", seed=3)
    assert np.all(np.abs(drawn.value - exact.value) <= 5.0 * drawn.error + exact.error)


def test_pump_is_pump() -> None:
    assert albedo.compensate(PHONG, "pump") == albedo.pump(PHONG, 1)


def test_models_without_their_fresnel_factor() -> None:
    metal = white(albedo.model("cook_torrance", m=0.2, fresnel="copper"))
    assert metal.model == albedo.model("cook_torrance", m=0.2)
    shiny = white(albedo.model("ashikhmin_shirley", n=50, r_s=0.2))
    assert shiny.model.r_s == 1.0  # type: ignore[attr-defined]
    assert (shiny.f0, shiny.average) == pytest.approx((0.2, 0.2 + 0.8 / 21.0))
    waves = white(albedo.model("he_torrance", fresnel="dielectric", wavelength=0.6))
    assert waves.model == albedo.model("he_torrance", wavelength=0.6)
    glass = white(albedo.model("cook_torrance", m=0.2, fresnel="dielectric", ior=0.7))
    assert abs(glass.average - average("dielectric", n=0.7)) <= glass.error + 1e-14
    assert glass.error <= 1e-12
    assert white(PHONG).model is PHONG
    assert white(albedo.pump(PHONG, 1)).f0 == 1.0


def test_an_anisotropic_lobe() -> None:
    base = albedo.model(
        "cook_torrance", alpha_x=0.5, alpha_y=0.3, distribution="ggx", geometry="smith"
    )
    phi = np.array([[0.0], [0.4], [2.0]])
    model = albedo.compensate(base, rtol=1e-3)
    found = albedo.directional_albedo(model, [1.0, 0.4, 0.05], phi, rtol=1e-2)
    assert np.all(np.abs(found.value - 1.0) <= found.error)
    assert np.all(found.error <= 1e-2)


def test_a_compensated_model_is_a_model_like_any_other() -> None:
    model = albedo.compensate(GGX)
    assert model == albedo.compensate(GGX, "kulla_conty")
    assert model != albedo.compensate(GGX, "turquin")
    assert model != albedo.compensate(GGX, slides=True)
    assert hash(model) == hash(albedo.compensate(GGX))
    assert model.spec.startswith("compensate(cook_torrance:alpha_x=0.3")
    table = albedo.table(model, [0.9, 0.3], sweep={"m": [0.2, 0.3]})
    assert np.all(np.abs(table["value"].values - 1.0) <= table["error"].values)
    over = albedo.compensate(albedo.couple(PHONG, 0.5))
    found = albedo.directional_albedo(over, COSINES)
    assert np.all(np.abs(found.value - 1.0) <= found.error)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: albedo.compensate("phong"), "needs a model, not str"),
        (lambda: albedo.compensate(GGX, "heitz"), "method = 'heitz'"),
        (lambda: albedo.compensate(GGX, slides=1), "slides = 1"),
        (lambda: albedo.compensate(GGX, rtol=1.0), "rtol = 1.0"),
        (lambda: albedo.compensate(albedo.model("ward", m=0.3)), "without limit"),
        (lambda: albedo.compensate(albedo.model("oren_nayar", sigma=0.2)), "nothing is lost"),
        (lambda: albedo.compensate(albedo.model("schwenk")), "does not multiply"),
        (lambda: albedo.compensate(albedo.model("ashikhmin_shirley", r_s=0.1, r_d=0.5)), "terms"),
        (lambda: albedo.compensate(lobe(0.2, fresnel="schlick", f0=0.1), "pump"), "F = 1"),
        (lambda: albedo.compensate(albedo.model("phong_original"), "pump"), "not symmetric"),
        (lambda: albedo.compensate(albedo.model("lambert", rho=0.0), "turquin"), "not above 0"),
        (lambda: albedo.compensate(lobe(0.2, fresnel="schlick", f0=0.1) * 0.5), "inside"),
    ],
)
def test_bad_input(make: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make()
