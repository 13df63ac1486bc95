"""The environments as other libraries drive them: Gymnasium's wrappers, TorchRL, skrl, SB3-contrib, RLlib.

Each drives the cars through its own classes and must find what the environment itself says: the same observations,
rewards and ends of episodes, for the same seeds and currents.
"""

import gymnasium as gym
import gymnasium.wrappers as single
import gymnasium.wrappers.vector as vector
import numpy as np
import pytest

pytestmark = pytest.mark.tools

NAME = "ISDSuspension-v0"
CARS, STEPS = 3, 30
STEP_INFO = gym.make(NAME).unwrapped.task.step_info
KEYS = {"speed", "cost", *STEP_INFO}
#: what these libraries warn of is theirs
theirs = pytest.mark.filterwarnings("ignore")


def cars(**options):
    return gym.make_vec(NAME, CARS, max_episode_steps=STEPS, **options)


def currents(steps, count=CARS, seed=0):
    return (
        np.random.default_rng(seed).uniform(-5, 5, (steps, count, 1)).astype(np.float32)
    )


def returns(steps=STEPS):
    """Sum of rewards of every car over an episode, by the environment itself."""
    env = cars()
    env.reset(seed=0)
    return sum(env.step(a)[1] for a in currents(steps))


@theirs
def test_wrappers_of_one_car():
    env = gym.make(NAME, max_episode_steps=STEPS)
    for wrap in (
        lambda e: single.RescaleAction(e, -1.0, 1.0),
        single.TimeAwareObservation,
        single.NormalizeObservation,
        lambda e: single.NormalizeReward(e, gamma=0.99),
        lambda e: single.FrameStackObservation(e, 4),
        single.RecordEpisodeStatistics,
    ):
        env = wrap(env)
    obs, info = env.reset(seed=0)
    assert obs.shape == (4, 7) and set(info) == KEYS
    for a in currents(STEPS)[:, 0]:
        obs, _, terminated, truncated, info = env.step(a / 5)
    assert truncated and not terminated and np.isfinite(obs).all()
    assert set(info) == KEYS | {"episode"} and info["episode"]["l"] == STEPS


@theirs
def test_wrappers_of_many_cars():
    env = vector.RecordEpisodeStatistics(cars())
    env = vector.ClipAction(vector.RescaleAction(env, -1.0, 1.0))
    env = vector.DictInfoToList(
        vector.NormalizeReward(vector.NormalizeObservation(env))
    )
    obs, info = env.reset(seed=0)
    assert obs.shape == (CARS, 6) and [set(i) for i in info] == [KEYS] * CARS
    for a in currents(STEPS):
        _, _, _, truncated, info = env.step(a / 5)
    assert truncated.all()
    np.testing.assert_allclose([i["episode"]["r"] for i in info], returns(), rtol=1e-5)


@theirs
def test_videos(tmp_path):
    """Films of Gymnasium's recorders run in real time."""
    if not hasattr(vector, "RecordVideo"):
        pytest.skip("this Gymnasium has no recorder of batches")
    pytest.importorskip("pygame", reason="pictures need isd-gym[render]")
    pytest.importorskip("moviepy", reason="RecordVideo needs isd-gym[render]")
    import imageio.v3 as iio

    steps = 20
    one, twin = (
        gym.make(NAME, render_mode="rgb_array", max_episode_steps=steps)
        for _ in range(2)
    )
    env = single.RecordVideo(one, str(tmp_path / "one"))
    many = vector.RecordVideo(
        cars(render_mode="rgb_array"), str(tmp_path / "many"), video_length=steps
    )
    env.reset(seed=0), many.reset(seed=0), twin.reset(seed=0)
    drawn = [twin.render()]
    for a in currents(steps):
        over = env.step(a[0])[3]
        twin.step(a[0])
        many.step(a)
        drawn.append(twin.render())
    assert over
    np.testing.assert_array_equal(env.recorded_frames, drawn)
    env.close(), many.close()
    for folder, tiles in (("one", 1), ("many", CARS)):
        (film,) = (tmp_path / folder).glob("*.mp4")
        about = iio.immeta(film, plugin="FFMPEG")
        assert about["fps"] == 200
        assert about["size"][0] * about["size"][1] == tiles * 960 * 600
        if folder == "one":
            assert about["duration"] == pytest.approx(steps / 200, abs=0.021)


@theirs
@pytest.mark.parametrize("kind", ["GymEnv", "same_step", "disabled"])
def test_torchrl(kind):
    envs = pytest.importorskip(
        "torchrl.envs", reason="TorchRL is of isd-gym[libraries]"
    )
    if kind == "GymEnv":
        env, count = envs.GymEnv(NAME, max_episode_steps=STEPS), 1
    else:
        env, count = envs.GymWrapper(cars(autoreset_mode=kind)), CARS
    envs.check_env_specs(env)
    assert env.batch_size == (() if kind == "GymEnv" else (CARS,))
    env.set_seed(0)
    whole = env.rollout(2 * STEPS + 5, break_when_any_done=False)
    assert (
        whole["next", "done"].sum() == 2 * count
        and not whole["next", "terminated"].any()
    )
    assert (
        whole["next", "reward"].isfinite().all()
        and (whole["next", "reward"] <= 0).all()
    )


@theirs
def test_skrl():
    torch = pytest.importorskip("torch", reason="skrl needs torch")
    wrappers = pytest.importorskip(
        "skrl.envs.wrappers.torch", reason="skrl is of isd-gym[libraries]"
    )
    env = wrappers.wrap_env(cars(), verbose=False)
    assert env.num_envs == CARS
    env._env.reset(seed=0)
    env._reset_once = False
    total = sum(env.step(torch.from_numpy(a))[1].numpy()[:, 0] for a in currents(STEPS))
    np.testing.assert_allclose(total, returns(), rtol=1e-5)


@theirs
@pytest.mark.slow
def test_rllib_trains():
    pytest.importorskip("ray.rllib", reason="RLlib is of isd-gym[ray]")
    import ray
    from ray.rllib.algorithms.ppo import PPOConfig

    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    try:
        config = (
            PPOConfig()
            .environment(f"isd_gym:{NAME}", env_config={"max_episode_steps": 200})
            .env_runners(num_env_runners=1, rollout_fragment_length=200)
            .training(
                train_batch_size_per_learner=400, minibatch_size=100, num_epochs=1
            )
        )
        algorithm = config.build_algo()
        found = algorithm.train()["env_runners"]
        assert (
            found["episode_len_mean"] == 200
            and -2000 < found["episode_return_mean"] < 0
        )
        algorithm.stop()
    finally:
        ray.shutdown()
