"""The generator of records with hidden effects: the stated effect explains the records."""

import json

import numpy as np
import pytest
from rigs.hidden import ALL_KINDS, make_case
from rigs.reference import simulate

pytestmark = pytest.mark.tools


def element(model, name):
    return next((e for e in model["elements"] if e.get("name") == name), None)


def gaps(model, case):
    record = case.estimation
    y = simulate(model, record["time"], record, step=2e-5)
    return {k: float(np.sqrt(np.mean((y[k] - record[k]) ** 2)) / np.std(record[k])) for k in y}


@pytest.mark.parametrize("kind", ALL_KINDS)
def test_every_kind_makes_records(kind):
    case = make_case(kind, 1, duration=1.0, step=1e-4, moving=False)
    channels = [c["name"] for c in case.model["inputs"] + case.model["outputs"]]
    for table in (case.estimation, case.validation):
        assert list(table) == ["time", *channels]
        assert all(len(column) == 501 and np.isfinite(column).all() for column in table.values())
        np.testing.assert_allclose(np.diff(table["time"]), 2e-3)
    assert set(case.model["uncertainty"].values()) == {case.spread}
    clean = kind.split("_")[-1] == "none" or kind.startswith("none")
    assert (case.answer == []) == clean
    assert (case.answer == "unknown") == ("out" in kind.split("_"))
    json.dumps([case.model, case.record()])


@pytest.mark.parametrize(
    "kind",
    ["friction_strut", "current_lag", "sensor_delay_acc", "rig_stribeck", "mass_cubic", "two_mass_inertance"],
)
def test_the_truth_explains_the_record_to_the_noise_and_the_owners_model_does_not(kind):
    case = make_case(kind, 3, duration=6.0, snr_db=30.0, spread=0.02, moving=False)
    floor = 10 ** (-30 / 20)
    explained, believed = gaps(case.truth["model"], case), gaps(case.model, case)
    # the owner's record of the current is late by up to one sample, which the device's travel feels
    assert max(explained.values()) < 1.5 * floor
    assert max(believed.values()) > 2.0 * floor
    assert max(case.visibility.values()) > 1.5


def test_a_force_cell_reads_what_stands_beside_its_element():
    case = make_case("damping_tyre", 4, duration=3.0, snr_db=60.0, moving=False, nuisances=0)
    record, true = case.estimation, case.truth["model"]
    cell = {"name": "tyre_force", "quantity": "force", "element": ["tyre", "hidden_1"]}
    both = simulate({**true, "outputs": [cell]}, record["time"], record, step=2e-5)["tyre_force"]
    alone = simulate(true, record["time"], record, step=2e-5)["tyre_force"]
    near, far = (np.std(record["tyre_force"] - y) / np.std(record["tyre_force"]) for y in (both, alone))
    assert near < 0.04 < 0.08 < far
