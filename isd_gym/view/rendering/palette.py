"""Colours of the pictures.

The colours of the cars are those of Okabe and Ito (Color Universal Design, 2008), which colour-blind readers
can distinguish. No meaning depends on colour alone.
"""

from __future__ import annotations

Colour = tuple[int, int, int]

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
GROUND_FAR: Colour = (232, 229, 224)
GROUND_MARK: Colour = (184, 176, 165)
OIL: Colour = (250, 222, 160)

CAR_COLOURS = (BLUE, VERMILLION)
PULL, PUSH = GREEN, PURPLE  # contracting thrust (positive current), extending thrust


def mix(first: Colour, second: Colour, share: float) -> Colour:
    """Return a mixture of two colours."""
    r, g, b = (round(a + (c - a) * share) for a, c in zip(first, second, strict=True))
    return r, g, b
