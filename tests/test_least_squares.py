"""The bounded step of the fit, alone."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from isd_gym.diagnosis._estimation.least_squares import bounded_step


@pytest.mark.parametrize("seed", range(20))
def test_without_damping_it_is_no_worse_than_the_clipped_step_and_stays_inside(seed):
    rng = np.random.default_rng(seed)
    p = 4
    A, b = rng.standard_normal((12, p)), rng.standard_normal(12)
    x = np.zeros(p)
    low, high = -rng.uniform(0, 0.3, p), rng.uniform(0, 0.3, p)
    step = bounded_step(A.T @ A, A.T @ b, x, low, high, np.full(p, np.inf), 0.0)
    assert np.all(x + step >= low) and np.all(x + step <= high)
    free = np.linalg.solve(A.T @ A, A.T @ b)
    if np.all((free > low) & (free < high)):
        np.testing.assert_allclose(step, free)
        np.testing.assert_allclose(step, lsq_linear(A, b, (low, high)).x, atol=1e-6)


def test_what_rests_on_a_limit_is_held_and_the_rest_moves_as_if_it_were_known():
    H = np.array([[2.0, 1.0], [1.0, 2.0]])
    slope = np.array([-1.0, 1.0])
    low, high = np.zeros(2), np.full(2, 10.0)
    step = bounded_step(H, slope, np.zeros(2), low, high, np.full(2, np.inf), 0.0)
    np.testing.assert_allclose(step, [0.0, 0.5])


def test_no_stride_is_exceeded():
    step = bounded_step(
        np.eye(2),
        np.array([100.0, -0.1]),
        np.zeros(2),
        np.full(2, -9e9),
        np.full(2, 9e9),
        np.array([1.0, 1.0]),
        0.0,
    )
    np.testing.assert_allclose(step, [1.0, -0.1])
