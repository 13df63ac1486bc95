"""An effect is tried at places that move as its own place does, so that a local optimum at one of them decides nothing."""

from types import SimpleNamespace

import numpy as np
from builders import channel, network, spring

from isd_gym.diagnosis._estimation.structure import Hypothesis
from isd_gym.diagnosis._selection.equivalent_laws import _places_alike
from isd_gym.physics.elements import Motion

SHAFT = network(
    "shaft",
    [spring("rim", "hub", 6e6)],
    [channel("push", "force", "hub")],
    [channel("speed", "velocity", "rim")],
    masses={"hub": 340.0, "rim": 20.0},
)
TIME = np.linspace(0.0, 10.0, 2000)
SPEED = 20.0 * np.exp(-0.2 * TIME)


def moving(ripple):
    """Motion of hub and rim, which run down together beside a torsional vibration of the rim."""
    swing = ripple * np.sin(40.0 * TIME)
    travel = np.cumsum(SPEED) * (TIME[1] - TIME[0])
    still = np.zeros_like(TIME)
    hub, rim = Motion(travel, SPEED, still), Motion(travel + swing / 40.0, SPEED + swing, still)
    return {
        ("hub", "ground"): hub,
        ("rim", "ground"): rim,
        ("rim", "hub"): Motion(swing / 40.0, swing, still),
    }


def test_drag_at_one_end_of_a_stiff_shaft_is_tried_at_the_other_end_too():
    problem = SimpleNamespace(network=SHAFT)
    drag = Hypothesis("quadratic_damping", ("rim", "ground"))
    (other,) = _places_alike(problem, drag, moving(ripple=3.0))
    assert other.effect == "quadratic_damping" and other.where == ("hub", "ground")
    assert _places_alike(problem, drag, moving(ripple=30.0)) == []  # the ends move apart
    assert _places_alike(problem, Hypothesis("quadratic_damping", ("rim", "hub")), moving(ripple=3.0)) == []
