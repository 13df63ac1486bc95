"""Cars that share roads, as any library learns on them."""

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from isd_gym.errors import InputError
from isd_gym.scoring import score
from isd_gym.wrappers import CHANGE, SCALE, SharedRoads, cost_of


def made(count=8, **options):
    return gymnasium.make_vec("ISDSuspension-v0", count, **options)


def test_what_is_seen_done_and_rewarded():
    wrapped, bare = SharedRoads(made(autoreset_mode="same_step"), each=4, seed=5), made()
    features, _ = wrapped.reset()
    seen, _ = bare.reset(seed=[5] * 4 + [6] * 4)
    np.testing.assert_array_equal(features[:, :6], seen / SCALE)
    assert not features[:, 6:].any()
    rng = np.random.default_rng(0)
    velocity = np.zeros(8)
    for _ in range(50):
        actions = rng.uniform(-1.5, 1.5, (8, 1)).astype(np.float32)
        features, reward, *_ = wrapped.step(actions)
        last = seen
        seen, own, *_ = bare.step(last[:, 5:] + 0.5 * np.clip(actions, -1, 1))
        np.testing.assert_allclose(features[:, :6], seen / SCALE, rtol=1e-6)
        np.testing.assert_allclose(features[:, 6:12], (seen - last) / CHANGE, rtol=1e-4, atol=1e-6)
        velocity += 5e-3 * (seen[:, 0] - velocity)
        np.testing.assert_allclose(features[:, 12], velocity / 0.07, rtol=1e-3, atol=1e-6)
        for group in (slice(0, 4), slice(4, 8)):
            np.testing.assert_allclose(reward[group], 0.1 * (own[group] - own[group].mean()), atol=1e-7)
        assert wrapped.cost == pytest.approx(-own.mean(), rel=1e-5)
    assert np.abs(reward).max() > 0.0


@pytest.mark.parametrize("mode", ["same_step", "next_step"])
def test_a_new_road_begins_without_a_past(mode):
    env = SharedRoads(made(4, autoreset_mode=mode, max_episode_steps=10), each=2)
    assert env.autoreset_mode is AutoresetMode(env.env.metadata["autoreset_mode"])
    env.reset()
    begun = []
    for k in range(1, 24):
        features, reward, _, truncated, _ = env.step(np.ones((4, 1), np.float32))
        np.testing.assert_array_equal(features[0::2], features[1::2])  # a pair does the same on the same road
        np.testing.assert_allclose(reward, 0.0, atol=1e-9)
        if not features.any():  # at rest, nothing remembered
            begun.append(k)
        assert truncated.all() == truncated.any() == (k % 10 == 0 if mode == "same_step" else k % 11 == 10)
    assert begun == ([10, 20] if mode == "same_step" else [11, 22])


def test_the_last_of_a_road_is_told_in_the_features_terms():
    ends, goes_on = (
        SharedRoads(made(4, autoreset_mode=mode, max_episode_steps=10 if mode == "same_step" else 99), each=2)
        for mode in ("same_step", "disabled")
    )
    ends.reset()
    goes_on.reset()
    for _ in range(10):
        *_, info = ends.step(np.ones((4, 1), np.float32))
        there, *_ = goes_on.step(np.ones((4, 1), np.float32))
    np.testing.assert_allclose(np.stack(info["final_obs"]), there, rtol=1e-5, atol=1e-6)


def test_the_cost_is_the_score_s():
    idle = cost_of(lambda features: np.zeros((len(features), 1)), roads=2, steps=400)
    found = score(["isd-passive"], episodes=2, duration=2.0)
    assert idle == pytest.approx(found.policies[-1]["cost"]["value"], rel=1e-4)


def test_refusals():
    with pytest.raises(InputError, match="8 cars are no groups of 3"):
        SharedRoads(made(), each=3)
    with pytest.raises(InputError, match="measured observation"):
        SharedRoads(made(observation="full"), each=4)


@pytest.mark.parametrize(("name", "motions", "currents"), [("ISDHalfCar-v0", 2, 2), ("ISDFullCar-v0", 3, 4)])
def test_cars_with_several_corners(name, motions, currents):
    cars = gymnasium.make_vec(name, 4, autoreset_mode="same_step", max_episode_steps=30)
    wrapped, bare = SharedRoads(cars, each=2, seed=5), gymnasium.make_vec(name, 4)
    features, _ = wrapped.reset()
    signals = motions + 5 * currents
    assert features.shape == (4, 2 * signals + motions) and wrapped.increments.shape == (currents,)
    seen, _ = bare.reset(seed=[5, 5, 6, 6])
    rng = np.random.default_rng(0)
    velocity = np.zeros((4, motions))
    for _ in range(29):
        actions = rng.uniform(-1, 1, (4, currents)).astype(np.float32)
        features, reward, *_ = wrapped.step(actions)
        seen, own, *_ = bare.step(seen[:, -currents:] + 0.5 * actions)
        velocity += 5e-3 * (seen[:, :motions] - velocity)
        sizes = np.array([0.07, 0.025, 0.027])[:motions]
        np.testing.assert_allclose(features[:, -motions:], velocity / sizes, rtol=1e-3, atol=1e-6)
        np.testing.assert_allclose(features[:, 0], seen[:, 0], rtol=1e-6)
        assert reward[0] == pytest.approx(0.05 * (own[0] - own[1]), rel=1e-4, abs=1e-9)
    *_, info = wrapped.step(actions)  # the last of a road, in the features' terms
    final = bare.step(seen[:, -currents:] + 0.5 * actions)[0]
    np.testing.assert_allclose(np.stack(info["final_obs"])[:, 1], final[:, 1] / 0.4, rtol=1e-5)
