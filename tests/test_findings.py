"""Probabilities of place, kind and law, from weighted candidates made by hand."""

import json
from collections import Counter
from pathlib import Path
from types import SimpleNamespace

import pytest
from test_words import VAGUE, document

from isd_gym.diagnosis._result_builder import ResultBuilder
from isd_gym.diagnosis._selection.criteria import CRITERIA
from isd_gym.diagnosis._selection.weights import FREE_FORCE, Statement, WeightedCandidate
from isd_gym.diagnosis._verdict.findings import find
from isd_gym.diagnosis._verdict.gates import confidence
from isd_gym.diagnosis._verdict.grades import MISTAKEN, OBSERVED, grade, observed
from isd_gym.diagnosis._verdict.wording import summary_of

FRONT, REAR = ("body_front", "wheel_front"), ("body_rear", "wheel_rear")
FIT = SimpleNamespace(structure=SimpleNamespace(hypotheses=(), names=()))
NO_LAWS = SimpleNamespace(fit=FIT, elements=())
HELD = {"test_explained": 1.0, "support": 1.0, "imitated": False}


def friction(place):
    return Statement(place, "dry_friction", "coulomb_friction")


def found(*weighted, own, is_named=False, explained=0.99, left=0.0):
    """Findings of candidates: pairs of a weight and the statements of a candidate; `own` are those of the foremost candidate."""
    candidates = [WeightedCandidate(NO_LAWS, w, frozenset(s)) for w, s in weighted]
    evidence = SimpleNamespace(explained=explained, width_after=left, **HELD)
    search = SimpleNamespace(criteria=CRITERIA)
    return find(search, candidates, evidence, {}, frozenset(own), is_named=is_named, is_doubted=False)


def test_a_kind_that_two_places_share_is_certain_and_its_place_is_open():
    front, rear = [friction(FRONT)], [friction(REAR)]
    first, *others = found((0.55, front), (0.43, rear), (0.02, []), own=front)
    assert first.place == () and first.kind == "dry_friction" and not first.named
    assert first.kind_probability == pytest.approx(0.98 * (1 - MISTAKEN["kind"]))
    assert first.kind_probability >= CRITERIA.certain
    assert {f.place: f.kind_probability < CRITERIA.certain for f in others} == {FRONT: True, REAR: True}
    assert [law.effect for law in first.laws] == ["coulomb_friction"]


@pytest.mark.parametrize(
    ("candidates", "is_named"),
    [
        (((0.9, [friction(FRONT)]), (0.1, [friction(REAR)])), False),  # the place is certain
        (((0.9, [friction(FRONT)]), (0.1, [friction(REAR)])), True),
        (((0.5, [friction(FRONT)]), (0.5, [Statement(FRONT, "dry_friction", "stribeck_friction")])), False),  # one place
        (((0.6, [friction(FRONT)]), (0.4, [Statement(REAR, "viscous", "linear_damping")])), False),  # two kinds
    ],
)  # fmt: skip
def test_no_open_place_where_a_place_is_certain_or_kinds_differ(candidates, is_named):
    assert all(f.place for f in found(*candidates, own=[friction(FRONT)], is_named=is_named))


def test_a_place_is_doubted_where_its_candidate_explains_less_than_half_or_did_not_pass():
    front, rear = [friction(FRONT)], [friction(FRONT), friction(REAR)]
    sure = {f.place: f.place_probability for f in found((0.1, front), (0.9, rear), own=front)}
    assert sure[FRONT] == pytest.approx(1 - MISTAKEN["place"])
    assert sure[REAR] == pytest.approx(0.9 * (1 - MISTAKEN["extra"]))  # the further effect did not pass
    (weak,) = found((1.0, front), own=front, explained=0.3)
    assert weak.place_probability == weak.kind_probability == pytest.approx(1 - MISTAKEN["weak"])
    # a part is explained, and the name did not pass
    (partly,) = found((1.0, front), own=front, explained=0.8)
    assert partly.place_probability == partly.kind_probability == pytest.approx(1 - MISTAKEN["partly"])
    (passed,) = found((1.0, front), own=front, explained=0.8, is_named=True)
    assert passed.kind_probability == pytest.approx(1 - MISTAKEN["kind"])
    free = Statement(FRONT, "other", FREE_FORCE)
    (table,) = found((1.0, [free]), own=[friction(FRONT)], explained=0.3)
    assert (table.place_probability, table.kind_probability) == (1 - MISTAKEN["place"], 1 - MISTAKEN["free"])


