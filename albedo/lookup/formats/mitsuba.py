"""Mitsuba 3: a plugin in Python, a rough conductor that gives back what a table says is lost."""

from __future__ import annotations

import base64
import textwrap
from pathlib import Path

from albedo.errors import InputError
from albedo.lookup.formats import Format
from albedo.lookup.label import LookupTable
from albedo.lookup.plain import to_plain

GEOMETRY = {"ggx": "smith", "beckmann": "smith_rational"}
"""What `geometry` of cook_torrance is the masking of `roughconductor`, by distribution."""

_AXES = ("m", "cos_theta")


def check(table: LookupTable) -> None:
    """Refuse a table that is not the albedo of Mitsuba's lobe.

    Raises
    ------
    InputError
        Where the quantity, the axes, the interpolation or the model are others.
    """
    about, grid = table.about, table.grid
    if about["quantity"] not in ("albedo", "complement"):
        raise InputError(
            f"the plugin for Mitsuba reads an albedo or its complement; the table is of "
            f"{about['quantity']}"
        )
    if grid.names != _AXES:
        raise InputError(
            f"the plugin for Mitsuba reads tables over m and cos_theta; this one is over "
            f"{' and '.join(grid.names)}"
        )
    if grid.ends[1] != (0.0, 1.0):
        raise InputError(
            "the plugin for Mitsuba reads tables of all cosines from 0 to 1; this one has "
            f"{grid.ends[1][0]:g} to {grid.ends[1][1]:g}"
        )
    if table.channels[0].table.read != "linear":
        raise InputError(
            "the plugin for Mitsuba reads by linear interpolation; design the table with interp "
            "linear"
        )
    _check_model(table)


def _check_model(table: LookupTable) -> None:
    name, own = table.about["name"], table.about["parameters"]
    if name != "cook_torrance":
        raise InputError(
            f"the plugin for Mitsuba needs a table of cook_torrance; this one is of {name}"
        )
    distribution = own["distribution"]
    if distribution not in GEOMETRY:
        raise InputError(
            f"Mitsuba's roughconductor is ggx or beckmann; the table is of {distribution}"
        )
    wanted = {"geometry": GEOMETRY[distribution], "prefactor": "1/4", "fresnel": "white"}
    for key, value in wanted.items():
        if own[key] != value:
            raise InputError(
                f"Mitsuba's roughconductor of {distribution}, without its Fresnel factor, has "
                f"{key} = {value}; the table is of {key} = {own[key]}"
            )


def save(table: LookupTable, path: Path) -> None:
    """Write the plugin with the table in it."""
    check(table)
    text, arrays = to_plain(table)
    (data,) = arrays.values()
    coded = base64.b64encode(data.astype(data.dtype.newbyteorder("<")).tobytes()).decode("ascii")
    lines = "\n".join(f'    "{line}"' for line in textwrap.wrap(coded, 88))
    source = Path(__file__).with_name("_mitsuba_plugin.py").read_text(encoding="utf-8")
    source = source.replace('LABEL = ""\n', f"LABEL = {text!r}\n", 1)
    source = source.replace('DATA = ""\n', f"DATA = (\n{lines}\n)\n", 1)
    said = [f"Written by {table.about['source']}.", *str(table).splitlines()]
    comments = "".join(f"# {line}\n" for line in said)
    path.write_text(comments + source, encoding="utf-8", newline="\n")


FORMAT = Format("mitsuba", ".py", "plugin for Mitsuba 3, a rough conductor", save, axes=2)
