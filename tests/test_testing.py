"""The kit for other projects: what is right passes, and what is wrong on purpose is caught by name.

The BRDFs and routines below are plain numpy, as other projects write them. Seeds are fixed.
"""

from __future__ import annotations

import doctest
import importlib
import re
import subprocess
import sys
import unittest
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

import albedo
from albedo.brdf import Model
from albedo.errors import InputError
from albedo.grammar import parse
from albedo.testing import (
    assert_energy_conserving,
    assert_reciprocal,
    assert_sampler_matches_pdf,
    assert_white_furnace,
)
from albedo.testing.sampling import _FEWEST, _TAIL

Array = np.ndarray
PI = np.pi

# Few incidences where the fault is everywhere, so that all tests take seconds.
FEW: dict[str, Any] = {"cos_theta": [1.0, 0.6, 0.1], "isotropic": True}
ONCE: dict[str, Any] = {"cos_theta": 0.6, "phi": 0.4, "samples": 20_000}


def dot(a: Array, b: Array) -> Array:
    return np.sum(a * b, axis=-1)


def unit(w: Array) -> Array:
    return w / np.linalg.norm(w, axis=-1, keepdims=True)


def half(wi: Array, wo: Array) -> Array:
    return unit(wi + wo)


def mirror(w: Array) -> Array:
    return w * (-1.0, -1.0, 1.0)


def lambert(wi: Array, wo: Array, rho: float = 1.0) -> Array:
    return np.full(len(wo), rho / PI)


# GGX after Walter et al. 2007, with two roughnesses.


def ggx(h: Array, ax: float, ay: float) -> Array:
    return 1.0 / (PI * ax * ay * ((h[:, 0] / ax) ** 2 + (h[:, 1] / ay) ** 2 + h[:, 2] ** 2) ** 2)


def smith_lambda(w: Array, ax: float, ay: float) -> Array:
    slope = ((ax * w[:, 0]) ** 2 + (ay * w[:, 1]) ** 2) / w[:, 2] ** 2
    return 0.5 * (np.sqrt(1.0 + slope) - 1.0)


def masking(wi: Array, wo: Array, ax: float, ay: float) -> Array:
    return 1.0 / (1.0 + smith_lambda(wi, ax, ay) + smith_lambda(wo, ax, ay))


def schlick(f0: float, c: Array) -> Array:
    return f0 + (1.0 - f0) * (1.0 - c) ** 5


def cook_torrance(wi: Array, wo: Array, ax: float = 0.3, ay: float = 0.3, f0: float = 1.0) -> Array:
    h = half(wi, wo)
    top = ggx(h, ax, ay) * masking(wi, wo, ax, ay) * schlick(f0, dot(wo, h))
    return top / (4.0 * wi[:, 2] * wo[:, 2])


def ggx_normals(u: Array, ax: float, ay: float) -> Array:
    """Half vectors with the density D n.h."""
    x, y = ax * np.cos(2.0 * PI * u[:, 0]), ay * np.sin(2.0 * PI * u[:, 0])
    r = np.sqrt(u[:, 1] / (1.0 - u[:, 1]))
    return unit(np.stack((r * x, r * y, np.ones(len(u))), axis=1))


def ggx_sample(wi: Array, u: Array, ax: float = 0.3, ay: float = 0.3) -> Array:
    h = ggx_normals(u, ax, ay)
    return 2.0 * dot(wi, h)[:, None] * h - wi


def ggx_pdf(wi: Array, wo: Array, ax: float = 0.3, ay: float = 0.3) -> Array:
    h = half(wi, wo)
    return ggx(h, ax, ay) * h[:, 2] / (4.0 * dot(wo, h))


def cosine_sample(wi: Array, u: Array) -> Array:
    r, phi = np.sqrt(u[:, 0]), 2.0 * PI * u[:, 1]
    return np.stack((r * np.cos(phi), r * np.sin(phi), np.sqrt(1.0 - u[:, 0])), axis=1)


def cosine_pdf(wi: Array, wo: Array) -> Array:
    return wo[:, 2] / PI


def blinn(
    wi: Array, wo: Array, n: float = 30.0, scale: Callable[[float], float] | None = None
) -> Array:
    norm = (n + 8.0) / (8.0 * PI) if scale is None else scale(n)
    return norm * half(wi, wo)[:, 2] ** n


def phong(wi: Array, wo: Array, n: float = 20.0) -> Array:
    return (n + 2.0) / (2.0 * PI) * np.maximum(dot(mirror(wi), wo), 0.0) ** n


def message(assertion: Callable[..., None], *arguments: Any, **options: Any) -> str:
    """What the failure says."""
    with pytest.raises(AssertionError) as caught:
        assertion(*arguments, **options)
    return str(caught.value)


# What is right passes.

MODELS = (
    "lambert",
    "phong:n=20",
    "cook_torrance:m=0.3,distribution=ggx,geometry=smith_correlated",
    "cook_torrance:alpha_x=0.1,alpha_y=0.4,distribution=ggx,geometry=smith",
    "ward_bounded:m=0.2",
    "eon:r=0.6",
)


