"""The table of criteria: evidence made by hand, every verdict, every gate that can fail, and the completed model."""

from dataclasses import replace
from types import SimpleNamespace

import ablation
import numpy as np
import pytest

from isd_gym.diagnosis._result_builder import ResultBuilder, closed
from isd_gym.diagnosis._selection.contradictions import repeats
from isd_gym.diagnosis._selection.criteria import CRITERIA, Criteria, table
from isd_gym.diagnosis._selection.free_force import FreeForce
from isd_gym.diagnosis._selection.held_out import HeldOutScore
from isd_gym.diagnosis._verdict.evidence import EffectEvidence, Evidence
from isd_gym.diagnosis._verdict.gates import confidence, decide, gates_of, table_gates
from isd_gym.diagnosis._verdict.grades import MISTAKEN, grade, share_mistaken
from isd_gym.physics.elements import TYPES, Motion

SEEN = {"share": 0.4, "spread": 0.05, "removed": 0.995, "width": 0.3, "beyond_small": True}
FRICTION = EffectEvidence("coulomb_friction at mass-ground", **SEEN)
GAIN = EffectEvidence("sensor_gain at position", share=0.2, spread=0.05, sensor=True, fault=0.1)

#: friction that explains a gap of 30 % down to noise of 2 %, with no rival in sight
GOOD = Evidence(
    channels=("position",), before=(0.4,), refit=(0.3,), after=(0.021,), richest=(0.021,), richest_share=0.4,
    noise=(0.02,), noise_known=(True,), envelope=(0.03,), effects=(FRICTION,),
    elpd_diff=2000.0, elpd_dse=200.0, explained=0.995, rival_loss=50.0, force_loss=50.0,
)  # fmt: skip


def test_the_stored_evidence_of_rigs_gives_their_verdicts():
    rows = [row for row in ablation.rows_of(()) if row["diagnosis"]["reason"] != "kind_certain"]
    assert len(rows) > 80
    for r in map(ablation.Replay.of, rows):
        assert r.outcome(r.criteria)[0] == r.row["diagnosis"]["verdict"], r.row["name"]


def test_a_name_passes_every_gate():
    d = decide(GOOD)
    assert d.verdict == "missing_effect"
    assert d.gates and all(g.passed for g in d.gates)


@pytest.mark.parametrize(
    ("refit", "after", "share"),
    [(0.8, 0.2, 0.9375), (30.0, 1.03, None), (30.0, 0.2, None), (1.2, 1.8, -1.25)],
)
def test_a_share_of_the_gap_is_not_stated_where_a_constant_errs_less(refit, after, share):
    rows = {"refit": refit, "after": after, "noise_floor": 0.0}
    assert closed({k: np.array([v]) for k, v in rows.items()}) == (share and pytest.approx(share))


@pytest.mark.parametrize(
    ("gate", "change", "verdict"),
    [
        ("predicts better", {"elpd_diff": 3.0, "elpd_dse": 1.0}, "unknown_effect"),
        ("predicts better", {"elpd_dse": 1500.0}, "unknown_effect"),
        ("material", {"effects": (replace(FRICTION, share=0.02, removed=0.7),)}, "unknown_effect"),
        ("adequate", {"explained": 0.45, "after": (0.2,), "richest": (0.2,)}, "unknown_effect"),
        ("adequate", {"nominal_removed": -0.1}, "unknown_effect"),
        ("adequate", {"largest_left": 14.4}, "unknown_effect"),
        ("determined", {"effects": (replace(FRICTION, spread=3.0),)}, "unknown_effect"),
        ("determined", {"effects": (replace(FRICTION, contradiction="beyond its reach"),)}, "unknown_effect"),
        (
            "distinguishable",
            {"indistinguishable": ("hysteresis at mass-ground",), "rival_loss": 1.0},
            "ambiguous",
        ),
        ("lack of fit", {"lack_of_fit": 0.8}, "unknown_effect"),
        ("probable", {"probability": 0.4}, "unknown_effect"),
        ("confirmed", {"test_explained": 0.4, "test_gap": 1.2}, "unknown_effect"),
        ("sensor", {"effects": (GAIN,), "force_loss": 1.2}, "ambiguous"),
        ("sensor", {"effects": (replace(GAIN, fault=0.4),), "force_loss": 10.0}, "ambiguous"),
    ],
)
def test_each_gate_can_fail_and_the_verdict_follows(gate, change, verdict):
    d = decide(replace(GOOD, **change))
    assert [g.name for g in d.gates if not g.passed] == [gate]
    assert d.verdict == verdict


