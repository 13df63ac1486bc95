"""The data gate on rigs that are no cars: slow, large, tiny; the model tells what is plausible there."""

import numpy as np
import pytest

from isd_gym.data import Table, check
from isd_gym.discrepancy.records import read_record
from isd_gym.errors import InputError
from isd_gym.network import Network, own_time
from isd_gym.simulate import simulate


def rig(period: float, size: float) -> tuple[Network, Table]:
    """A mass on a shaken base with that period [s], moved by some `size` [m], 25 samples a period."""
    w = 2 * np.pi / period
    network = Network.load(
        {
            "schema": "isd-model/1",
            "masses": {"mass": 2.0},
            "elements": [
                {
                    "name": "spring",
                    "type": "linear_stiffness",
                    "between": ["mass", "base"],
                    "stiffness": 2.0 * w**2,
                },
                {"name": "damper", "type": "linear_damping", "between": ["mass", "base"], "damping": 0.8 * w},
            ],
            "inputs": [{"name": "base", "quantity": "displacement", "at": "base", "unit": "m"}],
            "outputs": [{"name": "place", "quantity": "displacement", "at": "mass", "unit": "m"}],
        }
    )
    time = period / 25 * np.arange(1500)
    rng = np.random.default_rng(0)
    base = sum(
        size * np.sin(f * w * time + p)
        for f, p in zip(np.geomspace(0.2, 2, 9), 6 * rng.random(9), strict=True)
    )
    place = simulate(network, time, {"base": base}, step=period / 100)["place"]
    noisy = place + 0.01 * place.std() * rng.standard_normal(len(place))
    return network, Table(time, {"base": base, "place": noisy}, "rig")


def told(network: Network, table: Table) -> list[str]:
    notes: list[str] = []
    read_record(table, network, notes)
    return [n for n in notes if "unit" in n]


def test_the_own_time_of_a_model_is_that_of_its_slowest_swing() -> None:
    assert own_time(rig(3.0, 1.0)[0]) == pytest.approx(3.0 / (2 * np.pi), rel=1e-6)
    assert own_time(Network.load("quarter-car-passive")) == pytest.approx(0.128, rel=0.05)
    assert own_time(Network.load("force-rig")) is None or own_time(Network.load("force-rig")) > 0


@pytest.mark.parametrize(
    ("period", "size"), [(40.0, 0.1), (9.0, 8.0), (0.01, 3e-9)], ids=["slow", "large", "tiny"]
)
def test_what_a_car_cannot_do_another_rig_can(period: float, size: float) -> None:
    network, table = rig(period, size)
    kinds = {"inputs": {"base": "displacement"}, "outputs": {"place": "displacement"}}
    assert any("unit?" in f.message or "unit than s" in f.message for f in check(table, **kinds))
    assert told(network, table) == []


def test_a_slip_of_the_unit_is_told_at_the_rigs_own_scale() -> None:
    """A tenth of a millimetre in mm is no figure that a car could not have."""
    network, table = rig(0.5, 2e-5)
    slipped = Table(table.time, table.columns | {"place": 1e3 * table["place"]}, "rig")
    (note,) = told(network, slipped)
    assert "place" in note and "a thousand times what the model says" in note
    (note,) = told(network, Table(table.time, table.columns | {"place": 1e-3 * table["place"]}, "rig"))
    assert "a thousandth of" in note


def test_a_slow_rig_in_milliseconds_is_refused_as_a_car_is() -> None:
    network, table = rig(40.0, 0.1)
    with pytest.raises(InputError, match="another unit than s"):
        read_record(Table(1e3 * table.time, table.columns, "rig"), network, [])
