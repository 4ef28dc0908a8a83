"""The promise: the true error is below the bound, at every tolerance and every budget.

The references are those of ``golden/albedo.csv`` (see ``golden/README.md``), made with mpmath in
coordinates of their own.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from decimal import Decimal
from functools import cache
from pathlib import Path

import exact
import numpy as np
import pytest
from cases import anywhere

import albedo
from albedo.brdf import Model, Real
from albedo.charts.polar import PolarChart
from albedo.charts.tail_rings import TailRingsChart
from albedo.grammar import parse
from albedo.integrators import cells, rules

GOLDEN = Path(__file__).parent / "golden" / "albedo.csv"


@dataclass(frozen=True)
class Case:
    """A reference value."""

    model: Model
    cos_theta: float
    phi: float
    value: Decimal

    @property
    def scale(self) -> float:
        return abs(float(self.value))


@cache
def cases() -> tuple[Case, ...]:
    with GOLDEN.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    models = {row["model"]: parse(row["model"]).model() for row in rows}
    return tuple(
        Case(models[r["model"]], float(r["cos_theta"]), float(r["phi"]), Decimal(r["value"]))
        for r in rows
    )


@dataclass(frozen=True)
class Outcome:
    """What became of a case."""

    case: Case
    error: float
    bound: float
    evaluations: int
    converged: bool

    @property
    def covered(self) -> bool:
        # The references show 14 digits and more by two rules; half a unit of the 15th is theirs.
        return self.error <= self.bound + 5e-16 * self.case.scale


def outcomes(rtol: float, budget: int | None, every: int = 1) -> Iterator[Outcome]:
    for case in cases()[::every]:
        found = albedo.directional_albedo(
            case.model, case.cos_theta, case.phi, rtol=rtol, max_evaluations=budget
        )
        error = abs(float(Decimal(float(found.value)) - case.value))
        yield Outcome(
            *(case, error, float(found.error)), int(found.evaluations), bool(found.converged)
        )


def describe(found: list[Outcome]) -> str:
    return "\n".join(
        f"{o.case.model.spec} cos={o.case.cos_theta:g} phi={o.case.phi:g} "
        f"error {o.error:.3g} bound {o.bound:.3g}"
        for o in found[:8]
    )


def test_there_are_references_for_every_model() -> None:
    """A model without golden albedos names the file that checks its albedo independently."""
    assert len(cases()) >= 500
    golden = {case.model.name for case in cases()}
    assert golden <= set(albedo.models())
    for name in albedo.models().keys() - golden:
        checked_by = getattr(exact.oracle(name), "CHECKED_BY", None)
        assert checked_by is not None, f"{name}: no golden albedos, and no CHECKED_BY in its oracle"
        text = (Path(__file__).parent / checked_by).read_text(encoding="utf-8")
        assert f'"{name}"' in text, f"{checked_by} does not check {name}"


@pytest.mark.parametrize("rtol", [1e-3, 1e-8, 1e-12])
def test_the_tolerance_is_met_and_the_bound_covers(rtol: float) -> None:
    found = list(outcomes(rtol, None))
    dishonest = [o for o in found if not o.covered]
    assert not dishonest, describe(dishonest)
    assert all(o.converged for o in found), describe([o for o in found if not o.converged])


@pytest.mark.slow
@pytest.mark.parametrize("rtol", [1e-4, 1e-5, 1e-6, 1e-7, 1e-9, 1e-10, 1e-11])
def test_the_bound_covers_at_every_tolerance(rtol: float) -> None:
    dishonest = [o for o in outcomes(rtol, None) if not o.covered]
    assert not dishonest, describe(dishonest)


@pytest.mark.filterwarnings("ignore::albedo.ConvergenceWarning")
def test_small_budgets_still_have_honest_bounds_that_are_not_idle() -> None:
    ratios, broad = [], []
    for budget in (64, 256, 1024):
        found = list(outcomes(1e-8, budget))
        dishonest = [o for o in found if not o.covered]
        assert not dishonest, describe(dishonest)
        assert max(o.evaluations for o in found) <= budget + 64
        for o in found:
            if o.error > 1e-13 * o.case.scale:
                (ratios if has_lobe(o.case.model) else broad).append(o.bound / o.error)
    assert len(ratios) > 2000
    # Measured: 1.1e4, 5.0e3 and 1.7e4 for the three budgets, 8.8e3 over all.
    assert np.median(ratios) <= 1e4
    # Without a lobe errors fall far below what a spectrum can promise: 7.0e4, 1.8e4 and 8.2e5.
    assert np.median(broad) <= 1e6


def has_lobe(model: Model) -> bool:
    """Whether some part is concentrated: the bounds of the others are idler."""
    return any(isinstance(part.chart, PolarChart | TailRingsChart) for part in model.parts())


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::albedo.ConvergenceWarning")
@pytest.mark.parametrize("budget", [96, 128, 512, 1500, 2048, 3000, 4096])
def test_every_budget_has_an_honest_bound(budget: int) -> None:
    dishonest = [o for o in outcomes(1e-8, budget) if not o.covered]
    assert not dishonest, describe(dishonest)


def test_the_cost_does_not_grow_with_sharpness() -> None:
    spent = [(o.case.model.isotropic, o.evaluations) for o in outcomes(1e-8, None)]
    isotropic = [n for flat, n in spent if flat]
    anisotropic = [n for flat, n in spent if not flat]
    # Measured over all references: medians 4016 and 15112, largest 17784 and 64484.
    assert np.median(isotropic) <= 4096
    assert np.median(anisotropic) <= 4 * 4096
    assert max(isotropic) <= 20_000
    assert max(anisotropic) <= 80_000


def random_model(rng: np.random.Generator) -> Model:
    """A model anywhere in the range of its parameters, often far from isotropic."""

    def decades(low: float, high: float) -> float:
        return float(10.0 ** rng.uniform(np.log10(low), np.log10(high)))

    def one(*words: str) -> str:
        return words[int(rng.integers(len(words)))]

    n = decades(0.05, 20.0) if rng.random() < 0.5 else decades(1.0, 1e8)
    m, wide = decades(1e-6, 1.0), decades(1e-3, 1.0)
    axes = {"alpha_x": wide, "alpha_y": min(max(wide * decades(1e-2, 1e2), 1e-4), 1.0)}
    exponents = {"n_u": decades(0.5, 1e4), "n_v": decades(0.5, 1e4)}
    masking = one("v_cavity", "smith", "smith_correlated", "none")
    kind = one("beckmann", "ggx")
    choices: list[tuple[str, dict[str, object]]] = [
        ("phong_original", {"n": n}),
        ("phong", {"n": n}),
        ("max_phong", {"n": n, "c": one("paper", "safe"), "variant": one("mirror", "retro")}),
        ("max_phong_anisotropic", exponents),
        ("blinn_original", {"n": n}),
        ("blinn", {"n": n}),
        ("cook_torrance", {"m": m, "distribution": kind, "geometry": masking}),
        ("cook_torrance", {"m": m, "distribution": "gaussian", "geometry": masking}),
        ("cook_torrance", {**axes, "distribution": kind, "geometry": masking}),
        ("ward", {"m": m, "form": one("exact", "fast")}),
        ("ward", {**axes, "form": one("exact", "fast")}),
        ("ward_bounded", axes),
        ("ward_duer", axes),
        ("ashikhmin_shirley", exponents),
        ("he_torrance", {"sigma0": decades(0.01, 0.5), "tau": decades(0.5, 5.0)}),
    ]
    name, parameters = choices[int(rng.integers(len(choices)))]
    return albedo.model(name, **parameters)


def random_outcomes(seed: int, count: int, rtols: list[float], budgets: list[int]) -> None:
    """Random models and directions against 1e-13, whose own bound is granted."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        model = random_model(rng)
        c = float(10.0 ** rng.uniform(-9, 0) if rng.random() < 0.4 else rng.uniform(1e-3, 1.0))
        phi = 0.0 if model.isotropic else float(rng.choice([rng.uniform(0.0, 6.28), 0.0, 1.5708]))
        best = albedo.directional_albedo(model, c, phi, rtol=1e-13, max_evaluations=4_000_000)
        # What is granted must not excuse anything: all references are better than the tries.
        assert best.error <= 1e-11 * abs(best.value), (model.spec, c, phi)
        tries: list[dict[str, float]] = [{"rtol": rtol} for rtol in rtols]
        tries += [{"max_evaluations": budget} for budget in budgets]
        for options in tries:
            found = albedo.directional_albedo(model, c, phi, **options)
            error = abs(float(found.value - best.value))
            granted = float(found.error + best.error) + 5e-16 * abs(float(best.value))
            assert error <= granted, (model.spec, c, phi, options)


