"""A learner's state as a folder of plain numbers; resuming a training executes no code from the folder.

`learner.safetensors` holds the networks' weights, the optimisers' moments and the free variables of a
Stable-Baselines3 learner, and the running mean of the actor; `NAME.npy` the columns of a replay buffer;
`state.json` everything else. The learner is created from the run's settings as at the start, and must
have the shapes of the stored arrays.
"""

from __future__ import annotations

import json
import os
import re
from contextlib import contextmanager, suppress
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from isd_gym._common.errors import InputError, shown
from isd_gym._common.files import lock, writing
from isd_gym._common.inputs import is_number, read_json

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

SCHEMA = "isd-checkpoint/2"
NAME = re.compile(r"(\.?)checkpoint-(\d{12})")  # with a dot while it is written
LEARNER, STATE = "learner.safetensors", "state.json"
BUFFER = ("explored", "observations", "next_observations", "actions", "rewards", "dones", "timeouts")
FILES = (LEARNER, STATE, *(f"{key}.npy" for key in BUFFER))
STEPS = 10**12  # above the number of steps of any run
#: above every number of a learner; larger numbers overflow in a network of single precision
LARGEST = 1e12
#: parts of the actor, whose running mean a checkpoint holds, and the name of the mean
ACTOR = ("mlp_extractor.policy_net", "action_net", "actor.latent_pi", "actor.mu")
AVERAGE = "average"


def newest(folder: Path) -> Path | None:
    """Return the newest checkpoint of a run, and remove incomplete checkpoints.

    Args:
        folder: Folder of the run.

    Returns:
        Folder of the checkpoint; None without a checkpoint.
    """
    for stale in _written(folder, hidden=True):
        _remove(stale)
    found = [p for p in _written(folder) if (p / STATE).exists()]
    return found[-1] if found else None


def _written(folder: Path, hidden: bool = False) -> list[Path]:
    """Return the folders with the names that `write` gives, oldest first: complete ones, or those of a killed `write`."""
    found = ((p, NAME.fullmatch(p.name)) for p in folder.iterdir())
    own = [p for p, named in found if named and bool(named[1]) == hidden]
    return sorted(p for p in own if p.is_dir() and not p.is_symlink())


def _remove(checkpoint: Path) -> None:
    """Delete the files that `write` wrote, and their folder unless somebody put more into it."""
    for name in FILES:
        with suppress(FileNotFoundError):
            (checkpoint / name).unlink()
    with suppress(OSError):
        checkpoint.rmdir()


def steps(checkpoint: Path) -> int:
    """Return the number of control steps of all cars at a checkpoint.

    Args:
        checkpoint: Folder of the checkpoint.

    Returns:
        Number of steps.
    """
    return int(checkpoint.name.removeprefix("checkpoint-"))


def write(folder: Path, model: Any, average: dict[str, np.ndarray], state: dict[str, Any]) -> None:
    """Write a checkpoint atomically, then remove older checkpoints.

    Args:
        folder: Folder of the run.
        model: Learner of Stable-Baselines3.
        average: Running mean of the actor's weights.
        state: Further state, as plain data.
    """
    from safetensors.numpy import save

    place = folder / f"checkpoint-{model.num_timesteps:012d}"
    if place.exists():
        return
    temporary = folder / f".{place.name}"
    held = {"updates": int(model._n_updates), "episodes": int(model._episode_num)}
    with writing(place, temporary):
        temporary.mkdir(exist_ok=True)
        # the library's own file writer raises other errors
        mean = {f"{AVERAGE}/{key}": value for key, value in average.items()}
        (temporary / LEARNER).write_bytes(save(_tensors(model) | mean))
        if getattr(model, "replay_buffer", None) is not None:
            buffer = model.replay_buffer
            for key in BUFFER:
                np.save(temporary / f"{key}.npy", getattr(buffer, key)[: _filled(buffer)])
            held |= {"position": int(buffer.pos), "full": bool(buffer.full)}
        (temporary / STATE).write_text(json.dumps({"schema": SCHEMA, "learner": held, **state}))
        for file in temporary.iterdir():
            with file.open("rb") as handle:
                os.fsync(handle.fileno())
        older = _written(folder)
        temporary.rename(place)
    for old in older:
        _remove(old)


