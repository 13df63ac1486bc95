"""Claims and pictures of a reproduction, which its parts share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...view.report.plots import Picture, as_picture


@dataclass
class Claim:
    """A claim of the paper.

    Attributes:
        place: Place in the paper.
        says: The claim.
        found: The computed value.
        verdict: The verdict.
    """

    place: str
    says: str
    found: str
    verdict: str


@dataclass
class Study:
    """Results of a reproduction.

    Attributes:
        folder: Folder of the pictures.
        quick: Whether few and short episodes are driven.
        progress: Called with a task and its finished share.
        figures: Computed figures by their place in the paper.
        claims: Claims so far.
        cars: Rows of texts of the table of cars.
        pictures: Pictures so far.
    """

    folder: Path
    quick: bool = False
    progress: Callable[[str, float], None] = lambda task, share: None
    figures: dict[str, Any] = field(default_factory=dict)
    claims: list[Claim] = field(default_factory=list)
    cars: list[list[str]] = field(default_factory=list)
    pictures: list[Picture] = field(default_factory=list)

    def claim(self, place: str, says: str, found: str, verdict: str) -> None:
        """Add a claim of the paper."""
        self.claims.append(Claim(place, says, found, verdict))

    def picture(self, fig: Any, name: str, title: str, caption: str) -> None:
        """Save a figure, and add the figure to the pictures of the page."""
        made = as_picture(fig, name, title, title, caption)
        made.save(self.folder)
        self.pictures.append(made)