def test_test_records_without_a_gap_neither_confirm_a_name_nor_take_it_away():
    silent = replace(GOOD, test_explained=-0.5, test_gap=0.8)
    assert decide(silent).verdict == "missing_effect"
    assert grade(confidence(silent)) == "probable" and grade(confidence(GOOD)) == "certain"


@pytest.mark.parametrize("changes", [{"probability": 0.4}, {"refit": (0.08,), "envelope": (0.09,)}])
def test_an_effect_whose_law_alone_is_open_is_told_as_open(changes):
    rival = {"indistinguishable": ("hysteresis at mass-ground",), "rival_loss": 1.0}
    assert decide(replace(GOOD, **rival, **changes)).verdict == "ambiguous"


def test_what_is_left_is_held_against_what_small_effects_make_of_the_candidate_itself():
    left = replace(GOOD, explained=0.45, after=(0.12,), richest=(0.12,))
    # driven harder than what was fitted to, held-out records show more of what is small: then the fitted ones tell
    harder = replace(left, explained=0.3, envelope_after=(0.1,))
    assert decide(harder).verdict == "unknown_effect"
    assert decide(replace(harder, training_explained=0.99)).verdict == "missing_effect"
    assert decide(replace(harder, training_explained=0.87)).verdict == "unknown_effect"
    known = replace(harder, training_explained=0.99, envelope_after=(0.03,))
    assert decide(known).verdict == "unknown_effect"


def test_a_small_force_that_closes_a_wide_gap_is_named_and_one_that_closes_a_narrow_one_is_told():
    small = (replace(FRICTION, share=0.02),)
    assert decide(replace(GOOD, effects=small)).verdict == "missing_effect"
    # in a gap of 8 % the envelope of small effects decides
    more = (replace(FRICTION, share=0.03, width=0.08),)
    small = (replace(FRICTION, share=0.02, width=0.08),)
    assert decide(replace(GOOD, effects=more, refit=(0.08,), richest_share=0.03)).verdict == "missing_effect"
    told = replace(GOOD, effects=small, refit=(0.08,), richest_share=0.02)
    assert decide(told).verdict == "parameters_only"
    small = (replace(small[0], beyond_small=False),)
    narrow = replace(GOOD, effects=small, refit=(0.08,), richest_share=0.02, envelope=(0.085,))
    d = decide(narrow)
    assert d.verdict == "parameters_only"
    assert d.small
    assert [g.name for g in d.gates if not g.passed] == ["material"]


def test_a_name_of_any_number_of_effects_explains_half():
    rest = {"after": (0.2,), "richest": (0.2,), "test_explained": 0.8}
    several = (FRICTION, replace(FRICTION, label="series_compliance at mass-ground"))
    for effects in (several[:1], several):
        part = replace(GOOD, effects=effects, explained=0.51, **rest)
        assert decide(part).verdict == "missing_effect"
        assert [g.name for g in decide(replace(part, explained=0.49)).gates if not g.passed] == ["adequate"]


@pytest.mark.parametrize(
    ("explained", "law", "kind"), [(0.95, 0.94, 0.95), (0.8, 0.64, 0.95), (0.6, 0.64, 0.64)]
)
def test_a_name_that_leaves_a_part_is_less_probable(explained, law, kind):
    part = replace(GOOD, explained=explained)
    stated = {level: 1.0 - share_mistaken(level, part) for level in ("law", "kind")}
    assert stated == pytest.approx({"law": law, "kind": kind})


