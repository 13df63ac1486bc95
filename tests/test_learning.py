"""Options for learning: held actions, relative rewards, histories, groups of cars, states; and what they leave unchanged."""

import pickle
import threading

import gymnasium
import numpy as np
import pytest
from gymnasium.utils import seeding
from program import refused

from isd_gym import InputError, ISDSuspensionEnv, ISDSuspensionVectorEnv
from isd_gym._common.seeds import generators, scoring_generator
from isd_gym.env import RELATIVE_SCALE
from isd_gym.env.history import LEADS, SCALES
from isd_gym.physics.road import Road


def made(name="ISDSuspension-v0", **options):
    return gymnasium.make(name, disable_env_checker=True, **options).unwrapped


def driven(env, actions):
    """Observations, rewards and infos of a drive."""
    out = [env.step(a) for a in actions]
    return (
        np.array([o[0] for o in out]),
        np.array([o[1] for o in out]),
        [o[4] for o in out],
    )


@pytest.mark.parametrize("name", ["ISDSuspension-v0", "ISDHalfCar-v0", "ISDFullCar-v0"])
def test_a_held_increment_is_a_ramp_of_the_current_over_its_control_steps(name):
    own, plain = made(name, hold=3, action="increment"), made(name)
    own.reset(seed=7), plain.reset(seed=7)
    rng, present = np.random.default_rng(0), np.zeros(plain.action_space.shape)
    for _ in range(40):
        rate = rng.uniform(-1.2, 1.2, present.shape)
        obs, reward, _, _, info = own.step(rate)
        currents = []
        for _ in range(3):
            present = np.clip(present + 0.5 * np.clip(rate, -1, 1), -5, 5)
            currents.append(present)
        seen, rewards, infos = driven(plain, currents)
        np.testing.assert_array_equal(obs, seen[-1])
        travel = [one["cost_travel"] for one in infos]
        told = (reward, -info["cost"], info["cost_travel"])
        mean = np.mean(rewards)
        assert told == pytest.approx((mean, mean, np.mean(travel)), rel=1e-12)
        exceeded = max(one["exceeds_acceleration"] for one in infos)
        assert info["exceeds_acceleration"] == exceeded


@pytest.mark.parametrize("name", ["ISDSuspension-v0", "ISDFullCar-v0"])
def test_a_history_is_scaled_signals_their_changes_and_velocities(name):
    own, plain = made(name, observation="history"), made(name)
    first, seen = own.reset(seed=3)[0], plain.reset(seed=3)[0]
    kinds = [signal.kind for signal in plain.task.measured]
    scale, change = (np.array([SCALES[kind][i] for kind in kinds]) for i in (0, 1))
    n, motions = len(kinds), 1 + len(plain.task.vehicle.axes)
    late = len(own.task.history.late)
    assert (
        not first.any()
        and first.shape == (3 * n + 3 * motions + late,) == own.observation_space.shape
    )
    assert len(own.task.labels) == len(first)
    rng, velocity, step = np.random.default_rng(0), np.zeros((motions, 3)), np.zeros(n)
    taus, shares = np.array([0.3, 1.0, 3.0]), np.array([0.042, 0.07, 0.091])
    for _ in range(60):
        action = rng.uniform(-5, 5, plain.action_space.shape)
        obs, last, last_step = own.step(action)[0], seen, step
        seen = plain.step(action)[0]
        step = (seen - last) / change
        velocity += 5e-3 * (seen[:motions, None] - velocity / taus)
        velocities = velocity / (shares * scale[:motions, None])
        expected = np.concatenate(
            [seen / scale, step, step - last_step, velocities.ravel()]
        )
        np.testing.assert_allclose(
            obs[: len(expected)], np.clip(expected, -10, 10), rtol=2e-3, atol=2e-3
        )
    assert own.observation_space.contains(obs)


@pytest.mark.parametrize(
    ("name", "corners"), [("ISDHalfCar-v0", 1), ("ISDFullCar-v0", 2)]
)
@pytest.mark.parametrize("speed", [20.0, 14.0])
def test_a_history_repeats_the_front_corners_before_the_rear_wheels_arrive(
    name, corners, speed
):
    """A number of 30 ms before the arrival is that of the front wheel, wheelbase / speed - 30 ms ago."""
    own = made(name, observation="history", speed=speed)
    own.reset(seed=3)
    rng, seen = np.random.default_rng(0), []
    for _ in range(80):
        seen.append(own.step(rng.uniform(-5, 5, own.action_space.shape))[0])
    history, labels = own.task.history, own.task.labels
    motions = 1 + len(own.task.vehicle.axes)
    assert len(history.late) == (2 * motions + 3 * corners) * len(LEADS)
    for i, (column, distance, lead) in enumerate(
        history.late, len(labels) - len(history.late)
    ):
        assert distance == pytest.approx(2.7)
        ago = round((2.7 / speed - lead) / 5e-3)
        assert seen[-1][i] == seen[-1 - ago][column]
        assert labels[i].startswith(labels[column].removesuffix(" [-]") + ", ")
        assert "rear" not in labels[column]
    assert np.abs(seen[-1][-len(history.late) :]).min() > 0


