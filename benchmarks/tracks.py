"""Make the benchmark cards again, and the pages that show them.

python benchmarks/tracks.py [--only ISDHalfCar-v0 robust ...] [--jobs 1]

One score per track (`isd-gym score`), one card per environment (`isd-gym card --write`, into isd_gym/benchmark/references), one sweep for
the robust track (benchmarks/robust-track.json); then the tables of the pages. The file benchmarks/tracks.json keeps the
processor time of each track. The last lines are the reward thresholds for `isd_gym.env.registration`.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from json_files import read_json, save_json

from isd_gym.benchmark import cards
from isd_gym.benchmark.tracks import TRACKS
from isd_gym.env.registration import EPISODE_STEPS, REWARD_THRESHOLDS

ROOT = Path(__file__).resolve().parents[1]
TIMES = ROOT / "benchmarks" / "tracks.json"
ROBUST = ROOT / "benchmarks" / "robust-track.json"
#: policies that were trained
LEARNED = {path.name for path in (ROOT / "agents" / "policies").iterdir()}


BLIND = ("passive", "isd-passive", "skyhook", "lqg", "mpc", "mpc-friction")
WHEELBASE = (*BLIND, "lqg-wheelbase", "mpc-wheelbase")
AHEAD = ("passive", "skyhook", "mpc-friction", "lqg-preview", "mpc-friction-preview")
QUARTER = "ISDSuspension-v0"
ROADS = ("A", "B", "C", "D", "E", "bump")
#: policies of the card, by track
POLICIES = {
    "standard": ("passive", "isd-passive", "skyhook", "add", "lqg", "mpc-paper", "mpc", "mpc-friction", "ppo", "sac"),
    "preview-0.1": (*AHEAD, "ppo-preview-0.1"),
    "preview-0.2": (*AHEAD, "ppo-preview-0.2"),
    "half-car": (*WHEELBASE, "ppo-half-car"),
    "full-car": (*WHEELBASE, "ppo-full-car"),
    "full-car-preview-0.2": ("passive", "skyhook", "lqg-wheelbase", "mpc-wheelbase", "lqg-preview", "mpc-friction-preview"),
} | {name: ("passive", "skyhook", "lqg", "mpc") for name in TRACKS if "active" in name}  # fmt: skip


def best(rows: list[dict[str, Any]], *, learned: bool) -> dict[str, Any] | None:
    """Best learned or best classical policy of a track, from rows in the order of J."""
    return next((row for row in rows if (row["policy"] in LEARNED) == learned), None)


def reward_threshold(card: dict[str, Any]) -> float:
    """Return of the best classical controller of the track `standard`, rounded down to a multiple of 5."""
    row = best(cards.ranking(card, "standard"), learned=False)
    assert row is not None
    return float(5 * math.floor(-EPISODE_STEPS * row["cost"]["value"] / 5))


def run(words: list[str]) -> float:
    """Run a command of the program, and return its processor time [s]."""
    before = os.times()
    subprocess.run(
        [sys.executable, "-m", "isd_gym", *words], check=True, stdout=subprocess.DEVNULL
    )
    after = os.times()
    return (
        after.children_user
        + after.children_system
        - before.children_user
        - before.children_system
    )


def make_card(environment: str, folder: Path) -> dict[str, float]:
    """Score the tracks of an environment and write its card; return the processor time of each track [s]."""
    spent, files = {}, []
    for name, policies in POLICIES.items():
        track = TRACKS[name]
        if track.card == environment:
            files.append(folder / f"{track.name}.json")
            spent[track.name] = run(
                ["score", *policies, "--track", name, "--json", str(files[-1])]
            )
            print(f"{environment}, {track.name}: {spent[track.name]:.0f} s", flush=True)
    run(
        [
            "card",
            *map(str, files),
            "--write",
            str(cards.BUILT_IN / f"{environment}.json"),
        ]
    )
    return spent


def drive_robust(folder: Path, jobs: int) -> dict[str, float]:
    """Drive the robust track and keep its overall result; return the processor time [s]."""
    spent = run(
        ["sweep", "robust", "--out", str(folder / "robust"), "--jobs", str(jobs)]
    )
    found = read_json(folder / "robust" / "sweep.json")
    kept = {
        k: found[k]
        for k in ("schema", "episodes", "seed", "duration", "overall", "missing")
    }
    kept["conditions"] = len(found["conditions"])
    save_json(ROBUST, kept)
    print(f"robust: {spent:.0f} s", flush=True)
    return {"robust": spent}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    names = (*dict.fromkeys(TRACKS[name].card for name in POLICIES), "robust")
    parser.add_argument("--only", nargs="+", choices=names, default=names)
    parser.add_argument(
        "--jobs", type=int, default=1, help="processes of the robust track"
    )
    given = parser.parse_args()
    times = read_json(TIMES) if TIMES.exists() else {}
    for name in given.only:
        with tempfile.TemporaryDirectory() as place:
            if name == "robust":
                spent = drive_robust(Path(place), given.jobs)
            else:
                spent = make_card(name, Path(place))
        times[name] = {"date": time.strftime("%Y-%m-%d"), "processor_seconds": spent}
        save_json(TIMES, times)
    subprocess.run([sys.executable, str(ROOT / "docs" / "results.py")], check=True)
    thresholds = {
        name: reward_threshold(cards.load(name)) for name in REWARD_THRESHOLDS
    }
    print(f"REWARD_THRESHOLDS = {json.dumps(thresholds)}")


if __name__ == "__main__":
    main()
