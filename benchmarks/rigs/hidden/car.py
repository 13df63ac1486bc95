"""The quarter car: network, hidden effects, roads and currents."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..families.draw import channel, model
from .secret import (
    FINE,
    Array,
    Draw,
    Element,
    Model,
    Secret,
    absorber,
    add,
    band_noise,
    both,
    effect,
    element,
    fading,
    fault,
    in_series,
    relaxation,
    replaced,
    sensor_gain,
)

if TYPE_CHECKING:
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
        "road displacement road",
        channel("current", "current", element="motor"),
    ]
    outputs = [
        "body_acceleration acceleration body",
        "suspension_travel displacement body wheel",
        channel("tyre_force", "force", element="tyre"),
        "device_travel displacement piston joint",
    ]
    masses = {"body": 345.0, "wheel": 45.0}
    return model("quarter-car-isd", masses, elements, inputs, outputs)


DEVICE, STRUT, DAMPER, TYRE = (
    ("piston", "joint"),
    ("body", "wheel"),
    ("joint", "wheel"),
    ("wheel", "road"),
)


def _two(*kinds: str) -> Draw:
    """Return a kind that hides two others together."""
    return lambda r: both(*(CAR[kind](r) for kind in kinds))


def _bump(**more: Any) -> Draw:
    return effect(
        "bump_stop",
        STRUT,
        clearance=(0.014, 0.021),
        stiffness=(8e4, 1.8e5),
        damping=0.0,
        **more,
    )


def _bias(r: Generator) -> Secret:
    bias = r.choice([-1, 1]) * r.uniform(0.0015, 0.003)
    return Secret(
        add=[{"type": "sensor_bias", "channel": "suspension_travel", "bias": bias}]
    )


def _asymmetric(r: Generator) -> Secret:
    ratio = r.uniform(0.3, 0.6)  # damping in compression over damping in extension
    return add(
        "asymmetric_damping", *DAMPER, extension=0.0, compression=(ratio - 1) * 1500.0
    )


def _lift_off(r: Generator) -> Secret:
    # The owner's spring pulls; the tyre does not, beyond the static load of about 3.8 kN.
    load = r.uniform(0.75, 0.95) * 3826.0
    return Secret(
        add=[element("tyre_lift_off", *TYRE, stiffness=192000.0, load=load)], level=5.0
    )


PHASE = (-np.pi, np.pi)
CAR: dict[str, Draw] = {
    "none": lambda r: Secret(),
    "none_passive": lambda r: Secret(passive=True, level=2.0),
    "none_strong_road": lambda r: Secret(level=3.5),
    "friction_device": lambda r: Secret(drop=["seal"]),
    "friction_strut": effect("coulomb_friction", STRUT, level=(70, 120)),
    "friction_damper": effect("coulomb_friction", DAMPER, level=(100, 180)),
    "stribeck_device": replaced("seal", "stribeck_friction", level=(300, 420), static_level=(600, 800), stribeck_velocity=(0.03, 0.06)),
    "stribeck_strut": effect("stribeck_friction", STRUT, level=(50, 80), static_level=(140, 220), stribeck_velocity=(0.03, 0.06)),
    "damping_strut": effect("linear_damping", STRUT, damping=(150, 300)),
    "damping_tyre": effect("linear_damping", TYRE, damping=(250, 450)),
    "stiffness_device": effect("linear_stiffness", DEVICE, stiffness=(4e3, 9e3)),
    "inertance_strut": effect("inertance", STRUT, inertance=(6, 14)),
    "quad_damping_device": effect("quadratic_damping", DEVICE, damping=(6e3, 1.2e4)),
    "quad_damping_damper": effect("quadratic_damping", DAMPER, damping=(1.2e3, 2.4e3)),
    "asym_damper": _asymmetric,
    "cubic_main": effect("cubic_stiffness", STRUT, stiffness=(8e6, 1.8e7)),
    "gas_spring_main": effect("gas_spring", STRUT, force=(1500, 2500), length=(0.14, 0.18), exponent=1.3),
    "bump_stop": _bump(side="both"),
    "bump_stop_compression": _bump(side="compression"),
    "bump_stop_device": effect("bump_stop", DEVICE, clearance=(0.010, 0.015), stiffness=(2e5, 6e5), damping=0.0, side="both"),
    "backlash_damper": in_series("damper", "backlash", gap=(0.002, 0.004), stiffness=5e6),
    "compliance_damper": in_series("damper", "series_compliance", stiffness=(4e4, 9e4)),
    "hysteresis_main": effect("hysteresis", STRUT, level=(90, 160), stiffness=(4e4, 8e4), exponent=1.0, shape=0.5),
    "cogging": effect("cogging_force", DEVICE, amplitude=(110, 200), pitch=0.0059, phase=PHASE),
    "terminal_inertia": effect("terminal_inertia", DEVICE, mass=(20, 35), terminal="second"),
    "tyre_lift_off": _lift_off,
    "thrust_droop": fault("thrust_saturation", current=(3.0, 4.5)),
    "current_lag": fault("actuator_lag", time_constant=(0.008, 0.02)),
    "current_delay": fault("actuator_delay", delay=(0.006, 0.015)),
    "sensor_gain_acc": sensor_gain("body_acceleration", 0.1, 0.15),
    "sensor_gain_travel": sensor_gain("suspension_travel", 0.1, 0.15),
    "sensor_bias_travel": _bias,
    "sensor_delay_acc": fault("sensor_delay", channel="body_acceleration", delay=(0.004, 0.010)),
    "two_friction_strut_quad_device": _two("friction_strut", "quad_damping_device"),
    "two_asym_bump": _two("asym_damper", "bump_stop"),
    "two_lag_cubic": _two("current_lag", "cubic_main"),
    "two_gain_damping_tyre": _two("sensor_gain_acc", "damping_tyre"),
    "out_body_mode": absorber("body", (25, 40), (4.5, 6.5)),
    "out_wheel_mode": absorber("wheel", (3, 6), (11, 16)),
    "out_fading_damper": fading("damper", DAMPER, 1500.0, (1500, 3000)),
    "out_relaxation": relaxation(STRUT, (6e3, 1.2e4), (0.08, 0.2)),
    "out_timed_friction": effect("x_timed_friction", STRUT, unknown=True, level=(150, 250), period=(2.0, 4.0), duty=0.4),
    "out_position_damping": effect("x_position_damping", STRUT, unknown=True, damping=(500, 900), length=0.012),
    "out_parametric_spring": effect("x_parametric_stiffness", STRUT, unknown=True, stiffness=(3500, 6000), frequency=(0.3, 0.8)),
}  # fmt: skip
CAR_NUISANCES: list[Draw] = [
    effect("cubic_stiffness", STRUT, stiffness=(2e5, 6e5)),
    effect("linear_damping", TYRE, damping=(8, 17)),
    effect("quadratic_damping", DEVICE, damping=(150, 240)),
    fault("thrust_saturation", current=(25, 35)),
    effect("cogging_force", DEVICE, amplitude=(4, 9), pitch=0.0059, phase=PHASE),
    effect("coulomb_friction", STRUT, level=(4, 8.5)),
    lambda r: add("asymmetric_damping", *DAMPER, extension=0.0, compression=-1500.0 * r.uniform(0.015, 0.035)),
]  # fmt: skip


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
