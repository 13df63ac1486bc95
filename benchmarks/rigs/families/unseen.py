"""Families kept aside: new benches, and laws outside every library. They are run once, after all development.

Nothing may be developed on these. `KINDS` does not hold them; `benchmarks/diagnose.py --suite unseen --seeds N` runs them,
with a seed that has not been used before, and docs/validation/diagnosis.md says which seeds were.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from . import effects as fx
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
from .effects import NOTHING, Pair, Scale, Sized, at, devices, play, unknown

if TYPE_CHECKING:
    from numpy.random import Generator


# ------------------------------------------------------------------------------------- laws that no library here has
def wedge(r: Generator, s: Scale, place: Pair) -> Sized:
    """Friction wedges: what they hold grows with the square of the way out."""
    return lambda x: fx.link(
        "x_wedge_friction", place, slope=x * s.force / s.travel, length=s.travel
    )


def worn_guide(r: Generator, s: Scale, place: Pair) -> Sized:
    """A guide that rubs near its middle only."""
    width = r.uniform(0.4, 0.8) * s.travel
    return lambda x: fx.link(
        "x_bistable_friction", place, level=2.0 * x * s.force, width=width
    )


def shear_thinning(r: Generator, s: Scale, place: Pair) -> Sized:
    """Oil that thins with the rate: a damper until it is fast, and hardly more force from there on."""
    knee = r.uniform(0.3, 0.7) * s.rate
    return lambda x: fx.link(
        "x_shear_thinning", place, damping=2.0 * x * s.force / knee, velocity=knee
    )


def maxwell(r: Generator, s: Scale, place: Pair) -> Sized:
    """Rubber: a spring and a damper in line, over a point that is not in the model."""
    time = r.uniform(0.5, 2.0) * s.time
    return lambda x: fx.link(
        "x_maxwell", place, stiffness=2.0 * x * s.stiffness, time=time
    )


def fading(r: Generator, s: Scale, place: Pair) -> Sized:
    """Oil that warms up in use and thins."""
    turns = r.uniform(8.0, 25.0)

    def sized(x: float) -> fx.Change:
        work = x * s.damping * s.rate**2 * s.time * turns
        return fx.link(
            "x_fading_damping", place, damping=2.0 * x * s.damping, energy=work
        )

    return sized


# ------------------------------------------------------------------------------------------------------------ benches
HEAD, MOUNT = ("head", "ground"), ("rod", "head")


def press(r: Generator) -> Rig:
    """A test machine that works through an elastic mount on a heavy head which the specimen holds."""
    t, m = tempo(r, (10.0, 80.0), samples=(60.0, 250.0)), mass(r)
    zeta, size = log(r, 0.1, 0.6), amplitude(r, t.omega)
    elements = [
        element(
            "linear_stiffness",
            "mount",
            "rod",
            "head",
            stiffness=m * t.omega**2 * log(r, 2.0, 8.0),
        ),
        element(
            "linear_damping",
            "mount_loss",
            "rod",
            "head",
            damping=m * t.omega * log(r, 0.03, 0.2),
        ),
        element(
            "linear_damping",
            "specimen",
            "head",
            "ground",
            damping=2 * zeta * m * t.omega,
        ),
    ]
    out = [reading(r, "force", "rod")]
    if r.random() < 0.6:
        out.append(reading(r, str(r.choice(["displacement", "acceleration"])), "head"))
    net = model(
        "press",
        {"head": m},
        elements,
        ["stroke displacement rod"],
        out,
    )
    drives = at_rest(excitation(r, t, size, 0.2, 2.0), "stroke")
    pairs = (HEAD, MOUNT)
    return rig_of(net, drives, t, size, ("head.mass",), pairs, (28.0, 55.0))


BRIDGE, LOAD = ("bridge", "ground"), ("load", "bridge")


def gantry(r: Generator) -> Rig:
    """A bridge on rails, driven by a motor, with a load that swings on it."""
    t, m = tempo(r, (20.0, 90.0), samples=(60.0, 200.0)), mass(r)
    load, size = m * log(r, 0.2, 1.0), amplitude(r, t.omega)
    force, amperes = (m + load) * size * t.omega**2, log(r, 0.2, 20.0)
    elements = [
        element(
            "linear_damping",
            "rails",
            "bridge",
            "ground",
            damping=(m + load) * t.omega * log(r, 0.1, 1.0),
        ),
        element(
            "motor",
            "drive",
            "bridge",
            "ground",
            thrust_constant=force / amperes,
            ratio=1.0,
        ),
        *spring_damper("load", "bridge", load, t.omega, log(r, 0.01, 0.1), "rope_"),
    ]
    out = [reading(r, "displacement", "bridge"), reading(r, "acceleration", "load")]
    net = model(
        "gantry",
        {"bridge": m, "load": load},
        elements,
        [channel("current", "current", element="drive")],
        out,
    )
    signals = [
        held(r, t, log(r, 2.0, 8.0) / t.omega, amperes * k)
        for k in (1.0, log(r, 0.7, 1.3))
    ]
    return rig_of(
        net, at_rest(signals, "current"), t, size, ("bridge.mass",), (BRIDGE, LOAD)
    )


RIM, HUB = ("rim", "hub"), ("hub", "ground")


def coast(r: Generator) -> Rig:
    """Two wheels on a soft shaft run down together in one record, ringing against each other."""
    t, m = tempo(r, (15.0, 60.0), samples=(30.0, 100.0), size=(600, 9000)), mass(r)
    hub, speed = m * log(r, 0.3, 1.0), log(r, 0.05, 50.0)
    tau = t.span * log(r, 0.4, 1.5)
    elements = [
        element("linear_damping", "bearing", "hub", "ground", damping=(m + hub) / tau),
        *spring_damper("rim", "hub", m, t.omega, log(r, 0.003, 0.02), "shaft_"),
    ]
    out = [reading(r, "velocity", "hub"), reading(r, "velocity", "rim")]
    start = {
        "hub": (0.0, speed),
        "rim": (0.3 * speed / t.omega, speed * r.uniform(0.8, 1.2)),
    }
    net = model("coast", {"rim": m, "hub": hub}, elements, [], out)
    return Rig(
        net,
        (Drive({}, start),),
        t.size,
        t.interval,
        1 / t.omega,
        0.4 * speed,
        ("rim.mass",),
        (RIM, HUB),
        (30.0, 60.0),
    )


TABLE, FLOOR = ("table", "base"), ("table", "ground")


def isolator(r: Generator) -> Rig:
    """A table on mounts over a shaking floor that is pushed as well: two inputs; the floor's force is measured too."""
    t, m = tempo(r, (20.0, 120.0), samples=(40.0, 160.0)), mass(r)
    size, zeta = amplitude(r, t.omega), log(r, 0.03, 0.3)
    out = [reading(r, "acceleration", "table"), reading(r, "force", "base")]
    if r.random() < 0.5:
        out.append(reading(r, "displacement", "table", "base"))
    inputs = [
        "base displacement base",
        "push force table",
    ]
    net = model(
        "isolator",
        {"table": m},
        spring_damper("table", "base", m, t.omega, zeta),
        inputs,
        out,
    )
    shakes, push = excitation(r, t, size), m * size * t.omega**2 * (0.2 + zeta)
    pushes = [
        rough(r, t, 0.3 * t.frequency, 2.0 * t.frequency, 0.5, push) for _ in shakes
    ]
    drives = tuple(
        Drive({"base": s, "push": p}, {}) for s, p in zip(shakes, pushes, strict=True)
    )
    return rig_of(net, drives, t, size, (), (TABLE, FLOOR))


