"""Ordinary files of loggers and spreadsheets are read right, or refused in one line."""

import re

import numpy as np
import pytest
from builders import channel, damper, network, spring
from program import read_json, refused, run
from scipy.io import savemat

from isd_gym import Table, diagnose, read_table, simulate
from isd_gym._commands.simulate import command
from isd_gym._common.units import convert
from isd_gym.records.data._table import read_rasters
from isd_gym.records.inspection import inspect
from isd_gym.records.inspection.map_file import save_map
from isd_gym.records.loggers import ChannelMap, Recording
from isd_gym.records.loggers.record_reading import records_of
from isd_gym.records.schemas import check as of_schema

PARTS = [spring("mass", "table", 9e3), damper("mass", "table", 45.0)]
MOVED = channel("table", "displacement", "table", unit="mm")
SEEN = channel("acc", "acceleration", "mass", unit="g")
RIG = network("shaker", PARTS, [MOVED], [SEEN], masses={"mass": 12.0})
WANTED = (*RIG.inputs, *RIG.outputs)
HEAD = "time [s],table [mm],acc [g]"
UNITS_OF = {"table": "mm", "acc": "g"}
N = 1200
TIME = 0.002 * np.arange(N)
DATA = np.c_[TIME, 900.0 + 800.0 * np.sin(9 * TIME), -0.3 * np.sin(9 * TIME)]


def text(data=DATA, separator=",", form="{:.9g}".format):
    return "\n".join(separator.join(form(x) for x in row) for row in data) + "\n"


def values(record):
    """Return the channels of a record in the units of the model."""
    if isinstance(record, Table):
        return {
            c.name: convert(record[c.name], record.units.get(c.name) or c.unit, c.unit)
            for c in WANTED
        }
    return {
        c.name: convert(record.signals[c.name].values, c.si, c.unit) for c in WANTED
    }


def check(record, data=DATA, atol=2e-3):
    found = values(record)
    np.testing.assert_allclose(found["table"], data[:, 1], atol=atol)
    np.testing.assert_allclose(found["acc"], data[:, 2], atol=atol)
    time = record.time if isinstance(record, Table) else record.signals["acc"].time
    np.testing.assert_allclose(time - time[0], data[:, 0] - data[0, 0], atol=1e-6)


def read(path, content, **options):
    path.write_text(content, encoding="utf-8")
    return records_of(path, RIG, WANTED, **options)


@pytest.mark.parametrize(
    ("head", "separator"),
    [
        (f"# {HEAD}\n", ","),
        (f"% rig 7\n# {HEAD}\n", ","),
        ("# time, table, acc\n# s, mm, g\n", ","),
        ("# time table acc\n", " "),
        ("#time\ttable\tacc\n", "\t"),
    ],
)
def test_a_header_in_a_comment_line_names_the_columns(head, separator, tmp_path):
    (record,) = read(tmp_path / "a.txt", head + text(separator=separator))
    check(record)


def test_columns_that_are_empty_throughout_do_not_count(tmp_path):
    """A spreadsheet fills the lines of a logger's file up to its longest line, here the remark of another output."""
    head = f"% Logger,,,,\n% Output A (off) - Sine, 10 MHz, 1 Vpp, offset 0 V, phase 0 deg\n% {HEAD},,\n"
    lines = text().splitlines()
    (record,) = read(
        tmp_path / "a.csv", head + "".join(f"{line},,\n" for line in lines)
    )
    check(record)
    (record,) = read(
        tmp_path / "b.csv", "".join(f"{line},\n" for line in (HEAD, *lines))
    )
    check(record)


def test_what_could_be_misread_is_refused_with_the_remedy(tmp_path):
    content = HEAD + "\n" + text().replace(",", ";").replace(".", ",").replace(";", ",")
    refused("export with semicolons or tabs", read, tmp_path / "a.csv", content)
    # a comment that is no header
    refused(
        "--columns NAME,NAME",
        read,
        tmp_path / "a.csv",
        "# measured by J., 3 May\n" + text(),
    )
    refused("--columns NAME,NAME", read, tmp_path / "a.csv", "# 1, 2, 3\n" + text())


def test_a_file_without_time_is_read_at_a_rate(tmp_path):
    path = tmp_path / "a.csv"
    refused("--rate HZ", read, path, HEAD.partition(",")[2] + "\n" + text(DATA[:, 1:]))
    (record,) = records_of(path, RIG, WANTED, rate=500.0)
    check(record)
    found = inspect([path], RIG, rate=500.0)
    save_map(found.map("rig.json"), tmp_path / "map.json")  # the map remembers the rate
    (record,) = records_of(path, RIG, WANTED, by=ChannelMap.load(tmp_path / "map.json"))
    check(record)
    of_schema(read_json(tmp_path / "map.json"), "isd-map/1", "the map")
    for rate in (0.0, float("nan"), float("inf"), -3.0):
        refused("--rate must be", records_of, path, RIG, WANTED, rate=rate)


