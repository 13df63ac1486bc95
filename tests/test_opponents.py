"""Opponents of a law with several parameters: a special case of the law beside one more effect."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

from isd_gym.data import Table
from isd_gym.discrepancy import diagnose
from isd_gym.discrepancy.estimation.structure import Hypothesis

INERTIA, TORQUE, DAMPING, FRICTION, BIAS = 0.0365, 1.146, 0.03, 0.16, 0.011
ARM = ["arm", "ground"]
PENDULUM = {
    "schema": "isd-model/1",
    "name": "arm",
    "inertias": {"arm": INERTIA},
    "elements": [
        {"name": "gravity", "type": "gravity_sine", "between": ARM, "torque": TORQUE},
        {"name": "gear", "type": "linear_damping", "between": ARM, "damping": 0.05},
    ],
    "inputs": [],
    "outputs": [{"name": "angle", "quantity": "angle", "at": "arm", "unit": "rad"}],
    "uncertainty": {"arm.inertia": 0.1, "gravity.torque": 0.03, "gear.damping": 1.0},
}


def drop(angle: float, seed: int) -> Table:
    """Return the angle of a pendulum with dry friction that falls from `angle` [rad], by an encoder that is not set to zero."""

    def motion(_: float, y: np.ndarray) -> list[float]:
        torque = TORQUE * np.sin(y[0]) + DAMPING * y[1] + FRICTION * np.tanh(y[1] / 0.005)
        return [y[1], -torque / INERTIA]

    time = np.arange(0.0, 3.0, 0.01)
    found = solve_ivp(motion, (0.0, time[-1]), [angle, 0.0], "Radau", t_eval=time, rtol=1e-8, atol=1e-9)
    noise = 0.002 * np.random.default_rng(seed).standard_normal(len(time))
    return Table(time, {"angle": found.y[0] + BIAS + noise}, f"drop{seed}")


def test_friction_by_direction_is_not_named_where_friction_and_an_offset_predict_as_well() -> None:
    runs = [drop(a, k) for k, a in enumerate((1.5, -1.3, 1.2, -1.4))]
    d = diagnose(runs[:2], PENDULUM, validate=runs[2:])
    assert not any(e.effect == "asymmetric_friction" for e in d.effects)
    assert any(f.kind == "dry_friction" and set(f.place) == set(ARM) for f in d.findings)


def test_the_parameters_of_an_effect_are_those_that_a_fit_moves() -> None:
    effects = ("coulomb_friction", "asymmetric_friction", "hysteresis", "stribeck_friction")
    assert [Hypothesis(h, ("arm", "ground")).parameters for h in effects] == [1, 2, 2, 3]
