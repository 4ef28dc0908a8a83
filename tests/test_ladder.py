"""The albedos of many steps: what rows that come late know, and what a ladder costs."""

from __future__ import annotations

import itertools
import tracemalloc
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from numpy.polynomial import Chebyshev, Polynomial

import albedo
from albedo.brdf import Part
from albedo.charts.heights import FIRST, LAST, LOWEST, folded, unfolded
from albedo.errors import InputError
from albedo.operators.divisor import CONTROLS, TERMS, LogCurve, placed
from albedo.operators.families import Families
from albedo.operators.ladder import (
    _COARSE,
    _DARK,
    _HIDDEN,
    _JOINED,
    _MANY,
    _SHARE,
    _WORN,
    Ladder,
    ladder,
)
from albedo.operators.nodes import LEBESGUE, TRUST, cosines
from albedo.operators.pieces import Piece
from albedo.operators.profiles import Profiles
from albedo.operators.pump import _GOAL, _LEFT, _OF_CURVES, Pumped
from albedo.quadrature import _MOST_SPENT

# Its albedos have several extrema inside, so that rings have many kinks.
SCALED = albedo.model("lafortune_scaled", n=20, s=0.95)
WIDE = np.geomspace(LOWEST, 1.0, 997)


def climbed(model: albedo.Model, steps: int, control: str | None = None) -> Ladder:
    found = Ladder(model, control, _OF_CURVES[0] * _GOAL)
    while len(found.curves) < steps:
        found.step()
    return found


