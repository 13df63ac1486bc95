"""Files of other programs: Excel, MATLAB 7.3 and TDMS; good, broken and hostile."""

import sys
import zipfile

import builders
import numpy as np
import pytest
from program import refused

from isd_gym import InputError, Network, Table, read_table
from isd_gym.records.data._table import read_rasters
from isd_gym.records.loggers.record_reading import records_of

openpyxl = pytest.importorskip("openpyxl")
h5py = pytest.importorskip("h5py")
nptdms = pytest.importorskip("nptdms")

TIME = np.arange(200) * 0.01
FORCE = 3.0 * np.sin(7.0 * TIME)


def excel(path, rows, before=()):
    book = openpyxl.Workbook()
    for title in before:
        book.create_sheet(title, 0).append(["notes", "of the day"])
    for row in rows:
        book.worksheets[-1].append(row)
    book.save(path)


def unread(path, *words):
    with pytest.raises(InputError) as told:
        read_table(path)
    assert str(path) in str(told.value)
    assert all(w in str(told.value) for w in words), told.value


def tdms(path, groups):
    with nptdms.TdmsWriter(path) as writer:
        for group, name, values, properties in groups:
            writer.write_segment(
                [nptdms.ChannelObject(group, name, values, properties)]
            )


def test_a_workbook_is_read_like_a_text_table(tmp_path):
    rows = [
        ["Test 7, bench 3"],
        [],
        ["time [ms]", "force (kN)"],
        *zip(1000 * TIME, FORCE, strict=True),
    ]
    excel(tmp_path / "a.xlsx", [list(r) for r in rows], before=["notes"])
    read = read_table(tmp_path / "a.xlsx", expected={"force": "N"})
    assert np.allclose(read.time, TIME) and np.allclose(read["force"], 1000 * FORCE)
    (raster,) = read_rasters(tmp_path / "a.xlsx")
    assert set(raster.values) == {"time", "force"}


