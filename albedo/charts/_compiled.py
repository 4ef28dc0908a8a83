"""What charts share whose nodes are laid out by a kernel."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from albedo._compile import kernel

Kernel = Callable[..., None]
Nodes = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


class CompiledChart:
    """A chart whose nodes are laid out by a kernel, here or from inside other kernels.

    Attributes
    ----------
    around : {"none", "smooth", "entire"}
        Panels from u = 0 to 1 are halves of something periodic, even about both ends and with its
        peaks there, that is analytic around the ring, or has no singularities but those of the
        chart. ``none`` promises nothing.
    """

    around: str = "none"

    @property
    def layout(self) -> tuple[Kernel, np.ndarray]:
        """The kernel, and the numbers that it needs to know of the chart.

        ``kernel(geometry, code, box, u, v, numbers, wi, wo, h, weight)`` fills the last four, in
        the shapes of what `nodes` returns.
        """
        raise TypeError(f"{type(self).__name__} must implement layout")

    def nodes(
        self,
        geometry: np.ndarray,
        code: np.ndarray,
        box: np.ndarray,
        u: np.ndarray,
        v: np.ndarray,
    ) -> Nodes:
        """Directions and Jacobians at the nodes (u, v) of panels.

        Parameters
        ----------
        geometry, code, box : ndarray, shape (m, ...)
            Panels, with the geometry of the row of each.
        u, v : ndarray, shape (p,) and (q,)
            Nodes in (0, 1).

        Returns
        -------
        wi : ndarray, shape (3, m)
        wo, h : ndarray, shape (3, m, p * q)
            Outgoing direction, and wi + wo without cancellation.
        weight : ndarray, shape (m, p * q)
            n.v dV / (du dv); dV / (du dv) in charts of energies lost rather than reflected.
        """
        panels, count = box.shape[0], u.size * v.size
        wo, h = np.empty((3, panels, count)), np.empty((3, panels, count))
        found = np.empty((3, panels)), wo, h, np.empty((panels, count))
        kernel, numbers = self.layout
        kernel(geometry, code, box, u, v, numbers, *found)
        return found


@kernel
def clustered(t, power):
    """A place in (0, 1) and its slope, nodes clustered at the start (1), the end (2) or both (3),
    or with a fourth power at the end (4)."""
    if power == 1:
        return t * t, 2.0 * t
    if power == 2:
        return t * (2.0 - t), 2.0 * (1.0 - t)
    if power == 3:
        return t * t * (3.0 - 2.0 * t), 6.0 * t * (1.0 - t)
    if power == 4:
        left = (1.0 - t) * (1.0 - t)
        return 1.0 - left * left, 4.0 * left * (1.0 - t)
    return t, 1.0
