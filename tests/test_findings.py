"""Probabilities of place, kind and law, from weighted candidates made by hand."""

from collections import Counter
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from program import read_json
from test_criteria import GOOD
from test_words import NONE, document

from isd_gym.diagnosis import CRITERIA
from isd_gym.diagnosis._selection.held_out_table import Member
from isd_gym.diagnosis._verdict.findings import Finder
from isd_gym.diagnosis._verdict.grades import MISTAKEN, OBSERVED, grade, observed
from isd_gym.diagnosis._verdict.wording import summary_of
from isd_gym.diagnosis.result import _plain

FRONT, REAR = ("body_front", "wheel_front"), ("body_rear", "wheel_rear")
NO_LAWS = SimpleNamespace(hypotheses=(), elements=())


def member(place, mechanism, effect):
    return Member(effect, place, mechanism, "between")


def friction(place):
    return member(place, "dry_friction", "coulomb_friction")


def found(*weighted, named=(), is_doubted=False, **changes):
    """Findings of sets: pairs of a weight and the members of a set; `changes` of the evidence."""
    sets = [(SimpleNamespace(fit=NO_LAWS, members=tuple(s)), w) for w, s in weighted]
    evidence = replace(GOOD, **changes)
    return Finder(CRITERIA, sets, evidence, {}, frozenset(named), is_doubted).find()


def test_a_kind_that_two_places_share_is_certain_and_its_place_is_open():
    front, rear = [friction(FRONT)], [friction(REAR)]
    first, *others = found((0.55, front), (0.43, rear), (0.02, []))
    assert first.place == () and first.kind == "dry_friction" and not first.named
    assert first.kind_probability == pytest.approx(0.98 * (1 - MISTAKEN["kind"]))
    assert first.kind_probability >= CRITERIA.certain
    assert {f.place: f.kind_probability < CRITERIA.certain for f in others} == {
        FRONT: True,
        REAR: True,
    }
    assert [law.effect for law in first.laws] == ["coulomb_friction"]


@pytest.mark.parametrize(
    ("sets", "named"),
    [
        (((0.9, [friction(FRONT)]), (0.1, [friction(REAR)])), ()),  # the place is certain
        (((0.6, [friction(FRONT)]), (0.4, [friction(REAR)])), [friction(FRONT)]),
        (((0.5, [friction(FRONT)]), (0.5, [member(FRONT, "dry_friction", "stribeck_friction")])), ()),  # one place
        (((0.6, [friction(FRONT)]), (0.4, [member(REAR, "viscous", "linear_damping")])), ()),  # two kinds
    ],
)  # fmt: skip
def test_no_open_place_where_a_place_is_certain_or_kinds_differ(sets, named):
    assert all(f.place for f in found(*sets, named=named))


def test_statements_of_a_set_that_explains_a_part_or_was_not_needed_are_doubted():
    front = (1.0, [friction(FRONT)])
    (sure,) = found(front)
    assert sure.place_probability == pytest.approx(1 - MISTAKEN["place"])
    (weak,) = found(front, explained=0.3)
    assert (
        weak.place_probability
        == weak.kind_probability
        == pytest.approx(1 - MISTAKEN["weak"])
    )
    (partly,) = found(front, explained=0.6)
    assert (
        partly.place_probability
        == partly.kind_probability
        == pytest.approx(1 - MISTAKEN["partly"])
    )
    (doubted,) = found(front, is_doubted=True)
    assert (
        doubted.kind_probability
        == doubted.laws[0].probability
        == pytest.approx(1 - MISTAKEN["extra"])
    )


def test_a_law_has_the_weight_of_the_sets_that_contain_it():
    further = member(FRONT, "viscous", "quadratic_damping")
    rival = member(FRONT, "dry_friction", "hysteresis")
    both, beside = found(
        (0.8, [friction(FRONT), further]), (0.1, [friction(FRONT)]), (0.1, [rival])
    )
    said = {law.effect: law.probability for law in (*both.laws, *beside.laws)}
    expected = {"coulomb_friction": 0.9, "hysteresis": 0.1, "quadratic_damping": 0.8}
    assert said == pytest.approx(
        {k: v * (1 - MISTAKEN["law"]) for k, v in expected.items()}
    )


def test_a_place_with_most_of_the_weight_is_not_open_however_doubtful_the_kind_is():
    front, rear = [friction(FRONT)], [friction(REAR)]
    findings = found((0.9, front), (0.1, rear), explained=0.6)
    assert (
        all(f.place for f in findings)
        and findings[0].kind_probability < CRITERIA.certain
    )


def test_a_kind_that_explains_a_part_is_told_as_probable():
    front = [friction(FRONT)]
    for explained, told in ((0.99, "is missing"), (0.6, "is probably missing")):
        findings = [_plain(f) for f in found((1.0, front), explained=explained)]
        text = summary_of(document(NONE, findings=findings))
        assert (
            f"Dry friction between body_front and wheel_front {told} (probability"
            in text
        )


def test_the_summary_says_that_the_place_is_open():
    front, rear = [friction(FRONT)], [friction(REAR)]
    findings = [_plain(f) for f in found((0.55, front), (0.43, rear), (0.02, []))]
    text = summary_of(document(NONE, findings=findings))
    assert (
        "Dry friction is missing (probability 0.93), but the data do not determine its place:"
        in text
    )
    assert (
        "between body_front and wheel_front (0.53) or between body_rear and wheel_rear (0.42)."
        in text
    )


@pytest.mark.parametrize(
    ("probability", "told"),
    [(0.97, "certain"), (0.8, "certain"), (0.79, "probable"), (0.5, "probable"), (0.49, "possible"), (0.0, "possible")],
)  # fmt: skip
def test_a_probability_has_a_grade(probability, told):
    assert grade(probability) == told
    (sure,) = found((1.0, [friction(FRONT)]))
    assert sure.to_dict()["grade"] == {"place": "certain", "kind": "certain"}


def test_the_frequencies_of_grades_are_those_of_the_first_looks():
    folder = Path(__file__).resolve().parents[1] / "benchmarks"
    stated, true = Counter(), Counter()
    for suite in read_json(folder / "diagnosis.json").values():
        for level, bins in suite["reliability"].items():
            for b in bins:
                stated["simulated", level, grade(b["low"])] += b["names"]
                true["simulated", level, grade(b["low"])] += round(
                    b["names"] * b["right"]
                )
    for look in read_json(folder / "first-looks.json"):
        for rig in look["rigs"]:
            for level, statements in rig["stated"].items():
                for probability, is_true in statements:
                    stated["measured", level, grade(probability)] += 1
                    true["measured", level, grade(probability)] += is_true
    counted = {k: (stated[k], true[k]) for k in stated if stated[k]}
    kept = {
        (r, x, g): n
        for r, by in OBSERVED.items()
        for x, of in by.items()
        for g, n in of.items()
        if n[0]
    }
    assert kept == counted
    assert (
        observed("place", "certain")
        == "true: 93 of 94 on simulated rigs, 45 of 46 on measured rigs"
    )
    assert (
        observed("law", "possible")
        == "true: 0 of 2 on simulated rigs, 21 of 58 on measured rigs"
    )
