"""The size of a dissipative law where damping is slight: its share of the dissipated work, not of the force."""

import builders
import numpy as np
import pytest
from builders import channel

from isd_gym.diagnosis._estimation.gauss_newton import Fitter
from isd_gym.diagnosis._estimation.noise import white_filters
from isd_gym.diagnosis._estimation.structure import Hypothesis, rebuilt
from isd_gym.diagnosis._hypotheses.forces import dissipated_work, lossy_share
from isd_gym.diagnosis._hypotheses.unmodelled_effects import simulate_unmodelled_effects
from isd_gym.diagnosis._selection.held_out import effect_size
from isd_gym.diagnosis._simulation.problem import Problem, Record
from isd_gym.physics import elements as el

STIFFNESS = 250e3  # [N/m]; the mass is 1 kg, so that a period takes 12.6 ms
LEVEL = 0.8  # [N] of friction, beside 250 N of elastic force at the beginning


def ring_down(damping, effect, values):
    """Return a ring-down from 1 mm with a law that the model lacks, simulated by that law."""
    between = ["beam", "ground"]
    spring = builders.spring(*between, stiffness=STIFFNESS, name="bending")
    damper = builders.damper(*between, damping=damping, name="loss")
    network = builders.network(
        "beam",
        [spring, damper],
        [],
        [channel("rate", "velocity", "beam")],
        masses={"beam": 1.0},
        uncertainty={"loss.damping": 1.0},
    )
    time = np.arange(0.0, 0.5, 2e-4)
    omega = np.sqrt(STIFFNESS)
    measured = -1e-3 * omega * np.exp(-0.5 * damping * time) * np.sin(omega * time)
    problem = Problem(network, [Record("ring", 2e-4, {}, measured[:, None])])
    structure = rebuilt(network, [(Hypothesis(effect, ("beam", "ground")), values)])
    fit = Fitter(problem, white_filters(np.array([0.01]))).follow(structure, structure.start, [0])
    return problem, fit


def test_friction_in_a_lightly_damped_structure_has_its_share_of_the_dissipated_work():
    problem, fit = ring_down(2.0, "coulomb_friction", {"level": LEVEL})
    rate = fit.outputs[0][:, 0]
    powers = LEVEL * np.mean(np.abs(rate)), 2.0 * np.mean(rate**2)
    (name,) = fit.structure.names
    assert LEVEL / (0.5 * STIFFNESS * 1e-3) < 0.01
    assert effect_size(problem, fit, name) == pytest.approx(powers[0] / sum(powers), rel=0.02)


@pytest.mark.parametrize(
    ("damping", "effect", "values"),
    [
        (100.0, "coulomb_friction", {"level": LEVEL}),
        (2.0, "cubic_stiffness", {"stiffness": 5e-3 * STIFFNESS / 1e-6}),
    ],
    ids=["well damped", "elastic"],
)
def test_the_share_of_the_force_counts_where_damping_is_strong_and_for_elastic_laws(damping, effect, values):
    problem, fit = ring_down(damping, effect, values)
    (name,) = fit.structure.names
    assert effect_size(problem, fit, name) < 0.05


def test_the_elastic_part_of_a_force_does_no_work():
    phase = np.linspace(0.0, 6.0 * np.pi, 3001)
    motion = el.Motion(0.2 * np.sin(phase), 0.2 * np.cos(phase), -0.2 * np.sin(phase))
    force = 30.0 * motion.d + 5.0 * motion.d**3 + 2.0 * np.sign(motion.v) + 7.0
    assert dissipated_work(force, motion) == pytest.approx(2.0 * 0.2 * 2.0 / np.pi, rel=1e-3)


def test_unmodelled_friction_is_small_beside_the_damping_where_damping_is_slight():
    """A share of the elastic force would be a multiple of the damping, and no interval of a fitted friction would exclude zero."""
    problem, fit = ring_down(2.0, "coulomb_friction", {"level": LEVEL})
    assert lossy_share(problem, fit) == pytest.approx(0.0056, rel=0.02)
    change = simulate_unmodelled_effects(problem, fit, 0.005)[0][:, 0]
    measured = problem.records[0].measured[:, 0]
    # the part in phase with the motion: what a law changes of the decay; elastic laws move the phase instead, after many periods
    decay = [abs(float(c @ measured)) / float(measured @ measured) for c in change.T]
    assert min(decay) < 0.002