@pytest.mark.parametrize("spec", MODELS)
def test_models_of_the_catalogue_pass(spec: str) -> None:
    model = parse(spec).model()
    assert_energy_conserving(model)
    assert_reciprocal(model)
    assert_sampler_matches_pdf(model, cos_theta=[1.0, 0.3], samples=20_000)


def test_each_channel_of_a_model_is_tested() -> None:
    gold = albedo.model("schlick", color=(0.9, 0.5, 0.25), roughness=0.8)
    assert_energy_conserving(gold)
    assert_reciprocal(gold)
    assert_sampler_matches_pdf(gold, cos_theta=0.5, samples=5000)
    first = albedo.directional_albedo(gold.channel(0), 0.5).value
    said = message(assert_white_furnace, gold, expected=first, cos_theta=0.5)
    assert "channel 1: f is not what is expected" in said


def test_dirac_parts_count_for_the_albedo_and_are_no_draws() -> None:
    mirrored = albedo.model("he_torrance", sigma0=0.1, tau=1.7)
    said = message(assert_energy_conserving, mirrored, cos_theta=[0.9, np.cos(np.radians(79.6))])
    assert "albedo 1.04" in said
    assert_sampler_matches_pdf(mirrored, cos_theta=0.4, samples=20_000)


@pytest.mark.parametrize(
    ("f", "isotropic"),
    [
        (lambert, True),
        (cook_torrance, True),
        (partial(cook_torrance, ax=0.1, ay=0.5), False),
        (partial(cook_torrance, f0=0.04), True),
        (lambda wi, wo: 0.5 * blinn(wi, wo), True),
        (phong, True),
    ],
    ids=["lambert", "ggx", "anisotropic", "fresnel", "blinn", "phong"],
)
def test_functions_that_are_right_pass(f: Any, isotropic: bool) -> None:
    assert_energy_conserving(f, isotropic=isotropic)
    assert_reciprocal(f)


def test_values_times_the_cosine_are_what_renderers_return() -> None:
    def shaded(wi: Array, wo: Array) -> Array:
        return cook_torrance(wi, wo) * wo[:, 2]

    assert_reciprocal(shaded, with_cosine=True)
    assert_energy_conserving(shaded, with_cosine=True, **FEW)
    assert "not reciprocal" in message(assert_reciprocal, shaded)


@pytest.mark.parametrize(("ax", "ay"), [(0.3, 0.3), (0.1, 0.6)])
def test_routines_that_are_right_pass(ax: float, ay: float) -> None:
    pdf, f = partial(ggx_pdf, ax=ax, ay=ay), partial(cook_torrance, ax=ax, ay=ay)

    def sample(wi: Array, u: Array) -> tuple[Array, Array, Array]:
        wo = ggx_sample(wi, u, ax, ay)
        above = wo[:, 2] > 0.0
        safe = np.where(above[:, None], wo, wi)
        density = np.where(above, pdf(wi, safe), 0.0)
        weight = f(wi, safe) * safe[:, 2] / pdf(wi, safe)
        return wo, density, np.where(above, weight, 0.0)

    assert_sampler_matches_pdf(sample, pdf, f=f)
    assert_sampler_matches_pdf(
        sample, pdf, f=lambda wi, wo: f(wi, wo) * wo[:, 2], with_cosine=True, **ONCE
    )
    assert_sampler_matches_pdf(lambda wi, u: ggx_sample(wi, u, ax, ay), pdf, **ONCE)


def test_a_third_random_number_chooses_the_lobe() -> None:
    def sample(wi: Array, u: Array) -> Array:
        assert u.shape == (len(wi), 3)
        return np.where(u[:, 2:] < 0.3, cosine_sample(wi, u), ggx_sample(wi, u))

    def pdf(wi: Array, wo: Array) -> Array:
        return 0.3 * cosine_pdf(wi, wo) + 0.7 * ggx_pdf(wi, wo)

    assert_sampler_matches_pdf(sample, pdf, dimensions=3, **ONCE)
    assert "do not follow" in message(
        assert_sampler_matches_pdf, sample, ggx_pdf, dimensions=3, **ONCE
    )


# What is wrong on purpose: too much energy.


def no_quarter(wi: Array, wo: Array) -> Array:
    return 4.0 * cook_torrance(wi, wo)


def over_pi(wi: Array, wo: Array) -> Array:
    """1/pi in place of 1/4."""
    return 4.0 / PI * cook_torrance(wi, wo, 0.1, 0.1)


def pi_for_the_cosines(wi: Array, wo: Array) -> Array:
    """D G/pi in place of D G/(4 n.l n.v)."""
    return 4.0 / PI * wi[:, 2] * wo[:, 2] * cook_torrance(wi, wo, 0.1, 0.1)


def masking_inverted(wi: Array, wo: Array) -> Array:
    return cook_torrance(wi, wo) / masking(wi, wo, 0.3, 0.3) ** 2


