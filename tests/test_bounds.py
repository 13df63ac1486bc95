"""Bounds of a score: the causal bound against closed forms, and stored ceilings above every causal controller."""

import numpy as np
import pytest
from program import refused

from isd_gym import Network, StageCost
from isd_gym.benchmark import ceilings as module
from isd_gym.benchmark import lq_bounds as bounds
from isd_gym.benchmark.ceilings import ceiling, passive_cost, reachable
from isd_gym.benchmark.policies import find, passive
from isd_gym.benchmark.scoring import Conditions, drive
from isd_gym.physics.prediction import (
    Weights,
    prediction_model,
    preview_regulator,
    regulator,
)
from isd_gym.physics.road import road

CAR, PAPER, COST = Network.load("quarter-car-isd"), road("paper"), StageCost()


def _linear():
    model = CAR.to_dict()
    model["elements"] = [
        e for e in model["elements"] if e["name"] not in ("seal", "end_stop")
    ]
    model["uncertainty"] = {}
    return Network.from_dict(model)


def test_passive_cost_in_expectation_is_what_is_driven():
    exact = passive_cost(CAR, PAPER, 20.0, 20.0, COST)
    run = drive(passive(CAR), CAR, Conditions(episodes=64, seed=7000))
    cost = run.cost(COST)
    assert abs(cost.mean() - exact) < 3 * cost.std() / 8


def test_preview_regulator_without_points_is_the_regulator_and_with_them_it_gains():
    model = prediction_model(_linear(), 5e-3)
    weights = Weights(COST, effort=0.01, centring=0.01)
    K, G = preview_regulator(model, weights, 40)
    np.testing.assert_array_equal(K, regulator(model, weights)[0])
    # rolled out on the linear car, full state, the law with the road ahead costs less; its first weights matter most
    rng = np.random.default_rng(0)
    rises = 1.4e-3 * rng.standard_normal(4000)

    def cost(G):
        x, total = np.zeros(model.n), 0.0
        for k in range(3900):
            i = float(-K @ x - G @ rises[k : k + len(G)])
            x = model.A @ x + model.B * i + model.P * rises[k]
            y = model.C @ x + model.D * i
            total += weights.signals @ y**2 + weights.current * i**2
        return total

    costs = [cost(G[:n]) for n in (0, 10, 40)]
    assert costs[2] < costs[1] < costs[0]
    for slip in (0.9, 1.1):  # an optimum: what changes the weights makes it worse
        assert cost(slip * G) > costs[2]


@pytest.mark.parametrize(
    ("travel", "tyre", "acceleration"),
    [(-0.17, -0.006, -0.131), (0.0, 0.0, -0.171), (-0.10, 0.024, -0.186)],
)
def test_best_acceleration_is_design_s(travel, tyre, acceleration):
    best = bounds.best_acceleration(travel, tyre)
    assert best.acceleration_change == pytest.approx(acceleration, abs=1e-3)
    assert best.travel_change == pytest.approx(travel, abs=1e-4)
    assert best.tyre_change == pytest.approx(tyre, abs=1e-4)


def test_reference_is_the_closed_form_of_the_passive_car():
    # known in closed form for a spring-damper quarter car on white velocity S (Newland): travel and tyre load
    ms, mu, k, c, kt, S = 345.0, 45.0, 22e3, 1500.0, 192e3, (2 * np.pi) ** 2 * 5e-7 * 20
    travel2 = S * (ms + mu) / (2 * c)
    accel2 = S * (k**2 * (ms + mu) + kt * c**2) / (2 * c * ms**2)
    rms = bounds.reference()
    assert rms[0] ** 2 == pytest.approx(accel2, rel=1e-6)
    assert rms[1] ** 2 == pytest.approx(travel2, rel=1e-6)


def test_the_bound_does_not_depend_on_the_device():
    free = bounds.lq_bound()
    assert free.triple == pytest.approx(
        bounds.lq_bound("quarter-car-eq8").triple, rel=1e-9
    )
    assert free.cost == pytest.approx(float(free.weights @ free.triple**2), rel=1e-4)


def test_bad_input_is_one_line():
    refused("no causal controller", bounds.best_acceleration, -0.5, -0.2)
    refused("not random", bounds.reference, road="bump")


def test_the_ceiling_is_above_every_causal_controller():
    found = ceiling("quarter-car-isd")
    assert found.standard_error < 0.003
    # proven is farther away than what is searched
    assert -0.6 < found.proven_change < found.change < -0.24
    idle = drive(passive(CAR), CAR, Conditions(episodes=4)).cost(COST).mean()
    for name in (
        "mpc-friction",
        "lqr-full",
    ):  # the full state is no knowledge of the road
        own = drive(find(name, CAR), CAR, Conditions(episodes=4)).cost(COST).mean()
        assert own / idle - 1 > found.change


def test_a_score_quotes_no_ceiling_of_few_roads(monkeypatch):
    """Three roads have no standard error to speak of."""
    stored = module._stored("ceiling.json")

    def few(name):
        return {
            key: {"seeds": dict(list(one["seeds"].items())[:3])}
            for key, one in stored.items()
        }

    assert len(ceiling("quarter-car-isd").roads) == 8
    monkeypatch.setattr(module, "_stored", few)
    assert (
        ceiling("quarter-car-isd") is None
        and ceiling("quarter-car-isd", "bump") is None
    )


def test_the_clairvoyant_optimum_is_that_of_the_score():
    found = reachable(CAR, Conditions())
    assert found["value"].shape == (32,) and np.all(found["lower"] < found["value"])
    cost = COST(
        found["body_acceleration"], found["suspension_travel"]
    )  # the cost belongs to the triple
    np.testing.assert_allclose(cost, found["value"], rtol=1e-4)
    assert (
        reachable(CAR, Conditions(seed=900_000)) is None
        and reachable(CAR, Conditions(speed=21.0)) is None
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["lqr-full", "mpc-friction"])  # the best ones
def test_no_causal_controller_is_better_on_its_road(name):
    own = drive(find(name, CAR), CAR, Conditions()).cost(COST)
    assert np.all(own > reachable(CAR, Conditions())["value"])
