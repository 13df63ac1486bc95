"""Before the test: what a plan says of rigs whose answers are known from physics, and that the diagnosis agrees."""

import json
import math

import builders
import numpy as np
import pytest
import typer
from builders import channel, damper, friction, spring
from isd_gym.contrib.forecast.command import command
from program import refused
from typer.testing import CliRunner

from isd_gym._common.errors import InputError
from isd_gym.contrib.forecast import plan, read_rivals
from isd_gym.contrib.forecast.planning import (
    KINDS,
    Excitation,
    Limits,
    Rig,
    design_test,
    infer_rig,
    list_excitations,
    make_excitation,
    make_record,
)
from isd_gym.diagnosis import Criteria, diagnose
from isd_gym.physics.network import Network
from isd_gym.physics.simulate import simulate
from isd_gym.records.data import Table, read_table
from isd_gym.records.schemas import load

MASS = builders.model(
    "shaken-mass",
    [spring("table", "shaker", 9000.0), damper("table", "shaker", 45.0)],
    [channel("stroke", "displacement", "shaker", unit="mm")],
    [channel("acceleration", "acceleration", "table")],
    masses={"table": 12.0},
    uncertainty={"table.mass": 0.03, "spring.stiffness": 0.1, "damper.damping": 0.2},
)
SHORT = Rig({"stroke": Limits(0.01)}, (1.0, 7.0), 8.0, 0.008)
#: criteria in which noise alone counts
NOISE_ALONE = Criteria(material=1e-9, share=1e-9, wide_gap=1e9, determined=1e9)


def foreseen(model=MASS, **choices):
    return plan(model, **({"rig": SHORT, "add_sensors": False} | choices))


def level(p, what="smallest"):
    (e,) = p.effects
    assert e.status == "named", e
    return float(getattr(e, what)[e.varied[0]].value)


FRICTION = {"only": ["coulomb_friction", "ground"], "criteria": NOISE_ALONE}


def test_twice_the_noise_asks_for_twice_the_size():
    one, two = (level(foreseen(noise={"acceleration": s}, **FRICTION), "seen") for s in (0.5, 1.0))
    assert two / one == pytest.approx(2.0, rel=0.1)


@pytest.mark.slow
def test_a_record_of_four_times_the_length_halves_the_size():
    record = make_record(Network.load(MASS), SHORT, make_excitation(Network.load(MASS), SHORT))
    stroke = 1e3 * record.inputs["stroke"]
    sizes = []
    for times in (4, 16):
        x = np.tile(stroke[:-1], times)
        table = Table(SHORT.step * np.arange(len(x)), {"stroke": x}, "planned", {"stroke": "mm"})
        sizes.append(level(foreseen(data=[table], rig=None, noise={"acceleration": 0.5}, **FRICTION), "seen"))
    assert sizes[0] / sizes[1] == pytest.approx(2.0, rel=0.15)


def test_what_moves_no_sensor_is_unseen_and_the_sensor_that_would_see_it_is_named():
    """Two oscillators on one shaker do not feel each other: of the second one nothing is measured."""
    model = json.loads(json.dumps(MASS))
    model["masses"]["other"] = 5.0
    model["elements"] += [spring("other", "shaker", 4e3, "beside"), damper("other", "shaker", 30.0, "oil")]
    p = plan(model, rig=SHORT, only=["cubic_stiffness", "shaker"])
    status = {e.where: e.status for e in p.effects}
    assert status["table", "shaker"] == "named"
    assert status["other", "shaker"] == "unseen"
    told = {s.name: s.told for s in p.sensors}
    assert told["other_acceleration"] > 0  # so would the force at the shaker, which carries both
    assert told["table_shaker_travel"] == 0


@pytest.mark.slow
def test_the_diagnosis_names_what_the_plan_says_it_does():
    """Half as much again as the planned size is named, two thirds of it are not."""
    p = plan(MASS, only=["coulomb_friction", "ground"], add_sensors=False)
    network, record = Network.load(MASS), p.records[0]
    rng = np.random.default_rng(5)
    for factor, named in ((1.5, True), (1 / 1.5, False)):
        rub = friction("table", "ground", factor * level(p))
        stroke = 1e3 * record.inputs["stroke"]
        measured = simulate(network.with_element(rub), record.time, {"stroke": stroke})
        y = measured["acceleration"] + p.noise["acceleration"] * rng.standard_normal(len(record))
        table = Table(record.time, {"stroke": stroke, "acceleration": y}, "planned")
        assert (diagnose([table], p.network).verdict == "missing_effect") is named


