"""Loggers' files looked into: what is odd is told, columns find their channels, and bad maps are one line."""

import re
from pathlib import Path

import numpy as np
import pytest
from builders import QUARTER_CAR as CAR
from builders import channel, damper, drive_quarter_car, model, spring
from program import assert_one_line, printed, read_json, refused, save_json
from program import run as start

from isd_gym import Network, Table, simulate
from isd_gym.diagnosis._records.reading import read_record
from isd_gym.records.data import write_table
from isd_gym.records.inspection import inspect, lines
from isd_gym.records.inspection.map_file import save_map
from isd_gym.records.loggers import ChannelMap, Raster, mended, runs
from isd_gym.records.loggers.record_reading import records_of
from isd_gym.records.schemas import load

NAMES = {
    "road": "base",
    "body_acceleration": "az_body",
    "wheel_acceleration": "az_wheel",
    "travel": "stroke",
}


@pytest.fixture(scope="module")
def run():
    return drive_quarter_car()


def written(path, head, *columns):
    """A text table at `path`; a head of '' writes numbers alone."""
    np.savetxt(
        path,
        np.column_stack(columns),
        delimiter=",",
        header=head,
        comments="",
        fmt="%.12g",
    )
    if not head:
        path.write_text(path.read_text().lstrip("\n"))
    return path


def valid(path):
    pytest.importorskip("jsonschema").validate(read_json(path), load("isd-map/1"))
    return path


def found(tmp_path, run, names, units=None, suffix=".csv", factors=None):
    """What is suggested for columns of these names."""
    time, columns = run
    factors = factors or {}
    data = {n: columns[c] * factors.get(c, 1.0) for c, n in names.items()}
    head = ",".join(
        ["time", *(f"{n} [{units[c]}]" if units else n for c, n in names.items())]
    )
    file = tmp_path / f"rec{suffix}"
    if suffix == ".csv":
        written(file, head, time, *data.values())
    else:
        write_table(
            file,
            Table(
                time,
                data,
                units={n: units[c] for c, n in names.items()} if units else {},
            ),
        )
    return file, inspect([file], Network.load(CAR))


def chosen(made):
    return {
        name: pick.facts.name for name, (pick, _) in made.suggestion.channels.items()
    }


def test_names_that_say_nothing_are_told_by_physics_alone(tmp_path, run):
    names = {
        "travel": "ch3",
        "road": "ch1",
        "wheel_acceleration": "ch4",
        "body_acceleration": "ch2",
    }
    units = {
        "travel": "mm",
        "road": "mm",
        "wheel_acceleration": "g",
        "body_acceleration": "g",
    }
    factors = {n: 1 / 9.80665 if units[n] == "g" else 1e3 for n in names}
    _, made = found(tmp_path, run, names, units, factors=factors)
    assert chosen(made) == names
    assert all(sure > 0.9 for _, sure in made.suggestion.channels.values())


def test_a_column_without_a_unit_keeps_the_channel_s_and_another_is_asked_for(
    tmp_path, run
):
    file, made = found(tmp_path, run, NAMES, factors={"travel": -1e3})
    pick, _ = made.suggestion.channels["travel"]
    assert (pick.facts.name, pick.unit, pick.sign) == ("stroke", "m", -1)
    assert chosen(made) == NAMES
    assert "--unit stroke=mm?" in made.suggestion.remarks[0]
    told = inspect([file], Network.load(CAR), units={"stroke": "mm"})
    assert not told.suggestion.remarks
    assert told.map("car.json").channels["travel"].unit == "mm"


ANGLE = {"name": "phi", "quantity": "angle", "at": "arm", "unit": "deg"}
PENDULUM = model(
    "pendulum", [damper("arm", "ground", 0.01)], [], [ANGLE], inertias={"arm": 0.01}
)


@pytest.mark.parametrize(
    ("column", "unit"),
    [
        ("phi", "deg"),
        ("winkel", "deg"),
        ("enc_arm_rad", "rad"),
        ("Winkel mrad", "mrad"),
    ],
)
def test_the_unit_is_that_of_the_model_or_of_the_column_s_name(tmp_path, column, unit):
    """A swing of 100 is plausible in deg, and in mrad too: nothing is guessed from the size."""
    time = 0.01 * np.arange(600)
    file = written(
        tmp_path / "rec.csv",
        f"time,{column}",
        time,
        100 * np.exp(-0.2 * time) * np.cos(6 * time),
    )
    made = inspect([file], Network.load(PENDULUM))
    assert made.map("pendulum.json").channels["phi"].unit == unit


