"""Test records with a hidden effect: a seeded generator of rigs, made by `reference`, not by the kernel.

`make_case(kind, seed)` draws a true network, small unmodelled effects of a few per cent (nuisances), one
hidden effect or two or none, records of it with coloured noise, and the model as its owner believes it:
without the hidden effect and the nuisances, and with base parameters off by a few per cent. `ALL_KINDS` names
all kinds. Levels follow the shared blind rigs: 500 Hz, AR(1) noise of 26 to 40 dB, a road record imperfect by
0.2 %, the current held for 5 ms, another road with a bump for validation.

A force cell reads everything that acts between its terminals, so the record of an element's force holds the
effects that stand side by side with that element.
"""

from __future__ import annotations

import copy
import json
import zlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from reference import simulate
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

Array = NDArray[Any]
Model = dict[str, Any]
Element = dict[str, Any]

FINE = 1e-3
"""Interval at which the truth gets its inputs [s]; records keep every second sample."""
MAIN = {
    "linear_stiffness": "stiffness",
    "linear_damping": "damping",
    "inertance": "inertance",
    "coulomb_friction": "level",
}
"""The parameter of each type that the owner knows only roughly."""


@dataclass(frozen=True)
class Case:
    """One rig: what its owner has, and what was hidden."""

    kind: str
    seed: int
    model: Model
    """`isd-model/1`, as its owner believes it."""
    estimation: dict[str, Array]
    validation: dict[str, Array]
    answer: list[list[Any]] | str
    """Pairs of an effect's name and its terminals, or channel, or None where several places are the same;
    "unknown"; or empty where nothing is hidden. As in the shared blind rigs' `truth.json`."""
    truth: dict[str, Any]
    """`model`: the true network; `hidden`, `nuisances`: what of it the owner does not know."""
    snr_db: float
    spread: float
    visibility: dict[str, float]
    """RMS change of each channel that the hidden effect makes, in standard deviations of the noise."""

    @property
    def name(self) -> str:
        return f"{self.kind}_{self.seed:03d}"

    def record(self) -> dict[str, Any]:
        """The case's entry of a `truth.json`."""
        return {
            "kind": self.kind,
            "answer": self.answer,
            "truth": {"hidden": self.truth["hidden"], "nuisances": self.truth["nuisances"]},
            "snr_db": self.snr_db,
            "spread": self.spread,
            "visibility": [round(v, 2) for v in self.visibility.values()],
        }


@dataclass
class Secret:
    """What a kind hides: how the truth differs from the owner's network."""

    add: list[Element] = field(default_factory=list)
    """What the owner lacks: elements side by side with what stands there, or at a motor or channel."""
    drop: list[str] = field(default_factory=list)
    """Base elements that the owner lacks."""
    series: list[Element] = field(default_factory=list)
    """Elements put in series with the base elements named in `into`."""
    replace: dict[str, Element] = field(default_factory=dict)
    """Base elements that are of another type in truth."""
    masses: dict[str, float] = field(default_factory=dict)
    unknown: bool = False
    level: float = 1.0
    """Strength of the excitation."""
    passive: bool = False


def _e(kind: str, first: str, second: str, **parameters: Any) -> Element:
    return {"type": kind, "between": [first, second], **parameters}


def _add(kind: str, first: str, second: str, **parameters: float | str) -> Secret:
    return Secret(add=[{"type": kind, "between": [first, second], **parameters}])


def _motor(kind: str, **parameters: float) -> Secret:
    return Secret(add=[{"type": kind, "element": "motor", **parameters}])


def _sensor(kind: str, channel: str, **parameters: float) -> Secret:
    return Secret(add=[{"type": kind, "channel": channel, **parameters}])


def _both(*secrets: Secret) -> Secret:
    total = Secret(level=max(s.level for s in secrets))
    for s in secrets:
        total.add += s.add
        total.drop += s.drop
        total.series += s.series
        total.replace |= s.replace
    return total


def _absorber(r: Generator, at: str, mass: float, frequency: float) -> Secret:
    """A second body on a spring: a mode that no element between known nodes can make."""
    w = 2 * np.pi * frequency
    return Secret(
        add=[
            _e("linear_stiffness", "hidden_mass", at, stiffness=mass * w**2, name="hidden_spring"),
            _e(
                "linear_damping",
                "hidden_mass",
                at,
                damping=2 * r.uniform(0.03, 0.08) * mass * w,
                name="hidden_damper",
            ),
        ],
        masses={"hidden_mass": mass},
        unknown=True,
    )


def _relaxation(r: Generator, first: str, second: str, stiffness: float, time: float) -> Secret:
    """A Maxwell branch: spring and damper in series over a node that the owner does not have."""
    return Secret(
        add=[
            _e("linear_stiffness", first, "hidden_node", stiffness=stiffness, name="hidden_spring"),
            _e("linear_damping", "hidden_node", second, damping=stiffness * time, name="hidden_damper"),
        ],
        unknown=True,
    )


def _strange(kind: str, first: str, second: str, **parameters: float) -> Secret:
    secret = _add(kind, first, second, **parameters)
    secret.unknown = True
    return secret


