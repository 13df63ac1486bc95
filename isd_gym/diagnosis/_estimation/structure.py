"""Structures: effects inserted into a network, and the free parameters of a fit."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ..._common.arrays import Z95
from ..._common.errors import InputError
from ...physics import elements as el
from ...physics.network import GROUND, Channel, Network

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

#: how far the base parameters may move, in prior standard deviations
REACH = 3.0
#: one sigma of the logarithm of a new parameter about the size that the data suggest, and how far the logarithm may rise and fall: stiff laws
#: are slow to simulate, and a law may vanish
WIDE, RISE, FALL = 5.0, math.log(1e2), math.log(1e4)
#: standard deviation of the logarithm of a parameter that stays near its start value
SURE = 1e-4

#: largest logarithm of a value within an interval
LARGEST_LOG = 700.0
#: networks that a structure keeps
LATEST = 50


@dataclass(frozen=True)
class Free:
    """A free parameter: path in the network, transform, prior and limits (in transformed units)."""

    path: str
    log: bool
    mean: float
    sigma: float
    low: float
    high: float
    owner: int  # -1: the base model, else the index of the hypothesis
    stride: float = math.inf  # how far one step of a fit may go

    def forward(self, value: float) -> float:
        return math.log(max(value, 1e-300)) if self.log else value

    def back(self, x: float) -> float:
        return math.exp(x) if self.log else x

    def interval(self, x: float, sigma: float) -> tuple[float, float]:
        """Return the ends of the 95 % interval of a value, from its mean and deviation (transformed)."""
        half = Z95 * sigma
        if not self.log:
            return x - half, x + half
        return self.back(max(x - half, -LARGEST_LOG)), self.back(
            min(x + half, LARGEST_LOG)
        )

    def step(self, x: float) -> float:
        """Return the step of a finite difference at `x` (transformed)."""
        return 2e-3 if self.log else 1e-3 * max(abs(x), 0.03 * self.sigma, 1e-12)


@dataclass(frozen=True)
class Hypothesis:
    """An effect of the library at a place."""

    #: type of the element
    effect: str
    #: two nodes, a motor or a channel
    where: tuple[str, ...]
    #: options that are not numbers: name, value
    options: tuple[tuple[str, str], ...] = ()
    #: for an effect in series: the element that the effect carries; empty for all elements at the place
    behind: str = ""

    @property
    def kind(self) -> type[el.Element]:
        return el.TYPES[self.effect]

    @property
    def place(self) -> str:
        return self.kind.place

    @property
    def choices(self) -> dict[str, str]:
        """Choices that are not numbers: options, and the partner in series."""
        return dict(self.options) | ({"behind": self.behind} if self.behind else {})

    def stands(self, network: Network) -> bool:
        """Return whether the effect makes sense at the place, and is no other value of a known parameter."""
        if not self.behind:
            return self.kind.stands(network, self.where)
        here = [e.name for e in el.beside(network, self.where)]
        alone = [
            e for e in network.elements if e.name not in here or e.name == self.behind
        ]
        return self.kind.stands(unchecked(network, elements=tuple(alone)), self.where)

    @property
    def label(self) -> str:
        extra = "".join(f" ({v})" for _, v in self.options) + (
            f" (of {self.behind})" if self.behind else ""
        )
        return f"{self.effect} at {'-'.join(self.where)}{extra}"


@dataclass(frozen=True)
class Structure:
    """A network with inserted effects, and the free parameters."""

    network: Network
    free: tuple[Free, ...]
    hypotheses: tuple[Hypothesis, ...] = ()
    names: tuple[str, ...] = ()  # of the elements that the hypotheses brought
    ties: tuple[tuple[str, str], ...] = ()  # (path, path it follows)
    #: sensor offset of each output, equal for all records [unit of the channel]; None before an estimate
    offsets: tuple[float, ...] | None = None

    @cached_property
    def _made(self) -> dict[bytes, Network]:
        """The latest networks by their parameters: a network keeps its equations of motion."""
        return {}

    def at(self, x: np.ndarray) -> Network:
        """Return the network with values of the free parameters, transformed (parameters,)."""
        key, made = x.tobytes(), self._made
        network = made.get(key)
        if network is None:
            if len(made) >= LATEST:
                made.clear()
            network = made[key] = self._network(x)
        return network

    def _network(self, x: np.ndarray) -> Network:
        values = {f.path: f.back(float(v)) for f, v in zip(self.free, x, strict=True)}
        known = self.network.parameters
        for path, source in self.ties:
            values[path] = values.get(source, known[source])
        return self.network.with_parameters(values) if values else self.network

    @property
    def start(self) -> np.ndarray:
        known = self.network.parameters
        return np.array([f.forward(known[f.path]) for f in self.free])

    def start_from(self, known: Mapping[str, float]) -> np.ndarray:
        """Return start values (parameters,), transformed: known ones by path, the network's own for the others."""
        return np.array(
            [known.get(f.path, v) for f, v in zip(self.free, self.start, strict=True)]
        )

    @property
    def mean(self) -> np.ndarray:
        """Prior means of the free parameters (parameters,)."""
        return np.array([f.mean for f in self.free])

    @property
    def sigma(self) -> np.ndarray:
        """Prior standard deviations of the free parameters (parameters,)."""
        return np.array([f.sigma for f in self.free])


