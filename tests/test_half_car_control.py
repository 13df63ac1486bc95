"""Control and score of half and full cars: what is refused, corners as quarter cars, the rear road known from the front."""

import numpy as np
import pytest
from builders import decoupled_half_car, rms
from program import refused

from isd_gym import InputError, ISDSuspensionVectorEnv, Network, baselines, score
from isd_gym.benchmark.driving import Crew, travel
from isd_gym.benchmark.policies import conventional, find, passive
from isd_gym.benchmark.scoring import Conditions, drive
from isd_gym.physics.vehicle import vehicle

HALF, FULL = Network.load("half-car-isd"), Network.load("full-car-isd")
OF_QUARTER_CARS = ("lqr-full",)
KINDS = {"half-car-isd": "half car", "full-car-passive": "full car"}


@pytest.mark.parametrize(
    ("policy", "network", "model", "words"),
    [
        *(
            (p, n, None, f"of a quarter car.*is a {KINDS[n]}")
            for p in OF_QUARTER_CARS
            for n in KINDS
        ),
        ("ppo", "half-car-isd", None, "was made for network 'quarter-car-isd'"),
        (
            "lqg",
            "half-car-isd",
            "quarter-car-isd",
            "a quarter car, but the plant 'half-car-isd' is a half car",
        ),
    ],
)
def test_who_cannot_drive_a_car_says_so(policy, network, model, words):
    known = model and Network.load(model)
    refused(words, lambda: find(policy, Network.load(network), model=known).make())


@pytest.mark.parametrize("net", [HALF, FULL, Network.load("half-car-passive")])
def test_corners_of_the_built_in_cars_are_the_quarter_car(net):
    car = vehicle(net)
    quarter = Network.load(
        "quarter-car-passive" if "passive" in net.name else "quarter-car-isd"
    )
    for corner in car.corners:
        own = car.quarter_car(corner)
        assert list(own.masses.values()) == list(quarter.masses.values())
        own_elements = sorted((e.type, *e.law_parameters()) for e in own.elements)
        assert own_elements == sorted(
            (e.type, *e.law_parameters()) for e in quarter.elements
        )


def test_corners_share_the_weight_by_the_lever_rule():
    data = HALF.to_dict()
    data["bodies"]["body"]["points"] = {
        "body_front": {"x": 1.0},
        "body_rear": {"x": -2.0},
    }
    data["outputs"] = data["outputs"][:1]
    data["uncertainty"] = {}
    assert vehicle(Network.load(data)).resting_masses == pytest.approx((460.0, 230.0))
    data["bodies"]["body"]["points"]["body_rear"]["x"] = 0.5
    with pytest.raises(InputError, match="does not rest on its wheels"):
        _ = vehicle(Network.load(data)).resting_masses


@pytest.mark.parametrize("policy", ["skyhook", "lqg", "mpc", "mpc-friction"])
def test_on_a_decoupled_half_car_each_corner_is_driven_as_a_quarter_car(policy):
    """Two quarter cars are driven; the half car that they make up gets the same currents."""
    steps, net = 300, decoupled_half_car()
    quarters, wanted = [], []
    for axle in range(2):
        env = ISDSuspensionVectorEnv(1, autoreset_mode="disabled")
        legs = travel(Crew(find(policy, env.network), 1), env, steps, seed=axle)
        seen, actions = zip(
            *((leg.seen[0].astype(float), leg.actions[0, 0]) for leg in legs),
            strict=True,
        )
        quarters.append(np.array(seen)), wanted.append(np.array(actions))
    front, rear = quarters
    heave, pitch = (front[:, 0] + rear[:, 0]) / 2, (rear[:, 0] - front[:, 0]) / 2.7
    observed = np.column_stack(
        [heave, pitch, front[:, 1:5], rear[:, 1:5], front[:, 5], rear[:, 5]]
    )
    driver = find(policy, net).make()
    driver.reset()
    found = np.array([driver.act(obs) for obs in observed])
    np.testing.assert_allclose(found, np.array(wanted).T, atol=1e-9)
    assert np.abs(wanted).max(axis=1).min() > 0.3