def no_masking(wi: Array, wo: Array) -> Array:
    return cook_torrance(wi, wo) / masking(wi, wo, 0.3, 0.3)


def phong_of_blinn(wi: Array, wo: Array) -> Array:
    """Phong's (n + 2)/(2 pi) on a lobe about the half vector."""
    return blinn(wi, wo, scale=lambda n: (n + 2.0) / (2.0 * PI))


def lobe_and_diffuse(wi: Array, wo: Array) -> Array:
    """A diffuse part that takes nothing from the lobe's light."""
    return cook_torrance(wi, wo, f0=0.04) + lambert(wi, wo)


def phong_over_cosine(wi: Array, wo: Array) -> Array:
    return phong(wi, wo) / wo[:, 2]


@pytest.mark.parametrize(
    ("f", "cos_theta"),
    [
        (no_quarter, "0.1"),
        (over_pi, "1"),
        (pi_for_the_cosines, "1"),
        (masking_inverted, "0.1"),
        (no_masking, "0.1"),
        (phong_of_blinn, "1"),
        (lobe_and_diffuse, "0.1"),
        (phong_over_cosine, "1"),
    ],
)
def test_too_much_energy_is_caught(f: Any, cos_theta: str) -> None:
    said = message(assert_energy_conserving, f, **FEW)
    assert said.startswith("f reflects more than it receives: ")
    # The worst incidence comes first.
    worst = re.findall(r"cos_theta = (\S+)", said)[0]
    assert worst == cos_theta
    assert "features of 0.03 rad" in said
    assert "at most 1.000001 is allowed" in said
    (value,) = re.findall(r"albedo (\d+\.\d+)", said)[:1]
    assert float(value) > 1.0


def test_blinns_usual_norm_is_a_little_too_large() -> None:
    """(n + 8)/(8 pi) is the norm of the lobe without the cosine next to it, at normal incidence.

    The integral at normal incidence is 8 pi (2^(-n/2) + n)/((n + 2)(n + 4)), Giesen 2009.
    """
    n = 30.0
    exact = (n + 8.0) / (8.0 * PI) * 8.0 * PI * (2.0 ** (-n / 2.0) + n) / ((n + 2.0) * (n + 4.0))
    assert exact > 1.0
    assert_white_furnace(blinn, expected=exact, cos_theta=1.0, rtol=1e-6, isotropic=True)
    assert "albedo 1.04" in message(assert_energy_conserving, blinn, **FEW)


# Too little, or another albedo than that of the model that is meant.


@pytest.mark.parametrize(
    "wrong_half",
    [lambda wi, wo: unit(wi - wo + 1e-12), lambda wi, wo: wi + wo],
    ids=["difference", "not normalised"],
)
def test_a_wrong_half_vector_is_caught_by_the_albedo_that_is_meant(wrong_half: Any) -> None:
    """Neither breaks reciprocity, and both lose energy."""
    cosines = [1.0, 0.6, 0.3]
    meant = albedo.model("cook_torrance", m=0.3, distribution="ggx", geometry="smith_correlated")
    expected = albedo.directional_albedo(meant, cosines).value

    def wrong(wi: Array, wo: Array) -> Array:
        top = ggx(wrong_half(wi, wo), 0.3, 0.3) * masking(wi, wo, 0.3, 0.3)
        return top / (4.0 * wi[:, 2] * wo[:, 2])

    options: dict[str, Any] = {"expected": expected, "cos_theta": cosines, "isotropic": True}
    assert_white_furnace(cook_torrance, **options)
    said = message(assert_white_furnace, wrong, **options)
    assert said.startswith("the albedo of f is not what is expected")
    assert "3 of 3 incidences fail" in said
    assert f"{expected[0] * 0.999:.6g}"[:6] in said


def test_exchanged_directions_in_a_model_that_is_not_reciprocal_are_caught() -> None:
    lewis = albedo.model("lewis", n=20.0, reading="per_incidence")
    assert_white_furnace(lewis, rtol=1e-6)
    exchanged = message(assert_white_furnace, lambda wi, wo: lewis.eval(wo, wi), isotropic=True)
    # What is held to 1 with the light fixed is not with the view.
    assert "10 of 10 incidences fail" in exchanged
    assert "albedo 1.38" in message(
        assert_energy_conserving, lambda wi, wo: lewis.eval(wo, wi), **FEW
    )


# Light and view are not exchangeable.


def one_masking(wi: Array, wo: Array) -> Array:
    both = masking(wi, wo, 0.3, 0.3)
    return cook_torrance(wi, wo) / both / (1.0 + smith_lambda(wi, 0.3, 0.3))


def fresnel_of_the_light(wi: Array, wo: Array) -> Array:
    return cook_torrance(wi, wo) * schlick(0.04, wi[:, 2])


def phong_over_light(wi: Array, wo: Array) -> Array:
    return phong(wi, wo) / wi[:, 2]


