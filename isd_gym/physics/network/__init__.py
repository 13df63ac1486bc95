"""A suspension as a network: masses, named nodes, and two-terminal elements between nodes.

`Network` is the model (`_model`), and `isd-model/1` its JSON format (`_format`). `assemble` derives the
equations of motion (`_assembly`, `frames`). `linearise` gives a state space with named signals, for
controllers and frequency responses (`_linear`).
"""

from ..._common.units import UNITS
from ._assembly import Assembly, assemble, assemble_all
from ._bodies import AXES, Body, Lever, Point
from ._cut import cut, rejoin, without
from ._format import SCHEMA, builtin_networks
from ._linear import (
    StateSpace,
    linearise,
    natural_frequencies,
    own_time,
    slowest_time,
    transfer,
)
from ._model import GROUND, MOTIONS, Channel, Network

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
    "assemble_all",
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
