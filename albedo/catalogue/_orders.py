"""The sum over orders of scattering by a Gaussian random surface, which several models have."""

from __future__ import annotations

import math

from albedo._compile import inlined, kernel
from albedo.special import exp

SIDE = 32
"""Series that are summed side by side."""
ALONE = 8
"""Fewer series are summed faster one by one, with terms side by side."""
# Up to here they are.
_FEW = 40.0


@kernel
def log_weight(g, m):
    """ln of g^m e^-g/m!, for m > 30 (Loader 2000)."""
    d = (m - g) / (m + g)
    if abs(d) < 0.1:
        # m log(m/g) + g - m without cancellation: 2 m sum_k d^(2k+1)/(2k+1) - (m - g).
        deviance = (m - g) * d
        power = 2.0 * m * d
        for k in range(1, 12):
            power *= d * d
            deviance += power / (2 * k + 1)
    else:
        deviance = m * math.log(m / g) + g - m
    m2 = m * m
    stirling = (1.0 / 12.0 - (1.0 / 360.0 - (1.0 / 1260.0 - 1.0 / (1680.0 * m2)) / m2) / m2) / m
    return -deviance - stirling


@inlined
def _eight_terms(first, way, c, root, rest, heights, over):
    """Fill the roots of exp(-c/m) root^2 rest^2, and them over m, for eight m up or down."""
    for j in range(heights.size):
        m = max(first + way * j, 1.0)
        height = root * exp(-0.5 * c / m) * rest
        heights[j] = height
        over[j] = height / m


@inlined
def _eight_weights(weight, ratios, heights, over):
    """Make weights of their ratios, the first to a given one; the sum of the terms, and the last.

    Terms are summed in pairs: nothing waits long for what comes before.
    """
    w_0 = weight * ratios[0]
    w_1 = w_0 * ratios[1]
    w_2 = w_1 * ratios[2]
    w_3 = w_2 * ratios[3]
    w_4 = w_3 * ratios[4]
    w_5 = w_4 * ratios[5]
    w_6 = w_5 * ratios[6]
    w_7 = w_6 * ratios[7]
    t_01 = w_0 * heights[0] * over[0] + w_1 * heights[1] * over[1]
    t_23 = w_2 * heights[2] * over[2] + w_3 * heights[3] * over[3]
    t_45 = w_4 * heights[4] * over[4] + w_5 * heights[5] * over[5]
    before, last = w_6 * heights[6] * over[6], w_7 * heights[7] * over[7]
    return (t_01 + t_23) + (t_45 + (before + last)), before, last, w_7


@kernel
def _huge_terms(weight, ratios, heights, over):
    """The sum of terms up to the first that is about to leave the range of numbers."""
    total = 0.0
    for j in range(heights.size):
        weight *= ratios[j]
        total += weight * heights[j] * over[j]
        if weight <= 1e-300 or heights[j] > 1e200:
            break
    return total


