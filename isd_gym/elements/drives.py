"""What a drive makes of the current that it is told to give."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from .base import Array, Element, Setting, Start, driven_motor, parameter, register

if TYPE_CHECKING:
    from ..network import Network


def delayed(values: Array, steps: float, before: float | None = None) -> Array:
    """`values` (n, ...) later by a number of samples, linear in between; `before` them, or the first one.

    steps: need not be whole.
    """
    low = math.floor(steps)
    part = steps - low
    first = np.repeat(values[:1] if before is None else np.full_like(values[:1], before), low + 1, axis=0)
    longer = np.concatenate([first, values])[: len(values) + 1]
    return longer[1:] if part == 0.0 else (1.0 - part) * longer[1:] + part * longer[:-1]


class _Drive(Element):
    """At a motor that a current drives; there was no current before the record."""

    place = "element"
    plane = "time"

    @classmethod
    def stands(cls, network: Network, where: tuple[str, ...]) -> bool:
        return driven_motor(network, where) and super().stands(network, where)


@register
class ThrustSaturation(_Drive):
    type = "thrust_saturation"
    mechanism = "drive"
    equation = "I_eff = I_s tanh(I / I_s)"
    source = "iron saturation of a linear motor"
    signature = "thrust falls short at high current only"
    test = (
        "Hold the device and raise the current in steps: the thrust must fall short of proportion as "
        "{current} is approached, and be in proportion below a fifth of it."
    )
    shaped_by = "current"
    current: float = parameter("A", 1.0, 50.0, open_end=True)

    def apply(self, signal: Array, step: float) -> Array:
        return np.asarray(self.current * np.tanh(signal / self.current), dtype=np.float64)

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        return [Start({"current": s * at.signal}) for s in (0.7, 1.2, 2.0, 4.0)]

    @classmethod
    def grown(cls, start: Start, factor: float) -> dict[str, float]:
        return {"current": start.values["current"] / factor}  # the lower, the more it takes away


@register
class ActuatorLag(_Drive):
    type = "actuator_lag"
    mechanism = "drive"
    equation = "tau dI/dt + I = I_command"
    source = "L/R of Table 1 (26 mH / 3.8 Ohm = 6.8 ms) or a drive's bandwidth"
    signature = "thrust late and rounded after a step in current"
    test = (
        "Command a step of current on the held device: the thrust must reach 63 % after {time_constant}, "
        "without a dead time."
    )
    time_constant: float = parameter("s", 1e-3, 0.1)

    def apply(self, signal: Array, step: float) -> Array:
        from scipy.signal import lfilter

        if not self.time_constant > 0:
            return signal
        pole = math.exp(-step / self.time_constant)
        share = (1.0 - pole) * self.time_constant / step  # mean of the decay over one step
        state, _ = lfilter([0.0, 1.0 - pole], [1.0, -pole], signal, axis=0, zi=0.0 * signal[:1])
        return np.asarray(signal + (state - signal) * share, dtype=np.float64)

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        return [
            Start({"time_constant": t}, grows=("time_constant",)) for t in (0.05 * at.time, 0.25 * at.time)
        ]


@register
class ActuatorDelay(_Drive):
    type = "actuator_delay"
    mechanism = "drive"
    equation = "I(t) = I_command(t - T)"
    source = "bus and drive latency"
    signature = "thrust late but not rounded"
    test = (
        "Command a step of current on the held device: the thrust must be nothing for {delay}, and then "
        "all there."
    )
    delay: float = parameter("s", 1e-3, 0.1)

    def apply(self, signal: Array, step: float) -> Array:
        return delayed(signal, self.delay / step, before=0.0)

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        return [Start({"delay": t}, grows=("delay",)) for t in (0.05 * at.time, 0.25 * at.time)]


#: order in which a drive's effects act, whatever the order in the model: bus, electric circuit, iron
DRIVE_ORDER = (ActuatorDelay, ActuatorLag, ThrustSaturation)
