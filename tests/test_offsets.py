"""The unknown constant of a sensor: equal in all records, or free in each record."""

from dataclasses import replace

import numpy as np
import pytest
from builders import channel, fitted, oscillator, recorded, sines
from program import refused
from scipy.optimize import least_squares

from isd_gym import Network
from isd_gym.diagnosis._estimation.gauss_newton import Fitter
from isd_gym.diagnosis._estimation.initial_states import motion_rows
from isd_gym.diagnosis._estimation.noise import white_weights
from isd_gym.diagnosis._estimation.structure import base_structure
from isd_gym.diagnosis._hypotheses.law_matching import residual_of
from isd_gym.diagnosis._selection.held_out import HeldOutEvaluator
from isd_gym.diagnosis._simulation.problem import Problem, Record

STEP, SAMPLES = 2e-3, 1500
OFFSET, NOISE = 0.013, 2e-5  # [m]


def stand(offset="free"):
    """A mass on a spring to the ground, pushed by a known force."""
    position = channel("position", "displacement", "mass", offset=offset)
    known = {"spring.stiffness": 0.2, "damper.damping": 0.5}
    return oscillator(
        position, mass=2.0, stiffness=900.0, damping=9.0, uncertainty=known
    )


def record(name, mean, seed, offset=OFFSET, size=2.0):
    """A push of some size [N] about a mean force [N] from rest at its deflection, seen by a sensor with an offset [m]."""
    rng = np.random.default_rng(seed)
    t = np.arange(SAMPLES) * STEP
    push = mean + sines(t, (1.1, 2.7, 4.9), rng.uniform(0, 6, 3), size)
    blank = Record(name, STEP, {"push": push}, np.zeros((SAMPLES, 1)))
    network = stand()
    problem = Problem(network, [blank], ["fit"])
    rest = np.array([mean / 900.0, 0.0])
    x0 = np.linalg.lstsq(motion_rows(problem, network), rest, rcond=None)[0]
    seen = recorded(network, STEP, {"push": push}, initial=x0).measured
    return replace(
        blank, measured=seen + offset + NOISE * rng.standard_normal(seen.shape)
    )


def problem_of(network, *offsets, held=None, size=2.0):
    records = [
        record(f"run {k}", 6.0 * k - 6.0, k, o, size) for k, o in enumerate(offsets)
    ]
    roles = ["fit"] * len(records)
    if held is not None:
        records.append(record("test", 3.0, 9, held))
        roles.append("choose")
    return Problem(network, records, roles)


@pytest.mark.parametrize(
    ("text", "value"), [("free", "free"), ("record", "record"), ("none", None)]
)
def test_an_offset_is_read_and_written(text, value):
    network = stand(text)
    assert network.outputs[0].offset == value
    assert Network.load(network.to_dict()) == network
    assert network.outputs[0].to_dict().get("offset", "none") == text


@pytest.mark.parametrize("wrong", ["free for all", True, ["free"], 1.0])
def test_another_offset_is_refused(wrong):
    refused('"offset" must be "free"', stand, wrong)


def covariance(problem, fit):
    """Return the covariance of the parameters and the shared offset, all other numbers eliminated."""
    fitter = Fitter(problem, white_weights(np.array([NOISE])))
    none = {i: np.zeros((len(problem.records[i]), 1, 0)) for i in problem.estimation}
    H, _, _ = fitter.normal_equations(fit.structure, fit.x, fit.initial, none)
    return np.linalg.inv(H)


def test_mean_forces_show_a_stiffness_through_one_offset_only():
    """Three mean forces deflect a spring by 6 N / k each: one offset per record hides the deflections."""
    spread = {}
    for offset in ("free", "record"):
        problem = problem_of(stand(offset), OFFSET, OFFSET, OFFSET, size=0.2)
        fit = fitted(problem, NOISE)
        assert fit.network.parameters["spring.stiffness"] == pytest.approx(
            900.0, rel=0.02
        )
        spread[offset] = float(covariance(problem, fit)[0, 0])
    # the mean deflections have a hundred times the power of the motion about them
    assert spread["free"] < 0.05 * spread["record"]


def test_each_record_has_its_own_offset_where_the_model_says_so():
    true = (0.001, -0.004, 0.02)
    problem = problem_of(stand("record"), *true)
    fit = fitted(problem, NOISE)
    assert [float(fit.offset[i][0]) for i in range(3)] == pytest.approx(
        true, abs=10 * NOISE
    )
    assert fit.structure.offsets is None


