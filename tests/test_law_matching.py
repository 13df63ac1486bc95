"""Laws that are matched to the residual of a fit, along the measured motion."""

import numpy as np
import pytest
from builders import fitted, oscillator, sines

from isd_gym import simulate
from isd_gym.diagnosis import Hypothesis
from isd_gym.diagnosis._simulation.problem import Problem, Record
from isd_gym.physics import elements as el
from isd_gym.view.report.steps import law_force

STEP, NOISE, PLACE = 2e-3, 2e-6, ("mass", "base")


def rig():
    known = {"spring.stiffness": 0.1, "damper.damping": 0.3}
    parts = {"mass": 2.0, "stiffness": 4000.0, "damping": 12.0}
    return oscillator("mass displacement mass", base="base", uncertainty=known, **parts)


def stage(effect="", place=PLACE, **values):
    """Return a record of the rig with a law, and the refitted rig without the law."""
    network, rng = rig(), np.random.default_rng(7)
    t = np.arange(3000) * STEP
    f = np.array([2, 5, 9])
    base = sines(t, f, rng.uniform(0, 6, 3), 0.004 / f)
    true = (
        network.with_element(el.TYPES[effect]("true", place, **values))
        if effect
        else network
    )
    seen = simulate(true, t, {"base": base}, interpolation="auto")["mass"]
    record = Record(
        "run", STEP, {"base": base}, (seen + rng.normal(0, NOISE, len(t)))[:, None]
    )
    problem = Problem(network, [record])
    return problem, fitted(problem, NOISE)


def test_a_law_acts_along_a_motion_in_either_order_of_its_nodes():
    d = np.linspace(-0.03, 0.05, 999)
    motion = el.Motion(d, 0 * d, 0 * d)
    values = {"amplitude": 10.0, "pitch": 0.02, "phase": 0.5}
    for place, sign in ((PLACE, 1.0), (PLACE[::-1], -1.0)):
        force = law_force(Hypothesis("cogging_force", place), values, PLACE, motion)
        wanted = sign * 10 * np.sin(2 * np.pi * sign * d / 0.02 + 0.5)
        assert force == pytest.approx(wanted, abs=0.01)
    inertance = Hypothesis("inertance", PLACE)
    assert law_force(inertance, {"inertance": 1.0}, PLACE, motion) is None
