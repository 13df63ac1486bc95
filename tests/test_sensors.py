"""What a controller sees of a car: noise of the size said, late by as much, a road sensor with an end; the same for one and many."""

import numpy as np
import pytest
from program import refused

from isd_gym import ISDSuspensionVectorEnv
from isd_gym.env import Sensors
from isd_gym.env._sensors import NOISE

BAD = {
    "noise": 1.5,
    "delay": 2,
    "road_error": 1e-3,
    "road_lag": 0.01,
    "road_range": 1.0,
}


def _drive(sensors, steps=30, cars=4, **options):
    """Seen and true observations (steps + 1, cars, n) under the same currents."""
    out = []
    for own in (sensors, None):
        env = ISDSuspensionVectorEnv(
            cars, sensors=own, autoreset_mode="disabled", **options
        )
        obs, _ = env.reset(seed=5)
        rows = [obs]
        for k in range(steps):
            obs, *_ = env.step(np.full((cars, 1), 2 * np.sin(0.3 * k)))
            rows.append(obs)
        out.append(np.array(rows))
    return out


def test_noise_is_of_the_size_said_and_white():
    seen, true = _drive({"noise": 2.0}, steps=400, cars=16)
    error = (seen - true)[..., :5]
    np.testing.assert_allclose(
        error.std(axis=(0, 1)), 2 * np.array([*NOISE.values()]), rtol=0.03
    )
    assert np.abs(error.mean(axis=(0, 1)) / error.std(axis=(0, 1))).max() < 0.05
    flat = (error / error.std(axis=(0, 1))).reshape(len(error), -1)
    assert np.abs(np.mean(flat[1:] * flat[:-1])) < 0.01  # from step to step
    between = np.corrcoef(flat.T) - np.eye(flat.shape[1])
    assert (
        np.abs(between).max() < 0.25
    )  # from channel to channel, car to car: 400 samples each
    assert np.mean(flat**4) == pytest.approx(3.0, abs=0.1)
    np.testing.assert_array_equal(
        seen[..., 5], true[..., 5]
    )  # its own current is known


def test_signals_and_road_are_late_by_as_much_as_said():
    options = dict(observation="preview", preview=0.05)
    seen, true = _drive({"delay": 3, "road_lag": 0.01}, **options)
    np.testing.assert_array_equal(seen[3:, :, :5], true[:-3, :, :5])
    np.testing.assert_array_equal(seen[:3, :, :5], true[:1, :, :5].repeat(3, axis=0))
    np.testing.assert_array_equal(seen[2:, :, 6:], true[:-2, :, 6:])
    words, late = "whole number of control steps", {"road_lag": 0.012}
    refused(words, ISDSuspensionVectorEnv, 2, observation="preview", sensors=late)
    np.testing.assert_array_equal(seen[..., 5], true[..., 5])


def test_the_road_is_seen_with_an_error_and_to_an_end():
    options = dict(observation="preview", preview=0.05, speed=20.0)
    seen, true = _drive({"road_error": 2e-3}, steps=200, **options)
    assert (seen - true)[..., 6:].std() == pytest.approx(2e-3, rel=0.03)
    np.testing.assert_array_equal(seen[..., :6], true[..., :6])
    seen, true = _drive({"road_range": 0.45}, **options)  # 0.1 m a step: four points
    np.testing.assert_array_equal(seen[..., :10], true[..., :10])
    np.testing.assert_array_equal(seen[..., 10:], true[..., 9:10].repeat(6, axis=-1))
    blind, _ = _drive({"road_range": 0.05}, **options)
    assert not blind[..., 6:].any()


def test_roads_and_rewards_do_not_depend_on_what_is_seen():
    rewards = []
    for sensors in (None, BAD):
        env = ISDSuspensionVectorEnv(
            2, sensors=sensors, observation="preview", preview=0.05
        )
        env.reset(seed=0)
        rewards.append([env.step(np.zeros((2, 1)))[1] for _ in range(20)])
    np.testing.assert_array_equal(*rewards)


def test_text_mapping_and_object_say_the_same():
    text = "noise=1.5, delay=2, road_error=1e-3, road_lag=0.01, road_range=1"
    assert Sensors.of(text) == Sensors.of(BAD) == Sensors(**BAD)
    assert Sensors.of(Sensors.of(text).to_dict()) == Sensors.of(text)
    assert Sensors.of("noise=0:2").noise == (0.0, 2.0)
    assert (
        Sensors.of(None).perfect
        and Sensors.of("").perfect
        and not Sensors.of("delay=1").perfect
    )


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ("nois=1", "no 'nois', there are noise"),
        ("noise=x", "is not such as"),
        ("noise=2:1", "noise must be"),
        ({"road_error": -1}, "road_error must be"),
        ({"road_range": float("nan")}, "road_range must be"),
    ],
)
def test_bad_sensors_are_one_line(given, why):
    refused(why, Sensors.of, given)
