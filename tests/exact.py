"""What is known in closed form, and a second copy of every formula in 40 digits.

The closed forms are albedos that need no quadrature over the hemisphere. The oracles, one file per
model in ``oracles/``, evaluate its BRDF from raw directions with mpmath, straight from its
definition in cosines and angles: nothing of the bookkeeping of half vectors that the package lives
by is repeated there.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Any

import mpmath
import numpy as np

import albedo

Number = Any  # an mpf of the context below

# A context of its own: its precision is nobody else's.
mp = mpmath.MPContext()
mp.dps = 40


# Closed forms ------------------------------------------------------------------------------------

GGX_ALPHA_1_AVERAGE = 4.0 / 3.0 * (1.0 - math.log(2.0))
"""Average albedo of GGX, alpha = 1, height-correlated Smith."""


def ggx_alpha_1(mu: float) -> float:
    """Albedo of GGX with alpha = 1 and height-correlated Smith: 1 - mu log((1 + mu)/mu)."""
    return 1.0 - mu * (math.log1p(mu) - math.log(mu)) if mu > 0.0 else 1.0


def ggx_normal_loss(alpha: float) -> float:
    """1 - albedo at normal incidence of GGX with Smith, as a one-dimensional integral.

    With u = tan^2 of the half vector's angle, D (n.h) dh = alpha^2/(alpha^2 + u)^2 du; V is at
    twice the angle, tan^2 = 4 u/(1 - u)^2, and above the horizon for u < 1.
    """
    a2 = mp.mpf(alpha) ** 2

    def lost(u: Number) -> Number:
        root = mp.sqrt((1 - u) ** 2 + 4 * a2 * u)
        return (root - 1 + u) / (root + 1 - u) * a2 / (a2 + u) ** 2

    cuts = sorted({mp.zero, mp.one, 1 - mp.sqrt(a2)} | {a2 * 8**k for k in range(-2, 30)})
    return float(mp.quad(lost, [c for c in cuts if 0 <= c <= 1]) + a2 / (1 + a2))


def ward_bounded_normal(alpha: float) -> float:
    """Albedo of the bounded Ward model at normal incidence: 1 - alpha^2 (1 - exp(-1/alpha^2))."""
    return 1.0 + alpha * alpha * math.expm1(-1.0 / (alpha * alpha))


def _cosine_power(n: Number, mu: Number) -> Number:
    """The integral of cos(psi)^n from -pi/2 to pi/2 - theta, with mu = cos(theta)."""
    half = mp.beta((n + 1) / 2, mp.mpf("0.5")) / 2
    if (n - 1) * mu * mu > 200:
        # What lies beyond is exp(-100) of it, and its series would take minutes.
        return 2 * half
    return half + mp.betainc(mp.mpf("0.5"), (n + 1) / 2, 0, mu * mu) / 2


def phong(n: float, mu: float) -> float:
    """Albedo of the reciprocal Phong model at any angle, clipped by the horizon.

    With psi the angle from the mirror direction in the plane of incidence and b the angle out of
    it, r.v = cos(b) cos(psi), n.v = cos(b) cos(psi + theta) and dV = cos(b) db dpsi: a product.
    """
    n, mu = mp.mpf(n), mp.mpf(mu)
    across = mp.beta((n + 3) / 2, mp.mpf("0.5"))
    along = mu * _cosine_power(n + 1, mu) + (1 - mu * mu) ** (n / 2 + 1) / (n + 1)
    return float((n + 2) / (2 * mp.pi) * across * along)


def phong_grazing(n: float) -> float:
    """Albedo of the reciprocal Phong model at 90 degrees."""
    n = mp.mpf(n)
    return float((n + 2) / (2 * mp.pi) * mp.beta((n + 1) / 2, mp.mpf("1.5")))


def phong_original(n: float, mu: float) -> float:
    """Albedo of Phong's own model, light fixed."""
    return phong(n, mu) * 2.0 * math.pi / ((n + 2.0) * mu)


