"""Ablation of the diagnosis: variations of the search apply and are undone; stated and observed shares of doubtful statements."""

import importlib
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))

import ablation
import search_ablation
from search_ablation import SELECTION, VARIATIONS, varied

from isd_gym.diagnosis._selection.criteria import CRITERIA
from isd_gym.diagnosis._selection.settings import SearchSettings
from isd_gym.diagnosis._verdict.grades import MISTAKEN

pytestmark = pytest.mark.tools


@pytest.mark.parametrize("variation", VARIATIONS, ids=lambda v: f"{v.target} {v.label}")
def test_a_variation_changes_its_target_and_is_undone(variation):
    def value():
        module, *path = variation.target.split(".")
        place = importlib.import_module(f"{SELECTION}.{module}")
        for name in path:
            place = getattr(place, name)
        return place

    if variation.is_setting:
        with varied(variation) as settings:
            changed = getattr(settings, variation.target)
        assert changed == variation.value != getattr(SearchSettings(), variation.target)
        return
    before = value()
    with varied(variation):
        assert value() is variation.value and variation.value != before
    assert value() is before


def test_the_lines_of_the_search_that_a_diagnosis_executes_tell_what_it_depends_on():
    from isd_gym.diagnosis._selection.candidate import simplest_first

    with search_ablation.executed() as lines:
        simplest_first([], 30.0, 60.0)
    assert any("if not ranked" in line for line in lines)
    assert not any("is_imitation" in line for line in lines)  # nothing to imitate


def row(explained, kind_probability, law_probability):
    """A case with friction between mass and ground, found there."""
    place = ["ground", "mass"]
    finding = {
        "place": place,
        "place_probability": 1.0 - MISTAKEN["weak"],
        "kind": "dry_friction",
        "kind_probability": kind_probability,
        "laws": [{"effect": "coulomb_friction", "probability": law_probability}],
    }
    said = {
        "evidence": {"explained": explained},
        "criteria": {"least_removed": CRITERIA.least_removed},
        "findings": [finding],
    }
    said["best_candidate"] = {"where": [place]}
    return {"answer": [["coulomb_friction", place]], "truth": None, "diagnosis": said}


def test_the_weight_of_a_statement_is_recovered_whatever_its_limit():
    (weak,) = ablation.shares_of([row(0.3, 0.4, 0.4)])
    assert weak["limit"] == "weak" and weak["statements"] == 1 and weak["true"] == 1.0
    assert weak["stated"] == pytest.approx(1.0 - MISTAKEN["weak"])
    assert weak["halved"] == pytest.approx(1.0 - 0.5 * MISTAKEN["weak"])
    extra = 1.0 - MISTAKEN["extra"]
    (doubted,) = ablation.shares_of([row(0.99, extra, extra)])
    assert doubted["limit"] == "extra" and doubted["stated"] == pytest.approx(extra)
    assert ablation.shares_of([row(0.99, 0.95, 0.94)]) == []  # passed the inclusion test
