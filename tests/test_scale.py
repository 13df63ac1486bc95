"""The data gate on rigs that are no cars: slow, large, tiny; the model tells what is plausible there."""

import builders
import numpy as np
import pytest
from builders import damper, friction, oscillator, sines
from program import refused

from isd_gym import Network, Table, simulate
from isd_gym.diagnosis._records.reading import read_record
from isd_gym.physics.network import own_time, slowest_time
from isd_gym.records.data import check


def rig(period, size):
    """A mass on a shaken base with that period [s], moved by some `size` [m], 25 samples a period."""
    w = 2 * np.pi / period
    parts = {"mass": 2.0, "stiffness": 2.0 * w**2, "damping": 0.8 * w}
    network = oscillator("place displacement mass", base="base", **parts)
    time = period / 25 * np.arange(1500)
    rng = np.random.default_rng(0)
    base = sines(time, np.geomspace(0.2, 2, 9) / period, 6 * rng.random(9), size)
    place = simulate(network, time, {"base": base}, step=period / 100)["place"]
    noisy = place + 0.01 * place.std() * rng.standard_normal(len(place))
    return network, Table(time, {"base": base, "place": noisy}, "rig")


def told(network, table):
    notes = []
    read_record(table, network, notes)
    return [n for n in notes if "unit" in n]


def test_the_own_time_of_a_model_is_that_of_its_slowest_swing():
    assert own_time(rig(3.0, 1.0)[0]) == pytest.approx(3.0 / (2 * np.pi), rel=1e-6)
    assert own_time(Network.load("quarter-car-passive")) == pytest.approx(
        0.128, rel=0.05
    )


@pytest.mark.parametrize(("period", "size"), [(40.0, 0.1), (9.0, 8.0), (0.01, 3e-9)])
def test_what_a_car_cannot_do_another_rig_can(period, size):
    network, table = rig(period, size)
    kinds = {"inputs": {"base": "displacement"}, "outputs": {"place": "displacement"}}
    assert any(
        "unit?" in f.message or "unit than s" in f.message
        for f in check(table, **kinds)
    )
    assert told(network, table) == []


def test_a_slip_of_the_unit_is_told_at_the_rigs_own_scale():
    """A tenth of a millimetre in mm is no figure that a car could not have."""
    network, table = rig(0.5, 2e-5)
    slipped = Table(table.time, table.columns | {"place": 1e3 * table["place"]}, "rig")
    (note,) = told(network, slipped)
    assert "place" in note and "a thousand times what the model says" in note
    (note,) = told(
        network,
        Table(table.time, table.columns | {"place": 1e-3 * table["place"]}, "rig"),
    )
    assert "a thousandth of" in note
    # a slow rig in milliseconds is refused as a car is
    network, table = rig(40.0, 0.1)
    refused(
        "another unit than s",
        read_record,
        Table(1e3 * table.time, table.columns, "rig"),
        network,
        [],
    )


def coast_down(step, samples=300, model_time=50.0):
    """A wheel that coasts down by drag, its nominal model with a bearing of that time constant [s]."""
    bearing, speed = (
        damper("wheel", "ground", 0.1 / model_time, "bearing"),
        "speed angular_velocity wheel",
    )
    network = builders.network("", [bearing], [], [speed], inertias={"wheel": 0.1})
    time = step * np.arange(samples)
    noise = 0.02 * np.random.default_rng(0).standard_normal(samples)
    return network, Table(time, {"speed": 75.0 / (1.0 + time / 60.0) + noise}, "wheel")


def free(network):
    """The wheel with dry friction in place of the bearing."""
    rub = friction("wheel", "ground", 0.1)
    return network.with_element(rub).without_element("bearing")


def test_a_quasi_static_test_may_have_any_step():
    bench = builders.network(
        "bench", [damper("rod", "ground", 5.0)], ["x displacement rod"], ["f force rod"]
    )
    assert slowest_time(bench) == np.inf  # all motion is prescribed
    t = np.arange(400.0)
    (note,) = told(
        bench, Table(t, {"x": np.sin(0.1 * t), "f": np.cos(0.1 * t)}, "slow")
    )
    assert "a step of 1 s" in note


def test_the_slowest_time_of_a_model_counts_relaxations_and_no_free_motion():
    assert slowest_time(coast_down(0.5, model_time=50.0)[0]) == pytest.approx(50.0)
    assert slowest_time(rig(3.0, 1.0)[0]) == pytest.approx(3.0 / (2 * np.pi), rel=1e-6)
    assert slowest_time(free(coast_down(0.5)[0])) == np.inf
    # the device of this car moves freely; the numbers that rounding gives such a motion are no time
    for name in ("quarter-car-isd", "half-car-isd", "full-car-isd"):
        slowest = slowest_time(Network.load(name))
        assert slowest is not None and slowest < 1.0
        assert own_time(Network.load(name)) == pytest.approx(0.136, rel=0.1)


def test_a_slow_relaxation_is_logged_slowly():
    assert told(*coast_down(0.5)) == []
    network, table = coast_down(0.5)
    refused(
        r"another unit than s.*--accept step",
        read_record,
        Table(1e3 * table.time, table.columns, "wheel"),
        network,
        [],
    )
    # a free wheel has no time of its own, and no time is in contradiction to the step
    (note,) = told(free(network), table)
    assert "warning" in note and "0.5 s" in note


def test_an_implausible_step_is_accepted_by_name():
    network, table = coast_down(0.5, model_time=0.01)
    refused("another unit than s", read_record, table, network, [])
    for accept in ("step", "all"):
        notes = []
        assert len(read_record(table, network, notes, [accept])) == len(table)
        assert any("another unit than s" in n for n in notes)


def test_few_samples_of_many_periods_are_no_short_record():
    network, table = rig(0.5, 0.01)
    parts = (slice(0, 1110, 6), slice(185), slice(63))
    few, brief, scrap = (
        Table(table.time[s], {n: x[s] for n, x in table.columns.items()}, "")
        for s in parts
    )
    assert len(few) == 185
    read_record(few, network, [])
    notes: list[str] = []
    read_record(brief, network, notes)
    assert any(
        "short: 185 samples of 200 (or 64 for 10 periods" in note for note in notes
    )
    refused("too short: 63 samples of at least 64", read_record, scrap, network, [])