def phong_original_view(n: float, mu: float) -> float:
    """Albedo of Phong's own model, view fixed: the cosine that is divided by is that of L."""
    n, mu = mp.mpf(n), mp.mpf(mu)
    return float(mp.beta((n + 2) / 2, mp.mpf("0.5")) * _cosine_power(n, mu))


def max_phong_grazing(n: float) -> float:
    """Albedo of Phong over the larger cosine at 90 degrees."""
    return (n + 2.0) / (2.0 * (n + 1.0))


def blinn_normal(n: float) -> float:
    """The integral of (n.h)^n (n.v) over the hemisphere at normal incidence."""
    return 8.0 * math.pi * (2.0 ** (-0.5 * n) + n) / ((n + 2.0) * (n + 4.0))


def ashikhmin_shirley_diffuse(r_s: float, r_d: float, mu: float) -> float:
    """Albedo of the diffuse term of Ashikhmin and Shirley."""
    return r_d * (1.0 - r_s) * (1.0 - (1.0 - 0.5 * mu) ** 5)


# Fresnel factors and the parts of microfacet models


def fresnel(index: complex, u: Number) -> Number:
    """Unpolarised reflectance from a relative index n - ik, by complex arithmetic."""
    n = mp.mpc(index)
    u = mp.mpf(u)
    inside = mp.sqrt(1 - (1 - u * u) / (n * n))
    across = (u - n * inside) / (u + n * inside)
    along = (n * u - inside) / (n * u + inside)
    return (abs(across) ** 2 + abs(along) ** 2) / 2


@cache
def metal(name: str, source: str, wavelength: float) -> complex:
    """n - ik of a metal, on straight lines between the wavelengths of the table."""
    path = Path(albedo.__file__).with_name("metals.csv")
    rows = [line.split(",") for line in path.read_text("utf-8").split()[1:]]
    data = [[float(x) for x in r[2:]] for r in rows if r[:2] == [source, name]]
    for (a, n_a, k_a), (b, n_b, k_b) in pairwise(data):
        if a <= wavelength <= b:
            t = (wavelength - a) / (b - a)
            return complex(n_a + t * (n_b - n_a), -(k_a + t * (k_b - k_a)))
    raise ValueError(f"no data for {wavelength} um")


def f0(n: Number, k: Number) -> Number:
    """Reflectance at normal incidence."""
    return ((n - 1) ** 2 + k * k) / ((n + 1) ** 2 + k * k)


@cache
def lazanyi_fit(n: float, k: float) -> tuple[Number, Number]:
    """a and alpha of least squares over 201 points, by Newton's method from the best of a scan."""
    start = f0(mp.mpf(n), mp.mpf(k))
    points = [mp.mpf(i) / 200 for i in range(1, 200)]
    off = [start + (1 - start) * (1 - u) ** 5 - fresnel(complex(n, -k), u) for u in points]
    u, o = np.array(points, dtype=float), np.array(off, dtype=float)

    def squares(alpha: float) -> float:
        term = u * (1 - u) ** alpha
        return float(o @ o - (term @ o) ** 2 / (term @ term))

    def equations(a: Number, alpha: Number) -> tuple[Number, Number]:
        terms = [v * (1 - v) ** alpha for v in points]
        rest = [t * (e - a * t) for t, e in zip(terms, off, strict=True)]
        return mp.fsum(rest), mp.fsum(r * mp.log(1 - v) for r, v in zip(rest, points, strict=True))

    alpha = min(np.arange(1.0, 100.0, 0.05), key=squares)
    term = u * (1 - u) ** alpha
    a, alpha = mp.findroot(equations, (float(term @ o / (term @ term)), float(alpha)))
    return a, alpha


def fresnel_of(p: Mapping[str, Any], u: Number) -> Number:
    """The factor that the parameters of a model choose."""
    kind = p["fresnel"]
    if kind == "white":
        return mp.one
    if kind == "dielectric":
        return fresnel(complex(p["ior"], 0.0), u)
    if kind == "conductor":
        return fresnel(complex(p["ior"], -p["k"]), u)
    if kind not in ("schlick", "lazanyi"):
        return fresnel(metal(kind, p["source"], p["wavelength"]), u)
    normal = mp.mpf(p["f0"]) if "f0" in p else f0(mp.mpf(p["ior"]), mp.mpf(p["k"]))
    factor = normal + (1 - normal) * (1 - u) ** 5
    if kind == "schlick":
        return factor
    fitted = "a" not in p
    a, alpha = lazanyi_fit(p["ior"], p["k"]) if fitted else (p["a"], p["alpha"])
    return factor - a * u * (1 - u) ** mp.mpf(alpha)


