"""Where a function changes its sign: the next place to look, by Chandrupatla's method.

T. R. Chandrupatla, "A new hybrid quadratic/bisection algorithm for finding the zero of a nonlinear
function without using derivatives", Advances in Engineering Software 28 (1997): inverse quadratic
interpolation where the three values show that it is safe, else bisection.
"""

from __future__ import annotations

from albedo._compile import inlined


@inlined
def next_share(x_1, x_2, x_3, f_1, f_2, f_3, least):
    """The next place between the first two, as a share of the way from the first to the second.

    The values there have two signs. The third is on the side of the first, or is the second; the
    share is not within `least` of 0 or 1.
    """
    gap, rise, share = (x_1 - x_2) / (x_3 - x_2), (f_1 - f_2) / (f_3 - f_2), 0.5
    if gap < 1.0 and rise * rise < gap and (1.0 - rise) * (1.0 - rise) < 1.0 - gap:
        share = f_1 / (f_2 - f_1) * f_3 / (f_2 - f_3) + (x_3 - x_1) / (x_2 - x_1) * f_1 / (
            f_3 - f_1
        ) * f_2 / (f_3 - f_2)
    return min(max(share, least), 1.0 - least)