def test_a_reference_leaves_the_order_of_policies_unchanged():
    """The reference does not depend on the actions: two policies differ by the same return, up to the factor."""
    rng = np.random.default_rng(1)
    policies = rng.uniform(-5, 5, (2, 200, 1)).repeat(5, axis=1)
    returns = {}
    for reward in ("cost", "relative"):
        env = made(reward=reward)
        for k, actions in enumerate(policies):
            env.reset(seed=11)
            returns[reward, k] = driven(env, actions)[1].sum()
    plain = returns["cost", 0] - returns["cost", 1]
    assert returns["relative", 0] - returns["relative", 1] == pytest.approx(
        RELATIVE_SCALE * plain, rel=1e-9
    )
    env.reset(seed=11)
    assert not driven(env, np.zeros((200, 1)))[
        1
    ].any()  # the reference is the car without current


def test_a_group_shares_a_road_and_its_rewards_have_no_sum():
    name = "ISDHalfCarLearning-v0"
    given = {"road": "C+bump", "duration": 0.4, "reward_scale": 1.0, "hold": 2}
    env = gymnasium.make_vec(name, 6, cars_per_road=3, reward="relative", **given)
    single = made(name, reward="cost", **given)
    env.reset(seed=5), single.reset(seed=6)
    rng = np.random.default_rng(0)
    for k in range(90):  # over two ends of episodes
        actions = rng.uniform(-1, 1, env.action_space.shape).astype(np.float32)
        obs, reward, _, over, info = env.step(actions)
        np.testing.assert_allclose(reward.reshape(2, 3).sum(axis=1), 0.0, atol=1e-9)
        assert over.all() == over.any() == (k % 41 == 39)
        if k < 40:
            costs = info["cost"].reshape(2, 3)
            expected = RELATIVE_SCALE * (costs.mean(axis=1, keepdims=True) - costs)
            np.testing.assert_allclose(reward, expected.ravel(), atol=1e-9)
            own, cost, *_ = single.step(actions[4])
            np.testing.assert_array_equal(obs[4], own)
            assert -cost == info["cost"][4]
    assert len(np.unique(env.unwrapped.task.batch.road_heights[0])) == 2


def test_per_level_weighs_a_rough_road_as_the_paper_s():
    rough, usual = made(road=Road("rough", roughness=4e-4), per_level=True), made()
    rough.reset(seed=1), usual.reset(seed=1)
    actions = np.zeros((2000, 1))
    told = driven(rough, actions)
    assert told[1].mean() == pytest.approx(driven(usual, actions)[1].mean(), rel=0.5)
    assert told[1][-1] == pytest.approx(-told[2][-1]["cost"] * 1e-4 / 4e-4, rel=1e-9)


@pytest.mark.parametrize(
    "options", [{}, {"reward": "relative", "hold": 2}, {"per_level": True, "road": "C"}]
)
def test_a_scale_of_the_reward_changes_the_reward_alone(options):
    plain, scaled = made(**options), made(reward_scale=30, **options)
    plain.reset(seed=4), scaled.reset(seed=4)
    actions = np.random.default_rng(0).uniform(-5, 5, (50, 1))
    one, many = driven(plain, actions), driven(scaled, actions)
    np.testing.assert_allclose(many[1], 30 * np.array(one[1]), rtol=1e-12)
    np.testing.assert_array_equal(many[0], one[0])
    assert many[2] == one[2]
    words = "reward_scale must be a number from 1e-06 to 1e\\+06, not 0"
    refused(words, made, reward_scale=0)


