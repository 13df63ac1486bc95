"""Scales and signals: nothing a family draws is tied to a size of machine.

A rig gets a mass (a gram to five tonnes), a natural frequency, an amplitude, a sampling rate and a length, all of them
log-uniform; stiffness, damping, forces and what is hidden follow from those.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from .plant import Array, Element, Model, Signal

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.random import Generator


def log(r: Generator, low: float, high: float) -> float:
    """Log-uniform between two positive numbers."""
    return float(np.exp(r.uniform(np.log(low), np.log(high))))


@dataclass(frozen=True)
class Tempo:
    """Natural frequency [Hz], sampling interval [s], samples."""

    frequency: float
    interval: float
    size: int

    @property
    def omega(self) -> float:
        return 2 * np.pi * self.frequency

    @property
    def time(self) -> Array:
        return np.arange(self.size) * self.interval

    @property
    def span(self) -> float:
        return self.size * self.interval


def tempo(
    r: Generator,
    periods: tuple[float, float],
    samples: tuple[float, float] = (30.0, 150.0),
    size: tuple[int, int] = (300, 20000),
) -> Tempo:
    """A natural frequency such that `samples` of a period at 50 Hz to 5 kHz, and a record of so many `periods`."""
    per = log(r, *samples)
    count = int(np.clip(per * log(r, *periods), *size))
    rate = log(r, 50.0, 5000.0)
    digits = -int(np.floor(np.log10(1.0 / rate))) + 1
    return Tempo(rate / per, round(1.0 / rate, digits), count)


def amplitude(r: Generator, omega: float) -> float:
    """A displacement [m] at which nothing is faster than 5 m/s or is accelerated by more than 300 m/s^2."""
    return log(r, 3e-5, max(1e-4, min(0.3, 5.0 / omega, 300.0 / omega**2)))


def mass(r: Generator) -> float:
    return log(r, 1e-3, 5e3)


# -------------------------------------------------------------------------------------------------------- signals
def rough(
    r: Generator,
    t: Tempo,
    low: float,
    high: float,
    slope: float,
    size: float,
    lines: int = 60,
) -> Signal:
    """A sum of sines of random phase between two frequencies [Hz], amplitude as f^-slope, of RMS `size`."""
    low = max(low, 1.0 / t.span)
    f = np.sort(np.exp(r.uniform(np.log(low), np.log(max(high, 1.5 * low)), lines)))
    a = f**-slope * np.sqrt(np.gradient(f))
    return _sines(
        t.time,
        2 * np.pi * f,
        size * np.sqrt(2.0) * a / np.sqrt(np.sum(a**2)),
        r.uniform(0, 2 * np.pi, lines),
    )


def sweep(r: Generator, t: Tempo, low: float, high: float, size: float) -> Signal:
    """A sine whose frequency [Hz] goes from one to the other, exponentially, up or down."""
    low, high = (low, high) if r.random() < 0.7 else (high, low)
    rate = np.log(high / low) / t.span
    w = 2 * np.pi * low * np.exp(rate * t.time)
    phase = (w - 2 * np.pi * low) / rate + r.uniform(0, 2 * np.pi)
    a = size * np.sqrt(2.0)
    return Signal(
        a * np.sin(phase),
        a * w * np.cos(phase),
        a * (w * rate * np.cos(phase) - w**2 * np.sin(phase)),
    )


def tones(
    r: Generator, t: Tempo, low: float, high: float, size: float, count: int = 3
) -> Signal:
    f = np.exp(r.uniform(np.log(low), np.log(high), count))
    return _sines(
        t.time,
        2 * np.pi * f,
        size * np.sqrt(2.0 / count) * np.ones(count),
        r.uniform(0, 2 * np.pi, count),
    )


def _sines(t: Array, w: Array, a: Array, phase: Array) -> Signal:
    value, rate, second = np.zeros(len(t)), np.zeros(len(t)), np.zeros(len(t))
    for wi, ai, p in zip(w, a, phase, strict=True):
        s, c = ai * np.sin(wi * t + p), ai * np.cos(wi * t + p)
        value += s
        rate += wi * c
        second -= wi**2 * s
    return Signal(value, rate, second)


def held(r: Generator, t: Tempo, dwell: float, size: float) -> Signal:
    """A current that jumps between levels and stays for `dwell` [s] in the mean; of zero mean in the long run."""
    value, i = np.zeros(t.size), 0
    sign = 1.0
    while i < t.size:
        n = max(2, round(dwell * r.uniform(0.5, 1.5) / t.interval))
        value[i : i + n] = sign * size * r.uniform(0.4, 1.4)
        i, sign = i + n, -sign if r.random() < 0.8 else sign
    return Signal(value, 0 * value, 0 * value, held=True)


def strengthened(signal: Signal, factor: float) -> Signal:
    return Signal(
        signal.value * factor, signal.rate * factor, signal.second * factor, signal.held
    )


def excitation(
    r: Generator, t: Tempo, size: float, low: float = 0.25, high: float = 3.0
) -> list[Signal]:
    """Two records' signals about a natural frequency: rough, swept or a few tones; the second of another strength."""
    f, out = t.frequency, []
    for strength in (1.0, log(r, 0.7, 1.3)):
        sort = r.choice(["rough", "rough", "sweep", "tones"])
        if sort == "rough":
            s = rough(r, t, low * f, high * f, r.uniform(0.0, 1.5), size)
        elif sort == "sweep":
            s = sweep(r, t, low * f, high * f, size)
        else:
            s = tones(r, t, 0.5 * f, 1.6 * f, size, int(r.integers(2, 5)))
        out.append(strengthened(s, strength))
    return out