def beckmann_lambda(a: Number) -> Number:
    """Smith's Lambda for Beckmann slopes, a = 1/(alpha tan(theta))."""
    a = mp.mpf(a)
    # The difference cancels to about a^2 of its terms.
    with mp.workdps(40 + int(4 * mp.log10(1 + a)) + 2):
        return (mp.exp(-a * a) / (a * mp.sqrt(mp.pi)) - mp.erfc(a)) / 2


@cache
def gaussian_scale(m: float) -> Number:
    """What makes the projected integral of exp(-delta^2/m^2) equal to 1."""
    m = mp.mpf(m)
    cuts = [c for c in (m * k for k in (0, 1, 2, 4, 8, 12)) if c < mp.pi / 2] + [
        min(mp.pi / 2, 16 * m)
    ]
    whole = mp.quad(lambda t: mp.exp(-((t / m) ** 2)) * mp.sin(t) * mp.cos(t), cuts)
    return 1 / (2 * mp.pi * whole)


def distribution(
    name: str, width: tuple[float, float], h: Sequence[Number], printed: bool = False
) -> Number:
    """D of a unit half vector; `width` holds the roughnesses or the exponents along x and y."""
    a, b = mp.mpf(width[0]), mp.mpf(width[1])
    x, y, z = h
    if name == "ggx":
        return 1 / (mp.pi * a * b * ((x / a) ** 2 + (y / b) ** 2 + z * z) ** 2)
    if name == "beckmann":
        return mp.exp(-((x / a) ** 2 + (y / b) ** 2) / (z * z)) / (mp.pi * a * b * z**4)
    if name == "blinn_phong":
        return (a + 2) / (2 * mp.pi) * z**a
    if name == "gaussian":
        scale = 1 / (mp.pi * a * a) if printed else gaussian_scale(float(a))
        return scale * mp.exp(-((mp.acos(min(z, mp.one)) / a) ** 2))
    t2 = x * x + y * y
    n = (a * x * x + b * y * y) / t2 if t2 > 0 else a
    more = 1 if printed else 2
    return mp.sqrt((a + more) * (b + more)) / (2 * mp.pi) * z**n


def smith_lambda(
    name: str, width: tuple[float, float], v: Sequence[Number], geometry: str = "smith"
) -> Number:
    """Lambda of a direction; distributions without one of their own borrow Beckmann's.

    For approximate maskings 1/G1 - 1, from G1 as it is published.
    """
    a, b = mp.mpf(width[0]), mp.mpf(width[1])
    if name in ("blinn_phong", "ashikhmin_shirley"):
        a, b = mp.sqrt(2 / (a + 2)), mp.sqrt(2 / (b + 2))
    t2 = ((a * v[0]) ** 2 + (b * v[1]) ** 2) / v[2] ** 2
    if t2 == 0:
        return mp.zero
    if geometry == "schlick_smith":
        k = mp.sqrt(2 / mp.pi) * mp.sqrt(t2) * v[2] / mp.sqrt(v[0] ** 2 + v[1] ** 2)
        return (v[2] * (1 - k) + k) / v[2] - 1
    x = 1 / mp.sqrt(t2)
    if geometry == "smith_rational":
        # Walter et al. 2007, eq. 27, but for what exceeds 1.
        above, below = (
            sum(mp.mpf(c) * x**i for i, c in enumerate(terms))
            for terms in (("0", "3.535", "2.181"), ("1", "2.276", "2.577"))
        )
        g1 = above / below
        return max(1 / g1 - 1, mp.zero) if x < mp.mpf("1.6") else mp.zero
    return (mp.sqrt(1 + t2) - 1) / 2 if name == "ggx" else beckmann_lambda(x)


# What the oracles share


