"""Formulas in place of tables: polynomials and quotients of two, with their error, as code.

Coordinates are warped as those of tables are, and taken to [-1, 1]; a formula of degree n has the
products of their powers of up to n in all. It is fitted so that its largest error is least
(Lawson's weights), to the same reference as tables, and measured in the same way.
"""

from __future__ import annotations

import itertools
import json
import math
import os
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike

from albedo.brdf import Model
from albedo.errors import InputError
from albedo.files import atomic_file, check_output, strict
from albedo.lookup.design import Search, Wish, measure
from albedo.lookup.formats import _code as code
from albedo.lookup.formats.c import DIALECT as C
from albedo.lookup.label import Errors, about_of, places_of
from albedo.lookup.quantities import coordinates_of, quantity_of, subject_of
from albedo.lookup.stored import Grid
from albedo.lookup.warps import Warp

FORMS = ("polynomial", "rational")
"""What a formula may be."""
DEGREES = {1: range(1, 17), 2: range(1, 11), 3: range(1, 7)}
"""Degrees that are tried, by the number of axes."""

# Places that a formula is fitted to, and rounds of Lawson's weights.
_FITTED, _ROUNDS = 4000, 24
# Axes that are looked at further, of all, and the degree at which they are compared.
_BEST, _TRIAL = 4, {1: 6, 2: 5, 3: 3}
# Cells along each axis where errors are measured.
_CELLS = {1: 256, 2: 48, 3: 12}
_PLACES, _SEED = 8192, 0xF17


@dataclass(frozen=True, eq=False)
class Fit:
    """A formula that stands for an albedo; made by `albedo.fit`.

    Attributes
    ----------
    form : str
        Of `FORMS`.
    grid : Grid
        Its axes; counts say nothing.
    powers : ndarray of int, shape (terms, axes)
        Of the warped coordinates on [-1, 1].
    channels : tuple of str
    numerators, denominators : tuple of ndarray, shape (terms,)
        Coefficients for each channel. The denominator of a polynomial is 1.
    errors : tuple of Errors
        For each channel.
    about : dict
        As of `albedo.LookupTable`.
    """

    form: str
    grid: Grid
    powers: np.ndarray
    channels: tuple[str, ...]
    numerators: tuple[np.ndarray, ...]
    denominators: tuple[np.ndarray, ...]
    errors: tuple[Errors, ...]
    about: dict[str, Any]

    @property
    def degree(self) -> int:
        """The largest sum of powers."""
        return int(self.powers.sum(1).max())

    @property
    def coefficients(self) -> int:
        """How many numbers all channels have."""
        own = [int(np.count_nonzero(n)) for n in self.numerators]
        return sum(own) + sum(int(np.count_nonzero(d[1:])) for d in self.denominators)

    @property
    def worst(self) -> float:
        """The error of the worst channel, in the sense that was asked for."""
        name = {"max": "largest", "rms": "rms", "relative": "relative"}[self.about["metric"]]
        return max(float(getattr(errors, name)) for errors in self.errors)

    def read(self, x: np.ndarray, channel: int = 0) -> np.ndarray:
        """Values at coordinates, shape (axes, n)."""
        return _quotient(
            self.grid, self.powers, self.numerators[channel], self.denominators[channel], x
        )

    def __call__(self, **coordinates: ArrayLike) -> np.ndarray:
        """Values at coordinates; as of `albedo.LookupTable`."""
        x, shape = places_of(self.grid, coordinates)
        found = [self.read(x, k).reshape(shape) for k in range(len(self.channels))]
        return found[0] if len(found) == 1 else np.array(found)

    @cached_property
    def label(self) -> dict[str, Any]:
        """All that is known of the formula, as plain data."""
        grid = self.grid
        axes = [
            {"name": n, "low": min(e), "high": max(e), "even_in": w}
            for n, e, w in zip(grid.names, grid.ends, grid.warps, strict=True)
        ]
        channels = [
            {
                "name": name,
                "numerator": self.numerators[k].tolist(),
                "denominator": self.denominators[k].tolist(),
                "errors": asdict(self.errors[k]),
            }
            for k, name in enumerate(self.channels)
        ]
        return strict(
            {
                "format": f"albedo {self.form} 1",
                **self.about,
                "axes": axes,
                "powers": self.powers.tolist(),
                "channels": channels,
            }
        )

    def functions(self) -> list[code.Function]:
        """The formula of each channel in the words that languages share."""
        inputs = tuple(f"real {own}" for own in code.arguments(self.grid))
        lines = code.unit_coordinates(self.grid)
        found = []
        for name, top, bottom in zip(
            self.channels, self.numerators, self.denominators, strict=True
        ):
            own = [*lines, f"real p = {_nested(self.powers, top)}"]
            result = "p"
            if self.form == "rational":
                own.append(f"real q = {_nested(self.powers, bottom)}")
                result = "p / q"
            suffix = name if len(self.channels) > 1 else ""
            found.append(code.Function("real", suffix, inputs, tuple(own), result))
        return found

    @cached_property
    def float32_adds(self) -> float:
        """What float32 arithmetic adds to the error: the most at many places."""
        rng = np.random.default_rng(_SEED)
        x = self.grid.at(rng.uniform(size=(len(self.grid.names), _PLACES))).astype(np.float32)
        most = 0.0
        for k, own in enumerate(self.functions()):
            found = code.in_float32([code.ACOS, replace(own, name="main")], x)
            ends = np.sort(np.array(self.grid.ends), axis=1)
            exact = self.read(np.clip(x.astype(np.float64), ends[:, :1], ends[:, 1:]), k)
            most = max(most, float(np.abs(found - exact).max()))
        return most

    def __str__(self) -> str:
        axes = ", ".join(
            f"{n} ({w})" for n, w in zip(self.grid.names, self.grid.warps, strict=True)
        )
        lines = [
            f"{self.about['title']}: {self.form} of degree {self.degree} in {axes}, "
            f"{self.coefficients} coefficients"
        ]
        for name, e in zip(self.channels, self.errors, strict=True):
            where = ", ".join(f"{key} = {value:.4g}" for key, value in e.where.items())
            lines.append(
                f"{name}: errs by {e.largest:.3g} at most, at {where}; rms {e.rms:.3g}, relative "
                f"{e.relative:.3g}; {e.verified:.3g} at {e.places} fresh places"
            )
        return "\n".join(lines)


