"""A user's controller drives alike from Python and by the name of its file."""

import re
import sys
from pathlib import Path

import pytest
from program import assert_one_line, read_json, refused, run

from isd_gym import score
from isd_gym.benchmark.scoring import Entry

PAGE = Path(__file__).parents[1] / "docs" / "tutorials" / "controller.md"
#: the class of the tutorial, the same class for many cars at once, and the same without all that is optional
OWN = re.search(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)[1]
OWN += """

class Many(SkyDamper):
    def act_batch(self, observations):
        acceleration, _, travel_rate, _, _, _ = observations.T
        self.velocity = 0.995 * self.velocity + STEP * acceleration
        force = self.damping * self.velocity - self.friction * np.tanh(travel_rate / 0.02)
        return np.clip(force / THRUST, -5, 5)


class OnlyMany:
    def __init__(self):
        self.many = Many()

    def reset_batch(self, count):
        self.many.reset()

    def act_batch(self, observations):
        return self.many.act_batch(observations)


class OnlyAct:
    velocity, damping, friction = 0.0, 2500.0, 400.0
    act = SkyDamper.act


class Wrong(SkyDamper):
    def act_batch(self, observations):
        return None


class Nothing:
    pass


class Remembers:
    observation = "history"

    def reset(self):
        pass

    def act_batch(self, observations):
        assert observations.shape[1] > 12 and np.abs(observations).max() <= 10
        return np.full(len(observations), helper_of_mine.CURRENT)


def zero(observation):
    return 0.0


def fails(observation):
    return observation.nonsense


class Wants:
    def __init__(self, gain):
        pass
"""
FILE = "import helper_of_mine\n" + OWN
DRIVE = {"episodes": 3, "duration": 0.5}


@pytest.fixture
def made(tmp_path, monkeypatch):
    (tmp_path / "own.py").write_text(FILE)
    (tmp_path / "helper_of_mine.py").write_text("CURRENT = 0.1\n")
    monkeypatch.setattr(
        sys, "path", [*sys.path]
    )  # the folder of a controller is put on it
    space = {}
    exec(OWN, space)
    return tmp_path / "own.py", space


@pytest.mark.parametrize("name", ["SkyDamper", "Many", "OnlyMany", "OnlyAct"])
def test_both_doors_score_alike(made, name):
    file, space = made
    by_class = score(Entry("own", space[name]), **DRIVE).policies[1]
    to = file.with_name("score.json")
    done = run(
        "score", Path(f"{file}:{name}"), "--episodes 3 --duration 0.5 --json", to
    )
    assert done.returncode == 0, done.stderr
    by_name = read_json(to)["policies"][1]
    assert (
        by_class["cost"] == by_name["cost"] and by_class["current_rms"]["value"] > 0.01
    )
    assert by_class["control_time"]["median"] > 0
    usual = score(Entry("own", space["SkyDamper"]), **DRIVE).policies[1]
    assert by_class["cost"]["value"] == pytest.approx(usual["cost"]["value"], rel=1e-12)


@pytest.mark.parametrize(
    ("name", "says"),
    [
        (":Wrong", "act_batch returned None"),
        (":Nothing", "no method act"),
        (
            "",
            "needs the name of a class or function after a colon: there are SkyDamper",
        ),
        (":SkyDampr", "did you mean 'SkyDamper'?"),
        (":fails", "AttributeError"),
        (":Wants", "TypeError"),
    ],
)
def test_a_wrong_controller_is_one_line(made, name, says):
    file, space = made
    done = run("score", Path(f"{file}{name}"), "--episodes 1 --duration 0.1")
    assert_one_line(done, says)
    if name in (":Wrong", ":Nothing"):  # by its class as well
        refused(says, score, Entry("own", space[name[1:]]), **DRIVE)
    if name == ":fails":
        line = FILE.splitlines().index("    return observation.nonsense") + 1
        assert f"own.py:{line}" in done.stderr


def test_controllers_are_scored_by_file_and_name(made):
    """A controller with memory, and a function, beside a policy of the same cost."""
    file, _ = made
    to, names = (
        file.with_name("s.json"),
        (Path(f"{file}:{n}") for n in ("Remembers", "zero")),
    )
    done = run("score isd-passive", *names, "--episodes 2 --duration 1 --json", to)
    assert done.returncode == 0, done.stderr
    rows = {row["policy"]: row for row in read_json(to)["policies"]}
    assert list(rows) == ["passive", "isd-passive", "Remembers", "zero"]
    assert rows["zero"]["cost"]["value"] == rows["isd-passive"]["cost"]["value"]
