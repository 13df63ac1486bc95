"""Archives of stock Stable-Baselines3 in scores, and scores during a training."""

import base64
import json
import pickle
import zipfile

import gymnasium as gym
import numpy as np
import pytest
from isd_gym.agents._archives import convert
from isd_gym.agents.policy import Policy
from program import read_json, refused, run

from isd_gym import Network
from isd_gym.benchmark.policies import find, passive
from isd_gym.benchmark.scoring import Conditions, drive

sb3 = pytest.importorskip("stable_baselines3")
from isd_gym.sb3 import ScoreCallback, make_vec_env, save_model  # noqa: E402

pytestmark = pytest.mark.filterwarnings("ignore")
CAR = "quarter-car-isd"


def algorithm(kind):
    if hasattr(sb3, kind):
        return getattr(sb3, kind)
    return getattr(pytest.importorskip("sb3_contrib"), kind)


def learner(kind, env, **options):
    small = dict(policy_kwargs=dict(net_arch=[16, 8]), seed=1, device="cpu") | options
    if kind in ("PPO", "A2C"):
        small |= dict(n_steps=16) | (dict(batch_size=16) if kind == "PPO" else {})
    else:
        small |= dict(learning_starts=16, batch_size=8, buffer_size=1000)
    return algorithm(kind)("MlpPolicy", env, **small)


def rewritten(path, change):
    """Apply `change` to the description in an archive."""
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    data = json.loads(parts["data"])
    change(data)
    parts["data"] = json.dumps(data).encode()
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in parts.items():
            archive.writestr(name, content)
    return path


def without_options(path):
    return rewritten(path, lambda data: data["observation_space"].pop("isd_gym"))


def assert_drives_as_predicted(policy, model, network, *, steps=400):
    """The policy on measured signals commands what `model.predict` does on histories, step by step."""
    drives = dict(network=network, autoreset_mode="disabled")
    histories = gym.make_vec(
        "ISDSuspension-v0", 2, observation="history", action="share", **drives
    )
    signals = gym.make_vec("ISDSuspension-v0", 2, **drives)
    seen, _ = histories.reset(seed=5)
    measured, _ = signals.reset(seed=5)
    normalize = model.get_vec_normalize_env()
    policy.reset_batch(2)
    largest = 0.0
    for _ in range(steps):
        features = seen if normalize is None else normalize.normalize_obs(seen)
        shares, _ = model.predict(features, deterministic=True)
        wanted = 5.0 * shares
        commanded = np.reshape(policy.act_batch(measured), wanted.shape)
        np.testing.assert_allclose(commanded, wanted, atol=2e-4)
        largest = max(largest, np.abs(wanted).max())
        seen, *_ = histories.step(shares)
        measured, *_ = signals.step(wanted.astype(np.float32))
    assert largest > 0.05  # the policy does something


@pytest.mark.parametrize(
    ("kind", "network", "is_stored", "is_normalized"),
    [
        ("PPO", CAR, True, False),
        ("PPO", CAR, False, True),
        ("SAC", CAR, True, True),
        ("PPO", "half-car-isd", False, False),
        *(
            pytest.param(*row, marks=pytest.mark.slow)
            for row in (
                ("SAC", CAR, False, False),
                ("A2C", CAR, True, False),
                ("TD3", CAR, True, False),
                ("DDPG", CAR, False, False),
                ("TQC", CAR, False, True),
            )
        ),
    ],
)
def test_a_stock_model_is_scored_as_it_predicts(
    kind, network, is_stored, is_normalized, tmp_path
):
    from stable_baselines3.common.vec_env import VecNormalize

    env = make_vec_env(4, cars_per_road=2, network=network)
    if is_normalized:
        env = VecNormalize(env, clip_obs=5.0)
    model = learner(kind, env).learn(400)
    save_model(model, tmp_path / "m.zip")
    if not is_stored:
        without_options(tmp_path / "m.zip")
    assert_drives_as_predicted(
        convert(tmp_path / "m.zip", network=network), model, network
    )
    brief = f"--episodes 1 --duration 1 --network {network} --json"
    code, out, err = run("score", tmp_path / "m.zip", brief, tmp_path / "s.json")
    assert code == 0 and "m " in out, err
    assert ("m_vecnormalize.pkl" in err) == is_normalized
    held = read_json(tmp_path / "s.json")
    assert [row["policy"] for row in held["policies"]] == ["passive", "m"]