def _units(grid: Grid, x: np.ndarray) -> np.ndarray:
    return np.clip(2.0 * grid.share_of(x) - 1.0, -1.0, 1.0)


def _quotient(
    grid: Grid, powers: np.ndarray, top: np.ndarray, bottom: np.ndarray, x: np.ndarray
) -> np.ndarray:
    """A formula at coordinates, by Horner's rule in one coordinate after the other."""
    u = _units(grid, x)
    below = _horner(powers, bottom, u) if np.any(bottom[1:]) else bottom[0]
    return _horner(powers, top, u) / below


def _horner(powers: np.ndarray, coefficients: np.ndarray, u: np.ndarray) -> Any:
    if u.shape[0] == 0:
        return float(coefficients.sum())
    total: Any = 0.0
    for power in range(int(powers[:, 0].max(initial=0)), -1, -1):
        own = powers[:, 0] == power
        total = total * u[0] + _horner(powers[own][:, 1:], coefficients[own], u[1:])
    return total


def _nested(powers: np.ndarray, coefficients: np.ndarray, axis: int = 0) -> str:
    """The same as an expression."""
    if powers.shape[1] == 0:
        return code.number(float(coefficients.sum()))
    text = ""
    for power in range(int(powers[:, 0].max(initial=0)), -1, -1):
        own = powers[:, 0] == power
        inner = _nested(powers[own][:, 1:], coefficients[own], axis + 1)
        if not text:
            text = inner
            continue
        # What is added to nothing needs no brackets.
        text = f"({text}) * u_{axis} + {inner}" if " " in text else f"{text} * u_{axis} + {inner}"
    return f"({text})" if axis and " " in text else text


