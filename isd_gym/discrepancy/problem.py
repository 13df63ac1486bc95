"""Records against a model: what was measured, and what a network says about it.

`Problem` holds the records in the units of the model's channels and simulates many variants of one network structure
in a single call of the kernel (one lane each).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import oaconvolve, welch

from ..network import Assembly, Network, assemble
from ..simulate import Plant, effective_current, upsample
from ..units import convert

Array = NDArray[np.float64]
#: what a record is for: to fit by, to choose among candidates by, to report by
Role = Literal["fit", "choose", "report"]


@dataclass(frozen=True)
class Record:
    """One measured record, uniformly sampled.

    `inputs` in SI units (n,); `measured` (n, channels) in the channels' units; `slopes`: (velocity, acceleration) of moved nodes.
    """

    name: str
    step: float  # [s]
    inputs: Mapping[str, Array]
    measured: Array
    slopes: Mapping[str, tuple[Array, Array]] = field(default_factory=dict)
    start: float = 0.0  # [s] time of the first sample
    taps: Array | None = None  # low-pass that model and data both pass, where derivatives need one
    thin: int = 1  # of the filtered outputs every `thin`-th sample is compared
    margin: int = (
        0  # compared samples left out at either end, where the low-pass had to guess; inputs reach over them
    )

    def __len__(self) -> int:
        """Samples of the outputs that are compared."""
        return len(self.measured)

    @property
    def samples(self) -> int:
        """Samples of the inputs."""
        return len(next(iter(self.inputs.values()))) if self.inputs else len(self.measured)

    @property
    def rate(self) -> float:
        """Interval of the outputs that are compared [s]."""
        return self.step * self.thin

    @property
    def time(self) -> Array:
        return np.asarray(self.start + self.rate * (self.margin + np.arange(len(self))), dtype=np.float64)

    @cached_property
    def pace(self) -> float:
        """The time [s] in which the motion changes: one over the circular frequency that halves the outputs' power."""
        return min(pace(self.measured[:, j], self.rate) for j in range(self.measured.shape[1]))

    def seen(self, values: Array) -> Array:
        """Those of `values` (samples, ...) at the inputs' samples that are compared."""
        return values[self.margin * self.thin :: self.thin][: len(self)]

    def follows(self, other: Record) -> bool:
        """Whether this record is the stretch right after `other`."""
        end = other.start + len(other) * other.rate
        return self.name == other.name and abs(self.start - end) < 0.5 * self.rate

    def part(self, first: int, stop: int, name: str) -> Record:
        """Compared samples first..stop-1 as a record of their own."""
        cut = slice(first * self.thin, (stop - 1 + 2 * self.margin) * self.thin + 1)
        return replace(
            self,
            name=name,
            inputs={k: v[cut] for k, v in self.inputs.items()},
            measured=self.measured[first:stop],
            slopes={k: (v[cut], a[cut]) for k, (v, a) in self.slopes.items()},
            start=self.start + first * self.rate,
        )


def pace(values: Array, step: float) -> float:
    """One over the circular frequency [s] below which half of the power of `values` (n,) lies."""
    f, s = welch(values - values.mean(), 1.0 / step, nperseg=min(len(values), 4096))
    total = np.cumsum(s)
    middle = float(np.interp(0.5 * total[-1], total, f)) if total[-1] > 0 else 0.0
    return 1.0 / (2 * math.pi * max(middle, f[1]))


def low_pass(values: Array, taps: Array, thin: int = 1) -> Array:
    """Zero-phase low-pass along the first axis, ends continued point-symmetrically, every `thin`-th sample kept."""
    half = len(taps) // 2
    half_in = min(half, len(values) - 1)
    head = 2 * values[:1] - values[half_in:0:-1]
    tail = 2 * values[-1:] - values[-2 : -half_in - 2 : -1]
    padded = np.concatenate([head, values, tail])
    shape = (-1,) + (1,) * (values.ndim - 1)
    return oaconvolve(padded, taps.reshape(shape), mode="same", axes=0)[
        half_in : half_in + len(values) : thin
    ]