def test_a_law_beside_the_foremost_candidates_law_is_doubted_and_a_rival_is_not():
    """A richer candidate holds both laws: the further one did not pass the inclusion test."""
    further = Statement(FRONT, "dry_friction", "stribeck_friction")
    rival = Statement(FRONT, "dry_friction", "hysteresis")
    weighted = (0.8, [friction(FRONT), further]), (0.1, [friction(FRONT)]), (0.1, [rival])
    (both,) = found(*weighted, own=[friction(FRONT)], is_named=True)
    said = {law.effect: law.probability for law in both.laws}
    doubt = 1 - MISTAKEN["law"]
    assert said["coulomb_friction"] == pytest.approx(0.9 * doubt)
    assert said["hysteresis"] == pytest.approx(0.1 * doubt)
    assert said["stribeck_friction"] == pytest.approx(0.8 * (1 - MISTAKEN["extra"]))
    assert both.laws[0].effect == "coulomb_friction"


def test_a_place_with_most_of_the_weight_is_not_open_however_doubtful_the_kind_is():
    front, rear = [friction(FRONT)], [friction(REAR)]
    findings = found((0.9, front), (0.1, rear), own=front, explained=0.6)
    assert all(f.place for f in findings) and findings[0].kind_probability < CRITERIA.certain


def test_a_kind_that_explains_a_part_is_told_as_probable():
    front = [friction(FRONT)]
    for explained, told in ((0.99, "is missing"), (0.6, "is probably missing")):
        findings = [f.to_dict() for f in found((1.0, front), own=front, explained=explained)]
        text = summary_of(document(VAGUE, findings=findings))
        assert f"Dry friction between body_front and wheel_front {told} (probability" in text


def test_the_summary_says_that_the_place_is_open():
    front, rear = [friction(FRONT)], [friction(REAR)]
    findings = [f.to_dict() for f in found((0.55, front), (0.43, rear), (0.02, []), own=front)]
    text = summary_of(document(VAGUE, findings=findings))
    assert "Dry friction is missing (probability 0.93), but the data do not determine its place:" in text
    assert "between body_front and wheel_front (0.53) or between body_rear and wheel_rear (0.42)." in text
    assert "Also possible" not in text


@pytest.mark.parametrize(("weight", "words"), [(1.0, "Perhaps beside it"), (0.88, "Also possible")])
def test_a_kind_beside_a_certain_kind_is_told_from_one_in_its_place(weight, words):
    """Of 0.33, at most 0.05 is left for candidates without the certain kind; of 0.23, up to 0.16."""
    spring = Statement(FRONT, "elastic", "cubic_stiffness")
    both = [friction(FRONT), spring]
    candidates = [(weight, both)] if weight == 1.0 else [(weight, [friction(FRONT)]), (1 - weight, [spring])]
    findings = [f.to_dict() for f in found(*candidates, own=[friction(FRONT)])]
    for f in findings:  # as likely as a further kind is in most of the results
        if f["kind"] == "elastic" and weight < 1.0:
            f["kind_probability"] = 0.23
    text = summary_of(document(VAGUE, findings=findings))
    assert f"{words}: an elastic force between body_front and wheel_front" in text