# -------------------------------------------------------------------------------------------- the quarter car
def _car_base(r: Generator, _: Secret) -> Model:
    elements: list[Element] = [
        _e("linear_stiffness", "body", "wheel", name="main_spring", stiffness=22000.0),
        _e("linear_stiffness", "wheel", "road", name="tyre", stiffness=192000.0),
        _e("linear_stiffness", "body", "piston", name="oil", stiffness=709000.0),
        _e("inertance", "piston", "joint", name="inerter", inertance=95.0),
        _e("linear_damping", "piston", "joint", name="leak", damping=1293.0),
        _e("coulomb_friction", "piston", "joint", name="seal", level=500.0),
        _e("motor", "piston", "joint", name="motor", thrust_constant=60.0, ratio=4.056),
        _e("linear_damping", "joint", "wheel", name="damper", damping=1500.0),
    ]
    if r.random() < 0.3:
        elements.append(
            _e(
                "bump_stop",
                "piston",
                "joint",
                name="end_stop",
                clearance=0.02465,
                stiffness=1e6,
                damping=1000.0,
            )
        )
    return {
        "schema": "isd-model/1",
        "name": "quarter-car-isd",
        "masses": {"body": 345.0, "wheel": 45.0},
        "elements": elements,
        "inputs": [
            {"name": "road", "quantity": "displacement", "at": "road", "unit": "m"},
            {"name": "current", "quantity": "current", "element": "motor", "unit": "A"},
        ],
        "outputs": [
            {"name": "body_acceleration", "quantity": "acceleration", "at": "body", "unit": "m/s^2"},
            {
                "name": "suspension_travel",
                "quantity": "displacement",
                "between": ["body", "wheel"],
                "unit": "m",
            },
            {"name": "tyre_force", "quantity": "force", "element": "tyre", "unit": "N"},
            {
                "name": "device_travel",
                "quantity": "displacement",
                "between": ["piston", "joint"],
                "unit": "m",
            },
        ],
    }


DEVICE, STRUT, DAMPER, TYRE = ("piston", "joint"), ("body", "wheel"), ("joint", "wheel"), ("wheel", "road")


def _car_friction_device(r: Generator) -> Secret:
    return Secret(drop=["seal"])


def _car_stribeck_device(r: Generator) -> Secret:
    return Secret(
        replace={
            "seal": {
                "type": "stribeck_friction",
                "level": r.uniform(300, 420),
                "static_level": r.uniform(600, 800),
                "stribeck_velocity": r.uniform(0.03, 0.06),
            }
        }
    )


def _car_asymmetric(r: Generator) -> Secret:
    ratio = r.uniform(0.3, 0.6)  # damping in compression over damping in extension
    return _add("asymmetric_damping", *DAMPER, extension=0.0, compression=(ratio - 1) * 1500.0)


def _car_bump(r: Generator, side: str = "both") -> Secret:
    return _add(
        "bump_stop",
        *STRUT,
        clearance=r.uniform(0.014, 0.021),
        stiffness=r.uniform(8e4, 1.8e5),
        damping=0.0,
        side=side,
    )


def _car_hysteresis(r: Generator) -> Secret:
    return _add(
        "hysteresis", *STRUT, level=r.uniform(90, 160), stiffness=r.uniform(4e4, 8e4), exponent=1.0, shape=0.5
    )


def _car_lift_off(r: Generator) -> Secret:
    # The owner's spring pulls; the tyre does not, beyond the static load of about 3.8 kN.
    secret = _add("tyre_lift_off", *TYRE, stiffness=192000.0, load=r.uniform(0.75, 0.95) * 3826.0)
    secret.level = 5.0
    return secret


def _car_backlash(r: Generator) -> Secret:
    play = {"type": "backlash", "gap": r.uniform(0.002, 0.004), "stiffness": 5e6, "into": ["damper"]}
    return Secret(series=[play])


def _car_compliance(r: Generator) -> Secret:
    return Secret(
        series=[{"type": "series_compliance", "stiffness": r.uniform(4e4, 9e4), "into": ["damper"]}]
    )


