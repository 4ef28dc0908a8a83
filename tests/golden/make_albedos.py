"""Golden directional albedos of the models that `make_golden.py` leaves out, from the oracles.

Writes ``albedos.csv`` beside itself, with the columns of ``albedo.csv``. What is integrated is the
formula of ``tests/oracles``, in mpmath, at directions that are exact in it; of the package only the
grammar of models is used, which reads the parameters.

How the values are made
-----------------------
Every integral is iterated: composite Gauss-Legendre over a second coordinate for each node of the
first, panels graded towards lobes and layers, cut at kinks, and halved where their highest Legendre
coefficients have not died out. The charts, one of which each model names in `INTEGRANDS`:

* ``half``: the angle ``d`` of the half vector to the normal and its azimuth ``psi`` from the plane
  of incidence. With T = tan(theta), V is above the horizon for d < (pi/2 + atan(T cos psi))/2, and
  dV = 4 (l.h) sin d dd dpsi.
* ``plane``: the angle ``x`` of V in the plane of N and an axis, and the angle ``b`` out of it:
  n.v = cos b cos x, dV = cos b db dx. The horizon is an edge, and so is o.v = 0 for a lobe about an
  axis o in the plane.
* ``polar``: elevation and azimuth of V.

Orders of gratings are Dirac parts: their sum is a closed form.

How the digits are demonstrated
-------------------------------
Every value is computed twice, with different orders, panels and working precisions (`RULES`);
``digits`` is floor(-log10(relative difference)), and the value that of the finer rule. Every number
stands for exactly the double that Python reads.

Usage, with the package installed::

    python make_albedos.py                   # add the missing rows to albedos.csv
    python make_albedos.py --only '^schlick' # only models whose name matches
    python make_albedos.py --force           # compute all again
    python make_albedos.py --list            # show the rows wanted
"""

from __future__ import annotations

import argparse
import csv
import math
import re
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import mpmath
import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

exact = import_module("exact")
grammar = import_module("albedo.grammar")
mp = exact.mp

Number = Any  # an mpf of that context
Direction = tuple[Any, Any, Any]
Function = Callable[[Number], Number]

COLUMNS = ("model", "cos_theta", "phi", "value", "digits")
MIN_DIGITS = 13
PRINTED_DIGITS = 25


class Row(NamedTuple):
    """A value that is wanted."""

    model: str
    cos_theta: float
    phi: float = 0.0


# ------------------------------------------------------------------------------------------------
# One-dimensional integration
# ------------------------------------------------------------------------------------------------


class Recipe(NamedTuple):
    """What distinguishes the two computations of a value."""

    order: int
    digits: int
    growth: float
    tolerance: float


RULES = (Recipe(16, 30, 3.0, 1e-15), Recipe(20, 36, 2.0, 1e-16))


class Feature(NamedTuple):
    """A place near which panels are short: no longer than scale + growth times the distance."""

    where: Number
    scale: float


class Rule(NamedTuple):
    """A Gauss-Legendre rule on [-1, 1], and rows that give some Legendre coefficients."""

    nodes: tuple[Number, ...]
    weights: tuple[Number, ...]
    middle: np.ndarray
    last: np.ndarray
    recipe: Recipe


