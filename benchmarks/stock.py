"""Stock Stable-Baselines3 on the environment for learning: no teacher, no filter, five training seeds.

python benchmarks/stock.py train --out runs/stock [--only ppo-2min ...] [--seeds 5]     # one core; goes on where it stopped
python benchmarks/stock.py collect runs/stock                                           # scores all, writes benchmarks/stock.json
python benchmarks/stock.py draw docs/figures/stock_curves.svg                           # the learning curves

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
import study

ROOT = Path(__file__).resolve().parents[1]
RESULT = ROOT / "benchmarks" / "stock.json"
POINTS = 25  # of a learning curve
SCALE = ("mpc", "skyhook")  # beside a learning curve
PASSIVE = {"quarter-car-isd": ("passive", "skyhook", "mpc", "mpc-friction"), "half-car-isd": ("passive", "lqg-wheelbase", "mpc-wheelbase")}  # fmt: skip
TUNED: dict[str, Any] = {
    "n_steps": 256, "batch_size": 2048, "n_epochs": 1, "gamma": 0.99, "gae_lambda": 1.0,
    "policy_kwargs": {"net_arch": {"pi": [64, 64], "vf": []}},
}  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Recipe:
    """What is trained: an algorithm of the library on cars of an environment."""

    algorithm: str
    cars: int
    decisions: int
    rate: float | None = None  # first learning rate, falling to 0; None: the default
    arguments: dict[str, Any] = dataclasses.field(default_factory=dict)
    options: dict[str, Any] = dataclasses.field(default_factory=dict)  # of the environment
    pink: bool = False  # exploration by pink noise of deviation 0.5 (package pink-noise-rl)
    normalized: bool = False  # VecNormalize with its defaults
    environment: str = "ISDSuspensionLearning-v0"


RECIPES = {
    "ppo-2min": Recipe("PPO", 512, 25_000_000, 1e-3, TUNED),
    "ppo-defaults": Recipe("PPO", 32, 1_900_000),
    "sac-defaults": Recipe("SAC", 8, 320_000),
    "td3-defaults": Recipe("TD3", 8, 320_000),
    "tqc-defaults": Recipe("TQC", 8, 160_000),
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
    "td3, pink noise": Recipe("TD3", 8, 320_000, pink=True),
}  # fmt: skip


def train(name: str, seed: int, folder: Path) -> None:
    """Train a recipe with a seed; do nothing where the model exists."""
    import torch
    from stable_baselines3 import PPO, SAC, TD3
    from stable_baselines3.common.noise import VectorizedActionNoise
    from stable_baselines3.common.vec_env import VecNormalize

    from isd_gym.sb3 import ScoreCallback, make_vec_env

    out = folder / name / f"{seed}.zip"
    if out.exists():
        return
    torch.set_num_threads(1)
    recipe = RECIPES[name]
    kinds: dict[str, Any] = {"PPO": PPO, "SAC": SAC, "TD3": TD3}
    if recipe.algorithm == "TQC":
        from sb3_contrib import TQC

        kinds["TQC"] = TQC
    cars: Any = make_vec_env(recipe.cars, cars_per_road=8, env_id=recipe.environment, **recipe.options)
    env = VecNormalize(cars) if recipe.normalized else cars
    more: dict[str, Any] = {}
    if recipe.rate is not None:
        first = recipe.rate
        more["learning_rate"] = lambda left: first * left
    if recipe.pink:
        from pink import PinkActionNoise

        each = [
            PinkActionNoise([0.5], 500, 1, rng=np.random.default_rng([seed, car]))
            for car in range(recipe.cars)
        ]
        noise = VectorizedActionNoise(each[0], recipe.cars)
        noise.noises = each  # not copies of one stream
        more["action_noise"] = noise
    model = kinds[recipe.algorithm]("MlpPolicy", env, seed=seed, device="cpu", **recipe.arguments, **more)
    env.seed(seed * 1_000_003 + 12_345)

    class Curve(ScoreCallback):
        """J on the validation roads over the processor time of the training alone."""

        def _evaluate(self) -> None:
            self.spent.append(time.process_time() - self.begun)
            super()._evaluate()
            self.begun += time.process_time() - self.begun - self.spent[-1]

    curve = Curve(recipe.decisions // POINTS, references=SCALE, verbose=0)
    curve.spent, curve.begun = [], time.process_time()
    model.learn(recipe.decisions, callback=curve)
    out.parent.mkdir(parents=True, exist_ok=True)
    seconds = round(curve.spent[-1], 1)
    points = [[round(t, 1), *row] for t, row in zip(curve.spent, curve.history, strict=True)]
    (folder / name / f"{seed}.json").write_text(
        json.dumps({"processor_seconds": seconds, "curve": points, "references": curve.references}) + "\n"
    )
    if recipe.normalized:
        env.save(str(out.with_name(f"{seed}_vecnormalize.pkl")))
    model.save(out)
    print(f"{name}, seed {seed}: {seconds:.0f} s", flush=True)


def collect(folder: Path) -> None:
    """Score all models of a folder on the scoring roads; results of recipes without a model there stay."""
    from isd_gym.registration import LEARNING
    from isd_gym.scoring import score

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
            "curves": [each.get("curve", []) for each in told], "beside": told[0].get("references", {}),
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


def draw(path: Path) -> None:
    """Draw the learning curves: interquartile mean and 95 % interval over training seeds (stratified bootstrap)."""
    import matplotlib

    matplotlib.use("svg")
    import matplotlib.pyplot as plt

    rows = json.loads(RESULT.read_text(encoding="utf-8"))["recipes"]
    shown = [name for name, row in rows.items() if row["network"] == "quarter-car-isd" and "half" not in name]
    plt.rcParams["svg.hashsalt"] = "stock"
    figure, axes = plt.subplots(figsize=(8, 4.5), layout="constrained")
    rng = np.random.default_rng(0)
    for name in shown:
        curves = [np.array(curve) for curve in rows[name].get("curves", []) if curve]
        if not curves:
            continue
        length = min(map(len, curves))
        time_, change_ = (
            np.mean([c[:length, 0] for c in curves], axis=0),
            np.array([c[:length, 3] for c in curves]),
        )
        drawn = study.iqm(change_[rng.integers(len(curves), size=(500, len(curves)))].swapaxes(0, 1))
        (line,) = axes.plot(time_, study.iqm(change_), label=f"{name} ({len(curves)} seeds)")
        axes.fill_between(
            time_, *np.quantile(drawn, [0.025, 0.975], axis=0), color=line.get_color(), alpha=0.2
        )
    for reference, change_ in next((rows[n]["beside"] for n in shown if rows[n].get("beside")), {}).items():
        axes.axhline(change_, color="0.5", linestyle=":", linewidth=1)
        axes.text(0, change_, reference, va="bottom", fontsize=8, color="0.3")
    axes.set(xlabel="processor time [s]", ylabel="J against passive on validation roads [%]", xscale="log")
    axes.legend()
    figure.savefig(path, metadata={"Date": None})


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
    commands.add_parser("draw").add_argument("picture", type=Path)
    given = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    if given.command == "collect":
        collect(given.folder)
        return
    if given.command == "draw":
        draw(given.picture)
        return
    for name in given.only:
        for seed in range(given.seeds):
            train(name, seed, given.out)


if __name__ == "__main__":
    main()
