"""Formulas in other arithmetic, and the digits that are right."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import cases
import exact
import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

import albedo
from albedo._compile import is_kernel
from albedo.analysis import stability
from albedo.analysis.precise import evaluate, precise, single
from albedo.brdf import Model
from albedo.catalogue import names
from albedo.cli import app
from albedo.directions import half_vector, spherical
from albedo.errors import InputError
from albedo.grammar import ModelSpec, parse

EPS = float(np.finfo(float).eps)
ROOT = Path(__file__).parent.parent


def naive_ward(wi: np.ndarray, wo: np.ndarray, m: float) -> np.ndarray:
    """Ward's lobe with tan^2 of the half vector's angle as papers write it, from its cosine."""
    h = wi + wo
    n_h = h[..., 2] / np.sqrt((h * h).sum(-1))
    tangent2 = (1.0 - n_h * n_h) / (n_h * n_h)
    root = np.sqrt(wi[..., 2] * wo[..., 2])
    return np.exp(-tangent2 / (m * m)) / (4.0 * math.pi * m * m * root)


def stable_ward(wi: np.ndarray, wo: np.ndarray, m: float) -> np.ndarray:
    h = wi + wo
    tangent2 = (h[..., 0] ** 2 + h[..., 1] ** 2) / h[..., 2] ** 2
    root = np.sqrt(wi[..., 2] * wo[..., 2])
    return np.exp(-tangent2 / (m * m)) / (4.0 * math.pi * m * m * root)


def worst(frame: pd.DataFrame, way: str) -> float:
    return float(stability.worst(frame).set_index("way")["worst"][way])


def plain(model: Model) -> bool:
    """Whether all of a model is kernels of plain arithmetic."""
    return all(is_kernel(part.fill) for part in model.parts())


@pytest.mark.parametrize("model", [m for m in cases.EXTREME if plain(m)], ids=lambda m: m.spec)
def test_fifty_digits_of_a_kernel_agree_with_the_oracle(
    model: Model, rng: np.random.Generator
) -> None:
    """Two sources of one value: the kernel in 50 digits, and the definition in 40."""
    count = 1 if model.name in ("he_torrance", "lewis", "stam_gaussian") else 3
    wi = spherical(rng.uniform(0.2, 1.0, count), rng.uniform(-3.0, 3.0, count))
    width = min(1.0, min((min(p.widths) for p in model.parts()), default=1.0))
    wo = wi * np.array([-1.0, -1.0, 1.0]) + 0.5 * width * rng.normal(size=(count, 3))
    wo[:, 2] = np.maximum(np.abs(wo[:, 2]), 0.05)
    exactly = precise()
    light, view = (exactly.array(v) for v in (wi, wo))
    for v in (light, view):
        for k in range(count):
            v[k] = v[k] / exactly.functions["sqrt"](sum(x * x for x in v[k]))
    found = evaluate(model, exactly, light, view, light + view)
    doubts = (part.doubt for part in model.parts())
    doubt = max((float(d(None)) if callable(d) else d for d in doubts), default=0.0)
    for k in range(count):
        known = float(exact.brdf(model, wi[k], wo[k]))
        # Packed parameters and constants are in float64: an exponent of up to 40 amplifies them.
        slack = (64.0 * EPS + doubt) * exact.amplification(model)
        slack *= 1.0 + abs(math.log(known or 1.0))
        assert abs(float(found[k]) - known) <= slack * known + 1e-290


@pytest.mark.parametrize("name", names())
def test_single_precision_stays_single(name: str, rng: np.random.Generator) -> None:
    model = albedo.model(name).by_channel()[0]
    wi = spherical(rng.uniform(0.3, 1.0, 5), rng.uniform(-3.0, 3.0, 5))
    wo = spherical(rng.uniform(0.3, 1.0, 5), rng.uniform(-3.0, 3.0, 5))
    short = single()
    light, view, h = (short.array(v) for v in (wi, wo, half_vector(wi, wo)))
    found = evaluate(model, short, light, view, h)
    assert found.dtype == np.float32
    known = model.eval(wi, wo)
    seen = known > 1e-6 * max(known.max(), 1e-30)
    # 24 bits, of which a lobe's exponent of up to 14 and some dozen operations take a few.
    np.testing.assert_allclose(found[seen], known[seen], rtol=500.0 * 2.0**-24)


def test_digits_are_counted() -> None:
    number = precise().number
    true = [number(1.0), number(1.0), number(2.0), number(0.0), number(1e-310), number(3.0)]
    got = np.array([1.0, 1.0 + 1e-6, math.nan, 0.0, 0.0, -3.0])
    found = stability.digits(got, np.array(true, object), "float64")
    assert found[0] == pytest.approx(15.95, abs=0.01)
    assert found[1] == pytest.approx(6.0, abs=1e-6)
    assert found[2] == 0.0
    assert np.isnan(found[3:5]).all()
    assert found[5] == 0.0
    # What should be 0 and is not has no right digit.
    assert stability.digits(np.array([1e-3]), np.array([number(0.0)], object), "float64")[0] == 0.0
    # Above what float32 has, there is nothing to count.
    assert np.isnan(stability.digits(np.array([math.inf]), np.array([number(1e39)]), "float32")[0])


def test_a_naive_formula_loses_the_digits_that_it_should() -> None:
    """1 - (n.h)^2 of a lobe of width m has a rounding of 1e-16 in m^2."""
    m = 1e-5
    hints: dict[str, Any] = {"lobe": "half", "width": m}
    naive = albedo.model_from(lambda wi, wo: naive_ward(wi, wo, m), **hints)
    stable = albedo.model_from(lambda wi, wo: stable_ward(wi, wo, m), **hints)
    cosines = (0.9, 0.5)
    frames = [stability.measure([({}, one)], cosines=cosines) for one in (naive, stable)]
    lost = [worst(frame, "raw") for frame in frames]
    # eps/m^2 is 2e-6, times exponents of up to 6; slopes lose eps/m.
    assert 3.5 < lost[0] < 7.0
    assert lost[1] > 9.0
    assert worst(frames[0], "float32") == 0.0
    own = stability.measure([({}, albedo.model("ward", m=m))], cosines=cosines)
    assert worst(own, "float64") > 14.0


def test_special_places_are_where_they_say() -> None:
    found = stability.exact_places(precise(), 0.3, 0.7, (0.01, 0.02))
    wi, wo, h = (v.astype(float) for v in (found.wi, found.wo, found.h))
    np.testing.assert_allclose(np.linalg.norm(wi, axis=1), 1.0, atol=4 * EPS)
    np.testing.assert_allclose(np.linalg.norm(wo, axis=1), 1.0, atol=4 * EPS)
    place = found.places.index
    mirror = wi[0] * np.array([-1.0, -1.0, 1.0])
    np.testing.assert_allclose(wo[place("mirror")], mirror, atol=4 * EPS)
    np.testing.assert_array_equal(wo[place("retro")], wi[0])
    np.testing.assert_array_equal(wo[place("normal")], [0.0, 0.0, 1.0])
    beside = h[place("H at (0, 0.5) widths")]
    across = np.array([-math.sin(0.7), math.cos(0.7)])
    np.testing.assert_allclose(beside[:2] / beside[2], 0.01 * across, atol=1e-15)


def test_sweeps_are_thinned_to_their_ends() -> None:
    spec = stability.swept("ward")
    (values,) = spec.sweep.values()
    assert len(values) == stability.SETS[0]
    assert (values[0], values[-1]) == (1e-8, 10.0)
    two = stability.swept("he_torrance")
    assert [len(v) for v in two.sweep.values()] == [stability.SETS[1]] * 2
    assert stability.swept("ward:m=0.1") == ModelSpec("ward", {"m": 0.1})


def test_what_is_not_finite_is_counted() -> None:
    def broken(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        # A difference of equals in the denominator: float64 divides by 0 at V = L, 50 digits too.
        return 1.0 / (wi[..., 2] + wo[..., 2] - 2.0 * wi[..., 2] + 1e-20)

    frame = stability.measure([({}, albedo.model_from(broken))], cosines=(0.7,))
    row = frame[frame["place"] == "retro"].iloc[0]
    # At 0.7 + 0.7 - 1.4 + 1e-20 both are 1e20; elsewhere 1e-20 is lost, which costs nothing.
    assert row["float64"] > 15.0
    assert stability.not_finite(frame) == {}
    # r = 1e-20 vanishes beside 1, in 1 + r t^2 - t^2 of Schlick's lobe at t = 1.
    steep = albedo.model_from(lambda wi, wo: 1e-20 / (1.0 + 1e-20 * wo[..., 2] - wo[..., 2]) ** 2)
    frame = stability.measure([({}, steep)], cosines=(0.7,))
    # Once for each azimuth.
    assert stability.not_finite(frame) == {"float64": 3, "raw": 3, "float32": 3}
    assert frame[frame["place"] == "normal"].iloc[0]["raw"] == 0.0


def test_functions_that_object_arrays_lack_are_refused() -> None:
    from scipy.special import j0

    model = albedo.model_from(lambda wi, wo: j0(wi[..., 2] * wo[..., 2]))
    with pytest.raises(InputError, match="50 digits"):
        stability.measure([({}, model)], cosines=(0.5,))


GRATINGS = [
    "stam_grating:coherence=3",
    "stam_grating:coherence=0.3,profile=lamellar,duty=0.3,fresnel=dielectric",
    "stam_grating:coherence=200,depth=0.6,period=4.1,fresnel=schlick,f0=0",
    "stam_grating:coherence=0.1,period=100",
]


@pytest.mark.parametrize("spec", GRATINGS)
def test_a_formula_stands_for_values_of_numpy(spec: str) -> None:
    """Bessel functions are in no kernel; the same sum is written once more for other numbers."""
    frame = stability.measure([({}, parse(spec).model())], cosines=(1.0, 0.3, 1e-3, 1e-9))
    assert not frame[["float64_not_finite", "raw_not_finite", "float32_not_finite"]].any(axis=None)
    assert frame["float64"].median() > 14.5
    # Exponents of up to 690 have an error of as many roundings, and their arguments have some.
    assert frame["float64"].min() > 11.5
    assert frame["float32"].median() > 6.0


def test_a_model_of_dirac_parts_is_looked_at_with_lobes() -> None:
    spec = stability.swept("stam_grating")
    assert list(spec.sweep) == ["coherence"]
    for name in albedo.models():
        assert stability.named_models(stability.swept(name))[0][1].parts()
    assert stability.swept("stam_grating:depth=0.2") == ModelSpec("stam_grating", {"depth": 0.2})


@pytest.mark.parametrize("spec", ["lewis:reading=per_incidence"])
def test_what_is_no_kernel_of_plain_arithmetic_is_refused(spec: str) -> None:
    """A curve in a kernel."""
    model = parse(spec).model()
    assert not plain(model)
    with pytest.raises(InputError, match="plain arithmetic"):
        stability.measure([({}, model)], cosines=(0.5,))


def test_what_is_all_dirac_parts_is_refused() -> None:
    with pytest.raises(InputError, match="Dirac"):
        stability.measure([({}, albedo.model("stam_grating"))], cosines=(0.5,))


def test_pumped_models_are_refused() -> None:
    model = albedo.pump(albedo.model("lambert"), 1)
    with pytest.raises(InputError, match=r"plain arithmetic|values of its own"):
        stability.measure([({}, model)], cosines=(0.5,))


def test_the_command_counts_plots_and_writes(tmp_path: Path) -> None:
    csv, png = tmp_path / "ward.csv", tmp_path / "ward.png"
    line = ["stability", "ward:m=[1e-8,0.1]", "-o", str(csv), "--plot", str(png)]
    done = CliRunner().invoke(app, line, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    assert "float32: median" in done.output
    frame = pd.read_csv(csv)
    assert set(frame["m"]) == {1e-8, 0.1}
    assert frame["cos_theta"].min() == min(stability.COSINES)
    assert png.stat().st_size > 10_000


def test_the_command_counts_digits_of_a_function(tmp_path: Path) -> None:
    file = tmp_path / "my_brdf.py"
    file.write_text("def dusty(wi, wo):\n    return 0.25 + 0.0 * wo[..., 2]\n")
    done = CliRunner().invoke(app, ["stability", f"{file}:dusty"], catch_exceptions=False)
    assert done.exit_code == 0
    assert "fewest 16.0" in done.output


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (["nope"], "unknown model"),
        (["phong + lambert"], "sum"),
        (["ward:m=-1"], "m = -1"),
        (["ward", "-o", "x.txt"], "x.txt"),
        (["ward", "--plot", "x.txt"], "x.txt"),
        (["granier_heidrich", "--plot", "x.png"], "one swept number"),
        (["ward:m=0.1", "--plot", "x.png"], "one swept number"),
        (["ward", "--width", "0.1"], "--width"),
        (["no.py:f"], "no.py"),
    ],
)
def test_mistakes_are_named(line: list[str], said: str) -> None:
    done = CliRunner().invoke(app, ["stability", *line])
    assert done.exit_code != 0
    assert said in str(done.exception) or said in done.output


@pytest.mark.parametrize("spec", ["he_torrance:sigma0=0.01,tau=8.9", "stam_gaussian:sigma=1"])
def test_series_end_in_every_arithmetic(spec: str) -> None:
    """In float32 the constant 1e-300, below which a series ends, is 0."""
    frame = stability.measure([({}, parse(spec).model())], cosines=(0.7, 1e-3))
    assert stability.not_finite(frame) == {}
    assert frame["float64"].min() > 12.0


@pytest.mark.parametrize("text", ["0", "1e-330", "1e-9", "20.5", "100.25", "1234.5"])
def test_bessel_functions_of_fifty_digits(text: str) -> None:
    """By recurrence from z = 20 on, against mpmath's series with more digits.

    One argument is below all numbers of float64.
    """
    bessel_j, number = precise().functions["bessel_j"], precise().number
    with exact.mp.workdps(70):
        z = exact.mp.mpf(text)
        for order in (0, 1, -3, int(0.6 * z), -int(z), int(1.2 * z) + 5, int(3.0 * z) + 40):
            known = exact.mp.besselj(order, z)
            found = exact.mp.mpf(bessel_j(number(order), number(text))._mpf_)
            # The last of fifty digits is rounded, of the recurrence and of its norm.
            assert abs(found - known) <= exact.mp.mpf(10) ** -49 * abs(known)
