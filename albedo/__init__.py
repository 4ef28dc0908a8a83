"""albedo: directional albedos of reflectance models, with an error bound on every number.

    >>> import albedo
    >>> ward = albedo.model("ward", m=0.1)
    >>> print(albedo.directional_albedo(ward, cos_theta=0.5))
    0.488988056(2) [bound]

Importing this package compiles nothing; what is heavy is imported where it is used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

_HOME = {
    "advise": "albedo.advice.search",
    "model": "albedo.catalogue",
    "models": "albedo.catalogue",
    "model_from": "albedo.user",
    "directional_albedo": "albedo.quadrature",
    "average_albedo": "albedo.averages",
    "monte_carlo_albedo": "albedo.integrators.monte_carlo",
    "MonteCarloEstimate": "albedo.integrators.monte_carlo",
    "table": "albedo.tables",
    "compensate": "albedo.operators.compensate",
    "couple": "albedo.operators.couple",
    "design": "albedo.lookup.design",
    "fit": "albedo.lookup.fits",
    "load_lookup": "albedo.lookup.formats",
    "LookupTable": "albedo.lookup.label",
    "save_fit": "albedo.lookup.fits",
    "save_lookup": "albedo.lookup.formats",
    "normalize": "albedo.operators.normalize",
    "pump": "albedo.operators.pump",
    "Estimate": "albedo.estimate",
    "Model": "albedo.brdf",
    "InputError": "albedo.errors",
    "DivergenceError": "albedo.errors",
    "ConvergenceWarning": "albedo.errors",
    "CacheWarning": "albedo.errors",
}

if TYPE_CHECKING:
    from albedo import testing
    from albedo.advice.search import advise
    from albedo.averages import average_albedo
    from albedo.brdf import Model
    from albedo.catalogue import model, models
    from albedo.errors import CacheWarning, ConvergenceWarning, DivergenceError, InputError
    from albedo.estimate import Estimate
    from albedo.integrators.monte_carlo import MonteCarloEstimate, monte_carlo_albedo
    from albedo.lookup.design import design
    from albedo.lookup.fits import fit, save_fit
    from albedo.lookup.formats import load_lookup, save_lookup
    from albedo.lookup.label import LookupTable
    from albedo.operators.compensate import compensate
    from albedo.operators.couple import couple
    from albedo.operators.normalize import normalize
    from albedo.operators.pump import pump
    from albedo.quadrature import directional_albedo
    from albedo.tables import table
    from albedo.user import model_from

__all__ = [
    "CacheWarning",
    "ConvergenceWarning",
    "DivergenceError",
    "Estimate",
    "InputError",
    "LookupTable",
    "Model",
    "MonteCarloEstimate",
    "advise",
    "average_albedo",
    "compensate",
    "couple",
    "design",
    "directional_albedo",
    "fit",
    "load_lookup",
    "model",
    "model_from",
    "models",
    "monte_carlo_albedo",
    "normalize",
    "pump",
    "save_fit",
    "save_lookup",
    "table",
    "testing",
]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        value = getattr(import_module(_HOME[name]), name)
        globals()[name] = value
        return value
    if name == "testing":
        return import_module("albedo.testing")
    raise AttributeError(f"module 'albedo' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOME, "testing"])
