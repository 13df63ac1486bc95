"""A car is the same car to the last bit: alone, beside others, with matrices of its own or shared ones."""

import numpy as np
import pytest
from builders import channel, damper, element, friction, network, spring

from isd_gym import Network
from isd_gym.physics.simulate import Plant

STEP = 1e-3
LANES = 7  # no multiple of what one instruction works on
SUSPENSION, DEVICE = ("body", "wheel"), ("piston", "joint")
DAMPER, TYRE = ("joint", "wheel"), ("wheel", "road")
LAWS = {
    "friction and end stop": (),
    "stops touched at once": (
        {"type": "bump_stop", "between": SUSPENSION, "clearance": 8e-3, "stiffness": 2e5, "damping": 500.0},
        {"type": "bump_stop", "between": DAMPER, "clearance": 4e-3, "stiffness": 5e4},
    ),
    "hysteresis": (
        {"type": "hysteresis", "between": SUSPENSION, "level": 200.0, "stiffness": 5e4},
        {"type": "hysteresis", "between": DEVICE, "level": 90.0, "stiffness": 1e5, "exponent": 2.0, "shape": 0.4},
    ),
    "Stribeck": (
        {"type": "stribeck_friction", "between": SUSPENSION, "level": 60.0, "static_level": 110.0, "stribeck_velocity": 0.05},
    ),
    "three coupled frictions": (
        {"type": "coulomb_friction", "between": SUSPENSION, "level": 100.0},
        {"type": "coulomb_friction", "between": DAMPER, "level": 150.0},
    ),
    "backlash": ({"type": "backlash", "between": DAMPER, "gap": 2e-3, "stiffness": 2e5},),
    "smooth laws": (
        {"type": "quadratic_damping", "between": DAMPER, "damping": 2000.0},
        {"type": "asymmetric_damping", "between": SUSPENSION, "extension": 400.0, "compression": -200.0},
        {"type": "cubic_stiffness", "between": SUSPENSION, "stiffness": 2e7},
        {"type": "gas_spring", "between": SUSPENSION, "force": 800.0, "length": 0.2},
        {"type": "cogging_force", "between": DEVICE, "amplitude": 80.0, "pitch": 6e-3},
        {"type": "tyre_lift_off", "between": TYRE, "stiffness": 192e3, "load": 2000.0},
    ),
}  # fmt: skip


def car(laws):
    net = Network.load("quarter-car-isd")
    for i, law in enumerate(laws):
        net = net.with_element({"name": f"law_{i}", **law})
    return net


def in_series():
    """A mass that hangs on backlash and compliance in series: a node whose velocity is only a difference."""
    play = element("play", "backlash", "mass", "middle", gap=2e-3, stiffness=5e5)
    rod = element("rod", "series_compliance", "middle", "road", stiffness=3e5)
    held = [spring("mass", "ground", 2e4), damper("mass", "ground", 80.0)]
    parts = [*held, play, friction("mass", "middle", 20.0), rod]
    seen = ["a acceleration mass", channel("force", "force", element="rod")]
    return network(
        "in series", parts, ["road displacement road"], seen, masses={"mass": 50.0}
    )


def drives(steps):
    """A road and a current for every lane, from standstill to far into the stops."""
    rng = np.random.default_rng(5)
    size = np.linspace(0.0, 6.0, LANES)
    road = np.cumsum(rng.standard_normal((steps, LANES)), axis=0) * 6.3e-4 * size
    time = np.arange(steps)[:, None] * STEP
    return {
        "road": road,
        "current": 5.0 * np.sin(9.0 * time + np.arange(LANES)) * (size > 2.0),
    }


@pytest.mark.parametrize("case", [*LAWS, "in series"])
def test_a_lane_is_the_car_alone_with_any_matrices(case):
    net = in_series() if case == "in series" else car(LAWS[case])
    inputs = {
        k: v for k, v in drives(1501).items() if k in [c.name for c in net.inputs]
    }
    shared = Plant(net, STEP, lanes=LANES).run(inputs, samples=1501)
    own = Plant([net] * LANES, STEP).run(inputs, samples=1501)
    assert np.isfinite(shared).all()
    assert np.ptp(
        shared[-1], axis=1
    ).all()  # the lanes differ: equality below is no accident
    np.testing.assert_array_equal(shared, own)
    single = Plant(net, STEP)
    for l in range(LANES):
        alone = single.run({k: v[:, l] for k, v in inputs.items()}, samples=1501)
        np.testing.assert_array_equal(shared[:, :, l], alone[:, :, 0])


@pytest.mark.parametrize("other", [{}, {"body.mass": 9.0}])
def test_parameters_of_their_own_are_networks_of_their_own(other):
    """Lanes that differ in parameters of laws alone, or of the linear part too, each against its network alone."""
    net = car(LAWS["Stribeck"])
    steps = {
        "seal.level": 60.0,
        "end_stop.clearance": -3e-3,
        "law_0.static_level": 10.0,
        **other,
    }
    start = net.parameters
    nets = [
        net.with_parameters({k: start[k] + i * v for k, v in steps.items()})
        for i in range(LANES)
    ]
    inputs = {k: v[:, 5] for k, v in drives(1501).items()}
    together = Plant(nets, STEP).run(inputs, samples=1501)
    for l, one in enumerate(nets):
        np.testing.assert_array_equal(
            together[:, :, l], Plant(one, STEP).run(inputs, samples=1501)[:, :, 0]
        )
