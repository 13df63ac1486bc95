"""Picture of a car: from the side, and from behind for a car with a left and a right track.

Wheels, wheelbase and track have one scale. Motions are exaggerated vertically by a common factor, so that the
body remains a straight bar: its slope in the picture is the factor times its angle.
"""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from . import corner as suspension
from . import wheel
from .canvas import Canvas, Point, number
from .corner import Suspension, Words
from .palette import INK, MUTED, PALE, WHITE, Colour, mix
from .road import Window, ground, reference_height, rulers

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from .snapshots import CarSnapshot, CornerSnapshot

BEHIND, AHEAD, ASIDE = 1.3, 2.1, 0.65  # road beyond the outermost wheels [m]
# overhang of the body beyond the outermost wheels [m]
OVERHANG, OVERHANG_ASIDE = (
    1.05,
    0.25,
)
# Lengths in units of the layout (a pixel at 640x400), at static equilibrium.
LARGEST_METRE = 90.0
FLOOR = 66.0  # distance from the foot of the picture to the road
# distance from the top of a tyre to its carrier, for a suspension of full size
CARRIER = 9.0
BAR, CABIN = 15.0, 40.0
TOP = 44.0  # free height above the cabin
SMALLEST_SUSPENSION = 0.25  # size relative to that of a quarter car


@dataclass(frozen=True)
class View:
    """A view of a car, from the right side or from behind."""

    shot: CarSnapshot  # the car
    is_rear: bool  # whether the view is from behind
    window: Window  # part of the picture; its origin is the centre of gravity

    def along(self, x: float, y: float) -> float:
        """Return the distance [m] of a point to the right of the centre of gravity in the picture."""
        return -y if self.is_rear else x

    def place(self, corner: CornerSnapshot) -> float:
        """Return the horizontal position of a corner in the picture [px]."""
        return self.window.origin + self.along(corner.x, corner.y) * self.window.metre

    def _depth(self, corner: CornerSnapshot) -> float:
        return corner.x if self.is_rear else corner.y

    @cached_property
    def near(self) -> tuple[CornerSnapshot, ...]:
        """Front corners of the view, from left to right."""
        first: dict[float, CornerSnapshot] = {}
        for corner in sorted(self.shot.corners, key=self._depth):
            first.setdefault(self.along(corner.x, corner.y), corner)
        return tuple(first[along] for along in sorted(first))

    @property
    def far(self) -> tuple[CornerSnapshot, ...]:
        """Corners behind the front corners of the view."""
        return tuple(corner for corner in self.shot.corners if corner not in self.near)

    def body_heights(
        self, along: NDArray[np.float64], *, is_far: bool = False
    ) -> NDArray[np.float64]:
        """Return displacements [m] of the body along its near or its far edge, at distances (n,) [m] to the right."""
        depths = [self._depth(corner) for corner in self.shot.corners]
        depth = max(depths) if is_far else min(depths)
        places = [(depth, -a) if self.is_rear else (a, depth) for a in along.tolist()]
        return np.array([self.shot.height(x, y) for x, y in places])


