"""Whatever an environment returns belongs to the caller: writing to it changes nothing that comes later."""

from collections.abc import Mapping

import gymnasium as gym
import numpy as np
import pytest

NAME = "ISDSuspension-v0"
CARS, STEPS = 4, 12
MODES = ["next_step", "same_step", "disabled"]
OPTIONS = {
    "plain": {},
    "drawn": {
        "randomize": {
            "body.mass": (0.8, 1.2),
            "speed": (15.0, 30.0),
            "road": ["A", "B"],
        }
    },
    "remembered": {
        "observation": "history",
        "reward": "relative",
        "action": "increment",
        "hold": 2,
    },
    "noisy": {"sensors": {"noise": 1.0}, "observation": "preview"},
}


def overwrite(value):
    """Write to everything that can be written within a value."""
    if isinstance(value, np.ndarray):
        if value.dtype == object:
            for part in value:
                overwrite(part)
        value[...] = None if value.dtype == object else 1
    elif isinstance(value, Mapping):
        for part in value.values():
            overwrite(part)
        value["written"] = {"by": "the caller"}
    elif isinstance(value, list):
        for part in value:
            overwrite(part)
        value.append("written")
    elif isinstance(value, tuple):
        for part in value:
            overwrite(part)


def assert_twins_agree(one, other, calls):
    """Make the same calls of two equal environments; everything that the first one returns is overwritten."""
    for k, call in enumerate(calls):
        mine, twin = call(one), call(other)
        np.testing.assert_equal(listed(mine), listed(twin), err_msg=f"call {k}")
        overwrite(mine)


def listed(value):
    """Return a value with lists in place of arrays of objects, which numpy does not compare."""
    if isinstance(value, np.ndarray):
        return list(value) if value.dtype == object else value
    if isinstance(value, Mapping):
        return {key: listed(part) for key, part in value.items()}
    return (
        [listed(part) for part in value] if isinstance(value, list | tuple) else value
    )


def actions(k):
    return np.random.default_rng(k).uniform(-1, 1, (CARS, 1)).astype(np.float32)


@pytest.mark.parametrize("options", OPTIONS)
@pytest.mark.parametrize("mode", MODES)
def test_of_a_batch(mode, options):
    one, other = (
        gym.make_vec(
            NAME, CARS, autoreset_mode=mode, max_episode_steps=5, **OPTIONS[options]
        )
        for _ in "12"
    )
    calls = [lambda env: env.reset(seed=0)]
    calls += [lambda env, k=k: env.step(actions(k)) for k in range(STEPS)]
    mask = np.array([True, False, True, False])
    calls.insert(4, lambda env: env.reset(options={"reset_mask": mask.copy()}))
    calls.insert(9, lambda env: env.reset(options={"reset_mask": ~mask}))
    for place in (3, 8):
        calls.insert(place, lambda env: without_generator(env.get_state(1)))
        calls.insert(place, lambda env: env.set_state(2, env.get_state(1)))
    assert_twins_agree(one, other, calls)


@pytest.mark.parametrize("options", OPTIONS)
def test_of_one_car(options):
    one, other = (gym.make(NAME, **OPTIONS[options]).unwrapped for _ in "12")
    calls = [lambda env: env.reset(seed=0)]
    calls += [lambda env, k=k: env.step(actions(k)[0]) for k in range(STEPS)]
    calls.insert(6, lambda env: without_generator(env.get_state()))
    calls += [lambda env: env.reset(), lambda env: env.step(actions(0)[0])]
    assert_twins_agree(one, other, calls)


def without_generator(state):
    return {key: value for key, value in state.items() if key != "rng"}


@pytest.mark.parametrize("options", OPTIONS)
@pytest.mark.parametrize("rescale", [True, False])
def test_of_the_batch_of_stable_baselines3(rescale, options):
    pytest.importorskip("stable_baselines3", reason="of isd-gym[agents]")
    from isd_gym.sb3 import BatchedVecEnv

    given = {"rescale": rescale, "duration": 0.025, **OPTIONS[options]}
    one, other = (BatchedVecEnv(NAME, CARS, **given) for _ in "12")
    calls = [lambda env: env.seed(0), lambda env: env.reset()]
    calls += [lambda env, k=k: without_time(env.step(actions(k))) for k in range(STEPS)]
    assert_twins_agree(one, other, calls)


def test_the_helper_takes_the_arguments_of_stable_baselines3():
    pytest.importorskip("stable_baselines3", reason="of isd-gym[agents]")
    from isd_gym.sb3 import BatchedVecEnv, make_vec_env

    given = {"duration": 0.5}
    cars = make_vec_env("ISDHalfCarLearning-v0", n_envs=3, seed=5, env_kwargs=given)
    twin = BatchedVecEnv("ISDHalfCarLearning-v0", 3, **given)
    twin.seed(5)
    np.testing.assert_array_equal(cars.reset(), twin.reset())
    assert cars.num_envs == 3 and cars.env.max_episode_steps == 100
    ids = {
        env.env.spec.id
        for env in (make_vec_env(n_envs=2), make_vec_env(2), BatchedVecEnv(count=2))
    }
    assert len(ids) == 1


def without_time(step):
    """Return a step of Stable-Baselines3 without the seconds since the start, which twins do not share."""
    for info in step[3]:
        if "t" in info.get("episode", ()):
            info["episode"]["t"] = 0.0
    return step
