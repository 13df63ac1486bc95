"""Low-pass filtering and differentiation of noisy measured inputs that move a node.

Model outputs and measured outputs pass the same low-pass, so the filter causes no bias. The pass band keeps the
signals of the outputs and leaves out the noise of differentiated inputs.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import firwin, welch

from ..._common.units import convert
from ...physics.network import MOTIONS, natural_frequencies, transfer
from .._simulation.interpolation import differences
from .._simulation.problem import BROKEN, low_pass
from .multirate import build_record

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..._common.arrays import Array
    from ...physics.network import Channel, Network
    from .._simulation.problem import Record

QUIET = 0.02  # relative noise (RMS) of a derivative below which no low-pass is needed
WIDE = 0.7  # share of the Nyquist frequency above which a low-pass removes too little to be worth its margins
#: Cutoff of the low-pass as a share of the Nyquist frequency of the compared samples; the roll-off takes the rest.
FILLED = 0.85
#: Share of the cutoff up to which the low-pass keeps a signal whole (the gain at the cutoff is one half).
PASSED = 0.75
#: Ratio of power density to noise density above which an output holds a signal (2: equal parts).
VISIBLE = 2.0
#: Share of an output's power above its noise to keep at any frequency. The remainder of a force with the sign of a rate is
#: harmonics, and a comparison of the harmonics needs noisier derivatives.
KEPT = 0.95
#: Multiple of the natural frequencies up to which the model resonates; the low-pass keeps the whole signal of this band.
ABOVE_RESONANCE = 2.0
#: Factor about a natural frequency within which input motion counts as excitation, since nominal parameters may be off.
NEAR = 1.25
#: Least number of independent periodogram values in a smoothed power density, for a standard error of about 12 %.
AVERAGES = 64
LENGTH = 2048  # largest number of samples of a periodogram
ORDERS = range(2, 7)  # differences from which white noise is estimated
LEAST_COMPARED = 60  # least number of compared samples of a record behind a low-pass


def differentiate_inputs(records: list[Record], network: Network) -> list[Record]:
    """Return records behind one low-pass, with derivatives, if noisy inputs have to be differentiated; else `records` unchanged."""
    orders = count_derivatives(network)
    step = records[0].step
    if not orders or any(abs(r.step - step) > 1e-3 * step for r in records):
        return records
    thin = choose_decimation(records, network)
    if thin < 2:
        return records
    shortest = min(r.samples for r in records)
    cutoff = FILLED * 0.5 / (step * thin)
    size = min(2 * math.ceil(4.0 / (cutoff * step)) + 1, 2 * (shortest // 8) + 1)
    taps = firwin(size, cutoff, fs=1 / step, window=("kaiser", 6.0))
    # near the ends of a record the filter extrapolates: inputs and outputs there are not compared
    margin = min(math.ceil(len(taps) / thin), shortest // (8 * thin))
    moved = [c.name for c in network.moving if c.name in orders]
    out = []
    for r in records:
        if r.source is not None:  # outputs with time stamps of their own
            made = build_record(r.source, network, r.lags, thin=thin, cutoff=cutoff)
            filtered = replace(made, name=r.name, taps=taps)
        else:
            kept = slice(margin * thin, r.samples - margin * thin, thin)
            measured = low_pass(r.measured, taps)[kept]
            filtered = replace(
                r, measured=measured, taps=taps, margin=margin, thin=thin
            )
        inputs = dict(filtered.inputs) | {
            n: low_pass(filtered.inputs[n], taps) for n in moved
        }
        slopes = {n: differences(inputs[n], filtered.step) for n in moved}
        noise = {n: estimate_white_noise(r.inputs[n]) for n in moved}
        out.append(replace(filtered, inputs=inputs, slopes=slopes, input_noise=noise))
    return out


def count_derivatives(network: Network) -> dict[str, int]:
    """Return how often each input that moves a node has to be differentiated, 1 or 2."""
    orders = {
        c.name: _highest_derivative(network, str(c.at)) - MOTIONS.index(c.quantity)
        for c in network.moving
    }
    return {name: order for name, order in orders.items() if order > 0}


def _highest_derivative(network: Network, node: str) -> int:
    """Return the highest derivative of a moved node's displacement in the forces: 2 if inertia acts on the node or its measured force."""
    here = [e for e in network.elements if e.place == "between" and node in e.where]
    if any(e.linear()[2] for e in here):
        return 2
    has_force_sensor = any(
        c.quantity == "force" and c.at == node for c in network.outputs
    )
    if has_force_sensor and network.masses.get(node):
        return 2
    return 1 if has_force_sensor or any(e.linear()[1] for e in here) else 0


