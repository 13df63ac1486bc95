"""Laws that are matched to the residual of a fit, along the measured motion."""

from dataclasses import replace

import builders
import numpy as np
import pytest
from builders import damper, element, fitted, oscillator, recorded, sines

from isd_gym.diagnosis._estimation.gauss_newton import Fitter
from isd_gym.diagnosis._estimation.noise import white_weights
from isd_gym.diagnosis._estimation.structure import Hypothesis, add
from isd_gym.diagnosis._hypotheses.law_matching import match_laws
from isd_gym.diagnosis._hypotheses.library import hypotheses
from isd_gym.diagnosis._hypotheses.motion import joined, motions
from isd_gym.diagnosis._hypotheses.pair_forces import force_responses, law_forces, measured_motions
from isd_gym.diagnosis._selection.candidate import Candidate
from isd_gym.diagnosis._selection.screening import Screening, best_of_each_law
from isd_gym.diagnosis._selection.settings import SearchSettings
from isd_gym.diagnosis._simulation.problem import Problem, Record
from isd_gym.physics import elements as el
from isd_gym.physics.simulate import simulate

STEP, NOISE, PLACE = 2e-3, 2e-6, ("mass", "base")


def rig():
    known = {"spring.stiffness": 0.1, "damper.damping": 0.3}
    parts = {"mass": 2.0, "stiffness": 4000.0, "damping": 12.0}
    return oscillator("mass displacement mass", base="base", uncertainty=known, **parts)


def stage(effect="", place=PLACE, **values):
    """Return a record of the rig with a law, and the refitted rig without the law."""
    network, rng = rig(), np.random.default_rng(7)
    t = np.arange(3000) * STEP
    f = np.array([2, 5, 9])
    base = sines(t, f, rng.uniform(0, 6, 3), 0.004 / f)
    true = network.with_element(el.TYPES[effect]("true", place, **values)) if effect else network
    seen = simulate(true, t, {"base": base}, interpolation="auto")["mass"]
    record = Record("run", STEP, {"base": base}, (seen + rng.normal(0, NOISE, len(t)))[:, None])
    problem = Problem(network, [record])
    return problem, fitted(problem, NOISE)


def matches(problem, fit):
    fitter = Fitter(problem, white_weights(np.array([NOISE])))
    return match_laws(problem, fitter, fit, np.array([NOISE]), list(hypotheses(problem.network)))


@pytest.mark.parametrize(
    ("effect", "place", "values"),
    [
        ("coulomb_friction", PLACE, {"level": 1.0}),
        ("quadratic_damping", PLACE, {"damping": 120.0}),
        ("cubic_stiffness", PLACE, {"stiffness": 4e7}),
        ("bump_stop", PLACE, {"clearance": 0.001, "stiffness": 4000.0}),
        ("hysteresis", PLACE, {"level": 8.0, "stiffness": 4000.0}),
        ("sensor_delay", ("mass",), {"delay": 0.004}),
    ],
)
def test_the_law_that_is_missing_is_among_the_first_matches(effect, place, values):
    found = matches(*stage(effect, place, **values))
    laws = list(dict.fromkeys((m.hypothesis.effect, m.hypothesis.where) for m in found))
    assert (effect, place) in laws[:3], laws[:6]


def test_the_measured_motion_is_nearer_to_the_truth_than_the_simulated_motion():
    problem, fit = stage("cubic_stiffness", stiffness=4e8)
    record = problem.records[0]
    true = record.measured[:, 0] - record.inputs["base"]
    measured = measured_motions(problem, fit, np.array([NOISE]))[PLACE][0].d
    simulated = motions(problem, fit)[PLACE].d
    assert np.std(measured - true) < 0.5 * np.std(simulated - true)


def test_the_response_to_a_force_is_the_change_by_the_element():
    problem, fit = stage()
    motion = measured_motions(problem, fit, np.array([NOISE]))[PLACE]
    h = next(h for h in hypotheses(problem.network) if h.effect == "cubic_stiffness" and h.where == PLACE)
    values = {"stiffness": 1e3}
    force = law_forces(fit.network, PLACE, joined(motion), STEP, [(h, values)])
    assert force[:, 0] == pytest.approx(1e3 * motion[0].d ** 3, rel=1e-4, abs=1e-8)
    change = force_responses(problem, fit, PLACE, {0: force})[0][:, 0, 0]
    cubic = fit.network.with_element(el.TYPES["cubic_stiffness"]("more", PLACE, **values))
    initial = fit.initial[0][:, None]
    both = [problem.simulate([n], 0, initial, like=fit.network)[:, 0, 0] for n in (cubic, fit.network)]
    assert np.std(change - (both[0] - both[1])) < 0.03 * np.std(change)