def base_structure(network: Network) -> Structure:
    known = network.parameters
    free = []
    for path, sigma in network.uncertainty.items():
        value = known[path]
        if sigma <= 0:
            continue
        if value > 0:
            s = math.log1p(sigma)
            m = math.log(value)
            low = REACH * s
            if REACH * sigma >= 1.0 and may_vanish(network, path):
                low = FALL
            free.append(Free(path, True, m, s, m - low, m + REACH * s, -1))
        elif value != 0:
            s = sigma * abs(value)
            free.append(
                Free(path, False, value, s, value - REACH * s, value + REACH * s, -1)
            )
        else:
            s = sigma * usual(network, path)
            owner, _, name = path.rpartition(".")
            own = el.parameter_fields(type(network.element(owner)))
            signed = next(f.metadata["minimum"] < 0 for f in own if f.name == name)
            free.append(
                Free(path, False, 0.0, s, -REACH * s if signed else 0.0, REACH * s, -1)
            )
    return Structure(network, tuple(free))


def may_vanish(network: Network, path: str) -> bool:
    """Return whether a parameter may be zero: that of an element, not an inertia."""
    owner, _, name = path.rpartition(".")
    element = next((e for e in network.elements if e.name == owner), None)
    own = el.parameter_fields(type(element)) if element else ()
    return any(f.name == name and f.metadata["minimum"] == 0 for f in own)


def usual(network: Network, path: str) -> float:
    """Return the scale of a parameter that starts at zero: critical damping, or the largest value of the same kind; raise InputError
    without one."""
    parts = [e.linear() for e in network.elements if e.place == "between"]
    k, c, b = (max((p[i] for p in parts), default=0.0) for i in range(3))
    owner, _, name = path.rpartition(".")
    m = max(network.largest_inertia(*network.element(owner).where), b)
    sizes = {
        "N/m": [k],
        "N s/m": [2.0 * math.sqrt(k * m), c],
        "kg": [m],
        "N": [max((getattr(e, "level", 0.0) for e in network.elements), default=0.0)],
    }
    field_of = {f.name: f for f in el.parameter_fields(type(network.element(owner)))}
    size = next(
        (s for s in sizes.get(field_of[name].metadata["unit"], []) if s > 0), 0.0
    )
    if not size:
        raise InputError(
            f"uncertainty: '{path}' is zero, and nothing in the model says what would be much of it: "
            "give it a small value that it may grow from"
        )
    return size


