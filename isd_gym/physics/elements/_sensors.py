"""Effects of a sensor on its measured signal."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ._base import Element, Setting, Start, growing, parameter, plausible, register
from ._drives import delayed

if TYPE_CHECKING:
    from ..._common.arrays import Array
    from ..network import Network


#: largest plausible delay or advance of a channel [s]
LATEST = 0.3
#: largest negative noise of a magnitude, as a share of its largest value
NEGATIVE = 0.1


class _Sensor(Element):
    place = "channel"
    plane = "time"


class _ZeroSensor(_Sensor):
    """An effect at the zero of a sensor, absent from channels whose offset is a fitted parameter."""

    @classmethod
    def stands(cls, network: Network, where: tuple[str, ...]) -> bool:
        free = any(c.name == where[0] and c.offset for c in network.outputs)
        return not free and super().stands(network, where)


@register
class SensorGain(_Sensor):
    type = "sensor_gain"
    mechanism = "sensor"
    equation = "y = g y_true"
    source = "calibration error; Isermann, Fault-Diagnosis Systems (2006): beyond a factor of five a sensor is broken or in another unit"
    signature = "one channel off in proportion, all others right"
    test = "Put the sensor on a known input (a shaker, a gauge block): it must read {gain} times the truth."
    gain: float = plausible(
        parameter("-", 0.3, 3.0, default=1.0, minimum=-math.inf, spread=0.1), 0.2, 5.0
    )

    def apply(self, signal: Array, step: float) -> Array:
        return self.gain * signal

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        return [Start({"gain": 1.05}, signed=True)]

    @classmethod
    def sized(cls, start: Start, amplitude: Array) -> dict[str, float]:
        return {"gain": 1.0 + 0.05 * float(amplitude[0])}


@register
class SensorBias(_ZeroSensor):
    type = "sensor_bias"
    mechanism = "sensor"
    equation = "y = y_true + bias"
    source = "offset error"
    signature = "one channel off by a constant, all others right"
    test = "Read the sensor with the rig at rest: it must show {bias}."
    bias: float = parameter(
        "unit of the channel", -math.inf, math.inf, minimum=-math.inf
    )

    def apply(self, signal: Array, step: float) -> Array:
        return signal + self.bias

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        return [Start({"bias": 0.1 * at.signal}, grows=("bias",), signed=True)]


@register
class SensorDelay(_Sensor):
    type = "sensor_delay"
    mechanism = "sensor"
    equation = "y(t) = y_true(t - T); T < 0: the channel leads"
    source = (
        "filter or bus latency, 1 to 100 ms, up to 0.3 s over radio or video; a lead comes of time stamps that were corrected too far, "
        "or of inputs that are late themselves"
    )
    signature = "one channel late or early, all others right"
    test = "Tap the rig with two sensors at one place: this one must answer {delay} later (earlier, if negative)."
    delay: float = plausible(
        parameter("s", -0.1, 0.1, minimum=-math.inf, spread=0.03), -LATEST, LATEST
    )

    def apply(self, signal: Array, step: float) -> Array:
        return delayed(signal, self.delay / step)

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        return [Start({"delay": 0.1 * at.time}, grows=("delay",), signed=True)]


@register
class SensorMagnitude(_ZeroSensor):
    type = "sensor_magnitude"
    mechanism = "sensor"
    equation = "y = |y_true|"
    source = "tachometers and flow meters that count pulses; Doebelin, Measurement Systems (2003)"
    signature = (
        "one channel never below zero, with a kink wherever its quantity changes sign"
    )
    test = "Move the rig slowly one way and the other: the sensor must show the same sign both ways."

    def apply(self, signal: Array, step: float) -> Array:
        return np.abs(signal)

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        low, high = (
            np.quantile(at.samples, [0.001, 0.999])
            if at.samples is not None
            else (-1.0, 1.0)
        )
        # below zero only noise
        return [Start({}, signed=True)] if low > -NEGATIVE * high else []


@register
class SensorDeadZone(_ZeroSensor):
    type = "sensor_dead_zone"
    mechanism = "sensor"
    equation = "y = sgn(y_true) max(|y_true| - w, 0)"
    source = "Tao and Kokotovic, Adaptive Control of Systems with Actuator and Sensor Nonlinearities (1996)"
    signature = "one channel rests at zero while the others move"
    test = "Move the sensor slowly through its zero: it must show nothing until {width} on either side."
    shaped_by = "width"
    width: float = plausible(
        parameter("unit of the channel", 1e-6, 1e6, open_end=True), reach=20.0
    )

    def apply(self, signal: Array, step: float) -> Array:
        return np.asarray(
            signal - np.clip(signal, -self.width, self.width), dtype=np.float64
        )

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        if at.samples is None or not rests_at_zero(at.samples):
            return []
        return [growing(width=share * at.signal) for share in (0.1, 0.4)]


def rests_at_zero(samples: Array) -> bool:
    """Return whether a signal (n,) is near zero much more often than near the values beside zero."""
    size = np.abs(samples)
    near = 0.02 * float(np.quantile(size, 0.999))
    at_zero, beside = (
        np.mean(size < near),
        np.mean((size >= near) & (size < 4.0 * near)) / 3.0,
    )
    return bool(at_zero > 2.0 * beside)
