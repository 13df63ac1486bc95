"""Ceilings: exact where Riccati knows the answer, above what causal controllers reach, within the clairvoyant optimum."""

import json

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils import seeding
from program import refused

import isd_gym.contrib.ceilings.ceiling as module
from isd_gym._common.seeds import scoring_generator
from isd_gym.benchmark.policies import find, passive
from isd_gym.benchmark.scoring import drive
from isd_gym.contrib.ceilings import bounds
from isd_gym.contrib.ceilings import clairvoyant as oracle
from isd_gym.contrib.ceilings.ceiling import CeilingSettings, NewsValue, ceiling, known, passive_cost, stitch
from isd_gym.contrib.ceilings.clairvoyant import Episode, Schedule
from isd_gym.physics._prediction import Weights, prediction_model, preview_regulator, regulator
from isd_gym.physics.cost import StageCost
from isd_gym.physics.network import Network
from isd_gym.physics.road import paper_road, road
from isd_gym.physics.simulate import Plant

CAR, PAPER, COST = Network.load("quarter-car-isd"), road("paper"), StageCost()


def _linear():
    model = CAR.to_dict()
    model["elements"] = [e for e in model["elements"] if e["name"] not in ("seal", "end_stop")]
    model["uncertainty"] = {}
    return Network.from_dict(model)


def _heights(seed, duration):
    return PAPER.heights(duration, rng=seeding.np_random(seed)[0])


@pytest.mark.slow
@pytest.mark.parametrize("preview", [0, 1, 20])
def test_on_a_linear_car_without_limits_every_road_gives_the_riccati_value(preview):
    # through the real kernel: the penalised optimum of a road that is known whole is what a causal controller has on average
    net, steps = _linear(), 200
    value = NewsValue(net, PAPER, 20.0, steps, COST, settings=CeilingSettings(move=0.0, centring=0.0))
    found = []
    for seed in (1, 2):
        heights = _heights(seed, steps * 5e-3)
        penalty, _ = value.penalty(heights, preview)
        episode = Episode(net, heights, cost=COST, slew_limit=1e3, current_limit=1e4, penalty=penalty)
        currents = episode.optimise(Schedule(((0.0, 1e-3), (0.0, 1e-6)), 20))
        found.append(episode.cost_of(episode.rollout(currents)))
    np.testing.assert_allclose(found, value.value(preview), rtol=1e-8)


def test_its_value_is_that_of_the_stationary_riccati_equation():
    net = _linear()
    value = NewsValue(net, PAPER, 20.0, 3000, COST, settings=CeilingSettings(move=0.0, centring=0.0))
    model = prediction_model(net, 5e-3)
    _, V = regulator(model, Weights(COST, centring=0.0))
    stage = model.C.T @ (Weights(COST, centring=0.0).signals[:, None] * model.C)
    expected = np.trace((V + stage) @ model.W)
    assert np.trace(value.M[100, :-1, :-1] @ value.W) == pytest.approx(expected, rel=1e-3)


def test_knowing_more_is_worth_more_and_the_whole_road_most():
    value = NewsValue(_linear(), PAPER, 20.0, 200, COST, settings=CeilingSettings(move=0.0, centring=0.0))
    values = [value.value(n) for n in (0, 1, 5, 20, 80, 200)]
    assert np.all(np.diff(values) < 0)


@pytest.mark.slow
@pytest.mark.parametrize("preview", [0, 4])
def test_the_penalty_has_no_mean_whatever_a_causal_policy_does(preview):
    # a policy that reacts to what it sees, on the real car with friction and stops; 24 roads of 2 s
    value = NewsValue(CAR, PAPER, 20.0, 400, COST)
    lqg = drive(find("lqg", CAR), CAR, episodes=24, seed=50, duration=2.0)
    charged, cost = [], []
    for i in range(24):
        heights = _heights(50 + i, 2.0)
        penalty, _ = value.penalty(heights, preview)
        bare, charging = (Episode(CAR, heights, cost=COST, penalty=p) for p in (None, penalty))
        currents = lqg.current[:, i]
        cost.append(bare.cost_of(bare.rollout(currents)))
        charged.append(cost[-1] - charging.cost_of(charging.rollout(currents)))
    error = np.std(charged, ddof=1) / np.sqrt(24)
    assert abs(np.mean(charged)) < 3 * error
    # the penalty charges for information on the road: for a causal policy it explains most of the variance between roads
    assert np.std(np.array(cost) - charged) < 0.5 * np.std(cost)
    np.testing.assert_allclose(cost, lqg.cost(COST), rtol=1e-9)


