"""Bounds stand beside a score only where their conditions hold."""

import numpy as np
import pytest

from isd_gym import Network, score
from isd_gym.benchmark import ceilings as beside
from isd_gym.benchmark.comparability import Comparable, comparable
from isd_gym.benchmark.policies import find, passive
from isd_gym.benchmark.scoring import Conditions
from isd_gym.view.report import score as page

CAR = Network.load("quarter-car-isd")


@pytest.mark.parametrize(
    ("change", "left_out"),
    [
        ({}, set()),
        ({"network": Network.load("quarter-car-eq8")}, set()),
        ({"road": "C"}, set()),
        ({"road": "bump"}, {"lq_bound", "ceiling"}),
        ({"road": "paper+bump"}, {"lq_bound", "ceiling"}),
        ({"episodes": 31}, {"lq_bound", "ceiling"}),
        ({"duration": 19.0}, {"lq_bound", "ceiling"}),
        (
            {"reference": "isd-passive"},
            {"lq_bound", "ceiling", "clairvoyant"},
        ),
    ],
)
def test_every_condition_counts(change, left_out):
    change = dict(change)
    network, reference = change.pop("network", CAR), change.pop("reference", "passive")
    found = comparable(network, Conditions(**change), reference=reference)
    assert {name for name, reason in vars(found).items() if reason} == left_out
    assert (found.left_out is None) == (not left_out)


def test_the_report_draws_no_bound_that_does_not_hold(monkeypatch, tmp_path):
    """No bound is in the picture; the page says why."""
    asked = []

    def front(tyre, travel, **options):
        return asked.append(options) or np.zeros((3, 2))

    monkeypatch.setattr(beside, "lq_front", front)
    result = score(
        [find("isd-passive", CAR)],
        CAR,
        reference=passive(CAR),
        episodes=2,
        duration=1.0,
    )
    assert beside.fronts(result) == [] and not asked
    chart = page.trade_off(page.Shown(result))
    assert "bound" not in chart.caption.replace("boundary", "")
    html = page.score_report(result, tmp_path / "page").read_text(encoding="utf-8")
    assert "Left out: the LQ bound and the causal ceiling" in html

    result.comparable = Comparable()
    assert len(beside.fronts(result)) == 2
    assert (
        asked[0]["network"] is CAR and asked[0]["road"].name == "paper"
    )  # the plant itself, not its name
