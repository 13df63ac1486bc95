"""What learns here: Stable-Baselines3 with default hyperparameters on the environments for learning.

    python benchmarks/learning.py [--only NAME ...] [--seeds 5]    # one core; goes on where it stopped
    python docs/results.py    # the table of the study, from the file

Every seed is trained, scored on the 32 scoring roads, and added to benchmarks/learning.json.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from json_files import read_json

from isd_gym._commands.train import arguments, read_recipe

RESULT = Path(__file__).with_suffix(".json")
POINTS = 10  # of a learning curve
QUARTER, HALF, FULL = (
    "ISDSuspensionLearning-v0",
    "ISDHalfCarLearning-v0",
    "ISDFullCarLearning-v0",
)


@dataclass(frozen=True)
class Setting:
    """An algorithm on an environment, with the options that differ from the defaults."""

    algorithm: str
    decisions: int
    options: dict[str, Any] = field(default_factory=dict)  # of the environment
    cars: int = 1
    environment: str = QUARTER
    recipe: str = ""  # of isd-gym train


SETTINGS = {
    "PPO": Setting("PPO", 80_000),
    "PPO, reward cost": Setting("PPO", 80_000, {"reward": "cost"}),
    "PPO, observation measured": Setting("PPO", 80_000, {"observation": "measured"}),
    "PPO, hold 4": Setting("PPO", 80_000, {"hold": 4}),
    "PPO, reward_scale 1": Setting("PPO", 80_000, {"reward_scale": 1.0}),
    "PPO, 8 cars": Setting("PPO", 80_000, cars=8),
    "SAC": Setting("SAC", 8_000),
    "SAC, reward_scale 3": Setting("SAC", 8_000, {"reward_scale": 3.0}),
    "SAC, reward_scale 1": Setting("SAC", 8_000, {"reward_scale": 1.0}),
    "A2C": Setting("A2C", 80_000),
    "TD3": Setting("TD3", 8_000),
    "TQC": Setting("TQC", 8_000),
    "PPO, half car": Setting("PPO", 80_000, environment=HALF),
    "PPO, full car": Setting("PPO", 80_000, environment=FULL),
}


# the recipes of `isd-gym train`, for a quarter, half and full car
for recipe, environment, car in (
    ("ppo", QUARTER, ""),
    ("sac", QUARTER, ""),
    ("ppo-model-free", QUARTER, ""),
    ("ppo-model-free", HALF, ", half car"),
    ("ppo", HALF, ", half car"),
    ("ppo", FULL, ", full car"),
):
    plan = read_recipe(recipe)
    SETTINGS[f"recipe {recipe}{car}"] = Setting(
        plan["algorithm"],
        plan["steps"],
        plan["environment"],
        plan["cars"],
        environment,
        recipe,
    )


def train(setting: Setting, seed: int, model_file: Path) -> dict[str, Any]:
    """Train and save a model; return its processor time [s] and its curve on the validation roads."""
    import gymnasium
    import sb3_contrib
    import stable_baselines3
    import torch
    from stable_baselines3.common.env_util import make_vec_env

    from isd_gym import sb3

    class Curve(sb3.ScoreCallback):
        """Score on the validation roads, with the processor time of the drives [s]."""

        spent = 0.0

        def _cost(self, entry: Any) -> float:
            begin = time.process_time()
            cost = super()._cost(entry)
            self.spent += time.process_time() - begin
            return cost

    torch.set_num_threads(1)
    library = sb3_contrib if setting.algorithm == "TQC" else stable_baselines3
    more: dict[str, Any] = {}
    if setting.recipe:
        env: Any = sb3.make_vec_env(
            setting.environment, setting.cars, **setting.options
        )
        more = arguments(read_recipe(setting.recipe))
    elif setting.cars == 1:
        env = gymnasium.make(setting.environment, **setting.options)
    else:
        env = make_vec_env(
            setting.environment, setting.cars, env_kwargs=setting.options
        )
    learner = getattr(library, setting.algorithm)
    model = learner("MlpPolicy", env, seed=seed, device="cpu", **more)
    curve = Curve(setting.decisions // POINTS, references=(), verbose=0)
    begin = time.process_time()
    model.learn(setting.decisions, callback=curve)
    seconds = time.process_time() - begin - curve.spent
    model.save(model_file)
    points = [[steps, round(change, 2)] for steps, _, change in curve.history]
    return {"seconds": round(seconds, 1), "curve": points}


def score_of(model_file: Path, network: str) -> float:
    """Return the change of J against the passive car on the scoring roads [%]."""
    from isd_gym import score

    rows = score([str(model_file)], network).policies
    return round(100.0 * rows[-1]["cost"]["change"], 2)


def read() -> dict[str, Any]:
    """Return the results by setting and seed."""
    return read_json(RESULT) if RESULT.exists() else {}


def study(names: list[str], seeds: int) -> None:
    """Train and score what the results lack."""
    from isd_gym.env.registration import LEARNING

    folder = Path("runs/learning")
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        for seed in map(str, range(seeds)):
            if seed in read().get(name, {}):
                continue
            setting = SETTINGS[name]
            model_file = (
                folder / f"{name.replace(', ', '-').replace(' ', '-')}-{seed}.zip"
            )
            found = train(setting, int(seed), model_file)
            found["change"] = score_of(model_file, LEARNING[setting.environment])
            print(
                f"{name}, seed {seed}: {found['change']} %, {found['seconds']} s",
                flush=True,
            )
            results = read()  # others may have added to it
            results.setdefault(name, {})[seed] = found
            RESULT.write_text(json.dumps(results) + "\n", encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--only",
        nargs="+",
        choices=list(SETTINGS),
        default=list(SETTINGS),
        metavar="NAME",
    )
    parser.add_argument("--seeds", type=int, default=5)
    given = parser.parse_args()
    study(given.only, given.seeds)


if __name__ == "__main__":
    main()
