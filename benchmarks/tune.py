"""One setting of a baseline changed at a time, on roads that the score does not use.

    python benchmarks/tune.py mpc-friction horizon=40 tyre_load=0 spread=0.7 --seed 1000 --episodes 16
    python benchmarks/tune.py mpc tyre_load=0.1 --seed 3000 --episodes 16

The first line is the controller as shipped. Change of J, acceleration, travel and tyre load against passive, in %.
"""

from __future__ import annotations

import argparse
import ast
from typing import Any

import numpy as np

import baselines
from isd_gym.cost import StageCost
from isd_gym.network import Network
from isd_gym.policies import passive
from isd_gym.scoring import Entry, Run, drive

NETWORK = Network.load("quarter-car-isd")


def change(run: Run, base: Run) -> list[float]:
    """J, acceleration, travel, tyre load, in per cent."""
    out = [run.cost(StageCost()).mean() / base.cost(StageCost()).mean() - 1]
    for key in ("body_acceleration", "suspension_travel", "tyre_load"):
        out.append(np.sqrt(np.mean(getattr(run, key) ** 2) / np.mean(getattr(base, key) ** 2)) - 1)
    return [100 * float(x) for x in out]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("name")
    parser.add_argument("settings", nargs="*", help="name=value")
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--episodes", type=int, default=16)
    args = parser.parse_args()
    on: dict[str, Any] = dict(seed=args.seed, episodes=args.episodes)
    base = drive(passive(NETWORK), NETWORK, **on)
    for setting in ["", *args.settings]:
        options: dict[str, Any] = {}
        if setting:
            key, _, value = setting.partition("=")
            try:
                options[key] = ast.literal_eval(value)
            except ValueError:
                options[key] = value
        entry = Entry(args.name, lambda o=options: baselines.make(args.name, **o))
        cells = "".join(f"{x:9.2f}" for x in change(drive(entry, NETWORK, **on), base))
        print(f"{setting or 'as shipped':<36}{cells}", flush=True)


if __name__ == "__main__":
    main()
