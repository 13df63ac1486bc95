"""Fleets: what a folder holds, what is done again, what is told of many cases."""

import json

import numpy as np
import pytest
from program import refused
from typer.testing import CliRunner

from isd_gym._commands import app
from isd_gym._common.errors import InputError, ReportError
from isd_gym.contrib.fleet import cases as module
from isd_gym.contrib.fleet.cases import (
    Case,
    _task,
    case_itself,
    cases_of,
    check,
    fleet,
    lines,
    merge,
    page,
    write_page,
)
from isd_gym.physics.network import Network
from isd_gym.records.data import Table, write_table


def case(folder, name, *files):
    for file in files:
        path = folder / name / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("time,x\n0,1\n")


def test_cases_are_found_with_vehicle_date_and_loggers(tmp_path):
    case(tmp_path, "van7_2024-09-01", "run1/body.csv", "run1/wheel.mf4", "validation.csv", "notes.pdf")
    case(tmp_path, "van7_2024-05-01", "a.csv")
    case(tmp_path, "bench", "a.csv")
    found = cases_of(tmp_path, "car.json")
    assert [c.vehicle for c in found] == ["bench", "van7", "van7"]
    assert [c.date for c in found] == ["", "2024-05-01", "2024-09-01"]
    run = tmp_path / "van7_2024-09-01"
    assert found[2].data == (f"{run}/run1/body.csv+{run}/run1/wheel.mf4",)
    assert found[2].validate == (f"{run}/validation.csv",)
    # every file that a reader knows is a run
    case(tmp_path / "more", "rig", "run1.lvm", "run2.csv.gz", "run3.CSV", "run4.zip", "model.json")
    (rig,) = cases_of(tmp_path / "more")
    assert [name.rpartition("/")[2] for name in rig.data] == ["run1.lvm", "run2.csv.gz", "run3.CSV"]


def test_a_folder_that_holds_one_case_is_that_case(tmp_path):
    case(tmp_path, "rig", "first.csv", "second.csv", "validation.csv", "model.json")
    rig = tmp_path / "rig"
    one = case_itself(rig)
    assert one is not None and one.data == (f"{rig}/first.csv", f"{rig}/second.csv")
    assert one.validate == (f"{rig}/validation.csv",) and one.model == f"{rig}/model.json"
    assert case_itself(tmp_path) is None  # of cases
    case(tmp_path, ".", "stray.csv")
    assert case_itself(tmp_path, "car.json") is None


def test_a_model_that_is_named_goes_before_the_folders_own(tmp_path):
    case(tmp_path, "rig", "first.csv", "second.csv", "model.json")
    words = ["diagnose", str(tmp_path / "rig"), "--model", "nosuch.json", "--out", str(tmp_path / "out")]
    done = CliRunner().invoke(app, words)
    assert isinstance(done.exception, InputError) and "nosuch.json" in str(done.exception)


def test_a_case_without_a_model_and_a_folder_without_cases_are_one_line(tmp_path):
    refused("no folders of records", cases_of, tmp_path)
    case(tmp_path, "van", "a.csv")
    refused(r"holds no model\.json; --model", cases_of, tmp_path)
    refused("lies among the cases", check, tmp_path, tmp_path / "out")


def test_a_file_that_changed_is_a_new_task(tmp_path):
    case(tmp_path, "van", "a.csv")
    (one,) = cases_of(tmp_path, "force-rig")
    before = _task(one, {}).key
    assert _task(one, {}).key == before
    (tmp_path / "van" / "a.csv").write_text("time,x\n0,1\n1,2\n")
    assert _task(one, {}).key != before


def results(values):
    """A fleet of one vehicle whose friction is what `values` say."""
    cases = [Case(f"van_{d}", "van", d, ("a.csv",), (), "m.json") for d in values]
    tasks = [_task(c, {}) for c in cases]
    found = {}
    for task, (value, half) in zip(tasks, values.values(), strict=True):
        q = {"value": value, "low": value - half, "high": value + half, "unit": "N"}
        effect = {"effect": "coulomb_friction", "between": ["piston", "joint"]}
        effect |= {"confidence": 0.99, "parameters": {"level": q}}
        found[task.key] = {"diagnosis": {"verdict": "missing_effect", "effects": [effect]}}
    return cases, tasks, found


