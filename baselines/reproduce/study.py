"""What the sections share: the names of the cars, the pieces of a page, what has been found so far."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from isd_gym.report.plots import Picture as PagePicture
from isd_gym.report.plots import (
    embedded,
    pixels,
    save,
)

if TYPE_CHECKING:
    from pathlib import Path

SCHEMA = "isd-reproduction/1"
KIND = "reproduction"
PARTS = ("index.html", "reproduction.json", "*.png")
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
    """Cells as text. `texts`: columns set flush left; `wrap`: the first column may break."""

    title: str
    heads: Sequence[str]
    rows: list[Sequence[str]]
    note: str = ""
    texts: Sequence[int] = (0,)
    wrap: bool = False


@dataclass
class Section:
    title: str
    text: list[str] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)
    pictures: list[PagePicture] = field(default_factory=list)


@dataclass
class Claim:
    """One claim: where it stands in the paper, what it says, what was found, and the verdict."""

    place: str
    says: str
    found: str
    verdict: str


@dataclass
class Study:
    """What the sections share: where pictures go, how much work to do, the figures and claims so far."""

    folder: Path
    quick: bool
    progress: Progress
    figures: dict[str, Any] = field(default_factory=dict)
    claims: list[Claim] = field(default_factory=list)
    evidence: list[Sequence[str]] = field(default_factory=list)

    def picture(self, fig: Any, name: str, title: str, alt: str, caption: str) -> PagePicture:
        data = embedded(save(fig, self.folder / f"{name}.png"))
        return PagePicture(f"{name}.png", title, alt, caption, data, pixels(fig))
