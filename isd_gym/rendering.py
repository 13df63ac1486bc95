"""The picture of the car corner on its rolling road, and films of it.

`Renderer.draw` paints one or two `Snapshot`s (two for comparison: same road, same scales). It knows nothing
of the simulation: whoever has the displacements of the nodes can draw.

Signs are those of the model: a displacement is positive upwards, a travel is positive in extension, and a
positive current pulls the terminals of the device together (force positive in tension). Colours are those of
Okabe and Ito (Color Universal Design, 2008), which the colour-blind can tell apart; no meaning hangs on
colour alone.
"""

from __future__ import annotations

import importlib
import itertools
import math
import os
import subprocess
import sys
import warnings
from collections import deque
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from .errors import InputError, how_to_install
from .files import whole

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.typing import NDArray

Colour = tuple[int, int, int]
Point = tuple[float, float]
Anchor = Literal["left", "center", "right"]

# Okabe-Ito
ORANGE: Colour = (230, 159, 0)
GREEN: Colour = (0, 158, 115)
BLUE: Colour = (0, 114, 178)
VERMILLION: Colour = (213, 94, 0)
PURPLE: Colour = (204, 121, 167)

WHITE: Colour = (255, 255, 255)
INK: Colour = (38, 43, 48)
MUTED: Colour = (96, 104, 112)
STEEL: Colour = (84, 92, 100)
STEEL_FAR: Colour = (168, 175, 182)
PALE: Colour = (222, 226, 230)
SKY_TOP: Colour = (231, 239, 246)
SKY_LOW: Colour = (249, 251, 252)
GROUND: Colour = (214, 208, 199)
GROUND_MARK: Colour = (184, 176, 165)
OIL: Colour = (250, 222, 160)

CAR_COLOURS = (BLUE, VERMILLION)
PULL, PUSH = GREEN, PURPLE  # thrust that contracts the device (positive current), that extends it

_WHEEL_RADIUS = 0.32  # [m], what the wheel stands for; the factor on screen is relative to it
CYLINDER = 0.05  # m, stroke of the main cylinder (Table 1), as drawn where no stop ends the travel before
_EXAGGERATION = (6.0, 4.0, 3.0, 2.0, 1.0, 0.5, 0.2, 0.1, 0.05, 0.02)
_HISTORY = 4.0  # [s]
_SMALLEST = (640, 400)
ROAD_WINDOW = 5.0  # [m] of road behind and ahead of the wheel: fills a picture of the usual proportions


@dataclass(frozen=True, kw_only=True, eq=False)
class Snapshot:
    """What one frame shows of one car. Displacements are absolute, upwards, about static equilibrium.

    `road_behind` [m]: how much of the profile lies behind the wheel. `static_tyre_load` [N]. `label`: the name
    above the picture. `past`: time [s], body acceleration [m/s^2] and suspension travel [m] of the moments before, for the
    curves; without it they go through the moments that were drawn.
    """

    time: float  # [s]
    body: float  # [m]
    wheel: float  # [m]
    piston: float | None = None  # [m], node between oil spring and inerter; None: the model has none
    joint: float | None = None  # [m], node between inerter and damper; None: a car without the device
    road_profile: NDArray[np.float64]  # [m], shape (n,): road height, from behind the wheel to ahead
    road_step: float  # [m], distance of two samples of the profile
    road_behind: float | None = (
        None  # [m], from the first sample to the wheel; None: the wheel is in the middle
    )
    speed: float  # [m/s]
    current: float = 0.0  # [A]
    current_limit: float | None = None  # [A]; None: there is no motor
    body_acceleration: float  # [m/s^2]
    suspension_travel: float  # [m]
    tyre_load: float  # [N], dynamic: what is added to the static load
    static_tyre_load: float | None = (
        None  # [N]; where given, a tyre that carries nothing is drawn off the road
    )
    device_travel_limit: float | None = None  # [m], end stop of the device; None: it has none
    cost: float | None = None  # [-], mean cost so far
    label: str = ""
    past: Sequence[tuple[float, float, float]] = ()

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name in ("road_profile", "label", "past") or value is None:
                continue
            if not math.isfinite(value):
                raise InputError(f"snapshot: {field.name} is {value}, not a finite number")
        road = np.asarray(self.road_profile, dtype=np.float64)
        if road.ndim != 1 or road.size == 0 or not np.isfinite(road).all():
            raise InputError(
                f"snapshot: road_profile must be a row of finite heights, got shape {road.shape}"
            )
        object.__setattr__(self, "road_profile", road)
        for name in ("road_step", "current_limit", "device_travel_limit"):
            value = getattr(self, name)
            if value is not None and value <= 0.0:
                raise InputError(f"snapshot: {name} must be positive, got {value}")
        if self.piston is not None and self.joint is None:
            raise InputError("snapshot: piston without joint; give both, only joint, or neither")

    @property
    def device_travel(self) -> float | None:
        """Extension of the device [m], None where there is no device."""
        if self.joint is None:
            return None
        return (self.body if self.piston is None else self.piston) - self.joint


_NO_WINDOW = "cannot open a window: {}; use render_mode='rgb_array', or write a film"


def check_display() -> None:
    """Raise `InputError` where no window can be opened, or pygame is missing: before long work, not after it."""
    pg = _pygame()
    _start_display(pg)
    pg.display.quit()


def _start_display(pg: Any) -> None:
    """Without a display SDL may take a driver that shows nothing; only who asks for one should get it."""
    name = "SDL_VIDEODRIVER"
    choose = sys.platform.startswith("linux") and not os.environ.get(name)
    if choose:
        served = {"x11": "DISPLAY", "wayland": "WAYLAND_DISPLAY"}
        drivers = [driver for driver, display in served.items() if os.environ.get(display)]
        if not drivers:
            raise InputError(_NO_WINDOW.format("this machine has no display"))
        os.environ[name] = ",".join(drivers)
    try:
        pg.display.init()
    except pg.error as error:
        raise InputError(_NO_WINDOW.format(str(error).strip().splitlines()[0])) from None
    finally:
        if choose:
            del os.environ[name]


