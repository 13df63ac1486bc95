"""The summary of a diagnosis: every sentence comes from the numbers of the document."""

from dataclasses import asdict, replace
from typing import get_args

import pytest
from test_criteria import GOOD

from isd_gym.diagnosis._selection.criteria import CRITERIA
from isd_gym.diagnosis._verdict.evidence import EffectEvidence
from isd_gym.diagnosis._verdict.gates import Reason, decide, gate, gates_of, table_gates
from isd_gym.diagnosis._verdict.wording import (
    ADVICE,
    KINDS,
    NOT_BORNE_OUT,
    TESTS,
    failures,
    plain_number,
    plain_value,
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
SEEN = replace(
    GOOD,
    channels=("travel",),
    after=(0.02,),
    effects=(EffectEvidence("coulomb_friction at mass-ground", share=0.4, spread=0.05),),
    explained=0.99,
    richest=(0.02,),
)


def document(evidence=SEEN, after=0.02, **more):
    """A diagnosis as its JSON has it, with the verdict of the evidence."""
    decision = decide(evidence)
    rows = {"before": evidence.before[0], "refit": evidence.refit[0], "after": after, "noise_floor": 0.02}
    gates = [g.to_dict() for g in decision.gates]
    rejected = {
        "effects": ["coulomb_friction"],
        "where": [["mass", "ground"]],
        "values": [{"level": 3.0}],
        "explained": evidence.explained,
        "error": {k: {"travel": rows[k]} for k in ("before", "refit")} | {"after": {"travel": 0.07}},
        "failed_gates": [g for g in gates if not g["passed"]],
    }
    return {
        "verdict": decision.verdict,
        "reason": decision.reason,
        "effects": [FRICTION] if decision.verdict == "missing_effect" else [],
        "small_effects": [FRICTION] if decision.small else [],
        "alternatives": [],
        "where": [{"channel": "travel", "share": 1.0, "bands_hz": [], "when": "velocity of a-b changes sign"}],
        "parameters": {},
        "gap": {"held_out": {k: {"travel": v} for k, v in rows.items()}, "closed": None},
        "gates": gates,
        "next_experiment": None,
        "tabulated": None,
        "best_table": None,
        "best_candidate": rejected if gates and decision.verdict != "missing_effect" else None,
        "remainder": None,
        "stretches": None,
        "constant": {},
        "findings": [],
        "evidence": asdict(evidence),
        "criteria": asdict(CRITERIA),
    } | more  # fmt: skip


def test_a_name_that_the_records_to_report_by_do_not_bear_out_says_so():
    assert "falls from 30.0 % to 2.1 %" in summary_of(document(after=0.021))
    assert NOT_BORNE_OUT not in summary_of(document(after=0.021))
    assert "rises from 30.0 % to 90.0 %" in summary_of(document(after=0.9))
    assert NOT_BORNE_OUT in summary_of(document(after=0.9))
    assert "Next: repeat the test" in summary_of(document(after=0.9))


def test_a_refit_that_errs_more_than_the_model_as_given_is_told():
    def said(before, evidence=VAGUE):
        rows = {"before": before, "refit": 0.3, "after": 0.021, "noise_floor": 0.01}
        held_out = {k: {"travel": v} for k, v in rows.items()}
        return summary_of(document(evidence, gap={"held_out": held_out, "closed": None}))

    worse = "made the model worse on held-out data (travel: 14.0 % as given, 30.0 % refitted)"
    assert worse in said(before=0.14) and worse in said(before=0.14, evidence=SEEN)
    assert "worse on held-out data" not in said(before=0.299) + said(before=0.4)


@pytest.mark.parametrize(("refit", "is_told"), [(1.053, True), (0.99, False)])
def test_a_refit_that_errs_more_than_a_constant_is_told(refit, is_told):
    rows = {"before": 1.2, "refit": refit, "after": 0.9, "noise_floor": 0.01}
    held_out = {k: {"travel": v} for k, v in rows.items()}
    said = summary_of(document(VAGUE, gap={"held_out": held_out, "closed": None}))
    assert ("errs more in travel than a constant would" in said) == is_told


def test_a_model_that_is_completed_without_a_certain_name_says_so():
    open_law = document(VAGUE, verdict="unknown_effect", best_table=tried(0.3))
    assert "model.json" not in summary_of(open_law)
    open_law["best_candidate"]["completes"] = True
    open_law["gap"]["closed"] = 0.61
    said = summary_of(open_law)
    assert (
        "model.json has Coulomb friction between mass and ground, which predicts best: the error in travel falls"
        in said
    )
    assert "61 % of the gap is closed on the test records." in said and "is not named because" in said
    open_law["best_candidate"]["explained"] = 0.2
    assert (
        "test records, but only 20 % on the validation records: it is not yet the whole cause"
        in summary_of(open_law)
    )
    open_law["gap"]["closed"] = 0.38
    assert "The cause is not found; this law is a stopgap." in summary_of(open_law)


def test_no_candidate_that_raises_the_error_is_best_and_nothing_is_said_to_explain_it():
    worse = document(VAGUE)
    worse["best_candidate"]["error"]["after"]["travel"] = 0.34
    said = summary_of(worse)
    assert (
        "No known effect reduces the error on the test records" in said and "34.0 % (refitted 30.0 %)" in said
    )
    assert "best candidate" not in said and "explain" not in said
    unseen = document(VAGUE, verdict="unknown_effect", best_table=tried(-0.15))
    unseen["best_candidate"]["explained"] = -0.4
    said = summary_of(unseen)
    assert "No known effect reduces the error on the validation records." in said and "best" not in said
    assert "No table of a force between two nodes reduces the held-out error." in said and "-15" not in said
    alone = worse | {"verdict": "ambiguous"}
    assert "no known effect reduces the error" in summary_of(alone) and "removes" not in summary_of(alone)


def test_the_title_is_the_finding():
    assert statements_of(document()).title == "Missing: Coulomb friction between mass and ground"
    rivals = [
        {"effects": [e], "where": [["mass", "ground"]], "excess": 0.01} for e in ("hysteresis", "backlash")
    ]
    for probabilities in ((0.62, 0.02), (0.5, 0.5)):
        tied = document(VAGUE, verdict="ambiguous", alternatives=rivals, findings=dry(*probabilities))
        assert statements_of(tied).title == "An effect is missing; these data leave 2 candidates"
        assert "equally" not in summary_of(tied)
    certain = document(VAGUE, verdict="ambiguous", reason="kind_certain", findings=dry(0.97, 0.03))
    assert statements_of(certain).title == "Missing: dry friction between mass and ground; its law is open"
    assert statements_of(document(VAGUE)).title == "An effect is missing; no known law fits"
    assert statements_of(document(VAGUE, findings=dry(0.9))).title == (
        "An effect is missing, probably dry friction between mass and ground"
    )


def dry(*probabilities):
    """Findings of dry friction and then of an elastic force, with these probabilities."""
    laws = [{"effect": "coulomb_friction", "probability": 0.4, "parameters": {}}]
    return [
        {
            "place": ["mass", "ground"],
            "place_probability": 1.0,
            "kind": k,
            "kind_probability": p,
            "laws": laws,
        }
        for k, p in zip(("dry_friction", "elastic"), probabilities, strict=False)
    ]


def test_every_failed_gate_has_an_advice():
    assert set(ADVICE) == {g.name for g in gates_of(SEEN)}


def test_values_are_told_in_the_units_of_engineers():
    assert plain_value(0.000790123456, "m") == "0.7901 mm" and plain_value(2e6, "N/m") == "2 MN/m"
    assert plain_value(1293.0, "N s/m") == "1293 N s/m" and plain_value(None, "m") == "unknown m"


#: friction that takes the error from 30 to 7 %, whose level is known to a factor of 20 only
VAGUE = replace(SEEN, effects=(EffectEvidence("coulomb_friction at mass-ground", share=0.4, spread=3.0),))


def test_an_unnamed_effect_is_told_with_how_far_it_goes_and_the_gate_it_fails():
    said = summary_of(document(VAGUE))
    assert (
        "With the best candidate, Coulomb friction between mass and ground, the error in travel falls from 30.0 % to 7.0 %."
        in said
    )
    assert "is not named because its values are uncertain by 95 % (less than 90 % needed)." in said
    nothing = summary_of(document(replace(SEEN, effects=(), after=SEEN.refit, richest=())))
    assert "No known effect reduces the held-out error by enough to be kept." in nothing


def tried(explained, moved=0.2, errors=5.0, confirmed=0.9):
    gates = [g.to_dict() for g in table_gates(explained, moved, errors, confirmed)]
    return {"between": ["mass", "ground"], "over": "elongation", "explained": explained, "gates": gates}


def test_a_table_that_is_not_stated_is_told_with_its_figure_and_the_reason():
    said = summary_of(document(VAGUE, best_table=tried(0.93, errors=1.2)))
    assert "removes 93 % of the squared held-out error beyond noise" in said
    assert "but its better prediction may be chance" in said
    assert "depend on time" not in said and "half" not in said
    said = summary_of(document(VAGUE, best_table=tried(0.68, confirmed=0.14)))
    assert (
        "removes 68 % of the squared held-out error beyond noise, but it leaves 86 % of the squared error on the test records (at most 50 %)"
        in said
    )
    said = summary_of(document(VAGUE, best_table=tried(0.3)))
    assert "removes 30 % of the squared held-out error beyond noise (needed 50 %)." in said
    assert "depend on time, on its own past, on an input" in said


def test_so_is_one_that_the_reported_records_do_not_bear_out():
    table = {
        "between": ["mass", "ground"],
        "over": "both",
        "element": "missing_force",
        "explained": 0.6,
        "nearest": [{"effect": "gas_spring", "share": 0.88}],
        "shares": {"elongation": 0.97, "rate": 0.05},
    }
    closed = {"held_out": document(VAGUE)["gap"]["held_out"], "closed": -0.5}
    said = summary_of(document(VAGUE, tabulated=table, best_table=tried(0.6)))
    assert "removes 60 % of the squared held-out error beyond noise" in said and "gas spring 88 %" in said
    assert "distance alone 97 %, rate alone 5 %" in said
    assert NOT_BORNE_OUT not in said
    refuted = statements_of(document(VAGUE, tabulated=table, gap=closed))
    assert NOT_BORNE_OUT in refuted.text and "repeat the test" in refuted.text
    assert not refuted.title.startswith("Missing: a force")


def test_ambiguous_rivals_have_their_places_and_what_they_leave():
    rivals = [
        {"effects": [name], "where": [["mass", "ground"]], "excess": excess, "why_not": ""}
        for name, excess in (("coulomb_friction", 0.01), ("hysteresis", 0.012))
    ]
    abreast = replace(SEEN, indistinguishable=("hysteresis at mass-ground",), rival_loss=1.0)
    said = summary_of(document(abreast, alternatives=rivals, next_experiment={"do": "a sine"}))
    assert "between 2 candidates: Coulomb friction between mass and ground (leaves 1.0 %" in said
    assert said.endswith("Next: run the test in next_experiment.csv.")
    alone = summary_of(document(abreast, alternatives=rivals[:1]))
    assert "but 1 other law predicts as well" in alone
    pairs = [
        r | {"effects": ["backlash", *r["effects"]], "where": [["ground", "mass"], *r["where"]]}
        for r in rivals
    ]
    told = statements_of(document(abreast, alternatives=pairs))
    assert told.title == "Probably missing: backlash between ground and mass; a further effect is open"
    assert (
        "contains backlash between ground and mass. They differ in the further effect: Coulomb friction"
        in told.text
    )


@pytest.mark.parametrize(
    ("change", "reason", "words"),
    [
        ({"refit": (0.021,)}, "immaterial", "the error beyond noise is at most 0.6 % of the"),
        ({"refit": (0.05,), "envelope": (0.06,)}, "small_effects", "leave up to 6.0 %"),
        ({"refit": (0.06,), "noise": (0.05,), "envelope": (0.01,)}, "noise", "the error in travel beyond noise is 3.3 % (noise 5.0 %)"),
    ],
)  # fmt: skip
def test_why_nothing_is_missing_is_told_with_its_figures(change, reason, words):
    base = {"before": (0.2,), "effects": (), "after": (0.02,), "richest": ()}
    quiet = replace(SEEN, **(base | change))
    spring = {"prior": 100.0, "value": 112.0, "low": 111.0, "high": 113.0, "unit": "N/m"}
    d = document(quiet, parameters={"k.stiffness": spring})
    assert (d["verdict"], d["reason"]) == ("parameters_only", reason)
    said = summary_of(d)
    assert words in said
    assert "k.stiffness from 100 to 112 N/m (+12.0%)" in said


@pytest.mark.parametrize("reason", get_args(Reason))
@pytest.mark.parametrize("verdict", ["no_discrepancy", "parameters_only"])
def test_every_reason_of_a_verdict_has_words(verdict, reason):
    """An evidence that ends in `closed_by_small` broke off, since no test had one."""
    closing = replace(SEEN, richest_share=0.042)
    said = summary_of(document(closing, verdict=verdict, reason=reason, effects=[]))
    assert said.endswith(".")
    assert ("Effects of at most 4.2 % of the force" in said) == (reason == "closed_by_small")


def test_a_small_effect_is_told_with_its_share_or_the_gate_it_fails():
    small = replace(SEEN, effects=(replace(SEEN.effects[0], share=0.02),), refit=(0.08,), envelope=(0.085,))
    small = replace(small, richest_share=0.02)
    said = summary_of(document(small))
    assert "Too small to be named: Coulomb friction between mass and ground (level 3 N), 2.0 %" in said


def test_a_bound_of_the_noise_is_told():
    bounded = replace(VAGUE, noise_known=(False,))
    assert "only an upper bound on the noise of travel (at most 2.0 %)" in summary_of(document(bounded))


def test_a_unit_whose_sensor_has_another_zero():
    d = document(replace(SEEN, effects=(), after=SEEN.refit, richest=()), constant={"travel": 0.9})
    said = summary_of(d, is_fmu=True)
    assert (
        "A constant offset is 90 % of the squared error in travel" in said
        and "inside an FMU are hidden" in said
    )


def test_a_figure_that_is_not_finite_does_not_lose_the_result():
    """JSON has null for such a figure; the summary is written all the same."""

    def blanked(node):
        if isinstance(node, dict):
            return {k: v if k in ("criteria", "count") else blanked(v) for k, v in node.items()}
        if isinstance(node, list | tuple):
            return [blanked(v) for v in node]
        return None if isinstance(node, float) else node

    for made in (document(), document(VAGUE, best_table=tried(0.3)), document(replace(SEEN, refit=(0.021,)))):
        assert summary_of(blanked(made))
    assert plain_number(None) == "unknown"
    assert failures([gate("g", float("nan"), ">", 1.0, "").to_dict() | {"value": None}]) == (
        "g is unknown (needed above 1)"
    )


@pytest.mark.parametrize(("probability", "is_told"), [(0.95, True), (0.33, True), (0.1, False)])
def test_an_unnamed_effect_has_a_test_on_the_rig_for_its_likeliest_kind(probability, is_told):
    told = document(VAGUE, findings=dry(probability))
    steps = statements_of(told).next_steps
    assert any("two or three constant speeds" in step for step in steps) is is_told
    assert not any(
        "constant speeds" in step for step in statements_of(document(findings=dry(0.95))).next_steps
    )


def test_every_kind_has_a_test_on_the_rig():
    assert set(TESTS) == set(KINDS) - {"other"}


def test_asymmetric_friction_is_told_as_friction_and_an_offset_too():
    sides = {"extension": 3.0, "compression": 2.0}
    law = FRICTION | {
        "effect": "asymmetric_friction",
        "parameters": {k: {"value": v, "low": v, "high": v, "unit": "N"} for k, v in sides.items()},
    }
    assert "Coulomb friction of 2.5 N and a constant force of 0.5 N are the same force" in summary_of(
        document(effects=[law])
    )
    assert "the same force" not in summary_of(document())