def test_an_input_whose_outputs_are_all_turned_is_asked_for(tmp_path, run):
    _, made = found(tmp_path, run, NAMES, factors={"road": -1.0})
    assert {pick.sign for pick, _ in made.suggestion.channels.values()} == {1}
    assert made.suggestion.remarks == [
        "all outputs follow the model turned round: --sign road=-1?"
    ]


@pytest.mark.parametrize("cell", ["OVERLOAD", "\u22120.5"])
def test_a_text_among_the_numbers_is_told_and_the_column_stays(tmp_path, run, cell):
    time, columns = run
    file = written(
        tmp_path / "rec.csv", ",".join(["time", *columns]), time, *columns.values()
    )
    rows = file.read_text().splitlines()
    at = 1 + list(columns).index("travel")
    cells = rows[200].split(",")
    rows[200] = ",".join([*cells[:at], cell, *cells[at + 1 :]])
    file.write_text("\n".join(rows), encoding="utf-8")
    made = inspect([file], Network.load(CAR))
    assert chosen(made)["travel"] == "travel"
    assert [str(o) for o in made.oddities] == [
        f"travel: line 201: '{cell}' is not a number; correct the file"
    ]
    save_map(made.map("car.json"), tmp_path / "map.json")
    by = ChannelMap.load(tmp_path / "map.json")
    network = Network.load(CAR)
    refused(
        f"column 'travel', line 201: '{cell}' is",
        runs,
        file,
        network,
        network.outputs,
        by=by,
    )


def test_two_columns_that_could_be_it_are_not_called_sure(tmp_path, run):
    time, columns = run
    twin = columns["travel"] + 1e-5 * np.random.default_rng(1).standard_normal(
        len(time)
    )
    file = tmp_path / "rec.csv"
    more = {"travel_2": twin, "travel": twin[::-1], "travel_1": columns["travel"]}
    write_table(file, Table(time, columns | more))
    made = inspect([file], Network.load(CAR)).suggestion.channels["travel"]
    assert made[0].facts.name in ("travel_1", "travel_2")
    assert made[1] < 0.9


def test_what_is_odd_is_told(tmp_path, run):
    time, columns = run
    frozen = columns["travel"].copy()
    frozen[2000:2100] = frozen[2000]
    keep = np.r_[0:1000, 1400 : len(time)]
    rows = np.column_stack([time, frozen, 1e3 * columns["road"], 0 * time])[keep]
    file = written(tmp_path / "rec.csv", "time,frozen [m],road [m],dead [V]", rows)
    told = " ".join(" ".join(lines(inspect([file]))).split())
    assert "a gap: 1 s at 2.4975 s" in told
    assert "frozen: " in told and "frozen, dropped out?" in told
    assert "it would be plausible: --unit road=mm" in told
    assert "dead: is constant (0)" in told


def test_a_rate_that_is_too_slow_is_told(tmp_path):
    time = 0.1 * np.arange(600)
    file = tmp_path / "rec.csv"
    write_table(file, Table(time, {"x": np.sin(2 * np.pi * 3.7 * time)}))
    assert "too slow for the motion" in " ".join(
        " ".join(lines(inspect([file]))).split()
    )


def test_two_runs_of_one_logger_are_told(tmp_path):
    files = [tmp_path / "run1.csv", tmp_path / "run2.csv"]
    for file in files:
        write_table(file, Table(0.01 * np.arange(99), {"x": np.arange(99.0)}))
    words = "the same columns as run1.csv; if they are two runs, inspect one of them"
    assert words in map(str, inspect(files).oddities)


def test_the_terminal_holds_80_columns_and_the_page_fetches_nothing(tmp_path, run):
    names = {c: f"a_rather_long_name_of_a_column_{c}" for c in run[1]}
    _, made = found(tmp_path, run, names)
    assert max(map(len, lines(made, 80))) <= 80


def test_the_command_writes_over_no_record(tmp_path):
    file = tmp_path / "rec.csv"
    write_table(file, Table(0.01 * np.arange(400), {"x": np.sin(0.1 * np.arange(400))}))
    before = file.read_bytes()
    printed("inspect", file, "--json", tmp_path / "facts.json")
    assert (tmp_path / "facts.json").exists()
    words = "it is an input file"
    assert_one_line(start("inspect", file, "--json", file), words)
    assert file.read_bytes() == before


def raster(time, **columns):
    return Raster(
        "rec.csv",
        np.asarray(time, float),
        {k: np.asarray(v, float) for k, v in columns.items()},
    )