SLIDE = ("slide", "ground")


def dry(r: Generator) -> Rig:
    """A slide on a spring whose dry friction is known, as a level: what is missing stands beside it."""
    t, m = tempo(r, (15.0, 100.0)), mass(r)
    size, zeta = amplitude(r, t.omega), log(r, 0.03, 0.2)
    push = size * m * t.omega**2 * (0.4 + zeta)
    elements = spring_damper("slide", "ground", m, t.omega, zeta)
    elements.append(
        element(
            "coulomb_friction",
            "seal",
            "slide",
            "ground",
            level=push * log(r, 0.1, 0.35),
        )
    )
    out = [reading(r, str(r.choice(["displacement", "velocity"])), "slide")]
    net = model("dry", {"slide": m}, elements, ["push force slide"], out)
    drives = at_rest(excitation(r, t, push), "push")
    return rig_of(net, drives, t, size, (), (SLIDE,))


LEFT, RIGHT = ("left", "ground"), ("right", "left")


def pair(r: Generator) -> Rig:
    """Two slightly damped masses in a row, struck at the second and left to ring; positions of both or of one."""
    t, m = tempo(r, (20.0, 80.0), samples=(50.0, 120.0), size=(800, 12000)), mass(r)
    other, size = m * log(r, 0.3, 1.5), amplitude(r, t.omega)
    elements = [
        *spring_damper("left", "ground", m, t.omega, log(r, 0.003, 0.02), "left_"),
        *spring_damper(
            "right",
            "left",
            other,
            t.omega * log(r, 0.8, 2.0),
            log(r, 0.003, 0.02),
            "right_",
        ),
    ]
    out = [reading(r, "displacement", "left"), reading(r, "displacement", "right")]
    keep = [out[1]] if r.random() < 0.4 else out
    drives = []
    for x in (1.5 * size, 1.5 * size * r.uniform(0.8, 1.25)):
        drives.append(
            Drive(
                {},
                {
                    "left": (0.3 * x, 0.0),
                    "right": (-x, x * t.omega * r.uniform(-0.3, 0.3)),
                },
            )
        )
    net = model("pair", {"left": m, "right": other}, elements, [], keep)
    return rig_of(net, tuple(drives), t, size, ("left.mass",), (LEFT, RIGHT))


