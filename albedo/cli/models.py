"""``albedo models``."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from albedo.cli.app import app
from albedo.cli.options import (
    complete_model,
)
from albedo.cli.screen import (
    new_table,
    print_table,
)
from albedo.errors import InputError


@app.command()
def models(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="NAME", help="Show one model in full.", autocompletion=complete_model
        ),
    ] = None,
    as_markdown: Annotated[
        bool, typer.Option("--markdown", help="Print the list as a Markdown table.")
    ] = False,
) -> None:
    """List the models, or show one: its formula, sources, promises and parameters.

    \b
    Examples:
      albedo models
      albedo models cook_torrance
    """
    if as_markdown and name is not None:
        raise InputError("--markdown prints the list of all models and does not go with a name.")
    if as_markdown:
        from albedo.describe import markdown

        typer.echo(markdown(), nl=False)
    elif name is None:
        _list_models()
    else:
        _show_model(name)


def _list_models() -> None:
    import albedo

    table = new_table("model", "what it is", "equation", "reciprocal", "conserves energy")
    for name, kind in albedo.models().items():
        promises = (_yes(kind.reciprocal), _yes(kind.conserves_energy))
        table.add_row(name, kind.title, kind.equation, *promises)
    print_table(table)


def _show_model(name: str) -> None:
    import inspect

    from albedo.catalogue import model_class
    from albedo.describe import citation, promises

    kind = model_class(name)
    typer.echo(f"{kind.name}: {kind.title}\n")
    typer.echo(inspect.getdoc(kind))
    typer.echo(f"\nequation:  {kind.equation}")
    for key in kind.references:
        typer.echo(f"source:    {citation(key)}")
    typer.echo()
    for promise, said in promises(kind).items():
        typer.echo(f"{promise + ':':28s} {said}")
    table = new_table("parameter", "default", "allowed", "unit", "meaning")
    for item in kind.parameter_info():
        table.add_row(item.name, _default(item.default), item.range_text, item.unit, item.doc)
    if table.row_count:
        typer.echo()
        print_table(table)


def _yes(promise: Any) -> str:
    # A model whose promise depends on its parameters declares a property.
    if isinstance(promise, bool):
        return "yes" if promise else "no"
    return "depends on its parameters"


def _default(value: Any) -> str:
    from albedo.grammar import format_value

    return "" if value is None else format_value(value)