def test_the_response_of_a_pendulum_in_full_swing_is_the_change_by_the_element():
    place = ("arm", "ground")
    parts = [element("gravity", "gravity_sine", *place, torque=10.0), damper(*place, 0.05, "bearing")]
    known = {"inertias": {"arm": 1.0}, "uncertainty": {"gravity.torque": 0.05}}
    network = builders.network("pendulum", parts, [], ["angle angle arm"], **known)
    problem = Problem(network, [recorded(network, 0.02, {}, 500, [1.0, 0.0])])
    assert np.max(np.abs(problem.records[0].measured)) > 0.9  # the start is not lost
    fit = fitted(problem, 1e-4)
    motion = measured_motions(problem, fit, np.array([1e-4]))[place]
    h = next(h for h in hypotheses(network) if h.effect == "coulomb_friction" and h.where == place)
    force = law_forces(fit.network, place, joined(motion), 0.02, [(h, {"level": 1e-3})])
    change = force_responses(problem, fit, place, {0: force})[0][:, 0, 0]
    slowed = fit.network.with_element(el.TYPES["coulomb_friction"]("more", place, level=1e-3))
    initial = fit.initial[0][:, None]
    both = [problem.simulate([n], 0, initial, like=fit.network)[:, 0, 0] for n in (slowed, fit.network)]
    assert np.std(change - (both[0] - both[1])) < 0.05 * np.std(change)


def test_friction_that_holds_the_mass_is_found_by_simulation():
    screening = Screening(*stage("coulomb_friction", level=5.0), np.array([NOISE]), SearchSettings())
    near = [(g[0].hypothesis.effect, g[0].hypothesis.where) for g in screening.shortlist()]
    assert ("coulomb_friction", PLACE) in near[:6]


def test_a_force_that_repeats_is_read_from_one_period():
    h, d = Hypothesis("cogging_force", PLACE), np.linspace(-0.03, 0.05, 999)
    ways = [
        (replace(h, where=w), {"amplitude": 10.0, "pitch": 0.02, "phase": 0.5}) for w in (PLACE, PLACE[::-1])
    ]
    forces = law_forces(rig(), PLACE, el.Motion(d, 0 * d, 0 * d), STEP, ways)
    angle = 2 * np.pi * d / 0.02
    assert forces == pytest.approx(10 * np.sin(np.array([angle + 0.5, angle - 0.5]).T), abs=0.01)


def test_a_law_that_dissipates_starts_with_less_damping_and_the_same_work():
    """The damping of a model without the law has taken the law's work, and a staircase of optima may lie between the two."""
    problem, fit = stage("coulomb_friction", level=1.0)
    screening = Screening(problem, fit, np.array([NOISE]), SearchSettings())
    here = (m for m in screening.matches if set(m.hypothesis.where) == set(PLACE))
    match = next(m for m in here if m.hypothesis.effect == "coulomb_friction")
    assert match.values["level"] == pytest.approx(1.0, rel=0.3)
    assert set(match.moved) == {"spring.stiffness", "damper.damping"}
    rate = screening.motion[PLACE].v

    def values(begun):
        structure, x = begun
        return {f.path: f.back(float(v)) for f, v in zip(structure.free, x, strict=True)}

    def work(v):
        return float(np.mean(v["damper.damping"] * rate**2 + v["coulomb_friction.level"] * np.abs(rate)))

    known = values(match.begin(fit.structure))
    begun = [values(start) for start in screening.starts_with_less_damping(match)]
    assert [v["damper.damping"] / known["damper.damping"] for v in begun] == pytest.approx(
        [0.5, 0.46], abs=0.1
    )
    assert [work(v) / work(known) for v in begun] == pytest.approx([1.0, 1.0], rel=0.02)
    spring = next(m for m in screening.matches if m.hypothesis.effect == "cubic_stiffness")
    assert not list(screening.starts_with_less_damping(spring))


def test_the_best_fit_of_each_law_is_a_candidate():
    _, fit = stage("coulomb_friction", level=1.0)
    other = replace(
        fit,
        structure=add(fit.structure, Hypothesis("cubic_stiffness", ("mass", "ground")), {"stiffness": 1e6}),
    )
    best, rival, worse = Candidate(fit, 1.0), Candidate(other, 2.0), Candidate(fit, 3.0)
    assert best_of_each_law([worse, rival, None, Candidate(fit, np.nan), best]) == [best, rival]
