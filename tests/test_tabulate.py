"""The law that no list has: tables with a smooth prior, and the verdict that shows one."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from builders import oscillator

from isd_gym.diagnosis._selection.free_force import Table as TableStructure
from isd_gym.diagnosis._selection.free_force import _axis, _directions
from isd_gym.diagnosis._selection.weights import _statement_of_table
from isd_gym.physics.elements import TabulatedForce

SHAKEN = oscillator(
    "travel displacement mass base", "felt acceleration mass", base="base"
)


def test_the_prior_of_a_table_is_zero_at_rest_smooth_and_as_large_as_it_was_said():
    x = _axis(np.linspace(-1.0, 3.0, 1000))
    assert len(x) == 33 and 0.0 in x and np.all(np.diff(x) > 0)
    basis = _directions(x, 10.0)
    assert np.allclose(basis[x == 0.0], 0.0, atol=1e-9)
    spread = np.sqrt(np.sum(basis**2, axis=1))
    assert (
        9.0 < spread[np.argmax(np.abs(x))] < 10.1
    )  # far from rest nothing is known of it
    rough = np.abs(np.diff(basis, 2, axis=0)).max()
    assert rough < 2.0


@pytest.mark.parametrize(
    ("over", "kind"), [("elongation", "elastic"), ("rate", "other")]
)
def test_a_table_of_the_distance_alone_is_elastic(over, kind):
    force = TabulatedForce(
        "missing", ("mass", "base"), force=(-1.0, 0.0, 1.0), elongation=(-1.0, 0.0, 1.0)
    )
    network = replace(SHAKEN, elements=(*SHAKEN.elements, force))
    structure = TableStructure(network, (), element="missing", over=over)
    told = _statement_of_table(SimpleNamespace(structure=structure))
    assert (told.place, told.kind) == (("base", "mass"), kind)
