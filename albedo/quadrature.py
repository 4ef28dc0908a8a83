"""Directional and average albedo by quadrature, with a bound on every number."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from albedo._compile import is_kernel
from albedo.brdf import Model, Part, parts_of
from albedo.directions import real_array
from albedo.errors import ConvergenceWarning, DivergenceError, InputError
from albedo.estimate import Estimate
from albedo.integrators.adaptive import Refined, compile_kernels, integrate, look
from albedo.integrators.cells import ModelIntegrand

DEFAULT_LIMIT = 400_000
"""Evaluations per value before the quadrature gives up and says so."""

# A pumped model may have hundreds of panels, each of which takes a thousand for eleven digits.
_PER_PANEL = 2_000

# Directions whose Dirac parts are held at once: a model may have thousands of them.
_SPIKED = 64

# A scan of the hemisphere needs as many before it can promise a resolved width of 1e-4 rad.
_SCAN_LIMIT = 4_000_000_000

# What the numbers of a part err by is looked at closely from this share of the tolerance on.
_SMALL = 0.1
# The share of a tolerance that numbers in a model may take up: more than pumping-up leaves of one.
_MOST_SPENT = 0.95

# A direction this close to the horizon, in widths of the lobe, stands for cos_theta = 0; the
# change from one a thousand times farther is added to the bound.
_GRAZING = 1e-18
_GRAZING_STEP = 1e3


LOWEST_COSINE = 1e-60
"""The smallest cosine above 0: values of a BRDF grow as its fourth power at most, 1e240."""


def check_directions(cos_theta: ArrayLike, phi: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """cos_theta in [0, 1] and phi in radians, as float64 arrays that broadcast."""
    c, p = real_array(cos_theta, "cos_theta"), real_array(phi, "phi")
    outside = (c < 0) | (c > 1)
    if np.any(outside):
        raise InputError(f"cos_theta = {c[outside].flat[0]:g} is out of range; it lies in [0, 1]")
    if np.any(tiny := (c > 0) & (c < LOWEST_COSINE)):
        raise InputError(
            f"cos_theta = {c[tiny].flat[0]:g} is out of range; it is 0 or lies in "
            f"[{LOWEST_COSINE:g}, 1]"
        )
    try:
        np.broadcast_shapes(c.shape, p.shape)
    except ValueError:
        raise InputError(
            f"cos_theta of shape {c.shape} and phi of shape {p.shape} do not broadcast"
        ) from None
    return c, p


def check_tolerances(rtol: float, atol: float) -> None:
    """Refuse tolerances that no number can meet."""
    for name, value in (("rtol", rtol), ("atol", atol)):
        if not (isinstance(value, int | float) and math.isfinite(value) and 0 <= value < 1):
            raise InputError(f"{name} = {value!r} is out of range; it lies in [0, 1)")
    if rtol < 1e-14 and atol == 0.0:
        raise InputError(f"rtol = {rtol:g} is below what float64 can meet; ask for 1e-14 or more")


def directional_albedo(
    model: Model,
    cos_theta: ArrayLike,
    phi: ArrayLike = 0.0,
    rtol: float = 1e-8,
    atol: float = 0.0,
    *,
    fixed: str = "light",
    complement: bool = False,
    max_evaluations: int | None = None,
) -> Estimate:
    r"""Directional albedo: the share of the light from one direction that is reflected.

    a(L) = \int f(L, V) (n.V) dV over the hemisphere, Dirac parts included (NNS eq. 2).

    Parameters
    ----------
    model : Model
        A model of the catalogue, or one made by `albedo.model_from`.
    cos_theta : array_like
        Cosines of the angle of incidence, 0 or in [1e-60, 1]. At 0 the result is the limit.
    phi : array_like
        Azimuth in radians; it broadcasts with `cos_theta`.
    rtol, atol : float
        The error asked for: at most max(atol, rtol |a|).
    fixed : {"light", "view"}
        Which direction is given; the other one is integrated over. They differ for models that
        are not reciprocal.
    complement : bool
        Return 1 - a instead: integrated directly, without cancellation, where the model states
        a unit integral, and by subtraction elsewhere.
    max_evaluations : int, optional
        Most evaluations per value (default 400,000, or 2,000 for each panel of a part where that is
        more).

    Returns
    -------
    Estimate
        Arrays shaped as the broadcast of `cos_theta` and `phi`, of kind ``bound``; with a leading
        axis of channels where a colour of the model has several.

    Raises
    ------
    InputError
        For input out of range.
    DivergenceError
        At cos_theta = 0 when the albedo has no finite limit there.

    Warns
    -----
    ConvergenceWarning
        When a tolerance was not met; `Estimate.converged` tells where.

    Examples
    --------
    >>> import albedo
    >>> print(albedo.directional_albedo(albedo.model("lambert", rho=0.5), 1.0, rtol=1e-6))
    0.500000000000(1) [bound]
    """
    c, p = check_directions(cos_theta, phi)
    c, p = np.broadcast_arrays(c, p)
    kinds = model.by_channel()
    estimate = albedo_rows(
        [kind for kind in kinds for _ in range(c.size)],
        *(np.tile(c.ravel(), len(kinds)), np.tile(p.ravel(), len(kinds))),
        rtol=rtol,
        atol=atol,
        fixed=fixed,
        complement=complement,
        max_evaluations=max_evaluations,
    )
    warn_unconverged(estimate, rtol, atol)
    return reshaped(estimate, c.shape if model.channels is None else (model.channels, *c.shape))


def warn_unconverged(estimate: Estimate, rtol: float, atol: float) -> None:
    """Warn once when a value missed its tolerance."""
    missed = int(np.size(estimate.converged) - np.count_nonzero(estimate.converged))
    if missed:
        warnings.warn(
            f"{missed} of {np.size(estimate.converged)} values missed rtol={rtol:g}, "
            f"atol={atol:g}; their bounds hold, see Estimate.converged",
            ConvergenceWarning,
            stacklevel=3,
        )


def reshaped(estimate: Estimate, shape: tuple[int, ...]) -> Estimate:
    """The estimate with all arrays in another shape."""
    return Estimate(
        *(estimate.value.reshape(shape), estimate.error.reshape(shape), estimate.kind),
        *(estimate.evaluations.reshape(shape), estimate.converged.reshape(shape)),
        estimate.resolved_width,
        {name: reshaped(part, shape) for name, part in estimate.parts.items()},
    )


def albedo_rows(
    models: Sequence[Model],
    cos_theta: np.ndarray,
    phi: np.ndarray,
    *,
    rtol: float,
    atol: float,
    fixed: str = "light",
    complement: bool = False,
    max_evaluations: int | None = None,
    shared: bool = False,
) -> Estimate:
    """Albedos of many rows, each with its own model of one class, in one batch.

    Parameters
    ----------
    models : sequence of Model, length n
        All of one class; repeated entries should be the same object.
    cos_theta, phi : ndarray, shape (n,)
        Directions.
    rtol, atol, fixed, complement, max_evaluations
        As in `directional_albedo`.
    shared : bool
        All cores work on parts that are kernels, as on those that ask for it anyway: what users
        wrote in Python may not be meant for several threads.

    Returns
    -------
    Estimate
        With arrays of shape (n,).
    """
    check_tolerances(rtol, atol)
    if fixed not in ("light", "view"):
        raise InputError(f"fixed = {fixed!r} is unknown; choose light or view")
    scanned = any(m.resolved_width is not None for m in models)
    default = _SCAN_LIMIT if scanned else DEFAULT_LIMIT
    limit = default if max_evaluations is None else max_evaluations
    if not isinstance(limit, int) or limit < 16:
        raise InputError(f"max_evaluations = {limit!r} is out of range; it must be at least 16")
    options: dict[str, Any] = {"rtol": rtol, "atol": atol, "limit": limit, "shared": shared}
    options["per_panel"] = _PER_PANEL if max_evaluations is None else 0
    swap = fixed == "view"
    zero = cos_theta == 0.0
    if not zero.any():
        return _rows(models, cos_theta, phi, swap, complement, options)
    for model in models:
        if not model.grazing_limit:
            raise DivergenceError(f"the albedo of {model.spec} diverges at cos_theta = 0")
    smallest = np.array([min((min(p.widths) for p in m.parts()), default=1.0) for m in models])
    near = np.where(zero, _GRAZING * np.minimum(smallest, 1.0), cos_theta)
    far = np.where(zero, near * _GRAZING_STEP, cos_theta)
    limit_value = _rows(models, near, phi, swap, complement, options)
    other = _rows(models, far, phi, swap, complement, options)
    moved = np.where(zero, np.abs(limit_value.value - other.value), 0.0)
    value, error = limit_value.value.copy(), limit_value.error + moved
    for i in np.flatnonzero(zero):
        known = models[int(i)].grazing_albedo()
        if known is not None:
            value[i], error[i] = (1.0 - known if complement else known), 0.0
    done = error <= np.maximum(atol, rtol * np.abs(value))
    return Estimate(
        *(value, error, "bound", limit_value.evaluations + other.evaluations * zero),
        *(limit_value.converged & (done | ~zero), limit_value.resolved_width, limit_value.parts),
    )


def _rows(
    models: Sequence[Model],
    cos_theta: np.ndarray,
    phi: np.ndarray,
    swap: bool,
    complement: bool,
    options: dict[str, Any],
) -> Estimate:
    """Sum the parts and spikes of every row; batch the rows whose parts share a structure."""
    n = cos_theta.size
    distinct, which = _distinct(models)
    prepared = [
        (parts, m.pack(), m.isotropic, m.reciprocal)
        for m, parts in zip(distinct, parts_of(distinct), strict=True)
    ]
    batches: dict[Any, list[int]] = {}
    for k, (parts, _, isotropic, _) in enumerate(prepared):
        structure = (
            tuple((q.name, q.fill, q.chart, q.columns) for q in parts),
            isotropic,
        )
        batches.setdefault(structure, []).append(k)
    value, error, evaluations = np.zeros(n), np.zeros(n), np.zeros(n, dtype=int)
    # What of the errors is due to numbers in the models.
    numbers = np.zeros(n)
    converged = np.ones(n, dtype=bool)
    contributions: dict[str, Estimate] = {}
    spike = _spikes(distinct, which, cos_theta, phi)
    # What the parts found so far leave of the tolerance of the sum: a part that adds little needs
    # few digits. Nothing is negative.
    slack = np.zeros(n)
    if spike is not None and not complement:
        slack += np.maximum(options["rtol"] * spike.value - spike.error, 0.0)
    direct = np.zeros(n, dtype=bool)
    for members in batches.values():
        rows = np.flatnonzero(np.isin(which, members))
        parts, _, isotropic, _ = prepared[members[0]]
        place = np.searchsorted(members, which[rows])
        loss = complement and len(parts) == 1 and parts[0].loss is not None and not swap
        direct[rows] = loss
        p = np.array([prepared[k][1] for k in members], dtype=np.float64)[place]
        limit = max(16, options["limit"] // max(len(parts), 1))
        jobs: list[_Job] = []
        for k, part in enumerate(parts):
            widths = np.array([prepared[j][0][k].widths for j in members])[place]
            scale = np.array([prepared[j][0][k].scale for j in members])[place]
            doubt = np.empty(rows.size)
            for i, j in enumerate(members):
                own, at = prepared[j][0][k].doubt, place == i
                # The views of a symmetric model are lights.
                known = not swap or prepared[j][3]
                doubt[at] = own(cos_theta[rows][at] if known else None) if callable(own) else own
                average = prepared[j][0][k].average_doubt
                if known and average is not None and doubt[at].max() > _SMALL * options["rtol"]:
                    averaged = average(cos_theta[rows][at], phi[rows][at])
                    doubt[at] = np.minimum(doubt[at], averaged)
            # What the part's own numbers are worth is not spent a second time, if it can be had.
            spent = float(doubt.max())
            hopeless = spent > _MOST_SPENT * options["rtol"]
            rtol = options["rtol"] - (0.5 * options["rtol"] if hopeless else spent)
            chart, integrand = _integral(part, part.packed(p), scale, swap, loss)
            if options["shared"] and is_kernel(integrand.fill):
                integrand = replace(integrand, shared=True)
            what = chart, integrand, cos_theta[rows], phi[rows]
            job = _Job((*what, widths, isotropic), rtol, doubt, np.zeros(rows.size))
            if len(parts) > 1 and not complement:
                job.begun, least = look(*job.what, rtol=rtol, limit=limit)
                job.share = rtol * least
            jobs.append(job)
        for k, (part, job) in enumerate(zip(parts, jobs, strict=True)):
            left = slack[rows] + sum(later.share for later in jobs[k:])
            # Where the parts found so far have used up everything, each has its own digits.
            given = np.where(left > 0.0, left - job.share, 0.0)
            tolerance = {"atol": options["atol"], "rtol": job.rtol, "slack": given}
            per_panel = options["per_panel"]
            result = integrate(
                *job.what, **tolerance, limit=limit, per_panel=per_panel, begun=job.begun
            )
            of_numbers = job.doubt * np.abs(result.value)
            numbers[rows] += of_numbers
            result.error += of_numbers
            result.converged &= result.error <= np.maximum(
                options["atol"], given + options["rtol"] * np.abs(result.value)
            )
            value[rows] += result.value
            error[rows] += result.error
            if not complement:
                gained = options["rtol"] * np.maximum(result.value - result.error, 0.0)
                slack[rows] += gained - result.error
            evaluations[rows] += result.evaluations
            converged[rows] &= result.converged
            piece = contributions.setdefault(part.name, _zeros(n))
            for name in ("value", "error", "evaluations", "converged"):
                getattr(piece, name)[rows] = getattr(result, name)
    if spike is not None:
        contributions["mirror"] = spike
        value += np.where(direct, -spike.value, spike.value)
        error += spike.error
        numbers += spike.error
    _tell_in_common(
        distinct, which, cos_theta, phi, ~direct, options["rtol"], value, numbers, error
    )
    if complement:
        value = np.where(direct, value, 1.0 - value)
        gave_up = np.flatnonzero(direct & np.isnan(value))
        if gave_up.size:
            # What is lost has no value where panels cannot be told from rounding: subtract then.
            kept = _rows(
                *([models[int(i)] for i in gave_up], cos_theta[gave_up], phi[gave_up]),
                *(swap, False, options),
            )
            value[gave_up], error[gave_up] = 1.0 - kept.value, kept.error
            evaluations[gave_up] += kept.evaluations
            direct[gave_up] = False
        # What a lobe sends beyond its cut is below 1e-290 of what it is.
        error = error + np.where(direct, 1e-290, np.finfo(float).eps * np.abs(value))
    error = np.where(np.isnan(value), np.inf, error)
    # Parts may converge one by one and the sum may still be fine, or not: the sum decides.
    converged = error <= np.maximum(options["atol"], options["rtol"] * np.abs(value))
    width = models[0].resolved_width if models else None
    several = contributions if len(contributions) > 1 and not complement else {}
    return Estimate(value, error, "bound", evaluations, converged, width, several)


def _zeros(n: int) -> Estimate:
    return Estimate(
        np.zeros(n), np.zeros(n), "bound", np.zeros(n, dtype=int), np.ones(n, dtype=bool)
    )


def _distinct(models: Sequence[Model]) -> tuple[list[Model], np.ndarray]:
    """The different objects among the models, and which of them each one is."""
    found = {id(m): m for m in models}
    number = {key: k for k, key in enumerate(found)}
    return list(found.values()), np.array([number[id(m)] for m in models], dtype=int)


def _spikes(
    distinct: Sequence[Model], which: np.ndarray, cos_theta: np.ndarray, phi: np.ndarray
) -> Estimate | None:
    """Energy of the Dirac parts, or None when no model has any."""
    if all(type(model).spikes is Model.spikes for model in distinct):
        return None
    s = np.sqrt((1 - cos_theta) * (1 + cos_theta))
    wi = np.stack((s * np.cos(phi), s * np.sin(phi), cos_theta), axis=-1)
    total, found = _zeros(which.size), False
    for k, model in enumerate(distinct):
        own = np.flatnonzero(which == k)
        for first in range(0, own.size, _SPIKED):
            rows = own[first : first + _SPIKED]
            _, weights = model.spikes(wi[rows])
            found = found or len(weights) > 0
            total.value[rows] = weights.sum(0)
            total.error[rows] = model.spike_errors(wi[rows], weights).sum(0)
    return total if found else None


def _tell_in_common(
    distinct: Sequence[Model],
    which: np.ndarray,
    cos_theta: np.ndarray,
    phi: np.ndarray,
    whole: np.ndarray,
    rtol: float,
    value: np.ndarray,
    numbers: np.ndarray,
    error: np.ndarray,
) -> None:
    """Take from the errors of sums what numbers that the parts have in common do not make of them.

    Parameters
    ----------
    distinct, which, cos_theta, phi
        Models, which of them every row has, and directions.
    whole : ndarray of bool
        Rows whose value is an albedo.
    rtol : float
        What is asked for.
    value, numbers : ndarray
        Albedos, and what is in their errors of numbers in every part.
    error : ndarray
        Changed in place.
    """
    for k, model in enumerate(distinct):
        told = whole & np.isfinite(numbers) & (numbers > _SMALL * rtol * np.abs(value))
        rows = np.flatnonzero((which == k) & told)
        together = model.sum_doubt(cos_theta[rows], phi[rows]) if rows.size else None
        if together is not None:
            error[rows] -= np.maximum(numbers[rows] - together * np.abs(value[rows]), 0.0)


@dataclass
class _Job:
    """A part over all rows of a batch: what `integrate` wants, and what is known beforehand.

    `doubt` is what the part's own numbers err by, and `share` what it adds to the tolerance of the
    sum at least.
    """

    what: tuple[Any, ...]
    rtol: float
    doubt: np.ndarray
    share: np.ndarray
    begun: Refined | None = None


def _integral(
    part: Part, p: np.ndarray, scale: np.ndarray, swap: bool, loss: bool
) -> tuple[Any, ModelIntegrand]:
    """The chart and the integrand of a part, or of what it loses."""
    fill = part.loss if loss else part.fill
    assert fill is not None
    integrand = ModelIntegrand(fill, p, scale, swap, part.shared)
    return part.loss_chart if loss else part.chart, integrand


def compile_ahead(lines: Sequence[str]) -> None:
    """Compile what integrating models takes beside their panels and their own formulas.

    Parameters
    ----------
    lines : sequence of str
        Models as on the command line; the first of a sweep stands for all.
    """
    from albedo.grammar import parse

    models = [next(parse(line).models()) for line in lines]
    compile_kernels(dict.fromkeys(part.chart for model in models for part in model.parts()))