@pytest.mark.parametrize(
    ("name", "scale", "units"),
    [
        ("time [us]", 1e6, {}),
        ("Time_us", 1e6, {}),
        ("Time (µs)", 1e6, {}),
        ("t_ns", 1e9, {}),
        ("Time_ms", 1e3, {}),
        ("time", 1e6, {"time": "us"}),
        ("Zeitmarke", 1e6, {"Zeitmarke": "us"}),
        ("Time_ms", 1e6, {"Time_ms": "us"}),
    ],
)
def test_stamps_have_the_unit_of_their_name_or_of_the_user(
    name, scale, units, tmp_path
):
    data = DATA.copy()
    data[:, 0] *= scale
    content = f"{name},table [mm],acc [g]\n" + text(data, form="{:.12g}".format)
    (record,) = read(tmp_path / "a.csv", content, units=units)
    check(record)
    (group,) = inspect([tmp_path / "a.csv"], units=units).files  # the same reading
    assert group[0].step == pytest.approx(0.002)


@pytest.mark.parametrize("stamp", ["t", "zeit", "Time_s"])
def test_single_numbers_and_texts_of_a_mat_file_are_no_time(stamp, tmp_path):
    own = {stamp: DATA[:, 0], "table": DATA[:, 1], "acc": DATA[:, 2]}
    more = {
        "T": 5.0,
        "seconds": 60.0,
        "date": "2026-11-25",
        "fs": 500.0,
        "timestamp": 1.7e9,
    }
    if stamp != "t":
        more["t"] = 0.0
    more["time"] = 2.4
    path = tmp_path / "a.mat"
    savemat(path, {**more, **own})
    (record,) = records_of(path, RIG, WANTED)
    check(record)
    assert inspect([path]).files[0][0].stamp == stamp


def grouped(x, thousands, mark, digits=3):
    return f"{x:,.{digits}f}".translate(str.maketrans({",": thousands, ".": mark}))


@pytest.mark.parametrize(
    ("thousands", "mark"),
    [
        (".", ","),
        (",", "."),
        ("'", "."),
        ("’", "."),
        (" ", ","),
        ("\u00a0", ","),
        ("", ","),
    ],
)
def test_thousands_separators_are_read(thousands, mark, tmp_path):
    content = (
        HEAD.replace(",", ";")
        + "\n"
        + text(DATA, ";", lambda x: grouped(x, thousands, mark))
    )
    (record,) = read(tmp_path / "a.csv", content)
    check(record)


@pytest.mark.parametrize(
    ("thousands", "mark"), [(".", ","), (",", "."), (".", "."), (",", ",")]
)
def test_whole_numbers_with_thousands_separators_are_never_fractions(
    thousands, mark, tmp_path
):
    """1.050 between 999 and 1.051 is refused, or read as more than a thousand."""
    rows = (f"{t:.4f};{grouped(x, thousands, mark, 0)};{a:.4f}" for t, x, a in DATA)
    if mark == ",":
        rows = (re.sub(r"(;|^)(-?\d)\.(\d{4})(?=;|$)", r"\1\2,\3", row) for row in rows)
    refused(
        r"may be a fraction or thousands|is not a number",
        read,
        tmp_path / "a.csv",
        HEAD.replace(",", ";") + "\n" + "\n".join(rows),
    )


def test_three_decimals_are_fractions(tmp_path):
    """Numbers from 1 to 999 with three decimals, among them round hundreds, in both notations."""
    data = np.c_[TIME, np.linspace(1.0, 999.0, N).round(3), DATA[:, 2]]
    data[5::100, 1] = 250.0
    plain = HEAD.replace(",", ";") + "\n" + text(data, ";", "{:.3f}".format)
    for content in (plain, plain.replace(".", ",")):
        (record,) = read(tmp_path / "a.csv", content)
        check(record, data)


def beside(first, second, heads):
    def cells(data, i):
        return [f"{x:.9g}" for x in data[i]] if i < len(data) else [""] * data.shape[1]

    count = max(len(first), len(second))
    rows = [",".join([*cells(first, i), *cells(second, i)]) for i in range(count)]
    return heads + "\n" + "\n".join(rows) + "\n"


@pytest.mark.parametrize(
    "heads",
    [f"{HEAD},{HEAD}", "time1 [s],table1 [mm],acc1 [g],time2 [s],table2 [mm],acc2 [g]"],
)
def test_runs_side_by_side_are_two_records(heads, tmp_path):
    first, second = DATA[:700], DATA[500:1100] - [DATA[500, 0], 0, 0]
    one, two = read(tmp_path / "a.csv", beside(first, second, heads))
    check(one, first)
    check(two, second)
    refused("2 tables side by side", read_table, tmp_path / "a.csv")
    RIG.save(tmp_path / "rig.json")
    refused(
        "holds 2 runs side by side",
        command,
        str(tmp_path / "rig.json"),
        [tmp_path / "a.csv"],
        tmp_path / "out.csv",
    )


