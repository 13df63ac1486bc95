"""Policies of half and full cars: the rear road told by the front wheels, several currents, training and files."""

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from isd_gym.agents._entry import open_policy
from isd_gym.agents._memory import Memory
from isd_gym.agents.policy import Head, Policy
from program import refused

from isd_gym import ISDSuspensionVectorEnv, Network, StageCost
from isd_gym.physics.vehicle import vehicle

CARS = {"half-car-isd": "ISDHalfCar-v0", "full-car-isd": "ISDFullCar-v0"}
both = pytest.mark.parametrize("network", CARS)
STEP = 5e-3
# A, of sums in single precision in an estimate that remembers seconds: 2 to 5 mA against the same code in double precision,
# by the order of the sums, which NumPy chooses by processor
ROUNDING = 1e-2


@cache
def memory(network):
    """The memory of a shipped policy: signals, rear road and estimate."""
    return Policy.load(f"ppo-{network.removesuffix('-isd')}").memory


def policy_of(network, head=None, seed=0, hidden=8):
    rng, plant = np.random.default_rng(seed), Network.load(network)
    car = vehicle(plant)
    sizes = [memory(network).width(len(car.measured)), hidden, len(car.driven)]
    layers = [
        (rng.normal(size=(b, a)) / a, 0.1 * rng.normal(size=b))
        for a, b in pairwise(sizes)
    ]
    return Policy(
        layers, memory=memory(network), head=head or Head("increment"), network=plant
    )


@both
@pytest.mark.parametrize("mode", ["target", "increment", "residual"])
def test_one_car_and_many_get_the_same_currents(network, mode):
    policy = policy_of(network, Head(mode))
    motors = len(vehicle(Network.load(network)).driven)
    env = ISDSuspensionVectorEnv(3, network=network, autoreset_mode="disabled")
    obs, _ = env.reset(seed=1)
    alone = policy.copy()
    for _ in range(60):
        many, one = policy.act_batch(obs), alone.act(obs[1])
        assert many.shape == (3, motors) and one.shape == (motors,)
        np.testing.assert_allclose(many[1], one, atol=ROUNDING)
        obs, *_ = env.step(many)
    assert np.ptp(many, axis=1).min() > 0


def test_a_policy_of_another_car_is_one_line(tmp_path):
    half, quarter = policy_of("half-car-isd").save(tmp_path / "half"), "ppo"
    for name, network, says in (
        (str(half), "quarter-car-isd", "2 currents; 'quarter-car-isd' has 1"),
        (str(half), "full-car-isd", "2 currents; 'full-car-isd' has 4"),
        (quarter, "half-car-isd", "1 current; 'half-car-isd' has 2"),
    ):
        plant = Network.load(network)
        assert "choose a policy" in refused(
            says, open_policy, name, plant, StageCost(), STEP, {}
        )
    other = {"memory": memory("half-car-isd"), "network": Network.load("full-car-isd")}
    refused("outputs", Policy, policy_of("half-car-isd").weights, **other)


def test_scoring_sets_the_speed_of_a_policy(tmp_path):
    folder = policy_of("half-car-isd").save(tmp_path / "p")
    plant = Network.load("half-car-isd")
    entry = open_policy(str(folder), plant, StageCost(), STEP, {"speed": 30.0})
    assert entry.make().memory.echo.speed == 30.0


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        ({"speed": 0.1}, "m/s or more"),
        ({"rows": [[1.0] * 18] * 9}, "leading wheel"),
        ({"lag": 1.5}, "whole number"),
        ({"points": 10**6}, "points"),
        ({"rows": [[1.0, 2.0]]}, "as many states"),
        ({"followers": []}, "rises"),
        ({"followers": [[3, 2.7]]}, "follower"),
        ({"followers": [[0, 2.7], [0, 2.7]]}, "other wheels"),
    ],
)
def test_a_spoilt_echo_is_one_line(spoil, says):
    data = memory("half-car-isd").to_dict()
    refused(says, Memory.from_dict, {**data, "echo": {**data["echo"], **spoil}})
    refused("both", Memory.from_dict, {**data, "ahead": 3})
