"""Half and full cars as environments: spaces, seeds, roads of the wheels, costs, and the quarter car as their limit."""

import warnings
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from builders import decoupled_half_car, element
from gymnasium.utils.env_checker import check_env
from program import refused
from scipy.integrate import trapezoid
from scipy.special import k1

from isd_gym import ISDSuspensionEnv, ISDSuspensionVectorEnv, Network, linearise
from isd_gym.physics.cost import FULL_CAR, HALF_CAR
from isd_gym.physics.road import Road, paper_road
from isd_gym.physics.vehicle import vehicle

CARS = {"ISDHalfCar-v0": 2, "ISDFullCar-v0": 4}
NETWORKS = {"ISDHalfCar-v0": "half-car-isd", "ISDFullCar-v0": "full-car-isd"}
MOTORS = {"quarter-car-isd": 1, "half-car-isd": 2, "full-car-isd": 4}
FULL = ["front_left", "front_right", "rear_left", "rear_right"]
CORNERS = {"ISDHalfCar-v0": ["front", "rear"], "ISDFullCar-v0": FULL}
both = pytest.mark.parametrize("name", CARS)


@pytest.mark.parametrize("name", ["ISDSuspension-v0", "ISDSuspensionEq8-v0", *CARS])
@pytest.mark.parametrize("observation", ["measured", "full", "preview"])
def test_gymnasium_check_env(name, observation):
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        check_env(
            gym.make(name, observation=observation).unwrapped, skip_render_check=True
        )
    # the action is a current in ampere by contract
    assert all("range=[-1, 1]" in str(w.message) for w in seen), [
        str(w.message) for w in seen
    ]


@pytest.mark.parametrize("name", ["ISDSuspension-v0", *CARS])
def test_stable_baselines_check_env(name):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        checker.check_env(
            gym.wrappers.RescaleAction(gym.make(name), np.float32(-1), np.float32(1))
        )


@both
def test_spaces_follow_from_the_network(name):
    env = gym.make(f"isd_gym:{name}").unwrapped
    corners, turns = CORNERS[name], CARS[name] // 2
    zero = np.ones(len(corners), np.float32)
    assert env.action_space == gym.spaces.Box(-5, 5, zero.shape, np.float32)
    motions = ["body_acceleration", "pitch_acceleration", "roll_acceleration"]
    each = [f"{at}_travel{rate}" for at in ("suspension", "device") for rate in ("", "_rate")]  # fmt: skip
    expected = motions[: 1 + turns] + [f"{s}_{c}" for c in corners for s in each]
    expected += [f"current_{c}" for c in corners]
    assert [signal.name for signal in env.task.measured] == expected
    assert env.observation_space.shape == (len(expected),) == (len(env.task.labels),)
    costs = env.task.vehicle.costs
    keys = {"speed", "cost", *costs, "exceeds_acceleration", "exceeds_travel"}
    keys |= {f"tyre_load_{c}" for c in corners}
    assert set(env.reset(seed=0)[1]) == keys
    _, reward, _, _, info = env.step(zero)
    assert set(info) == keys
    assert reward == pytest.approx(-sum(info[k] for k in costs), rel=1e-12)
    # position and velocity of the body's motions, and of wheel, piston and joint at each corner
    state = 2 * (1 + turns + 3 * len(corners))
    ahead = 20 * (2 if len(corners) == 4 else 1)
    for more, options in ((state, {"observation": "full"}), (ahead, {"observation": "preview", "preview": 0.1})):  # fmt: skip
        wide = gym.make(name, **options)
        assert wide.observation_space.shape == (len(expected) + more,)


class NoNumber:
    def __repr__(self):
        return "\x1b[31m\n" * 1000


