"""What simpler models change, against closed forms, random directions and other searches."""

from __future__ import annotations

import doctest
import math
import sys
from contextlib import nullcontext
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import quad
from scipy.optimize import differential_evolution

import albedo
from albedo.analysis import scale_down
from albedo.analysis.scale_down import albedo_change, change_by_channel, radiance_change
from albedo.brdf import Model, Part
from albedo.charts.cosine import CosineChart
from albedo.errors import InputError
from albedo.grammar import parse
from albedo.studies import StudyFile

EPS = float(np.finfo(float).eps)
STUDIES = Path(__file__).parent.parent / "studies"
DRAWS = 200_000
# Normal errors exceed this once in 150,000 draws; fewer than 100 are made here.
SIGMAS = 4.5

# An original and what stands for it: a Fresnel factor dropped or replaced, one roughness for two, a
# diffuse part that is not coupled any more, another lobe, another diffuse model.
PAIRS = {
    "no Fresnel factor": (
        "cook_torrance:m=0.3,fresnel=schlick,f0=0.04",
        "0.04*cook_torrance:m=0.3",
    ),
    "Schlick's factor": (
        "cook_torrance:m=0.2,fresnel=dielectric,ior=1.5",
        "cook_torrance:m=0.2,fresnel=schlick,f0=0.04",
    ),
    "isotropic": ("ward:alpha_x=0.2,alpha_y=0.4", "ward:m=0.3"),
    "another lobe": ("max_phong:n=50", "phong:n=50"),
    "about the light": ("max_phong:n=50,variant=retro", "lambert:rho=0.3"),
    "a narrow lobe about the light": (
        "max_phong:n=3000,variant=retro",
        "max_phong:n=2000,variant=retro",
    ),
    "another diffuse": ("oren_nayar:sigma=0.5", "lambert"),
}


class Broken(Model):
    """Values that are no numbers."""

    name = "broken"

    def pack(self) -> tuple[float, ...]:
        return ()

    def parts(self) -> tuple[Part, ...]:
        def fill(wi: Any, wo: Any, h: Any, p: Any, out: np.ndarray) -> None:
            out[:] = np.nan

        return (Part("diffuse", fill, CosineChart()),)


def model(spec: str) -> Model:
    return parse(spec).model()


def directions(count: int, cosine: bool, rng: np.random.Generator) -> np.ndarray:
    """Uniform in solid angle, or by the cosine."""
    z, phi = rng.uniform(0.0, 1.0, count), rng.uniform(0.0, 2.0 * math.pi, count)
    z = np.sqrt(z) if cosine else z
    s = np.sqrt((1.0 - z) * (1.0 + z))
    return np.stack((s * np.cos(phi), s * np.sin(phi), z), axis=-1)


def is_mean(value: scale_down.Measured, draws: np.ndarray) -> bool:
    """Whether the mean of draws is the number, within its error and their standard error."""
    spread = SIGMAS * float(draws.std()) / math.sqrt(draws.size)
    return bool(abs(value.value - draws.mean()) <= value.error + spread)


def test_lambert_for_lambert() -> None:
    first, second = (albedo.model("lambert", rho=rho) for rho in (0.5, 0.4))
    light, energy = radiance_change(first, second), albedo_change(first, second)
    # The mean of n.l over uniform lights is 1/2.
    known = {"absolute": 0.05 / math.pi, "relative": 0.2, "share": 0.2, "signed": -0.05 / math.pi}
    for name, value in known.items():
        found = getattr(light, name)
        assert abs(found.value - value) <= found.error <= 1e-5
    for name, value in {**known, "absolute": 0.1, "signed": -0.1}.items():
        found = getattr(energy, name)
        assert abs(found.value - value) <= found.error <= 1e-11
    assert abs(light.worst.value - 0.1 / math.pi) <= light.worst.error
    assert light.worst.cos_light == 1.0
    assert abs(light.worst_relative.value - 0.2) <= light.worst_relative.error <= 1e-8
    assert abs(energy.worst.value - 0.1) <= energy.worst.error <= 1e-11
    assert light.agreed
    assert energy.agreed
    assert math.isnan(energy.worst.cos_view)
    assert math.isnan(energy.worst.angle_from_mirror)


