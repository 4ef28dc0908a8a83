"""What does recursive pumping-up do to the reciprocal Blinn model with n = 20?

As for Phong in the figure before: every step gains light and none makes any, a < a* < 1, and after
several steps the surface may look brighter than it should. Read here: brighter than the lobe at
normal incidence ever is, or brightest beside the mirror direction.

The output radiance is f(L, V) n.l, that of a source whose rays carry unit irradiance on a plane
across them. Its unit is the largest one of the lobe before any step at normal incidence, which is
the constant of the model: a mirror with the same blur would show that much at any incidence.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import albedo
from albedo.analysis import pumped_figures
from albedo.studies import Study

if TYPE_CHECKING:
    from albedo.studies import Context

STUDY = Study(
    name="nns_fig4",
    title="Blinn, recursively pumped up",
    paper="NNS",
    figure="Figure 4",
    claims=("N6", "N8"),
)


def run(context: Context) -> None:
    """Albedos and output radiances after every step, and what the paper says of them."""
    pumped_figures.recursive(context, albedo.model("blinn", n=20), "Blinn's lobe")
