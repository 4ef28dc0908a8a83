"""Kernels in float32, and what an evaluation costs. No timing decides whether a test passes."""

from __future__ import annotations

import csv
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import albedo
from albedo import _compile
from albedo._compile import in_single, is_kernel, kernel, translated
from albedo.analysis import kernel_cost
from albedo.analysis.kernel_cost import Subject
from albedo.analysis.precise import evaluate, single
from albedo.brdf import Model
from albedo.catalogue import names
from albedo.cli import app
from albedo.directions import half_vector, spherical
from albedo.errors import InputError
from albedo.grammar import parse
from albedo.studies import StudyFile, compare, run_study

ROOT = Path(__file__).parent.parent
EPS = float(np.finfo(np.float32).eps)
TINY = float(np.finfo(np.float32).tiny)

# The defaults, and choices that reach the other branches of the kernels.
OTHERS = (
    *("ashikhmin_shirley:r_d=0.5,n_u=10,n_v=300,r_s=0.2", "lewis:lobe=mirror,n=10"),
    *("cook_torrance:distribution=ggx,geometry=smith,fresnel=conductor,ior=0.3,k=2.7",),
    *("cook_torrance:m=0.5,geometry=smith_correlated,fresnel=dielectric",),
    *("cook_torrance:distribution=blinn_phong,n=20,geometry=schlick_smith,fresnel=schlick,f0=0.1",),
    *("cook_torrance:distribution=gaussian,m=0.4,geometry=smith_rational,fresnel=lazanyi",),
    *("distribution_brdf:distribution=velvet", "eon:albedo=fitted", "fujii:form=artist"),
    *("he_torrance:sigma0=0.9,tau=3", "he_torrance:a_ud=0.3", "max_phong:p=0.5"),
    *("max_phong:variant=retro", "poulin_fournier:base=specular,e=5", "ward:form=fast,m=0.4"),
    *("schlick:form=final,layers=2,color=0.5,isotropy=0.4", "schwenk:reflectivity=0.4,k=0.5"),
    *("stam_gaussian:sigma=1.0", "strauss:smoothness=0.9,metalness=0.5,color=0.3"),
)


def plain(model: Model) -> bool:
    return bool(model.parts()) and all(is_kernel(part.fill) for part in model.parts())


PLAIN = [model for name in names() if plain(model := albedo.model(name))]
MODELS = [*PLAIN, *(parse(text).model() for text in OTHERS)]


