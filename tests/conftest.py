"""What all tests share: one seed, and hypothesis without chance."""

from __future__ import annotations

import math
import os
import zlib

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

from albedo.operators import kept

SEED = 20090603
"""The one seed of all random numbers in the tests."""

# Examples are the same on every machine and at every run; the first call of a kernel compiles it.
settings.register_profile(
    "albedo",
    derandomize=True,
    deadline=None,
    print_blob=False,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
settings.load_profile("albedo")


def pytest_configure(config: pytest.Config) -> None:
    """Tests share the cores: BLAS's threads, which wait without sleep, are in each other's way."""
    if config.getoption("numprocesses", None):
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


@pytest.fixture
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    """A generator that depends on the seed and on the test, not on which tests ran before."""
    return np.random.default_rng([SEED, zlib.crc32(request.node.nodeid.encode())])


@pytest.fixture(autouse=True)
def _nothing_kept(
    monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Tables are computed, whatever earlier runs kept, and leave nothing."""
    monkeypatch.setattr(kept, "_folder", lambda: tmp_path_factory.getbasetemp() / "tables")
    monkeypatch.setattr(kept, "_WORTH", math.inf)
