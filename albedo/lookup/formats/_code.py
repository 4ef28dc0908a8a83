"""A lookup table as code: how it is read, written once for all languages.

Functions are made of declarations and expressions in a few words that C, GLSL, HLSL, OSL,
JavaScript and Python share, and a `Dialect` spells them. What a language does in its own way, such
as to fetch a number, stands in the file of its format.

In expressions ``$name(`` is a function of the same file, and ``@name(`` is one that gets the
numbers of the table as well, where a language has to hand them on.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from decimal import ROUND_UP, Context
from typing import Any

import numpy as np

from albedo.lookup.label import LookupTable
from albedo.lookup.plain import to_plain
from albedo.lookup.stored import Grid, Table
from albedo.lookup.warps import Warp

SHARES = {"unorm16": 65535, "unorm8": 255}
"""What the largest share stands for."""

# Places where float32 is compared with float64.
_PLACES = 16384
_SEED = 0xF32


@dataclass(frozen=True)
class Function:
    """A function without branches.

    Attributes
    ----------
    kind : str
        ``real``, ``int`` or ``value``: a number of each channel.
    name : str
    inputs : tuple of str
        Such as ``real t``.
    lines : tuple of str
        Such as ``real a = t - 1.0``.
    result : str
        An expression.
    data : bool
        Whether it reads numbers of the table.
    """

    kind: str
    name: str
    inputs: tuple[str, ...]
    lines: tuple[str, ...]
    result: str
    data: bool = False


@dataclass(frozen=True)
class Dialect:
    """How a language spells functions.

    Attributes
    ----------
    head, let, back, tail : str
        The first line of a function, a declaration, what it returns, and its last line.
    argument : str
        An input.
    kinds : mapping
        Types.
    words : mapping
        Functions that have other names; ``$name`` is one of the file.
    prefix : str
        What names of functions of the file begin with.
    data : tuple of (str, str)
        What functions that read numbers get first, as it is declared and as it is handed on.
    """

    head: str
    let: str
    back: str
    tail: str
    argument: str = "{kind} {name}"
    kinds: Mapping[str, str] = field(default_factory=dict)
    words: Mapping[str, str] = field(default_factory=dict)
    prefix: str = ""
    data: tuple[str, str] | None = None

    def expression(self, text: str) -> str:
        """Spell an expression."""
        return re.sub(r"([@$]?\b\w+)\(", self._call, text)

    def _call(self, found: re.Match[str]) -> str:
        name = self.words.get(found[1], found[1])
        if not name.startswith(("@", "$")):
            return f"{name}("
        handed = f"{self.data[1]}, " if name.startswith("@") and self.data else ""
        return f"{self.name(name[1:])}({handed}"

    def name(self, own: str = "") -> str:
        """Name of a function of the file; of the one that is called, if it has none of its own."""
        return "_".join(part for part in (self.prefix, own) if part)

    def declaration(self, line: str) -> str:
        """Spell a declaration, ``KIND NAME = EXPRESSION``."""
        kind, name, _, value = line.split(" ", 3)
        return self.let.format(kind=self._kind(kind), name=name, value=self.expression(value))

    def _kind(self, kind: str) -> str:
        return self.kinds.get(kind, kind)

    def inputs(self, inputs: Sequence[str]) -> str:
        """Spell what a function gets."""
        pairs = [line.split(" ") for line in inputs]
        return ", ".join(self.argument.format(kind=self._kind(k), name=n) for k, n in pairs)

    def function(self, own: Function) -> str:
        """Spell a function."""
        inputs = self.inputs(own.inputs)
        if own.data and self.data:
            inputs = f"{self.data[0]}, {inputs}"
        head = self.head.format(kind=self._kind(own.kind), name=self.name(own.name), inputs=inputs)
        lines = [self.declaration(line) for line in own.lines]
        back = self.back.format(value=self.expression(own.result))
        return "\n".join([head, *lines, back, *([self.tail] if self.tail else [])])


CLAMP = Function(
    "real",
    "clamp",
    ("real x", "real low", "real high"),
    (),
    # What is no number stays none.
    "x < low ? low : x > high ? high : x",
)
"""For languages that have none."""

ACOS = Function(
    "real",
    "acos",
    ("real x",),
    (
        "real a = abs(x)",
        "real p = ((0.0066700901 - 0.0012624911 * a) * a - 0.0170881256) * a + 0.0308918810",
        "real q = ((p * a - 0.0501743046) * a + 0.0889789874) * a - 0.2145988016",
        "real r = sqrt(1.0 - a) * (q * a + 1.5707963050)",
    ),
    f"r + step(x, 0.0) * ({math.pi!r} - 2.0 * r)",
)
"""Abramowitz and Stegun 4.4.46, to 2e-8: that of a GPU may err by 1e-4."""


def number(x: float) -> str:
    """A number as all languages read it."""
    text = repr(float(x))
    return f"({text})" if x < 0.0 else text


def blend(read: str) -> Function:
    """Between two points, or along Lagrange's cubic through four."""
    if read == "linear":
        inputs = ("real t", "value a", "value b")
        return Function("value", "blend", inputs, (), "a + t * (b - a)")
    return Function(
        "value",
        "blend",
        ("real t", "value a", "value b", "value c", "value d"),
        (
            *("real u = t - 1.0", "real v = t - 2.0", "real w = t - 3.0"),
            *("real p = -u * v * w / 6.0", "real q = 0.5 * t * v * w"),
            *("real r = -0.5 * t * u * w", "real s = t * u * v / 6.0"),
        ),
        "p * a + q * b + r * c + s * d",
    )


