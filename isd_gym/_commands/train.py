"""`isd-gym train`: stock Stable-Baselines3 on the environments for learning."""

from __future__ import annotations

import json
import sys
import time
import tomllib
from importlib.metadata import version
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .._common.errors import InputError, how_to_install, shown
from .._common.files import claim_folder, whole, write_text
from .._common.inputs import read_json
from ._options import NetworkOption, RoadOption, SpeedOption, option

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.callbacks import BaseCallback

    from ..physics.network import Network
    from ..sb3 import BatchedVecEnv

SCHEMA = "isd-training/2"
ALGORITHMS = ("PPO", "A2C", "SAC", "TD3", "DDPG")
REPLAY = "replay_buffer.pkl"
#: kind, mark and parts of the folder of a training
FOLDER = (
    "training",
    "run.json",
    ("run.json", "model.zip", "best.zip", REPLAY, "tensorboard", "policy"),
)
CHECKPOINT_SECONDS = 60.0
#: first roads of two training seeds
SEED_DISTANCE = 1_000_003


def command(
    recipe: Annotated[
        str,
        typer.Argument(help="ppo, sac, ppo-model-free, or a JSON file of your own."),
    ],
    out: Annotated[
        Path, option("--out DIR", "Folder of the training; an unfinished one goes on.")
    ],
    seed: Annotated[int, option("--seed", "Seed of the training.", min=0)] = 0,
    steps: Annotated[
        int | None,
        option("--steps", "Decisions of all cars; default: the recipe's.", min=1),
    ] = None,
    network: NetworkOption = "quarter-car-isd",
    road: RoadOption = "paper",
    speed: SpeedOption = 20.0,
    randomize: Annotated[
        str | None,
        option(
            "--randomize WHAT",
            "Ranges that every episode draws from: robust (those of the robust track), a JSON file such as "
            '{"body.mass": [0.8, 1.2], "road": ["A", "C"]}, or the folder of isd-gym diagnose.',
        ),
    ] = None,
) -> None:
    """Train a policy with Stable-Baselines3; the same command again goes on with an unfinished training.

    A recipe has the name of the algorithm, the number of cars, options of the environment for learning, and keyword
    arguments of the algorithm. DIR/run.json shows the recipe of a training. Change a copy of that file's "recipe" to
    make a recipe of your own, also for A2C, TD3 or DDPG.

    While it learns, the command prints the cost J on validation roads beside the passive car, mpc and skyhook. DIR/policy
    is the best policy on these roads; `isd-gym score passive mpc DIR/policy` compares it on the scoring roads.
    DIR/best.zip is the same policy for Stable-Baselines3, and `tensorboard --logdir DIR/tensorboard` shows the curves.

    Example: isd-gym train ppo --out runs/ppo
    """
    if not (find_spec("stable_baselines3") and find_spec("torch")):
        raise InputError(
            f"training needs Stable-Baselines3 and torch: {how_to_install('agents')}"
        )
    from ..physics.network import Network

    plan = read_recipe(recipe)
    if steps is not None:
        plan["steps"] = steps
    car: dict[str, Any] = {
        "network": Network.load(network).to_dict(),
        "road": road,
        "speed": speed,
    }
    car |= ranges(randomize) if randomize is not None else {}
    train(plan, car, seed, out)


def read_recipe(name: str) -> dict[str, Any]:
    """Return a recipe: a shipped one by its name, or the content of a JSON file."""
    shipped = json.loads(
        files(__package__).joinpath("recipes.json").read_text(encoding="utf-8")
    )
    if name not in shipped and not name.endswith(".json"):
        raise InputError(
            f"the recipe must be {', '.join(shipped)} or a .json file, not {shown(name)}"
        )
    found = shipped[name] if name in shipped else read_json(name)
    fields = shipped["ppo"]
    if not isinstance(found, dict) or set(found) != set(fields):
        raise InputError(
            f"recipe {shown(name)} must have the fields {', '.join(fields)}"
        )
    for field, usual in fields.items():
        if type(found[field]) is not type(usual):
            raise InputError(
                f"recipe {shown(name)}: {field} must be like {shown(usual)}"
            )
    if taken := {"network", "road", "speed", "randomize"} & set(found["environment"]):
        raise InputError(
            f"recipe {shown(name)}: give --{min(taken)} to the command, not in environment"
        )
    if found["algorithm"] not in ALGORITHMS:
        raise InputError(
            f"recipe {shown(name)}: algorithm must be one of {', '.join(ALGORITHMS)}"
        )
    return found


def ranges(given: str) -> dict[str, Any]:
    """Return the options of the environment for `--randomize`."""
    if given.endswith(".json"):
        return {"randomize": read_json(given)}
    if given != "robust":
        return {"randomize": given}
    grid = (
        files("isd_gym.benchmark")
        .joinpath("grids/robust.toml")
        .read_text(encoding="utf-8")
    )
    track = tomllib.loads(grid)["random"]
    drawn = {**track["factors"], "speed": track["speed"], "road": track["road"]}
    return {"randomize": drawn, "sensors": {"noise": track["noise"]}, "per_level": True}


