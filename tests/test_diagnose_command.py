"""The command `isd-gym diagnose` to its end: every verdict and way, and every file that it writes opened again."""

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builders import QUARTER_CAR, drive_quarter_car, friction, oscillator
from html_page import Page
from program import printed, read_json, refused

from isd_gym import Network, Table, diagnose, read_table, simulate
from isd_gym.diagnosis import Hypothesis, SearchSettings
from isd_gym.diagnosis import _workflow as workflow
from isd_gym.diagnosis._records.reading import thin_long_record
from isd_gym.diagnosis._selection.plain_fits import Stage
from isd_gym.diagnosis._simulation.problem import Record
from isd_gym.diagnosis._simulation.time_limit import TimeLimit
from isd_gym.diagnosis._verdict.wording import summary_of
from isd_gym.records import schemas
from isd_gym.records.data import write_table

jsonschema = pytest.importorskip("jsonschema")

RATE = 100.0
KNOWN = {"spring.stiffness": 0.1, "damper.damping": 0.1}
OWN = oscillator(
    "travel displacement mass", "felt acceleration mass", uncertainty=KNOWN
)
PLACE = frozenset({"mass", "ground"})


def with_odd(**law):
    """The rig with a law between mass and ground that the model lacks."""
    return OWN.with_element({"name": "odd", "between": ["mass", "ground"], **law})


def wide(t, rng):
    """A force [N] of many sines from 0.3 to 8 Hz, 40 N RMS."""
    f, phase = rng.uniform(0.3, 8.0, 30), rng.uniform(0.0, 2 * np.pi, 30)
    x = np.sin(2 * np.pi * f[:, None] * t + phase[:, None]).sum(axis=0)
    return np.asarray(40.0 * x / x.std())


def sine(t, rng):
    return 40.0 * np.sin(2 * np.pi * 2.0 * t)


def record(truth, seed, push=wide, *, seconds=8.0, noise=0.01, settled=0.0, hidden=0.0):
    """A record of a rig, noise added. settled [s]: left out at the beginning. hidden [N]: a force that nobody measures."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds + settled, 1.0 / RATE)
    force = push(t, rng)
    other = (
        hidden
        * np.sin(2 * np.pi * 4.1 * t + rng.uniform(0, 6))
        * np.sign(np.sin(1.7 * t))
    )
    out = {"push": force, **simulate(truth, t, {"push": force + other})}
    keep = t >= settled
    out = {n: x[keep] for n, x in out.items()}
    noisy = {
        n: x + (n != "push") * noise * x.std() * rng.standard_normal(len(x))
        for n, x in out.items()
    }
    return Table(t[keep] - t[keep][0], noisy, f"r{seed}")


@dataclass(frozen=True)
class Outcome:
    """A finished command: output folder, JSON document and printed text."""

    folder: Path
    document: dict[str, Any]
    printed: str

    @property
    def model(self):
        return Network.load(self.folder / "model.json")

    @property
    def page(self):
        return Page(self.folder / "report.html")


def diagnosed(out, *words):
    """Run the command; every file in its folder is opened again and checked."""
    text = printed("diagnose", *words, "--out", out)
    document = read_json(out / "diagnosis.json")
    outcome = Outcome(out, document, text)
    check_folder(outcome)
    return outcome


def check_folder(o):
    d = o.document
    jsonschema.Draft202012Validator(schemas.load("isd-diagnosis/1")).validate(d)
    assert d["summary"] == summary_of(d)  # from the numbers of the document alone
    assert not re.search(r"\b(inf|nan|None)\b", d["summary"])
    first = re.split(r" \(|; |(?<=[a-z])\. ", d["summary"])[0]
    assert first in " ".join(o.printed.split())
    assert first in " ".join(o.page.text.split())
    for file in o.folder.iterdir():
        if file.suffix == ".svg":
            assert "<path" in file.read_text(), file.name  # not blank
        elif file.suffix == ".csv":
            assert len(read_table(file).time) > 100
    assert {"gap.svg", "time.svg"} <= {f.name for f in o.folder.iterdir()}
    for g in d["gates"]:
        compared = {"<": "__lt__", "<=": "__le__", ">": "__gt__", ">=": "__ge__"}[
            g["relation"]
        ]
        assert g["passed"] == getattr(float(g["value"]), compared)(float(g["limit"]))
    t = np.arange(0, 1, 0.01)
    inputs = {c.name: 0.01 * np.sin(9 * t) for c in o.model.inputs}
    assert all(np.isfinite(y).all() for y in simulate(o.model, t, inputs).values())


def restrict(patch, *known):
    """Let the library have these effects alone."""
    whole = Hypothesis.stands
    patch.setattr(
        Hypothesis,
        "stands",
        lambda self, network: self.effect in known and whole(self, network),
    )


@pytest.fixture
def library(monkeypatch):
    """Few effects: the way is that of the whole library, in a tenth of its time."""
    restrict(
        monkeypatch, "coulomb_friction", "quadratic_damping", "inertance", "sensor_gain"
    )


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A folder with the model and the records of all rigs."""
    folder = tmp_path_factory.mktemp("rigs")
    OWN.save(folder / "model.json")
    replace(OWN, uncertainty={"damper.damping": 0.1}).save(folder / "stiff.json")
    hard = {"type": "cubic_stiffness", "stiffness": 4e6}
    rigs = {
        "clean": (OWN, {}),
        "stiffer": (
            OWN.with_parameters({"spring.stiffness": 2250.0, "damper.damping": 34.0}),
            {},
        ),
        "friction": (with_odd(type="coulomb_friction", level=12.0), {}),
        "hard": (with_odd(**hard), {}),
        "hum": (OWN, {"hidden": 25.0}),
        "sine": (
            with_odd(type="inertance", inertance=1.0),
            {"push": sine, "settled": 4.0, "noise": 0.02},
        ),
    }
    for name, (truth, how) in rigs.items():
        for seed in (1, 2):
            write_table(folder / f"{name}{seed}.csv", record(truth, seed, **how))
    return folder


