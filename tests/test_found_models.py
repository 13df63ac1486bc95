"""What a found model is used for: errors on new records, ranges of an environment, a folder with its report."""

from dataclasses import replace

import numpy as np
import pytest
from builders import channel, element, oscillator
from program import assert_one_line, printed, read_json, refused, run

from isd_gym import ISDSuspensionEnv, Network, Table, simulate
from isd_gym.diagnosis import Quantity
from isd_gym.diagnosis._selection.uncertainty import with_posterior
from isd_gym.diagnosis.simulation._record_fits import (
    prediction_errors,
)
from isd_gym.physics._batch import posterior_ranges, ranges
from isd_gym.records.data import write_table

RIG = oscillator(
    channel("travel", "displacement", "mass", unit="mm", offset="record"), name="rig"
)
TIME = np.arange(2000) / 200.0
PUSH = 40.0 * np.sin(2 * np.pi * 2.1 * TIME) + 20.0 * np.sin(
    2 * np.pi * 3.7 * TIME + 1.0
)


@pytest.fixture
def files(tmp_path):
    RIG.save(tmp_path / "rig.json")
    replace(RIG.with_parameters({"damper.damping": 60.0}), name="other").save(
        tmp_path / "other.json"
    )
    travel = simulate(RIG, TIME, {"push": PUSH})["travel"]
    noise = 0.05 * np.random.default_rng(0).standard_normal(len(TIME))
    for name, first, offset in (
        ("a", 0, 0.0),
        ("b", 700, 3.0),
    ):  # the second starts in mid-motion
        columns = {
            "push": PUSH[first:],
            "travel": travel[first:] + noise[first:] + offset,
        }
        write_table(
            tmp_path / f"{name}.csv", Table(TIME[first:] - TIME[first], columns, name)
        )
    return tmp_path


def test_the_error_of_the_true_model_is_the_noise_and_that_of_another_one_is_not(files):
    records = [files / "a.csv", files / "b.csv"]
    own, other = (
        prediction_errors(records, files / m).errors for m in ("rig.json", "other.json")
    )
    assert [(r.record, r.channel) for r in own] == [
        (n, "travel") for n in ("a", "b", "all records")
    ]
    assert all(
        r.rms == pytest.approx(0.05, rel=0.1) and r.nrmse < 0.02 and r.unit == "mm"
        for r in own
    )
    assert all(r.nrmse > 0.15 for r in other)
    refused("no outputs", prediction_errors, records, replace(RIG, outputs=()))


def test_the_true_model_of_a_long_stiffening_decay_errs_by_noise(tmp_path):
    """The frequency follows the amplitude, so that a poor initial state loses the phase over thirty periods."""
    hard = element("hard", "cubic_stiffness", "mass", "ground", stiffness=7.5e11)
    parts = {"mass": 1.0, "stiffness": 7.3e5, "damping": 3.0, "beside": [hard]}
    rig = replace(oscillator("velocity velocity mass", **parts), inputs=())
    time = np.arange(1100) / 5000.0
    velocity = simulate(rig, time, {}, initial=np.array([-2.8e-4, 0.16]))["velocity"]
    noise = 1e-3 * np.random.default_rng(3).standard_normal(len(time))
    write_table(
        tmp_path / "decay.csv", Table(time, {"velocity": velocity + noise}, "decay")
    )
    (row,) = prediction_errors([tmp_path / "decay.csv"], rig).errors
    assert row.rms == pytest.approx(1e-3, rel=0.1)


def test_the_noise_of_an_irregular_motion_is_no_more_than_the_error():
    """The spectrum of this motion is that of noise with a memory."""
    push = 40.0 * np.random.default_rng(0).standard_normal(len(TIME))
    rig = oscillator("felt acceleration mass")
    columns = {"push": push} | simulate(rig, TIME, {"push": push})
    (row,) = prediction_errors([Table(TIME, columns, "push")], rig).errors
    assert row.noise == row.nrmse < 0.01


def test_the_command_prints_the_table_and_writes_it(files):
    made = files / "errors.json"
    records = (files / "a.csv", files / "b.csv")
    text = printed("simulate --compare --json", made, files / "rig.json", *records)
    assert all(w in text for w in ("all records", "RMS error", "own parameters"))
    rows = read_json(made)["errors"]
    assert len(rows) == 3 and all(
        r["rms"] == pytest.approx(0.05, rel=0.1) for r in rows
    )


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("a.csv", "--out FILE is missing"),
        ("a.csv b.csv --out o.csv", "one DATA with --out"),
        ("a.csv --compare --out o.csv", "leave out --out"),
        (
            "a.csv --compare --initial mass=0.1",
            "leave out --out and --initial",
        ),
        ("a.csv a.csv --compare", "named twice"),
        ("push.csv --compare", "no column 'travel'"),
    ],
)
def test_other_wishes_are_one_line(files, monkeypatch, words, told):
    monkeypatch.chdir(files)
    write_table("push.csv", Table(TIME, {"push": PUSH}, "push"))
    assert_one_line(run("simulate rig.json", words), told)


def test_the_intervals_of_a_fit_become_uncertainties():
    quantities = {
        "spring.stiffness": Quantity(
            2000.0, 2000.0 / 1.1**1.96, 2000.0 * 1.1**1.96, "N/m"
        ),
        "damper.damping": Quantity(30.0, 30.0, float("inf"), "N s/m"),
        "gone.level": Quantity(1.0, 0.5, 2.0, "N"),
    }
    found = with_posterior(replace(RIG, uncertainty={"mass.mass": 0.2}), quantities)
    assert found.uncertainty == {
        "mass.mass": 0.2,
        "spring.stiffness": pytest.approx(0.1, abs=1e-3),
    }


@pytest.fixture
def found(tmp_path):
    car = Network.load("quarter-car-isd").with_parameters({"body.mass": 350.0})
    folder = tmp_path / "found"
    folder.mkdir()
    replace(car, uncertainty={"body.mass": 0.02, "seal.level": 0.1}).save(
        folder / "model.json"
    )
    return folder


def test_the_environment_draws_the_rig_that_was_measured(found):
    env = ISDSuspensionEnv(network=found / "model.json", randomize=found)
    drawn = []
    for seed in range(200):
        _, info = env.reset(seed=seed)
        drawn.append(info["body.mass"])
    low, high = 350.0 / 1.02**1.96, 350.0 * 1.02**1.96
    assert low <= min(drawn) < low + 1.5 and high - 1.5 < max(drawn) <= high


def test_further_ranges_stand_beside_those_of_the_folder(found):
    car = Network.load(found / "model.json")
    given = ranges(
        car, {"found": str(found), "speed": (10, 20), "body.mass": (0.5, 2.0)}
    )
    assert given["speed"] == (10.0, 20.0) and given["body.mass"] == (0.5, 2.0)
    assert given["seal.level"] == pytest.approx((1.1**-1.96, 1.1**1.96))
    assert posterior_ranges(car, found / "model.json").keys() == {
        "body.mass",
        "seal.level",
    }


def test_another_car_and_a_model_without_uncertainty_are_one_line(found, tmp_path):
    refused("give network=", ISDSuspensionEnv, randomize=str(found))
    Network.load("quarter-car-passive").save(tmp_path / "m.json")
    sure = replace(Network.load("quarter-car-passive"), uncertainty={})
    sure.save(tmp_path / "m.json")
    refused("states no uncertainty", posterior_ranges, sure, tmp_path / "m.json")
    refused("must be the folder", ranges, sure, {"found": 3})
    refused("", ranges, sure, tmp_path / "nowhere")
