"""Fresnel factors, unpolarised, as a function of u = cos of the angle of incidence.

Microfacet models take u = v.h. In energy analyses the factor is ``white`` (1). Models call the
kernels; `reflectance` and `average` evaluate the same kernels for arrays.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from albedo._compile import kernel
from albedo.errors import InputError

CODES = {"white": 0, "schlick": 1, "dielectric": 2, "conductor": 3, "lazanyi": 4}


@kernel
def schlick(f0, u, less=-1.0):
    """Schlick 1994, eq. 15: F0 + (1 - F0)(1 - u)^5; `less` is 1 - u where that is known better."""
    # u may be rounded to above 1.
    x = less if less >= 0.0 else max(0.0, 1.0 - u)
    x2 = x * x
    return f0 + (1.0 - f0) * (x2 * x2 * x)


CAREFUL = 0.02
"""From this F0 on 1 - u by subtraction costs F three units in the last place at most."""


@kernel
def is_careful(code, f0):
    """Whether a factor of a code falls so low next to u = 1 that 1 - u must be known better."""
    return (code == 1 or code == 4) and f0 < CAREFUL


@kernel
def schlick_rest(u):
    """1 - (1 - u)^5, expanded so that nothing cancels where u is small."""
    return u * (5.0 + u * (-10.0 + u * (10.0 + u * (-5.0 + u))))


@kernel
def dielectric(n, u):
    """Exact equations for a real relative index n (Cook and Torrance 1982, sect. 2)."""
    if n == 1.0:
        return 0.0
    beside = (n - 1.0) * (n + 1.0)
    g2 = beside + u * u
    if g2 <= 0.0:
        return 1.0
    g = math.sqrt(g2)
    # g - u by the difference of their squares, which is small where the index is next to 1.
    less = beside / (g + u)
    ratio = (u * (g + u) - 1.0) / (u * less + 1.0)
    front = less / (g + u)
    return 0.5 * front * front * (1.0 + ratio * ratio)


@kernel
def dielectric_transmittance(n, u):
    """1 - F of the exact equations for a real relative index n >= 1, without cancellation."""
    if u <= 0.0:
        return 0.0
    if n == 1.0:
        return 1.0
    g = math.sqrt((n - 1.0) * (n + 1.0) + u * u)
    across = u + g
    along = n * n * u + g
    return 2.0 * u * g * (1.0 / (across * across) + n * n / (along * along))


@kernel
def conductor(n, k, u):
    """Exact equations for a complex index n - ik (Schwenk, eqs. 10 to 12)."""
    if n == 1.0 and k == 0.0:
        return 0.0
    s2 = (1.0 - u) * (1.0 + u)
    beside = (n - 1.0) * (n + 1.0) - k * k
    t0 = beside + u * u
    q = math.hypot(t0, 2.0 * n * k)
    # a^2 - b^2 = t0 and a b = n k: the root that does not cancel, and the other by the product.
    if t0 > 0.0:
        a2 = 0.5 * (q + t0)
        a = math.sqrt(a2)
        b2 = (n * k) * (n * k) / a2
    else:
        b2 = 0.5 * (q - t0)
        a = n * k / math.sqrt(b2) if b2 > 0.0 else 0.0
    if a + u == 0.0:
        return 1.0
    # a - u by the difference of their squares, which is small where the index is next to 1.
    off = (beside + b2) / (a + u)
    r_s = (off * off + b2) / ((a + u) * (a + u) + b2)
    along, most, u2b2 = u * a - s2, u * a + s2, u * u * b2
    r_p = r_s * (along * along + u2b2) / (most * most + u2b2)
    return 0.5 * (r_s + r_p)


@kernel
def lazanyi(f0, a, alpha, u, less=-1.0):
    """Schlick's form less its error, a u (1 - u)^alpha (Lazanyi and Szirmay-Kalos 2005)."""
    # u may be rounded to above 1, and a power of a negative number is none.
    x = less if less >= 0.0 else max(0.0, 1.0 - u)
    return max(0.0, schlick(f0, u, x) - a * u * x**alpha)


