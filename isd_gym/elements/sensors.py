"""What a sensor makes of the signal that it is to report."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from .base import Array, Element, Setting, Start, parameter, register
from .drives import delayed

if TYPE_CHECKING:
    from ..network import Network


class _Sensor(Element):
    place = "channel"
    plane = "time"


@register
class SensorGain(_Sensor):
    type = "sensor_gain"
    mechanism = "sensor"
    equation = "y = g y_true"
    source = "calibration error"
    signature = "one channel off in proportion, all others right"
    test = "Put the sensor on a known input (a shaker, a gauge block): it must read {gain} times the truth."
    gain: float = parameter("-", 0.3, 3.0, default=1.0, minimum=-math.inf, spread=0.1)

    def apply(self, signal: Array, step: float) -> Array:
        return self.gain * signal

    def fault(self, time: float) -> float:
        return abs(self.gain - 1.0)

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        return [Start({"gain": 1.05}, signed=True)]

    @classmethod
    def sized(cls, start: Start, amplitude: Array) -> dict[str, float]:
        return {"gain": 1.0 + 0.05 * float(amplitude[0])}

    @classmethod
    def grown(cls, start: Start, factor: float) -> dict[str, float]:
        return {"gain": 1.0 + 0.05 * factor}


@register
class SensorBias(_Sensor):
    type = "sensor_bias"
    mechanism = "sensor"
    equation = "y = y_true + bias"
    source = "offset error"
    signature = "one channel off by a constant, all others right"
    test = "Read the sensor with the rig at rest: it must show {bias}."
    bias: float = parameter("unit of the channel", -math.inf, math.inf, minimum=-math.inf)

    def apply(self, signal: Array, step: float) -> Array:
        return signal + self.bias

    @classmethod
    def stands(cls, network: Network, where: tuple[str, ...]) -> bool:
        free = any(c.name == where[0] and c.offset for c in network.outputs)  # fitted already
        return not free and super().stands(network, where)

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        return [Start({"bias": 0.1 * at.signal}, grows=("bias",), signed=True)]


@register
class SensorDelay(_Sensor):
    type = "sensor_delay"
    mechanism = "sensor"
    equation = "y(t) = y_true(t - T)"
    source = "filter or bus latency"
    signature = "one channel late, all others right"
    test = "Tap the rig with two sensors at one place: this one must answer {delay} later."
    delay: float = parameter("s", 1e-3, 0.1)

    def apply(self, signal: Array, step: float) -> Array:
        return delayed(signal, self.delay / step)

    def fault(self, time: float) -> float:
        return self.delay / time

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        return [Start({"delay": t}, grows=("delay",)) for t in (0.05 * at.time, 0.25 * at.time)]
