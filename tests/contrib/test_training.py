"""Training of policies: imitation, PPO and SAC, checkpoints, and what a killed run leaves."""

import json
import pickle
import shutil
from dataclasses import replace
from operator import attrgetter

import numpy as np
import pytest
from gymnasium import spaces
from isd_gym.agents.policy import Head, Policy
from program import refused

from isd_gym._common.errors import InputError
from isd_gym._common.files import claim_folder
from isd_gym.contrib.training.checkpoint import held
from isd_gym.contrib.training.settings import MEMORY, SETTINGS, PPOSettings, SACSettings, robust

torch = pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")
import isd_gym.contrib.training.train as module  # noqa: E402
from isd_gym.contrib.training.environment import Remember  # noqa: E402
from isd_gym.contrib.training.ppo import GroupBuffer, PPOPolicy  # noqa: E402
from isd_gym.contrib.training.sac import GroupReplayBuffer, SACPolicy  # noqa: E402
from isd_gym.sb3 import make_vec_env  # noqa: E402

load, save = (getattr(pytest.importorskip("safetensors.numpy"), name) for name in ("load", "save"))
train = module.train
torch.set_num_threads(1)
pytestmark = pytest.mark.filterwarnings("ignore")  # torch and tensorboard warn of themselves


@pytest.fixture
def brief(monkeypatch):
    """Training that takes a second: few steps, short validation."""
    monkeypatch.setattr(module, "VALIDATION_EPISODES", 2)
    monkeypatch.setattr(module, "SCORE_EPISODES", 2)
    monkeypatch.setattr(module, "BASELINES", ())
    monkeypatch.setattr(module, "drive", lambda *a, drive=module.drive, **k: drive(*a, **k, duration=0.5))
    monkeypatch.setattr(module, "score", lambda *a, score=module.score, **k: score(*a, **k, duration=0.5))
    few = dict(warm_steps=300, warm_updates=20, evaluations=4, checkpoint_seconds=0.0)
    ppo = PPOSettings(steps=2048, cars=16, horizon=16, tail=8, batch=64, epochs=1, teacher="lqg", **few)
    small = dict(steps=1024, cars=16, batch=32, buffer=512, warm_up=64, critic_updates=4)
    sac = SACSettings(teacher=None, preview=0.05, **small, **few)
    return {"ppo": ppo, "sac": sac}


class Killed(Exception):
    pass


@pytest.mark.parametrize(("algorithm", "least"), [("ppo", 327680), ("sac", 4096)])
def test_fewer_steps_than_a_rollout_are_refused_at_once(algorithm, least, tmp_path):
    words = f"1000 steps are less than one rollout .*: give {least} or more"
    refused(words, train, algorithm, tmp_path / "run", steps=1000)
    assert not (tmp_path / "run").exists()
    assert SETTINGS[algorithm]().rollout == least


def test_a_short_run_of_sac_says_that_its_policy_stays_the_imitation(tmp_path, monkeypatch):
    lines = []
    monkeypatch.setattr(module.Run, "go", lambda self: {})
    module.train("sac", tmp_path / "run", steps=100_000, say=lines.append)
    assert "the policy stays the imitation" in lines[0]
    lines.clear()
    module.train("sac", tmp_path / "run", say=lines.append)
    assert not lines


