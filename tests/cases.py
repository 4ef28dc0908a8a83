"""Models to test: what the catalogue declares, at its defaults and at the ends of its ranges."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import albedo
from albedo.brdf import Alias, Choice, Model, Real
from albedo.errors import InputError

# Sets that no rule finds: combinations that matter together.
EXTRA: dict[str, list[dict[str, Any]]] = {
    "ashikhmin_shirley": [
        {"n_u": 10.0, "n_v": 1000.0},
        {"n_u": 1e4, "n_v": 1.0, "r_s": 0.3},
        {"n": 30.0, "r_s": 0.05, "r_d": 1.0},
        {"n": 30.0, "r_s": 0.8, "r_d": 1.0, "diffuse": "lambert"},
    ],
    "cook_torrance": [
        {"m": 1.0, "distribution": "ggx", "geometry": "smith_correlated"},
        {"m": 1e-6, "distribution": "ggx", "geometry": "smith"},
        {"m": 0.3, "geometry": "smith"},
        {"alpha_x": 0.5, "alpha_y": 0.05, "distribution": "ggx", "geometry": "smith"},
        {"alpha_x": 0.02, "alpha_y": 0.5, "geometry": "v_cavity"},
        {"n": 4.0, "distribution": "blinn_phong"},
        {"n": 4.0, "distribution": "blinn_phong", "geometry": "smith"},
        {"n_u": 1e4, "n_v": 1.0, "distribution": "ashikhmin_shirley", "geometry": "smith"},
        {"m": 0.7, "distribution": "gaussian", "geometry": "smith_correlated"},
        {"m": 0.4, "fresnel": "conductor", "ior": 0.2, "k": 3.0},
        {"m": 0.4, "fresnel": "dielectric", "ior": 0.7, "distribution": "ggx"},
        {"m": 0.4, "geometry": "none"},
    ],
    "he_torrance": [
        {"sigma0": 5.0, "tau": 50.0},
        {"sigma0": 0.01, "tau": 3.0},
        {"sigma0": 0.18, "tau": 3.0, "fresnel": "dielectric", "a_ud": 0.2},
    ],
    "max_phong": [{"n": 5.0, "p": 0.0}, {"n": 5.0, "p": 0.5}, {"n": 0.0, "c": "safe"}],
    "max_phong_anisotropic": [{"n_u": 1e4, "n_v": 1.0}, {"n_u": 50.0, "n_v": 50.0}],
    "phong_original": [{"rho_s": 3.0}],
    "ward": [
        {"alpha_x": 0.2, "alpha_y": 0.05},
        {"m": 1e-6},
        {"m": 1.0},
        {"m": 0.5, "form": "fast"},
    ],
    "ward_bounded": [{"alpha_x": 0.2, "alpha_y": 0.05}, {"m": 1e-6}, {"m": 1.0}],
    "ward_duer": [{"alpha_x": 0.2, "alpha_y": 0.05}, {"m": 1e-6}, {"m": 1.0}],
}


def _built(kind: type[Model], sets: Iterable[dict[str, Any]]) -> list[Model]:
    """The models that these sets of parameters make, without those that do not go together."""
    models: list[Model] = []
    for values in sets:
        try:
            model = kind(**values)
        except InputError:
            continue
        if model not in models:
            models.append(model)
    return models


def moderate(kind: type[Model]) -> list[Model]:
    """A model with its defaults, with every choice, and with the sets that are listed above."""
    sets: list[dict[str, Any]] = [{}]
    for parameter in kind.parameter_info():
        if isinstance(parameter, Choice):
            sets += [{parameter.name: choice} for choice in parameter.choices]
    return _built(kind, sets + EXTRA.get(kind.name, []))


def extreme(kind: type[Model]) -> list[Model]:
    """As `moderate`, and with every number at both ends of the range that it declares."""
    ends: list[dict[str, Any]] = []
    declared = {parameter.name: parameter for parameter in kind.parameter_info()}
    for parameter in declared.values():
        first = declared[parameter.targets[0]] if isinstance(parameter, Alias) else parameter
        if isinstance(first, Real):
            low = first.low + 1e-6 if first.open_low else first.low
            ends.append({parameter.name: low})
            if math.isfinite(first.high):
                ends.append({parameter.name: first.high})
    # The ends count with every choice that uses the parameter.
    choices = [{}] + [
        {parameter.name: choice}
        for parameter in declared.values()
        if isinstance(parameter, Choice)
        for choice in parameter.choices
    ]
    sets = [{**choice, **end} for end in ends for choice in choices]
    built = moderate(kind)
    return built + [model for model in _built(kind, sets) if model not in built]


MODERATE = [model for kind in albedo.models().values() for model in moderate(kind)]
EXTREME = [model for kind in albedo.models().values() for model in extreme(kind)]
