"""The panel at the right of a picture: time, speed, currents, cost and live curves."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .canvas import Canvas, number
from .curves import SECONDS, History, Scale, plot
from .palette import CAR_COLOURS, INK, MUTED, PALE, PULL, PUSH, STEEL_FAR

if TYPE_CHECKING:
    from collections.abc import Sequence

    from .snapshots import CarSnapshot, CornerSnapshot

CELL = 25.0  # height of a corner's current [units of the layout]


class Panel:
    """The panel of one car or of two between two edges [px], including the memory of the curves."""

    def __init__(
        self, canvas: Canvas, left: float, right: float, height: float, cars: int
    ) -> None:
        """Use the right part of the picture."""
        self.canvas = canvas
        self.x0 = left + 14 * canvas.unit
        self.x1 = right - 14 * canvas.unit
        self.height = height
        self._histories = [History() for _ in range(cars)]
        self._scales: dict[str, Scale] = {}

    def add(self, shots: Sequence[CarSnapshot]) -> None:
        """Append the values of the snapshots to the curves."""
        for history, shot in zip(self._histories, shots, strict=True):
            history.add(shot)

    def paint(self, shots: Sequence[CarSnapshot]) -> None:
        """Draw the panel."""
        c = self.canvas
        u = self.canvas.unit
        x0 = self.x0
        x1 = self.x1
        first = shots[0]
        c.text(
            f"{number(first.time, 2, sign=False)} s", x0, 18 * u, size=13, face="Bold"
        )
        kmh = number(3.6 * first.speed, 0, sign=False)
        speed = f"{number(first.speed, 0, sign=False)} m/s ({kmh} km/h)"
        c.text(speed, x1, 18 * u, size=10, colour=MUTED, anchor="right")
        y = 40 * u
        y = self._one_car(first, y) if len(shots) == 1 else self._two_cars(shots, y)
        traces = [trace for trace, _ in first.traces]
        data = [history.array() for history in self._histories]
        each = (self.height - y - 22 * u) / len(traces)
        for column, trace in enumerate(traces, start=1):
            scale = self._scales.setdefault(trace.title, Scale(trace.scale))
            plot(c, (x0, y, x1, y + each - 12 * u), trace, scale, data, column)
            y += each
        foot = y - 5 * u
        axis = x0 + 26 * u
        c.text(f"−{SECONDS:g} s", axis, foot, size=9.5, colour=MUTED)
        c.text("now", x1, foot, size=9.5, colour=MUTED, anchor="right")
        c.text(
            "isd-gym",
            (axis + x1) / 2,
            self.height - 9 * u,
            size=9,
            colour=STEEL_FAR,
            anchor="center",
        )

    def _one_car(self, shot: CarSnapshot, y: float) -> float:
        c = self.canvas
        u = self.canvas.unit
        x0 = self.x0
        x1 = self.x1
        c.text(
            "Motor current" if len(shot.corners) == 1 else "Motor currents",
            x0,
            y,
            size=11,
        )
        limits = sorted(
            {
                corner.current_limit
                for corner in shot.corners
                if corner.current_limit is not None
            }
        )
        words = ", ".join(f"±{limit:g} A" for limit in limits)
        c.text(words, x1, y, size=10, colour=MUTED, anchor="right")
        y = _currents(c, x0, x1, y + 17 * u, shot.corners)
        if limits:
            c.text("− pushes apart", x0, y, size=9.5, colour=MUTED)
            c.text("pulls together +", x1, y, size=9.5, colour=MUTED, anchor="right")
        y += 22 * u
        if shot.cost is not None:
            c.text("Mean cost so far", x0, y, size=11)
            c.text(
                number(shot.cost, 3, sign=False),
                x1,
                y,
                size=11,
                anchor="right",
                face="Bold",
            )
        return y + 26 * u

    def _two_cars(self, shots: Sequence[CarSnapshot], y: float) -> float:
        c = self.canvas
        u = self.canvas.unit
        x0 = self.x0
        x1 = self.x1
        for shot, colour in zip(shots, CAR_COLOURS, strict=True):
            c.rect(colour, x0, y - 4.5 * u, 9 * u, 9 * u, radius=2 * u)
            width = 0.0
            if shot.cost is not None:
                words = f"cost {number(shot.cost, 3, sign=False)}"
                width = c.text(words, x1, y, size=10, anchor="right")
            c.text(
                shot.label,
                x0 + 14 * u,
                y,
                size=11,
                face="Bold",
                room=x1 - x0 - 20 * u - width,
            )
            y = _currents(c, x0, x1, y + 16 * u, shot.corners) + 6 * u
        return y


def _currents(
    c: Canvas, x0: float, x1: float, y: float, corners: Sequence[CornerSnapshot]
) -> float:
    """Draw the current of each corner in a top view of the car with the front at the top, and return the foot [px]."""
    u = c.unit
    sides = sorted({corner.y for corner in corners}, reverse=True)
    axles = sorted({corner.x for corner in corners}, reverse=True)
    gap = 12 * u
    width = (x1 - x0 - gap * (len(sides) - 1)) / len(sides)
    for corner in corners:
        left = x0 + sides.index(corner.y) * (width + gap)
        top = y + axles.index(corner.x) * CELL * u
        words = f"{number(corner.current, 2)} A"
        colour = INK
        if corner.current_limit is None:
            words, colour = "no motor", MUTED
        taken = c.text(
            words, left + width, top, size=9.5, anchor="right", colour=colour
        )
        c.text(
            corner.name.replace("_", " "),
            left,
            top,
            size=9.5,
            room=width - taken - 4 * u,
        )
        _bar(c, left, left + width, top + 7.5 * u, corner)
    return y + len(axles) * CELL * u


def _bar(c: Canvas, x0: float, x1: float, top: float, corner: CornerSnapshot) -> None:
    u = c.unit
    height = 6 * u
    c.rect(PALE, x0, top, x1 - x0, height, radius=1.5 * u)
    if corner.current_limit is None:
        return
    middle = (x0 + x1) / 2
    reach = float(np.clip(corner.current / corner.current_limit, -1, 1)) * (x1 - x0) / 2
    colour = PULL if reach >= 0 else PUSH
    c.rect(colour, min(middle, middle + reach), top, max(abs(reach), 0.5 * u), height)
    c.rect(INK, middle - 0.5 * u, top - 2 * u, u, height + 4 * u)
