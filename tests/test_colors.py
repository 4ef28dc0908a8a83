"""Colours: parameters with channels give a leading axis to values, albedos and tables."""

from __future__ import annotations

import numpy as np
import pytest

import albedo
from albedo.brdf import Color, Model, Part, Real
from albedo.catalogue.lambert import fill
from albedo.charts.cosine import CosineChart

RED_GREEN_BLUE = (0.9, 0.5, 0.1)


class Dyed(Model):
    """Lambert's law with a colour, dimmed."""

    name = "dyed"
    color = Color(1.0, "reflectance of every channel", low=0.0, high=1.0)
    tint = Color(1.0, "a second colour", low=0.0, high=1.0)
    dim = Real(1.0, "what is left", low=0.0, high=1.0)

    def pack(self) -> tuple[float, ...]:
        return (self.color * self.tint * self.dim,)

    def parts(self) -> tuple[Part, ...]:
        return (Part("diffuse", fill, CosineChart()),)


def test_a_colour_gives_a_leading_axis() -> None:
    model = Dyed(color=RED_GREEN_BLUE, dim=0.5)
    found = albedo.directional_albedo(model, [[1.0, 0.5], [0.2, 0.1]])
    assert found.value.shape == found.error.shape == (3, 2, 2)
    exact = 0.5 * np.array(RED_GREEN_BLUE)[:, None, None]
    assert np.all(np.abs(found.value - exact) <= found.error)
    average = albedo.average_albedo(model)
    assert average.value.shape == (3,)
    assert np.all(np.abs(average.value - exact[:, 0, 0]) <= average.error)
    values = model.eval([0.0, 0.0, 1.0], [[0.6, 0.0, 0.8], [0.0, 0.0, 1.0]])
    # A product of three numbers and a division by pi.
    np.testing.assert_allclose(values, np.repeat(exact[..., 0], 2, 1) / np.pi, rtol=1e-15)


def test_a_channel_is_the_model_of_its_numbers() -> None:
    model = Dyed(color=RED_GREEN_BLUE)
    assert model.channels == 3
    assert [one.channels for one in model.by_channel()] == [None] * 3
    green = albedo.directional_albedo(model.channel(1), 0.5)
    alone = albedo.directional_albedo(Dyed(color=RED_GREEN_BLUE[1]), 0.5)
    assert green.value == alone.value
    assert green.value.shape == ()
    assert model.channel(1) == model.channel(1)
    assert len({model, model.channel(0), model.channel(1)}) == 3
    assert Dyed(color=0.5).by_channel() == [Dyed(color=0.5)]


def test_tables_have_a_dimension_for_channels() -> None:
    table = albedo.table(Dyed(color=RED_GREEN_BLUE), [1.0, 0.5], sweep={"dim": [0.5, 1.0]})
    assert table["value"].dims == ("dim", "channel", "phi", "cos_theta")
    error = table["error"].values
    exact = np.array([0.5, 1.0])[:, None] * np.array(RED_GREEN_BLUE)
    assert np.all(np.abs(table["value"].values - exact[:, :, None, None]) <= error)


@pytest.mark.parametrize(
    ("values", "complaint"),
    [
        ({"color": (0.9, 1.5)}, r"color = 1.5 is out of range; it must lie in \[0, 1\]"),
        ({"color": ()}, "color has no channel"),
        ({"color": (0.9, "x")}, "color = 'x' is not a number"),
        ({"color": (0.9, 0.1), "tint": (1.0, 1.0, 1.0)}, "color has 2, tint has 3"),
    ],
)
def test_bad_colours_are_refused(values: dict, complaint: str) -> None:
    with pytest.raises(albedo.InputError, match=complaint):
        Dyed(**values)


def test_a_channel_that_is_not_there_is_refused() -> None:
    with pytest.raises(albedo.InputError, match="has no channel 3; it has 3"):
        Dyed(color=RED_GREEN_BLUE).channel(3)
    with pytest.raises(albedo.InputError, match="it has none"):
        Dyed().channel(0)


def test_colours_of_different_lengths_do_not_share_a_table() -> None:
    with pytest.raises(albedo.InputError, match="equally many channels"):
        albedo.table(Dyed(), [1.0], sweep={"color": [(0.1, 0.2), 0.3]})