def helpers(table: Table) -> list[Function]:
    """What a reading needs beside ``@texel(row, column)`` and what the language has."""
    counts, points = table.grid.counts, _points(table)
    found = [blend(table.read)]
    at = [_plus("column", k) for k in range(points)]
    found.append(
        Function(
            "value",
            "line",
            ("int row", "int column", "real t"),
            tuple(f"value {n} = @texel(row, {c})" for n, c in zip("abcd", at, strict=False)),
            _blended("t", points),
            data=True,
        )
    )
    if len(counts) == 3:
        rows = [_plus("row", k) for k in range(points)]
        found.append(
            Function(
                "value",
                "plane",
                ("int row", "int column", "real s", "real t"),
                tuple(
                    f"value {n} = @line({r}, column, t)" for n, r in zip("abcd", rows, strict=False)
                ),
                _blended("s", points),
                data=True,
            )
        )
    return found


def _points(table: Table) -> int:
    return 4 if table.read == "cubic" else 2


def _plus(name: str, k: int) -> str:
    return f"{name} + {k}" if k else name


def _blended(t: str, points: int) -> str:
    return f"$blend({t}, {', '.join('abcd'[:points])})"


def places(table: Table) -> list[str]:
    """Declarations of ``t_0`` and so on: where coordinates lie, in steps from the first node."""
    return _along(table.grid)


def _along(grid: Grid) -> list[str]:
    names = arguments(grid)
    numbers = grid.numbers()
    lines = [
        f"real x_{a} = clamp({name}, {number(min(ends))}, {number(max(ends))})"
        for a, (name, ends) in enumerate(zip(names, grid.ends, strict=True))
    ]
    for a, text in enumerate(grid.warps):
        own = Warp.parse(text)
        low, high, first, scale, steps, shift, count = map(float, numbers[a, 3:])
        if own.by:
            lines.append(f"real k_{a} = {number(own.k)} * x_{grid.names.index(own.by)}")
            begin, end = (_rational(number(x), f"k_{a}") for x in (low, high))
            lines.append(f"real first_{a} = {begin if low else '0.0'}")
            lines.append(f"real last_{a} = {end}")
            along = f"{number(steps)} * ({_rational(f'x_{a}', f'k_{a}')} - first_{a})"
            along += f" / (last_{a} - first_{a})"
        else:
            along = f"({_warped(own, f'x_{a}')} - {number(first)}) * {number(scale)}"
        moved = f"{along} - {-shift!r}" if shift else along
        lines.append(f"real t_{a} = clamp({moved}, 0.0, {number(count - 1.0)})")
    return lines


def unit_coordinates(grid: Grid) -> list[str]:
    """Declarations of ``u_0`` and so on: warped coordinates on [-1, 1]."""
    steps = replace(grid, counts=(3,) * len(grid.names), texels="ends")
    # Three points are two steps, from 0 to 2.
    lines = _along(steps)
    return [*lines, *(f"real u_{a} = t_{a} - 1.0" for a in range(len(grid.names)))]


