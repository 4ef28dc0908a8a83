"""GLSL: functions that read a texture, for GLSL ES 3.00 and desktop GLSL 3.30.

One reads texels and interpolates by arithmetic, which is exact to float32; where the table is read
linearly, another leaves it to the filter of the texture unit.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from albedo.lookup.formats import Format
from albedo.lookup.formats import _code as code
from albedo.lookup.label import LookupTable

STORED = ("float32", "float16", "unorm16", "unorm8")
"""What textures can hold."""

_KINDS = {
    "float32": ("R32F", "RG32F"),
    "float16": ("R16F", "RG16F"),
    "unorm16": tuple(f"{name}16 (in WebGL 2, which has none, {name}32F)" for name in ("R", "RG")),
    "unorm8": ("R8", "RG8"),
}
# Samplers are lowp in GLSL ES unless told otherwise.
_PRECISION = """\
#ifdef GL_ES
precision highp float;
precision highp int;
precision highp sampler2D;
#endif"""

_DIALECT = code.Dialect(
    head="{kind} {name}({inputs})\n{{",
    let="    {kind} {name} = {value};",
    back="    return {value};",
    tail="}",
    words={"real": "float", "acos": "$acos"},
    data=("sampler2D table", "table"),
)


def save(table: LookupTable, path: Path) -> None:
    """Write the functions."""
    path.write_text(text(table), encoding="ascii", newline="\n")


def text(table: LookupTable) -> str:
    """The functions, under a comment that says how the texture is filled."""
    first = table.channels[0].table
    told = [
        *code.told(table),
        *code.told_of_float32(table),
        "",
        *code.told_of_texture(table, _KINDS),
        "In GLSL ES, declare it as uniform highp sampler2D; in WebGL 2, filtering 32F needs the",
        "extension OES_texture_float_linear.",
        *code.told_of_filter(table, f"{code.stem(table)}_filtered"),
        "",
    ]
    parts = [code.comment(*told), code.label_comment(table), functions(table)]
    if first.read == "linear":
        parts.append(_filtered(table))
    return "\n\n".join(parts) + "\n"


def _dialect(table: LookupTable) -> code.Dialect:
    value = "float" if len(table.channels) == 1 else "vec2"
    return replace(_DIALECT, prefix=code.stem(table), kinds={"real": "float", "value": value})


def _leaf(table: LookupTable, name: str, inputs: tuple[str, ...], texel: str) -> str:
    """A function that reads the texture."""
    swizzle = "r" if len(table.channels) == 1 else "rg"
    result = code.scaled(table, "vec2", f"{texel}.{swizzle}")
    return _dialect(table).function(code.Function("value", name, inputs, (), result, data=True))


def functions(table: LookupTable) -> str:
    """The functions that interpolate by arithmetic."""
    first, dialect = table.channels[0].table, _dialect(table)
    texel = _leaf(
        *(table, "texel", ("int row", "int column")),
        "texelFetch(table, ivec2(column, row), 0)",
    )
    others = [*code.helpers(first), code.main(first)]
    if "angle" in table.grid.warps:
        others.insert(0, code.ACOS)
    return "\n\n".join([_PRECISION, texel, *(dialect.function(own) for own in others)])


def _filtered(table: LookupTable) -> str:
    """The function that leaves it to a filter."""
    texel = "textureLod(table, vec2(u, v), 0.0)"
    sample = _leaf(table, "sample", ("real u", "real v"), texel)
    main = code.main(table.channels[0].table, "filtered", by_filter=True)
    return f"{sample}\n\n{_dialect(table).function(main)}"


FORMAT = Format("glsl", ".glsl", "GLSL that reads a texture", save, stored=STORED)