@pytest.mark.parametrize("control", CONTROLS)
def test_rows_that_come_late_meet_all_steps_at_once(
    control: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They are cut once, and say what rows say that met the steps one by one."""
    found = climbed(SCALED, 4, control)
    for profiles in found._parts:
        found._meet(profiles, found._cos, found._met)
    found._met = 4
    known, error = found._values()
    rows = np.arange(0, found._cos.size, 7)
    cuts, real = [], Profiles.cut

    def counted(self: Profiles, *found: np.ndarray) -> np.ndarray:
        cuts.append(found[0].size)
        return real(self, *found)

    monkeypatch.setattr(Profiles, "cut", counted)
    (part,) = SCALED.parts()
    late = found._profile(part, found._cos[rows], np.zeros(rows.size, dtype=int))
    assert len(cuts) == 1
    found._cos, found._parts = found._cos[rows], [late]
    value, own = found._values()
    # A kink that was left in hides less than a thousandth of the tolerance; rows have a hundred.
    assert np.all(np.abs(value / known[rows] - 1.0) <= own + error[rows] + 0.1 * found.rtol)


@pytest.mark.parametrize("control", CONTROLS)
def test_runs_of_nodes_hold_all_that_is_sent_on(control: str | None) -> None:
    found = climbed(SCALED, 4, control)
    (profiles,) = found._parts
    value, _, _ = found._sums(profiles, found._cos)
    rows = np.arange(0, found._cos.size, 5)
    log_light = np.log(np.maximum(found._cos[rows], LOWEST))
    edges = found.curves[-1].edges
    runs = profiles.sent(CONTROLS.index(control), log_light, rows, edges)
    # Sums of some thousand positive terms in another order.
    np.testing.assert_allclose(runs.total, value[rows], rtol=1e-12)
    sums = np.bincount(runs.row, runs.share, rows.size)
    if control == "cumulative":
        # What is divided by a cosine passes no error of an albedo on.
        assert np.all(sums <= runs.total * (1.0 + 1e-12))
    else:
        np.testing.assert_allclose(sums, runs.total, rtol=1e-12)
    assert np.all((edges[runs.piece] <= runs.y) & (runs.y <= edges[runs.piece + 1]))


def test_a_kink_at_grazing_incidence_is_halved_towards_until_it_is_seen() -> None:
    """Broad lobes have panels from the horizon to the zenith: 1e-6 of one is twenty halvings."""
    found = climbed(albedo.model("phong", n=1), 3)
    # What was asked for; bounds may exceed it where noise does not let them fall.
    assert all(curve.bound.max() <= 2.0 * found.rtol for curve in found.curves)
    exact = Ladder(albedo.model("phong", n=1), None, 5e-12)
    while len(exact.curves) < 3:
        exact.step()
    y = folded(np.geomspace(LOWEST, 1.0, 301))
    for k, (curve, fine) in enumerate(zip(found.curves, exact.curves, strict=True)):
        bound = curve.bound[curve.piece(y)] + fine.bound[fine.piece(y)]
        bound += found.average(k, cosines(y)) + exact.average(k, cosines(y))
        assert np.all(np.abs(curve.at(y) - fine.at(y)) <= bound)


def test_the_doubt_of_a_divisor_is_that_of_the_worst_pair_of_heights() -> None:
    """The sum of moduli, pair by pair, without the kernel."""
    found = climbed(SCALED, 4)
    curves = found.curves[:4]
    # What extrema that were passed over may be is told by the largest error of a curve.
    new = np.concatenate([0.5 * curve.error.max() + curve.bound for curve in curves])
    edges = found._cells[3]
    worst = 0.0
    for light, view in itertools.product(0.5 * (edges[1:] + edges[:-1]), repeat=2):
        passed = np.zeros(new.size)
        for curve, cells, transfer in zip(curves, found._cells, found._transfer, strict=False):
            (at_l,), (at_v,) = curve.at(np.array([light])), curve.at(np.array([view]))
            cell = np.searchsorted(cells, light if at_l >= at_v else view) - 1
            passed[: transfer.shape[1]] += transfer[cell]
        worst = max(worst, float(np.abs(passed) @ new))
    expected = 2.0 * worst + found.divisor(4).left_out
    # Sums of some hundred terms in another order.
    assert found.doubt(4) == pytest.approx(expected, rel=1e-13)


class Wrong(Ladder):
    """Curves that are off by waves of one height, each with its own phase and sign, and say so."""

    def __init__(self, model: albedo.Model, control: str | None, rtol: float, wave: float) -> None:
        super().__init__(model, control, rtol)
        self.before: list[LogCurve] = []
        self.rng, self.wave = np.random.default_rng(5), wave

    def step(self) -> LogCurve:
        curve = super().step()
        self.before.append(curve)
        nodes = np.polynomial.chebyshev.chebpts1(TERMS)
        basis = np.polynomial.chebyshev.chebvander(nodes, TERMS - 1)
        shares = placed(0.5 * (nodes + 1.0), curve.bent[:, None])
        y = curve.edges[:-1, None] + shares * np.diff(curve.edges)[:, None]
        # Towards the horizon a wave of y itself would be one that no step passes on.
        off = np.cos(self.wave * y / (1.0 + 0.1 * np.abs(y)) + self.rng.uniform(0.0, 6.0))
        off *= OFF * self.rng.choice([-1.0, 1.0])
        # The series of a wave exceeds it by what it leaves out.
        wrong = replace(
            curve,
            coefficients=curve.coefficients + np.linalg.solve(basis, off.T).T,
            error=curve.error + 1.01 * OFF,
        )
        self.curves[-1] = wrong
        return wrong


# What curves are wrong by on purpose.
OFF = 1e-6


@pytest.mark.parametrize("wave", [0.0, 1.0, 8.0])
@pytest.mark.parametrize(
    ("spec", "control"),
    [
        ("phong:n=20", None),
        ("ward:m=0.4", "literal"),
        ("ward_duer:m=0.2", "cumulative"),
        ("cook_torrance:m=0.4", None),
    ],
)
def test_errors_of_curves_are_passed_on_within_the_bound(
    spec: str, control: str | None, wave: float
) -> None:
    """An albedo errs by an average of what all curves before do, with the signs that they have."""
    model = next(albedo.grammar.parse(spec).models())
    exact = Ladder(model, control, 0.03 * OFF)
    found = Wrong(model, control, 0.03 * OFF, wave)
    while len(found.curves) < 6:
        found.step()
        exact.step()
    y = np.linspace(FIRST, LAST, 4001)
    seen = []
    for k, (curve, right) in enumerate(zip(found.before, exact.curves, strict=True)):
        passed = found.average(k, cosines(y))
        own = curve.bound[curve.piece(y)] + right.bound[right.piece(y)]
        own += exact.average(k, cosines(y))
        off = np.abs(curve.at(y) - right.at(y))
        assert np.all(off <= passed + own)
        if k:
            # It is no more than for the worst pair of heights, but for the squares of errors, and
            # for a few roundings: shares of the light sum to 1 within two or three.
            worst = found.doubt(k) + k * found.doubt(k) ** 2
            assert passed.max() <= worst * (1.0 + 16 * np.finfo(float).eps)
            seen.append(float((np.maximum(off - own, 0.0) / passed).max()))
    # Twice, and half as much again for extrema that are passed over, of what a wave may do.
    assert 0.2 <= max(seen) <= 0.5


@pytest.mark.parametrize("wave", [0.0, 8.0])
def test_errors_are_passed_on_where_a_product_is_next_to_a_cosine(wave: float) -> None:
    """Phong's albedo is 1 at the normal, and so is the cosine: which is more is not known there."""
    exact = Ladder(albedo.model("phong", n=20), "cumulative", 0.03 * OFF)
    found = Wrong(exact.model, "cumulative", 0.03 * OFF, wave)
    while len(found.curves) < 8:
        found.step()
        exact.step()
    y = LAST - np.geomspace(1e-8, 1.0, 400)
    for k, (curve, right) in enumerate(zip(found.before, exact.curves, strict=True)):
        own = curve.bound[curve.piece(y)] + right.bound[right.piece(y)]
        own += exact.average(k, cosines(y))
        off = np.abs(curve.at(y) - right.at(y))
        assert np.all(off <= found.average(k, cosines(y)) + own)


@pytest.mark.parametrize("wave", [0.0, 3.0])
@pytest.mark.parametrize(
    "model",
    [
        albedo.model("schlick", form="final", roughness=0.1),
        albedo.model("he_torrance", a_ud=0.2),
        albedo.model("lafortune", lobes=((-0.9, -0.9, 0.9, 20.0), (0.7, 0.7, 0.3, 4.0))),
    ],
    ids=str,
)
def test_parts_mirrors_and_sums_err_within_their_bounds(
    model: albedo.Model, wave: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Errors that parts and mirrors have in common are less in their sum than in each."""
    steps, c = 4, np.array([1.0, 0.7, 0.3, 0.05, 1e-3, 1e-7])
    right = albedo.directional_albedo(albedo.pump(model, steps), c)
    ladder = Wrong(model, None, 0.03 * OFF, wave)
    while len(ladder.curves) < steps:
        ladder.step()
    monkeypatch.setattr(Pumped, "_ladder", property(lambda self: ladder))
    wrong = albedo.pump(model, steps, rtol=1e-7)
    # What is asked for is less than the curves can give, so that their errors are most of all.
    with pytest.warns(albedo.ConvergenceWarning):
        found = albedo.directional_albedo(wrong, c, rtol=1e-7)
    lines = [(found, right)] + [(found.parts[k], right.parts[k]) for k in found.parts]
    assert len(lines) > 2
    for one, other in lines:
        assert np.all(np.abs(one.value - other.value) <= one.error + other.error)
    off = np.abs(found.value - right.value) / found.value
    assert np.all(off <= ladder.average(steps, c) + 1e-7)
    assert off.max() >= 0.1 * OFF
    # The sum is known better than the parts one by one, but where one of them is most of it.
    one_by_one = np.sum([part.error for part in found.parts.values()], axis=0)
    assert np.all(found.error <= one_by_one)
    assert np.any(found.error < 0.8 * one_by_one)


def in_quarters(curve: LogCurve) -> LogCurve:
    """The same curve, with four pieces in the place of each."""
    shares = np.arange(4) / 4.0
    low = curve.edges[:-1, None] + shares * np.diff(curve.edges)[:, None]
    edges = np.append(low.ravel(), LAST)
    # Only a quarter at a bend bends.
    bent = np.zeros((curve.error.size, 4), dtype=int)
    bent[curve.bent == 1, 0], bent[curve.bent == 2, 3] = 1, 2
    nodes = np.polynomial.chebyshev.chebpts1(TERMS)
    basis = np.polynomial.chebyshev.chebvander(nodes, TERMS - 1)
    places = placed(0.5 * (nodes + 1.0), bent.reshape(-1, 1))
    y = edges[:-1, None] + places * np.diff(edges)[:, None]
    series = np.linalg.solve(basis, curve.at(y).T).T
    return replace(
        curve, edges=edges, coefficients=series, error=np.repeat(curve.error, 4), bent=bent.ravel()
    )


@pytest.mark.parametrize("control", CONTROLS)
def test_averages_hold_for_errors_that_change_their_sign_in_a_piece(control: str | None) -> None:
    """With every piece four unknowns they grow by less than half: the bound has twice as much."""
    coarse, fine = Ladder(SCALED, control, 1e-7), Ladder(SCALED, control, 1e-7)
    for _ in range(8):
        # Curves that are the same, or what is compared is how well each was had.
        fine.step()
        split = in_quarters(coarse.step())
        fine.curves[-1] = split
        fine._cells[-1] = np.union1d(fine._cells[-1], split.edges)
        middle = 0.5 * (fine._cells[-1][1:] + fine._cells[-1][:-1])
        own = np.zeros((middle.size, split.error.size))
        own[np.arange(middle.size), split.piece(middle)] = 1.0
        known = fine._cells[-2] if len(fine._cells) > 1 else fine._start
        passed = np.zeros((middle.size, 0))
        if len(fine._cells) > 1:
            passed = fine._passed[1][np.searchsorted(known, middle) - 1]
        fine._transfer[-1] = np.column_stack((passed, own))
    for steps in range(1, 8):
        ratio = fine.average(steps, WIDE).max() / coarse.average(steps, WIDE).max()
        assert 0.9 <= ratio <= 1.6


def test_the_doubt_of_a_divisor_takes_no_room_for_all_pairs_of_heights() -> None:
    # Enough steps that what a process keeps beside, half a megabyte, is nothing to it.
    found = climbed(SCALED, 12)
    cells = found._cells[-1].size - 1
    unknowns = sum(curve.error.size for curve in found.curves)
    known = found.doubt(12)
    found._doubts.clear()
    tracemalloc.start()
    assert found.doubt(12) == known
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 8 * cells * cells * unknowns / 4


@pytest.mark.parametrize("m", [0.1, 0.5])
def test_curves_and_rings_end_where_masking_ends(m: float) -> None:
    """A kink at one height, whatever the light: 1e-8 by default, on both sides of it."""
    base = albedo.model("cook_torrance", geometry="smith_rational", m=m)
    (part,) = base.parts()
    (height,) = part.heights
    beside = height * np.array([0.5, 1.0 - 1e-3, 1.0, 1.0 + 1e-3, 1.1])
    angles = np.concatenate(([1.0, 0.5, 1e-3, 1e-6], beside[beside < 1.0]))
    own = albedo.directional_albedo(base, angles, rtol=1e-8)
    pumped = albedo.pump(base, 2)
    found = albedo.directional_albedo(pumped, angles)
    assert found.converged.all()
    first, _ = pumped.albedos
    # The curve of the first albedo against integrals that know nothing of rings.
    slack = (first.error + first.bound).max() * own.value + own.error
    assert np.all(np.abs(np.exp(first.at(folded(angles))) - own.value) <= slack)


@pytest.mark.parametrize(
    "spec",
    [
        "cook_torrance",
        "lafortune_scaled",
        "ward:m=0.1",
        pytest.param("he_torrance", marks=pytest.mark.slow),
    ],
)
def test_curves_of_families_are_those_of_rows_from_the_model(
    spec: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = next(albedo.grammar.parse(spec).models())
    found = climbed(model, 3)
    monkeypatch.setattr(Families, "panels", Families.direct)
    exact = Ladder(model, None, 5e-12)
    while len(exact.curves) < 3:
        exact.step()
    y = folded(np.geomspace(1e-9, 1.0, 997))
    for k, (curve, fine) in enumerate(zip(found.curves, exact.curves, strict=True)):
        bound = curve.bound[curve.piece(y)] + fine.bound[fine.piece(y)]
        bound += found.average(k, cosines(y)) + exact.average(k, cosines(y))
        assert np.all(np.abs(curve.at(y) - fine.at(y)) <= bound)


def test_pieces_give_up_nodes_that_later_albedos_do_not_need() -> None:
    """Those that are left are nodes of before, so that no row is computed for it."""
    found, fewer = Ladder(albedo.model("ward", m=0.2), None, 1.2e-10), 0
    before: dict[tuple[float, float], np.ndarray] = {}
    for _ in range(8):
        found.step()
        nodes = {(one.low, one.high): one.y[: one.gaps + 1] for one in found._pieces}
        for ends, y in nodes.items():
            if ends in before and y.size < before[ends].size:
                fewer += 1
                assert np.all(np.isin(y, before[ends]))
        # A piece whose rows err as much as its series misses them is not refined: up to 1.6.
        assert found.curves[-1].error.max() <= 2.0 * found.rtol
        before = nodes
    assert fewer > 0


def test_turnings_are_where_the_clamp_changes_course() -> None:
    """Against places on a fine grid where the product of the albedos is the larger cosine."""
    divisor = climbed(albedo.model("schlick"), 3, "cumulative").divisor(3)
    view = np.linspace(-44.0, LAST, 40_001)
    c_view = unfolded(view)

    def course(y: float) -> list[tuple[bool, ...]]:
        """Which of the albedos are larger at V than at L, at all places of the clamp."""
        c = float(unfolded(np.array([y]))[0])
        product = sum(np.maximum(curve.at(view), curve.at(np.array([y]))) for curve in curves)
        above = product > np.log(np.maximum(np.maximum(c, c_view), LOWEST))
        places = view[:-1][above[1:] != above[:-1]]
        return [tuple(bool(v.at(at) > v.at(np.array([y]))[0]) for v in curves) for at in places]

    curves = divisor.curves
    found = divisor.turnings(np.linspace(-3.0, 1.0, 4001))
    assert found.size > 4
    ends = np.concatenate(([-3.0], found, [1.0]))
    # On both sides of each the course is another one, and between two it is one.
    for low, high in itertools.pairwise(ends.tolist()):
        inside = [course(low + share * (high - low)) for share in (0.03, 0.4, 0.7, 0.97)]
        assert all(other == inside[0] for other in inside)
    for place in found.tolist():
        assert course(place - 1e-3) != course(place + 1e-3)


def test_a_clamp_that_begins_at_a_corner_is_seen_at_once() -> None:
    """Where another height has the albedo of L the product has a corner, which dips below the
    cosine before any other place does: a bound of 3e-14 had hidden 2e-10 there.
    """
    base = albedo.model("ashikhmin_shirley", n_u=56.77, n_v=56.77, r_s=0.7398, r_d=0.6093)
    divisor = climbed(base, 4, "cumulative").divisor(4)
    curve = divisor.curves[1]

    def corner(y: float) -> tuple[float, float]:
        """The place that has L's second albedo, and by how much the product exceeds n.l there."""
        (place,) = divisor._levels_of(curve, np.array([y]))
        c = unfolded(np.array([y, place[0]]))
        excess = divisor._free.logs(c[:1], c[1:]) - np.log(c.max())
        return float(place[0]), float(excess[0])

    low, high = 0.325, 0.33
    assert corner(low)[1] > 0.0 > corner(high)[1]
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if corner(middle)[1] > 0.0 else (low, middle)
    for beyond in (1e-8, 1e-7, 1e-6, 3e-6):
        place, excess = corner(high + beyond)
        assert excess < 0.0
        found = np.array(divisor._clamped(np.array([high + beyond])))
        around = np.sort(found[np.abs(found - place) < 1e-3])
        assert around.size == 2
        assert around[0] < place < around[1]


def test_marks_with_a_floor_are_those_of_the_larger_of_curve_and_cosine() -> None:
    (curve,) = climbed(albedo.model("ward", m=0.4), 1, "literal").curves

    def larger(y: np.ndarray) -> np.ndarray:
        return np.maximum(curve.at(y), np.log(unfolded(y)))

    assert curve.crossings.size > 0
    corners = np.concatenate((curve.floored_turns, curve.crossings))
    marks = curve.floored_marks
    assert np.all(np.isin(curve.crossings, marks))
    mates = marks[~np.isin(marks, corners)]
    assert mates.size > 0
    off = np.abs(larger(mates)[:, None] - larger(corners)).min(1)
    # Of places that bisection tells apart no more: the curve's slopes are below 1.
    np.testing.assert_allclose(off, 0.0, atol=1e-13)
    # Every corner that has the value elsewhere has its mates.
    y = np.linspace(FIRST, LAST, 200_001)
    for corner in corners:
        rest = larger(y) - larger(np.array([corner]))
        places = y[:-1][(rest[1:] > 0.0) != (rest[:-1] > 0.0)]
        away = places[np.abs(places[:, None] - corners).min(1) > 1e-2]
        assert np.all(np.abs(away[:, None] - mates).min(1) < 1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("control", ["literal", "cumulative"])
@pytest.mark.parametrize("spec", ["ward_duer:m=0.2", "ward:m=0.4", "schlick", "lafortune"])
def test_controlled_curves_are_those_of_a_finer_ladder(spec: str, control: str) -> None:
    """Albedos bend where the control begins to tell; rows that miss a kink differ on one side."""
    model = next(albedo.grammar.parse(spec).models())
    found, fine = climbed(model, 5, control), Ladder(model, control, 5e-12)
    while len(fine.curves) < 5:
        fine.step()
    for k, (curve, exact) in enumerate(zip(found.curves, fine.curves, strict=True)):
        near = curve.edges[:, None] + np.array([-1e-3, -1e-6, 0.0, 1e-6, 1e-3])
        y = np.union1d(folded(np.geomspace(1e-9, 1.0, 997)), near.ravel())
        y = y[(y >= curve.edges[0]) & (y <= curve.edges[-1])]
        bound = curve.bound[curve.piece(y)] + exact.bound[exact.piece(y)]
        bound += found.average(k, cosines(y)) + fine.average(k, cosines(y))
        assert np.all(np.abs(curve.at(y) - exact.at(y)) <= bound)


def rows_with(
    curves: list[LogCurve], model: albedo.Model, control: str | None, c: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Values and errors of rows at some cosines, had as well as can be, with given divisors."""
    found = Ladder(model, control, 1e-12)
    found.curves, found._divisors = list(curves), {}
    fresh = np.zeros(c.size, dtype=int)
    found._parts = [found._profile(part, c, fresh) for part in model.parts()]
    found._cos = c
    return found._values()


@pytest.mark.slow
@pytest.mark.parametrize("control", CONTROLS)
@pytest.mark.parametrize("steps", [3, 7])
@pytest.mark.parametrize(
    "spec",
    [
        "ward_duer:m=0.2",
        "oren_nayar",
        "cook_torrance:geometry=smith_rational,m=0.1",
        "lafortune",
        "schlick",
    ],
)
def test_rows_err_by_no_more_than_they_say(spec: str, steps: int, control: str | None) -> None:
    """Against rows that are had seventy times as precisely, with the same divisors."""
    model = next(albedo.grammar.parse(spec).models())
    found = climbed(model, steps, control)
    for profiles in found._parts:
        found._meet(profiles, found._cos, found._met)
    found._met = steps
    value, own = found._values()
    rows = np.arange(0, found._cos.size, 2)
    exact, rest = rows_with(found.curves, model, control, found._cos[rows])
    assert np.all(np.abs(value[rows] / exact - 1.0) <= own[rows] + rest)


@pytest.mark.slow
@pytest.mark.parametrize("control", CONTROLS)
@pytest.mark.parametrize(
    "spec",
    [
        "phong:n=20",
        "blinn:n=80",
        "ward:m=0.1",
        "ward:m=0.4",
        "ward_duer:m=0.2",
        "ward_bounded:m=0.2",
        "cook_torrance:m=0.4",
        "cook_torrance:geometry=smith_rational,m=0.1",
        "ashikhmin_shirley:r_s=0.5",
        "ashikhmin_shirley:specular=none,r_s=0.4,r_d=0.2",
        "lafortune",
        "lafortune_scaled:n=20,s=0.95",
        "oren_nayar",
        "oren_nayar:rho=0.1121,sigma=0.5224",
        "oren_nayar_full:rho=0.5,sigma=1.26",
        "stam_gaussian",
        "schlick",
    ],
)
def test_twenty_steps_are_had_to_what_is_promised(spec: str, control: str | None) -> None:
    """By default an albedo is had to 1e-8; most of that is what the divisor may be off."""
    found = albedo.pump(next(albedo.grammar.parse(spec).models()), 20, control)._ladder
    # Rows that err as much as their series misses them refine no piece: sums, integrals around
    # rings and hidden kinks have a share of the tolerance each.
    noise = _SHARE + _COARSE + _MANY * _HIDDEN
    # Curves are joined, which has a share too.
    most = ((TRUST + LEBESGUE) * noise + _JOINED) * found.rtol
    assert max(curve.error.max() for curve in found.curves) <= most
    # The rest is for the quadrature of the result.
    assert found.average(20, WIDE).max() <= _LEFT * _GOAL


@dataclass
class _Told:
    """Curves that leave so many times what they are worth."""

    rtol: float
    fold: float

    def worst(self, steps: int) -> float:
        return self.fold * self.rtol


@pytest.mark.parametrize(
    ("fold", "goal", "asked"),
    [
        (12.0, 1e-8, [7e-10]),
        (20.0, 1e-8, [7e-10, 3e-10]),
        (80.0, 1e-8, [7e-10, 1e-10]),
        # Where none does the first is as good, and coarser ones are those of a lesser goal.
        (1e4, 1e-8, [7e-10]),
        (1e4, 1e-10, [7e-12, 7e-11, 7e-10]),
    ],
)
def test_curves_are_asked_for_what_the_first_ones_tell(
    fold: float, goal: float, asked: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the first curves leave too much, the next are the coarsest that will do by that."""
    known: list[float] = []

    def climbed(self: Pumped, rtol: float) -> _Told:
        known.append(rtol)
        return _Told(rtol, fold)

    monkeypatch.setattr(Pumped, "_climbed", climbed)
    found = albedo.pump(STEEP, 20, goal=goal)._ladder
    assert known == pytest.approx(asked)
    assert found.rtol == min(known)


@pytest.mark.slow
@pytest.mark.parametrize("control", CONTROLS)
def test_what_a_mirror_leaves_at_grazing_incidence_is_had(control: str | None) -> None:
    """Its albedo is a thousandth there, so that every step multiplies what was next to nothing."""
    found = albedo.pump(albedo.model("he_torrance"), 20, control)._ladder
    noise = _SHARE + _COARSE + _MANY * _HIDDEN
    # Curves are joined, which has a share too.
    most = ((TRUST + LEBESGUE) * noise + _JOINED) * found.rtol
    assert max(curve.error.max() for curve in found.curves) <= most
    assert found.average(20, WIDE[WIDE >= 1e-6]).max() <= _LEFT * _GOAL
    # Most of the rows that look ahead are read from families, not computed when they are asked for.
    (families,) = found._families.values()
    (ahead,) = [key for key in families._stretches if key is not None]
    asked = np.array([(s.family is not None, s.asked.size) for s in families._stretches[ahead]])
    assert asked[:, 0] @ asked[:, 1] > 0.5 * asked[:, 1].sum()


def test_rows_that_stay_dark_are_had_for_steps_ahead_from_the_start() -> None:
    found = Ladder(albedo.model("he_torrance"), None, 1e-6)
    (profiles,) = found._parts
    y, ahead = folded(found._cos), profiles.ahead.copy()
    found.step()
    after_one = np.exp(found.step().at(y))
    # It was looked at roughly.
    assert np.all(ahead[after_one < 0.5 * _DARK] == 1)
    assert np.all(ahead[after_one > 2.0 * _DARK] == 0)
    assert 20 < ahead.sum() < 100


@pytest.mark.parametrize("name", ["ward", "lafortune_scaled", "lambert"])
def test_rows_that_a_step_makes_bright_are_not(name: str) -> None:
    """Of Ward's, most is far less than what is sent on at grazing incidence, but only at first."""
    found = Ladder(albedo.model(name), None, 1e-6)
    assert not any(profiles.ahead.any() for profiles in found._parts)


def test_curves_for_less_do_where_control_keeps_the_product() -> None:
    """Rows of He and Torrance's model that were had for steps ahead from the start left 1e-8."""
    found = Ladder(albedo.model("he_torrance"), "cumulative", _OF_CURVES[0] * _GOAL)
    for _ in range(20):
        found.step()
    assert found.worst(20) <= _LEFT * _GOAL


@pytest.mark.parametrize("place", ["keep", "cut", "replace"])
def test_what_was_interrupted_is_not_gone_on_with(
    place: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ladders are shared, and one whose rows are half moved would say anything."""
    model, cos_theta = albedo.model("he_torrance", sigma0=0.3), np.array([0.9, 0.3, 0.01])

    def interrupted(self: Profiles, *_: Any) -> None:
        # In its midst.
        self.slices.density[:] *= 0.9
        raise KeyboardInterrupt

    ladder.cache_clear()
    with monkeypatch.context() as context:
        context.setattr(Profiles, place, interrupted)
        with pytest.raises(KeyboardInterrupt):
            albedo.directional_albedo(albedo.pump(model, 12), cos_theta)
    found = albedo.directional_albedo(albedo.pump(model, 12), cos_theta)
    ladder.cache_clear()
    fresh = albedo.directional_albedo(albedo.pump(model, 12), cos_theta)
    np.testing.assert_array_equal(found.value, fresh.value)
    np.testing.assert_array_equal(found.error, fresh.error)


def _albedos_of_a_product(steps: int, x: np.ndarray) -> np.ndarray:
    """Albedos at cosines x of f = c u(n.l) u(n.v) that is pumped up, u = 1 - (1 - x/2)^5.

    While they rise with the cosine, 2 pi c (p(x) int_0^x u t dt + u(x) int_x^1 p(t) t dt), with
    p = u / (product of all before). Integrals are those of Chebyshev series on octaves.
    """
    u = Polynomial([0.0, 5 / 2, -5 / 2, 5 / 4, -5 / 16, 1 / 32])
    below = (u * Polynomial([0.0, 1.0])).integ()
    edges = np.concatenate(([0.0], 0.5 ** np.arange(70, -1, -1)))
    octaves = list(itertools.pairwise(edges.tolist()))
    known: list[list[Chebyshev]] = []
    # Rises as a pumped albedo does, and is 1 at the normal.
    scale = 1.0 / (u(1.0) * below(1.0))

    def over(t: np.ndarray, k: int) -> np.ndarray:
        return u(t) / np.prod([step[k](t) for step in known], axis=0)

    found = []
    for step in range(steps + 1):
        beyond, here = 0.0, []
        for k in reversed(range(len(octaves))):
            part = Chebyshev.interpolate(lambda t, k=k: t * over(t, k), 24, octaves[k])
            rest = part.integ(lbnd=octaves[k][1])
            here.append(
                Chebyshev.interpolate(
                    lambda t, k=k, rest=rest, beyond=beyond: (
                        scale * (over(t, k) * below(t) + u(t) * (beyond - rest(t)))
                    ),
                    24,
                    octaves[k],
                )
            )
            beyond -= float(rest(octaves[k][0]))
        known.append(here[::-1])
        which = np.clip(np.searchsorted(edges, x) - 1, 0, len(octaves) - 1)
        found.append([known[step][k](t) for k, t in zip(which.tolist(), x.tolist(), strict=True)])
    return np.array(found)


def test_an_albedo_that_falls_to_nothing_is_pumped_up_as_precisely_as_others() -> None:
    """Five steps divide by the fifth power of n.v, which one series of rings does not survive."""
    base = albedo.model("ashikhmin_shirley", specular="none", r_s=0.4, r_d=0.2)
    x = np.array([1e-9, 1e-6, 1e-3, 0.1, 0.3, 0.6, 0.9, 1.0])
    # They rise up to the fourth; the series round to 1e-13.
    expected = _albedos_of_a_product(4, x)
    assert np.all(np.diff(expected, axis=1) > 0.0)
    for goal in (1e-8, 1e-10):
        pumped = albedo.pump(base, 5, goal=goal)
        for step in range(1, 5):
            found = pumped.albedo_before(step, x)
            assert np.all(found.error < goal * found.value)
            assert np.all(np.abs(found.value - expected[step]) <= found.error + 1e-12 * found.value)
        last = albedo.directional_albedo(pumped, x, rtol=goal)
        assert last.converged.all()


def test_rows_have_no_more_slices_than_help(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is noise is not halved time and again, and is in the bounds."""
    base = albedo.model("ashikhmin_shirley", specular="none", r_s=0.4, r_d=0.2)
    (part,) = base.parts()
    monkeypatch.setattr(type(base), "parts", lambda self: (replace(part, rings=None),))
    monkeypatch.setattr("albedo.operators.ladder._ROUNDED", 1e-300)
    monkeypatch.setattr("albedo.operators.ladder._MOST_SLICES", 300)
    noisy = Ladder(base, None, 4e-12)
    for _ in range(6):
        noisy.step()
    (rows,) = noisy._parts
    count = np.bincount(rows.row[rows.slices.panel])
    # A round at most doubles them, and a later step cuts at its kinks.
    assert 300 < count.max() < 700
    monkeypatch.undo()
    exact = climbed(base, 6)
    y = np.linspace(folded(np.array([1e-6]))[0], LAST, 99)
    for n in range(6):
        off = np.abs(noisy.curves[n].at(y) - exact.curves[n].at(y))
        assert np.all(off <= noisy.doubt(n) + noisy.curves[n].bound.max() + exact.doubt(n) + 4e-10)
    assert noisy.curves[5].bound.max() > 1e-7


STEEP = albedo.model("lafortune_scaled", n=31.57, s=0.1694)
"""A lobe whose albedo falls from 1 to 2e-23: steps divide by little where little is sent on."""


def test_what_a_step_lifts_is_known_to_as_many_digits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Roundings of what is bright at first are not all that is seen of what is left."""
    fine, coarse = Ladder(STEEP, None, 4e-12), Ladder(STEEP, None, 4e-10)
    for found in (fine, coarse):
        for _ in range(4):
            found.step()
    y = np.linspace(folded(np.array([1e-6]))[0], LAST, 99)
    for n in range(4):
        off = np.abs(fine.curves[n].at(y) - coarse.curves[n].at(y))
        own = sum(some.doubt(n) + some.curves[n].bound.max() for some in (fine, coarse))
        assert np.all(off <= own)
    # It is 6e-11; with panels that end at kinks only it was 4e-8.
    assert fine.worst(4) < 2e-10
    monkeypatch.setattr("albedo.operators.ladder._ROUNDED", 1e-300)
    blurred = Ladder(STEEP, None, 4e-12)
    for _ in range(4):
        blurred.step()
    assert blurred.worst(4) > 1e-9


def test_what_no_cosine_tells_is_not_halved() -> None:
    """An albedo so steep that the next cosine has another one is as good as cosines are."""
    base = albedo.model("lafortune_scaled", n=7.754, s=0.005461)
    found = Ladder(base, None, 4e-12)
    curve = found.step()
    # It rises as 1 + (n theta/s)^2/4: an ulp of the cosine is 1e-16 (n/s)^2/4, half of 1e-10.
    assert 1e-11 < curve.bound.max() < 2e-10
    # There were a thousand.
    assert len(found._pieces) < 40
    c = 1.0 - np.geomspace(1e-9, 1e-3, 40)
    exact = albedo.directional_albedo(base, c, rtol=1e-12)
    off = np.abs(curve(c) / exact.value - 1.0)
    assert np.all(off <= curve.bound.max() + exact.error / exact.value)


def test_the_worst_pieces_are_refined_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where there is no room for all, no piece is left as poor as it was."""
    monkeypatch.setattr("albedo.operators.ladder._MOST_PIECES", 14)
    found = Ladder(STEEP, None, 4e-12)
    curve = found.step()
    assert len(found._pieces) <= 14
    # With 15 it is 2e-12; as long as none was cut it was 4e-3.
    assert curve.bound.max() < 1e-5


def test_a_goal_that_is_missed_leaves_no_worse_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where there is no room for fine curves, coarser ones are worth more."""
    monkeypatch.setattr("albedo.operators.ladder._MOST_PIECES", 24)
    ladder.cache_clear()
    fine = albedo.pump(STEEP, 3, goal=1e-10)
    left = fine._ladder.worst(3)
    asked = _OF_CURVES[0] * 1e-10
    assert fine._ladder.rtol > asked
    assert left < 0.1 * ladder(STEEP, None, asked).worst(3)
    assert left <= albedo.pump(STEEP, 3)._ladder.worst(3)
    ladder.cache_clear()


def test_pieces_that_did_before_may_leave_a_little_more(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fewer rows are computed for it, and bounds tell what it costs."""
    rows, left = [], []
    real = Ladder._profile

    def counted(self: Ladder, part: Part, c: np.ndarray, *rest: Any) -> Profiles:
        rows[-1] += c.size
        return real(self, part, c, *rest)

    monkeypatch.setattr(Ladder, "_profile", counted)
    for fold in (1.0, _WORN):
        monkeypatch.setattr("albedo.operators.ladder._WORN", fold)
        rows.append(0)
        left.append(climbed(SCALED, 14).worst(14))
    assert rows[1] < 0.95 * rows[0]
    assert left[0] < left[1] < _WORN * left[0]


def test_pieces_that_did_not_do_as_one_are_tried_again_later(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As no more bends in them show, and not at every step."""
    tried: dict[tuple[float, float, int], list[int]] = {}
    real = Ladder._joined

    def seen(self: Ladder, pieces: list[Piece], *rest: Any) -> Piece | None:
        found = real(self, pieces, *rest)
        if found is None:
            key = pieces[0].low, pieces[-1].high, len(pieces)
            tried.setdefault(key, []).append(len(self.curves))
        return found

    monkeypatch.setattr(Ladder, "_joined", seen)
    climbed(SCALED, 20)
    again = np.concatenate([np.diff(steps) for steps in tried.values()])
    assert again.size >= 2
    assert np.all(again >= 3)


def test_quadrature_has_what_the_divisor_leaves_of_the_tolerance(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """However little that is: half of 1e-8 on top of 7.8e-9 had been too much here."""
    assert _LEFT < _MOST_SPENT < 1.0
    left = 7.8e-9
    monkeypatch.setattr(Ladder, "average", lambda self, steps, c, part=None: np.full(c.shape, left))
    monkeypatch.setattr(Ladder, "doubt", lambda self, steps: left)
    pumped = albedo.pump(albedo.model("blinn", n=287.1), 8, "cumulative")
    found = albedo.directional_albedo(pumped, 1.0)
    assert np.all(found.converged)
    assert np.all((left * found.value <= found.error) & (found.error <= 1e-8 * found.value))
    ladder.cache_clear()


def test_what_rounding_leaves_nothing_of_is_refused() -> None:
    steep = albedo.model("lafortune_scaled", n=30.0, s=0.01)
    told = "at cos_theta = .* no digit of its albedo is left after step 1; it is as low as 1e-59"
    with pytest.raises(InputError, match=told):
        albedo.directional_albedo(albedo.pump(steep, 3), 0.5)


def test_a_doubt_that_is_no_number_any_more_makes_a_bound_infinite() -> None:
    found = climbed(albedo.model("phong", n=1), 1)
    found._doubts[1] = 1e200
    assert np.all(np.isinf(found.average(1, np.array([0.1, 1.0]))))


def test_the_last_quadrature_sees_bends_that_come_from_bends() -> None:
    """A nearly constant albedo is mapped to a strip of a thousandth, next to an end of a panel."""
    base = albedo.model("oren_nayar", rho=0.3371, sigma=0.02942)
    cos_theta = np.linspace(0.5, 0.75, 26)
    found = albedo.directional_albedo(albedo.pump(base, 8, "literal"), cos_theta)
    known = albedo.pump(base, 9, "literal").albedo_before(8, cos_theta)
    assert found.converged.all()
    # They hold errors of the same curves, and each its own quadrature; it had been 20 bounds.
    assert np.all(np.abs(found.value - known.value) <= 0.1 * (found.error + known.error))


@pytest.mark.parametrize(
    "spec",
    [
        "oren_nayar:rho=0.1121,sigma=0.5224",
        # A broad lobe about an axis.
        pytest.param("lafortune_scaled:n=0.25,s=0.95,rho_s=0.15", marks=pytest.mark.slow),
    ],
)
def test_next_to_nothing_over_a_cosine_is_had_as_precisely(spec: str) -> None:
    """The product of small albedos is a cosine next to the horizon, and stays one."""
    base = next(albedo.grammar.parse(spec).models())
    cos_theta = np.geomspace(1e-6, 1.0, 13)
    found = albedo.directional_albedo(albedo.pump(base, 20, "cumulative"), cos_theta)
    finer = albedo.pump(base, 20, "cumulative", goal=1e-10)
    known = albedo.directional_albedo(finer, cos_theta, rtol=1e-10)
    # It had been 2e-7 and 7e-3.
    assert found.converged.all()
    assert np.all(known.error < 4e-10 * known.value)
    assert np.all(np.abs(found.value - known.value) <= found.error + known.error)


def test_a_model_that_is_cut_off_at_0_is_pumped_up_as_precisely() -> None:
    """Rings end where Oren and Nayar's fit falls below 0, opposite the light."""
    base = albedo.model("oren_nayar_full", rho=0.5183, sigma=1.26)
    cos_theta = np.geomspace(1e-6, 1.0, 13)
    found = albedo.directional_albedo(albedo.pump(base, 5, "literal"), cos_theta)
    known = albedo.pump(base, 6, "literal").albedo_before(5, cos_theta)
    # It had been 6e-5.
    assert found.converged.all()
    assert np.all(np.abs(found.value - known.value) <= found.error + known.error)


def test_kinks_are_the_same_however_many_are_looked_for_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    known = climbed(SCALED, 5)
    monkeypatch.setattr("albedo.operators.profiles._ROOM", 1000)
    found = climbed(SCALED, 5)
    assert known._parts[0].slices.panel.size * known.curves[-1].bends.size > 3 * 1000
    for a, b in zip(known.curves, found.curves, strict=True):
        np.testing.assert_array_equal(a.coefficients, b.coefficients)
