"""Which vectors does Ashikhmin and Shirley's model read, and how do they lie?

The figure of the paper names them: k1 to the light, k2 to the viewer, the normal n, tangents u and
v of the anisotropy, and the half vector h between k1 and k2. Here they are computed for one pair of
directions that is no mirror pair, projected on the page, and listed with the dot products that the
model's equations contain.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

import albedo
from albedo import plotting
from albedo.directions import spherical
from albedo.estimate import format_value
from albedo.studies import Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from albedo.studies import Context

STUDY = Study(
    name="as_fig1",
    title="The vectors of Ashikhmin and Shirley's model",
    paper="AS",
    figure="Figure 1",
)

# Polar angle and azimuth from u in degrees; not in one plane with the normal, as a mirror pair is.
LIGHT = (52.0, 150.0)
VIEW = (58.0, 8.0)
EXPONENTS = (10.0, 100.0)
# From where the page looks at the surface: azimuth and elevation in degrees.
EYE = (-66.0, 27.0)
EPS = float(np.finfo(float).eps)

_COLORS = {
    "n": "#222222",
    "u": "#999933",
    "v": "#AA4499",
    "k1": "#D55E00",
    "k2": "#0072B2",
    "h": "#009E73",
}
_NAMES = {"k1": "k₁", "k2": "k₂"}


def run(context: Context) -> None:
    """Compute the vectors, list them, and draw them."""
    context.setting(
        light_deg=LIGHT[0], light_azimuth_deg=LIGHT[1], view_deg=VIEW[0], view_azimuth_deg=VIEW[1]
    )
    vectors = make_vectors()
    context.table("vectors", as_rows(vectors), "The vectors in the frame of u, v and n")
    dots = products(vectors)
    context.table("products", dots, "Dot products that the equations contain, and their angles")
    azimuth = exponent_of(vectors)
    context.table("exponent", azimuth, "The exponent of n.h at the azimuth of h, for n_u, n_v")
    context.figure(
        "geometry",
        draw(vectors),
        f"Light at {LIGHT[0]:g}° from the normal, viewer at {VIEW[0]:g}°, orthographic view; the "
        "disc is the tangent plane. Dotted: feet of k₁, k₂ and h on it, and the plane of k₁ and "
        "k₂, in which h halves their angle.",
    )
    rows = dots.set_index("product")
    context.note(
        f"h lies {rows.angle_deg['n.h']:.2f}° from the normal. It halves the angle of k1 and k2: "
        f"k1.h and k2.h are both {format_value(rows.value['k1.h'], rows.value_error['k1.h'])}, as "
        f"is |k1 + k2|/2 = {format_value(rows.value['|k1+k2|/2'], rows.value_error['|k1+k2|/2'])}."
        " That the Fresnel factor may be taken at either makes the model reciprocal."
    )
    n_u, n_v = EXPONENTS
    context.note(
        f"The azimuth of h from u is {float(azimuth['phi_h_deg'].iloc[0]):.2f}°; with n_u = "
        f"{n_u:g} and n_v = {n_v:g} the exponent of n.h is "
        f"{float(azimuth['exponent'].iloc[0]):.3f} there."
    )


def make_vectors() -> dict[str, np.ndarray]:
    """All vectors of the figure, in the frame of u, v and n."""
    light, view = (
        spherical(math.cos(math.radians(theta)), math.radians(phi)) for theta, phi in (LIGHT, VIEW)
    )
    both = light + view
    return {
        "n": np.array([0.0, 0.0, 1.0]),
        "u": np.array([1.0, 0.0, 0.0]),
        "v": np.array([0.0, 1.0, 0.0]),
        "k1": light,
        "k2": view,
        "h": both / np.linalg.norm(both),
    }


def as_rows(vectors: dict[str, np.ndarray]) -> pd.DataFrame:
    """One row for every vector: components, polar angle and azimuth."""
    rows = []
    for name, w in vectors.items():
        flat = math.hypot(w[0], w[1])
        row: dict[str, Any] = {"vector": name}
        for axis, part in zip("uvn", w, strict=True):
            # A direction is a product of a sine and a cosine; h also a sum, a root and a quotient.
            row |= {f"along_{axis}": part}
            row |= {f"along_{axis}_error": 0.0 if name in ("n", "u", "v") else 8.0 * EPS}
        row["theta_deg"] = math.degrees(math.atan2(flat, w[2]))
        row["phi_deg"] = math.degrees(math.atan2(w[1], w[0])) if flat else math.nan
        rows.append(row)
    return pd.DataFrame(rows)


def products(vectors: dict[str, np.ndarray]) -> pd.DataFrame:
    """Dot products and the angles that they are the cosines of."""
    pairs = (
        *(("n", "k1"), ("n", "k2"), ("n", "h"), ("k1", "h"), ("k2", "h"), ("k1", "k2")),
        *(("h", "u"), ("h", "v")),
    )
    rows = []
    for a, b in pairs:
        x, y = vectors[a], vectors[b]
        # By the arc tangent: an arc cosine loses digits where vectors are close.
        angle = math.degrees(math.atan2(float(np.linalg.norm(np.cross(x, y))), float(x @ y)))
        rows.append({"product": f"{a}.{b}", "value": float(x @ y), "angle_deg": angle})
    half = 0.5 * float(np.linalg.norm(vectors["k1"] + vectors["k2"]))
    rows.append({"product": "|k1+k2|/2", "value": half, "angle_deg": math.degrees(math.acos(half))})
    frame = pd.DataFrame(rows)
    # Three products of components that are each right to 8 units.
    frame.insert(2, "value_error", 32.0 * EPS)
    return frame


def exponent_of(vectors: dict[str, np.ndarray]) -> pd.DataFrame:
    """n_u cos^2 + n_v sin^2 of the azimuth of h, the density p_h there, and the model's value."""
    n_u, n_v = EXPONENTS
    h, light, view = vectors["h"], vectors["k1"], vectors["k2"]
    model = albedo.model("ashikhmin_shirley", n_u=n_u, n_v=n_v)
    along = (n_u * h[0] ** 2 + n_v * h[1] ** 2) / (h[0] ** 2 + h[1] ** 2)
    # The density of views is p_h/(4 k1.h).
    density = float(model.pdf(light, view)) * 4.0 * float(light @ h)
    return pd.DataFrame(
        [
            {
                "n_u": n_u,
                "n_v": n_v,
                "phi_h_deg": math.degrees(math.atan2(h[1], h[0])),
                "exponent": along,
                "exponent_error": 64.0 * EPS * along,
                "p_h": density,
                # The exponent's rounding is multiplied by the logarithm of n.h.
                "p_h_error": 128.0 * EPS * max(1.0, along) * density,
                "brdf": float(model.eval(light, view)),
                "brdf_error": 128.0 * EPS * max(1.0, along) * float(model.eval(light, view)),
            }
        ]
    )


