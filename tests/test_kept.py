"""Tables that are kept on disk: bit for bit what was written, or computed anew."""

from __future__ import annotations

import importlib.util
import math
import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import albedo
from albedo.brdf import Model
from albedo.errors import CacheWarning
from albedo.estimate import Estimate
from albedo.operators import kept, mapping
from albedo.operators.maps import LogMap
from albedo.operators.pump import _of_stage
from albedo.operators.stages import Stages, stages
from albedo.progress import watched

ELLIPTIC = albedo.model("ward", alpha_x=0.4, alpha_y=0.2)
UPRIGHT = albedo.model("lafortune", lobes=((0.0, 0.0, 1.0, 1.0),))


@pytest.fixture
def folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Everything is kept, here, and as soon as it is there."""
    monkeypatch.setattr(kept, "_folder", lambda: tmp_path / "tables")
    monkeypatch.setattr(kept, "_WORTH", 0.0)
    return tmp_path / "tables"


class Counter:
    """Counts the albedos that tables compute, and may be interrupted."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.rows, self.most = 0, math.inf
        self._compute = mapping.albedo_rows
        # As seen from nodes of tables: those that look for symmetry have no such limit.
        monkeypatch.setattr(mapping, "albedo_rows", self)

    def __call__(self, models: Any, c: np.ndarray, phi: np.ndarray, **options: Any) -> Estimate:
        if "max_evaluations" in options:
            if self.rows >= self.most:
                raise KeyboardInterrupt
            self.rows += c.size
        return self._compute(models, c, phi, **options)


@pytest.fixture
def counter(monkeypatch: pytest.MonkeyPatch) -> Counter:
    """One thread, and few albedos at once."""
    monkeypatch.setenv("ALBEDO_THREADS", "1")
    monkeypatch.setattr(mapping, "_CHUNK", 32)
    return Counter(monkeypatch)


def tables(base: Model, steps: int, rtol: float = 1e-3) -> tuple[LogMap, ...]:
    """The tables as a process makes them that knows nothing."""
    stages.cache_clear()
    return albedo.pump(base, steps, rtol=rtol).albedos


def assert_same(first: LogMap, second: LogMap) -> None:
    for one in fields(LogMap):
        a, b = getattr(first, one.name), getattr(second, one.name)
        assert type(a) is type(b)
        if isinstance(a, np.ndarray):
            assert (a.dtype, a.shape) == (b.dtype, b.shape)
            assert a.tobytes() == b.tobytes()
        else:
            assert a == b


@pytest.mark.parametrize(("base", "steps"), [(ELLIPTIC, 1), (UPRIGHT, 2)], ids=str)
def test_a_kept_table_is_what_was_written(
    base: Model, steps: int, folder: Path, counter: Counter
) -> None:
    made = tables(base, steps)
    assert sorted(path.suffix for path in folder.iterdir()) == [".table"] * steps
    assert counter.rows > 0
    counter.rows = 0
    for one, again in zip(made, tables(base, steps), strict=True):
        assert_same(one, again)
    assert counter.rows == 0
    # And what is divided by it is worth the same.
    model = albedo.pump(base, steps, rtol=1e-3)
    found = albedo.directional_albedo(model, 0.5, 0.3, rtol=model.usual_rtol)
    exact = albedo.directional_albedo(albedo.pump(base, steps, rtol=1e-5), 0.5, 0.3, rtol=1e-4)
    assert abs(found.value - exact.value) <= found.error + exact.error


def test_what_was_computed_of_a_table_is_not_computed_again(folder: Path, counter: Counter) -> None:
    (whole,) = tables(ELLIPTIC, 1)
    total = counter.rows
    for path in folder.iterdir():
        path.unlink()
    counter.rows, counter.most = 0, total // 2
    with pytest.raises(KeyboardInterrupt):
        tables(ELLIPTIC, 1)
    done = counter.rows
    assert done >= total // 2
    assert {path.suffix for path in folder.iterdir()} == {".rows"}
    counter.rows, counter.most = 0, math.inf
    (table,) = tables(ELLIPTIC, 1)
    # Rectangles next to each other share nodes: some are found that were not asked for before.
    assert counter.rows <= total - done
    assert_same(table, whole)
    assert {path.suffix for path in folder.iterdir()} == {".table"}


