"""Assertions about tables of albedos, in files or in arrays."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from albedo.brdf import Model
from albedo.errors import InputError

# Places where a lookup table is compared, beside what its label says.
_LOOKS = 128


def assert_table_close(
    table: str | os.PathLike[str] | np.ndarray,
    model: Model | str,
    *,
    atol: float,
    parameter: str | None = None,
    between: bool = True,
    shape: tuple[int, ...] | None = None,
    **convention: str,
) -> None:
    """Fail unless a table of albedos is close to certified values of a model.

    Parameters
    ----------
    table : path or ndarray
        A lookup table that this package wrote; or a table made elsewhere, as `albedo audit` reads
        it: a file, or an array of rows and columns, and of channels last. Of a lookup table what
        its label says is compared, and readings at 128 places.
    model : Model or str
        What it should be of: a model, ``ggx`` or ``beckmann``, or a name with parameters. Of a
        lookup table all parameters but those of its axes are compared.
    atol : float
        What it may err by.
    parameter : str, optional
        What varies beside the direction in a table made elsewhere; ``m`` unless given, where the
        table has two axes.
    between : bool
        Whether readings between its nodes count as well, or the nodes alone.
    shape : tuple of int, optional
        Of a flat list.
    **convention : str
        What is known of a table made elsewhere, such as ``texels="centres"`` or
        ``masking="smith"``: see `albedo.lookup.audit`. What is not told is found out, so that a
        table with another masking passes where only closeness is asked for.

    Raises
    ------
    AssertionError
        With the place of the largest error, and the convention that was found.
    InputError
        For a file that cannot be read, or an unknown convention.

    Examples
    --------
    >>> import numpy as np
    >>> from albedo.testing import assert_table_close
    >>> assert_table_close(np.full(8, 0.5), "lambert:rho=0.5", atol=1e-6)
    """
    if not (isinstance(atol, int | float) and 0.0 < atol < 1.0):
        raise InputError(f"atol = {atol!r} is out of range; it lies in (0, 1)")
    from albedo.lookup.audit import audit, said_to_be, shaped
    from albedo.lookup.foreign import load_array

    kind = said_to_be(model) if isinstance(model, str) else model
    if not isinstance(kind, Model):
        raise InputError(
            f"assert_table_close needs a model or its name, not {type(model).__name__}"
        )
    if isinstance(table, np.ndarray):
        data = table
    else:
        own = _lookup(table)
        if own is not None:
            _compare_lookup(own, kind, atol)
            return
        data = load_array(table)
    data = shaped(data, shape)
    if parameter is None and data.ndim > 1:
        parameter = "m"
    found = audit(data, kind, parameter, fixed=convention)
    nodes = float(np.abs(found.node_errors).max())
    worst = max(nodes, found.largest) if between else nodes
    if worst > atol:
        raise AssertionError(f"the table errs by {worst:.3g}, more than atol = {atol:g}\n{found}")


def _lookup(path: str | os.PathLike[str]) -> Any:
    """A lookup table of this package, or None for another file."""
    from albedo.lookup.formats import formats, load_lookup

    suffix = os.path.splitext(os.fspath(path))[1].lower()
    readable = [own for own in formats().values() if own.suffix == suffix and own.load is not None]
    if not readable:
        return None
    if suffix in (".csv", ".exr"):
        # Such files may be of others: theirs have no label.
        try:
            return load_lookup(path)
        except InputError as error:
            if "label" in str(error) and "digest" not in str(error):
                return None
            raise
    return load_lookup(path)


def _compare_lookup(table: Any, model: Model, atol: float) -> None:
    """Fail where a lookup table is of another model, or errs by more than is allowed."""
    from albedo.files import strict

    expected = strict({k: v for k, v in model.parameters.items() if k not in _varied(table, model)})
    if table.about["name"] != model.name or table.about["parameters"] != expected:
        raise AssertionError(
            f"the table is of {table.about['name']} with {table.about['parameters']}, not of "
            f"{model.name} with {expected}"
        )
    for channel in table.channels:
        if channel.errors.largest > atol:
            where = ", ".join(f"{name} = {x:.4g}" for name, x in channel.errors.where.items())
            raise AssertionError(
                f"the table errs by {channel.errors.largest:.3g} at {where}, as its label says of "
                f"{channel.name}; more than atol = {atol:g}"
            )
    _look(table, model, atol)


def _look(table: Any, model: Model, atol: float) -> None:
    """Fail where a reading differs from a certified value by more than is allowed."""
    from albedo.lookup.quantities import coordinates_of, functions_of, quantity_of

    grid = table.grid
    quantity = quantity_of(table.about["quantity"])
    ends = dict(zip(grid.names, grid.ends, strict=True))
    ranges = {name: ends[name] for name in grid.names if name not in ("phi", "cos_theta")}
    coordinates = coordinates_of(model, ranges, quantity, ends.get("cos_theta", (0.0, 1.0)))
    if tuple(c.name for c in coordinates) != grid.names:
        raise AssertionError(f"the table has the axes {', '.join(grid.names)}, unlike {model.spec}")
    functions = functions_of(
        *(model, quantity, coordinates, 1e-3 * atol, False), fixed=table.about["fixed"]
    )
    share = np.random.default_rng(0).uniform(size=(len(grid.names), _LOOKS))
    x = grid.at(share)
    for channel, function in zip(table.channels, functions, strict=True):
        value, error = function(list(x))
        off = np.abs(channel.table(x) - value) - error
        k = int(np.argmax(off))
        if off[k] > atol:
            where = ", ".join(f"{n} = {v:.6g}" for n, v in zip(grid.names, x[:, k], strict=True))
            raise AssertionError(
                f"{channel.name} at {where} is read as {channel.table(x)[k]:.6g}, and is "
                f"{value[k]:.6g} of {model.spec}; that is more than atol = {atol:g}"
            )


def _varied(table: Any, model: Model) -> set[str]:
    """Parameters that the axes of a table set, through an alias as well."""
    info = {p.name: p for p in model.parameter_info()}
    found = set(table.grid.names)
    for name in table.grid.names:
        found |= set(getattr(info.get(name), "targets", ()))
    return found
