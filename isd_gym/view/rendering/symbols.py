"""Symbols of elements: coil spring, dashpot, arrow."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .palette import INK, STEEL, STEEL_FAR, WHITE, Colour, mix

if TYPE_CHECKING:
    from .canvas import Canvas


def coil(
    c: Canvas,
    x: float,
    top: float,
    bottom: float,
    radius: float,
    turns: int,
    line: float,
    *,
    stub: float | None = None,
    colours: tuple[Colour, Colour] = (STEEL, STEEL_FAR),
) -> None:
    """Draw a helix around the axis `x`; `line` is the width of the wire, `stub` the length of the straight ends."""
    near, far = colours
    stub = 2 * line if stub is None else stub
    c.rect(near, x - line / 2, top, line, stub + line / 2)
    c.rect(near, x - line / 2, bottom - stub - line / 2, line, stub + line / 2)
    per = 16
    phase = np.linspace(0.0, 2 * np.pi * turns, per * turns + 1)
    points = np.column_stack(
        [x + radius * np.sin(phase), np.linspace(top + stub, bottom - stub, phase.size)]
    )
    quarter = per // 4
    halves = [
        (k, min(k + per // 2, phase.size - 1))
        for k in range(-quarter, phase.size, per // 2)
    ]
    for front in (False, True):
        for number, (start, stop) in enumerate(halves):
            if (number % 2 == 0) == front:
                part = points[max(start, 0) : stop + 1]
                if len(part) > 1:
                    c.lines(near if front else far, part, line if front else 0.8 * line)
    for start, stop in halves:  # around the turns
        for k in (start, stop):
            if 0 < k < phase.size - 1:
                c.circle(near, points[k, 0], points[k, 1], line / 2)


def dashpot(
    c: Canvas,
    x: float,
    top: float,
    bottom: float,
    length: float,
    stroke: float,
    u: float,
) -> None:
    """Draw cup and plunger of `length` at rest, with a range of `stroke` in each direction."""
    foot, cup, half = 5 * u, 2 * stroke + 4 * u, 12 * u
    rim = bottom - foot - cup
    plate = top + length - foot - cup / 2
    c.rect(STEEL, x - 2 * u, bottom - foot, 4 * u, foot)
    c.rect(mix(WHITE, STEEL_FAR, 0.35), x - half, rim, 2 * half, cup)
    c.rect(INK, x - half, rim, 1.8 * u, cup)
    c.rect(INK, x + half - 1.8 * u, rim, 1.8 * u, cup)
    c.rect(INK, x - half, bottom - foot - 1.8 * u, 2 * half, 1.8 * u)
    c.rect(STEEL, x - 1.7 * u, top, 3.4 * u, plate - top)
    c.rect(INK, x - half + 3 * u, plate - 2 * u, 2 * half - 6 * u, 4 * u)


def arrow(
    c: Canvas, colour: Colour, x: float, tail: float, head: float, width: float
) -> None:
    """Draw a vertical arrow from the height `tail` to the height `head`."""
    way = 1.0 if head > tail else -1.0
    tip = min(abs(head - tail), 2.2 * width)
    neck = head - way * tip
    c.rect(colour, x - width / 2, min(tail, neck), width, abs(neck - tail))
    c.polygon(colour, [(x, head), (x - 1.3 * width, neck), (x + 1.3 * width, neck)])
