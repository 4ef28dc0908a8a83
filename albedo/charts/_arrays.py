"""What the charts share."""

from __future__ import annotations

import numpy as np

Nodes = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def blank(panels: int, count: int) -> Nodes:
    """Arrays for wi (3, panels), wo and h (3, panels, count) and weights (panels, count)."""
    wi, weight = np.empty((3, panels)), np.empty((panels, count))
    return wi, np.empty((3, panels, count)), np.empty((3, panels, count)), weight
