"""The families: what stands on the bench, how it is driven, what is measured, and what may be hidden in it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from . import effects as fx
from . import half_car
from .bench import Drive, Rig, at_rest, rig_of
from .case import Family
from .draw import (
    amplitude,
    channel,
    element,
    excitation,
    held,
    log,
    mass,
    model,
    reading,
    rough,
    spring_damper,
    tempo,
)
from .effects import NOTHING, at, devices, play, unknown

if TYPE_CHECKING:
    from numpy.random import Generator

BASE, SOIL = ("mass", "base"), ("mass", "ground")


# ------------------------------------------------------------------------------------------------- on a shaken base
def shaken(r: Generator, sensors: str = "position") -> Rig:
    """A mass on a spring and damper over a moved base."""
    t, m, zeta = tempo(r, (20.0, 150.0)), mass(r), log(r, 0.02, 0.3)
    size = amplitude(r, t.omega)
    out = {
        "position": [reading(r, "displacement", "mass")],
        "travel": [reading(r, "displacement", "mass", "base")],
        "acceleration": [reading(r, "acceleration", "mass")],
        "both": [
            reading(r, "displacement", "mass", "base"),
            reading(r, "acceleration", "mass"),
        ],
    }
    sort = (
        sensors
        if sensors != "position"
        else str(r.choice(["position", "travel", "both"]))
    )
    elements = spring_damper("mass", "base", m, t.omega, zeta)
    net = model(
        "shaken",
        {"mass": m},
        elements,
        ["base displacement base"],
        out[sort],
    )
    drives = at_rest(excitation(r, t, size), "base")
    known = ("mass.mass",) if r.random() < 0.5 else ()
    return rig_of(net, drives, t, size, known, (BASE, SOIL))


def shaken2(r: Generator) -> Rig:
    """Two masses, one on the other, on a moved base, by accelerometers alone."""
    t, m = tempo(r, (25.0, 150.0), samples=(60.0, 200.0)), mass(r)
    upper, ratio = m * log(r, 0.2, 2.0), log(r, 1.3, 3.0)
    elements = [
        *spring_damper("lower", "base", m + upper, t.omega, log(r, 0.02, 0.15)),
        *spring_damper(
            "upper", "lower", upper, ratio * t.omega, log(r, 0.02, 0.12), "upper_"
        ),
    ]
    out = [reading(r, "acceleration", "lower"), reading(r, "acceleration", "upper")]
    size = amplitude(r, t.omega)
    net = model(
        "shaken2",
        {"lower": m, "upper": upper},
        elements,
        ["base displacement base"],
        out,
    )
    pairs = (("lower", "base"), ("upper", "lower"), ("lower", "ground"))
    return rig_of(
        net,
        at_rest(excitation(r, t, size, 0.3, 4.0), "base"),
        t,
        size,
        ("lower.mass", "upper.mass"),
        pairs,
    )


def three(r: Generator) -> Rig:
    """Three masses in a row from the ground, pushed at the first; two positions and an acceleration, or any of them."""
    t, m = tempo(r, (25.0, 120.0), samples=(80.0, 250.0)), mass(r)
    names, elements, masses = ["one", "two", "three"], [], {}
    below = "ground"
    for name in names:
        masses[name] = m * log(r, 0.4, 2.0)
        elements += spring_damper(
            name,
            below,
            masses[name],
            t.omega * log(r, 1.2, 2.5),
            log(r, 0.02, 0.1),
            f"{name}_",
        )
        below = name
    out = [
        reading(r, "displacement", "one"),
        reading(r, "displacement", "three", "two"),
        reading(r, "acceleration", "two"),
    ]
    keep = [o for o in out if r.random() < 0.75] or out
    size = amplitude(r, t.omega)
    push = size * sum(masses.values()) * t.omega**2 * 0.5
    net = model("three", masses, elements, ["push force one"], keep)
    pairs = (("one", "ground"), ("two", "one"), ("three", "two"))
    return rig_of(
        net,
        at_rest(excitation(r, t, push, 0.3, 3.0), "push"),
        t,
        size,
        ("one.mass",),
        pairs,
    )


# --------------------------------------------------------------------------------------------------- left to itself
def decay(r: Generator, bodies: int = 1) -> Rig:
    """A swing that dies away: no input; let go twice, from different places."""
    t, m = tempo(r, (8.0, 35.0), samples=(30.0, 120.0), size=(300, 6000)), mass(r)
    zeta, size = log(r, 0.001, 0.02), amplitude(r, t.omega)
    masses, elements = {"mass": m}, spring_damper("mass", "ground", m, t.omega, zeta)
    out = [reading(r, "displacement", "mass")]
    if r.random() < 0.4:
        out.append(reading(r, str(r.choice(["velocity", "acceleration"])), "mass"))
    pairs: tuple[tuple[str, str], ...] = (SOIL,)
    if bodies == 2:
        masses["second"] = m * log(r, 0.3, 1.5)
        elements += spring_damper(
            "second",
            "mass",
            masses["second"],
            t.omega * log(r, 1.0, 2.0),
            zeta,
            "second_",
        )
        out.append(reading(r, "displacement", "second"))
        pairs = (SOIL, ("second", "mass"))
    net = model("decay", masses, elements, [], out)
    drives = []
    for x in (1.5 * size, 1.5 * size * r.uniform(0.75, 1.2)):
        v = x * t.omega * r.uniform(-0.3, 0.3)
        drives.append(Drive({}, {n: (x * r.choice([1.0, -1.0]), v) for n in masses}))
    return rig_of(net, tuple(drives), t, size, ("mass.mass",), pairs)


def spin(r: Generator) -> Rig:
    """A flywheel running down in one record; its speed is measured."""
    size = int(log(r, 300, 6000))
    rate = log(r, 50.0, 1000.0)
    span, m, speed = size / rate, mass(r), log(r, 0.05, 50.0)
    tau = span * log(r, 0.4, 1.5)
    damper = element("linear_damping", "bearing", "rim", "ground", damping=m / tau)
    net = model("spin", {"rim": m}, [damper], [], [reading(r, "velocity", "rim")])
    return Rig(
        net,
        (Drive({}, {"rim": (0.0, speed)}),),
        size,
        float(f"{1 / rate:.3g}"),
        tau,
        0.4 * speed,
        ("rim.mass",),
        (("rim", "ground"),),
        (30.0, 60.0),
    )


# ----------------------------------------------------------------------------------------------------------- pushed
def resonator(r: Generator) -> Rig:
    """A slightly damped oscillator, pushed: what is small in force is large in motion."""
    t, m, zeta = (
        tempo(r, (60.0, 300.0), samples=(25.0, 70.0), size=(2000, 20000)),
        mass(r),
        log(r, 0.002, 0.015),
    )
    size = amplitude(r, t.omega)
    push = size * m * t.omega**2 * np.sqrt(zeta)
    sort = str(r.choice(["displacement", "displacement", "acceleration", "velocity"]))
    net = model(
        "resonator",
        {"mass": m},
        spring_damper("mass", "ground", m, t.omega, zeta),
        ["push force mass"],
        [reading(r, sort, "mass")],
    )
    signals = [
        rough(r, t, 0.3 * t.frequency, 2.0 * t.frequency, 0.0, push * k)
        for k in (1.0, log(r, 0.7, 1.3))
    ]
    return rig_of(net, at_rest(signals, "push"), t, size, (), (SOIL,))


def pushed(r: Generator) -> Rig:
    """A mass on a spring to the ground with a measured force on it; written as a rotation one time in three."""
    t, m, zeta = tempo(r, (15.0, 120.0)), mass(r), log(r, 0.03, 0.4)
    size = amplitude(r, t.omega)
    push = size * m * t.omega**2 * (0.3 + zeta)
    out = [
        reading(r, str(r.choice(["displacement", "acceleration", "velocity"])), "mass")
    ]
    if r.random() < 0.4 and out[0]["quantity"] != "displacement":
        out.append(reading(r, "displacement", "mass"))
    net = model(
        "pushed",
        {"mass": m},
        spring_damper("mass", "ground", m, t.omega, zeta),
        ["push force mass"],
        out,
    )
    return rig_of(net, at_rest(excitation(r, t, push), "push"), t, size, (), (SOIL,))


def cart(r: Generator) -> Rig:
    """A carriage that nothing holds: a motor's current or a force in, its position out, so it drifts."""
    t, m = tempo(r, (15.0, 80.0), samples=(40.0, 150.0)), mass(r)
    tau = log(r, 0.5, 6.0) / t.omega
    size = amplitude(r, t.omega)
    force = m * size * t.omega**2
    guide = element("linear_damping", "guide", "mass", "ground", damping=m / tau)
    out = [reading(r, "displacement", "mass")]
    if r.random() < 0.3:
        out.append(reading(r, "velocity", "mass"))
    if r.random() < 0.6:
        amperes = log(r, 0.2, 20.0)
        motor = element(
            "motor",
            "motor",
            "mass",
            "ground",
            thrust_constant=force / amperes,
            ratio=1.0,
        )
        signals = [
            held(r, t, log(r, 2.0, 8.0) / t.omega, amperes * k)
            for k in (1.0, log(r, 0.7, 1.3))
        ]
        net = model(
            "cart",
            {"mass": m},
            [guide, motor],
            [channel("current", "current", element="motor")],
            out,
        )
        drives = at_rest(signals, "current")
    else:
        net = model("cart", {"mass": m}, [guide], ["push force mass"], out)
        drives = at_rest(excitation(r, t, force, 0.1, 1.5), "push")
    return rig_of(net, drives, t, size, ("mass.mass",), (SOIL,))


