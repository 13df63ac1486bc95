"""Tracks of the benchmark: conditions, what a policy may see, and the entries that others have made."""

import runpy
from pathlib import Path

import numpy as np
import pytest
from program import assert_one_line, read_json, refused, run, save_json

from isd_gym import Network, score
from isd_gym.benchmark import cards
from isd_gym.benchmark.policies import find_all
from isd_gym.benchmark.scoring import measures
from isd_gym.benchmark.tracks import TRACKS, find_track

ENTRIES = sorted((Path(__file__).parents[1] / "benchmarks" / "entries").glob("*.json"))


def track_of(found):
    """Return the name of the track of a score file, and its card."""
    names = [
        name for name, track in TRACKS.items() if track.network == found["network"]
    ]
    card = cards.load(TRACKS[names[0]].card)
    place = cards.match(found, card)["track"]
    return next(name for name in names if TRACKS[name].name == place), card


@pytest.mark.parametrize("path", ENTRIES, ids=lambda path: path.stem)
def test_an_entry_is_a_score_of_this_version_on_the_roads_of_a_track(path):
    found = cards.read_score(path)
    name, card = track_of(found)
    assert path.stem.startswith(name), "name the file TRACK-POLICY.json"
    assert "passive" in found["raw"]
    rows = cards.ranking(card, TRACKS[name].name, [found])
    assert any(row["submitted"] for row in rows)


def test_a_score_on_a_track_is_compared_with_its_card(tmp_path):
    (tmp_path / "mine.py").write_text(
        "class Mine:\n    def reset(self): pass\n    def act(self, observation): return -2.0 * observation[2]\n"
    )
    done = run(
        "score mine.py:Mine --track active-bump --json mine.json",
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    assert (
        "More: --full." in done.stdout
        and "road 'bump', 10 m/s, 1 x 20 s" in " ".join(done.stdout.split())
    )
    shown = run("card mine.json", cwd=tmp_path)
    assert shown.returncode == 0, shown.stderr
    assert "active-bump" in shown.stdout and "Mine" in shown.stdout
    old = read_json(tmp_path / "mine.json") | {"version": "0.0.9"}
    save_json(tmp_path / "mine.json", old)
    other = run("card mine.json", cwd=tmp_path)
    assert other.returncode == 2 and other.stderr.count("\n") == 1
    assert "the score is of version 0.0.9, the card of version 0.1.0" in other.stderr


def test_a_track_that_does_not_exist_is_told_in_one_line():
    refused("no track 'active-g'; did you mean 'active", lambda: find_track("active-g"))
    refused("no track 'x'; there are standard, ", lambda: find_track("x"))


def test_a_track_sets_the_conditions_alone():
    done = run("score passive --track active-bump --road A --episodes 2")
    assert_one_line(done, "--track sets --road, --episodes; leave out one or the other")


@pytest.mark.parametrize(
    ("track", "policy", "words"),
    [
        (
            "active-c",
            "lqg-preview",
            "'lqg-preview' sees 0.25 s of road ahead, but track active-c shows none",
        ),
        ("preview-0.1", "lqg-preview", "track preview-0.1 shows 0.1 s"),
        ("standard", "lqr-full", "'lqr-full' sees the state, which no track shows"),
    ],
)
def test_a_controller_that_sees_more_than_the_track_is_refused(track, policy, words):
    chosen = TRACKS[track]
    entries = find_all([policy], Network.load(chosen.network))
    refused(words, lambda: chosen.check(entries))
    chosen.check(find_all(["passive", "lqg"], Network.load(chosen.network)))


def test_exceeded_limits_are_shares_of_the_time():
    found = score(
        "passive", "quarter-car-active", road="E", speed=20.0, episodes=2, duration=5.0
    )
    driven = found.runs["passive"]
    shares = measures(driven, found.cost)
    travel, load = driven.suspension_travel, driven.tyre_load
    assert shares["travel_exceedance"][0] == pytest.approx(
        np.mean(np.abs(travel) > 0.08, axis=0)
    )
    assert shares["wheel_lift"][0] == pytest.approx(
        np.mean(load < -390.0 * 9.81, axis=0)
    )
    assert min(*shares["travel_exceedance"][0], *shares["wheel_lift"][0]) > 0.01


def test_the_file_for_envhub_gives_every_car_without_a_network():
    made = runpy.run_path(
        str(Path(__file__).parents[1] / "examples" / "envhub" / "env.py")
    )
    cars = made["make_env"](n_envs=2)["isd_gym"]
    assert len(cars) == len(made["TASKS"])
    for car in (cars[0], cars[4]):
        seen, _ = car.reset(seed=0)
        seen, reward, *_ = car.step(car.action_space.sample())
        assert seen["agent_pos"].shape[0] == reward.shape[0] == 2 and (reward < 0).all()
        car.close()
