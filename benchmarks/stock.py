"""Stock Stable-Baselines3 on the environment for learning: no teacher, no filter, five training seeds.

python benchmarks/stock.py train --out runs/stock [--only ppo-2min ...] [--seeds 5]     # one core; goes on where it stopped
python benchmarks/stock.py collect runs/stock                                           # scores all, writes benchmarks/stock.json

`ppo-2min` is the recipe of docs/tutorials/train.md. The models with default settings have all default hyperparameters of the
library. The interval of a mean over training seeds is a stratified bootstrap over seeds and roads, as in study.py.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import time
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
RESULT = ROOT / "benchmarks" / "stock.json"
POINTS = 25  # of a learning curve
DECISIONS = 667  # of an episode of 20 s, each held for 30 ms
PASSIVE = {"quarter-car-isd": ("passive", "skyhook", "mpc", "mpc-friction"), "half-car-isd": ("passive", "lqg-wheelbase", "mpc-wheelbase")}  # fmt: skip
TUNED: dict[str, Any] = {
    "n_steps": 256, "batch_size": 2048, "n_epochs": 1, "gamma": 0.99, "gae_lambda": 1.0,
    "policy_kwargs": {"net_arch": {"pi": [64, 64], "vf": []}},
}  # fmt: skip
#: options of all recipes: the reward needs no model of the car
RELATIVE: dict[str, Any] = {"reward": "relative", "action": "increment", "hold": 2, "reward_scale": 1.0}
OFF_POLICY: dict[str, Any] = {"hold": 6, "reward_scale": 30.0}


@dataclasses.dataclass(frozen=True)
class Recipe:
    """What is trained: an algorithm of the library on cars of an environment."""

    algorithm: str
    cars: int
    decisions: int
    rate: float | None = None  # first learning rate, falling to 0; None: the default
    arguments: dict[str, Any] = dataclasses.field(default_factory=dict)
    options: dict[str, Any] = dataclasses.field(default_factory=dict)  # of the environment
    normalized: bool = False  # VecNormalize with its defaults
    pink: bool = False  # noise of the actions is pink (package pink-noise-rl), of a deviation of 0.3 for TD3
    environment: str = "ISDSuspensionLearning-v0"


RECIPES = {
    "ppo-2min": Recipe("PPO", 512, 25_000_000, 1e-3, TUNED),
    "ppo-defaults": Recipe("PPO", 32, 1_900_000),
    "sac-defaults": Recipe("SAC", 32, 1_000_000),
    "sac": Recipe("SAC", 32, 1_280_000, options=OFF_POLICY),
    "sac, pink noise": Recipe("SAC", 32, 1_280_000, options=OFF_POLICY, pink=True),
    "tqc": Recipe("TQC", 32, 1_280_000, options=OFF_POLICY),
    "td3": Recipe("TD3", 32, 1_280_000, options=OFF_POLICY),
    "td3, pink noise": Recipe("TD3", 32, 1_280_000, options=OFF_POLICY, pink=True),
    "ppo-half-car": Recipe("PPO", 512, 25_000_000, 1e-3, TUNED, environment="ISDHalfCarLearning-v0"),
    # half of the recipe, with one thing changed
    "half": Recipe("PPO", 512, 12_500_000, 1e-3, TUNED),
    "half, hold 1": Recipe("PPO", 512, 12_500_000, 1e-3, TUNED, {"hold": 1}),
    "half, hold 4": Recipe("PPO", 512, 12_500_000, 1e-3, TUNED, {"hold": 4}),
    "half, hold 8": Recipe("PPO", 512, 12_500_000, 1e-3, TUNED, {"hold": 8}),
    "half, gSDE": Recipe("PPO", 512, 12_500_000, 1e-3, {**TUNED, "use_sde": True, "sde_sample_freq": 16}),
    "half, gSDE, hold 1": Recipe(
        "PPO", 512, 12_500_000, 1e-3, {**TUNED, "use_sde": True, "sde_sample_freq": 16}, {"hold": 1}
    ),
    "half, VecNormalize": Recipe("PPO", 512, 12_500_000, 1e-3, TUNED, normalized=True),
    "half, own cost": Recipe("PPO", 512, 12_500_000, 1e-3, TUNED, {"reward": "cost"}),
    "half, one observation": Recipe("PPO", 512, 12_500_000, 1e-3, TUNED, {"observation": "measured"}),
    "half, current": Recipe("PPO", 512, 12_500_000, 1e-3, TUNED, {"action": "current"}),
}  # fmt: skip


def train(name: str, seed: int, folder: Path) -> None:
    """Train a recipe with a seed; do nothing where the model exists."""
    import torch
    from sb3_contrib import TQC
    from stable_baselines3 import PPO, SAC, TD3
    from stable_baselines3.common.noise import VectorizedActionNoise
    from stable_baselines3.common.vec_env import VecNormalize

    from isd_gym.sb3 import ScoreCallback, make_vec_env

    out = folder / name / f"{seed}.zip"
    if out.exists():
        return
    torch.set_num_threads(1)
    recipe = RECIPES[name]
    kinds: dict[str, Any] = {"PPO": PPO, "SAC": SAC, "TD3": TD3, "TQC": TQC}
    cars: Any = make_vec_env(recipe.environment, recipe.cars, cars_per_road=8, **RELATIVE | recipe.options)
    env = VecNormalize(cars) if recipe.normalized else cars
    more: dict[str, Any] = {}
    if recipe.rate is not None:
        first = recipe.rate
        more["learning_rate"] = lambda left: first * left
    if recipe.pink and recipe.algorithm == "TD3":
        from pink import PinkActionNoise

        rngs = np.random.default_rng(seed).spawn(recipe.cars)
        noises = [PinkActionNoise(0.3, seq_len=DECISIONS, action_dim=1, rng=rng) for rng in rngs]
        more["action_noise"] = VectorizedActionNoise(noises[0], recipe.cars)
        more["action_noise"].noises = noises
    model = kinds[recipe.algorithm]("MlpPolicy", env, seed=seed, device="cpu", **recipe.arguments, **more)
    if recipe.pink and recipe.algorithm == "SAC":
        from pink import PinkNoiseDist

        model.actor.action_dist = PinkNoiseDist(DECISIONS, 1, rng=np.random.default_rng(seed))
    env.seed(seed * 1_000_003 + 12_345)

    class Curve(ScoreCallback):
        """J on the validation roads over the processor time of the training alone."""

        def _evaluate(self) -> None:
            self.spent.append(time.process_time() - self.begun)
            super()._evaluate()
            self.begun += time.process_time() - self.begun - self.spent[-1]

    curve = Curve(recipe.decisions // POINTS, references=(), verbose=0)
    curve.spent, curve.begun = [], time.process_time()
    model.learn(recipe.decisions, callback=curve)
    out.parent.mkdir(parents=True, exist_ok=True)
    seconds = round(curve.spent[-1], 1)
    points = [[round(t, 1), *row] for t, row in zip(curve.spent, curve.history, strict=True)]
    (folder / name / f"{seed}.json").write_text(
        json.dumps({"processor_seconds": seconds, "curve": points}) + "\n"
    )
    if recipe.normalized:
        env.save(str(out.with_name(f"{seed}_vecnormalize.pkl")))
    model.save(out)
    print(f"{name}, seed {seed}: {seconds:.0f} s", flush=True)


def collect(folder: Path) -> None:
    """Score all models of a folder on the scoring roads; results of recipes without a model there stay."""
    from isd_gym.benchmark.scoring import score
    from isd_gym.env.registration import LEARNING

    before = json.loads(RESULT.read_text(encoding="utf-8"))
    rows: dict[str, Any] = {}
    grounds: dict[str, dict[str, list[float]]] = before["references"]
    for name, recipe in RECIPES.items():
        models = sorted((folder / name).glob("*.zip"), key=lambda p: int(p.stem))
        if not models:
            if name in before["recipes"]:
                rows[name] = before["recipes"][name]
            continue
        network = LEARNING[recipe.environment]
        if network not in grounds:
            found = score(list(PASSIVE[network]), network)
            grounds[network] = {k: v["cost"] for k, v in found.raw.items()}
        costs = []
        for model in models:
            found = score([str(model)], network)
            costs.append(next(v["cost"] for k, v in found.raw.items() if k != "passive"))
        told = [json.loads(m.with_suffix(".json").read_text()) for m in models]
        spent = [each["processor_seconds"] for each in told]
        rows[name] = {
            "algorithm": recipe.algorithm, "environment": recipe.environment, "network": network, "cars": recipe.cars,
            "decisions": recipe.decisions,
            "seeds": [int(m.stem) for m in models], "processor_seconds": spent, "costs": costs,
            # processor time [s], decisions, J, change against `passive` [%] on the validation roads
            "curves": [each.get("curve", []) for each in told],
        }  # fmt: skip
        print(
            f"{name}: {[round(100 * (np.mean(c) / np.mean(grounds[network]['passive']) - 1), 2) for c in costs]} %"
        )
    data = {"date": time.strftime("%Y-%m-%d"), "references": grounds, "recipes": rows}
    RESULT.write_text(json.dumps(data) + "\n", encoding="utf-8")


def change(own: np.ndarray, ground: np.ndarray, draws: int = 2000) -> tuple[float, float, float]:
    """Return the change of the mean cost and its 95 % interval over seeds and roads.

    own (seeds, roads), ground (roads,): costs on the same roads.
    """
    rng = np.random.default_rng(0)
    values = []
    for _ in range(draws):
        roads = rng.integers(own.shape[1], size=own.shape[1])
        seeds = rng.integers(len(own), size=len(own))
        values.append(own[seeds][:, roads].mean() / ground[roads].mean() - 1.0)
    low, high = np.quantile(values, [0.025, 0.975])
    return float(own.mean() / ground.mean() - 1.0), float(low), float(high)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    one = commands.add_parser("train")
    one.add_argument("--out", type=Path, default=Path("runs/stock"))
    one.add_argument("--only", nargs="+", choices=list(RECIPES), default=list(RECIPES))
    one.add_argument("--seeds", type=int, default=5)
    commands.add_parser("collect").add_argument("folder", type=Path)
    given = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    if given.command == "collect":
        collect(given.folder)
        return
    for name in given.only:
        for seed in range(given.seeds):
            train(name, seed, given.out)


if __name__ == "__main__":
    main()
