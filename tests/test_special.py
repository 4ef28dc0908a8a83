"""The exponential that kernels run side by side, in every arithmetic."""

from __future__ import annotations

import math

import mpmath as mp
import numpy as np

from albedo._compile import in_single, kernel, stands_for
from albedo.analysis.precise import precise, rebuilt, single
from albedo.special import exp

_ULP = 2.0**-52


@kernel
def exponentials(x, out):
    for i in range(x.size):
        out[i] = exp(x[i])


def test_an_exponential_is_right_to_an_ulp_and_a_half(rng: np.random.Generator) -> None:
    x = np.concatenate(
        (rng.uniform(-700.0, 700.0, 3000), rng.uniform(-1.0, 1.0, 3000), [0.0, -0.0, -700.0, 700.0])
    )
    # Where the whole number changes, and the rest is largest.
    x = np.concatenate((x, (np.arange(-1000, 1000) + 0.5) * math.log(2.0)))
    out = np.empty(x.size)
    exponentials(x, out)
    exact = [mp.exp(mp.mpf(a)) for a in x]
    off = np.array([float(abs(mp.mpf(b) / a - 1)) for a, b in zip(exact, out, strict=True)])
    assert off.max() <= 1.5 * _ULP


def test_far_below_there_is_nothing_and_what_is_no_number_stays_so() -> None:
    x, out = np.array([-700.1, -1e4, -1e300, -np.inf, np.nan]), np.empty(5)
    exponentials(x, out)
    np.testing.assert_array_equal(out[:4], 0.0)
    assert math.isnan(out[4])


def test_in_other_arithmetic_it_is_the_function_it_stands_for() -> None:
    assert stands_for(exp) == "exp"
    assert stands_for(exponentials) is None
    x = np.linspace(-80.0, 5.0, 50)
    out = np.empty(50, np.float32)
    in_single(exponentials)(x.astype(np.float32), out)
    np.testing.assert_allclose(out, np.exp(x.astype(np.float32)), rtol=2.0**-22)
    for arithmetic in (single(), precise()):
        given = arithmetic.array(x)
        found = np.empty(50, arithmetic.dtype)
        rebuilt(exponentials, arithmetic)(given, found)
        for a, b in zip(given, found, strict=True):
            assert b == arithmetic.functions["exp"](a)
