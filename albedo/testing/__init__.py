"""Assertions about BRDFs and their sampling, for the test suites of other projects.

    >>> import numpy as np
    >>> from albedo.testing import assert_energy_conserving
    >>> assert_energy_conserving(lambda wi, wo: np.full(len(wo), 1.0 / np.pi), cos_theta=[1, 0.1])

They are plain functions that raise AssertionError, for pytest, unittest or neither. What each of
them finds, and what none can see, is in ``docs/testing.md``.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

_HOME = {
    "assert_energy_conserving": "albedo.testing.energy",
    "assert_reciprocal": "albedo.testing.reciprocity",
    "assert_sampler_matches_pdf": "albedo.testing.sampling",
    "assert_table_close": "albedo.testing.tables",
    "assert_white_furnace": "albedo.testing.energy",
}

if TYPE_CHECKING:
    from albedo.testing.energy import assert_energy_conserving, assert_white_furnace
    from albedo.testing.reciprocity import assert_reciprocal
    from albedo.testing.sampling import assert_sampler_matches_pdf
    from albedo.testing.tables import assert_table_close

__all__ = [
    "assert_energy_conserving",
    "assert_reciprocal",
    "assert_sampler_matches_pdf",
    "assert_table_close",
    "assert_white_furnace",
]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        value = getattr(import_module(_HOME[name]), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'albedo.testing' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOME])