def test_a_thread_that_comes_late_loses_nothing(folder: Path) -> None:
    """Interrupted while it starts a thread, a pool does not wait for it."""
    told: list[tuple[int, int]] = []
    shelf = kept.Shelf("late", lambda done, known: told.append((done, known)))
    c, phi = np.array([0.25, 0.5]), np.zeros(2)
    assert np.isnan(shelf.known(c, phi)).all()
    shelf.close()
    found = albedo.directional_albedo(UPRIGHT, c)
    shelf.put(c, phi, found)
    # Whoever watched has gone.
    assert told == [(0, 2)]
    again = kept.Shelf("late")
    assert again.finished() is None
    known = np.column_stack((found.value, found.error, found.evaluations))
    np.testing.assert_array_equal(again.known(c, phi), known)


def test_what_is_quickly_made_is_not_kept(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kept, "_WORTH", math.inf)
    tables(UPRIGHT, 1)
    assert not folder.exists()


def cut(content: bytes) -> bytes:
    return content[: len(content) // 2]


def flip(content: bytes) -> bytes:
    middle = len(content) // 2
    return content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]


def other(content: bytes) -> bytes:
    """A file that is whole, but not of this table."""
    shelf = kept.Shelf("other")
    return shelf._sealed(content[32:]) + content[32:]


@pytest.mark.parametrize("damage", [cut, flip, other, lambda content: b""])
@pytest.mark.parametrize("finished", [True, False])
def test_a_damaged_file_is_told_and_made_again(
    finished: bool, damage: Callable[[bytes], bytes], folder: Path, counter: Counter
) -> None:
    (whole,) = tables(UPRIGHT, 1)
    total = counter.rows
    if not finished:
        for path in folder.iterdir():
            path.unlink()
        counter.rows, counter.most = 0, 1
        with pytest.raises(KeyboardInterrupt):
            tables(UPRIGHT, 1)
        counter.most = math.inf
    (path,) = folder.iterdir()
    path.write_bytes(damage(path.read_bytes()))
    counter.rows = 0
    with pytest.warns(CacheWarning, match="is damaged; it is removed and made again"):
        (table,) = tables(UPRIGHT, 1)
    assert counter.rows == total
    assert_same(table, whole)
    counter.rows = 0
    tables(UPRIGHT, 1)
    assert counter.rows == 0


def test_a_folder_that_cannot_be_written_stops_nothing(folder: Path) -> None:
    folder.write_text("a file")
    with pytest.warns(CacheWarning) as caught:
        tables(UPRIGHT, 1)
    said = [str(one.message) for one in caught]
    assert said[0].startswith("The kept file")
    assert said[1:] == [f"The folder '{folder}' cannot keep tables: File exists"]
    assert folder.read_text() == "a file"


def test_files_that_were_not_used_for_longest_go_first(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tables(UPRIGHT, 1)
    (first,) = folder.iterdir()
    tables(UPRIGHT, 1, 1e-4)
    (second,) = set(folder.iterdir()) - {first}
    for age, path in enumerate((second, first)):
        os.utime(path, (age, age))
    # Reading counts as use.
    tables(UPRIGHT, 1, 1e-4)
    room = second.stat().st_size
    monkeypatch.setattr(kept, "_ROOM", room)
    kept._tidy(folder)
    assert list(folder.iterdir()) == [second]
    # Whatever is written makes room for itself.
    tables(UPRIGHT, 1, 1e-5)
    assert sum(path.stat().st_size for path in folder.iterdir()) <= room
    assert not second.exists()


def test_two_that_make_the_same_table_do_not_disturb_each_other(folder: Path) -> None:
    """Threads with shelves of their own: on the disk they are as two processes."""
    found: list[LogMap] = []
    makers = [Stages(ELLIPTIC, None, 1e-3, _of_stage) for _ in range(2)]
    threads = [
        threading.Thread(target=lambda maker=maker: found.extend(maker.albedos(1)))
        for maker in makers
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert_same(*found)
    # Albedos that the slower one wrote last may be left.
    assert [path.suffix for path in folder.iterdir()].count(".table") == 1
    (table,) = tables(ELLIPTIC, 1)
    assert_same(table, found[0])


def test_two_threads_make_one_series_of_tables() -> None:
    maker = Stages(UPRIGHT, None, 1e-3, _of_stage)
    threads = [threading.Thread(target=maker.albedos, args=(2,)) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(maker.tables) == 2
    c, phi = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8]]).T[2], 0.0
    for k, table in enumerate(maker.tables):
        known = albedo.directional_albedo(albedo.pump(UPRIGHT, k, rtol=1e-3), c, phi, rtol=1e-2)
        wi = np.column_stack((np.sqrt((1.0 - c) * (1.0 + c)), 0.0 * c, c))
        slack = (maker.doubt(k) + table.error.max()) * known.value + known.error
        assert np.all(np.abs(table.at(wi) - known.value) <= slack)


