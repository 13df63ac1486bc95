"""Intervals of fitted parameters of either sign."""

from types import SimpleNamespace

import numpy as np
import pytest
from rigs import pushed_mass

from isd_gym.diagnosis.estimation.structure import Hypothesis, add, base_structure
from isd_gym.diagnosis.selection.uncertainty import intervals


@pytest.mark.parametrize("stiffness", [2.5e6, -2.5e6, -2.5])
def test_an_interval_is_about_its_value_for_either_sign(stiffness):
    """A softening spring has a negative cubic stiffness: mean -/+ 1.96 deviations, however large the value."""
    rig = pushed_mass("rig", [{"name": "travel", "quantity": "displacement", "at": "mass", "unit": "m"}])
    structure = add(
        base_structure(rig), Hypothesis("cubic_stiffness", ("mass", "ground")), {"stiffness": stiffness}
    )
    free, x = structure.free, structure.start
    assert [f.log for f in free] == [False]
    deviation = 0.01 * abs(stiffness)
    evaluator = SimpleNamespace(problem=SimpleNamespace(network=rig))
    candidate = SimpleNamespace(fit=SimpleNamespace(structure=structure, x=x, network=structure.network))
    (found,) = intervals(evaluator, candidate, np.array([[deviation**2]])).values()
    assert found.value == pytest.approx(stiffness)
    assert found.low == pytest.approx(stiffness - 1.96 * deviation)
    assert found.high == pytest.approx(stiffness + 1.96 * deviation)