def unit(v: Sequence[float]) -> tuple[Number, ...]:
    v = [mp.mpf(float(x)) for x in v]
    length = mp.sqrt(sum(x * x for x in v))
    return tuple(x / length for x in v)


def dot(a: Sequence[Number], b: Sequence[Number]) -> Number:
    return sum(x * y for x, y in zip(a, b, strict=True))


def half(light: Sequence[Number], view: Sequence[Number]) -> tuple[Number, ...]:
    h = [a + b for a, b in zip(light, view, strict=True)]
    length = mp.sqrt(dot(h, h))
    return tuple(x / length for x in h)


def cos_mirror(light: Sequence[Number], view: Sequence[Number]) -> Number:
    return max(mp.zero, 2 * light[2] * view[2] - dot(light, view))


def power(base: Number, n: Number) -> Number:
    """base^n, with the limit n -> 0 in place of 0^0."""
    return base ** mp.mpf(n) if base > 0 else mp.zero


def ward_exponent(p: Mapping[str, Any], h: Sequence[Number]) -> Number:
    return (h[0] / mp.mpf(p["alpha_x"])) ** 2 + (h[1] / mp.mpf(p["alpha_y"])) ** 2


def ward_scale(p: Mapping[str, Any]) -> Number:
    return mp.mpf(p["rho_s"]) / (4 * mp.pi * mp.mpf(p["alpha_x"]) * mp.mpf(p["alpha_y"]))


def poisson_sum(g: Number, c: Number) -> Number:
    """Sum over m >= 1 of g^m e^-g/(m! m) exp(-c/m).

    Where the terms form a wide bell, as a trapezoid rule over m, which is as exact as the sum.
    """
    g, c = mp.mpf(g), mp.mpf(c)
    if g == 0:
        return mp.zero
    # The largest term is near m log(m/g) = c/m.
    low, top = g, g + mp.sqrt(c) + c / g
    for _ in range(90):
        middle = mp.sqrt(low * top)
        low, top = (low, middle) if middle**2 * mp.log(middle / g) > c else (middle, top)
    wide = 1 / mp.sqrt(1 / top + 2 * c / top**3)
    if wide < 20:
        total, weight, m = mp.zero, mp.exp(-g), 0
        while True:
            m += 1
            weight *= g / m
            term = weight / m * mp.exp(-c / m)
            total += term
            if m > top and term <= total * mp.mpf(10) ** -40:
                return total
    with mp.workdps(60):

        def height(m: Number) -> Number:
            return m * mp.log(g) - g - mp.loggamma(m + 1) - c / m - mp.log(m)

        # exp(-2 (pi/0.4)^2) = 3e-54 is what the steps cost, exp(-17^2/2) = 2e-63 the ends.
        steps = (top + mp.mpf("0.4") * k * wide for k in range(-43, 46))
        return mp.fsum(mp.exp(height(m)) for m in steps if m > 0) * mp.mpf("0.4") * wide


def oracle(name: str) -> Any:
    """The module of ``oracles/`` that holds the second copy of a model, and the sets to try."""
    return import_module(f"oracles.{name}")


def amplification(model: Any) -> float:
    """By how much a model's equation amplifies roundings beyond a lobe's: its oracle may say so."""
    said = getattr(oracle(model.name), "amplification", None)
    return 1.0 if said is None else float(said(model.parameters))


def brdf(model: Any, wi: Sequence[float], wo: Sequence[float]) -> Number:
    """The finite part of a model for raw directions, whose lengths are made 1 exactly."""
    return oracle(model.name).brdf(model.parameters, unit(wi), unit(wo))


def brdf_with_slack(model: Any, wi: np.ndarray, wo: np.ndarray) -> tuple[float, float]:
    """A value, and how far it moves when every coordinate of the directions moves by an ulp."""
    value = brdf(model, wi, wo)
    slack = mp.zero
    for k in range(6):
        pair = np.concatenate((wi, wo))
        pair[k] += np.spacing(max(abs(pair[k]), 1e-300))
        slack += abs(brdf(model, pair[:3], pair[3:]) - value)
    return float(value), float(slack)
