"""Pictures of cars on a rolling road, and films.

`Renderer.draw` paints one or two snapshots (two for comparison, on the same road with the same scales): a
`CarSnapshot` of a car. The renderer knows nothing of the
simulation; the displacements of the nodes suffice. `write_video` makes a film of frames.

From the bottom up: `palette` and `backend`, the drawing surface (`canvas`), the content (`snapshots`),
symbols of elements (`symbols`), parts of a car (`wheel`, `corner`, `road`), whole cars (`car`), live curves (`curves`, `panel`), frames (`renderer`) and films (`film`). Names for other modules are imported here.
Inside, positions and sizes are in pixels of the frame, motions and roads in metres; `u` is the unit of the layout [px].
"""

from __future__ import annotations

from .backend import check_display
from .film import write_video
from .palette import BLUE, CAR_COLOURS, GREEN, ORANGE, PULL, PURPLE, PUSH, VERMILLION
from .renderer import Renderer
from .snapshots import CarSnapshot, CornerSnapshot

__all__ = [
    "BLUE",
    "CAR_COLOURS",
    "GREEN",
    "ORANGE",
    "PULL",
    "PURPLE",
    "PUSH",
    "VERMILLION",
    "CarSnapshot",
    "CornerSnapshot",
    "Renderer",
    "check_display",
    "write_video",
]