def run(files, tmp_path, name, *, validate=True, model="model.json"):
    one, two = files / f"{name}1.csv", files / f"{name}2.csv"
    held = ["--validate", two] if validate else [two]
    return diagnosed(tmp_path / "out", one, *held, "--model", files / model)


def test_no_discrepancy(files, library, tmp_path):
    o = run(files, tmp_path, "clean")
    assert o.document["verdict"] == "no_discrepancy" and o.document["effects"] == []
    assert o.document["summary"].startswith(
        "The model agrees with the measurements; no effect is missing ("
    )
    assert o.document["reason"] == "immaterial"


@pytest.mark.slow
def test_parameters_only_from_a_single_record(files, library, tmp_path):
    o = diagnosed(
        tmp_path / "out", files / "stiffer1.csv", "--model", files / "model.json"
    )
    assert o.document["verdict"] == "parameters_only"
    assert o.model.parameters["spring.stiffness"] == pytest.approx(2250.0, rel=0.01)
    assert "spring.stiffness from 2000 to 22" in o.document["summary"]
    assert any("last third" in note for note in o.document["notes"])
    assert re.search(
        r"Record “stiffer1” \(fitted up to \d[\d.]* s, then held out\)", o.page.text
    )


@pytest.mark.parametrize(
    "validate", [True, pytest.param(False, marks=pytest.mark.slow)]
)
def test_missing_effect(files, library, tmp_path, validate):
    o = run(files, tmp_path, "friction", validate=validate)
    assert o.document["verdict"] == "missing_effect"
    (effect,) = o.document["effects"]
    assert effect["effect"] == "coulomb_friction" and set(effect["between"]) == PLACE
    (odd,) = [e for e in o.model.elements if e.type == "coulomb_friction"]
    assert o.model.parameters[f"{odd.name}.level"] == pytest.approx(12.0, rel=0.1)
    assert (
        0 < o.model.uncertainty[f"{odd.name}.level"] < 0.1
    )  # the posterior goes with the model
    assert o.document["best_candidate"] is None and (o.folder / "law.svg").exists()
    assert all(g["passed"] for g in o.document["gates"])
    refit, after = (
        o.document["gap"]["held_out"][k]["travel"] for k in ("refit", "after")
    )
    assert after < 0.2 * refit
    assert (
        "Record “friction2” (held out)" in o.page.text
    )  # also where nobody set it aside


@pytest.mark.slow
@pytest.mark.parametrize(
    ("where", "left_out", "verdict"),
    [
        ((Stage, "run"), "the search for a first effect", "unknown_effect"),
        ((workflow, "collect_evidence"), "", "missing_effect"),
    ],
)
def test_a_stage_whose_time_is_over_ends_and_the_summary_says_what_was_not_tried(
    files, library, tmp_path, monkeypatch, where, left_out, verdict
):
    """A clock stands still until a function is called. A name whose candidates were not compared is no name."""
    now, (owner, called) = [0.0], where
    monkeypatch.setattr(TimeLimit, "seconds", property(lambda self: now[0]))
    whole = getattr(owner, called)

    def late(*given, **options):
        now[0] = (
            0.88 * 4.0
        )  # the search and the comparison of its candidates have had their time
        return whole(*given, **options)

    monkeypatch.setattr(owner, called, late)
    words = (
        files / "friction1.csv",
        "--validate",
        files / "friction2.csv",
        "--model",
        files / "model.json",
    )
    o = diagnosed(tmp_path / "out", *words, "--max-seconds", 5)
    d = o.document
    assert d["verdict"] == verdict
    if left_out:
        assert d["not_tried"][0].startswith(left_out)
        assert (
            f"The time limit of 5 s ended the diagnosis early. Not tried: {left_out}"
            in d["summary"]
        )
        assert (
            "the search for it is not finished" in d["summary"]
            and "No known effect" not in d["summary"]
        )
        assert "the time limit ended the search" in o.page.text
    else:
        assert not d["not_tried"] and "time limit" not in d["summary"]


