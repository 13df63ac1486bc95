"""A refit that stands for the missing effect on the training records misleads the search; the nominal values are a second start."""

import builders
import numpy as np
import pytest
from builders import channel, damper, spring
from scipy.integrate import solve_ivp

from isd_gym.diagnosis import diagnose
from isd_gym.records.data import Table

INERTIA, TORQUE, DAMPING = 0.00333, 0.2139, 2e-4  # [kg m^2], [N m], [N m s/rad]
ARM = builders.network(
    "arm",
    [spring("arm", "ground", TORQUE, "gravity"), damper("arm", "ground", DAMPING, "bearing")],
    outputs=[channel("angle", "angle", "arm"), channel("rate", "angular_velocity", "arm")],
    inertias={"arm": INERTIA},
    uncertainty={"gravity.stiffness": 0.05, "bearing.damping": 1.0},
)


def swings(count, seconds=9.0, step=0.01):
    """Return consecutive parts of one free swing of a pendulum from 1.6 rad, simulated by another integrator."""
    size = round(seconds / step)
    time = np.arange(count * size) * step
    start = [1.6, 0.0]

    def motion(_, state):
        angle, rate = state
        return [rate, (-TORQUE * np.sin(angle) - DAMPING * rate) / INERTIA]

    angle, rate = solve_ivp(motion, (0.0, time[-1]), start, t_eval=time, rtol=1e-9, atol=1e-11).y
    rng = np.random.default_rng(0)
    angle, rate = (y + s * rng.standard_normal(y.size) for y, s in ((angle, 1e-4), (rate, 5e-3)))
    parts = [slice(k * size, (k + 1) * size) for k in range(count)]
    return [Table(time[:size], {"angle": angle[part], "rate": rate[part]}) for part in parts]


@pytest.mark.slow
def test_the_sine_of_gravity_is_named_where_the_refit_softens_the_spring():
    """Large swings are slower. The refitted stiffness is that of the largest, and the small swings of the validation are far off."""
    records = swings(6)
    found = diagnose(records[:4], ARM, validate=records[4:])
    assert found.gap["refit"]["angle"] > 2.0 * found.gap["before"]["angle"]
    assert [e.effect for e in found.effects] == ["gravity_sine"]
    assert found.effects[0].parameters["torque"].value == pytest.approx(TORQUE, rel=1e-3)
    assert found.gap["after"]["angle"] < 0.001
