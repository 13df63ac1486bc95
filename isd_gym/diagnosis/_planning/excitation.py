"""Test signals within the limits of a rig: multisines, sweeps, steps and triangles."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.signal import welch

from ..._common.errors import InputError
from .._simulation.problem import Record

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from ..._common.arrays import Array
    from ...physics.network import Channel, Network

KINDS = ("multisine", "sweep", "steps", "triangle")
#: time of fading in and out [s], at most a tenth of the test
RAMP = 0.5
#: largest number of lines of a multisine
LINES = 200
#: number of sets of random phases; the multisine with the lowest crest factor is used
PHASES = 6
#: amplitudes of tests as shares of the limits
LEVELS = (1.0, 0.4)


@dataclass(frozen=True)
class Rig:
    """Capabilities of a test rig."""

    #: largest amplitude [SI unit] and rate [SI unit/s] by input
    limits: Mapping[str, tuple[float, float]]
    #: lowest and highest frequency [Hz]
    band: tuple[float, float]
    #: length of a test [s]
    length: float
    #: sampling interval [s]
    step: float


@dataclass(frozen=True)
class Excitation:
    """A test signal."""

    #: one of `KINDS`
    kind: str
    #: lowest and highest frequency [Hz]
    band_hz: tuple[float, float]
    #: excited inputs; the other inputs stay at zero
    at: tuple[str, ...]
    #: amplitude as a share of each limit
    level: float = 1.0
    #: seed of phases and step heights
    seed: int = 0

    def signals(self, network: Network, rig: Rig) -> dict[str, Array]:
        """Return the inputs, which start and end at zero.

        Args:
            network: The model with the inputs.
            rig: The rig with limits, length and sampling interval.

        Returns:
            Signal (samples,) [SI unit] by input.
        """
        count = round(rig.length / rig.step) + 1
        time = np.asarray(rig.step * np.arange(count), dtype=np.float64)
        ramp = min(RAMP, 0.1 * float(time[-1]))
        position = np.clip(np.minimum(time, time[-1] - time) / ramp, 0.0, 1.0)
        window = 0.5 - 0.5 * np.cos(math.pi * position)
        out = {}
        for number, c in enumerate(network.inputs):
            if c.name not in self.at:
                out[c.name] = np.zeros(len(time))
                continue
            rng = np.random.default_rng([self.seed, number])
            raw = self._shape(c, time, rng) * window
            reach, fastest = rig.limits[c.name]
            raw *= self.level * reach / max(float(np.abs(raw).max()), 1e-300)
            slope = float(np.abs(np.diff(raw)).max()) / rig.step
            if c.quantity != "current" and slope > fastest:
                raw *= fastest / slope
            out[c.name] = raw
        return out

    def describe(self, network: Network, rig: Rig) -> str:
        """Return the test in words, such as ``multisine, 0.5 to 15 Hz, 20 s: road to 8.2 mm``."""
        signals = self.signals(network, rig)
        parts = []
        for c in network.inputs:
            if c.name in self.at:
                size = float(np.abs(signals[c.name]).max())
                is_length = c.quantity == "displacement"
                text = f"{1e3 * size:.3g} m" if is_length else f"{size:.3g} "
                parts.append(f"{c.name} to {text}{c.si}")
        low, high = self.band_hz
        band = f"{low:.3g} to {high:.3g} Hz"
        if self.kind == "triangle":
            band = f"at {low:.3g} Hz"
        return f"{self.kind}, {band}, {rig.length:g} s: {' and '.join(parts)}"

    def _shape(self, c: Channel, time: Array, rng: np.random.Generator) -> Array:
        """Return an unscaled signal (samples,). Displacements have about the same speed at all frequencies."""
        moves = c.quantity == "displacement"
        low, high = self.band_hz
        if self.kind == "multisine":
            return self._multisine(moves, time, rng)
        if self.kind == "steps":
            return self._steps(c.quantity == "current", time, rng)
        if self.kind == "triangle":
            return np.asarray(np.arcsin(np.sin(2 * math.pi * low * time)))
        rate = math.log(high / low) / time[-1]
        wave = np.sin(2 * math.pi * low * np.expm1(rate * time) / rate)
        if moves:
            wave *= np.minimum(1.0, math.sqrt(high / low) * np.exp(-rate * time))
        return np.asarray(wave)

    def _multisine(self, moves: bool, time: Array, rng: np.random.Generator) -> Array:
        """Return a multisine with amplitudes proportional to one over frequency if `moves`, else constant."""
        length = time[-1]
        low, high = (length * f for f in self.band_hz)
        cycles = np.arange(math.ceil(low), math.floor(high) + 1)
        if len(cycles) > LINES:  # the same number per decade
            cycles = np.unique(np.round(np.geomspace(cycles[0], cycles[-1], LINES)))
        lines = cycles / length
        amplitudes = 1 / lines if moves else np.ones(len(lines))
        signals = []
        for _ in range(PHASES):
            out, phases = np.zeros(len(time)), rng.uniform(0, 2 * math.pi, len(lines))
            for f, a, p in zip(lines, amplitudes, phases, strict=True):
                out += a * np.sin(2 * math.pi * f * time + p)
            signals.append(out)
        return min(signals, key=lambda y: float(np.abs(y).max() / max(y.std(), 1e-300)))

    def _steps(self, jumps: bool, time: Array, rng: np.random.Generator) -> Array:
        """Return random levels, connected by minimum-jerk ramps of half a period of the highest frequency unless `jumps`."""
        low, high = self.band_hz
        out, start, level = np.zeros(len(time)), 0.0, 0.0
        rise = 0.5 / high
        longest = max(0.5 / math.sqrt(low * high), 1.0 / high)
        while start < time[-1]:
            target = rng.uniform(-1.0, 1.0)
            s = np.clip((time - start) / rise, 0.0, 1.0)
            s = np.ceil(s) if jumps else s**3 * (10 - 15 * s + 6 * s**2)
            out += (target - level) * s
            level, start = target, start + rise + rng.uniform(rise, longest)
        return out


def infer_rig(network: Network, records: Sequence[Record]) -> Rig:
    """Return the capabilities of a rig, as its records show them.

    Args:
        network: The model with the inputs.
        records: Records measured on the rig.

    Raises:
        InputError: The records move no input, or no test can drive an input.
    """
    limits = {}
    low, high = math.inf, 0.0
    for c in network.inputs:
        if c.quantity == "condition":
            raise InputError(
                f"input '{c.name}': no test can drive a logged {c.spoken}; leave out the input and what reads it"
            )
        reach, slope = 0.0, 0.0
        for r in records:
            x = np.asarray(r.inputs[c.name])
            reach = max(reach, float(np.abs(x).max()))
            steepest = float(np.quantile(np.abs(np.diff(x)), 0.999))
            slope = max(slope, steepest / r.step)
            if np.ptp(x) > 0:
                first, last = _band(x, r.step, c.quantity == "displacement")
                low, high = min(low, first), max(high, last)
        if reach > 0:
            limits[c.name] = reach, slope or math.inf
    step = records[0].step
    length = max(r.samples * r.step for r in records)
    low, high = max(min(low, 0.1 / step), 1.0 / length), min(high, 0.25 / step)
    if not low < high:
        raise InputError("the records move no input")
    return Rig(limits, (low, high), length, step)


def _band(x: Array, step: float, moves: bool) -> tuple[float, float]:
    """Return the band [Hz] of 93 % of the power of an input (samples,); a displacement counts by its speed."""
    x = np.gradient(x, step) if moves else x - x.mean()
    f, s = welch(x, 1 / step, nperseg=min(len(x), 8192))
    total = np.cumsum(s)
    first, last = np.searchsorted(total, [0.02 * total[-1], 0.95 * total[-1]])
    return float(f[max(first, 1)]), float(f[last])


def list_excitations(network: Network, rig: Rig) -> Iterator[Excitation]:
    """Yield the tests among which a design chooses: of each kind, over the whole band and halves, at two levels, at all inputs and at each."""
    low, high = rig.band
    middle = math.sqrt(low * high)
    names = tuple(c.name for c in network.inputs if c.name in rig.limits)
    places = [names, *((n,) for n in names)] if len(names) > 1 else [names]
    for at in places:
        for kind in KINDS:
            for band in ((low, high), (low, middle), (middle, high)):
                for level in LEVELS:
                    yield Excitation(kind, band, at, level)


def make_record(network: Network, rig: Rig, excitation: Excitation) -> Record:
    """Return the record of a planned test. The outputs are zero."""
    inputs = excitation.signals(network, rig)
    count = len(next(iter(inputs.values())))
    return Record("planned", rig.step, inputs, np.zeros((count, len(network.outputs))))
