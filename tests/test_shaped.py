"""The shaped reward: it telescopes, the news of the road have zero mean, and single cars equal cars of a batch."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from program import refused

from isd_gym import Network
from isd_gym.physics import elements as el
from isd_gym.physics._value import value_of


@pytest.fixture
def rng():
    return np.random.default_rng(0)


CARS = ["quarter-car-isd", "half-car-isd", "full-car-isd"]
IDS = ["ISDSuspension-v0", "ISDHalfCar-v0", "ISDFullCar-v0"]


def linear(name):
    """Return a car without friction and stops."""
    car = Network.load(name)
    elements = [
        e for e in car.elements if e.bound is None and not isinstance(e, el.BumpStop)
    ]
    return replace(car, elements=tuple(elements), uncertainty={})


def laws(obs, rng, currents):
    """Return actions of three policies for a third of the cars each: none, random, and skyhook-like."""
    shares = np.zeros((len(obs), currents))
    third = len(obs) // 3
    shares[third : 2 * third] = rng.uniform(-1, 1, (third, currents))
    shares[2 * third :] = np.clip(obs[2 * third :, :1], -1, 1)
    return shares


def covariance(batch):
    """Return the covariance of the unexpected rises of the tracks in the physics steps of a control step [m^2]."""
    of, steps, rises = batch.of, batch.substeps, []
    poles, gains = batch.cars[of.pole : of.rough, 0], batch.cars[of.gain : of.pole, 0]
    for part in (slice(of.sum_filters), slice(of.sum_filters, of.filters))[: of.tracks]:
        impulse = [(gains[part] * poles[part] ** k).sum() for k in range(steps)]
        heights = np.array(
            [
                [impulse[k - j] if k >= j else 0.0 for j in range(steps)]
                for k in range(steps)
            ]
        )
        rise = np.diff(heights, axis=0, prepend=0.0)
        rises.append(rise @ rise.T)
    if of.tracks == 1:
        return rises[0]
    return np.block(
        [
            [rises[0] + rises[1], rises[0] - rises[1]],
            [rises[0] - rises[1], rises[0] + rises[1]],
        ]
    )


@pytest.mark.parametrize("name", IDS)
def test_rewards_are_a_constant_minus_the_costs_and_the_change_of_the_value(name, rng):
    """The news of the road have zero mean under every policy: the sum of reward, cost and change of the value is a
    constant within four standard errors over roads."""
    env = gym.make_vec(
        name, 96, reward="shaped", action="share", autoreset_mode="disabled"
    )
    task = env.unwrapped.task
    value = value_of(task.network, task.cost, 5e-3, 20.0)
    of, steps = task.batch.of, 600
    obs, _ = env.reset(seed=5)
    total = np.zeros(96)
    for _ in range(steps):
        obs, reward, _, _, info = env.step(laws(obs, rng, of.currents))
        total += reward + info["cost"]
    total = (total + task.batch.cars[of.value]) / steps
    constant = np.trace(value.news @ covariance(task.batch))
    for one in np.split(total, 3):
        assert abs(one.mean() - constant) < 4 * one.std() / np.sqrt(len(one))


@pytest.mark.parametrize("name", CARS)
def test_a_linear_car_s_reward_does_not_depend_on_the_road_of_the_step(name, rng):
    options = {"reward": "shaped", "action": "share"}
    env = gym.make(
        "ISDSuspension-v0", network=linear(name), disable_env_checker=True, **options
    ).unwrapped
    env.reset(seed=0)
    for _ in range(60):  # the rear wheels have met the road of the front wheels
        env.step(rng.uniform(-1, 1, env.action_space.shape))
    state, rewards, returns = env.get_state(), [], []
    of, cars = env.task.batch.of, env.task.batch.cars
    for _ in range(30):
        state["car"]["ways"][of.counter :] += 1_000_003
        env.set_state(state)
        _, reward, _, _, info = env.step(np.full(env.action_space.shape, 0.1))
        rewards.append(reward)
        returns.append(info["cost"] + cars[of.value, 0])
    # the linear models of half and full car leave out known road: between samples of the rear axle, and the drift of tracks
    assert np.std(rewards) < {1: 1e-12, 2: 5e-3, 4: 5e-2}[of.corners] * np.std(returns)


def test_a_broken_car_pays_the_cost_at_its_bounds():
    env = gym.make(
        "ISDSuspension-v0", reward="shaped", disable_env_checker=True
    ).unwrapped
    env.reset(seed=0)
    env.task.batch._states[0, 0, 0] = 1e3
    _, reward, terminated, _, info = env.step(np.zeros(1))
    assert terminated
    assert np.isfinite(reward)
    assert reward < -0.5 * info["cost"]


def test_roads_ahead_are_refused():
    refused(
        "do not see the road ahead",
        gym.make,
        "ISDSuspension-v0",
        reward="shaped",
        observation="preview",
    )


def test_a_car_without_a_motor_is_refused():
    refused(
        "motor",
        gym.make,
        "ISDSuspension-v0",
        network="quarter-car-passive",
        reward="shaped",
    )
    refused(
        r'controlled damper, .* choose reward="relative"',
        gym.make,
        "ISDSuspension-v0",
        network="quarter-car-semiactive",
        reward="shaped",
    )
