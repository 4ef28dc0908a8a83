"""What angles do the lobes of Phong and Blinn depend on?

Phong's lobe is a power of cos(alpha) = r.v, the angle between V and the mirror direction of L;
Blinn's is one of cos(delta) = n.h, the angle between H and N. In the plane of incidence alpha =
2 delta. For any V

    sin^2(alpha/2) = (v.h)^2 sin^2(delta) + (n.l - n.v)^2/4,

so that sin(delta) = sin(alpha/2)/(v.h) for V as high as R: there delta is more than alpha/2, and
Blinn's lobe falls faster beside R than in the plane of incidence.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

import albedo
from albedo import plotting
from albedo.analysis.drawn_vectors import (
    ROUNDING,
    Scene,
    angle_between,
    dot_products,
    mirrored,
    vector_table,
)
from albedo.directions import half_vector, spherical
from albedo.studies import Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from albedo.brdf import Model
    from albedo.studies import Context

STUDY = Study(
    name="schwenk_fig3",
    title="Mirror direction and half vector",
    paper="S",
    figure="Figure 3",
)

THETA = 50.0
"""Angle of incidence in degrees."""

# V is so far from R, in the plane of incidence (towards N) and at the height of R.
OFF = 24.0
N_PHONG, N_BLINN = 20.0, 80.0
SHADES = {"N": "#222222", "L": "#E69F00", "V": "#0072B2", "R": "#D55E00", "H": "#009E73"}
PAIRS = (("R", "V"), ("N", "H"), ("N", "L"), ("N", "V"), ("V", "H"))


def run(context: Context) -> None:
    """Vectors and products for both views, the relation between the angles, and the figure."""
    context.setting(light_deg=THETA, view_off_mirror_deg=OFF, n_phong=N_PHONG, n_blinn=N_BLINN)
    places = {"in the plane of incidence": in_plane(OFF), "beside R": beside(OFF)}
    for name, (place, vectors) in zip(("plane", "beside"), places.items(), strict=True):
        loose = {"theta_deg": 1e-10, "phi_deg": 1e-10, "x": 1e-14, "y": 1e-14, "z": 1e-14}
        context.table(
            f"vectors_{name}", vector_table(vectors), f"Directions, V {place}", loose=loose
        )
        context.table(
            f"products_{name}", dot_products(vectors, PAIRS), f"Dot products and angles, V {place}"
        )
    table = relation(12 if context.full else 6)
    context.table(
        "angles",
        table,
        "α = angle(R, V), δ = angle(N, H), and both sides of the relation between them; V in the "
        "plane of incidence (azimuth 0 about R) and out of it",
        loose={"azimuth_deg": 1e-10},
    )
    halves = {
        place: angle_between(v["N"], v["H"]) / angle_between(v["R"], v["V"])
        for place, v in places.items()
    }
    off = float((table["left"] - table["right"]).abs().max())
    context.note(
        f"Light at {THETA:g}°, V at {OFF:g}° from R: δ/α is "
        + " and ".join(f"{ratio:.6f} {place}" for place, ratio in halves.items())
        + ". For small angles beside R it is 1/(2 cos θ) = "
        f"{0.5 / math.cos(math.radians(THETA)):.6f}. Both sides of the relation between α and δ "
        f"agree within {off:.0e}, for V all around R."
    )
    context.figure(
        "lobes_figure",
        draw(places),
        f"Left: the plane of incidence with Phong's lobe (R.V)^{N_PHONG:g} and Blinn's with the "
        f"exponents {N_BLINN:g} and {N_PHONG:g}, as lengths along V; α = 2δ. Right: V beside R, "
        "as high as R, where δ is more than half of α.",
    )


def frame(light: np.ndarray, view: np.ndarray) -> dict[str, np.ndarray]:
    """N, L, V, R and H."""
    half = half_vector(light, view)
    return {
        "N": np.array([0.0, 0.0, 1.0]),
        "L": light,
        "V": view,
        "R": mirrored(light),
        "H": half / np.linalg.norm(half),
    }


def about_mirror(alpha: float, azimuth: float) -> np.ndarray:
    """V at an angle from R; azimuth 0 is towards N. Radians."""
    theta = math.radians(THETA)
    c, s = math.cos(theta), math.sin(theta)
    up, across = math.sin(alpha) * math.cos(azimuth), math.sin(alpha) * math.sin(azimuth)
    return np.array([-s * math.cos(alpha) + c * up, across, c * math.cos(alpha) + s * up])


def in_plane(off: float) -> dict[str, np.ndarray]:
    """V in the plane of incidence, so many degrees from R towards N."""
    return frame(spherical(math.cos(math.radians(THETA))), about_mirror(math.radians(off), 0.0))


def beside(off: float) -> dict[str, np.ndarray]:
    """V at the height of R, so many degrees from it: R turned about N."""
    s = math.sin(math.radians(THETA))
    turn = 2.0 * math.asin(math.sin(0.5 * math.radians(off)) / s)
    cosine = math.cos(math.radians(THETA))
    return frame(spherical(cosine), spherical(cosine, math.pi - turn))


def relation(steps: int) -> pd.DataFrame:
    """Both sides of the relation between alpha and delta, for V around R."""
    rows = []
    for off in (1e-6, 1.0, 10.0, OFF):
        for azimuth in np.linspace(0.0, 180.0, steps + 1):
            view = about_mirror(math.radians(off), math.radians(azimuth))
            vectors = frame(spherical(math.cos(math.radians(THETA))), view)
            alpha = angle_between(vectors["R"], vectors["V"])
            half = vectors["H"]
            sine = float(np.hypot(half[0], half[1]))
            delta = math.atan2(sine, half[2])
            # n.l - n.v as differences of R and V, along the normal.
            drop = 0.5 * float(vectors["R"][2] - vectors["V"][2])
            rows.append(
                {
                    "azimuth_deg": azimuth,
                    "alpha_deg": math.degrees(alpha),
                    "alpha_deg_error": math.degrees(ROUNDING),
                    "delta_deg": math.degrees(delta),
                    "delta_deg_error": math.degrees(ROUNDING),
                    "left": math.sin(0.5 * alpha) ** 2,
                    "left_error": ROUNDING,
                    "right": float(vectors["V"] @ half) ** 2 * sine**2 + drop**2,
                    "right_error": ROUNDING,
                }
            )
    return pd.DataFrame(rows)


def lobe(model: Model, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A lobe over its peak for V in the plane of incidence, as points of that plane.

    Angles are those of V to the normal, positive on the side of R, which is drawn on the left.
    """
    light = spherical(math.cos(math.radians(THETA)))
    views = np.stack((-np.sin(angles), 0.0 * angles, np.cos(angles)), axis=-1)
    values = model.eval(light, views) / model.eval(light, mirrored(light))
    return values * views[:, 0], values * views[:, 2]


