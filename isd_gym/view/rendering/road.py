"""The road in a picture: heights over the width, the ground below, and rulers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .palette import GROUND, GROUND_FAR, GROUND_MARK, INK, MUTED, STEEL_FAR

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .canvas import Canvas

MARKS = 2.0  # distance of two marks on the ground [m]


@dataclass(frozen=True)
class Window:
    """A part of the picture with a road from the side."""

    left: float  # left edge [px]
    right: float  # right edge [px]
    foot: float  # lower edge [px]
    origin: float  # position of distance 0 along the road [px]
    metre: float  # length of a metre of road [px]

    def columns(self) -> NDArray[np.float64]:
        """Return the positions [px] at which the road is drawn, one every two pixels."""
        return np.linspace(self.left, self.right, int((self.right - self.left) / 2) + 1)

    def heights(
        self, profile: NDArray[np.float64], step: float, behind: float
    ) -> NDArray[np.float64]:
        """Return the heights (n,) [m] at `columns` of a profile (m,) [m], one every `step` [m] from `behind`
        [m] the origin."""
        place = np.arange(profile.size) * step - behind
        return np.interp((self.columns() - self.origin) / self.metre, place, profile)


def reference_height(heights: NDArray[np.float64], contact: float) -> float:
    """Return the mean of heights (n,) [m] of the road, which the camera follows.

    The weights vanish towards the edges, for a smooth motion. Heights are relative to the height under the
    wheel, so that rounding does not depend on the altitude of the road.
    """
    weight = np.hanning(heights.size + 2)[1:-1]
    return contact + float((heights - contact) @ weight / weight.sum())


def ground(
    c: Canvas,
    window: Window,
    y: NDArray[np.float64],
    travelled: float | None,
    u: float,
    *,
    is_behind: bool = False,
) -> None:
    """Draw the ground below a road with heights y (n,) [px] at the columns of the window: from the side with
    marks that show the driven distance [m], or a section across (None). It is pale if another road is in
    front."""
    x = window.columns()
    surface = np.column_stack([x, y])
    below = np.vstack(
        [surface, [[window.right, window.foot], [window.left, window.foot]]]
    )
    c.polygon(GROUND_FAR if is_behind else GROUND, below)
    if travelled is not None and not is_behind:
        _marks(c, window, y, travelled, u)
    if is_behind:
        c.lines(STEEL_FAR, surface, u)
    else:
        c.polygon(
            INK, np.vstack([surface - [0, 0.6 * u], surface[::-1] + [0, 2.2 * u]])
        )


def _marks(
    c: Canvas, window: Window, y: NDArray[np.float64], travelled: float, u: float
) -> None:
    x = window.columns()
    offset = travelled % MARKS
    first = (
        math.floor((window.left - window.origin) / window.metre / MARKS) * MARKS
        - offset
    )
    last = (window.right - window.origin) / window.metre + MARKS
    for place in np.arange(first, last, MARKS).tolist():
        at = window.origin + place * window.metre
        top = float(np.interp(at, x, y)) + 4 * u
        c.polygon(
            GROUND_MARK,
            [
                (at, top),
                (at + 7 * u, top),
                (at - 1 * u, top + 11 * u),
                (at - 8 * u, top + 11 * u),
            ],
        )


def rulers(c: Canvas, window: Window, scale: float, factor: float) -> None:
    """Draw a vertical ruler of motions with their exaggeration at the left, and a metre of road at the right."""
    u = c.unit
    margin, foot = 10 * u, window.foot - 11 * u
    tall = next(
        (mm for mm in (10, 20, 50, 100, 200, 500, 1000) if mm * 1e-3 * scale > 8 * u),
        2000,
    )
    rise = tall * 1e-3 * scale
    x, y = window.left + margin, window.foot - 6 * u
    for a, b in ((y - rise, y - rise), (y, y)):
        c.rect(MUTED, x - 2.5 * u, a - 0.5 * u, 5 * u, b - a + u)
    c.rect(MUTED, x - 0.5 * u, y - rise, u, rise)
    words = f"{tall} mm, vertical ×{factor:g}"
    c.text(words, x + 6 * u, foot, size=9.5, colour=MUTED)
    run, right = window.metre, window.right - margin
    for edge in (right - run, right):
        c.rect(MUTED, edge - 0.5 * u, foot - 2.5 * u + 4 * u, u, 5 * u)
    c.rect(MUTED, right - run, foot + 3.5 * u, run, u)
    c.text(
        "1 m", right - run / 2, foot - 4 * u, size=9.5, colour=MUTED, anchor="center"
    )
