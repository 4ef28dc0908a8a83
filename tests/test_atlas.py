"""Default tables of all models: complete, interruptible, continued without computing twice."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import xarray
from typer.testing import CliRunner

import albedo
from albedo import atlas
from albedo.cli import app
from albedo.tables import Plan


def wanted(*names: str) -> list[atlas.Sheet]:
    return [sheet for sheet in atlas.sheets(1e-4) if sheet.name in names]


@pytest.fixture
def computed(monkeypatch: pytest.MonkeyPatch) -> list[np.ndarray]:
    """The pieces that get computed."""
    pieces: list[np.ndarray] = []
    whole = Plan.compute

    def compute(self: Plan, piece: np.ndarray) -> albedo.Estimate:
        pieces.append(piece)
        return whole(self, piece)

    monkeypatch.setattr(Plan, "compute", compute)
    return pieces


def test_every_model_declares_tables_that_are_large_enough() -> None:
    sheets = list(atlas.sheets())
    assert {sheet.spec.name for sheet in sheets} == set(albedo.models())
    assert len({sheet.name for sheet in sheets}) == len(sheets)
    for sheet in sheets:
        swept = int(np.prod([len(values) for values in sheet.plan.axes.values()], initial=1))
        turned = not sheet.plan.model.isotropic
        assert swept >= (16 if turned else 32), sheet.name
        assert sheet.plan.cos_theta.size >= (16 if turned else 32), sheet.name
        assert sheet.plan.phi.size >= (8 if turned else 1), sheet.name


def test_an_interrupted_run_goes_on_where_it_stopped(
    tmp_path: Path, computed: list[np.ndarray]
) -> None:
    sheets = wanted("lambert", "ward_bounded", "blinn", "phong")
    total = sum(len(sheet.plan.pieces) for sheet in sheets)

    def stop(done: int, entries: int) -> None:
        if done > 1024:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        atlas.write_atlas(tmp_path, sheets, progress=stop)
    before = len(computed)
    assert 2 <= before < total
    finished = len(list(tmp_path.rglob("*.npz"))) + 2 * len(list(tmp_path.glob("*.nc")))
    assert finished >= 2
    computed.clear()
    steps: list[tuple[int, int]] = []
    files = atlas.write_atlas(tmp_path, sheets, progress=lambda *step: steps.append(step))
    assert len(computed) == total - finished
    assert steps[-1] == (4 * 1024, 4 * 1024)
    assert sorted(tmp_path.iterdir()) == sorted(files)
    for file, sheet in zip(files, sheets, strict=True):
        with xarray.open_dataset(file, engine="h5netcdf") as table:
            # In one go, with another number of threads: the same bits.
            once = sheet.plan.dataset(
                sheet.plan.join([sheet.plan.compute(piece) for piece in sheet.plan.pieces])
            )
            assert np.array_equal(table["value"].values, once["value"].values)
            assert np.array_equal(table["error"].values, once["error"].values)
            assert table.attrs["model"] == sheet.spec.name
    computed.clear()
    atlas.write_atlas(tmp_path, sheets, threads=2)
    assert not computed


def test_a_table_of_other_inputs_is_made_again(tmp_path: Path, computed: list[np.ndarray]) -> None:
    atlas.write_atlas(tmp_path, wanted("lambert"))
    looser = [sheet for sheet in atlas.sheets(1e-3) if sheet.name == "lambert"]
    stale = tmp_path / ".lambert.0123456789abcdef.parts"
    stale.mkdir()
    computed.clear()
    (file,) = atlas.write_atlas(tmp_path, looser)
    assert len(computed) == len(looser[0].plan.pieces)
    assert not stale.exists()
    with xarray.open_dataset(file, engine="h5netcdf") as table:
        assert table.attrs["rtol"] == 1e-3


def test_damaged_files_are_named(tmp_path: Path) -> None:
    (tmp_path / "lambert.nc").write_bytes(b"no table")
    with pytest.raises(albedo.InputError, match=r"lambert\.nc' is damaged"):
        atlas.write_atlas(tmp_path, wanted("lambert"))
    (tmp_path / "lambert.nc").unlink()
    (sheet,) = wanted("lambert")
    parts = tmp_path / f".lambert.{sheet.key()}.parts"
    parts.mkdir()
    (parts / "00000.npz").write_bytes(b"no piece")
    with pytest.raises(albedo.InputError, match=r"00000\.npz' is damaged"):
        atlas.write_atlas(tmp_path, [sheet])


def test_the_command_line_refuses_what_does_not_go_together(tmp_path: Path) -> None:
    runner = CliRunner()
    for arguments, words in (
        (["--all", "ward", "-o", str(tmp_path)], "does not go with a model"),
        (["--all", "--cos", "1", "-o", str(tmp_path)], "does not go with --cos"),
        (["-o", str(tmp_path / "a.nc")], "Name a model"),
    ):
        result = runner.invoke(app, ["table", *arguments])
        assert result.exit_code == 2
        assert re.search(words, result.output)
    file = tmp_path / "file"
    file.write_text("")
    result = runner.invoke(app, ["table", "--all", "-o", str(file)])
    assert result.exit_code == 2
    assert "is a file; the tables need a folder" in result.output
