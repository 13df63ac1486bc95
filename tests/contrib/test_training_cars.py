"""Policies of half and full cars: the rear road told by the front wheels, several currents, training and files."""

import json
import shutil
from dataclasses import replace
from functools import cache
from importlib.util import find_spec
from itertools import pairwise

import numpy as np
import pytest
from isd_gym.agents._entry import open_policy
from isd_gym.agents._memory import Echo, Memory, _Echo
from isd_gym.agents.policy import Head, Policy
from program import refused

from isd_gym.contrib.training.settings import PPOSettings, SACSettings, tuned
from isd_gym.contrib.training.wheelbase import car_filter, road_model
from isd_gym.env._environment import ISDSuspensionVectorEnv
from isd_gym.physics._prediction import prediction_model
from isd_gym.physics._vehicle import vehicle
from isd_gym.physics.cost import StageCost
from isd_gym.physics.network import Network

CARS = {"half-car-isd": "ISDHalfCar-v0", "full-car-isd": "ISDFullCar-v0"}
both = pytest.mark.parametrize("network", CARS)
needs_sb3 = pytest.mark.skipif(
    find_spec("stable_baselines3") is None, reason="Stable-Baselines3 (and torch) not installed"
)
STEP = 5e-3
# A, of sums in single precision in an estimate that remembers seconds: 2 to 5 mA against the same code in double precision,
# by the order of the sums, which NumPy chooses by processor
ROUNDING = 1e-2


@cache
def memory(network, speed=20.0):
    """The memory of a trained policy: signals, rear road and estimate."""
    known, echo = car_filter(Network.load(network), speed)
    return replace(Memory.of(vehicle(Network.load(network))), filter=known, echo=echo)


def renamed(x_front=1.35, x_rear=-1.35):
    """The half car with its wheels and roads under other names, and axles elsewhere."""
    text = json.dumps(Network.load("half-car-isd").to_dict())
    for old, new in (("front", "a"), ("rear", "b")):
        text = text.replace(old, new)
    data = json.loads(text)
    points = data["bodies"]["body"]["points"]
    points["body_a"]["x"], points["body_b"]["x"] = x_front, x_rear
    return Network.load(data)


def policy_of(network, head=None, seed=0, hidden=8):
    rng, plant = np.random.default_rng(seed), Network.load(network)
    car = vehicle(plant)
    sizes = [memory(network).width(len(car.measured)), hidden, len(car.driven)]
    layers = [(rng.normal(size=(b, a)) / a, 0.1 * rng.normal(size=b)) for a, b in pairwise(sizes)]
    return Policy(layers, memory=memory(network), head=head or Head("increment"), network=plant)


def law(network, speed=20.0):
    """The law of the estimate: a residual of nothing."""
    plant = Network.load(network)
    car, own = vehicle(plant), memory(network, speed)
    layer = (np.zeros((len(car.driven), own.width(len(car.measured)))), np.zeros(len(car.driven)))
    return Policy([layer], memory=own, head=Head("residual"), network=plant)


def cost(policy, speed=20.0, cars=8, steps=1500):
    """Mean cost on the paper's road."""
    env = ISDSuspensionVectorEnv(
        cars, network=policy.model, speed=speed, autoreset_mode="disabled", allow_passive=True
    )
    obs, _ = env.reset(seed=40)
    policy.reset_batch(cars)
    total = 0.0
    for _ in range(steps):
        obs, reward, *_ = env.step(policy.act_batch(obs))
        total -= reward.mean()
    return total / steps


def roads(network, speed, steps, policy=None):
    """Heights of the road under the corners (steps, corners) of one car."""
    env = ISDSuspensionVectorEnv(1, network=network, speed=speed, autoreset_mode="disabled")
    env.reset(seed=2)
    idle = np.zeros((1, len(vehicle(network).driven)))
    seen = [env.task.batch.road_heights[:, 0].copy()]
    for _ in range(steps):
        env.step(idle)
        seen.append(env.task.batch.road_heights[:, 0].copy())
    return np.array(seen)


@pytest.mark.parametrize(
    ("network", "speed"),
    [
        (Network.load("half-car-isd"), 20.0),  # 27 steps
        (Network.load("half-car-isd"), 13.5),  # 40 steps
        (Network.load("full-car-isd"), 20.0),
        (renamed(1.2, -1.8), 15.0),  # 40 steps
    ],
    ids=["half", "slow", "full", "renamed"],
)
def test_what_the_front_met_is_what_the_rear_meets_to_the_step(network, speed):
    """Fed with the true rises under the leading wheels, the memory tells those under the others to the last digit."""
    wheels = vehicle(network).wheels
    _, echo = car_filter(network, speed)
    leaders = [i for i, behind in enumerate(wheels.behind) if behind == 0.0]
    followers = [i for i, behind in enumerate(wheels.behind) if behind > 0.0]
    assert [distance for _, distance in echo.followers] == [wheels.behind[i] for i in followers]
    delay = round(max(wheels.behind) / speed / STEP)
    assert echo.points == delay - echo.lag + 1
    heights = roads(network, speed, 300)
    rises = np.diff(heights, axis=0)
    given = replace(echo, rows=tuple(tuple(map(float, row)) for row in np.eye(len(leaders))), rise=1.0)
    keeper = _Echo(given, STEP, 1)  # the arithmetic alone: its input is the truth instead of an estimate
    for k in range(echo.lag, 299):
        # at time k the estimate is of the step that began `lag` steps ago
        ahead = keeper.see(rises[k - echo.lag, leaders][None].astype(np.float32))[0]
        if k < delay + echo.lag:
            continue
        told = ahead.reshape(len(followers), echo.points)
        true = np.array([rises[k : k + echo.points, i] for i in followers])
        known = min(echo.points, 299 - k)
        np.testing.assert_allclose(told[:, :known], true[:, :known], atol=1e-9)


