"""Policies: memory, files, and the same actions in numpy as in Stable-Baselines3."""

import hashlib
import json
import sys
from importlib.util import find_spec
from itertools import pairwise

import gymnasium
import numpy as np
import pytest
from isd_gym.agents._memory import Memory
from isd_gym.agents.policy import JSON_NAME, SHIPPED, WEIGHTS_NAME, Head, Policy
from isd_gym.baselines import make
from program import read_json, refused, run

from isd_gym import Network
from isd_gym.benchmark.policies import conventional
from isd_gym.physics.vehicle import vehicle

MEMORY = Memory.of(vehicle(Network.load("quarter-car-isd")))


def small_policy(rng, head=None, memory=MEMORY):
    sizes = [memory.width(6), 8, 1]
    layers = [
        (rng.normal(size=(b, a)) / a, rng.normal(size=b)) for a, b in pairwise(sizes)
    ]
    car = Network.load("quarter-car-isd")
    return Policy(layers, memory=memory, head=head or Head("increment"), network=car)


@pytest.fixture
def rng():
    return np.random.default_rng(7)


def drive(policy, steps, seed=3):
    env = gymnasium.make("ISDSuspension-v0")
    obs, _ = env.reset(seed=seed)
    policy.reset()
    seen = []
    for _ in range(steps):
        obs, *_ = env.step(np.array([policy.act(obs)], np.float32))
        seen.append(obs)
    return np.array(seen)


def test_a_residual_of_nothing_is_the_lqg():
    """The filter in float32 and in its own coordinates commands what `isd_gym.baselines.lqg` does, stick and slip included."""
    memory = Policy.load("ppo").memory
    layers = [(np.zeros((1, memory.width(6))), np.zeros(1))]
    policy = Policy(layers, memory=memory, head=Head("residual"))
    assert Memory.from_dict(json.loads(json.dumps(memory.to_dict()))) == memory
    lqg = make("lqg", model=Network.load("quarter-car-isd"))
    env = gymnasium.make_vec("ISDSuspension-v0", 8, autoreset_mode="disabled")
    obs, _ = env.reset(seed=5)
    lqg.reset_batch(8)
    apart, features = [], []
    for _ in range(600):
        wanted = lqg.act_batch(obs)
        present = obs[:, 5]
        own = present + np.clip(policy.act_batch(obs) - present, -0.5, 0.5)
        apart.append(np.abs(own - wanted).max())
        features.append(policy._recall.features.copy())
        obs, *_ = env.step(wanted[:, None])
    assert np.max(apart) < 2e-3  # A
    z = np.array(features)[100:, :, -10:-3]
    size = np.sqrt((z**2).mean(axis=(0, 1)))  # coordinates of about unit size
    assert size.min() > 0.4 and size.max() < 2.0


def test_reset_forgets_and_what_is_not_finite_is_taken_as_nothing(rng):
    policy = small_policy(rng)
    np.testing.assert_array_equal(drive(policy, 20), drive(policy, 20))
    obs = np.full(6, np.nan)
    obs[5] = 1.0
    assert np.isfinite(policy.act(obs)) and np.isfinite(policy.act(np.zeros(6)))


def test_a_folder_gives_the_same_policy_back(rng, tmp_path):
    policy = small_policy(rng)
    policy.info = {"algorithm": "test", "score": {"cost": 0.7}}
    back = Policy.load(policy.save(tmp_path / "p"))
    np.testing.assert_array_equal(drive(policy, 30), drive(back, 30))
    assert back.info == policy.info
    assert back.model == policy.model


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda d: (d / WEIGHTS_NAME).unlink(), f"no {WEIGHTS_NAME}"),
        (lambda d: (d / JSON_NAME).unlink(), f"no {JSON_NAME}"),
        (
            lambda d: (d / WEIGHTS_NAME).write_bytes(
                (d / WEIGHTS_NAME).read_bytes()[:-1] + b"\0"
            ),
            "altered",
        ),
        (lambda d: (d / JSON_NAME).write_text("{"), "not JSON"),
        (lambda d: (d / JSON_NAME).write_bytes(b"\xff\xfe"), "not JSON"),
        (lambda d: (d / JSON_NAME).write_text("[1]"), "schema"),
    ],
)
def test_a_spoilt_folder_is_one_clear_line(rng, tmp_path, spoil, says):
    folder = small_policy(rng).save(tmp_path / "p")
    spoil(folder)
    refused(says, Policy.load, folder)
    (tmp_path / "x.zip").write_bytes(b"PK")
    refused("pickle", Policy.load, tmp_path / "x.zip")


