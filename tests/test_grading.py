"""The diagnosis' benchmark: the grades of answers, and the continuation of a stopped run."""

import grading
import pytest
from program import save_json

pytestmark = pytest.mark.tools

GROUND = ["mass", "ground"]


def said(verdict, *effects, confidence=0.999, **more):
    shared = {"confidence": confidence, "parameters": {}}
    places = ({("channel" if isinstance(p, str) else "between"): p} for _, p in effects)
    names = [
        {"effect": e} | p | shared for (e, _), p in zip(effects, places, strict=True)
    ]
    d = {
        "verdict": verdict,
        "effects": names,
        "alternatives": [],
        "parameters": {},
        "gap": {"closed": None},
    }
    return {
        "suite": "s",
        "name": "n",
        "family": "f",
        "kind": "k",
        "seconds": 1.0,
        "diagnosis": d,
        **more,
    }


FRICTION = [["coulomb_friction", GROUND]]


@pytest.mark.parametrize(
    "answer, row, grade",
    [
        (FRICTION, said("missing_effect", ("coulomb_friction", ["ground", "mass"])), "right"),
        (FRICTION, said("missing_effect", ("coulomb_friction", ["mass", "base"])), "wrong"),
        (FRICTION, said("missing_effect", ("sensor_delay", "mass_position")), "wrong"),
        (FRICTION, said("parameters_only"), "missed"),
        (FRICTION, said("ambiguous"), "missed"),
        ([["backlash", None]], said("missing_effect", ("backlash", ["a", "b"])), "right"),
        ([], said("no_discrepancy"), "right"),
        ([], said("unknown_effect"), "missed"),
        ([], said("missing_effect", ("cubic_stiffness", GROUND)), "wrong"),
        ("unknown", said("unknown_effect"), "right"),
        ("unknown", said("parameters_only"), "missed"),
        ("unknown", said("missing_effect", ("gas_spring", GROUND)), "wrong"),
        ({"needs": [["coulomb_friction", "stribeck_friction"]]}, said("x", ("stribeck_friction", GROUND)), "right"),
        ({"needs": ["hysteresis"], "allows": ["backlash"]}, said("x", ("backlash", GROUND)), "wrong"),
        ({"needs": ["hysteresis"], "allows": ["backlash"]}, said("x"), "missed"),
        ({"needs": ["cubic_stiffness"]}, said("x", ("cubic_stiffness", GROUND), ("cogging_force", GROUND)), "wrong"),
    ],
)  # fmt: skip
def test_what_is_right_wrong_and_missed(answer, row, grade):
    assert grading.graded({**row, "answer": answer}) == grade


def test_a_nuisance_that_is_really_there_may_be_named_but_not_instead():
    truth = {
        "hidden": [],
        "nuisances": [{"type": "cubic_stiffness", "between": GROUND, "stiffness": 1.0}],
    }
    both = said(
        "missing_effect", ("coulomb_friction", GROUND), ("cubic_stiffness", GROUND)
    )
    only = said("missing_effect", ("cubic_stiffness", GROUND))
    assert grading.graded({**both, "answer": FRICTION, "truth": truth}) == "right"
    assert grading.graded({**both, "answer": FRICTION, "truth": {}}) == "wrong"
    assert grading.graded({**only, "answer": FRICTION, "truth": truth}) == "wrong"


def test_stated_confidence_is_held_against_what_was_right():
    places = [GROUND] * 8 + [["x", "y"]] * 2
    rows = [
        said("m", ("coulomb_friction", p), confidence=0.93, answer=FRICTION)
        for p in places
    ]
    (curve,) = grading.reliability(rows)
    assert (curve["names"], curve["right"], curve["stated"]) == (
        10,
        0.8,
        pytest.approx(0.93),
    )
    assert (curve["least"], curve["most"]) == pytest.approx((0.490, 0.943), abs=0.001)


def test_cases_are_items_of_the_engine(tmp_path, monkeypatch, capsys):
    import diagnose

    rigs = tmp_path / "rigs"
    truth = {f"rig_{i:03d}": {"kind": "shaken", "answer": FRICTION} for i in range(3)}
    for name in truth:
        (rigs / name).mkdir(parents=True)
    save_json(tmp_path / "rigs.truth.json", truth)
    looked = []

    def fake(files, out):
        name = files.model.parent.name
        looked.append(name)
        if name == "rig_001":
            while True:  # for ever: only its processor time ends it
                sum(range(1000))
        if name == "rig_002" and looked.count("rig_002") == 1:
            raise SystemExit  # it is stopped here
        return said("missing_effect", ("coulomb_friction", GROUND))["diagnosis"]

    monkeypatch.setattr(diagnose, "command", fake)
    cases = list(diagnose.in_folder(rigs, []))
    with pytest.raises(SystemExit):
        diagnose.run_all(cases, tmp_path / "out", 1, 0.1)
    rows = diagnose.run_all(cases, tmp_path / "out", 1, 0.1)
    assert looked == ["rig_000", "rig_001", "rig_002", "rig_002"]
    assert "2 of 3 are there already" in capsys.readouterr().out
    assert [grading.graded(r) for r in rows] == ["right", "missed", "right"] and rows[
        1
    ]["timed_out"]
    assert sorted(r["name"] for r in diagnose.read([tmp_path / "out"])) == sorted(truth)
