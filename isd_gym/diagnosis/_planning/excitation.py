"""Test signals within the limits of a rig: multisines, sweeps, steps and triangles."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..._common.errors import InputError, shown
from ..._common.units import convert
from ...records.data import Table
from .._simulation.problem import Record

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from ..._common.arrays import Array
    from ...physics.network import Channel, Network

KINDS = ("multisine", "sweep", "steps", "triangle")
#: amplitude [SI unit] and rate [SI unit/s] of a typical rig
REACH = {
    "m": 0.01,
    "m/s": 0.2,
    "m/s^2": 3.0,
    "rad": 0.2,
    "rad/s": 2.0,
    "rad/s^2": 30.0,
    "A": 5.0,
    "V": 6.0,
}
SLOPE = {"m": 0.5, "rad": 5.0}
WEIGHT = 0.1 * 9.81  # amplitude of a force per mass of the model [N/kg]
LENGTH = 20.0  # [s]
SAMPLES = 20.0  # per period of the highest frequency
RAMP = 0.5  # time of fading in and out [s], at most a tenth of the test
LINES = 200  # of a multisine at most
MOST_SAMPLES = 2_000_000  # of a test
PHASES = 6  # sets of random phases; the multisine with the lowest crest factor is used


@dataclass(frozen=True)
class Limits:
    """Limits of a rig at one input."""

    reach: float  # largest amplitude [SI unit]
    slope: float = math.inf  # largest rate [SI unit/s]

    def __post_init__(self) -> None:
        if not (0 < self.reach < math.inf and self.slope > 0):
            raise InputError(
                f"a limit of an input must be a number > 0, not {self.reach:g}"
            )


@dataclass(frozen=True)
class Rig:
    """Capabilities of a test rig."""

    limits: Mapping[str, Limits]  # by input
    band: tuple[float, float]  # lowest and highest frequency [Hz]
    length: float = LENGTH  # of a test [s]
    step: float = 2e-3  # sampling interval [s]

    def __post_init__(self) -> None:
        low, high = self.band
        if not 0 < low < high < math.inf:
            raise InputError(
                f"the band must have frequencies 0 < LOW < HIGH, not {low:g}:{high:g}"
            )
        if not (self.length > 0 and math.isfinite(self.length)):
            raise InputError(
                f"the length of a test must be a number of seconds > 0, not {self.length:g}"
            )
        if not 0 < self.step < math.inf:
            raise InputError(
                f"the sampling interval of a test must be positive, not {self.step:g} s"
            )
        if not self.length / self.step < MOST_SAMPLES:
            raise InputError(
                f"a test of {self.length:g} s at {1 / self.step:g} Hz has {self.length / self.step:.3g} samples, at most "
                f"{MOST_SAMPLES} are simulated"
            )
        if high * self.step > 0.25:
            raise InputError(
                f"a band up to {high:g} Hz needs a sampling rate of {4 * high:g} Hz or more, not {1 / self.step:g}"
            )
        if self.length * low < 1.0:
            raise InputError(
                f"a test of {self.length:g} s is shorter than a period of {low:g} Hz: use a longer test or a higher band"
            )

    @property
    def time(self) -> Array:
        """Sampling times [s] (samples,)."""
        return np.asarray(
            self.step * np.arange(round(self.length / self.step) + 1), dtype=np.float64
        )


@dataclass(frozen=True)
class Excitation:
    """A test signal."""

    kind: str  # one of `KINDS`
    low: float  # lowest frequency [Hz]
    high: float  # highest frequency [Hz]
    at: tuple[str, ...]  # excited inputs; the other inputs stay at zero
    level: float = 1.0  # amplitude as a share of each limit
    seed: int = 0  # of phases and step heights

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InputError(
                f"no excitation {shown(self.kind)} (there are {', '.join(KINDS)})"
            )

    def signals(self, network: Network, rig: Rig) -> dict[str, Array]:
        """Generate the inputs, which start and end at zero.

        Args:
            network: The model with the inputs.
            rig: The rig with limits, length and sampling interval.

        Returns:
            Signal (samples,) [SI unit] by input.
        """
        time = rig.time
        ramp = min(RAMP, 0.1 * float(time[-1]))
        position = np.clip(np.minimum(time, time[-1] - time) / ramp, 0.0, 1.0)
        window = 0.5 - 0.5 * np.cos(math.pi * position)
        out = {}
        for number, c in enumerate(network.inputs):
            if c.name not in self.at:
                out[c.name] = np.zeros(len(time))
                continue
            raw = (
                self._shape(c, time, np.random.default_rng([self.seed, number]))
                * window
            )
            limits = rig.limits[c.name]
            raw *= self.level * limits.reach / max(float(np.abs(raw).max()), 1e-300)
            slope = float(np.abs(np.diff(raw)).max()) / rig.step
            if c.quantity != "current" and slope > limits.slope:
                raw *= limits.slope / slope
            out[c.name] = raw
        return out

    def describe(self, network: Network, rig: Rig) -> str:
        """Return the test in words, such as ``multisine, 0.5 to 15 Hz, 20 s: road to 8.2 mm``.

        Args:
            network: The model with the inputs.
            rig: The rig with the limits.
        """
        signals = self.signals(network, rig)
        inputs = {c.name: c for c in network.inputs}
        parts = [
            f"{n} to {_amount(float(np.abs(signals[n]).max()), inputs[n])}"
            for n in self.at
        ]
        band = f"{self.low:.3g} to {self.high:.3g} Hz"
        band = {
            "triangle": f"at {self.low:.3g} Hz",
            "steps": f"up to {self.high:.3g} Hz",
        }.get(self.kind, band)
        return f"{self.kind}, {band}, {rig.length:g} s: {' and '.join(parts)}"

    def to_dict(self) -> dict[str, Any]:
        """Return the excitation as JSON types."""
        return {
            "kind": self.kind,
            "band_hz": [self.low, self.high],
            "level": self.level,
            "at": list(self.at),
            "seed": self.seed,
        }

    def _shape(self, c: Channel, time: Array, rng: np.random.Generator) -> Array:
        """Generate an unscaled signal. Displacements have about the same speed at all frequencies.

        Args:
            c: The input.
            time: Sampling times [s] (samples,).
            rng: Source of phases and step heights.

        Returns:
            The signal (samples,).
        """
        moves = c.quantity == "displacement"
        if self.kind == "multisine":
            return self._multisine(moves, time, rng)
        if self.kind == "sweep":
            rate = math.log(self.high / self.low) / time[-1]
            phase = 2 * math.pi * self.low * np.expm1(rate * time) / rate
            middle = math.sqrt(self.low * self.high)
            size = (
                np.minimum(1.0, middle / (self.low * np.exp(rate * time)))
                if moves
                else 1.0
            )
            return np.asarray(size * np.sin(phase), dtype=np.float64)
        if self.kind == "triangle":
            return np.asarray(
                np.arcsin(np.sin(2 * math.pi * self.low * time)), dtype=np.float64
            )
        return self._steps(c.quantity == "current", time, rng)

    def _multisine(self, moves: bool, time: Array, rng: np.random.Generator) -> Array:
        """Generate a multisine with amplitudes proportional to one over frequency if `moves`, else constant."""
        length = time[-1]
        lines = (
            np.arange(math.ceil(self.low * length), math.floor(self.high * length) + 1)
            / length
        )
        if len(lines) > LINES:  # the same number per decade
            lines = (
                np.unique(np.round(np.geomspace(lines[0], lines[-1], LINES) * length))
                / length
            )
        amplitudes = 1 / lines if moves else np.ones(len(lines))
        signals = []
        for _ in range(PHASES):
            out, phases = np.zeros(len(time)), rng.uniform(0, 2 * math.pi, len(lines))
            for f, a, p in zip(lines, amplitudes, phases, strict=True):
                out += a * np.sin(2 * math.pi * f * time + p)
            signals.append(out)
        return min(signals, key=lambda y: float(np.abs(y).max() / max(y.std(), 1e-300)))

    def _steps(self, jumps: bool, time: Array, rng: np.random.Generator) -> Array:
        """Generate random levels, connected by minimum-jerk ramps of half a period of `high` unless `jumps`."""
        out, start, level = np.zeros(len(time)), 0.0, 0.0
        rise = 0.0 if jumps else 0.5 / self.high
        longest = max(0.5 / math.sqrt(self.low * self.high), 1.0 / self.high)
        while start < time[-1]:
            hold = rise + rng.uniform(0.5 / self.high, longest)
            target = rng.uniform(-1.0, 1.0)
            s = (
                np.clip((time - start) / rise, 0.0, 1.0)
                if rise
                else (time >= start).astype(float)
            )
            out += (target - level) * s**3 * (10 - 15 * s + 6 * s**2)
            level, start = target, start + hold
        return out


def _amount(value: float, c: Channel) -> str:
    """Return a value [SI unit] with its unit, displacements in milli-units."""
    return (
        f"{1e3 * value:.3g} m{c.si}"
        if c.quantity == "displacement"
        else f"{value:.3g} {c.si}"
    )


# ------------------------------------------------------------------------------------------------- limits of a rig


def infer_rig(network: Network, records: Sequence[Record]) -> Rig:
    """Infer the capabilities of a rig from its records. An input that stands in all records has typical limits.

    Args:
        network: The model with the inputs.
        records: Records measured on the rig.

    Returns:
        The rig.

    Raises:
        InputError: The limits of an input cannot be inferred, or no test can drive the input.
    """
    given = {}
    for c in network.inputs:
        if c.quantity == "condition":
            raise InputError(
                f"input '{c.name}': no test can drive a logged {c.spoken}; leave out the input and what reads it"
            )
        given[c.name] = _measured_limits(c, records) or _typical_limits(c, network)
    low, high = _measured_band(records, network)
    step = records[0].step
    low, high = min(low, 0.1 / step), min(high, 0.25 / step)
    seconds = max(r.samples * r.step for r in records)
    return Rig(given, (max(low, 1.0 / seconds), high), seconds, step)


def _measured_limits(c: Channel, records: Sequence[Record]) -> Limits | None:
    """Return the range of an input in records, or None if the input is zero or there are no records."""
    signals = [np.asarray(r.inputs[c.name]) for r in records]
    reach = max((float(np.abs(x).max()) for x in signals), default=0.0)
    if not reach > 0:
        return None
    slope = max(
        float(np.quantile(np.abs(np.diff(x)), 0.999)) / r.step
        for x, r in zip(signals, records, strict=True)
    )
    return Limits(reach, slope if c.quantity != "current" and slope > 0 else math.inf)


def _typical_limits(c: Channel, network: Network) -> Limits:
    """Return the limits of a typical rig at an input. Raise `InputError` for an unusual unit."""
    weight = WEIGHT * network.total_mass if c.si == "N" else 0.0
    reach = REACH.get(c.si) or weight
    if not reach:
        raise InputError(f"the largest value of {c.name} [{c.unit}] is unknown")
    return Limits(reach, SLOPE.get(c.si, math.inf))


def _measured_band(records: Sequence[Record], network: Network) -> tuple[float, float]:
    """Return the band [Hz] of 93 % of the inputs' power; displacements count by their speed."""
    from scipy.signal import welch

    low, high = math.inf, 0.0
    for r in records:
        for c in network.inputs:
            x = np.asarray(r.inputs[c.name])
            if not np.ptp(x) > 0:
                continue
            x = np.gradient(x, r.step) if c.quantity == "displacement" else x - x.mean()
            f, s = welch(x, 1 / r.step, nperseg=min(len(x), 8192))
            total = np.cumsum(s)
            low = min(low, float(f[np.searchsorted(total, 0.02 * total[-1])]))
            high = max(high, float(f[np.searchsorted(total, 0.95 * total[-1])]))
            low = max(low, float(f[1]))
    return (low, high) if 0 < low < high else (0.25, 15.0)