@pytest.mark.parametrize(("gap", "verdict"), [(0.08, "no_discrepancy"), (0.12, "unknown_effect")])
def test_a_wide_gap_of_the_training_records_is_no_agreement(gap, verdict):
    """A cart erred by 18 % while it was fitted, and by 3 % on held-out records, in which it moved little."""
    small = replace(FRICTION, share=0.02, removed=0.7)
    quiet = replace(GOOD, before=(0.03,), refit=(0.03,), after=(0.025,), richest=(0.025,), effects=(small,))
    assert decide(replace(quiet, training_refit=(gap,), training_after=(0.1,))).verdict == verdict


def test_agreement_needs_a_noise_that_is_known_or_a_small_error():
    quiet = replace(GOOD, before=(0.021,), refit=(0.02,), after=(0.02,), effects=(), richest=())
    assert decide(quiet).verdict == "no_discrepancy"
    assert decide(replace(quiet, before=(0.2,))).verdict == "parameters_only"
    training = {"explained": 0.3, "training_refit": (0.08,), "training_after": (0.03,)}  # alone has a gap
    driven = replace(quiet, effects=(FRICTION,), **training)
    assert decide(driven).verdict == "no_discrepancy"
    assert decide(replace(driven, training_explained=0.8)).verdict == "unknown_effect"
    # 99.7 % of the signal left and called noise, of which nothing is known beforehand
    broad = replace(quiet, refit=(0.997,), noise=(0.997,), noise_known=(False,))
    assert decide(broad).verdict == "unknown_effect"


def test_a_name_makes_nothing_worse_that_it_was_fitted_to():
    # nine tenths of the held-out gap, by chance, and the fitted records worse than before
    lucky = replace(GOOD, training_refit=(0.3,), training_after=(0.4,), training_explained=-0.9)
    d = decide(lucky)
    assert d.verdict == "unknown_effect"
    assert [g.name for g in d.gates if not g.passed] == ["adequate"]
    assert decide(replace(lucky, training_after=(0.03,), training_explained=0.97)).verdict == "missing_effect"


def test_a_channel_that_friction_lets_drift_says_nothing_against_a_name():
    rows = ("channels", "before", "refit", "after", "noise", "noise_known", "envelope", "richest")
    four = {name: 4 * getattr(GOOD, name) for name in rows}
    training = {"training_refit": (0.05, 0.05, 0.04, 0.3), "training_after": (0.02, 0.02, 0.02, 0.6)}
    drifts = replace(GOOD, **four | training)
    assert decide(drifts).verdict == "missing_effect"
    assert decide(replace(drifts, training_after=(0.06, 0.05, 0.05, 0.6))).verdict == "unknown_effect"


def test_what_noise_may_hide_is_no_finding():
    errors = {"before": (0.16,), "refit": (0.051,), "after": (0.051,), "noise": (0.041,)}
    clean = replace(GOOD, envelope=(0.01,), effects=(), **errors)
    assert decide(replace(clean, richest=())).verdict == "parameters_only"
    assert decide(replace(clean, richest=(), refit=(0.071,), after=(0.071,))).verdict == "unknown_effect"
    # an effect with a gain is judged, however large the noise
    rest = {"elpd_diff": 900.0, "explained": 0.6, "lack_of_fit": 0.7}
    small = replace(clean, effects=(FRICTION,), after=(0.041,), **rest)
    assert decide(small).verdict == "unknown_effect"


def test_a_name_that_small_effects_excuse_is_stated_with_less_confidence():
    held = ({"explained": 0.95}, {"explained": 0.7}, {"test_explained": 0.8})
    whole, part, unconfirmed = (confidence(replace(GOOD, **e, probability=0.9)) for e in held)
    assert whole == pytest.approx(0.9 * (1.0 - MISTAKEN["law"]))
    assert unconfirmed == part == pytest.approx(0.9 * (1.0 - MISTAKEN["partly"])) and part < whole


def test_criteria_are_arguments_and_say_why_they_are():
    strict = Criteria(share=0.5, alone_removes=0.999)
    assert decide(replace(GOOD, explained=0.89, richest_share=0.9), strict).verdict == "unknown_effect"
    rows = table()
    assert {r["id"] for r in rows} == set(Criteria.__dataclass_fields__)
    assert all(r["unit"] and r["why"] and r["source"] for r in rows)
    assert {g.name for g in gates_of(GOOD, CRITERIA)} >= {"material", "distinguishable", "sensor"}


