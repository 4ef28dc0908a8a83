"""three.js: a module with the numbers, a texture of them, its GLSL, and a reading in JavaScript."""

from __future__ import annotations

import base64
import json
import textwrap
from dataclasses import replace
from pathlib import Path

import numpy as np

from albedo.lookup.formats import Format, glsl
from albedo.lookup.formats import _code as code
from albedo.lookup.label import LookupTable

# Arrays, and types of texels.
_ARRAYS = {
    "float32": ("Float32Array", "FloatType"),
    "float16": ("Uint16Array", "HalfFloatType"),
    "unorm8": ("Uint8Array", "UnsignedByteType"),
}

_DIALECT = code.Dialect(
    head="function {name}({inputs}) {{",
    let="  const {name} = {value};",
    back="  return {value};",
    tail="}",
    argument="{name}",
    words={"int": "", "real": "", "clamp": "$clamp"}
    | {name: f"Math.{name}" for name in ("min", "max", "floor", "sqrt", "acos", "log")},
)

_HALF = """\
  const bits = {stored};
  const exponent = (bits >> 10) & 31;
  const digits = (bits & 1023) + (exponent > 0 ? 1024 : 0);
  const size = digits * 2 ** ((exponent > 0 ? exponent : 1) - 25);
  return bits >> 15 ? -size : size;"""

_TEXTURE = """\
export function makeTexture(THREE) {{
  const texture = new THREE.DataTexture(numbers, width, height, THREE.{format}, THREE.{type});
  texture.minFilter = THREE.NearestFilter;
  texture.magFilter = THREE.NearestFilter;
  texture.generateMipmaps = false;
  texture.flipY = false;
  texture.unpackAlignment = 1;
  texture.colorSpace = THREE.NoColorSpace;
  texture.needsUpdate = true;
  return texture;
}}"""


def save(table: LookupTable, path: Path) -> None:
    """Write the module."""
    path.write_text(text(table), encoding="ascii", newline="\n")


def text(table: LookupTable) -> str:
    """The module."""
    first, several = table.channels[0].table, len(table.channels) > 1
    dialect = replace(_DIALECT, data=("channel", "channel") if several else None)
    array, kind = _ARRAYS[first.stored]
    rows, columns = code.shape(table.grid)
    name = code.stem(table)
    what = "an array of both numbers" if several else "the number"
    told = [
        *code.told(table),
        "",
        "makeTexture(THREE) gives a texture, and glsl is the text of a function that reads it:",
        f"{name}(table, {', '.join(code.arguments(table.grid))}).",
        *code.told_of_float32(table),
        f"lookup({', '.join(code.arguments(table.grid))}) gives {what} in double precision.",
        "",
    ]
    functions = [code.CLAMP, *code.helpers(first)]
    main = code.main(first, "value" if several else "lookup")
    parts = [
        code.comment(*told),
        f"export const label = {_script(chr(10).join(code.label_lines(table)))};",
        f"const width = {columns};\nconst height = {rows};",
        _numbers(table, array),
        _TEXTURE.format(format="RGFormat" if several else "RedFormat", type=kind),
        f"export const glsl = {_script(_lines(glsl.functions(table)))};",
        _texel(table, dialect),
        *(dialect.function(own) for own in functions),
        ("" if several else "export ") + dialect.function(main),
        *([_both(table, dialect)] if several else []),
    ]
    return "\n\n".join(parts) + "\n"


def _script(text: str) -> str:
    """JSON that may stand in a page as well."""
    return text.replace("<", "\\u003c")


def _lines(text: str) -> str:
    """A text as an expression that can be read."""
    lines = ",\n".join(f"  {json.dumps(line)}" for line in text.splitlines())
    return f'[\n{lines},\n].join("\\n")'


def _numbers(table: LookupTable, array: str) -> str:
    """The numbers as they are stored, those of a texel side by side, the lowest byte first."""
    data = np.stack([channel.table.data for channel in table.channels], axis=-1)
    raw = data.astype(data.dtype.newbyteorder("<")).tobytes()
    lines = textwrap.wrap(base64.b64encode(raw).decode("ascii"), 96)
    body = ",\n".join(f'  "{line}"' for line in lines)
    return (
        f'const base64 = [\n{body},\n].join("");\n'
        "const bytes = Uint8Array.from(atob(base64), (character) => character.charCodeAt(0));\n"
        f"const numbers = new {array}(bytes.buffer);"
    )


def _texel(table: LookupTable, dialect: code.Dialect) -> str:
    """The function that gives a number."""
    first, several = table.channels[0].table, len(table.channels) > 1
    stored = (
        "numbers[2 * (row * width + column) + channel]"
        if several
        else ("numbers[row * width + column]")
    )
    if first.stored == "float16":
        body = _HALF.format(stored=stored)
    elif first.stored in code.SHARES:
        tables = [channel.table for channel in table.channels]
        low, step = (
            [code.number(getattr(own, what)) for own in tables] for what in ("low", "step")
        )
        chosen = [f"[{', '.join(x)}][channel]" if several else x[0] for x in (low, step)]
        body = f"  return {chosen[0]} + {chosen[1]} * {stored};"
    else:
        body = f"  return {stored};"
    inputs = "channel, row, column" if several else "row, column"
    head = dialect.head.format(name="texel", inputs=inputs)
    return f"{head}\n{body}\n{dialect.tail}"


def _both(table: LookupTable, dialect: code.Dialect) -> str:
    axes = ", ".join(code.arguments(table.grid))
    calls = ", ".join(f"value({k}, {axes})" for k in range(len(table.channels)))
    head = dialect.head.format(name="lookup", inputs=axes)
    return f"export {head}\n  return [{calls}];\n{dialect.tail}"


FORMAT = Format("three", ".js", "a module for three.js", save, stored=tuple(_ARRAYS))
