"""Every model of the catalogue, held to what it declares and promises."""

from __future__ import annotations

import builtins
import math
import types
from collections import defaultdict
from collections.abc import Callable
from typing import Any

import cases
import exact
import numpy as np
import pytest

import albedo
from albedo._compile import stands_for
from albedo.brdf import Model, Real
from albedo.catalogue._fresnel import FresnelChoice
from albedo.charts.cosine import CosineChart
from albedo.charts.dark import DarkChart
from albedo.charts.orders import OrdersChart
from albedo.charts.polar import PolarChart
from albedo.directions import spherical
from albedo.grammar import format_spec, parse
from albedo.integrators.rules import gauss

EPS = np.finfo(float).eps

everywhere = pytest.mark.parametrize("model", cases.EXTREME, ids=lambda m: m.spec)
moderate = pytest.mark.parametrize("model", cases.MODERATE, ids=lambda m: m.spec)

# From normal incidence to where float64 itself ends.
HEIGHTS = np.array([1.0, 1 - 1e-12, 0.9, 0.5, 0.1, 1e-3, 1e-6, 1e-9, 1e-12])
# Where the albedo may be largest: normal, oblique and grazing incidence.
INCIDENCES = np.array([1.0, 0.97, 0.9, 0.7, 0.5, 0.35, 0.2, 0.1, 0.03, 1e-2, 1e-4, 1e-7])


