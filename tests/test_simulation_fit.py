"""From the search to `model.json`: sensor offsets, splines between sparse samples, and the last fit to all training data."""

from dataclasses import replace

import numpy as np
import pytest
from builders import channel, oscillator
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from isd_gym._common.errors import InputError
from isd_gym.diagnosis import diagnose
from isd_gym.diagnosis._estimation.structure import Hypothesis, add, base_structure, with_sensor_offsets
from isd_gym.diagnosis._selection.candidate import Candidate
from isd_gym.diagnosis._selection.held_out import HeldOutEvaluator
from isd_gym.diagnosis._selection.simulation_fit import fit_simulation_error, run_freely
from isd_gym.diagnosis._simulation.problem import Problem, Record
from isd_gym.physics.network import Network
from isd_gym.physics.simulate import simulate
from isd_gym.records.data import Table

MASS, STIFFNESS, DAMPING, CUBIC = 2.0, 8000.0, 12.0, 4e7
OFFSET, NOISE = 0.004, 1e-6  # [m]
STEP = 0.011  # [s]: nine samples per period of 10 Hz
PAIR = ("mass", "ground")


def duffing(offset="free", stiffness=STIFFNESS):
    """A mass on a linear spring and a damper: the oscillator without its cubic spring."""
    position = channel("position", "displacement", "mass", offset=offset)
    known = {"spring.stiffness": 0.1, "damper.damping": 0.3}
    return oscillator(position, mass=MASS, stiffness=stiffness, damping=DAMPING, uncertainty=known)


def record(seed, samples=1500):
    """A random multi-sine of force and the motion from rest, by scipy's integrator."""
    rng = np.random.default_rng(seed)
    t = np.arange(samples) * STEP
    lines = np.arange(0.5, 16.0, 0.25)
    phases = rng.uniform(0, 2 * np.pi, len(lines))
    push = np.sum(4.0 * np.sin(2 * np.pi * lines[:, None] * t + phases[:, None]), axis=0) * np.minimum(t, 1.0)
    force = CubicSpline(t, push)

    def rate(at, state):
        x, v = state
        return [v, (float(force(at)) - STIFFNESS * x - CUBIC * x**3 - DAMPING * v) / MASS]

    seen = solve_ivp(rate, (0.0, t[-1]), [0.0, 0.0], t_eval=t, rtol=1e-8, atol=1e-11, max_step=STEP).y[0]
    noisy = seen + OFFSET + NOISE * rng.standard_normal(samples)
    return Table(t, {"push": push, "position": noisy}, f"run {seed}")


def error_of(network, table, interpolation="auto"):
    """RMS error of a simulation from rest, over the deviation of the measured output."""
    out = simulate(network, table.time, {"push": table["push"]}, interpolation=interpolation)["position"]
    return float(np.sqrt(np.mean((table["position"] - out) ** 2)) / np.std(table["position"]))


def complete(stiffness=STIFFNESS):
    """The oscillator with its cubic spring, and the offset of its sensor."""
    nominal = base_structure(duffing(stiffness=stiffness))
    structure = add(nominal, Hypothesis("cubic_stiffness", PAIR), {"stiffness": CUBIC})
    return with_sensor_offsets(structure.network, (OFFSET,))


def test_a_model_holds_the_offset_of_its_sensor():
    network, t = complete(), np.arange(100) * 1e-3
    still = simulate(network, t, {"push": 0 * t})["position"]
    assert still == pytest.approx(np.full(100, OFFSET))
    assert Network.load(network.to_dict()) == network
    assert network.outputs[0].offset == "free"  # a later diagnosis estimates what is left
    # a further offset adds to the first
    network = with_sensor_offsets(complete(), (0.001,))
    assert len([e for e in network.elements if e.type == "sensor_bias"]) == 1
    assert network.parameters["position_offset.bias"] == pytest.approx(OFFSET + 0.001)


def test_only_one_offset_for_all_records_is_held():
    assert with_sensor_offsets(duffing("record"), (OFFSET,)) == duffing("record")
    assert with_sensor_offsets(duffing("none"), (0.0,)) == duffing("none")
    assert with_sensor_offsets(duffing(), None) == duffing()


