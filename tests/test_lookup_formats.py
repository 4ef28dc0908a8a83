"""Files of lookup tables: what is written is read, and nothing else is."""

from __future__ import annotations

import json
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lookups import all_kinds, lookup_table
from tools import need_module
from typer.testing import CliRunner

import albedo
from albedo.cli import app
from albedo.errors import InputError
from albedo.lookup import formats as room
from albedo.lookup.formats import formats, load_lookup, save_lookup
from albedo.lookup.label import LookupTable

READABLE = [own for own in formats().values() if own.load is not None]
KINDS = all_kinds()


def names_of(kind: dict[str, Any]) -> str:
    return "-".join(str(v) for v in kind.values())


@pytest.mark.parametrize("own", READABLE, ids=lambda own: own.name)
@pytest.mark.parametrize("kind", KINDS, ids=names_of)
def test_what_is_written_is_read(own: room.Format, kind: dict[str, Any], tmp_path: Path) -> None:
    table = lookup_table(**kind)
    stored = table.channels[0].table.stored
    target = tmp_path / f"table{own.suffix}"
    if stored not in own.stored:
        with pytest.raises(InputError, match=rf"{own.name} holds no {stored}; design the table"):
            save_lookup(table, target)
        assert not list(tmp_path.iterdir())
        return
    found = load_lookup(save_lookup(table, target))
    assert found.label == table.label
    assert found.sha256 == table.sha256
    for one, other in zip(found.channels, table.channels, strict=True):
        np.testing.assert_array_equal(one.table.data, other.table.data)
        assert one.table.data.dtype == other.table.data.dtype
    assert [path.name for path in tmp_path.iterdir()] == [target.name]


def changed(data: bytes, rng: np.random.Generator) -> bytes:
    """A file with some bytes changed, moved, left out, or put in."""
    found = bytearray(data)
    how, at = rng.integers(7), int(rng.integers(len(found)))
    other = int(rng.integers(len(found)))
    if how == 0:
        found[at] ^= 1 << int(rng.integers(8))
    elif how == 1:
        for k in rng.integers(len(found), size=int(rng.integers(2, 12))):
            found[k] = int(rng.integers(256))
    elif how == 2:
        del found[at:]
    elif how == 3:
        del found[at : at + int(rng.integers(1, 64))]
    elif how == 4:
        found[at:at] = rng.integers(256, size=int(rng.integers(1, 64)), dtype=np.uint8).tobytes()
    elif how == 5:
        piece = bytes(found[at : at + 32])
        found[other : other + len(piece)] = piece
    else:
        # Sizes and offsets are such words; large ones ask for memory.
        found[at : at + 4] = rng.choice([b"\xff\xff\xff\x7f", b"\xff\xff\xff\xff", b"\0\0\0\0"])
    return bytes(found)


FUZZ = """
import resource, sys
import numpy as np
from pathlib import Path
from hypothesis import HealthCheck, given, settings, strategies as st
sys.path.insert(0, {tests!r})
from test_lookup_formats import changed
from albedo.errors import InputError
from albedo.lookup.formats import load_lookup
# Far more than a table of a kilobyte needs; what asks for more is refused memory.
resource.setrlimit(resource.RLIMIT_AS, (6 * 2**30, 6 * 2**30))
whole, known = Path({path!r}), load_lookup({path!r})
data, target = whole.read_bytes(), whole.with_name("changed" + whole.suffix)
same = 0
@settings(
    max_examples={count}, derandomize=True, database=None, deadline=5000,
    suppress_health_check=list(HealthCheck),
)
@given(st.integers(0, 2**63 - 1))
def look(seed):
    global same
    target.write_bytes(changed(data, np.random.default_rng(seed)))
    try:
        found = load_lookup(target)
    except InputError as error:
        assert str(error).startswith(f"'{{target}}' is not read: "), error
        assert chr(10) not in str(error), error
    else:
        # What no value, coordinate or attribute lies in may change.
        assert found.sha256 == known.sha256 and found.label == known.label
        same += 1
look()
print(same)
"""


@pytest.mark.parametrize("kind", ["float32", "unorm16"])
@pytest.mark.parametrize("own", READABLE, ids=lambda own: own.name)
def test_damaged_files_are_refused(own: room.Format, kind: str, tmp_path: Path) -> None:
    """Two thousand of each format, in another process: what crashes a library is seen here."""
    stored = kind if kind in own.stored else "float16"
    path = save_lookup(lookup_table(stored=stored), tmp_path / f"table{own.suffix}")
    script = FUZZ.format(tests=str(Path(__file__).parent), path=str(path), count=1000)
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", script], capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr[-2000:]
    # Most changes are seen: few bytes of a file mean nothing.
    assert int(done.stdout.split()[-1]) < 400