@pytest.mark.parametrize("kind", KINDS)
def test_an_excitation_keeps_within_the_rigs_limits(kind):
    network = Network.load("quarter-car-isd")
    rig = Rig({"road": Limits(0.02, 0.3), "current": Limits(4.0)}, (0.5, 15.0), 10.0, 2e-3)
    played = Excitation(kind, 0.5, 15.0, ("road", "current")).signals(network, rig)
    road, current = played["road"], played["current"]
    assert np.abs(road).max() <= 0.02 * (1 + 1e-9)
    assert np.abs(np.diff(road)).max() / rig.step <= 0.3 * (1 + 1e-9)
    assert np.abs(current).max() == pytest.approx(4.0)
    assert road[0] == road[-1] == 0.0
    power = np.abs(np.fft.rfft(np.gradient(road, rig.step))) ** 2
    f = np.fft.rfftfreq(len(road), rig.step)
    assert power[(f > 0.2) & (f < 40)].sum() > 0.97 * power.sum()


def test_limits_come_from_the_data_where_nobody_states_them():
    network = Network.load(MASS)
    record = make_record(network, SHORT, Excitation("sweep", 1.0, 5.0, ("stroke",), 0.5))
    rig = infer_rig(network, [record])
    assert rig.limits["stroke"].reach == pytest.approx(np.abs(record.inputs["stroke"]).max())
    assert rig.length == pytest.approx(8.0, rel=0.01)
    assert 0.5 < rig.band[0] < 1.5
    assert 3.0 < rig.band[1] < 7.0
    every = list(list_excitations(network, rig))
    assert {e.kind for e in every} == set(KINDS)


@pytest.mark.parametrize(
    ("choice", "word"),
    [
        ({"band": (5.0, 1.0)}, "band"),
        ({"length": math.nan}, "length"),
        ({"rate": 10.0, "band": (1.0, 7.0)}, "sampling rate"),
        ({"limits": {"stork": Limits(1.0)}}, "stork"),
    ],
)
def test_a_rig_that_cannot_be_is_refused_with_one_line(choice, word):
    refused(word, infer_rig, Network.load(MASS), **choice)


def run(*words):
    app = typer.Typer()
    app.command()(command)
    return CliRunner().invoke(app, list(words))


QUICK = "--limit stroke=10mm --band 1:7 --length 8 --rate 125 --only cubic_stiffness --no-sensors"


def test_the_command_writes_the_plan_its_page_and_a_test_that_a_rig_can_play(tmp_path):
    model = tmp_path / "model.json"
    model.write_text(json.dumps(MASS))
    out, html, test = (tmp_path / name for name in ("plan.json", "plan.html", "test.csv"))
    made = run(str(model), *QUICK.split(), "--out", str(out), "--html", str(html), "--design", str(test))
    assert made.exit_code == 0, made.output
    said = json.loads(out.read_text())
    pytest.importorskip("jsonschema").validate(said, load("isd-plan/1"))
    assert {e["status"] for e in said["effects"]} == {"named"}
    assert len(said["matrix"]) == len(said["effects"])
    assert "<svg" in html.read_text()
    assert test.read_text().startswith("time,stroke [mm]\n")
    table = read_table(test, expected={"stroke": "mm"})
    assert np.abs(table["stroke"]).max() <= 10.0 + 1e-9
    played = simulate(Network.load(MASS), table.time, {"stroke": table["stroke"]})
    assert played["acceleration"].std() > 0.1


