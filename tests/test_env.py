"""The environments as Gymnasium and Stable-Baselines3 users meet them."""

import pickle
import sys
import warnings

import gymnasium as gym
import numpy as np
import pytest
from builders import element, friction
from gymnasium.utils.env_checker import check_env
from program import python, refused

from isd_gym import ISDSuspensionEnv, Network


def misspelt(node, name):
    """The quarter car with another name of a mass."""
    model = Network.load("quarter-car-isd").to_dict()
    model["masses"][name] = model["masses"].pop(node)
    return model | {"uncertainty": {}}


def rollout(env, seed, steps=300):
    rng = np.random.default_rng(seed)
    obs, _ = env.reset(seed=seed)
    out = [obs]
    for _ in range(steps):
        obs, reward, *_ = env.step(rng.uniform(-5, 5, 1).astype(np.float32))
        out.append(np.append(obs, reward))
    return out


def test_twin_rollouts_and_global_state():
    np.random.seed(7)  # noqa: NPY002
    before = pickle.dumps(np.random.get_state())  # noqa: NPY002
    a, b = (rollout(gym.make("ISDSuspension-v0"), 5) for _ in range(2))
    for x, y in zip(a, b, strict=True):
        np.testing.assert_array_equal(x, y)
    assert pickle.dumps(np.random.get_state()) == before  # noqa: NPY002
    other = rollout(gym.make("ISDSuspension-v0"), 6)
    assert not np.array_equal(a[-1], other[-1])


def test_pickling_in_mid_episode():
    env = ISDSuspensionEnv()
    env.reset(seed=1)
    for _ in range(50):
        env.step(np.full(1, 3.0, np.float32))
    copy = pickle.loads(pickle.dumps(env))
    one = np.ones(1, np.float32)
    for _ in range(50):
        np.testing.assert_array_equal(env.step(one)[0], copy.step(one)[0])


def test_reward_is_minus_the_stage_cost_of_section_4_2():
    env = gym.make("ISDSuspension-v0")
    env.reset(seed=0)
    for _ in range(100):
        obs, reward, _, _, info = env.step(np.full(1, 2.0, np.float32))
        by_hand = (
            0.6 * (float(obs[0]) / 0.8306) ** 2 + 0.3 * (float(obs[1]) / 7.6e-3) ** 2
        )
        assert reward == pytest.approx(-by_hand, rel=1e-5)
        assert reward == pytest.approx(
            -sum(v for k, v in info.items() if k.startswith("cost_"))
        )


def test_autoreset_as_gymnasium_has_it():
    env = gym.make_vec("ISDSuspension-v0", 3, max_episode_steps=5)
    assert env.metadata["autoreset_mode"] is gym.vector.AutoresetMode.NEXT_STEP
    env.reset(seed=0)
    steps = [env.step(np.ones((3, 1), np.float32)) for _ in range(13)]
    # after a truncated step one more that resets, without a reward, then five of the new episode
    assert [k for k, step in enumerate(steps) if step[3].all()] == [4, 10]
    assert [k for k, step in enumerate(steps) if not step[1].any()] == [5, 11]
    env = gym.make_vec(
        "ISDSuspension-v0", 3, max_episode_steps=5, autoreset_mode="same_step"
    )
    env.reset(seed=0)
    for _ in range(5):
        obs, *_, info = env.step(np.ones((3, 1), np.float32))
    assert (
        not obs.any()
        and info["_final_obs"].all()
        and info["final_obs"][0][5] == pytest.approx(1.0)
    )


@pytest.mark.parametrize(
    ("options", "steps"),
    [
        ({}, 4000),
        ({"max_episode_steps": 8000}, 8000),
        ({"duration": 1.0}, 200),
        ({"control_step": 0.01}, 2000),
    ],
)
def test_the_length_of_an_episode_is_told(options, steps):
    env = gym.wrappers.TimeAwareObservation(gym.make("ISDSuspension-v0", **options))
    again = gym.make(env.spec)
    many = gym.make_vec("ISDSuspension-v0", 2, **options)
    for made in (env, again, many):
        assert made.spec.max_episode_steps == steps
        made.reset(seed=0)
        action = np.zeros(made.action_space.shape, np.float32)
        ends = [np.any(made.step(action)[3]) for _ in range(steps)]
        assert ends[-1] and not any(ends[:-1])


