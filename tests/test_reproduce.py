"""The reproduction: its pieces against known answers, and the page whole or not at all."""

import numpy as np
import pytest
from program import read_json

from isd_gym import Network
from isd_gym._commands._reproduce import car, page, rig
from isd_gym._commands._reproduce.study import Study
from isd_gym._commands.reproduce import show
from isd_gym.benchmark.scoring import PAPER


@pytest.mark.parametrize("frequency", [1.0, 5.0, 10.0])
def test_sine_without_friction_is_the_impedance_in_closed_form(frequency):
    own = Network.load("force-rig").with_parameters({"seal.level": 1e-6})
    time, x, force = rig.force_test(own, frequency)
    stiffness = rig.fundamental(time, force, frequency) / rig.fundamental(
        time, x, frequency
    )
    s = 2j * np.pi * frequency
    assert abs(stiffness * (1 / 709e3 + 1 / (95 * s**2 + 1293 * s)) - 1) < 2e-3


def test_identification_finds_another_rig_s_values():
    own = Network.load("force-rig").with_parameters(
        {"oil.stiffness": 9e5, "leak.damping": 800.0}
    )
    fit = rig.identify(own, Network.load("force-rig"), 500.0, noise=0.01)
    assert fit["oil.stiffness"] == pytest.approx(9e5, rel=0.01)
    assert fit["leak.damping"] == pytest.approx(800.0, rel=0.02)
    assert fit["share"] == pytest.approx(0.01, rel=0.3)


def test_failure_leaves_nothing(tmp_path, monkeypatch):
    def broken(study):
        raise RuntimeError("midway")

    monkeypatch.setattr(page, "PARTS", (rig.table_1, broken))
    with pytest.raises(RuntimeError, match="midway"):
        page.reproduce(tmp_path / "out", quick=True)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_whole_page(tmp_path):
    tasks = set()
    result = page.reproduce(
        tmp_path / "out", quick=True, progress=lambda task, share: tasks.add(task)
    )
    text = (tmp_path / "out" / "index.html").read_text()
    names = {p.name for p in (tmp_path / "out").glob("*.svg")}
    assert text.count('<svg class="chart"') == len(names) == 5
    assert "http:" not in text.replace("http://www.w3.org", "") and "https:" not in text
    data = read_json(tmp_path / "out" / "reproduction.json")
    assert data["schema"] == page.SCHEMA
    verdicts = {c["place"]: c["verdict"] for c in data["claims"]}
    assert verdicts["Table 7 (simulation)"] == "not possible on average"
    assert verdicts["Table 8 (bench)"] == "possible"
    # figures found beforehand
    bounds = [data["figures"][f"bound of {name}"]["bound"] for name in PAPER]
    assert bounds == pytest.approx([-0.131, -0.192], abs=1e-3)
    assert {"identification", "force tests, force-rig"} <= tasks
    show(result)


def test_the_road_level_claims_no_travel_that_does_not_come_out(tmp_path):
    """Table 7's passive row: acceleration and tyre load within 1 %, travel 6 % short."""
    study = Study(tmp_path)
    car.road_level(study)
    a, l, f = study.figures["passive"]["used"]
    assert abs(a / 0.8306 - 1) < 0.01 and abs(f / 518.0 - 1) < 0.01
    assert -0.07 < l / 7.6e-3 - 1 < -0.05
    assert "a travel of 7.16 mm (7.6)" in study.claims[0].found
