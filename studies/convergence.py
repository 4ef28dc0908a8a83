"""How fast does Monte Carlo converge, with which draws, and when is the quadrature faster?

For every model with its default parameters the albedo is drawn with all strategies and sequences of
points, again and again; errors are differences from the quadrature. Rates are fitted to them.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from functools import partial
from statistics import median
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

import albedo
from albedo import plotting
from albedo.brdf import Model
from albedo.integrators.monte_carlo import SEQUENCES
from albedo.sampling.mixture import STRATEGIES
from albedo.studies import Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from albedo.studies import Context

STUDY = Study(
    name="convergence",
    title="What a sample buys: strategies, sequences, and the quadrature",
)

TIMED = {
    "cook_torrance, ggx, m = 0.3": albedo.model(
        "cook_torrance", m=0.3, distribution="ggx", geometry="smith"
    ),
    "ward, m = 0.1": albedo.model("ward", m=0.1),
    "phong, n = 100": albedo.model("phong", n=100.0),
    "lambert": albedo.model("lambert"),
}
# Models that a quick run is about: broad and narrow lobes, in one part and in several.
QUICK = ("lambert", "oren_nayar", "phong", "ward", "cook_torrance", "ashikhmin_shirley")
# Draws of a variance that is compared.
_DRAWS = 2**15
_COLORS = ("#0072B2", "#D55E00", "#009E73", "#AA4499")


def run(context: Context) -> None:
    """Errors and rates of all models, variances, times, and a figure."""
    cosines = (0.9, 0.5, 0.1) if context.full else (0.5,)
    sizes = [2**k for k in (range(10, 17, 2) if context.full else (10, 13))]
    seeds = 8 if context.full else 2
    context.setting(rtol=1e-9, seeds=seeds, samples=sizes[-1])
    models = {name: kind().by_channel()[0] for name, kind in albedo.models().items()}
    if not context.full:
        models = {name: models[name] for name in QUICK}
    errors, variances = [], []
    with warnings.catch_warnings():
        # Some strategies hardly see some lobes: that is what the table shows.
        warnings.simplefilter("ignore", albedo.ConvergenceWarning)
        for done, (name, model) in enumerate(models.items()):
            context.progress(done, len(models), name)
            if not model.parts():
                # Dirac parts alone: nothing is drawn.
                continue
            for cosine in cosines:
                exact = float(albedo.directional_albedo(model, cosine, 0.4, rtol=1e-9).value)
                errors += measure(name, model, cosine, exact, sizes, seeds)
                variances.append(compare(name, model, cosine))
    frame = pd.DataFrame(errors)
    rates = fit(frame)
    noisy = pd.DataFrame(variances)
    # Errors and variances go down to roundings where weights are constant.
    context.table(
        "errors",
        frame,
        "Root mean square of relative errors over seeds",
        loose={column: 1e-9 for column in frame if column.startswith("error_")},
    )
    context.table(
        "rates",
        rates,
        "Fitted powers of the number of draws",
        loose={column: 1e-3 for column in rates if column.startswith("rate_")},
    )
    context.table(
        "variances",
        noisy,
        "Variance of a draw, relative to a^2",
        loose={column: 1e-9 for column in noisy if column.startswith("variance_")},
    )
    context.figure(
        "errors_figure",
        draw(context.full),
        "Root mean square errors at cos θ = 0.5: points for visible GGX normals, and strategies "
        "for Ward's lobe with random points. Grey: the powers -1/2 and -1.",
    )
    with context.alone(), warnings.catch_warnings():
        warnings.simplefilter("ignore", albedo.ConvergenceWarning)
        times = race(3, (2, 3, 4)) if context.full else race(1, (2, 3))
    context.table(
        "times",
        times,
        "Seconds to a relative error, in one run on one core",
        machine=[column for column in times if column != "model"],
    )
    for sentence in sentences(rates, noisy, times):
        context.note(sentence)


def measure(
    name: str, model: Model, cosine: float, exact: float, sizes: list[int], seeds: int
) -> list[dict[str, object]]:
    """Errors of one model and direction, for all ways to draw."""
    rows = []
    for strategy in STRATEGIES:
        for sequence in SEQUENCES:
            row: dict[str, object] = {
                "model": name,
                "cos_theta": cosine,
                "strategy": strategy,
                "sequence": sequence,
            }
            for size in sizes:
                found = draws(model, cosine, size, strategy, sequence, seeds)
                off = (np.array([float(one.value) for one in found]) - exact) / exact
                row[f"error_{size}"] = float(np.sqrt(np.mean(off**2)))
            row["reliable"] = all(bool(one.reliable) for one in found)
            rows.append(row)
    return rows


def draws(
    model: Model, cosine: float, size: int, strategy: str, sequence: str, seeds: int
) -> list[albedo.MonteCarloEstimate]:
    """Independent estimates."""
    return [
        albedo.monte_carlo_albedo(
            *(model, cosine, 0.4),
            samples=size,
            strategy=strategy,
            sequence=sequence,
            seed=seed,
        )
        for seed in range(seeds)
    ]


def compare(name: str, model: Model, cosine: float) -> dict[str, object]:
    """Variance of a random draw for all strategies, over the square of the albedo."""
    row: dict[str, object] = {"model": name, "cos_theta": cosine}
    widths = [min(part.widths) for part in model.parts()]
    row["narrowest_lobe"] = min(widths)
    for strategy in STRATEGIES:
        (found,) = draws(model, cosine, _DRAWS, strategy, "random", 1)
        row[f"variance_{strategy}"] = float(found.error) ** 2 * _DRAWS / float(found.value) ** 2
        row[f"reliable_{strategy}"] = bool(found.reliable)
    return row


def fit(frame: pd.DataFrame) -> pd.DataFrame:
    """Power of the number of draws, by least squares in logarithms, where draws are reliable."""
    columns = [column for column in frame if column.startswith("error_")]
    sizes = np.log([float(column.removeprefix("error_")) for column in columns])
    kept = frame[frame["reliable"]]
    rows = []
    for (strategy, sequence), group in kept.groupby(["strategy", "sequence"], sort=False):
        errors = group[columns].to_numpy()
        # An error of rounding has no rate: constant weights leave nothing else.
        noisy = np.all(errors > 1e-12, axis=1)
        slopes = np.polyfit(sizes, np.log(errors[noisy]).T, 1)[0]
        low, middle, high = np.percentile(slopes, (25, 50, 75))
        rows.append(
            {
                "strategy": strategy,
                "sequence": sequence,
                "cases": int(noisy.sum()),
                "rate_median": float(middle),
                "rate_lower_quartile": float(low),
                "rate_upper_quartile": float(high),
            }
        )
    return pd.DataFrame(rows)


def race(rounds: int, digits: tuple[int, ...]) -> pd.DataFrame:
    """Seconds to a relative error: Monte Carlo to 1e-2 and less, quadrature to 1e-8."""
    rows = []
    for name, model in TIMED.items():
        row: dict[str, object] = {"model": name}
        for sequence in ("random", "sobol"):
            for k in digits:
                drawn = partial(
                    albedo.monte_carlo_albedo,
                    *(model, 0.5),
                    rtol=10.0**-k,
                    sequence=sequence,
                )
                row[f"{sequence}_1e-{k}"] = timed(drawn, rounds)
        row["quadrature_1e-8"] = timed(partial(albedo.directional_albedo, model, 0.5), rounds)
        rows.append(row)
    return pd.DataFrame(rows)


def timed(call: Callable[[], object], rounds: int) -> float:
    """Median seconds of a call, the first one left out."""
    call()
    spent = []
    for _ in range(rounds):
        start = time.perf_counter()
        call()
        spent.append(time.perf_counter() - start)
    return median(spent)


def sentences(rates: pd.DataFrame, variances: pd.DataFrame, times: pd.DataFrame) -> list[str]:
    """What the tables say, in words around their numbers."""
    own = rates[rates["strategy"] == "model"].set_index("sequence")["rate_median"]
    narrow = variances[variances["narrowest_lobe"] < 0.5]
    worse = narrow[narrow["variance_model"] > narrow["variance_cosine"]]
    listed = ", ".join(sorted(set(worse["model"]))) or "none"
    ratio = times["random_1e-3"] / times["quadrature_1e-8"]
    return [
        "With their own routines, errors fall as the number of draws to the power "
        + ", ".join(f"{own[sequence]:.2f} ({sequence})" for sequence in SEQUENCES)
        + ", in the median over all models.",
        f"Of {len(narrow)} cases with a lobe narrower than 0.5 rad, the model's own routine has a "
        f"larger variance than cosine sampling in {len(worse)}: {listed}.",
        "Random draws to 1e-3 take "
        + ", ".join(f"{r:.2g}" for r in ratio)
        + " times as long as the quadrature to 1e-8 ("
        + ", ".join(times["model"])
        + ").",
    ]


def draw(full: bool) -> Figure:
    """Errors against draws, for sequences and for strategies."""
    sizes = 2 ** np.arange(10, 20 if full else 15)
    seeds = 16 if full else 4
    ggx, ward = list(TIMED.values())[:2]
    with warnings.catch_warnings(), plotting.style():
        warnings.simplefilter("ignore", albedo.ConvergenceWarning)
        figure, axes = plotting.new_figure(columns=2, width=7.5)
        for axis, model, ways in (
            (axes[0], ggx, [("model", sequence, sequence) for sequence in SEQUENCES]),
            (axes[1], ward, [(strategy, "random", strategy) for strategy in STRATEGIES]),
        ):
            exact = float(albedo.directional_albedo(model, 0.5, 0.4, rtol=1e-10).value)
            for color, (strategy, sequence, label) in zip(_COLORS, ways, strict=False):
                errors = []
                for size in sizes:
                    found = draws(model, 0.5, int(size), strategy, sequence, seeds)
                    off = np.array([float(one.value) for one in found]) / exact - 1.0
                    errors.append(np.sqrt(np.mean(off**2)))
                axis.plot(sizes, errors, color=color, label=label)
            for power in (-0.5, -1.0):
                axis.plot(sizes, 0.5 * sizes**power, ":", color="#888888", lw=1)
            axis.set_xscale("log")
            axis.set_yscale("log")
            axis.set_xlabel("draws")
            axis.legend(ncols=2, loc="upper center", bbox_to_anchor=(0.5, -0.18), frameon=False)
        axes[0].set_ylabel("relative error")
        axes[0].set_title("points: GGX, m = 0.3", fontsize=10)
        axes[1].set_title("strategies: Ward, m = 0.1", fontsize=10)
    return figure
