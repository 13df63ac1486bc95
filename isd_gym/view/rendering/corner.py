"""The suspension of a corner: spring, damper and hydraulic device between the body and a wheel.

Lengths are in units of the layout at static equilibrium.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from .palette import (
    INK,
    MUTED,
    OIL,
    ORANGE,
    PALE,
    PULL,
    PUSH,
    STEEL,
    VERMILLION,
    Colour,
    mix,
)
from .symbols import arrow, coil, dashpot

if TYPE_CHECKING:
    from .canvas import Anchor, Canvas
    from .snapshots import CornerSnapshot

OIL_SPRING, DEVICE, DAMPER = 18.0, 73.0, 99.0
LENGTH = OIL_SPRING + DEVICE + DAMPER
# range of motion in each direction
DEVICE_STROKE, DAMPER_STROKE, LONE_DAMPER_STROKE = (
    18.5,
    29.0,
    45.0,
)
OIL_STROKE = 10.0
#: extent of the suspension to the left and right of the wheel; the motor's cylinder is at the right
LEFT, RIGHT = 73.0, 92.0
CYLINDER = 0.05  # stroke of the main cylinder (Table 1) [m], drawn if no stop ends the travel before
Words = Literal["all", "nodes", ""]


def demands(corner: CornerSnapshot) -> list[tuple[float, float]]:
    """Return the motions of a corner [m] and their ranges in each direction [units of the layout]."""
    top = corner.body if corner.joint is None else corner.joint
    stroke = LONE_DAMPER_STROKE if corner.joint is None else DAMPER_STROKE
    return [
        (abs(corner.device_travel or 0.0), DEVICE_STROKE),
        (abs(top - corner.wheel), stroke),
        (
            abs(
                corner.body
                - (corner.piston if corner.piston is not None else corner.body)
            ),
            OIL_STROKE,
        ),
    ]


class Suspension:
    """The suspension of a corner in a picture, over the wheel at x [px]; a metre of motion has the length
    `scale` [px]."""

    def __init__(
        self,
        canvas: Canvas,
        corner: CornerSnapshot,
        x: float,
        *,
        unit: float,
        scale: float,
        words: Words = "",
        is_rear: bool = False,
    ) -> None:
        """Store position and size of the suspension."""
        self.canvas = canvas
        self.corner = corner
        self.x = x
        self.u = unit
        self.scale = scale
        self.words, self.is_rear = words, is_rear

    @property
    def spring_place(self) -> float:
        """Distance of the main spring to the left of the wheel [units of the layout]."""
        return 36.0 if self.is_rear else 58.0

    def paint(
        self, seat: float, carrier: float, spring_seat: float | None = None
    ) -> None:
        """Draw the suspension between the body's underside (over the wheel, over the spring) and the wheel's carrier."""
        spring_seat = seat if spring_seat is None else spring_seat
        c, u, corner = self.canvas, self.u, self.corner
        coil(
            c, self.x - self.spring_place * u, spring_seat, carrier, 15 * u, 8, 3.0 * u
        )
        if corner.joint is None:
            dashpot(c, self.x, seat, carrier, LENGTH * u, LONE_DAMPER_STROKE * u, u)
            if self.words == "all":
                self._tag("main spring", self.x - 79 * u, (seat + carrier) / 2, "right")
                self._tag("damper", self.x + 20 * u, (seat + carrier) / 2, "left")
            return
        if self.words == "all":
            self._tag("main spring", self.x - 79 * u, (seat + carrier) / 2, "right")
        joint = carrier - DAMPER * u - (corner.joint - corner.wheel) * self.scale
        self._device(seat, joint)
        dashpot(c, self.x, joint, carrier, DAMPER * u, DAMPER_STROKE * u, u)
        if self.words == "all":
            self._tag("damper", self.x + 20 * u, carrier - 0.4 * DAMPER * u, "left")

    def _name(self, words: str, x: float, y: float) -> None:
        """Write the name of a node."""
        self.canvas.text(words, x, y, size=9.5, colour=MUTED, face="Oblique")

    def _tag(self, words: str, x: float, y: float, anchor: Anchor) -> None:
        """Write the name of an element."""
        self.canvas.text(words, x, y, size=9.5, colour=MUTED, anchor=anchor)

    def _device(self, seat: float, joint: float) -> None:
        """Draw oil spring, main cylinder (rod: piston, barrel: joint), and the motor's cylinder at its side."""
        c = self.canvas
        u = self.u
        x = self.x
        corner = self.corner
        travel = corner.device_travel
        assert travel is not None
        node = joint - DEVICE * u - travel * self.scale
        if corner.piston is None:
            c.rect(STEEL, x - 2 * u, seat, 4 * u, max(0.0, node - seat))
        else:
            coil(
                c,
                x,
                seat,
                node,
                9 * u,
                4,
                2.2 * u,
                stub=1.5 * u,
                colours=(mix(ORANGE, INK, 0.25), OIL),
            )
            if self.words == "all":
                self._tag("oil spring", x + 15 * u, seat + 6.5 * u, "left")

        # main cylinder
        foot, bore = 6 * u, (2 * DEVICE_STROKE + 8) * u
        top = joint - foot - bore
        c.rect(STEEL, x - 2.5 * u, joint - foot - u, 5 * u, foot + u)
        c.framed(OIL, INK, x - 13 * u, top, 26 * u, bore, line=1.6 * u, radius=2.5 * u)
        piston = joint - foot - bore / 2 - travel * self.scale
        c.rect(STEEL, x - 2 * u, node, 4 * u, piston - node)
        c.rect(INK, x - 11.4 * u, piston - 2.5 * u, 22.8 * u, 5 * u)

        if not self.is_rear:
            self._motor(top, bore, travel)
        c.circle(INK, x, node, 3 * u)
        c.circle(INK, x, joint, 3 * u)
        if self.words:
            self._name("piston", x + 7 * u, node)
            self._name("joint", x + 7 * u, joint)
        if corner.current_limit is not None:
            aside = 25 if self.is_rear else -25
            self._thrust(x + aside * u, (node + joint) / 2)

    def _motor(self, top: float, bore: float, travel: float) -> None:
        """Draw the motor's (deputy) cylinder at the side of the main cylinder.

        Oil that the rising piston displaces at the top moves the mover to the right, so that extension is to
        the right; the ends of the cylinder are the end stop (paper, Table 1).
        """
        c = self.canvas
        u = self.u
        x = self.x
        corner = self.corner
        left, width, high = x + 24 * u, 68 * u, 19 * u
        middle = top + bore / 2
        pipe = 3.5 * u
        for colour, w in ((INK, pipe), (OIL, pipe - 2 * u)):
            y = top + 6 * u
            c.rect(colour, x + 12 * u, y - w / 2, left - x - 12 * u + 6 * u + w / 2, w)
            c.rect(colour, left + 6 * u - w / 2, y - w / 2, w, middle - y)
            y = top + bore - 6 * u
            c.rect(
                colour,
                x + 12 * u,
                y - w / 2,
                left + width - 6 * u - x - 12 * u + w / 2,
                w,
            )
            c.rect(colour, left + width - 6 * u - w / 2, middle, w, y - middle + w / 2)
        limit = corner.device_travel_limit
        share = travel / (limit or CYLINDER)
        touching = limit is not None and abs(share) > 0.985
        if corner.current_limit is not None:
            colour = self._current_colour()
            force = min(1.0, abs(corner.current) / corner.current_limit)
            winding = mix(PALE, colour, 0.15 + 0.85 * force if force else 0.0)
            for k in range(5):
                place = left + 13 * u + k * 9 * u
                c.framed(
                    winding,
                    STEEL,
                    place,
                    middle - high / 2 - 4 * u,
                    6 * u,
                    high + 8 * u,
                    line=0.8 * u,
                    radius=1.5 * u,
                )
        c.framed(
            OIL, INK, left, middle - high / 2, width, high, line=1.6 * u, radius=2.5 * u
        )
        if limit is not None:
            for side in (0, 1):
                hit = touching and (share > 0) == bool(side)
                c.rect(
                    VERMILLION if hit else INK,
                    left + side * (width - 4 * u),
                    middle - high / 2,
                    4 * u,
                    high,
                )
        mover = 14 * u
        centre = (
            left
            + width / 2
            + float(np.clip(share, -1.02, 1.02)) * (width / 2 - 4 * u - mover / 2)
        )
        c.rect(
            INK,
            centre - mover / 2,
            middle - high / 2 + 2.2 * u,
            mover,
            high - 4.4 * u,
            radius=1.5 * u,
        )
        # gauge: position of the mover between the stops, as travel of the device
        if limit is not None:
            reach = width / 2 - 4 * u - mover / 2
            y = top + bore + 16 * u
            dial = left + width / 2
            c.rect(MUTED, dial - reach, y - 0.4 * u, 2 * reach, 0.8 * u)
            for place in (-reach, 0.0, reach):
                c.rect(MUTED, dial + place - 0.4 * u, y - 2.5 * u, 0.8 * u, 5 * u)
            c.polygon(
                VERMILLION if touching else INK,
                [(centre, y), (centre - 3 * u, y - 5 * u), (centre + 3 * u, y - 5 * u)],
            )
            if self.words:
                words = f"±{1e3 * limit:.4g} mm"
                c.text(
                    words,
                    dial,
                    y + 9 * u,
                    size=9.5,
                    colour=VERMILLION if touching else MUTED,
                    anchor="center",
                )
        if self.words == "all":
            rows = (
                ("inerter", "and motor")
                if corner.current_limit is not None
                else ("inerter",)
            )
            for row, word in enumerate(rows):
                self._tag(
                    word,
                    left + width + 7 * u,
                    middle + (12 * row - 6 * (len(rows) - 1)) * u,
                    "left",
                )

    def _current_colour(self) -> Colour:
        return PULL if self.corner.current >= 0 else PUSH

    def _thrust(self, x: float, middle: float) -> None:
        """Draw the force of the motor on the terminals: converging arrows for a pull, diverging arrows for a push."""
        c, u, corner = self.canvas, self.u, self.corner
        assert corner.current_limit is not None
        share = min(1.0, abs(corner.current) / corner.current_limit)
        if share < 0.02:
            return
        length = (6 + 24 * share) * u
        for side in (-1, 1):
            near = middle + side * 4 * u
            far = middle + side * (4 * u + length)
            tail, head = (far, near) if corner.current > 0 else (near, far)
            arrow(c, self._current_colour(), x, tail, head, (3 + 3 * share) * u)
