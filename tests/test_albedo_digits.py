"""Digits of directional albedos, against golden values of every model and in float32."""

from __future__ import annotations

import csv
import math
import sys
from collections import Counter
from decimal import Decimal
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import exact
import numpy as np
import pytest

import albedo
from albedo.analysis import albedo_digits
from albedo.analysis.printed import FORMULAS
from albedo.brdf import Model
from albedo.catalogue import names
from albedo.errors import InputError
from albedo.grammar import parse
from albedo.quadrature import albedo_rows

GOLDEN = Path(__file__).parent / "golden"
EPS = float(np.finfo(float).eps)
SHORT = 2.0**-24
"""A rounding of float32."""


class Reference(NamedTuple):
    """A golden albedo."""

    spec: str
    model: Model
    cos_theta: float
    phi: float
    value: Decimal
    digits: int

    @property
    def slack(self) -> float:
        """How far it may be off itself."""
        return abs(float(self.value)) * 10.0**-self.digits


@cache
def references(file: str) -> tuple[Reference, ...]:
    with (GOLDEN / file).open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    models = {row["model"]: parse(row["model"]).model() for row in rows}
    return tuple(
        Reference(
            *(r["model"], models[r["model"]], float(r["cos_theta"]), float(r["phi"])),
            *(Decimal(r["value"]), int(r["digits"])),
        )
        for r in rows
    )


@cache
def maker() -> Any:
    """The script that makes ``albedos.csv``."""
    sys.path.insert(0, str(GOLDEN))
    try:
        return import_module("make_albedos")
    finally:
        sys.path.remove(str(GOLDEN))


# Golden values -----------------------------------------------------------------------------------


def test_models_have_a_dozen_golden_albedos() -> None:
    """Or none, and a file of tests that holds their albedo against something independent."""
    found = Counter(
        r.model.name for file in ("albedo.csv", "albedos.csv") for r in references(file)
    )
    assert set(found) <= set(names())
    assert len(found) >= 28
    assert min(found.values()) >= 12, found
    for name in set(names()) - set(found):
        assert hasattr(exact.oracle(name), "CHECKED_BY"), name


def test_golden_albedos_reach_from_the_normal_to_grazing_incidence() -> None:
    for name in {r.model.name for r in references("albedos.csv")}:
        own = [r for r in references("albedos.csv") if r.model.name == name]
        assert max(r.cos_theta for r in own) >= 0.7
        assert min(r.cos_theta for r in own) <= 1e-6
        assert min(r.digits for r in own) >= 13
        if not all(r.model.isotropic for r in own):
            assert any(r.phi != 0.0 for r in own if not r.model.isotropic)


def test_the_table_of_golden_albedos_is_complete() -> None:
    """What the script wants is there, and nothing else."""
    wanted = [maker().key(row) for row in maker().table()]
    assert len(set(wanted)) == len(wanted)
    with (GOLDEN / "albedos.csv").open(encoding="utf-8", newline="") as stream:
        rows = [(r["model"], r["cos_theta"], r["phi"]) for r in csv.DictReader(stream)]
    assert rows == wanted


@pytest.mark.parametrize("rtol", [1e-3, albedo_digits.DEFAULT, albedo_digits.FINE])
def test_albedos_agree_with_the_oracles_within_their_bounds(rtol: float) -> None:
    off = []
    for r in references("albedos.csv"):
        where = np.array([r.cos_theta]), np.array([r.phi])
        found = albedo_rows([r.model], *where, rtol=rtol, atol=0.0)
        error = abs(float(Decimal(float(found.value[0])) - r.value))
        if not error <= float(found.error[0]) + r.slack:
            off.append((r.spec, r.cos_theta, r.phi, error, float(found.error[0]), r.slack))
    assert not off


@pytest.mark.parametrize("name", ["lambert", "schlick", "schwenk", "stam_grating"])
def test_the_script_finds_its_values_again(name: str) -> None:
    """One row of a model at normal incidence, which takes a second."""
    script = maker()
    row = next(r for r in script.table() if r.model.startswith(name) and r.cos_theta == 1.0)
    ((_, text, digits),) = script.compute([row])
    known = next(r for r in references("albedos.csv") if (r.spec, r.cos_theta) == row[:2])
    assert Decimal(text) == known.value
    assert digits == known.digits