def free_of(element: el.Element, owner: int) -> list[Free]:
    """Return the free parameters of a new element, with wide priors around the start values: a rig may have any scale."""
    out = []
    for f in el.parameter_fields(type(element)):
        meta = f.metadata
        if meta["fixed"]:
            continue
        value = getattr(element, f.name)
        path, stride = f"{element.name}.{f.name}", meta["stride"] or math.inf
        largest = (1.0 - 1e-9) * meta["maximum"]
        low, high = meta["plausible"] or (-largest, largest)
        if meta["minimum"] >= 0:
            m = math.log(max(value, 1e-300))
            fall, rise = FALL, RISE
            if meta["reach"]:
                fall = rise = math.log(meta["reach"])
            least = max(m - fall, math.log(low) if low > 0 else -math.inf)
            most = min(m + rise, math.log(high))
            out.append(Free(path, True, m, WIDE, least, most, owner, stride))
        else:
            known = f.default if isinstance(f.default, int | float) else 0.0
            spread = meta["spread"] or 30.0 * max(abs(value), 1e-9)
            out.append(Free(path, False, known, spread, low, high, owner, stride))
    return out


def _plausible(cls: type[el.Element], values: Mapping[str, float]) -> dict[str, float]:
    """Return start values moved into the plausible ranges of a missing effect."""
    out = dict(values)
    for f in el.parameter_fields(cls):
        limits = f.metadata["plausible"]
        if limits and f.name in out:
            out[f.name] = min(max(out[f.name], limits[0]), limits[1])
    return out


def add(structure: Structure, h: Hypothesis, values: Mapping[str, float]) -> Structure:
    """Return the structure with one more effect at start values; raise InputError where the effect cannot be inserted."""
    network, cls, where = structure.network, h.kind, h.where
    name = network.free_name(h.effect)
    free, ties = list(structure.free), list(structure.ties)
    found = list(zip(structure.hypotheses, structure.names, strict=True))
    if cls.series:
        network, where = split(network, where, name, h.behind)
    here = el.beside(network, where) if cls.place == "between" else []
    gone = [e.name for e in here if e.type in cls.replaces]
    tied = cls.tied(network, where)
    data = {
        **_plausible(cls, values),
        **{key: network.parameters[path] for key, path in tied.items()},
    }
    element = cls(name=name, where=where, **data, **dict(h.options))
    network = replace(
        network,
        elements=(*network.elements, element),
        outputs=cells_beside(network, element),
    )
    for other in gone:  # what replaces it stands there by now
        network = drop(network, other)
        free = [f for f in free if not f.path.startswith(f"{other}.")]
        found = [(known, its) for known, its in found if its != other]
    held = cls.held(dict(h.options))
    free += [
        f for f in free_of(element, len(found)) if f.path.rpartition(".")[2] not in tied
    ]
    # a number that a fit reports but does not move
    free = [
        replace(f, sigma=SURE, low=f.mean, high=f.mean)
        if f.path in {f"{name}.{key}" for key in held}
        else f
        for f in free
    ]
    ties += [(f"{name}.{key}", path) for key, path in tied.items()]
    found.append((h, name))
    hypotheses, names = zip(*found, strict=True)
    return Structure(
        network, tuple(free), hypotheses, names, tuple(ties), structure.offsets
    )


def offsets_of(network: Network, output: Channel) -> list[el.SensorBias]:
    """Return the effects that hold the known part of an output's free offset (`with_sensor_offsets`)."""
    biases = [e for e in network.elements if isinstance(e, el.SensorBias)]
    return [e for e in biases if output.offset and e.where[0] == output.name]