@pytest.mark.parametrize(
    ("order", "env_id"),
    [
        ("stack", "ISDSuspension-v0"),
        ("stack, normalise", "ISDSuspension-v0"),
        ("normalise, stack", "ISDSuspensionLearning-v0"),
    ],
)
def test_a_stack_of_observations_is_scored_as_it_predicts(order, env_id, tmp_path):
    """An observation of k times the width is a stack, by its file and during a training."""
    from stable_baselines3.common.vec_env import VecFrameStack, VecNormalize

    env = make_vec_env(env_id, 4)
    for wrap in order.split(", "):
        env = VecFrameStack(env, 3) if wrap == "stack" else VecNormalize(env)
    callback = ScoreCallback(1000, save=tmp_path / "m", **SHORT)
    model = learner("PPO", env).learn(64, callback=callback)
    code, _, err = run("score", tmp_path / "m.zip", "--episodes 1 --duration 0.1")
    assert code == 0, err
    found = callback._cost(find(str(tmp_path / "m.zip"), Network.load(CAR)))
    assert found == pytest.approx(callback.history[-1][1], rel=1e-3)
    policy = Policy.load(convert(tmp_path / "m.zip").save(tmp_path / "folder"))
    assert policy.memory.frames == 3
    if order != "normalise, stack":
        env.seed(1)
        env.training = False  # the statistics stay those of the file
        seen = env.reset()
        policy.reset_batch(4)
        for _ in range(20):
            actions, _ = model.predict(seen, deterministic=True)
            raw = seen if order == "stack" else env.get_original_obs()
            np.testing.assert_allclose(
                policy.act_batch(raw[:, -6:]), 5 * actions[:, 0], atol=1e-4
            )
            seen = env.step(actions)[0]


def test_a_converted_history_is_bounded_before_it_is_normalised(tmp_path):
    """An environment clips its histories to ±10; the policy, its folder and its C do so as well."""
    from stable_baselines3.common.vec_env import VecNormalize

    env = VecNormalize(make_vec_env(4, cars_per_road=2), clip_obs=100.0)
    model = learner("PPO", env).learn(64)
    save_model(model, tmp_path / "m.zip")
    policy = convert(tmp_path / "m.zip")
    loaded = Policy.load(policy.save(tmp_path / "folder"))
    shape = (50, env.observation_space.shape[0])
    features = np.random.default_rng(0).uniform(-40, 40, shape).astype(np.float32)
    wanted, _ = model.predict(
        env.normalize_obs(np.clip(features, -10, 10)), deterministic=True
    )
    for own in (policy, loaded):
        np.testing.assert_allclose(own.share(features), wanted, atol=1e-5)


def test_the_environment_leaves_its_options_in_the_archive(tmp_path):
    """Measured signals with increments cannot be told from their spaces: the archive says it, or the user."""
    env = make_vec_env("ISDSuspension-v0", 4, action="increment")
    learner("PPO", env).learn(64).save(tmp_path / "m.zip")
    assert convert(tmp_path / "m.zip").head.mode == "increment"
    without_options(tmp_path / "m.zip")
    assert convert(tmp_path / "m.zip").head.mode == "target"
    entry = find(str(tmp_path / "m.zip"), Network.load(CAR), trained="action=increment")
    assert entry.make().head.mode == "increment"
    # the single environment, made by Stable-Baselines3 itself, leaves them as well
    learner("PPO", "ISDSuspensionLearning-v0").learn(32).save(tmp_path / "n.zip")
    held = json.loads(zipfile.ZipFile(tmp_path / "n.zip").read("data"))[
        "observation_space"
    ]["isd_gym"]
    assert held == {
        "network": CAR, "observation": "history", "action": "share", "hold": 1, "control_step": 0.005, "preview": None,
    }  # fmt: skip