def bare(network: Network) -> Network:
    """The network without its motor and sensor effects, which act outside the kernel."""
    kept = tuple(e for e in network.elements if e.place == "between")
    return network if len(kept) == len(network.elements) else replace(network, elements=kept)


FINEST = 20  # physics steps a sample at most


def _through(values: Array, every: int) -> Array:
    """A record at `every` times its rate, by a cubic spline through its samples."""
    n = len(values)
    return np.asarray(
        CubicSpline(np.arange(n), values)(np.arange(every * (n - 1) + 1) / every), dtype=np.float64
    )


class Problem:
    """A base model and records to judge it by.

    network: the owner's model. records: with the `roles` that they have, those to fit by first. step [s]: the largest of
    the physics.
    """

    def __init__(
        self, network: Network, records: Sequence[Record], roles: Sequence[Role], step: float = 2e-3
    ):
        self.network = network
        self.records = list(records)
        self.roles = list(roles)
        self.step = step
        self.channels = [c.name for c in network.outputs]
        self.factors = np.array([convert(1.0, c.si, c.unit) for c in network.outputs])
        self.free_offset = np.array([c.offset for c in network.outputs])

    def _of(self, *roles: Role) -> list[int]:
        return [i for i, r in enumerate(self.roles) if r in roles]

    @property
    def estimation(self) -> list[int]:
        return self._of("fit")

    @property
    def held(self) -> list[int]:
        """Records that take no part in fitting."""
        return self._of("choose", "report")

    @property
    def choosing(self) -> list[int]:
        return self._of("choose")

    @property
    def reporting(self) -> list[int]:
        """Records that take no part in choosing either; the choosing ones where there are not enough for both."""
        return self._of("report") or self.choosing

    @cached_property
    def time(self) -> float:
        """The rig's own time scale [s]."""
        return float(np.median([r.pace for r in self.records]))

    def measured(self, records: Sequence[int] | None = None) -> Array:
        """Outputs (samples, channels) of the records (those to fit by), one after the other."""
        return np.concatenate(
            [self.records[i].measured for i in (self.estimation if records is None else records)]
        )

    def with_records(self, records: Sequence[Record]) -> Problem:
        """The same with other records in the same roles."""
        return Problem(self.network, records, self.roles, self.step)

    def constants(self, index: int) -> Array:
        """What a free offset does to record `index`: (samples, channels, free offsets), one where the channel is its own."""
        free = np.flatnonzero(self.free_offset)
        out = np.zeros((len(self.records[index]), len(self.channels), len(free)))
        out[:, free, np.arange(len(free))] = 1.0
        return out

    def simulate(
        self,
        networks: Sequence[Network],
        index: int,
        initial: Array | None = None,
        *,
        like: Network | None = None,
        substeps: int | None = None,
    ) -> Array:
        """Outputs (n, channels, lanes) in the channels' units of networks of one structure over record `index`.

        `initial` (states, lanes): initial state in the coordinates of the assembly of `like`, mapped to each lane's own
        coordinates by the motion of the nodes. Without it everything starts at rest at the first sample.
        """
        record = self.records[index]
        # a third of the time in which the motion changes (the linear part is exact), and not more than the problem's own
        every = substeps or min(
            max(1, math.ceil(record.step / min(self.step, 0.3 * self.time) - 1e-9)), FINEST
        )
        sparse = every > 1 and record.step > 0.3 * self.time
        first = networks[0]
        motored = any(e.place == "element" for e in first.elements)
        pure = {id(n): bare(n) for n in networks}  # lanes that differ in their initial state share a network
        plant = Plant([pure[id(n)] for n in networks], record.step / every)
        h = record.step / every
        inputs: dict[str, Array] = {}
        for c in first.inputs:
            fine = upsample(record.inputs[c.name], every, hold=c.quantity == "current")
            if (
                sparse and c.quantity != "current"
            ):  # lines between so few samples would lack a part of the amplitude
                fine = _through(record.inputs[c.name], every)
            if motored and c.quantity == "current":
                columns = []
                for n in networks:
                    columns.append(effective_current(n, c.elements[0], fine[:, None], h)[:, 0])
                fine = np.stack(columns, axis=1)
            inputs[c.name] = fine
        if motored:
            width = len(networks)
            inputs = {
                k: v if v.ndim == 2 else np.repeat(v[:, None], width, axis=1) for k, v in inputs.items()
            }
        slopes = {}
        for name in plant.differentiated:
            pair = record.slopes.get(name)
            if pair is not None:
                slopes[name] = (upsample(pair[0], every), upsample(pair[1], every))
        start = None
        if plant.n:
            start = self._start(plant, initial, like, record)
        out = plant.run(inputs, every=every, samples=record.samples, initial=start, derivatives=slopes)
        out = out * self.factors[:, None]
        if any(e.place == "channel" for e in first.elements):
            for lane, n in enumerate(networks):
                for e in n.elements:
                    if e.place == "channel":
                        j = self.channels.index(e.where[0])
                        out[:, j, lane] = e.apply(out[:, j, lane], record.step)
        if record.taps is not None:
            out = record.seen(low_pass(out, record.taps))
        return out

    def _start(self, plant: Plant, initial: Array | None, like: Network | None, record: Record) -> Array:
        lanes = len(plant.networks)
        if initial is None or like is None:
            return np.zeros((plant.n, lanes))
        source = assemble(bare(like))
        # most lanes differ in parameters that the motion of the nodes does not depend on
        known: dict[bytes, Array] = {}
        maps = {}
        for asm in plant.assemblies:
            if id(asm) not in maps:
                key = asm.position.tobytes() + asm.velocity.tobytes()
                if key not in known:
                    known[key] = carrier(source, asm, self.time)
                maps[id(asm)] = known[key]
        return np.stack([maps[id(asm)] @ initial[:, k] for k, asm in enumerate(plant.assemblies)], axis=1)


