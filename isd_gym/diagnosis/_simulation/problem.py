"""Records and a model: measured outputs, and simulations of a network over the same inputs.

`Problem` holds the records in the units of the model's channels and simulates many variants of one network structure
in a single call of the kernel (one lane each).
"""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass, field, replace
from functools import cached_property
from threading import Lock
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from scipy.signal import firwin, oaconvolve

from ..._common.errors import InputError
from ..._common.units import HELD, convert
from ...physics.network import Network, assemble
from ...physics.simulate import COARSE, FINE, Plant, effective_current, pace
from .interpolation import interpolated, splined_input
from .node_motion import transfer_matrix
from .time_limit import check_time

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence

    from numpy.typing import NDArray

    from ..._common.arrays import Array
    from ...records.loggers.recording import Recording


#: use of a record: training (fit), validation (choose) or test (report)
Role = Literal["fit", "choose", "report"]


@dataclass(frozen=True)
class Record:
    """One measured record, uniformly sampled, with inputs in SI units (n,) and outputs in the channels' units (n, channels)."""

    name: str
    step: float  # [s]
    inputs: Mapping[str, Array]
    measured: Array
    slopes: Mapping[str, tuple[Array, Array]] = field(default_factory=dict)
    start: float = 0.0  # [s] time of the first sample
    taps: Array | None = (
        None  # low-pass filter of simulated and measured outputs, where derivatives need a filter
    )
    thin: int = 1  # every `thin`-th sample of the filtered outputs is compared
    margin: int = 0  # compared samples left out at either end, where the filter extrapolates; inputs cover these samples
    lead: int = 0  # compared samples of inputs before the first compared sample: laws with memory forget their start
    #: RMS white noise of moved nodes' displacements before the low-pass [SI]; without an entry it is estimated
    input_noise: Mapping[str, float] = field(default_factory=dict)
    size: int = 0  # number of simulated samples without inputs, of an unread record
    source: Recording | None = None  # recording of a resampled record

    def __len__(self) -> int:
        """Number of compared samples of the outputs."""
        return len(self.measured)

    @property
    def samples(self) -> int:
        """Number of samples of the inputs."""
        if self.inputs:
            return len(next(iter(self.inputs.values())))
        return self.size or (self.before + len(self) - 1 + self.margin) * self.thin + 1

    @property
    def interval(self) -> float:
        """Interval of the compared samples [s]."""
        return self.step * self.thin

    @property
    def time(self) -> Array:
        return np.asarray(
            self.start + self.interval * (self.before + np.arange(len(self))),
            dtype=np.float64,
        )

    @property
    def before(self) -> int:
        """Number of compared intervals of inputs before the first compared sample."""
        return self.lead + self.margin

    @cached_property
    def pace(self) -> float:
        """Time scale of the motion [s]: the inverse of the circular frequency that halves the power of the outputs."""
        return min(
            pace(self.measured[:, j], self.interval)
            for j in range(self.measured.shape[1])
        )

    @property
    def filtered(self) -> bool:
        """Whether the compared outputs are low-pass filtered."""
        return self.taps is not None

    def unread(self) -> Record:
        """Return the record without filter: a simulation is compared at every sample of the inputs."""
        return replace(self, taps=None, thin=1, lead=0, size=self.samples)

    def seen(self, values: Array) -> Array:
        """Return the values (samples, ...) at the compared samples."""
        return values[self.before * self.thin :: self.thin][: len(self)]

    def read(self, values: Array) -> Array:
        """Return the compared samples of simulated outputs, filtered like the measurement."""
        if self.taps is None and self.thin == 1 and not self.lead:
            return values
        return self.seen(values if self.taps is None else low_pass(values, self.taps))

    def part(self, first: int, stop: int, name: str, lead: int = 0) -> Record:
        """Return compared samples first to stop - 1 as a record; at most `lead` samples before the first lead in."""
        back = min(max(lead, self.lead), self.lead + first)
        back -= (
            back % WHOLE
        )  # a record can be thinned by each factor up to `MAX_THINNING`
        begin = self.lead + first - back
        cut = slice(
            begin * self.thin, (self.lead + stop - 1 + 2 * self.margin) * self.thin + 1
        )
        return replace(
            self,
            name=name,
            inputs={k: v[cut] for k, v in self.inputs.items()},
            measured=self.measured[first:stop],
            slopes={k: (v[cut], a[cut]) for k, (v, a) in self.slopes.items()},
            start=self.start + begin * self.interval,
            lead=back,
        )


