"""Integrals around rings: read from series, cut without computing the model again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.polynomial import chebyshev

import albedo
from albedo.brdf import Model
from albedo.charts.heights import FIRST, LAST, folded
from albedo.integrators import adaptive
from albedo.integrators.adaptive import (
    Refined,
    _enough,
    _heights,
    _lifted,
    _Rows,
    refine,
    refine_alike,
)
from albedo.integrators.cells import Cells, ModelIntegrand, evaluate
from albedo.operators.divisor import CONTROLS, Divisor, LogCurve
from albedo.operators.ladder import Ladder, rings_of
from albedo.operators.panels import _LIMIT, Ahead, Panels, _judge_series, height_at
from albedo.operators.profiles import Profiles, StepKinks, _Store

COSINES = np.array([1.0, 0.7, 0.3, 1e-2, 1e-5])
MODELS = [
    albedo.model("phong", n=20),
    albedo.model("phong", n=1e6),
    albedo.model("ward", m=0.1),
    albedo.model("oren_nayar"),
    albedo.model("cook_torrance", m=0.4),
]
models = pytest.mark.parametrize("model", MODELS, ids=lambda model: model.spec)


def profiles_of(model: Model, rtol: float = 1e-11) -> Profiles:
    (part,) = model.parts()
    return Profiles(Panels.of(model, part, rings_of(part), COSINES, rtol))


def total(profiles: Profiles) -> tuple[np.ndarray, np.ndarray]:
    value, of_slices, of_panels = profiles.sums(0, np.log(COSINES))
    return value, of_slices + of_panels + profiles.shift * value


@models
def test_rings_add_up_to_albedos(model: Model) -> None:
    value, error = total(profiles_of(model))
    known = albedo.directional_albedo(model, COSINES, rtol=1e-12)
    assert np.all(np.abs(value - known.value) <= error + known.error)
    # Half of what was asked for stays in the series, and about as much in the rings.
    assert np.all(error <= 2e-11 * value)


@models
def test_cut_slices_keep_the_sum(model: Model, rng: np.random.Generator) -> None:
    profiles = profiles_of(model)
    before, error = total(profiles)
    for _ in range(3):
        s = profiles.slices
        which = np.repeat(np.arange(s.panel.size), 2)
        place = s.start[which] + rng.uniform(size=which.size) * (s.end - s.start)[which]
        fresh = profiles.cut(which, place, rng.integers(0, 4, which.size))
        assert fresh.size >= which.size
        # No step divides by anything yet.
        profiles.slices.log_product[:] = 0.0
    s = profiles.slices
    # Every panel is covered once.
    widths = np.bincount(s.panel, s.end - s.start)
    np.testing.assert_allclose(widths, 1.0, rtol=1e-12)
    after, slack = total(profiles)
    assert np.all(np.abs(after - before) <= error + slack)
    # Slices get nodes for their share of a panel, which are raised only where it matters.
    assert np.all(slack <= 1e-10 * after)


def bent_curve(low: float, bend: float, high: float, above: bool) -> LogCurve:
    """A curve with a root between two places: above a bend, or below it."""
    series = np.zeros((4, 18))
    series[:, 0] = [-5.0, -1.0, -1.0, -5.0]
    # The cube of the root is the cube of (1 + u) / 2, or of (1 - u) / 2.
    if above:
        series[2, :4] += chebyshev.poly2cheb([1.0, 3.0, 3.0, 1.0]) / 8.0
    else:
        series[1, :4] += chebyshev.poly2cheb([1.0, -3.0, 3.0, -1.0]) / 8.0
    edges, bent = np.array([FIRST, low, bend, high, LAST]), [0, 0, 1, 0] if above else [0, 2, 0, 0]
    return LogCurve(edges, series, np.full(4, 1e-16), np.array(bent), np.array([bend]))


def cut_at_the_bend(model: Model, curve: LogCurve, known: bool) -> Profiles:
    """Rows that are divided by the larger albedo, cut where it bends."""
    profiles = profiles_of(model)
    total(profiles)
    nowhere, least = np.empty((COSINES.size, 0)), np.zeros(COSINES.size)
    which, place, sides = profiles.kinks([StepKinks(curve, nowhere, curve.bends)], False, least)
    profiles.cut(which, place, sides if known else np.zeros_like(sides))
    profiles.slices.log_product[:] = 0.0
    profiles.multiply([curve], COSINES, 0, np.empty(0, int))
    return profiles


@pytest.mark.parametrize("model", MODELS[:3] + MODELS[4:], ids=lambda model: model.spec)
@pytest.mark.parametrize("rises", [True, False], ids=["rising", "falling"])
@pytest.mark.parametrize("above", [True, False], ids=["above", "below"])
def test_nodes_are_clustered_next_to_a_bend_where_series_are_in_roots(
    model: Model, rises: bool, above: bool
) -> None:
    profiles = profiles_of(model)
    total(profiles)
    s = profiles.slices
    along = s.y[s.first + s.order - 1] > s.y[s.first]
    # In the midst of what holds most, on a panel that is no strip next to the horizon, and not
    # about 30 degrees, where the coordinate has a kink itself.
    may = (along == rises) & (s.high - s.low < 1.0) & (s.low * s.high > 0.0) & (s.high < LAST)
    most = int(np.argmax(np.where(may, s.value, -1.0)))
    assert may[most]
    low, high, panel = float(s.low[most]), float(s.high[most]), s.panel[most]
    bend = 0.5 * (low + high)
    curve = bent_curve(low, bend, high, above)
    np.testing.assert_array_equal(curve.bent_sides, [1 if above else 2])
    profiles, other = (cut_at_the_bend(model, curve, known) for known in (True, False))
    value, _, _ = profiles.sums(0, np.log(COSINES))
    other.sums(0, np.log(COSINES))
    s, plain = profiles.slices, other.slices
    (own,) = np.flatnonzero((s.bent > 0) & (s.panel == panel))
    # On the side where the root is, and towards the bend, whether heights rise or fall along it.
    assert s.bent[own] == (1 if rises == above else 2)
    np.testing.assert_allclose(s.low[own] if above else s.high[own], bend, atol=1e-9)
    y = np.abs(s.y[s.first[own] : s.first[own] + s.order[own]] - bend)
    assert y.min() < 0.01 * y.max()
    # What is smooth then has rules that are worth more, and the value is the same.
    np.testing.assert_array_equal(plain.end, s.end)
    error, more = s.error[own], plain.error[own]
    assert error < max(0.01 * more, 1e-13 * value[profiles.row[panel]])
    assert abs(s.value[own] - plain.value[own]) <= error + more


def test_halves_are_clustered_at_their_own_ends() -> None:
    profiles = profiles_of(MODELS[2])
    s = profiles.slices
    for bent in (1, 2, 3):
        place = np.full(1, 0.5 * float(s.start[0] + s.end[0]))
        profiles.cut(np.zeros(1, int), place, np.full(1, bent))
    hit = np.flatnonzero(s.bent)
    before = {(s.start[k], s.end[k]): s.bent[k] for k in hit.tolist()}
    s.order[hit] = 24
    fresh = profiles.raised(hit)
    assert fresh.size == 2 * len(before)
    for (start, end), bent in before.items():
        (first,) = fresh[s.start[fresh] == start]
        (last,) = fresh[s.end[fresh] == end]
        assert s.bent[first] == bent & 1
        assert s.bent[last] == bent & 2


def test_bends_are_on_the_side_that_is_in_the_root() -> None:
    for bent, side in (([0, 1, 2, 0], 0), ([0, 2, 1, 0], 3), ([1, 2, 2, 1], 2), ([2, 1, 1, 2], 1)):
        curve = replace(bent_curve(-1.0, 0.2, 0.5, True), bent=np.array(bent))
        np.testing.assert_array_equal(curve.bent_sides, [side])


@models
def test_places_near_others_are_one(model: Model) -> None:
    profiles = profiles_of(model)
    s = profiles.slices
    count = s.panel.size
    places = np.array([0.5, 0.5 + 1e-12, 1e-13, 1.0 - 1e-13])
    profiles.cut(np.zeros(4, int), places, np.zeros(4, int))
    assert profiles.slices.panel.size == count + 1
    assert profiles.slices.start.min() == 0.0
    assert profiles.slices.end.max() == 1.0


def test_kinks_of_several_steps_are_those_of_each() -> None:
    model = albedo.model("ward", m=0.4)
    profiles, pumped = profiles_of(model), albedo.pump(model, 3)
    total(profiles)
    divisors = [Divisor(list(pumped.albedos[:k]), None) for k in (1, 2, 3)]
    known = [StepKinks(d.curves[-1], d.last_levels(COSINES), d.last_bends) for d in divisors]
    least = np.full(COSINES.size, 1e-12)
    together = np.stack(profiles.kinks(known, False, least))
    alone = np.concatenate([np.stack(profiles.kinks([k], False, least)) for k in known], axis=1)
    assert together.shape[1] > 10
    # Slice after slice, and in each step after step.
    rank = np.argsort(alone[0], kind="stable")
    np.testing.assert_array_equal(together, alone[:, rank])


def test_a_level_is_found_where_its_height_is() -> None:
    """Slices are cut at exactly the heights at which a divisor has kinks."""
    profiles = profiles_of(albedo.model("ward", m=0.4))
    pumped = albedo.pump(albedo.model("ward", m=0.4), 1)
    (curve,) = pumped.albedos
    levels = pumped.divisor.last_levels(COSINES)
    profiles.multiply([curve], COSINES, 0, np.empty(0, int))
    profiles.sums(0, np.log(COSINES))
    known = [StepKinks(curve, levels, pumped.divisor.last_bends)]
    found = profiles.kinks(known, False, np.zeros(COSINES.size))
    fresh = profiles.cut(*found)
    s = profiles.slices
    seen = 0
    for k in fresh.tolist():
        row = profiles.row[s.panel[k]]
        nodes = s.y[s.first[k] : s.first[k] + s.order[k]]
        for level in levels[row][np.isfinite(levels[row])]:
            # No slice has nodes on both sides of a level.
            assert np.all(nodes < level) or np.all(nodes > level)
            seen += 1
    assert seen > 4


@pytest.mark.parametrize("control", [0, 2])
@models
def test_slices_that_only_l_divides_are_divided_as_a_whole(model: Model, control: int) -> None:
    """Where the albedo of L is the larger one, what slices are worth is not summed up again."""
    profiles = profiles_of(model)
    profiles.sums(control, np.log(COSINES))
    s = profiles.slices
    nodes = np.repeat(np.arange(s.panel.size), s.order)
    # Slices of one store lie one after the other, so that their nodes do.
    np.testing.assert_array_equal(s.first, np.cumsum(s.order) - s.order)
    known, off = np.zeros(nodes.size), 1e-14
    for curve in albedo.pump(model, 2).albedos:
        # A curve that changes by no more than half its error is taken to rise, or to fall.
        off += 0.5 * curve.error.max()
        profiles.multiply([curve], COSINES, control, np.empty(0, int))
        at_l = curve.at(folded(COSINES))[profiles.row[s.panel]]
        known += np.maximum(curve.at(s.y), at_l[nodes])
    np.testing.assert_allclose(s.log_product + s.log_scale[nodes], known, rtol=1e-14, atol=off)
    assert 0 < np.count_nonzero(s.log_scale) < s.panel.size or model.spec == "oren_nayar"
    value, error, _ = profiles.sums(control, np.log(COSINES))
    s.stale[:] = True
    again, slack, _ = profiles.sums(control, np.log(COSINES))
    # Two scales, each rounded.
    np.testing.assert_allclose(value, again, rtol=1e-14)
    # Bounds are of the last coefficients, in which roundings are amplified.
    assert np.all(np.abs(error - slack) <= 1e-6 * slack + 64.0 * np.finfo(float).eps * value)


def test_rows_are_chosen_extended_and_replaced() -> None:
    model = MODELS[0]
    some, profiles, other = profiles_of(model), profiles_of(model), profiles_of(model, 1e-9)
    known, coarse = total(profiles)[0], total(other)[0]
    some.keep(np.array([3, 1]))
    value, _, _ = some.sums(0, np.log(COSINES[[3, 1]]))
    np.testing.assert_allclose(value, known[[3, 1]], rtol=1e-15)
    some.extend(profiles)
    value, _, _ = some.sums(0, np.log(np.concatenate((COSINES[[3, 1]], COSINES))))
    np.testing.assert_allclose(value, known[[3, 1, 0, 1, 2, 3, 4]], rtol=1e-15)
    rows = np.array([2, 0])
    profiles.keep(rows)
    other.replace(rows, profiles)
    value, _ = total(other)
    np.testing.assert_allclose(value[rows], known[rows], rtol=1e-15)
    np.testing.assert_allclose(value[[1, 3, 4]], coarse[[1, 3, 4]], rtol=1e-15)
    assert not np.array_equal(value[rows], coarse[rows])


def test_what_is_next_to_nothing_can_be_had_as_precisely() -> None:
    """Each panel to a share of what is as dark or darker, for divisors that lift it."""
    model = albedo.model("blinn", n=20)
    (part,) = model.parts()
    ahead = Ahead(Ladder(model, None, 1e-6).step())
    for chosen in (None, ahead):
        rows = Panels.of(model, part, rings_of(part), COSINES, 1e-11, chosen)
        assert np.all(rows.ahead == int(chosen is not None))
        panels = rows.code, rows.box, rows.row, rows.series[:, 0]
        worst = float((rows.blur / ahead.shares(rows.geometry, *panels)).max())
        assert (worst <= 1e-11) == (chosen is not None)


def test_shares_hold_all_panels_that_are_as_dark() -> None:
    """Beside sums over all pairs of panels."""
    model = albedo.model("blinn", n=20)
    (part,) = model.parts()
    curve = Ladder(model, None, 1e-6).step()
    p = Panels.of(model, part, rings_of(part), COSINES, 1e-8)
    held = p.series[:, 0]
    steps = (0.0, 4.0, 12.0, 30.0)
    found = Ahead(curve, steps).shares(p.geometry, p.code, p.box, p.row, held)
    height = np.array(
        [
            [
                height_at.py_func(p.geometry[r], code[0], code[3], box, t)
                for r, code, box in zip(p.row, p.code, p.box, strict=True)
            ]
            for t in (0.0, 0.5, 1.0)
        ]
    )
    at_l = curve.at(folded(p.geometry[:, 0]))[p.row]
    albedo_of = np.maximum(curve.at(folded(np.sin(height))), at_l)
    least, middle = albedo_of.min(0), albedo_of[1]
    # The same number where V is darker than L, and some ulps elsewhere.
    darker = (p.row == p.row[:, None]) & (middle <= middle[:, None] + 1e-12)
    known = np.min(
        [(darker * (held * np.exp(-k * middle))).sum(1) * np.exp(k * least) for k in steps], axis=0
    )
    np.testing.assert_allclose(found, known, rtol=1e-9)
    whole = np.bincount(p.row, held)[p.row]
    assert np.all(found <= whole * (1.0 + 1e-12))
    assert np.any(found < 1e-6 * whole)
    # With control of the product also as much as any cosine leaves of all.
    clamped = Ahead(curve, steps, True).shares(p.geometry, p.code, p.box, p.row, held)
    cosine = np.maximum(np.sin(height[[0, 2]]), p.geometry[p.row, 0])
    left = np.minimum(1.0, cosine.min(0)[:, None] / cosine.max(0))
    over = ((p.row == p.row[:, None]) * held * left).sum(1)
    np.testing.assert_allclose(clamped, np.minimum(found, over), rtol=1e-9)
    assert np.any(clamped < 0.8 * found)


def test_rounding_is_not_refined_against() -> None:
    """What is next to nothing is had as well as numbers are, without all that may be spent."""
    model = albedo.model("lafortune_scaled")
    (part,) = model.parts()
    c, n = np.geomspace(1e-5, 1e-2, 8), 8
    numbers = np.tile(np.array(model.pack(), dtype=np.float64), (n, 1))
    integrand = ModelIntegrand(part.fill, part.packed(numbers), np.full(n, part.scale))
    done = refine(
        *(rings_of(part), integrand, c, np.zeros(n), np.tile(part.widths, (n, 1)), True),
        rtol=4.5e-13,
        atol=0.0,
        limit=_LIMIT,
        judge_series=_judge_series,
        weigh=Ahead(Ladder(model, None, 1e-6).step()).weights,
    )
    assert np.all(done.spent < 0.25 * _LIMIT)


def test_cells_stay_in_the_heights_that_they_were_cut_from(monkeypatch: pytest.MonkeyPatch) -> None:
    model = albedo.model("he_torrance")
    part, seen = model.parts()[0], []

    def lifted(cells: Cells, rows: _Rows, weight: np.ndarray) -> tuple[_Rows, np.ndarray]:
        of, owner = _heights(cells)
        np.testing.assert_array_equal(rows.of, of)
        np.testing.assert_array_equal(rows.owner, owner)
        seen.append(of.size)
        return _lifted(cells, rows, weight)

    ahead = Ahead(Ladder(model, None, 1e-6).step())
    monkeypatch.setattr(adaptive, "_lifted", lifted)
    Panels.of(model, part, rings_of(part), np.geomspace(1e-5, 1e-2, 8), 1e-12, ahead)
    # Some were halved.
    assert max(seen) > seen[0]


@pytest.mark.parametrize("name", ["ward", "stam_gaussian", "cook_torrance"])
def test_rows_that_begin_with_cells_of_others_are_as_good(name: str) -> None:
    """For less, and as well where panels differ: towards the horizon there are more of them."""
    model = albedo.model(name)
    part, n = model.parts()[0], 60
    c = np.geomspace(1e-6, 1.0, n)
    numbers = np.tile(np.array(model.pack(), dtype=np.float64), (n, 1))
    integrand = ModelIntegrand(part.fill, part.packed(numbers), np.full(n, part.scale))
    row = integrand, c, np.zeros(n), np.tile(part.widths, (n, 1)), True
    how = {"rtol": 1e-11, "atol": 0.0, "limit": _LIMIT, "judge_series": _judge_series}
    alone = refine(rings_of(part), *row, **how)
    taken = refine_alike(rings_of(part), *row, 6, **how)

    def summed(done: Refined) -> tuple[np.ndarray, np.ndarray]:
        cells = done.cells
        error = np.bincount(cells.row, cells.error.sum(1), n) * done.doubt
        return np.bincount(cells.row, cells.value, n), error

    (value, error), (other, bound) = summed(alone), summed(taken)
    # Sums of some thousand terms.
    rounding = 40.0 * np.finfo(float).eps * value
    assert np.all(np.abs(value - other) <= error + bound + rounding)
    assert np.all(bound <= 0.5e-11 * other)
    assert taken.spent.sum() < 0.66 * alone.spent.sum()
    # Every panel is covered once, in the coordinates that its own row has.
    for done in (alone, taken):
        box = done.cells.box
        area = (box[:, 1] - box[:, 0]) * (box[:, 3] - box[:, 2])
        key = np.column_stack((done.cells.row, done.cells.code, box[:, 4:]))
        _, of = np.unique(key, axis=0, return_inverse=True)
        np.testing.assert_allclose(np.bincount(of.ravel(), area), 1.0, rtol=1e-12)


def test_orders_that_would_have_done_are_told_by_spectra() -> None:
    """Cells have no more nodes than before; most do with those, and bounds hold all the same."""
    model = albedo.model("he_torrance")
    part, n = model.parts()[0], 5
    c, chart, rtol = np.geomspace(1e-6, 1.0, n), rings_of(model.parts()[0]), 1e-10
    numbers = np.tile(np.array(model.pack(), dtype=np.float64), (n, 1))
    integrand = ModelIntegrand(part.fill, part.packed(numbers), np.full(n, part.scale))
    row = integrand, c, np.zeros(n), np.tile(part.widths, (n, 1)), True
    how = {"atol": 0.0, "limit": _LIMIT, "judge_series": _judge_series}
    done = refine(chart, *row, rtol=0.01 * rtol, **how)
    cells, atol = done.cells, np.zeros(n)
    own = _enough(done, np.arange(n), 0.01 * rtol, atol, None)
    fewer = _enough(done, np.arange(n), rtol, atol, None)
    assert np.all(fewer <= own)
    assert np.all(own <= cells.order)
    assert fewer.prod(1).sum() < 0.8 * cells.order.prod(1).sum()
    again = Cells.blank(cells.row, cells.code, cells.box, fewer, cells.series.shape[1])
    evaluate(chart, integrand, done.geometry, again)
    _judge_series(again)
    value, other = (np.bincount(some.row, some.value, n) for some in (cells, again))
    error = np.bincount(again.row, again.error.sum(1), n)
    # What falls ever faster errs by more: most do, and the others are refined.
    allowed = 0.25 * rtol * value / np.bincount(cells.row)
    assert np.mean(again.error.sum(1) <= allowed[cells.row]) > 0.5
    # Both have sums of some thousand terms.
    assert np.all(np.abs(value - other) <= error + 40.0 * np.finfo(float).eps * value)
    # What is tolerated anyhow takes next to nothing.
    least = _enough(done, np.arange(n), rtol, 10.0 * value, None)
    assert least.max() <= 8


def test_slices_that_stay_take_over_their_nodes() -> None:
    """Nodes are moved together where there are many holes, and stay where there are few."""
    for kept, moved in ((0.9, False), (0.2, True)):
        slices = profiles_of(MODELS[2]).slices
        order, first = slices.order.copy(), slices.first.copy()
        which = np.arange(order.size) < kept * order.size
        before = [
            slices.density[a : a + q].copy()
            for a, q in zip(first[which], order[which], strict=True)
        ]
        nodes = slices._nodes.size
        slices.keep(which)
        assert (slices._nodes.size < nodes) == moved
        for k, values in enumerate(before):
            mine = slice(slices.first[k], slices.first[k] + slices.order[k])
            np.testing.assert_array_equal(slices.density[mine], values)


def test_stores_grow() -> None:
    store = _Store({"a": np.empty(0, int), "b": np.empty(0)}, 0)
    for k in range(10):
        store.append(a=np.full(k, k))
    assert store.size == 45
    assert store.arrays["a"][:45].sum() == sum(k * k for k in range(10))
    assert np.all(store.arrays["b"][:45] == 0.0)


@pytest.mark.parametrize("before", [0, 4])
def test_room_is_used_again_and_nothing_in_it_is(before: int) -> None:
    """Rows that are laid out where others were have the sums that they have anywhere."""
    expected = total(profiles_of(MODELS[0]))
    others = profiles_of(MODELS[before])
    total(others)
    others.slices.log_product[:] = np.nan
    (part,) = MODELS[0].parts()
    panels = Panels.of(MODELS[0], part, rings_of(part), COSINES, 1e-11)
    for found, wanted in zip(total(Profiles(panels, others.slices)), expected, strict=True):
        np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize("control", CONTROLS)
def test_lifts_are_integrals_of_what_slices_are_multiplied_by(control: str | None) -> None:
    model = albedo.model("lafortune_scaled")
    ladder = Ladder(model, control, 7e-10)
    for _ in range(5):
        ladder.step()
    ladder._pass_on()
    ladder._values()
    (profiles,) = ladder._parts
    s, divisor = profiles.slices, ladder.divisor(5)
    bent = np.flatnonzero(s.bent > 0)[::10]
    assert bent.size > 20 or control
    t = (np.arange(400) + 0.5) / 400.0
    for k in (*bent.tolist(), *range(0, s.panel.size, s.panel.size // 40)):
        i = s.panel[k]
        row, code, size = profiles.row[i], profiles.code[i], s.end[k] - s.start[k]
        known = profiles.geometry[row], code[0], code[3], profiles.box[i]
        view = np.sin([height_at(*known, at) for at in s.start[k] + size * t])
        light = np.full(view.size, ladder._cos[row])
        lift = size * np.exp(-divisor.logs(light, view)).mean()
        # Middles of 400 parts, where roots of the distance begin: (1/400)^1.5 and a few times more.
        np.testing.assert_allclose(s.lift[k], lift, rtol=1e-3)


def test_slices_of_rows_are_told_with_their_rows() -> None:
    profiles = profiles_of(MODELS[2])
    wanted = np.array([True, False, False, True, False])
    which, row = profiles.of_rows(wanted)
    every = profiles.row[profiles.slices.panel]
    np.testing.assert_array_equal(which, np.flatnonzero(wanted[every]))
    np.testing.assert_array_equal(row, every[which])
    assert set(row.tolist()) == {0, 3}
    assert profiles.of_rows(np.zeros(5, dtype=bool))[0].size == 0
