"""The half car: a body that heaves and pitches on two axles, over a road that the front axle meets first.

The owner has accelerometers on the body and on the wheels, and the travel of both suspensions; the wheels were weighed. What is hidden sits at one
axle, or in the sensor of one: the answer is the effect at the right corner.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from . import effects as fx
from .bench import Drive, Rig
from .case import Family
from .draw import Tempo, channel, element, log, model, rough, strengthened
from .effects import NOTHING, Hidden, Shape, at, devices
from .plant import Signal

if TYPE_CHECKING:
    from numpy.random import Generator

    from .effects import Pair
    from .plant import Element

INTERVAL = 0.005
"""Sampling interval [s] of the records."""
SIZE = 2000
"""Samples of a record: ten seconds."""
ENDS = ("front", "rear")
FRONT, REAR = (("body_" + end, "wheel_" + end) for end in ENDS)
TYRE_FRONT, TYRE_REAR = (("wheel_" + end, "road_" + end) for end in ENDS)


def half_car(r: Generator) -> Rig:
    """A passenger car's half: body frequencies of 1.0 to 1.6 Hz, wheels near 10 Hz."""
    body, base = log(r, 400.0, 1200.0), r.uniform(2.4, 3.0)
    front = base * r.uniform(0.42, 0.54)
    arms = {"front": front, "rear": front - base}
    inertia = body * front * (base - front) * r.uniform(0.8, 1.05)
    elements: list[Element] = []
    masses, omega = {}, 2 * np.pi * r.uniform(1.0, 1.35)
    for end, other in (ENDS, ENDS[::-1]):
        load = body * abs(arms[other]) / base  # what the axle carries of the body
        own = omega * (
            1.0 if end == "front" else r.uniform(1.05, 1.2)
        )  # the rear axle swings faster
        masses[f"wheel_{end}"] = load * r.uniform(0.1, 0.15)
        spring, tyre = load * own**2, load * own**2 * r.uniform(7.0, 11.0)
        elements += [
            element(
                "linear_stiffness",
                f"spring_{end}",
                f"body_{end}",
                f"wheel_{end}",
                stiffness=spring,
            ),
            element(
                "linear_damping",
                f"damper_{end}",
                f"body_{end}",
                f"wheel_{end}",
                damping=2 * r.uniform(0.2, 0.35) * load * own,
            ),
            element(
                "linear_stiffness",
                f"tyre_{end}",
                f"wheel_{end}",
                f"road_{end}",
                stiffness=tyre,
            ),
        ]
    points = {f"body_{end}": {"x": arm} for end, arm in arms.items()}
    net = model(
        "half_car",
        masses,
        elements,
        [f"road_{end} displacement road_{end}" for end in ENDS],
        sensors(r),
        {"body": {"mass": body, "inertia": {"pitch": inertia}, "points": points}},
    )
    t = Tempo(omega / (2 * np.pi), INTERVAL, SIZE)
    size = r.uniform(0.006, 0.012)
    drives = tuple(drive(r, t, base, size * k) for k in (1.0, log(r, 0.7, 1.3)))
    pairs = (FRONT, REAR, TYRE_FRONT, TYRE_REAR)
    weighed = tuple(f"{wheel}.mass" for wheel in masses)
    return Rig(
        net,
        drives,
        t.size,
        t.interval,
        1 / omega,
        0.1,
        weighed,
        pairs,
        (28.0, 50.0),
        60.0,
    )


def sensors(r: Generator) -> list[Element | str]:
    """The body's accelerations at its ends, or of its centre and its pitch; travels and wheels' accelerations."""
    if r.random() < 0.5:
        out = [f"body_acceleration_{end} acceleration body_{end}" for end in ENDS]
    else:
        pitch = {"body": "body", "axis": "pitch"}
        out = [
            "body_acceleration acceleration body",
            channel("pitch_acceleration", "angular_acceleration", **pitch),
        ]
    for end in ENDS:
        out.append(f"travel_{end} displacement body_{end} wheel_{end}")
        out.append(f"wheel_acceleration_{end} acceleration wheel_{end}")
    return out


def drive(r: Generator, t: Tempo, base: float, size: float) -> Drive:
    """From a flat road onto a rough one, its height of RMS `size` [m]; the rear axle meets it wheelbase over speed later."""
    late = max(1, round(base / r.uniform(12.0, 30.0) / t.interval))
    longer = Tempo(t.frequency, t.interval, t.size + late)
    road = faded(strengthened(rough(r, longer, 0.4, 15.0, 1.0, 1.0), size), longer, 0.5)

    def part(lead: int) -> Signal:
        return Signal(
            *(
                np.concatenate([np.zeros(lead), q[: t.size - lead]])
                for q in (road.value, road.rate, road.second)
            )
        )

    return Drive({"road_front": part(0), "road_rear": part(late)}, {})


def faded(signal: Signal, t: Tempo, span: float) -> Signal:
    """The signal, grown from rest over `span` [s] with a smooth second derivative at both ends."""
    s = np.clip(t.time / span, 0.0, 1.0)
    grown = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    rate = 30.0 * s**2 * (1.0 - s) ** 2 / span
    second = 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / span**2
    return Signal(
        signal.value * grown,
        signal.rate * grown + signal.value * rate,
        signal.second * grown + 2.0 * signal.rate * rate + signal.value * second,
    )


def mounted(name: str, shape: Shape, place: Pair) -> Hidden:
    """What a damper's mounting hides: in series, so its place is the whole leg."""
    return Hidden(
        ((shape, place),), [[name, list(place)]], linear=name == "series_compliance"
    )


FAMILY = Family(
    half_car,
    {
        "none": NOTHING,
        "none_second": NOTHING,
        "none_third": NOTHING,
        **devices(
            FRONT,
            "friction",
            "stribeck",
            "asymmetric",
            "stop",
            "quadratic",
            "gas",
            suffix="_front",
        ),
        **devices(
            REAR,
            "friction",
            "asymmetric",
            "cubic",
            "hysteresis",
            "cogging",
            suffix="_rear",
        ),
        **devices(TYRE_REAR, "cubic", suffix="_tyre_rear"),
        "play_rear": mounted("backlash", fx.loose_mount("damper_rear"), REAR),
        "bushing_front": mounted(
            "series_compliance", fx.bushing("damper_front"), FRONT
        ),
        "gain_front": at("sensor_gain", fx.sensor_gain, "travel_front"),
        "delay_rear": at("sensor_delay", fx.sensor_delay, "wheel_acceleration_rear"),
    },
)