def fit(
    model: Model | str,
    ranges: Mapping[str, tuple[float, float]] | None = None,
    error: float = 1e-3,
    *,
    form: str = "rational",
    metric: str = "max",
    quantity: str = "albedo",
    cosines: tuple[float, float] = (0.0, 1.0),
    warps: Mapping[str, str] | None = None,
    fixed: str = "light",
    progress: Callable[[str], None] | None = None,
) -> Fit:
    """Fit a formula to what a table would hold.

    Parameters
    ----------
    model, ranges, quantity, cosines, warps, fixed, progress
        As of `albedo.design`.
    error : float
        What the formula may err by, in [1e-7, 0.5]; that with the fewest coefficients is sought.
    form : {"polynomial", "rational"}
        A quotient of two polynomials needs fewer coefficients, and a division.
    metric : {"max", "relative"}
        Of which error.

    Returns
    -------
    Fit
        With its errors, measured.

    Raises
    ------
    InputError
        For input out of range, and where no degree that is tried meets the error.

    Examples
    --------
    >>> import albedo
    >>> formula = albedo.fit("phong:n=1..100/2", error=1e-2)
    >>> bool(formula.worst <= 1e-2)
    True
    """
    model, varied = subject_of(model, ranges, "fit")
    if form not in FORMS:
        raise InputError(f"form = {form!r} is unknown; choose one of {', '.join(FORMS)}")
    if metric not in ("max", "relative"):
        raise InputError(f"metric = {metric!r} is unknown; choose one of max, relative")
    what = quantity_of(quantity)
    coordinates = coordinates_of(model, varied, what, cosines)
    wish = Wish(error, metric, warps=warps)
    wish.check(len(coordinates))
    search = Search(model, what, coordinates, wish, fixed, progress or (lambda words: None))
    return _Fitting(search, form).found()


