"""Channels with stamps of their own: they are resampled onto one grid, and the lag of another clock is found."""

from dataclasses import replace

import numpy as np
import pytest
from builders import QUARTER_CAR as CAR
from builders import channel, drive_quarter_car
from program import refused

from isd_gym import Network, Table, diagnose, simulate
from isd_gym.diagnosis._estimation.clock_lag import align_clocks
from isd_gym.diagnosis._records.resampling import build_record
from isd_gym.diagnosis._simulation.problem import Problem
from isd_gym.records.data import write_table
from isd_gym.records.loggers import ChannelMap, Recording, Signal, runs
from isd_gym.records.loggers.recording import sampled

NETWORK = Network.load(CAR)
CHANNELS = (*NETWORK.inputs, *NETWORK.outputs)


@pytest.fixture(scope="module")
def truth():
    """A drive at 4 kHz without noise, from rest."""
    time = 2.5e-4 * np.arange(40001)
    coarse, columns = drive_quarter_car(seconds=11.0)
    heights = np.interp(time, coarse, columns["road"] * np.minimum(coarse, 1.0))
    return time, {"road": heights} | simulate(CAR, time, {"road": heights})


def recording(truth, stamps, lag=0.0, noise=0.0, clocks=None):
    """The drive as logged: stamps by channel; those of the second clock are late by `lag`."""
    time, columns = truth
    rng = np.random.default_rng(3)
    clocks = clocks or {"road": "a"}
    signals = {}
    for c in CHANNELS:
        t = stamps[c.name]
        x = np.interp(t, time, columns[c.name])
        own = clocks.get(c.name, "b" if lag else "a")
        x = x + noise * x.std() * rng.standard_normal(len(x)) * (c.name != "road")
        signals[c.name] = Signal(t + (lag if own == "b" else 0.0), x, c.si, own, c.name)
    return Recording("run", signals)


