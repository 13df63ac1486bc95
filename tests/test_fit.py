"""The diagnosis' fitter: its bounded step, records side by side, slopes used again, fewer samples to search by."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from builders import (
    damper,
    element,
    fitted,
    friction,
    network,
    oscillator,
    recorded,
    rms,
    sines,
    spring,
)
from scipy.optimize import lsq_linear

from isd_gym import InputError, Network, simulate
from isd_gym.diagnosis import hypotheses
from isd_gym.diagnosis._estimation.gauss_newton import Fitter
from isd_gym.diagnosis._estimation.least_squares import (
    PROBE,
    QuadraticModel,
    Slope,
    bounded_step,
)
from isd_gym.diagnosis._estimation.noise import white_weights
from isd_gym.diagnosis._estimation.structure import Free, add, base_structure
from isd_gym.diagnosis._hypotheses.law_matching import starts_of
from isd_gym.diagnosis._hypotheses.motion import motions, simulate_variants
from isd_gym.diagnosis._simulation.problem import Problem, Record

STEP = 2e-3


def shaken(stiffness=4000.0):
    known = {"spring.stiffness": 0.1, "damper.damping": 0.1}
    parts = {
        "stiffness": stiffness,
        "damping": 12.0,
        "beside": [friction("mass", "base", 2.0)],
    }
    return oscillator(
        "mass displacement mass", mass=2.0, base="base", uncertainty=known, **parts
    )


def record(network, samples=2400, seed=3):
    """Made with the steps that the fit takes: what the steps make of dry friction is not what is tested here."""
    rng = np.random.default_rng(seed)
    t = np.arange(samples) * STEP
    f = np.array([2, 5, 9])
    made = recorded(
        network, STEP, {"base": sines(t, f, rng.uniform(0, 6, 3), 0.004 / f)}
    )
    return replace(
        made, measured=made.measured + 1e-5 * rng.standard_normal((samples, 1))
    )


def errors_of_decays(*starts):
    """Errors, as shares of the deviation, of a softening oscillator whose decays from these states are followed over forty periods."""
    soft = element("soft", "cubic_stiffness", "mass", "ground", stiffness=-16.6)
    net = oscillator(
        "mass displacement mass",
        mass=1.0,
        stiffness=72.7,
        damping=0.0124,
        beside=[soft],
    )
    rng, records = np.random.default_rng(0), []
    for state in starts:
        made = recorded(net, 1 / 21, {"push": np.zeros(629)}, initial=state)
        records.append(
            replace(
                made, measured=made.measured + 0.002 * rng.standard_normal((629, 1))
            )
        )
    problem, structure = Problem(net, records), base_structure(net)
    fitter = Fitter(problem, white_weights(np.array([0.002])))
    fit = fitter.follow(structure, structure.start, range(len(records)), iterations=12)
    return [
        np.std(r.measured - fit.outputs[i]) / np.std(r.measured)
        for i, r in enumerate(records)
    ]


def test_a_record_is_followed_whatever_records_stand_beside_it():
    # full steps overshoot in the record of large motion alone
    assert errors_of_decays([0.4, 0.2], [1.5, 3.0])[0] < 0.02
    assert errors_of_decays([1.5, 3.0], [0.4, 0.2])[1] < 0.02


def test_a_motion_whose_phase_follows_its_amplitude_is_followed_from_its_first_samples():
    assert errors_of_decays([1.5, 3.0])[0] < 0.05


def test_a_fit_finds_the_values_that_made_the_record():
    problem = Problem(shaken(), [record(shaken(4400.0))], ["fit"])
    fitter = Fitter(problem, white_weights(np.array([1e-5])))
    structure = base_structure(problem.network)
    fit = fitter.fit(structure)
    assert fit.network.parameters["spring.stiffness"] == pytest.approx(4400.0, rel=1e-3)
    assert fit.network.parameters["damper.damping"] == pytest.approx(12.0, rel=0.02)
    # the slope there is level: a fresh one leads no further
    again = fitter.fit(structure, fit.x, fit.initial, fit.offset)
    assert again.cost + again.prior == pytest.approx(fit.cost + fit.prior, rel=3e-4)


def drive(loss):
    parts = [
        spring("motor", "load", 36.0),
        damper("motor", "load", 0.012, "shaft"),
        damper("motor", "ground", loss, "bearing"),
        friction("load", "ground", 0.15),
    ]
    inertias = {"motor": 0.0021, "load": 0.004}
    outputs = ["angle angle motor", "speed angular_velocity load"]
    known = {"bearing.damping": 1.0, "spring.stiffness": 0.1, "motor.inertia": 0.1}
    given = {"inertias": inertias, "uncertainty": known}
    return network("drive", parts, ["torque torque motor"], outputs, **given)


@pytest.mark.parametrize("loss", [0.013, 0.02])
def test_a_drive_that_friction_stops_is_fitted_from_far(loss):
    """The slopes promise initial states that lose the motion: they need the damping of the parameters, too."""
    rng = np.random.default_rng(0)
    torque = np.repeat(rng.uniform(-0.6, 0.6, 20), 100)
    made = recorded(drive(0.004), STEP, {"torque": torque})
    noise = np.array([1e-3, 0.05]) * rng.standard_normal(made.measured.shape)
    problem = Problem(drive(loss), [replace(made, measured=made.measured + noise)])
    fit = fitted(problem, 0.01, 0.1, iterations=12)
    assert fit.network.parameters["bearing.damping"] == pytest.approx(0.004, rel=0.03)


def test_of_many_records_each_finds_its_own_beginning():
    net = shaken()
    whole = record(net, 3000)
    parts = [whole.part(k * 600, (k + 1) * 600, "run") for k in range(5)]
    problem = Problem(net, parts, ["fit"] * 5)
    structure = base_structure(net)
    fit = Fitter(problem, white_weights(np.array([1e-5]))).follow(
        structure, structure.start, range(5)
    )
    for i, part in enumerate(parts):
        assert rms(part.measured - fit.outputs[i]) < 0.02 * part.measured.std()


def test_fewer_samples_tell_the_same_where_they_lie_far_above_the_motion():
    net = shaken().without_element("rub")  # of first order in the step
    problem = Problem(net, [record(net)], ["fit"])
    few = problem.rough
    assert few is not problem
    assert len(few.records[0]) == len(
        problem.records[0].measured[:: round(few.records[0].step / STEP)]
    )
    said = few.simulate([net], 0)[:, 0, 0]
    seen = few.records[0].measured[:, 0]
    assert rms(said - seen) < 0.01 * seen.std()


def test_nothing_to_fit_is_a_fit_too():
    gas = spring("rod", "ground", 3e3, "gas")
    net = network("dyno", [gas], ["base displacement rod"], ["mass force rod"])
    t = np.arange(800) * STEP
    base = 0.01 * np.sin(9 * t)
    problem = Problem(
        net, [Record("dyno", STEP, {"base": base}, 3e3 * base[:, None])], ["fit"]
    )
    assert fitted(problem, 1.0).cost == pytest.approx(0.0, abs=1e-9)


def test_every_place_of_a_law_is_simulated_beside_the_others():
    """Friction acts at once on a massless terminal and not on a mass: such lanes are no plant together, and none is lost."""
    net = Network.load("quarter-car-isd").without_element("seal")
    time = 2.5e-3 * np.arange(200)
    inputs = {"road": 0.01 * np.sin(20 * time), "current": np.sign(np.sin(9 * time))}
    y = np.stack([simulate(net, time, inputs)[c.name] for c in net.outputs], axis=1)
    problem = Problem(net, [Record("run", 2.5e-3, inputs, y, {})], ["fit"])
    fit = fitted(problem, *y.std(axis=0), iterations=0)
    tried = [
        h
        for h in hypotheses(net)
        if h.effect in ("coulomb_friction", "hysteresis", "linear_damping")
    ]
    starts = starts_of(problem, fit, motions(problem, fit), tried)
    built = [add(fit.structure, h, start.ways[0]) for h, start in starts]
    seen = {}
    for chunk, lanes in simulate_variants(problem, fit, [b.network for b in built]):
        seen |= zip(chunk, np.moveaxis(lanes[0], 2, 0), strict=True)
    assert len(seen) == len(built) > 10
    places = {
        b.hypotheses[-1].where
        for b in built
        if b.hypotheses[-1].effect == "coulomb_friction"
    }
    assert {("piston", "joint"), ("body", "wheel")} <= places
    base = problem.simulate(
        [fit.network], 0, fit.initial[0][:, None], like=fit.network
    )[:, :, 0]
    assert all(np.abs(y - base).max() > 0 for y in seen.values())


def test_one_that_breaks_down_takes_no_other_along(monkeypatch):
    net = shaken()
    problem = Problem(net, [record(net)], ["fit"])
    fit = fitted(problem, 1.0, iterations=0)
    whole, bad = Problem.simulate_all, shaken(5000.0)

    def breaks(self, networks, *args, **more):
        if any(n is bad for n in networks):
            raise InputError("broken")
        return whole(self, networks, *args, **more)

    monkeypatch.setattr(Problem, "simulate_all", breaks)
    networks = [shaken(3000.0 + 10 * k) for k in range(5)]
    networks.insert(2, bad)
    done = sorted(
        k for chunk, _ in simulate_variants(problem, fit, networks) for k in chunk
    )
    assert done == [0, 1, 3, 4, 5]


@pytest.mark.parametrize("seed", range(20))
def test_without_damping_it_is_no_worse_than_the_clipped_step_and_stays_inside(seed):
    rng = np.random.default_rng(seed)
    p = 4
    A, b = rng.standard_normal((12, p)), rng.standard_normal(12)
    x = np.zeros(p)
    low, high = -rng.uniform(0, 0.3, p), rng.uniform(0, 0.3, p)
    step = bounded_step(A.T @ A, A.T @ b, x, low, high, np.full(p, np.inf), 0.0)
    assert np.all(x + step >= low) and np.all(x + step <= high)
    free = np.linalg.solve(A.T @ A, A.T @ b)
    if np.all((free > low) & (free < high)):
        np.testing.assert_allclose(step, free)
        np.testing.assert_allclose(step, lsq_linear(A, b, (low, high)).x, atol=1e-6)


def test_what_rests_on_a_limit_is_held_and_the_rest_moves_as_if_it_were_known():
    H = np.array([[2.0, 1.0], [1.0, 2.0]])
    slope = np.array([-1.0, 1.0])
    low, high = np.zeros(2), np.full(2, 10.0)
    step = bounded_step(H, slope, np.zeros(2), low, high, np.full(2, np.inf), 0.0)
    np.testing.assert_allclose(step, [0.0, 0.5])


def test_an_accelerated_step_errs_by_one_order_less():
    """Two outputs that are curved in two parameters: the error of a step without damping falls with the square of the distance, and with
    its third power where the step is accelerated."""

    def outputs(x):
        return np.array([np.exp(x[0]) + x[1], x[0] * x[1], x[1] ** 2 + x[0]])

    x = np.array([0.3, 0.7])
    free = [Free(n, False, 0.0, 1e6, -9.0, 9.0, 0) for n in "ab"]
    structure = SimpleNamespace(free=free, mean=np.zeros(2), sigma=np.full(2, 1e6))
    by = np.array([[np.exp(x[0]), 1.0], [x[1], x[0]], [1.0, 2 * x[1]]])
    slope = Slope(by, by.T @ by, np.zeros((0, 0)), np.zeros((0, 0)))
    errors = []
    for size in (0.08, 0.04):
        truth = x + size * np.array([0.6, -0.8])
        down = by.T @ (outputs(truth) - outputs(x))
        model = QuadraticModel(structure, x, 0, {0: slope}, {0: down})
        plain = model.step(0.0)
        change = outputs(x + PROBE * plain.x) - outputs(x)
        bent = model.accelerated(plain, {0: change}, 0.0)
        errors.append([np.linalg.norm(x + s.x - truth) for s in (plain, bent)])
    orders = np.log2(np.array(errors[0]) / errors[1])
    assert orders == pytest.approx([2.0, 3.0], abs=0.3)
