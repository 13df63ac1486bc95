"""A suspension as a network: masses, named nodes, and two-terminal elements between nodes.

`Network` is the model (`model`), and `isd-model/1` its JSON format (`format`). `assemble` derives the
equations of motion (`assembly`, `frames`). `linearise` gives a state space with named signals, for
controllers and frequency responses (`linear`).
"""

from ...common.units import UNITS
from .assembly import Assembly, assemble
from .bodies import AXES, Body, Lever, Point
from .cut import cut, rejoin, without
from .format import SCHEMA, builtin_networks
from .linear import StateSpace, linearise, natural_frequencies, own_time, slowest_time, transfer
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
    "slowest_time",
    "transfer",
    "without",
]
