"""Sweeps: every item once, whatever dies; the merged figures are the score's; bad grids are one line."""

import os
import signal
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from program import assert_one_line, read_json, refused, run

from isd_gym import Network, score
from isd_gym.benchmark.policies import find, passive
from isd_gym.benchmark.sweep import items as engine
from isd_gym.benchmark.sweep.conditions import drive_item, overall, sweep
from isd_gym.benchmark.sweep.grid import Condition, Grid

GRID = """
policies = ["isd-passive", "skyhook"]
episodes = 4
batch = 2
duration = 0.5

[axes]
speed = [10, 30.0]

[[conditions]]
name = "heavy"
factors = { "body.mass" = 1.2 }
"""


def noted(folder, number):
    """A task that tells that it was done."""
    with (Path(folder) / "done").open("a") as file:
        file.write(f"{number}\n")
    return number**2


def dies(folder, number):
    """Number 2 never survives, number 3 has an error."""
    if number == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    if number == 3:
        raise ValueError("of its own")
    return noted(folder, number)


def slow(folder, number):
    time.sleep(0.3)
    return noted(folder, number)


def _items(folder, count):
    return [{"folder": str(folder), "number": i} for i in range(count)]


def _results(items, folder):
    found = engine.stored(items, folder)
    return [found.get(engine.key_of(item)) for item in items]


def _done(folder):
    return sorted(int(line) for line in (folder / "done").read_text().split())


@pytest.fixture
def importable(monkeypatch):
    """Make this file and its helpers importable for workers."""
    here = Path(__file__).parent
    paths = [str(here), str(here.parent), os.environ.get("PYTHONPATH", "")]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(paths))


@pytest.mark.parametrize("jobs", [1, 2])
def test_each_is_done_once_and_not_again(jobs, tmp_path, importable):
    items, out = _items(tmp_path, 5), tmp_path / "out"
    assert not engine.run(noted, items, out, jobs=jobs)
    assert _results(items, out) == [0, 1, 4, 9, 16]
    assert not engine.run(noted, items, out, jobs=jobs)
    assert _done(tmp_path) == [0, 1, 2, 3, 4]


def test_what_is_done_is_kept_when_a_worker_dies(tmp_path, importable):
    items, out = _items(tmp_path, 3), tmp_path / "out"
    refused(
        "a worker died.* the same line goes on",
        engine.run,
        dies,
        items[1:],
        out,
        jobs=2,
    )
    assert not engine.run(dies, items[:2], out) and _results(items, out) == [0, 1, None]
    assert _done(tmp_path).count(1) <= 2


def test_what_cannot_be_done_is_a_line_and_the_rest_goes_on(tmp_path, importable):
    items, lines = _items(tmp_path, 6), []
    failed = engine.run(dies, items[3:], tmp_path / "out", jobs=2, say=lines.append)
    assert _done(tmp_path) == [4, 5]
    assert list(failed.values()) == ["ValueError: of its own"]
    assert len(lines) == 1
    assert not list((tmp_path / "out").glob(".*"))  # nothing half-written


def test_a_grid_is_axes_crossed_and_conditions_named(tmp_path):
    (tmp_path / "grid.toml").write_text(GRID)
    grid = Grid.load(tmp_path / "grid.toml")
    assert [c.name for c in grid.conditions] == ["speed 10", "speed 30", "heavy"]
    items = grid.all_items()
    assert len(items) == 3 * 3 * 2  # the passive car as well
    assert len(set(map(engine.key_of, items))) == 18


def test_a_sweep_says_what_the_score_says(tmp_path):
    plant = Network.load("quarter-car-isd")
    heavy = plant.with_parameters({"body.mass": 1.2 * plant.parameters["body.mass"]})
    conditions = (Condition("heavy", factors={"body.mass": 1.2}),)
    grid = Grid(("skyhook",), conditions, episodes=5, batch=2, duration=1.0)
    merged, _ = sweep(grid, tmp_path / "out")
    assert (
        merged["missing"] == 0 and read_json(tmp_path / "out" / "sweep.json") == merged
    )
    entry = find("skyhook", heavy, model=plant)
    expected = score([entry], heavy, reference=passive(heavy), episodes=5, duration=1.0)
    own = {r["policy"]: r for r in expected.policies}["skyhook"]
    (row,) = merged["conditions"][0]["policies"]
    for name in ("cost", "tyre_load_rms", "peak_body_acceleration"):
        for key in ("value", "change", "low", "high"):
            assert row[name].get(key) == pytest.approx(own[name].get(key), rel=1e-12)


