"""No condition makes a controller give a current that is not finite or not allowed; the page says what the files say."""

from __future__ import annotations

import importlib.util
import math
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from isd_gym.network import Network
from isd_gym.scoring import Entry, drive

ROOT = Path(__file__).parent.parent


@pytest.fixture
def script(request, monkeypatch):
    """A script of the repository, as a module."""
    spec = importlib.util.spec_from_file_location("a_script", ROOT / request.param)
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "a_script", module)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("script", ["benchmarks/robustness.py"], indirect=True)
def test_every_controller_in_every_condition_stays_allowed(script):
    """The benchmark itself, one short episode: finite costs, and no command outside Table 5."""
    conditions = tuple(replace(c, episodes=1) for c in script.CONDITIONS)
    found = script.run(conditions=conditions, duration=1.2)  # the bump comes after 1 s
    assert [r["condition"] for r in found["conditions"]] == [c.name for c in script.CONDITIONS]
    for row in found["conditions"]:
        assert all(math.isfinite(p["cost"]) and p["fallbacks"] == 0 for p in row["policies"].values())
    for name in script.POLICIES:
        counts = found["commands"][name]
        assert counts.pop("commands") >= 240 * len(conditions)
        assert set(counts.values()) == {0}, name


@pytest.mark.parametrize("script", ["benchmarks/robustness.py"], indirect=True)
def test_the_watch_sees_what_is_not_allowed(script):
    class Wild:
        name = "wild"

        def reset(self): ...
        def act(self, observation):
            return 7.0

    counts = Counter()
    drive(
        script.checked(Entry("wild", Wild), counts),
        Network.load("quarter-car-isd"),
        episodes=2,
        duration=0.05,
    )
    assert counts == {"commands": 20, "not finite": 0, "above 5 A": 20, "steps above 0.5 A": 20}


@pytest.mark.parametrize("script", ["benchmarks/robustness.py"], indirect=True)
def test_signals_are_late_and_noisy_as_said(script):
    obs = np.arange(12, dtype=np.float32).reshape(2, 6)
    late = script.Delay()
    assert np.array_equal(late(obs, 0), obs)
    seen = late(obs + 1, 1)
    assert np.array_equal(seen[:, :5], obs[:, :5]) and np.array_equal(seen[:, 5], obs[:, 5] + 1)
    noise = script.Noise()(np.zeros((20_000, 6)), 0)
    assert noise[:, :5].std(axis=0) == pytest.approx([*script.NOISE.values()], rel=0.03)
    assert not noise[:, 5].any()


@pytest.mark.parametrize("script", ["docs/controllers.py"], indirect=True)
def test_the_page_carries_the_files_figures(script):
    page = script.PAGE.read_text(encoding="utf-8")
    assert script.fill(page) == page, "run python docs/controllers.py"
