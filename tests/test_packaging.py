"""What an import costs in modules, what a version is, and what a wheel holds."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

import albedo

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]

# Each of these takes longer to import than all that most commands do.
HEAVY = ("numba", "llvmlite", "matplotlib", "pandas", "xarray", "scipy", "h5py", "h5netcdf")

IMPORT = "import albedo"
HELP = "from albedo.cli import app; app(['--help'], standalone_mode=False)"
VERSION = "from albedo.cli import app; app(['--version'], standalone_mode=False)"


def modules_after(code: str) -> set[str]:
    """Top-level modules that a fresh interpreter holds after running the code."""
    script = f"{code}\nimport json, sys\nprint(json.dumps(list(sys.modules)), file=sys.stderr)"
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    return {name.partition(".")[0] for name in json.loads(run.stderr.splitlines()[-1])}


@pytest.mark.parametrize("code", [IMPORT, HELP, VERSION], ids=["import", "help", "version"])
def test_nothing_heavy_is_loaded(code: str) -> None:
    assert not modules_after(code).intersection(HEAVY)


def test_every_public_name_is_found() -> None:
    for name in albedo.__all__:
        assert getattr(albedo, name) is not None
    assert set(albedo.__all__) <= set(dir(albedo))


def test_the_version_is_the_same_everywhere() -> None:
    assert albedo.__version__ == PROJECT["version"]
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.search(rf"^## \[{re.escape(albedo.__version__)}\]", changes, re.MULTILINE)


def test_constraints_pin_every_requirement() -> None:
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pins = [line for line in lines if line and not line.startswith("#")]
    assert all(re.fullmatch(r"[\w.-]+==[\w.]+", pin) for pin in pins)
    pinned = {_normal(pin.partition("==")[0]) for pin in pins}
    extras = [item for items in PROJECT["optional-dependencies"].values() for item in items]
    wanted = {_normal(re.split(r"[><=\[;]", item)[0]) for item in PROJECT["dependencies"] + extras}
    assert wanted - {PROJECT["name"]} <= pinned


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name.strip()).lower()


@pytest.mark.slow
def test_a_wheel_holds_the_package_and_nothing_else(tmp_path: Path) -> None:
    source = tmp_path / "source"
    source.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    for name in ("albedo", "tests", "studies"):
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    command = ["pip", "wheel", "-q", "--no-deps", "-w", str(tmp_path), str(source)]
    subprocess.run([sys.executable, "-m", *command], check=True)
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        held = {name for name in archive.namelist() if ".dist-info/" not in name}
    package = ROOT / "albedo"
    expected = {
        path.relative_to(ROOT).as_posix()
        for path in package.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert held == expected
