"""Typical forces at the places of a rig, and the size of a dissipative law by its work."""

import numpy as np
import pytest
from builders import damper, followed, network, recorded, spring

from isd_gym._common.arrays import rms
from isd_gym.diagnosis import Hypothesis
from isd_gym.diagnosis._estimation.gauss_newton import Fitter
from isd_gym.diagnosis._estimation.noise import white_weights
from isd_gym.diagnosis._estimation.structure import add, base_structure
from isd_gym.diagnosis._hypotheses.forces import (
    PlaceForces,
    lossy_share,
    place_forces,
)
from isd_gym.diagnosis._hypotheses.law_matching import simulate_unmodelled_effects
from isd_gym.diagnosis._simulation.problem import Problem, Record

STEP, BODY = 5e-3, 400.0


def dropped(tyre=3e5, wheel=100.0, **more):
    strut = [spring("body", "wheel", 4e4), damper("body", "wheel", 500.0)]
    parts, seen = [*strut, spring("wheel", "ground", tyre, "tyre")], ["body", "wheel"]
    outputs, masses = (
        [f"{n} displacement {n}" for n in seen],
        {"body": BODY, "wheel": wheel},
    )
    return network("dropped", parts, [], outputs, masses=masses, **more)


def forces_of(dropped, state, samples=600):
    """Typical forces of a free motion from `state`, and the motion (samples, outputs)."""
    problem = Problem(dropped, [recorded(dropped, STEP, {}, samples, state)], ["fit"])
    fit = followed(problem, 1e-6, 1e-6, initial={0: np.array(state)}, iterations=3)
    return place_forces(problem, fit), problem.records[0].measured


def test_the_force_of_a_free_pair_is_that_of_the_springs_and_does_not_follow_the_stiffest_one():
    fall = [0.02, 0.0, 0.0, 0.0]
    soft, motion = forces_of(dropped(3e5), fall)
    stiff, _ = forces_of(dropped(3e6), fall)
    force = 4e4 * rms(motion[:, 0] - motion[:, 1])
    assert soft.at(("body", "ground")) == pytest.approx(force, rel=0.1)
    # a tyre ten times as stiff carries the same load
    assert stiff.at(("body", "ground")) == pytest.approx(
        soft.at(("body", "ground")), rel=0.3
    )
    assert stiff.largest < 3 * soft.largest


def test_a_force_between_two_masses_is_compared_with_the_smaller_of_their_forces():
    forces = PlaceForces(
        {"body": 300.0, "wheel": 900.0, "base": 5.0}, frozenset({"ground", "base"})
    )
    assert forces.at(("body", "wheel")) == forces.at(("wheel", "body")) == 300.0
    assert forces.at(("wheel", "ground")) == forces.at(("base", "wheel")) == 900.0
    assert forces.at(("base", "ground")) == 5.0
    assert forces.at(("motor",)) == 900.0


def test_a_model_that_stands_still_takes_its_scale_from_the_measured_motion():
    swing = 0.01 * np.sin(2 * np.pi * 1.6 * STEP * np.arange(600))
    problem = Problem(
        dropped(),
        [Record("free", STEP, {}, np.stack([swing, 0.1 * swing], 1))],
        ["fit"],
    )
    fit = followed(problem, 1e-5, 1e-5, initial={0: np.zeros(4)}, iterations=0)
    inertia = BODY * rms(swing) * (2 * np.pi * 1.6) ** 2
    assert place_forces(problem, fit).at(("body", "ground")) == pytest.approx(
        inertia, rel=0.3
    )


STIFFNESS = 250e3  # [N/m]; the mass is 1 kg, so that a period takes 12.6 ms
LEVEL = 0.8  # [N] of friction, beside 250 N of elastic force at the beginning


def ring_down(damping, effect, values):
    """Return a ring-down from 1 mm with a law that the model lacks, simulated by that law."""
    parts = [
        spring("beam", "ground", STIFFNESS, "bending"),
        damper("beam", "ground", damping, "loss"),
    ]
    known = {"masses": {"beam": 1.0}, "uncertainty": {"loss.damping": 1.0}}
    beam = network("beam", parts, [], ["rate velocity beam"], **known)
    time = np.arange(0.0, 0.5, 2e-4)
    omega = np.sqrt(STIFFNESS)
    measured = -1e-3 * omega * np.exp(-0.5 * damping * time) * np.sin(omega * time)
    problem = Problem(beam, [Record("ring", 2e-4, {}, measured[:, None])])
    structure = add(
        base_structure(beam), Hypothesis(effect, ("beam", "ground")), values
    )
    fit = Fitter(problem, white_weights(np.array([0.01]))).follow(
        structure, structure.start, [0]
    )
    return problem, fit


def test_unmodelled_friction_is_small_beside_the_damping_where_damping_is_slight():
    """A share of the elastic force would be a multiple of the damping, and no interval of a fitted friction would exclude zero."""
    problem, fit = ring_down(2.0, "coulomb_friction", {"level": LEVEL})
    assert lossy_share(problem, fit) == pytest.approx(0.0056, rel=0.02)
    change = simulate_unmodelled_effects(problem, fit, 0.005)[0][:, 0]
    measured = problem.records[0].measured[:, 0]
    # the part in phase with the motion: what a law changes of the decay; elastic laws move the phase instead, after many periods
    decay = [abs(float(c @ measured)) / float(measured @ measured) for c in change.T]
    assert min(decay) < 0.002