def test_splines_follow_an_oscillator_that_straight_lines_do_not():
    table = record(1)
    lines, splines = (error_of(complete(), table, kind) for kind in ("linear", "auto"))
    assert splines < 0.005 < 0.02 < lines


def test_dense_samples_keep_straight_lines():
    t = np.arange(2000) * 1e-3
    push = {"push": np.sin(2 * np.pi * 2.0 * t)}
    linear, auto = (simulate(duffing(), t, push, interpolation=k)["position"] for k in ("linear", "auto"))
    assert np.array_equal(linear, auto)


def test_another_course_between_samples_is_refused():
    t = np.arange(100) * 1e-3
    with pytest.raises(InputError, match="interpolation must be linear, smooth, spline or auto"):
        simulate(duffing(), t, {"push": t}, interpolation="cubic")


def candidate(stiffness):
    """A candidate with a stiffness of the spring, and an evaluator of two training records."""
    tables = [record(k, 800) for k in (2, 3)]
    records = [Record(t.source, STEP, {"push": t["push"]}, t["position"][:, None]) for t in tables]
    problem = Problem(duffing(), records, ["fit", "choose"])
    whole = Problem(duffing(), records, ["fit", "fit"])
    structure = add(base_structure(duffing()), Hypothesis("cubic_stiffness", PAIR), {"stiffness": CUBIC})
    structure = replace(structure, offsets=(OFFSET,))
    x = structure.start
    x[0] = np.log(stiffness)
    evaluator = HeldOutEvaluator(problem, whole=whole)
    fit = evaluator.plain_fitter.follow(structure, x, [0])
    return evaluator, Candidate(fit, 0.0)


def test_the_last_fit_lowers_the_error_of_free_runs():
    evaluator, wrong = candidate(1.01 * STIFFNESS)
    made = fit_simulation_error(evaluator, wrong, (np.inf, -np.inf))
    assert made is not None
    structure, x, last = made
    assert structure.at(x).parameters["spring.stiffness"] == pytest.approx(STIFFNESS, rel=2e-3)
    assert structure.offsets is not None
    assert structure.offsets[0] == pytest.approx(OFFSET, abs=2e-5)
    for error in (last.data, last.held_out):
        assert error["after"]["position"] < 0.2 * error["before"]["position"]
    assert last.values["spring.stiffness"] == structure.at(x).parameters["spring.stiffness"]
    errors = run_freely(evaluator.whole, structure, x, evaluator.least_noise)
    assert set(errors) == {0, 1} and errors[0].shape == (800, 1)


def test_the_last_fit_is_dropped_where_it_gains_nothing_or_the_motion_is_lost():
    evaluator, right = candidate(STIFFNESS)
    first = fit_simulation_error(evaluator, right, (np.inf, -np.inf))
    if first is not None:  # what is left after one fit is no gain
        fit = replace(right.fit, structure=first[0], x=first[1])
        assert fit_simulation_error(evaluator, replace(right, fit=fit), (np.inf, -np.inf)) is None
    evaluator, lost = candidate(1.3 * STIFFNESS)
    assert fit_simulation_error(evaluator, lost, (np.inf, -np.inf)) is None


@pytest.mark.slow
def test_a_diagnosed_oscillator_reads_like_its_sensor(tmp_path):
    """The completed model predicts a new record in the units of the sensor, offset included."""
    found = diagnose([record(4)], duffing(stiffness=1.03 * STIFFNESS))
    assert found.verdict == "missing_effect"
    assert [e.effect for e in found.effects] == ["cubic_stiffness"]
    found.save(tmp_path / "found")
    network = Network.load(tmp_path / "found" / "model.json")
    assert network.parameters["position_offset.bias"] == pytest.approx(OFFSET, rel=0.01)
    assert error_of(network, record(5)) < 0.01
    assert found.to_dict()["simulation_fit"] is None or found.simulation_fit is not None
