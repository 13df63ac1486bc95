"""The force that a measured motion needs, in place of the motion that a force makes."""

import math

import builders
import numpy as np
import pytest
from builders import channel, damper, element, spring

from isd_gym import Network, Table, diagnose, simulate
from isd_gym.diagnosis import SearchSettings
from isd_gym.diagnosis._estimation.exchanged_roles import invert
from isd_gym.diagnosis._simulation.problem import Problem, Record

MASS, DAMPING, THRUST = 4.0, 12.0, 25.0  # [kg], [N s/m], [N/A]
COGGING, PITCH = 5.0, 0.02  # [N], [m]
STEP = 1e-3  # [s]


def axis(between=("ground", "carriage"), *more, **changes):
    """Return a carriage that the current of a motor pushes."""
    motor = element("motor", "motor", *between, thrust_constant=THRUST)
    model = builders.model(
        "axis",
        [damper("carriage", "ground", DAMPING, "bearing"), motor, *more],
        [channel("current", "current", element="motor")],
        [channel("position", "displacement", "carriage", unit="mm")],
        masses={"carriage": MASS},
        uncertainty={
            "carriage.mass": 0.1,
            "bearing.damping": 0.3,
            "motor.thrust_constant": 0.05,
        },
    )
    return Network.load(model | changes)


@pytest.mark.parametrize("between", [("ground", "carriage"), ("carriage", "ground")])
def test_the_computed_force_is_that_of_the_drive(between):
    """The motion that a current makes needs the force of this current, whatever the direction of the motor."""
    network = axis(between)
    t = np.arange(4000) * STEP
    current = 0.5 * np.sin(2 * math.pi * 1.1 * t) * np.minimum(t, 1.0)
    position = simulate(network, t, {"current": current})["position"]  # [mm]
    inverse = invert(network)
    assert inverse is not None
    turned = inverse.records(
        [Record("run", STEP, {"current": current}, position[:, None])]
    )
    seen = Problem(inverse.network, turned, ["fit"]).simulate([inverse.network], 0)[
        :, 0, 0
    ]
    assert np.abs(seen - turned[0].measured[:, 0]).max() < 0.02 * THRUST * 0.5
    assert np.abs(turned[0].measured[:, 0]).max() == pytest.approx(
        THRUST * np.abs(current).max()
    )


LAG = {"name": "lag", "type": "actuator_lag", "element": "motor", "time_constant": 0.01}
SPRING = spring("carriage", "ground", 100.0)


@pytest.mark.parametrize(
    "network",
    [
        axis(("ground", "carriage"), SPRING),
        axis(("ground", "carriage"), LAG),
        axis(outputs=[channel("speed", "velocity", "carriage")]),
        Network.load("quarter-car-isd"),
    ],
    ids=["spring", "effect at the motor", "speed alone", "car"],
)
def test_other_models_have_no_inverse(network):
    assert invert(network) is None


def test_the_completed_model_has_the_drive_as_input():
    network = axis()
    inverse = invert(network)
    assert inverse is not None
    found = inverse.network.with_parameters({"carriage.mass": 4.4})
    law = {"amplitude": COGGING, "pitch": PITCH, "phase": 0.0}
    cogging = element("cogging_force", "cogging_force", "carriage", "ground", **law)
    restored = inverse.restore(found.with_element(cogging))
    assert restored is not None
    assert restored.masses == {"carriage": 4.4}
    assert [e.name for e in restored.elements] == ["bearing", "motor", "cogging_force"]
    assert (restored.inputs, restored.outputs) == (network.inputs, network.outputs)
    fault = {
        "name": "fault",
        "type": "sensor_gain",
        "channel": "motor_force",
        "gain": 1.1,
    }
    assert inverse.restore(inverse.network.with_element(fault)) is None


def servo(seed, samples=10_000):
    """A carriage with cogging that a position controller moves, by semi-implicit Euler steps of a tenth of the sampling step."""
    rng = np.random.default_rng(seed)
    times, sizes = rng.uniform(0.3, 1.5, 5), rng.uniform(0.01, 0.04, 5)
    phases = rng.uniform(0, 2 * math.pi, 5)
    x = v = 0.0
    out = np.empty((samples, 2))
    for k in range(samples):
        wanted = min(1.0, k * STEP) * float(
            np.sum(sizes * np.sin(2 * math.pi * times * k * STEP + phases))
        )
        seen = 5e-6 * round(x / 5e-6)  # encoder of 5 um
        current = float(np.clip(150.0 * (wanted - seen) - 3.0 * v, -8.0, 8.0))
        out[k] = current, 1e3 * seen
        for _ in range(10):
            force = (
                THRUST * current
                - DAMPING * v
                - COGGING * math.sin(2 * math.pi * x / PITCH)
            )
            v += 0.1 * STEP * force / MASS
            x += 0.1 * STEP * v
    columns = {"current": out[:, 0], "position": out[:, 1]}
    return Table(
        np.arange(samples) * STEP, columns, f"run {seed}", units={"position": "mm"}
    )


@pytest.mark.slow
def test_cogging_of_an_axis_in_a_closed_loop_is_named():
    """The simulated motion drifts away; the force that the measured motion needs shows the pitch."""
    found = diagnose(
        [servo(1), servo(2)],
        axis(),
        validate=[servo(3)],
        settings=SearchSettings(jobs=1),
    )
    assert found.verdict == "missing_effect", found.summary
    (effect,) = found.effects
    assert effect.effect == "cogging_force"
    assert effect.parameters["pitch"].value == pytest.approx(PITCH, rel=0.01)
    assert effect.parameters["amplitude"].value == pytest.approx(COGGING, rel=0.1)
    assert found.whole is not None
    assert found.whole.inputs[0].quantity == "current"