@kernel
def fresnel(code, a, b, c, u, less=-1.0):
    """The factor that `code` names, of the numbers that `coefficients` gives for it.

    `less` is 1 - u where that is known better: next to u = 1 a factor with F0 = 0 is its power.
    """
    if code == 0:
        return 1.0
    if code == 1:
        return schlick(a, u, less)
    if code == 2:
        return dielectric(a, u)
    if code == 3:
        return conductor(a, b, u)
    return lazanyi(a, b, c, u, less)


@kernel
def fill_factors(code, a, b, c, u, less, out):
    """Fill `out` with factors of one kind, for arrays of its numbers, of cosines and of 1 - u.

    Where 1 - u is not known better than u tells, it is negative.
    """
    for i in range(out.size):
        out[i] = fresnel(code, a[i], b[i], c[i], u[i], less[i])


def schlick_f0(n: ArrayLike, k: ArrayLike = 0.0) -> np.ndarray:
    """Reflectance at normal incidence from the index n - ik.

    Parameters
    ----------
    n, k : array_like
        Relative index of refraction and extinction coefficient.

    Returns
    -------
    ndarray
        F0 = ((n - 1)^2 + k^2)/((n + 1)^2 + k^2).
    """
    n, k = np.asarray(n, dtype=float), np.asarray(k, dtype=float)
    return ((n - 1.0) ** 2 + k * k) / ((n + 1.0) ** 2 + k * k)


LARGEST_F0 = 0.9999
"""To this `ior_from_f0` and `k_from_f0` clamp what they invert: at 1 the index is infinite."""


def _clamped(f0: ArrayLike) -> np.ndarray:
    values = np.asarray(f0, dtype=float)
    if not np.all((values >= 0.0) & (values <= 1.0)):
        raise InputError(f"f0 = {f0!r} is out of range; it must lie in [0, 1]")
    return np.minimum(values, LARGEST_F0)


def ior_from_f0(f0: ArrayLike) -> np.ndarray:
    """Index of refraction n >= 1 of a dielectric (k = 0) from its reflectance.

    Parameters
    ----------
    f0 : array_like
        Reflectance at normal incidence in [0, 1]; above 0.9999 it counts as 0.9999.

    Returns
    -------
    ndarray
        n = (1 + sqrt(F0))/(1 - sqrt(F0)) (Cook and Torrance 1982, sect. 4; Schwenk, eq. 14).
    """
    root = np.sqrt(_clamped(f0))
    return (1.0 + root) / (1.0 - root)


def k_from_f0(f0: ArrayLike) -> np.ndarray:
    """Extinction coefficient of a conductor with n = 1 from its reflectance.

    Parameters
    ----------
    f0 : array_like
        Reflectance at normal incidence in [0, 1]; above 0.9999 it counts as 0.9999.

    Returns
    -------
    ndarray
        k = 2 sqrt(F0/(1 - F0)).
    """
    f0 = _clamped(f0)
    return 2.0 * np.sqrt(f0 / (1.0 - f0))


class LazanyiFit(NamedTuple):
    """The error term a u (1 - u)^alpha of one index, and what it leaves.

    Attributes
    ----------
    a, alpha : float
        Factor and exponent.
    error : float
        Largest |F - F_exact| over the points of the fit.
    """

    a: float
    alpha: float
    error: float


EXPONENTS = (1.0, 100.0)
"""Exponents alpha that `fit_lazanyi` looks through."""