def test_the_script_integrates_over_a_kink_and_a_root() -> None:
    script = maker()
    mp = script.mp
    rule = script.gauss_legendre(script.RULES[0])
    with mp.workdps(rule.recipe.digits):
        third = mp.mpf(1) / 3
        kink = script.integrate(lambda x: abs(x - third), [mp.zero, mp.one], [], rule)
        root = script.integrate(mp.sqrt, [mp.zero, mp.one], [], rule)
        # Ten times the tolerance of the rule, as halved panels add up.
        assert abs(kink - mp.mpf(5) / 18) < 10 * rule.recipe.tolerance
        assert abs(root - mp.mpf(2) / 3) < 10 * rule.recipe.tolerance


def test_the_script_has_the_albedos_of_closed_forms() -> None:
    """A lobe about the normal, and the lobe about R that `exact` has as a product."""
    script = maker()
    rows = [script.Row("lafortune:lobes=((-1,-1,1,3))", c) for c in (1.0, 0.3)]
    upright, inclined = (Decimal(text) for _, text, _ in script.compute(rows))
    # 2 pi times the integral of c^4 dc; both in float64 here.
    assert abs(float(upright) - 2.0 * math.pi / 5.0) < 4 * EPS
    phong = exact.phong(3.0, 0.3) * 2.0 * math.pi / 5.0
    assert abs(float(inclined) - phong) < 4 * EPS


# Digits ------------------------------------------------------------------------------------------


def test_digits_are_those_that_are_right_at_least() -> None:
    right = albedo_digits.right_digits
    assert right(1.0, 1.0) == albedo_digits.FULL["default"]
    assert right(1.0 + 1e-6, Decimal(1)) == pytest.approx(6.0, abs=1e-6)
    # An error of the reference counts against the value.
    assert right(1.0, 1.0, error=1e-5) == pytest.approx(5.0)
    assert right(3.0, 1.0) == 0.0
    assert right(math.nan, 1.0) == 0.0
    assert math.isnan(right(0.0, 0.0))
    assert right(1.0, 1.0, full=7.0) == 7.0


@pytest.mark.parametrize(
    ("spec", "c", "phi"),
    [
        ("ward:alpha_x=0.1,alpha_y=0.4", 0.3, 0.6),
        ("cook_torrance:m=1e-6", 1e-3, 0.0),
        ("schwenk:smoothness=0.9", 0.5, 0.0),
        ("strauss", 0.7, 0.0),
    ],
)
@pytest.mark.parametrize("rtol", [1e-5, 1e-10])
def test_nodes_sum_up_to_the_albedo(spec: str, c: float, phi: float, rtol: float) -> None:
    model = parse(spec).model()
    known = albedo.directional_albedo(model, c, phi, rtol=1e-12)
    found = albedo_digits.single_albedo(model, c, phi, rtol=rtol)
    # The cells of every part meet half of their tolerance before rounding.
    assert abs(found.summed - known.value) <= rtol * known.value + known.error
    assert found.nodes == sum(
        n.weight.size for n in albedo_digits.nodes_of(model, c, phi, rtol=rtol)
    )


def test_parameters_are_rounded_by_themselves() -> None:
    """The albedo of Lambert's model is its parameter."""
    found = albedo_digits.single_albedo(albedo.model("lambert", rho=0.3), 0.7)
    rounded = float(np.float32(0.3))
    # A thousand weights, and sums of as many terms.
    assert found.parameters == pytest.approx(rounded, rel=100 * EPS)
    assert found.inputs == pytest.approx(rounded, rel=100 * EPS)
    assert found.summed == pytest.approx(0.3, rel=100 * EPS)
    # One more rounding of pi and one of the quotient.
    assert found.value == pytest.approx(rounded, rel=3 * SHORT)
    assert found.value != found.parameters