@pytest.mark.slow
@both
def test_the_law_gains_from_what_the_front_met(network):
    """Each rear wheel has 0.13 s of its road in sight: a third more is gained than without."""
    passive = network.replace("isd", "passive")
    own = memory(network)
    rows = tuple(tuple(0.0 for _ in row) for row in own.filter.law_ahead)
    blind = law(network)
    blind.memory = replace(own, filter=replace(own.filter, law_ahead=rows, rate_ahead=rows))
    plant, motors = Network.load(network), len(own.filter.law)
    nothing = np.zeros((motors, len(vehicle(plant).measured))), np.zeros(motors)
    idle = Policy([nothing], head=Head("target"), network=plant)
    idle.model = Network.load(passive)
    ground, told, untold = cost(idle), cost(law(network)), cost(blind)
    assert told / ground < 0.71 and 0.74 < untold / ground < 0.80


def test_at_a_speed_that_leaves_no_time_there_is_no_rear_road():
    """At 400 m/s the rear wheels follow after 1.35 steps, sooner than the front wheels tell their road."""
    known, echo = car_filter(Network.load("half-car-isd"), 400.0)
    assert echo is None and known.roads == known.points == 0
    recall = Memory(filter=known).start(np.zeros((1, 12), np.float32))
    recall.see(np.full((1, 12), 0.01, np.float32))
    assert np.isfinite(recall.features).all() and np.abs(recall.filter.wanted).min() > 0


def test_the_delay_follows_the_speed():
    """A law that was made at 20 m/s serves at 28 m/s, if it is told so."""
    made = law("half-car-isd")
    late, right = cost(made, speed=28.0), cost(made.at_speed(28.0), speed=28.0)
    best = cost(law("half-car-isd", 28.0), speed=28.0)
    assert best * 0.99 < right < 0.96 * late
    assert right == pytest.approx(best, rel=0.02)
    assert made.at_speed(20.0) is made
    refused("m/s or more", made.at_speed, 0.05)
    quarter = Policy.load("ppo")
    assert quarter.at_speed(7.0) is quarter


def test_a_quarter_car_s_model_is_that_of_the_baselines():
    """The whole-car model of a car with one corner: same matrices up to the choice of the state, by its transfer."""
    network = Network.load("quarter-car-isd")
    own, known = road_model(network, STEP), prediction_model(network, STEP)
    a = np.zeros((own.A.shape[0], 1)) + own.B
    b = known.B[:, None]
    for _ in range(40):  # response of the measured signals to a current over one step
        np.testing.assert_allclose(own.C[:5] @ a, known.C[:5] @ b, atol=1e-9)
        a, b = own.A @ a, known.A @ b
    forces = (own.C[:5] @ own.G + own.F[:5])[:, 0]
    dry = known.friction[0]
    np.testing.assert_allclose(forces, known.C[:5] @ known.G[:, dry] + known.F[:5, dry], atol=1e-12)


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
        assert "choose a policy" in refused(says, open_policy, name, plant, StageCost(), STEP, {})
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
        ({"speed": 0.0}, "speed"),
        ({"speed": 0.1}, "m/s or more"),
        ({"rows": [[1.0] * 18] * 9}, "leading wheel"),
        ({"lag": 1.5}, "whole number"),
        ({"points": 10**6}, "points"),
        ({"rows": [[1.0, 2.0]]}, "as many states"),
        ({"rows": [["x"]]}, "rows"),
        ({"followers": []}, "rises"),
        ({"followers": [[3, 2.7]]}, "follower"),
        ({"followers": [[0, -1.0]]}, "follower"),
        ({"followers": [[0, 2.7], [0, 2.7]]}, "other wheels"),
        ({"more": 1}, "memory"),
    ],
)
def test_a_spoilt_echo_is_one_line(spoil, says):
    data = memory("half-car-isd").to_dict()
    refused(says, Memory.from_dict, {**data, "echo": {**data["echo"], **spoil}})
    refused("both", Memory.from_dict, {**data, "ahead": 3})


