"""The assertion that light and view may be exchanged."""

from __future__ import annotations

import numpy as np

from albedo.brdf import Model
from albedo.testing._functions import LOWEST, Function, Values, function_of, lights, places
from albedo.testing._options import check_count, check_number
from albedo.testing._words import pair

_SHOWN = 3


def assert_reciprocal(
    f: Function | Model,
    *,
    rtol: float = 1e-6,
    atol: float = 1e-9,
    samples: int = 20_000,
    lowest_cos_theta: float = LOWEST,
    with_cosine: bool = False,
    seed: int = 0,
) -> None:
    """Assert that a BRDF is the same with light and view exchanged (Helmholtz).

    |f(wi, wo) - f(wo, wi)| is at most max(`atol`, `rtol` times the larger of the two) at pairs of
    directions of all kinds: anywhere, next to the horizon, near the mirror direction, near the
    light, and along the axes exactly.

    Parameters
    ----------
    f : callable or Model
        ``f(wi, wo)``: values in 1/sr, shape (n,), at pairs of unit vectors to the light and to the
        viewer, shape (n, 3), z along the normal, both above the horizon. Or a model, whose Dirac
        parts are left out; one with channels is tested in each.
    rtol : float
        In [0, 1). A lobe of width w that reads raw directions is known to about 1e-16/w^2, and in
        float32 to 1e-7/w^2.
    atol : float
        In 1/sr, in [0, 1): what is smaller than that is dark.
    samples : int
        So many pairs, at least 8; the 169 along the axes come on top.
    lowest_cos_theta : float
        The smallest cosine of a direction, in [1e-9, 0.1).
    with_cosine : bool
        `f` returns f n.v, as renderers do: then f(wi, wo) (n.wi) = f(wo, wi) (n.wo) is what is
        asserted.
    seed : int
        Same seed, same directions.

    Raises
    ------
    AssertionError
        When f(wi, wo) and f(wo, wi) differ by more, or a value is not finite, or negative, or the
        arrays that `f` returns do not fit.
    InputError
        When an option is out of range.

    Notes
    -----
    A difference that lives on less than about 1/`samples` of the pairs may be missed. Half of the
    lights are next to the horizon, and so is a quarter of the views.

    Examples
    --------
    >>> import numpy as np
    >>> from albedo.testing import assert_reciprocal
    >>> def phong(wi, wo, n=20):
    ...     r_v = wi[:, 2] * wo[:, 2] - wi[:, 0] * wo[:, 0] - wi[:, 1] * wo[:, 1]
    ...     return (n + 2) / (2 * np.pi) * np.maximum(r_v, 0) ** n
    >>> assert_reciprocal(phong)
    >>> assert_reciprocal(lambda wi, wo: phong(wi, wo) / wi[:, 2])
    Traceback (most recent call last):
    AssertionError: f is not reciprocal: ...
    """
    __tracebackhide__ = True
    check_number("rtol", rtol, 0.0, 1.0)
    check_number("atol", atol, 0.0, 1.0)
    check_count("samples", samples, 8)
    check_number("lowest_cos_theta", lowest_cos_theta, 1e-9, 0.1)
    check_count("seed", seed, 0)
    rng = np.random.default_rng(seed)
    wi, wo = places(lights(-(-samples // 4), lowest_cos_theta, rng), lowest_cos_theta, rng)
    for values in function_of(f, "f", with_cosine):
        _compare(values, wi, wo, rtol, atol)


def _compare(values: Values, wi: np.ndarray, wo: np.ndarray, rtol: float, atol: float) -> None:
    __tracebackhide__ = True
    there, back = values(wi, wo), values(wo, wi)
    larger = np.maximum(there, back)
    off = np.abs(there - back)
    failed = off > np.maximum(atol, rtol * larger)
    if not failed.any():
        return
    relative = np.where(failed, off / np.where(failed, larger, 1.0), -1.0)
    # The pair with the largest values of those that are about as wrong: it matters most.
    rank = np.lexsort((-larger, -np.round(relative, 2)))
    count = int(np.count_nonzero(failed))
    lines = [
        f"  f(wi, wo) = {there[k]:.9g} and f(wo, wi) = {back[k]:.9g}, {relative[k]:.3g} of the "
        f"larger, at\n{pair(wi[k], wo[k])}"
        for k in rank[: min(_SHOWN, count)].tolist()
    ]
    raise AssertionError(
        f"{values.name} is not reciprocal: {count} of {failed.size} pairs of directions differ by "
        f"more than rtol = {rtol:g} of the larger and atol = {atol:g}, the worst of them\n"
        + "\n".join(lines)
    )