@pytest.mark.parametrize("algorithm", ["ppo", "sac"])
def test_training_goes_on_where_it_was_killed(brief, algorithm, tmp_path):
    settings, out = brief[algorithm], tmp_path / "run"
    lines = []

    def until_half(line):
        lines.append(line)
        if line.strip().startswith(("50", "56", "62")):
            raise Killed

    with pytest.raises(Killed):
        train(algorithm, out, settings=settings, say=until_half)
    (out / ".checkpoint-000000009999").mkdir()  # a write that was cut short
    kept = json.loads((next(out.glob("checkpoint-*")) / "state.json").read_text())
    more = []
    report = train(algorithm, out, settings=settings, say=more.append)
    assert more[0].startswith("resuming")
    assert all(len(line) <= 80 for line in lines if "M steps" in line)  # no number is split at the edge
    curve = report["training"]["curve"]
    assert curve[: len(kept["curve"])] == kept["curve"] and curve[-1]["steps"] >= settings.steps
    steps = [row["steps"] for row in curve]
    assert steps == sorted(set(steps))
    assert not list(out.glob(".checkpoint-*")) and len(list(out.glob("checkpoint-*"))) == 1
    policy = Policy.load(out / "policy")
    assert policy.info["score"]["episodes"] == 2
    assert policy.info["training"]["seconds"] > kept["seconds"]
    # these settings cannot be typed
    assert policy.info["training"]["command"].startswith("isd_gym.contrib.training.train")
    again = []
    train(algorithm, out, settings=settings, say=again.append)
    assert [row["steps"] for row in Policy.load(out / "policy").info["training"]["curve"]] == steps
    refused("another seed", train, algorithm, out, settings=settings, seed=1)
    refused("other settings", train, algorithm, out, settings=replace(settings, gamma=0.5))


@pytest.mark.parametrize("algorithm", ["ppo", pytest.param("sac", marks=pytest.mark.slow)])
def test_a_checkpoint_is_numbers_alone_and_brings_the_learner_back_whole(
    brief, algorithm, tmp_path, monkeypatch
):
    """Weights, moments, counts and buffer to the last bit; what does not fit, or holds code, is one line."""
    settings, out = brief[algorithm], tmp_path / "run"
    models = []

    class Seen(module.Run):
        def save(self, model):
            models.append(model)
            super().save(model)

    monkeypatch.setattr(module, "Run", Seen)
    module.train(algorithm, out, settings=settings, say=lambda line: None)
    (kept,) = out.glob("checkpoint-*")
    assert {p.suffix for p in kept.iterdir()} <= {".safetensors", ".json", ".npy"}

    def fails(*args, **kwargs):
        raise AssertionError("a pickle was opened")

    for name in ("load", "loads", "Unpickler"):
        monkeypatch.setattr(pickle, name, fails)
    monkeypatch.setattr(torch, "load", fails)
    longer = replace(settings, steps=2 * settings.steps)
    lines = []

    def stop(line):
        lines.append(line)
        raise Killed

    old, read = models[-1], {}

    def remember(place, model, read_=module.checkpoint.read):
        out = read_(place, model)
        read["model"] = model
        return out

    monkeypatch.setattr(module.checkpoint, "read", remember)
    with pytest.raises(Killed):
        module.train(algorithm, out, settings=longer, say=stop)
    new = read["model"]
    assert lines[0].startswith("resuming") and new is not old
    for name in old._get_torch_save_params()[0]:
        a, b = (attrgetter(name)(m).state_dict() for m in (old, new))
        if name.endswith("optimizer"):
            assert a["state"].keys() == b["state"].keys() and len(a["state"]) > 0
            a, b = ({f"{i}{k}": v for i, s in d["state"].items() for k, v in s.items()} for d in (a, b))
        assert a.keys() == b.keys() and all(torch.equal(a[k], b[k]) for k in a)
    assert (old.num_timesteps, old._n_updates) == (new.num_timesteps, new._n_updates)
    if algorithm == "sac":
        assert np.array_equal(old.replay_buffer.observations, new.replay_buffer.observations)
        assert old.replay_buffer.pos == new.replay_buffer.pos
    whole = {p.name: p.read_bytes() for p in kept.iterdir()}
    state = json.loads(whole["state.json"])

    def spoilt(number):
        tensors = load(whole["learner.safetensors"])
        key = max(k for k in tensors if "policy/act" in k and k.endswith("weight"))
        tensors[key] = tensors[key].copy()
        tensors[key].flat[3] = number
        return save(tensors)

    def averages(change):
        tensors = load(whole["learner.safetensors"])
        key = next(k for k in tensors if k.startswith("average/"))
        return save(tensors | {key: np.ascontiguousarray(change(tensors[key]))})

    for name, data, says in (
        ("state.json", json.dumps(state | {"references": {"passive": 0.0}}).encode(), "something else"),
        ("state.json", json.dumps(state | {"seconds": -1}).encode(), "something else"),
        ("learner.safetensors", spoilt(np.nan), "not finite"),
        ("learner.safetensors", spoilt(3e38), "not finite, or beyond"),
        ("learner.safetensors", save(load(whole["learner.safetensors"]) | {"a": np.ones(2)}), "holds 'a'"),
        ("learner.safetensors", averages(lambda mean: mean[:-1]), "of shape"),
        (
            "state.json",
            json.dumps({k: v for k, v in state.items() if k != "schema"}).encode(),
            "other version",
        ),
        ("state.json", json.dumps(state | {"curve": [{"steps": "x"}]}).encode(), "KeyError|something else"),
        ("state.json", json.dumps(state | {"learner": {"updates": 1e300}}).encode(), "cannot be"),
        ("state.json", b"[" * 5000, "levels"),
        ("learner.safetensors", whole["learner.safetensors"][:-5], "no checkpoint"),
        ("learner.safetensors", b"\x80\x04cos\nsystem\n", "no checkpoint"),
    ):
        (kept / name).write_bytes(data)
        refused(says, module.train, algorithm, out, settings=longer, say=lambda line: None)
        (kept / name).write_bytes(whole[name])
    large = load(whole["learner.safetensors"])  # finite numbers, and a network whose answers are not
    for key in large:
        if key.startswith("policy/") and key.endswith(("weight", "log_std")):
            large[key] = np.full_like(large[key], 9e11)
    (kept / "learner.safetensors").write_bytes(save(large))
    refused("not finite", module.train, algorithm, out, settings=longer, say=lambda line: None)