def lobe_in_half_space(wi: Array, wo: Array) -> Array:
    """Diffuse light that Fresnel's factor of the light alone lets in."""
    return (1.0 - schlick(0.04, wi[:, 2])) * lambert(wi, wo)


def only_at_grazing(wi: Array, wo: Array) -> Array:
    """A cosine clamped from below, of one direction only."""
    return cook_torrance(wi, wo) * wi[:, 2] / np.maximum(wi[:, 2], 1e-3)


def only_near_the_mirror(wi: Array, wo: Array) -> Array:
    close = dot(mirror(wi), wo) > np.cos(0.01)
    return lambert(wi, wo) * np.where(close, 1.0 + 0.1 * wi[:, 2], 1.0)


def skewed_azimuth(wi: Array, wo: Array) -> Array:
    phi = np.arctan2(wi[:, 1], wi[:, 0]) - np.arctan2(wo[:, 1], wo[:, 0])
    return lambert(wi, wo) * (1.0 + 0.5 * np.sin(phi))


@pytest.mark.parametrize(
    "f",
    [
        one_masking,
        fresnel_of_the_light,
        phong_over_light,
        lobe_in_half_space,
        only_at_grazing,
        only_near_the_mirror,
        skewed_azimuth,
    ],
)
def test_what_is_not_reciprocal_is_caught(f: Any) -> None:
    said = message(assert_reciprocal, f)
    assert said.startswith("f is not reciprocal: ")
    there, back = re.findall(r"f\(w[io], w[io]\) = ([\d.e+-]+)", said)[:2]
    wi, wo = (
        np.array([float(x) for x in re.findall(rf"{name} = \((.*?)\)", said)[0].split(", ")])
        for name in ("wi", "wo")
    )
    # The message is enough to see it again.
    np.testing.assert_allclose(f(wi[None], wo[None]), float(there), rtol=1e-4)
    np.testing.assert_allclose(f(wo[None], wi[None]), float(back), rtol=1e-4)
    assert float(there) != float(back)


def test_a_difference_within_the_tolerance_passes() -> None:
    def slightly(wi: Array, wo: Array) -> Array:
        return lambert(wi, wo) * (1.0 + 1e-4 * wi[:, 2])

    assert_reciprocal(slightly, rtol=1.1e-4)
    assert "rtol = 5e-05" in message(assert_reciprocal, slightly, rtol=5e-5)


# Values that are none.


def bitangent_missing(wi: Array, wo: Array) -> Array:
    """The azimuth of a direction along the normal is 0/0."""
    with np.errstate(invalid="ignore", divide="ignore"):
        c = (wi[:, 0] * wo[:, 0] + wi[:, 1] * wo[:, 1]) / np.sqrt(
            (1.0 - wi[:, 2] ** 2) * (1.0 - wo[:, 2] ** 2)
        )
    return lambert(wi, wo) * (1.0 + 0.1 * c) * 0.5


def nan_at_grazing(wi: Array, wo: Array) -> Array:
    with np.errstate(invalid="ignore"):
        return 0.1 * np.sqrt(np.minimum(wi[:, 2], wo[:, 2]) - 1e-3)


def negative(wi: Array, wo: Array) -> Array:
    """An odd power of a cosine that is not clamped."""
    return 0.1 * dot(mirror(wi), wo) ** 5


def infinite(wi: Array, wo: Array) -> Array:
    with np.errstate(over="ignore"):
        return np.exp(1.0 / np.minimum(wi[:, 2], wo[:, 2]))


@pytest.mark.parametrize(
    ("f", "what"),
    [
        (bitangent_missing, "is nan"),
        (nan_at_grazing, "is nan"),
        (negative, r"is -\d"),
        (infinite, "is inf"),
        (lambda wi, wo: np.zeros((len(wo), 3)), r"returned shape \(\d+, 3\) for \d+ places"),
        (lambda wi, wo: 0.3, r"returned shape \(\) for"),
        (lambda wi, wo: None, "returned NoneType of object"),
        (lambda wi, wo: lambert(wi, wo) + 0j, "returned ndarray of complex128"),
    ],
)
@pytest.mark.parametrize(
    "assertion",
    [
        assert_energy_conserving,
        assert_white_furnace,
        assert_reciprocal,
        lambda f: assert_sampler_matches_pdf(cosine_sample, f, **ONCE),
        lambda f: assert_sampler_matches_pdf(returning(), cosine_pdf, f=f, **ONCE),
    ],
    ids=["energy", "furnace", "reciprocal", "pdf", "weights"],
)
def test_values_that_are_none_are_caught_by_all(assertion: Any, f: Any, what: str) -> None:
    said = message(assertion, f)
    assert re.search(what, said), said
    if what.startswith("is"):
        assert "places are not" in said
        assert "theta = " in said


# Draws that do not follow their density.


def clipped(sample: Any) -> Any:
    """Draws below the horizon are kept: mirrored up."""

    def kept(wi: Array, u: Array) -> Array:
        wo = sample(wi, u)
        wo[:, 2] = np.abs(wo[:, 2])
        return wo

    return kept


