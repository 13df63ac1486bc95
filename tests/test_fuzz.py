"""A small fixed share of `benchmarks/fuzz.py`, and that it would notice."""

import fuzz
import pytest

pytestmark = pytest.mark.tools

LARGE = {"models": 300, "csv": 300, "zips": 200}
SLOW = {"parquet": 40, "mat": 60, "mf4": 15, "records": 40, "inspections": 60}
SHARE = dict.fromkeys(fuzz.KINDS, 150) | LARGE | SLOW


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
    wrong = {"models": (outside, "wrote outside"), "csv": (broken, "KeyError"), "zips": (endless, "hang")}
    for kind, (how, says) in wrong.items():
        monkeypatch.setitem(fuzz.KINDS, kind, how)
        assert says in fuzz.block(kind, 0, 0, 1)["failures"][0]