@pytest.mark.parametrize("name", MOTORS)
@pytest.mark.parametrize(
    ("action", "message"),
    [
        (lambda n: np.float32(0.0), "must have shape"),
        (lambda n: np.zeros(n + 1, np.float32), "must have shape"),
        (lambda n: np.zeros((n, 1), np.float32), "must have shape"),
        (lambda n: ["1"] * n, "must have shape"),
        (lambda n: [10**400] * n, "action"),
        (lambda n: [NoNumber()] * n, "action"),
        (lambda n: {}, "action"),
        (lambda n: [1j] * n, "action"),
        (lambda n: np.r_[np.zeros(n - 1), np.nan], "must be finite"),
        (lambda n: [0.0] * (n - 1) + [np.inf], "must be finite"),
    ],
)
def test_bad_actions_change_nothing(name, action, message):
    env, twin, many = (f(name) for f in (ISDSuspensionEnv, ISDSuspensionEnv, lambda n: ISDSuspensionVectorEnv(2, n)))  # fmt: skip
    for one in (env, twin, many):
        one.reset(seed=0)
    bad = action(MOTORS[name])
    refused(message, env.step, bad)
    with np.errstate(invalid="ignore"):  # 0 times infinity
        refused("action", many.step, [bad, bad])
    ones = np.ones(MOTORS[name], np.float32)
    np.testing.assert_array_equal(env.step(ones)[0], twin.step(ones)[0])


def without(net, *names):
    kept = tuple(e for e in net.elements if e.name not in names)
    return replace(net, elements=kept, outputs=(), uncertainty={})


def hung_up(net, node):
    """The elements at a node of the body are tied to the ground instead."""
    places = (
        tuple("ground" if n == node else n for n in e.where) for e in net.elements
    )
    tied = tuple(replace(e, where=p) for e, p in zip(net.elements, places, strict=True))
    return replace(net, elements=tied, outputs=(), uncertainty={})


HALF = Network.load("half-car-isd")
TWIN = element(
    "twin", "motor", "piston_front", "joint_front", thrust_constant=60.0, ratio=1.0
)
ONE_CURRENT = tuple(c for c in HALF.inputs if c.name != "current_rear")
NO_CARS = {
    "does not carry the body": hung_up(HALF, "body_front"),
    "stands on the road 'road_front'": without(HALF, "tyre_front"),
    "is not the only one of a wheel": HALF.with_element(TWIN),
    "has no input": replace(HALF, inputs=ONE_CURRENT, uncertainty={}),
}


@pytest.mark.parametrize("message", NO_CARS)
def test_networks_that_are_no_cars(message):
    refused(message, ISDSuspensionEnv, NO_CARS[message])


SPREAD = {"body.mass": (0.8, 1.2), "body.inertia.pitch": (0.9, 1.1)}
SPREAD |= {"seal_rear.level": (0.5, 1.5), "speed": (10, 30)}
OPTIONS = [
    ("quarter-car-isd", {}),
    ("quarter-car-isd", {"road": "C+bump", "speed": 15.0}),
    ("quarter-car-isd", {"randomize": {"body.mass": (0.8, 1.2), "speed": (10, 30), "road": ["A", "bump"]}}),
    ("quarter-car-isd", {"observation": "preview"}),
    ("quarter-car-isd", {"hold": 2, "reward": "relative", "observation": "history", "action": "increment"}),
    ("quarter-car-isd", {"per_level": True, "road": "C", "hold": 3, "sensors": {"noise": 1.0, "delay": 2}, "observation": "history"}),
    ("quarter-car-isd", {"observation": "preview", "preview": 0.05, "sensors": {"noise": (0.0, 3.0), "delay": 2, "road_error": 1e-3, "road_lag": 0.01}}),
    ("quarter-car-isd", {"reward": "shaped", "observation": "history", "action": "share"}),
    ("quarter-car-eq8", {"observation": "full"}),
    ("half-car-isd", {"reward": "shaped", "hold": 3}),
    ("full-car-isd", {"reward": "shaped"}),
    ("half-car-isd", {}),
    ("half-car-isd", {"randomize": {**SPREAD, "road": ["A", "C+bump", "bump"]}}),
    ("half-car-isd", {"observation": "preview", "preview": 0.1, "road": "C+bump", "speed": 13.7}),
    ("half-car-isd", {"observation": "full", "sensors": {"noise": 1.0, "delay": 1}}),
    pytest.param(*("half-car-passive", {"allow_passive": True}), marks=pytest.mark.slow),
    pytest.param(*("full-car-isd", {"road": "D"}), marks=pytest.mark.slow),
    pytest.param(*("full-car-isd", {"observation": "preview", "preview": 0.1, "randomize": {"speed": (15, 25), "road": ["paper", "C"]}}), marks=pytest.mark.slow),
    ("full-car-isd", {"observation": "preview", "preview": 0.1, "sensors": {"road_error": 1e-3, "road_range": 1.0}}),
]  # fmt: skip