def compiled_single(model: Model, wi: np.ndarray, wo: np.ndarray, h: np.ndarray) -> np.ndarray:
    """Values of the compiled kernels in float32, for directions (n, 3)."""
    count = len(wi)
    light = np.ascontiguousarray(wi.T)
    view, half = (np.ascontiguousarray(v.T).reshape(3, count, 1) for v in (wo, h))
    total = np.zeros(count, np.float32)
    for part in model.parts():
        p = np.tile(part.packed(np.array([model.pack()])).astype(np.float32), (count, 1))
        out = np.empty((count, 1), np.float32)
        in_single(part.fill)(light, view, half, p, out)
        total = total + np.float32(part.scale) * out[:, 0]
    return total


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.spec)
def test_compiled_float32_is_the_formula_in_float32(model: Model, rng: np.random.Generator) -> None:
    """The same operations, rounded alike; functions of two libraries differ by a few ulp.

    A lobe is the exponential of a number of the size of its logarithm, which has a handful of
    roundings of its own: by so much more may the values differ.
    """
    count = 24
    wi = spherical(rng.uniform(0.1, 1.0, count), rng.uniform(-3.0, 3.0, count))
    wo = spherical(rng.uniform(0.1, 1.0, count), rng.uniform(-3.0, 3.0, count))
    # Half of the views beside the mirror direction, where lobes are.
    near = wi[::2] * np.array([-1.0, -1.0, 1.0]) + 0.05 * rng.normal(size=(count // 2, 3))
    near[:, 2] = np.maximum(np.abs(near[:, 2]), 0.05)
    wo[::2] = near / np.linalg.norm(near, axis=-1, keepdims=True)
    arithmetic = single()
    light, view, half = (arithmetic.array(v) for v in (wi, wo, half_vector(wi, wo)))
    found = compiled_single(model, light, view, half)
    expected = evaluate(model, arithmetic, light, view, half)
    assert found.dtype == expected.dtype == np.float32
    given, wanted = found.astype(float), expected.astype(float)
    assert np.all(np.isfinite(wanted))
    # The logarithm of what a narrow lobe is small by, or large; below, numbers are denormal.
    size = 1.0 + np.abs(np.log(np.maximum(wanted, TINY)))
    assert np.all(np.abs(given - wanted) <= 8.0 * EPS * size * wanted + 4.0 * TINY)
    assert np.count_nonzero(wanted > TINY) >= count // 4


@kernel
def third(x):
    return x * 0.3333333333333333 + FAR * NODES[1]


FAR = 0.1
NODES = np.array([0.0, 0.7])


@kernel
def harmonic(n, given, out):
    """Integers in quotients, products, comparisons and sums; a constant; a tuple; a callee."""
    x = given[0]
    low, high = (x, 2.0) if x > 5.0 else (1.1, 3.3)
    out[0] = low + high
    for i in range(1, n + 1):
        out[0] += x / i + i * math.pi - 2 / i
        if i < x:
            out[0] -= third(x) ** 2
    out[1] = math.exp(-x) * 1e300


def harmonic_single(n: int, x: np.float32) -> list[np.float32]:
    """The same in numpy's float32, which takes integers and floats of Python as float32."""
    total = np.float32(1.1) + np.float32(3.3)
    for i in range(1, n + 1):
        step = x / np.float32(i) + np.float32(i) * np.float32(math.pi)
        total = total + (step - np.float32(2) / np.float32(i))
        if i < x:
            one = x * np.float32(0.3333333333333333) + np.float32(FAR) * np.float32(NODES[1])
            total = total - one * one
    return [total, np.float32(math.inf)]


SIGNATURE = "void(int64, {0}[::1], {0}[::1])"


def test_numbers_of_a_kernel_are_float32() -> None:
    """To the last bit: there is no function of a library in the first number."""
    out = np.zeros(2, np.float32)
    for x in (np.float32(0.7), np.float32(3.3)):
        in_single(harmonic)(7, np.array([x]), out)
        assert list(out) == harmonic_single(7, x)
    # The kernel itself stays what it was.
    double = np.zeros(2)
    harmonic(1, np.array([0.7]), double)
    assert double[0] == 1.1 + 3.3 + (0.7 + math.pi - 2.0)


def fresh(function: Any, signature: str, monkeypatch: pytest.MonkeyPatch, folder: Path) -> str:
    """The code of a kernel in float32 that comes from no cache, what it calls included."""
    monkeypatch.setenv("ALBEDO_CACHE_DIR", str(folder))
    compiled = in_single.__wrapped__(function)
    compiled.compile(signature)
    (code,) = compiled.inspect_llvm().values()
    return str(code)


DOUBLE = re.compile(r"\bdouble\b")
REPRESENTATIVE = [
    *("ashikhmin_shirley", "cook_torrance", "eon", "he_torrance", "lafortune", "oren_nayar_full"),
    *("poulin_fournier:base=specular", "schlick", "strauss", "ward"),
]


@pytest.mark.parametrize("text", REPRESENTATIVE)
def test_no_float64_is_left(text: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    fill = parse(text).model().parts()[-1].fill
    signature = kernel_cost._FILLS["float32"]
    assert not DOUBLE.search(fresh(fill, signature, monkeypatch, tmp_path))


def test_float64_would_be_seen(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """numba alone promotes what meets a constant or an integer; here nothing is promoted."""
    single_signature = SIGNATURE.format("float32")
    monkeypatch.setenv("ALBEDO_CACHE_DIR", str(tmp_path))
    alone = _compile._compiled(harmonic.py_func, "-alone")
    alone.compile(single_signature)
    (promoted,) = alone.inspect_llvm().values()
    assert DOUBLE.search(promoted)
    assert not DOUBLE.search(fresh(harmonic, single_signature, monkeypatch, tmp_path))


def test_float32_kernels_are_kept_on_disk_apart() -> None:
    compiled = in_single(albedo.model("ward").parts()[0].fill)
    place = Path(compiled.stats.cache_path)
    assert place.parent.name == _compile.digest(_compile.PACKAGE) + "-float32"
    assert place.is_relative_to(_compile.cache_root())
    assert in_single(albedo.model("ward").parts()[0].fill) is compiled


def test_what_is_no_plain_kernel_is_refused() -> None:
    offset = 1.0

    @kernel
    def closure(x):
        return x + offset

    with pytest.raises(InputError, match="holds values of its own"):
        in_single(closure)
    with pytest.raises(InputError, match="is no kernel"):
        translated(math.sqrt, lambda value: value)


def test_blocks_are_those_of_the_seed() -> None:
    one, two, other = (
        kernel_cost.random_block(np.random.default_rng(seed), 40, 3) for seed in (1, 1, 2)
    )
    assert one.wi.shape == (3, 40)
    assert one.wo.shape == one.h.shape == (3, 40, 3)
    for a, b, c in zip(vars(one).values(), vars(two).values(), vars(other).values(), strict=True):
        assert np.array_equal(a, b)
        assert not np.array_equal(a, c)
        assert a.flags.c_contiguous
    for directions in (one.wi, one.wo):
        assert np.all((directions[2] >= kernel_cost.LOWEST_COSINE) & (directions[2] <= 1.0))
        # Components of a unit vector, each rounded a few times.
        assert np.all(np.abs((directions**2).sum(0) - 1.0) < 8.0 * np.finfo(float).eps)


def test_blocks_are_of_the_size_of_a_cache() -> None:
    """Directions, values and parameters of any part."""
    block = kernel_cost.random_block(np.random.default_rng(0))
    directions = sum(v.nbytes for v in vars(block).values())
    for item in kernel_cost.catalogue():
        for _, rows in item.fills:
            assert directions + block.wo[0].nbytes + rows(block).nbytes < 2**22, item.label


@pytest.mark.parametrize("name", ["ward", "stam_gaussian", "lambert", "strauss"])
def test_views_of_the_lobe_are_where_the_model_is(name: str) -> None:
    """Its own draws have, by their density, larger values than views drawn evenly."""
    model = albedo.model(name)
    lobe = kernel_cost.lobe_block(model, np.random.default_rng(3), 500)
    even = kernel_cost.random_block(np.random.default_rng(3), 500)
    assert np.all(lobe.wo[2] > 0.0)
    # h is a sum of two numbers up to 1 that the routine may know better: some roundings.
    assert np.all(np.abs(lobe.h[:, :, 0] - lobe.wi - lobe.wo[:, :, 0]) < 1e-14)
    inside, outside = (
        np.median(model.finite_part(b.wi.T, b.wo[:, :, 0].T, b.h[:, :, 0].T)) for b in (lobe, even)
    )
    assert inside >= outside


def test_every_turn_evaluates_the_kernels() -> None:
    """A kernel that counts, by a parameter, how often a block was evaluated."""
    rows: list[np.ndarray] = []

    def counters(block: kernel_cost.Block) -> np.ndarray:
        rows.append(np.zeros((block.wi.shape[1], 1)))
        return rows[-1]

    item = Subject("counts", "counts", ((count_up, counters),))
    begun: list[tuple[int, int]] = []
    options: dict[str, Any] = {"seconds": 1e-6, "repeats": 7}
    found = kernel_cost.samples(
        [item], ways=("pairs",), progress=lambda *step: begun.append(step), **options
    )
    assert set(found) == {
        (label, precision, "pairs")
        for label in ("", "counts")
        for precision in ("float64", "float32")
    }
    assert all(values.shape == (7,) for values in found.values())
    assert all(np.all(values >= 0.0) for values in found.values())
    # Once to load it, once or more to see how long it takes, and in every round.
    assert rows[0][0, 0] >= 1 + 1 + 7
    assert np.all(rows[0] == rows[0][0, 0])
    assert begun[0] == (0, 8)
    assert begun[-1] == (8, 8)
    assert begun == sorted(begun)


@kernel
def count_up(wi, wo, h, p, out):
    for j in range(out.shape[0]):
        p[j, 0] += 1.0
        for i in range(out.shape[1]):
            out[j, i] = p[j, 0]


def test_the_half_vector_is_formed() -> None:
    block = kernel_cost.random_block(np.random.default_rng(5), 6, 4)
    expected = block.wi[:, :, None] + block.wo
    block.h[:] = np.nan
    nothing = np.zeros((6, 1))
    kernel_cost.form_half_vector(block.wi, block.wo, block.h, nothing, np.empty((6, 4)))
    assert np.array_equal(block.h, expected)


def test_ratios_and_quartiles_are_of_the_rounds() -> None:
    """Ratios are taken in every round: what slows down all of one does not show."""
    item = Subject("slow", "slow", ((count_up, kernel_cost.constant(np.zeros(1))),) * 2)
    drift = np.array([1.0, 1.0, 5.0, 1.0, 1.0, 9.0, 1.0])
    found = {
        ("slow", "float64", "pairs"): 3.0 * drift,
        ("ref", "float64", "pairs"): 2.0 * drift,
        ("", "float64", "pairs"): np.arange(1.0, 8.0),
    }
    (row,) = kernel_cost.table([item], found, "ref").to_dict("records")
    assert tuple(row) == kernel_cost.COLUMNS
    assert (row["ratio"], row["ratio_low"], row["ratio_high"]) == (1.5, 1.5, 1.5)
    assert (row["ns"], row["ns_low"], row["ns_high"]) == (3.0, 3.0, 9.0)
    assert (row["empty_ns"], row["parts"], row["compiled"]) == (4.0, 2, True)


def test_what_cannot_be_timed_is_refused() -> None:
    item = kernel_cost.subject(albedo.model("lambert"))
    for bad, said in (
        ({"repeats": 6}, "repeats = 6 is out of range"),
        ({"seconds": 0.0}, "seconds = 0 is out of range"),
        ({"seconds": math.nan}, "seconds = nan is out of range"),
    ):
        with pytest.raises(InputError, match=said):
            kernel_cost.samples([item], **bad)
    with pytest.raises(InputError, match="be distinct"):
        kernel_cost.samples([item, item])
    with pytest.raises(InputError, match="no finite part"):
        kernel_cost.subject(albedo.model("stam_grating"))


def test_a_part_that_is_no_kernel_is_timed_in_float64_only() -> None:
    (grating,) = kernel_cost.catalogue(["stam_grating"])
    assert not grating.compiled
    found = kernel_cost.samples([grating], ways=("pairs",), seconds=1e-6, repeats=7)
    assert {key[1] for key in found if key[0]} == {"float64"}


def test_every_model_of_the_catalogue_has_costs() -> None:
    frame = kernel_cost.committed()
    assert set(frame["model"]) == set(names())
    for name, rows in frame.groupby("model"):
        precisions = 2 if rows["compiled"].all() else 1
        assert len(rows) == precisions * len(kernel_cost.WAYS), name
    assert frame.attrs["processor"]
    specs = {item.label: item.spec for item in kernel_cost.catalogue()}
    assert dict(zip(frame["model"], frame["spec"], strict=True)) == specs


LINES = kernel_cost.FILE.read_text(encoding="utf-8").splitlines()
HEAD, FIRST = LINES[:4], LINES[4]


def changed(column: str, value: str) -> str:
    """The first row with another value."""
    cells = next(csv.reader([FIRST]))
    cells[kernel_cost.COLUMNS.index(column)] = value
    return ",".join(f'"{cell}"' for cell in cells)


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ([], "are no table"),
        ([*HEAD[:3]], "are no table"),
        (HEAD, "have no rows"),
        ([*HEAD[:3], "model,ns", "ward,1.0"], "have other columns"),
        ([HEAD[0], HEAD[2], HEAD[3], FIRST], "do not name their processor"),
        ([HEAD[0], HEAD[1], HEAD[3], FIRST], "do not name their versions"),
        ([*HEAD, FIRST, FIRST], "have a row twice"),
        ([*HEAD, FIRST + ",1,2"], "are no table"),
        ([*HEAD, changed("model", "")], "rows without names"),
        ([*HEAD, changed("precision", "float16")], "have other precisions or ways"),
        ([*HEAD, changed("way", "fast")], "have other precisions or ways"),
        ([*HEAD, changed("ns", "-1.0")], "have a ns that is no positive number"),
        ([*HEAD, changed("ns", "few")], "have a ns that is no positive number"),
        ([*HEAD, changed("empty_ns", "inf")], "have a empty_ns that is no positive number"),
        ([*HEAD, changed("ratio", "1e9")], "have a ratio outside its quartiles"),
        ([*HEAD, changed("parts", "1.5")], "parts that are no whole number"),
        ([*HEAD, changed("compiled", "maybe")], "compiled neither True nor False"),
    ],
)
def test_a_damaged_table_is_refused(lines: list[str], said: str, tmp_path: Path) -> None:
    path = tmp_path / "damaged.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    with pytest.raises(InputError, match=said) as caught:
        kernel_cost.committed(path)
    assert "damaged.csv" in str(caught.value)


def test_a_missing_or_binary_table_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        kernel_cost.committed(tmp_path / "none.csv")
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="cannot be read"):
        kernel_cost.committed(tmp_path / "binary.csv")


def test_the_command_writes_what_the_loader_reads(tmp_path: Path) -> None:
    path = tmp_path / "costs.csv"
    arguments = ["cost", "lambert:rho=0.5", "oren_nayar", "-o", str(path), "--repeats", "7"]
    result = CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    head = next(line for line in result.stdout.splitlines() if line.strip())
    assert re.match(r"\s*model\s+ratio\s+quartiles", head)
    assert kernel_cost.processor() in result.stdout
    frame = kernel_cost.committed(path)
    assert list(frame["model"].unique()) == ["lambert:rho=0.5", "oren_nayar"]
    assert len(frame) == 2 * 2 * len(kernel_cost.WAYS)
    assert frame.attrs == {
        "processor": kernel_cost.processor(),
        "versions": kernel_cost.versions(),
    }


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nonsense"], "unknown model"),
        (["stam_grating"], "no finite part"),
        (["ward", "--update"], "--update times all models"),
        (["ward", "-o", "costs.txt"], "must end in one of .csv"),
        (["ward", "--repeats", "2"], "repeats = 2 is out of range"),
        (["ward", "--seed", "-1"], "--seed -1 is out of range"),
        (["ward", "ward"], "be distinct"),
    ],
)
def test_bad_input_is_one_sentence(arguments: list[str], said: str) -> None:
    result = CliRunner().invoke(app, ["cost", *arguments], catch_exceptions=False)
    assert result.exit_code == 2
    assert result.stdout == ""
    (line,) = result.stderr.strip().splitlines()
    assert said in line