def test_a_policy_that_learned_nothing_is_told_so(tmp_path, capsys):
    """The default policy of a new model has currents of some mA."""
    callback = ScoreCallback(10_000, roads=2, duration=0.5, references=())
    learner("PPO", "ISDSuspension-v0").learn(32, callback=callback).save(
        tmp_path / "m.zip"
    )
    assert "the cost of zero current" in capsys.readouterr().out
    words = "score --episodes 2 --duration 0.5 passive isd-passive skyhook"
    err = run(words, tmp_path / "m.zip")[2]
    assert err.count("what zero current costs") == 1
    assert "ISDSuspensionLearning-v0" in err
    assert "m.zip" in err or "'m'" in err


class Bomb:
    def __reduce__(self):
        return exec, ("raise SystemExit('code of the archive was run')",)


def test_nothing_of_an_archive_is_run(tmp_path):
    learner("PPO", make_vec_env(2)).learn(32).save(tmp_path / "m.zip")

    def plant(data):
        for held in data.values():
            if isinstance(held, dict) and ":serialized:" in held:
                held[":serialized:"] = base64.b64encode(pickle.dumps(Bomb())).decode()

    rewritten(tmp_path / "m.zip", plant)
    brief = "--episodes 1 --duration 0.1"
    assert run("score", tmp_path / "m.zip", brief)[0] == 0
    (tmp_path / "vecnormalize.pkl").write_bytes(pickle.dumps(Bomb()))
    code, _, err = run("score", tmp_path / "m.zip", brief)
    assert code == 2 and "not a saved VecNormalize" in err
    none = "--trained-with normalize=none"
    assert run("score", tmp_path / "m.zip", none, brief)[0] == 0


class Pictures(gym.Env):
    observation_space = gym.spaces.Box(0, 255, (36, 36, 3), np.uint8)
    action_space = gym.spaces.Box(-1, 1, (1,))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return self.observation_space.sample(), {}

    def step(self, action):
        return self.observation_space.sample(), 0.0, False, False, {}


class Named(Pictures):
    observation_space = gym.spaces.Dict({"a": gym.spaces.Box(-1, 1, (2,))})


