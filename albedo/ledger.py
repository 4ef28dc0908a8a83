"""What the studies say about every claim, in one row each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Row:
    """A claim, its verdict, and the measurements that the verdict comes from."""

    id: str
    paper: str
    says: str
    where: str
    verdict: str
    why: str = ""
    pending: str = ""
    parts: tuple[dict[str, Any], ...] = ()
    explanations: tuple[str, ...] = ()
    seconds: float = 0.0
