"""How many digits of a directional albedo are right: of the quadrature, in float32, and as printed.

Digits of values are counted by `albedo.analysis.stability`; an albedo is an integral of them, in
which roundings average and shifts of a lobe do not. Measured are

* what `albedo.directional_albedo` gives at its default tolerance and at the tightest useful one,
  against references or against each other;
* the sum over the same nodes with all values of the BRDF in single precision, and with nothing but
  the parameters, or the parameters and directions, rounded to it;
* the same sums for formulas as papers print them (`albedo.analysis.printed`).

Nodes are those of the cells on which the adaptive quadrature ends, with directions from the chart
and weights in float64: what differs between two sums is the values alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from decimal import Decimal
from typing import TYPE_CHECKING, Any

import numpy as np

from albedo.analysis.precise import evaluate_part, single
from albedo.analysis.printed import Printed
from albedo.brdf import Model, Part
from albedo.directions import half_vector
from albedo.errors import InputError
from albedo.estimate import Estimate
from albedo.grammar import parse
from albedo.integrators.adaptive import refine
from albedo.integrators.cells import ModelIntegrand
from albedo.integrators.rules import gauss
from albedo.quadrature import DEFAULT_LIMIT, albedo_rows

if TYPE_CHECKING:
    import pandas as pd

DEFAULT, FINE = 1e-8, 1e-12
"""Relative tolerances: that of `albedo.directional_albedo`, and the tightest useful one."""
COSINES = (1.0, 0.7, 0.1, 1e-3, 1e-6, 1e-12)
"""Cosines of the angle of incidence."""
AZIMUTH = 0.6
"""Azimuth of the light, in radians, where the model is anisotropic."""
WAYS = ("default", "fine", "float32")
FULL = {way: -math.log10(2.0 ** (-24 if way == "float32" else -53)) for way in WAYS}
"""All digits that there are: half a unit in the last place."""

_LARGEST = float(np.finfo(np.float32).max)


def right_digits(
    value: float, reference: float | Decimal, error: float = 0.0, full: float = FULL["default"]
) -> float:
    """Digits of a value that are right at least.

    Parameters
    ----------
    value : float
    reference : float or Decimal
        What it is compared with.
    error : float
        How far the reference itself may be off.
    full : float
        No more than these.

    Returns
    -------
    float
        -log10 of the relative error, between 0 and `full`; 0 where the value is not finite, NaN
        where the reference is 0, about which nothing is to be right.
    """
    true = Decimal(reference)
    if true == 0:
        return math.nan
    if not math.isfinite(value):
        return 0.0
    off = (abs(Decimal(float(value)) - true) + Decimal(error)) / abs(true)
    return full if off == 0 else min(max(-float(off.log10()), 0.0), full)


@dataclass(frozen=True, eq=False)
class Nodes:
    """The nodes of the integral of one part.

    Attributes
    ----------
    part : Part
    wi, wo, h : ndarray, shape (n, 3)
        Directions, and their sum as the chart knows it.
    weight : ndarray, shape (n,)
        n.v dV times the weights of the rules: f @ weight is the albedo.
    """

    part: Part
    wi: np.ndarray
    wo: np.ndarray
    h: np.ndarray
    weight: np.ndarray


def nodes_of(
    model: Model, cos_theta: float, phi: float = 0.0, *, rtol: float = 1e-10, albedo: float = 0.0
) -> list[Nodes]:
    """Nodes on which the integrals of all parts are known to a tolerance.

    Parameters
    ----------
    model : Model
        With one channel, and parts that are kernels.
    cos_theta, phi : float
        Direction of incidence; the cosine in (0, 1].
    rtol : float
        Relative error of each part.
    albedo : float
        About how large the sum is, where it is known: no part needs its digits beyond it.

    Raises
    ------
    InputError
        For a model that is all Dirac parts.
    """
    if not model.parts():
        raise InputError(f"{model.spec} is all Dirac parts: no value of it has digits to count")
    packed = np.array([model.pack()], dtype=np.float64)
    found = []
    for part in model.parts():
        integrand = ModelIntegrand(part.fill, part.packed(packed), np.array([part.scale]))
        refined = refine(
            *(part.chart, integrand, np.array([cos_theta]), np.array([phi])),
            *(np.array([part.widths]), model.isotropic),
            rtol=rtol,
            atol=rtol * albedo / len(model.parts()),
            limit=DEFAULT_LIMIT,
        )
        found.append(_laid_out(part, refined.geometry, refined.cells))
    return found


def _laid_out(part: Part, geometry: np.ndarray, cells: Any) -> Nodes:
    """The nodes of all cells, those with the same orders together."""
    wis, wos, hs, weights = [], [], [], []
    for p, q in np.unique(cells.order, axis=0).tolist():
        which = np.flatnonzero((cells.order[:, 0] == p) & (cells.order[:, 1] == q))
        u, v = gauss(p), gauss(q)
        shape = geometry[cells.row[which]], cells.code[which], cells.box[which]
        wi, wo, h, weight = part.chart.nodes(*shape, u.nodes, v.nodes)
        wis.append(np.repeat(wi, p * q, axis=1))
        wos.append(wo.reshape(3, -1))
        hs.append(h.reshape(3, -1))
        weights.append((weight * np.outer(u.weights, v.weights).ravel()).ravel())
    wi, wo, h = (np.ascontiguousarray(np.concatenate(x, axis=1).T) for x in (wis, wos, hs))
    return Nodes(part, wi, wo, h, np.concatenate(weights))


@dataclass(frozen=True)
class SingleAlbedo:
    """An albedo without its Dirac parts, with values of the BRDF in single precision.

    Attributes
    ----------
    summed : float
        All values in float64.
    value : float
        All values in float32, every operation rounded, weights and sum in float64; NaN where one
        of them is not finite.
    parameters : float
        Values in float64, of parameters rounded to float32.
    inputs : float
        Values in float64, of parameters, directions and their sums rounded to float32.
    nodes : int
    not_finite : int
        Values in float32 that are not finite, at nodes where those in float64 are.
    beyond : int
        How many of those are too large for float32 in float64 already.
    """

    summed: float
    value: float
    parameters: float
    inputs: float
    nodes: int
    not_finite: int
    beyond: int


def single_albedo(
    model: Model, cos_theta: float, phi: float = 0.0, *, rtol: float = 1e-10, albedo: float = 0.0
) -> SingleAlbedo:
    """The albedo with values in float32, beside that in float64 on the same nodes.

    Parameters
    ----------
    model, cos_theta, phi, rtol, albedo
        As in `nodes_of`.

    Raises
    ------
    InputError
        For a model with something else than kernels of plain arithmetic, and one that is all
        Dirac parts.
    """
    short = single()
    packed = np.array([model.pack()], dtype=np.float64)
    sums, count, bad, beyond = np.zeros(4), 0, 0, 0
    for nodes in nodes_of(model, cos_theta, phi, rtol=rtol, albedo=albedo):
        part, vectors = nodes.part, (nodes.wi, nodes.wo, nodes.h)
        p = part.packed(packed)
        rounded = tuple(v.astype(np.float32) for v in vectors)
        in_short = evaluate_part(model, part, short, *rounded).astype(np.float64)
        p_short = p.astype(np.float32).astype(np.float64)
        scale_short = float(np.float32(part.scale))
        values = (
            part.scale * _filled(part, p, *vectors),
            in_short,
            scale_short * _filled(part, p_short, *vectors),
            scale_short * _filled(part, p_short, *(v.astype(np.float64) for v in rounded)),
        )
        sums += [float(f @ nodes.weight) for f in values]
        count += nodes.weight.size
        broken = np.isfinite(values[0]) & ~np.isfinite(in_short)
        bad += int(np.count_nonzero(broken))
        beyond += int(np.count_nonzero(broken & (np.abs(values[0]) > _LARGEST)))
    summed, value, parameters, inputs = sums.tolist()
    return SingleAlbedo(summed, value, parameters, inputs, count, bad, beyond)


def _filled(part: Part, p: np.ndarray, wi: np.ndarray, wo: np.ndarray, h: np.ndarray) -> np.ndarray:
    """Values of a kernel in float64, its factor left out."""
    count = len(wi)
    out = np.empty((count, 1))
    view, half = (np.ascontiguousarray(v.T).reshape(3, count, 1) for v in (wo, h))
    part.fill(np.ascontiguousarray(wi.T), view, half, np.repeat(p, count, axis=0), out)
    return out[:, 0]


def measure(
    models: Iterable[tuple[dict[str, Any], Model]],
    *,
    cosines: Iterable[float] = COSINES,
    rtol: float = 1e-8,
    progress: Callable[[int, int], None] | None = None,
) -> pd.DataFrame:
    """Count the right digits of albedos.

    Parameters
    ----------
    models : iterable of (dict, Model)
        What each is called by, such as its swept parameters, and the model, with one channel.
    cosines : iterable of float
        Cosines of the angle of incidence, in (0, 1].
    rtol : float
        To which the nodes for float32 are good; they are the same for both arithmetics.
    progress : callable, optional
        Called with models done and models in all.

    Returns
    -------
    pandas.DataFrame
        One row for every model and cosine: what the model is called by, ``cos_theta``,
        ``phi_deg``, the ``albedo`` at `FINE` with its bound ``albedo_error``, and

        * ``default``: digits of the value at `DEFAULT` that are right at least, against the other;
        * ``fine``: digits that the bound of the value at `FINE` promises;
        * ``float32``: digits of the sum with values in single precision, Dirac parts left out;
        * ``parameters``, ``inputs`` and ``operations``: relative change of that sum when only
          they are rounded, and when everything is;
        * ``nodes``, ``not_finite`` and ``beyond``: how many values, how many are not finite in
          float32, and how many of those are too large for it.

    Raises
    ------
    InputError
        For models whose values are not kernels of plain arithmetic, and for those that are all
        Dirac parts.
    """
    import pandas as pd

    models, cosines = list(models), list(cosines)
    rows = []
    for done, (names, model) in enumerate(models):
        if progress is not None:
            progress(done, len(models))
        phi = 0.0 if model.isotropic else AZIMUTH
        where = [model] * len(cosines), np.array(cosines), np.full(len(cosines), phi)
        coarse, fine = (albedo_rows(*where, rtol=t, atol=0.0) for t in (DEFAULT, FINE))
        for k, c in enumerate(cosines):
            value, error = float(fine.value[k]), float(fine.error[k])
            short = single_albedo(model, c, phi, rtol=rtol, albedo=value)
            rows.append(
                {
                    **names,
                    "cos_theta": c,
                    "phi_deg": math.degrees(phi),
                    "albedo": value,
                    "albedo_error": error,
                    "default": right_digits(float(coarse.value[k]), value, error),
                    "fine": right_digits(value, value, error),
                    "float32": right_digits(short.value, short.summed, full=FULL["float32"]),
                    "parameters": _moved(short.parameters, short.summed),
                    "inputs": _moved(short.inputs, short.summed),
                    "operations": _moved(short.value, short.summed),
                    "nodes": short.nodes,
                    "not_finite": short.not_finite,
                    "beyond": short.beyond,
                }
            )
    if progress is not None:
        progress(len(models), len(models))
    return pd.DataFrame(rows)


def _moved(value: float, from_: float) -> float:
    return abs(value / from_ - 1.0) if from_ != 0.0 else math.nan


def worst(frame: pd.DataFrame) -> pd.DataFrame:
    """For every way, the row of `measure` with the fewest digits, and the median of all.

    Returns
    -------
    pandas.DataFrame
        One row for every way: ``way``, ``median``, ``worst``, ``lost``, which is all that the
        arithmetic has less those, and the columns of the row where it is worst, up to its albedo.
    """
    import pandas as pd

    kept = list(frame.columns[: frame.columns.get_loc("albedo_error") + 1])
    rows = []
    for way in WAYS:
        least = float(frame[way].min())
        at = frame.loc[frame[way].idxmin(), kept]
        numbers = {"way": way, "median": float(frame[way].median()), "worst": least}
        rows.append({**numbers, "lost": FULL[way] - least, **at})
    return pd.DataFrame(rows)


def printed_albedos(
    formula: Printed, m: float, cos_theta: float, *, rtol: float = 1e-10
) -> pd.DataFrame:
    """What a formula as printed makes of an albedo, beside the same lobe in slopes.

    Parameters
    ----------
    formula : Printed
    m : float
        Width of the lobe.
    cos_theta : float
        Cosine of the angle of incidence, in (0, 1].
    rtol : float
        To which the nodes are good.

    Returns
    -------
    pandas.DataFrame
        One row for each ``way`` (float64, float32) and ``form``: ``printed``; ``raw``, the model
        with h formed from the directions at the nodes; ``known``, with h as the chart knows it.
        ``value`` is the sum, NaN where a value is not finite; ``relative_error`` its error against
        the ``albedo``, itself known to ``albedo_error``; ``relative_error_error`` what the nodes
        and the albedo are off by; ``not_finite`` counts values.
    """
    import pandas as pd

    model, short = parse(formula.same(m)).model(), single()
    fine = _fine(model, cos_theta)
    albedo, bound = float(fine.value[0]), float(fine.error[0])
    (nodes,) = nodes_of(model, cos_theta, rtol=rtol)
    wi, wo, h = nodes.wi, nodes.wo, nodes.h
    wi_s, wo_s, h_s = (v.astype(np.float32) for v in (wi, wo, h))
    constant = formula.constant(m)
    with np.errstate(all="ignore"):
        values = {
            ("float64", "printed"): constant * formula.function(wi, wo, m),
            ("float64", "raw"): model.finite_part(wi, wo, half_vector(wi, wo)),
            ("float64", "known"): model.finite_part(wi, wo, h),
            ("float32", "printed"): constant * formula.function(wi_s, wo_s, np.float32(m)),
            ("float32", "raw"): evaluate_part(model, nodes.part, short, wi_s, wo_s, wi_s + wo_s),
            ("float32", "known"): evaluate_part(model, nodes.part, short, wi_s, wo_s, h_s),
        }
        sums = {k: float(f.astype(np.float64) @ nodes.weight) for k, f in values.items()}
    # The sum of stable values in float64 is off by what the nodes are.
    off = (abs(sums["float64", "known"] - albedo) + bound) / albedo
    rows = [
        {
            "width": m,
            "cos_theta": cos_theta,
            "way": way,
            "form": form,
            "albedo": albedo,
            "albedo_error": bound,
            "value": total if math.isfinite(total) else math.nan,
            "relative_error": abs(total / albedo - 1.0) if math.isfinite(total) else math.inf,
            "relative_error_error": off,
            "not_finite": int(np.count_nonzero(~np.isfinite(values[way, form]))),
        }
        for (way, form), total in sums.items()
    ]
    return pd.DataFrame(rows)


def _fine(model: Model, cos_theta: float) -> Estimate:
    return albedo_rows([model], np.array([cos_theta]), np.zeros(1), rtol=FINE, atol=0.0)
