"""Test records with a hidden effect: a seeded generator of rigs, made by `reference`, not by the kernel.

`make_case(kind, seed)` draws a true network, small unmodelled effects of a few per cent (nuisances), one
hidden effect or two or none, records of it with coloured noise, and the model as its owner believes it:
without the hidden effect and the nuisances, and with base parameters off by a few per cent. `ALL_KINDS` names
all kinds. Levels follow the shared blind rigs: 500 Hz, AR(1) noise of 26 to 40 dB, a road record imperfect by
0.2 %, the current held for 5 ms, another road with a bump for validation.

A force cell reads everything that acts between its terminals, so the record of an element's force holds the
effects that stand side by side with that element.
"""

from ..case import Case
from .make import ALL_KINDS, family, make_case

__all__ = ["ALL_KINDS", "Case", "family", "make_case"]
