"""The whole car as a controller believes it to be: against the kernel, the Riccati equation, and the road behind the front axle."""

from dataclasses import replace

import numpy as np
import pytest
from builders import decoupled_half_car
from program import refused

from isd_gym import ISDSuspensionVectorEnv, Network, StageCost, baselines
from isd_gym.benchmark.driving import Crew, Entry, travel
from isd_gym.benchmark.lq_bounds import (
    blind_gain,
    ideal,
    lq_bound,
    reference,
    simulated_cost,
    wheelbase_bound,
)
from isd_gym.benchmark.policies import find
from isd_gym.physics.car_prediction import CarWeights, car_model, car_regulator
from isd_gym.physics.road import Road
from isd_gym.physics.vehicle import vehicle

STEP = 5e-3


def linear(name):
    """A built-in car without friction and end stops."""
    net = Network.load(name)
    kept = tuple(
        e for e in net.elements if e.type not in ("coulomb_friction", "bump_stop")
    )
    return replace(net, elements=kept, uncertainty={})


def weights(net):
    car = vehicle(net)
    return CarWeights(
        StageCost.of(None, car.axes, len(car.corners)), effort=0.01, centring=0.03
    )


@pytest.mark.parametrize("speed", [20.0, 13.7, 400.0])
@pytest.mark.parametrize("name", ["half-car-isd", "full-car-isd"])
def test_the_model_predicts_what_the_kernel_does(name, speed):
    """On a road that is straight between control steps the delay line of whole control steps has all that the rear wheels meet."""
    net, steps = linear(name), 120
    model, tracks = car_model(net, STEP, speed), vehicle(net).wheels.tracks
    rng = np.random.default_rng(0)
    rises = rng.normal(size=(tracks, steps)) * 1e-3
    heights = np.concatenate([np.zeros((tracks, 1)), np.cumsum(rises, axis=1)], axis=1)
    abscissa = np.arange(steps + 1) * STEP * speed
    profile = heights if tracks == 2 else heights[0]
    road = Road("own", abscissa=abscissa, profile=profile)
    options = {"road": road, "speed": speed, "duration": steps * STEP}
    env = ISDSuspensionVectorEnv(1, net, autoreset_mode="disabled", **options)
    env.reset(seed=0)
    x, found, predicted = np.zeros(model.n), [], []
    for k in range(steps):
        env.step(rng.uniform(-5, 5, (1, len(model.car.driven))))
        currents = env.task.batch.currents[:, 0]
        x = model.A @ x + model.inputs @ currents + model.gamma @ rises[:, k]
        predicted.append(model.C @ x + model.feedthrough @ currents)
        found.append(env.task.batch.out[: len(model.C), 0].copy())
    found, predicted = np.array(found), np.array(predicted)
    error = np.abs(found - predicted).max(axis=0) / np.abs(found).max(axis=0)
    # other delays are interpolated in steps of 5 ms here, of 1 ms there
    exact = np.allclose(model.delays, np.round(model.delays))
    assert error.max() < (1e-6 if exact else 0.3)
    if not exact:
        names = [c.name for c in model.car.channels]
        travels = [j for j, n in enumerate(names) if n.startswith("suspension_travel_")]
        left = np.mean((found - predicted)[:, travels] ** 2)
        assert left < 0.05**2 * np.mean(found[:, travels] ** 2)


@pytest.mark.parametrize(
    ("name", "speed"),
    [("half-car-isd", 20.0), ("half-car-isd", 33.0), ("full-car-isd", 30.0)],
)
def test_the_optimum_costs_what_the_riccati_equation_says(name, speed):
    model = car_model(linear(name), STEP, speed)
    K, cost = car_regulator(model, weights(model.network))
    assert simulated_cost(model, weights(model.network), K) == pytest.approx(
        cost, rel=1e-6
    )
    for change in (0.98, 1.02):
        assert simulated_cost(model, weights(model.network), change * K) > cost


