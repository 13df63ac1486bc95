"""The clairvoyant optimum: reached by the real environment, within the limits, and above its proven bound."""

import json

import gymnasium as gym
import numpy as np
import pytest

from isd_gym._common.errors import InputError
from isd_gym._common.seeds import scoring_generator
from isd_gym.benchmark.policies import find
from isd_gym.benchmark.scoring import drive
from isd_gym.contrib.ceilings import clairvoyant as oracle
from isd_gym.physics.cost import StageCost
from isd_gym.physics.network import Network
from isd_gym.physics.road import road


def _convex():
    model = Network.load("quarter-car-isd").to_dict()
    model["elements"] = [e for e in model["elements"] if e["name"] not in ("seal", "end_stop")]
    model["uncertainty"] = {}
    return Network.from_dict(model)


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


def test_bad_input_is_one_line():
    with pytest.raises(InputError, match="no motor"):
        oracle.clairvoyant("quarter-car-passive", seed=0)
    with pytest.raises(InputError, match="either heights, a seed or a scoring road"):
        oracle.clairvoyant()
    with pytest.raises(InputError, match="heights must be finite"):
        oracle.clairvoyant(heights=np.zeros(5003))
    model = Network.load("quarter-car-isd").to_dict()
    model["elements"].append(
        {"name": "lag", "type": "actuator_lag", "element": "motor", "time_constant": 0.01}
    )
    with pytest.raises(InputError, match="ideal drive"):
        oracle.clairvoyant(Network.from_dict(model), seed=0)


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
    found = oracle.clairvoyant(_convex(), seed=1, duration=4.0)
    assert found.gap is not None
    assert 0.0 <= found.gap < 0.001


def _costs(name, episodes):
    net = Network.load("quarter-car-isd")
    return drive(find(name, net), net, episodes=episodes).cost(StageCost())


@pytest.mark.slow
@pytest.mark.parametrize("name", ["isd-passive", "skyhook", "add", "lqg", "lqr-full", "mpc", "mpc-friction"])
def test_no_causal_controller_is_better_on_its_road(name):
    assert np.all(_costs(name, 32) > oracle.reachable("quarter-car-isd")["value"])


@pytest.mark.slow
def test_shipped_value_comes_again():
    heights = road("paper").heights(20.0, rng=scoring_generator(3))
    found = oracle.clairvoyant(heights=heights)
    known = oracle.reference()
    assert found.value == pytest.approx(known["value"][3], rel=0.006)
    assert found.lower == pytest.approx(known["lower"][3], rel=1e-3)
