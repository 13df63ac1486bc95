"""A force given by a table: against the law it was made of, in the kernel, the environment and the controllers."""

import json

import gymnasium
import numpy as np
import pytest
from program import refused

from isd_gym import Network, baselines, linearise, simulate

D, V = np.linspace(-0.06, 0.06, 241), np.linspace(-2.0, 2.0, 401)


def car(element):
    extra = {"name": "extra", "between": ["body", "wheel"], **element}
    return Network.load("quarter-car-isd").with_element(extra)


def tabulated(**table):
    """Return a force by a table, whose arrays are lists as in a file."""
    lists = {k: v.tolist() for k, v in table.items() if isinstance(v, np.ndarray)}
    return {"type": "tabulated_force", **table, **lists}


def road(t):
    return {"road": 0.01 * np.sin(9.0 * t) + 0.004 * np.sin(31.0 * t), "current": 0 * t}


@pytest.mark.parametrize(
    ("law", "table"),
    [
        ({"type": "quadratic_damping", "damping": 3000.0}, {"rate": V, "force": 3000.0 * V * np.abs(V)}),
        ({"type": "cubic_stiffness", "stiffness": 2e7}, {"elongation": D, "force": 2e7 * D**3, "beyond": "slope"}),
        (
            {"type": "asymmetric_damping", "extension": 900.0, "compression": 200.0},
            {"elongation": [-0.1, 0.1], "rate": [-2.0, 0.0, 2.0], "force": [[-400.0, 0.0, 1800.0]] * 2},
        ),
    ],
)  # fmt: skip
def test_a_table_does_what_its_law_does(law, table):
    t = np.arange(0, 2, 1e-3)
    by_law = simulate(car(law), t, road(t))
    without = simulate(Network.load("quarter-car-isd"), t, road(t))
    # a kink is not smooth
    for interpolation in (
        ("linear", "smooth") if len(table["force"]) > 3 else ("linear",)
    ):
        by_table = simulate(
            car(tabulated(interpolation=interpolation, **table)), t, road(t)
        )
        for name in by_law:
            moved = np.abs(by_law[name] - without[name]).max()
            assert moved > 0
            assert np.abs(by_table[name] - by_law[name]).max() < 0.02 * moved + 1e-9


def test_beyond_its_ends_a_table_holds_its_force_or_its_slope():
    element = tabulated(rate=[-1.0, 0.0, 1.0], force=[-2.0, 0.0, 4.0])
    axis = np.array([-3.0, 3.0])
    assert np.allclose(car(element).element("extra").curve(axis), [-2.0, 4.0])
    assert np.allclose(
        car({**element, "beyond": "slope"}).element("extra").curve(axis), [-6.0, 12.0]
    )
    assert np.allclose(
        car({**element, "scale": 0.5}).element("extra").curve(axis), [-1.0, 2.0]
    )


def test_a_table_is_written_as_it_was_read():
    net = car(
        tabulated(
            elongation=[0.0, 1.0], rate=[0.0, 1.0, 2.0], force=[[0, 1, 2], [1, 2, 3]]
        )
    )
    assert Network.load(json.loads(net.dumps())) == net
    assert (
        "elongation"
        not in car(tabulated(rate=[0, 1], force=[0, 1])).element("extra").to_dict()
    )


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"force": [1.0]}, "over .elongation., over .rate. or over both"),
        ({"rate": [0.0, 0.0], "force": [0.0, 1.0]}, "each larger than the one before"),
        ({"rate": [0.0, 1.0], "force": [0.0]}, "2 numbers, one a knot, not 1"),
        (
            {"rate": [0.0, 1.0], "elongation": [0.0, 1.0], "force": [0.0, 1.0]},
            "must be a list",
        ),
        ({"rate": [0.0, float("nan")], "force": [0.0, 1.0]}, "finite"),
        ({"rate": "all", "force": [0.0, 1.0]}, "must be a list of at most"),
    ],
)
def test_a_table_that_is_none_is_said_in_a_line(table, words):
    refused(words, car, tabulated(**table))


@pytest.mark.slow
def test_the_environment_and_the_controllers_take_a_table():
    knots = np.linspace(-0.5, 0.5, 21)
    net = car(tabulated(rate=knots, force=400.0 * np.tanh(8.0 * knots)))
    slope = car(
        {
            "type": "linear_damping",
            "damping": 400.0 * np.tanh(8.0 * knots[11]) / knots[11],
        }
    )
    assert np.allclose(
        linearise(net).A,
        linearise(slope).A,
        atol=1e-6 * np.abs(linearise(slope).A).max(),
    )
    env = gymnasium.make("ISDSuspension-v0", network=net)
    for name in ("passive", "lqg", "mpc"):
        controller = baselines.make(name, net)
        obs, _ = env.reset(seed=1)
        controller.reset()
        for _ in range(20):
            obs, reward, *_ = env.step(np.array([controller.act(obs)], np.float32))
            assert np.isfinite(reward)