def choose_decimation(records: Sequence[Record], network: Network) -> int:
    """Return n such that every n-th output sample is compared, behind a low-pass at `FILLED` of the new Nyquist frequency: it ends at the
    noise of the derivatives of the inputs, but never within the signal band of the outputs."""
    orders = count_derivatives(network)
    nyquist = 0.5 / records[0].step
    bands = [
        find_derivative_band(r, network, c, orders[c.name])
        for r in records
        for c in network.moving
        if c.name in orders
    ]
    noisy = find_noise_band(records, network)
    end = min([*bands, noisy])
    if end > WIDE * nyquist:
        return 1
    # the measured force above that frequency cannot be compared
    keep = min(max(find_signal_band(r, network) for r in records), noisy)
    most = FILLED * PASSED * nyquist / max(keep, 1e-300)
    most = min(most, min(map(len, records)) / LEAST_COMPARED)
    return max(min(math.ceil(nyquist / end), math.floor(most)), 1)


def find_noise_band(records: Sequence[Record], network: Network) -> float:
    """Return the frequency [Hz] from which on the noise of a force computed from a twice differentiated motion, which grows with the
    square of the frequency, has more power than the measured force, there and in sum beyond; or infinity."""
    step, lowest = records[0].step, math.inf
    usable = [r for r in records if r.reading is None and len(r) == r.samples >= 64]
    length = min([LENGTH, *(len(r) // 4 for r in usable)])
    for motion, force in find_computed_forces(network) if usable else ():
        j, k = network.outputs.index(force), network.inputs.index(motion)
        noise = float(
            np.median([estimate_white_noise(r.inputs[motion.name]) for r in usable])
        )
        measured = [r.measured[:, j] - r.measured[:, j].mean() for r in usable]
        spectra = [welch(y, 1 / step, nperseg=length) for y in measured]
        frequency, seen = spectra[0][0], np.mean([s for _, s in spectra], axis=0)
        try:
            gain = transfer(network, frequency)[:, j, k] * convert(
                1.0, force.si, force.unit
            )
        except BROKEN:
            continue
        made = np.abs(gain) ** 2 * 2 * noise**2 * step
        above = np.flatnonzero(
            (made > seen) & (np.cumsum((made - seen)[::-1])[::-1] > 0)
        )
        lowest = min([lowest, *frequency[above[:1]].tolist()])
    return lowest


def find_computed_forces(network: Network) -> list[tuple[Channel, Channel]]:
    """Return the measured displacements (inputs) that are differentiated twice, each with the output of the force at the same node."""
    orders = count_derivatives(network)
    return [
        (c, o)
        for c in network.moving
        for o in network.outputs
        if c.quantity == "displacement"
        and orders.get(c.name) == 2
        and o.quantity == "force"
        and o.at == c.at
    ]


def estimate_white_noise(x: Array) -> float:
    """Return the RMS of the white noise of a smooth signal (n,): the least over several orders of differences, whose variance is that of
    the noise times a binomial coefficient (Hall, Kay and Titterington, Biometrika 77 (1990) 521)."""
    variances = [
        np.mean(np.diff(x, m) ** 2) / math.comb(2 * m, m)
        for m in ORDERS
        if len(x) > 2 * m
    ]
    return math.sqrt(float(min(variances, default=0.0)))


def find_derivative_band(
    record: Record, network: Network, channel: Channel, order: int
) -> float:
    """Return the frequency [Hz] up to which the derivative of an input is signal: that of the valley between motion and noise, or that of
    `_find_force_band`; infinite if its noise is negligible."""
    x, step = record.inputs[channel.name], record.step
    f, density = _estimate_density(np.diff(x, order), step)
    width = max(3, len(f) // 64)
    level = _smooth_logarithm(density, width)
    peak = int(np.argmax(level[: max(2, len(f) // 2)]))
    valley = peak + int(np.argmin(level[peak : len(f) - width]))
    if math.sqrt(density[valley:].sum() / max(density.sum(), 1e-300)) < QUIET:
        return math.inf
    end = float(f[valley])
    sensors = [
        j
        for j, c in enumerate(network.outputs)
        if c.quantity == "force" and c.at == channel.at
    ]
    if sensors and len(record) == len(x):
        motion = _integrate_density(f, density, step, order)
        found = _find_force_band(
            record, network, channel, sensors[0], f, motion, valley
        )
        end = end if found is None else found
    return max(end, float(20 * f[1]))


def _find_force_band(
    record: Record,
    network: Network,
    channel: Channel,
    output: int,
    frequency: Array,
    motion: Array,
    valley: int,
) -> float | None:
    """Return the frequency [Hz] above which the force computed from a measured motion has more than 1.5 times the power of the measured
    force: noise, since a missing effect causes an excess at some frequencies only. None if the model has no frequency response."""
    try:
        gain = transfer(network, frequency)[:, output, network.inputs.index(channel)]
    except BROKEN:
        return None
    width = max(3, len(frequency) // 64)
    top = len(frequency) - width
    computed = _smooth_logarithm(motion * np.abs(gain) ** 2, width)
    seen = _smooth_logarithm(
        _estimate_density(record.measured[:, output], record.step)[1], width
    )
    computed = computed * (
        seen[:valley].sum() / max(computed[:valley].sum(), 1e-300)
    )  # parameters may be off
    signal = np.flatnonzero(computed[:top] < 1.5 * seen[:top])
    return float(frequency[signal[-1]]) if len(signal) else 0.0


def find_signal_band(record: Record, network: Network) -> float:
    """Return the highest frequency [Hz] of the signals in a record: of every signal within the resonance of the model and of
    displacements, of `KEPT` of the power of other outputs, and of every natural frequency in the motion of an input."""
    natural = natural_frequencies(network)
    resonant = ABOVE_RESONANCE * float(natural.max(initial=0.0))
    highest = 0.0
    for c, y in zip(network.outputs, record.measured.T, strict=True):
        f, density = _estimate_density(y, record.interval)
        seen = _smooth(density)
        above = np.maximum(seen - VISIBLE * float(seen.min()), 0.0)
        power = np.cumsum(above)
        bulk = f[np.searchsorted(power, KEPT * power[-1])] if power[-1] > 0 else 0.0
        holds = (above > 0) & ((f < resonant) | (c.quantity == "displacement"))
        highest = max(highest, float(bulk), float(f[holds].max(initial=0.0)))
    for c in network.moving:
        f, density = _estimate_density(np.diff(record.inputs[c.name]), record.step)
        motion = _smooth(_integrate_density(f, density, record.step, 1))
        moves = motion > VISIBLE * float(motion.min())
        for at in natural:
            if moves[(f > at / NEAR) & (f < at * NEAR)].any():
                highest = max(highest, ABOVE_RESONANCE * float(at))
    return highest


def _estimate_density(values: Array, step: float) -> tuple[Array, Array]:
    """Return frequencies [Hz] and one-sided power density of a signal (n,) without its mean."""
    return welch(
        values - values.mean(), 1 / step, nperseg=min(LENGTH, len(values) // 4)
    )


def _integrate_density(
    frequency: Array, density: Array, step: float, order: int
) -> Array:
    """Return the power density of a signal from the density of its differences of the given order."""
    return density / np.maximum(2 * np.sin(math.pi * frequency * step), 1e-9) ** (
        2 * order
    )


def _smooth_logarithm(density: Array, width: int) -> Array:
    """Return geometric means of a power density over `width` neighbouring frequencies."""
    window = np.ones(width) / width
    return np.exp(np.convolve(np.log(np.maximum(density, 1e-300)), window, mode="same"))


def _smooth(density: Array) -> Array:
    """Return means of a power density over neighbouring frequencies, of at least `AVERAGES` independent values."""
    inner = density.copy()
    # the mean is removed and the density one-sided: the first and the last values are no noise densities
    inner[:2], inner[-1] = density[2], density[-2]
    return uniform_filter1d(
        inner, max(len(density) // 64, AVERAGES // 7, 3), mode="nearest"
    )