def test_channels_beside_one_another_keep_their_own_stamps(tmp_path):
    heads = "t [s],table [mm],t2 [s],acc [g]"
    (record,) = read(tmp_path / "a.csv", beside(DATA[:, :2], DATA[::2, [0, 2]], heads))
    assert isinstance(record, Recording)
    np.testing.assert_allclose(record.signals["acc"].time, DATA[::2, 0], atol=1e-9)
    np.testing.assert_allclose(record.signals["table"].time, DATA[:, 0], atol=1e-9)


@pytest.mark.parametrize(
    "heads", ["T1,table,T2,acc", "time,T1,T2,table,acc", "time,table,acc,t0"]
)
def test_temperatures_and_constants_are_no_time(heads, tmp_path):
    known = {
        "time": TIME,
        "table": DATA[:, 1],
        "acc": DATA[:, 2],
        "T1": np.sin(TIME),
        "T2": np.cos(TIME),
    }
    data = np.stack([known.get(head, 0 * TIME) for head in heads.split(",")], axis=1)
    (tmp_path / "a.csv").write_text(heads + "\n" + text(data))
    assert len(read_rasters(tmp_path / "a.csv")) == 1


@pytest.mark.parametrize("gap", ["nan", ""])
def test_a_stretch_without_numbers_splits_a_record(gap, tmp_path):
    lines = text().splitlines()
    lines[500:520] = [line.rpartition(",")[0] + "," + gap for line in lines[500:520]]
    one, two = read(tmp_path / "a.csv", HEAD + "\n" + "\n".join(lines))
    check(one, DATA[:500])
    check(two, DATA[520:])
    assert "20 samples without a number (acc) left out, first 1 s" in one.notes[0]
    refused(
        "column 'acc' holds no number",
        read,
        tmp_path / "a.csv",
        HEAD + "\n" + "\n".join(x.rpartition(",")[0] + "," + gap for x in lines),
    )


def test_a_sign_turns_a_channel(tmp_path):
    content = "time [s],table [mm],sensor [g]\n" + text(DATA * [1, 1, -1])
    for signs in ({"acc": -1}, {"sensor": -1}):
        (record,) = read(
            tmp_path / "a.csv", content, rename={"sensor": "acc"}, signs=signs
        )
        check(record)
    (tmp_path / "b.csv").write_text(HEAD + "\n" + text(DATA * [1, 1, -1]))
    (record,) = records_of(
        tmp_path / "b.csv", RIG, WANTED, signs={"acc": -1}, rate=500.0
    )  # the other road
    found = values(record)
    np.testing.assert_allclose(found["acc"], DATA[:, 2], atol=2e-3)


def test_a_copy_of_a_training_record_validates_nothing():
    acc = simulate(RIG, TIME, {"table": DATA[:, 1] - 900.0})["acc"]
    acc = acc + 1e-3 * np.random.default_rng(1).standard_normal(N)
    one, other = (
        Table(TIME, {"table": DATA[:, 1] - 900.0, "acc": acc}, n, UNITS_OF)
        for n in ("one", "two")
    )
    refused(
        "two has the samples of one: give each record once",
        diagnose,
        [one],
        RIG,
        validate=[other],
    )
    refused("two has the samples of one", diagnose, [one, other], RIG)


def test_inspect_takes_columns_signs_and_maps(tmp_path):
    """A named column is taken whatever the other columns look like; a sign against the physics is remarked."""
    RIG.save(tmp_path / "rig.json")
    turned = -simulate(RIG, TIME, {"table": DATA[:, 1] - 900.0})["acc"]
    (tmp_path / "a.csv").write_text(
        "time [s],table [mm],acc [g],left [g]\n" + text(np.c_[DATA, turned])
    )

    def go(*words):
        done = run(
            "inspect", tmp_path / "a.csv", "--model", tmp_path / "rig.json", *words
        )
        return done.returncode, done.stdout + done.stderr

    made = ["--out", tmp_path / "map.json"]
    assert go("--rename", "left=acc", *made)[0] == 0
    found = ChannelMap.load(tmp_path / "map.json").channels["acc"]
    assert (found.column, found.sign) == ("left", -1)
    code, said = go("--rename", "left=acc", "--sign", "acc=1", *made)
    assert (
        code == 0
        and "acc follows the model turned round (0.99): --sign acc=-1?"
        in " ".join(said.split())
    )
    assert ChannelMap.load(tmp_path / "map.json").channels["acc"].sign == 1
    code, said = go("--map", tmp_path / "map.json")
    assert code == 0 and "--sign acc=-1?" in " ".join(said.split())
    for words, says in (
        (["--rename", "lefd=acc"], "did you mean 'left'?"),
        (["--rename", "left=table"], "unit 'g' is none of m"),
        (["--sign", "acc=2"], "wants -1 or 1"),
        (["--sign", "ac=-1"], "no channel 'ac'"),
        (["--map", tmp_path / "map.json", "--sign", "acc=-1"], "--map replaces"),
    ):
        code, said = go(*words)
        assert code == 2 and says in said and len(said.strip().splitlines()) == 1
