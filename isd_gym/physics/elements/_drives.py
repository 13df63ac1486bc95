"""Effects of a drive on its commanded current."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from ._base import (
    Element,
    Setting,
    Start,
    driven_motor,
    growing,
    parameter,
    plausible,
    register,
)

if TYPE_CHECKING:
    from ..._common.arrays import Array
    from ..network import Network


def delayed(values: Array, steps: float, before: float | None = None) -> Array:
    """Return a signal delayed by a number of samples, with linear interpolation.

    Args:
        values: Signal (n, ...).
        steps: Delay [samples], not necessarily an integer. A negative delay advances the signal, which is
            continued point-symmetrically beyond its end.
        before: Value before the first sample; None for the first value.

    Returns:
        Delayed signal (n, ...).
    """
    if steps < 0:
        ahead = min(math.ceil(-steps), len(values) - 1)
        longer = np.concatenate(
            [values, 2.0 * values[-1:] - values[-2 : -ahead - 2 : -1]]
        )
        part = ahead + steps if ahead == math.ceil(-steps) else 0.0
        whole = longer[ahead:]
        return (
            whole
            if part == 0.0
            else (1.0 - part) * whole + part * longer[ahead - 1 : -1]
        )
    low = math.floor(steps)
    part = steps - low
    first = np.repeat(
        values[:1] if before is None else np.full_like(values[:1], before),
        low + 1,
        axis=0,
    )
    longer = np.concatenate([first, values])[: len(values) + 1]
    return longer[1:] if part == 0.0 else (1.0 - part) * longer[1:] + part * longer[:-1]


class _Drive(Element):
    """An effect at a motor that a current drives; the current before the record is zero."""

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
    # below a twentieth of the start, about the deviation of the command, the drive would hardly follow the
    # command
    current: float = plausible(parameter("A", 1.0, 50.0, open_end=True), reach=20.0)

    def apply(self, signal: Array, step: float) -> Array:
        return np.asarray(
            self.current * np.tanh(signal / self.current), dtype=np.float64
        )

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        return [Start({"current": s * at.signal}) for s in (0.7, 1.2, 2.0, 4.0)]


@register
class ActuatorLag(_Drive):
    type = "actuator_lag"
    mechanism = "drive"
    equation = "tau dI/dt + I = I_command"
    source = "L/R of Table 1 (26 mH / 3.8 Ohm = 6.8 ms) or a drive's bandwidth; slow hydraulic drives reach 0.5 s"
    signature = "thrust late and rounded after a step in current"
    test = (
        "Command a step of current on the held device: the thrust must reach 63 % after {time_constant}, "
        "without a dead time."
    )
    time_constant: float = plausible(parameter("s", 1e-3, 0.1), 0.0, 0.5)

    def apply(self, signal: Array, step: float) -> Array:
        from scipy.signal import lfilter

        if not self.time_constant > 0:
            return signal
        pole = math.exp(-step / self.time_constant)
        share = (
            (1.0 - pole) * self.time_constant / step
        )  # mean of the decay over a step
        state, _ = lfilter(
            [0.0, 1.0 - pole], [1.0, -pole], signal, axis=0, zi=0.0 * signal[:1]
        )
        return np.asarray(signal + (state - signal) * share, dtype=np.float64)

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        return [growing(time_constant=t) for t in (0.05 * at.time, 0.25 * at.time)]


@register
class ActuatorDelay(_Drive):
    type = "actuator_delay"
    mechanism = "drive"
    equation = "I(t) = I_command(t - T)"
    source = "bus and drive latency: 1 to 20 ms on a field bus, up to 0.3 s over radio or a network"
    signature = "thrust late but not rounded"
    test = (
        "Command a step of current on the held device: the thrust must be nothing for {delay}, and then "
        "all there."
    )
    delay: float = plausible(parameter("s", 1e-3, 0.1), 0.0, 0.3)

    def apply(self, signal: Array, step: float) -> Array:
        return delayed(signal, self.delay / step, before=0.0)

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        return [growing(delay=t) for t in (0.05 * at.time, 0.25 * at.time)]


@register
class DriveDeadZone(_Drive):
    type = "drive_dead_zone"
    mechanism = "drive"
    equation = "I_eff = sgn(I) max(|I| - I_d, 0)"
    source = "overlap of a valve's spool (Merritt, Hydraulic Control Systems, 1967), dead time of an inverter"
    signature = "no thrust at small commands, whatever the motion; the thrust of large ones falls short by a constant"
    test = "Hold the device and raise the command slowly: there must be no thrust below {threshold}, in either direction."
    shaped_by = "threshold"
    threshold: float = plausible(parameter("A", 0.01, 5.0, open_end=True), reach=20.0)

    def apply(self, signal: Array, step: float) -> Array:
        return np.asarray(
            signal - np.clip(signal, -self.threshold, self.threshold), dtype=np.float64
        )

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        if at.samples is None or not has_levels(at.samples):
            return []
        return [growing(threshold=share * at.signal) for share in (0.1, 0.4)]


@register
class QuadraticThrust(_Drive):
    type = "quadratic_thrust"
    mechanism = "drive"
    equation = "I_eff = I |I| / I_r (form 'signed'), I^2 / I_r (form 'square')"
    source = "propellers and fans (thrust in proportion to the square of the speed), solenoids (of the current)"
    signature = "thrust grows with the square of the command: short of proportion below I_r, beyond it above"
    test = "Hold the device and double the command: the thrust must grow fourfold, and be that of the model at {reference}."
    shaped_by = "reference"
    choices: ClassVar[dict[str, tuple[str, ...]]] = {"form": ("signed", "square")}
    reference: float = plausible(parameter("A", 0.1, 50.0, open_end=True), reach=20.0)
    form: str = "signed"

    def apply(self, signal: Array, step: float) -> Array:
        other = np.abs(signal) if self.form == "signed" else signal
        return np.asarray(signal * other / self.reference, dtype=np.float64)

    @classmethod
    def variants(cls, network: Network, where: tuple[str, ...]) -> list[dict[str, str]]:
        return [{"form": form} for form in cls.choices["form"]]

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        if at.samples is None or not has_levels(at.samples):
            return []
        size = np.abs(at.samples)
        if (
            at.options["form"] == "square"
            and min(np.max(at.samples), -np.min(at.samples)) < 0.05 * size.max()
        ):
            return []  # for a command of one sign both forms are equal
        # the square law closest to proportionality over these commands
        nearest = float(np.sum(size**4) / np.sum(size**3))
        return [Start({"reference": share * nearest}) for share in (0.6, 1.0, 1.7)]


def has_levels(samples: Array) -> bool:
    """Return whether the magnitudes of a command (n,) differ; for a single magnitude every static law is only another constant."""
    size = np.abs(samples)
    sizes = size[size > 0.05 * size.max(initial=0.0)]
    return bool(len(sizes) and sizes.std() > 0.1 * sizes.mean())


#: order in which the effects of a drive act, in any model: bus, valve or amplifier, electric circuit, iron
DRIVE_ORDER = (
    ActuatorDelay,
    DriveDeadZone,
    ActuatorLag,
    QuadraticThrust,
    ThrustSaturation,
)
