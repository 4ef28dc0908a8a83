"""Lewis 1993: Phong's and Blinn's lobes normalised, by a constant or at every incidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Self

from albedo.brdf import Choice, Model, Part, Real
from albedo.catalogue.blinn import Blinn
from albedo.catalogue.phong import Phong


class Lewis(Model):
    """f = rho_s X^n / I, X = n.h or r.v (Lewis 1993).

    Only the abstract was within reach, so both readings of its normalisation are here. ``constant``
    takes for I the integral I_n(0) at normal incidence: the reciprocal Blinn and Phong models.
    ``per_incidence`` takes I_n(theta_L), the integral of X^n (n.v) over all views: the albedo is
    rho_s everywhere, and the model is not reciprocal, as Schwenk sect. 3.1 says. I_n is tabulated
    by quadrature, and the error of the table is part of every bound.
    """

    name = "lewis"
    title = "Lewis' normalised lobes"
    equation = "Lewis 1993; Schwenk sect. 3.1"
    references = ("lewis1993", "schwenk2011", "giesen2009")
    tables = ("n=1..1e6/32log,reading=per_incidence",)
    domain = "n=0.001..1e9/61log"

    n = Real(80.0, "exponent", low=0.0, high=1e9)
    rho_s = Real(1.0, "albedo at normal incidence", low=0.0, high=1.0)
    reading = Choice(
        "constant", "where the lobe is normalised", choices=("constant", "per_incidence")
    )
    lobe = Choice("half_vector", "X: n.h or r.v", choices=("half_vector", "mirror"))

    @property
    def reciprocal(self) -> bool:  # type: ignore[override]
        """Dividing by an integral that depends on L alone is not symmetric."""
        return self.reading == "constant"

    @property
    def _lobe(self) -> Any:
        """The model that is normalised by a constant."""
        return Blinn if self.lobe == "half_vector" else Phong

    def pack(self) -> tuple[float, ...]:
        kind = self._lobe(n=self.n, rho_s=self.rho_s)
        return tuple(kind.pack())

    @classmethod
    def prepare(cls, models: Sequence[Self]) -> None:
        """Tabulate the integrals of all that are divided by one at every incidence."""
        from albedo.operators.normalize import per_incidence_ahead

        for lobe in (Blinn, Phong):
            per_incidence_ahead(
                [
                    lobe(n=model.n)
                    for model in models
                    if model.reading == "per_incidence" and model._lobe is lobe
                ]
            )

    def parts(self) -> tuple[Part, ...]:
        (part,) = self._lobe(n=self.n).parts()
        if self.reading == "constant":
            return (part,)
        # Here, because operators stand above the models.
        from albedo.operators.normalize import per_incidence

        return (replace(part, **per_incidence(part.fill, self._lobe(n=self.n))),)
