"""Is the advice good? Random scenes, places that no search has seen, and all other ways."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from albedo.advice.prices import Prices, committed
from albedo.advice.scene import Axis, Scene
from albedo.advice.search import Advice, Search
from albedo.advice.ways import Way
from albedo.brdf import Model
from albedo.errors import InputError
from albedo.grammar import parse_model

UNSEEN = 2
"""Seed of the places where advice is judged."""

# Models whose values take longer have references that take longer than a judge has.
_DEAREST = 500.0
# And models that take longer to make, each of which is made for some dozens of parameters.
_SLOWEST = 1e8


@dataclass(frozen=True, eq=False)
class Judgement:
    """What became of advice.

    Attributes
    ----------
    advice : Advice
    within : float
        Share of unseen places that are within the tolerance; NaN where nothing was advised.
    worst : float
        The largest error there, as a share of what is allowed.
    cheaper : Way or None
        What passes the same test at less than half the price, or at any price where nothing was
        advised.
    """

    advice: Advice
    within: float
    worst: float
    cheaper: Way | None

    @property
    def kept(self) -> bool:
        """Whether the stated share is within the tolerance."""
        return self.advice.choice is None or self.within >= self.advice.choice.share


def random_scene(seed: int, prices: Prices | None = None) -> Search:
    """A scene of a model of the catalogue over part of its default table.

    Parameters
    ----------
    seed : int
    prices : Prices, optional

    Returns
    -------
    Search
        Of a scene whose reference can be had.
    """
    from albedo.catalogue import models

    prices = prices or committed()
    rng = np.random.default_rng((seed, 0xADF1CE))
    kinds = list(models().values())
    while True:
        kind = kinds[rng.integers(len(kinds))]
        drawn = _model(kind, rng)
        if drawn is None or prices.value(drawn[0]) > _DEAREST or prices.made(drawn[0]) > _SLOWEST:
            continue
        model, axes = drawn
        light = ("sky", "sky", "point", "area")[rng.integers(4)]
        tolerance = float(10.0 ** rng.uniform(-3.0, -1.0))
        relative = bool(rng.integers(2))
        # Of tails that are nothing, no approximation is right by a share.
        both = relative and light != "sky"
        scene = Scene(
            *(model, axes, (0.0, float(rng.uniform(50.0, 88.0))), light),
            *(float(rng.uniform(2.0, 15.0)), "radiance"),
            rtol=tolerance if relative else 0.0,
            atol=0.1 * tolerance if both else 0.0 if relative else tolerance,
        )
        try:
            return Search(scene, prices)
        except InputError:
            # A highlight too narrow for a source has no reference.
            continue


def _model(kind: type[Model], rng: np.random.Generator) -> tuple[Model, tuple[Axis, ...]] | None:
    """A model over a part of one of its default tables."""
    text = kind.tables[rng.integers(len(kind.tables))]
    spec = parse_model(f"{kind.name}:{text}", "A scene")
    axes = []
    for name, values in spec.sweep.items():
        if not isinstance(values, np.ndarray):
            return None
        low, high = sorted(rng.uniform(0.0, 1.0, 2))
        ends = np.interp((low, high), np.linspace(0.0, 1.0, values.size), values)
        axes.append(Axis(name, float(ends[0]), float(ends[1])))
    model = kind(**spec.fixed, **{axis.name: axis.low for axis in axes}).by_channel()[0]
    return (model, tuple(axes)) if model.parts() else None


def judge(search: Search) -> Judgement:
    """Advise, and look at places that the search has not seen and at ways it did not go.

    Parameters
    ----------
    search : Search

    Returns
    -------
    Judgement
    """
    advice = search.answer(math.inf, math.inf)
    chosen = advice.choice
    if chosen is None:
        return Judgement(advice, math.nan, math.nan, _passing(search, search.all_ways))
    unseen = search.places(UNSEEN, search.count)
    count = min(len(unseen.points), chosen.places)
    points = unseen.points.first(count)
    off = np.abs(chosen.way.values(points) - unseen.known[:count])
    ratio = np.where(off == 0.0, 0.0, off / np.maximum(unseen.allowed[:count], 1e-300))
    half = [way for way in search.all_ways if way.ns < 0.5 * chosen.ns]
    return Judgement(
        advice, float(np.mean(ratio <= 1.0)), float(ratio.max()), _passing(search, half)
    )


def _passing(search: Search, ways: list[Way]) -> Way | None:
    """The first of some ways that passes the tests of the search."""
    for way in ways:
        if search.predicted(way) <= 1.0 and search.verified(way)[0] <= 1.0:
            return way
    return None


def judge_many(seeds: Iterator[int] | range) -> Iterator[tuple[int, Judgement]]:
    """Judge the random scenes of some seeds."""
    for seed in seeds:
        yield seed, judge(random_scene(seed))


def row_of(seed: int, judged: Judgement) -> dict[str, Any]:
    """A judgement as a row of a table."""
    advice = judged.advice
    scene, choice = advice.scene, advice.choice
    ranges = ", ".join(f"{axis.name} {axis.low:.3g} to {axis.high:.3g}" for axis in scene.axes)
    return {
        "scene": seed,
        "model": scene.model.name,
        "range": ranges,
        "light": scene.light,
        "theta_deg": scene.theta[1],
        "rtol": scene.rtol,
        "atol": scene.atol,
        "advice": "nothing fits" if choice is None else str(choice.way),
        "ns": math.nan if choice is None else choice.ns,
        "plain_ns": advice.plain,
        "bytes": 0 if choice is None else choice.bytes,
        "verified": math.nan if choice is None else choice.verified,
        "unseen": judged.worst,
        "share_stated": math.nan if choice is None else choice.share,
        "share_unseen": judged.within,
        "cheaper": "" if judged.cheaper is None else str(judged.cheaper),
    }
