"""Noise of a motion that is differentiated twice: part of the noise of the computed force, and a reason to swap roles."""

import builders
import numpy as np
import pytest
from builders import channel, damper, element, spring

from isd_gym import Table, diagnose
from isd_gym.diagnosis import SearchSettings
from isd_gym.diagnosis._estimation.exchanged_roles import (
    prefer_direct_problem,
    swap_roles,
)
from isd_gym.diagnosis._estimation.noise import floors_of, propagate_input_noise
from isd_gym.diagnosis._records.filtering import estimate_white_noise
from isd_gym.diagnosis._simulation.problem import Problem, Record

STEP, SAMPLES = 0.01, 3000
MASS, DAMPING, STIFFNESS = 3.0, 4.0, 120.0
LIMITS = SearchSettings().input_noise, SearchSettings().swapped_error


def rig(stiffness=STIFFNESS):
    """A carriage whose measured motion is the input, with the force at it as output."""
    ground, known = (
        ("carriage", "ground"),
        {"inertia.inertance": 0.1, "guide.damping": 0.5},
    )
    elements = [
        element("inertia", "inertance", *ground, inertance=MASS),
        damper(*ground, DAMPING, "guide"),
    ]
    elements += [spring(*ground, stiffness)] if stiffness else []
    position = channel("position", "displacement", "carriage", unit="mm")
    return builders.network(
        "carriage", elements, [position], ["force force carriage"], uncertainty=known
    )


def moved(seed, friction=0.0):
    """(position, force) of the carriage on a motion of five sines, known with its derivatives."""
    rng = np.random.default_rng(seed)
    t = np.arange(SAMPLES) * STEP
    x, v, a = np.zeros(SAMPLES), np.zeros(SAMPLES), np.zeros(SAMPLES)
    for f, p in zip((0.31, 0.57, 0.83, 1.21, 1.7), rng.uniform(0, 6, 5), strict=True):
        w, size = 2 * np.pi * f, 0.01 / f
        x, v, a = x + size * np.sin(w * t + p), v + size * w * np.cos(w * t + p), a - size * w**2 * np.sin(w * t + p)  # fmt: skip
    return x, MASS * a + DAMPING * v + STIFFNESS * x + friction * np.sign(v)


def pushed(seed, stiffness=STIFFNESS, friction=0.0):
    """(position, force) of the carriage under a known random force, in fine Euler steps with projected friction."""
    rng = np.random.default_rng(seed)
    t, fine = np.arange(SAMPLES) * STEP, 20
    force = builders.sines(t, np.arange(0.2, 2.2, 0.13), rng.uniform(0, 6, 16), 2.0)
    x, v, out = 0.0, 0.0, np.empty(SAMPLES)
    for k in range(SAMPLES):
        out[k] = x
        after = force[min(k + 1, SAMPLES - 1)]
        for i in range(fine):
            f = force[k] + (after - force[k]) * i / fine
            v += (f - DAMPING * v - stiffness * x) / MASS * STEP / fine
            reach = friction / MASS * STEP / fine
            v -= float(np.clip(v, -reach, reach))
            x += v * STEP / fine
    return out, np.asarray(force)


def as_record(position, force, encoder, seed=0, cell=0.02):
    """A record with white noise of the encoder [m] and of the load cell [N]."""
    rng = np.random.default_rng(100 + seed)
    seen = position + encoder * rng.standard_normal(len(position))
    return Record(f"run {seed}", STEP, {"position": seen}, (force + cell * rng.standard_normal(len(force)))[:, None])  # fmt: skip


@pytest.mark.parametrize("encoder", [2e-5, 1e-4])
@pytest.mark.parametrize("friction", [0.0, 2.0])
def test_the_noise_of_the_encoder_is_seen_in_the_computed_force(encoder, friction):
    """Reference: the force computed from the noisy motion, minus that computed from the motion itself."""
    network = rig()
    clean = [moved(k, friction) for k in range(2)]
    problem = Problem(
        network,
        [as_record(*c, encoder, k) for k, c in enumerate(clean)],
        ["fit", "fit"],
    )
    bare = Problem(
        network, [as_record(*c, 0.0, k) for k, c in enumerate(clean)], ["fit", "fit"]
    )
    noisy, true = (p.simulate_all([network], [0, 1]) for p in (problem, bare))
    expected = np.std(np.concatenate([noisy[i] - true[i] for i in (0, 1)]))
    assert expected > 2 * 0.02  # it rules over the noise of the cell
    assert propagate_input_noise(problem)[0] == pytest.approx(expected, rel=0.2)
    (floor,) = floors_of(problem)
    assert floor.known and floor.deviation > 0.8 * expected
    if not friction:  # the harmonics of friction look like noise of the sensor
        assert floor.source == "input" and floor.deviation < 1.4 * expected


