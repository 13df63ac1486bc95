"""The missing force between two nodes over time, which the residuals of the outputs show."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal.windows import tukey

from ..._common.errors import InputError
from ..._common.units import convert
from ...physics import elements as el
from ...physics.network import Channel, Network, linearise
from ...physics.simulate import pace

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from ..._common.arrays import Array

HIGHEST = 8.0  # times the frequency of the motion: above, sensors resolve no force


def reconstruct_force(
    network: Network,
    pair: tuple[str, str],
    time: Array,
    measured: Mapping[str, Array],
    residual: Mapping[str, Array],
    noise: Mapping[str, float],
) -> Array:
    """Return the force between two nodes that explains the residuals of outputs best under white noise.

    The filter is Wiener's, with the force's own spectrum as prior (expectation maximisation), in a band up to `HIGHEST` times the
    frequency of the measured motion.

    Args:
        network: The model.
        pair: The two nodes.
        time: Time stamps (n,) [s].
        measured: Output (n,) by channel [unit of the channel].
        residual: Residual (n,) by channel [unit of the channel].
        noise: RMS noise by channel [unit of the channel].

    Returns:
        Force (n,) [N].

    Raises:
        InputError: The record is too short, or the model has no linear response.
    """
    step, samples = float(time[1] - time[0]), len(time)
    frequency = np.asarray(np.fft.rfftfreq(samples, step), np.float64)
    scale = float(np.median([pace(y, step) for y in measured.values()]))
    highest = min(HIGHEST / (2 * math.pi * scale), 0.4 / step)
    band = (frequency >= 0.5 / (samples * step)) & (frequency <= highest)
    if band.sum() < 10:
        raise InputError("the record is too short to look for a force in it")
    channels = [c for c in network.outputs if c.name in measured]
    gain = _response(network, pair, channels, frequency[band])
    factors = np.array([convert(1.0, c.unit, c.si) for c in channels])
    taper = tukey(samples, 0.1)
    left = np.stack([residual[c.name] for c in channels], axis=1) * factors
    left = (left - left.mean(axis=0)) * taper[:, None]
    spectrum = np.fft.rfft(left, axis=0)[band]
    level = np.maximum([noise[c.name] for c in channels], 1e-12) * factors
    power = level**2 * float(np.sum(taper**2))
    seen = np.sum(np.abs(gain) ** 2 / power, axis=1)
    sought = np.sum(gain.conj() * spectrum / power, axis=1)
    prior = np.abs(sought / np.maximum(seen, 1e-300)) ** 2
    width = max(3, len(prior) // 40)
    for _ in range(12):
        prior = np.maximum(uniform_filter1d(prior, width, mode="nearest"), 1e-30)
        force = sought / (seen + 1.0 / prior)
        prior = np.abs(force) ** 2 + 1.0 / (seen + 1.0 / prior)
    whole = np.zeros(len(frequency), complex)
    whole[band] = force
    return np.asarray(np.fft.irfft(whole, samples))


def _response(
    network: Network, pair: tuple[str, str], channels: list[Channel], frequency: Array
) -> NDArray[np.complex128]:
    """Return the linear response about rest (frequencies, channels) to a force between two nodes, in SI units per N."""
    name = network.free_name("missing_force")
    outputs = []
    for c in channels:
        # a cell that reads an element reads the force beside the element
        beside = c.element is not None and any(
            network.element(e).where == pair for e in c.elements
        )
        outputs.append(replace(c, element=(*c.elements, name)) if beside else c)
    motor = el.Motor(name, pair, thrust_constant=1.0, ratio=1.0)  # type: ignore[call-arg]
    probe = replace(
        network,
        elements=(*network.mechanical.elements, motor),
        inputs=(
            *(c for c in network.inputs if c.quantity != "current"),
            Channel(name, "current", "A", element=name),
        ),
        outputs=tuple(outputs),
        uncertainty={},
        turning=frozenset(),
    )
    space = linearise(probe)
    answer = space.response(frequency)[:, :, space.inputs.index(name)]
    return answer[:, [space.outputs.index(c.name) for c in channels]]
