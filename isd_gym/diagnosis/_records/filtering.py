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
from scipy.signal import welch

from ...physics.network import MOTIONS, natural_frequencies
from .._simulation.interpolation import differences
from .._simulation.problem import low_pass
from .resampling import CUTOFF, build_record, compare_behind_low_pass

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..._common.arrays import Array
    from ...physics.network import Channel, Network
    from .._simulation.problem import Record

QUIET = 0.02  # relative noise (RMS) of a derivative below which no low-pass is needed
#: Share of the cutoff up to which the low-pass keeps a signal whole (the gain at the cutoff is one half).
PASSED = 0.75
#: Ratio of power density to noise density above which an output holds a signal (2: equal parts).
VISIBLE = 2.0
#: Share of an output's power above its noise to keep. The remainder of a force with the sign of a rate is harmonics, and a
#: comparison of the harmonics needs noisier derivatives.
KEPT = 0.93
#: Multiple of the natural frequencies up to which the model resonates; the low-pass keeps the whole signal of this band.
ABOVE_RESONANCE = 2.0
AVERAGED = 16  # neighbouring frequencies whose mean power density is one of noise
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
    moved = [c.name for c in network.moving if c.name in orders]
    out = []
    for r in records:
        if r.source is not None:
            filtered = build_record(r.source, network, thin=thin, passes=2)
        else:
            filtered = compare_behind_low_pass(r, thin, passes=2)
        assert filtered.taps is not None
        inputs = dict(filtered.inputs)
        for n in moved:
            inputs[n] = low_pass(inputs[n], filtered.taps)
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
    """Return n such that every n-th output sample is compared, behind a low-pass at `CUTOFF` of the new Nyquist frequency: 1 if no input
    has noisy derivatives, else as many as the signal band of the outputs permits."""
    orders = count_derivatives(network).items()
    if max(_relative_noise(records, *order) for order in orders) < QUIET:
        return 1
    highest = max(find_signal_band(r, network) for r in records)
    most = CUTOFF * PASSED * 0.5 / (records[0].step * max(highest, 1e-300))
    return max(math.floor(min(most, min(map(len, records)) / LEAST_COMPARED)), 1)


def _relative_noise(records: Sequence[Record], name: str, order: int) -> float:
    """Return the RMS noise of the differences of an input, relative to the differences."""
    signals = [r.inputs[name] for r in records]
    noise = max(estimate_white_noise(x) for x in signals)
    whole = max(np.diff(x, order).std() for x in signals)
    return float(noise * math.sqrt(math.comb(2 * order, order)) / max(whole, 1e-300))


def find_signal_band(record: Record, network: Network) -> float:
    """Return the highest frequency [Hz] of the signals in a record: of the resonances of the model, and of `KEPT` of the power of each
    output."""
    bands = [ABOVE_RESONANCE * float(natural_frequencies(network).max(initial=0.0))]
    for y in record.measured.T:
        length = min(LENGTH, len(y) // 4)
        f, density = welch(y - y.mean(), 1 / record.interval, nperseg=length)
        noise = uniform_filter1d(density[1:-1], AVERAGED).min()
        power = np.cumsum(np.maximum(density - VISIBLE * noise, 0.0))
        bands.append(float(f[np.searchsorted(power, KEPT * power[-1])]))
    return max(bands)


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
