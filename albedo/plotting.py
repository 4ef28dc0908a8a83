"""Figures of albedo curves: one style, on paper and on screen, without any global state.

A figure made here is a plain `matplotlib.figure.Figure`; pyplot is never imported, so a figure
lives and dies with its variable and nothing needs a display.
"""

from __future__ import annotations

import io
import os
import re
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from albedo.errors import InputError
from albedo.files import atomic_file, check_output, save_text
from albedo.grammar import Spec, cos_degrees

if TYPE_CHECKING:
    import numpy as np
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogFormatterSciNotation

    from albedo.estimate import Estimate

__all__ = [
    "SUFFIXES",
    "Curve",
    "angle_grid",
    "color",
    "draw",
    "draw_radiance",
    "error_maps",
    "grazing_grid",
    "measure",
    "new_figure",
    "save_figure",
    "style",
    "view_grid",
]

SUFFIXES = (".png", ".svg", ".pdf")

# Okabe and Ito's colours, then Tol's muted ones: both are told apart with any colour vision.
_BLUE, _VERMILION, _GREEN, _PURPLE = "#0072B2", "#D55E00", "#009E73", "#AA4499"
_ORANGE, _SKY, _BLACK, _ROSE = "#E69F00", "#56B4E9", "#222222", "#CC6677"
_INDIGO, _OLIVE, _WINE, _TEAL = "#332288", "#999933", "#882255", "#44AA99"
_PALETTE = (
    _BLUE, _VERMILION, _GREEN, _PURPLE, _ORANGE, _SKY, _ROSE, _INDIGO, _OLIVE, _WINE, _TEAL,
)  # fmt: skip

# Models that are often drawn together get hues that are far apart, the same in every figure.
_COLORS = {
    "lambert": _OLIVE,
    "phong": _BLUE,
    "phong_original": _INDIGO,
    "max_phong": _SKY,
    "blinn": _PURPLE,
    "blinn_original": _WINE,
    "he_torrance": _BLACK,
    "cook_torrance": _VERMILION,
    "ward": _GREEN,
    "ward_duer": _TEAL,
    "ward_bounded": _ROSE,
    "ashikhmin_shirley": _ORANGE,
}

# Line styles carry the difference where colour does not (print, colour vision, overlap).
_DASHES: tuple[Any, ...] = (
    "-",
    (0, (6, 2)),
    (0, (1.2, 1.4)),
    (0, (6, 1.6, 1.2, 1.6)),
    (0, (3, 1.6)),
    (0, (6, 1.4, 1.2, 1.4, 1.2, 1.4)),
    (0, (10, 2)),
    (0, (3, 1.4, 1.2, 1.4, 1.2, 1.4)),
)

_STYLE: Any = {
    "axes.edgecolor": "#555555",
    "axes.grid": True,
    "axes.labelsize": 10.5,
    "axes.linewidth": 0.8,
    "axes.axisbelow": True,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlesize": 10.5,
    "figure.facecolor": "white",
    "font.family": "DejaVu Sans",
    "font.size": 9.5,
    "grid.color": "#e3e3e3",
    "grid.linewidth": 0.7,
    "legend.fontsize": 9.5,
    "legend.frameon": False,
    "lines.linewidth": 1.7,
    "lines.solid_capstyle": "round",
    "mathtext.fontset": "dejavusans",
    "path.simplify": False,
    "savefig.dpi": 200,
    # Without a salt, the identifiers inside an SVG differ from run to run.
    "svg.hashsalt": "albedo",
    "xtick.labelsize": 9.5,
    "ytick.labelsize": 9.5,
}

# Dots of an inch in pictures for a site: twice those of a screen, and of pictures inside an SVG.
_SCREEN = 192
_INSIDE = 120

# More curves than this in one legend cannot be told apart: a sweep then gets a colour scale.
_MOST_NAMED = 8
# So many shades of one colour are told apart.
_MOST_SHADES = 3


