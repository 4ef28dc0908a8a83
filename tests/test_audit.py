"""Tables that were made elsewhere, most of them wrong in a known way: each is named and found."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lookups import lookup_table
from tools import need_module
from typer.testing import CliRunner

import albedo
from albedo.brdf import Model
from albedo.cli import app
from albedo.errors import InputError
from albedo.lookup.audit import audit, said_to_be, shaped
from albedo.lookup.foreign import load_array
from albedo.lookup.formats import save_lookup
from albedo.quadrature import albedo_rows
from albedo.testing import assert_table_close

COUNT = 12
# Two maskings, so that references are made for as many only.
SOME = {"masking": "smith_correlated"}


def ggx(**values: Any) -> Model:
    return albedo.model("cook_torrance", **{"distribution": "ggx", "geometry": "smith", **values})


@cache
def table(geometry: str = "smith_correlated", texels: str = "centres", root: bool = True) -> Any:
    """Rows of roughness, columns of cosines: a generator that is right, in its own convention."""
    u = (np.arange(COUNT) + 0.5) / COUNT if texels == "centres" else np.linspace(0.0, 1.0, COUNT)
    alpha = np.clip(u * u if root else u, 2e-3, 1.0)
    mu = np.clip(u, 1e-9, 1.0)
    models = [ggx(m=a, geometry=geometry) for a in alpha.tolist()]
    rows = [model for model in models for _ in range(COUNT)]
    found = albedo_rows(rows, np.tile(mu, COUNT), np.zeros(COUNT**2), rtol=1e-6, atol=0.0)
    return found.value.reshape(COUNT, COUNT)


def seen(data: np.ndarray, **how: Any) -> Any:
    return audit(data, ggx(), "m", fixed={**SOME, **how})


def test_a_table_that_is_right() -> None:
    found = seen(table())
    how = found.best.convention
    assert found.fits
    assert (how.rows, how.columns) == ("m", "cos_theta")
    assert (how.texels, how.cosine, how.parameter) == ("centres", "cos", "its root")
    assert how.channels == ("albedo",)
    assert how.encoding == "as it is"
    # What its nodes and the references err by.
    assert found.best.nodes < 3e-5
    # The first texel is read half a texel nearer to the horizon than it is.
    assert found.largest > 0.03
    assert found.second is not None
    assert found.second.rms > 100.0 * found.best.rms


@pytest.mark.parametrize(
    ("wrong", "part", "name"),
    [
        (lambda t: t.T, "rows", "cos_theta"),
        (lambda t: t[::-1], "parameter", "1 - its root"),
        (lambda t: t[:, ::-1], "cosine", "1 - cos"),
        (lambda t: 1.0 - t, "channels", ("complement",)),
        (lambda t: t / np.pi, "encoding", "over pi"),
        (lambda t: 0.5 * t, "encoding", "half"),
        (
            lambda t: np.where(t <= 0.0031308, 12.92 * t, 1.055 * t ** (1 / 2.4) - 0.055),
            "encoding",
            "sRGB",
        ),
    ],
)
def test_conventions_are_told_apart(wrong: Any, part: str, name: Any) -> None:
    found = seen(wrong(table()))
    assert found.fits
    assert getattr(found.best.convention, part) == name
    assert found.best.nodes < 1e-4


def test_texels_and_roughness_are_told_apart() -> None:
    ends = seen(table(texels="ends")).best
    assert (ends.convention.texels, ends.convention.parameter) == ("ends", "its root")
    plain = seen(table(root=False)).best
    assert (plain.convention.texels, plain.convention.parameter) == ("centres", "itself")
    assert max(ends.nodes, plain.nodes) < 3e-5


def test_another_masking_is_named() -> None:
    found = audit(table("smith"), said_to_be("ggx"), "m")
    assert found.fits
    assert found.best.convention.masking == "smith"
    assert "geometry=smith," in found.model
    # Uncorrelated masking is darker by up to a tenth.
    with pytest.raises(AssertionError, match="more than atol"):
        assert_table_close(
            table("smith"), "ggx", atol=0.01, between=False, masking="smith_correlated"
        )
    assert_table_close(table("smith"), "ggx", atol=1e-4, between=False, masking="smith")


def test_noise_and_bias_are_told_apart() -> None:
    rng = np.random.default_rng(1)
    noisy = seen(table() + 4e-3 * rng.normal(size=(COUNT, COUNT)))
    assert noisy.fits
    assert noisy.noise > 0.8
    assert noisy.best.rms == pytest.approx(4e-3, rel=0.2)
    biased = seen(0.995 * table())
    assert biased.fits
    assert biased.noise < 0.2
    assert biased.best.nodes == pytest.approx(5e-3, rel=0.2)


def test_what_is_no_table_fits_nothing() -> None:
    found = seen(np.random.default_rng(2).uniform(size=(COUNT, COUNT)))
    assert not found.fits
    assert "NOT what any convention gives" in str(found)


def test_split_sums_in_either_order() -> None:
    """Of two channels each is found for itself."""
    u = (np.arange(COUNT) + 0.5) / COUNT
    pairs = np.empty((COUNT, COUNT, 2))
    for k, a in enumerate(np.maximum(u * u, 2e-3).tolist()):
        white, edge = (
            albedo.directional_albedo(
                ggx(m=a, geometry="smith_correlated", fresnel="schlick", f0=f0), u, rtol=1e-6
            ).value
            for f0 in (1.0, 0.0)
        )
        pairs[k, :, 0], pairs[k, :, 1] = white - edge, edge
    found = seen(pairs)
    assert found.best.convention.channels == ("f0", "f90")
    assert seen(pairs[..., ::-1]).best.convention.channels == ("f90", "f0")
    assert found.best.nodes < 1e-4


def test_one_axis_and_a_model_without_masking() -> None:
    u = np.linspace(0.0, 1.0, 33)
    model = albedo.model("phong", n=20.0)
    values = albedo.directional_albedo(model, np.maximum(u, 1e-9), rtol=1e-6).value
    found = audit(values[::-1], model)
    assert found.best.convention.cosine == "1 - cos"
    assert found.best.convention.masking == ""
    assert found.largest < 2e-3
    assert_table_close(values, "phong:n=20", atol=2e-3)
    with pytest.raises(AssertionError, match="the table errs by"):
        assert_table_close(values + 0.01, "phong:n=20", atol=2e-3)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: seen(np.zeros(9)), "should have 2 axes"),
        (lambda: seen(np.zeros((9, 9, 5))), "up to 4 channels"),
        (lambda: seen(np.zeros((1, 9))), "an axis has 2 to 1024 nodes"),
        (lambda: seen(np.full((9, 9), np.nan)), "not finite"),
        (lambda: seen(np.zeros((9, 9)), texels="left"), "texels = 'left' is unknown"),
        (lambda: seen(np.zeros((9, 9)), order="x"), "'order' is no part of a convention"),
        (
            lambda: audit(np.zeros((9, 9)), ggx(), "m", axes=("m", "x")),
            "axes = m,x are not those of the table",
        ),
        (lambda: audit(np.zeros((9, 9)), ggx(alpha_x=0.3), "m"), "no isotropic model"),
        (lambda: said_to_be("phong:n=1..2/2"), "sweeps n"),
        (lambda: shaped(np.zeros(100), (3, 5)), "which are not 3 x 5"),
        (lambda: shaped(np.zeros(100), (0, 5)), "which are not 0 x 5"),
        (lambda: shaped(np.zeros(100), (-5, -5)), "which are not -5 x -5"),
        (lambda: shaped(np.zeros(1000), None), "give its shape"),
        (lambda: assert_table_close(np.zeros(9), "ggx", atol=0.0), "atol = 0.0 is out of range"),
        (lambda: assert_table_close(np.zeros(9), 3, atol=0.1), "needs a model or its name"),
    ],
)
def test_what_cannot_be_audited(call: Any, said: str) -> None:
    with pytest.raises(InputError, match=said):
        call()


def test_lists_have_the_shape_of_a_square() -> None:
    assert shaped(np.zeros(144), None).shape == (12, 12)
    assert shaped(np.zeros(288), None).shape == (12, 12, 2)
    assert shaped(np.zeros(60), (4, 5)).shape == (4, 5, 3)
    assert shaped(np.zeros((1, 60)), None).shape == (60,)
    assert shaped(np.zeros(77), None).shape == (77,)


VALUES = np.random.default_rng(0).uniform(size=(6, 6)).round(4)
NESTED = ",\n".join("{" + ", ".join(f"{x}f" for x in row) + "}" for row in VALUES)
FLAT = ", ".join(f"{x:.4e}" for x in VALUES.ravel())


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.h", f"// 1, 2, 3, 4, 5\n#define N 6\nstatic const float E2[6][6] = {{{NESTED}}};\n"),
        ("a.c", f"/* {{1,2}} */ const float tab[] = {{ {FLAT} }}; float f(int x1) {{ return 1; }}"),
        ("a.js", f"export const v2 = new Float32Array([{FLAT}]);\nconst other = [1, 2, 3, 4];"),
        (
            "a.glsl",
            f"const float lut[36] = float[36]({FLAT});\nvec2 g() {{ return vec2(1., 2.); }}",
        ),
        ("a.py", "E = " + repr(VALUES.tolist()) + "\n"),
        ("a.csv", "\n".join(",".join(map(str, row)) for row in VALUES)),
        ("a.txt", "a b c\n" + "\n".join("  ".join(map(str, row)) for row in VALUES)),
    ],
)
def test_numbers_in_text(name: str, text: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    np.testing.assert_array_equal(load_array(tmp_path / name).ravel(), VALUES.ravel())
    assert shaped(load_array(tmp_path / name), None).shape == (6, 6)


def test_vectors_in_source_are_channels(tmp_path: Path) -> None:
    rows = ",".join(
        "{" + ",".join(f"{{{a}, {b}}}" for a, b in row) + "}" for row in VALUES.reshape(3, 6, 2)
    )
    (tmp_path / "a.h").write_text(f"const float2 t[3][6] = {{{rows}}};")
    np.testing.assert_array_equal(load_array(tmp_path / "a.h"), VALUES.reshape(3, 6, 2))


def test_numbers_in_files(tmp_path: Path) -> None:
    from PIL import Image

    np.save(tmp_path / "a.npy", VALUES)
    np.testing.assert_array_equal(load_array(tmp_path / "a.npy"), VALUES)
    shares = np.rint(255.0 * VALUES).astype(np.uint8)
    # Red and green, with a blue that says nothing.
    pixels = np.stack((shares, shares.T, np.zeros_like(shares)), axis=-1)
    Image.fromarray(pixels).save(tmp_path / "a.png")
    found = load_array(tmp_path / "a.png")
    np.testing.assert_allclose(found, np.stack((shares, shares.T), axis=-1) / 255.0)
    Image.fromarray(np.rint(65535.0 * VALUES).astype(np.uint16)).save(tmp_path / "b.png")
    np.testing.assert_allclose(load_array(tmp_path / "b.png"), VALUES, atol=1e-5)
    exr = need_module("OpenEXR")
    with exr.File({"type": exr.scanlineimage}, {"Y": VALUES.astype(np.float32)}) as file:
        file.write(str(tmp_path / "a.exr"))
    np.testing.assert_array_equal(load_array(tmp_path / "a.exr"), VALUES.astype(np.float32))


def texture(number: int, pixels: np.ndarray) -> bytes:
    """A texture of DirectDraw with pixels of a format of DXGI."""
    header = struct.pack("<4s7I44x", b"DDS ", 124, 0x1007, *pixels.shape[:2], 0, 0, 1)
    header += struct.pack("<2I4s5I", 32, 4, b"DX10", 0, 0, 0, 0, 0) + bytes(20)
    return header + struct.pack("<5I", number, 3, 0, 1, 0) + pixels.tobytes()


@pytest.mark.parametrize(("number", "kind", "channels"), [(34, "<f2", 2), (41, "<f4", 1)])
def test_textures_of_directdraw(number: int, kind: str, channels: int, tmp_path: Path) -> None:
    pixels = np.stack((VALUES, VALUES.T)[:channels], axis=-1).astype(kind)
    path = tmp_path / "a.dds"
    path.write_bytes(texture(number, pixels))
    np.testing.assert_array_equal(load_array(path), np.squeeze(pixels.astype(float)))
    path.write_bytes(texture(number, pixels)[:-1])
    with pytest.raises(InputError, match="does not hold 6 x 6 pixels"):
        load_array(path)


@pytest.mark.parametrize(
    ("name", "data", "said"),
    [
        ("a.what", b"1", "is of no kind that is read"),
        ("a.npy", b"\x93NUMPY", "no array of NumPy"),
        ("a.png", b"no picture", "no PNG"),
        ("a.exr", b"no picture", "no OpenEXR picture"),
        ("a.dds", b"no texture", "no DDS"),
        ("a.h", b"int main() { return 0; }", "no list of numbers"),
        ("a.h", b"\xff\xfe", "is no text"),
        ("a.csv", b"1,2\n3,x\n", "has what is no number"),
        ("a.csv", b"1,2\n3\n", "no rows of equally many numbers"),
        ("a.csv", b"1,2\n", "holds no table"),
        ("a.csv", b"1,nan\n3,4\n", "not finite"),
    ],
)
def test_files_that_hold_no_table(name: str, data: bytes, said: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(InputError, match=said):
        load_array(tmp_path / name)


def test_arrays_of_objects_and_huge_ones_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    np.save(path, np.array([[print, print]], dtype=object), allow_pickle=True)
    with pytest.raises(InputError, match="holds object numbers"):
        load_array(path)
    with path.open("wb") as file:
        header = {"descr": "<f8", "fortran_order": False, "shape": (10**6, 10**6)}
        np.lib.format.write_array_header_1_0(file, header)
    with pytest.raises(InputError, match=r"numbers of shape \(1000000, 1000000\)"):
        load_array(path)


FUZZ = """
import resource, sys
import numpy as np
from pathlib import Path
from hypothesis import HealthCheck, given, settings, strategies as st
sys.path.insert(0, {tests!r})
from test_lookup_formats import changed
from albedo.errors import InputError
from albedo.lookup.foreign import load_array
resource.setrlimit(resource.RLIMIT_AS, (6 * 2**30, 6 * 2**30))
whole = Path({path!r})
data, target = whole.read_bytes(), whole.with_name("changed" + whole.suffix)
@settings(
    max_examples=2000, derandomize=True, database=None, deadline=5000,
    suppress_health_check=list(HealthCheck),
)
@given(st.integers(0, 2**63 - 1))
def look(seed):
    target.write_bytes(changed(data, np.random.default_rng(seed)))
    try:
        found = load_array(target)
    except InputError as error:
        assert chr(10) not in str(error), error
    else:
        assert np.isfinite(found).all() and found.size <= 2**22