@pytest.mark.parametrize("control_step", [1e-3, 5e-3, 20e-3])
@pytest.mark.parametrize("hold", [1, 4])
def test_neither_the_control_step_nor_a_hold_changes_actuator_and_episode(
    control_step, hold
):
    env = made(control_step=control_step, hold=hold, duration=2.0)
    env.reset(seed=0)
    decision, steps, over, reached = control_step * hold, 0, False, 0.0
    while not over:
        obs, _, _, over, _ = env.step([5.0])
        steps += 1
        reached = reached or steps * decision * (obs[5] > 4.9999)
    assert steps == round(2.0 / decision)
    assert 0.05 - 1e-9 <= reached < 0.05 + decision  # 5 A at 100 A/s
    if (control_step, hold) == (5e-3, 1):
        env.reset(seed=0)
        assert [float(env.step([5.0])[0][5]) for _ in range(11)] == [
            min(0.5 * k, 5.0) for k in range(1, 12)
        ]


SPREAD = {"body.mass": (0.8, 1.2), "speed": (15, 30), "road": ["A", "bump"]}


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("ISDSuspension-v0", {}),
        ("ISDSuspensionLearning-v0", {}),
        ("ISDFullCar-v0", {"observation": "preview", "road": "B+pothole"}),
        ("ISDSuspension-v0", {"randomize": SPREAD, "sensors": {"noise": 1.0, "delay": 2}}),
        ("ISDHalfCarLearning-v0", {"per_level": True, "road": "C"}),
    ],
)  # fmt: skip
def test_an_episode_branches_from_a_state_to_the_last_bit(name, options):
    def same(one, other):
        for a, b in zip(one, other, strict=True):
            np.testing.assert_array_equal(a, b)

    env, rng = made(name, **options), np.random.default_rng(0)
    env.reset(seed=3)
    shape = env.action_space.shape
    driven(env, rng.uniform(-1, 1, (137, *shape)))
    state = pickle.loads(pickle.dumps(env.get_state()))
    actions = rng.uniform(-1, 1, (500, *shape))
    seen, rewards, infos = driven(env, actions)
    other = made(name, **options)
    other.reset(seed=9)
    driven(other, actions[:5])
    other.set_state(state)
    same((seen, rewards, infos), driven(other, actions))
    same(env.reset()[0], other.reset()[0])  # and so do the next roads
    many = gymnasium.make_vec(name, 11, **options).unwrapped
    many.reset(seed=50)
    for _ in range(31):  # another place in the rings of the road
        many.step(rng.uniform(-1, 1, (11, *shape)))
    many.set_state(9, state)
    back = many.get_state(9)
    for k in range(200):
        all_actions = np.zeros((11, *shape))
        all_actions[9] = actions[k]
        obs, reward, *_ = many.step(all_actions)
        same((obs[9], reward[9]), (seen[k], rewards[k]))
    many.set_state(2, back)
    other.set_state(many.get_state(2))
    same(driven(other, actions[:50])[0], seen[:50])


def test_a_state_of_another_car_is_refused():
    env = made("ISDHalfCar-v0")
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.get_state()
    quarter = made(observation="history")
    quarter.reset(seed=0)
    refused("another network, another observation", env.set_state, quarter.get_state())
    refused(r"comes from get_state\(\)", env.set_state, {"states": 1})


def test_no_seed_reaches_a_scoring_road():
    drawn = {
        int(scoring_generator(i).integers(0, 2**64, dtype=np.uint64)) for i in range(64)
    }
    reached = {
        int(seeding.np_random(s)[0].integers(0, 2**64, dtype=np.uint64))
        for s in range(20_000)
    }
    assert len(drawn) == 64 and not drawn & reached
    one, many = made(), gymnasium.make_vec("ISDSuspension-v0", 4)
    one.reset(options={"scoring_road": 3}), many.reset(options={"scoring_road": 0})
    actions = np.zeros((4, 1), np.float32)
    for _ in range(20):
        alone, together = one.step(actions[0])[0], many.step(actions)[0]
    np.testing.assert_array_equal(alone, together[3])
    heights = Road("paper", roughness=1e-4).heights(0.1, rng=generators(None, 3, 1)[0])
    assert one.task.batch.road_heights[0, 0] == heights[-1]
    refused(
        "scoring_road must be a whole number", one.reset, options={"scoring_road": -1}
    )
    refused("not 'scoring'", one.reset, options={"scoring": 1})
    refused("not 'mask'", many.reset, options={"mask": 1})


