"""A user's controller drives alike from Python and by the name of its file."""

import json
import re
from pathlib import Path

import pytest
from program import refused, run

from isd_gym.benchmark.scoring import Entry, score

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
"""
DRIVE = {"episodes": 3, "duration": 0.5}


@pytest.fixture
def made(tmp_path):
    (tmp_path / "own.py").write_text(OWN)
    space = {}
    exec(OWN, space)
    return tmp_path / "own.py", space


@pytest.mark.parametrize("name", ["SkyDamper", "Many", "OnlyMany", "OnlyAct"])
def test_both_doors_score_alike(made, name):
    file, space = made
    by_class = score(Entry("own", space[name]), **DRIVE).policies[1]
    to = file.with_name("score.json")
    done = run(
        "score", f"{file}:{name}", "--episodes", 3, "--duration", 0.5, "--json", to
    )
    assert done.returncode == 0, done.stderr
    by_name = json.loads(to.read_text())["policies"][1]
    assert (
        by_class["cost"] == by_name["cost"] and by_class["current_rms"]["value"] > 0.01
    )
    assert by_class["control_time"]["median"] > 0
    usual = score(Entry("own", space["SkyDamper"]), **DRIVE).policies[1]
    assert by_class["cost"]["value"] == pytest.approx(usual["cost"]["value"], rel=1e-12)


@pytest.mark.parametrize(
    ("name", "says"),
    [("Wrong", "act_batch returned None"), ("Nothing", "no method act")],
)
def test_both_doors_refuse_alike(made, name, says):
    file, space = made
    refused(says, score, Entry("own", space[name]), **DRIVE)
    done = run("score", f"{file}:{name}", "--episodes", 1, "--duration", 0.1)
    assert (
        done.returncode == 2
        and says in done.stderr
        and len(done.stderr.splitlines()) == 1
    )
