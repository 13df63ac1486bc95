"""The study: PPO and SAC over training seeds against the baselines, paired on held-out roads.

    python benchmarks/study.py train --out runs/study --seeds 5          # resumes; half an hour on one core
    python benchmarks/study.py ship runs/study                           # the best seed of each algorithm, into agents/policies
    python benchmarks/study.py collect RUN... --out benchmarks/study.json --items runs/study/items   # any seeds; resumes
    python benchmarks/study.py table benchmarks/study.json
    python benchmarks/study.py draw benchmarks/study.json --out docs/figures

`--network half-car-isd` (train, collect) does the same with a half car; its only condition is the training road (`--training-road`).
`collect` drives every policy over the same roads in every condition and stores the cost of each episode and the
learning curves: a small file from which table and figures are redrawn. The point estimate over training seeds is the
interquartile mean, its 95 % interval a stratified bootstrap over seeds and roads (Agarwal et al., NeurIPS 2021).
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from isd_gym.agents.policy import SHIPPED, Policy

from isd_gym._common.errors import InputError
from isd_gym._common.files import write_text
from isd_gym.benchmark._sweep import items as engine
from isd_gym.benchmark._sweep.grid import Condition, Grid

SCHEMA = "isd-study/2"
#: by network; of the quarter car's MPCs the best (`isd-gym score` has all of them)
BASELINES = {
    "quarter-car-isd": ("passive", "isd-passive", "lqg", "mpc-friction"),
    "half-car-isd": ("passive", "mpc-friction", "lqg-wheelbase", "mpc-wheelbase"),
}
#: every controller keeps believing in the nominal car; on the training road eight times as many roads, to tell policies
#: apart that differ by a tenth of a per cent
CONDITIONS = (
    Condition("training road"),
    Condition("ISO A", road="A"),
    Condition("ISO C", road="C"),
    Condition("slow", speed=12.0),
    Condition("fast", speed=30.0),
    Condition("body 20 % heavier", factors={"body.mass": 1.2}),
    Condition("body 20 % lighter", factors={"body.mass": 0.8}),
    Condition("friction 50 % higher", factors={"seal.level": 1.5}),
    Condition("friction 50 % lower", factors={"seal.level": 0.5}),
)
MORE = 8
RESAMPLES = 4000


def collect(
    runs: list[Path],
    episodes: int,
    seed: int,
    items: Path,
    *,
    jobs: int = 1,
    preview: float | None = None,
    conditions: tuple[Condition, ...] = CONDITIONS,
    network: str = "quarter-car-isd",
) -> dict[str, Any]:
    """Cost and RMS tyre load [N] (episodes,) of every policy in every condition, and the learning curves of the runs.

    Items lie in the folder `items`: what is in it is not driven again. preview [s]: baselines that see so much of the road.
    """
    baselines = BASELINES[network]
    if preview:
        baselines = (*baselines[:2], *(f"{n}-preview" for n in baselines[2:]))
    conditions = tuple(replace(c, network=network) for c in conditions)
    curves, names = {}, dict.fromkeys(baselines)
    keys = {name: name for name in baselines}
    for folder in runs:
        folder = folder / "policy" if (folder / "policy").is_dir() else folder
        info = Policy.load(folder).info
        key = f"{info['algorithm']}/{info['training']['seed']}"
        if key in keys.values():
            raise InputError(f"two runs of {key}")
        names[str(folder)] = None
        keys[str(folder)] = key
        curves[key] = info["training"]
    times = [
        replace(c, preview=preview, episodes=episodes * (1 if i else MORE)) for i, c in enumerate(conditions)
    ]
    grid = Grid(tuple(names), tuple(times), episodes=episodes, seed=seed, batch=32)
    outcome = engine.run(grid.tasks(), items, jobs=jobs, say=print)
    costs: dict[str, dict[str, list[float]]] = {}
    tyre: dict[str, dict[str, list[float]]] = {}
    for c in grid.conditions:
        costs[c.name], tyre[c.name] = {}, {}
        for name, key in keys.items():
            found = [outcome.results.get(t.key) for t in grid.items(c, name)]
            if None in found:
                print(f"{c.name}: {key} is missing")
                continue
            costs[c.name][key] = [round(j, 6) for part in found for j in part["measures"]["cost"]]
            load = [q for part in found for q in part["measures"]["tyre_load_rms"]]  # mean squares
            tyre[c.name][key] = [round(q**0.5, 2) for q in load]
    return {
        "schema": SCHEMA,
        "network": network,
        "episodes": episodes,
        "seed": seed,
        "preview": preview or 0.0,
        "conditions": {c.name: c.to_dict() for c in conditions},
        "costs": costs,
        "tyre_load": tyre,
        "training": curves,
    }


def train_all(
    out: Path, seeds: int, algorithms: tuple[str, ...] = ("ppo", "sac"), network: str = "quarter-car-isd"
) -> None:
    """Train every seed of every algorithm, one after the other; goes on where it stopped."""
    from isd_gym.contrib.training.train import train

    for seed in range(seeds):
        for algorithm in algorithms:
            (out / algorithm).mkdir(parents=True, exist_ok=True)
            train(algorithm, out / algorithm / str(seed), seed=seed, network=network)


def ship(out: Path) -> list[Path]:
    """Copy the seed of least cost on its validation roads (not on those it is scored on) of each algorithm."""
    shipped = []
    for algorithm in ("ppo", "sac"):
        policies = [Policy.load(p.parent) for p in sorted((out / algorithm).glob("*/policy/policy.json"))]
        policies = [p for p in policies if p.info["score"] is not None]
        if policies:
            best = min(policies, key=lambda p: min(row["cost"] for row in p.info["training"]["curve"]))
            shipped.append(best.save(SHIPPED / best.name))
    return shipped


def iqm(values: np.ndarray) -> np.ndarray:
    """Interquartile mean along the first axis: the mean of the middle half."""
    ordered = np.sort(values, axis=0)
    cut = len(ordered) // 4
    return ordered[cut : len(ordered) - cut].mean(axis=0)


def change(own: np.ndarray, reference: np.ndarray, rng: np.random.Generator) -> tuple[float, float, float]:
    """IQM over training seeds of the relative change of cost, and its 95 % interval.

    own (seeds, episodes), reference (episodes,): costs on the same roads.
    """
    seeds, episodes = own.shape
    value = float(iqm(own.mean(axis=1) / reference.mean() - 1))
    drawn = np.empty(RESAMPLES)
    for k in range(RESAMPLES):
        roads = rng.integers(episodes, size=episodes)
        some = rng.integers(seeds, size=seeds)
        drawn[k] = iqm(own[some][:, roads].mean(axis=1) / reference[roads].mean() - 1)
    low, high = np.quantile(drawn, [0.025, 0.975])
    return value, float(low), float(high)


def groups(costs: dict[str, list[float]]) -> dict[str, np.ndarray]:
    """Costs by policy (seeds, episodes); the training seeds of an algorithm together."""
    out: dict[str, list[list[float]]] = {}
    for key, values in costs.items():
        out.setdefault(key.partition("/")[0], []).append(values)
    return {k: np.array(v) for k, v in out.items()}


def best_mpc(costs: dict[str, np.ndarray]) -> str:
    """The MPC of least mean cost."""
    return min((k for k in costs if k.startswith("mpc")), key=lambda k: costs[k].mean())


def table(study: dict[str, Any]) -> str:
    """The outcome as a Markdown table. Intervals against a single baseline hold for the mean over the same roads."""
    references = ("passive", "lqg", "best MPC")
    lines = [
        "| condition | policy | seeds | J | tyre load | of the reachable gain | against passive | against LQG | against the best MPC |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for condition, costs in study["costs"].items():
        by, load, gains = groups(costs), loads(study, condition), shares(study, condition)
        rivals = {"passive": "passive", "lqg": "lqg", "best MPC": best_mpc(by) if has_mpc(by) else None}
        for name, own in by.items():
            cells = []
            for reference in references:
                rival = rivals[reference]
                if rival not in by or name in ("passive", rival):
                    cells.append("")
                    continue
                v, low, high = change(own, by[str(rival)][0], np.random.default_rng(0))
                digits = 1 if reference == "passive" else 2
                cells.append(f"{100 * v:+.{digits}f} % [{100 * low:+.{digits}f}, {100 * high:+.{digits}f}]")
            seeds = len(own) if name in ("ppo", "sac") else ""
            label = f"{name} (best MPC)" if name == rivals["best MPC"] else name
            seen = name in load and name != "passive"
            grip = f"{100 * float(iqm(load[name] / load['passive'] - 1)):+.1f} %" if seen else ""
            share = f"{100 * gains[name]:.1f} %" if name in gains else ""
            cells = [f"{iqm(own.mean(axis=1)):.4f}", grip, share, *cells]
            lines.append(f"| {condition} | {label} | {seeds} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def loads(study: dict[str, Any], condition: str) -> dict[str, np.ndarray]:
    """RMS tyre load [N] over all roads, by policy (seeds,)."""
    by = groups(study.get("tyre_load", {}).get(condition, {}))
    return {k: np.sqrt(np.mean(v**2, axis=1)) for k, v in by.items()}


def shares(study: dict[str, Any], condition: str) -> dict[str, float]:
    """Share of the reachable gain by policy, on the first roads of the training condition, whose optimum is known."""
    best = np.array(study.get("clairvoyant", []))
    if condition != "training road" or not len(best):
        return {}
    by = {k: v[:, : len(best)].mean(axis=1) for k, v in groups(study["costs"][condition]).items()}
    passive = by.pop("passive")[0]
    return {name: float(iqm((passive - own) / (passive - best.mean()))) for name, own in by.items()}


def has_mpc(costs: dict[str, np.ndarray]) -> bool:
    return any(k.startswith("mpc") for k in costs)


def draw(study: dict[str, Any], out: Path) -> list[Path]:
    """Learning curves and the comparison, as SVG files in `out`."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    out.mkdir(parents=True, exist_ok=True)
    colours = {"ppo": "tab:blue", "sac": "tab:orange"}
    figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
    for key, training in study["training"].items():
        name = key.partition("/")[0]
        x = [row["steps"] / 1e6 for row in training["curve"]]
        axes.plot(
            x, [row["cost"] for row in training["curve"]], color=colours[name], alpha=0.7, label=name.upper()
        )
    references = {k: j for training in study["training"].values() for k, j in training["references"].items()}
    for name, j in references.items():
        if "passive" in name:  # far above
            continue
        axes.axhline(j, color="0.5", linestyle=":", linewidth=1)
        axes.text(axes.get_xlim()[1], j, f" {name}", va="center", fontsize=8)
    handles = dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    axes.legend(handles.values(), handles.keys())
    axes.set(xlabel="control steps [million]", ylabel="cost J on validation roads [-]")
    first = out / "learning_curves.svg"
    figure.savefig(first)
    plt.close(figure)

    conditions = list(study["costs"])
    rows = -(-len(conditions) // 4)
    figure, grid = plt.subplots(
        rows, -(-len(conditions) // rows), figsize=(12, 2.6 * rows), sharey=True, layout="constrained"
    )
    for axes, condition in zip(np.ravel(grid), conditions, strict=False):
        by = groups(study["costs"][condition])
        rival = best_mpc(by)
        names = [n for n in by if "passive" not in n and n != rival]
        for i, name in enumerate(names):
            v, low, high = change(by[name], by[rival][0], np.random.default_rng(0))
            axes.plot([100 * low, 100 * high], [i, i], color=colours.get(name, "0.4"), linewidth=3)
            axes.plot(100 * v, i, "o", color=colours.get(name, "0.4"))
        axes.set_yticks(range(len(names)), names)
        axes.axvline(0.0, color="0.8", linewidth=1)
        axes.set(title=condition, xlabel=f"J against {rival} [%]", ylim=(-0.5, len(names) - 0.5))
    second = out / "study.svg"
    figure.savefig(second)
    plt.close(figure)
    return [first, second]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    one = commands.add_parser("collect")
    one.add_argument("runs", nargs="*", type=Path)
    one.add_argument("--out", type=Path, required=True)
    one.add_argument(
        "--items", type=Path, required=True, help="folder of what was driven; it is not driven again"
    )
    one.add_argument("--jobs", type=int, default=1)
    one.add_argument("--preview", type=float)
    one.add_argument("--training-road", action="store_true", help="that condition alone")
    one.add_argument("--episodes", type=int, default=16)
    one.add_argument("--seed", type=int, default=0)
    one.add_argument("--network", choices=BASELINES, default="quarter-car-isd")
    runs = commands.add_parser("train")
    runs.add_argument("--out", type=Path, required=True)
    runs.add_argument("--seeds", type=int, default=5)
    runs.add_argument("--algorithms", nargs="+", default=["ppo", "sac"])
    runs.add_argument("--network", choices=BASELINES, default="quarter-car-isd")
    commands.add_parser("ship").add_argument("runs", type=Path)
    for name in ("table", "draw"):
        other = commands.add_parser(name)
        other.add_argument("study", type=Path)
        if name == "draw":
            other.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    if given.command == "collect":
        where = CONDITIONS[:1] if given.training_road else CONDITIONS
        found = collect(
            given.runs,
            given.episodes,
            given.seed,
            given.items,
            jobs=given.jobs,
            preview=given.preview,
            conditions=where,
            network=given.network,
        )
        write_text(given.out, json.dumps(found) + "\n")
        return
    if given.command == "train":
        train_all(given.out, given.seeds, tuple(given.algorithms), given.network)
        return
    if given.command == "ship":
        for path in ship(given.runs):
            print(path)
        return
    study = json.loads(given.study.read_text())
    if given.command == "table":
        print(table(study), end="")
    else:
        for path in draw(study, given.out):
            print(path)


if __name__ == "__main__":
    main()