def jacobian_missing(wi: Array, wo: Array) -> Array:
    h = half(wi, wo)
    return ggx(h, 0.3, 0.3) * h[:, 2]


def cosine_missing(wi: Array, wo: Array) -> Array:
    return ggx(half(wi, wo), 0.3, 0.3) / (4.0 * dot(wo, half(wi, wo)))


def disc_without_root(wi: Array, u: Array) -> Array:
    return cosine_sample(wi, np.stack((u[:, 0] ** 2, u[:, 1]), axis=1))


def point_used_twice(wi: Array, u: Array) -> Array:
    return cosine_sample(wi, u[:, [0, 0]])


def half_a_turn(wi: Array, u: Array) -> Array:
    return cosine_sample(wi, u * (1.0, 0.5))


VISIBLE = albedo.model("cook_torrance", m=0.6, distribution="ggx", geometry="smith_correlated")


@pytest.mark.parametrize(
    ("sample", "pdf"),
    [
        (ggx_sample, jacobian_missing),
        (ggx_sample, cosine_missing),
        (ggx_sample, partial(ggx_pdf, ax=0.09, ay=0.09)),
        (clipped(partial(ggx_sample, ax=0.8, ay=0.8)), partial(ggx_pdf, ax=0.8, ay=0.8)),
        (partial(ggx_sample, ax=0.1, ay=0.4), partial(ggx_pdf, ax=0.4, ay=0.1)),
        (cosine_sample, lambda wi, wo: wo[:, 2]),
        (cosine_sample, lambda wi, wo: 1.5 * wo[:, 2] ** 2 / PI),
        (cosine_sample, lambda wi, wo: np.full(len(wo), 0.5 / PI)),
        (cosine_sample, lambda wi, wo: 0.5 * wo[:, 2] / PI),
        (disc_without_root, cosine_pdf),
        (point_used_twice, cosine_pdf),
        (half_a_turn, cosine_pdf),
        (VISIBLE, partial(ggx_pdf, ax=0.6, ay=0.6)),
    ],
    ids=[
        *("half-vector Jacobian missing", "n.h missing", "roughness for alpha"),
        *("below the horizon kept", "axes exchanged", "1/pi missing", "cosine twice"),
        *("cosine missing", "half of it", "no root", "u used twice", "half a turn"),
        "visible normals",
    ],
)
def test_a_density_of_something_else_is_caught(sample: Any, pdf: Any) -> None:
    plain = sample
    if isinstance(sample, Model):
        plain = lambda wi, u: sample.sample(u, wi).wo  # noqa: E731
    said = message(assert_sampler_matches_pdf, plain, pdf, **ONCE)
    assert said.startswith("the draws of sample do not follow pdf: 1 of 1 incidences fail")
    assert "wi = (0.736848795, 0.311534674, 0.6), theta = 53.1301 deg" in said
    expected, seen = re.findall(r"([\d.]+) draws expected, (\d+) found", said)[0]
    assert abs(float(expected) - float(seen)) > 4.0 * np.sqrt(float(expected))
    assert "a correct routine fails with a probability of 1e-06 at most" in said


def test_the_worst_cell_is_named_by_its_directions() -> None:
    """What falls about v = (sin 60, 0, cos 60) is sent along the normal, or about the normal."""
    hole = np.array([np.sqrt(0.75), 0.0, 0.5])

    def sample(wi: Array, u: Array, spread: float) -> Array:
        wo = cosine_sample(wi, u)
        other = unit(cosine_sample(wi, 1e4 * u % 1.0) * (spread, spread, 1.0))
        return np.where((wo @ hole > np.cos(np.radians(10.0)))[:, None], other, wo)

    # An atom is the worst, and next to what is spread out the hole is.
    for spread, where, within in ((0.0, np.array([0.0, 0.0, 1.0]), 0.01), (0.1, hole, 15.0)):
        wrong = partial(sample, spread=spread)
        said = message(assert_sampler_matches_pdf, wrong, cosine_pdf, cos_theta=0.9)
        wo = [float(x) for x in re.findall(r"wo = \((.*?)\)", said)[0].split(", ")]
        assert np.dot(wo, where) > np.cos(np.radians(within))


def test_the_share_above_the_horizon_is_tested_apart() -> None:
    """One draw in a hundred is thrown away: each cell is hardly off, their sum is."""

    def sample(wi: Array, u: Array) -> Array:
        wo = cosine_sample(wi, u)
        wo[u[:, 0] * 1e4 % 1.0 < 0.01] *= -1.0
        return wo

    said = message(assert_sampler_matches_pdf, sample, cosine_pdf, **ONCE)
    assert "pdf integrates to 1 +- " in said
    assert abs(float(re.findall(r"where (\S+) of 20000 draws are", said)[0]) - 0.99) < 2e-3
    assert_sampler_matches_pdf(sample, lambda wi, wo: 0.99 * cosine_pdf(wi, wo), **ONCE)