def draw(places: dict[str, dict[str, np.ndarray]]) -> Figure:
    """The plane of incidence with both lobes, and V beside R in space."""
    with plotting.style():
        figure, panels = plotting.new_figure(2, 9.0, 3.6)
        for axes, (place, vectors) in zip(panels, places.items(), strict=True):
            flat = place.startswith("in")
            # Looking along B, at T to the right, or from above.
            scene = Scene(axes, *((-90.0, 0.0) if flat else (-62.0, 24.0)))
            if flat:
                draw_lobes(axes)
                axes.fill_between([-1.0, 1.0], -0.06, 0.0, color="#eeeeee", linewidth=0)
                axes.plot([-1.0, 1.0], [0.0, 0.0], color="#888888", linewidth=1.2)
            else:
                scene.surface(1.0)
                for name in "LVRH":
                    tip = vectors[name]
                    foot = tip * np.array([1.0, 1.0, 0.0])
                    drop = np.stack((tip, foot, 0.0 * tip))
                    scene.line(drop, color="#bbbbbb", linewidth=0.8, ls=":")
            for name, shade in SHADES.items():
                scene.arrow(vectors[name], name, shade)
            scene.arc(vectors["R"], vectors["V"], "α", SHADES["R"], radius=0.97)
            scene.arc(vectors["N"], vectors["H"], "δ", SHADES["H"], radius=0.8)
            axes.margins(0.04)
            low, high = axes.get_ylim()
            axes.set_ylim(low, high + 0.12)
            look = {"transform": axes.transAxes, "ha": "center", "va": "top", "fontsize": 10.5}
            axes.text(0.5, 1.0, f"V {place}", **look)
        plotting.add_legend(figure, panels[0])
    return figure


def draw_lobes(axes: Axes) -> None:
    """Both lobes as lengths along V."""
    angles = np.radians(np.linspace(-89.9, 89.9, 1200))
    looks = (
        ("phong", N_PHONG, f"Phong, (R.V)^{N_PHONG:g}", "-"),
        ("blinn", N_BLINN, f"Blinn, (N.H)^{N_BLINN:g}", (0, (6, 2))),
        ("blinn", N_PHONG, f"Blinn, (N.H)^{N_PHONG:g}", (0, (1.2, 1.4))),
    )
    for name, n, label, dash in looks:
        x, z = lobe(albedo.model(name, n=n), angles)
        shade = plotting.color(name)
        axes.plot(x, z, color=shade, linestyle=dash, label=label, linewidth=1.4)
        if name == "phong":
            axes.fill(x, z, color=shade, alpha=0.1, linewidth=0)
