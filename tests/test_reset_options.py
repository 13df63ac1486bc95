"""Road and speed as options of `reset`."""

import gymnasium
import numpy as np
import pytest
from program import refused

import isd_gym  # noqa: F401


def drive(env, shape, **arguments):
    """Observations and rewards of 30 steps after a reset."""
    rng = np.random.default_rng(0)
    rows = [env.reset(**arguments)[0]]
    for _ in range(30):
        observation, reward, _, _, info = env.step(
            rng.uniform(-1, 1, shape).astype(np.float32)
        )
        rows.append(np.append(observation, reward))
    assert np.all(info["speed"] == 30.0)
    return np.concatenate([np.ravel(row) for row in rows])


@pytest.mark.parametrize("name", ["ISDSuspension-v0", "ISDFullCar-v0"])
@pytest.mark.parametrize("reward", ["cost", "relative"])
@pytest.mark.parametrize("is_vector", [False, True])
def test_a_reset_changes_road_and_speed_of_all_following_episodes(
    name, reward, is_vector
):
    def make(**options):
        if is_vector:
            return gymnasium.make_vec(name, 3, reward=reward, **options)
        return gymnasium.make(name, reward=reward, **options)

    there, env = make(road="C+bump", speed=30.0), make()
    env.reset(seed=1)
    options = {"road": "C+bump", "speed": 30.0}
    shape = env.action_space.shape
    np.testing.assert_array_equal(
        drive(env, shape, seed=3, options=options), drive(there, shape, seed=3)
    )
    np.testing.assert_array_equal(
        drive(env, shape, seed=4), drive(there, shape, seed=4)
    )
    on_scoring_road = {"options": {"scoring_road": 2}}
    np.testing.assert_array_equal(
        drive(env, shape, **on_scoring_road), drive(there, shape, **on_scoring_road)
    )


@pytest.mark.parametrize(
    ("options", "reset", "says"),
    [
        ({}, {"road": "Z"}, "road"),
        ({}, {"speed": 0.0}, "speed must be a number"),
        (
            {},
            {"mass": 3.0},
            "reset has the options road, speed, scoring_road, not 'mass'",
        ),
        (
            {"randomize": {"speed": (10, 30)}},
            {"speed": 20.5},
            "randomize draws the speed",
        ),
        (
            {"network": "half-car-isd"},
            {"speed": 5.0},
            "make the environment with speed=5",
        ),
    ],
)
def test_an_option_that_does_not_fit_is_one_line(options, reset, says):
    env = gymnasium.make("ISDSuspension-v0", **options)
    first, _ = env.reset(seed=0)
    refused(says, env.reset, options=reset)
    again, info = env.reset(seed=0)
    np.testing.assert_array_equal(first, again)