def returning(wo: Any = None, pdf: Any = None, weight: Any = None) -> Any:
    """Cosine draws of Lambert's BRDF, with something else in place of what they return."""

    def sample(wi: Array, u: Array) -> tuple[Array, Array, Array]:
        right = cosine_sample(wi, u)
        return (
            right if wo is None else wo(right),
            right[:, 2] / PI if pdf is None else pdf(right),
            np.ones(len(u)) if weight is None else weight(right),
        )

    return sample


@pytest.mark.parametrize(
    ("sample", "what"),
    [
        (returning(wo=lambda w: 1.01 * w), "directions are not of unit length: 1.01 for u = "),
        (returning(wo=lambda w: w * np.where(w[:, :1] > 0.5, np.nan, 1.0)), "are not a number"),
        (returning(wo=lambda w: w[:, :2]), r"shape \(\d+, 2\)"),
        (returning(wo=lambda w: None), "returned NoneType of object"),
        (returning(pdf=lambda w: w[:, 2]), r"the density that sample returns is not pdf\(wi, wo\)"),
        (returning(pdf=lambda w: -w[:, 2] / PI), "densities are negative or not a number: -0"),
        (returning(pdf=lambda w: w), r"the density, returned shape \(\d+, 3\)"),
        (returning(weight=lambda w: w[:, 2]), "the weight that sample returns is not f n.v/pdf"),
        (returning(weight=lambda w: 1.0 / w[:, 2]), "the weight that sample returns is not f n.v"),
        (returning(weight=lambda w: np.full(len(w), np.nan)), "weights are not finite or negative"),
        (lambda wi, u: (), "returned 0 things"),
    ],
)
def test_what_a_routine_returns_is_looked_at(sample: Any, what: str) -> None:
    said = message(assert_sampler_matches_pdf, sample, cosine_pdf, f=lambert, **ONCE)
    assert re.search(what, said), said


def test_draws_below_the_horizon_weigh_nothing() -> None:
    def sample(wi: Array, u: Array) -> tuple[Array, Array, Array]:
        wo = ggx_sample(wi, u, 0.8, 0.8)
        return wo, np.where(wo[:, 2] > 0.0, 1.0, 0.5), np.ones(len(u))

    pdf = partial(ggx_pdf, ax=0.8, ay=0.8)
    said = message(assert_sampler_matches_pdf, sample, pdf, **ONCE)
    assert "draws below the horizon, or of density 0, have a weight: 1 for u = " in said


def test_draws_where_the_density_is_0_are_caught() -> None:
    def narrow(wi: Array, wo: Array) -> Array:
        return np.where(wo[:, 2] > 0.1, cosine_pdf(wi, wo), 0.0)

    said = message(assert_sampler_matches_pdf, cosine_sample, narrow, **ONCE)
    assert re.search(r"\d+ of 20000 draws lie where pdf\(wi, wo\) is 0", said)


# Honesty.


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_furnace_that_is_off_by_little(sign: float) -> None:
    f = partial(lambert, rho=1.0 + 2e-3 * sign)
    assert_white_furnace(f, rtol=5e-3, **FEW)
    assert_white_furnace(f, rtol=1e-9, expected=1.0 + 2e-3 * sign, **FEW)
    said = message(assert_white_furnace, f, rtol=1e-3, **FEW)
    assert "0.999 to 1.001 is allowed" in said
    assert f"albedo {1.0 + 2e-3 * sign:.3f}" in said


def test_the_worst_incidence_of_a_furnace_is_named() -> None:
    def f(wi: Array, wo: Array) -> Array:
        return lambert(wi, wo) * np.where(np.abs(wi[:, 2] - 0.3) < 0.01, 0.9, 0.95)

    said = message(assert_white_furnace, f, cos_theta=[1.0, 0.3, 0.1], isotropic=True)
    assert re.findall(r"cos_theta = (\S+)", said)[0] == "0.3"


def test_an_albedo_is_held_to_1_up_to_the_stated_tolerance() -> None:
    assert_energy_conserving(lambert, **FEW)
    assert_energy_conserving(partial(lambert, rho=1.0 + 5e-7), **FEW)
    assert "1.000002" in message(assert_energy_conserving, partial(lambert, rho=1.0 + 2e-6), **FEW)
    assert_energy_conserving(partial(lambert, rho=1.0 + 2e-6), atol=1e-5, **FEW)


def striped(wi: Array, wo: Array) -> Array:
    """Jumps at 200 circles: no few nodes know its integral."""
    return 1.05 * np.where(np.floor(200.0 * wo[:, 2]) % 2 == 0, 1.9, 0.0) / PI


def test_what_cannot_be_decided_does_not_pass_in_silence() -> None:
    options: dict[str, Any] = {"max_evaluations": 20_000, "lobe": "diffuse", **FEW}
    for assertion in (assert_energy_conserving, assert_white_furnace):
        said = message(assertion, striped, **options)
        assert said.startswith("it could not be decided whether ")
        assert float(re.findall(r"a bound of (\S+)", said)[0]) > 0.0
        assertion(striped, undecided="pass", **options)