@cache
def gauss_legendre(recipe: Recipe) -> Rule:
    """Nodes by Newton's method from those in float64."""
    n = recipe.order
    start, w = np.polynomial.legendre.leggauss(n)
    nodes, weights = [], []
    with mp.workdps(recipe.digits + 10):
        for guess in start:
            x = mp.mpf(float(guess))
            for _ in range(3):
                before, now = mp.one, x
                for k in range(2, n + 1):
                    before, now = now, ((2 * k - 1) * x * now - (k - 1) * before) / k
                slope = n * (x * now - before) / (x * x - 1)
                x -= now / slope
            nodes.append(x)
            weights.append(2 / ((1 - x) * (1 + x) * slope * slope))
    rows = np.polynomial.legendre.legvander(start, n - 1).T * w * (np.arange(n) + 0.5)[:, None]
    return Rule(tuple(nodes), tuple(weights), rows[n // 2 - 2 : n // 2 + 1], rows[n - 3 :], recipe)


def graded(cuts: Iterable[Number], features: Iterable[Feature], growth: float) -> list[Number]:
    """Ends of panels between the first and the last cut, graded towards the features."""
    places = sorted(set(cuts))
    near = [(f.where, f.scale) for f in features]
    ends = [places[0]]
    for a, b in pairwise(places):
        # From both ends of a piece inwards, so that panels at either are as short as they must be.
        middle = (a + b) / 2
        for start, sign, others in ((a, 1, []), (b, -1, [])):
            at, total = 0.0, float(middle - a)
            gaps = [(float(sign * (where - start)), scale) for where, scale in near]
            while total > 0.0:
                left = total - at
                length = left
                for gap, scale in gaps:
                    d = gap - at
                    limit = (growth * d + scale) / (1 + growth) if d > 0 else scale - growth * d
                    length = min(length, limit)
                length = max(length, total * 1e-25)
                if length >= 0.7 * left:
                    break
                at += length
                others.append(start + sign * mp.mpf(at))
            ends += sorted(others)
            if sign > 0:
                ends.append(middle)
        ends.append(b)
    return sorted(set(ends))


def panel(f: Function, a: Number, b: Number, rule: Rule) -> tuple[Number, float]:
    """The integral over [a, b], and an estimate of its error from the fall of the coefficients."""
    half, middle = (b - a) / 2, (a + b) / 2
    values = [f(middle + half * x) for x in rule.nodes]
    whole = half * mp.fdot(rule.weights, values)
    top = max(abs(v) for v in values)
    if top == 0:
        return whole, 0.0
    scaled = np.array([float(v / top) for v in values])
    centre = float(np.abs(rule.middle @ scaled).max())
    last = float(np.abs(rule.last @ scaled).max())
    ratio = last / centre if centre > last else 1.0
    # Coefficients have roundings of float64, times their degrees: no sign of a kink.
    seen = last > rule.recipe.order * 1e-15
    return whole, 2 * ratio * ratio * last * float(half * top) if seen else 0.0


def integrate(
    f: Function, cuts: Iterable[Number], features: Iterable[Feature], rule: Rule, floor: float = 0.0
) -> Number:
    """The integral between the first and the last cut; `floor` is a size that hardly matters."""
    ends = graded(cuts, features, rule.recipe.growth)
    done = [(a, b, *panel(f, a, b, rule)) for a, b in pairwise(ends)]
    total = max(float(sum(abs(entry[2]) for entry in done)), floor)
    result = mp.zero
    stack = [(*entry, 0) for entry in done]
    while stack:
        a, b, value, error, depth = stack.pop()
        if error <= rule.recipe.tolerance * total or depth >= 60:
            result += value
            continue
        middle = (a + b) / 2
        stack += [(*pair, *panel(f, *pair, rule), depth + 1) for pair in ((a, middle), (middle, b))]
    return result


class Nested:
    """An integral whose integrand is one: what is far below the largest of these hardly matters."""

    def __init__(self, rule: Rule) -> None:
        self.rule, self.largest = rule, 0.0

    def inner(self, f: Function, cuts: Iterable[Number], features: Iterable[Feature]) -> Number:
        found = integrate(f, cuts, features, self.rule, 1e-6 * self.largest)
        self.largest = max(self.largest, float(abs(found)))
        return found


# ------------------------------------------------------------------------------------------------
# Charts
# ------------------------------------------------------------------------------------------------


class Problem:
    """A model and a light, in working numbers, in the frame of the model.

    Attributes
    ----------
    name, p
        The model and its parameters.
    c, s, phi : Number
        Cosine and sine of the angle of incidence, and the azimuth.
    light : tuple of Number
    """

    def __init__(self, row: Row) -> None:
        model = grammar.parse(row.model).model()
        self.name, self.p = model.name, dict(model.parameters)
        self.c, self.phi = mp.mpf(row.cos_theta), mp.mpf(row.phi)
        self.s = mp.sqrt((1 - self.c) * (1 + self.c))
        self.turn = mp.cos(self.phi), mp.sin(self.phi)
        self.light = self.turned((self.s, mp.zero, self.c))
        self.mirror = self.turned((-self.s, mp.zero, self.c))
        self.oracle = exact.oracle(self.name)

    def turned(self, v: Direction) -> Direction:
        """From the frame in which the light has y = 0 into that of the model."""
        cos_phi, sin_phi = self.turn
        return v[0] * cos_phi - v[1] * sin_phi, v[0] * sin_phi + v[1] * cos_phi, v[2]

    def brdf(self, view: Direction, **changed: Any) -> Number:
        return self.oracle.brdf({**self.p, **changed}, self.light, view)


class Half(NamedTuple):
    """What the chart of half vectors has to know of a lobe.

    Attributes
    ----------
    width : float
        In radians of the half vector.
    layer : float
        Cosine n.v below which the integrand has a layer at the horizon.
    cuts : tuple of Number
        Angles of the half vector at which there are kinks.
    azimuths : tuple of (Number, float)
        Azimuths in the frame of the model about which the lobe is narrow, and how narrow; they
        hold for the opposite azimuth as well.
    symmetric : bool
        Whether both sides of the plane of incidence are the same.
    """

    width: float
    layer: float = 1.0
    cuts: tuple[Any, ...] = ()
    azimuths: tuple[tuple[Any, float], ...] = ()
    symmetric: bool = True


def over_half_vectors(problem: Problem, shape: Half, rule: Rule) -> Number:
    """The chart ``half``."""
    c, s, nest = problem.c, problem.s, Nested(rule)

    def around(psi: Number) -> Number:
        cos_psi, sin_psi = mp.cos(psi), mp.sin(psi)
        last = (mp.pi / 2 + mp.atan2(s * cos_psi, c)) / 2

        def height(d: Number) -> Number:
            cos_d, sin_d = mp.cos(d), mp.sin(d)
            l_h = c * cos_d + s * sin_d * cos_psi
            n_v = 2 * l_h * cos_d - c
            view = 2 * l_h * sin_d * cos_psi - s, 2 * l_h * sin_d * sin_psi, n_v
            return problem.brdf(problem.turned(view)) * n_v * 4 * l_h * sin_d

        # n.v falls to 0 at the horizon with twice this slope.
        slope = float(mp.sqrt(c * c + (s * cos_psi) ** 2))
        features = [Feature(mp.zero, 2 * shape.width), Feature(last, 0.5 * shape.layer / slope)]
        features = [f for f in features if f.scale < last]
        return nest.inner(height, [mp.zero, last, *(x for x in shape.cuts if x < last)], features)

    if s == 0 and shape.symmetric:
        return 2 * mp.pi * around(mp.zero)
    turns = 1 if shape.symmetric else 2
    ends = {k * mp.pi / 2 for k in range(2 * turns + 1)}
    # About psi = pi/2 the horizon sweeps across the lobe.
    features = [Feature((k + 0.5) * mp.pi, float(c)) for k in range(turns)]
    for x in shape.cuts:
        reach = mp.tan(2 * x - mp.pi / 2) * c / s if s > 0 else mp.inf
        if abs(reach) < 1:
            where = mp.acos(reach)
            ends |= {where, 2 * mp.pi - where} if turns == 2 else {where}
    for azimuth, narrow in shape.azimuths:
        for k in range(-3, 4):
            place = azimuth + k * mp.pi - problem.phi
            if 0 <= place <= turns * mp.pi:
                features.append(Feature(place, narrow))
                ends.add(place)
    return (3 - turns) * integrate(around, ends, features, rule)


class Lobe(NamedTuple):
    """A lobe in the chart ``plane``: its angle there, and about how wide it is."""

    angle: Any
    width: float


def over_plane(
    value: Callable[[Direction], Number],
    plane: tuple[Any, Any],
    lobes: list[Lobe],
    rule: Rule,
    cuts: Iterable[Number] = (),
    even: bool = True,
) -> Number:
    """The chart ``plane``.

    Parameters
    ----------
    value : callable
        The BRDF at a direction.
    plane : tuple of Number
        Where the plane cuts the surface, a unit vector.
    lobes : list of Lobe
    cuts : iterable of Number
        Angles within the plane at which there are kinks.
    even : bool
        Whether both sides of the plane are the same.
    """
    x_o, y_o = plane
    nest, right = Nested(rule), mp.pi / 2

    def along(x: Number) -> Number:
        sin_x, cos_x = mp.sin(x), mp.cos(x)

        def height(b: Number) -> Number:
            sin_b, cos_b = mp.sin(b), mp.cos(b)
            flat = cos_b * sin_x
            view = flat * x_o - sin_b * y_o, flat * y_o + sin_b * x_o, cos_b * cos_x
            return value(view) * cos_b * cos_b * cos_x

        near = [Feature(mp.zero, 2 * lobe.width) for lobe in lobes]
        return nest.inner(height, [mp.zero, right] if even else [-right, mp.zero, right], near)

    ends = [-right, right, *(lobe.angle for lobe in lobes), *cuts]
    features = [Feature(lobe.angle, 2 * lobe.width) for lobe in lobes]
    found = integrate(along, [x for x in ends if abs(x) <= right], features, rule)
    return 2 * found if even else found


def over_elevations(problem: Problem, width: float, rule: Rule) -> Number:
    """The chart ``polar`` for a lobe about R that ends a right angle away, azimuths from R."""
    nest, c, s = Nested(rule), problem.c, problem.s
    theta = mp.atan2(s, c)

    def ring(t: Number) -> Number:
        sin_t, cos_t = mp.sin(t), mp.cos(t)

        def height(a: Number) -> Number:
            view = -sin_t * mp.cos(a), sin_t * mp.sin(a), cos_t
            return problem.brdf(problem.turned(view)) * cos_t * sin_t

        ends = [mp.zero, mp.pi]
        if cos_t * c < sin_t * s:
            ends.append(mp.acos(-cos_t * c / (sin_t * s)))
        return nest.inner(height, ends, [Feature(mp.zero, 2 * width / max(float(sin_t), width))])

    ends = [mp.zero, mp.pi / 2, theta, mp.pi / 2 - theta]
    return 2 * integrate(ring, ends, [Feature(theta, 2 * width)], rule)


# ------------------------------------------------------------------------------------------------
# Models
# ------------------------------------------------------------------------------------------------


def width_of(n: float) -> float:
    """About how wide a cosine power is."""
    return 1.0 / math.sqrt(float(n) + 1.0)


def lambert(problem: Problem, rule: Rule) -> Number:
    return over_plane(problem.brdf, problem.turn, [], rule)


def strauss(problem: Problem, rule: Rule) -> Number:
    return over_elevations(problem, width_of(3 / (1 - problem.p["smoothness"])), rule)


def granier_heidrich(problem: Problem, rule: Rule) -> Number:
    """Both lobes are about R; that of the base is never clipped for an index above sqrt(2)."""
    angle = -mp.atan2(problem.s, problem.c)
    lobes = [Lobe(angle, width_of(problem.p[e])) for e in ("e0", "e1")]
    return over_plane(problem.brdf, problem.turn, lobes, rule, [angle + mp.pi / 2])


def about_axis(problem: Problem, axis: Direction, n: float, rule: Rule, **changed: Any) -> Number:
    """A power of the cosine to an axis, which ends a right angle from it."""
    across = mp.hypot(axis[0], axis[1])
    plane = (axis[0] / across, axis[1] / across) if across > 0 else (mp.one, mp.zero)
    angle = mp.atan2(across, axis[2])
    cuts = [angle - mp.pi / 2]
    return over_plane(
        lambda view: problem.brdf(view, **changed), plane, [Lobe(angle, width_of(n))], rule, cuts
    )


def lafortune(problem: Problem, rule: Rule) -> Number:
    """Lobe by lobe."""
    total = mp.mpf(problem.p["rho_d"])
    for *scales, n in problem.p["lobes"]:
        x, y, z = (mp.mpf(a) * b for a, b in zip(scales, problem.light, strict=True))
        one = {"lobes": ((*scales, n),), "rho_d": 0.0}
        total += about_axis(problem, (x, y, z), n, rule, **one)
    return total


def lafortune_scaled(problem: Problem, rule: Rule) -> Number:
    x, y, z = problem.mirror
    return about_axis(problem, (x, y, mp.mpf(problem.p["s"]) * z), problem.p["n"], rule)


def lewis(problem: Problem, rule: Rule) -> Number:
    n = problem.p["n"]
    if problem.p["lobe"] == "mirror":
        return about_axis(problem, problem.mirror, n, rule)
    return over_half_vectors(problem, Half(width_of(n)), rule)


def schwenk(problem: Problem, rule: Rule) -> Number:
    n = 2 / (1 + 1 / 255 - problem.p["smoothness"])
    return over_half_vectors(problem, Half(width_of(n)), rule)


def schlick(problem: Problem, rule: Rule) -> Number:
    p = problem.p
    across = ((mp.pi / 2, p["isotropy"]),) if p["isotropy"] < 1 else ()
    shape = Half(math.sqrt(p["roughness"]), p["roughness"], (), across, not across)
    return over_half_vectors(problem, shape, rule)


def distribution_brdf(problem: Problem, rule: Rule) -> Number:
    """n.l + n.v - n.l n.v makes a layer as high as n.l."""
    p, layer = problem.p, float(problem.c)
    if p["distribution"] == "tabulated":
        knots = tuple(mp.mpf(angle) for angle, _ in p["density"] if angle > 0)
        return over_half_vectors(problem, Half(0.3, layer, knots), rule)
    if p["distribution"] in ("velvet", "blinn_phong"):
        width = p["spread"] if p["distribution"] == "velvet" else width_of(p["n"])
        return over_half_vectors(problem, Half(width, layer), rule)
    a, b = p["alpha_x"], p["alpha_y"]
    width = min(a, b)
    if a == b:
        return over_half_vectors(problem, Half(width, layer), rule)
    long = (mp.zero if a > b else mp.pi / 2, width / max(a, b))
    return over_half_vectors(problem, Half(width, layer, (), (long,), False), rule)


def stam_gaussian(problem: Problem, rule: Rule) -> Number:
    p = problem.p
    longest = max(p["t_x"], p["t_y"])
    # The first terms of the series are as wide as the light is long over t, the others wider.
    width = 0.5 * p["wavelength"] / longest
    same = p["t_x"] == p["t_y"]
    narrow = (mp.pi / 2 if p["t_x"] > p["t_y"] else mp.zero, min(p["t_x"], p["t_y"]) / longest)
    shape = Half(width, float(problem.c), (), () if same else (narrow,), same)
    return over_half_vectors(problem, shape, rule)


def stam_grating(problem: Problem, rule: Rule) -> Number:
    """All orders; a closed form."""
    return mp.fsum(problem.oracle.orders(problem.p, problem.light).values())


def poulin_fournier(problem: Problem, rule: Rule) -> Number:
    """Across the cylinders, cut where shadows begin, end and pass one another."""
    oracle, f, spacing = problem.oracle, mp.mpf(problem.p["floor_height"]), problem.p["spacing"]
    spacing, right = mp.mpf(spacing), mp.pi / 2
    cap, w = mp.acos(f), mp.sqrt(1 - f * f)
    light = mp.atan2(problem.light[1], problem.light[2])
    cuts = {light, mp.asin(f)} | ({mp.acos(2 / spacing)} if spacing >= 2 else set())

    def end(psi: Number) -> Number:
        return psi + mp.asin(min(mp.one, spacing * mp.cos(psi) - 1)) - cap

    def shadow(psi: Number) -> Number:
        return f * mp.tan(psi) + spacing - 1 / mp.cos(psi)

    whole = [lambda x: shadow(x) - w, lambda x: shadow(x) - (spacing - w), end]
    cuts |= {x for g in whole for x in roots(g, sorted({*cuts, mp.asin(f), right - mp.eps}))}
    cuts |= {-x for x in cuts}
    places = sorted(x for x in {*cuts, -right + mp.eps, right - mp.eps} if abs(x) < right)
    of_light = oracle.visible(light, spacing, f)

    def seen(k: int) -> Function:
        return lambda x: oracle.visible(x, spacing, f)[k] - of_light[k]

    def floor(x: Number) -> Number:
        view = oracle.visible(x, spacing, f)
        return min(view[3], of_light[3]) - max(view[2], of_light[2])

    cuts |= {x for g in (*map(seen, range(4)), floor) for x in roots(g, places)}
    even = problem.p["base"] == "lambert"
    # A shadow that ends as an arcsine has a root there.
    edges = [Lobe(x, 1e-3) for x in sorted(cuts) if abs(x) < right]
    return over_plane(
        problem.brdf, (mp.zero, mp.one), [], rule, [edge.angle for edge in edges], even
    )


def roots(g: Function, places: list[Number]) -> Iterator[Number]:
    """Where a continuous function changes its sign between places, looked at in 16 steps each."""
    for a, b in pairwise(places):
        steps = [a + (b - a) * k / 16 for k in range(17)]
        for low, high in pairwise(steps):
            before = g(low)
            if before * g(high) < 0:
                for _ in range(mp.prec):
                    middle = (low + high) / 2
                    low, high = (middle, high) if before * g(middle) > 0 else (low, middle)
                yield (low + high) / 2


MODELS: dict[str, Callable[[Problem, Rule], Number]] = {
    function.__name__: function
    for function in (
        *(distribution_brdf, granier_heidrich, lafortune, lafortune_scaled, lambert, lewis),
        *(poulin_fournier, schlick, schwenk, stam_gaussian, stam_grating, strauss),
    )
}


# ------------------------------------------------------------------------------------------------
# The table
# ------------------------------------------------------------------------------------------------

FALLING = "density=((0,9),(0.1,4),(0.25,0.7),(0.6,0.02),(1.3,0.001))"


def table() -> Iterator[Row]:
    """All rows."""

    def grid(models: Iterable[str], cosines: Iterable[float], phi: float = 0.0) -> Iterator[Row]:
        for model in models:
            for c in cosines:
                yield Row(model, c, phi)

    few = (1.0, 0.7, 0.1, 1e-3, 1e-6)
    yield from grid(["lambert:rho=1", "lambert:rho=0.3", "lambert:rho=0.01"], (1.0, 0.5, 1e-6))
    for n in ("0.5", "20", "1e4", "1e8"):
        yield from grid([f"lewis:n={n}"], (1.0, 0.5, 0.01, 1e-6))
        yield from grid([f"lewis:n={n},lobe=mirror"], (0.7, 1e-3))
    yield from grid(["lewis:n=20,reading=per_incidence,rho_s=0.7"], (0.7, 1e-3))
    for lobe in ("-1,-1,1,20", "-0.9,-0.9,1,50", "1,1,1,30", "-1,-1,0.99999,1e6"):
        yield from grid([f"lafortune:lobes=(({lobe}))"], (1.0, 0.5, 1e-3, 1e-6))
    yield from grid(["lafortune:lobes=((-1,-0.7,0.9,12),(0.5,0.9,1,3.5)),rho_d=0.2"], few, 0.7)
    for n, s in ((20, 1.0), (3, 0.5), (1e4, 0.999)):
        yield from grid([f"lafortune_scaled:n={n:g},s={s:g}"], few[:: 1 if n == 20 else 2])
    yield Row("lafortune_scaled:n=20,s=0.9", 0.3)
    for more in ("smoothness=0", "smoothness=0.5,metalness=0.5,color=0.5", "smoothness=0.95"):
        yield from grid([f"strauss:{more}"], few)
    for more in ("ior=1.5", "ior=2,e0=1000,e1=300,k_d=0.3", "e0=1e5,e1=5,normalization=phong"):
        yield from grid([f"granier_heidrich:{more}"], (1.0, 0.7, 1e-3, 1e-6))
    for r in ("1", "0.01", "1e-6"):
        yield from grid([f"schlick:roughness={r}"], (1.0, 0.5, 1e-6))
    yield from grid(["schlick:roughness=0.7,form=final,color=0.5"], (0.1,))
    yield from grid(["schlick:roughness=0.04,isotropy=0.1"], (0.5, 0.01), 0.7)
    for s in ("0", "0.5", "1"):
        yield from grid([f"schwenk:smoothness={s},metalness=0.5,color=0.6"], (1.0, 0.7, 1e-3, 1e-6))
    yield from grid(["schwenk:smoothness=0.8,level=3,color=0.3"], (0.5,))
    for more in ("m=1,distribution=ggx", "m=0.1", "m=1e-4,distribution=ggx"):
        yield from grid([f"distribution_brdf:{more}"], (1.0, 0.5, 1e-6))
    more = "alpha_x=0.4,alpha_y=0.1,distribution=ggx"
    yield from grid([f"distribution_brdf:{more}"], (0.5,), 0.7)
    yield from grid(["distribution_brdf:distribution=velvet,fresnel=schlick,f0=0.04"], (0.7,))
    more = f"distribution=tabulated,{FALLING},normalization=solid_angle"
    yield from grid([f"distribution_brdf:{more}"], (0.7,))
    yield from grid(["stam_grating"], few)
    yield from grid(["stam_grating:depth=0.6,period=4.1"], few, 0.7)
    yield from grid(["stam_grating:profile=lamellar,duty=0.3,period=0.9"], (0.7, 0.1), 1.2)
    yield from grid(["stam_grating:profile=lamellar,duty=0.5,period=30"], (0.7, 1e-6), 0.2)
    for shape in ("spacing=3,floor_height=0.5", "spacing=2,floor_height=0,rho=0.7"):
        yield from grid([f"poulin_fournier:{shape}"], (1.0, 0.5, 0.01), 0.7)
        yield from grid([f"poulin_fournier:{shape}"], (0.7, 1e-6), math.pi / 2)
    yield from grid(["poulin_fournier:spacing=6,floor_height=0.3"], (0.7, 1e-3), 1.2)
    # Its series takes a millisecond, so most rows are at normal incidence, where a line is enough.
    upright = (
        "1e-3",
        "0.05",
        "0.1",
        "0.2,t_x=3,t_y=3",
        "0.1,t_x=10,t_y=10",
        "0.02,t_x=0.3,t_y=0.3",
    )
    for more in upright:
        yield Row(f"stam_gaussian:sigma={more},mirror=off", 1.0)
    yield Row("stam_gaussian:sigma=0.5,t_x=3,t_y=3,mirror=off", 1.0)
    yield from grid(["stam_gaussian:sigma=0.02,mirror=off"], few)


def key(row: Row) -> tuple[str, str, str]:
    """How a row is recognised in the file."""
    return row.model, repr(row.cos_theta), repr(row.phi)


def read_rows(path: Path) -> list[dict[str, str]]:
    """Rows already in the file."""
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def write_rows(path: Path, rows: list[dict[str, str]]) -> None:
    """A file with these rows in the order of the table, put in place in one step."""
    place = {key(row): i for i, row in enumerate(table())}
    rows.sort(key=lambda r: place.get((r["model"], r["cos_theta"], r["phi"]), len(place)))
    fresh = path.with_suffix(".tmp")
    with fresh.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    fresh.replace(path)


def forget() -> None:
    """What oracles remember was computed with the precision of one rule."""
    modules = [exact, *(exact.oracle(name) for name in MODELS)]
    for module in modules:
        for thing in vars(module).values():
            if hasattr(thing, "cache_clear"):
                thing.cache_clear()


def compute(rows: list[Row]) -> Iterator[tuple[Row, str, int]]:
    """Values and digits of the rows of one model, by both rules."""
    found: list[list[Number]] = []
    for recipe in RULES:
        forget()
        values = []
        with mp.workdps(recipe.digits):
            for row in rows:
                begin = time.perf_counter()
                problem = Problem(row)
                values.append(MODELS[problem.name](problem, gauss_legendre(recipe)))
                print(*key(row), f"{time.perf_counter() - begin:.1f} s", flush=True)
        found.append(values)
    for row, coarse, fine in zip(rows, *found, strict=True):
        off = abs(coarse - fine) / abs(fine) if fine != 0 else abs(coarse)
        digits = PRINTED_DIGITS if off == 0 else int(mpmath.floor(-mpmath.log10(off)))
        text = mpmath.nstr(fine, PRINTED_DIGITS, min_fixed=1, max_fixed=0, strip_zeros=False)
        yield row, text, min(digits, PRINTED_DIGITS)


def main(argv: list[str] | None = None) -> int:
    """Compute what is missing."""
    result = argparse.ArgumentParser(description="Write golden albedos from the oracles.")
    result.add_argument("--out", type=Path, default=HERE / "albedos.csv", help="the CSV file")
    result.add_argument("--only", default="", metavar="PATTERN", help="regular expression on model")
    result.add_argument("--force", action="store_true", help="compute rows already there again")
    result.add_argument("--list", action="store_true", help="print the wanted rows and stop")
    args = result.parse_args(argv)
    wanted = [row for row in dict.fromkeys(table()) if re.search(args.only, row.model)]
    if args.list:
        for row in wanted:
            print(*key(row))
        return 0
    names = {key(row) for row in wanted}
    everything = {key(row) for row in table()}
    kept = [r for r in read_rows(args.out) if (r["model"], r["cos_theta"], r["phi"]) in everything]
    if args.force:
        kept = [r for r in kept if (r["model"], r["cos_theta"], r["phi"]) not in names]
    known = {(r["model"], r["cos_theta"], r["phi"]) for r in kept}
    missing: dict[str, list[Row]] = {}
    for row in wanted:
        if key(row) not in known:
            missing.setdefault(row.model, []).append(row)
    weak, begin = 0, time.perf_counter()
    for rows in missing.values():
        for row, text, digits in compute(rows):
            print(*key(row), text, digits, flush=True)
            if digits < MIN_DIGITS:
                weak += 1
                print("  fewer digits than wanted: row left out", file=sys.stderr, flush=True)
                continue
            kept.append(dict(zip(COLUMNS, (*key(row), text, str(digits)), strict=True)))
        write_rows(args.out, kept)
    print(f"{time.perf_counter() - begin:.0f} s, {weak} rows left out")
    return 1 if weak else 0


if __name__ == "__main__":
    sys.exit(main())