def test_gaps_split_a_record_and_say_where():
    time = np.r_[0:500, 800:1200, 1300:1310] * 0.01
    notes = []
    pieces = mended(raster(time, x=np.sin(time)), notes)
    assert [len(p) for p in pieces] == [500, 400]
    assert (
        "split at 2 gaps (3.01 s at 4.99 s" in notes[0] and "1 of 3 pieces" in notes[0]
    )


def test_samples_that_are_there_twice_are_taken_once():
    time, x = 0.01 * np.arange(600), np.random.default_rng(0).standard_normal(600)
    order = np.sort(np.r_[0:600, 100:150])
    notes = []
    (piece,) = mended(raster(time[order], x=x[order]), notes)
    np.testing.assert_array_equal(piece.columns["x"], x)
    assert "50 samples are there twice, first 1.000000 s" in notes[0]


def test_stamps_coarser_than_the_sampling_are_evenly_spread():
    time = np.floor(0.0025 * np.arange(2000) * 100) / 100
    notes = []
    (piece,) = mended(raster(time, x=np.arange(2000)), notes)
    assert np.ptp(np.diff(piece.time)) < 1e-12 and "taken as evenly sampled" in notes[0]


@pytest.mark.parametrize(
    ("order", "words"),
    [
        (np.r_[0:300, 250:400], "run backwards after sample 300"),
        (np.r_[399:-1:-1], "run backwards after sample 1"),
    ],
)
def test_overlapping_and_reversed_stamps_are_refused(order, words):
    refused(words, mended, raster(0.01 * order, x=np.arange(len(order))), [])


def message_of(*words):
    done = start(*words)
    assert_one_line(done)
    return done.stderr


def simulated(folder, model, *more):
    files = (folder / model, folder / "rec.csv")
    message = message_of("simulate", *files, *more, "--out", folder / "o.csv")
    assert not (folder / "o.csv").exists()
    return message


def test_a_map_drives_a_simulation(tmp_path, run):
    time, columns = run
    write_table(tmp_path / "rec.csv", Table(time, {"base": 1e3 * columns["road"]}))
    save_json(tmp_path / "car.json", CAR)
    by = {"schema": "isd-map/1", "channels": {"road": {"column": "base", "unit": "mm"}}}
    save_json(tmp_path / "map.json", by)
    words = [
        tmp_path / "car.json",
        tmp_path / "rec.csv",
        "--map",
        tmp_path / "map.json",
    ]
    printed("simulate", *words, "--out", tmp_path / "out.csv")
    seen = np.loadtxt(tmp_path / "out.csv", delimiter=",", skiprows=1)
    truth = simulate(CAR, time, {"road": columns["road"]}, interpolation="auto")
    np.testing.assert_allclose(
        seen[:, 1], truth["body_acceleration"], rtol=1e-6, atol=1e-9
    )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            {"channels": {"road": {"column": "bse"}}},
            "no column 'bse', which .* for road; did you mean 'base'",
        ),
        (
            {"channels": {"raod": {"column": "base"}}},
            "no channel 'raod'; did you mean 'road'",
        ),
        ({"channels": {"travel": {"column": "base"}}}, "no column for the input road"),
        (
            {"channels": {"road": {"column": "base", "unit": "furlong"}}},
            "unknown unit 'furlong'",
        ),
        (
            {"channels": {"road": {"column": "base", "sign": 2}}},
            r"json: channels.road.sign: 2 is not one of \[1",
        ),
        ({"channels": {}}, "channels: {} should be non-empty"),
        ({"schema": "isd-model/1"}, "schema: 'isd-map/1' was expected"),
        ({"chanels": {}}, "'chanels' was unexpected"),
    ],
)
def test_a_wrong_map_is_one_line_and_nothing_is_written(tmp_path, run, change, words):
    time, columns = run
    write_table(tmp_path / "rec.csv", Table(time, {"base": columns["road"]}))
    save_json(tmp_path / "car.json", CAR)
    good = {"schema": "isd-map/1", "channels": {"road": {"column": "base"}}}
    save_json(tmp_path / "map.json", good | change)
    assert re.search(
        words, simulated(tmp_path, "car.json", "--map", tmp_path / "map.json")
    )


BASE = channel("base", "displacement", "base", unit="mm")
SWING = model(
    "swing",
    [spring("mass", "base", 800.0)],
    [BASE],
    ["x displacement mass"],
    masses={"mass": 2.0},
)


