"""The loop closed: a car whose seal sticks, an owner who does not know it, records, the diagnosis, a better controller.

    python examples/close_the_loop.py --out found

The car is the default one with a stiffer tyre and a lighter wheel; its owner's model lacks the seal's dry friction.
Two short records with noisy sensors are diagnosed, the model is completed, and the MPC with the old and with the new
model drive the car on roads that neither has seen.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from isd_gym import (
    Diagnosis,
    Network,
    Score,
    Table,
    baselines,
    diagnose,
    score,
    simulate,
)
from isd_gym.benchmark.policies import passive
from isd_gym.benchmark.scoring import Entry
from isd_gym.physics.road import road
from isd_gym.view import write_report

CAR = Network.load("quarter-car-isd").with_parameters(
    {"wheel.mass": 44.0, "tyre.stiffness": 195e3, "body.mass": 350.0}
)
OWNERS = Network.load("quarter-car-isd").without_element("seal")


def record(name: str, seed: int, duration: float = 10.0, step: float = 2e-3) -> Table:
    """A drive of `duration` [s] on the paper's road with random currents, sensors with 2 % noise."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, duration, step)
    heights = road("paper").heights(time[-1], speed=20.0, step=step, rng=rng)[
        : len(time)
    ]
    held = round(0.1 / step)
    current = np.repeat(rng.uniform(-4.0, 4.0, len(time) // held + 1), held)[
        : len(time)
    ]
    measured = simulate(CAR, time, {"road": heights, "current": current})
    noisy = {
        k: y + 0.02 * y.std() * rng.standard_normal(len(y)) for k, y in measured.items()
    }
    return Table(time, {"road": heights, "current": current, **noisy}, name)


def close(episodes: int = 8, say: Any = None) -> tuple[Diagnosis, Score]:
    """Diagnose two records of the car, then score the MPC that believes in the old and in the new model, on the car."""
    found = diagnose(
        [record("drive 1", 1)], OWNERS, validate=[record("drive 2", 2)], progress=say
    )
    entries = [
        Entry("mpc, old model", lambda: baselines.make("mpc", OWNERS)),
        Entry("mpc, new model", lambda: baselines.make("mpc", found.model)),
    ]
    return found, score(entries, CAR, reference=passive(CAR), episodes=episodes)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--out", type=Path, help="folder for the diagnosis and its report"
    )
    parser.add_argument(
        "--episodes", type=int, default=8, help="roads of 20 s to score on"
    )
    parser.add_argument("--json", type=Path, help="file for the score")
    args = parser.parse_args()
    found, result = close(args.episodes, print)
    print(found.summary)
    for row in result.to_dict()["policies"]:
        cost = row["cost"]
        change = (
            "" if cost.get("change") is None else f"  {100 * cost['change']:+.1f} %"
        )
        print(f"{row['policy']:16s} J {cost['value']:.3f}{change}")
    if args.out:
        print(f"report: {write_report(found, args.out)}")
    if args.json:
        args.json.write_text(json.dumps(result.to_dict(), indent=1) + "\n")


if __name__ == "__main__":
    main()
