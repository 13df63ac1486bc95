"""The value of news of the road for a linear car."""

import numpy as np
import pytest
from program import refused

from isd_gym.contrib.ceilings.ceiling import CeilingSettings, NewsValue
from isd_gym.physics._prediction import Weights, prediction_model, regulator
from isd_gym.physics.cost import StageCost
from isd_gym.physics.network import Network
from isd_gym.physics.road import road

CAR, PAPER, COST = Network.load("quarter-car-isd"), road("paper"), StageCost()


def _linear():
    model = CAR.to_dict()
    model["elements"] = [e for e in model["elements"] if e["name"] not in ("seal", "end_stop")]
    model["uncertainty"] = {}
    return Network.from_dict(model)


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


def test_bad_input_is_one_line():
    refused("no motor", NewsValue, Network.load("quarter-car-passive"), PAPER, 20.0, 100, COST)
    refused("rough road", NewsValue, CAR, road("bump"), 20.0, 100, COST)
    refused(">= 0", CeilingSettings, move=-1.0)
