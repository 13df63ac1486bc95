"""MissingPhysBench: the figures of the scorer for answers whose score is known, the seal, and the rig with the closed loop."""

import importlib
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from isd_gym.physics.network import Network
from isd_gym.physics.simulate import simulate

pytestmark = pytest.mark.tools

BENCHMARKS = Path(__file__).resolve().parents[1] / "benchmarks"
GROUND = ["mass", "ground"]
FRICTION = {"law": "coulomb_friction", "place": GROUND}
TRUTH = {
    "set": "one effect",
    "noise_db": 40,
    "effects": [FRICTION],
    "places": [GROUND],
    "nuisances": [{"law": "cubic_stiffness", "place": ["mass", "base"]}],
    "parameters": {"spring.stiffness": 100.0},
    "nominal_error": 0.5,
}
NOTHING = {**TRUTH, "set": "nothing", "effects": [], "places": []}
OUTSIDE = {**TRUTH, "set": "outside the library", "effects": []}
TIME = np.linspace(0.0, 10.0, 501)
TEST = {"time": TIME, "x": np.sin(TIME)}


@pytest.fixture
def bench(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    return importlib.import_module("missing_physics")


def figures(bench, truth, *effects, **more):
    answer = {"effects": list(effects), **more}
    return bench.summarise(
        [bench.score_case(truth, TEST, answer, more.get("prediction"))]
    )


def law(name, place=GROUND, **more):
    return {"law": name, "place": place, **more}


DRAG, UNLIKELY = (
    law("quadratic_damping", probability=0.8),
    law("coulomb_friction", probability=0.3),
)
PLACED = law(None)


@pytest.mark.parametrize(
    ("truth", "effects", "expected"),
    [
        # terminals have no order; there is nothing to abstain from
        (TRUTH, [law("coulomb_friction", GROUND[::-1], probability=0.9)], {"place_f1": 1, "law_accuracy": 1, "wrong_names": 0, "brier": 0.01, "abstention": None}),
        # the true law was given no probability
        (TRUTH, [DRAG], {"place_f1": 1, "law_accuracy": 0, "wrong_names": 1, "brier": (1 + 0.64) / 2}),
        # a small effect that is there is no error
        (TRUTH, [FRICTION, TRUTH["nuisances"][0]], {"place_f1": 1, "law_accuracy": 1, "wrong_names": 0, "brier": 0}),
        (NOTHING, [TRUTH["nuisances"][0]], {"abstention": 1}),
        # silence is right where nothing can be named
        (NOTHING, [], {"abstention": 1}),
        (NOTHING, [DRAG], {"abstention": 0, "wrong_names": 1, "brier": 0.64}),
        (NOTHING, [PLACED], {"place_f1": 0}),
        (OUTSIDE, [], {"abstention": 1}),
        (OUTSIDE, [DRAG], {"abstention": 0, "wrong_names": 1, "brier": 0.64}),
        (OUTSIDE, [PLACED], {"place_f1": 1, "abstention": 1}),
        # an unlikely statement is not a name, but counts for the Brier score
        (NOTHING, [UNLIKELY], {"wrong_names": 0, "abstention": 1, "brier": 0.09}),
    ],
)  # fmt: skip
def test_answers_of_known_score(bench, truth, effects, expected):
    found = figures(bench, truth, *effects)
    assert {k: found[k] for k in expected} == pytest.approx(expected)


def test_error_reduction_is_one_for_the_truth_and_zero_for_the_best_nominal_model(
    bench,
):
    y, deviation = TEST["x"], np.std(TEST["x"])
    wave = np.tile([1.0, -1.0], len(y))[: len(y)] * deviation
    for share, expected in ((0.0, 1.0), (0.5, 0.0), (0.25, 0.75), (9.0, -1.0)):
        f = figures(bench, TRUTH, prediction={"x": y + share * wave})
        assert f["error_reduction"] == pytest.approx(expected, abs=1e-9)
    assert figures(bench, TRUTH)["error_reduction"] is None
    assert figures(bench, TRUTH, prediction={"x": y[:-1]})["error_reduction"] == -1.0


def test_parameter_error_is_relative_to_the_truth(bench):
    f = figures(bench, TRUTH, parameters={"spring.stiffness": 93.0, "unknown": 1.0})
    assert f["parameter_error"] == pytest.approx(0.07)


def sealed_case(bench, folder):
    cases, truth, answers = folder / "cases", folder / "cases.truth", folder / "answers"
    for place in (cases, truth, answers / "case_01"):
        place.mkdir(parents=True)
    (truth / "truth.json").write_text(json.dumps({"case_01": TRUTH}))
    bench.write_csv(truth / "case_01.csv", TEST)
    (cases / "benchmark.json").write_text(
        json.dumps({"seed": 1, "truth_sha256": bench.digest(truth)})
    )
    (answers / "case_01" / "answer.json").write_text(
        json.dumps({"effects": [FRICTION]})
    )
    bench.write_csv(answers / "case_01" / "prediction.csv", TEST)
    return cases, answers


def test_the_scorer_runs_without_the_package(bench, tmp_path):
    cases, answers = sealed_case(bench, tmp_path)
    alone = (
        tmp_path / "missing_physics.py"
    )  # the file alone, in a folder without the project
    alone.write_bytes((BENCHMARKS / "missing_physics.py").read_bytes())
    words = [
        sys.executable,
        alone,
        "score",
        cases,
        answers,
        "--json",
        tmp_path / "figures.json",
    ]
    clean = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    done = subprocess.run(
        list(map(str, words)), capture_output=True, text=True, env=clean, cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    f = json.loads((tmp_path / "figures.json").read_text())["answers"]["all"]
    assert (f["law_accuracy"], f["error_reduction"]) == (1.0, 1.0)
    source = alone.read_text()
    assert "import isd_gym" not in source and "from isd_gym" not in source


def test_a_truth_that_was_changed_is_refused(bench, tmp_path):
    cases, answers = sealed_case(bench, tmp_path)
    (tmp_path / "cases.truth" / "truth.json").write_text(
        json.dumps({"case_01": NOTHING})
    )
    with pytest.raises(SystemExit, match="sealed"):
        bench.score(cases, answers)


def test_the_force_of_the_controller_moves_the_open_rig_as_the_closed_loop_did(bench):
    """The recorded force drives the true rig without its controller, by the project's own simulation, to the recorded position."""
    rigs = importlib.import_module("missing_physics_rigs")
    files, test, truth = rigs.make_case("loop.friction", 1, 40, bench.SAMPLES)
    assert not any(e["name"].startswith("loop_") for e in files["model"]["elements"])
    true = {**files["model"], "masses": {"mass": truth["parameters"]["mass.mass"]}}
    known = truth["parameters"]
    own = [
        {k: known.get(f"{e['name']}.{k}", v) for k, v in e.items()}
        for e in true["elements"]
    ]
    small = [
        {k: v for k, v in e.items() if k not in ("law", "place")}
        for e in truth["nuisances"]
    ]
    true["elements"] = own + [
        {**e, "name": f"true_{k}"} for k, e in enumerate([*truth["hidden"], *small])
    ]
    name = true["inputs"][0]["name"]
    network = Network.load({k: v for k, v in true.items() if k != "uncertainty"})
    y = simulate(
        network, test["time"], {name: files["test_input"][name]}, interpolation="spline"
    )
    error = np.std(y["position"] - test["position"]) / np.std(test["position"])
    assert error < 0.02
    assert truth["nominal_error"] > 10.0 * error