def with_sensor_offsets(network: Network, offsets: Sequence[float] | None) -> Network:
    """Return the model with the fitted offsets of its sensors [unit of the channel] as effects `sensor_bias`, which later offsets add
    to."""
    for c, offset in zip(network.outputs, offsets or (), strict=bool(offsets)):
        if c.offset != "free" or not offset:
            continue
        here = [
            e for e in network.elements if e.place == "channel" and e.where[0] == c.name
        ]
        last = here[-1] if here else None
        if isinstance(last, el.SensorBias):
            path = f"{last.name}.bias"
            network = network.with_parameters({path: last.bias + offset})
            continue
        kind: type[el.Element] = el.SensorBias
        bias = kind(
            name=network.free_name(f"{c.name}_offset"),
            where=(c.name,),
            **{"bias": float(offset)},
        )
        network = replace(network, elements=(*network.elements, bias))
    return network


def parameter_values(element: el.Element) -> dict[str, float]:
    """Return the parameters of an element by name."""
    return {
        f.name: getattr(element, f.name) for f in el.parameter_fields(type(element))
    }


def cells_beside(network: Network, element: el.Element) -> tuple[Channel, ...]:
    """Return the outputs; a load cell also reads an element in parallel with its own element."""
    out = []
    for c in network.outputs:
        cell = [network.element(n) for n in c.elements]
        if (
            cell
            and element.place == "between"
            and all(e.where == element.where for e in cell)
        ):
            c = replace(c, element=(*c.elements, element.name))
        out.append(c)
    return tuple(out)


def drop(network: Network, name: str) -> Network:
    kept = {
        k: v for k, v in network.uncertainty.items() if not k.startswith(f"{name}.")
    }
    outputs = []
    for c in network.outputs:
        if name in c.elements and len(c.elements) == 1:
            raise InputError(
                f"output '{c.name}' reads '{name}', which cannot be replaced"
            )
        outputs.append(
            replace(c, element=tuple(n for n in c.elements if n != name))
            if name in c.elements
            else c
        )
    elements = tuple(e for e in network.elements if e.name != name)
    return replace(network, elements=elements, outputs=tuple(outputs), uncertainty=kept)


def split(
    network: Network, pair: tuple[str, ...], stem: str, behind: str = ""
) -> tuple[Network, tuple[str, str]]:
    """Put everything between a pair, or the element `behind` alone, behind a new node next to its first terminal, a moved one first; the
    gap is returned."""
    if behind and behind not in {e.name for e in el.beside(network, pair)}:
        raise InputError(f"'{behind}' does not stand between {' and '.join(pair)}")
    first, second = pair
    if second in network.moved_nodes and first not in network.moved_nodes:
        first, second = second, first
    node = network.free_name(
        f"{first}_{stem}" if first != GROUND else f"{second}_{stem}"
    )
    moved = []
    for e in network.elements:
        if (
            e.place == "between"
            and set(e.where) == {first, second}
            and behind in ("", e.name)
        ):
            e = replace(e, where=tuple(node if n == first else n for n in e.where))
        moved.append(e)
    # two terminals in the owner's order, so that the sign of elongation stays; the element in series closes the gap later
    return unchecked(network, elements=tuple(moved)), (first, node)


def unchecked(network: Network, **changes: object) -> Network:
    """Return a network with changes that the checks of `Network` would refuse."""
    out = object.__new__(Network)
    out.__dict__.update(
        {f.name: getattr(network, f.name) for f in fields(Network)} | changes
    )
    return out


def twin(node: str, known: Collection[str]) -> str:
    """Return the known node from which a node was split; a known node is its own origin."""
    while node not in known and "_" in node:
        node = node.rpartition("_")[0]
    return node


def owner_pair(network: Network, h: Hypothesis) -> tuple[str, str] | None:
    """Return the terminals of an effect in nodes of the nominal model; a motor's terminals for an effect of a drive."""
    if h.place == "channel":
        return None
    if h.place == "element":
        return network.element(h.where[0]).between
    known = {*network.nodes, GROUND}
    first, second = (twin(n, known) for n in h.where)
    return first, second
