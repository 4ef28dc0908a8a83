"""HLSL: functions that read a texture, as in GLSL."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from albedo.lookup.formats import Format
from albedo.lookup.formats import _code as code
from albedo.lookup.label import LookupTable

_KINDS = {
    "float32": ("DXGI_FORMAT_R32_FLOAT", "DXGI_FORMAT_R32G32_FLOAT"),
    "float16": ("DXGI_FORMAT_R16_FLOAT", "DXGI_FORMAT_R16G16_FLOAT"),
    "unorm16": ("DXGI_FORMAT_R16_UNORM", "DXGI_FORMAT_R16G16_UNORM"),
    "unorm8": ("DXGI_FORMAT_R8_UNORM", "DXGI_FORMAT_R8G8_UNORM"),
}

_DIALECT = code.Dialect(
    head="{kind} {name}({inputs})\n{{",
    let="    const {kind} {name} = {value};",
    back="    return {value};",
    tail="}",
    words={"real": "float", "acos": "$acos"},
)


def save(table: LookupTable, path: Path) -> None:
    """Write the functions."""
    path.write_text(text(table), encoding="ascii", newline="\n")


def text(table: LookupTable) -> str:
    """The functions, under a comment that says how the texture is filled."""
    first, value = table.channels[0].table, ("float", "float2")[len(table.channels) - 1]
    texture = f"Texture2D<{value}> table"
    dialect = replace(
        _DIALECT,
        prefix=code.stem(table),
        kinds={"real": "float", "value": value},
        data=(texture, "table"),
    )
    told = [
        *code.told(table),
        *code.told_of_float32(table),
        "",
        *code.told_of_texture(table, _KINDS),
        *code.told_of_filter(table, dialect.name("filtered")),
        "",
    ]
    others = [*code.helpers(first), code.main(first)]
    if "angle" in table.grid.warps:
        others.insert(0, code.ACOS)
    texel = code.Function(
        *("value", "texel", ("int row", "int column"), ()),
        code.scaled(table, value, "table.Load(int3(column, row, 0))"),
        data=True,
    )
    parts = [dialect.function(own) for own in (texel, *others)]
    if first.read == "linear":
        pair = f"{texture}, SamplerState linear_clamp", "table, linear_clamp"
        sampled = replace(dialect, data=pair)
        sample = code.Function(
            *("value", "sample", ("real u", "real v"), ()),
            code.scaled(table, value, "table.SampleLevel(linear_clamp, float2(u, v), 0.0)"),
            data=True,
        )
        main = code.main(first, "filtered", by_filter=True)
        parts += [sampled.function(own) for own in (sample, main)]
    return "\n\n".join([code.comment(*told), code.label_comment(table), *parts]) + "\n"


FORMAT = Format(
    *("hlsl", ".hlsl", "HLSL that reads a texture", save),
    stored=("float32", "float16", "unorm16", "unorm8"),
)
