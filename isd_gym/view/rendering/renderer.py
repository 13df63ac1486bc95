"""Frames of one car or of two cars side by side, as arrays or in a window."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Literal

from ..._common.errors import InputError
from .backend import NO_WINDOW, pygame, start_display
from .canvas import Canvas
from .car import CarScene
from .palette import CAR_COLOURS, PALE, SKY_LOW, SKY_TOP, WHITE, mix
from .panel import Panel

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    from .snapshots import CarSnapshot

EXAGGERATION = (10.0, 8.0, 6.0, 4.0, 3.0, 2.0, 1.0, 0.5, 0.2, 0.1, 0.05, 0.02)


class Renderer:
    """Frames of one car, or of two cars of one kind side by side, as arrays ("rgb_array") or in a window
    ("human").

    In a window, `draw` keeps the pace of the simulated time. Calls that are faster than `fps` per
    simulated second, at most 60, enter the curves without a new frame, so that a 5 ms control loop may
    call `draw` at every step.

    Scales only widen over time, for larger motions. A snapshot that is earlier than the last one restarts
    the curves. `closed` tells whether the viewer has closed the window.
    """

    def __init__(
        self,
        mode: Literal["human", "rgb_array"],
        *,
        width: int = 960,
        height: int = 600,
        cars: int = 1,
        fps: float = 50.0,
    ) -> None:
        self.mode = mode
        self.width = width
        self.height = height
        self.cars = cars
        self.fps = fps
        self.closed = False
        self._now = self._painted = -math.inf  # simulated time [s]
        self._pg = pygame()
        self._unit = min(width / 640, height / 400)  # the layout is defined for 640x400
        self._window: Any = None
        if mode == "human":
            self._open_window()
        self._canvas = Canvas(self._pg, width, height, self._unit)
        panel = (268 if cars == 1 else 236) * self._unit
        self._scene_width = (width - panel) / cars
        self._paint_backdrop()
        self._restart()

    def draw(self, *snapshots: CarSnapshot) -> NDArray[np.uint8] | None:
        """Paint the cars; return the frame (height, width, 3) uint8 in mode "rgb_array"."""
        now = snapshots[0].time
        if now < self._now:
            self._restart()
        self._panel.add(snapshots)
        since, self._now = now - self._painted, now
        if self.mode == "human" and (
            self.closed or since < (1 - 1e-6) / min(self.fps, 60.0)
        ):
            return None
        self._painted = now
        self._paint(snapshots)
        if self.mode == "rgb_array":
            return self._canvas.pixels()
        self._show(since)
        return None

    def close(self) -> None:
        """Close the window, if any; afterwards the renderer cannot be used in mode "human"."""
        if self._window is not None:
            self._pg.display.quit()
            self._window = None
        self.closed = True

    # --- window -----------------------------------------------------------------------------------

    def _open_window(self) -> None:
        start_display(self._pg)
        try:
            self._window = self._pg.display.set_mode((self.width, self.height))
        except self._pg.error as error:
            raise InputError(
                NO_WINDOW.format(str(error).strip().splitlines()[0])
            ) from None
        self._pg.display.set_caption("isd-gym")
        self._clock = self._pg.time.Clock()

    def _show(self, since: float) -> None:
        for event in self._pg.event.get():
            if event.type == self._pg.QUIT or (
                event.type == self._pg.KEYDOWN
                and event.key in (self._pg.K_ESCAPE, self._pg.K_q)
            ):
                self.close()
                return
        self._window.blit(self._canvas.frame, (0, 0))
        self._pg.display.flip()
        if since < 1.0:
            self._clock.tick(1.0 / since)

    # --- picture ----------------------------------------------------------------------------------

    def _restart(self) -> None:
        self._now = self._painted = -math.inf
        left = self._scene_width * self.cars
        self._panel = Panel(self._canvas, left, self.width, self.height, self.cars)
        self._factor = 0  # index into EXAGGERATION

    def _paint_backdrop(self) -> None:
        canvas = self._canvas
        width = self._scene_width * self.cars
        for y in range(2 * self.height):
            canvas.row(
                y, 2 * width, mix(SKY_TOP, SKY_LOW, min(1.0, y / (1.6 * self.height)))
            )
        canvas.rect(WHITE, width, 0, self.width - width, self.height)
        canvas.keep_backdrop()

    def _paint(self, snapshots: Sequence[CarSnapshot]) -> None:
        canvas = self._canvas
        canvas.start()
        views = []
        for index, snapshot in enumerate(snapshots):
            place = (index * self._scene_width, self._scene_width, CAR_COLOURS[index])
            views.append(CarScene(canvas, snapshot, *place, self.cars == 1))
        # both cars have the road and the scale of the first, so that they can be compared
        needed = max(view.needed(views[0].reference) for view in views)
        room = min(views[0].most, 1.0 / needed if needed else math.inf)
        while (
            self._factor < len(EXAGGERATION) - 1 and EXAGGERATION[self._factor] > room
        ):
            self._factor += 1
        for view in views:
            view.paint(views[0].reference, EXAGGERATION[self._factor])
        for index in range(1, self.cars + 1):
            canvas.rect(PALE, index * self._scene_width - 0.5, 0, 1, self.height)
        self._panel.paint(snapshots)
        canvas.finish()
