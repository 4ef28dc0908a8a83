"""Lookup tables: how they are read, what they are designed to, and what they say they err by."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lookups import WARPS, lookup_table
from scipy.interpolate import RegularGridInterpolator
from typer.testing import CliRunner

import albedo
from albedo.brdf import Model
from albedo.cli import app
from albedo.errors import InputError
from albedo.lookup.label import LookupTable
from albedo.lookup.quantities import coordinates_of, functions_of, quantity_of
from albedo.lookup.reference import Coordinate, refer
from albedo.lookup.stored import Grid, Table
from albedo.lookup.warps import Warp
from albedo.quadrature import albedo_rows

EPS = float(np.finfo(float).eps)
GGX = {"distribution": "ggx", "geometry": "smith_correlated"}
DOMAIN: dict[str, Any] = {"ranges": {"m": (0.05, 1.0)}, "cosines": (0.01, 1.0)}


def ggx(**values: Any) -> Model:
    return albedo.model("cook_torrance", **GGX, **values)


def designed(**how: Any) -> LookupTable:
    """A table of GGX over the domain that others are compared on."""
    return albedo.design(ggx(), DOMAIN["ranges"], cosines=DOMAIN["cosines"], **how)


def random_places(table: LookupTable, count: int, seed: int = 3) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {
        name: rng.uniform(min(ends), max(ends), count)
        for name, ends in zip(table.grid.names, table.grid.ends, strict=True)
    }


@pytest.mark.parametrize(
    "text", ["linear", "sqrt", "angle", "log", "rational:0.25", "rational:0.5*m"]
)
def test_warps_are_undone(text: str) -> None:
    warp = Warp.parse(text)
    assert str(warp) == text
    x, m = np.linspace(0.01, 1.0, 101), np.linspace(0.05, 1.0, 101)
    # A few roundings, which next to the horizon weigh more in the angle.
    np.testing.assert_allclose(warp.inverse(warp(x, m), m), x, rtol=20.0 * EPS, atol=EPS)
    s = warp(x, np.full(x.size, 0.3))
    assert np.all(np.diff(s) > 0.0) or np.all(np.diff(s) < 0.0)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("cubed", "the warp 'cubed' is unknown"),
        ("rational", "the warp 'rational' is unknown"),
        ("log:2", "the warp 'log:2' is unknown"),
        ("rational:0", r"out of range; K .* lies in \[1e-09, 1e\+09\]"),
        ("rational:x", "out of range"),
        ("rational:0.1*", "out of range"),
        ("rational:nan", "out of range"),
    ],
)
def test_warps_that_are_none(text: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        Warp.parse(text)


@pytest.mark.parametrize("texels", ["ends", "centres"])
@pytest.mark.parametrize("axes", [1, 2, 3])
def test_readings_are_those_of_scipy(axes: int, texels: str) -> None:
    """Linear in the shares of warped axes, and constant beyond the outermost nodes."""
    for warps in WARPS[axes]:
        table = lookup_table(axes, warps=warps, stored="float64", texels=texels)
        grid = table.grid
        lines = [grid.shares(count) for count in grid.counts]
        known = RegularGridInterpolator(lines, table.channels[0].table.values)
        x = random_places(table, 500)
        share = grid.share_of(np.array(list(x.values())))
        inside = np.array([np.clip(s, a[0], a[-1]) for s, a in zip(share, lines, strict=True)])
        # A place between nodes is known to some roundings of its warp, times the steepest slope.
        np.testing.assert_allclose(table(**x), known(inside.T), atol=500.0 * EPS)
        # At the nodes there is what was stored.
        points = dict(zip(grid.names, grid.points(), strict=True))
        nodes = table.channels[0].table.values.ravel()
        np.testing.assert_allclose(table(**points), nodes, atol=500.0 * EPS)


@pytest.mark.parametrize("stored", ["float16", "unorm8"])
def test_negative_and_infinite_numbers_are_read_as_they_are(stored: str) -> None:
    grid = Grid(("a",), ((0.0, 3.0),), ("linear",), (4,))
    values = np.array([-0.5, -1e-7, 0.25, 60000.0])
    table = Table.of(grid, values, stored, "linear")
    expected = values.astype(np.float16) if stored == "float16" else table.values
    np.testing.assert_array_equal(table(np.arange(4.0)[None]), expected.astype(float))
    large = Table.of(grid, 10.0 * values, "float16", "linear")(np.array([[3.0]]))
    assert np.isposinf(large[0])


def test_what_is_outside_is_refused() -> None:
    table = lookup_table()
    with pytest.raises(InputError, match=r"m is outside of the table; it lies in \[0.05, 1\]"):
        table(m=0.01, cos_theta=0.5)
    with pytest.raises(InputError, match="cos_theta is outside of the table"):
        table(m=0.1, cos_theta=np.nan)
    with pytest.raises(InputError, match="a reading needs m, cos_theta; given are m"):
        table(m=0.1)
    with pytest.raises(InputError, match="are not numbers of shapes that broadcast"):
        table(m=[0.1, 0.2], cos_theta=[0.1, 0.2, 0.3])
    assert lookup_table(quantity="split_sum")(m=[0.1, 0.2], cos_theta=0.5).shape == (2, 2)


@pytest.mark.parametrize("relative", [False, True])
@pytest.mark.parametrize("axes", [1, 2, 3])
def test_references_keep_within_their_bounds(axes: int, relative: bool) -> None:
    """A function with a layer at the horizon and one along a parameter, known in closed form."""
    coordinates = (
        Coordinate("m", 0.01, 1.0),
        Coordinate("phi", 0.0, 0.5 * math.pi),
        Coordinate("cos_theta", 0.0, 1.0),
    )[3 - axes :]

    def function(columns: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        c = columns[-1]
        width = 0.02 + (columns[0] if axes == 3 else 0.1)
        turn = np.cos(2.0 * columns[-2]) if axes > 1 else 0.5
        return 1e-3 + c / (c + width * (1.2 + 0.3 * turn)), np.full(c.size, 1e-12)

    reference = refer(function, coordinates, 1e-5, relative)
    rng = np.random.default_rng(0)
    x = np.array([rng.uniform(c.low, c.high, 2000) for c in coordinates])
    x[-1, :1000] = 10.0 ** rng.uniform(-12.0, 0.0, 1000)
    value, error = reference(x)
    known, _ = function(list(x))
    assert np.all(np.abs(value - known) <= error)
    assert error[x[-1] > 1e-8].max() <= 2e-5


def test_a_reference_that_cannot_be_had_is_refused() -> None:
    def step(columns: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        return (columns[0] > 0.4321).astype(float), np.zeros(columns[0].size)

    with pytest.raises(InputError, match=r"known to .* only, where 1e-06 is needed"):
        refer(step, (Coordinate("m", 0.0, 1.0),), 1e-6)

    def hole(columns: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        return np.where(columns[0] > 0.5, np.nan, 1.0), np.zeros(columns[0].size)

    with pytest.raises(InputError, match=r"has no value with a bound at m = 0\.\d+"):
        refer(hole, (Coordinate("m", 0.0, 1.0),), 1e-6)


@pytest.mark.parametrize(("size", "largest", "rms"), [(32, 3e-3, 3e-4), (64, 8e-4, 8e-5)])
def test_ggx_in_squares(size: int, largest: float, rms: float) -> None:
    table = designed(size=(size, size))
    errors = table.channels[0].errors
    assert errors.largest <= largest
    assert errors.rms <= rms
    assert errors.verified <= errors.largest
    # The best warp crowds nodes towards the horizon, and is not the usual one.
    assert Warp.parse(table.grid.warps[1]).kind == "rational"
    plain = designed(size=(size, size), warps={"cos_theta": "linear", "m": "linear"})
    assert plain.channels[0].errors.largest > 4.0 * errors.largest


def test_a_thousandth_in_eight_kilobytes() -> None:
    table = designed(error=1e-3, max_bytes=8192)
    assert table.worst <= 1e-3
    assert table.bytes <= 8192
    assert table.about["asked"] == 1e-3
    # A table that is a little smaller errs by more than was asked for.
    counts = tuple(n - 2 for n in table.grid.counts)
    warps = dict(zip(table.grid.names, table.grid.warps, strict=True))
    smaller = designed(size=counts, warps=warps)
    assert smaller.worst > 1e-3


@pytest.mark.parametrize(
    "how",
    [
        {"error": 5e-3},
        {"error": 5e-3, "metric": "relative"},
        {"error": 5e-4, "metric": "rms"},
        {"error": 1e-4, "interp": "cubic"},
        {"error": 5e-3, "dtype": "float16"},
        {"error": 4e-3, "dtype": "unorm8"},
        {"size": (12, 12), "texels": "centres"},
    ],
    ids=str,
)
def test_what_a_label_says_holds(how: dict[str, Any]) -> None:
    """At places that no design has seen, against quadrature."""
    table = designed(**how)
    x = random_places(table, 600)
    models = [ggx(m=m) for m in x["m"].tolist()]
    known = albedo_rows(models, x["cos_theta"], np.zeros(600), rtol=1e-7, atol=0.0)
    off = np.abs(table(**x) - known.value)
    errors = table.channels[0].errors
    assert np.all(off <= errors.largest + known.error)
    assert np.all(off <= table.bound(**x) + known.error)
    assert np.all(off <= errors.relative * known.value + known.error)
    # Six hundred squares of errors whose largest is no more than five times their mean.
    assert math.sqrt(np.mean(off**2)) == pytest.approx(errors.rms, rel=0.25)
    # It is no empty boast either: something comes near to the bound.
    assert errors.verified > 0.5 * errors.largest
    if "error" in how:
        assert table.worst <= how["error"]


def test_other_quantities() -> None:
    loss = albedo.design(ggx(m=0.3), error=1e-3, quantity="complement", cosines=(0.01, 1.0))
    known = albedo.directional_albedo(ggx(m=0.3), [0.05, 0.7], complement=True).value
    off = np.abs(loss(cos_theta=[0.05, 0.7]) - known)
    assert np.all(off <= loss.bound(cos_theta=[0.05, 0.7]) + 1e-8)

    average = albedo.design(ggx(), {"m": (0.1, 1.0)}, 1e-3, quantity="average")
    assert average.grid.names == ("m",)
    # The average of GGX with m = 1 is 4/3 (1 - ln 2).
    expected = 4.0 / 3.0 * (1.0 - math.log(2.0))
    assert abs(float(average(m=1.0)) - expected) <= float(average.bound(m=1.0))

    pair = albedo.design(ggx(), {"m": (0.2, 1.0)}, 5e-3, quantity="split_sum")
    assert [channel.name for channel in pair.channels] == ["f0", "f90"]
    a, b = pair(m=0.4, cos_theta=0.3)
    whole = albedo.directional_albedo(ggx(m=0.4, fresnel="schlick", f0=0.25), 0.3).value
    assert abs(0.25 * a + b - whole) <= 1.25 * 5e-3


def test_anisotropic_models_have_an_axis_of_azimuths() -> None:
    model = albedo.model("ashikhmin_shirley", n_u=40.0, n_v=5.0)
    table = albedo.design(model, error=0.02)
    assert table.grid.names == ("phi", "cos_theta")
    known = albedo.directional_albedo(model, 0.4, phi=0.7).value
    assert abs(float(table(phi=0.7, cos_theta=0.4)) - known) <= 0.02


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: albedo.design(3), "design needs a model or its name, not int"),
        (lambda: albedo.design("ward", error=0.1), "grows without limit .* smallest cosine"),
        (lambda: albedo.design("phong"), "give the error .* or its size"),
        (lambda: albedo.design("phong", error=0.1, size=(8,)), "give the error .* or its size"),
        (lambda: albedo.design("phong", error=1e-9), r"error = 1e-09 is out of range"),
        (lambda: albedo.design("phong", error=0.1, metric="mean"), "metric = 'mean' is unknown"),
        (lambda: albedo.design("phong", error=0.1, interp="spline"), "interp = 'spline'"),
        (lambda: albedo.design("phong", error=0.1, dtype="int8"), "dtype = 'int8' is unknown"),
        (lambda: albedo.design("phong", error=0.1, texels="corners"), "texels = 'corners'"),
        (lambda: albedo.design("phong", error=0.1, quantity="loss"), "quantity = 'loss'"),
        (lambda: albedo.design("phong", error=0.1, max_bytes=0), "max_bytes = 0 is out of range"),
        (lambda: albedo.design("phong", size=(1,)), r"size = 1 is out of range; .* \[2, 4096\]"),
        (lambda: albedo.design("phong", size=(8, 8)), "size = 8x8 has 2 axes; the table has 1"),
        (lambda: albedo.design("phong", error=0.1, cosines=(0.5, 0.2)), "are no range"),
        (lambda: albedo.design("phong", {"n": (5.0, 5.0)}, 0.1), "is no range"),
        (lambda: albedo.design("phong", {"x": (1.0, 5.0)}, 0.1), "x"),
        (lambda: albedo.design("phong", error=0.1, warps={"n": "log"}), "there is no axis 'n'"),
        (
            lambda: albedo.design("phong", error=0.1, warps={"cos_theta": "log"}),
            "begins at 0, where there is no logarithm",
        ),
        (
            lambda: albedo.design("phong:n=1..9/2", error=0.1, warps={"n": "rational:1*x"}),
            "names no other axis",
        ),
        (
            lambda: albedo.design("phong:n=1..9/2", error=0.1, warps={"n": "rational:1*cos_theta"}),
            "is none where cos_theta is 0",
        ),
        (
            lambda: albedo.design("phong:n=1..9/2", error=1e-3, max_bytes=16),
            "no table within 16 bytes",
        ),
        (
            lambda: albedo.design("phong:n=1..9/2", error=1e-4, dtype="unorm8"),
            "no table of unorm8 read by linear interpolation meets 0.0001",
        ),
        (lambda: albedo.design("strauss:color=(.1,.2,.3)", error=0.1), "has 3 channels"),
        (
            lambda: albedo.design("phong", error=0.1, quantity="split_sum"),
            "split_sum needs a model with Schlick's Fresnel factor",
        ),
        (
            lambda: albedo.design("cook_torrance:m=[.1,.2],distribution=[ggx,beckmann]", error=0.1),
            "distribution is swept over words",
        ),
    ],
)
def test_what_no_table_can_be(call: Any, said: str) -> None:
    with pytest.raises(InputError, match=said):
        call()


def test_design_on_the_command_line(tmp_path: Path) -> None:
    run, target = CliRunner(), tmp_path / "phong.nc"
    words = ["design", "phong:n=1..20/2", "--error", "0.01", "-o", str(target)]
    done = run.invoke(app, words)
    assert done.exit_code == 0, done.output
    table = albedo.load_lookup(target)
    assert f"{table.bytes} bytes" in done.stdout
    assert table.worst <= 0.01
    done = run.invoke(app, [*words[:-2], "--json"])
    assert json.loads(done.stdout) == {**table.label, "sha256": table.sha256}
    for more, said in {
        ("--cos", "0.1"): "--cos 0.1 is no range",
        ("--size", "axb"): "--size axb is no size",
        ("--warp", "n"): "--warp n is none",
        ("-o", str(tmp_path / "t.what")): "must end in one of",
        ("-o", str(tmp_path / "none" / "t.nc")): "there is no folder",
    }.items():
        done = run.invoke(app, ["design", "phong", "--error", "0.1", *more])
        assert done.exit_code == 2
        assert said in done.stderr
        assert len(done.stderr.splitlines()) == 1


def test_functions_of_a_model_carry_bounds() -> None:
    quantity = quantity_of("albedo")
    coordinates = coordinates_of(ggx(), {"m": (0.1, 1.0)}, quantity, (0.0, 1.0))
    (function,) = functions_of(ggx(), quantity, coordinates, 1e-6, False)
    value, error = function([np.array([0.3, 0.3]), np.array([0.5, 0.9])])
    known = albedo.directional_albedo(ggx(m=0.3), [0.5, 0.9], rtol=1e-10)
    assert np.all(np.abs(value - known.value) <= error + known.error)
    assert np.all(error <= 1e-6)