# --------------------------------------------------------------------------------------------------------- models
def element(
    kind: str, name: str, first: str, second: str, **parameters: float
) -> Element:
    return {"name": name, "type": kind, "between": [first, second], **parameters}


def spring_damper(
    first: str, second: str, m: float, omega: float, zeta: float, prefix: str = ""
) -> list[Element]:
    """A spring and a damper that give a mass `m` its natural frequency [rad/s] and damping ratio."""
    return [
        element(
            "linear_stiffness", f"{prefix}spring", first, second, stiffness=m * omega**2
        ),
        element(
            "linear_damping",
            f"{prefix}damper",
            first,
            second,
            damping=2 * zeta * m * omega,
        ),
    ]


UNIT = {
    "displacement": "m",
    "velocity": "m/s",
    "acceleration": "m/s^2",
    "angular_acceleration": "rad/s^2",
    "force": "N",
    "current": "A",
}


def _with_unit(given: Element | str) -> Element:
    if isinstance(given, str):
        name, quantity, *nodes = given.split()
        place = {"between": nodes} if nodes[1:] else {"at": nodes[0]}
        given = channel(name, quantity, **place)
    return {**given, "unit": UNIT[given["quantity"]]}


def model(
    name: str,
    masses: dict[str, float],
    elements: list[Element],
    inputs: Sequence[Element | str],
    outputs: Sequence[Element | str],
    bodies: dict[str, Any] | None = None,
) -> Model:
    """Return a model; a channel may be a text of its name, quantity and nodes ("travel displacement body wheel")."""
    return {
        "schema": "isd-model/1",
        "name": name,
        "masses": masses,
        **({"bodies": bodies} if bodies else {}),
        "elements": elements,
        "inputs": [_with_unit(c) for c in inputs],
        "outputs": [_with_unit(c) for c in outputs],
    }


def reading(
    r: Generator, quantity: str, node: str, other: str | None = None
) -> Element:
    """An output; a displacement has an unknown zero one time in three."""
    place = {"at": node} if other is None else {"between": [node, other]}
    out = {"name": f"{node}_{quantity}", "quantity": quantity, **place}
    return (
        {**out, "offset": "free"}
        if quantity == "displacement" and r.random() < 0.35
        else out
    )


def channel(name: str, quantity: str, **place: Any) -> Element:
    return {"name": name, "quantity": quantity, **place}
