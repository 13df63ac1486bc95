"""No condition makes a controller give a current that is not finite or not allowed; the page says what the files say."""

import importlib.util
import math
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from isd_gym.benchmark.sweep.conditions import sweep
from isd_gym.benchmark.sweep.grid import Grid

ROOT = Path(__file__).parents[1]


@pytest.fixture
def script(request, monkeypatch):
    """A script of the repository, as a module."""
    spec = importlib.util.spec_from_file_location("a_script", ROOT / request.param)
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "a_script", module)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_every_controller_in_every_condition_stays_allowed(tmp_path):
    """The benchmark's grid, one short episode: finite costs, and no command outside Table 5."""
    grid = Grid.load(ROOT / "benchmarks" / "robustness.toml")
    brief = replace(grid, episodes=1, duration=1.2)  # the bump comes after 1 s
    merged, _ = sweep(brief, tmp_path)
    assert merged["missing"] == 0 and len(merged["conditions"]) == 17
    for condition in merged["conditions"]:
        for row in condition["policies"]:
            assert math.isfinite(row["cost"]["change"]) and row["fallbacks"] == 0
            given, *wrong = row["commands"].values()
            assert given == 240 and wrong == [0, 0, 0], row["policy"]


@pytest.mark.parametrize("script", ["docs/controllers.py"], indirect=True)
def test_the_page_carries_the_files_figures(script):
    page = script.PAGE.read_text(encoding="utf-8")
    assert script.fill(page) == page, "run python docs/controllers.py"