KEYED: dict[str, tuple[Model, tuple[Any, ...]]] = {
    "as it is": (ELLIPTIC, (1e-3, 100)),
    "next number": (ELLIPTIC.replace(alpha_x=math.nextafter(0.4, 1.0)), (1e-3, 100)),
    "other parameter": (ELLIPTIC.replace(form="fast"), (1e-3, 100)),
    "other class": (albedo.model("ward_duer", alpha_x=0.4, alpha_y=0.2), (1e-3, 100)),
    "sum": (ELLIPTIC + 0.3 * albedo.model("lambert"), (1e-3, 100)),
    "sum, other factor": (ELLIPTIC + 0.4 * albedo.model("lambert"), (1e-3, 100)),
    "step": (_of_stage(UPRIGHT, 1, None, 1e-3), (1e-3, 100)),
    "next step": (_of_stage(UPRIGHT, 2, None, 1e-3), (1e-3, 100)),
    "control": (_of_stage(UPRIGHT, 1, "literal", 1e-3), (1e-3, 100)),
    "tables asked for": (_of_stage(UPRIGHT, 1, None, 1e-4), (1e-3, 100)),
    "tolerance": (ELLIPTIC, (math.nextafter(1e-3, 1.0), 100)),
    "most": (ELLIPTIC, (1e-3, 101)),
    "starts": (ELLIPTIC, (1e-3, 100, mapping.STARTS)),
    "no starts": (ELLIPTIC, (1e-3, 100, ())),
    "text": (ELLIPTIC, (str((1e-3).hex()), 100)),
}


def test_all_that_numbers_depend_on_is_in_the_key(monkeypatch: pytest.MonkeyPatch) -> None:
    keys = {name: kept._key(*of) for name, of in KEYED.items()}
    assert None not in keys.values()
    assert len(set(keys.values())) == len(keys)
    assert {name: kept._key(*of) for name, of in KEYED.items()} == keys
    (table,) = tables(UPRIGHT, 1)
    series = table.series.copy()
    series.flat[0] = np.nextafter(series.flat[0], 2.0)
    changed = LogMap(**{**vars(table), "series": series})
    before = [kept._key(UPRIGHT, (1e-3, one)) for one in ((), (table,), (changed,), (table, table))]
    assert len({*before}) == 4
    monkeypatch.setattr(kept, "digest", lambda *folders: "other sources")
    assert kept._key(*KEYED["as it is"]) not in (None, keys["as it is"])


def test_values_that_were_computed_once_do_not_change_the_key() -> None:
    model = albedo.pump(UPRIGHT, 1, rtol=1e-3)
    key = kept._key(model, ())
    assert not model._in_rings
    assert "_in_rings" in vars(model)
    assert kept._key(model, ()) == key


SOURCE = """
import math
import os

from albedo._compile import kernel
from albedo.brdf import Model, Part, Real
from albedo.charts.cosine import CosineChart


SCALE = float(os.environ.get("KEPT_SCALE", "1.0"))


@kernel
def scaled(x):
    return SCALE * x / math.pi


@kernel
def fill(wi, wo, h, p, out):
    for j in range(out.shape[0]):
        for i in range(out.shape[1]):
            out[j, i] = scaled(p[j, 0])


class Mine(Model):
    name = "mine"
    rho = Real(0.5, "albedo", high=1.0)

    def pack(self):
        return (self.rho,)

    def parts(self):
        return (Part("diffuse", FILL, CosineChart("max")),)


def made_here(scale):
    class Mine(Model):
        name = "mine"

        def pack(self):
            return (scale,)

    return Mine()


def closed(scale):
    def filled(wi, wo, h, p, out):
        out[...] = scale

    return filled
"""


NAME = "kept_model_of_mine"