CAR: dict[str, Callable[[Generator], Secret]] = {
    "none": lambda r: Secret(),
    "none_passive": lambda r: Secret(passive=True, level=2.0),
    "none_strong_road": lambda r: Secret(level=3.5),
    "friction_device": _car_friction_device,
    "friction_strut": lambda r: _add("coulomb_friction", *STRUT, level=r.uniform(70, 120)),
    "friction_damper": lambda r: _add("coulomb_friction", *DAMPER, level=r.uniform(100, 180)),
    "stribeck_device": _car_stribeck_device,
    "stribeck_strut": lambda r: _add(
        "stribeck_friction",
        *STRUT,
        level=r.uniform(50, 80),
        static_level=r.uniform(140, 220),
        stribeck_velocity=r.uniform(0.03, 0.06),
    ),
    "damping_strut": lambda r: _add("linear_damping", *STRUT, damping=r.uniform(150, 300)),
    "damping_tyre": lambda r: _add("linear_damping", *TYRE, damping=r.uniform(250, 450)),
    "stiffness_device": lambda r: _add("linear_stiffness", *DEVICE, stiffness=r.uniform(4e3, 9e3)),
    "inertance_strut": lambda r: _add("inertance", *STRUT, inertance=r.uniform(6, 14)),
    "quad_damping_device": lambda r: _add("quadratic_damping", *DEVICE, damping=r.uniform(6e3, 1.2e4)),
    "quad_damping_damper": lambda r: _add("quadratic_damping", *DAMPER, damping=r.uniform(1.2e3, 2.4e3)),
    "asym_damper": _car_asymmetric,
    "cubic_main": lambda r: _add("cubic_stiffness", *STRUT, stiffness=r.uniform(8e6, 1.8e7)),
    "gas_spring_main": lambda r: _add(
        "gas_spring", *STRUT, force=r.uniform(1500, 2500), length=r.uniform(0.14, 0.18), exponent=1.3
    ),
    "bump_stop": _car_bump,
    "bump_stop_compression": lambda r: _car_bump(r, "compression"),
    "bump_stop_device": lambda r: _add(
        "bump_stop",
        *DEVICE,
        clearance=r.uniform(0.010, 0.015),
        stiffness=r.uniform(2e5, 6e5),
        damping=0.0,
        side="both",
    ),
    "backlash_damper": _car_backlash,
    "compliance_damper": _car_compliance,
    "hysteresis_main": _car_hysteresis,
    "cogging": lambda r: _add(
        "cogging_force", *DEVICE, amplitude=r.uniform(110, 200), pitch=0.0059, phase=r.uniform(-np.pi, np.pi)
    ),
    "terminal_inertia": lambda r: _add(
        "terminal_inertia", *DEVICE, mass=r.uniform(20, 35), terminal="second"
    ),
    "tyre_lift_off": _car_lift_off,
    "thrust_droop": lambda r: _motor("thrust_saturation", current=r.uniform(3.0, 4.5)),
    "current_lag": lambda r: _motor("actuator_lag", time_constant=r.uniform(0.008, 0.02)),
    "current_delay": lambda r: _motor("actuator_delay", delay=r.uniform(0.006, 0.015)),
    "sensor_gain_acc": lambda r: _sensor(
        "sensor_gain", "body_acceleration", gain=1 + r.choice([-1, 1]) * r.uniform(0.1, 0.15)
    ),
    "sensor_gain_travel": lambda r: _sensor(
        "sensor_gain", "suspension_travel", gain=1 + r.choice([-1, 1]) * r.uniform(0.1, 0.15)
    ),
    "sensor_bias_travel": lambda r: _sensor(
        "sensor_bias", "suspension_travel", bias=r.choice([-1, 1]) * r.uniform(0.0015, 0.003)
    ),
    "sensor_delay_acc": lambda r: _sensor("sensor_delay", "body_acceleration", delay=r.uniform(0.004, 0.010)),
    "two_friction_strut_quad_device": lambda r: _both(
        CAR["friction_strut"](r), CAR["quad_damping_device"](r)
    ),
    "two_asym_bump": lambda r: _both(_car_asymmetric(r), _car_bump(r)),
    "two_lag_cubic": lambda r: _both(CAR["current_lag"](r), CAR["cubic_main"](r)),
    "two_gain_damping_tyre": lambda r: _both(CAR["sensor_gain_acc"](r), CAR["damping_tyre"](r)),
    "out_body_mode": lambda r: _absorber(r, "body", r.uniform(25, 40), r.uniform(4.5, 6.5)),
    "out_wheel_mode": lambda r: _absorber(r, "wheel", r.uniform(3, 6), r.uniform(11, 16)),
    "out_fading_damper": lambda r: Secret(
        add=[_e("x_fading_damping", *DAMPER, damping=1500.0, energy=r.uniform(1500, 3000))],
        replace={"damper": {"type": "linear_damping", "damping": 1.0}},
        unknown=True,
    ),
    "out_relaxation": lambda r: _relaxation(r, *STRUT, r.uniform(6e3, 1.2e4), r.uniform(0.08, 0.2)),
    "out_timed_friction": lambda r: _strange(
        "x_timed_friction", *STRUT, level=r.uniform(150, 250), period=r.uniform(2.0, 4.0), duty=0.4
    ),
    "out_position_damping": lambda r: _strange(
        "x_position_damping", *STRUT, damping=r.uniform(500, 900), length=0.012
    ),
    "out_parametric_spring": lambda r: _strange(
        "x_parametric_stiffness", *STRUT, stiffness=r.uniform(3500, 6000), frequency=r.uniform(0.3, 0.8)
    ),
}


def _car_nuisances(r: Generator) -> list[Element]:
    return [
        _e("cubic_stiffness", *STRUT, stiffness=r.uniform(2e5, 6e5)),
        _e("linear_damping", *TYRE, damping=r.uniform(8, 17)),
        _e("quadratic_damping", *DEVICE, damping=r.uniform(150, 240)),
        {"type": "thrust_saturation", "element": "motor", "current": r.uniform(25, 35)},
        _e("cogging_force", *DEVICE, amplitude=r.uniform(4, 9), pitch=0.0059, phase=r.uniform(-np.pi, np.pi)),
        _e("coulomb_friction", *STRUT, level=r.uniform(4, 8.5)),
        _e("asymmetric_damping", *DAMPER, extension=0.0, compression=-1500.0 * r.uniform(0.015, 0.035)),
    ]


def _band_noise(r: Generator, size: int, low: float, high: float, slope: float = 0.0) -> Array:
    """Gaussian noise of unit RMS between two frequencies [Hz], its amplitude as frequency**-slope."""
    f = np.fft.rfftfreq(2 * size, FINE)
    with np.errstate(divide="ignore"):
        shape = np.where(f > 0, f**-slope, 0.0) / (1 + (f / high) ** 8)
        shape[1:] /= 1 + (low / f[1:]) ** 4
    noise = np.fft.irfft(np.fft.rfft(r.standard_normal(2 * size)) * shape)[:size]
    return np.asarray(noise / np.sqrt(np.mean(noise**2)))


