"""A small fixed share of `benchmarks/kills.py`, and that it would notice."""

import json
import os
import random
import sys
from pathlib import Path

import pytest

threads = {k: os.environ.get(k) for k in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")}
import kills  # noqa: E402

for key, value in threads.items():
    os.environ.pop(key) if value is None else os.environ.update({key: value})

pytestmark = [
    pytest.mark.tools,
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="fork, limits of a process"),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),  # of forking
]


def tried(way, case, tmp_path, tries=1):
    tally = kills.Tally()
    way(tmp_path, "it", case, tally, random.Random(0), tries)
    return tally


def test_a_sweep_may_be_killed_whenever_it_changes_the_disk(tmp_path):
    tally = tried(kills.moments, kills.CASES["sweep"], tmp_path)
    assert not tally.wrong, tally.wrong
    seen = tally.seen
    assert seen["it: at a moment: nothing"] > 10 and seen["it: from a moment: again, and right"] == 1


@pytest.mark.slow
def test_what_two_write_at_once_is_whole(tmp_path):
    tally = tried(kills.both, kills.CASES["sweep"], tmp_path)
    assert not tally.wrong and tally.seen["it: two at once: both"] == 1, tally.wrong


def half(folder):
    path = folder / "out.json"
    return json.loads(path.read_text()) if path.exists() else None


def careless():
    with open("out.json", "w") as stream:
        stream.write('{"a": ')
        stream.flush()
        Path("note").write_text("a change of the disk meanwhile")
        stream.write("1}")


def test_what_goes_wrong_is_noticed(tmp_path):
    tally = tried(kills.moments, kills.Case(kills.nothing, careless, half), tmp_path)
    assert any("half-written" in line for line in tally.wrong)
