"""The catalogue: one file per reflectance model, found by its name.

A file ``NAME.py`` in this folder defines one `albedo.brdf.Model` with ``name = "NAME"``. Nothing
else needs to know: a model is imported when it is asked for.
"""

from __future__ import annotations

import pkgutil
from difflib import get_close_matches
from functools import cache
from importlib import import_module
from typing import Any

from albedo.brdf import Model
from albedo.errors import InputError


def names() -> tuple[str, ...]:
    """Names of all models, sorted, without importing any."""
    return tuple(sorted(m.name for m in pkgutil.iter_modules(__path__) if m.name[0] != "_"))


@cache
def model_class(name: str) -> type[Model]:
    """The class of the model called `name`.

    Raises
    ------
    InputError
        When there is none; the sentence lists the names and the nearest one.
    """
    if name not in names():
        near = get_close_matches(name, names(), 1)
        hint = f" (did you mean {near[0]}?)" if near else ""
        raise InputError(f"unknown model {name!r}{hint}; the models are {', '.join(names())}")
    module = import_module(f"{__name__}.{name}")
    found = [
        item
        for item in vars(module).values()
        if isinstance(item, type) and issubclass(item, Model) and item.__module__ == module.__name__
    ]
    if len(found) != 1 or found[0].name != name:
        raise TypeError(f"{module.__file__} must define exactly one Model with name = {name!r}")
    return found[0]


def model(name: str, /, **parameters: Any) -> Model:
    """The model called `name`, with its parameters fixed.

    Parameters
    ----------
    name : str
        One of `models`.
    **parameters
        Values of its parameters; the others keep their defaults.

    Raises
    ------
    InputError
        For an unknown name or parameter (the sentence lists the valid ones), or a value out of
        range.

    Examples
    --------
    >>> import albedo
    >>> albedo.model("ward", m=0.1)
    <albedo model ward:alpha_x=0.1,alpha_y=0.1,rho_s=1.0,form=exact>
    """
    return model_class(name)(**parameters)


def models() -> dict[str, type[Model]]:
    """The registry: every model's class by its name, sorted."""
    return {name: model_class(name) for name in names()}
