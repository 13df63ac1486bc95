"""The panel at the right of a picture: time, speed, currents, cost and live curves."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .canvas import number
from .curves import SECONDS, History, Scale, plot
from .palette import CAR_COLOURS, INK, MUTED, PALE, PULL, PUSH, STEEL_FAR

if TYPE_CHECKING:
    from collections.abc import Sequence

    from .canvas import Canvas
    from .snapshots import AnySnapshot, CornerSnapshot

CELL = 25.0  # height of a corner's current [units of the layout]


class Panel:
    """The panel of one car or of two between two edges [px], including the memory of the curves."""

    def __init__(self, canvas: Canvas, left: float, right: float, height: float, cars: int) -> None:
        """Use the right part of the picture."""
        self.canvas, self.x0, self.x1 = canvas, left + 14 * canvas.unit, right - 14 * canvas.unit
        self.height = height
        self._histories = [History() for _ in range(cars)]
        self._scales: dict[str, Scale] = {}

    def add(self, shots: Sequence[AnySnapshot]) -> None:
        """Append the values of the snapshots to the curves."""
        for history, shot in zip(self._histories, shots, strict=True):
            history.add(shot)

    def paint(self, shots: Sequence[AnySnapshot]) -> None:
        """Draw the panel."""
        c, u, x0, x1 = self.canvas, self.canvas.unit, self.x0, self.x1
        first = shots[0]
        c.text(f"{number(first.time, 2, sign=False)} s", x0, 18 * u, size=13, face="Bold")
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
        c.text("isd-gym", (axis + x1) / 2, self.height - 9 * u, size=9, colour=STEEL_FAR, anchor="center")

    def _one_car(self, shot: AnySnapshot, y: float) -> float:
        c, u, x0, x1 = self.canvas, self.canvas.unit, self.x0, self.x1
        if len(shot.corners) == 1:
            _current_bar(c, x0, x1, y, shot.corners[0], "Motor current")
            y += 55 * u
        else:
            c.text("Motor currents", x0, y, size=11)
            limits = {corner.current_limit for corner in shot.corners} - {None}
            words = ", ".join(f"±{limit:g} A" for limit in sorted(limits)) or "no motor"  # type: ignore[type-var]
            c.text(words, x1, y, size=10, colour=MUTED, anchor="right")
            y = _currents(c, x0, x1, y + 17 * u, shot.corners)
            if limits:
                c.text("− pushes apart", x0, y, size=9.5, colour=MUTED)
                c.text("pulls together +", x1, y, size=9.5, colour=MUTED, anchor="right")
            y += 22 * u
        if shot.cost is not None:
            c.text("Mean cost so far", x0, y, size=11)
            c.text(number(shot.cost, 3, sign=False), x1, y, size=11, anchor="right", face="Bold")
        return y + 26 * u

    def _two_cars(self, shots: Sequence[AnySnapshot], y: float) -> float:
        c, u, x0, x1 = self.canvas, self.canvas.unit, self.x0, self.x1
        for shot, colour in zip(shots, CAR_COLOURS, strict=True):
            c.rect(colour, x0, y - 4.5 * u, 9 * u, 9 * u, radius=2 * u)
            width = 0.0
            if shot.cost is not None:
                words = f"cost {number(shot.cost, 3, sign=False)}"
                width = c.text(words, x1, y, size=10, anchor="right")
            c.text(shot.label, x0 + 14 * u, y, size=11, face="Bold", room=x1 - x0 - 20 * u - width)
            if len(shot.corners) == 1:
                corner = shot.corners[0]
                _current_text(c, x1, y + 16 * u, corner, 10)
                _bar(c, x0, x1 - 54 * u, y + 16 * u - 3.5 * u, 7 * u, corner)
                y += 38 * u
            else:
                y = _currents(c, x0, x1, y + 16 * u, shot.corners) + 6 * u
        return y


def _currents(c: Canvas, x0: float, x1: float, y: float, corners: Sequence[CornerSnapshot]) -> float:
    """Draw the current of each corner in a top view of the car with the front at the top, and return the foot [px]."""
    u = c.unit
    sides = sorted({corner.y for corner in corners}, reverse=True)
    axles = sorted({corner.x for corner in corners}, reverse=True)
    gap = 12 * u
    width = (x1 - x0 - gap * (len(sides) - 1)) / len(sides)
    for corner in corners:
        left = x0 + sides.index(corner.y) * (width + gap)
        top = y + axles.index(corner.x) * CELL * u
        taken = _current_text(c, left + width, top, corner, 9.5)
        c.text(corner.name.replace("_", " "), left, top, size=9.5, room=width - taken - 4 * u)
        _bar(c, left, left + width, top + 7.5 * u, 6 * u, corner)
    return y + len(axles) * CELL * u


def _current_bar(c: Canvas, x0: float, x1: float, y: float, corner: CornerSnapshot, title: str) -> None:
    u = c.unit
    c.text(title, x0, y, size=11)
    if corner.current_limit is None:
        c.text("no motor", x1, y, size=11, colour=MUTED, anchor="right")
    else:
        c.text(f"{number(corner.current, 2)} A", x1, y, size=11, anchor="right", face="Bold")
    _bar(c, x0, x1, y + 12 * u, 10 * u, corner)
    if corner.current_limit is not None:
        foot, limit = y + 32 * u, f"{corner.current_limit:g}"
        c.text(f"−{limit} A  pushes apart", x0, foot, size=9.5, colour=MUTED)
        c.text(f"pulls together  +{limit} A", x1, foot, size=9.5, colour=MUTED, anchor="right")


def _current_text(c: Canvas, x: float, y: float, corner: CornerSnapshot, size: float) -> float:
    """Write the current of a corner up to x, and return the width of the text [px]."""
    words = "no motor" if corner.current_limit is None else f"{number(corner.current, 2)} A"
    colour = MUTED if corner.current_limit is None else INK
    return c.text(words, x, y, size=size, anchor="right", colour=colour)


def _bar(c: Canvas, x0: float, x1: float, top: float, height: float, corner: CornerSnapshot) -> None:
    u = c.unit
    c.rect(PALE, x0, top, x1 - x0, height, radius=1.5 * u)
    middle = (x0 + x1) / 2
    if corner.current_limit is not None:
        reach = float(np.clip(corner.current / corner.current_limit, -1, 1)) * (x1 - x0) / 2
        c.rect(
            PULL if reach >= 0 else PUSH, min(middle, middle + reach), top, max(abs(reach), 0.5 * u), height
        )
        c.rect(INK, middle - 0.5 * u, top - 2 * u, u, height + 4 * u)
