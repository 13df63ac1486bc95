"""Every controller on cars, roads and sensors it was not made for (ten minutes on one core).

    python benchmarks/robustness.py --json benchmarks/robustness.json
    python benchmarks/robustness.py skyhook my-policy-folder
    python docs/controllers.py          # the table of the page, from the file

In every condition the controllers keep believing in the nominal car, unless the condition is what they believe in. The
cost is compared with the conventional passive car of the same masses on the same roads: `EPISODES` of `DURATION` each,
seeds that no controller was tuned on. Every command is checked on its way: finite, at most 5 A, at most 0.5 A from the
present current.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from isd_gym.batch import CURRENT_LIMIT, SLEW_LIMIT
from isd_gym.cost import StageCost
from isd_gym.files import write_text
from isd_gym.network import Network
from isd_gym.policies import find, passive
from isd_gym.scoring import Entry, drive

SCHEMA = "isd-robustness/1"
POLICIES = ("isd-passive", "skyhook", "add", "lqg", "mpc-paper", "mpc", "mpc-friction")
PLANT, PRINTED = "quarter-car-isd", "quarter-car-eq8"
EPISODES, DURATION, SEED = 8, 10.0, 5000
#: one sigma of white noise on each measured signal; the current is the controller's own and is known
NOISE = {
    "body_acceleration": 0.1,  # m/s^2
    "suspension_travel": 5e-4,  # m
    "suspension_travel_rate": 0.02,  # m/s
    "device_travel": 1e-4,  # m
    "device_travel_rate": 0.01,  # m/s
}
RESAMPLES = 4000


class Noise:
    def __init__(self) -> None:
        self.rng = np.random.default_rng(SEED)
        self.sigma = np.array([*NOISE.values()])

    def __call__(self, observations: np.ndarray, step: int) -> np.ndarray:
        out = observations.copy()
        out[:, :5] += self.sigma * self.rng.standard_normal((len(out), 5))
        return out


class Delay:
    """The signals come one control step late; the present current does not."""

    def __init__(self) -> None:
        self.last: np.ndarray | None = None

    def __call__(self, observations: np.ndarray, step: int) -> np.ndarray:
        out = observations.copy()
        if self.last is not None:
            out[:, :5] = self.last
        self.last = observations[:, :5].copy()
        return out


@dataclass(frozen=True)
class Condition:
    """factors: on parameters of the plant. model: what the controllers believe in."""

    name: str
    road: str = "paper"
    speed: float = 20.0  # m/s
    factors: dict[str, float] = field(default_factory=dict)
    corrupt: Callable[[], Any] | None = None
    model: str = PLANT
    episodes: int = EPISODES  # one where the road is not random


CONDITIONS = (
    Condition("nominal"),
    Condition("body 20 % lighter", factors={"body.mass": 0.8}),
    Condition("body 20 % heavier", factors={"body.mass": 1.2}),
    Condition("friction halved", factors={"seal.level": 0.5}),
    Condition("friction 50 % higher", factors={"seal.level": 1.5}),
    Condition("thrust constant 15 % lower", factors={"motor.thrust_constant": 0.85}),
    Condition("thrust constant 15 % higher", factors={"motor.thrust_constant": 1.15}),
    Condition("10 m/s", speed=10.0),
    Condition("30 m/s", speed=30.0),
    Condition("ISO 8608 class A", road="A"),
    Condition("ISO 8608 class C", road="C"),
    Condition("ISO 8608 class E", road="E"),
    Condition("bump", road="bump", episodes=1),
    Condition("pothole", road="pothole", episodes=1),
    Condition("noisy sensors", corrupt=Noise),
    Condition("signals 5 ms late", corrupt=Delay),
    Condition("belief: equation (8)", model=PRINTED),
)


def checked(entry: Entry, counts: Counter[str]) -> Entry:
    """The same policy, its commands counted."""

    def make() -> Any:
        controller: Any = entry.make()
        name = "act_batch" if hasattr(controller, "act_batch") else "act"
        act = getattr(controller, name)

        def watched(observation: np.ndarray) -> Any:
            command = act(observation)
            present = np.atleast_2d(observation)[:, 5]
            wanted = np.broadcast_to(command, present.shape)
            counts["commands"] += len(wanted)
            counts["not finite"] += int(np.sum(~np.isfinite(wanted)))
            counts["above 5 A"] += int(np.sum(np.abs(wanted) > CURRENT_LIMIT + 1e-6))
            counts["steps above 0.5 A"] += int(np.sum(np.abs(wanted - present) > SLEW_LIMIT + 1e-6))
            return command

        setattr(controller, name, watched)
        return controller

    return Entry(entry.name, make, entry.network)


def run(
    policies: tuple[str, ...] = POLICIES,
    conditions: tuple[Condition, ...] = CONDITIONS,
    duration: float = DURATION,
    say: Callable[[str], None] = lambda line: None,
) -> dict[str, Any]:
    """Change of the cost of every policy in every condition, and the count of its commands."""
    cost = StageCost()
    counts = {name: Counter[str]() for name in policies}
    rows = []
    for condition in conditions:
        nominal = Network.load(PLANT)
        values = {k: nominal.parameters[k] * v for k, v in condition.factors.items()}
        plant = nominal.with_parameters(values)
        on: dict[str, Any] = dict(
            road=condition.road,
            speed=condition.speed,
            episodes=condition.episodes,
            seed=SEED,
            duration=duration,
        )
        base = drive(passive(plant), plant, **on)
        ground = base.cost(cost)
        draws = np.random.default_rng(0).integers(len(ground), size=(RESAMPLES, len(ground)))
        row: dict[str, Any] = {
            "condition": condition.name,
            "passive_cost": float(ground.mean()),
            "policies": {},
        }
        for name in policies:
            entry = find(name, plant, model=Network.load(condition.model))
            corrupt = condition.corrupt() if condition.corrupt else None
            found = drive(checked(entry, counts[name]), plant, corrupt=corrupt, **on)
            own = found.cost(cost)
            ratio = own[draws].mean(axis=1) / ground[draws].mean(axis=1) - 1
            rms = lambda r, key: float(np.sqrt(np.mean(getattr(r, key) ** 2)))  # noqa: E731
            row["policies"][name] = {
                "cost": float(own.mean() / ground.mean() - 1),
                "low": float(np.quantile(ratio, 0.025)),
                "high": float(np.quantile(ratio, 0.975)),
                **{
                    key: rms(found, key) / rms(base, key) - 1
                    for key in ("body_acceleration", "suspension_travel", "tyre_load")
                },
                "fallbacks": found.fallbacks,
            }
        rows.append(row)
        cells = "".join(f"{100 * row['policies'][n]['cost']:+13.1f}" for n in policies)
        say(f"{condition.name:<28}{cells}")
    return {
        "schema": SCHEMA,
        "plant": PLANT,
        "episodes": EPISODES,
        "duration": duration,
        "seed": SEED,
        "noise": NOISE,
        "conditions": rows,
        "commands": {n: dict(c) for n, c in counts.items()},
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("policies", nargs="*", default=POLICIES)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    names = tuple(args.policies)
    print(f"{'change of J against passive, %':<28}" + "".join(f"{n:>13}" for n in names))
    result = run(names, say=lambda line: print(line, flush=True))
    for name, counts in result["commands"].items():
        print(f"{name:<16}" + ", ".join(f"{v} {k}" for k, v in counts.items()))
    if args.json:
        write_text(args.json, json.dumps(result, indent=1, allow_nan=False) + "\n")


if __name__ == "__main__":
    main()
