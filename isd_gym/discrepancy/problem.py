"""Records against a model: what was measured, what a network says about it, and how residuals are weighed.

`Problem` holds the records in the units of the model's channels and simulates many variants of one network structure
in a single call of the kernel (one lane each). `Whitener` turns coloured residuals into nearly white ones.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numba as nb
import numpy as np
from numpy.typing import NDArray
from scipy.signal import oaconvolve, welch

from ..network import Assembly, Network, assemble
from ..simulate import Plant, effective_current, upsample
from ..units import UNITS, convert

Array = NDArray[np.float64]


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


class Problem:
    """A base model and records to judge it by.

    network: the owner's model. records: estimation first, then held-out ones; `held[i]` says which is which.
    """

    def __init__(self, network: Network, records: Sequence[Record], held: Sequence[bool], step: float = 2e-3):
        self.network = network
        self.records = list(records)
        self.held = list(held)
        self.step = step
        self.channels = [c.name for c in network.outputs]
        self.factors = np.array([convert(1.0, UNITS[c.quantity], c.unit) for c in network.outputs])
        self.free_offset = np.array([c.offset for c in network.outputs])

    @property
    def estimation(self) -> list[int]:
        return [i for i, h in enumerate(self.held) if not h]

    @property
    def validation(self) -> list[int]:
        return [i for i, h in enumerate(self.held) if h]

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
        every = substeps or max(1, math.ceil(record.step / self.step - 1e-9))
        first = networks[0]
        motored = any(e.place == "element" for e in first.elements)
        pure = {id(n): bare(n) for n in networks}  # lanes that differ in their initial state share a network
        plant = Plant([pure[id(n)] for n in networks], record.step / every)
        h = record.step / every
        inputs: dict[str, Array] = {}
        for c in first.inputs:
            fine = upsample(record.inputs[c.name], every, hold=c.quantity == "current")
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
        for part, name in plant.labels:
            if part in ("v", "alpha"):
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
                    known[key] = carrier(source, asm)
                maps[id(asm)] = known[key]
        return np.stack([maps[id(asm)] @ initial[:, k] for k, asm in enumerate(plant.assemblies)], axis=1)


def motion_rows_of(asm: Assembly, nodes: Sequence[str] | None = None) -> Array:
    """Displacement and scaled velocity of nodes as rows over the states: what an initial state means physically."""
    x = asm.columns("x")
    every = [n for n in asm.network.nodes if n not in asm.network.moved_nodes]
    pick = [every.index(n) for n in (every if nodes is None else nodes)]
    return np.vstack([asm.position[pick, x], 0.05 * asm.velocity[pick, x]])


def carrier(source: Assembly, target: Assembly) -> Array:
    """Matrix from initial states of one network to those of another: the nodes that both have move alike."""
    moved = source.network.moved_nodes
    both = [n for n in source.network.nodes if n in target.network.nodes and n not in moved]
    if not both or not target.size[0]:
        return np.zeros((target.size[0], source.size[0]))
    own, other = motion_rows_of(target, both), motion_rows_of(source, both)
    return np.asarray(np.linalg.lstsq(own, other, rcond=None)[0], dtype=np.float64)


# ------------------------------------------------------------------------------------------- weights


@dataclass(frozen=True)
class Whitener:
    """Autoregressive filters, one a channel: residual -> innovations of unit variance. `taps` (channels, order+1)."""

    taps: tuple[Array, ...]

    def __call__(self, residual: Array) -> Array:
        """residual (n, channels, ...) -> same shape, whitened along time."""
        wide = residual.reshape(*residual.shape[:2], -1)
        out = np.empty(wide.shape)
        for j, a in enumerate(self.taps):
            _filter(a, wide[:, j], out[:, j])
        return out.reshape(residual.shape)


@nb.njit(cache=True, nogil=True)
def _filter(taps, x, out):
    """out[t] = sum over k of taps[k] x[t - k], for every column of x (n, columns)."""
    for t in range(len(x)):
        for c in range(x.shape[1]):
            out[t, c] = taps[0] * x[t, c]
        for k in range(1, min(len(taps), t + 1)):
            for c in range(x.shape[1]):
                out[t, c] += taps[k] * x[t - k, c]


def autoregression(series: Sequence[Array], order: int, least: float = 0.0) -> tuple[Array, float]:
    """Least-squares AR taps (1, -a1, ...) and innovation standard deviation of several stretches of one series.

    White noise of deviation `least` is added in thought: bands where a record happens to be quieter than any model
    can be trusted to be are not weighed by how quiet they are.
    """
    gram: Array = np.zeros((order, order))
    rhs: Array = np.zeros(order)
    count, total = 0, 0.0
    for x in series:
        lags = np.lib.stride_tricks.sliding_window_view(x, order + 1)[:, ::-1]
        gram += lags[:, 1:].T @ lags[:, 1:]
        rhs += lags[:, 1:].T @ lags[:, 0]
        total += float(lags[:, 0] @ lags[:, 0])
        count += len(lags)
    total += count * least**2
    gram += count * least**2 * np.eye(order)
    ridge = 1e-9 * float(np.trace(gram)) / order + 1e-300
    a = np.linalg.solve(gram + ridge * np.eye(order), rhs)
    variance = max(float(total - 2 * a @ rhs + a @ gram @ a), 1e-300) / max(count, 1)
    return np.concatenate([[1.0], -a]), math.sqrt(variance)


def whitener(residuals: Sequence[Array], floor: Array, order: int = 20) -> Whitener:
    """Filters from residuals [(n, channels), ...] of the best model at hand; `floor` (channels,): noise to reckon with."""
    taps = []
    for j in range(residuals[0].shape[1]):
        series = [r[:, j] - r[:, j].mean() for r in residuals]
        a, sigma = autoregression(series, min(order, min(map(len, series)) // 8), float(floor[j]))
        taps.append(a / max(sigma, 1e-300))
    return Whitener(tuple(taps))


def innovations(residuals: Sequence[Array], floor: Array, order: int = 20) -> float:
    """Sum over channels of n log(innovation variance): minus twice the log likelihood under own coloured noise."""
    total = 0.0
    for j in range(residuals[0].shape[1]):
        series = [r[:, j] - r[:, j].mean() for r in residuals]
        _, sigma = autoregression(series, min(order, min(map(len, series)) // 8), float(floor[j]))
        total += 2 * sum(len(s) for s in series) * math.log(max(sigma, 1e-300))
    return total


def noise_of(series: Sequence[Array], step: float, *, white: bool = False) -> Noise:
    """Coloured measurement noise in residuals (n,): white plus AR(1), fitted to the spectrum above the motion.

    Below some 15 Hz signal and model error cover the noise, so its level there is that of the law found above. It is never
    more than the series itself. `white`: what a low-pass left of the spectrum tells a level, but no colour.
    """
    density, frequency = [], np.zeros(0)
    length = min(1024, min(len(x) for x in series))
    for x in series:
        frequency, s = welch(x - x.mean(), 1.0 / step, nperseg=length)
        density.append(s * len(x))
    s = np.maximum(np.sum(density, axis=0) / sum(len(x) for x in series), 1e-300)
    w = 2 * np.pi * frequency * step
    top = frequency[-1]
    pick = (frequency > max(min(15.0, 0.3 * top), 2 * frequency[1])) & (
        frequency < (0.7 if white else 0.98) * top
    )
    best: tuple[float, Noise] = (math.inf, Noise(0.0, 0.0, 0.0))
    for phi in (0.0,) if white else (0.0, 0.3, 0.5, 0.6, 0.7, 0.8, 0.87, 0.93):
        shape = 1.0 / (1 + phi**2 - 2 * phi * np.cos(w[pick]))
        for share in (1.0,) if phi == 0 else (0.0, 0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 0.9):
            model = share + (1 - share) * shape * (1 - phi) ** 2
            logs = np.log(s[pick] / model)
            # a median: peaks of unexplained motion do not lift the level
            level = float(np.median(logs))
            error = float(np.mean(np.minimum(np.abs(logs - level), 1.0)))
            if error < best[0] - 1e-9:
                unit = math.exp(level) / (2 * step)
                best = error, Noise(unit * share, unit * (1 - share) * (1 - phi) ** 2, phi)
    noise = best[1]
    share = min(1.0, float(np.var(np.concatenate(series))) / max(noise.deviation**2, 1e-300))
    return Noise(noise.white * share, noise.drive * share, noise.phi)


@dataclass(frozen=True)
class Noise:
    """White noise and AR(1) noise together: `white` variance, innovation variance `drive`, coefficient `phi`."""

    white: float
    drive: float
    phi: float

    @property
    def deviation(self) -> float:
        return math.sqrt(self.white + self.drive / (1 - self.phi**2))

    def density(self, w: Array) -> Array:
        return self.white + self.drive / (1 + self.phi**2 - 2 * self.phi * np.cos(w))


def passed(W: Whitener, noise: Sequence[Noise]) -> Array:
    """Mean square per channel that pure noise leaves behind the filters."""
    w = np.linspace(0, math.pi, 2048)
    out = []
    for a, n in zip(W.taps, noise, strict=True):
        response = np.abs(np.exp(-1j * np.outer(w, np.arange(len(a)))) @ a) ** 2
        out.append(float(np.mean(response * n.density(w))))
    return np.array(out)