@pytest.fixture(scope="module")
def study() -> dict[str, Any]:
    """What the file of the study defines."""
    loaded = StudyFile(ROOT / "studies" / "cost.py").load()
    return dict(loaded.run.__globals__)


@pytest.mark.parametrize("name", ["strauss", "schlick"])
def test_products_by_reciprocals_have_the_values_of_divisions(
    study: dict[str, Any], name: str
) -> None:
    """A reciprocal and a product are two roundings for one, in 6 or 9 places; then powers."""
    two = study["with_and_without"](name)
    for precision in kernel_cost.PRECISIONS:
        eps = float(np.finfo(precision).eps)
        assert study["largest_difference"](two, precision) <= 40.0 * eps
    # The variant does divide by nothing, and the kernel of the model does.
    divisions = [re.search(r"\bfdiv\b", code_of(item.fills[0][0])) for item in two]
    assert divisions[0] is not None
    assert divisions[1] is None


def code_of(function: Any) -> str:
    """The code of a kernel that is compiled anew, in float64."""
    uncached = _compile.numba.njit(**_compile._OPTIONS)(function.py_func)
    uncached.compile(kernel_cost._FILLS["float64"])
    (code,) = uncached.inspect_llvm().values()
    return str(code)


def test_further_readings_have_the_values_of_the_models(study: dict[str, Any]) -> None:
    """The same formulas: an arc cosine of n.l >= 0.1 and its tangent keep all but a few digits."""
    block = kernel_cost.random_block(np.random.default_rng(2), 300)
    for item in study["readings_of_models"]()[:2]:
        assert item.model is not None
        fill, rows = item.fills[0]
        out = np.empty((300, 1))
        fill(block.wi, block.wo, block.h, rows(block), out)
        expected = item.model.finite_part(
            block.wi.T, block.wo[:, :, 0].T, np.ascontiguousarray(block.h[:, :, 0].T)
        )
        # theta is rounded to 2e-16, tan(theta) is up to 10, and slopes grow by 100 of that; the
        # exponent 100 of the lobe multiplies a few roundings.
        assert np.all(np.abs(out[:, 0] - expected) <= 1e-13 * np.abs(expected) + 1e-300)


