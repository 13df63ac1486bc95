"""Tables in and out, and the data gate, on records whose truth is known."""

import re
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from program import refused
from scipy import io, signal

from isd_gym import Table, read_table
from isd_gym.records.data import check, write_table
from isd_gym.records.data._quality import held_samples
from isd_gym.records.data._signals import unwrapped
from isd_gym.records.data._table import read_columns

STEP = 0.002
INPUTS = {"road": "displacement", "current": "current"}
OUTPUTS = {"acceleration": "acceleration", "travel": "displacement", "tyre": "force"}


def ar1(rng, n, lag1):
    """AR(1) noise of unit variance (n,)."""
    white = rng.standard_normal(n + 300)
    return signal.lfilter([np.sqrt(1 - lag1**2)], [1, -lag1], white)[300:]


@cache
def car(seed=0, seconds=12.0, snr_db=32.0, step=STEP):
    """The passive quarter car of Table 6 on a random road (scipy's lsim), with noise on what is measured, and a
    saturated current in a zero-order hold, which the gate must leave alone."""
    rng = np.random.default_rng(seed)
    ms, mu, k, c, kt = 345.0, 45.0, 22000.0, 1500.0, 192000.0
    a = np.array(
        [[0, 1, 0, 0], [-k, -c, k, c], [0, 0, 0, 1], [k, c, -k - kt, -c]], float
    )
    a[1] /= ms
    a[3] /= mu
    b = np.array([[0], [0], [0], [kt / mu]])
    measured = np.array([a[1], [1, 0, -1, 0], [0, 0, kt, 0]])
    time = step * np.arange(round(seconds / step))
    white = rng.standard_normal(len(time)) * np.sqrt(step) * 0.02
    road = signal.lfilter([1], [1, -np.exp(-0.3 * step)], white)
    road = signal.sosfiltfilt(signal.butter(2, 40 * 2 * step, output="sos"), road)
    _, y, _ = signal.lsim((a, b, measured, np.array([[0], [0], [-kt]])), road, time)
    y = y + np.column_stack([ar1(rng, len(time), 0.4) for _ in range(3)]) * y.std(
        0
    ) * 10 ** (-snr_db / 20)
    hold = round(0.006 / step)
    current = np.clip(3 * ar1(rng, len(time) // hold + 1, 0.97), -5, 5).repeat(hold)[
        : len(time)
    ]
    columns = dict(
        zip(("road", "current", *OUTPUTS), (road, current, *y.T), strict=True)
    )
    return Table(time, columns, "car", {"tyre": "N"})


def replaced(table, **columns):
    return Table(table.time, table.columns | columns, table.source, table.units)


def judged(table):
    return check(table, inputs=INPUTS, outputs=OUTPUTS)


def serious(findings):
    return [str(f) for f in findings if f.level != "note"]


def test_table_is_frozen_and_checks_its_columns():
    table = Table(np.arange(3), {"a": np.array([1, 2, 3])})
    with pytest.raises(ValueError, match="read-only"):
        table["a"][0] = 5
    refused("'b' has shape", Table, np.arange(3), {"b": np.arange(4)})
    refused(
        "did you mean 'travel'",
        Table(np.arange(3), {"travel": np.arange(3)}).__getitem__,
        "travl",
    )
    refused("no time step", lambda: Table(np.zeros(1), {}).step)


@pytest.mark.parametrize("suffix", [".csv", ".tsv", ".txt", ".parquet", ".mat", ".mf4"])
def test_what_is_written_is_read_back_to_the_last_bit(tmp_path, suffix):
    table, path = car(seconds=1), tmp_path / f"record{suffix}"
    write_table(path, table)
    again = read_table(path)
    assert list(again.columns) == list(table.columns)
    for n in table.columns:
        np.testing.assert_array_equal(again[n], table[n])
    assert [*tmp_path.iterdir()] == [path]
    decay = read_table(path, expected={})  # no channels
    np.testing.assert_array_equal(decay.time, table.time)
    if suffix in (".parquet", ".mat", ".mf4"):
        assert again.units == {"tyre": "N"}


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.floats(allow_nan=False, width=64), min_size=1, max_size=30),
    st.sampled_from(
        [(",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ","), (" ", ".")]
    ),
    st.sampled_from(["plain", "brackets", "row"]),
    st.sampled_from(["", "\ufeff", "# bench 4\nproject;x\n"]),
)
def test_any_dialect_of_csv_gives_the_same_numbers(
    tmp_path_factory, values, dialect, units, preamble
):
    delimiter, decimal = dialect
    head = {
        "plain": ["time", "f"],
        "brackets": ["time[s]", "f[kN]"],
        "row": ["time", "f"],
    }[units]
    rows = [head] + ([["s", "kN"]] if units == "row" else [])
    rows += [
        [repr(x).replace(".", decimal) for x in (0.001 * i, v)]
        for i, v in enumerate(values)
    ]
    path = tmp_path_factory.mktemp("csv") / "x.csv"
    path.write_text(
        preamble + "\n".join(delimiter.join(r) for r in rows), encoding="utf-8"
    )
    table = read_table(path, expected={"f": "kN"}, units={"f": "kN"})
    assert np.array_equal(table["f"], values)
    if units != "plain":
        assert read_table(path).units["f"] == "kN"


def test_channels_are_renamed_and_converted(tmp_path):
    path = tmp_path / "bench.csv"
    rows = "0;1,5;2,5;1;start\n2;-3;0;-0,5;\n4;0;1;0;end\n"
    path.write_text("Time [ms];Weg (mm);Kraft [kN];a [g];remark\n" + rows)
    names = {"Time": "time", "Weg": "travel", "Kraft": "force", "a": "acceleration"}
    units = {"travel": "m", "force": "N", "acceleration": "m/s^2"}
    table = read_table(path, rename=names, expected=units)
    assert table.time == pytest.approx([0, 0.002, 0.004])
    assert table["travel"] == pytest.approx([0.0015, -0.003, 0])
    assert table["force"] == pytest.approx([2500, 0, 1000])
    assert table["acceleration"] == pytest.approx([9.80665, -4.903325, 0])
    assert table.units == units
    assert "remark" not in read_table(path, rename={"Time": "time"}).columns
    # the model's own unit may be another than SI, and what the user says goes before what the file says
    own = read_table(path, rename={"Weg": "x"}, expected={"x": "mm"})
    assert own["x"] == pytest.approx([1.5, -3, 0])
    told = read_table(path, units={"Weg": "cm"}, expected={"Weg": "m"})
    assert told["Weg"][1] == pytest.approx(-0.03)


BAD_FILES = {
    "empty.csv": ("", "is empty"),
    "binary.csv": (b"\x00\x01\x02", "not a text table"),
    "bare.csv": (
        "0,1\n1,2\n",
        "line 1 has 2 fields, no header row names them: name the columns with --columns NAME,NAME",
    ),
    "words.csv": ("time,travel\na,b\n", "no columns of numbers"),
    "ragged.csv": (
        "time,travel\n0,1\n1,2,3\n2,3\n",
        "line 3 has 3 fields, the header has 2",
    ),
    "text.csv": (
        "time,travel\n0,1\n1,oops\n2,3\n",
        "line 3, column 'travel': 'oops' is not a number",
    ),
    "twice.csv": ("time,travel,travel\n0,1,1\n1,2,2\n", "names 'travel' twice"),
    "lacking.csv": (
        "time,travl\n0,1\n1,2\n",
        "no column 'travel'; did you mean 'travl'",
    ),
    "timeless.csv": ("index,travel\n0,1\n1,2\n", "no column 'time'"),
    "weight.csv": (
        "time,travel [kg]\n0,1\n1,2\n",
        "column 'travel': unknown unit 'kg'",
    ),
    "wrong.csv": (
        "time,travel [N]\n0,1\n1,2\n",
        "column 'travel': unit 'N' cannot be converted to 'm'",
    ),
    "broken.parquet": (b"PAR1 and no more", "cannot be read"),
    "broken.mat": (b"MATLAB no more" * 20, "cannot be read|not a MATLAB file"),
    "broken.mf4": (b"MDF     4.10    " * 8, "is not an MDF file"),
    "record.docx": ("", "cannot tell the format from suffix '.docx'"),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_a_bad_file_is_answered_in_one_line(tmp_path, name):
    content, answer = BAD_FILES[name]
    path = tmp_path / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    assert str(path) in refused(answer, read_table, path, expected={"travel": "m"})


HEADERS = {
    "one row": ["time,force [kN],travel [mm]"],
    "a row of units": ["time,force,travel", "s,kN,mm"],
    "units beside gaps": ["time,force,travel,state", "s,kN,mm,-"],
    "names that are units": ["t,A,V", "s,kN,mm"],
    "numbered channels below": [
        "time,force,travel",
        "Channel 1,Channel 2,Channel 3",
        "s,kN,mm",
    ],
    "numbered channels above": ["CH1,CH2,CH3", "time [s],force [kN],travel [mm]"],
    "descriptions below": [
        "Time,force,travel",
        "since the start,load cell,string pot",
        "[s],[kN],[mm]",
    ],
    "descriptions at the end": [
        "time,force,travel",
        "s,kN,mm",
        "clock,load cell A,string pot",
    ],
    "a preamble as wide": ["bench 4,rig B,", "time,force,travel", "s,kN,mm"],
    "seconds by another name": ["time,force,travel", "sec,kN,mm"],
    "units of which half are known": ["time,force,travel,x", "s,kN,mm,degC"],
    "a preamble that ends in a letter": ["bench,A,V", "time,force [kN],travel [mm]"],
    "without a name of time": ["Bench 4,by,Meier", "x1,x2,x3", "s,kN,mm"],
}


@pytest.mark.parametrize("how", HEADERS)
def test_a_second_header_row_is_no_unit_and_no_name(tmp_path, how):
    head = HEADERS[how]
    width = head[0].count(",") + 1
    rows = [
        ",".join(["0.5", "1.5", "-2", "7"][:width]),
        ",".join(["1.0", "2.5", "3", "7"][:width]),
    ]
    path = tmp_path / "x.csv"
    path.write_text("\n".join([*head, *rows]) + "\n")
    names = {
        "names that are units": ["t", "A", "V"],
        "without a name of time": ["x1", "x2", "x3"],
    }.get(how, ["Time" if how == "descriptions below" else "time", "force", "travel"])
    columns = read_columns(path)
    assert list(columns.values)[:3] == names
    assert [columns.units.get(n) for n in names[1:]] == ["kN", "mm"]
    assert [list(columns.values[n]) for n in names] == [
        [0.5, 1.0],
        [1.5, 2.5],
        [-2.0, 3.0],
    ]


def test_a_first_row_with_gaps_belongs_to_the_numbers(tmp_path):
    (tmp_path / "x.csv").write_text("time,a,b\n0,,\n1,2,3\n2,3,4\n")
    assert list(read_table(tmp_path / "x.csv").time) == [0, 1, 2]


@pytest.mark.parametrize("form", ["brackets", "row", "parquet"])
def test_columns_that_differ_by_their_unit_alone_are_both_there(tmp_path, form):
    marks = "Force [V]", "Force [N]"
    if form != "row":
        marks = "Force (V)", "Force (N)"
    first, second = marks
    if form == "parquet":
        pyarrow = pytest.importorskip("pyarrow")
        from pyarrow import parquet

        path = tmp_path / "x.parquet"
        data = {"time": [0.0, 1.0], first: [1.0, 2.0], second: [10.0, 20.0]}
        parquet.write_table(pyarrow.table(data), path)
    else:
        path = tmp_path / "x.csv"
        head = "time,Force,Force\ns,V,N" if form == "row" else f"time,{first},{second}"
        path.write_text(f"{head}\n0,1,10\n1,2,20\n")
    columns = read_columns(path)
    assert list(columns.values) == ["time", first, second]
    assert [columns.units[n] for n in marks] == ["V", "N"]
    # the unit that fits the channel, under the column's name or a rename of it; each by its whole name
    for rename, expected, values in (
        ({}, {"Force": "kN"}, [0.01, 0.02]),
        ({}, {"Force": "mV"}, [1000, 2000]),
        ({"Force": "load"}, {"load": "N"}, [10, 20]),
        ({first: "u"}, {"u": "V"}, [1, 2]),
    ):
        (name,) = expected
        read = read_table(path, rename=rename, expected=expected)
        assert list(read[name]) == values
    words = r"called 'Force': .* and .*; choose one with --rename COLUMN=CHANNEL"
    refused(words, read_table, path, expected={"Force": "m"})


@pytest.mark.parametrize("rate", [1024.0, 900.0, 256.0, 48.0, 2048.0])
@pytest.mark.parametrize("begin", [0.0, 1.7e9])
def test_the_rate_of_rounded_stamps_comes_from_the_whole_span(rate, begin):
    count = 5000
    table = car()
    time = np.round(begin + 0.0003 + np.arange(count) / rate, 3)
    rounded = Table(time, {n: x[:count] for n, x in table.columns.items()})
    assert 1 / rounded.step == pytest.approx(rate, rel=2e-6)
    assert (
        np.abs(
            rounded.uniform().time - (begin + 0.0003 + np.arange(count) / rate)
        ).max()
        < 1e-4
    )
    if begin == 0:  # what the stamps' unit says of absolute ones is for the reader
        assert not [
            f for f in judged(rounded) if f.channel == "time" and f.level != "note"
        ]


def test_spikes_and_small_swings_are_no_wraps():
    x = 20.0 * np.sin(STEP * 9 * np.arange(5000))
    assert unwrapped(x, 360.0)[1] == 0
    x[700] = 359.0
    assert unwrapped(x, 360.0)[1] == 0
    assert unwrapped(np.where(np.arange(5000) < 2500, 0.0, 350.0), 360.0)[1] == 0


def test_missing_files_folders_and_renames_are_told(tmp_path):
    (tmp_path / "a.csv").mkdir()
    good, table = tmp_path / "b.csv", car(seconds=1)
    write_table(good, table)
    refused("no such file", read_table, tmp_path / "no.csv")
    refused("suffix", read_table, tmp_path)
    refused("is a folder", read_table, tmp_path / "a.csv")
    words = "no column 'trvel' to rename; did you mean 'travel'"
    refused(words, read_table, good, rename={"trvel": "x"})
    refused("no folder", write_table, tmp_path / "none" / "b.csv", table)
    refused("cannot write suffix", write_table, tmp_path / "b.xlsx", table)
    odd = Table(np.arange(3), {"2nd": np.arange(3)})
    refused("no name for a MATLAB variable", write_table, tmp_path / "b.mat", odd)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.csv", "b.csv"]


def test_empty_cells_are_missing_samples(tmp_path):
    (tmp_path / "x.csv").write_text("time,a\n0,1\n1,\n2,NaN\n3,4\n")
    assert np.array_equal(
        read_table(tmp_path / "x.csv")["a"], [1, np.nan, np.nan, 4], equal_nan=True
    )


def test_mat_structs_are_read_and_objects_refused(tmp_path):
    path = tmp_path / "x.mat"
    time = np.arange(5.0)
    log = {"time": time, "x": time**2, "rate": 1000.0}
    io.savemat(path, {"log": log, "note": "bench", "long": np.zeros(9)})
    assert list(read_table(path).columns) == ["x"]
    assert np.array_equal(read_table(path, expected={"x": "m"})["x"], time**2)
    refused("has shape", read_table, path, expected={"x": "m", "long": "N"})
    cell = np.empty(5, object)
    cell[:] = "a"
    io.savemat(path, {"time": time, "x": cell})
    refused("refused", read_table, path, expected={"x": "m"})


def test_mdf_rasters_units_and_formulas(tmp_path):
    asammdf = pytest.importorskip("asammdf")
    path = tmp_path / "x.mf4"
    fast, slow = np.arange(200) * 0.001, np.arange(100) * 0.002
    with asammdf.MDF(version="4.10") as mdf:
        for name, values, time, more in (
            ("x", fast * 1e3, fast, {"unit": "mm"}),
            ("f", 2 * slow, slow, {"unit": "kN"}),
            ("g", 2 * slow, slow, {"unit": "N"}),
            ("g", 2 * slow, slow, {"unit": "N"}),
            ("algebra", slow, slow, {"conversion": {"formula": "X1*2+1"}}),
        ):
            mdf.append([asammdf.Signal(values, time, name=name, **more)])
        mdf.save(path)
    assert read_table(path, expected={"x": "m"})["x"] == pytest.approx(fast)
    both = read_table(path, expected={"f": "N", "g": "N"})
    assert both["f"] == pytest.approx(2000 * slow)
    for names, words in (
        (("x", "f"), "different rasters of 200, 100 samples"),
        (("algebra",), "no channel 'algebra'"),
        (("y",), "no channel 'y'"),
    ):
        refused(words, read_table, path, expected=dict.fromkeys(names, "N"))


@pytest.mark.parametrize("seed", range(4))
def test_clean_records_pass_at_any_usual_noise_and_rate(seed):
    for snr_db in (20.0, 26.0, 40.0, 60.0, 300.0):
        assert judged(car(seed, snr_db=snr_db)) == []
    step = (0.0005, 0.001, 0.005, 0.01)[seed]
    assert serious(judged(car(step=step, seconds=2400 * step))) == []


@pytest.mark.parametrize(
    ("levels", "snr_db"), [(200, 26.0), (2000, 50.0), (200, 300.0), (20000, 300.0)]
)
def test_encoders_and_rounded_files_pass(levels, snr_db):
    table = car(snr_db=snr_db)
    grid = {n: np.ptp(table[n]) / levels for n in table.columns}
    coarse = {n: np.round(table[n] / grid[n]) * grid[n] for n in table.columns}
    assert serious(judged(replaced(table, **coarse))) == []
    rounded = {
        n: np.array([float(f"{v:.5g}") for v in table[n]]) for n in table.columns
    }
    assert serious(judged(replaced(table, **rounded))) == []


def test_friction_rests_and_rig_tests_pass():
    """Commands without noise, and what friction does: square-wave force, corners, long rests, free decay."""
    rng = np.random.default_rng(1)
    time = STEP * np.arange(6250)
    lift = 1 - np.cos(2 * np.pi * (time - 3) / 0.2)
    for command in (
        0.01 * np.sin(2 * np.pi * np.repeat([2.0, 4, 6, 8, 10], 1250) * time),
        0.01 * signal.sawtooth(2 * np.pi * 0.3 * time, 0.5),
        np.where((time > 3) & (time < 3.2), 0.025 * lift, 0),
        np.zeros_like(time),
    ):
        speed = np.gradient(command, STEP)
        force = 700 * np.sign(np.round(speed, 9)) + 2e4 * command + 1000 * speed
        force += 15 * ar1(rng, len(time), 0.5) + 500 * np.exp(-time) * np.cos(12 * time)
        table = Table(time, {"x": command, "force": force})
        found = check(table, inputs={"x": "displacement"}, outputs={"force": "force"})
        idle = (
            "warning: no input changes (x): the outputs are compared with free motion"
        )
        assert serious(found) == ([] if command.any() else [idle])
    decay = Table(time, {"x": 0.02 * np.exp(-time) * np.cos(12 * time)})
    assert check(decay, inputs={}, outputs={"x": "displacement"}) == []


def put(x, at, value):
    """The samples with others at some places."""
    out = np.array(x)
    out[at] = value
    return out


def places(x):
    return np.random.default_rng(5).choice(
        np.arange(100, len(x) - 100, 60), 8, replace=False
    )


def clipped(x):
    middle, top = np.median(x), np.quantile(np.abs(x - np.median(x)), 0.95)
    return np.clip(x, middle - top, middle + top)


def noise_alone(x):
    return 1e-3 * np.std(x) * np.random.default_rng(6).standard_normal(len(x))


#: what is done to a channel; level and words of the finding
SPOILT = {
    "clipped": (clipped, "error", "is clipped"),
    "clipped above": (lambda x: np.minimum(x, np.quantile(x, 0.99)), "warning", "is clipped: .* largest"),
    "frozen": (lambda x: put(x, slice(len(x) // 3, len(x) // 3 + 300), x[len(x) // 3]), "error", "does not change for 300 samples"),
    "dead from two thirds on": (lambda x: put(x, slice(2 * len(x) // 3, None), x[2 * len(x) // 3]), "error", "does not change for"),
    "dropouts": (lambda x: put(x, np.add.outer(places(x), np.arange(15)), np.median(x) - 2 * np.std(x)), "error", "does not change for 120 samples"),
    "spikes": (lambda x: put(x, places(x), x[places(x)] + np.where(places(x) % 2, 6, -6) * np.std(x)), "warning", "8 samples are spikes"),
    "not finite": (lambda x: put(x, places(x), np.nan), "error", "8 samples are not finite"),
    "infinite": (lambda x: put(x, places(x)[0], np.inf), "error", "1 samples are not finite"),
    "constant": (lambda x: np.full(len(x), x[0]), "error", "is constant"),
    "held": (lambda x: x[::5].repeat(5)[: len(x)], "warning", "holds each value for 5 samples"),
    "only noise": (noise_alone, "warning", "nothing but noise"),
    "in thousandths": (lambda x: 1e3 * x, "error", "cannot be: a wrong unit"),
}  # fmt: skip


@pytest.mark.parametrize(("channel", "seed"), [*zip(OUTPUTS, (0, 1, 0), strict=True)])
@pytest.mark.parametrize("how", SPOILT)
def test_a_spoilt_channel_is_found_and_named(channel, how, seed):
    if (channel, how) == ("tyre", "in thousandths"):
        pytest.skip("400 kN are heavy, not impossible")
    table = car(seed, snr_db=[26.0, 36.0][seed])
    change, level, message = SPOILT[how]
    seen = judged(replaced(table, **{channel: change(table[channel])}))
    found = [f for f in seen if f.level != "note"]
    assert {f.channel for f in found} == {channel}
    assert found[0].level == level and re.search(message, found[0].message)
    spans = np.array(found[0].where).reshape(-1, 2)
    assert np.all((spans >= table.time[0]) & (spans <= table.time[-1] + STEP))


def stroke(zero):
    """The speed of one stroke (2000,): at rest for 500 samples before and after it; `zero`: how rest is written."""
    out = np.full(2000, zero)
    phase = np.arange(1000) / 1000
    noise = 2e-3 * np.random.default_rng(0).standard_normal(1000)
    out[500:1500] = np.round(np.abs(np.sin(np.pi * phase) ** 2 + noise), 4)
    return out


@pytest.mark.parametrize("zero", [0.0, -0.0])
@pytest.mark.parametrize("alone", [True, False])
def test_a_speed_at_rest_is_not_clipped(zero, alone):
    time, speed = STEP * np.arange(2000), stroke(zero)
    noise = 0.1 * np.random.default_rng(1).standard_normal(2000)
    outputs = {} if alone else {"force": "force"}
    columns = {"speed": speed, "force": 100 * np.gradient(speed + 0.0) + noise}
    table = Table(time, {n: columns[n] for n in ("speed", *outputs)})
    assert serious(check(table, inputs={"speed": "velocity"}, outputs=outputs)) == []
    assert held_samples("speed", speed, time) == []


def test_a_coarse_encoder_is_not_clipped_where_the_motion_turns():
    """Counts of 3 mrad, as means of ten samples: some twenty are equal at the turn, and fewer at the levels beside it."""
    t = 1e-3 * np.arange(4000)
    swing = 0.1 * np.exp(-0.1 * t) * np.cos(1.8 * t - 2.7)
    seen = (0.003 * np.floor(swing / 0.003 + 0.5)).reshape(-1, 10).mean(axis=1)
    table = Table(t[::10], {"angle": seen})
    assert serious(check(table, inputs={}, outputs={"angle": "angle"})) == []


def test_a_speed_of_one_direction_alone_is_told():
    """Half of the motion is not measured while the travel goes on: a warning, without a negative zero in it."""
    table = car(snr_db=40)
    speed = np.gradient(table["travel"], STEP)
    one = np.where(speed > 0, speed, -0.0)
    kinds = {"travel": "displacement", "speed": "velocity"}
    seen = Table(table.time, {"travel": table["travel"], "speed": one})
    (text,) = serious(check(seen, inputs={}, outputs=kinds))
    assert text.startswith("warning: speed: ")
    assert "exactly 0, its smallest value" in text and "-0" not in text


def test_a_channel_that_rests_with_all_others_is_not_frozen():
    """Noise that dies with the motion: everything stands in the second half of the record."""
    table = car(snr_db=30)
    stopped = {n: np.r_[x[:3000], np.full(3000, x[3000])] for n, x in table.columns.items()}  # fmt: skip
    found = judged(replaced(table, **stopped))
    assert not [f for f in found if f.check == "held" and f.level != "note"]


@pytest.mark.parametrize(
    ("share", "level"), [(1 / 6000, None), (0.01, "warning"), (0.2, "error")]
)
def test_clipping_counts_by_the_power_that_it_holds(share, level):
    table = car(snr_db=40)
    for channel in OUTPUTS:
        x = table[channel] - np.mean(table[channel])
        top = np.sort(x)[-max(1, round(share * len(x)))]
        found = judged(replaced(table, **{channel: np.minimum(x, top)}))
        levels = [f.level for f in found if f.level != "note"]
        assert levels == ([level] if level else [])


@pytest.mark.parametrize("share", [0.4, 0.8, 0.95, 0.99])
def test_heavier_clipping_at_both_ends_is_an_error_too(share):
    """Beyond nine tenths, no noise is left between the rails: the channel looks like a simulation."""
    table = car(snr_db=40)
    for channel in OUTPUTS:
        x = table[channel] - np.mean(table[channel])
        rail = np.quantile(np.abs(x), 1.0 - share)
        found = judged(replaced(table, **{channel: np.clip(x, -rail, rail)}))
        assert "error" in {f.level for f in found if f.check == "held"}


def jittered(time, share):
    return time + share * STEP * np.random.default_rng(0).uniform(-1, 1, len(time))


TIMES = {
    "repeats": (
        lambda t: put(t, 500, t[499]),
        r"repeats after t = 0.998 s \(1 times\)",
    ),
    "backwards": (lambda t: np.r_[t[:900], t[:-900]], "runs backwards"),
    "gap": (
        lambda t: np.r_[t[:700], t[700:] + 0.5],
        "1 gaps in time, the first of 0.502 s after t = 1.398 s",
    ),
    "missing": (lambda t: STEP * (np.arange(len(t)) * 1001 // 1000), "gaps in time"),
    "not finite": (lambda t: put(t, 5, np.nan), "not finite"),
    "jitter": (lambda t: np.sort(jittered(t, 0.4)), "not uniform"),
    "drift": (lambda t: t * (1 + 0.05 * t / t[-1]), "not uniform"),
    "milliseconds": (lambda t: 1e3 * t, "another unit"),
    "microseconds": (lambda t: 1e6 * t, "another unit"),
}


@pytest.mark.parametrize("how", TIMES)
def test_a_bad_time_base_is_an_error(how):
    table = car()
    change, message = TIMES[how]
    found = judged(Table(change(table.time), table.columns))
    assert found[0].level == "error" and found[0].channel == "time"
    assert re.search(message, found[0].message)


def test_records_without_content_are_refused():
    table = car()
    short = Table(table.time[:60], {n: x[:60] for n, x in table.columns.items()})
    assert "too short: 60 samples" in judged(short)[0].message
    found = judged(replaced(table, **{n: noise_alone(table[n]) for n in OUTPUTS}))
    assert {f.channel for f in found if f.level == "error"} == set(OUTPUTS)
    flat = dict.fromkeys(INPUTS, np.ones(len(table)))
    found = judged(replaced(table, **flat))
    assert {f.channel for f in found if f.level == "note"} >= set(INPUTS)
    assert "warning: no input changes (road, current)" in serious(found)[0]
    # a motor that is not used
    assert serious(judged(replaced(table, current=flat["current"]))) == []


def test_units_and_swaps_that_cannot_be_are_told():
    table = car()
    shock, travel, tyre = (table[n] for n in OUTPUTS)
    for columns, channel, words in (
        ({"acceleration": tyre, "tyre": shock}, "acceleration", "columns swapped"),
        ({"acceleration": travel, "travel": 50 * shock}, "travel", ""),
        ({"acceleration": shock + 9.81}, "acceleration", "gravity"),
        ({"travel": travel * 1e-6}, "travel", "wrong unit"),
    ):
        worst = judged(replaced(table, **columns))[0]
        assert worst.channel == channel and words in worst.message
    columns = table.columns | {"travel": 1e3 * travel}
    assert judged(Table(table.time, columns, units={"travel": "mm"})) == []
    words = "unknown quantity 'weight'"
    refused(words, check, table, inputs={}, outputs={"tyre": "weight"})
    words = "no column 'tire'; did you mean 'tyre'"
    refused(words, check, table, inputs={}, outputs={"tire": "force"})


def test_lost_and_repeated_samples_are_seen_though_time_runs_on():
    table = car(snr_db=40)
    n = len(table)

    def rows(*index):
        taken = np.sort(index[0]) if len(index) == 1 else np.r_[index]
        columns = {k: x[taken] for k, x in table.columns.items()}
        return judged(Table(STEP * np.arange(len(taken)), columns))

    lost = rows(slice(2000), slice(2300, n))[0]
    assert lost.level == "error" and "samples lost" in lost.message
    assert lost.where[0][0] == pytest.approx(1999 * STEP)
    twice = " ".join(map(str, rows(slice(2000), slice(1500, n))))
    assert "500 samples, first at t = 4 s, repeat those 1 s earlier" in twice
    doubled = rows(np.r_[:n, 500:5500:50])
    errors = [f.message for f in doubled if f.level == "error"]
    assert any("100 samples, first at" in message for message in errors)
    same = judged(replaced(table, tyre=table["acceleration"]))
    told = [(f.level, f.channel, f.message) for f in same]
    assert ("error", "tyre", "is the same column as 'acceleration'") in told