@pytest.fixture
def brief(monkeypatch):
    """Settings of a training of a few thousand steps, and nothing scored that takes long."""
    if find_spec("stable_baselines3") is None:
        pytest.skip("Stable-Baselines3 (and torch) not installed")
    import isd_gym.contrib.training.train as module
    import isd_gym.contrib.training.wheelbase as wheelbase

    def known(network, *_):  # made once for all runs
        own = memory(network.name)
        return own.filter, own.echo

    monkeypatch.setattr(wheelbase, "car_filter", known)
    monkeypatch.setattr(module, "CAR_BASELINES", ())
    monkeypatch.setattr(module, "VALIDATION_EPISODES", 2)
    monkeypatch.setattr(module, "SCORE_EPISODES", 2)
    warm = dict(teacher="law", warm_steps=300, warm_updates=30, cars=16)
    small = dict(checkpoint_seconds=0.0, averaging=0.5, evaluations=4, **warm)
    ppo = dict(steps=4096, horizon=32, tail=16, batch=128, epochs=1, learning_rate=1e-4, **small)
    sac = dict(steps=2048, batch=64, warm_up=256, buffer=4096, n_steps=4, critic_updates=10, **small)
    return {"ppo": PPOSettings(**ppo), "sac": SACSettings(actor=(16,), critic=(16,), **sac)}


class Killed(Exception):
    pass


@pytest.mark.slow
@needs_sb3
@pytest.mark.filterwarnings("ignore")  # torch and tensorboard warn of themselves
@pytest.mark.parametrize(
    ("algorithm", "network"),
    [("ppo", "half-car-isd"), ("sac", "half-car-isd"), ("ppo", "full-car-isd"), ("sac", "full-car-isd")],
)
def test_a_training_goes_on_to_the_same_policy(brief, algorithm, network, tmp_path):
    """Killed half-way, a run goes on from its checkpoint, twice to the same result; its policy drives and is scored."""
    from isd_gym.contrib.training.train import train

    settings, out, twin = brief[algorithm], tmp_path / "run", tmp_path / "twin"

    def until_half(line):
        if line.strip().startswith(("50", "56", "62")):
            raise Killed

    with pytest.raises(Killed):
        train(algorithm, out, settings=settings, network=network, say=until_half)
    shutil.copytree(out, twin)
    reports = []
    for folder in (out, twin):
        lines = []
        reports.append(train(algorithm, folder, settings=settings, network=network, say=lines.append))
        assert lines[0].startswith("resuming")
    costs = [[row["cost"] for row in report["training"]["curve"]] for report in reports]
    assert costs[0] == costs[1] and len(costs[0]) >= 4
    assert reports[0]["score"]["cost"] == reports[1]["score"]["cost"]
    policy, other = (Policy.load(folder / "policy") for folder in (out, twin))
    for (w, b), (v, c) in zip(policy.weights, other.weights, strict=True):
        np.testing.assert_array_equal(w, v)
        np.testing.assert_array_equal(b, c)
    assert policy.name == f"{algorithm}-{CARS[network][3:7].lower()}-car"
    assert policy.info["env"]["id"] == CARS[network]
    assert policy.memory.echo is not None and policy.currents == len(vehicle(Network.load(network)).driven)
    found = open_policy(str(out / "policy"), Network.load(network), StageCost(), STEP, {}).make()
    assert np.isfinite(cost(found, steps=100))


@needs_sb3
def test_the_tuned_settings_of_a_car_can_be_typed(tmp_path):
    from isd_gym.contrib.training.train import train

    half = tuned("ppo", vehicle(Network.load("half-car-isd")))
    assert half.gamma == 0.995 and half.teacher == "mpc-wheelbase"
    assert tuned("ppo", vehicle(Network.load("quarter-car-isd"))) == PPOSettings()
    refused("leave the preview out", train, "ppo", tmp_path / "run", network="half-car-isd", preview=0.1)
    half_car = {"network": "half-car-isd", "randomize": True}
    refused("quarter car: give ranges", train, "ppo", tmp_path / "run", **half_car)


def test_an_echo_can_be_of_several_axles():
    """A third axle follows the first one as well, each at its own distance."""
    echo = Echo(((1.0,),), ((0, 1.0), (0, 2.0)), speed=20.0, lag=1, points=5, rise=1.0)
    weights = echo.weights(STEP)  # 10 and 20 steps
    assert weights.shape == (1, 21, 10)
    for i in range(5):
        assert np.flatnonzero(weights[0, :, i]).tolist() == [9 - i]
        assert np.flatnonzero(weights[0, :, 5 + i]).tolist() == [19 - i]
    part = replace(echo, speed=30.0).weights(STEP)  # 6.67 and 13.33 steps
    np.testing.assert_allclose(part[0, [5, 6], 0], [1 / 3, 2 / 3])
    # a rise that has not been met is none: 1 m at 100 m/s are two steps, of which the first one is told
    told = replace(echo, speed=100.0).weights(STEP)[0, :, :5].any(axis=0)
    assert told.tolist() == [True] * 2 + [False] * 3