@lru_cache(maxsize=4096)
def fit_lazanyi(n: float, k: float) -> LazanyiFit:
    """Fit the error term of Lazanyi and Szirmay-Kalos to the exact equations.

    Least squares over 201 points, equally spaced in u from 0 to 1. For an exponent alpha the best
    factor a is known, so that one unknown remains: the sum of squares is scanned over alpha in
    [1, 100] and its lowest minimum found by bisection of the derivative.

    Parameters
    ----------
    n, k : float
        Relative index of refraction, n > 0, and extinction coefficient, k >= 0.

    Returns
    -------
    LazanyiFit
        a, alpha and the largest error.

    Examples
    --------
    >>> from albedo.fresnel import fit_lazanyi
    >>> print("%.3f %.2f %.4f" % fit_lazanyi(0.348, 2.714))
    0.154 3.02 0.0024
    """
    u = np.linspace(0.0, 1.0, 201)
    x = 1.0 - u
    off = reflectance("schlick", u, n=n, k=k) - reflectance("conductor", u, n=n, k=k)
    logs = np.log(np.maximum(x, 1e-300))

    def fitted(alpha: float) -> tuple[float, np.ndarray, np.ndarray]:
        """Best a, the term without it, and what remains."""
        term = u * x**alpha
        a = float(term @ off / (term @ term))
        return a, term, off - a * term

    scan = np.geomspace(*EXPONENTS, 400)
    squares = [float(np.sum(fitted(alpha)[2] ** 2)) for alpha in scan]
    best = int(np.argmin(squares))
    low, high = scan[max(best - 1, 0)], scan[min(best + 1, scan.size - 1)]
    if 0 < best < scan.size - 1:
        for _ in range(60):
            middle = 0.5 * (low + high)
            a, term, rest = fitted(middle)
            falls = a * float(rest @ (term * logs)) > 0.0
            low, high = (middle, high) if falls else (low, middle)
    alpha = 0.5 * (low + high) if 0 < best < scan.size - 1 else scan[best]
    a, _, rest = fitted(alpha)
    return LazanyiFit(a, float(alpha), float(np.max(np.abs(rest))))


def stays_a_factor(f0: float, a: float, alpha: float) -> bool:
    """Whether Lazanyi's form with these numbers lies in [0, 1] for all u.

    With x = 1 - u, 1 - F = u ((1 - F0)(1 + x + x^2 + x^3 + x^4) + a x^alpha).
    """
    x = np.linspace(0.0, 1.0, 2001)
    term = a * x**alpha
    below = (1.0 - f0) * (1.0 + x * (1.0 + x * (1.0 + x * (1.0 + x)))) + term
    return bool(np.all(f0 + (1.0 - f0) * x**5 - (1.0 - x) * term >= 0.0) and np.all(below >= 0.0))


def coefficients(
    kind: str,
    *,
    f0: float | None = None,
    n: float = 1.5,
    k: float = 0.0,
    a: float | None = None,
    alpha: float | None = None,
) -> tuple[int, float, float, float]:
    """The code of a Fresnel factor and the three numbers that its kernel reads.

    Parameters
    ----------
    kind : str
        One of `CODES`.
    f0 : float, optional
        schlick: reflectance at normal incidence; without it, that of n and k.
    n, k : float
        Relative index of refraction and extinction coefficient.
    a, alpha : float, optional
        lazanyi: the error term; without them, that of `fit_lazanyi`.

    Returns
    -------
    tuple
        Code, and a, b, c of `fresnel`; 0 where the factor does not read them.
    """
    if kind not in CODES:
        raise InputError(f"unknown Fresnel factor {kind!r}; choose one of {', '.join(CODES)}")
    if not (n > 0.0 and k >= 0.0 and math.isfinite(n) and math.isfinite(k)):
        raise InputError(f"n = {n:g}, k = {k:g} is no index; n must be positive and k not negative")
    code = CODES[kind]
    if kind == "white":
        return code, 0.0, 0.0, 0.0
    if kind == "schlick":
        return code, float(schlick_f0(n, k)) if f0 is None else f0, 0.0, 0.0
    if kind == "dielectric":
        return code, n, 0.0, 0.0
    if kind == "conductor":
        return code, n, k, 0.0
    if (a is None) != (alpha is None):
        raise InputError("lazanyi: give both a and alpha, or neither to have them fitted")
    normal = float(schlick_f0(n, k))
    given = a is not None and alpha is not None
    if a is None or alpha is None:
        a, alpha, _ = fit_lazanyi(n, k)
    if not stays_a_factor(normal, a, alpha):
        what = "given" if given else f"fitted to n = {n:g}, k = {k:g}"
        raise InputError(
            f"lazanyi: a = {a:g}, alpha = {alpha:g}, {what}, make a factor that leaves [0, 1]"
        )
    return code, normal, a, alpha