def _warped(own: Warp, x: str) -> str:
    if own.kind == "linear":
        return x
    if own.kind == "rational":
        return f"{x} * {number(1.0 + own.k)} / ({x} + {number(own.k)})"
    return {"sqrt": f"sqrt({x})", "angle": f"acos({x})", "log": f"log({x})"}[own.kind]


def _rational(x: str, k: str) -> str:
    return f"{x} * (1.0 + {k}) / ({x} + {k})"


def _cell(table: Table, a: int) -> list[str]:
    """Declarations of the first of the points that are read along an axis, and of the way on."""
    count = table.grid.counts[a]
    # A minimum drops what is no number, which is no index either.
    first = f"min(floor(t_{a}), {number(count - 2)})"
    if table.read == "cubic":
        first = f"min(max(floor(t_{a}) - 1.0, 0.0), {number(count - 4)})"
    return [f"int i_{a} = int({first})", f"real f_{a} = t_{a} - real(i_{a})"]


def reading(table: Table) -> tuple[list[str], str]:
    """Declarations and the result of a reading by arithmetic."""
    counts, points = table.grid.counts, _points(table)
    lines = places(table)
    for a in range(len(counts)):
        lines += _cell(table, a)
    if len(counts) == 1:
        return lines, "@line(0, i_0, f_0)"
    values = [f"v_{k}" for k in range(points)]
    for k, name in enumerate(values):
        first = f"(i_0 + {k})" if k else "i_0"
        if len(counts) == 2:
            lines.append(f"value {name} = @line({_plus('i_0', k)}, i_1, f_1)")
        else:
            row = f"{first} * {counts[1]} + i_1"
            lines.append(f"value {name} = @plane({row}, i_2, f_1, f_2)")
    return lines, f"$blend(f_0, {', '.join(values)})"


def filtered(table: Table) -> tuple[list[str], str]:
    """The same by a texture unit's linear filter, ``@sample(u, v)``.

    Its coordinates are scaled and shifted by half a texel, so that they reach the outermost nodes.
    """
    counts = table.grid.counts
    lines = places(table)
    u = f"(t_{len(counts) - 1} + 0.5) / {number(counts[-1])}"
    if len(counts) == 1:
        return lines, f"@sample({u}, 0.5)"
    if len(counts) == 2:
        return lines, f"@sample({u}, (t_0 + 0.5) / {number(counts[0])})"
    lines += _cell(table, 0)
    height = number(counts[0] * counts[1])
    for k, name in enumerate(("v_0", "v_1")):
        row = f"real({_plus('i_0', k)}) * {number(counts[1])} + t_1 + 0.5"
        lines.append(f"value {name} = @sample({u}, ({row}) / {height})")
    return lines, "$blend(f_0, v_0, v_1)"


def shape(grid: Grid) -> tuple[int, int]:
    """Rows and columns of the picture of a table, as in OpenEXR."""
    return math.prod(grid.counts[:-1]), grid.counts[-1]


def main(table: Table, name: str = "", *, by_filter: bool = False) -> Function:
    """The function that is called."""
    inputs = tuple(f"real {own}" for own in arguments(table.grid))
    lines, result = filtered(table) if by_filter else reading(table)
    return Function("value", name, inputs, tuple(lines), result, data=True)


# Names


def stem(table: Any) -> str:
    """What all names of a file begin with: an identifier, from the model and the quantity."""
    quantity = table.about["quantity"]
    words = ["albedo", table.about["name"][:40], "" if quantity == "albedo" else quantity]
    text = re.sub(r"[^A-Za-z0-9]+", "_", "_".join(words))
    return text.strip("_")


def arguments(grid: Grid) -> list[str]:
    """Names of the axes as no language minds them."""
    found: list[str] = []
    for name in grid.names:
        # Two underscores are reserved in GLSL and C++.
        own = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_") or "x"
        if own[0].isdigit() or own.startswith("gl_"):
            own = f"x_{own}"
        if own in _RESERVED or _TYPES.fullmatch(own) or _LOCALS.fullmatch(own):
            own += "_"
        while own in found:
            own = f"{own.rstrip('_')}_{len(found)}x"
        found.append(own)
    return found


