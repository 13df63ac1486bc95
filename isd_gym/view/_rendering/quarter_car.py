"""Picture of a quarter car: a wheel on a rolling road, the suspension with the names of its parts, and the body."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from . import corner, wheel
from .canvas import number
from .corner import Suspension
from .palette import MUTED, WHITE, Colour, mix
from .road import Window, ground, reference_height, rulers

if TYPE_CHECKING:
    from .canvas import Canvas
    from .corner import Words
    from .snapshots import Snapshot

# Lengths in units of the layout (a pixel at 640x400), at static equilibrium.
METRE = 40.0  # length of a metre of road
FLOOR = 58.0  # distance from the foot of the picture to the road
CARRIER = 9.0  # distance from the top of the tyre to the wheel carrier
BODY = 40.0
SCALE = wheel.RADIUS / wheel.METRES  # length of a metre of motion without exaggeration


class QuarterCarScene:
    """A quarter car on its road, in a part of the picture [px]; names of elements are written where it is
    `roomy`."""

    most = 6.0  # largest exaggeration of motions

    def __init__(
        self, canvas: Canvas, snapshot: Snapshot, left: float, width: float, colour: Colour, roomy: bool
    ) -> None:
        """Use a part of the picture."""
        self.canvas, self.shot, self.left, self.width, self.colour = canvas, snapshot, left, width, colour
        self.roomy = roomy
        self.u = canvas.unit
        self.height = canvas.frame.get_height()
        self.x = left + width / 2
        behind = snapshot.road_behind
        profile, step = snapshot.road_profile, snapshot.road_step
        if behind is None:
            behind = (profile.size - 1) * step / 2
        self.window = Window(left, left + width, self.height, self.x, METRE * self.u)
        self.road = self.window.heights(profile, step, behind)
        self.contact = float(np.interp(0.0, np.arange(profile.size) * step - behind, profile))
        self.reference = reference_height(self.road, self.contact)

    def needed(self, reference: float) -> float:
        """Return the largest motion about the mean height of the road [m], as a share of its range without exaggeration."""
        shot = self.shot
        demands = [
            (float(np.abs(self.road - reference).max()), 30.0),
            (abs(shot.body - reference), 28.0),
            (abs(shot.wheel - self.contact), 20.0),
            *corner.demands(shot),
        ]
        return max(motion * SCALE / room for motion, room in demands)

    def paint(self, reference: float, factor: float) -> None:
        """Draw the car about the mean height of the road [m], with motions exaggerated by a factor."""
        c, u, shot = self.canvas, self.u, self.shot
        scale = factor * wheel.RADIUS * u / wheel.METRES  # [px/m]
        floor = self.height - FLOOR * u
        road_y = floor - (self.road - reference) * scale
        contact_y = floor - (self.contact - reference) * scale
        hub = floor - (wheel.RADIUS - wheel.SQUASH) * u - (shot.wheel - reference) * scale
        carrier = hub - (wheel.RADIUS + CARRIER) * u
        rest = floor - (2 * wheel.RADIUS - wheel.SQUASH + CARRIER + corner.LENGTH) * u
        seat = rest - (shot.body - reference) * scale  # underside of the body

        c.clip(self.left, 0, self.width, self.height)
        wheel.tyre(c, self.x, hub, contact_y, u, lifted=shot.has_lifted)
        ground(c, self.window, road_y, shot.speed * shot.time, u)
        # rolls with the drawn road
        wheel.side_rim(c, self.x, hub, u, shot.speed * shot.time * METRE / wheel.RADIUS)
        reach = 66 * u
        wheel.carrier(c, self.x, hub, carrier, reach, u, u)
        c.text(
            "wheel", self.x + reach, carrier + 10 * u,
            size=9.5, colour=MUTED, face="Oblique", anchor="right",
        )  # fmt: skip
        words: Words = "all" if self.roomy else "nodes"
        Suspension(c, shot, self.x, unit=u, scale=scale, words=words).paint(seat, carrier)
        self._body(seat)
        c.clip()
        load = f"dynamic tyre load {number(shot.tyre_load / 1e3, 2)} kN"
        c.text(load, self.x, self.height - 26 * u, size=9.5, anchor="center")
        rulers(c, self.window, scale, factor)

    def _body(self, seat: float) -> None:
        c, u, label = self.canvas, self.u, self.shot.label
        half, top = 88 * u, seat - BODY * u
        fill = mix(WHITE, self.colour, 0.16)
        c.framed(fill, self.colour, self.x - half, top, 2 * half, BODY * u, line=2 * u, radius=7 * u)
        c.text(label, self.x, top + 15 * u, size=13, face="Bold", anchor="center", room=2 * (half - 8 * u))
        c.text(
            "body", self.x, top + (30 if label else 20) * u,
            size=9.5, colour=MUTED, face="Oblique", anchor="center",
        )  # fmt: skip
