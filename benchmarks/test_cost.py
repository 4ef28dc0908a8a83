"""What an albedo costs, and what the strongest general methods need for the same.

    pytest benchmarks --benchmark-columns=median,iqr,rounds

Every benchmark carries evaluations per entry and nanoseconds per evaluation in its extra info,
printed at the end; ratios hold within one run. Not part of the pass/fail tests.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from statistics import median

import numpy as np
import pytest

import albedo
from albedo.brdf import Model, Part
from albedo.directions import spherical
from albedo.integrators import cells
from albedo.operators.ladder import Ladder

COS = 0.5
MODELS = {
    "ggx m=0.3": albedo.model(
        "cook_torrance", m=0.3, distribution="ggx", geometry="smith_correlated"
    ),
    "ward m=0.1": albedo.model("ward", m=0.1),
    "ward m=0.001": albedo.model("ward", m=0.001),
}
AXIS = np.linspace(0.02, 1.0, 32)
EXPONENTS = 2.0 / AXIS**2 - 1.0
TABLES = {
    "ggx": (MODELS["ggx m=0.3"], {"m": AXIS}),
    "cook_torrance": (albedo.model("cook_torrance"), {"m": AXIS}),
    "ward": (albedo.model("ward"), {"m": AXIS}),
    "ward_bounded": (albedo.model("ward_bounded"), {"m": AXIS}),
    "phong": (albedo.model("phong"), {"n": EXPONENTS}),
    "max_phong": (albedo.model("max_phong"), {"n": EXPONENTS}),
    "blinn": (albedo.model("blinn"), {"n": EXPONENTS}),
    "ashikhmin_shirley": (albedo.model("ashikhmin_shirley"), {"n": EXPONENTS}),
    "he_torrance": (albedo.model("he_torrance"), {"sigma0": np.linspace(0.02, 0.5, 32)}),
}


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("name", TABLES)
def test_table_32_by_32(benchmark, name: str, threads: int) -> None:
    """1024 entries at 1e-8."""
    model, sweep = TABLES[name]
    cosines = np.linspace(0.01, 1.0, 32)
    result = benchmark.pedantic(
        lambda: albedo.table(model, cosines, sweep=sweep, threads=threads),
        rounds=5,
        warmup_rounds=1,
    )
    count = result.evaluations.values
    spent = benchmark.stats.stats.median
    benchmark.extra_info["evaluations per entry"] = float(np.median(count))
    benchmark.extra_info["ns per evaluation"] = 1e9 * spent / float(count.sum())
    print(
        f"\n{name}, {threads} thread(s): {spent:.3f} s, {np.median(count):.0f} evaluations per "
        f"entry (most {count.max()}), {1e9 * spent / count.sum():.0f} ns per evaluation"
    )


@pytest.mark.parametrize("name", [name for name in TABLES if name != "he_torrance"])
def test_two_threads(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """How much faster two threads are, and what the machine lets two threads have.

    Two processors that share a core, or their time with others, take longer for the same work
    when both are busy. So pairs of runs are told apart by the processor time of the kernels, which
    a machine with two free cores does not change.
    """
    model, sweep = TABLES[name]
    cosines = np.linspace(0.01, 1.0, 32)
    real, kernels = cells._sweep, []

    def counted(*arguments: object) -> None:
        start = time.thread_time()
        real(*arguments)
        kernels.append(time.thread_time() - start)

    monkeypatch.setattr(cells, "_sweep", counted)

    def run(threads: int) -> tuple[float, float]:
        kernels.clear()
        start = time.perf_counter()
        albedo.table(model, cosines, sweep=sweep, threads=threads)
        return time.perf_counter() - start, sum(kernels)

    run(1), run(2)
    pairs = [(run(1), run(2)) for _ in range(21)]
    quiet = [one[0] / two[0] for one, two in pairs if two[1] < 1.05 * one[1]]
    every = median(one[0] / two[0] for one, two in pairs)
    growth = median(two[1] / one[1] for one, two in pairs)
    free = f"{median(quiet):.2f}" if quiet else "none"
    print(
        f"\n{name}, two threads: {every:.2f} times faster in the median of {len(pairs)} pairs, in "
        f"which the kernels took {growth:.2f} times the processor time; {free} in the {len(quiet)} "
        "pairs in which they took less than 1.05 times"
    )


SAMPLED = {
    "lambert": (albedo.model("lambert"), "cosine"),
    "ggx, visible normals": (
        albedo.model("cook_torrance", m=0.3, distribution="ggx", geometry="smith"),
        "model",
    ),
    "beckmann, visible normals": (albedo.model("cook_torrance", geometry="smith"), "model"),
    "ashikhmin_shirley": (albedo.model("ashikhmin_shirley"), "model"),
    "ward": (albedo.model("ward"), "model"),
    "phong": (albedo.model("phong"), "model"),
}


@pytest.mark.parametrize("name", SAMPLED)
def test_samples_per_second(benchmark, name: str) -> None:
    """Four million random draws on one core: points, directions, densities, values and sums."""
    model, strategy = SAMPLED[name]
    count = 4_000_000
    benchmark.pedantic(
        lambda: albedo.monte_carlo_albedo(model, COS, samples=count, strategy=strategy),
        rounds=5,
        warmup_rounds=1,
    )
    rate = count / benchmark.stats.stats.median
    benchmark.extra_info["million samples per second"] = 1e-6 * rate
    print(f"\n{name}: {1e-6 * rate:.1f} million samples per second")


PUMPED = {
    "phong": albedo.model("phong", n=20),
    "blinn": albedo.model("blinn", n=20),
    "ward": albedo.model("ward", m=0.4),
    "ggx": MODELS["ggx m=0.3"],
    "oren_nayar": albedo.model("oren_nayar"),
}


@pytest.mark.parametrize("name", PUMPED)
def test_twenty_steps(benchmark, name: str) -> None:
    """All albedos of twenty steps of pumping-up, worth 1e-9 and 1.2e-10, nothing known before."""
    for rtol in (1e-9, 1.2e-10):

        def climb(rtol: float = rtol) -> Ladder:
            found = Ladder(PUMPED[name], None, rtol)
            while len(found.curves) < 20:
                found.step()
            return found

        found, spent = climb(), timed(climb, 3)
        benchmark.extra_info[f"seconds at {rtol:g}"] = spent
        print(f"\n{name}: {spent:.2f} s for curves of {rtol:g}, which leave {found.doubt(20):.1e}")
    benchmark.pedantic(lambda: None)


@pytest.mark.parametrize("steps", [1, 3, 10])
@pytest.mark.parametrize("name", ["phong", "ward"])
def test_pumped_evaluation(benchmark, name: str, steps: int) -> None:
    """A value of a pumped model beside one of its base, in pairs: a row of 2048 views."""
    base, pumped = PUMPED[name], albedo.pump(PUMPED[name], steps)
    rng = np.random.default_rng(1)
    wi = spherical(np.array([COS]), 0.0).T.copy()
    wo = spherical(rng.random(2048), rng.uniform(-3, 3, 2048)).T.reshape(3, 1, -1).copy()
    h, out = wo + wi[:, :, None], np.empty((1, 2048))
    p = np.array([base.pack()])
    seconds = []
    for model in (base, pumped):
        (part,) = model.parts()
        numbers = part.packed(p)

        def fill(part: Part = part, numbers: np.ndarray = numbers) -> None:
            for _ in range(50):
                part.fill(wi, wo, h, numbers, out)

        seconds.append(timed(fill, 15))
    own, whole = (1e9 * spent / (50 * 2048) for spent in seconds)
    benchmark.extra_info["ns more per value"] = whole - own
    one = ", one table" if pumped.divisor.collapsed else ""
    print(f"\n{name}, {steps} steps{one}: {own:.0f} ns, pumped {whole - own:.0f} ns more")
    benchmark.pedantic(lambda: None)


def slopes(model: Model) -> Callable[[np.ndarray], np.ndarray]:
    """The integrand in half-vector slopes on [-6, 6]^2 widths, zero below the horizon."""
    width = model.parts()[0].widths[0]
    s = math.sqrt((1 - COS) * (1 + COS))
    light = np.array([s, 0.0, COS])

    def integrand(points: np.ndarray) -> np.ndarray:
        x, y = width * points[:, 0], width * points[:, 1]
        q = 1.0 + x * x + y * y
        h = np.stack((x, y, np.ones_like(x)), -1) / np.sqrt(q)[:, None]
        l_dot_h = h @ light
        view = 2.0 * l_dot_h[:, None] * h - light
        view /= np.linalg.norm(view, axis=1, keepdims=True)
        up = (view[:, 2] > 0) & (l_dot_h > 0)
        value = np.zeros(len(x))
        value[up] = model.eval(light, view[up]) * view[up, 2]
        return value * 4.0 * np.abs(l_dot_h) / q**1.5 * width * width

    return integrand


def timed(call: Callable[[], object], rounds: int = 5) -> float:
    call()
    seconds = []
    for _ in range(rounds):
        start = time.perf_counter()
        call()
        seconds.append(time.perf_counter() - start)
    return median(seconds)


@pytest.mark.parametrize("name", MODELS)
def test_against_general_methods(benchmark, name: str) -> None:
    """Ours at 1e-8; theirs as near to it as they come, in the same run."""
    import cubature as cubature_package
    from scipy import integrate

    model = MODELS[name]
    benchmark.pedantic(lambda: albedo.directional_albedo(model, COS), rounds=7, warmup_rounds=1)
    ours = benchmark.stats.stats.median
    found = albedo.directional_albedo(model, COS)
    reference = float(albedo.directional_albedo(model, COS, rtol=1e-12).value)
    print(f"\n{name}: {found}, {int(found.evaluations)} evaluations, {1e3 * ours:.2f} ms")
    in_slopes, wide = slopes(model), 40.0 if "ggx" in name else 6.0

    def with_scipy() -> float:
        low, high = np.full(2, -wide), np.full(2, wide)
        result = integrate.cubature(in_slopes, low, high, rtol=1e-8, max_subdivisions=2000)
        return float(result.estimate)

    def with_package() -> float:
        value, _ = cubature_package.cubature(
            in_slopes, 2, 1, [-wide] * 2, [wide] * 2, relerr=1e-8, maxEval=500_000, vectorized=True
        )
        return float(value[0])

    def on_angles(mu: float, phi: float) -> float:
        t = math.sqrt((1 - mu) * (1 + mu))
        view = np.array([t * math.cos(phi), t * math.sin(phi), mu])
        light = np.array([math.sqrt((1 - COS) * (1 + COS)), 0.0, COS])
        return float(model.eval(light, view)) * mu

    def with_dblquad() -> float:
        return (
            2.0 * integrate.dblquad(on_angles, 0.0, math.pi, 0.0, 1.0, epsrel=1e-8, epsabs=1e-8)[0]
        )

    def with_monte_carlo() -> float:
        # Walter's sampling of a Beckmann lobe; 1,024 samples.
        rng = np.random.default_rng(1)
        u, v = rng.random(1024), rng.random(1024)
        radius, phi = np.sqrt(-np.log1p(-u)), 2.0 * math.pi * v
        if "ggx" in name:
            radius = np.sqrt(u / (1.0 - u))
        points = np.stack((radius * np.cos(phi), radius * np.sin(phi)), -1)
        density = np.exp(-(radius**2)) / math.pi
        if "ggx" in name:
            density = 1.0 / (math.pi * (1.0 + radius**2) ** 2)
        return float(np.mean(in_slopes(points) / density))

    others = {
        "scipy.integrate.cubature in slopes": (with_scipy, 3),
        "cubature package in slopes": (with_package, 3),
        "1,024 importance samples": (with_monte_carlo, 5),
        "scipy.integrate.dblquad on angles": (with_dblquad, 1),
    }
    import warnings

    for label, (call, rounds) in others.items():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            value, spent = call(), timed(call, rounds)
        benchmark.extra_info[label] = spent / ours
        print(
            f"  {label}: {spent / ours:.3g} times ours, relative error "
            f"{abs(value / reference - 1.0):.1e}"
        )


@pytest.mark.parametrize("interp", ["linear", "cubic"])
@pytest.mark.parametrize("dtype", ["float32", "float16", "unorm16"])
def test_lookup(benchmark, dtype: str, interp: str) -> None:
    """A million readings of a designed table, on one core."""
    model = albedo.model("cook_torrance", distribution="ggx", geometry="smith_correlated")
    table = albedo.design(
        model, {"m": (0.05, 1.0)}, size=(32, 32), cosines=(0.01, 1.0), dtype=dtype, interp=interp
    )
    x = np.random.default_rng(0).uniform(0.05, 1.0, (2, 10**6))
    read = table.channels[0].table
    benchmark.pedantic(lambda: read(x), rounds=9, warmup_rounds=1)
    benchmark.extra_info["ns_per_reading"] = round(benchmark.stats.stats.median * 1e3, 1)