class Renderer:
    """Draws the car corner (`cars=1`) or two of them side by side (`cars=2`).

    In mode "rgb_array" `draw` returns the frame and needs no display. In mode "human" it shows the frame in a
    window and keeps the pace of the simulated time; calls that come faster than `fps` (at most 60) per
    simulated second enter the plots but are not painted, so a 5 ms control loop may call it at every step.
    `closed` turns True when the viewer shuts the window (its button, Escape or q).

    The scales stand still while time runs and only ever widen, when the motion leaves them; a snapshot that
    is earlier than the last one starts afresh. Raises `InputError` where pygame is missing, where a window
    finds no display, and for a size [px] below 640x400.

    width, height [px].
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
        if mode not in ("human", "rgb_array"):
            raise InputError(f"render mode must be 'human' or 'rgb_array', got {mode!r}")
        if cars not in (1, 2):
            raise InputError(f"cars must be 1 or 2, got {cars}")
        if width < _SMALLEST[0] or height < _SMALLEST[1]:
            raise InputError(f"a picture of {width}x{height} is too small to read; the least is 640x400")
        if not (math.isfinite(fps) and fps > 0):
            raise InputError(f"fps must be positive, got {fps}")
        self.mode, self.width, self.height, self.cars, self.fps = mode, width, height, cars, fps
        self.closed = False
        self._now = self._painted = -math.inf  # [s] of simulated time
        self._pg = _pygame()
        self._unit = min(width / 640, height / 400)  # everything is laid out for 640x400
        self._window: Any = None
        if mode == "human":
            self._open_window()
        self._canvas = _Canvas(self._pg, width, height, self._unit)
        panel = (268 if cars == 1 else 236) * self._unit
        self._scene_width = (width - panel) / cars
        self._paint_backdrop()
        self._restart()

    @property
    def road_window(self) -> tuple[float, float]:
        """Lengths of road [m] behind and ahead of the wheel that the picture has room for."""
        half = self._scene_width / 2 / (_METRE * self._unit)
        return half, half

    def draw(self, *snapshots: Snapshot) -> NDArray[np.uint8] | None:
        """Paint one snapshot per car; returns the frame, shape (height, width, 3), in mode "rgb_array"."""
        if len(snapshots) != self.cars:
            raise InputError(
                f"this renderer draws {self.cars} car(s) and was given {len(snapshots)} snapshot(s)"
            )
        now = snapshots[0].time
        if now < self._now:
            self._restart()
        for history, snapshot in zip(self._history, snapshots, strict=True):
            history.add(snapshot)
        since, self._now = now - self._painted, now
        if self.mode == "human" and (self.closed or since < (1 - 1e-6) / min(self.fps, 60.0)):
            return None
        self._painted = now
        self._paint(snapshots)
        if self.mode == "rgb_array":
            return self._canvas.pixels()
        self._show(since)
        return None

    def close(self) -> None:
        """Shut the window, if there is one; the renderer cannot be used in mode "human" afterwards."""
        if self._window is not None:
            self._pg.display.quit()
            self._window = None
        self.closed = True

    # --- window -----------------------------------------------------------------------------------

    def _open_window(self) -> None:
        _start_display(self._pg)
        try:
            self._window = self._pg.display.set_mode((self.width, self.height))
        except self._pg.error as error:
            raise InputError(_NO_WINDOW.format(str(error).strip().splitlines()[0])) from None
        self._pg.display.set_caption("isd-gym")
        self._clock = self._pg.time.Clock()

    def _show(self, since: float) -> None:
        for event in self._pg.event.get():
            if event.type == self._pg.QUIT or (
                event.type == self._pg.KEYDOWN and event.key in (self._pg.K_ESCAPE, self._pg.K_q)
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
        self._history: list[_History] = [_History() for _ in range(self.cars)]
        self._factor = 0  # index into _EXAGGERATION
        self._plots = {"body_acceleration": _Scale(1.0, 2), "suspension_travel": _Scale(10.0, 1)}

    def _paint_backdrop(self) -> None:
        canvas, width = self._canvas, self._scene_width * self.cars
        for y in range(2 * self.height):
            canvas.row(y, 2 * width, _mix(SKY_TOP, SKY_LOW, min(1.0, y / (1.6 * self.height))))
        canvas.rect(WHITE, width, 0, self.width - width, self.height)
        canvas.keep_backdrop()

    def _paint(self, snapshots: Sequence[Snapshot]) -> None:
        canvas = self._canvas
        canvas.start()
        views = []
        for index, snapshot in enumerate(snapshots):
            left = index * self._scene_width
            views.append(
                _Scene(canvas, snapshot, left, self._scene_width, CAR_COLOURS[index], self.cars == 1)
            )
        # One road and one scale for both cars, or they could not be compared.
        needed = max(view.needed(views[0].reference) for view in views)
        while self._factor < len(_EXAGGERATION) - 1 and needed * _EXAGGERATION[self._factor] > 1.0:
            self._factor += 1
        for view in views:
            view.paint(views[0].reference, _EXAGGERATION[self._factor])
        for index in range(1, self.cars + 1):
            canvas.rect(PALE, index * self._scene_width - 0.5, 0, 1, self.height)
        _panel(
            canvas,
            self._scene_width * self.cars,
            self.width,
            self.height,
            snapshots,
            self._history,
            self._plots,
        )
        canvas.finish()


class _History:
    """What the live plots show: the last `_HISTORY` seconds of one car."""

    def __init__(self) -> None:
        self.rows: deque[tuple[float, float, float]] = deque()

    def add(self, snapshot: Snapshot) -> None:
        known = self.rows[-1][0] if self.rows else -math.inf
        self.rows.extend((t, a, 1e3 * l) for t, a, l in snapshot.past if known < t < snapshot.time)
        self.rows.append((snapshot.time, snapshot.body_acceleration, 1e3 * snapshot.suspension_travel))
        while self.rows[0][0] < snapshot.time - _HISTORY:
            self.rows.popleft()

    def array(self) -> NDArray[np.float64]:
        """Time [s], body acceleration [m/s^2], suspension travel [mm], shape (n, 3)."""
        flat = itertools.chain.from_iterable(self.rows)
        return np.fromiter(flat, np.float64, 3 * len(self.rows)).reshape(-1, 3)


class _Scale:
    """Range of a plot: three units either way, ticks at two; the unit is 1, 2 or 4 times a power of ten."""

    def __init__(self, unit: float, digits: int) -> None:
        self.unit, self.digits = unit, digits  # digits behind the point of the RMS

    def hold(self, peak: float) -> None:
        while peak > 3.0 * self.unit:
            decade = 10.0 ** math.floor(math.log10(self.unit) + 1e-9)
            step = round(self.unit / decade)
            self.unit = decade * {1: 2, 2: 4, 4: 10}[step]


# --- the drawing surface --------------------------------------------------------------------------


class _Canvas:
    """Shapes are drawn at twice the size and scaled down, so they are smooth; text is set as it is."""

    def __init__(self, pg: Any, width: int, height: int, unit: float) -> None:
        self.pg, self.unit = pg, unit
        self.frame = pg.Surface((width, height), 0, 32)
        self._large = pg.Surface((2 * width, 2 * height), 0, 32)
        self._backdrop = self._large.copy()
        self._texts: list[tuple[Any, Point]] = []
        self._fonts: dict[tuple[float, str], Any] = {}
        self._set: dict[tuple[str, float, Colour, str], Any] = {}
        pg.font.init()

    def row(self, y: int, width: float, colour: Colour) -> None:
        self.pg.draw.line(self._large, colour, (0, y), (width, y))

    def keep_backdrop(self) -> None:
        self._backdrop.blit(self._large, (0, 0))

    def start(self) -> None:
        self._large.blit(self._backdrop, (0, 0))

    def clip(self, left: float = 0.0, top: float = 0.0, width: float = 0.0, height: float = 0.0) -> None:
        """Draw shapes only inside this box; without arguments, everywhere."""
        box = None if width == 0.0 else (round(2 * left), round(2 * top), round(2 * width), round(2 * height))
        self._large.set_clip(box)

    def finish(self) -> None:
        self.pg.transform.smoothscale(self._large, self.frame.get_size(), self.frame)
        self.frame.blits(self._texts, False)
        self._texts.clear()

    def pixels(self) -> NDArray[np.uint8]:
        width, height = self.frame.get_size()
        raw = self.pg.image.tobytes(self.frame, "RGB")
        return np.frombuffer(raw, np.uint8).reshape(height, width, 3).copy()

    def rect(self, colour: Colour, x: float, y: float, w: float, h: float, *, radius: float = 0.0) -> None:
        left, top = round(2 * x), round(2 * y)
        box = (left, top, max(1, round(2 * (x + w)) - left), max(1, round(2 * (y + h)) - top))
        self.pg.draw.rect(self._large, colour, box, border_radius=round(2 * radius))

    def framed(
        self,
        fill: Colour,
        edge: Colour,
        x: float,
        y: float,
        w: float,
        h: float,
        *,
        line: float,
        radius: float = 0.0,
    ) -> None:
        self.rect(edge, x, y, w, h, radius=radius)
        self.rect(fill, x + line, y + line, w - 2 * line, h - 2 * line, radius=max(0.0, radius - line))

    def circle(self, colour: Colour, x: float, y: float, r: float) -> None:
        self.pg.draw.circle(self._large, colour, (2 * x, 2 * y), 2 * r)

    def polygon(self, colour: Colour, points: Sequence[Point] | NDArray[np.float64]) -> None:
        self.pg.draw.polygon(self._large, colour, (2 * np.asarray(points)).tolist())

    def lines(self, colour: Colour, points: Sequence[Point] | NDArray[np.float64], width: float) -> None:
        self.pg.draw.lines(
            self._large, colour, False, (2 * np.asarray(points)).tolist(), max(1, round(2 * width))
        )

    def text(
        self,
        words: str,
        x: float,
        y: float,
        *,
        size: float = 10.0,
        colour: Colour = INK,
        anchor: Anchor = "left",
        face: str = "",
        room: float | None = None,
    ) -> float:
        """Set `words` with their middle at height `y`, smaller or cut to fit `room`; returns the width."""
        surface = self._typeset(words, size, colour, face)
        if room is not None:
            if surface.get_width() > room:
                size *= 0.85
                surface = self._typeset(words, size, colour, face)
            while surface.get_width() > room and len(words) > 1:
                words = words.rstrip("…")[:-1].rstrip(" ,;:-") + "…"
                surface = self._typeset(words, size, colour, face)
        width, height = surface.get_size()
        left = x - {"left": 0.0, "center": width / 2, "right": width}[anchor]
        self._texts.append((surface, (round(left), round(y - height / 2))))
        return float(width)

    def _typeset(self, words: str, size: float, colour: Colour, face: str) -> Any:
        key = (words, size, colour, face)
        if key not in self._set:
            if len(self._set) > 1500:  # numbers that change all the time
                self._set.clear()
            if (size, face) not in self._fonts:
                pixels = max(9, round(size * self.unit))
                self._fonts[size, face] = self.pg.font.Font(_font_file(face), pixels)
            self._set[key] = self._fonts[size, face].render(words, True, colour)
        return self._set[key]


def _font_file(face: str) -> str:
    import matplotlib  # it brings the DejaVu fonts: the same picture on every machine

    return str(
        Path(matplotlib.get_data_path()) / "fonts" / "ttf" / f"DejaVuSans{'-' + face if face else ''}.ttf"
    )


def _mix(first: Colour, second: Colour, share: float) -> Colour:
    r, g, b = (round(a + (c - a) * share) for a, c in zip(first, second, strict=True))
    return r, g, b


def _number(value: float, digits: int, *, sign: bool = True) -> str:
    """A number with a true minus sign, and no minus before zero."""
    value = round(value, digits) + 0.0
    return f"{value:{'+' if sign else ''}.{digits}f}".replace("-", "−")


# --- the car corner -------------------------------------------------------------------------------

# Lengths in units of the layout (a pixel at 640x400), at static equilibrium.
_METRE = 40.0  # of road
_TYRE = 38.0  # radius
_SQUASH = 4.0  # of the tyre under its static load
_FLOOR = 58.0  # from the foot of the picture to the road
_CARRIER = 9.0  # from the top of the tyre to the wheel carrier
_OIL, _DEVICE, _DAMPER = 18.0, 73.0, 99.0
_DEVICE_STROKE, _DAMPER_STROKE, _LONE_DAMPER_STROKE = 18.5, 29.0, 45.0  # room for motion, either way
_BODY = 40.0


class _Scene:
    """One car on its road."""

    def __init__(
        self, canvas: _Canvas, snapshot: Snapshot, left: float, width: float, colour: Colour, roomy: bool
    ) -> None:
        self.canvas, self.shot, self.left, self.width, self.colour = canvas, snapshot, left, width, colour
        self.roomy = roomy
        self.u = canvas.unit
        self.height = canvas.frame.get_height()
        self.x = left + width / 2
        behind = snapshot.road_behind
        road, step = snapshot.road_profile, snapshot.road_step
        if behind is None:
            behind = (road.size - 1) * step / 2
        metre = _METRE * self.u
        self.road_x = np.linspace(left, left + width, int(width / 2) + 1)  # a point every two pixels
        place = np.arange(road.size) * step - behind
        self.road = np.interp((self.road_x - self.x) / metre, place, road)
        self.contact = float(np.interp(0.0, place, road))
        # The camera follows the road at large: a mean that fades towards the edges, so it moves smoothly.
        weight = np.hanning(self.road.size + 2)[1:-1]
        # heights less the one under the wheel, so that a road's own height is gone before anything is rounded
        self.reference = self.contact + float((self.road - self.contact) @ weight / weight.sum())

    def needed(self, reference: float) -> float:
        """The largest motion, as a share of the room it has in a drawing without exaggeration."""
        shot = self.shot
        top = shot.body if shot.joint is None else shot.joint
        stroke = _LONE_DAMPER_STROKE if shot.joint is None else _DAMPER_STROKE
        demands = [
            (float(np.abs(self.road - reference).max()), 30.0),
            (abs(shot.body - reference), 28.0),
            (abs(shot.wheel - self.contact), 20.0),
            (abs(shot.device_travel or 0.0), _DEVICE_STROKE),
            (abs(top - shot.wheel), stroke),
            (abs(shot.body - (shot.piston if shot.piston is not None else shot.body)), 10.0),
        ]
        return max(motion * _TYRE / _WHEEL_RADIUS / room for motion, room in demands)

    def paint(self, reference: float, factor: float) -> None:
        c, u, shot = self.canvas, self.u, self.shot
        self.scale = factor * _TYRE * u / _WHEEL_RADIUS  # [px/m]
        floor = self.height - _FLOOR * u
        road_y = floor - (self.road - reference) * self.scale
        contact_y = floor - (self.contact - reference) * self.scale
        hub = floor - (_TYRE - _SQUASH) * u - (shot.wheel - reference) * self.scale
        carrier = hub - (_TYRE + _CARRIER) * u
        rest = floor - (2 * _TYRE - _SQUASH + _CARRIER + _OIL + _DEVICE + _DAMPER) * u
        seat = rest - (shot.body - reference) * self.scale  # underside of the body

        c.clip(self.left, 0, self.width, self.height)
        self._tyre(hub, contact_y)
        self._ground(road_y)
        self._rim(hub)
        c.rect(STEEL, self.x - 3 * u, carrier, 6 * u, hub - carrier, radius=3 * u)
        c.circle(INK, self.x, hub, 5 * u)
        c.circle(WHITE, self.x, hub, 2 * u)
        reach = 66 * u
        c.rect(INK, self.x - reach, carrier - 2.5 * u, 2 * reach, 5 * u, radius=2.5 * u)
        self._name("wheel", self.x + reach, carrier + 10 * u, "right")
        if shot.joint is None:
            _coil(c, self.x - 40 * u, seat, carrier, 15 * u, 8, 3.0 * u)
            _dashpot(
                c, self.x + 40 * u, seat, carrier, (_OIL + _DEVICE + _DAMPER) * u, _LONE_DAMPER_STROKE * u
            )
            if self.roomy:
                self._tag("main spring", self.x - 64 * u, (seat + carrier) / 2, "right")
                self._tag("damper", self.x + 62 * u, (seat + carrier) / 2, "left")
        else:
            _coil(c, self.x - 58 * u, seat, carrier, 15 * u, 8, 3.0 * u)
            if self.roomy:
                self._tag("main spring", self.x - 79 * u, (seat + carrier) / 2, "right")
            joint = carrier - _DAMPER * u - (shot.joint - shot.wheel) * self.scale
            self._device(seat, joint)
            _dashpot(c, self.x, joint, carrier, _DAMPER * u, _DAMPER_STROKE * u)
            if self.roomy:
                self._tag("damper", self.x + 20 * u, carrier - 0.4 * _DAMPER * u, "left")
        self._body(seat)
        c.clip()
        self._legend(factor)

    def _name(self, words: str, x: float, y: float, anchor: Anchor = "left") -> None:
        """The name of a node."""
        self.canvas.text(words, x, y, size=9.5, colour=MUTED, face="Oblique", anchor=anchor)

    def _tag(self, words: str, x: float, y: float, anchor: Anchor) -> None:
        """The name of an element."""
        self.canvas.text(words, x, y, size=9.5, colour=MUTED, anchor=anchor)

    def _body(self, seat: float) -> None:
        c, u, label = self.canvas, self.u, self.shot.label
        half, top = 88 * u, seat - _BODY * u
        fill = _mix(WHITE, self.colour, 0.16)
        c.framed(fill, self.colour, self.x - half, top, 2 * half, _BODY * u, line=2 * u, radius=7 * u)
        c.text(label, self.x, top + 15 * u, size=13, face="Bold", anchor="center", room=2 * (half - 8 * u))
        self._name("body", self.x, top + (30 if label else 20) * u, "center")

    def _ground(self, road_y: NDArray[np.float64]) -> None:
        c, u, shot = self.canvas, self.u, self.shot
        surface = np.column_stack([self.road_x, road_y])
        right = self.left + self.width
        c.polygon(GROUND, np.vstack([surface, [[right, self.height], [self.left, self.height]]]))
        # Marks fixed to the ground every two metres: they make the speed visible.
        metre, every = _METRE * u, 2.0
        offset = (shot.speed * shot.time) % every
        first = math.floor((self.left - self.x) / metre / every) * every - offset
        for place in np.arange(first, (right - self.x) / metre + every, every).tolist():
            x = self.x + place * metre
            y = float(np.interp(x, self.road_x, road_y)) + 4 * u
            c.polygon(GROUND_MARK, [(x, y), (x + 7 * u, y), (x - 1 * u, y + 11 * u), (x - 8 * u, y + 11 * u)])
        c.polygon(INK, np.vstack([surface - [0, 0.6 * u], surface[::-1] + [0, 2.2 * u]]))

    def _tyre(self, hub: float, contact: float) -> None:
        """Touches the road as long as it carries load; the road is painted over what is pressed in."""
        c, u, shot = self.canvas, self.u, self.shot
        radius = _TYRE * u
        gap = contact - hub
        lifted = shot.static_tyre_load is not None and shot.tyre_load <= -shot.static_tyre_load
        angle = np.linspace(0.0, 2 * np.pi, 73)[:-1]  # from straight down
        below = np.maximum(np.cos(angle), 0.0)
        squash = float(np.clip((radius - gap) / radius, 0.0, 0.5))
        aside = np.abs((angle + np.pi) % (2 * np.pi) - np.pi)
        bulge = 1.0 + 0.35 * squash * np.exp(-(((aside - 0.75) / 0.35) ** 2))
        stretch = 1.0 if lifted else max(1.0, (gap + 1.5 * u) / radius)
        x = self.x + radius * bulge * np.sin(angle)
        y = hub + radius * bulge * np.where(below > 0, stretch, 1.0) * np.cos(angle)
        c.polygon((58, 63, 68), np.column_stack([x, y]))

    def _rim(self, hub: float) -> None:
        c, u = self.canvas, self.u
        c.circle(STEEL_FAR, self.x, hub, 24 * u)
        c.circle((238, 240, 242), self.x, hub, 21.5 * u)
        turn = self.shot.speed * self.shot.time * _METRE / _TYRE  # rolls with the road as it is drawn
        for k in range(5):
            angle = turn + 2 * math.pi * k / 5
            s, n = math.sin(angle), math.cos(angle)
            spoke = [(5, -3), (22, -2), (22, 2), (5, 3)]
            c.polygon(
                STEEL_FAR, [(self.x + (a * n - b * s) * u, hub + (a * s + b * n) * u) for a, b in spoke]
            )

    def _device(self, seat: float, joint: float) -> None:
        """Oil spring, main cylinder (rod: piston, barrel: joint), and the motor's cylinder at its side."""
        c, u, x, shot = self.canvas, self.u, self.x, self.shot
        travel = shot.device_travel
        assert travel is not None
        node = joint - _DEVICE * u - travel * self.scale
        if shot.piston is None:
            c.rect(STEEL, x - 2 * u, seat, 4 * u, max(0.0, node - seat))
        else:
            _coil(c, x, seat, node, 9 * u, 4, 2.2 * u, stub=1.5 * u, near=_mix(ORANGE, INK, 0.25), far=OIL)
            if self.roomy:
                self._tag("oil spring", x + 15 * u, seat + 6.5 * u, "left")

        # Main cylinder
        foot, bore = 6 * u, (2 * _DEVICE_STROKE + 8) * u
        top = joint - foot - bore
        c.rect(STEEL, x - 2.5 * u, joint - foot - u, 5 * u, foot + u)
        c.framed(OIL, INK, x - 13 * u, top, 26 * u, bore, line=1.6 * u, radius=2.5 * u)
        piston = joint - foot - bore / 2 - travel * self.scale
        c.rect(STEEL, x - 2 * u, node, 4 * u, piston - node)
        c.rect(INK, x - 11.4 * u, piston - 2.5 * u, 22.8 * u, 5 * u)

        # The motor's (deputy) cylinder. Oil that the rising piston pushes out at the top moves the mover to
        # the right, so extension reads to the right; its ends are the end stop (paper, Table 1).
        left, width, high = x + 24 * u, 68 * u, 19 * u
        middle = top + bore / 2
        pipe = 3.5 * u
        for colour, w in ((INK, pipe), (OIL, pipe - 2 * u)):
            y = top + 6 * u
            c.rect(colour, x + 12 * u, y - w / 2, left - x - 12 * u + 6 * u + w / 2, w)
            c.rect(colour, left + 6 * u - w / 2, y - w / 2, w, middle - y)
            y = top + bore - 6 * u
            c.rect(colour, x + 12 * u, y - w / 2, left + width - 6 * u - x - 12 * u + w / 2, w)
            c.rect(colour, left + width - 6 * u - w / 2, middle, w, y - middle + w / 2)
        limit = shot.device_travel_limit
        share = travel / (limit or CYLINDER)
        touching = limit is not None and abs(share) > 0.985
        if shot.current_limit is not None:
            colour, force = self._current_colour(), min(1.0, abs(shot.current) / shot.current_limit)
            coil = _mix(PALE, colour, 0.15 + 0.85 * force if force else 0.0)
            for k in range(5):
                place = left + 13 * u + k * 9 * u
                c.framed(
                    coil,
                    STEEL,
                    place,
                    middle - high / 2 - 4 * u,
                    6 * u,
                    high + 8 * u,
                    line=0.8 * u,
                    radius=1.5 * u,
                )
        c.framed(OIL, INK, left, middle - high / 2, width, high, line=1.6 * u, radius=2.5 * u)
        if limit is not None:
            for side in (0, 1):
                hit = touching and (share > 0) == bool(side)
                c.rect(
                    VERMILLION if hit else INK, left + side * (width - 4 * u), middle - high / 2, 4 * u, high
                )
        mover = 14 * u
        centre = left + width / 2 + float(np.clip(share, -1.02, 1.02)) * (width / 2 - 4 * u - mover / 2)
        c.rect(INK, centre - mover / 2, middle - high / 2 + 2.2 * u, mover, high - 4.4 * u, radius=1.5 * u)

        c.circle(INK, x, node, 3 * u)
        c.circle(INK, x, joint, 3 * u)
        if limit is not None:  # gauge: the mover's place between the stops, read as travel of the device
            reach, y = width / 2 - 4 * u - mover / 2, top + bore + 16 * u
            dial = left + width / 2
            c.rect(MUTED, dial - reach, y - 0.4 * u, 2 * reach, 0.8 * u)
            for place in (-reach, 0.0, reach):
                c.rect(MUTED, dial + place - 0.4 * u, y - 2.5 * u, 0.8 * u, 5 * u)
            c.polygon(
                VERMILLION if touching else INK,
                [(centre, y), (centre - 3 * u, y - 5 * u), (centre + 3 * u, y - 5 * u)],
            )
            words = f"±{1e3 * limit:.4g} mm"
            c.text(
                words, dial, y + 9 * u, size=9.5, colour=VERMILLION if touching else MUTED, anchor="center"
            )
        if self.roomy:
            rows = ("inerter", "and motor") if shot.current_limit is not None else ("inerter",)
            for row, word in enumerate(rows):
                self._tag(word, left + width + 7 * u, middle + (12 * row - 6 * (len(rows) - 1)) * u, "left")
        self._name("piston", x + 7 * u, node)
        self._name("joint", x + 7 * u, joint)
        if shot.current_limit is not None:
            self._thrust(x - 25 * u, (node + joint) / 2)

    def _current_colour(self) -> Colour:
        return PULL if self.shot.current >= 0 else PUSH

    def _thrust(self, x: float, middle: float) -> None:
        """What the motor does to the terminals: arrows at each other (pulls together) or from each other."""
        c, u, shot = self.canvas, self.u, self.shot
        assert shot.current_limit is not None
        share = min(1.0, abs(shot.current) / shot.current_limit)
        if share < 0.02:
            return
        length = (6 + 24 * share) * u
        for side in (-1, 1):
            near, far = middle + side * 4 * u, middle + side * (4 * u + length)
            tail, head = (far, near) if shot.current > 0 else (near, far)
            _arrow(c, self._current_colour(), x, tail, head, (3 + 3 * share) * u)

    def _legend(self, factor: float) -> None:
        c, u, shot = self.canvas, self.u, self.shot
        margin, foot = 10 * u, self.height - 11 * u
        load = f"dynamic tyre load {_number(shot.tyre_load / 1e3, 2)} kN"
        c.text(load, self.x, self.height - 26 * u, size=9.5, anchor="center")
        # Rulers: what a length in the picture stands for
        tall = next((mm for mm in (10, 20, 50, 100, 200, 500, 1000) if mm * 1e-3 * self.scale > 8 * u), 2000)
        rise = tall * 1e-3 * self.scale
        x, y = self.left + margin, self.height - 6 * u
        for a, b in ((y - rise, y - rise), (y, y)):
            c.rect(MUTED, x - 2.5 * u, a - 0.5 * u, 5 * u, b - a + u)
        c.rect(MUTED, x - 0.5 * u, y - rise, u, rise)
        words = f"{tall} mm, vertical ×{factor:g}"
        c.text(words, x + 6 * u, foot, size=9.5, colour=MUTED)
        run = _METRE * u
        right = self.left + self.width - margin
        for edge in (right - run, right):
            c.rect(MUTED, edge - 0.5 * u, foot - 2.5 * u + 4 * u, u, 5 * u)
        c.rect(MUTED, right - run, foot + 3.5 * u, run, u)
        c.text("1 m", right - run / 2, foot - 4 * u, size=9.5, colour=MUTED, anchor="center")