@pytest.mark.parametrize(("network", "options"), OPTIONS)
def test_env_i_of_a_batch_is_the_single_env_of_its_seed(network, options):
    """To the last bit, over the end of an episode, whatever the neighbours do: a full and a partial group of cars."""
    count, steps, watched = 11, 300, (0, 4, 9)
    ends = {"max_episode_steps": 220, "autoreset_mode": "same_step"}
    batch = ISDSuspensionVectorEnv(count, network, **ends, **options)
    singles = {i: ISDSuspensionEnv(network, **options) for i in watched}
    obs, _ = batch.reset(seed=10)
    for i, env in singles.items():
        np.testing.assert_array_equal(obs[i], env.reset(seed=10 + i)[0])
    rng = np.random.default_rng(0)
    for k in range(steps):
        actions = rng.uniform(-5, 5, batch.action_space.shape).astype(np.float32)
        actions[0] = 5.0  # the first car is driven onto its end stops
        obs, rewards, _, truncated, info = batch.step(actions)
        for i, env in singles.items():
            one, reward, _, _, own = env.step(actions[i])
            assert reward == rewards[i] and truncated[i] == (k == 219)
            if truncated[i]:
                np.testing.assert_array_equal(one, info["final_obs"][i])
                one, own = env.reset()
            np.testing.assert_array_equal(one, obs[i])
            assert all(info[key][i] == value for key, value in own.items())


@pytest.mark.parametrize(
    ("name", "spread"),
    [
        ("quarter-car-isd", None),
        ("quarter-car-isd", {"body.mass": (0.8, 1.2)}),
        ("half-car-isd", {"wheel_front.mass": (0.8, 1.2), "speed": (12, 28)}),
    ],
)
def test_threads_change_nothing(name, spread):
    """Groups of cars shared by one, two and three threads: observations, rewards and info to the last bit."""
    fleets = [
        ISDSuspensionVectorEnv(43, name, road="E", randomize=spread, threads=n)
        for n in (1, 2, 3)
    ]
    for cars in fleets:
        cars.reset(seed=5)
    rng = np.random.default_rng(2)
    for _ in range(60):
        currents = rng.uniform(-5, 5, (43, MOTORS[name])).astype(np.float32)
        one, *others = [cars.step(currents) for cars in fleets]
        for other in others:
            np.testing.assert_array_equal(one[0], other[0])
            np.testing.assert_array_equal(one[1], other[1])
            for key, values in one[4].items():
                np.testing.assert_array_equal(values, other[4][key])
    assert np.ptp(one[1]) > 0.0


def test_reset_mask_forgets_the_road_that_lies_behind():
    """A car that starts again has even road under its rear wheel, its neighbours go on."""
    options = {"autoreset_mode": "disabled", "road": "bump"}
    env, idle = ISDSuspensionVectorEnv(3, "half-car-isd", **options), np.zeros((3, 2))
    env.reset(seed=0)
    for _ in range(210):  # the front wheel is over the bump, the rear one is not yet
        env.step(idle)
    env.reset(options={"reset_mask": np.array([True, False, True])})
    highest = np.zeros(3)
    for _ in range(40):
        env.step(idle)
        highest = np.maximum(highest, np.abs(env.task.batch.road_heights[1]))
    assert not highest[[0, 2]].any() and highest[1] > 0.04