@pytest.mark.parametrize(("is_tied", "listed"), [(True, ["best"]), (False, ["other"])])
def test_a_candidate_without_a_rival_is_not_listed_as_one_that_cannot_be_told_apart(is_tied, listed):
    """A certain kind whose law is open: the best candidate has no rival, and stands in `best_candidate`."""

    def candidate(name):
        h = SimpleNamespace(effect=name, where=("rod", "ground"), choices={})
        return SimpleNamespace(hypotheses=(h,), elements=(), deviance=0.0)

    best, other = candidate("best"), candidate("other")
    scored = {"rivals": lambda: [other], "score": lambda r: SimpleNamespace(mean_square=0.4 if r else 1.0)}
    scores = SimpleNamespace(refitted=None, foremost=best, noise_score=0.0, **scored)
    made = ResultBuilder._contenders(SimpleNamespace(scores=scores), [], is_tied)
    assert [c.effects[0] for c in made] == listed
    assert (made[0].why_not == "cannot be told apart on these data") == is_tied


@pytest.mark.parametrize(
    ("probability", "told"),
    [(0.97, "certain"), (0.8, "certain"), (0.79, "probable"), (0.5, "probable"), (0.49, "possible"), (0.0, "possible")],
)  # fmt: skip
def test_a_probability_has_a_grade(probability, told):
    assert grade(probability) == told
    (sure,) = found((1.0, [friction(FRONT)]), own=[friction(FRONT)])
    assert sure.to_dict()["grade"] == {"place": "certain", "kind": "certain"}


def test_the_frequencies_of_grades_are_those_of_the_first_looks():
    folder = Path(__file__).resolve().parents[1] / "benchmarks"
    stated, true = Counter(), Counter()
    suites = json.loads((folder / "diagnosis.json").read_text(encoding="utf-8"))
    for suite in ("families 463", "families 472", "home 463", "home 472"):
        for level, bins in suites[suite]["reliability"].items():
            for b in bins:
                stated["simulated", level, grade(b["low"])] += b["names"]
                true["simulated", level, grade(b["low"])] += round(b["names"] * b["right"])
    for look in json.loads((folder / "first-looks.json").read_text(encoding="utf-8")):
        for rig in look["rigs"]:
            for level, statements in rig["stated"].items():
                for probability, is_true in statements:
                    stated["measured", level, grade(probability)] += 1
                    true["measured", level, grade(probability)] += is_true
    counted = {k: (stated[k], true[k]) for k in stated if stated[k]}
    kept = {(r, x, g): n for r, by in OBSERVED.items() for x, of in by.items() for g, n in of.items() if n[0]}
    assert kept == counted
    assert observed("place", "certain") == "true: 248 of 264 on simulated rigs, 45 of 46 on measured rigs"
    assert observed("law", "possible") == "true: 25 of 145 on simulated rigs, 21 of 58 on measured rigs"


def test_a_law_that_leaves_a_wide_gap_is_probable_however_much_it_explains():
    """A cogging force took the error of a pendulum from 91 to 24 %, which is 93 % of the squares, in place of the sine of gravity."""
    named = {"own": [friction(FRONT)], "is_named": True, "explained": 0.93}
    sure, open_law = (found((1.0, [friction(FRONT)]), left=left, **named)[0] for left in (0.09, 0.24))
    assert sure.laws[0].probability == pytest.approx(1.0 - MISTAKEN["law"])
    assert open_law.laws[0].probability == pytest.approx(1.0 - MISTAKEN["partly"])
    assert open_law.laws[0].to_dict()["grade"] == "probable"


def test_a_law_that_is_the_sum_of_two_others_is_probable_at_most():
    """Asymmetric friction is Coulomb friction with a constant force, which may be an offset of a load: no record tells them apart."""
    lean = [Statement(FRONT, "dry_friction", "asymmetric_friction")]
    (one,) = found((1.0, lean), own=lean, is_named=True)
    assert one.kind_probability == pytest.approx(1.0 - MISTAKEN["kind"])
    assert one.laws[0].probability == pytest.approx(1.0 - MISTAKEN["partly"])
    evidence = SimpleNamespace(explained=0.99, width_after=0.0, probability=1.0, **HELD)
    assert confidence(evidence, is_sum=True) == one.laws[0].probability < confidence(evidence)
    evidence.imitated = True  # unmodelled effects may have told the law from its special case
    assert confidence(evidence) == one.laws[0].probability