_TYPES = re.compile(
    r"([biud]?vec|d?mat|float|half|u?int|bool|double|min\d+\w+?)\d(x\d)?|u?int\w*_t|"
    r"[iu]?(sampler|image|texture|Texture|Buffer|RW)\w*|SV_\w*"
)
_LOCALS = re.compile(r"([xtikfv]|first|last)_\d|to_\w+")
# C and C++, with macros that common headers or compilers bring.
_C = """
alignas alignof and and_eq asm auto bitand bitor bool break case catch char char8_t char16_t
char32_t class compl complex concept const consteval constexpr constinit const_cast continue
co_await co_return co_yield decltype default delete do double dynamic_cast else enum explicit
export extern far false float for friend goto if imaginary inline int linux long mutable namespace
near new noexcept not not_eq nullptr operator or or_eq private protected public register
reinterpret_cast requires restrict return short signed size_t sizeof static static_assert
static_cast struct switch template this thread_local throw true try typedef typeid typename typeof
union unix unsigned using virtual void volatile wchar_t while xor xor_eq NAN INFINITY NULL
"""
# GLSL, HLSL and OSL.
_SHADERS = """
active asuint attribute atomic_uint buffer cbuffer centroid closure coherent color column_major
common compile cast discard dword emit external filter fixed flat fvec half highp hvec illuminance
illuminate in inout input interface interpolate invariant layout linear lineadj lowp main matrix
mediump noinline nointerpolation noperspective normal out output packed packoffset partition pass
patch pixelfragment point precise precision public readonly registers resource row_major sample
sampling shader shared snorm stateblock string subroutine superp surface tbuffer technique texture
triangle triangleadj uint uniform unorm varying vector vertexfragment volume writeonly P I N Ng u v
dPdu dPdv Ps time dtime dPdtime Ci M_PI
"""
# JavaScript and Python.
_SCRIPTS = """
arguments as async await debugger eval finally from function import instanceof is lambda let
nonlocal null of package pass super undefined var with yield None True False def del elif except
global raise assert Math NaN Infinity THREE
"""
# What generated code is made of.
_OWN = """
abs acos blend channel clamp column data floor fmax fmin file glsl label ldexp line log lookup
makeTexture max min np numbers picture plane pow real row sqrt step table texel texelFetch
textureLod value whole width height
"""
_RESERVED = frozenset(f"{_C} {_SHADERS} {_SCRIPTS} {_OWN}".split())


def outputs(table: LookupTable) -> list[str]:
    """Names of what a function gives that gives several numbers."""
    return [f"to_{re.sub('[^A-Za-z0-9]+', '_', own.name).strip('_')}" for own in table.channels]


# Comments


def comment(*lines: str) -> str:
    """Lines that begin with ``//``, whatever stands in them.

    Nothing ends such a comment but its line, and only ``\\`` at its end goes on with the next.
    """
    found = []
    for line in lines:
        # In ASCII and without control characters, as JSON escapes them.
        plain = json.dumps(line)[1:-1].replace('\\"', '"').replace("\\\\", "\\")
        if plain.rstrip().endswith(("\\", "??/")):
            plain += "."
        found.append(f"// {plain}".rstrip())
    return "\n".join(found)


def label_lines(table: LookupTable) -> list[str]:
    """The label with its digest as JSON in ASCII, a line for each word."""
    label = json.loads(to_plain(table)[0])
    words = [f" {json.dumps(key)}: {json.dumps(value)}" for key, value in label.items()]
    return ["{", *(f"{word}," for word in words[:-1]), words[-1], "}"]


def label_comment(table: LookupTable) -> str:
    """The label as a comment."""
    first, *others = label_lines(table)
    return "\n".join([f"// label: {first}", *(f"// {line}" for line in others)])


def up(x: float, digits: int = 3) -> str:
    """A bound in a few digits, none of them rounded down."""
    return f"{float(Context(prec=digits, rounding=ROUND_UP).create_decimal_from_float(x)):g}"


def told(table: LookupTable) -> list[str]:
    """What every file begins with: what the table holds, its domain, and what it errs by."""
    grid, first = table.grid, table.channels[0].table
    lines = [
        f"{table.about['title']}, a lookup table by {table.about['source']}.",
        f"It holds {table.about['meaning']}, for {table.about['model']};",
        f"{grid} points of {first.stored}, read by {first.read} interpolation.",
        "",
    ]
    for name, own, ends in zip(grid.names, arguments(grid), grid.ends, strict=True):
        renamed = "" if own == name else f" (here {own})"
        lines.append(f"  {name}{renamed} from {min(ends)!r} to {max(ends)!r}")
    lines += [
        "",
        "A coordinate beyond its range is taken to be at its end. Azimuths are in radians.",
    ]
    lines += [
        f"{channel.name} errs by {up(channel.errors.largest)} at most, against the model."
        for channel in table.channels
    ]
    return lines