@pytest.mark.slow
def test_training_deletes_nothing_but_its_own_checkpoints(brief, tmp_path):
    """Copies and notes of the user stay, also within a checkpoint that is replaced by the next."""
    settings, out = replace(brief["ppo"], teacher=None), tmp_path / "run"
    train("ppo", out, settings=settings, say=lambda line: None)
    (kept,) = out.glob("checkpoint-*")
    mine = [out / "checkpoint-best", out / f"{kept.name}-mine", out / ".checkpoint-tmp"]
    shutil.copytree(kept, mine[1])
    for folder in (mine[0], mine[2], kept):
        folder.mkdir(exist_ok=True)
        (folder / "note.txt").write_text("precious")
    before = {p: p.read_bytes() for folder in mine for p in folder.iterdir()}
    for _ in range(2):
        train("ppo", out, settings=replace(settings, steps=2 * settings.steps), say=lambda line: None)
        assert {p: p.read_bytes() for folder in mine for p in folder.iterdir()} == before
        assert [p.name for p in kept.iterdir()] == ["note.txt"]
        assert [p.name for p in out.glob("*/state.json") if p.parent not in mine] == ["state.json"]


@pytest.mark.slow
def test_a_training_that_diverges_or_has_nothing_to_learn_is_one_line(brief, tmp_path):
    settings = replace(brief["ppo"], teacher=None)
    refused("does not move the car", train, "ppo", tmp_path / "flat", settings=settings, road="flat")
    wild = replace(settings, learning_rate=1e30)
    refused("not finite after", train, "ppo", tmp_path / "run", settings=wild, say=lambda line: None)