def test_white_noise_is_told_from_smooth_motion():
    rng = np.random.default_rng(4)
    x, _ = moved(0)
    noise = 1e-5 * rng.standard_normal(SAMPLES)
    assert estimate_white_noise(x + noise) == pytest.approx(1e-5, rel=0.1)
    assert estimate_white_noise(x) < 1e-9


@pytest.mark.parametrize("friction", [0.0, 2.0])
def test_a_clean_motion_has_no_noise_to_pass_on(friction):
    problem = Problem(rig(), [as_record(*moved(0, friction), 0.0)], ["fit"])
    assert propagate_input_noise(problem)[0] < 0.02
    assert floors_of(problem)[0].source != "input"


def test_swapped_roles_are_the_same_carriage():
    """The force that the first model computes for a motion drives the second model along this motion."""
    network = rig()
    swapped = swap_roles(network, network.inputs[0], network.outputs[0])
    assert [(c.name, c.quantity, c.unit) for c in swapped.inputs] == [
        ("force", "force", "N")
    ]
    assert [(c.name, c.quantity, c.unit) for c in swapped.outputs] == [
        ("position", "displacement", "mm")
    ]
    x, force = pushed(0)
    record = Record("run", STEP, {"force": force}, 1e3 * x[:, None])
    seen = Problem(swapped, [record], ["fit"]).simulate([swapped], 0)[:, 0, 0]
    assert np.std(seen - 1e3 * x) < 0.01 * np.std(1e3 * x)


def test_the_direct_problem_is_preferred_where_noise_rules_the_inverse_one():
    records = [as_record(*pushed(k), 3e-4, k) for k in range(3)]
    found = prefer_direct_problem(records, rig(), 2, *LIMITS)
    assert found is not None
    turned, network, note = found
    assert [c.name for c in network.inputs] == ["force"]
    assert turned[0].measured[:, 0] == pytest.approx(
        1e3 * records[0].inputs["position"]
    )
    assert turned[2].inputs["force"] == pytest.approx(records[2].measured[:, 0])
    assert note.startswith("force is taken as input and position as output: noise of position, differentiated twice, would be ")  # fmt: skip
    quiet = [as_record(*pushed(k), 1e-7, k) for k in range(3)]
    assert prefer_direct_problem(quiet, rig(), 2, *LIMITS) is None


def as_table(r):
    columns = {"position": 1e3 * r.inputs["position"], "force": r.measured[:, 0]}
    return Table(
        STEP * np.arange(len(r)), columns, r.name, {"position": "mm", "force": "N"}
    )


def constant_speed(speed, seed, friction):
    """(position, force) at a constant speed: the force balances friction and says nothing about the motion."""
    t = np.arange(SAMPLES // 6) * STEP
    ripple = 0.3 * np.random.default_rng(seed).standard_normal(len(t))
    return speed * t, SOFT * speed * t + DAMPING * speed + friction * np.sign(
        speed
    ) + ripple


SOFT = 20.0  # [N/m]
SPEEDS = (0.02, -0.05, 0.1, -0.2, 0.15, -0.1, 0.05, -0.15)


def test_a_motion_that_the_force_does_not_determine_is_no_direct_problem():
    """Constant speeds: a straight line follows the motion better than any model with a force can."""
    records = [
        as_record(*constant_speed(v, k, 2.0), 3e-4, k) for k, v in enumerate(SPEEDS)
    ]
    assert (
        propagate_input_noise(Problem(rig(SOFT), records, ["fit"] * len(records)))[0]
        > 1.0
    )
    assert prefer_direct_problem(records, rig(SOFT), 5, *LIMITS) is None


@pytest.mark.slow
def test_the_direct_problem_names_what_the_inverse_one_cannot():
    tables = [as_table(as_record(*pushed(k, friction=3.0), 3e-4, k)) for k in range(4)]
    found = diagnose(tables[:2], rig(), validate=tables[2:])
    assert [e.effect for e in found.effects] == ["coulomb_friction"]
    assert found.effects[0].parameters["level"].value == pytest.approx(3.0, rel=0.1)
    assert any(n.startswith("force is taken as input") for n in found.notes)