def test_a_density_that_cannot_be_integrated_is_not_decided() -> None:
    def pdf(wi: Array, wo: Array) -> Array:
        even = np.floor(1e4 * np.arctan2(wo[:, 1], wo[:, 0])) % 2 == 0
        return np.where(even, 1.999, 0.001) * cosine_pdf(wi, wo)

    options = {**ONCE, "samples": 2000}
    said = message(assert_sampler_matches_pdf, cosine_sample, pdf, **options)
    assert said.startswith("it could not be decided whether the draws of sample follow pdf")
    assert_sampler_matches_pdf(cosine_sample, pdf, undecided="pass", **options)


def test_an_excess_at_grazing_incidence_is_seen_where_it_begins() -> None:
    ward = albedo.model("ward", m=0.1)
    assert_energy_conserving(ward, cos_theta=[1.0, 0.1, 1e-3])
    said = message(assert_energy_conserving, ward)
    assert "1 of 10 incidences fail" in said
    assert "cos_theta = 0.0001" in said


def test_a_wrong_claim_of_isotropy_is_caught() -> None:
    brushed = partial(cook_torrance, ax=0.1, ay=0.5)
    for assertion in (assert_energy_conserving, assert_white_furnace):
        said = message(assertion, brushed, isotropic=True)
        assert said.startswith("f(wi, wo) is not isotropic, as isotropic=True says: ")


def test_an_excess_at_one_azimuth_is_found() -> None:
    def f(wi: Array, wo: Array) -> Array:
        c = wi[:, 0] ** 2 / np.maximum(1.0 - wi[:, 2] ** 2, 1e-30)
        return lambert(wi, wo) * (0.9 + 0.2 * c)

    said = message(assert_energy_conserving, f, cos_theta=[0.5, 0.1])
    assert "2 of 8 incidences fail" in said
    assert "phi = 0 deg" in said
    assert_energy_conserving(f, cos_theta=[0.5, 0.1], phi=0.5 * PI)


def test_a_narrow_lobe_is_seen_where_it_is_declared() -> None:
    narrow = partial(cook_torrance, ax=1e-4, ay=1e-4)
    assert_white_furnace(narrow, cos_theta=[1.0, 0.5], isotropic=True)
    assert_white_furnace(narrow, cos_theta=[1.0, 0.5], isotropic=True, lobe="half", width=1e-4)


def test_correct_routines_fail_no_more_often_than_stated() -> None:
    """200 seeds at a level of 0.05: at most 28 fail but for one in 10^6; the true rate is lower."""
    failed = 0
    for seed in range(200):
        try:
            assert_sampler_matches_pdf(
                cosine_sample, cosine_pdf, cos_theta=0.5, samples=2000, level=0.05, seed=seed
            )
        except AssertionError:
            failed += 1
    assert failed <= stats.binom.isf(1e-6, 200, 0.05)


def test_the_p_values_of_correct_routines_are_even() -> None:
    """The statistic of 200 seeds against its distribution: what the level rests on."""
    from albedo.analysis.checks import compare

    wi = np.array([0.0, 0.0, 1.0])
    rng = np.random.default_rng(7)
    found = []
    for _ in range(200):
        pilot, draws = (cosine_sample(wi, rng.random((n, 2))) for n in (500, 2000))
        found.append(compare(pilot, draws, cosine_pdf, wi, level=0.5, fewest=100.0).p_value)
    # Kolmogorov and Smirnov's test at a level of 1e-3.
    assert stats.kstest(found, "uniform").pvalue > 1e-3


@pytest.mark.parametrize("cells", [1, 2, 5, 20])
@pytest.mark.parametrize("p", [1e-9, 1e-11])
def test_far_out_the_statistic_exceeds_its_limit_by_less_than_is_granted(
    cells: int, p: float
) -> None:
    """The exact distribution of Pearson's statistic of Poisson counts with the fewest draws."""
    top = stats.chi2.isf(p, cells)
    size = 2**18
    step = 4.0 * top / size
    seen = np.arange(1000)
    terms = np.floor((seen - _FEWEST) ** 2 / _FEWEST / step).astype(int)
    # What lies beyond the grid is at its end, and what is rounded down counts as too large.
    one = np.bincount(np.minimum(terms + 1, size - 1), stats.poisson.pmf(seen, _FEWEST), size)
    spectrum = np.fft.rfft(one, 2 * cells * size)
    tail = np.fft.irfft(spectrum**cells)[int(top / step) :].sum()
    assert p < tail < p / _TAIL


def test_same_seed_same_verdict() -> None:
    wrong = partial(ggx_pdf, ax=0.36, ay=0.36)
    first = message(assert_sampler_matches_pdf, ggx_sample, wrong, seed=3, **ONCE)
    assert message(assert_sampler_matches_pdf, ggx_sample, wrong, seed=3, **ONCE) == first
    assert message(assert_sampler_matches_pdf, ggx_sample, wrong, seed=4, **ONCE) != first


