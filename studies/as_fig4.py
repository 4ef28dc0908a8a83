"""How dark does a glossy white half sphere become towards its edge in uniform light?

With R_s = 0.05 and R_d = 1 the diffuse term gives way to the specular one towards the edge, where
the Fresnel factor rises. The paper shows the half sphere and names the lowest values, about 74
percent near the edge. What is lowest depends on the exponent: within about 1/sqrt(n) of grazing
incidence half of the lobe lies below the horizon, however large n is. The half sphere is seen along
its axis, orthographically, so that its radius is the sine of the angle of incidence.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

import albedo
from albedo import fresnel, plotting
from albedo.estimate import format_value
from albedo.studies import Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from albedo.brdf import Model
    from albedo.studies import Context

STUDY = Study(
    name="as_fig4",
    title="A glossy half sphere in a furnace",
    paper="AS",
    figure="Figure 4",
    claims=("A7",),
)

R_S, R_D = 0.05, 1.0
PRINTED = 0.74
EXPONENTS = (10.0, 100.0, 1e3, 1e4, 1e6, 1e9)
SHOWN = (100.0, 1e4, 1e9)
# The largest exponent of the spheres in figure 2.
FINITE = 1e3
# Directions with a smaller cosine are the edge; all others are the inside.
EDGE = 0.02
# How far out a half sphere is near its edge, in radii.
NEAR = 0.9
# The radius of an image, in pixels.
RADIUS = 200
_COLORS = ("#999933", "#E69F00", "#D55E00", "#AA4499", "#56B4E9", "#0072B2")
_DASHES: tuple[Any, ...] = ((0, (1.2, 1.4)), (0, (3, 1.6)), (0, (6, 2)), (0, (6, 1.6, 1.2, 1.6)))


def run(context: Context) -> None:
    """Albedos against the angle, their minima against n, the half sphere, and both readings."""
    rtol = 1e-12 if context.full else 1e-10
    context.setting(rtol=rtol)
    cosines = np.unique(
        np.concatenate(
            (
                np.geomspace(1e-9 if context.full else 1e-6, 0.02, 121 if context.full else 41),
                np.linspace(0.02, 1.0, 197 if context.full else 99),
            )
        )
    )[::-1]
    curves = measure(cosines, rtol)
    context.table("curves", curves, "Total albedo against the angle of incidence")
    context.progress(1, 3, "minima")
    lows = minima(rtol)
    context.table(
        "minima",
        lows,
        "The lowest total albedo inside, that of the edge, and the lowest in an image; the last "
        "row is the limit for each angle",
        loose={"inside_at_deg": 0.02, "inside_at_radius": 1e-4},
    )
    found, again = thresholds(41), thresholds(57)
    # What the degree changes, and what a grid of cosines leaves.
    first, last = ((b, abs(a - b) + 1e-6 * b) for a, b in zip(found, again, strict=True))
    context.progress(2, 3, "figures")
    context.figure(
        "half_sphere",
        draw_spheres(rtol),
        f"The half sphere in light of radiance 1, R_s = {R_S:g}, R_d = {R_D:g}, grey linear in the "
        "radiance. Dashed: where the albedo is lowest inside, if it has a minimum there.",
    )
    context.figure(
        "curves_figure",
        draw_curves(curves, lows),
        "Total albedo along the radius, and towards the edge in the cosine. Points: minima inside. "
        "Black: the limit for each angle as n grows.",
    )
    judge(context, lows)
    note(context, lows, first, last)


def surface(n: float) -> Model:
    """The model of the figure."""
    return albedo.model("ashikhmin_shirley", n=n, r_s=R_S, r_d=R_D)


def limit(cosines: np.ndarray, rtol: float) -> tuple[np.ndarray, np.ndarray]:
    """The total albedo of a mirror under the same Fresnel factor, and the diffuse term."""
    diffuse = albedo.directional_albedo(surface(1.0).replace(specular="none"), cosines, rtol=rtol)
    mirror = fresnel.reflectance("schlick", cosines, f0=R_S)
    # Five products and a sum for the mirror.
    return mirror + diffuse.value, diffuse.error + 8.0 * float(np.finfo(float).eps) * mirror


def measure(cosines: np.ndarray, rtol: float) -> pd.DataFrame:
    """One row for every cosine, two columns for every exponent."""
    columns: dict[str, Any] = {
        "theta_deg": 90.0 - np.degrees(np.arcsin(cosines)),
        "radius": np.sqrt((1.0 - cosines) * (1.0 + cosines)),
        "cos_theta": cosines,
    }
    for n in EXPONENTS:
        found = albedo.directional_albedo(surface(n), cosines, rtol=rtol)
        columns[f"n={n:g}"] = found.value
        columns[f"n={n:g}_error"] = found.error
        if n == FINITE:
            columns["diffuse"] = found.parts["diffuse"].value
            columns["diffuse_error"] = found.parts["diffuse"].error
    columns["limit"], columns["limit_error"] = limit(cosines, rtol)
    return pd.DataFrame(columns)


def lowest_inside(n: float | None, rtol: float) -> tuple[float, float, float, float]:
    """The minimum inside: cosine, its bound, albedo, its bound; NaN where there is none.

    None is the limit of large exponents.
    """

    def at(c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if n is None:
            return limit(c, rtol)
        found = albedo.directional_albedo(surface(n), c, rtol=rtol)
        return found.value, found.error

    low, high, count = EDGE, 1.0, 161
    while True:
        c = np.linspace(low, high, count)
        value, error = at(c)
        k = int(np.argmin(value[1:-1])) + 1
        if not (value[k] < value[k - 1] and value[k] < value[k + 1]):
            # Beyond the last minimum the albedo may fall again, and lower.
            inner = np.flatnonzero((value[1:-1] < value[:-2]) & (value[1:-1] < value[2:])) + 1
            if not inner.size:
                return (math.nan,) * 4
            k = int(inner[np.argmin(value[inner])])
        if c[k + 1] - c[k] < 1e-4:
            # Where it is convex the minimum is no farther below than a neighbour is above.
            more = max(value[k - 1], value[k + 1]) - value[k]
            bound = float(error[k - 1 : k + 2].max() + more)
            return float(c[k]), float(c[k + 1] - c[k - 1]), float(value[k]), bound
        low, high, count = float(c[k - 1]), float(c[k + 1]), 21


def minima(rtol: float) -> pd.DataFrame:
    """The lowest albedo inside, anywhere, and at the centres of the pixels of an image."""
    # Centres of pixels along the radius, the first half a pixel from the edge.
    radius = (np.arange(RADIUS) + 0.5) / RADIUS
    pixels = np.sqrt((1.0 - radius) * (1.0 + radius))
    rows = []
    for n in EXPONENTS:
        c, width, value, error = lowest_inside(n, rtol)
        image = albedo.directional_albedo(surface(n), pixels, rtol=rtol)
        k = int(np.argmin(image.value))
        edge = albedo.directional_albedo(surface(n), 0.0, rtol=rtol)
        rows.append(
            {
                "n": n,
                "inside": value,
                "inside_error": error,
                "inside_at_cos": c,
                "inside_at_cos_error": width,
                "inside_at_deg": 90.0 - math.degrees(math.asin(c)),
                "inside_at_radius": math.sqrt((1.0 - c) * (1.0 + c)),
                "edge": float(edge.value),
                "edge_error": float(edge.error),
                "image": float(image.value[k]),
                "image_error": float(image.error[k]),
                "image_at_radius": radius[k],
            }
        )
    c, width, value, error = lowest_inside(None, rtol)
    rows.append(
        {
            "n": math.inf,
            "inside": value,
            "inside_error": error,
            "inside_at_cos": c,
            "inside_at_cos_error": width,
            "inside_at_deg": 90.0 - math.degrees(math.asin(c)),
            "inside_at_radius": math.sqrt((1.0 - c) * (1.0 + c)),
        }
    )
    return pd.DataFrame(rows)


def thresholds(nodes: int) -> tuple[float, float]:
    """Exponents from which on there is a minimum inside, and one that rounds to 74 percent.

    Between cosines of 0.1 and 0.6 the albedo is a polynomial to all digits that are needed here.
    """
    from numpy.polynomial.chebyshev import Chebyshev
    from scipy.optimize import brentq

    c = np.linspace(0.1, 0.6, 20_001)

    def polynomial(log_n: float) -> Chebyshev:
        def values(where: np.ndarray) -> np.ndarray:
            return albedo.directional_albedo(surface(math.exp(log_n)), where, rtol=1e-11).value

        return Chebyshev.interpolate(values, nodes - 1, domain=[0.1, 0.6])

    def steepest_fall(log_n: float) -> float:
        return float(polynomial(log_n).deriv()(c).min())

    def above(log_n: float) -> float:
        found = polynomial(log_n)
        # From the edge inwards the albedo rises first; then it has to fall.
        falls = c > float(c[np.argmin(found.deriv()(c))])
        return float(found(c[falls]).min()) - (PRINTED - 0.005)

    span = math.log(1e3), math.log(1e4), math.log(1e6)
    return (
        math.exp(brentq(steepest_fall, span[0], span[1], xtol=1e-9)),
        math.exp(brentq(above, span[1], span[2], xtol=1e-9)),
    )


def judge(context: Context, lows: pd.DataFrame) -> None:
    """Are the lowest values near the edge, and about 74 percent?"""
    rows = lows.set_index("n")
    top, finite = rows.loc[EXPONENTS[-1]], rows.loc[FINITE]
    growing = "each angle as n grows"
    context.claim(
        "A7",
        "The lowest values of the half sphere are about 74 percent.",
        value=top["inside"],
        error=top["inside_error"],
        criterion=f"= {PRINTED:g} +- 0.005",
        quantity=f"lowest total albedo for cos θ >= {EDGE:g}, n = {EXPONENTS[-1]:.0e}",
        reading=growing,
        figure="curves_figure",
        table="minima",
    )
    context.claim(
        "A7",
        "They lie near the edge.",
        value=top["inside_at_radius"],
        # How far the sine moves when the cosine does by its bound.
        error=top["inside_at_cos_error"] * top["inside_at_cos"] / top["inside_at_radius"],
        criterion=f"> {NEAR:g}",
        quantity=f"radius of the minimum, that of the edge being 1, n = {EXPONENTS[-1]:.0e}",
        reading=growing,
        figure="curves_figure",
        table="minima",
    )
    context.claim(
        "A7",
        f"The lowest values of the half sphere are about 74 percent, n = {FINITE:g}.",
        value=finite["edge"],
        error=finite["edge_error"],
        criterion=f"= {PRINTED:g} +- 0.005",
        quantity="lowest total albedo, which is that of the edge",
        reading="a given n, the edge included",
        figure="curves_figure",
        table="minima",
    )


def note(
    context: Context, lows: pd.DataFrame, first: tuple[float, float], last: tuple[float, float]
) -> None:
    """What is seen, and why it depends on the reading."""
    rows = lows.set_index("n")
    top, finite, end = rows.loc[EXPONENTS[-1]], rows.loc[FINITE], rows.loc[math.inf]

    def shown(row: pd.Series, name: str) -> str:
        return format_value(row[name], row[f"{name}_error"])

    q = 2.0**-0.25
    exact = (1.0 - q) / (1.0 - 0.5 * q)
    context.note(
        f"In the limit for each angle the total albedo is R_s + (1 - R_s) (1 + (1 - c)^5 - "
        "(1 - c/2)^5), c = cos θ. It is lowest where (1 - c)^4 = (1 - c/2)^4/2, "
        f"c = {exact:.9f} ({math.degrees(math.acos(exact)):.3f}°, at "
        f"{math.sqrt((1.0 - exact) * (1.0 + exact)):.4f} of the radius): {shown(end, 'inside')}. "
        f"With n = {EXPONENTS[-1]:.0e} the quadrature finds {shown(top, 'inside')} at "
        f"c = {format_value(top['inside_at_cos'], top['inside_at_cos_error'])}."
    )
    context.note(
        "At the edge itself the diffuse term is 0 and the specular one reflects at most a half: "
        + "; ".join(f"n = {n:g}: {shown(rows.loc[n], 'edge')}" for n in EXPONENTS)
        + ". A minimum inside appears at n = "
        f"{format_value(*first)}, and from n = {format_value(*last)} on it rounds to 74 percent."
    )
    seen = [f"n = {n:g}: {shown(rows.loc[n], 'image')}" for n in EXPONENTS]
    context.note(
        f"What an image with a radius of {RADIUS} pixels shows at lowest, at the centres of its "
        "pixels: " + "; ".join(seen) + "."
    )
    context.explain(
        "A7",
        "At every angle that is not grazing the lobe loses about F sqrt(2/(pi n)) tan(θ) of the "
        "light, so that as n grows the total albedo tends to R_s + "
        f"(1 - R_s)(1 + (1 - c)^5 - (1 - c/2)^5), whose minimum is {shown(end, 'inside')} at "
        f"{float(end['inside_at_deg']):.1f}°: the paper's 74 percent near the edge. At a given n "
        "the last of the half sphere, where cos θ is not large against 1/sqrt(n), is darker than "
        f"that: {shown(finite, 'edge')} at the edge for n = {FINITE:g}, as half of the lobe is "
        f"below the horizon there; and below n = {format_value(*first)} the albedo has no minimum "
        f"inside at all. In an image with a radius of {RADIUS} pixels the dark rim is narrower "
        "than a pixel for large n, and what is seen is the minimum inside, which rounds to 74 "
        f"percent from n = {format_value(*last)} on.",
    )


def looks(n: float) -> dict[str, Any]:
    """Colour and dashes of an exponent."""
    k = EXPONENTS.index(n)
    dashes = ("-", *_DASHES, (0, (10, 2)))
    power = round(math.log10(n))
    label = f"n = {n:g}" if n < 1e4 else f"n = $10^{power}$"
    return {"color": _COLORS[k], "linestyle": dashes[k], "label": label}


def draw_curves(curves: pd.DataFrame, lows: pd.DataFrame) -> Figure:
    """Total albedo against the radius, and against the cosine."""
    with plotting.style():
        figure, (left, right) = plotting.new_figure(2, 7.4, 3.7)
        limited = {"color": "#222222", "linewidth": 1.0}
        for axes, x in ((left, "radius"), (right, "cos_theta")):
            for n in EXPONENTS:
                axes.plot(curves[x], curves[f"n={n:g}"], **looks(n))
            axes.plot(curves[x], curves["limit"], label="limit", **limited, zorder=1.8)
            axes.axhline(PRINTED, color="#888888", linewidth=0.9, zorder=1.5)
            axes.set_ylim(0.15, 1.02)
            mark_minima(axes, lows, "inside_at_radius" if x == "radius" else "inside_at_cos")
        left.annotate("74 %", (0.02, PRINTED + 0.012), color="#666666", fontsize=9.0)
        left.set_xlim(0.0, 1.0)
        left.set_xlabel("radius, sin θ")
        left.set_ylabel("total albedo")
        top = left.secondary_xaxis("top", functions=(np.asarray, np.asarray))
        degrees = np.array([0.0, 15.0, 30.0, 45.0, 60.0, 90.0])
        top.set_xticks(np.sin(np.radians(degrees)), [f"{d:g}°" for d in degrees])
        right.set_xscale("log")
        right.set_xlim(1.0, float(curves["cos_theta"].min()))
        right.set_xlabel("cos θ (the edge to the right)")
        right.tick_params(labelleft=False)
        plotting.add_legend(figure, left)
    return figure


def mark_minima(axes: Axes, lows: pd.DataFrame, x: str) -> None:
    """Points at the minima inside."""
    for n in EXPONENTS:
        row = lows.set_index("n").loc[n]
        if math.isfinite(row["inside"]):
            look = {"color": looks(n)["color"], "markeredgecolor": "white"}
            axes.plot(row[x], row["inside"], "o", markersize=5.5, zorder=4, **look)


def draw_spheres(rtol: float) -> Figure:
    """The half sphere for a few exponents."""
    from matplotlib.figure import Figure as NewFigure
    from matplotlib.patches import Circle

    side = (np.arange(2 * RADIUS) + 0.5) / RADIUS - 1.0
    x, y = np.meshgrid(side, side)
    z = np.sqrt(np.maximum(1.0 - x**2 - y**2, 0.0))
    nodes = np.linspace(0.0, 1.0, 401) ** 2
    with plotting.style():
        figure = NewFigure(figsize=(7.2, 3.3), layout="constrained")
        grid = figure.subplots(1, len(SHOWN))
        for axes, n in zip(grid, SHOWN, strict=True):
            value = albedo.directional_albedo(surface(n), nodes, rtol=1e-8).value
            image = axes.imshow(
                np.interp(z, nodes, value),
                cmap="gray",
                vmin=0.3,
                vmax=1.0,
                extent=(-1.0, 1.0, -1.0, 1.0),
                interpolation="nearest",
            )
            rim = Circle((0.0, 0.0), 1.0, fill=False, color="#999999", linewidth=0.5)
            axes.add_patch(rim)
            image.set_clip_path(rim)
            c, _, low, error = lowest_inside(n, rtol)
            if math.isfinite(low):
                ring = math.sqrt((1.0 - c) * (1.0 + c))
                look = {"fill": False, "color": "#D55E00", "linewidth": 0.9, "linestyle": "--"}
                axes.add_patch(Circle((0.0, 0.0), ring, **look))
                axes.text(*(0.0, -0.86), format_value(low, max(error, 1e-5)), ha="center",
                          va="bottom", fontsize=9.0, color="#7a3400")  # fmt: skip
            axes.set_title(looks(n)["label"])
            axes.set_xticks([])
            axes.set_yticks([])
            axes.grid(visible=False)
            axes.spines[:].set_visible(False)
            axes.set_xlim(-1.05, 1.05)
            axes.set_ylim(-1.05, 1.05)
        bar = figure.colorbar(image, ax=grid, orientation="horizontal", shrink=0.6, aspect=40)
        bar.set_label("radiance over that of the background")
    return figure
