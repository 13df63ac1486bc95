"""Which laws the motion of the records can show: laws of travel and their periods."""

import builders
import numpy as np
import pytest
from builders import channel, damper, model
from scipy.integrate import solve_ivp

from isd_gym.diagnosis import diagnose
from isd_gym.diagnosis._estimation.gauss_newton import Fitter
from isd_gym.diagnosis._estimation.noise import white_filters
from isd_gym.diagnosis._estimation.structure import base_structure
from isd_gym.diagnosis._hypotheses.law_matching import match_laws
from isd_gym.diagnosis._hypotheses.library import hypotheses
from isd_gym.diagnosis._selection.admissibility import Travel, admissible_matches, is_observed
from isd_gym.diagnosis._simulation.problem import Problem, Record
from isd_gym.physics.network import Network
from isd_gym.records.data import Table

DRUM = model(
    "drum",
    [damper("drum", "ground", 0.1, "bearing")],
    [],
    [channel("speed", "angular_velocity", "drum")],
    inertias={"drum": 14.0},
    uncertainty={"bearing.damping": 2.0},
)


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


def test_no_pitch_is_offered_that_is_finer_than_the_samples():
    time = np.arange(100) * 0.05
    angle = channel("angle", "angle", "drum")
    network = Network.load(DRUM | {"outputs": [angle]})
    measured = (5.0 * time + 0.1 * np.sin(9.0 * time))[:, None]
    problem = Problem(network, [Record("spin", 0.05, {}, measured)])
    fitter = Fitter(problem, white_filters(np.array([0.01])))
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