@pytest.mark.slow
def test_a_stitch_of_one_solution_is_that_solution():
    value = NewsValue(CAR, PAPER, 20.0, 200, COST)
    heights = _heights(3, 1.0)
    penalty, slope = value.penalty(heights)
    episode = Episode(CAR, heights, cost=COST, penalty=penalty)
    currents = np.cumsum(np.random.default_rng(0).uniform(-0.3, 0.3, 200))
    np.testing.assert_array_equal(stitch(episode, value, slope, [currents, currents]), currents)


def test_passive_cost_in_expectation_is_what_is_driven():
    exact = passive_cost(CAR, PAPER, 20.0, 20.0, COST)
    run = drive(passive(CAR), CAR, episodes=64, seed=7000)
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


def test_bad_input_is_one_line():
    refused("no motor", NewsValue, Network.load("quarter-car-passive"), PAPER, 20.0, 100, COST)
    refused("rough road", NewsValue, CAR, road("bump"), 20.0, 100, COST)
    refused("whole number", ceiling, preview=0.0123)
    refused(">= 0", CeilingSettings, move=-1.0)
    refused("no causal controller", bounds.best_acceleration, -0.5, -0.2)
    refused("not random", bounds.reference, road="bump")


def test_the_shipped_ceiling_is_above_every_causal_controller():
    found = ceiling(compute=False)
    assert found is not None, "regenerate: isd-gym ceiling --store isd_gym/benchmark/bounds/ceiling.json"
    assert found.standard_error / found.passive < 0.003
    # proven is farther away than what is searched, and nearer than the clairvoyant's proven bound
    assert -0.6 < found.proven.mean() / found.passive - 1 < found.change < -0.24
    idle = drive(passive(CAR), CAR, episodes=4).cost(COST).mean()
    for name in ("mpc-friction", "lqr-full"):  # the full state is no knowledge of the road
        own = drive(find(name, CAR), CAR, episodes=4).cost(COST).mean()
        assert own / idle - 1 > found.change


