"""A learner's state as a folder of plain numbers; resuming a training executes no code from the folder.

`learner.safetensors` holds the networks' weights, the optimisers' moments and the free variables of a
Stable-Baselines3 learner; `average.npz` the running mean of the actor; `NAME.npy` the columns of a replay
buffer; `state.json` everything else. The learner is created from the run's settings as at the start, and must
have the shapes of the stored arrays.
"""

from __future__ import annotations

import json
import os
import re
import shutil
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from isd_gym.errors import InputError, shown
from isd_gym.inputs import read_json

if TYPE_CHECKING:
    from pathlib import Path

SCHEMA = "isd-checkpoint/1"
NAME = re.compile(r"checkpoint-(\d{12})")
LEARNER, AVERAGE, STATE = "learner.safetensors", "average.npz", "state.json"
BUFFER = ("explored", "observations", "next_observations", "actions", "rewards", "dones", "timeouts")
STEPS = 10**12  # above the number of steps of any run


def newest(folder: Path) -> Path | None:
    """Return the newest checkpoint of a run, and remove incomplete checkpoints.

    Args:
        folder: Folder of the run.

    Returns:
        Folder of the checkpoint; None without a checkpoint.
    """
    for stale in folder.glob(".checkpoint-*"):
        shutil.rmtree(stale)
    found = sorted(p for p in folder.glob("checkpoint-*") if NAME.fullmatch(p.name))
    return found[-1] if found else None


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
    temporary.mkdir()
    # the library's own file writer raises other errors
    (temporary / LEARNER).write_bytes(save(_tensors(model)))
    arrays: dict[str, Any] = average
    np.savez(temporary / AVERAGE, **arrays)
    held = {"updates": int(model._n_updates), "episodes": int(model._episode_num)}
    if getattr(model, "replay_buffer", None) is not None:
        buffer = model.replay_buffer
        for key in BUFFER:
            np.save(temporary / f"{key}.npy", getattr(buffer, key)[: _filled(buffer)])
        held |= {"position": int(buffer.pos), "full": bool(buffer.full)}
    (temporary / STATE).write_text(json.dumps({"schema": SCHEMA, "learner": held, **state}))
    for file in temporary.iterdir():
        with file.open("rb") as handle:
            os.fsync(handle.fileno())
    older = list(folder.glob("checkpoint-*"))
    temporary.rename(place)
    for old in older:
        shutil.rmtree(old)


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
        if not (_numbers(state) and isinstance(state["curve"], list) and len(state["references"]) > 0):
            raise InputError(f"{STATE} says something else")
        _restore(model, checkpoint / LEARNER)
        with np.load(checkpoint / AVERAGE, allow_pickle=False) as arrays:
            average = {k: _like(k, arrays[k], model.policy.state_dict()[k]) for k in arrays.files}
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


def _numbers(state: dict[str, Any]) -> bool:
    """Return whether the times, costs and learning curve of a state have the form that a run writes."""
    numbers = [state["seconds"], state["environment_seconds"], *state["references"].values()]
    numbers += [row[key] for row in state["curve"] for key in ("steps", "seconds", "cost")]
    return all(isinstance(v, int | float) and not isinstance(v, bool) for v in numbers)


def _filled(buffer: Any) -> int:
    """Return the number of filled rows of a replay buffer."""
    if not 0 <= buffer.pos <= buffer.buffer_size:
        raise InputError("its buffer's position cannot be")
    return int(buffer.buffer_size if buffer.full else buffer.pos)


def _like(name: str, value: np.ndarray, wanted: Any) -> np.ndarray:
    """Return an array of numbers with the shape of `wanted`; raise `InputError` for other arrays."""
    if value.dtype.kind not in "fiub" or value.shape != tuple(wanted.shape):
        raise InputError(f"{shown(name)} is {value.dtype} of shape {value.shape}, not {tuple(wanted.shape)}")
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


def _restore(model: Any, path: Path) -> None:
    import torch
    from safetensors.numpy import load_file

    found = load_file(path)
    modules, variables = model._get_torch_save_params()
    for name in modules:
        if name.endswith("optimizer"):
            continue
        module = attrgetter(name)(model)
        own = module.state_dict()
        values = {k: _like(k, found.pop(f"{name}/{k}"), v) for k, v in own.items()}
        module.load_state_dict({k: torch.from_numpy(np.array(v)) for k, v in values.items()})
    with torch.no_grad():
        for name in variables:
            value = attrgetter(name)(model)
            value.copy_(torch.from_numpy(_like(name, found.pop(name), value)))
    for name, optimizer in _optimizers(model).items():
        parameters = [p for group in optimizer.param_groups for p in group["params"]]
        state: dict[int, dict[str, Any]] = {}
        for full in [k for k in found if k.startswith(f"{name}/")]:
            i, key = full.removeprefix(f"{name}/").split("/")
            number = int(i)
            wanted = np.empty(()) if key == "step" else parameters[number]
            state.setdefault(number, {})[key] = torch.from_numpy(
                np.array(_like(full, found.pop(full), wanted))
            )
        if any(
            number < 0 or set(moments) != {"step", "exp_avg", "exp_avg_sq"}
            for number, moments in state.items()
        ):
            raise InputError(f"its {shown(name)} is not Adam's")
        optimizer.load_state_dict({"state": state, "param_groups": optimizer.state_dict()["param_groups"]})
    if found:
        raise InputError(f"its learner holds {shown(min(found))}, which this one has not")