def other_archives(folder):
    """Archives that are no flat policies, and what is said of them."""
    env = make_vec_env(2)
    usual = learner("PPO", env).learn(32)
    usual.save(folder / "usual.zip")
    whole = (folder / "usual.zip").read_bytes()
    (folder / "short.zip").write_bytes(whole[: len(whole) // 2])
    sb3.PPO("CnnPolicy", Pictures(), n_steps=8, batch_size=8).save(folder / "cnn.zip")
    sb3.PPO("MultiInputPolicy", Named(), n_steps=8, batch_size=8).save(
        folder / "dict.zip"
    )
    learner("PPO", env, use_sde=True).save(folder / "sde.zip")
    learner("SAC", env, use_sde=True).save(folder / "sac-sde.zip")
    learner("PPO", make_vec_env(2, observation="full")).save(folder / "full.zip")
    learner("PPO", make_vec_env(2, network="half-car-isd")).save(folder / "half.zip")
    contrib = pytest.importorskip("sb3_contrib")
    contrib.RecurrentPPO("MlpLstmPolicy", env, n_steps=8, batch_size=8).save(
        folder / "lstm.zip"
    )
    return {
        "short": "not a whole one", "cnn": "observations of shape", "dict": "not a Box", "sac-sde": "gSDE",
        "full": "observation 'full'", "half": "history of half-car-isd", "lstm": "recurrent", "sde": None,
    }  # fmt: skip


def test_other_archives_are_one_line(tmp_path):
    for name, says in other_archives(tmp_path).items():
        code, _, err = run(
            "score", tmp_path / f"{name}.zip", "--episodes 1 --duration 0.1"
        )
        assert code == (0 if says is None else 2), (name, err)
        if says is not None:
            assert says in err and len(err.splitlines()) == 1, (name, err)


def test_a_file_that_does_not_run_is_one_line(tmp_path):
    (tmp_path / "m.py").write_text("x = 1\ny = x +\n")
    for name, says in (
        ("m.py:A", "m.py:2: SyntaxError"),
        ("none.py:A", "no Python file"),
    ):
        code, _, err = run("score", tmp_path / name, "--episodes 1 --duration 0.1")
        assert code == 2 and says in err and len(err.splitlines()) == 1


SHORT = dict(references=["skyhook"], roads=2, duration=0.5, verbose=0)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["PPO", "SAC", "TD3", "TQC"])
@pytest.mark.parametrize("is_normalized", [False, True])
def test_scores_do_not_disturb_the_training(kind, is_normalized, tmp_path):
    from stable_baselines3.common.vec_env import VecNormalize

    weights = []
    for callback in (None, ScoreCallback(100, save=tmp_path / "best", **SHORT)):
        env = make_vec_env(4, cars_per_road=2)
        model = learner(kind, VecNormalize(env) if is_normalized else env).learn(
            400, callback=callback
        )
        weights.append(model.policy.state_dict())
    for name, value in weights[0].items():
        assert (value == weights[1][name]).all(), name
    steps = [row[0] for row in callback.history]
    assert steps[-1] == model.num_timesteps and 4 <= len(steps) <= 5
    assert list(callback.references) == ["skyhook"]
    # the saved model is the best one: driven from its file, it has the best J
    entry = find(str(tmp_path / "best.zip"), Network.load(CAR))
    found = callback._cost(entry)
    assert found == pytest.approx(
        min(cost for _, cost, _ in callback.history), rel=1e-4
    )


def test_scores_are_logged(tmp_path, capsys):
    tensorboard = pytest.importorskip(
        "tensorboard.backend.event_processing.event_accumulator"
    )
    model = learner(
        "SAC", "ISDSuspensionLearning-v0", tensorboard_log=str(tmp_path)
    )  # one car
    model.learn(60, callback=ScoreCallback(30, **SHORT | dict(verbose=1)))
    lines = [
        line
        for line in capsys.readouterr().out.splitlines()
        if line.startswith("score:")
    ]
    assert (
        len(lines) == 3 and "skyhook" in lines[0] and "% against passive" in lines[-1]
    )
    events = tensorboard.EventAccumulator(str(next(tmp_path.glob("SAC*"))))
    events.Reload()
    assert {"score/J", "score/change_percent", "score/skyhook_percent"} <= set(
        events.Tags()["scalars"]
    )
    assert [e.step for e in events.Scalars("score/J")] == [30, 60]


def test_references_on_validation_roads_are_those_of_drive():
    """J and changes are what `drive` says on the same roads, whose seeds no training has."""
    from isd_gym.sb3 import VALIDATION_SEED

    callback = ScoreCallback(100, **SHORT)
    learner("PPO", make_vec_env(4, network="half-car-isd")).learn(64, callback=callback)
    net = Network.load("half-car-isd")
    drives = Conditions(episodes=2, duration=0.5, seed=VALIDATION_SEED)
    cost = callback._task.cost
    base = drive(passive(net), net, drives).cost(cost).mean()
    own = drive(find("skyhook", net, speed=20.0), net, drives).cost(cost).mean()
    assert callback.references["skyhook"] == pytest.approx(
        100 * (own / base - 1), rel=1e-9
    )


def test_a_callback_with_wrong_arguments_is_refused(tmp_path):
    for wrong in (
        dict(every=0),
        dict(every=1.5),
        dict(roads=0),
        dict(duration=0.0),
        dict(references="mpc"),
    ):
        refused("", ScoreCallback, **wrong)
    refused("", ScoreCallback, save=tmp_path / "none" / "best.zip")
    refused(
        "environments of isd_gym",
        learner("PPO", "Pendulum-v1").learn,
        32,
        callback=ScoreCallback(**SHORT),
    )
    refused(
        "no policy 'mpd'",
        learner("PPO", make_vec_env(2)).learn,
        32,
        callback=ScoreCallback(**SHORT | dict(references=["mpd"])),
    )
