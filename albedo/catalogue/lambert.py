"""Lambert 1760: the ideal diffuse reflector."""

from __future__ import annotations

import math

from albedo._compile import kernel
from albedo.brdf import Model, Part, Real
from albedo.charts.cosine import CosineChart


@kernel
def fill(wi, wo, h, p, out):
    """f = rho / pi."""
    for j in range(out.shape[0]):
        for i in range(out.shape[1]):
            out[j, i] = p[j, 0] / math.pi


@kernel
def loss(wi, wo, h, p, out):
    """(1 - rho) n.v / pi, whose unit integral is that of n.v / pi."""
    for j in range(out.shape[0]):
        for i in range(out.shape[1]):
            out[j, i] = (1.0 - p[j, 0]) / math.pi


class Lambert(Model):
    """f = rho / pi (Lambert 1760): the same radiance in every direction."""

    name = "lambert"
    title = "Lambert's ideal diffuse reflector"
    equation = "Lambert 1760"
    references = ("lambert1760",)
    tables = ("rho=0..1/32",)
    domain = "rho=0..1/11"

    rho = Real(1.0, "albedo", low=0.0, high=1.0)

    def pack(self) -> tuple[float, ...]:
        return (self.rho,)

    def parts(self) -> tuple[Part, ...]:
        return (Part("diffuse", fill, CosineChart(), loss=loss, loss_chart=CosineChart()),)