def rewritten(path: Path, change: Any) -> Path:
    """A JSON file with another label."""
    content = json.loads(path.read_text())
    change(content["label"], content["data"])
    path.write_text(json.dumps(content))
    return path


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda label, data: label.update(format="other"), "is wrong at format"),
        (lambda label, data: label.update(more=1), "Additional properties"),
        (lambda label, data: label.pop("model"), "'model' is a required property"),
        (lambda label, data: label["axes"][0].update(count=10**9), "is wrong at axes/0/count"),
        (
            lambda label, data: label["axes"][0].update(even_in="log:3"),
            "the warp 'log:3' is unknown",
        ),
        (lambda label, data: label["axes"][1].update(even_in="log"), "even in log"),
        (lambda label, data: label["axes"][0].update(low=2.0), "from 2 to 1"),
        (lambda label, data: label["axes"][0].update(name="cos_theta"), "of the same name"),
        (
            lambda label, data: label["axes"][1].update(even_in="rational:1*x"),
            "names no other axis",
        ),
        (
            lambda label, data: [axis.update(count=60000) for axis in label["axes"]],
            "or over 16777216 numbers",
        ),
        (lambda label, data: label["channels"][0].update(step=0.0), "is wrong at channels/0/step"),
        (lambda label, data: label.update(quantity="split_sum"), "channels of its quantity"),
        (
            lambda label, data: label["channels"][0]["errors"].update(map=[1.0]),
            "map of errors of another shape",
        ),
        (lambda label, data: label["channels"][0]["errors"].update(largest=1e-9), "the digest"),
        (lambda label, data: data["albedo"][0].__setitem__(0, 0.5), "the digest"),
        (lambda label, data: data["albedo"].pop(), "shape"),
        (lambda label, data: data.update(albedo="none"), "has no numbers of the channel"),
        (lambda label, data: data.update(albedo=[[1e300] * 6] * 7), "not finite"),
        (lambda label, data: data.pop("albedo"), "has no numbers of the channel"),
    ],
)
def test_what_no_table_has_is_told(change: Any, said: str, tmp_path: Path) -> None:
    path = rewritten(save_lookup(lookup_table(), tmp_path / "table.json"), change)
    with pytest.raises(InputError, match=f"table.json' is not read: .*{said}"):
        load_lookup(path)


def test_numbers_that_are_none_are_refused(tmp_path: Path) -> None:
    path = save_lookup(lookup_table(), tmp_path / "table.json")
    text = path.read_text()
    first = text.index("data")
    start = text.index("[[", first) + 2
    path.write_text(text[:start] + "NaN" + text[text.index(",", start) :])
    with pytest.raises(InputError, match="NaN is no number"):
        load_lookup(path)


def test_coordinates_and_words_are_compared(tmp_path: Path) -> None:
    """They are not what a reading needs, and are compared all the same."""
    from scipy.io import netcdf_file

    table = lookup_table(warps=("linear", "rational:0.5*m"), stored="unorm16")
    for said, change in {
        "coordinates": lambda file: file.variables["m"].data.__setitem__(3, 0.5),
        "its coordinates": lambda file: file.variables["cos_theta_at"].data.__setitem__(
            (1, 1), 0.5
        ),
        "attribute 'model'": lambda file: setattr(file, "model", "another"),
        "attribute 'add_offset'": lambda file: setattr(file.variables["albedo"], "add_offset", 0.1),
    }.items():
        path = save_lookup(table, tmp_path / "table.nc")
        with netcdf_file(path, "a", mmap=False) as file:
            change(file)
        with pytest.raises(InputError, match=said):
            load_lookup(path)
    path = save_lookup(table, tmp_path / "table.csv")
    path.write_text(path.read_text().replace("\n1.0,1.0,", "\n1.0,0.9,"))
    with pytest.raises(InputError, match="coordinates"):
        load_lookup(path)


def test_netcdf_is_read_by_xarray(tmp_path: Path) -> None:
    """Which knows its conventions: shares are unpacked, and axes have their coordinates."""
    import xarray

    table = lookup_table(stored="unorm8")
    with xarray.open_dataset(save_lookup(table, tmp_path / "t.nc"), engine="scipy") as found:
        np.testing.assert_allclose(found["albedo"], table.channels[0].table.values, rtol=1e-6)
        np.testing.assert_array_equal(found["m"], table.grid.nodes()[0])
        assert found.attrs["model"] == "nothing:m=0.5"


@pytest.mark.parametrize(("stored", "quantity"), [("float32", "albedo"), ("float16", "split_sum")])
def test_openexr_is_read_by_another_library(stored: str, quantity: str, tmp_path: Path) -> None:
    """Pixels to the last bit, in rows of the first axis, and the label in the header."""
    oiio = need_module("OpenImageIO")
    table = lookup_table(stored=stored, quantity=quantity)
    picture = oiio.ImageInput.open(str(save_lookup(table, tmp_path / "t.exr")))
    spec = picture.spec()
    pixels = picture.read_image(format="float")
    picture.close()
    assert (spec.height, spec.width) == table.grid.counts
    assert str(spec.format) == {"float32": "float", "float16": "half"}[stored]
    assert list(spec.channelnames) == (["Y"] if quantity == "albedo" else ["R", "G"])
    for k, channel in enumerate(table.channels):
        found = pixels.reshape(spec.height, spec.width, -1)[:, :, k]
        np.testing.assert_array_equal(found.astype(float), channel.table.values)
    assert json.loads(spec["label"])["sha256"] == table.sha256


