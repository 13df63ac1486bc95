"""The gain from the rear road known from the front: half car or full car, over the speed.

python benchmarks/wheelbase.py [--network half-car-isd] [--speeds 10 15 20 25 30] [--episodes 16] [--seed 3000] --json FILE

At each speed every controller drives the same roads. The file has the cost of each against the conventional passive car, and the
paired change against the decentralised friction-aware MPC (`mpc-friction`), both with 95 % intervals; for a half car also
the linear-quadratic bound with and without knowledge of the rear road. Controllers are told the speed: the intensity of
the road's velocity, and the delay of the rear axle, wheelbase / speed. The benchmark continues FILE where it exists.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from json_files import read_json, save_json

from isd_gym import InputError, Network, baselines, score
from isd_gym.benchmark.lq_bounds import wheelbase_bound
from isd_gym.benchmark.policies import find
from isd_gym.benchmark.scoring import Entry, compare, measures
from isd_gym.physics.prediction import ROAD_INTENSITY
from isd_gym.physics.vehicle import vehicle

POLICIES = (
    "isd-passive",
    "skyhook",
    "lqg",
    "mpc",
    "mpc-friction",
    "lqg-wheelbase",
    "mpc-wheelbase",
)
BASE = "mpc-friction"
KEPT = ("cost", "body_acceleration_rms", "pitch_acceleration_rms", "weighted_acceleration_rms", "tyre_load_rms",
        "suspension_travel_front_rms", "suspension_travel_rear_rms")  # fmt: skip


def entry(name: str, network: Any, speed: float) -> Any:
    """A controller that knows the speed."""
    if name in ("isd-passive", "skyhook"):
        return find(name, network)
    if name.endswith("-wheelbase"):
        return Entry(name, lambda: baselines.make(name, network, speed=speed))
    return Entry(
        name,
        lambda: baselines.make(
            name, network, road_intensity=ROAD_INTENSITY * speed / 20.0
        ),
    )


def drive(
    network: Any, speed: float, episodes: int, seed: int, duration: float
) -> dict[str, Any]:
    """Return the figures of all controllers at one speed."""
    entries = [entry(name, network, speed) for name in POLICIES]
    found = score(
        entries, network, speed=speed, episodes=episodes, seed=seed, duration=duration
    )
    base = measures(found.runs[BASE], found.cost)["cost"][0]
    rows = {}
    for row in found.policies:
        name = row["policy"]
        against = compare(
            "cost", measures(found.runs[name], found.cost)["cost"][0], base, "-"
        )
        rows[name] = {k: row[k] for k in KEPT if k in row} | {
            f"cost_against_{BASE}": against
        }
        rows[name] |= {
            "fallbacks": row["fallbacks"],
            "control_time": row["control_time"],
        }
    return {"speed": {"value": speed, "unit": "m/s"}, "policies": rows}


def bound(network: Any, speed: float) -> dict[str, Any] | None:
    """Return the change of the cost at the linear-quadratic bound, with and without knowledge of the rear road."""
    try:
        found = wheelbase_bound(network, speed=speed)
    except InputError:
        return None
    return {
        "change": found.change,
        "change_without_rear_road": found.blind_change,
        "passive": found.passive,
    }


def main(argv: list[str] | None = None) -> None:
    """Drive, print a line for each speed, and write the file."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--network", default="half-car-isd")
    parser.add_argument(
        "--speeds", type=float, nargs="+", default=[10.0, 15.0, 20.0, 25.0, 30.0]
    )
    parser.add_argument("--episodes", type=int, default=16)
    parser.add_argument("--seed", type=int, default=3000)
    parser.add_argument("--duration", type=float, default=20.0)
    parser.add_argument("--json", type=Path, required=True)
    args = parser.parse_args(argv)
    network = Network.load(args.network)
    car = vehicle(network)
    conditions = {"network": network.name, "road": "paper", "episodes": args.episodes, "seed": args.seed,
                  "duration": {"value": args.duration, "unit": "s"}, "wheelbase": {"value": max(car.wheels.behind), "unit": "m"}}  # fmt: skip
    out: dict[str, Any] = {**conditions, "speeds": []}
    if args.json.exists():
        held = read_json(args.json)
        if {k: held.get(k) for k in conditions} != conditions:
            parser.error(f"{args.json} holds other conditions: name another file")
        out = held
    for speed in args.speeds:
        if any(one["speed"]["value"] == speed for one in out["speeds"]):
            continue
        begin = time.time()
        one = drive(network, speed, args.episodes, args.seed, args.duration)
        one["preview"] = {
            "value": conditions["wheelbase"]["value"] / speed,
            "unit": "s",
        }
        one["lq_bound"] = bound(network, speed)
        out["speeds"] = sorted(
            [*out["speeds"], one], key=lambda row: row["speed"]["value"]
        )
        save_json(args.json, out)
        for name, row in one["policies"].items():
            a, b = row["cost"], row[f"cost_against_{BASE}"]
            print(
                f"{speed:g} m/s {name:15} J {a['value']:.4f} {_interval(a)} against passive, {_interval(b)} against {BASE}"
            )
        print(
            f"{speed:g} m/s bound {one['lq_bound']}, {time.time() - begin:.0f} s",
            flush=True,
        )


def _interval(q: dict[str, Any]) -> str:
    return f"{100 * q['change']:+.2f} % [{100 * q['low']:+.2f}, {100 * q['high']:+.2f}]"


if __name__ == "__main__":
    main()