@dataclass(frozen=True)
class Curve:
    """Albedo against the angle of incidence, with its error bounds.

    Attributes
    ----------
    label : str
        What the legend says.
    name : str
        Name of the model, which fixes the colour.
    cos_theta, value, error : ndarray
        Cosines of the angle of incidence, albedos and their error bounds.
    swept : tuple of (str, float) or None
        The swept parameter and its value, where one number alone tells the curves apart.
    kind : {"bound", "standard_error"}
        What the errors are.
    """

    label: str
    name: str
    cos_theta: np.ndarray
    value: np.ndarray
    error: np.ndarray
    swept: tuple[str, float] | None = None
    kind: str = "bound"


@contextmanager
def style() -> Iterator[None]:
    """Set the look of every artist that is created or saved inside the block, and only there."""
    import matplotlib

    with matplotlib.rc_context(_STYLE):
        yield


def color(name: str) -> str:
    """Colour of a model: the same in every figure.

    Parameters
    ----------
    name : str
        Name of the model.

    Returns
    -------
    str
        A hexadecimal colour.
    """
    return _COLORS.get(name, _PALETTE[zlib.crc32(name.encode()) % len(_PALETTE)])


def new_figure(
    columns: int = 1, width: float = 6.5, height: float = 3.8
) -> tuple[Figure, list[Axes]]:
    """Make an empty figure, to be used inside `style`.

    Parameters
    ----------
    columns : int
        Number of panels side by side.
    width, height : float
        Size in inches.

    Returns
    -------
    figure : Figure
        The figure.
    axes : list of Axes
        Its panels.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    panels = [figure.add_subplot(1, columns, index + 1) for index in range(columns)]
    return figure, panels


def save_figure(figure: Figure, path: str | os.PathLike[str]) -> Path:
    """Write a figure as PNG, SVG or PDF; the same figure gives the same bytes.

    Parameters
    ----------
    figure : Figure
        The figure.
    path : path
        File that ends in ``.png``, ``.svg`` or ``.pdf``.

    Returns
    -------
    Path
        The file.
    """
    target = check_output(path, SUFFIXES)
    kind = target.suffix.lower()[1:]
    with style(), atomic_file(target) as temporary:
        _plain_powers(figure)
        figure.savefig(temporary, format=kind, metadata=dict.fromkeys(_UNSET[kind]))
    return target


# Dates and tool versions would make equal figures differ in their bytes.
_UNSET: dict[str, tuple[str, ...]] = {
    "png": ("Software",),
    "svg": ("Date", "Creator"),
    "pdf": ("CreationDate", "Creator", "Producer"),
}


def save_for_site(figure: Figure, stem: Path, small: bool = True) -> None:
    """Write a figure as PNG and compact SVG; everything is placed once for both.

    Parameters
    ----------
    figure : Figure
        The figure, finished: its layout is fixed.
    stem : Path
        Where, without an ending.
    small : bool
        Take the time to make the PNG small.
    """
    import numpy as np
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    from albedo.compact import compact_svg, write_png

    # Points that no eye would miss: a tenth of a dot beside the line at most. Text that a reader
    # can search and a screen reader can read, in place of drawn letters.
    look: Any = {
        "path.simplify": True,
        "path.simplify_threshold": 0.1,
        "svg.fonttype": "none",
    }
    with style(), rc_context(look):
        _plain_powers(figure)
        if (engine := figure.get_layout_engine()) is not None:
            engine.execute(figure)
            figure.set_layout_engine("none")
        drawn = io.StringIO()
        # What is no line in an SVG is a picture of as many dots as a screen shows. `savefig` would
        # draw all twice, to find its layout.
        figure.set_dpi(_INSIDE)
        FigureCanvasSVG(figure).print_svg(drawn, metadata=dict.fromkeys(_UNSET["svg"]))
        save_text(compact_svg(drawn.getvalue()), stem.with_name(f"{stem.name}.svg"))
        figure.set_dpi(_SCREEN)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        with atomic_file(stem.with_name(f"{stem.name}.png")) as temporary:
            write_png(np.asarray(canvas.buffer_rgba()), temporary, _SCREEN, small)


def _plain_powers(figure: Figure) -> None:
    """Write powers of ten on logarithmic axes as text: a parser of formulas is slow."""
    from matplotlib.ticker import LogFormatterSciNotation

    powers = _powers()
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            major, minor = axis.get_major_formatter(), axis.get_minor_formatter()
            if type(major) is LogFormatterSciNotation:
                axis.set_major_formatter(powers(labelOnlyBase=major.labelOnlyBase))
            if type(minor) is LogFormatterSciNotation:
                axis.set_minor_formatter(powers(labelOnlyBase=minor.labelOnlyBase))


@cache
def _powers() -> type[LogFormatterSciNotation]:
    """The class of what writes them; matplotlib is loaded when it is needed."""
    from matplotlib.ticker import LogFormatterSciNotation

    raised = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
    power = re.compile(r"\$\\mathdefault\{(-?)(?:(\d+)\\times)?(\d+)\^\{(-?\d+)\}\}\$")

    class Powers(LogFormatterSciNotation):
        """10⁻² in place of a formula that says so."""

        def __call__(self, x: float, pos: int | None = None) -> str:
            text = str(super().__call__(x, pos))
            found = power.fullmatch(text)
            if not found:
                return text
            sign, factor, base, exponent = found.groups()
            return f"{sign}{f'{factor} × ' if factor else ''}{base}{exponent.translate(raised)}"

    return Powers


def angle_grid() -> np.ndarray:
    """Cosines for a linear angle axis: 0 to 89.9 degrees, denser in the last five.

    Returns
    -------
    ndarray
        Descending cosines.
    """
    degrees = [float(step) for step in range(85)] + [85.0 + step / 10 for step in range(50)]
    import numpy as np

    return np.array([cos_degrees(theta) for theta in degrees])


def grazing_grid(min_cos: float = 1e-6, per_decade: int = 24) -> np.ndarray:
    """Cosines for a logarithmic axis, from 1 down.

    Parameters
    ----------
    min_cos : float
        Smallest cosine, above 0 and below 1.
    per_decade : int
        Points in each factor of ten.

    Returns
    -------
    ndarray
        Descending cosines.
    """
    import numpy as np

    if not 1e-300 <= min_cos < 1.0:
        raise InputError(
            f"The smallest cosine of a grazing axis is {min_cos:g}; it must be within 1e-300 and 1."
        )
    count = 1 + max(2, round(per_decade * -np.log10(min_cos)))
    return np.geomspace(1.0, min_cos, count)


def measure(
    specs: Sequence[Spec],
    cos_theta: np.ndarray,
    *,
    phi: float = 0.0,
    rtol: float = 1e-6,
    find: Callable[..., Estimate] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Curve]:
    """Compute one curve for every model that the specs name.

    Parameters
    ----------
    specs : sequence of ModelSpec or SumSpec
        Models and sums, sweeps included.
    cos_theta : ndarray
        Cosines of the angles of incidence.
    phi : float
        Azimuth of the incident direction, radians.
    rtol : float
        Relative tolerance.
    find : callable, optional
        What computes the albedos of a model: ``find(model, cos_theta, phi=phi)``; quadrature to
        `rtol` unless given.
    progress : callable, optional
        Called with the number of curves done and of all.

    Returns
    -------
    list of Curve
        The curves, in the order of the specs.
    """
    import numpy as np

    import albedo

    if find is None:
        find = partial(albedo.directional_albedo, rtol=rtol)
    total = sum(spec.count for spec in specs)
    curves: list[Curve] = []
    done = 0
    for spec in specs:
        singles: Iterator[Spec] = spec.singles()
        for values, single in zip(spec.assignments(), singles, strict=True):
            model = single.model()
            numbers = [(key, value) for key, value in values.items() if isinstance(value, float)]
            label = str(single)
            for channel, kind in enumerate(model.by_channel()):
                estimate = find(kind, cos_theta, phi=phi)
                curves.append(
                    Curve(
                        label=label if kind is model else f"{label}, channel {channel}",
                        name=spec.name,
                        cos_theta=cos_theta,
                        value=np.asarray(estimate.value),
                        error=np.asarray(estimate.error),
                        swept=numbers[0] if len(values) == 1 and numbers else None,
                        kind=estimate.kind,
                    )
                )
            done += 1
            if progress is not None:
                progress(done, total)
    return curves


def draw(curves: Sequence[Curve], *, grazing: bool = False, phi: float | None = None) -> Figure:
    """Draw albedo curves in one figure.

    Parameters
    ----------
    curves : sequence of Curve
        What `measure` gives; different models and sweeps may be mixed.
    grazing : bool
        Use a logarithmic axis in the cosine of the angle, which shows what happens at grazing
        incidence; otherwise a linear axis in degrees.
    phi : float, optional
        Azimuth in radians, to be named on the axis.

    Returns
    -------
    Figure
        The figure.
    """
    with style():
        figure, (axes,) = new_figure()
        draw_axes(axes, curves, grazing=grazing, phi=phi)
        _add_key(figure, axes, curves)
    return figure


def draw_axes(
    axes: Axes, curves: Sequence[Curve], *, grazing: bool = False, phi: float | None = None
) -> None:
    """Draw albedo curves into a panel of one's own figure, without a legend.

    Parameters
    ----------
    axes : Axes
        The panel.
    curves : sequence of Curve
        The curves.
    grazing : bool
        Logarithmic axis in the cosine instead of a linear one in degrees.
    phi : float, optional
        Azimuth in radians, to be named on the axis.
    """
    import numpy as np

    scale = _scale(curves)
    low, high = _extent(curves)
    log = _wants_log(low, high, grazing)
    span = high - low
    for number, curve in enumerate(curves):
        x = curve.cos_theta if grazing else np.degrees(np.arccos(curve.cos_theta))
        look = _look(number, curve, curves, scale)
        finite = np.isfinite(curve.value)
        axes.plot(x[finite], curve.value[finite], label=curve.label, **look)
        lower = curve.value - curve.error
        upper = curve.value + curve.error
        seen = upper / np.maximum(lower, 1e-300) > 1.01 if log else curve.error > 2e-3 * span
        if np.any(seen & finite & np.isfinite(curve.error)):
            floor = low / 10 if log else -np.inf
            axes.fill_between(
                x, np.maximum(lower, floor), upper, color=look["color"], alpha=0.22, linewidth=0
            )
    axes.axhline(1.0, color="#888888", linewidth=0.9, zorder=1.5)
    where = "" if phi is None else f", azimuth {np.degrees(phi):g}°"
    if grazing:
        axes.set_xscale("log")
        axes.set_xlim(max(float(c.cos_theta.max()) for c in curves), _smallest(curves))
        axes.set_xlabel(f"cosine of the angle of incidence (grazing to the right{where})")
    else:
        axes.set_xlim(0.0, 90.0)
        axes.set_xticks(np.arange(0.0, 91.0, 15.0))
        axes.set_xlabel(f"angle of incidence (degrees{where})")
    noisy = any(curve.kind == "standard_error" for curve in curves)
    axes.set_ylabel("directional albedo" + (" ± standard error" if noisy else ""))
    if log:
        axes.set_yscale("log")
        axes.set_ylim(low / 1.3, max(high, 1.0) * 1.3)
    else:
        axes.set_ylim(min(0.0, 1.05 * low), 1.05 * max(high, 1.0))


def view_grid(theta_deg: float) -> np.ndarray:
    """Angles of views in a plane through the normal: even ones, and more about a direction.

    Parameters
    ----------
    theta_deg : float
        The direction in degrees.

    Returns
    -------
    ndarray
        Ascending angles to the normal in radians, between -pi/2 and pi/2.
    """
    import numpy as np

    near = theta_deg + np.outer((-1.0, 1.0), np.geomspace(1e-4, 20.0, 120)).ravel()
    angles = np.concatenate((np.arange(-89.5, 90.0, 0.5), near, [theta_deg]))
    inside = np.unique(angles[np.abs(angles) < 89.999])
    found: np.ndarray = np.radians(inside)
    return found


def draw_radiance(profiles: Sequence[tuple[str, np.ndarray, Estimate]], title: str) -> Figure:
    """Draw output radiances in the plane of incidence.

    Parameters
    ----------
    profiles : sequence of (str, ndarray, Estimate)
        For each curve its label, angles of views in radians, and what
        `albedo.analysis.radiance.plane_radiance` gives there.
    title : str
        What it is of.

    Returns
    -------
    Figure
        The figure; its axis of radiances is logarithmic where the curves differ by much.
    """
    import numpy as np

    tops = [float(found.value.max()) for _, _, found in profiles]
    with style():
        figure, (axes,) = new_figure()
        for number, (label, view, found) in enumerate(profiles):
            axes.plot(
                *(np.degrees(view), found.value),
                color=_PALETTE[number % len(_PALETTE)],
                linestyle=_DASHES[number % len(_DASHES)],
                label=label,
            )
        if max(tops) > 20.0 * max(min(tops), 1e-300):
            axes.set_yscale("log")
            axes.set_ylim(max(min(tops), 1e-12 * max(tops)) / 100.0, 2.0 * max(tops))
        else:
            axes.set_ylim(0.0, 1.05 * max(tops))
        axes.set_title(title, loc="left")
        axes.set_xlim(-90.0, 90.0)
        axes.set_xticks(np.arange(-90.0, 91.0, 30.0))
        axes.set_xlabel("angle of the view in the plane of incidence (degrees)")
        axes.set_ylabel("output radiance (1/sr)")
        add_legend(figure, axes)
    return figure


def error_maps(
    maps: Sequence[np.ndarray],
    titles: Sequence[str],
    rows: str,
    columns: str,
    path: str | os.PathLike[str],
) -> Path:
    """Draw errors over the texels of a table, two maps in a row, and save them.

    Parameters
    ----------
    maps : sequence of ndarray
        Errors over rows and columns, or over columns alone.
    titles : sequence of str
        One for each.
    rows, columns : str
        What the axes are; without rows, errors are drawn as lines.
    path : path
        Where; its ending says the format.

    Returns
    -------
    Path
        The file.
    """
    import numpy as np
    from matplotlib.colors import LogNorm, Normalize
    from matplotlib.ticker import MaxNLocator

    down = -(-len(maps) // 2)
    with style():
        figure, _ = new_figure(0, 9.0, 3.6 * down)
        grid = figure.subplots(down, 2, squeeze=False)
        for axes, own, title in zip(grid.ravel(), maps, titles, strict=True):
            axes.set_title(title, fontsize="medium")
            axes.set_xlabel(f"column ({columns})")
            if own.ndim == 1:
                axes.plot(np.arange(own.size), own, color=_BLUE, marker="o", markersize=3)
                axes.set_ylabel("error")
                axes.axhline(0.0, color="0.6", linewidth=0.8)
                continue
            signed = bool((own < 0.0).any())
            top = float(np.abs(own).max()) or 1.0
            # Both are told apart with any colour vision; only one of them knows a sign.
            least = float(own[own > 0.0].min(initial=top))
            image = axes.imshow(
                own,
                cmap="RdBu_r" if signed else "viridis",
                norm=Normalize(-top, top) if signed else LogNorm(max(least, 1e-5 * top), top),
                origin="lower",
                aspect="auto",
            )
            for axis in (axes.xaxis, axes.yaxis):
                axis.set_major_locator(MaxNLocator(6, integer=True))
            axes.set_ylabel(f"row ({rows})")
            axes.grid(False)
            figure.colorbar(image, ax=axes, label="error")
        return save_figure(figure, path)


def add_legend(
    figure: Figure, axes: Axes, extra: Sequence[Any] = (), columns: int | None = None
) -> None:
    """Put a legend below the panels, where it covers no data.

    Parameters
    ----------
    figure : Figure
        The figure.
    axes : Axes
        The panel whose labelled lines are listed.
    extra : sequence of artists
        Further labelled artists.
    columns : int, optional
        How many stand side by side; as many as fit unless given.
    """
    handles = [*axes.get_legend_handles_labels()[0], *extra]
    longest = max((len(str(handle.get_label())) for handle in handles), default=0)
    # A character of the legend is about 0.072 inches wide; its line and its gaps take 0.65.
    fitting = int(figure.get_figwidth() / (0.072 * longest + 0.65))
    columns = max(1, min(fitting, len(handles))) if columns is None else columns
    # The room for the legend is added below: the panels keep their size.
    figure.set_figheight(figure.get_figheight() + 0.21 * -(-len(handles) // columns))
    figure.legend(
        handles=handles,
        loc="outside lower center",
        ncols=columns,
        handlelength=3.2,
        columnspacing=1.4,
    )


def _add_key(figure: Figure, axes: Axes, curves: Sequence[Curve]) -> None:
    scale = _scale(curves)
    if scale is None:
        if len(curves) > 3 * _MOST_NAMED:
            # Too many to name and no number that orders them: the table has the names.
            axes.set_title(f"{len(curves)} models", loc="left")
            return
        add_legend(figure, axes)
        return
    from matplotlib.cm import ScalarMappable

    parameter = curves[0].swept
    assert parameter is not None
    bar = figure.colorbar(ScalarMappable(norm=scale[0], cmap=scale[1]), ax=axes, pad=0.02)
    bar.set_label(f"{curves[0].name}: {parameter[0]}")
    bar.outline.set_visible(False)


def _scale(curves: Sequence[Curve]) -> tuple[Any, Any] | None:
    """Colour scale for one long sweep over a number; None where the curves are named."""
    if len(curves) <= _MOST_NAMED or any(curve.swept is None for curve in curves):
        return None
    swept = [curve.swept for curve in curves if curve.swept is not None]
    if len({(curve.name, item[0]) for curve, item in zip(curves, swept, strict=True)}) > 1:
        return None
    import numpy as np
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap, LogNorm, Normalize

    values = [item[1] for item in swept]
    low, high, middle = min(values), max(values), float(np.median(values))
    # Values that were spaced evenly in the logarithm have their median at the geometric mean.
    log = low > 0.0 and abs(np.log(middle**2 / (low * high))) < abs(
        np.log(2 * middle / (low + high))
    )
    norm = (LogNorm if log else Normalize)(low, high)
    # The yellow end of viridis is too pale for a line on white.
    return norm, ListedColormap(colormaps["viridis"](np.linspace(0.0, 0.88, 256)))


def _look(
    number: int, curve: Curve, curves: Sequence[Curve], scale: tuple[Any, Any] | None
) -> dict[str, Any]:
    if scale is not None and curve.swept is not None:
        norm, colors = scale
        return {"color": colors(norm(curve.swept[1])), "linestyle": "-", "linewidth": 1.2}
    from matplotlib.colors import to_rgb

    namesakes = [index for index, other in enumerate(curves) if other.name == curve.name]
    if curve.swept is not None and len(namesakes) > _MOST_SHADES:
        from matplotlib import colormaps

        place = namesakes.index(number)
        hue = colormaps["viridis"](0.86 * place / (len(namesakes) - 1))
        return {"color": hue, "linestyle": _DASHES[place % len(_DASHES)], "linewidth": 1.4}
    # Further curves of one model go towards white, but stay dark enough to be read.
    paler = 0.45 * namesakes.index(number) / max(len(namesakes) - 1, 1)
    shade = tuple(c + (1.0 - c) * paler for c in to_rgb(color(curve.name)))
    return {"color": shade, "linestyle": _DASHES[number % len(_DASHES)]}


def _extent(curves: Sequence[Curve]) -> tuple[float, float]:
    import numpy as np

    values = np.concatenate([curve.value[np.isfinite(curve.value)] for curve in curves])
    if values.size == 0:
        return 0.0, 1.0
    return float(values.min()), float(values.max())


def _wants_log(low: float, high: float, grazing: bool) -> bool:
    """Whether a linear axis would hide what the curves do."""
    if low <= 0.0:
        return False
    return high > 5.0 or (grazing and low < 0.05 * high)


def _smallest(curves: Sequence[Curve]) -> float:
    return min(float(curve.cos_theta[curve.cos_theta > 0.0].min()) for curve in curves)