def told_of_float32(table: LookupTable, *, by_filter: bool = False) -> list[str]:
    """What float32 adds, for a comment."""
    adds = up(2.0 * float32_adds(table, by_filter=by_filter), 2)
    return [
        f"float32 arithmetic adds up to {adds}: twice the most that was measured at {_PLACES}",
        "places, where divisions, roots and logarithms were as inexact as Vulkan lets them be.",
    ]


def told_of_texture(table: LookupTable, kinds: Mapping[str, Sequence[str]]) -> list[str]:
    """How a texture is filled, for a comment; what its texels are called, by how many numbers."""
    grid, first = table.grid, table.channels[0].table
    rows, columns = shape(grid)
    names = arguments(grid)
    kind = kinds[first.stored][len(table.channels) - 1]
    down = " and ".join(names[:-1])
    order = f"a row runs along {names[-1]}" + (f", rows along {down}" if down else "")
    if len(names) == 3:
        order += f", each {names[0]} having {grid.counts[1]} of them"
    lines = [
        f"The texture has {columns} x {rows} texels of {kind}, without mipmaps:",
        f"{order}.",
        f"Number row * {columns} + column of the table is texel (column, row); row 0 lies first in",
        "memory, where texture coordinates are 0, and nothing is flipped.",
    ]
    if len(table.channels) == 2:
        lines.append(f"Red is {table.channels[0].name}, green is {table.channels[1].name}.")
    if first.stored in SHARES:
        lines.append(f"A texel holds a share k as k / {SHARES[first.stored]}.")
    lines.append("The numbers are in files of other formats whose label has the same sha256.")
    return lines


def told_of_filter(table: LookupTable, name: str) -> list[str]:
    """What a texture unit's filter needs and adds, for a comment."""
    if table.channels[0].table.read == "cubic":
        return ["A texture unit filters linearly, which is not how this table is read."]
    return [
        f"{name} leaves the interpolation to a texture that is filtered linearly and",
        "clamped to its edge. With weights of eight bits, the fewest there are, it adds up to",
        f"{up(filter_adds(table) + 2.0 * float32_adds(table, by_filter=True), 2)} instead.",
    ]


def vector(kind: str, numbers: Sequence[float]) -> str:
    """A constant for each channel."""
    if len(numbers) == 1:
        return number(numbers[0])
    return f"{kind}({', '.join(map(number, numbers))})"


def scaled(table: LookupTable, kind: str, texel: str) -> str:
    """What a texel stands for, as an expression."""
    tables = [channel.table for channel in table.channels]
    if tables[0].stored not in SHARES:
        return texel
    low = vector(kind, [own.low for own in tables])
    return f"{low} + {vector(kind, [span(own) for own in tables])} * {texel}"


# Arithmetic in float32


class _Rough(np.ndarray):
    """float32 as a GPU may compute: its divisions err by up to 2.5 units in the last place."""

    def __truediv__(self, other: Any) -> Any:
        return _off(np.true_divide(self, other), 2.5)

    def __rtruediv__(self, other: Any) -> Any:
        return _off(np.true_divide(other, self), 2.5)


def _off(exact: Any, units: float, least: float = 0.0) -> Any:
    """Numbers that err as much as they may, up or down."""
    found = np.asarray(exact, dtype=np.float32)
    # By a bit of a hash, so that a file is the same each time it is written.
    sign = (found.view(np.uint32) * np.uint32(2654435761)) >> np.uint32(31)
    most = np.maximum(np.float32(units) * np.spacing(np.abs(found)), np.float32(least))
    return (found + np.where(sign, most, -most)).view(_Rough)


def _rough(x: Any) -> Any:
    return np.asarray(x, dtype=np.float32).view(_Rough)