def test_a_score_quotes_no_ceiling_of_few_roads(tmp_path, monkeypatch):
    """Two roads have no standard error to speak of."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    kept = {600_000 + i: {"reached": 0.6, "proven": 0.5} for i in range(3)}
    monkeypatch.setattr(module, "read", lambda key, file: dict(kept))
    assert known("quarter-car-isd") is None
    kept[600_003] = {"reached": 0.61, "proven": 0.51}
    assert known("quarter-car-isd")["roads"] == 4


@pytest.mark.parametrize(
    ("travel", "tyre", "acceleration"), [(-0.17, -0.006, -0.131), (0.0, 0.0, -0.171), (-0.10, 0.024, -0.186)]
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


def test_motor_without_effort_comes_near_the_bound_and_never_below():
    free = bounds.lq_bound()
    assert free.triple == pytest.approx(bounds.lq_bound("quarter-car-eq8").triple, rel=1e-9)  # of any device
    costs = []
    for effort in (1e-2, 1e-6, 1e-10):
        p = bounds.lq_bound(effort=effort)
        costs.append(float(p.weights @ p.triple**2))
    assert costs[0] > costs[1] > costs[2] > free.cost
    assert costs[2] == pytest.approx(free.cost, rel=1e-4)


def test_law_rolled_out_costs_what_riccati_says():
    lanes, steps, h = 48, 8000, 1e-3
    net = bounds.ideal("quarter-car-isd")
    point = bounds.lq_bound(weights=(1, 0.5, 0.5))
    car = bounds.linear_car(net)
    plant = Plant(net, h, lanes=lanes, extra=bounds.vehicle(net).channels)
    rng = np.random.default_rng(3)
    gain, _ = paper_road().noise(20.0, h)
    road = np.cumsum(np.vstack([np.zeros((1, lanes)), gain * rng.standard_normal((steps, lanes))]), axis=0)
    state, out = plant.state(), np.zeros((plant.n_outputs, lanes))
    total = np.zeros(3)
    for k in range(steps):
        x = car.seen.T @ (state[: plant.n] - car.lift[:, None] * road[k])
        force = -(point.gain @ x)
        u = np.stack([road[k], road[k + 1]])[:, None]
        c = force[None, None]
        plant.kernel.advance(plant.mats, plant.ints, state, u, c, lanes)
        if k >= 2000:  # stationary by then
            plant.kernel.measure(plant.mats, plant.ints, state, u[1], c[0], lanes, out)
            total += np.mean(out[[0, 1, 5]] ** 2, axis=1)
    cost = float(point.weights @ total / (steps - 2000))
    # 48 x 6 s: the standard error is about 1.5 %
    assert cost == pytest.approx(point.cost, rel=0.05)


def test_shipped_values_are_those_of_the_score():
    found = oracle.reference()
    assert found is not None, "regenerate: python -m isd_gym.contrib.ceilings.clairvoyant"
    assert found["value"].shape == (32,)
    assert np.all(found["lower"] < found["value"])
    # the cost belongs to the triple
    cost = StageCost()(found["acceleration"], found["travel"])
    np.testing.assert_allclose(cost, found["value"], rtol=1e-4)


def test_unknown_episodes_are_none_and_nothing_is_computed():
    assert oracle.reachable("quarter-car-isd", seed=900_000) is None
    assert oracle.reachable("quarter-car-isd", speed=21.0) is None


def test_cache_keeps_what_was_computed(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    calls = []

    def fake(network, *, seed, **_):
        calls.append(seed)
        return oracle.Clairvoyant(np.zeros(4), 0.1 * seed, None, np.full(3, 0.5), (0.1 * seed,))

    monkeypatch.setattr(oracle, "clairvoyant", fake)
    first = oracle.reference(road="C", episodes=2, seed=5, compute=True)
    again = oracle.reference(road="C", episodes=2, seed=5)
    assert calls == [5, 6]
    assert again is not None
    np.testing.assert_array_equal(first["value"], again["value"])
    assert np.isnan(again["lower"]).all()
    assert json.loads((tmp_path / "isd_gym" / "clairvoyant.json").read_text())


def test_what_has_no_clairvoyant_optimum_is_one_line():
    refused("no motor", oracle.clairvoyant, "quarter-car-passive", seed=0)
    refused("either heights, a seed or a scoring road", oracle.clairvoyant)
    refused("heights must be finite", oracle.clairvoyant, heights=np.zeros(5003))
    lag = {"name": "lag", "type": "actuator_lag", "element": "motor", "time_constant": 0.01}
    refused("ideal drive", oracle.clairvoyant, CAR.with_element(lag), seed=0)


@pytest.mark.slow
def test_reached_by_the_environment_within_the_limits():
    found = oracle.clairvoyant(seed=4, duration=3.0)
    steps = np.diff(found.currents, prepend=0.0)
    assert np.abs(steps).max() <= 0.5 and np.abs(found.currents).max() <= 5.0
    assert np.abs(steps).max() > 0.49  # it uses what it may
    env = gym.make("ISDSuspension-v0")
    env.reset(seed=4)
    total = -sum(float(env.step(np.array([i]))[1]) for i in found.currents)
    assert total / len(found.currents) == pytest.approx(found.value, rel=1e-9)
    env.reset(seed=4)
    idle = -sum(float(env.step(np.zeros(1))[1]) for _ in found.currents) / len(found.currents)
    assert found.lower is not None
    assert 0.4 * idle < found.lower / 0.5 and found.lower < found.value < 0.6 * idle


@pytest.mark.slow
def test_without_friction_and_stops_reached_and_proven_meet():
    # the problem is then convex: two independent solvers, DDP through the kernel and the dual of the relaxation, must agree
    found = oracle.clairvoyant(_linear(), seed=1, duration=4.0)
    assert found.gap is not None
    assert 0.0 <= found.gap < 0.001


@pytest.mark.slow
@pytest.mark.parametrize("name", ["isd-passive", "skyhook", "add", "lqg", "lqr-full", "mpc", "mpc-friction"])
def test_no_causal_controller_is_better_on_its_road(name):
    own = drive(find(name, CAR), CAR, episodes=32).cost(COST)
    assert np.all(own > oracle.reachable("quarter-car-isd")["value"])


@pytest.mark.slow
def test_shipped_value_comes_again():
    heights = road("paper").heights(20.0, rng=scoring_generator(3))
    found = oracle.clairvoyant(heights=heights)
    known = oracle.reference()
    assert found.value == pytest.approx(known["value"][3], rel=0.006)
    assert found.lower == pytest.approx(known["lower"][3], rel=1e-3)
