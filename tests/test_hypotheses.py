"""Laws and places that the search tries, and start values of the fits."""

import builders
import numpy as np
import pytest
from builders import channel, damper, model, network, spring
from scipy.integrate import solve_ivp

from isd_gym.diagnosis import diagnose
from isd_gym.diagnosis._hypotheses.library import hypotheses
from isd_gym.diagnosis._selection.admissibility import Travel, is_admissible, is_observed
from isd_gym.physics.elements import Motion
from isd_gym.physics.network import Network
from isd_gym.records.data import Table


def car():
    return Network.load("quarter-car-isd")


def law(effect, *where):
    here = (h for h in hypotheses(car()) if set(h.where) == set(where) and not h.behind)
    return next(h for h in here if h.effect == effect)


MASSES = {"hub": 340.0, "rim": 20.0}
STIFF = spring("rim", "hub", 6e6)
SHAFT = network("shaft", [STIFF], ["push force hub"], ["speed velocity rim"], masses=MASSES)
TIME = np.linspace(0.0, 10.0, 2000)
SPEED = 20.0 * np.exp(-0.2 * TIME)


def moving(ripple):
    """Motion of hub and rim, which run down together beside a torsional vibration of the rim."""
    swing = ripple * np.sin(40.0 * TIME)
    travel = np.cumsum(SPEED) * (TIME[1] - TIME[0])
    still = np.zeros_like(TIME)
    hub, rim = Motion(travel, SPEED, still), Motion(travel + swing / 40.0, SPEED + swing, still)
    between = Motion(swing / 40.0, swing, still)
    return {("hub", "ground"): hub, ("rim", "ground"): rim, ("rim", "hub"): between}


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
