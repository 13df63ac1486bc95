"""Typical forces at the places of a rig."""

import builders
import numpy as np
import pytest
from builders import channel, damper

from isd_gym._common.arrays import rms
from isd_gym.diagnosis._estimation.gauss_newton import Fitter
from isd_gym.diagnosis._estimation.noise import white_filters
from isd_gym.diagnosis._estimation.structure import base_structure
from isd_gym.diagnosis._hypotheses.forces import PlaceForces, place_forces
from isd_gym.diagnosis._simulation.problem import Problem, Record

STEP, BODY = 5e-3, 400.0


def dropped(tyre=3e5, wheel=100.0, **more):
    return builders.network(
        "dropped",
        [
            builders.spring("body", "wheel", 4e4),
            damper("body", "wheel", 500.0),
            builders.spring("wheel", "ground", tyre, "tyre"),
        ],
        [],
        [channel("body", "displacement", "body"), channel("wheel", "displacement", "wheel")],
        masses={"body": BODY, "wheel": wheel},
        **more,
    )


def forces_of(network, state, samples=600):
    """Typical forces of a free motion from `state`, and the motion (samples, outputs)."""
    blank = Record("free", STEP, {}, np.zeros((samples, len(network.outputs))))
    seen = Problem(network, [blank], ["fit"]).simulate([network], 0, np.array(state)[:, None], like=network)[
        :, :, 0
    ]
    problem = Problem(network, [Record("free", STEP, {}, seen)], ["fit"])
    structure = base_structure(network)
    fit = Fitter(problem, white_filters(np.full(len(network.outputs), 1e-6))).fit(
        structure, structure.start, {0: np.array(state)}, frozen=True, iterations=3
    )
    return place_forces(problem, fit), seen


def test_the_force_of_a_free_pair_is_that_of_the_springs_and_does_not_follow_the_stiffest_one():
    fall = [0.02, 0.0, 0.0, 0.0]
    soft, motion = forces_of(dropped(3e5), fall)
    stiff, _ = forces_of(dropped(3e6), fall)
    spring = 4e4 * rms(motion[:, 0] - motion[:, 1])
    assert soft.at(("body", "ground")) == pytest.approx(spring, rel=0.1)
    # a tyre ten times as stiff carries the same load
    assert stiff.at(("body", "ground")) == pytest.approx(soft.at(("body", "ground")), rel=0.3)
    assert stiff.largest < 3 * soft.largest


def test_a_force_between_two_masses_is_compared_with_the_smaller_of_their_forces():
    forces = PlaceForces({"body": 300.0, "wheel": 900.0, "base": 5.0}, frozenset({"ground", "base"}))
    assert forces.at(("body", "wheel")) == forces.at(("wheel", "body")) == 300.0
    assert forces.at(("wheel", "ground")) == forces.at(("base", "wheel")) == 900.0
    assert forces.at(("base", "ground")) == 5.0
    assert forces.at(("motor",)) == 900.0


def test_an_input_force_counts_at_its_node():
    network = builders.network(
        "cart",
        [damper("cart", "ground", 0.1, "drag")],
        [channel("push", "force", "cart")],
        [channel("speed", "velocity", "cart")],
        masses={"cart": 2.0},
    )
    push = 10.0 * np.sin(2 * np.pi * 1.5 * STEP * np.arange(800))
    blank = Record("run", STEP, {"push": push}, np.zeros((800, 1)))
    seen = Problem(network, [blank], ["fit"]).simulate([network], 0)[:, :, 0]
    problem = Problem(network, [Record("run", STEP, {"push": push}, seen)], ["fit"])
    structure = base_structure(network)
    fit = Fitter(problem, white_filters(np.array([1e-6]))).fit(structure, frozen=True, iterations=3)
    assert place_forces(problem, fit).at(("cart", "ground")) == pytest.approx(rms(push), rel=0.05)


def test_a_model_that_stands_still_takes_its_scale_from_the_measured_motion():
    network = dropped()
    swing = 0.01 * np.sin(2 * np.pi * 1.6 * STEP * np.arange(600))
    problem = Problem(network, [Record("free", STEP, {}, np.stack([swing, 0.1 * swing], 1))], ["fit"])
    structure = base_structure(network)
    fit = Fitter(problem, white_filters(np.full(2, 1e-5))).fit(
        structure, structure.start, {0: np.zeros(4)}, frozen=True, iterations=0
    )
    inertia = BODY * rms(swing) * (2 * np.pi * 1.6) ** 2
    assert place_forces(problem, fit).at(("body", "ground")) == pytest.approx(inertia, rel=0.3)
