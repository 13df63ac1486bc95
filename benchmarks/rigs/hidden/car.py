"""The quarter car: its network, what may be hidden in it, its roads and currents."""

from __future__ import annotations

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
    both,
    element,
    motor,
    relaxation,
    sensor,
    strange,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.random import Generator


def car_base(r: Generator, _: Secret) -> Model:
    elements: list[Element] = [
        element(
            "linear_stiffness", "body", "wheel", name="main_spring", stiffness=22000.0
        ),
        element("linear_stiffness", "wheel", "road", name="tyre", stiffness=192000.0),
        element("linear_stiffness", "body", "piston", name="oil", stiffness=709000.0),
        element("inertance", "piston", "joint", name="inerter", inertance=95.0),
        element("linear_damping", "piston", "joint", name="leak", damping=1293.0),
        element("coulomb_friction", "piston", "joint", name="seal", level=500.0),
        element(
            "motor", "piston", "joint", name="motor", thrust_constant=60.0, ratio=4.056
        ),
        element("linear_damping", "joint", "wheel", name="damper", damping=1500.0),
    ]
    if r.random() < 0.3:
        elements.append(
            element(
                "bump_stop",
                "piston",
                "joint",
                name="end_stop",
                clearance=0.02465,
                stiffness=1e6,
                damping=1000.0,
            )
        )
    inputs = [
        channel("road", "displacement", at="road"),
        channel("current", "current", element="motor"),
    ]
    outputs = [
        channel("body_acceleration", "acceleration", at="body"),
        channel("suspension_travel", "displacement", between=["body", "wheel"]),
        channel("tyre_force", "force", element="tyre"),
        channel("device_travel", "displacement", between=["piston", "joint"]),
    ]
    masses = {"body": 345.0, "wheel": 45.0}
    return model("quarter-car-isd", masses, elements, inputs, outputs)


DEVICE, STRUT, DAMPER, TYRE = (
    ("piston", "joint"),
    ("body", "wheel"),
    ("joint", "wheel"),
    ("wheel", "road"),
)


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
    return add(
        "asymmetric_damping", *DAMPER, extension=0.0, compression=(ratio - 1) * 1500.0
    )


def _car_bump(r: Generator, side: str = "both") -> Secret:
    return add(
        "bump_stop",
        *STRUT,
        clearance=r.uniform(0.014, 0.021),
        stiffness=r.uniform(8e4, 1.8e5),
        damping=0.0,
        side=side,
    )


def _car_hysteresis(r: Generator) -> Secret:
    return add(
        "hysteresis",
        *STRUT,
        level=r.uniform(90, 160),
        stiffness=r.uniform(4e4, 8e4),
        exponent=1.0,
        shape=0.5,
    )


def _car_lift_off(r: Generator) -> Secret:
    # The owner's spring pulls; the tyre does not, beyond the static load of about 3.8 kN.
    secret = add(
        "tyre_lift_off", *TYRE, stiffness=192000.0, load=r.uniform(0.75, 0.95) * 3826.0
    )
    secret.level = 5.0
    return secret


def _car_backlash(r: Generator) -> Secret:
    play = {
        "type": "backlash",
        "gap": r.uniform(0.002, 0.004),
        "stiffness": 5e6,
        "into": ["damper"],
    }
    return Secret(series=[play])


def _car_compliance(r: Generator) -> Secret:
    return Secret(
        series=[
            {
                "type": "series_compliance",
                "stiffness": r.uniform(4e4, 9e4),
                "into": ["damper"],
            }
        ]
    )


