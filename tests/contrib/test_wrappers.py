"""Wrappers for environments of other packages do what the options of this package do."""

import gymnasium
import numpy as np
import pytest
from program import refused

from isd_gym._common.errors import InputError
from isd_gym.benchmark.driving import cost_of
from isd_gym.benchmark.scoring import score
from isd_gym.contrib.wrappers import HistoryObservation, Hold, RelativeReward
from isd_gym.env._history import history_of
from isd_gym.env._task import RELATIVE_SCALE


def made(**options):
    return gymnasium.make("ISDSuspension-v0", disable_env_checker=True, **options)


def test_a_wrapped_environment_equals_the_options():
    own = made(hold=3, duration=1.0)
    other = Hold(made(duration=1.0), 3)
    own.reset(seed=2), other.reset(seed=2)
    rng = np.random.default_rng(0)
    for _ in range(60):
        action = rng.uniform(-5, 5, 1)
        a, b = own.step(action), other.step(action)
        np.testing.assert_array_equal(a[0], b[0])
        assert a[1] == pytest.approx(b[1], rel=1e-12)
    car = own.unwrapped.task.vehicle
    own, other = made(observation="history"), HistoryObservation(made(), history_of(car))
    np.testing.assert_array_equal(own.reset(seed=4)[0], other.reset(seed=4)[0])
    for _ in range(50):
        action = rng.uniform(-5, 5, 1)
        np.testing.assert_array_equal(own.step(action)[0], other.step(action)[0])
    own = made(reward="relative")
    other = RelativeReward(made(), made(), np.zeros(1, np.float32), RELATIVE_SCALE)
    own.reset(seed=4), other.reset(seed=4)
    for _ in range(50):
        action = rng.uniform(-5, 5, 1)
        assert own.step(action)[1] == pytest.approx(other.step(action)[1], abs=1e-12)


def test_a_pendulum_of_gymnasium():
    one, two = (gymnasium.make("Pendulum-v1", max_episode_steps=40) for _ in range(2))
    env = Hold(RelativeReward(one, two, np.zeros(1, np.float32)), 4)
    env.reset(seed=0)
    for k in range(10):
        _, reward, _, truncated, _ = env.step(np.zeros(1, np.float32))
        assert reward == 0.0 and truncated == (k == 9)  # it does what its reference does


def test_the_cost_is_the_score_s():
    idle = cost_of(lambda features: np.zeros((len(features), 1)), roads=2, duration=2.0)
    found = score(["isd-passive"], episodes=2, duration=2.0)
    assert idle == pytest.approx(found.policies[-1]["cost"]["value"], rel=1e-4)


def test_refusals():
    refused("hold must be a whole number", Hold, made(), 0)
    env = made()
    refused("of its own", RelativeReward, env, env, np.zeros(1, np.float32))
    refused("cannot do", RelativeReward, env, made(), np.full(1, 9.0, np.float32))
    with pytest.raises(InputError, match="one of 6 signals"):
        HistoryObservation(made(observation="full"), history_of(env.unwrapped.task.vehicle))
    short = RelativeReward(env, made(duration=0.01), np.zeros(1, np.float32))
    short.reset(seed=0)
    short.step(np.zeros(1, np.float32))
    refused("cannot go on", short.step, np.zeros(1, np.float32))