def test_two_trainings_do_not_share_a_folder(tmp_path):
    taken = held(claim_folder(tmp_path / "run", *module.FOLDER), "training run")
    with taken, pytest.raises(InputError, match="another process"):
        train("ppo", tmp_path / "run")
    assert not list((tmp_path / "run").iterdir())
    # a folder of other things is left alone
    (tmp_path / "run" / "thesis.tex").write_text("mine")
    refused("not empty", train, "ppo", tmp_path / "run")
    refused("algorithm", train, "dqn", tmp_path / "run")


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["ppo", "sac"])
def test_ctrl_c_saves_where_it_is_and_says_how_to_go_on(brief, tmp_path, monkeypatch, algorithm):
    """Progress begins at once, never passes the whole, and what was done counts when the run goes on."""
    # a brief training is over before the next word
    monkeypatch.setattr("isd_gym.contrib.training.train.SHOW_EVERY", 0.0)
    told = []
    lines = []

    def watch(task, share):
        told.append((task, share))
        if task == "training" and share > 0.4:
            raise KeyboardInterrupt

    settings = replace(brief[algorithm], checkpoint_seconds=1e9)
    out = tmp_path / "my run"
    with pytest.raises(KeyboardInterrupt):
        train(algorithm, out, settings=settings, say=lines.append, progress=watch)
    (saved,) = out.glob("checkpoint-*")
    done = int(saved.name.removeprefix("checkpoint-"))
    assert 0.4 * settings.steps < done < settings.steps
    assert "this goes on from there" in lines[-1]
    assert told[0] == ("preparing", 0.0) and all(0 <= share <= 1 for _, share in told)
    assert ("imitating lqg" in {task for task, _ in told}) == (settings.teacher == "lqg")
    again = []
    report = train(algorithm, out, settings=settings, say=again.append)
    assert any(line.startswith("resuming") for line in again)
    assert report["training"]["curve"][-1]["steps"] >= settings.steps
    assert not any(float(line.split("%")[0]) > 100 for line in (*lines, *again) if line.lstrip()[0].isdigit())


@pytest.mark.slow
def test_a_spread_of_cars_and_another_road_can_be_trained_on(brief, tmp_path):
    lines = []
    settings = replace(brief["ppo"], steps=256, teacher=None)
    train("ppo", tmp_path / "run", settings=settings, randomize=True, road="C", say=lines.append)
    policy = Policy.load(tmp_path / "run" / "policy")
    assert policy.info["env"]["road"] == "C"
    assert set(policy.info["env"]["randomize"]) == set(robust()[0])
    assert policy.info["env"]["sensors"] == {"noise": [0.0, 2.0]} and policy.name == "ppo-robust"
    # compared with the same cars without current
    assert any(line.startswith("J on the validation roads: isd-passive") for line in lines)
    refused("another randomize", train, "ppo", tmp_path / "run", settings=settings, road="C")


def test_the_road_ahead_is_the_critic_s_alone():
    box = spaces.Box(-1.0, 1.0, (6,), np.float32)
    action = spaces.Box(-1.0, 1.0, (1,), np.float32)
    policy = SACPolicy(box, action, lambda _: 1e-3, seen=4, net_arch=dict(pi=[8], qf=[8]))
    x, y = torch.zeros(1, 6), torch.zeros(1, 6)
    y[0, 4:] = 1.0
    same, other = (policy._predict(v, deterministic=True) for v in (x, y))
    assert torch.equal(same, other)
    assert not torch.equal(policy.critic(x, same)[0], policy.critic(y, same)[0])
    without = PPOPolicy(box, action, lambda _: 1e-3, net_arch=dict(pi=[8], vf=[]))
    assert not without.predict_values(y).any()


def test_on_a_spread_every_road_counts_the_same():
    def cost(even, **options):
        cars = make_vec_env("ISDSuspension-v0", 16, rescale=False, max_episode_steps=300, **options)
        env = Remember(cars, MEMORY, Head("increment"), even=even)
        env.seed(0)
        env.reset()
        return -np.mean([env.step(np.zeros((16, 1), np.float32))[1] for _ in range(900)])

    smooth, rough = dict(road="A", speed=10.0), dict(road="C", speed=35.0)
    # a linear car's cost grows with the road's level and the speed; the friction and the end stop are a little besides
    assert cost(False, **rough) / cost(False, **smooth) == pytest.approx(16 * 3.5, rel=0.2)
    assert cost(True, **rough) / cost(True, **smooth) == pytest.approx(1.0, rel=0.2)
    # drawn anew at the end of an episode, the weight is that of the road which a reward was earned on
    both = dict(randomize={"road": ["A", "C"], "speed": (10.0, 35.0)})
    assert cost(True, **both) == pytest.approx(cost(True, **smooth), rel=0.2)
    # on the paper's road nothing is weighed
    assert cost(True) == cost(False)


