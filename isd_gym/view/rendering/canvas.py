"""The drawing surface of a picture."""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from .palette import INK, Colour

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

Point = tuple[float, float]
Anchor = Literal["left", "center", "right"]


class Canvas:
    """A surface for shapes and text; coordinates are in pixels, `unit` is the unit of the layout [px].

    Shapes are drawn at twice the size and scaled down for smooth edges; text is drawn at its final size.
    """

    def __init__(self, pg: Any, width: int, height: int, unit: float) -> None:
        self.pg, self.unit = pg, unit
        self.frame = pg.Surface((width, height), 0, 32)
        self._large = pg.Surface((2 * width, 2 * height), 0, 32)
        self._backdrop = self._large.copy()
        self._axis: float | None = None
        self._texts: list[tuple[Any, Point]] = []
        self._fonts: dict[tuple[float, str], Any] = {}
        self._set: dict[tuple[str, float, Colour, str], Any] = {}
        pg.font.init()

    def row(self, y: int, width: float, colour: Colour) -> None:
        """Draw a horizontal line of the backdrop, in rows and columns of the large surface."""
        self.pg.draw.line(self._large, colour, (0, y), (width, y))

    def keep_backdrop(self) -> None:
        """Store the present shapes as the backdrop of all frames."""
        self._backdrop.blit(self._large, (0, 0))

    def start(self) -> None:
        """Start a frame with the backdrop."""
        self._large.blit(self._backdrop, (0, 0))

    def clip(
        self,
        left: float = 0.0,
        top: float = 0.0,
        width: float = 0.0,
        height: float = 0.0,
    ) -> None:
        """Restrict shapes to a box [px]; without arguments, remove the restriction."""
        box = (
            None
            if width == 0.0
            else (round(2 * left), round(2 * top), round(2 * width), round(2 * height))
        )
        self._large.set_clip(box)

    @contextmanager
    def mirrored(self, axis: float) -> Iterator[None]:
        """Exchange left and right of `axis` [px] for all shapes within the block; text is not mirrored."""
        self._axis = axis
        try:
            yield
        finally:
            self._axis = None

    def _placed(
        self, points: Sequence[Point] | NDArray[np.float64]
    ) -> list[list[float]]:
        """Return points on the large surface."""
        large = 2 * np.asarray(points)
        if self._axis is not None:
            large[:, 0] = 4 * self._axis - large[:, 0]
        return large.tolist()

    def finish(self) -> None:
        """Complete a frame: scale the shapes and draw the text."""
        self.pg.transform.smoothscale(self._large, self.frame.get_size(), self.frame)
        self.frame.blits(self._texts, False)
        self._texts.clear()

    def pixels(self) -> NDArray[np.uint8]:
        """Return the frame (height, width, 3) uint8."""
        width, height = self.frame.get_size()
        raw = self.pg.image.tobytes(self.frame, "RGB")
        return np.frombuffer(raw, np.uint8).reshape(height, width, 3).copy()

    def rect(
        self,
        colour: Colour,
        x: float,
        y: float,
        w: float,
        h: float,
        *,
        radius: float = 0.0,
    ) -> None:
        """Draw a filled rectangle from its upper left corner, with rounded corners."""
        if self._axis is not None:
            x = 2 * self._axis - x - w
        left, top = round(2 * x), round(2 * y)
        box = (
            left,
            top,
            max(1, round(2 * (x + w)) - left),
            max(1, round(2 * (y + h)) - top),
        )
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
        """Draw a filled rectangle with a frame of width `line`."""
        self.rect(edge, x, y, w, h, radius=radius)
        self.rect(
            fill,
            x + line,
            y + line,
            w - 2 * line,
            h - 2 * line,
            radius=max(0.0, radius - line),
        )

    def circle(self, colour: Colour, x: float, y: float, r: float) -> None:
        """Draw a disc."""
        self.pg.draw.circle(self._large, colour, self._placed([(x, y)])[0], 2 * r)

    def polygon(
        self, colour: Colour, points: Sequence[Point] | NDArray[np.float64]
    ) -> None:
        """Draw a filled polygon with corners (n, 2)."""
        self.pg.draw.polygon(self._large, colour, self._placed(points))

    def lines(
        self,
        colour: Colour,
        points: Sequence[Point] | NDArray[np.float64],
        width: float,
    ) -> None:
        """Draw a polyline through points (n, 2)."""
        self.pg.draw.lines(
            self._large, colour, False, self._placed(points), max(1, round(2 * width))
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
        """Draw text with its anchor at x and its middle at y [px], reduced or cut to `room` [px]; return its
        width [px]."""
        surface = self._typeset(words, size, colour, face)
        if room is not None:
            for smaller in (0.85 * size, 0.7 * size):
                if surface.get_width() > room:
                    size = smaller
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
            if len(self._set) > 1500:  # changing numbers
                self._set.clear()
            if (size, face) not in self._fonts:
                pixels = max(9, round(size * self.unit))
                self._fonts[size, face] = self.pg.font.Font(_font_file(face), pixels)
            self._set[key] = self._fonts[size, face].render(words, True, colour)
        return self._set[key]


def _font_file(face: str) -> str:
    import matplotlib  # matplotlib includes the DejaVu fonts: equal pictures on all machines

    return str(
        Path(matplotlib.get_data_path())
        / "fonts"
        / "ttf"
        / f"DejaVuSans{'-' + face if face else ''}.ttf"
    )


def number(value: float, digits: int, *, sign: bool = True) -> str:
    """Return a number with a true minus sign, without a negative zero."""
    value = round(value, digits) + 0.0
    return f"{value:{'+' if sign else ''}.{digits}f}".replace("-", "−")
