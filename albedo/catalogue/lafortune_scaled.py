"""Phong's lobe with its vertical component scaled, so that it leans towards the horizon."""

from __future__ import annotations

from albedo.brdf import Model, Part, Real
from albedo.catalogue._lafortune import fill, lobe_layout, lobe_numbers, lobe_routine
from albedo.catalogue.lafortune import Lafortune


class LafortuneScaled(Model):
    """f = rho_s c(n, s) max(0, r.x v.x + r.y v.y + s r.z v.z)^n (NNS eq. 7).

    The paper leaves c(n, s) open. Here c = 1 / max over theta of the integral of the lobe, so that
    the albedo is at most rho_s, and reaches it. It is found by quadrature; its error is part of
    every bound. At s = 1 it is (n + 2)/(2 pi) and the model is Phong's.
    """

    name = "lafortune_scaled"
    title = "Lafortune's lobe scaled along the normal"
    equation = "NNS eq. 7"
    references = ("neumann_pumping", "lafortune1997")
    tables = ("s=0.9..1/32",)
    domain = "n=1..100/13log,s=0.9..1/11"

    n = Real(20.0, "exponent", low=0.0, high=1e9)
    s = Real(0.95, "scale of the vertical component", low=0.0, high=1.0, open_low=True)
    rho_s = Real(1.0, "largest albedo", low=0.0, high=1.0)

    @property
    def normalization(self) -> tuple[float, float]:
        """c(n, s) in 1/sr, and its relative error."""
        # Here, because operators stand above the models.
        from albedo.operators.normalize import largest_albedo

        largest, error = largest_albedo(Lafortune(lobes=((-1.0, -1.0, self.s, self.n),)))
        return 1.0 / largest, error

    def pack(self) -> tuple[float, ...]:
        constant, _ = self.normalization
        return lobe_numbers((-1.0, -1.0, self.s), self.n, self.rho_s * constant)

    def parts(self) -> tuple[Part, ...]:
        _, error = self.normalization
        layout = lobe_layout((-1.0, -1.0, self.s), self.n)
        routine = lobe_routine((-1.0, -1.0, self.s), self.n)
        return (Part("specular", fill, *layout, doubt=error, routine=routine),)
