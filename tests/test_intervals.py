"""Intervals of fitted parameters of either sign."""

from types import SimpleNamespace

import numpy as np
import pytest
from builders import friction, oscillator
from rigs.reference import simulate
from scipy.signal import lsim, lti

from isd_gym import Table, diagnose
from isd_gym.diagnosis import Hypothesis, SearchSettings
from isd_gym.diagnosis._estimation.sensitivities import deviations
from isd_gym.diagnosis._estimation.structure import add, base_structure
from isd_gym.diagnosis._selection.uncertainty import (
    intervals,
    sizes_within,
    sums_with_dampers,
)


@pytest.mark.parametrize("stiffness", [2.5e6, -2.5e6, -2.5])
def test_an_interval_is_about_its_value_for_either_sign(stiffness):
    """A softening spring has a negative cubic stiffness: mean -/+ 1.96 deviations, however large the value."""
    rig = oscillator("travel displacement mass")
    cubic = Hypothesis("cubic_stiffness", ("mass", "ground"))
    structure = add(base_structure(rig), cubic, {"stiffness": stiffness})
    free, x = structure.free, structure.start
    assert [f.log for f in free] == [False]
    deviation = 0.01 * abs(stiffness)
    evaluator = SimpleNamespace(problem=SimpleNamespace(network=rig))
    fit = SimpleNamespace(structure=structure, x=x, network=structure.network)
    (found,) = intervals(evaluator, fit, np.array([[deviation**2]])).values()
    assert found.value == pytest.approx(stiffness)
    assert found.low == pytest.approx(stiffness - 1.96 * deviation)
    assert found.high == pytest.approx(stiffness + 1.96 * deviation)


def test_an_added_damping_is_stated_with_the_damper_beside_it():
    """The damper, free as a logarithm, and both directions of the law: the interval is that of the sum."""
    rig = oscillator("travel displacement mass", uncertainty={"damper.damping": 0.3})
    damping = rig.parameters["damper.damping"]
    law = Hypothesis("asymmetric_damping", ("mass", "ground"))
    structure = add(base_structure(rig), law, {"extension": 2.0, "compression": -1.0})
    (name,) = structure.names
    element = structure.network.element(name)
    spread = np.array([0.1, 0.2 * damping, 0.3 * damping])
    matrix = np.outer(spread, spread) * (1.5 * np.eye(3) - 0.5)
    found = sums_with_dampers(
        structure.network, structure, structure.start, element, matrix
    )
    total = found[f"{name}.extension"]
    assert [total.value, found[f"{name}.compression"].value] == pytest.approx(
        [damping + 2, damping - 1]
    )
    deviation = damping * np.sqrt(0.1**2 + 0.2**2 - 0.1 * 0.2)
    assert total.high - total.value == pytest.approx(1.96 * deviation, rel=1e-3)


def test_steps_of_differences_make_up_the_covariance_whatever_the_units():
    """The stiffness of a cubic spring has a deviation of 1e13, a logarithm one of 1e-2."""
    known = {"mass.mass": 0.1, "spring.stiffness": 0.1, "damper.damping": 0.3}
    rig = oscillator("travel displacement mass", uncertainty=known)
    hypothesis = Hypothesis("cubic_stiffness", ("mass", "ground"))
    structure = add(base_structure(rig), hypothesis, {"stiffness": 1e15})
    cubic = [f.path.endswith("cubic_stiffness.stiffness") for f in structure.free]
    deviation = np.where(cubic, 1e13, 1e-2)
    correlation = 0.3 * np.eye(len(deviation)) + 0.7
    wanted = correlation * np.outer(deviation, deviation)
    steps = deviations(structure, structure.start, wanted)
    assert steps.T @ steps / np.outer(deviation, deviation) == pytest.approx(
        correlation, rel=1e-6
    )


def _smooth(rng, time, highest, size):
    """Return a multi-sine that begins gently [unit of `size`]."""
    f = rng.uniform(0.1 * highest, highest, 20)
    x = sum(np.sin(2 * np.pi * fi * time + rng.uniform(0, 2 * np.pi)) for fi in f)
    return size * (x - x[0]) / x.std() * (1 - np.exp(-((time / 0.3) ** 2)))


def test_straight_lines_between_the_samples_of_a_smooth_force_do_not_bias_mass_and_stiffness():
    """A straight line reduces the force by (angle between samples)^2 / 12; the errors must stay within the intervals."""
    m, k, c, rng = 5.0, 2000.0, 6.0, np.random.default_rng(3)
    step, fine = 2 * np.pi / np.sqrt(k / m) / 30, 40
    true, tables = lti([1.0], [m, c, k]), []
    for run in range(2):
        t = np.arange(2000 * fine) * step / fine
        push = _smooth(np.random.default_rng(run), t, 4.0, 20.0)
        travel = lsim(true, push, t)[1][::fine]
        noisy = travel + 0.003 * travel.std() * rng.standard_normal(len(travel))
        columns = {"push": push[::fine], "travel": noisy}
        tables.append(Table(t[::fine], columns, f"run{run}"))
    known = {"mass.mass": 0.1, "spring.stiffness": 0.1, "damper.damping": 1.0}
    rig = oscillator("travel displacement mass", uncertainty=known)
    found = diagnose(tables, rig, settings=SearchSettings(depth=0, jobs=1)).parameters
    for path, truth in (("mass.mass", m), ("spring.stiffness", k)):
        q = found[path]
        assert q.low < truth < q.high
        assert q.value == pytest.approx(truth, rel=1e-3)
        assert q.high - q.low < 0.03 * truth  # not the stated uncertainty


@pytest.mark.slow
def test_a_factor_that_all_parameters_share_keeps_its_stated_uncertainty():
    """The motion of a shaken mass depends on ratios of mass, stiffness, damping and friction alone."""
    spread = {
        "mass.mass": 0.1,
        "spring.stiffness": 0.1,
        "damper.damping": 0.3,
        "rub.level": 0.3,
    }
    parts = {
        "mass": 2.0,
        "stiffness": 800.0,
        "damping": 8.0,
        "beside": [friction("mass", "ground", 0.8)],
    }
    model = oscillator(
        "position displacement mass", base="moved", uncertainty=spread, **parts
    )
    t, rng, tables = np.arange(3000) * 5e-3, np.random.default_rng(1), []
    for run in range(2):
        base = _smooth(np.random.default_rng(run), t, 5.0, 0.003)
        y = simulate(model.to_dict(), t, {"moved": base})["position"]
        y = y + 0.003 * y.std() * rng.standard_normal(len(y))
        tables.append(
            Table(time=t, columns={"moved": base, "position": y}, source=f"run{run}")
        )
    found = diagnose(tables, model, settings=SearchSettings(depth=0, jobs=1)).parameters
    # precisions of the statements on the common factor add up
    known = sum(s**-2 for s in spread.values()) ** -0.5
    for path in ("mass.mass", "spring.stiffness"):
        deviation = 0.5 * np.log(found[path].high / found[path].low) / 1.96
        assert 0.7 * known < deviation <= 1.01 * spread[path]


@pytest.mark.parametrize("copies", [1, 17])
def test_unmodelled_effects_together_have_no_more_power_than_the_residual(copies):
    """Seventeen laws that do the same leave a value as open as one of them does."""
    response, residual = np.full((100, copies), 3.0), 50.0
    sizes = sizes_within(response.T @ response, residual)
    assert np.sum((response @ sizes) ** 2) == pytest.approx(residual)
