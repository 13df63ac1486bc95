"""Nodes that are moved by their velocity or acceleration: against the closed solution, and what they cannot tell."""

import copy

import numpy as np
import pytest

from isd_gym import simulate
from isd_gym.discrepancy.hypotheses import pairs
from isd_gym.errors import InputError
from isd_gym.network import Network, linearise

M, C, K, W, A = 2.0, 3.0, 200.0, 7.0, 0.98
TABLE = {
    "schema": "isd-model/1",
    "name": "table",
    "masses": {"m": M},
    "elements": [
        {"name": "k", "type": "linear_stiffness", "between": ["m", "table"], "stiffness": K},
        {"name": "c", "type": "linear_damping", "between": ["m", "table"], "damping": C},
    ],
    "inputs": [{"name": "u", "quantity": "acceleration", "at": "table", "unit": "m/s^2"}],
    "outputs": [
        {"name": "a", "quantity": "acceleration", "at": "m", "unit": "m/s^2"},
        {"name": "d", "quantity": "displacement", "between": ["m", "table"], "unit": "m"},
        {"name": "F", "quantity": "force", "at": "table", "unit": "N"},
    ],
}
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
def test_a_table_that_is_told_by_its_rate_moves_the_mass_as_the_closed_solution_does(quantity):
    errors = []
    for h in (0.01, 0.005, 0.0025):
        t = np.arange(0, 3, h)
        out = simulate(shaken(quantity), t, {"u": MOVES[quantity][1](t)}, step=h)
        d, a = solution(t)
        errors.append(
            [np.abs(out["d"] - d).max() / np.abs(d).max(), np.abs(out["a"] - a).max() / np.abs(a).max()]
        )
        assert np.allclose(out["F"], M * out["a"], rtol=1e-9, atol=1e-9)  # nothing else is there to push
    errors = np.array(errors)
    assert np.all(errors[0] < 1e-3)
    assert np.all(np.log2(errors[:-1] / errors[1:]) > 1.95)  # second order: lines between samples


def test_the_three_inputs_of_one_motion_agree_and_a_velocity_tells_absolute_velocities():
    t = np.arange(0, 3, 1e-3)
    speed = {"outputs": [{"name": "v", "quantity": "velocity", "at": "m", "unit": "m/s"}]}
    by = {
        q: simulate(shaken(q, **(speed if q != "acceleration" else {})), t, {"u": MOVES[q][1](t)})
        for q in MOVES
    }
    for name in ("a", "d", "F"):
        for q in ("acceleration", "velocity"):
            assert np.allclose(by[q][name], by["displacement"][name], atol=2e-4 * np.abs(by[q][name]).max())
    assert np.allclose(by["velocity"]["v"], by["displacement"]["v"], atol=1e-6)


def test_a_velocity_may_rub_on_the_ground_and_friction_does_there_as_with_the_displacement():
    t = np.arange(0, 2, 1e-3)
    rub = {"elements": [{"name": "r", "type": "coulomb_friction", "between": ["m", "ground"], "level": 0.5}]}
    by = {q: simulate(shaken(q, **rub), t, {"u": MOVES[q][1](t)}) for q in ("velocity", "displacement")}
    assert np.allclose(by["velocity"]["a"], by["displacement"]["a"], atol=5e-3)


def test_the_names_of_a_state_space_say_what_was_measured():
    space = linearise(shaken("acceleration"))
    assert space.inputs == ("u",)
    assert np.allclose(
        space.response(np.array([1e-3]))[0, 0], 1.0, atol=1e-3
    )  # slowly, the mass goes with the table
    assert linearise(shaken("velocity")).inputs[0] == "u"


GROUND_SPRING = {"name": "s", "type": "linear_stiffness", "between": ["m", "ground"], "stiffness": 1.0}
GROUND_RUB = {"name": "s", "type": "coulomb_friction", "between": ["m", "ground"], "level": 1.0}
AT_M = {"name": "x", "quantity": "displacement", "at": "m", "unit": "m"}
SPEED = {"name": "x", "quantity": "velocity", "at": "m", "unit": "m/s"}
SECOND = {"name": "u2", "quantity": "acceleration", "at": "m", "unit": "m/s^2"}


@pytest.mark.parametrize(
    ("quantity", "more", "words"),
    [
        ("acceleration", {"elements": [GROUND_SPRING]}, "'s' ties 'm' to 'ground', and needs the displacement of 'table'"),
        ("velocity", {"elements": [GROUND_SPRING]}, "needs the displacement of 'table', which its velocity does not tell"),
        ("acceleration", {"elements": [GROUND_RUB]}, "needs the velocity of 'table'"),
        ("acceleration", {"outputs": [AT_M]}, "the displacement of 'm' against the ground is not told by input 'u'"),
        ("acceleration", {"outputs": [SPEED]}, "the velocity of 'm' against the ground"),
        ("acceleration", {"inputs": [SECOND]}, "says nothing of its distance from 'm', which 'u2' moves"),
    ],
)  # fmt: skip
def test_what_is_missing_is_said_in_a_line(quantity, more, words):
    t = np.arange(0, 1, 0.01)
    with pytest.raises(InputError, match=words.replace("'", ".")) as caught:
        simulate(shaken(quantity, **more), t, {"u": t, "u2": t})
    assert "\n" not in str(caught.value)


def test_a_distance_cannot_be_an_input():
    with pytest.raises(InputError, match=r"needs .at.: a node"):
        Network.load(
            {
                **TABLE,
                "inputs": [{"name": "u", "quantity": "acceleration", "between": ["m", "table"], "unit": "g"}],
            }
        )


def test_no_effect_is_looked_for_at_a_ground_whose_distance_nobody_knows():
    assert pairs(Network.load(shaken("acceleration"))) == [("m", "table")]
    assert ("m", "ground") in pairs(Network.load(shaken("displacement")))