@kernel
def poisson_series(g, c, root, rest, room):
    """(root rest)^2 times the sum over m >= 1 of g^(m-1) e^-g/(m! m) exp(-c/m), root-wise.

    That is the series of He et al. 1991, eq. 78, over g, and what it is multiplied by: the series
    alone may be below the range of numbers. Up to g = 40 it starts with m = 1, up to 100 with the
    largest term, before which e^-g is below what float32 has. Above, the sum is a trapezoid rule
    of a smooth function, so a wider step around the largest term gives the same number.

    The room is three arrays of eight numbers: the terms come eight at a time, side by side.
    """
    ratios, heights, over = room
    if g <= 40.0:
        weight, total, first = math.exp(-g), 0.0, 1.0
        while True:
            _eight_terms(first, 1.0, c, root, rest, heights, over)
            for j in range(heights.size):
                ratios[j] = g / (first + j)
            if first == 1.0:
                ratios[0] = 1.0
            # They rise with m.
            if heights[7] > 1e200:
                return total + _huge_terms(weight, ratios, heights, over)
            some, before, last, weight = _eight_weights(weight, ratios, heights, over)
            total += some
            # The first terms of a far tail underflow: only a falling term ends the sum.
            if (total > 0.0 and last <= before and last <= 1e-17 * total) or weight <= 1e-300:
                return total
            first += 8.0
    # The largest term: m log(m/g) = c/m.
    m0 = g + c / g
    for _ in range(6):
        m0 -= (m0 * math.log(m0 / g) - c / m0) / (math.log(m0 / g) + 1.0 + c / (m0 * m0))
    if g <= 100.0:
        # Its floor, without an integer on the way.
        m0 -= m0 % 1.0
        largest = math.exp(log_weight(g, m0)) / (g * math.sqrt(2.0 * math.pi * m0))
        total = 0.0
        for side in range(2):
            way = 1.0 - 2.0 * side
            weight, first = largest, m0 - side
            while first >= 1.0:
                _eight_terms(first, way, c, root, rest, heights, over)
                for j in range(heights.size):
                    m = first + way * j
                    ratios[j] = g / m if side == 0 else (m + 1.0) / g
                    # Down to the first term, and no further.
                    if m < 1.0:
                        ratios[j] = 0.0
                if first == m0:
                    ratios[0] = 1.0
                some, _, last, weight = _eight_weights(weight, ratios, heights, over)
                total += some
                if last <= 1e-17 * total:
                    break
                first += 8.0 * way
        return total
    step = 0.55 / math.sqrt(1.0 / m0 + 2.0 * c / (m0 * m0 * m0))
    # A step that m0 can be added to exactly: nodes that are rounded cost sqrt(g) ulps.
    step = (m0 + step) - m0
    total = 0.0
    for j in range(-17, 20):
        m = m0 + j * step
        if m < 1.0:
            continue
        height = root * math.exp(0.5 * (log_weight(g, m) - c / m)) * rest
        total += height * (height * (step / g / (m * math.sqrt(2.0 * math.pi * m))))
    return total


@inlined
def _few_terms(g, c, weight, term, total):
    """Fill sums as of `poisson_series` with roots that are 1, for g up to 40, side by side.

    All have as many terms as one needs.
    """
    for i in range(g.size):
        weight[i] = exp(-g[i])
        total[i] = weight[i] * exp(-c[i])
    m, left = 1.0, True
    while left:
        # Four terms share the constants of their exponentials, and what is loaded.
        a_1, a_2, a_3, a_4 = 1.0 / (m + 1.0), 1.0 / (m + 2.0), 1.0 / (m + 3.0), 1.0 / (m + 4.0)
        m += 4.0
        for i in range(g.size):
            w_1 = weight[i] * (g[i] * a_1)
            w_2 = w_1 * (g[i] * a_2)
            w_3 = w_2 * (g[i] * a_3)
            weight[i] = w_3 * (g[i] * a_4)
            term[i] = weight[i] * (a_4 * exp(-c[i] * a_4))
            some = total[i] + w_1 * (a_1 * exp(-c[i] * a_1))
            some += w_2 * (a_2 * exp(-c[i] * a_2))
            some += w_3 * (a_3 * exp(-c[i] * a_3))
            total[i] = some + term[i]
        # Terms rise and then fall, ever faster: one that hardly counts is beyond the largest.
        most = 0.0
        for i in range(g.size):
            most = max(most, term[i] - 1e-17 * total[i])
        left = most > 0.0


@kernel
def fill_series(g, c, root, rest, side, room, out):
    """Fill what `poisson_series` gives for many numbers, in a third of the time or less.

    Beside its room there is one of five arrays of `SIDE` numbers.
    """
    few_g, few_c, weight, term, total = side
    # Sums that are no less have lost nothing; float32 has fewer numbers.
    small = exp(-600.0) if exp(-600.0) > 0.0 else exp(-60.0)
    for first in range(0, g.size, few_g.size):
        n = min(few_g.size, g.size - first)
        for i in range(n):
            few = g[first + i] <= _FEW
            few_g[i] = g[first + i] if few else 0.0
            few_c[i] = c[first + i] if few else 0.0
        _few_terms(few_g[:n], few_c[:n], weight, term, total)
        for i in range(n):
            k = first + i
            if g[k] <= _FEW and total[i] >= small:
                whole = root[k] * rest[k]
                out[k] = total[i] * whole * whole
            else:
                out[k] = poisson_series(g[k], c[k], root[k], rest[k], room)