def test_cars_of_a_group_share_a_road_and_their_advantages_are_relative():
    many = dict(rescale=False, stagger=True, max_episode_steps=8)
    env = Remember(make_vec_env("ISDSuspension-v0", 4, **many), MEMORY, Head("increment"), group=2)
    env.seed(3)
    env.reset()
    for _ in range(12):  # over the ends of episodes
        obs, reward, done, _ = env.step(np.zeros((4, 1), np.float32))
        np.testing.assert_array_equal(obs[0::2], obs[1::2])
        np.testing.assert_array_equal(done[0::2], done[1::2])
    assert not np.array_equal(obs[0], obs[2])

    one = spaces.Box(-1.0, 1.0, (1,), np.float32)
    buffer = GroupBuffer(3, one, one, device="cpu", n_envs=4, gamma=0.9, group=2, tail=1)
    road = np.array([[1.0, 1.0, -4.0, -4.0]])  # what the road does to both cars of a group
    own = np.array([[0.5, -0.5, 0.25, -0.25]])
    for k in range(3):
        zero = torch.zeros(4)
        last = own if k == 2 else 0 * own
        buffer.add(np.zeros((4, 1)), np.zeros((4, 1)), (road + last)[0], np.zeros(4), zero, zero)
    buffer.compute_returns_and_advantage(torch.zeros(4), np.zeros(4))
    np.testing.assert_allclose(buffer.advantages, own * [[0.81], [0.9], [1.0]], atol=1e-6)
    learnt = np.concatenate([batch.advantages for batch in buffer.get(4)])
    # not at the last step
    np.testing.assert_allclose(np.sort(learnt), np.sort(buffer.advantages[:2].ravel()))
    buffer.episode_starts[2] = 1.0  # what follows an end is of another road
    buffer.compute_returns_and_advantage(torch.zeros(4), np.zeros(4))
    assert not buffer.advantages[:2].any() and buffer.advantages[2].any()
    refused("tail", GroupBuffer, 3, one, one, device="cpu", n_envs=4, group=2, tail=3)

    replay = GroupReplayBuffer(40, one, one, device="cpu", n_envs=4, group=2, n_steps=3, gamma=0.5)
    for k in range(10):
        now = np.full((4, 1), k, np.float32)
        ends = np.full(4, k == 4)
        replay.add(now, now + 1, now, np.arange(4) + k, ends, [{"TimeLimit.truncated": True}] * 4)
    batch = replay.sample(64)
    begin, end = batch.observations[:, 0].numpy(), batch.next_observations[:, 0].numpy()
    assert np.array_equal(begin[0::2], begin[1::2]) and begin.max() <= 7
    np.testing.assert_array_equal(end, np.where((begin <= 4) & (begin > 2), 5, begin + 3))
    steps = end - begin
    np.testing.assert_allclose(batch.discounts[:, 0], 0.5**steps)
    car = batch.rewards[:, 0].numpy() - sum(np.where(j < steps, 0.5**j * (begin + j), 0) for j in range(3))
    car /= sum(np.where(j < steps, 0.5**j, 0) for j in range(3))
    np.testing.assert_allclose(car.reshape(-1, 2)[:, 1] - car.reshape(-1, 2)[:, 0], 1.0, atol=1e-5)
    replay.explored[:] = False
    replay.explored[6, 1] = True  # the cars 2 and 3
    batch = replay.sample(8)
    np.testing.assert_array_equal(batch.observations[:, 0], np.full(8, 6))
    expected = [sum(0.5**j * (i + 6 + j) for j in range(3)) for i in (2, 3)]
    np.testing.assert_allclose(batch.rewards[:, 0], expected * 4)
