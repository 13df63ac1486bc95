"""Rulers: the real size of lengths in a picture."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .palette import MUTED

if TYPE_CHECKING:
    from .canvas import Canvas
    from .road import Window


def rulers(c: Canvas, window: Window, scale: float, factor: float) -> None:
    """Draw a vertical ruler of motions with their exaggeration at the left, and a metre of road at the right.

    Args:
        c: Canvas.
        window: Part of the picture with the road.
        scale: Length of a metre of motion [px].
        factor: Factor of the exaggerated motions.
    """
    u = c.unit
    margin, foot = 10 * u, window.foot - 11 * u
    tall = next((mm for mm in (10, 20, 50, 100, 200, 500, 1000) if mm * 1e-3 * scale > 8 * u), 2000)
    rise = tall * 1e-3 * scale
    x, y = window.left + margin, window.foot - 6 * u
    for a, b in ((y - rise, y - rise), (y, y)):
        c.rect(MUTED, x - 2.5 * u, a - 0.5 * u, 5 * u, b - a + u)
    c.rect(MUTED, x - 0.5 * u, y - rise, u, rise)
    words = f"{tall} mm, vertical ×{factor:g}"
    c.text(words, x + 6 * u, foot, size=9.5, colour=MUTED)
    run, right = window.metre, window.right - margin
    for edge in (right - run, right):
        c.rect(MUTED, edge - 0.5 * u, foot - 2.5 * u + 4 * u, u, 5 * u)
    c.rect(MUTED, right - run, foot + 3.5 * u, run, u)
    c.text("1 m", right - run / 2, foot - 4 * u, size=9.5, colour=MUTED, anchor="center")