def loaded(path: Path, text: str | None = None) -> Any:
    """A module of a user, loaded from its file as it is now, or is to be."""
    if text is not None:
        path.write_text(text)
    spec = importlib.util.spec_from_file_location(NAME, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[NAME] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def mine(tmp_path: Path) -> Iterator[Path]:
    sys.dont_write_bytecode, before = True, sys.dont_write_bytecode
    yield tmp_path / "mine.py"
    sys.dont_write_bytecode = before
    sys.modules.pop(NAME, None)


def test_a_model_of_a_user_is_known_by_its_sources(mine: Path) -> None:
    text = SOURCE.replace("FILL", "fill")
    first = loaded(mine, text).Mine()
    key = kept._key(first, ())
    assert key is not None
    assert kept._key(first.replace(rho=0.4), ()) != key
    # A neighbour that it may read counts as well.
    helper = mine.with_name("helper.py")
    helper.write_text("scale = 1.0\n")
    os.utime(helper, (0, 0))
    assert kept._key(first, ()) not in (None, key)
    helper.unlink()
    # Edited, and not loaded again: what is on the disk is not what runs.
    mine.write_text(text.replace("scaled(p[j, 0])", "scaled(0.5 * p[j, 0])"))
    os.utime(mine, (4e9, 4e9))
    assert kept._key(first, ()) is None
    edited = loaded(mine, mine.read_text()).Mine()
    assert kept._key(edited, ()) not in (None, key)
    assert kept._key(first, ()) is None
    assert kept._key(loaded(mine, text).Mine(), ()) == key


def test_scripts_beside_each_other_are_told_apart(mine: Path) -> None:
    """A class of the same name, in modules of the same name: `__main__`."""
    other = mine.with_name("other.py")
    mine.write_text(SOURCE.replace("FILL", "fill"))
    other.write_text(SOURCE.replace("FILL", "fill").replace("SCALE * x", "0.5 * SCALE * x"))
    keys = [kept._key(loaded(path).Mine(), ()) for path in (mine, other)]
    assert None not in keys
    assert keys[0] != keys[1]


def test_what_a_kernel_reads_beside_its_parameters_is_in_the_key(
    mine: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = SOURCE.replace("FILL", "fill")
    key = kept._key(loaded(mine, text).Mine(), ())
    monkeypatch.setenv("KEPT_SCALE", "0.5")
    assert kept._key(loaded(mine).Mine(), ()) not in (None, key)
    monkeypatch.setenv("KEPT_SCALE", "1.0")
    assert kept._key(loaded(mine).Mine(), ()) == key
    # Nobody can tell what an object is.
    held = loaded(mine, text.replace("SCALE = float(os", "SCALE, OLD = object(), float(os"))
    assert kept._key(held.Mine(), ()) is None


def test_nothing_is_kept_of_what_cannot_be_told(mine: Path, folder: Path) -> None:
    module = loaded(mine, SOURCE.replace("FILL", "fill"))
    assert kept._key(module.made_here(0.5), ()) is None
    captured = loaded(mine, SOURCE.replace("FILL", "closed(0.5)"))
    assert kept._key(captured.Mine(), ()) is None
    assert kept._key(ELLIPTIC + captured.Mine(), ()) is None
    plain = albedo.model_from(
        lambda wi, wo: np.full(wo.shape[:-1], 0.5 / np.pi), lobe="diffuse", reciprocal=True
    )
    assert kept._key(plain, ()) is None
    tables(plain, 1)
    assert not folder.exists()


def test_who_watches_is_told_how_many_albedos_are_done(folder: Path, counter: Counter) -> None:
    told: dict[str, list[tuple[int, int]]] = {}

    @contextmanager
    def watcher(what: str) -> Iterator[Callable[[int, int], None]]:
        told[what] = []
        yield lambda done, known: told[what].append((done, known))

    counter.most = 64
    with watched(watcher), pytest.raises(KeyboardInterrupt):
        tables(UPRIGHT, 2)
    counter.most = math.inf
    rows = counter.rows
    with watched(watcher):
        tables(UPRIGHT, 2)
    assert list(told) == ["table 1", "table 2"]
    for steps in told.values():
        assert steps == sorted(steps)
        assert all(done <= known for done, known in steps)
        assert steps[-1][0] == steps[-1][1]
    # What an earlier run knew is done as soon as it is asked for.
    assert told["table 1"][0][0] > 0
    assert sum(steps[-1][0] for steps in told.values()) >= counter.rows - rows
    tables(UPRIGHT, 2, 1e-4)
    assert list(told) == ["table 1", "table 2"]