# ------------------------------------------------------------------------------------------- tests and their records


def list_excitations(network: Network, rig: Rig) -> Iterator[Excitation]:
    """Yield the tests among which a design chooses.

    Args:
        network: The model with the inputs.
        rig: The rig with band and length.

    Yields:
        Tests of each kind, over the whole band and halves, at two levels, at all inputs and at each input.
    """
    low, high = rig.band
    middle = math.sqrt(low * high)
    names = tuple(c.name for c in network.inputs)
    for at in [names, *((n,) for n in names)] if len(names) > 1 else [names]:
        for kind in KINDS:
            lower = [(low, middle)] if kind in ("multisine", "sweep") else []
            for a, b in [(low, high), *lower, (middle, high)]:
                if rig.length * a >= 1.0:
                    for level in (1.0, 0.4):
                        yield Excitation(kind, a, b, at, level)


def make_excitation(network: Network, rig: Rig, kind: str = "multisine") -> Excitation:
    """Make a test over the whole band at all inputs.

    Args:
        network: The model with the inputs.
        rig: The rig with the band.
        kind: One of `KINDS`.

    Returns:
        The test.
    """
    return Excitation(kind, *rig.band, tuple(c.name for c in network.inputs))


def make_record(
    network: Network,
    rig: Rig,
    excitation: Excitation,
    name: str = "planned",
    samples: int | None = None,
) -> Record:
    """Make the record of a planned test. The outputs are zero.

    Args:
        network: The model with inputs and outputs.
        rig: The rig.
        excitation: The test.
        name: Name of the record.
        samples: Largest number of samples. Default: the whole test.

    Returns:
        The record.
    """
    inputs = excitation.signals(network, rig)
    record = Record(
        name, rig.step, inputs, np.zeros((len(rig.time), len(network.outputs)))
    )
    return (
        record
        if samples is None or len(record) <= samples
        else record.part(0, samples, name)
    )


def make_table(network: Network, record: Record, source: str = "planned test") -> Table:
    """Make the table of a record's inputs, in the channels' units.

    Args:
        network: The model with the inputs.
        record: The record.
        source: Origin of the table.

    Returns:
        The table with time [s] and a column per input.
    """
    columns = {
        c.name: convert(np.asarray(record.inputs[c.name]), c.si, c.unit)
        for c in network.inputs
    }
    units = {c.name: c.unit for c in network.inputs}
    return Table(record.step * np.arange(record.samples), columns, source, units)