class CarScene:
    """A car on its road, in a part of the picture [px]; parts of a single suspension are named where it is `roomy`."""

    most = 10.0  # largest exaggeration of motions

    def __init__(
        self,
        canvas: Canvas,
        snapshot: CarSnapshot,
        left: float,
        width: float,
        colour: Colour,
        roomy: bool,
    ) -> None:
        """Use a part of the picture."""
        self.words: Words = ""
        if len(snapshot.corners) == 1:
            self.words = "all" if roomy else "nodes"
        self.canvas = canvas
        self.shot = snapshot
        self.left = left
        self.width = width
        self.colour = colour
        self.u = canvas.unit
        self.height = canvas.frame.get_height()
        self._lay_out()
        self.contacts = {
            corner: self._road_under(corner) for corner in snapshot.corners
        }
        base = float(np.mean(list(self.contacts.values())))
        window = self.views[0].window
        step = snapshot.road_step
        behind = snapshot.road_behind - max(corner.x for corner in snapshot.corners)
        self.roads = [
            window.heights(profile, step, behind) for profile in snapshot.road_profiles
        ]
        self.reference = float(
            np.mean([reference_height(road, base) for road in self.roads])
        )

    def _lay_out(self) -> None:
        """Divide the picture among the views, and compute the size of the parts."""
        shot, u = self.shot, self.u
        x = [corner.x for corner in shot.corners]
        y = [corner.y for corner in shot.corners]
        has_side = shot.is_long or not shot.is_wide
        side = max(x) - min(x) + BEHIND + AHEAD if has_side else 0.0
        rear = max(y) - min(y) + 2 * ASIDE if shot.is_wide else 0.0
        self.metre = min(self.width / (side + rear), LARGEST_METRE * u)
        middle = self.left + self.width * side / (side + rear)
        views = []
        if has_side:
            spare = (middle - self.left) / self.metre - side
            origin = self.left + (BEHIND + spare / 2 - min(x)) * self.metre
            views.append(
                View(
                    shot,
                    False,
                    Window(self.left, middle, self.height, origin, self.metre),
                )
            )
        if shot.is_wide:
            right = self.left + self.width
            origin = (middle + right) / 2 + (max(y) + min(y)) / 2 * self.metre
            views.append(
                View(shot, True, Window(middle, right, self.height, origin, self.metre))
            )
        self.views = views
        self.wheel_unit = wheel.METRES * self.metre / wheel.RADIUS
        fixed = (FLOOR + BAR + CABIN + TOP) * u + 2 * wheel.METRES * self.metre
        size = min(1.0, (self.height - fixed) / ((suspension.LENGTH + CARRIER) * u))
        apart = np.diff(sorted(set(x)))
        if apart.size:
            reach = (
                2 * suspension.RIGHT
                if len(set(x)) == 2
                else suspension.LEFT + suspension.RIGHT
            )
            size = min(size, float(apart.min()) * self.metre / (1.03 * reach * u))
        self.unit = max(size, SMALLEST_SUSPENSION) * u  # unit of the suspensions

    def _track(self, corner: CornerSnapshot) -> int:
        return int(self.shot.is_wide and corner.y < 0)

    def _road_under(self, corner: CornerSnapshot) -> float:
        """Return the height of the road under a wheel [m]."""
        shot = self.shot
        profile = shot.road_profiles[self._track(corner)]
        place = shot.road_behind + corner.x - max(other.x for other in shot.corners)
        return float(
            np.interp(place, np.arange(profile.size) * shot.road_step, profile)
        )

    def needed(self, reference: float) -> float:
        """Return the largest motion about the mean height of the road [m], as a share of its range without exaggeration."""
        size = self.unit / self.u
        ends = [
            height
            for view in self.views
            for height in view.body_heights(self._ends(view))
        ]
        demands = [(float(np.abs(road - reference).max()), 30.0) for road in self.roads]
        demands += [(abs(height - reference), 28.0) for height in ends]
        for corner in self.shot.corners:
            demands.append((abs(corner.wheel - self.contacts[corner]), 14.0))
            demands += [
                (motion, room * size) for motion, room in suspension.demands(corner)
            ]
        return max(motion * self.metre / self.u / room for motion, room in demands)

    def _ends(self, view: View) -> NDArray[np.float64]:
        """Return the ends of the body in a view, to the right of its centre of gravity [m]."""
        along = [view.along(corner.x, corner.y) for corner in self.shot.corners]
        over = OVERHANG_ASIDE if view.is_rear else OVERHANG
        return np.array([min(along) - over, max(along) + over])

    def paint(self, reference: float, factor: float) -> None:
        """Draw the car about the mean height of the road [m], with motions exaggerated by a factor."""
        c, u = self.canvas, self.u
        self.lift, self.scale = reference, factor * self.metre
        self.floor = self.height - FLOOR * u
        for view in self.views:
            window = view.window
            c.clip(window.left, 0, window.right - window.left, self.height)
            self._far_side(view)
            self._near_side(view)
            c.clip()
            self._words(view)
        whole = Window(
            self.left, self.left + self.width, self.height, self.left, self.metre
        )
        rulers(c, whole, self.scale, factor)
        if len(self.views) > 1:
            c.rect(PALE, self.views[1].window.left - 0.5, 0, 1, self.height)

    # --- heights ----------------------------------------------------------------------------------

    def _down(self, height: float, above: float = 0.0) -> float:
        """Return the position [px] of a point `height` [m] above static equilibrium and `above` [px] above the road."""
        return self.floor - above - (height - self.lift) * self.scale

    def _hub(self, corner: CornerSnapshot) -> float:
        return self._down(corner.wheel, (wheel.RADIUS - wheel.SQUASH) * self.wheel_unit)

    @property
    def _rest(self) -> float:
        """Height of the body's underside above the road at rest [px]."""
        return (2 * wheel.RADIUS - wheel.SQUASH) * self.wheel_unit + (
            CARRIER + suspension.LENGTH
        ) * self.unit

    # --- parts ------------------------------------------------------------------------------------

    def _ground(
        self, view: View, corners: Sequence[CornerSnapshot], *, is_behind: bool
    ) -> None:
        shot, window = self.shot, view.window
        if view.is_rear:
            at = [view.along(corner.x, corner.y) for corner in corners]
            columns = (window.columns() - window.origin) / window.metre
            heights = np.interp(
                columns, at, [self.contacts[corner] for corner in corners]
            )
            travelled = None
        else:
            heights = self.roads[self._track(corners[0])]
            travelled = shot.speed * shot.time
        y = self.floor - (heights - self.lift) * self.scale
        ground(self.canvas, window, y, travelled, self.u, is_behind=is_behind)

    def _tyre(
        self, view: View, corner: CornerSnapshot, colour: Colour = wheel.RUBBER
    ) -> None:
        contact = self._down(self.contacts[corner])
        wheel.tyre(
            self.canvas, view.place(corner), self._hub(corner), contact, self.wheel_unit,
            lifted=corner.has_lifted, colour=colour, is_rear=view.is_rear,
        )  # fmt: skip

    def _far_side(self, view: View) -> None:
        """Draw the far side in pale colours: road, wheels and edge of the body."""
        if not view.far:
            return
        last = max(view.far, key=lambda corner: corner.x if view.is_rear else corner.y)
        behind = [
            c for c in view.far if (c.x == last.x if view.is_rear else c.y == last.y)
        ]
        for corner in behind:
            self._tyre(view, corner, wheel.RUBBER_FAR)
        behind.sort(key=lambda corner: view.along(corner.x, corner.y))
        self._ground(view, behind, is_behind=True)
        self._bar(
            view,
            mix(WHITE, self.colour, 0.06),
            mix(WHITE, self.colour, 0.4),
            is_far=True,
        )

    def _near_side(self, view: View) -> None:
        c, shot = self.canvas, self.shot
        for corner in view.near:
            self._tyre(view, corner)
        self._ground(view, view.near, is_behind=False)
        middle = float(
            np.mean([view.along(corner.x, corner.y) for corner in view.near])
        )
        for corner in view.near:
            x = view.place(corner)
            hub = self._hub(corner)
            carrier = hub - wheel.RADIUS * self.wheel_unit - CARRIER * self.unit
            if not view.is_rear:
                turn = shot.speed * shot.time / wheel.METRES
                wheel.side_rim(c, x, hub, self.wheel_unit, turn)
            reach = (34 if view.is_rear else 66) * self.unit
            wheel.carrier(c, x, hub, carrier, reach, self.unit, self.wheel_unit)
            drawn = Suspension(
                c,
                corner,
                x,
                unit=self.unit,
                scale=self.scale,
                words=self.words,
                is_rear=view.is_rear,
            )
            seat = self._down(corner.body, self._rest)
            is_right = view.along(corner.x, corner.y) > middle
            # from the side, the springs are outside and the motors between the axles; from behind, the
            # springs are inside
            is_mirrored = is_right != view.is_rear
            aside = drawn.spring_place * self.unit * (1 if is_mirrored else -1)
            along = np.array([(x + aside - view.window.origin) / self.metre])
            spring_seat = self._down(float(view.body_heights(along)[0]), self._rest)
            with c.mirrored(x) if is_mirrored else nullcontext():
                drawn.paint(seat, carrier, spring_seat)
        self._body(view)

    def _edge(
        self, view: View, share: float, above: float, *, is_far: bool = False
    ) -> Point:
        """Return a point of the body [px]: at a share of its length, `above` [px] its underside."""
        first, last = self._ends(view)
        along = np.array([first + share * (last - first)])
        height = float(view.body_heights(along, is_far=is_far)[0])
        return view.window.origin + float(along[0]) * self.metre, self._down(
            height, self._rest + above
        )

    def _bar(
        self, view: View, fill: Colour, edge: Colour, *, is_far: bool = False
    ) -> None:
        bar, line = BAR * self.u, 2 * self.u
        aside = line / (float(np.ptp(self._ends(view))) * self.metre)
        for colour, inset, margin in ((edge, 0.0, 0.0), (fill, line, aside)):
            corners = (
                (margin, inset),
                (1 - margin, inset),
                (1 - margin, bar - inset),
                (margin, bar - inset),
            )
            self.canvas.polygon(
                colour, [self._edge(view, s, a, is_far=is_far) for s, a in corners]
            )

    def _body(self, view: View) -> None:
        c, u, shot = self.canvas, self.u, self.shot
        bar, cabin = BAR * u, CABIN * u
        roof = (0.12, 0.24, 0.76, 0.88) if view.is_rear else (0.1, 0.22, 0.6, 0.76)
        above = (0.0, cabin, cabin, 0.0)
        outline = [
            self._edge(view, share, bar + a)
            for share, a in zip(roof, above, strict=True)
        ]
        c.polygon(mix(WHITE, self.colour, 0.06), outline)
        c.lines(mix(WHITE, self.colour, 0.4), outline, 1.2 * u)
        self._bar(view, mix(WHITE, self.colour, 0.16), self.colour)
        for corner in view.near:
            c.circle(
                INK, view.place(corner), self._down(corner.body, self._rest), 2.6 * u
            )
        for x, y in shot.points.values():
            at = view.window.origin + view.along(x, y) * self.metre
            c.circle(INK, at, self._down(shot.height(x, y), self._rest + bar), 2.6 * u)
        _centre_of_gravity(
            c, view.window.origin, self._down(shot.heave, self._rest + bar / 2), 5 * u
        )

    # --- words ------------------------------------------------------------------------------------

    def _words(self, view: View) -> None:
        c, u, window = self.canvas, self.u, view.window
        if len(self.views) > 1:
            titles = (
                ("from behind", "front axle pale")
                if view.is_rear
                else ("from the right", "left side pale")
            )
            for title, down in zip(titles, (16, 29), strict=True):
                self._small(title, (window.left + window.right) / 2, down * u)
        if view is self.views[0]:
            left, right = (self._edge(view, share, BAR * u)[0] for share in (0.22, 0.6))
            x, y = self._edge(view, 0.41, BAR * u + 0.7 * CABIN * u)
            c.text(
                self.shot.label,
                x,
                y,
                size=12,
                face="Bold",
                anchor="center",
                room=right - left,
            )
        self._names_of_points(view)
        self._tyre_loads(view)

    def _small(
        self, words: str, x: float, y: float, *, colour: Colour = MUTED, face: str = ""
    ) -> float:
        return self.canvas.text(
            words, x, y, size=9.5, colour=colour, face=face, anchor="center"
        )

    def _names_of_points(self, view: View) -> None:
        """The names of the body's points, as far as they stand beside each other."""
        window, taken = view.window, view.window.left
        for name, (x, y) in sorted(
            self.shot.points.items(), key=lambda item: view.along(*item[1])
        ):
            words = name.replace("_", " ")
            at = window.origin + view.along(x, y) * self.metre
            half = 3 * len(words) * self.u
            if at - half > taken and at + half < window.right:
                height = self._down(
                    self.shot.height(x, y), self._rest + (BAR + 9) * self.u
                )
                taken = at + self._small(words, at, height, face="Oblique") / 2

    def _tyre_loads(self, view: View) -> None:
        """Name and tyre load of each corner below its wheel, where wheels are not too close."""
        upper = self.height - 42 * self.u
        lower = self.height - 29 * self.u
        names = [(corner, corner.name.replace("_", " ")) for corner in view.near]
        kind = "dynamic tyre load " if len(self.shot.corners) == 1 else ""
        loads = [
            (corner, f"{kind}{number(corner.tyre_load / 1e3, 2)} kN")
            for corner in view.near
        ]
        for row, y, colour in ((names, upper, MUTED), (loads, lower, INK)):
            free = view.window.left
            for corner, words in row:
                half = 2.9 * len(words) * self.u
                x = min(
                    max(view.place(corner), view.window.left + half),
                    view.window.right - half,
                )
                if x - half >= free:
                    free = x + self._small(words, x, y, colour=colour) / 2
        if not view.is_rear and len(view.near) == 2:
            rear, front = (view.place(corner) for corner in view.near)
            if front - rear > 100 * self.u:
                self._small("dynamic", (rear + front) / 2, upper)
                self._small("tyre load", (rear + front) / 2, lower)


def _centre_of_gravity(c: Canvas, x: float, y: float, radius: float) -> None:
    """Draw the symbol of a centre of gravity."""
    c.circle(INK, x, y, radius)
    c.circle(WHITE, x, y, 0.8 * radius)
    for start in (0.0, np.pi):
        angle = np.linspace(start, start + np.pi / 2, 9)
        arc = np.column_stack(
            [x + 0.85 * radius * np.cos(angle), y + 0.85 * radius * np.sin(angle)]
        )
        c.polygon(INK, np.vstack([[[x, y]], arc]))
