"""What does controlled pumping-up do to the reciprocal Blinn model with n = 20?

The paper says that the control keeps the output radiance below what comes in, that the albedo
converges to a limit below 1, and that for Blinn's lobe nothing is gained after the first step.

The control of NNS eq. 21 can be read in two ways, and both are measured. Literally, each step
divides the last BRDF by max(a(L), a(V), N.L, N.V). Cumulatively, all steps together never divide
by less than max(N.L, N.V).

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
    name="nns_fig6",
    title="Blinn, pumped up under control",
    paper="NNS",
    figure="Figure 6",
    claims=("N9", "N10"),
)


def run(context: Context) -> None:
    """Albedos and output radiances after every step, and what the paper says of them."""
    pumped_figures.controlled(
        context,
        albedo.model("blinn", n=20),
        "Blinn's lobe",
        worth=("Only the first step gains anything", "= 1 +- 0"),
        gains_from=2,
    )
