"""The causal ceiling: exact where Riccati knows the answer, a penalty of zero mean, below what causal controllers reach."""

import numpy as np
import pytest
from gymnasium.utils import seeding

from isd_gym._common.errors import InputError
from isd_gym.baselines._model import Weights, prediction_model, preview_regulator, regulator
from isd_gym.benchmark.policies import find, passive
from isd_gym.benchmark.scoring import drive
from isd_gym.contrib.ceilings.ceiling import (
    Ceiling,
    CeilingSettings,
    NewsValue,
    ceiling,
    known,
    passive_cost,
    stitch,
)
from isd_gym.contrib.ceilings.clairvoyant import Episode, Schedule
from isd_gym.physics.cost import StageCost
from isd_gym.physics.network import Network
from isd_gym.physics.road import road

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
    assert np.einsum("ij,ji->", value.M[100, :-1, :-1], value.W) == pytest.approx(
        np.einsum("ij,ji->", V + stage, model.W), rel=1e-3
    )


def test_knowing_more_is_worth_more_and_the_whole_road_most():
    value = NewsValue(_linear(), PAPER, 20.0, 200, COST, settings=CeilingSettings(move=0.0, centring=0.0))
    values = [value.value(n) for n in (0, 1, 5, 20, 80, 200)]
    assert np.all(np.diff(values) < 0)


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
    with pytest.raises(InputError, match="no motor"):
        NewsValue(Network.load("quarter-car-passive"), PAPER, 20.0, 100, COST)
    with pytest.raises(InputError, match="rough road"):
        NewsValue(CAR, road("bump"), 20.0, 100, COST)
    with pytest.raises(InputError, match="whole number"):
        ceiling(preview=0.0123)
    with pytest.raises(InputError, match=">= 0"):
        CeilingSettings(move=-1.0)


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


def test_the_sentence_names_the_sight():
    ahead = known("quarter-car-isd", preview=0.1)["sentence"]
    assert ahead.startswith(
        "The ceiling with 0.1 s of road ahead is an estimate, not a proven bound: J -39.4 +- 0.2 %"
    )
    assert "No controller that sees 0.1 s of road ahead is known to be better" in ahead
    few = Ceiling(0.0, np.full(4, 0.6), np.full(4, np.nan), 0.85).sentence
    assert "There is no proven bound." in few and "nan" not in few


def test_a_score_quotes_no_ceiling_of_few_roads(tmp_path, monkeypatch):
    """Two roads have no standard error to speak of."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    import isd_gym.contrib.ceilings.ceiling as module

    kept = {600_000 + i: {"reached": 0.6, "proven": 0.5} for i in range(3)}
    monkeypatch.setattr(module, "read", lambda key, file: dict(kept))
    assert known("quarter-car-isd") is None
    kept[600_003] = {"reached": 0.61, "proven": 0.51}
    assert known("quarter-car-isd")["roads"] == 4
