"""What do spheres of Ashikhmin and Shirley's lobe look like in a uniformly bright room?

With R_s = 1 the Fresnel factor is 1, and a surface that lost nothing would vanish against the
background. By reciprocity a pixel shows the albedo for light from the viewer. The spheres are seen
orthographically; u runs along the parallels of a vertical axis and v along the meridians. The paper
gives the centre of one sphere a number: about 68 percent of the background for n_u = n_v = 10.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

import albedo
from albedo import plotting
from albedo.analysis.half_vectors import albedo_at_normal
from albedo.estimate import format_value
from albedo.studies import Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from albedo.brdf import Model
    from albedo.studies import Context

STUDY = Study(
    name="as_fig2",
    title="Spheres in a furnace",
    paper="AS",
    figure="Figure 2",
    claims=("A2",),
)

EXPONENTS = (0.0, 10.0, 100.0, 1000.0)
PRINTED = 0.68
N = 10.0
SEED = 2
RTOL = 1e-6
EPS = float(np.finfo(float).eps)


@dataclass(frozen=True)
class Sphere:
    """Albedos of a model over directions, to be interpolated.

    Attributes
    ----------
    root : ndarray
        Square roots of cosines of the angle of incidence.
    turn : ndarray
        Azimuths from 0 to pi/2, all that an anisotropic lobe needs; two for an isotropic one.
    value, error : ndarray
        Albedos and their bounds.
    """

    root: np.ndarray
    turn: np.ndarray
    value: np.ndarray
    error: np.ndarray

    def at(self, cos_theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
        """Interpolated albedos, for azimuths from 0 to pi/2."""
        from scipy.interpolate import RectBivariateSpline

        low = min(3, self.turn.size - 1)
        spline = RectBivariateSpline(self.root, self.turn, self.value, kx=3, ky=low)
        found: np.ndarray = spline.ev(np.sqrt(cos_theta), phi)
        return found


def run(context: Context) -> None:
    """Render the spheres, measure their centres, and weigh the number that the paper gives."""
    context.setting(rtol=RTOL, rtol_centre=1e-10, seed=SEED)
    nodes = (65, 25) if context.full else (33, 9)
    pixels = 240 if context.full else 128
    pairs = list(itertools.combinations_with_replacement(EXPONENTS, 2))
    pictures: dict[tuple[float, float], np.ndarray] = {}
    rows = []
    for done, (n_u, n_v) in enumerate(pairs):
        context.progress(done, len(pairs), f"sphere of n_u = {n_u:g}, n_v = {n_v:g}")
        model = lobe(n_u, n_v)
        sphere = tabulate(model, *nodes)
        off = off_nodes(model, sphere, 200 if context.full else 60)
        pictures[n_u, n_v] = picture(sphere, pixels)
        # The other way round everything is turned by a quarter.
        pictures[n_v, n_u] = picture(sphere, pixels, turned=True)
        rows.append(summary(n_u, n_v, model, sphere, off))
    spheres = pd.DataFrame(rows)
    context.table(
        "spheres",
        spheres,
        "Centres of the spheres, extremes of their tables, and what interpolation is off by",
        loose={"interpolated_to": 1e-3},
    )
    context.figure(
        "furnace",
        draw(pictures, spheres),
        "Spheres of radiance a(V) before a background of 1: R_s = 1, no diffuse term; grey is "
        "linear in the radiance, outlines are thin lines. u is horizontal and v vertical at the "
        "centres, whose albedos are printed. Between tabulated directions the picture is off by "
        "less than "
        f"{float(spheres['interpolated_to'].max()):.0e} at any direction that was tried.",
    )
    readings = alternatives(2**18 if context.full else 2**14)
    context.table("readings", readings, "What has 68 percent, and other ways to the number")
    judge(context, readings)
    centre = spheres.set_index(["n_u", "n_v"])
    context.note(
        "Centres of equal exponents: "
        + "; ".join(
            f"n = {n:g}: {format_value(row.centre, row.centre_error)}"
            for n in EXPONENTS
            for row in [centre.loc[(n, n)]]
        )
        + ". At the edge of a sphere the albedo is 1/2: half of the half vectors then send light "
        "below the horizon, and the larger cosine is that of the rest."
    )


def lobe(n_u: float, n_v: float) -> Model:
    """The specular lobe with a Fresnel factor of 1."""
    return albedo.model("ashikhmin_shirley", n_u=n_u, n_v=n_v)


def tabulate(model: Model, places: int, turns: int) -> Sphere:
    """Albedos on a grid that is dense at grazing angles."""
    root = np.linspace(1e-3, 1.0, places)
    turn = np.linspace(0.0, 0.5 * math.pi, 2 if model.isotropic else turns)
    found = albedo.directional_albedo(model, root[:, None] ** 2, turn, rtol=RTOL)
    return Sphere(root, turn, found.value, found.error)


def off_nodes(model: Model, sphere: Sphere, count: int) -> float:
    """The largest error of the interpolation at random directions on the sphere's disc."""
    rng = np.random.default_rng(SEED)
    # Uniform on the disc, as pixels are.
    cosine = np.sqrt(rng.uniform(1e-4, 1.0, count))
    turn = rng.uniform(0.0, 0.5 * math.pi, count)
    exact = albedo.directional_albedo(model, cosine, turn, rtol=RTOL)
    return float(np.max(np.abs(sphere.at(cosine, turn) - exact.value) + exact.error))


