"""The grammar: what it reads, what it refuses, and that it reads back what it writes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import albedo
from albedo.errors import InputError
from albedo.grammar import (
    ModelSpec,
    SumSpec,
    cos_degrees,
    format_spec,
    format_value,
    parse,
    parse_model,
    parse_numbers,
)

names = st.from_regex(r"[a-z_][a-z0-9_]{0,12}", fullmatch=True).filter(
    lambda name: name not in ("nan", "inf", "infinity")
)
floats = st.floats(allow_nan=False, allow_infinity=False)
scalars = floats | names
values = st.recursive(
    scalars, lambda inner: st.lists(inner, min_size=1, max_size=3).map(tuple), max_leaves=8
)
lists = st.lists(floats, min_size=1, max_size=6, unique=True).map(np.array) | st.lists(
    names, min_size=1, max_size=4, unique=True
).map(tuple)


@given(names, st.dictionaries(names, values, max_size=4), st.dictionaries(names, lists, max_size=2))
def test_what_is_written_reads_back(name, fixed, sweep):
    sweep = {key: value for key, value in sweep.items() if key not in fixed}
    spec = ModelSpec(name, fixed, sweep)
    again = parse(str(spec))
    assert again == spec
    assert hash(again) == hash(spec)
    assert str(again) == str(spec)


specs = st.builds(
    lambda name, fixed, sweep: ModelSpec(
        name, fixed, {key: value for key, value in sweep.items() if key not in fixed}
    ),
    names,
    st.dictionaries(names, values, max_size=3),
    st.dictionaries(names, lists, max_size=1),
)


@given(st.lists(st.tuples(st.floats(0.0, 1e300), specs), min_size=2, max_size=4))
def test_sums_read_back(terms):
    spec = SumSpec(tuple(terms))
    again = parse(str(spec))
    assert again == spec
    assert hash(again) == hash(spec)
    # Blanks mean nothing, and brackets neither.
    assert parse(f" ( {str(spec).replace(' + ', '  +')} ) ") == spec
    doubled = tuple((2.0 * factor, term) for factor, term in terms)
    assert parse(f"2 * ({spec})") == SumSpec(doubled)


@pytest.mark.parametrize(
    ("text", "written"),
    [
        ("phong:n=20,rho_s=0.4 + 0.3*lambert", "phong:n=20,rho_s=0.4 + 0.3*lambert"),
        ("phong+lambert", "phong + lambert"),
        ("0.5*lambert", "0.5*lambert"),
        ("1*lambert", "lambert"),
        ("((lambert))", "lambert"),
        ("2*.5*lambert+1e-1*phong:n=1e+2", "lambert + 0.1*phong:n=100"),
        ("0.5*(phong + 0.5*(lambert + ward))", "0.5*phong + 0.25*lambert + 0.25*ward"),
        ("schwenk:color=(.9,.5,.1) + lambert", "schwenk:color=(0.9,0.5,0.1) + lambert"),
        ("phong:n=+2.+lambert", "phong:n=2 + lambert"),
        ("phong:n=+1..+3/3 + lambert", "phong:n=[1,2,3] + lambert"),
    ],
)
def test_sums_and_multiples(text, written):
    assert str(parse(text)) == written


def test_what_a_sum_calls_itself_reads_back():
    specular, diffuse = albedo.model("phong", n=1e20**0.25), albedo.model("lambert", rho=0.5)
    for model in (specular + 0.3 * diffuse, 1e-7 * (0.1 * specular + diffuse), 0.5 * diffuse):
        assert parse(model.spec).model() == model


def test_sums_are_built_for_every_combination():
    spec = parse("phong:n=[1,20] + 0.5*phong:n=[2,3,4] + lambert")
    assert spec.count == 6
    rows = list(spec.assignments())
    assert rows[1] == {"phong n": 1.0, "phong n 2": 3.0}
    built = list(spec.models())
    assert [model for single in spec.singles() for model in single.models()] == built
    pairs = [tuple(m.parameters["n"] for _, m in model.terms[:2]) for model in built]
    assert pairs == [(1, 2), (1, 3), (1, 4), (20, 2), (20, 3), (20, 4)]
    assert {factor for factor, _ in built[0].terms} == {1.0, 0.5}
    with pytest.raises(InputError, match="sweeps n, but one single model"):
        spec.model()
    with pytest.raises(InputError, match="sum or a multiple"):
        parse_model("0.5*lambert", "A map")


@given(floats)
def test_numbers_keep_every_bit(number):
    (again,) = parse(format_spec("m", {"x": number})).fixed.values()
    assert again == number
    assert math.copysign(1.0, again) == math.copysign(1.0, number)


@given(
    st.floats(1e-12, 1e12),
    st.floats(1.001, 1e6),
    st.integers(4, 200),
    st.sampled_from(["", "log"]),
    st.booleans(),
)
def test_ranges_read_back_as_ranges(start, ratio, count, log, downwards):
    ends = (start * ratio, start) if downwards else (start, start * ratio)
    spec = parse(f"m:x={ends[0]!r}..{ends[1]!r}/{count}{log}")
    points = spec.sweep["x"]
    assert len(points) == count
    assert (points[0], points[-1]) == ends
    assert parse(str(spec)) == spec
    # A range stays a range when written: 200 points would not fit on a line.
    assert len(str(spec)) < 100


@given(st.text(max_size=40))
def test_any_text_is_read_or_refused_in_one_sentence(text):
    for candidate in (text, f"ward:{text}", f"ward:m={text}"):
        message = ""
        try:
            spec = parse(candidate)
        except InputError as error:
            message = str(error)
        assert message.endswith(".") or parse(str(spec)) == spec


@pytest.mark.parametrize(
    ("text", "fixed"),
    [
        ("ward", {}),
        ("ward:m=0.1", {"m": 0.1}),
        (" ward : m = .1 ", {"m": 0.1}),
        (
            "cook_torrance:m=0.3,distribution=ggx,geometry=smith_correlated",
            {"m": 0.3, "distribution": "ggx", "geometry": "smith_correlated"},
        ),
        ("schwenk:color=(.9,.5,.1)", {"color": (0.9, 0.5, 0.1)}),
        ("lafortune:lobes=((-1,-1,1,20),(1,1,1,5))", {"lobes": ((-1, -1, 1, 20), (1, 1, 1, 5))}),
        ("w:prefactor=1/4,b=1/pi", {"prefactor": "1/4", "b": "1/pi"}),
        ("phong:n=1e6", {"n": 1e6}),
        ("phong:n=+2.", {"n": 2.0}),
    ],
)
def test_fixed_parameters(text, fixed):
    assert parse(text).fixed == fixed
    assert parse(text).sweep == {}


@pytest.mark.parametrize(
    ("text", "points"),
    [
        ("w:m=0..1/3", [0.0, 0.5, 1.0]),
        ("w:m=1..0/3", [1.0, 0.5, 0.0]),
        ("w:m=-1..-.5/2", [-1.0, -0.5]),
        ("w:m=1e-2..1e2/3log", [0.01, 1.0, 100.0]),
        ("w:m=1..100/3 log", [1.0, 10.0, 100.0]),
        ("w:m=[.1,.2,.5]", [0.1, 0.2, 0.5]),
        ("w:m=[.1]", [0.1]),
    ],
)
def test_sweeps(text, points):
    np.testing.assert_allclose(parse(text).sweep["m"], points, rtol=1e-15)


def test_sweeps_over_words_and_vectors():
    spec = parse("w:d=[ggx,beckmann],c=[(1,0,0),(0,1,0)]")
    assert spec.sweep == {"d": ("ggx", "beckmann"), "c": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))}
    assert spec.count == 4
    assert [row["d"] for row in spec.assignments()] == ["ggx", "ggx", "beckmann", "beckmann"]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "empty"),
        ("   ", "empty"),
        (":m=1", "not the name of a model"),
        ("ward m", "not the name of a model"),
        ("ward:", "ends after the colon"),
        ("ward:m", "name=value"),
        ("ward:m=", "no value"),
        ("ward:=1", "name=value"),
        ("ward:m=1,", "empty place"),
        ("ward:m=1,,n=2", "empty place"),
        ("ward:m=1,m=2", "given twice"),
        ("ward:m=1,m=[1,2]", "given twice"),
        ("ward:m=nan", "finite"),
        ("ward:m=-inf", "finite"),
        ("ward:m=Infinity", "finite"),
        ("ward:m=1e999", "too large"),
        ("ward:m=1+2j", "complex"),
        ("ward:m=3i", "complex"),
        ("ward:m=0x10", "number, a word"),
        ("ward:m=1_000", "number, a word"),
        ("ward:m=0.1 0.2", "number, a word"),
        ("ward:m=(1,2", "never closed"),
        ("ward:m=1,2)", "not opened"),
        ("ward:m=(1,2]", "not opened"),
        ("ward:m=()", "empty"),
        ("ward:m=(1,,2)", "empty place"),
        ("ward:m=(1,nan)", "finite"),
        ("ward:m=(1,2)3", "followed by"),
        ("ward:m=([1,2],3)", "to sweep"),
        ("ward:m=" + "(" * 20 + "1" + ")" * 20, "deep"),
        ("ward:m=[]", "empty"),
        ("ward:m=[1,]", "empty place"),
        ("ward:m=[1,ggx]", "mixes"),
        ("ward:m=[1,1.0]", "twice"),
        ("ward:m=[1,inf]", "finite"),
        ("ward:m=[0..1/3]", "inside"),
        ("ward:m=0..1", "without a count"),
        ("ward:m=0..1/", "whole number from 2"),
        ("ward:m=0..1/0", "whole number from 2"),
        ("ward:m=0..1/1", "whole number from 2"),
        ("ward:m=0..1/-3", "whole number from 2"),
        ("ward:m=0..1/2.5", "whole number from 2"),
        ("ward:m=0..1/3lin", "whole number from 2"),
        ("ward:m=0..1/1000001", "whole number from 2"),
        ("ward:m=0..1/" + "9" * 5000, "whole number from 2"),
        ("ward:m=0..nan/3", "finite"),
        ("ward:m=a..b/3", "not a number"),
        ("ward:m=0..1/3log", "above 0"),
        ("ward:m=-1..1/3log", "above 0"),
        ("ward:m=1..1/3", "same"),
        ("ward:m=1...5/3", "two ways"),
        ("ward:m=-1e308..1e308/3", "tell apart"),
        ("ward:m=1..1.0000000000000002/9", "tell apart"),
        ("ward +", "empty place beside"),
        ("+ ward", "empty place beside"),
        ("ward ++ phong", "empty place beside"),
        ("2*", "empty place beside"),
        ("*ward", "empty place beside"),
        ("ward*2", "'ward' before the '\\*' in 'ward\\*2' is not a number"),
        ("ward:m=1*2", "stands before its model"),
        ("x*ward", "stands before its model"),
        ("-1*ward", "factor of 'ward' is -1 in '-1\\*ward'; it must not be negative"),
        ("inf*ward", "not a number"),
        ("1e999*ward", "The factor of 'ward' is '1e999', which is too large"),
        ("1e300*(1e300*ward)", "factors of 'ward' in .* are too large"),
        ("ward + 0.5", "not the name of a model"),
        ("ward - phong", "not the name of a model"),
        ("ward:m=1 + 2", "number, a word"),
        ("ward:m=1 + 2 + phong", "number, a word"),
        ("()", "empty"),
        ("0.5*(ward", "never closed"),
        ("ward)", "not opened"),
        ("(ward)phong", "followed by"),
        ("(ward)(phong)", "not opened"),
        ("(" * 9 + "ward" + ")" * 9, "deep"),
        ("ward + phong:", "'phong:' ends after the colon"),
    ],
)
def test_bad_text_gets_one_sentence(text, says):
    with pytest.raises(InputError, match=says) as caught:
        parse(text)
    message = str(caught.value)
    assert "\n" not in message
    assert message.endswith(".")
    assert len(message) < 400


@pytest.mark.parametrize(
    "value", [math.nan, math.inf, 1j, True, None, "two words", "", (), "nan", 10**400, b"x"]
)
def test_values_that_cannot_be_written(value):
    with pytest.raises(InputError):
        format_value(value)


def test_numbers_are_written_short_and_exact():
    spec = format_spec("ward", {"a": 150, "b": np.float64(0.1), "c": 1e-5, "d": np.float32(0.5)})
    assert spec == "ward:a=150,b=0.1,c=1e-05,d=0.5"


def test_text_is_needed():
    with pytest.raises(InputError, match="text"):
        parse(3)  # type: ignore[arg-type]


def test_one_model_where_a_sweep_is_given():
    with pytest.raises(InputError, match="sweeps m, but one single model"):
        parse("ward:m=[.1,.2]").model()


@pytest.mark.parametrize("key", ["name", "self"])
def test_a_parameter_may_have_any_name(key):
    with pytest.raises(InputError, match="has no parameter"):
        parse(f"ward:{key}=1").model()


def test_models_are_built_for_every_combination():
    spec = parse("ward:alpha_x=[.1,.2],alpha_y=[.3,.4,.5],rho_s=0.5")
    pairs = [(m.parameters["alpha_x"], m.parameters["alpha_y"]) for m in spec.models()]
    assert pairs == [(0.1, 0.3), (0.1, 0.4), (0.1, 0.5), (0.2, 0.3), (0.2, 0.4), (0.2, 0.5)]
    assert len(pairs) == spec.count


def test_what_a_model_calls_itself_reads_back():
    model = parse("cook_torrance:m=0.3,distribution=ggx").model()
    assert parse(model.spec).model() == model


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("1,0.5,1e-3", [1.0, 0.5, 1e-3]),
        ("0..1/3", [0.0, 0.5, 1.0]),
        ("1,1e-2..1e-4/3log", [1.0, 1e-2, 1e-3, 1e-4]),
    ],
)
def test_lists_of_numbers(text, numbers):
    np.testing.assert_allclose(parse_numbers(text, "--cos"), numbers, rtol=1e-14)


@pytest.mark.parametrize("text", ["", "1,,2", "a", "nan", "0..1", "1,", "1;2"])
def test_bad_lists_of_numbers_name_the_option(text):
    with pytest.raises(InputError, match=r"^--cos"):
        parse_numbers(text, "--cos")


def test_cosines_of_degrees():
    assert cos_degrees(0.0) == 1.0
    assert cos_degrees(60.0) == 0.5
    assert cos_degrees(90.0) == 0.0
    # cos(90 - x) = sin(x), to the last digit however small x is.
    assert cos_degrees(90.0 - 2.0**-40) == math.sin(math.radians(2.0**-40))
    for angle in (-1e-9, 90.00001, math.nan, math.inf):
        with pytest.raises(InputError, match="within 0 and 90"):
            cos_degrees(angle)