# ------------------------------------------------------------------------------------------------- stroke in, force out
def dyno(r: Generator) -> Rig:
    """A damper on a test machine: its stroke goes in, the force of the load cell comes out."""
    t, m = tempo(r, (8.0, 80.0), samples=(60.0, 300.0)), mass(r)
    size = amplitude(r, t.omega)
    c = 2 * m * t.omega * log(r, 0.2, 2.0)
    elements = [element("linear_damping", "damper", "rod", "ground", damping=c)]
    if r.random() < 0.6:
        elements.append(
            element(
                "linear_stiffness",
                "gas",
                "rod",
                "ground",
                stiffness=c * t.omega * log(r, 0.1, 1.0),
            )
        )
    cell = (
        {**reading(r, "force", "rod"), "offset": "free"}
        if r.random() < 0.5
        else reading(r, "force", "rod")
    )
    net = model("dyno", {}, elements, ["stroke displacement rod"], [cell])
    signals = excitation(r, t, size, 0.2, 1.5)
    return rig_of(
        net, at_rest(signals, "stroke"), t, size, (), (("rod", "ground"),), (26.0, 50.0)
    )


ROD = ("rod", "ground")
LOWER, UPPER, FLOOR = ("lower", "base"), ("upper", "lower"), ("lower", "ground")
FAMILIES: dict[str, Family] = {
    "shaken": Family(
        shaken,
        {
            "none": NOTHING,
            **devices(
                SOIL, "friction", "quadratic", "cubic", "damping", suffix="_ground"
            ),
            **devices(
                BASE,
                "friction",
                "stribeck",
                "quadratic",
                "asymmetric",
                "cubic",
                "stop",
                "hysteresis",
                "inertance",
            ),
            "play": play("spring"),
            "unknown_tanh": unknown(fx.tanh_spring, BASE),
            "unknown_switched": unknown(fx.switched_spring, BASE),
            "unknown_timed_friction": unknown(fx.timed_friction, SOIL),
            "unknown_resonator": unknown(fx.resonator, BASE),
        },
    ),
    "shaken_acc": Family(
        lambda r: shaken(r, "acceleration"),
        {
            "none": NOTHING,
            **devices(SOIL, "friction", suffix="_ground"),
            **devices(BASE, "friction", "asymmetric", "cubic", "stop"),
            "unknown_position_damping": unknown(fx.position_damping, BASE),
        },
    ),
    "shaken2": Family(
        shaken2,
        {
            "none": NOTHING,
            **devices(
                UPPER, "friction", "asymmetric", "cubic", "stop", suffix="_upper"
            ),
            **devices(
                LOWER,
                "friction",
                "asymmetric",
                "quadratic",
                "hysteresis",
                suffix="_lower",
            ),
            **devices(FLOOR, "friction", "damping", suffix="_ground"),
            "gain": at("sensor_gain", fx.sensor_gain, "upper_acceleration"),
            "unknown_resonator": unknown(fx.resonator, ("upper", "lower")),
        },
    ),
    "three": Family(
        three,
        {
            "none": NOTHING,
            **devices(("two", "one"), "friction", "cubic", suffix="_middle"),
            **devices(("three", "two"), "friction", "asymmetric", suffix="_top"),
            **devices(("two", "ground"), "friction", suffix="_ground"),
            **devices(("one", "ground"), "quadratic", "stop", suffix="_foot"),
            "unknown_knocks": unknown(fx.knocks, ("three", "ground")),
        },
    ),
    "decay": Family(
        decay,
        {
            "none": NOTHING,
            **devices(SOIL, "friction", "quadratic", "cubic", "stop", "asymmetric"),
            "sine": at("cubic_stiffness", fx.sine, SOIL),
            "friction_and_sine": at("coulomb_friction", fx.coulomb, SOIL)
            & at("cubic_stiffness", fx.sine, SOIL),
            "drag_and_sine": at("quadratic_damping", fx.quadratic, SOIL)
            & at("cubic_stiffness", fx.sine, SOIL),
            "unknown_position_damping": unknown(fx.position_damping, SOIL),
            "unknown_resonator": unknown(fx.resonator, SOIL),
        },
    ),
    "decay2": Family(
        lambda r: decay(r, 2),
        {
            "none": NOTHING,
            **devices(SOIL, "friction"),
            **devices(("second", "mass"), "friction", "cubic", suffix="_second"),
        },
    ),
    "resonator": Family(
        resonator,
        {
            "none": NOTHING,
            **devices(SOIL, "cubic", "softening", "quadratic", "friction", "gas"),
            "unknown_switched": unknown(fx.switched_spring, SOIL),
        },
    ),
    "pushed": Family(
        pushed,
        {
            "none": NOTHING,
            **devices(
                SOIL,
                "friction",
                "stribeck",
                "quadratic",
                "cubic",
                "stop",
                "hysteresis",
                "gas",
            ),
            "delay": at("sensor_delay", fx.sensor_delay, fx.FIRST),
            "unknown_tanh": unknown(fx.tanh_spring, SOIL),
            "unknown_knocks": unknown(fx.knocks, SOIL),
        },
    ),
    "cart": Family(
        cart,
        {
            "none": NOTHING,
            **devices(
                SOIL,
                "friction",
                "stribeck",
                "quadratic",
                "cogging",
                "asymmetric",
                "stiffness",
            ),
            "unknown_timed_friction": unknown(fx.timed_friction, SOIL),
        },
    ),
    "spin": Family(
        spin, {"none": NOTHING, **devices(("rim", "ground"), "friction", "quadratic")}
    ),
    "dyno": Family(
        dyno,
        {
            "none": NOTHING,
            **devices(
                ROD,
                "friction",
                "stribeck",
                "asymmetric",
                "quadratic",
                "stop",
                "hysteresis",
                "cubic",
                "inertance",
            ),
            "unknown_position_damping": unknown(fx.position_damping, ROD),
            "unknown_timed_friction": unknown(fx.timed_friction, ROD),
        },
    ),
    "half_car": half_car.FAMILY,
}