def test_shards_of_a_sweep_merge_to_the_whole(tmp_path):
    grid = Grid(
        ("skyhook",),
        (Condition("a"), Condition("b", speed=10.0)),
        episodes=4,
        batch=2,
        duration=0.2,
    )
    whole, _ = sweep(grid, tmp_path / "whole")
    first, _ = sweep(grid, tmp_path / "parts", which="0/2")
    assert first["missing"] == 4
    second, _ = sweep(grid, tmp_path / "parts", which="1/2")
    assert second == whole


def test_a_drawn_grid_is_the_same_everywhere_and_spread_evenly():
    grid = Grid.load("robust")
    assert (
        grid.conditions == Grid.load("robust").conditions and len(grid.conditions) == 64
    )
    assert grid.conditions[0].factors == {  # Halton: a half, a third, ...
        "body.mass": pytest.approx(0.8 + 0.5 / 5),
        "seal.level": pytest.approx(0.5 + 1.0 / 7, abs=1e-4),
        "motor.thrust_constant": pytest.approx(0.85 + 0.3 / 11, abs=1e-4),
    }
    assert grid.conditions[0].speed == 22.5
    roads = [c.road for c in grid.conditions]
    assert all(14 <= roads.count(name) <= 18 for name in ("A", "B", "C", "paper"))
    assert np.mean([c.speed for c in grid.conditions]) == pytest.approx(22.5, abs=0.5)


def test_what_a_policy_is_made_of_is_part_of_an_item(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "policy.json").write_text("{}")
    grid = Grid(("mine",), (Condition("a"),), episodes=1, duration=0.1)
    (item,) = grid.items(grid.conditions[0], "mine")
    (tmp_path / "mine" / "policy.json").write_text("{ }")
    assert [item] != grid.items(grid.conditions[0], "mine")
    refused("'mine' is not here, or another", drive_item, **item)


def test_over_all_conditions_each_counts_the_same():
    rows = [{"a": -0.2, "b": -0.1}, {"a": -0.4, "b": -0.2}, {"a": 0.0, "b": -0.3}]
    policies = [
        [{"policy": p, "cost": {"change": v}} for p, v in row.items()] for row in rows
    ]
    conditions = [{"name": str(i), "policies": row} for i, row in enumerate(policies)]
    first, second = overall(conditions, ("a", "b"))
    where, change = {"a": ("2", 0.0), "b": ("0", -0.1)}[first["policy"]]
    assert first["change"]["value"] == pytest.approx(-0.2)
    assert first["worst"] == {"condition": where, "change": change}
    assert first["against"][second["policy"]]["value"] == pytest.approx(0.0)
    del conditions[1]["policies"][0]  # a is not there in all
    assert [r["policy"] for r in overall(conditions, ("a", "b"))] == ["b"]


@pytest.mark.slow
def test_a_sweep_of_half_cars_goes_on(tmp_path):
    conditions = (Condition("half", network="half-car-isd"),)
    grid = Grid(("skyhook",), conditions, episodes=2, batch=2, duration=0.05)
    merged, failed = sweep(grid, tmp_path)
    assert not failed and not merged["missing"]
    (row,) = merged["conditions"][0]["policies"]
    assert row["pitch_acceleration_rms"]["unit"] == "rad/s^2"
    again = []
    assert (
        sweep(grid, tmp_path, progress=lambda done, of: again.append((done, of)))[0]
        == merged
    )
    assert again[0] == (2, 2)  # nothing is driven twice


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("polices = ['lqg']", "did you mean 'policies'"),
        ("policies = []", "at least one"),
        ("policies = ['lqg', 'lqg']", "named twice"),
        ("policies = ['lqg']\nepisodes = 0", "episodes must be"),
        ("policies = ['lqg']\n[axes]\nspeeds = [1]", "did you mean 'speed'"),
        ("policies = ['lqg']\n[axes]\nspeed = []", "at least one"),
        ("policies = ['lqg']\n[axes]\nspeed = [-1]", "speed must be"),
        ("policies = ['lqg']\n[axes]\nroad = ['nowhere']", "no road 'nowhere'"),
        ("policies = ['lqg']\n[[conditions]]\nspeed = 1", "with a name"),
        (
            "policies = ['lqg']\n[[conditions]]\nname = 'a'\nfactors = {'body.mas' = 1}",
            "no parameter 'body.mas'",
        ),
        (
            "policies = ['lqg']\n[[conditions]]\nname = 'a'\n[[conditions]]\nname = 'a'",
            "two conditions",
        ),
        ("policies = [", "grid"),
        ("duration = nan\npolicies = ['lqg']", "duration"),
        ("policies = ['lqg']\n[random]\nspeed = [1, 2]", "needs a count"),
        (
            "policies = ['lqg']\n[random]\ncount = 2\nspeed = [2, 1]",
            r"'speed' must be \[low, high\]",
        ),
        (
            "policies = ['lqg']\n[random]\ncount = 2\nspeeed = [1, 2]",
            "did you mean 'speed'",
        ),
        ("policies = ['lqg']\n[axes]\nnoise = [-1]", "noise must be"),
        ("policies = ['lqg']\n[axes]\nroad_lag = [-1]", "road_lag must be"),
        ("policies = ['lqg']\nepisodes = 1000000000000", "more than"),
        (
            f"policies = ['lqg']\n[axes]\nspeed = {[*range(1, 201)]}\nnoise = {[*range(200)]}",
            "conditions",
        ),
        (
            "policies = ['lqg']\n[[conditions]]\nname = 'a'\nroad = ['C']",
            "road must be a name",
        ),
        (f"policies = ['lqg']\nseed = {10**299}", "seed"),
    ],
)
def test_a_bad_grid_is_one_line(text, why, tmp_path):
    path = tmp_path / "grid.toml"
    path.write_text(text)
    assert str(path) in refused(why, Grid.load, path)


