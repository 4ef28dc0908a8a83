"""Which of the reflectance models in figure 1 lose their light at grazing incidence?

The paper shows four directional albedos against the angle of incidence, with a Fresnel factor of
one, and says that those of Phong, He-Torrance and Ward "badly decrease" for larger angles. It does
not say whether He-Torrance's mirror term is part of its curve, so both readings are computed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

import albedo
from albedo import plotting
from albedo.analysis.grazing import first_above_one
from albedo.estimate import Estimate, format_value
from albedo.grammar import parse
from albedo.studies import Study

if TYPE_CHECKING:
    from albedo.studies import Context

STUDY = Study(
    name="nns_fig1",
    title="Four albedos against the angle of incidence",
    paper="NNS",
    figure="Figure 1",
    claims=("N2",),
)

# Column, label, model, part: None is the whole model.
CURVES = (
    ("phong", "Phong, n = 150", "phong:n=150", None),
    ("he_torrance", "He-Torrance, σ₀ = 0.1, τ = 1.7", "he_torrance:sigma0=0.1,tau=1.7", None),
    (
        "he_torrance_diffuse",
        "He-Torrance without its mirror term",
        "he_torrance:sigma0=0.1,tau=1.7",
        "directional_diffuse",
    ),
    ("cook_torrance", "Cook-Torrance, m = 0.1", "cook_torrance:m=0.1", None),
    ("ward", "Ward, m = 0.1", "ward:m=0.1", None),
)
# The models of which the paper says that their albedo badly decreases, and how it is read here.
DECREASING = ("phong", "he_torrance", "he_torrance_diffuse", "ward")
READINGS = {
    "he_torrance": "with the mirror term",
    "he_torrance_diffuse": "without the mirror term",
}
BADLY = 0.5


def run(context: Context) -> None:
    """Compute the curves on both axes, and judge the decrease."""
    rtol = 1e-10 if context.full else 1e-8
    context.setting(rtol=rtol)
    smallest = 1e-12 if context.full else 1e-6
    angles = evaluate(context, plotting.angle_grid(), rtol, "angles")
    grazing = evaluate(context, plotting.grazing_grid(smallest), rtol, "grazing angles")

    summary = summarise(angles, grazing, smallest)
    context.table("summary", summary, "Where each curve is lowest and highest")
    for name, cos_theta, curves, caption in (
        ("by_angle", plotting.angle_grid(), angles, "Albedos on the axis of the paper"),
        ("by_cosine", plotting.grazing_grid(smallest), grazing, "Albedos towards grazing angles"),
    ):
        context.table(name, as_frame(cos_theta, curves), caption)

    ward = parse("ward:m=0.1").model()
    crossing = first_above_one(ward, plotting.grazing_grid(smallest), grazing["ward"])
    for sentence in sentences(summary, crossing):
        context.note(sentence)
    draw(context, angles, grazing, smallest, crossing)

    labels = {spec: label for _, label, spec, part in CURVES if part is None}
    for column, _, spec, _ in CURVES:
        if column in DECREASING:
            value, error = relative_minimum(angles[column])
            context.claim(
                "N2",
                f"{labels[spec]}: the albedo badly decreases for larger angles of incidence.",
                value=value,
                error=error,
                criterion=f"< {BADLY}",
                quantity="lowest albedo on the axis of the figure, over that at normal incidence",
                reading=READINGS.get(column, ""),
            )


def evaluate(
    context: Context, cos_theta: np.ndarray, rtol: float, what: str
) -> dict[str, Estimate]:
    """Albedos of all curves; a model with two readings is computed once."""
    whole: dict[str, Estimate] = {}
    curves = {}
    for done, (column, label, spec, part) in enumerate(CURVES):
        context.progress(done, len(CURVES), f"{label}, {what}")
        if spec not in whole:
            whole[spec] = albedo.directional_albedo(parse(spec).model(), cos_theta, rtol=rtol)
        curves[column] = whole[spec] if part is None else whole[spec].parts[part]
    return curves


def as_frame(cos_theta: np.ndarray, curves: dict[str, Estimate]) -> pd.DataFrame:
    """One row for every angle, three columns for every curve."""
    columns: dict[str, Any] = {
        "theta_deg": np.degrees(np.arccos(cos_theta)),
        "cos_theta": cos_theta,
    }
    for column, estimate in curves.items():
        columns[column] = estimate.value
        columns[f"{column}_error"] = estimate.error
        columns[f"{column}_evaluations"] = estimate.evaluations
    return pd.DataFrame(columns)


def summarise(
    angles: dict[str, Estimate], grazing: dict[str, Estimate], smallest: float
) -> pd.DataFrame:
    """Extremes over the angles of the figure, and the value at the smallest cosine."""
    theta = np.degrees(np.arccos(plotting.angle_grid()))
    rows = []
    for column, label, _, _ in CURVES:
        value, error = angles[column].value, angles[column].error
        low, high = int(np.argmin(value)), int(np.argmax(value))
        end = grazing[column]
        rows.append(
            {
                "curve": label,
                "normal": value[0],
                "normal_error": error[0],
                "lowest": value[low],
                "lowest_error": error[low],
                "lowest_at_deg": theta[low],
                "highest": value[high],
                "highest_error": error[high],
                "highest_at_deg": theta[high],
                f"cos={smallest:g}": end.value[-1],
                f"cos={smallest:g}_error": end.error[-1],
            }
        )
    return pd.DataFrame(rows)


def relative_minimum(estimate: Estimate) -> tuple[float, float]:
    """Smallest value over the first one, with the bound of the quotient."""
    low = int(np.argmin(estimate.value))
    value, error = float(estimate.value[low]), float(estimate.error[low])
    first, first_error = float(estimate.value[0]), float(estimate.error[0])
    ratio = value / first
    return ratio, (error + ratio * first_error) / (first - first_error)


def sentences(summary: pd.DataFrame, crossing: tuple[float, float] | None) -> list[str]:
    """What the figure shows, in words around the numbers."""
    rows = summary.set_index("curve")
    labels = [label for _, label, _, _ in CURVES]
    text = [
        "What is left of the albedo at normal incidence, at worst: "
        + "; ".join(
            f"{label}: {rows.lowest[label] / rows.normal[label]:.1%} "
            f"at {rows.lowest_at_deg[label]:.1f}°"
            for label in labels
        )
        + "."
    ]
    above = [
        f"{label} reaches {rows.highest[label]:.4f} at {rows.highest_at_deg[label]:.1f}°"
        for label in labels
        if rows.highest[label] - rows.highest_error[label] > 1.0
    ]
    if above:
        text.append("On this axis more is reflected than arrives: " + "; ".join(above) + ".")
    if crossing is not None:
        cosine, width = crossing
        theta = 90.0 - np.degrees(np.arcsin(cosine))
        last = np.degrees(np.arccos(plotting.angle_grid()[-1]))
        seen = "beyond" if theta > last else "before"
        text.append(
            f"Ward's albedo passes one at cos θ = {format_value(cosine, width)}, which is "
            f"{theta:.4f}°, {seen} the {last:.1f}° at which the figure in degrees ends."
        )
    return text


def draw(
    context: Context,
    angles: dict[str, Estimate],
    grazing: dict[str, Estimate],
    smallest: float,
    crossing: tuple[float, float] | None,
) -> None:
    """The figure on the paper's axis, and again on logarithmic axes."""
    captions = {
        "by_angle_figure": "Directional albedo against the angle of incidence, Fresnel factor 1; "
        "the grey line is an albedo of one.",
        "by_cosine_figure": f"The same curves in the cosine, down to {smallest:g}."
        + ("" if crossing is None else f" Ward's passes one at cos θ = {crossing[0]:.3g}."),
    }
    for name, cos_theta, curves, log in (
        ("by_angle_figure", plotting.angle_grid(), angles, False),
        ("by_cosine_figure", plotting.grazing_grid(smallest), grazing, True),
    ):
        drawn = [
            plotting.Curve(
                label=label,
                name=parse(spec).name,
                cos_theta=cos_theta,
                value=curves[column].value,
                error=curves[column].error,
            )
            for column, label, spec, _ in CURVES
        ]
        context.figure(name, plotting.draw(drawn, grazing=log), captions[name])
