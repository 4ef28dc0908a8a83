"""Checks that can fail: of a model, of its sampling, and of functions in a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import albedo
from albedo.analysis import checks
from albedo.analysis.checks import check, check_function, chi_square, finite_draws
from albedo.brdf import Model
from albedo.cli import app
from albedo.directions import spherical
from albedo.errors import InputError
from albedo.sampling.mixture import Sample

MODELS = [kind() for kind in albedo.models().values()]
PHONG = albedo.model("phong", n=20.0)

FILE = """
import numpy as np

def dusty(wi, wo):
    return 0.25 / np.pi / (wi[..., 2] + wo[..., 2])

def dusty_sample(u, wi):
    s, t = np.sqrt(u[:, 0]), 2 * np.pi * u[:, 1]
    return np.stack((s * np.cos(t), s * np.sin(t), np.sqrt(1 - u[:, 0])), axis=-1)

def dusty_pdf(wi, wo):
    return np.maximum(wo[:, 2], 0) / np.pi

def lopsided(wi, wo):
    return np.broadcast_to(wi[..., 2], wo.shape[:-1]) * 0.7

lopsided_sample = dusty_sample

def lopsided_pdf(wi, wo):
    return np.full(len(wo), 0.5 / np.pi)

def half(wi, wo):
    return np.full(wo.shape[:-1], 0.1)

half_sample = dusty_sample
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "mine.py"
    path.write_text(FILE, encoding="utf-8")
    return path


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.name)
@pytest.mark.filterwarnings("ignore::albedo.ConvergenceWarning")
def test_the_catalogue_passes_all_its_checks(model: Model) -> None:
    """Seeds are fixed: with 28 models at a level of 1 in 1,000 none has to fail."""
    failed = [one for one in check(model.by_channel()[0]) if one.passed is False]
    assert not failed


@pytest.mark.parametrize("cos_theta", [0.95, 0.05])
@pytest.mark.parametrize(
    "spec",
    [
        {"n_u": 1.0, "n_v": 1.0},
        {"n_u": 10.0, "n_v": 1e3},
        {"n_u": 1e4, "n_v": 1.0},
        {"n_u": 100.0, "n_v": 1e6},
    ],
    ids=str,
)
def test_draws_of_half_vectors_fit_in_all_four_quadrants(
    spec: dict[str, float], cos_theta: float
) -> None:
    model = albedo.model("ashikhmin_shirley", **spec)
    result = chi_square(
        *(finite_draws(model), model.pdf, cos_theta, 0.7), level=1e-3, tests=8, seed=5
    )
    assert result.passed, str(result)
    assert result.degrees > 100


def test_a_density_that_is_off_by_little_is_caught() -> None:
    """The exponent of the density 5 percent too high: 100,000 draws in 370 cells."""
    other = albedo.model("phong", n=21.0)
    result = chi_square(finite_draws(PHONG), other.pdf, 0.7)
    assert not result.passed
    assert result.undensified == 0


