"""Stock Stable-Baselines3 on the environment for learning: no teacher, no filter, five training seeds.

python benchmarks/stock.py train --out runs/stock [--only ppo-2min ...] [--seeds 5]     # one core; goes on where it stopped
python benchmarks/stock.py collect runs/stock                                           # scores all, writes benchmarks/stock.json

`ppo-2min` is the recipe of docs/tutorials/train.md. The models with default settings have all default hyperparameters of the
library. The interval of a mean over training seeds is a stratified bootstrap over seeds and roads, as in study.py.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
RESULT = ROOT / "benchmarks" / "stock.json"
PASSIVE = {"quarter-car-isd": ("passive", "skyhook", "mpc", "mpc-friction"), "half-car-isd": ("passive", "lqg-wheelbase", "mpc-wheelbase")}  # fmt: skip
TUNED: dict[str, Any] = {
    "n_steps": 256, "batch_size": 2048, "n_epochs": 1, "gamma": 0.99, "gae_lambda": 1.0,
    "policy_kwargs": {"net_arch": {"pi": [64, 64], "vf": []}},
}  # fmt: skip
#: name -> algorithm, environment, cars, decisions, first learning rate (None: the default), arguments
RECIPES: dict[str, tuple[str, str, int, int, float | None, dict[str, Any]]] = {
    "ppo-2min": ("PPO", "ISDSuspensionLearning-v0", 512, 25_000_000, 1e-3, TUNED),
    "ppo-defaults": ("PPO", "ISDSuspensionLearning-v0", 32, 1_900_000, None, {}),
    "sac-defaults": ("SAC", "ISDSuspensionLearning-v0", 32, 1_000_000, None, {}),
    "td3-defaults": ("TD3", "ISDSuspensionLearning-v0", 32, 1_000_000, None, {}),
    "tqc-defaults": ("TQC", "ISDSuspensionLearning-v0", 32, 500_000, None, {}),
    "ppo-half-car": ("PPO", "ISDHalfCarLearning-v0", 512, 25_000_000, 1e-3, TUNED),
}


def train(name: str, seed: int, folder: Path) -> None:
    """Train a recipe with a seed; do nothing where the model exists."""
    import torch
    from stable_baselines3 import PPO, SAC, TD3

    from isd_gym.sb3 import make_vec_env

    out = folder / name / f"{seed}.zip"
    if out.exists():
        return
    torch.set_num_threads(1)
    algorithm, environment, cars, decisions, rate, arguments = RECIPES[name]
    kinds: dict[str, Any] = {"PPO": PPO, "SAC": SAC, "TD3": TD3}
    if algorithm == "TQC":
        from sb3_contrib import TQC

        kinds["TQC"] = TQC
    env = make_vec_env(cars, cars_per_road=8, env_id=environment)
    more = {} if rate is None else {"learning_rate": lambda left: rate * left}
    model = kinds[algorithm]("MlpPolicy", env, seed=seed, device="cpu", **arguments, **more)
    env.seed(seed * 1_000_003 + 12_345)
    begin = time.process_time()
    model.learn(decisions)
    seconds = time.process_time() - begin
    out.parent.mkdir(parents=True, exist_ok=True)
    (folder / name / f"{seed}.json").write_text(json.dumps({"processor_seconds": round(seconds, 1)}) + "\n")
    model.save(out)
    print(f"{name}, seed {seed}: {seconds:.0f} s", flush=True)


def collect(folder: Path) -> None:
    """Score all models on the scoring roads and write the result."""
    from isd_gym.registration import LEARNING
    from isd_gym.scoring import score

    rows: dict[str, Any] = {}
    grounds: dict[str, dict[str, list[float]]] = {}
    for name, (algorithm, environment, cars, decisions, _, _) in RECIPES.items():
        models = sorted((folder / name).glob("*.zip"), key=lambda p: int(p.stem))
        if not models:
            continue
        network = LEARNING[environment]
        if network not in grounds:
            found = score(list(PASSIVE[network]), network)
            grounds[network] = {k: v["cost"] for k, v in found.raw.items()}
        costs = []
        for model in models:
            found = score([str(model)], network)
            costs.append(next(v["cost"] for k, v in found.raw.items() if k != "passive"))
        spent = [json.loads(m.with_suffix(".json").read_text())["processor_seconds"] for m in models]
        rows[name] = {
            "algorithm": algorithm, "environment": environment, "network": network, "cars": cars, "decisions": decisions,
            "seeds": [int(m.stem) for m in models], "processor_seconds": spent, "costs": costs,
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
