"""A road that nobody measured, in the likelihood: what motion alone tells, and what a known force adds."""

import numpy as np
import pytest

from isd_gym import simulate
from isd_gym.data import Table
from isd_gym.discrepancy.unmeasured import identify
from isd_gym.errors import InputError
from isd_gym.network import Network

LEVEL = (2 * np.pi) ** 2 * 5e-7 * 20  # two-sided intensity of the road's velocity [m^2/s]
FREE = {
    "body.mass": 0.1,
    "wheel.mass": 0.1,
    "main_spring.stiffness": 0.1,
    "damper.damping": 0.3,
    "tyre.stiffness": 0.1,
}


def car(motor):
    data = Network.load("quarter-car-passive").to_dict()
    data["outputs"] = [
        {"name": "a", "quantity": "acceleration", "at": "body", "unit": "m/s^2"},
        {"name": "w", "quantity": "acceleration", "at": "wheel", "unit": "m/s^2"},
        {"name": "l", "quantity": "displacement", "between": ["body", "wheel"], "unit": "m"},
    ]
    if motor:
        data["elements"].append(
            {
                "name": "motor",
                "type": "motor",
                "between": ["body", "wheel"],
                "thrust_constant": 60.0,
                "ratio": 4.0,
            }
        )
        data["inputs"].append({"name": "current", "quantity": "current", "element": "motor", "unit": "A"})
    return Network.load({**data, "uncertainty": FREE})


def drives(truth, motor, seconds=20.0, seed=1):
    rng, h, out = np.random.default_rng(seed), 1e-3, []
    for k in range(2):
        t = np.arange(0, seconds, h)
        road = np.concatenate([[0.0], np.cumsum(rng.standard_normal(len(t) - 1) * np.sqrt(LEVEL * h))])
        current = np.repeat(rng.uniform(-4, 4, len(t) // 20), 20)
        y = simulate(truth, t, {"road": road, "current": current})
        columns = {n: (v + 0.01 * np.std(v) * rng.standard_normal(len(t)))[::4] for n, v in y.items()}
        if motor:
            columns["current"] = current[::4]
        out.append(Table(time=t[::4], columns=columns, source=f"drive_{k}"))
    return out


@pytest.mark.slow
@pytest.mark.parametrize("motor", [False, True])
def test_motion_tells_ratios_to_mass_and_a_motor_sets_the_scale(motor):
    truth = car(motor)
    owner = truth.with_parameters({"damper.damping": 1950.0, "tyre.stiffness": 207e3})
    found = identify(drives(truth, motor), owner, effects=False)
    assert found.ratios_only is not motor
    assert found.level.low < LEVEL < found.level.high
    true, got = truth.parameters, {k: q.value for k, q in found.parameters.items()}
    size = got["body.mass"] / true["body.mass"]
    assert motor is (abs(size - 1) < 0.01)
    for path in ("main_spring.stiffness", "damper.damping"):
        assert got[path] / true[path] / size == pytest.approx(1.0, abs=0.01)
    assert ("body.mass" in found.determined) is motor
    for path, q in found.parameters.items():
        assert q.low * 0.98 < true[path] < q.high * 1.02


def test_what_is_asked_for_wrongly_is_said_in_a_line():
    with pytest.raises(InputError, match="must be one moved node's displacement"):
        identify([], car(False), road="street")
    with pytest.raises(InputError, match="data: no records"):
        identify([], car(False))
    cell = car(False).to_dict()
    cell["outputs"].append({"name": "F", "quantity": "force", "at": "road", "unit": "N"})
    with pytest.raises(InputError, match="who has that has the road"):
        identify([], Network.load(cell))
