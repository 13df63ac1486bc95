"""Settings of a baseline, one changed at a time or several together, on roads that the score does not use.

    python benchmarks/tune.py mpc-friction horizon=40 tyre_load=0 spread=0.7 --seed 1000 --episodes 16
    python benchmarks/tune.py mpc tyre_load=0.1,centring=0.1 --seed 3000 --episodes 16
    python benchmarks/tune.py mpc-friction noise=0.5 noise=0.5,spread=0.7 --randomize --episodes 64 --duration 10

The first line is the controller as shipped. Change of J, acceleration, travel and tyre load against passive, in %; with
``--randomize`` on cars, roads and sensors of the robust track, the mean change of J of a car against itself without current,
and its standard error. `noise` [-] is what the estimate takes the sensors' noise to be, a multiple of the track's.
"""

from __future__ import annotations

import argparse
import ast
from typing import Any

import numpy as np

from isd_gym import baselines
from isd_gym.benchmark.policies import find, passive
from isd_gym.benchmark.scoring import Entry, Run, drive
from isd_gym.contrib.training.settings import robust
from isd_gym.physics.cost import StageCost
from isd_gym.physics.network import Network

NETWORK = Network.load("quarter-car-isd")


def change(run: Run, base: Run) -> list[float]:
    """J, acceleration, travel, tyre load, in per cent."""
    out = [run.cost(StageCost()).mean() / base.cost(StageCost()).mean() - 1]
    for key in ("body_acceleration", "suspension_travel", "tyre_load"):
        out.append(np.sqrt(np.mean(getattr(run, key) ** 2) / np.mean(getattr(base, key) ** 2)) - 1)
    return [100 * float(x) for x in out]


def spread(run: Run, base: Run) -> list[float]:
    """Mean over cars of the change of J and its standard error, in per cent."""
    ratio = run.cost(StageCost()) / base.cost(StageCost()) - 1
    return [100 * float(ratio.mean()), 100 * float(ratio.std() / len(ratio) ** 0.5)]


def options(setting: str) -> dict[str, Any]:
    """``a=1,b=x`` as keyword arguments."""
    out: dict[str, Any] = {}
    for part in filter(None, setting.split(",")):
        key, _, value = part.partition("=")
        try:
            out[key] = ast.literal_eval(value)
        except ValueError:
            out[key] = value
    if "noise" in out:
        out["sensors"] = baselines.noisy(out.pop("noise"))
    return out


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("name")
    parser.add_argument("settings", nargs="*", help="name=value,name=value")
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--episodes", type=int, default=16)
    parser.add_argument("--duration", type=float, default=20.0)
    parser.add_argument("--randomize", action="store_true")
    args = parser.parse_args()
    on: dict[str, Any] = dict(seed=args.seed, episodes=args.episodes, duration=args.duration)
    if args.randomize:
        ranges, sensors = robust()
        on |= dict(randomize=ranges, sensors=sensors)
    base = drive(find("isd-passive", NETWORK) if args.randomize else passive(NETWORK), NETWORK, **on)
    for setting in ["", *args.settings]:
        given = options(setting)
        entry = Entry(args.name, lambda o=given: baselines.make(args.name, **o))
        cells = (spread if args.randomize else change)(drive(entry, NETWORK, **on), base)
        print(f"{setting or 'as shipped':<48}{''.join(f'{x:9.2f}' for x in cells)}", flush=True)


if __name__ == "__main__":
    main()
