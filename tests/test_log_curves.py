"""Curves of albedos as kernels read them, and the points that they are made from."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.polynomial import chebyshev

from albedo.charts.heights import FIRST, LAST
from albedo.operators.divisor import TERMS, LogCurve, curve_along, straight
from albedo.operators.nodes import places
from albedo.operators.pieces import Piece

_EPS = np.finfo(np.float64).eps


def curve_of(rng: np.random.Generator, pieces: int, fall: float, error: float) -> LogCurve:
    """Pieces that crowd at one place, with series that fall so fast."""
    middle = FIRST + (LAST - FIRST) * rng.random()
    crowd = middle + 1e-3 * rng.standard_normal(pieces // 2)
    inside = np.concatenate((crowd, rng.uniform(FIRST, LAST, pieces - 1 - crowd.size)))
    edges = np.unique(np.concatenate(([FIRST, LAST], np.clip(inside, FIRST, LAST))))
    count = edges.size - 1
    coefficients = rng.standard_normal((count, TERMS)) * fall ** np.arange(TERMS)
    bent = rng.integers(0, 3, count)
    return LogCurve(edges, coefficients, np.full(count, error), bent)


@given(
    seed=st.integers(0, 2**32 - 1),
    pieces=st.integers(1, 60),
    fall=st.floats(0.05, 1.0),
    error=st.sampled_from([1e-3, 1e-7, 1e-10, 0.0]),
)
def test_a_curve_is_its_series(seed: int, pieces: int, fall: float, error: float) -> None:
    rng = np.random.default_rng(seed)
    curve = curve_of(rng, pieces, fall, error)
    y = np.concatenate((curve.edges, rng.uniform(FIRST, LAST, 200)))
    k = curve.piece(y)
    u = np.array(
        [
            straight(y[i], curve.edges[k[i]], curve.edges[k[i] + 1], int(curve.bent[k[i]]))
            for i in range(y.size)
        ]
    )
    series = np.array([chebyshev.chebval(u[i], curve.coefficients[k[i]]) for i in range(y.size)])
    # What is left out, and roundings of u, which a series amplifies by its slope, at most 18^2, and
    # by the size of a piece in y.
    size = np.abs(curve.coefficients[k]).sum(1)
    reach = np.maximum(1.0, np.abs(y) / np.diff(curve.edges)[k])
    rounding = 4.0 * TERMS**2 * _EPS * size * np.where(curve.bent[k] > 0, np.sqrt(reach), reach)
    slack = curve.polynomials.left_out[k] + rounding + 1e-14 * size
    # A root's slope has no bound where it begins: its argument is rounded as y is.
    near = np.where(curve.bent[k] > 0, 2.0 * TERMS**2 * size * np.sqrt(reach * 4.0 * _EPS), 0.0)
    assert np.all(np.abs(curve.at(y) - series) <= slack + near)
    allowed = np.maximum(0.01 * error, 8.0 * _EPS * np.abs(curve.coefficients).sum(1))
    told = curve.bound - curve.error
    # Series that do not fall are read on 32 parts, and what that misses is told.
    assert np.all((told <= allowed) | (curve.polynomials.parts == 32))


@given(
    seed=st.integers(0, 2**32 - 1),
    pieces=st.integers(1, 60),
    width=st.floats(1e-6, 1.0),
    up=st.booleans(),
)
def test_a_curve_along_a_slice_is_the_curve(seed: int, pieces: int, width: float, up: bool) -> None:
    """Nodes that rise or fall, over one piece or many, ends of pieces among them."""
    rng = np.random.default_rng(seed)
    curve = curve_of(rng, pieces, 0.3, 1e-10)
    start = rng.uniform(FIRST, LAST)
    y = rng.uniform(start, start + width * (LAST - start), 24)
    y[:2] = rng.choice(curve.edges, 2)
    y = np.sort(y)[:: 1 if up else -1].copy()
    out = np.empty(20)
    curve_along(y, 2, 22, *curve.pieces, 0, out)
    # On an end of a part both its neighbours are the curve.
    bound = 2.0 * curve.polynomials.left_out.max() + 1e-14 * np.abs(curve.coefficients).sum(1).max()
    np.testing.assert_allclose(out, curve.at(y[2:22]), rtol=0.0, atol=bound)


@pytest.mark.parametrize("gaps", [4, 8])
@pytest.mark.parametrize("bent", [0, 1, 2])
def test_a_piece_with_more_nodes_keeps_its_rows(gaps: int, bent: int) -> None:
    piece = Piece(-0.3, 1.7 / 7.0, bent, gaps)
    finer = Piece(-0.3, 1.7 / 7.0, bent, 2 * gaps)
    nodes = finer.y[: 2 * gaps + 1]
    assert np.all(np.isin(piece.y, nodes))
    # Both ends are nodes, shared with neighbours in the same bits.
    assert piece.y[0] == -0.3
    assert piece.y[gaps] == 1.7 / 7.0


@pytest.mark.parametrize("gaps", [4, 8, 16])
def test_fresh_points_lie_between_nodes(gaps: int) -> None:
    t = places(gaps)
    nodes, fresh = t[: gaps + 1], t[gaps + 1 :]
    assert np.all(np.diff(nodes) > 0)
    gap = np.searchsorted(nodes, fresh) - 1
    assert np.unique(gap).size == fresh.size >= gaps // 2
    # From both ends inward.
    assert {0, gaps - 1} <= set(gap.tolist())


def test_a_curve_at_what_is_no_place_reads_no_foreign_memory(rng: np.random.Generator) -> None:
    """Directions that are none give values that are none, and what lies beyond an end is there."""
    curve = curve_of(rng, 30, 0.3, 1e-10)
    found = curve.at(np.array([np.nan, -np.inf, 2.0 * FIRST, np.inf, 2.0 * LAST]))
    assert np.isnan(found[0])
    np.testing.assert_array_equal(found[1:3], curve.at(np.full(2, FIRST)))
    np.testing.assert_array_equal(found[3:], curve.at(np.full(2, LAST)))
