"""Special functions that no kernel can call, by the names of them in other arithmetic."""

from __future__ import annotations

from typing import Any


def bessel_j(order: Any, x: Any) -> Any:
    """J_order(x), for arrays that broadcast, by scipy."""
    from scipy.special import jv

    return jv(order, x)
