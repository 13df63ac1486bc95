"""A suspension as a network: masses, named nodes, and two-terminal elements between them.

`Network` is the model (`model`), `isd-model/1` its JSON file (`format`); `assemble` turns it into equations of motion
without any hand derivation (`assembly`, `frames`), and `linearise` into a state space with named signals, for controllers and frequency
responses (`linear`).
"""

from ..units import UNITS
from .assembly import Assembly, assemble
from .bodies import AXES, Body, Lever, Point
from .cut import cut, rejoin, without
from .format import SCHEMA, builtin_networks
from .linear import StateSpace, linearise, natural_frequencies, own_time, transfer
from .model import GROUND, MOTIONS, Channel, Network

__all__ = [
    "AXES",
    "GROUND",
    "MOTIONS",
    "SCHEMA",
    "UNITS",
    "Assembly",
    "Body",
    "Channel",
    "Lever",
    "Network",
    "Point",
    "StateSpace",
    "assemble",
    "builtin_networks",
    "cut",
    "linearise",
    "natural_frequencies",
    "own_time",
    "rejoin",
    "transfer",
    "without",
]
