"""Test signals within the limits of a rig: multisines, sweeps and steps."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.signal import chirp, welch
from scipy.signal.windows import tukey

from .._simulation.problem import Record

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from ..._common.arrays import Array
    from ...physics.network import Network

#: share of a test in which its inputs fade in, and as much in which they fade out
FADED = 0.05
#: amplitudes of tests as shares of the limits
LEVELS = (1.0, 0.4)
#: the band of an input holds its power between these shares
BAND = (0.02, 0.95)


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

    #: one of `SHAPES`
    kind: str
    #: lowest and highest frequency [Hz]
    band_hz: tuple[float, float]
    #: excited inputs; the other inputs stay at zero
    at: tuple[str, ...]
    #: amplitude as a share of each limit
    level: float = 1.0


def multisine(time: Array, low: float, high: float, rng: np.random.Generator) -> Array:
    """Return a sum of sines (samples,) of random phases and of the same speed."""
    frequency = np.fft.rfftfreq(len(time), time[1])
    band = (frequency >= low) & (frequency <= high)
    spectrum = np.zeros(len(frequency), complex)
    phases = rng.uniform(0, 2 * math.pi, band.sum())
    spectrum[band] = np.exp(1j * phases) / frequency[band]
    return np.asarray(np.fft.irfft(spectrum, len(time)))


def sweep(time: Array, low: float, high: float, _: np.random.Generator) -> Array:
    """Return a logarithmic sweep (samples,), of the same speed in the upper half of its band."""
    wave = chirp(time, low, time[-1], high, "logarithmic", phi=-90)
    return np.asarray(wave * np.minimum(1.0, (high / low) ** (0.5 - time / time[-1])))


def steps(time: Array, low: float, high: float, rng: np.random.Generator) -> Array:
    """Return random levels (samples,), each held for at least half a period of the highest frequency, with ramps as long."""
    longest = max(0.5 / math.sqrt(low * high), 1.0 / high)
    count = math.ceil(time[-1] * high)
    holds = rng.uniform(0.5 / high, longest, count)
    ramps = np.full(count, 0.5 / high)
    corners = np.cumsum(np.stack([ramps, holds], axis=1))
    levels = np.repeat(rng.uniform(-1.0, 1.0, count), 2)
    return np.asarray(PchipInterpolator(corners, levels)(time))


SHAPES = {"multisine": multisine, "sweep": sweep, "steps": steps}


def infer_rig(network: Network, records: Sequence[Record]) -> Rig | None:
    """Return the capabilities of a rig, as its records show them; None if no test can drive an input, or the records move none.

    Args:
        network: The model with the inputs.
        records: Records measured on the rig.
    """
    if any(c.quantity == "condition" for c in network.inputs):
        return None
    step = records[0].step
    length = max(r.samples * r.step for r in records)
    limits = {}
    bands = []
    for c in network.inputs:
        moved = [r for r in records if np.ptp(r.inputs[c.name]) > 0]
        if not moved:
            continue
        signals = [np.asarray(r.inputs[c.name]) for r in moved]
        reach = max(np.abs(x).max() for x in signals)
        rate = max(np.quantile(np.abs(np.diff(x)), 0.999) for x in signals) / step
        limits[c.name] = (float(reach), float(rate) or math.inf)
        for x in signals:
            # a displacement counts by its speed
            is_length = c.quantity == "displacement"
            bands.append(_band(np.gradient(x) if is_length else x, step))
    if not bands:
        return None
    lowest, highest = np.transpose(bands)
    low = max(lowest.min(), 1.0 / length)
    high = min(highest.max(), 0.25 / step)
    return Rig(limits, (float(low), float(high)), length, step) if low < high else None


def _band(x: Array, step: float) -> tuple[float, float]:
    """Return the band [Hz] that holds the power of a signal (samples,)."""
    f, power = welch(x - x.mean(), 1 / step, nperseg=min(len(x), 8192))
    total = np.cumsum(power)
    first, last = np.searchsorted(total, np.array(BAND) * total[-1])
    return float(f[max(first, 1)]), float(f[last])


def list_excitations(rig: Rig) -> Iterator[Excitation]:
    """Yield the tests among which a design chooses: of each kind, over the whole band and halves, at two levels, at all inputs and at each."""
    low, high = rig.band
    middle = math.sqrt(low * high)
    bands = ((low, high), (low, middle), (middle, high))
    names = tuple(rig.limits)
    places = dict.fromkeys([names, *((n,) for n in names)])
    for choice in itertools.product(SHAPES, bands, places, LEVELS):
        yield Excitation(*choice)


def make_record(network: Network, rig: Rig, excitation: Excitation) -> Record:
    """Return the record of a planned test, whose inputs start and end at zero. The outputs are zero."""
    count = round(rig.length / rig.step) + 1
    time = np.asarray(rig.step * np.arange(count), dtype=np.float64)
    inputs = {}
    for number, c in enumerate(network.inputs):
        inputs[c.name] = np.zeros(count)
        if c.name in excitation.at:
            rng = np.random.default_rng(number)
            shape = SHAPES[excitation.kind](time, *excitation.band_hz, rng)
            wave = shape * tukey(count, 2 * FADED)
            reach, rate = rig.limits[c.name]
            size = np.abs(wave).max() / (excitation.level * reach)
            speed = np.abs(np.diff(wave)).max() / rig.step
            inputs[c.name] = wave / max(size, speed / rate, 1e-300)
    return Record("planned", rig.step, inputs, np.zeros((count, len(network.outputs))))