def test_pictures_without_pygame_are_refused_as_gymnasium_does(monkeypatch):
    monkeypatch.setitem(sys.modules, "pygame", None)
    for make in (gym.make, gym.make_vec):
        with pytest.raises(
            gym.error.DependencyNotInstalled, match="pygame-ce: pip install"
        ):
            make("ISDSuspension-v0", render_mode="rgb_array")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (
            {"network": "quarter-car-passive"},
            "no motor.*quarter-car-isd.*allow_passive=True",
        ),
        (
            {"randomize": {"body.mass": (300, 400)}},
            r"'body.mass' has factors on 345.*give \(0.87, 1.16\)",
        ),
        ({"randomize": {"body.mass": (0.01, 1.0)}}, "0.1 to 10"),
        (
            {"network": misspelt("body", "bdoy")},
            "masses: no element is at 'bdoy'; did you mean 'body'",
        ),
    ],
)
def test_options_without_sense_are_refused(options, words):
    for make in (gym.make, gym.make_vec):
        refused(words, make, "ISDSuspension-v0", **options)


@pytest.mark.parametrize("seed", [1.5, "abc", [0, 1.5], [0, "1"], [True, 1]])
def test_a_seed_of_a_batch_is_whole_numbers(seed):
    env = gym.make_vec("ISDSuspension-v0", 2)
    refused("seed must be whole numbers", env.reset, seed=seed)
    env.reset(seed=[3, None]), env.reset(seed=np.array([1, 2]))


def test_an_infinite_action_of_a_batch_is_refused_without_a_warning():
    many = gym.make_vec("ISDSuspension-v0", 3)
    many.reset(seed=0)
    actions = np.zeros((3, 1), np.float32)
    actions[1] = np.inf
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        refused("action 1 is not finite", many.step, actions)


def test_check_env_passes_with_and_without_pygame(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        check_env(gym.make("ISDSuspension-v0").unwrapped)
    assert not any("render" in str(w.message) for w in seen)
    code = """if True:
        import sys
        sys.modules["pygame"] = None
        import gymnasium
        from gymnasium.utils.env_checker import check_env
        check_env(gymnasium.make("ISDSuspension-v0").unwrapped)
    """
    done = python(code)
    assert done.returncode == 0 and "render" not in done.stderr, done.stderr


@pytest.mark.slow
def test_model_file_with_found_effects_runs_as_env(tmp_path):
    net = Network.load("quarter-car-isd")
    for extra in (
        friction("body", "wheel", 80.0),
        {
            "name": "lag",
            "type": "actuator_lag",
            "element": "motor",
            "time_constant": 0.01,
        },
        {"name": "late", "type": "actuator_delay", "element": "motor", "delay": 0.007},
        {
            "name": "soft",
            "type": "thrust_saturation",
            "element": "motor",
            "current": 4.0,
        },
        {
            "name": "gain",
            "type": "sensor_gain",
            "channel": "body_acceleration",
            "gain": 1.5,
        },
    ):
        net = net.with_element(extra)
    net.save(tmp_path / "model.json")
    env = gym.make("ISDSuspension-v0", network=str(tmp_path / "model.json"))
    env.reset(seed=0)
    for _ in range(200):
        obs, _, terminated, _, info = env.step(np.full(1, 4.0, np.float32))
        assert not terminated
    true = np.sqrt(info["cost_acceleration"] / 0.6) * 0.8306
    assert abs(obs[0]) == pytest.approx(1.5 * true, rel=1e-5)


@pytest.mark.slow
def test_a_car_that_diverges_is_terminated_with_finite_numbers():
    """A damper that drives: reward, observation and info stay finite, alone and in a batch, and both end at the same step."""
    drives = {"extension": -20000.0, "compression": -20000.0}
    driver = element("driver", "asymmetric_damping", "body", "wheel", **drives)
    net = Network.load("quarter-car-passive").with_element(driver)
    car = gym.make("isd_gym:ISDSuspension-v0", network=net, allow_passive=True)
    cars = gym.make_vec("isd_gym:ISDSuspension-v0", 3, network=net, allow_passive=True)
    car.reset(seed=4)
    cars.reset(seed=4)
    for _ in range(4000):
        obs, reward, terminated, truncated, info = car.step(np.zeros(1, np.float32))
        many, rewards, ended, _, infos = cars.step(np.zeros((3, 1), np.float32))
        assert (
            np.isfinite(obs).all()
            and np.isfinite(reward)
            and np.isfinite(list(info.values())).all()
        )
        assert all(np.isfinite(x).all() for x in (many, rewards, infos["tyre_load"]))
        assert obs in car.observation_space
        assert ended[0] == terminated and rewards[0] == reward
        if terminated:
            break
    assert terminated and not truncated