look()
"""


@pytest.mark.parametrize("suffix", [".npy", ".csv", ".png", ".exr", ".dds", ".h", ".js"])
def test_damaged_files_are_read_or_refused(suffix: str, tmp_path: Path) -> None:
    """Two thousand of each kind, in another process; arrays have no digest that could be wrong."""
    from PIL import Image

    path = tmp_path / f"a{suffix}"
    if suffix == ".npy":
        np.save(path, VALUES)
    elif suffix == ".png":
        Image.fromarray(np.rint(255.0 * VALUES).astype(np.uint8)).save(path)
    elif suffix == ".exr":
        exr = need_module("OpenEXR")
        with exr.File({"type": exr.scanlineimage}, {"Y": VALUES.astype(np.float32)}) as file:
            file.write(str(path))
    elif suffix == ".dds":
        path.write_bytes(texture(34, np.stack((VALUES, VALUES.T), axis=-1).astype("<f2")))
    elif suffix == ".csv":
        path.write_text("\n".join(",".join(map(str, row)) for row in VALUES))
    else:
        path.write_text(f"const float t[6][6] = {{{NESTED}}};" if suffix == ".h" else f"[{FLAT}]")
    script = FUZZ.format(tests=str(Path(__file__).parent), path=str(path))
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", script], capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr[-2000:]


def test_lookup_tables_are_compared_by_label_and_by_value(tmp_path: Path) -> None:
    model = ggx(geometry="smith_correlated")
    designed = albedo.design(model, {"m": (0.2, 1.0)}, 5e-3)
    path = save_lookup(designed, tmp_path / "t.nc")
    assert_table_close(path, model, atol=6e-3)
    with pytest.raises(AssertionError, match="as its label says"):
        assert_table_close(path, model, atol=1e-4)
    with pytest.raises(AssertionError, match="the table is of cook_torrance with"):
        assert_table_close(path, ggx(geometry="smith"), atol=6e-3)
    # A label may say what is not so; a reading does not.
    other = lookup_table(stored="float32")
    forged = type(other)(other.channels, {**designed.about, "coordinates": "0" * 64})
    with pytest.raises(AssertionError, match="is read as"):
        assert_table_close(save_lookup(forged, tmp_path / "f.npz"), model, atol=6e-3)


def test_audit_on_the_command_line(tmp_path: Path) -> None:
    run = CliRunner()
    np.save(tmp_path / "t.npy", table())
    words = ["audit", str(tmp_path / "t.npy"), "--model", "ggx"]
    words += ["--known", "masking=smith_correlated", "--axes", "m,cos_theta"]
    plot, record = tmp_path / "t.png", tmp_path / "t.json"
    done = run.invoke(app, [*words, "--plot", str(plot), "-o", str(record)])
    assert done.exit_code == 0, done.output
    assert "rows m, columns cos_theta; texels at centres; even in cos_theta" in done.stdout
    assert plot.stat().st_size > 10_000
    assert json.loads(record.read_text())["best"]["convention"]["parameter"] == "its root"
    np.save(tmp_path / "t.npy", np.random.default_rng(0).uniform(size=(COUNT, COUNT)))
    assert run.invoke(app, [*words, "--json"]).exit_code == 1
    for more, said in {
        ("--known", "x"): "--known x is none",
        ("--shape", "5x5"): "not 5 x 5",
    }.items():
        done = run.invoke(app, [*words, *more])
        assert done.exit_code == 2
        assert said in done.stderr
