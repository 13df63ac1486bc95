"""A small rig for every element type, drawn from a seed: the element sits in a shaken mass with a motor and a logged oil."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np

BASE: dict[str, Any] = {
    "schema": "isd-model/1",
    "name": "law",
    "masses": {"body": 40.0},
    "elements": [
        {
            "name": "spring",
            "type": "linear_stiffness",
            "between": ["body", "table"],
            "stiffness": 9e3,
        },
        {
            "name": "damper",
            "type": "linear_damping",
            "between": ["body", "table"],
            "damping": 300.0,
        },
        {
            "name": "motor",
            "type": "motor",
            "between": ["body", "ground"],
            "thrust_constant": 40.0,
        },
    ],
    "inputs": [
        {"name": "table", "quantity": "displacement", "at": "table", "unit": "m"},
        {"name": "current", "quantity": "current", "element": "motor", "unit": "A"},
        {"name": "oil", "quantity": "temperature", "unit": "degC"},
    ],
    "outputs": [
        {
            "name": "travel",
            "quantity": "displacement",
            "between": ["body", "table"],
            "unit": "m",
        },
        {"name": "speed", "quantity": "velocity", "at": "body", "unit": "m/s"},
    ],
}
PAIR = {"between": ["body", "table"]}
MOTOR = {"element": "motor"}
SENSOR = {"channel": "travel"}
#: place and nominal values of each type; a seed scales the numbers by 0.8 to 1.25
ELEMENTS: dict[str, dict[str, Any]] = {
    "linear_stiffness": PAIR | {"stiffness": 3e3},
    "linear_damping": PAIR | {"damping": 100.0},
    "inertance": PAIR | {"inertance": 10.0},
    "terminal_inertia": PAIR | {"mass": 5.0, "terminal": "first"},
    "series_compliance": PAIR | {"stiffness": 4e3},
    "motor": {},
    "coulomb_friction": PAIR | {"level": 20.0},
    "stribeck_friction": PAIR
    | {"level": 15.0, "static_level": 25.0, "stribeck_velocity": 0.05},
    "asymmetric_friction": PAIR | {"extension": 25.0, "compression": 12.0},
    "quadratic_damping": PAIR | {"damping": 400.0},
    "asymmetric_damping": PAIR | {"extension": 150.0, "compression": 40.0},
    "degressive_damping": PAIR | {"damping": 300.0, "knee": 0.1},
    "controlled_damper": PAIR | {"low": 50.0, "high": 400.0, "current": 2.0},
    "cubic_stiffness": PAIR | {"stiffness": 4e6},
    "gas_spring": PAIR | {"force": 200.0, "length": 0.2, "exponent": 1.3},
    "bump_stop": PAIR | {"clearance": 0.008, "stiffness": 3e4},
    "backlash": PAIR | {"gap": 0.01, "stiffness": 1e4},
    "hysteresis": PAIR
    | {"level": 40.0, "stiffness": 2e4, "exponent": 1.0, "shape": 0.5},
    "cogging_force": PAIR | {"amplitude": 20.0, "pitch": 0.01, "phase": 1.0},
    "constant_force": PAIR | {"force": 30.0},
    "gravity_sine": PAIR | {"torque": 3e3, "rest": 0.2},
    "tyre_lift_off": PAIR | {"stiffness": 9e3, "load": 60.0},
    "tabulated_force": PAIR | {"rate": [-0.2, 0.0, 0.3], "force": [-60.0, 0.0, 50.0]},
    "scheduled_damping": PAIR | {"slope": 4.0, "reference": 20.0, "channel": "oil"},
    "scheduled_friction": PAIR
    | {"level": 15.0, "slope": 0.5, "reference": 20.0, "channel": "oil"},
    "load_dependent_friction": PAIR | {"level": 8.0, "gain": 0.1, "load": "spring"},
    "thrust_saturation": MOTOR | {"current": 2.0},
    "actuator_lag": MOTOR | {"time_constant": 0.02},
    "actuator_delay": MOTOR | {"delay": 0.016},
    "drive_dead_zone": MOTOR | {"threshold": 0.6},
    "quadratic_thrust": MOTOR | {"reference": 2.0, "form": "signed"},
    "sensor_gain": SENSOR | {"gain": 1.2},
    "sensor_bias": SENSOR | {"bias": 0.002},
    "sensor_delay": SENSOR | {"delay": 0.01},
    "sensor_magnitude": SENSOR,
    "sensor_dead_zone": SENSOR | {"width": 0.002},
}


def draw(
    kind: str, seed: int = 0
) -> tuple[dict[str, Any], np.ndarray, dict[str, np.ndarray]]:
    """Return the model of a rig with an element, time (n,) [s] and inputs (n,) [SI]."""
    rng = np.random.default_rng([seed, sorted(ELEMENTS).index(kind)])
    model, element = copy.deepcopy(BASE), {"name": "law", "type": kind}
    for key, value in ELEMENTS[kind].items():
        element[key] = (
            float(value * rng.uniform(0.8, 1.25)) if isinstance(value, float) else value
        )
    if kind != "motor":
        model["elements"].append(element)
    time = 0.002 * np.arange(501)
    rise = np.minimum(time / 0.1, 1.0) ** 3
    phase = rng.uniform(0.0, 2.0 * np.pi, 3)
    table = (
        0.01
        * rise
        * (np.sin(14.0 * time + phase[0]) + 0.4 * np.sin(37.0 * time + phase[1]))
    )
    steps = np.repeat(rng.uniform(-3.0, 3.0, 51), 10)[: len(time)]
    inputs = {
        "table": table,
        "current": steps,
        "oil": 20.0 + 10.0 * np.sin(3.0 * time + phase[2]),
    }
    if kind == "controlled_damper":
        inputs["valve"] = inputs["current"]
        model["inputs"].append(
            {"name": "valve", "quantity": "current", "element": "law", "unit": "A"}
        )
    return model, time, inputs