def left(record):
    """RMS of what the true model leaves, over the deviation, by channel; from rest."""
    problem = Problem(NETWORK, [record], ["fit"])
    said = problem.simulate([NETWORK], 0)[:, :, 0]
    keep = slice(len(said) // 10, None)
    return (record.measured - said)[keep].std(axis=0) / record.measured[keep].std(
        axis=0
    )


def even(step, phase=0.0):
    return phase + step * np.arange(int((9.9 - phase) / step))


def test_two_rasters_are_compared_without_a_trace_of_resampling(truth):
    """Accelerations at 1 kHz, the travel at 130 Hz between their instants: the true model fits both."""
    stamps = {c.name: even(1e-3) for c in CHANNELS} | {"travel": even(1 / 130, 0.0033)}
    notes = []
    record = build_record(recording(truth, stamps), NETWORK, notes)
    assert record.interval == pytest.approx(1 / 130, rel=0.1)
    assert left(record).max() < 2e-3
    assert any(
        "body_acceleration" in n and "low-pass that the model passes, too" in n
        for n in notes
    )


def test_uneven_stamps_are_interpolated(truth):
    rng = np.random.default_rng(0)
    stray = even(2.5e-3) + 1e-3 * rng.uniform(-1, 1, len(even(2.5e-3)))
    stamps = {c.name: stray if c.name != "road" else even(2.5e-3) for c in CHANNELS}
    run = recording(truth, stamps)
    assert left(build_record(run, NETWORK)).max() < 3e-3
    # as if they were even, they do not fit
    as_even = {n: replace(s, time=even(2.5e-3)) for n, s in run.signals.items()}
    assert left(build_record(replace(run, signals=as_even), NETWORK)).max() > 0.02


@pytest.mark.parametrize("lag", [0.02, -0.02, 0.137])
def test_the_lag_of_another_clock_is_found_early_and_late(truth, lag):
    known = {"body.mass": 0.05, "damper.damping": 0.1, "spring.stiffness": 0.05}
    heavier = NETWORK.with_parameters({"body.mass": 362.0, "damper.damping": 1400.0})
    owner = replace(heavier, uncertainty=known)
    stamps = {c.name: even(2.5e-3) for c in CHANNELS} | {"road": even(2e-3)}
    run = recording(truth, stamps, lag, noise=0.03)
    record = build_record(run, owner)
    (made,), (found,) = align_clocks([record], owner)
    assert abs(found.value - lag) < 2e-4
    assert found.low < lag < found.high or abs(found.value - lag) < 5e-5
    assert made.source.lags == {"b": found.value}
    assert ("late" if lag > 0 else "early") in str(found)


def test_a_lag_that_is_known_is_taken(truth):
    stamps = {c.name: even(2.5e-3) for c in CHANNELS}
    run = replace(recording(truth, stamps, 0.03), lags={"b": 0.03})
    record = build_record(run, NETWORK)
    assert align_clocks([record], NETWORK) == ([record], [])
    assert left(record).max() < 3e-3


def test_a_held_input_is_averaged_from_instant_to_instant():
    held = Signal(np.arange(4.0), np.array([0.0, 2.0, 0.0, 0.0]), "A", "a")
    values, _ = sampled(held, np.array([0.5, 1.5, 2.5]), "current")
    assert values == pytest.approx([1.0, 1.0, 0.0])


def test_inputs_on_two_clocks_ask_for_the_lag():
    model = {**CAR, "inputs": [*CAR["inputs"], channel("push", "force", "body")]}
    network, t = Network.load(model), even(2.5e-3)
    channels = (*network.inputs, *network.outputs)
    signals = {
        c.name: Signal(t, np.sin(t), c.si, "ba"[c.name != "push"], c.name)
        for c in channels
    }
    refused(
        r'road on a, push on b.*"lag" in the map',
        build_record,
        Recording("run", signals),
        network,
    )


def test_a_rate_below_twice_the_motion_is_refused(truth):
    stamps = {c.name: even(2.5e-3) for c in CHANNELS} | {
        "wheel_acceleration": even(0.05)
    }
    words = "wheel_acceleration is logged at 20 Hz, below twice the motion.*--map"
    refused(words, diagnose, [recording(truth, stamps)], NETWORK, accept=["all"])


def test_a_channel_that_two_loggers_have_asks_for_the_map(tmp_path):
    t = even(2.5e-3)
    for name in ("a", "b"):
        write_table(
            tmp_path / f"{name}.csv", Table(t, {c.name: np.sin(t) for c in CHANNELS})
        )
    refused(
        r"choose one with --map FILE",
        runs,
        f"{tmp_path}/a.csv+{tmp_path}/b.csv",
        NETWORK,
        CHANNELS,
    )
    channels = {
        c.name: {"column": c.name, "logger": 1 + (c.name == "travel")} for c in CHANNELS
    }
    by = ChannelMap.from_dict({"schema": "isd-map/1", "channels": channels})
    (run,) = runs(f"{tmp_path}/a.csv+{tmp_path}/b.csv", NETWORK, CHANNELS, by=by)
    assert run.clocks == ["1 a.csv", "2 b.csv"]
    write_table(
        tmp_path / "c.csv",
        Table(t, {c.name: np.sin(t) for c in CHANNELS if c.name != "travel"}),
    )
    refused(
        r"travel in logger 2; name the files of one run together, as in .*\+",
        runs,
        f"{tmp_path}/c.csv",
        NETWORK,
        CHANNELS,
        by=by,
    )


def test_absolute_stamps_of_two_loggers_share_their_origin(tmp_path):
    for name, first, columns in (("a", 0.0, CHANNELS[:1]), ("b", 1.25, CHANNELS[1:])):
        rows = [",".join(["stamp", *(c.name for c in columns)])]
        for k in range(600):
            seconds = first + 0.01 * k
            values = [f"{np.sin(seconds):.6f}"] * len(columns)
            rows.append(",".join([f"2024-05-01T12:00:{seconds:09.6f}Z", *values]))
        (tmp_path / f"{name}.csv").write_text("\n".join(rows))
    (run,) = runs(f"{tmp_path}/a.csv+{tmp_path}/b.csv", NETWORK, CHANNELS)
    start, stop = run.together()
    assert start == pytest.approx(1.25, abs=0.03) and stop == pytest.approx(
        5.99, abs=0.03
    )