@pytest.mark.parametrize("speed", [20.0, 13.7, 31.3])
@pytest.mark.parametrize("preview", [0.0, 0.05])
@both
def test_wheels_meet_the_road_of_their_track_one_after_the_other(name, speed, preview):
    """The heights under the wheels are `Road.wheel_heights` of the same generator, bit for bit."""
    ground = {"road": "C+bump", "speed": speed}
    see = {"observation": "preview", "preview": preview} if preview else {}
    env = ISDSuspensionEnv(NETWORKS[name], **ground, **see)
    env.reset(seed=3)
    met = [env.task.batch.road_heights[:, 0].copy()]
    for _ in range(300):
        env.step(np.zeros(CARS[name], np.float32))
        met.append(env.task.batch.road_heights[:, 0].copy())
    wheels = env.task.vehicle.wheels
    rng = gym.utils.seeding.np_random(3)[0]
    # the environment knows the whole duration before it starts: a profile is as long
    heights = env.task.batch.road.wheel_heights(wheels, 20.0, speed=speed, rng=rng)
    np.testing.assert_array_equal(np.array(met).T, heights[:, : 5 * 300 + 1 : 5])
    front, rear = np.array(met).T[[0, -1]]
    assert np.abs(front).max() > 0.02 and not rear[: int(2.7 / speed / 5e-3)].any()


@both
def test_preview_is_what_the_wheels_meet_later(name):
    """The first axle after the time of each point, the rear axle after the delay more; each track its own wheel."""
    tracks = 2 if CARS[name] == 4 else 1
    env = ISDSuspensionEnv(NETWORKS[name], observation="preview", preview=0.1, road="D")
    env.reset(seed=0)
    heights, views, signals = [], [], len(env.task.measured)
    for _ in range(120):
        obs, *_ = env.step(np.zeros(CARS[name], np.float32))
        heights.append(env.task.batch.road_heights[:, 0].copy())
        views.append(obs[signals:].reshape(tracks, 20) + heights[-1][:tracks, None])
    heights = np.array(heights)  # the corners of the first axle come first
    late = round(2.7 / 20.0 / 5e-3)
    for k in range(60):
        np.testing.assert_allclose(
            views[k], heights[k + 1 : k + 21, :tracks].T, atol=1e-6
        )
        np.testing.assert_allclose(
            views[k], heights[k + 1 + late : k + 21 + late, -tracks:].T, atol=1e-6
        )
    if tracks == 2:
        assert np.abs(heights[:, 0] - heights[:, 1]).max() > 1e-3


def stationary_rms(name):
    """RMS of the signals of a passive car on the paper's road at 20 m/s, from its frequency response."""
    net = Network.load(name)
    car = vehicle(net)
    space = linearise(replace(net, outputs=car.channels, uncertainty={}))
    f = np.concatenate([[1e-4], np.geomspace(1e-3, 2e4, 20_000)])
    columns = [space.inputs.index(c.road_input) for c in car.corners]
    late = np.exp(-2j * np.pi * f[:, None, None] * np.array(car.wheels.behind) / 20.0)
    response = space.response(f)[:, :, columns] * late
    ground, track = paper_road(), np.array(car.wheels.track)
    left, right = (
        response[:, :, track == 0].sum(axis=2),
        response[:, :, track == 1].sum(axis=2),
    )
    power = np.abs(left) ** 2 + np.abs(right) ** 2
    if car.wheels.tracks == 2:
        x = 2 * np.pi * f / 20.0 * car.wheels.width  # coherence of an isotropic surface
        power += 2 * (x * k1(x))[:, None] * np.real(left * right.conj())
    power *= ground.psd(f / 20.0)[:, None] / 20.0
    return dict(
        zip(
            [c.name for c in car.channels],
            np.sqrt(trapezoid(power, f, axis=0)),
            strict=True,
        )
    )


@pytest.mark.parametrize(
    ("name", "cost"), [("half-car-passive", HALF_CAR), ("full-car-passive", FULL_CAR)]
)
def test_references_are_the_rms_of_the_passive_car(name, cost):
    rms = stationary_rms(name)
    corners = [c.name for c in vehicle(Network.load(name)).corners]
    references = {"body": cost.acceleration_reference, "pitch": cost.pitch_reference}
    if len(corners) == 4:
        references["roll"] = cost.roll_reference
    for motion, own in references.items():
        assert own == pytest.approx(rms[f"{motion}_acceleration"], rel=1e-3)
    for kind, own in (
        ("suspension_travel", cost.travel_reference),
        ("tyre_load", cost.tyre_load_reference),
    ):
        assert own == pytest.approx([rms[f"{kind}_{c}"] for c in corners], rel=1e-3)
    motions = cost.acceleration + cost.pitch + cost.roll
    assert motions == pytest.approx(0.6) and cost.travel == 0.3


