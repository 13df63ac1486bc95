"""Laws and places that the search tries, and start values of the fits."""

from dataclasses import replace
from types import SimpleNamespace

import builders
import numpy as np
import pytest
from builders import channel, damper, model
from program import refused
from scipy.integrate import solve_ivp

from isd_gym.diagnosis import diagnose
from isd_gym.diagnosis._estimation.gauss_newton import Fitter
from isd_gym.diagnosis._estimation.noise import white_weights
from isd_gym.diagnosis._estimation.structure import add, base_structure
from isd_gym.diagnosis._hypotheses.law_matching import Match, match_laws
from isd_gym.diagnosis._hypotheses.library import hypotheses
from isd_gym.diagnosis._selection.admissibility import Travel, admissible_matches, is_admissible, is_observed
from isd_gym.diagnosis._selection.screening import Screening
from isd_gym.diagnosis._simulation.problem import Problem, Record
from isd_gym.physics.elements import Start
from isd_gym.physics.network import Network
from isd_gym.records.data import Table


def matched(effect, values, **start):
    structure = base_structure(Network.load("quarter-car-isd"))
    h = next(h for h in hypotheses(structure.network) if h.effect == effect)
    return structure, Match(h, Start(values, **start), values, {}, 1.0)


def test_values_that_no_law_can_have_are_refused():
    """A match may ask for a force without end; a case of it ended a whole diagnosis."""
    structure, much = matched("cogging_force", {"amplitude": 1e12, "pitch": 0.01, "phase": 0.0})
    refused("", much.begin, structure)
    structure, little = matched("cogging_force", {"amplitude": 10.0, "pitch": 0.01, "phase": 0.0})
    built, x = little.begin(structure)
    assert len(x) == len(built.free)
    # a match of another size
    structure, m = matched("coulomb_friction", {"level": 100.0}, grows=("level",))
    built, _ = m.sized(5.0).begin(structure)
    assert built.network.element(built.names[-1]).level == 500.0


def test_a_second_stop_is_a_hypothesis_where_the_first_is_known_for_sure():
    """It may be met before the first; a stop whose clearance the owner is not sure of is refitted instead. Found, it is not put there again."""
    car = Network.load("quarter-car-isd")

    def stops(network):
        found = [h for h in hypotheses(network) if h.effect == "bump_stop"]
        return [h for h in found if set(h.where) == {"piston", "joint"}]

    assert car.element("end_stop").type == "bump_stop" and "end_stop.clearance" not in car.uncertainty
    assert [dict(h.options)["side"] for h in stops(car)] == ["both", "extension", "compression"]
    assert not stops(replace(car, uncertainty={**car.uncertainty, "end_stop.clearance": 0.1}))
    found = add(base_structure(car), stops(car)[0], {"clearance": 0.01, "stiffness": 2e5})
    current, problem = SimpleNamespace(structure=found), SimpleNamespace(network=car)
    stage = SimpleNamespace(current=current, problem=problem)
    assert not any(Screening.is_sensible(stage, h) for h in stops(found.network))
    # two springs are one spring
    assert not any(h.effect == "linear_stiffness" and h.where == ("body", "wheel") for h in hypotheses(car))


KNOWN = {"inertias": {"drum": 14.0}, "uncertainty": {"bearing.damping": 2.0}}
DRUM = model("drum", [damper("drum", "ground", 0.1, "bearing")], [], ["speed angular_velocity drum"], **KNOWN)


def coast_down(speed, seed, friction, drag):
    """Return the speed of a drum that coasts down by friction [N m], damping and drag [N m s^2/rad^2], with noise of an encoder."""

    def slowing(_, v):
        return -(friction + 0.02 * v + drag * v * abs(v)) / 14.0

    time = np.arange(0.0, 80.0, 0.2)
    found = solve_ivp(slowing, (0.0, time[-1]), [speed], t_eval=time, rtol=1e-9, atol=1e-9)
    noise = 0.02 * np.random.default_rng(seed).standard_normal(len(time))
    return Table(time, {"speed": found.y[0] + noise}, f"run{seed}")


