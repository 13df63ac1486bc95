"""A small fixed share of `benchmarks/fuzz.py`, and that it would notice."""

import fuzz
import pytest

pytestmark = pytest.mark.tools

SHARE = {
    "models": 300,
    "csv": 300,
    "parquet": 40,
    "mat": 60,
    "mf4": 15,
    "policies": 150,
    "zips": 200,
    "actions": 150,
    "networks": 150,
    "writes": 150,
    "grids": 150,
    "records": 40,
    "roads": 150,
    "inspections": 60,
    "maps": 150,
}


@pytest.mark.parametrize("kind", fuzz.KINDS)
def test_a_share_of_the_tries(kind):
    pytest.importorskip({"parquet": "pyarrow", "mf4": "asammdf"}.get(kind, "numpy"))
    found = fuzz.block(kind, 1, 0, SHARE[kind])
    assert not found["failures"], found["failures"]
    assert found["counts"]["result"] > 0 and (found["counts"]["refused"] > 0 or kind == "records")


def test_what_goes_wrong_is_noticed(monkeypatch):
    def outside(rng, folder):
        (folder.parent / "elsewhere").write_text("")

    def broken(rng, folder):
        raise KeyError("x")

    def endless(rng, folder):
        while True:
            pass

    monkeypatch.setattr(fuzz, "SECONDS", 0.1)
    for kind, how, says in (
        ("models", outside, "wrote outside"),
        ("csv", broken, "KeyError"),
        ("zips", endless, "hang"),
    ):
        monkeypatch.setitem(fuzz.KINDS, kind, how)
        assert says in fuzz.block(kind, 0, 0, 1)["failures"][0]


def test_it_goes_on_where_it_stopped(tmp_path):
    import json

    for tries in (10, 20):
        fuzz.run(tmp_path, tries, 3, ["models"], 5.0)
        state = json.loads((tmp_path / "fuzz.json").read_text())["kinds"]["models"]
        assert state["done"] == state["result"] + state["refused"] == tries