_PYTHON = Dialect(
    head="def {name}({inputs}):",
    let="    {name} = {value}",
    back="    return {value}",
    tail="",
    argument="{name}",
    words={"int": "whole", "min": "np.minimum", "max": "np.maximum", "floor": "np.floor"}
    | {"abs": "np.abs", "clamp": "np.clip", "acos": "$acos", "sqrt": "sqrt", "log": "log"},
)
_WORDS = {
    "np": np,
    "whole": lambda x: np.asarray(x).astype(np.int64),
    "real": _rough,
    "step": lambda edge, x: _rough(x >= edge),
    # As Vulkan lets them be: a root may be the inverse of a rough inverse root.
    "sqrt": lambda x: _off(np.sqrt(x), 4.5),
    "log": lambda x: _off(np.log(x), 3.0, 2.0**-21),
}


def float32_texels(table: Table) -> np.ndarray:
    """The picture of a table as a texture unit gives it and code makes numbers of it."""
    if table.stored not in SHARES:
        return table.values.astype(np.float32).reshape(shape(table.grid))
    share = _off((table.data / SHARES[table.stored]).astype(np.float32), 1.0)
    return (table.low + span(table) * share).reshape(shape(table.grid))


def span(table: Table) -> float:
    """From the smallest share to the largest."""
    return table.step * SHARES[table.stored]


def float32_adds(table: LookupTable, *, by_filter: bool = False) -> float:
    """The largest difference that float32 makes, at many places.

    The functions that are exported are run in float32, where division, root and logarithm err as
    much as Vulkan lets them, and are compared with float64 at the same coordinates.

    Parameters
    ----------
    table : LookupTable
    by_filter : bool
        Of the reading by a filter, whose weights are float32 too.
    """
    grid = table.grid
    rng = np.random.default_rng(_SEED)
    shares = rng.uniform(size=(len(grid.names), _PLACES // 2))
    # Ends matter, and so does what is crowded in either coordinate.
    shares[:, :64] = np.rint(shares[:, :64])
    ends = np.sort(np.array(grid.ends), axis=1)
    even = ends[:, :1] + np.diff(ends, axis=1) * rng.uniform(size=shares.shape)
    x = np.concatenate((grid.at(shares), even), axis=1).astype(np.float32)
    exact = np.clip(x.astype(np.float64), ends[:, :1], ends[:, 1:])
    first = table.channels[0].table
    functions = [ACOS, *helpers(first), main(first, "main", by_filter=by_filter)]
    source = "\n".join(_PYTHON.function(own) for own in functions)
    largest = 0.0
    for channel in table.channels:
        texels = float32_texels(channel.table).view(_Rough)
        names: dict[str, Any] = dict(_WORDS)
        names["texel"] = lambda row, column, texels=texels: texels[row, column]
        names["sample"] = lambda u, v, texels=texels: _bilinear(texels, u, v)
        # The very text that other languages get.
        exec(source, names)
        found = np.asarray(names["main"](*(_rough(own) for own in x)), dtype=np.float64)
        largest = max(largest, float(np.abs(found - channel.table(exact)).max()))
    return largest


def in_float32(functions: Sequence[Function], x: np.ndarray) -> np.ndarray:
    """What a function called ``main`` gives in float32 for each row of coordinates."""
    names: dict[str, Any] = dict(_WORDS)
    exec("\n".join(_PYTHON.function(own) for own in functions), names)
    return np.asarray(names["main"](*(_rough(own) for own in x)), dtype=np.float64)


def _bilinear(texels: Any, u: Any, v: Any) -> Any:
    """What a linear filter with exact weights gives."""
    height, width = texels.shape
    s, t = _rough(v) * height - 0.5, u * width - 0.5
    j, i = np.floor(s), np.floor(t)
    rows = [np.clip(j.astype(int) + k, 0, height - 1) for k in (0, 1)]
    columns = [np.clip(i.astype(int) + k, 0, width - 1) for k in (0, 1)]
    lines = [
        texels[row, columns[0]] * (1.0 - (t - i)) + texels[row, columns[1]] * (t - i)
        for row in rows
    ]
    return lines[0] * (1.0 - (s - j)) + lines[1] * (s - j)


def filter_adds(table: LookupTable) -> float:
    """What weights of eight bits, the fewest that GPUs have, add at most."""
    most = 0.0
    for channel in table.channels:
        values = channel.table.values
        # A table of three axes is filtered along two.
        axes = range(max(0, values.ndim - 2), values.ndim)
        steps = sum(float(np.abs(np.diff(values, axis=axis)).max()) for axis in axes)
        most = max(most, steps / 256.0)
    return most