def test_what_grew_over_dates_is_told():
    levels = {"2024-05-01": (300.0, 8.0), "2024-07-01": (340.0, 8.0), "2024-09-01": (450.0, 8.0)}
    merged = merge(*results(levels))
    told = " ".join(" ".join(lines(merged)).split())
    assert "level: 300 -> 340 -> 450 N (+50 %, beyond its intervals)" in told
    assert max(map(len, lines(merged))) <= 80
    assert "<polyline" in page(merged) and json.dumps(merged)
    within = merge(*results({"2024-05-01": (300.0, 40.0), "2024-07-01": (340.0, 40.0)}))
    assert "within its intervals" in " ".join(" ".join(lines(within)).split())


def test_a_page_that_cannot_be_drawn_leaves_the_results(tmp_path, monkeypatch):
    case(tmp_path, "fleet/van_2024-01-01", "a.csv", "model.json")
    merged = merge(*results({"2024-01-01": (300.0, 8.0)}))
    monkeypatch.setattr("isd_gym.contrib.fleet.cases.merge", lambda *args: merged)
    words = ["diagnose", str(tmp_path / "fleet"), "--out", str(tmp_path / "out")]
    done = CliRunner().invoke(app, words)
    assert (tmp_path / "out" / "fleet.html").exists()
    monkeypatch.setattr("isd_gym.contrib.fleet.cases.page", lambda merged: 1 / 0)
    with pytest.raises(ReportError, match="page of the fleet could not be drawn"):
        write_page(merged, tmp_path / "out")
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 1 and isinstance(done.exception, SystemExit)
    assert "coulomb friction piston-joint (level 300 N)" in " ".join(done.stdout.split())
    assert "ZeroDivisionError" in done.stderr.splitlines()[-1]
    assert json.loads((tmp_path / "out" / "fleet.json").read_text()) == merged
    assert not (tmp_path / "out" / "fleet.html").exists()


def test_a_broken_result_of_a_case_is_made_again(tmp_path, monkeypatch):
    case(tmp_path / "cases", "van_2024-05-01", "a.csv")
    _, _, found = results({"2024-05-01": (500.0, 5.0)})
    (good,) = found.values()
    calls = []
    made = lambda **given: calls.append(given["name"]) or {**good, "model": None}  # noqa: E731
    monkeypatch.setattr(module, "diagnose_case", made)
    merged, _ = fleet(tmp_path / "cases", tmp_path / "out", "force-rig")
    assert len(calls) == 1 and merged["missing"] == 0
    (path,) = (tmp_path / "out" / "cases").glob("*.json")
    held = json.loads(path.read_text())
    for strange in ({}, [], {"diagnosis": {}, "model": None}, {"diagnosis": {"verdict": 3, "effects": []}}):
        path.write_text(json.dumps({**held, "result": strange}))
        assert fleet(tmp_path / "cases", tmp_path / "out", "force-rig")[0] == merged
    assert len(calls) == 5
    fleet(tmp_path / "cases", tmp_path / "out", "force-rig")
    assert len(calls) == 5


def test_a_case_that_cannot_be_diagnosed_is_told_and_the_others_go_on(tmp_path):
    rig = Network.load("force-rig")
    for name in ("a_2024-01-01", "b_2024-01-01"):
        (tmp_path / "cases" / name).mkdir(parents=True)
        names = ["nonsense"] if name[0] == "b" else [c.name for c in (*rig.inputs, *rig.outputs)]
        t = 1e-3 * np.arange(50)  # too short for anybody
        write_table(tmp_path / "cases" / name / "run.csv", Table(t, {n: np.sin(t) for n in names}))
    merged, outcome = fleet(tmp_path / "cases", tmp_path / "out", "force-rig")
    write_page(merged, tmp_path / "out")
    errors = {r["case"]: r["error"] for r in merged["cases"]}
    assert "too short" in errors["a_2024-01-01"] and "no column" in errors["b_2024-01-01"]
    assert merged["missing"] == 2 and len(outcome.failed) == 2
    assert "no result" in (tmp_path / "out" / "fleet.html").read_text()
    again, _ = fleet(tmp_path / "cases", tmp_path / "out", "force-rig")  # the folder is its own
    assert again["missing"] == 2