def test_once_up_and_down_where_the_motion_hardly_goes_is_no_repetition():
    wave = TYPES["cogging_force"](name="wave", where=("mass", "base"), amplitude=1.0, pitch=2.0, phase=0.0)
    rare = np.concatenate([np.random.default_rng(0).uniform(-1.0, 1.0, 1000), [-2.0, 2.0]])
    often = np.linspace(-2.0, 2.0, 1000)
    assert not repeats(wave, Motion(rare, 0 * rare, 0 * rare))  # two periods end to end
    assert repeats(wave, Motion(often, 0 * often, 0 * often))


def test_a_table_that_explains_the_validation_records_alone_is_not_confirmed():
    def score(nrmse, test_nrmse):
        errors = np.array([nrmse]), np.array([test_nrmse])
        none = None
        return HeldOutScore(none, nrmse**2, none, none, *errors, errors[0], test_nrmse**2, none)

    refit, table = score(0.5, 0.4), score(0.1, 0.39)
    confirmed = table.explained_on_test(refit, np.array([0.01]), 1e-4)
    assert confirmed == pytest.approx((0.4**2 - 0.39**2) / (0.4**2 - 0.01**2))
    failed = [g.name for g in table_gates(0.96, 0.49, 8.0, confirmed) if not g.passed]
    assert failed == ["confirmed"]


def test_the_limit_of_a_doubtful_sensor_is_the_one_it_was_held_against():
    def forces_first(fault):
        return gates_of(replace(GOOD, effects=(replace(GAIN, fault=fault),), force_loss=10.0))[-1]

    assert (forces_first(0.1).passed, forces_first(0.1).limit) == (True, 4.0)
    assert (forces_first(0.4).passed, forces_first(0.4).limit) == (False, 20.0)


REFITTED, LAW, TABLE = (SimpleNamespace(name=n, hypotheses=(n,), well_formed=lambda: True) for n in "rlt")


def completes(validation, refit, after, table=None, law=LAW):
    """Whether a law completes a model, by mean squares on validation records and errors on test records."""
    score = lambda c: SimpleNamespace(mean_square=validation[c.name])  # noqa: E731
    scores = SimpleNamespace(refitted=REFITTED, foremost=law, score=score)
    errors = {"refit": np.array([refit]), "after": np.array([after])}
    search = SimpleNamespace(criteria=CRITERIA)
    builder = SimpleNamespace(scores=scores, search=search, _errors=lambda c: errors)
    return ResultBuilder._is_supported(builder, FreeForce(candidate=table))


@pytest.mark.parametrize(
    ("validation", "test", "answer"),
    [
        ((4.0, 2.0), (0.3, 0.2), True),
        ((4.0, 4.1), (0.3, 0.2), False),  # errs more on validation records
        ((4.0, 2.0), (0.3, 0.31), False),  # errs more on test records
        # sqrt(0.3^2 - 0.299^2) = 2.4 % of the deviation: nobody would notice
        ((4.0, 2.0), (0.3, 0.299), False),
    ],
)
def test_a_law_completes_a_model_that_it_improves_on_validation_and_on_test_records(validation, test, answer):
    assert completes(dict(zip("rl", validation, strict=True)), *test) == answer


def test_the_table_of_a_free_force_and_the_law_compete_on_validation_records():
    assert completes({"r": 4.0, "l": 2.0, "t": 2.5}, 0.3, 0.2, TABLE)
    assert not completes({"r": 4.0, "l": 2.0, "t": 1.5}, 0.3, 0.2, TABLE)
    # a law without a candidate, or with contradictory values, completes nothing
    nobody = SimpleNamespace(name="l", hypotheses=(), well_formed=lambda: True)
    odd = SimpleNamespace(name="l", hypotheses=("l",), well_formed=lambda: False)
    assert not completes({"r": 4.0, "l": 2.0}, 0.3, 0.2, law=nobody)
    assert not completes({"r": 4.0, "l": 2.0}, 0.3, 0.2, law=odd)