def test_a_simulation_begins_as_it_is_told(tmp_path):
    time = 0.01 * np.arange(200)
    write_table(tmp_path / "rec.csv", Table(time, {"base": np.full(200, 3.0)}))
    save_json(tmp_path / "swing.json", SWING)
    words = [tmp_path / "swing.json", tmp_path / "rec.csv", "--out", tmp_path / "o.csv"]
    words += ["--initial", "mass=0.01", "--initial", "mass.velocity=0.1"]
    printed("simulate", *words)
    seen = np.loadtxt(tmp_path / "o.csv", delimiter=",", skiprows=1)[:, 1]
    truth = (
        0.003 + 0.007 * np.cos(20 * time) + 0.1 / 20 * np.sin(20 * time)
    )  # about the base, at 20 rad/s
    np.testing.assert_allclose(seen, truth, atol=1e-9)


@pytest.mark.parametrize(
    ("word", "words"),
    [
        ("mas=1", "'mas' is no node"),
        ("base=1", "'base' is moved by an input"),
        ("mass=x", "give NODE=VALUE"),
        ("mass", "give NODE=VALUE"),
    ],
)
def test_a_wrong_start_is_one_line(tmp_path, word, words):
    write_table(
        tmp_path / "rec.csv", Table(0.01 * np.arange(200), {"base": np.zeros(200)})
    )
    save_json(tmp_path / "swing.json", SWING)
    assert words in simulated(tmp_path, "swing.json", "--initial", word)


def inspected(*words):
    text = printed("inspect", *words)
    # a path is never wrapped
    rows = [line for line in text.splitlines() if not line.startswith("map: ")]
    assert max(map(len, rows)) <= 80
    return text


def test_a_file_without_a_header_is_read_by_the_names_that_are_told(tmp_path, run):
    time, columns = run
    file = written(tmp_path / "bare.csv", "", time, *columns.values())
    save_json(tmp_path / "car.json", CAR)
    car, out = tmp_path / "car.json", tmp_path / "out.csv"
    for words in (["inspect", file], ["simulate", car, file, "--out", out]):
        assert "--columns NAME,NAME,..." in message_of(*words)
    assert "names 2 columns, line 1 has 5" in message_of(
        "inspect", file, "--columns time,x"
    )
    assert "name 2 of 2 is empty" in message_of("inspect", file, "--columns time,")
    assert "names 'time' twice" in message_of("inspect", file, "--columns time,time")
    names = ",".join(["time", *columns]).replace("travel", "travel [m]")
    names = Path(names)  # one word, although it has a space
    asked = ["--columns", names, "--model", car, "--out", tmp_path / "map.json"]
    text = inspected(file, *asked)
    assert "5 fields" not in text and "  travel " in text
    valid(tmp_path / "map.json")
    truth = simulate(CAR, time, {"road": columns["road"]}, interpolation="auto")[
        "travel"
    ]
    # the map remembers the names
    for more in (["--columns", names], ["--map", tmp_path / "map.json"]):
        printed("simulate", car, file, "--out", out, *more)
        np.testing.assert_allclose(
            np.loadtxt(out, delimiter=",", skiprows=1)[:, 3], truth, atol=1e-6
        )


BEARING = damper("wheel", "ground", 0.02, "bearing")
TURNING = model("spin", [BEARING], [], ["angle angle wheel"], inertias={"wheel": 0.2})


@pytest.mark.parametrize("unit", ["deg", "rad"])
@pytest.mark.parametrize("low", [0.0, -0.5])
def test_an_angle_that_begins_anew_each_turn_is_unwrapped_with_a_note(
    tmp_path, unit, low
):
    time = 0.002 * np.arange(4000)
    turn = {"deg": 360.0, "rad": 2 * np.pi}[unit]
    turns = 30 * (1 - np.exp(-0.1 * time)) + 1e-4 * np.random.default_rng(
        0
    ).standard_normal(4000)
    head, angle = (
        f"time,angle [{unit}],total [{unit}]",
        turn * ((turns - low) % 1 + low),
    )
    file = written(tmp_path / "rec.csv", head, time, angle, turn * turns)
    text = inspected(file)
    assert "angle: an angle that begins anew each turn" in text
    assert "total:" not in text  # that one goes on by itself
    network = Network.load(TURNING)
    for path in (
        file,
        f"{file}+{written(tmp_path / 'more.csv', 'time,other', time, time)}",
    ):
        (record,) = records_of(path, network, network.outputs)
        angle = record.signals["angle"].values
        np.testing.assert_allclose(
            np.diff(angle), 2 * np.pi * np.diff(turns), atol=1e-4
        )
        assert any("an angle that begins anew each turn" in n for n in record.notes)
        assert read_record(record, network, []).measured.shape == (4000, 1)
