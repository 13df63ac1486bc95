"""Laws and places that the search tries, and start values of the fits."""

from dataclasses import replace

import builders
import numpy as np
import pytest
from builders import channel, damper, model
from scipy.integrate import solve_ivp

from isd_gym import Network, Table, diagnose
from isd_gym.diagnosis import hypotheses
from isd_gym.diagnosis._selection.admissibility import (
    Travel,
    is_admissible,
    is_observed,
)


def test_a_second_stop_is_a_hypothesis_where_the_first_is_known_for_sure():
    """It may be met before the first; a stop whose clearance the owner is not sure of is refitted instead."""
    car = Network.load("quarter-car-isd")

    def stops(network):
        found = [h for h in hypotheses(network) if h.effect == "bump_stop"]
        return [h for h in found if set(h.where) == {"piston", "joint"}]

    assert (
        car.element("end_stop").type == "bump_stop"
        and "end_stop.clearance" not in car.uncertainty
    )
    assert [dict(h.options)["side"] for h in stops(car)] == [
        "both",
        "extension",
        "compression",
    ]
    assert not stops(
        replace(car, uncertainty={**car.uncertainty, "end_stop.clearance": 0.1})
    )
    # two springs are one spring
    assert not any(
        h.effect == "linear_stiffness" and h.where == ("body", "wheel")
        for h in hypotheses(car)
    )


KNOWN = {"inertias": {"drum": 14.0}, "uncertainty": {"bearing.damping": 2.0}}
DRUM = model(
    "drum",
    [damper("drum", "ground", 0.1, "bearing")],
    [],
    ["speed angular_velocity drum"],
    **KNOWN,
)


def coast_down(speed, seed, friction, drag):
    """Return the speed of a drum that coasts down by friction [N m], damping and drag [N m s^2/rad^2], with noise of an encoder."""

    def slowing(_, v):
        return -(friction + 0.02 * v + drag * v * abs(v)) / 14.0

    time = np.arange(0.0, 80.0, 0.2)
    found = solve_ivp(
        slowing, (0.0, time[-1]), [speed], t_eval=time, rtol=1e-9, atol=1e-9
    )
    noise = 0.02 * np.random.default_rng(seed).standard_normal(len(time))
    return Table(time, {"speed": found.y[0] + noise}, f"run{seed}")


@pytest.mark.slow
def test_a_coast_down_whose_speed_alone_is_measured_shows_no_spring():
    runs = [
        coast_down(v, k, 4.0, 0.003) for k, v in enumerate((42.0, 43.0, 39.0, 45.0))
    ]
    d = diagnose(runs[:2], DRUM, validate=runs[2:])
    stated = {e.effect for e in d.effects} | {
        e for c in d.alternatives for e in c.effects
    }
    assert stated
    assert not stated & {
        "cubic_stiffness",
        "linear_stiffness",
        "bump_stop",
        "gas_spring",
        "hysteresis",
    }


def test_the_angle_follows_from_a_sensor_or_from_a_spring_but_not_from_a_speed():
    pair = ("drum", "ground")
    spring = builders.spring(*[*pair], stiffness=3.0, name="s")
    angle = channel("angle", "angle", "drum")
    held = DRUM | {"elements": [*DRUM["elements"], spring]}
    seen = DRUM | {"outputs": [angle]}
    offset = DRUM | {"outputs": [angle | {"offset": "record"}]}
    told = [is_observed(Network.load(m), pair) for m in (DRUM, held, seen, offset)]
    assert told == [False, True, True, False]


@pytest.mark.parametrize(
    ("is_driven", "passes"), [(True, 1.0), (False, 1.0), (False, 2.0)]
)
def test_a_coast_down_without_a_known_travel_shows_no_compliance(is_driven, passes):
    """The deflection of a compliance in line with a damper may start anywhere: it is any smooth function of time, as a spring's force is."""
    travel = Travel(is_observed=False, passes=passes, is_driven=is_driven)
    kinds = {h.effect: h for h in hypotheses(Network.load(DRUM))}
    told = {
        name: is_admissible(kinds[name], {kinds[name].where: travel}) for name in kinds
    }
    assert told["series_compliance"] == (is_driven or passes > 1.5)
    assert told["linear_stiffness"] == (passes > 1.5) and told["coulomb_friction"]