@pytest.mark.parametrize("speed", [10.0, 20.0, 33.3, 2000.0])
def test_knowledge_of_the_rear_road_lowers_the_optimum(speed):
    """And the less, the shorter the delay is: at 2000 m/s there is a quarter of a control step to know."""
    net = linear("half-car-isd")
    model, blind = (
        car_model(net, STEP, speed),
        car_model(net, STEP, speed, wheelbase=False),
    )
    _, known = car_regulator(model, weights(net))
    K, believed = car_regulator(blind, weights(net))
    unknown = simulated_cost(model, weights(net), blind_gain(model, blind, K))
    assert known <= unknown
    gain = 1 - known / unknown
    assert (gain > 0.05) if speed < 50 else (gain < 0.01)
    assert believed == pytest.approx(unknown, rel=0.05)


def test_the_estimate_sees_the_rear_road_come():
    """The delay line of the estimator has the rises that the front wheel met, friction and all."""
    net = Network.load("half-car-isd")
    made = baselines.make("lqg-wheelbase", net)
    env = ISDSuspensionVectorEnv(16, net, autoreset_mode="disabled")
    heights = []
    for _ in travel(Crew(Entry("lqg-wheelbase", lambda: made), 16), env, 600, seed=0):
        heights.append(env.task.batch.road_heights.copy())
    # (27, cars), the youngest first, of one step before the last
    line = made.estimator.x[made.prediction.motion :]
    met = np.diff(np.array(heights), axis=0)[:, 0][-2 : -2 - len(line) : -1]
    for rises in (slice(0, 10), slice(None)):  # over 50 ms, and over the wheelbase
        seen, true = line[rises].sum(axis=0), met[rises].sum(axis=0)
        assert np.mean((seen - true) ** 2) < 0.08 * np.mean(true**2)


def test_controllers_are_told_the_speed():
    """27 control steps between the axles at 20 m/s, 54 at 10 m/s; the MPC plans with as much road under the rear wheel."""
    net = Network.load("half-car-isd")
    for speed, steps in ((20.0, 27), (10.0, 54), (30.0, 18)):
        law, plan = (
            find(f"{name}-wheelbase", net, speed=speed).make()
            for name in ("lqg", "mpc")
        )
        for controller in (law, plan):
            assert np.round(controller.prediction.delays).tolist() == [0, steps]
        assert [c.preview for c in plan.corners] == pytest.approx([0.0, STEP * steps])
    assert find("skyhook", net, speed=10.0).make()


def test_a_quarter_car_has_no_wheelbase():
    words = "of a car with two axles, but network 'quarter-car-isd' is a quarter car"
    refused(words, baselines.make, "lqg-wheelbase", "quarter-car-isd")
    refused(
        "speed must be a positive number", baselines.make, "lqg-wheelbase", speed=0.0
    )


def test_the_bound_of_a_decoupled_half_car_is_that_of_its_quarter_cars():
    """Weights under which heave and pitch cost what the accelerations of the axles cost, and no knowledge of the rear road."""
    net = decoupled_half_car()
    quarter = lq_bound("quarter-car-isd", weights=(0.6, 0.3, 0.0))
    a, l, _ = reference("quarter-car-isd")
    # (a_front^2 + a_rear^2) / 2 = heave^2 + (1.35 pitch)^2
    cost = StageCost(
        acceleration=0.6, acceleration_reference=a, pitch=0.6, pitch_reference=a / 1.35,
        travel=0.3, travel_reference=float(l),
    )  # fmt: skip
    found = wheelbase_bound(net, cost=cost)
    assert found.blind == pytest.approx(quarter.cost, rel=3e-3)
    assert found.passive == pytest.approx(0.9, rel=2e-3)
    assert found.cost < 0.9 * found.blind


def test_what_has_no_bound():
    for network in ("full-car-isd", "quarter-car-isd"):
        refused("axles in one track", wheelbase_bound, network=network)
    refused("needs a rough road", wheelbase_bound, road="bump")
    # a mass inside the suspension
    data = Network.load("half-car-isd").to_dict()
    data["masses"]["piston_front"] = 1.0
    data["uncertainty"] = {}
    refused("wheels without other masses", ideal, Network.load(data))