def test_reward_is_the_stage_cost_of_the_signals():
    weights = {"tyre_load": 0.2, "current": 0.1}
    env = ISDSuspensionEnv("half-car-isd", cost=weights)
    cost = replace(HALF_CAR, **weights)
    env.reset(seed=0)
    for _ in range(100):
        obs, reward, _, _, info = env.step(np.array([2.0, -4.0], np.float32))
    loads = [info["tyre_load_front"], info["tyre_load_rear"]]
    signals = np.array([*obs[[0, 1, 2, 6]], *loads, *obs[[10, 11]]], float)
    by_hand = cost.factors(("pitch",), 2, 2) @ signals**2
    assert reward == pytest.approx(-by_hand, rel=1e-5)
    shares = [0.3, 0.3, 0.15, 0.15] * (signals[:4] / [0.5903, 0.4431, 7.059e-3, 7.250e-3]) ** 2  # fmt: skip
    told = [info[f"cost_{name}"] for name in ("acceleration", "pitch", "travel", "current")]  # fmt: skip
    expected = [*shares[:2], shares[2:].sum(), 0.05 * (4.0 + 16.0) / 25.0]
    assert told == pytest.approx(expected, rel=1e-5)


def test_the_drive_of_one_motor_is_its_own():
    """Lag, delay and saturation of the rear motor: the front current acts as before, the rear one as in its own quarter car."""
    net = decoupled_half_car()
    quarter = Network.load("quarter-car-isd")
    for effect in (
        {"name": "lag", "type": "actuator_lag", "time_constant": 0.01},
        {"name": "late", "type": "actuator_delay", "delay": 0.0073},
        {"name": "soft", "type": "thrust_saturation", "current": 3.0},
    ):
        net = net.with_element({**effect, "element": "motor_rear"})
        quarter = quarter.with_element({**effect, "element": "motor"})
    half = ISDSuspensionEnv(net, road="flat")
    front, rear = ISDSuspensionEnv(road="flat"), ISDSuspensionEnv(quarter, road="flat")
    for env in (half, front, rear):
        env.reset(seed=0)
    for k in range(300):
        ahead, behind = 5.0 * np.sin(0.05 * k), 5.0 * np.cos(0.03 * k)
        obs = half.step(np.array([ahead, behind]))[0]
        a, b = front.step(np.array([ahead]))[0], rear.step(np.array([behind]))[0]
        np.testing.assert_allclose(obs[2:6], a[1:5], atol=2e-7)
        np.testing.assert_allclose(obs[6:10], b[1:5], atol=2e-7)
    assert np.abs(a[3]) > 1e-4 and np.abs(b[3]) > 1e-4


def test_full_observation_is_above_the_road():
    """Behind a step of the road all displacements come to rest at zero above its new height."""
    x = np.array([0.0, 1.0, 2.0, 200.0])
    step = Road("step", abscissa=x, profile=np.array([0.0, 0.0, 0.05, 0.05]))
    net = without(
        HALF, "seal_front", "seal_rear"
    )  # friction would hold the devices away from their rest
    env = ISDSuspensionEnv(net, road=step, observation="full", speed=20.0)
    env.reset(seed=0)
    for _ in range(2000):
        obs, *_ = env.step(np.zeros(2, np.float32))
    places = [i for i, label in enumerate(env.task.labels) if "displacement" in label]
    assert len(places) == 8  # two wheels, pistons and joints, the body and its pitch
    np.testing.assert_allclose(obs[places], 0.0, atol=5e-5)  # a thousandth of the step
    assert env.task.batch.road_heights[:, 0] == pytest.approx([0.05, 0.05])
