"""The half car of the hidden suite: its own equations against the kernel's, and effects found at the right corner."""

from dataclasses import replace

import numpy as np
import pytest
from builders import named, table
from rigs import families
from rigs.families.bench import outputs
from rigs.families.half_car import FRONT, REAR, half_car
from rigs.families.plant import Signal, integrate

from isd_gym import Network, diagnose, simulate
from isd_gym.diagnosis._hypotheses.forces import _measured_force
from isd_gym.diagnosis._hypotheses.library import pairs
from isd_gym.diagnosis._simulation.problem import Problem, Record
from isd_gym.physics.elements._base import held_still


def waves(time, late=0.0):
    """A road of three sines [m] with its exact derivatives; `late` [s] for the rear axle."""
    w = np.array([5.0, 11.0, 23.0])
    angle = np.outer(time - late, w)
    return Signal(
        *(
            0.004 * np.sum(w**p * np.sin(angle + p * np.pi / 2), axis=1)
            for p in (0, 1, 2)
        )
    )


def car(seed=1):
    return half_car(np.random.default_rng(seed))


def ran(rig, model, interval, span=2.0):
    """Time, roads, and the channels that the suite's own integrator gives."""
    time = np.arange(round(span / interval) + 1) * interval
    road = {"road_front": waves(time), "road_rear": waves(time, 0.13)}
    free = integrate(model, road, len(time), interval, speed=0.1)
    return (
        time,
        road,
        outputs(replace(rig, size=len(time), interval=interval), model, free),
    )


def worst(a, b):
    return max(float(np.abs(a[k] - b[k]).max() / np.abs(b[k]).max()) for k in b)


def test_the_half_car_of_the_suite_is_that_of_the_kernel():
    """The kernel's road is linear between samples: what is left falls with the square of the interval."""
    rig = car()
    left = []
    for interval in (1e-3, 5e-4, 2.5e-4):
        time, road, own = ran(rig, rig.model, interval)
        left.append(
            worst(own, simulate(rig.model, time, {k: s.value for k, s in road.items()}))
        )
    assert left[2] < 1.5e-5
    np.testing.assert_allclose(np.divide(left[:-1], left[1:]), 4.0, rtol=0.05)


def half():
    return Network.load("half-car-passive")


def test_forces_are_looked_for_at_the_corners_and_between_body_and_ground():
    found = {frozenset(p) for p in pairs(half())}
    assert {frozenset(p) for p in (FRONT, REAR)} <= found
    assert {frozenset(("body", "ground")), frozenset(("body.pitch", "ground"))} <= found
    assert (
        not {frozenset(("body", "wheel_front")), frozenset(("body", "body.pitch"))}
        & found
    )


def test_springs_under_both_ends_hold_a_body_still_and_under_one_do_not():
    net = half()
    assert held_still(net, ("body", "ground"))
    assert not held_still(net.without_element("main_spring_rear"), ("body", "ground"))


def test_the_scale_of_force_is_the_inertia_of_what_the_sensor_sits_on():
    net, time = half(), np.arange(400) * 5e-3
    roads = {"road_front": waves(time).value, "road_rear": waves(time, 0.13).value}
    net = replace(
        net, outputs=(*net.outputs, net.probe("hop", "acceleration", at="wheel_rear"))
    )
    body = {
        "body_acceleration_front": 690.0,
        "body_acceleration": 690.0,
        "pitch_acceleration": 0.0,
    }
    for name, inertia in (body | {"hop": 45.0}).items():
        seen = replace(net, outputs=tuple(c for c in net.outputs if c.name == name))
        y = np.sin(20.0 * time)[:, None]
        problem = Problem(seen, [Record("r", 5e-3, roads, y)], ["fit"])
        assert _measured_force(problem) == pytest.approx(inertia * np.std(y), rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["friction_front", "cubic_tyre_rear", "delay_rear"])
def test_what_is_hidden_at_one_axle_is_named_there(kind):
    with np.errstate(over="ignore"):  # a size that is tried on the way to the right one
        case = families.make_case(f"half_car.{kind}", 1)
    held = [table(case.validation, "validation")]
    d = diagnose([table(case.estimation, "estimation")], case.model, validate=held)
    answer = {
        (e, frozenset([place] if isinstance(place, str) else place))
        for e, place in case.answer
    }
    assert named(d) == answer
