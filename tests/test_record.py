"""Rollouts as a Minari data set: its replay in the environment gives the same observations and rewards."""

import numpy as np
import pytest
from program import refused

from isd_gym.benchmark.datasets import write_dataset
from isd_gym.benchmark.policies import Idle, find, passive
from isd_gym.benchmark.scoring import Entry
from isd_gym.physics._vehicle import vehicle
from isd_gym.physics.network import Network

pytest.importorskip("h5py")
minari = pytest.importorskip("minari")

CAR = Network.load("quarter-car-isd")
SHORT = {"episodes": 2, "seed": 5, "duration": 0.5}


class Push:
    """Currents that grow with the acceleration, another one for every motor; one car at a time."""

    name, fallbacks = "push", 0

    def __init__(self, motors):
        self.shares = 20.0 / np.arange(1, motors + 1)

    def reset(self):
        pass

    def act(self, observation):
        # beyond 5 A at times: the data hold what was commanded, within the limits
        return 5.0 * self.shares * float(observation[0])


CARS = ("half-car-isd", "full-car-passive", "full-car-isd")


@pytest.mark.parametrize(
    "name", ["quarter-car-isd", *(pytest.param(n, marks=pytest.mark.slow) for n in CARS)]
)
def test_the_data_are_the_environments(name, tmp_path):
    """The environment of a data set gives its observations and rewards for its actions, whatever the number of motors."""
    car = Network.load(name)
    motors = len(vehicle(car).driven)
    folder = write_dataset(Entry("push", lambda: Push(motors)), tmp_path / "set", car, **SHORT)
    data = minari.MinariDataset(folder)
    assert data.total_episodes == 2 and data.total_steps == 200
    env = data.recover_environment()
    assert env.unwrapped.network == car and env.action_space == data.action_space
    seeds = [about["seed"] for about in data.storage.get_episode_metadata(data.episode_indices)]
    assert seeds == [5, 6]
    for seed, episode in zip(seeds, data.iterate_episodes(), strict=True):
        obs, _ = env.reset(seed=int(seed))
        np.testing.assert_array_equal(episode.observations[0], obs)
        assert episode.actions.shape == (100, motors) and (np.abs(episode.actions).max(axis=0) == 5.0).all()
        for k, action in enumerate(episode.actions):
            obs, reward, terminated, truncated, _ = env.step(action)
            np.testing.assert_array_equal(episode.observations[k + 1], obs)
            assert episode.rewards[k] == pytest.approx(reward, rel=1e-12)
            assert (episode.terminations[k], episode.truncations[k]) == (terminated, truncated)
        assert truncated


def test_a_plant_of_ones_own_travels_with_the_data(tmp_path):
    mine = CAR.with_parameters({"seal.level": 321.0})
    folder = write_dataset(Entry("idle", lambda: Idle("idle")), tmp_path / "set", mine, **SHORT)
    assert minari.MinariDataset(folder).recover_environment().unwrapped.network == mine
    folder = write_dataset(passive(mine), tmp_path / "other", mine, **SHORT)
    assert "seal.level" not in minari.MinariDataset(folder).recover_environment().unwrapped.network.parameters


def test_an_id_goes_to_minaris_own_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    entry = find("isd-passive", CAR)
    write_dataset(entry, "isd/mine-v3", CAR, **SHORT)
    data = minari.load_dataset("isd/mine-v3")
    assert data.id == "isd/mine-v3" and data.total_steps == 200
    refused("already", write_dataset, entry, "isd/mine-v3", CAR, **SHORT)


def test_nothing_is_left_when_it_fails(tmp_path, monkeypatch):
    def stopped(*given, **options):
        raise KeyboardInterrupt

    for place in ("gymnasium.make", "minari.dataset.minari_storage.MinariStorage.update_metadata"):
        with monkeypatch.context() as broken, pytest.raises(KeyboardInterrupt):
            broken.setattr(place, stopped)
            write_dataset(find("isd-passive", CAR), tmp_path / "set", CAR, **SHORT)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"episodes": 0}, "episodes must be at least 1"),
        ({"duration": -1.0}, "duration must be at least"),
        ({"road": "moon"}, "no road 'moon'"),
        ({"out": "no/such/folder"}, "no folder 'no/such'"),
        ({"out": "."}, "exists already"),
    ],
)
def test_bad_input(change, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    settings = {"out": "set", **SHORT, **change}
    refused(message, write_dataset, find("isd-passive", CAR), settings.pop("out"), CAR, **settings)
    assert not list(tmp_path.iterdir())


def test_a_missing_extra_is_one_line(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "h5py", None)
    words = r'recording needs h5py: pip install "\.\[record\]"'
    refused(words, write_dataset, find("isd-passive", CAR), tmp_path / "set", CAR, **SHORT)
