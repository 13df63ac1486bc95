"""Common parts of the sections: names of the cars, pieces of a page, shared results."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from ...view.report.plots import Picture as PagePicture
from ...view.report.plots import as_picture

if TYPE_CHECKING:
    from pathlib import Path

SCHEMA = "isd-reproduction/1"
KIND = "reproduction"
PARTS = ("index.html", "reproduction.json", "*.svg")
SERIES, PRINTED = "quarter-car-isd", "quarter-car-eq8"
RIG, RIG_PRINTED = "force-rig", "force-rig-eq6"
AMPLITUDE = 0.01  # m, Table 2
FREQUENCIES = (2.0, 4.0, 6.0, 8.0, 10.0)  # Hz, section 3.2
INERTANCE = 95.0  # kg, Table 6
TABLE_4 = {"oil.stiffness": 709e3, "leak.damping": 1293.0}
NAMES = ("acceleration", "travel", "tyre load")
Progress = Callable[[str, float], None]


@dataclass
class Table:
    """A table of texts.

    Attributes:
        title: Title.
        heads: Column headings.
        rows: Cells.
        note: Note below the table.
        texts: Indices of left-aligned columns.
        wrap: Whether the first column may wrap.
    """

    title: str
    heads: Sequence[str]
    rows: list[Sequence[str]]
    note: str = ""
    texts: Sequence[int] = (0,)
    wrap: bool = False


@dataclass
class Section:
    """A section of the page.

    Attributes:
        title: Title.
        text: Paragraphs.
        tables: Tables.
        pictures: Pictures.
    """

    title: str
    text: list[str] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)
    pictures: list[PagePicture] = field(default_factory=list)


@dataclass
class Claim:
    """A claim of the paper.

    Attributes:
        place: Place in the paper.
        says: The claim.
        found: The result.
        verdict: The verdict.
    """

    place: str
    says: str
    found: str
    verdict: str


@dataclass
class Study:
    """Results that the sections share.

    Attributes:
        folder: Folder of the pictures.
        quick: Whether few and short episodes are driven.
        progress: Called with a task and its finished share.
        figures: Figures by section.
        claims: Claims so far.
        evidence: Rows of the table of evidence.
    """

    folder: Path
    quick: bool
    progress: Progress
    figures: dict[str, Any] = field(default_factory=dict)
    claims: list[Claim] = field(default_factory=list)
    evidence: list[Sequence[str]] = field(default_factory=list)

    def picture(
        self, fig: Any, name: str, title: str, alt: str, caption: str
    ) -> PagePicture:
        """Save a figure, and return the picture of a page.

        Args:
            fig: The figure.
            name: Stem of the file name.
            title: Title.
            alt: Text for readers who cannot see the figure.
            caption: Caption.

        Returns:
            The picture.
        """
        made = as_picture(fig, name, title, alt, caption)
        made.save(self.folder)
        return made
