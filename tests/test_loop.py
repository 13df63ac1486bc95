"""The loop closed: what the diagnosis finds makes the controller better on the plant that hides it."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "examples"))

from close_the_loop import close


@pytest.mark.slow
def test_the_completed_model_drives_the_car_better_than_the_owners():
    found, result = close(episodes=4)
    assert found.verdict == "missing_effect"
    assert [(e.effect, set(e.between or ())) for e in found.effects] == [
        ("coulomb_friction", {"piston", "joint"})
    ]
    level = found.effects[0].parameters["level"]
    assert level.value == pytest.approx(500.0, rel=0.03)
    assert found.gap["after"]["device_travel"] < 0.05 < found.gap["refit"]["device_travel"]
    cost = {row["policy"]: row["cost"] for row in result.to_dict()["policies"]}
    assert cost["mpc, new model"]["high"] < cost["mpc, old model"]["low"]
    assert cost["mpc, new model"]["change"] < -0.2
