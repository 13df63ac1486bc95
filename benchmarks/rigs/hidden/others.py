"""The device's force rig, masses pushed and left alone, a strut on a machine, two masses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..families.draw import model
from .secret import (
    FINE,
    Array,
    Draw,
    Model,
    Pair,
    Secret,
    absorber,
    add,
    band_noise,
    effect,
    element,
    fading,
    fault,
    relaxation,
    replaced,
    sensor_gain,
)

if TYPE_CHECKING:
    from numpy.random import Generator


# ---------------------------------------------------------------------------------------------- the force rig
def rig_base(r: Generator, secret: Secret) -> Model:
    elements = [
        element("linear_stiffness", "top", "piston", name="oil", stiffness=709000.0),
        element("inertance", *PISTON, name="inerter", inertance=95.0),
        element("linear_damping", *PISTON, name="leak", damping=1293.0),
        element("coulomb_friction", *PISTON, name="seal", level=500.0),
    ]
    inputs = ["displacement displacement top"]
    outputs = ["force force top"]
    return model("force-rig", {}, elements, inputs, outputs)


PISTON = ("piston", "ground")
RIG: dict[str, Draw] = {
    "rig_none": lambda r: Secret(),
    "rig_friction": lambda r: Secret(drop=["seal"]),
    "rig_damping": lambda r: Secret(drop=["leak"]),
    "rig_compliance": lambda r: Secret(drop=["oil"]),
    "rig_paper_story": lambda r: Secret(drop=["seal", "leak", "oil"]),
    "rig_stribeck": replaced("seal", "stribeck_friction", level=(350, 450), static_level=(650, 850), stribeck_velocity=(0.03, 0.06)),
    "rig_quad": effect("quadratic_damping", PISTON, damping=(4e3, 8e3)),
    "rig_cogging": effect("cogging_force", PISTON, amplitude=(80, 180), pitch=0.0059, phase=(-np.pi, np.pi)),
    "rig_asymmetric": effect("asymmetric_damping", PISTON, extension=0.0, compression=(500, 900)),
    "rig_bump": effect("bump_stop", PISTON, clearance=(0.006, 0.009), stiffness=(2e5, 5e5), damping=0.0, side="both"),
    "rig_centring": effect("linear_stiffness", PISTON, stiffness=(2e4, 5e4)),
    "rig_hysteresis": effect("hysteresis", PISTON, level=(200, 400), stiffness=(1e5, 3e5), exponent=1.0, shape=0.5),
    "rig_sensor_gain": sensor_gain("force", 0.12, 0.2),
    "rig_out_fading": fading("leak", PISTON, 1293.0, (600, 1200)),
    "rig_out_timed_friction": effect("x_timed_friction", PISTON, unknown=True, level=(300, 500), period=(2.3, 3.7), duty=0.4),
}  # fmt: skip
RIG_NUISANCES: list[Draw] = [
    effect("quadratic_damping", PISTON, damping=(70, 140)),
    effect("cogging_force", PISTON, amplitude=(4, 8), pitch=0.0059, phase=(-np.pi, np.pi)),
]  # fmt: skip


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
    inputs = ["push force mass"]
    outputs = [
        "position displacement mass",
        "acceleration acceleration mass",
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
    inputs = ["stroke displacement rod"]
    outputs = ["force force rod"]
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
    inputs = ["push force upper"]
    outputs = [
        "upper_acceleration acceleration upper",
        "lower_acceleration acceleration lower",
        "stroke displacement upper lower",
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


def scaled(kind: str, where: Pair, r: Generator, s: Scale) -> Secret:
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
SHORT = {
    "friction": "coulomb_friction",
    "stribeck": "stribeck_friction",
    "quad": "quadratic_damping",
    "asymmetric": "asymmetric_damping",
    "cubic": "cubic_stiffness",
    "gas_spring": "gas_spring",
    "bump": "bump_stop",
    "hysteresis": "hysteresis",
    "inertance": "inertance",
}


def _scaled(group: str, place: Pair, names: str) -> dict[str, tuple[str, Pair]]:
    return {f"{group}_{name}": (SHORT[name], place) for name in names.split()}


SCALED: dict[str, tuple[str, Pair]] = {
    **_scaled("mass", BODY, "friction stribeck quad asymmetric cubic bump hysteresis"),
    **_scaled("decay", BODY, "friction quad cubic"),
    **_scaled(
        "drive", ROD, "friction asymmetric quad cubic gas_spring hysteresis bump"
    ),
    **_scaled("two_mass", UPPER, "friction"),
    "two_mass_friction_foot": ("coulomb_friction", LOWER),
    **_scaled("two_mass", UPPER, "cubic asymmetric inertance"),
}
OTHER: dict[str, Draw] = {
    "mass_none": lambda r: Secret(),
    "mass_sensor_delay": fault("sensor_delay", channel="acceleration", delay=(0.006, 0.012)),
    "mass_out_mode": absorber("mass", (2, 4), (5, 7)),
    "mass_out_parametric": effect("x_parametric_stiffness", BODY, unknown=True, stiffness=(1500, 3000), frequency=(0.3, 0.8)),
    "decay_none": lambda r: Secret(),
    "drive_none": lambda r: Secret(),
    "drive_out_timed_friction": effect("x_timed_friction", ROD, unknown=True, level=(80, 140), period=(2.3, 3.7), duty=0.4),
    "drive_out_relaxation": relaxation(ROD, (1e4, 2e4), (0.05, 0.2)),
    "two_mass_none": lambda r: Secret(),
    "two_mass_out_mode": absorber("lower", (3, 6), (7, 10)),
}  # fmt: skip