@pytest.mark.slow
def test_a_coast_down_whose_speed_alone_is_measured_shows_no_spring():
    runs = [coast_down(v, k, 4.0, 0.003) for k, v in enumerate((42.0, 43.0, 39.0, 45.0))]
    d = diagnose(runs[:2], DRUM, validate=runs[2:])
    stated = {e.effect for e in d.effects} | {e for c in d.contenders for e in c.effects}
    assert stated
    assert not stated & {"cubic_stiffness", "linear_stiffness", "bump_stop", "gas_spring", "hysteresis"}


def test_the_angle_follows_from_a_sensor_or_from_a_spring_but_not_from_a_speed():
    pair = ("drum", "ground")
    spring = builders.spring(*[*pair], stiffness=3.0, name="s")
    angle = channel("angle", "angle", "drum")
    held = DRUM | {"elements": [*DRUM["elements"], spring]}
    seen = DRUM | {"outputs": [angle]}
    offset = DRUM | {"outputs": [angle | {"offset": "record"}]}
    told = [is_observed(Network.load(m), pair) for m in (DRUM, held, seen, offset)]
    assert told == [False, True, True, False]


@pytest.mark.parametrize(("is_driven", "passes"), [(True, 1.0), (False, 1.0), (False, 2.0)])
def test_a_coast_down_without_a_known_travel_shows_no_compliance(is_driven, passes):
    """The deflection of a compliance in line with a damper may start anywhere: it is any smooth function of time, as a spring's force is."""
    travel = Travel(is_observed=False, passes=passes, span=10.0, advance=0.1, is_driven=is_driven)
    kinds = {h.effect: h for h in hypotheses(Network.load(DRUM))}
    told = {name: is_admissible(kinds[name], {kinds[name].where: travel}) for name in kinds}
    assert told["series_compliance"] == (is_driven or passes > 1.5)
    assert told["linear_stiffness"] == (passes > 1.5) and told["coulomb_friction"]


def test_no_pitch_is_offered_that_is_finer_than_the_samples():
    time = np.arange(100) * 0.05
    angle = channel("angle", "angle", "drum")
    network = Network.load(DRUM | {"outputs": [angle]})
    measured = (5.0 * time + 0.1 * np.sin(9.0 * time))[:, None]
    problem = Problem(network, [Record("spin", 0.05, {}, measured)])
    fitter = Fitter(problem, white_weights(np.array([0.01])))
    fit = fitter.fit(base_structure(network))
    offered = [h for h in hypotheses(network) if h.kind.periodic]
    noise = np.array([0.01])

    def pitches(starts):
        return [s.values["pitch"] for s in starts]

    every = pitches(match_laws(problem, fitter, fit, noise, offered))
    kept = pitches(admissible_matches(problem, fitter, fit, noise, offered))
    finest = 2.5 * 0.25  # samples of a period times travel of a sample [rad]
    assert min(every) < finest < 1.05 * min(kept)
    assert len(kept) < len(every)


@pytest.mark.parametrize(
    ("travel", "period", "is_seen"),
    [
        (Travel(is_observed=True, passes=1.0, span=10.0, advance=0.1), 0.3, True),
        (Travel(is_observed=True, passes=1.0, span=10.0, advance=0.2), 0.3, False),  # finer than the samples
        (Travel(is_observed=False, passes=1.0, span=10.0, advance=0.1), 2.0, True),
        (Travel(is_observed=False, passes=1.0, span=10.0, advance=0.1), 4.0, False),  # one repetition
        (Travel(is_observed=False, passes=2.0, span=10.0, advance=0.1), 4.0, True),
    ],
)
def test_a_period_is_seen_where_samples_resolve_it_and_the_travel_holds_it_often(travel, period, is_seen):
    assert travel.shows_period(period) == is_seen
