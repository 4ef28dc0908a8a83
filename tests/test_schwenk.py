"""Schwenk's model: its exponent, its steps of simplification and its colours."""

from __future__ import annotations

import math

import numpy as np
import pytest
from exact import blinn_normal

import albedo
from albedo.catalogue.blinn import normalization
from albedo.catalogue.schwenk import exponent

EPS = np.finfo(float).eps

COSINES = np.array([1.0, 0.7, 0.2, 1e-3])


@pytest.mark.parametrize(("s", "e"), [(0.0, 1.9922), (0.5, 3.969), (1.0, 510.0)])
def test_published_exponents(s: float, e: float) -> None:
    # Four and five digits are printed.
    assert exponent(s) == pytest.approx(e, rel=5e-5)


@pytest.mark.parametrize("s", [0.2, 0.8, 1.0])
def test_the_third_step_is_a_modified_blinn_phong(s: float) -> None:
    m, c = 0.6, 0.3
    model = albedo.model("schwenk", color=c, metalness=m, smoothness=s, level="3")
    e = exponent(s)
    blinn = albedo.directional_albedo(albedo.model("blinn", n=e), COSINES)
    scale = s * s * (1.0 - m + m * c) / (math.pi * normalization(e))
    found = albedo.directional_albedo(model, COSINES)
    slack = found.error + scale * blinn.error
    assert np.all(np.abs(found.value - c - scale * blinn.value) <= slack)


def test_the_fourth_step_is_lambert() -> None:
    model = albedo.model("schwenk", color=0.3, k_d=0.8, smoothness=0.5, k=0.4, level="4")
    found = albedo.directional_albedo(model, COSINES)
    assert np.all(np.abs(found.value - 0.3 * 0.8 * 0.8) <= found.error)


@pytest.mark.parametrize("level", ["0", "1"])
def test_normal_incidence_has_a_closed_form(level: str) -> None:
    """There v.h = n.h: 1/(v.h) takes one from the exponent, and Fresnel's factor of 1 is 1."""
    model = albedo.model("schwenk", smoothness=0.7, k_d=0.0, level=level)
    found = albedo.directional_albedo(model, 1.0)
    exact = 0.49 / math.pi * blinn_normal(exponent(0.7) - 1.0)
    assert abs(found.value - exact) <= found.error


def test_luminance_divides_the_colour_of_the_highlight() -> None:
    """Pure blue: F0 = 1/0.0722 in that channel, unless it is cut."""
    blue = albedo.model(
        "schwenk", color=(0.0, 0.0, 1.0), metalness=1.0, k_d=0.0, smoothness=0.9, level="1"
    )
    white = blue.replace(color=1.0)
    found, one = (albedo.directional_albedo(m, 0.7, rtol=1e-10) for m in (blue, white))
    assert np.all(found.value[:2] == 0.0)
    assert abs(found.value[2] - one.value / 0.0722) <= found.error[2] + one.error / 0.0722
    cut = albedo.directional_albedo(blue.replace(clamp="yes"), 0.7)
    assert abs(cut.value[2] - one.value) <= cut.error[2] + one.error


@pytest.mark.parametrize("level", ["0", "2", "3"])
def test_grey_is_the_number_of_each_channel(level: str) -> None:
    grey = albedo.model("schwenk", color=(0.4, 0.4, 0.4), metalness=0.8, level=level)
    found = albedo.directional_albedo(grey, 0.5)
    one = albedo.directional_albedo(grey.replace(color=0.4), 0.5)
    assert np.all(np.abs(found.value - one.value) <= found.error + one.error)
    black = albedo.directional_albedo(grey.replace(color=(0.0, 0.0, 0.0)), 0.5)
    assert np.all(np.isfinite(black.value))


def test_luminance_needs_one_channel_or_three() -> None:
    with pytest.raises(albedo.InputError, match="color has 2 channels"):
        albedo.model("schwenk", color=(0.1, 0.2))


def test_an_environment_is_mixed_in() -> None:
    """All metal: C_d = (1 - r) C + r C C_e; all plastic: the mean of F over cosines is exact."""
    values = {"color": 0.4, "color_environment": 0.9, "reflectivity": 0.5, "level": "4"}
    metal = albedo.directional_albedo(albedo.model("schwenk", metalness=1.0, **values), COSINES)
    assert np.all(np.abs(metal.value - (0.5 * 0.4 + 0.5 * 0.4 * 0.9)) <= metal.error)
    plastic = albedo.model("schwenk", metalness=0.0, **values)
    assert not plastic.reciprocal
    found = albedo.directional_albedo(plastic, COSINES)
    average = 0.04 + 0.96 / 21.0
    exact = 0.5 * 0.4 + 0.5 * ((1.0 - average) * 0.4 + average * 0.9)
    assert np.all(np.abs(found.value - exact) <= found.error + 4 * EPS)


def test_digits_name_a_level_on_the_command_line() -> None:
    from albedo.grammar import parse

    assert parse("schwenk:level=3").model() == albedo.model("schwenk", level="3")
    assert albedo.model("schwenk", level=3) == albedo.model("schwenk", level="3")
    with pytest.raises(albedo.InputError, match="level = '5' is unknown"):
        albedo.model("schwenk", level=5)