CAR: dict[str, Callable[[Generator], Secret]] = {
    "none": lambda r: Secret(),
    "none_passive": lambda r: Secret(passive=True, level=2.0),
    "none_strong_road": lambda r: Secret(level=3.5),
    "friction_device": _car_friction_device,
    "friction_strut": lambda r: add(
        "coulomb_friction", *STRUT, level=r.uniform(70, 120)
    ),
    "friction_damper": lambda r: add(
        "coulomb_friction", *DAMPER, level=r.uniform(100, 180)
    ),
    "stribeck_device": _car_stribeck_device,
    "stribeck_strut": lambda r: add(
        "stribeck_friction",
        *STRUT,
        level=r.uniform(50, 80),
        static_level=r.uniform(140, 220),
        stribeck_velocity=r.uniform(0.03, 0.06),
    ),
    "damping_strut": lambda r: add(
        "linear_damping", *STRUT, damping=r.uniform(150, 300)
    ),
    "damping_tyre": lambda r: add("linear_damping", *TYRE, damping=r.uniform(250, 450)),
    "stiffness_device": lambda r: add(
        "linear_stiffness", *DEVICE, stiffness=r.uniform(4e3, 9e3)
    ),
    "inertance_strut": lambda r: add("inertance", *STRUT, inertance=r.uniform(6, 14)),
    "quad_damping_device": lambda r: add(
        "quadratic_damping", *DEVICE, damping=r.uniform(6e3, 1.2e4)
    ),
    "quad_damping_damper": lambda r: add(
        "quadratic_damping", *DAMPER, damping=r.uniform(1.2e3, 2.4e3)
    ),
    "asym_damper": _car_asymmetric,
    "cubic_main": lambda r: add(
        "cubic_stiffness", *STRUT, stiffness=r.uniform(8e6, 1.8e7)
    ),
    "gas_spring_main": lambda r: add(
        "gas_spring",
        *STRUT,
        force=r.uniform(1500, 2500),
        length=r.uniform(0.14, 0.18),
        exponent=1.3,
    ),
    "bump_stop": _car_bump,
    "bump_stop_compression": lambda r: _car_bump(r, "compression"),
    "bump_stop_device": lambda r: add(
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
    "cogging": lambda r: add(
        "cogging_force",
        *DEVICE,
        amplitude=r.uniform(110, 200),
        pitch=0.0059,
        phase=r.uniform(-np.pi, np.pi),
    ),
    "terminal_inertia": lambda r: add(
        "terminal_inertia", *DEVICE, mass=r.uniform(20, 35), terminal="second"
    ),
    "tyre_lift_off": _car_lift_off,
    "thrust_droop": lambda r: motor("thrust_saturation", current=r.uniform(3.0, 4.5)),
    "current_lag": lambda r: motor(
        "actuator_lag", time_constant=r.uniform(0.008, 0.02)
    ),
    "current_delay": lambda r: motor("actuator_delay", delay=r.uniform(0.006, 0.015)),
    "sensor_gain_acc": lambda r: sensor(
        "sensor_gain",
        "body_acceleration",
        gain=1 + r.choice([-1, 1]) * r.uniform(0.1, 0.15),
    ),
    "sensor_gain_travel": lambda r: sensor(
        "sensor_gain",
        "suspension_travel",
        gain=1 + r.choice([-1, 1]) * r.uniform(0.1, 0.15),
    ),
    "sensor_bias_travel": lambda r: sensor(
        "sensor_bias",
        "suspension_travel",
        bias=r.choice([-1, 1]) * r.uniform(0.0015, 0.003),
    ),
    "sensor_delay_acc": lambda r: sensor(
        "sensor_delay", "body_acceleration", delay=r.uniform(0.004, 0.010)
    ),
    "two_friction_strut_quad_device": lambda r: both(
        CAR["friction_strut"](r), CAR["quad_damping_device"](r)
    ),
    "two_asym_bump": lambda r: both(_car_asymmetric(r), _car_bump(r)),
    "two_lag_cubic": lambda r: both(CAR["current_lag"](r), CAR["cubic_main"](r)),
    "two_gain_damping_tyre": lambda r: both(
        CAR["sensor_gain_acc"](r), CAR["damping_tyre"](r)
    ),
    "out_body_mode": lambda r: absorber(
        r, "body", r.uniform(25, 40), r.uniform(4.5, 6.5)
    ),
    "out_wheel_mode": lambda r: absorber(
        r, "wheel", r.uniform(3, 6), r.uniform(11, 16)
    ),
    "out_fading_damper": lambda r: Secret(
        add=[
            element(
                "x_fading_damping",
                *DAMPER,
                damping=1500.0,
                energy=r.uniform(1500, 3000),
            )
        ],
        replace={"damper": {"type": "linear_damping", "damping": 1.0}},
        unknown=True,
    ),
    "out_relaxation": lambda r: relaxation(
        r, *STRUT, r.uniform(6e3, 1.2e4), r.uniform(0.08, 0.2)
    ),
    "out_timed_friction": lambda r: strange(
        "x_timed_friction",
        *STRUT,
        level=r.uniform(150, 250),
        period=r.uniform(2.0, 4.0),
        duty=0.4,
    ),
    "out_position_damping": lambda r: strange(
        "x_position_damping", *STRUT, damping=r.uniform(500, 900), length=0.012
    ),
    "out_parametric_spring": lambda r: strange(
        "x_parametric_stiffness",
        *STRUT,
        stiffness=r.uniform(3500, 6000),
        frequency=r.uniform(0.3, 0.8),
    ),
}


def car_nuisances(r: Generator) -> list[Element]:
    return [
        element("cubic_stiffness", *STRUT, stiffness=r.uniform(2e5, 6e5)),
        element("linear_damping", *TYRE, damping=r.uniform(8, 17)),
        element("quadratic_damping", *DEVICE, damping=r.uniform(150, 240)),
        {"type": "thrust_saturation", "element": "motor", "current": r.uniform(25, 35)},
        element(
            "cogging_force",
            *DEVICE,
            amplitude=r.uniform(4, 9),
            pitch=0.0059,
            phase=r.uniform(-np.pi, np.pi),
        ),
        element("coulomb_friction", *STRUT, level=r.uniform(4, 8.5)),
        element(
            "asymmetric_damping",
            *DAMPER,
            extension=0.0,
            compression=-1500.0 * r.uniform(0.015, 0.035),
        ),
    ]


def car_inputs(
    r: Generator, secret: Secret, size: int, validation: bool
) -> dict[str, Array]:
    t = np.arange(size) * FINE
    # A random road as the paper prints it: slope white, one-sided displacement density 2 kappa u / f^2.
    kappa = secret.level * (
        r.uniform(0.5e-6, 1.0e-6) if validation else r.uniform(0.8e-6, 2.0e-6)
    )
    variance = 2 * kappa * 20.0 / 0.3
    road = np.sqrt(variance) * band_noise(r, size, 0.3, 40.0, slope=1.0)
    if validation:
        length, at = r.uniform(0.12, 0.3), t[-1] * r.uniform(0.3, 0.7)
        inside = np.abs(t - at) < length / 2
        road = road + r.uniform(0.025, 0.05) * np.where(
            inside, np.cos(np.pi * (t - at) / length) ** 4, 0.0
        )
    current = np.clip(r.uniform(1.6, 2.6) * band_noise(r, size, 1.0, 11.0), -5, 5)
    hold = round(5e-3 / FINE)
    current = current[np.arange(size) // hold * hold]
    return {"road": road, "current": 0.0 * current if secret.passive else current}
