"""Energy maps: the largest and smallest albedo of a model over its domain."""

from __future__ import annotations

import math
from pathlib import Path

import exact
import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

import albedo
from albedo.analysis.energy import GRAZING, domain, draw, energy_map, verdict
from albedo.cli import app
from albedo.grammar import parse


def test_every_model_declares_a_domain_within_its_ranges() -> None:
    for name, kind in albedo.models().items():
        spec = parse(f"{name}:{kind.domain}")
        assert spec.sweep, name
        for model in spec.models():  # refuses what is out of range
            assert model.name == name


def test_the_largest_albedo_is_found_between_the_directions_of_the_grid() -> None:
    """c RV^n / max(NL, NV) with n -> 0 has its largest albedo near 45 degrees."""
    found = energy_map(parse("max_phong:n=[0,1]"), rtol=1e-9).frame
    cosines = np.cos(np.radians(np.linspace(5.0, 60.0, 1101)))
    for row, n in zip(found.itertuples(), (0.0, 1.0), strict=True):
        fine = albedo.directional_albedo(albedo.model("max_phong", n=n), cosines, rtol=1e-9)
        # A twentieth of a degree off the top costs less than 1e-6 of the albedo.
        assert abs(row.max_albedo - fine.value.max()) <= 1e-6
        assert row.max_albedo >= fine.value.max() - row.max_albedo_error - 1e-8
        there = albedo.directional_albedo(albedo.model("max_phong", n=n), row.max_cos_theta)
        assert abs(there.value - row.max_albedo) <= there.error + row.max_albedo_error
    assert list(found["exceeds_one"]) == ["yes", "yes"]


def test_extremes_of_phong_are_at_the_ends() -> None:
    found = energy_map(parse("phong:n=[5,50]")).frame
    for row, n in zip(found.itertuples(), (5.0, 50.0), strict=True):
        assert abs(row.max_albedo - 1.0) <= row.max_albedo_error
        assert row.max_cos_theta == 1.0
        assert row.exceeds_one == "within the bound"
        assert abs(row.min_albedo - exact.phong_grazing(n)) <= row.min_albedo_error + 1e-8
        assert row.min_cos_theta == pytest.approx(GRAZING)
        assert not row.diverges


def test_divergence_and_azimuth_are_reported() -> None:
    found = energy_map(parse("ward:alpha_x=0.05,alpha_y=[0.05,0.3]"), rtol=1e-4).frame
    assert found["diverges"].all()
    assert (found["exceeds_one"] == "yes").all()
    turned = found.iloc[1]
    assert turned["max_cos_theta"] == pytest.approx(GRAZING)
    along, across = (
        float(
            albedo.directional_albedo(
                albedo.model("ward", alpha_x=0.05, alpha_y=0.3), GRAZING, phi, rtol=1e-4
            ).value
        )
        for phi in (0.0, 0.5 * math.pi)
    )
    assert turned["max_phi"] == (0.0 if along > across else 0.5 * math.pi)
    assert turned["max_albedo"] == pytest.approx(max(along, across), rel=2e-4)


def test_the_verdict_needs_the_bound() -> None:
    assert verdict(1.1, 0.05) == "yes"
    assert verdict(1.1, 0.2) == verdict(1.0, 0.0) == verdict(0.95, 0.1) == "within the bound"
    assert verdict(0.9, 0.05) == "no"


def test_what_is_given_is_not_swept() -> None:
    assert domain("ward:rho_s=0.5").sweep.keys() == {"m"}
    assert domain("ward:m=[0.1,0.2]").sweep["m"].tolist() == [0.1, 0.2]
    with pytest.raises(albedo.InputError, match="nothing to sweep"):
        domain("ward:alpha_x=0.1")
    with pytest.raises(albedo.InputError, match="at most"):
        energy_map(parse("ward:m=0.1..0.2/2000,rho_s=0.1..0.2/2000"))


def test_maps_are_drawn_over_one_or_two_numbers() -> None:
    one = energy_map(parse("lambert:rho=[0.1,0.5,1]"), rtol=1e-4)
    (axes,) = draw(one).axes
    top = next(line for line in axes.lines if line.get_label() == "largest albedo")
    np.testing.assert_allclose(top.get_ydata(), one.frame["max_albedo"])
    two = energy_map(parse("phong:n=[1,10,100],rho_s=[0.5,1]"), rtol=1e-3)
    assert len(draw(two).axes) == 4
    words = energy_map(parse("blinn:normalization=[exact,n_plus_8]"), rtol=1e-3)
    with pytest.raises(albedo.InputError, match="one or two swept numbers"):
        draw(words)


def test_the_command_writes_numbers_and_picture(tmp_path: Path) -> None:
    picture = tmp_path / "blinn.png"
    spec = "blinn:n=[1,10],normalization=n_plus_8"
    result = CliRunner().invoke(app, ["energy", spec, "-o", str(picture)])
    assert result.exit_code == 0, result.output
    assert "exceeds 1: 2 of 2" in result.output
    assert picture.stat().st_size > 10_000
    frame = pd.read_csv(tmp_path / "blinn.csv")
    assert list(frame["n"]) == [1.0, 10.0]
    # (n + 8)/(8 pi) over the exact constant.
    wanted = [(n + 8) / (8 * math.pi) * exact.blinn_normal(n) for n in (1.0, 10.0)]
    assert np.all(np.abs(frame["max_albedo"] - wanted) <= frame["max_albedo_error"] + 1e-12)


def test_a_map_that_cannot_be_drawn_is_refused_before_it_is_computed(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["energy", "ward", "-o", str(tmp_path / "a.xyz")])
    assert result.exit_code == 2
    result = CliRunner().invoke(app, ["energy", "ward:m=0.1", "-o", str(tmp_path / "a.png")])
    assert result.exit_code == 2
    assert "nothing to sweep" in result.output
    assert not list(tmp_path.iterdir())
