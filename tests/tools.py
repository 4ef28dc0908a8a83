"""Programs that a test needs, and that not every machine has.

Where one is missing the test is skipped, unless ALBEDO_REQUIRE_TOOLS=1 says that all are there:
then it fails.
"""

from __future__ import annotations

import importlib
import os
import shutil
import subprocess
import tarfile
import tempfile
from pathlib import Path
from types import ModuleType
from typing import NoReturn

import pytest

from albedo._compile import cache_root

THREE = "0.187.0"
"""The version of three.js."""


def missing(reason: str) -> NoReturn:
    """Skip the test, or fail."""
    if os.environ.get("ALBEDO_REQUIRE_TOOLS") == "1":
        pytest.fail(f"{reason}, and ALBEDO_REQUIRE_TOOLS=1")
    pytest.skip(reason)


def need(*names: str) -> str:
    """Path of a program, by the first of its names that is there."""
    for name in names:
        if found := shutil.which(name):
            return found
    missing(f"there is no {' or '.join(names)} here")


def need_module(name: str) -> ModuleType:
    """A Python package."""
    try:
        return importlib.import_module(name)
    except ImportError:
        missing(f"the package {name.partition('.')[0]} is not installed")


def need_three() -> Path:
    """The folder with three.js, which npm fetches once."""
    folder = cache_root() / "npm" / f"three-{THREE}"
    if folder.is_dir():
        return folder
    npm = need("npm")
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent) as name:
        fetched = Path(name)
        command = [npm, "pack", "--silent", f"three@{THREE}"]
        run = subprocess.run(command, cwd=fetched, capture_output=True, text=True, check=False)
        if run.returncode:
            missing(f"npm does not fetch three {THREE}: {run.stderr.strip()[-200:]}")
        (archive,) = fetched.glob("*.tgz")
        with tarfile.open(archive) as package:
            package.extractall(fetched, filter="data")
        try:
            (fetched / "package" / "build").rename(folder)
        except OSError:
            # Another process was faster.
            assert folder.is_dir()
    return folder
