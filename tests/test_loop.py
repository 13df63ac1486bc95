"""The loop closed: what the diagnosis finds makes the controller better on the plant that hides it."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "examples"))

from close_the_loop import close


@pytest.mark.slow
def test_the_completed_model_drives_the_car_better_than_the_owners() -> None:
    found, result = close(episodes=4)
    assert found.verdict == "missing_effect"
    assert [(e.effect, set(e.between or ())) for e in found.effects] == [
        ("coulomb_friction", {"piston", "joint"})
    ]
    level = found.effects[0].parameters["level"]
    assert level.value == pytest.approx(500.0, rel=0.03)
    page = Path(__file__).resolve().parents[1] / "docs" / "validation" / "diagnosis.md"
    # where friction holds, the refit of the old model ends in one of several optima, by the rounding of the processor
    told = re.search(
        r"names the friction at its place with a level of (\S+) to (\S+) N\. .* between (\S+) and (\S+) % to (\S+) %",
        page.read_text(encoding="utf-8"),
    )
    assert told is not None
    least, most, least_before, most_before, after = map(float, told.groups())
    assert 0.995 * least <= level.value <= 1.005 * most
    assert least_before - 0.5 <= 100 * found.gap["refit"]["device_travel"] <= most_before + 0.5
    assert 100 * found.gap["after"]["device_travel"] == pytest.approx(after, abs=0.2)
    cost = {row["policy"]: row["cost"] for row in result.to_dict()["policies"]}
    assert cost["mpc, new model"]["high"] < cost["mpc, old model"]["low"]
    assert cost["mpc, new model"]["change"] < -0.2