def test_archives_run_nothing_and_do_not_burst(tmp_path: Path) -> None:
    path = tmp_path / "table.npz"
    text = json.dumps({**lookup_table().label, "sha256": lookup_table().sha256})
    # An object that a pickle would make.
    np.savez(path, label=np.array(text), albedo=np.array([[print]], dtype=object))
    with pytest.raises(InputError, match=r"Object arrays cannot be loaded"):
        load_lookup(path)
    np.savez_compressed(path, label=np.array(text), albedo=np.zeros(2**24))
    with pytest.raises(InputError, match=r"array 'albedo' has 134217856 bytes, more than 168"):
        load_lookup(path)
    np.savez_compressed(path, label=np.array("x" * 2**21), albedo=np.zeros(1))
    with pytest.raises(InputError, match=r"array 'label' has 8388736 bytes"):
        load_lookup(path)


def test_tables_of_albedos_are_told_from_lookup_tables(tmp_path: Path) -> None:
    from albedo.files import save_table

    path = save_table(albedo.table(albedo.model("lambert"), [0.1, 0.5, 1.0]), tmp_path / "t.nc")
    with pytest.raises(InputError, match="netCDF 4, such as `albedo table` writes"):
        load_lookup(path)


def test_large_files_are_not_opened(tmp_path: Path) -> None:
    path = tmp_path / "table.nc"
    with path.open("wb") as file:
        file.truncate(2**28 + 1)
    with pytest.raises(InputError, match="has 268435457 bytes; a table has at most 268435456"):
        load_lookup(path)
    with pytest.raises(InputError, match="cannot be read: No such file"):
        load_lookup(tmp_path / "none.nc")
    (tmp_path / "folder.nc").mkdir()
    with pytest.raises(InputError, match="is no file"):
        load_lookup(tmp_path / "folder.nc")


KILLED = """
import sys, time
from pathlib import Path
sys.path.insert(0, {tests!r})
from lookups import lookup_table
from albedo.lookup import formats as room
own = room.formats()[{name!r}]
def slow(table, path):
    path.write_bytes(b"half of a file")
    print("begun", flush=True)
    time.sleep(60.0)
room.formats = lambda: {{{name!r}: room.Format(own.name, own.suffix, own.title, slow, own.load)}}
room.save_lookup(lookup_table(seed=1), {path!r})
"""


@pytest.mark.parametrize("own", READABLE, ids=lambda own: own.name)
def test_a_killed_export_leaves_the_former_file(own: room.Format, tmp_path: Path) -> None:
    path = save_lookup(lookup_table(), tmp_path / f"table{own.suffix}")
    script = KILLED.format(tests=str(Path(__file__).parent), name=own.name, path=str(path))
    with subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(script)], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "begun\n"
        process.kill()
    assert load_lookup(path).sha256 == lookup_table().sha256
    # What a process that was killed left behind has a name that nobody looks for.
    assert all(p == path or p.name.startswith(".") for p in tmp_path.iterdir())


def test_export_on_the_command_line(tmp_path: Path) -> None:
    first = save_lookup(lookup_table(), tmp_path / "table.nc")
    run = CliRunner()
    done = run.invoke(app, ["export", str(first), "-o", str(tmp_path / "table.csv")])
    assert done.exit_code == 0
    assert "7 (root of m) x 6 (cos_theta) points of float32, 168 bytes" in done.stdout
    assert load_lookup(tmp_path / "table.csv").sha256 == lookup_table().sha256
    for words, said in {
        ("none.nc", "-o", "t.csv"): "none.nc' cannot be read",
        ("table.nc", "-o", "t.what"): "must end in one of",
        ("table.nc", "-o", "t.csv", "--to", "what"): "the format 'what' is unknown",
        ("table.nc", "-o", "nowhere/t.csv"): "there is no folder",
    }.items():
        name, flag, target, *rest = words
        done = run.invoke(
            app, ["export", str(tmp_path / name), flag, str(tmp_path / target), *rest]
        )
        assert done.exit_code == 2
        assert said in done.stderr
        assert not (tmp_path / target).exists()


def test_formats_are_found_by_their_names() -> None:
    assert {"netcdf", "csv", "npz", "json", "exr"} <= set(formats())
    assert albedo.load_lookup is load_lookup
    assert all(isinstance(own.title, str) and own.suffix[0] == "." for own in formats().values())
    assert isinstance(lookup_table(), LookupTable)
