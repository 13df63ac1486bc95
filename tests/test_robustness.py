"""No condition makes a controller give a current that is not finite or not allowed."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from isd_gym.benchmark.driving import Crew
from isd_gym.benchmark.sweep.conditions import sweep
from isd_gym.benchmark.sweep.grid import Grid
from isd_gym.physics.vehicle import CURRENT_LIMIT, SLEW_LIMIT

ROOT = Path(__file__).parents[1]


@pytest.mark.slow
def test_every_controller_in_every_condition_stays_allowed(tmp_path, monkeypatch):
    """The benchmark's grid, one short episode: finite costs, and no command outside Table 5."""
    act, commands = Crew.act, []

    def watched(crew, observations):
        found = act(crew, observations)
        commands.append((crew.name, np.ravel(found), observations[:, 5]))
        return found

    monkeypatch.setattr(Crew, "act", watched)
    grid = Grid.load(ROOT / "benchmarks" / "robustness.toml")
    brief = replace(grid, episodes=1, duration=1.2)  # the bump comes after 1 s
    merged, _ = sweep(brief, tmp_path)
    assert merged["missing"] == 0 and len(merged["conditions"]) == 17
    for condition in merged["conditions"]:
        for row in condition["policies"]:
            assert math.isfinite(row["cost"]["change"]) and row["fallbacks"] == 0
    assert {name for name, _, _ in commands} >= set(grid.policies)
    for name, found, present in commands:
        assert np.abs(found).max() <= CURRENT_LIMIT + 1e-6, name
        assert np.abs(found - present).max() <= SLEW_LIMIT + 1e-6, name
