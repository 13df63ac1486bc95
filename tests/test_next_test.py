"""The test that decides between candidates: within the limits of the rig, and better than the usual one."""

from types import SimpleNamespace

import builders
import numpy as np
import pytest
from builders import channel, damper, spring

from isd_gym import Network
from isd_gym.diagnosis import Hypothesis
from isd_gym.diagnosis._estimation.structure import add, base_structure
from isd_gym.diagnosis._planning.design import design_test
from isd_gym.diagnosis._planning.excitation import (
    SHAPES,
    Excitation,
    Rig,
    infer_rig,
    list_excitations,
    make_record,
)

MASS = Network.load(
    builders.model(
        "shaken-mass",
        [spring("table", "shaker", 9000.0), damper("table", "shaker", 45.0)],
        [channel("stroke", "displacement", "shaker", unit="mm")],
        [channel("acceleration", "acceleration", "table")],
        masses={"table": 12.0},
        uncertainty={
            "table.mass": 0.03,
            "spring.stiffness": 0.1,
            "damper.damping": 0.2,
        },
    )
)
SHORT = Rig({"stroke": (0.01, np.inf)}, (1.0, 7.0), 8.0, 0.008)


@pytest.mark.parametrize("kind", SHAPES)
def test_an_excitation_keeps_within_the_rigs_limits(kind):
    network = Network.load("quarter-car-isd")
    limits = {"road": (0.02, 0.3), "current": (4.0, np.inf)}
    rig = Rig(limits, (0.5, 15.0), 10.0, 2e-3)
    test = Excitation(kind, rig.band, ("road", "current"))
    played = make_record(network, rig, test).inputs
    road, current = played["road"], played["current"]
    assert np.abs(road).max() <= 0.02 * (1 + 1e-9)
    assert np.abs(np.diff(road)).max() / rig.step <= 0.3 * (1 + 1e-9)
    assert np.abs(current).max() == pytest.approx(4.0)
    assert road[0] == road[-1] == 0.0
    power = np.abs(np.fft.rfft(np.gradient(road, rig.step))) ** 2
    f = np.fft.rfftfreq(len(road), rig.step)
    assert power[(f > 0.2) & (f < 40)].sum() > 0.97 * power.sum()


def test_limits_come_from_the_records():
    sweep = Excitation("sweep", (1.0, 5.0), ("stroke",), 0.5)
    record = make_record(MASS, SHORT, sweep)
    rig = infer_rig(MASS, [record])
    largest = np.abs(record.inputs["stroke"]).max()
    assert rig.limits["stroke"][0] == pytest.approx(largest)
    assert rig.length == pytest.approx(8.0, rel=0.01)
    assert 0.5 < rig.band[0] < 1.5
    assert 3.0 < rig.band[1] < 7.0
    assert {e.kind for e in list_excitations(rig)} == set(SHAPES)


def rival(effect, **values):
    law = Hypothesis(effect, ("table", "ground"))
    structure = add(base_structure(MASS), law, values)
    return SimpleNamespace(label=effect, structure=structure, x=structure.start)


def test_a_designed_test_separates_rivals_better_than_the_usual_one():
    left = [rival("coulomb_friction", level=3.0), rival("linear_damping", damping=14.0)]
    usual = Excitation("multisine", SHORT.band, ("stroke",))
    tests = [
        usual,
        Excitation("steps", SHORT.band, ("stroke",), 0.4),
        Excitation("sweep", SHORT.band, ("stroke",), 0.3),
    ]
    noise = np.array([0.05])

    def distance(tests, noise=noise):
        return design_test(MASS, left, SHORT, noise, tests).distance

    found = design_test(MASS, left, SHORT, noise, tests)
    assert found.distance >= distance([usual]) > 0
    assert set(found.closest) == {"coulomb_friction", "linear_damping"}
    assert np.abs(found.record.inputs["stroke"]).max() <= 0.01 + 1e-12
    assert distance(tests, 10 * noise) < found.distance
    assert found.table(MASS).columns.keys() == {"stroke [mm]"}