@pytest.mark.filterwarnings("ignore::albedo.ConvergenceWarning")
def test_random_models_have_honest_bounds() -> None:
    random_outcomes(1, 150, [1e-3, 1e-8], [64, 256, 1024, 4096])


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::albedo.ConvergenceWarning")
@pytest.mark.parametrize("seed", range(2, 10))
def test_many_random_models_have_honest_bounds(seed: int) -> None:
    rtols = [10.0**-k for k in range(3, 13)]
    random_outcomes(seed, 500, rtols, [64, 90, 128, 180, 256, 400, 512, 700, 1024, 2048, 4096])


def excesses_anywhere(
    kind: type[Model], rng: np.random.Generator, count: int, rows: int
) -> list[tuple[float, str]]:
    """Errors above bounds, in bounds: all over the ranges, against a fine tolerance."""
    excesses: list[tuple[float, str]] = []
    models = anywhere(kind, rng, count)
    assert len(models) == count or not any(
        isinstance(parameter, Real) for parameter in kind.parameter_info()
    )
    for model in models:
        c = np.where(rng.random(rows) < 0.6, rng.uniform(0.005, 1.0, rows), 0.0)
        c = np.where(c > 0.0, c, 10.0 ** rng.uniform(-7.0, 0.0, rows))
        phi = rng.uniform(0.0, 2.0 * np.pi, rows)
        best = albedo.directional_albedo(model, c, phi, rtol=1e-10)
        for rtol in (1e-2, 1e-3, 1e-5, 1e-7):
            found = albedo.directional_albedo(model, c, phi, rtol=rtol)
            off, bound = np.abs(found.value - best.value), found.error + best.error
            excesses += [
                (
                    float(off[k] / bound[k]),
                    f"{model.spec} rtol={rtol:g} cos={c[k]!r} phi={phi[k]!r}",
                )
                for k in np.flatnonzero(off > bound)
            ]
    return excesses


