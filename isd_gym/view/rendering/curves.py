"""Live curves: the last seconds of a quantity of one car or of two."""

from __future__ import annotations

import itertools
import math
from collections import deque
from typing import TYPE_CHECKING

import numpy as np

from .canvas import Canvas, number
from .palette import CAR_COLOURS, MUTED, PALE, STEEL_FAR

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from .snapshots import CarSnapshot, Trace

SECONDS = 4.0  # length of the curves


class History:
    """Values of the last `SECONDS` of one car, in the units of the plots."""

    def __init__(self) -> None:
        self.rows: deque[tuple[float, ...]] = deque()

    def add(self, snapshot: CarSnapshot) -> None:
        """Append the values of a snapshot and of its unknown earlier moments."""
        known = self.rows[-1][0] if self.rows else -math.inf
        factors = [trace.factor for trace, _ in snapshot.traces]
        between = [row for row in snapshot.past if known < row[0] < snapshot.time]
        for time, *values in (
            *between,
            (snapshot.time, *(value for _, value in snapshot.traces)),
        ):
            self.rows.append(
                (time, *(f * v for f, v in zip(factors, values, strict=True)))
            )
        while self.rows[0][0] < snapshot.time - SECONDS:
            self.rows.popleft()

    def array(self) -> NDArray[np.float64]:
        """Return time [s] and values (n, 1 + traces)."""
        flat = itertools.chain.from_iterable(self.rows)
        width = len(self.rows[0])
        return np.fromiter(flat, np.float64, width * len(self.rows)).reshape(-1, width)


class Scale:
    """Range of a plot: three units in each direction, with ticks at two; the unit is 1, 2 or 4 times a power of ten."""

    def __init__(self, unit: float) -> None:
        self.unit = unit

    def hold(self, peak: float) -> None:
        """Widen the range until it holds a value."""
        while peak > 3.0 * self.unit:
            decade = 10.0 ** math.floor(math.log10(self.unit) + 1e-9)
            step = round(self.unit / decade)
            self.unit = decade * {1: 2, 2: 4, 4: 10}[step]


def plot(
    c: Canvas,
    box: tuple[float, float, float, float],
    trace: Trace,
    scale: Scale,
    data: Sequence[NDArray[np.float64]],
    column: int,
) -> None:
    """Draw a live plot into a box (left, top, right, foot) [px]: its title with the RMS, and the curves
    below.

    `data` has time [s] and values in the units of the plots of each car (n, columns); the range of the
    axis widens if necessary.
    """
    u = c.unit
    x0, y0, x1, y1 = box
    scale.hold(max(float(np.abs(rows[:, column]).max()) for rows in data))
    place = (
        x1 - c.text(trace.unit, x1, y0, size=10, colour=MUTED, anchor="right") - 4 * u
    )
    for rows, colour in reversed(list(zip(data, CAR_COLOURS, strict=False))):
        rms = float(np.sqrt(np.mean(rows[:, column] ** 2)))
        digits = max(0, min(trace.digits, 2 - math.floor(math.log10(max(rms, 1e-9)))))
        words = number(rms, digits, sign=False)
        place -= (
            c.text(
                words, place, y0, size=10, face="Bold", colour=colour, anchor="right"
            )
            + 6 * u
        )
    place -= c.text("RMS", place + 2 * u, y0, size=10, colour=MUTED, anchor="right")
    c.text(
        trace.title, x0, y0, size=11 if len(data) == 1 else 10, room=place - 4 * u - x0
    )
    left, top = x0 + 26 * u, y0 + 14 * u
    right, bottom = x1, y1
    middle = (top + bottom) / 2
    unit_height = (bottom - top) / 2 / 3.0
    c.rect((247, 248, 249), left, top, right - left, bottom - top)
    for tick in (-2, 0, 2):
        y = middle - tick * unit_height
        c.rect(
            STEEL_FAR if tick == 0 else PALE, left, y - 0.4 * u, right - left, 0.8 * u
        )
        c.text(
            number(tick * scale.unit, 0) if tick else "0",
            left - 5 * u,
            y,
            size=9.5,
            colour=MUTED,
            anchor="right",
        )
    c.clip(left, top, right - left, bottom - top)
    now = max(rows[-1, 0] for rows in data)
    # the first curve is behind the second
    for rows, colour, line in zip(data, CAR_COLOURS, (1.9, 1.3), strict=False):
        if len(rows) > 1:
            x = right - (now - rows[:, 0]) / SECONDS * (right - left)
            y_values = middle - rows[:, column] / scale.unit * unit_height
            c.lines(
                colour,
                np.column_stack([x, y_values]),
                (line if len(data) > 1 else 1.4) * u,
            )
    c.clip()