def thinned(record: Record, by: int, held: Collection[str]) -> Record:
    """Return a record with every `by`-th sample; inputs are low-pass filtered, or averaged where they are held."""
    if record.taps is not None:  # the inputs are filtered already
        taps = record.taps[(len(record.taps) // 2) % by :: by]
        return replace(
            record,
            step=record.step * by,
            thin=record.thin // by,
            taps=taps / taps.sum(),
            inputs={k: v[::by] for k, v in record.inputs.items()},
            slopes={k: (v[::by], a[::by]) for k, (v, a) in record.slopes.items()},
        )
    taps, n = firwin(8 * by + 1, 0.9 / by, window=("kaiser", 5.0)), record.samples
    edges = np.arange(0, n, by)
    inputs = {
        k: np.add.reduceat(v, edges) / np.diff(np.append(edges, n))
        if k in held
        else low_pass(v, taps, by)
        for k, v in record.inputs.items()
    }
    lead = record.lead // by
    return replace(
        record,
        step=record.step * by,
        inputs=inputs,
        lead=lead,
        measured=record.measured[::by],
    )


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


def _unit_columns(outputs: Array, chosen: NDArray[np.bool_]) -> Array:
    """Return a column of ones for each chosen channel (samples, channels, columns)."""
    return np.broadcast_to(
        np.eye(len(chosen))[:, chosen], (len(outputs), len(chosen), chosen.sum())
    )


def deviation_within(series: Sequence[Array], groups: Sequence[object]) -> Array:
    """Return the deviation (channels,) of series (samples, channels) about the means of their groups, at least 1e-300."""
    parts: dict[object, list[Array]] = {}
    for y, group in zip(series, groups, strict=True):
        parts.setdefault(group, []).append(y)
    joined = [np.concatenate(own) for own in parts.values()]
    square = sum(len(y) * np.var(y, axis=0) for y in joined) / sum(map(len, joined))
    return np.maximum(np.sqrt(np.asarray(square, dtype=np.float64)), 1e-300)


#: exceptions of a simulation or a fit that breaks down
BROKEN = (InputError, np.linalg.LinAlgError)

#: largest number of physics steps per sample
FINEST = 60
#: largest factor by which a record is thinned, and smallest number of samples of a thinned record
MAX_THINNING, MIN_SAMPLES = 4, 500
WHOLE = math.lcm(*range(1, MAX_THINNING + 1))
#: least number of samples that give an initial state
LEAST_HEAD = 20
#: smallest length of a record beside a longer one in one call, as a share
SIMILAR = 0.8
#: largest number of samples of all lanes in one call
LARGEST = 2_000_000


class Problem:
    """A nominal model and measured records, all for training unless `roles` say otherwise. `step`: largest physics step, relative to the
    time scale `time` [s] of the motion."""

    def __init__(
        self,
        network: Network,
        records: Sequence[Record],
        roles: Sequence[Role] | None = None,
        step: float = FINE,
        time: float | None = None,
    ):
        self.network = network
        self.records = list(records)
        self.roles: list[Role] = (
            list(roles) if roles is not None else ["fit"] * len(self.records)
        )
        self.step = step
        self.channels = [c.name for c in network.outputs]
        self.factors = np.array([convert(1.0, c.si, c.unit) for c in network.outputs])
        #: whether all records of a channel share an unknown offset (channels,)
        self.shared_offset = np.array(
            [c.offset == "free" for c in network.outputs], bool
        )
        #: whether each record of a channel has an unknown offset of its own (channels,)
        self.record_offset = np.array(
            [c.offset == "record" for c in network.outputs], bool
        )
        self._time = time
        self._spans: dict[int, float] = {}
        self.memory = SimulationCache()

    def _of(self, *roles: Role) -> list[int]:
        return [i for i, r in enumerate(self.roles) if r in roles]

    @property
    def estimation(self) -> list[int]:
        return self._of("fit")

    @property
    def held(self) -> list[int]:
        """Validation and test records."""
        return self._of("choose", "report")

    @property
    def choosing(self) -> list[int]:
        return self._of("choose")

    @property
    def reporting(self) -> list[int]:
        """Test records; the validation records if there are too few records for both roles."""
        return self._of("report") or self.choosing

    @cached_property
    def time(self) -> float:
        """Time scale of the rig [s]."""
        return self._time or float(np.median([r.pace for r in self.records]))

    def scale(self, record: Record) -> float:
        """Return the time scale of a record's motion [s], at most that of the rig."""
        return min(self.time, record.pace)

    def every(self, record: Record) -> int:
        """Return the number of physics steps per sample of the inputs."""
        return min(
            max(1, math.ceil(record.step / (self.step * self.scale(record)) - 1e-9)),
            FINEST,
        )

    def _sparse(self, record: Record) -> bool:
        """Return whether samples are so sparse that linear interpolation reduces the amplitude."""
        return self.every(record) > 1 and record.step > COARSE * self.scale(record)

    def span(self, index: int) -> float:
        """Return the prior standard deviation of a record's initial motion [m], from the range of the record."""
        if index not in self._spans:
            record, spans = self.records[index], [0.0]
            lengths = {
                "displacement": 1.0,
                "velocity": self.time,
                "acceleration": self.time**2,
            }
            for c in self.network.moving:
                spans.append(float(np.ptp(record.inputs[c.name])) * lengths[c.quantity])
            for j, c in enumerate(self.network.outputs):
                if c.quantity in lengths:
                    reach = float(np.ptp(record.measured[:, j])) / self.factors[j]
                    spans.append(reach * lengths[c.quantity])
            self._spans[index] = 2.0 * (max(spans) or 0.01)
        return self._spans[index]

    def measured(self, records: Sequence[int] | None = None) -> Array:
        """Return the measured outputs of records (samples, channels), one after the other; of the training records by default."""
        return np.concatenate(
            [
                self.records[i].measured
                for i in (self.estimation if records is None else records)
            ]
        )

    def with_records(
        self, records: Sequence[Record], roles: Sequence[Role] | None = None
    ) -> Problem:
        """Return the problem with other records; the roles stay unless given."""
        return Problem(self.network, records, roles or self.roles, self.step, self.time)

    @cached_property
    def heads(self) -> Problem:
        """The problem with the first samples of each record, which give its initial state."""
        parts = []
        for r in self.records:
            count = max(LEAST_HEAD, math.ceil(self.time / r.interval))
            parts.append(r.part(0, min(count, len(r)), r.name))
        return self.with_records(parts)

    @cached_property
    def rough(self) -> Problem:
        """The problem with the fewest samples that resolve the motion; the problem itself if no sample can be left out."""
        by = [self._spare(r) for r in self.records]
        if max(by, default=1) < 2:
            return self
        held = {c.name for c in self.network.inputs if c.quantity in HELD}
        records = [
            thinned(r, k, held) if k > 1 else r
            for r, k in zip(self.records, by, strict=True)
        ]
        return Problem(self.network, records, self.roles, 1.01 * COARSE, self.time)

    def _spare(self, record: Record) -> int:
        """Return the factor by which a record may be thinned."""
        most = int(
            min(
                COARSE * self.scale(record) / record.step,
                record.samples / MIN_SAMPLES,
                MAX_THINNING,
            )
        )
        if record.source is not None:
            return 1
        if record.taps is None:
            return max(most, 1)
        return max((k for k in range(1, most + 1) if record.thin % k == 0), default=1)

    def watching(self, network: Network) -> Problem:
        """Return the problem with the outputs of another network, at every sample of the inputs."""
        out = Problem(network, self._unread, self.roles, self.step, self.time)
        out.memory = self.memory  # inputs between samples
        return out

    @cached_property
    def _unread(self) -> list[Record]:
        return [r.unread() for r in self.records]

    def deviation(self, records: Sequence[int] | None = None) -> Array:
        """Return the deviation (channels,) within measured records, of which segments with one name are one, by default those to fit by;
        at least 1e-300."""
        pick = [
            self.records[i] for i in (self.estimation if records is None else records)
        ]
        return deviation_within([r.measured for r in pick], [r.name for r in pick])

    def common(self, outputs: Array) -> Array:
        """Return the derivatives of outputs (samples, channels) by the shared offsets (samples, channels, offsets)."""
        return _unit_columns(outputs, self.shared_offset)

    def nuisances(self, outputs: Array) -> Array:
        """Return the derivatives of outputs (samples, channels) by the offsets of a record (samples, channels, offsets)."""
        return _unit_columns(outputs, self.record_offset)

    def simulate(
        self,
        networks: Sequence[Network],
        index: int,
        initial: Array | None = None,
        *,
        like: Network | None = None,
    ) -> Array:
        """Return outputs (n, channels, lanes) of networks of one structure over a record, from an initial state (states, lanes) in the
        coordinates of `like`, by default the first network; else from rest."""
        begun = None if initial is None else {index: initial}
        return self.simulate_all(networks, [index], begun, like=like)[index]

    def simulate_all(
        self,
        networks: Sequence[Network],
        records: Sequence[int],
        initial: Mapping[int, Array] | None = None,
        *,
        like: Network | None = None,
    ) -> dict[int, Array]:
        """The same over several records, those of similar length side by side in one call of the kernel."""
        # a rate by differences would see what comes after the last sample
        is_exact = any(assemble(networks[0].mechanical).outputs_by_difference)
        groups: dict[tuple[Any, ...], list[int]] = {}
        for i in sorted(records, key=lambda i: -self.records[i].samples):
            r = self.records[i]
            key = (r.step, self.every(r), *r.slopes)
            longest = self.records[groups.get(key, [i])[0]].samples
            if r.samples < (longest if is_exact else SIMILAR * longest):
                groups[*key, longest] = groups.pop(key)
            groups.setdefault(key, []).append(i)
        out: dict[int, Array] = {}
        for members in groups.values():
            samples = self.records[members[0]].samples
            size = max(1, LARGEST // (samples * len(networks)))
            for k in range(0, len(members), size):
                out |= self._side_by_side(
                    networks, members[k : k + size], initial, like
                )
        return {i: out[i] for i in records}

    def _side_by_side(
        self,
        networks: Sequence[Network],
        members: Sequence[int],
        initial: Mapping[int, Array] | None,
        like: Network | None,
    ) -> dict[int, Array]:
        """Every network over every record of `members`, the longest first: one lane each, record by record."""
        check_time()
        records = [self.records[i] for i in members]
        record, wide = records[0], len(networks)
        every = self.every(record)
        lanes = [n.mechanical for n in networks] * len(records)
        plant = Plant(lanes, record.step / every)
        inputs, slopes = self._inputs_of_lanes(plant, networks, records)
        start = None
        if plant.n:
            given = None
            if initial is not None:
                given = np.concatenate([initial[i] for i in members], axis=1)
            start = self._start(plant, given, like)
        out = plant.run(
            inputs,
            every=every,
            samples=record.samples,
            initial=start,
            derivatives=slopes,
        )
        with np.errstate(all="ignore"):  # the caller detects a diverged simulation
            out = out * self.factors[:, None]
            self._distort(out, networks, record.step)
        read = {}
        for k, (i, r) in enumerate(zip(members, records, strict=True)):
            own = out[: r.samples, :, k * wide : (k + 1) * wide]
            read[i] = r.read(own)
        return read

    def _inputs_of_lanes(
        self, plant: Plant, networks: Sequence[Network], records: Sequence[Record]
    ) -> tuple[dict[str, Array], dict[str, tuple[Array, Array]]]:
        """Return the inputs at the physics steps, and the derivatives of those that the plant differentiates, a column a lane."""
        record, first = records[0], networks[0]
        every, sparse = self.every(record), self._sparse(record)
        motored = any(e.place == "element" for e in first.elements)
        total = every * (record.samples - 1) + 1

        def lanes(columns: Sequence[Array]) -> Array:
            """A column a record, for all of its lanes; shorter records go on with their last value."""
            if len(columns) == 1 and not motored:
                return columns[0]
            full = np.empty((total, len(columns)))
            for k, x in enumerate(columns):
                full[: len(x), k] = x
                full[len(x) :, k] = x[-1]
            return np.repeat(full, len(networks), axis=1)

        curves = {}
        slopes = {}
        for name in plant.differentiated:
            curves[name] = [self._bent(r, name, every, sparse) for r in records]
            _, first_derivative, second_derivative = zip(*curves[name], strict=True)
            slopes[name] = (lanes(first_derivative), lanes(second_derivative))
        inputs = {}
        for c in first.inputs:
            if c.name in curves:
                fine = [curve[0] for curve in curves[c.name]]
            else:
                fine = [
                    self._fine(r, c.name, every, c.quantity in HELD, sparse)
                    for r in records
                ]
            if motored and c.quantity == "current":
                step = record.step / every
                driven = lanes(fine)
                for lane in range(driven.shape[1]):
                    n = networks[lane % len(networks)]
                    one = driven[:, lane : lane + 1]
                    driven[:, lane : lane + 1] = effective_current(
                        n, c.elements[0], one, step
                    )
                inputs[c.name] = driven
            else:
                inputs[c.name] = lanes(fine)
        return inputs, slopes

    def _distort(self, out: Array, networks: Sequence[Network], step: float) -> None:
        """Apply the elements at channels (sensor effects) to the outputs of each lane, in place."""
        if not any(e.place == "channel" for e in networks[0].elements):
            return
        for lane in range(out.shape[2]):
            for e in networks[lane % len(networks)].elements:
                if e.place == "channel":
                    j = self.channels.index(e.where[0])
                    out[:, j, lane] = e.apply(out[:, j, lane], step)

    def _bent(
        self, record: Record, name: str, every: int, sparse: bool
    ) -> tuple[Array, ...]:
        """Return an input that is differentiated at the physics steps, with its derivatives."""
        given, slopes = record.inputs[name], record.slopes.get(name)
        return self.memory.made(
            ("bent", id(given), id(slopes), record.step, every, sparse),
            (given, slopes),
            lambda: splined_input(given, slopes, record.step, every, sparse=sparse),
        )

    def _fine(
        self, record: Record, name: str, every: int, held: bool, sparse: bool
    ) -> Array:
        """Return an input at the physics steps."""
        given = record.inputs[name]
        key = ("fine", id(given), record.step, every, held, sparse)
        return self.memory.made(
            key,
            given,
            lambda: (
                interpolated(given, every, record.step, held=held, sparse=sparse),
            ),
        )[0]

    def _start(
        self, plant: Plant, initial: Array | None, like: Network | None
    ) -> Array:
        lanes = len(plant.networks)
        if initial is None:
            return np.zeros((plant.n, lanes))
        source = plant.assemblies[0] if like is None else assemble(like.mechanical)
        # most lanes differ in parameters that the motion of the nodes does not depend on
        keys = [
            asm.position.tobytes() + asm.velocity.tobytes() for asm in plant.assemblies
        ]
        distinct = dict(zip(keys, plant.assemblies, strict=True))
        maps = {
            key: transfer_matrix(source, asm, self.time)
            for key, asm in distinct.items()
        }
        return np.stack(
            [maps[key] @ initial[:, k] for k, key in enumerate(keys)], axis=1
        )


def simulate_from_rest(network: Network, record: Record) -> Array | None:
    """Return the outputs (samples, channels) of a model at rest where the inputs of a record begin; None where the simulation breaks down."""
    inputs = {}
    for c in network.inputs:
        u = record.inputs[c.name]
        inputs[c.name] = u - u[0] * (c.quantity in ("displacement", "angle"))
    problem = Problem(network, [replace(record, inputs=inputs)])
    try:
        out = problem.simulate([network], 0)[:, :, 0]
    except BROKEN:
        return None
    return out if np.isfinite(out).all() else None


class SimulationCache:
    """What was simulated last, to be had again without simulating: no more than `limit` bytes of it."""

    def __init__(self, limit: int = 200_000_000):
        self.limit, self.size = limit, 0
        self._kept: OrderedDict[
            tuple[object, ...], tuple[object, tuple[Array, ...]]
        ] = OrderedDict()
        self._lock = Lock()

    def get(self, key: tuple[object, ...]) -> tuple[Array, ...] | None:
        with self._lock:
            found = self._kept.get(key)
            if found is not None:
                self._kept.move_to_end(key)
            return found[1] if found else None

    def made(
        self, key: tuple[object, ...], of: object, make: Callable[[], tuple[Array, ...]]
    ) -> tuple[Array, ...]:
        """Return the values of a key, made and stored if they are not there."""
        known = self.get(key)
        if known is None:
            known = make()
            self.put(key, of, known)
        return known

    def put(
        self, key: tuple[object, ...], of: object, values: tuple[Array, ...]
    ) -> None:
        """Store values. `of` is the object whose identity is part of the key; the cache keeps `of` alive."""
        with self._lock:
            if key not in self._kept:
                self._kept[key] = of, values
                self.size += sum(v.nbytes for v in values)
            while self.size > self.limit and len(self._kept) > 1:
                _, (_, gone) = self._kept.popitem(last=False)
                self.size -= sum(v.nbytes for v in gone)