def test_info_tells_the_drawn_parameters_and_exceeded_limits():
    ranges = {"body.mass": (0.8, 1.2), "road": ["A", "H"]}
    many = gymnasium.make_vec("ISDSuspension-v0", 6, randomize=ranges)
    one = made(randomize=ranges)
    info, single = many.reset(seed=0)[1], one.reset(seed=4)[1]
    assert set(info["road"]) == {"A", "H"} and info["_body.mass"].all()
    assert single["body.mass"] == info["body.mass"][4] == pytest.approx(345.0, rel=0.2)
    beyond = np.zeros(6)
    for _ in range(400):
        *_, info = many.step(np.zeros((6, 1), np.float32))
        own = one.step([0.0])[4]
        for key in ("exceeds_travel", "road"):
            assert own[key] == info[key][4]
        beyond += info["exceeds_acceleration"]
    acceleration, travel = np.abs(many.unwrapped.task.batch.out[:2])
    np.testing.assert_array_equal(acceleration > 5.0, info["exceeds_acceleration"])
    np.testing.assert_array_equal(travel > 0.08, info["exceeds_travel"])
    np.testing.assert_array_equal(beyond > 0, info["road"] == "H")


WRONG = [
    ({"hold": 1.5}, "hold must be a whole number"),
    ({"reward": "own"}, "reward must be one of cost, relative"),
    ({"action": "voltage"}, "action must be one of current, share, increment"),
    ({"preview": 0.1}, "preview is for observation"),
    ({"control_step": np.nan}, "control_step must be a number"),
    ({"control_step": 3.3e-3}, "whole multiple"),
    ({"preview": 1e6, "observation": "preview"}, "preview must be a number"),
    ({"cost": 3}, "cost must be a mapping"),
    ({"cost": {"acceleration": 1e308}}, "weight of acceleration must be"),
    ({"randomize": 3}, "randomize must be a mapping"),
    ({"randomize": {"speed": None}}, "must be a pair"),
    ({"network": "force-rig"}, "is no car"),
    ({"road": "moon"}, "no road 'moon'"),
    ({"speed": 0.0}, "speed must be a number"),
    ({"randomize": {"roof.mass": (0.8, 1.2)}}, "no parameter 'roof.mass'"),
    ({"randomize": {"body.mass": (1.2, 0.8)}}, "needs 0 < low <= high"),
    ({"render_mode": "ascii"}, "render_mode .*must be"),
    ({"network": "half-car-isd", "cost": {"roll": 0.1}}, "does not roll"),
    (
        {"network": "half-car-isd", "cost": {"travel_reference": (1e-3,) * 3}},
        "3 values for 2 corners",
    ),
    (
        {"network": "half-car-isd", "cost": {"travel_reference": (1e-3, 0.0)}},
        "must be from 1e-12",
    ),
]


@pytest.mark.parametrize(("options", "message"), WRONG)
def test_a_wrong_option_is_one_line(options, message):
    for kind in (ISDSuspensionEnv, ISDSuspensionVectorEnv):
        refused(message, kind, **options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"num_envs": True}, "num_envs must be"),
        ({"max_episode_steps": float("nan")}, "max_episode_steps must be"),
        ({"threads": "a"}, "threads must be"),
        ({"autoreset_mode": []}, "autoreset_mode must be"),
        ({"num_envs": 8, "cars_per_road": 3}, "cannot be shared out"),
    ],
)
def test_a_wrong_argument_of_a_batch_is_one_line(options, message):
    refused(message, ISDSuspensionVectorEnv, **options)


@pytest.mark.parametrize(
    ("road", "message"),
    [
        ({"abscissa": [0, 1], "profile": [0, np.nan]}, "finite numbers"),
        ({"abscissa": [0, 1], "profile": [0, 1e300]}, "no road"),
        ({"abscissa": [1, 0], "profile": [0, 0]}, "must not go back"),
        ({"roughness": -1.0}, "roughness must be"),
    ],
)
def test_a_road_has_finite_numbers(road, message):
    refused(message, Road, "x", **road)


def test_a_batch_refuses_a_second_thread_and_half_a_start():
    env = ISDSuspensionVectorEnv(4, autoreset_mode="disabled", cars_per_road=2)

    def start(*mask):
        env.reset(seed=1, options={"reset_mask": np.array(mask)})

    refused("must start all cars", start, True, True, False, False)
    refused("same seed", env.reset, seed=[1, 2, 3, 4])
    env.reset(seed=1)
    refused("all cars of a road or none", start, True, False, False, False)
    still, found = np.zeros((4, 1)), []
    with env._alone():

        def step():
            try:
                env.step(still)
            except InputError as error:
                found.append(str(error))

        thread = threading.Thread(target=step)
        thread.start()
        thread.join()
    (told,) = found
    assert told.startswith("another thread is using this vector environment")
    env.step(still)
    pickle.loads(pickle.dumps(env)).step(still)
