"""Where the fits of a stage begin."""

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import pytest

from isd_gym._common.errors import InputError
from isd_gym.diagnosis._estimation.structure import add, base_structure
from isd_gym.diagnosis._hypotheses.law_matching import Match
from isd_gym.diagnosis._hypotheses.library import hypotheses
from isd_gym.diagnosis._selection.screening import Screening
from isd_gym.physics.elements import Start
from isd_gym.physics.network import Network


def matched(effect, values, **start):
    structure = base_structure(Network.load("quarter-car-isd"))
    h = next(h for h in hypotheses(structure.network) if h.effect == effect)
    return structure, Match(h, Start(values, **start), values, {}, 1.0)


def test_values_that_no_law_can_have_are_refused():
    """A match may ask for a force without end; a case of it ended a whole diagnosis."""
    structure, much = matched("cogging_force", {"amplitude": 1e12, "pitch": 0.01, "phase": 0.0})
    with pytest.raises(InputError):
        much.begin(structure)
    structure, little = matched("cogging_force", {"amplitude": 10.0, "pitch": 0.01, "phase": 0.0})
    built, x = little.begin(structure)
    assert len(x) == len(built.free)


def test_a_match_of_another_size():
    structure, m = matched("coulomb_friction", {"level": 100.0}, grows=("level",))
    built, _ = m.sized(5.0).begin(structure)
    assert built.network.element(built.names[-1]).level == 500.0


def test_a_second_stop_is_a_hypothesis_where_the_first_is_known_for_sure():
    """It may be met before the first; a stop whose clearance the owner is not sure of is refitted instead. Found, it is not put there again."""
    car = Network.load("quarter-car-isd")

    def stops(network):
        found = [h for h in hypotheses(network) if h.effect == "bump_stop"]
        return [h for h in found if set(h.where) == {"piston", "joint"}]

    assert car.element("end_stop").type == "bump_stop" and "end_stop.clearance" not in car.uncertainty
    assert [dict(h.options)["side"] for h in stops(car)] == ["both", "extension", "compression"]
    assert not stops(replace(car, uncertainty={**car.uncertainty, "end_stop.clearance": 0.1}))
    found = add(base_structure(car), stops(car)[0], {"clearance": 0.01, "stiffness": 2e5})
    stage = cast(
        "Screening",
        SimpleNamespace(current=SimpleNamespace(structure=found), problem=SimpleNamespace(network=car)),
    )
    assert not any(Screening.is_sensible(stage, h) for h in stops(found.network))
    # two springs are one spring
    assert not any(h.effect == "linear_stiffness" and h.where == ("body", "wheel") for h in hypotheses(car))