def test_nothing_changes_nothing() -> None:
    same = model("ward:m=0.2")
    for found in (radiance_change(same, same), albedo_change(same, same)):
        for name in ("absolute", "relative", "share", "worst", "worst_relative"):
            assert getattr(found, name).value == 0.0


def test_light_from_nothing_is_an_infinite_change() -> None:
    black, grey = albedo.model("lambert", rho=0.0), albedo.model("lambert", rho=0.1)
    for found in (radiance_change(black, grey), albedo_change(black, grey)):
        for one in (found.relative, found.share, found.worst_relative):
            assert one.value == math.inf
            assert one.error == math.inf
        assert math.isfinite(found.absolute.value)
        assert found.worst.value > 0.0
    both = radiance_change(black, black)
    assert both.relative.value == both.share.value == 0.0


@pytest.mark.parametrize("width_h", [1.0, 0.25, 2.0**-10])
@pytest.mark.parametrize("width_d", [1.0, 0.0625])
def test_the_rule_is_a_mean(width_h: float, width_d: float) -> None:
    at = scale_down._nodes(18, width_h, width_d)
    n_l, n_v = at.wi[:, 2], at.wo[:, 2]
    # Uniform lights and views by the cosine: means of n.l, n.v and of the square of l.v.
    l_v = np.sum(at.wi * at.wo, axis=-1)
    known = {1.0: np.ones_like(n_l), 0.5: n_l, 2.0 / 3.0: n_v, 1.0 / 3.0: l_v**2}
    for value, numbers in known.items():
        # What 18 nodes leave of a root at the horizon, seen against 27 nodes: 1e-12.
        assert at.weight @ numbers == pytest.approx(value, rel=1e-11)
    assert np.all(at.weight >= 0.0)
    assert np.allclose(at.wi + at.wo, at.h, rtol=0.0, atol=4 * EPS)
    assert np.allclose(np.linalg.norm(at.wi, axis=-1), 1.0, rtol=0.0, atol=4 * EPS)


ORIGINALS = ["phong:n=1000", "ward:m=0.05", "oren_nayar", "blinn:n=1e5", "max_phong:variant=retro"]


@pytest.mark.parametrize("spec", [*ORIGINALS, *(first for first, _ in PAIRS.values())])
def test_the_mean_radiance_is_the_average_albedo(spec: str) -> None:
    one = model(spec)
    found = radiance_change(one, one)
    average = albedo.average_albedo(one)
    slack = found.original.error + average.error / (2.0 * math.pi)
    assert abs(found.original.value - average.value / (2.0 * math.pi)) <= slack
    assert found.original.error <= 2e-3 * found.original.value
    energy = albedo_change(one, one)
    assert abs(energy.original.value - average.value) <= energy.original.error + average.error


@pytest.mark.parametrize("name", PAIRS)
def test_means_are_those_of_random_directions(name: str, rng: np.random.Generator) -> None:
    first, second = (model(spec) for spec in PAIRS[name])
    found = radiance_change(first, second)
    wi, wo = directions(DRAWS, False, rng), directions(DRAWS, True, rng)
    f, g = first.eval(wi, wo), second.eval(wi, wo)
    assert is_mean(found.absolute, np.abs(g - f) * wi[:, 2])
    assert is_mean(found.signed, (g - f) * wi[:, 2])
    assert is_mean(found.original, f * wi[:, 2])
    if name in ("no Fresnel factor", "Schlick's factor", "another diffuse"):
        # The others have relative changes that no finite number of draws has the mean of.
        # Where a tail is below the range of numbers, nothing changes.
        assert is_mean(found.relative, np.abs(g - f) / np.where(f > 0.0, f, 1.0))
    mean = found.absolute.value / found.original.value
    assert found.share.value == pytest.approx(mean, rel=8 * EPS)