def test_what_is_drawn_where_the_density_is_0_is_counted() -> None:
    def clipped(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        return np.where(wo[:, 0] < -0.9, 0.0, PHONG.pdf(wi, wo))

    result = chi_square(finite_draws(PHONG), clipped, 0.7)
    assert result.undensified > 0
    assert not result.passed
    assert "where the density is 0" in str(result)


@pytest.mark.parametrize("factor", [0.97, 1.03])
def test_a_density_that_is_not_normalised_is_caught(factor: float) -> None:
    """By the draws below the horizon, or by there being none left for them."""
    result = chi_square(finite_draws(PHONG), lambda wi, wo: factor * PHONG.pdf(wi, wo), 0.9)
    assert not result.passed
    assert result.above == pytest.approx(factor, rel=1e-3)


def test_a_density_that_cannot_be_integrated_says_nothing_for_the_draws() -> None:
    """Stripes of 1e-4 rad: twice the density on every second one."""

    def striped(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        even = np.floor(1e4 * np.arctan2(wo[:, 1], wo[:, 0])) % 2 == 0
        return np.where(even, 1.999, 0.001) * PHONG.pdf(wi, wo)

    result = chi_square(finite_draws(PHONG), striped, 0.7, samples=5000)
    assert result.bound > checks.LOOSE
    assert not result.passed
    assert "uncertain by" in str(result)


def test_the_share_above_the_horizon_is_the_integral_of_the_density() -> None:
    mirror = albedo.model("he_torrance", sigma0=0.03, tau=1.0)
    for model in (PHONG, mirror, albedo.model("ward", m=0.3) + albedo.model("lambert")):
        value, error = checks.above_horizon(model, 0.1, 0.4)
        wo = model.sample(np.random.default_rng(1).random((100_000, 2)), spherical(0.1, 0.4)).wo
        spread = np.sqrt(value * (1.0 - value) / 1e5)
        assert error < 1e-6
        assert abs(np.mean(wo[:, 2] > 0.0) - value) <= 5.0 * spread


def test_draws_from_half_of_the_lobe_are_caught() -> None:
    def half(u: np.ndarray, wi: np.ndarray) -> np.ndarray:
        wo = PHONG.sample(u, wi).wo.copy()
        wo[:, 1] = np.abs(wo[:, 1])
        return wo

    assert not chi_square(half, PHONG.pdf, 0.7).passed


def test_checks_of_a_broken_model_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    original = albedo.model("phong_original", n=5.0)
    object.__setattr__(original, "reciprocal", True)
    object.__setattr__(original, "conserves_energy", True)
    failed = {one.name for one in check(original) if one.passed is False}
    assert failed == {"reciprocity", "energy"}
    bright = albedo.model("ward", m=0.1)
    object.__setattr__(bright, "conserves_energy", True)
    assert not checks.energy(bright).passed
    skewed = albedo.model("phong", n=20.0)
    true = type(skewed).sample

    def heavy(self: Model, u: np.ndarray, wi: np.ndarray) -> Sample:
        found = true(self, u, wi)
        return Sample(found.wo, found.pdf, 1.01 * found.weight)

    monkeypatch.setattr(type(skewed), "sample", heavy)
    assert [one.passed for one in checks.sampling(skewed)] == [False, *5 * [True]]


def test_functions_in_a_file_are_checked_with_their_sampling(file: Path) -> None:
    found = check_function(f"{file}:dusty", lobe="diffuse", isotropic=True, reciprocal=True)
    assert all(one.passed is not False for one in found)
    assert [one.name for one in found][-4:] == [
        f"dusty_sample at cos theta = {c}" for c in ("0.95", "0.6", "0.25", "0.05")
    ]
    found = check_function(f"{file}:lopsided", lobe="diffuse", isotropic=True, reciprocal=True)
    failed = [one.name for one in found if one.passed is False]
    assert failed[0] == "reciprocity"
    assert len(failed) == 5


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("none.py:f", "is not a file"),
        ("mine.py:f", "has no function 'f'; it has dusty"),
        ("mine.py:half", "has half_sample but no half_pdf"),
        ("broken.py:f", "cannot be run: ZeroDivisionError|cannot be run: NameError"),
    ],
)
def test_files_that_do_not_fit_are_named(file: Path, name: str, message: str) -> None:
    (file.parent / "broken.py").write_text("missing + 1\n", encoding="utf-8")
    with pytest.raises(InputError, match=message):
        check_function(str(file.parent / name), lobe="diffuse", isotropic=True)


def test_the_command_says_what_failed(file: Path) -> None:
    run = CliRunner().invoke(app, ["check", "phong:n=20"])
    assert run.exit_code == 0, run.output
    assert "No check failed" in run.stdout
    bad = CliRunner().invoke(
        app, ["check", f"{file}:lopsided", "--lobe", "diffuse", "--isotropic", "--reciprocal"]
    )
    assert bad.exit_code == 1
    assert "FAILED" in bad.stdout
    assert "5 of 14 checks failed" in bad.stdout
    for line, message in (
        (["check", "phong", "--lobe", "mirror"], "is about a function in a file"),
        (["check", "phong", "--level", "2"], "--level 2 is out of range"),
        (["check", "phong", "--seed", "-1"], "--seed -1 is out of range"),
        (["check", "nobody"], "nobody"),
    ):
        run = CliRunner().invoke(app, line)
        assert run.exit_code == 2
        assert message in run.stderr


def test_tables_of_a_function_have_no_parameters_to_sweep() -> None:
    grey = albedo.model_from(lambda wi, wo: np.full(wo.shape[:-1], 0.1), lobe="diffuse")
    found = albedo.table(grey, [0.5, 1.0], rtol=1e-6)
    np.testing.assert_allclose(found["value"].values.ravel(), 0.1 * np.pi, rtol=1e-6)
    with pytest.raises(InputError, match="is a function and has no parameter 'm'"):
        albedo.table(grey, [0.5], sweep={"m": [0.1]})


def test_what_operators_make_is_checked_like_any_other() -> None:
    """Energy, reciprocity, densities: a pumped model has charts and samples of its own."""
    for model in (
        albedo.pump(albedo.model("phong", n=20), 2),
        albedo.pump(albedo.model("lafortune_scaled"), 1, rtol=1e-4),
        albedo.couple(albedo.model("phong", n=20)),
    ):
        found = check(model)
        assert all(result.passed is not False for result in found), model.spec
