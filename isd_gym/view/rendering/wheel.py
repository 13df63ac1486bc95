"""Wheels on the road, from the side and from behind.

Lengths are in units of the layout; the radius of a wheel at rest is `RADIUS`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from .palette import INK, STEEL, STEEL_FAR, WHITE, Colour

if TYPE_CHECKING:
    from .canvas import Canvas

RADIUS = 38.0
METRES = 0.32  # radius of the represented wheel [m]
SQUASH = 4.0  # compression of the tyre under its static load
WIDTH = 24.0  # width from behind
RUBBER: Colour = (58, 63, 68)
RUBBER_FAR: Colour = (176, 182, 188)


def tyre(
    c: Canvas,
    x: float,
    hub: float,
    contact: float,
    u: float,
    *,
    lifted: bool,
    colour: Colour = RUBBER,
    is_rear: bool = False,
) -> None:
    """Draw a tyre about its hub [px], in contact with the road [px] while it carries load; from the side, the
    road is painted over the compressed part."""
    radius = RADIUS * u
    if is_rear:
        foot = hub + radius if lifted else contact + 1.5 * u
        top = hub - radius
        c.rect(colour, x - WIDTH / 2 * u, top, WIDTH * u, foot - top, radius=6 * u)
        if colour == RUBBER:
            for groove in (-5.0, 5.0):
                c.rect(
                    (92, 98, 104),
                    x + (groove - 0.8) * u,
                    top + 3 * u,
                    1.6 * u,
                    max(0.0, foot - top - 6 * u),
                )
        return
    gap = contact - hub
    angle = np.linspace(0.0, 2 * np.pi, 73)[:-1]  # from the lowest point
    below = np.maximum(np.cos(angle), 0.0)
    squash = float(np.clip((radius - gap) / radius, 0.0, 0.5))
    aside = np.abs((angle + np.pi) % (2 * np.pi) - np.pi)
    bulge = 1.0 + 0.35 * squash * np.exp(-(((aside - 0.75) / 0.35) ** 2))
    stretch = 1.0 if lifted else max(1.0, (gap + 1.5 * u) / radius)
    across = x + radius * bulge * np.sin(angle)
    down = hub + radius * bulge * np.where(below > 0, stretch, 1.0) * np.cos(angle)
    c.polygon(colour, np.column_stack([across, down]))


def side_rim(c: Canvas, x: float, hub: float, u: float, turn: float) -> None:
    """Draw the rim of a wheel from the side, rolled by the angle `turn` [rad]."""
    c.circle(STEEL_FAR, x, hub, 24 * u)
    c.circle((238, 240, 242), x, hub, 21.5 * u)
    for k in range(5):
        angle = turn + 2 * math.pi * k / 5
        s, n = math.sin(angle), math.cos(angle)
        spoke = [(5, -3), (22, -2), (22, 2), (5, 3)]
        c.polygon(
            STEEL_FAR,
            [(x + (a * n - b * s) * u, hub + (a * s + b * n) * u) for a, b in spoke],
        )


def carrier(
    c: Canvas, x: float, hub: float, top: float, reach: float, u: float, pin: float
) -> None:
    """Draw hub, upright and the plate over the tyre that carries the suspension."""
    c.rect(STEEL, x - 3 * pin, top, 6 * pin, hub - top, radius=3 * pin)
    c.circle(INK, x, hub, 5 * pin)
    c.circle(WHITE, x, hub, 2 * pin)
    c.rect(INK, x - reach, top - 2.5 * u, 2 * reach, 5 * u, radius=2.5 * u)
