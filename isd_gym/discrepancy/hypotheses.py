"""What could be missing, and where: every effect of the library at every place where it makes physical sense."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from .. import elements as el
from ..errors import InputError
from ..network import GROUND, Network, assemble

#: a plain name of what a law does to its terminals, for rivals that are worth telling apart
SERIES = ("series_compliance", "backlash")
DRY = ("coulomb_friction", "stribeck_friction")


@dataclass(frozen=True)
class Free:
    """A number to be fitted: `path` in the network, its transform, prior and limits (in transformed units)."""

    path: str
    log: bool
    mean: float
    sigma: float
    low: float
    high: float
    owner: int  # -1: the base model, else the index of the hypothesis

    def forward(self, value: float) -> float:
        return math.log(max(value, 1e-300)) if self.log else value

    def back(self, x: float) -> float:
        return math.exp(x) if self.log else x


@dataclass(frozen=True)
class Hypothesis:
    """An effect of the library at a place: two nodes, a motor or a channel. `options` are its non-numeric choices."""

    effect: str
    where: tuple[str, ...]
    options: tuple[tuple[str, str], ...] = ()

    @property
    def place(self) -> str:
        return el.TYPES[self.effect].place

    @property
    def label(self) -> str:
        extra = "".join(f" ({v})" for _, v in self.options)
        return f"{self.effect} at {'-'.join(self.where)}{extra}"


@dataclass(frozen=True)
class Structure:
    """A network with hypotheses built in, and the numbers that may move."""

    network: Network
    free: tuple[Free, ...]
    hypotheses: tuple[Hypothesis, ...] = ()
    names: tuple[str, ...] = ()  # of the elements that the hypotheses brought
    ties: tuple[tuple[str, str], ...] = ()  # (path, path it follows)

    def at(self, x: np.ndarray) -> Network:
        values = {f.path: f.back(float(v)) for f, v in zip(self.free, x, strict=True)}
        known = self.network.parameters
        for path, source in self.ties:
            values[path] = values.get(source, known[source])
        return self.network.with_parameters(values) if values else self.network

    @property
    def start(self) -> np.ndarray:
        known = self.network.parameters
        return np.array([f.forward(known[f.path]) for f in self.free])


#: how far the base parameters may move, in prior standard deviations
REACH = 4.0


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
            free.append(Free(path, True, m, s, m - REACH * s, m + REACH * s, -1))
        elif value != 0:
            s = sigma * abs(value)
            free.append(Free(path, False, value, s, value - REACH * s, value + REACH * s, -1))
    return Structure(network, tuple(free))


def free_of(cls: type[el.Element], owner: int, element: el.Element) -> list[Free]:
    out = []
    for f in el.parameter_fields(cls):
        if f.metadata["fixed"]:
            continue
        low, high = f.metadata["range"]
        value = getattr(element, f.name)
        path = f"{element.name}.{f.name}"
        if f.metadata["minimum"] >= 0 and low >= 0 and cls.place != "channel":
            # wide: the plausible range is that of a car corner, a rig may lie outside
            low, high = max(low, 1e-12), max(high, low * 10)
            centre, half = 0.5 * (math.log(low) + math.log(high)), 0.5 * (math.log(high) - math.log(low))
            reach = math.log(1e3)
            out.append(Free(path, True, centre, 2.0 * half + 2.0, centre - half - reach, centre + half + reach, owner))
        else:
            scale = {"gain": 1.0, "phase": 100.0}.get(f.name)
            if scale is None:
                scale = 30.0 * max(abs(value), 1e-9)
            if f.name == "delay":
                out.append(Free(path, True, math.log(0.01), 3.0, math.log(1e-5), math.log(1.0), owner))
                continue
            centre = value if f.name == "gain" else 0.0
            out.append(Free(path, False, centre, scale, -math.inf, math.inf, owner))
    return out


def add(structure: Structure, h: Hypothesis, values: Mapping[str, float]) -> Structure:
    """The structure with one more effect built in at start `values`. Raises `InputError` where it cannot stand."""
    network = structure.network
    cls = el.TYPES[h.effect]
    name = network.free_name(h.effect)
    owner = len(structure.hypotheses)
    ties = list(structure.ties)
    free = list(structure.free)
    options: dict[str, Any] = dict(h.options)
    data = dict(values)
    if h.effect in SERIES:
        network = split(network, h.where)
        node = network.nodes_added  # type: ignore[attr-defined]
        raise InputError(node)
    where = h.where
    if h.effect == "stribeck_friction":
        for e in network.elements:
            if isinstance(e, el.CoulombFriction) and set(e.where) == set(where):
                # a Stribeck curve holds the constant level already: it takes the Coulomb element's place
                network = drop(network, e.name)
                free = [f for f in free if not f.path.startswith(f"{e.name}.")]
    if h.effect == "tyre_lift_off":
        spring = next(e for e in network.elements if e.type == "linear_stiffness" and e.where == where)
        data["stiffness"] = spring.stiffness  # type: ignore[attr-defined]
        ties.append((f"{name}.stiffness", f"{spring.name}.stiffness"))
    element = cls(name=name, where=where, **data, **options)
    network = replace(network, elements=(*network.elements, element))
    tied = {path for path, _ in ties}
    free += [f for f in free_of(cls, owner, element) if f.path not in tied]
    return Structure(network, tuple(free), (*structure.hypotheses, h), (*structure.names, name), tuple(ties))


def drop(network: Network, name: str) -> Network:
    kept = {k: v for k, v in network.uncertainty.items() if not k.startswith(f"{name}.")}
    return replace(network, elements=tuple(e for e in network.elements if e.name != name), uncertainty=kept)
