"""Papers that studies are about: their figures and their claims."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PaperFigure:
    """A figure of a paper, and why it is not reproduced yet, if it is not."""

    number: str
    caption: str
    pending: str = ""


@dataclass(frozen=True)
class PaperClaim:
    """Something that a paper asserts and a number can settle."""

    id: str
    says: str
    where: str
    pending: str = ""


@dataclass(frozen=True)
class Paper:
    """A paper with its figures and its claims."""

    key: str
    title: str
    authors: str
    year: int | None
    about: str
    figures: tuple[PaperFigure, ...] = ()
    claims: tuple[PaperClaim, ...] = ()