def _coil(
    c: _Canvas,
    x: float,
    top: float,
    bottom: float,
    radius: float,
    turns: int,
    line: float,
    *,
    stub: float | None = None,
    near: Colour = STEEL,
    far: Colour = STEEL_FAR,
) -> None:
    """A helix seen from the side: what is behind is paler."""
    stub = 2 * line if stub is None else stub
    c.rect(near, x - line / 2, top, line, stub + line / 2)
    c.rect(near, x - line / 2, bottom - stub - line / 2, line, stub + line / 2)
    per = 16
    phase = np.linspace(0.0, 2 * np.pi * turns, per * turns + 1)
    points = np.column_stack([x + radius * np.sin(phase), np.linspace(top + stub, bottom - stub, phase.size)])
    quarter = per // 4
    halves = [(k, min(k + per // 2, phase.size - 1)) for k in range(-quarter, phase.size, per // 2)]
    for front in (False, True):
        for number, (start, stop) in enumerate(halves):
            if (number % 2 == 0) == front:
                part = points[max(start, 0) : stop + 1]
                if len(part) > 1:
                    c.lines(near if front else far, part, line if front else 0.8 * line)
    for start, stop in halves:  # round the turns
        for k in (start, stop):
            if 0 < k < phase.size - 1:
                c.circle(near, points[k, 0], points[k, 1], line / 2)


def _dashpot(c: _Canvas, x: float, top: float, bottom: float, length: float, stroke: float) -> None:
    """Cup and plunger; `length` at rest, room for `stroke` either way."""
    u = c.unit
    foot, cup, half = 5 * u, 2 * stroke + 4 * u, 12 * u
    rim = bottom - foot - cup
    plate = top + length - foot - cup / 2
    c.rect(STEEL, x - 2 * u, bottom - foot, 4 * u, foot)
    c.rect(_mix(WHITE, STEEL_FAR, 0.35), x - half, rim, 2 * half, cup)
    c.rect(INK, x - half, rim, 1.8 * u, cup)
    c.rect(INK, x + half - 1.8 * u, rim, 1.8 * u, cup)
    c.rect(INK, x - half, bottom - foot - 1.8 * u, 2 * half, 1.8 * u)
    c.rect(STEEL, x - 1.7 * u, top, 3.4 * u, plate - top)
    c.rect(INK, x - half + 3 * u, plate - 2 * u, 2 * half - 6 * u, 4 * u)


def _arrow(c: _Canvas, colour: Colour, x: float, tail: float, head: float, width: float) -> None:
    way = 1.0 if head > tail else -1.0
    tip = min(abs(head - tail), 2.2 * width)
    neck = head - way * tip
    c.rect(colour, x - width / 2, min(tail, neck), width, abs(neck - tail))
    c.polygon(colour, [(x, head), (x - 1.3 * width, neck), (x + 1.3 * width, neck)])


# --- the panel at the right -----------------------------------------------------------------------


def _panel(
    c: _Canvas,
    left: float,
    right: float,
    height: float,
    shots: Sequence[Snapshot],
    histories: Sequence[_History],
    scales: dict[str, _Scale],
) -> None:
    u = c.unit
    x0, x1 = left + 14 * u, right - 14 * u
    first = shots[0]
    c.text(f"{_number(first.time, 2, sign=False)} s", x0, 18 * u, size=13, face="Bold")
    speed = f"{_number(first.speed, 0, sign=False)} m/s ({_number(3.6 * first.speed, 0, sign=False)} km/h)"
    c.text(speed, x1, 18 * u, size=10, colour=MUTED, anchor="right")
    y = 40 * u
    if len(shots) == 1:
        _current_bar(c, x0, x1, y, first, "Motor current")
        y += 55 * u
        if first.cost is not None:
            c.text("Mean cost so far", x0, y, size=11)
            c.text(_number(first.cost, 3, sign=False), x1, y, size=11, anchor="right", face="Bold")
        y += 26 * u
    else:
        for shot, colour in zip(shots, CAR_COLOURS, strict=True):
            c.rect(colour, x0, y - 4.5 * u, 9 * u, 9 * u, radius=2 * u)
            width = 0.0
            if shot.cost is not None:
                words = f"cost {_number(shot.cost, 3, sign=False)}"
                width = c.text(words, x1, y, size=10, anchor="right")
            c.text(shot.label, x0 + 14 * u, y, size=11, face="Bold", room=x1 - x0 - 20 * u - width)
            _slim_bar(c, x0, x1, y + 16 * u, shot)
            y += 38 * u
    titles = {
        "body_acceleration": ("Body acceleration", "m/s²"),
        "suspension_travel": ("Suspension travel", "mm"),
    }
    data = [history.array() for history in histories]
    each = (height - y - 22 * u) / 2
    for column, (key, (title, unit)) in enumerate(titles.items(), start=1):
        scale = scales[key]
        scale.hold(max(float(np.abs(rows[:, column]).max()) for rows in data))
        _plot(c, x0, y, x1, y + each - 12 * u, title, unit, scale, data, column)
        y += each
    foot = y - 5 * u
    axis = x0 + 26 * u
    c.text(f"−{_HISTORY:g} s", axis, foot, size=9.5, colour=MUTED)
    c.text("now", x1, foot, size=9.5, colour=MUTED, anchor="right")
    c.text("isd-gym", (axis + x1) / 2, height - 9 * u, size=9, colour=STEEL_FAR, anchor="center")


def _current_bar(c: _Canvas, x0: float, x1: float, y: float, shot: Snapshot, title: str) -> None:
    u = c.unit
    c.text(title, x0, y, size=11)
    if shot.current_limit is None:
        c.text("no motor", x1, y, size=11, colour=MUTED, anchor="right")
    else:
        c.text(f"{_number(shot.current, 2)} A", x1, y, size=11, anchor="right", face="Bold")
    _bar(c, x0, x1, y + 12 * u, 10 * u, shot)
    if shot.current_limit is not None:
        foot, limit = y + 32 * u, f"{shot.current_limit:g}"
        c.text(f"−{limit} A  pushes apart", x0, foot, size=9.5, colour=MUTED)
        c.text(f"pulls together  +{limit} A", x1, foot, size=9.5, colour=MUTED, anchor="right")


def _slim_bar(c: _Canvas, x0: float, x1: float, y: float, shot: Snapshot) -> None:
    u = c.unit
    words = "no motor" if shot.current_limit is None else f"{_number(shot.current, 2)} A"
    c.text(words, x1, y, size=10, colour=MUTED if shot.current_limit is None else INK, anchor="right")
    _bar(c, x0, x1 - 54 * u, y - 3.5 * u, 7 * u, shot)


def _bar(c: _Canvas, x0: float, x1: float, top: float, height: float, shot: Snapshot) -> None:
    u = c.unit
    c.rect(PALE, x0, top, x1 - x0, height, radius=1.5 * u)
    middle = (x0 + x1) / 2
    if shot.current_limit is not None:
        reach = float(np.clip(shot.current / shot.current_limit, -1, 1)) * (x1 - x0) / 2
        c.rect(
            PULL if reach >= 0 else PUSH, min(middle, middle + reach), top, max(abs(reach), 0.5 * u), height
        )
        c.rect(INK, middle - 0.5 * u, top - 2 * u, u, height + 4 * u)


def _plot(
    c: _Canvas,
    x0: float,
    y0: float,
    x1: float,
    y1: float,
    title: str,
    unit: str,
    scale: _Scale,
    data: Sequence[NDArray[np.float64]],
    column: int,
) -> None:
    """One live plot: its title with the RMS of what is shown, below it the curves."""
    u = c.unit
    place = x1 - c.text(unit, x1, y0, size=10, colour=MUTED, anchor="right") - 4 * u
    for rows, colour in reversed(list(zip(data, CAR_COLOURS, strict=False))):
        rms = float(np.sqrt(np.mean(rows[:, column] ** 2)))
        digits = max(0, min(scale.digits, 2 - math.floor(math.log10(max(rms, 1e-9)))))
        words = _number(rms, digits, sign=False)
        place -= c.text(words, place, y0, size=10, face="Bold", colour=colour, anchor="right") + 6 * u
    place -= c.text("RMS", place + 2 * u, y0, size=10, colour=MUTED, anchor="right")
    c.text(title, x0, y0, size=11 if len(data) == 1 else 10, room=place - 4 * u - x0)
    left, top = x0 + 26 * u, y0 + 14 * u
    right, bottom = x1, y1
    middle, unit_height = (top + bottom) / 2, (bottom - top) / 2 / 3.0
    c.rect((247, 248, 249), left, top, right - left, bottom - top)
    for tick in (-2, 0, 2):
        y = middle - tick * unit_height
        c.rect(STEEL_FAR if tick == 0 else PALE, left, y - 0.4 * u, right - left, 0.8 * u)
        c.text(
            _number(tick * scale.unit, 0) if tick else "0",
            left - 5 * u,
            y,
            size=9.5,
            colour=MUTED,
            anchor="right",
        )
    c.clip(left, top, right - left, bottom - top)
    now = max(rows[-1, 0] for rows in data)
    for rows, colour, line in zip(
        data, CAR_COLOURS, (1.9, 1.3), strict=False
    ):  # the first shows behind the second
        if len(rows) > 1:
            x = right - (now - rows[:, 0]) / _HISTORY * (right - left)
            y_values = middle - rows[:, column] / scale.unit * unit_height
            c.lines(colour, np.column_stack([x, y_values]), (line if len(data) > 1 else 1.4) * u)
    c.clip()


# --- films ----------------------------------------------------------------------------------------


def write_video(path: str | Path, frames: Iterable[NDArray[np.uint8]], fps: float) -> None:
    """Write frames, each of shape (height, width, 3), as an MP4 or a GIF, by the suffix of `path`.

    The file appears whole or not at all. Raises `InputError` for another suffix, no frames, frames of unequal
    size, more than 50 frames per second in a GIF (viewers play none faster), and an MP4 without
    imageio-ffmpeg.

    fps: frames a second.
    """
    path = Path(path)
    kind = path.suffix.lower()
    if kind not in (".mp4", ".gif"):
        raise InputError(f"cannot write a film to '{path}': end the name in .mp4 or .gif")
    if not (math.isfinite(fps) and fps > 0):
        raise InputError(f"fps must be positive, got {fps}")
    if kind == ".gif" and fps > 50:
        raise InputError(f"a GIF plays at most 50 frames per second, got {fps:g}; write an .mp4 instead")
    checked = _checked(frames, path)
    with whole(path) as temporary:
        if kind == ".mp4":
            _write_mp4(temporary, checked, fps)
        else:
            _write_gif(temporary, checked, fps)


def _checked(frames: Iterable[NDArray[np.uint8]], path: Path) -> Iterator[NDArray[np.uint8]]:
    shape: tuple[int, ...] | None = None
    for number, frame in enumerate(frames):
        if (
            frame.ndim != 3
            or frame.shape[2] != 3
            or frame.dtype != np.uint8
            or frame.shape != (shape or frame.shape)
        ):
            raise InputError(f"film '{path}': frame {number} is {frame.dtype} {frame.shape}, wanted uint8 "
                             f"{shape or '(height, width, 3)'}")  # fmt: skip
        shape = frame.shape
        yield frame
    if shape is None:
        raise InputError(f"film '{path}': there are no frames to write")


def _write_mp4(path: Path, frames: Iterator[NDArray[np.uint8]], fps: float) -> None:
    encoder = _extra("imageio_ffmpeg", "writing an MP4", "imageio-ffmpeg").get_ffmpeg_exe()
    first = next(frames)
    height, width = (size + size % 2 for size in first.shape[:2])  # the codec wants even sides
    source = f"-f rawvideo -pix_fmt rgb24 -s {width}x{height} -r {fps:.6f} -i -"
    target = "-an -c:v libx264 -crf 18 -pix_fmt yuv420p -movflags +faststart"
    command = [encoder, "-y", "-loglevel", "error", *source.split(), *target.split(), str(path)]
    # In a session of its own, Ctrl-C reaches the encoder through us alone, and no half film is finished.
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True
    ) as process:
        assert process.stdin is not None and process.stderr is not None
        try:
            for frame in itertools.chain([first], frames):
                edge = ((0, height - frame.shape[0]), (0, width - frame.shape[1]), (0, 0))
                process.stdin.write(np.pad(frame, edge, mode="edge").tobytes())
            process.stdin.close()
            complaint = process.stderr.read()
        except BrokenPipeError:
            complaint = process.stderr.read() or b"it stopped early"
        except BaseException:
            process.kill()
            raise
    if process.returncode != 0 or not path.stat().st_size:
        lines = complaint.decode(errors="replace").strip().splitlines()
        raise InputError(f"the film could not be encoded: {lines[-1] if lines else 'the encoder failed'}")


def _write_gif(path: Path, frames: Iterator[NDArray[np.uint8]], fps: float) -> None:
    from PIL import Image  # matplotlib needs it too

    # One palette for the whole film, from its beginning and the colours of the picture: what stands still
    # keeps its pixels, so the file is small and free of flicker.
    opening = list(itertools.islice(frames, 64))
    samples = opening[:: max(1, len(opening) // 8)]
    ramps = [
        _mix(a, b, k / 8) for a in (*CAR_COLOURS, PULL, PUSH, ORANGE) for b in (WHITE, INK) for k in range(9)
    ]
    swatch = np.zeros((len(ramps), samples[0].shape[1], 3), np.uint8)
    swatch[:] = np.array(ramps, np.uint8)[:, None]
    master = Image.fromarray(np.concatenate([*samples, swatch])).quantize(256, Image.Quantize.MEDIANCUT)

    def reduced() -> Iterator[Any]:
        for frame in itertools.chain(opening, frames):
            yield Image.fromarray(frame).quantize(palette=master, dither=Image.Dither.NONE)

    images = list(reduced())
    ends = [round(100 * k / fps) for k in range(len(images) + 1)]  # a GIF counts in 10 ms
    durations = [10 * (b - a) for a, b in itertools.pairwise(ends)]
    images[0].save(path, save_all=True, append_images=images[1:], duration=durations, loop=0, disposal=1)


def _extra(module: str, doing: str, package: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError:
        raise InputError(f"{doing} needs {package}: {how_to_install('render')}") from None


def _pygame() -> Any:
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # pygame 2.6 warns of pkg_resources on import
        return _extra("pygame", "drawing", "pygame")
