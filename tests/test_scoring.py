"""The score: paired roads, the standard's weighting, intervals that mean what they say."""

import json
import shutil

import numpy as np
import pytest
from isd_gym.agents.policy import SHIPPED
from program import refused

from isd_gym import Network, score
from isd_gym.benchmark.policies import Idle, passive
from isd_gym.benchmark.scoring import Entry, frequency_weighting, weighted_rms

CAR = Network.load("quarter-car-isd")


class Constant:
    """The same current always; counts what it was asked."""

    fallbacks = 3

    def __init__(self, current):
        self.current, self.name = current, f"constant {current}"

    def reset(self):
        pass

    def act(self, observation):
        assert observation.shape == (6,)
        return self.current


def test_weighting_matches_the_table_of_iso_2631():
    """W_k at one-third-octave centres, ISO 2631-1:1997 table 3 (factor x 1000), within 1.5 %."""
    frequencies = (0.5, 1.0, 2.0, 4.0, 5.0, 8.0, 16.0, 31.5, 63.0, 80.0)
    for f, factor in zip(
        frequencies, (418, 482, 531, 967, 1039, 1036, 768, 405, 186, 132), strict=True
    ):
        exact = 10 ** (round(10 * np.log10(f)) / 10)
        assert frequency_weighting(np.array([exact]))[0] == pytest.approx(
            factor / 1000, rel=0.015
        ), f


def test_weighted_rms_of_a_sine():
    t = np.arange(4000) * 5e-3
    expected = np.sqrt(2) * frequency_weighting(np.array([5.0]))[0]
    assert weighted_rms(2 * np.sin(2 * np.pi * 5.0 * t), 5e-3) == pytest.approx(
        expected, rel=1e-6
    )


def test_table_holds_what_the_contract_asks():
    entries = [passive(CAR), Entry("constant", lambda: Constant(3.0))]
    result = score(
        entries, CAR, reference=entries[0], episodes=4, duration=3.0
    ).to_dict()
    json.dumps(result, allow_nan=False)
    assert result["schema"] == "isd-score/1" and result["episodes"] == 4
    first, second = result["policies"]
    assert first["cost"]["change"] == 0.0 == first["cost"]["low"]
    q = second["body_acceleration_rms"]
    assert q["low"] <= q["change"] <= q["high"] and q["unit"] == "m/s^2"
    assert second["fallbacks"] == 3 * 4
    assert second["current_rms"]["value"] == pytest.approx(3.0, rel=0.01)
    assert (
        second["limit_violations"]["current"]
        == second["limit_violations"]["current_change"]
        == 0
    )
    assert 0 < second["control_time"]["median"] <= second["control_time"]["p99_9"]
    # 3 A through 3.8 Ohm for 3 s, and what the motor gives to or takes from the car
    assert second["energy"]["value"] == pytest.approx(3.8 * 9 * 3, rel=0.3)


def test_policies_of_the_same_name_are_called_by_their_paths(tmp_path):
    """A copy of a shipped policy brings the name of the shipped one along, and a policy may be called like the reference."""
    shipped, copies = SHIPPED / "ppo", [tmp_path / "one", tmp_path / "other"]
    for copy in copies:
        shutil.copytree(shipped, copy)
    paths = [str(copy) for copy in copies]
    found = score(["ppo", *paths], CAR, episodes=1, duration=0.5)
    assert [r["policy"] for r in found.policies] == ["passive", "ppo", *paths]
    assert len({json.dumps(r["cost"]) for r in found.policies[1:]}) == 1
    alone = score(paths[:1], CAR, episodes=1, duration=0.5)
    assert [r["policy"] for r in alone.policies] == ["passive", "ppo"]
    text = (shipped / "policy.json").read_text()
    (copies[0] / "policy.json").write_text(
        text.replace('"name": "ppo"', '"name": "passive"')
    )
    found = score(paths[:1], CAR, episodes=1, duration=0.5)
    assert [r["policy"] for r in found.policies] == ["passive", paths[0]]
    assert found.policies[0]["cost"]["value"] != found.policies[1]["cost"]["value"]
    for twice in (
        ["ppo", "ppo"],
        [paths[1], paths[1], "ppo"],
        [Entry("a", lambda: Idle("a"))] * 2,
    ):
        refused("is named twice", score, twice, CAR, episodes=1, duration=0.5)