@pytest.mark.parametrize("name", ["lqg", *baselines.WHOLE_CAR])
@pytest.mark.parametrize("step", [4e-3, 5e-3])
def test_the_slew_limit_is_a_rate(name, step):
    """A current changes by at most 100 A/s, whatever the control step: 0.5 A in 5 ms."""
    controller = baselines.make(name, HALF, control_step=step)
    controller.reset()
    command = controller.act(np.full(12, 0.05, np.float32) * (np.arange(12) < 10))
    assert np.abs(command).max() == pytest.approx(100.0 * step)


def test_the_conventional_half_car_has_the_networks_own_body():
    data = HALF.to_dict()
    data["masses"]["wheel_rear"] = 60.0
    data["bodies"]["body"]["mass"] = 800.0
    data["bodies"]["body"]["points"]["body_front"]["x"] = 1.2
    data["elements"][0]["stiffness"] = 25000.0
    car = conventional(Network.load(data))
    assert car.masses == {"wheel_front": 45.0, "wheel_rear": 60.0}
    assert (
        car.bodies[0].mass == 800.0
        and car.element("main_spring_front").stiffness == 25000.0
    )
    assert [c.x for c in vehicle(car).corners] == [1.2, -1.35]


def test_score_of_a_half_car():
    result = score(
        ["passive", "isd-passive"],
        HALF,
        reference=passive(HALF),
        episodes=3,
        duration=2.0,
    )
    row, run = result.policies[1], result.runs["isd-passive"]
    travels = [row[f"suspension_travel_{c}_rms"]["value"] for c in ("front", "rear")]
    assert row["suspension_travel_rms"]["value"] == pytest.approx(rms(travels))
    assert (
        row["pitch_acceleration_rms"]["unit"] == "rad/s^2"
        and "change" in row["tyre_load_rear_rms"]
    )
    # the reward of the environment is minus the cost
    env = ISDSuspensionVectorEnv(3, HALF, autoreset_mode="disabled")
    env.reset(options={"scoring_road": 0})
    rewards = np.mean([env.step(np.zeros((3, 2)))[1] for _ in range(400)], axis=0)
    np.testing.assert_allclose(run.cost(result.cost), -rewards, rtol=1e-12)


def test_comfort_is_evaluated_at_the_driver_or_where_one_asks():
    """The acceleration of a point is that of the network's own output there."""
    run = drive(find("isd-passive", HALF), HALF, Conditions(episodes=1, duration=1.0))
    assert HALF.bodies[0].points[2].x == 0.1
    z, pitch = run.signals["body_acceleration"], run.signals["pitch_acceleration"]
    np.testing.assert_allclose(run.acceleration_at("driver"), z - 0.1 * pitch)
    brief, points = {"episodes": 1, "duration": 1.0}, (None, "driver", "body_front")
    told = {p: score("isd-passive", HALF, point=p, **brief) for p in points}
    weighted = {
        p: r.policies[-1]["weighted_acceleration_rms"]["value"] for p, r in told.items()
    }
    assert weighted[None] == weighted["driver"] != weighted["body_front"]
    assert told[None].to_dict()["comfort_point"] == "driver"
    words = r"no point 'nose'.*there are body, body_front, body_rear, driver"
    refused(words, score, "isd-passive", HALF, point="nose", **brief)


def test_every_wheel_has_its_own_road_ahead():
    """The rear wheels meet the front's road later; both tracks differ."""
    env = ISDSuspensionVectorEnv(
        2, network="full-car-isd", observation="preview", preview=0.1, speed=17.0
    )
    controller = baselines.make("lqg-preview", "full-car-isd", preview=0.1, speed=17.0)
    controller.reset_batch(2)
    seen, _ = env.reset(seed=0)
    shown, heights = [], []
    for _ in range(80):
        heights.append(env.task.batch.road_heights.copy())
        shown.append(controller.observed(np.asarray(seen, float)))
        seen, *_ = env.step(np.zeros((2, 4), np.float32))
    for wheel in range(4):
        ahead = np.array(heights[51:71])[:, wheel].T - heights[50][wheel][:, None]
        # 31.8 control steps behind: linear between two of them
        np.testing.assert_allclose(
            shown[50][wheel][:, 6:], ahead, atol=1e-8 if wheel < 2 else 2e-3
        )
        assert np.abs(ahead).max() > 4e-3