@pytest.mark.parametrize("name", PAIRS)
def test_largest_changes_are_those_of_another_search(name: str, rng: np.random.Generator) -> None:
    first, second = (model(spec) for spec in PAIRS[name])
    low = 0.02
    found = radiance_change(first, second, lowest=low)

    def places(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Cosines of both, and their azimuths, from (4, n)."""
        made = []
        for z, phi in ((x[0], x[1]), (x[2], x[3])):
            s = np.sqrt(np.maximum((1.0 - z) * (1.0 + z), 0.0))
            made.append(np.stack((s * np.cos(phi), s * np.sin(phi), z), axis=-1))
        return made[0], made[1]

    for worst, relative in ((found.worst, False), (found.worst_relative, True)):

        def loss(x: np.ndarray, relative: bool = relative) -> np.ndarray:
            wi, wo = places(x)
            f, g = first.eval(wi, wo), second.eval(wi, wo)
            with np.errstate(divide="ignore", invalid="ignore"):
                change = np.abs(g - f) / f if relative else np.abs(g - f) * wi[..., 2]
            nothing = np.isnan(change) | (np.maximum(f, g) < scale_down.LEAST)
            return -np.where(nothing, 0.0, change)

        if math.isinf(worst.value):
            # The search for a change of everything from nothing has nothing to climb.
            assert loss(np.array([*_angles(worst.wi), *_angles(worst.wo)])[:, None])[0] == -math.inf
            continue
        turn = (0.0, 2.0 * math.pi)
        other = differential_evolution(
            loss,
            [(low, 1.0), turn, (low, 1.0), turn],
            rng=rng,
            vectorized=True,
            updating="deferred",
            popsize=24,
            maxiter=400,
            tol=1e-10,
            polish=False,
        )
        assert -other.fun <= worst.value + worst.error + 1e-9 * worst.value
        # Where evolution ends on the same hill, its population spreads by its tolerance.
        assert -other.fun >= worst.value * (1.0 - 1e-4) - worst.error
        here = float(loss(np.array([*_angles(worst.wi), *_angles(worst.wo)])[:, None])[0])
        # Raw directions, at cosines of 0.02 and beyond.
        assert -here == pytest.approx(worst.value, rel=1e-9)


def _angles(v: Any) -> tuple[float, float]:
    return float(v[2]), math.atan2(v[1], v[0])


def test_dropping_1_over_v_h_leaves_the_ratio_v_h() -> None:
    """Without a diffuse term: the mean of 1 - v.h, and 1 at grazing incidence."""
    values = {"smoothness": 0.6, "k_d": 0.0, "metalness": 0.7, "color": 0.3}
    whole, simpler = (albedo.model("schwenk", level=level, **values) for level in ("1", "2"))
    found = radiance_change(whole, simpler)
    # Of the mean of v.h over uniform lights and views by the cosine, the angle between the two is
    # left: (1 + l.v)/2 = (v.h)^2. For a light at c, by the views' azimuth and cosine:

    def ring(c: float, v: float) -> float:
        s = math.sqrt((1.0 - c * c) * (1.0 - v * v))
        inner, _ = quad(lambda p: math.sqrt(0.5 * (1.0 + c * v + s * math.cos(p))), 0.0, math.pi)
        return inner / math.pi

    def light(c: float) -> float:
        return quad(lambda v: ring(c, v) * 2.0 * v, 0.0, 1.0, epsabs=1e-9)[0]

    mean, _ = quad(light, 0.0, 1.0, epsabs=1e-8)
    # What the outer integral is asked for, ten times.
    assert abs(found.relative.value - (1.0 - mean)) <= found.relative.error + 1e-7
    worst = found.worst_relative
    assert abs(worst.value - (1.0 - scale_down.LOWEST)) <= worst.error <= 1e-8
    assert worst.cos_light == pytest.approx(scale_down.LOWEST, rel=1e-9)
    # At mirror directions k_s s^2 F0/pi n.l/(v.h) (1 - v.h) is s^2 F0 (1 - n.l)/pi.
    peak = 0.36 / math.pi
    assert found.worst.value >= peak * (1.0 - scale_down.LOWEST) - found.worst.error


def test_dropping_fresnel_has_closed_forms() -> None:
    """Without a diffuse term f/g = 1 + (1 - F0)/F0 (1 - v.h)^5, at most with v.h = lowest."""
    blue = {"color": (0.0, 0.5, 1.0), "metalness": 1.0, "smoothness": 0.9, "k_d": 0.0}
    for channel in (1, 2):
        whole, simpler = (
            albedo.model("schwenk", level=level, **blue).channel(channel) for level in ("0", "1")
        )
        f0 = blue["color"][channel] / (0.7152 * 0.5 + 0.0722 * 1.0)
        low = 0.01
        found = radiance_change(whole, simpler, lowest=low).worst_relative
        ratio = 1.0 + (1.0 - f0) / f0 * (1.0 - low) ** 5
        assert abs(found.value - abs(1.0 / ratio - 1.0)) <= found.error + 16 * EPS * found.value
        assert found.error <= 1e-6


def test_dropping_the_highlight_loses_it_all() -> None:
    """At normal incidence s^2 F0/pi; what is left is Lambert's law."""
    values = {"color": 0.4, "metalness": 0.5, "smoothness": 0.7}
    whole, simpler = (albedo.model("schwenk", level=level, **values) for level in ("3", "4"))
    found = radiance_change(whole, simpler)
    f0 = 0.5 + 0.5 * 0.4
    assert abs(found.worst.value - 0.49 * f0 / math.pi) <= found.worst.error <= 1e-9
    assert found.worst.cos_light == found.worst.cos_view == 1.0
    exact = 0.49 * f0 / (0.49 * f0 + 0.4)
    assert abs(found.worst_relative.value - exact) <= found.worst_relative.error <= 1e-9
    lambert = albedo.model("lambert", rho=0.4)
    for measure in (radiance_change, albedo_change):
        first, second = measure(whole, simpler), measure(whole, lambert)
        for name in ("absolute", "relative", "share", "worst"):
            one, other = getattr(first, name), getattr(second, name)
            assert abs(one.value - other.value) <= one.error + other.error


@pytest.mark.parametrize("steps", [(0, 1), (1, 2), (2, 3), (3, 4), (0, 4)])
@pytest.mark.parametrize("s", [0.2, 0.8, 1.0])
def test_steps_by_raw_formula(steps: tuple[int, int], s: float, rng: np.random.Generator) -> None:
    """Schwenk's eqs. 50 to 53 once more, in raw cosines and at random directions."""
    gold, m = (1.0, 0.77, 0.34), 0.8
    luminance = 0.2126 * gold[0] + 0.7152 * gold[1] + 0.0722 * gold[2]
    wi, wo = directions(DRAWS, False, rng), directions(DRAWS, True, rng)
    h = wi + wo
    h /= np.linalg.norm(h, axis=-1, keepdims=True)
    v_h = np.sum(wo * h, axis=-1)

    def values(level: int, c: float) -> np.ndarray:
        f0 = 1.0 - m + m * (c if level > 2 else c / luminance)
        factor = f0 + (1.0 - f0) * (1.0 - v_h) ** 5 if level < 1 else f0
        factor = factor / v_h if level < 2 else factor
        highlight = s * s * factor * h[:, 2] ** (2.0 / (1.0 + 1.0 / 255.0 - s))
        return (c + (highlight if level < 4 else 0.0)) / math.pi

    for channel in (0, 2):
        pair = [
            albedo.model("schwenk", color=gold, metalness=m, smoothness=s, level=level)
            for level in steps
        ]
        found = radiance_change(*(one.channel(channel) for one in pair))
        f, g = (values(level, gold[channel]) for level in steps)
        assert is_mean(found.relative, np.abs(g / f - 1.0))
        assert is_mean(found.absolute, np.abs(g - f) * wi[:, 2])
        # Nothing that was drawn may exceed the largest.
        drawn = np.where((wi[:, 2] > 1e-6) & (wo[:, 2] > 1e-6), np.abs(g / f - 1.0), 0.0)
        assert drawn.max() <= found.worst_relative.value + found.worst_relative.error + 64 * EPS


@pytest.mark.parametrize("steps", [(1, 2), (2, 3), (3, 4)])
def test_shares_of_radiance_and_albedo_are_one(steps: tuple[int, int]) -> None:
    """Where a step takes light away everywhere, both are what the average albedo loses."""
    values = {"color": 0.4, "metalness": 0.8, "smoothness": 0.95}
    first, second = (albedo.model("schwenk", level=str(k), **values) for k in steps)
    light, energy = radiance_change(first, second), albedo_change(first, second)
    before, after = albedo.average_albedo(first), albedo.average_albedo(second)
    lost = 1.0 - float(after.value) / float(before.value)
    slack = float(before.error + after.error) / float(before.value)
    for found in (light, energy):
        assert abs(found.share.value - lost) <= found.share.error + slack
        assert found.signed.value == pytest.approx(-found.absolute.value, rel=1e-12)


def test_largest_change_of_an_albedo_is_on_a_fine_curve() -> None:
    first, second = model("blinn:n=40"), model("phong:n=10")
    found = albedo_change(first, second)
    c = np.linspace(1e-3, 1.0, 400)
    a, b = (albedo.directional_albedo(one, c).value for one in (first, second))
    for worst, curve in (
        (found.worst, np.abs(b - a)),
        (found.worst_relative, np.abs(b - a) / a),
    ):
        k = int(curve.argmax())
        assert curve[k] <= worst.value + worst.error
        # Between points of the curve a maximum is missed by the square of their distance.
        inside = c[k] > c[0]
        assert not inside or worst.value - worst.error <= curve[k] * (1.0 + 1e-4)
        assert not inside or worst.cos_light == pytest.approx(c[k], abs=0.02)


def test_errors_of_numbers_in_a_model_are_in_the_error() -> None:
    """A coupled diffuse part is made of tabulated albedos, whose doubt is in every value."""
    coupled = albedo.couple(model("phong:n=20"), 0.5)
    found = radiance_change(coupled, model("phong:n=20 + 0.5*lambert"))
    pair = scale_down._Pair(coupled, coupled)
    assert pair.doubt > 0.0
    assert found.worst.error >= pair.doubt * found.worst.value
    assert found.absolute.error >= pair.doubt * found.original.value


def test_colours_are_measured_by_channel() -> None:
    color, grey = (
        albedo.model("schwenk", color=(0.2, 0.4, 0.8), level="4"),
        albedo.model("lambert", rho=0.1),
    )
    found = change_by_channel(color, grey)
    for (light, energy), known in zip(found, (0.5, 0.75, 0.875), strict=True):
        assert abs(light.relative.value - known) <= light.relative.error
        assert abs(energy.relative.value - known) <= energy.relative.error
    assert len(change_by_channel(grey, grey)) == 1
    with pytest.raises(InputError, match=r"3 channels and .* 2"):
        change_by_channel(color, albedo.couple(model("phong:n=20"), (0.1, 0.2)))


def test_bad_input_is_named() -> None:
    color, grey = albedo.model("schwenk", color=(0.2, 0.4, 0.8), level="4"), albedo.model("lambert")
    for measure in (radiance_change, albedo_change):
        with pytest.raises(InputError, match="3 channels"):
            measure(grey, color)
        for lowest in (0.0, 0.5, math.nan):
            with pytest.raises(InputError, match="lowest"):
                measure(grey, grey, lowest=lowest)
        with pytest.raises(InputError, match="rtol"):
            measure(grey, grey, rtol=2.0)
    with pytest.raises(InputError, match="broken is not finite at"):
        radiance_change(grey, Broken())


def test_rules_that_do_not_agree_say_so() -> None:
    """A step in the lobe that no panel ends at: the difference of the last two rules is kept."""
    cap = albedo.model_from(
        lambda wi, wo: np.where(wo[..., 2] > 0.7, 0.3, 0.1), lobe="diffuse", isotropic=True
    )
    found = radiance_change(model("lambert"), cap, rtol=1e-10)
    assert not found.agreed
    # |g - f| is 1/pi - 0.3 and 1/pi - 0.1; views above 0.7 are 0.51 of all by their cosine.
    exact = 0.5 * (0.51 * (1.0 / math.pi - 0.3) + 0.49 * (1.0 / math.pi - 0.1))
    assert abs(found.absolute.value - exact) <= found.absolute.error
    assert 1e-10 < found.absolute.error < 0.02 * exact


def test_the_page_shows_what_is_computed() -> None:
    page = Path(__file__).parent.parent / "docs" / "scale_down.md"
    failed, tried = doctest.testfile(str(page), module_relative=False)
    assert (failed, tried) == (0, 7)


@pytest.fixture(scope="module")
def study() -> ModuleType:
    StudyFile(STUDIES / "schwenk_scale_down.py").load()
    return sys.modules["albedo_study_schwenk_scale_down"]


@pytest.mark.parametrize("level", range(5))
def test_specialised_kernels_are_the_model(study: ModuleType, level: int) -> None:
    wi, wo, h = study.block()
    one = study.at_level(level, **study.LOBE).channel(study.LOBE_CHANNEL)
    out = np.empty((1, study.BLOCK))
    study.specialised(level)(wi, wo, h, np.array([one.pack()]), out)
    known = one.finite_part(
        np.tile(wi.T, (study.BLOCK, 1)),
        np.ascontiguousarray(wo[:, 0].T),
        np.ascontiguousarray(h[:, 0].T),
    )
    # The same operations, but for those of the diffuse term.
    np.testing.assert_allclose(out[0], known, rtol=8 * EPS)


def test_costs_are_measured_in_turn(study: ModuleType) -> None:
    costs = study.measured_costs(3, nullcontext)
    assert sorted(costs["level"]) == sorted(2 * [0, 1, 2, 3, 4])
    assert np.all((costs["ns_low"] > 0.0) & (costs["ns_low"] <= costs["ns"]))
    assert np.all(costs["ns"] <= costs["ns_high"])
    assert costs["saved_ns"].isna().sum() == 2


def test_a_median_is_no_better_known_than_the_worst_setting(study: ModuleType) -> None:
    changes = {
        "to_level": [1, 1, 1, 2],
        "x": [0.1, 0.3, 0.2, 9.0],
        "x_error": [1e-3, 2e-3, 0.0, 1.0],
    }
    frame = pd.DataFrame(changes)
    assert study.middle(frame, 1, "x") == (0.2, 2e-3)


def test_steps_that_change_nothing_are_counted(
    study: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The tables of two settings: what is no metal has no step 1 and no step 3."""
    from albedo.studies import Context

    monkeypatch.setattr(study, "QUICK_SMOOTHNESS", (0.5,))
    monkeypatch.setattr(study, "QUICK_COLORS", ("grey",))
    frame = study.changes(Context(study.STUDY, tmp_path, False))
    assert len(frame) == 2 * len(study.QUICK_PAIRS)
    assert frame["agreed"].all()
    summary = study.summarised(frame)
    counts = [study.of_pair(summary, k - 1, k)["nothing_at"] for k in study.STEPS]
    # Of grey plastic and grey metal; a constant F0 of 1 makes no Fresnel factor either.
    assert counts == [2, 0, 1, 0]
    # What is lost in a row is what is lost together, of light that only falls.
    signed = frame[frame["metalness"] == 1.0].set_index(["from_level", "to_level"])
    steps = sum(signed.loc[(k - 1, k), "albedo_signed"] for k in study.STEPS)
    slack = sum(signed.loc[(k - 1, k), "albedo_signed_error"] for k in study.STEPS)
    whole = signed.loc[(0, 4)]
    assert abs(steps - whole["albedo_signed"]) <= slack + whole["albedo_signed_error"]