def nodes(
    part: Any, cos_theta: float, phi: float, isotropic: bool, order: int = 4
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """wi, wo and h in the shapes of a kernel, at the nodes of the part's own chart."""
    geometry, row, code, box = part.chart.panels(
        np.array([cos_theta]), np.array([phi]), np.array([part.widths]), isotropic
    )
    rule = gauss(order)
    wi, wo, h, _ = part.chart.nodes(geometry[row], code, box, rule.nodes, rule.nodes)
    return wi, wo, h


def filled(part: Any, model: Model, wi: np.ndarray, wo: np.ndarray, h: np.ndarray) -> np.ndarray:
    """Values of a part at nodes."""
    p = np.tile(np.array(model.pack(), dtype=float), (wi.shape[1], 1))
    out = np.empty(wo.shape[1:])
    part.fill(wi, wo, h, part.packed(p), out)
    return out


def swapped(part: Any, model: Model, wi: np.ndarray, wo: np.ndarray, h: np.ndarray) -> np.ndarray:
    """Values of a part with light and view exchanged; the half vector is the same."""
    light = wo.reshape(3, -1)
    view = np.repeat(wi, wo.shape[2], axis=1)[:, :, None]
    return filled(part, model, light, view, h.reshape(3, -1, 1)).reshape(wo.shape[1:])


def asymmetry(model: Model, cos_theta: float, phi: float) -> float:
    """Largest |f(l, v) - f(v, l)| over the nodes of the model's charts, over the largest f."""
    worst = 0.0
    for part in model.parts():
        wi, wo, h = nodes(part, cos_theta, phi, model.isotropic)
        there, back = filled(part, model, wi, wo, h), swapped(part, model, wi, wo, h)
        above = wo[2] > 0.0
        sizes = np.maximum(np.abs(there), np.abs(back))[above]
        top = max(float(sizes.max()), 1e-300)
        # Down to 1e-10 of the peak, each node counts on its own.
        scale = np.maximum(sizes, 1e-10 * top)
        worst = max(worst, float(np.max(np.abs(there - back)[above] / scale)))
    return worst


@everywhere
def test_reciprocity_is_as_claimed(model: Model) -> None:
    found = max(asymmetry(model, c, 0.4) for c in (0.95, 0.4, 0.05, 1e-4))
    if model.reciprocal:
        # Exponents down to log(1e-10) = -23 amplify the roundings of slopes, about ten of them;
        # a low power of r.v is as uncertain as r.v itself, down to 1e-6 at these nodes.
        low = min(model.parameters.get("n_u", 99.0), model.parameters.get("n_v", 99.0)) < 1.0
        assert found <= (1e6 if low else 40 * 23) * exact.amplification(model) * EPS


def test_models_that_claim_not_to_be_reciprocal_are_not() -> None:
    for kind in albedo.models().values():
        for model in cases.moderate(kind):
            if not model.reciprocal:
                assert asymmetry(model, 0.4, 0.4) > 1e-3, model.spec


@moderate
@pytest.mark.filterwarnings("ignore::albedo.ConvergenceWarning")
def test_reciprocal_models_reflect_the_same_with_the_view_fixed(model: Model) -> None:
    if not model.reciprocal:
        return
    cosines, phi = np.array([0.93, 0.4, 1e-2]), np.array([0.3, 1.2, 0.0])
    light, view = (
        albedo.directional_albedo(model, cosines, phi, rtol=1e-7, atol=1e-12, fixed=fixed)
        for fixed in ("light", "view")
    )
    assert np.all(np.isfinite(view.value)), "a value was refused"
    assert np.all(np.abs(light.value - view.value) <= light.error + view.error)


def largest_excess(model: Model) -> tuple[float, float]:
    """Largest of a - 1, and of what a exceeds 1 by beyond its bound."""
    phi = np.array([0.0] if model.isotropic else [0.0, 0.4, 0.9, 0.5 * math.pi])
    cosines = np.append(INCIDENCES, 0.0) if model.grazing_limit else INCIDENCES
    found = albedo.directional_albedo(model, cosines, phi[:, None], rtol=1e-4, atol=1e-6)
    assert np.all(np.isfinite(found.value)), "a value was refused"
    return float(np.max(found.value - 1.0)), float(np.max(found.value - found.error - 1.0))


@moderate
@pytest.mark.filterwarnings("ignore::albedo.ConvergenceWarning")
def test_conserving_models_reflect_no_more_than_they_receive(model: Model) -> None:
    if model.conserves_energy:
        assert largest_excess(model)[1] <= 0.0


def choices_of(model: Model) -> tuple[Any, ...]:
    """The words of a model, but for its Fresnel factor: that takes energy, and gives none."""
    factor = FresnelChoice._declared if isinstance(model, FresnelChoice) else {}
    kept = (v for k, v in model.parameters.items() if k not in factor)
    return (model.name, *(v for v in kept if isinstance(v, str)))


def test_models_that_claim_not_to_conserve_energy_do_not() -> None:
    """For every combination of choices some parameters reflect more than 1."""
    guilty: dict[Any, list[Model]] = defaultdict(list)
    for model in cases.EXTREME:
        if not model.conserves_energy:
            guilty[choices_of(model)].append(model)
    innocent = []
    for key, models in guilty.items():
        for model in models:
            # One direction is enough, and narrow lobes are as good as wide ones.
            cosines = np.array([1.0, 0.7, 0.1, 1e-6])
            with np.errstate(all="ignore"):
                found = albedo.directional_albedo(model, cosines, rtol=1e-3, atol=1e-3)
            if np.any(found.value - found.error > 1.0):
                break
        else:
            innocent.append(key)
    assert not innocent


def extreme_pairs() -> tuple[np.ndarray, np.ndarray]:
    """Pairs of directions: mirror, retro, normal, horizon, and everything between."""
    phi = np.array([0.0, 0.3, 0.5 * math.pi, math.pi, -2.5])
    some = spherical(HEIGHTS[:, None], phi).reshape(-1, 3)
    wi, wo = np.broadcast_arrays(some[:, None], some[None, :])
    mirror = some * np.array([-1.0, -1.0, 1.0])
    close = mirror + 1e-9 * np.roll(some, 1, axis=1)
    close /= np.linalg.norm(close, axis=1, keepdims=True)
    close[:, 2] = np.abs(close[:, 2])
    wi = np.concatenate((wi.reshape(-1, 3), some, some, some))
    return wi, np.concatenate((wo.reshape(-1, 3), mirror, some, close))


@everywhere
def test_values_are_finite_and_not_negative_everywhere(model: Model) -> None:
    values = model.eval(*extreme_pairs())
    assert np.all(np.isfinite(values))
    assert np.all(values >= 0.0)


@everywhere
def test_values_at_the_nodes_of_the_charts_are_finite(model: Model) -> None:
    for part in model.parts():
        for c in (1.0, 0.5, 1e-3, 1e-12):
            wi, wo, h = nodes(part, c, 0.3, model.isotropic)
            values = filled(part, model, wi, wo, h)[wo[2] > 0.0]
            assert np.all(np.isfinite(values))
            assert np.all(values >= 0.0)


@everywhere
def test_nothing_is_reflected_below_the_horizon(model: Model) -> None:
    up = spherical([0.7, 1.0, 1e-9])
    down = up * np.array([1.0, 1.0, -1.0])
    level = np.array([[1.0, 0.0, 0.0]])
    for below in (down, level):
        assert np.all(model.eval(below, up) == 0.0)
        assert np.all(model.eval(up, below) == 0.0)
        assert np.all(model.eval(below, below) == 0.0)


def turned(v: np.ndarray, angle: float) -> np.ndarray:
    """Vectors (3, ...) turned about the normal."""
    c, s = math.cos(angle), math.sin(angle)
    return np.stack((c * v[0] - s * v[1], s * v[0] + c * v[1], v[2]))


def dependence(model: Model, cos_theta: float) -> float:
    """Largest change when both directions turn together, over the value (or 1e-10 of the peak)."""
    worst = 0.0
    for part in model.parts():
        wi, wo, h = nodes(part, cos_theta, 0.0, model.isotropic)
        before = filled(part, model, wi, wo, h)
        for angle in (0.3, 0.5 * math.pi, 2.0):
            after = filled(part, model, *(turned(x, angle) for x in (wi, wo, h)))
            above = wo[2] > 0.0
            scale = np.maximum(before, 1e-10 * before[above].max(initial=1e-290))[above]
            worst = max(worst, float(np.max(np.abs(after - before)[above] / scale)))
    if not model.parts():
        shares = model.spikes(spherical(np.full(4, cos_theta), [0.0, 0.3, 0.5 * math.pi, 2.0]))[1]
        worst = float(np.ptp(shares.sum(0)) / max(shares.sum(0).max(), 1e-290))
    return worst


@everywhere
def test_isotropy_is_as_claimed(model: Model) -> None:
    found = max(dependence(model, c) for c in (0.9, 0.3))
    if model.isotropic:
        # A turn rounds every slope a few times, and exponents down to -23 amplify that; l - v of a
        # retro-reflector is a difference of raw directions, as uncertain as EPS over its width.
        retro = math.sqrt(model.parameters["n"]) if "retro" in model.parameters.values() else 1.0
        # Where x^n ends at 1e-10 of its peak, n/x amplifies the four roundings of x = r.v.
        n = float(model.parameters.get("n", 1.0))
        end = n * 10.0 ** (10.0 / n) if n >= 5.0 else 0.0
        assert found <= max(40 * 23 * max(1.0, retro), 4 * end) * exact.amplification(model) * EPS
    else:
        assert found > 1e-3


def pure(function: Callable[..., Any]) -> Callable[..., Any]:
    """A compiled function as plain Python, and so all the compiled functions that it calls."""
    code = function.py_func.__code__
    names = {**vars(builtins), **function.py_func.__globals__}
    for name in code.co_names:
        if hasattr(names.get(name), "py_func"):
            known = stands_for(names[name])
            names[name] = getattr(math, known) if known else pure(names[name])
    return types.FunctionType(code, names)


@moderate
def test_compiled_kernels_equal_plain_python(model: Model) -> None:
    for part in model.parts():
        for kernel, chart in ((part.fill, part.chart), (part.loss, part.loss_chart)):
            if kernel is None:
                continue
            # A lobe that is divided by numbers keeps the kernel of the lobe.
            kernel = getattr(kernel, "fill", kernel)
            if not hasattr(kernel, "py_func"):
                continue  # numpy is plain Python already
            geometry, row, code, box = chart.panels(
                np.array([0.3]), np.array([0.7]), np.array([part.widths]), model.isotropic
            )
            rule = gauss(3)
            keep = slice(0, 24)
            wi, wo, h, _ = chart.nodes(
                geometry[row][keep], code[keep], box[keep], rule.nodes, rule.nodes
            )
            p = part.packed(np.tile(np.array(model.pack(), dtype=float), (wi.shape[1], 1)))
            compiled, plain = np.empty(wo.shape[1:]), np.empty(wo.shape[1:])
            kernel(wi, wo, h, p, compiled)
            with np.errstate(under="ignore"):
                pure(kernel)(wi, wo, h, p, plain)
            # The two libraries' exp, log1p and pow differ by an ulp each, behind exponents to 50.
            floor = 1e-20 * np.abs(plain).max()
            np.testing.assert_allclose(compiled, plain, rtol=200 * EPS, atol=floor)


@pytest.mark.parametrize(
    "chart",
    [
        CosineChart("max"),
        CosineChart("max", angle=True),
        CosineChart(angle=True, layered=True),
        DarkChart(c_1=0.6, lobe=0.9, second=0.02),
        OrdersChart(0.3, 0.1),
        PolarChart("slope", "v_cavity", "gaussian", 2, 2),
        PolarChart("slope", "max", "cosine_power", 4, full=True),
        PolarChart("mirror", "max", "cosine_power", 4),
        PolarChart("retro_hemisphere"),
    ],
    ids=str,
)
@pytest.mark.parametrize("cos_theta", [0.6, 0.01])
def test_compiled_charts_equal_plain_python(
    chart: Any, cos_theta: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    import sys

    rule = gauss(3)

    def laid_out() -> tuple[np.ndarray, ...]:
        geometry, row, code, box = chart.panels(
            np.array([cos_theta]), np.array([0.7]), np.array([[0.2, 0.05]]), False
        )
        keep = slice(0, 24)
        made = chart.nodes(geometry[row][keep], code[keep], box[keep], rule.nodes, rule.nodes)
        return (geometry, row, code, box, *made)

    compiled = laid_out()
    room = sys.modules[type(chart).__module__]
    for name in ("_panels", "_nodes"):
        if hasattr(room, name):
            monkeypatch.setattr(room, name, pure(getattr(room, name)))
    plain = laid_out()
    for a, b in zip(compiled, plain, strict=True):
        # Cuts come out of a bisection, and nodes of differences of neighbouring angles.
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-13)


# he_torrance's oracle sums a series at 40 digits for every one of seven calls; lewis's integrates.
SAMPLES = {"he_torrance": 4, "lewis": 4}


@pytest.mark.parametrize("model", cases.EXTREME, ids=lambda m: m.spec)
def test_eval_agrees_with_its_oracle(model: Model, rng: np.random.Generator) -> None:
    count = SAMPLES.get(model.name, 8)
    cosines = 10.0 ** rng.uniform(-6.0, 0.0, count)
    cosines[: count // 2] = rng.uniform(0.05, 1.0, count // 2)
    wi = spherical(cosines, rng.uniform(-math.pi, math.pi, count))
    anywhere = spherical(rng.uniform(0.01, 1.0, count), rng.uniform(-math.pi, math.pi, count))
    width = min(min(part.widths) for part in model.parts()) if model.parts() else 1.0
    # Numbers in the values may have been computed with an error that the model states.
    doubts = (part.doubt for part in model.parts())
    doubt = max((float(d(None)) if callable(d) else d for d in doubts), default=0.0)
    nearby = (
        wi * np.array([-1.0, -1.0, 1.0]) + width * rng.normal(size=(count, 3)) * cosines[:, None]
    )
    nearby /= np.linalg.norm(nearby, axis=1, keepdims=True)
    nearby[:, 2] = np.maximum(np.abs(nearby[:, 2]), 1e-12)
    for wo in (anywhere, nearby):
        values = model.eval(wi, wo)
        for k in range(count):
            value, slack = exact.brdf_with_slack(model, wi[k], wo[k])
            # What an ulp of the coordinates does, forty times over for the steps from them to the
            # slopes; some dozen roundings in exponents of about 40; and what underflows.
            assert abs(values[k] - value) <= 40 * slack + (250 * EPS + doubt) * value + 1e-290


@everywhere
def test_models_are_frozen_equal_and_hashable(model: Model) -> None:
    again = type(model)(**model.parameters)
    assert again == model
    assert again is not model
    assert hash(again) == hash(model)
    assert model != "model"
    with pytest.raises(AttributeError, match="frozen"):
        model.rho = 1.0  # type: ignore[attr-defined]
    for parameter in model.parameter_info():
        if isinstance(parameter, Real) and parameter.name in model.parameters:
            value = model.parameters[parameter.name]
            other = 0.5 * (value + max(parameter.low, 0.3 * value + 0.1))
            if other == value:
                continue
            try:
                changed = model.replace(**{parameter.name: other})
            except albedo.InputError:
                continue  # such as a second width for an isotropic distribution
            assert changed != model
            assert getattr(changed, parameter.name) == other
            assert changed.replace(**{parameter.name: value}) == model


@everywhere
def test_what_a_model_calls_itself_builds_it_again(model: Model) -> None:
    assert parse(model.spec).model() == model
    assert parse(format_spec(model.name, model.parameters)).model() == model
    assert model.spec in repr(model)


def test_the_registry_lists_every_model_once() -> None:
    kinds = albedo.models()
    assert list(kinds) == sorted(kinds)
    for name, kind in kinds.items():
        assert kind.name == name
        assert kind.title
        assert kind.equation
        assert kind.references
        for parameter in kind.parameter_info():
            assert parameter.doc or not isinstance(parameter, Real)
            assert parameter.range_text
        assert albedo.model(name) == kind()


def test_the_parameters_of_a_model_cannot_be_changed_behind_its_back() -> None:
    ward = albedo.model("ward", m=0.3)
    with pytest.raises(TypeError):
        ward.parameters["alpha_x"] = 0.1  # type: ignore[index]


def test_an_alias_sets_and_reads_all_its_targets() -> None:
    ward = albedo.model("ward", m=0.3)
    assert (ward.alpha_x, ward.alpha_y, ward.m) == (0.3, 0.3, 0.3)
    with pytest.raises(AttributeError, match="differ"):
        _ = ward.replace(alpha_x=0.1).m
    assert ward.replace(m=0.2) == albedo.model("ward", alpha_x=0.2, alpha_y=0.2)
