"""The causal bound against figures found beforehand, its own Riccati value and simulation."""

import numpy as np
import pytest

from isd_gym._common.errors import InputError
from isd_gym.contrib.ceilings import bounds
from isd_gym.physics.road import paper_road
from isd_gym.physics.simulate import Plant


@pytest.mark.parametrize(
    ("travel", "tyre", "acceleration"), [(-0.17, -0.006, -0.131), (0.0, 0.0, -0.171), (-0.10, 0.024, -0.186)]
)
def test_best_acceleration_is_design_s(travel, tyre, acceleration):
    best = bounds.best_acceleration(travel, tyre)
    assert best.acceleration_change == pytest.approx(acceleration, abs=1e-3)
    assert best.travel_change == pytest.approx(travel, abs=1e-4)
    assert best.tyre_change == pytest.approx(tyre, abs=1e-4)


def test_reference_is_the_closed_form_of_the_passive_car():
    # known in closed form for a spring-damper quarter car on white velocity S (Newland): travel and tyre load
    ms, mu, k, c, kt, S = 345.0, 45.0, 22e3, 1500.0, 192e3, (2 * np.pi) ** 2 * 5e-7 * 20
    travel2 = S * (ms + mu) / (2 * c)
    accel2 = S * (k**2 * (ms + mu) + kt * c**2) / (2 * c * ms**2)
    rms = bounds.reference()
    assert rms[0] ** 2 == pytest.approx(accel2, rel=1e-6)
    assert rms[1] ** 2 == pytest.approx(travel2, rel=1e-6)


def test_out_of_reach_is_said():
    with pytest.raises(InputError, match="no causal controller"):
        bounds.best_acceleration(-0.5, -0.2)
    with pytest.raises(InputError, match="not random"):
        bounds.reference(road="bump")


def test_bound_does_not_depend_on_the_device():
    a, b = (bounds.lq_bound(n).triple for n in ("quarter-car-isd", "quarter-car-eq8"))
    assert a == pytest.approx(b, rel=1e-9)


def test_motor_without_effort_comes_near_the_bound_and_never_below():
    free = bounds.lq_bound()
    costs = []
    for effort in (1e-2, 1e-6, 1e-10):
        p = bounds.lq_bound(effort=effort)
        costs.append(float(p.weights @ p.triple**2))
    assert costs[0] > costs[1] > costs[2] > free.cost
    assert costs[2] == pytest.approx(free.cost, rel=1e-4)


def test_law_rolled_out_costs_what_riccati_says():
    lanes, steps, h = 48, 8000, 1e-3
    net = bounds.ideal("quarter-car-isd")
    point = bounds.lq_bound(weights=(1, 0.5, 0.5))
    car = bounds.linear_car(net)
    plant = Plant(net, h, lanes=lanes, extra=bounds.vehicle(net).channels)
    rng = np.random.default_rng(3)
    gain, _ = paper_road().noise(20.0, h)
    road = np.cumsum(np.vstack([np.zeros((1, lanes)), gain * rng.standard_normal((steps, lanes))]), axis=0)
    state, out = plant.state(), np.zeros((plant.n_outputs, lanes))
    total = np.zeros(3)
    for k in range(steps):
        x = car.seen.T @ (state[: plant.n] - car.lift[:, None] * road[k])
        force = -(point.gain @ x)
        u = np.stack([road[k], road[k + 1]])[:, None]
        c = force[None, None]
        plant.kernel.advance(plant.mats, plant.ints, state, u, c, lanes)
        if k >= 2000:  # stationary by then
            plant.kernel.measure(plant.mats, plant.ints, state, u[1], c[0], lanes, out)
            total += np.mean(out[[0, 1, 5]] ** 2, axis=1)
    cost = float(point.weights @ total / (steps - 2000))
    # 48 x 6 s: the standard error is about 1.5 %
    assert cost == pytest.approx(point.cost, rel=0.05)