def read(checkpoint: Path, model: Any) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Restore a learner from a checkpoint.

    Args:
        checkpoint: Folder of the checkpoint.
        model: Learner with the same settings; changed in place.

    Returns:
        Running mean of the actor's weights, and the further state.

    Raises:
        InputError: The folder is no checkpoint of such a learner.
    """
    where = f"'{checkpoint}' is no checkpoint to go on from"
    state = read_json(checkpoint / STATE, where)
    try:
        if state.pop("schema", None) != SCHEMA:
            raise InputError("it is of another version; train into another folder")
        held = {k: int(v) for k, v in state.pop("learner").items()}
        if not all(0 <= v < STEPS for v in held.values()):
            raise InputError("its counts cannot be")
        if not _sound(state):
            raise InputError(f"{STATE} says something else")
        average = _restore(model, checkpoint / LEARNER)
        model._n_updates, model._episode_num = held["updates"], held["episodes"]
        model.num_timesteps = steps(checkpoint)
        if getattr(model, "replay_buffer", None) is not None:
            buffer = model.replay_buffer
            buffer.pos, buffer.full = held["position"], bool(held["full"])
            for key in BUFFER:
                rows = getattr(buffer, key)
                saved = np.load(checkpoint / f"{key}.npy", allow_pickle=False, mmap_mode="r")
                rows[: _filled(buffer)] = _like(key, saved, rows[: _filled(buffer)])
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    except Exception as error:  # any error is a fault of the files
        raise InputError(f"{where} ({type(error).__name__}: {error})") from None
    return average, state


def _sound(state: dict[str, Any]) -> bool:
    """Return whether the times, costs and learning curve of a state have the form that a run writes."""
    times = [state["seconds"], state["environment_seconds"]]
    rows = [[row[key] for key in ("steps", "seconds", "cost")] for row in state["curve"]]
    costs = list(state["references"].values())
    return (
        isinstance(state["curve"], list)
        and all(is_number(v) and 0 <= v < STEPS for v in (*times, *(v for row in rows for v in row)))
        and len(costs) > 0
        and all(is_number(v) and v > 0 for v in costs)  # changes are shares of the first one
    )


def _filled(buffer: Any) -> int:
    """Return the number of filled rows of a replay buffer."""
    if not 0 <= buffer.pos <= buffer.buffer_size:
        raise InputError("its buffer's position cannot be")
    return int(buffer.buffer_size if buffer.full else buffer.pos)


def _like(name: str, value: np.ndarray, wanted: Any) -> np.ndarray:
    """Return an array of numbers with the shape of `wanted`; raise `InputError` for other arrays."""
    if value.dtype.kind not in "fiub" or value.shape != tuple(wanted.shape):
        raise InputError(f"{shown(name)} is {value.dtype} of shape {value.shape}, not {tuple(wanted.shape)}")
    if value.size and not (np.abs(value, dtype=float) <= LARGEST).all():
        raise InputError(f"{shown(name)} holds a number that is not finite, or beyond {LARGEST:g}")
    return value


# -------------------------------------------------------------------- a learner of Stable-Baselines3 as tensors


def _optimizers(model: Any) -> dict[str, Any]:
    """Return optimisers by their names in Stable-Baselines3."""
    names = model._get_torch_save_params()[0]
    return {n: attrgetter(n)(model) for n in names if n.endswith("optimizer")}


def _tensors(model: Any) -> dict[str, np.ndarray]:
    """Return all learned arrays of a learner by unique names."""
    modules, variables = model._get_torch_save_params()
    out: dict[str, Any] = {}
    for name in modules:
        if not name.endswith("optimizer"):
            out |= {f"{name}/{k}": v for k, v in attrgetter(name)(model).state_dict().items()}
    out |= {name: attrgetter(name)(model) for name in variables}
    for name, optimizer in _optimizers(model).items():
        for i, moments in optimizer.state_dict()["state"].items():
            out |= {f"{name}/{i}/{key}": value for key, value in moments.items()}
    return {k: np.array(v.detach().numpy()) for k, v in out.items()}


def _restore(model: Any, path: Path) -> dict[str, np.ndarray]:
    """Fill a learner with the tensors of a file, and return the running mean of the actor's weights."""
    import torch
    from safetensors import safe_open

    with safe_open(path, framework="numpy") as file:
        left = set(file.keys())

        def take(name: str, wanted: Any) -> Any:
            if name not in left:
                raise InputError(f"its learner lacks {shown(name)}")
            left.discard(name)
            shape = tuple(file.get_slice(name).get_shape())
            if shape != tuple(wanted.shape):  # before it is read
                raise InputError(f"{shown(name)} is of shape {shape}, not {tuple(wanted.shape)}")
            return torch.from_numpy(np.array(_like(name, file.get_tensor(name), wanted)))

        average = {}
        if any(name.startswith(f"{AVERAGE}/") for name in left):  # there is no mean before the first update
            actor = {k: v for k, v in model.policy.state_dict().items() if k.startswith(ACTOR)}
            average = {k: take(f"{AVERAGE}/{k}", v).numpy() for k, v in actor.items()}
        modules, variables = model._get_torch_save_params()
        for name in modules:
            if not name.endswith("optimizer"):
                module = attrgetter(name)(model)
                module.load_state_dict({k: take(f"{name}/{k}", v) for k, v in module.state_dict().items()})
        with torch.no_grad():
            for name in variables:
                value = attrgetter(name)(model)
                value.copy_(take(name, value))
        for name, optimizer in _optimizers(model).items():
            state = _moments(name, optimizer, [k for k in left if k.startswith(f"{name}/")], take)
            optimizer.load_state_dict(
                {"state": state, "param_groups": optimizer.state_dict()["param_groups"]}
            )
    if left:
        raise InputError(f"its learner holds {shown(min(left))}, which this one has not")
    return average


def _moments(
    optimizer_name: str, optimizer: Any, names: list[str], take: Callable[[str, Any], Any]
) -> dict[int, dict[str, Any]]:
    """Return the moments of an Adam optimiser by the number of the parameter."""
    parameters = [p for group in optimizer.param_groups for p in group["params"]]
    state: dict[int, dict[str, Any]] = {}
    for full in names:
        i, key = full.removeprefix(f"{optimizer_name}/").split("/")
        number = int(i)
        state.setdefault(number, {})[key] = take(full, np.empty(()) if key == "step" else parameters[number])
    if any(n < 0 or set(moments) != {"step", "exp_avg", "exp_avg_sq"} for n, moments in state.items()):
        raise InputError(f"its {shown(optimizer_name)} is not Adam's")
    return state


@contextmanager
def held(folder: Path, kind: str) -> Iterator[None]:
    """Lock the folder of a growing result for this process."""
    handle = lock(folder)
    if handle is None and os.name != "nt":  # Windows has no such locks
        raise InputError(f"another process is writing the {kind} in '{folder}'")
    try:
        yield
    finally:
        if handle is not None:
            os.close(handle)
