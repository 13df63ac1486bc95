"""Nodes that are moved by their velocity or acceleration, or cut where their motion was measured."""

import copy

import builders
import numpy as np
import pytest
from builders import channel, damper, friction, spring
from program import refused

from isd_gym import Network, simulate
from isd_gym.diagnosis import hypotheses
from isd_gym.diagnosis._hypotheses.library import pairs
from isd_gym.physics.network import cut, rejoin

M, C, K, W, A = 2.0, 3.0, 200.0, 7.0, 0.98
STRUT = [spring("m", "table", K, "k"), damper("m", "table", C, "c")]
SEEN = ["a acceleration m", "d displacement m table", "F force table"]
TABLE = builders.model("table", STRUT, ["u acceleration table"], SEEN, masses={"m": M})
MOVES = {  # of the table, from rest: acceleration A sin(W t) and its integrals
    "acceleration": ("m/s^2", lambda t: A * np.sin(W * t)),
    "velocity": ("m/s", lambda t: A / W * (1 - np.cos(W * t))),
    "displacement": ("m", lambda t: A / W * (t - np.sin(W * t) / W)),
}


def shaken(quantity, **more):
    model = copy.deepcopy(TABLE)
    model["inputs"][0].update(quantity=quantity, unit=MOVES[quantity][0])
    for key, extra in more.items():
        model[key] += extra
    return model


def solution(t):
    """Travel from the table and absolute acceleration of a mass on a table shaken from rest: particular and free part."""
    z = -M * A / (K - M * W * W + 1j * C * W)
    s = np.roots([M, C, K])
    c = np.linalg.solve([[1, 1], s], [-z.imag, -(1j * W * z).imag])
    free = c[:, None] * np.exp(np.outer(s, t))
    d = (z * np.exp(1j * W * t)).imag + free.sum(axis=0).real
    v = (1j * W * z * np.exp(1j * W * t)).imag + (s[:, None] * free).sum(axis=0).real
    return d, -(K * d + C * v) / M


@pytest.mark.parametrize("quantity", ["acceleration", "velocity"])
def test_a_table_that_is_told_by_its_rate_moves_the_mass_as_the_closed_solution_does(
    quantity,
):
    errors = []
    for h in (0.01, 0.005, 0.0025):
        t = np.arange(0, 3, h)
        out = simulate(shaken(quantity), t, {"u": MOVES[quantity][1](t)}, step=h)
        d, a = solution(t)
        errors.append(
            [
                np.abs(out[k] - y).max() / np.abs(y).max()
                for k, y in (("d", d), ("a", a))
            ]
        )
        assert np.allclose(
            out["F"], M * out["a"], rtol=1e-9, atol=1e-9
        )  # nothing else is there to push
    errors = np.array(errors)
    assert np.all(errors[0] < 1e-3)
    assert np.all(
        np.log2(errors[:-1] / errors[1:]) > 1.95
    )  # second order: lines between samples


GROUND_SPRING = spring("m", "ground", 1.0, "s")
GROUND_RUB = friction("m", "ground", 1.0, "s")
SPEED = channel("x", "velocity", "m")
SECOND = channel("u2", "acceleration", "m")


@pytest.mark.parametrize(
    ("quantity", "more", "words"),
    [
        ("acceleration", {"elements": [GROUND_SPRING]}, "'s' ties 'm' to 'ground', and needs the displacement of 'table'"),
        ("velocity", {"elements": [GROUND_SPRING]}, "needs the displacement of 'table', which its velocity does not tell"),
        ("acceleration", {"elements": [GROUND_RUB]}, "needs the velocity of 'table'"),
        ("acceleration", {"outputs": [SPEED]}, "the velocity of 'm' against the ground"),
        ("acceleration", {"inputs": [SECOND]}, "says nothing of its distance from 'm', which 'u2' moves"),
    ],
)  # fmt: skip
def test_what_is_missing_is_said_in_a_line(quantity, more, words):
    t = np.arange(0, 1, 0.01)
    refused(
        words.replace("'", "."),
        simulate,
        shaken(quantity, **more),
        t,
        {"u": t, "u2": t},
    )