def reflectance(
    kind: str,
    u: ArrayLike,
    *,
    f0: ArrayLike | None = None,
    n: ArrayLike = 1.5,
    k: ArrayLike = 0.0,
    a: ArrayLike | None = None,
    alpha: ArrayLike | None = None,
) -> np.ndarray:
    """Unpolarised reflectance of a smooth interface.

    Parameters
    ----------
    kind : {"white", "schlick", "dielectric", "conductor", "lazanyi"}
        The equation.
    u : array_like
        Cosine of the angle of incidence, in [0, 1].
    f0 : array_like, optional
        schlick: reflectance at normal incidence; without it, that of n and k.
    n, k : array_like
        Relative index of refraction n - ik; dielectric reads n alone.
    a, alpha : array_like, optional
        lazanyi: the error term; without them, that of `fit_lazanyi`.

    Returns
    -------
    ndarray
        Values in [0, 1]; the arguments broadcast.

    Raises
    ------
    InputError
        For an unknown kind, or values out of range.

    Examples
    --------
    >>> from albedo.fresnel import reflectance
    >>> print(reflectance("dielectric", [1.0, 0.5], n=1.5).round(4))
    [0.04   0.0892]
    """
    cosine = np.asarray(u, dtype=float)
    if not np.all((cosine >= 0.0) & (cosine <= 1.0)):
        raise InputError(f"u = {u!r} is out of range; it must lie in [0, 1]")
    given = {"f0": f0, "n": n, "k": k, "a": a, "alpha": alpha}
    arrays = {key: np.asarray(v, dtype=float) for key, v in given.items() if v is not None}
    shape = np.broadcast_shapes(*(v.shape for v in arrays.values()))
    flat = [np.broadcast_to(v, shape).ravel() for v in arrays.values()]
    rows = [
        coefficients(kind, **dict(zip(arrays, map(float, row), strict=True)))
        for row in zip(*flat, strict=True)
    ]
    code = rows[0][0] if rows else 0
    numbers = [np.array([row[i] for row in rows]).reshape(shape) for i in (1, 2, 3)]
    *numbers, cosine = np.broadcast_arrays(*numbers, cosine)
    out = np.empty(cosine.size)
    flat_arrays = (np.ascontiguousarray(v).ravel() for v in (*numbers, cosine))
    fill_factors(code, *flat_arrays, np.full(cosine.size, -1.0), out)
    return out.reshape(cosine.shape)


def average(
    kind: str,
    *,
    f0: float | None = None,
    n: float = 1.5,
    k: float = 0.0,
    a: float | None = None,
    alpha: float | None = None,
) -> float:
    """Cosine-weighted average of a factor, 2 times the integral of F(u) u over u from 0 to 1.

    By a double exponential rule, cut at the critical angle of n < 1, whose error is a few units
    in the fifteenth digit.

    Parameters
    ----------
    kind : str
        As in `reflectance`.
    f0, n, k, a, alpha : float, optional
        As in `reflectance`.

    Returns
    -------
    float
        The average; it is F0 + (1 - F0)/21 for schlick.
    """
    cut = math.sqrt(min(max((1.0 - n) * (1.0 + n) + k * k, 0.0), 1.0))
    t, step = np.linspace(-3.5, 3.5, 281, retstep=True)
    sinh, cosh = 0.5 * math.pi * np.sinh(t), 0.5 * math.pi * np.cosh(t)
    near, far = 1.0 / (1.0 + np.exp(-2.0 * sinh)), 1.0 / (1.0 + np.exp(2.0 * sinh))
    weight = 2.0 * near * far * cosh * float(step)
    total = 0.0
    for low, high in ((0.0, cut), (cut, 1.0)):
        u = np.where(t < 0.0, low + (high - low) * near, high - (high - low) * far)
        factor = reflectance(kind, np.clip(u, 0.0, 1.0), f0=f0, n=n, k=k, a=a, alpha=alpha)
        total += (high - low) * float(np.sum(weight * factor * u))
    return 2.0 * total