def test_a_car_with_other_inputs_is_refused(rng):
    refused("quarter-car-passive", small_policy(rng).check, "quarter-car-passive")
    small_policy(rng).check(
        Network.load("quarter-car-isd").with_parameters({"body.mass": 400.0})
    )
    refused(
        "filter", small_policy, rng, Head("residual")
    )  # a residual is added to the current of a filter


@pytest.mark.parametrize("name", [p.parent.name for p in SHIPPED.glob("*/policy.json")])
def test_a_shipped_policy_is_what_its_score_says(name):
    policy = Policy.load(name)
    looks = {"observation": policy.observation, "preview": policy.preview or None}
    kind, shape = policy.info["env"]["id"], (8, policy.currents)
    env = gymnasium.make_vec(kind, 8, autoreset_mode="disabled", **looks)
    drive = {"allow_passive": True, "autoreset_mode": "disabled"}
    car = gymnasium.make_vec(kind, 8, network=conventional(policy.model), **drive)
    (obs, _), _ = env.reset(seed=0), car.reset(seed=0)
    own = other = 0.0
    for _ in range(2000):
        obs, reward, *_ = env.step(policy.act_batch(obs).reshape(shape))
        own -= reward.sum()
        other -= car.step(np.zeros(shape))[1].sum()
    change = own / other - 1
    assert change == pytest.approx(policy.info["score"]["cost"]["change"], abs=0.04)
    assert policy.info["training"]["command"].startswith(
        f"isd-gym train {policy.info['algorithm']}"
    )


def test_shipped_policies_are_scored_beside_the_baselines_without_torch(
    tmp_path, monkeypatch
):
    """What is shipped is whole (its checksum is that of its weights), small, and ahead of the passive car."""
    for name in ("ppo", "sac"):
        head = read_json(SHIPPED / name / JSON_NAME)
        blob = (SHIPPED / name / WEIGHTS_NAME).read_bytes()
        assert (
            hashlib.sha256(blob).hexdigest() == head["weights"]["sha256"]
            and len(blob) < 100_000
        )
        assert head["training"]["curve"] and head["training"]["versions"]
    for absent in ("torch", "stable_baselines3", "isd_gym.sb3"):
        monkeypatch.setitem(sys.modules, absent, None)
    words = "score passive lqg ppo sac --episodes 2 --json s.json"
    assert run(words, cwd=tmp_path).returncode == 0
    rows = {r["policy"]: r for r in read_json(tmp_path / "s.json")["policies"]}
    for name in ("ppo", "sac"):
        assert rows[name]["cost"]["change"] < -0.15
        assert rows[name]["tyre_load_rms"]["change"] < 0.05
        assert rows[name]["share_of_reachable_gain"] > 0.3
        assert rows[name]["control_time"]["median"] < 1e-3  # 1 kHz


@pytest.fixture
def sb3():
    if find_spec("stable_baselines3") is None:
        pytest.skip("Stable-Baselines3 (and torch) not installed")
    import torch

    torch.set_num_threads(1)
    import stable_baselines3

    return stable_baselines3


def test_the_adapter_is_the_single_environment(sb3):
    from isd_gym.sb3 import make_vec_env

    env = make_vec_env("ISDSuspension-v0", 3)
    env.seed(11)
    obs = env.reset()
    single = gymnasium.make("ISDSuspension-v0")
    alone, _ = single.reset(seed=12)
    np.testing.assert_array_equal(obs[1], alone)
    rng = np.random.default_rng(0)
    for _ in range(50):
        action = rng.uniform(-1, 1, (3, 1)).astype(np.float32)
        obs, rewards, done, infos = env.step(action)
        alone, reward, *_ = single.step(5 * action[1])
        np.testing.assert_array_equal(obs[1], alone)
        assert rewards[1] == pytest.approx(reward, rel=1e-6)
        assert not done.any() and infos == [{}, {}, {}]


def test_the_end_of_an_episode_is_told_as_sb3_wants_it(sb3):
    from isd_gym.sb3 import make_vec_env

    env = make_vec_env(
        "ISDSuspension-v0",
        2,
        rescale=False,
        max_episode_steps=4,
        stagger=True,
        observation="history",
    )
    env.seed(0)
    start = env.reset()
    ends = {}
    for k in range(4):
        obs, _, done, infos = env.step(np.ones((2, 1), np.float32))
        for i in np.flatnonzero(done):
            ends[int(i)] = k
            assert infos[i]["TimeLimit.truncated"]
            # the last observation knows the past, the first of the new episode does not
            assert infos[i]["terminal_observation"][6:].any()
            assert np.all(obs[i, 6:] == 0.0) and obs[i].shape == start[i].shape
    assert ends == {0: 3, 1: 1}  # staggered