def on_page(points: Any) -> np.ndarray:
    """Orthographic projection: right and up on the page."""
    azimuth, elevation = np.radians(EYE)
    right = np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
    towards = np.array(
        [
            math.cos(elevation) * math.cos(azimuth),
            math.cos(elevation) * math.sin(azimuth),
            math.sin(elevation),
        ]
    )
    found: np.ndarray = np.asarray(points) @ np.stack((right, np.cross(towards, right)), axis=1)
    return found


def arc(a: np.ndarray, b: np.ndarray, radius: float) -> np.ndarray:
    """Points of the circle from a to b."""
    angle = math.atan2(float(np.linalg.norm(np.cross(a, b))), float(a @ b))
    t = np.linspace(0.0, 1.0, 60)[:, None]
    found: np.ndarray = (
        radius * (np.sin((1.0 - t) * angle) * a + np.sin(t * angle) * b) / math.sin(angle)
    )
    return found


def mark_angle(
    axes: Axes,
    a: np.ndarray,
    b: np.ndarray,
    radius: float,
    text: str,
    out: tuple[float, float],
) -> None:
    """An arc from a to b and its name, moved by `out` from the middle of the arc."""
    line = on_page(arc(a, b, radius))
    axes.plot(*line.T, color="#555555", linewidth=1.0)
    x, y = line[len(line) // 2]
    axes.text(x + out[0], y + out[1], text, ha="center", va="center", fontsize=10)


def draw(vectors: dict[str, np.ndarray]) -> Figure:
    """All vectors as arrows, arcs of the angles, and the tangent plane."""
    from matplotlib.colors import to_rgba

    with plotting.style():
        figure, (axes,) = plotting.new_figure(1, 6.5, 4.5)
        turn = np.linspace(0.0, 2.0 * math.pi, 400)
        rim = on_page(np.stack((np.cos(turn), np.sin(turn), 0.0 * turn), axis=1))
        axes.fill(*rim.T, facecolor="#f0f0f0", edgecolor="#aaaaaa", linewidth=0.9, zorder=0.5)
        fan = arc(vectors["k1"], vectors["k2"], 1.0)
        plane = on_page(np.concatenate(([np.zeros(3)], fan)))
        axes.fill(*plane.T, facecolor=to_rgba(_COLORS["h"], 0.10), edgecolor="none", zorder=0.8)
        axes.plot(*on_page(fan).T, ":", color="#555555", linewidth=1.1)
        for name in ("k1", "k2", "h"):
            w = vectors[name]
            foot = np.array([w[0], w[1], 0.0])
            feet = on_page([np.zeros(3), foot, w])
            axes.plot(*feet.T, ":", color=_COLORS[name], linewidth=1.3)
        for name, w in vectors.items():
            tip = on_page(w * (1.12 if name in "nuv" else 1.0))
            axes.annotate(
                "",
                xy=tuple(tip),
                xytext=(0.0, 0.0),
                arrowprops={
                    "arrowstyle": "-|>,head_length=0.7,head_width=0.28",
                    "color": _COLORS[name],
                    "linewidth": 2.0,
                    "shrinkA": 0.0,
                    "shrinkB": 0.0,
                },
                zorder=3,
            )
            place = tip + 0.075 * tip / np.linalg.norm(tip)
            axes.text(
                *place,
                _NAMES.get(name, name),
                color=_COLORS[name],
                fontsize=13,
                fontweight="bold",
                ha="center",
                va="center",
            )
        k1, k2, h, n, u = (vectors[name] for name in ("k1", "k2", "h", "n", "u"))
        mark_angle(axes, k1, h, 0.62, "α", (-0.06, 0.06))
        mark_angle(axes, h, k2, 0.62, "α", (-0.03, 0.09))
        mark_angle(axes, n, h, 0.86, "δ", (0.03, 0.07))
        foot = np.array([h[0], h[1], 0.0]) / math.hypot(h[0], h[1])
        mark_angle(axes, u, foot, 0.3, "φ", (0.07, 0.03))
        axes.plot(*on_page([np.zeros(3), 0.42 * foot]).T, ":", color=_COLORS["h"], linewidth=1.3)
        # Arrows are no data to the axes.
        axes.set_xlim(-1.12, 1.25)
        axes.set_ylim(-0.5, 1.12)
        axes.set_aspect("equal")
        axes.axis("off")
    return figure
