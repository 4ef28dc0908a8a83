"""Places on a piece of y: Chebyshev's nodes with both ends, and fresh points that confirm them."""

from __future__ import annotations

from functools import cache

import numpy as np

from albedo.charts.heights import LOWEST, unfolded

MOST = 16
"""Gaps between the nodes of a piece, at most."""
FEWEST = 4
# Between its nodes an interpolant errs most. Fresh points stand in every second gap, from both
# ends inward: what a gap between them hides is not many times as much.
TRUST = 8.0
# What errors at the nodes may come to between them: the Lebesgue constant of 17 nodes.
LEBESGUE = 2.8


@cache
def places(gaps: int) -> np.ndarray:
    """Places on a piece, from 0 to 1: Chebyshev's nodes with both ends, then fresh points.

    All are nodes where there are twice as many gaps, in the same bits.
    """
    fine = 2 * MOST // gaps
    grid = np.sin(0.25 * np.pi / MOST * np.arange(2 * MOST + 1)) ** 2
    lower = np.arange(0, gaps // 2, 1 if gaps == FEWEST else 2)
    fresh = np.concatenate((lower, gaps - 1 - lower))
    return np.concatenate((grid[::fine], grid[fresh * fine + fine // 2]))


def cosines(y: np.ndarray) -> np.ndarray:
    """Of incidences at y."""
    return np.clip(unfolded(y), LOWEST, 1.0)
