"""Where the fits of a stage begin."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

from isd_gym.diagnosis._estimation.structure import Hypothesis, add, base_structure
from isd_gym.diagnosis._hypotheses.library import hypotheses
from isd_gym.diagnosis._hypotheses.score_test import ScoredStart
from isd_gym.diagnosis._selection.screening import Screening, amplified, starts
from isd_gym.physics.elements import Start
from isd_gym.physics.network import Network


def screened(effect: str, values: dict[str, float], **start: Any) -> tuple[Screening, ScoredStart]:
    structure = base_structure(Network.load("quarter-car-isd"))
    stage = cast(
        "Screening", SimpleNamespace(current=SimpleNamespace(structure=structure, x=structure.start))
    )
    h = next(h for h in hypotheses(structure.network) if h.effect == effect)
    return stage, ScoredStart(h, Start(values, **start), values, 1.0)


def test_a_start_that_no_law_can_have_is_left_out() -> None:
    """The score test may ask for a force without end; a case of it ended a whole diagnosis."""
    stage, much = screened("cogging_force", {"amplitude": 1e12, "pitch": 0.01, "phase": 0.0})
    assert starts(stage, [much]) == []
    stage, little = screened("cogging_force", {"amplitude": 10.0, "pitch": 0.01, "phase": 0.0})
    assert len(starts(stage, [little])) == 1


def test_a_start_grows_in_what_scales_it() -> None:
    stage, s = screened("coulomb_friction", {"level": 100.0}, grows=("level",))
    levels = [t.network.element(t.names[-1]).level for t in amplified(stage, s, (0.5, 5.0, 1e9))]
    assert levels == [50.0, 500.0]


def test_a_second_stop_is_a_hypothesis_where_the_first_is_known_for_sure() -> None:
    """It may be met before the first; a stop whose clearance the owner is not sure of is refitted instead. Found, it is not put there again."""
    car = Network.load("quarter-car-isd")

    def stops(network: Network) -> list[Hypothesis]:
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
