"""The warning of roads on which linear tyres would pull, and the share of the time in which they do."""

import warnings

import gymnasium as gym
import numpy as np
import pytest
from builders import element
from program import python

from isd_gym import Network, TyreContactWarning
from isd_gym.physics._tyre_contact import pulling_share
from isd_gym.physics.road import road
from isd_gym.physics.vehicle import vehicle

QUARTER = "ISDSuspension-v0"


def with_lift_off(name):
    """A quarter car whose wheel lifts off."""
    car = Network.load(name)
    content = car.to_dict()
    (load,) = vehicle(car).static_tyre_loads
    values = {"stiffness": 192000.0, "load": load}
    content["elements"].append(
        element("lift_off", "tyre_lift_off", "wheel", "road", **values)
    )
    return content


@pytest.mark.parametrize(
    ("name", "ground"), [("quarter-car-passive", "D"), ("half-car-isd", "E")]
)
def test_the_share_is_the_share_of_a_drive(name, ground):
    car = vehicle(Network.load(name))
    cars = gym.make_vec(
        QUARTER,
        16,
        network=car.network,
        allow_passive=True,
        road=ground,
        max_episode_steps=2001,
    )
    cars.reset(seed=0)
    idle, loads = np.zeros(cars.action_space.shape, np.float32), []
    for _ in range(2000):
        info = cars.step(idle)[-1]
        loads.append(
            [
                info[n] + w
                for n, w in zip(car.tyre_loads, car.static_tyre_loads, strict=True)
            ]
        )
    share = float(np.mean(np.array(loads) < 0))
    assert share > 0.005
    assert pulling_share(car, road(ground), 20.0) == pytest.approx(share, rel=0.15)


@pytest.mark.parametrize(
    "options",
    [
        {"road": "E"},
        {"road": "D+bump", "speed": 25.0},
        {"randomize": {"road": ["A", "E"]}},
        {"road": "D", "speed": 10.0, "randomize": {"speed": (10.0, 30.0)}},
    ],
)
def test_rough_roads_are_warned_of(options):
    for make in (gym.make, lambda name, **given: gym.make_vec(name, 3, **given)):
        with pytest.warns(TyreContactWarning, match="tyre_lift_off") as seen:
            make(QUARTER, **options)
        assert len(seen) == 1
        assert "\n" not in str(seen[0].message)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"road": "C", "speed": 40.0},
        {"road": "paper+pothole"},
        {"road": "E", "network": with_lift_off("quarter-car-isd")},
    ],
)
def test_other_roads_are_not(options):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gym.make(QUARTER, **options)


def test_a_program_warns_once():
    code = f"import gymnasium\nfor road in 'paper E E C E'.split(): gymnasium.make({QUARTER!r}, road=road)"
    assert python(code).stderr.count("TyreContactWarning") == 1


def test_the_command_says_it_in_one_line():
    words = [
        "isd-gym",
        "score",
        "passive",
        "--road",
        "E",
        "--episodes",
        "2",
        "--duration",
        "1",
    ]
    done = python(
        f"import sys; sys.argv = {words}; from isd_gym._commands import main; main()"
    )
    lines = [line for line in done.stderr.splitlines() if "tyre_lift_off" in line]
    assert len(lines) == 1, done.stderr
    assert lines[0].startswith("isd-gym: on road E")
