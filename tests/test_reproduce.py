"""The reproduction: its pieces against known answers, and the page whole or not at all."""

import json

import numpy as np
import pytest

from isd_gym._commands._reproduce import page, rig
from isd_gym._commands._reproduce.device import device
from isd_gym._commands._reproduce.road_level import road_level
from isd_gym._commands._reproduce.study import SCHEMA, Study
from isd_gym._commands.reproduce import show
from isd_gym.physics.network import Network


def test_first_harmonic_of_a_known_signal():
    time = np.arange(0, 1.0 + 1e-9, 1e-3)
    signal = (
        3.0 * np.sin(2 * np.pi * 4 * time + 0.7)
        + 1.5
        + 0.4 * np.sin(2 * np.pi * 12 * time)
    )
    found = rig.fundamental(time, signal, 4.0)
    assert abs(found) == pytest.approx(3.0, rel=1e-6)
    assert np.angle(found) == pytest.approx(0.7, abs=1e-6)


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

    monkeypatch.setattr(page, "SECTIONS", (device, broken))
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
    assert text.count('<svg class="chart"') == len(names) == 7
    assert "http:" not in text.replace("http://www.w3.org", "") and "https:" not in text
    data = json.loads((tmp_path / "out" / "reproduction.json").read_text())
    assert data["schema"] == SCHEMA
    assert {c["place"] for c in data["claims"]} >= {
        "Table 4",
        "Table 7",
        "Table 8",
        "Figure 6",
    }
    # figures found beforehand
    cases = data["figures"]["causal_bound"]["cases"]
    assert cases[2]["bound"] == pytest.approx(-0.171, abs=1e-3)
    eq8 = data["figures"]["eq8_lq"]
    assert [round(r["change"][0], 3) for r in eq8] == [-0.027, -0.047, -0.078]
    assert {"sweep", "identification", "force tests"} <= tasks
    show(result)


def test_the_road_level_claims_no_travel_that_does_not_come_out(tmp_path):
    """Table 7's passive row: acceleration and tyre load within 1 %, travel 6 % short."""
    study = Study(tmp_path, True, lambda task, share: None)
    section = road_level(study)
    a, l, f = study.figures["passive"]["κ = 5·10⁻⁷ m³/cycle (used here)"]
    assert abs(a / 0.8306 - 1) < 0.01 and abs(f / 518.0 - 1) < 0.01
    assert -0.07 < l / 7.6e-3 - 1 < -0.05
    assert "Its travel is not: 7.16 mm" in section.text[0]