def test_no_time_for_the_refit_is_one_line(files, monkeypatch):
    monkeypatch.setattr(TimeLimit, "seconds", property(lambda self: 1e9))
    refused(
        r"the time limit of 5 s is over before .* raise --max-seconds",
        diagnose,
        [files / "friction1.csv"],
        files / "model.json",
        settings=SearchSettings(max_seconds=5.0),
    )


def test_a_long_record_is_thinned_with_a_note():
    n = 250_000
    slow = np.sin(2 * np.pi * np.arange(n) * 1e-3)  # 1000 samples per period
    record = Record("long", 1e-3, {"push": slow}, slow[:, None])
    notes = []
    thin = thin_long_record(record, OWN, notes)
    assert len(thin) == thin.samples == 83_334 and thin.step == pytest.approx(3e-3)
    assert np.abs(thin.inputs["push"][100:-100] - slow[::3][100:-100]).max() < 1e-3
    (note,) = notes
    assert note.startswith(
        "long: 250000 samples are more than the motion needs: every 3th sample"
    )
    assert thin_long_record(thin, OWN, notes) is thin and len(notes) == 1
    fast = replace(record, measured=np.random.default_rng(0).standard_normal((n, 1)))
    assert (
        thin_long_record(fast, OWN, notes) is fast
    )  # what looks like noise to the eye may be the motion


@pytest.mark.parametrize("rig", ["hard", "hum"])
@pytest.mark.slow
def test_unknown_effect_that_no_law_of_the_library_explains(
    rig, files, library, tmp_path
):
    """A hardening spring, which this library does not have, and a force that nobody measured and that depends on time."""
    o = run(files, tmp_path, rig)
    d = o.document
    assert d["verdict"] == "unknown_effect" and d["effects"] == []
    assert "no known effect passes the checks for a name" in d["summary"]
    # no law removes half of the gap: the model has none
    assert not d["best_candidate"]["completes"]
    assert o.model.parameters.keys() == OWN.parameters.keys()
    failed = [g["gate"] for g in d["gates"] if not g["passed"]]
    assert [g["gate"] for g in d["best_candidate"]["failed_gates"]] == failed


@pytest.mark.slow
def test_ambiguous_with_the_test_that_would_decide(files, tmp_path, monkeypatch):
    """One sine: inertance, and a compliance in series, give the same force there."""
    restrict(monkeypatch, "inertance", "series_compliance")
    o = run(files, tmp_path, "sine", model="stiff.json")
    d = o.document
    assert d["verdict"] == "ambiguous", d["summary"]
    assert {tuple(a["effects"]) for a in d["alternatives"]} == {
        ("inertance",),
        ("series_compliance",),
    }
    assert [g["gate"] for g in d["best_candidate"]["failed_gates"]] == [
        "distinguishable"
    ]
    assert (
        "do not decide between 2 candidates: " in d["summary"]
        or "or inertance" in d["summary"]
    )
    assert "inertance between mass and ground" in d["summary"]
    assert {e.type for e in o.model.elements} & {"inertance", "series_compliance"}
    assert "Likeliest law, not certain: " in o.model.description
    test = read_table(o.folder / "next_experiment.csv")
    assert set(test.columns) == {"push"}
    played = simulate(OWN, test.time, test.columns)
    assert all(np.isfinite(y).all() for y in played.values())
    assert d["summary"].endswith("Next: run the test in next_experiment.csv.")


@pytest.mark.slow
def test_a_car_cut_at_its_wheel(library, tmp_path):
    """Its records do not hold the road."""
    car = Network.load(
        QUARTER_CAR | {"uncertainty": {"body.mass": 0.03, "damper.damping": 0.1}}
    )
    car.save(tmp_path / "car.json")
    drives = [tmp_path / f"drive{seed}.csv" for seed in (1, 2)]
    for seed, file in enumerate(drives, 1):
        time, columns = drive_quarter_car(
            4e-3, 8.0, seed, car.with_element(friction("body", "wheel", 150.0))
        )
        write_table(
            file,
            Table(
                time, {n: x for n, x in columns.items() if n != "road"}, f"drive{seed}"
            ),
        )
    words = [
        drives[0],
        "--validate",
        drives[1],
        "--model",
        tmp_path / "car.json",
        "--cut",
        "wheel",
    ]
    o = diagnosed(tmp_path / "out", *words)
    assert o.document["verdict"] == "missing_effect", o.document["summary"]
    (effect,) = o.document["effects"]
    assert effect["effect"] == "coulomb_friction" and set(effect["between"]) == {
        "body",
        "wheel",
    }
    assert effect["parameters"]["level"]["value"] == pytest.approx(150.0, rel=0.1)
    assert "tyre" in {e.name for e in o.model.elements}
    assert "coulomb_friction" in {e.type for e in o.model.elements}
    assert any("left out: tyre" in note for note in o.document["notes"])