# Where bounds were too small, by up to 40 000 times: spikes and layers that few nodes did not see.
ONCE_HIDDEN = [
    ("ashikhmin_shirley:n_u=118.232,n_v=63724.2", 0.49230546, 4.98594047, 1e-6),
    (
        "ashikhmin_shirley:n_u=7.2146e-4,n_v=5.92675,r_s=0.35,r_d=0.12",
        4.5287966e-4,
        2.49026710,
        1e-7,
    ),
    ("distribution_brdf:alpha_y=7.46515533,fresnel=conductor", 1.73479041e-3, 6.08027148, 1e-7),
    ("he_torrance:sigma0=5e-4,mirror=off", 0.36524174, 0.0, 1e-7),
    ("he_torrance:sigma0=1e-4,mirror=off", 0.44317285, 0.0, 1e-7),
    ("max_phong_anisotropic:n_u=0.581168,n_v=506292.2", 0.99390192, 2.21810864, 1e-7),
    ("stam_gaussian:sigma=13.61484,t_x=0.7367197,t_y=211.87788", 8.3725553e-5, 3.20618492, 1e-5),
    ("stam_gaussian:sigma=0.8768473,t_x=0.0172898", 1.02166147e-6, 2.98156787, 1e-3),
    ("stam_gaussian:sigma=39.63469,t_x=1.7,t_y=0.0169191", 1.9368e-4, 1.68491632, 1e-3),
]


@pytest.mark.parametrize(("spec", "c", "phi", "rtol"), ONCE_HIDDEN)
def test_what_few_nodes_did_not_see_is_seen(spec: str, c: float, phi: float, rtol: float) -> None:
    model = parse(spec).model()
    # Next to the place too, where nodes fall otherwise.
    c_near, phi_near = c * np.linspace(0.98, 1.02, 9), phi + np.linspace(-0.01, 0.01, 9)
    c_near, phi_near = np.minimum(c_near, 1.0)[:, None], phi_near[None, :]
    best = albedo.directional_albedo(model, c_near, phi_near, rtol=1e-10)
    assert np.all(best.converged)
    for coarse in (rtol, 10.0 * rtol, 0.1 * rtol):
        found = albedo.directional_albedo(model, c_near, phi_near, rtol=coarse)
        off = np.abs(found.value - best.value)
        assert np.all(off <= found.error + best.error), np.max(off / found.error)


# The maps of Granier and Heidrich's layers have seconds to be made, and tests of their own.
@pytest.mark.filterwarnings("ignore::albedo.ConvergenceWarning")
@pytest.mark.parametrize("name", sorted(albedo.models().keys() - {"granier_heidrich"}))
def test_bounds_are_honest_all_over_the_ranges(name: str, rng: np.random.Generator) -> None:
    assert excesses_anywhere(albedo.models()[name], rng, 4, 40) == []


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::albedo.ConvergenceWarning")
@pytest.mark.parametrize("name", sorted(albedo.models().keys() - {"granier_heidrich"}))
def test_bounds_are_honest_all_over_the_ranges_many_times(
    name: str, rng: np.random.Generator
) -> None:
    # 1 of 10 000 spectra passes its bound, and here are 4800 albedos of each: what was hidden from
    # all nodes shows by more, or more often.
    excesses = excesses_anywhere(albedo.models()[name], rng, 20, 60)
    assert len(excesses) <= 1, excesses
    assert all(share < 2.0 for share, _ in excesses), excesses


def spoiled(p: int, seen_by_spectrum: bool) -> rules.Rule:
    """A rule with one weight off by one percent."""
    rule = rules.gauss(p)
    weights, to_coefficients = rule.weights.copy(), rule.to_coefficients.copy()
    weights[p // 3] *= 1.01
    if seen_by_spectrum:
        to_coefficients[p // 3] *= 1.01
    return rules.Rule(rule.nodes, weights, to_coefficients)


@pytest.mark.filterwarnings("ignore::albedo.ConvergenceWarning")
@pytest.mark.parametrize("seen", [True, False])
def test_a_sabotaged_rule_is_caught(monkeypatch: pytest.MonkeyPatch, seen: bool) -> None:
    """One weight wrong: either the spectrum shows it, or this very comparison does."""
    monkeypatch.setattr(cells, "gauss", lambda p: spoiled(p, seen))
    # The rules that kernels read are made anew, without the cache.
    monkeypatch.setattr(cells, "rules_by_order", cells.rules_by_order.__wrapped__)
    found = list(outcomes(1e-8, 20_000, every=40))
    caught = [o for o in found if not o.covered or not o.converged]
    assert len(caught) > 0.9 * len(found)
