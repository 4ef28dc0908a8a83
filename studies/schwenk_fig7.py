"""What does increasing anisotropy do to the lobes and the albedos of two anisotropic models?

The figure of the survey shows renderings of Ashikhmin and Shirley's model and of Ward's side by
side, while the two roughnesses are drawn apart. Here the same is seen in maps over the hemisphere
of directions, drawn as its projection on the surface: the lobe for one light, as the radiance that
it sends to every view, and the furnace map, which is the directional albedo of every direction of
incidence. The geometric mean of the two roughnesses stays the same. Exponents of the one model are
those of the roughnesses of the other, n = 2/α² - 2, and the Fresnel factor is 1.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

import albedo
from albedo import plotting
from albedo.analysis.grazing import first_above_one
from albedo.brdf import Model
from albedo.directions import spherical
from albedo.estimate import format_value
from albedo.studies import Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from albedo.studies import Context

STUDY = Study(
    name="schwenk_fig7",
    title="Lobes and furnace maps of increasing anisotropy",
    paper="S",
    figure="Figure 7",
)

MEAN = 0.2
"""Geometric mean of the two roughnesses."""
RATIOS = (1.0, 2.0, 4.0, 8.0)
TITLES = {"ashikhmin_shirley": "Ashikhmin-Shirley", "ward": "Ward"}
LIGHT_DEGREES, LIGHT_AZIMUTH_DEGREES = 50.0, 35.0
# Radiances over so many decades are told apart.
DECADES, FAINTEST = 5, 1e-30
LOWEST = 0.01
"""The smallest cosine of the furnace maps."""


def model_of(name: str, ratio: float) -> Model:
    """A model with roughnesses of this ratio, the larger one along x."""
    alpha_x, alpha_y = MEAN * math.sqrt(ratio), MEAN / math.sqrt(ratio)
    if name == "ward":
        return albedo.model("ward", alpha_x=alpha_x, alpha_y=alpha_y)
    n_u, n_v = (2.0 / (alpha * alpha) - 2.0 for alpha in (alpha_x, alpha_y))
    return albedo.model("ashikhmin_shirley", n_u=n_u, n_v=n_v)


def column(name: str, ratio: float) -> str:
    """The column of a model and a ratio."""
    return f"{name}_{ratio:g}"


def run(context: Context) -> None:
    """Compute both kinds of maps, and draw them."""
    rtol = 1e-6 if context.full else 1e-4
    size, cosines, azimuths = (65, 40, 25) if context.full else (41, 10, 7)
    context.setting(rtol=rtol, mean=MEAN, size=size)
    lobes = lobe_maps(size)
    context.table(
        "lobes",
        lobes,
        f"Radiance f n.l (1/sr) towards views (v_x, v_y), light at {LIGHT_DEGREES:g}° and azimuth "
        f"{LIGHT_AZIMUTH_DEGREES:g}°; columns are models and ratios of roughnesses",
        digits=dict.fromkeys(lobes, 5),
    )
    context.progress(1, 3, "furnace maps")
    furnace = furnace_maps(cosines, azimuths, rtol)
    context.table(
        "furnace",
        furnace,
        "Albedos of directions of incidence in one quarter of the hemisphere; the others mirror it",
    )
    context.progress(2, 3, "figures")
    summary = summarise(lobes, furnace)
    context.table(
        "summary",
        summary,
        "Tops of the lobes, and extremes of the furnace maps",
        loose={"azimuthal_spread": 1e-6},
    )
    for row in summary.to_dict("records"):
        context.note(
            f"{TITLES[row['model']]}, α_x/α_y = {row['ratio']:g} ({row['alpha_x']:.3g} and "
            f"{row['alpha_y']:.3g}): albedos from "
            f"{format_value(row['smallest'], row['smallest_error'])} at {row['smallest_at']} to "
            f"{format_value(row['largest'], row['largest_error'])} at {row['largest_at']}; over "
            f"azimuth they differ by {row['azimuthal_spread']:.3g} at most."
        )
    cosines_down = plotting.grazing_grid(1e-9, 2)
    ward = model_of("ward", 1.0)
    found = albedo.directional_albedo(ward, cosines_down, rtol=rtol)
    crossing = first_above_one(ward, cosines_down, found)
    if crossing is not None:
        cosine, width = crossing
        context.note(
            f"No map has an albedo above 1. With α = {MEAN:g} Ward's passes 1 at n.l = "
            f"{format_value(cosine, width)}, in a ring of the disk that is "
            f"{cosine**2 / (1.0 + math.sqrt((1.0 - cosine) * (1.0 + cosine))):.1g} of its radius "
            "wide."
        )
    context.figure(
        "lobes_figure",
        draw_lobes(lobes),
        "Lobes seen from above, for one light (the white ring; the cross is its mirror direction): "
        "the radiance sent to every view, on a logarithmic scale. From left to right the roughness "
        "along x grows and that along y falls. Circles are at 30 and 60 degrees.",
    )
    context.figure(
        "furnace_figure",
        draw_furnace(furnace),
        "Furnace maps: the albedo of every direction of incidence, seen from above, for the same "
        "roughnesses. Circles are at 30 and 60 degrees.",
    )


def lobe_maps(size: int) -> pd.DataFrame:
    """Radiances over the disk of views."""
    # Odd sizes have a pixel in the middle, and the last ones lie inside the disk.
    edge = np.linspace(-1.0, 1.0, size)
    x, y = np.meshgrid(edge, edge)
    inside = x * x + y * y < 1.0
    x, y = x[inside], y[inside]
    views = np.stack((x, y, np.sqrt(1.0 - x * x - y * y)), axis=-1)
    light = light_direction()
    columns: dict[str, Any] = {"v_x": x, "v_y": y}
    for name in TITLES:
        for ratio in RATIOS:
            found = light[2] * model_of(name, ratio).eval(light, views)
            # What is fainter still has no digits worth keeping.
            columns[column(name, ratio)] = np.where(found < FAINTEST, 0.0, found)
    return pd.DataFrame(columns)


def light_direction() -> np.ndarray:
    """The light of the lobes."""
    cosine = math.cos(math.radians(LIGHT_DEGREES))
    return spherical(cosine, math.radians(LIGHT_AZIMUTH_DEGREES))


def furnace_maps(cosines: int, azimuths: int, rtol: float) -> pd.DataFrame:
    """Albedos over a quarter of the hemisphere."""
    # Even steps of the angle: the projection crowds them towards the edge, where albedos change.
    theta = np.linspace(0.0, 0.5 * math.pi - math.asin(LOWEST), cosines)
    c = np.sin(0.5 * math.pi - theta).round(6)
    phi = np.linspace(0.0, 90.0, azimuths)
    grid_c, grid_deg = (a.ravel() for a in np.meshgrid(c, phi, indexing="ij"))
    grid_phi = np.radians(grid_deg)
    columns: dict[str, Any] = {"cos_theta": grid_c, "phi_deg": grid_deg}
    for name in TITLES:
        for ratio in RATIOS:
            found = albedo.directional_albedo(model_of(name, ratio), grid_c, grid_phi, rtol=rtol)
            key = column(name, ratio)
            columns |= {key: found.value, f"{key}_error": found.error}
    return pd.DataFrame(columns)


def summarise(lobes: pd.DataFrame, furnace: pd.DataFrame) -> pd.DataFrame:
    """Extremes of all maps."""
    rows = []
    for name in TITLES:
        for ratio in RATIOS:
            key = column(name, ratio)
            # Equal values of different azimuths differ by roundings: the first one is named.
            values = furnace[key].round(9)
            low, high = furnace.loc[values.idxmin()], furnace.loc[values.idxmax()]
            around = furnace.groupby("cos_theta")[key]
            rows.append(
                {
                    "model": name,
                    "ratio": ratio,
                    "alpha_x": MEAN * math.sqrt(ratio),
                    "alpha_y": MEAN / math.sqrt(ratio),
                    "largest_radiance_of_map": float(lobes[key].max()),
                    "smallest": low[key],
                    "smallest_error": low[f"{key}_error"],
                    "smallest_at": place(low),
                    "largest": high[key],
                    "largest_error": high[f"{key}_error"],
                    "largest_at": place(high),
                    "azimuthal_spread": float((around.max() - around.min()).max()),
                }
            )
    return pd.DataFrame(rows)


def place(row: pd.Series) -> str:
    """A direction of incidence in words."""
    if row["cos_theta"] == 1.0:
        return "normal incidence"
    degrees = 90.0 - math.degrees(math.asin(row["cos_theta"]))
    return f"{degrees:.1f}°, azimuth {row['phi_deg']:.0f}°"


def grid_of(names: Any) -> tuple[Any, Any]:
    """A figure of two rows of disks, one for each model, and its panels."""
    figure, _ = plotting.new_figure(0, 8.0, 3.9)
    panels = figure.subplots(2, len(RATIOS), squeeze=False)
    for row, name in zip(panels, names, strict=True):
        for axes, ratio in zip(row, RATIOS, strict=True):
            axes.set_aspect("equal")
            axes.set_xlim(-1.03, 1.03)
            axes.set_ylim(-1.03, 1.03)
            axes.set_xticks(())
            axes.set_yticks(())
            axes.grid(False)
            for spine in axes.spines.values():
                spine.set_visible(False)
            if axes in panels[0]:
                alphas = MEAN * math.sqrt(ratio), MEAN / math.sqrt(ratio)
                axes.set_title(f"α = {alphas[0]:.2g} × {alphas[1]:.2g}")
            else:
                axes.set_xlabel("x (tangent)")
        row[0].set_ylabel(f"{TITLES[name]}\ny (bitangent)")
    return figure, panels


def rings(axes: Any, color: str) -> None:
    """Circles of 30 and 60 degrees, and the horizon."""
    turn = np.linspace(0.0, 2.0 * math.pi, 181)
    for degrees, width in ((30.0, 0.5), (60.0, 0.5), (90.0, 0.9)):
        radius = math.sin(math.radians(degrees))
        axes.plot(radius * np.cos(turn), radius * np.sin(turn), color=color, linewidth=width)


def draw_lobes(lobes: pd.DataFrame) -> Figure:
    """Lobes on one logarithmic scale."""
    from matplotlib.colors import LogNorm
    from matplotlib.patches import Circle

    keys = [column(name, ratio) for name in TITLES for ratio in RATIOS]
    top = 10.0 ** math.ceil(math.log10(float(lobes[keys].to_numpy().max())))
    norm = LogNorm(top * 10.0**-DECADES, top)
    edge = np.unique(lobes["v_x"])
    # The corners of the square have no views.
    column_of = np.searchsorted(edge, lobes["v_x"])
    row_of = np.searchsorted(edge, lobes["v_y"])
    light = light_direction()
    with plotting.style():
        figure, panels = grid_of(TITLES)
        half = 0.5 * (edge[1] - edge[0])
        extent = (edge[0] - half, edge[-1] + half) * 2
        for row, name in zip(panels, TITLES, strict=True):
            for axes, ratio in zip(row, RATIOS, strict=True):
                image = np.full((edge.size, edge.size), np.nan)
                seen = np.maximum(lobes[column(name, ratio)], norm.vmin)
                image[row_of, column_of] = seen
                drawn = axes.imshow(
                    *(image, "viridis", norm), origin="lower", extent=extent,
                    interpolation="nearest",
                )  # fmt: skip
                # A pixel is no part of the disk by its middle alone: the rim is filled and cut.
                disk = Circle((0.0, 0.0), 1.0, facecolor=drawn.cmap(0.0), zorder=-1.0)
                axes.add_patch(disk)
                drawn.set_clip_path(Circle((0.0, 0.0), 1.0, transform=axes.transData))
                rings(axes, "#bbbbbb")
                axes.plot(light[0], light[1], "o", ms=6, mfc="none", mec="white", mew=1.3)
                axes.plot(-light[0], -light[1], "x", ms=5, color="black", mew=1.1)
        bar = figure.colorbar(drawn, ax=panels, pad=0.02, extend="min")
        bar.set_label("radiance f n.l (1/sr)")
        bar.outline.set_visible(False)
    return figure


def draw_furnace(furnace: pd.DataFrame) -> Figure:
    """Furnace maps on one scale, four times the quarter that was computed."""
    c, phi = np.unique(furnace["cos_theta"])[::-1], np.unique(furnace["phi_deg"])
    radius = np.sqrt((1.0 - c) * (1.0 + c))
    # All four quarters in one turn: the map is symmetric in x and in y.
    around = np.radians(
        np.concatenate((phi, 180.0 - phi[-2::-1], 180.0 + phi[1:], 360.0 - phi[-2::-1]))
    )
    x, y = radius[:, None] * np.cos(around), radius[:, None] * np.sin(around)
    with plotting.style():
        figure, panels = grid_of(TITLES)
        for row, name in zip(panels, TITLES, strict=True):
            for axes, ratio in zip(row, RATIOS, strict=True):
                quarter = furnace[column(name, ratio)].to_numpy().reshape(c.size, phi.size)
                turned = quarter[:, -2::-1]
                whole = np.concatenate((quarter, turned, quarter[:, 1:], turned), axis=1)
                drawn = axes.pcolormesh(
                    *(x, y, whole), vmin=0.0, vmax=1.0, cmap="viridis", shading="gouraud",
                    rasterized=True,
                )  # fmt: skip
                rings(axes, "#bbbbbb")
        bar = figure.colorbar(drawn, ax=panels, pad=0.02)
        bar.set_label("directional albedo")
        bar.outline.set_visible(False)
    return figure
