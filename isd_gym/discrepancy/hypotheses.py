"""What could be missing, and where: every effect of the library at every place where it makes physical sense."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from .. import elements as el
from ..errors import InputError
from ..network import GROUND, Channel, Network

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
REACH = 3.0


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
            out.append(
                Free(
                    path, True, centre, 2.0 * half + 2.0, centre - half - reach, centre + half + reach, owner
                )
            )
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
    ties = list(structure.ties)
    free = list(structure.free)
    found = list(zip(structure.hypotheses, structure.names, strict=True))
    options: dict[str, Any] = dict(h.options)
    data = dict(values)
    where = h.where
    if h.effect in SERIES:
        network, where = split(network, h.where, name)
    if h.effect == "stribeck_friction":
        for e in network.elements:
            if isinstance(e, el.CoulombFriction) and set(e.where) == set(where):
                # a Stribeck curve holds the constant level already: it takes the Coulomb element's place
                network = drop(network, e.name)
                free = [f for f in free if not f.path.startswith(f"{e.name}.")]
                found = [(other, its) for other, its in found if its != e.name]
    if h.effect == "tyre_lift_off":
        spring = next(e for e in network.elements if e.type == "linear_stiffness" and e.where == where)
        data["stiffness"] = spring.stiffness  # type: ignore[attr-defined]
        ties.append((f"{name}.stiffness", f"{spring.name}.stiffness"))
    element = cls(name=name, where=where, **data, **options)
    network = replace(network, elements=(*network.elements, element), outputs=_cells(network, element))
    tied = {path for path, _ in ties}
    free += [f for f in free_of(cls, len(found), element) if f.path not in tied]
    found.append((h, name))
    return Structure(
        network, tuple(free), tuple(h for h, _ in found), tuple(its for _, its in found), tuple(ties)
    )


def _cells(network: Network, element: el.Element) -> tuple[Channel, ...]:
    """The outputs, a force cell reading what was put side by side with its element, too."""
    out = []
    for c in network.outputs:
        beside = [network.element(n) for n in c.elements]
        if beside and element.place == "between" and all(e.where == element.where for e in beside):
            c = replace(c, element=(*c.elements, element.name))
        out.append(c)
    return tuple(out)


def drop(network: Network, name: str) -> Network:
    kept = {k: v for k, v in network.uncertainty.items() if not k.startswith(f"{name}.")}
    outputs = []
    for c in network.outputs:
        if name in c.elements and len(c.elements) == 1:
            raise InputError(f"output '{c.name}' reads '{name}', which cannot be replaced")
        outputs.append(
            replace(c, element=tuple(n for n in c.elements if n != name)) if name in c.elements else c
        )
    elements = tuple(e for e in network.elements if e.name != name)
    return replace(network, elements=elements, outputs=tuple(outputs), uncertainty=kept)


def split(network: Network, pair: tuple[str, ...], stem: str) -> tuple[Network, tuple[str, str]]:
    """Everything between the pair moved behind a new node next to its first terminal; the gap is what is returned.

    A moved terminal goes first, so that the rig still moves it.
    """
    first, second = pair
    if second in network.moved_nodes and first not in network.moved_nodes:
        first, second = second, first
    node = network.free_name(f"{first}_{stem}" if first != GROUND else f"{second}_{stem}")
    keep = first
    moved = []
    for e in network.elements:
        if e.place == "between" and set(e.where) == {first, second}:
            e = replace(e, where=tuple(node if n == keep else n for n in e.where))
        moved.append(e)
    # two terminals in the owner's order, so that the sign of elongation stays
    gap = (keep, node)
    return _Opened.of(network, tuple(moved)), gap


def twin(node: str, known: Collection[str]) -> str:
    """The node of `known` that one which `split` put in was split from; a known one is its own."""
    while node not in known and "_" in node:
        node = node.rpartition("_")[0]
    return node


class _Opened:
    """A network is checked on construction; this one is only whole once the series element closes the gap."""

    @staticmethod
    def of(network: Network, moved: tuple[el.Element, ...]) -> Network:
        out = object.__new__(Network)
        for f in fields(Network):
            object.__setattr__(out, f.name, getattr(network, f.name))
        object.__setattr__(out, "elements", moved)
        return out


# ----------------------------------------------------------------------------------- where effects can stand


def pairs(network: Network) -> list[tuple[str, str]]:
    """Pairs of nodes where something can stand: those joined already, masses among one another, a lone mass and ground."""
    out: dict[frozenset[str], tuple[str, str]] = {}
    for e in network.elements:
        if e.place == "between" and not isinstance(e, el.SeriesCompliance | el.Backlash):
            out.setdefault(frozenset(e.where), e.between)
    masses = list(network.masses)
    for i, a in enumerate(masses):
        for b in masses[i + 1 :]:
            out.setdefault(frozenset((a, b)), (a, b))
    if len(masses) == 1 and not network.moved_nodes:
        out.setdefault(frozenset((masses[0], GROUND)), (masses[0], GROUND))
    return list(out.values())


def standing(network: Network, pair: tuple[str, ...]) -> list[el.Element]:
    return [e for e in network.elements if e.place == "between" and set(e.where) == set(pair)]


def in_line(network: Network, first: tuple[str, ...], second: tuple[str, ...]) -> bool:
    """Whether one force passes through both pairs: they are links of a chain whose inner nodes have no mass."""
    links = {frozenset(e.where) for e in network.elements if e.place == "between"}
    ends = {GROUND, *network.masses, *network.moved_nodes}
    chain, grown = {frozenset(first)}, True
    while grown:
        grown = False
        for node in {n for link in chain for n in link} - ends:
            here = {link for link in links if node in link}
            if len(here) == 2 and not here <= chain:
                chain, grown = chain | here, True
    return frozenset(second) in chain


def hypotheses(network: Network) -> Iterator[Hypothesis]:
    """Every effect at every place where it is not a mere change of a parameter that is there already."""
    motors = [e for e in network.elements if isinstance(e, el.Motor)]
    driven = {c.element for c in network.inputs if c.quantity == "current"}
    devices = {frozenset(e.where) for e in network.elements if isinstance(e, el.Motor | el.Inertance)} or {
        frozenset(p) for p in pairs(network)
    }
    for pair in pairs(network):
        here = {e.type for e in standing(network, pair)}
        moved = any(n in network.moved_nodes for n in pair)
        elastic = bool({"linear_stiffness", "series_compliance"} & here)
        for kind in ("linear_stiffness", "linear_damping", "inertance"):
            if kind in here or (kind == "linear_stiffness" and elastic):
                continue
            yield Hypothesis(kind, pair)
        if not {"coulomb_friction", "stribeck_friction"} & here:
            yield Hypothesis("coulomb_friction", pair)
        if "stribeck_friction" not in here:
            yield Hypothesis("stribeck_friction", pair)
        for kind in (
            "quadratic_damping",
            "asymmetric_damping",
            "cubic_stiffness",
            "gas_spring",
            "hysteresis",
        ):
            if kind not in here:
                yield Hypothesis(kind, pair)
        if "bump_stop" not in here:
            for side in ("both", "extension", "compression"):
                yield Hypothesis("bump_stop", pair, (("side", side),))
        if frozenset(pair) in devices:
            if "cogging_force" not in here:
                yield Hypothesis("cogging_force", pair)
            # to the ground it is an inertance
            if "terminal_inertia" not in here and (GROUND not in pair or "inertance" in here):
                for terminal in ("first", "second"):
                    if pair[0 if terminal == "first" else 1] != GROUND:
                        yield Hypothesis("terminal_inertia", pair, (("terminal", terminal),))
        if (
            moved
            and "linear_stiffness" in here
            and "tyre_lift_off" not in here
            and set(pair) & set(network.masses)
        ):
            yield Hypothesis("tyre_lift_off", pair)
        if here - {"linear_stiffness"}:  # a spring in series with a lone spring is a softer spring
            yield Hypothesis("series_compliance", pair)
        if here:
            yield Hypothesis("backlash", pair)
    for m in motors:
        if m.name in driven:
            here = {e.type for e in network.elements if e.place == "element" and e.where[0] == m.name}
            for kind in ("thrust_saturation", "actuator_lag", "actuator_delay"):
                if kind not in here:
                    yield Hypothesis(kind, (m.name,))
    for c in network.outputs:
        here = {e.type for e in network.elements if e.place == "channel" and e.where[0] == c.name}
        for kind in ("sensor_gain", "sensor_bias", "sensor_delay"):
            if kind not in here and not (kind == "sensor_bias" and c.offset):
                yield Hypothesis(kind, (c.name,))


@dataclass(frozen=True)
class Motion:
    """What happens between a pair of nodes in the simulation at hand: elongation d [m], its rate v and acceleration a."""

    d: np.ndarray
    v: np.ndarray
    a: np.ndarray


PROBE = 0.05  # share of the data's typical force that a probe gives


@dataclass(frozen=True)
class Probe:
    """Start values to try. `ways`: value sets whose responses are projected together; `grows`: what scales with amplitude."""

    values: dict[str, float]
    ways: tuple[dict[str, float], ...]
    grows: tuple[str, ...]
    inverse: bool = False  # amplitude is 1 / value
    signed: bool = False


def probes(
    h: Hypothesis, network: Network, motion: Motion | None, force: float, current: float, spread: float
) -> list[Probe]:
    """Places in the parameter space of a hypothesis to try, sized by the motion and force [N] of the data."""

    def one(values: dict[str, float], *grows: str, **more: Any) -> Probe:
        return Probe(values, (values,), grows, **more)

    kind = h.effect
    if kind == "sensor_gain":
        return [one({"gain": 1.05}, signed=True)]
    if kind == "sensor_bias":
        return [one({"bias": 0.1 * spread}, "bias", signed=True)]
    if kind in ("sensor_delay", "actuator_delay"):
        return [one({"delay": t}, "delay") for t in (0.002, 0.01)]
    if kind == "actuator_lag":
        return [one({"time_constant": t}, "time_constant") for t in (0.002, 0.01)]
    if kind == "thrust_saturation":
        return [one({"current": s * current}) for s in (0.7, 1.2, 2.0, 4.0)]
    assert motion is not None
    d, v, a = motion.d, motion.v, motion.a
    rms = lambda x: max(float(np.sqrt(np.mean(np.square(x)))), 1e-12)  # noqa: E731
    reach = max(float(np.abs(d).max()), 1e-9)
    e = PROBE * force
    if kind == "coulomb_friction":
        return [one({"level": e}, "level")]
    if kind == "stribeck_friction":
        out = []
        level = next((x.level for x in standing(network, h.where) if isinstance(x, el.CoulombFriction)), 0.0)
        for q in (0.3, 1.0):
            vs = q * rms(v)
            out.append(
                one(
                    {"level": level + e * 0.3, "static_level": level + 1.3 * e, "stribeck_velocity": vs},
                    signed=bool(level),
                )
            )
        return out
    if kind == "linear_damping":
        return [one({"damping": e / rms(v)}, "damping")]
    if kind == "linear_stiffness":
        return [one({"stiffness": e / rms(d)}, "stiffness")]
    if kind == "inertance":
        return [one({"inertance": e / rms(a)}, "inertance")]
    if kind == "quadratic_damping":
        return [one({"damping": e / rms(v * v)}, "damping")]
    if kind == "asymmetric_damping":
        c = e / rms(v)
        return [
            Probe(
                {"extension": c, "compression": c},
                ({"extension": c, "compression": 0.0}, {"extension": 0.0, "compression": c}),
                ("extension", "compression"),
                signed=True,
            )
        ]
    if kind == "cubic_stiffness":
        return [one({"stiffness": e / rms(d**3)}, "stiffness", signed=True)]
    if kind == "gas_spring":
        return [
            one({"force": e * s * reach / (1.3 * rms(d)), "length": s * reach}, "force")
            for s in (1.5, 4.0, 12.0)
        ]
    if kind == "hysteresis":
        return [
            one({"level": e, "stiffness": e / (s * rms(d))}, "level", "stiffness") for s in (0.03, 0.15, 0.6)
        ]
    if kind == "bump_stop":
        side = dict(h.options)["side"]
        x = np.abs(d) if side == "both" else np.maximum(d if side == "extension" else -d, 0.0)
        out = []
        for q in (0.5, 0.75, 0.9, 0.97, 0.995):
            gap = float(np.quantile(x, q)) if side == "both" else float(np.quantile(x, 0.5 + 0.5 * q))
            over = np.maximum(x - gap, 0.0)
            if gap > 0 and over.max() > 1e-3 * reach:
                out.append(one({"clearance": gap, "stiffness": e / rms(over)}, "stiffness"))
        return out
    if kind == "backlash":
        return [one({"gap": s * rms(d)}, "gap") for s in (0.02, 0.2)]
    if kind == "series_compliance":
        return [one({"stiffness": force / (0.02 * rms(d))}, "stiffness", inverse=True)]
    if kind == "terminal_inertia":
        return [one({"mass": e / rms(a)}, "mass")]
    if kind == "tyre_lift_off":
        stiffness = next(x for x in standing(network, h.where) if x.type == "linear_stiffness").linear()[0]
        loads = [float(np.quantile(stiffness * d, q)) for q in (0.8, 0.93, 0.985)]
        return [one({"stiffness": stiffness, "load": w}) for w in loads if w > 0]
    if kind == "cogging_force":
        span = float(np.ptp(d))
        longest, shortest = min(2 * span, 0.05), max(1e-3, span / 60)
        # neighbouring pitches shift by a quarter period over the span
        cycles = np.arange(1 / longest, 1 / shortest, 0.25 / span)
        out = []
        for f in cycles:
            p = float(1 / f)
            out.append(
                Probe(
                    {"amplitude": e, "pitch": p, "phase": 0.0},
                    (
                        {"amplitude": e, "pitch": p, "phase": 0.0},
                        {"amplitude": e, "pitch": p, "phase": math.pi / 2},
                    ),
                    ("amplitude",),
                    signed=True,
                )
            )
        return out
    return generic(h, force, rms(d), rms(v))


def generic(h: Hypothesis, force: float, d: float, v: float) -> list[Probe]:
    """An effect added by a user: the geometric middle of its plausible ranges."""
    values = {}
    for f in el.parameter_fields(el.TYPES[h.effect]):
        low, high = f.metadata["range"]
        values[f.name] = math.sqrt(low * high) if low > 0 else 0.5 * (low + high)
    return [Probe(values, (values,), ())]