def test_a_bad_workbook_is_one_line(tmp_path, monkeypatch):
    excel(tmp_path / "a.xlsx", [["only", "text"], ["no", "numbers"]])
    unread(tmp_path / "a.xlsx", "no sheet with rows of numbers")
    (tmp_path / "b.xlsx").write_bytes(b"PK no archive")
    unread(tmp_path / "b.xlsx", "not an Excel workbook")
    excel(tmp_path / "c.xlsx", [["time", "force"], [0, 1], [1, 2]])
    whole = (tmp_path / "c.xlsx").read_bytes()
    (tmp_path / "c.xlsx").write_bytes(whole[: len(whole) // 2])
    unread(tmp_path / "c.xlsx", "not an Excel workbook")
    with zipfile.ZipFile(tmp_path / "d.xlsx", "w", zipfile.ZIP_DEFLATED) as bomb:
        bomb.writestr("xl/worksheets/sheet1.xml", bytes(60_000_000))
    monkeypatch.setenv("ISD_GYM_READ_LIMIT_GB", "0.02")
    unread(tmp_path / "d.xlsx", "the limit is 0.02")


def matlab(path, fill):
    with h5py.File(path, "w", userblock_size=512) as file:
        fill(file)
    with open(path, "r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")


def variable(group, name, values, kind="double"):
    group.create_dataset(name, data=values).attrs["MATLAB_class"] = np.bytes_(kind)


def text(group, name, words):
    variable(group, name, np.array([[ord(c)] for c in words], np.uint16), "char")


def test_a_matlab_7_3_file_has_its_vectors_and_units(tmp_path):
    def fill(file):
        log = file.create_group("log")
        variable(log, "time", TIME[None])
        variable(log, "force", FORCE[:, None])
        variable(log, "rate", np.array([[100.0]]))
        text(log.create_group("units"), "force", "kN")
        text(file, "note", "bench")
        file.create_group("#refs#")

    matlab(tmp_path / "a.mat", fill)
    read = read_table(tmp_path / "a.mat", expected={"force": "N"})
    assert np.array_equal(read.time, TIME) and np.allclose(read["force"], 1000 * FORCE)
    assert list(read_table(tmp_path / "a.mat").columns) == ["force"]


def test_a_matlab_7_3_file_leads_to_no_other_file(tmp_path):
    (tmp_path / "secret").write_bytes(FORCE.tobytes())

    def outside(file):
        variable(file, "time", TIME[None])
        file.create_dataset(
            "x",
            shape=(200,),
            dtype=float,
            external=[(str(tmp_path / "secret"), 0, 1600)],
        )

    def linked(file):
        variable(file, "time", TIME[None])
        file["x"] = h5py.ExternalLink(str(tmp_path / "a.mat"), "/time")

    def large(file):
        file.create_dataset(
            "x", shape=(10**9,), dtype=float, compression="gzip", chunks=(10**5,)
        )

    matlab(tmp_path / "a.mat", outside)
    unread(tmp_path / "a.mat", "lies in another file")
    matlab(tmp_path / "b.mat", linked)
    refused("no column 'x'", read_table, tmp_path / "b.mat", expected={"x": "m"})
    matlab(tmp_path / "c.mat", large)
    unread(tmp_path / "c.mat", "the limit is 1")
    (tmp_path / "d.mat").write_bytes(
        b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + bytes(400)
    )
    unread(tmp_path / "d.mat", "cannot be read")


WAVE = {"wf_increment": 0.01, "wf_start_offset": 0.0}


def test_channels_of_a_tdms_file_have_their_stamps_and_units(tmp_path):
    late = WAVE | {"wf_start_time": np.datetime64("2026-01-01T00:00:00.5")}
    early = WAVE | {
        "wf_start_time": np.datetime64("2026-01-01T00:00:00.0"),
        "unit_string": "kN",
    }
    tdms(
        tmp_path / "a.tdms", [("a", "force", FORCE, early), ("b", "travel", TIME, late)]
    )
    first, second = read_rasters(tmp_path / "a.tdms")
    assert first.units["force"] == "kN" and np.allclose(first.values["time"], TIME)
    assert np.allclose(second.values["time"], TIME + 0.5)
    assert np.allclose(
        read_table(tmp_path / "a.tdms", expected={"force": "N"})["force"], 1000 * FORCE
    )
    unread(tmp_path / "a.tdms", "different rasters")
    refused(
        "no channel 'frce'; did you mean 'force'",
        read_table,
        tmp_path / "a.tdms",
        expected={"frce": "N"},
    )


def test_a_tdms_file_without_waveforms_is_a_table(tmp_path):
    tdms(
        tmp_path / "a.tdms",
        [("log", "time", TIME, {}), ("log", "force", FORCE, {"unit_string": "kN"})],
    )
    assert np.allclose(
        read_table(tmp_path / "a.tdms", expected={"force": "N"})["force"], 1000 * FORCE
    )
    network = Network.load(
        builders.cart(
            builders.spring("cart", "ground", 1.0), inputs=["force force cart"]
        )
    )
    (record,) = records_of(tmp_path / "a.tdms", network, network.inputs)
    assert isinstance(record, Table) and np.allclose(record["force"], 1000 * FORCE)


def test_a_bad_tdms_file_is_one_line(tmp_path):
    (tmp_path / "a.tdms").write_bytes(b"no")
    unread(tmp_path / "a.tdms", "not a TDMS file")
    tdms(tmp_path / "b.tdms", [("log", "force", FORCE, WAVE)])
    (tmp_path / "b.tdms").write_bytes((tmp_path / "b.tdms").read_bytes()[:60])
    unread(tmp_path / "b.tdms")
    tdms(tmp_path / "c.tdms", [("log", "note", ["a", "b"], {})])
    unread(tmp_path / "c.tdms", "no numeric channel")


@pytest.mark.parametrize(
    ("suffix", "module", "extra"),
    [
        (".xlsx", "openpyxl", "files"), (".tdms", "nptdms", "files"),
        (".parquet", "pyarrow", "io"), (".mf4", "asammdf", "io"),
    ],
)  # fmt: skip
def test_the_extra_of_a_missing_library_is_named(
    tmp_path, monkeypatch, suffix, module, extra
):
    (tmp_path / f"a{suffix}").write_bytes(b"TDSm")
    for name in [m for m in sys.modules if m.split(".")[0] == module]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, module, None)
    refused(rf'pip install "\.\[{extra}\]"', read_table, tmp_path / f"a{suffix}")