def test_the_command_prints_a_table_and_says_what_is_missing(tmp_path):
    bad, good, out = (tmp_path / name for name in ("grid.toml", "good.toml", "out"))
    bad.write_text(GRID.replace("isd-passive", "isd-pasive"))
    good.write_text(GRID)
    for words in ("", "--shard 0/2"):
        done = run("sweep", bad, "--out", out, words)
        assert_one_line(done, "no policy 'isd-pasive' (did you mean 'isd-passive'?)")
        assert not done.stdout
    empty = run("sweep", good, "--out", out, "--shard 77/78")
    assert_one_line(empty, "shard 77/78 is empty: there are 18 items")
    assert not out.exists()  # neither of these has begun
    part = run("sweep", good, "--out", tmp_path / "part", "--shard 17/18")
    assert part.returncode == 0 and "17 items are not there yet" in part.stdout
    assert "heavy" not in part.stdout  # no row without a figure
    whole = run("sweep", good, "--out", out)
    assert whole.returncode == 0 and "heavy" in whole.stdout
    assert run("sweep", tmp_path / "absent.toml", "--out", out).returncode == 2


needs_ray = pytest.mark.skipif(find_spec("ray") is None, reason="Ray is not installed")


@pytest.fixture
def cluster(monkeypatch):
    """A Ray cluster of two nodes of one core each, processes of their own: (address, kill the second)."""
    from ray.cluster_utils import Cluster

    monkeypatch.setenv("RAY_raylet_start_wait_time_s", "120")
    small = {"num_cpus": 1, "object_store_memory": 80_000_000}
    made = Cluster(
        initialize_head=True, head_node_args={**small, "include_dashboard": False}
    )
    second = made.add_node(**small)
    yield made.address, lambda: made.remove_node(second, allow_graceful=False)
    made.shutdown()


@needs_ray
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_ray_cluster_of_two_nodes_one_of_them_killed(tmp_path, importable, cluster):
    address, kill = cluster
    items, killed = _items(tmp_path, 16), []

    def progress(done, total):
        if done == 4 and not killed:
            kill()
            killed.append(done)

    where = {"engine": "ray", "address": address}
    failed = engine.run(slow, items, tmp_path / "out", **where, progress=progress)
    assert killed and not failed
    assert _results(items, tmp_path / "out") == [i**2 for i in range(16)]
    # what the dead node was at was done again; nothing else was
    assert set(_done(tmp_path)) == set(range(16)) and len(_done(tmp_path)) <= 17
    assert not engine.run(slow, items, tmp_path / "out", **where)
    assert len(_done(tmp_path)) <= 17


@needs_ray
@pytest.mark.filterwarnings("ignore")
def test_a_cluster_that_is_not_there_is_one_line(tmp_path):
    refused(
        r"no Ray cluster at '127\.0\.0\.1:1'",
        engine.run,
        noted,
        _items(tmp_path, 1),
        tmp_path / "out",
        engine="ray",
        address="127.0.0.1:1",
    )


def test_without_ray_the_engine_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    refused(
        "scale", engine.run, noted, _items(tmp_path, 1), tmp_path / "out", engine="ray"
    )
    refused(
        "no engine 'cloud'", engine.run, noted, [], tmp_path / "out", engine="cloud"
    )