def led(network: Network, record: Record) -> tuple[Array, Array]:
    """Displacement and velocity (samples, moved nodes) of the moved nodes; where they are not told, zero: the frame's own."""
    still = np.zeros(record.samples)
    r, v = [], []
    for c in network.moving:
        u = record.inputs[c.name]
        told = c.quantity == "displacement"
        r.append(u if told else still)
        v.append(np.gradient(u, record.step) if told else u if c.quantity == "velocity" else still)
    shape = (record.samples, len(r))
    return np.stack(r, axis=1) if r else np.zeros(shape), np.stack(v, axis=1) if v else np.zeros(shape)


def motion_rows_of(asm: Assembly, time: float, nodes: Sequence[str] | None = None) -> Array:
    """Displacement, and velocity times `time` [s], of nodes as rows over the states: what an initial state means physically."""
    x = asm.columns("x")
    every = [n for n in asm.network.nodes if n not in asm.network.moved_nodes]
    pick = [every.index(n) for n in (every if nodes is None else nodes)]
    return np.vstack([asm.position[pick, x], time * asm.velocity[pick, x]])


def carrier(source: Assembly, target: Assembly, time: float) -> Array:
    """Matrix from initial states of one network to those of another: the nodes that both have move alike."""
    moved = source.network.moved_nodes
    both = [n for n in source.network.nodes if n in target.network.nodes and n not in moved]
    if not both or not target.size[0]:
        return np.zeros((target.size[0], source.size[0]))
    own, other = motion_rows_of(target, time, both), motion_rows_of(source, time, both)
    return np.asarray(np.linalg.lstsq(own, other, rcond=None)[0], dtype=np.float64)