UNSEEN: dict[str, Family] = {
    "press": Family(
        press,
        {
            "none": NOTHING,
            **devices(
                HEAD,
                "friction",
                "quadratic",
                "asymmetric",
                "stop",
                "cogging",
                "stiffness",
            ),
            **devices(MOUNT, "cubic", "hysteresis", suffix="_mount"),
            "play": play("mount"),
            "unknown_shear": unknown(shear_thinning, HEAD),
        },
    ),
    "gantry": Family(
        gantry,
        {
            "none": NOTHING,
            **devices(BRIDGE, "friction", "stribeck", "quadratic", "asymmetric"),
            **devices(LOAD, "friction", "cubic", suffix="_load"),
            "lag": at("actuator_lag", fx.lag, "drive"),
            "droop": at("thrust_saturation", fx.saturation, "drive"),
            "unknown_worn_guide": unknown(worn_guide, BRIDGE),
        },
    ),
    "coast": Family(
        coast,
        {
            "none": NOTHING,
            **devices(HUB, "friction", "quadratic"),
            **devices(RIM, "cubic", "friction", suffix="_shaft"),
        },
    ),
    "isolator": Family(
        isolator,
        {
            "none": NOTHING,
            **devices(TABLE, "friction", "stribeck", "gas", "stop", "hysteresis"),
            **devices(FLOOR, "friction", "damping", suffix="_ground"),
            "gain": at("sensor_gain", fx.sensor_gain, "table_acceleration"),
            "friction_and_stop": at("coulomb_friction", fx.coulomb, FLOOR)
            & at("bump_stop", fx.stop, TABLE),
            "unknown_maxwell": unknown(maxwell, TABLE),
            "unknown_wedge": unknown(wedge, TABLE),
        },
    ),
    "dry": Family(
        dry,
        {
            "none": NOTHING,
            **devices(
                SLIDE, "quadratic", "cubic", "stop", "asymmetric", "gas", "cogging"
            ),
            "unknown_fading": unknown(fading, SLIDE),
        },
    ),
    "pair": Family(
        pair,
        {
            "none": NOTHING,
            **devices(LEFT, "friction", "cubic", "quadratic"),
            **devices(RIGHT, "friction", "softening", suffix="_right"),
            "unknown_worn_guide": unknown(worn_guide, LEFT),
        },
    ),
}
