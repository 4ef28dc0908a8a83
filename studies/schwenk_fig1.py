"""What are the directions and angles that the survey's models are made of?

All directions are unit vectors that point away from the surface: N the normal, L to the light, V
to the viewer, R = 2 (n.l) N - L the mirror direction of L, H along L + V. Models are functions of
their dot products, which are computed here for the directions in the figure, with relations that
hold for any two directions.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from albedo import plotting
from albedo.analysis.drawn_vectors import (
    ROUNDING,
    Scene,
    dot_products,
    mirrored,
    vector_table,
)
from albedo.directions import half_vector, spherical
from albedo.studies import Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from albedo.studies import Context

STUDY = Study(
    name="schwenk_fig1",
    title="Directions at a point of a surface",
    paper="S",
    figure="Figure 1",
)

# Angles to the normal and azimuths of L and V in the figure, degrees.
LIGHT, VIEW = (60.0, 0.0), (48.0, 130.0)
PAIRS = (
    *(("N", "L"), ("N", "V"), ("N", "H"), ("N", "R")),
    *(("L", "V"), ("L", "H"), ("V", "H"), ("R", "V"), ("R", "H")),
)


def run(context: Context) -> None:
    """The directions, their products, relations between them, and the figure."""
    context.setting(
        light_deg=LIGHT[0], light_azimuth_deg=LIGHT[1], view_deg=VIEW[0], view_azimuth_deg=VIEW[1]
    )
    vectors = directions()
    context.table("vectors", vector_table(vectors), "Directions of the figure", loose=angles())
    products = dot_products(vectors, PAIRS)
    context.table("products", products, "Dot products and angles")
    context.table(
        "relations",
        relations(vectors),
        "Relations of any two directions: both sides for those of the figure",
    )
    value = products.set_index("pair")["angle_deg"]
    context.note(
        f"V is off the mirror direction by {value['R.V']:.4f}° and the half vector off the normal "
        f"by {value['N.H']:.4f}°, which is {value['N.H'] / value['R.V']:.4f} of it; the half angle "
        f"between H and either direction is {value['V.H']:.4f}°."
    )
    context.figure(
        "frame_figure",
        draw(vectors),
        "The surface with its tangent T and bitangent B, the directions, and the angles θ of L and "
        "V, α between R and V, δ between N and H, and β between H and L or V.",
    )


def angles() -> dict[str, float]:
    """Columns of angles, in degrees, that other libraries round otherwise."""
    return {"theta_deg": 1e-10, "phi_deg": 1e-10, "x": 1e-14, "y": 1e-14, "z": 1e-14}


def directions() -> dict[str, np.ndarray]:
    """T, B, N, L, V, R and H."""
    light, view = (
        spherical(math.cos(math.radians(theta)), math.radians(phi)) for theta, phi in (LIGHT, VIEW)
    )
    half = half_vector(light, view)
    return {
        **dict(zip("TBN", np.eye(3), strict=True)),
        "L": light,
        "V": view,
        "R": mirrored(light),
        "H": half / np.linalg.norm(half),
    }


def relations(vectors: dict[str, np.ndarray]) -> pd.DataFrame:
    """Both sides of relations that hold for any L and V."""
    n, light, view, mirror, half = (vectors[name] for name in "NLVRH")
    sides = {
        "r.v = 2 (n.l)(n.v) - l.v": (
            mirror @ view,
            2.0 * (n @ light) * (n @ view) - light @ view,
        ),
        "n.l + n.v = 2 (v.h)(n.h)": (n @ light + n @ view, 2.0 * (view @ half) * (n @ half)),
        "1 + l.v = 2 (v.h)^2": (1.0 + light @ view, 2.0 * (view @ half) ** 2),
        "l.h = v.h": (light @ half, view @ half),
        "2 (1 - r.v) = 4 (v.h)^2 (1 - (n.h)^2) + (n.l - n.v)^2": (
            np.sum((mirror - view) ** 2),
            # The sine of the angle of H from its tangential part.
            4.0 * (view @ half) ** 2 * np.sum(half[:2] ** 2) + (n @ light - n @ view) ** 2,
        ),
    }
    return pd.DataFrame(
        [
            {
                "relation": name,
                "left": float(left),
                "left_error": 4.0 * ROUNDING,
                "right": float(right),
                "right_error": 4.0 * ROUNDING,
            }
            for name, (left, right) in sides.items()
        ]
    )


def draw(vectors: dict[str, np.ndarray]) -> Figure:
    """All directions in space, with their angles."""
    with plotting.style():
        figure, (axes,) = plotting.new_figure(width=6.5, height=4.4)
        scene = Scene(axes, azimuth=-68.0, elevation=20.0)
        scene.surface(1.05)
        for name in "LVRH":
            # A plumb line shows where a tip is in space.
            tip = vectors[name]
            foot = tip * np.array([1.0, 1.0, 0.0])
            scene.line(np.stack((tip, foot, 0.0 * tip)), color="#bbbbbb", linewidth=0.8, ls=":")
        for name in "TB":
            scene.arrow(vectors[name], name, "#888888", linewidth=1.1)
        shades = {"N": "#222222", "L": "#E69F00", "V": "#0072B2", "R": "#D55E00", "H": "#009E73"}
        for name, shade in shades.items():
            scene.arrow(vectors[name], name, shade)
        for first, second, label, radius, shade, shift in (
            ("N", "L", "$θ_l$", 0.36, "#E69F00", (0.02, 0.0)),
            ("N", "V", "$θ_v$", 0.66, "#0072B2", (0.0, 0.0)),
            ("N", "H", "δ", 0.85, "#009E73", (0.0, 0.0)),
            ("R", "V", "α", 0.8, "#D55E00", (0.0, 0.0)),
            ("H", "L", "β", 0.52, "#777777", (-0.03, 0.05)),
            ("H", "V", "β", 0.52, "#777777", (0.09, 0.01)),
        ):
            scene.arc(vectors[first], vectors[second], label, shade, radius=radius, shift=shift)
        axes.margins(0.03)
    return figure
