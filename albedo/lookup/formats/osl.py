"""OSL: functions and a shader that read the table's OpenEXR picture.

No compiler of OSL has seen them: tests compile their text as C++, with a texture of their own, and
compare the coordinates with OpenImageIO's texture system.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from albedo.lookup.formats import Format
from albedo.lookup.formats import _code as code
from albedo.lookup.label import LookupTable

_DIALECT = code.Dialect(
    head="{kind} {name}({inputs})\n{{",
    let="    {kind} {name} = {value};",
    back="    return {value};",
    tail="}",
    kinds={"real": "float", "value": "float"},
    words={"int": "(int)", "real": "(float)", "acos": "$acos"},
)

_ROWS = """\
// Row 0 of a picture lies where v is 0; where v runs upwards, as in Blender, this is 1.0 - (v).
#ifndef ALBEDO_V
#define ALBEDO_V(v) (v)
#endif"""


def save(table: LookupTable, path: Path) -> None:
    """Write the functions and the shader."""
    path.write_text(text(table), encoding="ascii", newline="\n")


def text(table: LookupTable) -> str:
    """The functions, and a shader of them."""
    first, several = table.channels[0].table, len(table.channels) > 1
    dialect = replace(
        _DIALECT,
        prefix=code.stem(table),
        data=("string file, int channel", "file, channel") if several else ("string file", "file"),
    )
    linear = first.read == "linear"
    functions = code.helpers(first)
    if linear:
        # The picture is filtered along two axes; numbers of a third are blended.
        functions = [code.blend("linear")] if len(table.grid.names) == 3 else []
    if "angle" in table.grid.warps:
        functions.insert(0, code.ACOS)
    main = code.main(first, "channel" if several else "", by_filter=linear)
    told = [
        *code.told(table),
        *code.told_of_float32(table, by_filter=linear),
        "",
        "The file is this table as OpenEXR, whose label has the same sha256. Texture coordinates",
        "are scaled and shifted by half a texel, so that they reach the outermost nodes.",
        "",
    ]
    parts = [
        code.comment(*told),
        code.label_comment(table),
        _ROWS,
        _sample(table, dialect, linear),
        *(dialect.function(own) for own in (*functions, main)),
        *([_both(table, dialect)] if several else []),
        _shader(table, dialect),
    ]
    return "\n\n".join(parts) + "\n"


def _sample(table: LookupTable, dialect: code.Dialect, linear: bool) -> str:
    """The function that reads the picture: between texels, or one of them."""
    which = "channel" if len(table.channels) > 1 else "0"
    # Without a width there is no blur by what neighbouring points of the surface read.
    options = (
        f'"wrap", "clamp", "interp", "{"bilinear" if linear else "closest"}",\n        '
        f'"width", 0.0, "blur", 0.0, "firstchannel", {which}'
    )
    if linear:
        own = code.Function("value", "sample", ("real u", "real v"), (), "{u}, {v}", data=True)
        u, v = "u", "v"
    else:
        rows, columns = code.shape(table.grid)
        own = code.Function("value", "texel", ("int row", "int column"), (), "", data=True)
        u = f"(column + 0.5) / {code.number(columns)}"
        v = f"(row + 0.5) / {code.number(rows)}"
    return dialect.function(
        replace(own, result=f"texture(file, {u}, ALBEDO_V({v}),\n        {options})")
    )


def _both(table: LookupTable, dialect: code.Dialect) -> str:
    """The function that gives both channels."""
    axes = code.arguments(table.grid)
    inputs = ["string file", *(f"float {own}" for own in axes)]
    inputs += [f"output float {own}" for own in code.outputs(table)]
    lines = [
        f"    {own} = {dialect.name('channel')}(file, {k}, {', '.join(axes)});"
        for k, own in enumerate(code.outputs(table))
    ]
    head = dialect.head.format(kind="void", name=dialect.name(), inputs=", ".join(inputs))
    return "\n".join([head, *lines, dialect.tail])


def _shader(table: LookupTable, dialect: code.Dialect) -> str:
    """The shader, for those who include no functions."""
    grid, outputs = table.grid, code.outputs(table)
    axes = code.arguments(grid)
    inputs = [f'string file = "{dialect.name()}.exr"']
    inputs += [
        f"float {own} = {code.number(max(ends))}" for own, ends in zip(axes, grid.ends, strict=True)
    ]
    inputs += [f"output float {own} = 0.0" for own in outputs]
    call = f"{dialect.name()}(file, {', '.join(axes)}"
    body = f"{call}, {', '.join(outputs)});" if len(outputs) > 1 else f"{outputs[0]} = {call});"
    return "\n".join(
        [
            "#ifndef ALBEDO_FUNCTIONS_ONLY",
            f"shader {dialect.name('shader')}(",
            ",\n".join(f"    {own}" for own in inputs) + ")",
            f"{{\n    {body}\n}}",
            "#endif",
        ]
    )


FORMAT = Format(
    "osl", ".osl", "OSL that reads the OpenEXR picture", save, stored=("float32", "float16")
)