def train(plan: dict[str, Any], car: dict[str, Any], seed: int, out: Path) -> None:
    """Train a recipe for a car in a folder, or go on there; leave the best policy on the validation roads, and its score."""
    import stable_baselines3
    import torch

    from ..env.registration import BY_CORNERS
    from ..physics.network import Network
    from ..physics.vehicle import vehicle
    from ..sb3 import ScoreCallback, make_vec_env

    torch.set_num_threads(1)
    plant = Network.load(car["network"])
    name = BY_CORNERS[len(vehicle(plant).corners)].replace("-v0", "Learning-v0")
    cars = make_vec_env(name, plan["cars"], **plan["environment"], **car)
    claim_folder(out, *FOLDER)
    claim(
        out / "run.json",
        {"schema": SCHEMA, "seed": seed, "recipe": plan, "environment": car},
    )
    callback = ScoreCallback(save=out / "best.zip")
    model: Any = learner(
        getattr(stable_baselines3, plan["algorithm"]), plan, seed, cars, out
    )
    callback.history = model.scores = [
        tuple(row) for row in getattr(model, "scores", [])
    ]
    # other roads after a pause than at the beginning
    cars.seed(seed * SEED_DISTANCE + model.num_timesteps)
    left = plan["steps"] - model.num_timesteps
    if left > 0:
        if model.num_timesteps:
            typer.echo(
                f"going on after {model.num_timesteps:,} of {plan['steps']:,} decisions",
                err=True,
            )
        try:
            model.learn(
                left,
                [callback, checkpoint(out)],
                reset_num_timesteps=False,
                progress_bar=sys.stderr.isatty(),
            )
        except KeyboardInterrupt:
            save(model, out)
            typer.echo(
                f"saved after {model.num_timesteps:,} decisions; the same command goes on",
                err=True,
            )
            raise
        save(model, out)
    cars.close()
    finish(out, plant)


def claim(file: Path, request: dict[str, Any]) -> None:
    """Write what is trained in a folder, or check that an earlier training there was asked for the same."""
    text = json.dumps(request, indent=1) + "\n"
    if not file.exists():
        write_text(file, text)
    elif read_json(file) != json.loads(text):
        raise InputError(
            f"'{file.parent}' holds another training ('{file}'): name another folder with --out"
        )


def learner(
    kind: Any, plan: dict[str, Any], seed: int, cars: BatchedVecEnv, out: Path
) -> BaseAlgorithm:
    """Return the model of the last checkpoint, or a new one."""
    if (out / "model.zip").exists():
        model = kind.load(out / "model.zip", cars, device="cpu")
        if (out / REPLAY).exists():
            model.load_replay_buffer(out / REPLAY)
        return model
    try:
        return kind(
            "MlpPolicy",
            cars,
            seed=seed,
            device="cpu",
            tensorboard_log=str(out / "tensorboard"),
            **arguments(plan),
        )
    except (AssertionError, TypeError, ValueError) as error:
        raise InputError(
            f"{plan['algorithm']} does not take these arguments: {error}"
        ) from None


def arguments(plan: dict[str, Any]) -> dict[str, Any]:
    """Return the keyword arguments of the algorithm; an object as the learning rate is a `LinearSchedule`."""
    from stable_baselines3.common.utils import LinearSchedule

    given = dict(plan["arguments"])
    if isinstance(given.get("learning_rate"), dict):
        given["learning_rate"] = LinearSchedule(**given["learning_rate"])
    return given


def checkpoint(out: Path) -> BaseCallback:
    """Return a callback that saves the model before a rollout, once a minute."""
    from stable_baselines3.common.callbacks import BaseCallback

    class Checkpoint(BaseCallback):
        saved = time.monotonic()

        def _on_step(self) -> bool:
            return True

        def _on_rollout_start(self) -> None:
            if time.monotonic() - self.saved > CHECKPOINT_SECONDS:
                save(self.model, out)
                self.saved = time.monotonic()

    return Checkpoint()


def save(model: BaseAlgorithm, out: Path) -> None:
    """Save the model, and the replay buffer of an off-policy algorithm."""
    from ..sb3 import save_model

    if hasattr(model, "save_replay_buffer"):
        with whole(out / REPLAY) as part:
            model.save_replay_buffer(part)
    save_model(model, out / "model.zip")


def finish(out: Path, plant: Network) -> None:
    """Write the best policy as plain weights, with its training and its score on the scoring roads."""
    from ..agents._archives import convert
    from ..benchmark.policies import passive
    from ..benchmark.scoring import Entry, score

    run = read_json(out / "run.json")
    policy = convert(out / "best.zip", network=plant, name=out.name)
    condition = {name: run["environment"][name] for name in ("road", "speed")}
    result = score(
        [Entry(policy.name, policy.copy)], plant, reference=passive(plant), **condition
    )
    row = result.policies[-1]
    policy.info |= {"training": {**run, "versions": versions()}, "score": row}
    policy.save(out / "policy")
    typer.echo(
        f"cost J {row['cost']['value']:.4f}, {100 * row['cost']['change']:+.1f} % against passive on "
        f"{result.conditions.episodes} scoring roads; policy in '{out / 'policy'}'"
    )


def versions() -> dict[str, str]:
    """Return the versions of the packages that make a policy."""
    return {
        name: version(name)
        for name in ("isd-gym", "stable-baselines3", "torch", "numpy")
    }
