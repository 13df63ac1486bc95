"""The frequency band that is compared where a measured input is differentiated: all of the signal, and little of the noise."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import welch

from ..errors import InputError
from ..network import MOTIONS, natural_frequencies, transfer

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..arrays import Array
    from ..network import Channel, Network
    from .problem import Record

#: relative noise (RMS) of a derivative below which no low-pass is needed
QUIET = 0.02
#: share of the Nyquist frequency above which a low-pass takes too little away to be worth its margins
WIDE = 0.7
#: share of the Nyquist frequency of the compared samples at which the low-pass has its cutoff: the rest is empty
FILLED = 0.85
#: share of the cutoff up to which the low-pass of `records.derivatives` keeps a signal whole (its gain at the cutoff is one half)
PASSED = 0.75
#: ratio of an output's power density to that of its noise above which the output holds a signal: signal and noise are equal
VISIBLE = 2.0
#: share of each output's power above its noise that must be kept at any frequency: of a force that switches with the sign of a
#: rate, the rest is harmonics, for which derivatives with more noise would be compared
KEPT = 0.95
#: up to this many times its natural frequencies the model resonates: there the whole signal is kept, however little its power
ABOVE_RESONANCE = 2.0
#: an input moves at a natural frequency if it does so within this factor of the frequency: nominal parameters may be off
NEAR = 1.25
#: independent periodogram values of which a smoothed power density is the mean at least: it is then known to some 12 %
AVERAGES = 64
LENGTH = 2048  # samples of a periodogram at most


def differentiated(network: Network) -> dict[str, int]:
    """Return the inputs that move a node and are differentiated, and how often each is.

    Args:
        network: The nominal model.

    Returns:
        Input name -> 1 or 2.
    """
    orders = {c.name: motion_needed(network, str(c.at)) - MOTIONS.index(c.quantity) for c in network.moving}
    return {name: order for name, order in orders.items() if order > 0}


def motion_needed(network: Network, node: str) -> int:
    """Return the highest derivative of the displacement of a moved node that forces need: 2 where inertia acts on the node."""
    here = [e for e in network.elements if e.place == "between" and node in e.where]
    if any(e.linear()[2] for e in here):
        return 2
    reads = any(c.quantity == "force" and c.at == node for c in network.outputs)
    return 1 if reads or any(e.linear()[1] for e in here) else 0


def decimation(records: Sequence[Record], network: Network) -> int:
    """Return of how many samples one is compared, behind a low-pass at `FILLED` of the new Nyquist frequency.

    The low-pass ends where the derivatives of the inputs are noise (`derivative_band`), but never within the band in
    which an output holds a signal (`signal_band`).

    Args:
        records: Records of one sampling interval.
        network: The nominal model.

    Returns:
        1 where no low-pass is needed, or none is possible without loss of signal.
    """
    orders = differentiated(network)
    moved = [c for c in network.moving if c.name in orders]
    nyquist = 0.5 / records[0].step
    ends = math.inf
    for r in records:
        ends = min([ends, *(derivative_band(r, network, c, orders[c.name]) for c in moved)])
    if ends > WIDE * nyquist:
        return 1
    keep = max(signal_band(r, network) for r in records)
    most = FILLED * PASSED * nyquist / max(keep, 1e-300)
    return max(min(math.ceil(nyquist / ends), math.floor(most)), 1)


def derivative_band(record: Record, network: Network, channel: Channel, order: int) -> float:
    """Return the frequency [Hz] at which the derivative of an input ends to be signal.

    Where a force is measured at the moved node, the band ends where the nominal model makes, from there on up, half as
    much power again of the measured motion as the force has: that is noise. A missing effect does so in places only.
    Without such a force the band ends in the valley between motion and noise.

    Args:
        record: The measured record.
        network: The nominal model.
        channel: The input.
        order: How often the input is differentiated.

    Returns:
        The frequency [Hz]; infinite where the noise of the derivative is too little to matter.
    """
    x, step = record.inputs[channel.name], record.step
    f, s = _density(np.diff(x, order), step)
    raw = _integrated(f, s, step, order)
    width = max(3, len(f) // 64)

    def smooth(density: Array) -> Array:
        window = np.ones(width) / width
        return np.exp(np.convolve(np.log(np.maximum(density, 1e-300)), window, mode="same"))

    level = smooth(s)
    peak = int(np.argmax(level[: max(2, len(f) // 2)]))
    valley = peak + int(np.argmin(level[peak : len(f) - width]))
    if math.sqrt(s[valley:].sum() / max(s.sum(), 1e-300)) < QUIET:
        return math.inf
    end = float(f[valley])
    cell = next(
        (j for j, c in enumerate(network.outputs) if c.quantity == "force" and c.at == channel.at), None
    )
    gain = _response(network, f) if cell is not None and len(record) == len(x) else None
    if cell is not None and gain is not None:
        made = smooth(raw * np.abs(gain[:, cell, network.inputs.index(channel)]) ** 2)
        seen = smooth(_density(record.measured[:, cell], step)[1])
        made = made * (seen[:valley].sum() / max(made[:valley].sum(), 1e-300))  # the parameters may be off
        signal = np.flatnonzero(made[: len(f) - width] < 1.5 * seen[: len(f) - width])
        end = float(f[signal[-1]]) if len(signal) else 0.0
    return max(end, float(20 * f[1]))


def signal_band(record: Record, network: Network) -> float:
    """Return the frequency [Hz] up to which a record holds a signal that the comparison must keep.

    An output holds a signal where its power density stands `VISIBLE` times above the density of its own noise. All of the
    signal is kept as far as the nominal model resonates (`ABOVE_RESONANCE`): slow motion has most of the power of a displacement,
    and the resonance most of what tells parameters and effects apart. All of the signal of a displacement is kept: no noise of a
    derivative reaches a displacement but through a mass. Of forces and accelerations, which show such noise as it is, `KEPT` of the
    power is kept further up. So is every natural frequency at which an input moves, whether the rig responds there or not.

    Args:
        record: The measured record.
        network: The nominal model.
    """
    natural = natural_frequencies(network)
    resonant = ABOVE_RESONANCE * float(natural.max(initial=0.0))
    highest = 0.0
    for c, y in zip(network.outputs, record.measured.T, strict=True):
        f, s = _density(y, record.rate)
        seen = _mean(s)
        above = np.maximum(seen - VISIBLE * float(seen.min()), 0.0)
        power = np.cumsum(above)
        bulk = f[np.searchsorted(power, KEPT * power[-1])] if power[-1] > 0 else 0.0
        holds = (above > 0) & ((f < resonant) | (c.quantity == "displacement"))
        highest = max(highest, float(bulk), float(f[holds].max(initial=0.0)))
    for c in network.moving:
        f, s = _density(np.diff(record.inputs[c.name]), record.step)
        motion = _mean(_integrated(f, s, record.step, 1))
        moves = motion > VISIBLE * float(motion.min())
        for at in natural:
            if moves[(f > at / NEAR) & (f < at * NEAR)].any():
                highest = max(highest, ABOVE_RESONANCE * float(at))
    return highest


def _density(values: Array, step: float) -> tuple[Array, Array]:
    """Return frequencies [Hz] and one-sided power density of a signal (n,) without its mean."""
    return welch(values - values.mean(), 1 / step, nperseg=min(LENGTH, len(values) // 4))


def _integrated(frequency: Array, density: Array, step: float, order: int) -> Array:
    """Return the power density of a signal from that of its differences of that order."""
    return density / np.maximum(2 * np.sin(math.pi * frequency * step), 1e-9) ** (2 * order)


def _mean(density: Array) -> Array:
    """Return a power density as means over neighbouring frequencies, each of `AVERAGES` values at least."""
    inner = density.copy()
    # without the mean, and one-sided, the first and the last values are no densities of noise
    inner[:2], inner[-1] = density[2], density[-2]
    return uniform_filter1d(inner, max(len(density) // 64, AVERAGES // 7, 3), mode="nearest")


def _response(network: Network, frequency: Array) -> Array | None:
    """Return the frequency response of the nominal model; None where its linear model has none."""
    try:
        return transfer(network, frequency)
    except (InputError, np.linalg.LinAlgError):
        return None