def test_float32_has_its_digits_and_no_more() -> None:
    models = [({"m": m}, albedo.model("ward", m=m)) for m in (0.3, 1e-6)]
    frame = albedo_digits.measure(models, cosines=(1.0, 0.1, 1e-3))
    assert len(frame) == 6
    assert frame["float32"].max() <= albedo_digits.FULL["float32"]
    # Values have 24 bits, an exponent of a few units and some dozen roundings, which average out.
    assert frame["float32"].min() > 6.0
    assert (frame["parameters"] < 4 * SHORT).all()
    assert (frame["fine"] >= 11.9).all()
    assert (frame["default"] >= 8.0).all()
    assert (frame["not_finite"] == 0).all()
    summary = albedo_digits.worst(frame).set_index("way")
    assert list(summary.index) == list(albedo_digits.WAYS)
    assert summary.loc["float32", "worst"] == frame["float32"].min()
    assert summary.loc["fine", "lost"] == albedo_digits.FULL["fine"] - frame["fine"].min()
    assert {"m", "cos_theta", "albedo", "albedo_error"} <= set(summary.columns)


def test_values_that_are_not_finite_in_float32_are_counted() -> None:
    # A peak of 1/(pi m^2) = 3e15 over 4 n.l n.v = 4e-24 and less is more than 3.4e38.
    model = albedo.model("cook_torrance", m=1e-8)
    (row,) = albedo_digits.measure([({}, model)], cosines=(1e-12,)).to_dict("records")
    assert row["not_finite"] >= row["beyond"] > 0
    assert row["float32"] == 0.0
    assert row["fine"] > 11.9


def test_an_albedo_of_nothing_has_no_digits() -> None:
    frame = albedo_digits.measure([({}, albedo.model("lambert", rho=0.0))], cosines=(0.5,))
    assert frame[list(albedo_digits.WAYS)].isna().all(axis=None)


@pytest.mark.parametrize(
    ("spec", "says"),
    [("stam_grating", "Dirac"), ("lewis:reading=per_incidence", "plain arithmetic")],
)
def test_what_has_no_values_in_float32_is_refused(spec: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        albedo_digits.measure([({}, parse(spec).model())], cosines=(0.5,))


# Lobes as printed --------------------------------------------------------------------------------


@pytest.mark.parametrize("label", FORMULAS)
def test_formulas_as_printed_are_the_models_where_lobes_are_wide(label: str) -> None:
    # A width that no six digits hold.
    frame = albedo_digits.printed_albedos(FORMULAS[label], 10.0**-0.3, 0.7).set_index(
        ["way", "form"]
    )
    for form in ("printed", "raw", "known"):
        row = frame.loc[("float64", form)]
        # Exponents of up to 40 amplify roundings by 1/m^2 of them.
        assert row["relative_error"] <= row["relative_error_error"] + 1000 * EPS
        assert row["not_finite"] == 0
        assert frame.loc[("float32", form)]["relative_error"] < 1000 * SHORT


@pytest.mark.parametrize("label", FORMULAS)
def test_formulas_as_printed_spoil_albedos(label: str) -> None:
    """A rounding of a cosine is m^2 times as large in units of the lobe."""
    m = 1e-3
    frame = albedo_digits.printed_albedos(FORMULAS[label], m, 0.5).set_index(["way", "form"])
    printed = frame.loc[("float32", "printed")]
    assert printed["relative_error"] > 1e-4 or printed["not_finite"] > 0
    assert frame.loc[("float32", "known")]["relative_error"] < 100 * SHORT
    assert frame.loc[("float64", "printed")]["relative_error"] < 1000 * EPS / m**2
    known = frame.loc[("float64", "known")]
    assert known["relative_error"] <= 1e-10 + known["albedo_error"] / known["albedo"]
    assert (frame["relative_error_error"] >= known["relative_error"]).all()


def test_a_sum_that_is_not_finite_has_no_value() -> None:
    """1 + r t^2 - t^2 is 0 at r = 1e-16."""
    frame = albedo_digits.printed_albedos(FORMULAS["Schlick's Z"], 1e-8, 0.5)
    row = frame.set_index(["way", "form"]).loc[("float64", "printed")]
    assert row["not_finite"] > 0
    assert math.isnan(row["value"])
    assert row["relative_error"] == math.inf