class Recorded:
    """A context that keeps claims."""

    def __init__(self) -> None:
        self.claims: list[dict[str, Any]] = []

    def claim(self, id: str, statement: str, **given: Any) -> None:
        verdict = compare(given["criterion"]).judge(given["value"], given["error"])
        self.claims.append({**given, "verdict": verdict.partition(":")[0]})


def test_every_reading_has_its_verdict(study: dict[str, Any]) -> None:
    context = Recorded()
    rounds = np.linspace(-0.2, 0.2, 9)
    levels = (3.0, 1.0, 2.0, 3.0)
    values = {key: level + rounds for key, level in zip(study["READINGS"], levels, strict=True)}
    study["judge"](context, "It is so.", "a number", values, ">= 2")
    verdicts = [claim["verdict"] for claim in context.claims]
    assert verdicts == ["holds", "fails", "undecided", "holds"]
    assert len({claim["reading"] for claim in context.claims}) == 4
    for claim, level in zip(context.claims, levels, strict=True):
        assert claim["machine"]
        assert claim["value"] == pytest.approx(level, abs=1e-15)
        # Quartiles of nine even rounds are the third and the seventh.
        assert claim["error"] == pytest.approx(0.1, rel=1e-12)


@pytest.mark.slow
def test_the_study_runs(tmp_path: Path) -> None:
    result = run_study(StudyFile(ROOT / "studies" / "cost.py"), tmp_path)
    assert not result.failed, result.manifest["error"]
    assert result.manifest["warnings"] == []
    assert {claim["id"] for claim in result.manifest["claims"]} == {"S15"}
    # Eight statements, in each of the ways to take a time.
    parts = [(claim["reading"], claim["statement"]) for claim in result.manifest["claims"]]
    assert len({reading for reading, _ in parts}) == 4
    assert len(parts) == len(set(parts)) == 4 * len({statement for _, statement in parts}) == 32