def _car_inputs(r: Generator, secret: Secret, size: int, validation: bool) -> dict[str, Array]:
    t = np.arange(size) * FINE
    # A random road as the paper prints it: slope white, one-sided displacement density 2 kappa u / f^2.
    kappa = secret.level * (r.uniform(0.5e-6, 1.0e-6) if validation else r.uniform(0.8e-6, 2.0e-6))
    variance = 2 * kappa * 20.0 / 0.3
    road = np.sqrt(variance) * _band_noise(r, size, 0.3, 40.0, slope=1.0)
    if validation:
        length, at = r.uniform(0.12, 0.3), t[-1] * r.uniform(0.3, 0.7)
        inside = np.abs(t - at) < length / 2
        road = road + r.uniform(0.025, 0.05) * np.where(inside, np.cos(np.pi * (t - at) / length) ** 4, 0.0)
    current = np.clip(r.uniform(1.6, 2.6) * _band_noise(r, size, 1.0, 11.0), -5, 5)
    hold = round(5e-3 / FINE)
    current = current[np.arange(size) // hold * hold]
    return {"road": road, "current": 0.0 * current if secret.passive else current}


# ---------------------------------------------------------------------------------------------- the force rig
def _rig_base(r: Generator, secret: Secret) -> Model:
    return {
        "schema": "isd-model/1",
        "name": "force-rig",
        "masses": {},
        "elements": [
            _e("linear_stiffness", "top", "piston", name="oil", stiffness=709000.0),
            _e("inertance", "piston", "ground", name="inerter", inertance=95.0),
            _e("linear_damping", "piston", "ground", name="leak", damping=1293.0),
            _e("coulomb_friction", "piston", "ground", name="seal", level=500.0),
        ],
        "inputs": [{"name": "displacement", "quantity": "displacement", "at": "top", "unit": "m"}],
        "outputs": [{"name": "force", "quantity": "force", "at": "top", "unit": "N"}],
    }


PISTON = ("piston", "ground")
RIG: dict[str, Callable[[Generator], Secret]] = {
    "rig_none": lambda r: Secret(),
    "rig_friction": lambda r: Secret(drop=["seal"]),
    "rig_damping": lambda r: Secret(drop=["leak"]),
    "rig_compliance": lambda r: Secret(drop=["oil"]),
    "rig_paper_story": lambda r: Secret(drop=["seal", "leak", "oil"]),
    "rig_stribeck": lambda r: Secret(
        replace={
            "seal": {
                "type": "stribeck_friction",
                "level": r.uniform(350, 450),
                "static_level": r.uniform(650, 850),
                "stribeck_velocity": r.uniform(0.03, 0.06),
            }
        }
    ),
    "rig_quad": lambda r: _add("quadratic_damping", *PISTON, damping=r.uniform(4e3, 8e3)),
    "rig_cogging": lambda r: _add(
        "cogging_force", *PISTON, amplitude=r.uniform(80, 180), pitch=0.0059, phase=r.uniform(-np.pi, np.pi)
    ),
    "rig_asymmetric": lambda r: _add(
        "asymmetric_damping", *PISTON, extension=0.0, compression=r.uniform(500, 900)
    ),
    "rig_bump": lambda r: _add(
        "bump_stop",
        *PISTON,
        clearance=r.uniform(0.006, 0.009),
        stiffness=r.uniform(2e5, 5e5),
        damping=0.0,
        side="both",
    ),
    "rig_centring": lambda r: _add("linear_stiffness", *PISTON, stiffness=r.uniform(2e4, 5e4)),
    "rig_hysteresis": lambda r: _add(
        "hysteresis",
        *PISTON,
        level=r.uniform(200, 400),
        stiffness=r.uniform(1e5, 3e5),
        exponent=1.0,
        shape=0.5,
    ),
    "rig_sensor_gain": lambda r: _sensor(
        "sensor_gain", "force", gain=1 + r.choice([-1, 1]) * r.uniform(0.12, 0.2)
    ),
    "rig_out_fading": lambda r: Secret(
        add=[_e("x_fading_damping", *PISTON, damping=1293.0, energy=r.uniform(600, 1200))],
        replace={"leak": {"type": "linear_damping", "damping": 1.0}},
        unknown=True,
    ),
    "rig_out_timed_friction": lambda r: _strange(
        "x_timed_friction", *PISTON, level=r.uniform(300, 500), period=r.uniform(2.3, 3.7), duty=0.4
    ),
}


def _rig_nuisances(r: Generator) -> list[Element]:
    return [
        _e("quadratic_damping", *PISTON, damping=r.uniform(70, 140)),
        _e("cogging_force", *PISTON, amplitude=r.uniform(4, 8), pitch=0.0059, phase=r.uniform(-np.pi, np.pi)),
    ]


def _rig_inputs(r: Generator, secret: Secret, size: int, validation: bool) -> dict[str, Array]:
    """Triangles of 0.1 Hz, then sines of rising frequency; corners as round as a ram makes them."""
    t = np.arange(size) * FINE
    amplitude = 0.007 if validation else 0.010
    sines = (3.0, 5.0, 7.0, 9.0) if validation else (2.0, 4.0, 6.0, 8.0, 10.0)
    slow = 20.0 * t[-1] / 35.0
    x = amplitude * 2 / np.pi * np.arcsin(np.sin(2 * np.pi * 0.1 * t))
    each = (t[-1] - slow) / len(sines)
    for i, f in enumerate(sines):
        inside = t >= slow + i * each
        x = np.where(inside, amplitude * np.sin(2 * np.pi * f * (t - slow - i * each)), x)
    kernel = np.hanning(33)
    padded = np.concatenate([np.zeros(16), x, np.full(16, x[-1])])
    return {"displacement": np.convolve(padded, kernel / kernel.sum(), mode="valid")}


# --------------------------------------------------------------------------------------------- other networks
def _mass_base(r: Generator, secret: Secret) -> Model:
    mass, frequency, ratio = r.uniform(20, 60), r.uniform(1.5, 4.0), r.uniform(0.08, 0.2)
    w = 2 * np.pi * frequency
    return {
        "schema": "isd-model/1",
        "name": "one-mass",
        "masses": {"mass": mass},
        "elements": [
            _e("linear_stiffness", "mass", "ground", name="spring", stiffness=mass * w**2),
            _e("linear_damping", "mass", "ground", name="damper", damping=2 * ratio * mass * w),
        ],
        "inputs": [{"name": "push", "quantity": "force", "at": "mass", "unit": "N"}],
        "outputs": [
            {"name": "position", "quantity": "displacement", "at": "mass", "unit": "m"},
            {"name": "acceleration", "quantity": "acceleration", "at": "mass", "unit": "m/s^2"},
        ],
    }


def _decay_base(r: Generator, secret: Secret) -> Model:
    model = _mass_base(r, secret)
    model["name"], model["inputs"] = "free-decay", []
    model["elements"][1]["damping"] *= 0.3
    return model


def _drive_base(r: Generator, secret: Secret) -> Model:
    """A strut in a testing machine: displacement in, force out, no free node."""
    return {
        "schema": "isd-model/1",
        "name": "strut-on-machine",
        "masses": {},
        "elements": [
            _e("linear_stiffness", "rod", "ground", name="spring", stiffness=r.uniform(1e4, 3e4)),
            _e("linear_damping", "rod", "ground", name="damper", damping=r.uniform(800, 2000)),
            _e("inertance", "rod", "ground", name="inerter", inertance=r.uniform(10, 40)),
        ],
        "inputs": [{"name": "stroke", "quantity": "displacement", "at": "rod", "unit": "m"}],
        "outputs": [{"name": "force", "quantity": "force", "at": "rod", "unit": "N"}],
    }


def _two_base(r: Generator, secret: Secret) -> Model:
    upper, lower = r.uniform(15, 30), r.uniform(30, 60)
    k1, k2 = lower * (2 * np.pi * r.uniform(2, 3)) ** 2, upper * (2 * np.pi * r.uniform(4, 6)) ** 2
    return {
        "schema": "isd-model/1",
        "name": "two-mass",
        "masses": {"upper": upper, "lower": lower},
        "elements": [
            _e("linear_stiffness", "upper", "lower", name="spring", stiffness=k2),
            _e("linear_damping", "upper", "lower", name="damper", damping=0.2 * np.sqrt(k2 * upper)),
            _e("linear_stiffness", "lower", "ground", name="foot", stiffness=k1),
            _e("linear_damping", "lower", "ground", name="pad", damping=0.3 * np.sqrt(k1 * lower)),
        ],
        "inputs": [{"name": "push", "quantity": "force", "at": "upper", "unit": "N"}],
        "outputs": [
            {"name": "upper_acceleration", "quantity": "acceleration", "at": "upper", "unit": "m/s^2"},
            {"name": "lower_acceleration", "quantity": "acceleration", "at": "lower", "unit": "m/s^2"},
            {"name": "stroke", "quantity": "displacement", "between": ["upper", "lower"], "unit": "m"},
        ],
    }


def _push_inputs(r: Generator, secret: Secret, size: int, validation: bool) -> dict[str, Array]:
    t = np.arange(size) * FINE
    push = 150.0 * _band_noise(r, size, 0.5, 12.0)
    if validation:  # less noise, and a sweep
        f0, f1 = 0.5, 8.0
        phase = 2 * np.pi * f0 * t[-1] / np.log(f1 / f0) * (np.exp(t / t[-1] * np.log(f1 / f0)) - 1)
        push = 0.5 * push + 100.0 * np.sin(phase)
    return {"push": secret.level * push}


def _no_inputs(r: Generator, secret: Secret, size: int, validation: bool) -> dict[str, Array]:
    return {}


def _stroke_inputs(r: Generator, secret: Secret, size: int, validation: bool) -> dict[str, Array]:
    if not validation:
        return {"stroke": 0.012 * _band_noise(r, size, 0.3, 6.0, slope=0.5)}
    t = np.arange(size) * FINE
    return {
        "stroke": sum(
            a * np.sin(2 * np.pi * f * t + f) for a, f in ((0.015, 0.7), (0.006, 2.9), (0.002, 5.3))
        )
    }


@dataclass(frozen=True)
class Scale:
    """RMS motion and force between two terminals without the hidden effect: to draw visible ones."""

    d: float
    v: float
    force: float


def _scaled(kind: str, where: tuple[str, str], r: Generator, s: Scale) -> Secret:
    share = r.uniform(0.15, 0.3) * s.force
    match kind:
        case "coulomb_friction":
            return _add(kind, *where, level=share)
        case "stribeck_friction":
            return _add(
                kind, *where, level=0.6 * share, static_level=1.8 * share, stribeck_velocity=0.4 * s.v
            )
        case "quadratic_damping":
            return _add(kind, *where, damping=1.5 * share / s.v**2)
        case "asymmetric_damping":
            return _add(kind, *where, extension=2.0 * share / s.v, compression=0.0)
        case "cubic_stiffness":
            return _add(kind, *where, stiffness=share / s.d**3)
        case "gas_spring":
            return _add(kind, *where, force=8 * share, length=5.0 * s.d, exponent=1.3)
        case "bump_stop":
            return _add(
                kind, *where, clearance=1.3 * s.d, stiffness=8 * share / s.d, damping=0.0, side="both"
            )
        case "hysteresis":
            return _add(kind, *where, level=1.5 * share, stiffness=8 * share / s.d, exponent=1.0, shape=0.5)
        case "inertance":
            return _add(kind, *where, inertance=2.0 * share * s.d / s.v**2)
    raise ValueError(kind)


BODY, ROD, UPPER, LOWER = ("mass", "ground"), ("rod", "ground"), ("upper", "lower"), ("lower", "ground")
SCALED: dict[str, tuple[str, tuple[str, str]]] = {
    **{
        f"mass_{label}": (kind, BODY)
        for label, kind in {
            "friction": "coulomb_friction",
            "stribeck": "stribeck_friction",
            "quad": "quadratic_damping",
            "asymmetric": "asymmetric_damping",
            "cubic": "cubic_stiffness",
            "bump": "bump_stop",
            "hysteresis": "hysteresis",
        }.items()
    },
    "decay_friction": ("coulomb_friction", BODY),
    "decay_quad": ("quadratic_damping", BODY),
    "decay_cubic": ("cubic_stiffness", BODY),
    **{
        f"drive_{label}": (kind, ROD)
        for label, kind in {
            "friction": "coulomb_friction",
            "asymmetric": "asymmetric_damping",
            "quad": "quadratic_damping",
            "cubic": "cubic_stiffness",
            "gas_spring": "gas_spring",
            "hysteresis": "hysteresis",
            "bump": "bump_stop",
        }.items()
    },
    "two_mass_friction": ("coulomb_friction", UPPER),
    "two_mass_friction_foot": ("coulomb_friction", LOWER),
    "two_mass_cubic": ("cubic_stiffness", UPPER),
    "two_mass_asymmetric": ("asymmetric_damping", UPPER),
    "two_mass_inertance": ("inertance", UPPER),
}
OTHER: dict[str, Callable[[Generator], Secret]] = {
    "mass_none": lambda r: Secret(),
    "mass_sensor_delay": lambda r: _sensor("sensor_delay", "acceleration", delay=r.uniform(0.006, 0.012)),
    "mass_out_mode": lambda r: _absorber(r, "mass", r.uniform(2, 4), r.uniform(5, 7)),
    "mass_out_parametric": lambda r: _strange(
        "x_parametric_stiffness", *BODY, stiffness=r.uniform(1500, 3000), frequency=r.uniform(0.3, 0.8)
    ),
    "decay_none": lambda r: Secret(),
    "drive_none": lambda r: Secret(),
    "drive_out_timed_friction": lambda r: _strange(
        "x_timed_friction", *ROD, level=r.uniform(80, 140), period=r.uniform(2.3, 3.7), duty=0.4
    ),
    "drive_out_relaxation": lambda r: _relaxation(r, *ROD, r.uniform(1e4, 2e4), r.uniform(0.05, 0.2)),
    "two_mass_none": lambda r: Secret(),
    "two_mass_out_mode": lambda r: _absorber(r, "lower", r.uniform(3, 6), r.uniform(7, 10)),
}

ALL_KINDS: list[str] = [*CAR, *RIG, *OTHER, *SCALED]
"""Every kind that `make_case` knows."""

Inputs = Callable[[Generator, Secret, int, bool], dict[str, Array]]
FAMILIES: dict[str, tuple[Callable[[Generator, Secret], Model], Inputs, float]] = {
    "car": (_car_base, _car_inputs, 20.0),
    "rig": (_rig_base, _rig_inputs, 35.0),
    "mass": (_mass_base, _push_inputs, 20.0),
    "decay": (_decay_base, _no_inputs, 8.0),
    "drive": (_drive_base, _stroke_inputs, 20.0),
    "two_mass": (_two_base, _push_inputs, 20.0),
}


def family(kind: str) -> str:
    """The network that a kind is about."""
    if kind in CAR:
        return "car"
    return next(name for name in ("rig", "mass", "decay", "drive", "two_mass") if kind.startswith(name + "_"))


# --------------------------------------------------------------------------------------------------- assembly
def _plus(model: Model, extra: Iterable[Element], prefix: str) -> list[Element]:
    """Append elements to a model, with names; returns what was appended."""
    added = []
    for i, e in enumerate(extra):
        named = {"name": f"{prefix}_{i + 1}", **copy.deepcopy(e)}
        model["elements"].append(named)
        added.append(named)
    return added


def _into_series(model: Model, e: Element, node: str) -> Element:
    """Put an element between the elements named in `into` and the first terminal that they share."""
    parameters = {k: v for k, v in e.items() if k != "into"}
    targets = [t for t in model["elements"] if t.get("name") in e["into"]]
    first = targets[0]["between"][0]
    for t in targets:
        t["between"] = [node, t["between"][1]]
    return {**parameters, "between": [first, node]}


def _without_node(model: Model, spring: str) -> None:
    """Take a series spring away: its two terminals become one."""
    e = next(e for e in model["elements"] if e["name"] == spring)
    keep, gone = e["between"]
    model["elements"].remove(e)
    for other in [*model["elements"], *model["outputs"]]:
        if "between" in other:
            other["between"] = [keep if n == gone else n for n in other["between"]]


def _ar1(r: Generator, size: int, deviation: float, memory: float = 0.4) -> Array:
    white = r.standard_normal(size + 50) * deviation * np.sqrt(1 - memory**2)
    return np.asarray(lfilter([1.0], [1.0, -memory], white)[50:])


def _run(
    model: Model, inputs: Mapping[str, Array], size: int, initial: dict[str, tuple[float, float]], step: float
) -> dict[str, Array]:
    t = np.arange(size) * FINE
    derivatives = {}
    for i in model["inputs"]:
        if i["quantity"] == "displacement":
            spline = CubicSpline(t, inputs[i["name"]])
            derivatives[i["name"]] = (spline(t, 1), spline(t, 2))
    cells = copy.deepcopy(model)
    for output in cells["outputs"]:
        if "element" in output:  # a force cell reads all that acts between its terminals
            at = next(e["between"] for e in model["elements"] if e.get("name") == output["element"])
            output["element"] = [e["name"] for e in model["elements"] if e.get("between") == at]
    return simulate(cells, t, inputs, step=step, initial=initial, derivatives=derivatives)


def make_case(
    kind: str,
    seed: int,
    *,
    duration: float | None = None,
    snr_db: float | None = None,
    spread: float | None = None,
    nuisances: int | None = None,
    moving: bool | None = None,
    step: float = 2e-5,
) -> Case:
    """One hidden-effect case; every choice that is not given is drawn from `seed`.

    kind: one of `ALL_KINDS`. duration: of each record [s]. snr_db: of each channel of the estimation record
    (validation has the same noise in absolute terms). spread: relative one-sided error of the owner's base
    parameters. nuisances: how many small effects the truth has besides. moving: whether records begin in
    mid-motion instead of at rest. step: of the reference simulator [s].
    """
    r = np.random.default_rng([zlib.crc32(kind.encode()), seed])
    group = family(kind)
    base, make_inputs, usual = FAMILIES[group]
    duration = usual if duration is None else duration
    snr_db = float(r.choice([26.0, 32.0, 40.0])) if snr_db is None else snr_db
    spread = float(r.choice([0.02, 0.05])) if spread is None else spread
    moving = bool(r.random() < 0.5) and group == "car" if moving is None else moving
    size = 2 * round(duration / FINE / 2) + 1
    lead = round(3.0 / FINE) if moving else 0
    plain = Secret()

    def initial(record: int) -> dict[str, tuple[float, float]]:
        return {"mass": ((0.03, 0.0), (-0.02, 0.15))[record]} if group == "decay" else {}

    base_model = base(r, plain)
    for e in base_model["elements"]:  # the rig at hand is not the textbook's
        if e["type"] in MAIN:
            e[MAIN[e["type"]]] *= 1 + 0.1 * r.uniform(-1, 1)
    for node in base_model["masses"]:
        base_model["masses"][node] *= 1 + 0.1 * r.uniform(-1, 1)
    streams = [r.spawn(1)[0] for _ in range(2)]
    draws = [copy.deepcopy(s.bit_generator.state) for s in streams]

    def inputs(secret: Secret) -> list[dict[str, Array]]:
        for s, state in zip(streams, draws, strict=True):
            s.bit_generator.state = copy.deepcopy(state)
        return [make_inputs(s, secret, size + lead, bool(i)) for i, s in enumerate(streams)]

    def base_element(name: str) -> Element:
        return next(e for e in base_model["elements"] if e["name"] == name)

    if kind in SCALED:
        effect, where = SCALED[kind]
        secret = _scaled(effect, where, r, _scale(base_model, where, inputs(plain)[0], size, initial(0)))
    else:
        secret = {**CAR, **RIG, **OTHER}[kind](r)
    for e in secret.add:
        if e["type"] == "tyre_lift_off":  # takes back what the linear tyre pulls
            e["stiffness"] = base_element("tyre")["stiffness"]
        if e["type"] == "x_fading_damping":  # all of the damper, and when cold as strong
            e["damping"] = base_element(*secret.replace)["damping"]
    driven = inputs(secret)

    # the truth
    true = copy.deepcopy(base_model)
    found: list[list[Any]] = []
    for name, other in secret.replace.items():
        e = next(e for e in true["elements"] if e["name"] == name)
        if not secret.unknown:
            found.append([other["type"], e["between"]])
        new = {"name": name, "between": e["between"], **other}
        e.clear()
        e.update(new)
    for name in secret.drop:
        e = next(e for e in true["elements"] if e["name"] == name)
        split = len(secret.drop) > 1 or name == "oil"
        found.append(["series_compliance" if name == "oil" else e["type"], None if split else e["between"]])
    true["masses"].update(secret.masses)
    hidden = _plus(true, secret.add, "hidden")
    for e in hidden:
        place = e.get("between") or e.get("channel")
        if "element" in e:
            place = next(m["between"] for m in true["elements"] if m["name"] == e["element"])
        found.append([e["type"], place])
    for i, e in enumerate(secret.series):
        hidden += _plus(true, [_into_series(true, e, f"hidden_node_{i + 1}")], f"series_{i + 1}")
        found.append([e["type"], None])
    answer: list[list[Any]] | str = "unknown" if secret.unknown else found
    pool = {"car": _car_nuisances, "rig": _rig_nuisances}.get(group, lambda r: [])(r)
    # a few per cent on a rough road as on a smooth one: motion goes with the root of its level
    for e in pool:
        power = {"cubic_stiffness": 1.0, "quadratic_damping": 0.5}.get(e["type"], 0.0)
        for key in ("stiffness", "damping"):
            if key in e:
                e[key] /= secret.level**power
    taken = {(e["type"], str(e.get("between") or e.get("element"))) for e in hidden}
    pool = [n for n in pool if (n["type"], str(n.get("between") or n.get("element"))) not in taken]
    count = (2 if group == "rig" else int(r.integers(2, 5))) if nuisances is None else nuisances
    chosen = r.permutation(len(pool))[: min(count, len(pool))]
    small = _plus(true, [pool[i] for i in sorted(chosen)], "nuisance")
    damper = next((e["between"] for e in true["elements"] if e.get("name") == "damper"), None)
    behind = [e for e in small if e.get("between") == list(DAMPER) and group == "car"]
    for e in behind:  # less damping is the damper's: on a massless node of its own it would push for ever
        e["between"] = list(damper or DAMPER)

    # the owner's model
    owner = copy.deepcopy(base_model)
    owner["uncertainty"] = {}
    for node in owner["masses"]:
        owner["masses"][node] *= 1 + spread * r.uniform(-1, 1)
        owner["uncertainty"][f"{node}.mass"] = spread
    for e in owner["elements"]:
        if e["type"] in MAIN and e["name"] not in secret.drop:
            e[MAIN[e["type"]]] *= 1 + spread * r.uniform(-1, 1)
            owner["uncertainty"][f"{e['name']}.{MAIN[e['type']]}"] = spread
    without = copy.deepcopy(true)  # the truth but for what is hidden
    without["elements"] = [
        e for e in without["elements"] if not str(e.get("name")).startswith(("hidden", "series"))
    ]
    for e in without["elements"]:
        if e.get("name") in {b["name"] for b in behind}:
            e["between"] = list(DAMPER)
    without["masses"] = {n: m for n, m in without["masses"].items() if n not in secret.masses}
    for e in without["elements"]:
        original = next((b for b in base_model["elements"] if b["name"] == e.get("name")), None)
        if original is not None:
            e.clear()
            e.update(copy.deepcopy(original))
    for m in (owner, without):
        for name in secret.drop:
            if name == "oil":
                _without_node(m, name)
            else:
                m["elements"] = [e for e in m["elements"] if e.get("name") != name]

    # the records
    outputs = [o["name"] for o in base_model["outputs"]]
    records: list[dict[str, Array]] = []
    noise: dict[str, float] = {}
    visibility: dict[str, float] = {}
    for i, u in enumerate(driven):
        y = {k: v[lead::2] for k, v in _run(true, u, size + lead, initial(i), step).items()}
        if i == 0:
            noise = {k: 10 ** (-snr_db / 20) * float(np.std(y[k])) for k in outputs}
            plainly = _run(without, u, size + lead, initial(i), step) if answer else None
            for k in outputs:
                change = (
                    0.0 if plainly is None else float(np.sqrt(np.mean((y[k] - plainly[k][lead::2]) ** 2)))
                )
                visibility[k] = change / noise[k]
        table = {"time": np.arange(len(y[outputs[0]])) * 2 * FINE}
        for item in base_model["inputs"]:
            column = u[item["name"]][lead::2]
            if item["quantity"] != "current":
                # what moves a machine is measured better than what moves a car
                imperfect = 1e-5 if group in ("rig", "drive") else 2e-3
                column = column + imperfect * np.std(column) * r.standard_normal(len(column))
            table[item["name"]] = column
        for k in outputs:
            table[k] = y[k] + _ar1(r, len(y[k]), noise[k])
        records.append(table)
    return Case(
        kind,
        seed,
        owner,
        records[0],
        records[1],
        answer,
        {"model": true, "hidden": hidden, "nuisances": small},
        snr_db,
        spread,
        visibility,
    )


def _scale(
    model: Model,
    where: tuple[str, str],
    inputs: dict[str, Array],
    size: int,
    initial: dict[str, tuple[float, float]],
) -> Scale:
    """How far and fast two terminals move without the hidden effect, and the force between them."""
    probe = copy.deepcopy(model)
    probe["outputs"] = [
        {"name": q, "quantity": q, "between": list(where)} for q in ("displacement", "velocity")
    ] + [
        {"name": e["name"], "quantity": "force", "element": e["name"]}
        for e in model["elements"]
        if e["between"] == list(where)
    ]
    y = _run(probe, inputs, size, initial, 1e-4)
    rms = {k: float(np.sqrt(np.mean(v**2))) for k, v in y.items()}
    d, v = rms.pop("displacement"), rms.pop("velocity")
    return Scale(d, v, max(rms.values()))


# ---------------------------------------------------------------------------------------------------- on disk
def save(cases: Iterable[Case], folder: Path | str) -> None:
    """Write cases as the shared blind rigs are: a folder each, and `truth.json`."""
    folder = Path(folder)
    truth = {}
    for case in cases:
        place = folder / case.name
        place.mkdir(parents=True, exist_ok=True)
        (place / "model.json").write_text(json.dumps(case.model, indent=1))
        for which, table in (("estimation", case.estimation), ("validation", case.validation)):
            np.savetxt(
                place / f"{which}.csv",
                np.column_stack(list(table.values())),
                fmt=["%.4f"] + ["%.6g"] * (len(table) - 1),
                delimiter=",",
                header=",".join(table),
                comments="",
            )
        truth[case.name] = case.record()
    (folder / "truth.json").write_text(json.dumps(truth, indent=1))
