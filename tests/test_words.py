"""The verdict in words: what the records to report by say against it is said."""

from __future__ import annotations

import numpy as np

from isd_gym.discrepancy.criteria import CRITERIA
from isd_gym.discrepancy.evidence import Evidence
from isd_gym.discrepancy.result import Effect, Quantity, Tabulated
from isd_gym.discrepancy.words import NOT_BORNE_OUT, sentence, unnamed

SEEN = Evidence(("travel",), (0.3,), (0.3,), (0.02,), (0.02,), (True,), (0.03,))
FRICTION = Effect(
    "coulomb_friction", ("mass", "ground"), None, 0.9, {"level": Quantity(3.0, 2.9, 3.1, "N", None)}, "seal"
)


def said(after: float) -> str:
    rows = {"before": 0.4, "refit": 0.3, "after": after, "noise_floor": 0.02}
    gap = {row: {"travel": value} for row, value in rows.items()}
    return sentence("missing_effect", [FRICTION], [], [], [], gap, SEEN, CRITERIA)


def test_a_name_that_the_records_to_report_by_do_not_bear_out_says_so() -> None:
    assert "falls from 30.0 % to 2.1 %" in said(0.021)
    assert NOT_BORNE_OUT not in said(0.021)
    assert "rises from 30.0 % to 90.0 %" in said(0.9)
    assert said(0.9).endswith(NOT_BORNE_OUT)


def test_so_does_a_table() -> None:
    axis = np.linspace(-1.0, 1.0, 5)
    table = Tabulated(("mass", "ground"), "rate", "missing_force", 0.6, (), tuple(axis), axis, axis, axis)
    assert NOT_BORNE_OUT not in unnamed(table, 0.5)
    assert unnamed(table, -0.5).endswith(NOT_BORNE_OUT)
