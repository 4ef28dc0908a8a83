"""Curves on fewer pieces, and pieces on rows that were there already."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from numpy.polynomial import chebyshev

from albedo.charts.heights import FIRST, LAST
from albedo.operators.divisor import TERMS, LogCurve, placed
from albedo.operators.joined import joined
from albedo.operators.nodes import MOST
from albedo.operators.pieces import FRESH, Piece, between

BEND = -0.4
Function = Callable[[np.ndarray], np.ndarray]


def of_function(function: Function, edges: np.ndarray, bent: np.ndarray) -> LogCurve:
    """Series through a function on pieces."""
    nodes = chebyshev.chebpts2(TERMS)
    to_series = np.linalg.inv(chebyshev.chebvander(nodes, TERMS - 1))
    share = placed(0.5 * (nodes + 1.0), bent[:, None])
    y = edges[:-1, None] + share * np.diff(edges)[:, None]
    return LogCurve(edges, function(y) @ to_series.T, np.full(bent.size, 1e-12), bent)


def smooth(y: np.ndarray) -> np.ndarray:
    return 0.1 * np.tanh(0.5 * y) + 0.02 * np.cos(2.0 * np.tanh(y))


def kinked(size: float, power: float) -> Function:
    return lambda y: smooth(y) + size * np.maximum(y - BEND, 0.0) ** power


INSIDE = (-20.0, -8.0, -4.0, -3.0, -2.5, -2.0, -1.5, -1.0, -0.7, BEND, 0.0, 0.5)
EDGES = np.array([FIRST, *INSIDE, LAST])
MARKS = np.array([-1.0, BEND, 0.5])


@pytest.mark.parametrize("bent", [0, 1])
def test_ends_at_which_nothing_bends_are_joined_away(bent: int) -> None:
    kinds = np.zeros(EDGES.size - 1, dtype=int)
    kinds[10] = bent
    curve = of_function(smooth, EDGES, kinds)
    found = joined(curve, 1e-11, MARKS)
    assert found.error.size < 0.7 * curve.error.size
    assert np.all(np.isin(found.edges, curve.edges))
    assert found.bends.size == 0
    assert not found.bent.any()
    y = np.linspace(FIRST, LAST, 20_001)
    off = np.abs(found.at(y) - curve.at(y))
    assert np.all(off <= found.bound[found.piece(y)])
    # What it may differ by, what is read of polynomials of few terms, and the curve's own error.
    assert found.error.max() <= 1e-11 + 1e-12


@pytest.mark.parametrize(("size", "power"), [(1e-3, 1.5), (1e-6, 1.5), (1e-4, 1.0), (1e-5, 3.0)])
def test_a_curve_bends_at_the_marks_that_can_be_seen(size: float, power: float) -> None:
    kinds = np.zeros(EDGES.size - 1, dtype=int)
    # Right of the kink the series is in the root of the distance from it.
    kinds[10] = 1
    curve = of_function(kinked(size, power), EDGES, kinds)
    found = joined(curve, 1e-11, MARKS)
    np.testing.assert_array_equal(found.bends, [BEND])
    y = np.linspace(FIRST, LAST, 20_001)
    assert np.all(np.abs(found.at(y) - curve.at(y)) <= found.bound[found.piece(y)])


@pytest.mark.parametrize(("size", "power"), [(1e-3, 1.5), (1e-6, 1.0)])
def test_a_bend_that_nobody_marked_is_seen(size: float, power: float) -> None:
    """What is cut at places without a name may bend there, and slices have to know."""
    # A neighbour that is short leaves the bend to be seen within little.
    edges = np.sort(np.append(EDGES, BEND - 1e-5))
    kinds = np.zeros(edges.size - 1, dtype=int)
    kinds[11] = 1
    curve = of_function(kinked(size, power), edges, kinds)
    found = joined(curve, 1e-11, np.empty(0))
    assert found.bends.size > 0
    assert np.all(np.abs(found.bends - BEND) <= 1e-5)
    # Smooth ends that no series joins are no bends.
    edges = np.union1d(EDGES, np.linspace(-1.0, 1.0, 21))
    steep = of_function(lambda y: np.tanh(8.0 * y), edges, np.zeros(edges.size - 1, dtype=int))
    found = joined(steep, 1e-11, np.empty(0))
    assert found.error.size > 1
    assert found.bends.size == 0


def test_a_kink_below_what_is_allowed_is_joined_away() -> None:
    curve = of_function(kinked(1e-13, 1.5), EDGES, np.zeros(EDGES.size - 1, dtype=int))
    found = joined(curve, 1e-11, MARKS)
    assert found.bends.size == 0
    assert found.error.size < 0.7 * curve.error.size


@pytest.mark.parametrize("gaps", list(FRESH))
@pytest.mark.parametrize("bent", [0, 1, 2])
def test_pieces_among_known_rows_are_as_good_as_they_say(gaps: int, bent: int) -> None:
    """The error of a series is no more than its bound, with fresh points alone."""
    low, high = -0.9, 0.3
    ends = (low, -0.8, -0.6, -0.1, 0.2, high)
    parts = [Piece(a, b, 0, 16).y for a, b in itertools.pairwise(ends)]
    known = np.unique(np.concatenate(parts))
    piece = Piece.among(low, high, bent, gaps, known)
    assert piece is not None
    assert np.all(np.isin(piece.y, known))
    assert np.unique(piece.y).size == piece.y.size == gaps + 1 + FRESH[gaps]
    assert {low, high} <= set(piece.y[: gaps + 1].tolist())
    assert 1.0 <= piece.worse <= 2.0
    assert not piece.may_have_fewer
    assert piece.refined().chosen is None
    assert piece.refined().gaps in (8, 16)

    def function(y: np.ndarray) -> np.ndarray:
        return 1.0 / (1.0 + 4.0 * (y + 0.2) ** 2)

    series = piece.to_series @ function(piece.y[: gaps + 1])
    missed = np.abs(piece.basis @ series - function(piece.y)).max()
    y = np.linspace(low, high, 3000)
    error = np.abs(piece.polynomials(y) @ series - function(y)).max()
    assert error <= piece.trust * piece.worse * missed + 1e-13


def _pieces(kind: str, rng: np.random.Generator) -> Iterator[Piece]:
    """Pieces of one kind, among points that are there by chance."""
    while True:
        bent = int(rng.integers(3))
        ends = np.concatenate(([-0.9, 0.3], rng.uniform(-0.9, 0.3, int(rng.integers(1, 5)))))
        orders = [8, 16]
        parts = [
            Piece(a, b, 0, int(rng.choice(orders))).y for a, b in itertools.pairwise(np.sort(ends))
        ]
        known = np.unique(np.concatenate(parts))
        gaps = int(rng.choice(list(FRESH) if kind == "among" else [4, 8, 16]))
        found: Piece | None = None
        if kind == "plain":
            found = Piece(-0.9, 0.3, bent, gaps)
        elif gaps + 1 + FRESH[gaps] <= 0.7 * known.size:
            found = Piece.among(-0.9, 0.3, bent, gaps, known)
        if found is not None:
            yield found


@pytest.mark.parametrize("kind", ["plain", "among"])
def test_fresh_points_tell_what_corners_nobody_foretold_leave(kind: str) -> None:
    """Up to the trust in them, but for some few places of corners.

    Of 2000 pieces of each kind 2.7 and 0.6 in a hundred had more.
    """
    rng = np.random.default_rng(7)
    y = np.linspace(-0.9, 0.3, 2001)
    told = 0
    for piece in itertools.islice(_pieces(kind, rng), 300):
        corners, sizes = rng.uniform(-0.9, 0.3, 2), rng.uniform(-1.0, 1.0, 2)

        def function(y: np.ndarray, at: np.ndarray = corners, by: np.ndarray = sizes) -> np.ndarray:
            found: np.ndarray = by @ np.abs(y - at[:, None])
            return found

        series = piece.to_series @ function(piece.y[: piece.gaps + 1])
        missed = np.abs(piece.basis @ series - function(piece.y)).max()
        error = np.abs(piece.polynomials(y) @ series - function(y)).max()
        told += bool(error <= piece.trust * piece.worse * missed)
    assert told >= 0.95 * 300


def test_rows_that_crowd_do_not_make_a_piece() -> None:
    crowd = np.concatenate(([-0.9], np.linspace(-0.3, -0.2999, 40), [0.3]))
    assert Piece.among(-0.9, 0.3, 0, 16, crowd) is None


@pytest.mark.parametrize("low", [FIRST, -16.12391650365695, -1.0, 0.9])
@pytest.mark.parametrize("first", [False, True])
@pytest.mark.parametrize("last", [False, True])
def test_nodes_between_bends_differ_however_close_they_are(
    low: float, first: bool, last: bool
) -> None:
    """Down to the least distance of two marks; those that were clustered had been one number."""
    for size in np.geomspace(1.1e-11, 0.1, 60):
        high = low + size
        found = between(low, high, first, last)
        assert [piece.low for piece in found[1:]] == [piece.high for piece in found[:-1]]
        assert (found[0].low, found[-1].high) == (low, high)
        # Ends that bend have the clustered nodes, but where nothing would be left between them.
        assert (found[0].bent == 1, found[-1].bent == 2) == (
            (first, last) if size > 2e-8 else (False, False)
        )
        for piece in found:
            while piece.gaps < MOST:
                piece = piece.refined()
            assert np.unique(piece.y).size == piece.y.size
            assert np.all(np.isfinite(piece.to_series))


@pytest.mark.parametrize("bent", [0, 1, 2])
def test_what_parts_of_a_piece_will_miss_is_told_by_its_series(bent: int) -> None:
    """As their own series on half as many rows miss it, for what the whole holds."""
    whole = Piece(-0.9, 0.3, bent, 16)
    # The first of them is bent as the whole is, the second nowhere, the third on its own.
    parts = Piece(-0.9, -0.2, bent & 1, 8), Piece(-0.2, 0.3, bent & 2, 8), Piece(-0.6, 0.0, 2, 4)

    def function(y: np.ndarray) -> np.ndarray:
        found: np.ndarray = np.exp(1.5 * chebyshev.chebval(whole.polynomials(y)[:, 1], [0, 1]))
        return found

    series = np.zeros(TERMS)
    series[:17] = whole.to_series @ function(whole.y[:17])
    for part in parts:
        own = part.to_series @ function(part.y[: part.gaps + 1])
        y = np.linspace(part.low, part.high, 2000)
        missed = np.abs(part.polynomials(y) @ own - function(y)).max()
        # Coefficients that are left out are aliased: they count twice at most, and here nearly do,
        # because they fall fast and have one sign.
        told = whole.left_out(series, part)
        assert missed <= 2.0 * told + 1e-14
        assert told <= missed + 1e-14
    rich = Piece(-0.9, -0.2, bent & 1, 16)
    assert whole.left_out(series, rich) == 0.0
    assert rich.halved.gaps == 8
    assert set(rich.halved.y.tolist()) <= set(rich.y.tolist())