def picture(sphere: Sphere, pixels: int, turned: bool = False) -> np.ndarray:
    """The unit sphere from far along z; beside it, the radiance of the edge.

    At the point (x, y, z) the normal is (x, y, z), u = (z, 0, -x)/|.| and v = n x u, so that the
    viewer has the components -x/|.| along u, -y z/|.| along v and z along n.
    """
    side = (np.arange(pixels) + 0.5) / pixels * 2.0 - 1.0
    x, y = np.meshgrid(side, -side)
    z = np.sqrt(np.maximum(1.0 - x**2 - y**2, 0.0))
    # At the poles of the axis u is not defined; no centre of a pixel hits them.
    phi = np.arctan2(np.abs(y) * z, np.abs(x))
    return sphere.at(np.maximum(z, sphere.root[0] ** 2), 0.5 * math.pi - phi if turned else phi)


def summary(n_u: float, n_v: float, model: Model, sphere: Sphere, off: float) -> dict[str, float]:
    """The centre of a sphere, and what its table has."""
    centre = albedo.directional_albedo(model, 1.0, rtol=1e-10)
    return {
        "n_u": n_u,
        "n_v": n_v,
        "centre": float(centre.value),
        "centre_error": float(centre.error),
        "lowest": float(sphere.value.min()),
        "lowest_error": float(sphere.error.max()),
        "highest": float(sphere.value.max()),
        "highest_error": float(sphere.error.max()),
        "interpolated_to": off,
    }


def alternatives(samples: int) -> pd.DataFrame:
    """The albedo of n = 10 in three ways, and what would have to differ for 68 percent."""
    from scipy.optimize import brentq

    model = lobe(N, N)
    found = albedo.directional_albedo(model, 1.0, rtol=1e-10)
    exact, error = float(found.value), float(found.error)
    closed = albedo_at_normal(N)
    drawn = albedo.monte_carlo_albedo(model, 1.0, samples=samples, seed=SEED)
    spread = float(drawn.error) * math.sqrt(samples)
    exponent = brentq(lambda n: albedo_at_normal(n) - PRINTED, 1.0, 100.0, xtol=1e-13)
    # By secants: the albedo falls with the angle of incidence from the centre on.
    cosine = brentq(
        lambda c: float(albedo.directional_albedo(model, c, rtol=1e-11).value) - PRINTED,
        *(0.5, 1.0),
        xtol=1e-11,
    )
    mean = albedo.average_albedo(model, rtol=1e-8)
    # With r_s below 1 the albedo is r_s times that of r_s = 1, and the rest times that of r_s = 0.
    dark = albedo.directional_albedo(lobe(N, N).replace(r_s=0.0), 1.0, rtol=1e-10)
    lowest = float(dark.value)
    r_s = (PRINTED - lowest) / (exact - lowest)
    rows = [
        ("quadrature", exact, error, "bound"),
        ("closed form", closed, 16.0 * EPS, "bound"),
        ("draws of the lobe", float(drawn.value), float(drawn.error), "standard error"),
        ("standard deviation of one draw", spread, 2.0 * spread / math.sqrt(samples), "estimate"),
        ("draws that leave one standard error of the difference",
         (spread / (exact - PRINTED)) ** 2,
         4.0 * (spread / (exact - PRINTED)) ** 2 / math.sqrt(samples), "estimate"),
        ("exponent with 0.68 at the centre", exponent, 1e-11, "bound"),
        ("R_s with 0.68 at the centre", r_s, 10.0 * (error + float(dark.error)), "bound"),
        ("distance from the centre with 0.68, in radii", math.sqrt((1.0 - cosine) * (1.0 + cosine)),
         1e-9, "bound"),
        ("mean over the whole disc", float(mean.value), float(mean.error), "bound"),
        ("nearest of 255 grey levels to the albedo", round(255.0 * exact) / 255.0, 4.0 * EPS,
         "bound"),
    ]  # fmt: skip
    return pd.DataFrame(rows, columns=["quantity", "value", "value_error", "kind"])


