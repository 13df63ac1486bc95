"""The kernel against physics: analytic limits, energy, its own order, and an integrator that shares nothing with it."""

import numpy as np
import pytest
from builders import friction, network, spring
from program import refused
from rigs import reference
from scipy.signal import lsim, sawtooth

from isd_gym import Network, linearise, simulate
from isd_gym.benchmark.policies import Idle
from isd_gym.benchmark.scoring import Conditions, Entry, drive
from isd_gym.physics.road import paper_road

STEP = 1e-3


def a_road(duration, seed=0, scale=1.0):
    z = paper_road().heights(duration, rng=np.random.default_rng(seed), step=STEP)
    return np.arange(len(z)) * STEP, scale * z


def rms(x):
    return np.sqrt(np.mean(np.square(x)))


def currents(time, amplitude, seed=0):
    """A current held for 5 ms at a time."""
    rng = np.random.default_rng(seed)
    walk = np.cumsum(rng.normal(0, 0.3, len(time) // 5 + 1))
    return np.repeat(np.clip(walk, -amplitude, amplitude), 5)[: len(time)]


CASES = {
    "sticking": ({}, 0.0, 1.0),
    "sliding": ({}, 5.0, 1.0),
    "rough, on the end stop": ({}, 5.0, 4.0),
    "equation 8": ("quarter-car-eq8", 3.0, 1.0),
    "damper set by a current": ("quarter-car-semiactive", 3.0, 1.0),
    "two frictions": ({"type": "coulomb_friction", "between": ["body", "wheel"], "level": 100.0}, 4.0, 1.0),
    "Stribeck": (
        {"type": "stribeck_friction", "between": ["body", "wheel"], "level": 60.0, "static_level": 110.0, "stribeck_velocity": 0.05},
        4.0, 1.0,
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_outputs_agree_with_the_independent_reference(case):
    """RMS of every output of a car within 0.1 % at the shipped step; `test_reference.py` has every law by itself."""
    what, amplitude, scale = CASES[case]
    net = Network.load(what if isinstance(what, str) else "quarter-car-isd")
    if isinstance(what, dict) and what:
        net = net.with_element({"name": "more", **what})
    time, road = a_road(8.0, scale=scale)
    inputs = {"road": road, "current": currents(time, amplitude)}
    ours = simulate(net, time, inputs)
    theirs = reference.simulate(net.to_dict(), time, inputs)
    for name in ours:
        assert rms(ours[name]) == pytest.approx(rms(theirs[name]), rel=1e-3), name


def test_linear_network_is_exact():
    """Without laws the kernel is scipy's own integration of the state space, inputs linear between samples."""
    net = Network.load("quarter-car-passive")
    time, road = a_road(3.0)
    space = linearise(net)
    _, y, _ = lsim((space.A, space.B, space.C, space.D), road, time)
    ours = simulate(net, time, {"road": road})
    for j, name in enumerate(ours):
        np.testing.assert_allclose(
            ours[name], y[:, j], rtol=1e-7, atol=1e-9 * np.abs(y[:, j]).max()
        )


def test_long_run_on_the_papers_road_is_the_analytic_value():
    idle = Entry("passive", lambda: Idle("passive"))
    long = Conditions(episodes=256, duration=40.0)
    run = drive(idle, Network.load("quarter-car-passive"), long)
    keep = slice(1000, None)  # past the start from rest
    assert rms(run.body_acceleration[keep]) == pytest.approx(0.828, rel=0.01)
    assert rms(run.suspension_travel[keep]) == pytest.approx(7.16e-3, rel=0.01)
    assert rms(run.tyre_load[keep]) == pytest.approx(516, rel=0.01)


def test_triangle_test_shows_figure_6():
    """0.1 Hz, 10 mm: a square wave of +-505 N from the series rig; 7.1 kN from equation (6) as printed."""
    time = np.arange(0, 20, STEP)
    x = 0.01 * sawtooth(2 * np.pi * 0.1 * time, 0.5)
    force = simulate("force-rig", time, {"displacement": x})["force"][10_000:]
    plateau = np.abs(force)[np.abs(np.abs(x[10_000:]) - 0.004) < 0.003]
    assert np.median(plateau) == pytest.approx(505, rel=0.01)
    assert plateau.std() < 5
    slow = np.abs(np.gradient(np.gradient(x))) < 1e-12
    parallel = simulate("force-rig-eq6", time, {"displacement": x})["force"]
    assert np.abs(parallel[slow]).max() == pytest.approx(7.6e3, rel=0.01)
    elastic = 709e3 * 0.01
    assert elastic == pytest.approx(7.1e3, rel=0.01)


def test_coulomb_decay_loses_4f_over_k_each_cycle():
    k, f, m = 1e4, 20.0, 100.0
    parts = [spring("mass", "ground", k), friction("mass", "ground", f)]
    net = network("slider", parts, outputs=["x displacement mass"], masses={"mass": m})
    period = 2 * np.pi * np.sqrt(m / k)
    time = np.arange(0, 4.25 * period, STEP)
    x = simulate(net, time, {}, initial=np.array([0.05, 0.0]))["x"]
    peaks = [
        x[int(i * period / STEP) - 5 : int(i * period / STEP) + 6].max()
        for i in range(1, 5)
    ]
    np.testing.assert_allclose(peaks, 0.05 - 4 * f / k * np.arange(1, 5), rtol=2e-3)
    still = simulate(net, time, {}, initial=np.array([0.0019, 0.0]))["x"]
    np.testing.assert_array_equal(still, still[0])  # k x < f: it stays for ever


def test_simulate_refuses_bad_input():
    time = np.arange(100) * STEP
    lost, still = (
        {"road": np.full(100, np.nan), "current": 0 * time},
        {"road": 0 * time, "current": 0 * time},
    )
    uneven = np.sort(np.random.default_rng(0).random(100))
    refused(
        "input 'current' is missing",
        simulate,
        "quarter-car-isd",
        time,
        {"road": 0 * time},
    )
    refused(
        "'road' must hold 100 finite samples", simulate, "quarter-car-isd", time, lost
    )
    refused("uniformly sampled", simulate, "quarter-car-isd", uneven, still)
