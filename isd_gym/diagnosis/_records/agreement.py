"""Comparison of measured channels with the nominal model before any fit: turned signs, wrong units, swapped columns.

A turned sensor correlates with the simulation at nearly -1. No missing effect of a rig does so over a broad band, but
a refit explains such a record by a false effect. The correlation uses cross spectra of short segments, so that drift
and constants do not enter.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import signal

from ..._common.errors import plain
from ..._common.units import convert, units_of
from ...physics.network import own_time
from .._simulation.problem import Problem, simulate_from_rest

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from ..._common.arrays import Array
    from ...physics.network import Channel, Network

CLEAR = 0.85  # least correlation of a channel with the simulation for a statement about the channel
SCALED = 0.93  # least correlation for a statement about a unit
UNLIKE = (
    0.5  # largest correlation of a channel with its own simulation for swapped columns
)
LEAST_SAMPLES = 256  # of a compared record
SEGMENTS = 8  # number of segments of a record, without overlap
NARROW = 4.0  # effective number of spectral lines below which a signal is a single sine
LARGE = 9.0  # least ratio of two units for a statement, since gains of sensors may be wrong too
SLACK = 1.5  # largest ratio of the measured factor to that of two units
VAGUE = (
    1.0  # relative uncertainty of a parameter from which amplitudes are not compared
)


@dataclass(frozen=True)
class _Spectra:
    """Agreement of simulated and measured outputs over all records."""

    #: correlation of simulated (rows) with measured outputs (columns)
    correlation: Array
    #: ratio of the amplitudes of measured (columns) to simulated outputs (rows)
    gain: Array
    #: whether the records are single sines near or above the slowest oscillation of the rig
    is_narrow: bool


def find_misreading(problem: Problem) -> str:
    """Return the clearest sign of a turned, mislabelled or swapped channel, in a line with the correlation and the remedy; '' for
    records that agree with the model or cannot be compared."""
    network = problem.network
    if not network.inputs or not all(c.measured for c in network.inputs):
        return ""
    found = _compare(problem)
    if found is None:
        return ""
    swapped = _find_swapped(network.outputs, found.correlation, found.gain)
    if swapped:
        return swapped
    own = np.diag(found.correlation)
    agrees = own > CLEAR
    turned = np.flatnonzero(own < -CLEAR)
    # beyond a resonance that the model has elsewhere, every output of a sine is turned
    if len(turned) and (agrees.any() or not found.is_narrow):
        return _describe_turned(network, turned, own)
    # an uncertain parameter may scale the outputs
    if any(u >= VAGUE for u in network.uncertainty.values()):
        return ""
    return _find_wrong_unit(network, own, np.diag(found.gain))


def _drives(network: Network) -> list[Channel]:
    """Return the inputs that are motions or forces."""
    kinds = ("displacement", "velocity", "acceleration", "force")
    return [c for c in network.inputs if c.quantity in kinds]


def _describe_turned(network: Network, turned: NDArray[np.int_], own: Array) -> str:
    """Return a line on turned outputs: the input is turned where all outputs are, else the clearest one."""
    worst = int(turned[np.argmin(own[turned])])
    is_every = len(turned) == len(network.outputs)
    if (
        is_every
        and len(turned) > 1
        and len(network.inputs) == len(_drives(network)) == 1
    ):
        name = plain(network.inputs[0].name, 40)
        return f"all outputs follow the model with r = {max(own):.2f} or less, turned round: --sign {name}=-1"
    name = plain(network.outputs[worst].name, 40)
    line = f"{name} follows the model with r = {own[worst]:.2f}, turned round: --sign {name}=-1"
    motors = {
        plain(c.elements[0], 40)
        for c in network.inputs
        if c.quantity in ("current", "voltage")
    }
    if motors and is_every:
        line += (
            f", or swap the nodes of motor {' and '.join(sorted(motors))} in the model"
        )
    return line


def _find_wrong_unit(network: Network, own: Array, gain: Array) -> str:
    """Return a line on a channel in a wrong unit: the only drive where all outputs differ by one factor, else the first such output."""
    drives = _drives(network)
    common = float(np.median(gain))
    is_common = (own > SCALED) & (gain < SLACK * common) & (common < SLACK * gain)
    if len(gain) > 1 and is_common.all() and len(drives) == 1:
        return _describe_unit(drives[0], 1 / common, min(own))
    agreeing = np.flatnonzero(own > SCALED)
    lines = [_describe_unit(network.outputs[j], gain[j], own[j]) for j in agreeing]
    return next(filter(None, lines), "")


def _compare(problem: Problem) -> _Spectra | None:
    """Return the agreement of the simulation from rest with the records; None where no record can be compared."""
    network = problem.network
    count = len(network.outputs)
    own = own_time(network)
    total = np.zeros((2 * count, 2 * count))
    is_narrow = True
    for record in problem.records:
        simulated = None
        if len(record) >= LEAST_SAMPLES:
            simulated = simulate_from_rest(network, record)
        if simulated is None or len(simulated) < len(record):
            continue
        both = np.hstack([simulated[: len(record)], record.measured])
        both = both[len(record) // 8 :]  # start-up from rest
        if not np.isfinite(both).all():
            continue
        frequency, cross = signal.csd(
            both[:, :, None],
            both[:, None, :],
            1 / record.interval,
            nperseg=len(both) // SEGMENTS,
            detrend="linear",
            axis=0,
        )
        total += cross.real.sum(axis=0)
        power = np.diagonal(cross.real, axis1=1, axis2=2)[:, count:]
        power = (power / np.maximum(power.sum(axis=0), 1e-300)).sum(axis=1)
        lines = power.sum() ** 2 / max(np.sum(power**2), 1e-300)
        peak = 2 * math.pi * frequency[np.argmax(power)]
        is_fast = own is not None and peak * own > 0.5
        is_narrow = is_narrow and lines < NARROW and is_fast
    size = np.sqrt(np.diag(total))
    if not (np.isfinite(total).all() and (size > 0).all()):
        return None
    cross = total[:count, count:]
    simulated_size, measured_size = size[:count, None], size[None, count:]
    return _Spectra(
        cross / (simulated_size * measured_size),
        measured_size / simulated_size,
        is_narrow,
    )


def _find_swapped(outputs: Sequence[Channel], r: Array, gain: Array) -> str:
    """Return a line on two outputs whose columns are exchanged; '' without such outputs."""
    agrees = (r > CLEAR) & (gain > 0.4) & (gain < 2.5)
    is_own = np.diag((r > UNLIKE) & (gain > 1 / 3) & (gain < 3))
    for i, j in itertools.combinations(range(len(outputs)), 2):
        if not (agrees[i, j] and agrees[j, i]) or (is_own[i] and is_own[j]):
            continue
        one, two = (plain(outputs[k].name, 40) for k in (i, j))
        remedy = "exchange their names in the header"
        if outputs[i].si == outputs[j].si:
            remedy = f"--rename {one}={two} --rename {two}={one}"
        return (
            f"{one} follows the model's {two} with r = {r[j, i]:.2f}, and {two} its {one} with r = {r[i, j]:.2f}: the columns "
            f"are swapped: {remedy}"
        )
    return ""


def _describe_unit(channel: Channel, gain: float, r: float) -> str:
    """Return a line on a channel whose amplitude is about `gain` times that of the model; '' where no unit differs by that factor."""
    factors = {u: convert(1.0, channel.unit, u) for u in units_of(channel.si)}
    for unit, factor in factors.items():
        is_far = not 1 / LARGE < factor < LARGE
        if is_far and 1 / SLACK < gain / factor < SLACK:
            name = plain(channel.name, 40)
            size = f"{factor:.4g} times" if factor > 1 else f"1/{1 / factor:.4g} of"
            return f"{name} is {size} what the model says, with r = {r:.2f}, in a wrong unit: --unit {name}={unit}"
    return ""
