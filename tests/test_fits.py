"""Formulas in place of tables: what they say they err by, and the code that they become."""

from __future__ import annotations

import json
import runpy
import subprocess
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tools import need
from typer.testing import CliRunner

import albedo
from albedo.brdf import Model
from albedo.cli import app
from albedo.errors import InputError
from albedo.lookup.fits import FIT_SUFFIXES, Fit
from albedo.quadrature import albedo_rows


def ggx(**values: Any) -> Model:
    return albedo.model("cook_torrance", distribution="ggx", geometry="smith_correlated", **values)


@cache
def formula(form: str, error: float = 3e-3, quantity: str = "albedo") -> Fit:
    return albedo.fit(
        ggx(), {"m": (0.1, 1.0)}, error, form=form, quantity=quantity, cosines=(0.02, 1.0)
    )


def places(count: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(4)
    return {"m": rng.uniform(0.1, 1.0, count), "cos_theta": rng.uniform(0.02, 1.0, count)}


@pytest.mark.parametrize("form", ["polynomial", "rational"])
def test_what_a_formula_says_holds(form: str) -> None:
    found = formula(form)
    assert found.worst <= 3e-3
    x = places(500)
    models = [ggx(m=m) for m in x["m"].tolist()]
    known = albedo_rows(models, x["cos_theta"], np.zeros(500), rtol=1e-7, atol=0.0)
    off = np.abs(found(**x) - known.value)
    errors = found.errors[0]
    assert np.all(off <= errors.largest + known.error)
    assert np.all(off <= errors.relative * known.value + known.error)
    assert errors.verified > 0.5 * errors.largest


def test_a_quotient_needs_fewer_coefficients_for_a_small_error() -> None:
    # A layer of the lobe's width: of a pole's shape, which powers follow slowly.
    model = ggx(m=0.1)
    polynomial, rational = (
        albedo.fit(model, error=1e-4, form=form) for form in ("polynomial", "rational")
    )
    assert max(polynomial.worst, rational.worst) <= 1e-4
    assert rational.degree < polynomial.degree


def test_lower_degrees_do_not_do() -> None:
    found = formula("polynomial")
    looser = formula("polynomial", 0.03)
    assert looser.degree < found.degree
    assert looser.worst > 3e-3


def test_relative_errors_and_two_channels() -> None:
    loss = albedo.fit(
        ggx(m=0.5), error=1e-2, quantity="complement", metric="relative", cosines=(0.01, 1.0)
    )
    known = albedo.directional_albedo(ggx(m=0.5), 0.3, complement=True).value
    assert abs(float(loss(cos_theta=0.3)) / known - 1.0) <= 1e-2
    pair = formula("rational", 0.01, "split_sum")
    a, b = pair(m=0.4, cos_theta=0.3)
    whole = albedo.directional_albedo(ggx(m=0.4, fresnel="schlick", f0=0.25), 0.3).value
    assert abs(0.25 * a + b - whole) <= 1.25 * 0.01


@pytest.mark.parametrize("form", ["polynomial", "rational"])
def test_a_constant_has_a_formula(form: str) -> None:
    """Any denominator will do for it, which no equation tells."""
    for model in (albedo.compensate(ggx(m=0.3), "kulla_conty"), albedo.model("lambert", rho=0.3)):
        found = albedo.fit(model, error=1e-6, form=form)
        known = albedo.directional_albedo(model, 0.4)
        assert abs(float(found(cos_theta=0.4)) - known.value) <= found.worst + known.error
        assert found.worst <= 1e-6


def program(found: Fit, header: Path) -> str:
    name = "albedo_cook_torrance_" + found.form
    return f"""#include <stdio.h>
#include "{header.name}"
int main(void) {{
    double m, c;
    while (scanf("%lf %lf", &m, &c) == 2) printf("%.17g\\n", {name}(m, c));
    return 0;
}}
"""


@pytest.mark.parametrize("form", ["polynomial", "rational"])
def test_c_gives_what_the_library_gives(form: str, tmp_path: Path) -> None:
    gcc, found, x = need("gcc"), formula(form), places(2000)
    header = albedo.save_fit(found, tmp_path / "fit.h")
    (tmp_path / "main.c").write_text(program(found, header))
    flags = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-pedantic", "-ffp-contract=off"]
    binary = tmp_path / "main"
    subprocess.run([gcc, *flags, str(tmp_path / "main.c"), "-o", str(binary), "-lm"], check=True)
    text = "".join(f"{m!r} {c!r}\n" for m, c in zip(*(v.tolist() for v in x.values()), strict=True))
    done = subprocess.run([str(binary)], input=text, capture_output=True, text=True, check=True)
    values = np.array(done.stdout.split(), dtype=float)
    # Coefficients are below 10, and each of some dozen terms is rounded a few times.
    np.testing.assert_allclose(values, found(**x), atol=1e-12)


@pytest.mark.parametrize("form", ["polynomial", "rational"])
def test_python_and_javascript_give_it_too(form: str, tmp_path: Path) -> None:
    found, x = formula(form), places(200)
    name = "albedo_cook_torrance_" + form
    module = runpy.run_path(str(albedo.save_fit(found, tmp_path / "fit.py")))
    np.testing.assert_allclose(module[name](**x), found(**x), atol=1e-12)
    script = albedo.save_fit(found, tmp_path / "fit.js").rename(tmp_path / "fit.mjs")
    pairs = list(zip(*(v.tolist() for v in x.values()), strict=True))
    text = f"import {{ {name} as f }} from '{script.as_uri()}';\n"
    text += f"console.log(JSON.stringify({json.dumps(pairs)}.map(([m, c]) => f(m, c))));\n"
    (tmp_path / "main.mjs").write_text(text)
    done = subprocess.run(
        [need("node"), str(tmp_path / "main.mjs")], capture_output=True, text=True, check=True
    )
    np.testing.assert_allclose(json.loads(done.stdout), found(**x), atol=1e-12)


@pytest.mark.parametrize("warp", ["sqrt", "angle", "rational:0.3", "rational:0.5*m"])
def test_shaders_compile(warp: str, tmp_path: Path) -> None:
    validator = need("glslangValidator")
    found = albedo.fit(
        ggx(), {"m": (0.2, 1.0)}, 0.05, cosines=(0.05, 1.0), warps={"cos_theta": warp}
    )
    assert found.grid.warps[1] == warp
    call = f"albedo_cook_torrance_{found.form}(0.5, 0.5)"
    glsl = albedo.save_fit(found, tmp_path / "fit.glsl").read_text()
    (tmp_path / "a.frag").write_text(
        "#version 300 es\nprecision highp float;\nout vec4 color;\n"
        f"{glsl}\nvoid main() {{ color = vec4({call}); }}\n"
    )
    subprocess.run([validator, str(tmp_path / "a.frag")], check=True, capture_output=True)
    hlsl = albedo.save_fit(found, tmp_path / "fit.hlsl").read_text()
    (tmp_path / "b.frag").write_text(f"{hlsl}\nfloat4 main() : SV_Target {{ return {call}; }}\n")
    subprocess.run(
        [validator, "-D", "-V", "-e", "main", str(tmp_path / "b.frag"), "-o", "/dev/null"],
        check=True,
        capture_output=True,
    )
    # What is said of float32 is little beside the error, and more than nothing.
    assert 1e-8 < found.float32_adds < 1e-4


def test_files_of_formulas(tmp_path: Path) -> None:
    found = formula("rational")
    content = json.loads(albedo.save_fit(found, tmp_path / "fit.json").read_text())
    assert content == found.label
    assert len(content["powers"]) == len(content["channels"][0]["numerator"])
    for suffix in FIT_SUFFIXES:
        text = albedo.save_fit(found, tmp_path / f"fit{suffix}").read_text()
        assert "errs by" in text or suffix == ".json"
    with pytest.raises(InputError, match="must end in one of"):
        albedo.save_fit(found, tmp_path / "fit.what")


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: albedo.fit(3), "fit needs a model or its name, not int"),
        (lambda: albedo.fit("phong", form="spline"), "form = 'spline' is unknown"),
        (lambda: albedo.fit("phong", metric="rms"), "metric = 'rms' is unknown"),
        (lambda: albedo.fit("phong", error=1.0), "error = 1.0 is out of range"),
        (lambda: albedo.fit("strauss:color=(.1,.2,.3)"), "has 3 channels"),
        (
            lambda: albedo.fit("phong:n=1..1e6/2", error=1e-6, form="polynomial"),
            "no polynomial of degree up to 10 meets 1e-06",
        ),
    ],
)
def test_what_no_formula_can_be(call: Any, said: str) -> None:
    with pytest.raises(InputError, match=said):
        call()


def test_formulas_on_the_command_line(tmp_path: Path) -> None:
    run, target = CliRunner(), tmp_path / "phong.h"
    words = ["design", "phong:n=1..20/2", "--form", "rational", "--error", "0.01"]
    done = run.invoke(app, [*words, "-o", str(target)])
    assert done.exit_code == 0, done.output
    assert "rational of degree" in done.stdout
    assert "albedo_phong_rational" in target.read_text()
    assert json.loads(run.invoke(app, [*words, "--json"]).stdout)["format"] == "albedo rational 1"
    for more, said in {
        ("--size", "8x8"): "--size is of tables",
        ("-o", str(tmp_path / "t.nc")): "must end in one of",
    }.items():
        done = run.invoke(app, [*words, *more])
        assert done.exit_code == 2
        assert said in done.stderr
    done = run.invoke(app, words[:-2])
    assert done.exit_code == 2
    assert "--error is needed" in done.stderr
