"""The device's force rig, masses pushed and left alone, a strut on a machine, two masses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..families.draw import channel, model
from .secret import (
    FINE,
    Array,
    Element,
    Model,
    Secret,
    absorber,
    add,
    band_noise,
    element,
    relaxation,
    sensor,
    strange,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.random import Generator


# ---------------------------------------------------------------------------------------------- the force rig
def rig_base(r: Generator, secret: Secret) -> Model:
    elements = [
        element("linear_stiffness", "top", "piston", name="oil", stiffness=709000.0),
        element("inertance", *PISTON, name="inerter", inertance=95.0),
        element("linear_damping", *PISTON, name="leak", damping=1293.0),
        element("coulomb_friction", *PISTON, name="seal", level=500.0),
    ]
    inputs = [channel("displacement", "displacement", at="top")]
    outputs = [channel("force", "force", at="top")]
    return model("force-rig", {}, elements, inputs, outputs)


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
    "rig_quad": lambda r: add(
        "quadratic_damping", *PISTON, damping=r.uniform(4e3, 8e3)
    ),
    "rig_cogging": lambda r: add(
        "cogging_force",
        *PISTON,
        amplitude=r.uniform(80, 180),
        pitch=0.0059,
        phase=r.uniform(-np.pi, np.pi),
    ),
    "rig_asymmetric": lambda r: add(
        "asymmetric_damping", *PISTON, extension=0.0, compression=r.uniform(500, 900)
    ),
    "rig_bump": lambda r: add(
        "bump_stop",
        *PISTON,
        clearance=r.uniform(0.006, 0.009),
        stiffness=r.uniform(2e5, 5e5),
        damping=0.0,
        side="both",
    ),
    "rig_centring": lambda r: add(
        "linear_stiffness", *PISTON, stiffness=r.uniform(2e4, 5e4)
    ),
    "rig_hysteresis": lambda r: add(
        "hysteresis",
        *PISTON,
        level=r.uniform(200, 400),
        stiffness=r.uniform(1e5, 3e5),
        exponent=1.0,
        shape=0.5,
    ),
    "rig_sensor_gain": lambda r: sensor(
        "sensor_gain", "force", gain=1 + r.choice([-1, 1]) * r.uniform(0.12, 0.2)
    ),
    "rig_out_fading": lambda r: Secret(
        add=[
            element(
                "x_fading_damping", *PISTON, damping=1293.0, energy=r.uniform(600, 1200)
            )
        ],
        replace={"leak": {"type": "linear_damping", "damping": 1.0}},
        unknown=True,
    ),
    "rig_out_timed_friction": lambda r: strange(
        "x_timed_friction",
        *PISTON,
        level=r.uniform(300, 500),
        period=r.uniform(2.3, 3.7),
        duty=0.4,
    ),
}


def rig_nuisances(r: Generator) -> list[Element]:
    return [
        element("quadratic_damping", *PISTON, damping=r.uniform(70, 140)),
        element(
            "cogging_force",
            *PISTON,
            amplitude=r.uniform(4, 8),
            pitch=0.0059,
            phase=r.uniform(-np.pi, np.pi),
        ),
    ]


def rig_inputs(
    r: Generator, secret: Secret, size: int, validation: bool
) -> dict[str, Array]:
    """Triangles of 0.1 Hz, then sines of rising frequency; corners as round as a ram makes them."""
    t = np.arange(size) * FINE
    amplitude = 0.007 if validation else 0.010
    sines = (3.0, 5.0, 7.0, 9.0) if validation else (2.0, 4.0, 6.0, 8.0, 10.0)
    slow = 20.0 * t[-1] / 35.0
    x = amplitude * 2 / np.pi * np.arcsin(np.sin(2 * np.pi * 0.1 * t))
    each = (t[-1] - slow) / len(sines)
    for i, f in enumerate(sines):
        inside = t >= slow + i * each
        x = np.where(
            inside, amplitude * np.sin(2 * np.pi * f * (t - slow - i * each)), x
        )
    kernel = np.hanning(33)
    padded = np.concatenate([np.zeros(16), x, np.full(16, x[-1])])
    return {"displacement": np.convolve(padded, kernel / kernel.sum(), mode="valid")}


# --------------------------------------------------------------------------------------------- other networks
def mass_base(r: Generator, secret: Secret) -> Model:
    mass = r.uniform(20, 60)
    w = 2 * np.pi * r.uniform(1.5, 4.0)
    ratio = r.uniform(0.08, 0.2)
    elements = [
        element("linear_stiffness", *BODY, name="spring", stiffness=mass * w**2),
        element("linear_damping", *BODY, name="damper", damping=2 * ratio * mass * w),
    ]
    inputs = [channel("push", "force", at="mass")]
    outputs = [
        channel("position", "displacement", at="mass"),
        channel("acceleration", "acceleration", at="mass"),
    ]
    return model("one-mass", {"mass": mass}, elements, inputs, outputs)


def decay_base(r: Generator, secret: Secret) -> Model:
    model = mass_base(r, secret)
    model["name"], model["inputs"] = "free-decay", []
    model["elements"][1]["damping"] *= 0.3
    return model


def drive_base(r: Generator, secret: Secret) -> Model:
    """A strut in a testing machine: displacement in, force out, no free node."""
    elements = [
        element("linear_stiffness", *ROD, name="spring", stiffness=r.uniform(1e4, 3e4)),
        element("linear_damping", *ROD, name="damper", damping=r.uniform(800, 2000)),
        element("inertance", *ROD, name="inerter", inertance=r.uniform(10, 40)),
    ]
    inputs = [channel("stroke", "displacement", at="rod")]
    outputs = [channel("force", "force", at="rod")]
    return model("strut-on-machine", {}, elements, inputs, outputs)


def two_base(r: Generator, secret: Secret) -> Model:
    upper, lower = r.uniform(15, 30), r.uniform(30, 60)
    k1 = lower * (2 * np.pi * r.uniform(2, 3)) ** 2
    k2 = upper * (2 * np.pi * r.uniform(4, 6)) ** 2
    c1, c2 = 0.3 * np.sqrt(k1 * lower), 0.2 * np.sqrt(k2 * upper)
    elements = [
        element("linear_stiffness", *UPPER, name="spring", stiffness=k2),
        element("linear_damping", *UPPER, name="damper", damping=c2),
        element("linear_stiffness", *LOWER, name="foot", stiffness=k1),
        element("linear_damping", *LOWER, name="pad", damping=c1),
    ]
    inputs = [channel("push", "force", at="upper")]
    outputs = [
        channel("upper_acceleration", "acceleration", at="upper"),
        channel("lower_acceleration", "acceleration", at="lower"),
        channel("stroke", "displacement", between=["upper", "lower"]),
    ]
    masses = {"upper": upper, "lower": lower}
    return model("two-mass", masses, elements, inputs, outputs)


def push_inputs(
    r: Generator, secret: Secret, size: int, validation: bool
) -> dict[str, Array]:
    t = np.arange(size) * FINE
    push = 150.0 * band_noise(r, size, 0.5, 12.0)
    if validation:  # less noise, and a sweep
        f0, f1 = 0.5, 8.0
        phase = (
            2
            * np.pi
            * f0
            * t[-1]
            / np.log(f1 / f0)
            * (np.exp(t / t[-1] * np.log(f1 / f0)) - 1)
        )
        push = 0.5 * push + 100.0 * np.sin(phase)
    return {"push": secret.level * push}


def no_inputs(
    r: Generator, secret: Secret, size: int, validation: bool
) -> dict[str, Array]:
    return {}


def stroke_inputs(
    r: Generator, secret: Secret, size: int, validation: bool
) -> dict[str, Array]:
    if not validation:
        return {"stroke": 0.012 * band_noise(r, size, 0.3, 6.0, slope=0.5)}
    t = np.arange(size) * FINE
    return {
        "stroke": sum(
            a * np.sin(2 * np.pi * f * t + f)
            for a, f in ((0.015, 0.7), (0.006, 2.9), (0.002, 5.3))
        )
    }


@dataclass(frozen=True)
class Scale:
    """RMS motion and force between two terminals without the hidden effect: to draw visible ones."""

    d: float
    v: float
    force: float


def scaled(kind: str, where: tuple[str, str], r: Generator, s: Scale) -> Secret:
    share = r.uniform(0.15, 0.3) * s.force
    match kind:
        case "coulomb_friction":
            return add(kind, *where, level=share)
        case "stribeck_friction":
            return add(
                kind,
                *where,
                level=0.6 * share,
                static_level=1.8 * share,
                stribeck_velocity=0.4 * s.v,
            )
        case "quadratic_damping":
            return add(kind, *where, damping=1.5 * share / s.v**2)
        case "asymmetric_damping":
            return add(kind, *where, extension=2.0 * share / s.v, compression=0.0)
        case "cubic_stiffness":
            return add(kind, *where, stiffness=share / s.d**3)
        case "gas_spring":
            return add(kind, *where, force=8 * share, length=5.0 * s.d, exponent=1.3)
        case "bump_stop":
            return add(
                kind,
                *where,
                clearance=1.3 * s.d,
                stiffness=8 * share / s.d,
                damping=0.0,
                side="both",
            )
        case "hysteresis":
            return add(
                kind,
                *where,
                level=1.5 * share,
                stiffness=8 * share / s.d,
                exponent=1.0,
                shape=0.5,
            )
        case "inertance":
            return add(kind, *where, inertance=2.0 * share * s.d / s.v**2)
    raise ValueError(kind)


BODY, ROD, UPPER, LOWER = (
    ("mass", "ground"),
    ("rod", "ground"),
    ("upper", "lower"),
    ("lower", "ground"),
)
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
    "mass_sensor_delay": lambda r: sensor(
        "sensor_delay", "acceleration", delay=r.uniform(0.006, 0.012)
    ),
    "mass_out_mode": lambda r: absorber(r, "mass", r.uniform(2, 4), r.uniform(5, 7)),
    "mass_out_parametric": lambda r: strange(
        "x_parametric_stiffness",
        *BODY,
        stiffness=r.uniform(1500, 3000),
        frequency=r.uniform(0.3, 0.8),
    ),
    "decay_none": lambda r: Secret(),
    "drive_none": lambda r: Secret(),
    "drive_out_timed_friction": lambda r: strange(
        "x_timed_friction",
        *ROD,
        level=r.uniform(80, 140),
        period=r.uniform(2.3, 3.7),
        duty=0.4,
    ),
    "drive_out_relaxation": lambda r: relaxation(
        r, *ROD, r.uniform(1e4, 2e4), r.uniform(0.05, 0.2)
    ),
    "two_mass_none": lambda r: Secret(),
    "two_mass_out_mode": lambda r: absorber(
        r, "lower", r.uniform(3, 6), r.uniform(7, 10)
    ),
}
