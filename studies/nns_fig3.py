"""What does recursive pumping-up do to the reciprocal Phong model with n = 20?

The paper shows the albedo and the output radiance after each step. It says that every step gains
light and none makes any, a < a* < 1, and that after several steps the surface may look brighter
than it should. Read here: brighter than the lobe at normal incidence ever is, or brightest beside
the mirror direction.

The output radiance is f(L, V) n.l, that of a source whose rays carry unit irradiance on a plane
across them. Its unit is the largest one of the lobe before any step at normal incidence,
(n + 2)/(2π): a mirror with the same blur would show that much at any incidence.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import albedo
from albedo.analysis import pumped_figures
from albedo.studies import Study

if TYPE_CHECKING:
    from albedo.studies import Context

STUDY = Study(
    name="nns_fig3",
    title="Phong, recursively pumped up",
    paper="NNS",
    figure="Figure 3",
    claims=("N6", "N8"),
)


def run(context: Context) -> None:
    """Albedos and output radiances after every step, and what the paper says of them."""
    pumped_figures.recursive(context, albedo.model("phong", n=20), "Phong's lobe")