@dataclass(eq=False)
class _Fitting:
    """The search for one formula."""

    search: Search
    form: str

    def found(self) -> Fit:
        """The formula of the lowest degree that meets the error."""
        search = self.search
        axes = len(search.coordinates)
        cloud = search.cloud
        step = max(1, cloud.shape[1] // _FITTED)
        # Shuffled: a regular step through a mesh would leave out whole lines.
        kept = np.sort(np.random.default_rng(_SEED).permutation(cloud.shape[1])[::step])
        x = cloud[:, kept]
        values = [known[kept] for known in search.known]
        search.say("axes")
        trial = _powers(axes, _TRIAL[axes])
        choices = []
        for warps in self._combinations():
            grid = self._grid(warps)
            u = _units(grid, x)
            worst = max(self._fitted(trial, u, v, rounds=3)[2] for v in values)
            choices.append((worst, warps))
        best = [warps for _, warps in sorted(choices, key=lambda pair: pair[0])[:_BEST]]
        search.say("degree")
        nearest = math.inf
        for degree in DEGREES[axes]:
            powers = _powers(axes, degree)
            for warps in best:
                grid = self._grid(warps)
                u = _units(grid, x)
                own = [self._fitted(powers, u, v, rounds=_ROUNDS) for v in values]
                if max(worst for _, _, worst in own) > search.goal:
                    nearest = min(nearest, max(worst for _, _, worst in own))
                    continue
                made = self._measured(grid, powers, own)
                nearest = min(nearest, made.worst)
                if made.worst <= search.goal:
                    return made
        raise InputError(
            f"no {self.form} of degree up to {max(DEGREES[axes])} meets {search.goal:g}; the best "
            f"errs by {nearest:.2g}"
        )

    def _grid(self, warps: tuple[str, ...]) -> Grid:
        coordinates = self.search.coordinates
        names = tuple(c.name for c in coordinates)
        ends = tuple((c.low, c.high) for c in coordinates)
        return Grid(names, ends, warps, (_CELLS[len(names)] + 1,) * len(names))

    def _combinations(self) -> list[tuple[str, ...]]:
        # Formulas bend by themselves: a few numbers of the rational family are enough.
        found = list(self.search.combinations())
        few = [w for w in found if all(_few(text) for text in w)]
        return few or found

    def _fitted(
        self, powers: np.ndarray, u: np.ndarray, values: np.ndarray, rounds: int
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """Coefficients of powers, above and below, and the largest error."""
        basis = _basis(powers, u)
        scale = 1.0 / np.maximum(np.abs(values), 1e-300) if self.search.relative else 1.0
        weight, below = np.ones(values.size), np.ones(values.size)
        best: tuple[float, np.ndarray, np.ndarray] = (math.inf, np.zeros(0), np.zeros(0))
        columns = basis
        if self.form == "rational":
            columns = np.concatenate((basis, -values[:, None] * basis[:, 1:]), axis=1)
        for _ in range(rounds):
            factor = np.sqrt(weight) * scale / below
            solved = np.linalg.lstsq(columns * factor[:, None], values * factor, rcond=1e-14)[0]
            top = solved[: len(powers)]
            bottom = np.zeros(len(powers))
            bottom[0] = 1.0
            bottom[1:] = solved[len(powers) :] if self.form == "rational" else 0.0
            below = basis @ bottom
            if not np.all(below > 1e-3 * np.abs(below).max()):
                # A pole next to the domain: what was found before stands.
                break
            off = np.abs(basis @ top / below - values) * scale
            worst = float(off.max())
            if worst < best[0]:
                best = worst, top, bottom
            weight *= off / max(worst, 1e-300) + 1e-3
            weight /= weight.mean()
        if not math.isfinite(best[0]) and columns is not basis:
            # What is a polynomial already leaves its denominator to chance.
            factor = np.full(values.size, scale)
            top = np.linalg.lstsq(basis * factor[:, None], values * factor, rcond=1e-14)[0]
            worst = float((np.abs(basis @ top - values) * scale).max())
            best = worst, top, np.eye(1, len(powers))[0]
        if not math.isfinite(best[0]):
            return np.zeros(len(powers)), np.eye(1, len(powers))[0], math.inf
        return _monomials(powers, best[1]), _monomials(powers, best[2]), best[0]

    def _measured(
        self, grid: Grid, powers: np.ndarray, own: list[tuple[np.ndarray, np.ndarray, float]]
    ) -> Fit:
        """A formula with its errors."""
        search = self.search
        search.say("errors")
        errors = []
        for (top, bottom, _), reference, function in zip(
            own, search.references, search.functions, strict=True
        ):

            def read(x: np.ndarray, top: np.ndarray = top, bottom: np.ndarray = bottom) -> Any:
                return _quotient(grid, powers, top, bottom, x)

            errors.append(measure(grid, read, reference, function))
        how: dict[str, Any] = {"metric": search.wish.metric, "asked": search.wish.error}
        return Fit(
            self.form,
            grid,
            powers,
            search.quantity.channels,
            tuple(top for top, _, _ in own),
            tuple(bottom for _, bottom, _ in own),
            tuple(errors),
            about_of(search.model, search.quantity, grid, fixed=search.fixed, **how),
        )


def _few(text: str) -> bool:
    own = Warp.parse(text)
    return own.kind != "rational" or 0.05 <= own.k <= 2.0


def _powers(axes: int, degree: int) -> np.ndarray:
    """Powers of up to a degree in all, the constant first."""
    found = [p for p in itertools.product(range(degree + 1), repeat=axes) if sum(p) <= degree]
    return np.array(sorted(found, key=sum))


def _basis(powers: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Products of Chebyshev's polynomials at places, shape (n, terms)."""
    lines = [chebyshev.chebvander(own, int(powers.max())) for own in u]
    found = np.ones((u.shape[1], len(powers)))
    for axis, line in enumerate(lines):
        found *= line[:, powers[:, axis]]
    return found


def _monomials(powers: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Coefficients of powers, of those of products of Chebyshev's polynomials."""
    axes, top = powers.shape[1], int(powers.max())
    tensor = np.zeros((top + 1,) * axes)
    tensor[tuple(powers.T)] = coefficients
    matrix = np.zeros((top + 1, top + 1))
    for k in range(top + 1):
        own = chebyshev.cheb2poly(np.eye(top + 1)[k])
        matrix[: len(own), k] = own
    for axis in range(axes):
        tensor = np.moveaxis(np.tensordot(matrix, tensor, axes=(1, axis)), 0, axis)
    return tensor[tuple(powers.T)]


_SHADER = code.Dialect(
    head="{kind} {name}({inputs})\n{{",
    let="    {kind} {name} = {value};",
    back="    return {value};",
    tail="}",
    kinds={"real": "float"},
    words={"real": "float", "acos": "$acos"},
)
_JAVASCRIPT = code.Dialect(
    head="export function {name}({inputs}) {{",
    let="  const {name} = {value};",
    back="  return {value};",
    tail="}",
    argument="{name}",
    words={"clamp": "$clamp"} | {name: f"Math.{name}" for name in ("sqrt", "acos", "log")},
)
_PYTHON = code.Dialect(
    head="def {name}({inputs}):",
    let="    {name} = {value}",
    back="    return {value}",
    tail="",
    argument="{name}",
    words={"clamp": "np.clip", "acos": "np.arccos", "sqrt": "np.sqrt", "log": "np.log"},
)
# How each language is spelt, what stands before its functions, and what these need.
_LANGUAGES: dict[str, tuple[code.Dialect, str, tuple[code.Function, ...]]] = {
    ".h": (C, "#include <math.h>", (code.CLAMP,)),
    ".glsl": (_SHADER, "", (code.ACOS,)),
    ".hlsl": (_SHADER, "", (code.ACOS,)),
    ".osl": (_SHADER, "", (code.ACOS,)),
    ".js": (_JAVASCRIPT, "", (code.CLAMP,)),
    ".py": (_PYTHON, "import numpy as np", ()),
}
FIT_SUFFIXES = (*_LANGUAGES, ".json")
"""What a formula is written as."""


def save_fit(formula: Fit, path: str | os.PathLike[str]) -> Path:
    """Write a formula as code, or as JSON.

    Parameters
    ----------
    formula : Fit
    path : path
        Ends in one of `FIT_SUFFIXES`: C, GLSL, HLSL, OSL, JavaScript, Python or JSON.

    Returns
    -------
    Path
        The file.
    """
    target = check_output(path, FIT_SUFFIXES)
    suffix = target.suffix.lower()
    with atomic_file(target) as temporary:
        if suffix == ".json":
            temporary.write_text(json.dumps(formula.label) + "\n", encoding="utf-8")
        else:
            temporary.write_text(as_code(formula, suffix), encoding="ascii", newline="\n")
    return target


def as_code(formula: Fit, suffix: str) -> str:
    """A formula as the text of a file with this ending."""
    dialect, before, needed = _LANGUAGES[suffix]
    dialect = replace(dialect, prefix=code.stem(formula) + f"_{formula.form}")
    label = {key: value for key, value in formula.label.items() if key != "channels"}
    told = [
        f"{formula.about['title']}, a {formula.form} of degree {formula.degree} by "
        f"{formula.about['source']}.",
        f"It gives {formula.about['meaning']}, for {formula.about['model']}.",
        *(
            f"{name} errs by {code.up(e.largest)} at most, against the model."
            for name, e in zip(formula.channels, formula.errors, strict=True)
        ),
        f"float32 arithmetic adds up to {code.up(2.0 * formula.float32_adds, 2)}: twice the most "
        "that was measured.",
        f"label: {json.dumps(strict(label))}",
    ]
    functions = [own for own in needed if own.name != "acos" or "acos(" in str(formula.functions())]
    mark = "#" if suffix == ".py" else "//"
    parts = [
        code.comment(*told).replace("//", mark, 1).replace("\n//", f"\n{mark}"),
        *([before] if before else []),
        *(dialect.function(own) for own in (*functions, *formula.functions())),
    ]
    if suffix == ".h":
        guard = dialect.name("H").upper()
        parts[1:] = [f"#ifndef {guard}\n#define {guard}", *parts[1:], "#endif"]
    return "\n\n".join(parts) + "\n"
