"""What turns: inertias, angles, torques and volts in a model, and the laws that pendulums and drives need."""

import json
import math

import builders
import numpy as np
import pytest
from builders import cart, channel, damper, element, spring
from program import refused
from scipy.integrate import solve_ivp

from isd_gym import Network, simulate
from isd_gym._common.units import about_axis, convert
from isd_gym.diagnosis._estimation.structure import base_structure

J, G, C = 0.0033, 0.21, 4e-4
PENDULUM = builders.model(
    "arm",
    [
        element("gravity", "gravity_sine", "arm", "ground", torque=G),
        damper("arm", "ground", C, "bearing"),
        element("drive", "motor", "arm", "ground", thrust_constant=0.02),
    ],
    [channel("command", "voltage", element="drive", unit="mV")],
    [
        channel("angle", "angle", "arm", unit="deg"),
        channel("speed", "angular_velocity", "arm", unit="rpm"),
        channel("torque", "torque", element="gravity", unit="mN m"),
    ],
    inertias={"arm": J},
    uncertainty={"arm.inertia": 0.05, "gravity.torque": 0.05},
)


def test_a_pendulum_swings_as_its_equation_says():
    t = np.arange(0, 3, 1e-3)
    volts = np.where(t < 1.0, 3.0, 0.0)  # held over each sample
    out = simulate(PENDULUM, t, {"command": 1e3 * volts})
    state, parts = [0.0, 0.0], []
    for volt, span in ((3.0, t[t < 1.0]), (0.0, t[t >= 1.0])):

        def rate(_, x, volt=volt):  # the motor pulls its terminals together
            return [x[1], (-G * math.sin(x[0]) - C * x[1] - 0.02 * volt) / J]

        ends = (span[0], span[-1] + 1e-3)
        run = solve_ivp(rate, ends, state, rtol=1e-10, atol=1e-12, dense_output=True)
        parts.append(run.sol(span))
        state = run.y[:, -1]
    angle, speed = np.hstack(parts)
    assert np.ptp(angle) > 0.4  # the sine matters
    assert np.allclose(np.radians(out["angle"]), angle, atol=1e-4)
    assert np.allclose(out["speed"] * math.pi / 30, speed, atol=2e-3)
    assert np.allclose(out["torque"], 1e3 * G * np.sin(angle), atol=0.05)


def test_a_model_that_turns_is_written_as_it_was_read():
    net = Network.load(PENDULUM)
    again = net.to_dict()
    assert again["inertias"] == {"arm": J} and again["masses"] == {}
    quantities = [c["quantity"] for c in again["inputs"] + again["outputs"]]
    assert quantities == ["voltage", "angle", "angular_velocity", "torque"]
    assert Network.load(json.loads(net.dumps())) == net
    assert net.unit_of("arm.inertia") == "kg m^2"
    assert net.unit_of("bearing.damping") == "N m s/rad"
    assert net.unit_of("gravity.torque") == "N m"
    assert net.unit_of("drive.thrust_constant") == "N m/V"
    assert net.with_parameters({"arm.inertia": 0.004}).masses["arm"] == 0.004


def test_units_of_rotation():
    assert convert(90.0, "deg", "rad") == pytest.approx(math.pi / 2)
    assert convert(60.0, "rpm", "rad/s") == pytest.approx(2 * math.pi)
    units = {"N s^2/m^2": "N m s^2/rad^2", "m/s": "rad/s", "-": "-"}
    assert {unit: about_axis(unit) for unit in units} == units


ROD = spring("car", "arm", 1.0, "rod")


def changed(**more):
    return {**PENDULUM, **more}


@pytest.mark.parametrize(
    ("model", "words"),
    [
        (
            changed(outputs=[channel("x", "displacement", "arm", unit="mm")]),
            "'arm' turns, and cannot be",
        ),
        (
            changed(outputs=[channel("x", "displacement", "arm", unit="deg")]),
            'quantity": "angle"',
        ),
        (changed(masses={"arm": 1.0}), "has a mass already"),
        (changed(inertias={"arm": -1.0}), "positive number of kg m.2"),
        (
            changed(masses={"car": 1.0}, elements=[*PENDULUM["elements"], ROD]),
            "'car' is tied to what turns",
        ),
    ],
)
def test_what_turns_is_not_mixed_with_what_moves_along_a_line(model, words):
    refused(words, Network.load, model)


def test_a_damping_that_starts_at_zero_may_be_fitted():
    model = {**PENDULUM, "uncertainty": {"bearing.damping": 0.1}}
    held = [
        spring("arm", "ground", G, "gravity"),
        damper("arm", "ground", 0.0, "bearing"),
    ]
    model["elements"] = [*held, PENDULUM["elements"][2]]
    (free,) = base_structure(
        Network.load({**model, "outputs": model["outputs"][:2]})
    ).free
    assert free.low == 0.0 and free.sigma == pytest.approx(0.1 * 2 * math.sqrt(G * J))


def test_what_starts_at_zero_with_nothing_to_measure_it_by_is_said_in_a_line():
    free = cart(damper("cart", "ground", 0.0, "c"))
    refused(
        r"'c\.damping' is zero, and nothing in the model says",
        base_structure,
        Network.load({**free, "uncertainty": {"c.damping": 0.5}}),
    )