def test_functions_may_write_into_what_they_are_given() -> None:
    def rude(wi: Array, wo: Array) -> Array:
        values = cook_torrance(wi, wo)
        wi[:], wo[:] = 0.0, 0.0
        return values

    assert_reciprocal(rude)
    assert_energy_conserving(rude, **FEW)


# Wrong arguments, and where the kit is used.


@pytest.mark.parametrize(
    ("call", "what"),
    [
        (lambda: assert_energy_conserving(3.0), "f is float; it must be f(wi, wo) or a Model"),
        (lambda: assert_energy_conserving(lambert, cos_theta=0.0), "cos_theta contains 0"),
        (lambda: assert_energy_conserving(lambert, cos_theta=1.5), "cos_theta = 1.5 is out of"),
        (lambda: assert_energy_conserving(lambert, cos_theta=[]), "cos_theta is empty"),
        (lambda: assert_energy_conserving(lambert, atol=-1.0), "atol = -1.0 is out of range"),
        (lambda: assert_energy_conserving(lambert, lobe="half"), "needs a width in radians"),
        (lambda: assert_energy_conserving(lambert, lobe="wide"), "lobe = 'wide' is unknown"),
        (lambda: assert_energy_conserving(lambert, undecided="maybe"), "undecided = 'maybe'"),
        (lambda: assert_energy_conserving(lambert, max_evaluations=3), "max_evaluations = 3"),
        (lambda: assert_energy_conserving(lambert, resolved_width=0.0), "resolved_width = 0.0"),
        (lambda: assert_energy_conserving(VISIBLE, isotropic=True), "isotropic is about a func"),
        (lambda: assert_reciprocal(VISIBLE, with_cosine=True), "with_cosine is about a function"),
        (lambda: assert_white_furnace(lambert, expected=-1.0), "expected contains -1"),
        (lambda: assert_white_furnace(lambert, expected=[1, 1, 1]), "does not broadcast"),
        (lambda: assert_white_furnace(lambert, rtol=float("nan")), "rtol = nan is out of range"),
        (lambda: assert_reciprocal(lambert, samples=0), "samples = 0 is out of range"),
        (lambda: assert_reciprocal(lambert, lowest_cos_theta=0.5), "lowest_cos_theta = 0.5"),
        (lambda: assert_reciprocal(None), "f is NoneType"),
        (lambda: assert_sampler_matches_pdf(cosine_sample), "pdf is missing"),
        (lambda: assert_sampler_matches_pdf(1, cosine_pdf), "sample is int"),
        (lambda: assert_sampler_matches_pdf(cosine_sample, 1), "pdf is int"),
        (lambda: assert_sampler_matches_pdf(cosine_sample, cosine_pdf, level=0.5), "level = 0.5"),
        (lambda: assert_sampler_matches_pdf(cosine_sample, cosine_pdf, seed=-1), "seed = -1"),
    ],
)
def test_wrong_arguments_are_input_errors(call: Callable[[], None], what: str) -> None:
    with pytest.raises(InputError, match=re.escape(what)):
        call()


class TestWithUnittest(unittest.TestCase):
    """The assertions know nothing of what runs them."""

    def test_right(self) -> None:
        assert_reciprocal(lambert)
        assert_energy_conserving(lambert, **FEW)
        assert_white_furnace(lambert, **FEW)
        assert_sampler_matches_pdf(cosine_sample, cosine_pdf, **ONCE)

    def test_wrong(self) -> None:
        with self.assertRaisesRegex(self.failureException, "not reciprocal"):  # noqa: PT027
            assert_reciprocal(phong_over_light)


def test_the_kit_costs_nothing_until_it_is_used() -> None:
    code = (
        "import sys, albedo\n"
        "assert 'albedo.testing' not in sys.modules\n"
        "assert albedo.testing.__name__ == 'albedo.testing'\n"
        "heavy = {'numba', 'scipy', 'pytest', 'unittest', 'pandas', 'matplotlib'}\n"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)\n"
        "assert set(albedo.testing.__all__) <= set(dir(albedo.testing))\n"
        "albedo.testing.assert_reciprocal(lambda wi, wo: wi[:, 2] * wo[:, 2])\n"
        "assert 'pytest' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True)


DOCS = Path(__file__).resolve().parent.parent / "docs" / "testing.md"
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


@pytest.mark.parametrize("name", ["", ".energy", ".reciprocity", ".sampling"])
def test_examples_work(name: str) -> None:
    found = doctest.testmod(importlib.import_module(f"albedo.testing{name}"), optionflags=FLAGS)
    assert found.attempted
    assert not found.failed


def test_the_page_works() -> None:
    found = doctest.testfile(str(DOCS), module_relative=False, optionflags=FLAGS)
    assert found.attempted
    assert not found.failed