def test_a_distance_cannot_be_an_input():
    refused(
        r"needs .at.: a node",
        Network.load,
        {**TABLE, "inputs": [channel("u", "acceleration", "m", "table", unit="g")]},
    )


def test_effects_at_the_ground_need_no_more_than_the_input_tells():
    """A speed tells what rubs on the ground, but no travel from it; an acceleration tells neither."""
    at_ground = {}
    for quantity in MOVES:
        network = Network.load(shaken(quantity))
        at_ground[quantity] = {
            h.kind.plane for h in hypotheses(network) if set(h.where) == {"m", "ground"}
        }
        assert ("m", "table") in pairs(network)
    everything = {"rate", "elongation", "time"}
    velocity = everything - {"elongation"}
    assert at_ground == {
        "acceleration": set(),
        "velocity": velocity,
        "displacement": everything,
    }


def car():
    data = Network.load("quarter-car-isd").to_dict()
    data["outputs"].append(channel("wheel_acceleration", "acceleration", "wheel"))
    paths = ("body.mass", "wheel.mass", "tyre.stiffness", "damper.damping")
    data["uncertainty"] = dict.fromkeys(paths, 0.05)
    return Network.load(data)


def driven():
    t = np.arange(0, 4, 1e-3)
    road = 0.008 * np.sin(9 * t) ** 3 + 0.003 * np.sin(41 * t) ** 2
    return t, {"road": road, "current": 2.0 * np.sign(np.sin(5 * t))}


def test_what_is_above_the_cut_moves_as_in_the_whole_car():
    t, inputs = driven()
    whole = simulate(car(), t, inputs)
    part = cut(car(), "wheel")
    assert part.moved_nodes == ("wheel",) and "tyre" not in {
        e.name for e in part.elements
    }
    assert [c.name for c in part.inputs] == ["wheel_acceleration", "current"]
    assert set(part.uncertainty) == {"body.mass", "damper.damping"}
    out = simulate(
        part,
        t,
        {
            "wheel_acceleration": whole["wheel_acceleration"],
            "current": inputs["current"],
        },
    )
    assert set(out) == {"body_acceleration", "suspension_travel", "device_travel"}
    for name, y in out.items():
        assert np.std(y - whole[name]) < 0.01 * np.std(whole[name])


def test_a_displacement_is_taken_before_an_acceleration():
    data = car().to_dict()
    data["outputs"].append(channel("hub", "displacement", "wheel", unit="mm"))
    part = cut(Network.load(data), "wheel")
    assert part.inputs[0].name == "hub" and part.inputs[0].unit == "mm"
    assert "wheel_acceleration" not in {
        c.name for c in part.outputs
    }  # the input tells it


def test_what_was_found_in_a_part_comes_back_into_the_whole():
    part = cut(car(), "wheel").with_parameters({"damper.damping": 1400.0})
    part = part.with_element(friction("body", "wheel", 80.0))
    whole = rejoin(car(), part)
    assert (
        whole.parameters["damper.damping"] == 1400.0
        and whole.parameters["rub.level"] == 80.0
    )
    assert whole.parameters["tyre.stiffness"] == car().parameters["tyre.stiffness"]
    assert whole.inputs == car().inputs and whole.uncertainty == car().uncertainty
    assert rejoin(car(), cut(car(), "wheel")).parameters == car().parameters


@pytest.mark.parametrize(
    ("node", "words"),
    [
        ("roof", "no node 'roof'"),
        ("road", "moved by an input already"),
        ("piston", "no output measures the motion of 'piston'"),
        ("body", "the other nodes are all connected without 'body'"),
    ],
)
def test_a_cut_that_makes_no_sense_is_said_in_a_line(node, words):
    refused(words, cut, car(), node)
