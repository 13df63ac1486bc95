"""Comparison of measured channels with the nominal model before any fit: turned signs, wrong units, swapped columns.

A turned sensor correlates with the simulation at nearly -1. No missing effect of a rig does so over a broad band, but
a refit explains such a record by a false effect. The correlation uses cross spectra of short segments, so that drift
and constants do not enter.
"""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING

import numpy as np
from scipy import signal

from ..._common.errors import plain
from ..._common.units import TABLE, convert
from ...physics.network import own_time
from .._simulation.problem import Problem, simulate_from_rest

if TYPE_CHECKING:
    from ..._common.arrays import Array
    from ...physics.network import Channel

CLEAR = 0.85  # least correlation of a channel with the simulation for a statement about the channel
SCALED = 0.93  # least correlation for a statement about a unit
UNLIKE = (
    0.5  # largest correlation of a channel with its own simulation for swapped columns
)
LEAST_SAMPLES = 256  # of a compared record
SEGMENTS = 8  # number of segments of a record, without overlap
NARROW = 4.0  # effective number of spectral lines below which a signal is a single sine
#: factors that a wrong unit causes, with the largest relative deviation of the measured factor
SLIPS = (
    (1e3, 1.6),
    (1e-3, 1.6),
    (9.80665, 1.25),
    (1 / 9.80665, 1.25),
    (180 / math.pi, 1.25),
    (math.pi / 180, 1.25),
)
VAGUE = (
    1.0  # relative uncertainty of a parameter from which amplitudes are not compared
)


def find_misreading(problem: Problem) -> str:
    """Return the clearest sign of a turned, mislabelled or swapped channel, in a line with the correlation and the remedy; '' for
    records that agree with the model or cannot be compared."""
    network = problem.network
    if not network.inputs or not all(c.measured for c in network.inputs):
        return ""
    spectra = _pooled(problem)
    if spectra is None:
        return ""
    xx, yy, xy, narrow = spectra
    r = xy / np.sqrt(np.outer(xx, yy))  # [simulated, measured]
    gain = np.sqrt(yy[None, :] / xx[:, None])
    outputs = list(network.outputs)
    if swap := _swapped(outputs, r, gain):
        return swap
    own, amplitude = np.diag(r), np.diag(gain)
    turned = [j for j in range(len(outputs)) if own[j] < -CLEAR]
    agree = [j for j in range(len(outputs)) if own[j] > CLEAR]
    if narrow and not agree:
        turned = []  # beyond a resonance that the model has elsewhere, every output of a sine is turned
    drives = [
        c
        for c in network.inputs
        if c.quantity in ("displacement", "velocity", "acceleration", "force")
    ]
    if (
        len(turned) > 1
        and len(turned) == len(outputs)
        and len(network.inputs) == len(drives) == 1
    ):
        name = plain(drives[0].name, 40)
        worst = max(own[j] for j in turned)
        return f"all outputs follow the model with r = {worst:.2f} or less, turned round: --sign {name}=-1"
    if turned:
        j = min(turned, key=lambda j: own[j])
        name = plain(outputs[j].name, 40)
        line = f"{name} follows the model with r = {own[j]:.2f}, turned round: --sign {name}=-1"
        motors = {
            plain(c.elements[0], 40)
            for c in network.inputs
            if c.quantity in ("current", "voltage")
        }
        if motors and len(turned) == len(outputs):
            return f"{line}, or swap the nodes of motor {' and '.join(sorted(motors))} in the model"
        return line
    if any(u >= VAGUE for u in network.uncertainty.values()):
        return ""
    scaled = [j for j in agree if own[j] > SCALED]
    slips: dict[int, float] = {}
    for j, (factor, slack) in itertools.product(scaled, SLIPS):
        if 1 / slack < amplitude[j] / factor < slack:
            slips.setdefault(j, factor)
    common = set(slips.values())
    if (
        len(slips) > 1
        and len(common) == 1
        and len(slips) == len(outputs)
        and len(drives) == 1
    ):
        return _unit_line(
            drives[0], 1 / common.pop(), float(min(own[j] for j in slips))
        )
    return next(
        (
            line
            for j, k in slips.items()
            if (line := _unit_line(outputs[j], k, float(own[j])))
        ),
        "",
    )


def _pooled(problem: Problem) -> tuple[Array, Array, Array, bool] | None:
    """Return the power of simulated (channels,) and measured outputs (channels,), their cross power, and whether the
    records are single sines near or above the slowest oscillation of the rig."""
    network = problem.network
    count = len(network.outputs)
    xx, yy, xy = np.zeros(count), np.zeros(count), np.zeros((count, count))
    narrow, used = True, False
    own = own_time(network)
    for record in problem.records:
        if len(record) < LEAST_SAMPLES:
            continue
        said = simulate_from_rest(network, record)
        if said is None:
            continue
        skip = len(record) // 8  # start-up from rest
        x, y = said[skip : len(record)], record.measured[skip:]
        if x.shape != y.shape or not np.isfinite(y).all():
            continue
        options = {"nperseg": len(x) // SEGMENTS, "detrend": "linear", "axis": 0}
        frequency, own_power = signal.welch(y, 1 / record.interval, **options)
        xx += signal.welch(x, 1 / record.interval, **options)[1].sum(axis=0)
        yy += own_power.sum(axis=0)
        xy += signal.csd(x[:, :, None], y[:, None, :], 1 / record.interval, **options)[
            1
        ].real.sum(axis=0)
        total = (
            own_power.sum(axis=1)
            if count == 1
            else (own_power / np.maximum(own_power.sum(axis=0), 1e-300)).sum(axis=1)
        )
        lines = float(total.sum() ** 2 / max(float((total**2).sum()), 1e-300))
        fast = (
            own is not None
            and 2 * math.pi * frequency[int(np.argmax(total))] * own > 0.5
        )
        narrow, used = narrow and lines < NARROW and fast, True
    if not used or not (np.isfinite(xy).all() and (xx > 0).all() and (yy > 0).all()):
        return None
    return xx, yy, xy, narrow


def _swapped(outputs: list[Channel], r: Array, gain: Array) -> str:
    """Return a line on two outputs whose columns are exchanged; '' without such outputs."""
    for i, j in itertools.combinations(range(len(outputs)), 2):
        crossed = min(r[i, j], r[j, i]) > CLEAR and all(
            0.4 < gain[a, b] < 2.5 for a, b in ((i, j), (j, i))
        )
        straight = all(r[k, k] > UNLIKE and 1 / 3 < gain[k, k] < 3 for k in (i, j))
        if crossed and not straight:
            one, two = (plain(outputs[k].name, 40) for k in (i, j))
            remedy = (
                f"--rename {one}={two} --rename {two}={one}"
                if outputs[i].si == outputs[j].si
                else "exchange their names in the header"
            )
            return (
                f"{one} follows the model's {two} with r = {r[j, i]:.2f}, and {two} its {one} with r = {r[i, j]:.2f}: the columns "
                f"are swapped: {remedy}"
            )
    return ""


def _unit_line(channel: Channel, factor: float, r: float) -> str:
    """Return a line on a channel that is `factor` times as large as the model; '' where no unit differs by that factor."""
    fits = [
        unit
        for unit, (si, _) in TABLE.items()
        if si == channel.si and 0.98 < convert(1.0, unit, channel.unit) * factor < 1.02
    ]
    if not fits:
        return ""
    name = plain(channel.name, 40)
    size = f"{factor:.4g} times" if factor > 1 else f"1/{1 / factor:.4g} of"
    return f"{name} is {size} what the model says, with r = {r:.2f}, in a wrong unit: --unit {name}={fits[0]}"
