"""The summary of a diagnosis: every sentence comes from the numbers of the document."""

import re
from dataclasses import asdict, replace
from typing import get_args

import pytest
from test_criteria import GOOD, NAMED, NONE, OPEN
from test_law_sets import answer, row

from isd_gym.diagnosis import CRITERIA
from isd_gym.diagnosis._verdict.gates import Reason, decide, gate, gates_of
from isd_gym.diagnosis._verdict.wording import (
    ADVICE,
    KINDS,
    NOT_BORNE_OUT,
    TESTS,
    failures,
    plain_number,
    statements_of,
    summary_of,
)

pytestmark = pytest.mark.tools

FRICTION = {
    "effect": "coulomb_friction",
    "between": ["mass", "ground"],
    "confidence": 0.9,
    "parameters": {"level": {"value": 3.0, "low": 2.9, "high": 3.1, "unit": "N"}},
}
SEEN = replace(GOOD, channels=("travel",), after=(0.02,), explained=0.99)


def document(found=NAMED, evidence=SEEN, after=0.02, **more):
    """A diagnosis as its JSON has it, with the verdict of the answer."""
    decision = decide(found, evidence)
    rows = {
        "before": evidence.before[0],
        "refit": evidence.refit[0],
        "after": after,
        "noise_floor": 0.02,
    }
    gates = [g.to_dict() for g in decision.gates]
    rejected = {
        "effects": ["coulomb_friction"],
        "where": [["mass", "ground"]],
        "values": [{"level": 3.0}],
        "explained": evidence.explained,
        "error": {k: {"travel": rows[k]} for k in ("before", "refit")}
        | {"after": {"travel": 0.07}},
        "failed_gates": [g for g in gates if not g["passed"]],
    }
    return {
        "verdict": decision.verdict,
        "reason": decision.reason,
        "effects": [FRICTION] if decision.verdict == "missing_effect" else [],
        "alternatives": [],
        "where": [{"channel": "travel", "share": 1.0, "band_hz": None}],
        "parameters": {},
        "gap": {"held_out": {k: {"travel": v} for k, v in rows.items()}, "closed": None},
        "gates": gates,
        "next_experiment": None,
        "best_candidate": rejected if gates and decision.verdict != "missing_effect" else None,
        "remainder": None,
        "stretches": None,
        "constant": {},
        "findings": [],
        "evidence": asdict(evidence),
        "criteria": asdict(CRITERIA),
    } | more  # fmt: skip


def errors(before=0.3, refit=0.3, after=0.021):
    """Errors on the test records."""
    rows = {"before": before, "refit": refit, "after": after, "noise_floor": 0.01}
    return {
        "gap": {"held_out": {k: {"travel": v} for k, v in rows.items()}, "closed": None}
    }


def dry(*probabilities):
    """Findings of dry friction and then of an elastic force, with these probabilities."""
    laws = [{"effect": "coulomb_friction", "probability": 0.4, "parameters": {}}]
    place = {"place": ["mass", "ground"], "place_probability": 1.0, "laws": laws}
    kinds = zip(("dry_friction", "elastic"), probabilities, strict=False)
    return [place | {"kind": k, "kind_probability": p} for k, p in kinds]


def law(effect, **parameters):
    values = {
        k: {"value": v, "low": v, "high": v, "unit": "N"} for k, v in parameters.items()
    }
    return FRICTION | {"effect": effect, "parameters": values}


def rivals():
    """Two laws with equal predictions."""
    errors = {"coulomb_friction": 0.01, "hysteresis": 0.012}
    return [
        {"effects": [name], "where": [["mass", "ground"]], "excess": excess}
        for name, excess in errors.items()
    ]


WORSE = r"made the model worse on held-out data \(travel: 14.0 % as given, 30.0 % refitted\)"
BORNE_OUT = f"^(?!.*{re.escape(NOT_BORNE_OUT)})"
SPEEDS = "two or three constant speeds"


DOUBTED = law("coulomb_friction", level=3.0) | {"confidence": 0.64}
LEANING = law("asymmetric_damping", extension=-450.0, compression=550.0)
LEANING |= {
    "totals": {
        k: {"value": v, "unit": "N s/m"}
        for k, v in (("extension", 1050.0), ("compression", 2050.0))
    }
}


@pytest.mark.parametrize(
    ("found", "more", "words"),
    [
        (NAMED, {"after": 0.021}, BORNE_OUT + ".*falls from 30.0 % to 2.1 %"),
        (NAMED, {"after": 0.9}, f"rises from 30.0 % to 90.0 %.*{re.escape(NOT_BORNE_OUT)}.*Next: repeat the test"),
        (NONE, errors(before=0.14), WORSE),
        (NAMED, errors(before=0.14), WORSE),
        (NONE, errors(before=0.299), "^(?!.*worse on held-out data)"),
        (NONE, errors(before=0.4), "^(?!.*worse on held-out data)"),
        (NONE, errors(1.2, 1.053, 0.9), "errs more in travel than a constant would"),
        (NONE, errors(1.2, 0.99, 0.9), "^(?!.*than a constant would)"),
        (NONE, {}, "With the best candidate, Coulomb friction between mass and ground, the error in travel falls from 30.0 % to 7.0 %."),
        (NONE, {}, r"is not named because it leaves too much of the error\."),
        (answer(row(0.3)), {}, "No known effect reduces the held-out error by enough to be kept."),
        (OPEN, {"alternatives": rivals(), "next_experiment": {"do": "a sine"}}, r"between 2 candidates: Coulomb friction between mass and ground \(leaves 1.0 %.*Next: run the test in next_experiment.csv.$"),
        (NAMED, {"effects": [law("asymmetric_friction", extension=3.0, compression=2.0)]}, "Coulomb friction of 2.5 N and a constant force of 0.5 N are the same force"),
        (NAMED, {}, "^(?!.*the same force)"),
        (NAMED, {}, r"^The model lacks Coulomb friction .*\(level 3 N\) \(probability 0.90\)\. With"),
        (NAMED, {"effects": [DOUBTED]}, r"^The model probably lacks Coulomb friction .*\(probability 0.64\)\. With"),
        (NAMED, {"effects": [LEANING]}, r"\(extension 1050 N s/m, compression 2050 N s/m, with the damper beside it\)"),
        # the test on the rig is that of the likeliest kind of an effect without a name
        (NONE, {"findings": dry(0.95)}, SPEEDS),
        (NONE, {"findings": dry(0.33)}, SPEEDS),
        (NONE, {"findings": dry(0.1)}, f"^(?!.*{SPEEDS})"),
        (NAMED, {"findings": dry(0.95)}, f"^(?!.*{SPEEDS})"),
    ],
)  # fmt: skip
def test_every_sentence_of_a_summary_has_its_reason(found, more, words):
    assert re.search(words, summary_of(document(found, **more)), re.DOTALL)