@pytest.mark.parametrize(
    "words",
    [
        ("--limit", "stroke"),
        ("--limit", "road=3"),
        ("--limit", "stroke=5V"),
        ("--band", "7"),
        ("--noise", "acceleration=-1"),
        ("--only", "frictoin"),
        ("--excitation", "noise"),
        ("--after", "there.json"),
        ("--length", "0.01"),
    ],
)
def test_bad_options_are_answered_with_one_line_and_nothing_is_written(tmp_path, words):
    model = tmp_path / "model.json"
    model.write_text(json.dumps(MASS))
    made = run(str(model), *words, "--out", str(tmp_path / "plan.json"))
    assert isinstance(made.exception, InputError)
    assert not (tmp_path / "plan.json").exists()


def rivals(levels):
    """What a diagnosis leaves that cannot tell friction from damping against the ground."""
    common = {"where": [["table", "ground"]], "why_not": "", "options": [{}]}
    laws = {"coulomb_friction": {"level": levels[0]}, "linear_damping": {"damping": levels[1]}}
    stiffness = {"value": 9100.0, "low": 9000.0, "high": 9200.0, "unit": "N/m"}
    return {
        "schema": "isd-diagnosis/1",
        "verdict": "ambiguous",
        "parameters": {"spring.stiffness": stiffness},
        "alternatives": [{"effects": [k], "values": [v], **common} for k, v in laws.items()],
    }


@pytest.mark.parametrize(
    ("verdict", "words"),
    [
        ("missing_effect", "nothing is left to decide: the missing effect is named"),
        ("no_discrepancy", "nothing is left to decide: nothing is missing"),
        ("parameters_only", "nothing is left to decide: parameters explain"),
    ],
)
def test_no_test_is_designed_after_a_decided_diagnosis(tmp_path, verdict, words):
    """Rivals that were beaten are in the file, too."""
    (tmp_path / "model.json").write_text(json.dumps(MASS))
    (tmp_path / "diagnosis.json").write_text(json.dumps(rivals((3.0, 14.0)) | {"verdict": verdict}))
    test = tmp_path / "test.csv"
    after = ["--design", str(test), "--after", str(tmp_path / "diagnosis.json")]
    made = run(str(tmp_path / "model.json"), *QUICK.split(), *after)
    assert isinstance(made.exception, InputError)
    assert words in str(made.exception)
    assert not test.exists()


def test_a_designed_test_separates_rivals_better_than_the_usual_one():
    network = Network.load(MASS)
    left = read_rivals(network, rivals((3.0, 14.0)))
    assert [r.label for r in left] == ["coulomb_friction at table-ground", "linear_damping at table-ground"]
    tests = [Excitation(k, 1.0, 7.0, ("stroke",), size) for k, size in (("triangle", 0.4), ("sweep", 0.3))]
    tests.insert(0, make_excitation(network, SHORT))
    found = design_test(network, left, SHORT, np.array([0.05]), tests=tests)
    assert found is not None
    assert found.separation >= found.usual > 0
    assert np.abs(found.record.inputs["stroke"]).max() <= 0.01 + 1e-12
    louder = design_test(network, left, SHORT, np.array([0.5]), tests=tests)
    assert louder is not None
    assert louder.separation < found.separation


def test_results_without_rivals_are_refused_with_one_line():
    network = Network.load(MASS)
    whole = rivals((3.0, 14.0))
    for change, word in (
        ({"alternatives": []}, "no rivals"),
        ({"schema": "isd-score/1"}, "no result of a diagnosis"),
        ({"alternatives": [{"effects": ["coulomb_friction"], "where": [["table", "ground"]]}]}, "again"),
    ):
        refused(word, read_rivals, network, {**whole, **change})
    # of a stranger
    row = whole["alternatives"][0]
    for wrong in (
        {"effects": "no_such"},
        {"where": [["nowhere", "ground"]]},
        {"where": 3},
        {"values": [{"level": "much"}]},
        {"values": [7]},
        {"values": [{}, {}]},
        {"options": 5},
        {"options": [[1, 2]]},
        {"options": [{"behind": 5}]},
    ):
        refused("", read_rivals, network, {**whole, "alternatives": [{**row, **wrong}, row]})
    for change in (
        {"alternatives": [1, 2]},
        {"alternatives": {"a": 1}},
        {"parameters": [1]},
        {"parameters": {"a": {}}},
    ):
        refused("", read_rivals, network, {**whole, **change})
