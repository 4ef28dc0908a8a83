"""C: a header of C99 that is C++ as well, with the numbers as they are stored and their reading.

Arithmetic is in double precision, in the order of the library: where its compiler fuses no
multiplications and its libm has the same arc cosine and logarithm, every bit is the same.
"""

from __future__ import annotations

import textwrap
from dataclasses import replace
from pathlib import Path

import numpy as np

from albedo.lookup.formats import Format
from albedo.lookup.formats import _code as code
from albedo.lookup.label import LookupTable

_TYPES = {
    "float64": "double",
    "float32": "float",
    "float16": "uint16_t",
    "unorm16": "uint16_t",
    "unorm8": "uint8_t",
}

DIALECT = code.Dialect(
    head="static inline {kind} {name}({inputs})\n{{",
    let="    const {kind} {name} = {value};",
    back="    return {value};",
    tail="}",
    kinds={"real": "double", "value": "double"},
    words={"int": "(int)", "real": "(double)", "min": "fmin", "max": "fmax", "clamp": "$clamp"},
)

_HALF = """\
    const int bits = {stored};
    const int exponent = (bits >> 10) & 31;
    const int digits = (bits & 1023) + (exponent > 0 ? 1024 : 0);
    const double size = ldexp((double)digits, (exponent > 0 ? exponent : 1) - 25);
    return bits >> 15 ? -size : size;"""


def save(table: LookupTable, path: Path) -> None:
    """Write a header."""
    path.write_text(text(table), encoding="ascii", newline="\n")


def text(table: LookupTable) -> str:
    """The header."""
    first, several = table.channels[0].table, len(table.channels) > 1
    dialect = replace(
        DIALECT, prefix=code.stem(table), data=("int channel", "channel") if several else None
    )
    functions = [code.CLAMP, *code.helpers(first), code.main(first, "channel" if several else "")]
    # Another table under the same name is an error of the compiler, and is not left out in silence.
    guard = dialect.name(f"{table.sha256[:8]}_H").upper()
    parts = [
        code.comment(*code.told(table), "Arithmetic is in double precision.", ""),
        code.label_comment(table),
        f"#ifndef {guard}\n#define {guard}",
        "#include <math.h>\n#include <stdint.h>",
        _numbers(table, dialect),
        _texel(table, dialect),
        *(dialect.function(own) for own in functions),
        *([_both(table, dialect)] if several else []),
        "#endif",
    ]
    return "\n\n".join(parts) + "\n"


def _numbers(table: LookupTable, dialect: code.Dialect) -> str:
    """The arrays."""
    first = table.channels[0].table
    blocks = [_block(channel.table.data, first.stored) for channel in table.channels]
    sizes = f"[{first.data.size}]"
    inner = blocks[0]
    if len(blocks) > 1:
        sizes = f"[{len(blocks)}]{sizes}"
        inner = ",\n".join(f"{{\n{block}\n}}" for block in blocks)
    kind = _TYPES[first.stored]
    return f"static const {kind} {dialect.name('numbers')}{sizes} = {{\n{inner}\n}};"


def _block(data: np.ndarray, stored: str) -> str:
    """Numbers in the shortest form that reads back exactly."""
    # Formatted in another way, a float32 would be widened.
    words = ", ".join(str(x) + ("f" if stored == "float32" else "") for x in data)
    return textwrap.fill(words, 98, initial_indent="    ", subsequent_indent="    ")


def _texel(table: LookupTable, dialect: code.Dialect) -> str:
    """The function that gives a number."""
    first, several = table.channels[0].table, len(table.channels) > 1
    which = "[channel]" if several else ""
    stored = f"{dialect.name('numbers')}{which}[row * {first.grid.counts[-1]} + column]"
    if first.stored == "float16":
        body = _HALF.format(stored=stored)
    elif first.stored in code.SHARES:
        low, step = (
            [code.number(getattr(own.table, what)) for own in table.channels]
            for what in ("low", "step")
        )
        chosen = [f"(channel ? {x[1]} : {x[0]})" if several else x[0] for x in (low, step)]
        body = f"    return {chosen[0]} + {chosen[1]} * {stored};"
    else:
        body = f"    return {stored};"
    inputs = ("int channel, " if several else "") + "int row, int column"
    head = dialect.head.format(kind="double", name=dialect.name("texel"), inputs=inputs)
    return f"{head}\n{body}\n{dialect.tail}"


def _both(table: LookupTable, dialect: code.Dialect) -> str:
    """The function that gives both channels."""
    axes = code.arguments(table.grid)
    outputs = code.outputs(table)
    inputs = ", ".join([*(f"double {own}" for own in axes), *(f"double *{own}" for own in outputs)])
    lines = [
        f"    *{own} = {dialect.name('channel')}({k}, {', '.join(axes)});"
        for k, own in enumerate(outputs)
    ]
    head = dialect.head.format(kind="void", name=dialect.name(), inputs=inputs)
    return "\n".join([head, *lines, dialect.tail])


FORMAT = Format("c", ".h", "a header of C99 and C++", save)
