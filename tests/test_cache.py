"""Compiled kernels: found by the next process, and never stale."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numba.core.errors import TypingError

import albedo
from albedo import _compile
from albedo._compile import address, indirect, kernel

PACKAGE = Path(albedo.__file__).parent
HERE = PACKAGE.parent
PRINT_VALUE = (
    "import albedo; m = albedo.model('blinn', n=2.0); "
    "print(float(m.eval([0, 0, 1], [0.6, 0, 0.8])))"
)


def run(code: str, root: Path, cache: Path) -> str:
    environment = {**os.environ, "PYTHONPATH": str(root), "ALBEDO_CACHE_DIR": str(cache)}
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=root,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.strip()


def machine_code(cache: Path) -> set[Path]:
    return set(cache.rglob("*.nbc"))


def test_the_next_process_hits_and_an_edited_helper_misses(tmp_path: Path) -> None:
    copy, cache = tmp_path / "albedo", tmp_path / "cache"
    shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))
    first = run(PRINT_VALUE, tmp_path, cache)
    files = machine_code(cache)
    assert files
    assert run(PRINT_VALUE, tmp_path, cache) == first
    assert machine_code(cache) == files
    # The model's own file stays as it is: only a helper that it was compiled with changes.
    helper = copy / "geometry.py"
    text = helper.read_text(encoding="utf-8")
    changed = text.replace("math.exp(-0.25 * n * log_secant2(hx, hy, hz))", "2.0")
    assert changed != text
    helper.write_text(changed, encoding="utf-8")
    second = run(PRINT_VALUE, tmp_path, cache)
    assert float(second) != float(first)
    assert machine_code(cache) > files


def test_kernels_of_a_user_count_their_own_neighbours(tmp_path: Path) -> None:
    (tmp_path / "helper.py").write_text(
        "from albedo._compile import kernel\n\n@kernel\ndef twice(x):\n    return 2.0 * x\n"
    )
    (tmp_path / "mine.py").write_text(
        "from albedo._compile import kernel\nfrom helper import twice\n\n"
        "@kernel\ndef f(x):\n    return twice(x) + 1.0\n\nprint(f(3.0))\n"
    )
    root = f"{PACKAGE.parent}{os.pathsep}{tmp_path}"
    code = f"import sys; sys.path[:0] = {root.split(os.pathsep)!r}; import mine"
    cache = tmp_path / "cache"
    assert run(code, tmp_path, cache) == "7.0"
    assert run(code, tmp_path, cache) == "7.0"
    helper = tmp_path / "helper.py"
    helper.write_text(helper.read_text().replace("2.0 * x", "5.0 * x"))
    assert run(code, tmp_path, cache) == "16.0"


def test_a_helper_process_compiles_what_an_integral_needs_beside_its_panels(tmp_path: Path) -> None:
    line = "ward:m=0.1"
    run(f"from albedo.quadrature import compile_ahead; compile_ahead([{line!r}])", HERE, tmp_path)
    before = machine_code(tmp_path)
    run(
        "import albedo; albedo.directional_albedo(albedo.model('ward', m=0.1), 0.5)", HERE, tmp_path
    )
    after = machine_code(tmp_path)
    shared = {
        file
        for file in after
        if file.name.startswith(("adaptive.", "cells.", "rules.", "polar._nodes"))
    }
    # Nothing of these had to be compiled again; the panels and the model's own kernel had.
    assert len(shared) >= 10
    assert shared <= before
    assert {file.name.split("-")[0] for file in after - before} >= {"polar._panels", "ward.fill"}


def test_a_kernel_is_called_by_its_address_with_its_own_types_only() -> None:
    types = "void(f8[::1], f8[::1])"
    call = indirect(types)

    @kernel
    def double(x, y):
        for i in range(x.size):
            y[i] = 2.0 * x[i]

    @kernel
    def square(x, y):
        for i in range(x.size):
            y[i] = x[i] * x[i]

    @kernel
    def through(where, x, y):
        call(where, (x, y))

    x, y = np.arange(4.0), np.empty(4)
    for function, expected in ((double, 2.0 * x), (square, x * x)):
        through(address(function, types), x, y)
        np.testing.assert_array_equal(y, expected)
    with pytest.raises(TypingError, match="is called with"):
        through(address(double, types), np.arange(4), y)
    # On disk it is the one that a call compiles.
    double(x, y)
    assert len(double.signatures) == 1

    @kernel
    def total(x, y):
        return x.sum() + y.sum()

    with pytest.raises(TypingError, match="returns float64, not none"):
        address(total, types)


def test_only_an_empty_cache_gets_a_second_compiler(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its folder is there as soon as a kernel is declared; machine code comes later."""
    started = []

    class Helper:
        def __init__(self, command: list[str], **_: object) -> None:
            started.append(command)

        def __enter__(self) -> Helper:
            return self

        def __exit__(self, *_: object) -> None:
            return None

        def terminate(self) -> None:
            return None

    monkeypatch.setenv("ALBEDO_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(_compile.subprocess, "Popen", Helper)
    folder = tmp_path / _compile.digest(_compile.PACKAGE) / "catalogue"
    folder.mkdir(parents=True)
    with _compile.second_compiler("ward:m=0.1"):
        pass
    assert [command[-1] for command in started] == ["ward:m=0.1"]
    (folder / "ward.fill.nbi").touch()
    with _compile.second_compiler("ward:m=0.1"):
        pass
    assert len(started) == 1