def test_the_joint_fit_is_that_of_all_numbers_at_once():
    """Independent check: scipy's least squares over parameters, initial states and one offset, without elimination."""
    problem = problem_of(stand(), OFFSET, OFFSET)
    structure = base_structure(problem.network)
    fitter = Fitter(problem, white_weights(np.array([NOISE])))
    fit = fitter.fit(structure, iterations=30)
    scale = [np.linalg.cholesky(fitter._information(structure, i)).T for i in range(2)]
    mean = np.array([f.mean for f in structure.free])
    sigma = np.array([f.sigma for f in structure.free])

    def left(z):
        network = structure.at(z[:2])
        out = [(z[:2] - mean) / sigma]
        for i in range(2):
            x0 = z[3 + 2 * i : 5 + 2 * i]
            y = (
                problem.simulate([network], i, x0[:, None], like=network)[:, 0, 0]
                + z[2]
            )
            out += [(problem.records[i].measured[:, 0] - y) / NOISE, scale[i] @ x0]
        return np.concatenate(out)

    start = np.concatenate([structure.start, [0.0], fit.initial[0], fit.initial[1]])
    dense = least_squares(
        left, start, x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14
    )
    cost = (
        fit.cost
        + fit.prior
        + sum(float(np.sum((scale[i] @ fit.initial[i]) ** 2)) for i in range(2))
    )
    assert cost == pytest.approx(2 * dense.cost, rel=1e-7)
    assert fit.structure.offsets is not None
    assert fit.structure.offsets[0] == pytest.approx(dense.x[2], abs=1e-7)
    expected = np.linalg.inv(dense.jac.T @ dense.jac)[:2, :2]
    size = np.sqrt(np.diag(expected))  # slopes by parameters are one-sided differences
    np.testing.assert_allclose(
        covariance(problem, fit)[:2, :2] / np.outer(size, size),
        expected / np.outer(size, size),
        atol=0.01,
    )


def test_the_residual_of_the_score_test_has_no_offset_left():
    problem = problem_of(stand(), OFFSET, OFFSET)
    fitter = Fitter(problem, white_weights(np.array([NOISE])))
    fit = fitter.fit(base_structure(problem.network))
    residual = residual_of(problem, fitter, fit)
    constant = np.zeros(len(residual.left))
    constant[: 2 * SAMPLES] = 1.0 / NOISE
    assert np.linalg.norm(residual.without(constant)) < 1e-6 * np.linalg.norm(constant)
    one = constant.copy()
    one[SAMPLES:] = 0.0  # an offset of one record alone is no offset of the sensor
    assert np.linalg.norm(residual.without(one)) > 0.1 * np.linalg.norm(one)


def test_a_held_out_record_has_the_offset_of_the_training_records():
    """A sensor that moved by 3 mm before the held-out record is an error of 3 mm there."""
    problem = problem_of(stand(), OFFSET, OFFSET, held=OFFSET + 0.003)
    fitter, structure = (
        HeldOutEvaluator(problem).plain_fitter,
        base_structure(problem.network),
    )
    fit = fitter.fit(structure)
    held = fitter.follow(fit.structure, fit.x, problem.held)
    left = (
        problem.records[2].measured[300:, 0] - held.outputs[2][300:, 0]
    )  # the free motion has died by then
    assert left.mean() == pytest.approx(0.003, abs=2e-4)
    assert held.offset[2][0] == fit.offset[0][0]
    nominal = HeldOutEvaluator(problem).plain_fitter.follow(
        structure, structure.start, problem.held
    )
    assert nominal.offset[2][0] == pytest.approx(OFFSET, abs=1e-4)


def test_the_deviation_is_that_within_records():
    """Two places, ten times the motion apart: the distance is no motion. Segments of one record are one record."""
    t = np.arange(1000) * 1e-2
    motion, push = 0.01 * np.sin(2 * np.pi * t), {"push": 0 * t}

    def problem(*parts):
        records = [Record(n, 1e-2, push, y[:, None]) for n, y in parts]
        return Problem(stand(), records, ["fit"] * len(records))

    apart = problem(("run 0", 0.3 + motion), ("run 1", 0.4 + motion))
    assert apart.measured().std() > 0.05
    within = 0.01 / np.sqrt(2)
    assert apart.deviation()[0] == pytest.approx(within, rel=1e-6)
    ramp = problem(("run 0", motion), ("run 0", 1.0 + motion))
    assert ramp.deviation()[0] == pytest.approx(np.hypot(within, 0.5))