def judge(context: Context, readings: pd.DataFrame) -> None:
    """Is the centre at about 68 percent?"""
    rows = readings.set_index("quantity")

    def shown(quantity: str) -> str:
        return format_value(rows.value[quantity], rows.value_error[quantity])

    exact, error = rows.value["quadrature"], rows.value_error["quadrature"]
    context.claim(
        "A2",
        "In uniform light the centre of the sphere with n_u = n_v = 10 has about 68 percent of the "
        "background's radiance.",
        value=exact,
        error=error,
        criterion=f"= {PRINTED:g} +- 0.005",
        quantity="albedo at normal incidence, R_s = 1",
        figure="furnace",
        table="readings",
    )
    context.note(
        f"Three ways to the centre: {shown('quadrature')} by quadrature, {shown('closed form')} in "
        f"closed form, {shown('draws of the lobe')} by draws."
    )
    context.explain(
        "A2",
        "At normal incidence n.k2 = 2 (n.h)^2 - 1, and the albedo is the integral of (n + 1) x^n "
        f"(2 x^2 - 1) from sqrt(1/2) to 1: {shown('closed form')} for n = 10, which quadrature and "
        "draws confirm. That is nearly 70 percent, not 68. The difference is "
        f"{exact - PRINTED:.4f}, {255.0 * (exact - PRINTED):.0f} of 255 grey levels, more than "
        "rounding a pixel can do. If the paper's number was read off an image that was made with "
        f"random draws, noise can: one draw has a standard deviation of "
        f"{rows.value['standard deviation of one draw']:.3f}, so that with "
        f"{rows.value['draws that leave one standard error of the difference']:.0f} draws for a "
        "pixel a difference like this is one standard error. Away from the centre the sphere "
        "darkens, and has 68 percent at "
        f"{rows.value['distance from the centre with 0.68, in radii']:.3f} of its radius; the "
        "number may also be one of that region. An exponent of "
        f"{rows.value['exponent with 0.68 at the centre']:.2f} in place of 10, or R_s = "
        f"{rows.value['R_s with 0.68 at the centre']:.4f} in place of 1, would have 68 percent at "
        "the centre. Which of these it was cannot be told from the paper. That a lobe this wide "
        "loses about a third of the light stands either way.",
    )


def draw(pictures: dict[tuple[float, float], np.ndarray], spheres: pd.DataFrame) -> Figure:
    """All spheres on white, with the albedos of their centres."""
    from matplotlib import colormaps
    from matplotlib.figure import Figure as NewFigure
    from matplotlib.patches import Circle

    values = {
        pair: (row.centre, row.centre_error)
        for row in spheres.itertuples()
        for pair in ((row.n_u, row.n_v), (row.n_v, row.n_u))
    }
    count = len(EXPONENTS)
    grey = colormaps["gray"]
    with plotting.style():
        figure = NewFigure(figsize=(6.5, 7.1), layout="constrained")
        grid = figure.subplots(count, count)
        for j, n_v in enumerate(EXPONENTS[::-1]):
            for i, n_u in enumerate(EXPONENTS):
                axes = grid[j, i]
                image = axes.imshow(
                    pictures[n_u, n_v],
                    cmap=grey,
                    vmin=0.0,
                    vmax=1.0,
                    extent=(-1.0, 1.0, -1.0, 1.0),
                    interpolation="nearest",
                )
                rim = Circle((0.0, 0.0), 1.0, fill=False, color="#999999", linewidth=0.5)
                axes.add_patch(rim)
                image.set_clip_path(rim)
                value, error = values[n_u, n_v]
                axes.text(
                    *(0.0, 0.0),
                    format_value(value, max(error, 1e-6)),
                    ha="center",
                    va="center",
                    fontsize=9.0,
                    color="white" if value < 0.6 else "black",
                )
                axes.set_xticks([])
                axes.set_yticks([])
                axes.grid(visible=False)
                axes.spines[:].set_visible(False)
                axes.set_xlim(-1.06, 1.06)
                axes.set_ylim(-1.06, 1.06)
                if i == 0:
                    axes.set_ylabel(f"$n_v$ = {n_v:g}")
                if j == count - 1:
                    axes.set_xlabel(f"$n_u$ = {n_u:g}")
        bar = figure.colorbar(
            image, ax=grid, orientation="horizontal", shrink=0.7, aspect=40, pad=0.02
        )
        bar.set_label("radiance over that of the background")
    return figure