def test_a_model_that_is_completed_without_a_certain_name_says_so():
    open_law = document(NONE, verdict="unknown_effect")
    assert "model.json" not in summary_of(open_law)
    open_law["best_candidate"]["completes"] = True
    open_law["gap"]["closed"] = 0.61
    said = summary_of(open_law)
    best = "model.json has Coulomb friction between mass and ground, which predicts best: the error in travel falls"
    assert best in said
    assert (
        "61 % of the gap is closed on the test records." in said
        and "is not named because" in said
    )


def test_no_candidate_that_raises_the_error_is_best_and_nothing_is_said_to_explain_it():
    worse = document(NONE)
    worse["best_candidate"]["error"]["after"]["travel"] = 0.34
    said = summary_of(worse)
    assert "No known effect reduces the error on the test records" in said
    assert "34.0 % (refitted 30.0 %)" in said
    assert "best candidate" not in said and "explain" not in said
    unseen = document(NONE, verdict="unknown_effect")
    unseen["best_candidate"]["explained"] = -0.4
    said = summary_of(unseen)
    assert (
        "No known effect reduces the error on the validation records." in said
        and "best" not in said
    )


def test_the_title_is_the_finding():
    assert (
        statements_of(document()).title
        == "Missing: Coulomb friction between mass and ground"
    )
    for probabilities in ((0.62, 0.02), (0.5, 0.5)):
        tied = document(
            NONE,
            verdict="ambiguous",
            alternatives=rivals(),
            findings=dry(*probabilities),
        )
        assert (
            statements_of(tied).title
            == "An effect is missing; these data leave 2 candidates"
        )
        assert "equally" not in summary_of(tied)
    assert (
        statements_of(document(NONE)).title == "An effect is missing; no known law fits"
    )
    probable = statements_of(document(NONE, findings=dry(0.9))).title
    assert (
        probable
        == "An effect is missing, probably dry friction between mass and ground"
    )


@pytest.mark.parametrize(
    ("change", "reason", "words"),
    [
        ({"refit": (0.021,)}, "immaterial", "the error in travel beyond noise is 0.6 %, at most 3 %"),
        ({"refit": (0.06,), "noise": (0.05,)}, "noise", "the error in travel beyond noise is 3.3 %, less than the noise (5.0 %)"),
    ],
)  # fmt: skip
def test_why_nothing_is_missing_is_told_with_its_figures(change, reason, words):
    quiet = replace(SEEN, **({"before": (0.2,), "training_refit": (0.05,)} | change))
    spring = {
        "prior": 100.0,
        "value": 112.0,
        "low": 111.0,
        "high": 113.0,
        "unit": "N/m",
    }
    d = document(answer(row(0.05)), quiet, parameters={"k.stiffness": spring})
    assert (d["verdict"], d["reason"]) == ("parameters_only", reason)
    said = summary_of(d)
    assert words in said
    assert "k.stiffness from 100 to 112 N/m (+12.0%)" in said


@pytest.mark.parametrize("reason", get_args(Reason))
@pytest.mark.parametrize("verdict", ["no_discrepancy", "parameters_only"])
def test_every_reason_of_a_verdict_has_words(verdict, reason):
    said = summary_of(document(NONE, verdict=verdict, reason=reason))
    assert said.endswith(".")


def test_every_failed_gate_has_an_advice_and_every_kind_a_test_on_the_rig():
    assert set(ADVICE) == {g.name for found in (NAMED, NONE) for g in gates_of(found)}
    assert set(TESTS) == set(KINDS) - {"other"}


def test_a_figure_that_is_not_finite_does_not_lose_the_result():
    """JSON has null for such a figure; the summary is written all the same."""

    def blanked(node):
        if isinstance(node, dict):
            return {
                k: v if k in ("criteria", "count") else blanked(v)
                for k, v in node.items()
            }
        if isinstance(node, list | tuple):
            return [blanked(v) for v in node]
        return None if isinstance(node, float) else node

    quiet = document(
        answer(row(0.021)), replace(SEEN, refit=(0.021,), training_refit=(0.021,))
    )
    for made in (document(), document(NONE), quiet):
        assert summary_of(blanked(made))
    assert plain_number(None) == "unknown"
    unknown = gate("g", float("nan"), ">", 1.0, "").to_dict() | {"value": None}
    assert failures([unknown]) == "g is unknown"
